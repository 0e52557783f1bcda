/// zygos/gram.h: packed sums of outer products, lower triangle row by row, that carry their row sums.
///
/// G 1 = sum holds to rounding, unless memory was changed from outside. What stands beside the sums has a seal.

#ifndef ZYGOS_GRAM_H
#define ZYGOS_GRAM_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Entries of a triangle that wide.
uint32_t zygos_gram_entries(uint32_t width);

/// Adds z z^T, and its row sums to sum; the three do not overlap. Cost: a product and a sum for each entry.
void zygos_gram_add(double *gram, double *sum, uint32_t width, const double *z);

/// Writes the row sums.
void zygos_gram_row_sums(const double *gram, uint32_t width, double *sum);

/// Largest violation of G 1 = sum in units of a row's tolerance, at the most 2; above 1 means corrupt. That is
/// (64 width + adds) eps times the largest entry that the row has, or by its diagonal could have: columns differ
/// in size by orders of magnitude, and every addition rounds, of like numbers always the same way. adds: how many there
/// were, or more. width is at the most ZYGOS_MAX_ROW.
double zygos_gram_check(const double *gram, uint32_t width, const double *sum, double adds);

/// A seal of what changes seldom and has no row sums: goes on with another number, or with n doubles. One flipped bit
/// in any of them always changes it. Cost: a multiplication a word.
uint64_t zygos_checksum_number(uint64_t checksum, uint64_t number);
uint64_t zygos_checksum_doubles(uint64_t checksum, const double *x, uint32_t n);

#ifdef __cplusplus
}
#endif
#endif
