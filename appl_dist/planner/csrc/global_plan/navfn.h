// The global plan: navfn::NavFn. A wave of potential runs from the robot until it reaches the goal's cell, then
// a path follows its gradient back.
#pragma once
#include "costmap.h"

enum { NAVFN_BUFFER = 10000 };  // entries a priority buffer holds; more are dropped, as in ROS
enum { NAVFN_NEUTRAL = 50 };    // cost of a free cell
#define NAVFN_NONE 1.0e10f      // potential of a cell no wave came to

// Potential by which the bounded wave reaches beyond what it needs; see navfn_wave.c. The small one moves a plan by
// micrometres as a rule, by millimetres in one of a hundred.
#define NAVFN_MARGIN_EXACT 1600.0f
#define NAVFN_MARGIN_FAST 100.0f

typedef struct {
    int w, h;
    uint8_t *master;      // (h, w) the costmap `cost` was made from
    uint8_t *cost;        // (h, w) traversal cost 50..253, 254 blocked; the outer ring is blocked
    float *potential;     // (h, w) NAVFN_NONE where no wave came
    float *step;          // (h, w) cost * 1/sqrt(2); infinite for cells blocked or in a buffer already
    float *remain;        // (h, w) lower bound of what the wave adds from there to the goal's cell
    int remain_goal;      // the cell `remain` is about, -1 for none
    int32_t *buffers[3];  // (NAVFN_BUFFER + 4)
    int32_t *reached;     // (h * w + 1) the cells that hold a potential
    int reached_count;
    float *path_x, *path_y;  // (path_capacity) cells, goal first
    int path_capacity;
    // The last plan, and whether it still holds: the wave depends only on costs, start and goal.
    bool fresh;
    int start, goal;  // cells
    double goal_x, goal_y;
    int plan_count;
    double *plan;          // (path_capacity + 1, 2) m, odom: robot first
    bool whole;            // no bound: every potential is NavFn's
    bool single;           // the wave in single precision
    float margin;          // NAVFN_MARGIN_…
    float bound;           // the wave spreads only where it can still matter: see navfn_wave.c
    float goal_potential;  // of the last plan, 0 for none
    long cells;            // cells the wave updated
    uint8_t cost_of[256];
    float step_of[256];   // cost * 1/sqrt(2), infinite where blocked
    float per_cost[256];  // 1 / cost
} navfn;

void navfn_init(navfn *n);
void navfn_restart(navfn *n);  // no plan yet: nothing of an earlier drive has an influence on the next
void navfn_sync(navfn *n, const uint8_t *master, grid_window window);  // takes over changed costs
// Plan from start to goal; the start's cell of `master` is cleared. False, and no plan, when there is none.
bool navfn_plan(navfn *n, const grid_frame *frame, uint8_t *master, double start_x, double start_y, double goal_x,
                double goal_y);
