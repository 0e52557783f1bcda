/* SPDX-License-Identifier: MIT */
/// zygos/priv/arm.h: the sums of one arm, and what a cycle does with them. zygos_t has one, which the calls of zygos.h
/// handle; programs do not call what is declared here.
///
///     CAN frame -> wire -> cycle -> smoother -> kinematics -> balance -> accumulator -> solver -> estimate

#ifndef ZYGOS_ARM_H
#define ZYGOS_ARM_H

#include "../types.h"
#include "accumulator.h"
#include "balance.h"
#include "cycle.h"
#include "effects.h"
#include "gram.h"
#include "guard.h"
#include "impulse.h"
#include "joint.h"
#include "jointsums.h"
#include "kinematics.h"
#include "momentum.h"
#include "momentumsums.h"
#include "motorsums.h"
#include "noise.h"
#include "reduction.h"
#include "smoother.h"
#include "solver.h"
#include "sums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Everything about one arm. The program may read the members; only the functions below change them. The magic number
/// shows that zygos_arm_init() has succeeded on this memory.
typedef struct {
    uint32_t magic;
    uint32_t places; ///< Exclusive or of the counts and indices that follow from the configuration; another
                     ///< number where a cycle found memory changed: none is processed before zygos_arm_scrub().
    uint64_t config_checksum; ///< Of config.
    uint64_t tables_checksum; ///< Of everything that follows from the configuration.
    uint64_t moving;          ///< Exclusive or of what changes from cycle to cycle: integrals, and places in windows.
    uint64_t scrubbed;        ///< Number of the newest cycle when zygos_arm_scrub() was called last, or of the start.
    uint64_t quarantined;     ///< Number of arcs and blocks that were dropped because memory was changed.
    uint64_t cycles;          ///< Number of cycles that were processed.
    uint64_t added;           ///< Number of the newest cycle that gave a row which was not refused.
    uint64_t restored; ///< Number of the newest cycle of a stored state (zygos_resume()); 0: none is in the sums.
    uint64_t gaps;     ///< Number of times an arc ended because a cycle did not follow the one before.
    uint64_t invalid;  ///< Number of cycles that were not used: flagged invalid, not finite, or changed in
                       ///< memory before they were processed.
    uint64_t wraps;    ///< Number of times an angle passed the end of its multi-turn range; the arc ends.
    uint64_t apart;    ///< Number of cycles with link and motor angle on different sides of that end, not used.
    uint64_t waited[ZYGOS_KINDS_OF_ROWS]; ///< Number of instants that have no row of a kind, because an arc of these
                                          ///< rows waited for its end (ending).
    uint32_t instant;                     ///< 1: arm_state, row and accepted below belong to the newest cycle.
    uint32_t held;   ///< Kinds of rows, as bits, whose tasks wait, because their sums are being copied (handover.h).
    uint32_t beside; ///< 1: something else is done beside the next cycle, so that no task proceeds in it.
    double accepted; ///< 1 when the newest row was accumulated, 0 when the bandwidth test refused it.
    zygos_previous_cycle_t previous;
    zygos_balance_t balance;
    zygos_impulse_t impulse;
    zygos_momentum_t momentum;
    zygos_sums_t sums;
    zygos_joint_t joint;
    zygos_smoother_t smoother;
    zygos_geometry_t geometry;
    zygos_receiver_t receiver;
    zygos_noise_t noise;
    zygos_arm_state_t arm_state;
    zygos_motion_t motion;
    zygos_row_t row;
    zygos_impulse_rows_t impulse_rows;
    zygos_joint_row_t joint_row;
} zygos_arm_t;

/// Digest of the offsets and types in the structs that library and caller exchange, at the default capacities on a
/// processor of 64 bits. It changes when a field is moved or given another type, and not when it is renamed. A test of
/// tests/unit/test_snapshot.py computes its value.
#define ZYGOS_LAYOUT 0x2093CA94u

#define ZYGOS_MIX(hash, value) (((uint32_t)(hash) ^ (uint32_t)(value)) * 16777619u)

/// Identifies the memory layout, the same on processors of 32 and of 64 bits: of zygos_solver_t, which has pointers and
/// is in no snapshot, ZYGOS_LAYOUT counts and not the size. It differs between builds whose structs differ in layout,
/// by their capacities or by the compiler. The caller writes it into zygos_config_t.abi, and zygos_arm_init() compares
/// it with that of the library. It is also in the head of a snapshot.
#define ZYGOS_ABI                                                                                                      \
    ZYGOS_MIX(                                                                                                         \
        ZYGOS_MIX(ZYGOS_MIX(ZYGOS_ABI_SIZES, ZYGOS_MAX_JOINTS), ZYGOS_VERSION_MAJOR * 256 + ZYGOS_VERSION_MINOR),      \
        ZYGOS_LAYOUT)
#define ZYGOS_ABI_SIZES                                                                                                \
    ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(ZYGOS_MIX(sizeof(zygos_arm_t), sizeof(zygos_config_t)),                    \
                                            sizeof(zygos_work_t) - sizeof(zygos_solver_t)),                            \
                                  sizeof(zygos_estimate_t)),                                                           \
                        sizeof(zygos_cycle_t)),                                                                        \
              sizeof(zygos_frame_t))

/// Returns 1 for a configuration that zygos_arm_init() accepts, and otherwise its error. Cost: one pass over it.
int zygos_config_check(const zygos_config_t *config);

/// Checks the configuration and initialises *self. The task that calls zygos_arm_step() may call it again at any time
/// while no frame is being received. config may be &self->config. Returns 1, or an enum zygos_error, in which case
/// *self is unchanged: ZYGOS_E_ARITHMETIC where the compiler's flags break IEEE arithmetic. Cost: the coefficients of
/// the smoother, and one memset of zygos_arm_t.
int zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config);

/// Continues with a stored state that has passed zygos_snapshot_check(), or with a state in memory that has received no
/// frames for a while. All sums and counters are kept. The open arc ends; the cycles in the queue and the open cycle
/// are lost and counted (zygos_receiver_resume()). Everything that follows from the configuration is computed again.
/// The state must have the same configuration, otherwise the call returns ZYGOS_E_CONFIG, and possible indices, counts
/// and lengths, otherwise it returns ZYGOS_E_STATE. So no image, whatever its bytes are, makes this or a later call
/// access memory outside *self. Call it in the task of zygos_arm_step(), while no frame is being received. Returns 1,
/// or an enum zygos_error, in which case *self is unchanged. Cost: the coefficients of the smoother, and the end of an
/// arc.
int zygos_arm_resume(zygos_arm_t *self, const zygos_config_t *config);

/// Receives one CAN frame. The frames must come in the order of the bus. The function only decodes and stores; it may
/// run in the receive interrupt while zygos_arm_step() runs in a task. Returns enum zygos_reception or an enum
/// zygos_error.
int zygos_arm_frame(zygos_arm_t *self, const zygos_frame_t *frame);

/// Processes at most one complete cycle: smooths the signals, forms the rows and accumulates them. A cycle whose
/// readings were changed in memory since they arrived is not used, and counted in invalid; the arc ends. Returns 1 if
/// it took a cycle, also one that is not used, 0 if none was waiting, or an enum zygos_error: with ZYGOS_E_STATE,
/// memory was changed and the cycle still waits; call zygos_arm_scrub(). Cost: the same for every valid cycle of a
/// configuration, with a part of a task (accumulator.h) beside it after the end of a block or an arc. An arc that ends
/// while the one before it is closing waits until that one is closed; until then there are no rows of its kind.
int zygos_arm_step(zygos_arm_t *self);

/// Processes one cycle in SI units, instead of zygos_arm_frame() and zygos_arm_step(); do not use both for one arm.
/// Call it in the task in which zygos_arm_step() would run. A cycle that is flagged ZYGOS_CYCLE_INVALID, or has a value
/// that is not finite, an angle beyond +-1e4 rad or another value beyond +-1e6, is counted and dropped, and the arc
/// ends. Returns 1 when the cycle was used, 0 when it was dropped, or an enum zygos_error: with ZYGOS_E_STATE, memory
/// was changed and the cycle was not used; call zygos_arm_scrub().
int zygos_arm_cycle(zygos_arm_t *self, const zygos_cycle_t *cycle);

/// Ends the open arcs of all rows, and finishes the tasks that proceed beside the cycles; open arcs that are too short
/// to be of use are dropped. The next cycle begins new ones. Call it in the task of zygos_arm_step(). Returns 1;
/// ZYGOS_E_NULL; ZYGOS_E_ORDER when zygos_arm_init() has not succeeded on *self; or ZYGOS_E_STATE, with *self
/// unchanged, when memory was changed: call zygos_arm_scrub(). Cost: a few passes over the sums of two arcs of each
/// kind.
int zygos_arm_end_arcs(zygos_arm_t *self);

/// Copies everything that zygos_work_solve() needs into *work. Does nothing when a pointer is null. Call it in the task
/// of zygos_arm_step(). Cost: one copy of the sums.
void zygos_arm_take(const zygos_arm_t *self, zygos_work_t *work);

/// Solves like zygos_arm_take() and zygos_work_solve(), but without a copy of the sums: for memory that does not hold a
/// zygos_work_t. The open arcs end (zygos_arm_end_arcs()), also where nothing is solved afterwards; with a forgetting
/// factor the sums of closed arcs fade then as at every end of an arc. The normal equations lie in buffers of *self
/// until the call returns, and no other function may be called on *self until then but zygos_arm_frame(): cycles wait
/// in the queue, and those beyond its length are lost and counted. A state that a reset has left in the middle must be
/// initialised anew, or resumed from a snapshot. Call it where the arm rests or the motion has ended, not more often
/// than arcs would end. An arc that does not match its row sums is dropped and counted, and the others are solved. Call
/// it in the task of zygos_arm_step(). Returns what zygos_work_solve() returns, or what zygos_arm_end_arcs() does where
/// that is negative. Cost: that of zygos_arm_end_arcs() and of zygos_work_solve().
int zygos_arm_solve(zygos_arm_t *self, zygos_solver_t *solver, zygos_estimate_t *out);

/// The same behind zygos_arm_end_arcs(). The pointers are not checked. Where memory was changed since, the estimate is
/// refused (ZYGOS_REASON_CORRUPT).
int zygos_arm_solve_ended(zygos_arm_t *self, zygos_solver_t *solver, zygos_estimate_t *out);

/// Adopts a valid estimate of this arm as the running solution, with which each arc is compared when it ends (guard.h):
/// an arc that contradicts it is excluded from the sums and counted. Sums that the estimate excluded (its member since)
/// are dropped. Call it once or twice in an arc, with the result of zygos_work_solve() on the newest zygos_arm_take().
/// Without this call no arc is excluded. Call it in the task of zygos_arm_step(). Returns 1 when the estimate was
/// adopted; 0, with sums and running solution unchanged, when the estimate is not valid or is older than
/// zygos_arm_restart(); or an enum zygos_error. After the running solution was given up, an estimate that is doubtful
/// only because of ZYGOS_REASON_CHANGED is adopted as well. Where joint rows alone determine the estimate
/// (jointsums.h), their segments are what is called arcs here. Cost: one pass over the sums of the motor and momentum
/// rows and two over the covariance; where sums are dropped, the others are moved once.
int zygos_arm_adopt(zygos_arm_t *self, const zygos_estimate_t *estimate);

/// Checks whether memory was changed from outside. Call it before a state is sealed, and after zygos_snapshot_check()
/// before a stored state is used: the CRC of a snapshot is also right when the state was damaged before it was sealed.
/// Returns 1 when no error was found; ZYGOS_E_NULL; ZYGOS_E_ORDER; ZYGOS_E_CONFIG when the configuration in *self
/// differs from *config; ZYGOS_E_STATE when an index, count or length is impossible; or ZYGOS_E_SUMS when
/// zygos_work_solve() would give ZYGOS_REASON_CORRUPT. zygos_arm_restart() repairs the sums, zygos_arm_init() repairs
/// everything. Only *work is changed; its content is lost. Not checked are the counters of faults and cycles, the
/// integrals, which zygos_arm_resume() drops, and the window of the smoother, which is soon overwritten. Call it in the
/// task of zygos_arm_step(), while no frame is being received. Cost: that of zygos_arm_take(), and a few passes over
/// the sums; about as much as zygos_snapshot_seal(), and far less than zygos_work_solve().
int zygos_arm_check(const zygos_arm_t *self, const zygos_config_t *config, zygos_work_t *work);

/// What zygos_arm_scrub() found and repaired, as bits.
enum zygos_scrubbed {
    ZYGOS_SCRUBBED_CONFIG = 1, ///< The configuration, which is that of the caller again.
    ZYGOS_SCRUBBED_TABLES = 2, ///< Something that follows from it, which was computed again.
    ZYGOS_SCRUBBED_PLACES = 4, ///< An impossible index, count or flag, or an integral, count or place that is not what
                               ///< the newest cycle left; the open arcs were dropped.
    ZYGOS_SCRUBBED_BLOCKS = 8, ///< Blocks or arcs whose sums do not match; they alone were dropped.
    ZYGOS_SCRUBBED_SUMS = 16 ///< All sums of a kind of rows, which were cleared: what they have in common was changed.
};

/// Finds and repairs what memory errors have changed in *self. Call it once in an arc and before each zygos_arm_take(),
/// and when zygos_arm_frame(), zygos_arm_step() or zygos_arm_cycle() returns ZYGOS_E_ORDER or ZYGOS_E_STATE, in the
/// task of zygos_arm_step(), while no frame is being received. *config is the caller's own configuration, not that in
/// *self, best in memory that is protected; of it, config in *self and the checksum in *self, two must agree. What
/// follows from the configuration has a checksum and is computed again where that does not match; then every arc that
/// may contain a cycle behind the last call is dropped, and the running solution (guard.h) is discarded. Cycles that
/// wait are dropped with a changed configuration, for they may lack joints. Indices and counts are set to possible
/// values. Blocks that do not match their row sums or their checksum are dropped and counted. Memory that nothing has
/// changed is left as it is, except for the member scrubbed, and an arc that waits for its end is ended. Returns 0 when
/// nothing was found; bits of enum zygos_scrubbed; ZYGOS_E_NULL; ZYGOS_E_ORDER when zygos_arm_init() has not succeeded
/// on *self; or ZYGOS_E_CONFIG, with *self unchanged, when *config is not the configuration that *self was initialised
/// with. Not checked are readings that wait and integrals of joint rows, which are checked when they are used, smoothed
/// signals, which last for a window, and counters of faults. Cost: one pass over *self for checksums and
/// row sums, less than zygos_arm_check(); where something has to be repaired, also that of zygos_arm_restart().
int zygos_arm_scrub(zygos_arm_t *self, const zygos_config_t *config);

/// Adds the arcs and blocks that tasks have dropped to quarantined, as zygos_arm_scrub() does. Returns how many there
/// were.
uint32_t zygos_arm_count_quarantined(zygos_arm_t *self);

/// Returns whether every count, place and length is possible, and what the newest call has left: whoever goes through
/// the sums then stays within them. Cost: zygos_arm_end_arcs() does the same.
bool zygos_arm_is_whole(const zygos_arm_t *self);

/// Restarts the estimate with the same configuration, for example because the payload changed or the sums are corrupt.
/// Reception continues; cycles that wait in the queue are discarded. Everything that follows from the configuration is
/// computed again. keep: bits of enum zygos_keep. Call it in the task of zygos_arm_step(). Returns 1, or an enum
/// zygos_error, in which case *self is unchanged; if the configuration in memory was changed, that is its error. Cost:
/// the coefficients of the smoother, and one memset of the sums.
int zygos_arm_restart(zygos_arm_t *self, uint32_t keep);

/// Returns ZYGOS_ABI of the build of the library.
uint32_t zygos_abi(void);

#ifdef __cplusplus
}
#endif
#endif
