#include "obstacles.h"

#include <string.h>

enum { CHUNK = 64 };  // beams worked on together

// A beam that leaves the map: cut at its edges, as ObstacleLayer::raytraceFreespace does. False where nothing is left.
static bool cut_at_edges(const grid_frame *g, const observation *seen, double end_x, double end_y, double *x,
                         double *y) {
    double wx = *x, wy = *y;
    const double a = wx - seen->ox, c = wy - seen->oy;
    if (wx < g->ox) {
        wy = seen->oy + c * ((g->ox - seen->ox) / a);
        wx = g->ox;
    }
    if (wy < g->oy) {
        wx = seen->ox + a * ((g->oy - seen->oy) / c);
        wy = g->oy;
    }
    if (wx > end_x) {
        wy = seen->oy + c * ((end_x - seen->ox) / a);
        wx = end_x - .001;
    }
    if (wy > end_y) {
        wx = seen->ox + a * ((end_y - seen->oy) / c);
        wy = end_y - .001;
    }
    *x = wx, *y = wy;
    int mx, my;
    return world_to_map(g, wx, wy, &mx, &my);
}

typedef struct {
    double x[CHUNK], y[CHUNK];      // m, where the beams end on the map
    double tx[CHUNK], ty[CHUNK];    // m, how far they free: to a micrometre where beyond the range
    int32_t cx[CHUNK], cy[CHUNK];   // cells of (x, y), -1 off the map
} beams;

static void find_cells(const grid_frame *g, const observation *seen, int from, int count, beams *p) {
    const double end_x = g->ox + g->w * g->res, end_y = g->oy + g->h * g->res;
    const double ox = g->ox, oy = g->oy, res = g->res, w = g->w, h = g->h;
    int leave = 0;
    for (int i = 0; i < count; ++i) {
        const double x = seen->x[from + i], y = seen->y[from + i];
        p->x[i] = x, p->y[i] = y;
        leave += (x < ox) | (y < oy) | (x > end_x) | (y > end_y);
    }
    if (leave)
        for (int i = 0; i < count; ++i)
            if (p->x[i] < ox || p->y[i] < oy || p->x[i] > end_x || p->y[i] > end_y)
                if (!cut_at_edges(g, seen, end_x, end_y, &p->x[i], &p->y[i])) p->x[i] = p->y[i] = NAN;
    for (int i = 0; i < count; ++i) {
        const double fx = (p->x[i] - ox) / res, fy = (p->y[i] - oy) / res;
        const int inside = (p->x[i] >= ox) & (p->y[i] >= oy) & (fx < w) & (fy < h);
        p->cx[i] = (int32_t)(inside ? fx : -1.0);
        p->cy[i] = (int32_t)(inside ? fy : -1.0);
    }
}

static const bounds NOWHERE = {INFINITY, INFINITY, -INFINITY, -INFINITY};

// Widens `b` by how far the beams free. Only the extremes of those beyond the range are worth a hypot.
static void touch_beams(const observation *seen, double range, int count, beams *p, bounds *b) {
    const double sx = seen->ox, sy = seen->oy, far = 0.999 * range * range, close = 1e-6;
    bounds distant = NOWHERE;
    for (int i = 0; i < count; ++i) {
        const double dx = p->x[i] - sx, dy = p->y[i] - sy, square = dx * dx + dy * dy;
        if (p->cx[i] < 0) continue;
        if (square >= far) {
            const double scale = fmin(1.0, range / sqrt(square));
            p->tx[i] = sx + dx * scale, p->ty[i] = sy + dy * scale;
            bounds_touch(&distant, p->tx[i], p->ty[i]);
        } else {
            p->tx[i] = sx + dx, p->ty[i] = sy + dy;
            bounds_touch(b, p->tx[i], p->ty[i]);
        }
    }
    if (distant.min_x > b->min_x + close && distant.min_y > b->min_y + close && distant.max_x < b->max_x - close &&
        distant.max_y < b->max_y - close)
        return;
    for (int i = 0; i < count; ++i) {
        if (p->cx[i] < 0) continue;
        if (p->tx[i] > distant.min_x + close && p->ty[i] > distant.min_y + close && p->tx[i] < distant.max_x - close &&
            p->ty[i] < distant.max_y - close)
            continue;
        const double dx = p->x[i] - sx, dy = p->y[i] - sy;
        const double scale = dx * dx + dy * dy >= far ? fmin(1.0, range / hypot(dx, dy)) : 1.0;
        bounds_touch(b, sx + dx * scale, sy + dy * scale);
    }
}

void obstacles_observe(uint8_t *layer, const grid_frame *g, const observation *seen, double raytrace_range,
                       double obstacle_range, bounds *b) {
    line_fan fan = {.lines = seen->lines};
    int x0, y0;
    const bool on_map = world_to_map(g, seen->ox, seen->oy, &x0, &y0);
    if (on_map) {
        fan_start(&fan, x0, y0, cell_distance(raytrace_range, g->res));
        bounds_touch(b, seen->ox, seen->oy);
    }
    int marks = 0, last_x = -1, last_y = -1;
    const double near = obstacle_range * obstacle_range;
    for (int from = 0; from < seen->count; from += CHUNK) {
        const int count = seen->count - from < CHUNK ? seen->count - from : CHUNK;
        beams p;
        find_cells(g, seen, from, count, &p);
        for (int i = 0; i < count; ++i) {
            const double x = seen->x[from + i], y = seen->y[from + i], dx = x - seen->ox, dy = y - seen->oy;
            int cx = p.cx[i], cy = p.cy[i];
            if (!(dx * dx + dy * dy < near)) continue;
            if (x == p.x[i] && y == p.y[i] ? cx < 0 : !world_to_map(g, x, y, &cx, &cy)) continue;
            seen->marks[marks++] = cy * g->w + cx;
            bounds_touch(b, x, y);
        }
        if (!on_map) continue;
        touch_beams(seen, raytrace_range, count, &p, b);
        for (int i = 0; i < count; ++i) {
            if (p.cx[i] < 0) continue;
            // Neighbouring beams often end in the same cell.
            if (p.cx[i] != last_x || p.cy[i] != last_y) fan_add(&fan, p.cx[i], p.cy[i]);
            last_x = p.cx[i], last_y = p.cy[i];
        }
    }
    // What is marked again need not be looked at; most cells are.
    for (int i = 0; i < marks; ++i) layer[seen->marks[i]] = COST_FREE;
    if (on_map) fan_free(&fan, layer, g->w, g->h);
    for (int i = 0; i < marks; ++i) layer[seen->marks[i]] = COST_LETHAL;
}
