/// zygos/priv/sums.h: the sums of all rows of one arm, with what tells how to read them. The state of an arm has one
/// (arm.h), and a solution works on another one, which zygos_arm_take() copies as a whole and handover.h in parts.

#ifndef ZYGOS_SUMS_H
#define ZYGOS_SUMS_H

#include "../types.h"
#include "accumulator.h"
#include "balance.h"
#include "guard.h"
#include "jointsums.h"
#include "momentumsums.h"
#include "motorsums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The kind of the joint rows, behind those of enum zygos_rows. They have no arcs.
#define ZYGOS_JOINT_KIND 3u
#define ZYGOS_KINDS_THAT_FADE 4u

/// Everything that a solution needs.
typedef struct {
    uint64_t cycle;   ///< SYNC number of the newest cycle that was processed.
    uint32_t arc;     ///< Number of instants of the open arc of energy rows, accepted or not.
    uint32_t ending;  ///< Kinds of rows (enum zygos_rows), as bits, whose open arc has ended, and waits until
                      ///< the arc before it is closed. There are no rows of these kinds until then.
    uint32_t dropped; ///< Number of times, modulo 2^32, that sums were dropped or changed at once.
    uint32_t reserved;
    uint64_t ended[ZYGOS_KINDS_OF_ROWS];          ///< The newest cycle of the arcs that wait.
    double ended_forgetting[ZYGOS_KINDS_OF_ROWS]; ///< Their products of forgetting factors; 1 where none waits.
    double forgetting[ZYGOS_KINDS_THAT_FADE]; ///< Product of the forgetting factors of the cycles in the open arc; of
                                              ///< joint rows, since the last complete segment.
    zygos_config_t config;
    zygos_column_map_t column_map;
    zygos_motor_sums_t motors;
    zygos_momentum_sums_t momentum;
    zygos_joint_sums_t joints;
    zygos_accumulator_t energy;
    zygos_guard_t guard;
} zygos_sums_t;

/// Finishes the tasks that proceed beside the cycles (accumulator.h). Returns false when a count, an index or a closing
/// arc is not as it was accumulated. Cost: a few passes over the sums of an arc.
bool zygos_sums_settle(zygos_sums_t *sums);

/// Returns whether what is summed matches what is summed beside it, or has the right checksum. Needs that all arcs have
/// ended. Cost: a pass over the sums.
bool zygos_sums_match(const zygos_sums_t *sums);

/// Settles, ends the open arcs, and returns whether the sums and counts are those that were accumulated. Where this is
/// false, zygos_work_solve() gives ZYGOS_REASON_CORRUPT. Call it for a copy. Cost: a few passes over the sums.
bool zygos_sums_intact(zygos_sums_t *sums);

#ifdef __cplusplus
}
#endif
#endif
