/* SPDX-License-Identifier: MIT */
/* Feeds recorded cycles to the refinement on board, slice by slice, for a tool that counts the instructions of each.
   Reads run.bin: six uint32 (size of a configuration, of an estimate and of a cycle, number of cycles; cycles to a use
   of readings, terms of the series), a double (noise of the torques as a share of their size), the configuration, the
   estimate and the cycles as they lie in memory. Writes out.bin: four uint32 (bytes of the task, of the filter, largest
   number of slices after a cycle, and the filter's entries), a byte for each slice with its phase, 255 behind the last
   slice of each cycle, and at the end x and root of the filter. A computer of another kind must come to the same bytes,
   but for the sizes. */

#include "semihosting.h"
#include "zygos/zygos.h"

#include <stddef.h>

int main(void);
void driver_mark(void);

static zygos_refine_t task;
static zygos_config_t config;
static zygos_estimate_t estimate;
static zygos_refine_settings_t settings;

/* What counts instructions sees this call behind each slice. */
__attribute__((noinline)) void driver_mark(void)
{
    __asm__ volatile("" ::: "memory");
}

int main(void)
{
    const int32_t run = semihosting_open("run.bin", SEMIHOSTING_READ);
    const int32_t out = semihosting_open("out.bin", SEMIHOSTING_WRITE);
    uint32_t head[6];
    double relative;
    if ((run < 0) || (out < 0) || (semihosting_read(run, head, sizeof head) != sizeof head) ||
        (head[0] != sizeof config) || (head[1] != sizeof estimate) || (head[2] != sizeof(zygos_cycle_t)) ||
        (semihosting_read(run, &relative, sizeof relative) != sizeof relative) ||
        (semihosting_read(run, &config, sizeof config) != sizeof config) ||
        (semihosting_read(run, &estimate, sizeof estimate) != sizeof estimate)) {
        return 1;
    }
    config.abi = ZYGOS_ABI;
    (void)zygos_refine_defaults(&settings, &config);
    settings.every = head[4];
    settings.terms = head[5];
    for (uint32_t i = 0; i < config.joints; i++) {
        settings.filter.torque_relative_sigma[i] = relative;
    }
    if ((zygos_refine_init(&task, &config, &settings) != 1) ||
        (zygos_refine_start(&task, &config, &estimate, NULL) != 1)) {
        return 2;
    }
    uint32_t sizes[4] = { sizeof task, sizeof task.filter, 0u, task.filter.entries };
    bool good = true;
    for (uint32_t k = 0; k < head[3]; k++) {
        zygos_cycle_t cycle;
        if (semihosting_read(run, &cycle, sizeof cycle) != sizeof cycle) {
            return 3;
        }
        (void)zygos_refine_cycle(&task, &cycle);
        uint32_t slices = 0;
        uint8_t phase = (uint8_t)task.phase;
        while (zygos_refine_step(&task, &config) == 1) {
            driver_mark();
            good = (semihosting_write(out, &phase, 1u) == 1u) && good;
            phase = (uint8_t)task.phase;
            slices++;
        }
        driver_mark(); /* of the call that had nothing to do */
        phase = 255u;
        good = (semihosting_write(out, &phase, 1u) == 1u) && good;
        sizes[2] = (slices > sizes[2]) ? slices : sizes[2];
    }
    const uint32_t n = task.filter.entries;
    const uint32_t bytes = (uint32_t)sizeof(double);
    good = (semihosting_write(out, sizes, sizeof sizes) == sizeof sizes) && good;
    good = (semihosting_write(out, task.filter.x, n * bytes) == n * bytes) && good;
    good = (semihosting_write(out, task.filter.root, n * (n + 1u) / 2u * bytes) == n * (n + 1u) / 2u * bytes) && good;
    return (good && (semihosting_close(out) == 0) && (task.filter.failed == 0u)) ? 0 : 4;
}
