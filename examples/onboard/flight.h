/// What the machine calls, and what it gives: the flight loop of one arm, from the receive interrupt to what is
/// believed.

#ifndef FLIGHT_H
#define FLIGHT_H

#include <zygos/zygos.h>

/// A frame of this spacecraft's own, by which the ground or the mission manager says: the gripper took or left a load.
#define FLIGHT_PAYLOAD_CHANGED 0x7F0u

/// What the rest of the flight software may use. An entry stays as it is until a better one is known; those of bodies
/// are forgotten when the payload changes.
typedef struct {
    uint64_t cycle;                       ///< Of the newest estimate that was good.
    uint32_t known[ZYGOS_MAX_PARAMETERS]; ///< 1: value and half95 hold.
    double value[ZYGOS_MAX_PARAMETERS];
    double half95[ZYGOS_MAX_PARAMETERS]; ///< Half width of the 95 % interval.
} flight_learned_t;

/// Start-up: goes on with a stored state, or starts from nothing. Returns 2, 1, or an enum zygos_error.
int flight_start(void);

/// Receive interrupt: puts the frame into a ring, no floating point. One caller.
void flight_receive(const zygos_frame_t *frame);

/// 1 while frames wait in the ring.
int flight_waiting(void);

/// The task of each SYNC period: works off what was received. May be interrupted by flight_receive() and may interrupt
/// flight_solve().
void flight_task(void);

/// The background task: solves when the other task left something to solve, and sends telemetry. Returns the estimate,
/// which holds until the next call, or null.
const zygos_estimate_t *flight_solve(void);

/// What is believed. Read it in the task that solves, or where that task cannot interrupt.
const flight_learned_t *flight_learned(void);

/// Stores the state, unless memory errors have changed it. In the task of the SYNC period; the state is whole, so
/// frames may come. flight_solve() must not run any more, whose memory the check takes. Returns 1 or 0.
int flight_store(void);

/// The port: sends a frame, or drops it when there is no room; never waits.
void port_send(const zygos_frame_t *frame);

/// The port: memory that outlives power. Each returns how many bytes of head and image were moved, 0 without such
/// memory.
uint32_t port_load(uint8_t head[ZYGOS_SNAPSHOT_HEAD], void *image, uint32_t size);
uint32_t port_save(const uint8_t head[ZYGOS_SNAPSHOT_HEAD], const void *image, uint32_t size);

#endif
