// The padded rectangular footprint: its corners in the world and the cells it covers.
#pragma once
#include "grid.h"

enum { FOOTPRINT_CORNERS = 4, FOOTPRINT_COLUMNS_MAX = 256 };

typedef struct {
    double x[FOOTPRINT_CORNERS], y[FOOTPRINT_CORNERS];  // m, robot frame, order of the yaml
    double reach;                                       // m, centre to the farthest corner
} footprint_shape;

footprint_shape footprint_make(double half_length, double half_width, double padding);

// Cells of the four corners at a pose; false when one is off the map.
static inline bool footprint_corner_cells(const footprint_shape *f, const grid_frame *g, double x, double y,
                                          double cos_th, double sin_th, grid_cell out[FOOTPRINT_CORNERS]) {
    for (int i = 0; i < FOOTPRINT_CORNERS; ++i)
        if (!world_to_map(g, x + (f->x[i] * cos_th - f->y[i] * sin_th), y + (f->x[i] * sin_th + f->y[i] * cos_th),
                          &out[i].x, &out[i].y))
            return false;
    return true;
}

// The lines of base_local_planner::LineIterator between any two corners of one side, as steps in a map's memory.
typedef struct {
    int reach;       // cells between the corners at most, in a column or a row
    int16_t *cells;  // (2 reach + 1, 2 reach + 1, reach + 1) by dy, dx; the last cell is repeated
} footprint_lines;

int footprint_line_reach(const footprint_shape *f, double res);
void footprint_lines_make(footprint_lines *l, int reach, int row);  // `row`: cells in a row of the map
static inline int footprint_line_at(const footprint_lines *l, int dx, int dy) {
    return ((dy + l->reach) * (2 * l->reach + 1) + dx + l->reach) * (l->reach + 1);
}

// Highest cost under the outline at a pose: -1 where it touches a lethal or unknown cell or leaves the map
// (CostmapModel::footprintCost).
int footprint_outline_cost(const footprint_shape *f, const footprint_lines *l, const grid_frame *g, const uint8_t *cost,
                           double x, double y, double cos_th, double sin_th);
// The same, of the outline through the cells of the corners.
int footprint_cells_cost(const footprint_lines *l, const grid_frame *g, const uint8_t *cost,
                         const grid_cell c[FOOTPRINT_CORNERS]);

// Outline and inside, one run of cells a column (Costmap2D::convexFillCells). `count` columns from `x0`.
typedef struct {
    int x0, count;
    int low[FOOTPRINT_COLUMNS_MAX], high[FOOTPRINT_COLUMNS_MAX];
} footprint_columns;

// False when a corner is off the map: ROS then leaves the map alone.
bool footprint_fill(const footprint_shape *f, const grid_frame *g, double x, double y, double yaw,
                    footprint_columns *out);
