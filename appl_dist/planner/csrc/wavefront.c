#include "wavefront.h"

#include <string.h>

size_t wavefront_cells(int w, int h) { return (size_t)(w + 2) * (size_t)(h + 2); }

void wavefront_reset(wavefront *m, const uint8_t *restrict cost) {
    m->stride = m->w + 2;
    m->head = m->tail = 0;
    // The border counts as touched, so that waves need no bounds checks.
    for (int x = 0; x < m->stride; ++x) m->dist[x] = m->dist[(m->h + 1) * m->stride + x] = WAVE_OBSTACLE;
    for (int y = 0; y < m->h; ++y) {
        uint16_t *restrict row = m->dist + (y + 1) * m->stride;
        const uint8_t *restrict from = cost + y * m->w;
        row[0] = row[m->w + 1] = WAVE_OBSTACLE;
        for (int x = 0; x < m->w; ++x) row[x + 1] = from[x] >= COST_INSCRIBED ? WAVE_BLOCKED : WAVE_FREE;
    }
}

void wavefront_unblock(wavefront *m, int x, int y) { m->dist[wave_index(m, x, y)] = WAVE_FREE; }

void wavefront_target(wavefront *m, int x, int y) {
    const int i = wave_index(m, x, y);
    if (m->dist[i] == 0) return;  // a plan visits a cell more than once
    m->dist[i] = 0;
    m->queue[m->tail++] = i;
}

static inline void touch(wavefront *m, int i, uint16_t distance) {
    if (m->dist[i] == WAVE_FREE) {
        m->dist[i] = distance;
        m->queue[m->tail++] = i;
    } else if (m->dist[i] == WAVE_BLOCKED) {
        m->dist[i] = WAVE_OBSTACLE;
    }
}

static inline void grow_one(wavefront *m) {
    const int i = m->queue[m->head++];
    const uint16_t next = (uint16_t)(m->dist[i] + 1);
    touch(m, i - 1, next);
    touch(m, i + 1, next);
    touch(m, i - m->stride, next);
    touch(m, i + m->stride, next);
}

void wavefront_grow_until(wavefront *m, int index) {
    const uint16_t before = m->dist[index];
    while (m->head < m->tail && m->dist[index] == before) grow_one(m);
}

int wavefront_ros_value(wavefront *m, int x, int y) {
    const int i = wave_index(m, x, y);
    if (m->dist[i] == WAVE_FREE || m->dist[i] == WAVE_BLOCKED) wavefront_grow_until(m, i);
    if (m->dist[i] < WAVE_LIMIT) return m->dist[i];
    return m->w * m->h + (m->dist[i] == WAVE_OBSTACLE ? 0 : 1);
}
