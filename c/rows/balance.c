/* SPDX-License-Identifier: MIT */
#include "zygos/priv/balance.h"

#include "zygos/priv/numbers.h"
#include "zygos/priv/reduction.h"
#include "zygos/wire.h"

#include <string.h>

/* Without a branch: at i > 0 gcc would see an index too large where the build has one joint. */
static uint32_t has_rotor(const zygos_config_t *config, uint32_t i)
{
    return (uint32_t)(config->joint[i].rigid == 0) | (uint32_t)(i > 0) | (uint32_t)(config->base == ZYGOS_BASE_FREE);
}

static uint32_t columns_of_joint(const zygos_config_t *config, uint32_t i)
{
    return has_rotor(config, i) + ((config->joint[i].rigid == 0) ? 2u : 0u);
}

uint32_t zygos_balance_columns(const zygos_config_t *config)
{
    uint32_t count = zygos_kinetic_parameters(config) + zygos_gravity_parameters(config) + config->effects;
    for (uint32_t i = 0; i < config->joints; i++) {
        count += columns_of_joint(config, i);
    }
    return count;
}

void zygos_balance_column_map(const zygos_config_t *config, zygos_column_map_t *out)
{
    memset(out, 0, sizeof *out);
    out->kinetic = zygos_kinetic_parameters(config);
    out->body = out->kinetic + zygos_gravity_parameters(config);
    uint32_t k = out->body;
    for (uint32_t i = 0; i < config->joints; i++) {
        out->joint[i] = k;
        out->rotor[i] = has_rotor(config, i);
        k += columns_of_joint(config, i);
    }
    out->effects = k;
    out->count = k + config->effects;
    zygos_reduction_places(config, out);
}

void zygos_balance_reset(zygos_balance_t *self)
{
    memset(self, 0, sizeof *self);
    self->origin = 1;
}

void zygos_balance_new_arc(zygos_balance_t *self)
{
    self->origin = 1;
}

/* A product instead of a branch: the work of a cycle does not depend on the place in the ring. */
static uint32_t behind_instant(uint32_t place, const zygos_config_t *config)
{
    return (place + 1u) * (uint32_t)(place != config->smoother_half_width);
}

void zygos_balance_torque(zygos_balance_t *self, const zygos_config_t *config, const double *tau)
{
    for (uint32_t i = 0; i < config->joints; i++) {
        self->torque[0][self->torque_at][i] = tau[i];
        self->torque[1][self->torque_at][i] = tau[i];
    }
    /* The ring holds M + 1 torques, so the place of the next one holds that of M cycles ago. */
    self->torque_at = behind_instant(self->torque_at, config);
}

bool zygos_balance_torque_is_whole(const zygos_balance_t *self, const zygos_config_t *config)
{
    const double *torque = self->torque[0][self->torque_at];
    const double *twin = self->torque[1][self->torque_at];
    double off = 0.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        off += (torque[i] - twin[i]) * (torque[i] - twin[i]);
    }
    return off <= 0.0; /* not where it is not a number */
}

const double *zygos_balance_torque_before(const zygos_balance_t *self)
{
    return self->torque[0][self->torque_at];
}

const double *zygos_balance_torque_after(const zygos_balance_t *self, const zygos_config_t *config)
{
    return self->torque[0][behind_instant(self->torque_at, config)];
}

/* Advances W, D and the effects to this instant. Returns the term of torque steps in the work of the row. variance: see
   zygos_row_t. */
static double advance_integrals(zygos_balance_t *self, const zygos_config_t *config, const zygos_integral_bias_t *bias,
                                const zygos_arm_state_t *state, double *variance)
{
    const double *tau = zygos_balance_torque_before(self);
    const double *tau_next = zygos_balance_torque_after(self, config);
    const double h24 = config->period_s / 24.0;
    double step_work = 0.0;
    double work = 0.0;
    double walk = 0.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        const double ratio = config->joint[i].gear_ratio;
        const double moved = state->theta[i] - self->theta[i];
        const double done = ratio * tau[i] * moved;
        work += done;
        const double least = ratio * ZYGOS_TORQUE_ROUNDING;
        const double sigma = config->joint[i].torque_sigma;
        const double own = zygos_larger(sigma, least) * moved;
        const double share = config->joint[i].torque_relative_sigma * done;
        walk += own * own + share * share;
        step_work += ratio * (tau_next[i] - tau[i]) * state->theta_rate[i];
        self->theta[i] = state->theta[i];
        const double dissipation_rate = state->theta_rate[i] - state->q_rate[i];
        const double g = dissipation_rate * dissipation_rate;
        double *past_0 = &self->dissipation_rate[0][i];
        double *past_1 = &self->dissipation_rate[1][i];
        double *past_2 = &self->dissipation_rate[2][i];
        self->dissipation[i] += h24 * (9.0 * g + 19.0 * *past_0 - 5.0 * *past_1 + *past_2) - bias->dissipation[i];
        *past_2 = *past_1;
        *past_1 = *past_0;
        *past_0 = g;
    }
    self->work += work;
    *variance = walk;
    if (config->effects > 0) {
        zygos_effects_advance(&self->effects, config, state, tau, tau_next, bias->effect);
    }
    return zygos_effects_jump(config) * step_work;
}

static void form_energy_row(const zygos_balance_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map, const zygos_arm_state_t *state,
                            const zygos_motion_t *motion, zygos_row_t *out)
{
    memcpy(out->column, motion->column, column_map->body * sizeof out->column[0]);
    for (uint32_t i = 0; i < config->joints; i++) {
        double *column = &out->column[column_map->joint[i]];
        if (column_map->rotor[i] != 0u) {
            const double rotor = config->joint[i].gear_ratio * state->theta_rate[i];
            *column = rotor * (0.5 * rotor + motion->carrier_rate[i]);
            column++;
        }
        if (config->joint[i].rigid == 0) {
            const double deflection = state->theta[i] - state->q[i];
            column[0] = 0.5 * deflection * deflection;
            column[1] = self->dissipation[i];
        }
    }
    if (config->effects > 0) {
        zygos_effects_columns(&self->effects, config, &out->column[column_map->effects]);
    }
    out->work = self->work;
}

int zygos_balance_row(zygos_balance_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_integral_bias_t *bias, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                      zygos_row_t *out)
{
    double variance = 0.0;
    const double step_work = advance_integrals(self, config, bias, state, &variance);
    self->instants += (self->instants < 4u) ? 1u : 0u;
    if (self->instants < 4u) {
        return 0;
    }
    const double factor = self->origin ? 0.0 : 1.0;
    self->origin = 0;
    self->work *= factor;
    for (uint32_t i = 0; i < config->joints; i++) {
        self->dissipation[i] *= factor;
    }
    if (config->effects > 0) {
        zygos_effects_scale(&self->effects, config, factor);
    }
    form_energy_row(self, config, column_map, state, motion, out);
    out->work += step_work;
    out->variance = factor * variance;
    return 1;
}
