/// zygos/effects.h: columns of the balance for what is no rigid body, rotor, linear spring or damper.
///
/// An effect with coefficient c adds c times its column to the left side of the balance. With the smoothed state of its
/// joint, sat(v) = clamp(v / ZYGOS_COULOMB_FULL_RATE, -1, 1), n the ratio and d = theta - q, the columns are
///
///     ZYGOS_MOTOR_COULOMB      integral of n sat(theta') theta'      work of the friction
///     ZYGOS_MOTOR_VISCOUS      integral of n theta'^2                work of the friction
///     ZYGOS_LINK_COULOMB       integral of sat(q') q'                work of the friction
///     ZYGOS_CUBIC_STIFFNESS    d^4 / 4                               energy of the spring
///     ZYGOS_TORQUE_LAG         sum over j < k of s_j, and s_k / 2    work that torque steps lose by being late,
///                                                                    s_j = n (tau_j - tau_(j-1)) theta'_j
///     ZYGOS_SPRING_OFFSET      d                                     energy of the spring
///
/// tau_j is the torque in force on [t_j, t_(j+1)). Integrals follow the rule of the dissipation (balance.h), and
/// integrals and sums begin with the arc. Of the step at the instant itself a lag T takes half: the smoother sees it
/// while it happens, and what a held torque adds to the row becomes h/2 (1/6 - x + x^2) with x = T / h instead of h/12;
/// the square is left out.

#ifndef ZYGOS_EFFECTS_H
#define ZYGOS_EFFECTS_H

#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Below this rate, after the gear, Coulomb friction fades to zero [rad/s].
#define ZYGOS_COULOMB_FULL_RATE 1e-3

typedef struct {
    double total[ZYGOS_EFFECT_PLACES];   ///< Integral or sum since the arc began.
    double instant[ZYGOS_EFFECT_PLACES]; ///< What belongs to this instant alone.
    double past[3][ZYGOS_EFFECT_PLACES]; ///< Integrand or summand of the three newest instants, newest first.
} zygos_effects_t;

/// sat(rate), without a branch.
double zygos_effects_saturated(double rate);

/// Returns 1, or ZYGOS_E_EFFECT when a configuration, whose joints are checked, asks for effects that it cannot have.
int zygos_effects_check(const zygos_config_t *config);

/// Bit e is set when a negative coefficient of effect e of a checked configuration is not physical.
uint32_t zygos_effects_positive(const zygos_config_t *config);

/// Carries the integrals and sums on to this instant. tau_before[N] and tau[N] are the torques in force until it and
/// from it on; drift, one an effect, is what noise alone adds to an integral in a step. Needs a checked configuration.
/// Cost: the same for every call of a configuration.
void zygos_effects_advance(zygos_effects_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                           const double *tau_before, const double *tau, const double *bias);

/// Multiplies the integrals and sums by keep: 0 at the origin of an arc, else 1.
void zygos_effects_scale(zygos_effects_t *self, const zygos_config_t *config, double factor);

/// Derivatives of the column of effect e in the newest smoothed angle and rate of its motor, and in the angle of its
/// link; torque_step is the change of its torque at the instant. An integral changes with the newest angle by what it
/// integrates over the angle.
void zygos_effects_motor_slopes(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state,
                                double torque_step, double *by_angle, double *by_rate);
double zygos_effects_link_slope(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state);

/// Writes the columns of this instant, one an effect.
void zygos_effects_columns(const zygos_effects_t *self, const zygos_config_t *config, double *column);

#ifdef __cplusplus
}
#endif
#endif
