/* SPDX-License-Identifier: MIT */
#include "zygos/priv/arm.h"

#include <stddef.h>

int zygos_arm_solve_ended(zygos_arm_t *self, zygos_solver_t *solver, zygos_estimate_t *out)
{
    solver->sums = &self->sums;
    if (!zygos_arm_is_whole(self) || !zygos_sums_match(&self->sums)) {
        return zygos_solver_refuse(out);
    }
    zygos_sums_apply_fade(&self->sums);
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
