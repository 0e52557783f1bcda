/* SPDX-License-Identifier: MIT */
#include "zygos/priv/effects.h"

_Static_assert((uint32_t)ZYGOS_TORQUE_GAIN + 1u == ZYGOS_EFFECT_KINDS, "the last of the kinds");

/* No switch over the kinds has a default, so that the compiler names each one that lacks a kind. */

/* Whether the column is energy of the spring: a state without a history. */
static bool stored(const zygos_effect_config_t *effect)
{
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_SPRING_OFFSET:
        return true;
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_LINK_COULOMB:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        break;
    }
    return false;
}

/* Whether a negative coefficient is as physical as a positive one. */
static bool signed_either_way(const zygos_effect_config_t *effect)
{
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_SPRING_OFFSET:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        return true;
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_LINK_COULOMB:
    case ZYGOS_TORQUE_LAG:
        break;
    }
    return false;
}

static bool known(const zygos_effect_config_t *effect)
{
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_LINK_COULOMB:
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_SPRING_OFFSET:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        return true;
    }
    return false;
}

/* Whether the arm can have an effect, which needs a spring or a declared error where it is of these. */
static bool fits_arm(const zygos_config_t *config, const zygos_effect_config_t *effect)
{
    if (!known(effect) || (effect->joint >= config->joints)) {
        return false;
    }
    const zygos_joint_config_t *joint = &config->joint[effect->joint];
    return (!stored(effect) || (joint->rigid == 0)) &&
           ((effect->kind != ZYGOS_TORQUE_GAIN) || (joint->torque_gain_sigma > 0.0));
}

static bool stands_before(const zygos_config_t *config, uint32_t e)
{
    bool found = false;
    for (uint32_t other = 0; other < e; other++) {
        found = found || ((config->effect[e].kind == config->effect[other].kind) &&
                          (config->effect[e].joint == config->effect[other].joint));
    }
    return found;
}

int zygos_effects_check(const zygos_config_t *config)
{
    if (config->effects > (uint32_t)ZYGOS_MAX_EFFECTS) {
        return ZYGOS_E_EFFECT;
    }
    uint32_t gains = 0;
    for (uint32_t e = 0; e < config->effects; e++) {
        const zygos_effect_config_t *effect = &config->effect[e];
        const bool gain = (effect->kind == ZYGOS_TORQUE_GAIN);
        if (!fits_arm(config, effect) || stands_before(config, e) || ((gains > 0) && !gain)) {
            return ZYGOS_E_EFFECT;
        }
        gains += gain ? 1u : 0u;
    }
    return (gains < config->joints) ? 1 : ZYGOS_E_EFFECT;
}

uint32_t zygos_effects_gains(const zygos_config_t *config)
{
    uint32_t gains = 0;
    for (uint32_t e = 0; e < config->effects; e++) {
        gains += (config->effect[e].kind == ZYGOS_TORQUE_GAIN) ? 1u : 0u;
    }
    return gains;
}

double zygos_effects_reference_sigma(const zygos_config_t *config)
{
    double sigma = 0.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        bool relative = false;
        for (uint32_t e = 0; e < config->effects; e++) {
            relative = relative || ((config->effect[e].kind == ZYGOS_TORQUE_GAIN) && (config->effect[e].joint == i));
        }
        const double own = config->joint[i].torque_gain_sigma;
        sigma = (!relative && (own > sigma)) ? own : sigma;
    }
    return sigma;
}

bool zygos_effects_at_link(const zygos_effect_config_t *effect)
{
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_LINK_COULOMB:
        return true;
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_SPRING_OFFSET:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        break;
    }
    return false;
}

bool zygos_effects_viscous(const zygos_effect_config_t *effect)
{
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_MOTOR_VISCOUS:
        return true;
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_LINK_COULOMB:
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_SPRING_OFFSET:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        break;
    }
    return false;
}

uint32_t zygos_effects_positive(const zygos_config_t *config)
{
    uint32_t bits = 0;
    for (uint32_t e = 0; e < config->effects; e++) {
        bits |= signed_either_way(&config->effect[e]) ? 0u : 1u << e;
    }
    return bits;
}

double zygos_effects_jump(const zygos_config_t *config)
{
    return (config->torque_law == ZYGOS_TORQUE_SAMPLED) ? 0.0 : config->period_s / 12.0;
}

double zygos_effects_saturated(double rate)
{
    const double share = rate / ZYGOS_COULOMB_FULL_RATE;
    return 0.5 * (__builtin_fabs(share + 1.0) - __builtin_fabs(share - 1.0));
}

/* What an effect integrates, adds up or is; of a gain the angle over which the torque works. Only the configuration
   chooses. */
static double newest(const zygos_effect_config_t *effect, double ratio, const zygos_arm_state_t *state,
                     double torque_step)
{
    const double motor = state->theta_rate[effect->joint];
    const double link = state->q_rate[effect->joint];
    const double deflection = state->theta[effect->joint] - state->q[effect->joint];
    switch ((enum zygos_effect_kind)effect->kind) {
    case ZYGOS_MOTOR_COULOMB:
        return ratio * zygos_effects_saturated(motor) * motor;
    case ZYGOS_MOTOR_VISCOUS:
        return ratio * motor * motor;
    case ZYGOS_LINK_COULOMB:
        return zygos_effects_saturated(link) * link;
    case ZYGOS_CUBIC_STIFFNESS:
        return 0.25 * deflection * deflection * deflection * deflection;
    case ZYGOS_SPRING_OFFSET:
        return deflection;
    case ZYGOS_TORQUE_LAG:
        return ratio * torque_step * motor;
    case ZYGOS_TORQUE_OFFSET:
        return ratio * motor;
    case ZYGOS_VISCOUS_ASYMMETRY:
        return ratio * __builtin_fabs(motor) * motor;
    case ZYGOS_TORQUE_GAIN:
        return state->theta[effect->joint];
    }
    return 0.0;
}

void zygos_effects_advance(zygos_effects_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                           const double *tau_before, const double *tau, const double *bias)
{
    const double h24 = config->period_s / 24.0;
    for (uint32_t e = 0; e < config->effects; e++) {
        const zygos_effect_config_t *effect = &config->effect[e];
        const uint32_t i = effect->joint;
        const double g = newest(effect, config->joint[i].gear_ratio, state, tau[i] - tau_before[i]);
        double *past_0 = &self->past[0][e];
        double *past_1 = &self->past[1][e];
        double *past_2 = &self->past[2][e];
        if (stored(effect)) {
            self->instant[e] = g;
        } else if (effect->kind == ZYGOS_TORQUE_LAG) {
            self->total[e] += *past_0;
            self->instant[e] = 0.5 * g;
        } else if (effect->kind == ZYGOS_TORQUE_GAIN) {
            const double ratio = config->joint[i].gear_ratio;
            self->total[e] -= ratio * tau_before[i] * (g - *past_0);
            self->instant[e] = -zygos_effects_jump(config) * ratio * (tau[i] - tau_before[i]) * state->theta_rate[i];
        } else {
            self->total[e] += h24 * (9.0 * g + 19.0 * *past_0 - 5.0 * *past_1 + *past_2) - bias[e];
        }
        *past_2 = *past_1;
        *past_1 = *past_0;
        *past_0 = g;
    }
}

void zygos_effects_scale(zygos_effects_t *self, const zygos_config_t *config, double factor)
{
    for (uint32_t e = 0; e < config->effects; e++) {
        self->total[e] *= factor;
    }
}

static double cube(const zygos_arm_state_t *state, uint32_t joint)
{
    const double deflection = state->theta[joint] - state->q[joint];
    return deflection * deflection * deflection;
}

void zygos_effects_motor_slopes(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state,
                                double tau_before, double tau, double *by_angle, double *by_rate)
{
    const uint32_t i = config->effect[e].joint;
    const double ratio = config->joint[i].gear_ratio;
    *by_angle = 0.0;
    *by_rate = 0.0;
    switch ((enum zygos_effect_kind)config->effect[e].kind) {
    case ZYGOS_MOTOR_COULOMB:
        *by_angle = ratio * zygos_effects_saturated(state->theta_rate[i]);
        break;
    case ZYGOS_MOTOR_VISCOUS:
        *by_angle = 2.0 * ratio * state->theta_rate[i];
        break;
    case ZYGOS_CUBIC_STIFFNESS:
        *by_angle = cube(state, i);
        break;
    case ZYGOS_SPRING_OFFSET:
        *by_angle = 1.0;
        break;
    case ZYGOS_TORQUE_OFFSET:
        *by_angle = ratio;
        break;
    case ZYGOS_VISCOUS_ASYMMETRY:
        *by_angle = 2.0 * ratio * __builtin_fabs(state->theta_rate[i]);
        break;
    case ZYGOS_TORQUE_LAG:
        *by_rate = 0.5 * ratio * (tau - tau_before);
        break;
    case ZYGOS_TORQUE_GAIN:
        *by_angle = -ratio * tau_before;
        *by_rate = -zygos_effects_jump(config) * ratio * (tau - tau_before);
        break;
    case ZYGOS_LINK_COULOMB:
        break;
    }
}

double zygos_effects_link_slope(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state)
{
    const uint32_t i = config->effect[e].joint;
    switch ((enum zygos_effect_kind)config->effect[e].kind) {
    case ZYGOS_LINK_COULOMB:
        return zygos_effects_saturated(state->q_rate[i]);
    case ZYGOS_CUBIC_STIFFNESS:
        return -cube(state, i);
    case ZYGOS_SPRING_OFFSET:
        return -1.0;
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN:
        break;
    }
    return 0.0;
}

void zygos_effects_columns(const zygos_effects_t *self, const zygos_config_t *config, double *column)
{
    for (uint32_t e = 0; e < config->effects; e++) {
        column[e] = self->total[e] + self->instant[e];
    }
}
