#include "adam.h"

#include <math.h>
#include <string.h>

#include "wide.h"


ALWAYS_INLINE float widen(uint16_t half) {
    const uint32_t bits = (uint32_t)half << 16;
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

ALWAYS_INLINE uint16_t narrow(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    const uint32_t rounded = (bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16;
    return (uint16_t)(x != x ? 0x7fc0u : rounded);
}

/* grad16 and copy16 are constants where this is inlined, so each case is a loop without branches. */
ALWAYS_INLINE void adam_loop(const adam_rates *r, size_t n, float *restrict p, const float *restrict grad32,
                      const uint16_t *restrict grad16, float *restrict m, float *restrict v,
                      uint16_t *restrict copy16) {
    const adam_rates k = *r;
    for (size_t i = 0; i < n; ++i) {
        const float g = grad16 ? widen(grad16[i]) : grad32[i];
        m[i] = k.keep1 * m[i] + k.take1 * g;
        v[i] = k.keep2 * v[i] + k.take2 * (g * g);
        p[i] -= k.rate * m[i] / (sqrtf(v[i]) * k.scale + k.epsilon);
        if (copy16) copy16[i] = narrow(p[i]);
    }
}

WIDE void adam_step(const adam_rates *rates, size_t n, float *p, const float *grad32, const uint16_t *grad16, float *m,
                    float *v, uint16_t *copy16) {
    if (grad16 && copy16)
        adam_loop(rates, n, p, NULL, grad16, m, v, copy16);
    else if (grad16)
        adam_loop(rates, n, p, NULL, grad16, m, v, NULL);
    else if (copy16)
        adam_loop(rates, n, p, grad32, NULL, m, v, copy16);
    else
        adam_loop(rates, n, p, grad32, NULL, m, v, NULL);
}

ALWAYS_INLINE void polyak_loop(float tau, size_t n, float *restrict target, const float *restrict p,
                        uint16_t *restrict copy16) {
    for (size_t i = 0; i < n; ++i) {
        target[i] += tau * (p[i] - target[i]);
        if (copy16) copy16[i] = narrow(target[i]);
    }
}

WIDE void polyak_step(float tau, size_t n, float *target, const float *p, uint16_t *copy16) {
    if (copy16)
        polyak_loop(tau, n, target, p, copy16);
    else
        polyak_loop(tau, n, target, p, NULL);
}
