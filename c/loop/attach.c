/* SPDX-License-Identifier: MIT */
#include "zygos/zygos.h"

#include <stddef.h>

/* Apart from the other calls, so that only who refines links the refinement. */
int zygos_refine(zygos_t *self, zygos_refine_t *refine, const zygos_refine_settings_t *settings, uint32_t slices)
{
    if ((self == NULL) || (refine == NULL) || (settings == NULL)) {
        return ZYGOS_E_NULL;
    }
    const zygos_config_t *config = zygos_reference(self);
    if (config == NULL) {
        return ZYGOS_E_ORDER;
    }
    const int verdict = zygos_refine_init(refine, config, settings);
    return (verdict == 1) ? zygos_attach(self, refine, slices) : verdict;
}
