#include "costmap.h"

#include <stddef.h>
#include <string.h>

#include "inflation_stamps.h"

void costmap_clear(costmap *m, double origin_x, double origin_y) {
    const size_t cells = (size_t)m->frame.w * (size_t)m->frame.h;
    m->frame.ox = origin_x;
    m->frame.oy = origin_y;
    memset(m->obstacles, COST_FREE, cells);
    memset(m->master, COST_FREE, cells);
    m->inflate.need_reinflation = true;
    m->exact = m->cleared = (grid_window){0, 0, 0, 0};
    m->touched = (grid_window){0, 0, m->frame.w, m->frame.h};
}

static void shift_map(uint8_t *map, int w, int h, int dx, int dy) {
    if (abs(dx) >= w || abs(dy) >= h) {
        memset(map, COST_FREE, (size_t)w * (size_t)h);
        return;
    }
    // Rows lie one after the other, so that all of them move at once; then what came around the edges is cleared.
    const ptrdiff_t cells = (ptrdiff_t)w * h;
    const ptrdiff_t by = (ptrdiff_t)dy * w + dx;
    const ptrdiff_t keep = cells - (by > 0 ? by : -by);
    memmove(map + (by > 0 ? 0 : -by), map + (by > 0 ? by : 0), (size_t)keep);
    if (dy > 0) memset(map + (h - dy) * w, COST_FREE, (size_t)(dy * w));
    if (dy < 0) memset(map, COST_FREE, (size_t)(-dy * w));
    for (int x = dx > 0 ? w - dx : 0; x < (dx > 0 ? w : -dx); ++x)
        for (int y = 0; y < h; ++y) map[y * w + x] = COST_FREE;
}

void costmap_mark_cleared(costmap *m, double x, double y) {
    int cx, cy;
    if (!world_to_map(&m->frame, x, y, &cx, &cy)) return;
    grid_window *k = &m->cleared;
    if (window_empty(*k)) *k = (grid_window){cx, cy, cx + 1, cy + 1};
    k->x0 = cx < k->x0 ? cx : k->x0;
    k->xn = cx >= k->xn ? cx + 1 : k->xn;
    k->y0 = cy < k->y0 ? cy : k->y0;
    k->yn = cy >= k->yn ? cy + 1 : k->yn;
}

// One axis of what stays exact after a shift: obstacles that left the map cost nothing any more, and what is near the
// new cells has not been offered to them.
static void shift_exact(int *from, int *to, int cells, int by, int reach) {
    *from -= by;
    *to -= by;
    const int lost = by > 0 ? reach : by < 0 ? 2 * reach - by : 0;
    const int behind = by > 0 ? 2 * reach + by : by < 0 ? reach : 0;
    if (*from < lost) *from = lost;
    if (*to > cells - behind) *to = cells - behind;
}

// Costmap2D::updateOrigin for a window centred on the robot; whole cells only.
static void follow(costmap *m, double x, double y) {
    grid_frame *g = &m->frame;
    const double half_w = (g->w - 1 + 0.5) * g->res / 2;
    const double half_h = (g->h - 1 + 0.5) * g->res / 2;
    const double fx = (x - half_w - g->ox) / g->res;
    const double fy = (y - half_h - g->oy) / g->res;
    if (!(fabs(fx) < 1e9 && fabs(fy) < 1e9)) return;
    const int dx = (int)fx;
    const int dy = (int)fy;
    if (dx == 0 && dy == 0) return;
    g->ox = g->ox + dx * g->res;
    g->oy = g->oy + dy * g->res;
    shift_map(m->obstacles, g->w, g->h, dx, dy);
    shift_map(m->master, g->w, g->h, dx, dy);
    shift_exact(&m->exact.x0, &m->exact.xn, g->w, dx, m->inflate.cells);
    shift_exact(&m->exact.y0, &m->exact.yn, g->h, dy, m->inflate.cells);
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
    const int w = g->w;
    const int h = g->h;
    if (m->rolling) follow(m, pose[0], pose[1]);

    bounds b = {pose[0], pose[1], pose[0], pose[1]};
    obstacles_observe(m->obstacles, g, seen, set->raytrace_range, set->obstacle_range, &b);
    const double c = cos(pose[2]);
    const double s = sin(pose[2]);
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i)
        bounds_touch(&b, pose[0] + (shape->x[i] * c - shape->y[i] * s), pose[1] + (shape->x[i] * s + shape->y[i] * c));
    if (m->inflate.need_reinflation) m->exact = (grid_window){0, 0, 0, 0};
    inflation_bounds(&m->inflate, &b.min_x, &b.min_y, &b.max_x, &b.max_y);

    const int x0 = world_to_map_clamped(b.min_x, g->ox, w, g->res);
    const int y0 = world_to_map_clamped(b.min_y, g->oy, h, g->res);
    const int xn = world_to_map_clamped(b.max_x, g->ox, w, g->res) + 1;
    const int yn = world_to_map_clamped(b.max_y, g->oy, h, g->res) + 1;
    m->touched = (grid_window){0, 0, 0, 0};
    if (xn < x0 || yn < y0) return;
    clear_footprint(m, shape, pose);
    const grid_window window = {x0, y0, xn, yn};
    if (inflation_stamps_exact(&m->inflate) && !window_empty(window_overlap(m->exact, window))) {
        inflation_stamps_update(&m->inflate, scratch, m->obstacles, m->master, w, h, window, m->exact, m->cleared);
        m->exact = window;
    } else {
        for (int y = y0; y < yn; ++y) memcpy(m->master + y * w + x0, m->obstacles + y * w + x0, (size_t)(xn - x0));
        const bool stamped = inflation_run(&m->inflate, scratch, m->master, w, h, x0, y0, xn, yn);
        m->exact = stamped ? window : (grid_window){0, 0, 0, 0};
    }
    m->cleared = (grid_window){0, 0, 0, 0};
    const int spread = 2 * m->inflate.cells;
    m->touched = (grid_window){x0 > spread ? x0 - spread : 0, y0 > spread ? y0 - spread : 0,
                               xn + spread < w ? xn + spread : w, yn + spread < h ? yn + spread : h};
}
