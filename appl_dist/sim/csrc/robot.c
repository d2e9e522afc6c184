#include "robot.h"

#include <math.h>

#include "geometry.h"
#include "trig.h"

#define NEAR_M 0.02                     // bullet's contacts begin to act at this distance
#define HARDEST_N 400.0                 // twice the weight: more is a jolt of one step
enum { AHEAD_MS = 20, GLIDE_MS = 20 };  // how far ahead the way is checked; how often the ideal drive is checked

void robot_reset(robot *r, const double pose[3], uint64_t seed) {
    vehicle_reset(&r->spec, &r->state, pose, seed);
    r->before = r->state;
    r->landed = 1;
    r->held = r->in_collision = r->collided = r->rolled_over = 0;
}

double robot_clearance(const robot *r, double limit) {
    const double pose[3] = {r->state.x, r->state.y, r->state.yaw};
    return hull_clearance(&r->spec, pose, r->cylinders, r->count, limit);
}

static int is_free(const robot *r, int ms) {
    const double speed =
        sqrt(r->state.vx * r->state.vx + r->state.vy * r->state.vy) + fabs(r->state.w) * r->spec.hull_radius;
    // Tyres give at most sqrt(2) mu g of acceleration; 15 m/s^2 bounds that with the hull's swing.
    const double time = 1e-3 * ms;
    const double reach = (speed + 0.5 * 15.0 * time) * time + NEAR_M;
    return robot_clearance(r, reach) >= reach;
}

static int glide(robot *r, int ms) {
    for (int done = 0; done < ms;) {
        const int step = ms - done < GLIDE_MS ? ms - done : GLIDE_MS;
        vehicle_advance(&r->spec, &r->state, step);
        r->in_collision = robot_clearance(r, 1.0) <= 0.0;
        r->collided |= r->in_collision;
        done += step;
    }
    return ms;
}

// The way is checked 20 ms ahead and, where that is too far to be sure, as far as one step with contacts.
int robot_drive(robot *r, int ms) {
    if (r->spec.ideal) return glide(r, ms);
    if (r->held) return 0;
    r->state.ground_force = r->spec.mass * GRAVITY;
    int done = 0;
    while (done < ms) {
        int step = ms - done < AHEAD_MS ? ms - done : AHEAD_MS;
        if (!is_free(r, step)) {
            step = step < CONTACT_MS ? step : CONTACT_MS;
            if (!is_free(r, step)) break;
        }
        vehicle_advance(&r->spec, &r->state, step);
        done += step;
    }
    r->landed |= done > 0;
    return done;
}

robot_velocity robot_predict(robot *r, int ms) {
    r->before = r->state;
    vehicle_advance(&r->spec, &r->state, ms);
    const double per_s = 1e3 / ms;
    return (robot_velocity){(r->state.x - r->before.x) * per_s, (r->state.y - r->before.y) * per_s,
                            (r->state.yaw - r->before.yaw) * per_s};
}

void robot_resolve(robot *r, const robot_contact *k) {
    r->landed = 0;
    r->held = k->held;
    r->in_collision = k->touching;
    r->collided |= k->touching;
    r->rolled_over |= k->rolled_over;
    if (!k->held) return;
    vehicle_state *state = &r->state;
    const double dx = k->x - r->before.x;
    const double dy = k->y - r->before.y;
    state->distance = r->before.distance + sqrt(dx * dx + dy * dy);
    state->x = k->x;
    state->y = k->y;
    state->yaw = k->yaw;
    double c, s;
    trig_sincos(k->yaw, &s, &c);
    state->vx += k->dvx - k->dw * (s * r->spec.com_x + c * r->spec.com_y);
    state->vy += k->dvy + k->dw * (c * r->spec.com_x - s * r->spec.com_y);
    state->w += k->dw;
    state->ground_force = k->ground_force < HARDEST_N ? k->ground_force : HARDEST_N;
}
