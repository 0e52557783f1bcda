/* SPDX-License-Identifier: MIT */
/// zygos/priv/noise.h: the bias of the normal equations by the noise of the sensors.
///
/// A row is computed from noisy angles and rates, and products of rows contain the square of that noise: it biases
/// every estimate towards zero, and more data do not help. The noise of a smoothed signal is known, however: it is the
/// declared standard deviation of the sensor times the coefficients of the smoother. With the signals x + e, the
/// covariance S of e and the derivative J of the augmented row [columns, work] with respect to x,
///
///     E column = true column + 1/2 sum_s S_ss d2(column)/dx_s^2        subtracted from the row
///     E [row]^T [row] = true square + J S J^T                          subtracted from the sums of the rows
///
/// The first is subtracted where it does not vanish with the constant of the arc: from the kinetic columns, which are
/// quadratic in the rates, and from the dissipation, which increases by (S_q' + S_theta') h in each period. For the
/// work and the dissipation only the part that is correlated with the signals of the instant is used: n tau on theta,
/// and 2 (theta' - q') on theta - q. Terms with the square of S are neglected; they are smaller by the square of noise
/// over signal.
///
/// The sensors are independent of each other. The value and the rate of one signal are correlated where it latches
/// late.

#ifndef ZYGOS_NOISE_H
#define ZYGOS_NOISE_H

#include "../types.h"
#include "balance.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A gyro is regarded as exact when its variance is below this share of the variance of every link's rate.
#define ZYGOS_GYRO_SHARE 1e-4

/// The number of indices in a list of columns, rounded up so that a list is a whole number of words of eight bytes.
#define ZYGOS_LIST_WORDS ((ZYGOS_MAX_COLUMNS + 2 + 7) / 8)

/// The columns that contain the noise of one sensor, in ascending order. They are places in memory that is written to,
/// and are therefore verified each time before they are used.
typedef struct {
    uint64_t seal;                           ///< Exclusive or of the words of the other members.
    uint8_t place[8 * ZYGOS_LIST_WORDS - 1]; ///< Their indices, and 0 behind them.
    uint8_t count;                           ///< Number of columns.
} zygos_column_list_t;

/// The covariances of the smoothed signals: of the link encoder and the motor encoder of each joint, and of the gyro.
typedef struct {
    /// Covariance of the smoothed value and rate of each signal, q_1 .. q_N theta_1 .. theta_N, as a lower Cholesky
    /// factor: L11 [rad], L21 and L22 [rad/s].
    double factor[2 * ZYGOS_MAX_JOINTS][3];
    double rate_variance[2 * ZYGOS_MAX_JOINTS];       ///< [rad^2/s^2]
    double gyro_variance;                             ///< Of one smoothed component, or 0 [rad^2/s^2].
    zygos_integral_bias_t integral_bias;              ///< Bias of the integrals in one period.
    zygos_column_list_t signal[2 * ZYGOS_MAX_JOINTS]; ///< Columns that contain its value or its rate.
    zygos_column_list_t gyro;
} zygos_noise_t;

/// Where the noise of an instant goes: packed lower triangles of p + 1 rows, the work last, and their row sums.
typedef struct {
    double *gram; ///< What it is added to.
    double *sum;
    double *rows; ///< What it is subtracted from.
    double *row_sum;
} zygos_noise_target_t;

/// Computes the covariances from the coefficients of the smoother and the declared standard deviations. Needs a checked
/// configuration.
void zygos_noise_init(zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_smoother_t *smoother);

/// Subtracts the expectation of the noise from the kinetic columns of a row. Does nothing where the configuration
/// switches the compensation off. Cost: the kinetic columns once for each joint.
void zygos_noise_means(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                       zygos_row_t *row);

/// Adds weight^2 J S J^T of this instant to one target, and subtracts it from the other. The sensors take turns, with a
/// weight that is larger in proportion: sensor s (link encoders, motor encoders, gyro) is added where turn - s is a
/// multiple of config->compensation. tau[N] is the torque before the instant, tau_next[N] the torque after it. Cost:
/// for each sensor that is added, J and one update of its columns (three updates for the gyro in space); it depends on
/// the sensor and not on the data. Returns false, and leaves out the sensor, where a list of columns does not match its
/// seal: memory was changed.
bool zygos_noise_add(const zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                     const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                     const double *tau, const double *tau_next, uint32_t turn, double weight,
                     const zygos_noise_target_t *target);

#ifdef __cplusplus
}
#endif
#endif
