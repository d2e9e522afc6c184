// Connectivity of a grid of free and blocked cells.
#pragma once
#include <stdint.h>

// Mark in `region` (rows, cols) the 4-connected free cells that lead across the grid: the largest region touching the
// first column, if that is also the largest touching the last. `stack` holds rows * cols indices.
// Returns the number of its cells, 0 if nothing leads across.
int grid_connectivity_crossing(const uint8_t *blocked, int rows, int cols, uint8_t *region, int32_t *stack);
