/* SPDX-License-Identifier: MIT */
/// zygos/priv/refiner.h: a square-root filter for the state of an arm with flexible joints and its parameters.
///
/// Rows of the energy balance need no model of how noise passes through the motion, but use a small part of what the
/// frames hold. This extended Kalman filter uses nearly all of it, if the model is complete. It starts from an
/// estimate, such as that of zygos_work_solve(), and improves it with every cycle:
///
///     zygos_refiner_start()      state, parameters and their covariance
///     zygos_refiner_read()       the readings at a SYNC
///     zygos_refiner_advance()    the torques up to the next SYNC, then again zygos_refiner_read()
///
/// Where readings are used in every few cycles only, each is the mean over these cycles (refine.h). The means are
/// entries of the estimate before its own, from the time when the covariance is moved until they are used; then they
/// are dropped.
///
/// The covariance is S S' with a triangular S, which stays positive definite. Its entries are the state of
/// propagation.h; the bias of the gyro, one entry for each rate of the base; and constants: the parameters in units of
/// settings.size, and, where configured, Coulomb friction of each rotor, an offset and a gain of each torque, and zeros
/// of link and motor encoders. The torques carry noise, which is the process noise: sigma^2 + (relative sigma *
/// torque)^2.
///
/// A filter cannot tell whether its model is complete. The normalised squares of the innovations, 1 on average, grow
/// with gross errors only: whoever publishes its values must compare them with the estimate from which it started.

#ifndef ZYGOS_REFINER_H
#define ZYGOS_REFINER_H

#include "../types.h"
#include "propagation.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The state, and the bias of the gyro.
#define ZYGOS_MAX_FAST (ZYGOS_MAX_MOVING + ZYGOS_MAX_BASE_RATES)
/// All entries of the filter.
#define ZYGOS_MAX_REFINED (ZYGOS_MAX_FAST + ZYGOS_MAX_MOTION_CONSTANTS + 4 * ZYGOS_MAX_JOINTS)
/// The length of S.
#define ZYGOS_MAX_ROOT (ZYGOS_MAX_REFINED * (ZYGOS_MAX_REFINED + 1) / 2)

/// The readings at a SYNC: encoders of links and motors, and rates of the base.
#define ZYGOS_MAX_READINGS (2 * ZYGOS_MAX_JOINTS + ZYGOS_MAX_BASE_RATES)
/// The state and the means of readings that follow from it.
#define ZYGOS_MAX_MOVED (ZYGOS_MAX_MOVING + ZYGOS_MAX_READINGS)
/// Columns by which the noise of the torques between two uses of readings enters the covariance.
#define ZYGOS_MAX_PUSHES (ZYGOS_MAX_SHAPES * ZYGOS_MAX_JOINTS)

/// The kinds of readings whose innovations are counted apart.
enum zygos_channel {
    ZYGOS_CHANNEL_LINK = 0,    ///< Link encoders.
    ZYGOS_CHANNEL_MOTOR = 1,   ///< Motor encoders.
    ZYGOS_CHANNEL_GYRO = 2,    ///< The gyro.
    ZYGOS_KINDS_OF_CHANNEL = 3 ///< How many there are.
};

/// What the filter has to know besides the configuration.
typedef struct {
    uint32_t steps;    ///< Runge-Kutta steps in a period, 1..1000.
    uint32_t friction; ///< 1: Coulomb friction of each rotor is estimated, 0: there is none.
    uint32_t offsets;  ///< 1: an offset of each torque is estimated, 0: there is none.
    uint32_t gains;    ///< 1: the share by which each torque exceeds the reported one is estimated, 0: there is none.
    uint32_t zeros;    ///< 1: zeros of link and motor encoders are estimated, 0: those of the configuration are exact.
    uint32_t reserved;
    double size[ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS]; ///< Of each parameter, > 0; in its unit.
    double torque_sigma[ZYGOS_MAX_JOINTS];              ///< Noise of a torque, before the gear [Nm], >= 0.
    double torque_relative_sigma[ZYGOS_MAX_JOINTS];     ///< The same as a share of its size, >= 0.
    double link_sigma[ZYGOS_MAX_JOINTS];                ///< Noise of the link encoders, steps included [rad], > 0.
    double motor_sigma[ZYGOS_MAX_JOINTS];               ///< Noise of the motor encoders, likewise.
    double gyro_sigma;                                  ///< Noise of the gyro [rad/s], > 0.
    double bias_walk;                                   ///< Random walk of its bias over one period [rad/s], >= 0.
    double second_order; ///< Factor of the variance of the link rates [s] that the noise of the gyro is increased by:
                         ///< the filter is linear, and starts with poor rates; 0..1000.
} zygos_refiner_settings_t;

/// The filter. x and root are the whole of its memory of the past.
typedef struct {
    zygos_propagation_t propagation;
    zygos_refiner_settings_t settings;
    uint32_t fast;                        ///< Entries that change: the state and the bias.
    uint32_t entries;                     ///< n, all entries.
    uint32_t constants;                   ///< n - fast.
    uint32_t joints;                      ///< N.
    uint32_t failed;                      ///< 1: the estimate became impossible, and only a new start helps.
    double x[ZYGOS_MAX_REFINED];          ///< The estimate.
    double root[ZYGOS_MAX_ROOT];          ///< S, upper triangular: column j has its entries 0..j from j (j + 1) / 2 on.
    double count[ZYGOS_KINDS_OF_CHANNEL]; ///< Readings since the start, or since the caller set this to 0.
    double square[ZYGOS_KINDS_OF_CHANNEL]; ///< Sum of their squared innovations divided by the expected variances.
    double volume;          ///< With the next: the product of the expected variances is volume * 2^exponent.
    double volume_exponent; ///< Both since the start. They tell which of several settings the readings favour.
    double gyro_variance;   ///< That the readings of the gyro at the newest SYNC are expected to have.
} zygos_refiner_t;

/// Scratch of one call; nothing in it is kept.
typedef struct {
    union {
        zygos_propagation_work_t propagation; ///< Until the last constant was carried; then it is the table.
        double table[ZYGOS_MAX_FAST + ZYGOS_MAX_READINGS][ZYGOS_MAX_FAST + ZYGOS_MAX_PUSHES + ZYGOS_MAX_BASE_RATES];
    };
    zygos_dynamics_t dynamics;
    uint32_t shapes; ///< Of each torque in push, 1..ZYGOS_MAX_SHAPES.
    uint32_t leads;  ///< Mean readings before the other entries of the estimate: 2N + W, or 0 where there are none.
    uint32_t cycles; ///< Over which they are means.
    uint32_t reserved;
    double across[ZYGOS_MAX_MOVED][ZYGOS_MAX_MOVING]; ///< Derivatives by the state before; rows: the state, the means.
    double pushed[ZYGOS_MAX_MOVED][ZYGOS_MAX_ACCELERATIONS]; ///< Of the same by additions to the accelerations.
    double push[ZYGOS_MAX_MOVED][ZYGOS_MAX_PUSHES]; ///< What 1 Nm of each shape of a torque does to them: the first
                                                    ///< shape of all joints, then the next.
    double constant[ZYGOS_MAX_MOTION_CONSTANTS];
    double torque[ZYGOS_MAX_JOINTS]; ///< As reported [Nm].
    double gain[ZYGOS_MAX_READINGS + ZYGOS_MAX_REFINED];
    double seen[ZYGOS_MAX_REFINED];                     ///< What a reading sees of each column of S.
    double lead_x[ZYGOS_MAX_READINGS];                  ///< What means are expected to be, without zeros and bias.
    double lead[ZYGOS_MAX_REFINED][ZYGOS_MAX_READINGS]; ///< Their entries in each column of S.
    double crown[ZYGOS_MAX_READINGS * (ZYGOS_MAX_READINGS + 1) / 2]; ///< Their own columns, packed as in S.
} zygos_refiner_work_t;

/// Prepares a filter; zygos_refiner_start() has to follow. Needs a configuration that zygos_arm_init() accepts. Returns
/// 1; ZYGOS_E_VALUE if a joint is rigid or a setting is out of range, then the filter cannot be used.
int zygos_refiner_init(zygos_refiner_t *self, const zygos_config_t *config, const zygos_refiner_settings_t *settings);

/// Begins at the SYNC whose readings are used next. x and sigma: n entries in SI units and their standard deviations,
/// of which those of the p parameters are not read; covariance: p x p of the parameters, in SI units. Returns 1;
/// ZYGOS_E_VALUE if a sigma is negative or the covariance is not positive definite, then the filter is as before.
/// Cost: a Cholesky factorisation.
int zygos_refiner_start(zygos_refiner_t *self, const double *x, const double *sigma, const double *covariance);

/// The same where the caller has written the covariance of the parameters, in units of their sizes, into their columns
/// of root: the entry of parameters i <= j is in the column fast + j, in row fast + i.
int zygos_refiner_begin(zygos_refiner_t *self, const double *x, const double *sigma);

/// Begins again after an interruption: state and bias, x and sigma: `fast` entries each, are others, and all constants
/// are kept. Cost: one pass over the root.
void zygos_refiner_resume(zygos_refiner_t *self, const double *x, const double *sigma);

/// Uses the readings at a SYNC: angles of links and motors [rad] after sign and zero, and the rate of the base in its
/// axes [rad/s], which is not read where the base is fixed. Cost: n^2 multiplications for each reading.
void zygos_refiner_read(zygos_refiner_t *self, const zygos_config_t *config, const double *q, const double *theta,
                        const double *omega, zygos_refiner_work_t *work);

/// Moves the estimate to the next SYNC, under torques before the gear [Nm] that were held since the last one. lost:
/// standard deviation that the torques have in addition [Nm], 0 where they were received. Returns true; false where the
/// estimate is impossible: no inertia resists, or a number is not finite. The filter has then failed. Cost:
/// zygos_propagate() and a product of the derivatives with S.
bool zygos_refiner_advance(zygos_refiner_t *self, const zygos_config_t *config, const double *tau, double lost,
                           zygos_propagation_stages_t *stages, zygos_refiner_work_t *work);

/// What one reading told.
typedef struct {
    uint32_t channel;  ///< enum zygos_channel.
    uint32_t rejected; ///< 1: its square was above the limit, and it was not used.
    uint32_t terms;    ///< The reading is the sum of so many entries with the weights below.
    uint32_t entry[3]; ///< Ascending.
    double weight[3];  ///< See entry.
    double variance;   ///< Expected, of the innovation.
    double square;     ///< Of the innovation divided by its variance, at most the limit.
} zygos_innovation_t;

/// The parts of zygos_refiner_read() and zygos_refiner_advance(), for a caller that does them in slices (refine.h).
/// Reading k of a SYNC, in the order link encoders, motor encoders, base rates (those about the axis of a planar arm),
/// is used unless its normalised square is above limit; where work->leads is not 0, it is the mean over the cycles.
/// Cost: n^2 multiplications, and n (2N + W) where it is a mean.
zygos_innovation_t zygos_refiner_use(zygos_refiner_t *self, const zygos_config_t *config, uint32_t k, double value,
                                     double limit, zygos_refiner_work_t *work);
/// Returns the time from SYNC to the instant that reading k of an encoder belongs to [s].
double zygos_refiner_latch_s(const zygos_config_t *config, uint32_t k);
/// Limits the standard deviation of an entry to less than sigma: a reading of it that is as expected, and that is not
/// counted. Needs work->leads to be 0. Cost: n^2 multiplications.
void zygos_refiner_pin(zygos_refiner_t *self, uint32_t entry, double sigma, zygos_refiner_work_t *work);
/// Writes parameters and friction in SI units into constant[]: the constants of zygos_dynamics_set().
void zygos_refiner_constants(const zygos_refiner_t *self, double *constant);
/// Writes the torques that act, by the estimated gains and offsets, into drive[N].
void zygos_refiner_drive(const zygos_refiner_t *self, const double *tau, double *drive);
/// Moves the column of constant c in the root, and makes that of the means, by work->across and by what the constants
/// do: slope has the derivatives of zygos_propagate(); where it is null, constants add to the accelerations as
/// zygos_propagation_slopes() has left it in work, and these count by work->pushed. Cost: (W + 4N) n multiplications;
/// where it is null, (W + 2N) n and for each mean W + 4N + W + 2N.
void zygos_refiner_carry(zygos_refiner_t *self, uint32_t c, const double (*slope)[ZYGOS_MAX_SLOPES],
                         zygos_refiner_work_t *work);
/// Writes work->table, whose square is the covariance of state and bias after the period, and behind them of the means;
/// noise: standard deviations of the torques [Nm], of all shapes in work->push; walk: step of the bias [rad/s]. After
/// it, zygos_refiner_row() has to be called for each row: those of state and bias, the last one first, then those of
/// the means, the last one first. Cost: (W + 4N)^3 / 2 multiplications, and (W + 4N)^2 (2N + W) / 2 for the means.
void zygos_refiner_table(const zygos_refiner_t *self, const double *noise, double walk, zygos_refiner_work_t *work);
/// Takes row `at` of the table into the root, or into work->crown. Cost: 2 (at + 1) (2W + (4 + shapes) N)
/// multiplications, and as many for each mean.
void zygos_refiner_row(zygos_refiner_t *self, uint32_t at, zygos_refiner_work_t *work);

/// Writes the p parameters in SI units, and their p x p covariance where covariance is not null. Cost: p^3/6
/// multiplications for the covariance.
void zygos_refiner_parameters(const zygos_refiner_t *self, double *value, double *covariance);

#ifdef __cplusplus
}
#endif
#endif
