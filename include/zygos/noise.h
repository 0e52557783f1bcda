/// zygos/noise.h: what the sensors' noise adds to the normal equations on average.
///
/// A row is made of noisy angles and rates, and products of rows hold the square of that noise: it draws every estimate
/// towards zero, and more data does not help. The noise of a smoothed signal is known, though: the declared deviation
/// of the sensor times the smoother's own coefficients. With x + e for the signals, S the covariance of e and J the
/// derivative of the augmented row [columns, work] in x,
///
///     E column = true column + 1/2 sum_s S_ss d2(column)/dx_s^2        removed from the row
///     E [row]^T [row] = true square + J S J^T                          summed here, subtracted where a sum is used
///
/// The first is kept where it does not vanish with the constant of the arc: rates in the kinetic columns, which are
/// quadratic in them, and the dissipation, which the noise of the rates makes grow by (S_q' + S_theta') h a step. Of
/// the work, and of the dissipation, what is correlated with the signals of the instant is n tau on theta and 2 (theta'
/// - q') on theta - q. Terms with the square of S are left out: they are smaller by the square of noise over signal.
///
/// Sensors are independent of each other; the value and the rate of one signal are correlated where it latches late.

#ifndef ZYGOS_NOISE_H
#define ZYGOS_NOISE_H

#include "balance.h"
#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A gyro whose variance is below this share of that of every link's rate is taken to be exact.
#define ZYGOS_GYRO_SHARE 1e-4

/// Where the noise of one sensor shows, in ascending order.
typedef struct {
    uint32_t count;
    uint32_t place[ZYGOS_MAX_PARAMETERS + 1];
} zygos_column_list_t;

/// Sensors: link encoder of each joint, motor encoder of each joint, the gyro. What they share with each other is 0.
typedef struct {
    /// Of the smoothed value and rate of a joint's signal, q_1 .. q_N theta_1 .. theta_N, as a lower Cholesky factor:
    /// value, covariance / value, what is left of the rate [rad, rad/s].
    double factor[2 * ZYGOS_MAX_JOINTS][3];
    double rate_variance[2 * ZYGOS_MAX_JOINTS];      ///< [rad^2/s^2]
    double gyro_variance;                            ///< Of a smoothed component, or 0 [rad^2/s^2].
    zygos_integral_bias_t integral_bias;             ///< Mean growth of the dissipation, and of effects, in a step.
    zygos_column_list_t angle[2 * ZYGOS_MAX_JOINTS]; ///< Of the value; where it latches late, also those of the rate.
    zygos_column_list_t rate[2 * ZYGOS_MAX_JOINTS];
    zygos_column_list_t gyro;
} zygos_noise_t;

/// Computes the covariances from the smoother's coefficients and the declared deviations. Needs a checked
/// configuration.
void zygos_noise_init(zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_smoother_t *smoother);

/// Removes the mean of the noise from the kinetic columns of a row. Does nothing where the configuration switches the
/// compensation off. Cost: the kinetic columns once for each joint.
void zygos_noise_means(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                       zygos_row_t *row);

/// Adds weight^2 J S J^T of this instant to the packed lower triangle of p + 1 rows (the work's last), and its row sums
/// to sum. Sensors take turns, with as much more weight: sensor s (link encoders, motor encoders, gyro) has its turn
/// where turn - s is a multiple of config->compensation. tau[N] is the torque before the instant, tau_next[N] that
/// after it. Cost: for each sensor whose turn it is, J and one update of the places where it is not zero (three of the
/// gyro's in space); it depends on the sensor, not on its data.
void zygos_noise_add(const zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                     const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                     const double *tau, const double *tau_next, uint32_t turn, double weight, double *packed,
                     double *sum);

#ifdef __cplusplus
}
#endif
#endif
