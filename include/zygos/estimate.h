/// zygos/estimate.h: what zygos_solve() writes: values, intervals, and how far they can be used.

#ifndef ZYGOS_ESTIMATE_H
#define ZYGOS_ESTIMATE_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// How far an estimate can be used.
enum zygos_validity {
    ZYGOS_REFUSED = 0,  ///< There are no values.
    ZYGOS_DOUBTFUL = 1, ///< There are values, but the reason says why they must not be trusted.
    ZYGOS_PARTIAL = 2,  ///< Some parameters are not identifiable yet; the others have values.
    ZYGOS_VALID = 3     ///< Every parameter has a value and a sigma.
};

/// Why an estimate is not valid.
enum zygos_reason {
    ZYGOS_REASON_NONE = 0,    ///< The estimate is valid.
    ZYGOS_REASON_NO_DATA = 1, ///< Fewer than three accepted instants for each parameter, or too few blocks.
    ZYGOS_REASON_NOT_IDENTIFIABLE =
        2, ///< The motion does not determine every parameter, as rank or sigmas show, or the
           ///< arm is at rest: move every joint, and those most whose parameters are missing.
    ZYGOS_REASON_TOO_FAST =
        3, ///< More than 5 % of the instants failed the bandwidth test: sample faster or move slower.
    ZYGOS_REASON_NOT_PHYSICAL = 4, ///< The bodies' inertia less the rotors' is not positive definite, Im, k or b is not
                                   ///< positive, or a friction or lag is negative, by more than ZYGOS_NEGATIVE_SIGMAS:
                                   ///< wait, or check signs, ratios and the torque law.
    ZYGOS_REASON_CORRUPT = 5,      ///< Row sums or counts do not match: memory was changed. zygos_step() repairs them.
    ZYGOS_REASON_UNCLOSED = 6, ///< The residuals are not noise (ZYGOS_CLUSTER_LIMIT): the balance does not close. Check
                               ///< ratios, zeros, signs and the torque law; friction that is not configured as an
                               ///< effect and torques on the base have the same result.
    ZYGOS_REASON_DECLARED = 8, ///< The declared noise is not in the data (ZYGOS_NOISE_ABSENT): declare the actual one.
    ZYGOS_REASON_NOISE = 7,   ///< Noise is as large as the motion in some combination (ZYGOS_MIN_SIGNAL_TO_NOISE): move
                              ///< more, or declare the actual noise of the sensors.
    ZYGOS_REASON_CHANGED = 9, ///< Several consecutive newest arcs contradict the values (guard.h), which are those
                              ///< before a change, or an arc differed from those before, and the values are of both:
                              ///< call zygos_restart(). Where a sensor fails for a while, the first disappears when
                              ///< arcs agree again.
    ZYGOS_REASON_UNEXPLAINED = 10, ///< The residuals are not noise, and exceed ZYGOS_UNEXPLAINED_LIMIT: see
                                   ///< ZYGOS_REASON_UNCLOSED; more motion does not help.
    ZYGOS_REASON_GAIN = 11, ///< The gain of a torque sensor differs from what is declared of it (ZYGOS_GAIN_SIGMAS):
                            ///< calibrate it, or declare it as that uncertain (torque_gain_sigma).
    ZYGOS_REASON_OLD = 12   ///< No row was added for longer than an arc: the values are of the arm as it was then.
};

/// The kinds of rows, each with arcs of its own. Where joint rows alone determine the estimate, they have the place of
/// the energy rows.
enum zygos_rows { ZYGOS_ENERGY_ROWS = 0, ZYGOS_MOTOR_ROWS = 1, ZYGOS_MOMENTUM_ROWS = 2, ZYGOS_KINDS_OF_ROWS = 3 };

/// Where a solution is (zygos_t.stage). The background moves it from idle to asked and from given to solved, the task
/// moves it on. Each bit is there three times, two places apart, and is what two of them say.
enum zygos_stage {
    ZYGOS_STAGE_IDLE = 0,
    ZYGOS_STAGE_ASKED = 21, ///< The task copies the sums.
    ZYGOS_STAGE_GIVEN = 42, ///< The copy belongs to the background.
    ZYGOS_STAGE_SOLVED = 63 ///< The estimate waits to be adopted.
};

/// An estimate of all parameters.
typedef struct {
    uint64_t cycle;    ///< SYNC number of the newest cycle in the sums.
    uint64_t accepted; ///< Number of instants in the sums.
    uint64_t refused;  ///< Number of instants that failed the bandwidth test.
    uint64_t since; ///< 0, or only arcs after this cycle were used, because older ones were bad (zygos_work_solve()).
    uint32_t parameters; ///< p.
    uint32_t validity;   ///< enum zygos_validity.
    uint32_t reason;     ///< enum zygos_reason.
    uint32_t arcs;       ///< Number of arcs in the sums, including the open one; segments, of joint rows alone.
    uint32_t blocks;     ///< Number of blocks from which the sigmas are computed; groups, of joint rows alone.
    uint32_t rank;       ///< Number of independent columns.
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS]; ///< Number of excluded arcs, by enum zygos_rows, including open ones.
    uint32_t consecutive;                   ///< Number of consecutive newest arcs of energy rows that were excluded.
    uint32_t changed;  ///< 1: an arc differed from those before by more than noise, and these are in the sums (doubtful
                       ///< with ZYGOS_REASON_CHANGED, by zygos_solve() alone).
    uint32_t restored; ///< 1: some of the sums are of a stored state (zygos_resume()).
    uint64_t unused;   ///< Number of SYNCs since a row was added last (zygos_solve() alone tells).
    double condition;  ///< 1-norm condition of the scaled normal matrix of the independent columns.
    double cluster;    ///< The statistic of ZYGOS_CLUSTER_LIMIT: around 1 for noise, at most the instants of a block.
    double residual;   ///< Root mean square of W - row . x without the constants of the arcs [J]; where joint rows
                       ///< alone are solved, of these [Nms], divided by the torque's deviation if all are declared.
    double noise_ratio; ///< Square of residual over the share of the declared noise in it; NaN where none is declared.
    double signal_to_noise; ///< The ratio of ZYGOS_MIN_SIGNAL_TO_NOISE; infinite where no noise is declared.
    uint32_t identifiable[ZYGOS_MAX_PARAMETERS]; ///< 1; or 0, and value and sigma are NaN.
    /// The least squares solution for all columns, 0 for dependent columns; NaN when refused. As a whole it predicts
    /// the energy of motions like those that it was estimated from. A single entry is meaningful only where value has
    /// it, too.
    double solution[ZYGOS_MAX_PARAMETERS];
    double value[ZYGOS_MAX_PARAMETERS];
    double sigma[ZYGOS_MAX_PARAMETERS];  ///< One standard deviation: scatter of the blocks, a floor that does not
                                         ///< average out (ZYGOS_SYSTEMATIC), and the noise of the torques (balance.h).
    double half95[ZYGOS_MAX_PARAMETERS]; ///< Half width of the 95 % interval: sigma times Student's factor for the
                                         ///< effective number of blocks of the parameter.
    double covariance[ZYGOS_MAX_PACKED]; ///< Lower triangle by rows, of all that is in sigma; NaN where a parameter has
                                         ///< no value. Positive semi-definite among those that have one.
} zygos_estimate_t;

#ifdef __cplusplus
}
#endif
#endif
