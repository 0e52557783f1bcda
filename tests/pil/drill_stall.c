/* A task that is held up at its 60th cycle until 5 cycles are lost. */

#include "core.h"
#include "zygos/zygos.h"

int __real_zygos_step(zygos_arm_t *self);
int __wrap_zygos_step(zygos_arm_t *self);

int __wrap_zygos_step(zygos_arm_t *self)
{
    const volatile uint32_t *lost = &self->receiver.faults.overrun;
    while ((self->cycles == 60u) && (*lost < 5u)) {
        core_sleep();
    }
    return __real_zygos_step(self);
}
