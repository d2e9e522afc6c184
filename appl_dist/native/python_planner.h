// A planner written in Python (planner/planners.py: Planner) behind planner_interface.h. What it raises is kept, since
// the C loop between cannot carry it, and thrown again once the loop has stopped.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <stdexcept>
#include <utility>

extern "C" {
#include "planner_interface.h"
}

namespace appl {
namespace nb = nanobind;

class PythonPlanner {
  public:
    PythonPlanner(nb::object planner, int beams) : planner_(planner) {
        interface_.self = this;
        interface_.beams = beams;
        interface_.add_scan = [](void *self, const float *ranges, const double pose[3]) {
            of(self).guarded([&](PythonPlanner &p) {
                p.planner_.attr("add_scan")(copied(ranges, size_t(p.interface_.beams)), copied(pose, 3));
            });
        };
        interface_.update_local = [](void *self, const double pose[3]) {
            of(self).guarded([&](PythonPlanner &p) { p.planner_.attr("update_local_map")(copied(pose, 3)); });
        };
        interface_.update_global = [](void *self, const double pose[3]) {
            of(self).guarded([&](PythonPlanner &p) { p.planner_.attr("update_global_map")(copied(pose, 3)); });
        };
        interface_.plan = [](void *self, const double pose[3], double now) {
            bool found = false;
            of(self).guarded([&](PythonPlanner &p) {
                const nb::object now_s = std::isnan(now) ? nb::none() : nb::object(nb::float_(now));
                found = nb::cast<bool>(nb::bool_(p.planner_.attr("plan")(copied(pose, 3), now_s)));
            });
            return found;
        };
        interface_.control = [](void *self, const double pose[3], const double twist[2], double now, double out[2]) {
            out[0] = out[1] = 0.0;
            of(self).guarded([&](PythonPlanner &p) {
                const nb::object command = p.planner_.attr("control")(copied(pose, 3), copied(twist, 2), now);
                const double v = nb::cast<double>(nb::float_(command[0]));
                const double w = nb::cast<double>(nb::float_(command[1]));
                if (!std::isfinite(v) || !std::isfinite(w))
                    throw std::domain_error("planner: control returned a command that is not finite");
                out[0] = v;
                out[1] = w;
            });
        };
        interface_.control_steps = [](const void *self) {
            long steps = 0;
            of(const_cast<void *>(self)).guarded([&](PythonPlanner &p) {
                steps = nb::cast<long>(p.planner_.attr("rollout_steps"));
            });
            return steps;
        };
        interface_.failed = [](const void *self) { return bool(static_cast<const PythonPlanner *>(self)->raised_); };
    }
    PythonPlanner(const PythonPlanner &) = delete;

    planner_interface interface() const { return interface_; }

    // Throws what the call that failed has raised.
    void rethrow() {
        std::exception_ptr e;
        std::swap(e, raised_);
        std::rethrow_exception(e);
    }

  private:
    static PythonPlanner &of(void *self) { return *static_cast<PythonPlanner *>(self); }

    template <typename T>
    static nb::object copied(const T *from, size_t n) {
        T *values = new T[n];
        std::copy(from, from + n, values);
        nb::capsule owner(values, [](void *p) noexcept { delete[] static_cast<T *>(p); });
        return nb::cast(nb::ndarray<nb::numpy, T>(values, {n}, owner));
    }

    template <typename Call>
    void guarded(Call call) noexcept {
        if (raised_) return;
        nb::gil_scoped_acquire locked;
        try {
            call(*this);
        } catch (...) {
            raised_ = std::current_exception();
        }
    }

    nb::object planner_;
    planner_interface interface_{};
    std::exception_ptr raised_;
};
}  // namespace appl
