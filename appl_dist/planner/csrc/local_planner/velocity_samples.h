// Velocity samples in blocks of vector width: their arcs, where they end, and what is known of their costs.
#pragma once
#include "rollout_arc.h"

enum { SAMPLE_LANES = 16 };

// What a sample needs next: nothing, a simulation, its last point's distances, the costs under its points.
typedef enum { SAMPLE_SCORED, SAMPLE_NEEDS_SIMULATION, SAMPLE_NEEDS_DISTANCES, SAMPLE_NEEDS_REFINING } sample_stage;

typedef struct sample_block {
    double v[SAMPLE_LANES], w[SAMPLE_LANES];
    // Fields of `arc`.
    double x[SAMPLE_LANES], y[SAMPLE_LANES], th[SAMPLE_LANES], turn[SAMPLE_LANES], pace[SAMPLE_LANES];
    double per_half[SAMPLE_LANES], dt[SAMPLE_LANES];
    int32_t steps[SAMPLE_LANES], from[SAMPLE_LANES];
    // Cell of the last point, and whether it is known: the answer of rollout_arc_cell, SAMPLE_NO_ARC where
    // the arc is not to be trusted.
    int32_t cx[SAMPLE_LANES], cy[SAMPLE_LANES], known[SAMPLE_LANES];
    // Scratch of the search.
    double bound[SAMPLE_LANES];                      // of the cost from below, while it is refined
    int32_t path[SAMPLE_LANES], goal[SAMPLE_LANES];  // cells from the last point, or at least
    int32_t occ[SAMPLE_LANES];                       // highest cost met so far
    int32_t back[SAMPLE_LANES], gap[SAMPLE_LANES];   // next point to test, counted from the last; between those tested
    uint8_t stage[SAMPLE_LANES];
} sample_block;

enum { SAMPLE_NO_ARC = -2 };

// From v and w: arcs, steps and last cells of all lanes.
void velocity_samples_rollout(sample_block *b, const rollout_planner *p, const motion *m);
rollout_arc velocity_samples_arc(const sample_block *b, int lane);
