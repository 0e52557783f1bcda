/// zygos/priv/motorsums.h: accumulates the normal equations of the motor impulse rows, a small set for each joint.
///
/// The rows of a joint contain only its own parameters. Their sums are therefore separate from those of the energy rows
/// until the solver adds both, each with a weight by its noise. The bias by the noise of the sensors is the same at
/// every instant, and is subtracted when an arc ends. The noise that the integral of the deflection accumulates is
/// correlated over a whole arc; therefore blocks consist of whole arcs. When all blocks are in use, two neighbours are
/// merged.
///
/// What follows when an arc ends is a task that proceeds by one joint, or one block, in each cycle: an arc is closing
/// from its end until it is admitted.

#ifndef ZYGOS_MOTORSUMS_H
#define ZYGOS_MOTORSUMS_H

#include "../types.h"
#include "impulse.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The length of a joint's row that is augmented by the impulse and by 1.
#define ZYGOS_MAX_MOTOR_ROW (ZYGOS_MAX_IMPULSE + 2)
#define ZYGOS_MAX_PACKED_MOTOR (ZYGOS_MAX_MOTOR_ROW * (ZYGOS_MAX_MOTOR_ROW + 1) / 2)

/// Sum of z z^T with z = [columns, impulse, 1], lower triangle by rows, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_MOTOR];
    double sum[ZYGOS_MAX_MOTOR_ROW];
} zygos_motor_gram_t;

/// One block of the sums.
typedef struct {
    zygos_motor_gram_t joint[ZYGOS_MAX_JOINTS]; ///< Closed arcs: without the constants and the noise.
    double instants[ZYGOS_MAX_JOINTS];          ///< Accepted instants whose row of that joint was added.
    double total;                               ///< All accepted instants.
    double fade;                                ///< Factor of the block (exponential forgetting).
    uint64_t end;                               ///< Number of the newest cycle.
    uint64_t checksum;                          ///< Closed arcs: of instants, total, fade and end.
} zygos_motor_block_t;

/// The tasks, which are done beside the rows of a cycle.
#define ZYGOS_MOTOR_NONE 0u
#define ZYGOS_MOTOR_CLOSE 1u ///< Compares a joint of the closing arc with its row sums, and eliminates its constant.
#define ZYGOS_MOTOR_JUDGE 2u ///< Compares it with the running solution (guard.h).
#define ZYGOS_MOTOR_ADMIT 3u ///< Admits the arc.
#define ZYGOS_MOTOR_MERGE 4u ///< Adds a joint of a block to that of the block before it.
#define ZYGOS_MOTOR_SHIFT 5u ///< Moves a block to the place before it.
#define ZYGOS_MOTOR_TASKS 6u

/// The normal equations of the motor rows.
typedef struct {
    zygos_impulse_column_map_t column_map;
    double noise[ZYGOS_MAX_JOINTS][ZYGOS_MAX_PACKED_IMPULSE]; ///< Expected products of noise in one instant.
    uint32_t count;                                           ///< Number of blocks of closed arcs.
    uint32_t corrupt;     ///< 1: count and target did not match the checksum, and no single bit explains that.
    uint32_t instants;    ///< Accepted instants of the open arc.
    uint32_t cycles;      ///< Instants of the open arc, accepted or not.
    uint32_t quarantined; ///< Arcs and blocks that were dropped since the last zygos_arm_scrub(): memory was changed.
    uint32_t task;        ///< One of the tasks above.
    uint32_t joint;       ///< The next joint of the task.
    uint32_t place;       ///< The block that the task changes.
    uint32_t whole;       ///< 1: all that was compared of the closing arc matches.
    uint32_t closing_cycles; ///< Instants of the closing arc, accepted or not.
    double target;           ///< Instants up to which blocks are merged.
    uint64_t checksum;       ///< Of count and target.
    zygos_motor_block_t open;
    zygos_motor_block_t closing;
    zygos_motor_block_t block[ZYGOS_MAX_MOTOR_BLOCKS];
} zygos_motor_sums_t;

/// Computes what follows from the configuration: the columns, and the noise of an instant. The sums are not changed.
/// Needs a checked configuration.
void zygos_motor_sums_tables(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_smoother_t *smoother);

/// Returns whether every index and count is possible for a checked configuration. The other functions rely on that and
/// do not check it. Cost: a comparison for each block and each column.
bool zygos_motor_sums_intact(const zygos_motor_sums_t *self, const zygos_config_t *config);

/// Clears the sums. The tables are kept.
void zygos_motor_sums_clear(zygos_motor_sums_t *self, const zygos_config_t *config);

/// Adds the row of one joint with weight 1 or 0. The joints take turns, one in each instant, because the noise of
/// neighbouring instants is nearly the same. Cost: one small rank-1 update.
void zygos_motor_sums_add(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_impulse_rows_t *rows,
                          double weight);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_motor_sums_is_short(const zygos_motor_sums_t *self);

/// Ends the open arc, whose newest cycle is given: it is closing from then on, or dropped when it is too short, and
/// then false is returned. Needs that no task is open, or that the arc is too short. Cost: the sums of an arc are
/// copied.
bool zygos_motor_sums_close(zygos_motor_sums_t *self, uint64_t cycle);

/// Proceeds with the task by one joint or one block. ZYGOS_MOTOR_JUDGE is that of the caller, who ends it by the next
/// function: this one does nothing then. Cost: one pass over the sums of a joint, or of a block.
void zygos_motor_sums_proceed(zygos_motor_sums_t *self, const zygos_config_t *config);
void zygos_motor_sums_judged(zygos_motor_sums_t *self, bool admitted);

/// Returns whether a cycle addresses nothing outside the struct. Cost: four comparisons.
bool zygos_motor_sums_steady(const zygos_motor_sums_t *self);

/// Drops the open arc.
void zygos_motor_sums_leave_out(zygos_motor_sums_t *self);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Needs finished tasks. Cost: a few
/// instructions for each block.
void zygos_motor_sums_forget(zygos_motor_sums_t *self, double factor);

/// Multiplies each block by its factor, which is 1 then. Needs finished tasks. Cost: one pass over the blocks of which
/// the factor is not 1.
void zygos_motor_sums_apply_fade(zygos_motor_sums_t *self);

/// Drops the open arc, the closing one, and the blocks with cycles after the given one.
void zygos_motor_sums_drop_after(zygos_motor_sums_t *self, uint64_t cycle);

/// Drops the blocks up to the given cycle, and returns their number.
uint32_t zygos_motor_sums_drop_until(zygos_motor_sums_t *self, uint64_t cycle);

/// Drops each block that does not match its row sums or its checksum, and the open arc where its sums do not match;
/// repairs a flipped bit of count and target. Returns false when that cannot be repaired: then clear the sums. Clears
/// them where the configuration has no such rows. Needs the tables. Cost: one pass over the sums.
bool zygos_motor_sums_scrub(zygos_motor_sums_t *self, const zygos_config_t *config);

/// Returns 2 when row sums or a checksum do not match, otherwise at most 1. Needs zygos_motor_sums_intact().
double zygos_motor_sums_check(const zygos_motor_sums_t *self, const zygos_config_t *config);

#ifdef __cplusplus
}
#endif
#endif
