/* SPDX-License-Identifier: MIT */
/// zygos/priv/solver.h: solves the normal equations for parameters, standard deviations and a verdict.
///
/// The columns are scaled to unit length, and the matrix is factorised by Cholesky with symmetric pivoting. Columns
/// that are linear combinations of others are removed from the factorisation; they, and every parameter that they can
/// be exchanged for, are not identifiable yet and have no value. The bias of the equations by the declared noise is
/// subtracted (noise.h); when the residuals are smaller than that noise, a smaller share of it is subtracted. The
/// standard deviations (sigmas) are computed by the jackknife, solving again without one block at a time: neighbouring
/// rows share noise, so that s^2 A^-1 would be far too small. They are increased by what undeclared noise may hide, and
/// they have a floor for errors that may be the same in every arc and do not average out (ZYGOS_SYSTEMATIC).

#ifndef ZYGOS_SOLVER_H
#define ZYGOS_SOLVER_H

#include "../types.h"
#include "change.h"
#include "sums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A parameter with a smaller scaled pivot is a linear combination of the others.
#define ZYGOS_PIVOT_LIMIT 1e-11
/// Limit of the signal-to-noise ratio: the smallest ratio, over all linear combinations of columns, of the sums to the
/// noise in them (signal plus noise over noise, so that it is 1 where there is only noise). Below this limit only half
/// of the sums of the weakest combination is subtracted, and values that change by more than the limits for sigma
/// because of this are withheld.
#define ZYGOS_MIN_SIGNAL_TO_NOISE 2.0
/// When the mean square of the residuals is below this share of the declared noise, the declared noise is too large,
/// and it is scaled down to what the residuals show.
#define ZYGOS_OVERDECLARED 0.6
/// Below this share the declared noise is so far from the data that the correction of the rows cannot be trusted.
#define ZYGOS_NOISE_ABSENT 0.1
/// The residuals beyond the declared noise show how much undeclared noise the columns may contain. When its square, for
/// each scaled column, exceeds this share of the sums in the combination of columns that the motion excites least, the
/// estimate is refused. Otherwise the change of the solution by the same amount of noise is added to the sigmas.
#define ZYGOS_NOISE_LIMIT 1.0
/// When the residuals exceed this share of the variance of the work, no parameter has a value: the rows are noise, as
/// of an arm at rest (not identifiable), or, where the residuals are not noise, those of another arm (unexplained).
#define ZYGOS_UNEXPLAINED_LIMIT 0.1
/// Limit of the cluster statistic, the mean over the blocks of (sum of residuals)^2 / (instants * mean square). Noise
/// of the rows is correlated over a few instants only, so that this is around 1 or less. When it exceeds this limit,
/// and the block means exceed ZYGOS_CLUSTER_SHARE of the spread of the work, the balance does not close: a wrong gear
/// ratio, zero, sign or torque law, an effect that is not configured, noise of the torques, or a torque on the base.
#define ZYGOS_CLUSTER_LIMIT 5.0
#define ZYGOS_CLUSTER_SHARE 5e-3
/// The same share where joint rows alone are solved: a small constant torque is all that is wrong with many arms, and
/// the errors of smoothing do not persist in these rows.
#define ZYGOS_JOINT_CLUSTER_SHARE 1e-3
/// Where something small is missing, a solution looks closed. Three ratios of residuals, which need no declared noise
/// of angles and rates, show about half of what makes values wrong: the cluster statistic; the squared residuals of the
/// energy rows, solved together with the others over solved alone; the same of the motor rows of each joint. The noise
/// of torques, which walks, is allowed for, and what parameters of their own fit of the noise of few rows. What is less
/// than a share of the squares of the right side does not count. Such an estimate is doubtful, because the balance does
/// not close. Estimates that lack values, and those whose residuals may all be noise of the torques, are not judged.
#define ZYGOS_MISFIT_CLUSTER 3.0
#define ZYGOS_MISFIT_ENERGY 0.015
#define ZYGOS_MISFIT_MOTORS 0.005
#define ZYGOS_MISFIT_SHARE 1e-3
#define ZYGOS_MISFIT_CLUSTER_SHARE 2e-3
/// Where the balance closes only because of that share, the sigmas allow for a residual that all blocks have in common:
/// for the part of the cluster statistic above this value, which noise does not reach.
#define ZYGOS_CLUSTER_NOISE 1.0
/// Floor of the sigmas. The part of the squared residuals that the declared noise does not explain may be the same in
/// every arc, for example the error of the smoother in a fast motion. The scatter of the blocks decreases with their
/// number; that share of it is therefore kept as it would be after a single arc of arc_cycles instants: covariance =
/// scatter (1 + share instants / arc_cycles), to which the noise of the torques (balance.h) is added. The share is at
/// least this value, because no standard deviation is declared exactly, and because the neglected products of noise
/// with itself (noise.h) do not show in the residuals.
#define ZYGOS_SYSTEMATIC 0.125
/// A parameter whose sigma exceeds this share of its size is not identifiable yet. The size is the value; for a kinetic
/// parameter at least the square root of the product of the two diagonal parameters that it couples, and for a first
/// moment at least the largest first moment. Effects are exempt, because an effect may be zero. If the rank is full
/// nevertheless, the error of such a parameter is also in the others: their sigmas are increased by the change of the
/// solution without it, and the second, smaller limit holds for them.
#define ZYGOS_SIGMA_LIMIT 0.25
#define ZYGOS_SIGMA_LIMIT_BESIDE 0.025
/// The least number of groups of joint rows, and of blocks, from which standard deviations are computed; of blocks
/// behind arcs that contradict, as many as of groups: they merge beside the others.
#define ZYGOS_MIN_GROUPS 4u
#define ZYGOS_LEAST_BLOCKS ((ZYGOS_MAX_BLOCKS < 16) ? ZYGOS_MIN_GROUPS : 8u)
/// The gain of a torque sensor differs from what is declared of it where the estimate of its error exceeds this number
/// of standard deviations, by the declared errors and the scatter of the blocks together.
#define ZYGOS_GAIN_SIGMAS 3.0
/// A parameter that cannot be negative may be zero, and its estimate negative by up to this number of sigmas.
#define ZYGOS_NEGATIVE_SIGMAS 3.0

/// Blocks of a kind of rows, by their ranks, from the first to before the end.
typedef struct {
    uint32_t first;
    uint32_t end;
} zygos_range_t;

/// Where the solver finds the sums, and what it remembers in between. Its five triangles and its vectors of p entries
/// lie in memory of the accumulator that is free when all arcs have ended. It belongs to the task that solves; its
/// members are not for reading.
typedef struct {
    zygos_sums_t *sums;
    double *total;       ///< Sums of all rows, weighted, without their noise.
    double *noise;       ///< The noise that was subtracted.
    double *factor;      ///< The Cholesky factor of the scaled equations of all rows.
    double (*matrix)[2]; ///< Two systems of scaled equations side by side, or their factors; the size of two triangles.
    double *scale;
    double *right_side;
    double *solution;
    double *inverse; ///< Diagonal of the inverse of the scaled matrix.
    double *information[2];
    double *degrees_of_freedom;
    double *linearised_variance;
    double *product;
    double *prior_variance; ///< The part of each variance that the prior of the gains has.
    double (*pull)[2];      ///< The scores of two blocks side by side,
    double (*influence)[2]; ///< their influence on the solution,
    double (*change)[2];    ///< and its change without them.
    double (*column)[2];    ///< Scratch memory.
    double *size;           ///< In place of pull, behind the jackknife.
    double *noise_square;   ///< The same: squares of the errors that noise may hide.
    zygos_column_map_t column_map;
    double weight[ZYGOS_MAX_JOINTS]; ///< Weight of each joint's motor rows, that of the energy rows being 1.
    double momentum_weight;          ///< Weight of the momentum rows.
    double joints_weight;            ///< Weight of the joint rows.
    uint32_t joints_alone;           ///< 1: they alone are solved.
    uint32_t joints_used;            ///< 1: they take part.
    uint32_t gains;                  ///< Number of torque gains, which are the last parameters.
    uint32_t gains_held;             ///< 1: they are held at the values last found, gain_value.
    uint32_t gains_differ;           ///< Number of gains that contradict their prior.
    uint32_t gains_seen;             ///< Number of gains that the rows tell from 0.
    uint32_t fits;                   ///< 1: the solution with held gains fits all rows.
    uint32_t reserved;
    double alone;                        ///< Squared residuals of the energy rows solved alone [J^2].
    double gain_value[ZYGOS_MAX_JOINTS]; ///< Where they are held.
    double gain_cost[ZYGOS_MAX_JOINTS];  ///< Root of what a unit of information on each of them costs in variance.
    double gain_reference;               ///< Deviation of the error of the sensor that the gains are relative to.
    double gain_ratios;                  ///< Sum over the gains of its square over theirs.
    double spread;                       ///< Sum of the squared work without the constants of the arcs [J^2].
    zygos_range_t blocks[ZYGOS_KINDS_OF_ROWS]; ///< Those that are used, by enum zygos_rows.
    double instants;                           ///< Accepted instants in the blocks of energy rows.
    double noise_fraction;                     ///< Their share of the noise of all closed arcs.
    double noise_scale;                        ///< Share of the declared noise that is subtracted.
    uint32_t pivot[ZYGOS_MAX_PARAMETERS];      ///< The columns, the independent ones first.
    zygos_change_t newest;                     ///< What was found of a change of the arm, unless the sums were corrupt.
} zygos_solver_t;

/// A copy of the sums, and scratch memory of the solver. It is filled by zygos_arm_take() and consumed by
/// zygos_work_solve(). It belongs to the task that solves; its members are not for reading.
typedef struct {
    zygos_sums_t sums;
    zygos_solver_t solver;
} zygos_work_t;

/// Solves the normal equations in *work, which is changed, and writes *out. If zygos_arm_adopt() is in use, and the
/// estimate is not valid because the residuals are larger than noise, the solution is repeated without the oldest
/// quarter and without the older half of the arcs; the first of these that is valid and has far smaller residuals is
/// the answer, and out->since is the newest cycle that was excluded. Returns 1 when there are values, 0 when validity
/// is ZYGOS_REFUSED, or ZYGOS_E_NULL.
///
/// Cost: pairs of Cholesky factorisations of order p, with their solutions and inverses; two are made side by side. B
/// is the number of blocks of energy, motor and momentum rows, and with joint rows that take part also
/// ZYGOS_JOINT_GROUPS; the jackknife leaves out two of them at a time. To weigh the rows takes c = 0, and 5 more if
/// other rows are beside energy rows, 5 more for momentum rows, and 10 more for joint rows beside energy rows. A
/// solution needs at the most (B + 1) / 2 + c + 6 pairs, or (B + 1) / 2 + 2 c + 17 if gains of torque sensors are
/// estimated: never more than (B + 1) / 2 + 57. Without old arcs there are at the most two more solutions, each of
/// fewer energy blocks and without joint rows, so that they need at the most (B + 1) / 2 + 37: together never more than
/// 3 (B + 1) / 2 + 131, and 246 with the usual capacities. Their jackknife is left out unless the balance closes with
/// far smaller residuals, so that the dearest solution costs less than one and a half times as much as the dearest
/// valid one of the same arm (docs/cost.md).
int zygos_work_solve(zygos_work_t *work, zygos_estimate_t *out);

/// The parts of zygos_arm_solve() behind zygos_sums_match(): the solution, and the estimate where they do not match.
/// They need the member sums of *self, and that all arcs have ended. The triangles are free and empty before and
/// afterwards. Cost: as zygos_work_solve().
int zygos_solver_solve(zygos_solver_t *self, zygos_estimate_t *out);
int zygos_solver_refuse(zygos_estimate_t *out);

#ifdef __cplusplus
}
#endif
#endif
