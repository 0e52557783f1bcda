/* SPDX-License-Identifier: MIT */
/// zygos/priv/accumulator.h: the energy rows, whose blocks overlap, in front of the store of their sums (store.h).
///
/// Within an arc each row is [y, D] . x + constant = W with the same unknown constant. The outer products of
/// z = [row, W, 1] are summed. The last column contains what is needed to eliminate the constant exactly when the arc
/// ends: G := G - s m^T - m s^T + n m m^T with the mean m of the arc.
///
/// The scatter of the blocks gives the standard deviations. Blocks with sharp ends would be dominated by these ends,
/// because the noise of a rate adds up to the difference of two angles. Therefore the blocks overlap: in each segment
/// the weight of one block decreases to 0 and the weight of the next one increases, and the weights of an instant add
/// up to 1. When blocks no longer merge, segments become twice as long. The division into blocks does not change the
/// total.
///
/// All cycles cost nearly the same. The rows of ZYGOS_BUFFER_ROWS instants wait in a buffer; then their products are
/// added to two blocks, slice by slice of the matrix, so that an entry is read and written once for all of them. The
/// tasks proceed by a part in a cycle that neither opens a segment nor proceeds with a task of other rows. An arc that
/// ends while another one is closing waits until that one is admitted (zygos.h); the tasks also proceed in cycles
/// without rows.
///
/// The bias of the sums by noise (noise.h) is subtracted from the buffer that its instant is in, and is also summed for
/// its whole arc.
///
/// In the open arc the weights of a block are checked against its overlap with the neighbouring blocks, and what the
/// noise of torques adds is stored twice.

#ifndef ZYGOS_ACCUMULATOR_H
#define ZYGOS_ACCUMULATOR_H

#include "../types.h"
#include "balance.h"
#include "gram.h"
#include "store.h"

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
/// Above this width, rows that are added to two buffers' blocks and the part of a task are too much for one cycle.
#define ZYGOS_WIDE 48u

/// One block of the sums.
typedef struct {
    /// Sum of w z z^T, lower triangle by rows, width (width + 1)/2 entries. Closed arcs: of w (z - m) (z - m)^T with
    /// the mean m of the arc, but for the last row, which would be 0: it is the sum of w (z - m), the deviations.
    double gram[ZYGOS_MAX_PACKED_ROW];
    double sum[ZYGOS_MAX_ROW]; ///< Row sums of gram; closed arcs: without the last row.
    double square;             ///< Sum of w^2.
    double overlap;            ///< Sum of w times the weight in the following block.
    double variance[2]; ///< What the noise of the torques adds to the variance of the work in it [J^2], twice. It does
                        ///< not fade.
    zygos_block_head_t head;
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
    uint32_t blocks;                                        ///< ZYGOS_PAIR() of the two blocks.
    uint32_t shared; ///< Slices that have been added; ZYGOS_BUFFER_SLICES: all, or the buffer is filled.
    uint32_t row;    ///< The next row of the matrix that is added.
    uint32_t parity; ///< That of its arc.
} zygos_row_buffer_t;

/// The normal equations of the energy rows.
typedef struct {
    zygos_store_t store;
    uint32_t width;             ///< p + 2.
    uint32_t noisy;             ///< 1: noise is declared and subtracted.
    uint32_t filled;            ///< Instants in the buffer that is being filled, accepted or not.
    uint32_t filling;           ///< Which of the buffers is being filled; the others are added to the blocks.
    uint32_t twin;              ///< zygos_accumulator_twin(), which each cycle compares.
    uint32_t means_checksum;    ///< Checksum of mean, and of the instants and the end of its arc.
    double length;              ///< Length of the open segment.
    double segment;             ///< Accepted instants of the open segment.
    uint64_t refused;           ///< Instants that failed the bandwidth test.
    double overlap;             ///< What the block that is verified shares with the block before it.
    double mean[ZYGOS_MAX_ROW]; ///< Of the closing arc.
    zygos_row_buffer_t buffer[ZYGOS_ROW_BUFFERS];
    zygos_noise_sums_t noise_open[2]; ///< Noise of the open and of the closing arc, subtracted from their blocks.
    zygos_noise_sums_t noise_closed;  ///< Noise of closed arcs, subtracted; reduced in proportion when an arc is
                                      ///< dropped. Without the factor noise_fade.
    zygos_block_t block[ZYGOS_MAX_BLOCKS];
} zygos_accumulator_t;

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns the blocks that buffers are added to, in one number.
static inline uint32_t zygos_accumulator_twin(const zygos_accumulator_t *self)
{
    uint32_t fold = self->buffer[0].blocks;
    for (uint32_t b = 1; b < ZYGOS_ROW_BUFFERS; b++) {
        fold = zygos_folded_count(fold, self->buffer[b].blocks);
    }
    return zygos_fold_of_counts_end(fold);
}
#endif

/// Clears the sums for p parameters and arcs of at most arc_cycles cycles.
void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s);

/// Adds one instant with weight 1 (accepted) or 0 (refused); the instructions are the same. The caller has
/// subtracted the noise of this instant from the buffer that is being filled. Returns whether a segment was opened, or
/// two buffers waited; the task need not proceed beside that. Cost: an update of rank ZYGOS_BUFFER_ROWS of (p+2)(p+3)/2
/// / ZYGOS_BUFFER_ROWS entries of two blocks, half as much more in the first instants of an arc. Where the tasks had no
/// time to clear blocks, two blocks are cleared and merged at once.
bool zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight);

/// Adds the content of all buffers to the blocks. Cost: one pass over each of them.
void zygos_accumulator_flush(zygos_accumulator_t *self);

/// Adds the next slices of what waits in full buffers to the blocks, as zygos_accumulator_add() does: for a cycle
/// without a row. Returns whether there was one. Cost: that of zygos_accumulator_add() at the most.
bool zygos_accumulator_share_slices(zygos_accumulator_t *self);

/// Adds what waits in full buffers to the blocks. Cost: at the most one pass over two buffers.
void zygos_accumulator_share_out(zygos_accumulator_t *self);

/// Returns whether the indices and counts of the buffers are possible, and their blocks what they were. Cost: a few
/// comparisons.
bool zygos_accumulator_steady(const zygos_accumulator_t *self);

/// Returns whether this is so of all members for p parameters. Reads nothing outside the struct, whatever its content
/// is. Cost: a few comparisons for each block.
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters);

/// Returns the deviations of a block of closed arcs or of one that is judged, width entries, the last of which is 0.
const double *zygos_accumulator_deviation(const zygos_accumulator_t *self, const zygos_block_t *block);

/// Returns the block of that rank in order of time, which is below store.count.
const zygos_block_t *zygos_accumulator_at(const zygos_accumulator_t *self, uint32_t rank);

/// What is peculiar to these rows, for the store. The store verifies and seals what it tells.

/// Returns whether rows of the closing arc wait in buffers.
bool zygos_accumulator_waits(const zygos_accumulator_t *self);

/// Hands over the rows of the open arc, which ends.
void zygos_accumulator_end_rows(zygos_accumulator_t *self);

/// Drops the rows of the open or of the closing arc, by parity, that are not in blocks; has_rows: there are some. Cost:
/// one pass over the buffers.
void zygos_accumulator_drop_rows(zygos_accumulator_t *self, uint32_t parity, bool has_rows);

/// Drops the rows in all buffers, whatever memory says.
void zygos_accumulator_forget_rows(zygos_accumulator_t *self);

/// Returns whether numbers of the open arc are possible that are not in the sums of its blocks.
bool zygos_accumulator_is_open_whole(const zygos_accumulator_t *self);

/// Computes the means of the closing arc. Returns false where they count another number of instants. Cost: a few
/// instructions for each block and column.
bool zygos_accumulator_take_means(zygos_accumulator_t *self);

/// Returns whether a block of it has the weights and the variance that it should, and predicts its row sums. Cost: a
/// few instructions for each column.
bool zygos_accumulator_verified(zygos_accumulator_t *self, const zygos_block_t *block);

/// Eliminates the constant from the rows of a block from the one of the task to before end.
void zygos_accumulator_eliminate(zygos_accumulator_t *self, zygos_block_t *block, uint32_t end);

/// The last row becomes that of the deviations. Returns whether the row sums are those that were predicted.
bool zygos_accumulator_eliminated(zygos_accumulator_t *self, zygos_block_t *block);

#ifdef __cplusplus
}
#endif
#endif
