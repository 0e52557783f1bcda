/* SPDX-License-Identifier: MIT */
/// zygos/priv/reduction.h: reduces the columns of a row to the structurally independent ones.
///
/// Some columns are linear combinations of others in every motion, because of the arm's geometry: axes that are
/// parallel or perpendicular, a base that does not move. A row over all columns, z, is then formed as before, and
/// z E is accumulated in its place, with a constant matrix E of full column rank: columns . (E parameters) = right
/// side. What is estimated are the parameters that E leaves, followed by the coefficients of the effects, which are not
/// reduced. Without a reduction E is the unit matrix.
///
/// On a free base E must be a selection, one entry of 1 for each parameter, in ascending order; on a fixed base it is
/// any matrix that selects Im, k and b of every flexible joint as they are. The solver judges whether Im, k and b of
/// flexible joints and the coefficients of effects are physical, and the rest only where E selects every column: a
/// parameter that stands for others as well may have any sign.

#ifndef ZYGOS_REDUCTION_H
#define ZYGOS_REDUCTION_H

#include "../types.h"
#include "balance.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Checks the reduction of a configuration whose joints, base and effects are possible, and whether this build has room
/// for the columns and the parameters. Returns 1 or ZYGOS_E_REDUCTION. Cost: a few passes over the entries.
int zygos_reduction_check(const zygos_config_t *config);

/// Computes the members reduced, parameters and place of a column map from the others. Needs a checked configuration.
void zygos_reduction_places(const zygos_config_t *config, zygos_column_map_t *column_map);

/// Returns whether every column has a parameter of its own.
bool zygos_reduction_selects_all(const zygos_column_map_t *column_map);

/// Writes the p parameters' columns of a row into out from those that it was formed with; both end with the effects.
/// The arrays must not overlap. Cost: a product and a sum for each entry, the same for every row of a configuration.
void zygos_reduce(const zygos_config_t *config, const zygos_column_map_t *column_map, const double *columns,
                  double *out);

/// Writes x into out, an entry for each column: E times the parameters, then the effects.
void zygos_expand(const zygos_config_t *config, const zygos_column_map_t *column_map, const double *parameters,
                  double *out);

#ifdef __cplusplus
}
#endif
#endif
