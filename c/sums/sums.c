/* SPDX-License-Identifier: MIT */
#include "zygos/priv/sums.h"

#include "zygos/priv/effects.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>

/* ---------------------------------------------------------------- one kind of rows */

zygos_store_t *zygos_sums_store(const zygos_sums_t *self, uint32_t kind)
{
    zygos_sums_t *all = (zygos_sums_t *)(uintptr_t)self; /* who only reads uses the same function */
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        return &all->energy.store;
    }
    return (kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? &all->motors.store : &all->momentum.store;
}

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
    const zygos_config_t *config = &self->config;
    zygos_sums_drop_waiting(self, kind);
    switch (kind) {
    case ZYGOS_ENERGY_ROWS:
        zygos_accumulator_init(&self->energy, self->column_map.parameters, config->arc_cycles, config->period_s);
        break;
    case ZYGOS_JOINT_KIND:
        zygos_joint_sums_clear(&self->joints);
        break;
    default:
        zygos_store_clear(zygos_sums_store(self, kind), kind, 2.0 * (double)zygos_store_longest(config, kind));
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
    return zygos_store_busy(zygos_sums_store(self, kind), kind);
}

bool zygos_sums_has_work(const zygos_sums_t *self, uint32_t kind)
{
    return zygos_store_has_work(zygos_sums_store(self, kind), kind);
}

bool zygos_sums_can_close(const zygos_sums_t *self, uint32_t kind)
{
    return zygos_store_can_close(zygos_sums_store(self, kind), kind, self->config.forgetting_factor < 1.0);
}

bool zygos_sums_is_short(const zygos_sums_t *self, uint32_t kind)
{
    return zygos_store_is_short(zygos_sums_store(self, kind));
}

/* Ends the open arc, without a task. */
static void close_arc(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        self->energy.store.cycles = self->arc;
        self->arc = 0;
    }
    zygos_store_close(zygos_sums_store(self, kind), kind, cycle);
}

void zygos_sums_end_arc(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    zygos_store_t *store = zygos_sums_store(self, kind);
    if (zygos_store_rests(store)) {
        const double factor = zygos_kept_share(&self->config, self->forgetting[kind]);
        if (factor < 1.0) {
            zygos_store_forget(store, kind, factor);
        }
        self->forgetting[kind] = 1.0;
    }
    close_arc(self, kind, cycle);
}

void zygos_sums_drop_after(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    if (kind == ZYGOS_JOINT_KIND) {
        zygos_joint_sums_drop_after(&self->joints, cycle);
    } else {
        zygos_store_drop_after(zygos_sums_store(self, kind), kind, cycle);
        self->guard.held_instants = 0.0; /* it may be of them */
    }
}

uint32_t zygos_sums_drop_until(zygos_sums_t *self, uint32_t kind, uint64_t cycle)
{
    return zygos_store_drop_until(zygos_sums_store(self, kind), kind, cycle);
}

static bool scrub(zygos_sums_t *self, uint32_t kind)
{
    if (kind == ZYGOS_JOINT_KIND) {
        return zygos_joint_sums_scrub(&self->joints, &self->config, &self->column_map);
    }
    if ((kind != (uint32_t)ZYGOS_ENERGY_ROWS) && (zygos_store_longest(&self->config, kind) == 0)) {
        zygos_sums_clear(self, kind); /* rows that nobody adds must not stop those that are */
        return true;
    }
    return zygos_store_scrub(zygos_sums_store(self, kind), kind);
}

static bool is_whole(const zygos_sums_t *self, uint32_t kind)
{
    return (kind == ZYGOS_JOINT_KIND) ? zygos_joint_sums_is_whole(&self->joints)
                                      : zygos_store_is_whole(zygos_sums_store(self, kind), kind);
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
    return self->energy.store.quarantined + self->motors.store.quarantined + self->momentum.store.quarantined +
           self->joints.quarantined;
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
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        zygos_store_apply_fade(zygos_sums_store(self, kind), kind);
    }
}

bool zygos_sums_match(const zygos_sums_t *self)
{
    bool good = true;
    for (uint32_t kind = 0; good && (kind < ZYGOS_KINDS_OF_SUMS); kind++) {
        good = is_whole(self, kind);
    }
    return good;
}

uint64_t zygos_sums_checksum(const zygos_sums_t *self)
{
    uint64_t sum = zygos_checksum_memory(0u, &self->config, sizeof self->config);
    sum = zygos_checksum_memory(sum, &self->motors.column_map, sizeof self->motors.column_map);
    sum = zygos_checksum_memory(sum, self->motors.noise, sizeof self->motors.noise);
    sum = zygos_checksum_memory(sum, self->momentum.deviation, sizeof self->momentum.deviation);
    sum = zygos_checksum_memory(sum, self->momentum.rotor, sizeof self->momentum.rotor);
    if (self->joints.width == 0) {
        return sum; /* nobody uses the others */
    }
    sum = zygos_checksum_memory(sum, self->joints.weight, sizeof self->joints.weight);
    sum = zygos_checksum_memory(sum, self->joints.deviation, sizeof self->joints.deviation);
    return zygos_checksum_memory(sum, self->joints.rotor_variance, sizeof self->joints.rotor_variance);
}

bool zygos_sums_settle_copy(zygos_sums_t *self)
{
    if ((self == NULL) || (self->checksum != zygos_sums_checksum(self)) || (self->config.joints < 1u) ||
        (self->config.joints > ZYGOS_MAX_JOINTS) || (zygos_effects_check(&self->config) < 0) ||
        (self->config.kinetic > (uint32_t)ZYGOS_LAST_KINETIC) || (self->config.base > (uint32_t)ZYGOS_BASE_FIXED) ||
        (zygos_reduction_check(&self->config) < 0)) {
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
           ((self->energy.store.corrupt | self->motors.store.corrupt | self->momentum.store.corrupt) == 0);
}
