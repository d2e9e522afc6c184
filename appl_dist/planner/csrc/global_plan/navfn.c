#include "navfn.h"

#include <string.h>

#include "navfn_path.h"
#include "navfn_wave.h"

enum { BLOCKED = 254 };

void navfn_init(navfn *n) {
    for (int c = 0; c < 256; ++c) {
        const int v = (int)(NAVFN_NEUTRAL + 0.8 * c);
        n->cost_of[c] = c < COST_INSCRIBED ? (uint8_t)(v >= BLOCKED ? BLOCKED - 1 : v)
                                           : (c == COST_UNKNOWN ? BLOCKED - 1 : BLOCKED);
        n->per_cost[c] = 1.0f / (float)(c ? c : 1);
        n->step_of[c] = c >= BLOCKED ? INFINITY : (float)(0.707106781 * (float)c);
    }
    const int cells = n->w * n->h;
    memset(n->master, COST_UNKNOWN, (size_t)cells);
    memset(n->cost, BLOCKED, (size_t)cells);
    for (int y = 1; y < n->h - 1; ++y) memset(n->cost + y * n->w + 1, n->cost_of[COST_UNKNOWN], (size_t)(n->w - 2));
    for (int i = 0; i < cells; ++i) {
        n->potential[i] = NAVFN_NONE;
        n->step[i] = n->step_of[n->cost[i]];
    }
    n->reached_count = 0;
    n->remain_goal = -1;
    navfn_restart(n);
}

void navfn_restart(navfn *n) {
    navfn_clear_potential(n);
    n->fresh = false;
    n->plan_count = 0;
    n->goal_potential = 0;
    n->cells = 0;
}

// Whether the last wave came to the cell or beside it.
static bool wave_reached(const navfn *n, int i) {
    const float *p = n->potential;
    const float least = fminf(fminf(p[i - 1], p[i + 1]), fminf(p[i - n->w], p[i + n->w]));
    return fminf(least, p[i]) < NAVFN_NONE;
}

void navfn_sync(navfn *n, const uint8_t *master, grid_window k) {
    enum { RUN = 32 };  // cells compared at once
    const int x0 = k.x0 > 1 ? k.x0 : 1;
    const int xn = k.xn < n->w - 1 ? k.xn : n->w - 1;
    for (int y = k.y0 > 1 ? k.y0 : 1; y < k.yn && y < n->h - 1; ++y)
        for (int x = x0; x < xn; x += RUN) {
            const int first = y * n->w + x;
            const int count = xn - x < RUN ? xn - x : RUN;
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
                n->fresh = n->fresh && !wave_reached(n, i);
            }
        }
}

bool navfn_plan(navfn *n, const grid_frame *g, uint8_t *master, double start_x, double start_y, double goal_x,
                double goal_y) {
    int sx, sy, ex, ey;
    if (!world_to_map(g, start_x, start_y, &sx, &sy)) {
        navfn_restart(n);
        return false;
    }
    const int start = sy * n->w + sx;
    master[start] = COST_FREE;
    navfn_sync(n, master, (grid_window){sx, sy, sx + 1, sy + 1});
    if (!world_to_map(g, goal_x, goal_y, &ex, &ey)) {
        navfn_restart(n);
        return false;
    }
    const int goal = ey * n->w + ex;
    if (n->fresh && n->start == start && n->goal == goal && n->goal_x == goal_x && n->goal_y == goal_y)
        return n->plan_count > 0;
    n->fresh = true;
    n->start = start;
    n->goal = goal;
    n->goal_x = goal_x;
    n->goal_y = goal_y;
    n->plan_count = 0;
    if (!navfn_wave(n, start, goal)) return false;
    const int count = navfn_follow(n, start, goal);
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
