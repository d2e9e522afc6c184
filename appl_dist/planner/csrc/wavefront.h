// Distance in 4-neighbour steps from a set of target cells (base_local_planner::MapGrid), grown only as far as
// somebody asks and towards where they ask: a best-first search (A*) whose estimate is the distance to a box of cells.
// Distances do not depend on the order they are found in, so they are those of the breadth-first search of ROS.
#pragma once
#include "grid.h"

enum {
    WAVE_BLOCKED = 0,        // an obstacle, or outside the map
    WAVE_FREE = 0xFFFF,      // not reached (yet)
    WAVE_LIMIT = 0xFFF0,     // distances are below
    WAVE_BUCKETS = 3,        // a step changes distance + estimate by 0, 1 or 2
    WAVE_SIDE_MAX = 240,     // cells
    WAVE_STRIDE = 256,       // rows are padded by one cell on each side; an index holds row and column in a byte each
};

typedef struct {
    int w, h;            // cells
    const uint8_t *cost; // (h, w) of the map searched
    uint16_t *dist;      // ((h + 2) * WAVE_STRIDE) 1 + distance; a row is laid out when first needed
    uint8_t laid_out[WAVE_SIDE_MAX + 2];
    uint16_t *bucket[WAVE_BUCKETS];  // (w * h + 1) indices; a cell is in each at most once
    int count[WAVE_BUCKETS], next;  // `next` to be expanded in the bucket of `level`
    int level;           // cells whose distance + estimate is below it have their final distance
    int last_target;     // highest estimate of a target
    int targets_at[2 * WAVE_SIDE_MAX + 1];  // lists of targets by their estimate, -1 empty
    int *next_target;    // ((h + 2) * WAVE_STRIDE)
    // Estimate of steps from a cell to the box: by padded column and row.
    uint8_t to_column[WAVE_SIDE_MAX + 2], to_row[WAVE_SIDE_MAX + 2];
} wavefront;

static inline int wave_index(int x, int y) { return (y + 1) * WAVE_STRIDE + x + 1; }

// New search over a map of w x h cells: nothing reached, cells of cost 253 and more are obstacles. The box is where distances
// are asked for; others are found too, later.
void wavefront_reset(wavefront *m, const grid_frame *frame, const uint8_t *cost, const grid_box *box);
void wavefront_lay_out_row(wavefront *m, int y);  // by padded row; once
void wavefront_unblock(wavefront *m, int x, int y);  // not an obstacle, whatever its cost
void wavefront_target(wavefront *m, int x, int y);
void wavefront_grow_until(wavefront *m, int x, int y);  // until the cell's distance is final, or everything's

static inline uint16_t wavefront_found(wavefront *m, int x, int y) {
    if (!m->laid_out[y + 1]) wavefront_lay_out_row(m, y + 1);
    return m->dist[wave_index(x, y)];
}

// Whether the cell is no obstacle to the wave. Neighbours that are not are all reached, or none is.
static inline bool wavefront_open(wavefront *m, int x, int y) { return wavefront_found(m, x, y) != WAVE_BLOCKED; }

// Distance of a cell, or at least WAVE_LIMIT when it cannot be reached or is an obstacle.
static inline int wavefront_distance(wavefront *m, int x, int y) {
    const int d = wavefront_found(m, x, y);
    if (d == WAVE_BLOCKED) return WAVE_LIMIT;
    if (d - 1 + m->to_column[x + 1] + m->to_row[y + 1] <= m->level) return d - 1;
    wavefront_grow_until(m, x, y);
    return m->dist[wave_index(x, y)] - 1;
}

// At most the distance of a cell, without growing anything.
static inline int wavefront_at_least(wavefront *m, int x, int y) {
    const int d = wavefront_found(m, x, y), least = m->level - m->to_column[x + 1] - m->to_row[y + 1];
    if (d == WAVE_BLOCKED) return WAVE_LIMIT;
    return d - 1 < least ? d - 1 : least > 0 ? least : 0;
}

// MapCell::target_dist as ROS numbers it: w*h an obstacle, w*h + 1 never touched.
int wavefront_ros_value(wavefront *m, int x, int y);
