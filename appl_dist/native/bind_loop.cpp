// Loop: robot, lidar and planner coupled by the event model; owns the scan and the trial's samples.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <cmath>
#include <memory>
#include <vector>

#include "check.h"
#include "python_planner.h"

extern "C" {
#include "loop.h"
}

namespace nb = nanobind;
using Triple = std::tuple<double, double, double>;

namespace {
template <typename T>
T *core_of(nb::handle owner, const char *name) {
    nb::capsule core = nb::cast<nb::capsule>(owner.attr("core")());
    return static_cast<T *>(core.data(name));
}

trial_rules rules_of(nb::handle from) {
    trial_rules r{};
    const auto number = [&](const char *name) { return nb::cast<double>(nb::float_(from.attr(name))); };
    r.goal_x = number("goal_x_m");
    r.goal_y = number("goal_y_m");
    r.success_y = number("success_y_m");
    r.goal_radius = number("goal_radius_m");
    r.limit_s = number("limit_s");
    r.idle_limit_s = number("idle_limit_s");
    r.clock_starts_after = number("clock_starts_after_m");
    r.collision_ends = nb::cast<bool>(from.attr("collision_ends"));
    return r;
}

class Loop {
  public:
    Loop(nb::object robot_, nb::object lidar_, nb::object planner, double lidar_x_m, nb::handle timing)
        : parts_{robot_, lidar_, planner}, l_(new navigation_loop{}) {
        l_->body = core_of<robot>(robot_, "robot");
        l_->sensor = core_of<lidar>(lidar_, "lidar");
        if (nb::hasattr(planner, "core")) {
            l_->planner = *core_of<planner_interface>(planner, "planner");
        } else {
            python_ = std::make_unique<appl::PythonPlanner>(planner, static_cast<int>(l_->sensor->spec.beams));
            l_->planner = python_->interface();
        }
        l_->lidar_x = lidar_x_m;
        if (l_->sensor->spec.beams != static_cast<size_t>(l_->planner.beams))
            throw nb::value_error("lidar.beams: the planner expects as many as the lidar has");
        ranges_.resize(l_->sensor->spec.beams);
        l_->ranges = ranges_.data();
        loop_timing &t = l_->timing;
        // clang-format off
#define READ(name) t.name = nb::cast<decltype(t.name)>(timing.attr(#name));
        READ(scan_period_ms) READ(scan_delay_ms) READ(odometry_delay_ms) READ(command_delay_ms)
        READ(local_map_period_ms) READ(global_map_period_ms) READ(plan_period_ms) READ(control_period_ms)
        READ(cpu_factor) READ(control_base_ms) READ(control_us_per_step) READ(plan_ms)
#undef READ
        // clang-format on
    }

    // Phases in ms: local map, global map, plan, control, odometry filter.
    void reset(const std::pair<double, double> &origin, const appl::Array &phases, nb::handle rules) {
        const int64_t *p = appl::checked<const int64_t>(phases, "phases", {5});
        const loop_phases of = {int(p[0]), int(p[1]), int(p[2]), int(p[3]), int(p[4])};
        const double at[2] = {origin.first, origin.second};
        const trial_rules followed = rules_of(rules);
        samples_.clear();
        make_room(0);
        loop_reset(l_.get(), at, &of);
        trial_start(&l_->test, &followed, l_->body);
    }

    int run(int64_t end_ms, bool watched) {
        l_->watched = watched;
        make_room(end_ms - l_->now_ms);
        loop_pause pause;
        {
            nb::gil_scoped_release unlocked;
            pause = loop_run(l_.get(), end_ms);
        }
        if (pause == LOOP_FAILED) python_->rethrow();
        return pause;
    }
    void stepped(int ms) { l_->now_ms += ms; }

    int contact_ms() const { return l_->contact_ms; }
    int64_t now_ms() const { return l_->now_ms; }
    std::tuple<Triple, std::pair<double, double>> estimate() const {
        const loop_stamp &e = l_->estimate;
        return {triple(e.pose_odom), {e.twist[0], e.twist[1]}};
    }
    std::tuple<Triple, int64_t> newest() const { return {triple(l_->newest.pose), l_->newest.time_ms}; }
    bool success() const { return l_->test.success; }
    bool failed() const { return trial_failed(&l_->test, l_->body); }
    bool timed_out() const { return trial_timed_out(&l_->test, l_->now_ms); }
    double time_s() const { return trial_time_s(&l_->test, l_->now_ms); }
    int collisions() const { return l_->test.collisions ? l_->test.collisions : l_->body->collided; }
    double min_clearance() const { return l_->test.min_clearance; }
    nb::object samples() const {
        const size_t rows = l_->test.count;
        auto *copy = new std::vector<double>(samples_.begin(), samples_.begin() + long(rows * TRIAL_COLUMNS));
        nb::capsule owner(copy, [](void *p) noexcept { delete static_cast<std::vector<double> *>(p); });
        return nb::cast(nb::ndarray<nb::numpy, double>(copy->data(), {rows, size_t(TRIAL_COLUMNS)}, owner));
    }
    nb::dict stages() const {
        static const char *const names[STAGES] = {"physics",    "lidar",       "local map",
                                                  "global map", "global plan", "local planner"};
        nb::dict d;
        for (int i = 0; i < STAGES; ++i) d[names[i]] = std::make_pair(l_->seconds[i], l_->calls[i]);
        return d;
    }

  private:
    static Triple triple(const double *p) { return {p[0], p[1], p[2]}; }

    void make_room(int64_t ms) {
        const size_t more = size_t(ms > 0 ? ms / l_->timing.scan_period_ms : 0) + 3;
        samples_.resize((l_->test.count + more) * TRIAL_COLUMNS);
        l_->test.samples = samples_.data();
        l_->test.capacity = samples_.size() / TRIAL_COLUMNS;
    }

    std::vector<nb::object> parts_;  // kept alive
    std::unique_ptr<navigation_loop> l_;
    std::vector<float> ranges_;
    std::vector<double> samples_;
    std::unique_ptr<appl::PythonPlanner> python_;
};

class Rate {
  public:
    Rate(int period_ms, int phase_ms) { rate_start(&r_, period_ms, phase_ms); }
    void wait(int64_t until_ms) { rate_wait(&r_, until_ms); }
    void finish(int64_t now_ms) { rate_finish(&r_, now_ms); }
    int64_t due_ms() const { return r_.due; }

  private:
    rate r_;
};
}  // namespace

void bind_loop(nb::module_ &m) {
    nb::class_<Loop>(m, "Loop", "See loop.h; run() ends with one of LOOP_*.")
        .def(nb::init<nb::object, nb::object, nb::object, double, nb::handle>(), nb::arg("robot"), nb::arg("lidar"),
             nb::arg("planner"), nb::arg("lidar_x_m"), nb::arg("timing"))
        .def("reset", &Loop::reset, nb::arg("origin"), nb::arg("phases"), nb::arg("rules"))
        .def("run", &Loop::run, nb::arg("end_ms"), nb::arg("watched"))
        .def("stepped", &Loop::stepped, nb::arg("ms"))
        .def("samples", &Loop::samples)
        .def("stages", &Loop::stages)
        .def_prop_ro("contact_ms", &Loop::contact_ms)
        .def_prop_ro("now_ms", &Loop::now_ms)
        .def_prop_ro("estimate", &Loop::estimate)
        .def_prop_ro("newest", &Loop::newest)
        .def_prop_ro("success", &Loop::success)
        .def_prop_ro("failed", &Loop::failed)
        .def_prop_ro("timed_out", &Loop::timed_out)
        .def_prop_ro("time_s", &Loop::time_s)
        .def_prop_ro("collisions", &Loop::collisions)
        .def_prop_ro("min_clearance_m", &Loop::min_clearance);
    m.attr("LOOP_ENDED") = int(LOOP_ENDED);
    m.attr("LOOP_OVER") = int(LOOP_OVER);
    m.attr("LOOP_CONTACT") = int(LOOP_CONTACT);
    m.attr("LOOP_SAMPLED") = int(LOOP_SAMPLED);
    m.attr("LOOP_BROKEN") = int(LOOP_BROKEN);

    nb::class_<Rate>(m, "Rate", "ros::Rate in whole ms, as the loop uses it; for tests.")
        .def(nb::init<int, int>(), nb::arg("period_ms"), nb::arg("phase_ms"))
        .def("wait", &Rate::wait)
        .def("finish", &Rate::finish)
        .def_prop_ro("due_ms", &Rate::due_ms);
}
