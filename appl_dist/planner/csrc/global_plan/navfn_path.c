#include "navfn_path.h"

// hypotf without the call: the squares are exact in double, and nothing here comes near its range.
static inline float length_of(float x, float y) { return (float)sqrt((double)x * x + (double)y * y); }

static void gradient(const navfn *n, int i, float *gx, float *gy) {
    const float *p = n->potential;
    const float here = p[i];
    float dx = 0;
    float dy = 0;
    *gx = *gy = 0;
    if (i < n->w || i > n->w * n->h - n->w || here >= NAVFN_NONE) return;
    if (p[i - 1] < NAVFN_NONE) dx += p[i - 1] - here;
    if (p[i + 1] < NAVFN_NONE) dx += here - p[i + 1];
    if (p[i - n->w] < NAVFN_NONE) dy += p[i - n->w] - here;
    if (p[i + n->w] < NAVFN_NONE) dy += here - p[i + n->w];
    const float length = length_of(dx, dy);
    if (!(length > 0)) return;
    const float scale = 1.0f / length;
    *gx = scale * dx;
    *gy = scale * dy;
}

static const int ring_x[8] = {-1, 0, 1, -1, 1, -1, 0, 1}, ring_y[8] = {-1, -1, -1, 0, 0, 1, 1, 1};

// NavFn::calcPath: half-cell steps down the gradient, cell steps where the wave's edge is near. Where it gives up,
// NavfnROS uses the points found so far all the same.
int navfn_follow(navfn *n, int start, int goal) {
    const int w = n->w;
    const int cells = n->w * n->h;
    const float *p = n->potential;
    int at = goal;
    int count = 0;
    float dx = 0;
    float dy = 0;
    float gx[4], gy[4];
    int known = -1;  // the cell whose corners' gradients are in gx, gy
    while (count < n->path_capacity) {
        int nearest = at + (int)roundf(dx) + (int)((float)w * roundf(dy));
        nearest = nearest < 0 ? 0 : nearest >= cells ? cells - 1 : nearest;
        if (p[nearest] < NAVFN_NEUTRAL) {
            n->path_x[count] = (float)(start % w);
            n->path_y[count] = (float)(start / w);
            return count + 1;
        }
        if (at < w || at > cells - w) return count;
        n->path_x[count] = (float)(at % w) + dx;
        n->path_y[count] = (float)(at / w) + dy;
        ++count;
        bool edge = count > 2 && n->path_x[count - 1] == n->path_x[count - 3] &&
                    n->path_y[count - 1] == n->path_y[count - 3];  // swinging between two points
        if (at == w || at == cells - w) return count;              // a corner of the ring: no eight neighbours
        if (at != known) {
            edge = edge || p[at] >= NAVFN_NONE;
            for (int k = 0; k < 8; ++k) edge = edge || p[at + ring_y[k] * w + ring_x[k]] >= NAVFN_NONE;
        }
        if (edge) {
            if (p[at] >= NAVFN_NONE) return count;
            int lowest = (int)p[at];
            int best = at;
            for (int k = 0; k < 8; ++k) {
                const int i = at + ring_y[k] * w + ring_x[k];
                if (p[i] < (float)lowest) {
                    lowest = (int)p[i];
                    best = i;
                }
            }
            at = best;
            dx = dy = 0;
            continue;
        }
        const int corner[4] = {at, at + 1, at + w, at + w + 1};
        for (int k = 0; k < 4 && at != known; ++k) gradient(n, corner[k], &gx[k], &gy[k]);
        known = at;
        const float x1 = (float)((1.0 - dx) * gx[0] + dx * gx[1]);
        const float x2 = (float)((1.0 - dx) * gx[2] + dx * gx[3]);
        const float x = (float)((1.0 - dy) * x1 + dy * x2);
        const float y1 = (float)((1.0 - dx) * gy[0] + dx * gy[1]);
        const float y2 = (float)((1.0 - dx) * gy[2] + dx * gy[3]);
        const float y = (float)((1.0 - dy) * y1 + dy * y2);
        if (x == 0 && y == 0) return count;
        const float scale = 0.5f / length_of(x, y);
        dx += x * scale;
        dy += y * scale;
        if (dx > 1.0) {
            ++at;
            dx = (float)(dx - 1.0);
        }
        if (dx < -1.0) {
            --at;
            dx = (float)(dx + 1.0);
        }
        if (dy > 1.0) {
            at += w;
            dy = (float)(dy - 1.0);
        }
        if (dy < -1.0) {
            at -= w;
            dy = (float)(dy + 1.0);
        }
    }
    return count;
}
