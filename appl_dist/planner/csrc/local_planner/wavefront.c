#include "wavefront.h"

#include <string.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

#include "wide.h"

static inline uint64_t *word_of(uint64_t *bits, int x, int y) { return bits + (y + 1) * WAVE_WORDS + (x >> 6); }
static inline uint64_t bit_of(int x) { return (uint64_t)1 << (x & 63); }

// One bit for each of 16 costs: no obstacle.
static inline uint64_t open_bits(const uint8_t *cost) {
#ifdef __SSE2__
    const __m128i dear = _mm_set1_epi8((char)COST_INSCRIBED);
    const __m128i c = _mm_loadu_si128((const __m128i *)cost);
    return ~(unsigned)_mm_movemask_epi8(_mm_cmpeq_epi8(_mm_max_epu8(c, dear), c)) & 0xFFFF;
#else
    uint64_t bits = 0;
    for (int i = 0; i < 16; ++i) bits |= (uint64_t)(cost[i] < COST_INSCRIBED) << i;
    return bits;
#endif
}

void wavefront_open_cells(const grid_frame *frame, const uint8_t *cost, wave_bits open) {
    const int w = frame->w;
    const int h = frame->h;
    memset(open, 0, sizeof(wave_bits));
    for (int y = 0; y < h; ++y) {
        const uint8_t *row = cost + y * w;
        uint64_t *to = open + (y + 1) * WAVE_WORDS;
        int x = 0;
        for (; x + 64 <= w; x += 64)
            to[x >> 6] = open_bits(row + x) | open_bits(row + x + 16) << 16 | open_bits(row + x + 32) << 32 |
                         open_bits(row + x + 48) << 48;
        for (; x + 16 <= w; x += 16) to[x >> 6] |= open_bits(row + x) << (x & 63);
        if (x == w) continue;
        uint8_t rest[16];
        memset(rest, COST_UNKNOWN, sizeof rest);
        memcpy(rest, row + x, (size_t)(w - x));
        to[x >> 6] |= open_bits(rest) << (x & 63);
    }
}

void wavefront_reset(wavefront *m, const grid_frame *frame, const wave_bits open, const grid_box *box) {
    m->w = frame->w;
    m->h = frame->h;
    m->box = *box;
    memcpy(m->open, open, sizeof m->open);
    m->box_level = WAVE_LIMIT;
    memset(m->target, 0, sizeof m->target);
}

void wavefront_unblock(wavefront *m, int x, int y) { *word_of(m->open, x, y) |= bit_of(x); }

void wavefront_target(wavefront *m, int x, int y) {
    *word_of(m->open, x, y) |= bit_of(x);
    *word_of(m->target, x, y) |= bit_of(x);
    const int left = m->box.x0 - x;
    const int right = x - m->box.x1;
    const int below = m->box.y0 - y;
    const int above = y - m->box.y1;
    const int columns = left > right ? left : right;
    const int rows = below > above ? below : above;
    const int to_box = (columns > 0 ? columns : 0) + (rows > 0 ? rows : 0);
    m->box_level = to_box < m->box_level ? to_box : m->box_level;
}

// Writes down the distance of the front's cells in the box.
static void record_front(wavefront *m) {
    if (m->level < m->box_level) return;
    const uint64_t *front = m->front;
    const grid_box *b = &m->box;
    const int from = b->y0 > m->first - 1 ? b->y0 : m->first - 1;
    const int to = b->y1 < m->last - 1 ? b->y1 : m->last - 1;
    for (int k = b->x0 >> 6; k <= b->x1 >> 6; ++k) {
        uint64_t inside = ~(uint64_t)0;
        if (k == b->x0 >> 6) inside &= ~(uint64_t)0 << (b->x0 & 63);
        if (k == b->x1 >> 6) inside &= ~(uint64_t)0 >> (63 - (b->x1 & 63));
        for (int y = from; y <= to; ++y) {
            uint16_t *dist = m->dist + y * WAVE_STRIDE + 64 * k;
            for (uint64_t left = front[(y + 1) * WAVE_WORDS + k] & inside; left; left &= left - 1)
                dist[__builtin_ctzll(left)] = (uint16_t)m->level;
        }
    }
}

void wavefront_start(wavefront *m) {
    m->level = 0;
    m->first = WAVE_ROWS;
    m->last = -1;
    memcpy(m->reached, m->target, sizeof m->reached);
    memcpy(m->front, m->target, sizeof m->front);
    for (int y = 1; y <= m->h; ++y) {
        const uint64_t *row = m->target + y * WAVE_WORDS;
        if (!(row[0] | row[1] | row[2] | row[3])) continue;
        if (y < m->first) m->first = y;
        m->last = y;
    }
    m->exhausted = m->last < 0;
    for (int y = m->box.y0; y <= m->box.y1; ++y)
        memset(m->dist + y * WAVE_STRIDE + m->box.x0, 0xFF, sizeof *m->dist * (size_t)(m->box.x1 - m->box.x0 + 1));
    record_front(m);
}

typedef uint64_t row_bits __attribute__((vector_size(8 * WAVE_WORDS)));

// One level in the padded rows [first, last]: the front is what is open beside a reached cell and was not reached. A
// row is overwritten when the rows beside it have been read. Whether there is a front.
WIDE static bool step(const uint64_t *restrict open, uint64_t *restrict reached, uint64_t *restrict front, int first,
                      int last) {
    const row_bits none = {0};
    row_bits below, row, above, free;
    row_bits any = none;
    memcpy(&below, reached + (first - 1) * WAVE_WORDS, sizeof below);
    memcpy(&row, reached + first * WAVE_WORDS, sizeof row);
    for (int k = first * WAVE_WORDS; k <= last * WAVE_WORDS; k += WAVE_WORDS) {
        memcpy(&above, reached + k + WAVE_WORDS, sizeof above);
        memcpy(&free, open + k, sizeof free);
        const row_bits high = row >> 63;
        const row_bits low = row << 63;
        const row_bits beside =
            row << 1 | SHUFFLE4(high, none, 4, 0, 1, 2) | row >> 1 | SHUFFLE4(low, none, 1, 2, 3, 4);
        const row_bits found = (below | above | beside) & free & ~row;
        const row_bits all = row | found;
        memcpy(front + k, &found, sizeof found);
        memcpy(reached + k, &all, sizeof all);
        any |= found;
        below = row;
        row = above;
    }
    return (any[0] | any[1] | any[2] | any[3]) != 0;
}

static void grow(wavefront *m) {
    m->first -= m->first > 1;
    m->last += m->last < m->h;
    m->exhausted = !step(m->open, m->reached, m->front, m->first, m->last);
    m->level += 1;
    if (!m->exhausted) record_front(m);
}

int wavefront_grow_until(wavefront *m, int x, int y) {
    if (!wavefront_in_box(m, x, y)) {  // once more, noting everything
        m->box = (grid_box){0, 0, m->w - 1, m->h - 1};
        m->box_level = 0;
        wavefront_start(m);
    }
    const uint16_t *d = m->dist + y * WAVE_STRIDE + x;
    while (*d == WAVE_UNKNOWN && !m->exhausted) grow(m);
    return *d;
}

void wavefront_grow_to(wavefront *m, int level) {
    while (m->level < level && !m->exhausted) grow(m);
}

int wavefront_ros_value(wavefront *m, int x, int y) {
    if (wavefront_open(m, x, y)) {
        const int d = wavefront_distance(m, x, y);
        return d < WAVE_LIMIT ? d : m->w * m->h + 1;
    }
    // An obstacle counts as touched when the wave reaches a cell beside it.
    const bool touched = (x > 0 && wavefront_distance(m, x - 1, y) < WAVE_LIMIT) ||
                         (x < m->w - 1 && wavefront_distance(m, x + 1, y) < WAVE_LIMIT) ||
                         (y > 0 && wavefront_distance(m, x, y - 1) < WAVE_LIMIT) ||
                         (y < m->h - 1 && wavefront_distance(m, x, y + 1) < WAVE_LIMIT);
    return m->w * m->h + (touched ? 0 : 1);
}
