/// zygos/kinematics.h: rate vectors, and the columns that bodies have in the balance.
///
/// The kinetic energy of an arm is a constant symmetric matrix N times the Gram table of its rate vectors
/// (docs/theory.md). Body i turns at w_i and has two directions across its joint axis that turn with it; the base of a
/// free arm has its three axes. A direction d of body i has the rate vector w_i x d. The columns are
///
///     spatial             N[0x,0x] N[0x,0y] .. N[Nv,Nv]: v_a . v_b for a <= b in the order 0x 0y 0z 1u 1v .. Nu Nv,
///                         halved for a = b
///     planar              a00 a01 .. aNN, of one plane vector a body: v_i = f_i (cos phi_i, sin phi_i), with the rate
///                         f_i = f_(i-1) + q'_i, f_0 the gyro about the axis, and phi_i = q_1 + .. + q_i; then b01 b02
///                         .. of v_i x v_j
///     planar, symmetric   the a_ij alone
///
/// On a fixed base those of body 0 are left out; in space also N[1u,1v], which is 0, and N[1v,1v], whose column is that
/// of N[1u,1u]. Then G[iu] G[iv], the first moments that gravity g can move, of each joint with an axis up to it that
/// is not vertical: -g . d.

#ifndef ZYGOS_KINEMATICS_H
#define ZYGOS_KINEMATICS_H

#include "smoother.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What the configuration says of directions, in the form in which a cycle needs it. The frame of body i has its two
/// directions u and v across the joint axis, and the axis, as columns; that of the base is the base's.
typedef struct {
    double rotation[ZYGOS_MAX_JOINTS][9];   ///< Frame of body i in that of body i - 1 at q = 0, row-major.
    double handedness[ZYGOS_MAX_JOINTS];    ///< +1 where u x v points along the axis, -1 where against it.
    double plane_gravity[2];                ///< Of a planar arm: gravity against its two directions [m/s^2].
    uint32_t has_gravity[ZYGOS_MAX_JOINTS]; ///< 1 where gravity has columns.
    uint32_t reserved;
} zygos_geometry_t;

/// Vectors stand in the base's axes; those of a planar arm in the plane, along the two directions across its axis.
typedef struct {
    double column[ZYGOS_MAX_BODY];             ///< Columns of the bodies' parameters [rad^2/s^2, m/s^2].
    double carrier_rate[ZYGOS_MAX_JOINTS];     ///< Rate of the body that carries joint i about its axis, a_i . w_(i-1)
                                               ///< [rad/s].
    double direction[ZYGOS_MAX_DIRECTIONS][3]; ///< d: in space as above; in a plane one a body, (cos phi_i, sin phi_i).
    double rate[ZYGOS_MAX_DIRECTIONS][3];      ///< v of each [rad/s].
    double axis[ZYGOS_MAX_JOINTS][3];          ///< Of a spatial arm.
    double spin[ZYGOS_MAX_JOINTS][3];          ///< Of a spatial arm: w_(i-1) of the body that carries joint i [rad/s].
} zygos_motion_t;

/// Sine and cosine. At most 1 ulp off for |angle| <= 1e5; branch-free: the same instructions for every finite angle,
/// and the same bits on every target with IEEE doubles. No library function.
void zygos_sincos(double angle, double *sine, double *cosine);

/// Two unit vectors across a unit vector: of the reflection that takes the axis to its largest component k, what it
/// takes e_k+1 and e_k+2 to. An axis along x, y or z has the next two axes, cyclically.
void zygos_perpendicular(const double *axis, double *u, double *v);

/// Number of parameters of the bodies: kinetic ones, and those that gravity has columns for. Needs a configuration
/// whose base, kinetic, joints, axes, frames and gravity are checked.
uint32_t zygos_kinetic_parameters(const zygos_config_t *config);
uint32_t zygos_gravity_parameters(const zygos_config_t *config);

/// Needs a configuration as above.
void zygos_geometry_init(zygos_geometry_t *self, const zygos_config_t *config);

/// Adds x_a . y_b for a <= b, halved for a = b, to the kinetic columns, x_a and y_b being any vectors in the place of
/// the rate vectors: columns are quadratic, and this is their polar form. Returns the place behind the kinetic columns.
double *zygos_kinetic_products(const zygos_config_t *config, const double (*x)[3], const double (*y)[3], double *out);

/// Derivatives of the bodies' columns in the angle and in the rate of link i. Needs a motion that zygos_kinematics()
/// filled. Cost: four products a pair of directions.
void zygos_kinematics_slopes(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                             uint32_t i, double *by_angle, double *by_rate);

/// Fills *out from the state. Needs a checked configuration. Cost: N sincos; planar (N+1)(N+2)/2 plane products, twice
/// as many where b_ij are parameters; spatial N rotations and (N+2)(2N+3) products of three.
void zygos_kinematics(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                      zygos_motion_t *out);

#ifdef __cplusplus
}
#endif
#endif
