#include "costmap.h"

#include <string.h>

typedef struct {
    double min_x, min_y, max_x, max_y;
} bounds;

static inline void touch(bounds *b, double x, double y) {
    if (x < b->min_x) b->min_x = x;
    if (y < b->min_y) b->min_y = y;
    if (x > b->max_x) b->max_x = x;
    if (y > b->max_y) b->max_y = y;
}

void costmap_clear(costmap *m, double origin_x, double origin_y) {
    const size_t cells = (size_t)m->frame.w * (size_t)m->frame.h;
    m->frame.ox = origin_x, m->frame.oy = origin_y;
    memset(m->obstacles, COST_FREE, cells);
    memset(m->master, COST_FREE, cells);
    m->inflate.need_reinflation = true;
    m->touched = (grid_window){0, 0, m->frame.w, m->frame.h};
}

static void shift_map(uint8_t *map, int w, int h, int dx, int dy) {
    if (abs(dx) >= w || abs(dy) >= h) {
        memset(map, COST_FREE, (size_t)w * (size_t)h);
        return;
    }
    const int keep = w - abs(dx), from = dx > 0 ? dx : 0, to = dx > 0 ? 0 : -dx;
    for (int i = 0; i < h; ++i) {
        const int y = dy > 0 ? i : h - 1 - i, source = y + dy;
        uint8_t *row = map + y * w;
        if (source < 0 || source >= h) {
            memset(row, COST_FREE, (size_t)w);
            continue;
        }
        memmove(row + to, map + source * w + from, (size_t)keep);
        memset(dx > 0 ? row + keep : row, COST_FREE, (size_t)(w - keep));
    }
}

// Costmap2D::updateOrigin for a window centred on the robot; whole cells only.
static void follow(costmap *m, double x, double y) {
    grid_frame *g = &m->frame;
    const double half_w = (g->w - 1 + 0.5) * g->res / 2, half_h = (g->h - 1 + 0.5) * g->res / 2;
    const double fx = (x - half_w - g->ox) / g->res, fy = (y - half_h - g->oy) / g->res;
    if (!(fabs(fx) < 1e9 && fabs(fy) < 1e9)) return;
    const int dx = (int)fx, dy = (int)fy;
    if (dx == 0 && dy == 0) return;
    g->ox = g->ox + dx * g->res;
    g->oy = g->oy + dy * g->res;
    shift_map(m->obstacles, g->w, g->h, dx, dy);
    shift_map(m->master, g->w, g->h, dx, dy);
}

// Frees the cells between sensor and hit, at most `reach` cells of them (Costmap2D::raytraceLine).
static inline void clear_line(costmap *m, int x0, int y0, int x1, int y1, int reach) {
    const int dx = x1 - x0, dy = y1 - y0;
    const grid_line l = line_between(x0, y0, x1, y1);
    int steps = l.steps;
    if (dx * dx + dy * dy >= reach * reach) {
        const double scale = fmin(1.0, reach / hypot(dx, dy));
        steps = (int)(scale * l.steps);
    }
    const int w = m->frame.w, every = l.dx2 + l.dy2 * w, extra = l.dx1 + l.dy1 * w;
    uint8_t *at = m->obstacles + y0 * w + x0;
    int num = l.num;
    *at = COST_FREE;
    for (int i = 0; i < steps; ++i) {
        num += l.add;
        const bool over = num >= l.den;
        num -= over ? l.den : 0;
        at += every + (over ? extra : 0);
        *at = COST_FREE;
    }
}

static void raytrace(costmap *m, const observation *seen, double range, bounds *b) {
    const grid_frame *g = &m->frame;
    int x0, y0;
    if (!world_to_map(g, seen->ox, seen->oy, &x0, &y0)) return;
    const double end_x = g->ox + g->w * g->res, end_y = g->oy + g->h * g->res;
    const int reach = cell_distance(range, g->res);
    int last_x = -1, last_y = -1;
    touch(b, seen->ox, seen->oy);
    for (int i = 0; i < seen->count; ++i) {
        double wx = seen->x[i], wy = seen->y[i];
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
        int x1, y1;
        if (!world_to_map(g, wx, wy, &x1, &y1)) continue;
        // Neighbouring beams often end in the same cell.
        if (x1 != last_x || y1 != last_y) clear_line(m, x0, y0, x1, y1, reach);
        last_x = x1, last_y = y1;
        const double dx = wx - seen->ox, dy = wy - seen->oy;
        const bool beyond = dx * dx + dy * dy >= 0.999 * range * range;
        const double scale = beyond ? fmin(1.0, range / hypot(dx, dy)) : 1.0;
        touch(b, seen->ox + dx * scale, seen->oy + dy * scale);
    }
}

static void mark(costmap *m, const observation *seen, double range, bounds *b) {
    for (int i = 0; i < seen->count; ++i) {
        const double px = seen->x[i], py = seen->y[i];
        const double square = (px - seen->ox) * (px - seen->ox) + (py - seen->oy) * (py - seen->oy);
        int x, y;
        if (!(square < range * range) || !world_to_map(&m->frame, px, py, &x, &y)) continue;
        m->obstacles[y * m->frame.w + x] = COST_LETHAL;
        touch(b, px, py);
    }
}

static void clear_footprint(costmap *m, const footprint_shape *shape, const double pose[3]) {
    footprint_columns robot;
    if (!footprint_fill(shape, &m->frame, pose[0], pose[1], pose[2], &robot)) return;
    for (int i = 0; i < robot.count; ++i)
        for (int y = robot.low[i]; y <= robot.high[i]; ++y) m->obstacles[y * m->frame.w + robot.x0 + i] = COST_FREE;
}

void costmap_update(costmap *m, inflation_scratch *scratch, const planner_settings *set, const footprint_shape *shape,
                    const observation *seen, const double pose[3]) {
    const grid_frame *g = &m->frame;
    const int w = g->w, h = g->h;
    if (m->rolling) follow(m, pose[0], pose[1]);

    bounds b = {pose[0], pose[1], pose[0], pose[1]};
    raytrace(m, seen, set->raytrace_range, &b);
    mark(m, seen, set->obstacle_range, &b);
    const double c = cos(pose[2]), s = sin(pose[2]);
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i)
        touch(&b, pose[0] + (shape->x[i] * c - shape->y[i] * s), pose[1] + (shape->x[i] * s + shape->y[i] * c));
    inflation_bounds(&m->inflate, &b.min_x, &b.min_y, &b.max_x, &b.max_y);

    const int x0 = world_to_map_clamped(b.min_x, g->ox, w, g->res), y0 = world_to_map_clamped(b.min_y, g->oy, h, g->res);
    const int xn = world_to_map_clamped(b.max_x, g->ox, w, g->res) + 1;
    const int yn = world_to_map_clamped(b.max_y, g->oy, h, g->res) + 1;
    m->touched = (grid_window){0, 0, 0, 0};
    if (xn < x0 || yn < y0) return;
    clear_footprint(m, shape, pose);
    for (int y = y0; y < yn; ++y) memcpy(m->master + y * w + x0, m->obstacles + y * w + x0, (size_t)(xn - x0));
    inflation_run(&m->inflate, scratch, m->master, w, h, x0, y0, xn, yn);
    const int spread = 2 * m->inflate.cells;
    m->touched = (grid_window){x0 > spread ? x0 - spread : 0, y0 > spread ? y0 - spread : 0,
                               xn + spread < w ? xn + spread : w, yn + spread < h ? yn + spread : h};
}
