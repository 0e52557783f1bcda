/* SPDX-License-Identifier: MIT */
/// zygos/refine.h: the filter of refiner.h as a task on board, in slices of bounded work.
///
/// zygos_refine() (zygos.h) attaches it to an arm, and the other calls do all that follows. A task of its own begins
/// with a valid estimate of zygos_solve() and refines it with every further cycle:
///
///     static zygos_refine_t fine;                           // apart from zygos_arm_t: who does not refine needs none
///     zygos_refine_init(&fine, &arm.config, &settings);     // once
///     zygos_refine_start(&fine, &arm.config, &estimate, NULL);  // with a valid estimate; again after a failure
///     zygos_refine_cycle(&fine, zygos_receiver_front(&arm.receiver));  // before each zygos_arm_step(), in its task
///     while (zygos_refine_step(&fine, &arm.config) == 1) { }  // any task, at any priority: one slice a call
///     zygos_refine_judge(&fine, &arm.config, &estimate, &refined);  // the same task, with each new estimate
///
/// The state of the arm is followed through every cycle. The covariance is moved, and readings are used, in every cycle
/// or in every few (settings.every): then torques and readings are averaged over these cycles, and derivatives are
/// taken at their middle. Where one of these cycles was lost, the newest readings are used instead of the means.
///
/// A filter cannot tell whether its model is complete. The estimate from energy rows is therefore the start of the
/// refined one, and stays what is published unless all conditions of enum zygos_refine_reason hold.

#ifndef ZYGOS_REFINE_H
#define ZYGOS_REFINE_H

#include "priv/cycle.h"
#include "priv/refiner.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The most cycles that may be missing without a restart of the state: over more, the torques are not known well
/// enough.
#define ZYGOS_REFINE_GAP 20u
/// Successive readings from which the state begins.
#define ZYGOS_REFINE_BEGINNING 4u
/// Columns of derivatives or of the root in one slice.
#define ZYGOS_REFINE_COLUMNS 4u
/// The ratio of an innovation is its normalised square divided by this. Above a ratio of 1 the reading is not used.
#define ZYGOS_REFINE_GATE 25.0
/// Windows that have to end after the start, and windows as expected that have to follow each one that is not,
#define ZYGOS_REFINE_CALM 4u
/// but not more than so many. A model that is wrong has windows that look right now and then.
#define ZYGOS_REFINE_LONGEST 20u
/// The first windows, of which only the newest that is not as expected counts: the filter has yet to settle.
#define ZYGOS_REFINE_SETTLING 8u
/// By which the mean normalised square of a window may exceed 1 beside 3 standard errors.
#define ZYGOS_REFINE_EXCESS 0.1
/// Standard errors that the level and the innovations are allowed.
#define ZYGOS_REFINE_SIGMAS 3.0
/// Standard deviations that the distance of estimates is allowed: the largest of many parameters is beyond 3 by chance.
#define ZYGOS_REFINE_APART_SIGMAS 4.0
/// Share by which the level may exceed 1 beside these: no deviation is declared exactly, and many readings tell the
/// level to a thousandth.
#define ZYGOS_REFINE_LOUDER 0.05
/// Share of a parameter's size by which the estimate from energy rows may be off beside its interval.
#define ZYGOS_REFINE_BIAS 0.002
/// The largest level that passes where no noise in proportion to the torques is declared: so much the filter takes for
/// noise that is its own error of linearisation.
#define ZYGOS_REFINE_STEPS 30.0

/// Why the refined values are not published.
enum zygos_refine_reason {
    ZYGOS_REFINE_NONE = 0,        ///< They are.
    ZYGOS_REFINE_WAITS = 1,       ///< There was no zygos_refine_start(), or too few readings since.
    ZYGOS_REFINE_ENERGY = 2,      ///< The estimate from energy rows, which has to vouch for them, has no values.
    ZYGOS_REFINE_FAILED = 3,      ///< The filter left the possible arms. Only a new start helps.
    ZYGOS_REFINE_INNOVATIONS = 4, ///< Innovations of a channel are larger than noise, or many readings were rejected.
    ZYGOS_REFINE_LEVEL = 5,       ///< The torques need more noise than is declared.
    ZYGOS_REFINE_APART = 6,       ///< The estimate from energy rows contradicts them.
    ZYGOS_REFINE_PHYSICAL = 7,    ///< A stiffness, a damping or a rotor is not positive.
    ZYGOS_REFINE_CORRUPT = 8      ///< Memory was changed from outside. Only a new start helps.
};

/// What the task has to know besides the configuration.
typedef struct {
    zygos_refiner_settings_t filter; ///< size is not read: zygos_refine_start() computes it.
    uint32_t every;                  ///< Cycles from one use of readings to the next, 1..1000.
    uint32_t terms;                  ///< Of the exponential series of the derivatives over these cycles, 2..20.
    uint32_t window;                 ///< Uses of readings that are judged together, 20..100000.
    uint32_t apart;                  ///< Cycles between the readings with which the state begins, 1..1000.
    double bias_sigma;               ///< Of the gyro before the first reading [rad/s], >= 0.
    double beside_sigma[5 * ZYGOS_MAX_JOINTS]; ///< Of friction, offsets [Nm], gains and zeros [rad] before the first,
                                               ///< >= 0: as many as the filter estimates, in its order. Their values
                                               ///< begin at 0.
} zygos_refine_settings_t;

/// Everything about the task. The program may read the members; only the functions below change them. Where the task
/// waits for a cycle, each member is under a seal or is written before it is read; between the slices of a cycle, sums
/// and a part of the scratch are not.
typedef struct {
    uint32_t magic;    ///< Of a task that zygos_refine_init() has prepared.
    uint32_t reserved; ///< 0.
    zygos_refiner_t filter;
    zygos_refine_settings_t settings;
    zygos_queue_t queue; ///< zygos_refine_cycle() writes its head, zygos_refine_step() its tail.
    uint64_t overrun;    ///< Cycles since init that found the queue full.
    zygos_previous_cycle_t previous;
    zygos_refiner_work_t work; ///< Kept from slice to slice.
    uint32_t started;          ///< 1: there was a zygos_refine_start().
    uint32_t moving;           ///< 1: the state is known.
    uint32_t phase;            ///< The kind of work that is next.
    uint32_t cursor;           ///< In the phase.
    uint32_t beginning;        ///< Readings with which the state begins that were taken.
    uint32_t since;            ///< Cycles since the last of them.
    uint32_t intervals;        ///< SYNC periods from the newest cycle but one to the newest.
    uint32_t interval;         ///< The one that is being worked on.
    uint32_t group;            ///< Cycles since the covariance was moved.
    uint32_t lost_lately;      ///< 1: one of them was lost.
    uint32_t windows;          ///< That have ended since the start.
    uint32_t awaited;          ///< Windows as expected without which nothing is published.
    uint64_t corrupt;          ///< 1: memory errors have ended the refinement, and only a new start helps.
    uint64_t sync;             ///< Of the newest cycle that was taken.
    uint64_t used;             ///< Uses of readings since the start.
    uint64_t lost;             ///< Cycles since init that did not arrive and were bridged.
    uint64_t restarts;         ///< Times since init that the state began anew.
    uint64_t rejected;         ///< Readings since init that were rejected.
    uint64_t spoiled;          ///< Cycles since init that memory errors changed in the queue; they count as lost.
    uint64_t abandoned;        ///< Refinements since init that memory errors ended.
    double angle[ZYGOS_REFINE_BEGINNING][2 * ZYGOS_MAX_JOINTS];
    double signal[ZYGOS_MAX_SIGNALS];    ///< Readings of the newest cycle.
    double before[ZYGOS_MAX_JOINTS];     ///< Torque that was reported with the cycle before,
    double after[ZYGOS_MAX_JOINTS];      ///< and with the newest.
    double tau[ZYGOS_MAX_JOINTS];        ///< That acts in the interval.
    double walk;                         ///< Mean square of the steps of the torques [Nm^2].
    double mean[ZYGOS_MAX_JOINTS];       ///< Sum of the torques since the covariance was moved,
    double variance[ZYGOS_MAX_JOINTS];   ///< and of the variances of their declared noise,
    double missing;                      ///< and of what was not received.
    double middle[ZYGOS_MAX_MOVING];     ///< State at the middle of these cycles.
    double readings[ZYGOS_MAX_READINGS]; ///< Sum of their readings,
    double expected[ZYGOS_MAX_READINGS]; ///< and of what the state says of them.
    double level;                        ///< Factor of the declared noise of the torques.
    double information;                  ///< About twice its logarithm.
    double score; ///< Of the window: derivative of the likelihood by twice the logarithm of the level, times 2,
    double share; ///< and the sum of the squared shares that the noise of the torques has in the innovations.
    double count[ZYGOS_KINDS_OF_CHANNEL];   ///< Of the window: readings,
    double square[ZYGOS_KINDS_OF_CHANNEL];  ///< sum of their normalised squares,
    double largest[ZYGOS_KINDS_OF_CHANNEL]; ///< and the largest of them.
    double nis[ZYGOS_KINDS_OF_CHANNEL];   ///< Of the window before: mean normalised square, 1 where all is as expected,
    double ratio[ZYGOS_KINDS_OF_CHANNEL]; ///< and the largest ratio: below 0.5 normal, 1 where one was rejected.
    zygos_propagation_means_t means;
    uint64_t config_seal;   ///< Of the caller's configuration,
    uint64_t settings_seal; ///< of the settings,
    uint64_t tables_seal;   ///< of what follows from both and from the start,
    uint64_t places_seal;   ///< of the counts, places and flags with which a slice addresses memory,
    uint64_t estimate_seal; ///< of the estimate,
    uint64_t sums_seal;     ///< of what is kept from cycle to cycle beside it,
    uint64_t root_seal;     ///< of the root of the covariance,
    uint64_t slopes_seal;   ///< and of the derivatives.
} zygos_refine_t;

/// What is published.
typedef struct {
    uint64_t cycle;                       ///< SYNC number of the newest cycle that was used.
    uint64_t used;                        ///< See zygos_refine_t.
    uint64_t lost;                        ///< See zygos_refine_t.
    uint64_t restarts;                    ///< See zygos_refine_t.
    uint64_t rejected;                    ///< See zygos_refine_t.
    uint64_t spoiled;                     ///< See zygos_refine_t.
    uint64_t abandoned;                   ///< See zygos_refine_t.
    uint32_t parameters;                  ///< p, without effects.
    uint32_t published;                   ///< 1: value and sigma are refined; 0: those of the energy rows.
    uint32_t reason;                      ///< enum zygos_refine_reason.
    uint32_t farthest;                    ///< Index of the value that is farthest from the energy rows.
    double distance;                      ///< Of it, divided by what passes.
    double level;                         ///< Noise of the torques, divided by the declared one.
    double level_error;                   ///< Standard error of its logarithm.
    double nis[ZYGOS_KINDS_OF_CHANNEL];   ///< Of the newest window: mean normalised squared innovation.
    double ratio[ZYGOS_KINDS_OF_CHANNEL]; ///< Of the newest window: largest ratio, as of autopilots.
    double value[ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS]; ///< Parameters [SI]; NaN where there is none.
    double sigma[ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS]; ///< Their standard deviations.
} zygos_refined_t;

/// Writes settings for a configuration: noise of encoders, gyro and torques as it declares them, zeros that are known
/// to a step of the encoder, no friction and no offsets; readings in every cycle up to two joints, and about every 40
/// ms with more, where a use costs much. Set torque_relative_sigma; with friction or offsets, set beside_sigma anew,
/// because those of the zeros come after theirs. Returns 1; ZYGOS_E_NULL; or, with *settings unchanged, ZYGOS_E_JOINTS
/// or ZYGOS_E_PERIOD where these are out of range.
int zygos_refine_defaults(zygos_refine_settings_t *settings, const zygos_config_t *config);

/// Prepares the task. *config must stay as it is, also where the other functions are given a copy: they compare it.
/// Returns 1, or an enum zygos_error, in which case *self cannot be used: ZYGOS_E_NULL; what zygos_arm_init() returns
/// for the configuration; ZYGOS_E_VALUE if a joint is rigid, a setting is out of range, or the gyro does not latch at
/// SYNC; or ZYGOS_E_TORQUE_LAW if torques are sampled. Call it while no other function is running on *self. Cost: one
/// memset, and the constants of the filter.
int zygos_refine_init(zygos_refine_t *self, const zygos_config_t *config, const zygos_refine_settings_t *settings);

/// Begins with an estimate: twice its standard deviations and 0.5 % of the sizes, at most about 1 %. prior: p values
/// [SI] for what the estimate has no value of, or null. Memory that was changed is repaired first, as by
/// zygos_refine_scrub(). Returns 1; ZYGOS_E_VALUE where a value or a positive definite covariance is missing, then the
/// task waits; or what zygos_refine_scrub() returns below 0. Call it in the task of zygos_refine_step(), and where
/// memory was changed while zygos_refine_cycle() is not running. Cost: a Cholesky factorisation, and p updates of n^2
/// multiplications.
int zygos_refine_start(zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *estimate,
                       const double *prior);

/// Hands over a cycle; null is ignored. Returns 1, 0 where there was none or the queue was full (counted),
/// ZYGOS_E_NULL, ZYGOS_E_ORDER when zygos_refine_init() has not succeeded on *self, or ZYGOS_E_STATE, with the cycle
/// lost, when memory was changed: call zygos_refine_scrub(). Cost: one copy of a cycle and its checksum.
int zygos_refine_cycle(zygos_refine_t *self, const zygos_cycle_t *cycle);

/// Does one slice of the work. Returns 1; 0 where nothing is to be done; or, with *self unchanged, an enum zygos_error:
/// ZYGOS_E_NULL; ZYGOS_E_ORDER when zygos_refine_init() has not succeeded on *self; ZYGOS_E_CONFIG when *config is not
/// the configuration of zygos_refine_init(); or ZYGOS_E_STATE when memory was changed: call zygos_refine_scrub() or
/// zygos_refine_start(). Where estimate, sums or covariance were changed, the refinement is abandoned and counted
/// (ZYGOS_REFINE_CORRUPT), and cycles are taken and not used until zygos_refine_start(). A cycle that was changed in
/// the queue is not used, and counted. Cost: the largest slice is one call of zygos_propagation_slopes().
int zygos_refine_step(zygos_refine_t *self, const zygos_config_t *config);

/// Finds and repairs what memory errors have changed in *self, as zygos_arm_scrub() does for zygos_arm_t. *config is
/// the caller's own configuration. Call it in the task of zygos_refine_step(), while zygos_refine_cycle() is not
/// running. A flipped bit of the settings is turned back, and what follows from them and from the configuration is
/// computed again; then, or where counts, places, estimate, sums or covariance were changed, the refinement is
/// abandoned and counted. Cycles that wait are dropped where the places of the queue were changed. Memory that nothing
/// has changed is left as it is. Returns 0 when nothing was found; bits of enum zygos_scrubbed (ZYGOS_SCRUBBED_CONFIG:
/// the settings); ZYGOS_E_NULL; ZYGOS_E_ORDER when zygos_refine_init() has not succeeded on *self; ZYGOS_E_CONFIG when
/// *config is not the configuration of zygos_refine_init(); or ZYGOS_E_STATE when the settings cannot be repaired: call
/// zygos_refine_init(). Cost: one pass over *self without its scratch; after a repair, also that of
/// zygos_refine_init(), and with the settings a pass over them for each of their bits.
int zygos_refine_scrub(zygos_refine_t *self, const zygos_config_t *config);

/// Compares with the newest estimate from energy rows, and writes what is published. Changes nothing in *self. Returns
/// 1 where the refined values are published, 0 where not, also where memory was changed (ZYGOS_REFINE_CORRUPT), or,
/// with *out unchanged, ZYGOS_E_NULL, ZYGOS_E_ORDER or ZYGOS_E_CONFIG as above. Call it in the task of
/// zygos_refine_step(). Cost: p n multiplications, and a checksum of the root.
int zygos_refine_judge(const zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *energy,
                       zygos_refined_t *out);

#ifdef __cplusplus
}
#endif
#endif
