/* SPDX-License-Identifier: MIT */
/* Flies the refinement on board, changes its memory between two calls, and goes on: one bit, the same bit of two words,
 * several words, or all of it. Whatever was changed, all that follows stays within its memory, under the sanitizers
 * this is compiled with, and ends; and a value hardly ever moves in silence.
 *
 * Usage: fuzz_refine RUN SEED TRIES, with RUN of bench/onboard.py. Prints counts; status 1 and a message when a check
 * failed. */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "zygos/zygos.h"

#define BEGUN 60u   /* cycles before the first change */
#define CYCLES 90u  /* of the flight that is compared with */
#define FOLLOW 10u  /* cycles flown behind a change */
#define SLICES 400u /* more than a cycle has */
#define MOVED 0.5   /* standard deviations that a value may move without a notice, */
#define WIDER 1.5   /* and the factor by which a deviation may change */
#define PARAMETERS (ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS)

typedef struct {
    double value[PARAMETERS];
    double sigma[PARAMETERS];
} values_t;

static zygos_config_t config;
static zygos_estimate_t estimate;
static zygos_refine_settings_t settings;
static zygos_cycle_t cycle[CYCLES];
static values_t expected[CYCLES];
static zygos_refine_t before[CYCLES]; /* each cycle */
static zygos_refine_t task;
static zygos_refined_t refined;
static uint64_t random_state;

static void check(bool holds, const char *what)
{
    if (!holds) {
        printf("%s\n", what);
        exit(1);
    }
}

static uint64_t draw(void)
{
    random_state += 0x9E3779B97F4A7C15u;
    uint64_t z = random_state;
    z = (z ^ (z >> 30u)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27u)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31u);
}

static uint32_t below(uint32_t limit)
{
    return (uint32_t)(draw() % limit);
}

/* So many slices, or all that there are. Returns the last verdict. */
static int work(uint32_t slices)
{
    int verdict = 1;
    for (uint32_t k = 0; (k < slices) && (verdict == 1); k++) {
        verdict = zygos_refine_step(&task, &config);
    }
    check((verdict < 1) || (slices < SLICES), "the slices of a cycle do not end");
    return verdict;
}

/* Parameters and deviations. Returns whether they are published or judged as without a change. */
static void see(values_t *out)
{
    double covariance[PARAMETERS * PARAMETERS];
    const uint32_t p = task.filter.propagation.parameters;
    zygos_refiner_parameters(&task.filter, out->value, covariance);
    for (uint32_t k = 0; k < p; k++) {
        out->sigma[k] = __builtin_sqrt(covariance[k * p + k]);
    }
}

static void flip(uint64_t bit)
{
    ((unsigned char *)&task)[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
}

enum kind { ONE_BIT, PAIR_OF_WORDS, PAIR_OF_NUMBERS, WORDS, ALL, KINDS };

static void change(enum kind kind)
{
    const uint64_t bits = 8u * sizeof task;
    const uint32_t size = (kind == PAIR_OF_NUMBERS) ? 64u : 32u;
    unsigned char *bytes = (unsigned char *)&task;
    const uint64_t bit = draw() % bits;
    if (kind == ONE_BIT) {
        flip(bit);
    } else if ((kind == PAIR_OF_WORDS) || (kind == PAIR_OF_NUMBERS)) {
        const uint64_t words = bits / size;
        const uint64_t first = draw() % words;
        const uint64_t other = (first + 1u + draw() % ((below(2) == 0) ? 8u : words - 1u)) % words;
        flip(first * size + bit % size);
        flip(other * size + bit % size);
    } else if (kind == WORDS) {
        static const uint32_t words[] = { 0, 1, 2, 3, 7, 8, 17, 1000, 0x7FFFFFFFu, 0x80000000u, 0xFFFFFFFFu };
        for (uint32_t times = 1u + below(3); times > 0; times--) {
            const uint32_t word = (below(3) == 0) ? (uint32_t)draw() : words[below(11)];
            memcpy(bytes + 4u * below((uint32_t)(sizeof task / 4u)), &word, sizeof word);
        }
    } else {
        const uint32_t magic = task.magic;
        for (size_t at = 0; at < sizeof task; at++) {
            bytes[at] = (unsigned char)draw();
        }
        task.magic = (below(2) == 0) ? magic : task.magic;
    }
}

static uint64_t changed[KINDS];
static uint64_t silent[KINDS];
static uint64_t noticed[KINDS];

/* A program that begins anew, or prepares the task again, where a call refuses or the refinement was abandoned. */
static bool mend(int verdict)
{
    if (verdict >= 0) {
        const int judged = zygos_refine_judge(&task, &config, &estimate, &refined);
        if ((judged >= 0) && (refined.reason != (uint32_t)ZYGOS_REFINE_FAILED) &&
            (refined.reason != (uint32_t)ZYGOS_REFINE_CORRUPT)) {
            return false;
        }
    }
    if (zygos_refine_start(&task, &config, &estimate, NULL) != 1) {
        check(zygos_refine_init(&task, &config, &settings) == 1, "not prepared again");
        check(zygos_refine_start(&task, &config, &estimate, NULL) == 1, "not begun again");
    }
    return true;
}

static void fly(enum kind kind)
{
    const uint32_t at = BEGUN + below(CYCLES - FOLLOW - BEGUN);
    const uint32_t slices = (below(4) == 0) ? 0u : below(45);
    task = before[at];
    check(zygos_refine_cycle(&task, &cycle[at]) == 1, "the queue is full");
    (void)work(slices);
    change(kind);
    bool quiet = !mend(work(SLICES));
    for (uint32_t k = at + 1u; k < at + FOLLOW; k++) {
        const int verdict = zygos_refine_cycle(&task, &cycle[k]);
        quiet = (verdict == 1) && quiet;
        quiet = !mend(work(SLICES)) && quiet;
    }
    const zygos_refine_t *right = &before[at + FOLLOW];
    quiet = quiet && (task.restarts == right->restarts) && (task.lost == right->lost) &&
            (task.overrun == right->overrun) && (task.rejected == right->rejected);
    changed[kind]++;
    noticed[kind] += quiet ? 0u : 1u;
    values_t found;
    see(&found);
    bool moved = false;
    for (uint32_t k = 0; quiet && (k < task.filter.propagation.parameters); k++) {
        const values_t *of = &expected[at + FOLLOW - 1u];
        const double off = __builtin_fabs(found.value[k] - of->value[k]) / of->sigma[k];
        const double ratio = found.sigma[k] / of->sigma[k];
        moved = moved || !(off <= MOVED) || !(ratio <= WIDER) || !(ratio >= 1.0 / WIDER);
    }
    silent[kind] += moved ? 1u : 0u;
}

/* Memory that was never prepared, null pointers, and arguments that cannot be. */
static void misuse(void)
{
    zygos_config_t wild = config;
    zygos_refine_settings_t other = settings;
    unsigned char *bytes = (unsigned char *)&wild;
    check(zygos_refine_defaults(NULL, &config) == ZYGOS_E_NULL, "defaults without settings");
    check(zygos_refine_defaults(&other, NULL) == ZYGOS_E_NULL, "defaults without a configuration");
    for (uint32_t k = 0; k < 20u; k++) {
        for (size_t at = 0; at < sizeof wild; at++) {
            bytes[at] = (unsigned char)draw();
        }
        check(zygos_refine_defaults(&other, &wild) < 0, "defaults of random memory");
        check(zygos_refine_init(&task, &wild, &settings) < 0, "prepared with a random configuration");
        change(ALL);
        task.magic = (uint32_t)draw();
        check(zygos_refine_start(&task, &config, &estimate, NULL) == ZYGOS_E_ORDER, "random memory begins");
        check(zygos_refine_cycle(&task, &cycle[0]) == ZYGOS_E_ORDER, "random memory takes a cycle");
        check(zygos_refine_step(&task, &config) == ZYGOS_E_ORDER, "random memory does a slice");
        check(zygos_refine_judge(&task, &config, &estimate, &refined) == ZYGOS_E_ORDER, "random memory is judged");
    }
    task = before[BEGUN];
    wild = config;
    for (uint32_t k = 0; k < 200u; k++) { /* a configuration that changes in the caller's memory */
        const uint64_t bit = draw() % (8u * sizeof wild);
        bytes[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
        (void)zygos_refine_cycle(&task, &cycle[BEGUN]);
        int verdict = 1;
        for (uint32_t slice = 0; (slice < SLICES) && (verdict == 1); slice++) {
            verdict = zygos_refine_step(&task, &wild);
        }
        check(verdict < 1, "slices with another configuration do not end");
        (void)zygos_refine_judge(&task, &wild, &estimate, &refined);
        (void)zygos_refine_start(&task, &wild, &estimate, NULL);
        bytes[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
        task = before[BEGUN];
        zygos_estimate_t spoiled = estimate;
        for (size_t at = 0; at < sizeof spoiled; at++) {
            ((unsigned char *)&spoiled)[at] = (unsigned char)draw();
        }
        (void)zygos_refine_judge(&task, &config, &spoiled, &refined);
        (void)zygos_refine_start(&task, &config, &spoiled, NULL);
        zygos_cycle_t readings;
        for (size_t at = 0; at < sizeof readings; at++) {
            ((unsigned char *)&readings)[at] = (unsigned char)draw();
        }
        readings.sync = before[BEGUN].sync + 1u;
        readings.flags = 0;
        task = before[BEGUN];
        check(zygos_refine_cycle(&task, &readings) == 1, "not handed over");
        (void)work(SLICES);
        task = before[BEGUN];
    }
}

int main(int count, char **argument)
{
    FILE *run = (count == 4) ? fopen(argument[1], "rb") : NULL;
    uint32_t head[6];
    double relative;
    if ((run == NULL) || (fread(head, sizeof head, 1, run) != 1) || (head[0] != sizeof config) ||
        (head[1] != sizeof estimate) || (head[2] != sizeof cycle[0]) || (head[3] < CYCLES) ||
        (fread(&relative, sizeof relative, 1, run) != 1) || (fread(&config, sizeof config, 1, run) != 1) ||
        (fread(&estimate, sizeof estimate, 1, run) != 1) || (fread(cycle, sizeof cycle, 1, run) != 1)) {
        printf("usage: fuzz_refine RUN SEED TRIES, with RUN of this build\n");
        return 2;
    }
    (void)fclose(run);
    config.abi = ZYGOS_ABI;
    random_state = strtoull(argument[2], NULL, 10);
    const uint64_t tries = strtoull(argument[3], NULL, 10);
    (void)zygos_refine_defaults(&settings, &config);
    settings.every = head[4];
    settings.terms = head[5];
    settings.window = 20u;
    for (uint32_t i = 0; i < config.joints; i++) {
        settings.filter.torque_relative_sigma[i] = relative;
    }
    check(zygos_refine_init(&task, &config, &settings) == 1, "not prepared");
    check(zygos_refine_start(&task, &config, &estimate, NULL) == 1, "not begun");
    for (uint32_t k = 0; k < CYCLES; k++) {
        before[k] = task;
        check(zygos_refine_cycle(&task, &cycle[k]) == 1, "the queue is full");
        check(work(SLICES) == 0, "a slice is refused");
        see(&expected[k]);
    }
    check((task.filter.failed == 0u) && (task.used > 50u), "the flight without a change fails");
    misuse();
    for (uint64_t k = 0; k < tries; k++) {
        const uint32_t kind = (k % 2u == 0) ? (uint32_t)ONE_BIT : 1u + (uint32_t)(k / 2u) % ((uint32_t)KINDS - 1u);
        fly((enum kind)kind);
    }
    for (uint32_t kind = 0; kind < (uint32_t)KINDS; kind++) {
        static const char *const name[] = { "one_bit", "pair_of_words", "pair_of_numbers", "words", "all" };
        printf("%s %" PRIu64 "\n%s_noticed %" PRIu64 "\n%s_silent %" PRIu64 "\n", name[kind], changed[kind], name[kind],
               noticed[kind], name[kind], silent[kind]);
    }
    return 0;
}
