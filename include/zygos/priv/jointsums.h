/* SPDX-License-Identifier: MIT */
/// zygos/priv/jointsums.h: accumulates the normal equations of the joint rows in interleaved groups.
///
/// The rows of all joints are added to one matrix. Each is divided by the standard deviation of its joint's torque
/// noise, if that is declared for every joint; otherwise all have the same weight. Joint rows have no constants:
/// nothing is centred. Consecutive increments fill a segment; a segment that is complete is added to group s % R, s
/// being its number, and the standard deviations come from the scatter of the R groups. Groups of interleaved segments
/// have seen the same motions, which neighbouring blocks have not.
///
/// The rows of an increment wait until all are formed. The cycles up to the next ones add them to the segment, two rows
/// at a time and so many entries of the matrix in each cycle.
///
/// There are two buffers for segments. While one is filled, the other one is added to its group and cleared, the same
/// number of entries in every cycle, so that it is empty when the first one is complete. The bias by the noise of the
/// rates (joint.h) is summed beside the rows, one signal for each increment in turn with a weight that is larger in
/// proportion, and subtracted from the segment when it is added.
///
/// Whether the residuals are noise is seen by how they add up: of each joint the sum of the rows of a segment, s, is
/// kept as the matrix sum of s s^T / (2 rows). Rows that share halves, of torque noise without correlation, give the
/// same mean square there as in the rows themselves; an error that persists gives one that is larger in proportion to
/// the length of a segment.
///
/// Forgetting multiplies a group when the next segment is added to it, and the solver does the rest. A void cycle
/// (cycle.h) drops the segments that are not being added yet; those that are, stay and are counted.
///
/// Where joint rows alone determine the estimate, a complete segment is compared with the running solution (guard.h).
/// Segments that contradict it are added to a group of their own, from which no estimate is made:
/// zygos_detect_change() compares it with the others.

#ifndef ZYGOS_JOINTSUMS_H
#define ZYGOS_JOINTSUMS_H

#include "../types.h"
#include "joint.h"
#include "smoother.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The least number of increments in a segment, and its least length.
#define ZYGOS_SEGMENT_INCREMENTS 16u
#define ZYGOS_SEGMENT_S 2.0

/// The length of a joint row that is augmented by the right side. With ZYGOS_JOINT_ROWS = 0 there is no memory for
/// rows.
#if ZYGOS_JOINT_ROWS
#define ZYGOS_MAX_JOINT_ROW (ZYGOS_MAX_PARAMETERS + 1)
#define ZYGOS_GROUP_PLACES ZYGOS_JOINT_GROUPS
#else
#define ZYGOS_MAX_JOINT_ROW 1
#define ZYGOS_GROUP_PLACES 1
#endif
#define ZYGOS_MAX_PACKED_JOINT (ZYGOS_MAX_JOINT_ROW * (ZYGOS_MAX_JOINT_ROW + 1) / 2)

/// The group of the segments that contradict, behind those of the estimate.
#define ZYGOS_SET_ASIDE ZYGOS_GROUP_PLACES

/// Sum of z z^T with z = [columns, impulse], lower triangle by rows, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_JOINT];
    double sum[ZYGOS_MAX_JOINT_ROW];
} zygos_joint_gram_t;

/// Rows that wait: those of two joints side by side, and 0 where there is one joint less.
#define ZYGOS_JOINT_PAIRS ((ZYGOS_JOINT_PLACES + 1) / 2)
typedef struct {
    double pair[ZYGOS_JOINT_PAIRS][ZYGOS_MAX_JOINT_ROW][2];
    double total[ZYGOS_JOINT_PAIRS][2]; ///< Sum of the entries of each row.
} zygos_joint_wait_t;

/// A segment that is being filled, or added to its group.
typedef struct {
    zygos_joint_gram_t rows;
    zygos_joint_gram_t noise;                              ///< Expected products of noise.
    double joint[ZYGOS_JOINT_PLACES][ZYGOS_MAX_JOINT_ROW]; ///< Sums of each joint's rows.
    double count[ZYGOS_JOINT_PLACES];                      ///< Number of accepted rows of each joint.
} zygos_joint_segment_t;

/// The normal equations of the joint rows. The checksum is of what is between filling and it.
typedef struct {
    uint32_t width;                          ///< Length of a row, p + 1; 0 where the configuration has no such rows.
    uint32_t increments;                     ///< Number of increments in a segment.
    uint32_t slice;                          ///< Number of entries that are added to the group in each cycle.
    uint32_t share;                          ///< Number of entries to which two rows that wait are added in each cycle.
    double weight[ZYGOS_MAX_JOINTS];         ///< Factor of each joint's rows [1/Nm, or 1].
    double deviation[ZYGOS_MAX_JOINTS + 3];  ///< Of each signal, times the root of 2 and of their number [rad/s].
    double rotor_variance[ZYGOS_MAX_JOINTS]; ///< Of the rate of each rotor with a spring, times 2 [rad^2/s^2].
    uint32_t filling;                        ///< Index of the buffer that is filled.
    uint32_t target;                         ///< The group to which the other one is added.
    uint64_t segments; ///< Number of segments that were complete, without those that were set aside.
    uint64_t end;      ///< Number of the newest cycle in a complete segment.
    double keep;       ///< Factor by which noise and joints are multiplied when the segment is added.
    double keep_group; ///< And its group.
    double joint_sums; ///< Number of sums in joints, weighted as they are.
    double count[ZYGOS_GROUP_PLACES + 1]; ///< Number of rows in each group, weighted as the rows are.
    double fade[ZYGOS_GROUP_PLACES + 1];  ///< Factor by which the group is multiplied when it is used or added to.
    uint64_t checksum;
    uint64_t accepted; ///< Number of accepted instants.
    uint64_t refused;  ///< Number of instants that the bandwidth test refused.
    uint32_t corrupt;  ///< 1: what is under the checksum did not match it, and no single bit explains that.
    uint32_t adding;   ///< 1: entries of the other one are added to its group; 2: the sums of its joints' rows.
    uint32_t cursor;   ///< Number of its entries that were added.
    uint32_t filled;   ///< Number of increments in the segment that is filled.
    uint32_t turn;     ///< The signal whose noise is added to the rows of this increment.
    uint32_t dropped;  ///< Number of segments that were dropped because of void cycles.
    uint32_t doubtful; ///< Number of segments that contain void cycles and could not be dropped.
    uint32_t joint;    ///< Number of its joints whose sums were added.
    uint32_t
        quarantined;  ///< Groups and segments that were dropped since the last zygos_arm_scrub(): memory was changed.
    uint32_t waiting; ///< Number of rows that wait.
    uint32_t pass;    ///< The next two of them that are added, those of noise behind those of rows.
    uint32_t row;     ///< The next row of the matrix that they are added to.
    zygos_joint_gram_t noise;   ///< Noise that was subtracted.
    zygos_joint_gram_t joints;  ///< Sum of s s^T / (2 rows).
    zygos_joint_wait_t wait[2]; ///< Of rows, and of their noise.
    zygos_joint_segment_t segment[2];
    zygos_joint_gram_t group[ZYGOS_GROUP_PLACES + 1]; ///< The segments that were added to it, without their noise. The
                                                      ///< last one is that of ZYGOS_SET_ASIDE.
} zygos_joint_sums_t;

/// Returns whether the joint rows alone determine the estimate: the base is fixed and no joint has a spring. The noise
/// of torques adds up in the work of the motors, so that energy rows would contradict good estimates there.
bool zygos_joint_sums_suffice(const zygos_config_t *config);

/// Returns the number of instants in a segment whose increments were all accepted.
uint32_t zygos_joint_sums_longest(const zygos_config_t *config);

/// Returns the mean square that the declared noise of the torques has in a row, which is independent in each period.
/// Needs the tables.
double zygos_joint_sums_torque_noise(const zygos_joint_sums_t *self, const zygos_config_t *config);

/// Computes what follows from the configuration: width, segments, weights and noise. The sums are not changed. Needs a
/// checked configuration.
void zygos_joint_sums_tables(zygos_joint_sums_t *self, const zygos_config_t *config,
                             const zygos_column_map_t *column_map, const zygos_smoother_t *smoother);

/// Returns whether every index and count is possible for a checked configuration. The other functions rely on that and
/// do not check it. Cost: a few comparisons for each group.
bool zygos_joint_sums_intact(const zygos_joint_sums_t *self, const zygos_config_t *config,
                             const zygos_column_map_t *column_map);

/// Clears the sums. Needs the tables.
void zygos_joint_sums_clear(zygos_joint_sums_t *self);

/// Counts an instant, accepted (1) or not (0), and adds the next entries of a complete segment to its group, and rows
/// that wait to the segment that is filled. Call it in each cycle with an instant. row: this cycle also forms a row;
/// rows that wait stay, and updates wait for a cycle that does not, where there are enough of them. Returns whether the
/// segment that is filled is complete; then zygos_guard_end_joints() must follow. Cost: slice entries, or one update of
/// p + 1 columns, for at most the time that the next segment takes; share entries of two products where rows wait.
bool zygos_joint_sums_step(zygos_joint_sums_t *self, const zygos_config_t *config, double accepted, bool row);

/// A row, and the noise of the signal whose turn it is, wait from here on. Cost: the reduction of two rows. Where rows
/// wait of an increment whose end a gap has lost, they are added at once.
void zygos_joint_sums_add(zygos_joint_sums_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                          const zygos_joint_t *joint, const zygos_joint_row_t *row);

/// Returns the number of rows in the segment that is filled, with those that wait, or in the groups of the estimate.
double zygos_joint_sums_open_rows(const zygos_joint_sums_t *self, const zygos_config_t *config);
double zygos_joint_sums_rows(const zygos_joint_sums_t *self);

/// Ends the segment that is filled: from here on it is added to the group whose turn it is, and the other one, which
/// must be empty, is filled. cycle: number of the newest cycle. *forgetting: product of the forgetting factors since
/// the last segment; it is set to 1. Cost: the checksum.
void zygos_joint_sums_admit(zygos_joint_sums_t *self, const zygos_config_t *config, uint64_t cycle, double *forgetting);

/// The same of a segment that contradicts: it is added to the group of those. anew: it replaces what is there.
void zygos_joint_sums_set_aside(zygos_joint_sums_t *self, const zygos_config_t *config, uint64_t cycle,
                                double *forgetting, bool anew);

/// Adds rows that wait to the segment that is filled, and the one that has ended to its group, at once. Cost: a pass
/// over the sums of a segment for each two rows, and one more.
void zygos_joint_sums_flush(zygos_joint_sums_t *self, const zygos_config_t *config);

/// Drops the segment that is filled, because it contains cycles after the given one. Cost: one pass over it.
void zygos_joint_sums_drop_after(zygos_joint_sums_t *self, uint64_t cycle);

/// Returns whether the places and counts that each cycle uses are possible. Cost: a few comparisons.
bool zygos_joint_sums_steady(const zygos_joint_sums_t *self, const zygos_config_t *config);

/// Adds the rows that wait, and drops each group, and the segment that is filled, where the row sums do not match.
/// Returns false when anything else does not match: then clear the sums. Needs the tables. Cost: one pass over the
/// sums, and one over those of a segment for each two rows that wait.
bool zygos_joint_sums_scrub(zygos_joint_sums_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map);

/// Returns whether all sums match their row sums and checksums. Needs zygos_joint_sums_intact() and
/// zygos_joint_sums_flush().
bool zygos_joint_sums_is_whole(const zygos_joint_sums_t *self);

#ifdef __cplusplus
}
#endif
#endif
