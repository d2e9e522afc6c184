// costmap_2d::InflationLayer: costs around lethal cells by a brushfire over distance bins.
// The brushfire is not an exact distance transform; its order is copied so that every cell agrees.
#pragma once
#include "grid.h"
#include "settings.h"

enum { INFLATION_BINS_MAX = 250, INFLATION_REACH = INFLATION_CELLS_MAX + 1, INFLATION_SIDE = 2 * INFLATION_REACH + 1 };

typedef struct {
    int32_t cell, next;  // the next in the same bin, -1 the last
    int16_t offset;      // from the obstacle it grew from: row of INFLATION_SIDE, column
} inflation_entry;

// Where the fire goes from an offset: the bin a neighbour would be in, 255 where it may not go.
typedef struct {
    uint8_t left, up, right, down;
} inflation_moves;

// Shared by the maps of one planner; sized for the largest.
typedef struct {
    uint8_t *best;             // (h, w) lowest bin a cell waits in or was processed in
    inflation_entry *entries;  // (capacity)
    int capacity;
} inflation_scratch;

enum { INFLATION_ENTRIES_PER_CELL = 5 };  // itself as an obstacle and once from each side

typedef struct {
    double radius, inscribed, weight;  // m, m, 1/m
    double res;                        // m
    int cells, bins;                   // reach in cells; distinct distances
    inflation_moves moves[INFLATION_SIDE * INFLATION_SIDE];  // by offset
    uint8_t cost_of_bin[INFLATION_BINS_MAX];
    bool need_reinflation;
    double last_min_x, last_min_y, last_max_x, last_max_y;  // m, bounds of the previous update
} inflation;

// False when the radius is negative, not finite or beyond INFLATION_CELLS_MAX cells; the layer is then unchanged.
bool inflation_set(inflation *f, double radius, double weight, double inscribed, double res);
// Widens this cycle's bounds as InflationLayer::updateBounds does.
void inflation_bounds(inflation *f, double *min_x, double *min_y, double *max_x, double *max_y);
// Inflates the lethal cells in and near columns [x0, xn), rows [y0, yn) of a (h, w) map.
void inflation_run(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, int x0, int y0, int xn,
                   int yn);
