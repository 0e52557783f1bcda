// Arm paper, compiled from arm.toml by `zygos compile-model`. Do not edit.
//
// The smallest build that holds it: -DZYGOS_MAX_JOINTS=2 -DZYGOS_MAX_HALF_WIDTH=5 -DZYGOS_MAX_EFFECTS=0 -DZYGOS_MAX_REDUCTION=0 -DZYGOS_SPATIAL=0 -DZYGOS_MOMENTUM=0 -DZYGOS_JOINT_ROWS=0 -DZYGOS_MAX_BLOCKS=32
// It takes 157,320 bytes: configuration 624, state 80,640, work 74,440, estimate 1,616.
//
// With the fewest blocks: -DZYGOS_MAX_JOINTS=2 -DZYGOS_MAX_HALF_WIDTH=5 -DZYGOS_MAX_EFFECTS=0 -DZYGOS_MAX_REDUCTION=0 -DZYGOS_SPATIAL=0 -DZYGOS_MOMENTUM=0 -DZYGOS_JOINT_ROWS=0 -DZYGOS_MAX_BLOCKS=11 -DZYGOS_MAX_MOTOR_BLOCKS=4
// Solved in place (zygos_solve_in_place()), it takes 43,184 bytes: configuration 624, state 40,416, solver 528, estimate 1,616.

#ifndef ARM_CONFIG_H
#define ARM_CONFIG_H

#include "zygos/zygos.h"

#if (ZYGOS_VERSION_MAJOR != 0) || (ZYGOS_VERSION_MINOR != 1)
#error "written for another version of zygos; remedy: run `zygos compile-model` again"
#endif
#if ZYGOS_MAX_JOINTS < 2
#error "this arm needs ZYGOS_MAX_JOINTS 2; remedy: compile with -DZYGOS_MAX_JOINTS=2"
#endif
#if ZYGOS_MAX_HALF_WIDTH < 5
#error "this arm needs ZYGOS_MAX_HALF_WIDTH 5; remedy: compile with -DZYGOS_MAX_HALF_WIDTH=5"
#endif

/// Where the estimate has each parameter: estimate.value[ARM_k1].
enum arm_parameter {
    ARM_a00 = 0, // kg m^2
    ARM_a01 = 1, // kg m^2
    ARM_a02 = 2, // kg m^2
    ARM_a11 = 3, // kg m^2
    ARM_a12 = 4, // kg m^2
    ARM_a22 = 5, // kg m^2
    ARM_Im1 = 6, // kg m^2
    ARM_k1 = 7, // Nm/rad
    ARM_b1 = 8, // Nms/rad
    ARM_Im2 = 9, // kg m^2
    ARM_k2 = 10, // Nm/rad
    ARM_b2 = 11, // Nms/rad
    ARM_PARAMETERS = 12
};

#ifdef __cplusplus
#pragma GCC system_header // no warning: C++17 compilers know the designated initialisers of C and C++20
#endif

/// What zygos_init() is given.
static const zygos_config_t arm_config = {
    .abi = ZYGOS_ABI,
    .joints = 2u,
    .kinetic = ZYGOS_PLANAR_SYMMETRIC,
    .torque_law = ZYGOS_TORQUE_APPLIED_FROM_SYNC,
    .smoother_half_width = 5u,
    .smoother_order = 6u,
    .smoother_lag = 5u,
    .arc_cycles = 1200u,
    .forgetting_factor = 1.0,
    .imu_node = 16u,
    .imu_fine = 1u,
    .period_s = 0.05,
    .imu_to_base = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 },
    .imu_latch_s = 0.0,
    .imu_sigma = 1.4208833331019601e-06,
    .gravity = { 0.0, 0.0, 0.0 },
    .joint = {
        {
            .node = 1u,
            .latch_us = 0u,
            .rigid = 0u,
            .reserved = 0u,
            .frame = { 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 },
            .axis = { 0.0, 0.0, 1.0 },
            .gear_ratio = 50.0,
            .link_sign = 1.0,
            .link_zero_rad = 0.0,
            .link_sigma_rad = 0.000866027131282639,
            .link_latch_s = 0.0,
            .motor_sign = 1.0,
            .motor_zero_rad = 0.0,
            .motor_sigma_rad = 0.000866027131282639,
            .motor_latch_s = 0.0,
            .torque_sigma = 0.0,
            .torque_relative_sigma = 0.0,
        },
        {
            .node = 2u,
            .latch_us = 0u,
            .rigid = 0u,
            .reserved = 0u,
            .frame = { 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 },
            .axis = { 0.0, 0.0, 1.0 },
            .gear_ratio = 50.0,
            .link_sign = 1.0,
            .link_zero_rad = 0.0,
            .link_sigma_rad = 0.000866027131282639,
            .link_latch_s = 0.0,
            .motor_sign = 1.0,
            .motor_zero_rad = 0.0,
            .motor_sigma_rad = 0.000866027131282639,
            .motor_latch_s = 0.0,
            .torque_sigma = 0.0,
            .torque_relative_sigma = 0.0,
        },
    },
    .compensation = 5u,
    .impulse_arc_cycles = 200u,
    .effects = 0u,
    .base = ZYGOS_BASE_FREE,
    .momentum_arc_cycles = 0u,
    .joint_row_cycles = 0u,
    .effect = {
        {
            .kind = ZYGOS_MOTOR_COULOMB,
            .joint = 0u,
        },
    },
    .reduced = 0u,
    .reductions = 0u,
    .reduction = {
        {
            .column = 0u,
            .parameter = 0u,
            .factor = 0.0,
        },
    },
};

#endif
