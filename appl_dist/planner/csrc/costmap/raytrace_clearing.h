// Which marked cells a fan of lines passes: Costmap2D::raytraceLine turned around. Few cells are marked, so each looks
// for the lines that may pass it, by direction, and asks them for the exact cells of their integer line.
#pragma once
#include "grid.h"

enum { FAN_SECTORS = 512, FAN_AROUND = 3 };

typedef struct {
    int16_t dx, dy;  // cells from start to end
    int32_t next;    // line of the same sector, -1 the last
} fan_line;

// All lines start in cell (x0, y0) and free at most `reach` cells.
typedef struct {
    int x0, y0, reach;
    fan_line *lines;               // (capacity of the caller)
    int count;
    int32_t first[FAN_SECTORS];    // line of the sector, -1 none
    int16_t longest[FAN_SECTORS];  // no line of the sector takes more steps
    int16_t around[FAN_SECTORS];   // nor of those up to FAN_AROUND sectors away
} line_fan;

static inline void fan_add(line_fan *f, int x1, int y1) {
    f->lines[f->count++] = (fan_line){.dx = (int16_t)(x1 - f->x0), .dy = (int16_t)(y1 - f->y0)};
}
// Frees the cells of `layer` (h, w), readable LAYER_PADDING bytes beyond its end, that a line passes.
void fan_free(line_fan *f, uint8_t *layer, int w, int h);
