/// zygos/smoother.h: a fixed-lag Savitzky-Golay filter, the only source of angles and rates.
///
/// A polynomial is fitted to the 2 M + 1 samples around instant k; its value and its slope there are the smoothed
/// signal and rate. All signals of an instant come from the same samples, so no row mixes a raw and a smoothed angle. A
/// sensor that latches late is evaluated earlier on its own polynomial.
///
/// The bandwidth test compares the slope with that of a second fit, over 2 M - 1 samples. Where they differ by more
/// than four standard deviations of the declared noise, the motion is faster than the filter can follow.

#ifndef ZYGOS_SMOOTHER_H
#define ZYGOS_SMOOTHER_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Coefficients of one sample of a joint: of q, of theta.
typedef struct {
    double value[2];
    double slope[2];            ///< Of the rate [1/s].
    double slope_difference[2]; ///< Slope minus the second slope [1/s].
} zygos_taps_t;

/// Samples of one instant: the base rate about three axes, then q and theta of each joint.
typedef struct {
    double omega[3];
    double reserved;
    double angle[ZYGOS_MAX_JOINTS][2];
} zygos_sample_t;

typedef struct {
    uint32_t joints;                                       ///< N.
    uint32_t window;                                       ///< 2M + 1.
    uint32_t position;                                     ///< Where the next sample goes.
    uint32_t filled;                                       ///< Samples since the last gap, at most window.
    zygos_taps_t taps[ZYGOS_MAX_JOINTS][ZYGOS_MAX_WINDOW]; ///< Oldest sample first.
    double gyro[ZYGOS_MAX_WINDOW];                         ///< The same of the gyro, which has a value only.
    double limit[ZYGOS_MAX_JOINTS][2];                     ///< Largest allowed square of the probe [rad^2/s^2].
    zygos_sample_t sample[2 * ZYGOS_MAX_WINDOW];           ///< Each twice, so that a window is contiguous.
} zygos_smoother_t;

/// The arm at one instant.
typedef struct {
    double q[ZYGOS_MAX_JOINTS];          ///< Link angle [rad].
    double theta[ZYGOS_MAX_JOINTS];      ///< Motor angle [rad].
    double q_rate[ZYGOS_MAX_JOINTS];     ///< [rad/s]
    double theta_rate[ZYGOS_MAX_JOINTS]; ///< [rad/s]
    double omega[3];                     ///< Base rate, base axes [rad/s].
    double accepted;                     ///< 1 when every signal passed the bandwidth test, else 0.
} zygos_arm_state_t;

/// Computes the coefficients and empties the window. Needs a checked configuration. Cost: about order * window^2
/// operations a signal; no library function. Returns nothing: every checked configuration has coefficients.
void zygos_smoother_init(zygos_smoother_t *self, const zygos_config_t *config);

/// Empties the window; the coefficients stay.
void zygos_smoother_reset(zygos_smoother_t *self);

/// Puts in the newest sample of each signal. When the window is full, writes the state M cycles ago into *out and
/// returns 1; else returns 0 and leaves *out as it was. Cost: 3 window products a joint signal, 1 a gyro axis; the same
/// for every call that returns 1.
int zygos_smoother_push(zygos_smoother_t *self, const double *signal, zygos_arm_state_t *out);

/// What noise of variance 1 makes of a signal: variance of the value, covariance of value and rate, variance of the
/// rate, which is 0 of the gyro. Needs an initialised smoother.
void zygos_smoother_variance(const zygos_smoother_t *self, uint32_t signal, double out[3]);

/// The coefficients of the derivative-th derivative (0 or 1, in samples) at s samples after the centre, for a
/// polynomial of the given order over 2 half_width + 1 samples, oldest first. Needs 2 half_width >= order.
void zygos_smoother_coefficients(uint32_t half_width, uint32_t order, double s, uint32_t derivative, double *out);

#ifdef __cplusplus
}
#endif
#endif
