/* Products of bfloat16 matrices on the tile unit of x86 server processors (AMX), rounded to bfloat16 once at the end.
 *
 * Both factors are first packed into tiles of 16 rows of 64 bytes. Sums are float32, in an order that depends on the
 * sizes alone: equal arguments give equal bits. bfloat16 is passed as uint16_t.
 */
#ifndef APPL_AMX_H
#define APPL_AMX_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    const uint16_t *data;
    size_t step;    /* elements from one stored row to the next */
    int transposed; /* stored as the transpose of what it stands for */
} amx_factor;

/* c (m, n) = a (m, k) b (k, n) + bias, and what is fused with it. */
typedef struct {
    size_t m, n, k;
    amx_factor a, b;
    amx_factor rest;      /* (m, fine) what rounding left of a's last columns, times b's last rows once more; neither
                             is stored transposed */
    size_t fine;          /* 0 for none */
    const uint16_t *bias; /* (n), or NULL */
    int relu;             /* negative results become 0; NaN stays */
    const uint16_t *open; /* (m, n) as c, or NULL: results become 0 where this is not positive */
    size_t open_step;
    uint16_t *sums;       /* (n), or NULL: becomes the sums of b's columns; b must not be stored transposed */
    uint16_t *c;
    size_t c_step;
} amx_product;

/* Whether this processor has the tile unit and this process may use it. Asks the kernel once. */
int amx_available(void);

/* Bytes of scratch that amx_multiply needs. */
size_t amx_scratch(const amx_product *product);

/* scratch: amx_scratch bytes at a multiple of 64. Only where amx_available. */
void amx_multiply(const amx_product *product, void *scratch);

#endif
