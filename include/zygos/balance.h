/// zygos/balance.h: one row of the energy balance per instant.
///
///     work of the motors W_k = row_k . parameters + constant of the arc
///
/// The parameters are those of the bodies (kinematics.h), then rotor inertia Im_i, stiffness k_i and damping b_i of
/// each joint (Im1 k1 b1 Im2 k2 b2 ..; no k and b where the joint is rigid, and no Im1 either where the base is fixed,
/// for that rotor turns with its link alone), then the coefficients of the effects in the order of the configuration
/// (effects.h).
///
/// On arrival of cycle c the smoothed instant is k = c - M, and
///     W_k = W_(k-1) + sum_i n_i tau_(i,k-1) (theta_(i,k) - theta_(i,k-1))      exact for held torque
///     D_k = D_(k-1) + h/24 (9 g_k + 19 g_(k-1) - 5 g_(k-2) + g_(k-3))          g = (theta' - q')^2
/// A torque that steps at t_k leaves the true rate h^2/12 times the slope of the acceleration below the slope of a
/// smooth curve through the samples. The kinetic energy then reads too high by h/12 sum_i n_i (tau_(i,k) - tau_(i,k-1))
/// theta'_(i,k), in which all inertias cancel, so the row's work is W_k plus that. (No term for a sampled torque.)
/// After a gap three smoothed instants fill g; the fourth is the origin of the arc, W = D = 0.

#ifndef ZYGOS_BALANCE_H
#define ZYGOS_BALANCE_H

#include "effects.h"
#include "kinematics.h"
#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ZYGOS_TORQUE_RING (ZYGOS_MAX_HALF_WIDTH + 1)

typedef struct {
    uint32_t instants;  ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;    ///< 1: the next instant opens an arc, W = D = 0.
    uint32_t torque_at; ///< Where the next torque goes.
    uint32_t reserved;
    double work;                                        ///< W [J].
    double dissipation[ZYGOS_MAX_JOINTS];               ///< D [rad^2/s].
    double theta[ZYGOS_MAX_JOINTS];                     ///< theta of the instant before.
    double dissipation_rate[3][ZYGOS_MAX_JOINTS];       ///< g of the three instants before, newest first.
    double torque[ZYGOS_TORQUE_RING][ZYGOS_MAX_JOINTS]; ///< Torque in force, waiting for its instant.
    zygos_effects_t effects;
} zygos_balance_t;

typedef struct {
    double column[ZYGOS_MAX_PARAMETERS];
    double work; ///< [J]
} zygos_row_t;

/// What noise alone adds to the integrals of squared rates in a step, and is taken off (noise.h).
typedef struct {
    double dissipation[ZYGOS_MAX_JOINTS]; ///< [rad^2/s]
    double effect[ZYGOS_EFFECT_PLACES];   ///< In units of the effect's column.
} zygos_integral_bias_t;

/// Place of each joint's parameters, the rotor inertia's first, and number of parameters p.
typedef struct {
    uint32_t kinetic;                 ///< Kinetic parameters of the bodies, which come first.
    uint32_t body;                    ///< All parameters of the bodies.
    uint32_t joint[ZYGOS_MAX_JOINTS]; ///< Place of Im_i, or of k_i where there is no Im_i.
    uint32_t rotor[ZYGOS_MAX_JOINTS]; ///< 1 where there is an Im_i.
    uint32_t effects;                 ///< Place of the first effect.
    uint32_t count;                   ///< p.
} zygos_column_map_t;

/// Needs a checked configuration.
void zygos_balance_column_map(const zygos_config_t *config, zygos_column_map_t *out);

/// Forgets all that was. Used at init and at every gap.
void zygos_balance_reset(zygos_balance_t *self);

/// Makes the next instant the origin of an arc; the filters run on.
void zygos_balance_new_arc(zygos_balance_t *self);

/// Stores tau[N], the torque that was in force during the cycle that ended with the newest SYNC. Call it once a cycle,
/// before zygos_balance_row().
void zygos_balance_torque(zygos_balance_t *self, const zygos_config_t *config, const double *tau);

/// Carries W and D on to this instant and writes its row. Returns 1 when the row belongs to an arc, 0 while g fills.
/// Cost: the same for every call of a configuration.
int zygos_balance_row(zygos_balance_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_integral_bias_t *bias, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                      zygos_row_t *out);

/// Torque in force on the step that ended with the newest instant, and on the one that begins with it: tau[N] each.
const double *zygos_balance_torque_before(const zygos_balance_t *self);
const double *zygos_balance_torque_after(const zygos_balance_t *self, const zygos_config_t *config);

#ifdef __cplusplus
}
#endif
#endif
