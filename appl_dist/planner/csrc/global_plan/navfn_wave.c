#include "navfn_wave.h"

enum { FIRST_THRESHOLD = 254, THRESHOLD_STEP = 100 };

// New potential of a cell from its two lowest neighbours: planar wave, quadratic approximation. The mixture of
// float and double is the original's.
static inline float planar_wave(float across, float along, float cost) {
    const float low = across < along ? across : along;
    const float gap = fabsf(across - along);
    const float d = gap / cost;
    const float v = (float)(-0.2301 * d * d + 0.5307 * d + 0.7040);
    return gap >= cost ? low + cost : low + cost * v;
}

// The same in single precision, from 1 / cost.
static inline float planar_wave_single(float across, float along, float cost, float per_cost) {
    const float low = across < along ? across : along;
    const float gap = fabsf(across - along);
    const float d = gap * per_cost;
    const float v = (0.7040f + 0.5307f * d) - 0.2301f * d * d;
    return gap >= cost ? low + cost : low + cost * v;
}

// Only cells that can matter are given a potential: those with p + h <= bound, h being a lower bound of what the wave
// adds from there to the goal (plane waves rise by at least 0.9956 * 50 a cell, in any direction).
// A cell takes its potential from neighbours whose p + h is lower, or higher by less than one cell's rise. What a
// missing neighbour changes is at most 0.0046 of a cell's cost and at least halves with every further cell, so it dies
// out below float32 within some dozen cells of the bound; NAVFN_MARGIN_EXACT keeps the path, and the cells its gradient
// reads, farther away. That is an argument, not a proof; what is known is from comparing with the whole wave. Random
// maps and all reference plans: the same bits. Of 20562 plans of 60 recorded drives 12, all of one drive and by at most
// 0.3 mm, differ with a margin of 1300, none with 1600. A bound from a wave rooted at the goal does not help: even one
// without any error needs this width, and then saves only a tenth of the cells.
#define RISE_PER_CELL 49.0f
#define BOUND_SLACK 100.0f  // the wave is done again where the guess was too low by more
#define BOUND_STEP 1500.0f

static void measure_remaining(navfn *n, int goal) {
    const int gx = goal % n->w;
    const int gy = goal / n->w;
    for (int y = 0; y < n->h; ++y) {
        const float dy = (float)(y - gy);
        float *row = n->remain + y * n->w;
        for (int x = 0; x < n->w; ++x) {
            const float dx = (float)(x - gx);
            row[x] = RISE_PER_CELL * sqrtf(dx * dx + dy * dy);
        }
    }
    n->remain_goal = goal;
}

typedef struct {
    int32_t *cells;
    int count;
} buffer;

static inline void remove_from_buffer(navfn *n, int cell) { n->step[cell] = n->step_of[n->cost[cell]]; }

// Gives the cells in `now` their lower potentials, and their neighbours places in `next` or `over`.
static inline void update_cells(navfn *n, const buffer *now, float threshold, buffer *next, buffer *over, bool single) {
    float *p = n->potential;
    float *step = n->step;
    const float *remain = n->remain;
    const float bound = n->bound;
    const uint8_t *costs = n->cost;
    const int w = n->w;
    int32_t *reached = n->reached + n->reached_count;
    int32_t *const buffers[2] = {next->cells, over->cells};
    int count[2] = {next->count, over->count};
    for (int k = 0; k < now->count; ++k) {
        const int i = now->cells[k];
        const int around[4] = {i - 1, i + 1, i - w, i + w};
        float beside[4];
        for (int j = 0; j < 4; ++j) beside[j] = p[around[j]];
        const float across = beside[0] < beside[1] ? beside[0] : beside[1];
        const float along = beside[2] < beside[3] ? beside[2] : beside[3];
        const uint8_t cost = costs[i];
        const float potential =
            single ? planar_wave_single(across, along, cost, n->per_cost[cost]) : planar_wave(across, along, cost);
        const float before = p[i];
        if (!(potential < before) || !(potential + remain[i] <= bound)) continue;
        *reached = i;
        reached += before >= NAVFN_NONE;
        p[i] = potential;
        const int far = !(potential < threshold);
        int32_t *cells = buffers[far];
        int end = count[far];
        for (int j = 0; j < 4; ++j) {
            if (!(beside[j] > potential + step[around[j]])) continue;
            cells[end++] = around[j];
            step[around[j]] = INFINITY;
        }
        for (; end > NAVFN_BUFFER; --end) remove_from_buffer(n, cells[end - 1]);  // no room
        count[far] = end;
    }
    next->count = count[0];
    over->count = count[1];
    n->reached_count = (int)(reached - n->reached);
}

void navfn_clear_potential(navfn *n) {
    for (int k = 0; k < n->reached_count; ++k) n->potential[n->reached[k]] = NAVFN_NONE;
    n->reached_count = 0;
}

static void propagate(navfn *n, int start, int goal) {
    buffer now = {n->buffers[0], 0};
    buffer next = {n->buffers[1], 0};
    buffer over = {n->buffers[2], 0};
    float threshold = FIRST_THRESHOLD;
    navfn_clear_potential(n);
    n->potential[start] = 0;
    n->reached[n->reached_count++] = start;
    const int around[4] = {start + 1, start - 1, start - n->w, start + n->w};
    for (int k = 0; k < 4; ++k)
        if (around[k] >= 0 && around[k] < n->w * n->h && n->step[around[k]] < INFINITY)
            now.cells[now.count++] = around[k];
    const int area = n->w * n->h / 20;
    const int cycles = area > n->w + n->h ? area : n->w + n->h;
    for (int cycle = 0; cycle < cycles && (now.count || next.count); ++cycle) {
        for (int k = 0; k < now.count; ++k) remove_from_buffer(n, now.cells[k]);
        if (n->single) update_cells(n, &now, threshold, &next, &over, true);
        else update_cells(n, &now, threshold, &next, &over, false);
        n->cells += now.count;
        buffer t = now;
        now = next;
        next = t;
        next.count = 0;
        if (now.count == 0) {
            threshold += THRESHOLD_STEP;
            t = now;
            now = over;
            over = t;
            over.count = 0;
        }
        if (n->potential[goal] < NAVFN_NONE) break;
    }
    const buffer left[3] = {now, next, over};
    for (int b = 0; b < 3; ++b)
        for (int k = 0; k < left[b].count; ++k) remove_from_buffer(n, left[b].cells[k]);
}

bool navfn_wave(navfn *n, int start, int goal) {
    if (n->remain_goal != goal) measure_remaining(n, goal);
    // What the last plan needed; in single precision less what the robot has covered of it since. Exactness keeps
    // that width.
    const float covered = n->single && n->potential[start] < n->goal_potential ? n->potential[start] : 0;
    const float guess =
        n->goal_potential > 0 ? n->goal_potential - covered + BOUND_SLACK : 56.0f / RISE_PER_CELL * n->remain[start];
    n->bound = n->whole ? NAVFN_NONE : guess + n->margin;
    n->cells = 0;
    bool wider = false;
    for (;;) {
        propagate(n, start, goal);
        const float reached = n->potential[goal];
        if (n->bound >= NAVFN_NONE || reached + n->margin <= n->bound) break;
        // A goal not reached may be a long way round, or behind walls: in the end the wave is the whole one.
        n->bound = reached < NAVFN_NONE ? reached + n->margin + BOUND_SLACK
                   : wider              ? NAVFN_NONE
                                        : n->bound + BOUND_STEP;
        wider = true;
    }
    const bool reached = n->potential[goal] < NAVFN_NONE;
    n->goal_potential = reached ? n->potential[goal] : 0;
    return reached;
}
