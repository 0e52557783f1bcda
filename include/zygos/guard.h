/// zygos/guard.h: arcs that contradict what is known are left out.
///
/// A sensor that sticks, a frame that repeats an old value, a torque that was not there: one such arc would spoil the
/// sums for good. So a running solution x, which zygos_adopt() takes from a valid estimate, judges each arc when it
/// ends. With the centred sums G of an arc, the squares of its residuals are x~' G x~ and what noise took off, x~ =
/// [x, -1]. An arc contradicts the solution when they exceed
///
///     what noise leaves     as the declared noise of this arc says, times the noise ratio of the run; at least what
///                           rows of the run leave on average, by their number and by the spread of their right side,
///                           times the 6-sigma quantile of chi-square with as many degrees of freedom as an arc has
///                           independent rows, times ZYGOS_GUARD_MARGIN
///     + what x may be off   36 tr(G C), with the covariance C of x: six standard deviations in every direction, so
///                           that a motion unlike those before contradicts nothing that they did not tell
///     + rounding, rules     ZYGOS_GUARD_SHARE^2 of the spread of the right side
///
/// The blocks of energy rows are compared in the same way by the sums of their residuals, in which noise cancels and
/// little else does. The rows of the energy, of the motors and of the momentum have arcs of their own, and each of them
/// is judged by itself. An arc that contradicts is not admitted to the sums, but counted and named. Without a running
/// solution nothing is left out.
///
/// ZYGOS_CONSECUTIVE_ARCS arcs in a row that contradict are no accident: the arm has changed. They are left out all the
/// same, and the estimate, which is still that of the arm before, is doubtful (ZYGOS_REASON_CHANGED) until an arc
/// agrees again, zygos_restart(), or the arcs left out in a row hold more instants than the sums do: then the running
/// solution is given up, and all arcs are admitted until the next one.

#ifndef ZYGOS_GUARD_H
#define ZYGOS_GUARD_H

#include "accumulator.h"
#include "jointsums.h"
#include "momentumsums.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Energy arcs in a row; of the other rows as many as fit into so many of the longest energy arcs.
#define ZYGOS_CONSECUTIVE_ARCS 3u
/// Noise differs from arc to arc by more than chance: what nobody declared depends on the motion.
#define ZYGOS_GUARD_MARGIN 1.25
/// Of noise the residuals of a block add up to little (ZYGOS_CLUSTER_LIMIT): at least this is usual.
#define ZYGOS_GUARD_CLUSTER 0.25
/// Residuals of this share of the right side's spread contradict nothing.
#define ZYGOS_GUARD_SHARE 1e-3
/// Arcs whose place is remembered.
#define ZYGOS_GUARD_ARCS 16u

/// The kinds of rows, each with arcs of its own.
enum zygos_rows { ZYGOS_ENERGY_ROWS = 0, ZYGOS_MOTOR_ROWS = 1, ZYGOS_MOMENTUM_ROWS = 2, ZYGOS_KINDS_OF_ROWS = 3 };

/// An arc that was left out.
typedef struct {
    uint64_t end;    ///< Number of its newest cycle.
    uint32_t cycles; ///< How many it had.
    uint32_t rows;   ///< enum zygos_rows.
} zygos_left_out_t;

/// What rows of the run leave on average: mean squares of residuals and of the right side, each an instant.
typedef struct {
    double residual; ///< 0: nothing is known, and no such arc is left out.
    double spread;
} zygos_mean_squares_t;

typedef struct {
    uint32_t known;      ///< 1: there is a running solution.
    uint32_t parameters; ///< p.
    uint32_t changed;    ///< 1: so many arcs in a row contradict that the arm has changed.
    uint32_t lost;       ///< Times that the running solution was found spoilt, and forgotten.
    uint32_t adopting;   ///< 1: zygos_adopt() was called, whatever it was given.
    uint32_t reserved;
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS];        ///< Arcs that were left out, by enum zygos_rows.
    uint32_t consecutive[ZYGOS_KINDS_OF_ROWS];     ///< Of these the newest that no arc that agrees lies between.
    double instants[ZYGOS_KINDS_OF_ROWS];          ///< Of those in a row.
    double agreeing_instants[ZYGOS_KINDS_OF_ROWS]; ///< Instants of arcs behind them that agree; half the longest arc
                                                   ///< ends the row.
    double contradiction[ZYGOS_KINDS_OF_ROWS];     ///< Residuals of the newest arc over their limit; above 1 left out.
    uint64_t since;                                ///< Estimates up to this cycle are of another arm.
    uint64_t dropped; ///< Sums up to this cycle were dropped, for arcs before the first running solution spoilt them.
    zygos_left_out_t newest[ZYGOS_GUARD_ARCS]; ///< Number k of those left out, from 0, is at k % ZYGOS_GUARD_ARCS.
    uint64_t checksum;                         ///< Of what stands behind it, which only zygos_adopt() writes.
    double noise_ratio;                        ///< 0 where no noise is declared.
    double cluster;                            ///< At least ZYGOS_GUARD_CLUSTER.
    zygos_mean_squares_t energy;
    zygos_mean_squares_t motor[ZYGOS_MAX_JOINTS];
    zygos_mean_squares_t momentum;
    double solution[ZYGOS_MAX_PARAMETERS];
    double covariance[ZYGOS_MAX_PACKED]; ///< Of as many standard deviations as the 95 % intervals have.
} zygos_guard_t;

/// Empties the guard. counters: those of arcs left out go as well. cycle: estimates up to it are of another arm.
void zygos_guard_clear(zygos_guard_t *self, bool counters, uint64_t cycle);

/// Whether flags and counts are possible. A running solution that memory spoilt is no obstacle: its check does not
/// match when the next arc ends, and it is forgotten. Cost: a few comparisons.
bool zygos_guard_intact(const zygos_guard_t *self);

/// Drops the sums up to a cycle with which an arc ended, and counts their arcs as left out. Cost: one move of the sums.
void zygos_guard_drop(zygos_guard_t *self, zygos_accumulator_t *energy, zygos_joint_sums_t *motors,
                      zygos_momentum_sums_t *momentum, uint64_t cycle);

/// Begins with the running solution that the caller has written (parameters, noise_ratio, cluster, energy.residual,
/// solution, covariance): what rows of the run leave on average at it, and the check. Cost: the sums of the motor and
/// the momentum rows once, and one pass over the solution.
void zygos_guard_begin(zygos_guard_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                       const zygos_accumulator_t *energy, const zygos_joint_sums_t *motors,
                       const zygos_momentum_sums_t *momentum);

/// How many times its mean a mean square of so many independent rows can reach: the 6-sigma quantile of chi-square over
/// its degrees of freedom, by Wilson and Hilferty, times ZYGOS_GUARD_MARGIN.
double zygos_guard_chi_square_limit(double freedom);

/// End the open arc of the energy, motor or momentum rows, whose newest cycle is the given one and which had so many:
/// as zygos_accumulator_end_arc() and its like do, unless the arc contradicts the running solution. Cost: as these, and
/// the sums of the arc twice.
void zygos_guard_end_energy(zygos_guard_t *self, const zygos_config_t *config, zygos_accumulator_t *sums,
                            uint64_t cycle, uint32_t cycles);
void zygos_guard_end_motors(zygos_guard_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                            zygos_joint_sums_t *sums, uint64_t cycle);
void zygos_guard_end_momentum(zygos_guard_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                              zygos_momentum_sums_t *sums, uint64_t cycle);

#ifdef __cplusplus
}
#endif
#endif
