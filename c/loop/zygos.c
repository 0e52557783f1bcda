/* SPDX-License-Identifier: MIT */
#include "zygos/zygos.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

/* Calls after which an estimate is adopted although an arc is being compared with the one before, and without a cycle,
   after which the bus counts as silent. */
#define PATIENCE 512u
/* Time constants of forgetting after which sums count as forgotten: 5 % are left. */
#define FADED 3.0
/* Cycles in which a copy waits for a pass of the patrol, whatever the capacities of the build are. */
#define VERIFYING 32u
/* So often in a row sums may be found corrupt that zygos_arm_scrub() finds nothing wrong with. */
#define CORRUPT 2u

/* Programs that never call zygos_refine() do not link the refinement: these references need no definition. The
   functions are there where a refinement is attached. */
#pragma weak zygos_refine_init
#pragma weak zygos_refine_start
#pragma weak zygos_refine_cycle
#pragma weak zygos_refine_step
#pragma weak zygos_refine_scrub
#pragma weak zygos_refine_judge

/* ---------------------------------------------------------------- what was given */

static uintptr_t two_of(uintptr_t a, uintptr_t b, uintptr_t c)
{
    return (a & b) | (a & c) | (b & c);
}

/* Copies are turned by so many bits for each: the same bit of two of them, which one particle may flip, is not the same
   bit of what they say. */
#define TURN 5u

static inline uintptr_t turned(uintptr_t word, uint32_t by)
{
    const uint32_t bits = 8u * (uint32_t)sizeof word;
    return (word << (by % bits)) | (word >> ((bits - by) % bits));
}

static uintptr_t turned_back(uintptr_t word, uint32_t by)
{
    return turned(word, 8u * (uint32_t)sizeof word - by);
}

static uintptr_t word_given_to(const zygos_t *self, uint32_t which)
{
    const uintptr_t second = turned_back(self->given[1].word[which], TURN);
    return two_of(self->given[0].word[which], second, turned_back(self->given[2].word[which], 2u * TURN));
}

static zygos_given_t given_to(const zygos_t *self)
{
    zygos_given_t out = { { 0 } };
    for (uint32_t which = 0; which < ZYGOS_GIVEN_WORDS; which++) {
        out.word[which] = word_given_to(self, which);
    }
    return out;
}

static void give(zygos_t *self, const zygos_given_t *what)
{
    for (uint32_t k = 0; k < 3u; k++) { /* two of them are right at any time */
        for (uint32_t which = 0; which < ZYGOS_GIVEN_WORDS; which++) {
            self->given[k].word[which] = turned(what->word[which], TURN * k);
        }
    }
}

static const zygos_config_t *config_of(const zygos_given_t *given)
{
    return (const zygos_config_t *)given->word[ZYGOS_GIVEN_CONFIG];
}

static zygos_background_t *memory_of_background(const zygos_given_t *given)
{
    return (zygos_background_t *)given->word[ZYGOS_GIVEN_MEMORY];
}

static zygos_background_t *background_of(const zygos_given_t *given)
{
    return (given->word[ZYGOS_GIVEN_BACKGROUND] != 0) ? memory_of_background(given) : NULL;
}

static zygos_in_place_t *in_place_of(const zygos_given_t *given)
{
    return (zygos_in_place_t *)given->word[ZYGOS_GIVEN_MEMORY];
}

static zygos_estimate_t *estimate_of(const zygos_given_t *given)
{
    zygos_background_t *background = background_of(given);
    return (background != NULL) ? &background->estimate : &in_place_of(given)->estimate;
}

/* What zygos_solve() has left must still be that when zygos_step() adopts it. */
static uint64_t *seal_of(const zygos_given_t *given)
{
    return (given->word[ZYGOS_GIVEN_BACKGROUND] != 0) ? &memory_of_background(given)->seal : &in_place_of(given)->seal;
}

/* Of the covariance, which is long, only where it is used: where sums are dropped with the estimate. */
static uint64_t estimate_checksum(const zygos_given_t *given, const zygos_estimate_t *estimate)
{
    const uint32_t p = zygos_least(estimate->parameters, (uint32_t)ZYGOS_MAX_PARAMETERS);
    const bool all = (given->word[ZYGOS_GIVEN_BACKGROUND] == 0) || (estimate->since > 0);
    const uint32_t head = (uint32_t)offsetof(zygos_estimate_t, covariance);
    const uint64_t sum = zygos_checksum_memory(0, estimate, head);
    return zygos_checksum_doubles(sum, estimate->covariance, all ? zygos_gram_entries(p) : 0u);
}

static zygos_refine_t *refine_of(const zygos_given_t *given)
{
    return (zygos_refine_t *)given->word[ZYGOS_GIVEN_REFINE];
}

/* Whether the three copies are the same, which is nearly always so. */
static inline bool agree(const zygos_t *self)
{
    uintptr_t off = 0;
    for (uint32_t which = 0; which < ZYGOS_GIVEN_WORDS; which++) {
        const uintptr_t second = self->given[1].word[which];
        off |=
            (turned(self->given[0].word[which], TURN) ^ second) | (turned(second, TURN) ^ self->given[2].word[which]);
    }
    return off == 0;
}

/* One flipped bit of the magic number is none. */
static bool is_begun(const zygos_t *self)
{
    const uint32_t off = self->magic ^ ZYGOS_BEGUN;
    return (off & (off - 1u)) == 0;
}

/* Who owns the copy must not depend on one bit: what is stored has each bit three times, and other bits do not count.
 */
static uint32_t stage_of(const zygos_t *self)
{
    const uint32_t stage = __atomic_load_n(&self->stage, __ATOMIC_ACQUIRE);
    if (stage == (uint32_t)ZYGOS_STAGE_IDLE) {
        return stage;
    }
    return (uint32_t)ZYGOS_STAGE_ASKED * (uint32_t)(two_of(stage, stage >> 2u, stage >> 4u) & 3u);
}

static void move_to(zygos_t *self, enum zygos_stage stage)
{
    __atomic_store_n(&self->stage, (uint32_t)stage, __ATOMIC_RELEASE);
}

/* A flag that decides who owns memory, stored like that. */
#define SET 7u
#define SPOILED 8u
static bool is_set(uint32_t flag)
{
    return (two_of(flag, flag >> 1u, flag >> 2u) & 1u) != 0;
}

/* That the sums were given up, which the background looks at. */
static void give_up(zygos_t *self)
{
    __atomic_store_n(&self->restarts, self->restarts + 1u, __ATOMIC_RELEASE);
}

/* Cycles of the longest arc that can be used by itself. */
static uint64_t longest_arc(const zygos_config_t *config)
{
    const uint32_t segment = zygos_joint_sums_longest(config);
    return (config->arc_cycles > segment) ? config->arc_cycles : segment;
}

/* Bits of the node numbers from which frames are stored. */
static uint32_t nodes_of(const zygos_config_t *config)
{
    uint32_t nodes = 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        nodes |= 1u << (config->joint[i].node & 31u);
    }
    return nodes | ((config->imu_node != 0) ? 1u << (config->imu_node & 31u) : 0u);
}

/* Nothing is refined. */
static void publish_nothing(zygos_t *self, enum zygos_refine_reason reason)
{
    memset(&self->refined, 0, sizeof self->refined);
    self->refined.reason = (uint32_t)reason;
}

/* All but the state. */
static int begin(zygos_t *self, const zygos_config_t *config, void *memory, uint32_t bytes)
{
    if ((self == NULL) || (config == NULL) || (memory == NULL)) {
        return ZYGOS_E_NULL;
    }
    const int verdict = zygos_config_check(config);
    if (verdict < 0) {
        return verdict;
    }
    if (bytes < (uint32_t)sizeof(zygos_in_place_t)) {
        return ZYGOS_E_MEMORY;
    }
    memset(self, 0, offsetof(zygos_t, state));
    const bool background = (bytes >= (uint32_t)sizeof(zygos_background_t));
    memset(memory, 0, background ? sizeof(zygos_background_t) : sizeof(zygos_in_place_t));
    const zygos_given_t given = {
        .word = { [ZYGOS_GIVEN_CONFIG] = (uintptr_t)config,
                  [ZYGOS_GIVEN_MEMORY] = (uintptr_t)memory,
                  [ZYGOS_GIVEN_BACKGROUND] = background ? 1u : 0u,
                  [ZYGOS_GIVEN_NODES] = nodes_of(config) },
    };
    give(self, &given);
    publish_nothing(self, ZYGOS_REFINE_WAITS);
    return 1;
}

int zygos_init(zygos_t *self, const zygos_config_t *config, void *memory, uint32_t bytes)
{
    const int begun = begin(self, config, memory, bytes);
    if (begun < 0) {
        return begun;
    }
    const int verdict = zygos_arm_init(&self->state, config);
    if (verdict == 1) {
        self->state.sums.guard.adopting = 1;
        self->magic = ZYGOS_BEGUN;
    }
    return verdict;
}

int zygos_frame(zygos_t *self, const zygos_frame_t *frame)
{
    if ((self == NULL) || (frame == NULL)) {
        return ZYGOS_E_NULL;
    }
    if ((self->magic != ZYGOS_BEGUN) && !is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    uintptr_t nodes = self->given[0].word[ZYGOS_GIVEN_NODES];
    if (turned(nodes, TURN) !=
        self->given[1].word[ZYGOS_GIVEN_NODES]) { /* two that are equal are what two of three say */
        nodes = word_given_to(self, ZYGOS_GIVEN_NODES);
    }
    const uint32_t node = frame->id & 0x7Fu;
    const bool own = ((node < 32u) && (((nodes >> node) & 1u) != 0)) || (frame->id == ZYGOS_ID_SYNC) ||
                     (frame->id == ZYGOS_ID_TPDO3 + ZYGOS_NODE_COMPUTER);
    const bool error = (frame->flags & (uint32_t)ZYGOS_FRAME_ERROR) != 0;
    if (!error && (!own || (frame->flags != 0))) {
        return 0;
    }
    const uint32_t head = __atomic_load_n(&self->head, __ATOMIC_RELAXED);
    if (head - __atomic_load_n(&self->tail, __ATOMIC_ACQUIRE) >= (uint32_t)ZYGOS_RING) {
        __atomic_store_n(&self->overrun, self->overrun + 1u, __ATOMIC_RELAXED);
        return 0;
    }
    self->ring[head % (uint32_t)ZYGOS_RING] = *frame;
    __atomic_store_n(&self->head, head + 1u, __ATOMIC_RELEASE);
    return 1;
}

/* ---------------------------------------------------------------- memory that was changed */

/* The copy for a solution is of no use any more. */
static void copy_anew(zygos_t *self)
{
    zygos_handover_begin(&self->handover);
    self->state.held = 0;
    self->verifying = 0;
}

/* Repairs the state; where that is beyond repair, the estimation begins anew. Returns 0 when nothing was found, 1 when
   something was, or ZYGOS_E_CONFIG where the caller's configuration contradicts the copies of it. */
static int mend(zygos_t *self, const zygos_given_t *given)
{
    self->state.held = 0;
    const int found = zygos_arm_scrub(&self->state, config_of(given));
    memset(&self->patrol, 0, sizeof self->patrol);
    if (found == 0) {
        self->state.sums
            .dropped++; /* tasks were finished at once: the kind of rows that is being copied begins again */
        return 0;
    }
    copy_anew(self);
    if (found == ZYGOS_E_CONFIG) {
        return found;
    }
    if (found < 0) {
        (void)zygos_arm_init(&self->state, config_of(given));
        self->state.sums.guard.adopting = 1;
        self->losses++;
        give_up(self);
    } else {
        self->repairs++;
    }
    return 1;
}

/* ---------------------------------------------------------------- the task */

/* Whether a complete cycle waits. */
static bool is_complete(const zygos_receiver_t *receiver)
{
    return receiver->queue.head != receiver->queue.tail;
}

/* Decodes frames until a cycle is complete, or all. Places that memory errors have moved apart lose what waits. The
   receiver accesses nothing outside itself, whatever its places are: these are checked once, behind the last frame.
   Returns false where memory was changed. */
static bool decode(zygos_t *self, bool all)
{
    zygos_receiver_t *receiver = &self->state.receiver;
    const uint32_t head = __atomic_load_n(&self->head, __ATOMIC_ACQUIRE);
    uint32_t tail = (head - self->tail > (uint32_t)ZYGOS_RING) ? head : self->tail;
    for (; (tail != head) && (all || !is_complete(receiver)); tail++) {
        (void)zygos_receiver_frame(receiver, &self->state.sums.config, &self->ring[tail % (uint32_t)ZYGOS_RING]);
    }
    __atomic_store_n(&self->tail, tail, __ATOMIC_RELEASE);
    const uint32_t lost = __atomic_load_n(&self->overrun, __ATOMIC_RELAXED);
    if (lost != self->overrun_counted) {
        receiver->faults.overrun += lost - self->overrun_counted;
        self->overrun_counted = lost;
    }
    return zygos_receiver_intact(receiver);
}

/* A comparison with the adopted estimate should not begin with one and end with another. */
static bool is_comparing(const zygos_arm_t *arm)
{
    return zygos_store_closing(&arm->sums.energy.store) || zygos_store_closing(&arm->sums.motors.store) ||
           (arm->sums.momentum.store.task == ZYGOS_TASK_JUDGE) || (arm->sums.ending != 0);
}

/* Where sums are dropped, tasks would have to be finished at once. */
static bool has_tasks(const zygos_arm_t *arm)
{
    bool busy = false;
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        busy = busy || zygos_sums_is_busy(&arm->sums, kind);
    }
    return busy;
}

/* Judges what is refined by a new estimate. What cannot be judged is not published any more. */
static void judge(zygos_t *self, const zygos_given_t *given)
{
    const zygos_refine_t *task = refine_of(given);
    if ((task != NULL) && (zygos_refine_judge(task, config_of(given), estimate_of(given), &self->refined) < 0)) {
        publish_nothing(self, ZYGOS_REFINE_CORRUPT);
    }
}

/* The refinement of another arm ends. */
static void refine_anew(zygos_t *self, const zygos_given_t *given)
{
    zygos_refine_t *task = refine_of(given);
    if (task != NULL) {
        if (zygos_refine_scrub(task, config_of(given)) >= 0) { /* else the settings are not to be trusted */
            const zygos_refine_settings_t settings = task->settings;
            (void)zygos_refine_init(task, config_of(given), &settings);
        }
        publish_nothing(self, ZYGOS_REFINE_WAITS);
    }
    self->refines_anew = 0;
}

/* Compares the checksum of the estimate, in a cycle of its own, because that costs as much as the adoption. Returns
   whether the adoption goes on in this one. */
static bool is_compared(zygos_t *self, const zygos_given_t *given)
{
    if (self->adopting == SET) {
        return true;
    }
    self->state.beside = 1u;
    self->adopting = (*seal_of(given) == estimate_checksum(given, estimate_of(given))) ? SET : SPOILED;
    return self->adopting != SET;
}

/* Gives the guard what it compares arcs with. Sums that are found corrupt are looked at, and given up where nothing is
   found so often in a row. */
static void use_estimate(zygos_t *self, const zygos_given_t *given, bool whole, bool current)
{
    zygos_background_t *background = background_of(given);
    const zygos_estimate_t *estimate = estimate_of(given);
    uint32_t *corrupt = (background != NULL) ? &background->corrupt : &in_place_of(given)->corrupt;
    *corrupt = (whole && (estimate->reason == (uint32_t)ZYGOS_REASON_CORRUPT)) ? *corrupt + 1u : 0u;
    if (*corrupt > 0) {
        if ((mend(self, given) == 0) && (*corrupt >= CORRUPT)) {
            (void)zygos_arm_restart(&self->state, (uint32_t)ZYGOS_KEEP_FAULTS);
            self->losses++;
            give_up(self);
        }
    } else if (current && ((background == NULL) || (estimate->since > 0))) {
        (void)zygos_arm_adopt(&self->state, estimate); /* where sums are dropped, which is rare, at once */
    } else if (current && (background->adopted != 0)) {
        zygos_guard_take_over(&self->state.sums.guard, &background->work.sums.guard);
    }
}

/* Adopts the estimate that the background has left. */
static void adopt(zygos_t *self, const zygos_given_t *given)
{
    const zygos_background_t *background = background_of(given);
    const zygos_arm_t *arm = &self->state;
    const bool busy = is_comparing(arm) || ((estimate_of(given)->since > 0) && has_tasks(arm));
    if ((background != NULL) && busy && (self->waited < PATIENCE)) {
        self->waited++;
        return;
    }
    if (!is_compared(self, given)) {
        return;
    }
    const bool whole = (self->adopting == SET);
    self->adopting = 0;
    self->waited = 0;
    const bool current = whole && (((background != NULL) ? background->of : in_place_of(given)->of) == self->restarts);
    self->repairs += whole ? 0u : 1u; /* an estimate that was changed since is not used */
    use_estimate(self, given, whole, current);
    if (current) {
        judge(self, given);
    }
    self->refining = 0;
    move_to(self, ZYGOS_STAGE_IDLE);
}

/* Whether the refinement waits for a start. */
static bool may_refine(const zygos_t *self, const zygos_refine_t *refine)
{
    const bool ended = (self->refined.reason == (uint32_t)ZYGOS_REFINE_FAILED) ||
                       (self->refined.reason == (uint32_t)ZYGOS_REFINE_CORRUPT);
    return (refine != NULL) && ((refine->started == 0) || ended);
}

static uint64_t syncs_of(const zygos_arm_t *arm)
{
    const uint64_t sync = arm->receiver.assembly.sync;
    return (sync > arm->sums.cycle) ? sync : arm->sums.cycle;
}

/* The age of the sums, for an estimate. */
static void date(const zygos_t *self, zygos_estimate_t *out)
{
    const uint64_t now = syncs_of(&self->state);
    out->unused = (now > self->state.added) ? now - self->state.added : 0u;
    out->restored = (self->state.restored > 0) ? 1u : 0u;
}

static int patrol(zygos_t *self, const zygos_given_t *given)
{
    return zygos_patrol_part(&self->patrol, &self->state, config_of(given)) ? 0 : mend(self, given);
}

/* Whether the tables were verified since the sums were copied, which they may have spoiled otherwise. Does a part of
   that. */
static bool is_verified(zygos_t *self, const zygos_given_t *given, uint64_t copied)
{
    if (copied > self->state.sums.cycle) { /* memory errors: it would be waited for in vain */
        copy_anew(self);
        return false;
    }
    if ((self->verifying == 0) || (self->verifying > VERIFYING)) {
        self->verifying = VERIFYING;
        memset(&self->patrol, 0, sizeof self->patrol);
    }
    const uint32_t pass = zygos_patrol_cycles();
    const uint32_t parts = (self->verifying == 1u) ? pass : pass / VERIFYING + 1u;
    for (uint32_t part = 0; (part < parts) && (self->state.scrubbed < copied); part++) {
        if (patrol(self, given) != 0) {
            return false; /* the copy begins anew */
        }
    }
    self->verifying--;
    return self->verifying == 0;
}

static void set_copied(zygos_t *self, uint32_t cycles)
{
    self->copied = cycles;
    self->not_copied = ~cycles;
}

/* 0 also where memory was changed. */
static uint32_t cycles_copied(const zygos_t *self)
{
    return (self->copied == ~self->not_copied) ? self->copied : 0u;
}

static void hand_over(zygos_t *self, const zygos_given_t *given)
{
    zygos_background_t *background = background_of(given);
    if (background == NULL) {
        if ((self->rested < longest_arc(config_of(given))) && (cycles_copied(self) > 0)) {
            return;
        }
        set_copied(self, 1u);
        if ((mend(self, given) < 0) || (zygos_arm_end_arcs(&self->state) < 0)) {
            return; /* the next cycle says so */
        }
        in_place_of(given)->of = self->restarts;
    } else {
        if ((self->handover.kind == 0) && (self->handover.cut == 0) && (self->handover.waited == 0)) {
            if (self->rested < cycles_copied(self)) { /* the tasks that have waited proceed */
                return;
            }
            set_copied(self, 0);
        }
        set_copied(self, cycles_copied(self) + 1u);
        const bool done = zygos_handover_part(&self->handover, &self->state.sums, &background->work.sums);
        self->state.held = zygos_handover_held(&self->handover);
        self->state.beside = (self->handover.waited == 0) ? 1u : 0u; /* tasks proceed while the copy waits */
        if (!done || !is_verified(self, given, background->work.sums.cycle)) {
            return;
        }
        if (background->of != self->restarts) { /* what was compared was another arm */
            background->changed = 0;
        }
        background->of = self->restarts;
        zygos_handover_begin(&self->handover);
    }
    (void)zygos_arm_count_quarantined(&self->state); /* the estimate lacks them */
    self->rested = 0;
    date(self, estimate_of(given));
    self->refining = may_refine(self, refine_of(given)) ? SET : 0u;
    move_to(self, ZYGOS_STAGE_GIVEN);
}

/* What is done beside a cycle. Returns false while the sums belong to a solution in place. */
static bool attend(zygos_t *self, const zygos_given_t *given)
{
    const uint32_t stage = stage_of(self);
    self->rested++;
    self->state.beside = 0;
    self->state.held = (stage == (uint32_t)ZYGOS_STAGE_ASKED) ? self->state.held : 0u; /* only a copy holds tasks */
    if ((self->refines_anew != 0) && is_set(self->refines_anew) &&
        ((stage != (uint32_t)ZYGOS_STAGE_GIVEN) || !is_set(self->refining))) {
        refine_anew(self, given);
    }
    if (stage == (uint32_t)ZYGOS_STAGE_GIVEN) {
        return given->word[ZYGOS_GIVEN_BACKGROUND] != 0;
    }
    if (stage == (uint32_t)ZYGOS_STAGE_SOLVED) {
        adopt(self, given);
    } else if (stage == (uint32_t)ZYGOS_STAGE_ASKED) {
        hand_over(self, given);
        return (given->word[ZYGOS_GIVEN_BACKGROUND] != 0) || (stage_of(self) != (uint32_t)ZYGOS_STAGE_GIVEN);
    }
    return true;
}

/* The cycle that waits, and the slices of the refinement, where there is one. */
static void refine(zygos_t *self, const zygos_given_t *given, const zygos_cycle_t *cycle)
{
    zygos_refine_t *task = refine_of(given);
    int done = (cycle != NULL) ? zygos_refine_cycle(task, cycle) : 1;
    if (is_set(self->refining)) {
        return; /* the background begins it */
    }
    const uintptr_t slices = given->word[ZYGOS_GIVEN_SLICES];
    const uintptr_t most = (slices > 0) ? slices : UINT32_MAX;
    for (uint32_t slice = 0; (slice < most) && (done >= 0); slice++) {
        done = zygos_refine_step(task, config_of(given));
        if (done == 0) {
            break;
        }
    }
    if (done < 0) {
        (void)zygos_refine_scrub(task, config_of(given));
    }
}

/* Repairs what a flipped bit has changed of what was given, and of the magic number. Returns what was given, in the
   copy that is not turned. */
static const zygos_given_t *prepare(zygos_t *self)
{
    if (!agree(self)) {
        const zygos_given_t given = given_to(self);
        give(self, &given); /* the others read these at any time: nothing is written where nothing flipped */
    }
    if (self->magic != ZYGOS_BEGUN) {
        self->magic = ZYGOS_BEGUN;
    }
    return &self->given[0];
}

/* What is done beside a cycle, whether one waits or not. Estimates depend on the cycles alone, and not on how often
   this is called, unless the bus is silent, or nothing on it makes a cycle, for which a configuration that was changed
   may be the reason. Returns 1 where the cycle may be used, or the error of the repair. */
static inline int attend_in_turn(zygos_t *self, const zygos_given_t *given, bool waits)
{
    self->quiet = waits ? 0u : self->quiet + 1u;
    if (waits || (self->quiet > PATIENCE)) {
        self->quiet = waits ? 0u : PATIENCE;
        if (!attend(self, given)) {
            return 0;
        }
        const int mended = patrol(self, given);
        if (mended < 0) {
            return mended;
        }
    }
    return waits ? 1 : 0;
}

int zygos_step(zygos_t *self)
{
    if (self == NULL) {
        return ZYGOS_E_NULL;
    }
    if ((self->magic != ZYGOS_BEGUN) && !is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    const zygos_given_t *given = prepare(self);
    int mended = decode(self, false) ? 0 : mend(self, given);
    if (mended < 0) {
        return mended;
    }
    const int attended = attend_in_turn(self, given, is_complete(&self->state.receiver));
    if (attended != 1) {
        return attended;
    }
    if (given->word[ZYGOS_GIVEN_REFINE] != 0) {
        refine(self, given, zygos_receiver_front(&self->state.receiver));
    }
    int stepped = zygos_arm_step(&self->state);
    if (stepped < 0) {
        mended = mend(self, given);
        stepped = (mended < 0) ? mended : zygos_arm_step(&self->state);
    }
    return stepped;
}

int zygos_cycle(zygos_t *self, const zygos_cycle_t *cycle)
{
    if ((self == NULL) || (cycle == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (!is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    const zygos_given_t *given = prepare(self);
    if (!attend(self, given)) {
        return 0;
    }
    int mended = patrol(self, given);
    int stepped = (mended < 0) ? mended : zygos_arm_cycle(&self->state, cycle);
    if ((stepped < 0) && (mended >= 0)) {
        mended = mend(self, given);
        stepped = (mended < 0) ? mended : zygos_arm_cycle(&self->state, cycle);
    }
    if (given->word[ZYGOS_GIVEN_REFINE] != 0) {
        refine(self, given, (stepped > 0) ? cycle : NULL);
    }
    return stepped;
}

int zygos_attach(zygos_t *self, zygos_refine_t *refine, uint32_t slices)
{
    if ((self == NULL) || (refine == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (!is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    zygos_given_t given = given_to(self);
    given.word[ZYGOS_GIVEN_REFINE] = (uintptr_t)refine;
    given.word[ZYGOS_GIVEN_SLICES] = slices;
    give(self, &given);
    return 1;
}

const zygos_config_t *zygos_reference(const zygos_t *self)
{
    if ((self == NULL) || !is_begun(self)) {
        return NULL;
    }
    const zygos_given_t given = given_to(self);
    return config_of(&given);
}

int zygos_restart(zygos_t *self, uint32_t keep)
{
    if (self == NULL) {
        return ZYGOS_E_NULL;
    }
    if (!is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    const zygos_given_t given = given_to(self);
    if ((given.word[ZYGOS_GIVEN_BACKGROUND] == 0) && (stage_of(self) == (uint32_t)ZYGOS_STAGE_GIVEN)) {
        return 0;
    }
    if (mend(self, &given) == ZYGOS_E_CONFIG) { /* all is made anew from the configuration in memory */
        return ZYGOS_E_CONFIG;
    }
    (void)decode(self, true);
    const int verdict = zygos_arm_restart(&self->state, keep);
    if (verdict < 0) {
        return verdict;
    }
    self->state.restored = 0;
    self->state.sums.guard.adopting = 1;
    copy_anew(self);
    self->refines_anew = SET;
    give_up(self);
    return 1;
}

int zygos_seal(zygos_t *self, uint8_t *head)
{
    if ((self == NULL) || (head == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (!is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    const zygos_given_t given = given_to(self);
    if ((given.word[ZYGOS_GIVEN_BACKGROUND] == 0) && (stage_of(self) == (uint32_t)ZYGOS_STAGE_GIVEN)) {
        return 0;
    }
    const uint64_t losses = self->losses;
    const int mended = mend(self, &given);
    self->state.beside = 0;
    if (mended < 0) {
        return mended;
    }
    return (losses == self->losses) ? zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, &self->state, head) : ZYGOS_E_STATE;
}

int zygos_resume(zygos_t *self, const zygos_config_t *config, void *memory, uint32_t bytes, const uint8_t *head,
                 uint32_t length)
{
    if ((self == NULL) || (head == NULL)) {
        return ZYGOS_E_NULL;
    }
    const int begun = begin(self, config, memory, bytes);
    if (begun < 0) {
        return begun;
    }
    int verdict = zygos_snapshot_check(ZYGOS_SNAPSHOT_STATE, head, &self->state, length);
    verdict = (verdict == 1) ? zygos_arm_resume(&self->state, config) : verdict;
    if (verdict < 0) {
        return verdict;
    }
    self->state.held = 0;
    self->state.beside = 0;
    if (zygos_arm_scrub(&self->state, config) != 0) {
        return ZYGOS_E_SUMS;
    }
    self->state.restored = self->state.sums.cycle;
    self->state.sums.guard.adopting = 1;
    self->magic = ZYGOS_BEGUN;
    return 1;
}

/* ---------------------------------------------------------------- the background */

/* The share that sums from before a cycle still have, by the factor of forgetting. */
static bool has_faded(const zygos_config_t *config, uint64_t cycles)
{
    const double factor = config->forgetting_factor;
    return (factor < 1.0) && ((double)cycles * (1.0 - factor) > FADED);
}

/* The values are those of both arms, as long as the sums have both. */
static void doubt(zygos_background_t *background, const zygos_config_t *config)
{
    zygos_estimate_t *estimate = &background->estimate;
    const bool gone = (background->changed_of != background->of) || (estimate->since >= background->unchanged) ||
                      (estimate->cycle < background->unchanged) ||
                      has_faded(config, estimate->cycle - background->unchanged);
    background->changed = gone ? 0u : background->changed;
    estimate->changed = background->changed;
    if ((estimate->changed != 0) && (estimate->validity >= (uint32_t)ZYGOS_PARTIAL)) {
        estimate->validity = ZYGOS_DOUBTFUL;
        estimate->reason = ZYGOS_REASON_CHANGED;
    }
}

/* Values of an arm that was not seen for longer than an arc may be those of another one. */
static void age(zygos_estimate_t *estimate, const zygos_config_t *config)
{
    if ((estimate->unused > longest_arc(config)) && (estimate->validity >= (uint32_t)ZYGOS_PARTIAL)) {
        estimate->validity = ZYGOS_DOUBTFUL;
        estimate->reason = ZYGOS_REASON_OLD;
    }
}

static void solve_copy(zygos_background_t *background, const zygos_config_t *config)
{
    zygos_estimate_t *estimate = &background->estimate;
    zygos_work_t *work = &background->work;
    (void)zygos_work_solve(work, estimate);
    if ((background->changed == 0) && (estimate->reason != (uint32_t)ZYGOS_REASON_CORRUPT) &&
        zygos_change_found(&work->solver.newest)) {
        background->changed = 1;
        background->changed_of = background->of;
        background->unchanged = work->solver.newest.until;
    }
    doubt(background, config);
    background->adopted = 0;
    if ((estimate->changed == 0) && zygos_guard_adopt(&work->sums, estimate)) {
        background->adopted = 1;
    }
}

int zygos_solve(zygos_t *self, zygos_estimate_t *out)
{
    if ((self == NULL) || (out == NULL)) {
        return ZYGOS_E_NULL;
    }
    if (!is_begun(self)) {
        return ZYGOS_E_ORDER;
    }
    const uint32_t stage = stage_of(self);
    if (stage == (uint32_t)ZYGOS_STAGE_IDLE) {
        move_to(self, ZYGOS_STAGE_ASKED);
        return 0;
    }
    if (stage != (uint32_t)ZYGOS_STAGE_GIVEN) {
        return 0;
    }
    const zygos_given_t given = given_to(self);
    const zygos_config_t *config = config_of(&given);
    zygos_background_t *background = background_of(&given);
    zygos_estimate_t *estimate = estimate_of(&given);
    const uint64_t unused = estimate->unused;
    const uint32_t restored = estimate->restored;
    uint32_t of = 0;
    if (background != NULL) {
        of = background->of;
        background->work.sums.config = *config;
        solve_copy(background, config);
    } else {
        of = in_place_of(&given)->of;
        (void)zygos_arm_solve_ended(&self->state, &in_place_of(&given)->solver, estimate);
    }
    estimate->unused = unused;
    estimate->restored = restored;
    if (is_set(self->refining) && (estimate->validity == (uint32_t)ZYGOS_VALID)) {
        (void)zygos_refine_start(refine_of(&given), config, estimate, NULL);
    }
    age(estimate, config);
    *out = *estimate;
    *seal_of(&given) = estimate_checksum(&given, estimate);
    const bool current = (of == __atomic_load_n(&self->restarts, __ATOMIC_ACQUIRE));
    move_to(self, ZYGOS_STAGE_SOLVED);
    return current ? 1 : 0;
}
