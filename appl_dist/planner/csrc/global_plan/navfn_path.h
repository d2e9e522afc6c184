// The path down a wave's gradient; used by navfn.c.
#pragma once
#include "navfn.h"

// Fills path_x and path_y from the goal's cell to the robot's; the number of points.
int navfn_follow(navfn *n, int start, int goal);
