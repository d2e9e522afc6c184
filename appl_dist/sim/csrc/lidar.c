#include "lidar.h"

#include <math.h>

#include "geometry.h"
#include "trig.h"
#include "wide.h"

#define PI 3.14159265358979323846

void lidar_directions(const lidar_spec *spec, double *cosines, double *sines) {
    for (size_t i = 0; i < spec->beams; ++i) {
        const double angle = spec->angle_min + (double)i * spec->increment;
        trig_sincos(angle, &sines[i], &cosines[i]);
    }
}

// atan2 to 4e-4 rad: spans are widened by that. libm's own was a third of a scan's time.
static inline double bearing(double y, double x) {
    const double ax = fabs(x);
    const double ay = fabs(y);
    const double big = ax > ay ? ax : ay;
    const double small = ax > ay ? ay : ax;
    const double a = small / big;
    const double s = a * a;
    const double octant = ((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a;
    const double quadrant = ay > ax ? 0.5 * PI - octant : octant;
    return copysign(x < 0.0 ? PI - quadrant : quadrant, y);
}

#define BLOCK 64  // cylinders at a time
#define LANES 8   // beams at a time

// What a block of cylinders looks like from the lidar: centres in its frame and the beams that may hit them.
typedef struct {
    double x[BLOCK], y[BLOCK], offset[BLOCK];  // offset = x^2 + y^2 - radius^2
    double centre[BLOCK], half[BLOCK];         // bearing and half width, in beams; half < 0: none
} view;

static void look(const lidar_spec *spec, const double pose[3], double c, double s, const double *cylinders, int n,
                 view *seen) {
    const double per_radian = 1.0 / spec->increment;
    for (int k = 0; k < n; ++k) {
        const double dx = cylinders[3 * k] - pose[0];
        const double dy = cylinders[3 * k + 1] - pose[1];
        const double radius = cylinders[3 * k + 2];
        const double d2 = dx * dx + dy * dy;
        const double reach = spec->range_max + radius;
        const double x = c * dx + s * dy;
        const double y = c * dy - s * dx;
        // Only beams within asin(r / d) of the centre's bearing can hit. asin(q) <= q + 0.5708 q^3 on [0, 1], and one
        // beam more on each side covers rounding; hit_lanes decides exactly.
        const double q = radius / sqrt(d2);
        const double half = (q + 0.5708 * q * q * q + 4e-4) * per_radian + 1.0;
        seen->x[k] = x;
        seen->y[k] = y;
        seen->offset[k] = x * x + y * y - radius * radius;
        seen->half[k] = d2 > reach * reach || d2 <= radius * radius ? -1.0 : half;
        seen->centre[k] = (bearing(y, x) - spec->angle_min) * per_radian;
    }
}

// LANES beams against one cylinder: keep the nearer hit.
static inline void hit_lanes(const double *restrict c, const double *restrict s, double x, double y, double offset,
                             double range_min, double range_max, float *restrict ranges) {
    double found[LANES];
    for (int i = 0; i < LANES; ++i) {
        const double along = x * c[i] + y * s[i];
        const double inside = along * along - offset;  // r^2 - (distance of the centre from the beam)^2
        const double exact = along - sqrt(inside < 0.0 ? 0.0 : inside);
        const double range = exact < range_min ? range_min : exact;
        found[i] = ((inside >= 0.0) & (along > 0.0) & (range <= range_max)) ? range : INFINITY;
    }
    for (int i = 0; i < LANES; ++i) ranges[i] = (float)found[i] < ranges[i] ? (float)found[i] : ranges[i];
}

WIDE void lidar_cast(const lidar *sensor, const double pose[3], const double *cylinders, size_t n, uint64_t seed,
                     uint64_t stamp, float *ranges) {
    const lidar_spec *spec = &sensor->spec;
    const double *cosines = sensor->cosines;
    const double *sines = sensor->sines;
    const double turn = 2.0 * PI / spec->increment;
    double c, s;
    trig_sincos(pose[2], &s, &c);
    const long beams = (long)spec->beams;
    const long end = beams - LANES;
    for (long i = 0; i < beams; ++i) ranges[i] = INFINITY;

    view seen;
    for (size_t first = 0; first < n; first += BLOCK) {
        const int count = n - first < BLOCK ? (int)(n - first) : BLOCK;
        look(spec, pose, c, s, cylinders + 3 * first, count, &seen);
        for (int k = 0; k < count; ++k) {
            const double half = seen.half[k];
            if (half < 0.0) continue;
            // Reached a turn before or on as well, for beams near +-pi of a lidar that sees behind itself.
            double middle = seen.centre[k];
            while (middle - turn + half >= 0.0) middle -= turn;
            for (; middle - half <= (double)(beams - 1); middle += turn) {
                if (middle + half < 0.0) continue;
                const double low = middle - half;
                const double high = middle + half;
                const long last = high < (double)(beams - 1) ? (long)high : beams - 1;
                // From a multiple of LANES on, so that what one cylinder stored the next one loads whole.
                for (long at = low > 0.0 ? (long)low / LANES * LANES : 0; at <= last; at += LANES) {
                    const long start = at < end ? at : end;
                    hit_lanes(cosines + start, sines + start, seen.x[k], seen.y[k], seen.offset[k], spec->range_min,
                              spec->range_max, ranges + start);
                }
            }
        }
    }
    if (spec->noise_sd > 0.0) {
        const uint64_t key = counter_key(seed, stamp);
        for (long i = 0; i < beams; ++i) ranges[i] += (float)(spec->noise_sd * counter_normal(key, (uint64_t)i));
    }
}
