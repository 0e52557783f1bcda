/// zygos/accumulator.h: accumulates the normal equations of the energy rows, in fixed memory and for any duration.
///
/// Within an arc each row is [y, D] . x + constant = W with the same unknown constant. The accumulator sums the outer
/// products of z = [row, W, 1]. The last column contains what is needed to eliminate the constant exactly when the arc
/// ends: G := G - s m^T - m s^T + n m m^T with the mean m of the arc.
///
/// The sums are divided into blocks; the scatter of the blocks gives the standard deviations. Blocks with sharp ends
/// would be dominated by these ends, because the noise of a rate adds up to the difference of two angles. Therefore the
/// blocks overlap: in each segment the weight of one block decreases to 0 and the weight of the next one increases, and
/// the weights of an instant add up to 1. When all blocks are in use, segments become twice as long, and neighbouring
/// blocks that fit into one are merged. The division into blocks does not change the total.
///
/// The rows of ZYGOS_BUFFER_ROWS instants are summed in a buffer, which is then added to two blocks, a slice in each
/// cycle. So a cycle costs one rank-1 update and a little more, and all cycles cost the same.
///
/// The bias of the sums by noise (noise.h) is summed separately, and is subtracted from the blocks when a segment ends.
///
/// Every block contains its row sums: G 1 = sum holds up to rounding, unless memory was corrupted. The other members of
/// a block of closed arcs, and the members that tell which blocks there are, have a checksum. In the open arc the
/// number of instants is also in the sums, and the weights are checked against the overlap with the neighbouring
/// blocks. An arc that fails this test when it closes is dropped. A flipped bit of the members that tell which blocks
/// there are is found by the checksum, and flipped back. A block that merges or fades keeps a wrong checksum.

#ifndef ZYGOS_ACCUMULATOR_H
#define ZYGOS_ACCUMULATOR_H

#include "balance.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The least number of blocks: the scatter of fewer is too uncertain, so blocks are not merged below this number.
/// Merging must leave two free blocks for an arc that begins; therefore the smallest build has six.
#define ZYGOS_MIN_BLOCKS ((ZYGOS_MAX_BLOCKS < 10) ? 6u : 8u)

/// One block of the sums.
typedef struct {
    double gram[ZYGOS_MAX_SLICED_GRAM]; ///< Sum of w z z^T, lower triangle by rows, width (width + 1)/2 entries, the
                                        ///< others 0.
    double sum[ZYGOS_MAX_SLICED_ROW];   ///< Row sums of gram.
    double deviation[ZYGOS_MAX_ROW];    ///< Closed arcs: sum of w (z - m), with the mean m of the arc.
    double instants;                    ///< Sum of the weights w of accepted instants.
    double square;                      ///< Sum of w^2.
    double overlap;                     ///< Sum of w times the weight in the following block.
    uint64_t end;                       ///< Closed arcs: number of the newest cycle.
    uint64_t checksum;                  ///< Closed arcs: of deviation and the members after it; 0 in the open arc.
} zygos_block_t;

/// The expected sums of products of noise: packed lower triangle of p + 1 rows, the work last, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_ROW];
    double sum[ZYGOS_MAX_ROW];
} zygos_noise_sums_t;

/// The summed rows of ZYGOS_BUFFER_ROWS instants.
typedef struct {
    double gram[ZYGOS_MAX_SLICED_GRAM];
    double sum[ZYGOS_MAX_SLICED_ROW];
    double instants; ///< Accepted instants.
} zygos_row_buffer_t;

/// The normal equations of the energy rows.
typedef struct {
    uint32_t width;        ///< p + 2.
    uint32_t count;        ///< Number of blocks in use; those of the open arc are the last.
    uint32_t open;         ///< First block of the open arc. The blocks before it belong to closed arcs.
    uint32_t newest;       ///< First block of the newest arcs that have enough instants to be compared.
    uint32_t window;       ///< First block of the arcs after these, which do not have enough yet.
    uint32_t arc_instants; ///< Accepted instants of the open arc.
    uint32_t arcs;         ///< Arcs that closed with enough instants. This and the next wrap at 2^32.
    uint32_t arcs_dropped; ///< Arcs that were dropped later, or had fewer than ZYGOS_MIN_ARC_INSTANTS.
    uint32_t corrupt;      ///< 1: the members under the checksum did not match it, and no single bit explains that.
    uint32_t filled;       ///< Instants in the buffer that is being filled, accepted or not.
    uint32_t filling;      ///< Which of the two buffers is being filled; the other is added to the blocks.
    uint32_t shared;       ///< Slices of the other one that have been added.
    uint32_t quarantined;  ///< Arcs and blocks that were dropped since the last zygos_scrub(): memory was changed.
    uint32_t twin;         ///< count and open again (ZYGOS_ACCUMULATOR_TWIN), with which each cycle compares them.
    double enough;         ///< Instants with which arcs are compared.
    double target;         ///< Length of a segment in instants.
    double segment;        ///< Accepted instants of the open segment.
    uint64_t accepted;     ///< Instants in closed arcs and in the open one.
    uint64_t refused;      ///< Instants that failed the bandwidth test.
    uint64_t checksum;     ///< Of width, count, open, newest, window, arcs, enough and target.
    double early;          ///< Weight of the older block in the buffer that is added.
    double late;           ///< Weight of the newer block.
    zygos_row_buffer_t buffer[2];
    zygos_noise_sums_t noise;      ///< Noise of the open segment, not yet subtracted.
    zygos_noise_sums_t noise_open; ///< Noise of the other segments of the open arc, subtracted.
    zygos_noise_sums_t
        noise_closed; ///< Noise of closed arcs, subtracted; reduced in proportion when an arc is dropped.
    zygos_block_t block[ZYGOS_MAX_BLOCKS];
} zygos_accumulator_t;

/// count and open in one number. There are at most 256 blocks.
#define ZYGOS_ACCUMULATOR_TWIN(self) ((self)->count ^ (((self)->open << 16u) | ((self)->open >> 16u)))

/// Initialises the accumulator for p parameters and arcs of at most arc_cycles cycles.
void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s);

/// Adds one instant with weight 1 (accepted) or 0 (refused); the instructions are the same. Cost: one rank-1 update of
/// (p+2)(p+3)/2 entries, and the addition of that number / ZYGOS_BUFFER_ROWS to the blocks; when an arc begins or a
/// segment has ended, also the opening of the next segment, in the worst case one merge of all blocks. The caller adds
/// the noise of this instant to self->noise after this call.
void zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight);

/// Adds the content of both buffers to the blocks. Cost: one pass over each of them.
void zygos_accumulator_flush(zygos_accumulator_t *self);

/// Ends the open arc, whose newest cycle is given: eliminates its constant, or drops it when it is too short. Cost: one
/// pass over its blocks.
void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle);

/// The same in two calls. The first eliminates the constant and returns true, or drops an arc that is too short and
/// returns false. The closed arc is then in the blocks from self->open on, and its noise in self->noise_open. The
/// second call either admits it to the closed arcs or leaves it out.
bool zygos_accumulator_close(zygos_accumulator_t *self);
void zygos_accumulator_admit(zygos_accumulator_t *self, uint64_t cycle);
void zygos_accumulator_leave_out(zygos_accumulator_t *self);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Cost: one pass over their blocks.
void zygos_accumulator_forget(zygos_accumulator_t *self, double factor);

/// Drops the open arc, and the blocks of closed arcs with cycles after the given one. A block in which such cycles were
/// merged with older ones is dropped as a whole. Cost: one pass over the noise of closed arcs.
void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle);

/// Drops the blocks of closed arcs up to the given cycle, and their share of the noise. Returns the number of arcs,
/// counting merged arcs as one. Cost: one move of the other blocks.
uint32_t zygos_accumulator_drop_until(zygos_accumulator_t *self, uint64_t cycle);

/// Returns whether every index, count and length is possible for p parameters. The other functions rely on that and do
/// not check it. Reads nothing outside the struct, whatever its content is. Cost: a few comparisons for each block.
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters);

/// Drops each block of closed arcs that does not match its row sums or its checksum, and the open arc where its sums do
/// not match; repairs a flipped bit of the members that tell which blocks there are. Returns false, and changes only
/// these, when the rest cannot be repaired: then initialise it. Needs a width that matches the configuration. Cost: one
/// pass over the sums.
bool zygos_accumulator_scrub(zygos_accumulator_t *self, uint32_t parameters);

/// Sums the blocks of closed arcs into gram (packed as in a block, width self->width).
void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram);

/// Returns the largest violation of G 1 = sum over all blocks in units of its tolerance (gram.h), or 2 when an arc was
/// corrupt when it closed. Above 1 means corrupt. Needs zygos_accumulator_intact(). The buffers are not checked before
/// zygos_accumulator_flush().
double zygos_accumulator_check(const zygos_accumulator_t *self);

#ifdef __cplusplus
}
#endif
#endif
