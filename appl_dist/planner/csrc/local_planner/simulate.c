#include "simulate.h"

int simulate_steps(const rollout_planner *p, double v, double w) {
    const planner_settings *s = p->set;
    const double n = fmax(fabs(v) * s->sim_time / s->sim_granularity, fabs(w) / s->angular_sim_granularity) + 0.5;
    if (n >= p->steps_max) return p->steps_max;
    return n >= 1 ? (int)n : 1;
}

static inline void advance(const planner_settings *s, motion *m, double v, double w, double c, double d, double dt) {
    m->v = towards(v, m->v, s->acc_lim_x * dt);
    m->w = towards(w, m->w, s->acc_lim_theta * dt);
    m->x = m->x + m->v * c * dt;
    m->y = m->y + m->v * d * dt;
    m->th = m->th + m->w * dt;
}

void simulate(rollout_planner *p, motion m, double v, double w, rollout *out) {
    const planner_settings *s = p->set;
    const int n = simulate_steps(p, v, w);
    const int impossible = p->frame.w * p->frame.h;
    const double dt = s->sim_time / n;
    double path = 0;
    double goal = 0;
    double occ = 0;
    out->v = v;
    out->w = w;
    out->cost = -1;
    out->points = 0;
    int i = 0;
    for (; i < n; ++i) {
        int cx, cy;
        if (!world_to_map(&p->frame, m.x, m.y, &cx, &cy)) break;
        const double c = cos(m.th);
        const double d = sin(m.th);
        const int outline = footprint_outline_cost(&p->shape, &p->lines, &p->frame, p->cost, m.x, m.y, c, d);
        if (outline < 0) break;
        occ = fmax(fmax(occ, outline), p->cost[cy * p->frame.w + cx]);
        path = wavefront_ros_value(&p->path, cx, cy);
        goal = wavefront_ros_value(&p->goal, cx, cy);
        if (goal >= impossible || path >= impossible) {
            out->cost = -2;
            break;
        }
        out->x[i] = m.x;
        out->y[i] = m.y;
        out->th[i] = m.th;
        advance(s, &m, v, w, c, d, dt);
    }
    out->points = i;
    if (i == n) out->cost = total_cost(p, path, goal, occ);
    p->rollouts += 1;
    p->rollout_steps += i < n ? i + 1 : n;
    if (p->trace && p->trace->count < p->trace->capacity)
        p->trace->rows[p->trace->count++] = (rollout_row){v, w, out->cost, path, goal, occ, n, i};
}

void simulate_poses(const rollout_planner *p, motion m, double v, double w, rollout *out) {
    const int n = simulate_steps(p, v, w);
    const double dt = p->set->sim_time / n;
    out->v = v;
    out->w = w;
    out->points = n;
    for (int i = 0; i < n; ++i) {
        out->x[i] = m.x;
        out->y[i] = m.y;
        out->th[i] = m.th;
        advance(p->set, &m, v, w, cos(m.th), sin(m.th), dt);
    }
}

void simulate_again(rollout_planner *p, motion m, double v, double w, rollout *out) {
    const long rollouts = p->rollouts;
    const long steps = p->rollout_steps;
    simulate(p, m, v, w, out);
    p->rollouts = rollouts;
    p->rollout_steps = steps;
}
