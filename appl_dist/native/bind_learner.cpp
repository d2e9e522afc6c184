// The learner's C core: optimiser steps over flat vectors. Tensors come in through DLPack, without a copy.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <cmath>
#include <optional>

#include "check.h"

extern "C" {
#include "adam.h"
}

namespace nb = nanobind;

namespace {
long length(const appl::Array &a) { return a.ndim() == 1 ? static_cast<long>(a.shape(0)) : -1; }

uint16_t *half_or_null(const std::optional<appl::Array> &a, const char *name, long n) {
    return a ? appl::checked<uint16_t>(*a, name, {n}) : nullptr;
}

void adam(const appl::Array &p, const appl::Array &grad, const appl::Array &m, const appl::Array &v,
          const std::optional<appl::Array> &copy, long step, double rate, double beta1, double beta2, double epsilon) {
    const long n = length(p);
    float *parameters = appl::checked<float>(p, "parameters", {n});
    const bool half = grad.dtype() == nb::dtype<uint16_t>();
    const void *gradient = half ? static_cast<const void *>(appl::checked<const uint16_t>(grad, "gradient", {n}))
                                : appl::checked<const float>(grad, "gradient", {n});
    float *first = appl::checked<float>(m, "first_moment", {n});
    float *second = appl::checked<float>(v, "second_moment", {n});
    uint16_t *cast = half_or_null(copy, "copy", n);
    if (step < 1) throw nb::value_error("step: counts from 1");
    const adam_rates rates = {
        static_cast<float>(beta1),
        static_cast<float>(beta2),
        static_cast<float>(1.0 - beta1),
        static_cast<float>(1.0 - beta2),
        static_cast<float>(rate / (1.0 - std::pow(beta1, step))),
        static_cast<float>(1.0 / std::sqrt(1.0 - std::pow(beta2, step))),
        static_cast<float>(epsilon),
    };
    nb::gil_scoped_release release;
    adam_step(&rates, static_cast<size_t>(n), parameters, half ? nullptr : static_cast<const float *>(gradient),
              half ? static_cast<const uint16_t *>(gradient) : nullptr, first, second, cast);
}

void polyak(const appl::Array &target, const appl::Array &p, const std::optional<appl::Array> &copy, double tau) {
    const long n = length(target);
    float *average = appl::checked<float>(target, "target", {n});
    const float *parameters = appl::checked<const float>(p, "parameters", {n});
    uint16_t *cast = half_or_null(copy, "copy", n);
    nb::gil_scoped_release release;
    polyak_step(static_cast<float>(tau), static_cast<size_t>(n), average, parameters, cast);
}
}  // namespace

void bind_learner(nb::module_ &m) {
    m.def("adam", &adam, nb::arg("parameters"), nb::arg("gradient"), nb::arg("first_moment"), nb::arg("second_moment"),
          nb::arg("copy").none(), nb::kw_only(), nb::arg("step"), nb::arg("rate"), nb::arg("beta1"), nb::arg("beta2"),
          nb::arg("epsilon"),
          "One Adam step in place on (n,) float32 vectors. gradient: (n,) float32, or uint16 bits of bfloat16; copy: (n,) "
          "uint16, receives the parameters as bfloat16, or None. step counts from 1.");
    m.def("polyak", &polyak, nb::arg("target"), nb::arg("parameters"), nb::arg("copy").none(), nb::kw_only(),
          nb::arg("tau"), "target += tau (parameters - target) in place, (n,) float32; copy as in adam.");
}
