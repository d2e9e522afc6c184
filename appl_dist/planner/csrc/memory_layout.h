// Memory of a navigator: laid out by running the same walk twice, once to count, once to hand out.
#pragma once
#include "navigator.h"

typedef struct {
    char *base;  // NULL: only count
    size_t used;
} arena;

void *arena_alloc(arena *a, size_t bytes);
// Points every array of `n` into the arena.
void memory_layout_navigator(navigator *n, const planner_settings *set, arena *a);
