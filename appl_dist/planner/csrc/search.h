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

// What a cycle's samples have in common: false when the pose they all start from is not legal, so none of them is.
bool search_prepare(rollout_planner *p, const motion *m);

// Forward samples: each speed with rate 0, then with the rates but the highest. `best`: v, w and cost of the cheapest,
// cost < 0 where none is legal;
// not `possible`: they are only counted.
void search_forward(rollout_planner *p, const motion *m, const sample_window *k, bool possible,
                    rollout *best);

// An in-place turn: taken when not dearer than `best` and the goal distance ahead of its last point is below *ahead,
// which it becomes. `best` as above.
void search_turn(rollout_planner *p, const motion *m, double w, double *ahead, rollout *best);
