#include "footprint.h"

static double pad(double v, double padding) { return v + (v > 0 ? padding : v < 0 ? -padding : 0.0); }

footprint_shape footprint_make(double half_length, double half_width, double padding) {
    const double l = pad(half_length, padding);
    const double w = pad(half_width, padding);
    return (footprint_shape){.x = {-l, -l, l, l}, .y = {-w, w, w, -w}, .reach = hypot(l, w)};
}

int footprint_line_reach(const footprint_shape *f, double res) {
    return (int)ceil(2 * fmax(fabs(f->x[0]), fabs(f->y[0])) / res) + 1;
}

void footprint_lines_make(footprint_lines *l, int reach, int row) {
    l->reach = reach;
    for (int dy = -reach; dy <= reach; ++dy)
        for (int dx = -reach; dx <= reach; ++dx) {
            int16_t *to = l->cells + footprint_line_at(l, dx, dy);
            grid_line line = line_between(0, 0, dx, dy);
            for (int i = 0; i <= reach; ++i) {
                to[i] = (int16_t)(line.y * row + line.x);
                if (i < line.steps) line_advance(&line);
            }
        }
}

int footprint_outline_cost(const footprint_shape *f, const footprint_lines *l, const grid_frame *g, const uint8_t *cost,
                           double x, double y, double cos_th, double sin_th) {
    grid_cell c[FOOTPRINT_CORNERS];
    return footprint_corner_cells(f, g, x, y, cos_th, sin_th, c) ? footprint_cells_cost(l, g, cost, c) : -1;
}

// All four lines at a time, all to the same length: no branch depends on the pose.
int footprint_cells_cost(const footprint_lines *l, const grid_frame *g, const uint8_t *cost,
                         const grid_cell c[FOOTPRINT_CORNERS]) {
    const uint8_t *from[FOOTPRINT_CORNERS];
    const int16_t *line[FOOTPRINT_CORNERS];
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
        const grid_cell a = c[i];
        const grid_cell b = c[(i + 1) % FOOTPRINT_CORNERS];
        from[i] = cost + a.y * g->w + a.x;
        line[i] = l->cells + footprint_line_at(l, b.x - a.x, b.y - a.y);
    }
    int worst[FOOTPRINT_CORNERS] = {0};
    for (int k = 0; k <= l->reach; ++k)
        for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
            const int here = from[i][line[i][k]];
            worst[i] = here > worst[i] ? here : worst[i];
        }
    const int a = worst[0] > worst[1] ? worst[0] : worst[1];
    const int b = worst[2] > worst[3] ? worst[2] : worst[3];
    const int most = a > b ? a : b;
    return most >= COST_LETHAL ? -1 : most;
}

bool footprint_fill(const footprint_shape *f, const grid_frame *g, double x, double y, double yaw,
                    footprint_columns *out) {
    grid_cell c[FOOTPRINT_CORNERS];
    out->count = 0;
    if (!footprint_corner_cells(f, g, x, y, cos(yaw), sin(yaw), c)) return false;
    int x0 = c[0].x;
    int x1 = c[0].x;
    for (int i = 1; i < FOOTPRINT_CORNERS; ++i) {
        if (c[i].x < x0) x0 = c[i].x;
        if (c[i].x > x1) x1 = c[i].x;
    }
    if (x1 - x0 >= FOOTPRINT_COLUMNS_MAX) return false;
    out->x0 = x0;
    out->count = x1 - x0 + 1;
    for (int i = 0; i < out->count; ++i) {
        out->low[i] = g->h;
        out->high[i] = -1;
    }
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
        const grid_cell a = c[i];
        const grid_cell b = c[(i + 1) % FOOTPRINT_CORNERS];
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
