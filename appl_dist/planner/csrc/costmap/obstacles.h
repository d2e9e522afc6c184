// The obstacle layer of a costmap (costmap_2d::ObstacleLayer): a scan clears the cells its beams pass, then marks those
// they end in.
#pragma once
#include "raytrace_clearing.h"

// Points that may be read beyond a scan's last.
enum { OBSERVATION_PADDING = 64 };

// One lidar scan as points. Points are float32, as in the PointCloud2 that carries them in ROS.
typedef struct {
    double ox, oy;  // m, odom: the sensor
    float *x, *y;   // (count) m, odom
    int count;
    int32_t *marks;        // (beams) scratch: cells to mark
    raytrace_line *lines;  // (beams) scratch: lines of cells to clear
} observation;

typedef struct {
    double min_x, min_y, max_x, max_y;  // m
} bounds;

static inline void bounds_touch(bounds *b, double x, double y) {
    if (x < b->min_x) b->min_x = x;
    if (y < b->min_y) b->min_y = y;
    if (x > b->max_x) b->max_x = x;
    if (y > b->max_y) b->max_y = y;
}

// Bytes that may be read beyond a layer's last cell.
enum { LAYER_PADDING = 64 };
// Clears and marks cells of `layer` (h, w) and widens `b` by what the scan may have changed. Ranges in m.
void obstacles_observe(uint8_t *layer, const grid_frame *g, const observation *seen, double raytrace_range,
                       double obstacle_range, bounds *b);
