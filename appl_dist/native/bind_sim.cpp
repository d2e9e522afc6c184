// The simulator's C core: Robot (tyre model, odometry, clearance) and Lidar.
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <tuple>
#include <vector>

#include "check.h"

extern "C" {
#include "grid_connectivity.h"
#include "geometry.h"
#include "lidar.h"
#include "robot.h"
#include "trig.h"
}

namespace nb = nanobind;
using Triple = std::tuple<double, double, double>;

namespace {
std::vector<double> copy_cylinders(const appl::Array &array) {
    if (array.ndim() == 2 && array.shape(0) == 0) return {};  // strides of nothing say nothing
    const double *data = appl::checked<const double>(array, "cylinders", {-1, 3});
    return {data, data + array.shape(0) * 3};
}

class Robot {
  public:
    explicit Robot(const vehicle_spec &spec) : r_{} { r_.spec = spec; }

    void reset(const appl::Array &pose, uint64_t seed, const appl::Array &cylinders) {
        const double *p = appl::checked<const double>(pose, "pose", {3});
        cylinders_ = copy_cylinders(cylinders);
        r_.cylinders = cylinders_.data();
        r_.count = cylinders_.size() / 3;
        robot_reset(&r_, p, seed);
    }

    void command(double v, double w, int64_t age_ms) { vehicle_command(&r_.state, v, w, age_ms); }

    int drive(int ms) {
        if (ms < 0) throw nb::value_error("drive: ms must be at least 0");
        return robot_drive(&r_, ms);
    }

    Triple predict(int ms) {
        if (ms < 1) throw nb::value_error("predict: ms must be at least 1");
        const robot_velocity v = robot_predict(&r_, ms);
        return {v.vx, v.vy, v.w};
    }

    void resolve(bool touching, bool held, bool rolled_over, double ground_force, double x, double y, double yaw,
                 double dvx, double dvy, double dw) {
        const robot_contact contact = {touching, held, rolled_over, x, y, yaw, dvx, dvy, dw, ground_force};
        robot_resolve(&r_, &contact);
    }

    double clearance(double limit) const { return robot_clearance(&r_, limit); }

    Triple twist() const {
        double forward, left;
        vehicle_body_velocity(&r_.spec, &r_.state, &forward, &left);
        return {forward, left, r_.state.w};
    }

    const vehicle_state &state() const { return r_.state; }
    const robot &body() const { return r_; }
    nb::capsule core() { return nb::capsule(&r_, "robot"); }

  private:
    robot r_;
    std::vector<double> cylinders_;
};

class Lidar {
  public:
    Lidar(size_t beams, double angle_min, double angle_max, double range_min, double range_max, double noise_sd)
        : cosines_(beams), sines_(beams),
          l_{{beams, angle_min, 0.0, range_min, range_max, noise_sd}, cosines_.data(), sines_.data()} {
        if (beams < 4 || !(angle_max > angle_min))
            throw nb::value_error("beams: a lidar has at least 4, angles rising");
        l_.spec.increment = (angle_max - angle_min) / static_cast<double>(beams - 1);
        lidar_directions(&l_.spec, cosines_.data(), sines_.data());
    }
    Lidar(const Lidar &) = delete;

    void cast(const appl::Array &pose, const appl::Array &cylinders, uint64_t seed, uint64_t stamp_ms,
              const appl::Array &ranges) const {
        const double *p = appl::checked<const double>(pose, "pose", {3});
        const size_t n = cylinders.ndim() == 2 ? cylinders.shape(0) : 0;
        const double *c = n ? appl::checked<const double>(cylinders, "cylinders", {-1, 3}) : nullptr;
        float *out = appl::checked<float>(ranges, "ranges", {static_cast<long>(l_.spec.beams)});
        nb::gil_scoped_release release;
        lidar_cast(&l_, p, c, n, seed, stamp_ms, out);
    }

    nb::capsule core() { return nb::capsule(&l_, "lidar"); }

  private:
    std::vector<double> cosines_, sines_;
    lidar l_;
};

// The first of (n, rows, cols) grids that can be crossed, its crossing region written to `region`; -1 if none can.
long first_crossing(const appl::Array &blocked, const appl::Array &region) {
    const uint8_t *grids = appl::checked<const uint8_t>(blocked, "blocked", {-1, -1, -1});
    const size_t rows = blocked.shape(1);
    const size_t cols = blocked.shape(2);
    uint8_t *out = appl::checked<uint8_t>(region, "region", {static_cast<long>(rows), static_cast<long>(cols)});
    if (rows > 127 || rows < 1 || cols < 1) throw nb::value_error("blocked: a grid has 1 to 127 rows");
    std::vector<int32_t> stack(rows * cols);
    for (size_t i = 0; i < blocked.shape(0); ++i)
        if (grid_connectivity_crossing(grids + i * rows * cols, static_cast<int>(rows), static_cast<int>(cols), out,
                                       stack.data()))
            return static_cast<long>(i);
    return -1;
}
}  // namespace

void bind_sim(nb::module_ &m) {
    m.def(
        "sine_cosine",
        [](double angle_rad) {
            double sine, cosine;
            trig_sincos(angle_rad, &sine, &cosine);
            return std::make_tuple(sine, cosine);
        },
        nb::arg("angle_rad"), "(sine, cosine) of an angle up to 1e5 rad, the same bits on every machine; see trig.h.");
    nb::class_<vehicle_spec>(m, "VehicleSpec", "Figures of a vehicle, see tyres.h; zero until set.")
        .def("__init__", [](vehicle_spec *self) { new (self) vehicle_spec{}; })
        .def_rw("mass", &vehicle_spec::mass)
        .def_rw("inertia_z", &vehicle_spec::inertia_z)
        .def_rw("com_x", &vehicle_spec::com_x)
        .def_rw("com_y", &vehicle_spec::com_y)
        .def_rw("com_z", &vehicle_spec::com_z)
        .def_rw("wheel_x", &vehicle_spec::wheel_x)
        .def_rw("wheel_y", &vehicle_spec::wheel_y)
        .def_rw("wheel_half_width", &vehicle_spec::wheel_half_width)
        .def_rw("wheel_radius", &vehicle_spec::wheel_radius)
        .def_rw("chassis_x", &vehicle_spec::chassis_x)
        .def_rw("chassis_y", &vehicle_spec::chassis_y)
        .def_rw("hull_radius", &vehicle_spec::hull_radius)
        .def_rw("friction", &vehicle_spec::friction)
        .def_rw("separation", &vehicle_spec::separation)
        .def_rw("max_v", &vehicle_spec::max_v)
        .def_rw("max_w", &vehicle_spec::max_w)
        .def_rw("max_accel", &vehicle_spec::max_accel)
        .def_rw("max_alpha", &vehicle_spec::max_alpha)
        .def_rw("timeout_ms", &vehicle_spec::timeout_ms)
        .def_rw("ideal", &vehicle_spec::ideal)
        .def_rw("odom_gain_v", &vehicle_spec::odom_gain_v)
        .def_rw("odom_gain_w", &vehicle_spec::odom_gain_w)
        .def_rw("odom_noise_w", &vehicle_spec::odom_noise_w)
        .def_rw("odom_noise_yaw", &vehicle_spec::odom_noise_yaw);

    nb::class_<Robot>(m, "Robot", "A robot's planar motion among cylinders, see robot.h and tyres.h.")
        .def(nb::init<const vehicle_spec &>(), nb::arg("spec"))
        .def("reset", &Robot::reset, nb::arg("pose"), nb::arg("seed"), nb::arg("cylinders"))
        .def("command", &Robot::command, nb::arg("v"), nb::arg("w"), nb::arg("age_ms"))
        .def("drive", &Robot::drive, nb::arg("ms"))
        .def("predict", &Robot::predict, nb::arg("ms"))
        .def("resolve", &Robot::resolve)
        .def("clearance", &Robot::clearance, nb::arg("limit_m"))
        .def("core", &Robot::core)
        .def_prop_ro("landed", [](const Robot &r) { return bool(r.body().landed); })
        .def_prop_ro("in_collision", [](const Robot &r) { return bool(r.body().in_collision); })
        .def_prop_ro("collided", [](const Robot &r) { return bool(r.body().collided); })
        .def_prop_ro("rolled_over", [](const Robot &r) { return bool(r.body().rolled_over); })
        .def_prop_ro("time_ms", [](const Robot &r) { return r.state().time_ms; })
        .def_prop_ro("distance", [](const Robot &r) { return r.state().distance; })
        .def_prop_ro("pose", [](const Robot &r) { return Triple(r.state().x, r.state().y, r.state().yaw); })
        .def_prop_ro("twist", &Robot::twist, "forward, left, yaw rate of base_link")
        .def_prop_ro("wheels", [](const Robot &r) { return std::make_tuple(r.state().wheel_v, r.state().wheel_w); })
        .def_prop_ro("odom_pose",
                     [](const Robot &r) {
                         const vehicle_state &s = r.state();
                         return Triple(s.odom_x, s.odom_y, s.yaw + s.odom_yaw_error);
                     })
        .def_prop_ro("odom_twist", [](const Robot &r) { return std::make_tuple(r.state().odom_v, r.state().odom_w); });
    m.attr("CONTACT_MS") = int(CONTACT_MS);

    m.def("first_crossing", &first_crossing, nb::arg("blocked"), nb::arg("region"));

    nb::class_<Lidar>(m, "Lidar", "A planar lidar among upright cylinders.")
        .def(nb::init<size_t, double, double, double, double, double>(), nb::arg("beams"), nb::arg("angle_min"),
             nb::arg("angle_max"), nb::arg("range_min"), nb::arg("range_max"), nb::arg("noise_sd"))
        .def("core", &Lidar::core)
        .def("cast", &Lidar::cast, nb::arg("pose"), nb::arg("cylinders"), nb::arg("seed"), nb::arg("stamp_ms"),
             nb::arg("ranges"), "One scan into ranges (beams,) float32 from the lidar's own pose (x, y, yaw).");
}
