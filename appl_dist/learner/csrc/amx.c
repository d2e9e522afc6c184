#define _GNU_SOURCE
#include "amx.h"

enum { TILE_ROWS = 16, TILE_BYTES = 1024, DEPTH = 32, BLOCK = 32 };

static size_t blocks(size_t n, size_t size) { return (n + size - 1) / size; }

/* Tiles along the depth, those of the rest behind the others. */
static size_t tiles_deep(const amx_product *p) { return blocks(p->k, DEPTH) + blocks(p->fine, DEPTH); }

/* A factor in tiles, its outer extent rounded up to whole blocks of two tiles. */
static size_t packed_bytes(size_t outer, size_t depth) { return 2 * blocks(outer, BLOCK) * depth * TILE_BYTES; }

size_t amx_scratch(const amx_product *p) {
    return packed_bytes(p->m, tiles_deep(p)) + packed_bytes(p->n, tiles_deep(p));
}

#if defined(__x86_64__) && defined(__linux__) && \
    ((defined(__clang__) && __clang_major__ >= 13) || (!defined(__clang__) && __GNUC__ >= 11))

#include <cpuid.h>
#include <immintrin.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

#define AVX512 __attribute__((target("avx512f,avx512bw,avx512vl,avx512dq,avx512bf16")))
#define AMX __attribute__((target("avx512f,avx512bw,avx512vl,avx512dq,avx512bf16,amx-tile,amx-bf16")))
#define ARCH_REQ_XCOMP_PERM 0x1023
#define XFEATURE_XTILEDATA 18

int amx_available(void) {
    static int known; /* 0: not asked yet */
    if (!known) {
        unsigned a, b, c, d, a1, x;
        const int tiles = __get_cpuid_count(7, 0, &a, &b, &c, &d)
                          && (d >> 22 & 1) && (d >> 24 & 1) /* AMX-BF16, AMX-TILE */
                          && (b >> 16 & 1) && (b >> 17 & 1) && (b >> 30 & 1) && (b >> 31 & 1) /* AVX512F, DQ, BW, VL */
                          && __get_cpuid_count(7, 1, &a1, &x, &x, &x) && (a1 >> 5 & 1);       /* AVX512-BF16 */
        known = tiles && syscall(SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA) == 0 ? 1 : -1;
    }
    return known > 0;
}

static inline __mmask32 first32(size_t from, size_t end) {
    return end <= from ? 0 : end - from >= 32 ? ~(__mmask32)0 : ((__mmask32)1 << (end - from)) - 1;
}

/* The transpose of 16 x 16 numbers of 32 bits. */
AVX512 static inline void flip(__m512i v[16]) {
    __m512i t[16], u[16];
    for (int i = 0; i < 16; i += 2) {
        t[i] = _mm512_unpacklo_epi32(v[i], v[i + 1]);
        t[i + 1] = _mm512_unpackhi_epi32(v[i], v[i + 1]);
    }
    for (int i = 0; i < 16; i += 4) { /* then lane L of u[i + c] is column 4 L + c of rows i to i + 3 */
        u[i] = _mm512_unpacklo_epi64(t[i], t[i + 2]);
        u[i + 1] = _mm512_unpackhi_epi64(t[i], t[i + 2]);
        u[i + 2] = _mm512_unpacklo_epi64(t[i + 1], t[i + 3]);
        u[i + 3] = _mm512_unpackhi_epi64(t[i + 1], t[i + 3]);
    }
    for (int c = 0; c < 4; ++c) {
        const __m512i even = _mm512_shuffle_i32x4(u[c], u[4 + c], 0x88);
        const __m512i odd = _mm512_shuffle_i32x4(u[c], u[4 + c], 0xdd);
        const __m512i even2 = _mm512_shuffle_i32x4(u[8 + c], u[12 + c], 0x88);
        const __m512i odd2 = _mm512_shuffle_i32x4(u[8 + c], u[12 + c], 0xdd);
        v[c] = _mm512_shuffle_i32x4(even, even2, 0x88);
        v[4 + c] = _mm512_shuffle_i32x4(odd, odd2, 0x88);
        v[8 + c] = _mm512_shuffle_i32x4(even, even2, 0xdd);
        v[12 + c] = _mm512_shuffle_i32x4(odd, odd2, 0xdd);
    }
}

/* One tile from 16 stored rows along the outer extent, 32 numbers deep. */
AVX512 static inline void along(const uint16_t *from, size_t step, size_t rows, __mmask32 columns, __m512i v[16]) {
    for (size_t i = 0; i < TILE_ROWS; ++i)
        v[i] = i < rows ? _mm512_maskz_loadu_epi16(columns, from + i * step) : _mm512_setzero_si512();
}

/* One tile from 32 stored rows along the depth, 16 numbers wide: neighbours in depth become pairs. */
AVX512 static inline void across(const uint16_t *from, size_t step, size_t rows, __mmask16 columns, __m512i v[16]) {
    for (size_t i = 0; i < TILE_ROWS; ++i) {
        __m512i low = _mm512_setzero_si512(), high = low;
        if (2 * i < rows) low = _mm512_cvtepu16_epi32(_mm256_maskz_loadu_epi16(columns, from + 2 * i * step));
        if (2 * i + 1 < rows)
            high = _mm512_cvtepu16_epi32(_mm256_maskz_loadu_epi16(columns, from + (2 * i + 1) * step));
        v[i] = _mm512_or_si512(low, _mm512_slli_epi32(high, 16));
    }
}

/* Tiles [outer / 16][k / 32] of a factor, `total` places to each row of tiles; `deep` if its stored rows run along the
 * depth, `turned` if the tile unit wants the depth in the tile's rows where `along` and `across` leave it in the
 * columns, or the other way round. */
AVX512 static void pack(const amx_factor *f, size_t outer, size_t k, size_t total, int deep, int turned, uint16_t *to) {
    const size_t depth = blocks(k, DEPTH), count = 2 * blocks(outer, BLOCK);
    for (size_t i = 0; i < count * depth; ++i) { /* along the stored rows, whichever way they run */
        const size_t o = deep ? i % count : i / depth, d = deep ? i / count : i % depth;
        const size_t first = o * TILE_ROWS, rows = first < outer ? outer - first : 0, left = k - d * DEPTH;
        __m512i v[16];
        if (deep)
            across(f->data + d * DEPTH * f->step + first, f->step, left, (__mmask16)first32(first, outer), v);
        else
            along(f->data + first * f->step + d * DEPTH, f->step, rows, first32(d * DEPTH, k), v);
        if (turned) flip(v);
        uint16_t *tile = to + (o * total + d) * (TILE_BYTES / 2);
        for (int r = 0; r < TILE_ROWS; ++r) _mm512_store_si512((void *)(tile + 32 * r), v[r]);
    }
}

AVX512 static inline void halves(__m512i pairs, __m512 out[2]) {
    out[0] = _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(_mm512_castsi512_si256(pairs)), 16));
    out[1] = _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64(pairs, 1)), 16));
}

/* A block of 32 x 32 sums into c, with all that is fused. */
AVX512 static void finish(const amx_product *p, const float *sums, size_t row, size_t column) {
    const __mmask32 columns = first32(column, p->n);
    const size_t rows = p->m - row < BLOCK ? p->m - row : BLOCK;
    const __m512 zero = _mm512_setzero_ps();
    __m512 bias[2] = {zero, zero};
    if (p->bias) halves(_mm512_maskz_loadu_epi16(columns, p->bias + column), bias);
    for (size_t i = 0; i < rows; ++i) {
        __m512 low = _mm512_add_ps(_mm512_load_ps(sums + BLOCK * i), bias[0]);
        __m512 high = _mm512_add_ps(_mm512_load_ps(sums + BLOCK * i + 16), bias[1]);
        if (p->relu) { /* the second operand is what max gives if either is NaN */
            low = _mm512_max_ps(zero, low);
            high = _mm512_max_ps(zero, high);
        }
        __m512i x = (__m512i)_mm512_cvtne2ps_pbh(high, low);
        if (p->open) {
            const __m512i open = _mm512_maskz_loadu_epi16(columns, p->open + (row + i) * p->open_step + column);
            x = _mm512_maskz_mov_epi16(_mm512_cmpgt_epi16_mask(open, _mm512_setzero_si512()), x);
        }
        _mm512_mask_storeu_epi16(p->c + (row + i) * p->c_step + column, columns, x);
    }
}

AVX512 static void column_sums(const amx_product *p) {
    for (size_t column = 0; column < p->n; column += BLOCK) {
        const __mmask32 columns = first32(column, p->n);
        __m512 low = _mm512_setzero_ps(), high = low, x[2];
        for (size_t i = 0; i < p->k; ++i) {
            halves(_mm512_maskz_loadu_epi16(columns, p->b.data + i * p->b.step + column), x);
            low = _mm512_add_ps(low, x[0]);
            high = _mm512_add_ps(high, x[1]);
        }
        _mm512_mask_storeu_epi16(p->sums + column, columns, (__m512i)_mm512_cvtne2ps_pbh(high, low));
    }
}

/* What the tile unit is told: eight tiles of 16 rows of 64 bytes. */
static const struct {
    uint8_t palette, start, reserved[14];
    uint16_t bytes[16];
    uint8_t rows[16];
} eight_tiles = {1, 0, {0}, {64, 64, 64, 64, 64, 64, 64, 64}, {16, 16, 16, 16, 16, 16, 16, 16}};

AMX void amx_multiply(const amx_product *p, void *scratch) {
    const size_t depth = tiles_deep(p), tile = TILE_BYTES / 2, behind = blocks(p->k, DEPTH) * tile;
    uint16_t *a = scratch, *b = a + packed_bytes(p->m, depth) / 2;
    if (p->sums) column_sums(p);
    pack(&p->a, p->m, p->k, depth, p->a.transposed, p->a.transposed, a);
    pack(&p->b, p->n, p->k, depth, !p->b.transposed, p->b.transposed, b);
    if (p->fine) {
        const amx_factor last = {p->b.data + (p->k - p->fine) * p->b.step, p->b.step, 0};
        pack(&p->rest, p->m, p->fine, depth, 0, 0, a + behind);
        pack(&last, p->n, p->fine, depth, 1, 0, b + behind);
    }
    _tile_loadconfig(&eight_tiles);
    float sums[BLOCK * BLOCK] __attribute__((aligned(64)));
    for (size_t column = 0; column < p->n; column += BLOCK)
        for (size_t row = 0; row < p->m; row += BLOCK) {
            const uint16_t *a0 = a + row / 16 * depth * tile, *a1 = a0 + depth * tile;
            const uint16_t *b0 = b + column / 16 * depth * tile, *b1 = b0 + depth * tile;
            _tile_zero(0);
            _tile_zero(1);
            _tile_zero(2);
            _tile_zero(3);
            /* Seven tiles: with the eighth the loop takes 1.4 times as long while the core's other thread works. */
            for (size_t d = 0; d < depth * tile; d += tile) {
                _tile_loadd(4, a0 + d, 64);
                _tile_loadd(5, a1 + d, 64);
                _tile_loadd(6, b0 + d, 64);
                _tile_dpbf16ps(0, 4, 6);
                _tile_dpbf16ps(2, 5, 6);
                _tile_loadd(6, b1 + d, 64);
                _tile_dpbf16ps(1, 4, 6);
                _tile_dpbf16ps(3, 5, 6);
            }
            _tile_stored(0, sums, 4 * BLOCK);
            _tile_stored(1, sums + 16, 4 * BLOCK);
            _tile_stored(2, sums + 16 * BLOCK, 4 * BLOCK);
            _tile_stored(3, sums + 16 * BLOCK + 16, 4 * BLOCK);
            finish(p, sums, row, column);
        }
    _tile_release(); /* whoever uses tiles next configures its own */
}

#else

int amx_available(void) { return 0; }

void amx_multiply(const amx_product *product, void *scratch) {
    (void)product;
    (void)scratch;
}

#endif
