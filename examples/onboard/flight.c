/* SPDX-License-Identifier: MIT */
#include "flight.h"
#include "arm_config.h"

#include <stdatomic.h>
#include <stddef.h>

enum kind { TELEMETRY_ESTIMATE = 0, TELEMETRY_SIGMA = 1, TELEMETRY_VERDICT = 3 }; /* as in zygos.dbc */

static zygos_t arm;
static zygos_background_t memory; /* belongs to the library */
static zygos_estimate_t estimate; /* this and what is learned belong to flight_solve() */
static flight_learned_t learned;
static _Atomic uint32_t payload_changed[2]; /* set by the interrupt for the task and for the background */

int flight_start(void)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    const uint32_t length = port_load(head, &arm.state, sizeof arm.state);
    const int resumed = zygos_resume(&arm, &arm_config, &memory, sizeof memory, head, length);
    return (resumed == 1) ? 2 : zygos_init(&arm, &arm_config, &memory, sizeof memory); /* over whatever was read */
}

int flight_store(void)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    return (zygos_seal(&arm, head) == 1) && (port_save(head, &arm.state, sizeof arm.state) > sizeof arm.state);
}

void flight_receive(const zygos_frame_t *frame)
{
    if ((frame->id == FLIGHT_PAYLOAD_CHANGED) && (frame->flags == 0u)) {
        payload_changed[0] = payload_changed[1] = 1u;
    }
    (void)zygos_frame(&arm, frame); /* a frame that is lost is counted, and leaves its cycle incomplete */
}

void flight_task(void)
{
    if (atomic_exchange(&payload_changed[0], 0u) != 0u) { /* rotors, springs and dampers are as they were */
        (void)zygos_restart(&arm, ZYGOS_KEEP_FAULTS | ZYGOS_KEEP_JOINTS);
    }
    while (zygos_step(&arm) == 1) {
    }
}

static void tell(uint32_t index, enum kind kind, double value)
{
    zygos_frame_t frame;
    zygos_wire_encode_telemetry((uint8_t)(estimate.cycle % 16u), (uint8_t)index, (uint8_t)kind, (float)value, &frame);
    port_send(&frame);
}

const zygos_estimate_t *flight_solve(void)
{
    const uint32_t bodies = (atomic_exchange(&payload_changed[1], 0u) != 0u) ? ARM_Im1 : 0u;
    for (uint32_t i = 0; i < bodies; i++) {
        learned.known[i] = 0u; /* with another payload they are other bodies */
    }
    if (zygos_solve(&arm, &estimate) != 1) {
        return NULL;
    }
    tell(0, TELEMETRY_VERDICT, estimate.validity);
    tell(1, TELEMETRY_VERDICT, estimate.reason);
    for (uint32_t i = 0; (estimate.validity >= ZYGOS_PARTIAL) && (i < estimate.parameters); i++) {
        if (estimate.identifiable[i] == 1u) { /* otherwise what was known before is better */
            learned.known[i] = 1u;
            learned.value[i] = estimate.value[i];
            learned.half95[i] = estimate.half95[i];
            learned.cycle = estimate.cycle;
            tell(i, TELEMETRY_ESTIMATE, estimate.value[i]);
            tell(i, TELEMETRY_SIGMA, estimate.sigma[i]);
        }
    }
    return &estimate;
}

const flight_learned_t *flight_learned(void)
{
    return &learned;
}
