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
        zygos_smoother_coefficients(m, config->smoother_order, s, 0, self->value[i]);
        if (gyro) {
            continue;
        }
        double second[ZYGOS_MAX_WINDOW] = { 0.0 };
        zygos_smoother_coefficients(m, config->smoother_order, s, 1, self->slope[i]);
        zygos_smoother_coefficients(m - 1u, config->smoother_order, s, 1, &second[1]);
        double square = 0.0;
        for (uint32_t j = 0; j < self->window; j++) {
            self->slope[i][j] /= config->period_s;
            self->probe[i][j] = self->slope[i][j] - second[j] / config->period_s;
            square += self->probe[i][j] * self->probe[i][j];
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

static double product(const double *a, const double *b, uint32_t n)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum;
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
    for (uint32_t i = 0; i < self->signals; i++) {
        const double *x = &self->sample[i][at + 1u];
        const double value = product(self->value[i], x, w);
        if (i >= 2u * n) {
            out->omega[i - 2u * n] = value;
            continue;
        }
        const double rate = product(self->slope[i], x, w);
        const double probe = product(self->probe[i], x, w);
        steady &= (uint32_t)(probe * probe <= self->limit[i]);
        if (i < n) {
            out->q[i] = value;
            out->q_rate[i] = rate;
        } else {
            out->theta[i - n] = value;
            out->theta_rate[i - n] = rate;
        }
    }
    out->accepted = (double)steady;
    return 1;
}
