/* SPDX-License-Identifier: MIT */
/// zygos/priv/effects.h: columns of the balance for effects beyond rigid bodies, rotors, linear springs and dampers.
///
/// An effect with coefficient c adds c times its column to the left side of the balance. With the smoothed state of its
/// joint, sat(v) = clamp(v / ZYGOS_COULOMB_FULL_RATE, -1, 1), the gear ratio n and d = theta - q, the columns are
///
///     ZYGOS_MOTOR_COULOMB      integral of n sat(theta') theta'      work of the friction
///     ZYGOS_MOTOR_VISCOUS      integral of n theta'^2                work of the friction
///     ZYGOS_LINK_COULOMB       integral of sat(q') q'                work of the friction
///     ZYGOS_CUBIC_STIFFNESS    d^4 / 4                               energy of the spring
///     ZYGOS_TORQUE_LAG         sum over j < k of s_j, and s_k / 2    work that torque steps lose by the delay,
///                                                                    s_j = n (tau_j - tau_(j-1)) theta'_j
///     ZYGOS_SPRING_OFFSET      d                                     energy of the spring
///     ZYGOS_TORQUE_OFFSET      integral of n theta'                  work that the reported torque has too much
///     ZYGOS_VISCOUS_ASYMMETRY  integral of n |theta'| theta'         work of the friction
///     ZYGOS_TORQUE_GAIN        -W of the joint, with its term h/12   work that the reported torque lacks (balance.h)
///
/// tau_j is the torque that acts on [t_j, t_(j+1)). The integrals are computed by the rule of the dissipation
/// (balance.h); integrals and sums begin with the arc. The torque step at the instant itself counts by half, because it
/// is in the middle of the smoother's window: with x = T / h for a lag T, the term h/12 of a held torque becomes h/2
/// (1/6 - x + x^2), of which the square is neglected.

#ifndef ZYGOS_EFFECTS_H
#define ZYGOS_EFFECTS_H

#include "../types.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Below this rate, after the gear, Coulomb friction decreases linearly to zero [rad/s].
#define ZYGOS_COULOMB_FULL_RATE 1e-3

/// The state of the integrals and sums.
typedef struct {
    double total[ZYGOS_EFFECT_PLACES];   ///< Integral or sum since the arc began.
    double instant[ZYGOS_EFFECT_PLACES]; ///< The part of the column that belongs to this instant alone.
    double past[3][ZYGOS_EFFECT_PLACES]; ///< Integrand or summand at the three newest instants, newest first; of a gain
                                         ///< the angle.
} zygos_effects_t;

/// Returns h/12 where a torque is held between SYNCs, else 0 [s]: see balance.h.
double zygos_effects_jump(const zygos_config_t *config);

/// Returns sat(rate), computed without a branch.
double zygos_effects_saturated(double rate);

/// Checks the effects of a configuration whose joints are checked. Returns 1 or ZYGOS_E_EFFECT.
int zygos_effects_check(const zygos_config_t *config);

/// Returns the number of gains, which are the last effects. Needs a checked configuration.
uint32_t zygos_effects_gains(const zygos_config_t *config);

/// Returns the standard deviation of the gain that all others are relative to: that of the joints without one of their
/// own. Needs a checked configuration.
double zygos_effects_reference_sigma(const zygos_config_t *config);

/// Returns whether the effect acts between a link and the body that carries it, and so on no rotor. Needs a checked
/// effect.
bool zygos_effects_at_link(const zygos_effect_config_t *effect);

/// Returns whether the torque of the effect is proportional to a rate, so that noise biases its integral. Needs a
/// checked effect.
bool zygos_effects_viscous(const zygos_effect_config_t *effect);

/// Returns a bit mask: bit e is set when a negative coefficient of effect e is not physical. Needs a checked
/// configuration.
uint32_t zygos_effects_positive(const zygos_config_t *config);

/// Advances the integrals and sums to this instant. tau_before[N] and tau[N] are the torques that act until it and from
/// it on. bias is the bias of each effect's integral by noise in one period. Needs a checked configuration.
/// Cost: the same for every call of a configuration.
void zygos_effects_advance(zygos_effects_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                           const double *tau_before, const double *tau, const double *bias);

/// Multiplies the integrals and sums by a factor: 0 at the origin of an arc, else 1.
void zygos_effects_scale(zygos_effects_t *self, const zygos_config_t *config, double factor);

/// Return the derivatives of the column of effect e with respect to the newest smoothed angle and rate of its motor,
/// and to the angle of its link. tau_before and tau are its torques until the instant and from it on. The derivative of
/// an integral with respect to the newest angle is its integrand over the angle.
void zygos_effects_motor_slopes(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state,
                                double tau_before, double tau, double *by_angle, double *by_rate);
double zygos_effects_link_slope(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state);

/// Writes the columns of this instant, one for each effect.
void zygos_effects_columns(const zygos_effects_t *self, const zygos_config_t *config, double *column);

#ifdef __cplusplus
}
#endif
#endif
