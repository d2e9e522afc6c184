/* Optimiser steps over flat parameter vectors, one pass over memory each.
 *
 * A step is bound by memory, not by arithmetic: master, moments, gradient and the cast copy are read and written once.
 * bfloat16 is passed as uint16_t, rounded to nearest even. Elementwise, so the bits do not depend on the vector width.
 */
#ifndef APPL_ADAM_H
#define APPL_ADAM_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    float keep1, keep2;   /* beta1, beta2 */
    float take1, take2;   /* 1 - beta1, 1 - beta2 */
    float rate;           /* learning rate / (1 - beta1^t) */
    float scale;          /* 1 / sqrt(1 - beta2^t) */
    float epsilon;
} adam_rates;

/* Kingma and Ba (ICLR 2015), Alg. 1, on n parameters: m = beta1 m + (1 - beta1) g, v likewise of g^2, and
 * p -= rate m / (sqrt(v) scale + epsilon). Exactly one of grad32 and grad16 is given; copy16 (may be NULL) becomes
 * the cast copy of p. */
void adam_step(const adam_rates *rates, size_t n, float *p, const float *grad32, const uint16_t *grad16, float *m,
               float *v, uint16_t *copy16);

/* target += tau (p - target) on n parameters; copy16 (may be NULL) becomes its cast copy. */
void polyak_step(float tau, size_t n, float *target, const float *p, uint16_t *copy16);

#endif
