// The wave of potential behind a plan; used by navfn.c.
#pragma once
#include "navfn.h"

// A new wave from the robot's cell, within a bound around what the last plan needed, widened until the goal's potential
// is well inside. False where the wave does not come to the goal.
bool navfn_wave(navfn *n, int start, int goal);
void navfn_clear_potential(navfn *n);  // resets the potential of every cell reached
