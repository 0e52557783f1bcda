#ifndef ZYGOS_H
#define ZYGOS_H

#include "estimate.h"
#include "priv/arm.h"
#include "refine.h"
#include "snapshot.h"
#include "text.h"
#include "types.h"
#include "wire.h"

#endif
