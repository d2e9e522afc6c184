#include "grid_connectivity.h"

#include <string.h>

// Give `label` to the free cells connected to `seed`; returns how many there are.
static int flood(const uint8_t *blocked, int rows, int cols, uint8_t *region, int32_t *stack, int32_t seed,
                 uint8_t label) {
    int size = 0;
    int depth = 0;
    region[seed] = label;
    stack[depth++] = seed;
    while (depth > 0) {
        const int32_t cell = stack[--depth];
        const int r = cell / cols;
        const int c = cell % cols;
        ++size;
        const int32_t next[4] = {r > 0 ? cell - cols : -1, r + 1 < rows ? cell + cols : -1, c > 0 ? cell - 1 : -1,
                                 c + 1 < cols ? cell + 1 : -1};
        for (int k = 0; k < 4; ++k)
            if (next[k] >= 0 && !blocked[next[k]] && !region[next[k]]) {
                region[next[k]] = label;
                stack[depth++] = next[k];
            }
    }
    return size;
}

// Label of the largest region with a cell in `column`; regions found before keep their labels.
static uint8_t largest(const uint8_t *blocked, int rows, int cols, uint8_t *region, int32_t *stack, int column,
                       int *sizes, uint8_t *labels) {
    uint8_t best = 0;
    for (int r = 0; r < rows; ++r) {
        const int32_t cell = r * cols + column;
        if (blocked[cell]) continue;
        if (!region[cell]) {
            ++*labels;
            sizes[*labels] = flood(blocked, rows, cols, region, stack, cell, *labels);
        }
        if (!best || sizes[region[cell]] > sizes[best]) best = region[cell];
    }
    return best;
}

int grid_connectivity_crossing(const uint8_t *blocked, int rows, int cols, uint8_t *region, int32_t *stack) {
    int sizes[256] = {0};  // at most one region for each cell of two columns: rows < 128
    uint8_t labels = 0;
    memset(region, 0, (size_t)rows * (size_t)cols);
    const uint8_t left = largest(blocked, rows, cols, region, stack, 0, sizes, &labels);
    const uint8_t right = largest(blocked, rows, cols, region, stack, cols - 1, sizes, &labels);
    if (!left || left != right) return 0;
    for (int i = 0; i < rows * cols; ++i) region[i] = region[i] == left;
    return sizes[left];
}
