// One trial: when it has succeeded or failed, and what it leaves behind, sampled whenever the lidar fires.
#pragma once
#include <stddef.h>

#include "robot.h"

enum { TRIAL_COLUMNS = 6 };  // t s, x m, y m, yaw rad, forward speed m/s, yaw rate rad/s; true, world frame

// Rules of a protocol, see actor/protocol.py.
typedef struct {
    double goal_x, goal_y;  // m, world frame
    double success_y;       // success beyond it; NAN: within goal_radius of the goal
    double goal_radius;     // m
    double limit_s, idle_limit_s;
    double clock_starts_after;  // m of motion
    int collision_ends;
} trial_rules;

typedef struct {
    trial_rules rules;
    double start_x, start_y;
    int64_t clock_start_ms;  // -1: not yet
    int64_t sampled_ms, touched_ms;
    int success, over;
    int collisions;        // times the robot ran into something
    double min_clearance;  // m, at most 100
    double *samples;       // (capacity, TRIAL_COLUMNS), the caller's
    size_t count, capacity;
} trial;

void trial_start(trial *t, const trial_rules *rules, const robot *r);
// Notes where the robot is and whether the trial is over; a second sample of one moment is none.
void trial_update(trial *t, const robot *r, int64_t now_ms);
double trial_time_s(const trial *t, int64_t now_ms);  // by the protocol's clock
int trial_failed(const trial *t, const robot *r);
int trial_timed_out(const trial *t, int64_t now_ms);
