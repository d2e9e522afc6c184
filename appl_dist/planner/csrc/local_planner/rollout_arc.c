#include "rollout_arc.h"

#include "wide.h"

// Pose at a step before the velocities are reached.
static void accelerating_pose(const rollout_arc *a, const planner_settings *set, const motion *m, pose_batch *at,
                              int i) {
    double x = m->x;
    double y = m->y;
    double th = m->th;
    double speed = m->v;
    double rate = m->w;
    for (int k = 0; k < (int)at->step[i]; ++k) {
        double s, c;
        rollout_arc_sincos(th, &s, &c);
        speed = towards(a->v, speed, set->acc_lim_x * a->dt);
        rate = towards(a->w, rate, set->acc_lim_theta * a->dt);
        x += speed * c * a->dt;
        y += speed * s * a->dt;
        th += rate * a->dt;
    }
    at->x[i] = x;
    at->y[i] = y;
    rollout_arc_sincos(th, &at->sine[i], &at->cosine[i]);
}

// The sum of cos(th + k turn) for k < n is sin(n turn / 2) / sin(turn / 2) cos(th + (n - 1) turn / 2).
WIDE static void arc_poses(const rollout_arc *restrict a, pose_batch *restrict at) {
    const rollout_arc way = *a;
    const bool straight = way.per_half == 0;
    for (int i = 0; i < POSE_BATCH; ++i) {
        const double n = at->step[i] - way.from;
        double s, c, half, unused;
        rollout_arc_sincos(way.th + (n - 1) * way.turn * 0.5, &s, &c);
        rollout_arc_sincos(n * way.turn * 0.5, &half, &unused);
        const double length = way.pace * (straight ? n : half * way.per_half);
        at->x[i] = way.x + length * c;
        at->y[i] = way.y + length * s;
        rollout_arc_sincos(way.th + n * way.turn, &at->sine[i], &at->cosine[i]);
    }
}

WIDE static void centre_cells(const grid_frame *restrict frame, pose_batch *restrict at) {
    const grid_frame g = *frame;
    const double per_res = 1 / g.res;
    for (int i = 0; i < POSE_BATCH; ++i)
        at->known[i] = rollout_arc_cell(&g, per_res, at->x[i], at->y[i], &at->cx[i], &at->cy[i]);
}

WIDE static void corner_cells(const grid_frame *restrict frame, const footprint_shape *restrict shape,
                              pose_batch *restrict at) {
    const grid_frame g = *frame;
    const double per_res = 1 / g.res;
    for (int i = 0; i < POSE_BATCH; ++i) at->corners_known[i] = 1;
    for (int k = 0; k < FOOTPRINT_CORNERS; ++k) {
        const double fx = shape->x[k];
        const double fy = shape->y[k];
        for (int i = 0; i < POSE_BATCH; ++i) {
            const double s = at->sine[i];
            const double c = at->cosine[i];
            const int32_t on = rollout_arc_cell(&g, per_res, at->x[i] + (fx * c - fy * s), at->y[i] + (fx * s + fy * c),
                                                &at->corner_x[k][i], &at->corner_y[k][i]);
            const int32_t before = at->corners_known[i];
            at->corners_known[i] = before < on ? before : on;
        }
    }
}

void rollout_arc_poses(const rollout_arc *a, const rollout_planner *p, const motion *m, pose_batch *at) {
    arc_poses(a, at);
    for (int i = 0; i < POSE_BATCH; ++i)
        if (at->step[i] < a->from) accelerating_pose(a, p->set, m, at, i);
    centre_cells(&p->frame, at);
}

void rollout_arc_corners(const rollout_planner *p, pose_batch *at) { corner_cells(&p->frame, &p->shape, at); }
