/// zygos/kinematics.h: the Gram table of the rate vectors.
///
/// The kinetic energy of a free-floating arm is a constant symmetric matrix times the Gram table of its bodies' rate
/// vectors (docs/theory.md). With parallel axes one plane vector a body is enough: v_i = f_i (cos phi_i, sin phi_i),
/// with the absolute rate f_i = f_(i-1) + q'_i, f_0 the gyro about the axis, and phi_i = q_1 + ... + q_i.

#ifndef ZYGOS_KINEMATICS_H
#define ZYGOS_KINEMATICS_H

#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double gram[ZYGOS_MAX_GRAM];           ///< v_i . v_j for i <= j, row by row [rad^2/s^2].
    double carrier_rate[ZYGOS_MAX_JOINTS]; ///< Rate of the body that carries joint i about its axis, a_i . w_(i-1)
                                           ///< [rad/s].
} zygos_motion_t;

/// Sine and cosine. At most 1 ulp off for |angle| <= 1e5; branch-free: the same instructions for every finite angle,
/// and the same bits on every target with IEEE doubles. No library function.
void zygos_sincos(double angle, double *sine, double *cosine);

/// Fills *out from the state. Needs a checked configuration. Cost: N sincos and (N+1)(N+2)/2 plane products.
void zygos_kinematics(const zygos_config_t *config, const zygos_state_t *state, zygos_motion_t *out);

#ifdef __cplusplus
}
#endif
#endif
