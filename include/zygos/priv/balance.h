/* SPDX-License-Identifier: MIT */
/// zygos/priv/balance.h: forms one row of the energy balance for each instant.
///
///     work of the motors W_k = row_k . parameters + constant of the arc
///
/// The parameters are those of the bodies (kinematics.h), then rotor inertia Im_i, stiffness k_i and damping b_i of
/// each joint (Im1 k1 b1 Im2 k2 b2 ..; a rigid joint has no k and b, and a rigid first joint on a fixed base no Im1
/// either, because that rotor only turns with its link), then the coefficients of the effects in the order of the
/// configuration (effects.h).
///
/// When cycle c arrives, the smoothed instant is k = c - M, and
///     W_k = W_(k-1) + sum_i n_i tau_(i,k-1) (theta_(i,k) - theta_(i,k-1))      exact for a held torque
///     D_k = D_(k-1) + h/24 (9 g_k + 19 g_(k-1) - 5 g_(k-2) + g_(k-3))          g = (theta' - q')^2
/// When the torque steps at t_k, the slope of a smooth curve through the samples exceeds the true rate by h^2/12 times
/// the slope of the acceleration. The kinetic energy is then too large by h/12 sum_i n_i (tau_(i,k) - tau_(i,k-1))
/// theta'_(i,k), in which all inertias cancel; the work of the row is W_k plus this term. (A sampled torque has no such
/// term.) The noise of the torques adds sum_i sigma_i^2 (theta_(i,k) - theta_(i,k-1))^2 to the variance of W_k: W
/// walks. Here sigma_i^2 = s_i^2 + (torque_relative_sigma_i n_i tau_(i,k-1))^2, and s_i is torque_sigma_i, at least the
/// deviation of the steps of a torque frame, n_i 1e-4 Nm / sqrt(12). After a gap three smoothed instants are needed for
/// g; the fourth is the origin of the arc, W = D = 0.

#ifndef ZYGOS_BALANCE_H
#define ZYGOS_BALANCE_H

#include "../types.h"
#include "effects.h"
#include "kinematics.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ZYGOS_TORQUE_RING (ZYGOS_MAX_HALF_WIDTH + 1)

/// The state of the integrals.
typedef struct {
    uint32_t instants;  ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;    ///< 1: the next instant opens an arc, W = D = 0.
    uint32_t torque_at; ///< Index of the next torque in the ring buffer.
    uint32_t reserved;
    double work;                                  ///< W [J].
    double dissipation[ZYGOS_MAX_JOINTS];         ///< D [rad^2/s].
    double theta[ZYGOS_MAX_JOINTS];               ///< theta at the previous instant.
    double dissipation_rate[3][ZYGOS_MAX_JOINTS]; ///< g at the three previous instants, newest first.
    /// Acting torques that wait for their instant, twice.
    double torque[2][ZYGOS_TORQUE_RING][ZYGOS_MAX_JOINTS];
    zygos_effects_t effects;
} zygos_balance_t;

/// One row of the balance.
typedef struct {
    double column[ZYGOS_MAX_COLUMNS]; ///< In the order above.
    double work;                      ///< Work of the motors [J].
    double variance;                  ///< What the noise of the torques adds to the variance of the work in the period
                                      ///< before this instant [J^2].
} zygos_row_t;

/// The bias of the integrals of squared rates by noise in one period, which is subtracted (noise.h).
typedef struct {
    double dissipation[ZYGOS_MAX_JOINTS]; ///< Of D [rad^2/s].
    double effect[ZYGOS_EFFECT_PLACES];   ///< Of the column of an effect, in its unit.
} zygos_integral_bias_t;

/// What place[] has where no parameter stands for a column alone.
#define ZYGOS_NO_PLACE 0xFFFFFFFFu

/// The column index of each joint's first parameter, and the numbers of columns and parameters. Where the configuration
/// has no reduction, the parameters are the columns.
typedef struct {
    uint32_t kinetic;                  ///< Number of kinetic parameters of the bodies, which are the first columns.
    uint32_t body;                     ///< Number of all parameters of the bodies.
    uint32_t joint[ZYGOS_MAX_JOINTS];  ///< Column of Im_i, or of k_i where there is no Im_i.
    uint32_t rotor[ZYGOS_MAX_JOINTS];  ///< 1 where there is an Im_i.
    uint32_t effects;                  ///< Column of the first effect.
    uint32_t count;                    ///< Number of columns.
    uint32_t reduced;                  ///< Parameter of the first effect, the number of all others.
    uint32_t parameters;               ///< p, the number of parameters.
    uint32_t place[ZYGOS_MAX_COLUMNS]; ///< The parameter that stands for a column, and for no other; or ZYGOS_NO_PLACE.
} zygos_column_map_t;

/// Returns the number of columns. Needs the number of joints and the effects to be possible; with an arm that does not
/// fit the build, or with gravity on a free base, it may exceed ZYGOS_MAX_COLUMNS.
uint32_t zygos_balance_columns(const zygos_config_t *config);

/// Computes the column indices and the places. Needs a checked configuration. Cost: a few passes over the reduction.
void zygos_balance_column_map(const zygos_config_t *config, zygos_column_map_t *out);

/// Resets the integrals and their history. Called at init and at every gap.
void zygos_balance_reset(zygos_balance_t *self);

/// Makes the next instant the origin of an arc. The history is kept.
void zygos_balance_new_arc(zygos_balance_t *self);

/// Stores tau[N], the torque that acted during the cycle that ended with the newest SYNC. Call it once in each cycle,
/// before zygos_balance_row().
void zygos_balance_torque(zygos_balance_t *self, const zygos_config_t *config, const double *tau);

/// Advances W and D to this instant and writes its row. Returns 1 when the row belongs to an arc, 0 for the three
/// instants after a gap. Cost: the same for every call of a configuration.
int zygos_balance_row(zygos_balance_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_integral_bias_t *bias, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                      zygos_row_t *out);

/// Returns whether both copies of the torque that acted in the period before the newest instant are the same; otherwise
/// memory was changed since it was stored.
bool zygos_balance_torque_is_whole(const zygos_balance_t *self, const zygos_config_t *config);

/// Return tau[N], the torque that acted in the period before the newest instant, and in the period after it.
const double *zygos_balance_torque_before(const zygos_balance_t *self);
const double *zygos_balance_torque_after(const zygos_balance_t *self, const zygos_config_t *config);

#ifdef __cplusplus
}
#endif
#endif
