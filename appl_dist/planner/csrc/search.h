// The cheapest of many samples, found without scoring them all: a best-first search over lower bounds of their costs.
// The distance terms are known from a roll-out's last point alone, and the obstacle term only grows along the way; a
// sample is looked at only for as long as its bound is the lowest. What wins is what wins in ROS, which scores every
// sample in order and keeps the first of the cheapest.
#pragma once
#include "arc.h"

// A sample on its way to its cost.
typedef struct candidate {
    arc way;
    double bound;       // of the cost from below; the cost itself when `stage` says so
    int order;          // place in ROS's order
    int stage;
    int x, y;           // cell of the last point
    int path, goal;     // cells from there, or at least
    int occ;            // highest cost met so far
    int back, gap;      // next point to look at, counted from the last; distance to those looked at
} candidate;

// Starts a cycle: where the samples in `k` (`forward`: with the forward ones) may end, for the waves to come.
grid_box search_start(rollout_planner *p, const motion *m, const sample_window *k, bool forward);

// After the waves are laid out: the cheapest sample. Only v, w and cost of `best` are set; cost < 0: none is legal.
void search_best(rollout_planner *p, const motion *m, const sample_window *k, bool forward, rollout *best);

// Rates of in-place turns are not below a least one, and some are not allowed.
static inline double turn_rate(const rollout_planner *p, double w) {
    const double least = p->set->min_in_place_vel_theta;
    return w > 0 ? fmax(w, least) : fmin(w, -least);
}

static inline bool turn_allowed(const rollout_planner *p, double w, double dw) {
    return (w > dw || w < -dw) && ((w < 0 && !p->stuck_left) || (w > 0 && !p->stuck_right));
}
