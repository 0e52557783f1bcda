/* SPDX-License-Identifier: MIT */
/* The program of README.md, as it stands, in its three contexts:

   contexts FRAMES COUNT           COUNT frames in an interrupt thread, the task in the main thread, and the background
   contexts FRAMES COUNT FLIPS     the same calls in one thread, and FLIPS flipped bits between them

   FRAMES holds whole cycles of a bus, their number a multiple of 240, without the SYNC that closes the last one. They
   are repeated without the first cycle, so that the arc ends there, and FTIME goes on. With REFINE defined, a
   refinement is attached. The output is a line of numbers: initialisations after a refusal, cycles, frames lost,
   estimates, those with values, repairs, and losses. */

#include "page.c"

#include <pthread.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define MOST_FRAMES 20000
#define PAUSE_NS 10000000L /* after an estimate, so that most of the time is spent on frames */

typedef struct {
    zygos_frame_t frame[MOST_FRAMES];
    size_t frames;
    size_t again; /* where the second cycle begins */
    size_t next;
    uint32_t cycles;
    uint32_t since_us; /* the clock at the beginning of this repetition */
} bus_t;

static bus_t bus;
static unsigned long wanted; /* frames */
static uint32_t done;        /* 1: the interrupt thread has sent them; 2: the task has taken them */
static unsigned long estimates;
static unsigned long values;
static unsigned long begun_again;

#ifdef REFINE
static zygos_refine_t fine;

static int refined(void)
{
    zygos_refine_settings_t settings;
    (void)zygos_refine_defaults(&settings, &arm_config);
    return zygos_refine(&arm, &fine, &settings, 0);
}
#else
static int refined(void)
{
    return 1;
}
#endif

static void read_bus(const char *path)
{
    FILE *file = fopen(path, "rb");
    bus.frames = (file == NULL) ? 0 : fread(bus.frame, sizeof bus.frame[0], MOST_FRAMES, file);
    if ((bus.frames == 0) || (fclose(file) != 0)) {
        exit(2);
    }
    for (size_t i = 0; i < bus.frames; i++) {
        bus.cycles += (bus.frame[i].id == ZYGOS_ID_SYNC) ? 1u : 0u;
        bus.again = ((bus.again == 0) && (bus.cycles == 2u)) ? i : bus.again;
    }
}

/* The next frame of the bus. */
static zygos_frame_t next(void)
{
    if (bus.next == bus.frames) {
        bus.next = bus.again;
        bus.since_us += (uint32_t)(arm_config.period_s * 1e6 * bus.cycles + 0.5);
    }
    zygos_frame_t frame = bus.frame[bus.next++];
    zygos_record_t record;
    if ((frame.id == ZYGOS_ID_TPDO3 + ZYGOS_NODE_COMPUTER) &&
        (zygos_wire_decode(&frame, ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER, &record) == ZYGOS_WIRE_OK)) {
        record.time_us += bus.since_us;
        (void)zygos_wire_encode(&record, ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER, &frame);
    }
    return frame;
}

static void solve(void)
{
    if (background() == 1) {
        estimates++;
        values += (estimate.validity >= (uint32_t)ZYGOS_PARTIAL) ? 1u : 0u;
    }
}

/* Frames come only while half of the ring is free. The loads are relaxed: they order nothing that the library has to
   order by itself. */
static void *interrupt_thread(void *unused)
{
    for (unsigned long i = 0; i < wanted; i++) {
        while (__atomic_load_n(&arm.head, __ATOMIC_RELAXED) - __atomic_load_n(&arm.tail, __ATOMIC_RELAXED) >=
               ZYGOS_RING / 2u) {
            (void)sched_yield();
        }
        const zygos_frame_t frame = next();
        receive(&frame);
    }
    __atomic_store_n(&done, 1u, __ATOMIC_RELAXED);
    return unused;
}

static void *background_thread(void *unused)
{
    const struct timespec pause = { 0, PAUSE_NS };
    for (unsigned long before = 0; __atomic_load_n(&done, __ATOMIC_RELAXED) < 2u; before = estimates) {
        solve();
        if (estimates > before) {
            (void)nanosleep(&pause, NULL);
        }
        (void)sched_yield();
    }
    return unused;
}

static int in_threads(void)
{
    pthread_t interrupt;
    pthread_t solver;
    if ((pthread_create(&interrupt, NULL, interrupt_thread, NULL) != 0) ||
        (pthread_create(&solver, NULL, background_thread, NULL) != 0)) {
        return 2;
    }
    while ((__atomic_load_n(&done, __ATOMIC_RELAXED) == 0) ||
           (__atomic_load_n(&arm.head, __ATOMIC_RELAXED) != __atomic_load_n(&arm.tail, __ATOMIC_RELAXED))) {
        task();
    }
    __atomic_store_n(&done, 2u, __ATOMIC_RELAXED);
    return ((pthread_join(interrupt, NULL) == 0) && (pthread_join(solver, NULL) == 0)) ? 0 : 2;
}

static uint64_t state = 88172645463325252u;

static uint64_t random_below(uint64_t bound) /* xorshift64 */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state % bound;
}

static void flip(void)
{
    const uint64_t place = random_below(8u * (sizeof arm + sizeof memory));
    unsigned char *const byte = (place / 8u < sizeof arm) ? (unsigned char *)&arm + place / 8u
                                                          : (unsigned char *)&memory + (place / 8u - sizeof arm);
    *byte = (unsigned char)(*byte ^ (1u << (place % 8u)));
}

static int with_flips(unsigned long flips)
{
    const unsigned long every = wanted / flips;
    for (unsigned long i = 0; i < wanted; i++) {
        const zygos_frame_t frame = next();
        const uint64_t before = (i % every == 0) ? random_below(3u) : 3u;
        if (before == 0) {
            flip();
        }
        receive(&frame);
        if (before == 1u) {
            flip();
        }
        task();
        const int stepped = zygos_step(&arm); /* what the task was told */
        if (before == 2u) {
            flip();
        }
        solve();
        if (stepped < 0) { /* as the manual says */
            begun_again++;
            (void)start();
        }
    }
    return 0;
}

int main(int count, char **words)
{
    if (count < 3) {
        return 2;
    }
    read_bus(words[1]);
    wanted = strtoul(words[2], NULL, 10);
    if ((start() != 1) || (refined() != 1)) {
        return 3;
    }
    const int ended = (count > 3) ? with_flips(strtoul(words[3], NULL, 10)) : in_threads();
    printf("%lu %lu %lu %lu %lu %lu %lu\n", begun_again, (unsigned long)arm.state.cycles, (unsigned long)arm.overrun,
           estimates, values, (unsigned long)arm.repairs, (unsigned long)arm.losses);
    return ended;
}
