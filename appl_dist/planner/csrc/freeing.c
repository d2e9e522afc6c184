#include "freeing.h"

#include <string.h>

// Direction as a number in 0..8 that grows counterclockwise: the slope within a quadrant around each half axis.
static inline float direction(int dx, int dy) {
    if (abs(dx) >= abs(dy)) return (float)dy / (float)dx + (dx > 0 ? 1.0f : 5.0f);
    return 3.0f - (float)dx / (float)dy + (dy > 0 ? 0.0f : 4.0f);
}

static inline int sector_of(float direction) { return (int)(direction * (FAN_SECTORS / 8)); }

void fan_start(line_fan *f, int x0, int y0, int reach) {
    f->x0 = x0, f->y0 = y0, f->reach = reach, f->count = 0;
    memset(f->first, -1, sizeof f->first);
    memset(f->longest, 0, sizeof f->longest);
}

void fan_add(line_fan *f, int x1, int y1) {
    const int dx = x1 - f->x0, dy = y1 - f->y0;
    const grid_line l = line_between(f->x0, f->y0, x1, y1);
    int steps = l.steps;
    if (dx * dx + dy * dy >= f->reach * f->reach) {
        double cells = fmin(1.0, f->reach / sqrt(dx * dx + dy * dy)) * l.steps;
        // Where the last bit could matter, the root as the original takes it.
        if (fabs(cells - rint(cells)) < 1e-6) cells = fmin(1.0, f->reach / hypot(dx, dy)) * l.steps;
        steps = (int)cells;
    }
    const bool along_x = l.dx2 != 0;
    fan_line *to = &f->lines[f->count];
    *to = (fan_line){.den = l.den, .num = l.num, .add = l.add, .steps = steps, .along_x = along_x, .next = -1,
                     .forward = (int8_t)(along_x ? l.dx2 : l.dy2), .aside = (int8_t)(along_x ? l.dy1 : l.dx1)};
    if (l.den > 0) {
        const int sector = sector_of(direction(dx, dy)) & (FAN_SECTORS - 1);
        to->next = f->first[sector];
        f->first[sector] = f->count;
        if (steps > f->longest[sector]) f->longest[sector] = steps;
    }
    f->count += 1;
}

// Step i of a line is (num + i add) / den cells aside.
static inline bool passes(const fan_line *l, int dx, int dy) {
    const int i = l->forward * (l->along_x ? dx : dy), aside = l->aside * (l->along_x ? dy : dx);
    const int part = l->num + i * l->add - aside * l->den;
    return i > 0 && i <= l->steps && aside >= 0 && part >= 0 && part < l->den;
}

// A line passes a cell i steps away no more than half a cell, and half a part in den >= i, beside its middle.
static bool is_passed(const line_fan *f, int dx, int dy) {
    const int far = abs(dx) > abs(dy) ? abs(dx) : abs(dy);
    if (far == 0) return f->count > 0;
    const float at = direction(dx, dy) + 8.0f, per_far = 1.0f / (float)far;
    const float width = 0.5f * (1.0f + per_far) * per_far + 1e-3f;
    const int last = sector_of(at + width);
    for (int s = sector_of(at - width); s <= last; ++s) {
        const int sector = s & (FAN_SECTORS - 1);
        if (f->longest[sector] < far) continue;
        for (int32_t k = f->first[sector]; k >= 0; k = f->lines[k].next)
            if (passes(&f->lines[k], dx, dy)) return true;
    }
    return false;
}

void fan_free(const line_fan *f, uint8_t *layer, int w, int h) {
    enum { WORD = 8 };
    if (f->count == 0) return;
    const int reach = f->reach < w + h ? f->reach : w + h;
    const int first = f->x0 > reach ? f->x0 - reach : 0, last = f->x0 + reach < w ? f->x0 + reach : w - 1;
    for (int y = f->y0 > reach ? f->y0 - reach : 0; y < h && y <= f->y0 + reach; ++y) {
        uint8_t *row = layer + y * w;
        for (int x = first; x <= last; x += WORD) {
            uint64_t cells;
            memcpy(&cells, row + x, sizeof cells);
            if (!cells) continue;
            for (int i = x; i < x + WORD && i <= last; ++i)
                if (row[i] != COST_FREE && is_passed(f, i - f->x0, y - f->y0)) row[i] = COST_FREE;
        }
    }
}
