/// zygos/gram.h: packed sums of outer products, lower triangle row by row, that carry their row sums.
///
/// G 1 = sum holds to rounding, unless memory was changed from outside.

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

#ifdef __cplusplus
}
#endif
#endif
