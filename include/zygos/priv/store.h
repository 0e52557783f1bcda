/// zygos/priv/store.h: the sums of rows whose blocks consist of whole arcs: motor rows and momentum rows.
///
/// A block has one or more matrices, each the sum of z z^T of rows of one length with its row sums: one for each joint,
/// or one for all. The last columns of a row are the constants of its arc, which are eliminated when the arc ends, as
/// is the bias by the noise of the sensors. When all blocks are in use, two neighbours are merged.
///
/// What takes time in proportion to a block is a task that proceeds by a part in each cycle, as that of the energy rows
/// (accumulator.h): an arc is closing from its end until it is admitted. The closing arc stands behind the blocks of
/// closed arcs.
///
/// The row sums of every matrix tell whether memory was changed. The numbers beside the sums of closed arcs, and what
/// tells which blocks there are, have checksums; a flipped bit of the latter is flipped back. A block that merges keeps
/// a wrong checksum.
///
/// A kind of rows is data: where its matrices are, how many constants a row has, and how noise enters. zygos_store_t is
/// the first member of zygos_motor_sums_t and zygos_momentum_sums_t. kind: ZYGOS_MOTOR_ROWS or ZYGOS_MOMENTUM_ROWS.

#ifndef ZYGOS_STORE_H
#define ZYGOS_STORE_H

#include "../estimate.h"
#include "../types.h"
#include "gram.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What a block has beside its sums.
typedef struct {
    double total;      ///< Accepted instants. Of closed arcs, without the factor fade.
    double fade;       ///< Factor of the block (exponential forgetting).
    uint64_t end;      ///< Number of the newest cycle.
    uint64_t checksum; ///< Closed arcs: of these members, and of the instants of each joint.
} zygos_block_head_t;

/// Number of cycles in which a task reads or changes each entry of a large matrix once, and the least number of entries
/// in one cycle.
#define ZYGOS_STORE_PASS_CYCLES 6u
#define ZYGOS_STORE_LEAST_PART 24u

/// The tasks, which are done beside the rows of a cycle.
#define ZYGOS_STORE_NONE 0u
#define ZYGOS_STORE_VERIFY 1u       ///< Compares the matrices of the closing arc with their row sums.
#define ZYGOS_STORE_VERIFY_NOISE 2u ///< Compares its noise with its row sums.
#define ZYGOS_STORE_ELIMINATE 3u    ///< Eliminates its constants and subtracts its noise.
#define ZYGOS_STORE_JUDGE 4u        ///< Compares it with the running solution (guard.h).
#define ZYGOS_STORE_ADMIT 5u        ///< Admits it with its noise to the closed arcs, or leaves it out.
#define ZYGOS_STORE_MERGE 6u        ///< Adds a block to the one before it.
#define ZYGOS_STORE_SHIFT 7u        ///< Moves a block to the place before it.
#define ZYGOS_STORE_TASKS 8u

/// What tells which blocks there are, and what is being done to them.
typedef struct {
    uint32_t count;       ///< Number of blocks of closed arcs.
    uint32_t corrupt;     ///< 1: the members under the checksum did not match it, and no single bit explains that.
    uint32_t cycles;      ///< Instants of the open arc, accepted or not.
    uint32_t quarantined; ///< Arcs and blocks that were dropped since the last zygos_arm_scrub(): memory was changed.
    uint32_t task;        ///< One of the tasks above.
    uint32_t part;        ///< The next matrix of the task.
    uint32_t row;         ///< The next row of it.
    uint32_t place;       ///< The block that the task changes.
    uint32_t admitted;    ///< 1: the closing arc is admitted.
    uint32_t parity;      ///< 0 or 1 in turn: which noise is that of the open arc.
    uint32_t closing_cycles; ///< Instants of the closing arc, accepted or not; 0 where none is closing.
    uint32_t twin;           ///< zygos_store_twin(), which each cycle compares.
    double target;           ///< Instants up to which blocks are merged.
    double noise_fade;       ///< Factor of the noise of closed arcs.
    uint64_t checksum;       ///< Of count, target and noise_fade.
    zygos_gram_scan_t scan;  ///< Row sums of what is verified.
} zygos_store_t;

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns the members that tell where the closing arc and the task are, in one number.
static inline uint32_t zygos_store_twin(const zygos_store_t *self)
{
    uint32_t fold = zygos_folded_count(zygos_folded_count(self->count, self->parity), self->closing_cycles);
    fold = zygos_folded_count(zygos_folded_count(fold, self->task), self->place);
    fold = zygos_folded_count(zygos_folded_count(fold, self->part), self->row);
    return zygos_fold_of_counts_end(fold);
}

/// Returns whether the closing arc and the task are where they were. Whoever addresses memory with these members bounds
/// them. Cost: a few operations.
static inline bool zygos_store_steady(const zygos_store_t *self)
{
    return self->twin == zygos_store_twin(self);
}
#endif

/// Clears the sums of all arcs, whose longest has so many cycles. Needs the tables.
void zygos_store_clear(zygos_store_t *self, uint32_t kind, uint32_t arc_cycles);

/// Returns whether every index and count is possible; used: there are such rows. The other functions rely on that and
/// do not check it. Cost: a few comparisons for each block.
bool zygos_store_intact(const zygos_store_t *self, uint32_t kind, bool used);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_store_is_short(const zygos_store_t *self, uint32_t kind);

/// Ends the open arc, whose newest cycle is given: it is closing from then on, or dropped when it is too short. Needs
/// that no task is open, or that the arc is too short. Cost: one copy of its sums.
void zygos_store_close(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Proceeds with the task. ZYGOS_STORE_JUDGE is that of the caller, who ends it by zygos_store_judged(): this function
/// does nothing then. Needs the tables. Cost: a part of a pass over a block.
void zygos_store_proceed(zygos_store_t *self, uint32_t kind);

/// The rows before this one of the matrix of its turn were compared. Returns whether there are more of the arc.
bool zygos_store_judged_rows(zygos_store_t *self, uint32_t kind, uint32_t end);
void zygos_store_judged(zygos_store_t *self, uint32_t kind, bool admitted);

/// Returns the row before which the next part of the task ends, in the matrix of its turn.
uint32_t zygos_store_part(const zygos_store_t *self, uint32_t kind);

/// Returns what the closing arc has beside its sums.
const zygos_block_head_t *zygos_store_closing(const zygos_store_t *self, uint32_t kind);

/// Returns the accepted instants of closed arcs, times their factors.
double zygos_store_instants(const zygos_store_t *self, uint32_t kind);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Needs finished tasks. Cost: a few
/// instructions for each block.
void zygos_store_forget(zygos_store_t *self, uint32_t kind, double factor);

/// Multiplies each block and the noise of closed arcs by its factor, which is 1 then. Needs finished tasks. Cost: one
/// pass over the blocks of which the factor is not 1.
void zygos_store_apply_fade(zygos_store_t *self, uint32_t kind);

/// Drops the open arc, and the closing one and the blocks with cycles after the given one. Cost: one pass over the sums
/// of two arcs.
void zygos_store_drop_after(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Drops the blocks up to the given cycle and their share of the noise, and returns their number. Needs finished tasks.
uint32_t zygos_store_drop_until(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Drops each block that does not match its row sums or its checksum, and the open arc where its sums do not match;
/// repairs a flipped bit of the members under the checksum. Returns false when that cannot be repaired: then clear the
/// sums. Needs the tables. Cost: one pass over the sums.
bool zygos_store_scrub(zygos_store_t *self, uint32_t kind);

/// Returns the largest violation of the row sums in units of their tolerance, or 2 when an arc was corrupt when it
/// closed or a checksum does not match. Above 1 means corrupt. Needs zygos_store_intact().
double zygos_store_check(const zygos_store_t *self, uint32_t kind);

#ifdef __cplusplus
}
#endif
#endif
