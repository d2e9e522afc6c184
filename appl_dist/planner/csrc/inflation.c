#include "inflation.h"

#include <float.h>
#include <string.h>

static uint8_t cost_at(const inflation *f, double distance_cells) {
    if (distance_cells == 0) return COST_LETHAL;
    const double metres = distance_cells * f->res;
    if (metres <= f->inscribed) return COST_INSCRIBED;
    return (uint8_t)((COST_INSCRIBED - 1) * exp(-1.0 * f->weight * (metres - f->inscribed)));
}

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
    for (int dy = -INFLATION_REACH; dy <= INFLATION_REACH; ++dy)
        for (int dx = -INFLATION_REACH; dx <= INFLATION_REACH; ++dx) {
            const double d = hypot(dx, dy);
            uint8_t *bin = &f->bin_of[dy + INFLATION_REACH][dx + INFLATION_REACH];
            *bin = 255;
            for (int b = 0; b < f->bins && d <= f->cells; ++b)
                if (keys[b] == d) *bin = (uint8_t)b;
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
    const inflation *f;
    inflation_scratch *scratch;
    int w, used;
    int32_t head[INFLATION_BINS_MAX], tail[INFLATION_BINS_MAX];
} brushfire;

static inline void enqueue(brushfire *b, int bin, int x, int y, int dx, int dy) {
    if (b->used == b->scratch->capacity) return;  // cannot happen: INFLATION_ENTRIES_PER_CELL
    const int32_t at = b->used++;
    b->scratch->entries[at] = (inflation_entry){(int16_t)x, (int16_t)y, (int8_t)dx, (int8_t)dy, -1};
    if (b->head[bin] < 0) b->head[bin] = at;
    else b->scratch->entries[b->tail[bin]].next = at;
    b->tail[bin] = at;
}

// A cell matters once: first in, in its lowest bin. Later and farther offers are dropped here.
static inline void offer(brushfire *b, int x, int y, int dx, int dy) {
    const uint8_t bin = b->f->bin_of[dy + INFLATION_REACH][dx + INFLATION_REACH];
    uint8_t *best = &b->scratch->best[y * b->w + x];
    if (bin >= *best) return;
    *best = bin;
    enqueue(b, bin, x, y, dx, dy);
}

static int clampi(int v, int low, int high) { return v < low ? low : v > high ? high : v; }

void inflation_run(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, int x0, int y0, int xn,
                   int yn) {
    if (f->cells == 0) return;
    const int r = f->cells;
    x0 = clampi(x0 - r, 0, w), xn = clampi(xn + r, 0, w);
    y0 = clampi(y0 - r, 0, h), yn = clampi(yn + r, 0, h);
    if (x0 >= xn || y0 >= yn) return;
    // The fire leaves the window by at most its reach.
    const int cx0 = clampi(x0 - r, 0, w), cxn = clampi(xn + r, 0, w);
    for (int y = clampi(y0 - r, 0, h); y < clampi(yn + r, 0, h); ++y)
        memset(scratch->best + y * w + cx0, 255, (size_t)(cxn - cx0));

    brushfire b = {.f = f, .scratch = scratch, .w = w};
    memset(b.head, -1, sizeof b.head);
    for (int y = y0; y < yn; ++y) {
        const uint8_t *row = map + y * w;
        for (int x = x0; x < xn; ++x) {
            const uint8_t *hit = memchr(row + x, COST_LETHAL, (size_t)(xn - x));
            if (!hit) break;
            x = (int)(hit - row);
            scratch->best[y * w + x] = 0;
            enqueue(&b, 0, x, y, 0, 0);
        }
    }
    for (int bin = 0; bin < f->bins; ++bin)
        for (int32_t at = b.head[bin]; at >= 0; at = scratch->entries[at].next) {
            const inflation_entry e = scratch->entries[at];
            const int cell = e.y * w + e.x;
            if (scratch->best[cell] != bin) continue;
            const uint8_t cost = f->cost_of_bin[bin];
            if (map[cell] == COST_UNKNOWN ? cost >= COST_INSCRIBED : map[cell] < cost) map[cell] = cost;
            // Never back towards the obstacle: that cell would lie in an earlier bin.
            if (e.dx <= 0 && e.x > 0) offer(&b, e.x - 1, e.y, e.dx - 1, e.dy);
            if (e.dy <= 0 && e.y > 0) offer(&b, e.x, e.y - 1, e.dx, e.dy - 1);
            if (e.dx >= 0 && e.x < w - 1) offer(&b, e.x + 1, e.y, e.dx + 1, e.dy);
            if (e.dy >= 0 && e.y < h - 1) offer(&b, e.x, e.y + 1, e.dx, e.dy + 1);
        }
}
