/// zygos/momentum.h: rows of the angular momentum of a floating arm, one of a planar arm and three of a spatial one.
///
///     0 = row_k . parameters + constant of the arc
///
/// No torque acts on a floating arm, so its angular momentum h about the mass centre keeps direction and length; what
/// it is need not be known. With the directions rho_a and their rate vectors v_a (kinematics.h), in base axes,
///
///     h = sum_ab N_ab rho_a x v_b + sum_i Im_i n_i theta'_i z_i
///
/// The columns are those of the kinetic parameters, then Im_1 .. Im_N. A planar arm has the component along the axis:
/// (f_i + f_j) cos(phi_j - phi_i) for a_ij, f_i for a_ii, (f_i + f_j) sin(phi_j - phi_i) for b_ij.
///
/// In space the rows are the components along the axes that the base had at the origin of the arc. That attitude is the
/// integral of the smoothed gyro: a step turns by h/24 (9 w_k + 19 w_(k-1) - 5 w_(k-2) + w_(k-3)) + h^2/12 w_(k-1)
/// x w_k, the last term for an axis that moves. It drifts with the gyro's bias, so these rows want arcs short enough.
///
/// The right-hand side is zero, so these rows know no scale: alone they determine nothing.

#ifndef ZYGOS_MOMENTUM_H
#define ZYGOS_MOMENTUM_H

#include "balance.h"
#include "kinematics.h"
#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ZYGOS_MAX_MOMENTUM (ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS)

typedef struct {
    uint32_t instants;  ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;    ///< 1: the next instant opens an arc.
    double attitude[4]; ///< Quaternion from base axes to those of the arc's origin, x y z w.
    double past[3][3];  ///< Base rate of the three instants before, newest first [rad/s].
} zygos_momentum_t;

/// Number of rows an instant: 3 in space, 1 in a plane, 0 on a fixed base. Needs a checked configuration.
uint32_t zygos_momentum_count(const zygos_config_t *config);

/// Forgets all that was. Used at init and at every gap.
void zygos_momentum_reset(zygos_momentum_t *self);

/// Makes the next instant the origin of an arc.
void zygos_momentum_new_arc(zygos_momentum_t *self);

/// Carries the attitude on to this instant. Needs a floating base. Returns 1 when the instant belongs to an arc, 0
/// during three instants after a gap. Cost: the same for every call of a configuration; in space one rotation.
int zygos_momentum_advance(zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state);

/// Writes one of the rows of an instant that belongs to an arc, at the most ZYGOS_MAX_MOMENTUM columns; component is
/// 0 .. zygos_momentum_count() - 1. Cost: the same for every call of a configuration; two products of vectors for each
/// of the kinetic columns.
void zygos_momentum_row(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                        const zygos_motion_t *motion, uint32_t component, double *out);

/// Noise of the rows. It is taken from the rates alone, next to whose noise that of the angles and of the attitude is
/// small. An error of the rate of link j (signal = j) or of the base about axis k (signal = N + k; in a plane N alone)
/// changes the row by out for each rad/s. With the variances of below, rows of one instant owe
///
///     sum over signals and rows of variance[signal] out outT      and rotor[i] to the diagonal at Im_i
///
/// to the sum of their products. Cost: as zygos_momentum_row().
void zygos_momentum_derivative(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                               uint32_t component, uint32_t signal, double *out);

/// variance[N + 3] of the smoothed rates [rad^2/s^2], and rotor[N], what the rotors' rates owe at each instant. The
/// rate of a rigid joint's rotor is that of its link, and it owes nothing of its own. imu_sigma is the standard
/// deviation of one sample of the gyro [rad/s]. Needs an initialised smoother.
void zygos_momentum_variance(const zygos_config_t *config, const zygos_smoother_t *smoother, double imu_sigma,
                             double *variance, double *rotor);

#ifdef __cplusplus
}
#endif
#endif
