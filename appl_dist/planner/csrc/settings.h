// What the planner is told: fixed settings (the Jackal's yaml files) and the parameters APPL moves.
// One list, so that the binding and Python cannot disagree about a field.
#pragma once
#include <stdbool.h>

// clang-format off
// Names and units as documented in planner/planner_settings.py, PlannerSettings.
#define PLANNER_SETTINGS(X)                                                                                   \
    X(acc_lim_x) X(acc_lim_theta) X(min_vel_x) X(min_in_place_vel_theta) X(max_rotational_vel) X(escape_vel)  \
    X(xy_goal_tolerance) X(yaw_goal_tolerance) X(rot_stopped_velocity) X(trans_stopped_velocity)              \
    X(sim_time) X(sim_granularity) X(angular_sim_granularity) X(controller_frequency)                         \
    X(heading_lookahead) X(oscillation_reset_dist) X(escape_reset_dist) X(escape_reset_theta)                 \
    X(meter_scoring) X(cost_scaling_factor)                                                                   \
    X(half_length_m) X(half_width_m) X(footprint_padding)                                                     \
    X(local_size_m) X(global_size_m) X(global_origin_m) X(resolution_m)                                       \
    X(obstacle_range) X(raytrace_range)                                                                       \
    X(controller_patience) X(planner_patience)                                                                \
    X(rotate_max_vel_theta) X(rotate_granularity_rad)
// clang-format on

typedef struct {
#define FIELD(name) double name;
    PLANNER_SETTINGS(FIELD)
#undef FIELD
    double beams, laser_x_m, angle_max_rad;  // spec.LaserGeometry
} planner_settings;

// Order of planner/dwa.py, DWA. Sample counts are whole numbers; max_vel_theta holds for both directions.
typedef struct {
    double max_vel_x, max_vel_theta;  // m/s, rad/s
    double vx_samples, vtheta_samples;
    double occdist_scale, pdist_scale, gdist_scale;
    double inflation_radius;  // m
} planner_parameters;

enum {
    PLANNER_PARAMETERS = sizeof(planner_parameters) / sizeof(double),  // how many there are
    SAMPLES_MAX = 300,                                                 // BaseLocalPlanner.cfg
    INFLATION_CELLS_MAX = 20,                                          // 1 m at 0.05 m
    VELOCITY_MAX = 20,                                                 // BaseLocalPlanner.cfg, m/s and rad/s
};

// A field that is not what it may be.
typedef struct {
    const char *name;
    double value, low, high;
} planner_limit;
