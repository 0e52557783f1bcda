/* SPDX-License-Identifier: MIT */
/// zygos/priv/numbers.h: small functions of numbers, vectors and bytes, which are inline because every stage needs
/// them.

#ifndef ZYGOS_NUMBERS_H
#define ZYGOS_NUMBERS_H

#include "../types.h"

#ifndef ZYGOS_DECLARATIONS_ONLY
#ifdef __cplusplus
extern "C" {
#endif

static inline uint32_t zygos_least(uint32_t a, uint32_t b)
{
    return (a < b) ? a : b;
}

static inline double zygos_larger(double a, double b)
{
    return (a > b) ? a : b;
}

static inline double zygos_magnitude(double x)
{
    return (x < 0.0) ? -x : x;
}

static inline bool zygos_within(double x, double low, double high)
{
    return (x >= low) && (x <= high);
}

/// Writes the lowest bytes of a value, the lowest one first.
static inline void zygos_put(uint8_t *out, uint32_t value, uint32_t bytes)
{
    for (uint32_t i = 0; i < bytes; i++) {
        out[i] = (uint8_t)(value >> (8u * i));
    }
}

/// Whether sums can have so many instants.
static inline bool zygos_is_count(double instants)
{
    return (instants >= 0.0) && (instants <= ZYGOS_MAX_INSTANTS);
}

static inline double zygos_dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void zygos_cross3(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

#ifdef __cplusplus
}
#endif
#endif

#endif
