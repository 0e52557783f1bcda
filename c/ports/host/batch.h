/// Host only: whole recordings in one call, for bindings to languages in which a call per frame is slow.

#ifndef ZYGOS_BATCH_H
#define ZYGOS_BATCH_H

#include "zygos/zygos.h"

/// Where a run leaves what each room made of each cycle. Any pointer may be null. Arrays are row-major.
typedef struct {
    uint64_t capacity; ///< Cycles that fit.
    uint64_t count;    ///< Cycles written.
    uint64_t *sync;    ///< capacity: SYNC number.
    uint32_t *flags;   ///< capacity: flags of the cycle.
    uint8_t *instant;  ///< capacity: 1 when the cycle completed an instant with a row.
    uint8_t *accepted; ///< capacity: 1 when the row was accumulated.
    double *measured;  ///< capacity x (3N+3): q, theta, tau, omega as they came in.
    double *state;     ///< capacity x (4N+3): q, theta, q rate, theta rate, omega, smoothed.
    double *row;       ///< capacity x (p+1): the columns and the work.
} zygos_trace_t;

/// Feeds frames and works off cycles as they complete. verdict[n] (may be null) takes enum zygos_reception of each
/// frame. Returns the number of cycles worked off, or an enum zygos_error.
int64_t zygos_batch_frames(zygos_t *self, const zygos_frame_t *frame, uint64_t n, uint8_t *verdict,
                           zygos_trace_t *trace);

/// Feeds cycles in SI. Returns the number of cycles used, or an enum zygos_error.
int64_t zygos_batch_cycles(zygos_t *self, const zygos_cycle_t *cycle, uint64_t n, zygos_trace_t *trace);

/// Encodes cycles as the traffic of a bus: per cycle SYNC, FTIME (every 50th cycle), the angles and torques of each
/// joint, the gyro; and one SYNC at the end that closes the last cycle. Returns the number of frames, at most n (4 + 2
/// N) + 1, which must fit into out. Cycles whose invalid flag is set are sent with their status bits cleared.
uint64_t zygos_batch_encode(const zygos_config_t *config, const zygos_cycle_t *cycle, uint64_t n, zygos_frame_t *out);

/// Digest of the declarations that the library was compiled with.
uint32_t zygos_declarations_digest(void);

#endif
