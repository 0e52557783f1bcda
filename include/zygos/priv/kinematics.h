/* SPDX-License-Identifier: MIT */
/// zygos/priv/kinematics.h: computes rate vectors, and the columns of the bodies in the energy balance.
///
/// The kinetic energy of an arm is the product of a constant symmetric matrix N with the Gram matrix of its rate
/// vectors (docs/theory.md). Body i rotates at w_i and has two body-fixed directions perpendicular to its joint axis; a
/// free base has its three axes. A direction d of body i has the rate vector w_i x d. The columns are
///
///     spatial             N[0x,0x] N[0x,0y] .. N[Nv,Nv]: v_a . v_b for a <= b in the order 0x 0y 0z 1u 1v .. Nu Nv,
///                         halved for a = b
///     planar              a00 a01 .. aNN, of one plane vector for each body: v_i = f_i (cos phi_i, sin phi_i), with
///     the rate
///                         f_i = f_(i-1) + q'_i, f_0 the gyro about the axis, and phi_i = q_1 + .. + q_i; then b01 b02
///                         .. of v_i x v_j
///     planar, symmetric   the a_ij alone
///
/// With a fixed base those of body 0 do not exist; in space neither do N[1u,1v], which is 0, and N[1v,1v], whose column
/// is that of N[1u,1u]. They are followed by the columns -g . d of the first moments G[iu] G[iv] under gravity g, for
/// each joint that is preceded by, or has, an axis that is not vertical.

#ifndef ZYGOS_KINEMATICS_H
#define ZYGOS_KINEMATICS_H

#include "../types.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The geometry of the configuration in the form that each cycle needs. The columns of the frame of body i are its two
/// directions u and v perpendicular to the joint axis, and the axis; the frame of the base is that of the
/// configuration.
typedef struct {
    double rotation[ZYGOS_MAX_JOINTS][9];   ///< Frame of body i in that of body i - 1 at q = 0, row-major.
    double handedness[ZYGOS_MAX_JOINTS];    ///< +1 where u x v points along the axis, -1 where opposite.
    double plane_gravity[2];                ///< Planar arm: -g along its two directions [m/s^2].
    uint32_t has_gravity[ZYGOS_MAX_JOINTS]; ///< 1 where the joint has columns of gravity.
    uint32_t reserved;
} zygos_geometry_t;

/// The motion of one instant. Vectors are in the axes of the base; those of a planar arm are in the plane, along the
/// two directions perpendicular to its axis.
typedef struct {
    double column[ZYGOS_MAX_BODY];             ///< Columns of the bodies [rad^2/s^2, m/s^2].
    double carrier_rate[ZYGOS_MAX_JOINTS];     ///< Rate of the body that carries joint i about its axis, a_i . w_(i-1)
                                               ///< [rad/s].
    double direction[ZYGOS_MAX_DIRECTIONS][3]; ///< d: in space as above; in a plane one a body, (cos phi_i, sin phi_i).
    double rate[ZYGOS_MAX_DIRECTIONS][3];      ///< v of each [rad/s].
    double axis[ZYGOS_MAX_JOINTS][3];          ///< Of a spatial arm.
    double spin[ZYGOS_MAX_JOINTS][3];          ///< Of a spatial arm: w_(i-1) of the body that carries joint i [rad/s].
} zygos_motion_t;

/// Computes sine and cosine. The error is at most 1 ulp for |angle| <= 1e5. The function has no branches and calls no
/// library function: it executes the same instructions for every finite angle, and gives the same bits on every target
/// with IEEE doubles.
void zygos_sincos(double angle, double *sine, double *cosine);

/// Computes two unit vectors perpendicular to a unit vector: the images of e_k+1 and e_k+2 under the reflection that
/// maps the axis to its largest component k. For an axis along x, y or z these are the next two axes, cyclically.
void zygos_perpendicular(const double *axis, double *u, double *v);

/// Return the numbers of kinetic parameters and of first moments under gravity. Need a configuration whose base,
/// kinetic, joints, axes, frames and gravity are checked.
uint32_t zygos_kinetic_parameters(const zygos_config_t *config);
uint32_t zygos_gravity_parameters(const zygos_config_t *config);

/// Computes the geometry. Needs a configuration as above.
void zygos_geometry_init(zygos_geometry_t *self, const zygos_config_t *config);

/// Adds x_a . y_b for a <= b, halved for a = b, to the kinetic columns, where x_a and y_b replace the rate vectors.
/// This is the bilinear form of the quadratic columns. Returns the address after the kinetic columns.
double *zygos_kinetic_products(const zygos_config_t *config, const double (*x)[3], const double (*y)[3], double *out);

/// Writes how the rate vectors change when the bodies from the given one on turn faster about an axis by 1 rad/s; in a
/// plane the axis is that of the plane. Needs a motion that zygos_kinematics() has computed.
void zygos_kinematics_swing(const zygos_config_t *config, const zygos_motion_t *motion, const double *axis,
                            uint32_t body, double (*out)[3]);

/// Computes the derivatives of the bodies' columns with respect to the angle and the rate of link i; the latter are
/// left out where by_rate is null. Needs a motion that zygos_kinematics() has computed. Cost: four products for each
/// pair of directions, or two.
void zygos_kinematics_slopes(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                             uint32_t i, double *by_angle, double *by_rate);

/// Computes the motion of a state. Needs a checked configuration. Cost: N times zygos_sincos(); for a planar arm
/// (N+1)(N+2)/2 products of plane vectors, twice as many where b_ij are parameters; for a spatial arm N rotations and
/// (N+2)(2N+3) products of vectors.
void zygos_kinematics(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                      zygos_motion_t *out);

#ifdef __cplusplus
}
#endif
#endif
