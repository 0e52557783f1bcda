/* SPDX-License-Identifier: MIT */
#include "zygos/priv/gram.h"

#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

#define EPSILON 2.220446049250313e-16
#define WORD 8u

void zygos_gram_add(double *restrict gram, double *restrict sum, uint32_t width, const double *restrict z)
{
    double total = 0.0;
    for (uint32_t i = 0; i < width; i++) {
        total += z[i];
    }
    /* Two rows and two columns at a time: most of all instructions of a cycle are here. */
    uint32_t i = 0;
    for (; i + 1u < width; i += 2u) {
        const double upper = z[i];
        const double lower = z[i + 1u];
        double *below = gram + i + 1u;
        for (const double *x = z; x != z + i; x += 2) {
            gram[0] += upper * x[0];
            gram[1] += upper * x[1];
            below[0] += lower * x[0];
            below[1] += lower * x[1];
            gram += 2;
            below += 2;
        }
        gram[0] += upper * upper;
        below[0] += lower * upper;
        below[1] += lower * lower;
        gram = below + 2;
        sum[0] += upper * total;
        sum[1] += lower * total;
        sum += 2;
    }
    if (i < width) {
        for (uint32_t j = 0; j < width; j++) {
            gram[j] += z[i] * z[j];
        }
        *sum += z[i] * total;
    }
}

double zygos_gram_form(const double *gram, const double *x, uint32_t width)
{
    const double *row = gram;
    double sum = 0.0;
    for (uint32_t i = 0; i < width; i++) {
        double along = 0.0;
        for (uint32_t j = 0; j < i; j++) {
            along += row[j] * x[j];
        }
        sum += x[i] * (2.0 * along + row[i] * x[i]);
        row += i + 1u;
    }
    return sum;
}

void zygos_gram_row_sums(const double *gram, uint32_t width, double *sum)
{
    memset(sum, 0, width * sizeof sum[0]);
    for (uint32_t i = 0; i < width; i++) {
        for (uint32_t j = 0; j < i; j++) {
            sum[i] += *gram;
            sum[j] += *gram;
            gram++;
        }
        sum[i] += *gram;
        gram++;
    }
}

void zygos_gram_scan(zygos_gram_scan_t *scan, const double *gram, uint32_t first, uint32_t end)
{
    const double *restrict from = &gram[zygos_gram_entries(first)];
    double *restrict sum = scan->sum;
    double *restrict most = scan->most;
    for (uint32_t i = first; i < end; i++) {
        double even = 0.0;
        double odd = 0.0;
        double top = 0.0;
        double other_top = 0.0;
        uint32_t j = 0;
        for (; j + 1u < i; j += 2u) { /* two entries at a time */
            const double size = __builtin_fabs(from[j]);
            const double other = __builtin_fabs(from[j + 1u]);
            even += from[j];
            odd += from[j + 1u];
            sum[j] += from[j];
            sum[j + 1u] += from[j + 1u];
            most[j] = zygos_larger(size, most[j]);
            most[j + 1u] = zygos_larger(other, most[j + 1u]);
            top = zygos_larger(size, top);
            other_top = zygos_larger(other, other_top);
        }
        if (j < i) {
            even += from[j];
            sum[j] += from[j];
            most[j] = zygos_larger(__builtin_fabs(from[j]), most[j]);
            top = zygos_larger(__builtin_fabs(from[j]), top);
        }
        top = zygos_larger(other_top, top);
        const double size = __builtin_fabs(from[i]);
        sum[i] = even + odd + from[i];
        most[i] = zygos_larger(size, top);
        scan->largest = zygos_larger(most[i], scan->largest);
        from += i + 1u;
    }
}

double zygos_gram_scanned(const zygos_gram_scan_t *scan, const double *gram, uint32_t width, const double *sum,
                          double adds)
{
    const double share = EPSILON * (64.0 * (double)width + adds);
    double worst = 0.0;
    for (uint32_t i = 0; i < width; i++) {
        const double off = __builtin_fabs(scan->sum[i] - sum[i]);
        const double square = __builtin_fabs(gram[zygos_gram_entries(i + 1u) - 1u]);
        const double bound = __builtin_sqrt(square) * __builtin_sqrt(scan->largest);
        const double tolerance = share * zygos_larger(bound, scan->most[i]);
        /* Not-a-number compares false with everything; neither it nor infinity is a sum. */
        const bool good = (off <= tolerance) && (tolerance < 1e300);
        const double ratio = good ? off / (tolerance + 1e-300) : 2.0;
        worst = zygos_larger(ratio, worst);
    }
    return worst;
}

double zygos_gram_check(const double *gram, uint32_t width, const double *sum, double adds)
{
    zygos_gram_scan_t scan = { { 0.0 }, { 0.0 }, 0.0 };
    zygos_gram_scan(&scan, gram, 0, width);
    return zygos_gram_scanned(&scan, gram, width, sum, adds);
}

/* The factor is odd and the rest can be turned back, so that two checksums never become equal. A product keeps the top
   bit to itself, and that of two words would cancel: the halves change places, and bits of the upper one are added. By
   one flipped bit of a word a checksum changes in two places at least, by which that is neither a flipped bit of the
   next word nor of the checksum. */
static uint64_t continued(uint64_t checksum, uint64_t number)
{
    const uint64_t product = (checksum ^ number) * 0x100000001B3u;
    return ((product << 32u) | (product >> 32u)) ^ (product >> 37u);
}

uint64_t zygos_checksum_number(uint64_t checksum, uint64_t number)
{
    return continued(checksum, number);
}

uint64_t zygos_checksum_words(uint64_t checksum, const uint64_t *word, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        checksum = continued(checksum, word[i]);
    }
    return checksum;
}

uint64_t zygos_checksum_doubles(uint64_t checksum, const double *x, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        checksum = continued(checksum, zygos_bits_of(x[i]));
    }
    return checksum;
}

uint64_t zygos_checksum_memory(uint64_t checksum, const void *memory, uint32_t bytes)
{
    const unsigned char *from = (const unsigned char *)memory;
    const unsigned char *const end = from + bytes;
    for (const unsigned char *const words = from + (bytes & ~7u); from != words; from += 8) {
        uint64_t word;
        __builtin_memcpy(&word, from, sizeof word);
        checksum = continued(checksum, word);
    }
    for (; from != end; from++) {
        checksum = continued(checksum, *from);
    }
    return checksum;
}

bool zygos_is_same(const void *a, const void *b, uint32_t bytes)
{
    const unsigned char *left = (const unsigned char *)__builtin_assume_aligned(a, 8);
    const unsigned char *right = (const unsigned char *)__builtin_assume_aligned(b, 8);
    uint64_t off = 0;
    for (const unsigned char *const end = left + (bytes & ~7u); left != end; left += 8, right += 8) {
        uint64_t l;
        uint64_t r;
        __builtin_memcpy(&l, left, 8);
        __builtin_memcpy(&r, right, 8);
        off |= l ^ r;
    }
    return off == 0;
}

/* Eight words at a time: memcpy() of a library for small cores moves four bytes at a time, because it does not know
   that these are aligned. */
void zygos_copy_words(void *to, const void *from, uint32_t words)
{
    unsigned char *out = __builtin_assume_aligned(to, WORD);
    const unsigned char *in = __builtin_assume_aligned(from, WORD);
    const unsigned char *const end = in + (size_t)words * WORD;
    for (const unsigned char *const eights = in + (size_t)(words & ~7u) * WORD; in != eights;) {
        __builtin_memcpy(out, in, 8u * WORD);
        out += 8u * WORD;
        in += 8u * WORD;
    }
    for (; in != end; in += WORD) {
        __builtin_memcpy(out, in, WORD);
        out += WORD;
    }
}

uint64_t zygos_fold_memory(uint64_t fold, const void *memory, uint32_t bytes)
{
    return zygos_fold_words(fold, memory, bytes);
}

bool zygos_checksum_repair(void *memory, uint32_t bytes, uint64_t checksum)
{
    unsigned char *byte = (unsigned char *)memory;
    const uint64_t off = checksum ^ zygos_checksum_memory(0, memory, bytes);
    if ((off & (off - 1u)) == 0) { /* it matches, or the flipped bit is its own */
        return true;
    }
    for (uint32_t bit = 0; bit < 8u * bytes; bit++) {
        byte[bit / 8u] = (unsigned char)(byte[bit / 8u] ^ (1u << (bit % 8u)));
        if (zygos_checksum_memory(0, memory, bytes) == checksum) {
            return true;
        }
        byte[bit / 8u] = (unsigned char)(byte[bit / 8u] ^ (1u << (bit % 8u)));
    }
    return false;
}
