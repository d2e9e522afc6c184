#include "best_first_search.h"

#include "in_place_turns.h"

enum { SURE_PATH_LEVEL = 8 };  // so near the plan most winners end

// The cost of the pose all samples start from; negative when it is not legal, so none of them is.
static int start_cost(rollout_planner *p, const motion *m) {
    const grid_frame *g = &p->frame;
    int cx, cy;
    if (!world_to_map(g, m->x, m->y, &cx, &cy) || !wavefront_open(&p->goal, cx, cy)) return -1;
    const int outline = footprint_outline_cost(&p->shape, &p->lines, g, p->cost, m->x, m->y, cos(m->th), sin(m->th));
    const int centre = p->cost[cy * g->w + cx];
    return outline > centre || outline < 0 ? outline : centre;
}

// A bound from what the waves know already; INFINITY where the last point cannot be legal.
static double distance_bound(const rollout_planner *p, sample_block *b, int i) {
    const int x = b->cx[i];
    const int y = b->cy[i];
    const int straight = abs(x - p->goal_column) + abs(y - p->goal_row);
    b->path[i] = wavefront_at_least(&p->path, x, y);
    b->goal[i] = wavefront_at_least(&p->goal, x, y);
    if (b->path[i] >= WAVE_LIMIT || b->goal[i] >= WAVE_LIMIT) return INFINITY;
    b->goal[i] = straight > b->goal[i] ? straight : b->goal[i];
    if (wavefront_known(&p->path, x, y) && wavefront_known(&p->goal, x, y)) b->stage[i] = SAMPLE_NEEDS_REFINING;
    return total_cost(p, b->path[i], b->goal[i], b->occ[i]);
}

static double first_bound(const rollout_planner *p, sample_block *b, int i) {
    b->occ[i] = p->search.start_occ;
    refine_start(b, i);
    if (b->known[i] == 0) return INFINITY;
    b->stage[i] = b->known[i] == 1 ? SAMPLE_NEEDS_DISTANCES : SAMPLE_NEEDS_SIMULATION;
    if (b->known[i] == 1) return distance_bound(p, b, i);
    if (b->known[i] == SAMPLE_NO_ARC) return 0;
    // In this cell or one beside it: at most one column and one row nearer.
    const int straight = abs(b->cx[i] - p->goal_column) + abs(b->cy[i] - p->goal_row) - 2;
    return total_cost(p, 0, straight > 0 ? straight : 0, b->occ[i]);
}

// Bounds of all samples. No winner is nearer to the goal than the nearest end is on a free map.
static void first_bounds(rollout_planner *p) {
    best_first_scratch *s = &p->search;
    int nearest = WAVE_LIMIT;
    for (int at = 0; at < s->used; ++at) {
        const sample_block *b = &s->blocks[at / SAMPLE_LANES];
        const int i = at % SAMPLE_LANES;
        const int straight = abs(b->cx[i] - p->goal_column) + abs(b->cy[i] - p->goal_row);
        if (b->known[i] == 1 && straight < nearest) nearest = straight;
    }
    if (nearest < WAVE_LIMIT) {
        wavefront_grow_to(&p->goal, nearest);
        wavefront_grow_to(&p->path, SURE_PATH_LEVEL);
    }
    for (int at = 0; at < s->used; ++at)
        s->bounds.level[0][at] = first_bound(p, &s->blocks[at / SAMPLE_LANES], at % SAMPLE_LANES);
    minimum_tree_build(&s->bounds, s->used);
}

// A bound of the sample as sharp as the waves allow without growing, or else with one of them grown to its last point.
static double sharpen_by_distances(rollout_planner *p, sample_block *b, int i, double now) {
    const double sharper = distance_bound(p, b, i);
    if (sharper > now || b->stage[i] == SAMPLE_NEEDS_REFINING) return sharper;
    wavefront_distance(wavefront_known(&p->path, b->cx[i], b->cy[i]) ? &p->goal : &p->path, b->cx[i], b->cy[i]);
    return distance_bound(p, b, i);
}

// Looks at the sample for as long as no other has a lower bound.
static double sharpen_by_refining(rollout_planner *p, const motion *m, sample_block *b, int i, int at) {
    best_first_scratch *s = &p->search;
    b->bound[i] = s->bounds.level[0][at];
    minimum_tree_set(&s->bounds, at, INFINITY);
    const int next = minimum_tree_first(&s->bounds);
    const refine_result found = refine_bound(p, m, b, i, s->bounds.level[0][next], at > next);
    if (found == REFINE_UNDECIDED) b->stage[i] = SAMPLE_NEEDS_SIMULATION;
    if (found == REFINE_EXACT) b->stage[i] = SAMPLE_SCORED;
    return found == REFINE_ILLEGAL ? INFINITY : b->bound[i];
}

// Finds the first of the cheapest samples in the blocks.
static void search_blocks(rollout_planner *p, const motion *m, rollout *best) {
    best_first_scratch *s = &p->search;
    first_bounds(p);
    for (;;) {
        const int at = minimum_tree_first(&s->bounds);
        const int i = at % SAMPLE_LANES;
        sample_block *b = &s->blocks[at / SAMPLE_LANES];
        const double bound = s->bounds.level[0][at];
        if (bound == INFINITY || (best->cost >= 0 && bound >= best->cost)) return;  // earlier samples win ties
        double sharper = INFINITY;
        switch ((sample_stage)b->stage[i]) {
            case SAMPLE_SCORED:
                best->v = b->v[i];
                best->w = b->w[i];
                best->cost = bound;
                return;
            case SAMPLE_NEEDS_DISTANCES:
                sharper = sharpen_by_distances(p, b, i, bound);
                break;
            case SAMPLE_NEEDS_REFINING:
                sharper = sharpen_by_refining(p, m, b, i, at);
                break;
            case SAMPLE_NEEDS_SIMULATION:
                sharper = simulate_cost(p, m, b->v[i], b->w[i], &p->probe);
                if (sharper < 0) sharper = INFINITY;
                b->stage[i] = SAMPLE_SCORED;
        }
        minimum_tree_set(&s->bounds, at, sharper);
    }
}

// The forward samples in ROS's order, as many as there are lanes for: each speed with rate 0, then with the rates but
// the highest.
static void next_samples(rollout_planner *p, const motion *m, const sample_window *k) {
    best_first_scratch *s = &p->search;
    s->used = 0;
    for (; s->row < k->nv; ++s->row, s->v += k->dv, s->column = 0) {
        for (; s->column < k->nw && s->used < FORWARD_BLOCKS * SAMPLE_LANES; ++s->column, ++s->used) {
            double w = 0;
            if (s->column == 1) w = s->w = k->min_w;
            if (s->column > 1) w = s->w += k->dw;
            sample_block *b = &s->blocks[s->used / SAMPLE_LANES];
            b->v[s->used % SAMPLE_LANES] = s->v;
            b->w[s->used % SAMPLE_LANES] = w;
        }
        if (s->column < k->nw) break;
    }
    for (int at = s->used; at % SAMPLE_LANES; ++at) {
        sample_block *b = &s->blocks[at / SAMPLE_LANES];
        b->v[at % SAMPLE_LANES] = b->v[0];
        b->w[at % SAMPLE_LANES] = b->w[0];
    }
    for (int at = 0; at < s->used; at += SAMPLE_LANES) velocity_samples_rollout(&s->blocks[at / SAMPLE_LANES], p, m);
    p->rollouts += s->used;
    for (int at = 0; at < s->used; ++at) p->rollout_steps += s->blocks[at / SAMPLE_LANES].steps[at % SAMPLE_LANES];
}

grid_box best_first_start(rollout_planner *p, const motion *m, const sample_window *k, bool forward) {
    best_first_scratch *s = &p->search;
    const grid_frame *g = &p->frame;
    const int x = world_to_map_clamped(m->x, g->ox, g->w, g->res);
    const int y = world_to_map_clamped(m->y, g->oy, g->h, g->res);
    const double braking = m->v * m->v / p->set->acc_lim_x;
    const int near = 2 + (int)fmin(g->w, (fabs(p->set->heading_lookahead) + braking) / g->res);
    grid_box box = {x - near, y - near, x + near, y + near};  // where turns end and look ahead to
    s->row = s->column = s->used = 0;
    s->v = k->min_v;
    if (forward) next_samples(p, m, k);
    for (int at = 0; at < s->used; ++at) {
        const sample_block *b = &s->blocks[at / SAMPLE_LANES];
        const int i = at % SAMPLE_LANES;
        const int cx = b->cx[i];
        const int cy = b->cy[i];
        if (b->known[i] != 1 || p->cost[cy * g->w + cx] >= COST_INSCRIBED) continue;
        box.x0 = cx < box.x0 ? cx : box.x0;
        box.x1 = cx > box.x1 ? cx : box.x1;
        box.y0 = cy < box.y0 ? cy : box.y0;
        box.y1 = cy > box.y1 ? cy : box.y1;
    }
    box.x0 = box.x0 > 0 ? box.x0 : 0;
    box.x1 = box.x1 < g->w ? box.x1 : g->w - 1;
    box.y0 = box.y0 > 0 ? box.y0 : 0;
    box.y1 = box.y1 < g->h ? box.y1 : g->h - 1;
    return box;
}

void best_first_search(rollout_planner *p, const motion *m, const sample_window *k, bool forward, rollout *best) {
    p->search.start_occ = start_cost(p, m);
    const bool possible = p->search.start_occ >= 0;
    while (forward && p->search.used > 0) {
        if (possible) search_blocks(p, m, best);
        next_samples(p, m, k);
    }
    in_place_turns_try(p, m, k, possible, best);
}
