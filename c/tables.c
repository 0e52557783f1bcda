#include "zygos/priv/tables.h"

#include "zygos/priv/gram.h"

#include <stddef.h>

#define WORD 8u

/* One of the tables. */
typedef struct {
    const void *memory;
    uint32_t bytes;
} region_t;

#define REGIONS 13u

static region_t region(const void *memory, size_t bytes)
{
    const region_t out = { memory, (uint32_t)bytes };
    return out;
}
#define WHOLE(member) region(&(member), sizeof(member))

static region_t region_of(const zygos_arm_t *arm, uint32_t k)
{
    switch (k) {
    case 0:
        return WHOLE(arm->column_map);
    case 1:
        return WHOLE(arm->geometry);
    case 2:
        return WHOLE(arm->smoother.taps);
    case 3:
        return WHOLE(arm->smoother.gyro);
    case 4:
        return WHOLE(arm->smoother.limit);
    case 5:
        return WHOLE(arm->noise);
    case 6:
        return WHOLE(arm->motor_sums.column_map);
    case 7:
        return WHOLE(arm->motor_sums.noise);
    case 8:
        return WHOLE(arm->momentum_sums.deviation);
    case 9:
        return WHOLE(arm->momentum_sums.rotor);
    case 10:
        return WHOLE(arm->joint_sums.weight);
    case 11:
        return WHOLE(arm->joint_sums.deviation);
    default:
        return WHOLE(arm->joint_sums.rotor_variance);
    }
}

/* Of the counts among them. */
static uint64_t counts_checksum(const zygos_arm_t *arm)
{
    const zygos_momentum_sums_t *momentum = &arm->momentum_sums;
    const zygos_joint_sums_t *joints = &arm->joint_sums;
    const uint32_t counts[10] = {
        arm->smoother.joints, arm->smoother.window, arm->accumulator.noisy, momentum->columns, momentum->components,
        momentum->signals,    joints->width,        joints->increments,     joints->slice,     joints->share,
    };
    return zygos_checksum_memory(0u, counts, (uint32_t)sizeof counts);
}

uint64_t zygos_tables_checksum(const zygos_arm_t *arm)
{
    uint64_t sum = counts_checksum(arm);
    for (uint32_t k = 0; k < REGIONS; k++) {
        const region_t table = region_of(arm, k);
        sum = zygos_checksum_memory(sum, table.memory, table.bytes);
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
    const region_t table = region_of(arm, self->region - 1u);
    const uint32_t bytes = (self->region == 0) ? (uint32_t)sizeof *config : table.bytes;
    const uint32_t from = (self->offset < bytes) ? self->offset : 0u;
    const uint32_t left = bytes - from;
    const uint32_t part = (left < ZYGOS_PATROL_WORDS * WORD) ? left : ZYGOS_PATROL_WORDS * WORD;
    bool good = true;
    if (self->region == 0) {
        self->begun = (from == 0) ? arm->cycle : self->begun;
        good = zygos_is_same((const unsigned char *)&arm->config + from, (const unsigned char *)config + from, part);
        self->sum = counts_checksum(arm);
    } else {
        self->sum = zygos_checksum_memory(self->sum, (const unsigned char *)table.memory + from, part);
    }
    self->offset = from + part;
    if (self->offset < bytes) {
        return good;
    }
    self->region++;
    self->offset = 0;
    return (self->region <= REGIONS) ? good : end_pass(self, arm);
}

uint32_t zygos_patrol_cycles(const zygos_arm_t *arm)
{
    const uint32_t most = ZYGOS_PATROL_WORDS * WORD;
    uint32_t cycles = ((uint32_t)sizeof arm->config + most - 1u) / most;
    for (uint32_t k = 0; k < REGIONS; k++) {
        cycles += (region_of(arm, k).bytes + most - 1u) / most;
    }
    return cycles;
}
