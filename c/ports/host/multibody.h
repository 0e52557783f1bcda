/* SPDX-License-Identifier: MIT */
/// Host only: the equations of motion of an arm, for the simulator. Written for itself: nothing of the library
/// that estimates is in it, so that the simulated arm and the estimator share no code.

#ifndef ZYGOS_MULTIBODY_H
#define ZYGOS_MULTIBODY_H

#ifndef ZYGOS_DECLARATIONS_ONLY /* The Python binding reads the declarations without the system headers. */
#include <stdint.h>
#endif

/// Forms of a torque law, per unit coefficient, of the rate and the angle x of its side (link, motor after the gear, or
/// motor less link at a spring), with s = shape and w = width. On the base n is 1 and x the angle that it has turned in
/// its plane since the start of the run, and there are the forms ONE, SINCE, SINE and COSINE only.
enum {
    ZYGOS_LAW_ONE,      ///< 1
    ZYGOS_LAW_RATE,     ///< rate
    ZYGOS_LAW_SIZE,     ///< |rate|
    ZYGOS_LAW_SIGN,     ///< rate / w within -1 .. 1
    ZYGOS_LAW_STRIBECK, ///< exp(-(rate / s)^2) times the sign above
    ZYGOS_LAW_LOAD,     ///< tanh(rate / w) |torque through the gear, after it|
    ZYGOS_LAW_REPORTED, ///< reported torque of the motor, before the gear
    ZYGOS_LAW_CUBE,     ///< (motor angle - link angle)^3
    ZYGOS_LAW_GAP,      ///< -(motor angle - link angle), within -s .. s
    ZYGOS_LAW_SINE,     ///< sin(s n x), n the gear ratio
    ZYGOS_LAW_COSINE,   ///< cos(s n x)
    ZYGOS_LAW_SINCE,    ///< 1 from s seconds after the start of the run on, 0 before; on the base only
    ZYGOS_LAW_BRISTLE,  ///< z, where dz = (1 - z sgn dx) dx / s; at joints only
    ZYGOS_LAW_SLIDERS,  ///< mean of ZYGOS_LAW_SLIDING states, of which state k = 1 .. has dz = dx / s times their
                        ///< number over k, up to -1 .. 1; at joints only
};

enum {
    ZYGOS_LAW_SLIDING = 4, ///< States of a law of sliders.
};

/// Where a law acts.
enum {
    ZYGOS_SITE_MOTOR,  ///< against the motor, before the gear
    ZYGOS_SITE_LINK,   ///< against the link
    ZYGOS_SITE_SPRING, ///< beside the spring, on the link; not at a rigid joint
    ZYGOS_SITE_LOAD,   ///< against the motor, as a torque after the gear; behind all others of its joint
    ZYGOS_SITE_TORQUE, ///< with the motor, before the gear
    ZYGOS_SITE_BASE,   ///< on the base
};

/// One law at a joint or on the base.
typedef struct {
    uint32_t joint; ///< From 0; on the base the base axis, 0 of a planar arm.
    uint32_t site;  ///< ZYGOS_SITE_...
    uint32_t form;  ///< ZYGOS_LAW_...
    uint32_t first; ///< Place of its first state in the memory of a piece of motion, where the form has states.
    double value;   ///< Coefficient.
    double shape;
    double width;
} zygos_multibody_law_t;

/// An arm of N joints as its equations of motion know it. Arrays are row-major and stay the caller's.
///
/// Body i turns with joint i, body 0 is the base; angles and rates of motors are after the gear. Each body has
/// directions across its joint's axis: V = 2N of a fixed base, 3 more of a floating one, which come first and are the
/// base's axes.
typedef struct {
    uint32_t joints;   ///< N >= 1.
    uint32_t floating; ///< 1 where the base floats, 0 where it is fixed.
    uint32_t planar;   ///< 1: the closed form of a planar arm that floats, for the last two calls below.
    uint32_t unused;
    const double *turn;    ///< N x 3 x 9: frame of body i in that of body i - 1 is [0] + cos q [1] + sin q [2].
    const double *axis;    ///< N x 3: unit vector of joint i in the frame of body i.
    const double *across;  ///< N x 2 x 3: the two directions of body i in its frame.
    const double *matrix;  ///< V x V, symmetric: the matrix N_ab of the kinetic energy [kg m^2]. Closed form: 3 x
                           ///< (N+1) x (N+1): a_ij symmetric, b_ij antisymmetric, and what rotors add to the inertia.
    const double *moment;  ///< V: first moments that gravity pulls at [kg m].
    const double *gravity; ///< 3: in the base's frame [m/s^2].
    const double *ratio;   ///< N: gear ratios.
    const double *rotor;   ///< N: rotor inertias about the rotors' axes, before the gear [kg m^2].
    const double
        *coupling; ///< N: share of the rotor inertia that the rotation of the carrying body acts on, 1 in nature.
    const uint8_t *rigid; ///< N: 1 where the motor turns with the link, 0 where a spring is between them.
} zygos_multibody_t;

/// Doubles of memory that each of the calls below works in, for an arm of that many joints.
uint64_t zygos_multibody_scratch(uint32_t joints);

/// Accelerations in n states, each on its own. in: n x (6 + 6N): base rate in base axes [rad/s], zero where it is
/// fixed; q [rad]; link rates, motor rates [rad/s]; torque of the springs on the links, not read at a rigid joint;
/// torque on the rotors before the gear; torque on the links besides that of the springs; torque on the base in base
/// axes, not read where it is fixed [Nm]. out: n x (3 + 2N): accelerations of base, links and motors [rad/s^2]; not
/// finite where no inertia resists. scratch: zygos_multibody_scratch() doubles that no other call uses meanwhile.
/// Cost: of the order of N^2 products of vectors.
void zygos_multibody_accelerations(const zygos_multibody_t *self, uint64_t n, const double *in, double *out,
                                   double *scratch);

/// Time derivatives of n states of width + 4N doubles: base rate [rad/s], q, motor angles [rad], link rates, motor
/// rates [rad/s]. width: 3 in base axes; 1 of the closed form; 0 for none, of a fixed base only.
/// force: n x (3N + width): torque of the springs on the links, torque on the rotors before the gear, torque on the
/// links besides that of the springs, torque on the base [Nm]. out: as the states. scratch and cost: as
/// zygos_multibody_accelerations().
void zygos_multibody_rates(const zygos_multibody_t *self, uint64_t n, uint32_t width, const double *state,
                           const double *force, double *out, double *scratch);

/// Integrates n states, as of zygos_multibody_rates(), by that many RK4 steps of step_s seconds under torques on the
/// rotors, n x N before the gear [Nm], that stay constant. spring: stiffness [Nm/rad], then damping [Nms/rad] of the N
/// joints, after the gear; 0 of a rigid one. laws: count laws at joints and on the base. gradient: coefficient of the
/// gravity gradient [1/s^2], of an arm that floats in space; else it does nothing. clock: n x 5: time since the start
/// of the run [s]; the angle [rad] that the base has turned since then in its plane, which stays as it is of an arm in
/// space; the unit vector to the Earth in base axes, which stays as it is without a gradient. memory: n x states of the
/// laws that have states; these are held within a step, and follow in half steps before and behind it. Changes state,
/// clock and memory. scratch: as above. Cost: 4 n steps times that of a state.
void zygos_multibody_advance(const zygos_multibody_t *self, uint64_t n, uint32_t width, const double *spring,
                             const zygos_multibody_law_t *laws, uint32_t count, double gradient, const double *torque,
                             double step_s, uint64_t steps, double *state, double *clock, uint32_t states,
                             double *memory, double *scratch);

#endif
