// One velocity sample rolled out and scored. Internal to the roll-out planner.
#pragma once
#include "rollout.h"

typedef struct {
    double x, y, th, v, w;
} motion;

// Steps TrajectoryPlanner takes along a sample.
int simulate_steps(const rollout_planner *p, double v, double w);

// TrajectoryPlanner::generateTrajectory, word for word in its order of tests.
void simulate(rollout_planner *p, motion m, double v, double w, rollout *out);

// Lays out what simulate_if_better looks up: once a cycle, after the map changed.
void simulate_prepare(rollout_planner *p);

// Whether the sample is legal and cheaper than `limit` (or as cheap, with `ties`; negative: no limit); then `out` holds
// it. Equal to `simulate` for samples that pass; those that cannot are dropped as soon as that is certain: the distance
// terms are known from the last point alone and the obstacle term only grows along the way.
// `column` numbers the yaw rates of a row of samples, which share their headings.
// `ahead` (in-place turns only): the goal distance ahead of the last point must be below *ahead, which it becomes.
bool simulate_if_better(rollout_planner *p, const motion *m, double v, double w, int column, double limit, bool ties,
                        double *ahead, rollout *out);
