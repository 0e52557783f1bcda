/* SPDX-License-Identifier: MIT */
#include "zygos/priv/joint.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

#define HALVES 3u
/* Weights of an instant in the integral over a half, in 24ths: of the last three and the first of a half, for the half
   that ends and for the one that begins. Between them an instant has the weight 24. */
#define INNER 24.0
static const double ending[3] = { 23.0, 28.0, 9.0 };
static const double beginning[3] = { 1.0, -4.0, 15.0 };

static bool in_space(const zygos_config_t *config)
{
    return (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
}

static uint32_t after(uint32_t half)
{
    return (half + 1u) % HALVES;
}

void zygos_joint_reset(zygos_joint_t *self, const zygos_config_t *config)
{
    self->turn = config->joints;
    if (config->joint_row_cycles == 0) {
        return; /* nobody uses what else there is */
    }
    memset(self, 0, sizeof *self);
    self->turn = config->joints;
    /* The fourth instant ends a half, of which there is nothing. */
    self->position = config->joint_row_cycles / 2u - 4u;
}

bool zygos_joint_intact(const zygos_joint_t *self, const zygos_config_t *config)
{
    if (config->joint_row_cycles == 0) {
        return true;
    }
    return (self->position < config->joint_row_cycles / 2u) && (self->halves <= 3u) && (self->oldest < HALVES) &&
           (self->begin < 2u) && (self->turn <= config->joints);
}

/* What one cycle leaves to the next is stored twice. */

static uint32_t columns_of_row(const zygos_config_t *config, const zygos_column_map_t *column_map)
{
    return column_map->body + config->joints;
}

/* The columns come last in both. */
static uint32_t bytes_of_integrals(uint32_t columns)
{
    return (uint32_t)(offsetof(zygos_joint_integrals_t, force) + columns * sizeof(double));
}

static uint32_t bytes_of_end(uint32_t columns)
{
    return (uint32_t)(offsetof(zygos_joint_end_t, momentum) + columns * sizeof(double));
}

/* Whether what rows need of the newest end is as it was left. */
static bool is_newest_whole(const zygos_joint_newest_t *newest)
{
    const uint32_t used = (uint32_t)(offsetof(zygos_motion_t, spin) - offsetof(zygos_motion_t, carrier_rate));
    return zygos_is_same(&newest[0], &newest[1], (uint32_t)offsetof(zygos_joint_newest_t, motion)) &&
           zygos_is_same(newest[0].motion.carrier_rate, newest[1].motion.carrier_rate, used);
}

/* The derivative of n_i theta'_i a_i . w_(i-1) by the angle of joint j < i. */
static double rotor_force(const zygos_config_t *config, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                          uint32_t j, uint32_t i)
{
    if (!in_space(config)) {
        return 0.0;
    }
    const double *z = motion->axis[i];
    const double *w = motion->spin[j];
    const double *axis = motion->axis[j];
    const double turned = axis[0] * (z[1] * w[2] - z[2] * w[1]) + axis[1] * (z[2] * w[0] - z[0] * w[2]) +
                          axis[2] * (z[0] * w[1] - z[1] * w[0]);
    return config->joint[i].gear_ratio * state->theta_rate[i] * turned;
}

/* The part of a_i that lies along a_j. */
static double along(const zygos_config_t *config, const zygos_motion_t *motion, uint32_t j, uint32_t i)
{
    return in_space(config) ? zygos_dot3(motion->axis[j], motion->axis[i]) : 1.0;
}

/* What an effect integrates in the row of its joint. Only the configuration chooses. */
static double effect_integrand(const zygos_config_t *config, uint32_t e, const zygos_arm_state_t *state)
{
    const uint32_t i = config->effect[e].joint;
    const double rigid = (config->joint[i].rigid != 0) ? config->joint[i].gear_ratio : 0.0;
    const double deflection = state->theta[i] - state->q[i];
    switch ((enum zygos_effect_kind)config->effect[e].kind) {
    case ZYGOS_MOTOR_COULOMB:
        return rigid * zygos_effects_saturated(state->theta_rate[i]);
    case ZYGOS_LINK_COULOMB:
        return zygos_effects_saturated(state->q_rate[i]);
    case ZYGOS_CUBIC_STIFFNESS:
        return -deflection * deflection * deflection;
    case ZYGOS_SPRING_OFFSET:
        return -1.0;
    case ZYGOS_TORQUE_OFFSET:
        return rigid;
    case ZYGOS_VISCOUS_ASYMMETRY:
        return rigid * __builtin_fabs(state->theta_rate[i]);
    case ZYGOS_MOTOR_VISCOUS:
    case ZYGOS_TORQUE_LAG:
    case ZYGOS_TORQUE_GAIN: /* the impulse of the row */
        break;
    }
    return 0.0;
}

/* What belongs to the ends of an increment alone. */
static double effect_at_end(const zygos_joint_newest_t *newest, const zygos_config_t *config, uint32_t e)
{
    const uint32_t i = config->effect[e].joint;
    const double rigid = (config->joint[i].rigid != 0) ? config->joint[i].gear_ratio : 0.0;
    switch ((enum zygos_effect_kind)config->effect[e].kind) {
    case ZYGOS_MOTOR_VISCOUS:
        return rigid * newest->state.theta[i];
    case ZYGOS_TORQUE_LAG:
        return rigid * newest->torque_mean[i];
    case ZYGOS_MOTOR_COULOMB:
    case ZYGOS_LINK_COULOMB:
    case ZYGOS_CUBIC_STIFFNESS:
    case ZYGOS_SPRING_OFFSET:
    case ZYGOS_TORQUE_OFFSET:
    case ZYGOS_VISCOUS_ASYMMETRY:
    case ZYGOS_TORQUE_GAIN: /* the impulse of the row */
        break;
    }
    return 0.0;
}

/* A half that integrands of an instant are added to. */
typedef struct {
    zygos_joint_integrals_t (*of_joint)[2];
    double weight;
    bool begins; /* Whether it is the first instant, so that what is there does not count. */
} side_t;

/* What is stored twice. */
static void add_scaled(double *restrict to, double *restrict twin, const double *restrict from, const side_t *side,
                       uint32_t count)
{
    if (side->begins) {
        for (uint32_t k = 0; k < count; k++) {
            const double scaled = side->weight * from[k];
            to[k] = scaled;
            twin[k] = scaled;
        }
        return;
    }
    for (uint32_t k = 0; k < count; k++) {
        const double scaled = side->weight * from[k];
        to[k] += scaled;
        twin[k] += scaled;
    }
}

/* Adds the integrands of this instant to so many halves. */
static void integrate(const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                      const side_t *side, uint32_t sides)
{
    for (uint32_t j = 0; j < config->joints; j++) {
        double force[ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS];
        zygos_kinematics_slopes(geometry, config, motion, j, force, NULL);
        for (uint32_t k = column_map->kinetic; k < column_map->body; k++) {
            force[k] = -force[k]; /* the potential energy */
        }
        for (uint32_t i = 0; i < config->joints; i++) {
            force[column_map->body + i] = (i > j) ? rotor_force(config, state, motion, j, i) : 0.0;
        }
        const double deflection = state->theta[j] - state->q[j];
        for (uint32_t s = 0; s < sides; s++) {
            zygos_joint_integrals_t *to = side[s].of_joint[j];
            add_scaled(to[0].force, to[1].force, force, &side[s], columns_of_row(config, column_map));
            add_scaled(&to[0].deflection, &to[1].deflection, &deflection, &side[s], 1u);
        }
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        const double integrand = effect_integrand(config, e, state);
        for (uint32_t s = 0; s < sides; s++) {
            zygos_joint_integrals_t *to = side[s].of_joint[config->effect[e].joint];
            add_scaled(&to[0].effect[e], &to[1].effect[e], &integrand, &side[s], 1u);
        }
    }
}

/* p_j of the motion at the newest end. */
static void joint_momentum(const zygos_joint_newest_t *newest, const zygos_config_t *config,
                           const zygos_column_map_t *column_map, uint32_t j, double *out)
{
    const zygos_motion_t *motion = &newest->motion;
    double moved[ZYGOS_MAX_DIRECTIONS][3];
    zygos_kinematics_swing(config, motion, motion->axis[j], j + 1u, moved);
    memset(out, 0, columns_of_row(config, column_map) * sizeof out[0]);
    (void)zygos_kinetic_products(config, motion->rate, (const double(*)[3])moved, out);
    (void)zygos_kinetic_products(config, (const double(*)[3])moved, motion->rate, out);
    for (uint32_t i = j; i < config->joints; i++) {
        const double spin = config->joint[i].gear_ratio * newest->state.theta_rate[i];
        const double own = config->joint[i].gear_ratio * (spin + motion->carrier_rate[i]);
        const double rigid = (config->joint[j].rigid != 0) ? 1.0 : 0.0;
        out[column_map->body + i] = (i > j) ? spin * along(config, motion, j, i) : rigid * own;
    }
}

/* The newest end, of joint j. */
static void end_of(const zygos_joint_newest_t *newest, const zygos_config_t *config,
                   const zygos_column_map_t *column_map, uint32_t j, zygos_joint_end_t *out)
{
    const bool rigid = (config->joint[j].rigid != 0);
    joint_momentum(newest, config, column_map, j, out->momentum);
    out->deflection = newest->state.theta[j] - newest->state.q[j];
    out->impulse = rigid ? config->joint[j].gear_ratio * zygos_effects_jump(config) * newest->jump[j] : 0.0;
    for (uint32_t e = 0; e < (uint32_t)ZYGOS_EFFECT_PLACES; e++) { /* unused ones are no remains of the stack */
        const bool own = (e < config->effects) && (config->effect[e].joint == j);
        out->effect[e] = own ? effect_at_end(newest, config, e) : 0.0;
    }
}

/* Forms the row of a joint; its end and its integrals make room for the next. Returns whether memory was as it had been
   left. */
static bool form_joint_row(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                           uint32_t j, zygos_joint_row_t *out)
{
    const double h = config->period_s / INNER;
    const uint32_t body = column_map->body;
    const zygos_joint_integrals_t *older = self->half[self->oldest][j];
    const zygos_joint_integrals_t *newer = self->half[after(self->oldest)][j];
    zygos_joint_end_t *begin = self->ends[self->begin][j];
    const uint32_t columns = columns_of_row(config, column_map);
    const uint32_t bytes = bytes_of_integrals(columns);
    const bool whole = zygos_is_same(&older[0], &older[1], bytes) && zygos_is_same(&newer[0], &newer[1], bytes) &&
                       zygos_is_same(&begin[0], &begin[1], bytes_of_end(columns)) && is_newest_whole(self->newest);
    zygos_joint_end_t end;
    const bool rigid = (config->joint[j].rigid != 0);
    end_of(self->newest, config, column_map, j, &end);
    memset(out->column, 0, column_map->count * sizeof out->column[0]);
    for (uint32_t k = 0; k < body; k++) {
        out->column[k] = end.momentum[k] - begin->momentum[k] - h * (older->force[k] + newer->force[k]);
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        if (column_map->rotor[i] != 0u) {
            const uint32_t k = body + i;
            out->column[column_map->joint[i]] =
                end.momentum[k] - begin->momentum[k] - h * (older->force[k] + newer->force[k]);
        }
    }
    if (!rigid) {
        double *spring = &out->column[column_map->joint[j] + column_map->rotor[j]];
        spring[0] = -h * (older->deflection + newer->deflection);
        spring[1] = begin->deflection - end.deflection;
    }
    const double impulse = rigid ? config->joint[j].gear_ratio * config->period_s : 0.0;
    out->impulse = impulse * (older->impulse + newer->impulse) + end.impulse - begin->impulse;
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == j) {
            const double gain = (config->effect[e].kind == ZYGOS_TORQUE_GAIN) ? out->impulse : 0.0;
            out->column[column_map->effects + e] =
                end.effect[e] - begin->effect[e] + h * (older->effect[e] + newer->effect[e]) - gain;
        }
    }
    out->accepted = (older->refused + newer->refused > 0.0) ? 0.0 : 1.0;
    out->joint = j;
    out->last = (j + 1u == config->joints) ? 1u : 0u;
    memcpy(&begin[0], &end, bytes_of_end(columns));
    memcpy(&begin[1], &end, bytes_of_end(columns));
    return whole;
}

/* Adds the torque before a SYNC and what is refused to the sides of all joints. */
static inline void add_torques(const side_t *side, uint32_t n, const double *tau_before, double refused, bool ends)
{
    for (uint32_t j = 0; j < n; j++) {
        for (uint32_t twin = 0; twin < 2u; twin++) {
            side[0].of_joint[j][twin].impulse += tau_before[j];
            side[0].of_joint[j][twin].refused += refused;
            if (ends) { /* it is the first of the next half as well */
                side[1].of_joint[j][twin].impulse = 0.0;
                side[1].of_joint[j][twin].refused = refused;
            }
        }
    }
}

/* What rows need of the instant at which a half ends. */
static inline void keep_newest(zygos_joint_newest_t *newest, uint32_t n, const zygos_arm_state_t *state,
                               const zygos_motion_t *motion, const double *tau_before, const double *tau)
{
    for (uint32_t j = 0; j < n; j++) {
        newest->jump[j] = tau[j] - tau_before[j];
        newest->torque_mean[j] = 0.5 * (tau[j] + tau_before[j]);
    }
    newest->state = *state;
    newest->motion = *motion;
}

int zygos_joint_row(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                    const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                    const double *tau_before, const double *tau, zygos_joint_row_t *out)
{
    const uint32_t cycles = config->joint_row_cycles / 2u;
    const uint32_t n = config->joints;
    bool formed = false;
    bool whole = true;
    /* The row first: its older half becomes the one after that which is being filled. */
    if (self->turn < n) {
        whole = form_joint_row(self, config, column_map, self->turn, out);
        self->turn++;
        formed = (self->halves == 3u);
        self->begin ^= (self->turn == n) ? 1u : 0u;
    }
    if (!whole) {
        zygos_joint_reset(self, config);
        return -1;
    }
    self->position++;
    const uint32_t left = cycles - self->position;
    const side_t side[2] = {
        { self->half[after(after(self->oldest))], (left < 3u) ? ending[2u - left] : INNER, false },
        { self->half[self->oldest], (left < 3u) ? beginning[2u - left] : 0.0, left == 2u },
    };
    integrate(config, column_map, geometry, state, motion, side, (left < 3u) ? 2u : 1u);
    add_torques(side, n, tau_before, 1.0 - state->accepted, left == 0);
    if (left > 0) {
        return formed ? 1 : 0;
    }
    for (uint32_t twin = 0; twin < 2u; twin++) {
        keep_newest(&self->newest[twin], n, state, motion, tau_before, tau);
    }
    self->position = 0;
    self->oldest = after(self->oldest);
    self->halves += (self->halves < 3u) ? 1u : 0u;
    self->turn = 0;
    return formed ? 1 : 0;
}

uint32_t zygos_joint_signals(const zygos_config_t *config)
{
    const uint32_t base = (config->base != ZYGOS_BASE_FREE) ? 0u : (in_space(config) ? 3u : 1u);
    return config->joints + base;
}

/* How fast the rotor of a rigid joint turns with a signal, beside its own joint. */
static double carried_by(const zygos_config_t *config, const zygos_motion_t *motion, uint32_t joint, uint32_t signal,
                         const double *axis)
{
    if (signal < config->joints) {
        return (signal < joint) ? along(config, motion, signal, joint) : 0.0;
    }
    return in_space(config) ? zygos_dot3(axis, motion->axis[joint]) : 1.0;
}

void zygos_joint_derivative(const zygos_joint_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map, uint32_t joint, uint32_t signal, double *out,
                            double *rotor)
{
    const uint32_t n = config->joints;
    const bool of_link = (signal < n);
    const bool rigid = (config->joint[joint].rigid != 0);
    const zygos_motion_t *motion = &self->newest[0].motion;
    double moved[ZYGOS_MAX_DIRECTIONS][3];
    double swung[ZYGOS_MAX_DIRECTIONS][3];
    double axis[3] = { 0.0, 0.0, 0.0 };
    if (of_link) {
        memcpy(axis, motion->axis[signal], sizeof axis);
    } else {
        axis[signal - n] = 1.0;
    }
    zygos_kinematics_swing(config, motion, motion->axis[joint], joint + 1u, moved);
    zygos_kinematics_swing(config, motion, axis, of_link ? signal + 1u : 0u, swung);
    memset(out, 0, column_map->count * sizeof out[0]);
    (void)zygos_kinetic_products(config, (const double(*)[3])swung, (const double(*)[3])moved, out);
    (void)zygos_kinetic_products(config, (const double(*)[3])moved, (const double(*)[3])swung, out);
    for (uint32_t i = 0; i < n; i++) {
        const double ratio = config->joint[i].gear_ratio;
        const double turned = (i > joint) ? ratio * along(config, motion, joint, i) : 0.0;
        const bool turns = of_link && (i == signal) && (config->joint[i].rigid != 0);
        rotor[i] = (config->joint[i].rigid != 0) ? 0.0 : turned;
        if (!column_map->rotor[i]) {
            continue;
        }
        double *column = &out[column_map->joint[i]];
        if (i > joint) {
            *column = turns ? turned : 0.0;
        } else if ((i == joint) && rigid) {
            *column = ratio * (((signal == joint) ? ratio : 0.0) + carried_by(config, motion, joint, signal, axis));
        }
    }
}
