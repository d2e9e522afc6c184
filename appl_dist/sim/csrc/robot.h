// A robot among cylinders. It drives freely here where nothing can be touched; where something can, motion stops and
// whoever resolves contacts takes one step (predict, resolve, correct).
#pragma once
#include <stddef.h>

#include "tyres.h"

enum { CONTACT_MS = 2 };  // a step with contacts; crashes at 2 m/s come out as with 1, and not with 4

typedef struct {
    vehicle_spec spec;
    vehicle_state state, before;  // before: where the last prediction started
    const double *cylinders;      // (count, 3) x, y, radius
    size_t count;
    int held;                   // contacts have the last word on where the robot is
    int landed;                 // it stands level on its wheels: the last motion was free
    int in_collision;           // now
    int collided, rolled_over;  // since reset
} robot;

// Mean velocity of base_link over a step, world frame, and mean yaw rate.
typedef struct {
    double vx, vy, w;
} robot_velocity;

// What contacts made of a step.
typedef struct {
    int touching, held, rolled_over;
    double x, y, yaw;     // base_link after the step
    double dvx, dvy, dw;  // change of its velocity
    double ground_force;  // N the wheels stand on the ground with
} robot_contact;

void robot_reset(robot *r, const double pose[3], uint64_t seed);
double robot_clearance(const robot *r, double limit);
// Drives by at most `ms`, as long as nothing can be touched; returns the ms done. The ideal drive goes through
// obstacles and only notes that it did.
int robot_drive(robot *r, int ms);
robot_velocity robot_predict(robot *r, int ms);
// Ends the predicted step; pose and velocity are replaced where contacts hold the robot.
void robot_resolve(robot *r, const robot_contact *contact);
