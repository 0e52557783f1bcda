/* SPDX-License-Identifier: MIT */
#include "zygos/priv/tables.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>

#define WORD 8u

#define SIZE_OF(member) (sizeof(((zygos_arm_t *)0)->member))
#define TABLES(WHICH)                                                                                                  \
    WHICH(sums.column_map)                                                                                             \
    WHICH(geometry)                                                                                                    \
    WHICH(smoother.taps)                                                                                               \
    WHICH(smoother.gyro)                                                                                               \
    WHICH(smoother.limit)                                                                                              \
    WHICH(noise)                                                                                                       \
    WHICH(sums.motors.column_map)                                                                                      \
    WHICH(sums.motors.noise)                                                                                           \
    WHICH(sums.momentum.deviation)                                                                                     \
    WHICH(sums.momentum.rotor)                                                                                         \
    WHICH(sums.joints.weight)                                                                                          \
    WHICH(sums.joints.deviation)                                                                                       \
    WHICH(sums.joints.rotor_variance)

/* Where the configuration and the tables are, in the order in which they are verified. */
typedef struct {
    uint32_t at;
    uint32_t bytes;
} region_t;
#define REGION(member) { (uint32_t)offsetof(zygos_arm_t, member), (uint32_t)SIZE_OF(member) },
static const region_t regions[] = { REGION(sums.config) TABLES(REGION) };
#define REGIONS ((uint32_t)(sizeof regions / sizeof regions[0]))

/* Cycles that the patrol takes for them. */
#define MOST (ZYGOS_PATROL_WORDS * WORD)
#define PARTS(member) +(uint32_t)((SIZE_OF(member) + MOST - 1u) / MOST)
#define PASS (0u PARTS(sums.config) TABLES(PARTS))

static const unsigned char *memory_of(const zygos_arm_t *arm, uint32_t region)
{
    return (const unsigned char *)arm + regions[region].at;
}

/* Of the counts among them. */
static uint64_t counts_checksum(const zygos_arm_t *arm)
{
    const zygos_momentum_sums_t *momentum = &arm->sums.momentum;
    const zygos_joint_sums_t *joints = &arm->sums.joints;
    const uint32_t counts[10] = {
        arm->smoother.joints, arm->smoother.window, arm->sums.energy.noisy, momentum->columns, momentum->components,
        momentum->signals,    joints->width,        joints->increments,     joints->slice,     joints->share,
    };
    return zygos_checksum_number(zygos_checksum_memory(0u, counts, (uint32_t)sizeof counts), arm->sums.checksum);
}

uint64_t zygos_tables_checksum(const zygos_arm_t *arm)
{
    uint64_t sum = counts_checksum(arm);
    for (uint32_t k = 1; k < REGIONS; k++) {
        sum = zygos_checksum_memory(sum, memory_of(arm, k), regions[k].bytes);
    }
    return sum;
}

static bool end_pass(zygos_patrol_t *self, zygos_arm_t *arm)
{
    const bool good = (self->sum == arm->tables_checksum);
    if (good) {
        arm->scrubbed = self->begun;
    }
    self->region = 0;
    self->offset = 0;
    return good;
}

bool zygos_patrol_part(zygos_patrol_t *self, zygos_arm_t *arm, const zygos_config_t *config)
{
    const uint32_t region = (self->region < REGIONS) ? self->region : 0u;
    const uint32_t bytes = regions[region].bytes;
    const uint32_t from = (self->offset < bytes) ? self->offset : 0u;
    const uint32_t part = zygos_least(bytes - from, MOST);
    bool good = true;
    if (region == 0) {
        if (from == 0) {
            self->begun = arm->sums.cycle;
            self->sum = counts_checksum(arm);
        }
        good = zygos_is_same(memory_of(arm, 0) + from, (const unsigned char *)config + from, part);
    } else {
        self->sum = zygos_checksum_memory(self->sum, memory_of(arm, region) + from, part);
    }
    self->offset = from + part;
    if (self->offset < bytes) {
        return good;
    }
    self->region = region + 1u;
    self->offset = 0;
    return (self->region < REGIONS) ? good : end_pass(self, arm);
}

uint32_t zygos_patrol_cycles(void)
{
    return PASS;
}
