/* SPDX-License-Identifier: MIT */
/// Host only: whole recordings in one call, for bindings to languages in which a call per frame is slow.

#ifndef ZYGOS_BATCH_H
#define ZYGOS_BATCH_H

#include "zygos/zygos.h"

/// The results of each module for each cycle. Any pointer may be null. Arrays are row-major.
typedef struct {
    uint64_t capacity; ///< Number of cycles for which there is memory.
    uint64_t count;    ///< Number of cycles written.
    uint64_t *sync;    ///< capacity: SYNC number.
    uint32_t *flags;   ///< capacity: flags of the cycle.
    uint8_t *instant;  ///< capacity: 1 when the cycle completed an instant with a row.
    uint8_t *waited;   ///< capacity: kinds of rows (enum zygos_rows), as bits, of which there is no row because an
                       ///< arc waited for its end.
    uint8_t *accepted; ///< capacity: 1 when the row was accumulated.
    double *measured;  ///< capacity x (3N+3): readings q, theta, tau, omega.
    double *state;     ///< capacity x (4N+3): smoothed q, theta, q rate, theta rate, omega.
    double *row;       ///< capacity x (p+1): the columns and the work.
} zygos_trace_t;

/// Receives frames and processes the cycles that they complete. Writes enum zygos_reception of each frame into
/// verdict[n], which may be null. Returns the number of cycles that were processed, or an enum zygos_error.
int64_t zygos_batch_frames(zygos_arm_t *self, const zygos_frame_t *frame, uint64_t n, uint8_t *verdict,
                           zygos_trace_t *trace);

/// Processes cycles in SI units. Returns the number of cycles used, or an enum zygos_error.
int64_t zygos_batch_cycles(zygos_arm_t *self, const zygos_cycle_t *cycle, uint64_t n, zygos_trace_t *trace);

/// Encodes cycles as the traffic of a bus: per cycle SYNC, FTIME (every 50th cycle), the angles and torques of each
/// joint, the gyro; and one SYNC at the end that closes the last cycle. Returns the number of frames, at most n (4 + 2
/// N) + 1, which must fit into out. Cycles whose invalid flag is set are sent with their status bits cleared.
uint64_t zygos_batch_encode(const zygos_config_t *config, const zygos_cycle_t *cycle, uint64_t n, zygos_frame_t *out);

/// Digest of the declarations that the library was compiled with.
uint32_t zygos_declarations_digest(void);

#endif
