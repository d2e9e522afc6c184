// Functions compiled for several vector widths, chosen when the module is loaded. Sums are in the written order and
// products are not fused, so every width yields the same bits.
#pragma once

// clang wants the attribute on every declaration, and sanitizers want one version: they get the plain functions, and so
// does a test that defines ONE_WIDTH to compile for one processor.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(ONE_WIDTH)
#if __GNUC__ >= 12
#define WIDE __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#endif
#else
#define WIDE
#endif

// What such functions are made of has to become part of each version.
#define ALWAYS_INLINE static inline __attribute__((always_inline))

// The elements a, b, c and d of the eight in two vectors of four uint64_t. GCC has the portable name since 12.
#if defined(__clang__) || __GNUC__ >= 12
#define SHUFFLE4(v, w, a, b, c, d) __builtin_shufflevector(v, w, a, b, c, d)
#else
#define SHUFFLE4(v, w, a, b, c, d) __builtin_shuffle(v, w, (__typeof__(v)){a, b, c, d})
#endif
