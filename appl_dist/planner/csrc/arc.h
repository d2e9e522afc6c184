// Where a sample leads, without stepping there. Once its velocities are reached a roll-out runs on an arc of equal
// steps, and each of its poses has a closed form. It differs from the sum of steps in ROS by rounding, less than 1e-10 m;
// who asks for cells takes a point within CELL_DOUBT of a cell's edge for undecided, and steps there instead.
#pragma once
#include "simulate.h"

#define CELL_DOUBT 1e-6  // cells: 5e-8 m at 0.05 m

typedef struct {
    double v, w;        // m/s, rad/s
    double x, y, th;    // pose at step `from`, after which both velocities are held
    double turn, pace;  // rad and m a step
    double per_half;    // 1 / sin(turn / 2); 0 for a straight line
    double dt;          // s
    int steps, from;
} arc;

typedef struct {
    double x, y, th;  // m, m, rad
} arc_pose;

// False when the closed form is not to be trusted: very long ways to the velocity, absurd values.
bool arc_make(arc *a, const planner_settings *set, const motion *m, double v, double w, int steps);
arc_pose arc_at(const arc *a, const planner_settings *set, const motion *m, int step);

// sin and cos to 1e-13 for |angle| < 1e4.
static inline void arc_sincos(double angle, double *s, double *c) {
    const double magic = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to a whole number
    const double k = (angle * 0.63661977236758134308 + magic) - magic;
    const double r = (angle - k * 1.5707963267341256) - k * 6.077100506506192e-11, z = r * r;
    const double sine = r + r * z * (-1.6666666666666666e-1 + z * (8.333333333333333e-3 + z * (-1.984126984126984e-4 +
                        z * (2.7557319223985893e-6 + z * (-2.505210838544172e-8 + z * 1.6059043836821613e-10)))));
    const double cosine = 1.0 + z * (-0.5 + z * (4.1666666666666664e-2 + z * (-1.388888888888889e-3 +
                          z * (2.48015873015873e-5 + z * (-2.755731922398589e-7 + z * (2.08767569878681e-9 -
                          z * 1.1470745597729725e-11))))));
    const int quarter = (int)k;
    const double a = quarter & 1 ? cosine : sine, b = quarter & 1 ? sine : cosine;
    *s = quarter & 2 ? -a : a;
    *c = (quarter + 1) & 2 ? -b : b;
}

// 1 and the cell of a point; 0 when it is off the map; -1 when it is too near an edge to tell.
static inline int arc_cell(const grid_frame *g, double per_res, double x, double y, int *cx, int *cy) {
    const double u = (x - g->ox) * per_res, v = (y - g->oy) * per_res;
    if (u < -CELL_DOUBT || v < -CELL_DOUBT || u > g->w + CELL_DOUBT || v > g->h + CELL_DOUBT) return 0;
    const int iu = (int)u, iv = (int)v;
    const double fu = u - iu, fv = v - iv;
    if (!(fu > CELL_DOUBT && fu < 1 - CELL_DOUBT && fv > CELL_DOUBT && fv < 1 - CELL_DOUBT)) return -1;
    *cx = iu, *cy = iv;
    return 1;
}
