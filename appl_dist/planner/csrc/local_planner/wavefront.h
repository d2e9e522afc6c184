// Distance in 4-neighbour steps from a set of target cells (base_local_planner::MapGrid), grown only as far as
// somebody asks. A breadth-first search on bits: a map row is four words, one level is a few word operations a row.
// Distances are written down inside a box of cells; who asks outside it makes the box the whole map.
#pragma once
#include "grid.h"

enum {
    WAVE_LIMIT = 0xFFF0,            // distances are below
    WAVE_UNKNOWN = 0xFFFF,          // not reached (yet)
    WAVE_SIDE_MAX = 240,            // cells; the last bits of a row stay 0, which parts it from the next
    WAVE_WORDS = 4,                 // 64-bit words a row
    WAVE_ROWS = WAVE_SIDE_MAX + 2,  // with an empty one below and above
    WAVE_STRIDE = 256,              // of `dist`
};

typedef uint64_t wave_bits[WAVE_ROWS * WAVE_WORDS];

typedef struct {
    int w, h;        // cells
    grid_box box;    // where distances are written down
    int box_level;   // no cell of it is nearer to a target
    wave_bits open;  // no obstacle
    wave_bits target;
    wave_bits reached;
    wave_bits front;  // reached at `level`; valid in the rows it can be in
    int first, last;  // padded rows that can be reached
    int level;        // cells of this distance and less are found
    bool exhausted;   // nothing is left to reach
    uint16_t *dist;   // (h, WAVE_STRIDE) in the box, once found
} wavefront;

// The cells of a map that are no obstacle (cost below 253), the same for all waves over it.
void wavefront_open_cells(const grid_frame *frame, const uint8_t *cost, wave_bits open);
// New search with no targets. The box has to be on the map.
void wavefront_reset(wavefront *m, const grid_frame *frame, const wave_bits open, const grid_box *box);
void wavefront_unblock(wavefront *m, int x, int y);  // not an obstacle, whatever its cost
void wavefront_target(wavefront *m, int x, int y);   // also on an obstacle
void wavefront_start(wavefront *m);                  // after the last of them
// Until the cell's distance is known, or everything's: at least WAVE_LIMIT when it cannot be reached.
int wavefront_grow_until(wavefront *m, int x, int y);
void wavefront_grow_to(wavefront *m, int level);  // all distances up to `level`

// Whether the cell is no obstacle to the wave. Neighbours that are not are all reached, or none is.
static inline bool wavefront_open(const wavefront *m, int x, int y) {
    return m->open[(y + 1) * WAVE_WORDS + (x >> 6)] >> (x & 63) & 1;
}

static inline bool wavefront_in_box(const wavefront *m, int x, int y) {
    return x >= m->box.x0 && x <= m->box.x1 && y >= m->box.y0 && y <= m->box.y1;
}

static inline bool wavefront_known(const wavefront *m, int x, int y) {
    return wavefront_in_box(m, x, y) && m->dist[y * WAVE_STRIDE + x] != WAVE_UNKNOWN;
}

// Distance of a cell, or at least WAVE_LIMIT when it cannot be reached or is an obstacle.
static inline int wavefront_distance(wavefront *m, int x, int y) {
    if (!wavefront_open(m, x, y)) return WAVE_LIMIT;
    return wavefront_known(m, x, y) ? m->dist[y * WAVE_STRIDE + x] : wavefront_grow_until(m, x, y);
}

// At most the distance of a cell, without growing anything.
static inline int wavefront_at_least(const wavefront *m, int x, int y) {
    if (!wavefront_open(m, x, y)) return WAVE_LIMIT;
    if (!wavefront_in_box(m, x, y)) return 0;
    const int d = m->dist[y * WAVE_STRIDE + x];
    return d != WAVE_UNKNOWN ? d : m->exhausted ? WAVE_LIMIT : m->level + 1;
}

// MapCell::target_dist as ROS numbers it: w*h an obstacle, w*h + 1 never touched.
int wavefront_ros_value(wavefront *m, int x, int y);
