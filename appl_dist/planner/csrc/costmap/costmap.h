// One layered costmap: obstacle layer (costmap_2d::ObstacleLayer, combination by maximum) and inflation,
// updated inside bounds as costmap_2d::LayeredCostmap does.
#pragma once
#include "footprint.h"
#include "inflation.h"
#include "obstacles.h"

typedef struct {
    grid_frame frame;
    bool rolling;        // follows the robot
    uint8_t *obstacles;  // (h, w) the layer: lethal or free
    uint8_t *master;     // (h, w) what the planners read
    inflation inflate;
    grid_window exact;    // each cell of `master` in it holds the cost of its nearest lethal one; may be empty
    grid_window cleared;  // holds the cells of `master` cleared since the last update
    grid_window touched;  // cells of `master` the last update may have changed
} costmap;

void costmap_clear(costmap *m, double origin_x, double origin_y);
// A point's cell of `master` was cleared from outside.
void costmap_mark_cleared(costmap *m, double x, double y);
// pose: x, y, yaw. `seen` may be empty.
void costmap_update(costmap *m, inflation_scratch *scratch, const planner_settings *set, const footprint_shape *shape,
                    const observation *seen, const double pose[3]);
