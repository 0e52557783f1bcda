/// zygos/priv/momentumsums.h: accumulates the normal equations of the momentum rows.
///
/// The rows contain only the kinetic parameters and the rotors, and their right-hand side is zero; their sums are
/// separate from those of the energy rows until the solver adds both. Neighbouring instants give nearly the same
/// information, therefore one component is added in each cycle. The expected products of noise are summed separately,
/// those of one sensor in each cycle with a larger weight, and are subtracted when an arc ends. Each component has a
/// constant of its own in each arc. Blocks consist of whole arcs; when all are in use, two neighbours are merged.
///
/// What takes time in proportion to a block is a task that proceeds by a part in each cycle, as that of the energy rows
/// (accumulator.h): an arc is closing from its end until it is admitted.

#ifndef ZYGOS_MOMENTUMSUMS_H
#define ZYGOS_MOMENTUMSUMS_H

#include "../types.h"
#include "gram.h"
#include "momentum.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The length of a row that is augmented by the constants of the components. With ZYGOS_MOMENTUM = 0 there is no memory
/// for rows.
#if ZYGOS_MOMENTUM
#define ZYGOS_MAX_MOMENTUM_ROW (ZYGOS_MAX_MOMENTUM + 3)
#define ZYGOS_MOMENTUM_PLACES ZYGOS_MAX_MOMENTUM_BLOCKS
#else
#define ZYGOS_MAX_MOMENTUM_ROW 1
#define ZYGOS_MOMENTUM_PLACES 1
#endif
#define ZYGOS_MAX_PACKED_MOMENTUM (ZYGOS_MAX_MOMENTUM_ROW * (ZYGOS_MAX_MOMENTUM_ROW + 1) / 2)

/// Sum of z z^T with z = [columns, 1 at the constant of the component], lower triangle by rows, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_MOMENTUM];
    double sum[ZYGOS_MAX_MOMENTUM_ROW];
} zygos_momentum_gram_t;

/// One block of the sums.
typedef struct {
    zygos_momentum_gram_t rows; ///< Closed arcs: without the constants and the noise.
    double instants;            ///< Accepted instants. Of closed arcs, without the factor fade.
    double fade;                ///< Factor of the block (exponential forgetting).
    uint64_t end;               ///< Number of the newest cycle.
    uint64_t checksum;          ///< Closed arcs: of instants, fade and end.
} zygos_momentum_block_t;

/// Number of cycles in which a task reads or changes each entry of a block once, and the least number of entries in one
/// cycle.
#define ZYGOS_MOMENTUM_PASS_CYCLES 6u
#define ZYGOS_MOMENTUM_LEAST_PART 24u

/// The tasks, which are done beside the rows of a cycle.
#define ZYGOS_MOMENTUM_NONE 0u
#define ZYGOS_MOMENTUM_VERIFY_ROWS 1u  ///< Compares the closing arc with its row sums.
#define ZYGOS_MOMENTUM_VERIFY_NOISE 2u ///< Compares its noise with its row sums.
#define ZYGOS_MOMENTUM_ELIMINATE 3u    ///< Eliminates its constants and subtracts its noise.
#define ZYGOS_MOMENTUM_JUDGE 4u        ///< Compares it with the running solution (guard.h).
#define ZYGOS_MOMENTUM_ADMIT 5u        ///< Admits it with its noise to the closed arcs, or leaves it out.
#define ZYGOS_MOMENTUM_MERGE 6u        ///< Adds a block to the one before it.
#define ZYGOS_MOMENTUM_SHIFT 7u        ///< Moves a block to the place before it.
#define ZYGOS_MOMENTUM_TASKS 8u

/// The closing arc, and the noise of the open and of the closing one.
#define ZYGOS_MOMENTUM_CLOSING(self)                                                                                   \
    ((self)->block[((self)->count < (uint32_t)ZYGOS_MOMENTUM_PLACES) ? (self)->count : 0u])
#define ZYGOS_MOMENTUM_NOISE_OPEN(self) ((self)->noise_arc[(self)->parity & 1u])
#define ZYGOS_MOMENTUM_NOISE_CLOSING(self) ((self)->noise_arc[((self)->parity & 1u) ^ 1u])

/// The normal equations of the momentum rows.
typedef struct {
    uint32_t columns;                       ///< Number of columns; 0 where the configuration has no such rows.
    uint32_t components;                    ///< Number of components: 3 in space, 1 in a plane.
    uint32_t count;                         ///< Number of blocks of closed arcs.
    uint32_t corrupt;                       ///< 1: count and target did not match, and no single bit explains that.
    uint32_t cycles;                        ///< Instants of the open arc, accepted or not.
    uint32_t signals;                       ///< Sensors whose noise is subtracted; 0 where none is.
    uint32_t quarantined;                   ///< Arcs and blocks that were dropped since the last zygos_arm_scrub().
    uint32_t task;                          ///< One of the tasks above.
    uint32_t row;                           ///< The next row of the task.
    uint32_t place;                         ///< The block that the task changes.
    uint32_t admitted;                      ///< 1: the closing arc is admitted.
    uint32_t parity;                        ///< 0 or 1 in turn: which of noise_arc is that of the open arc.
    uint32_t twin;                          ///< zygos_momentum_sums_twin(), which each cycle compares.
    uint32_t closing_cycles;                ///< Instants of the closing arc, accepted or not; 0 where none is closing.
    double target;                          ///< Instants up to which blocks are merged.
    double noise_fade;                      ///< Factor of noise_closed.
    uint64_t checksum;                      ///< Of count, target and noise_fade.
    double deviation[ZYGOS_MAX_JOINTS + 3]; ///< Of each signal, with the weight of its turn (momentum.h).
    double rotor[ZYGOS_MAX_JOINTS];         ///< Contribution of the rotors' rates in one instant.
    zygos_momentum_gram_t noise_arc[2];     ///< Noise of the open and of the closing arc, not yet subtracted. That of
                                            ///< the open one is without the rotors.
    zygos_momentum_gram_t noise_closed;     ///< Noise of closed arcs; reduced in proportion when one is dropped.
    zygos_gram_scan_t scan;                 ///< Row sums of what is verified.
    zygos_momentum_block_t arc;             ///< The open arc.
    zygos_momentum_block_t block[ZYGOS_MOMENTUM_PLACES]; ///< Those of closed arcs, and then the closing arc.
} zygos_momentum_sums_t;

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns the members that tell where the closing arc is, in one number.
static inline uint32_t zygos_momentum_sums_twin(const zygos_momentum_sums_t *self)
{
    const uint32_t fold = zygos_folded_count(zygos_folded_count(self->count, self->parity), self->closing_cycles);
    return zygos_fold_of_counts_end(fold);
}
#endif

/// Computes what follows from the configuration: columns, components, and the noise of an instant. The sums are not
/// changed. Needs a checked configuration.
void zygos_momentum_sums_tables(zygos_momentum_sums_t *self, const zygos_config_t *config,
                                const zygos_smoother_t *smoother);

/// Returns whether every index and count is possible for a checked configuration. The other functions rely on that and
/// do not check it. Cost: a comparison for each block.
bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Returns whether a cycle addresses nothing outside the struct, once the tables are verified, and the closing arc is
/// where it was. Cost: a few comparisons.
bool zygos_momentum_sums_steady(const zygos_momentum_sums_t *self);

/// Clears the sums. Needs the tables.
void zygos_momentum_sums_clear(zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Adds the row of the component whose turn it is with weight 1 or 0, and the noise of the sensor whose turn it is.
/// Needs a configuration with such rows, and an instant that belongs to an arc. Cost: one row, one derivative, and a
/// rank-1 update of (columns + 3)(columns + 4)/2 entries for each of them.
void zygos_momentum_sums_add(zygos_momentum_sums_t *self, const zygos_config_t *config,
                             const zygos_momentum_t *momentum, const zygos_arm_state_t *state,
                             const zygos_motion_t *motion, double weight);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_momentum_sums_is_short(const zygos_momentum_sums_t *self);

/// Ends the open arc, whose newest cycle is given: it is closing from then on, or dropped when it is too short, and
/// then false is returned. Needs that no task is open, or that the arc is too short. Cost: one copy of its sums.
bool zygos_momentum_sums_close(zygos_momentum_sums_t *self, uint64_t cycle);

/// Proceeds with the task. ZYGOS_MOMENTUM_JUDGE is that of the caller, who ends it by the next function: this one does
/// nothing then. Needs the tables. Cost: a part of a pass over a block.
void zygos_momentum_sums_proceed(zygos_momentum_sums_t *self, const zygos_config_t *config);
void zygos_momentum_sums_judged(zygos_momentum_sums_t *self, bool admitted);

/// Returns the row before which the next part of the task ends.
uint32_t zygos_momentum_sums_part(const zygos_momentum_sums_t *self);

/// Drops the open arc.
void zygos_momentum_sums_leave_out(zygos_momentum_sums_t *self);

/// Multiplies the sums of closed arcs by a factor (exponential forgetting). Needs finished tasks. Cost: a few
/// instructions for each block.
void zygos_momentum_sums_forget(zygos_momentum_sums_t *self, double factor);

/// Multiplies each block and the noise of closed arcs by its factor, which is 1 then. Needs finished tasks. Cost: one
/// pass over the blocks of which the factor is not 1.
void zygos_momentum_sums_apply_fade(zygos_momentum_sums_t *self);

/// Drops the open arc, and the closing one and the blocks with cycles after the given one. Cost: one pass over the sums
/// of two arcs.
void zygos_momentum_sums_drop_after(zygos_momentum_sums_t *self, uint64_t cycle);

/// Drops the blocks up to the given cycle and their share of the noise, and returns their number. Needs finished tasks.
uint32_t zygos_momentum_sums_drop_until(zygos_momentum_sums_t *self, uint64_t cycle);

/// Drops each block that does not match its row sums or its checksum, and the open arc where its sums do not match;
/// repairs a flipped bit of count and target. Returns false when that cannot be repaired: then clear the sums. Clears
/// them where the configuration has no such rows. Needs the tables. Cost: one pass over the sums.
bool zygos_momentum_sums_scrub(zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Returns the largest violation of the row sums in units of their tolerance, or 2 when an arc was corrupt when it
/// closed or a checksum does not match. Above 1 means corrupt. Needs zygos_momentum_sums_intact().
double zygos_momentum_sums_check(const zygos_momentum_sums_t *self);

#ifdef __cplusplus
}
#endif
#endif
