// Plan-view geometry of a robot and of upright cylinders. Metres, radians; the caller owns all memory.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include "tyres.h"

// Signed distance from the hull (chassis box and four wheels) at `pose` (x, y, yaw) to the surface of the nearest
// cylinder, negative inside; cylinders are (n, 3) x, y, radius. Anything farther than `limit` is reported as `limit`.
double hull_clearance(const vehicle_spec *spec, const double pose[3], const double *cylinders, size_t n, double limit);

// splitmix64's output function (Steele, Lea, Flood 2014).
static inline uint64_t counter_mix(uint64_t z) {
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

// What (seed, stamp) give to every index of counter_normal.
static inline uint64_t counter_key(uint64_t seed, uint64_t stamp) {
    return counter_mix(seed * UINT64_C(0x9E3779B97F4A7C15) + counter_mix(stamp + UINT64_C(0x632BE59BD9B4E019)));
}

// A standard normal deviate for (seed, stamp, index): the sum of eight 16-bit uniforms (kurtosis 2.85, |z| < 4.9),
// integer until the last operation, so the same on every machine and for every order of calls.
static inline double counter_normal(uint64_t key, uint64_t index) {
    const uint64_t fields = UINT64_C(0x0000FFFF0000FFFF);
    const uint64_t step = UINT64_C(0x9E3779B97F4A7C15);
    const uint64_t one = counter_mix(key + (2 * index + 1) * step);
    const uint64_t two = counter_mix(key + (2 * index + 2) * step);
    const uint64_t halves = (one & fields) + ((one >> 16) & fields) + (two & fields) + ((two >> 16) & fields);
    const int64_t sum = (int64_t)((halves & UINT64_C(0xFFFFFFFF)) + (halves >> 32));
    // Mean 8 * 65535 / 2, variance 8 * (65536^2 - 1) / 12.
    return (double)(sum - 262140) * 1.8688123650118534e-05;
}
