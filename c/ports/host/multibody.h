/// Host only: the equations of motion of an arm in space, for the simulator. Written for itself: nothing of the library
/// that estimates is in it, so that the simulated arm and the estimator share no code.

#ifndef ZYGOS_MULTIBODY_H
#define ZYGOS_MULTIBODY_H

#ifndef ZYGOS_DECLARATIONS_ONLY /* The Python binding reads the declarations without the system headers. */
#include <stdint.h>
#endif

/// An arm of N joints as its equations of motion know it. Arrays are row-major and stay the caller's.
///
/// Body i turns with joint i, body 0 is the base; angles and rates of motors are after the gear. Each body has
/// directions across its joint's axis: V = 2N of a fixed base, 3 more of a floating one, which come first and are the
/// base's axes.
typedef struct {
    uint32_t joints;       ///< N >= 1.
    uint32_t floating;     ///< 1 where the base floats, 0 where it is fixed.
    const double *turn;    ///< N x 3 x 9: frame of body i in that of body i - 1 is [0] + cos q [1] + sin q [2].
    const double *axis;    ///< N x 3: unit vector of joint i in the frame of body i.
    const double *across;  ///< N x 2 x 3: the two directions of body i in its frame.
    const double *matrix;  ///< V x V, symmetric: the matrix N_ab of the kinetic energy [kg m^2].
    const double *moment;  ///< V: first moments that gravity pulls at [kg m].
    const double *gravity; ///< 3: in the base's frame [m/s^2].
    const double *ratio;   ///< N: gear ratios.
    const double *rotor;   ///< N: rotor inertias about the rotors' axes, before the gear [kg m^2].
    const double
        *coupling; ///< N: share of the rotor inertia that the rotation of the carrying body acts on, 1 in nature.
    const uint8_t *rigid; ///< N: 1 where the motor turns with the link, 0 where a spring is between them.
} zygos_multibody_t;

/// Doubles of memory that zygos_multibody_accelerations() works in, for an arm of that many joints.
uint64_t zygos_multibody_scratch(uint32_t joints);

/// Accelerations in n states, each on its own. in: n x (3 + 6N): base rate in base axes [rad/s], zero where it is
/// fixed; q [rad]; link rates, motor rates [rad/s]; torque of the springs on the links, not read at a rigid joint;
/// torque on the rotors before the gear; torque on the links besides that of the springs [Nm]. out: n x (3 + 2N):
/// accelerations of base, links and motors [rad/s^2]; not finite where no inertia resists. scratch:
/// zygos_multibody_scratch() doubles that no other call uses meanwhile. Cost: of the order of N^2 products of vectors.
void zygos_multibody_accelerations(const zygos_multibody_t *self, uint64_t n, const double *in, double *out,
                                   double *scratch);

#endif
