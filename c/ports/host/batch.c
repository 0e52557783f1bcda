/* SPDX-License-Identifier: MIT */
#include "batch.h"

#include <string.h>

#define CYCLES_PER_TIME 50u

#ifndef ZYGOS_DECLARATIONS_DIGEST
#define ZYGOS_DECLARATIONS_DIGEST 0u
#endif

uint32_t zygos_declarations_digest(void)
{
    return ZYGOS_DECLARATIONS_DIGEST;
}

static void copy(double *out, uint64_t *k, const double *in, uint64_t n)
{
    memcpy(out + *k, in, n * sizeof in[0]);
    *k += n;
}

/* waited: what zygos_arm_t had of these before the cycle. */
static void record(const zygos_arm_t *self, const zygos_cycle_t *cycle, const uint64_t *waited, zygos_trace_t *trace)
{
    if ((trace == NULL) || (trace->count >= trace->capacity)) {
        return;
    }
    const uint64_t n = self->sums.config.joints;
    const uint64_t p = self->sums.column_map.parameters;
    const uint64_t at = trace->count++;
    if (trace->sync) {
        trace->sync[at] = cycle->sync;
    }
    if (trace->flags) {
        trace->flags[at] = cycle->flags;
    }
    if (trace->instant) {
        trace->instant[at] = (uint8_t)self->instant;
    }
    if (trace->waited) {
        uint32_t kinds = 0;
        for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
            kinds |= (uint32_t)(self->waited[kind] != waited[kind]) << kind;
        }
        trace->waited[at] = (uint8_t)kinds;
    }
    if (trace->accepted) {
        trace->accepted[at] = (uint8_t)(self->instant && (self->accepted > 0.0));
    }
    if (trace->measured) {
        uint64_t k = at * (3 * n + 3);
        copy(trace->measured, &k, cycle->q, n);
        copy(trace->measured, &k, cycle->theta, n);
        copy(trace->measured, &k, cycle->tau, n);
        copy(trace->measured, &k, cycle->omega, 3);
    }
    if (trace->state) {
        uint64_t k = at * (4 * n + 3);
        copy(trace->state, &k, self->arm_state.q, n);
        copy(trace->state, &k, self->arm_state.theta, n);
        copy(trace->state, &k, self->arm_state.q_rate, n);
        copy(trace->state, &k, self->arm_state.theta_rate, n);
        copy(trace->state, &k, self->arm_state.omega, 3);
    }
    if (trace->row) {
        uint64_t k = at * (p + 1);
        copy(trace->row, &k, self->row.column, p);
        copy(trace->row, &k, &self->row.work, 1);
    }
}

int64_t zygos_batch_frames(zygos_arm_t *self, const zygos_frame_t *frame, uint64_t n, uint8_t *verdict,
                           zygos_trace_t *trace)
{
    int64_t cycles = 0;
    for (uint64_t i = 0; i < n; i++) {
        const int reception = zygos_arm_frame(self, &frame[i]);
        if (reception < 0) {
            return reception;
        }
        if (verdict) {
            verdict[i] = (uint8_t)reception;
        }
        const zygos_cycle_t *front;
        while ((front = zygos_receiver_front(&self->receiver)) != NULL) {
            const zygos_cycle_t cycle = *front;
            uint64_t waited[ZYGOS_KINDS_OF_ROWS];
            memcpy(waited, self->waited, sizeof waited);
            const int stepped = zygos_arm_step(self);
            if (stepped < 0) {
                return stepped;
            }
            cycles += stepped;
            record(self, &cycle, waited, trace);
        }
    }
    return cycles;
}

int64_t zygos_batch_cycles(zygos_arm_t *self, const zygos_cycle_t *cycle, uint64_t n, zygos_trace_t *trace)
{
    int64_t cycles = 0;
    for (uint64_t i = 0; i < n; i++) {
        uint64_t waited[ZYGOS_KINDS_OF_ROWS];
        memcpy(waited, self->waited, sizeof waited);
        const int used = zygos_arm_cycle(self, &cycle[i]);
        if (used < 0) {
            return used;
        }
        cycles += used;
        if (used) {
            record(self, &cycle[i], waited, trace);
        }
    }
    return cycles;
}

static zygos_frame_t *put(const zygos_record_t *record_in, uint32_t message, uint32_t node, zygos_frame_t *out)
{
    return out + zygos_wire_encode(record_in, message, node, out);
}

uint64_t zygos_batch_encode(const zygos_config_t *config, const zygos_cycle_t *cycle, uint64_t n, zygos_frame_t *out)
{
    zygos_frame_t *const begin = out;
    for (uint64_t c = 0; c < n; c++) {
        const zygos_cycle_t *now = &cycle[c];
        zygos_record_t header;
        memset(&header, 0, sizeof header);
        header.sync = (uint8_t)(now->sync % ZYGOS_SYNC_MODULUS + 1u);
        header.counter = header.sync & 0x0Fu;
        out = put(&header, ZYGOS_MSG_SYNC, 0, out);
        if (now->sync % CYCLES_PER_TIME == 0) {
            header.time_us = (uint32_t)(uint64_t)((double)now->sync * config->period_s * 1e6 + 0.5);
            out = put(&header, ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER, out);
        }
        header.status = (now->flags & ZYGOS_CYCLE_INVALID) ? 0u : 0x0Fu;
        for (uint32_t i = 0; i < config->joints; i++) {
            zygos_record_t angles = header;
            angles.code[0] = zygos_wire_angle_code(now->q[i]);
            angles.code[1] = zygos_wire_angle_code(now->theta[i]);
            out = put(&angles, ZYGOS_MSG_ANGLES, config->joint[i].node, out);
            zygos_record_t torque = header;
            torque.code[0] = zygos_wire_torque_code(now->tau[i]);
            torque.latch_us = (uint16_t)config->joint[i].latch_us;
            torque.temperature = 20;
            out = put(&torque, ZYGOS_MSG_TORQUE, config->joint[i].node, out);
        }
        if (config->imu_node == 0) {
            continue;
        }
        zygos_record_t rate = header;
        rate.status = (uint8_t)((now->flags & ZYGOS_CYCLE_INVALID) ? 0u : (uint32_t)ZYGOS_STATUS_RATE_VALID);
        if (config->imu_fine) {
            rate.code[0] = zygos_wire_rate_fine_code(now->omega[0]);
            rate.code[1] = zygos_wire_rate_fine_code(now->omega[1]);
            out = put(&rate, ZYGOS_MSG_RATE_XY, config->imu_node, out);
            rate.code[0] = zygos_wire_rate_fine_code(now->omega[2]);
            out = put(&rate, ZYGOS_MSG_RATE_Z, config->imu_node, out);
        } else {
            for (uint32_t i = 0; i < 3; i++) {
                rate.code[i] = zygos_wire_rate_coarse_code(now->omega[i]);
            }
            out = put(&rate, ZYGOS_MSG_RATE_COARSE, config->imu_node, out);
        }
    }
    zygos_record_t last;
    memset(&last, 0, sizeof last);
    last.sync = (uint8_t)((n ? cycle[n - 1].sync + 1u : 0u) % ZYGOS_SYNC_MODULUS + 1u);
    out = put(&last, ZYGOS_MSG_SYNC, 0, out);
    return (uint64_t)(out - begin);
}
