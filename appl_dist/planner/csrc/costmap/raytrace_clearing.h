// Clears the marked cells that a scan's lines cross: Costmap2D::raytraceLine turned around. Few cells are marked, so
// for each of them the lines of about its direction are tested, with the exact cells of their integer lines.
#pragma once
#include "grid.h"

enum { RAYTRACE_SECTORS = 512, RAYTRACE_SECTORS_AROUND = 3 };

typedef struct {
    int16_t dx, dy;  // cells from start to end
    int32_t next;    // line of the same sector, -1 the last
} raytrace_line;

// All lines start in cell (x0, y0) and clear at most `reach` cells.
typedef struct {
    int x0, y0, reach;
    raytrace_line *lines;  // (capacity of the caller)
    int count;
    int32_t first[RAYTRACE_SECTORS];    // line of the sector, -1 none
    int16_t longest[RAYTRACE_SECTORS];  // no line of the sector takes more steps
    int16_t around[RAYTRACE_SECTORS];   // nor of those up to FAN_AROUND sectors away
} raytrace_clearing;

static inline void raytrace_clearing_add(raytrace_clearing *f, int x1, int y1) {
    f->lines[f->count++] = (raytrace_line){.dx = (int16_t)(x1 - f->x0), .dy = (int16_t)(y1 - f->y0)};
}
// Clears the cells of `layer` (h, w), readable LAYER_PADDING bytes beyond its end, that a line crosses.
void raytrace_clearing_run(raytrace_clearing *f, uint8_t *layer, int w, int h);
