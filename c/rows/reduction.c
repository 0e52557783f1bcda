/* SPDX-License-Identifier: MIT */
#include "zygos/priv/reduction.h"

#include <string.h>

#define LARGEST_FACTOR 1e9

static bool is_one(double x)
{
    return (x >= 1.0) && (x <= 1.0);
}

static bool in_range(const zygos_config_t *config, const zygos_column_map_t *column_map)
{
    const zygos_reduction_t *entry = config->reduction;
    bool good = (config->reductions <= (uint32_t)ZYGOS_MAX_REDUCTION);
    for (uint32_t k = 0; good && (k < config->reductions); k++) {
        const bool follows =
            (k == 0) || (entry[k].column > entry[k - 1u].column) ||
            ((entry[k].column == entry[k - 1u].column) && (entry[k].parameter > entry[k - 1u].parameter));
        const double size = __builtin_fabs(entry[k].factor);
        good = follows && (entry[k].column < column_map->effects) && (entry[k].parameter < config->reduced) &&
               (size > 0.0) && (size <= LARGEST_FACTOR);
    }
    return good;
}

/* On a free base the parameters are some of the columns, in their order. */
static bool selects(const zygos_config_t *config)
{
    bool good = (config->reductions == config->reduced);
    for (uint32_t k = 0; good && (k < config->reductions); k++) {
        good = (config->reduction[k].parameter == k) && is_one(config->reduction[k].factor) &&
               ((k == 0) || (config->reduction[k].column > config->reduction[k - 1u].column));
    }
    return good;
}

static bool keeps_joints(const zygos_config_t *config, const zygos_column_map_t *column_map)
{
    bool good = true;
    for (uint32_t i = 0; i < config->joints; i++) {
        for (uint32_t c = 0; (c < 3u) && (config->joint[i].rigid == 0); c++) {
            good = good && (column_map->place[column_map->joint[i] + c] != ZYGOS_NO_PLACE);
        }
    }
    return good;
}

int zygos_reduction_check(const zygos_config_t *config)
{
    const uint32_t columns = zygos_balance_columns(config);
    if (columns > (uint32_t)ZYGOS_MAX_COLUMNS) {
        return ZYGOS_E_REDUCTION;
    }
    if (config->reduced == 0) {
        const bool good = (config->reductions == 0) && (columns <= (uint32_t)ZYGOS_MAX_PARAMETERS);
        return good ? 1 : ZYGOS_E_REDUCTION;
    }
    /* The map is computed without the reduction first, whose entries are not checked yet. */
    zygos_column_map_t column_map;
    bool used[ZYGOS_MAX_PARAMETERS] = { false };
    zygos_balance_column_map(config, &column_map);
    bool good = (config->reduced <= column_map.effects) &&
                (config->reduced + config->effects <= (uint32_t)ZYGOS_MAX_PARAMETERS) && in_range(config, &column_map);
    for (uint32_t k = 0; good && (k < config->reductions); k++) {
        used[config->reduction[k].parameter] = true;
    }
    for (uint32_t r = 0; good && (r < config->reduced); r++) {
        good = used[r];
    }
    good = good && ((config->base != ZYGOS_BASE_FREE) || selects(config)) && keeps_joints(config, &column_map);
    return good ? 1 : ZYGOS_E_REDUCTION;
}

/* The places of columns that a parameter consists of, with the factor 1. */
static void select_places(const zygos_config_t *config, zygos_column_map_t *column_map)
{
    uint32_t shares[ZYGOS_MAX_COLUMNS] = { 0 }; /* number of columns that a parameter counts for */
    const uint32_t entries =
        (config->reductions <= (uint32_t)ZYGOS_MAX_REDUCTION) ? config->reductions : (uint32_t)ZYGOS_MAX_REDUCTION;
    for (uint32_t k = 0; k < entries; k++) {
        const uint32_t parameter = config->reduction[k].parameter;
        shares[(parameter < (uint32_t)ZYGOS_MAX_COLUMNS) ? parameter : 0u]++;
    }
    for (uint32_t k = 0; k < entries; k++) {
        const zygos_reduction_t *entry = &config->reduction[k];
        const bool alone = ((k == 0) || (entry[-1].column != entry->column)) &&
                           ((k + 1u == entries) || (entry[1].column != entry->column));
        if (alone && is_one(entry->factor) && (entry->column < column_map->effects) &&
            (entry->parameter < column_map->reduced) && (entry->parameter < (uint32_t)ZYGOS_MAX_COLUMNS) &&
            (shares[entry->parameter] == 1u)) {
            column_map->place[entry->column] = entry->parameter;
        }
    }
}

void zygos_reduction_places(const zygos_config_t *config, zygos_column_map_t *column_map)
{
    const bool whole = (config->reduced == 0);
    column_map->reduced = whole ? column_map->effects : config->reduced;
    column_map->parameters = column_map->reduced + config->effects;
    for (uint32_t c = 0; c < column_map->effects; c++) {
        column_map->place[c] = whole ? c : ZYGOS_NO_PLACE;
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        column_map->place[column_map->effects + e] = column_map->reduced + e;
    }
    select_places(config, column_map);
}

bool zygos_reduction_selects_all(const zygos_column_map_t *column_map)
{
    bool all = true;
    for (uint32_t c = 0; c < column_map->effects; c++) {
        all = all && (column_map->place[c] != ZYGOS_NO_PLACE);
    }
    return all;
}

void zygos_reduce(const zygos_config_t *config, const zygos_column_map_t *column_map, const double *restrict columns,
                  double *restrict out)
{
    const zygos_reduction_t *entry = config->reduction;
    if (config->reduced == 0) {
        memcpy(out, columns, column_map->count * sizeof out[0]);
        return;
    }
    memset(out, 0, column_map->reduced * sizeof out[0]);
    for (uint32_t k = 0; k < config->reductions; k++) {
        out[entry[k].parameter] += entry[k].factor * columns[entry[k].column];
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        out[column_map->reduced + e] = columns[column_map->effects + e];
    }
}

void zygos_expand(const zygos_config_t *config, const zygos_column_map_t *column_map, const double *restrict parameters,
                  double *restrict out)
{
    const zygos_reduction_t *entry = config->reduction;
    if (config->reduced == 0) {
        memcpy(out, parameters, column_map->count * sizeof out[0]);
        return;
    }
    memset(out, 0, column_map->effects * sizeof out[0]);
    for (uint32_t k = 0; k < config->reductions; k++) {
        out[entry[k].column] += entry[k].factor * parameters[entry[k].parameter];
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        out[column_map->effects + e] = parameters[column_map->reduced + e];
    }
}
