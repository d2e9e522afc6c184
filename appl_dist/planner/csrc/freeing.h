// Which marked cells a fan of lines passes: Costmap2D::raytraceLine turned around. Few cells are marked, so each looks
// for the lines that may pass it, by direction, and asks them for the exact cell of their integer line.
#pragma once
#include "grid.h"

enum { FAN_SECTORS = 512 };

typedef struct {
    int32_t den, num, add, steps;  // as grid_line, cut at the range
    int8_t forward, aside;         // signs of the main axis and of the other
    bool along_x;
    int32_t next;                  // line of the same sector, -1 the last
} fan_line;

// All lines start in cell (x0, y0) and free at most `reach` cells.
typedef struct {
    int x0, y0, reach;
    fan_line *lines;              // (capacity of the caller)
    int count;
    int32_t first[FAN_SECTORS];   // line of the sector, -1 none
    int32_t longest[FAN_SECTORS]; // steps
} line_fan;

void fan_start(line_fan *f, int x0, int y0, int reach);
void fan_add(line_fan *f, int x1, int y1);
// Frees the cells of `layer` (h, w), readable 8 bytes beyond its end, that a line passes.
void fan_free(const line_fan *f, uint8_t *layer, int w, int h);
