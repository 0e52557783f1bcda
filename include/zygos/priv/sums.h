/* SPDX-License-Identifier: MIT */
/// zygos/priv/sums.h: the sums of all rows of one arm, with what tells how to read them. The state of an arm has one
/// (arm.h), and a solution works on another one, which zygos_arm_take() copies as a whole and handover.h in parts.

#ifndef ZYGOS_SUMS_H
#define ZYGOS_SUMS_H

#include "../types.h"
#include "accumulator.h"
#include "balance.h"
#include "guard.h"
#include "jointsums.h"
#include "momentumsums.h"
#include "motorsums.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The kind of the joint rows, behind those of enum zygos_rows. They have no arcs.
#define ZYGOS_JOINT_KIND 3u
#define ZYGOS_KINDS_OF_SUMS 4u

/// Everything that a solution needs.
typedef struct {
    uint64_t cycle;   ///< SYNC number of the newest cycle that was processed.
    uint32_t arc;     ///< Number of instants of the open arc of energy rows, accepted or not.
    uint32_t ending;  ///< Kinds of rows (enum zygos_rows), as bits, whose open arc has ended, and waits until
                      ///< the arc before it is closed. There are no rows of these kinds until then.
    uint32_t dropped; ///< Number of times, modulo 2^32, that sums were dropped or changed at once.
    uint32_t reserved;
    uint64_t ended[ZYGOS_KINDS_OF_ROWS];          ///< The newest cycle of the arcs that wait.
    double ended_forgetting[ZYGOS_KINDS_OF_ROWS]; ///< Their products of forgetting factors; 1 where none waits.
    double forgetting[ZYGOS_KINDS_OF_SUMS]; ///< Product of the forgetting factors of the cycles in the open arc; of
                                            ///< joint rows, since the last complete segment.
    uint64_t checksum;                      ///< zygos_sums_checksum() as it was when the configuration was given.
    zygos_config_t config;
    zygos_column_map_t column_map;
    zygos_motor_sums_t motors;
    zygos_momentum_sums_t momentum;
    zygos_joint_sums_t joints;
    zygos_accumulator_t energy;
    zygos_guard_t guard;
} zygos_sums_t;

/// Functions of one kind of rows: one of enum zygos_rows, and where it says so also ZYGOS_JOINT_KIND.

/// Returns the blocks of these rows.
zygos_store_t *zygos_sums_store(const zygos_sums_t *self, uint32_t kind);

/// Clears the sums, also of joint rows. Needs the tables. Cost: one memset of them.
void zygos_sums_clear(zygos_sums_t *self, uint32_t kind);

/// Returns whether every index and count is possible for a checked configuration and its column map, also of joint
/// rows. The other functions rely on that and do not check it. Cost: a few comparisons for each block.
bool zygos_sums_is_intact(const zygos_sums_t *self, uint32_t kind, const zygos_column_map_t *column_map);

/// Return what zygos_store_busy() and zygos_store_has_work() do. Cost: a few comparisons.
bool zygos_sums_is_busy(const zygos_sums_t *self, uint32_t kind);
bool zygos_sums_has_work(const zygos_sums_t *self, uint32_t kind);

/// Returns whether the open arc has too few accepted instants to be of use.
bool zygos_sums_is_short(const zygos_sums_t *self, uint32_t kind);

/// Returns whether the open arc can end: no arc before it is closing, and no task changes what would fade with it.
bool zygos_sums_can_close(const zygos_sums_t *self, uint32_t kind);

/// Ends the open arc, whose newest cycle is given: the sums of closed arcs fade, and it is closing from then on, or
/// dropped when it is too short. While tasks change these sums, all fades with the next arc. Needs
/// zygos_sums_can_close(), or that the arc is too short. Cost: two checksums of each block, and one copy of an arc.
void zygos_sums_end_arc(zygos_sums_t *self, uint32_t kind, uint64_t cycle);

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Returns whether the open arc has ended and waits.
static inline bool zygos_sums_is_ending(const zygos_sums_t *self, uint32_t kind)
{
    return ((self->ending >> kind) & 1u) != 0;
}
#endif

/// Ends the arc that waits, if there is one. Needs and cost: as zygos_sums_end_arc().
void zygos_sums_end_waiting(zygos_sums_t *self, uint32_t kind);

/// From here on no arc of that kind waits: all fades with the next one. The product is 1 then, so that a flipped bit of
/// `ending` makes nothing fade.
void zygos_sums_drop_waiting(zygos_sums_t *self, uint32_t kind);

/// Drops the open arc, the closing one, and the blocks with cycles after the given one; of joint rows, the segment that
/// is filled. Cost: one pass over the sums of two arcs.
void zygos_sums_drop_after(zygos_sums_t *self, uint32_t kind, uint64_t cycle);

/// Drops the blocks up to the given cycle and their share of the noise, and returns the number of their arcs. Needs
/// finished tasks. Cost: the other blocks are moved once.
uint32_t zygos_sums_drop_until(zygos_sums_t *self, uint32_t kind, uint64_t cycle);

/// Functions of all kinds of rows.

/// Returns zygos_sums_is_intact() of all. Needs a checked configuration.
bool zygos_sums_are_intact(const zygos_sums_t *self);

/// Finishes the tasks that proceed beside the cycles (accumulator.h), and ends the arcs that wait. Needs
/// zygos_sums_are_intact(). Cost: a few passes over the sums of an arc of each kind.
void zygos_sums_settle(zygos_sums_t *self);

/// Ends the segment of joint rows that is filled, and adds it to its group. Cost: zygos_joint_sums_flush() twice.
void zygos_sums_end_segment(zygos_sums_t *self);

/// Returns how many arcs and blocks were dropped, since the counts were cleared, because memory was changed.
uint32_t zygos_sums_quarantined(const zygos_sums_t *self);

/// Drops each block, and the open arc, whose sums do not match; repairs a flipped bit of what tells which blocks there
/// are. Clears the sums of a kind where that cannot be repaired, and returns of how many; also
/// those of rows that the configuration does not have. Needs the tables. Cost: one
/// pass over the sums.
uint32_t zygos_sums_scrub(zygos_sums_t *self);

/// Multiplies each block and the noise of closed arcs by its factor, which is 1 then. Needs finished tasks. Cost: one
/// pass over the blocks of which the factor is not 1.
void zygos_sums_apply_fade(zygos_sums_t *self);

/// Returns whether what is summed matches what is summed beside it, or has the right checksum. Needs that all arcs have
/// ended. Cost: a pass over the sums.
bool zygos_sums_match(const zygos_sums_t *self);

/// Returns the checksum of the configuration and of the tables beside the sums, which no row sums protect. Cost: one
/// pass over them.
uint64_t zygos_sums_checksum(const zygos_sums_t *self);

/// Settles a copy. Returns false when the checksum does not match, or when a count, an index or a closing arc is not as
/// it was accumulated. Cost: as zygos_sums_settle().
bool zygos_sums_settle_copy(zygos_sums_t *self);

/// Settles a copy, ends its open arcs, and returns whether the sums and counts are those that were accumulated. Where
/// this is false, zygos_work_solve() gives ZYGOS_REASON_CORRUPT. Cost: a few passes over the sums.
bool zygos_sums_end_copy(zygos_sums_t *self);

/// The running solution and the sums with which it is compared (guard.h).

/// Makes a valid estimate the running solution: its solution, its covariance, widened as the 95 % intervals are, and
/// the mean squares of the run for it. Sums that the estimate excluded (its member since) are dropped, and their arcs
/// counted as excluded. Needs finished tasks. Returns false, with the running solution unchanged, where the estimate is
/// not valid, or not newer than since. After the running solution was given up, an estimate that is doubtful only
/// because of ZYGOS_REASON_CHANGED is adopted as well. Cost: one pass over the sums of the motor and momentum rows, and
/// two over the covariance; where sums are dropped, the others are moved once.
bool zygos_guard_adopt(zygos_sums_t *sums, const zygos_estimate_t *estimate);

/// Proceeds with the task of the sums of a kind of rows (enum zygos_rows): with the comparison of the closing arc, if
/// it is its turn. An arc that contradicts the running solution is left out. Returns whether there was a task; of
/// energy rows also, where one may have begun. Cost: a part of a pass over a block; for the first block, also one over
/// the running solution.
void zygos_guard_proceed(zygos_sums_t *sums, uint32_t kind);

/// Finishes the tasks of the sums of a kind of rows. Cost: a few passes over the sums of an arc.
void zygos_guard_settle(zygos_sums_t *sums, uint32_t kind);

/// Ends the segment of joint rows that is filled, if it has rows: it is added to the sums, or set aside where it
/// contradicts the running solution (zygos_joint_sums_set_aside()). Cost: where joint rows alone determine the
/// estimate, two passes over the sums of the segment and one over the running solution; otherwise those of the checksum
/// of the sums.
void zygos_guard_end_joints(zygos_sums_t *all);

#ifdef __cplusplus
}
#endif
#endif
