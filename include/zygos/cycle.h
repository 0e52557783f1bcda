/// zygos/cycle.h: frames to complete cycles.
///
/// A SYNC opens a cycle and closes the one before. A cycle is complete when each joint's angle and torque frame and the
/// gyro's rate frames have come exactly once, valid, with the counter of this SYNC. Nothing is decided by receive time
/// or by the order of arrival within a cycle, so a log replayed at any speed gives the same bits.
///
/// One producer (zygos_frame(), an interrupt or a task) and one consumer (zygos_step()) share the queue without a lock.

#ifndef ZYGOS_CYCLE_H
#define ZYGOS_CYCLE_H

#include "types.h"
#include "wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What the world did wrong, counted since init. Counters wrap at 2^32.
typedef struct {
    uint32_t length;   ///< Frames of ours with a wrong DLC.
    uint32_t crc;      ///< Frames of ours with a wrong CRC or data identifier.
    uint32_t range;    ///< Frames of ours with a field outside its range.
    uint32_t late;     ///< Frames of the cycle that closed last.
    uint32_t counter;  ///< Frames whose counter belongs neither to this cycle nor to the last.
    uint32_t repeated; ///< Frames that came twice in one cycle; the cycle is dropped.
    uint32_t unsynced; ///< Frames before the first SYNC.
    uint32_t latch;    ///< Torque frames whose latch delay is over 50 us off the configured one; the cycle is dropped.
    uint32_t
        link_invalid; ///< Frames whose status bit or code says that the link angle is invalid; the cycle is dropped.
    uint32_t motor_invalid;
    uint32_t torque_invalid;
    uint32_t disabled;      ///< Frames that say: drive disabled or brake closed; the cycle is dropped.
    uint32_t gyro_invalid;  ///< Frames whose status bit says so, or of a fine gyro where a coarse one is configured.
    uint32_t saturated;     ///< Torque or rate at its outermost code; the cycle is dropped.
    uint32_t incomplete;    ///< Cycles that closed with a frame missing or rejected.
    uint32_t dropped;       ///< Cycles not used, for whatever reason.
    uint32_t sync_repeated; ///< SYNCs with the counter of the SYNC before.
    uint32_t sync_jumped;   ///< SYNCs that skipped at least one counter.
    uint32_t time_lost;     ///< Times that more than 120 cycles passed without FTIME.
    uint32_t time_jumped;   ///< FTIMEs that disagree with the SYNC count by more than half a cycle. The arc ends; when
                            ///< cycles are missing, every arc that reaches behind the FTIME before is dropped.
    uint32_t overrun;       ///< Complete cycles lost because the queue was full.
    uint32_t bus_error;     ///< Error frames from the controller; bus-off ends the arc.
} zygos_faults_t;

/// Number of counters in zygos_faults_t.
#define ZYGOS_FAULT_COUNTERS ((uint32_t)(sizeof(zygos_faults_t) / sizeof(uint32_t)))

/// What zygos_frame() made of a frame.
enum zygos_reception { ZYGOS_FOREIGN = 0, ZYGOS_ACCEPTED = 1, ZYGOS_REJECTED = 2 };

/// State of reception: changes with every frame of ours, rejected ones included.
typedef struct {
    uint32_t last_verdict; ///< ZYGOS_ACCEPTED or ZYGOS_REJECTED: what became of the newest frame of ours.
    uint32_t spoiled;      ///< 1: the open cycle will be dropped (a repeated or invalid frame).
} zygos_reception_status_t;

/// The open cycle and the clock of the SYNCs.
typedef struct {
    uint64_t sync;       ///< SYNCs since init: the number of the open cycle.
    uint32_t received;   ///< Bit 2i: angles of joint i; bit 2i+1: its torque; then rate xy or all, rate z.
    uint32_t counter;    ///< SYNC counter of the open cycle, 0 before the first SYNC.
    uint32_t broken;     ///< Flags of the next complete cycle.
    uint64_t void_from;  ///< With ZYGOS_CYCLE_VOID: the last cycle that can be trusted.
    uint32_t since_time; ///< Cycles since the last FTIME.
    uint32_t timed;      ///< 1: time_us and time_sync hold the last FTIME; 2: one before zygos_receiver_resume().
    uint32_t time_us;
    uint64_t time_sync;
} zygos_assembly_t;

/// Ring of complete cycles, and the open one behind them. head is written by the producer only, tail by the consumer
/// only.
typedef struct {
    uint32_t head; ///< Place of the open cycle.
    uint32_t tail; ///< Place of the oldest complete one, if there is one.
    zygos_cycle_t slot[ZYGOS_CYCLE_QUEUE + 1];
} zygos_queue_t;

typedef struct {
    zygos_faults_t faults;
    zygos_reception_status_t status;
    zygos_assembly_t assembly;
    zygos_queue_t queue;
} zygos_receiver_t;

/// Forgets everything. Needs memory of its own; cost: one memset.
void zygos_receiver_init(zygos_receiver_t *self);

/// Whether the places in the queue exist: the other calls rely on that, and do not look.
bool zygos_receiver_intact(const zygos_receiver_t *self);

/// Goes on after an outage of unknown length, during which nothing was received. The open cycle is lost, and counted
/// when the next SYNC closes it; cycles in the queue are forgotten and counted as dropped. The cycle number goes on by
/// the step of the SYNC counter, modulo 240; the next FTIME corrects it where it fits, and otherwise counts in
/// time_jumped.
void zygos_receiver_resume(zygos_receiver_t *self);

/// Takes one frame. Needs an initialised receiver and a checked configuration. Decodes and stores only: bounded by one
/// CRC. A rejected frame changes faults and status and nothing else. Returns enum zygos_reception.
int zygos_receiver_frame(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame);

/// The oldest complete cycle in the queue, or null when there is none. It stays there, and in its place, until
/// zygos_receiver_pop(), which needs that there is one.
const zygos_cycle_t *zygos_receiver_front(const zygos_receiver_t *self);
void zygos_receiver_pop(zygos_receiver_t *self);

/// What later cycles need of this one: the reported torque for the torque law, the angles to notice that they wrap.
typedef struct {
    double reported[ZYGOS_MAX_JOINTS]; ///< Torque.
    double q[ZYGOS_MAX_JOINTS];        ///< Encoder readings of the cycle before.
    double theta[ZYGOS_MAX_JOINTS];
} zygos_previous_cycle_t;

/// Returns 1 when an angle went over the end of its multi-turn range since the cycle before: it differs by more than
/// half that range, 8 turns. Cost: 2 comparisons a joint.
int zygos_cycle_wrapped(const zygos_previous_cycle_t *previous, const zygos_config_t *config,
                        const zygos_cycle_t *cycle);

/// Returns 1 when link and motor angle of a flexible joint, signs and zeros applied, are more than 8 turns apart: one
/// of them has gone over the end of its multi-turn range and the other has not, which reads as a deflection of 16
/// turns. No spring gives way by half of that. Cost: 5 operations a joint.
int zygos_cycle_apart(const zygos_config_t *config, const zygos_cycle_t *cycle);

/// Applies signs, zeros and mounting. Writes the signals q_1..q_N, theta_1..theta_N, omega_x..omega_z (base axes) into
/// signal[2N+3], and into tau[N] the torque that was in force from the SYNC before this one until this one.
/// Changes *hold. Cost: 9 multiplications for the gyro and 6 a joint.
void zygos_cycle_calibrate(zygos_previous_cycle_t *previous, const zygos_config_t *config, const zygos_cycle_t *cycle,
                           double *signal, double *tau);

#ifdef __cplusplus
}
#endif
#endif
