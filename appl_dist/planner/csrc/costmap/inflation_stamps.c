#include "inflation_stamps.h"

#include <stddef.h>
#include <string.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

#include "wide.h"

// What a stamp makes of a cell: it raises it or, erased, clears it where it holds just what the stamp gives.
ALWAYS_INLINE uint8_t stamped(uint8_t cell, uint8_t cost, bool erase) {
    if (erase) return cell == cost ? COST_FREE : cell;
    return cell > cost ? cell : cost;
}

ALWAYS_INLINE void stamp_rows(uint8_t *map, int w, const uint8_t *stamp, int rows, int width, bool erase) {
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < width; ++x) map[y * w + x] = stamped(map[y * w + x], stamp[y * width + x], erase);
}

// Lays the stamp of cell (x, y) on the part of a map, w cells wide, that lies in window k.
ALWAYS_INLINE void apply_stamp(const inflation *f, uint8_t *map, int w, grid_window k, int x, int y, bool erase) {
    const int r = f->cells;
    const int side = 2 * r + 1;
    const grid_window all = {x - r, y - r, x + r + 1, y + r + 1};
    const grid_window part = window_overlap(k, all);
    if (part.x0 == all.x0 && part.y0 == all.y0 && part.xn == all.xn && part.yn == all.yn) {
        uint8_t *corner = map + all.y0 * w + all.x0;
        switch (f->stamp_width) {
            case 16:
                stamp_rows(corner, w, f->stamp, side, 16, erase);
                break;
            case 32:
                stamp_rows(corner, w, f->stamp, side, 32, erase);
                break;
            default:
                stamp_rows(corner, w, f->stamp, side, INFLATION_STAMP_WIDTH, erase);
                break;
        }
        return;
    }
    for (int cy = part.y0; cy < part.yn; ++cy)
        for (int cx = part.x0; cx < part.xn; ++cx) {
            const uint8_t cost = f->stamp[(cy - all.y0) * f->stamp_width + cx - all.x0];
            map[cy * w + cx] = stamped(map[cy * w + cx], cost, erase);
        }
}

void inflation_stamps_cell(const inflation *f, uint8_t *map, int w, int h, int cell) {
    apply_stamp(f, map, w, (grid_window){0, 0, w, h}, cell % w, cell / w, false);
}

// One bit for each of 64 cells: lethal.
static inline uint64_t lethal_bits(const uint8_t *cells) {
    uint64_t bits = 0;
#ifdef __SSE2__
    const __m128i lethal = _mm_set1_epi8((char)COST_LETHAL);
    for (int k = 0; k < 4; ++k) {
        const __m128i c = _mm_loadu_si128((const __m128i *)(const void *)(cells + 16 * k));
        bits |= (uint64_t)(unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(c, lethal)) << (16 * k);
    }
#else
    for (int k = 0; k < 64; ++k) bits |= (uint64_t)(cells[k] == COST_LETHAL) << k;
#endif
    return bits;
}

static inline uint64_t bits_below(int count) {
    return count <= 0 ? 0 : count < 64 ? ((uint64_t)1 << count) - 1 : ~(uint64_t)0;
}

// Where lethal cells have to be stamped again: tiles of the window `near`, 64 by 64 of them.
typedef struct {
    grid_window near;
    int shift;
    uint64_t rows[64];
} tile_mask;

static void mark_tiles(tile_mask *t, grid_window k) {
    k = window_overlap(k, t->near);
    if (window_empty(k)) return;
    const int first = (k.x0 - t->near.x0) >> t->shift;
    const int last = (k.xn - 1 - t->near.x0) >> t->shift;
    const uint64_t columns = bits_below(last + 1) & ~bits_below(first);
    for (int y = (k.y0 - t->near.y0) >> t->shift; y <= (k.yn - 1 - t->near.y0) >> t->shift; ++y) t->rows[y] |= columns;
}

typedef struct {
    int32_t *cells;  // lethal ones from the front, those no longer lethal from the back
    int count, gone;
} lethal_list;

// Finds the lethal cells near the window and marks the tiles of those that were not.
static lethal_list find_changes(inflation_scratch *scratch, const uint8_t *layer, const uint8_t *map, int w, int h,
                                grid_window window, tile_mask *t) {
    lethal_list l = {.cells = scratch->lethal};
    int32_t *end = scratch->lethal + (ptrdiff_t)w * h;
    const grid_window near = t->near;
    for (int y = near.y0; y < near.yn; ++y)
        for (int x = near.x0; x < near.xn; x += 64) {
            const int at = y * w + x;
            const uint64_t was = lethal_bits(map + at) & bits_below(near.xn - x);
            uint64_t now = was;
            if (y >= window.y0 && y < window.yn) {
                const uint64_t inside = bits_below(window.xn - x) & ~bits_below(window.x0 - x);
                now = (was & ~inside) | (lethal_bits(layer + at) & inside);
            }
            for (uint64_t left = now; left; left &= left - 1) l.cells[l.count++] = at + __builtin_ctzll(left);
            for (uint64_t left = was & ~now; left; left &= left - 1) end[-++l.gone] = at + __builtin_ctzll(left);
            for (uint64_t left = now & ~was; left; left &= left - 1) {
                const int cx = x + __builtin_ctzll(left);
                mark_tiles(t, (grid_window){cx, y, cx + 1, y + 1});
            }
        }
    return l;
}

static void update_part(const uint8_t *layer, uint8_t *map, int w, int reach, grid_window window, grid_window k,
                        tile_mask *t) {
    if (window_empty(k)) return;
    mark_tiles(t, window_grown(k, reach));
    k = window_overlap(k, window);
    for (int y = k.y0; y < k.yn && k.x0 < k.xn; ++y)
        memcpy(map + y * w + k.x0, layer + y * w + k.x0, (size_t)(k.xn - k.x0));
}

void inflation_stamps_update(const inflation *f, inflation_scratch *scratch, const uint8_t *layer, uint8_t *map, int w,
                             int h, grid_window window, grid_window exact, grid_window cleared) {
    const int r = f->cells;
    const grid_window k = window;
    const grid_window e = window_overlap(exact, window);
    tile_mask t = {.near = window_overlap(window_grown(window, r), (grid_window){0, 0, w, h}), .shift = 3};
    const int columns = t.near.xn - t.near.x0;
    const int rows = t.near.yn - t.near.y0;
    const int side = columns > rows ? columns : rows;
    while ((side - 1) >> t.shift >= 64) ++t.shift;

    const lethal_list l = find_changes(scratch, layer, map, w, h, window, &t);
    const int32_t *end = scratch->lethal + (ptrdiff_t)w * h;
    for (int i = 1; i <= l.gone; ++i) {
        const int y = end[-i] / w;
        const int x = end[-i] - y * w;
        apply_stamp(f, map, w, window, x, y, true);
        mark_tiles(&t, window_grown((grid_window){x, y, x + 1, y + 1}, 2 * r));
    }
    const grid_window parts[5] = {{k.x0, k.y0, k.xn, e.y0},
                                  {k.x0, e.yn, k.xn, k.yn},
                                  {k.x0, e.y0, e.x0, e.yn},
                                  {e.xn, e.y0, k.xn, e.yn},
                                  cleared};
    for (int i = 0; i < 5; ++i) update_part(layer, map, w, r, window, parts[i], &t);
    for (int i = 0; i < l.count; ++i) {
        const int y = l.cells[i] / w;
        const int x = l.cells[i] - y * w;
        const uint64_t row = t.rows[(y - t.near.y0) >> t.shift];
        if (row >> ((x - t.near.x0) >> t.shift) & 1) inflation_stamps_cell(f, map, w, h, l.cells[i]);
    }
}
