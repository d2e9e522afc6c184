#include "search.h"

#include <float.h>
#include <string.h>

// What is known of a candidate's cost.
enum { FIRST_BOUND = 0, PATH_KNOWN, ENDS_KNOWN, SCORED };
typedef enum { ILLEGAL, OPEN, DONE, UNDECIDED } verdict;

enum { COARSEST = 16 };  // points are looked at every 16th first, then those between

static inline bool before(const candidate *a, const candidate *b) {
    return a->bound < b->bound || (a->bound == b->bound && a->order < b->order);
}

static void sift_down(sample_search *s, int at) {
    const int32_t moved = s->heap[at];
    const candidate *c = s->candidates;
    for (;;) {
        int child = 2 * at + 1;
        if (child >= s->open) break;
        if (child + 1 < s->open && before(&c[s->heap[child + 1]], &c[s->heap[child]])) ++child;
        if (!before(&c[s->heap[child]], &c[moved])) break;
        s->heap[at] = s->heap[child];
        at = child;
    }
    s->heap[at] = moved;
}

static void drop_top(sample_search *s) {
    s->heap[0] = s->heap[--s->open];
    if (s->open > 0) sift_down(s, 0);
}

// The cost of the pose all samples start from; negative when it is not legal, so none of them is.
static int start_cost(rollout_planner *p, const motion *m) {
    const grid_frame *g = &p->frame;
    int cx, cy;
    if (!world_to_map(g, m->x, m->y, &cx, &cy) || !wavefront_open(&p->goal, cx, cy)) return -1;
    const int outline = footprint_outline_cost(&p->shape, &p->lines, g, p->cost, m->x, m->y, cos(m->th), sin(m->th));
    const int centre = p->cost[cy * g->w + cx];
    return outline > centre || outline < 0 ? outline : centre;
}

enum { OFF_LIMITS = -1, TOO_NEAR = -2 };

// The cost of one point of a roll-out; OFF_LIMITS where it is not legal, TOO_NEAR an edge where arc_cell cannot tell.
static int point_cost(rollout_planner *p, const motion *m, const arc *way, int step) {
    const grid_frame *g = &p->frame;
    const double per_res = p->search.per_res;
    const arc_pose at = arc_at(way, p->set, m, step);
    int cx, cy;
    const int known = arc_cell(g, per_res, at.x, at.y, &cx, &cy);
    if (known <= 0) return known - 1;
    if (!wavefront_open(&p->goal, cx, cy)) return OFF_LIMITS;
    double sine, cosine;
    arc_sincos(at.th, &sine, &cosine);
    grid_cell corner[FOOTPRINT_CORNERS];
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i) {
        const double fx = p->shape.x[i], fy = p->shape.y[i];
        const int on = arc_cell(g, per_res, at.x + (fx * cosine - fy * sine), at.y + (fx * sine + fy * cosine),
                                &corner[i].x, &corner[i].y);
        if (on <= 0) return on - 1;
    }
    const int outline = footprint_cells_cost(&p->lines, g, p->cost, corner), centre = p->cost[cy * g->w + cx];
    return outline > centre || outline < 0 ? outline : centre;
}

// Whether both waves reach every point, given that they reach the last. Cells open to the goal's wave are open to the
// path's, and among open neighbours all are reached if one is; so as a rule no wave has to come here.
static verdict reached(rollout_planner *p, const motion *m, const arc *way) {
    int x = -1, y = -1;
    for (int i = way->steps - 1; i >= 0; --i) {
        const arc_pose at = arc_at(way, p->set, m, i);
        int cx, cy;
        const int known = arc_cell(&p->frame, p->search.per_res, at.x, at.y, &cx, &cy);
        if (known <= 0) return known == 0 ? ILLEGAL : UNDECIDED;
        const int dx = abs(cx - x), dy = abs(cy - y);
        const bool linked = dx + dy <= 1 || (dx == 1 && dy == 1 && (wavefront_open(&p->goal, x, cy) ||
                                                                   wavefront_open(&p->goal, cx, y)));
        x = cx, y = cy;
        if (linked || i == way->steps - 1) continue;
        if (wavefront_distance(&p->path, x, y) >= WAVE_LIMIT || wavefront_distance(&p->goal, x, y) >= WAVE_LIMIT)
            return ILLEGAL;
    }
    return DONE;
}

// Looks at points until the bound passes `enough` (among equals, until `order` is no longer the first), or all are seen.
static verdict look(rollout_planner *p, const motion *m, candidate *c, double enough, int order) {
    const int n = c->way.steps;
    for (;;) {
        if (c->back >= n) {
            if (c->gap == 1) return reached(p, m, &c->way);
            c->gap /= 2;
            c->back = c->gap;
            continue;
        }
        const int cost = point_cost(p, m, &c->way, n - 1 - c->back);
        if (cost == OFF_LIMITS) return ILLEGAL;
        if (cost == TOO_NEAR) return UNDECIDED;
        c->back += c->gap == COARSEST ? COARSEST : 2 * c->gap;
        if (cost <= c->occ) continue;
        c->occ = cost;
        c->bound = total_cost(p, c->path, c->goal, c->occ);
        if (c->bound > enough || (c->bound == enough && c->order > order)) return OPEN;
    }
}

// Where the sample ends. UNDECIDED: only stepping through it tells.
static verdict begin(const rollout_planner *p, const motion *m, double v, double w, int steps, candidate *c) {
    c->way.v = v, c->way.w = w;
    if (!arc_make(&c->way, p->set, m, v, w, steps)) return UNDECIDED;
    const arc_pose end = arc_at(&c->way, p->set, m, steps - 1);
    const int known = arc_cell(&p->frame, p->search.per_res, end.x, end.y, &c->x, &c->y);
    return known == 1 ? OPEN : known == 0 ? ILLEGAL : UNDECIDED;
}

static verdict first_bound(rollout_planner *p, candidate *c) {
    c->path = wavefront_at_least(&p->path, c->x, c->y);
    c->goal = wavefront_at_least(&p->goal, c->x, c->y);
    if (c->path >= WAVE_LIMIT || c->goal >= WAVE_LIMIT) return ILLEGAL;
    const int straight = abs(c->x - p->goal_column) + abs(c->y - p->goal_row);
    if (straight > c->goal) c->goal = straight;
    c->occ = p->search.start_occ;
    c->bound = total_cost(p, c->path, c->goal, c->occ);
    c->stage = FIRST_BOUND;
    c->back = 0, c->gap = COARSEST;
    return OPEN;
}

// The sample's cost by stepping through it, -1 where it is not legal.
static double step_through(rollout_planner *p, const motion *m, double v, double w, rollout *scratch) {
    simulate_again(p, *m, v, w, scratch);
    return scratch->cost >= 0 ? scratch->cost : -1;
}

// Makes the bound of the heap's first candidate sharper by one stage.
static verdict sharpen(rollout_planner *p, const motion *m, candidate *c) {
    const sample_search *s = &p->search;
    if (c->stage == ENDS_KNOWN) {
        const candidate *next = NULL;  // the heap's second
        for (int i = 1; i <= 2 && i < s->open; ++i)
            if (!next || before(&s->candidates[s->heap[i]], next)) next = &s->candidates[s->heap[i]];
        return next ? look(p, m, c, next->bound, next->order) : look(p, m, c, INFINITY, 0);
    }
    if (c->stage == FIRST_BOUND) c->path = wavefront_distance(&p->path, c->x, c->y);
    else c->goal = wavefront_distance(&p->goal, c->x, c->y);
    if (c->path >= WAVE_LIMIT || c->goal >= WAVE_LIMIT) return ILLEGAL;
    c->stage += 1;
    c->bound = total_cost(p, c->path, c->goal, c->occ);
    return OPEN;
}

// Empties the heap into `best`.
static void settle(rollout_planner *p, const motion *m, rollout *best) {
    sample_search *s = &p->search;
    for (int i = s->open / 2 - 1; i >= 0; --i) sift_down(s, i);
    while (s->open > 0) {
        candidate *c = &s->candidates[s->heap[0]];
        if (best->cost >= 0 && c->bound >= best->cost) break;  // earlier chunks win ties
        if (c->stage == SCORED) {
            best->v = c->way.v, best->w = c->way.w, best->cost = c->bound;
            break;
        }
        verdict found = sharpen(p, m, c);
        if (found == UNDECIDED) {
            c->bound = step_through(p, m, c->way.v, c->way.w, &p->probe);
            found = c->bound < 0 ? ILLEGAL : DONE;
        }
        if (found == DONE) c->stage = SCORED;
        if (found == ILLEGAL) drop_top(s);
        else sift_down(s, 0);
    }
    s->open = 0;
}

// The forward samples in ROS's order, SEARCH_SAMPLES at a time: each speed with rate 0, then with the rates but the
// highest.
static void next_samples(rollout_planner *p, const motion *m, const sample_window *k) {
    sample_search *s = &p->search;
    s->used = 0;
    for (; s->row < k->nv; ++s->row, s->v += k->dv, s->column = 0) {
        for (; s->column < k->nw; ++s->column) {
            if (s->used == SEARCH_SAMPLES) return;
            double w = 0;
            if (s->column == 1) w = s->w = k->min_w;
            if (s->column > 1) w = s->w += k->dw;
            const int steps = simulate_steps(p, s->v, w);
            p->rollouts += 1;
            p->rollout_steps += steps;
            candidate *c = &s->candidates[s->used];
            const verdict found = begin(p, m, s->v, w, steps, c);
            if (found == ILLEGAL) continue;
            c->order = s->used++;
            c->stage = found == UNDECIDED ? SCORED : FIRST_BOUND;
        }
    }
}

static void score_samples(rollout_planner *p, const motion *m, rollout *best) {
    sample_search *s = &p->search;
    s->open = 0;
    for (int i = 0; i < s->used; ++i) {
        candidate *c = &s->candidates[i];
        if (c->stage == SCORED) c->bound = step_through(p, m, c->way.v, c->way.w, &p->probe);
        else if (first_bound(p, c) == ILLEGAL) continue;
        if (c->bound >= 0) s->heap[s->open++] = i;
    }
    settle(p, m, best);
}

grid_box search_start(rollout_planner *p, const motion *m, const sample_window *k, bool forward) {
    sample_search *s = &p->search;
    const grid_frame *g = &p->frame;
    const int x = world_to_map_clamped(m->x, g->ox, g->w, g->res), y = world_to_map_clamped(m->y, g->oy, g->h, g->res);
    const int near = 2 + (int)fmin(g->w, (fabs(p->set->heading_lookahead) + m->v * m->v / p->set->acc_lim_x) / g->res);
    grid_box box = {x - near, y - near, x + near, y + near};  // where turns end and look
    s->per_res = 1.0 / g->res;
    s->row = s->column = s->used = 0;
    s->v = k->min_v;
    if (forward) next_samples(p, m, k);
    for (int i = 0; i < s->used; ++i) {
        const candidate *c = &s->candidates[i];
        if (c->stage == SCORED || p->cost[c->y * g->w + c->x] >= COST_INSCRIBED) continue;
        box.x0 = c->x < box.x0 ? c->x : box.x0, box.x1 = c->x > box.x1 ? c->x : box.x1;
        box.y0 = c->y < box.y0 ? c->y : box.y0, box.y1 = c->y > box.y1 ? c->y : box.y1;
    }
    box.x0 = box.x0 > 0 ? box.x0 : 0, box.x1 = box.x1 < g->w ? box.x1 : g->w - 1;
    box.y0 = box.y0 > 0 ? box.y0 : 0, box.y1 = box.y1 < g->h ? box.y1 : g->h - 1;
    return box;
}

// An in-place turn is taken when it is not dearer than the best so far and the goal distance ahead of its last point is
// below *ahead, which it becomes.
static verdict score_turn(rollout_planner *p, const motion *m, double w, double most, double *ahead, double *cost) {
    candidate c;
    const double reach = p->set->heading_lookahead;
    verdict found = begin(p, m, 0, w, simulate_steps(p, 0, w), &c);
    if (found == OPEN) found = first_bound(p, &c);
    if (found != OPEN) return found;
    if (c.bound > most) return ILLEGAL;
    c.path = wavefront_distance(&p->path, c.x, c.y);
    c.goal = wavefront_distance(&p->goal, c.x, c.y);
    if (c.path >= WAVE_LIMIT || c.goal >= WAVE_LIMIT) return ILLEGAL;
    c.bound = total_cost(p, c.path, c.goal, c.occ);
    if (c.bound > most) return ILLEGAL;
    const arc_pose end = arc_at(&c.way, p->set, m, c.way.steps - 1);
    double sine, cosine;
    int x, y;
    arc_sincos(end.th, &sine, &cosine);
    const int known = arc_cell(&p->frame, p->search.per_res, end.x + reach * cosine, end.y + reach * sine, &x, &y);
    if (known <= 0) return known == 0 ? ILLEGAL : UNDECIDED;
    const double new_ahead = wavefront_ros_value(&p->goal, x, y);
    if (!(new_ahead < *ahead)) return ILLEGAL;
    c.order = 0;
    found = look(p, m, &c, most, 0);
    if (found == DONE) *ahead = new_ahead, *cost = c.bound;
    return found;
}

static verdict step_through_turn(rollout_planner *p, const motion *m, double w, double most, double *ahead,
                                 double *cost) {
    rollout *t = &p->probe;
    int x, y;
    *cost = step_through(p, m, 0, w, t);
    if (!(*cost >= 0 && *cost <= most)) return ILLEGAL;
    const double reach = p->set->heading_lookahead, th = t->th[t->points - 1];
    if (!world_to_map(&p->frame, t->x[t->points - 1] + reach * cos(th), t->y[t->points - 1] + reach * sin(th), &x, &y))
        return ILLEGAL;
    const double new_ahead = wavefront_ros_value(&p->goal, x, y);
    if (!(new_ahead < *ahead)) return ILLEGAL;
    *ahead = new_ahead;
    return DONE;
}

static void try_turn(rollout_planner *p, const motion *m, double w, double *ahead, rollout *best) {
    const double most = best->cost >= 0 ? best->cost : INFINITY;
    double cost = 0;
    verdict found = score_turn(p, m, w, most, ahead, &cost);
    if (found == UNDECIDED) found = step_through_turn(p, m, w, most, ahead, &cost);
    if (found == DONE) best->v = 0, best->w = w, best->cost = cost;
}

void search_best(rollout_planner *p, const motion *m, const sample_window *k, bool forward, rollout *best) {
    p->search.start_occ = start_cost(p, m);
    const bool possible = p->search.start_occ >= 0;
    while (forward && p->search.used > 0) {
        if (possible) score_samples(p, m, best);
        next_samples(p, m, k);
    }
    double ahead = DBL_MAX, w = k->min_w;
    for (int j = 0; j < k->nw; ++j, w += k->dw) {
        const double rate = turn_rate(p, w);
        p->rollouts += 1;
        p->rollout_steps += simulate_steps(p, 0, rate);
        if (possible && turn_allowed(p, w, k->dw)) try_turn(p, m, rate, &ahead, best);
    }
}
