#include "geometry.h"

#include <math.h>

#include "trig.h"

static double rectangle_distance(double dx, double dy) {
    if (dx > 0.0 && dy > 0.0) return sqrt(dx * dx + dy * dy);
    return dx > dy ? dx : dy;
}

double hull_clearance(const vehicle_spec *spec, const double pose[3], const double *cylinders, size_t n, double limit) {
    double c, s;
    trig_sincos(pose[2], &s, &c);
    double best = limit;
    for (size_t i = 0; i < n; ++i) {
        const double dx = cylinders[3 * i] - pose[0];
        const double dy = cylinders[3 * i + 1] - pose[1];
        const double reach = best + spec->hull_radius + cylinders[3 * i + 2];
        if (dx * dx + dy * dy >= reach * reach) continue;
        // The hull is symmetric about both body axes: fold the centre into the first quadrant.
        const double px = fabs(c * dx + s * dy);
        const double py = fabs(c * dy - s * dx);
        const double box = rectangle_distance(px - spec->chassis_x, py - spec->chassis_y);
        const double wheel = rectangle_distance(fabs(px - spec->wheel_x) - spec->wheel_radius,
                                                fabs(py - spec->wheel_y) - spec->wheel_half_width);
        const double gap = (box < wheel ? box : wheel) - cylinders[3 * i + 2];
        if (gap < best) best = gap;
    }
    return best;
}
