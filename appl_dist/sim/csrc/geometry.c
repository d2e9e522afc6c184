#include "geometry.h"

#include <math.h>

#include "trig.h"

/* jackal.urdf.xacro: chassis box 0.42 x 0.31, wheels of radius .098 and width .04 at (+-.131, +-.187795). */
static const double chassis_x = 0.210, chassis_y = 0.155;
static const double wheel_x = 0.131, wheel_y = 0.187795, wheel_half_x = 0.098, wheel_half_y = 0.020;

static double rectangle_distance(double dx, double dy) {
    if (dx > 0.0 && dy > 0.0) return sqrt(dx * dx + dy * dy);
    return dx > dy ? dx : dy;
}

double hull_clearance(const double pose[3], const double *cylinders, size_t n, double limit) {
    double c, s;
    trig_sincos(pose[2], &s, &c);
    double best = limit;
    for (size_t i = 0; i < n; ++i) {
        const double dx = cylinders[3 * i] - pose[0], dy = cylinders[3 * i + 1] - pose[1];
        const double reach = best + HULL_RADIUS_M + cylinders[3 * i + 2];
        if (dx * dx + dy * dy >= reach * reach) continue;
        /* The hull is symmetric about both body axes: fold the centre into the first quadrant. */
        const double px = fabs(c * dx + s * dy), py = fabs(c * dy - s * dx);
        const double box = rectangle_distance(px - chassis_x, py - chassis_y);
        const double wheel = rectangle_distance(fabs(px - wheel_x) - wheel_half_x, fabs(py - wheel_y) - wheel_half_y);
        const double gap = (box < wheel ? box : wheel) - cylinders[3 * i + 2];
        if (gap < best) best = gap;
    }
    return best;
}
