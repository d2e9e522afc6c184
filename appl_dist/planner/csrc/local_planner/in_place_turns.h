// Turns in place, which ROS tries after the forward samples and prefers by what lies ahead.
#pragma once
#include "refine_bound.h"

// Rates of in-place turns are not below a least one, and some are not allowed.
static inline double in_place_turn_rate(const rollout_planner *p, double w) {
    const double least = p->set->min_in_place_vel_theta;
    return w > 0 ? fmax(w, least) : fmin(w, -least);
}

static inline bool in_place_turn_allowed(const rollout_planner *p, double w, double dw) {
    return (w > dw || w < -dw) && ((w < 0 && !p->stuck_left) || (w > 0 && !p->stuck_right));
}

// `best` becomes a turn where one is to be taken. `possible`: the pose to start from is legal.
void in_place_turns_try(rollout_planner *p, const motion *m, const sample_window *k, bool possible, rollout *best);
