/* SPDX-License-Identifier: MIT */
/// zygos.h: identifies the dynamics of a space manipulator with flexible joints from encoders, gyro and motor torques.
///
/// An onboard program makes four calls:
///
///     static zygos_t arm;                      // one for each arm, in memory of the caller's choice
///     static zygos_background_t memory;        // for solutions; zygos_in_place_t where that is too much
///     static zygos_estimate_t estimate;
///
///     zygos_init(&arm, &config, &memory, sizeof memory);  // once
///     zygos_frame(&arm, &frame);               // receive interrupt: each frame, in the order of the bus
///     zygos_step(&arm);                        // the periodic task: one cycle, and a part of everything else
///     zygos_solve(&arm, &estimate);            // background, at a lower priority: 1 is a new estimate
///
/// There are three contexts, and each call belongs to one of them: the interrupt (zygos_frame()), the task
/// (zygos_step() and all others) and the background (zygos_solve()). Each may interrupt the others at any place, or run
/// on a core of its own. Two calls of one context must not run at the same time.
///
/// Every call returns 1 when it has done its work, 0 when there was nothing to do, and an enum zygos_error below 0 when
/// it was misused, in which case nothing was changed. zygos_text() has the errors in words.
///
/// The headers beside this one are the reference manual. What stands in zygos/priv/ sizes the structs and is no
/// interface. The common scale of all torques cannot be identified: a common error of the torque constants scales every
/// parameter.

#ifndef ZYGOS_H
#define ZYGOS_H

#include "priv/arm.h"
#include "priv/handover.h"
#include "priv/tables.h"
#include "refine.h"
#include "types.h"
#include "wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The number of frames that may wait between zygos_frame() and zygos_step(): a power of two, enough for
/// ZYGOS_CYCLE_QUEUE cycles.
#define ZYGOS_RING_LEAST (ZYGOS_CYCLE_QUEUE * (2 * ZYGOS_MAX_JOINTS + 4))
#if ZYGOS_RING_LEAST <= 32
#define ZYGOS_RING 32
#elif ZYGOS_RING_LEAST <= 64
#define ZYGOS_RING 64
#elif ZYGOS_RING_LEAST <= 128
#define ZYGOS_RING 128
#elif ZYGOS_RING_LEAST <= 256
#define ZYGOS_RING 256
#elif ZYGOS_RING_LEAST <= 512
#define ZYGOS_RING 512
#elif ZYGOS_RING_LEAST <= 1024
#define ZYGOS_RING 1024
#elif ZYGOS_RING_LEAST <= 2048
#define ZYGOS_RING 2048
#elif ZYGOS_RING_LEAST <= 4096
#define ZYGOS_RING 4096
#elif ZYGOS_RING_LEAST <= 8192
#define ZYGOS_RING 8192
#elif ZYGOS_RING_LEAST <= 16384
#define ZYGOS_RING 16384
#else
#define ZYGOS_RING 32768
#endif

/// Memory for solutions in the background: a copy of the sums, and the newest estimate. Its members are not for
/// reading.
typedef struct {
    zygos_work_t work;
    zygos_estimate_t estimate; ///< The newest.
    uint64_t seal;             ///< Of the estimate, until it is adopted.
    uint32_t of;               ///< zygos_t.restarts when the copy was made.
    uint32_t changed;          ///< 1: a comparison has found another arm,
    uint32_t changed_of;       ///< when zygos_t.restarts was this.
    uint32_t corrupt;          ///< Estimates in a row whose sums were corrupt.
    uint64_t unchanged;        ///< The newest cycle of the arm before.
    uint32_t adopted;          ///< 1: the estimate can be adopted.
    uint32_t reserved;
} zygos_background_t;

/// Memory for solutions without a copy of the sums: while one is computed, frames wait, and arcs end before it. There
/// is no comparison of the newest arc with the others (zygos_estimate_t.changed).
typedef struct {
    zygos_solver_t solver;
    zygos_estimate_t estimate;
    uint64_t seal; ///< As in zygos_background_t, also below.
    uint32_t of;
    uint32_t corrupt;
} zygos_in_place_t;

/// The words of what zygos_init() was given, and follows from the configuration for the interrupt.
#define ZYGOS_GIVEN_CONFIG 0u     ///< Address of the configuration,
#define ZYGOS_GIVEN_MEMORY 1u     ///< of the memory,
#define ZYGOS_GIVEN_REFINE 2u     ///< and of the refinement; 0: none.
#define ZYGOS_GIVEN_BACKGROUND 3u ///< 1: the memory is a zygos_background_t; 0: a zygos_in_place_t.
#define ZYGOS_GIVEN_NODES 4u      ///< Of this arm, as bits.
#define ZYGOS_GIVEN_SLICES 5u     ///< Of the refinement, in each cycle.
#define ZYGOS_GIVEN_WORDS 6u

/// All of that. It is kept three times, the second and the third time turned by 5 and 10 bits, and a bit is what two of
/// them say.
typedef struct {
    uintptr_t word[ZYGOS_GIVEN_WORDS];
} zygos_given_t;

/// zygos_t.magic of an arm that zygos_init() or zygos_resume() has prepared.
#define ZYGOS_BEGUN 0x5A59474Fu

/// One arm. The program may read the counters, and in its task state and refined; only the calls below change them.
typedef struct {
    uint32_t magic;
    uint32_t stage;           ///< enum zygos_stage.
    uint32_t head;            ///< Frames received, modulo 2^32; the interrupt alone writes it,
    uint32_t overrun;         ///< and this: frames lost, because zygos_step() was called too seldom.
    uint32_t tail;            ///< Frames taken; the task alone writes it, and everything below but the memory given.
    uint32_t overrun_counted; ///< Of overrun, what state.receiver.faults has.
    uint64_t repairs;         ///< Times that memory was found changed and repaired.
    uint64_t losses;          ///< Times that it could not be repaired, and the estimation began anew.
    uint64_t rested;          ///< Cycles since the sums were copied last.
    uint32_t copied;          ///< Cycles that this took, after which as many pass before the next time,
    uint32_t not_copied;      ///< and its complement: memory errors must not make them more.
    uint32_t waited;          ///< Cycles for which an estimate has waited to be adopted.
    uint32_t refining;        ///< Two of the lowest three bits: the background has the memory of the refinement.
    uint32_t refines_anew;    ///< The same: what is refined is another arm's.
    uint32_t quiet;           ///< Calls in a row without a cycle.
    uint32_t restarts;        ///< Times that the sums were given up: zygos_restart(), and memory beyond repair.
    uint32_t verifying;       ///< Cycles until the tables that the copied sums rest on are verified; 0: no copy waits.
    uint32_t adopting;        ///< 7: the estimate that waits to be adopted is as it was solved.
    uint32_t reserved;
    zygos_given_t given[3];
    zygos_handover_t handover;
    zygos_patrol_t patrol;
    zygos_refined_t refined; ///< What zygos_refine_judge() said of the newest estimate.
    zygos_frame_t ring[ZYGOS_RING];
    zygos_arm_t state; ///< The image of a snapshot.
} zygos_t;

/// Checks the configuration and initialises *self. *config stays the caller's: it is the reference with which the copy
/// in *self is compared, must not change, and is best in memory that is protected. memory: a zygos_background_t, or
/// where bytes is less than its size, a zygos_in_place_t; it belongs to the library from here on. Call it before the
/// receive interrupt is enabled. Returns 1, or an enum zygos_error: ZYGOS_E_MEMORY where bytes is less than the size of
/// zygos_in_place_t, ZYGOS_E_ARITHMETIC where the compiler's flags break IEEE arithmetic. Cost: the coefficients of the
/// smoother, and one memset of zygos_t.
int zygos_init(zygos_t *self, const zygos_config_t *config, void *memory, uint32_t bytes);

/// Receives one CAN frame: stores it, without floating point, if its identifier may be one of this arm. Call it in the
/// receive interrupt, or in one task, in the order of the bus. Returns 1 when the frame was stored; 0 when it is none
/// of this arm's, or was lost because ZYGOS_RING frames wait, which is counted in overrun; ZYGOS_E_NULL; or
/// ZYGOS_E_ORDER when zygos_init() has not succeeded on *self. Cost: one copy of 16 bytes.
int zygos_frame(zygos_t *self, const zygos_frame_t *frame);

/// Decodes frames until a cycle is complete, and processes it: smooths the signals, forms the rows and adds them to the
/// sums. Beside it, a part of each of these is done: the configuration and what follows from it are verified and
/// repaired; the sums are copied for zygos_solve(); its estimate is adopted, after which arcs that contradict it are
/// left out (guard.h); cycles are refined (zygos_refine()). Call it in one task, in each SYNC period or more often.
/// Where calls may come late, call it until it returns 0. Returns 1 when it took a cycle, 0 when none was complete or a
/// solution in place is under way; ZYGOS_E_NULL; ZYGOS_E_ORDER; or ZYGOS_E_CONFIG where *config contradicts the copies
/// of it in *self, so that it or more than one of these was changed: call zygos_init(). Cost: the same for every valid
/// cycle of a configuration, but for the parts (docs/cost.md). Where memory was changed: that of a repair, which may be
/// a pass over all sums.
int zygos_step(zygos_t *self);

/// The same for a cycle in SI units, instead of zygos_frame() and zygos_step(); do not use both for one arm. A cycle
/// that is flagged ZYGOS_CYCLE_INVALID, or has a value that is not finite, an angle beyond +-1e4 rad or another value
/// beyond +-1e6, is counted and dropped, and the arc ends. Returns 1 when the cycle was used, 0 when it was dropped or
/// a solution in place is under way, ZYGOS_E_NULL, ZYGOS_E_ORDER, or ZYGOS_E_CONFIG as zygos_step().
int zygos_cycle(zygos_t *self, const zygos_cycle_t *cycle);

/// Asks zygos_step() for a copy of the sums, and solves it once it is there. Call it in the background as often as an
/// estimate is wanted: it never waits. Returns 1 when *out is a new estimate, 0 when none is ready, ZYGOS_E_NULL or
/// ZYGOS_E_ORDER. With a zygos_in_place_t the sums are not copied: zygos_step() ends the arcs, and takes no cycle until
/// this call has returned. It does so once in an arc at the most. Cost: zygos_work_solve().
int zygos_solve(zygos_t *self, zygos_estimate_t *out);

/// Attaches a refinement to an arm (refine.h): it begins with the next valid estimate, and again after a failure, and
/// *refined is judged with every estimate. slices: how many slices of its work are done in each cycle; 0: all that
/// there are. Returns 1, or an enum zygos_error as zygos_refine_init(). Call it after zygos_init() or zygos_resume(),
/// before the interrupt is enabled and the background runs. Cost: that of zygos_refine_init().
int zygos_refine(zygos_t *self, zygos_refine_t *refine, const zygos_refine_settings_t *settings, uint32_t slices);

/// What zygos_refine() does with *self: *refine has been initialised. Returns the same.
int zygos_attach(zygos_t *self, zygos_refine_t *refine, uint32_t slices);

/// Returns the configuration that zygos_init() was given, or null when it has not succeeded on *self.
const zygos_config_t *zygos_reference(const zygos_t *self);

/// Restarts the estimate with the same configuration, because the payload changed. Frames that have been received are
/// of the arm before: cycles that they complete are not used. keep: bits of enum zygos_keep. Call it in the task.
/// Memory that was changed is repaired first. Returns 1; 0 while a solution in place is under way; ZYGOS_E_NULL;
/// ZYGOS_E_ORDER; ZYGOS_E_CONFIG as zygos_step(); or ZYGOS_E_KEEP for an unknown bit, or where there are no motor rows
/// to keep. An estimate of the sums before is not returned by zygos_solve() any more. Cost: one pass over the sums, the
/// coefficients of the smoother, and one memset of the sums.
int zygos_restart(zygos_t *self, uint32_t keep);

/// Verifies and repairs the state, and writes the head of its snapshot: store head and then self->state. Call it in the
/// task. Returns 1; 0 while a solution in place is under way; ZYGOS_E_NULL; ZYGOS_E_ORDER; ZYGOS_E_CONFIG as
/// zygos_step(); or ZYGOS_E_STATE where memory was beyond repair, so that the estimation begins anew: what was stored
/// before is better. Cost: one pass over the sums, and zygos_snapshot_seal().
int zygos_seal(zygos_t *self, uint8_t *head);

/// Continues with a stored state, instead of zygos_init(): the caller has read the head of a snapshot, and the image
/// behind it into self->state; length: bytes of both. The other arguments are those of zygos_init(). All sums and
/// counters are kept; the open arc ends. Returns 1, or an enum zygos_error, with which *self has to be initialised:
/// those of zygos_init() and of zygos_snapshot_check(), ZYGOS_E_CONFIG for the state of another configuration,
/// ZYGOS_E_STATE or ZYGOS_E_SUMS for one that was changed before it was sealed. Cost: zygos_snapshot_check(), and a
/// pass over the sums.
int zygos_resume(zygos_t *self, const zygos_config_t *config, void *memory, uint32_t bytes, const uint8_t *head,
                 uint32_t length);

/* ---------------------------------------------------------------- snapshots
 *
 * A snapshot is a head of ZYGOS_SNAPSHOT_HEAD bytes, followed by the memory of a zygos_config_t or a zygos_arm_t, the
 * image. The head contains the kind of the image, its memory layout and byte order, and a CRC-32C over all of it;
 * docs/snapshot.md has the format. The CRC detects accidental errors only: anybody can compute one, and errors that
 * were in memory before are sealed with it. Therefore zygos_seal() and zygos_resume(), which seal and check the state
 * of an arm by these functions, verify it beside that. */

/// Length of the head in bytes.
#define ZYGOS_SNAPSHOT_HEAD 24u
/// Version of the head and of the meaning of the images, independent of the version of the library.
#define ZYGOS_SNAPSHOT_FORMAT 1u

/// The content of a snapshot.
enum zygos_snapshot_kind {
    ZYGOS_SNAPSHOT_CONFIG = 1, ///< The image is a zygos_config_t.
    ZYGOS_SNAPSHOT_STATE = 2   ///< The image is a zygos_arm_t.
};

/// Writes the head of an image into head[ZYGOS_SNAPSHOT_HEAD]. kind: enum zygos_snapshot_kind. For a state, call it in
/// the task of zygos_arm_step(), while no frame is being received. Returns 1, ZYGOS_E_NULL or ZYGOS_E_KIND. Cost: two
/// table look-ups for each byte of the image.
int zygos_snapshot_seal(uint32_t kind, const void *image, uint8_t *head);

/// Checks a snapshot that was read back: length is the number of bytes, of which the first ZYGOS_SNAPSHOT_HEAD are in
/// head and the others in image. Changes nothing. Returns 1 when the image is what was sealed; otherwise the image must
/// not be used, and the result is the first of ZYGOS_E_NULL, ZYGOS_E_SNAPSHOT, ZYGOS_E_FORMAT, ZYGOS_E_KIND,
/// ZYGOS_E_BYTE_ORDER, ZYGOS_E_LAYOUT, ZYGOS_E_LENGTH and ZYGOS_E_CRC that applies. Cost: as zygos_snapshot_seal().
int zygos_snapshot_check(uint32_t kind, const uint8_t *head, const void *image, uint32_t length);

/* ---------------------------------------------------------------- codes in words
 *
 * There is one function for each enumeration whose values mean one thing each; enumerations of bits have none, because
 * their values are combinations. Every function returns a constant string in English, without a full stop, and
 * "unknown code" for a number that is no value of its enumeration; it never returns null. A program that calls none of
 * these functions does not link them: they are an object file of their own in the library. */

/// What a call returned: enum zygos_error, and "no error" for 0 and above. The texts of the codes from ZYGOS_E_SNAPSHOT
/// down continue a sentence that begins with the name of the stored file.
const char *zygos_text(int code);

/// Texts of enum zygos_validity and of enum zygos_reason, from an estimate.
const char *zygos_validity_text(uint32_t validity);
const char *zygos_reason_text(uint32_t reason);

/// Text of a kind of rows, enum zygos_rows.
const char *zygos_rows_text(uint32_t rows);

/// Text of a kind of readings whose innovations are counted, enum zygos_channel.
const char *zygos_channel_text(uint32_t channel);

/// Text of why refined values are not published, enum zygos_refine_reason.
const char *zygos_refine_text(uint32_t reason);

/// Texts of enum zygos_reception, which zygos_arm_frame() returns, of enum zygos_message and of enum zygos_wire_fault.
const char *zygos_reception_text(uint32_t reception);
const char *zygos_message_text(uint32_t message);
const char *zygos_wire_fault_text(uint32_t fault);

/// Text of what a fault counter counts. counter: its place in zygos_faults_t, 0 .. ZYGOS_FAULT_COUNTERS - 1.
const char *zygos_fault_text(uint32_t counter);

/// Texts of the enumerations in a configuration: enum zygos_kinetic, zygos_base, zygos_torque_law, zygos_effect_kind.
const char *zygos_kinetic_text(uint32_t kinetic);
const char *zygos_base_text(uint32_t base);
const char *zygos_torque_law_text(uint32_t torque_law);
const char *zygos_effect_text(uint32_t kind);

/// Text of where a solution is, enum zygos_stage.
const char *zygos_stage_text(uint32_t stage);

/// Text of a kind of snapshot, enum zygos_snapshot_kind.
const char *zygos_snapshot_kind_text(uint32_t kind);

#ifdef __cplusplus
}
#endif
#endif
