/* SPDX-License-Identifier: MIT */
/// zygos/priv/store.h: the sums of energy, motor and momentum rows in blocks, in fixed memory and for any duration.
///
/// A block has one or more matrices, each the sum of z z^T of rows of one length with its row sums: one for each joint,
/// or one for all. The last columns of a row are the constants of its arc, which are eliminated when the arc ends.
/// Blocks are, in order of time, those of closed arcs, of the closing one, and of the open one, to which rows are
/// added. Energy rows have several blocks in an arc, which overlap (accumulator.h); the others have one. When few
/// blocks are left, two neighbours of closed arcs that fit into one are merged; when none fit, the target doubles.
///
/// What takes time in proportion to a block is a task that proceeds by a part in a cycle: to verify the blocks of an
/// arc that ended, to eliminate its constants, to compare it with the running solution (guard.h), to admit it to the
/// closed arcs, to merge two blocks, and to clear one. An arc is closing from its end until it is admitted. Who reads
/// the sums finishes these tasks on a copy first; the result is then the same as if they had been finished when the arc
/// ended.
///
/// Every matrix has its row sums: G 1 = sum holds up to rounding, unless memory was changed. In a block of closed
/// energy arcs that is so of all rows but the last. That row, the numbers beside the sums of a block of closed arcs,
/// and the members that tell which blocks there are have checksums; a flipped bit of the latter is flipped back. In the
/// open arc the number of instants is also in the sums. An arc that fails these tests when it closes is dropped. A
/// block that merges keeps a wrong checksum.
///
/// A kind of rows is data: where its blocks and their parts are, how many constants a row has, and where noise is
/// summed. zygos_store_t is the first member of zygos_accumulator_t, zygos_motor_sums_t and zygos_momentum_sums_t.
/// kind: one of enum zygos_rows.

#ifndef ZYGOS_STORE_H
#define ZYGOS_STORE_H

#include "../types.h"
#include "gram.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What a block has beside its sums.
typedef struct {
    double total;      ///< Sum of the weights of accepted instants. Closed arcs: without the factor fade.
    double fade;       ///< Closed arcs: factor of the block (exponential forgetting); otherwise unused.
    uint64_t end;      ///< Closed arcs: number of the newest cycle.
    uint64_t checksum; ///< Closed arcs: of all but what row sums protect; otherwise 0.
} zygos_block_head_t;

/// The places of two blocks in one number.
#define ZYGOS_PAIR(first, second) ((first) | ((second) << 8u))

/// The tasks, which are done beside the rows of a cycle.
#define ZYGOS_TASK_NONE 0u
#define ZYGOS_TASK_CLEAR 1u        ///< Clears a free block.
#define ZYGOS_TASK_MERGE 2u        ///< Adds a block to the one before it.
#define ZYGOS_TASK_VERIFY 3u       ///< Compares a block of the closing arc with its row sums.
#define ZYGOS_TASK_VERIFY_NOISE 4u ///< Compares the noise of the closing arc with its row sums.
#define ZYGOS_TASK_ELIMINATE 5u    ///< Eliminates the constants of the block, and subtracts noise that is in none.
#define ZYGOS_TASK_JUDGE 6u        ///< Compares it with the running solution (guard.h).
#define ZYGOS_TASK_ADMIT 7u        ///< Admits the closing arc with its noise to the closed ones, or leaves it out.
#define ZYGOS_TASKS 8u

/// What tells which blocks there are, and what is being done to them. The checksum is of what is before it.
typedef struct {
    uint32_t count;    ///< Number of blocks in use: of closed arcs, of the closing one, and of the open one.
    uint32_t closed;   ///< Number of blocks of closed arcs, which are the first.
    uint32_t fresh;    ///< The first block of the open arc; closed, if no arc is closing.
    uint32_t ready;    ///< Number of free blocks that are cleared; they have the last places in order.
    uint32_t open;     ///< Place of the block of the open arc; 0 of energy rows.
    uint32_t arcs;     ///< Arcs that were admitted. This and arcs_dropped wrap at 2^32.
    uint64_t accepted; ///< Instants of these arcs, without those of dropped ones.
    double target;     ///< Instants up to which blocks are merged; of energy rows also of the next segment.
    double noise_fade; ///< Factor of the noise of closed arcs.
    uint8_t order[ZYGOS_ORDER_PLACES]; ///< The places of the blocks in order of time, then those of free blocks.
    uint64_t checksum;
    uint64_t closing_end;      ///< The number of the newest cycle of the closing arc.
    uint32_t closing_instants; ///< Its accepted instants.
    uint32_t closing_cycles;   ///< Its cycles.
    uint32_t arc_instants;     ///< Accepted instants of the open arc.
    uint32_t cycles;           ///< Its instants, accepted or not; of energy rows only when it ends.
    uint32_t arcs_dropped;     ///< Arcs that were dropped later, or had fewer than ZYGOS_MIN_ARC_INSTANTS.
    uint32_t corrupt;          ///< 1: what is under the checksum did not match it, and no single bit explains that.
    uint32_t quarantined; ///< Arcs and blocks that were dropped since the last zygos_arm_scrub(): memory was changed.
    uint32_t twin;        ///< zygos_store_twin(), which each cycle compares.
    uint32_t task;        ///< One of the tasks above.
    uint32_t pair;        ///< ZYGOS_PAIR() of the block of the task, and of the one that is added to it.
    uint32_t rank;        ///< The next block of the closing arc.
    uint32_t part;        ///< The next matrix of it.
    uint32_t row;         ///< The next row of that.
    uint32_t admitted;    ///< 1: the closing arc is admitted.
    uint32_t parity;      ///< 0 or 1 in turn: which noise is that of the open arc.
    uint32_t reserved;
    zygos_gram_scan_t scan; ///< Row sums of what is verified.
} zygos_store_t;

#ifndef ZYGOS_DECLARATIONS_ONLY
/// The two blocks of a ZYGOS_PAIR().
static inline uint32_t zygos_store_first_of(uint32_t pair)
{
    return pair & 255u;
}

static inline uint32_t zygos_store_second_of(uint32_t pair)
{
    return pair >> 8u;
}

/// Returns the members with which a cycle addresses blocks, and those that tell which arc is closing, in one number.
static inline uint32_t zygos_store_twin(const zygos_store_t *self)
{
    uint32_t fold = zygos_folded_count(self->count, self->closed);
    fold = zygos_folded_count(zygos_folded_count(fold, self->fresh), self->ready);
    fold = zygos_folded_count(zygos_folded_count(fold, self->open), self->parity);
    fold = zygos_folded_count(zygos_folded_count(fold, self->task), self->pair);
    fold = zygos_folded_count(zygos_folded_count(fold, self->rank), self->part);
    fold = zygos_folded_count(zygos_folded_count(fold, self->row), self->closing_instants);
    return zygos_fold_of_counts_end(fold);
}

/// Returns whether these members are what they were. Whoever addresses memory with them bounds them. Cost: a few
/// operations.
static inline bool zygos_store_steady(const zygos_store_t *self)
{
    return self->twin == zygos_store_twin(self);
}

/// Returns the cycles of the longest arc of such rows; 0: there are none.
static inline uint32_t zygos_store_longest(const zygos_config_t *config, uint32_t kind)
{
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        return config->arc_cycles;
    }
    return (kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? config->impulse_arc_cycles : config->momentum_arc_cycles;
}

/// Returns whether an arc is closing.
static inline bool zygos_store_closing(const zygos_store_t *self)
{
    return self->fresh > self->closed;
}
#endif

/// Returns the instants that were accepted and not dropped, also those of the closing arc and of the open one.
uint64_t zygos_store_accepted(const zygos_store_t *self);

/// Returns the place of the block of that rank in order of time, which there is whatever memory says.
uint32_t zygos_store_place(const zygos_store_t *self, uint32_t kind, uint32_t rank);

/// Returns what the block of that rank has beside its sums.
const zygos_block_head_t *zygos_store_head(const zygos_store_t *self, uint32_t kind, uint32_t rank);

/// Returns its accepted instants, times its factor, or those of all closed arcs.
double zygos_store_instants_of(const zygos_store_t *self, uint32_t kind, uint32_t rank);
double zygos_store_instants(const zygos_store_t *self, uint32_t kind);

/// Copies a block with what it has beside its sums, or noise of the arc of that parity or of closed arcs; nothing where
/// there is none. Needs the tables of *from. Accesses nothing outside, whatever memory says.
#define ZYGOS_NOISE_OF_CLOSED 2u
void zygos_store_copy_block(const zygos_store_t *from, zygos_store_t *to, uint32_t kind, uint32_t place);
void zygos_store_copy_noise(const zygos_store_t *from, zygos_store_t *to, uint32_t kind, uint32_t which);

/// Clears the sums of all arcs. target: as the member. Needs the tables. Cost: one pass over all blocks.
void zygos_store_clear(zygos_store_t *self, uint32_t kind, double target);

/// Returns whether every index and count is possible; used: there are such rows. The other functions rely on that and
/// do not check it. Reads nothing outside the sums, whatever memory says. Cost: a few comparisons for each block.
bool zygos_store_intact(const zygos_store_t *self, uint32_t kind, bool used);

/// A block that is cleared becomes the newest one of the open arc; an arc of energy rows begins with two. Cost: a
/// checksum. Where the tasks had no time to clear blocks, these are cleared and merged at once.
void zygos_store_open_block(zygos_store_t *self, uint32_t kind);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_store_is_short(const zygos_store_t *self);

/// Ends the open arc, whose newest cycle is given: it is closing from then on. An arc that is too short is dropped;
/// what there is of energy rows is cleared away by the tasks, or at once while another arc is closing. Needs that no
/// arc is closing, or that the open one is too short. Cost: a checksum, or one pass over the sums of an arc.
void zygos_store_close(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Proceeds with the task, or begins the next one. ZYGOS_TASK_JUDGE is that of the caller, who ends it by
/// zygos_store_judged(): this function does nothing then. Needs the tables. Cost: a part of a pass over a block.
void zygos_store_proceed(zygos_store_t *self, uint32_t kind);

/// Returns the row before which the next part of the task ends, in the matrix of its turn.
uint32_t zygos_store_part(const zygos_store_t *self, uint32_t kind);

/// Returns whether nothing of the closing arc was compared.
bool zygos_store_is_first_part(const zygos_store_t *self, uint32_t kind);

/// Returns whether its blocks were compared, so that it is the turn of their noise.
bool zygos_store_is_noise(const zygos_store_t *self);

/// The rows before this one of the matrix of its turn were compared. Returns whether there are more of the arc.
bool zygos_store_judged_rows(zygos_store_t *self, uint32_t kind, uint32_t end);
void zygos_store_judged(zygos_store_t *self, uint32_t kind, bool admitted);

/// Returns whether an arc is closing, or there is a task, or blocks have to be merged before the next arc can end.
bool zygos_store_busy(const zygos_store_t *self, uint32_t kind);

/// Returns whether zygos_store_proceed() has something to do: also where blocks have to be merged or cleared.
bool zygos_store_has_work(const zygos_store_t *self, uint32_t kind);

/// Returns whether no task changes the sums of closed arcs, and no arc waits for its admission.
bool zygos_store_rests(const zygos_store_t *self);

/// Returns whether the open arc can end. fading: the sums of closed arcs fade with it.
bool zygos_store_can_close(const zygos_store_t *self, uint32_t kind, bool fading);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Needs zygos_store_rests(). Cost: two
/// checksums of each block.
void zygos_store_forget(zygos_store_t *self, uint32_t kind, double factor);

/// Multiplies each block and the noise of closed arcs by its factor, which is 1 then. Needs finished tasks. Cost: one
/// pass over the blocks of which the factor is not 1.
void zygos_store_apply_fade(zygos_store_t *self, uint32_t kind);

/// Drops the open arc, and the closing one and the blocks of closed arcs with cycles after the given one. A block in
/// which such cycles were merged with older ones is dropped as a whole. An arc that is being admitted is admitted
/// before, and its share of the noise is dropped in proportion. Cost: a few passes over the sums of an arc.
void zygos_store_drop_after(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Drops the blocks of closed arcs up to the given cycle, and their share of the noise. Returns the number of arcs,
/// counting merged arcs as one. Needs that no arc is closing. Cost: at the most one pass over a block.
uint32_t zygos_store_drop_until(zygos_store_t *self, uint32_t kind, uint64_t cycle);

/// Drops each block of closed arcs that does not match its row sums or its checksum, the closing arc, and the open one
/// where its sums do not match; repairs a flipped bit of the members under the checksum. Returns false when that cannot
/// be repaired: then clear the sums. Needs the tables. The tasks should have been finished. Cost: one pass over the
/// sums.
bool zygos_store_scrub(zygos_store_t *self, uint32_t kind);

/// Returns whether all sums match their row sums and checksums, and no arc was corrupt when it closed. Needs
/// zygos_store_intact(). Rows that wait in buffers are not checked before zygos_accumulator_flush().
bool zygos_store_is_whole(const zygos_store_t *self, uint32_t kind);

#ifdef __cplusplus
}
#endif
#endif
