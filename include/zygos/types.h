/// zygos/types.h: the vocabulary that all rooms share.
///
/// SI units and radians throughout; a field that is not SI carries its unit in its name. Angles are link-side: the
/// motor angle theta is the gearbox output angle (rotor angle divided by the gear ratio), as it is on the wire.
///
/// Nothing in zygos allocates, prints, locks, recurses or keeps a global. The caller owns every struct. Counts and
/// sizes below are compile-time capacities; the numbers in use come from the configuration.

#ifndef ZYGOS_TYPES_H
#define ZYGOS_TYPES_H

#ifndef ZYGOS_DECLARATIONS_ONLY /* The Python binding reads the declarations without the system headers. */
#include <stdbool.h>
#include <stdint.h>
#endif

#ifdef __cplusplus
extern "C" {
#endif

/// Largest number of joints a build can hold. A smaller value makes every struct smaller and changes no result.
#ifndef ZYGOS_MAX_JOINTS
#define ZYGOS_MAX_JOINTS 7
#endif
#if (ZYGOS_MAX_JOINTS < 1) || (ZYGOS_MAX_JOINTS > 7)
#error "ZYGOS_MAX_JOINTS must be 1..7"
#endif

/// Largest half width M of the smoother; its window holds 2 M + 1 cycles.
#ifndef ZYGOS_MAX_HALF_WIDTH
#define ZYGOS_MAX_HALF_WIDTH 15
#endif
#if (ZYGOS_MAX_HALF_WIDTH < 2) || (ZYGOS_MAX_HALF_WIDTH > 31)
#error "ZYGOS_MAX_HALF_WIDTH must be 2..31"
#endif

/// Number of blocks in which the normal equations are kept; the spread of the blocks gives the sigmas. Even.
#ifndef ZYGOS_MAX_BLOCKS
#define ZYGOS_MAX_BLOCKS 64
#endif
#if (ZYGOS_MAX_BLOCKS < 8) || (ZYGOS_MAX_BLOCKS > 256) || (ZYGOS_MAX_BLOCKS % 2 != 0)
#error "ZYGOS_MAX_BLOCKS must be even, 8..256"
#endif

/// Complete cycles that may wait between zygos_frame() and zygos_step(), with the one being worked off.
#ifndef ZYGOS_CYCLE_QUEUE
#define ZYGOS_CYCLE_QUEUE 8
#endif
#if (ZYGOS_CYCLE_QUEUE < 2) || (ZYGOS_CYCLE_QUEUE > 1024)
#error "ZYGOS_CYCLE_QUEUE must be 2..1024"
#endif

/// Largest number of effects that a configuration can switch on. At 0 the library has no room for any.
#ifndef ZYGOS_MAX_EFFECTS
#define ZYGOS_MAX_EFFECTS 8
#endif
#if (ZYGOS_MAX_EFFECTS < 0) || (ZYGOS_MAX_EFFECTS > 16)
#error "ZYGOS_MAX_EFFECTS must be 0..16"
#endif

/// 1: the build has columns for arms that move in space; 0: for planar ones only, which makes every struct smaller.
#ifndef ZYGOS_SPATIAL
#define ZYGOS_SPATIAL 1
#endif
#if (ZYGOS_SPATIAL != 0) && (ZYGOS_SPATIAL != 1)
#error "ZYGOS_SPATIAL must be 0 or 1"
#endif

/// 1: the build has room for the sums of momentum rows; 0: it has none, which makes every struct smaller.
#ifndef ZYGOS_MOMENTUM
#define ZYGOS_MOMENTUM 1
#endif
#if (ZYGOS_MOMENTUM != 0) && (ZYGOS_MOMENTUM != 1)
#error "ZYGOS_MOMENTUM must be 0 or 1"
#endif

/// Number of blocks in which they are kept, of whole arcs each. Even.
#ifndef ZYGOS_MAX_MOMENTUM_BLOCKS
#define ZYGOS_MAX_MOMENTUM_BLOCKS 16
#endif
#if (ZYGOS_MAX_MOMENTUM_BLOCKS < 4) || (ZYGOS_MAX_MOMENTUM_BLOCKS > 256) || (ZYGOS_MAX_MOMENTUM_BLOCKS % 2 != 0)
#error "ZYGOS_MAX_MOMENTUM_BLOCKS must be even, 4..256"
#endif

#define ZYGOS_MAX_WINDOW (2 * ZYGOS_MAX_HALF_WIDTH + 1)
/// Signals the smoother filters: q_1 .. q_N, theta_1 .. theta_N, and the base rate about three axes.
#define ZYGOS_MAX_SIGNALS (2 * ZYGOS_MAX_JOINTS + 3)
/// Directions that rate vectors belong to: three of the base, two of each other body.
#define ZYGOS_MAX_DIRECTIONS (2 * ZYGOS_MAX_JOINTS + 3)
/// Parameters of the bodies: at the most those of a free-floating arm.
#if ZYGOS_SPATIAL
#define ZYGOS_MAX_BODY ((ZYGOS_MAX_JOINTS + 2) * (2 * ZYGOS_MAX_JOINTS + 3))
#else
#define ZYGOS_MAX_BODY ((ZYGOS_MAX_JOINTS + 1) * (ZYGOS_MAX_JOINTS + 1))
#endif
/// Parameters: those of the bodies, then rotor inertia, stiffness and damping of each joint, then the effects.
#define ZYGOS_MAX_PARAMETERS (ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS + ZYGOS_MAX_EFFECTS)
/// Length of an array of effects, which C wants to be at least 1.
#if ZYGOS_MAX_EFFECTS > 0
#define ZYGOS_EFFECT_PLACES ZYGOS_MAX_EFFECTS
#else
#define ZYGOS_EFFECT_PLACES 1
#endif
/// A row, augmented by the work and by 1.
#define ZYGOS_MAX_ROW (ZYGOS_MAX_PARAMETERS + 2)
#define ZYGOS_MAX_PACKED_ROW (ZYGOS_MAX_ROW * (ZYGOS_MAX_ROW + 1) / 2)
/// Instants that are summed before they are shared out in as many slices, and both with the last slice filled up.
#define ZYGOS_BUFFER_ROWS 8
#define ZYGOS_MAX_SLICED_ROW (ZYGOS_MAX_ROW + 2 * ZYGOS_BUFFER_ROWS)
#define ZYGOS_MAX_SLICED_GRAM (ZYGOS_MAX_PACKED_ROW + 2 * ZYGOS_BUFFER_ROWS)
#define ZYGOS_MAX_PACKED (ZYGOS_MAX_PARAMETERS * (ZYGOS_MAX_PARAMETERS + 1) / 2)

#ifdef __FAST_MATH__
#error "zygos needs IEEE arithmetic; remedy: compile without -ffast-math"
#endif

#define ZYGOS_VERSION_MAJOR 0
#define ZYGOS_VERSION_MINOR 1

/// Doubles count instants as far.
#define ZYGOS_MAX_INSTANTS 9007199254740992.0

/// Of fewer arcs of motor or momentum rows the spread says too little: they are left out, and no more of them merge.
#define ZYGOS_MIN_ARCS 3u

/// A block of closed arcs of which forgetting has left fewer instants than this is emptied.
#define ZYGOS_NEGLIGIBLE_INSTANTS 1e-6

/// Arcs with fewer accepted instants than this carry no weight: they are dropped and counted.
#define ZYGOS_MIN_ARC_INSTANTS 20

/// What a call that was misused returns. The call has changed nothing. Faults of the world are counted, never returned.
enum zygos_error {
    ZYGOS_E_NULL = -1,       ///< A required pointer is null.
    ZYGOS_E_ABI = -2,        ///< The caller was compiled with other headers or capacities than the library.
    ZYGOS_E_JOINTS = -3,     ///< joints is 0 or above ZYGOS_MAX_JOINTS.
    ZYGOS_E_KINETIC = -4,    ///< This build has no columns of that kind.
    ZYGOS_E_PERIOD = -5,     ///< period_s is not within 1e-5 .. 0.065.
    ZYGOS_E_TORQUE_LAW = -6, ///< torque_law is none of enum zygos_torque_law.
    ZYGOS_E_SMOOTHER = -7,   ///< Half width, order or lag out of range; end-point filters are refused.
    ZYGOS_E_NODE = -8,       ///< A node number is 0, above 31, or used twice (node numbers 1..31, 32 is the computer).
    ZYGOS_E_AXIS = -9, ///< A joint axis is no unit vector, of a spatial arm a frame no rotation, or of a planar one an
                       ///< axis not parallel.
    ZYGOS_E_VALUE = -10,  ///< A ratio, sign, zero, sigma, latch delay, keep, compensation, imu_fine or imu_to_base is
                          ///< not in its range.
    ZYGOS_E_ARC = -11,    ///< arc_cycles, impulse_arc_cycles or momentum_arc_cycles is below ZYGOS_MIN_ARC_INSTANTS, or
                          ///< this build has no room for momentum rows.
    ZYGOS_E_ORDER = -12,  ///< zygos_init() has not succeeded on this struct.
    ZYGOS_E_KEEP = -13,   ///< zygos_restart() does not know one of the bits, or there are no motor rows to keep.
    ZYGOS_E_EFFECT = -14, ///< Too many effects, an unknown kind, a joint out of range, an effect twice, or one of the
                          ///< spring of a rigid joint.
    ZYGOS_E_BASE = -15,   ///< base is none of enum zygos_base, or gravity, a gyro or momentum rows do not fit it.
    ZYGOS_E_SNAPSHOT = -16,   ///< No snapshot, or not even a whole head of one.
    ZYGOS_E_FORMAT = -17,     ///< A snapshot of a format that this build does not read.
    ZYGOS_E_KIND = -18,       ///< A snapshot of another kind, or a kind that there is not.
    ZYGOS_E_BYTE_ORDER = -19, ///< A snapshot from a machine of the other byte order.
    ZYGOS_E_LAYOUT = -20,     ///< A snapshot from a build with other capacities, structs or version.
    ZYGOS_E_LENGTH = -21,     ///< A snapshot that is cut off, or has more behind it.
    ZYGOS_E_CRC = -22,        ///< A snapshot whose bytes were changed.
    ZYGOS_E_CONFIG = -23,     ///< A state that was made with another configuration.
    ZYGOS_E_STATE = -24, ///< A state with a place, count or length that cannot be: memory was changed before it was
                         ///< sealed.
    ZYGOS_E_SUMS = -25   ///< A state whose sums do not match their row sums: likewise.
};

/// How the arm can move, and so which columns its bodies have; the counts are those of a free base.
enum zygos_kinetic {
    ZYGOS_PLANAR_SYMMETRIC = 0, ///< Parallel axes, centres of mass on the joint-to-joint lines: (N+1)(N+2)/2 columns.
    ZYGOS_PLANAR = 1,           ///< Parallel axes: (N+1)^2 columns.
    ZYGOS_SPATIAL_ARM = 2       ///< Any axes: (N+2)(2N+3) columns.
};

enum zygos_base {
    ZYGOS_BASE_FREE = 0, ///< Floats: a gyro tells its rate, no gravity.
    ZYGOS_BASE_FIXED = 1 ///< Stands: no gyro, gravity as configured. The columns of body 0 are left out.
};

/// Which torque is in force on [t_k, t_k+1), when r_k is the torque reported in cycle k.
enum zygos_torque_law {
    ZYGOS_TORQUE_APPLIED_FROM_SYNC = 0,      ///< r_k: the command takes effect with the SYNC that opens its cycle.
    ZYGOS_TORQUE_APPLIED_PREVIOUS_CYCLE = 1, ///< r_k+1: the drive reports what it applied during the past cycle.
    ZYGOS_TORQUE_SAMPLED = 2                 ///< (r_k + r_k+1)/2: the torque varies, and is sampled at each SYNC.
};

/// What the balance may know beyond rigid bodies, rotors, springs and dampers; each kind has one coefficient.
enum zygos_effect_kind {
    ZYGOS_MOTOR_COULOMB = 0,   ///< Coulomb friction of a rotor [Nm], before the ratio.
    ZYGOS_MOTOR_VISCOUS = 1,   ///< Viscous friction of a rotor [Nms/rad]: torque before the ratio, rate after it.
    ZYGOS_LINK_COULOMB = 2,    ///< Coulomb friction between a link and the body that carries it [Nm].
    ZYGOS_CUBIC_STIFFNESS = 3, ///< Torque of the spring with the cube of its deflection [Nm/rad^3].
    ZYGOS_TORQUE_LAG = 4,      ///< Delay of the motor's torque behind the one in force [s], less than a period.
    ZYGOS_SPRING_OFFSET = 5    ///< Torque of the spring where theta = q [Nm]: -k times what theta - q reads too much.
};

typedef struct {
    uint32_t kind;  ///< enum zygos_effect_kind.
    uint32_t joint; ///< 0..N-1.
} zygos_effect_config_t;

typedef struct {
    uint32_t node;     ///< CANopen-style node number of the joint's drive, 1..31.
    uint32_t latch_us; ///< Delay from SYNC to the encoders' latch, as the drive states it on the wire.
    uint32_t rigid;    ///< 1: theta = q. The motor encoder speaks for both sides; no stiffness, no damping.
    uint32_t reserved;
    double frame[9];       ///< Rotation from the joint's frame to that of the body before it at q = 0, row-major.
                           ///< Not looked at in a planar arm. The body behind the joint has the joint's frame.
    double axis[3];        ///< Unit vector of the joint axis in the joint's frame.
    double gear_ratio;     ///< Rotor turns per output turn, > 0.
    double link_sign;      ///< +1 or -1: angle = sign * (reading - zero).
    double link_zero_rad;  ///< Reading of the link encoder where q = 0.
    double link_sigma_rad; ///< Standard deviation of the link encoder's noise; 0 switches its bandwidth test off.
    double link_latch_s;   ///< Delay of the link encoder's latch, in addition to latch_us.
    double motor_sign;     ///< As link_sign, for the motor encoder.
    double motor_zero_rad; ///< Reading of the motor encoder where theta = 0.
    double motor_sigma_rad;
    double motor_latch_s;
} zygos_joint_config_t;

/// All that the library has to know of the hardware. No mass, no length, no stiffness: those it learns.
typedef struct {
    uint32_t abi;                 ///< Set it to ZYGOS_ABI.
    uint32_t joints;              ///< N, 1..ZYGOS_MAX_JOINTS.
    uint32_t kinetic;             ///< enum zygos_kinetic.
    uint32_t torque_law;          ///< enum zygos_torque_law.
    uint32_t smoother_half_width; ///< M >= 2: the window holds the 2 M + 1 cycles around the smoothed instant.
    uint32_t smoother_order;      ///< Order of the local polynomial, 2 .. 2 M - 2.
    uint32_t smoother_lag;        ///< Must equal M: a filter evaluated at its newest sample is refused.
    uint32_t arc_cycles;          ///< An arc ends after that many instants at the latest, >= ZYGOS_MIN_ARC_INSTANTS;
                                  ///< from an eighth of them on, at an instant that the bandwidth test refuses.
    double forgetting_factor; ///< Share of what closed arcs left that is kept from cycle to cycle, 0.9 .. 1; 1 forgets
                              ///< nothing. It is applied when an arc ends.
    uint32_t imu_node;        ///< Node number of the gyro, 1..31; 0 on a fixed base, which has none.
    uint32_t imu_fine;        ///< 1: rates come as i24 in two frames; 0: as i16 in one.
    double period_s;          ///< SYNC period h. Time is the SYNC count times h, never a receive time.
    double imu_to_base[9];    ///< Rotation that takes a rate from the sensor's axes to the base's, row-major.
    double imu_latch_s;       ///< Delay from SYNC to the gyro's latch.
    double imu_sigma;         ///< Standard deviation of one component of one sample's noise [rad/s]; 0: not declared.
    double gravity[3];        ///< In the base frame [m/s^2]; 0 on a free base.
    zygos_joint_config_t joint[ZYGOS_MAX_JOINTS];
    uint32_t compensation; ///< 0: off. m: what noise adds to the normal equations is taken off, each sensor's share in
                           ///< every m-th cycle, 1..2 ZYGOS_MAX_JOINTS + 1.
    uint32_t impulse_arc_cycles; ///< Arcs of the motor impulse rows, >= ZYGOS_MIN_ARC_INSTANTS; 0: no such rows.
    uint32_t effects; ///< Effects to identify, 0..ZYGOS_MAX_EFFECTS. Their columns follow those of the joints.
    uint32_t base;    ///< enum zygos_base.
    uint32_t momentum_arc_cycles; ///< Arcs of the momentum rows of a free base, >= ZYGOS_MIN_ARC_INSTANTS; 0: none.
    uint32_t reserved;            ///< 0.
    zygos_effect_config_t effect[ZYGOS_EFFECT_PLACES]; ///< In the order of their columns, each kind once a joint.
} zygos_config_t;

/// Bits of zygos_cycle_t.flags. With ZYGOS_CYCLE_VOID, the bits from ZYGOS_CYCLE_VOID_SHIFT up say how many cycles
/// before this one cannot be trusted: every arc that reaches into them is dropped. 0 means the open arc, however long.
#define ZYGOS_CYCLE_VOID_SHIFT 8
enum zygos_cycle_flag {
    ZYGOS_CYCLE_BREAK = 1,   ///< Nothing that came before is continued by this cycle: the arc ends before it.
    ZYGOS_CYCLE_INVALID = 2, ///< The values are not to be used: the cycle is dropped and counted, the arc ends.
    ZYGOS_CYCLE_VOID = 4     ///< Ends the arc, and drops every arc that reaches into the cycles counted above.
};

/// What the sensors say in one SYNC cycle, in SI, before signs, zeros and mounting are applied.
typedef struct {
    uint64_t sync;                  ///< Cycle number since init. A step other than +1 ends the arc.
    uint32_t flags;                 ///< Bits of enum zygos_cycle_flag.
    uint32_t reserved;              ///< 0.
    double q[ZYGOS_MAX_JOINTS];     ///< Link encoder [rad]. Not looked at where the joint is rigid.
    double theta[ZYGOS_MAX_JOINTS]; ///< Motor encoder, gearbox output [rad].
    double tau[ZYGOS_MAX_JOINTS];   ///< Rotor torque, before the ratio [Nm].
    double omega[3];                ///< Gyro, in the sensor's axes [rad/s]. Not looked at on a fixed base.
} zygos_cycle_t;

#ifdef __cplusplus
}
#endif
#endif
