// What a sample's points cost, looked at only for as long as its bound is the lowest.
#pragma once
#include "velocity_samples.h"

// Not legal; not looked at to the end; cost known; only stepping through it tells.
typedef enum { ILLEGAL, OPEN, DONE, UNDECIDED } verdict;

enum { LOOK_COARSEST = 16 };  // points are looked at every 16th first, then those between

// Before the first look.
static inline void look_start(sample_block *b, int lane) { b->back[lane] = 0, b->gap[lane] = LOOK_COARSEST; }

// Looks at points until the bound passes `enough` (with `or_equal`: reaches it) or all are seen.
verdict look(rollout_planner *p, const motion *m, sample_block *b, int lane, double enough, bool or_equal);

// The sample's cost by stepping through it, -1 where it is not legal.
double step_through(rollout_planner *p, const motion *m, double v, double w, rollout *scratch);
