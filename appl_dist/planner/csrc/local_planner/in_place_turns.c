#include "in_place_turns.h"

#include <float.h>

// A turn is taken when it is not dearer than the best so far and the goal distance ahead of its last point is below
// *ahead, which it becomes.
static refine_result score_turn(rollout_planner *p, const motion *m, sample_block *b, int i, double most,
                                double *ahead) {
    const double reach = p->set->heading_lookahead;
    const int x = b->cx[i];
    const int y = b->cy[i];
    if (b->known[i] <= 0) return b->known[i] == 0 ? REFINE_ILLEGAL : REFINE_UNDECIDED;
    b->path[i] = wavefront_at_least(&p->path, x, y);
    b->goal[i] = wavefront_at_least(&p->goal, x, y);
    if (b->path[i] >= WAVE_LIMIT || b->goal[i] >= WAVE_LIMIT) return REFINE_ILLEGAL;
    b->occ[i] = p->search.start_occ;
    if (total_cost(p, b->path[i], b->goal[i], b->occ[i]) > most) return REFINE_ILLEGAL;
    b->path[i] = wavefront_distance(&p->path, x, y);
    b->goal[i] = wavefront_distance(&p->goal, x, y);
    if (b->path[i] >= WAVE_LIMIT || b->goal[i] >= WAVE_LIMIT) return REFINE_ILLEGAL;
    b->bound[i] = total_cost(p, b->path[i], b->goal[i], b->occ[i]);
    if (b->bound[i] > most) return REFINE_ILLEGAL;

    const rollout_arc way = velocity_samples_arc(b, i);
    pose_batch end;
    for (int k = 0; k < POSE_BATCH; ++k) end.step[k] = way.steps - 1;
    rollout_arc_poses(&way, p, m, &end);
    int32_t cx, cy;
    const int known = rollout_arc_cell(&p->frame, 1 / p->frame.res, end.x[0] + reach * end.cosine[0],
                                       end.y[0] + reach * end.sine[0], &cx, &cy);
    if (known <= 0) return known == 0 ? REFINE_ILLEGAL : REFINE_UNDECIDED;
    const double new_ahead = wavefront_ros_value(&p->goal, cx, cy);
    if (!(new_ahead < *ahead)) return REFINE_ILLEGAL;
    refine_start(b, i);
    const refine_result found = refine_bound(p, m, b, i, most, false);
    if (found == REFINE_EXACT) *ahead = new_ahead;
    return found == REFINE_BOUNDED ? REFINE_ILLEGAL : found;
}

static refine_result simulate_turn(rollout_planner *p, const motion *m, sample_block *b, int i, double most,
                                   double *ahead) {
    rollout *t = &p->probe;
    int x, y;
    b->bound[i] = simulate_cost(p, m, 0, b->w[i], t);
    if (!(b->bound[i] >= 0 && b->bound[i] <= most)) return REFINE_ILLEGAL;
    const double reach = p->set->heading_lookahead;
    const double th = t->th[t->points - 1];
    if (!world_to_map(&p->frame, t->x[t->points - 1] + reach * cos(th), t->y[t->points - 1] + reach * sin(th), &x, &y))
        return REFINE_ILLEGAL;
    const double new_ahead = wavefront_ros_value(&p->goal, x, y);
    if (!(new_ahead < *ahead)) return REFINE_ILLEGAL;
    *ahead = new_ahead;
    return REFINE_EXACT;
}

static void try_turn(rollout_planner *p, const motion *m, sample_block *b, int i, double *ahead, rollout *best) {
    const double most = best->cost >= 0 ? best->cost : INFINITY;
    refine_result found = score_turn(p, m, b, i, most, ahead);
    if (found == REFINE_UNDECIDED) found = simulate_turn(p, m, b, i, most, ahead);
    if (found == REFINE_EXACT) {
        best->v = 0;
        best->w = b->w[i];
        best->cost = b->bound[i];
    }
}

void in_place_turns_try(rollout_planner *p, const motion *m, const sample_window *k, bool possible, rollout *best) {
    double ahead = DBL_MAX;
    double w = k->min_w;
    for (int j = 0; j < k->nw; j += SAMPLE_LANES) {
        sample_block *b = &p->search.turns[j / SAMPLE_LANES];
        const int count = k->nw - j < SAMPLE_LANES ? k->nw - j : SAMPLE_LANES;
        bool allowed[SAMPLE_LANES];
        for (int i = 0; i < SAMPLE_LANES; ++i) {
            const bool here = i < count;
            allowed[i] = here && in_place_turn_allowed(p, w, k->dw);
            b->v[i] = 0;
            b->w[i] = here ? in_place_turn_rate(p, w) : 0;
            if (here) w += k->dw;
        }
        velocity_samples_rollout(b, p, m);
        for (int i = 0; i < count; ++i) {
            p->rollouts += 1;
            p->rollout_steps += b->steps[i];
            if (possible && allowed[i]) try_turn(p, m, b, i, &ahead, best);
        }
    }
}
