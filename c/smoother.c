#include "zygos/smoother.h"

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

void zygos_smoother_init(zygos_smoother_t *self, const zygos_config_t *config)
{
    const uint32_t n = config->joints;
    const uint32_t m = config->smoother_half_width;
    memset(self, 0, sizeof *self);
    self->signals = 2u * n + 3u;
    self->joint_signals = 2u * n;
    self->window = 2u * m + 1u;
    for (uint32_t i = 0; i < self->signals; i++) {
        const bool gyro = (i >= 2u * n);
        const zygos_joint_config_t *joint = &config->joint[gyro ? 0u : i % n];
        const bool link = (i < n) && (joint->rigid == 0);
        const double own_s = link ? joint->link_latch_s : joint->motor_latch_s;
        const double latch_s = gyro ? config->imu_latch_s : own_s + 1e-6 * joint->latch_us;
        const double s = -latch_s / config->period_s;
        double value[ZYGOS_MAX_WINDOW];
        double slope[ZYGOS_MAX_WINDOW];
        double second[ZYGOS_MAX_WINDOW] = { 0.0 };
        zygos_smoother_coefficients(m, config->smoother_order, s, 0, value);
        zygos_smoother_coefficients(m, config->smoother_order, s, 1, slope);
        zygos_smoother_coefficients(m - 1u, config->smoother_order, s, 1, &second[1]);
        double square = 0.0;
        for (uint32_t j = 0; j < self->window; j++) {
            zygos_taps_t *taps = &self->taps[i][j / 2u];
            taps->value[j % 2u] = value[j];
            if (!gyro) {
                const double probe = slope[j] / config->period_s - second[j] / config->period_s;
                taps->slope[j % 2u] = slope[j] / config->period_s;
                taps->probe[j % 2u] = probe;
                square += probe * probe;
            }
        }
        if (gyro) {
            continue;
        }
        /* |probe . x| <= limit is tested as a square, which needs no square root. */
        const double sigma = link ? joint->link_sigma_rad : joint->motor_sigma_rad;
        const double bound = BANDWIDTH_SIGMAS * BANDWIDTH_SIGMAS * sigma * sigma * square;
        self->limit[i] = (sigma > 0.0) ? bound : 1e300;
    }
}

void zygos_smoother_gap(zygos_smoother_t *self)
{
    self->filled = 0;
}

void zygos_smoother_variance(const zygos_smoother_t *self, uint32_t signal, double out[3])
{
    memset(out, 0, 3u * sizeof out[0]);
    for (uint32_t j = 0; j < self->window; j++) {
        const double value = self->taps[signal][j / 2u].value[j % 2u];
        const double slope = self->taps[signal][j / 2u].slope[j % 2u];
        out[0] += value * value;
        out[1] += value * slope;
        out[2] += slope * slope;
    }
}

/* Value of a signal of the gyro at the middle of the window that begins at x. */
static double value_of(const zygos_taps_t *taps, const double *x, uint32_t window)
{
    double value[2] = { 0.0, 0.0 };
    for (const double *end = x + window; x < end; x += 2) {
        value[1] += taps->value[1] * x[1];
        value[0] += taps->value[0] * x[0];
        taps++;
    }
    return value[0] + value[1];
}

/* Value, rate and probe of a joint's signal: two samples at a time, each read once for all three. */
static void polynomial(const zygos_taps_t *taps, const double *x, uint32_t window, double out[3])
{
    double value[2] = { 0.0, 0.0 };
    double slope[2] = { 0.0, 0.0 };
    double probe[2] = { 0.0, 0.0 };
    for (const double *end = x + window; x < end; x += 2) {
        value[1] += taps->value[1] * x[1];
        value[0] += taps->value[0] * x[0];
        slope[1] += taps->slope[1] * x[1];
        slope[0] += taps->slope[0] * x[0];
        probe[1] += taps->probe[1] * x[1];
        probe[0] += taps->probe[0] * x[0];
        taps++;
    }
    out[0] = value[0] + value[1];
    out[1] = slope[0] + slope[1];
    out[2] = probe[0] + probe[1];
}

int zygos_smoother_push(zygos_smoother_t *self, const double *signal, zygos_state_t *out)
{
    const uint32_t w = self->window;
    const uint32_t at = self->position;
    for (uint32_t i = 0; i < self->signals; i++) {
        self->sample[i][at] = signal[i];
        self->sample[i][at + w] = signal[i];
    }
    self->position = (at + 1u == w) ? 0u : at + 1u;
    self->filled += (self->filled < w) ? 1u : 0u;
    if (self->filled < w) {
        return 0;
    }
    const uint32_t n = self->joint_signals / 2u;
    uint32_t steady = 1u;
    for (uint32_t i = 0; i < 2u * n; i++) {
        double smooth[3];
        polynomial(self->taps[i], &self->sample[i][at + 1u], w, smooth);
        steady &= (uint32_t)(smooth[2] * smooth[2] <= self->limit[i]);
        double *value = (i < n) ? &out->q[i] : &out->theta[i - n];
        double *rate = (i < n) ? &out->q_rate[i] : &out->theta_rate[i - n];
        *value = smooth[0];
        *rate = smooth[1];
    }
    for (uint32_t k = 0; k < 3; k++) {
        out->omega[k] = value_of(self->taps[2u * n + k], &self->sample[2u * n + k][at + 1u], w);
    }
    out->accepted = (double)steady;
    return 1;
}
