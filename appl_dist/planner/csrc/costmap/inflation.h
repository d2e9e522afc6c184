// costmap_2d::InflationLayer: costs around lethal cells by a brushfire over distance bins.
// The brushfire is not an exact distance transform; its order is copied so that every cell agrees.
#pragma once
#include "grid.h"
#include "settings.h"

enum { INFLATION_BINS_MAX = 250, INFLATION_REACH = INFLATION_CELLS_MAX + 1, INFLATION_SIDE = 2 * INFLATION_REACH + 1 };
enum { INFLATION_STAMP_ROWS = 2 * INFLATION_CELLS_MAX + 1, INFLATION_STAMP_WIDTH = 48 };

// Up to this reach the fire was found to be an exact distance transform, so that stamping gives the same costs (600
// random maps and all recorded ones; at 5 cells there is a map where it is not).
enum { INFLATION_EXACT_CELLS = 4 };

typedef struct {
    int32_t cell, offset;  // offset from the obstacle it grew from: row of INFLATION_SIDE, column
} inflation_entry;

// A piece of a bin's queue.
enum { INFLATION_PAGE = 63 };
typedef struct inflation_page {
    inflation_entry entries[INFLATION_PAGE];
    struct inflation_page *next;
} inflation_page;

// Where the fire goes from an offset, in the order left, up, right, down: never back towards the obstacle, as that cell
// would lie in an earlier bin, and never beyond the reach. Bin 255 goes nowhere.
typedef struct {
    uint8_t count;
    uint8_t bin[4], side[4];
} inflation_moves;

// Shared by the maps of one planner; sized for the largest.
typedef struct {
    uint8_t *best;          // (h, w) lowest bin a cell waits in or was processed in
    int32_t *lethal;        // (h * w)
    inflation_page *pages;  // (inflation_pages(h * w))
} inflation_scratch;

// A cell waits at most five times: itself as an obstacle and once from each side.
static inline int inflation_pages(int cells) { return 5 * cells / INFLATION_PAGE + 2 * INFLATION_BINS_MAX; }

typedef struct {
    double radius, inscribed, weight;                        // m, m, 1/m
    double res;                                              // m
    int cells, bins;                                         // reach in cells; distinct distances
    inflation_moves moves[INFLATION_SIDE * INFLATION_SIDE];  // by offset
    uint8_t cost_of_bin[INFLATION_BINS_MAX];
    bool stamps;  // cells take the cost of their nearest obstacle; the fire misses it for 2 in 10,000
    uint8_t stamp[INFLATION_STAMP_ROWS * INFLATION_STAMP_WIDTH];  // costs around an obstacle, rows of stamp_width
    int stamp_width;
    bool need_reinflation;
    double last_min_x, last_min_y, last_max_x, last_max_y;  // m, bounds of the previous update
} inflation;

// False when the radius is negative, not finite or beyond INFLATION_CELLS_MAX cells; the layer is then unchanged.
bool inflation_set(inflation *f, double radius, double weight, double inscribed, double res);
// Widens this cycle's bounds as InflationLayer::updateBounds does.
void inflation_bounds(inflation *f, double *min_x, double *min_y, double *max_x, double *max_y);
// Inflates the lethal cells in and near columns [x0, xn), rows [y0, yn) of a (h, w) map. True when it was by stamps.
bool inflation_run(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, int x0, int y0, int xn,
                   int yn);
