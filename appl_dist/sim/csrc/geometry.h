/* Plan-view geometry of the Jackal and of upright cylinders. Metres, radians; the caller owns all memory. */
#ifndef APPL_SIM_GEOMETRY_H
#define APPL_SIM_GEOMETRY_H

#include <stddef.h>
#include <stdint.h>

/* Circumscribed radius of the collision hull around base_link: chassis box and four wheels. */
#define HULL_RADIUS_M 0.3093

/* Signed distance from the hull at `pose` (x, y, yaw) to the surface of the nearest cylinder, negative inside;
 * cylinders are (n, 3) x, y, radius. Anything farther than `limit` is reported as `limit`. */
double hull_clearance(const double pose[3], const double *cylinders, size_t n, double limit);

/* A standard normal deviate for (seed, stamp, index): the sum of eight 16-bit uniforms (kurtosis 2.85, |z| < 4.9),
 * integer until the last operation, so the same on every machine and for every order of calls. */
double counter_normal(uint64_t seed, uint64_t stamp, uint64_t index);

#endif
