/* SPDX-License-Identifier: MIT */
/// zygos/priv/cycle.h: assembles frames into complete cycles.
///
/// A SYNC opens a cycle and closes the one before. A cycle is complete when the angle and torque frames of each joint
/// and the rate frames of the gyro have arrived exactly once, valid, and with the counter of this SYNC. Neither receive
/// times nor the order of arrival within a cycle are used, so that a log that is replayed at any speed gives the same
/// bits.
///
/// One producer (zygos_arm_frame(), in an interrupt or a task) and one consumer (zygos_arm_step()) share the queue
/// without a lock.

#ifndef ZYGOS_CYCLE_H
#define ZYGOS_CYCLE_H

#include "../types.h"
#include "../wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Faults of the bus and of the sensors, counted since init. "Own frames" are those with an identifier of this arm. The
/// counters wrap at 2^32. zygos_fault_text() has them in words.
typedef struct {
    uint32_t length;   ///< Own frames with a wrong length (DLC).
    uint32_t crc;      ///< Own frames with a wrong CRC or data identifier.
    uint32_t range;    ///< Own frames with a field outside its range.
    uint32_t late;     ///< Frames of the cycle that closed last.
    uint32_t counter;  ///< Frames whose counter belongs neither to the open cycle nor to the last one.
    uint32_t repeated; ///< Frames that arrived twice in one cycle; the cycle is dropped.
    uint32_t unsynced; ///< Frames before the first SYNC.
    uint32_t latch; ///< Torque frames whose latch delay differs from the configured one by more than 50 us; the cycle
                    ///< is dropped.
    uint32_t link_invalid;   ///< Frames with an invalid link angle, by status bit or code; the cycle is dropped.
    uint32_t motor_invalid;  ///< The same for the motor angle.
    uint32_t torque_invalid; ///< The same for the torque, by status bit.
    uint32_t disabled;       ///< Frames that report a disabled drive or a closed brake; the cycle is dropped.
    uint32_t gyro_invalid;   ///< Frames that report an invalid rate, or frames of a fine gyro where a coarse one is
                             ///< configured.
    uint32_t saturated;      ///< Torques or rates with the largest or smallest code; the cycle is dropped.
    uint32_t incomplete;     ///< Cycles that closed with a frame missing or rejected.
    uint32_t dropped;        ///< Cycles that were not used, for any reason.
    uint32_t sync_repeated;  ///< SYNCs with the counter of the SYNC before.
    uint32_t sync_jumped;    ///< SYNCs that skipped at least one counter.
    uint32_t time_lost;      ///< Number of times that more than 120 cycles passed without FTIME.
    uint32_t time_jumped;    ///< FTIMEs that differ from the SYNC count by more than half a cycle. The arc ends; when
                             ///< cycles are missing, every arc with instants after the FTIME before is dropped.
    uint32_t overrun;        ///< Complete cycles that were lost because the queue was full.
    uint32_t bus_error;      ///< Error frames of the CAN controller; bus-off ends the arc.
} zygos_faults_t;

/// Number of counters in zygos_faults_t.
#define ZYGOS_FAULT_COUNTERS ((uint32_t)(sizeof(zygos_faults_t) / sizeof(uint32_t)))

/// The result of zygos_arm_frame(): the frame has no identifier of this arm, was accepted, or was rejected and counted.
enum zygos_reception { ZYGOS_FOREIGN = 0, ZYGOS_ACCEPTED = 1, ZYGOS_REJECTED = 2 };

/// Status of reception. It changes with every own frame, also with rejected ones.
typedef struct {
    uint32_t last_verdict; ///< ZYGOS_ACCEPTED or ZYGOS_REJECTED, for the newest own frame.
    uint32_t spoiled;      ///< 1: the open cycle will be dropped because of a repeated or invalid frame.
} zygos_reception_status_t;

/// The open cycle, and the time base of the SYNCs.
typedef struct {
    uint64_t sync;       ///< SYNCs since init: the number of the open cycle.
    uint32_t received;   ///< Bit 2i: angles of joint i; bit 2i+1: its torque; then rate xy or all rates, rate z.
    uint32_t counter;    ///< SYNC counter of the open cycle, 0 before the first SYNC.
    uint32_t broken;     ///< The flags that the next complete cycle will have.
    uint64_t void_from;  ///< With ZYGOS_CYCLE_VOID: the last cycle that can be trusted.
    uint32_t since_time; ///< Cycles since the last FTIME.
    uint32_t timed;      ///< 1: time_us and time_sync hold the last FTIME; 2: one before zygos_receiver_resume().
    uint32_t time_us;
    uint64_t time_sync;
    uint64_t fold; ///< Of the readings of the open cycle that have arrived, in whatever order.
} zygos_assembly_t;

/// Ring buffer of the complete cycles, followed by the open one. Only the producer writes head, only the consumer
/// writes tail.
typedef struct {
    uint32_t head; ///< Index of the open cycle.
    uint32_t tail; ///< Index of the oldest complete cycle, if there is one.
    zygos_cycle_t slot[ZYGOS_CYCLE_QUEUE + 1];
    uint64_t fold[ZYGOS_CYCLE_QUEUE + 1]; ///< Of the readings of a complete cycle, its number and flags.
} zygos_queue_t;

/// Everything about reception.
typedef struct {
    zygos_faults_t faults;
    zygos_reception_status_t status;
    zygos_assembly_t assembly;
    zygos_queue_t queue;
} zygos_receiver_t;

/// Initialises *self. Cost: one memset.
void zygos_receiver_init(zygos_receiver_t *self);

/// Returns whether the indices of the queue are possible. The functions of the oldest cycle rely on that and do not
/// check it.
bool zygos_receiver_intact(const zygos_receiver_t *self);

/// Discards the cycles in the queue, whatever its indices are. Returns how many there were.
uint32_t zygos_receiver_discard(zygos_receiver_t *self);

/// Continues after an outage of unknown length, during which nothing was received. The open cycle is lost, and is
/// counted when the next SYNC closes it; cycles in the queue are discarded and counted as dropped. The cycle number
/// continues by the increment of the SYNC counter, modulo 240. The next FTIME corrects it if the two are consistent,
/// and is otherwise counted in time_jumped.
void zygos_receiver_resume(zygos_receiver_t *self);

/// Receives one frame. Needs an initialised receiver and a checked configuration. The function only decodes and stores.
/// A rejected frame changes faults and status and nothing else. Returns enum zygos_reception. Cost: one CRC.
int zygos_receiver_frame(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame);

/// Returns the oldest complete cycle in the queue, or null when there is none. The cycle stays in its place until
/// zygos_receiver_pop(), which must not be called when there is none.
const zygos_cycle_t *zygos_receiver_front(const zygos_receiver_t *self);
void zygos_receiver_pop(zygos_receiver_t *self);

/// Returns whether the oldest complete cycle is the one that arrived; otherwise memory was changed since. Needs that
/// there is one. Cost: 3 operations for each joint.
bool zygos_receiver_front_is_whole(const zygos_receiver_t *self, const zygos_config_t *config);

/// The readings of the cycle before: the torque is needed by the torque law, the angles are needed to detect a wrap.
typedef struct {
    double reported[ZYGOS_MAX_JOINTS]; ///< Reported torques.
    double q[ZYGOS_MAX_JOINTS];        ///< Readings of the link encoders.
    double theta[ZYGOS_MAX_JOINTS];    ///< Readings of the motor encoders.
} zygos_previous_cycle_t;

/// Returns 1 when an angle has passed the end of its multi-turn range since the cycle before: it differs by more than
/// half of that range, 8 turns. Cost: 2 comparisons for each joint.
int zygos_cycle_wrapped(const zygos_previous_cycle_t *previous, const zygos_config_t *config,
                        const zygos_cycle_t *cycle);

/// Applies signs, zeros and mounting. Writes the signals q_1..q_N, theta_1..theta_N, omega_x..omega_z (base axes) into
/// signal[2N+3], and into tau[N] the torque that acted from the SYNC before this one until this one.
/// Stores the readings in *previous. Cost: 9 multiplications for the gyro and 6 for each joint.
void zygos_cycle_calibrate(zygos_previous_cycle_t *previous, const zygos_config_t *config, const zygos_cycle_t *cycle,
                           double *signal, double *tau);

/// Returns 1 when link and motor angle of a joint, as zygos_cycle_calibrate() writes them, differ by more than 8 turns:
/// one of them has passed the end of its multi-turn range and the other has not, which would be a deflection of 16
/// turns. No spring deflects by half of that; those of a rigid joint are the same. Cost: 3 operations for each joint.
int zygos_cycle_apart(const double *signal, uint32_t joints);

#ifdef __cplusplus
}
#endif
#endif
