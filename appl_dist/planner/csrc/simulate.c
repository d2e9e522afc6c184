#include "simulate.h"

#include <string.h>

static inline double towards(double target, double now, double step) {  // computeNewVelocity
    if (target - now >= 0) return now + step < target ? now + step : target;
    return now - step > target ? now - step : target;
}

int simulate_steps(const rollout_planner *p, double v, double w) {
    const planner_settings *s = p->set;
    const double n = fmax(fabs(v) * s->sim_time / s->sim_granularity, fabs(w) / s->angular_sim_granularity) + 0.5;
    if (n >= p->steps_max) return p->steps_max;
    return n >= 1 ? (int)n : 1;
}

static double total_cost(const rollout_planner *p, double path, double goal, double occ) {
    return p->pdist * path + goal * p->gdist + p->par.occdist_scale * occ;
}

void simulate(rollout_planner *p, motion m, double v, double w, rollout *out) {
    const planner_settings *s = p->set;
    const int n = simulate_steps(p, v, w), impossible = p->frame.w * p->frame.h;
    const double dt = s->sim_time / n;
    double path = 0, goal = 0, occ = 0;
    out->v = v, out->w = w, out->cost = -1, out->points = 0;
    int i = 0;
    for (; i < n; ++i) {
        int cx, cy;
        if (!world_to_map(&p->frame, m.x, m.y, &cx, &cy)) break;
        const double c = cos(m.th), d = sin(m.th);
        const int outline = footprint_outline_cost(&p->shape, &p->frame, p->cost, m.x, m.y, c, d);
        if (outline < 0) break;
        occ = fmax(fmax(occ, outline), p->cost[cy * p->frame.w + cx]);
        path = wavefront_ros_value(&p->path, cx, cy);
        goal = wavefront_ros_value(&p->goal, cx, cy);
        if (goal >= impossible || path >= impossible) {
            out->cost = -2;
            break;
        }
        out->x[i] = m.x, out->y[i] = m.y, out->th[i] = m.th;
        m.v = towards(v, m.v, s->acc_lim_x * dt);
        m.w = towards(w, m.w, s->acc_lim_theta * dt);
        m.x = m.x + m.v * c * dt;
        m.y = m.y + m.v * d * dt;
        m.th = m.th + m.w * dt;
    }
    out->points = i;
    if (i == n) out->cost = total_cost(p, path, goal, occ);
    p->rollouts += 1;
    p->rollout_steps += i < n ? i + 1 : n;
    if (p->trace && p->trace->count < p->trace->capacity)
        p->trace->rows[p->trace->count++] = (rollout_row){v, w, out->cost, path, goal, occ, n, i};
}

static const heading_run *headings(rollout_planner *p, const motion *m, double w, int n, int column) {
    const bool shared = column < HEADING_RUNS && n <= HEADING_STEPS;
    heading_run *r = &p->runs[shared ? column : HEADING_RUNS];
    if (shared && r->w == w && r->steps == n) return r;
    const double dt = p->set->sim_time / n, step = p->set->acc_lim_theta * dt;
    double th = m->th, rate = m->w;
    for (int i = 0; i < n; ++i) {
        r->th[i] = th;
        if (i > 0 && th == r->th[i - 1]) {
            r->cos_th[i] = r->cos_th[i - 1], r->sin_th[i] = r->sin_th[i - 1];
        } else {
            r->cos_th[i] = cos(th), r->sin_th[i] = sin(th);
        }
        rate = towards(w, rate, step);
        th = th + rate * dt;
    }
    r->w = w, r->steps = n;
    return r;
}

bool simulate_if_better(rollout_planner *p, const motion *m, double v, double w, int column, double limit, bool ties,
                        double *ahead, rollout *out) {
    const planner_settings *s = p->set;
    const int n = simulate_steps(p, v, w);
    const double dt = s->sim_time / n, step = s->acc_lim_x * dt;
    const heading_run *r = headings(p, m, w, n, column);
    double x = m->x, y = m->y, speed = m->v;
    for (int i = 0; i < n; ++i) {
        p->xs[i] = x, p->ys[i] = y;
        speed = towards(v, speed, step);
        x = x + speed * r->cos_th[i] * dt;
        y = y + speed * r->sin_th[i] * dt;
    }
    // What the real code would do at most; it stops earlier where a roll-out hits something.
    p->rollouts += 1;
    p->rollout_steps += n;

    const grid_frame *g = &p->frame;
    int cx, cy;
    if (!world_to_map(g, p->xs[n - 1], p->ys[n - 1], &cx, &cy)) return false;
    const int path = wavefront_distance(&p->path, cx, cy);
    if (path >= WAVE_LIMIT) return false;
    if (limit >= 0 && p->pdist * path > limit) return false;  // spares growing the goal's wave
    const int goal = wavefront_distance(&p->goal, cx, cy);
    if (goal >= WAVE_LIMIT) return false;
    double cost = total_cost(p, path, goal, 0);
    if (limit >= 0 && (ties ? cost > limit : cost >= limit)) return false;

    double new_ahead = 0;
    if (ahead) {
        int ax, ay;
        const int last = n - 1;
        if (!world_to_map(g, p->xs[last] + s->heading_lookahead * r->cos_th[last],
                          p->ys[last] + s->heading_lookahead * r->sin_th[last], &ax, &ay))
            return false;
        new_ahead = wavefront_ros_value(&p->goal, ax, ay);
        if (!(new_ahead < *ahead)) return false;
    }

    int occ = 0;
    const int r0 = p->near_radius;
    for (int i = n - 1; i >= 0; --i) {  // far points fail first
        if (!world_to_map(g, p->xs[i], p->ys[i], &cx, &cy)) return false;
        if (wavefront_distance(&p->path, cx, cy) >= WAVE_LIMIT) return false;
        if (wavefront_distance(&p->goal, cx, cy) >= WAVE_LIMIT) return false;
        const int at = cy * g->w + cx;
        const bool inside = cx >= r0 && cy >= r0 && cx < g->w - r0 && cy < g->h - r0;
        if (inside && p->near_max[at] <= occ) continue;  // nothing under the robot could raise the cost
        const int outline =
            footprint_outline_cost(&p->shape, g, p->cost, p->xs[i], p->ys[i], r->cos_th[i], r->sin_th[i]);
        if (outline < 0) return false;
        const int worst = outline > p->cost[at] ? outline : p->cost[at];
        if (worst <= occ) continue;
        occ = worst;
        cost = total_cost(p, path, goal, occ);
        if (limit >= 0 && (ties ? cost > limit : cost >= limit)) return false;
    }
    out->v = v, out->w = w, out->cost = cost, out->points = n;
    memcpy(out->x, p->xs, sizeof(double) * (size_t)n);
    memcpy(out->y, p->ys, sizeof(double) * (size_t)n);
    memcpy(out->th, r->th, sizeof(double) * (size_t)n);
    if (ahead) *ahead = new_ahead;
    return true;
}

// near_max[c] = highest cost in the square of `near_radius` around c: windows double until they cover it.
static void window_max(const uint8_t *restrict from, uint8_t *restrict to, int n, int shift) {
    for (int i = 0; i < n - shift; ++i) to[i] = from[i] > from[i + shift] ? from[i] : from[i + shift];
}

static void slide_max(uint8_t *map, uint8_t *tmp, int cells, int stride, int width) {
    // map[i] becomes the maximum of `width` entries starting at i, `stride` apart. Rows run together: callers
    // leave alone the cells near the border, whose windows wrap.
    int have = 1;
    while (have < width) {
        const int shift = have * 2 <= width ? have : width - have;
        window_max(map, tmp, cells, shift * stride);
        memcpy(tmp + cells - shift * stride, map + cells - shift * stride, (size_t)(shift * stride));
        memcpy(map, tmp, (size_t)cells);
        have += shift;
    }
}

static void build_near_max(rollout_planner *p) {
    const int w = p->frame.w, h = p->frame.h, r = p->near_radius, cells = w * h;
    memcpy(p->near_max, p->cost, (size_t)cells);
    if (2 * r + 1 > w || 2 * r + 1 > h) {  // a map smaller than the robot: no shortcut
        memset(p->near_max, COST_UNKNOWN, (size_t)cells);
        return;
    }
    slide_max(p->near_max, p->near_tmp, cells, 1, 2 * r + 1);
    slide_max(p->near_max, p->near_tmp, cells, w, 2 * r + 1);
    const int centre = r * w + r;  // windows started at their corner; centre them
    memmove(p->near_max + centre, p->near_max, (size_t)(cells - centre));
}

void simulate_prepare(rollout_planner *p) {
    for (int i = 0; i <= HEADING_RUNS; ++i) p->runs[i].steps = 0;
    if (!p->trace) build_near_max(p);
}
