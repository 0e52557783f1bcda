/* Flies a recorded motion again and again, flips one bit of the state in each trial, and says what came of it.

   campaign RUN FIRST LAST TRIALS SEED OUT. RUN is what bench/configurations.py writes: three uint32 (size of a
   configuration, size of a frame, number of frames), the configuration and the frames. Bits flip in cycles FIRST to
   LAST; OUT receives a record for each trial. The caller does what the manual asks: zygos_arm_scrub() once in an arc
   and before each zygos_arm_take() or zygos_arm_solve(), and whenever a call returns an error. With CAMPAIGN_IN_PLACE
   the estimates are made without a copy of the sums. */

#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#include "zygos/zygos.h"

#define APART 50u     /* cycles between two stored states */
#define PATIENCE_S 10 /* of the processor, for a trial */
#define MOVED 0.5     /* sigmas that a value may move without a notice */
#define LOOKS_AFTER 2u
#define PAGE 4096u

enum outcome { UNFINISHED, NO_EFFECT, DETECTED, SILENT, CRASH, HANG };

/* What is told of a trial. */
typedef struct {
    uint64_t bit;
    uint32_t cycle;
    uint32_t outcome;
    double moved; /* of the parameter that moved most [sigmas] */
} record_t;

/* All that a caller can see beside the values. */
typedef struct {
    zygos_faults_t faults;
    uint64_t gaps, invalid, wraps, apart, quarantined;
    uint32_t arcs, left_out[ZYGOS_KINDS_OF_ROWS], validity, reason;
} seen_t;

typedef struct {
    zygos_estimate_t estimate;
    seen_t seen;
} look_t;

static zygos_config_t config;
static zygos_frame_t *frame;
static uint32_t *start; /* of each cycle, its first frame */
static uint32_t cycles;
static uint32_t every; /* cycles from look to look: an arc */
static look_t *look;   /* of the flight without a flip */
static zygos_arm_t *stored;
static zygos_arm_t *arm;
#ifdef CAMPAIGN_IN_PLACE
static zygos_solver_t solver;
#else
static zygos_work_t work;
#endif
static zygos_estimate_t estimate;

static void *room_for(size_t bytes)
{
    void *room = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (room == MAP_FAILED) {
        fputs("there is not enough memory\n", stderr);
        exit(2);
    }
    return room;
}

/* The state ends where a page begins that must not be touched, and begins behind such a page, or nearly so. */
static zygos_arm_t *fenced(void)
{
    const size_t pages = (sizeof(zygos_arm_t) + PAGE - 1u) / PAGE;
    unsigned char *room = room_for((pages + 2u) * PAGE);
    (void)mprotect(room, PAGE, PROT_NONE);
    (void)mprotect(room + (pages + 1u) * PAGE, PAGE, PROT_NONE);
    return (zygos_arm_t *)(void *)(room + (pages + 1u) * PAGE - sizeof(zygos_arm_t));
}

static bool scrubbed(void)
{
    return zygos_arm_scrub(arm, &config) == 0;
}

/* One cycle. Returns whether no call had anything to say. */
static bool feed(uint32_t k)
{
    bool quiet = true;
    for (uint32_t f = start[k]; f < start[k + 1u]; f++) {
        if (zygos_arm_frame(arm, &frame[f]) < 0) {
            (void)scrubbed();
            quiet = false;
        }
        int verdict;
        while ((verdict = zygos_arm_step(arm)) == 1) {
        }
        if (verdict < 0) {
            (void)scrubbed();
            quiet = false;
        }
    }
    return quiet;
}

static void estimate_now(void)
{
#ifdef CAMPAIGN_IN_PLACE
    (void)zygos_arm_solve(arm, &solver, &estimate);
#else
    zygos_arm_take(arm, &work);
    (void)zygos_work_solve(&work, &estimate);
#endif
}

static void see(look_t *out)
{
    estimate_now();
    (void)zygos_arm_adopt(arm, &estimate);
    memset(out, 0, sizeof *out);
    out->estimate = estimate;
    out->seen.faults = arm->receiver.faults;
    out->seen.gaps = arm->gaps;
    out->seen.invalid = arm->invalid;
    out->seen.wraps = arm->wraps;
    out->seen.apart = arm->apart;
    out->seen.quarantined = arm->quarantined;
    out->seen.arcs = estimate.arcs;
    memcpy(out->seen.left_out, estimate.left_out, sizeof out->seen.left_out);
    out->seen.validity = estimate.validity;
    out->seen.reason = estimate.reason;
}

static bool is_published(const zygos_estimate_t *of, uint32_t i)
{
    return (of->validity >= (uint32_t)ZYGOS_PARTIAL) && (i < of->parameters) && (of->identifiable[i] != 0);
}

/* How far the parameter that moved most did, in sigmas of the flight without a flip. */
static double moved(const zygos_estimate_t *now, const zygos_estimate_t *before)
{
    double most = 0.0;
    for (uint32_t i = 0; i < before->parameters; i++) {
        if (is_published(now, i) && is_published(before, i)) {
            const double off = __builtin_fabs(now->value[i] - before->value[i]) / before->sigma[i];
            most = (off <= most) ? most : off; /* not a number counts as moved */
        }
    }
    return most;
}

static uint64_t next(uint64_t *state)
{
    *state += 0x9E3779B97F4A7C15u;
    uint64_t z = *state;
    z = (z ^ (z >> 30u)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27u)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31u);
}

static void fly(uint32_t first, uint32_t last, uint64_t seed, record_t *out)
{
    uint64_t random = seed;
    (void)next(&random);
    const uint32_t at = first + (uint32_t)(next(&random) % (last - first));
    const uint64_t bit = next(&random) % (8u * sizeof(zygos_arm_t));
    const uint32_t from = (at - first) / APART;
    out->bit = bit;
    out->cycle = at;
    memcpy(arm, &stored[from], sizeof *arm);
    bool quiet = true;
    double most = 0.0;
    uint32_t looks = 0;
    for (uint32_t k = first + from * APART; (k < cycles) && (looks < LOOKS_AFTER); k++) {
        if (k == at) {
            ((unsigned char *)arm)[bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
        }
        quiet = feed(k) && quiet;
        if ((k + 1u) % every == 0) {
            quiet = scrubbed() && quiet;
            look_t here;
            see(&here);
            quiet = quiet && (memcmp(&here.seen, &look[k / every].seen, sizeof here.seen) == 0);
            const double off = quiet ? moved(&here.estimate, &look[k / every].estimate) : 0.0;
            most = (off <= most) ? most : off;
            looks += (k >= at) ? 1u : 0u;
        }
    }
    out->moved = most;
    out->outcome = !(most <= MOVED) ? SILENT : (quiet ? NO_EFFECT : DETECTED);
}

static bool is_read(FILE *run)
{
    uint32_t head[3];
    if ((fread(head, sizeof head, 1, run) != 1) || (head[0] != sizeof config) || (head[1] != sizeof(zygos_frame_t)) ||
        (fread(&config, sizeof config, 1, run) != 1)) {
        return false;
    }
    frame = calloc(head[2], sizeof *frame);
    start = calloc(head[2] + 2u, sizeof *start);
    if ((frame == NULL) || (start == NULL) || (fread(frame, sizeof *frame, head[2], run) != head[2])) {
        return false;
    }
    for (uint32_t f = 0; f < head[2]; f++) {
        if (frame[f].id == ZYGOS_ID_SYNC) {
            start[cycles] = f;
            cycles++;
        }
    }
    start[cycles] = head[2];
    config.abi = ZYGOS_ABI;
    return zygos_arm_init(arm, &config) == 1;
}

int main(int argc, char **argv)
{
    arm = fenced();
    FILE *run = (argc == 7) ? fopen(argv[1], "rb") : NULL;
    FILE *file = (argc == 7) ? fopen(argv[6], "wb") : NULL;
    if ((run == NULL) || (file == NULL) || !is_read(run)) {
        fputs("usage: campaign RUN FIRST LAST TRIALS SEED OUT, with RUN of this build\n", stderr);
        return 2;
    }
    const uint32_t first = (uint32_t)strtoul(argv[2], NULL, 10);
    const uint32_t last = (uint32_t)strtoul(argv[3], NULL, 10);
    const uint32_t trials = (uint32_t)strtoul(argv[4], NULL, 10);
    const uint64_t seed = strtoull(argv[5], NULL, 10);
    every = config.arc_cycles;
    look = room_for((cycles / every + 1u) * sizeof *look);
    stored = room_for(((last - first) / APART + 1u) * sizeof *stored);
    record_t *record = room_for((trials + 1u) * sizeof *record);
    for (uint32_t k = 0; k < cycles; k++) {
        if ((k >= first) && (k < last) && ((k - first) % APART == 0)) {
            stored[(k - first) / APART] = *arm;
        }
        bool quiet = feed(k);
        if ((k + 1u) % every == 0) {
            quiet = scrubbed() && quiet;
            see(&look[k / every]);
            fprintf(stderr, "cycle %u: validity %u, reason %u\n", k, look[k / every].seen.validity,
                    look[k / every].seen.reason);
        }
        if (!quiet) {
            fprintf(stderr, "cycle %u of the flight without a flip has an error\n", k);
            return 2;
        }
    }
    uint32_t done = 0;
    while (done < trials) { /* a child for as many trials as it survives */
        const pid_t child = fork();
        if (child == 0) {
            for (uint32_t t = done; t < trials; t++) {
                const struct itimerval patience = { .it_value = { .tv_sec = PATIENCE_S } };
                (void)setitimer(ITIMER_PROF, &patience, NULL);
                fly(first, last, seed + t, &record[t]);
            }
            _exit(0);
        }
        int status = 0;
        if ((child < 0) || (waitpid(child, &status, 0) != child)) {
            fputs("no child\n", stderr);
            return 2;
        }
        while ((done < trials) && (record[done].outcome != UNFINISHED)) {
            done++;
        }
        if (done < trials) {
            record[done].outcome = (WIFSIGNALED(status) && (WTERMSIG(status) == SIGPROF)) ? HANG : CRASH;
            fprintf(stderr, "seed %llu, bit %llu, cycle %u: status %d\n", (unsigned long long)(seed + done),
                    (unsigned long long)record[done].bit, record[done].cycle, status);
            done++;
        }
    }
    return (fwrite(record, sizeof *record, trials, file) == trials) && (fclose(file) == 0) ? 0 : 2;
}
