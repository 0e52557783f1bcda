#include "zygos/zygos.h"

#include <stddef.h>

/* Apart from the other calls, so that only who refines links the refinement. */
int zygos_refine(zygos_t *self, zygos_refine_t *refine, const zygos_refine_settings_t *settings, uint32_t slices)
{
    if ((self == NULL) || (refine == NULL) || (settings == NULL)) {
        return ZYGOS_E_NULL;
    }
    const uintptr_t config = self->given[0].config;
    if ((self->magic != ZYGOS_BEGUN) || (config != self->given[1].config) || (config != self->given[2].config)) {
        return ZYGOS_E_ORDER;
    }
    const int verdict = zygos_refine_init(refine, (const zygos_config_t *)config, settings);
    for (uint32_t i = 0; (verdict == 1) && (i < 3u); i++) {
        self->given[i].refine = (uintptr_t)refine;
        self->given[i].slices = slices;
    }
    return verdict;
}
