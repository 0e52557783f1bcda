/* SPDX-License-Identifier: MIT */
/* Flies a recorded motion again and again by the calls of an onboard program, flips one bit of all memory of the
   library in each trial, and says what came of it.

   campaign RUN FIRST LAST TRIALS SEED KIND OUT. RUN is what upset/campaign.py writes: three uint32 (size of a
   configuration, size of a frame, number of frames), the configuration and the frames. Bits flip between two calls in
   cycles FIRST to LAST; OUT receives a record for each trial. KIND is a sum of: 1, solutions in place; 2, with a
   refinement; 4, the same bit flips in two words.

   The caller does what the manual asks: zygos_frame() for each frame, zygos_step() until it returns 0, zygos_solve()
   every few cycles; and zygos_init() where zygos_step() returns ZYGOS_E_CONFIG. */

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

#define IN_PLACE 1u
#define REFINED 2u
#define PAIRS 4u
#define APART 50u     /* cycles between two stored states */
#define EVERY 8u      /* cycles between two calls of zygos_solve() */
#define PATIENCE_S 30 /* of the processor, for a trial */
#define MOVED 0.5     /* sigmas that a value may move without a notice, */
#define LATER 2.0     /* and in an estimate of another cycle, which has other arcs */
#define LOOKS_AFTER 2u
#define NEAR 8u /* words of eight bytes between half of the pairs */
#define CALLS 64u
#define PARAMETERS (ZYGOS_MAX_BODY + 3 * ZYGOS_MAX_JOINTS)
#define PAGE 4096u

enum outcome { UNFINISHED, NO_EFFECT, DETECTED, SILENT, CRASH, HANG };

/* What is told of a trial. */
typedef struct {
    uint64_t bit;
    uint64_t other; /* the second bit, or the same */
    uint32_t cycle;
    uint32_t outcome;
    double moved; /* of the parameter that moved most [sigmas]; in an estimate of another cycle divided by 4 */
} record_t;

/* What a caller can see of faults, which does not change in the flight without a flip. */
typedef struct {
    zygos_faults_t faults;
    uint64_t gaps, invalid, wraps, apart, quarantined, overrun, repairs, losses, lost, restarts, rejected, spoiled,
        abandoned, discarded;
} faults_t;

/* What an estimate, or what is refined, says of itself. */
typedef struct {
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS], validity, reason, changed, restored;
} said_t;

typedef struct {
    uint32_t cycle;  /* in which it was there */
    uint64_t newest; /* cycle in it */
    uint32_t arcs;
    uint32_t parameters;
    faults_t faults;
    said_t said;
    uint32_t known[ZYGOS_MAX_PARAMETERS];
    double value[ZYGOS_MAX_PARAMETERS];
    double sigma[ZYGOS_MAX_PARAMETERS];
} look_t;

/* The looks of a flight: at each estimate, and at what is refined when it was judged. */
typedef struct {
    uint32_t count;
    look_t *look;
} looks_t;

/* A part of the memory that bits flip in. */
typedef struct {
    unsigned char *memory;
    size_t bytes;
} part_t;

static zygos_config_t config;
static zygos_refine_settings_t settings;
static zygos_frame_t *frame;
static uint32_t *start; /* of each cycle, its first frame */
static uint32_t cycles;
static uint32_t kind;
static looks_t estimates; /* of the flight without a flip */
static looks_t refinements;
static part_t part[3];
static uint32_t parts;
static size_t all; /* bytes of the parts */
static unsigned char *stored;
static zygos_t *arm;
static void *memory;
static uint32_t bytes;
static zygos_refine_t *refine;
static zygos_estimate_t estimate;

static void *room_for(size_t size)
{
    void *room = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (room == MAP_FAILED) {
        fputs("there is not enough memory\n", stderr);
        exit(2);
    }
    return room;
}

/* A part ends where a page begins that must not be touched, and begins behind such a page, or nearly so. */
static void *fenced(size_t size)
{
    const size_t pages = (size + PAGE - 1u) / PAGE;
    unsigned char *room = room_for((pages + 2u) * PAGE);
    (void)mprotect(room, PAGE, PROT_NONE);
    (void)mprotect(room + (pages + 1u) * PAGE, PAGE, PROT_NONE);
    part[parts].memory = room + (pages + 1u) * PAGE - size;
    part[parts].bytes = size;
    all += size;
    return part[parts++].memory;
}

static void store(unsigned char *to)
{
    for (uint32_t p = 0; p < parts; p++) {
        memcpy(to, part[p].memory, part[p].bytes);
        to += part[p].bytes;
    }
}

static void restore(const unsigned char *from)
{
    for (uint32_t p = 0; p < parts; p++) {
        memcpy(part[p].memory, from, part[p].bytes);
        from += part[p].bytes;
    }
}

static void flip(uint64_t bit)
{
    size_t at = (size_t)(bit / 8u);
    uint32_t p = 0;
    while (at >= part[p].bytes) {
        at -= part[p].bytes;
        p++;
    }
    part[p].memory[at] ^= (unsigned char)(1u << (bit % 8u));
}

/* Flips the bits of a trial where this is the call before which they do. */
static void upset_before(const record_t *upset, bool now)
{
    if ((upset != NULL) && now) {
        flip(upset->bit);
        if (upset->other != upset->bit) {
            flip(upset->other);
        }
    }
}

static bool begin(void)
{
    return (zygos_init(arm, &config, memory, bytes) == 1) &&
           (((kind & REFINED) == 0) || (zygos_refine(arm, refine, &settings, 0) == 1));
}

static uint32_t stage(void)
{
    return __atomic_load_n(&arm->stage, __ATOMIC_RELAXED);
}

static void see_faults(faults_t *out)
{
    memset(out, 0, sizeof *out);
    out->faults = arm->state.receiver.faults;
    out->gaps = arm->state.gaps;
    out->invalid = arm->state.invalid;
    out->wraps = arm->state.wraps;
    out->apart = arm->state.apart;
    out->quarantined = arm->state.quarantined;
    out->overrun = arm->overrun;
    out->repairs = arm->repairs;
    out->losses = arm->losses;
    out->discarded = arm->state.sums.guard.lost;
    out->lost = arm->refined.lost;
    out->restarts = arm->refined.restarts;
    out->rejected = arm->refined.rejected;
    out->spoiled = arm->refined.spoiled;
    out->abandoned = arm->refined.abandoned;
}

static void see_estimate(uint32_t cycle, look_t *out)
{
    memset(out, 0, sizeof *out);
    out->cycle = cycle;
    out->newest = estimate.cycle;
    out->arcs = estimate.arcs;
    see_faults(&out->faults);
    memcpy(out->said.left_out, estimate.left_out, sizeof out->said.left_out);
    out->said.validity = estimate.validity;
    out->said.reason = estimate.reason;
    out->said.changed = estimate.changed;
    out->said.restored = estimate.restored;
    if (estimate.validity >= (uint32_t)ZYGOS_PARTIAL) {
        out->parameters = estimate.parameters;
        memcpy(out->known, estimate.identifiable, sizeof out->known);
        memcpy(out->value, estimate.value, sizeof out->value);
        memcpy(out->sigma, estimate.sigma, sizeof out->sigma);
    }
}

static void see_refined(uint32_t cycle, look_t *out)
{
    const zygos_refined_t *refined = &arm->refined;
    memset(out, 0, sizeof *out);
    out->cycle = cycle;
    see_faults(&out->faults);
    out->said.validity = refined->published;
    out->said.reason = refined->reason;
    for (uint32_t k = 0; (k < refined->parameters) && (k < (uint32_t)PARAMETERS) && (refined->published != 0); k++) {
        out->parameters = k + 1u;
        out->known[k] = 1;
        out->value[k] = refined->value[k];
        out->sigma[k] = refined->sigma[k];
    }
}

/* One cycle, in which bits flip before a call: that of a frame, of zygos_step(), or another one (behind them). Returns
   whether zygos_step() had nothing to say; *judged: whether an estimate was adopted. */
static bool feed(uint32_t k, const record_t *upset, uint32_t call, bool *judged)
{
    const uint32_t frames = start[k + 1u] - start[k];
    bool quiet = true;
    *judged = false;
    for (uint32_t f = 0; f < frames; f++) {
        upset_before(upset, call == f);
        quiet = (zygos_frame(arm, &frame[start[k] + f]) == 1) && quiet;
    }
    upset_before(upset, call == frames);
    int verdict = 1;
    for (uint32_t step = 0; (verdict == 1) && (step < CALLS); step++) {
        const uint32_t before = stage();
        verdict = zygos_step(arm);
        *judged = *judged || ((before == (uint32_t)ZYGOS_STAGE_SOLVED) && (stage() != before));
    }
    if (verdict < 0) {
        quiet = false;
        if ((verdict == ZYGOS_E_CONFIG) || (verdict == ZYGOS_E_ORDER)) {
            (void)begin();
        }
    }
    upset_before(upset, call == frames + 1u);
    return quiet && (verdict == 0);
}

/* How far the parameter that moved most did, in sigmas of the flight without a flip. */
static double moved(const look_t *now, const look_t *before)
{
    double most = 0.0;
    for (uint32_t i = 0; (i < before->parameters) && (i < now->parameters); i++) {
        if ((now->known[i] != 0) && (before->known[i] != 0)) {
            const double off = __builtin_fabs(now->value[i] - before->value[i]) / before->sigma[i];
            most = (off <= most) ? most : off; /* not a number counts as moved */
        }
    }
    return most;
}

/* Compares with the looks of the flight without a flip just before and at or behind this one; one of them is enough.
   When it came is no notice: a caller does not know when to expect it. Returns whether there is nothing to notice. */
static bool is_as_expected(const look_t *now, const looks_t *expected, double *most)
{
    uint32_t at = 0;
    while ((at + 1u < expected->count) && (expected->look[at].cycle < now->cycle)) {
        at++;
    }
    const look_t *behind = &expected->look[at];
    const look_t *before = ((behind->cycle > now->cycle) && (at > 0)) ? behind - 1 : behind;
    bool quiet = (now->arcs >= before->arcs) && (now->arcs <= behind->arcs);
    const bool same = (memcmp(&now->said, &before->said, sizeof now->said) == 0) ||
                      (memcmp(&now->said, &behind->said, sizeof now->said) == 0);
    quiet = quiet && same &&
            ((memcmp(&now->faults, &before->faults, sizeof now->faults) == 0) ||
             (memcmp(&now->faults, &behind->faults, sizeof now->faults) == 0));
    const double off = moved(now, before);
    const double other = moved(now, behind);
    const bool apart = (now->cycle != behind->cycle) || (now->newest != behind->newest);
    const double less = ((off <= other) ? off : other) * (apart ? MOVED / LATER : 1.0);
    *most = (less <= *most) ? *most : less;
    return quiet;
}

static uint64_t next(uint64_t *state)
{
    *state += 0x9E3779B97F4A7C15u;
    uint64_t z = *state;
    z = (z ^ (z >> 30u)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27u)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31u);
}

static uint64_t second(uint64_t bit, uint64_t *random)
{
    const uint64_t words = all / 8u;
    const uint64_t away = (next(random) % 2u == 0) ? 1u + next(random) % NEAR : 1u + next(random) % (words - 1u);
    return ((bit / 64u + away) % words) * 64u + bit % 64u;
}

static void fly(uint32_t first, uint32_t last, uint64_t seed, record_t *out)
{
    uint64_t random = seed;
    (void)next(&random);
    const uint32_t at = first + (uint32_t)(next(&random) % (last - first));
    const uint64_t bit = next(&random) % (8u * all);
    const uint32_t call = (uint32_t)(next(&random) % (start[at + 1u] - start[at] + 2u));
    const uint32_t from = (at - first) / APART;
    out->bit = bit;
    out->cycle = at;
    out->other = ((kind & PAIRS) != 0) ? second(bit, &random) : bit;
    restore(&stored[from * all]);
    bool quiet = true;
    double most = 0.0;
    uint32_t looks = 0;
    for (uint32_t k = first + from * APART; (k < cycles) && (looks < LOOKS_AFTER); k++) {
        look_t here;
        bool judged;
        quiet = feed(k, (k == at) ? out : NULL, call, &judged) && quiet;
        double here_moved = 0.0;
        if (judged && ((kind & REFINED) != 0)) {
            see_refined(k, &here);
            quiet = is_as_expected(&here, &refinements, &here_moved) && quiet;
        }
        if ((k % EVERY == 0) && (zygos_solve(arm, &estimate) == 1)) {
            see_estimate(k, &here);
            quiet = is_as_expected(&here, &estimates, &here_moved) && quiet;
            looks += (k >= at) ? 1u : 0u;
        }
        here_moved = quiet ? here_moved : 0.0;
        most = (here_moved <= most) ? most : here_moved;
    }
    out->moved = most;
    out->outcome = !(most <= MOVED) ? SILENT : (quiet ? NO_EFFECT : DETECTED);
    if (quiet && (looks < LOOKS_AFTER)) {
        out->outcome = HANG; /* estimates have ended without a word */
    }
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
    (void)zygos_refine_defaults(&settings, &config);
    settings.window = 20u;
    for (uint32_t i = 0; i < config.joints; i++) {
        settings.filter.torque_relative_sigma[i] = config.joint[i].torque_relative_sigma;
    }
    return begin();
}

/* The flight without a flip. Returns whether it has no errors. */
static bool fly_clean(uint32_t first, uint32_t last)
{
    const size_t most = cycles / EVERY + 1u;
    estimates.look = room_for(most * sizeof(look_t));
    refinements.look = room_for(most * sizeof(look_t));
    for (uint32_t k = 0; k < cycles; k++) {
        if ((k >= first) && (k < last) && ((k - first) % APART == 0)) {
            store(&stored[(k - first) / APART * all]);
        }
        bool judged;
        if (!feed(k, NULL, 0, &judged)) {
            fprintf(stderr, "cycle %u of the flight without a flip has an error\n", k);
            return false;
        }
        if (judged) {
            see_refined(k, &refinements.look[refinements.count++]);
            fprintf(stderr, "cycle %u: refined %u, reason %u\n", k, arm->refined.published, arm->refined.reason);
        }
        if ((k % EVERY == 0) && (zygos_solve(arm, &estimate) == 1)) {
            see_estimate(k, &estimates.look[estimates.count++]);
            fprintf(stderr, "cycle %u: validity %u, reason %u\n", k, estimate.validity, estimate.reason);
        }
    }
    return true;
}

int main(int argc, char **argv)
{
    kind = (argc == 8) ? (uint32_t)strtoul(argv[6], NULL, 10) : 0u;
    arm = fenced(sizeof *arm);
    bytes = ((kind & IN_PLACE) != 0) ? (uint32_t)sizeof(zygos_in_place_t) : (uint32_t)sizeof(zygos_background_t);
    memory = fenced(bytes);
    refine = ((kind & REFINED) != 0) ? fenced(sizeof *refine) : NULL;
    FILE *run = (argc == 8) ? fopen(argv[1], "rb") : NULL;
    FILE *file = (argc == 8) ? fopen(argv[7], "wb") : NULL;
    if ((run == NULL) || (file == NULL) || !is_read(run)) {
        fputs("usage: campaign RUN FIRST LAST TRIALS SEED KIND OUT, with RUN of this build\n", stderr);
        return 2;
    }
    const uint32_t first = (uint32_t)strtoul(argv[2], NULL, 10);
    const uint32_t last = (uint32_t)strtoul(argv[3], NULL, 10);
    const uint32_t trials = (uint32_t)strtoul(argv[4], NULL, 10);
    const uint64_t seed = strtoull(argv[5], NULL, 10);
    stored = room_for(((last - first) / APART + 1u) * all);
    record_t *record = room_for((trials + 1u) * sizeof *record);
    if (!fly_clean(first, last)) {
        return 2;
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
            fprintf(stderr, "seed %llu, bits %llu %llu, cycle %u: status %d\n", (unsigned long long)(seed + done),
                    (unsigned long long)record[done].bit, (unsigned long long)record[done].other, record[done].cycle,
                    status);
            done++;
        }
    }
    return (fwrite(record, sizeof *record, trials, file) == trials) && (fclose(file) == 0) ? 0 : 2;
}
