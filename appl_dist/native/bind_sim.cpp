// The simulator's C core: Vehicle (tyre model, odometry, clearance) and Lidar.
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "check.h"

extern "C" {
#include "field.h"
#include "geometry.h"
#include "lidar.h"
#include "tyres.h"
}

namespace nb = nanobind;
using Triple = std::tuple<double, double, double>;

namespace {
std::vector<double> copy_cylinders(const appl::Array &array) {
    if (array.ndim() == 2 && array.shape(0) == 0) return {};  // strides of nothing say nothing
    const double *data = appl::checked<const double>(array, "cylinders", {-1, 3});
    return {data, data + array.shape(0) * 3};
}

class Vehicle {
  public:
    explicit Vehicle(const vehicle_spec &spec) : spec_(spec), state_{}, before_{} {}

    void reset(const appl::Array &pose, uint64_t seed, const appl::Array &cylinders) {
        const double *p = appl::checked<const double>(pose, "pose", {3});
        cylinders_ = copy_cylinders(cylinders);
        vehicle_reset(&spec_, &state_, p, seed);
    }

    void command(double v, double w, int64_t age_ms) { vehicle_command(&state_, v, w, age_ms); }

    // Advance while the hull cannot come within `margin_m` of a cylinder, by at most `ms`; returns the ms done. The
    // way is checked 20 ms ahead and, where that is too far to be sure, `least_ms`.
    int drive_free(int ms, double margin_m, int least_ms) {
        if (ms < 0 || least_ms < 1) throw nb::value_error("drive_free: ms must be at least 0 and least_ms at least 1");
        int done = 0;
        state_.ground_force = spec_.mass * 9.8;
        while (done < ms) {
            int step = spec_.ideal ? ms : std::min(ms - done, AHEAD_MS);
            if (!spec_.ideal && !is_free(step, margin_m)) {
                step = std::min(step, least_ms);
                if (!is_free(step, margin_m)) break;
            }
            vehicle_advance(&spec_, &state_, step);
            done += step;
        }
        return done;
    }

    // Predict `ms` ahead without contacts: mean velocity of base_link over that time, world frame, and mean yaw rate.
    Triple predict(int ms) {
        before_ = state_;
        vehicle_advance(&spec_, &state_, ms);
        const double per_s = 1e3 / ms;
        return {(state_.x - before_.x) * per_s, (state_.y - before_.y) * per_s, (state_.yaw - before_.yaw) * per_s};
    }

    // Grip follows what the wheels stand on the ground with: `force` N until the next free motion.
    void load(double force) { state_.ground_force = force; }

    // Replace a prediction's end by where contacts put base_link, and add the change of velocity they made.
    void correct(double x, double y, double yaw, double dvx, double dvy, double dw) {
        state_.distance = before_.distance + std::hypot(x - before_.x, y - before_.y);
        state_.x = x;
        state_.y = y;
        state_.yaw = yaw;
        const double c = std::cos(yaw), s = std::sin(yaw);
        state_.vx += dvx - dw * (s * spec_.com_x + c * spec_.com_y);
        state_.vy += dvy + dw * (c * spec_.com_x - s * spec_.com_y);
        state_.w += dw;
    }

    double clearance(double limit) const {
        const double pose[3] = {state_.x, state_.y, state_.yaw};
        return hull_clearance(pose, cylinders_.data(), cylinders_.size() / 3, limit);
    }

    Triple twist() const {
        double forward, left;
        vehicle_body_velocity(&spec_, &state_, &forward, &left);
        return {forward, left, state_.w};
    }

    const vehicle_spec &spec() const { return spec_; }
    const vehicle_state &state() const { return state_; }
    const std::vector<double> &cylinders() const { return cylinders_; }

  private:
    static constexpr int AHEAD_MS = 20;

    bool is_free(int ms, double margin_m) const {
        const double speed = std::hypot(state_.vx, state_.vy) + std::fabs(state_.w) * HULL_RADIUS_M;
        // Tyres give at most sqrt(2) mu g of acceleration; 15 m/s^2 bounds that with the hull's swing.
        const double time = 1e-3 * ms, reach = (speed + 0.5 * 15.0 * time) * time + margin_m;
        return clearance(reach) >= reach;
    }

    vehicle_spec spec_;
    vehicle_state state_, before_;
    std::vector<double> cylinders_;
};

class Lidar {
  public:
    Lidar(size_t beams, double angle_min, double angle_max, double range_min, double range_max, double noise_sd)
        : spec_{beams, angle_min, 0.0, range_min, range_max, noise_sd}, cosines_(beams), sines_(beams) {
        if (beams < 4 || !(angle_max > angle_min)) throw nb::value_error("beams: a lidar has at least 4, angles rising");
        spec_.increment = (angle_max - angle_min) / static_cast<double>(beams - 1);
        lidar_directions(&spec_, cosines_.data(), sines_.data());
    }

    void cast(const appl::Array &pose, const appl::Array &cylinders, uint64_t seed, uint64_t stamp_ms,
              const appl::Array &ranges) const {
        const double *p = appl::checked<const double>(pose, "pose", {3});
        const size_t n = cylinders.ndim() == 2 ? cylinders.shape(0) : 0;
        const double *c = n ? appl::checked<const double>(cylinders, "cylinders", {-1, 3}) : nullptr;
        float *out = appl::checked<float>(ranges, "ranges", {static_cast<long>(spec_.beams)});
        nb::gil_scoped_release release;
        lidar_cast(&spec_, cosines_.data(), sines_.data(), p, c, n, seed, stamp_ms, out);
    }

  private:
    lidar_spec spec_;
    std::vector<double> cosines_, sines_;
};

// The first of (n, rows, cols) grids that can be crossed, its crossing region written to `region`; -1 if none can.
long first_crossing(const appl::Array &blocked, const appl::Array &region) {
    const uint8_t *grids = appl::checked<const uint8_t>(blocked, "blocked", {-1, -1, -1});
    const size_t rows = blocked.shape(1), cols = blocked.shape(2);
    uint8_t *out = appl::checked<uint8_t>(region, "region", {static_cast<long>(rows), static_cast<long>(cols)});
    if (rows > 127 || rows < 1 || cols < 1) throw nb::value_error("blocked: a grid has 1 to 127 rows");
    std::vector<int32_t> stack(rows * cols);
    for (size_t i = 0; i < blocked.shape(0); ++i)
        if (field_crossing(grids + i * rows * cols, static_cast<int>(rows), static_cast<int>(cols), out, stack.data()))
            return static_cast<long>(i);
    return -1;
}
}  // namespace

void bind_sim(nb::module_ &m) {
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

    nb::class_<Vehicle>(m, "Vehicle", "A Jackal's planar motion among cylinders, advanced in steps of 1 ms.")
        .def(nb::init<const vehicle_spec &>(), nb::arg("spec"))
        .def("reset", &Vehicle::reset, nb::arg("pose"), nb::arg("seed"), nb::arg("cylinders"))
        .def("command", &Vehicle::command, nb::arg("v"), nb::arg("w"), nb::arg("age_ms"))
        .def("drive_free", &Vehicle::drive_free, nb::arg("ms"), nb::arg("margin_m"), nb::arg("least_ms") = 4)
        .def("predict", &Vehicle::predict, nb::arg("ms"))
        .def("load", &Vehicle::load, nb::arg("force"))
        .def("correct", &Vehicle::correct)
        .def("clearance", &Vehicle::clearance, nb::arg("limit_m"))
        .def_prop_ro("time_ms", [](const Vehicle &v) { return v.state().time_ms; })
        .def_prop_ro("distance", [](const Vehicle &v) { return v.state().distance; })
        .def_prop_ro("pose", [](const Vehicle &v) { return Triple(v.state().x, v.state().y, v.state().yaw); })
        .def_prop_ro("twist", &Vehicle::twist, "forward, left, yaw rate of base_link")
        .def_prop_ro("wheels", [](const Vehicle &v) { return std::make_tuple(v.state().wheel_v, v.state().wheel_w); })
        .def_prop_ro("odom_pose",
                     [](const Vehicle &v) { 
                         const vehicle_state &s = v.state();
                         return Triple(s.odom_x, s.odom_y, s.yaw + s.odom_yaw_error);
                     })
        .def_prop_ro("odom_twist",
                     [](const Vehicle &v) { return std::make_tuple(v.state().odom_v, v.state().odom_w); });

    m.def("first_crossing", &first_crossing, nb::arg("blocked"), nb::arg("region"));

    nb::class_<Lidar>(m, "Lidar", "A planar lidar among upright cylinders.")
        .def(nb::init<size_t, double, double, double, double, double>(), nb::arg("beams"), nb::arg("angle_min"),
             nb::arg("angle_max"), nb::arg("range_min"), nb::arg("range_max"), nb::arg("noise_sd"))
        .def("cast", &Lidar::cast, nb::arg("pose"), nb::arg("cylinders"), nb::arg("seed"), nb::arg("stamp_ms"),
             nb::arg("ranges"), "One scan into ranges (beams,) float32 from the lidar's own pose (x, y, yaw).");
}
