/* SPDX-License-Identifier: MIT */
#include "zygos/types.h"

/* Apart, so that who needs nothing but a few functions links nothing else. */
const unsigned char ZYGOS_CAPACITIES = 1;
