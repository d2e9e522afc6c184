// One velocity sample rolled out and scored, step by step. Internal to the roll-out planner.
#pragma once
#include "rollout.h"

typedef struct {
    double x, y, th, v, w;
} motion;

// Velocities to try: `nv` speeds from `min_v`, `nw` rates from `min_w`.
typedef struct {
    double min_v, max_v, dv, min_w, max_w, dw;
    int nv, nw;
} sample_window;

static inline double towards(double target, double now, double step) {  // TrajectoryPlanner::computeNewVelocity
    if (target - now >= 0) return now + step < target ? now + step : target;
    return now - step > target ? now - step : target;
}

static inline double total_cost(const rollout_planner *p, double path, double goal, double occ) {
    return p->pdist * path + goal * p->gdist + p->par.occdist_scale * occ;
}

// Steps TrajectoryPlanner takes along a sample.
int simulate_steps(const rollout_planner *p, double v, double w);

// TrajectoryPlanner::generateTrajectory, word for word in its order of tests.
void simulate(rollout_planner *p, motion m, double v, double w, rollout *out);

// Only the poses of a sample that is legal, and its velocities.
void simulate_poses(const rollout_planner *p, motion m, double v, double w, rollout *out);

// The whole of it, not counted as work of this cycle.
void simulate_again(rollout_planner *p, motion m, double v, double w, rollout *out);
