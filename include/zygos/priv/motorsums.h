/* SPDX-License-Identifier: MIT */
/// zygos/priv/motorsums.h: accumulates the normal equations of the motor impulse rows, a small set for each joint.
///
/// The rows of a joint contain only its own parameters. Their sums are therefore separate from those of the energy rows
/// until the solver adds both, each with a weight by its noise. The bias by the noise of the sensors is the same at
/// every instant, and is subtracted when an arc ends. The noise that the integral of the deflection accumulates is
/// correlated over a whole arc; therefore blocks consist of whole arcs (store.h).

#ifndef ZYGOS_MOTORSUMS_H
#define ZYGOS_MOTORSUMS_H

#include "../types.h"
#include "balance.h"
#include "impulse.h"
#include "store.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The length of a joint's row that is augmented by the impulse and by 1.
#define ZYGOS_MAX_MOTOR_ROW (ZYGOS_MAX_IMPULSE + 2)
#define ZYGOS_MAX_PACKED_MOTOR (ZYGOS_MAX_MOTOR_ROW * (ZYGOS_MAX_MOTOR_ROW + 1) / 2)

/// Sum of z z^T with z = [columns, impulse, 1], lower triangle by rows, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_MOTOR];
    double sum[ZYGOS_MAX_MOTOR_ROW];
} zygos_motor_gram_t;

/// One block of the sums.
typedef struct {
    zygos_motor_gram_t joint[ZYGOS_MAX_JOINTS]; ///< Closed arcs: without the constants and the noise.
    double instants[ZYGOS_MAX_JOINTS];          ///< Accepted instants whose row of that joint was added.
    zygos_block_head_t head;
} zygos_motor_block_t;

/// The normal equations of the motor rows.
typedef struct {
    zygos_store_t store;
    zygos_impulse_column_map_t column_map;
    double noise[ZYGOS_MAX_JOINTS][ZYGOS_MAX_PACKED_IMPULSE]; ///< Expected products of noise in one instant.
    zygos_motor_block_t block[ZYGOS_MAX_MOTOR_BLOCKS + 1];
} zygos_motor_sums_t;

/// Returns the block of that rank in order of time.
const zygos_motor_block_t *zygos_motor_sums_at(const zygos_motor_sums_t *self, uint32_t rank);

/// Computes what follows from the configuration: the columns, and the noise of an instant. The sums are not changed.
/// Needs a checked configuration.
void zygos_motor_sums_tables(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_smoother_t *smoother);

/// Returns whether the columns are those of a checked configuration, and every index and count is possible. The other
/// functions rely on that and do not check it. Cost: a comparison for each block and each column.
bool zygos_motor_sums_intact(const zygos_motor_sums_t *self, const zygos_config_t *config);

/// Writes where the columns of the rows of a joint stand among the parameters, and behind them the place of the right
/// side. Returns their number. No place is one that there is not, whatever memory says.
uint32_t zygos_motor_sums_places(const zygos_motor_sums_t *self, const zygos_column_map_t *column_map, uint32_t joint,
                                 uint32_t *place);

/// Adds the row of one joint with weight 1 or 0. The joints take turns, one in each instant, because the noise of
/// neighbouring instants is nearly the same. Cost: one small rank-1 update.
void zygos_motor_sums_add(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_impulse_rows_t *rows,
                          double weight);

#ifdef __cplusplus
}
#endif
#endif
