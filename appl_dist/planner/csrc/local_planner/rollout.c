#include "rollout.h"

#include <float.h>

#include "best_first_search.h"
#include "in_place_turns.h"

void rollout_reset(rollout_planner *p) {
    p->stuck_left = p->stuck_right = p->rotating_left = p->rotating_right = p->escaping = false;
    p->prev_x = p->prev_y = p->escape_x = p->escape_y = p->escape_theta = 0;
    p->one.points = p->two.points = 0;
}

void rollout_set_parameters(rollout_planner *p, const planner_parameters *par) {
    p->par = *par;
    p->pdist = par->pdist_scale;
    p->gdist = par->gdist_scale;
    if (p->set->meter_scoring != 0) {
        p->gdist *= p->set->resolution_m;
        p->pdist *= p->set->resolution_m;
    }
}

// MapGrid::adjustPlanResolution fused with its two users: setTargetCells and setLocalGoal.
typedef struct {
    rollout_planner *p;
    bool started, left;
    int goal_x, goal_y;
} plan_walk;

static void walk_point(plan_walk *walk, double x, double y) {
    int cx, cy;
    rollout_planner *p = walk->p;
    if (walk->left) return;
    if (world_to_map(&p->frame, x, y, &cx, &cy) && p->cost[cy * p->frame.w + cx] != COST_UNKNOWN) {
        wavefront_target(&p->path, cx, cy);
        walk->goal_x = cx;
        walk->goal_y = cy;
        walk->started = true;
    } else if (walk->started) {
        walk->left = true;
    }
}

// The part of findBestPath that lays out the grids.
static void lay_out_waves(rollout_planner *p, const double *plan_x, const double *plan_y, int n, const motion *m,
                          const grid_box *box) {
    const double res = p->frame.res;
    wavefront_open_cells(&p->frame, p->cost, p->open);
    wavefront_reset(&p->path, &p->frame, p->open, box);
    wavefront_reset(&p->goal, &p->frame, p->open, box);
    footprint_columns robot;
    if (footprint_fill(&p->shape, &p->frame, m->x, m->y, m->th, &robot))
        for (int i = 0; i < robot.count; ++i)
            for (int row = robot.low[i]; row <= robot.high[i]; ++row) wavefront_unblock(&p->path, robot.x0 + i, row);
    plan_walk walk = {.p = p};
    double last_x = plan_x[0];
    double last_y = plan_y[0];
    walk_point(&walk, last_x, last_y);
    for (int i = 1; i < n && !walk.left; ++i) {
        const double dx = plan_x[i] - last_x;
        const double dy = plan_y[i] - last_y;
        const double square = dx * dx + dy * dy;
        if (square > res * res) {
            const int steps = (int)ceil(sqrt(square) / res);
            for (int j = 1; j < steps && !walk.left; ++j)
                walk_point(&walk, last_x + j * (dx / steps), last_y + j * (dy / steps));
        }
        walk_point(&walk, plan_x[i], plan_y[i]);
        last_x = plan_x[i];
        last_y = plan_y[i];
    }
    p->goal_column = walk.goal_x;
    p->goal_row = walk.goal_y;
    if (walk.started) wavefront_target(&p->goal, walk.goal_x, walk.goal_y);
    wavefront_start(&p->path);
    wavefront_start(&p->goal);
}

static sample_window dynamic_window(const rollout_planner *p, const motion *m) {
    const planner_settings *s = p->set;
    const double period = 1.0 / s->controller_frequency;
    const double reach = fmin(p->par.max_vel_x, hypot(p->goal_x - m->x, p->goal_y - m->y) / s->sim_time);
    sample_window k = {.nv = (int)p->par.vx_samples, .nw = (int)p->par.vtheta_samples};
    k.max_v = fmax(fmin(reach, m->v + s->acc_lim_x * period), s->min_vel_x);
    k.min_v = fmax(s->min_vel_x, m->v - s->acc_lim_x * period);
    k.max_w = fmin(p->par.max_vel_theta, m->w + s->acc_lim_theta * period);
    k.min_w = fmax(-p->par.max_vel_theta, m->w - s->acc_lim_theta * period);
    // One sample: the spacing is never added, and as infinity it forbids in-place turns, as the division by zero
    // of the original does.
    k.dv = k.nv > 1 ? (k.max_v - k.min_v) / (k.nv - 1) : INFINITY;
    k.dw = k.nw > 1 ? (k.max_w - k.min_w) / (k.nw - 1) : INFINITY;
    return k;
}

typedef struct {
    rollout *best, *other;
} rollout_pair;

static void swap_best(rollout_pair *c) {
    rollout *t = c->best;
    c->best = c->other;
    c->other = t;
}

static void try_forward(rollout_planner *p, const motion *m, double v, double w, rollout_pair *c) {
    simulate(p, *m, v, w, c->other);
    if (c->other->cost >= 0 && (c->other->cost < c->best->cost || c->best->cost < 0)) swap_best(c);
}

static void try_turn(rollout_planner *p, const motion *m, double w, bool allowed, double *ahead, rollout_pair *c) {
    rollout *t = c->other;
    simulate(p, *m, 0, w, t);
    if (!allowed || t->cost < 0 || !(t->cost <= c->best->cost || c->best->cost < 0)) return;
    const double th = t->th[t->points - 1];
    int cx, cy;
    if (!world_to_map(&p->frame, t->x[t->points - 1] + p->set->heading_lookahead * cos(th),
                      t->y[t->points - 1] + p->set->heading_lookahead * sin(th), &cx, &cy))
        return;
    const double d = wavefront_ros_value(&p->goal, cx, cy);
    if (d < *ahead) {
        *ahead = d;
        swap_best(c);
    }
}

// Every sample, in order, as ROS does.
static void try_all(rollout_planner *p, const motion *m, const sample_window *k, rollout_pair *c) {
    if (!p->escaping) {
        double v = k->min_v;
        for (int i = 0; i < k->nv; ++i, v += k->dv) {
            try_forward(p, m, v, 0, c);
            double w = k->min_w;
            for (int j = 0; j < k->nw - 1; ++j, w += k->dw) try_forward(p, m, v, w, c);
        }
    }
    double ahead = DBL_MAX;
    double w = k->min_w;
    for (int j = 0; j < k->nw; ++j, w += k->dw)
        try_turn(p, m, in_place_turn_rate(p, w), in_place_turn_allowed(p, w, k->dw), &ahead, c);
}

static void forget_oscillation_after(rollout_planner *p, const motion *m) {
    if (hypot(m->x - p->prev_x, m->y - p->prev_y) > p->set->oscillation_reset_dist)
        p->rotating_left = p->rotating_right = p->stuck_left = p->stuck_right = false;
}

static void stop_escaping_after(rollout_planner *p, const motion *m) {
    if (hypot(m->x - p->escape_x, m->y - p->escape_y) > p->set->escape_reset_dist ||
        fabs(shortest_angle(p->escape_theta, m->th)) > p->set->escape_reset_theta)
        p->escaping = false;
}

static void remember_turn(rollout_planner *p, const motion *m, const rollout *best) {
    if (best->v > 0) return;
    if (best->w < 0) {
        if (p->rotating_right) p->stuck_right = true;
        p->rotating_right = true;
    } else if (best->w > 0) {
        if (p->rotating_left) p->stuck_left = true;
        p->rotating_left = true;
    }
    p->prev_x = m->x;
    p->prev_y = m->y;
}

const rollout *rollout_best(rollout_planner *p, const double *plan_x, const double *plan_y, int n, double x, double y,
                            double theta, double v, double w) {
    const motion m = {x, y, theta, v, w};
    p->goal_x = plan_x[n - 1];
    p->goal_y = plan_y[n - 1];
    const sample_window k = dynamic_window(p, &m);
    rollout_pair c = {&p->one, &p->two};
    c.best->cost = c.other->cost = -1;
    c.best->points = c.other->points = 0;
    p->rollouts = p->rollout_steps = 0;
    if (p->trace) {
        const grid_box everywhere = {0, 0, p->frame.w - 1, p->frame.h - 1};
        lay_out_waves(p, plan_x, plan_y, n, &m, &everywhere);
        try_all(p, &m, &k, &c);
    } else {
        const grid_box ends = best_first_start(p, &m, &k, !p->escaping);
        lay_out_waves(p, plan_x, plan_y, n, &m, &ends);
        best_first_search(p, &m, &k, !p->escaping, c.best);
        if (c.best->cost >= 0) simulate_poses(p, m, c.best->v, c.best->w, c.best);
    }

    if (c.best->cost >= 0) {
        remember_turn(p, &m, c.best);
        forget_oscillation_after(p, &m);
        stop_escaping_after(p, &m);
        return c.best;
    }
    // Nothing legal: back up, whatever stands there.
    rollout *back = c.other;
    simulate(p, m, p->set->escape_vel, 0, back);
    forget_oscillation_after(p, &m);
    if (!p->escaping && back->cost > -2) {
        p->escape_x = x;
        p->escape_y = y;
        p->escape_theta = theta;
        p->escaping = true;
    }
    stop_escaping_after(p, &m);
    if (back->cost == -1) back->cost = 1;
    return back;
}

bool rollout_check(rollout_planner *p, double x, double y, double theta, double v, double w, double v_sample,
                   double w_sample) {
    simulate(p, (motion){x, y, theta, v, w}, v_sample, w_sample, &p->probe);
    return p->probe.cost >= 0;
}
