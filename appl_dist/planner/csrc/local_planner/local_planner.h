// base_local_planner::TrajectoryPlannerROS: cuts the global plan to the local map, stops and turns at its end,
// leaves the rest to the roll-outs.
#pragma once
#include "rollout.h"

typedef struct {
    double *x, *y;               // (capacity) the global plan, odom
    int capacity, first, count;  // points first .. first + count are left of it
    double end_yaw;              // rad, heading asked for at its last point; 0 at all others, as navfn leaves it
} plan_store;

typedef struct {
    rollout_planner rollouts;
    plan_store plan;
    bool rotating_to_goal, reached_goal;
    // Of the last call.
    const rollout *best;  // NULL when the goal pose was reached or no plan could be cut
    double best_cost;
    int local_first, local_count;  // the part of `plan` given to the roll-outs
} local_planner;

void local_planner_reset(local_planner *l);
// Copies n points; false when they do not fit.
bool local_planner_set_plan(local_planner *l, const double *xy, int n, double end_yaw);
// computeVelocityCommands on `cost` (frame h, w). pose: x, y, yaw; twist: v, w of the odometry; out: v, w.
bool local_planner_command(local_planner *l, const grid_frame *frame, const uint8_t *cost, const double pose[3],
                           const double twist[2], double out[2]);
