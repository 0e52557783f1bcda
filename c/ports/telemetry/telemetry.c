/* SPDX-License-Identifier: MIT */
#include "telemetry.h"

#include <float.h>
#include <stdbool.h>
#include <string.h>

#define HEARTBEAT 0x700u
#define MODULUS 0x1000000u

_Static_assert(ZYGOS_FAULT_COUNTERS + 16u == NODE_COUNTERS, "a counter without a name");

const char *const node_counter_name[NODE_COUNTERS] = {
    "fault_length",         "fault_crc",           "fault_range",        "fault_late",         "fault_counter",
    "fault_repeated",       "fault_unsynced",      "fault_latch",        "fault_link_invalid", "fault_motor_invalid",
    "fault_torque_invalid", "fault_disabled",      "fault_gyro_invalid", "fault_saturated",    "fault_incomplete",
    "fault_dropped",        "fault_sync_repeated", "fault_sync_jumped",  "fault_time_lost",    "fault_time_jumped",
    "fault_overrun",        "fault_bus_error",     "count_cycles",       "count_gaps",         "count_invalid",
    "count_wraps",          "count_accepted",      "count_refused",      "count_arcs",         "count_arcs_dropped",
    "node_overflow",        "node_misshapen",      "node_down",          "node_unsent",        "node_corrupt",
    "node_unsaved",         "count_apart",         "count_waited",
};

void node_counters(const zygos_t *zygos, const node_losses_t *losses, uint64_t *out)
{
    const zygos_arm_t *arm = &zygos->state;
    uint32_t fault[ZYGOS_FAULT_COUNTERS];
    memcpy(fault, &arm->receiver.faults, sizeof fault);
    for (uint32_t i = 0; i < ZYGOS_FAULT_COUNTERS; i++) {
        out[i] = fault[i];
    }
    const uint64_t other[NODE_COUNTERS - ZYGOS_FAULT_COUNTERS] = {
        arm->cycles,
        arm->gaps,
        arm->invalid,
        arm->wraps,
        zygos_store_accepted(&arm->sums.energy.store),
        arm->sums.energy.refused,
        arm->sums.energy.store.arcs,
        arm->sums.energy.store.arcs_dropped,
        losses->overflow,
        losses->misshapen,
        losses->down,
        losses->unsent,
        losses->corrupt,
        losses->unsaved,
        arm->apart,
        arm->waited[ZYGOS_ENERGY_ROWS] + arm->waited[ZYGOS_MOTOR_ROWS] + arm->waited[ZYGOS_MOMENTUM_ROWS],
    };
    memcpy(&out[ZYGOS_FAULT_COUNTERS], other, sizeof other);
}

void node_telemetry_init(node_telemetry_t *self, uint32_t every, uint32_t refines)
{
    memset(self, 0, sizeof *self);
    self->every = every;
    self->refines = refines;
    self->judged = 1;
}

void node_telemetry_follow(node_telemetry_t *self, const zygos_t *arm)
{
    self->counter = arm->state.receiver.assembly.counter;
    self->judged = 1;
}

static void put(node_telemetry_t *self, enum node_kind kind, uint32_t index, double value)
{
    self->value[self->items] = value;
    self->index[self->items] = (uint8_t)index;
    self->kind[self->items] = (uint8_t)kind;
    self->items++;
}

/* The values of a new estimate, in place of those before. */
static void put_estimate(node_telemetry_t *self, const zygos_t *arm, const node_losses_t *losses)
{
    const zygos_estimate_t *const out = &self->estimate;
    self->items = 0;
    self->next = 0;
    self->due = 0;
    const double verdict[NODE_VERDICTS] = { (double)out->validity,
                                            (double)out->reason,
                                            (double)(out->cycle % MODULUS),
                                            (double)(out->accepted % MODULUS),
                                            (double)(out->refused % MODULUS),
                                            (double)out->arcs,
                                            (double)out->blocks,
                                            (double)out->rank,
                                            out->condition,
                                            out->cluster,
                                            out->residual,
                                            out->noise_ratio,
                                            out->signal_to_noise,
                                            (double)out->left_out[ZYGOS_ENERGY_ROWS] };
    for (uint32_t i = 0; i < NODE_VERDICTS; i++) {
        put(self, NODE_VERDICT, i, verdict[i]);
    }
    uint64_t counter[NODE_COUNTERS];
    node_counters(arm, losses, counter);
    for (uint32_t i = 0; i < NODE_COUNTERS; i++) {
        put(self, NODE_COUNTER, i, (double)(counter[i] % MODULUS));
    }
    for (uint32_t i = 0; (i < out->parameters) && (i < (uint32_t)ZYGOS_MAX_PARAMETERS); i++) {
        put(self, NODE_ESTIMATE, i, out->value[i]);
        put(self, NODE_SIGMA, i, out->sigma[i]);
        put(self, NODE_HALF95, i, out->half95[i]);
    }
}

/* What zygos_refine_judge() has said of the estimate. */
static void put_refined(node_telemetry_t *self, const zygos_refined_t *refined)
{
    const double refinement[NODE_REFINEMENTS] = {
        (double)refined->reason,
        (double)(refined->cycle % MODULUS),
        (double)(refined->used % MODULUS),
        (double)(refined->lost % MODULUS),
        (double)(refined->restarts % MODULUS),
        (double)(refined->rejected % MODULUS),
        (double)refined->farthest,
        refined->distance,
        refined->level,
        refined->level_error,
        refined->nis[ZYGOS_CHANNEL_LINK],
        refined->nis[ZYGOS_CHANNEL_MOTOR],
        refined->nis[ZYGOS_CHANNEL_GYRO],
        refined->ratio[ZYGOS_CHANNEL_LINK],
        refined->ratio[ZYGOS_CHANNEL_MOTOR],
        refined->ratio[ZYGOS_CHANNEL_GYRO],
    };
    for (uint32_t i = 0; i < NODE_REFINEMENTS; i++) {
        put(self, NODE_REFINEMENT, i, refinement[i]);
    }
    for (uint32_t i = 0;
         (refined->published == 1u) && (i < refined->parameters) && (i < (uint32_t)ZYGOS_MAX_PARAMETERS); i++) {
        put(self, NODE_REFINED, i, refined->value[i]);
        put(self, NODE_REFINED_SIGMA, i, refined->sigma[i]);
    }
    self->due = (self->wanted == 1u) ? self->items : self->due;
}

/* So many values are due now that all are sent before the next estimate is due. */
static void allot(node_telemetry_t *self)
{
    const uint32_t syncs = self->every - (uint32_t)((self->syncs - 1u) % self->every);
    const uint32_t left = self->items - self->next;
    self->due = self->next + left / syncs + ((left % syncs > 0u) ? 1u : 0u);
}

int node_telemetry_step(node_telemetry_t *self, zygos_t *arm, const node_losses_t *losses)
{
    const bool solved = (self->wanted == 1u) && (zygos_solve(arm, &self->estimate) == 1);
    if (solved) {
        self->wanted = 0;
        self->judged = (self->refines == 1u) ? 0u : 1u;
        put_estimate(self, arm, losses);
        allot(self);
    }
    if ((self->judged == 0u) && (arm->stage == (uint32_t)ZYGOS_STAGE_IDLE)) {
        self->judged = 1;
        put_refined(self, &arm->refined);
    }
    const uint32_t counter = arm->state.receiver.assembly.counter;
    const bool accepted = (counter != self->counter) && (counter != 0u); /* one that is repeated changes nothing */
    self->counter = counter;
    if (accepted && (self->syncs++ % self->every == 0u)) {
        self->wanted = 1;
        self->due = self->items; /* the next estimate may come before the next SYNC */
    } else if (accepted) {
        allot(self);
    }
    return solved ? 2 : (accepted ? 1 : 0);
}

int node_telemetry_next(node_telemetry_t *self, const zygos_t *arm, zygos_frame_t *out)
{
    while (self->next < self->due) {
        const uint32_t k = self->next++;
        if ((self->value[k] >= -(double)FLT_MAX) && (self->value[k] <= (double)FLT_MAX)) {
            zygos_wire_encode_telemetry((uint8_t)(arm->state.receiver.assembly.counter & 0x0Fu), self->index[k],
                                        self->kind[k], (float)self->value[k], out);
            return 1;
        }
    }
    return 0;
}

void node_telemetry_heartbeat(enum node_heartbeat state, zygos_frame_t *out)
{
    memset(out, 0, sizeof *out);
    out->id = HEARTBEAT + ZYGOS_NODE_COMPUTER;
    out->length = 1;
    out->data[0] = (uint8_t)state;
}
