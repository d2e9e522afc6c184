#include "inflation.h"

#include <float.h>
#include <string.h>

static uint8_t cost_at(const inflation *f, double distance_cells) {
    if (distance_cells == 0) return COST_LETHAL;
    const double metres = distance_cells * f->res;
    if (metres <= f->inscribed) return COST_INSCRIBED;
    return (uint8_t)((COST_INSCRIBED - 1) * exp(-1.0 * f->weight * (metres - f->inscribed)));
}

static inline int offset_of(int dx, int dy) { return (dy + INFLATION_REACH) * INFLATION_SIDE + dx + INFLATION_REACH; }

// Bins are the distinct values of hypot(dx, dy), as keys of the std::map<double, ...> of the original.
static void build_kernel(inflation *f) {
    double keys[(INFLATION_CELLS_MAX + 1) * (INFLATION_CELLS_MAX + 1)];
    f->bins = 0;
    for (int i = 0; i <= f->cells; ++i)
        for (int j = 0; j <= f->cells; ++j) {
            const double d = hypot(i, j);
            if (d > f->cells) continue;
            int at = 0;
            while (at < f->bins && keys[at] < d) ++at;
            if (at < f->bins && keys[at] == d) continue;
            memmove(keys + at + 1, keys + at, sizeof(double) * (size_t)(f->bins - at));
            keys[at] = d;
            f->bins += 1;
        }
    for (int b = 0; b < f->bins; ++b) f->cost_of_bin[b] = cost_at(f, keys[b]);
    uint8_t bin_of[INFLATION_REACH + 1][INFLATION_REACH + 1];
    for (int i = 0; i <= INFLATION_REACH; ++i)
        for (int j = 0; j <= INFLATION_REACH; ++j) {
            const double d = hypot(i, j);
            bin_of[i][j] = 255;
            for (int b = 0; b < f->bins && d <= f->cells; ++b)
                if (keys[b] == d) bin_of[i][j] = (uint8_t)b;
        }
    const int far = INFLATION_CELLS_MAX;
    for (int dy = -far; dy <= far; ++dy)
        for (int dx = -far; dx <= far; ++dx) {
            const int column = abs(dx), row = abs(dy);
            inflation_moves *m = &f->moves[offset_of(dx, dy)];
            // Never back towards the obstacle: that cell would lie in an earlier bin.
            m->left = dx <= 0 ? bin_of[row][column + 1] : 255;
            m->up = dy <= 0 ? bin_of[row + 1][column] : 255;
            m->right = dx >= 0 ? bin_of[row][column + 1] : 255;
            m->down = dy >= 0 ? bin_of[row + 1][column] : 255;
        }
}

bool inflation_set(inflation *f, double radius, double weight, double inscribed, double res) {
    if (!(radius >= 0 && weight >= 0 && radius <= INFLATION_CELLS_MAX * res)) return false;
    if (f->radius == radius && f->weight == weight && f->inscribed == inscribed && f->res == res && f->bins > 0)
        return true;
    f->radius = radius, f->weight = weight, f->inscribed = inscribed, f->res = res;
    f->cells = cell_distance(radius, res);
    if (f->cells > INFLATION_CELLS_MAX) f->cells = INFLATION_CELLS_MAX;
    f->need_reinflation = true;
    build_kernel(f);
    return true;
}

void inflation_bounds(inflation *f, double *min_x, double *min_y, double *max_x, double *max_y) {
    const double was_min_x = f->last_min_x, was_min_y = f->last_min_y;
    const double was_max_x = f->last_max_x, was_max_y = f->last_max_y;
    f->last_min_x = *min_x, f->last_min_y = *min_y, f->last_max_x = *max_x, f->last_max_y = *max_y;
    if (f->need_reinflation) {
        *min_x = *min_y = -FLT_MAX;
        *max_x = *max_y = FLT_MAX;
        f->need_reinflation = false;
        return;
    }
    *min_x = fmin(was_min_x, *min_x) - f->radius;
    *min_y = fmin(was_min_y, *min_y) - f->radius;
    *max_x = fmax(was_max_x, *max_x) + f->radius;
    *max_y = fmax(was_max_y, *max_y) + f->radius;
}

typedef struct {
    uint8_t *best;
    inflation_entry *entries;
    int used, capacity;
    int32_t head[INFLATION_BINS_MAX], tail[INFLATION_BINS_MAX];
} brushfire;

static inline void enqueue(brushfire *b, int bin, int cell, int offset) {
    if (b->used == b->capacity) return;  // cannot happen: INFLATION_ENTRIES_PER_CELL
    const int32_t at = b->used++;
    b->entries[at] = (inflation_entry){cell, -1, (int16_t)offset};
    if (b->head[bin] < 0) b->head[bin] = at;
    else b->entries[b->tail[bin]].next = at;
    b->tail[bin] = at;
}

// A cell matters once: first in, in its lowest bin. Later and farther offers are dropped here.
static inline void offer(brushfire *b, uint8_t bin, int cell, int offset) {
    if (bin >= b->best[cell]) return;
    b->best[cell] = bin;
    enqueue(b, bin, cell, offset);
}

// `inside`: the fire stays clear of the map's edges.
static inline void burn(const inflation *f, brushfire *b, uint8_t *map, int w, int h, bool inside) {
    for (int bin = 0; bin < f->bins; ++bin)
        for (int32_t at = b->head[bin]; at >= 0; at = b->entries[at].next) {
            const int cell = b->entries[at].cell, offset = b->entries[at].offset;
            if (b->best[cell] != bin) continue;
            const uint8_t cost = f->cost_of_bin[bin];
            if (map[cell] == COST_UNKNOWN ? cost >= COST_INSCRIBED : map[cell] < cost) map[cell] = cost;
            const inflation_moves to = f->moves[offset];
            const int y = inside ? 0 : cell / w, x = inside ? 0 : cell - y * w;
            if (inside || x > 0) offer(b, to.left, cell - 1, offset - 1);
            if (inside || y > 0) offer(b, to.up, cell - w, offset - INFLATION_SIDE);
            if (inside || x < w - 1) offer(b, to.right, cell + 1, offset + 1);
            if (inside || y < h - 1) offer(b, to.down, cell + w, offset + INFLATION_SIDE);
        }
}

static int clampi(int v, int low, int high) { return v < low ? low : v > high ? high : v; }

void inflation_run(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, int x0, int y0, int xn,
                   int yn) {
    if (f->cells == 0) return;
    const int r = f->cells;
    x0 = clampi(x0 - r, 0, w), xn = clampi(xn + r, 0, w);
    y0 = clampi(y0 - r, 0, h), yn = clampi(yn + r, 0, h);
    if (x0 >= xn || y0 >= yn) return;
    // The fire leaves the window by at most its reach, and looks one cell beyond.
    const int cx0 = clampi(x0 - r - 1, 0, w), cxn = clampi(xn + r + 1, 0, w);
    for (int y = clampi(y0 - r - 1, 0, h); y < clampi(yn + r + 1, 0, h); ++y)
        memset(scratch->best + y * w + cx0, 255, (size_t)(cxn - cx0));

    brushfire b = {.best = scratch->best, .entries = scratch->entries, .capacity = scratch->capacity};
    memset(b.head, -1, sizeof b.head);
    for (int y = y0; y < yn; ++y) {
        const uint8_t *row = map + y * w;
        for (int x = x0; x < xn; ++x) {
            const uint8_t *hit = memchr(row + x, COST_LETHAL, (size_t)(xn - x));
            if (!hit) break;
            x = (int)(hit - row);
            scratch->best[y * w + x] = 0;
            enqueue(&b, 0, y * w + x, offset_of(0, 0));
        }
    }
    if (x0 > r && y0 > r && xn + r < w && yn + r < h) burn(f, &b, map, w, h, true);
    else burn(f, &b, map, w, h, false);
}
