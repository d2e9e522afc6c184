// Planner: checks arguments, owns the memory of one navigator, turns C arrays into numpy ones.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "check.h"

extern "C" {
#include "navigator.h"
}

namespace nb = nanobind;
using appl::Array;
using appl::checked;

namespace {

template <typename T>
nb::object owned(std::vector<T> values, std::initializer_list<size_t> shape) {
    auto *keep = new std::vector<T>(std::move(values));
    nb::capsule owner(keep, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(keep->data(), shape, owner));
}

[[noreturn]] void refuse(const planner_limit &bad) {
    char text[160];
    std::snprintf(text, sizeof text, "%s: got %g; allowed %g..%g", bad.name, bad.value, bad.low, bad.high);
    throw nb::value_error(text);
}

planner_settings settings_of(nb::handle from, nb::handle laser) {
    planner_settings s;
#define READ(name) s.name = nb::cast<double>(nb::float_(from.attr(#name)));
    PLANNER_SETTINGS(READ)
#undef READ
    s.beams = nb::cast<double>(nb::float_(laser.attr("beams")));
    s.laser_x_m = nb::cast<double>(nb::float_(laser.attr("mount_x_m")));
    s.angle_max_rad = nb::cast<double>(nb::float_(laser.attr("angle_max_rad")));
    planner_limit bad;
    if (!navigator_check_settings(&s, &bad)) refuse(bad);
    return s;
}

bool is_fast(nb::handle settings) {
    const std::string name = nb::cast<std::string>(nb::str(settings.attr("arithmetic")));
    if (name != "exact" && name != "fast")
        throw nb::value_error(("arithmetic: got " + name + "; allowed exact, fast").c_str());
    return name == "fast";
}

planner_parameters parameters_of(const Array &values, const planner_settings &set) {
    const double *v = checked<const double>(values, "values", {PLANNER_PARAMETERS});
    planner_parameters p;
    std::memcpy(&p, v, sizeof p);
    planner_limit bad;
    if (!navigator_check_parameters(&set, &p, &bad)) refuse(bad);
    return p;
}

class Planner {
  public:
    Planner(const Planner &) = delete;
    Planner(nb::handle settings, nb::handle laser, const Array &parameters) {
        const planner_settings set = settings_of(settings, laser);
        const planner_parameters par = parameters_of(parameters, set);
        bytes_ = navigator_bytes(&set);
        memory_.reset(static_cast<char *>(std::calloc(1, bytes_ + 64)));
        if (!memory_) throw std::bad_alloc();
        char *aligned = memory_.get() + (64 - reinterpret_cast<uintptr_t>(memory_.get()) % 64) % 64;
        n_ = navigator_init(aligned, &set, &par, is_fast(settings));
        interface_ = navigator_interface(n_);
    }

    void reset(const Array &goal) {
        const double *g = finite(goal, "goal", 3);
        navigator_reset(n_, g);
    }
    void set_parameters(const Array &values) {
        const planner_parameters p = parameters_of(values, n_->set);
        navigator_set_parameters(n_, &p);
    }
    void add_scan(const Array &ranges, const Array &pose) {
        const float *r = checked<const float>(ranges, "ranges", {static_cast<long>(n_->set.beams)});
        const double *p = finite(pose, "pose", 3);
        nb::gil_scoped_release unlocked;
        navigator_add_scan(n_, r, p);
    }
    void update_local(const Array &pose) {
        const double *p = finite(pose, "pose", 3);
        nb::gil_scoped_release unlocked;
        navigator_update_local(n_, p);
    }
    void update_global(const Array &pose) {
        const double *p = finite(pose, "pose", 3);
        nb::gil_scoped_release unlocked;
        navigator_update_global(n_, p);
    }
    bool plan(const Array &pose, double now) {
        const double *p = finite(pose, "pose", 3);
        nb::gil_scoped_release unlocked;
        return navigator_plan(n_, p, now);
    }
    nb::object control(const Array &pose, const Array &twist, double now) {
        const double *p = finite(pose, "pose", 3);
        const double *t = finite(twist, "twist", 2);
        std::vector<double> out(2);
        {
            nb::gil_scoped_release unlocked;
            navigator_control(n_, p, t, finite(now), out.data());
        }
        return owned(std::move(out), {2});
    }
    nb::object cycle(const Array &ranges, const Array &pose, const Array &twist, double now) {
        const float *r = checked<const float>(ranges, "ranges", {static_cast<long>(n_->set.beams)});
        const double *p = finite(pose, "pose", 3);
        const double *t = finite(twist, "twist", 2);
        std::vector<double> out(2);
        {
            nb::gil_scoped_release unlocked;
            navigator_cycle(n_, r, p, t, finite(now), out.data());
        }
        return owned(std::move(out), {2});
    }
    double bearing(const Array &pose, double lookahead) const {
        return navigator_bearing(n_, finite(pose, "pose", 3), lookahead);
    }

    // Parts on their own, for tests and conformance.
    void load_map(bool local, const Array &cost, double ox, double oy) {
        costmap &m = local ? n_->local : n_->global;
        const uint8_t *c = checked<const uint8_t>(cost, "cost", {m.frame.h, m.frame.w});
        const size_t cells = static_cast<size_t>(m.frame.w) * m.frame.h;
        m.frame.ox = ox;
        m.frame.oy = oy;
        for (size_t i = 0; i < cells; ++i) m.obstacles[i] = c[i] == COST_LETHAL ? COST_LETHAL : COST_FREE;
        std::copy(c, c + cells, m.master);
        m.exact = {0, 0, 0, 0};
        if (!local) navfn_sync(&n_->plan, m.master, {0, 0, m.frame.w, m.frame.h});
    }
    void inflate(bool local) {
        costmap &m = local ? n_->local : n_->global;
        m.exact = {0, 0, 0, 0};
        inflation_run(&m.inflate, &n_->scratch, m.master, m.frame.w, m.frame.h, 0, 0, m.frame.w, m.frame.h);
        if (!local) navfn_sync(&n_->plan, m.master, {0, 0, m.frame.w, m.frame.h});
    }
    // `whole`: the wave covers all that NavFn's covers, not only what the plan needs.
    nb::object plan_between(const Array &start, const Array &goal, bool whole) {
        const double *s = finite(start, "start", 2);
        const double *g = finite(goal, "goal", 2);
        navfn_restart(&n_->plan);
        n_->plan.whole = whole;
        costmap_mark_cleared(&n_->global, s[0], s[1]);
        navfn_plan(&n_->plan, &n_->global.frame, n_->global.master, s[0], s[1], g[0], g[1]);
        n_->plan.whole = false;
        const size_t count = static_cast<size_t>(n_->plan.plan_count);
        return owned(std::vector<double>(n_->plan.plan, n_->plan.plan + 2 * count), {count, 2});
    }
    void set_plan(const Array &plan, double end_yaw) {
        const double *p = checked<const double>(plan, "plan", {-1, 2});
        const size_t n = plan.shape(0);
        if (n > static_cast<size_t>(n_->local_plan.plan.capacity))
            throw nb::value_error(("plan: got " + std::to_string(n) + " points; at most " +
                                   std::to_string(n_->local_plan.plan.capacity) + " fit")
                                      .c_str());
        for (size_t i = 0; i < 2 * n; ++i)
            if (!(std::abs(p[i]) <= 1e4)) throw nb::value_error("plan: holds a coordinate that is not within 10 km");
        local_planner_set_plan(&n_->local_plan, p, static_cast<int>(n), end_yaw);
    }
    // computeVelocityCommands alone. With `trace` every sample is simulated to its end and reported.
    nb::tuple local_command(const Array &pose, const Array &twist, bool trace) {
        const double *p = finite(pose, "pose", 3);
        const double *t = finite(twist, "twist", 2);
        rollout_planner &r = n_->local_plan.rollouts;
        std::vector<rollout_row> rows;
        rollout_trace report = {nullptr, 0, 0};
        if (trace) {
            rows.resize(static_cast<size_t>(r.par.vx_samples * r.par.vtheta_samples + r.par.vtheta_samples) + 3);
            report = {rows.data(), static_cast<int>(rows.size()), 0};
            r.trace = &report;
        }
        std::vector<double> out(2);
        const bool ok = local_planner_command(&n_->local_plan, &n_->local.frame, n_->local.master, p, t, out.data());
        r.trace = nullptr;
        n_->valid = ok;
        const size_t count = static_cast<size_t>(report.count);
        std::vector<double> flat(count * ROLLOUT_COLUMNS);
        if (count > 0) std::memcpy(flat.data(), rows.data(), count * sizeof(rollout_row));
        return nb::make_tuple(ok, owned(std::move(out), {2}), owned(std::move(flat), {count, ROLLOUT_COLUMNS}));
    }
    nb::object wavefronts() {
        rollout_planner &r = n_->local_plan.rollouts;
        const int w = r.frame.w;
        const int h = r.frame.h;
        std::vector<int32_t> grids(2 * static_cast<size_t>(w) * h);
        for (int k = 0; k < 2; ++k)
            for (int y = 0; y < h; ++y)
                for (int x = 0; x < w; ++x)
                    grids[(static_cast<size_t>(k) * h + y) * w + x] = wavefront_ros_value(k ? &r.goal : &r.path, x, y);
        return owned(std::move(grids), {2, size_t(h), size_t(w)});
    }
    nb::object map(bool local, bool obstacles) const {
        const costmap &m = local ? n_->local : n_->global;
        const uint8_t *from = obstacles ? m.obstacles : m.master;
        const size_t w = m.frame.w;
        const size_t h = m.frame.h;
        return owned(std::vector<uint8_t>(from, from + w * h), {h, w});
    }
    nb::object origin(bool local) const {
        const grid_frame &g = (local ? n_->local : n_->global).frame;
        return owned(std::vector<double>{g.ox, g.oy}, {2});
    }
    nb::object potential() const {
        const size_t w = n_->plan.w;
        const size_t h = n_->plan.h;
        return owned(std::vector<float>(n_->plan.potential, n_->plan.potential + w * h), {h, w});
    }
    nb::object latest_plan() const {
        const size_t count = static_cast<size_t>(n_->latest_count);
        return owned(std::vector<double>(n_->latest, n_->latest + 2 * count), {count, 2});
    }
    nb::object best() const {  // (n, 3) x, y, yaw of the chosen roll-out
        const rollout *b = n_->local_plan.best;
        const size_t count = b ? static_cast<size_t>(b->points) : 0;
        std::vector<double> flat;
        for (size_t i = 0; i < count; ++i) flat.insert(flat.end(), {b->x[i], b->y[i], b->th[i]});
        return owned(std::move(flat), {count, 3});
    }
    nb::object best_sample() const {  // v, w, cost; NaN where nothing was chosen
        const rollout *b = n_->local_plan.best;
        if (!b) return owned(std::vector<double>{NAN, NAN, NAN}, {3});
        return owned(std::vector<double>{b->v, b->w, b->cost}, {3});
    }
    nb::dict status() const {
        const local_planner &l = n_->local_plan;
        const rollout_planner &r = l.rollouts;
        nb::dict d;
        d["stuck_left"] = r.stuck_left;
        d["stuck_right"] = r.stuck_right;
        d["rotating_left"] = r.rotating_left;
        d["rotating_right"] = r.rotating_right;
        d["escaping"] = r.escaping;
        d["prev_x"] = r.prev_x;
        d["prev_y"] = r.prev_y;
        d["escape_x"] = r.escape_x;
        d["escape_y"] = r.escape_y;
        d["escape_theta"] = r.escape_theta;
        d["rotating_to_goal"] = l.rotating_to_goal;
        d["reached"] = l.reached_goal;
        d["plan_left"] = l.plan.count;
        d["local_count"] = l.local_count;
        return d;
    }
    nb::tuple local_plan_ends() const {
        const local_planner &l = n_->local_plan;
        if (l.local_count == 0) return nb::make_tuple();
        const int a = l.local_first;
        const int b = a + l.local_count - 1;
        return nb::make_tuple(l.plan.x[a], l.plan.y[a], l.plan.x[b], l.plan.y[b]);
    }
    int state() const { return n_->state; }
    int recoveries() const { return n_->recoveries; }
    bool valid() const { return n_->valid; }
    long rollouts() const { return n_->local_plan.rollouts.rollouts; }
    long rollout_steps() const { return n_->local_plan.rollouts.rollout_steps; }
    long navfn_cells() const { return n_->plan.cells; }
    size_t bytes() const { return bytes_; }
    nb::capsule core() { return nb::capsule(&interface_, "planner"); }

  private:
    struct Free {
        void operator()(char *p) const { std::free(p); }
    };
    static double finite(double v) {
        if (!std::isfinite(v)) throw nb::value_error("now_s: expected a finite time");
        return v;
    }
    static const double *finite(const Array &a, const char *name, long n) {
        const double *v = checked<const double>(a, name, {n});
        for (long i = 0; i < n; ++i)
            // In float32: the planner of ROS reads poses and velocities in that precision.
            if (!std::isfinite(static_cast<float>(v[i])))
                throw nb::value_error((std::string(name) + ": holds a value that is not finite").c_str());
        return v;
    }
    std::unique_ptr<char, Free> memory_;
    size_t bytes_ = 0;
    navigator *n_ = nullptr;
    planner_interface interface_{};
};

}  // namespace

void bind_planner(nb::module_ &m) {
    nb::list names;
#define NAME(name) names.append(#name);
    PLANNER_SETTINGS(NAME)
#undef NAME
    m.attr("PLANNER_SETTINGS") = nb::tuple(names);
    nb::class_<Planner>(m, "Planner")
        .def(nb::init<nb::handle, nb::handle, const Array &>(), nb::arg("settings"), nb::arg("laser"),
             nb::arg("parameters"))
        .def("reset", &Planner::reset)
        .def("set_parameters", &Planner::set_parameters)
        .def("add_scan", &Planner::add_scan)
        .def("update_local", &Planner::update_local)
        .def("update_global", &Planner::update_global)
        .def("plan", &Planner::plan)
        .def("control", &Planner::control)
        .def("cycle", &Planner::cycle)
        .def("core", &Planner::core)
        .def("bearing", &Planner::bearing)
        .def("load_map", &Planner::load_map)
        .def("inflate", &Planner::inflate)
        .def("plan_between", &Planner::plan_between)
        .def("set_plan", &Planner::set_plan)
        .def("local_command", &Planner::local_command)
        .def("wavefronts", &Planner::wavefronts)
        .def("map", &Planner::map)
        .def("origin", &Planner::origin)
        .def("potential", &Planner::potential)
        .def("latest_plan", &Planner::latest_plan)
        .def("best", &Planner::best)
        .def("best_sample", &Planner::best_sample)
        .def("status", &Planner::status)
        .def("local_plan_ends", &Planner::local_plan_ends)
        .def_prop_ro("state", &Planner::state)
        .def_prop_ro("recoveries", &Planner::recoveries)
        .def_prop_ro("valid", &Planner::valid)
        .def_prop_ro("rollouts", &Planner::rollouts)
        .def_prop_ro("rollout_steps", &Planner::rollout_steps)
        .def_prop_ro("navfn_cells", &Planner::navfn_cells)
        .def_prop_ro("bytes", &Planner::bytes);
}
