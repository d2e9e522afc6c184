#include "costmap.h"

#include <string.h>

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
    obstacles_observe(m->obstacles, g, seen, set->raytrace_range, set->obstacle_range, &b);
    const double c = cos(pose[2]), s = sin(pose[2]);
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i)
        bounds_touch(&b, pose[0] + (shape->x[i] * c - shape->y[i] * s), pose[1] + (shape->x[i] * s + shape->y[i] * c));
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
