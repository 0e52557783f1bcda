/* SPDX-License-Identifier: MIT */
/* What a flight computer may do with the library, as libFuzzer's bytes say: cycles, damaged and foreign frames,
 * solutions, states that are sealed, damaged and resumed, configurations with wild members. The sanitizers watch; a
 * check of the library's own promises aborts.
 *
 * Usage: that of libFuzzer (clang -fsanitize=fuzzer,address,undefined). */

#include "traffic.h"

static zygos_arm_t arm;
static zygos_work_t work;
static zygos_estimate_t estimate;
static slot_t slot[4 + 2 * ZYGOS_MAX_JOINTS];

typedef struct {
    const uint8_t *at;
    size_t left;
} bytes_t;

/* Zeros after the end. */
static void take(bytes_t *from, void *to, size_t size)
{
    const size_t have = (from->left < size) ? from->left : size;
    memset(to, 0, size);
    memcpy(to, from->at, have);
    from->at += have;
    from->left -= have;
}

static uint32_t number(bytes_t *from, size_t size)
{
    uint32_t out = 0;
    take(from, &out, size);
    return out;
}

static void check(bool holds)
{
    if (!holds) {
        abort();
    }
}

/* Changes up to 8 bytes at a place that the input says. */
static void damage(bytes_t *from, void *image, size_t size)
{
    uint8_t other[8];
    const size_t place = number(from, 4) % (size - sizeof other);
    take(from, other, sizeof other);
    for (size_t i = 0; i < sizeof other; i++) {
        ((uint8_t *)image)[place + i] ^= other[i];
    }
}

static void work_off(void)
{
    for (uint32_t i = 0; (i < 2u * ZYGOS_CYCLE_QUEUE) && (zygos_arm_step(&arm) == 1); i++) {
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    bytes_t bytes = { data, size };
    const uint32_t choice = number(&bytes, 1);
    zygos_config_t config = config_of(1u + (choice & 1u), (choice >> 1) & 1u);
    config.arc_cycles = 20u;
    config.impulse_arc_cycles = 15u;
    config.momentum_arc_cycles = (choice & 4u) ? 12u : 0u;
    config.torque_law = (choice >> 3) & 1u;
    if (choice & 16u) {
        damage(&bytes, &config, sizeof config);
    }
    random_state = 1; /* what follows depends on the input alone */
    if (zygos_arm_init(&arm, &config) != 1) {
        return 0;
    }
    /* A wild configuration that is taken may have other nodes; the frames are those of its joints at most. */
    const uint32_t joints = (config.joints <= (uint32_t)ZYGOS_MAX_JOINTS) ? config.joints : 1u;
    const uint32_t n = slots(slot, joints, config.imu_fine != 0);
    uint64_t cycle = 0;
    while (bytes.left > 0) {
        const uint32_t what = number(&bytes, 1);
        switch (what & 7u) {
        case 0: { /* cycles as they should be */
            const uint64_t end = cycle + 1u + (what >> 3);
            for (; cycle < end; cycle++) {
                for (uint32_t i = 0; i < n; i++) {
                    const zygos_record_t record = record_of(slot[i], cycle);
                    const zygos_frame_t frame = encode(&record, slot[i]);
                    (void)zygos_arm_frame(&arm, &frame);
                }
                work_off();
            }
            break;
        }
        case 1: { /* well formed, with any contents */
            const slot_t at = slot[(what >> 3) % n];
            zygos_record_t record = record_of(at, cycle);
            take(&bytes, &record, sizeof record);
            zygos_frame_t frame;
            if (zygos_wire_encode(&record, at.message, at.node, &frame) == 1) {
                (void)zygos_arm_frame(&arm, &frame);
            }
            break;
        }
        case 2: { /* any bytes at all */
            zygos_frame_t frame;
            take(&bytes, &frame, sizeof frame);
            const int verdict = zygos_arm_frame(&arm, &frame);
            check((verdict == ZYGOS_REJECTED) || (verdict == ZYGOS_ACCEPTED) || (verdict == ZYGOS_FOREIGN));
            break;
        }
        case 3: /* a cycle that a computer has decoded itself */
        {
            zygos_cycle_t decoded;
            memset(&decoded, 0, sizeof decoded);
            take(&bytes, &decoded, sizeof decoded);
            (void)zygos_arm_cycle(&arm, &decoded);
            break;
        }
        case 4:
            zygos_arm_take(&arm, &work);
            if (zygos_work_solve(&work, &estimate) == 1) {
                (void)zygos_arm_adopt(&arm, &estimate);
            }
            break;
        case 5: {
            zygos_arm_take(&arm, &work);
            damage(&bytes, &work, sizeof work);
            (void)zygos_work_solve(&work, &estimate);
            break;
        }
        case 6: { /* a stored state that was damaged before it was sealed */
            uint8_t head[ZYGOS_SNAPSHOT_HEAD];
            damage(&bytes, &arm, sizeof arm);
            check(zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, &arm, head) == 1);
            check(zygos_snapshot_check(ZYGOS_SNAPSHOT_STATE, head, &arm, sizeof head + sizeof arm) == 1);
            if (zygos_arm_resume(&arm, &config) != 1) {
                check(zygos_arm_init(&arm, &config) == 1);
            }
            break;
        }
        default:
            (void)zygos_arm_restart(&arm, what >> 3);
            break;
        }
        work_off();
    }
    return 0;
}
