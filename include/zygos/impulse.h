/// zygos/impulse.h: one row of each flexible joint's motor impulse an instant.
///
///     n_i int tau_i = row_k . parameters of joint i + constant of the arc
///
/// The rotor's equation of motion, multiplied by the ratio n and integrated once. With d = theta - q the columns are
///
///     Im_i                    n^2 theta' + n a_i . w_(i-1)
///     k_i                     integral of d
///     b_i                     d
///     ZYGOS_MOTOR_COULOMB     integral of n sat(theta')
///     ZYGOS_MOTOR_VISCOUS     n theta
///     ZYGOS_CUBIC_STIFFNESS   integral of d^3
///     ZYGOS_SPRING_OFFSET     time since the arc began
///     ZYGOS_TORQUE_LAG        n (tau_(k-1) + tau_k) / 2
///
/// in the order of the configuration; friction of a link has no column. Integrals follow the rule of the dissipation
/// (balance.h) and begin with the arc. No link's inertia is in the row: it is local to its joint, and so are the
/// unknowns.
///
/// A torque held between SYNCs adds n h tau a step, exactly. Where it steps, the smoothed theta' is h/12 times the jump
/// of the acceleration above the true one (balance.h). The rotor's inertia times that jump is n (tau_k - tau_(k-1)), so
/// n h/12 (tau_k - tau_(k-1)) is added to the row's impulse. (No term for a sampled torque; what the jump of the base,
/// whose rate is not differentiated, would take off is neglected.)
///
/// The integral of d sums the encoders' noise up like a random walk, so these rows want shorter arcs than those of the
/// energy: the room has arcs of its own.

#ifndef ZYGOS_IMPULSE_H
#define ZYGOS_IMPULSE_H

#include "effects.h"
#include "kinematics.h"
#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Columns of a joint's row: Im, k, b and the effects at the joint.
#define ZYGOS_MAX_IMPULSE (3 + ZYGOS_MAX_EFFECTS)
#define ZYGOS_MAX_PACKED_IMPULSE (ZYGOS_MAX_IMPULSE * (ZYGOS_MAX_IMPULSE + 1) / 2)

typedef struct {
    uint32_t instants;                            ///< Smoothed instants since the gap, at most 4.
    uint32_t origin;                              ///< 1: the next instant opens an arc.
    double impulse[ZYGOS_MAX_JOINTS];             ///< n int tau [Nms].
    double deflection_integral[ZYGOS_MAX_JOINTS]; ///< Integral of d [rad s].
    double past[3][ZYGOS_MAX_JOINTS];             ///< d of the three instants before, newest first.
    double total[ZYGOS_EFFECT_PLACES];            ///< Integral of an effect.
    double before[3][ZYGOS_EFFECT_PLACES];        ///< Its integrand at the three instants before, newest first.
} zygos_impulse_t;

/// Which columns each joint has. effect[i][c] is the effect in column 3 + c.
typedef struct {
    uint32_t count[ZYGOS_MAX_JOINTS]; ///< 0 where the joint is rigid and has no row.
    uint32_t effect[ZYGOS_MAX_JOINTS][ZYGOS_EFFECT_PLACES];
} zygos_impulse_column_map_t;

typedef struct {
    double column[ZYGOS_MAX_JOINTS][ZYGOS_MAX_IMPULSE];
    double impulse[ZYGOS_MAX_JOINTS]; ///< [Nms]
} zygos_impulse_rows_t;

/// Needs a checked configuration.
void zygos_impulse_column_map(const zygos_config_t *config, zygos_impulse_column_map_t *out);

/// Forgets all that was. Used at init and at every gap.
void zygos_impulse_reset(zygos_impulse_t *self);

/// Makes the next instant the origin of an arc; the integrands of the past stay.
void zygos_impulse_new_arc(zygos_impulse_t *self);

/// Carries the integrals on to this instant and writes the rows of the flexible joints. tau_before[N] and tau[N] are
/// the torques in force until the instant and from it on. Returns 1 when the rows belong to an arc, 0 while the
/// integrands fill: three instants, as the energy row. Cost: the same for every call of a configuration.
int zygos_impulse_row(zygos_impulse_t *self, const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                      const zygos_arm_state_t *state, const zygos_motion_t *motion, const double *tau_before,
                      const double *tau, zygos_impulse_rows_t *out);

/// What the noise of the sensors adds to the products of one row's columns of a flexible joint on average: out takes
/// the lower triangle, row by row. The rows are linear in the signals, so it is the same for every instant and every
/// motion: N accepted instants owe N times as much. imu_sigma is the standard deviation of one sample of the gyro
/// [rad/s]. Integrals average noise out and have none here; the noise of a_i . w_(i-1) is counted as if the axes were
/// parallel, which in space is a little too much (of the order of 1/n^2). Needs an initialised smoother.
void zygos_impulse_noise(const zygos_config_t *config, const zygos_impulse_column_map_t *column_map,
                         const zygos_smoother_t *smoother, double imu_sigma, uint32_t joint, double *out);

#ifdef __cplusplus
}
#endif
#endif
