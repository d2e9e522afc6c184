#include "navfn.h"

#include <string.h>

enum { NEUTRAL = 50, BLOCKED = 254, FIRST_THRESHOLD = 254, THRESHOLD_STEP = 100 };
#define POTENTIAL_NONE 1.0e10f

void navfn_init(navfn *n) {
    for (int c = 0; c < 256; ++c) {
        const int v = (int)(NEUTRAL + 0.8 * c);
        n->cost_of[c] = c < COST_INSCRIBED ? (uint8_t)(v >= BLOCKED ? BLOCKED - 1 : v)
                                           : (c == COST_UNKNOWN ? BLOCKED - 1 : BLOCKED);
        n->per_cost[c] = 1.0f / (float)(c ? c : 1);
        n->step_of[c] = c >= BLOCKED ? INFINITY : (float)(0.707106781 * (float)c);
    }
    const int cells = n->w * n->h;
    memset(n->master, COST_UNKNOWN, (size_t)cells);
    memset(n->cost, BLOCKED, (size_t)cells);
    for (int y = 1; y < n->h - 1; ++y) memset(n->cost + y * n->w + 1, n->cost_of[COST_UNKNOWN], (size_t)(n->w - 2));
    for (int i = 0; i < cells; ++i) n->potential[i] = POTENTIAL_NONE, n->step[i] = n->step_of[n->cost[i]];
    n->reached_count = 0;
    n->remain_goal = -1;
    n->fresh = false;
    n->plan_count = 0;
    n->goal_potential = 0;
}

// Whether the last wave came to the cell or beside it.
static bool seen(const navfn *n, int i) {
    const float *p = n->potential;
    const float least = fminf(fminf(p[i - 1], p[i + 1]), fminf(p[i - n->w], p[i + n->w]));
    return fminf(least, p[i]) < POTENTIAL_NONE;
}

void navfn_sync(navfn *n, const uint8_t *master, grid_window k) {
    enum { RUN = 32 };  // cells compared at once
    const int x0 = k.x0 > 1 ? k.x0 : 1, xn = k.xn < n->w - 1 ? k.xn : n->w - 1;
    for (int y = k.y0 > 1 ? k.y0 : 1; y < k.yn && y < n->h - 1; ++y)
        for (int x = x0; x < xn; x += RUN) {
            const int first = y * n->w + x, count = xn - x < RUN ? xn - x : RUN;
            if (count == RUN) {
                uint64_t was[RUN / 8], is[RUN / 8];
                memcpy(was, n->master + first, RUN);
                memcpy(is, master + first, RUN);
                if (!((was[0] ^ is[0]) | (was[1] ^ is[1]) | (was[2] ^ is[2]) | (was[3] ^ is[3]))) continue;
            }
            for (int i = first; i < first + count; ++i) {
                if (n->master[i] == master[i]) continue;
                n->master[i] = master[i];
                const uint8_t c = n->cost_of[master[i]];
                if (n->cost[i] == c) continue;
                n->cost[i] = c;
                n->step[i] = n->step_of[c];
                n->fresh = n->fresh && !seen(n, i);
            }
        }
}

// New potential of a cell from its two lowest neighbours: planar wave, quadratic approximation. The mixture of
// float and double is the original's.
static inline float planar_wave(float across, float along, float cost) {
    const float low = across < along ? across : along;
    const float gap = fabsf(across - along);
    const float d = gap / cost;
    const float v = (float)(-0.2301 * d * d + 0.5307 * d + 0.7040);
    return gap >= cost ? low + cost : low + cost * v;
}

// Only cells that can matter are given a potential: those with p + h <= bound, h being a lower bound of what the wave
// adds from there to the goal (plane waves rise by at least 0.9956 * 50 a cell, in any direction).
// A cell takes its potential from neighbours whose p + h is lower, or higher by less than one cell's rise. What a
// missing neighbour changes is at most 0.0046 of a cell's cost and at least halves with every further cell, so it dies
// out below float32 within some dozen cells of the bound; NAVFN_MARGIN_EXACT keeps the path, and the cells its gradient
// reads, farther away. That is an argument, not a proof; what is known is from comparing with the whole wave. Random maps
// and all reference plans: the same bits. Of 20562 plans of 60 recorded drives 12, all of one drive and by at most
// 0.3 mm, differ with a margin of 1300, none with 1600. A bound from a wave rooted at the goal does not help: even one
// without any error needs this width, and then saves only a tenth of the cells.
#define RISE_PER_CELL 49.0f
#define SLACK 100.0f  // the wave is done again where the guess was too low by more
#define WIDER 1500.0f

static void measure_remaining(navfn *n, int goal) {
    const int gx = goal % n->w, gy = goal / n->w;
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

// The same in single precision, from 1 / cost.
static inline float planar_wave_single(float across, float along, float cost, float per_cost) {
    const float low = across < along ? across : along;
    const float gap = fabsf(across - along);
    const float d = gap * per_cost;
    const float v = (0.7040f + 0.5307f * d) - 0.2301f * d * d;
    return gap >= cost ? low + cost : low + cost * v;
}

typedef struct {
    int32_t *cells;
    int count;
} buffer;

static inline void take_out(navfn *n, int cell) { n->step[cell] = n->step_of[n->cost[cell]]; }

// Gives the cells in `now` their lower potentials, and their neighbours places in `next` or `over`.
static inline void update_cells(navfn *n, const buffer *now, float threshold, buffer *next, buffer *over, bool single) {
    float *p = n->potential, *step = n->step;
    const float *remain = n->remain, bound = n->bound;
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
        const float before = p[i], potential = single ? planar_wave_single(across, along, costs[i], n->per_cost[costs[i]])
                                                      : planar_wave(across, along, costs[i]);
        if (!(potential < before) || !(potential + remain[i] <= bound)) continue;
        *reached = i;
        reached += before >= POTENTIAL_NONE;
        p[i] = potential;
        const int far = !(potential < threshold);
        int32_t *cells = buffers[far];
        int end = count[far];
        for (int j = 0; j < 4; ++j) {
            if (!(beside[j] > potential + step[around[j]])) continue;
            cells[end++] = around[j];
            step[around[j]] = INFINITY;
        }
        for (; end > NAVFN_BUFFER; --end) take_out(n, cells[end - 1]);  // no room
        count[far] = end;
    }
    next->count = count[0], over->count = count[1];
    n->reached_count = (int)(reached - n->reached);
}

static void forget(navfn *n) {
    for (int k = 0; k < n->reached_count; ++k) n->potential[n->reached[k]] = POTENTIAL_NONE;
    n->reached_count = 0;
}

static void propagate(navfn *n, int start, int goal) {
    buffer now = {n->buffers[0], 0}, next = {n->buffers[1], 0}, over = {n->buffers[2], 0};
    float threshold = FIRST_THRESHOLD;
    forget(n);
    n->potential[start] = 0;
    n->reached[n->reached_count++] = start;
    const int around[4] = {start + 1, start - 1, start - n->w, start + n->w};
    for (int k = 0; k < 4; ++k)
        if (around[k] >= 0 && around[k] < n->w * n->h && n->step[around[k]] < INFINITY)
            now.cells[now.count++] = around[k];
    const int area = n->w * n->h / 20, cycles = area > n->w + n->h ? area : n->w + n->h;
    for (int cycle = 0; cycle < cycles && (now.count || next.count); ++cycle) {
        for (int k = 0; k < now.count; ++k) take_out(n, now.cells[k]);
        if (n->single) update_cells(n, &now, threshold, &next, &over, true);
        else update_cells(n, &now, threshold, &next, &over, false);
        n->cells += now.count;
        buffer t = now;
        now = next, next = t, next.count = 0;
        if (now.count == 0) {
            threshold += THRESHOLD_STEP;
            t = now;
            now = over, over = t, over.count = 0;
        }
        if (n->potential[goal] < POTENTIAL_NONE) break;
    }
    const buffer left[3] = {now, next, over};
    for (int b = 0; b < 3; ++b)
        for (int k = 0; k < left[b].count; ++k) take_out(n, left[b].cells[k]);
}

// The wave within a bound around what the last plan needed, widened until the goal's potential is well inside.
static void propagate_to_goal(navfn *n, int start, int goal) {
    if (n->remain_goal != goal) measure_remaining(n, goal);
    // What the last plan needed; in single precision less what the robot has covered of it since. Exactness keeps
    // that width.
    const float covered = n->single && n->potential[start] < n->goal_potential ? n->potential[start] : 0;
    const float guess = n->goal_potential > 0 ? n->goal_potential - covered + SLACK
                                              : 56.0f / RISE_PER_CELL * n->remain[start];
    n->bound = n->whole ? POTENTIAL_NONE : guess + n->margin;
    n->cells = 0;
    bool wider = false;
    for (;;) {
        propagate(n, start, goal);
        const float reached = n->potential[goal];
        if (n->bound >= POTENTIAL_NONE || reached + n->margin <= n->bound) break;
        // A goal not reached may be a long way round, or behind walls: in the end the wave is the whole one.
        n->bound = reached < POTENTIAL_NONE ? reached + n->margin + SLACK : wider ? POTENTIAL_NONE : n->bound + WIDER;
        wider = true;
    }
    n->goal_potential = n->potential[goal] < POTENTIAL_NONE ? n->potential[goal] : 0;
}

// hypotf without the call: the squares are exact in double, and nothing here comes near its range.
static inline float length_of(float x, float y) { return (float)sqrt((double)x * x + (double)y * y); }

static void gradient(const navfn *n, int i, float *gx, float *gy) {
    const float *p = n->potential;
    const float here = p[i];
    float dx = 0, dy = 0;
    *gx = *gy = 0;
    if (i < n->w || i > n->w * n->h - n->w || here >= POTENTIAL_NONE) return;
    if (p[i - 1] < POTENTIAL_NONE) dx += p[i - 1] - here;
    if (p[i + 1] < POTENTIAL_NONE) dx += here - p[i + 1];
    if (p[i - n->w] < POTENTIAL_NONE) dy += p[i - n->w] - here;
    if (p[i + n->w] < POTENTIAL_NONE) dy += here - p[i + n->w];
    const float length = length_of(dx, dy);
    if (!(length > 0)) return;
    const float scale = 1.0f / length;
    *gx = scale * dx;
    *gy = scale * dy;
}

static const int ring_x[8] = {-1, 0, 1, -1, 1, -1, 0, 1}, ring_y[8] = {-1, -1, -1, 0, 0, 1, 1, 1};

// NavFn::calcPath: half-cell steps down the gradient, cell steps where the wave's edge is near. Where it gives up,
// NavfnROS uses the points found so far all the same.
static int follow_gradient(navfn *n, int start, int goal) {
    const int w = n->w, cells = n->w * n->h;
    const float *p = n->potential;
    int at = goal, count = 0;
    float dx = 0, dy = 0, gx[4], gy[4];
    int known = -1;  // the cell whose corners' gradients are in gx, gy
    while (count < n->path_capacity) {
        int nearest = at + (int)roundf(dx) + (int)((float)w * roundf(dy));
        nearest = nearest < 0 ? 0 : nearest >= cells ? cells - 1 : nearest;
        if (p[nearest] < NEUTRAL) {
            n->path_x[count] = (float)(start % w);
            n->path_y[count] = (float)(start / w);
            return count + 1;
        }
        if (at < w || at > cells - w) return count;
        n->path_x[count] = (float)(at % w) + dx;
        n->path_y[count] = (float)(at / w) + dy;
        ++count;
        bool edge = count > 2 && n->path_x[count - 1] == n->path_x[count - 3] &&
                    n->path_y[count - 1] == n->path_y[count - 3];  // swinging between two points
        if (at == w || at == cells - w) return count;  // a corner of the ring: no eight neighbours
        if (at != known) {
            edge = edge || p[at] >= POTENTIAL_NONE;
            for (int k = 0; k < 8; ++k) edge = edge || p[at + ring_y[k] * w + ring_x[k]] >= POTENTIAL_NONE;
        }
        if (edge) {
            if (p[at] >= POTENTIAL_NONE) return count;
            int lowest = (int)p[at], best = at;
            for (int k = 0; k < 8; ++k) {
                const int i = at + ring_y[k] * w + ring_x[k];
                if (p[i] < (float)lowest) lowest = (int)p[i], best = i;
            }
            at = best;
            dx = dy = 0;
            continue;
        }
        const int corner[4] = {at, at + 1, at + w, at + w + 1};
        for (int k = 0; k < 4 && at != known; ++k) gradient(n, corner[k], &gx[k], &gy[k]);
        known = at;
        const float x1 = (float)((1.0 - dx) * gx[0] + dx * gx[1]), x2 = (float)((1.0 - dx) * gx[2] + dx * gx[3]);
        const float x = (float)((1.0 - dy) * x1 + dy * x2);
        const float y1 = (float)((1.0 - dx) * gy[0] + dx * gy[1]), y2 = (float)((1.0 - dx) * gy[2] + dx * gy[3]);
        const float y = (float)((1.0 - dy) * y1 + dy * y2);
        if (x == 0 && y == 0) return count;
        const float scale = 0.5f / length_of(x, y);
        dx += x * scale;
        dy += y * scale;
        if (dx > 1.0) ++at, dx = (float)(dx - 1.0);
        if (dx < -1.0) --at, dx = (float)(dx + 1.0);
        if (dy > 1.0) at += w, dy = (float)(dy - 1.0);
        if (dy < -1.0) at -= w, dy = (float)(dy + 1.0);
    }
    return count;
}

bool navfn_plan(navfn *n, const grid_frame *g, uint8_t *master, double start_x, double start_y, double goal_x,
                double goal_y) {
    int sx, sy, ex, ey;
    if (!world_to_map(g, start_x, start_y, &sx, &sy)) {
        n->fresh = false;
        n->plan_count = 0;
        n->cells = 0;
        return false;
    }
    const int start = sy * n->w + sx;
    master[start] = COST_FREE;
    navfn_sync(n, master, (grid_window){sx, sy, sx + 1, sy + 1});
    if (!world_to_map(g, goal_x, goal_y, &ex, &ey)) {
        n->fresh = false;
        n->plan_count = 0;
        n->cells = 0;
        return false;
    }
    const int goal = ey * n->w + ex;
    if (n->fresh && n->start == start && n->goal == goal && n->goal_x == goal_x && n->goal_y == goal_y)
        return n->plan_count > 0;
    n->fresh = true;
    n->start = start, n->goal = goal, n->goal_x = goal_x, n->goal_y = goal_y;
    n->plan_count = 0;
    propagate_to_goal(n, start, goal);
    if (!(n->potential[goal] < POTENTIAL_NONE)) return false;
    const int count = follow_gradient(n, start, goal);
    if (count == 0) return false;
    for (int i = 0; i < count; ++i) {
        n->plan[2 * i] = g->ox + (double)n->path_x[count - 1 - i] * g->res;
        n->plan[2 * i + 1] = g->oy + (double)n->path_y[count - 1 - i] * g->res;
    }
    n->plan[2 * count] = goal_x;
    n->plan[2 * count + 1] = goal_y;
    n->plan_count = count + 1;
    return true;
}
