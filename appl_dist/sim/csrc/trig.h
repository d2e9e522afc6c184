// Sine and cosine with the same bits on every machine: additions and multiplications alone, in a fixed order.
//
// libm's differ in the last bit between versions and processors; a trajectory would carry that on. Reduction to
// |r| <= pi/4 by Cody and Waite with pi/2 in three parts, then the polynomials of FreeBSD's k_sin.c and k_cos.c (Sun
// Microsystems 1993). Within 1 ulp of the exact value for |x| < 1e5, which no heading reaches. Compile without
// contraction (-ffp-contract=off): a fused multiply-add would round otherwise.
#pragma once
#include <stdint.h>

static inline void trig_sincos(double x, double *sine, double *cosine) {
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding and taking it away rounds to a whole number
    const double quarter = (x * 6.36619772367581382433e-01 + shift) - shift;
    const double first = x - quarter * 1.57079632673412561417e+00;  // 33 bits of pi/2: exact product
    const double second = quarter * 6.07710050630396597660e-11;     // the next 33 bits
    const double head = first - second;
    const double tail = ((first - head) - second) - quarter * 2.02226624879595063154e-21;
    const double r = head + tail;
    const double low = (head - r) + tail;

    const double z = r * r;
    const double ps =
        8.33333333332248946124e-03 +
        z * (-1.98412698298579493134e-04 +
             z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
    const double cube = z * r;
    const double s = r - ((z * (0.5 * low - cube * ps) - low) - cube * -1.66666666666666324348e-01);
    const double pc = z * (4.16666666666666019037e-02 +
                           z * (-1.38888888888741095749e-03 +
                                z * (2.48015872894767294178e-05 +
                                     z * (-2.75573143513906633035e-07 +
                                          z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    const double half = 0.5 * z;
    const double one = 1.0 - half;
    const double c = one + (((1.0 - one) - half) + (z * pc - r * low));

    switch ((int64_t)quarter & 3) {
        case 0:
            *sine = s;
            *cosine = c;
            break;
        case 1:
            *sine = c;
            *cosine = -s;
            break;
        case 2:
            *sine = -s;
            *cosine = -c;
            break;
        default:
            *sine = -c;
            *cosine = s;
            break;
    }
}
