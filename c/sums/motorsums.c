/* SPDX-License-Identifier: MIT */
#include "zygos/priv/motorsums.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <string.h>

void zygos_motor_sums_tables(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_smoother_t *smoother)
{
    zygos_impulse_column_map(config, &self->column_map);
    memset(self->noise, 0, sizeof self->noise);
    for (uint32_t i = 0; (i < config->joints) && (config->compensation != 0); i++) {
        if (self->column_map.count[i] > 0) {
            zygos_impulse_noise(config, &self->column_map, smoother, config->imu_sigma, i, self->noise[i]);
        }
    }
}

static bool same_layout(const zygos_impulse_column_map_t *column_map, const zygos_config_t *config)
{
    zygos_impulse_column_map_t own;
    bool same = true;
    zygos_impulse_column_map(config, &own);
    for (uint32_t i = 0; i < config->joints; i++) {
        same = same && (column_map->count[i] == own.count[i]);
        for (uint32_t e = 0; e < ZYGOS_EFFECT_PLACES; e++) {
            same = same && (column_map->effect[i][e] == own.effect[i][e]);
        }
    }
    return same;
}

bool zygos_motor_sums_intact(const zygos_motor_sums_t *self, const zygos_config_t *config)
{
    return same_layout(&self->column_map, config) &&
           zygos_store_intact(&self->store, (uint32_t)ZYGOS_MOTOR_ROWS, config->impulse_arc_cycles > 0);
}

const zygos_motor_block_t *zygos_motor_sums_at(const zygos_motor_sums_t *self, uint32_t rank)
{
    return &self->block[zygos_store_place(&self->store, (uint32_t)ZYGOS_MOTOR_ROWS, rank)];
}

uint32_t zygos_motor_sums_places(const zygos_motor_sums_t *self, const zygos_column_map_t *column_map, uint32_t joint,
                                 uint32_t *place)
{
    const uint32_t count = zygos_least(self->column_map.count[joint], (uint32_t)ZYGOS_MAX_IMPULSE);
    const uint32_t *effect = self->column_map.effect[joint];
    for (uint32_t c = 0; c < count; c++) {
        const uint32_t column = (c < 3u) ? column_map->joint[joint] + c : column_map->effects + effect[c - 3u];
        const uint32_t known = (column < (uint32_t)ZYGOS_MAX_COLUMNS) ? column_map->place[column] : 0u;
        place[c] = (known < (uint32_t)ZYGOS_MAX_PARAMETERS) ? known : 0u; /* zygos_arm_scrub() reports the others */
    }
    place[count] = column_map->parameters;
    return count;
}

void zygos_motor_sums_add(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_impulse_rows_t *rows,
                          double weight)
{
    const uint32_t i = self->store.cycles % config->joints;
    const uint32_t p = self->column_map.count[i];
    zygos_motor_block_t *open = &self->block[(self->store.open <= ZYGOS_MAX_MOTOR_BLOCKS) ? self->store.open : 0u];
    if (p > 0) {
        double z[ZYGOS_MAX_MOTOR_ROW];
        for (uint32_t k = 0; k < p; k++) {
            z[k] = weight * rows->column[i][k];
        }
        z[p] = weight * rows->impulse[i];
        z[p + 1u] = weight;
        zygos_gram_add(open->joint[i].gram, open->joint[i].sum, p + 2u, z);
    }
    open->instants[i] += weight;
    self->store.arc_instants += (uint32_t)(weight > 0.0);
    self->store.cycles++;
}
