#include "raytrace_clearing.h"

#include <string.h>

// Direction as a number in 0..8 that grows counterclockwise: the slope within a quadrant around each half axis.
static inline float direction(int dx, int dy) {
    const bool along_x = abs(dx) >= abs(dy);
    const float main = (float)(along_x ? dx : dy);
    const float aside = (float)(along_x ? dy : -dx);
    return aside / main + (along_x ? 1.0f : 3.0f) + (main > 0 ? 0.0f : 4.0f);
}

// 0.5 (1 + 1 / far) / far + 0.001 <= RAYTRACE_SECTORS_AROUND sectors of 8 / RAYTRACE_SECTORS
enum { RAYTRACE_FAR_CELLS = 13 };

static inline int sector_of(float direction) { return (int)(direction * (RAYTRACE_SECTORS / 8)); }

static int longer(int dx, int dy) { return abs(dx) > abs(dy) ? abs(dx) : abs(dy); }

static void sort_by_direction(raytrace_clearing *f) {
    memset(f->first, -1, sizeof f->first);
    memset(f->longest, 0, sizeof f->longest);
    for (int i = 0; i < f->count; ++i) {
        raytrace_line *l = &f->lines[i];
        if (l->dx == 0 && l->dy == 0) continue;
        const int sector = sector_of(direction(l->dx, l->dy)) & (RAYTRACE_SECTORS - 1);
        const int far = longer(l->dx, l->dy);
        const int steps = far < f->reach ? far : f->reach;
        l->next = f->first[sector];
        f->first[sector] = i;
        if (steps > f->longest[sector]) f->longest[sector] = (int16_t)steps;
    }
    int16_t ring[RAYTRACE_SECTORS + 2 * RAYTRACE_SECTORS_AROUND];
    memcpy(ring + RAYTRACE_SECTORS_AROUND, f->longest, sizeof f->longest);
    memcpy(ring, f->longest + RAYTRACE_SECTORS - RAYTRACE_SECTORS_AROUND, RAYTRACE_SECTORS_AROUND * sizeof *ring);
    memcpy(ring + RAYTRACE_SECTORS_AROUND + RAYTRACE_SECTORS, f->longest, RAYTRACE_SECTORS_AROUND * sizeof *ring);
    memset(f->around, 0, sizeof f->around);
    for (int k = 0; k <= 2 * RAYTRACE_SECTORS_AROUND; ++k)
        for (int i = 0; i < RAYTRACE_SECTORS; ++i)
            f->around[i] = f->around[i] > ring[i + k] ? f->around[i] : ring[i + k];
}

// Steps of a line cut at the reach.
static int steps_of(const raytrace_line *l, int far, int reach) {
    const int square = l->dx * l->dx + l->dy * l->dy;
    if (square < reach * reach) return far;
    const double steps = fmin(1.0, reach / sqrt(square)) * far;
    if (fabs(steps - rint(steps)) > 1e-6) return (int)steps;
    return (int)(fmin(1.0, reach / hypot(l->dx, l->dy)) * far);  // the last bit matters: as the original takes the root
}

// Step i of a line is (far / 2 + i near) / far cells aside: grid_line in closed form.
static inline bool crosses(const raytrace_clearing *f, const raytrace_line *l, int dx, int dy) {
    const bool along_x = abs(l->dx) >= abs(l->dy);
    const int main = along_x ? l->dx : l->dy;
    const int other = along_x ? l->dy : l->dx;
    const int far = abs(main);
    const int near = abs(other);
    const int i = (main > 0 ? 1 : -1) * (along_x ? dx : dy);
    const int aside = (other >= 0 ? 1 : -1) * (along_x ? dy : dx);
    const int part = far / 2 + i * near - aside * far;
    if (!(i > 0 && i <= far && aside >= 0 && part >= 0 && part < far)) return false;
    return i <= steps_of(l, far, f->reach);
}

// A line crosses a cell i steps away no more than half a cell, and half a part in far >= i, beside its middle.
static inline bool is_crossed(const raytrace_clearing *f, int dx, int dy) {
    const int far = longer(dx, dy);
    if (far == 0) return true;
    const float at = direction(dx, dy) + 8.0f;
    // From RAYTRACE_FAR_CELLS on all of them are in the sectors around.
    if (far >= RAYTRACE_FAR_CELLS && f->around[sector_of(at) & (RAYTRACE_SECTORS - 1)] < far) return false;
    const float per_far = 1.0f / (float)far;
    const float width = 0.5f * (1.0f + per_far) * per_far + 1e-3f;
    const int last = sector_of(at + width);
    for (int s = sector_of(at - width); s <= last; ++s) {
        const int sector = s & (RAYTRACE_SECTORS - 1);
        if (f->longest[sector] < far) continue;
        for (int32_t k = f->first[sector]; k >= 0; k = f->lines[k].next)
            if (crosses(f, &f->lines[k], dx, dy)) return true;
    }
    return false;
}

void raytrace_clearing_run(raytrace_clearing *f, uint8_t *layer, int w, int h) {
    enum { RUN = 32 };
    if (f->count == 0) return;
    sort_by_direction(f);
    const int reach = f->reach < w + h ? f->reach : w + h;
    const int first = f->x0 > reach ? f->x0 - reach : 0;
    const int last = f->x0 + reach < w ? f->x0 + reach : w - 1;
    for (int y = f->y0 > reach ? f->y0 - reach : 0; y < h && y <= f->y0 + reach; ++y) {
        uint8_t *row = layer + y * w;
        for (int from = first; from <= last; from += RUN) {
            uint64_t cells[RUN / 8];
            memcpy(cells, row + from, sizeof cells);
            if (!(cells[0] | cells[1] | cells[2] | cells[3])) continue;
            for (int k = 0; k < RUN / 8; ++k) {
                if (!cells[k]) continue;
                for (uint64_t left = cells[k]; left;) {
                    const int byte = __builtin_ctzll(left) >> 3;
                    const int x = from + 8 * k + byte;  // the lowest comes first
                    left &= ~(UINT64_C(0xff) << (8 * byte));
                    if (x <= last && is_crossed(f, x - f->x0, y - f->y0)) row[x] = COST_FREE;
                }
            }
        }
    }
}
