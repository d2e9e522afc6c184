// Hyperbolic tangent with the same bits on every machine: additions, multiplications and one division, in a fixed
// order.
//
// libm's and numpy's differ in the last bit between versions and processors. tanh |x| = e / (e + 2) with
// e = exp(2 |x|) - 1, for which 2 |x| = k ln 2 + r, |r| <= ln 2 / 2, and exp(r) - 1 is its Taylor series up to r^13 /
// 13! (the rest is below 2^-56). Within 4 ulp of a double's, so that the float nearest to it is off by 1 ulp at most.
// Compile without contraction (-ffp-contract=off): a fused multiply-add would round otherwise.
#pragma once
#include <stdint.h>
#include <string.h>

static inline double portable_tanh(double x) {
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding and taking it away rounds to a whole number
    const double y = 2.0 * (x < 0 ? -x : x);
    if (!(y < 44.0)) return x != x ? x : x < 0 ? -1.0 : 1.0;  // 1 - tanh 22 is below half an ulp of 1
    const double k = (y * 1.44269504088896338700e+00 + shift) - shift;
    const double r = (y - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;  // ln 2 in two parts
    double series = 1.0 / 6227020800.0;
    series = 1.0 / 479001600.0 + r * series;
    series = 1.0 / 39916800.0 + r * series;
    series = 1.0 / 3628800.0 + r * series;
    series = 1.0 / 362880.0 + r * series;
    series = 1.0 / 40320.0 + r * series;
    series = 1.0 / 5040.0 + r * series;
    series = 1.0 / 720.0 + r * series;
    series = 1.0 / 120.0 + r * series;
    series = 1.0 / 24.0 + r * series;
    series = 1.0 / 6.0 + r * series;
    series = 0.5 + r * series;
    series = r + r * r * series;

    const uint64_t exponent = (uint64_t)((int64_t)k + 1023) << 52;
    double power;  // 2^k
    memcpy(&power, &exponent, sizeof power);
    const double e = power * series + (power - 1.0);
    return x < 0 ? -(e / (e + 2.0)) : e / (e + 2.0);
}
