#include "zygos/priv/arm.h"

#include <stddef.h>

int zygos_arm_solve_ended(zygos_arm_t *self, zygos_solver_t *solver, zygos_estimate_t *out)
{
    solver->accumulator = &self->accumulator;
    solver->motor_sums = &self->motor_sums;
    solver->momentum_sums = &self->momentum_sums;
    solver->joint_sums = &self->joint_sums;
    solver->guard = &self->guard;
    solver->config = &self->config;
    solver->cycle = self->cycle;
    if (!zygos_arm_is_whole(self) || !zygos_solver_matches(solver)) {
        return zygos_solver_refuse(out);
    }
    zygos_accumulator_apply_fade(solver->accumulator);
    zygos_motor_sums_apply_fade(solver->motor_sums);
    zygos_momentum_sums_apply_fade(solver->momentum_sums);
    return zygos_solver_solve(solver, out);
}

int zygos_arm_solve(zygos_arm_t *self, zygos_solver_t *solver, zygos_estimate_t *out)
{
    if ((solver == NULL) || (out == NULL)) {
        return ZYGOS_E_NULL;
    }
    const int ended = zygos_arm_end_arcs(self);
    return (ended < 0) ? ended : zygos_arm_solve_ended(self, solver, out);
}
