/* SPDX-License-Identifier: MIT */
/* What must be noticed: interrupts that do not save the floating-point registers. */

#include "zygos/zygos.h"

#define FPCCR (*(volatile uint32_t *)0xE000EF34u)
#define SAVED (3u << 30) /* ASPEN and LSPEN: space for the registers, and saving on first use */
#define IN_USE 4u

int __real_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config);
int __wrap_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config);

int __wrap_zygos_arm_init(zygos_arm_t *self, const zygos_config_t *config)
{
    const int verdict = __real_zygos_arm_init(self, config);
    uint32_t control;
    FPCCR &= ~SAVED;
    __asm volatile("mrs %0, control" : "=r"(control));
    __asm volatile("msr control, %0\n\tisb" : : "r"(control & ~IN_USE));
    return verdict;
}
