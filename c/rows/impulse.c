/* SPDX-License-Identifier: MIT */
#include "zygos/priv/impulse.h"

#include <string.h>

void zygos_impulse_column_map(const zygos_config_t *config, zygos_impulse_column_map_t *out)
{
    memset(out, 0, sizeof *out);
    for (uint32_t i = 0; i < config->joints; i++) {
        out->count[i] = (config->joint[i].rigid == 0) ? 3u : 0u;
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        const uint32_t i = config->effect[e].joint;
        if (!zygos_effects_at_link(&config->effect[e]) && (out->count[i] > 0)) {
            out->effect[i][out->count[i] - 3u] = e;
            out->count[i]++;
        }
    }
}

void zygos_impulse_reset(zygos_impulse_t *self)
{
    memset(self, 0, sizeof *self);
    self->origin = 1;
}

void zygos_impulse_new_arc(zygos_impulse_t *self)
{
    self->origin = 1;
}

/* The integral over the newest step of the cubic through g and the three values before, which move up. */
static double step_integral(double h24, double g, double *past_0, double *past_1, double *past_2)
{
    const double step = h24 * (9.0 * g + 19.0 * *past_0 - 5.0 * *past_1 + *past_2);
    *past_2 = *past_1;
    *past_1 = *past_0;
    *past_0 = g;
    return step;
}

/* The column of an effect: *integrand is what it integrates, and the value what belongs to the instant alone. Only the
 * configuration chooses. */
static double effect_column(uint32_t kind, double ratio, double theta, double theta_rate, double deflection,
                            double tau_mean, double impulse, double *integrand)
{
    *integrand = 0.0;
    switch ((enum zygos_effect_kind)kind) {
    case ZYGOS_MOTOR_COULOMB:
        *integrand = ratio * zygos_effects_saturated(theta_rate);
        return 0.0;
    case ZYGOS_MOTOR_VISCOUS:
        return ratio * theta;
    case ZYGOS_CUBIC_STIFFNESS:
        *integrand = deflection * deflection * deflection;
        return 0.0;
    case ZYGOS_SPRING_OFFSET:
        *integrand = 1.0;
        return 0.0;
    case ZYGOS_TORQUE_OFFSET:
        *integrand = ratio;
        return 0.0;
    case ZYGOS_VISCOUS_ASYMMETRY:
        *integrand = ratio * __builtin_fabs(theta_rate);
        return 0.0;
    case ZYGOS_TORQUE_LAG:
        return ratio * tau_mean;
    case ZYGOS_TORQUE_GAIN:
        return -impulse;
    case ZYGOS_LINK_COULOMB: /* acts on no rotor, and has no column here */
        break;
    }
    return 0.0;
}

int zygos_impulse_row(zygos_impulse_t *self, const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                      const zygos_arm_state_t *state, const zygos_motion_t *motion, const double *tau_before,
                      const double *tau, zygos_impulse_rows_t *out)
{
    const double h = config->period_s;
    const double h24 = h / 24.0;
    const double h12 = zygos_effects_jump(config);
    self->instants += (self->instants < 4u) ? 1u : 0u;
    const double factor = self->origin ? 0.0 : 1.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        if (column_map->count[i] == 0) {
            continue;
        }
        const double ratio = config->joint[i].gear_ratio;
        const double deflection = state->theta[i] - state->q[i];
        double *column = out->column[i];
        self->impulse[i] = factor * (self->impulse[i] + ratio * h * tau_before[i]);
        self->deflection_integral[i] =
            factor * (self->deflection_integral[i] +
                      step_integral(h24, deflection, &self->past[0][i], &self->past[1][i], &self->past[2][i]));
        column[0] = ratio * (ratio * state->theta_rate[i] + motion->carrier_rate[i]);
        column[1] = self->deflection_integral[i];
        column[2] = deflection;
        out->impulse[i] = self->impulse[i] + ratio * h12 * (tau[i] - tau_before[i]);
        for (uint32_t c = 3; c < column_map->count[i]; c++) {
            const uint32_t e = column_map->effect[i][c - 3u];
            double integrand;
            const double value = effect_column(config->effect[e].kind, ratio, state->theta[i], state->theta_rate[i],
                                               deflection, 0.5 * (tau_before[i] + tau[i]), out->impulse[i], &integrand);
            self->total[e] = factor * (self->total[e] + step_integral(h24, integrand, &self->before[0][e],
                                                                      &self->before[1][e], &self->before[2][e]));
            column[c] = self->total[e] + value;
        }
    }
    if (self->instants < 4u) {
        return 0;
    }
    self->origin = 0;
    return 1;
}

void zygos_impulse_noise(const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                         const zygos_smoother_t *smoother, double imu_sigma, uint32_t joint, double *out)
{
    const uint32_t n = config->joints;
    double link[3];
    double motor[3];
    zygos_smoother_variance(smoother, joint, link);
    zygos_smoother_variance(smoother, n + joint, motor);
    /* Of one sample: the link encoder, the motor encoder. */
    const double link_variance = config->joint[joint].link_sigma_rad * config->joint[joint].link_sigma_rad;
    const double motor_variance = config->joint[joint].motor_sigma_rad * config->joint[joint].motor_sigma_rad;
    double carrier = 0.0;
    if (config->base == ZYGOS_BASE_FREE) {
        double gyro[3];
        zygos_smoother_variance(smoother, 2u * n, gyro);
        carrier = imu_sigma * imu_sigma * gyro[0];
    }
    for (uint32_t j = 0; j < joint; j++) {
        const double sigma =
            config->joint[j].rigid ? config->joint[j].motor_sigma_rad : config->joint[j].link_sigma_rad;
        double before[3];
        zygos_smoother_variance(smoother, j, before);
        carrier += sigma * sigma * before[2];
    }
    const double ratio = config->joint[joint].gear_ratio;
    const double value = motor_variance * motor[0];
    const double rate = motor_variance * motor[2];
    const double both = motor_variance * motor[1];
    /* How each column depends on the motor's rate and value; the others' noise is in it alone. */
    for (uint32_t a = 0; a < column_map->count[joint]; a++) {
        for (uint32_t b = 0; b <= a; b++) {
            double by_rate[2] = { 0.0, 0.0 };
            double by_value[2] = { 0.0, 0.0 };
            const uint32_t at[2] = { a, b };
            for (uint32_t k = 0; k < 2; k++) {
                const bool viscous =
                    (at[k] > 2u) && zygos_effects_viscous(&config->effect[column_map->effect[joint][at[k] - 3u]]);
                by_rate[k] = (at[k] == 0) ? ratio * ratio : 0.0;
                by_value[k] = (at[k] == 2u) ? 1.0 : (viscous ? ratio : 0.0);
            }
            double sum = by_rate[0] * by_rate[1] * rate + by_value[0] * by_value[1] * value +
                         (by_rate[0] * by_value[1] + by_value[0] * by_rate[1]) * both;
            sum += ((a == 0) && (b == 0)) ? ratio * ratio * carrier : 0.0;
            sum += ((a == 2u) && (b == 2u)) ? link_variance * link[0] : 0.0;
            *out = sum;
            out++;
        }
    }
}
