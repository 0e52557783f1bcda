#include "zygos/priv/sums.h"

#include "zygos/priv/effects.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>

/* Arcs and blocks that were dropped because memory was changed. */
static uint32_t quarantined(const zygos_sums_t *sums)
{
    return sums->energy.quarantined + sums->motors.quarantined + sums->momentum.quarantined;
}

static bool ends(const zygos_sums_t *sums, uint32_t kind)
{
    return ((sums->ending >> kind) & 1u) != 0;
}

/* By how much the sums of closed arcs fade before such an arc is added. */
static double factor_of(const zygos_sums_t *sums, uint32_t kind)
{
    return zygos_kept_share(&sums->config, sums->ended_forgetting[kind]);
}

/* Ends the arcs that wait for their end. Needs that no task is open. */
static void end_waiting(zygos_sums_t *sums)
{
    const zygos_config_t *config = &sums->config;
    if (ends(sums, (uint32_t)ZYGOS_ENERGY_ROWS)) {
        zygos_accumulator_forget(&sums->energy, factor_of(sums, (uint32_t)ZYGOS_ENERGY_ROWS));
        zygos_guard_end_energy(&sums->guard, config, &sums->energy, sums->ended[ZYGOS_ENERGY_ROWS], sums->arc);
        sums->arc = 0;
    }
    if (ends(sums, (uint32_t)ZYGOS_MOTOR_ROWS)) {
        zygos_motor_sums_forget(&sums->motors, factor_of(sums, (uint32_t)ZYGOS_MOTOR_ROWS));
        zygos_guard_end_motors(&sums->guard, config, &sums->column_map, &sums->motors, sums->ended[ZYGOS_MOTOR_ROWS]);
    }
    if (ends(sums, (uint32_t)ZYGOS_MOMENTUM_ROWS)) {
        zygos_momentum_sums_forget(&sums->momentum, factor_of(sums, (uint32_t)ZYGOS_MOMENTUM_ROWS));
        zygos_guard_end_momentum(&sums->guard, config, &sums->column_map, &sums->momentum,
                                 sums->ended[ZYGOS_MOMENTUM_ROWS]);
    }
    sums->ending = 0;
}

bool zygos_sums_settle(zygos_sums_t *sums)
{
    if ((sums == NULL) || (sums->config.joints < 1u) || (sums->config.joints > ZYGOS_MAX_JOINTS) ||
        (zygos_effects_check(&sums->config) < 0) || (sums->config.kinetic > (uint32_t)ZYGOS_LAST_KINETIC) ||
        (sums->config.base > (uint32_t)ZYGOS_BASE_FIXED)) {
        return false;
    }
    if (zygos_reduction_check(&sums->config) < 0) {
        return false;
    }
    zygos_balance_column_map(&sums->config, &sums->column_map);
    if (!zygos_accumulator_intact(&sums->energy, sums->column_map.parameters) ||
        !zygos_joint_sums_intact(&sums->joints, &sums->config, &sums->column_map) ||
        !zygos_motor_sums_intact(&sums->motors, &sums->config) ||
        !zygos_momentum_sums_intact(&sums->momentum, &sums->config)) {
        return false;
    }
    const uint32_t before = quarantined(sums);
    zygos_guard_settle_energy(&sums->guard, &sums->config, &sums->energy);
    zygos_guard_settle_motors(&sums->guard, &sums->config, &sums->column_map, &sums->motors);
    zygos_guard_settle_momentum(&sums->guard, &sums->config, &sums->column_map, &sums->momentum);
    end_waiting(sums);
    return quarantined(sums) == before;
}

bool zygos_sums_match(const zygos_sums_t *sums)
{
    return (zygos_accumulator_check(&sums->energy) <= 1.0) &&
           (zygos_motor_sums_check(&sums->motors, &sums->config) <= 1.0) &&
           (zygos_momentum_sums_check(&sums->momentum) <= 1.0) && (zygos_joint_sums_check(&sums->joints) <= 1.0);
}

/* Whether the work was taken, and from memory that nobody changed; closes the open arcs. Apart from the solver, so that
   who only checks does not link it. */
bool zygos_sums_intact(zygos_sums_t *sums)
{
    if (!zygos_sums_settle(sums)) {
        return false;
    }
    zygos_accumulator_t *energy = &sums->energy;
    zygos_accumulator_flush(energy);
    zygos_joint_sums_flush(&sums->joints, &sums->config);
    zygos_guard_end_joints(&sums->guard, &sums->config, &sums->joints, sums->cycle,
                           &sums->forgetting[ZYGOS_JOINT_KIND]);
    zygos_joint_sums_flush(&sums->joints, &sums->config);
    if (!zygos_sums_match(sums)) {
        return false;
    }
    const uint32_t before = quarantined(sums);
    zygos_guard_end_momentum(&sums->guard, &sums->config, &sums->column_map, &sums->momentum, sums->cycle);
    zygos_guard_end_energy(&sums->guard, &sums->config, energy, sums->cycle, sums->arc);
    if (sums->config.impulse_arc_cycles > 0) {
        zygos_guard_end_motors(&sums->guard, &sums->config, &sums->column_map, &sums->motors, sums->cycle);
    }
    zygos_accumulator_apply_fade(energy);
    zygos_motor_sums_apply_fade(&sums->motors);
    zygos_momentum_sums_apply_fade(&sums->momentum);
    return (quarantined(sums) == before) && (energy->corrupt == 0) && (sums->motors.corrupt == 0) &&
           (sums->momentum.corrupt == 0);
}
