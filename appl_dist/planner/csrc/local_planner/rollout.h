// Roll-outs of velocity samples and the choice among them: base_local_planner::TrajectoryPlanner with
// dwa: true, heading_scoring, simple_attractor and holonomic_robot: false.
#pragma once
#include "footprint.h"
#include "minimum_tree.h"
#include "settings.h"
#include "wavefront.h"

typedef struct {
    double v, w, cost;   // m/s, rad/s; cost -1 hits something or leaves the map, -2 has no way to the goal
    int points;          // stored in x, y, th
    double *x, *y, *th;  // m, m, rad, odom
} rollout;

// One evaluated sample, as the traced ROS code reports it.
typedef struct {
    double v, w, cost, path_cells, goal_cells, occ, num_steps, points;
} rollout_row;

enum { ROLLOUT_COLUMNS = sizeof(rollout_row) / sizeof(double) };

typedef struct {
    rollout_row *rows;
    int capacity, count;
} rollout_trace;

enum { FORWARD_BLOCKS = MINIMUM_TREE_LEAVES_MAX / 16, TURN_BLOCKS = (SAMPLES_MAX + 15) / 16 };

// Scratch of best_first_search.c.
typedef struct {
    struct sample_block *blocks;  // (SEARCH_BLOCKS) forward samples
    struct sample_block *turns;   // (TURN_BLOCKS) in place
    minimum_tree bounds;          // of the samples' costs, from below
    int used;                     // samples in the blocks
    int row, column;              // the sample after them
    double v, w;
    int start_occ;  // cost of the pose all samples start from
} best_first_scratch;

typedef struct {
    const planner_settings *set;
    planner_parameters par;
    double pdist, gdist;  // scales in force: times the resolution with meter_scoring
    footprint_shape shape;
    footprint_lines lines;
    grid_frame frame;  // the local map, valid during one call
    const uint8_t *cost;
    wave_bits open;  // its cells that are no obstacle
    wavefront path, goal;
    double goal_x, goal_y;      // end of the local plan
    int goal_column, goal_row;  // its cell, or that of the last point on the map
    // State over cycles. Names as in ROS, where left and right are swapped.
    bool stuck_left, stuck_right, rotating_left, rotating_right, escaping;
    double prev_x, prev_y, escape_x, escape_y, escape_theta;
    // Scratch.
    int steps_max;
    rollout one, two, probe;
    best_first_scratch search;
    rollout_trace *trace;          // NULL: samples that cannot win are not simulated to the end
    long rollouts, rollout_steps;  // of the last call
} rollout_planner;

void rollout_reset(rollout_planner *p);
void rollout_set_parameters(rollout_planner *p, const planner_parameters *par);

// updatePlan and findBestPath: the best roll-out along a plan of n points. Its arrays are valid until the next call.
// Poses and twist as truncated to float by ROS.
const rollout *rollout_best(rollout_planner *p, const double *plan_x, const double *plan_y, int n, double x, double y,
                            double theta, double v, double w);
// TrajectoryPlanner::checkTrajectory
bool rollout_check(rollout_planner *p, double x, double y, double theta, double v, double w, double v_sample,
                   double w_sample);
