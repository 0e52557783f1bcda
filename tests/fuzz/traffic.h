/* SPDX-License-Identifier: MIT */
/* Traffic of an arm for the fuzzers: random numbers, a configuration with every kind of row, and its frames. */

#ifndef FUZZ_TRAFFIC_H
#define FUZZ_TRAFFIC_H

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "zygos/zygos.h"

#define PERIOD_US 50000u

static uint64_t random_state;

static uint64_t draw(void) /* xorshift64* */
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return random_state * 0x2545F4914F6CDD1Du;
}

static uint32_t below(uint32_t n)
{
    return (uint32_t)((draw() >> 32) % n);
}

static zygos_config_t config_of(uint32_t joints, uint32_t fine)
{
    zygos_config_t config;
    memset(&config, 0, sizeof config);
    config.abi = ZYGOS_ABI;
    config.joints = joints;
    config.smoother_half_width = 3;
    config.smoother_order = 4;
    config.smoother_lag = 3;
    config.arc_cycles = 200;
    config.impulse_arc_cycles = 100;
    config.momentum_arc_cycles = 100;
    config.compensation = 2u * joints + 1u;
    config.forgetting_factor = 0.9999;
    config.imu_sigma = 1e-4;
    config.imu_node = 16;
    config.imu_fine = fine;
    config.period_s = 1e-6 * PERIOD_US;
    config.imu_to_base[0] = config.imu_to_base[4] = config.imu_to_base[8] = 1.0;
    for (uint32_t i = 0; i < joints; i++) {
        zygos_joint_config_t *joint = &config.joint[i];
        joint->node = i + 1;
        joint->axis[2] = 1.0;
        joint->gear_ratio = 50.0;
        joint->link_sign = joint->motor_sign = 1.0;
        joint->link_sigma_rad = joint->motor_sigma_rad = 1e-3;
    }
    return config;
}

/* The messages of a cycle, in the order of the bus: SYNC, FTIME, two of each joint, one or two of the gyro. */
typedef struct {
    uint32_t message;
    uint32_t node;
} slot_t;

static uint32_t slots(slot_t *slot, uint32_t joints, uint32_t fine)
{
    uint32_t n = 0;
    slot[n++] = (slot_t){ ZYGOS_MSG_SYNC, 0 };
    slot[n++] = (slot_t){ ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER };
    for (uint32_t i = 0; i < joints; i++) {
        slot[n++] = (slot_t){ ZYGOS_MSG_ANGLES, i + 1 };
        slot[n++] = (slot_t){ ZYGOS_MSG_TORQUE, i + 1 };
    }
    slot[n++] = (slot_t){ fine ? ZYGOS_MSG_RATE_XY : ZYGOS_MSG_RATE_COARSE, 16 };
    if (fine) {
        slot[n++] = (slot_t){ ZYGOS_MSG_RATE_Z, 16 };
    }
    return n;
}

/* A small, smooth motion, so that the estimator has rows to form. */
static zygos_record_t record_of(slot_t slot, uint64_t cycle)
{
    zygos_record_t record;
    memset(&record, 0, sizeof record);
    record.sync = (uint8_t)(cycle % ZYGOS_SYNC_MODULUS + 1u);
    record.counter = record.sync & 0x0Fu;
    record.time_us = (uint32_t)(cycle * PERIOD_US);
    record.status = 15;
    const int32_t phase = (int32_t)(cycle % 400u) - 200; /* a parabola every 400 cycles */
    for (int32_t k = 0; k < 3; k++) {
        record.code[k] = (slot.message == ZYGOS_MSG_RATE_COARSE) ? phase : (phase * phase + 1000 * k) / (k + 1);
    }
    return record;
}

static zygos_frame_t encode(const zygos_record_t *record, slot_t slot)
{
    zygos_frame_t frame;
    if (zygos_wire_encode(record, slot.message, slot.node, &frame) != 1) {
        printf("message %" PRIu32 " cannot be encoded\n", slot.message);
        exit(1);
    }
    for (uint32_t i = frame.length; i < sizeof frame.data; i++) {
        frame.data[i] = (uint8_t)below(256); /* must not be read */
    }
    frame.pad[0] = (uint8_t)below(256);
    return frame;
}

#endif
