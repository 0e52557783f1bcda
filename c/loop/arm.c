/* SPDX-License-Identifier: MIT */
#include "zygos/priv/arm.h"

#include "zygos/priv/numbers.h"
#include "zygos/priv/tables.h"

#include <float.h>
#include <limits.h>
#include <stddef.h>
#include <string.h>

/* What the arithmetic and the layout of a snapshot rely on. */
_Static_assert(CHAR_BIT == 8, "zygos needs bytes of 8 bits");
_Static_assert((sizeof(double) == 8) && (FLT_RADIX == 2) && (DBL_MANT_DIG == 53) && (DBL_MAX_EXP == 1024),
               "zygos needs doubles of 64 bits; remedy: compile without -fshort-double or -fsingle-precision-constant");
_Static_assert(FLT_EVAL_METHOD == 0, "zygos needs doubles that are rounded to double after each operation; remedy: "
                                     "compile for SSE2 instead of the x87");
#define SIZE(member) (sizeof(((zygos_config_t *)0)->member))
#define SIZE_OF_JOINT(member) (sizeof(((zygos_joint_config_t *)0)->member))
_Static_assert((sizeof(zygos_joint_config_t) ==
                4u * sizeof(uint32_t) + SIZE_OF_JOINT(frame) + SIZE_OF_JOINT(axis) + 12u * sizeof(double)) &&
                   (sizeof(zygos_effect_config_t) == 2u * sizeof(uint32_t)) &&
                   (sizeof(zygos_reduction_t) == 2u * sizeof(uint32_t) + sizeof(double)) &&
                   (sizeof(zygos_config_t) == 18u * sizeof(uint32_t) + 4u * sizeof(double) + SIZE(imu_to_base) +
                                                  SIZE(gravity) + SIZE(joint) + SIZE(effect) + SIZE(reduction)),
               "a configuration has no padding, because it is compared byte by byte");

#define MAGIC 0x7A79676Fu /* "zygo" */
#define LARGEST_ANGLE 1e4
#define LARGEST_VALUE 1e6
#define LONGEST_INCREMENT 1000000u
/* Parts of tasks in a cycle without rows, which cost less than the rows; one more where these are compensated. */
#define IDLE_PARTS 2u
#define TURNS 4u    /* of the noise of sensors, from which on one turn may go without a part of a task */
#define SHORTEST 8u /* an instant that fails the bandwidth test ends an arc from this part of the longest on */

uint32_t zygos_abi(void)
{
    return ZYGOS_ABI;
}

static bool is_sign(double x)
{
    return zygos_within(x, 1.0, 1.0) || zygos_within(x, -1.0, -1.0);
}

static bool is_rotation(const double *r)
{
    bool good = true;
    for (uint32_t i = 0; i < 3; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            const double target = (i == j) ? 1.0 : 0.0;
            good = good && zygos_within(zygos_dot3(&r[3u * i], &r[3u * j]), target - 1e-9, target + 1e-9);
        }
    }
    const double determinant =
        r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) + r[2] * (r[3] * r[7] - r[4] * r[6]);
    return good && (determinant > 0.0);
}

/* Whether joint i has a node number that no other node before it has. */
static bool node_fits(const zygos_config_t *config, uint32_t i)
{
    const uint32_t node = config->joint[i].node;
    bool good = (node >= 1u) && (node <= 31u) && (node != config->imu_node);
    for (uint32_t j = 0; j < i; j++) {
        good = good && (node != config->joint[j].node);
    }
    return good;
}

static bool axis_fits(const zygos_config_t *config, uint32_t i)
{
    const zygos_joint_config_t *joint = &config->joint[i];
    const bool in_plane = (config->kinetic != ZYGOS_SPATIAL_ARM);
    return zygos_within(zygos_dot3(joint->axis, joint->axis), 1.0 - 1e-9, 1.0 + 1e-9) &&
           (in_plane ? zygos_within(zygos_dot3(joint->axis, config->joint[0].axis), 1.0 - 1e-9, 1.0 + 1e-9)
                     : is_rotation(joint->frame));
}

static bool encoder_fits(double sign, double zero_rad, double sigma_rad, double latch_s, double period_s)
{
    return is_sign(sign) && zygos_within(zero_rad, -1e3, 1e3) && zygos_within(sigma_rad, 0.0, 1.0) &&
           zygos_within(latch_s, 0.0, period_s);
}

static bool drive_fits(const zygos_config_t *config, uint32_t i)
{
    const zygos_joint_config_t *joint = &config->joint[i];
    const double latch_s = 1e-6 * joint->latch_us;
    const bool motor = zygos_within(joint->gear_ratio, 1e-3, 1e6) &&
                       encoder_fits(joint->motor_sign, joint->motor_zero_rad, joint->motor_sigma_rad,
                                    joint->motor_latch_s + latch_s, config->period_s);
    const bool link =
        (joint->rigid == 1u) ||
        ((joint->rigid == 0u) && encoder_fits(joint->link_sign, joint->link_zero_rad, joint->link_sigma_rad,
                                              joint->link_latch_s + latch_s, config->period_s));
    const bool torque = zygos_within(joint->torque_sigma, 0.0, LARGEST_VALUE) &&
                        zygos_within(joint->torque_relative_sigma, 0.0, 1.0) &&
                        zygos_within(joint->torque_gain_sigma, 0.0, 1.0);
    return motor && link && torque;
}

static int check_joint(const zygos_config_t *config, uint32_t i)
{
    if (!node_fits(config, i)) {
        return ZYGOS_E_NODE;
    }
    if (!axis_fits(config, i)) {
        return ZYGOS_E_AXIS;
    }
    return drive_fits(config, i) ? 1 : ZYGOS_E_VALUE;
}

static bool base_fits(const zygos_config_t *config)
{
    const double *g = config->gravity;
    if (config->base == ZYGOS_BASE_FREE) {
        return zygos_within(zygos_dot3(g, g), 0.0, 0.0);
    }
    return (config->base == ZYGOS_BASE_FIXED) && (config->imu_node == 0) && (config->momentum_arc_cycles == 0) &&
           zygos_within(zygos_dot3(g, g), 0.0, 1e6);
}

/* Whether an increment is even, has enough steps, and leaves a cycle for the row of each joint before the last three
   instants of a half. */
static bool increments_fit(const zygos_config_t *config)
{
    const uint32_t length = config->joint_row_cycles;
    return (length == 0) || ((ZYGOS_JOINT_ROWS != 0) && (length % 2u == 0) && (length >= ZYGOS_MIN_INCREMENT) &&
                             (length >= 2u * config->joints + 4u) && (length <= LONGEST_INCREMENT));
}

static bool arcs_fit(const zygos_config_t *config)
{
    const uint32_t shortest = ZYGOS_MIN_ARC_INSTANTS;
    const uint32_t momentum = config->momentum_arc_cycles;
    const bool none = (config->arc_cycles == 0) && zygos_joint_sums_suffice(config);
    return increments_fit(config) && (none || (config->arc_cycles >= shortest)) &&
           ((config->impulse_arc_cycles == 0) || (config->impulse_arc_cycles >= shortest)) &&
           ((momentum == 0) || ((ZYGOS_MOMENTUM != 0) && (momentum >= shortest)));
}

static bool smoother_fits(const zygos_config_t *config)
{
    const uint32_t m = config->smoother_half_width;
    return (m >= 2u) && (m <= ZYGOS_MAX_HALF_WIDTH) && (config->smoother_order >= 2u) &&
           (config->smoother_order <= 2u * m - 2u) && (config->smoother_lag == m);
}

static bool gyro_node_fits(const zygos_config_t *config)
{
    return ((config->imu_node >= 1u) || (config->base != ZYGOS_BASE_FREE)) && (config->imu_node <= 31u);
}

static bool values_fit(const zygos_config_t *config)
{
    return (config->imu_fine <= 1u) && is_rotation(config->imu_to_base) &&
           zygos_within(config->imu_latch_s, 0.0, config->period_s) && zygos_within(config->imu_sigma, 0.0, 1.0) &&
           zygos_within(config->forgetting_factor, 0.9, 1.0) && (config->compensation <= 2u * ZYGOS_MAX_JOINTS + 3u);
}

/* Checks what the others need to find their way in a configuration, and the base. */
static int check_kind(const zygos_config_t *config)
{
    if (config->abi != ZYGOS_ABI) {
        return ZYGOS_E_ABI;
    }
    if ((config->joints < 1u) || (config->joints > ZYGOS_MAX_JOINTS)) {
        return ZYGOS_E_JOINTS;
    }
    if (config->kinetic > (uint32_t)ZYGOS_LAST_KINETIC) {
        return ZYGOS_E_KINETIC;
    }
    return base_fits(config) ? 1 : ZYGOS_E_BASE;
}

int zygos_config_check(const zygos_config_t *config)
{
    if (config == NULL) {
        return ZYGOS_E_NULL;
    }
    const int kind = check_kind(config);
    if (kind < 0) {
        return kind;
    }
    if (!zygos_within(config->period_s, 1e-5, 0.065)) {
        return ZYGOS_E_PERIOD;
    }
    if (config->torque_law > ZYGOS_TORQUE_SAMPLED) {
        return ZYGOS_E_TORQUE_LAW;
    }
    if (!smoother_fits(config)) {
        return ZYGOS_E_SMOOTHER;
    }
    if (!arcs_fit(config)) {
        return ZYGOS_E_ARC;
    }
    if (!gyro_node_fits(config)) {
        return ZYGOS_E_NODE;
    }
    if (!values_fit(config)) {
        return ZYGOS_E_VALUE;
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const int verdict = check_joint(config, i);
        if (verdict < 0) {
            return verdict;
        }
    }
    const int effects = zygos_effects_check(config);
    return (effects < 0) ? effects : zygos_reduction_check(config);
}

/* Continues a fold of counts. The factor is odd, so that a flipped bit always changes the product, and in a way that
   none of another count makes good. */
static inline uint32_t with_count(uint32_t fold, uint32_t count)
{
    return (((fold << 16u) | (fold >> 16u)) ^ count) * 0x9E3779B1u;
}

/* The part of places_of() that many configurations do not have. */
static uint32_t further_places_of(const zygos_arm_t *self, uint32_t counts)
{
    const zygos_config_t *config = &self->sums.config;
    uint32_t fold = with_count(with_count(with_count(counts, config->effects), config->reductions), config->reduced);
    fold = with_count(with_count(with_count(fold, self->sums.column_map.reduced), config->momentum_arc_cycles),
                      config->joint_row_cycles);
    if (config->momentum_arc_cycles > 0) {
        const zygos_momentum_sums_t *sums = &self->sums.momentum;
        fold = with_count(with_count(with_count(fold, sums->columns), sums->components), sums->signals);
    }
    if (config->joint_row_cycles > 0) {
        const zygos_joint_sums_t *sums = &self->sums.joints;
        fold = with_count(with_count(with_count(fold, config->base), config->kinetic), sums->width);
        fold = with_count(with_count(with_count(fold, sums->increments), sums->slice), sums->share);
    }
    for (uint32_t e = 0; e < zygos_least(config->effects, (uint32_t)ZYGOS_MAX_EFFECTS); e++) {
        fold = with_count(with_count(fold, config->effect[e].kind), config->effect[e].joint);
        for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_JOINTS; i++) {
            fold = with_count(fold, self->sums.motors.column_map.effect[i][e]);
        }
    }
    for (uint32_t k = 0; k < zygos_least(config->reductions, (uint32_t)ZYGOS_MAX_REDUCTION); k++) {
        fold = with_count(with_count(fold, config->reduction[k].column), config->reduction[k].parameter);
    }
    return fold;
}

/* Of every count and index that follows from the configuration and with which a cycle addresses memory. */
static inline uint32_t places_of(const zygos_arm_t *self)
{
    const zygos_config_t *config = &self->sums.config;
    const zygos_column_map_t *map = &self->sums.column_map;
    const uint32_t further =
        config->momentum_arc_cycles | config->joint_row_cycles | config->effects | config->reductions;
    uint32_t fold = with_count(with_count(with_count(config->joints, config->torque_law), config->smoother_half_width),
                               map->kinetic);
    fold = with_count(with_count(with_count(with_count(fold, map->body), map->effects), map->count), map->parameters);
    fold =
        with_count(with_count(with_count(fold, self->smoother.joints), self->smoother.window), self->sums.energy.width);
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_JOINTS; i++) {
        fold = with_count(with_count(with_count(fold, map->joint[i]), map->rotor[i]),
                          self->sums.motors.column_map.count[i]);
    }
    return (further != 0) ? further_places_of(self, fold) : fold;
}

/* Of the places, counts and integrals that one cycle leaves to the next. A bit that flips there would spoil the rest of
   an arc. */
static uint64_t moving_of(const zygos_arm_t *self)
{
    const zygos_config_t *config = &self->sums.config;
    const zygos_balance_t *balance = &self->balance;
    const zygos_impulse_t *impulse = &self->impulse;
    uint32_t counts = zygos_folded_count(self->sums.arc, self->sums.ending);
    counts = zygos_folded_count(zygos_folded_count(counts, self->smoother.position), self->smoother.filled);
    counts = zygos_folded_count(zygos_folded_count(counts, balance->instants), balance->origin);
    counts = zygos_folded_count(counts, balance->torque_at);
    if (config->impulse_arc_cycles > 0) {
        counts = zygos_folded_count(zygos_folded_count(counts, impulse->instants), impulse->origin);
        counts = zygos_folded_count(counts, self->sums.motors.store.cycles);
    }
    if ((ZYGOS_MOMENTUM != 0) && (config->momentum_arc_cycles > 0)) {
        counts = zygos_folded_count(zygos_folded_count(counts, self->momentum.instants), self->momentum.origin);
        counts = zygos_folded_count(counts, self->sums.momentum.store.cycles);
    }
    uint64_t fold = ZYGOS_FOLDED(counts, balance, zygos_balance_t, work, dissipation_rate);
    fold = ZYGOS_FOLDED(fold, &self->previous, zygos_previous_cycle_t, reported, theta);
    fold = ZYGOS_FOLDED(fold, &self->sums.energy, zygos_accumulator_t, length, segment);
    if (config->impulse_arc_cycles > 0) {
        fold = ZYGOS_FOLDED(fold, impulse, zygos_impulse_t, impulse, past);
    }
    if ((ZYGOS_MOMENTUM != 0) && (config->momentum_arc_cycles > 0)) {
        fold = ZYGOS_FOLDED(fold, &self->momentum, zygos_momentum_t, attitude, past);
    }
    if (config->joint_row_cycles > 0) {
        fold = ZYGOS_FOLDED(fold, &self->joint, zygos_joint_t, position, reserved);
    }
    if (config->effects > 0) {
        fold = ZYGOS_FOLDED(fold, &balance->effects, zygos_effects_t, total, past);
        fold = ZYGOS_FOLDED(fold, impulse, zygos_impulse_t, total, before);
    }
    if (config->forgetting_factor < 1.0) {
        fold = zygos_fold_words(fold, self->sums.forgetting, sizeof self->sums.forgetting);
    }
    if (self->sums.ending != 0) {
        fold = zygos_fold_words(fold, self->sums.ended, sizeof self->sums.ended);
        fold = zygos_fold_words(fold, self->sums.ended_forgetting, sizeof self->sums.ended_forgetting);
    }
    return zygos_fold_end(fold);
}

/* Whether a cycle accesses nothing outside *self. Those that do not follow from the configuration change; they are
   compared with the configuration, which is verified before. */
static bool is_steady(const zygos_arm_t *self)
{
    const zygos_config_t *config = &self->sums.config;
    const zygos_accumulator_t *sums = &self->sums.energy;
    return (self->places == places_of(self)) && (self->moving == moving_of(self)) && zygos_store_steady(&sums->store) &&
           zygos_accumulator_steady(sums) &&
           ((config->impulse_arc_cycles == 0) || zygos_store_steady(&self->sums.motors.store)) &&
           ((config->momentum_arc_cycles == 0) || zygos_store_steady(&self->sums.momentum.store)) &&
           (self->smoother.position < self->smoother.window) &&
           (self->balance.torque_at <= config->smoother_half_width) &&
           ((config->joint_row_cycles == 0) ||
            (zygos_joint_intact(&self->joint, config) && zygos_joint_sums_steady(&self->sums.joints, config)));
}

/* What follows from the configuration alone. */
static void make_tables(zygos_arm_t *self)
{
    const zygos_config_t *own = &self->sums.config;
    zygos_balance_column_map(own, &self->sums.column_map);
    zygos_geometry_init(&self->geometry, own);
    zygos_smoother_init(&self->smoother, own);
    zygos_noise_init(&self->noise, own, &self->sums.column_map, &self->smoother);
    zygos_motor_sums_tables(&self->sums.motors, own, &self->smoother);
    zygos_momentum_sums_tables(&self->sums.momentum, own, &self->smoother);
    zygos_joint_sums_tables(&self->sums.joints, own, &self->sums.column_map, &self->smoother);
    self->sums.energy.width = self->sums.column_map.parameters + 2u;
    self->sums.energy.noisy = (own->compensation > 0) ? 1u : 0u;
    self->config_checksum = zygos_checksum_memory(0, own, sizeof *own);
    self->sums.checksum = zygos_sums_checksum(&self->sums);
    self->tables_checksum = zygos_tables_checksum(self);
    self->places = places_of(self);
}

static bool equal(double a, double b)
{
    return (a <= b) && (a >= b);
}

/* Whether the compiler kept IEEE arithmetic. Operands are read as volatile, so that nothing is computed before the
   program runs; what a flag breaks is folded or reordered all the same. */
static bool is_ieee(void)
{
    static const double operands[] = { 1e308, 1e16, 1.0, 49.0 };
    const volatile double *read = operands;
    const double large = read[0];
    const double infinite = large * 10.0;
    const double nan = infinite - infinite;
    if (equal(nan, nan) || (nan <= large) || (nan >= large) || (infinite <= DBL_MAX)) {
        return false;
    }
    const double huge = read[1];
    const double one = read[2];
    const double divisor = read[3];
    return equal((huge + one) - huge, 0.0) && equal((49.0 * one) / divisor, 1.0) &&
           equal((98.0 * one) / divisor, 2.0) && equal((147.0 * one) / divisor, 3.0);
}

/* The windows of the signals are empty, and every integral begins. */
static void begin_integrals(zygos_arm_t *self)
{
    zygos_smoother_reset(&self->smoother);
    zygos_balance_reset(&self->balance);
    zygos_impulse_reset(&self->impulse);
    zygos_momentum_reset(&self->momentum);
    zygos_joint_reset(&self->joint, &self->sums.config);
}

/* The integrals of a kind of rows begin an arc. */
static inline void begin_arc(zygos_arm_t *self, uint32_t kind)
{
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        zygos_balance_new_arc(&self->balance);
    } else if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        zygos_impulse_new_arc(&self->impulse);
    } else {
        zygos_momentum_new_arc(&self->momentum);
    }
}

int zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config)
{
    if ((self == NULL) || (config == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (!is_ieee()) {
        return ZYGOS_E_ARITHMETIC;
    }
    const int verdict = zygos_config_check(config);
    if (verdict < 0) {
        return verdict;
    }
    memmove(&self->sums.config, config, sizeof self->sums.config); /* config may point into *self */
    unsigned char *behind = (unsigned char *)(&self->sums.config + 1);
    memset(self, 0, offsetof(zygos_arm_t, sums.config));
    memset(behind, 0, sizeof *self - offsetof(zygos_arm_t, sums.config) - sizeof self->sums.config);
    make_tables(self);
    zygos_receiver_init(&self->receiver);
    begin_integrals(self);
    for (uint32_t kind = 0; kind < ZYGOS_KINDS_OF_SUMS; kind++) {
        zygos_sums_clear(&self->sums, kind);
    }
    self->moving = moving_of(self);
    self->magic = MAGIC;
    return 1;
}

/* Returns 1 where a call may go on, whose other argument is given: or *self. */
static inline int begun(const zygos_arm_t *self, const void *argument)
{
    if ((self == NULL) || (argument == NULL)) {
        return ZYGOS_E_NULL;
    }
    return (self->magic == MAGIC) ? 1 : ZYGOS_E_ORDER;
}

int zygos_arm_frame(zygos_arm_t *self, const zygos_frame_t *frame)
{
    const int verdict = begun(self, frame);
    return (verdict < 0) ? verdict : zygos_receiver_frame(&self->receiver, &self->sums.config, frame);
}

/* ---------------------------------------------------------------- ends of arcs

   An arc that ends while the one before it is closing waits until that one is closed, which would cost many times a
   cycle at once. There are no rows of its kind in that time. */

static bool is_held(const zygos_arm_t *self, uint32_t kind)
{
    return ((self->held >> kind) & 1u) != 0;
}

/* Whether the end of the open arc would first have to finish tasks, or change sums that are being copied. Blocks of
   closed arcs that merge have to be whole before they fade. */
static bool has_to_wait(const zygos_arm_t *self, uint32_t kind)
{
    return (is_held(self, kind) || !zygos_sums_can_close(&self->sums, kind)) && !zygos_sums_is_short(&self->sums, kind);
}

/* Ends the open arc, or lets it wait for that. */
static void end_in_turn(zygos_arm_t *self, uint32_t kind)
{
    if (!has_to_wait(self, kind)) {
        zygos_sums_end_arc(&self->sums, kind, self->sums.cycle);
        return;
    }
    double *forgetting = &self->sums.forgetting[kind];
    self->sums.ending |= 1u << kind;
    self->sums.ended[kind] = self->sums.cycle;
    self->sums.ended_forgetting[kind] = *forgetting;
    *forgetting = 1.0;
}

/* Ends those arcs that no longer have to wait. */
static void end_free(zygos_arm_t *self)
{
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        if (!has_to_wait(self, kind)) {
            zygos_sums_end_waiting(&self->sums, kind);
        }
    }
}

static void gap(zygos_arm_t *self)
{
    self->gaps += (self->smoother.filled > 0) ? 1u : 0u;
    begin_integrals(self);
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        if (!zygos_sums_is_ending(&self->sums, kind)) {
            end_in_turn(self, kind);
        }
    }
}

/* Adds rows that wait to the blocks. Returns how many parts of tasks, with that, cost less than an energy row. */
static uint32_t share_rows(zygos_arm_t *self)
{
    const uint32_t most = IDLE_PARTS + ((self->sums.config.compensation > 0) ? 1u : 0u);
    const bool shared = zygos_accumulator_share_slices(&self->sums.energy);
    return (shared && (self->sums.energy.width > ZYGOS_WIDE)) ? 1u : most;
}

static void proceed_energy(zygos_arm_t *self)
{
    if ((self->sums.config.arc_cycles > 0) && !is_held(self, (uint32_t)ZYGOS_ENERGY_ROWS)) {
        zygos_guard_proceed(&self->sums, (uint32_t)ZYGOS_ENERGY_ROWS);
    }
}

static bool may_proceed(const zygos_arm_t *self, uint32_t kind)
{
    return zygos_sums_has_work(&self->sums, kind) && !is_held(self, kind);
}

/* The tasks proceed in a cycle without rows. */
static void idle(zygos_arm_t *self)
{
    const uint32_t most = share_rows(self);
    const bool dear = (self->beside != 0) || (self->smoother.filled <= 1u); /* behind a gap */
    const uint32_t parts = (dear && (most > 1u)) ? most - 1u : most;
    for (uint32_t part = 0; part < parts; part++) {
        uint32_t kind = (uint32_t)ZYGOS_MOTOR_ROWS;
        while ((kind < (uint32_t)ZYGOS_KINDS_OF_ROWS) && !may_proceed(self, kind)) {
            kind++;
        }
        if (kind < (uint32_t)ZYGOS_KINDS_OF_ROWS) {
            zygos_guard_proceed(&self->sums, kind);
        } else {
            proceed_energy(self);
        }
        if (self->sums.ending != 0) {
            end_free(self);
        }
    }
}

/* Drops what reaches into the cycles that cannot be trusted. No row of its kind is newer than an arc that waits. */
static void void_arcs(zygos_arm_t *self, const zygos_cycle_t *cycle)
{
    if (!(cycle->flags & ZYGOS_CYCLE_VOID)) {
        return;
    }
    const uint64_t doubtful = cycle->flags >> ZYGOS_CYCLE_VOID_SHIFT;
    const uint64_t trusted = (doubtful < cycle->sync) ? cycle->sync - doubtful : 0u;
    if ((doubtful != 0) && (self->sums.cycle <= trusted)) {
        return;
    }
    self->sums.dropped++;
    zygos_sums_drop_after(&self->sums, ZYGOS_JOINT_KIND, trusted);
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        if (!zygos_sums_is_ending(&self->sums, kind) || (self->sums.ended[kind] > trusted)) {
            zygos_sums_drop_waiting(&self->sums, kind); /* with the open arc, as which it counts */
            zygos_sums_drop_after(&self->sums, kind, trusted);
        }
    }
}

/* No cycle is processed before zygos_arm_scrub(), which computes the number anew. */
static void suspect(zygos_arm_t *self)
{
    self->places = ~places_of(self);
}

/* An instant without a row, because an arc of that kind waits; the last such one where the arc can end. */
static void go_without_row(zygos_arm_t *self, uint32_t kind)
{
    self->waited[kind]++;
    if (!has_to_wait(self, kind)) {
        zygos_sums_end_waiting(&self->sums, kind);
    }
}

/* Whether this cycle is not for the tasks of these rows: with short arcs they always have one. Every other cycle is for
   those of the energy rows, and every fourth one for those of the momentum rows where these wait. */
static bool yields(const zygos_arm_t *self, uint32_t kind)
{
    const uint32_t turn = (uint32_t)(self->cycles & 3u);
    const bool momentum = zygos_sums_is_ending(&self->sums, (uint32_t)ZYGOS_MOMENTUM_ROWS) && (turn == 1u);
    const bool energy = zygos_sums_has_work(&self->sums, (uint32_t)ZYGOS_ENERGY_ROWS) && ((turn & 1u) == 0);
    return energy || (momentum && (kind == (uint32_t)ZYGOS_MOTOR_ROWS));
}

/* Returns whether a task of these rows has proceeded. */
static bool proceed_beside(zygos_arm_t *self, uint32_t kind)
{
    if (yields(self, kind) || !may_proceed(self, kind)) {
        return false;
    }
    zygos_guard_proceed(&self->sums, kind);
    return true;
}

/* Ends an instant of motor or momentum rows, which have arcs of their own: a task proceeds, and the arc ends where it
   is the longest, or goes on waiting for that. busy: this cycle has done something that costs as much as the part of a
   task; one is enough. Returns the same. */
static inline bool end_instant(zygos_arm_t *self, uint32_t kind, bool busy)
{
    const bool waits = zygos_sums_is_ending(&self->sums, kind);
    busy = busy || proceed_beside(self, kind);
    if (waits) {
        go_without_row(self, kind);
        begin_arc(self, kind);
    } else if (zygos_sums_store(&self->sums, kind)->cycles >= zygos_store_longest(&self->sums.config, kind)) {
        end_in_turn(self, kind);
        begin_arc(self, kind);
        busy = true; /* an arc was copied */
    }
    return busy;
}

/* The motor impulse rows of the newest instant. busy: as above. Returns the same. */
static bool add_impulses(zygos_arm_t *self, bool busy)
{
    const zygos_config_t *config = &self->sums.config;
    if ((config->impulse_arc_cycles == 0) ||
        (zygos_impulse_row(&self->impulse, config, &self->sums.motors.column_map, &self->arm_state, &self->motion,
                           zygos_balance_torque_before(&self->balance),
                           zygos_balance_torque_after(&self->balance, config), &self->impulse_rows) == 0)) {
        return busy;
    }
    if (!zygos_sums_is_ending(&self->sums, (uint32_t)ZYGOS_MOTOR_ROWS)) {
        zygos_motor_sums_add(&self->sums.motors, config, &self->impulse_rows, self->arm_state.accepted);
    }
    return end_instant(self, (uint32_t)ZYGOS_MOTOR_ROWS, busy);
}

/* The momentum row of the newest instant whose turn it is. busy: as above. Returns the same. */
static bool add_momentum(zygos_arm_t *self, bool busy)
{
    const zygos_config_t *config = &self->sums.config;
    if ((ZYGOS_MOMENTUM == 0) || (config->momentum_arc_cycles == 0) || (self->sums.momentum.components == 0) ||
        (zygos_momentum_advance(&self->momentum, config, &self->arm_state) == 0)) {
        return busy;
    }
    if (!zygos_sums_is_ending(&self->sums, (uint32_t)ZYGOS_MOMENTUM_ROWS)) {
        zygos_momentum_sums_add(&self->sums.momentum, config, &self->momentum, &self->arm_state, &self->motion,
                                self->arm_state.accepted);
    }
    return end_instant(self, (uint32_t)ZYGOS_MOMENTUM_ROWS, busy);
}

/* The joint rows: integrals of the newest instant, the row that is due, and the next part of a complete segment.
   Returns whether there was a row. */
static bool add_joints(zygos_arm_t *self)
{
    const zygos_config_t *config = &self->sums.config;
    if ((ZYGOS_JOINT_ROWS == 0) || (config->joint_row_cycles == 0)) {
        return false;
    }
    if (zygos_joint_sums_step(&self->sums.joints, config, self->arm_state.accepted,
                              self->joint.turn < config->joints)) {
        zygos_guard_end_joints(&self->sums);
    }
    const int formed = zygos_joint_row(&self->joint, config, &self->sums.column_map, &self->geometry, &self->arm_state,
                                       &self->motion, zygos_balance_torque_before(&self->balance),
                                       zygos_balance_torque_after(&self->balance, config), &self->joint_row);
    if (formed <= 0) {
        self->sums.joints.quarantined += (formed < 0) ? 1u : 0u;
        return false;
    }
    zygos_joint_sums_add(&self->sums.joints, config, &self->sums.column_map, &self->joint, &self->joint_row);
    return true;
}

/* The energy row of the newest instant. busy: as above. */
static void add_energy(zygos_arm_t *self, bool busy)
{
    const zygos_config_t *config = &self->sums.config;
    zygos_row_t columns; /* before they are reduced, where they are */
    zygos_row_t *row = (config->reduced > 0) ? &columns : &self->row;
    if ((config->arc_cycles == 0) ||
        (zygos_balance_row(&self->balance, config, &self->sums.column_map, &self->noise.integral_bias, &self->arm_state,
                           &self->motion, row) == 0)) {
        return;
    }
    if (zygos_sums_is_ending(&self->sums, (uint32_t)ZYGOS_ENERGY_ROWS)) {
        const uint32_t most = share_rows(self);
        const uint32_t parts = busy ? 1u : most;
        for (uint32_t part = 0; part < parts; part++) {
            proceed_energy(self);
        }
        go_without_row(self, (uint32_t)ZYGOS_ENERGY_ROWS);
        zygos_balance_new_arc(&self->balance);
        return;
    }
    self->instant = 1;
    self->accepted = self->arm_state.accepted;
    zygos_noise_means(&self->noise, config, &self->motion, row);
    if (config->reduced > 0) {
        zygos_reduce(config, &self->sums.column_map, columns.column, self->row.column);
        self->row.work = columns.work;
        self->row.variance = columns.variance;
    }
    zygos_noise_sums_t *noise = &self->sums.energy.noise_open[self->sums.energy.store.parity];
    zygos_row_buffer_t *buffer = &self->sums.energy.buffer[self->sums.energy.filling];
    const zygos_noise_target_t target = { noise->gram, noise->sum, buffer->gram, buffer->sum };
    const bool whole =
        zygos_noise_add(&self->noise, config, &self->sums.column_map, &self->geometry, &self->arm_state, &self->motion,
                        zygos_balance_torque_before(&self->balance), zygos_balance_torque_after(&self->balance, config),
                        self->sums.arc, self->arm_state.accepted, &target);
    const bool opened = zygos_accumulator_add(&self->sums.energy, &self->row, self->arm_state.accepted);
    /* The noise of the first link is that of all bodies, which costs the most. */
    const bool dear = (config->compensation > TURNS) && (self->sums.arc % config->compensation == 0);
    if (!opened && !busy && !dear) {
        proceed_energy(self);
    }
    if (!whole) {
        suspect(self);
    }
    self->sums.arc++;
    /* Where the motion is too fast for the smoother, the error of the integrals is a constant of the following arc. A
       factor is used instead of a branch, so that the instructions of a cycle do not depend on its data. */
    const double shortest = (double)(config->arc_cycles / SHORTEST);
    const double longest = (double)config->arc_cycles;
    if ((double)self->sums.arc >= shortest + self->arm_state.accepted * (longest - shortest)) {
        end_in_turn(self, (uint32_t)ZYGOS_ENERGY_ROWS);
        zygos_balance_new_arc(&self->balance);
    }
}

/* The share of what is in the open arcs that is left when they close. */
static void forget(zygos_sums_t *sums)
{
    const double factor = sums->config.forgetting_factor;
    sums->forgetting[ZYGOS_ENERGY_ROWS] *= factor;
    sums->forgetting[ZYGOS_MOTOR_ROWS] *= factor;
    sums->forgetting[ZYGOS_MOMENTUM_ROWS] *= (ZYGOS_MOMENTUM != 0) ? factor : 1.0;
    sums->forgetting[ZYGOS_JOINT_KIND] *= factor;
}

/* Calibrates a cycle. Returns whether its signals are used: link and motor angles may be too far apart. */
static inline bool receive(zygos_arm_t *self, const zygos_cycle_t *cycle, double *signal, double *tau)
{
    const uint32_t broken = (uint32_t)ZYGOS_CYCLE_BREAK | (uint32_t)ZYGOS_CYCLE_VOID;
    const bool follows = (self->cycles > 0) && (cycle->sync == self->sums.cycle + 1u) && !(cycle->flags & broken);
    const bool wrapped = follows && (zygos_cycle_wrapped(&self->previous, &self->sums.config, cycle) == 1);
    zygos_cycle_calibrate(&self->previous, &self->sums.config, cycle, signal, tau);
    const bool apart = (zygos_cycle_apart(signal, self->sums.config.joints) == 1);
    self->wraps += wrapped ? 1u : 0u;
    self->apart += apart ? 1u : 0u;
    void_arcs(self, cycle);
    if (!follows || wrapped || (apart && (self->smoother.filled > 0))) {
        gap(self);
    }
    self->sums.cycle = cycle->sync;
    self->cycles++;
    forget(&self->sums);
    self->instant = 0;
    return !apart;
}

static void process_cycle(zygos_arm_t *self, const zygos_cycle_t *cycle)
{
    double signal[ZYGOS_MAX_SIGNALS];
    double tau[ZYGOS_MAX_JOINTS];
    if (!receive(self, cycle, signal, tau)) {
        return;
    }
    zygos_balance_torque(&self->balance, &self->sums.config, tau);
    const int smoothed = zygos_smoother_push(&self->smoother, signal, &self->arm_state);
    if ((smoothed < 0) || !zygos_balance_torque_is_whole(&self->balance, &self->sums.config)) {
        suspect(self);
    }
    if (smoothed != 1) {
        idle(self);
        return;
    }
    zygos_kinematics(&self->geometry, &self->sums.config, &self->arm_state, &self->motion);
    self->added = (self->arm_state.accepted > 0.0) ? self->sums.cycle : self->added;
    const bool busy = add_joints(self) || (self->beside != 0);
    add_energy(self, add_momentum(self, add_impulses(self, busy)));
}

/* Whether what is used as a place, a count or a length can be. What follows from the configuration is computed anew. */
static bool is_intact(const zygos_arm_t *self)
{
    return (zygos_config_check(&self->sums.config) >= 0) && zygos_receiver_intact(&self->receiver) &&
           zygos_joint_intact(&self->joint, &self->sums.config) && zygos_sums_are_intact(&self->sums) &&
           zygos_guard_intact(&self->sums.guard) && (self->sums.ending < (1u << ZYGOS_KINDS_OF_ROWS));
}

int zygos_arm_resume(zygos_arm_t *self, const zygos_config_t *config)
{
    int verdict = begun(self, config);
    verdict = (verdict < 0) ? verdict : zygos_config_check(config);
    if (verdict < 0) {
        return verdict;
    }
    if (!zygos_is_same(&self->sums.config, config, (uint32_t)sizeof *config)) {
        return ZYGOS_E_CONFIG;
    }
    if (!is_intact(self)) {
        return ZYGOS_E_STATE;
    }
    self->gaps += (self->smoother.filled > 0) ? 1u : 0u; /* before the tables empty the smoother */
    make_tables(self);
    self->scrubbed = self->sums.cycle;
    gap(self);
    zygos_sums_settle(&self->sums);
    self->instant = 0;
    zygos_receiver_resume(&self->receiver);
    self->moving = moving_of(self);
    return 1;
}

/* Ends the arcs before a cycle whose values must not be used, and counts it. Flags that have changed with the values
   drop an arc at worst. */
static void leave_cycle_out(zygos_arm_t *self, const zygos_cycle_t *cycle)
{
    self->invalid++;
    self->instant = 0;
    void_arcs(self, cycle);
    gap(self);
}

int zygos_arm_step(zygos_arm_t *self)
{
    const int verdict = begun(self, self);
    if (verdict < 0) {
        return verdict;
    }
    if (!zygos_receiver_intact(&self->receiver)) {
        return ZYGOS_E_STATE;
    }
    const zygos_cycle_t *cycle = zygos_receiver_front(&self->receiver);
    if (cycle == NULL) {
        return 0;
    }
    if (!is_steady(self)) {
        return ZYGOS_E_STATE;
    }
    if (zygos_receiver_front_is_whole(&self->receiver, &self->sums.config)) {
        process_cycle(self, cycle);
    } else {
        leave_cycle_out(self, cycle);
    }
    self->moving = moving_of(self);
    zygos_receiver_pop(&self->receiver);
    return 1;
}

static bool usable(const zygos_config_t *config, const zygos_cycle_t *cycle)
{
    bool good = (cycle->flags & ZYGOS_CYCLE_INVALID) == 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        good = good && ((config->joint[i].rigid != 0) || zygos_within(cycle->q[i], -LARGEST_ANGLE, LARGEST_ANGLE)) &&
               zygos_within(cycle->theta[i], -LARGEST_ANGLE, LARGEST_ANGLE) &&
               zygos_within(cycle->tau[i], -LARGEST_VALUE, LARGEST_VALUE);
    }
    for (uint32_t i = 0; (i < 3) && (config->base == ZYGOS_BASE_FREE); i++) {
        good = good && zygos_within(cycle->omega[i], -LARGEST_VALUE, LARGEST_VALUE);
    }
    return good;
}

int zygos_arm_cycle(zygos_arm_t *self, const zygos_cycle_t *cycle)
{
    const int verdict = begun(self, cycle);
    if (verdict < 0) {
        return verdict;
    }
    if (!is_steady(self)) {
        return ZYGOS_E_STATE;
    }
    if (!usable(&self->sums.config, cycle)) {
        leave_cycle_out(self, cycle);
        self->moving = moving_of(self);
        return 0;
    }
    process_cycle(self, cycle);
    self->moving = moving_of(self);
    return 1;
}

int zygos_arm_end_arcs(zygos_arm_t *self)
{
    const int verdict = begun(self, self);
    if (verdict < 0) {
        return verdict;
    }
    if (!is_steady(self) || !is_intact(self)) {
        return ZYGOS_E_STATE;
    }
    zygos_sums_settle(&self->sums);
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        zygos_sums_end_arc(&self->sums, kind, self->sums.cycle);
        begin_arc(self, kind);
    }
    zygos_sums_end_segment(&self->sums);
    zygos_sums_settle(&self->sums);
    self->moving = moving_of(self);
    return 1;
}

void zygos_arm_take(const zygos_arm_t *self, zygos_work_t *work)
{
    if ((self == NULL) || (work == NULL)) {
        return;
    }
    work->sums = self->sums;
}

int zygos_arm_adopt(zygos_arm_t *self, const zygos_estimate_t *estimate)
{
    const int verdict = begun(self, estimate);
    if (verdict < 0) {
        return verdict;
    }
    if (!is_steady(self) || !is_intact(self)) {
        return ZYGOS_E_STATE;
    }
    self->sums.guard.adopting = 1;
    zygos_sums_settle(&self->sums);
    self->sums.dropped++; /* tasks were finished at once */
    const bool adopted = zygos_guard_adopt(&self->sums, estimate);
    self->moving = moving_of(self);
    return adopted ? 1 : 0;
}

int zygos_arm_check(const zygos_arm_t *self, const zygos_config_t *config, zygos_work_t *work)
{
    if ((self == NULL) || (config == NULL) || (work == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (self->magic != MAGIC) {
        return ZYGOS_E_ORDER;
    }
    if (!zygos_is_same(&self->sums.config, config, (uint32_t)sizeof *config)) {
        return ZYGOS_E_CONFIG;
    }
    if (!is_intact(self)) {
        return ZYGOS_E_STATE;
    }
    zygos_arm_take(self, work);
    return zygos_sums_end_copy(&work->sums) ? 1 : ZYGOS_E_SUMS;
}

/* Drops what has not ended: windows, integrals and open arcs. */
static void drop_unended(zygos_arm_t *self)
{
    begin_integrals(self);
    self->smoother.position = 0;
    for (uint32_t kind = 0; kind < ZYGOS_KINDS_OF_SUMS; kind++) {
        zygos_sums_drop_waiting(&self->sums, kind);
        zygos_sums_drop_after(&self->sums, kind, self->sums.cycle);
    }
    self->sums.ending = 0; /* without bits of other kinds, which memory may supply */
    self->sums.arc = 0;
    self->instant = 0;
}

/* Indices and flags that change. Returns what was found. */
static uint32_t scrub_places(zygos_arm_t *self)
{
    uint32_t found = 0;
    if (!zygos_receiver_intact(&self->receiver)) {
        self->receiver.queue.head = 0;
        self->receiver.queue.tail = 0;
        zygos_receiver_resume(&self->receiver);
        found = (uint32_t)ZYGOS_SCRUBBED_PLACES;
    }
    if (!is_steady(self)) {
        drop_unended(self);
        found = (uint32_t)ZYGOS_SCRUBBED_PLACES;
    }
    if (!zygos_guard_intact(&self->sums.guard)) {
        zygos_guard_clear(&self->sums.guard, false, self->sums.cycle);
        found = (uint32_t)ZYGOS_SCRUBBED_PLACES;
    }
    return found;
}

uint32_t zygos_arm_count_quarantined(zygos_arm_t *self)
{
    const uint32_t dropped = zygos_sums_quarantined(&self->sums);
    self->sums.energy.store.quarantined = 0;
    self->sums.motors.store.quarantined = 0;
    self->sums.momentum.store.quarantined = 0;
    self->sums.joints.quarantined = 0;
    self->quarantined += dropped;
    return dropped;
}

bool zygos_arm_is_whole(const zygos_arm_t *self)
{
    return (self->magic == MAGIC) && is_steady(self) && is_intact(self);
}

/* Returns what was found. */
static uint32_t scrub_sums(zygos_arm_t *self)
{
    const uint32_t found = (zygos_sums_scrub(&self->sums) > 0) ? (uint32_t)ZYGOS_SCRUBBED_SUMS : 0u;
    return found | ((zygos_arm_count_quarantined(self) > 0) ? (uint32_t)ZYGOS_SCRUBBED_BLOCKS : 0u);
}

/* Drops every arc with a cycle behind the last call. */
static void drop_unverified(zygos_arm_t *self)
{
    const uint64_t trusted = self->scrubbed;
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        zygos_sums_drop_after(&self->sums, kind, trusted);
    }
    if (self->sums.joints.end > trusted) { /* segments cannot be taken out of a group */
        zygos_joint_sums_clear(&self->sums.joints);
    }
    drop_unended(self);
    zygos_guard_clear(&self->sums.guard, false, self->sums.cycle);
}

/* Compares the configuration with the caller's, and repairs it. Returns bits of enum zygos_scrubbed, or
   ZYGOS_E_CONFIG where the caller's is not the one that was given. */
static int scrub_config(zygos_arm_t *self, const zygos_config_t *config)
{
    if (zygos_is_same(&self->sums.config, config, (uint32_t)sizeof *config)) {
        return 0;
    }
    const uint64_t checksum = zygos_checksum_memory(0, &self->sums.config, sizeof self->sums.config);
    if ((self->config_checksum == checksum) ||
        (self->config_checksum != zygos_checksum_memory(0, config, sizeof *config))) {
        return ZYGOS_E_CONFIG;
    }
    self->sums.config = *config;
    zygos_receiver_resume(&self->receiver); /* what waits may lack joints that it did not name */
    return (int)ZYGOS_SCRUBBED_CONFIG;
}

static bool are_arm_tables_whole(const zygos_arm_t *self)
{
    return (self->config_checksum == zygos_checksum_memory(0, &self->sums.config, sizeof self->sums.config)) &&
           (self->tables_checksum == zygos_tables_checksum(self)) && (self->places == places_of(self));
}

/* Settles what flipped in the guard, and what an arc that was ending left. Returns bits of enum zygos_scrubbed. */
static uint32_t settle(zygos_arm_t *self)
{
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        if (zygos_sums_is_intact(&self->sums, kind, &self->sums.column_map)) {
            zygos_guard_settle(&self->sums, kind);
        }
    }
    if (!is_steady(self)) {
        return (uint32_t)ZYGOS_SCRUBBED_PLACES;
    }
    if (self->sums.ending != 0) {
        zygos_sums_settle(&self->sums);
    }
    return 0;
}

int zygos_arm_scrub(zygos_arm_t *self, const zygos_config_t *config)
{
    if ((self == NULL) || (config == NULL)) {
        return ZYGOS_E_NULL;
    }
    const uint32_t off = self->magic ^ MAGIC;
    if ((off & (off - 1u)) != 0) {
        return ZYGOS_E_ORDER;
    }
    if ((config == &self->sums.config) || (zygos_config_check(config) < 0)) {
        return ZYGOS_E_CONFIG;
    }
    const int compared = scrub_config(self, config);
    if (compared < 0) {
        return compared;
    }
    uint32_t found = (uint32_t)compared | ((off != 0) ? (uint32_t)ZYGOS_SCRUBBED_PLACES : 0u);
    self->magic = MAGIC;
    found |= are_arm_tables_whole(self) ? 0u : (uint32_t)ZYGOS_SCRUBBED_TABLES;
    const bool rebuilt = (found & ((uint32_t)ZYGOS_SCRUBBED_CONFIG | (uint32_t)ZYGOS_SCRUBBED_TABLES)) != 0u;
    const bool unmoved = (self->moving == moving_of(self));
    if (rebuilt) {
        make_tables(self); /* which empties the smoother */
        self->moving = unmoved ? moving_of(self) : self->moving;
    }
    found |= settle(self);
    found |= scrub_sums(self);
    self->moving = unmoved ? moving_of(self) : self->moving;
    found |= scrub_places(self);
    if (rebuilt) {
        drop_unverified(self);
    }
    self->scrubbed = self->sums.cycle;
    self->moving = moving_of(self);
    return (int)found;
}

int zygos_arm_restart(zygos_arm_t *self, uint32_t keep)
{
    int verdict = begun(self, self);
    verdict = (verdict < 0) ? verdict : zygos_config_check(&self->sums.config);
    if (verdict < 0) {
        return verdict;
    }
    const uint32_t known = (uint32_t)ZYGOS_KEEP_FAULTS | (uint32_t)ZYGOS_KEEP_JOINTS;
    const bool joints = (keep & (uint32_t)ZYGOS_KEEP_JOINTS) != 0;
    if (((keep & ~known) != 0) || (joints && (self->sums.config.impulse_arc_cycles == 0))) {
        return ZYGOS_E_KEEP;
    }
    if ((keep & ZYGOS_KEEP_FAULTS) == 0) {
        memset(&self->receiver.faults, 0, sizeof self->receiver.faults);
        self->gaps = 0;
        self->invalid = 0;
        self->wraps = 0;
        self->apart = 0;
        memset(self->waited, 0, sizeof self->waited);
    }
    (void)zygos_receiver_discard(&self->receiver);
    make_tables(self); /* memory may have been changed there */
    self->scrubbed = self->sums.cycle;
    begin_integrals(self);
    const uint32_t motors = (uint32_t)ZYGOS_MOTOR_ROWS;
    const bool kept = joints && zygos_sums_is_intact(&self->sums, motors, &self->sums.column_map);
    if (kept) { /* the other sums, which may be corrupt, are cleared */
        zygos_guard_settle(&self->sums, motors);
        zygos_sums_end_waiting(&self->sums, motors);
        zygos_guard_settle(&self->sums, motors);
        zygos_sums_end_arc(&self->sums, motors, self->sums.cycle);
        zygos_guard_settle(&self->sums, motors);
    }
    for (uint32_t kind = 0; kind < ZYGOS_KINDS_OF_SUMS; kind++) {
        if (!kept || (kind != motors)) {
            zygos_sums_clear(&self->sums, kind);
        }
    }
    zygos_guard_clear(&self->sums.guard, (keep & ZYGOS_KEEP_FAULTS) == 0, self->sums.cycle);
    self->sums.arc = 0;
    self->sums.ending = 0;
    self->instant = 0;
    self->held = 0;
    self->beside = 0;
    self->moving = moving_of(self);
    return 1;
}
