#include "zygos/priv/joint.h"

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

static double product(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
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
           (self->newest < 2u) && (self->turn <= config->joints);
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
    return in_space(config) ? product(motion->axis[j], motion->axis[i]) : 1.0;
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
static double effect_at_end(const zygos_joint_t *self, const zygos_config_t *config, uint32_t e)
{
    const uint32_t i = config->effect[e].joint;
    const double rigid = (config->joint[i].rigid != 0) ? config->joint[i].gear_ratio : 0.0;
    switch ((enum zygos_effect_kind)config->effect[e].kind) {
    case ZYGOS_MOTOR_VISCOUS:
        return rigid * self->state.theta[i];
    case ZYGOS_TORQUE_LAG:
        return rigid * self->torque_mean[i];
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

static void add_scaled(double *restrict to, const double *restrict from, double factor, uint32_t count)
{
    for (uint32_t k = 0; k < count; k++) {
        to[k] += factor * from[k];
    }
}

/* Adds the integrands of this instant to the half with the first weight, and to the next with the second. */
static void integrate(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                      zygos_joint_integrals_t *const half[2], const double *weight)
{
    const uint32_t sides = (self->position + 3u > config->joint_row_cycles / 2u) ? 2u : 1u;
    for (uint32_t j = 0; j < config->joints; j++) {
        double force[ZYGOS_MAX_BODY + ZYGOS_MAX_JOINTS];
        zygos_kinematics_slopes(geometry, config, motion, j, force, NULL);
        for (uint32_t k = column_map->kinetic; k < column_map->body; k++) {
            force[k] = -force[k]; /* the potential energy */
        }
        for (uint32_t i = 0; i < config->joints; i++) {
            force[column_map->body + i] = (i > j) ? rotor_force(config, state, motion, j, i) : 0.0;
        }
        for (uint32_t s = 0; s < sides; s++) {
            add_scaled(half[s]->force[j], force, weight[s], column_map->body + config->joints);
            half[s]->deflection[j] += weight[s] * (state->theta[j] - state->q[j]);
        }
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        const double integrand = effect_integrand(config, e, state);
        for (uint32_t s = 0; s < sides; s++) {
            half[s]->effect[e] += weight[s] * integrand;
        }
    }
}

/* p_j of the motion at the newest end. */
static void momentum_of(const zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                        uint32_t j, double *out)
{
    const zygos_motion_t *motion = &self->motion;
    double moved[ZYGOS_MAX_DIRECTIONS][3];
    zygos_kinematics_swing(config, motion, motion->axis[j], j + 1u, moved);
    memset(out, 0, (column_map->body + config->joints) * sizeof out[0]);
    (void)zygos_kinetic_products(config, motion->rate, (const double(*)[3])moved, out);
    (void)zygos_kinetic_products(config, (const double(*)[3])moved, motion->rate, out);
    for (uint32_t i = j; i < config->joints; i++) {
        const double spin = config->joint[i].gear_ratio * self->state.theta_rate[i];
        const double own = config->joint[i].gear_ratio * (spin + motion->carrier_rate[i]);
        const double rigid = (config->joint[j].rigid != 0) ? 1.0 : 0.0;
        out[column_map->body + i] = (i > j) ? spin * along(config, motion, j, i) : rigid * own;
    }
}

/* Forms the row of a joint; its end and its integrals make room for the next. */
static void form_row(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                     uint32_t j, zygos_joint_row_t *out)
{
    const double h = config->period_s / INNER;
    const double h12 = zygos_effects_jump(config);
    const uint32_t body = column_map->body;
    zygos_joint_integrals_t *older = &self->half[self->oldest];
    const zygos_joint_integrals_t *newer = &self->half[after(self->oldest)];
    zygos_joint_end_t *begin = &self->ends[self->newest][j];
    zygos_joint_end_t end = { 0 }; /* copied whole below: unused entries are no remains of the stack */
    const bool rigid = (config->joint[j].rigid != 0);
    momentum_of(self, config, column_map, j, end.momentum);
    end.deflection = self->state.theta[j] - self->state.q[j];
    end.impulse = rigid ? config->joint[j].gear_ratio * h12 * self->jump[j] : 0.0;
    memset(out->column, 0, column_map->count * sizeof out->column[0]);
    for (uint32_t k = 0; k < body; k++) {
        out->column[k] = end.momentum[k] - begin->momentum[k] - h * (older->force[j][k] + newer->force[j][k]);
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        if (column_map->rotor[i]) {
            const uint32_t k = body + i;
            out->column[column_map->joint[i]] =
                end.momentum[k] - begin->momentum[k] - h * (older->force[j][k] + newer->force[j][k]);
        }
    }
    if (!rigid) {
        double *spring = &out->column[column_map->joint[j] + column_map->rotor[j]];
        spring[0] = -h * (older->deflection[j] + newer->deflection[j]);
        spring[1] = begin->deflection - end.deflection;
    }
    const double impulse = rigid ? config->joint[j].gear_ratio * config->period_s : 0.0;
    out->impulse = impulse * (older->impulse[j] + newer->impulse[j]) + end.impulse - begin->impulse;
    for (uint32_t e = 0; e < (uint32_t)ZYGOS_EFFECT_PLACES; e++) {
        end.effect[e] = 0.0;
        if ((e < config->effects) && (config->effect[e].joint == j)) {
            end.effect[e] = effect_at_end(self, config, e);
            const double gain = (config->effect[e].kind == ZYGOS_TORQUE_GAIN) ? out->impulse : 0.0;
            out->column[column_map->effects + e] =
                end.effect[e] - begin->effect[e] + h * (older->effect[e] + newer->effect[e]) - gain;
            older->effect[e] = 0.0;
        }
    }
    out->accepted = (older->refused[j] + newer->refused[j] > 0.0) ? 0.0 : 1.0;
    out->joint = j;
    out->last = (j + 1u == config->joints) ? 1u : 0u;
    *begin = end;
    memset(older->force[j], 0, (body + config->joints) * sizeof older->force[j][0]);
    older->impulse[j] = 0.0;
    older->deflection[j] = 0.0;
    older->refused[j] = 0.0;
}

int zygos_joint_row(zygos_joint_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                    const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                    const double *tau_before, const double *tau, zygos_joint_row_t *out)
{
    const uint32_t cycles = config->joint_row_cycles / 2u;
    const uint32_t n = config->joints;
    bool formed = false;
    /* The row first: its older half becomes the one after that which is being filled. */
    if (self->turn < n) {
        form_row(self, config, column_map, self->turn, out);
        self->turn++;
        formed = (self->halves == 3u);
        self->newest ^= (self->turn == n) ? 1u : 0u;
    }
    zygos_joint_integrals_t *const half[2] = { &self->half[after(after(self->oldest))], &self->half[self->oldest] };
    self->position++;
    const uint32_t left = cycles - self->position;
    const double weight[2] = { (left < 3u) ? ending[2u - left] : INNER, (left < 3u) ? beginning[2u - left] : 0.0 };
    integrate(self, config, column_map, geometry, state, motion, half, weight);
    for (uint32_t j = 0; j < n; j++) {
        half[0]->impulse[j] += tau_before[j];
        half[0]->refused[j] += 1.0 - state->accepted;
    }
    if (left > 0) {
        return formed ? 1 : 0;
    }
    for (uint32_t j = 0; j < n; j++) {
        half[1]->refused[j] += 1.0 - state->accepted; /* it is the first of the next half as well */
        self->jump[j] = tau[j] - tau_before[j];
        self->torque_mean[j] = 0.5 * (tau[j] + tau_before[j]);
    }
    self->state = *state;
    self->motion = *motion;
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

void zygos_joint_derivative(const zygos_joint_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map, uint32_t joint, uint32_t signal, double *out,
                            double *rotor)
{
    const uint32_t n = config->joints;
    const bool of_link = (signal < n);
    const bool rigid = (config->joint[joint].rigid != 0);
    const zygos_motion_t *motion = &self->motion;
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
            const double carried = of_link ? ((signal < joint) ? along(config, motion, signal, joint) : 0.0)
                                           : (in_space(config) ? product(axis, motion->axis[joint]) : 1.0);
            *column = ratio * (((signal == joint) ? ratio : 0.0) + carried);
        }
    }
}
