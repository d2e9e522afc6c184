#include "lidar.h"

#include <math.h>

#include "geometry.h"

#define PI 3.14159265358979323846

void lidar_directions(const lidar_spec *spec, double *cosines, double *sines) {
    for (size_t i = 0; i < spec->beams; ++i) {
        const double angle = spec->angle_min + (double)i * spec->increment;
        cosines[i] = cos(angle);
        sines[i] = sin(angle);
    }
}

/* atan2 to 4e-4 rad: spans are widened by that. libm's own was a third of a scan's time. */
static double bearing(double y, double x) {
    const double ax = fabs(x), ay = fabs(y), big = ax > ay ? ax : ay, small = ax > ay ? ay : ax;
    const double a = small / big, s = a * a;
    double r = ((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a;
    if (ay > ax) r = 0.5 * PI - r;
    if (x < 0.0) r = PI - r;
    return y < 0.0 ? -r : r;
}

/* Beams first..last against one cylinder at (x, y) in the lidar frame: keep the nearer hit. */
static void hit_beams(const double *cosines, const double *sines, long first, long last, double x, double y,
                      double radius, double nearest, double range_min, double range_max, float *ranges) {
    const double offset = x * x + y * y - radius * radius;
    for (long i = first; i <= last; ++i) {
        if (ranges[i] < nearest) continue;
        const double along = x * cosines[i] + y * sines[i];
        const double inside = along * along - offset; /* r^2 - (distance of the centre from the beam)^2 */
        if (inside < 0.0 || along <= 0.0) continue;
        double range = along - sqrt(inside);
        if (range < range_min) range = range_min;
        if (range <= range_max && (float)range < ranges[i]) ranges[i] = (float)range;
    }
}

void lidar_cast(const lidar_spec *spec, const double *cosines, const double *sines, const double pose[3],
                const double *cylinders, size_t n, uint64_t seed, uint64_t stamp, float *ranges) {
    const double c = cos(pose[2]), s = sin(pose[2]);
    const long beams = (long)spec->beams;
    const double per_radian = 1.0 / spec->increment, turn = 2.0 * PI * per_radian;
    for (long i = 0; i < beams; ++i) ranges[i] = INFINITY;

    for (size_t k = 0; k < n; ++k) {
        const double dx = cylinders[3 * k] - pose[0], dy = cylinders[3 * k + 1] - pose[1];
        const double radius = cylinders[3 * k + 2], d2 = dx * dx + dy * dy;
        const double reach = spec->range_max + radius;
        if (d2 > reach * reach || d2 <= radius * radius) continue;
        const double x = c * dx + s * dy, y = c * dy - s * dx;
        /* Only beams within asin(r / d) of the centre's bearing can hit. asin(q) <= q + 0.5708 q^3 on [0, 1], and one
         * beam more on each side covers rounding; hit_beams decides exactly. */
        const double distance = sqrt(d2), nearest = distance - radius - 1e-6;
        const double q = radius / distance, half = (q + 0.5708 * q * q * q + 4e-4) * per_radian + 1.0;
        const double centre = (bearing(y, x) - spec->angle_min) * per_radian;
        /* The span may also be reached a turn on, for beams near +-pi of a lidar that sees behind itself. */
        for (double middle = centre; middle - half <= (double)(beams - 1); middle += turn) {
            long first = (long)ceil(middle - half), last = (long)floor(middle + half);
            if (first < 0) first = 0;
            if (last > beams - 1) last = beams - 1;
            hit_beams(cosines, sines, first, last, x, y, radius, nearest, spec->range_min, spec->range_max,
                      ranges);
        }
        for (double middle = centre - turn; middle + half >= 0.0; middle -= turn) {
            long last = (long)floor(middle + half);
            if (last > beams - 1) last = beams - 1;
            hit_beams(cosines, sines, 0, last, x, y, radius, nearest, spec->range_min, spec->range_max,
                      ranges);
        }
    }
    if (spec->noise_sd > 0.0)
        for (long i = 0; i < beams; ++i)
            if (ranges[i] < INFINITY)
                ranges[i] += (float)(spec->noise_sd * counter_normal(seed, stamp, (uint64_t)i));
}
