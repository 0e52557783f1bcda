/* SPDX-License-Identifier: MIT */
#include "zygos/priv/smoother.h"

#include <string.h>

#define BANDWIDTH_SIGMAS 4.0

/* Polynomials orthogonal on the integers -m .. m obey p_k+1 = x p_k - b_k p_k-1. The fit of order r is their truncated
   series, so the coefficient of sample j is the sum over k of p_k(j) p_k(s) / |p_k|^2. x is scaled to -1 .. 1. */
void zygos_smoother_coefficients(uint32_t half_width, uint32_t order, double s, uint32_t derivative, double *out)
{
    const uint32_t n = 2u * half_width + 1u;
    const double m = half_width;
    const double at = s / m;
    double before[ZYGOS_MAX_WINDOW];
    double here[ZYGOS_MAX_WINDOW];
    double norm_before = 1.0;
    double value_before = 0.0;
    double value = 1.0;
    double slope_before = 0.0;
    double slope = 0.0;
    for (uint32_t j = 0; j < n; j++) {
        before[j] = 0.0;
        here[j] = 1.0;
        out[j] = 0.0;
    }
    for (uint32_t k = 0; k <= order; k++) {
        double norm = 0.0;
        for (uint32_t j = 0; j < n; j++) {
            norm += here[j] * here[j];
        }
        const double weight = ((derivative == 0) ? value : slope / m) / norm;
        for (uint32_t j = 0; j < n; j++) {
            out[j] += weight * here[j];
        }
        const double b = (k == 0) ? 0.0 : norm / norm_before;
        for (uint32_t j = 0; j < n; j++) {
            const double x = ((double)j - m) / m;
            const double next = x * here[j] - b * before[j];
            before[j] = here[j];
            here[j] = next;
        }
        const double next_slope = value + at * slope - b * slope_before;
        const double next_value = at * value - b * value_before;
        slope_before = slope;
        slope = next_slope;
        value_before = value;
        value = next_value;
        norm_before = norm;
    }
}

/* Of a joint's encoder, of the link (0) or of the motor (1), with the given latch and noise. */
static void init_taps(zygos_smoother_t *self, const zygos_config_t *config, uint32_t joint, uint32_t side,
                      double latch_s, double sigma)
{
    const uint32_t m = config->smoother_half_width;
    const double s = -latch_s / config->period_s;
    double value[ZYGOS_MAX_WINDOW];
    double slope[ZYGOS_MAX_WINDOW];
    double second[ZYGOS_MAX_WINDOW] = { 0.0 };
    zygos_smoother_coefficients(m, config->smoother_order, s, 0, value);
    zygos_smoother_coefficients(m, config->smoother_order, s, 1, slope);
    zygos_smoother_coefficients(m - 1u, config->smoother_order, s, 1, &second[1]);
    double square = 0.0;
    for (uint32_t j = 0; j < self->window; j++) {
        zygos_taps_t *taps = &self->taps[joint][j];
        taps->value[side] = value[j];
        taps->slope[side] = slope[j] / config->period_s;
        taps->slope_difference[side] = taps->slope[side] - second[j] / config->period_s;
        square += taps->slope_difference[side] * taps->slope_difference[side];
    }
    /* |probe . x| <= limit is tested as a square, which needs no square root. */
    const double bound = BANDWIDTH_SIGMAS * BANDWIDTH_SIGMAS * sigma * sigma * square;
    self->limit[joint][side] = (sigma > 0.0) ? bound : 1e300;
}

void zygos_smoother_init(zygos_smoother_t *self, const zygos_config_t *config)
{
    const uint32_t m = config->smoother_half_width;
    memset(self, 0, sizeof *self);
    self->joints = config->joints;
    self->window = 2u * m + 1u;
    zygos_smoother_coefficients(m, config->smoother_order, -config->imu_latch_s / config->period_s, 0, self->gyro);
    for (uint32_t i = 0; i < config->joints; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        const bool rigid = (joint->rigid != 0);
        const double latch_s = 1e-6 * joint->latch_us;
        const double link_s = rigid ? joint->motor_latch_s : joint->link_latch_s;
        init_taps(self, config, i, 0, link_s + latch_s, rigid ? joint->motor_sigma_rad : joint->link_sigma_rad);
        init_taps(self, config, i, 1, joint->motor_latch_s + latch_s, joint->motor_sigma_rad);
    }
}

void zygos_smoother_reset(zygos_smoother_t *self)
{
    self->filled = 0;
}

void zygos_smoother_variance(const zygos_smoother_t *self, uint32_t signal, double out[3])
{
    const uint32_t n = self->joints;
    memset(out, 0, 3u * sizeof out[0]);
    for (uint32_t j = 0; j < self->window; j++) {
        const bool gyro = (signal >= 2u * n);
        const zygos_taps_t *taps = &self->taps[gyro ? 0u : signal % n][j];
        const double value = gyro ? self->gyro[j] : taps->value[signal / n];
        const double slope = gyro ? 0.0 : taps->slope[signal / n];
        out[0] += value * value;
        out[1] += value * slope;
        out[2] += slope * slope;
    }
}

/* Replaces the oldest sample and its twin. Returns whether they differed. The square of a difference that is too
   small for a square is no harm. */
static bool put_in(zygos_sample_t *restrict sample, zygos_sample_t *restrict twin, uint32_t joints,
                   const double *restrict signal)
{
    double off = 0.0;
    for (uint32_t i = 0; i < joints; i++) {
        const double link = sample->angle[i][0] - twin->angle[i][0];
        const double motor = sample->angle[i][1] - twin->angle[i][1];
        off += link * link + motor * motor;
        sample->angle[i][0] = signal[i];
        twin->angle[i][0] = signal[i];
        sample->angle[i][1] = signal[joints + i];
        twin->angle[i][1] = signal[joints + i];
    }
    for (uint32_t k = 0; k < 3; k++) {
        const double rate = sample->omega[k] - twin->omega[k];
        off += rate * rate;
        sample->omega[k] = signal[2u * joints + k];
        twin->omega[k] = signal[2u * joints + k];
    }
    return !(off <= 0.0); /* also where it is not a number */
}

static void smooth_gyro(const zygos_smoother_t *self, const zygos_sample_t *x, double *omega)
{
    double x_rate = 0.0;
    double y_rate = 0.0;
    double z_rate = 0.0;
    for (const double *c = self->gyro; c < self->gyro + self->window; c++) {
        x_rate += *c * x->omega[0];
        y_rate += *c * x->omega[1];
        z_rate += *c * x->omega[2];
        x++;
    }
    omega[0] = x_rate;
    omega[1] = y_rate;
    omega[2] = z_rate;
}

/* Both angles of a joint: values, rates and squares of the probes. Each sample is read once for all three, and lies
   beside that of the other angle. */
static void smooth_joint(const zygos_taps_t *taps, uint32_t window, const zygos_sample_t *x, uint32_t joint,
                         double out[6])
{
    double value[2] = { 0.0, 0.0 };
    double slope[2] = { 0.0, 0.0 };
    double slope_difference[2] = { 0.0, 0.0 };
    for (const zygos_taps_t *end = taps + window; taps < end; taps++) {
        const double *angle = x->angle[joint];
        value[0] += taps->value[0] * angle[0];
        value[1] += taps->value[1] * angle[1];
        slope[0] += taps->slope[0] * angle[0];
        slope[1] += taps->slope[1] * angle[1];
        slope_difference[0] += taps->slope_difference[0] * angle[0];
        slope_difference[1] += taps->slope_difference[1] * angle[1];
        x++;
    }
    out[0] = value[0];
    out[1] = value[1];
    out[2] = slope[0];
    out[3] = slope[1];
    out[4] = slope_difference[0] * slope_difference[0];
    out[5] = slope_difference[1] * slope_difference[1];
}

int zygos_smoother_push(zygos_smoother_t *self, const double *signal, zygos_arm_state_t *out)
{
    const uint32_t w = self->window;
    const uint32_t at = self->position;
    const bool changed = put_in(&self->sample[at], &self->sample[at + w], self->joints, signal);
    self->position = (at + 1u == w) ? 0u : at + 1u;
    self->filled += (self->filled < w) ? 1u : 0u;
    if (changed || (self->filled < w)) {
        return changed ? -1 : 0;
    }
    const zygos_sample_t *oldest = &self->sample[at + 1u];
    double smooth[ZYGOS_MAX_JOINTS][6];
    for (uint32_t i = 0; i < self->joints; i++) {
        smooth_joint(self->taps[i], w, oldest, i, smooth[i]);
    }
    uint32_t steady = 1u;
    for (uint32_t i = 0; i < self->joints; i++) {
        out->q[i] = smooth[i][0];
        out->theta[i] = smooth[i][1];
        out->q_rate[i] = smooth[i][2];
        out->theta_rate[i] = smooth[i][3];
        steady &= (uint32_t)(smooth[i][4] <= self->limit[i][0]) & (uint32_t)(smooth[i][5] <= self->limit[i][1]);
    }
    smooth_gyro(self, oldest, out->omega);
    out->accepted = (double)steady;
    return 1;
}
