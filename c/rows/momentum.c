/* SPDX-License-Identifier: MIT */
#include "zygos/priv/momentum.h"

#include "zygos/priv/numbers.h"

#include <string.h>

uint32_t zygos_momentum_count(const zygos_config_t *config)
{
    if (config->base != ZYGOS_BASE_FREE) {
        return 0;
    }
    return (config->kinetic == ZYGOS_SPATIAL_ARM) ? 3u : 1u;
}

void zygos_momentum_reset(zygos_momentum_t *self)
{
    memset(self, 0, sizeof *self);
    self->origin = 1;
}

void zygos_momentum_new_arc(zygos_momentum_t *self)
{
    self->origin = 1;
}

/* Turns the attitude by one step of the base rate; at the origin of an arc it is that of the base. */
static void rotate_attitude(zygos_momentum_t *self, double h, const double *omega, double factor)
{
    double angle[3];
    zygos_cross3(self->past[0], omega, angle);
    double half_square = 0.0;
    for (uint32_t k = 0; k < 3; k++) {
        const double mean = 9.0 * omega[k] + 19.0 * self->past[0][k] - 5.0 * self->past[1][k] + self->past[2][k];
        angle[k] = h / 24.0 * mean + h * h / 12.0 * angle[k];
        half_square += 0.25 * angle[k] * angle[k];
        self->past[2][k] = self->past[1][k];
        self->past[1][k] = self->past[0][k];
        self->past[0][k] = omega[k];
    }
    /* cos x and sin x / x of half the angle x, by their series: of use up to a radian a step. */
    const double z = half_square;
    const double c = 1.0 + z * (-1.0 / 2.0 + z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z / 40320.0)));
    const double s = 0.5 * (1.0 + z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z / 362880.0))));
    const double v[3] = { s * angle[0], s * angle[1], s * angle[2] };
    const double *p = self->attitude;
    double around[3];
    zygos_cross3(p, v, around);
    double turned[4] = { 0.0, 0.0, 0.0, p[3] * c - p[0] * v[0] - p[1] * v[1] - p[2] * v[2] };
    double square = turned[3] * turned[3];
    for (uint32_t k = 0; k < 3; k++) {
        turned[k] = p[3] * v[k] + c * p[k] + around[k];
        square += turned[k] * turned[k];
    }
    /* Where there is no attitude yet, 1 stands in for its length. */
    const double scale = factor / __builtin_sqrt(square + (1.0 - factor));
    for (uint32_t k = 0; k < 4; k++) {
        self->attitude[k] = scale * turned[k];
    }
    self->attitude[3] += 1.0 - factor;
}

int zygos_momentum_advance(zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state)
{
    self->instants += (self->instants < 4u) ? 1u : 0u;
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        rotate_attitude(self, config->period_s, state->omega, self->origin ? 0.0 : 1.0);
    }
    if (self->instants < 4u) {
        return 0;
    }
    self->origin = 0;
    return 1;
}

/* Axis k of the arc's origin, in base axes. */
static void origin_axis(const zygos_momentum_t *self, uint32_t k, double *out)
{
    double once[3];
    double twice[3];
    double axis[3] = { 0.0, 0.0, 0.0 };
    axis[k] = 1.0;
    zygos_cross3(axis, self->attitude, once);
    zygos_cross3(once, self->attitude, twice);
    for (uint32_t j = 0; j < 3; j++) {
        out[j] = axis[j] + 2.0 * (self->attitude[3] * once[j] + twice[j]);
    }
}

/* The momentum along an axis is what the energy changes by when all turns faster about it. */
static void columns(const zygos_config_t *config, const zygos_motion_t *motion, const double *axis,
                    const double (*rate)[3], const double *spin, double *out)
{
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t kinetic = zygos_kinetic_parameters(config);
    double whole[ZYGOS_MAX_DIRECTIONS][3];
    zygos_kinematics_swing(config, motion, axis, 0, whole);
    memset(out, 0, kinetic * sizeof out[0]);
    (void)zygos_kinetic_products(config, (const double(*)[3])whole, rate, out);
    (void)zygos_kinetic_products(config, rate, (const double(*)[3])whole, out);
    for (uint32_t i = 0; i < config->joints; i++) {
        const double *z = motion->axis[i];
        const double along = space ? zygos_dot3(axis, z) : 1.0;
        out[kinetic + i] = config->joint[i].gear_ratio * spin[i] * along;
    }
}

void zygos_momentum_row(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                        const zygos_motion_t *motion, uint32_t component, double *out)
{
    double axis[3];
    origin_axis(self, component, axis);
    columns(config, motion, axis, motion->rate, state->theta_rate, out);
}

void zygos_momentum_derivative(const zygos_momentum_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                               uint32_t component, uint32_t signal, double *out)
{
    const uint32_t n = config->joints;
    const bool of_link = (signal < n);
    double rate[ZYGOS_MAX_DIRECTIONS][3];
    double spin[ZYGOS_MAX_JOINTS] = { 0.0 };
    double axis[3];
    double about[3] = { 0.0, 0.0, 0.0 };
    if (of_link) {
        memcpy(about, motion->axis[signal], sizeof about);
        spin[signal] = config->joint[signal].rigid ? 1.0 : 0.0;
    } else {
        about[signal - n] = 1.0;
    }
    origin_axis(self, component, axis);
    zygos_kinematics_swing(config, motion, about, of_link ? signal + 1u : 0u, rate);
    columns(config, motion, axis, (const double(*)[3])rate, spin, out);
}

void zygos_momentum_variance(const zygos_config_t *config, const zygos_smoother_t *smoother, double imu_sigma,
                             double *variance, double *rotor)
{
    const uint32_t n = config->joints;
    for (uint32_t i = 0; i < n; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        const double sigma = joint->rigid ? joint->motor_sigma_rad : joint->link_sigma_rad;
        const double spin = joint->gear_ratio * joint->motor_sigma_rad;
        double link[3];
        double motor[3];
        zygos_smoother_variance(smoother, i, link);
        zygos_smoother_variance(smoother, n + i, motor);
        variance[i] = sigma * sigma * link[2];
        rotor[i] = joint->rigid ? 0.0 : spin * spin * motor[2];
    }
    for (uint32_t k = 0; k < 3; k++) {
        double gyro[3];
        zygos_smoother_variance(smoother, 2u * n + k, gyro);
        variance[n + k] = imu_sigma * imu_sigma * gyro[0];
    }
}
