#include "zygos/priv/sums.h"

#include "zygos/priv/effects.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>

/* ---------------------------------------------------------------- one kind of rows */

void zygos_sums_drop_waiting(zygos_sums_t *self, uint32_t kind)
{
    if (kind >= (uint32_t)ZYGOS_KINDS_OF_ROWS) {
        return;
    }
    if (zygos_sums_is_ending(self, kind)) {
        self->forgetting[kind] *= self->ended_forgetting[kind];
        self->ending ^= 1u << kind;
    }
    self->ended_forgetting[kind] = 1.0;
}

void zygos_sums_clear(zygos_sums_t *self, uint32_t kind)
{
    zygos_sums_drop_waiting(self, kind);
    const zygos_config_t *config = &self->config;
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        zygos_accumulator_init(&self->energy, self->column_map.parameters, config->arc_cycles, config->period_s);
        break;
    case ZYGOS_MOTOR_ROWS:
        zygos_motor_sums_clear(&self->motors, config);
        break;
    case ZYGOS_MOMENTUM_ROWS:
        zygos_momentum_sums_clear(&self->momentum, config);
        break;
    default:
        zygos_joint_sums_clear(&self->joints);
        break;
    }
    self->forgetting[kind] = 1.0;
}

bool zygos_sums_is_intact(const zygos_sums_t *self, uint32_t kind, const zygos_column_map_t *column_map)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_intact(&self->energy, column_map->parameters);
    case ZYGOS_MOTOR_ROWS:
        return zygos_motor_sums_intact(&self->motors, &self->config);
    case ZYGOS_MOMENTUM_ROWS:
        return zygos_momentum_sums_intact(&self->momentum, &self->config);
    default:
        return zygos_joint_sums_intact(&self->joints, &self->config, column_map);
    }
}

bool zygos_sums_is_busy(const zygos_sums_t *self, uint32_t kind)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_busy(&self->energy);
    case ZYGOS_MOTOR_ROWS:
        return self->motors.task != ZYGOS_MOTOR_NONE;
    default:
        return self->momentum.task != ZYGOS_MOMENTUM_NONE;
    }
}

/* Whether no task changes the sums of closed arcs, and no arc waits for its admission. */
static bool rests(const zygos_sums_t *self, uint32_t kind)
{
    return (kind == (uint32_t)ZYGOS_ENERGY_ROWS) ? zygos_accumulator_rests(&self->energy)
                                                 : !zygos_sums_is_busy(self, kind);
}

bool zygos_sums_can_close(const zygos_sums_t *self, uint32_t kind)
{
    return (kind == (uint32_t)ZYGOS_ENERGY_ROWS) ? !zygos_accumulator_closing(&self->energy) &&
                                                       ((self->config.forgetting_factor >= 1.0) || rests(self, kind))
                                                 : !zygos_sums_is_busy(self, kind);
}

bool zygos_sums_is_short(const zygos_sums_t *self, uint32_t kind)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_is_short(&self->energy);
    case ZYGOS_MOTOR_ROWS:
        return zygos_motor_sums_is_short(&self->motors);
    default:
        return zygos_momentum_sums_is_short(&self->momentum);
    }
}

/* Ends the open arc, without a task. */
static void close_arc(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        (void)zygos_accumulator_close(&self->energy, cycle, self->arc);
        self->arc = 0;
        break;
    case ZYGOS_MOTOR_ROWS:
        (void)zygos_motor_sums_close(&self->motors, cycle);
        break;
    default:
        (void)zygos_momentum_sums_close(&self->momentum, cycle);
        break;
    }
}

static void forget(zygos_sums_t *self, uint32_t kind, double factor)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        zygos_accumulator_forget(&self->energy, factor);
        break;
    case ZYGOS_MOTOR_ROWS:
        zygos_motor_sums_forget(&self->motors, factor);
        break;
    default:
        zygos_momentum_sums_forget(&self->momentum, factor);
        break;
    }
}

void zygos_sums_end_arc(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    if (rests(self, kind)) {
        const double factor = zygos_kept_share(&self->config, self->forgetting[kind]);
        if (factor < 1.0) {
            forget(self, kind, factor);
        }
        self->forgetting[kind] = 1.0;
    }
    close_arc(self, kind, cycle);
}

void zygos_sums_drop_after(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        zygos_accumulator_drop_after(&self->energy, cycle);
        break;
    case ZYGOS_MOTOR_ROWS:
        zygos_motor_sums_drop_after(&self->motors, cycle);
        break;
    case ZYGOS_MOMENTUM_ROWS:
        zygos_momentum_sums_drop_after(&self->momentum, cycle);
        break;
    default:
        zygos_joint_sums_drop_after(&self->joints, cycle);
        break;
    }
}

uint32_t zygos_sums_drop_until(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_drop_until(&self->energy, cycle);
    case ZYGOS_MOTOR_ROWS:
        return zygos_motor_sums_drop_until(&self->motors, cycle);
    default:
        return zygos_momentum_sums_drop_until(&self->momentum, cycle);
    }
}

static bool scrub(zygos_sums_t *self, uint32_t kind)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_scrub(&self->energy, self->column_map.parameters);
    case ZYGOS_MOTOR_ROWS:
        return zygos_motor_sums_scrub(&self->motors, &self->config);
    case ZYGOS_MOMENTUM_ROWS:
        return zygos_momentum_sums_scrub(&self->momentum, &self->config);
    default:
        return zygos_joint_sums_scrub(&self->joints, &self->config, &self->column_map);
    }
}

static double check(const zygos_sums_t *self, uint32_t kind)
{
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        return zygos_accumulator_check(&self->energy);
    case ZYGOS_MOTOR_ROWS:
        return zygos_motor_sums_check(&self->motors, &self->config);
    case ZYGOS_MOMENTUM_ROWS:
        return zygos_momentum_sums_check(&self->momentum);
    default:
        return zygos_joint_sums_check(&self->joints);
    }
}

void zygos_sums_end_waiting(zygos_sums_t *self, uint32_t kind)
{
    if (zygos_sums_is_ending(self, kind)) {
        const double since = self->forgetting[kind];
        self->ending ^= 1u << kind;
        self->forgetting[kind] = self->ended_forgetting[kind];
        self->ended_forgetting[kind] = 1.0;
        zygos_sums_end_arc(self, kind, self->ended[kind]);
        self->forgetting[kind] *= since;
    }
}

/* ---------------------------------------------------------------- all kinds */

void zygos_sums_settle(zygos_sums_t *self)
{
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        zygos_guard_settle(self, kind);
        if (zygos_sums_is_ending(self, kind)) {
            zygos_sums_end_waiting(self, kind);
            zygos_guard_settle(self, kind);
        }
    }
}

void zygos_sums_end_segment(zygos_sums_t *self)
{
    zygos_joint_sums_flush(&self->joints, &self->config);
    zygos_guard_end_joints(self);
    zygos_joint_sums_flush(&self->joints, &self->config);
}

bool zygos_sums_are_intact(const zygos_sums_t *self)
{
    zygos_column_map_t column_map; /* that in memory may have been changed */
    bool good = true;
    zygos_balance_column_map(&self->config, &column_map);
    for (uint32_t kind = 0; good && (kind < ZYGOS_KINDS_OF_SUMS); kind++) {
        good = zygos_sums_is_intact(self, kind, &column_map);
    }
    return good;
}

uint32_t zygos_sums_quarantined(const zygos_sums_t *self)
{
    return self->energy.quarantined + self->motors.quarantined + self->momentum.quarantined + self->joints.quarantined;
}

uint32_t zygos_sums_scrub(zygos_sums_t *self)
{
    uint32_t cleared = 0;
    for (uint32_t kind = 0; kind < ZYGOS_KINDS_OF_SUMS; kind++) {
        if (!scrub(self, kind)) {
            zygos_sums_clear(self, kind);
            cleared++;
        }
    }
    return cleared;
}

void zygos_sums_apply_fade(zygos_sums_t *self)
{
    zygos_accumulator_apply_fade(&self->energy);
    zygos_motor_sums_apply_fade(&self->motors);
    zygos_momentum_sums_apply_fade(&self->momentum);
}

bool zygos_sums_match(const zygos_sums_t *self)
{
    bool good = true;
    for (uint32_t kind = 0; good && (kind < ZYGOS_KINDS_OF_SUMS); kind++) {
        good = (check(self, kind) <= 1.0);
    }
    return good;
}

bool zygos_sums_settle_copy(zygos_sums_t *self)
{
    if ((self == NULL) || (self->config.joints < 1u) || (self->config.joints > ZYGOS_MAX_JOINTS) ||
        (zygos_effects_check(&self->config) < 0) || (self->config.kinetic > (uint32_t)ZYGOS_LAST_KINETIC) ||
        (self->config.base > (uint32_t)ZYGOS_BASE_FIXED) || (zygos_reduction_check(&self->config) < 0)) {
        return false;
    }
    zygos_balance_column_map(&self->config, &self->column_map);
    if (!zygos_sums_are_intact(self)) {
        return false;
    }
    const uint32_t before = zygos_sums_quarantined(self);
    zygos_sums_settle(self);
    return zygos_sums_quarantined(self) == before;
}

/* Apart from the solver, so that who only checks does not link it. */
bool zygos_sums_end_copy(zygos_sums_t *self)
{
    if (!zygos_sums_settle_copy(self)) {
        return false;
    }
    zygos_accumulator_flush(&self->energy);
    zygos_sums_end_segment(self);
    if (!zygos_sums_match(self)) {
        return false;
    }
    const uint32_t before = zygos_sums_quarantined(self);
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        close_arc(self, kind, self->cycle); /* what is older does not fade before the next arc */
        zygos_guard_settle(self, kind);
    }
    zygos_sums_apply_fade(self);
    return (zygos_sums_quarantined(self) == before) &&
           ((self->energy.corrupt | self->motors.corrupt | self->momentum.corrupt) == 0);
}
