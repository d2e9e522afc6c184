#include "trial.h"

#include <math.h>

enum { APART_MS = 500 };  // contacts closer together are one collision: a body that scrapes along bounces
#define CLEARANCE_LIMIT_M 100.0

static void sample(trial *t, const robot *r, int64_t now_ms) {
    if (now_ms == t->sampled_ms) return;
    t->sampled_ms = now_ms;
    if (t->count < t->capacity) {
        double *to = t->samples + TRIAL_COLUMNS * t->count++;
        double left;
        to[0] = (double)now_ms / 1000.0;
        to[1] = r->state.x;
        to[2] = r->state.y;
        to[3] = r->state.yaw;
        vehicle_body_velocity(&r->spec, &r->state, &to[4], &left);
        to[5] = r->state.w;
    }
    t->min_clearance = robot_clearance(r, t->min_clearance);
    if (!r->in_collision) return;
    t->collisions += now_ms - t->touched_ms >= APART_MS;
    t->touched_ms = now_ms;
}

void trial_start(trial *t, const trial_rules *rules, const robot *r) {
    t->rules = *rules;
    t->start_x = r->state.x;
    t->start_y = r->state.y;
    t->clock_start_ms = rules->clock_starts_after > 0 ? -1 : 0;
    t->sampled_ms = -1;
    t->touched_ms = -APART_MS;
    t->success = t->over = t->collisions = 0;
    t->min_clearance = CLEARANCE_LIMIT_M;
    t->count = 0;
    sample(t, r, 0);
}

double trial_time_s(const trial *t, int64_t now_ms) {
    return t->clock_start_ms < 0 ? 0.0 : (double)(now_ms - t->clock_start_ms) / 1000.0;
}

int trial_failed(const trial *t, const robot *r) { return r->rolled_over || (t->rules.collision_ends && r->collided); }

int trial_timed_out(const trial *t, int64_t now_ms) {
    if (t->clock_start_ms < 0) return (double)now_ms >= t->rules.idle_limit_s * 1000.0;
    return trial_time_s(t, now_ms) >= t->rules.limit_s;
}

static double distance(const robot *r, double x, double y) {
    const double dx = r->state.x - x;
    const double dy = r->state.y - y;
    return sqrt(dx * dx + dy * dy);
}

static int at_goal(const trial *t, const robot *r) {
    const trial_rules *k = &t->rules;
    if (!isnan(k->success_y)) return r->state.y > k->success_y;
    return distance(r, k->goal_x, k->goal_y) < k->goal_radius;
}

void trial_update(trial *t, const robot *r, int64_t now_ms) {
    sample(t, r, now_ms);
    if (t->clock_start_ms < 0 && distance(r, t->start_x, t->start_y) >= t->rules.clock_starts_after)
        t->clock_start_ms = now_ms;
    const int failed = trial_failed(t, r);
    t->success = t->success || (!failed && at_goal(t, r));
    t->over = t->success || failed || trial_timed_out(t, now_ms);
}
