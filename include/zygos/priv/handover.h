/* SPDX-License-Identifier: MIT */
/// zygos/priv/handover.h: copies the sums for a solution, a part in each cycle.
///
/// What the rows of each cycle change is copied at one moment, which costs less than a row: the cut. All other sums of
/// that kind of rows are changed by tasks alone (accumulator.h). These wait from the cut on until the rest has been
/// copied, by a part in each cycle, so that the copy is what zygos_arm_take() would have copied at the moment of the
/// cut. Where no row waits half added to a block, the blocks of the open arc of energy rows are no part of the cut:
/// they are copied in ZYGOS_HANDOVER_QUARTERS cycles, each row of them before the rows that wait are added to it. A
/// part is a block or a table: how many there are does not depend on the capacities. The kinds of rows follow each
/// other, each with a cut of its own. Where sums are dropped meanwhile, the kind begins again.

#ifndef ZYGOS_HANDOVER_H
#define ZYGOS_HANDOVER_H

#include "../types.h"
#include "sums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Cycles in which blocks of the open arc are copied, which is before the rows that wait have been added to them.
#define ZYGOS_HANDOVER_QUARTERS 4u
/// Cycles after which a cut no longer waits for the moment at which it costs the least.
#define ZYGOS_HANDOVER_PATIENCE 512u
/// How often a kind of rows begins again before the rest of it is copied at once.
#define ZYGOS_HANDOVER_TRIES 16u

/// What is to be copied next.
typedef struct {
    uint32_t kind;    ///< enum zygos_rows, ZYGOS_JOINT_KIND, then ZYGOS_GUARD_KIND; ZYGOS_HANDOVER_KINDS: done.
    uint32_t cut;     ///< 1: the cut of this kind was made.
    uint32_t unit;    ///< Of the rest of it, the next block or table.
    uint32_t waited;  ///< Cycles for which the cut has waited.
    uint32_t tries;   ///< How often this kind has begun again.
    uint32_t dropped; ///< zygos_sums_t.dropped at the cut.
    uint32_t whole;   ///< 1: the cut has copied the blocks of the open arc of energy rows, too.
    uint32_t fold;    ///< Of all of these: a copy that memory errors have led elsewhere would lack sums.
    uint8_t copied[ZYGOS_ORDER_PLACES]; ///< 1: this block of energy rows needs not be copied as one of the others.
} zygos_handover_t;

/// The running solution, which follows ZYGOS_JOINT_KIND.
#define ZYGOS_GUARD_KIND 4u
#define ZYGOS_HANDOVER_KINDS 5u

/// Begins anew.
void zygos_handover_begin(zygos_handover_t *self);

/// Returns the bits of zygos_arm_t.held: the kind of rows whose tasks wait.
uint32_t zygos_handover_held(const zygos_handover_t *self);

/// Copies the next part. Call it before a cycle is processed. Needs a state that was initialised. Where memory has
/// changed *self, the copy begins anew. Returns whether all is copied; out->config is the caller's to copy. Cost: a
/// cut, or the copy of a block.
bool zygos_handover_part(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out);

#ifdef __cplusplus
}
#endif
#endif
