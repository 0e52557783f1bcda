/* SPDX-License-Identifier: MIT */
/// The flight loop of one arm, from the receive interrupt to the estimate in use: the functions that a port calls, and
/// those that it provides.

#ifndef FLIGHT_H
#define FLIGHT_H

#include <zygos/zygos.h>

/// A frame of this spacecraft, by which the ground or the mission manager reports that the gripper took or released a
/// load.
#define FLIGHT_PAYLOAD_CHANGED 0x7F0u

/// The estimate in use, for the rest of the flight software. An entry is kept until a better one is known; the entries
/// of bodies are discarded when the payload changes.
typedef struct {
    uint64_t cycle;                       ///< Cycle of the newest estimate that was used.
    uint32_t known[ZYGOS_MAX_PARAMETERS]; ///< 1: value and half95 are valid.
    double value[ZYGOS_MAX_PARAMETERS];
    double half95[ZYGOS_MAX_PARAMETERS]; ///< Half width of the 95 % interval.
} flight_learned_t;

/// Start-up: continues with a stored state (returns 2) or initialises the library (returns 1, or an enum zygos_error).
int flight_start(void);

/// Receive interrupt: without floating point. There must be one caller.
void flight_receive(const zygos_frame_t *frame);

/// The task of each SYNC period: processes the frames that were received. flight_receive() may interrupt it, and it may
/// interrupt flight_solve().
void flight_task(void);

/// The background task: solves when the other task has copied the sums, and sends telemetry. Returns the estimate,
/// which is valid until the next call, or null.
const zygos_estimate_t *flight_solve(void);

/// Returns the estimate in use. Read it in the task that solves, or where that task cannot interrupt.
const flight_learned_t *flight_learned(void);

/// Stores the state, unless memory errors have changed it beyond repair. Call it in the task of the SYNC period. Where
/// power may fail meanwhile, keep two places and write them in turn: a CRC tells a half-written one. Returns 1 or 0.
int flight_store(void);

/// Function of the port: sends a frame, or drops it when the buffer is full; it never waits.
void port_send(const zygos_frame_t *frame);

/// Functions of the port for non-volatile memory. Each returns the number of bytes of head and image that were moved, 0
/// without such memory.
uint32_t port_load(uint8_t head[ZYGOS_SNAPSHOT_HEAD], void *image, uint32_t size);
uint32_t port_save(const uint8_t head[ZYGOS_SNAPSHOT_HEAD], const void *image, uint32_t size);

#endif
