/* SPDX-License-Identifier: MIT */
/* A task that is held up at its 60th cycle until 5 frames are lost. */

#include <stddef.h>

#include "core.h"
#include "zygos/zygos.h"

int __real_zygos_arm_step(zygos_arm_t *self);
int __wrap_zygos_arm_step(zygos_arm_t *self);

int __wrap_zygos_arm_step(zygos_arm_t *self)
{
    const zygos_t *whole = (const zygos_t *)(const void *)((const char *)self - offsetof(zygos_t, state));
    const volatile uint32_t *lost = &whole->overrun;
    while ((self->cycles == 60u) && (*lost < 5u)) {
        core_sleep();
    }
    return __real_zygos_arm_step(self);
}
