// The learner's C core: optimiser steps over flat vectors, and matrix products. Tensors come in through DLPack, without
// a copy.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <new>
#include <optional>

#include "check.h"

extern "C" {
#include "adam.h"
#include "amx.h"
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

// (rows, columns) of bfloat16; only the columns need to lie side by side.
struct Matrix {
    Matrix(const appl::Array &a, const char *name) {
        const nb::dlpack::dtype wanted{static_cast<uint8_t>(nb::dlpack::dtype_code::Bfloat), 16, 1};
        if (a.dtype() != wanted) throw nb::type_error((std::string(name) + ": expected bfloat16").c_str());
        if (a.ndim() != 2 || (a.shape(1) > 1 && a.stride(1) != 1) || a.stride(0) < 0)
            throw nb::value_error((std::string(name) + ": expected (rows, columns), columns side by side, got " +
                                   appl::shape_text(a)).c_str());
        data = static_cast<uint16_t *>(const_cast<void *>(static_cast<const void *>(a.data())));
        rows = a.shape(0), columns = a.shape(1), step = static_cast<size_t>(a.stride(0));
    }
    Matrix() = default;
    void expect(const char *name, size_t r, size_t c) const {
        if (rows != r || columns != c)
            throw nb::value_error((std::string(name) + ": expected (" + std::to_string(r) + ", " + std::to_string(c) +
                                   "), got (" + std::to_string(rows) + ", " + std::to_string(columns) + ")").c_str());
    }

    uint16_t *data = nullptr;
    size_t rows = 0, columns = 0, step = 0;
};

// Scratch that grows to the largest product of its thread.
void *scratch(size_t bytes) {
    struct Free {
        void operator()(void *p) const { ::operator delete(p, std::align_val_t{64}); }
    };
    thread_local std::unique_ptr<void, Free> memory;
    thread_local size_t size = 0;
    if (bytes > size) {
        memory.reset();
        size = 0;
        memory.reset(::operator new(bytes, std::align_val_t{64}));
        size = bytes;
    }
    return memory.get();
}

// A product with its memory, to be run as often as that changes; holds on to the tensors.
class Product {
  public:
    Product(const appl::Array &a_, const appl::Array &b_, const appl::Array &out_, bool transpose_a, bool transpose_b,
            const std::optional<appl::Array> &rest_, const std::optional<appl::Array> &bias_, bool relu,
            const std::optional<appl::Array> &open_, const std::optional<appl::Array> &sums_)
        : kept_{a_, b_, out_, rest_.value_or(a_), bias_.value_or(a_), open_.value_or(a_), sums_.value_or(a_)} {
        if (!amx_available()) throw std::runtime_error("this processor has no AMX tiles");
        const Matrix a(a_, "a"), b(b_, "b"), out(out_, "out");
        const size_t m = transpose_a ? a.columns : a.rows, k = transpose_a ? a.rows : a.columns;
        const size_t n = transpose_b ? b.rows : b.columns;
        b.expect("b", transpose_b ? n : k, transpose_b ? k : n);
        out.expect("out", m, n);
        if (sums_ && transpose_b) throw nb::value_error("sums: only with b as it is");
        if (rest_ && (transpose_a || transpose_b)) throw nb::value_error("rest: only with a and b as they are");
        Matrix rest, bias, open, sums;
        if (rest_) (rest = Matrix(*rest_, "rest")).expect("rest", m, std::min(rest.columns, k));
        if (bias_) (bias = Matrix(*bias_, "bias")).expect("bias", 1, n);
        if (open_) (open = Matrix(*open_, "open")).expect("open", m, n);
        if (sums_) (sums = Matrix(*sums_, "sums")).expect("sums", 1, n);
        product_ = {m, n, k, {a.data, a.step, transpose_a}, {b.data, b.step, transpose_b}, {rest.data, rest.step, 0},
                    rest.columns, bias.data, relu, open.data, open.step, sums.data, out.data, out.step};
    }

    void run() const {
        nb::gil_scoped_release release;
        amx_multiply(&product_, scratch(amx_scratch(&product_)));
    }

  private:
    appl::Array kept_[7];
    amx_product product_;
};
}  // namespace

void bind_learner(nb::module_ &m) {
    m.def("adam", &adam, nb::arg("parameters"), nb::arg("gradient"), nb::arg("first_moment"), nb::arg("second_moment"),
          nb::arg("copy").none(), nb::kw_only(), nb::arg("step"), nb::arg("rate"), nb::arg("beta1"), nb::arg("beta2"),
          nb::arg("epsilon"),
          "One Adam step in place on (n,) float32 vectors. gradient: (n,) float32, or uint16 bits of bfloat16; copy: "
          "(n,) uint16, receives the parameters as bfloat16, or None. step counts from 1.");
    m.def("polyak", &polyak, nb::arg("target"), nb::arg("parameters"), nb::arg("copy").none(), nb::kw_only(),
          nb::arg("tau"), "target += tau (parameters - target) in place, (n,) float32; copy as in adam.");
    m.def("has_tiles", [] { return amx_available() != 0; }, "Whether `Product` can run on this processor.");
    nb::class_<Product>(m, "Product",
                        "out (m, n) = a (m, k) b (k, n) + bias (1, n), all bfloat16, summed in float32. rest "
                        "(m, r): added to the last r columns of a, not rounded. transpose_a, transpose_b: a, b are "
                        "stored transposed. relu: negative results become 0. open (m, n): results become 0 where it is "
                        "not positive. sums (1, n) becomes the sums of b's columns.")
        .def(nb::init<const appl::Array &, const appl::Array &, const appl::Array &, bool, bool,
                      const std::optional<appl::Array> &, const std::optional<appl::Array> &, bool,
                      const std::optional<appl::Array> &, const std::optional<appl::Array> &>(),
             nb::arg("a"), nb::arg("b"), nb::arg("out"), nb::kw_only(), nb::arg("transpose_a") = false,
             nb::arg("transpose_b") = false, nb::arg("rest").none() = nb::none(), nb::arg("bias").none() = nb::none(),
             nb::arg("relu") = false, nb::arg("open").none() = nb::none(), nb::arg("sums").none() = nb::none())
        .def("__call__", &Product::run);
}
