// Refines a sample's lower bound by the costs under its points, for as long as it is the lowest of all bounds.
#pragma once
#include "velocity_samples.h"

// Not legal; a bound, as not every point was tested; the exact cost; only simulating it tells.
typedef enum { REFINE_ILLEGAL, REFINE_BOUNDED, REFINE_EXACT, REFINE_UNDECIDED } refine_result;

enum { REFINE_COARSEST = 16 };  // every 16th point is tested first, then those between

// Before the first refinement.
static inline void refine_start(sample_block *b, int lane) {
    b->back[lane] = 0;
    b->gap[lane] = REFINE_COARSEST;
}

// Tests points until the bound passes `enough` (with `or_equal`: reaches it) or all are tested.
refine_result refine_bound(rollout_planner *p, const motion *m, sample_block *b, int lane, double enough,
                           bool or_equal);

// The sample's cost by simulating it step by step, -1 where it is not legal.
double simulate_cost(rollout_planner *p, const motion *m, double v, double w, rollout *scratch);
