/* SPDX-License-Identifier: MIT */
/// zygos/priv/change.h: detects a change of the arm by comparing the newest arc with the running solution.
///
/// The running solution x0 with its covariance C0 (guard.h) is compared with the solution x of the newest arc alone,
/// whether that arc was excluded or not. With the centred sums A of its energy rows, from which its share N of the
/// declared noise was subtracted, and the mean square r^2 of the residuals, that of the run or that of the arc,
/// whichever is larger,
///
///     deviation_i = (x - x0)_i / sqrt(C0_ii + r^2 (A^-1 (A + N) A^-1)_ii)
///
/// as if the noise of all rows were independent (a cluster statistic of 1, which noise does not reach). The guard holds
/// the sums of the newest arc that has half the instants of the longest; shorter arcs are held together. In a copy, the
/// open arc is one of them. Where x0 is also of a part of these rows, the deviations are smaller. Gains of torque
/// sensors, and parameters that the arc does not determine, are kept at x0 and have no deviation.
///
/// A deviation of ZYGOS_CHANGE_ALARM or more is a change of the arm where the residuals of x are noise. If they are
/// not, the cause may also be a sensor that fails, or an effect without a column, for example friction, in another
/// motion: then the deviation does not prove a change.
///
/// Where joint rows alone determine the estimate, the guard sees that the arm has changed, and the deviations tell in
/// what: those consecutive segments that contradict, but for the first, are compared in the same way.

#ifndef ZYGOS_CHANGE_H
#define ZYGOS_CHANGE_H

#include "../types.h"
#include "sums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Deviation of the newest arc from the running solution, in standard deviations, from which on it is a change.
#define ZYGOS_CHANGE_ALARM 6.0

/// The newest arc beside the running solution.
typedef struct {
    uint64_t until;  ///< Number of the newest cycle before the arc.
    uint32_t reason; ///< 0; ZYGOS_REASON_NO_DATA: nothing was compared; ZYGOS_REASON_UNCLOSED: the residuals of the
                     ///< arc's own solution are not noise.
    uint32_t reserved;
    double deviation[ZYGOS_MAX_PARAMETERS]; ///< NaN where nothing was compared.
} zygos_change_t;

/// Compares the newest arc. Needs that all arcs have ended. Only buffers are used, which are empty before and
/// afterwards. Cost: the Cholesky factor of a matrix of order p and the diagonal of its inverse, and p products with
/// the sums.
void zygos_change_compare(zygos_sums_t *sums, zygos_change_t *out);

/// Returns whether a deviation is a change of the arm.
bool zygos_change_found(const zygos_change_t *self);

#ifdef __cplusplus
}
#endif
#endif
