// Everything one robot's planner remembers, and the move_base loop around it. The caller owns the memory:
// navigator_bytes(settings) of it, 16-byte aligned. Nothing is allocated afterwards.
#pragma once
#include <stddef.h>

#include "costmap.h"
#include "local_planner.h"
#include "navfn.h"
#include "planner_interface.h"

typedef enum {
    NAVIGATOR_IDLE,         // no goal yet
    NAVIGATOR_PLANNING,     // waits for a global plan, or lost its valid command
    NAVIGATOR_CONTROLLING,  // follows the plan
    NAVIGATOR_CLEARING,     // runs a recovery behaviour
    NAVIGATOR_SUCCEEDED,
    NAVIGATOR_ABORTED,  // out of recoveries: zero velocity until the next goal
} navigator_state;

typedef enum { RECOVERY_FOR_PLANNING, RECOVERY_FOR_CONTROLLING } recovery_reason;

enum { RECOVERY_BEHAVIOURS = 4 };  // clear, rotate, clear, rotate; the clearings name a layer that does not exist

typedef struct {
    bool active, half;  // half a turn done
    double start_yaw;   // rad
} rotation;

typedef struct {
    planner_settings set;
    planner_parameters par;
    footprint_shape shape;
    costmap local, global;
    inflation_scratch scratch;
    navfn plan;
    local_planner local_plan;
    observation seen;
    double *beam_cos, *beam_sin;  // (beams) directions in the laser's frame
    double goal[3];               // m, m, rad; odom
    navigator_state state;
    recovery_reason reason;
    rotation turn;
    bool run_planner, new_plan, have_plan;
    double *latest;  // (path capacity + 1, 2) the newest global plan
    int latest_count;
    int recovery_index, recoveries;
    double now, last_valid_plan, last_valid_control;  // s; NaN before the first control cycle
    bool valid;  // the last control cycle's command came from a valid roll-out or goal behaviour
    unsigned cycles;
} navigator;

// False, and `bad` names the first field out of its range.
bool navigator_check_settings(const planner_settings *set, planner_limit *bad);
bool navigator_check_parameters(const planner_settings *set, const planner_parameters *par, planner_limit *bad);

size_t navigator_bytes(const planner_settings *set);
// `fast`: plans may differ from those of ROS by what NAVFN_MARGIN_FAST and single precision allow, costs where the
// brushfire of ROS is no exact distance transform.
navigator *navigator_init(void *memory, const planner_settings *set, const planner_parameters *par, bool fast);
void navigator_reset(navigator *n, const double goal[3]);
void navigator_set_parameters(navigator *n, const planner_parameters *par);
// ranges: (beams) m; not finite or not positive = no return. pose: robot, at the scan's stamp.
void navigator_add_scan(navigator *n, const float *ranges, const double pose[3]);
void navigator_update_local(navigator *n, const double pose[3]);
void navigator_update_global(navigator *n, const double pose[3]);
bool navigator_plan(navigator *n, const double pose[3], double now);
void navigator_control(navigator *n, const double pose[3], const double twist[2], double now, double out[2]);
// Scan, local map, global map on every second call, plan, control.
void navigator_cycle(navigator *n, const float *ranges, const double pose[3], const double twist[2], double now,
                     double out[2]);
// Direction of the plan's point `lookahead` m of arc beyond the one nearest the robot; 0 without a plan.
double navigator_bearing(const navigator *n, const double pose[3], double lookahead);
planner_interface navigator_interface(navigator *n);
