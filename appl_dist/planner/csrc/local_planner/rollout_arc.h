// Where a sample leads, without stepping there. Once its velocities are reached a roll-out runs on an arc of equal
// steps, and each of its poses has a closed form. It differs from the sum of steps in ROS by rounding, below 1e-10 m;
// who asks for cells takes a point within CELL_DOUBT of a cell's edge for undecided, and steps there instead.
#pragma once
#include <string.h>

#include "simulate.h"
#include "wide.h"

#define CELL_DOUBT 1e-6  // cells: 5e-8 m at 0.05 m

enum { ACCELERATION_STEPS_MAX = 64, ROLLOUT_ARC_STEPS_MAX = 10000, POSE_BATCH = 8 };

typedef struct {
    double v, w;        // m/s, rad/s
    double x, y, th;    // pose at step `from`, after which both velocities are held
    double turn, pace;  // rad and m a step
    double per_half;    // 1 / sin(turn / 2); 0 for a straight line
    double dt;          // s
    int steps, from;
} rollout_arc;

// Poses at some steps of an arc, the cells of their centres, and those of the footprint's corners.
typedef struct {
    double step[POSE_BATCH];
    double x[POSE_BATCH], y[POSE_BATCH], sine[POSE_BATCH], cosine[POSE_BATCH];
    int32_t cx[POSE_BATCH], cy[POSE_BATCH], known[POSE_BATCH];  // cell of the centre, as rollout_arc_cell
    int32_t corner_x[FOOTPRINT_CORNERS][POSE_BATCH], corner_y[FOOTPRINT_CORNERS][POSE_BATCH];
    int32_t corners_known[POSE_BATCH];
} pose_batch;

// Fills a batch from its steps, which have to be those of the arc.
void rollout_arc_poses(const rollout_arc *a, const rollout_planner *p, const motion *m, pose_batch *at);
void rollout_arc_corners(const rollout_planner *p, pose_batch *at);

// sin and cos to 1e-13 for |angle| < 1e4.
ALWAYS_INLINE void rollout_arc_sincos(double angle, double *s, double *c) {
    const double magic = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to a whole number, kept in the low bits
    const double rounded = angle * 0.63661977236758134308 + magic;
    const double k = rounded - magic;
    const double r = (angle - k * 1.5707963267341256) - k * 6.077100506506192e-11;
    const double z = r * r;
    const double sine =
        r + r * z *
                (-1.6666666666666666e-1 +
                 z * (8.333333333333333e-3 +
                      z * (-1.984126984126984e-4 +
                           z * (2.7557319223985893e-6 + z * (-2.505210838544172e-8 + z * 1.6059043836821613e-10)))));
    const double cosine =
        1.0 +
        z * (-0.5 +
             z * (4.1666666666666664e-2 +
                  z * (-1.388888888888889e-3 +
                       z * (2.48015873015873e-5 +
                            z * (-2.755731922398589e-7 + z * (2.08767569878681e-9 - z * 1.1470745597729725e-11))))));
    int64_t quarter;
    memcpy(&quarter, &rounded, sizeof quarter);
    const double a = quarter & 1 ? cosine : sine;
    const double b = quarter & 1 ? sine : cosine;
    *s = quarter & 2 ? -a : a;
    *c = (quarter + 1) & 2 ? -b : b;
}

// 1 and the cell of a point; 0 when it is off the map (or NaN); -1 when it is too near an edge to tell. No branches, so
// that loops over it become vectors.
ALWAYS_INLINE int32_t rollout_arc_cell(const grid_frame *g, double per_res, double x, double y, int32_t *cx,
                                       int32_t *cy) {
    double u = (x - g->ox) * per_res;
    double v = (y - g->oy) * per_res;
    u = u > -1 ? u : -1;
    v = v > -1 ? v : -1;
    u = u < g->w + 1 ? u : g->w + 1;
    v = v < g->h + 1 ? v : g->h + 1;
    const int32_t iu = (int32_t)u;
    const int32_t iv = (int32_t)v;
    const double fu = u - iu;
    const double fv = v - iv;
    const double right = g->w - u;
    const double up = g->h - v;
    const double in_x = u < right ? u : right;
    const double in_y = v < up ? v : up;
    const double in = in_x < in_y ? in_x : in_y;
    const double off_x = fu < 1 - fu ? fu : 1 - fu;
    const double off_y = fv < 1 - fv ? fv : 1 - fv;
    const double sure = (off_x < off_y ? off_x : off_y) > CELL_DOUBT ? 1.0 : -1.0;
    const double known = in >= -CELL_DOUBT ? sure : 0.0;
    *cx = iu;
    *cy = iv;
    return (int32_t)known;
}
