#include "obstacles.h"

#include "wide.h"

enum { CHUNK = OBSERVATION_PADDING };  // beams worked on together

// A beam that leaves the map: cut at its edges, as ObstacleLayer::raytraceFreespace does. False where nothing is left.
static bool cut_at_edges(const grid_frame *g, const observation *seen, double end_x, double end_y, double *x, double *y,
                         int *cx, int *cy) {
    double wx = *x;
    double wy = *y;
    const double a = wx - seen->ox;
    const double c = wy - seen->oy;
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
    *x = wx;
    *y = wy;
    return world_to_map(g, wx, wy, cx, cy);
}

// Beams CHUNK at a time, the last chunk filled up with beams that end nowhere.
typedef struct {
    double x[CHUNK], y[CHUNK];    // m, where the beams end on the map
    double square[CHUNK];         // m^2 from the sensor; infinite off the map
    double cx[CHUNK], cy[CHUNK];  // cells, not rounded; -1 off the map
    int32_t cell[CHUNK];
    bool cut;  // some left the map and were cut
} beams;

WIDE static void find_cells(const grid_frame *g, const observation *seen, int from, int count, beams *p) {
    const double end_x = g->ox + g->w * g->res;
    const double end_y = g->oy + g->h * g->res;
    const double ox = g->ox;
    const double oy = g->oy;
    const double res = g->res;
    const double w = g->w;
    const double h = g->h;
    const double sx = seen->ox;
    const double sy = seen->oy;
    const float *xs = seen->x + from;
    const float *ys = seen->y + from;
    for (int i = 0; i < CHUNK; ++i) {
        const double x = xs[i];
        const double y = ys[i];
        const double fx = (x - ox) / res;
        const double fy = (y - oy) / res;
        const bool inside = (x >= ox) & (y >= oy) & (fx < w) & (fy < h) & (x <= end_x) & (y <= end_y);
        p->x[i] = x;
        p->y[i] = y;
        p->square[i] = inside ? (x - sx) * (x - sx) + (y - sy) * (y - sy) : INFINITY;
        p->cx[i] = inside ? fx : -1.0;
        p->cy[i] = inside ? fy : -1.0;
    }
    for (int i = count; i < CHUNK; ++i) {
        p->cx[i] = p->cy[i] = -1.0;
        p->square[i] = INFINITY;
    }
    double least = 0;
    for (int i = 0; i < count; ++i) least = p->cx[i] < least ? p->cx[i] : least;
    p->cut = false;
    for (int i = 0; least < 0 && i < count; ++i)
        if (p->x[i] < ox || p->y[i] < oy || p->x[i] > end_x || p->y[i] > end_y) {
            int cx, cy;
            p->cut = true;
            if (!cut_at_edges(g, seen, end_x, end_y, &p->x[i], &p->y[i], &cx, &cy)) continue;
            p->cx[i] = cx;
            p->cy[i] = cy;
            p->square[i] = (p->x[i] - sx) * (p->x[i] - sx) + (p->y[i] - sy) * (p->y[i] - sy);
        }
    for (int i = 0; i < CHUNK; ++i) p->cell[i] = (int32_t)p->cy[i] * g->w + (int32_t)p->cx[i];
}

// Loops of one plain operation each, so that they become vector code.
ALWAYS_INLINE void extend_axis(const double *v, const double *square, double reach, double *low, double *high) {
    double a[CHUNK], b[CHUNK];
    for (int i = 0; i < CHUNK; ++i) a[i] = square[i] < reach ? v[i] : INFINITY;
    for (int i = 0; i < CHUNK; ++i) b[i] = square[i] < reach ? v[i] : -INFINITY;
#define FOLD(n)                                                                 \
    for (int i = 0; i < (n); ++i) a[i] = a[i + (n)] < a[i] ? a[i + (n)] : a[i]; \
    for (int i = 0; i < (n); ++i) b[i] = b[i + (n)] > b[i] ? b[i + (n)] : b[i];
    FOLD(CHUNK / 2)
    FOLD(CHUNK / 4)
    FOLD(CHUNK / 8)
#undef FOLD
    for (int i = 0; i < CHUNK / 8; ++i) {
        *low = a[i] < *low ? a[i] : *low;
        *high = b[i] > *high ? b[i] : *high;
    }
}

// Widens `b` by the ends of the beams nearer than `reach` (m^2).
WIDE static void extend_bounds(const beams *p, double reach, bounds *b) {
    extend_axis(p->x, p->square, reach, &b->min_x, &b->max_x);
    extend_axis(p->y, p->square, reach, &b->min_y, &b->max_y);
}

// Widens `b` by how far the beams clear. Only the extremes of those beyond the range are worth a hypot.
static void extend_by_clearing(const observation *seen, double range, int count, const beams *p, bounds *b) {
    const double sx = seen->ox;
    const double sy = seen->oy;
    const double far = 0.999 * range * range;
    const double close = 1e-6;
    bounds ends = {INFINITY, INFINITY, -INFINITY, -INFINITY};
    extend_bounds(p, far, &ends);
    if (ends.min_x <= ends.max_x) {  // rounding keeps order: the extremes stay the extremes
        bounds_touch(b, sx + (ends.min_x - sx), sy + (ends.min_y - sy));
        bounds_touch(b, sx + (ends.max_x - sx), sy + (ends.max_y - sy));
    }
    // None of them gets farther than the range.
    if (b->min_x < sx - range - close && b->max_x > sx + range + close && b->min_y < sy - range - close &&
        b->max_y > sy + range + close)
        return;
    bounds distant = {INFINITY, INFINITY, -INFINITY, -INFINITY};
    double tx[CHUNK], ty[CHUNK];
    int beyond[CHUNK];
    int beyond_count = 0;
    for (int i = 0; i < count; ++i) {
        if (p->cx[i] < 0 || p->square[i] < far) continue;
        const double scale = fmin(1.0, range / sqrt(p->square[i]));
        tx[beyond_count] = sx + (p->x[i] - sx) * scale;
        ty[beyond_count] = sy + (p->y[i] - sy) * scale;
        bounds_touch(&distant, tx[beyond_count], ty[beyond_count]);
        beyond[beyond_count++] = i;
    }
    if (distant.min_x > b->min_x + close && distant.min_y > b->min_y + close && distant.max_x < b->max_x - close &&
        distant.max_y < b->max_y - close)
        return;
    for (int k = 0; k < beyond_count; ++k) {
        if (tx[k] > distant.min_x + close && ty[k] > distant.min_y + close && tx[k] < distant.max_x - close &&
            ty[k] < distant.max_y - close)
            continue;
        const double dx = p->x[beyond[k]] - sx;
        const double dy = p->y[beyond[k]] - sy;
        const double scale = fmin(1.0, range / hypot(dx, dy));
        bounds_touch(b, sx + dx * scale, sy + dy * scale);
    }
}

// A point beyond the map's edge can still round to a cell of it; its beam was cut.
static int mark_cut(const grid_frame *g, const observation *seen, int from, int count, double near, const beams *p,
                    int marks, bounds *b) {
    for (int i = 0; i < count; ++i) {
        const double x = seen->x[from + i];
        const double y = seen->y[from + i];
        const double dx = x - seen->ox;
        const double dy = y - seen->oy;
        int cx, cy;
        if ((x == p->x[i] && y == p->y[i]) || !(dx * dx + dy * dy < near) || !world_to_map(g, x, y, &cx, &cy)) continue;
        seen->marks[marks++] = cy * g->w + cx;
        bounds_touch(b, x, y);
    }
    return marks;
}

void obstacles_observe(uint8_t *layer, const grid_frame *g, const observation *seen, double raytrace_range,
                       double obstacle_range, bounds *b) {
    raytrace_clearing clearing = {.lines = seen->lines, .reach = cell_distance(raytrace_range, g->res)};
    const bool on_map = world_to_map(g, seen->ox, seen->oy, &clearing.x0, &clearing.y0);
    if (on_map) bounds_touch(b, seen->ox, seen->oy);
    const double near = obstacle_range * obstacle_range;
    int marks = 0;
    int last_line = -1;
    int last_mark = -1;
    for (int from = 0; from < seen->count; from += CHUNK) {
        const int count = seen->count - from < CHUNK ? seen->count - from : CHUNK;
        beams p;
        find_cells(g, seen, from, count, &p);
        if (on_map) extend_by_clearing(seen, raytrace_range, count, &p, b);
        // Neighbouring beams often end in the same cell.
        for (int i = 0; i < count && on_map; ++i) {
            if (p.cell[i] == last_line || p.cx[i] < 0) continue;
            raytrace_clearing_add(&clearing, (int)p.cx[i], (int)p.cy[i]);
            last_line = p.cell[i];
        }
        if (p.cut) {
            marks = mark_cut(g, seen, from, count, near, &p, marks, b);
            for (int i = 0; i < count; ++i)
                if (p.x[i] != seen->x[from + i] || p.y[i] != seen->y[from + i]) p.square[i] = INFINITY;
        }
        for (int i = 0; i < count; ++i) {
            if (p.cell[i] == last_mark || !(p.square[i] < near)) continue;
            seen->marks[marks++] = last_mark = p.cell[i];
        }
        extend_bounds(&p, near, b);
    }
    // What is marked again need not be tested; most cells are.
    for (int i = 0; i < marks; ++i) layer[seen->marks[i]] = COST_FREE;
    if (on_map) raytrace_clearing_run(&clearing, layer, g->w, g->h);
    for (int i = 0; i < marks; ++i) layer[seen->marks[i]] = COST_LETHAL;
}
