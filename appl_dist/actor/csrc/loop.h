// The closed loop of robot and planner: one clock, the events of actor/timing.py, nothing computed that nobody reads.
// The robot lives in the world frame, the planner in the odometry frame: origin at the start, axes parallel.
#pragma once
#include "lidar.h"
#include "planner_interface.h"
#include "robot.h"
#include "trial.h"

enum { LOOP_QUEUE = 2048 };  // more than the longest delay can hold, at a period of 1 ms

// See actor/timing.py; whole milliseconds, and computing times in ms of work.
typedef struct {
    int scan_period_ms, scan_delay_ms, odometry_delay_ms;
    int local_map_period_ms, global_map_period_ms, plan_period_ms, control_period_ms;
    int command_delay_ms;
    double cpu_factor, control_base_ms, control_us_per_step, plan_ms;
} loop_timing;

// ros::Rate: cycles lie on a grid of one period; after an overrun the next starts at once.
typedef struct {
    int64_t period, due, grid;  // ms; when the next cycle starts
} rate;

void rate_start(rate *r, int period_ms, int phase_ms);
void rate_wait(rate *r, int64_t until_ms);  // something else holds what the cycle needs: later, on the same grid
void rate_finish(rate *r, int64_t now_ms);  // the cycle has ended: sets when the next one starts

// When and where the lidar fired: true pose in the world, estimated pose and twist in the odometry frame.
typedef struct {
    int64_t time_ms;
    double pose[3], pose_odom[3], twist[2];
} loop_stamp;

// Readings on their way. Whoever takes one takes the newest that has arrived, so older ones are dropped.
typedef struct {
    loop_stamp stamp[LOOP_QUEUE];
    int first, count;
    int64_t delay_ms;
} loop_queue;

typedef struct {
    int64_t due_ms;
    double v, w;
} loop_command;

typedef enum {
    LOOP_ENDED,    // the time asked for has passed
    LOOP_OVER,     // the trial is over
    LOOP_CONTACT,  // the robot may touch something: resolve one step, then go on
    LOOP_SAMPLED,  // the lidar has fired, and `watched` is set
    LOOP_BROKEN,   // the robot's pose is no number any more
    LOOP_FAILED,   // the planner cannot go on
} loop_pause;

typedef enum {
    STAGE_PHYSICS,
    STAGE_LIDAR,
    STAGE_LOCAL_MAP,
    STAGE_GLOBAL_MAP,
    STAGE_PLAN,
    STAGE_CONTROL,
    STAGES
} loop_stage;

typedef struct {
    robot *body;
    const lidar *sensor;
    double lidar_x;  // m, mount in base_link
    planner_interface planner;
    loop_timing timing;
    trial test;
    float *ranges;  // (beams,)
    int watched;
    int contact_ms;  // LOOP_CONTACT: how far to step before going on; whoever does adds it to now_ms

    double origin[2];
    int64_t now_ms, received_ms, scan_due_ms, work_due_ms, plan_done_ms, control_done_ms;
    rate local, global, plan, control;
    int planning;  // a plan is being computed, from this pose
    double planning_from[3];
    double command[2];                // in force
    loop_command flying[LOOP_QUEUE];  // commands on their way to the wheels
    int flying_first, flying_count;
    loop_queue scans, estimates;
    loop_stamp newest, estimate;  // the last scan that was fired; what the planner believes
    double seconds[STAGES];
    int64_t calls[STAGES];
} navigation_loop;

typedef struct {
    int local_map_ms, global_map_ms, plan_ms, control_ms, filter_ms;
} loop_phases;

// Begins at time 0. The robot, the planner and the trial have been reset.
void loop_reset(navigation_loop *l, const double origin[2], const loop_phases *phases);
// Runs until `end_ms`, or until something needs the caller.
loop_pause loop_run(navigation_loop *l, int64_t end_ms);
