// Functions compiled for several vector widths, chosen when the module is loaded. Sums are in the written order and
// products are not fused, so every width yields the same bits.
#pragma once

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__)
#define WIDE __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define WIDE
#endif

// What such functions are made of has to become part of each version.
#define ALWAYS_INLINE static inline __attribute__((always_inline))
