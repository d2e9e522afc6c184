#include "footprint.h"

static double pad(double v, double padding) { return v + (v > 0 ? padding : v < 0 ? -padding : 0.0); }

footprint_shape footprint_make(double half_length, double half_width, double padding) {
    const double l = pad(half_length, padding), w = pad(half_width, padding);
    return (footprint_shape){.x = {-l, -l, l, l}, .y = {-w, w, w, -w}, .reach = hypot(l, w)};
}

// Highest cost on a line, or -1 (CostmapModel::lineCost, pointCost).
static inline int line_cost(const grid_frame *g, const uint8_t *cost, grid_cell a, grid_cell b) {
    int worst = 0;
    grid_line l = line_between(a.x, a.y, b.x, b.y);
    for (int i = 0;; ++i) {
        const int c = cost[l.y * g->w + l.x];
        if (c >= COST_LETHAL) return -1;
        if (c > worst) worst = c;
        if (i == l.steps) return worst;
        line_advance(&l);
    }
}

int footprint_outline_cost(const footprint_shape *f, const grid_frame *g, const uint8_t *cost, double x, double y,
                           double cos_th, double sin_th) {
    grid_cell c[FOOTPRINT_CORNERS];
    return footprint_corner_cells(f, g, x, y, cos_th, sin_th, c) ? footprint_cells_cost(g, cost, c) : -1;
}

int footprint_cells_cost(const grid_frame *g, const uint8_t *cost, const grid_cell c[FOOTPRINT_CORNERS]) {
    int worst = 0;
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
        const int line = line_cost(g, cost, c[i], c[(i + 1) % FOOTPRINT_CORNERS]);
        if (line < 0) return -1;
        if (line > worst) worst = line;
    }
    return worst;
}

bool footprint_fill(const footprint_shape *f, const grid_frame *g, double x, double y, double yaw,
                    footprint_columns *out) {
    grid_cell c[FOOTPRINT_CORNERS];
    out->count = 0;
    if (!footprint_corner_cells(f, g, x, y, cos(yaw), sin(yaw), c)) return false;
    int x0 = c[0].x, x1 = c[0].x;
    for (int i = 1; i < FOOTPRINT_CORNERS; ++i) {
        if (c[i].x < x0) x0 = c[i].x;
        if (c[i].x > x1) x1 = c[i].x;
    }
    if (x1 - x0 >= FOOTPRINT_COLUMNS_MAX) return false;
    out->x0 = x0;
    out->count = x1 - x0 + 1;
    for (int i = 0; i < out->count; ++i) out->low[i] = g->h, out->high[i] = -1;
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
        const grid_cell a = c[i], b = c[(i + 1) % FOOTPRINT_CORNERS];
        grid_line l = line_between(a.x, a.y, b.x, b.y);
        for (int k = 0;; ++k) {
            const int column = l.x - x0;
            if (l.y < out->low[column]) out->low[column] = l.y;
            if (l.y > out->high[column]) out->high[column] = l.y;
            if (k == l.steps) break;
            line_advance(&l);
        }
    }
    return true;
}
