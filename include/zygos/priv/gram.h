/* SPDX-License-Identifier: MIT */
/// zygos/priv/gram.h: sums of outer products, packed as lower triangle by rows, with their row sums.
///
/// G 1 = sum holds up to rounding, unless memory was changed from outside. Other data are protected by a checksum.

#ifndef ZYGOS_GRAM_H
#define ZYGOS_GRAM_H

#include "../types.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns the number of entries of a triangle of that width. It is inline because each pass over a triangle needs it.
static inline uint32_t zygos_gram_entries(uint32_t width)
{
    return width * (width + 1u) / 2u;
}

/// Returns the place of an entry of a symmetric matrix whose lower triangle is packed by rows.
static inline uint32_t zygos_gram_place(uint32_t i, uint32_t j)
{
    return (i >= j) ? zygos_gram_entries(i) + j : zygos_gram_entries(j) + i;
}

/// Returns an entry of such a matrix.
static inline double zygos_gram_entry(const double *gram, uint32_t i, uint32_t j)
{
    return gram[zygos_gram_place(i, j)];
}

/// Returns the bits of a number. The compiler's own memcpy() is one load, also where a freestanding build has no other
/// than that of a library.
static inline uint64_t zygos_bits_of(double x)
{
    uint64_t bits;
    __builtin_memcpy(&bits, &x, sizeof bits);
    return bits;
}

/// Exchanges the halves, which costs a core of 32 bits nothing.
static inline uint64_t zygos_exchanged(uint64_t number)
{
    return (number << 32u) | (number >> 32u);
}

/// Returns a fold that is continued with a number, for what each cycle compares: cheaper than a checksum. The same bit
/// flipped in two numbers cancels only where these are a multiple of 64 apart.
static inline uint64_t zygos_folded(uint64_t fold, uint64_t number)
{
    return ((fold << 1u) | (fold >> 63u)) ^ number;
}

/// The same for at most 32 counts.
static inline uint32_t zygos_folded_count(uint32_t fold, uint32_t count)
{
    return ((fold << 1u) | (fold >> 31u)) ^ count;
}

/// Return what a fold is stored as: a flipped bit of what was folded changes more than that bit of it.
static inline uint64_t zygos_fold_end(uint64_t fold)
{
    const uint64_t mixed = fold * 0x9E3779B97F4A7C15u;
    return mixed ^ (mixed >> 32u);
}
static inline uint32_t zygos_fold_of_counts_end(uint32_t fold)
{
    const uint32_t mixed = fold * 0x9E3779B1u;
    return mixed ^ (mixed >> 15u);
}

/// Returns the share that sums of closed arcs keep by a product of forgetting factors: 1 where nothing fades, and for a
/// product that cannot be.
static inline double zygos_kept_share(const zygos_config_t *config, double product)
{
    return ((config->forgetting_factor < 1.0) && (product >= 0.0) && (product < 1.0)) ? product : 1.0;
}

/// Returns a fold that is continued with whole words of eight bytes, two of them at a time: what changes from cycle to
/// cycle. The factor is odd, so that a flipped bit always changes the product; the top bit, which a product keeps to
/// itself, becomes one in the middle. That is cheaper than a turn for each word, which takes a core of 32 bits four
/// instructions. Memory must have the alignment of a double. Inline, for where the number of words is known. Cost: five
/// operations for two words.
__attribute__((always_inline)) static inline uint64_t zygos_fold_words(uint64_t fold, const void *memory,
                                                                       uint32_t bytes)
{
    const unsigned char *from = (const unsigned char *)__builtin_assume_aligned(memory, 8);
    const unsigned char *const pairs = from + (bytes & ~15u);
    uint64_t word[2];
    for (; from != pairs; from += 16) {
        __builtin_memcpy(word, from, sizeof word);
        fold = zygos_exchanged((fold ^ word[0] ^ zygos_exchanged(word[1])) * 0x9E3779B1u);
    }
    if ((bytes & 8u) != 0) {
        __builtin_memcpy(word, from, sizeof word[0]);
        fold = zygos_exchanged((fold ^ word[0]) * 0x9E3779B1u);
    }
    return fold;
}

/// The same with the members of a struct from the first to the last of these, with what lies between: whole words, or
/// it does not compile. Needs stddef.h.
#define ZYGOS_BETWEEN(type, first, last) (offsetof(type, last) + sizeof(((type *)0)->last) - offsetof(type, first))
#define ZYGOS_WORDS(bytes) ((uint32_t)((bytes) * sizeof(char[((bytes) % 8u == 0u) ? 1 : -1])))
#define ZYGOS_FOLDED(fold, whole, type, first, last)                                                                   \
    zygos_fold_words(fold, (const unsigned char *)(whole) + offsetof(type, first),                                     \
                     ZYGOS_WORDS(ZYGOS_BETWEEN(type, first, last)))
#endif

/// Adds z z^T to gram, and its row sums to sum. The three arrays must not overlap. Cost: a product and a sum for each
/// entry.
void zygos_gram_add(double *gram, double *sum, uint32_t width, const double *z);

/// Returns the sum over i, j of x_i x_j entry.
double zygos_gram_form(const double *gram, const double *x, uint32_t width);

/// Writes the row sums of gram into sum.
void zygos_gram_row_sums(const double *gram, uint32_t width, double *sum);

/// Returns the largest violation of G 1 = sum in units of a row's tolerance, at most 2; above 1 means corrupt. The
/// tolerance is (64 width + adds) eps times the largest entry that the row has or could have by its diagonal, because
/// columns differ in size by orders of magnitude and every addition rounds. adds: the number of additions, or more.
/// width: at most ZYGOS_MAX_ANY_ROW.
double zygos_gram_check(const double *gram, uint32_t width, const double *sum, double adds);

/// The same in parts. Scan the rows from first to before end, in order; the scan is all zero before the first.
/// zygos_gram_scanned() returns what zygos_gram_check() does.
typedef struct {
    double sum[ZYGOS_MAX_ANY_ROW];  ///< Row sums of the rows so far.
    double most[ZYGOS_MAX_ANY_ROW]; ///< The largest magnitude in each row.
    double largest;                 ///< In all of them.
} zygos_gram_scan_t;
void zygos_gram_scan(zygos_gram_scan_t *scan, const double *gram, uint32_t first, uint32_t end);
double zygos_gram_scanned(const zygos_gram_scan_t *scan, const double *gram, uint32_t width, const double *sum,
                          double adds);

/// Return a checksum that is continued with another number, with n words, with n doubles, or with bytes of memory. It
/// protects data that change seldom and have no row sums. One flipped bit in any of them always changes it, and the
/// same bit flipped in two words does not cancel. Cost: one multiplication for each word of eight bytes.
uint64_t zygos_checksum_number(uint64_t checksum, uint64_t number);
uint64_t zygos_checksum_words(uint64_t checksum, const uint64_t *word, uint32_t n);
uint64_t zygos_checksum_doubles(uint64_t checksum, const double *x, uint32_t n);
uint64_t zygos_checksum_memory(uint64_t checksum, const void *memory, uint32_t bytes);

/// Returns whether whole words of eight bytes are the same, whose memory has the alignment of a double. Unlike
/// memcmp(), which compilers make a call of a library of, it costs the same whatever they are.
bool zygos_is_same(const void *a, const void *b, uint32_t bytes);

/// Copies whole words of eight bytes, whose memory has the alignment of a double.
void zygos_copy_words(void *to, const void *from, uint32_t words);

/// Returns what zygos_fold_words() does.
uint64_t zygos_fold_memory(uint64_t fold, const void *memory, uint32_t bytes);

/// Repairs a bit that was flipped in memory or in its checksum, which began with 0. Returns true when they match, or do
/// so with one bit the other way round, which is then the content; false, with memory unchanged, when more was changed.
/// Cost: one pass over the memory for each of its bits.
bool zygos_checksum_repair(void *memory, uint32_t bytes, uint64_t checksum);

#ifdef __cplusplus
}
#endif
#endif
