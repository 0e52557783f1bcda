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

/// Largest violation of G 1 = sum in units of its tolerance 64 eps width max|G|, at the most 2; above 1 means corrupt.
/// width is at the most ZYGOS_MAX_ROW.
double zygos_gram_check(const double *gram, uint32_t width, const double *sum);

#ifdef __cplusplus
}
#endif
#endif
