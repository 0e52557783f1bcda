/* SPDX-License-Identifier: MIT */
/// zygos/priv/momentumsums.h: accumulates the normal equations of the momentum rows.
///
/// The rows contain only the kinetic parameters and the rotors, and their right-hand side is zero; their sums are
/// separate from those of the energy rows until the solver adds both. Neighbouring instants give nearly the same
/// information, therefore one component is added in each cycle. The expected products of noise are summed separately,
/// those of one sensor in each cycle with a larger weight, and are subtracted when an arc ends. Each component has a
/// constant of its own in each arc. Blocks consist of whole arcs (store.h).

#ifndef ZYGOS_MOMENTUMSUMS_H
#define ZYGOS_MOMENTUMSUMS_H

#include "../types.h"
#include "balance.h"
#include "gram.h"
#include "momentum.h"
#include "store.h"

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
    zygos_block_head_t head;
} zygos_momentum_block_t;

/// The normal equations of the momentum rows.
typedef struct {
    zygos_store_t store;
    uint32_t columns;    ///< Number of columns; 0 where the configuration has no such rows.
    uint32_t components; ///< Number of components: 3 in space, 1 in a plane.
    uint32_t signals;    ///< Sensors whose noise is subtracted; 0 where none is.
    uint32_t reserved;
    double deviation[ZYGOS_MAX_JOINTS + 3]; ///< Of each signal, with the weight of its turn (momentum.h).
    double rotor[ZYGOS_MAX_JOINTS];         ///< Contribution of the rotors' rates in one instant.
    zygos_momentum_gram_t noise_open[2];    ///< Noise of the open and of the closing arc, not yet subtracted. That of
                                            ///< the open one is without the rotors.
    zygos_momentum_gram_t noise_closed;     ///< Noise of closed arcs; reduced in proportion when one is dropped.
    zygos_momentum_block_t block[ZYGOS_MOMENTUM_PLACES + 1];
} zygos_momentum_sums_t;

/// Returns the block of that rank in order of time.
const zygos_momentum_block_t *zygos_momentum_sums_at(const zygos_momentum_sums_t *self, uint32_t rank);

/// Computes what follows from the configuration: columns, components, and the noise of an instant. The sums are not
/// changed. Needs a checked configuration.
void zygos_momentum_sums_tables(zygos_momentum_sums_t *self, const zygos_config_t *config,
                                const zygos_smoother_t *smoother);

/// Returns whether columns and components are those of a checked configuration, and every index and count is possible.
/// The other functions rely on that and do not check it. Cost: a comparison for each block.
bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config);

/// Writes where the columns stand among the parameters, or ZYGOS_NO_PLACE. Returns their number, for which there is
/// room, whatever memory says.
uint32_t zygos_momentum_sums_places(const zygos_momentum_sums_t *self, const zygos_column_map_t *column_map,
                                    uint32_t *place);

/// Adds the row of the component whose turn it is with weight 1 or 0, and the noise of the sensor whose turn it is.
/// Needs a configuration with such rows, and an instant that belongs to an arc. Cost: one row, one derivative, and a
/// rank-1 update of (columns + 3)(columns + 4)/2 entries for each of them.
void zygos_momentum_sums_add(zygos_momentum_sums_t *self, const zygos_config_t *config,
                             const zygos_momentum_t *momentum, const zygos_arm_state_t *state,
                             const zygos_motion_t *motion, double weight);

/// Adds to the noise of an arc with so many instants that of the rotors' rates, which is the same in each of them.
void zygos_momentum_sums_add_rotors(const zygos_momentum_sums_t *self, double instants, double *gram, double *sum);

#ifdef __cplusplus
}
#endif
#endif
