/* SPDX-License-Identifier: MIT */
#include "zygos/refine.h"

#include "zygos/priv/arm.h"
#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

_Static_assert(sizeof(zygos_refine_settings_t) % sizeof(uint64_t) == 0, "settings are sealed in words of eight bytes");

#define MAGIC 0x7A797266u /* "zyrf" */
/* Of an estimate, and without effects. */
#define PARAMETERS (ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS)
#define MOST_PARAMETERS ((PARAMETERS < ZYGOS_MAX_PARAMETERS) ? PARAMETERS : ZYGOS_MAX_PARAMETERS)

#define VARIANCE_OF_STEP 12. /* a step of 1 has the variance 1/12 */
#define TWO_SIGMAS 1.959964  /* 95 % of a normal distribution */
#define WIDER 2.0            /* standard deviations at the start, as a multiple of those of the estimate */
#define ADDED 0.005          /* what is added to them, and what a value without one has; shares of the sizes */
#define ASSUMED 0.01
#define MOST 0.01   /* with more, the first innovations lead the filter out of the range where it is linear */
#define RARE_S 0.04 /* between uses of readings where there are many parameters */
#define FRESH 10.0  /* noise of the readings with which the state begins, as a multiple */
#define KEPT 0.25   /* information that the level is what it was: windows that tell nothing of it leave it */
#define FADE 0.8    /* of what is known of the level, from window to window */
#define UNSURE 2.0  /* what is known of it at the start */
#define SMALLEST_LEVEL 1e-4
#define LARGEST_LEVEL 1e4
#define LARGEST_STATE 1e6

/* The kind of work that is next. */
enum phase {
    TAKE = 0,   /* the next cycle of the queue */
    MOVE = 1,   /* a step of the state */
    SLOPES = 2, /* the derivatives of the accelerations */
    SERIES = 3, /* columns of the derivatives of the motion */
    CARRY = 4,  /* columns of the constants in the root */
    TABLE = 5,  /* the table of zygos_refiner_table() */
    ROWS = 6,   /* a row of it */
    READ = 7,   /* a reading */
    CLOSE = 8   /* the end of these */
};

static bool is_finite(double x)
{
    return zygos_within(x, -1e300, 1e300);
}

/* ---------------------------------------------------------------- seals

   What a slice addresses memory with is verified in each slice; configuration, settings and tables where a slice
   follows places in them; estimate and root before they change. Sums are verified where the task waits for a cycle.
   What is computed for one use of readings is verified when it has been used. A seal that changes with a part of what
   it is of keeps what was wrong before. */

static uint64_t counts_of(const zygos_refine_t *self)
{
    const zygos_refiner_t *filter = &self->filter;
    const unsigned char *counts = (const unsigned char *)&filter->propagation;
    const size_t first = offsetof(zygos_propagation_t, base_rates);
    const size_t end = offsetof(zygos_propagation_t, sign);
    uint64_t fold = zygos_checksum_memory(0u, counts + first, (uint32_t)(end - first));
    fold = ZYGOS_FOLDED(fold, &filter->settings, zygos_refiner_settings_t, steps, reserved);
    fold = ZYGOS_FOLDED(fold, &self->settings, zygos_refine_settings_t, every, apart);
    fold = ZYGOS_FOLDED(fold, &self->work, zygos_refiner_work_t, shapes, reserved);
    fold = ZYGOS_FOLDED(fold, self, zygos_refine_t, started, abandoned);
    fold = zygos_folded(fold, filter->fast);
    fold = zygos_folded(fold, filter->entries);
    fold = zygos_folded(fold, filter->constants);
    fold = zygos_folded(fold, filter->joints);
    fold = zygos_folded(fold, filter->failed);
    return zygos_checksum_number(fold, self->queue.tail);
}

static uint64_t settings_seal_of(const zygos_refine_t *self)
{
    return zygos_checksum_memory(0u, &self->settings, sizeof self->settings);
}

static uint64_t tables_seal_of(const zygos_refine_t *self)
{
    const uint64_t filter = zygos_checksum_memory(0u, &self->filter.propagation, sizeof self->filter.propagation);
    const uint64_t settings = zygos_checksum_memory(filter, &self->filter.settings, sizeof self->filter.settings);
    return zygos_checksum_memory(settings, &self->means, sizeof self->means);
}

static uint64_t estimate_seal_of(const zygos_refine_t *self)
{
    return zygos_checksum_doubles(0u, self->filter.x, self->filter.entries);
}

static uint64_t sums_seal_of(const zygos_refine_t *self)
{
    const uint32_t sums = (uint32_t)(offsetof(zygos_refine_t, means) - offsetof(zygos_refine_t, walk));
    uint64_t sealed = zygos_checksum_memory(0u, (const unsigned char *)self + offsetof(zygos_refine_t, walk), sums);
    sealed = zygos_checksum_memory(sealed, &self->previous, sizeof self->previous);
    sealed = zygos_checksum_memory(sealed, self->angle, sizeof self->angle);
    return (self->settings.every > 1u) /* the dynamics are kept from cycle to cycle */
               ? zygos_checksum_memory(sealed, &self->work.dynamics, sizeof self->work.dynamics)
               : sealed;
}

/* Of columns of the root from one to before another: a sum, of which each column is a part. */
static uint64_t columns_seal_of(const zygos_refine_t *self, uint32_t first, uint32_t end)
{
    uint64_t sealed = 0u;
    for (uint32_t j = first; j < end; j++) {
        const double *own = &self->filter.root[j * (j + 1u) / 2u];
        const uint64_t fold = zygos_fold_memory(j, own, (j + 1u) * (uint32_t)sizeof own[0]);
        sealed += zygos_checksum_number(fold, j);
    }
    return sealed;
}

static uint64_t root_seal_of(const zygos_refine_t *self)
{
    return columns_seal_of(self, 0u, self->filter.entries);
}

/* Of the derivatives of the accelerations, and of those of the motion. */
static uint64_t slopes_seal_of(const zygos_refine_t *self)
{
    const zygos_propagation_work_t *slopes = &self->work.propagation;
    const uint64_t sealed = zygos_checksum_memory(0u, slopes->by_state, sizeof slopes->by_state);
    return zygos_checksum_memory(zygos_checksum_memory(sealed, slopes->by_constant, sizeof slopes->by_constant),
                                 slopes->by_torque, sizeof slopes->by_torque);
}

static uint64_t series_seal_of(const zygos_refine_t *self)
{
    const zygos_refiner_work_t *work = &self->work;
    const uint64_t sealed = zygos_checksum_memory(1u, work->across, sizeof work->across);
    return zygos_checksum_memory(zygos_checksum_memory(sealed, work->pushed, sizeof work->pushed), work->push,
                                 sizeof work->push);
}

static uint64_t config_seal_of(const zygos_config_t *config)
{
    return zygos_checksum_memory(0u, config, sizeof *config);
}

static bool are_tables_whole(const zygos_refine_t *self)
{
    return (self->settings_seal == settings_seal_of(self)) && (self->tables_seal == tables_seal_of(self));
}

static bool runs(const zygos_refine_t *self)
{
    return (self->started != 0u) && (self->filter.failed == 0u);
}

/* Whether the task waits for a cycle and has an estimate. */
static bool rests(const zygos_refine_t *self)
{
    return (self->phase == (uint32_t)TAKE) && runs(self);
}

/* Needs that the places are verified. */
static bool is_rest_whole(const zygos_refine_t *self)
{
    return !rests(self) || ((self->estimate_seal == estimate_seal_of(self)) && (self->sums_seal == sums_seal_of(self)));
}

/* Whether what the next slice changes is as the newest one left it. */
static bool is_changed_whole(const zygos_refine_t *self)
{
    const bool reads = (self->phase == (uint32_t)READ);
    const bool moves = (self->phase == (uint32_t)MOVE);
    const bool slopes = (self->phase == (uint32_t)TABLE); /* used for the last time */
    return is_rest_whole(self) && (!(reads || moves) || (self->estimate_seal == estimate_seal_of(self))) &&
           (!reads || (self->root_seal == root_seal_of(self))) &&
           (!slopes || (self->slopes_seal == slopes_seal_of(self) + series_seal_of(self)));
}

/* Whether the next slice begins with a group of cycles, or follows what the tables and the configuration say of places:
   once or twice in a use of readings. */
static bool leads_on(const zygos_refine_t *self)
{
    return ((self->phase == (uint32_t)TAKE) && (self->group == 0u)) || (self->phase == (uint32_t)SLOPES) ||
           ((self->phase == (uint32_t)ROWS) && (self->cursor <= 1u));
}

/* Behind a slice of a phase. */
static void seal_slice(zygos_refine_t *self, uint32_t phase)
{
    if ((phase == (uint32_t)TAKE) || (phase == (uint32_t)MOVE) || (phase == (uint32_t)READ)) {
        self->estimate_seal = estimate_seal_of(self);
    }
    if (phase == (uint32_t)READ) {
        self->root_seal = root_seal_of(self);
    }
    if (rests(self)) {
        self->sums_seal = sums_seal_of(self);
    }
    self->places_seal = counts_of(self);
}

static void seal_all(zygos_refine_t *self)
{
    self->tables_seal = tables_seal_of(self);
    seal_slice(self, (uint32_t)READ);
}

static void fail(zygos_refine_t *self)
{
    self->filter.failed = 1u;
    self->moving = 0u;
    self->beginning = 0u;
    self->phase = (uint32_t)TAKE;
}

/* What memory errors have changed cannot be repaired. */
static void abandon(zygos_refine_t *self)
{
    self->abandoned += (self->started != 0u) ? 1u : 0u;
    self->corrupt = (self->started != 0u) ? 1u : 0u;
    fail(self);
}

/* ---------------------------------------------------------------- beginning */

int zygos_refine_defaults(zygos_refine_settings_t *settings, const zygos_config_t *config)
{
    if ((settings == NULL) || (config == NULL)) {
        return ZYGOS_E_NULL;
    }
    if ((config->joints < 1u) || (config->joints > (uint32_t)ZYGOS_MAX_JOINTS)) {
        return ZYGOS_E_JOINTS;
    }
    if (!zygos_within(config->period_s, 1e-5, 0.065)) {
        return ZYGOS_E_PERIOD;
    }
    memset(settings, 0, sizeof *settings);
    zygos_refiner_settings_t *filter = &settings->filter;
    filter->steps = 1u + (uint32_t)(config->period_s / 0.0100001);
    filter->gyro_sigma = config->imu_sigma;
    filter->second_order = 20.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        const double own = joint->torque_sigma / joint->gear_ratio;
        filter->torque_sigma[i] = (own > 0.0) ? own : ZYGOS_TORQUE_ROUNDING;
        filter->link_sigma[i] = joint->link_sigma_rad;
        filter->motor_sigma[i] = joint->motor_sigma_rad;
    }
    settings->every = (config->joints > 2u) ? 1u + (uint32_t)(RARE_S / config->period_s - 0.9999) : 1u;
    settings->terms = (settings->every > 1u) ? 12u : 6u;
    settings->window = 100u;
    settings->apart = 1u + (uint32_t)(0.0249999 / config->period_s);
    settings->bias_sigma = 1e-3;
    /* An encoder is mounted to a step at best. */
    const double step = __builtin_sqrt(VARIANCE_OF_STEP);
    filter->zeros = 1u;
    filter->gains = (zygos_effects_gains(config) > 0u) ? 1u : 0u;
    double *zero = &settings->beside_sigma[(filter->gains != 0u) ? config->joints : 0u];
    for (uint32_t i = 0; i < config->joints; i++) {
        zero[i] = step * filter->link_sigma[i];
        zero[config->joints + i] = step * filter->motor_sigma[i];
    }
    const double reference = zygos_effects_reference_sigma(config);
    for (uint32_t e = config->effects - zygos_effects_gains(config); e < config->effects; e++) {
        const double own = config->joint[config->effect[e].joint].torque_gain_sigma;
        settings->beside_sigma[config->effect[e].joint] = __builtin_sqrt(own * own + reference * reference);
    }
    return 1;
}

static bool are_settings_possible(const zygos_refine_settings_t *settings, const zygos_config_t *config)
{
    bool good = zygos_within(settings->every, 1.0, 1000.0) && zygos_within(settings->terms, 2.0, 20.0) &&
                zygos_within(settings->window, 20.0, 1e5) && zygos_within(settings->apart, 1.0, 1000.0) &&
                zygos_within(settings->bias_sigma, 0.0, 1e3) && !(config->imu_latch_s > 0.0);
    for (uint32_t k = 0; k < 5u * config->joints; k++) {
        good = good && zygos_within(settings->beside_sigma[k], 0.0, 1e6);
    }
    return good;
}

/* What follows from configuration and settings. Returns whether these are possible. */
static bool make_filter(zygos_refine_t *self, const zygos_config_t *config)
{
    if (!are_settings_possible(&self->settings, config)) {
        return false;
    }
    zygos_propagation_means(&self->means, self->settings.every);
    return zygos_refiner_init(&self->filter, config, &self->settings.filter) == 1;
}

int zygos_refine_init(zygos_refine_t *self, const zygos_config_t *config, const zygos_refine_settings_t *settings)
{
    if ((self == NULL) || (config == NULL) || (settings == NULL)) {
        return ZYGOS_E_NULL;
    }
    memset(self, 0, sizeof *self);
    const int verdict = zygos_config_check(config);
    if (verdict < 0) {
        return verdict;
    }
    if (config->torque_law == (uint32_t)ZYGOS_TORQUE_SAMPLED) {
        return ZYGOS_E_TORQUE_LAW;
    }
    self->settings = *settings;
    zygos_refiner_settings_t *filter = &self->settings.filter;
    for (uint32_t k = 0; k < (uint32_t)(sizeof filter->size / sizeof filter->size[0]); k++) {
        filter->size[k] = 1.0;
    }
    if (!make_filter(self, config)) {
        return ZYGOS_E_VALUE;
    }
    self->config_seal = config_seal_of(config);
    self->settings_seal = settings_seal_of(self);
    seal_all(self);
    self->magic = MAGIC;
    return 1;
}

/* Turns a flipped bit of the settings back. */
static bool repair_settings(zygos_refine_t *self)
{
    uint64_t word[sizeof self->settings / sizeof(uint64_t)];
    memcpy(word, &self->settings, sizeof word);
    if (!zygos_checksum_repair(word, (uint32_t)sizeof word, self->settings_seal)) {
        return false;
    }
    memcpy(&self->settings, word, sizeof word);
    self->settings_seal = settings_seal_of(self);
    return true;
}

/* Places that lead nowhere, from which the task goes on; with the tables, of which the counts are a part. Returns
 * whether there can be any. */
static bool rebuild(zygos_refine_t *self, const zygos_config_t *config)
{
    const uint32_t head = __atomic_load_n(&self->queue.head, __ATOMIC_ACQUIRE);
    if (!make_filter(self, config)) {
        return false;
    }
    self->started = (self->started != 0u) ? 1u : 0u;
    self->cursor = 0u;
    self->group = 0u;
    self->work.leads = 0u;
    self->queue.tail = (head <= (uint32_t)ZYGOS_CYCLE_QUEUE) ? head : 0u;
    abandon(self);
    return true;
}

/* Repairs the magic number, the seal of the configuration and the settings. Returns what was found, or an error. */
static int scrub_head(zygos_refine_t *self, const zygos_config_t *config)
{
    const uint32_t off = self->magic ^ MAGIC;
    const uint64_t config_off = self->config_seal ^ config_seal_of(config);
    if ((off & (off - 1u)) != 0u) {
        return ZYGOS_E_ORDER;
    }
    if ((config_off & (config_off - 1u)) != 0u) { /* one bit is that of the seal */
        return ZYGOS_E_CONFIG;
    }
    uint32_t found = ((off != 0u) || (config_off != 0u)) ? (uint32_t)ZYGOS_SCRUBBED_PLACES : 0u;
    if (self->settings_seal != settings_seal_of(self)) {
        if (!repair_settings(self)) {
            return ZYGOS_E_STATE;
        }
        found |= (uint32_t)ZYGOS_SCRUBBED_CONFIG;
    }
    if (off != 0u) { /* zygos_refine_cycle() may be reading it */
        self->magic = MAGIC;
    }
    self->config_seal ^= config_off;
    return (int)found;
}

/* Places of the queue that lead nowhere lose what waits. */
static bool repair_queue(zygos_refine_t *self)
{
    const uint32_t head = __atomic_load_n(&self->queue.head, __ATOMIC_ACQUIRE); /* the step may be appending */
    if ((head <= (uint32_t)ZYGOS_CYCLE_QUEUE) && (self->queue.tail <= (uint32_t)ZYGOS_CYCLE_QUEUE)) {
        return false;
    }
    __atomic_store_n(&self->queue.head, 0u, __ATOMIC_RELEASE);
    __atomic_store_n(&self->queue.tail, 0u, __ATOMIC_RELEASE);
    return true;
}

int zygos_refine_scrub(zygos_refine_t *self, const zygos_config_t *config)
{
    if ((self == NULL) || (config == NULL)) {
        return ZYGOS_E_NULL;
    }
    const int head = scrub_head(self, config);
    if (head < 0) {
        return head;
    }
    uint32_t found = (uint32_t)head;
    const bool tables = (self->tables_seal != tables_seal_of(self));
    const bool places = (self->places_seal != counts_of(self));
    found |= tables ? (uint32_t)ZYGOS_SCRUBBED_TABLES : 0u;
    found |= places ? (uint32_t)ZYGOS_SCRUBBED_PLACES : 0u;
    if (tables || places) {
        if (!rebuild(self, config)) {
            self->magic = 0u;
            return ZYGOS_E_STATE;
        }
    } else if (rests(self) && (!is_rest_whole(self) || (self->root_seal != root_seal_of(self)))) {
        abandon(self);
        found |= (uint32_t)ZYGOS_SCRUBBED_SUMS;
    }
    found |= repair_queue(self) ? (uint32_t)ZYGOS_SCRUBBED_PLACES : 0u;
    if (found != 0u) {
        seal_all(self);
    }
    return (int)found;
}

/* What errors of p values are compared with: the value; of one of the inertia matrix at least the geometric mean of the
 * two moments of inertia that it couples, and of a first moment the largest one. */
static void measure_values(zygos_refine_t *self, const zygos_config_t *config, const double *value)
{
    const zygos_propagation_t *propagation = &self->filter.propagation;
    const uint32_t p = propagation->parameters;
    const zygos_dynamics_t *dynamics = &self->work.dynamics;
    double *size = self->filter.settings.size;
    double moment = 0.0;
    memset(self->work.constant, 0, sizeof self->work.constant);
    memcpy(self->work.constant, value, p * sizeof value[0]);
    zygos_dynamics_set(&self->work.dynamics, propagation, config, self->work.constant);
    for (uint32_t a = 0; a < propagation->directions; a++) {
        moment = zygos_larger(moment, zygos_magnitude(dynamics->moment[a]));
    }
    for (uint32_t k = 0; k < p; k++) {
        size[k] = zygos_magnitude(value[k]);
    }
    const uint32_t entries = (config->reduced == 0u) ? p : config->reductions;
    for (uint32_t e = 0; e < entries; e++) {
        const bool same = (config->reduced == 0u);
        const uint32_t c = same ? e : config->reduction[e].column;
        const uint32_t k = same ? e : config->reduction[e].parameter;
        const double factor = same ? 1.0 : zygos_magnitude(config->reduction[e].factor);
        double least = 0.0;
        if (c < propagation->pairs) {
            const uint32_t a = propagation->first[c];
            const uint32_t b = propagation->second[c];
            least = __builtin_sqrt(zygos_magnitude(dynamics->matrix[a][a] * dynamics->matrix[b][b]));
        } else if (c < propagation->pairs + propagation->moments) {
            least = moment;
        }
        size[k] = zygos_larger(size[k], least / factor);
    }
    for (uint32_t k = 0; k < p; k++) {
        size[k] = (size[k] > 0.0) ? size[k] : 1.0;
    }
}

/* The largest level that passes, with which the filter also begins: where it is linear only roughly, more noise of the
 * torques keeps it from believing its first innovations too much. */
static double largest_level(const zygos_refine_t *self, uint32_t n)
{
    bool declared = false;
    for (uint32_t i = 0; i < n; i++) {
        declared = declared || (self->filter.settings.torque_relative_sigma[i] > 0.0);
    }
    return declared ? 1.0 : ZYGOS_REFINE_STEPS;
}

/* The gains begin with what the estimate says of them, where it does. */
static void start_gains(const zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *estimate,
                        double *x, double *sigma)
{
    const zygos_refiner_t *filter = &self->filter;
    const uint32_t n = config->joints;
    const uint32_t gains = zygos_effects_gains(config);
    const uint32_t first =
        filter->fast + filter->propagation.parameters + n * (filter->settings.friction + filter->settings.offsets);
    const bool told = (estimate->parameters >= gains) && (estimate->parameters <= (uint32_t)ZYGOS_MAX_PARAMETERS);
    for (uint32_t g = 0; told && (filter->settings.gains != 0u) && (g < gains); g++) {
        const uint32_t k = estimate->parameters - gains + g;
        const uint32_t at = first + config->effect[config->effects - gains + g].joint;
        if (is_finite(estimate->value[k]) && is_finite(estimate->sigma[k])) {
            const double wider = WIDER * estimate->sigma[k];
            x[at] = estimate->value[k];
            sigma[at] = (wider < sigma[at]) ? wider : sigma[at];
        }
    }
}

/* Needs a task that is whole. Returns 1 or ZYGOS_E_VALUE. */
static int start(zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *estimate,
                 const double *prior)
{
    zygos_refiner_t *filter = &self->filter;
    const uint32_t p = filter->propagation.parameters;
    const uint32_t fast = filter->fast;
    double x[ZYGOS_MAX_REFINED] = { 0.0 };
    double sigma[ZYGOS_MAX_REFINED] = { 0.0 };
    double *value = &x[fast];
    bool good = (estimate->parameters >= p) && (estimate->validity != (uint32_t)ZYGOS_REFUSED);
    self->started = 0u;
    self->corrupt = 0u;
    self->moving = 0u;
    self->beginning = 0u;
    self->phase = (uint32_t)TAKE;
    filter->failed = 0u;
    for (uint32_t k = 0; good && (k < p); k++) {
        const bool known = is_finite(estimate->value[k]) && is_finite(estimate->sigma[k]);
        value[k] = (known || (prior == NULL)) ? estimate->value[k] : prior[k];
        good = is_finite(value[k]);
    }
    if (!good) {
        return ZYGOS_E_VALUE;
    }
    measure_values(self, config, value);
    const double *size = filter->settings.size;
    for (uint32_t j = 0; j < p; j++) {
        const uint32_t at = fast + j;
        double *own = &filter->root[at * (at + 1u) / 2u + fast];
        const bool known = is_finite(estimate->value[j]) && is_finite(estimate->sigma[j]);
        for (uint32_t i = 0; i <= j; i++) {
            const double entry = estimate->covariance[zygos_gram_place(j, i)];
            own[i] = is_finite(entry) ? WIDER * WIDER * entry / (size[i] * size[j]) : 0.0;
        }
        own[j] += ADDED * ADDED + (known ? 0.0 : ASSUMED * ASSUMED);
    }
    memcpy(&sigma[fast + p], self->settings.beside_sigma, (filter->constants - p) * sizeof sigma[0]);
    start_gains(self, config, estimate, x, sigma);
    if (zygos_refiner_begin(filter, x, sigma) != 1) {
        return ZYGOS_E_VALUE;
    }
    self->work.leads = 0u;
    for (uint32_t k = 0; k < p; k++) {
        zygos_refiner_pin(filter, fast + k, MOST, &self->work);
    }
    self->started = 1u;
    self->used = 0u;
    self->windows = 0u;
    self->awaited = 0u;
    self->level = largest_level(self, config->joints);
    self->information = UNSURE;
    self->score = 0.0;
    self->share = 0.0;
    self->walk = 0.0;
    memset(self->count, 0, sizeof self->count);
    memset(self->square, 0, sizeof self->square);
    memset(self->largest, 0, sizeof self->largest);
    return 1;
}

int zygos_refine_start(zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *estimate,
                       const double *prior)
{
    if ((self == NULL) || (config == NULL) || (estimate == NULL)) {
        return ZYGOS_E_NULL;
    }
    const int found = zygos_refine_scrub(self, config);
    if (found < 0) {
        return found;
    }
    const int begun = start(self, config, estimate, prior);
    seal_all(self);
    return begun;
}

/* ---------------------------------------------------------------- cycles */

static uint32_t behind_reading(uint32_t place)
{
    return (place >= (uint32_t)ZYGOS_CYCLE_QUEUE) ? 0u : place + 1u;
}

int zygos_refine_cycle(zygos_refine_t *self, const zygos_cycle_t *cycle)
{
    if (self == NULL) {
        return ZYGOS_E_NULL;
    }
    if (self->magic != MAGIC) {
        return ZYGOS_E_ORDER;
    }
    if (cycle == NULL) {
        return 0;
    }
    const uint32_t head = self->queue.head;
    if (head > (uint32_t)ZYGOS_CYCLE_QUEUE) {
        return ZYGOS_E_STATE;
    }
    const uint32_t next = behind_reading(head);
    if (next == __atomic_load_n(&self->queue.tail, __ATOMIC_ACQUIRE)) {
        self->overrun++;
        return 0;
    }
    self->queue.slot[head] = *cycle;
    self->queue.fold[head] = zygos_checksum_memory(0u, cycle, sizeof *cycle);
    __atomic_store_n(&self->queue.head, next, __ATOMIC_RELEASE);
    return 1;
}

/* The torque of the interval, and what of it nobody reported: of a walk between two known ends. */
static void enter(zygos_refine_t *self, const zygos_config_t *config)
{
    const zygos_refiner_settings_t *settings = &self->filter.settings;
    const bool previous = (config->torque_law == (uint32_t)ZYGOS_TORQUE_APPLIED_PREVIOUS_CYCLE);
    const uint32_t at = self->interval + (previous ? 1u : 0u);
    const uint32_t left = self->intervals - at;
    const double share = (double)at / (double)self->intervals;
    const uint32_t distance = zygos_least(at, left);
    if (self->group == 0u) {
        zygos_refiner_constants(&self->filter, self->work.constant);
        zygos_dynamics_set(&self->work.dynamics, &self->filter.propagation, config, self->work.constant);
        memset(self->mean, 0, sizeof self->mean);
        memset(self->variance, 0, sizeof self->variance);
        memset(self->middle, 0, sizeof self->middle);
        memset(self->readings, 0, sizeof self->readings);
        memset(self->expected, 0, sizeof self->expected);
        self->missing = 0.0;
        self->lost_lately = 0u;
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        self->tau[i] = self->before[i] + (self->after[i] - self->before[i]) * share;
        const double relative = settings->torque_relative_sigma[i] * self->tau[i];
        self->mean[i] += self->tau[i];
        self->variance[i] += settings->torque_sigma[i] * settings->torque_sigma[i] + relative * relative;
    }
    self->missing += self->walk * (double)distance;
    self->lost_lately |= (distance > 0u) ? 1u : 0u;
    self->cursor = 0u;
    self->phase = (uint32_t)MOVE;
}

/* Reading k of the newest cycle. */
static double reading(const zygos_refine_t *self, const zygos_config_t *config, uint32_t k)
{
    const uint32_t n = config->joints;
    const double *axis = config->joint[0].axis;
    const double *omega = &self->signal[2u * n];
    const bool planar = (k >= 2u * n) && (self->filter.propagation.base_rates == 1u);
    return planar ? zygos_dot3(axis, omega) : self->signal[k];
}

/* State and bias at the newest of the readings with which the state begins: rates are those of a parabola through
 * three, and what a fourth one says otherwise widens their deviations. */
static void begin_state(zygos_refine_t *self, const zygos_config_t *config)
{
    const zygos_refiner_settings_t *settings = &self->filter.settings;
    const uint32_t n = config->joints;
    const uint32_t w = self->filter.propagation.base_rates;
    const double time = (double)self->settings.apart * config->period_s;
    const double gyro = __builtin_sqrt(FRESH * FRESH * settings->gyro_sigma * settings->gyro_sigma +
                                       self->settings.bias_sigma * self->settings.bias_sigma);
    double x[ZYGOS_MAX_FAST] = { 0.0 };
    double sigma[ZYGOS_MAX_FAST] = { 0.0 };
    for (uint32_t k = 0; k < 2u * n; k++) {
        const double a[4] = { self->angle[0][k], self->angle[1][k], self->angle[2][k], self->angle[3][k] };
        const double noise = (k < n) ? settings->link_sigma[k] : settings->motor_sigma[k - n];
        const double zero =
            (settings->zeros != 0u)
                ? self->settings.beside_sigma[self->filter.constants - self->filter.propagation.parameters - 2u * n + k]
                : 0.0;
        const double rate = (3.0 * a[3] - 4.0 * a[2] + a[1]) / (2.0 * time);
        const double other = (11.0 * a[3] - 18.0 * a[2] + 9.0 * a[1] - 2.0 * a[0]) / (6.0 * time);
        x[w + k] = a[3];
        x[w + 2u * n + k] = rate;
        sigma[w + k] = FRESH * __builtin_sqrt(noise * noise + zero * zero);
        sigma[w + 2u * n + k] = zygos_magnitude(other - rate) + __builtin_sqrt(530.0) / (6.0 * time) * noise;
    }
    for (uint32_t k = 0; k < w; k++) {
        x[k] = reading(self, config, 2u * n + k);
        sigma[k] = gyro;
        sigma[self->filter.propagation.moving + k] = self->settings.bias_sigma;
    }
    if (self->root_seal != root_seal_of(self)) {
        abandon(self);
        return;
    }
    zygos_refiner_resume(&self->filter, x, sigma);
    self->root_seal = root_seal_of(self);
    self->moving = 1u;
    self->group = 0u;
    self->work.leads = 0u;
    self->lost_lately = 1u; /* no torque has acted yet */
    self->cursor = 0u;
    self->phase = (uint32_t)READ;
}

/* The readings from which the state begins. */
static void gather(zygos_refine_t *self, const zygos_config_t *config)
{
    self->since++;
    if ((self->beginning == 0u) || (self->since >= self->settings.apart)) {
        memcpy(self->angle[self->beginning], self->signal, 2u * config->joints * sizeof self->signal[0]);
        self->beginning++;
        self->since = 0u;
    }
    if (self->beginning == ZYGOS_REFINE_BEGINNING) {
        begin_state(self, config);
    }
}

static void use_cycle(zygos_refine_t *self, const zygos_config_t *config, const zygos_cycle_t *cycle)
{
    const uint32_t broken = (uint32_t)ZYGOS_CYCLE_BREAK | (uint32_t)ZYGOS_CYCLE_VOID;
    const bool known = (self->moving != 0u) || (self->beginning > 0u);
    const uint64_t step = cycle->sync - self->sync;
    const uint64_t most = (self->moving != 0u) ? ZYGOS_REFINE_GAP + 1u : 1u;
    const bool follows = known && (step >= 1u) && (step <= most) && ((cycle->flags & broken) == 0u) &&
                         (zygos_cycle_wrapped(&self->previous, config, cycle) == 0);
    double unused[ZYGOS_MAX_JOINTS];
    double widest = 0.0;
    memcpy(self->before, self->previous.reported, sizeof self->before);
    memcpy(self->after, cycle->tau, sizeof self->after);
    zygos_cycle_calibrate(&self->previous, config, cycle, self->signal, unused);
    self->sync = cycle->sync;
    if (!follows) {
        self->restarts += self->moving;
        self->moving = 0u;
        self->beginning = 0u;
        self->since = 0u;
    }
    if (self->moving == 0u) {
        gather(self, config);
        return;
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        widest = zygos_larger(widest, zygos_magnitude(self->after[i] - self->before[i]));
    }
    self->walk += (step == 1u) ? (widest * widest - self->walk) / 16.0 : 0.0;
    self->lost += step - 1u;
    self->intervals = (uint32_t)step;
    self->interval = 0u;
    enter(self, config);
}

/* Whether one encoder of a joint has passed the end of its range: the cycle is skipped, and nothing of it is kept. */
static bool is_apart(const zygos_refine_t *self, const zygos_config_t *config, const zygos_cycle_t *cycle)
{
    zygos_previous_cycle_t previous = self->previous;
    double signal[2 * ZYGOS_MAX_JOINTS + 3];
    double unused[ZYGOS_MAX_JOINTS];
    zygos_cycle_calibrate(&previous, config, cycle, signal, unused);
    return zygos_cycle_apart(signal, config->joints) == 1;
}

/* Needs that there is a cycle. */
static void take(zygos_refine_t *self, const zygos_config_t *config)
{
    const uint32_t tail = self->queue.tail;
    const zygos_cycle_t *cycle = &self->queue.slot[tail];
    const bool whole = (self->queue.fold[tail] == zygos_checksum_memory(0u, cycle, sizeof *cycle));
    self->spoiled += whole ? 0u : 1u;
    if (whole && runs(self) && ((cycle->flags & (uint32_t)ZYGOS_CYCLE_VOID) != 0u)) {
        self->filter.failed = 1u; /* what it has used cannot be taken back */
    } else if (whole && runs(self) && ((cycle->flags & (uint32_t)ZYGOS_CYCLE_INVALID) == 0u) &&
               !is_apart(self, config, cycle)) {
        use_cycle(self, config, cycle);
    }
    self->queue.fold[tail] = 0u; /* an index that changes must not bring it back */
    __atomic_store_n(&self->queue.tail, behind_reading(tail), __ATOMIC_RELEASE);
}

static void add_middle(zygos_refine_t *self)
{
    for (uint32_t k = 0; k < self->filter.propagation.moving; k++) {
        self->middle[k] += 0.5 * self->filter.x[k];
    }
}

/* How many readings a cycle has. */
static uint32_t readings_of(const zygos_refine_t *self, const zygos_config_t *config)
{
    return 2u * config->joints + self->filter.propagation.base_rates;
}

/* What reading k is in a state, or changes by with it, without zeros and bias. */
static double read_in(const zygos_refine_t *self, const zygos_config_t *config, uint32_t k, const double *state)
{
    const uint32_t angles = 2u * config->joints;
    const double *angle = &state[self->filter.propagation.base_rates];
    return (k < angles) ? angle[k] + zygos_refiner_latch_s(config, k) * angle[angles + k] : state[k - angles];
}

static void add_readings(zygos_refine_t *self, const zygos_config_t *config)
{
    for (uint32_t k = 0; k < readings_of(self, config); k++) {
        self->readings[k] += reading(self, config, k);
        self->expected[k] += read_in(self, config, k, self->filter.x);
    }
}

static void move(zygos_refine_t *self, const zygos_config_t *config)
{
    const uint32_t steps = self->filter.settings.steps;
    const uint32_t all = self->settings.every * steps;
    const uint32_t at = self->group * steps + self->cursor;
    double drive[ZYGOS_MAX_JOINTS];
    bool good = true;
    zygos_refiner_drive(&self->filter, self->tau, drive);
    if (at == all / 2u) {
        add_middle(self);
    }
    if (at == (all + 1u) / 2u) {
        add_middle(self);
    }
    good = zygos_propagation_move(&self->filter.propagation, config, &self->work.dynamics,
                                  config->period_s / (double)steps, self->filter.x, drive, &self->work.propagation);
    if (all == 1u) {
        add_middle(self);
    }
    for (uint32_t k = 0; k < self->filter.propagation.moving; k++) {
        good = good && zygos_within(self->filter.x[k], -LARGEST_STATE, LARGEST_STATE);
    }
    if (!good) {
        fail(self);
        return;
    }
    self->cursor++;
    if (self->cursor < steps) {
        return;
    }
    self->interval++;
    self->group++;
    if (self->interval == self->intervals) {
        add_readings(self, config);
    }
    if (self->group >= self->settings.every) {
        self->phase = (uint32_t)SLOPES;
    } else if (self->interval < self->intervals) {
        enter(self, config);
    } else {
        self->phase = (uint32_t)TAKE;
    }
}

static void linearise(zygos_refine_t *self, const zygos_config_t *config)
{
    double drive[ZYGOS_MAX_JOINTS];
    for (uint32_t i = 0; i < config->joints; i++) {
        self->mean[i] /= (double)self->settings.every;
    }
    memcpy(self->work.torque, self->mean, config->joints * sizeof self->mean[0]);
    zygos_refiner_drive(&self->filter, self->mean, drive);
    if (!zygos_propagation_slopes(&self->filter.propagation, config, &self->work.dynamics, self->middle, drive,
                                  &self->work.propagation)) {
        fail(self);
        return;
    }
    const uint32_t every = self->settings.every;
    self->work.shapes = zygos_least(every, (uint32_t)ZYGOS_MAX_SHAPES);
    self->work.leads = ((every > 1u) && (self->lost_lately == 0u)) ? readings_of(self, config) : 0u;
    self->work.cycles = every;
    for (uint32_t k = 0; k < self->work.leads; k++) {
        self->work.lead_x[k] = self->expected[k] / (double)every;
    }
    self->cursor = 0u;
    self->slopes_seal = slopes_seal_of(self);
    self->phase = (uint32_t)SERIES;
}

/* Noise of a torque that is another one in each cycle has in the mean over all cycles so much, and as much, of other
 * sizes, in each other shape over them. */
static double torque_noise_of(const zygos_refine_t *self, uint32_t i, double missing)
{
    const double variance = self->level * self->level * self->variance[i] + missing;
    return __builtin_sqrt(variance) / (double)self->settings.every;
}

/* Writes a column of state and means, whose rows are so many entries apart. */
static void put_column(const zygos_refine_t *self, const zygos_config_t *config, double factor,
                       const zygos_propagation_change_t *by, double *column, uint32_t stride)
{
    const uint32_t moving = self->filter.propagation.moving;
    for (uint32_t i = 0; i < moving; i++) {
        column[i * stride] = factor * by->end[i];
    }
    for (uint32_t i = 0; i < self->work.leads; i++) {
        column[(moving + i) * stride] = factor * read_in(self, config, i, by->mean);
    }
}

/* Adds to such a column what a column of accelerations does. */
static void add_pushed(zygos_refine_t *self, uint32_t accelerations, const double *by, uint32_t by_stride,
                       double *column, uint32_t stride)
{
    for (uint32_t i = 0; i < self->filter.propagation.moving + self->work.leads; i++) {
        double sum = column[i * stride];
        for (uint32_t k = 0; k < accelerations; k++) {
            sum += self->work.pushed[i][k] * by[k * by_stride];
        }
        column[i * stride] = sum;
    }
}

/* What the noise of a torque does in other shapes than held: Legendre polynomials over the cycles, of which noise that
 * is held within each of so many cycles has as much as their discrete counterparts are long. */
static void shape(zygos_refine_t *self, const zygos_config_t *config, double time, uint32_t torque)
{
    const double cycles = (double)self->settings.every;
    const uint32_t shapes = self->work.shapes;
    zygos_propagation_change_t out[ZYGOS_MAX_SHAPES];
    double square = 1.0;
    if (shapes < 2u) {
        return;
    }
    zygos_propagation_shapes(&self->filter.propagation, config, time, self->settings.terms, &self->means, torque,
                             shapes, &self->work.propagation, out);
    for (uint32_t k = 1; k < shapes; k++) {
        const double degree = (double)k;
        square *= 1.0 - degree * degree / (cycles * cycles);
        const double factor = __builtin_sqrt((2.0 * degree + 1.0) * square);
        put_column(self, config, factor, &out[k], &self->work.push[0][k * config->joints + torque], ZYGOS_MAX_PUSHES);
    }
}

/* Columns by the rates before, and by additions to accelerations beside them; then by the angles, which stay what they
   are and add to the accelerations, and by the torques. */
static void series(zygos_refine_t *self, const zygos_config_t *config)
{
    const zygos_propagation_t *propagation = &self->filter.propagation;
    zygos_refiner_work_t *work = &self->work;
    const uint32_t n = config->joints;
    const uint32_t w = propagation->base_rates;
    const uint32_t moving = propagation->moving;
    const uint32_t rates = w + 2u * n;
    const double time = (double)self->settings.every * config->period_s;
    for (uint32_t k = 0; (k < 2u) && (self->cursor < moving + n); k++, self->cursor++) {
        const uint32_t turn = self->cursor;
        zygos_propagation_change_t by = { { 0.0 }, { 0.0 } };
        if (turn < rates) {
            zygos_propagation_change_t pushed;
            const uint32_t c = (turn < w) ? turn : turn + 2u * n;
            zygos_propagation_series(propagation, config, time, self->settings.terms, &self->means, c,
                                     &work->propagation, &by, &pushed);
            put_column(self, config, 1.0, &by, &work->across[0][c], ZYGOS_MAX_MOVING);
            put_column(self, config, 1.0, &pushed, &work->pushed[0][turn], ZYGOS_MAX_ACCELERATIONS);
        } else if (turn < moving) {
            const uint32_t c = turn - rates + w;
            by.end[c] = 1.0;
            by.mean[c] = 1.0;
            put_column(self, config, 1.0, &by, &work->across[0][c], ZYGOS_MAX_MOVING);
            add_pushed(self, rates, &work->propagation.by_state[0][c], ZYGOS_MAX_MOVING, &work->across[0][c],
                       ZYGOS_MAX_MOVING);
        } else {
            const uint32_t torque = turn - moving;
            put_column(self, config, 0.0, &by, &work->push[0][torque], ZYGOS_MAX_PUSHES);
            add_pushed(self, rates, &work->propagation.by_torque[0][torque], ZYGOS_MAX_JOINTS, &work->push[0][torque],
                       ZYGOS_MAX_PUSHES);
            shape(self, config, time, torque);
        }
    }
    if (self->cursor >= moving + n) {
        self->cursor = 0u;
        self->slopes_seal += series_seal_of(self);
        self->phase = (uint32_t)CARRY;
    }
}

static void carry(zygos_refine_t *self)
{
    for (uint32_t k = 0; (k < ZYGOS_REFINE_COLUMNS) && (self->cursor < self->filter.constants); k++, self->cursor++) {
        const uint32_t j = self->filter.fast + self->cursor;
        self->root_seal -= columns_seal_of(self, j, j + 1u);
        zygos_refiner_carry(&self->filter, self->cursor, NULL, &self->work);
        self->root_seal += columns_seal_of(self, j, j + 1u);
    }
    if (self->cursor >= self->filter.constants) {
        self->phase = (uint32_t)TABLE;
    }
}

static void tabulate(zygos_refine_t *self, const zygos_config_t *config)
{
    double noise[ZYGOS_MAX_JOINTS];
    for (uint32_t i = 0; i < config->joints; i++) {
        noise[i] = torque_noise_of(self, i, self->missing);
    }
    const double walk = self->filter.settings.bias_walk * __builtin_sqrt((double)self->settings.every);
    zygos_refiner_table(&self->filter, noise, walk, &self->work);
    self->cursor = self->filter.fast + self->work.leads;
    self->phase = (uint32_t)ROWS;
}

static void take_row(zygos_refine_t *self, const zygos_config_t *config)
{
    const uint32_t leads = self->work.leads;
    const uint32_t fast = self->filter.fast;
    self->cursor--;
    /* those of state and bias first; those of the means are not in the root */
    const uint32_t at = (self->cursor >= leads) ? self->cursor - leads : fast + self->cursor;
    const uint32_t end = (at < fast) ? at + 1u : at;
    self->root_seal -= columns_seal_of(self, at, end);
    zygos_refiner_row(&self->filter, at, &self->work);
    self->root_seal += columns_seal_of(self, at, end);
    if (self->cursor > 0u) {
        return;
    }
    self->group = 0u;
    if (self->interval < self->intervals) {
        enter(self, config);
    } else {
        self->phase = (uint32_t)READ;
    }
}

static void read_one(zygos_refine_t *self, const zygos_config_t *config)
{
    zygos_refiner_t *filter = &self->filter;
    const uint32_t n = config->joints;
    const bool mean = (self->work.leads > 0u);
    const double value =
        mean ? self->readings[self->cursor] / (double)self->settings.every : reading(self, config, self->cursor);
    const zygos_innovation_t one =
        zygos_refiner_use(filter, config, self->cursor, value, ZYGOS_REFINE_GATE, &self->work);
    self->rejected += one.rejected;
    self->count[one.channel] += 1.0;
    self->square[one.channel] += one.square;
    self->largest[one.channel] = zygos_larger(self->largest[one.channel], one.square);
    if (self->lost_lately == 0u) {
        double share = 0.0;
        for (uint32_t k = 0; k < self->work.shapes * n; k++) {
            const double noise = torque_noise_of(self, k % n, 0.0);
            double moved = mean ? self->work.push[filter->propagation.moving + self->cursor][k] * noise : 0.0;
            for (uint32_t t = 0; (t < one.terms) && (one.entry[t] < filter->propagation.moving); t++) {
                moved += one.weight[t] * self->work.push[one.entry[t]][k] * noise;
            }
            share += moved * moved;
        }
        share /= one.variance;
        self->score += share * (one.square - 1.0);
        self->share += share * share;
    }
    self->cursor++;
    if (self->cursor >= readings_of(self, config)) {
        self->phase = (uint32_t)CLOSE;
    }
}

/* One step of Fisher's scoring by the logarithm of the squared level, with what earlier windows have told. */
static void adapt(zygos_refine_t *self)
{
    self->information = FADE * self->information + 0.5 * self->share;
    const double step = 0.5 * self->score / (self->information + KEPT);
    const double factor = (step > 1.0) ? 2.0 : ((step < -0.75) ? 0.25 : 1.0 + step);
    const double level = self->level * __builtin_sqrt(factor);
    self->level = (level < SMALLEST_LEVEL) ? SMALLEST_LEVEL : ((level > LARGEST_LEVEL) ? LARGEST_LEVEL : level);
    self->score = 0.0;
    self->share = 0.0;
}

static void conclude(zygos_refine_t *self)
{
    bool calm = true;
    self->phase = (uint32_t)TAKE;
    self->used++;
    if (self->used % self->settings.window != 0u) {
        return;
    }
    for (uint32_t c = 0; c < (uint32_t)ZYGOS_KINDS_OF_CHANNEL; c++) {
        const double count = self->count[c];
        self->nis[c] = (count > 0.0) ? self->square[c] / count : 1.0;
        self->ratio[c] = self->largest[c] / ZYGOS_REFINE_GATE;
        const double error = (count > 0.0) ? __builtin_sqrt(2.0 / count) : 0.0;
        calm = calm && (self->nis[c] <= 1.0 + ZYGOS_REFINE_EXCESS + ZYGOS_REFINE_SIGMAS * error);
        self->count[c] = 0.0;
        self->square[c] = 0.0;
        self->largest[c] = 0.0;
    }
    adapt(self);
    self->windows++;
    const uint32_t most = calm ? ZYGOS_REFINE_LONGEST : ZYGOS_REFINE_LONGEST - ZYGOS_REFINE_CALM;
    const uint32_t awaited = zygos_least(self->awaited, most);
    if (calm) {
        self->awaited = (awaited > 0u) ? awaited - 1u : 0u;
    } else {
        self->awaited = ZYGOS_REFINE_CALM + ((self->windows > ZYGOS_REFINE_SETTLING) ? awaited : 0u);
    }
}

static void work_on(zygos_refine_t *self, const zygos_config_t *config)
{
    switch ((enum phase)self->phase) {
    case TAKE:
        take(self, config);
        break;
    case MOVE:
        move(self, config);
        break;
    case SLOPES:
        linearise(self, config);
        break;
    case SERIES:
        series(self, config);
        break;
    case CARRY:
        carry(self);
        break;
    case TABLE:
        tabulate(self, config);
        break;
    case ROWS:
        take_row(self, config);
        break;
    case READ:
        read_one(self, config);
        break;
    case CLOSE:
        conclude(self);
        break;
    }
}

/* Whether there is something to do: without a cycle that waits, the first phase has nothing to take. Returns
 * ZYGOS_E_STATE where the queue leads nowhere. */
static int has_work(const zygos_refine_t *self)
{
    if (self->phase != (uint32_t)TAKE) {
        return 1;
    }
    const uint32_t head = __atomic_load_n(&self->queue.head, __ATOMIC_ACQUIRE);
    if (head == self->queue.tail) {
        return 0;
    }
    return (head > (uint32_t)ZYGOS_CYCLE_QUEUE) ? ZYGOS_E_STATE : 1;
}

int zygos_refine_step(zygos_refine_t *self, const zygos_config_t *config)
{
    if ((self == NULL) || (config == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (self->magic != MAGIC) {
        return ZYGOS_E_ORDER;
    }
    if ((self->places_seal != counts_of(self)) || (self->phase > (uint32_t)CLOSE)) {
        return ZYGOS_E_STATE;
    }
    const int work = has_work(self);
    if (work != 1) {
        return work;
    }
    const uint32_t phase = self->phase;
    const bool follows = leads_on(self);
    if ((config->joints != self->filter.joints) || (config->torque_law >= (uint32_t)ZYGOS_TORQUE_SAMPLED) ||
        (follows && (self->config_seal != config_seal_of(config)))) {
        return ZYGOS_E_CONFIG;
    }
    if (follows && !are_tables_whole(self)) {
        return ZYGOS_E_STATE;
    }
    if (is_changed_whole(self)) {
        work_on(self, config);
    } else {
        abandon(self);
    }
    seal_slice(self, phase);
    return 1;
}

/* Whether the torques have no more noise than declared. */
static bool quiet(const zygos_refine_t *self, uint32_t n, double error)
{
    const double x = ZYGOS_REFINE_SIGMAS * error;
    return self->level <= largest_level(self, n) * (1.0 + x + 0.5 * x * x + ZYGOS_REFINE_LOUDER);
}

static uint32_t reason_of(const zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *energy,
                          const zygos_refined_t *out)
{
    const zygos_refiner_t *filter = &self->filter;
    const double *value = &filter->x[filter->fast];
    if (self->started == 0u) {
        return ZYGOS_REFINE_WAITS;
    }
    if (self->corrupt != 0u) {
        return ZYGOS_REFINE_CORRUPT;
    }
    if (filter->failed != 0u) {
        return ZYGOS_REFINE_FAILED;
    }
    if ((energy->validity != (uint32_t)ZYGOS_VALID) && (energy->validity != (uint32_t)ZYGOS_PARTIAL)) {
        return ZYGOS_REFINE_ENERGY;
    }
    if (self->windows < ZYGOS_REFINE_CALM) {
        return ZYGOS_REFINE_WAITS;
    }
    if (self->awaited > 0u) {
        return ZYGOS_REFINE_INNOVATIONS;
    }
    if (!quiet(self, config->joints, out->level_error)) {
        return ZYGOS_REFINE_LEVEL;
    }
    if (!(out->distance <= 1.0)) {
        return ZYGOS_REFINE_APART;
    }
    for (uint32_t i = 0; i < 3u * config->joints; i++) {
        if (!(value[filter->propagation.parameters - 1u - i] > 0.0)) {
            return ZYGOS_REFINE_PHYSICAL;
        }
    }
    return ZYGOS_REFINE_NONE;
}

/* What is published of a task that is whole. */
static void compare(const zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *energy,
                    zygos_refined_t *out)
{
    const zygos_refiner_t *filter = &self->filter;
    const uint32_t p = filter->propagation.parameters;
    out->level = self->level;
    out->level_error = (self->information > 0.0) ? 0.5 / __builtin_sqrt(self->information) : 0.0;
    memcpy(out->nis, self->nis, sizeof out->nis);
    memcpy(out->ratio, self->ratio, sizeof out->ratio);
    for (uint32_t k = 0; k < p; k++) {
        const double size = filter->settings.size[k];
        double square = 0.0;
        for (uint32_t j = filter->fast + k; j < filter->entries; j++) {
            const double entry = filter->root[j * (j + 1u) / 2u + filter->fast + k];
            square += entry * entry;
        }
        out->value[k] = filter->x[filter->fast + k] * size;
        out->sigma[k] = __builtin_sqrt(square) * size;
        const double other = energy->half95[k] / TWO_SIGMAS;
        const double allowed =
            ZYGOS_REFINE_APART_SIGMAS * __builtin_sqrt(other * other + out->sigma[k] * out->sigma[k]) +
            ZYGOS_REFINE_BIAS * size;
        const double distance = zygos_magnitude(out->value[k] - energy->value[k]) / allowed;
        if (distance > out->distance) {
            out->distance = distance;
            out->farthest = k;
        }
    }
    out->reason = reason_of(self, config, energy, out);
}

int zygos_refine_judge(const zygos_refine_t *self, const zygos_config_t *config, const zygos_estimate_t *energy,
                       zygos_refined_t *out)
{
    if ((self == NULL) || (config == NULL) || (energy == NULL) || (out == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (self->magic != MAGIC) {
        return ZYGOS_E_ORDER;
    }
    if (self->config_seal != config_seal_of(config)) {
        return ZYGOS_E_CONFIG;
    }
    const uint32_t p = self->filter.propagation.parameters;
    const bool whole = (self->places_seal == counts_of(self)) && are_tables_whole(self) && is_rest_whole(self) &&
                       (!rests(self) || (self->root_seal == root_seal_of(self)));
    memset(out, 0, sizeof *out);
    out->cycle = self->sync;
    out->used = self->used;
    out->lost = self->lost;
    out->restarts = self->restarts;
    out->rejected = self->rejected;
    out->spoiled = self->spoiled;
    out->abandoned = self->abandoned;
    out->parameters = (p <= (uint32_t)MOST_PARAMETERS) ? p : (uint32_t)MOST_PARAMETERS;
    out->reason = (uint32_t)ZYGOS_REFINE_CORRUPT;
    if (whole) {
        compare(self, config, energy, out);
    }
    out->published = (out->reason == (uint32_t)ZYGOS_REFINE_NONE) ? 1u : 0u;
    if (out->published == 0u) {
        memcpy(out->value, energy->value, out->parameters * sizeof out->value[0]);
        memcpy(out->sigma, energy->sigma, out->parameters * sizeof out->sigma[0]);
    }
    return (int)out->published;
}
