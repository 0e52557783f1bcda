/// zygos.h: learn the dynamics of a flexible-joint space arm from its encoders, gyro and motor torques.
///
/// This header and those it gathers are the manual. A sample walks through one room after the other:
///
///     CAN frame -> wire -> cycle -> smoother -> kinematics -> balance -> accumulator -> solver -> estimate
///
/// In an onboard program:
///
///     static zygos_t arm;                      // one an arm; static or wherever you like
///     zygos_init(&arm, &config);               // once
///     zygos_frame(&arm, &frame);               // receive interrupt or task: each frame as it comes
///     while (zygos_step(&arm) == 1) { }        // one task: works off complete cycles
///     zygos_take(&arm, &work);                 // the same task, whenever an estimate is wanted
///     zygos_solve(&work, &estimate);           // any task, at any priority
///     zygos_adopt(&arm, &estimate);            // the task that steps, once or twice an arc
///
/// An arm on another bus uses zygos_cycle() instead of zygos_frame() and zygos_step(), with values in SI.
///
/// What it cannot know: the scale of all torques together. A common error of the torque constants scales every
/// parameter.

#ifndef ZYGOS_H
#define ZYGOS_H

#include "accumulator.h"
#include "balance.h"
#include "cycle.h"
#include "effects.h"
#include "gram.h"
#include "guard.h"
#include "impulse.h"
#include "jointsums.h"
#include "kinematics.h"
#include "momentum.h"
#include "momentumsums.h"
#include "noise.h"
#include "smoother.h"
#include "snapshot.h"
#include "solver.h"
#include "text.h"
#include "types.h"
#include "wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Everything about one arm. Its members are for reading; only the calls below change them. Memory that zygos_init()
/// has not accepted is recognised by its mark, except by chance.
typedef struct {
    uint32_t magic;
    uint32_t reserved;
    uint64_t cycle;             ///< SYNC number of the newest cycle that was worked off.
    uint64_t cycles;            ///< Cycles that were worked off.
    uint64_t gaps;              ///< Times that an arc ended because cycles did not follow each other.
    uint64_t invalid;           ///< Cycles through zygos_cycle() that were flagged invalid or not finite.
    uint64_t wraps;             ///< Times that an angle went over the end of its multi-turn range; the arc ends.
    uint64_t apart;             ///< Cycles with link and motor angle on different sides of that end; they are not used.
    uint32_t arc;               ///< Instants of the open arc, accepted or not.
    uint32_t instant;           ///< 1: state, row and accepted below are those of the newest cycle.
    double forgetting;          ///< What is left of closed arcs by the cycles of the open one (keep).
    double joints_forgetting;   ///< The same of the motor rows,
    double momentum_forgetting; ///< and of the momentum rows.
    double accepted;            ///< 1 when the newest row was accumulated, 0 when the bandwidth test refused it.
    zygos_config_t config;
    zygos_column_map_t column_map;
    zygos_geometry_t geometry;
    zygos_receiver_t receiver;
    zygos_previous_cycle_t previous;
    zygos_smoother_t smoother;
    zygos_noise_t noise;
    zygos_arm_state_t arm_state;
    zygos_motion_t motion;
    zygos_balance_t balance;
    zygos_row_t row;
    zygos_impulse_t impulse;
    zygos_impulse_rows_t impulse_rows;
    zygos_joint_sums_t joint_sums;
    zygos_momentum_t momentum;
    zygos_momentum_sums_t momentum_sums;
    zygos_accumulator_t accumulator;
    zygos_guard_t guard;
} zygos_t;

/// Digest of the text of all structs in these headers, without comments: a field that is moved, renamed or given
/// another type changes it. tests/unit/test_snapshot.py knows what it must be.
#define ZYGOS_LAYOUT 0xB4DBF2D6u

#define ZYGOS_MIX(hash, value) (((uint32_t)(hash) ^ (uint32_t)(value)) * 16777619u)

/// Differs between builds whose structs differ: in text, in capacities, or by the compiler. Goes into
/// zygos_config_t.abi; zygos_init() compares it with its own. Also in the head of a snapshot.
#define ZYGOS_ABI                                                                                                      \
    ZYGOS_MIX(                                                                                                         \
        ZYGOS_MIX(ZYGOS_MIX(ZYGOS_ABI_SIZES, ZYGOS_MAX_JOINTS), ZYGOS_VERSION_MAJOR * 256 + ZYGOS_VERSION_MINOR),      \
        ZYGOS_LAYOUT)
#define ZYGOS_ABI_SIZES                                                                                                \
    ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(sizeof(zygos_t), sizeof(zygos_config_t)), sizeof(zygos_work_t)), \
                                  sizeof(zygos_estimate_t)),                                                           \
                        sizeof(zygos_cycle_t)),                                                                        \
              sizeof(zygos_frame_t))

/// Bits of zygos_restart().
enum zygos_keep {
    ZYGOS_KEEP_NOTHING = 0,
    ZYGOS_KEEP_FAULTS = 1, ///< Fault, gap and wrap counters run on. Without it, call while no frame is received.
    ZYGOS_KEEP_JOINTS = 2 ///< The sums of the motor rows stay: what is known of Im, k and b. A new payload leaves them.
};

/// Checks the configuration and starts from nothing. Needs memory of its own; may be called again at any time by the
/// task that steps while no frame is being received. Returns 1, or an enum zygos_error and *self is as it was.
/// Cost: the coefficients of the smoother, and one memset of zygos_t.
int zygos_init(zygos_t *self, const zygos_config_t *config);

/// Goes on with a state that was stored, after zygos_snapshot_check() found it whole, or with one in memory that no
/// frames reached for a while. What was learned and counted stays. The arc in progress ends, cycles in the queue and
/// the open one are lost and counted (zygos_receiver_resume()), and what follows from the configuration is computed
/// anew. Needs a state of the same configuration, otherwise ZYGOS_E_CONFIG, in which all that is used as a place, count
/// or length can be, otherwise ZYGOS_E_STATE: no image, whatever its bytes, takes this or a later call out of *self.
/// Same task as zygos_step(), while no frame is being received. Returns 1, or an enum zygos_error and *self is as it
/// was. Cost: the coefficients of the smoother, and the end of an arc.
int zygos_resume(zygos_t *self, const zygos_config_t *config);

/// Front door: one CAN frame, in the order of the bus. Decodes and stores only; may run in the receive interrupt while
/// zygos_step() runs in a task. Returns enum zygos_reception or an enum zygos_error.
int zygos_frame(zygos_t *self, const zygos_frame_t *frame);

/// Works off at most one complete cycle: smooths, forms the row, accumulates. Returns 1, or 0 when none was waiting.
/// Cost: the same for every valid cycle of a configuration, but for the cycle in which a block or an arc ends.
int zygos_step(zygos_t *self);

/// The other door: one cycle in SI. Same task as zygos_step(); use one door only. A cycle that is flagged
/// ZYGOS_CYCLE_INVALID, or has a value that is not finite, an angle beyond +-1e4 rad or another value beyond +-1e6, is
/// counted and dropped and ends the arc. Returns 1 when the cycle was used, 0 when it was dropped, or an enum
/// zygos_error.
int zygos_cycle(zygos_t *self, const zygos_cycle_t *cycle);

/// Copies what zygos_solve() needs; does nothing when a pointer is null. Same task as zygos_step(). Bounded: one copy
/// of the accumulator.
void zygos_take(const zygos_t *self, zygos_work_t *work);

/// Takes a valid estimate of this arm as the running solution that judges each arc when it ends (guard.h): one that
/// contradicts it is left out of the sums and counted. Sums that the estimate had to leave out (since) are dropped.
/// Call it once or twice an arc with what zygos_solve() made of the newest zygos_take(). Without it nothing is left
/// out. Same task as zygos_step(). Returns 1; 0, and the sums and the running solution are as they were, for an
/// estimate that is not valid, or from before zygos_restart(); or an enum zygos_error. After the running solution was
/// given up, one that is doubtful for ZYGOS_REASON_CHANGED alone is taken as well. Cost: the sums of the motor and the
/// momentum rows once, and two passes over the covariance; where sums are dropped, a move of the others.
int zygos_adopt(zygos_t *self, const zygos_estimate_t *estimate);

/// Whether memory is what the library left in it: call it before a state is sealed, and behind zygos_snapshot_check()
/// before one that was stored is used, for a CRC also fits what was damaged before it was sealed. Returns 1;
/// ZYGOS_E_NULL; ZYGOS_E_ORDER; ZYGOS_E_CONFIG when the configuration in *self is not *config; ZYGOS_E_STATE when
/// something that is used as a place, count or length cannot be; or ZYGOS_E_SUMS when zygos_solve() would answer
/// ZYGOS_REASON_CORRUPT. zygos_restart() heals the sums, and zygos_init() everything. Changes *work alone, which is
/// scratch; what it held is lost. Not seen: fault and cycle counters, and the smoother's window, which is soon
/// overwritten. Same task as zygos_step(), while no frame is being received. Cost: zygos_take(), and a few passes over
/// the sums; about as much as zygos_snapshot_seal(), and far less than zygos_solve().
int zygos_check(const zygos_t *self, const zygos_config_t *config, zygos_work_t *work);

/// Starts the estimate from nothing with the same configuration (the payload changed, or the sums are corrupt);
/// reception goes on, cycles that wait in the queue are forgotten. What follows from the configuration is computed
/// anew. keep: bits of enum zygos_keep. Same task as zygos_step(). Returns 1, or an enum zygos_error and *self is as it
/// was: that of the configuration if memory was changed there. Cost: the coefficients of the smoother, and one memset
/// of the sums.
int zygos_restart(zygos_t *self, uint32_t keep);

/// ZYGOS_ABI as the library was compiled.
uint32_t zygos_abi(void);

#ifdef __cplusplus
}
#endif
#endif
