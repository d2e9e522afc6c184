// Costs by stamping: a map keeps, at each cell, the highest cost any lethal cell gives it. What changed since the last
// time is stamped again, the rest stays.
#pragma once
#include "inflation.h"

// Whether stamping gives the costs that are asked for.
static inline bool inflation_stamps_exact(const inflation *f) {
    return f->cells > 0 && (f->stamps || f->cells <= INFLATION_EXACT_CELLS);
}

// `map` is (h, w), readable LAYER_PADDING bytes beyond its end.
void inflation_stamps_cell(const inflation *f, uint8_t *map, int w, int h, int cell);

// What copying `window` of `layer` (h, w; lethal or free) to `map` and inflation_run would do, given that `map` is
// what they left behind: its cells in `exact` and in the window hold the cost of their nearest lethal cell in `map`,
// those in `cleared` excepted, and what is lethal there has been stamped beyond it.
void inflation_stamps_update(const inflation *f, inflation_scratch *scratch, const uint8_t *layer, uint8_t *map, int w,
                             int h, grid_window window, grid_window exact, grid_window cleared);
