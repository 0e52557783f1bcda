/* SPDX-License-Identifier: MIT */
/// zygos/priv/joint.h: rows of the joints' momentum over short increments.
///
/// For the angle q_j of a link the generalised momentum is p_j = dT/dq'_j, and from t_a to t_b
///
///     p_j(t_b) - p_j(t_a) - integral of (dT/dq_j - dV/dq_j) - integral of the spring's torque + integral of the losses
///         = n_j times the integral of tau_j where joint j is rigid, 0 where it is flexible
///
/// This is linear in the columns' parameters (balance.h), needs no acceleration, and there is a row for each joint. The
/// motor of a flexible joint acts on its rotor, which has a row of its own (impulse.h); the rotor of a rigid joint
/// turns with its link, and its balance is part of this row. The columns are the derivatives of those of the energy; in
/// addition
///
///     Im_i                    n_i theta'_i a_i . w_(i-1), differentiated by q'_j and by q_j, for i > j;
///                             n_j (n_j theta'_j + a_j . w_(j-1)) of a rigid joint itself
///     k_j, b_j                - integral of d, - d, of a flexible joint, with d = theta - q
///     ZYGOS_LINK_COULOMB      integral of sat(q')
///     ZYGOS_CUBIC_STIFFNESS   - integral of d^3
///     ZYGOS_SPRING_OFFSET     - time
///     others                  as in the rows of a motor's impulse, of a rigid joint
///
/// An increment is joint_row_cycles long, and neighbouring ones share half of their time: integrals are kept for each
/// half, and a row is formed of two. They are computed by the rule of the dissipation (balance.h); summed over a half,
/// each instant in it has the weight h, but for the last three and the first, whose integrands count for both sides.
/// At the end of a half only the motion is copied; the rows of the joints are formed one by one in the cycles that
/// follow. The first half begins with the fourth instant after a gap, as the arcs of other rows do.
///
/// Where a held torque steps, the smoothed rates exceed the true ones by h/12 times the jump of the acceleration
/// (balance.h). The momentum of a rigid joint is then too large by n_j h/12 (tau_k - tau_(k-1)), which is added to the
/// right side at both ends. On the link of a flexible joint no torque steps, and the terms of all joints cancel. (The
/// jump of a free base, whose rate is not differentiated, is neglected.)

#ifndef ZYGOS_JOINT_H
#define ZYGOS_JOINT_H

#include "../types.h"
#include "balance.h"
#include "kinematics.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The joints and columns for which there is memory.
#if ZYGOS_JOINT_ROWS
#define ZYGOS_JOINT_PLACES ZYGOS_MAX_JOINTS
#define ZYGOS_MAX_FORCE (ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS)
#else
#define ZYGOS_JOINT_PLACES 1
#define ZYGOS_MAX_FORCE 1
#endif

/// The least length of an increment in cycles: the rule of the integrals needs four steps in a half.
#define ZYGOS_MIN_INCREMENT 8u

/// The integrals over one half of an increment, of one joint.
typedef struct {
    double impulse;                     ///< n_j tau_j [Nms].
    double deflection;                  ///< d [rad s].
    double refused;                     ///< Number of refused instants, the same for each joint.
    double effect[ZYGOS_EFFECT_PLACES]; ///< What each effect of the joint integrates.
    double force[ZYGOS_MAX_FORCE];      ///< Of dT/dq_j - dV/dq_j: the bodies' columns, then the rotors'.
} zygos_joint_integrals_t;

/// What the ends of an increment contribute, of one joint.
typedef struct {
    double impulse;    ///< What the jump of the torque adds to the right side [Nms].
    double deflection; ///< d [rad].
    double effect[ZYGOS_EFFECT_PLACES];
    double momentum[ZYGOS_MAX_FORCE]; ///< p_j: the bodies' columns, then the rotors'.
} zygos_joint_end_t;

/// The newest end of an increment, of which the rows are formed one after the other.
typedef struct {
    double jump[ZYGOS_MAX_JOINTS];        ///< Step of each rotor's torque [Nm].
    double torque_mean[ZYGOS_MAX_JOINTS]; ///< And its mean before and behind [Nm].
    zygos_arm_state_t state;
    zygos_motion_t motion;
} zygos_joint_newest_t;

/// The state of the rows.
typedef struct {
    uint32_t position; ///< Instants since the newest half began.
    uint32_t halves;   ///< Halves that have ended since the gap, at most 3; the first one is not complete.
    uint32_t oldest;   ///< Index of the older of the two halves of the newest increment.
    uint32_t begin;    ///< Index in ends[] of the older end, which the newest replaces.
    uint32_t turn;     ///< The joint whose row comes next; N when all rows of the increment were formed.
    uint32_t reserved;
    zygos_joint_newest_t newest[2];                         ///< Twice, as the others.
    zygos_joint_integrals_t half[3][ZYGOS_JOINT_PLACES][2]; ///< Older, newer, and the one that is being filled, from
                                                            ///< oldest on; each twice.
    zygos_joint_end_t ends[2][ZYGOS_JOINT_PLACES][2];
} zygos_joint_t;

/// One row, not weighted.
typedef struct {
    double column[ZYGOS_MAX_COLUMNS]; ///< In the order of balance.h.
    double impulse;                   ///< The right side [Nms].
    double accepted;                  ///< 1, or 0 where an instant of the increment was refused.
    uint32_t joint;                   ///< Of which joint.
    uint32_t last;                    ///< 1: it is the last of its increment.
} zygos_joint_row_t;

/// Resets the integrals. Called at init and at every gap.
void zygos_joint_reset(zygos_joint_t *self, const zygos_config_t *config);

/// Returns whether every index and count is possible for a checked configuration.
bool zygos_joint_intact(const zygos_joint_t *self, const zygos_config_t *config);

/// Advances the integrals to this instant, and forms the row of a joint if one is due. tau_before[N] and tau[N] are the
/// torques that act until the instant and from it on. Needs a configuration with joint rows. What one cycle leaves to
/// the next is sealed. Returns 1 when there is a row, 0 when there is none, and -1 where memory was changed: then all
/// begins anew as after a gap. Cost: the derivatives by N angles, and two folds of the integrals; in the cycles in
/// which a row is formed also one momentum and a comparison of the motion, and at the ends of a half one copy of the
/// motion and up to twice the sums.
int zygos_joint_row(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                    const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                    const double *tau_before, const double *tau, zygos_joint_row_t *out);

/// Returns the number of signals whose noise is in the rows: the rates of N links, and those of a free base about three
/// axes, or one in a plane.
uint32_t zygos_joint_signals(const zygos_config_t *config);

/// Writes how the row of joint j at its newest end changes with the rate of link i (signal = i) or of the base about
/// axis k (signal = N + k; in a plane N alone), for each rad/s. With the variance of that rate, the expected product of
/// noise in the row is 2 variance out out^T summed over the signals, and 2 variance of theta'_i times the square of
/// rotor[i] on the diagonal at Im_i of each flexible joint, because the noise of an increment's ends is independent and
/// the mass matrix changes little between them. Noise of the angles is of second order and not used: it enters through
/// the change of the mass matrix and the force over an increment, and through d. Cost: two products of vectors for each
/// kinetic column.
void zygos_joint_derivative(const zygos_joint_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map, uint32_t joint, uint32_t signal, double *out,
                            double *rotor);

#ifdef __cplusplus
}
#endif
#endif
