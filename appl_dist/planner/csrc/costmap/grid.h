// A grid in the world, and the two rasterisers every layer of the planner shares.
// Casts and comparisons are those of costmap_2d::Costmap2D; they decide in which cell a point falls.
#pragma once
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

enum { COST_FREE = 0, COST_INSCRIBED = 253, COST_LETHAL = 254, COST_UNKNOWN = 255 };

typedef struct {
    int w, h;       // cells
    double res;     // m
    double ox, oy;  // m, lower left corner of cell (0, 0)
} grid_frame;

typedef struct {
    int x, y;
} grid_cell;

typedef struct {
    int x0, y0, x1, y1;  // columns [x0, x1], rows [y0, y1]; may reach beyond the map
} grid_box;

typedef struct {
    int x0, y0, xn, yn;  // columns [x0, xn), rows [y0, yn)
} grid_window;

static inline bool window_empty(grid_window k) { return k.xn <= k.x0 || k.yn <= k.y0; }

static inline grid_window window_overlap(grid_window a, grid_window b) {
    return (grid_window){a.x0 > b.x0 ? a.x0 : b.x0, a.y0 > b.y0 ? a.y0 : b.y0, a.xn < b.xn ? a.xn : b.xn,
                         a.yn < b.yn ? a.yn : b.yn};
}

static inline grid_window window_grown(grid_window k, int by) {
    return (grid_window){k.x0 - by, k.y0 - by, k.xn + by, k.yn + by};
}

// Costmap2D::worldToMap. False for points off the map and for NaN.
static inline bool world_to_map(const grid_frame *g, double wx, double wy, int *mx, int *my) {
    if (!(wx >= g->ox && wy >= g->oy)) return false;
    const double cx = (wx - g->ox) / g->res;
    const double cy = (wy - g->oy) / g->res;
    if (!(cx < g->w && cy < g->h)) return false;
    *mx = (int)cx;
    *my = (int)cy;
    return true;
}

// Costmap2D::worldToMapEnforceBounds for one axis.
static inline int world_to_map_clamped(double wx, double origin, int cells, double res) {
    if (!(wx >= origin)) return 0;
    if (wx >= res * cells + origin) return cells - 1;
    return (int)((wx - origin) / res);
}

// Costmap2D::cellDistance
static inline int cell_distance(double metres, double res) { return (int)fmax(0.0, ceil(metres / res)); }

// The integer line of base_local_planner::LineIterator (and, seen as offsets, of Costmap2D::raytraceLine).
// `steps` + 1 cells: start at (x, y), call line_advance between cells.
typedef struct {
    int x, y, steps;
    int den, num, add;
    int dx1, dy1, dx2, dy2;  // extra step when the error overflows; step taken every time
} grid_line;

static inline grid_line line_between(int x0, int y0, int x1, int y1) {
    const int ax = abs(x1 - x0);
    const int ay = abs(y1 - y0);
    const int sx = x1 >= x0 ? 1 : -1;
    const int sy = y1 >= y0 ? 1 : -1;
    grid_line l = {.x = x0, .y = y0};
    if (ax >= ay) {
        l.den = ax;
        l.num = ax / 2;
        l.add = ay;
        l.steps = ax;
        l.dy1 = sy;
        l.dx2 = sx;
    } else {
        l.den = ay;
        l.num = ay / 2;
        l.add = ax;
        l.steps = ay;
        l.dx1 = sx;
        l.dy2 = sy;
    }
    return l;
}

static inline void line_advance(grid_line *l) {
    l->num += l->add;
    if (l->num >= l->den) {
        l->num -= l->den;
        l->x += l->dx1;
        l->y += l->dy1;
    }
    l->x += l->dx2;
    l->y += l->dy2;
}

// Yaw after a trip through a quaternion, as poses and velocities make it in ROS (tf2 setRPY, getYaw).
static inline double yaw_through_quaternion(double yaw) {
    const double z = sin(yaw * 0.5);
    const double w = cos(yaw * 0.5);
    return atan2(2 * (w * z), w * w - z * z);
}

// angles::shortest_angular_distance, of angles 1.9.13 and later
static inline double shortest_angle(double from, double to) {
    const double pi = 3.14159265358979323846;
    const double a = fmod(to - from + pi, 2.0 * pi);
    return a <= 0.0 ? a + pi : a - pi;
}
