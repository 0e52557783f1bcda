/// zygos/priv/accumulator.h: accumulates the normal equations of the energy rows, in fixed memory and for any duration.
///
/// Within an arc each row is [y, D] . x + constant = W with the same unknown constant. The accumulator sums the outer
/// products of z = [row, W, 1]. The last column contains what is needed to eliminate the constant exactly when the arc
/// ends: G := G - s m^T - m s^T + n m m^T with the mean m of the arc.
///
/// The sums are divided into blocks; the scatter of the blocks gives the standard deviations. Blocks with sharp ends
/// would be dominated by these ends, because the noise of a rate adds up to the difference of two angles. Therefore the
/// blocks overlap: in each segment the weight of one block decreases to 0 and the weight of the next one increases, and
/// the weights of an instant add up to 1. When few blocks are left, neighbouring blocks that fit into one are merged;
/// when none fit, segments become twice as long. The division into blocks does not change the total.
///
/// All cycles cost nearly the same. The rows of ZYGOS_BUFFER_ROWS instants wait in a buffer; then their products are
/// added to two blocks, slice by slice of the matrix, so that an entry is read and written once for all of them.
/// Everything else that takes time in proportion to a block is a task that proceeds by a part in a cycle that neither
/// opens a segment nor proceeds with a task of other rows: to verify the blocks of an arc that ended, to eliminate its
/// constant, to compare it with the running solution (guard.h), to admit it to the closed arcs, to merge two blocks,
/// and to clear one. An arc is closing from its end until it is admitted. An arc that ends while another one is closing
/// waits until that one is admitted (zygos.h); the tasks also proceed in cycles without rows. Who reads the sums
/// finishes these tasks on a copy first; the result is then the same as if they had been finished when the arc ended.
///
/// The bias of the sums by noise (noise.h) is subtracted from the buffer that its instant is in, and is also summed for
/// its whole arc.
///
/// Every block contains its row sums: G 1 = sum holds up to rounding, unless memory was corrupted. In a block of closed
/// arcs that is so of all rows but the last, which has a checksum instead. The other members of such a block, and the
/// members that tell which blocks there are, have a checksum too. In the open arc the number of instants is also in the
/// sums, the weights are checked against the overlap with the neighbouring blocks, and what the noise of torques adds
/// is stored twice. An arc that fails this test when it closes is dropped. A flipped bit of the members that tell which
/// blocks there are is found by the checksum, and flipped back. A block that merges keeps a wrong checksum.

#ifndef ZYGOS_ACCUMULATOR_H
#define ZYGOS_ACCUMULATOR_H

#include "../types.h"
#include "balance.h"
#include "gram.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The least number of blocks: the scatter of fewer is too uncertain, so blocks are not merged below this number.
#define ZYGOS_MIN_BLOCKS ((ZYGOS_MAX_BLOCKS < 16) ? 6u : 8u)
/// Number of free blocks that are aimed at: two for an arc that begins, and one for the next segment.
#define ZYGOS_SPARE_BLOCKS 3u
/// Number of buffers: one is filled, one is added to the blocks, and a third waits after the end of an arc.
#define ZYGOS_ROW_BUFFERS 3u
/// Number of cycles in which a task reads or changes each entry of a block once, one less or one more.
#define ZYGOS_PASS_CYCLES 8u
/// The least number of entries that it reads or changes in one cycle.
#define ZYGOS_LEAST_PART 48u
/// Above this width, rows that are added to two buffers' blocks and the part of a task are too much for one cycle.
#define ZYGOS_WIDE 48u

/// One block of the sums.
typedef struct {
    /// Sum of w z z^T, lower triangle by rows, width (width + 1)/2 entries. Closed arcs: of w (z - m) (z - m)^T with
    /// the mean m of the arc, but for the last row, which would be 0: it is the sum of w (z - m), the deviations.
    double gram[ZYGOS_MAX_PACKED_ROW];
    double sum[ZYGOS_MAX_ROW]; ///< Row sums of gram; closed arcs: without the last row.
    double instants;           ///< Sum of the weights w of accepted instants.
    double square;             ///< Sum of w^2.
    double overlap;            ///< Sum of w times the weight in the following block.
    double variance[2];        ///< What the noise of the torques adds to the variance of the work in it [J^2], twice.
    double fade;       ///< Closed arcs: factor of all of it but variance (exponential forgetting); otherwise unused.
    uint64_t end;      ///< Closed arcs: number of the newest cycle.
    uint64_t checksum; ///< Closed arcs: of the deviations and the members after sum; otherwise 0.
} zygos_block_t;

/// The expected sums of products of noise: packed lower triangle of p + 1 rows, the work last, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_NOISE];
    double sum[ZYGOS_MAX_NOISE_ROW];
} zygos_noise_sums_t;

/// The rows of ZYGOS_BUFFER_ROWS instants, and their noise.
typedef struct {
    double pair[ZYGOS_MAX_ROW_PAIRS][ZYGOS_BUFFER_ROWS][2]; ///< Two neighbouring entries of z of each instant; 0 of
                                                            ///< instants that an arc did not have.
    double total[ZYGOS_BUFFER_ROWS];                        ///< Sum of the entries of z of each instant.
    double gram[ZYGOS_MAX_PACKED_ROW];                      ///< What is subtracted for the noise, negative.
    double sum[ZYGOS_MAX_ROW];                              ///< Its row sums.
    double instants;                                        ///< Accepted instants, while the buffer is filled.
    double variance;                                        ///< As of a block, while the buffer is filled.
    double early;                                           ///< Weight of the older block, from then on.
    double late;                                            ///< Weight of the newer block.
    uint32_t places;                                        ///< ZYGOS_PLACES() of the two blocks.
    uint32_t shared; ///< Slices that have been added; ZYGOS_BUFFER_SLICES: all, or the buffer is filled.
    uint32_t row;    ///< The next row of the matrix that is added.
    uint32_t parity; ///< That of its arc.
} zygos_row_buffer_t;

/// The places of two blocks in one number.
#define ZYGOS_PLACES(first, second) ((first) | ((second) << 8u))

/// The tasks, which are done beside the rows of a cycle.
#define ZYGOS_TASK_NONE 0u
#define ZYGOS_TASK_CLEAR 1u  ///< Clears a free block.
#define ZYGOS_TASK_MERGE 2u  ///< Adds a block to the one before it.
#define ZYGOS_TASK_VERIFY 3u ///< Compares a block of the closing arc, and its noise after the last one, with row sums.
#define ZYGOS_TASK_CENTRE 4u ///< Eliminates the constant from it.
#define ZYGOS_TASK_JUDGE 5u  ///< Compares it with the running solution (guard.h); after the last one the whole arc.
#define ZYGOS_TASK_ADMIT 6u  ///< Admits the closing arc with its noise to the closed ones, or leaves it out.
#define ZYGOS_TASKS 7u

/// The normal equations of the energy rows.
typedef struct {
    uint32_t width;        ///< p + 2.
    uint32_t count;        ///< Number of blocks in use: of closed arcs, of the closing one, and of the open one.
    uint32_t closed;       ///< Number of blocks of closed arcs, which are the first.
    uint32_t fresh;        ///< The first block of the open arc; closed, if no arc is closing.
    uint32_t newest;       ///< First block of the newest arcs that have enough instants to be compared.
    uint32_t window;       ///< First block of the arcs after these, which do not have enough yet.
    uint32_t ready;        ///< Number of free blocks that are cleared; they have the last places in order.
    uint32_t arc_instants; ///< Accepted instants of the open arc.
    uint32_t arcs;         ///< Arcs that were admitted. This and the next wrap at 2^32.
    uint32_t arcs_dropped; ///< Arcs that were dropped later, or had fewer than ZYGOS_MIN_ARC_INSTANTS.
    uint32_t corrupt;      ///< 1: the members under the checksum did not match it, and no single bit explains that.
    uint32_t filled;       ///< Instants in the buffer that is being filled, accepted or not.
    uint32_t filling;      ///< Which of the buffers is being filled; the others are added to the blocks.
    uint32_t parity;       ///< 0 or 1 in turn: which of noise_open is that of the open arc.
    uint32_t noisy;        ///< 1: noise is declared and subtracted.
    uint32_t quarantined;  ///< Arcs and blocks that were dropped since the last zygos_arm_scrub(): memory was changed.
    uint32_t twin;         ///< zygos_accumulator_twin(), with which each cycle compares the members in it.
    uint32_t task;         ///< One of the tasks above.
    uint32_t places;       ///< The block of the task, and the one that is added to it.
    uint32_t row;          ///< The next row of the task.
    uint32_t rank;         ///< The next block of the closing arc.
    uint32_t whole;        ///< 1: all that was verified of the closing arc matches.
    uint32_t admitted;     ///< 1: the closing arc is admitted.
    uint32_t closing_instants; ///< Accepted instants of the closing arc.
    uint32_t closing_cycles;   ///< Its cycles.
    uint32_t means_checksum; ///< Checksum of mean, closing_end and closing_instants, while the constant is eliminated.
    uint64_t closing_end;    ///< The number of its newest cycle.
    double enough;           ///< Instants with which arcs are compared.
    double target;           ///< Length of the next segment in instants.
    double length;           ///< Length of the open segment.
    double segment;          ///< Accepted instants of the open segment.
    uint64_t accepted;       ///< Instants in closed arcs, in the closing one and in the open one.
    uint64_t refused;        ///< Instants that failed the bandwidth test.
    uint64_t checksum; ///< Of width, count, closed, fresh, newest, window, ready, arcs, enough, target, noise_fade and
                       ///< order.
    double noise_fade; ///< Factor of noise_closed.
    double overlap;    ///< What the block of the task shares with the block before it.
    double mean[ZYGOS_MAX_ROW]; ///< Of the closing arc.
    zygos_gram_scan_t scan;     ///< Row sums of the block that is verified.
    zygos_row_buffer_t buffer[ZYGOS_ROW_BUFFERS];
    zygos_noise_sums_t noise_open[2];  ///< Noise of the open and of the closing arc, subtracted from their blocks.
    zygos_noise_sums_t noise_closed;   ///< Noise of closed arcs, subtracted; reduced in proportion when an arc is
                                       ///< dropped. Without the factor noise_fade.
    uint8_t order[ZYGOS_ORDER_PLACES]; ///< The places of the blocks in order of time, then those of free blocks.
    zygos_block_t block[ZYGOS_MAX_BLOCKS];
} zygos_accumulator_t;

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns the members with which a cycle addresses blocks, in one number, and those that tell which arc is closing.
static inline uint32_t zygos_accumulator_twin(const zygos_accumulator_t *self)
{
    uint32_t fold = zygos_folded_count(self->count, self->closed);
    fold = zygos_folded_count(zygos_folded_count(fold, self->fresh), self->ready);
    fold = zygos_folded_count(zygos_folded_count(fold, self->task), self->places);
    fold = zygos_folded_count(zygos_folded_count(fold, self->rank), self->parity);
    fold = zygos_folded_count(fold, self->closing_instants);
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        fold = zygos_folded_count(fold, self->buffer[b].places);
    }
    return zygos_fold_of_counts_end(fold);
}
#endif

/// Initialises the accumulator for p parameters and arcs of at most arc_cycles cycles.
void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s);

/// Adds one instant with weight 1 (accepted) or 0 (refused); the instructions are the same. The caller has
/// subtracted the noise of this instant from the buffer that is being filled. Returns whether a segment was opened, or
/// two buffers waited; the task need not proceed beside that. Cost: an update of rank ZYGOS_BUFFER_ROWS of (p+2)(p+3)/2
/// / ZYGOS_BUFFER_ROWS entries of two blocks, half as much more in the first instants of an arc. Where the tasks had no
/// time to clear blocks, two blocks are cleared and merged at once.
bool zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight);

/// Adds the content of all buffers to the blocks. Cost: one pass over each of them.
void zygos_accumulator_flush(zygos_accumulator_t *self);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_accumulator_is_short(const zygos_accumulator_t *self);

/// Ends the open arc: it is closing from then on. An arc that is too short counts as dropped, false is returned, and
/// what there is of it is cleared away by the tasks, or at once while another arc is closing. Needs that no arc is
/// closing, or that the open one is too short. cycle: its newest cycle. cycles: their number. Cost: a few instructions
/// for each block, or one pass over the buffers and the noise of an arc.
bool zygos_accumulator_close(zygos_accumulator_t *self, uint64_t cycle, uint32_t cycles);

/// Returns whether an arc is closing.
bool zygos_accumulator_closing(const zygos_accumulator_t *self);

/// Proceeds with the task, or begins the next one. ZYGOS_TASK_JUDGE is that of the caller, who ends it by one of the
/// next two functions: this one does nothing then. Cost: a part of a pass over a block, with (p+2)(p+3)/2 /
/// ZYGOS_PASS_CYCLES entries.
void zygos_accumulator_proceed(zygos_accumulator_t *self);

/// Returns the row before which the next part of the task ends.
uint32_t zygos_accumulator_part(const zygos_accumulator_t *self);

/// Ends ZYGOS_TASK_JUDGE of one block of the closing arc, and with it that of the whole arc, which is admitted or not.
void zygos_accumulator_judged_block(zygos_accumulator_t *self);
void zygos_accumulator_judged_arc(zygos_accumulator_t *self, bool admitted);

/// Returns whether there is a task, or an arc is closing.
bool zygos_accumulator_busy(const zygos_accumulator_t *self);

/// Returns whether zygos_accumulator_proceed() has something to do: also where blocks have to be merged or cleared.
bool zygos_accumulator_has_work(const zygos_accumulator_t *self);

/// Adds the next slices of what waits in full buffers to the blocks, as zygos_accumulator_add() does: for a cycle
/// without a row. Returns whether there was one. Cost: that of zygos_accumulator_add() at the most.
bool zygos_accumulator_share_slices(zygos_accumulator_t *self);

/// Adds what waits in full buffers to the blocks. Cost: at the most one pass over two buffers.
void zygos_accumulator_share_out(zygos_accumulator_t *self);

/// Finishes the tasks, and admits the closing arc unless it does not match its row sums. Cost: a few passes over the
/// blocks of the closing arc.
void zygos_accumulator_settle(zygos_accumulator_t *self);

/// Ends the open arc and settles.
void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle);

/// Returns whether no task changes the sums of closed arcs, and no arc waits for its admission.
bool zygos_accumulator_rests(const zygos_accumulator_t *self);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Needs zygos_accumulator_rests(). Cost: two
/// checksums of each block.
void zygos_accumulator_forget(zygos_accumulator_t *self, double factor);

/// Drops the open arc, the closing one and the blocks of closed arcs with cycles after the given one. A block in which
/// such cycles were merged with older ones is dropped as a whole. An arc that is being admitted is admitted before, and
/// its share of the noise is dropped in proportion. Cost: at the most one pass over a block, two over the noise of an
/// arc, and one over the buffers.
void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle);

/// Drops the blocks of closed arcs up to the given cycle, and their share of the noise. Returns the number of arcs,
/// counting merged arcs as one. Needs that no arc is closing. Cost: at the most one pass over a block.
uint32_t zygos_accumulator_drop_until(zygos_accumulator_t *self, uint64_t cycle);

/// Returns whether every index, count and length is possible for p parameters. The other functions rely on that and do
/// not check it. Reads nothing outside the struct, whatever its content is. Cost: a few comparisons for each block.
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters);

/// Returns whether a cycle addresses nothing outside the struct. Cost: a few comparisons.
bool zygos_accumulator_steady(const zygos_accumulator_t *self);

/// Drops each block of closed arcs that does not match its row sums or its checksum, and the open arc where its sums do
/// not match; repairs a flipped bit of the members that tell which blocks there are. Returns false, and changes only
/// these, when the rest cannot be repaired: then initialise it. Needs a width that matches the configuration. The tasks
/// should have been finished. Cost: one pass over the sums.
bool zygos_accumulator_scrub(zygos_accumulator_t *self, uint32_t parameters);

/// Multiplies each block and the noise of closed arcs by its factor, which is 1 then. Cost: one pass over the blocks of
/// which the factor is not 1.
void zygos_accumulator_apply_fade(zygos_accumulator_t *self);

/// Sums the blocks of closed arcs into gram (packed as in a block, width self->width).
void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram);

/// Returns the largest violation of G 1 = sum over all blocks in units of its tolerance (gram.h), or 2 when an arc was
/// corrupt when it closed. Above 1 means corrupt. Needs zygos_accumulator_intact(), and finished tasks. The buffers are
/// not checked before zygos_accumulator_flush().
double zygos_accumulator_check(const zygos_accumulator_t *self);

/// Returns the deviations of a block of closed arcs or of one that is judged, width entries, the last of which is 0.
const double *zygos_accumulator_deviation(const zygos_accumulator_t *self, const zygos_block_t *block);

/// Returns the instants of the block of that rank, times its factor.
double zygos_accumulator_instants(const zygos_accumulator_t *self, uint32_t rank);

/// Return the block of that rank in order of time, which is below self->count.
zygos_block_t *zygos_accumulator_block(zygos_accumulator_t *self, uint32_t rank);
const zygos_block_t *zygos_accumulator_at(const zygos_accumulator_t *self, uint32_t rank);

#ifdef __cplusplus
}
#endif
#endif
