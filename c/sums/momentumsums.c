/* SPDX-License-Identifier: MIT */
#include "zygos/priv/momentumsums.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <string.h>

static uint32_t columns_of_momentum(const zygos_config_t *config)
{
    return (config->momentum_arc_cycles > 0) ? zygos_kinetic_parameters(config) + config->joints : 0u;
}

static uint32_t components_of(const zygos_config_t *config)
{
    return (config->momentum_arc_cycles > 0) ? zygos_momentum_count(config) : 0u;
}

static uint32_t signals_of(const zygos_config_t *config)
{
    return ((config->momentum_arc_cycles > 0) && (config->compensation > 0)) ? config->joints + components_of(config)
                                                                             : 0u;
}

void zygos_momentum_sums_tables(zygos_momentum_sums_t *self, const zygos_config_t *config,
                                const zygos_smoother_t *smoother)
{
    self->columns = columns_of_momentum(config);
    self->components = components_of(config);
    self->signals = signals_of(config);
    memset(self->deviation, 0, sizeof self->deviation);
    memset(self->rotor, 0, sizeof self->rotor);
    if (self->signals == 0) {
        return;
    }
    zygos_momentum_variance(config, smoother, config->imu_sigma, self->deviation, self->rotor);
    for (uint32_t s = 0; s < self->signals; s++) {
        self->deviation[s] = __builtin_sqrt((double)self->signals * self->deviation[s]);
    }
}

bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    return (self->columns == columns_of_momentum(config)) && (self->components == components_of(config)) &&
           (self->signals == signals_of(config)) &&
           (self->columns + self->components <= (uint32_t)ZYGOS_MAX_MOMENTUM_ROW) &&
           zygos_store_intact(&self->store, (uint32_t)ZYGOS_MOMENTUM_ROWS, config->momentum_arc_cycles > 0);
}

const zygos_momentum_block_t *zygos_momentum_sums_at(const zygos_momentum_sums_t *self, uint32_t rank)
{
    return &self->block[zygos_store_place(&self->store, (uint32_t)ZYGOS_MOMENTUM_ROWS, rank)];
}

uint32_t zygos_momentum_sums_places(const zygos_momentum_sums_t *self, const zygos_column_map_t *column_map,
                                    uint32_t *place)
{
    const uint32_t columns = zygos_least(self->columns, (uint32_t)ZYGOS_MAX_MOMENTUM);
    for (uint32_t c = 0; c < columns; c++) {
        const uint32_t rotor = (c < column_map->kinetic) ? 0u : c - column_map->kinetic;
        const bool known = (rotor < (uint32_t)ZYGOS_MAX_JOINTS);
        const uint32_t column = (c < column_map->kinetic) ? c : (known ? column_map->joint[rotor] : UINT32_MAX);
        place[c] = (column < (uint32_t)ZYGOS_MAX_COLUMNS) ? column_map->place[column] : (uint32_t)ZYGOS_NO_PLACE;
    }
    return columns;
}

void zygos_momentum_sums_add(zygos_momentum_sums_t *self, const zygos_config_t *config,
                             const zygos_momentum_t *momentum, const zygos_arm_state_t *state,
                             const zygos_motion_t *motion, double weight)
{
    const uint32_t component = self->store.cycles % self->components;
    double z[ZYGOS_MAX_MOMENTUM + 3];
    zygos_momentum_row(momentum, config, state, motion, component, z);
    for (uint32_t k = 0; k < self->columns; k++) {
        z[k] *= weight;
    }
    for (uint32_t k = 0; k < self->components; k++) {
        z[self->columns + k] = (k == component) ? weight : 0.0;
    }
    zygos_momentum_gram_t *open =
        &self->block[(self->store.open <= ZYGOS_MOMENTUM_PLACES) ? self->store.open : 0u].rows;
    zygos_gram_add(open->gram, open->sum, self->columns + self->components, z);
    if (self->signals > 0) {
        zygos_momentum_gram_t *noise = &self->noise_open[self->store.parity & 1u];
        const uint32_t signal = self->store.cycles / self->components % self->signals;
        zygos_momentum_derivative(momentum, config, motion, component, signal, z);
        for (uint32_t k = 0; k < self->columns; k++) {
            z[k] *= weight * self->deviation[signal];
        }
        zygos_gram_add(noise->gram, noise->sum, self->columns, z);
    }
    self->store.arc_instants += (uint32_t)(weight > 0.0);
    self->store.cycles++;
}

void zygos_momentum_sums_add_rotors(const zygos_momentum_sums_t *self, double instants, double *gram, double *sum)
{
    const uint32_t joints = self->signals - self->components; /* or there is no noise */
    for (uint32_t i = 0; (i < (uint32_t)ZYGOS_MAX_JOINTS) && (i < joints) && (joints <= self->columns); i++) {
        const uint32_t place = self->columns - joints + i;
        const double owed = instants * self->rotor[i] / (double)self->components;
        gram[zygos_gram_entries(place + 1u) - 1u] += owed;
        sum[place] += owed;
    }
}
