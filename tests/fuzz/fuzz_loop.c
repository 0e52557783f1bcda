/* SPDX-License-Identifier: MIT */
/* Puts random bytes over all that the loop of zygos.h keeps: zygos_t, the memory for solutions and the refinement. Then
 * every call of the loop stays within this memory, under the sanitizers this is compiled with, and ends; and after
 * zygos_init() it works again.
 *
 * One thing is out of scope: where all three copies of what zygos_init() was given say the same wrong thing, the
 * library has no other address to go by. Only one copy is overwritten, or the same bit flips in two of them.
 *
 * Usage: fuzz_loop SEED TRIES JOINTS. Prints counts; status 1 and a message when a check failed. */

#include <stddef.h>

#include "traffic.h"

#define BEFORE 90u /* cycles before a change, */
#define BEHIND 12u /* and behind it */
#define CALLS 40u
#define EVERY 3u    /* cycles between two calls of zygos_solve() */
#define MOMENTS 12u /* successive cycles, so that a copy is in any of its parts */

static zygos_config_t config;
static zygos_t arm;
static zygos_t good[2][MOMENTS];
static union {
    zygos_background_t background;
    zygos_in_place_t in_place;
} memory, good_memory[2][MOMENTS];
static zygos_refine_t refine;
static zygos_refine_t good_refine[2][MOMENTS];
static zygos_refine_settings_t settings;
static zygos_estimate_t estimate;
static slot_t slot[4 + 2 * ZYGOS_MAX_JOINTS];
static uint32_t slot_count;
static bool given_spoilt;
static uint64_t refused, stepped, solved, restarted, sealed, refined;

static void check(bool holds, const char *what)
{
    if (!holds) {
        printf("%s\n", what);
        exit(1);
    }
}

/* One cycle as a program flies it. Returns the last verdict of zygos_step(). */
static int fly(uint64_t cycle)
{
    for (uint32_t i = 0; i < slot_count; i++) {
        const zygos_record_t record = record_of(slot[i], cycle);
        const zygos_frame_t frame = encode(&record, slot[i]);
        (void)zygos_frame(&arm, &frame);
    }
    int verdict = 1;
    for (uint32_t call = 0; (call < CALLS) && (verdict == 1); call++) {
        verdict = zygos_step(&arm);
        stepped += (verdict == 1) ? 1u : 0u;
    }
    check(verdict < 1, "steps do not end");
    if (cycle % EVERY == 0) {
        solved += (zygos_solve(&arm, &estimate) == 1) ? 1u : 0u;
    }
    return verdict;
}

static int begin(bool background)
{
    const size_t bytes = background ? sizeof memory.background : sizeof memory.in_place;
    const int begun = zygos_init(&arm, &config, &memory, (uint32_t)bytes);
    return (begun == 1) ? zygos_refine(&arm, &refine, &settings, 3) : begun;
}

static void fill(void *from, size_t bytes)
{
    for (size_t at = 0; at < bytes; at++) {
        ((unsigned char *)from)[at] = (unsigned char)draw();
    }
}

static void flip(void *from, size_t bytes)
{
    const size_t bit = (size_t)draw() % (8u * bytes);
    ((unsigned char *)from)[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
}

/* Random bytes, or some words that may be places, or some bits. */
static void spoil(void *from, size_t bytes)
{
    static const uint32_t words[] = { 0, 1, 2, 3, 7, 8, 0x15, 0x2A, 0x3F, 200, 0x7FFFFFFFu, 0x80000000u, 0xFFFFFFFFu };
    const uint32_t how = below(4);
    for (uint32_t times = 1u + below(4); (how > 0) && (times > 0); times--) {
        const uint32_t word = (how == 1u) ? (uint32_t)draw() : words[below(13)];
        if (how == 3u) {
            flip(from, bytes);
        } else {
            memcpy((unsigned char *)from + 4u * ((size_t)draw() % (bytes / 4u)), &word, sizeof word);
        }
    }
    if (how == 0) {
        fill(from, bytes);
    }
}

/* Once, until zygos_step() has repaired it: two wrong copies are wrong. */
static void spoil_given(void)
{
    if (given_spoilt) {
        return;
    }
    given_spoilt = true;
    const uint32_t first = below(3);
    if (below(2) == 0) {
        fill(&arm.given[first], sizeof arm.given[0]);
        return;
    }
    const size_t bit = (size_t)draw() % (8u * sizeof arm.given[0]);
    for (uint32_t k = 0; k < 2u; k++) {
        ((unsigned char *)&arm.given[(first + k) % 3u])[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
    }
}

/* All but the magic number, mostly: without it nothing happens. */
static void spoil_state(void)
{
    const uint32_t magic = arm.state.magic;
    const zygos_config_t before = arm.state.sums.config;
    spoil(&arm.state, sizeof arm.state);
    arm.state.magic = (below(4) == 0) ? arm.state.magic : magic;
    if (below(2) == 0) {
        arm.state.sums.config = before;
    }
}

/* Counts with which a step addresses memory before it has verified them. */
static void spoil_counts(void)
{
    zygos_arm_t *state = &arm.state;
    uint32_t *const count[] = { &state->sums.config.joints,        &state->sums.energy.width,
                                &state->sums.energy.store.count,   &state->sums.motors.store.count,
                                &state->sums.momentum.store.count, &state->sums.guard.parameters,
                                &state->sums.momentum.columns,     &state->sums.joints.width,
                                &state->sums.joints.target,        &state->sums.joints.adding,
                                &state->sums.energy.filling,       &state->sums.energy.store.parity };
    for (uint32_t times = 1u + below(3); times > 0; times--) {
        *count[below(12)] = (below(2) == 0) ? (uint32_t)draw() : below(300);
    }
}

static void change(bool background)
{
    const size_t counters = offsetof(zygos_t, given) - offsetof(zygos_t, stage);
    for (uint32_t times = 1u + below(3); times > 0; times--) {
        switch (below(10)) {
        case 0:
            spoil(&arm.stage, counters);
            break;
        case 1:
            spoil_given();
            break;
        case 2:
            spoil(&arm.handover, sizeof arm.handover);
            break;
        case 3:
            spoil(&arm.patrol, sizeof arm.patrol);
            spoil(&arm.refined, sizeof arm.refined);
            break;
        case 4:
            spoil(arm.ring, sizeof arm.ring);
            break;
        case 5:
            spoil_state();
            break;
        case 6:
            spoil(&memory, background ? sizeof memory.background : sizeof memory.in_place);
            break;
        case 7:
            spoil(&refine, sizeof refine);
            break;
        default:
            spoil_counts();
            break;
        }
    }
}

/* Every call, in whatever order. */
static void call_all(uint64_t cycle)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    for (uint32_t times = 1u + below(BEHIND); times > 0; times--) {
        const uint32_t call = below(16);
        if (call == 0) {
            restarted += (zygos_restart(&arm, below(8)) == 1) ? 1u : 0u;
        } else if (call == 1) {
            sealed += (zygos_seal(&arm, head) == 1) ? 1u : 0u;
        } else if (call == 2) {
            solved += (zygos_solve(&arm, &estimate) == 1) ? 1u : 0u;
        } else if (call == 3) {
            refined += (zygos_refine(&arm, &refine, &settings, below(3)) == 1) ? 1u : 0u;
        } else {
            refused += (fly(cycle) < 0) ? 1u : 0u;
            cycle++;
        }
    }
}

int main(int count, char **argument)
{
    if (count != 4) {
        printf("usage: fuzz_loop SEED TRIES JOINTS\n");
        return 2;
    }
    random_state = strtoull(argument[1], NULL, 10) * 2u + 1u;
    const uint64_t tries = strtoull(argument[2], NULL, 10);
    const uint32_t joints = (uint32_t)strtoul(argument[3], NULL, 10);
    slot_count = slots(slot, joints, 1);
    config = config_of(joints, 1);
    config.arc_cycles = 20;
    config.impulse_arc_cycles = 20;
    config.momentum_arc_cycles = (ZYGOS_MOMENTUM != 0) ? 20u : 0u;
    check(zygos_refine_defaults(&settings, &config) == 1, "no defaults");
    for (uint32_t place = 0; place < 2u; place++) {
        check(begin(place == 0) == 1, "not initialised");
        for (uint32_t cycle = 0; cycle < BEFORE; cycle++) {
            check(fly(cycle) == 0, "refused without a change");
            good[place][cycle % MOMENTS] = arm;
            good_memory[place][cycle % MOMENTS] = memory;
            good_refine[place][cycle % MOMENTS] = refine;
        }
    }
    for (uint64_t k = 0; k < tries; k++) {
        const uint32_t place = (uint32_t)(k % 2u);
        const uint32_t moment = below(MOMENTS);
        arm = good[place][moment];
        memory = good_memory[place][moment];
        refine = good_refine[place][moment];
        given_spoilt = false;
        change(place == 0);
        call_all(BEFORE);
        change(place == 0);
        call_all(BEFORE + BEHIND);
    }
    check(begin(true) == 1, "not initialised again");
    check(fly(0) == 0, "refused after zygos_init()");
    printf("refused %" PRIu64 "\nstepped %" PRIu64 "\nsolved %" PRIu64 "\nrestarted %" PRIu64 "\nsealed %" PRIu64
           "\nrefined %" PRIu64 "\n",
           refused, stepped, solved, restarted, sealed, refined);
    return 0;
}
