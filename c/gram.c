#include "zygos/gram.h"

#include <string.h>

#define EPSILON 2.220446049250313e-16

static double magnitude(double x)
{
    return (x < 0.0) ? -x : x;
}

uint32_t zygos_gram_entries(uint32_t width)
{
    return width * (width + 1u) / 2u;
}

void zygos_gram_add(double *restrict gram, double *restrict sum, uint32_t width, const double *restrict z)
{
    double total = 0.0;
    for (uint32_t i = 0; i < width; i++) {
        total += z[i];
    }
    for (uint32_t i = 0; i < width; i++) {
        const double zi = z[i];
        const uint32_t end = i + 1u;
        for (uint32_t j = 0; j < end; j++) {
            gram[j] += zi * z[j];
        }
        gram += end;
        sum[i] += zi * total;
    }
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

double zygos_gram_check(const double *gram, uint32_t width, const double *sum, double adds)
{
    double anew[ZYGOS_MAX_ROW];
    double row_most[ZYGOS_MAX_ROW] = { 0.0 };
    double largest = 0.0;
    double worst = 0.0;
    zygos_gram_row_sums(gram, width, anew);
    const double *row = gram;
    for (uint32_t i = 0; i < width; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            const double size = magnitude(row[j]);
            row_most[i] = (size > row_most[i]) ? size : row_most[i];
            row_most[j] = (size > row_most[j]) ? size : row_most[j];
            largest = (size > largest) ? size : largest;
        }
        row += i + 1u;
    }
    const double share = EPSILON * (64.0 * (double)width + adds);
    for (uint32_t i = 0; i < width; i++) {
        const double off = magnitude(anew[i] - sum[i]);
        const double square = magnitude(gram[zygos_gram_entries(i + 1u) - 1u]);
        const double bound = __builtin_sqrt(square) * __builtin_sqrt(largest);
        const double tolerance = share * ((bound > row_most[i]) ? bound : row_most[i]);
        /* Not-a-number compares false with everything; neither it nor infinity is a sum. */
        const bool good = (off <= tolerance) && (tolerance < 1e300);
        const double ratio = good ? off / (tolerance + 1e-300) : 2.0;
        worst = (ratio > worst) ? ratio : worst;
    }
    return worst;
}
