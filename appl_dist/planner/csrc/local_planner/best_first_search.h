// The cheapest of many samples, found without scoring them all: a best-first search over lower bounds of their costs.
// The distance terms are known from a roll-out's last point alone, and the obstacle term only grows along the way; a
// sample's bound is refined only for as long as it is the lowest. What wins is what wins in ROS, which scores every
// sample in order and keeps the first of the cheapest.
#pragma once
#include "refine_bound.h"

// Starts a cycle: where the samples in `k` (`forward`: with the forward ones) may end, for the waves to come.
grid_box best_first_start(rollout_planner *p, const motion *m, const sample_window *k, bool forward);

// After the wavefronts are started: the cheapest sample. Only v, w and cost of `best` are set; cost < 0: none is legal.
void best_first_search(rollout_planner *p, const motion *m, const sample_window *k, bool forward, rollout *best);
