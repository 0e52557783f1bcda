/* SPDX-License-Identifier: MIT */
/// zygos/priv/momentum.h: forms rows of the angular momentum of a free-floating arm, one for a planar arm and three in
/// space.
///
///     0 = row_k . parameters + constant of the arc
///
/// No external torque acts on a free-floating arm, so its angular momentum h about the centre of mass is constant; its
/// value need not be known. With the directions rho_a and their rate vectors v_a (kinematics.h), in base axes,
///
///     h = sum_ab N_ab rho_a x v_b + sum_i Im_i n_i theta'_i z_i
///
/// The columns are those of the kinetic parameters, then Im_1 .. Im_N. A planar arm has the component along the axis:
/// (f_i + f_j) cos(phi_j - phi_i) for a_ij, f_i for a_ii, (f_i + f_j) sin(phi_j - phi_i) for b_ij.
///
/// In space the rows are the components along the axes that the base had at the origin of the arc. This attitude is the
/// integral of the smoothed gyro: in one period it rotates by h/24 (9 w_k + 19 w_(k-1) - 5 w_(k-2) + w_(k-3)) + h^2/12
/// w_(k-1) x w_k, where the last term is for an axis that moves. It drifts with the bias of the gyro; therefore the
/// arcs of these rows must be short enough.
///
/// The right-hand side is zero, so that these rows do not determine the scale of the parameters, and alone determine
/// none of them.

#ifndef ZYGOS_MOMENTUM_H
#define ZYGOS_MOMENTUM_H

#include "../types.h"
#include "balance.h"
#include "kinematics.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The largest number of columns of a row.
#define ZYGOS_MAX_MOMENTUM (ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS)

/// The attitude since the origin of the arc.
typedef struct {
    uint32_t instants;  ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;    ///< 1: the next instant opens an arc.
    double attitude[4]; ///< Quaternion from base axes to those at the origin of the arc, x y z w.
    double past[3][3];  ///< Base rate at the three previous instants, newest first [rad/s].
} zygos_momentum_t;

/// Returns the number of rows in each instant: 3 in space, 1 in a plane, 0 for a fixed base. Needs a checked
/// configuration.
uint32_t zygos_momentum_count(const zygos_config_t *config);

/// Resets the attitude and its history. Called at init and at every gap.
void zygos_momentum_reset(zygos_momentum_t *self);

/// Makes the next instant the origin of an arc.
void zygos_momentum_new_arc(zygos_momentum_t *self);

/// Advances the attitude to this instant. Needs a free base. Returns 1 when the instant belongs to an arc, 0 for the
/// three instants after a gap. Cost: the same for every call of a configuration; in space one rotation.
int zygos_momentum_advance(zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state);

/// Writes one row of an instant that belongs to an arc, at most ZYGOS_MAX_MOMENTUM columns. component is 0 ..
/// zygos_momentum_count() - 1. Cost: the same for every call of a configuration; two products of vectors for each
/// kinetic column.
void zygos_momentum_row(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                        const zygos_motion_t *motion, uint32_t component, double *out);

/// Computes the derivative of a row with respect to a rate, from which the noise of the rows follows. Only the noise of
/// the rates is used, because that of the angles and of the attitude is small in comparison. An error of the rate of
/// link j (signal = j) or of the base about axis k (signal = N + k; in a plane N alone) changes the row by out for each
/// rad/s. With the variances of the function below, the expected sum of products of noise in the rows of one instant is
///
///     sum over signals and rows of variance[signal] out outT,     and rotor[i] on the diagonal at Im_i
///
/// Cost: as zygos_momentum_row().
void zygos_momentum_derivative(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                               uint32_t component, uint32_t signal, double *out);

/// Writes the variances of the smoothed rates into variance[N + 3] [rad^2/s^2], and the contribution of the rotors'
/// rates in each instant into rotor[N]. The rate of the rotor of a rigid joint is that of its link and has no
/// contribution of its own. imu_sigma is the standard deviation of one sample of the gyro [rad/s]. Needs an initialised
/// smoother.
void zygos_momentum_variance(const zygos_config_t *config, const zygos_smoother_t *smoother, double imu_sigma,
                             double *variance, double *rotor);

#ifdef __cplusplus
}
#endif
#endif
