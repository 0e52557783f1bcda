/* SPDX-License-Identifier: MIT */
/* Feeds valid, damaged and random frames to zygos_arm_frame() and checks after each what it may have changed:
 * a foreign frame nothing, a rejected one a single fault counter and the reception status.
 *
 * Usage: fuzz_frames SEED FRAMES JOINTS FINE. Prints the counts; status 1 and a message when a check failed.
 * The frames depend on the arguments only. */

#include "traffic.h"

#define FAULTS (sizeof(zygos_faults_t) / sizeof(uint32_t))

static const char *const fault_names[] = {
    "length",       "crc",         "range",        "late",          "counter",        "repeated",
    "unsynced",     "latch",       "link_invalid", "motor_invalid", "torque_invalid", "disabled",
    "gyro_invalid", "saturated",   "incomplete",   "dropped",       "sync_repeated",  "sync_jumped",
    "time_lost",    "time_jumped", "overrun",      "bus_error",
};
_Static_assert(sizeof fault_names / sizeof fault_names[0] == FAULTS, "a fault counter has no name here");

static zygos_arm_t arm;
static zygos_arm_t before;
static zygos_work_t work;
static zygos_estimate_t estimate;
static uint64_t verdicts[3];
static uint64_t fed;

static void fail(const char *what, const zygos_frame_t *frame)
{
    printf("frame %" PRIu64 ": id %03" PRIX32 " length %u flags %u: %s\n", fed, frame->id, frame->length, frame->flags,
           what);
    exit(1);
}

static void check(bool good, const char *what, const zygos_frame_t *frame)
{
    if (!good) {
        fail(what, frame);
    }
}

static uint32_t increments(const zygos_faults_t *now, const zygos_faults_t *then)
{
    uint32_t a[FAULTS];
    uint32_t b[FAULTS];
    memcpy(a, now, sizeof a);
    memcpy(b, then, sizeof b);
    uint32_t sum = 0;
    for (size_t i = 0; i < FAULTS; i++) {
        sum += a[i] - b[i];
    }
    return sum;
}

/* Hands one frame over and checks what it changed. `before` holds the state before it, and is kept so. */
static int feed(const zygos_frame_t *frame)
{
    const int verdict = zygos_arm_frame(&arm, frame);
    fed++;
    check((verdict >= 0) && (verdict <= 2), "the verdict is none", frame);
    verdicts[verdict]++;
    zygos_receiver_t *old = &before.receiver;
    if (verdict == ZYGOS_REJECTED) {
        check(increments(&arm.receiver.faults, &old->faults) == 1, "rejected, but not counted once", frame);
        check(arm.receiver.status.last_verdict == ZYGOS_REJECTED, "rejected, but the status says otherwise", frame);
        old->faults = arm.receiver.faults;
        old->status = arm.receiver.status;
    }
    if (verdict == ZYGOS_ACCEPTED) {
        check(arm.receiver.status.last_verdict == ZYGOS_ACCEPTED, "accepted, but the status says otherwise", frame);
        before.receiver = arm.receiver;
    }
    check(memcmp(&arm, &before, sizeof arm) == 0, "changed what it must not", frame);
    return verdict;
}

static void work_off(void)
{
    while (zygos_arm_step(&arm) == 1) {
    }
    memcpy(&before, &arm, sizeof arm);
}

static void start(uint32_t joints, uint32_t fine)
{
    const zygos_config_t config = config_of(joints, fine);
    if (zygos_arm_init(&arm, &config) != 1) {
        printf("zygos_arm_init refuses the configuration\n");
        exit(1);
    }
    memcpy(&before, &arm, sizeof arm);
}

static void flip(zygos_frame_t *frame, uint32_t bits)
{
    uint32_t chosen[8] = { 0 };
    for (uint32_t k = 0; k < bits; k++) {
        bool again = true;
        while (again) {
            chosen[k] = below(8u * frame->length);
            again = false;
            for (uint32_t j = 0; j < k; j++) {
                again = again || (chosen[j] == chosen[k]);
            }
        }
        frame->data[chosen[k] / 8u] ^= (uint8_t)(1u << (chosen[k] % 8u));
    }
}

static zygos_frame_t random_frame(void)
{
    zygos_frame_t frame;
    memset(&frame, 0, sizeof frame);
    frame.id = below(4) ? below(0x800) : (uint32_t)draw();
    frame.length = (uint8_t)(below(8) ? below(9) : below(256));
    frame.flags = (uint8_t)(below(4) ? 0 : below(256));
    for (uint32_t i = 0; i < sizeof frame.data; i++) {
        frame.data[i] = (uint8_t)below(256);
    }
    return frame;
}

/* Well-formed, CRC right, but with contents that cost the cycle, or that are absurd. */
static zygos_frame_t strange(zygos_record_t record, slot_t slot)
{
    static const int32_t edges[] = {
        ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX, ZYGOS_CODE_I16_MIN, ZYGOS_CODE_I16_MAX, INT32_MIN, INT32_MAX, 0, -1
    };
    switch (below(6)) {
    case 0:
        record.status = (uint8_t)below(16);
        break;
    case 1:
        record.code[below(3)] = edges[below(8)];
        break;
    case 2:
        record.latch_us = (uint16_t)below(65536);
        break;
    case 3:
        record.sync = (uint8_t)below(256);
        break;
    case 4:
        record.time_us = (uint32_t)draw();
        break;
    default:
        record.counter = (uint8_t)below(256);
        break;
    }
    return encode(&record, slot);
}

/* One frame of the bus at its worst. */
static void hostile(slot_t slot, uint64_t cycle)
{
    static zygos_frame_t past[64];
    static uint32_t written;
    const zygos_record_t record = record_of(slot, cycle);
    zygos_frame_t frame = encode(&record, slot);
    past[written++ % 64u] = frame;
    const bool protected = (slot.message != ZYGOS_MSG_SYNC);
    const uint32_t kind = below(64);
    if (kind < 36) { /* as it should be */
        feed(&frame);
    } else if (kind <
               46) { /* the CRC finds up to three wrong bits, but for those of the counter, which chooses the ID */
        const uint8_t header = frame.data[1];
        const uint32_t bits = 1u + below(8);
        flip(&frame, bits);
        const bool counted = (((frame.data[1] ^ header) & 0x0Fu) != 0);
        const int verdict = feed(&frame);
        check(!protected || (bits > 3) || counted || (verdict == ZYGOS_REJECTED), "up to three wrong bits were taken",
              &frame);
    } else if (kind < 49) {
        const uint8_t length = frame.length;
        frame.length = (uint8_t)(below(2) ? below(length) : below(256));
        const int verdict = feed(&frame);
        check((frame.length == length) || (verdict == ZYGOS_REJECTED), "a wrong DLC was taken", &frame);
    } else if (kind < 51) {
        frame.flags = (uint8_t)(1u << below(8));
        feed(&frame);
    } else if (kind < 54) { /* near our identifiers, or another of ours */
        frame.id ^= 1u << below(32);
        feed(&frame);
    } else if (kind < 56) {
        frame = past[below(64)];
        feed(&frame);
    } else if (kind < 57) {
        feed(&frame);
        feed(&frame);
    } else if (kind < 60) {
        frame = strange(record, slot);
        feed(&frame);
    } else if (kind < 63) {
        frame = random_frame();
        feed(&frame);
    } /* else lost */
}

static void fault_free(const slot_t *slot, uint32_t n, uint64_t cycles)
{
    for (uint64_t cycle = 0; cycle < cycles; cycle++) {
        for (uint32_t i = 0; i < n; i++) {
            const zygos_record_t record = record_of(slot[i], cycle);
            const zygos_frame_t frame = encode(&record, slot[i]);
            check(feed(&frame) == ZYGOS_ACCEPTED, "a good frame was not taken", &frame);
        }
        work_off();
    }
    const zygos_faults_t none = { 0 };
    const zygos_frame_t last = { 0 };
    check(memcmp(&arm.receiver.faults, &none, sizeof none) == 0, "a fault was counted on a good bus", &last);
    check(arm.cycles == cycles - 1, "a cycle was lost on a good bus", &last);
}

int main(int count, char **argument)
{
    if (count != 5) {
        printf("usage: fuzz_frames SEED FRAMES JOINTS FINE\n");
        return 2;
    }
    random_state = strtoull(argument[1], NULL, 10) * 2u + 1u;
    const uint64_t frames = strtoull(argument[2], NULL, 10);
    const uint32_t joints = (uint32_t)strtoul(argument[3], NULL, 10);
    const uint32_t fine = (uint32_t)strtoul(argument[4], NULL, 10);
    slot_t slot[4 + 2 * ZYGOS_MAX_JOINTS];
    const uint32_t n = slots(slot, joints, fine);

    start(joints, fine);
    fault_free(slot, n, 1000);

    start(joints, fine);
    for (uint32_t i = 1; i < n; i++) { /* before the first SYNC */
        const zygos_record_t record = record_of(slot[i], 0);
        const zygos_frame_t frame = encode(&record, slot[i]);
        check(feed(&frame) == ZYGOS_REJECTED, "taken before the first SYNC", &frame);
    }
    const uint64_t end = fed + frames;
    uint64_t solved = 0;
    for (uint64_t cycle = 0; fed < end; cycle++) {
        const bool good = (cycle % 256u) < 64u;          /* recovers now and then, so that there are rows to harm */
        const bool silent = ((cycle / 256u) % 4u) == 3u; /* no fine time for a while */
        for (uint32_t i = 0; i < n; i++) {
            if (silent && (slot[i].message == ZYGOS_MSG_FTIME)) {
                continue;
            }
            if (good) {
                const zygos_record_t record = record_of(slot[i], cycle);
                const zygos_frame_t frame = encode(&record, slot[i]);
                feed(&frame);
            } else {
                hostile(slot[i], cycle);
            }
        }
        if ((cycle % 512u) >= 32u) { /* else the consumer sleeps, and the queue overruns */
            work_off();
        }
        if (cycle % 4096u == 0) {
            zygos_arm_take(&arm, &work);
            solved += (zygos_work_solve(&work, &estimate) >= 0) ? 1u : 0u;
            check(memcmp(&arm, &before, sizeof arm) == 0, "take or solve changed the arm", &(zygos_frame_t){ 0 });
        }
    }
    printf("foreign %" PRIu64 "\naccepted %" PRIu64 "\nrejected %" PRIu64 "\ncycles %" PRIu64 "\nsolved %" PRIu64
           "\nrows %" PRIu64 "\n",
           verdicts[ZYGOS_FOREIGN], verdicts[ZYGOS_ACCEPTED], verdicts[ZYGOS_REJECTED], arm.cycles, solved,
           (uint64_t)zygos_store_accepted(&arm.sums.energy.store));
    uint32_t counters[FAULTS];
    memcpy(counters, &arm.receiver.faults, sizeof counters);
    for (size_t i = 0; i < FAULTS; i++) {
        printf("fault.%s %" PRIu32 "\n", fault_names[i], counters[i]);
    }
    return 0;
}
