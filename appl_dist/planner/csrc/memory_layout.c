// Limits of settings and parameters, and where everything lies in the caller's memory.
#include "memory_layout.h"

#include <string.h>

#include "velocity_samples.h"

static int cells_of(double metres, double res) { return (int)(metres / res + 0.5); }

// clang-format off
// Sets `bad` and returns false where a field is not in [low, high]; NaN is in no range.
#define WITHIN(from, field, low_, high_)                                             \
    if (!((from)->field >= (low_) && (from)->field <= (high_))) {                    \
        *bad = (planner_limit){#field, (from)->field, (low_), (high_)};              \
        return false;                                                                \
    }

bool navigator_check_settings(const planner_settings *s, planner_limit *bad) {
    const double res = s->resolution_m;
#define FINITE(name) WITHIN(s, name, -1e6, 1e6)
    PLANNER_SETTINGS(FINITE)
#undef FINITE
    WITHIN(s, resolution_m, 0.01, 1.0)
    WITHIN(s, local_size_m, 20 * res, WAVE_SIDE_MAX * res)
    WITHIN(s, global_size_m, 20 * res, 4000 * res)
    WITHIN(s, sim_time, 0.01, 10)
    WITHIN(s, sim_granularity, 1e-3, 5)
    WITHIN(s, angular_sim_granularity, 1e-3, 1.5)
    WITHIN(s, controller_frequency, 0.1, 1000)
    WITHIN(s, min_vel_x, 0, VELOCITY_MAX)
    WITHIN(s, escape_vel, -VELOCITY_MAX, 0)
    WITHIN(s, min_in_place_vel_theta, 0, VELOCITY_MAX)
    WITHIN(s, max_rotational_vel, 0, VELOCITY_MAX)
    WITHIN(s, rotate_max_vel_theta, 0, VELOCITY_MAX)
    WITHIN(s, footprint_padding, 0, s->local_size_m / 8)
    WITHIN(s, half_length_m, res, s->local_size_m / 8)
    WITHIN(s, half_width_m, res, s->local_size_m / 8)
    WITHIN(s, beams, 2, 100000)
    WITHIN(s, angle_max_rad, 1e-6, 3.1416)
    WITHIN(s, obstacle_range, 0, 100)
    WITHIN(s, raytrace_range, 0, 100)
    WITHIN(s, cost_scaling_factor, 0, 100)
    WITHIN(s, rotate_granularity_rad, 1e-3, 3.1416)
    WITHIN(s, acc_lim_x, 0, 1000)
    WITHIN(s, acc_lim_theta, 0, 1000)
    return true;
}

bool navigator_check_parameters(const planner_settings *s, const planner_parameters *p, planner_limit *bad) {
    WITHIN(p, max_vel_x, 0, VELOCITY_MAX)
    WITHIN(p, max_vel_theta, 0, VELOCITY_MAX)
    WITHIN(p, vx_samples, 1, SAMPLES_MAX)
    WITHIN(p, vtheta_samples, 1, SAMPLES_MAX)
    WITHIN(p, occdist_scale, 0, 5)
    WITHIN(p, pdist_scale, 0, 5)
    WITHIN(p, gdist_scale, 0, 5)
    WITHIN(p, inflation_radius, 0, INFLATION_CELLS_MAX * s->resolution_m)
    return true;
}

// clang-format on

void *arena_alloc(arena *a, size_t bytes) {
    void *at = a->base ? a->base + a->used : NULL;
    a->used += (bytes + 63) & ~(size_t)63;
    return at;
}

#define ARENA_ARRAY(a, type, count) ((type *)arena_alloc(a, sizeof(type) * (size_t)(count)))

static void memory_layout_rollouts(rollout_planner *p, const planner_settings *s, int h, arena *a) {
    const double fastest = fmax(VELOCITY_MAX, fabs(s->escape_vel));
    p->steps_max =
        2 + (int)fmax(fastest * s->sim_time / s->sim_granularity, (double)VELOCITY_MAX / s->angular_sim_granularity);
    wavefront *waves[2] = {&p->path, &p->goal};
    for (int i = 0; i < 2; ++i) waves[i]->dist = ARENA_ARRAY(a, uint16_t, h * WAVE_STRIDE);
    const footprint_shape shape = footprint_make(s->half_length_m, s->half_width_m, s->footprint_padding);
    const int reach = footprint_line_reach(&shape, s->resolution_m);
    p->lines.cells = ARENA_ARRAY(a, int16_t, (2 * reach + 1) * (2 * reach + 1) * (reach + 1));
    p->search.blocks = ARENA_ARRAY(a, sample_block, FORWARD_BLOCKS);
    p->search.turns = ARENA_ARRAY(a, sample_block, TURN_BLOCKS);
    for (int k = 0, entries = MINIMUM_TREE_LEAVES_MAX; k < MINIMUM_TREE_DEPTH_MAX; ++k, entries /= MINIMUM_TREE_FANOUT)
        p->search.bounds.level[k] = ARENA_ARRAY(a, double, entries);
    rollout *scratch[3] = {&p->one, &p->two, &p->probe};
    for (int i = 0; i < 3; ++i) {
        scratch[i]->x = ARENA_ARRAY(a, double, p->steps_max);
        scratch[i]->y = ARENA_ARRAY(a, double, p->steps_max);
        scratch[i]->th = ARENA_ARRAY(a, double, p->steps_max);
    }
}

static void memory_layout_map(costmap *m, int cells, double res, bool rolling, arena *a) {
    m->frame = (grid_frame){cells, cells, res, 0, 0};
    m->rolling = rolling;
    m->obstacles = ARENA_ARRAY(a, uint8_t, cells * cells + LAYER_PADDING);
    m->master = ARENA_ARRAY(a, uint8_t, cells * cells + LAYER_PADDING);
}

void memory_layout_navigator(navigator *n, const planner_settings *s, arena *a) {
    const double res = s->resolution_m;
    const int local = cells_of(s->local_size_m, res);
    const int global = cells_of(s->global_size_m, res);
    const int largest = local > global ? local : global;
    memory_layout_map(&n->local, local, res, true, a);
    memory_layout_map(&n->global, global, res, false, a);
    n->scratch.best = ARENA_ARRAY(a, uint8_t, largest * largest);
    n->scratch.lethal = ARENA_ARRAY(a, int32_t, largest * largest);
    n->scratch.pages = ARENA_ARRAY(a, inflation_page, inflation_pages(largest * largest));

    navfn *plan = &n->plan;
    plan->w = plan->h = global;
    plan->master = ARENA_ARRAY(a, uint8_t, global * global);
    plan->cost = ARENA_ARRAY(a, uint8_t, global * global);
    plan->potential = ARENA_ARRAY(a, float, global *global);
    plan->step = ARENA_ARRAY(a, float, global *global);
    plan->remain = ARENA_ARRAY(a, float, global *global);
    plan->reached = ARENA_ARRAY(a, int32_t, global * global + 1);
    for (int i = 0; i < 3; ++i) plan->buffers[i] = ARENA_ARRAY(a, int32_t, NAVFN_BUFFER + 4);
    plan->path_capacity = 4 * global;
    plan->path_x = ARENA_ARRAY(a, float, plan->path_capacity);
    plan->path_y = ARENA_ARRAY(a, float, plan->path_capacity);
    plan->plan = ARENA_ARRAY(a, double, 2 * (plan->path_capacity + 1));

    n->latest = ARENA_ARRAY(a, double, 2 * (plan->path_capacity + 1));
    n->local_plan.plan.capacity = plan->path_capacity + 1;
    n->local_plan.plan.x = ARENA_ARRAY(a, double, plan->path_capacity + 1);
    n->local_plan.plan.y = ARENA_ARRAY(a, double, plan->path_capacity + 1);
    n->seen.x = ARENA_ARRAY(a, float, s->beams + OBSERVATION_PADDING);
    n->seen.y = ARENA_ARRAY(a, float, s->beams + OBSERVATION_PADDING);
    n->seen.marks = ARENA_ARRAY(a, int32_t, s->beams + 1);
    n->seen.lines = ARENA_ARRAY(a, raytrace_line, s->beams);
    n->beam_cos = ARENA_ARRAY(a, double, s->beams);
    n->beam_sin = ARENA_ARRAY(a, double, s->beams);
    memory_layout_rollouts(&n->local_plan.rollouts, s, local, a);
}

size_t navigator_bytes(const planner_settings *set) {
    navigator unused;
    arena a = {NULL, 0};
    memset(&unused, 0, sizeof unused);
    arena_alloc(&a, sizeof unused);
    memory_layout_navigator(&unused, set, &a);
    return a.used;
}
