// The minimum of many bounds that change one at a time: a tree of minima, eight children a node. No branch depends on
// the bounds.
#pragma once
#include <math.h>
#include <stdint.h>

enum { MINIMUM_TREE_FANOUT = 8, MINIMUM_TREE_DEPTH_MAX = 4, MINIMUM_TREE_LEAVES_MAX = 4096 };

typedef struct {
    double *level[MINIMUM_TREE_DEPTH_MAX];  // [0] the bounds, each further one the minima of eights of the one before
    int depth;                              // levels in use; the last has eight entries
} minimum_tree;

static inline double minimum_of_eight(const double *v) {
    const double a = v[1] < v[0] ? v[1] : v[0];
    const double b = v[3] < v[2] ? v[3] : v[2];
    const double c = v[5] < v[4] ? v[5] : v[4];
    const double d = v[7] < v[6] ? v[7] : v[6];
    const double e = b < a ? b : a;
    const double f = d < c ? d : c;
    return f < e ? f : e;
}

static inline void minimum_tree_set(minimum_tree *t, int at, double bound) {
    t->level[0][at] = bound;
    for (int k = 1; k < t->depth; ++k) {
        at /= MINIMUM_TREE_FANOUT;
        t->level[k][at] = minimum_of_eight(t->level[k - 1] + MINIMUM_TREE_FANOUT * at);
    }
}

// After the first `count` (1 to LOWEST_MAX) bounds were written to level[0].
static inline void minimum_tree_build(minimum_tree *t, int count) {
    for (t->depth = 1;; ++t->depth) {
        double *from = t->level[t->depth - 1];
        for (; count % MINIMUM_TREE_FANOUT; ++count) from[count] = INFINITY;
        count /= MINIMUM_TREE_FANOUT;
        if (count == 1) return;
        for (int i = 0; i < count; ++i) t->level[t->depth][i] = minimum_of_eight(from + MINIMUM_TREE_FANOUT * i);
    }
}

// Index of the first of the lowest bounds.
static inline int minimum_tree_first(const minimum_tree *t) {
    const double lowest = minimum_of_eight(t->level[t->depth - 1]);
    int at = 0;
    for (int k = t->depth - 1; k >= 0; --k) {
        const double *v = t->level[k] + MINIMUM_TREE_FANOUT * at;
        unsigned here = 0;
        for (int i = 0; i < MINIMUM_TREE_FANOUT; ++i) here |= (unsigned)(v[i] <= lowest) << i;
        at = MINIMUM_TREE_FANOUT * at + __builtin_ctz(here);
    }
    return at;
}
