/* SPDX-License-Identifier: MIT */
/* Firmware that processes recorded vectors: reads run.bin through semihosting, runs the library on it, writes out.bin.
   A computer of the other kind that does the same must come to the same bytes.

   run.bin: ZYGOS_ABI and a zygos_config_t; then sections, each of two uint32 (kind, count) and what follows:
       frames    count zygos_frame_t, each through zygos_arm_frame(), then zygos_arm_step() while cycles wait
       cycles    count zygos_cycle_t, each through zygos_arm_cycle()
       image     nothing: zygos_arm_t as it lies in memory
       estimate  nothing: zygos_arm_take() and zygos_work_solve(), or, compiled with IN_PLACE=1, zygos_arm_solve()
   out.bin: records, each of two uint32 (kind, bytes) and what follows:
       init      int32: what zygos_arm_init() returned; when it refused, no section is processed
       verdicts  int8 for each frame or cycle of a section: what the call returned
       instant   for each cycle that was processed: its number, whether it has a row and was accepted, motion and row
       image, estimate
       sizes     four uint32, at the end: bytes of zygos_arm_t, zygos_work_t (or zygos_solver_t), zygos_estimate_t, and
   of stack used */

#include "core.h"
#include "semihosting.h"
#include "zygos/zygos.h"

#include <string.h>

enum section { FRAMES = 1, CYCLES = 2, IMAGE = 3, ESTIMATE = 4 };
enum record { INIT = 1, VERDICTS = 2, INSTANT = 3, MEMORY = 4, SOLVED = 5, SIZES = 6 };
enum status { DONE = 0, NO_FILE = 1, OTHER_BUILD = 2, CUT_SHORT = 3, UNKNOWN_SECTION = 4, NOT_WRITTEN = 5 };

typedef struct {
    uint64_t cycle;
    uint32_t instant;
    uint32_t accepted;
    zygos_arm_state_t state;
    zygos_motion_t motion;
    zygos_row_t row;
} instant_t;

#ifndef IN_PLACE
#define IN_PLACE 0
#endif

static zygos_arm_t arm;
#if IN_PLACE
static zygos_solver_t work;
#else
static zygos_work_t work;
#endif
static zygos_estimate_t estimate;
static zygos_config_t config;
static instant_t instant;
static int32_t in;
static int32_t out;
static uint32_t not_written;

static bool take(void *to, uint32_t size)
{
    return semihosting_read(in, to, size) == size;
}

static void put(uint32_t kind, const void *from, uint32_t size)
{
    const uint32_t head[2] = { kind, size };
    not_written |= (semihosting_write(out, head, sizeof head) != sizeof head) ? 1u : 0u;
    not_written |= (semihosting_write(out, from, size) != size) ? 1u : 0u;
}

static void put_instant(void)
{
    instant.cycle = arm.sums.cycle;
    instant.instant = arm.instant;
    instant.accepted = (arm.accepted > 0.0) ? 1u : 0u;
    memcpy(&instant.state, &arm.arm_state, sizeof arm.arm_state);
    memcpy(&instant.motion, &arm.motion, sizeof arm.motion);
    memcpy(&instant.row, &arm.row, sizeof arm.row);
    put(INSTANT, &instant, sizeof instant);
}

static bool frames(uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        zygos_frame_t frame;
        if (!take(&frame, sizeof frame)) {
            return false;
        }
        const int8_t verdict = (int8_t)zygos_arm_frame(&arm, &frame);
        put(VERDICTS, &verdict, sizeof verdict);
        while (zygos_arm_step(&arm) == 1) {
            put_instant();
        }
    }
    return true;
}

static bool cycles(uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        zygos_cycle_t cycle;
        if (!take(&cycle, sizeof cycle)) {
            return false;
        }
        const int8_t verdict = (int8_t)zygos_arm_cycle(&arm, &cycle);
        put(VERDICTS, &verdict, sizeof verdict);
        if (verdict == 1) {
            put_instant();
        }
    }
    return true;
}

static void solve(void)
{
#if IN_PLACE
    (void)zygos_arm_solve(&arm, &work, &estimate);
#else
    zygos_arm_take(&arm, &work);
    (void)zygos_work_solve(&work, &estimate);
#endif
}

static enum status sections(void)
{
    uint32_t head[2];
    while (take(head, sizeof head)) {
        bool whole = true;
        switch (head[0]) {
        case FRAMES:
            whole = frames(head[1]);
            break;
        case CYCLES:
            whole = cycles(head[1]);
            break;
        case IMAGE:
            put(MEMORY, &arm, sizeof arm);
            break;
        case ESTIMATE:
            solve();
            put(SOLVED, &estimate, sizeof estimate);
            break;
        default:
            return UNKNOWN_SECTION;
        }
        if (!whole) {
            return CUT_SHORT;
        }
    }
    return DONE;
}

int main(void)
{
    in = semihosting_open("run.bin", SEMIHOSTING_READ);
    out = semihosting_open("out.bin", SEMIHOSTING_WRITE);
    if ((in < 0) || (out < 0)) {
        return NO_FILE;
    }
    uint32_t abi = 0;
    if (!take(&abi, sizeof abi) || (abi != ZYGOS_ABI) || !take(&config, sizeof config)) {
        return OTHER_BUILD;
    }
    const int32_t verdict = zygos_arm_init(&arm, &config);
    put(INIT, &verdict, sizeof verdict);
    const enum status status = (verdict == 1) ? sections() : DONE;
    const uint32_t sizes[4] = { sizeof arm, sizeof work, sizeof estimate, core_stack_used() };
    put(SIZES, sizes, sizeof sizes);
    if ((semihosting_close(out) != 0) || (not_written != 0)) {
        return NOT_WRITTEN;
    }
    return status;
}
