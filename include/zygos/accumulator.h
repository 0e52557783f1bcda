/// zygos/accumulator.h: the normal equations, in fixed memory and for any duration.
///
/// Within an arc each row reads [y, D] . x + constant = W with the same unknown constant. The accumulator sums the
/// outer products of z = [row, W, 1]; the last column then holds all that is needed to eliminate the constant exactly
/// when the arc ends: G := G - s m^T - m s^T + n m m^T with m the mean of the arc.
///
/// The sums are kept in blocks, whose spread is what the sigmas come from. A block that begins and ends sharply would
/// tell of its edges, for the noise of a rate adds up to the difference of two angles. So blocks overlap: in each
/// segment one fades out and the next fades in, and the weights of an instant add up to 1. When all blocks are in use,
/// segments become twice as long and neighbours that fit into one block merge. The blocks do not change the sum.
///
/// The rows of ZYGOS_BUFFER_ROWS instants are summed together and then shared out to the two blocks, a slice in each
/// cycle, so that a cycle costs one rank-1 update and a little, and all cycles cost the same.
///
/// What noise adds on average (noise.h) is summed beside, and taken off the blocks when a segment ends.
///
/// Every block carries its row sums. G 1 = sum holds to rounding, unless memory was corrupted. What a block of closed
/// arcs holds beside its sums, and what says which blocks there are, carries a seal; in the open arc the instants are
/// counted in the sums as well, and the weights of a block are what it shares with its neighbours.

#ifndef ZYGOS_ACCUMULATOR_H
#define ZYGOS_ACCUMULATOR_H

#include "balance.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Of fewer blocks the spread says too little, so no more are merged. Where room is made, two must be free for the arc
/// that begins: the smallest build has six that stay.
#define ZYGOS_MIN_BLOCKS ((ZYGOS_MAX_BLOCKS < 10) ? 6u : 8u)

typedef struct {
    double gram[ZYGOS_MAX_SLICED_GRAM]; ///< Sum of w z z^T, lower triangle row by row, width (width + 1)/2 used; behind
                                        ///< it 0.
    double sum[ZYGOS_MAX_SLICED_ROW];   ///< Row sums of gram.
    double deviation[ZYGOS_MAX_ROW];    ///< Closed arcs: sum of w z less as many times the mean of its arc.
    double instants;                    ///< Sum of the weights w of accepted instants.
    double square;                      ///< Sum of w^2.
    double overlap;                     ///< Sum of w times the weight in the block behind.
    uint64_t end;                       ///< Closed arcs: number of the newest cycle in them.
    uint64_t checksum;                  ///< Closed arcs: of deviation and all behind it; 0 in the open arc.
} zygos_block_t;

/// What noise adds on average: packed lower triangle of p + 1 rows, that of the work last, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_ROW];
    double sum[ZYGOS_MAX_ROW];
} zygos_noise_sums_t;

/// The rows of a step.
typedef struct {
    double gram[ZYGOS_MAX_SLICED_GRAM];
    double sum[ZYGOS_MAX_SLICED_ROW];
    double instants; ///< Accepted ones.
} zygos_row_buffer_t;

typedef struct {
    uint32_t width;        ///< p + 2.
    uint32_t count;        ///< Blocks in use; those of the open arc come last.
    uint32_t open;         ///< First block of the open arc. The blocks before it belong to closed arcs.
    uint32_t newest;       ///< First block of the newest arcs that have enough instants to speak for themselves,
    uint32_t window;       ///< and of those behind them, which do not yet.
    uint32_t arc_instants; ///< Accepted instants of the open arc.
    uint32_t arcs;         ///< Arcs that closed with enough instants. Wraps at 2^32, and so does the next.
    uint32_t arcs_dropped; ///< Arcs that were dropped later, or had fewer than ZYGOS_MIN_ARC_INSTANTS.
    uint32_t corrupt;      ///< 1: the row sums of an arc did not match when it closed.
    uint32_t filled;       ///< Instants of the step that fills, accepted or not.
    uint32_t filling;      ///< Which of the two steps fills; the other is shared out.
    uint32_t shared;       ///< Slices of it that have been shared out.
    double enough;         ///< Instants with which arcs speak for themselves.
    double target;         ///< Instants of a segment.
    double segment;        ///< Accepted instants of the open segment.
    uint64_t accepted;     ///< Instants in closed arcs and in the open one.
    uint64_t refused;      ///< Instants that failed the bandwidth test.
    uint64_t checksum;     ///< Of width, count, open, newest, window, arcs, enough and target.
    double early;          ///< Share of the older block in the step that is shared out, and
    double late;           ///< of the newer one.
    zygos_row_buffer_t buffer[2];
    zygos_noise_sums_t noise;      ///< Of the open segment, not yet taken off.
    zygos_noise_sums_t noise_open; ///< Of the other segments of the open arc, taken off.
    zygos_noise_sums_t
        noise_closed; ///< Of closed arcs, taken off. When one of them is dropped, it shrinks in proportion.
    zygos_block_t block[ZYGOS_MAX_BLOCKS];
} zygos_accumulator_t;

/// Empties the accumulator for p parameters and arcs of so many cycles.
void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s);

/// Adds one instant with weight 1 (accepted) or 0 (refused): the instructions are the same. Cost: one rank-1 update of
/// (p+2)(p+3)/2 entries, and the same number / ZYGOS_BUFFER_ROWS shared out; when an arc begins or a segment has ended,
/// in addition what it takes to open the next, at the worst one merge of all blocks. What noise adds on average to this
/// instant goes into self->noise behind this call.
void zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight);

/// Shares out what waits in steps. Cost: each of them once.
void zygos_accumulator_flush(zygos_accumulator_t *self);

/// Ends the open arc, whose newest cycle is the given one: eliminates its constant, or drops it when it is too short.
/// Cost: its blocks once.
void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle);

/// The same in two steps. Closing eliminates the constant and returns true, or drops an arc that is too short and
/// returns false. A closed arc is in the blocks from self->open on, its noise in self->noise_open, until the next call
/// admits it to those before, or leaves it out.
bool zygos_accumulator_close(zygos_accumulator_t *self);
void zygos_accumulator_admit(zygos_accumulator_t *self, uint64_t cycle);
void zygos_accumulator_leave_out(zygos_accumulator_t *self);

/// Multiplies all that closed arcs left by a factor. Cost: their blocks once.
void zygos_accumulator_forget(zygos_accumulator_t *self, double factor);

/// Drops the open arc, and the blocks of closed arcs that reach beyond the given cycle. A block in which that cycle was
/// merged with older ones goes as a whole. Cost: one pass over the noise of closed arcs.
void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle);

/// Drops the blocks of closed arcs up to the given cycle, and their share of the noise. Returns how many arcs these
/// were, those that were merged as one. Cost: a move of the others.
uint32_t zygos_accumulator_drop_until(zygos_accumulator_t *self, uint64_t cycle);

/// Whether every place, count and length exists for p parameters: the other calls rely on that, and do not look. Reads
/// nothing beyond the struct, whatever is in it. Cost: a few comparisons a block.
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters);

/// Sums the blocks of closed arcs into gram (packed as in a block, width self->width).
void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram);

/// Largest violation of G 1 = sum over all blocks, in units of its tolerance (gram.h), or 2 when an arc that
/// closed was corrupt. Above 1 means corrupt. Needs an accumulator that is intact. Steps are not looked at before they
/// are flushed.
double zygos_accumulator_check(const zygos_accumulator_t *self);

#ifdef __cplusplus
}
#endif
#endif
