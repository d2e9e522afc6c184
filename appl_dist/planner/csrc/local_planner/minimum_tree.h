// The lowest of many bounds that change one at a time: a tree of minima, eight children a node. Neither way takes a
// branch that depends on the bounds.
#pragma once
#include <math.h>
#include <stdint.h>

enum { LOWEST_FAN = 8, LOWEST_DEPTH_MAX = 4, LOWEST_MAX = 4096 };

typedef struct {
    double *level[LOWEST_DEPTH_MAX];  // [0] the bounds, each further one the minima of eights of the one before
    int depth;                        // levels in use; the last has eight entries
} lowest_tree;

static inline double lowest_of_eight(const double *v) {
    const double a = v[1] < v[0] ? v[1] : v[0], b = v[3] < v[2] ? v[3] : v[2];
    const double c = v[5] < v[4] ? v[5] : v[4], d = v[7] < v[6] ? v[7] : v[6];
    const double e = b < a ? b : a, f = d < c ? d : c;
    return f < e ? f : e;
}

static inline void lowest_set(lowest_tree *t, int at, double bound) {
    t->level[0][at] = bound;
    for (int k = 1; k < t->depth; ++k) {
        at /= LOWEST_FAN;
        t->level[k][at] = lowest_of_eight(t->level[k - 1] + LOWEST_FAN * at);
    }
}

// After the first `count` (1 to LOWEST_MAX) bounds were written to level[0].
static inline void lowest_build(lowest_tree *t, int count) {
    for (t->depth = 1;; ++t->depth) {
        double *from = t->level[t->depth - 1];
        for (; count % LOWEST_FAN; ++count) from[count] = INFINITY;
        count /= LOWEST_FAN;
        if (count == 1) return;
        for (int i = 0; i < count; ++i) t->level[t->depth][i] = lowest_of_eight(from + LOWEST_FAN * i);
    }
}

// Place of the first of the lowest.
static inline int lowest_first(const lowest_tree *t) {
    const double lowest = lowest_of_eight(t->level[t->depth - 1]);
    int at = 0;
    for (int k = t->depth - 1; k >= 0; --k) {
        const double *v = t->level[k] + LOWEST_FAN * at;
        unsigned here = 0;
        for (int i = 0; i < LOWEST_FAN; ++i) here |= (unsigned)(v[i] <= lowest) << i;
        at = LOWEST_FAN * at + __builtin_ctz(here);
    }
    return at;
}
