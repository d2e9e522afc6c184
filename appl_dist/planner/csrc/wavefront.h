// Distance in 4-neighbour steps from a set of target cells (base_local_planner::MapGrid), grown only as far as
// somebody asks: the levels of a breadth-first search are final once reached.
#pragma once
#include "grid.h"

enum {
    WAVE_FREE = 0xFFFF,      // not reached (yet)
    WAVE_OBSTACLE = 0xFFFE,  // an obstacle cell a wave has touched
    WAVE_BLOCKED = 0xFFFD,   // an obstacle cell no wave has touched (yet)
    WAVE_LIMIT = 0xFFF0,     // distances are below
};

typedef struct {
    int w, h, stride;   // cells; rows are padded by one cell on each side
    uint16_t *dist;     // ((h + 2) * stride)
    int32_t *queue;     // (w * h) padded indices
    int head, tail;
} wavefront;

size_t wavefront_cells(int w, int h);  // entries of `dist`

static inline int wave_index(const wavefront *m, int x, int y) { return (y + 1) * m->stride + x + 1; }

// New search over a map: nothing reached, cells of cost 253 and more are obstacles.
void wavefront_reset(wavefront *m, const uint8_t *cost);
void wavefront_unblock(wavefront *m, int x, int y);  // not an obstacle, whatever its cost
void wavefront_target(wavefront *m, int x, int y);
void wavefront_grow_until(wavefront *m, int index);  // until the cell is reached, or everything is

// Distance of a cell, or at least WAVE_LIMIT when it cannot be reached or is an obstacle.
static inline int wavefront_distance(wavefront *m, int x, int y) {
    const int i = wave_index(m, x, y);
    if (m->dist[i] == WAVE_FREE) wavefront_grow_until(m, i);
    return m->dist[i];
}

// MapCell::target_dist as ROS numbers it: w*h an obstacle, w*h + 1 never touched.
int wavefront_ros_value(wavefront *m, int x, int y);
