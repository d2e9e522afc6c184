// Planar dynamics of a skid-steered robot whose tyres slide with Coulomb friction, as Gazebo's ODE computes it.
#pragma once
#include <stdint.h>

#define CONTACTS 8  // two edges of four wheels
#define GRAVITY 9.8

typedef struct {
    double mass, inertia_z;      // kg, kg m^2 about the centre of mass
    double com_x, com_y, com_z;  // of the whole robot, x y in base_link, z above ground
    double wheel_x, wheel_y;     // half wheelbase, half track
    double wheel_half_width, wheel_radius;
    double chassis_x, chassis_y;  // half length and half width of the collision box
    double hull_radius;           // no point of chassis and wheels is farther from base_link
    double friction;              // per world axis: a pyramid, not a cone
    double separation;            // effective track of the wheel command, track * 1.5
    double max_v, max_w;          // command limits of diff_drive_controller
    double max_accel, max_alpha;
    int64_t timeout_ms;                             // commands older than this count as zero
    int ideal;                                      // no tyres: the robot does what the wheels say
    double odom_gain_v, odom_gain_w, odom_noise_w;  // filtered twist, updated every 20 ms
    double odom_noise_yaw;                          // of the published heading, drawn anew every 20 ms
} vehicle_spec;

typedef struct {
    int64_t time_ms;
    double x, y, yaw;         // base_link, world frame
    double vx, vy, w;         // velocity of the centre of mass, world frame; yaw rate
    double wheel_v, wheel_w;  // command after the limits: what the wheels turn at
    double command_v, command_w;
    int64_t command_age_ms;
    double force_x, force_y;      // tyre force of the last step, world frame, for the load transfer
    double impulse[CONTACTS][2];  // of the last step, world frame: start of the next solution
    double ground_force;          // N, what the wheels stand on the ground with: the weight, less when lifted
    double odom_x, odom_y;        // integral of the wheel speed along the true yaw
    double odom_v, odom_w;
    double odom_yaw_error;  // published heading less the true one
    double distance;        // driven by base_link
    uint64_t seed;
} vehicle_state;

void vehicle_reset(const vehicle_spec *spec, vehicle_state *state, const double pose[3], uint64_t seed);
void vehicle_command(vehicle_state *state, double v, double w, int64_t age_ms);
// Advance by `ms` steps of 1 ms in free space.
void vehicle_advance(const vehicle_spec *spec, vehicle_state *state, int ms);
// Velocity of base_link in its own frame: forward, left.
void vehicle_body_velocity(const vehicle_spec *spec, const vehicle_state *state, double *forward, double *left);
