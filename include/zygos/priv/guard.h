/* SPDX-License-Identifier: MIT */
/// zygos/priv/guard.h: excludes arcs that contradict the estimate (outlier rejection).
///
/// A single arc with a sensor that is stuck, a frame that repeats an old value or a torque that was not applied would
/// corrupt the sums permanently. Therefore each arc is compared, when it ends, with a running solution x, which
/// zygos_arm_adopt() takes from a valid estimate. With the centred sums G of an arc and x~ = [x, -1], the sum of its
/// squared residuals is x~' G x~ plus the noise that was subtracted. An arc contradicts the solution when this sum
/// exceeds
///
///     the noise             of this arc as declared, times the noise ratio of the run, but at least the average of the
///                           run, by the number of rows and by the spread of their right side; times the 6-sigma
///                           quantile of chi-square with as many degrees of freedom as the arc has independent rows,
///                           times ZYGOS_GUARD_MARGIN
///     + the error of x      36 tr(G C), with the covariance C of x: six standard deviations in every direction, so
///                           that a new kind of motion does not contradict what was not determined before
///     + numerical errors    of rounding and of the quadrature: ZYGOS_GUARD_SHARE^2 of the spread of the right side
///
/// Where joint rows alone determine the estimate (zygos_joint_sums_suffice()), their segments are compared instead, and
/// energy rows are not: "arc" then means a segment of joint rows (jointsums.h), whose degrees of freedom are half the
/// rows of one joint, because increments share halves.
///
/// The blocks of energy rows are compared in the same way by the sums of their residuals, in which noise cancels and
/// systematic errors do not. The energy, motor and momentum rows have arcs of their own, and each kind is compared by
/// itself. An arc that contradicts is not added to the sums; it is counted, and its place is recorded. Without a
/// running solution no arc is excluded. Joint rows beside energy rows are not compared.
///
/// When ZYGOS_CONSECUTIVE_ARCS consecutive arcs contradict, the arm has changed. These arcs are excluded, too, and the
/// estimate, which is still that of the arm before the change, is doubtful (ZYGOS_REASON_CHANGED) until an arc agrees
/// again, until zygos_arm_restart(), or until the consecutive excluded arcs have more instants than the sums. In the
/// last case the running solution is discarded, and all arcs are added until the next one is adopted.

#ifndef ZYGOS_GUARD_H
#define ZYGOS_GUARD_H

#include "../types.h"
#include "accumulator.h"
#include "jointsums.h"
#include "momentumsums.h"
#include "motorsums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Number of consecutive energy arcs, or segments of joint rows alone; for the other rows, the number of arcs in as
/// many of the longest energy arcs.
#define ZYGOS_CONSECUTIVE_ARCS 3u
/// The noise differs between arcs by more than chance, because undeclared noise depends on the motion.
#define ZYGOS_GUARD_MARGIN 1.25
/// The least cluster statistic (ZYGOS_CLUSTER_LIMIT) that is expected in a run.
#define ZYGOS_GUARD_CLUSTER 0.25
/// Residuals below this share of the spread of the right side do not contradict.
#define ZYGOS_GUARD_SHARE 1e-3
/// Arcs that are held together have at least this number of instants for each parameter, and half those of the longest.
#define ZYGOS_GUARD_HELD 25.0
/// Number of excluded arcs whose places are recorded.
#define ZYGOS_GUARD_ARCS 16u

/// An arc that was excluded.
typedef struct {
    uint64_t end;    ///< Number of its newest cycle.
    uint32_t cycles; ///< Number of its cycles.
    uint32_t rows;   ///< enum zygos_rows.
} zygos_left_out_t;

/// Mean squares of the residuals and of the right side of a run, for one instant.
typedef struct {
    double residual; ///< 0: unknown; then no such arc is excluded.
    double spread;
} zygos_mean_squares_t;

/// Comparison of the rows of an arc with the running solution.
typedef struct {
    double residual;    ///< Sum of the squared residuals, including noise.
    double expected;    ///< Its expected value by the declared noise.
    double uncertainty; ///< Its expectation for an error of the solution of one standard deviation.
    double spread;      ///< Sum of the squares of the right side.
} zygos_finding_t;

/// The running solution, and the arcs that were excluded.
typedef struct {
    uint32_t known;      ///< 1: there is a running solution.
    uint32_t parameters; ///< p.
    uint32_t changed;    ///< 1: so many consecutive arcs contradict that the arm has changed.
    uint32_t lost;       ///< Number of times the running solution was found corrupt and was discarded.
    uint32_t adopting;   ///< 1: zygos_arm_adopt() was called, with whatever result.
    uint32_t comparing;  ///< Kinds of rows, as bits, whose closing arc is compared with the running solution.
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS];        ///< Number of excluded arcs, by enum zygos_rows.
    uint32_t consecutive[ZYGOS_KINDS_OF_ROWS];     ///< Number of consecutive newest arcs among them.
    double instants[ZYGOS_KINDS_OF_ROWS];          ///< Instants of the consecutive arcs.
    double agreeing_instants[ZYGOS_KINDS_OF_ROWS]; ///< Instants of later arcs that agree; from half the
                                                   ///< longest arc on, consecutive begins at 0 again.
    double contradiction[ZYGOS_KINDS_OF_ROWS];     ///< Residuals of the newest arc over their limit; excluded above 1.
    uint64_t since;                                ///< Estimates up to this cycle belong to another arm.
    uint64_t agreed;                               ///< The newest cycle before the consecutive segments of joint rows.
    uint64_t dropped;           ///< Sums up to this cycle were dropped, because they contained bad arcs.
    zygos_finding_t rows;       ///< Of the blocks of the closing arc that were compared.
    zygos_finding_t noise;      ///< Of its noise.
    zygos_finding_t blocks;     ///< Of the sums of residuals of its blocks.
    double share;               ///< Sum over its blocks of instants^2 / square.
    double compared;            ///< Number of its blocks.
    double walk;                ///< Uncertainty of the sum of residuals of a block.
    double motor_worst;         ///< Residuals over their limit of the closing arc of motor rows.
    uint32_t motor_informative; ///< 1: that arc could have contradicted.
    uint32_t reserved;
    zygos_finding_t momenta;                   ///< Of the closing arc of momentum rows.
    zygos_finding_t momentum_noise;            ///< Of its noise.
    zygos_left_out_t newest[ZYGOS_GUARD_ARCS]; ///< Excluded arc number k is at k % ZYGOS_GUARD_ARCS.
    uint64_t checksum;                         ///< Of the members after it, which only zygos_arm_adopt() writes.
    double noise_ratio;                        ///< 0 where no noise is declared.
    double cluster;                            ///< At least ZYGOS_GUARD_CLUSTER.
    zygos_mean_squares_t energy;
    zygos_mean_squares_t motor[ZYGOS_MAX_JOINTS];
    zygos_mean_squares_t momentum;
    double solution[ZYGOS_MAX_PARAMETERS];
    double covariance[ZYGOS_MAX_PACKED]; ///< Widened as the 95 % intervals are.
    uint64_t held_after;                 ///< Number of the newest cycle before the arcs in held.
    double held_instants;                ///< Their instants; 0 while an arc is added.
    double held_before;                  ///< Those without the arc that is added.
    uint32_t held_anew;                  ///< 1: it is the first of them.
    uint32_t held_arcs;                  ///< Their number.
    zygos_noise_sums_t held; ///< Sums of the newest arcs of energy rows that were compared, excluded or not, without
                             ///< their constants (change.h).
} zygos_guard_t;

/// Discards the running solution. counters: true to clear the counters of excluded arcs as well. cycle: estimates up to
/// this cycle will not be adopted, because they belong to another arm.
void zygos_guard_clear(zygos_guard_t *self, bool counters, uint64_t cycle);

/// Returns whether flags and counts are possible. A corrupt running solution need not be detected here: its checksum
/// does not match when the next arc ends, and it is discarded. Cost: a few comparisons.
bool zygos_guard_intact(const zygos_guard_t *self);

/// Returns the number of instants with which arcs that are held are compared (change.h).
double zygos_guard_enough(const zygos_config_t *config, uint32_t parameters);

/// Returns whether there is a running solution of p parameters with the right checksum; otherwise it is discarded.
/// Cost: one pass over its covariance.
bool zygos_guard_has_solution(zygos_guard_t *self, uint32_t parameters);

/// Takes over the running solution that zygos_guard_adopt() has written into another one. Cost: one copy of it.
void zygos_guard_take_over(zygos_guard_t *self, const zygos_guard_t *from);

/// Returns the 6-sigma quantile of chi-square over its degrees of freedom, by the approximation of Wilson and Hilferty,
/// times ZYGOS_GUARD_MARGIN: the limit of a mean square of so many independent rows in units of its expectation.
double zygos_guard_chi_square_limit(double freedom);

#ifdef __cplusplus
}
#endif
#endif
