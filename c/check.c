#include "zygos/priv/solver.h"

#include "zygos/priv/reduction.h"

#include <stddef.h>

/* Arcs and blocks that were dropped because memory was changed. */
static uint32_t quarantined(const zygos_work_t *work)
{
    return work->accumulator.quarantined + work->motor_sums.quarantined + work->momentum_sums.quarantined;
}

static bool ends(const zygos_work_t *work, uint32_t kind)
{
    return ((work->ending >> kind) & 1u) != 0;
}

/* By how much the sums of closed arcs fade before such an arc is added. */
static double factor_of(const zygos_work_t *work, uint32_t kind)
{
    return zygos_kept_share(&work->config, work->ended_forgetting[kind]);
}

/* Ends the arcs that wait for their end. Needs that no task is open. */
static void end_waiting(zygos_work_t *work)
{
    const zygos_config_t *config = &work->config;
    if (ends(work, (uint32_t)ZYGOS_ENERGY_ROWS)) {
        zygos_accumulator_forget(&work->accumulator, factor_of(work, (uint32_t)ZYGOS_ENERGY_ROWS));
        zygos_guard_end_energy(&work->guard, config, &work->accumulator, work->ended[ZYGOS_ENERGY_ROWS], work->arc);
        work->arc = 0;
    }
    if (ends(work, (uint32_t)ZYGOS_MOTOR_ROWS)) {
        zygos_motor_sums_forget(&work->motor_sums, factor_of(work, (uint32_t)ZYGOS_MOTOR_ROWS));
        zygos_guard_end_motors(&work->guard, config, &work->column_map, &work->motor_sums,
                               work->ended[ZYGOS_MOTOR_ROWS]);
    }
    if (ends(work, (uint32_t)ZYGOS_MOMENTUM_ROWS)) {
        zygos_momentum_sums_forget(&work->momentum_sums, factor_of(work, (uint32_t)ZYGOS_MOMENTUM_ROWS));
        zygos_guard_end_momentum(&work->guard, config, &work->column_map, &work->momentum_sums,
                                 work->ended[ZYGOS_MOMENTUM_ROWS]);
    }
    work->ending = 0;
}

uint64_t zygos_copied_checksum(const zygos_config_t *config, const zygos_motor_sums_t *motors,
                               const zygos_momentum_sums_t *momentum, const zygos_joint_sums_t *joints)
{
    uint64_t sum = zygos_checksum_memory(0u, config, sizeof *config);
    sum = zygos_checksum_memory(sum, &motors->column_map, sizeof motors->column_map);
    sum = zygos_checksum_memory(sum, motors->noise, sizeof motors->noise);
    sum = zygos_checksum_memory(sum, momentum->deviation, sizeof momentum->deviation);
    sum = zygos_checksum_memory(sum, momentum->rotor, sizeof momentum->rotor);
    if (joints->width == 0) {
        return sum; /* nobody uses the others */
    }
    sum = zygos_checksum_memory(sum, joints->weight, sizeof joints->weight);
    sum = zygos_checksum_memory(sum, joints->deviation, sizeof joints->deviation);
    return zygos_checksum_memory(sum, joints->rotor_variance, sizeof joints->rotor_variance);
}

bool zygos_work_settle(zygos_work_t *work)
{
    if ((work == NULL) || (work->checksum != zygos_copied_checksum(&work->config, &work->motor_sums,
                                                                   &work->momentum_sums, &work->joint_sums))) {
        return false;
    }
    if ((work->config.joints < 1u) || (work->config.joints > ZYGOS_MAX_JOINTS) ||
        (zygos_effects_check(&work->config) < 0) || (work->config.kinetic > (uint32_t)ZYGOS_LAST_KINETIC) ||
        (work->config.base > (uint32_t)ZYGOS_BASE_FIXED)) {
        return false;
    }
    if (zygos_reduction_check(&work->config) < 0) {
        return false;
    }
    zygos_balance_column_map(&work->config, &work->column_map);
    if (!zygos_accumulator_intact(&work->accumulator, work->column_map.parameters) ||
        !zygos_joint_sums_intact(&work->joint_sums, &work->config, &work->column_map) ||
        !zygos_motor_sums_intact(&work->motor_sums, &work->config) ||
        !zygos_momentum_sums_intact(&work->momentum_sums, &work->config)) {
        return false;
    }
    const uint32_t before = quarantined(work);
    zygos_guard_settle_energy(&work->guard, &work->config, &work->accumulator);
    zygos_guard_settle_motors(&work->guard, &work->config, &work->column_map, &work->motor_sums);
    zygos_guard_settle_momentum(&work->guard, &work->config, &work->column_map, &work->momentum_sums);
    end_waiting(work);
    return quarantined(work) == before;
}

/* Whether what is summed matches what is summed beside it, or has the right checksum. */
static bool match(const zygos_accumulator_t *energy, const zygos_motor_sums_t *motors,
                  const zygos_momentum_sums_t *momentum, const zygos_joint_sums_t *joints, const zygos_config_t *config)
{
    return (zygos_accumulator_check(energy) <= 1.0) && (zygos_motor_sums_check(motors, config) <= 1.0) &&
           (zygos_momentum_sums_check(momentum) <= 1.0) && (zygos_joint_sums_check(joints) <= 1.0);
}

bool zygos_solver_matches(const zygos_solver_t *self)
{
    return match(self->accumulator, self->motor_sums, self->momentum_sums, self->joint_sums, self->config);
}

/* Whether the work was taken, and from memory that nobody changed; closes the open arcs. Apart from the solver, so that
   who only checks does not link it. */
bool zygos_work_intact(zygos_work_t *work)
{
    if (!zygos_work_settle(work)) {
        return false;
    }
    zygos_accumulator_t *sums = &work->accumulator;
    zygos_accumulator_flush(sums);
    zygos_joint_sums_flush(&work->joint_sums, &work->config);
    zygos_guard_end_joints(&work->guard, &work->config, &work->joint_sums, work->cycle, &work->joints_forgetting);
    zygos_joint_sums_flush(&work->joint_sums, &work->config);
    if (!match(sums, &work->motor_sums, &work->momentum_sums, &work->joint_sums, &work->config)) {
        return false;
    }
    const uint32_t before = quarantined(work);
    zygos_guard_end_momentum(&work->guard, &work->config, &work->column_map, &work->momentum_sums, work->cycle);
    zygos_guard_end_energy(&work->guard, &work->config, sums, work->cycle, work->arc);
    if (work->config.impulse_arc_cycles > 0) {
        zygos_guard_end_motors(&work->guard, &work->config, &work->column_map, &work->motor_sums, work->cycle);
    }
    zygos_accumulator_apply_fade(sums);
    zygos_motor_sums_apply_fade(&work->motor_sums);
    zygos_momentum_sums_apply_fade(&work->momentum_sums);
    return (quarantined(work) == before) && (sums->corrupt == 0) && (work->motor_sums.corrupt == 0) &&
           (work->momentum_sums.corrupt == 0);
}
