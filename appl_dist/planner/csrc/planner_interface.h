// What the loop drives with: the threads of a move_base, each called at its own rate. Any planner that gives these
// functions can drive; `navigator_interface` gives those of the navigator.
#pragma once
#include <stdbool.h>

typedef struct {
    void *self;
    int beams;  // of the scans that it takes
    // ranges: (beams) m; not finite or not positive = no return. pose: x, y, yaw of the robot at the scan's stamp;
    // odom.
    void (*add_scan)(void *self, const float *ranges, const double pose[3]);
    void (*update_local)(void *self, const double pose[3]);
    void (*update_global)(void *self, const double pose[3]);
    // A global plan from `pose`. now: s; NaN leaves the clock where control set it.
    bool (*plan)(void *self, const double pose[3], double now);
    // twist: v, w of the odometry; out: the command v, w.
    void (*control)(void *self, const double pose[3], const double twist[2], double now, double out[2]);
    // Points that the last control cycle simulated, which the loop turns into computing time.
    long (*control_steps)(const void *self);
    // Whether the planner cannot go on, which stops the loop; NULL: it always can.
    bool (*failed)(const void *self);
} planner_interface;
