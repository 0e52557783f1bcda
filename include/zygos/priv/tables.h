/* SPDX-License-Identifier: MIT */
/// zygos/priv/tables.h: verifies the configuration and what follows from it, all at once or by a part in each cycle.

#ifndef ZYGOS_TABLES_H
#define ZYGOS_TABLES_H

#include "../types.h"
#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Words of eight bytes that are verified in a cycle.
#define ZYGOS_PATROL_WORDS 4u

/// Where the patrol is.
typedef struct {
    uint32_t region; ///< 0: the configuration; the tables follow.
    uint32_t offset; ///< Bytes of it that were verified.
    uint64_t sum;    ///< Checksum of the tables so far.
    uint64_t begun;  ///< Number of the newest cycle when this pass began.
} zygos_patrol_t;

/// Returns the checksum of everything that follows from the configuration alone. Cost: one pass over it.
uint64_t zygos_tables_checksum(const zygos_arm_t *arm);

/// Verifies the next part; after the last one the next pass begins, and zygos_arm_t.scrubbed is the number of the cycle
/// at which this pass began. *config is the caller's own configuration. Returns false where memory was changed: call
/// zygos_arm_scrub(), and begin anew with a patrol that is all zero. Cost: ZYGOS_PATROL_WORDS.
bool zygos_patrol_part(zygos_patrol_t *self, zygos_arm_t *arm, const zygos_config_t *config);

/// Returns the number of cycles that a pass takes.
uint32_t zygos_patrol_cycles(void);

#ifdef __cplusplus
}
#endif
#endif
