#include "wavefront.h"

#include <string.h>

static void estimate(uint8_t *to, int cells, int low, int high) {
    for (int i = 0; i < cells + 2; ++i) {
        const int at = i - 1;
        to[i] = (uint8_t)(at < low ? low - at : at > high ? at - high : 0);
    }
}

void wavefront_reset(wavefront *m, const grid_frame *frame, const uint8_t *cost, const grid_box *box) {
    m->w = frame->w, m->h = frame->h;
    m->cost = cost;
    m->next = m->level = m->last_target = 0;
    for (int b = 0; b < WAVE_BUCKETS; ++b) m->count[b] = 0;
    memset(m->targets_at, -1, sizeof m->targets_at);
    memset(m->laid_out, 0, sizeof m->laid_out);
    estimate(m->to_column, m->w, box->x0, box->x1);
    estimate(m->to_row, m->h, box->y0, box->y1);
}

// With a blocked border: waves need no bounds checks.
void wavefront_lay_out_row(wavefront *m, int y) {
    uint16_t *restrict row = m->dist + y * WAVE_STRIDE;
    m->laid_out[y] = 1;
    if (y == 0 || y == m->h + 1) {
        for (int x = 0; x < m->w + 2; ++x) row[x] = WAVE_BLOCKED;
        return;
    }
    const uint8_t *restrict from = m->cost + (y - 1) * m->w;
    row[0] = row[m->w + 1] = WAVE_BLOCKED;
    for (int x = 0; x < m->w; ++x) row[x + 1] = from[x] >= COST_INSCRIBED ? WAVE_BLOCKED : WAVE_FREE;
}

static inline void lay_out(wavefront *m, int y) {
    if (!m->laid_out[y]) wavefront_lay_out_row(m, y);
}

void wavefront_unblock(wavefront *m, int x, int y) {
    lay_out(m, y + 1);
    m->dist[wave_index(x, y)] = WAVE_FREE;
}

void wavefront_target(wavefront *m, int x, int y) {
    const int i = wave_index(x, y);
    lay_out(m, y + 1);
    if (m->dist[i] == 1) return;  // a plan visits a cell more than once
    m->dist[i] = 1;
    const int far = m->to_column[x + 1] + m->to_row[y + 1];
    m->next_target[i] = m->targets_at[far];
    m->targets_at[far] = i;
    if (far > m->last_target) m->last_target = far;
}

// Estimates differ by one between neighbours, so a neighbour goes into the same bucket or one of the next two.
// A cell may be found twice, the second time nearer; then it is in two buckets and its second expansion finds nothing.
static inline int relax(wavefront *m, uint16_t *into, int count, int to, uint16_t distance) {
    const bool nearer = distance < m->dist[to];
    into[count] = (uint16_t)to;
    m->dist[to] = nearer ? distance : m->dist[to];
    return count + nearer;
}

static inline void relax_uneven(wavefront *m, int to, uint16_t distance, int rise, int bucket) {
    const int b = bucket + 1 + rise < WAVE_BUCKETS ? bucket + 1 + rise : bucket + 1 + rise - WAVE_BUCKETS;
    m->count[b] = relax(m, m->bucket[b], m->count[b], to, distance);
}

static inline void expand(wavefront *m, int i, int bucket) {
    const int x = i % WAVE_STRIDE, y = i / WAVE_STRIDE;
    const uint8_t *column = m->to_column + x, *row = m->to_row + y;
    const uint16_t next = (uint16_t)(m->dist[i] + 1);
    lay_out(m, y - 1);
    lay_out(m, y + 1);
    if ((column[-1] | column[1] | row[-1] | row[1]) == 0) {  // inside the box the estimate is zero
        const int b = bucket + 1 < WAVE_BUCKETS ? bucket + 1 : 0;
        uint16_t *into = m->bucket[b];
        int count = m->count[b];
        count = relax(m, into, count, i - 1, next);
        count = relax(m, into, count, i + 1, next);
        count = relax(m, into, count, i - WAVE_STRIDE, next);
        m->count[b] = relax(m, into, count, i + WAVE_STRIDE, next);
        return;
    }
    relax_uneven(m, i - 1, next, column[-1] - column[0], bucket);
    relax_uneven(m, i + 1, next, column[1] - column[0], bucket);
    relax_uneven(m, i - WAVE_STRIDE, next, row[-1] - row[0], bucket);
    relax_uneven(m, i + WAVE_STRIDE, next, row[1] - row[0], bucket);
}

static void start_targets(wavefront *m, int bucket) {
    for (int at = m->targets_at[m->level]; at >= 0; at = m->next_target[at])
        m->bucket[bucket][m->count[bucket]++] = (uint16_t)at;
    m->targets_at[m->level] = -1;
}

void wavefront_grow_until(wavefront *m, int x, int y) {
    const int i = wave_index(x, y), far = m->to_column[x + 1] + m->to_row[y + 1];
    lay_out(m, y + 1);
    while (m->dist[i] - 1 + far > m->level) {
        const int bucket = m->level % WAVE_BUCKETS;
        if (m->level <= m->last_target) start_targets(m, bucket);
        while (m->next < m->count[bucket]) expand(m, m->bucket[bucket][m->next++], bucket);
        m->count[bucket] = m->next = 0;
        m->level += 1;
        if (m->level > m->last_target && !m->count[0] && !m->count[1] && !m->count[2]) m->level = 2 * WAVE_FREE;
    }
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
