/* SPDX-License-Identifier: MIT */
/* Solves states one after the other, for a tool that counts what each of them takes. Reads states.bin: zygos_arm_t as
   it lies in memory, once for each state. Writes found.bin: of each solution three uint32, its validity and reason,
   and 1 where old arcs were left out. */

#include "semihosting.h"
#include "zygos/priv/arm.h"
#include "zygos/priv/solver.h"

int main(void);
void solve_mark(void);

static zygos_arm_t arm;
static zygos_work_t work;
static zygos_estimate_t estimate;

/* What counts sees this call behind each solution. */
__attribute__((noinline)) void solve_mark(void)
{
    __asm__ volatile("" ::: "memory");
}

int main(void)
{
    const int32_t states = semihosting_open("states.bin", SEMIHOSTING_READ);
    const int32_t found = semihosting_open("found.bin", SEMIHOSTING_WRITE);
    bool written = (states >= 0) && (found >= 0);
    while (written && (semihosting_read(states, &arm, sizeof arm) == sizeof arm)) {
        zygos_arm_take(&arm, &work);
        (void)zygos_work_solve(&work, &estimate);
        solve_mark();
        const uint32_t answer[3] = { estimate.validity, estimate.reason, (estimate.since > 0) ? 1u : 0u };
        written = (semihosting_write(found, answer, sizeof answer) == sizeof answer);
    }
    return (written && (semihosting_close(found) == 0)) ? 0 : 1;
}
