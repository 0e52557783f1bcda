/// zygos/solver.h: from normal equations to parameters, sigmas and a verdict.
///
/// Columns are scaled to unit length, then factorised by Cholesky with symmetric pivoting. Columns that are linear
/// combinations of others leave the factorisation; they and every parameter they can be exchanged for are "not
/// identifiable yet" and have no value. What the declared noise adds to the equations is taken off (noise.h); when the
/// residuals are smaller than that noise, as much less. Sigmas come from solving again with one block left out at a
/// time, because neighbouring rows share noise and s^2 A^-1 would be far too small; what noise that nobody declared may
/// hide is added to them, and what may be the same in every arc is kept, however long the run (ZYGOS_SYSTEMATIC).

#ifndef ZYGOS_SOLVER_H
#define ZYGOS_SOLVER_H

#include "accumulator.h"
#include "guard.h"
#include "jointsums.h"
#include "momentumsums.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

enum zygos_validity {
    ZYGOS_REFUSED = 0,  ///< No values.
    ZYGOS_DOUBTFUL = 1, ///< Values exist, but reason says why not to trust them.
    ZYGOS_PARTIAL = 2,  ///< Some parameters are not identifiable yet; the others have values.
    ZYGOS_VALID = 3     ///< Every parameter has a value and a sigma.
};

enum zygos_reason {
    ZYGOS_REASON_NONE = 0,
    ZYGOS_REASON_NO_DATA = 1, ///< Fewer accepted instants than three a parameter, or fewer than ZYGOS_MIN_BLOCKS.
    ZYGOS_REASON_NOT_IDENTIFIABLE = 2, ///< The motion so far does not determine every parameter: rank or sigmas say so.
    ZYGOS_REASON_TOO_FAST = 3,         ///< More than 5 % of the instants failed the bandwidth test.
    ZYGOS_REASON_NOT_PHYSICAL = 4,     ///< The bodies' inertia less the rotors' is not positive definite, Im, k or b is
                                       ///< not positive, or a friction or lag is negative, by more than
                                       ///< ZYGOS_NEGATIVE_SIGMAS.
    ZYGOS_REASON_CORRUPT = 5,          ///< Row sums or counts do not match: memory was changed, or never taken.
    ZYGOS_REASON_UNCLOSED = 6,         ///< What the solution leaves over is no noise: see ZYGOS_CLUSTER_LIMIT.
    ZYGOS_REASON_DECLARED = 8,         ///< The declared noise is not in the data: see ZYGOS_NOISE_ABSENT.
    ZYGOS_REASON_NOISE = 7,   ///< Noise is as large as the motion in some combination: see ZYGOS_MIN_SIGNAL_TO_NOISE.
    ZYGOS_REASON_CHANGED = 9, ///< The newest arcs contradict the values, several in a row: see guard.h.
    ZYGOS_REASON_UNEXPLAINED = 10 ///< What the solution leaves over is no noise, and more than a share of the
                                  ///< work: see ZYGOS_UNEXPLAINED_LIMIT.
};

/// A parameter whose scaled pivot falls below this share is a combination of the others.
#define ZYGOS_PIVOT_LIMIT 1e-11
/// Smallest ratio of the sums to the noise in them, over all combinations of columns. At 1 they are noise. Below this
/// limit only half of the sums' least combination is taken off, and values that this changes by more than the limits
/// for sigma are withheld.
#define ZYGOS_MIN_SIGNAL_TO_NOISE 2.0
/// When the residuals' square is less than this share of the declared noise, the declaration is too large, and as much
/// of it is believed as the residuals show.
#define ZYGOS_OVERDECLARED 0.6
/// Below this share the declaration is wrong by so much that what it took off the rows themselves cannot be trusted.
#define ZYGOS_NOISE_ABSENT 0.1
/// The residuals beyond the declared noise tell how much more the columns may hold. When its square, per scaled column,
/// exceeds this share of what the motion puts into the combination of columns that it excites least, it makes that
/// combination, and with it the values. Below that, what as much noise again changes is added to the sigmas.
#define ZYGOS_NOISE_LIMIT 1.0
/// When more than this share of the work's variance is left over, nothing has a value: the rows are noise (an arm at
/// rest: not identifiable), or, where what is left over adds up as noise does not, another arm's (unexplained).
#define ZYGOS_UNEXPLAINED_LIMIT 0.1
/// Noise in the rows forgets within a few instants, so the residuals of a block add up like the square root of their
/// number, or less: the mean of (sum)^2 / (instants * mean square) over the blocks is around 1. When it exceeds this
/// limit, and what adds up is more than ZYGOS_CLUSTER_SHARE of the work's spread, the balance does not close: a wrong
/// gear ratio, zero, sign or torque law, an effect that is not switched on, noise of the torques, a torque on the base.
#define ZYGOS_CLUSTER_LIMIT 5.0
#define ZYGOS_CLUSTER_SHARE 5e-3
/// Where the balance closes by that share alone, sigmas allow for a residual that all blocks have in common: of what
/// adds up beyond this, which noise does not reach.
#define ZYGOS_CLUSTER_NOISE 1.0
/// What the declared noise does not explain of the residuals' square may be the same in every arc: what the smoother
/// makes of fast motion, for one. So beside the scatter of the blocks, which falls with their number, sigmas keep what
/// that share of the scatter would be after a single arc of arc_cycles instants: cov = scatter (1 + share instants /
/// arc_cycles). The share is at least this, for no deviation is declared exactly, and products of noise with itself
/// that are neglected (noise.h) leave no trace in the residuals.
#define ZYGOS_SYSTEMATIC 0.05
/// A parameter whose sigma exceeds this share of its size is not identifiable yet. The size is the value; of a kinetic
/// parameter, if larger, the root of the product of the two diagonal ones that it couples, and of a first moment the
/// largest of them. Effects are exempt: an effect may be zero.
/// When the rank is full all the same, the error of the one is in the others: their sigmas are widened by what leaving
/// it out changes, and beside it the second, smaller share holds.
#define ZYGOS_SIGMA_LIMIT 0.25
#define ZYGOS_SIGMA_LIMIT_BESIDE 0.025
/// Deviation of the newest arc from all before it, in standard deviations, that is no accident.
#define ZYGOS_CHANGE_ALARM 6.0
/// Blocks that the arcs before the newest one must fill: the spread of fewer makes false alarms.
#define ZYGOS_CHANGE_MIN_BLOCKS 8u
/// What cannot be negative may be zero, and come out negative by as many sigmas.
#define ZYGOS_NEGATIVE_SIGMAS 3.0

typedef struct {
    uint64_t cycle;      ///< SYNC number of the newest cycle that went in.
    uint64_t accepted;   ///< Instants that went in.
    uint64_t refused;    ///< Instants that failed the bandwidth test.
    uint64_t since;      ///< 0, or older arcs spoil the sums: only those behind this cycle went in (zygos_solve()).
    uint32_t parameters; ///< p.
    uint32_t validity;   ///< enum zygos_validity.
    uint32_t reason;     ///< enum zygos_reason.
    uint32_t arcs;       ///< Arcs that went in, the open one included.
    uint32_t blocks;     ///< Blocks behind the sigmas.
    uint32_t rank;       ///< Independent columns.
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS]; ///< Arcs that contradicted, by enum zygos_rows, the open ones included.
    uint32_t consecutive; ///< Of those of the energy rows the newest that no arc that agrees lies between.
    double condition;     ///< 1-norm condition of the scaled normal matrix of the independent columns.
    double cluster;     ///< How far the residuals of a block add up: around 1 for noise, up to its instants otherwise.
    double residual;    ///< Root mean square of W - row . x about the arc constants [J].
    double noise_ratio; ///< Its square over what the declared noise makes of it; NaN where none is declared.
    double signal_to_noise; ///< Smallest ratio of sums to noise (ZYGOS_MIN_SIGNAL_TO_NOISE); infinite where none is
                            ///< declared.
    uint32_t identifiable[ZYGOS_MAX_PARAMETERS]; ///< 1, or 0 and value and sigma are NaN.
    /// The least squares solution for all columns, dependent ones 0; NaN when refused. As a whole it predicts the
    /// energy of motions like those it came from. One of its entries means something by itself only where value has it
    /// too.
    double solution[ZYGOS_MAX_PARAMETERS];
    double value[ZYGOS_MAX_PARAMETERS];
    double sigma[ZYGOS_MAX_PARAMETERS];  ///< One standard deviation: scatter of the blocks, and a floor that no length
                                         ///< of the run averages out (ZYGOS_SYSTEMATIC).
    double half95[ZYGOS_MAX_PARAMETERS]; ///< Half width of the 95 % interval: sigma times Student's factor for as many
                                         ///< blocks as the parameter's information really comes from.
    double covariance[ZYGOS_MAX_PACKED]; ///< Lower triangle row by row, the floor in all of it; NaN where a parameter
                                         ///< has no value.
} zygos_estimate_t;

/// A copy of the sums and room to calculate in. Filled by zygos_take(), consumed by zygos_solve(). Belongs to the task
/// that solves; none of it is meant to be read.
typedef struct {
    zygos_accumulator_t accumulator;
    zygos_joint_sums_t joint_sums;
    zygos_momentum_sums_t momentum_sums;
    zygos_guard_t guard;
    uint64_t cycle;
    uint32_t arc; ///< Instants of the open arc of the energy rows.
    uint32_t reserved;
    zygos_config_t config;
    zygos_column_map_t column_map;
    double total[ZYGOS_MAX_PACKED_ROW]; ///< All rows, weighted, the noise taken off.
    double noise[ZYGOS_MAX_PACKED_ROW]; ///< The noise that was.
    double matrix[ZYGOS_MAX_PACKED];
    double factor[ZYGOS_MAX_PACKED];
    double scale[ZYGOS_MAX_PARAMETERS];
    double right_side[ZYGOS_MAX_PARAMETERS];
    double solution[ZYGOS_MAX_PARAMETERS];
    double size[ZYGOS_MAX_PARAMETERS];
    double noise_shift[ZYGOS_MAX_PARAMETERS];
    double score[ZYGOS_MAX_PARAMETERS];
    double leave_one_out[ZYGOS_MAX_BLOCKS + ZYGOS_MAX_JOINT_BLOCKS + ZYGOS_MOMENTUM_PLACES][ZYGOS_MAX_PARAMETERS];
    double weight[ZYGOS_MAX_JOINTS];      ///< Of each joint's motor rows beside the energy rows.
    double momentum_weight;               ///< Of the momentum rows beside the energy rows.
    double inverse[ZYGOS_MAX_PARAMETERS]; ///< Diagonal of the inverse of the scaled matrix.
    double information[2][ZYGOS_MAX_PARAMETERS];
    double degrees_of_freedom[ZYGOS_MAX_PARAMETERS];
    double linearised_variance[ZYGOS_MAX_PARAMETERS];
    double linearised[ZYGOS_MAX_PARAMETERS];
    double spread; ///< Sum of the squared work about the arc constants [J^2].
    struct {
        uint32_t first;
        uint32_t end;
    } blocks, arcs, momenta; ///< Blocks of the energy, the motor and the momentum rows that are looked at.
    double instants;         ///< Accepted instants of the first.
    double noise_fraction;   ///< Their share of the noise of closed arcs.
    double noise_scale;      ///< Share of the declared noise that is taken off.
    uint32_t pivot[ZYGOS_MAX_PARAMETERS];
} zygos_work_t;

/// Solves. Reads and changes *work, writes *out; touches nothing else. Where estimates are adopted (zygos_adopt()) and
/// the sums do not give a valid one because more is left over than noise leaves, it is tried without the oldest quarter
/// and the older half of the arcs; the first of these that is valid, and leaves far less over, is the answer, with
/// out->since. Cost: (2 blocks + 4) Cholesky factorisations of order p at the most, and where arcs are left out in
/// turns up to four times as many. Returns 1 when there are values, 0 when validity is ZYGOS_REFUSED, or ZYGOS_E_NULL.
int zygos_solve(zygos_work_t *work, zygos_estimate_t *out);

/// Whether sums and counts that were taken are those that were accumulated: where this is false, zygos_solve() answers
/// ZYGOS_REASON_CORRUPT. Reads and changes *work, as zygos_solve() does: take anew for each. Cost: a few passes over
/// the sums, and none of the factorisations.
bool zygos_work_intact(zygos_work_t *work);

/// Compares the newest arc with all that came before it. An arc with fewer than half the instants of the longest does
/// not speak for itself: it counts with those before it, until several such have as many together. Fills *out with what
/// was known before (until out->cycle; sigmas by the scatter alone, for what all arcs have in common is in both sides
/// of the comparison), and deviation[ZYGOS_MAX_PARAMETERS] with how far the newest arc's own value lies from that, in
/// standard deviations of the difference (from half95). Needs ZYGOS_CHANGE_MIN_BLOCKS blocks before the newest
/// arc, which a build with ZYGOS_MAX_BLOCKS of 32 and more keeps, and one of 8 never has. ZYGOS_CHANGE_ALARM and beyond
/// is a change of the arm where the balance closes on both sides (validity ZYGOS_VALID). Where it does not close on one
/// of them (ZYGOS_DOUBTFUL for ZYGOS_REASON_UNCLOSED; cluster is the larger of the two), it may as well be an effect
/// that no column describes, friction say, in a motion that was another: then the deviation is no proof of a change.
/// While the arcs that are compared hold the arm before and after it, it may name more than has changed. Call it twice
/// an arc: when the next arc speaks, the changed one is among those before. The open arc is looked at even if it
/// contradicts the running solution (guard.h); where there is one, a newest arc that no arm explains, for what its own
/// solution leaves is unusual, is no change. Reads and changes *work, as zygos_solve() does: take anew for each.
/// Returns 1; 0 when all deviations are NaN, because before (validity is then ZYGOS_REFUSED) or within the newest arc
/// something is not identifiable or not explained; or ZYGOS_E_NULL.
int zygos_detect_change(zygos_work_t *work, zygos_estimate_t *out, double *deviation);

#ifdef __cplusplus
}
#endif
#endif
