/// zygos/accumulator.h: the normal equations, in fixed memory and for any duration.
///
/// Within an arc each row reads [y, D] . x + constant = W with the same unknown constant. The accumulator sums the
/// outer products of z = [row, W, 1]; the last column then holds all that is needed to eliminate the constant exactly
/// when the arc ends: G := G - s m^T - m s^T + n m m^T with m the mean of the arc.
///
/// The sums are kept in blocks of consecutive instants. When all blocks are in use, blocks become twice as long and
/// neighbours that fit into one merge. The blocks do not change the sum; their spread is what the sigmas come from.
///
/// Every block carries its row sums. G 1 = sum holds to rounding, unless memory was corrupted.

#ifndef ZYGOS_ACCUMULATOR_H
#define ZYGOS_ACCUMULATOR_H

#include "balance.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double gram[ZYGOS_MAX_PACKED_ROW]; ///< Sum of z z^T, lower triangle row by row, width (width + 1)/2 used.
    double sum[ZYGOS_MAX_ROW];         ///< Sum of z (1^T z): the row sums of gram.
    double deviation[ZYGOS_MAX_ROW];   ///< Closed arcs: sum of z less as many times the mean of its arc.
    uint64_t instants;                 ///< Accepted instants in this block.
    uint64_t end;                      ///< Closed arcs: number of the newest cycle in them.
} zygos_block_t;

typedef struct {
    uint32_t width;        ///< p + 2.
    uint32_t count;        ///< Blocks in use; those of the open arc come last.
    uint32_t open;         ///< First block of the open arc. The blocks before it belong to closed arcs.
    uint32_t arc_instants; ///< Accepted instants of the open arc.
    uint32_t arcs;         ///< Arcs that closed with enough instants.
    uint32_t arcs_dropped; ///< Arcs that were dropped later, or had fewer than ZYGOS_MIN_ARC_INSTANTS.
    uint32_t corrupt;      ///< 1: the row sums of an arc did not match when it closed.
    uint64_t target;       ///< Instants at which a block is full.
    uint64_t accepted;     ///< Instants in closed arcs and in the open one.
    uint64_t refused;      ///< Instants that failed the bandwidth test.
    zygos_block_t block[ZYGOS_MAX_BLOCKS];
} zygos_accumulator_t;

/// Empties the accumulator for p parameters.
void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters);

/// Adds one instant with weight 1 (accepted) or 0 (refused): the instructions are the same. Cost: one rank-1 update of
/// (p+2)(p+3)/2 entries; when a block has become full, in addition what it takes to open the next, at the worst one
/// merge of all blocks.
void zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight);

/// Ends the open arc, whose newest cycle is the given one: eliminates its constant, or drops it when it is too short.
/// Cost: its blocks once.
void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle);

/// Drops the open arc, and the blocks of closed arcs that reach beyond the given cycle. A block in which that cycle was
/// merged with older ones goes as a whole. Cost: none for the sums.
void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle);

/// Sums the blocks of closed arcs into gram (packed as in a block, width self->width).
void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram);

/// Largest violation of G 1 = sum over all blocks, in units of its tolerance 64 eps n max|G|, or 2 when an arc that
/// closed was corrupt. Above 1 means corrupt.
double zygos_accumulator_check(const zygos_accumulator_t *self);

#ifdef __cplusplus
}
#endif
#endif
