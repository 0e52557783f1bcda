/* SPDX-License-Identifier: MIT */
/// zygos/priv/impulse.h: forms one row of the motor impulse for each flexible joint and instant.
///
///     n_i int tau_i = row_k . parameters of joint i + constant of the arc
///
/// This is the rotor's equation of motion, multiplied by the gear ratio n and integrated once. With d = theta - q the
/// columns are
///
///     Im_i                    n^2 theta' + n a_i . w_(i-1)
///     k_i                     integral of d
///     b_i                     d
///     ZYGOS_MOTOR_COULOMB     integral of n sat(theta')
///     ZYGOS_MOTOR_VISCOUS     n theta
///     ZYGOS_CUBIC_STIFFNESS   integral of d^3
///     ZYGOS_SPRING_OFFSET     time since the arc began
///     ZYGOS_TORQUE_LAG        n (tau_(k-1) + tau_k) / 2
///     ZYGOS_TORQUE_OFFSET     n times the time since the arc began
///     ZYGOS_VISCOUS_ASYMMETRY integral of n |theta'|
///     ZYGOS_TORQUE_GAIN       - the impulse of the row
///
/// in the order of the configuration; friction of a link has no column. The integrals are computed by the rule of the
/// dissipation (balance.h) and begin with the arc. The row does not contain the inertia of any link: it is local to its
/// joint, and so are its unknowns.
///
/// A torque that is held between SYNCs adds exactly n h tau in each period. Where it steps, the smoothed theta' exceeds
/// the true one by h/12 times the jump of the acceleration (balance.h). The rotor's inertia times that jump is
/// n (tau_k - tau_(k-1)), so n h/12 (tau_k - tau_(k-1)) is added to the impulse of the row. (A sampled torque has no
/// such term. The jump of the base, whose rate is not differentiated, is neglected.)
///
/// The integral of d accumulates the noise of the encoders like a random walk. Therefore these rows need shorter arcs
/// than the energy rows, and have arcs of their own.

#ifndef ZYGOS_IMPULSE_H
#define ZYGOS_IMPULSE_H

#include "../types.h"
#include "effects.h"
#include "kinematics.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The largest number of columns of a joint's row: Im, k, b and the effects at the joint, of each kind at most one.
#if ZYGOS_MAX_EFFECTS < ZYGOS_EFFECT_KINDS
#define ZYGOS_MAX_IMPULSE (3 + ZYGOS_MAX_EFFECTS)
#else
#define ZYGOS_MAX_IMPULSE (3 + ZYGOS_EFFECT_KINDS)
#endif
#define ZYGOS_MAX_PACKED_IMPULSE (ZYGOS_MAX_IMPULSE * (ZYGOS_MAX_IMPULSE + 1) / 2)

/// The state of the integrals.
typedef struct {
    uint32_t instants;                            ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;                              ///< 1: the next instant opens an arc.
    double impulse[ZYGOS_MAX_JOINTS];             ///< n int tau [Nms].
    double deflection_integral[ZYGOS_MAX_JOINTS]; ///< Integral of d [rad s].
    double past[3][ZYGOS_MAX_JOINTS];             ///< d at the three previous instants, newest first.
    double total[ZYGOS_EFFECT_PLACES];            ///< Integral of each effect.
    double before[3][ZYGOS_EFFECT_PLACES];        ///< Its integrand at the three previous instants, newest first.
} zygos_impulse_t;

/// The columns of each joint. effect[i][c] is the effect in column 3 + c of joint i.
typedef struct {
    uint32_t count[ZYGOS_MAX_JOINTS]; ///< Number of columns; 0 where the joint is rigid and has no row.
    uint32_t effect[ZYGOS_MAX_JOINTS][ZYGOS_EFFECT_PLACES];
} zygos_impulse_column_map_t;

/// The rows of one instant.
typedef struct {
    double column[ZYGOS_MAX_JOINTS][ZYGOS_MAX_IMPULSE];
    double impulse[ZYGOS_MAX_JOINTS]; ///< The right side [Nms].
} zygos_impulse_rows_t;

/// Computes the columns of each joint. Needs a checked configuration.
void zygos_impulse_column_map(const zygos_config_t *config, zygos_impulse_column_map_t *out);

/// Resets the integrals and their history. Called at init and at every gap.
void zygos_impulse_reset(zygos_impulse_t *self);

/// Makes the next instant the origin of an arc. The history of the integrands is kept.
void zygos_impulse_new_arc(zygos_impulse_t *self);

/// Advances the integrals to this instant and writes the rows of the flexible joints. tau_before[N] and tau[N] are the
/// torques that act until the instant and from it on. Returns 1 when the rows belong to an arc, 0 for the three
/// instants after a gap, as the energy row. Cost: the same for every call of a configuration.
int zygos_impulse_row(zygos_impulse_t *self, const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                      const zygos_arm_state_t *state, const zygos_motion_t *motion, const double *tau_before,
                      const double *tau, zygos_impulse_rows_t *out);

/// Writes the expected products of noise in the columns of one row of a flexible joint into out, as lower triangle by
/// rows. The rows are linear in the signals, so that these are the same for every instant and every motion, and N times
/// as large for N accepted instants. imu_sigma is the standard deviation of one sample of the gyro [rad/s]. The noise
/// of integrals is neglected. The noise of a_i . w_(i-1) is computed as if the axes were parallel, which in space is
/// too large by the order of 1/n^2. Needs an initialised smoother.
void zygos_impulse_noise(const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                         const zygos_smoother_t *smoother, double imu_sigma, uint32_t joint, double *out);

#ifdef __cplusplus
}
#endif
#endif
