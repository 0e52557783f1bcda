/* SPDX-License-Identifier: MIT */
/// zygos/types.h: types, capacities and codes that all modules share.
///
/// All quantities are in SI units and radians; a field in another unit has the unit in its name. All angles are those
/// after the gear: the motor angle theta is the angle of the gearbox output (rotor angle divided by the gear ratio), as
/// it is transmitted on the bus.
///
/// The library does not allocate memory, print, lock or recurse, and it has no global variables. The caller owns every
/// struct. The sizes below are compile-time capacities; the numbers in use come from the configuration.

#ifndef ZYGOS_TYPES_H
#define ZYGOS_TYPES_H

#ifndef ZYGOS_DECLARATIONS_ONLY /* The Python binding reads the declarations without the system headers. */
#include <stdbool.h>
#include <stdint.h>
#endif

#ifdef __cplusplus
extern "C" {
#endif

/// The largest number of joints of an arm. A smaller value makes every struct smaller and changes no result.
#ifndef ZYGOS_MAX_JOINTS
#define ZYGOS_MAX_JOINTS 7
#endif
#if (ZYGOS_MAX_JOINTS < 1) || (ZYGOS_MAX_JOINTS > 7)
#error "ZYGOS_MAX_JOINTS must be 1..7"
#endif

/// The largest half width M of the smoother. Its window holds 2 M + 1 cycles.
#ifndef ZYGOS_MAX_HALF_WIDTH
#define ZYGOS_MAX_HALF_WIDTH 15
#endif
#if (ZYGOS_MAX_HALF_WIDTH < 2) || (ZYGOS_MAX_HALF_WIDTH > 31)
#error "ZYGOS_MAX_HALF_WIDTH must be 2..31"
#endif

/// The number of blocks into which the normal equations are divided; they take most of the memory. The standard
/// deviations are computed from the scatter of the blocks. `zygos compile-model` proposes 12 of them, and 8 of motor
/// and of momentum rows: the sigmas are as large on average, but scatter twice as much, and residuals that are not
/// noise show less clearly.
#ifndef ZYGOS_MAX_BLOCKS
#define ZYGOS_MAX_BLOCKS 32
#endif
#if (ZYGOS_MAX_BLOCKS < 11) || (ZYGOS_MAX_BLOCKS > 128)
#error "ZYGOS_MAX_BLOCKS must be 11..128"
#endif

/// The number of complete cycles that may wait for zygos_step(), including the one that it processes.
#ifndef ZYGOS_CYCLE_QUEUE
#define ZYGOS_CYCLE_QUEUE 8
#endif
#if (ZYGOS_CYCLE_QUEUE < 2) || (ZYGOS_CYCLE_QUEUE > 1024)
#error "ZYGOS_CYCLE_QUEUE must be 2..1024"
#endif

/// 1: the build supports arms that move in space. 0: it supports planar arms only, which makes every struct smaller.
#ifndef ZYGOS_SPATIAL
#define ZYGOS_SPATIAL 1
#endif
#if (ZYGOS_SPATIAL != 0) && (ZYGOS_SPATIAL != 1)
#error "ZYGOS_SPATIAL must be 0 or 1"
#endif

/// The largest number of effects that a configuration can identify. With 0 there is no memory for any. The default has
/// room for the offset of the torque, Coulomb and viscous friction at every joint of an arm that moves in space.
#if ZYGOS_SPATIAL && (3 * ZYGOS_MAX_JOINTS > 8)
#define ZYGOS_USUAL_EFFECTS (3 * ZYGOS_MAX_JOINTS)
#else
#define ZYGOS_USUAL_EFFECTS 8
#endif
#ifndef ZYGOS_MAX_EFFECTS
#define ZYGOS_MAX_EFFECTS ZYGOS_USUAL_EFFECTS
#endif
#if (ZYGOS_MAX_EFFECTS < 0) || (ZYGOS_MAX_EFFECTS > 32)
#error "ZYGOS_MAX_EFFECTS must be 0..32"
#endif

/// 1: the build has memory for the normal equations of momentum rows. 0: it has none, which makes every struct smaller.
#ifndef ZYGOS_MOMENTUM
#define ZYGOS_MOMENTUM 1
#endif
#if (ZYGOS_MOMENTUM != 0) && (ZYGOS_MOMENTUM != 1)
#error "ZYGOS_MOMENTUM must be 0 or 1"
#endif

/// The number of blocks of the momentum rows; each block consists of whole arcs. It must be even.
#ifndef ZYGOS_MAX_MOMENTUM_BLOCKS
#define ZYGOS_MAX_MOMENTUM_BLOCKS 16
#endif
#if (ZYGOS_MAX_MOMENTUM_BLOCKS < 4) || (ZYGOS_MAX_MOMENTUM_BLOCKS > 128) || (ZYGOS_MAX_MOMENTUM_BLOCKS % 2 != 0)
#error "ZYGOS_MAX_MOMENTUM_BLOCKS must be even, 4..128"
#endif

/// 1: the build has memory for joint rows. 0: it has none, which makes every struct smaller.
#ifndef ZYGOS_JOINT_ROWS
#define ZYGOS_JOINT_ROWS 1
#endif
#if (ZYGOS_JOINT_ROWS != 0) && (ZYGOS_JOINT_ROWS != 1)
#error "ZYGOS_JOINT_ROWS must be 0 or 1"
#endif

/// The number of blocks of the motor rows; each block consists of whole arcs. It must be even.
#ifndef ZYGOS_MAX_MOTOR_BLOCKS
#define ZYGOS_MAX_MOTOR_BLOCKS 32
#endif
#if (ZYGOS_MAX_MOTOR_BLOCKS < 4) || (ZYGOS_MAX_MOTOR_BLOCKS > 128) || (ZYGOS_MAX_MOTOR_BLOCKS % 2 != 0)
#error "ZYGOS_MAX_MOTOR_BLOCKS must be even, 4..128"
#endif

/// The length of an array of places of blocks: whole words of eight bytes. Motor and momentum rows have one more block,
/// for the open arc.
#if (ZYGOS_MAX_MOTOR_BLOCKS >= ZYGOS_MAX_BLOCKS) && (ZYGOS_MAX_MOTOR_BLOCKS >= ZYGOS_MAX_MOMENTUM_BLOCKS)
#define ZYGOS_ORDER_PLACES ((ZYGOS_MAX_MOTOR_BLOCKS + 8) / 8 * 8)
#elif ZYGOS_MAX_MOMENTUM_BLOCKS >= ZYGOS_MAX_BLOCKS
#define ZYGOS_ORDER_PLACES ((ZYGOS_MAX_MOMENTUM_BLOCKS + 8) / 8 * 8)
#else
#define ZYGOS_ORDER_PLACES ((ZYGOS_MAX_BLOCKS + 7) / 8 * 8)
#endif

/// The number of groups of the joint rows.
#ifndef ZYGOS_JOINT_GROUPS
#define ZYGOS_JOINT_GROUPS 8
#endif
#if (ZYGOS_JOINT_GROUPS < 4) || (ZYGOS_JOINT_GROUPS > 64)
#error "ZYGOS_JOINT_GROUPS must be 4..64"
#endif

#define ZYGOS_MAX_WINDOW (2 * ZYGOS_MAX_HALF_WIDTH + 1)
/// The signals that the smoother filters: q_1 .. q_N, theta_1 .. theta_N, and the base rate about three axes.
#define ZYGOS_MAX_SIGNALS (2 * ZYGOS_MAX_JOINTS + 3)
/// The directions that have a rate vector: three of the base, two of each other body.
#define ZYGOS_MAX_DIRECTIONS (2 * ZYGOS_MAX_JOINTS + 3)
/// The parameters of the bodies. An arm on a free base has the most.
#if ZYGOS_SPATIAL
#define ZYGOS_MAX_BODY ((ZYGOS_MAX_JOINTS + 2) * (2 * ZYGOS_MAX_JOINTS + 3))
#else
#define ZYGOS_MAX_BODY ((ZYGOS_MAX_JOINTS + 1) * (ZYGOS_MAX_JOINTS + 1))
#endif
/// The columns of a row as it is formed: those of the bodies, then rotor inertia, stiffness and damping of each joint,
/// then the coefficients of the effects.
#define ZYGOS_MAX_COLUMNS (ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS + ZYGOS_MAX_EFFECTS)
/// The largest number of parameters that are estimated: as many as columns, or fewer where the configuration reduces
/// the columns to the structurally independent ones (reduction.h). A smaller value makes every struct smaller.
#ifndef ZYGOS_MAX_PARAMETERS
#define ZYGOS_MAX_PARAMETERS ZYGOS_MAX_COLUMNS
#endif
#if (ZYGOS_MAX_PARAMETERS < 2 * ZYGOS_MAX_JOINTS + 3) && (ZYGOS_MAX_PARAMETERS < ZYGOS_MAX_COLUMNS)
#error "ZYGOS_MAX_PARAMETERS must be at least 2 ZYGOS_MAX_JOINTS + 3"
#endif
#if ZYGOS_MAX_PARAMETERS > ZYGOS_MAX_COLUMNS
#error "ZYGOS_MAX_PARAMETERS must be at most the number of columns"
#endif
/// The largest number of entries, other than 0, of the matrix of the reduction. 0: the build has no room for one.
#if ZYGOS_SPATIAL
#define ZYGOS_USUAL_REDUCTION (12 * ZYGOS_MAX_COLUMNS)
#else
#define ZYGOS_USUAL_REDUCTION ZYGOS_MAX_COLUMNS
#endif
#ifndef ZYGOS_MAX_REDUCTION
#define ZYGOS_MAX_REDUCTION ZYGOS_USUAL_REDUCTION
#endif
#if (ZYGOS_MAX_REDUCTION < 0) || (ZYGOS_MAX_REDUCTION > 65535)
#error "ZYGOS_MAX_REDUCTION must be 0..65535"
#endif
/// The length of the array of these entries. C requires at least 1.
#if ZYGOS_MAX_REDUCTION > 0
#define ZYGOS_REDUCTION_PLACES ZYGOS_MAX_REDUCTION
#else
#define ZYGOS_REDUCTION_PLACES 1
#endif
/// The length of an array of effects. C requires at least 1.
#if ZYGOS_MAX_EFFECTS > 0
#define ZYGOS_EFFECT_PLACES ZYGOS_MAX_EFFECTS
#else
#define ZYGOS_EFFECT_PLACES 1
#endif
/// The length of a row that is augmented by the work and by 1.
#define ZYGOS_MAX_ROW (ZYGOS_MAX_PARAMETERS + 2)
#define ZYGOS_MAX_PACKED_ROW (ZYGOS_MAX_ROW * (ZYGOS_MAX_ROW + 1) / 2)
/// The length of the longest row of any kind: those of the momentum are augmented by three constants, and have columns
/// that a reduced energy row may lack; those of a motor have at most thirteen entries.
#if (ZYGOS_MOMENTUM != 0) && (ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS + 3 > ZYGOS_MAX_ROW)
#define ZYGOS_MAX_LONG_ROW (ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS + 3)
#else
#define ZYGOS_MAX_LONG_ROW ZYGOS_MAX_ROW
#endif
#if ZYGOS_MAX_LONG_ROW > 13
#define ZYGOS_MAX_ANY_ROW ZYGOS_MAX_LONG_ROW
#else
#define ZYGOS_MAX_ANY_ROW 13
#endif
/// The length of a row that is augmented by the work alone, because 1 contains no noise.
#define ZYGOS_MAX_NOISE_ROW (ZYGOS_MAX_PARAMETERS + 1)
#define ZYGOS_MAX_PACKED_NOISE (ZYGOS_MAX_NOISE_ROW * (ZYGOS_MAX_NOISE_ROW + 1) / 2)
/// The number of instants whose rows wait in a buffer before their products are added to the blocks, and the number of
/// slices of the matrix in which they are added: two in each cycle, or three where two buffers wait.
#define ZYGOS_BUFFER_ROWS 8
#define ZYGOS_BUFFER_SLICES 16
/// The least number of pairs of entries that hold a row.
#define ZYGOS_MAX_ROW_PAIRS ((ZYGOS_MAX_ROW + 1) / 2)
#define ZYGOS_MAX_PACKED (ZYGOS_MAX_PARAMETERS * (ZYGOS_MAX_PARAMETERS + 1) / 2)

/// A symbol whose name carries the capacities. The library defines it (capacities.c) and every object that includes
/// this header refers to it, so that objects of other capacities than the library's do not link; the message of the
/// linker has the capacities of the object, and `nm libzygos.a` those of the library. Usual: the default that follows
/// from the other capacities. A capacity that is given must be a decimal number. An object that is made for a linker
/// that discards what nothing calls keeps the reference where the compiler knows the attribute retain.
#ifndef ZYGOS_DECLARATIONS_ONLY
#if ZYGOS_MAX_EFFECTS == ZYGOS_USUAL_EFFECTS
#define ZYGOS_NAME_EFFECTS usual
#else
#define ZYGOS_NAME_EFFECTS ZYGOS_MAX_EFFECTS
#endif
#if ZYGOS_MAX_PARAMETERS == ZYGOS_MAX_COLUMNS
#define ZYGOS_NAME_PARAMETERS usual
#else
#define ZYGOS_NAME_PARAMETERS ZYGOS_MAX_PARAMETERS
#endif
#if ZYGOS_MAX_REDUCTION == ZYGOS_USUAL_REDUCTION
#define ZYGOS_NAME_REDUCTION usual
#else
#define ZYGOS_NAME_REDUCTION ZYGOS_MAX_REDUCTION
#endif
#define ZYGOS_NAME(joints, half_width, blocks, queue, spatial, effects, momentum, momentum_blocks, joint_rows,         \
                   parameters, reduction, motor_blocks, groups)                                                        \
    ZYGOS_NAMED(joints, half_width, blocks, queue, spatial, effects, momentum, momentum_blocks, joint_rows,            \
                parameters, reduction, motor_blocks, groups)
#define ZYGOS_NAMED(joints, half_width, blocks, queue, spatial, effects, momentum, momentum_blocks, joint_rows,        \
                    parameters, reduction, motor_blocks, groups)                                                       \
    zygos_capacities_joints_##joints##_half_width_##half_width##_blocks_##blocks##_queue_##queue##_spatial_##spatial##_effects_##effects##_momentum_##momentum##_momentum_blocks_##momentum_blocks##_joint_rows_##joint_rows##_parameters_##parameters##_reduction_##reduction##_motor_blocks_##motor_blocks##_groups_##groups
#define ZYGOS_CAPACITIES                                                                                               \
    ZYGOS_NAME(ZYGOS_MAX_JOINTS, ZYGOS_MAX_HALF_WIDTH, ZYGOS_MAX_BLOCKS, ZYGOS_CYCLE_QUEUE, ZYGOS_SPATIAL,             \
               ZYGOS_NAME_EFFECTS, ZYGOS_MOMENTUM, ZYGOS_MAX_MOMENTUM_BLOCKS, ZYGOS_JOINT_ROWS, ZYGOS_NAME_PARAMETERS, \
               ZYGOS_NAME_REDUCTION, ZYGOS_MAX_MOTOR_BLOCKS, ZYGOS_JOINT_GROUPS)
#if defined(__has_attribute) && defined(__linux__)
#if __has_attribute(retain)
#define ZYGOS_KEPT __attribute__((used, retain))
#endif
#endif
#ifndef ZYGOS_KEPT
#define ZYGOS_KEPT __attribute__((used))
#endif
extern const unsigned char ZYGOS_CAPACITIES;
static const unsigned char *const zygos_capacities_used ZYGOS_KEPT = &ZYGOS_CAPACITIES;
#endif

/* A reading that is not a number must be seen, and sums must be added in the order that is written. Compilers tell some
   of the flags that break this; zygos_init() finds the others. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "zygos needs IEEE arithmetic; remedy: compile without -ffast-math and -ffinite-math-only"
#endif
#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "zygos needs IEEE arithmetic; remedy: compile without -funsafe-math-optimizations and what it contains"
#endif

#define ZYGOS_VERSION_MAJOR 0
#define ZYGOS_VERSION_MINOR 2
#define ZYGOS_VERSION_PATCH 0

/// The largest number of instants that a double counts exactly.
#define ZYGOS_MAX_INSTANTS 9007199254740992.0

/// The least number of arcs of motor or momentum rows. The scatter of fewer arcs is too uncertain: such rows are not
/// used, and blocks do not merge below this number.
#define ZYGOS_MIN_ARCS 3u

/// A block of closed arcs is emptied when exponential forgetting has reduced it to fewer instants than this.
#define ZYGOS_NEGLIGIBLE_INSTANTS 1e-6

/// An arc with fewer accepted instants than this is dropped and counted.
#define ZYGOS_MIN_ARC_INSTANTS 20

/// The codes that a call returns when it was misused. Such a call has changed nothing. Faults of the bus and of the
/// sensors are counted (zygos_faults_t) and never returned. zygos_text() has the codes in words.
enum zygos_error {
    ZYGOS_E_NULL = -1,       ///< A required pointer is null.
    ZYGOS_E_ABI = -2,        ///< The caller was compiled with other headers or capacities than the library.
    ZYGOS_E_JOINTS = -3,     ///< joints is 0 or above ZYGOS_MAX_JOINTS.
    ZYGOS_E_KINETIC = -4,    ///< This build has no columns for that value of kinetic.
    ZYGOS_E_PERIOD = -5,     ///< period_s is not within 1e-5 .. 0.065.
    ZYGOS_E_TORQUE_LAW = -6, ///< torque_law is no value of enum zygos_torque_law.
    ZYGOS_E_SMOOTHER = -7,   ///< The half width, order or lag is out of range; a filter at the end point is refused.
    ZYGOS_E_NODE = -8,       ///< A node number is not within 1..31 or is used twice; node 32 is the flight computer.
    ZYGOS_E_AXIS = -9,    ///< A joint axis is no unit vector, a frame of a spatial arm is no rotation, or an axis of a
                          ///< planar arm is not parallel to the first one.
    ZYGOS_E_VALUE = -10,  ///< A ratio, sign, zero, sigma, latch delay, forgetting_factor, compensation, imu_fine or
                          ///< imu_to_base is not in its range.
    ZYGOS_E_ARC = -11,    ///< arc_cycles, impulse_arc_cycles or momentum_arc_cycles is below ZYGOS_MIN_ARC_INSTANTS,
                          ///< joint_row_cycles is odd or too short, or this build has no room for such rows.
    ZYGOS_E_ORDER = -12,  ///< zygos_init() or zygos_resume() has not succeeded on this struct.
    ZYGOS_E_KEEP = -13,   ///< zygos_restart() was given an unknown bit, or there are no motor rows to keep.
    ZYGOS_E_EFFECT = -14, ///< There are too many effects, an effect has an unknown kind or joint or is listed twice, or
                          ///< an effect of a spring belongs to a rigid joint.
    ZYGOS_E_BASE = -15,   ///< base is no value of enum zygos_base, or gravity, gyro or momentum rows do not fit it.
    ZYGOS_E_SNAPSHOT = -16,   ///< The bytes are no snapshot, or not even a complete head of one.
    ZYGOS_E_FORMAT = -17,     ///< The snapshot has a format that this build does not read.
    ZYGOS_E_KIND = -18,       ///< The snapshot is of another kind, or the kind is unknown.
    ZYGOS_E_BYTE_ORDER = -19, ///< The snapshot was written on a machine of the other byte order.
    ZYGOS_E_LAYOUT = -20,     ///< The snapshot was written by a build with other capacities, structs or version.
    ZYGOS_E_LENGTH = -21,     ///< The snapshot is cut off, or more bytes follow it.
    ZYGOS_E_CRC = -22,        ///< Bytes of the snapshot were changed.
    ZYGOS_E_CONFIG = -23,     ///< The state was made with another configuration.
    ZYGOS_E_STATE = -24, ///< The state contains an impossible index, count or length: memory was changed. In a stored
                         ///< state, it was changed before the state was sealed.
    ZYGOS_E_SUMS = -25,  ///< The sums of the state do not match their row sums: memory was changed, as above.
    ZYGOS_E_REDUCTION = -26, ///< The reduction is out of order or out of range, leaves a parameter without a column, is
                             ///< no selection on a free base, or does not select Im, k and b of a flexible joint.
    ZYGOS_E_MEMORY = -28,    ///< The memory for solutions is smaller than a zygos_in_place_t.
    ZYGOS_E_ARITHMETIC = -27 ///< The library was compiled with flags that break IEEE arithmetic, such as
                             ///< -ffinite-math-only, -fno-honor-nans or -funsafe-math-optimizations.
};

/// How the arm can move. This decides which columns its bodies have; the numbers are those of a free base.
enum zygos_kinetic {
    ZYGOS_PLANAR_SYMMETRIC =
        0,                ///< Parallel axes, centres of mass on the lines between the joints: (N+1)(N+2)/2 columns.
    ZYGOS_PLANAR = 1,     ///< Parallel axes: (N+1)^2 columns.
    ZYGOS_SPATIAL_ARM = 2 ///< Any axes: (N+2)(2N+3) columns.
};
/// The last one that this build has.
#define ZYGOS_LAST_KINETIC ((ZYGOS_SPATIAL != 0) ? ZYGOS_SPATIAL_ARM : ZYGOS_PLANAR)

/// How the base can move.
enum zygos_base {
    ZYGOS_BASE_FREE = 0, ///< The base floats; a gyro measures its rate, and there is no gravity.
    ZYGOS_BASE_FIXED =
        1 ///< The base does not move; there is no gyro, and gravity is configured. Body 0 has no columns.
};

/// Which torque acts on [t_k, t_k+1), where r_k is the torque reported in cycle k.
enum zygos_torque_law {
    ZYGOS_TORQUE_APPLIED_FROM_SYNC = 0,      ///< r_k: a command takes effect at the SYNC that opens its cycle.
    ZYGOS_TORQUE_APPLIED_PREVIOUS_CYCLE = 1, ///< r_k+1: the drive reports the torque of the past cycle.
    ZYGOS_TORQUE_SAMPLED = 2                 ///< (r_k + r_k+1)/2: the torque varies and is sampled at each SYNC.
};

/// Effects that can be identified in addition to rigid bodies, rotors, linear springs and dampers. Each has one
/// coefficient.
enum zygos_effect_kind {
    ZYGOS_MOTOR_COULOMB = 0, ///< Coulomb friction of a rotor [Nm], before the gear.
    ZYGOS_MOTOR_VISCOUS = 1, ///< Viscous friction of a rotor [Nms/rad]: the torque before the gear, the rate after it.
    ZYGOS_LINK_COULOMB = 2,  ///< Coulomb friction between a link and the body that carries it [Nm].
    ZYGOS_CUBIC_STIFFNESS = 3, ///< Spring torque proportional to the cube of the deflection [Nm/rad^3].
    ZYGOS_TORQUE_LAG = 4,      ///< Delay of the motor torque behind the torque of the law [s], less than a period.
    ZYGOS_SPRING_OFFSET = 5,   ///< Spring torque at theta = q [Nm]: -k times the error of the reading theta - q.
    ZYGOS_TORQUE_OFFSET =
        6, ///< Constant by which the reported rotor torque exceeds the true one [Nm], before the gear.
    ZYGOS_VISCOUS_ASYMMETRY =
        7,                ///< Half of the difference of a rotor's viscous friction between the directions [Nms/rad].
    ZYGOS_TORQUE_GAIN = 8 ///< Share by which the motor's torque exceeds the reported one, beside that of the joints
                          ///< without this effect, of which there is at least one. Its prior: torque_gain_sigma.
};

/// Their number.
#define ZYGOS_EFFECT_KINDS 9

/// One effect to identify.
typedef struct {
    uint32_t kind;  ///< enum zygos_effect_kind.
    uint32_t joint; ///< The index of the joint, 0..N-1.
} zygos_effect_config_t;

/// The hardware of one joint, from the base outwards. The standard deviation of an encoder with n steps per turn is 2
/// pi / n divided by the root of 12; add in squares that of the steps of a CAN frame, for n = 2^20, unless the steps of
/// both are the same. Angles and their deviations are those after the gear: divide those of a rotor's encoder by the
/// ratio.
typedef struct {
    uint32_t node;     ///< CANopen-style node number of the joint's drive, 1..31.
    uint32_t latch_us; ///< Delay from SYNC to the latch of the encoders, as the drive transmits it.
    uint32_t rigid;    ///< 1: theta = q, measured by the motor encoder; no stiffness and no damping. 0: flexible.
    uint32_t reserved;
    double frame[9]; ///< Rotation from the joint's frame to that of the preceding body at q = 0, row-major. It is
                     ///< not used for a planar arm. The body behind the joint has the joint's frame.
    double axis[3];  ///< Unit vector of the joint axis in the joint's frame; those of a planar arm have one direction.
    double gear_ratio;      ///< Rotor turns per output turn, 1e-3 .. 1e6.
    double link_sign;       ///< +1 or -1: angle = sign * (reading - zero).
    double link_zero_rad;   ///< Reading of the link encoder where q = 0, within +-1000.
    double link_sigma_rad;  ///< Standard deviation of the link encoder's noise, 0 .. 1; 0 switches its bandwidth test
                            ///< and the compensation of its noise off.
    double link_latch_s;    ///< Delay of the link encoder's latch, in addition to latch_us; together 0 .. period_s.
    double motor_sign;      ///< The same as link_sign, for the motor encoder.
    double motor_zero_rad;  ///< Reading of the motor encoder where theta = 0, likewise.
    double motor_sigma_rad; ///< The same as link_sigma_rad, for the motor encoder.
    double motor_latch_s;   ///< The same as link_latch_s, for the motor encoder.
    double torque_sigma; ///< Standard deviation of the torque's noise, after the gear [Nm], 0 .. 1e6; 0: not declared.
    double torque_relative_sigma; ///< The same as a share of its size, 0 .. 1. Both add in squares.
    double torque_gain_sigma;     ///< Standard deviation of the error of the torque sensor's gain, 0 .. 1. A joint with
                                  ///< ZYGOS_TORQUE_GAIN needs it above 0.
} zygos_joint_config_t;

/// One entry of the matrix that reduces columns to parameters (reduction.h).
typedef struct {
    uint32_t column;    ///< Index of a column as it is formed, without those of the effects.
    uint32_t parameter; ///< Index of the parameter that it counts for.
    double factor;      ///< By which the column is multiplied, not 0.
} zygos_reduction_t;

/// Everything the library has to know of the hardware. It contains no mass, length or stiffness: those are estimated.
typedef struct {
    uint32_t abi;                 ///< Set it to ZYGOS_ABI.
    uint32_t joints;              ///< N, 1..ZYGOS_MAX_JOINTS.
    uint32_t kinetic;             ///< enum zygos_kinetic.
    uint32_t torque_law;          ///< enum zygos_torque_law. No other field has as large an effect when it is wrong.
    uint32_t smoother_half_width; ///< M >= 2: the window holds the 2 M + 1 cycles around the smoothed instant.
    uint32_t smoother_order;      ///< Order of the local polynomial, 2 .. 2 M - 2.
    uint32_t smoother_lag;        ///< Must equal M: a filter that is evaluated at its newest sample is refused.
    uint32_t arc_cycles;          ///< The longest arc of energy rows in instants, >= ZYGOS_MIN_ARC_INSTANTS. From an
                                  ///< eighth of it on, an instant that the bandwidth test refuses ends the arc. 0: no
                                  ///< such rows, where the joint rows alone determine the estimate (jointsums.h).
    double forgetting_factor;     ///< Factor by which the sums of closed arcs are multiplied in each cycle, 0.9 .. 1; 1
                                  ///< forgets nothing. It is applied when an arc ends.
    uint32_t imu_node;            ///< Node number of the gyro, 1..31; 0 on a fixed base, which has no gyro.
    uint32_t imu_fine;            ///< 1: the rates are sent as i24 in two frames; 0: as i16 in one frame.
    double period_s; ///< SYNC period h, 1e-5 .. 0.065. The time is the SYNC count times h; receive times are not used.
    double imu_to_base[9]; ///< Rotation from the axes of the gyro to those of the base, row-major, orthonormal within
                           ///< 1e-9.
    double imu_latch_s;    ///< Delay from SYNC to the gyro's latch, 0 .. period_s.
    double imu_sigma;      ///< Standard deviation of the noise of one component [rad/s], 0 .. 1; 0: not declared.
    double gravity[3];     ///< Gravity in the base frame [m/s^2]; 0 on a free base.
    zygos_joint_config_t joint[ZYGOS_MAX_JOINTS]; ///< From the base outwards.
    uint32_t compensation; ///< The bias of the normal equations by the declared noise is subtracted. 0: it is not; m,
                           ///< 1..2 ZYGOS_MAX_JOINTS + 3: each sensor's part is computed in every m-th cycle, and that
                           ///< of each axis of the gyro.
    uint32_t impulse_arc_cycles;  ///< Length of the arcs of motor rows, >= ZYGOS_MIN_ARC_INSTANTS, usually 10 s; 0: no
                                  ///< such rows.
    uint32_t effects;             ///< Number of effects to identify, 0..ZYGOS_MAX_EFFECTS.
    uint32_t base;                ///< enum zygos_base.
    uint32_t momentum_arc_cycles; ///< Length of the arcs of momentum rows of a free base, likewise; 0: no such rows.
    uint32_t joint_row_cycles;    ///< Length of the increments of joint rows, even, at least 8 and at least twice the
                                  ///< number of joints plus 4, usually 0.1 to 0.2 s; 0: no such rows.
    zygos_effect_config_t
        effect[ZYGOS_EFFECT_PLACES]; ///< In the order of their columns, behind b of the last joint; each kind at most
                                     ///< once for a joint. Each effect makes the other parameters less certain.
    uint32_t reduced;    ///< Number of parameters without those of effects; 0: as many as columns, no reduction.
    uint32_t reductions; ///< Number of entries of the reduction.
    zygos_reduction_t reduction[ZYGOS_REDUCTION_PLACES]; ///< By column, then by parameter, both ascending.
} zygos_config_t;

/// Bits of the argument of zygos_restart().
enum zygos_keep {
    ZYGOS_KEEP_NOTHING = 0,
    ZYGOS_KEEP_FAULTS = 1, ///< The counters of faults, gaps and wraps are kept.
    ZYGOS_KEEP_JOINTS = 2  ///< The sums of the motor rows are kept, which determine Im, k and b: a payload does not
                           ///< change these. Where memory was changed so that they cannot be read, they are cleared.
};

/// Bits of zygos_cycle_t.flags. With ZYGOS_CYCLE_VOID, the bits from ZYGOS_CYCLE_VOID_SHIFT upwards are the number of
/// cycles before this one that cannot be trusted: every arc that contains one of them is dropped. The number 0 means
/// the open arc, whatever its length.
#define ZYGOS_CYCLE_VOID_SHIFT 8
enum zygos_cycle_flag {
    ZYGOS_CYCLE_BREAK = 1,   ///< The cycle does not continue the one before it: the arc ends before this cycle.
    ZYGOS_CYCLE_INVALID = 2, ///< The values must not be used: the cycle is dropped and counted, and the arc ends.
    ZYGOS_CYCLE_VOID = 4     ///< The arc ends, and every arc that contains one of the cycles above is dropped.
};

/// The readings of one SYNC cycle in SI units, before signs, zeros and mounting are applied.
typedef struct {
    uint64_t sync;                  ///< Cycle number since init. Any increment other than 1 ends the arc.
    uint32_t flags;                 ///< Bits of enum zygos_cycle_flag.
    uint32_t reserved;              ///< 0.
    double q[ZYGOS_MAX_JOINTS];     ///< Link encoder [rad]. Not used for a rigid joint.
    double theta[ZYGOS_MAX_JOINTS]; ///< Motor encoder, after the gear [rad].
    double tau[ZYGOS_MAX_JOINTS];   ///< Rotor torque, before the gear [Nm].
    double omega[3];                ///< Gyro, in the axes of the sensor [rad/s]. Not used on a fixed base.
} zygos_cycle_t;

/* ---------------------------------------------------------------- estimates */

/// How far an estimate can be used.
enum zygos_validity {
    ZYGOS_REFUSED = 0,  ///< There are no values.
    ZYGOS_DOUBTFUL = 1, ///< There are values, but the reason says why they must not be trusted.
    ZYGOS_PARTIAL = 2,  ///< Some parameters are not identifiable yet; the others have values.
    ZYGOS_VALID = 3     ///< Every parameter has a value and a sigma.
};

/// Why an estimate is not valid.
enum zygos_reason {
    ZYGOS_REASON_NONE = 0,    ///< The estimate is valid.
    ZYGOS_REASON_NO_DATA = 1, ///< Fewer than three accepted instants for each parameter, or too few blocks.
    ZYGOS_REASON_NOT_IDENTIFIABLE =
        2, ///< The motion does not determine every parameter, as rank or sigmas show, or the
           ///< arm is at rest: move every joint, and those most whose parameters are missing.
    ZYGOS_REASON_TOO_FAST =
        3, ///< More than 5 % of the instants failed the bandwidth test: sample faster or move slower.
    ZYGOS_REASON_NOT_PHYSICAL = 4, ///< The bodies' inertia less the rotors' is not positive definite, Im, k or b is not
                                   ///< positive, or a friction or lag is negative, by more than ZYGOS_NEGATIVE_SIGMAS:
                                   ///< wait, or check signs, ratios and the torque law.
    ZYGOS_REASON_CORRUPT = 5,      ///< Row sums or counts do not match: memory was changed. zygos_step() repairs them.
    ZYGOS_REASON_UNCLOSED = 6, ///< The residuals are not noise (ZYGOS_CLUSTER_LIMIT): the balance does not close. Check
                               ///< ratios, zeros, signs and the torque law; friction that is not configured as an
                               ///< effect and torques on the base have the same result.
    ZYGOS_REASON_DECLARED = 8, ///< The declared noise is not in the data (ZYGOS_NOISE_ABSENT): declare the actual one.
    ZYGOS_REASON_NOISE = 7,   ///< Noise is as large as the motion in some combination (ZYGOS_MIN_SIGNAL_TO_NOISE): move
                              ///< more, or declare the actual noise of the sensors.
    ZYGOS_REASON_CHANGED = 9, ///< Several consecutive newest arcs contradict the values (guard.h), which are those
                              ///< before a change, or an arc differed from those before, and the values are of both:
                              ///< call zygos_restart(). Where a sensor fails for a while, the first disappears when
                              ///< arcs agree again.
    ZYGOS_REASON_UNEXPLAINED = 10, ///< The residuals are not noise, and exceed ZYGOS_UNEXPLAINED_LIMIT: see
                                   ///< ZYGOS_REASON_UNCLOSED; more motion does not help.
    ZYGOS_REASON_GAIN = 11, ///< The gain of a torque sensor differs from what is declared of it (ZYGOS_GAIN_SIGMAS):
                            ///< calibrate it, or declare it as that uncertain (torque_gain_sigma).
    ZYGOS_REASON_OLD = 12   ///< No row was added for longer than an arc: the values are of the arm as it was then.
};

/// The kinds of rows, each with arcs of its own. Where joint rows alone determine the estimate, they have the place of
/// the energy rows.
enum zygos_rows { ZYGOS_ENERGY_ROWS = 0, ZYGOS_MOTOR_ROWS = 1, ZYGOS_MOMENTUM_ROWS = 2, ZYGOS_KINDS_OF_ROWS = 3 };

/// Where a solution is (zygos_t.stage). The background moves it from idle to asked and from given to solved, the task
/// moves it on. Each bit is there three times, two places apart, and is what two of them say.
enum zygos_stage {
    ZYGOS_STAGE_IDLE = 0,
    ZYGOS_STAGE_ASKED = 21, ///< The task copies the sums.
    ZYGOS_STAGE_GIVEN = 42, ///< The copy belongs to the background.
    ZYGOS_STAGE_SOLVED = 63 ///< The estimate waits to be adopted.
};

/// An estimate of all parameters.
typedef struct {
    uint64_t cycle;    ///< SYNC number of the newest cycle in the sums.
    uint64_t accepted; ///< Number of instants in the sums.
    uint64_t refused;  ///< Number of instants that failed the bandwidth test.
    uint64_t since; ///< 0, or only arcs after this cycle were used, because older ones were bad (zygos_work_solve()).
    uint32_t parameters; ///< p.
    uint32_t validity;   ///< enum zygos_validity.
    uint32_t reason;     ///< enum zygos_reason.
    uint32_t arcs;       ///< Number of arcs in the sums, including the open one; segments, of joint rows alone.
    uint32_t blocks;     ///< Number of blocks from which the sigmas are computed; groups, of joint rows alone.
    uint32_t rank;       ///< Number of independent columns.
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS]; ///< Number of excluded arcs, by enum zygos_rows, including open ones.
    uint32_t consecutive;                   ///< Number of consecutive newest arcs of energy rows that were excluded.
    uint32_t changed;  ///< 1: an arc differed from those before by more than noise, and these are in the sums (doubtful
                       ///< with ZYGOS_REASON_CHANGED, by zygos_solve() alone).
    uint32_t restored; ///< 1: some of the sums are of a stored state (zygos_resume()).
    uint64_t unused;   ///< Number of SYNCs since a row was added last (zygos_solve() alone tells).
    double condition;  ///< 1-norm condition of the scaled normal matrix of the independent columns.
    double cluster;    ///< The statistic of ZYGOS_CLUSTER_LIMIT: around 1 for noise, at most the instants of a block.
    double residual;   ///< Root mean square of W - row . x without the constants of the arcs [J]; where joint rows
                       ///< alone are solved, of these [Nms], divided by the torque's deviation if all are declared.
    double noise_ratio; ///< Square of residual over the share of the declared noise in it; NaN where none is declared.
    double signal_to_noise; ///< The ratio of ZYGOS_MIN_SIGNAL_TO_NOISE; infinite where no noise is declared.
    uint32_t identifiable[ZYGOS_MAX_PARAMETERS]; ///< 1; or 0, and value and sigma are NaN.
    /// The least squares solution for all columns, 0 for dependent columns; NaN when refused. As a whole it predicts
    /// the energy of motions like those that it was estimated from. A single entry is meaningful only where value has
    /// it, too.
    double solution[ZYGOS_MAX_PARAMETERS];
    double value[ZYGOS_MAX_PARAMETERS];
    double sigma[ZYGOS_MAX_PARAMETERS];  ///< One standard deviation: scatter of the blocks, a floor that does not
                                         ///< average out (ZYGOS_SYSTEMATIC), and the noise of the torques (balance.h).
    double half95[ZYGOS_MAX_PARAMETERS]; ///< Half width of the 95 % interval: sigma times Student's factor for the
                                         ///< effective number of blocks of the parameter.
    double covariance[ZYGOS_MAX_PACKED]; ///< Lower triangle by rows, of all that is in sigma; NaN where a parameter has
                                         ///< no value. Positive semi-definite among those that have one.
} zygos_estimate_t;

#ifdef __cplusplus
}
#endif
#endif
