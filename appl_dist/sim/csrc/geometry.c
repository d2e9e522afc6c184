#include "geometry.h"

#include <math.h>

/* jackal.urdf.xacro: chassis box 0.42 x 0.31, wheels of radius .098 and width .04 at (+-.131, +-.187795). */
static const double chassis_x = 0.210, chassis_y = 0.155;
static const double wheel_x = 0.131, wheel_y = 0.187795, wheel_half_x = 0.098, wheel_half_y = 0.020;

static double rectangle_distance(double dx, double dy) {
    if (dx > 0.0 && dy > 0.0) return sqrt(dx * dx + dy * dy);
    return dx > dy ? dx : dy;
}

double hull_clearance(const double pose[3], const double *cylinders, size_t n, double limit) {
    const double c = cos(pose[2]), s = sin(pose[2]);
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

/* splitmix64's output function (Steele, Lea, Flood 2014). */
static uint64_t mix(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double counter_normal(uint64_t seed, uint64_t stamp, uint64_t index) {
    const uint64_t key = mix(seed * 0x9E3779B97F4A7C15u + mix(stamp + 0x632BE59BD9B4E019u));
    int64_t sum = 0;
    for (uint64_t half = 0; half < 2; ++half) {
        const uint64_t bits = mix(key + (2 * index + half + 1) * 0x9E3779B97F4A7C15u);
        sum += (int64_t)((bits & 0xFFFF) + ((bits >> 16) & 0xFFFF) + ((bits >> 32) & 0xFFFF) + (bits >> 48));
    }
    /* Mean 8 * 65535 / 2, variance 8 * (65536^2 - 1) / 12. */
    return (double)(sum - 262140) * 1.8688123650118534e-05;
}
