/* SPDX-License-Identifier: MIT */
/* What must be noticed: a processor that flushes denormals to zero. */

#include "zygos/zygos.h"

int __real_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config);
int __wrap_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config);

int __wrap_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config)
{
    uint32_t mode;
    __asm volatile("vmrs %0, fpscr" : "=r"(mode));
    __asm volatile("vmsr fpscr, %0" : : "r"(mode | 1u << 24));
    return __real_zygos_arm_init(self, config);
}
