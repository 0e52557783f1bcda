/* SPDX-License-Identifier: MIT */
/// zygos/priv/smoother.h: a Savitzky-Golay filter with a fixed lag, which provides all angles and rates.
///
/// A polynomial is fitted to the 2 M + 1 samples around instant k; its value and slope at k are the smoothed signal and
/// rate. All signals of an instant are computed from the same samples, so that no row mixes raw and smoothed angles.
/// The polynomial of a sensor that latches late is evaluated correspondingly earlier.
///
/// The bandwidth test compares the slope with that of a second fit over 2 M - 1 samples. Where they differ by more than
/// four standard deviations of the declared noise, the motion is faster than the filter can follow.

#ifndef ZYGOS_SMOOTHER_H
#define ZYGOS_SMOOTHER_H

#include "../types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The filter coefficients of one sample of a joint, for q and for theta.
typedef struct {
    double value[2];            ///< Of the smoothed value.
    double slope[2];            ///< Of the rate [1/s].
    double slope_difference[2]; ///< Slope minus the slope of the second fit [1/s].
} zygos_taps_t;

/// The samples of one instant: the base rate about three axes, and q and theta of each joint.
typedef struct {
    double omega[3];
    double reserved;
    double angle[ZYGOS_MAX_JOINTS][2];
} zygos_sample_t;

typedef struct {
    uint32_t joints;                                       ///< N.
    uint32_t window;                                       ///< 2M + 1.
    uint32_t position;                                     ///< Index of the next sample.
    uint32_t filled;                                       ///< Samples since the last gap, at most window.
    zygos_taps_t taps[ZYGOS_MAX_JOINTS][ZYGOS_MAX_WINDOW]; ///< Coefficients, oldest sample first.
    double gyro[ZYGOS_MAX_WINDOW];                         ///< Coefficients of the gyro, value only.
    double limit[ZYGOS_MAX_JOINTS][2];                     ///< Largest allowed squared slope_difference [rad^2/s^2].
    zygos_sample_t sample[2 * ZYGOS_MAX_WINDOW];           ///< Each sample twice, so that a window is contiguous.
} zygos_smoother_t;

/// The smoothed state of the arm at one instant.
typedef struct {
    double q[ZYGOS_MAX_JOINTS];          ///< Link angle [rad].
    double theta[ZYGOS_MAX_JOINTS];      ///< Motor angle [rad].
    double q_rate[ZYGOS_MAX_JOINTS];     ///< [rad/s]
    double theta_rate[ZYGOS_MAX_JOINTS]; ///< [rad/s]
    double omega[3];                     ///< Base rate in base axes [rad/s].
    double accepted;                     ///< 1 when every signal passed the bandwidth test, else 0.
} zygos_arm_state_t;

/// Computes the coefficients and clears the window. Needs a checked configuration; every such configuration has
/// coefficients. Cost: about order * window^2 operations for each signal.
void zygos_smoother_init(zygos_smoother_t *self, const zygos_config_t *config);

/// Clears the window. The coefficients are kept.
void zygos_smoother_reset(zygos_smoother_t *self);

/// Adds the newest sample of each signal. When the window is full, writes the state M cycles ago into *out and returns
/// 1; otherwise returns 0 and does not change *out. Returns -1 instead when the two copies of the oldest sample
/// differ: memory was changed in the last window. Cost: 3 products over the window for each signal of a joint, 1
/// for each axis of the gyro; the same for every call that returns 1.
int zygos_smoother_push(zygos_smoother_t *self, const double *signal, zygos_arm_state_t *out);

/// Computes the covariance of a smoothed signal for noise of variance 1: variance of the value, covariance of value and
/// rate, variance of the rate. The last two are 0 for the gyro. Needs an initialised smoother.
void zygos_smoother_variance(const zygos_smoother_t *self, uint32_t signal, double out[3]);

/// Computes the coefficients, oldest sample first, of the value (derivative = 0) or of the slope per
/// sample interval (derivative = 1) at s samples after the centre, for a polynomial of the given order over 2
/// half_width + 1 samples. Needs 2 half_width >= order.
void zygos_smoother_coefficients(uint32_t half_width, uint32_t order, double s, uint32_t derivative, double *out);

#ifdef __cplusplus
}
#endif
#endif
