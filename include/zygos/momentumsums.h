/// zygos/momentumsums.h: the normal equations of the momentum rows.
///
/// The rows know the kinetic parameters and the rotors only, and their right-hand side is zero: their sums stay apart
/// from those of the energy until the solver adds both. Neighbouring instants say much the same, so one component has
/// its turn a cycle; what noise adds on average is summed beside, one sensor's share in that component a cycle, with as
/// much more weight, and is taken off when an arc ends. Each component has a constant of its own in each arc. Blocks
/// are whole arcs; when all are in use, neighbours merge.

#ifndef ZYGOS_MOMENTUMSUMS_H
#define ZYGOS_MOMENTUMSUMS_H

#include "momentum.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A row, augmented by the constants of the components. At ZYGOS_MOMENTUM = 0 there is room for none.
#if ZYGOS_MOMENTUM
#define ZYGOS_MAX_MOMENTUM_ROW (ZYGOS_MAX_MOMENTUM + 3)
#define ZYGOS_MOMENTUM_PLACES ZYGOS_MAX_MOMENTUM_BLOCKS
#else
#define ZYGOS_MAX_MOMENTUM_ROW 1
#define ZYGOS_MOMENTUM_PLACES 1
#endif
#define ZYGOS_MAX_PACKED_MOMENTUM (ZYGOS_MAX_MOMENTUM_ROW * (ZYGOS_MAX_MOMENTUM_ROW + 1) / 2)

/// Sum of z z^T of z = [columns, 1 at the component's constant], lower triangle row by row, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_MOMENTUM];
    double sum[ZYGOS_MAX_MOMENTUM_ROW];
} zygos_momentum_gram_t;

typedef struct {
    zygos_momentum_gram_t rows; ///< Closed: the constants eliminated, the noise taken off.
    double instants;            ///< Accepted ones.
    uint64_t end;               ///< Number of the newest cycle.
    uint64_t checksum;          ///< Of instants and end, when the arc has closed.
} zygos_momentum_block_t;

typedef struct {
    uint32_t columns;                       ///< 0 where the configuration asks for no such rows.
    uint32_t components;                    ///< 3 in space, 1 in a plane.
    uint32_t count;                         ///< Blocks of closed arcs.
    uint32_t corrupt;                       ///< 1: the row sums of an arc did not match when it closed.
    uint32_t cycles;                        ///< Instants of the open arc, accepted or not.
    uint32_t signals;                       ///< Sensors whose noise is taken off; 0 where none is.
    double target;                          ///< Instants up to which blocks merge.
    uint64_t checksum;                      ///< Of count and target.
    double deviation[ZYGOS_MAX_JOINTS + 3]; ///< Of each signal, for its turn (momentum.h).
    double rotor[ZYGOS_MAX_JOINTS];         ///< What the rotors' rates owe in an instant.
    zygos_momentum_gram_t noise_open;       ///< Of the open arc, not yet taken off, without the rotors' share.
    zygos_momentum_gram_t noise_closed;     ///< Of closed arcs. When one of them is dropped, it shrinks in proportion.
    zygos_momentum_block_t open;
    zygos_momentum_block_t block[ZYGOS_MOMENTUM_PLACES];
} zygos_momentum_sums_t;

/// What follows from the configuration: columns, components, and what noise adds in an instant. The sums stay.
/// Needs a checked configuration.
void zygos_momentum_sums_tables(zygos_momentum_sums_t *self, const zygos_config_t *config,
                                const zygos_smoother_t *smoother);

/// Whether every place and count exists for a checked configuration: the other calls rely on that, and do not look.
/// Cost: a comparison a block.
bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Empties the sums. Needs the tables.
void zygos_momentum_sums_clear(zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Adds the row of the component whose turn it is with weight 1 or 0, and what the sensor whose turn it is adds to it.
/// Needs a configuration that asks for such rows, and an instant that belongs to an arc. Cost: one row, one derivative,
/// and a rank-1 update of (columns + 3)(columns + 4)/2 entries for each.
void zygos_momentum_sums_add(zygos_momentum_sums_t *self, const zygos_config_t *config,
                             const zygos_momentum_t *momentum, const zygos_arm_state_t *state,
                             const zygos_motion_t *motion, double weight);

/// Ends the open arc, whose newest cycle is the given one: eliminates its constants and takes its noise off, or drops
/// it when it is too short. Cost: the sums of an arc a few times; at the worst one merge of all blocks.
void zygos_momentum_sums_end_arc(zygos_momentum_sums_t *self, const zygos_config_t *config, uint64_t cycle);

/// The same in two steps. Closing eliminates the constants, takes the noise off and returns true, or drops an arc that
/// is too short and returns false. A closed arc is in self->open until the next call admits it to the blocks, or leaves
/// it out.
bool zygos_momentum_sums_close(zygos_momentum_sums_t *self, const zygos_config_t *config);
void zygos_momentum_sums_admit(zygos_momentum_sums_t *self, uint64_t cycle);
void zygos_momentum_sums_leave_out(zygos_momentum_sums_t *self);

/// Multiplies all that closed arcs left by a factor. Cost: their blocks once.
void zygos_momentum_sums_forget(zygos_momentum_sums_t *self, double factor);

/// Drops the open arc, and the blocks that reach beyond the given cycle. Cost: one pass over the noise of closed arcs.
void zygos_momentum_sums_drop_after(zygos_momentum_sums_t *self, uint64_t cycle);

/// Drops the blocks up to the given cycle and their share of the noise, and returns how many.
uint32_t zygos_momentum_sums_drop_until(zygos_momentum_sums_t *self, uint64_t cycle);

/// Largest violation of the row sums in units of their tolerance, or 2 when an arc that closed was corrupt, or a seal
/// does not match. Above 1 means corrupt. Needs sums that are intact.
double zygos_momentum_sums_check(const zygos_momentum_sums_t *self);

#ifdef __cplusplus
}
#endif
#endif
