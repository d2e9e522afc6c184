// Traction of a skid-steered robot on flat ground.
//
// The wheels are ideal velocity motors (no effort limit in the URDF): after the acceleration limits of
// diff_drive_controller they turn exactly as commanded, and all lag and slip is tyre friction. Each wheel touches the
// ground at the two edges of its tread. Every 1 ms the friction impulses are found that bring the contact points to
// rest against the turning treads, each bounded by +-mu N dt along the two WORLD axes: without a usable fdir1, ODE
// builds its friction pyramid from the contact normal alone. Hence the robot turns faster along the world axes than
// across them. Projected Gauss-Seidel, as in ODE's quickstep, started from the last step's impulses.
// Normal forces are those of a rigid robot in quasi-static balance, so braking and turning shift them.
#include "tyres.h"

#include <math.h>
#include <string.h>

#include "geometry.h"
#include "trig.h"

#define STEP_S 0.001
#define MAX_SWEEPS 50
#define TOLERANCE 1e-7  // m/s: largest velocity change of a sweep at which the solution counts as found
#define ODOMETRY_MS 20
#define IDEAL_MS 10

static double clamp(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

void vehicle_reset(const vehicle_spec *spec, vehicle_state *state, const double pose[3], uint64_t seed) {
    memset(state, 0, sizeof *state);
    state->x = state->odom_x = pose[0];
    state->y = state->odom_y = pose[1];
    state->yaw = pose[2];
    state->seed = seed;
    state->command_age_ms = spec->timeout_ms;  // nothing received yet
    state->ground_force = spec->mass * GRAVITY;
}

void vehicle_command(vehicle_state *state, double v, double w, int64_t age_ms) {
    state->command_v = v;
    state->command_w = w;
    state->command_age_ms = age_ms;
}

// One update of diff_drive_controller: time-out, then velocity and acceleration limits.
static void turn_wheels(const vehicle_spec *spec, vehicle_state *state, double dt) {
    const int stale = state->command_age_ms >= spec->timeout_ms;
    const double v = stale ? 0.0 : clamp(state->command_v, -spec->max_v, spec->max_v);
    const double w = stale ? 0.0 : clamp(state->command_w, -spec->max_w, spec->max_w);
    const double dv = spec->max_accel * dt;
    const double dw = spec->max_alpha * dt;
    state->wheel_v = clamp(v, state->wheel_v - dv, state->wheel_v + dv);
    state->wheel_w = clamp(w, state->wheel_w - dw, state->wheel_w + dw);
}

// What does not change while the robot drives; contacts in base_link.
typedef struct {
    double inverse_mass, inverse_inertia;
    double x[CONTACTS], y[CONTACTS], xx, yy;  // m; sums of squares, m^2
    double from_com_x[CONTACTS], from_com_y[CONTACTS];
} stance;

static stance stand(const vehicle_spec *spec) {
    stance k = {.inverse_mass = 1.0 / spec->mass, .inverse_inertia = 1.0 / spec->inertia_z};
    for (int i = 0; i < CONTACTS; ++i) {
        k.x[i] = i & 2 ? spec->wheel_x : -spec->wheel_x;
        k.y[i] = (i & 1 ? 1.0 : -1.0) * spec->wheel_y + (i & 4 ? spec->wheel_half_width : -spec->wheel_half_width);
        k.from_com_x[i] = k.x[i] - spec->com_x;
        k.from_com_y[i] = k.y[i] - spec->com_y;
        k.xx += k.x[i] * k.x[i];
        k.yy += k.y[i] * k.y[i];
    }
    return k;
}

// Largest friction impulse of each contact, mu N dt. Contacts lie symmetrically about base_link, so the least-norm
// loads N = a + b x + c y that balance weight and tyre force have a closed form.
static void load_contacts(const vehicle_spec *spec, const stance *k, const vehicle_state *state, double c, double s,
                          double *limit) {
    const double weight = state->ground_force;
    const double forward = c * state->force_x + s * state->force_y;
    const double left = c * state->force_y - s * state->force_x;
    const double b = (spec->com_x * weight - spec->com_z * forward) / k->xx;
    const double d = (spec->com_y * weight - spec->com_z * left) / k->yy;
    for (int i = 0; i < CONTACTS; ++i) {
        const double load = weight / CONTACTS + b * k->x[i] + d * k->y[i];
        limit[i] = load > 0.0 ? spec->friction * load * STEP_S : 0.0;
    }
}

// c, s: cos and sin of the yaw.
static void solve_friction(const vehicle_spec *spec, const stance *k, vehicle_state *state, double c, double s) {
    const double inverse_mass = k->inverse_mass;
    const double inverse_inertia = k->inverse_inertia;
    double arm_x[CONTACTS], arm_y[CONTACTS], scale_x[CONTACTS], scale_y[CONTACTS], limit[CONTACTS];
    double impulse_x[CONTACTS], impulse_y[CONTACTS], target[2][2];
    for (int i = 0; i < CONTACTS; ++i) {
        arm_x[i] = c * k->from_com_x[i] - s * k->from_com_y[i];
        arm_y[i] = s * k->from_com_x[i] + c * k->from_com_y[i];
        scale_x[i] = 1.0 / (inverse_mass + arm_y[i] * arm_y[i] * inverse_inertia);
        scale_y[i] = 1.0 / (inverse_mass + arm_x[i] * arm_x[i] * inverse_inertia);
    }
    for (int left = 0; left < 2; ++left) {
        const double side = left ? 1.0 : -1.0;
        const double tread = state->wheel_v - side * state->wheel_w * 0.5 * spec->separation;
        target[left][0] = tread * c;
        target[left][1] = tread * s;
    }
    load_contacts(spec, k, state, c, s, limit);

    double vx = state->vx;
    double vy = state->vy;
    double w = state->w;
    for (int i = 0; i < CONTACTS; ++i) {
        impulse_x[i] = clamp(state->impulse[i][0], -limit[i], limit[i]);
        impulse_y[i] = clamp(state->impulse[i][1], -limit[i], limit[i]);
        vx += impulse_x[i] * inverse_mass;
        vy += impulse_y[i] * inverse_mass;
        w += (arm_x[i] * impulse_y[i] - arm_y[i] * impulse_x[i]) * inverse_inertia;
    }
    for (int sweep = 0; sweep < MAX_SWEEPS; ++sweep) {
        double change = 0.0;
        for (int i = 0; i < CONTACTS; ++i) {
            const double slip_x = target[i & 1][0] - (vx - w * arm_y[i]);
            const double x = clamp(impulse_x[i] + slip_x * scale_x[i], -limit[i], limit[i]);
            const double dx = x - impulse_x[i];
            impulse_x[i] = x;
            vx += dx * inverse_mass;
            w -= dx * arm_y[i] * inverse_inertia;
            const double slip_y = target[i & 1][1] - (vy + w * arm_x[i]);
            const double y = clamp(impulse_y[i] + slip_y * scale_y[i], -limit[i], limit[i]);
            const double dy = y - impulse_y[i];
            impulse_y[i] = y;
            vy += dy * inverse_mass;
            w += dy * arm_x[i] * inverse_inertia;
            const double largest = fmax(fabs(dx), fabs(dy)) * inverse_mass;
            if (largest > change) change = largest;
        }
        if (change < TOLERANCE) break;
    }
    for (int i = 0; i < CONTACTS; ++i) {
        state->impulse[i][0] = impulse_x[i];
        state->impulse[i][1] = impulse_y[i];
    }
    state->force_x = spec->mass * (vx - state->vx) / STEP_S;
    state->force_y = spec->mass * (vy - state->vy) / STEP_S;
    state->vx = vx;
    state->vy = vy;
    state->w = w;
}

// c, s: cos and sin of the yaw, before and after.
static void move(const vehicle_spec *spec, vehicle_state *state, double *c, double *s) {
    // Semi-implicit: the centre of mass moves along the new velocity, base_link follows rigidly.
    const double c0 = *c;
    const double s0 = *s;
    state->yaw += state->w * STEP_S;
    trig_sincos(state->yaw, s, c);
    const double c1 = *c;
    const double s1 = *s;
    const double dx = state->vx * STEP_S + (c0 - c1) * spec->com_x - (s0 - s1) * spec->com_y;
    const double dy = state->vy * STEP_S + (s0 - s1) * spec->com_x + (c0 - c1) * spec->com_y;
    state->x += dx;
    state->y += dy;
    state->distance += sqrt(dx * dx + dy * dy);
    state->odom_x += state->wheel_v * c1 * STEP_S;
    state->odom_y += state->wheel_v * s1 * STEP_S;
}

// robot_localization in its steady state: wheel speed half trusted; the IMU's yaw rate almost, its heading fully
// (process noise 0.06 rad^2/s against its 2.5e-5 rad^2), so that the heading's white noise is published.
static void filter_odometry(const vehicle_spec *spec, vehicle_state *state) {
    const uint64_t key = counter_key(state->seed, (uint64_t)state->time_ms);
    const double noise = spec->odom_noise_w * counter_normal(key, UINT64_C(1) << 32);
    state->odom_yaw_error = spec->odom_noise_yaw * counter_normal(key, (UINT64_C(1) << 32) + 1);
    state->odom_v += spec->odom_gain_v * (state->wheel_v - state->odom_v);
    state->odom_w += spec->odom_gain_w * (state->w + noise - state->odom_w);
}

// The drive of the recorded closed-loop vectors: acceleration limits, then up to 10 ms along the midpoint heading.
// Its sine and cosine are libm's, as when they were recorded.
static void ideal_step(const vehicle_spec *spec, vehicle_state *state, int ms) {
    const double dt = STEP_S * ms;
    turn_wheels(spec, state, dt);
    const double v = state->wheel_v;
    const double w = state->wheel_w;
    const double heading = state->yaw + 0.5 * w * dt;
    state->x += v * cos(heading) * dt;
    state->y += v * sin(heading) * dt;
    state->yaw += w * dt;
    state->odom_x = state->x;
    state->odom_y = state->y;
    state->odom_v = v;
    state->odom_w = state->w = w;
    state->distance += fabs(v) * dt;
    state->vx = v * cos(state->yaw) - w * (spec->com_x * sin(state->yaw) + spec->com_y * cos(state->yaw));
    state->vy = v * sin(state->yaw) + w * (spec->com_x * cos(state->yaw) - spec->com_y * sin(state->yaw));
}

void vehicle_advance(const vehicle_spec *spec, vehicle_state *state, int ms) {
    const stance k = stand(spec);
    double c, s;
    trig_sincos(state->yaw, &s, &c);
    while (ms > 0) {
        const int step = spec->ideal ? (ms < IDEAL_MS ? ms : IDEAL_MS) : 1;
        if (spec->ideal) {
            ideal_step(spec, state, step);
        } else {
            turn_wheels(spec, state, STEP_S);
            solve_friction(spec, &k, state, c, s);
            move(spec, state, &c, &s);
        }
        state->time_ms += step;
        state->command_age_ms += step;
        if (!spec->ideal && state->time_ms % ODOMETRY_MS == 0) filter_odometry(spec, state);
        ms -= step;
    }
}

void vehicle_body_velocity(const vehicle_spec *spec, const vehicle_state *state, double *forward, double *left) {
    double c, s;
    trig_sincos(state->yaw, &s, &c);
    *forward = c * state->vx + s * state->vy + state->w * spec->com_y;
    *left = c * state->vy - s * state->vx - state->w * spec->com_x;
}
