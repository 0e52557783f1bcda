/* SPDX-License-Identifier: MIT */
/// zygos/priv/propagation.h: moves an arm with flexible joints over one SYNC period with the derivatives of the motion.
///
/// The residual r(x, y; p) of the equations of motion is linear in the parameters p and in the accelerations y of base,
/// links and motors (docs/theory.md, "The information limit"). From it follow the accelerations and their derivatives
/// with respect to the state, the parameters, friction of the rotors and the torques, and a Runge-Kutta integration of
/// fourth order carries all of them over the period. The number of steps is fixed, so that the work is the same in
/// every cycle.
///
/// A state has the rates of the base (three in space, one in a plane, none where the base is fixed), q, theta, and the
/// rates of q and theta. Every joint must be flexible.

#ifndef ZYGOS_PROPAGATION_H
#define ZYGOS_PROPAGATION_H

#include "../types.h"
#include "balance.h"
#include "kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The rates of the base.
#if ZYGOS_SPATIAL
#define ZYGOS_MAX_BASE_RATES 3
#else
#define ZYGOS_MAX_BASE_RATES 1
#endif
/// The accelerations of base, links and motors.
#define ZYGOS_MAX_ACCELERATIONS (2 * ZYGOS_MAX_JOINTS + ZYGOS_MAX_BASE_RATES)
/// The entries of a state.
#define ZYGOS_MAX_MOVING (4 * ZYGOS_MAX_JOINTS + ZYGOS_MAX_BASE_RATES)
/// The constants on which the motion depends: parameters, and Coulomb friction of the rotors.
#define ZYGOS_MAX_MOTION_CONSTANTS (ZYGOS_MAX_BODY + 4 * ZYGOS_MAX_JOINTS)
/// The columns of the derivatives of a state: by the state before, by the constants, and by the torques.
#define ZYGOS_MAX_SLOPES (ZYGOS_MAX_MOVING + ZYGOS_MAX_MOTION_CONSTANTS + ZYGOS_MAX_JOINTS)
/// Shapes in time that the change of a torque between two uses of readings is made of.
#define ZYGOS_MAX_SHAPES 4
/// Terms of an exponential series.
#define ZYGOS_MAX_TERMS 20
/// The rate [rad/s] below which the sign of Coulomb friction is a straight line through 0.
#define ZYGOS_SLOWEST_RATE 1e-3

/// What is constant of an arm.
typedef struct {
    zygos_geometry_t geometry;
    zygos_column_map_t column_map;
    uint32_t base_rates;                ///< W: 3, 1 or 0.
    uint32_t moving;                    ///< W + 4N, the length of a state.
    uint32_t parameters;                ///< p, without effects.
    uint32_t directions;                ///< V.
    uint32_t pairs;                     ///< Parameters of the kinetic energy before the reduction.
    uint32_t moments;                   ///< First moments under gravity.
    uint32_t steps;                     ///< Runge-Kutta steps in a period.
    uint32_t friction;                  ///< 1: Coulomb friction of the rotors follows the parameters, 0: there is none.
    uint8_t body[ZYGOS_MAX_DIRECTIONS]; ///< Of each direction.
    uint8_t first[ZYGOS_MAX_BODY];      ///< Of each pair, its two directions.
    uint8_t second[ZYGOS_MAX_BODY];     ///< See first.
    uint8_t moment[2 * ZYGOS_MAX_JOINTS]; ///< Of each first moment its direction.
    double sign[ZYGOS_MAX_BODY];          ///< Of each pair, +1 or -1.
} zygos_propagation_t;

/// The dynamics that a set of parameters means.
typedef struct {
    double matrix[ZYGOS_MAX_DIRECTIONS][ZYGOS_MAX_DIRECTIONS]; ///< N_ab [kg m^2].
    double moment[ZYGOS_MAX_DIRECTIONS];                       ///< [kg m].
    double rotor[ZYGOS_MAX_JOINTS];                            ///< Im [kg m^2].
    double stiffness[ZYGOS_MAX_JOINTS];                        ///< k [Nm/rad].
    double damping[ZYGOS_MAX_JOINTS];                          ///< b [Nms/rad].
    double friction[ZYGOS_MAX_JOINTS]; ///< Coulomb friction of each rotor, before the gear [Nm].
} zygos_dynamics_t;

/// Scratch of one call; nothing in it is kept.
typedef struct {
    double direction[ZYGOS_MAX_DIRECTIONS][3];
    double axis[ZYGOS_MAX_JOINTS][3];
    double lean[ZYGOS_MAX_JOINTS][3]; ///< Rate of change of each axis.
    double base_axis[3][3];           ///< Axes of the base's rates.
    double omega[ZYGOS_MAX_JOINTS + 1][3];
    double spin[ZYGOS_MAX_JOINTS + 1][3]; ///< Angular acceleration of each body.
    double load[ZYGOS_MAX_JOINTS + 1][3]; ///< Torque of each body's inertia.
    double force[ZYGOS_MAX_DIRECTIONS][3];
    double acceleration[ZYGOS_MAX_DIRECTIONS][3];
    double along[ZYGOS_MAX_JOINTS][ZYGOS_MAX_JOINTS + 3]; ///< Rate of each carrier about the axis, by the rates.
    double mass[ZYGOS_MAX_JOINTS + 3][ZYGOS_MAX_JOINTS + 3];
    double y[ZYGOS_MAX_ACCELERATIONS];
    double by_state[ZYGOS_MAX_ACCELERATIONS][ZYGOS_MAX_MOVING];
    double by_constant[ZYGOS_MAX_ACCELERATIONS][ZYGOS_MAX_MOTION_CONSTANTS];
    double by_torque[ZYGOS_MAX_ACCELERATIONS][ZYGOS_MAX_JOINTS];
    double stage[ZYGOS_MAX_MOVING];
    double rate[ZYGOS_MAX_MOVING];
    double sum[ZYGOS_MAX_MOVING];
} zygos_propagation_work_t;

/// Scratch of zygos_propagate(), likewise: derivatives within a step.
typedef struct {
    double slope[ZYGOS_MAX_MOVING][ZYGOS_MAX_SLOPES]; ///< For the caller's result.
    double stage[ZYGOS_MAX_MOVING][ZYGOS_MAX_SLOPES];
    double rate[ZYGOS_MAX_MOVING][ZYGOS_MAX_SLOPES];
    double sum[ZYGOS_MAX_MOVING][ZYGOS_MAX_SLOPES];
} zygos_propagation_stages_t;

/// Prepares the constants. steps: Runge-Kutta steps in a period, 1..1000; friction: 0 or 1. Needs a configuration that
/// zygos_arm_init() accepts. Returns 1; ZYGOS_E_VALUE if a joint is rigid or a setting is out of range.
int zygos_propagation_init(zygos_propagation_t *self, const zygos_config_t *config, uint32_t steps, uint32_t friction);

/// Computes the dynamics of p parameters in SI units, followed by Coulomb friction where it is configured.
void zygos_dynamics_set(zygos_dynamics_t *out, const zygos_propagation_t *self, const zygos_config_t *config,
                        const double *constants);

/// Computes the accelerations of a state under torques before the gear [Nm], and their derivatives, into the members y,
/// by_state, by_constant and by_torque of work. Returns true; false where no inertia resists, then nothing of them is
/// valid. Cost: of the order of N V^2 products of vectors, and N^2 p products of numbers.
bool zygos_propagation_slopes(const zygos_propagation_t *self, const zygos_config_t *config,
                              const zygos_dynamics_t *dynamics, const double *state, const double *torque,
                              zygos_propagation_work_t *work);

/// Moves a state under torques that are held, by one Runge-Kutta step of `time` seconds, without derivatives. Returns
/// as zygos_propagation_slopes(); where it is false, state is undefined. Cost: 4 times the accelerations, each of the
/// order of N V^2 products of vectors.
bool zygos_propagation_move(const zygos_propagation_t *self, const zygos_config_t *config,
                            const zygos_dynamics_t *dynamics, double time, double *state, const double *torque,
                            zygos_propagation_work_t *work);

/// Factors by which the terms of an exponential series become those of the mean over the ends of equal cycles.
typedef struct {
    double share[ZYGOS_MAX_TERMS + 1][ZYGOS_MAX_SHAPES]; ///< Of term m, where a torque has one of the shapes of
                                                         ///< zygos_propagation_shapes(). For the first shape, which is
                                                         ///< held, it is the mean of (k / cycles)^m, k = 1..cycles.
} zygos_propagation_means_t;

/// Computes these factors for 1..1000 cycles. Cost: cycles ZYGOS_MAX_TERMS multiplications.
void zygos_propagation_means(zygos_propagation_means_t *out, uint32_t cycles);

/// What the state changes by: after some time, and in the mean over the ends of the cycles of this time; W + 4N entries
/// each.
typedef struct {
    double end[ZYGOS_MAX_MOVING];
    double mean[ZYGOS_MAX_MOVING];
} zygos_propagation_change_t;

/// Writes into *by what the state changes by within `time` seconds, where the derivatives of the accelerations by the
/// state stay as zygos_propagation_slopes() has left them in work, by entry c of the state before; and into *pushed
/// what it changes by, by a constant addition to the rate of change of that entry, which for a rate is an acceleration.
/// The exponential series has `terms` terms. Cost: terms (W + 4N) (W + 2N + 4) multiplications.
void zygos_propagation_series(const zygos_propagation_t *self, const zygos_config_t *config, double time,
                              uint32_t terms, const zygos_propagation_means_t *means, uint32_t c,
                              const zygos_propagation_work_t *work, zygos_propagation_change_t *by,
                              zygos_propagation_change_t *pushed);

/// Writes into out[shapes] what the state changes by, where the change of a torque before the gear has the shape of a
/// shifted Legendre polynomial of degree 0 to shapes - 1, as a function of the time that is left divided by `time`: 1,
/// 2u - 1, .. The series has `terms` terms. Cost: terms (W + 4N) (W + 2N + 2 shapes) multiplications.
void zygos_propagation_shapes(const zygos_propagation_t *self, const zygos_config_t *config, double time,
                              uint32_t terms, const zygos_propagation_means_t *means, uint32_t torque, uint32_t shapes,
                              const zygos_propagation_work_t *work, zygos_propagation_change_t *out);

/// Moves a state over one period under torques that are held. slope becomes its derivatives: W + 4N rows, whose columns
/// are the state before, the constants and the torques. Returns as zygos_propagation_slopes(); where it is false, state
/// and slope are undefined. Cost: 4 steps times zygos_propagation_slopes(), and as many products of the derivatives of
/// the accelerations by the state, with slope.
bool zygos_propagate(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                     double *state, const double *torque, double (*slope)[ZYGOS_MAX_SLOPES],
                     zygos_propagation_stages_t *stages, zygos_propagation_work_t *work);

#ifdef __cplusplus
}
#endif
#endif
