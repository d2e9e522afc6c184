#include "inflation_stamps.h"

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
            const int column = abs(dx);
            const int row = abs(dy);
            const uint8_t aside = bin_of[row][column + 1];
            const uint8_t along = bin_of[row + 1][column];
            const uint8_t to[4] = {dx <= 0 ? aside : 255, dy <= 0 ? along : 255, dx >= 0 ? aside : 255,
                                   dy >= 0 ? along : 255};
            inflation_moves *m = &f->moves[offset_of(dx, dy)];
            *m = (inflation_moves){.bin = {255, 255, 255, 255}};
            for (uint8_t side = 0; side < 4; ++side)
                if (to[side] < 255) {
                    m->bin[m->count] = to[side];
                    m->side[m->count++] = side;
                }
        }
}

static void build_stamp(inflation *f) {
    const int r = f->cells;
    f->stamp_width = r < 8 ? 16 : r < 16 ? 32 : INFLATION_STAMP_WIDTH;
    memset(f->stamp, 0, sizeof f->stamp);
    for (int dy = -r; dy <= r; ++dy)
        for (int dx = -r; dx <= r; ++dx) {
            const double d = hypot(dx, dy);
            if (d <= r) f->stamp[(dy + r) * f->stamp_width + dx + r] = cost_at(f, d);
        }
}

bool inflation_set(inflation *f, double radius, double weight, double inscribed, double res) {
    if (!(radius >= 0 && weight >= 0 && radius <= INFLATION_CELLS_MAX * res)) return false;
    if (f->radius == radius && f->weight == weight && f->inscribed == inscribed && f->res == res && f->bins > 0)
        return true;
    f->radius = radius;
    f->weight = weight;
    f->inscribed = inscribed;
    f->res = res;
    f->cells = cell_distance(radius, res);
    if (f->cells > INFLATION_CELLS_MAX) f->cells = INFLATION_CELLS_MAX;
    f->need_reinflation = true;
    build_kernel(f);
    build_stamp(f);
    return true;
}

void inflation_bounds(inflation *f, double *min_x, double *min_y, double *max_x, double *max_y) {
    const double was_min_x = f->last_min_x;
    const double was_min_y = f->last_min_y;
    const double was_max_x = f->last_max_x;
    const double was_max_y = f->last_max_y;
    f->last_min_x = *min_x;
    f->last_min_y = *min_y;
    f->last_max_x = *max_x;
    f->last_max_y = *max_y;
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
    inflation_page *unused;
    inflation_page *first[256];
    inflation_entry *tail[256], *end[256];  // by bin; that of 255 takes what is not wanted
} brushfire;

static inflation_page *new_page(brushfire *b, int bin) {
    inflation_page *page = b->unused++;
    page->next = NULL;
    b->tail[bin] = page->entries;
    b->end[bin] = page->entries + INFLATION_PAGE;
    return page;
}

// A cell matters once: first in, in its lowest bin. Later and farther offers are written, but not kept: whether an
// offer is wanted is a coin toss, so there is no branch.
static inline void offer(brushfire *b, uint8_t bin, int cell, int offset) {
    const uint8_t best = b->best[cell];
    const bool wanted = bin < best;
    b->best[cell] = wanted ? bin : best;
    inflation_entry *tail = b->tail[bin];
    *tail = (inflation_entry){cell, offset};
    b->tail[bin] = tail += wanted;
    if (tail == b->end[bin]) {
        inflation_page *full = (inflation_page *)(void *)(tail - INFLATION_PAGE);
        full->next = new_page(b, bin);
    }
}

// `inside`: the fire stays clear of the map's edges.
static inline void burn(const inflation *f, brushfire *b, uint8_t *map, int w, int h, bool inside) {
    const int step[4] = {-1, -w, 1, w};
    const int turn[4] = {-1, -INFLATION_SIDE, 1, INFLATION_SIDE};
    for (int bin = 0; bin < f->bins; ++bin) {
        const uint8_t cost = f->cost_of_bin[bin];
        for (const inflation_page *page = b->first[bin]; page; page = page->next) {
            const inflation_entry *end = page->next ? page->entries + INFLATION_PAGE : b->tail[bin];
            for (const inflation_entry *at = page->entries; at < end; ++at) {
                const int cell = at->cell;
                const int offset = at->offset;
                if (b->best[cell] != bin) continue;
                const uint8_t was = map[cell];
                map[cell] = (was == COST_UNKNOWN ? cost >= COST_INSCRIBED : was < cost) ? cost : was;
                const inflation_moves *to = &f->moves[offset];
                if (!inside) {
                    const int y = cell / w;
                    const int x = cell - y * w;
                    const bool open[4] = {x > 0, y > 0, x < w - 1, y < h - 1};
                    for (int k = 0; k < to->count; ++k)
                        if (open[to->side[k]])
                            offer(b, to->bin[k], cell + step[to->side[k]], offset + turn[to->side[k]]);
                    continue;
                }
                if (to->count == 0) continue;
                for (int k = 0; k < 2; ++k) offer(b, to->bin[k], cell + step[to->side[k]], offset + turn[to->side[k]]);
                for (int k = 2; k < to->count; ++k)
                    offer(b, to->bin[k], cell + step[to->side[k]], offset + turn[to->side[k]]);
            }
        }
    }
}

static void run_fire(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, const int32_t *lethal,
                     int count, bool inside) {
    brushfire b = {.best = scratch->best, .unused = scratch->pages};
    for (int bin = 0; bin < f->bins; ++bin) b.first[bin] = new_page(&b, bin);
    b.first[255] = new_page(&b, 255);
    for (int i = 0; i < count; ++i) offer(&b, 0, lethal[i], offset_of(0, 0));
    if (inside) burn(f, &b, map, w, h, true);
    else burn(f, &b, map, w, h, false);
}

// Lethal cells in row-major order, those among others aside: they are nobody's nearest. Sets `unknown` where one is.
static int find_lethal(const uint8_t *map, int w, int x0, int y0, int xn, int yn, int32_t *out, bool *unknown) {
    enum { RUN = 32 };
    int count = 0;
    for (int y = y0; y < yn; ++y) {
        const uint8_t *row = map + y * w;
        for (int from = x0; from < xn; from += RUN) {
            uint8_t any = 0;
            for (int x = 0; x < RUN; ++x) any |= row[from + x] >= COST_LETHAL;  // may look into the next row
            if (!any) continue;
            for (int x = from; x < from + RUN && x < xn; ++x) {
                if (row[x] < COST_LETHAL) continue;
                if (row[x] == COST_UNKNOWN) {
                    *unknown = true;
                    continue;
                }
                const bool within = x > x0 && y > y0 && x < xn - 1 && y < yn - 1 && row[x - 1] == COST_LETHAL &&
                                    row[x + 1] == COST_LETHAL && row[x - w] == COST_LETHAL && row[x + w] == COST_LETHAL;
                if (!within) out[count++] = y * w + x;
            }
        }
    }
    return count;
}

static int clampi(int v, int low, int high) { return v < low ? low : v > high ? high : v; }

bool inflation_run(const inflation *f, inflation_scratch *scratch, uint8_t *map, int w, int h, int x0, int y0, int xn,
                   int yn) {
    if (f->cells == 0) return false;
    const int r = f->cells;
    x0 = clampi(x0 - r, 0, w);
    xn = clampi(xn + r, 0, w);
    y0 = clampi(y0 - r, 0, h);
    yn = clampi(yn + r, 0, h);
    if (x0 >= xn || y0 >= yn) return false;
    bool unknown = false;
    const int count = find_lethal(map, w, x0, y0, xn, yn, scratch->lethal, &unknown);
    if (!unknown && inflation_stamps_exact(f)) {
        for (int i = 0; i < count; ++i) inflation_stamps_cell(f, map, w, h, scratch->lethal[i]);
        return true;
    }
    // The fire leaves the window by at most its reach, and reads one cell beyond.
    const int cx0 = clampi(x0 - r - 1, 0, w);
    const int cxn = clampi(xn + r + 1, 0, w);
    for (int y = clampi(y0 - r - 1, 0, h); y < clampi(yn + r + 1, 0, h); ++y)
        memset(scratch->best + y * w + cx0, 255, (size_t)(cxn - cx0));
    run_fire(f, scratch, map, w, h, scratch->lethal, count, x0 > r && y0 > r && xn + r < w && yn + r < h);
    return false;
}
