// A planar lidar among upright cylinders.
#pragma once
#include <stddef.h>
#include <stdint.h>

typedef struct {
    size_t beams;                 // at least 4
    double angle_min, increment;  // beam i points along angle_min + i * increment, robot frame
    double range_min, range_max;
    double noise_sd;
} lidar_spec;

// A lidar ready to cast.
typedef struct {
    lidar_spec spec;
    const double *cosines, *sines;  // (beams,) of every beam's angle, from lidar_directions
} lidar;

// cos and sin of every beam angle, (beams,) each.
void lidar_directions(const lidar_spec *spec, double *cosines, double *sines);

// Cast one scan from the lidar's own pose (x, y, yaw) into `ranges` (beams,) float32 metres; INFINITY = no return.
// cylinders (n, 3) x, y, radius. Noise depends on (seed, stamp, beam) alone.
void lidar_cast(const lidar *sensor, const double pose[3], const double *cylinders, size_t n, uint64_t seed,
                uint64_t stamp, float *ranges);
