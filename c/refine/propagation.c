/* SPDX-License-Identifier: MIT */
#include "zygos/priv/propagation.h"

#include "zygos/priv/numbers.h"

#include <string.h>

/* A vector in each body, such as the change of its angular velocity. */
typedef double bodies_t[ZYGOS_MAX_JOINTS + 1][3];
typedef double directions_t[ZYGOS_MAX_DIRECTIONS][3];

static void add(double *out, double factor, const double *a)
{
    out[0] += factor * a[0];
    out[1] += factor * a[1];
    out[2] += factor * a[2];
}

static void add_cross(double *out, const double *a, const double *b)
{
    double product[3];
    zygos_cross3(a, b, product);
    add(out, 1.0, product);
}

/* The index of direction `side` of a body. */
static uint8_t direction_of(const zygos_propagation_t *self, uint32_t body, uint32_t side)
{
    uint32_t at = 0;
    while ((at + 1u < self->directions) && (self->body[at] != body)) {
        at++;
    }
    return (uint8_t)(at + side);
}

static void add_product(zygos_propagation_t *self, uint32_t first, uint32_t second, double sign)
{
    self->first[self->pairs] = (uint8_t)first;
    self->second[self->pairs] = (uint8_t)second;
    self->sign[self->pairs] = sign;
    self->pairs++;
}

static void spatial_pairs(zygos_propagation_t *self, bool floats)
{
    for (uint32_t a = 0; a < self->directions; a++) {
        for (uint32_t b = a; b < self->directions; b++) {
            /* body 1 on a fixed base turns about its axis only: two of its three entries have no column */
            if (floats || (b > 1u) || (b == 0u) || (a > 1u)) {
                add_product(self, a, b, 1.0);
            }
        }
    }
}

static void planar_pairs(zygos_propagation_t *self, const zygos_config_t *config, uint32_t first)
{
    for (uint32_t i = first; i <= config->joints; i++) {
        for (uint32_t j = i; j <= config->joints; j++) {
            add_product(self, direction_of(self, i, 0), direction_of(self, j, 0), 1.0);
        }
    }
    for (uint32_t i = first; (i <= config->joints) && (config->kinetic == ZYGOS_PLANAR); i++) {
        for (uint32_t j = i + 1u; j <= config->joints; j++) {
            add_product(self, direction_of(self, i, 1), direction_of(self, j, 0), self->geometry.handedness[0]);
        }
    }
}

static bool is_flexible(const zygos_config_t *config)
{
    bool all = true;
    for (uint32_t i = 0; i < config->joints; i++) {
        all = all && (config->joint[i].rigid == 0u);
    }
    return all;
}

/* The bodies that the directions are fixed to: three of the base of a spatial arm, two of a body where its centre of
   mass may lie beside the line between its joints, or gravity acts on it. */
static void list_directions(zygos_propagation_t *self, const zygos_config_t *config)
{
    const bool spatial = (config->kinetic == ZYGOS_SPATIAL_ARM);
    uint32_t gravity = 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        gravity |= self->geometry.has_gravity[i];
    }
    const uint32_t sides = (spatial || (config->kinetic == ZYGOS_PLANAR) || (gravity != 0u)) ? 2u : 1u;
    for (uint32_t i = (config->base == ZYGOS_BASE_FREE) ? 0u : 1u; i <= config->joints; i++) {
        const uint32_t count = (spatial && (i == 0u)) ? 3u : sides;
        for (uint32_t k = 0; k < count; k++) {
            self->body[self->directions] = (uint8_t)i;
            self->directions++;
        }
    }
}

int zygos_propagation_init(zygos_propagation_t *self, const zygos_config_t *config, uint32_t steps, uint32_t friction)
{
    const bool floats = (config->base == ZYGOS_BASE_FREE);
    const bool spatial = (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t n = config->joints;
    if (!is_flexible(config) || (steps < 1u) || (steps > 1000u) || (friction > 1u)) {
        return ZYGOS_E_VALUE;
    }
    memset(self, 0, sizeof *self);
    zygos_geometry_init(&self->geometry, config);
    zygos_balance_column_map(config, &self->column_map);
    self->base_rates = floats ? (spatial ? 3u : 1u) : 0u;
    self->moving = self->base_rates + 4u * n;
    self->parameters = self->column_map.reduced;
    self->steps = steps;
    self->friction = friction;
    list_directions(self, config);
    if (spatial) {
        spatial_pairs(self, floats);
    } else {
        planar_pairs(self, config, floats ? 0u : 1u);
    }
    for (uint32_t i = 0; i < n; i++) {
        for (uint32_t k = 0; (k < 2u) && (self->geometry.has_gravity[i] != 0u); k++) {
            self->moment[self->moments] = direction_of(self, i + 1u, k);
            self->moments++;
        }
    }
    return 1;
}

void zygos_dynamics_set(zygos_dynamics_t *out, const zygos_propagation_t *self, const zygos_config_t *config,
                        const double *constants)
{
    double full[ZYGOS_MAX_COLUMNS] = { 0.0 };
    if (config->reduced == 0u) {
        memcpy(full, constants, self->parameters * sizeof full[0]);
    } else {
        for (uint32_t k = 0; k < config->reductions; k++) {
            const zygos_reduction_t *entry = &config->reduction[k];
            full[entry->column] += entry->factor * constants[entry->parameter];
        }
    }
    memset(out, 0, sizeof *out);
    for (uint32_t k = 0; k < self->pairs; k++) {
        out->matrix[self->first[k]][self->second[k]] = self->sign[k] * full[k];
        out->matrix[self->second[k]][self->first[k]] = self->sign[k] * full[k];
    }
    for (uint32_t k = 0; k < self->moments; k++) {
        out->moment[self->moment[k]] = full[self->pairs + k];
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const double *own = &full[self->column_map.joint[i]];
        out->rotor[i] = own[0];
        out->stiffness[i] = own[1];
        out->damping[i] = own[2];
        out->friction[i] = (self->friction != 0u) ? constants[self->parameters + i] : 0.0;
    }
}

/* Axes and directions at the angles of a state. */
static void place(const zygos_propagation_t *self, const zygos_config_t *config, const double *q,
                  zygos_propagation_work_t *work)
{
    double attitude[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    const bool spatial = (config->kinetic == ZYGOS_SPATIAL_ARM);
    uint32_t at = 0;
    memset(work->base_axis, 0, sizeof work->base_axis);
    if (spatial) {
        for (uint32_t k = 0; k < 3u; k++) {
            work->base_axis[k][k] = 1.0;
        }
    } else {
        memcpy(work->base_axis[0], config->joint[0].axis, sizeof work->base_axis[0]);
    }
    for (; (at < self->directions) && (self->body[at] == 0u); at++) {
        for (uint32_t k = 0; k < 3u; k++) {
            work->direction[at][k] = spatial ? work->base_axis[at][k] : self->geometry.rotation[0][3u * k + at];
        }
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const double *mount = self->geometry.rotation[i];
        double s;
        double c;
        double carried[9];
        memcpy(carried, attitude, sizeof carried);
        zygos_sincos(q[i], &s, &c);
        s *= self->geometry.handedness[i];
        for (uint32_t row = 0; row < 3u; row++) {
            double mixed[3];
            for (uint32_t column = 0; column < 3u; column++) {
                mixed[column] = carried[3u * row] * mount[column] + carried[3u * row + 1u] * mount[3u + column] +
                                carried[3u * row + 2u] * mount[6u + column];
            }
            attitude[3u * row] = c * mixed[0] + s * mixed[1];
            attitude[3u * row + 1u] = c * mixed[1] - s * mixed[0];
            attitude[3u * row + 2u] = mixed[2];
            work->axis[i][row] = mixed[2];
        }
        for (uint32_t k = 0; (at < self->directions) && (self->body[at] == i + 1u); k++, at++) {
            for (uint32_t row = 0; row < 3u; row++) {
                work->direction[at][row] = attitude[3u * row + k];
            }
        }
    }
}

/* out_a = sum N_ab in_b; in_b is zero for b < from. */
static void weigh_directions(const zygos_propagation_t *self, const zygos_dynamics_t *dynamics, uint32_t from,
                             const double (*in)[3], double (*out)[3])
{
    for (uint32_t a = 0; a < self->directions; a++) {
        const double *row = dynamics->matrix[a];
        double x = 0.0;
        double y = 0.0;
        double z = 0.0;
        for (uint32_t b = from; b < self->directions; b++) {
            x += row[b] * in[b][0];
            y += row[b] * in[b][1];
            z += row[b] * in[b][2];
        }
        out[a][0] = x;
        out[a][1] = y;
        out[a][2] = z;
    }
}

/* Adds direction x force of each direction to the torque of its body. */
static void turn(const zygos_propagation_t *self, const double (*direction)[3], const double (*force)[3],
                 double (*torque)[3])
{
    for (uint32_t a = 0; a < self->directions; a++) {
        add_cross(torque[self->body[a]], direction[a], force[a]);
    }
}

/* out[0 .. W + N - 1]: what base and joints take of torques on the bodies. beyond: of each joint their sum. */
static void project(const zygos_propagation_t *self, uint32_t n, const zygos_propagation_work_t *work,
                    const double (*torque)[3], double (*beyond)[3], double *out)
{
    double sum[3] = { 0.0, 0.0, 0.0 };
    for (uint32_t i = n; i > 0u; i--) {
        add(sum, 1.0, torque[i]);
        memcpy(beyond[i - 1u], sum, sizeof sum);
        out[self->base_rates + i - 1u] = zygos_dot3(work->axis[i - 1u], sum);
    }
    add(sum, 1.0, torque[0]);
    for (uint32_t k = 0; k < self->base_rates; k++) {
        out[k] = zygos_dot3(work->base_axis[k], sum);
    }
}

/* Replaces the inertia matrix by the factor L of L L', where rotors are free. Returns false where it is not positive
 * definite. */
static bool factorise_inertia(const zygos_dynamics_t *dynamics, uint32_t n, uint32_t size,
                              zygos_propagation_work_t *work)
{
    for (uint32_t v = 0; v < size; v++) {
        for (uint32_t u = 0; u <= v; u++) {
            double sum = work->mass[v][u];
            for (uint32_t i = 0; i < n; i++) {
                sum -= dynamics->rotor[i] * work->along[i][v] * work->along[i][u];
            }
            for (uint32_t k = 0; k < u; k++) {
                sum -= work->mass[v][k] * work->mass[u][k];
            }
            if (u < v) {
                work->mass[v][u] = sum / work->mass[u][u];
            } else if (sum > 0.0) {
                work->mass[v][v] = __builtin_sqrt(sum);
            } else {
                return false;
            }
        }
        if ((v < n) && !(dynamics->rotor[v] > 0.0)) {
            return false;
        }
    }
    return true;
}

/* The inertia matrix of base and joints, factorised. Returns false where it is not positive definite. */
static bool inertia(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                    zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t size = self->base_rates + n;
    for (uint32_t u = 0; u < size; u++) {
        const bool of_base = (u < self->base_rates);
        const uint32_t joint = of_base ? 0u : u - self->base_rates;
        const double *w = of_base ? work->base_axis[u] : work->axis[joint];
        const uint32_t moved = of_base ? 0u : joint + 1u;
        directions_t change = { { 0.0 } }; /* gcc does not see that each of its used rows is set */
        directions_t force;
        bodies_t torque = { { 0.0 } };
        bodies_t beyond;
        double column[ZYGOS_MAX_JOINTS + 3];
        uint32_t from = 0;
        for (uint32_t a = 0; a < self->directions; a++) {
            from += (self->body[a] < moved) ? 1u : 0u;
            zygos_cross3(w, work->direction[a], change[a]);
        }
        weigh_directions(self, dynamics, from, (const double(*)[3])change, force);
        turn(self, (const double(*)[3])work->direction, (const double(*)[3])force, torque);
        project(self, n, work, (const double(*)[3])torque, beyond, column);
        for (uint32_t i = 0; i < n; i++) {
            work->along[i][u] = (i >= moved) ? zygos_dot3(work->axis[i], w) : 0.0;
        }
        for (uint32_t v = 0; v < size; v++) {
            work->mass[v][u] = column[v];
        }
    }
    return factorise_inertia(dynamics, n, size, work);
}

/* Replaces a residual of base, joints and rotors by minus the accelerations that it takes to balance it. */
static void solve(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                  const zygos_propagation_work_t *work, double *x)
{
    const uint32_t n = config->joints;
    const uint32_t size = self->base_rates + n;
    double *rotor = &x[size];
    for (uint32_t i = 0; i < n; i++) {
        const double share = rotor[i] / config->joint[i].gear_ratio;
        for (uint32_t u = 0; u < size; u++) {
            x[u] -= work->along[i][u] * share;
        }
    }
    for (uint32_t v = 0; v < size; v++) {
        double sum = x[v];
        for (uint32_t k = 0; k < v; k++) {
            sum -= work->mass[v][k] * x[k];
        }
        x[v] = sum / work->mass[v][v];
    }
    for (uint32_t v = size; v > 0u; v--) {
        double sum = x[v - 1u];
        for (uint32_t k = v; k < size; k++) {
            sum -= work->mass[k][v - 1u] * x[k];
        }
        x[v - 1u] = sum / work->mass[v - 1u][v - 1u];
    }
    for (uint32_t i = 0; i < n; i++) {
        const double ratio = config->joint[i].gear_ratio;
        double turned = 0.0;
        for (uint32_t u = 0; u < size; u++) {
            turned += work->along[i][u] * x[u];
        }
        rotor[i] = (rotor[i] / (ratio * dynamics->rotor[i]) - turned) / ratio;
    }
    for (uint32_t k = 0; k < size + n; k++) {
        x[k] = -x[k];
    }
}

/* Coulomb friction for a coefficient of 1, and its slope. */
static double friction_sign(double rate, double *slope)
{
    const double share = rate / ZYGOS_SLOWEST_RATE;
    const bool slow = (share > -1.0) && (share < 1.0);
    *slope = slow ? 1.0 / ZYGOS_SLOWEST_RATE : 0.0;
    return slow ? share : ((share > 0.0) ? 1.0 : -1.0);
}

/* Angular velocities, and angular accelerations without those of base and joints. */
static void spin_bodies(const zygos_propagation_t *self, uint32_t n, const double *state,
                        zygos_propagation_work_t *work)
{
    const double *q_rate = &state[self->base_rates + 2u * n];
    memset(work->omega, 0, sizeof work->omega);
    memset(work->spin, 0, sizeof work->spin);
    for (uint32_t k = 0; k < self->base_rates; k++) {
        add(work->omega[0], state[k], work->base_axis[k]);
    }
    for (uint32_t i = 0; i < n; i++) {
        zygos_cross3(work->omega[i], work->axis[i], work->lean[i]);
        memcpy(work->omega[i + 1u], work->omega[i], sizeof work->omega[0]);
        add(work->omega[i + 1u], q_rate[i], work->axis[i]);
        memcpy(work->spin[i + 1u], work->spin[i], sizeof work->spin[0]);
        add(work->spin[i + 1u], q_rate[i], work->lean[i]);
    }
}

/* Adds the angular accelerations of base and joints. */
static void add_accelerations(uint32_t n, uint32_t w, zygos_propagation_work_t *work)
{
    for (uint32_t k = 0; k < w; k++) {
        add(work->spin[0], work->y[k], work->base_axis[k]);
    }
    for (uint32_t i = 1; i <= n; i++) {
        for (uint32_t k = 0; k < w; k++) {
            add(work->spin[i], work->y[k], work->base_axis[k]);
        }
        for (uint32_t k = 0; k < i; k++) {
            add(work->spin[i], work->y[w + k], work->axis[k]);
        }
    }
}

/* Accelerations of directions, the forces that they and gravity take, and the torques of these on the bodies, which are
 * added. swing: what angular velocities alone do. */
static void load_bodies(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                        const double (*swing)[3], double (*load)[3], zygos_propagation_work_t *work)
{
    for (uint32_t a = 0; a < self->directions; a++) {
        memcpy(work->acceleration[a], swing[a], sizeof work->acceleration[a]);
        add_cross(work->acceleration[a], work->spin[self->body[a]], work->direction[a]);
    }
    weigh_directions(self, dynamics, 0, (const double(*)[3])work->acceleration, work->force);
    for (uint32_t a = 0; a < self->directions; a++) {
        add(work->force[a], -dynamics->moment[a], config->gravity);
    }
    turn(self, (const double(*)[3])work->direction, (const double(*)[3])work->force, load);
}

/* The accelerations y, with all that derivatives need of the motion. */
static void accelerate(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                       const double *state, const double *torque, zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    const double *q = &state[w];
    const double *q_rate = &state[w + 2u * n];
    const double *theta_rate = &state[w + 3u * n];
    bodies_t load = { { 0.0 } };
    bodies_t beyond;
    directions_t swing;

    spin_bodies(self, n, state, work);
    for (uint32_t a = 0; a < self->directions; a++) {
        const double *omega = work->omega[self->body[a]];
        double rate[3];
        zygos_cross3(omega, work->direction[a], rate);
        zygos_cross3(omega, rate, swing[a]);
    }
    load_bodies(self, config, dynamics, (const double(*)[3])swing, load, work);
    for (uint32_t i = 0; i < n; i++) {
        add(load[i], dynamics->rotor[i] * config->joint[i].gear_ratio * theta_rate[i], work->lean[i]);
    }
    project(self, n, work, (const double(*)[3])load, beyond, work->y);
    for (uint32_t i = 0; i < n; i++) {
        const double ratio = config->joint[i].gear_ratio;
        const double spring =
            dynamics->stiffness[i] * (q[n + i] - q[i]) + dynamics->damping[i] * (theta_rate[i] - q_rate[i]);
        double slope;
        const double drive = torque[i] - dynamics->friction[i] * friction_sign(theta_rate[i], &slope);
        work->y[w + i] -= spring;
        work->y[w + n + i] =
            dynamics->rotor[i] * ratio * zygos_dot3(work->axis[i], work->spin[i]) + spring - ratio * drive;
    }
    solve(self, config, dynamics, work, work->y);
    add_accelerations(n, w, work);
    memset(work->load, 0, sizeof work->load);
    load_bodies(self, config, dynamics, (const double(*)[3])swing, work->load, work);
    for (uint32_t i = 0; i < n; i++) {
        const double geared = dynamics->rotor[i] * config->joint[i].gear_ratio;
        add(work->load[i], geared * work->y[w + n + i], work->axis[i]);
        add(work->load[i], geared * theta_rate[i], work->lean[i]);
    }
}

/* Puts a column of accelerations into by_state. */
static void put_state(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                      uint32_t place_of, double *column, zygos_propagation_work_t *work)
{
    solve(self, config, dynamics, work, column);
    for (uint32_t k = 0; k < self->base_rates + 2u * config->joints; k++) {
        work->by_state[k][place_of] = column[k];
    }
}

/* Residuals of a spring of joint i with this stiffness, or damping, by the link's side; those by the motor's are
 * opposite. */
static void by_spring(const zygos_propagation_t *self, uint32_t n, uint32_t i, double stiffness, double *column)
{
    column[self->base_rates + i] += stiffness;
    column[self->base_rates + n + i] -= stiffness;
}

/* What turns with a joint: its axes, and the angular velocities, accelerations and torques of its bodies. */
typedef struct {
    bodies_t tilt;
    bodies_t faster;
    bodies_t later;
    bodies_t torque;
} turned_t;

/* By the angle of joint m. */
static void turn_bodies(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                        const double *state, uint32_t m, const zygos_propagation_work_t *work, turned_t *out)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    const double *q_rate = &state[w + 2u * n];
    const double *theta_rate = &state[w + 3u * n];
    for (uint32_t k = m; k < n; k++) {
        double *tilt = out->tilt[k];
        double bend[3];
        zygos_cross3(work->axis[m], work->axis[k], tilt);
        zygos_cross3(out->faster[k], work->axis[k], bend);
        add_cross(bend, work->omega[k], tilt);
        memcpy(out->faster[k + 1u], out->faster[k], sizeof out->faster[k]);
        add(out->faster[k + 1u], q_rate[k], tilt);
        memcpy(out->later[k + 1u], out->later[k], sizeof out->later[k]);
        add(out->later[k + 1u], work->y[w + k], tilt);
        add(out->later[k + 1u], q_rate[k], bend);
        const double geared = dynamics->rotor[k] * config->joint[k].gear_ratio;
        add(out->torque[k], geared * work->y[w + n + k], tilt);
        add(out->torque[k], geared * theta_rate[k], bend);
    }
}

static void by_angle(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                     const double *state, uint32_t m, zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    turned_t turned = { 0 };
    bodies_t beyond;
    directions_t shift;
    directions_t change;
    directions_t force;
    double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
    uint32_t from = 0;
    turn_bodies(self, config, dynamics, state, m, work, &turned);
    for (uint32_t a = 0; a < self->directions; a++) {
        const uint32_t body = self->body[a];
        if (body <= m) {
            from++;
            continue;
        }
        const double *rho = work->direction[a];
        const double *omega = work->omega[body];
        double rate[3];
        double mixed[3];
        zygos_cross3(work->axis[m], rho, shift[a]);
        zygos_cross3(turned.later[body], rho, change[a]);
        add_cross(change[a], work->spin[body], shift[a]);
        zygos_cross3(omega, rho, rate);
        add_cross(change[a], turned.faster[body], rate);
        zygos_cross3(turned.faster[body], rho, mixed);
        add_cross(mixed, omega, shift[a]);
        add_cross(change[a], omega, mixed);
        add_cross(turned.torque[body], shift[a], work->force[a]);
    }
    weigh_directions(self, dynamics, from, (const double(*)[3])change, force);
    turn(self, (const double(*)[3])work->direction, (const double(*)[3])force, turned.torque);
    project(self, n, work, (const double(*)[3])turned.torque, beyond, column);
    double sum[3] = { 0.0, 0.0, 0.0 };
    for (uint32_t k = n; k > m; k--) {
        /* an axis that is turned takes another component of the load beyond it */
        add(sum, 1.0, work->load[k]);
        column[w + k - 1u] += zygos_dot3(turned.tilt[k - 1u], sum);
    }
    for (uint32_t k = m; k < n; k++) {
        const double geared = dynamics->rotor[k] * config->joint[k].gear_ratio;
        column[w + n + k] +=
            geared * (zygos_dot3(turned.tilt[k], work->spin[k]) + zygos_dot3(work->axis[k], turned.later[k]));
    }
    by_spring(self, n, m, dynamics->stiffness[m], column);
    put_state(self, config, dynamics, w + m, column, work);
}

/* By the rate u of base and joints. */
static void by_rate(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                    const double *state, uint32_t u, zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    const bool of_base = (u < w);
    const uint32_t joint = of_base ? 0u : u - w;
    const uint32_t moved = of_base ? 0u : joint + 1u;
    const double *own = of_base ? work->base_axis[u] : work->axis[joint];
    const double *q_rate = &state[w + 2u * n];
    const double *theta_rate = &state[w + 3u * n];
    bodies_t later = { { 0.0 } };
    bodies_t torque = { { 0.0 } };
    bodies_t beyond;
    directions_t change;
    directions_t force;
    double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
    uint32_t from = 0;
    if (!of_base) {
        memcpy(later[joint + 1u], work->lean[joint], sizeof later[0]);
    }
    for (uint32_t k = moved; k < n; k++) {
        double bend[3];
        zygos_cross3(own, work->axis[k], bend);
        memcpy(later[k + 1u], later[k], sizeof later[k]);
        add(later[k + 1u], q_rate[k], bend);
        add(torque[k], dynamics->rotor[k] * config->joint[k].gear_ratio * theta_rate[k], bend);
    }
    for (uint32_t a = 0; a < self->directions; a++) {
        const uint32_t body = self->body[a];
        if (body < moved) {
            from++;
            continue;
        }
        const double *rho = work->direction[a];
        const double *omega = work->omega[body];
        double rate[3];
        double mixed[3];
        zygos_cross3(later[body], rho, change[a]);
        zygos_cross3(omega, rho, rate);
        add_cross(change[a], own, rate);
        zygos_cross3(own, rho, mixed);
        add_cross(change[a], omega, mixed);
    }
    weigh_directions(self, dynamics, from, (const double(*)[3])change, force);
    turn(self, (const double(*)[3])work->direction, (const double(*)[3])force, torque);
    project(self, n, work, (const double(*)[3])torque, beyond, column);
    for (uint32_t k = moved; k < n; k++) {
        column[w + n + k] += dynamics->rotor[k] * config->joint[k].gear_ratio * zygos_dot3(work->axis[k], later[k]);
    }
    if (!of_base) {
        by_spring(self, n, joint, dynamics->damping[joint], column);
    }
    put_state(self, config, dynamics, of_base ? u : w + 2u * n + joint, column, work);
}

/* By angle, rate and torque of motor i. */
static void by_motor(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                     const double *state, uint32_t i, zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    const double ratio = config->joint[i].gear_ratio;
    double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
    double slope;
    const double sign = friction_sign(state[w + 3u * n + i], &slope);
    by_spring(self, n, i, -dynamics->stiffness[i], column);
    put_state(self, config, dynamics, w + n + i, column, work);

    memset(column, 0, sizeof column);
    bodies_t torque = { { 0.0 } };
    bodies_t beyond;
    add(torque[i], dynamics->rotor[i] * ratio, work->lean[i]);
    project(self, n, work, (const double(*)[3])torque, beyond, column);
    by_spring(self, n, i, -dynamics->damping[i], column);
    column[w + n + i] += ratio * dynamics->friction[i] * slope;
    put_state(self, config, dynamics, w + 3u * n + i, column, work);

    memset(column, 0, sizeof column);
    column[w + n + i] = -ratio;
    solve(self, config, dynamics, work, column);
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        work->by_torque[k][i] = column[k];
        if (self->friction != 0u) {
            work->by_constant[k][self->parameters + i] = -sign * column[k];
        }
    }
}

/* Adds the component of a torque on a body that base and joints take. */
static void add_component(const zygos_propagation_t *self, const zygos_propagation_work_t *work, uint32_t body,
                          const double *torque, double *column)
{
    for (uint32_t k = 0; k < self->base_rates; k++) {
        column[k] += zygos_dot3(work->base_axis[k], torque);
    }
    for (uint32_t k = 0; k < body; k++) {
        column[self->base_rates + k] += zygos_dot3(work->axis[k], torque);
    }
}

/* Adds what a column stands for to the derivatives by the parameters. next: the first entry of the reduction that has
 * not been read. */
static void put_constant(const zygos_propagation_t *self, const zygos_config_t *config,
                         const zygos_dynamics_t *dynamics, uint32_t at, double *column, uint32_t *next,
                         zygos_propagation_work_t *work)
{
    const uint32_t count = self->base_rates + 2u * config->joints;
    solve(self, config, dynamics, work, column);
    if (config->reduced == 0u) {
        for (uint32_t k = 0; k < count; k++) {
            work->by_constant[k][at] = column[k];
        }
        return;
    }
    for (; (*next < config->reductions) && (config->reduction[*next].column <= at); (*next)++) {
        const zygos_reduction_t *entry = &config->reduction[*next];
        for (uint32_t k = 0; k < count; k++) {
            work->by_constant[k][entry->parameter] += entry->factor * column[k];
        }
    }
}

static void by_parameters(const zygos_propagation_t *self, const zygos_config_t *config,
                          const zygos_dynamics_t *dynamics, const double *state, zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    uint32_t next = 0;
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        memset(work->by_constant[k], 0, self->parameters * sizeof work->by_constant[k][0]);
    }
    for (uint32_t c = 0; c < self->pairs; c++) {
        const uint32_t a = self->first[c];
        const uint32_t b = self->second[c];
        double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
        double torque[3];
        zygos_cross3(work->direction[a], work->acceleration[b], torque);
        add_component(self, work, self->body[a], torque, column);
        if (a != b) {
            zygos_cross3(work->direction[b], work->acceleration[a], torque);
            add_component(self, work, self->body[b], torque, column);
        }
        for (uint32_t k = 0; k < w + n; k++) {
            column[k] *= self->sign[c];
        }
        put_constant(self, config, dynamics, c, column, &next, work);
    }
    for (uint32_t c = 0; c < self->moments; c++) {
        const uint32_t a = self->moment[c];
        double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
        double torque[3];
        zygos_cross3(config->gravity, work->direction[a], torque);
        add_component(self, work, self->body[a], torque, column);
        put_constant(self, config, dynamics, self->pairs + c, column, &next, work);
    }
    for (uint32_t i = 0; i < n; i++) {
        const double ratio = config->joint[i].gear_ratio;
        const double *angle = &state[w];
        const double *rate = &state[w + 2u * n];
        double column[ZYGOS_MAX_ACCELERATIONS] = { 0.0 };
        double torque[3] = { 0.0, 0.0, 0.0 };
        add(torque, ratio * work->y[w + n + i], work->axis[i]);
        add(torque, ratio * rate[n + i], work->lean[i]);
        add_component(self, work, i, torque, column);
        column[w + n + i] = ratio * (ratio * work->y[w + n + i] + zygos_dot3(work->axis[i], work->spin[i]));
        put_constant(self, config, dynamics, self->column_map.joint[i], column, &next, work);
        for (uint32_t k = 0; k < 2u; k++) {
            memset(column, 0, sizeof column);
            by_spring(self, n, i, (k == 0u) ? angle[i] - angle[n + i] : rate[i] - rate[n + i], column);
            put_constant(self, config, dynamics, self->column_map.joint[i] + 1u + k, column, &next, work);
        }
    }
}

bool zygos_propagation_slopes(const zygos_propagation_t *self, const zygos_config_t *config,
                              const zygos_dynamics_t *dynamics, const double *state, const double *torque,
                              zygos_propagation_work_t *work)
{
    place(self, config, &state[self->base_rates], work);
    if (!inertia(self, config, dynamics, work)) {
        return false;
    }
    accelerate(self, config, dynamics, state, torque, work);
    for (uint32_t i = 0; i < config->joints; i++) {
        by_angle(self, config, dynamics, state, i, work);
        by_motor(self, config, dynamics, state, i, work);
    }
    for (uint32_t u = 0; u < self->base_rates + config->joints; u++) {
        by_rate(self, config, dynamics, state, u, work);
    }
    by_parameters(self, config, dynamics, state, work);
    return true;
}

bool zygos_propagation_move(const zygos_propagation_t *self, const zygos_config_t *config,
                            const zygos_dynamics_t *dynamics, double time, double *state, const double *torque,
                            zygos_propagation_work_t *work)
{
    static const double share[4] = { 0.0, 0.5, 0.5, 1.0 };
    static const double weight[4] = { 1.0, 2.0, 2.0, 1.0 };
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    memset(work->rate, 0, sizeof work->rate);
    memcpy(work->sum, state, self->moving * sizeof state[0]);
    for (uint32_t part = 0; part < 4u; part++) {
        for (uint32_t i = 0; i < self->moving; i++) {
            work->stage[i] = state[i] + share[part] * time * work->rate[i];
        }
        place(self, config, &work->stage[w], work);
        if (!inertia(self, config, dynamics, work)) {
            return false;
        }
        accelerate(self, config, dynamics, work->stage, torque, work);
        memcpy(work->rate, work->y, w * sizeof work->rate[0]);
        memcpy(&work->rate[w], &work->stage[w + 2u * n], 2u * n * sizeof work->rate[0]);
        memcpy(&work->rate[w + 2u * n], &work->y[w], 2u * n * sizeof work->rate[0]);
        for (uint32_t i = 0; i < self->moving; i++) {
            work->sum[i] += time / 6.0 * weight[part] * work->rate[i];
        }
    }
    memcpy(state, work->sum, self->moving * sizeof state[0]);
    return true;
}

/* The next term of an exponential series: the derivatives by the state times the term before, times factor. */
static void next_term(const zygos_propagation_t *self, uint32_t n, double factor, const zygos_propagation_work_t *work,
                      double *term)
{
    const uint32_t w = self->base_rates;
    double next[ZYGOS_MAX_ACCELERATIONS];
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        double sum = 0.0;
        for (uint32_t i = 0; i < self->moving; i++) {
            sum += work->by_state[k][i] * term[i];
        }
        next[k] = sum;
    }
    for (uint32_t k = 0; k < 2u * n; k++) {
        term[w + k] = factor * term[w + 2u * n + k];
    }
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        term[(k < w) ? k : k + 2u * n] = factor * next[k];
    }
}

/* A torque that has the shape P(s) = sum a_i s^i, with the share s of the time that has passed, changes the state at s
   by the sum over m of term m times m! times the sum over i of a_i i! / (i + m)! s^(i + m). The coefficients of the
   shifted Legendre polynomial of degree k, by the time that is left, are a_i = (-1)^i C(k, i) C(k + i, i). */
void zygos_propagation_means(zygos_propagation_means_t *out, uint32_t cycles)
{
    double power[ZYGOS_MAX_TERMS + ZYGOS_MAX_SHAPES] = { 0.0 }; /* mean of s^m */
    for (uint32_t c = 1; c <= cycles; c++) {
        const double s = (double)c / (double)cycles;
        double product = 1.0 / (double)cycles;
        for (uint32_t m = 0; m < (uint32_t)(ZYGOS_MAX_TERMS + ZYGOS_MAX_SHAPES); m++) {
            power[m] += product;
            product *= s;
        }
    }
    memset(out, 0, sizeof *out);
    for (uint32_t m = 0; m <= (uint32_t)ZYGOS_MAX_TERMS; m++) {
        for (uint32_t k = 0; k < (uint32_t)ZYGOS_MAX_SHAPES; k++) {
            double coefficient = 1.0;
            double ratio = 1.0; /* m! i! / (i + m)! */
            for (uint32_t i = 0; i <= k; i++) {
                out->share[m][k] += coefficient * ratio * power[m + i];
                const double next = (double)(i + 1u);
                coefficient *= -(double)(k - i) * (double)(k + i + 1u) / (next * next);
                ratio *= next / (double)(m + i + 1u);
            }
        }
    }
}

void zygos_propagation_series(const zygos_propagation_t *self, const zygos_config_t *config, double time,
                              uint32_t terms, const zygos_propagation_means_t *means, uint32_t c,
                              const zygos_propagation_work_t *work, zygos_propagation_change_t *by,
                              zygos_propagation_change_t *pushed)
{
    const uint32_t moving = self->moving;
    double term[ZYGOS_MAX_MOVING] = { 0.0 };
    memset(by, 0, sizeof *by);
    memset(pushed, 0, sizeof *pushed);
    term[c] = 1.0;
    by->end[c] = 1.0;
    by->mean[c] = 1.0;
    for (uint32_t m = 1; m <= terms; m++) {
        const double factor = time / (double)m;
        const double share = means->share[m][0];
        for (uint32_t i = 0; i < moving; i++) {
            pushed->end[i] += factor * term[i];
            pushed->mean[i] += share * factor * term[i];
        }
        next_term(self, config->joints, factor, work, term);
        for (uint32_t i = 0; i < moving; i++) {
            by->end[i] += term[i];
            by->mean[i] += share * term[i];
        }
    }
}

void zygos_propagation_shapes(const zygos_propagation_t *self, const zygos_config_t *config, double time,
                              uint32_t terms, const zygos_propagation_means_t *means, uint32_t torque, uint32_t shapes,
                              const zygos_propagation_work_t *work, zygos_propagation_change_t *out)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    double term[ZYGOS_MAX_MOVING] = { 0.0 };
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        term[(k < w) ? k : k + 2u * n] = time * work->by_torque[k][torque];
    }
    memset(out, 0, shapes * sizeof out[0]);
    for (uint32_t m = 1; m <= terms; m++) {
        if (m > 1u) {
            next_term(self, n, time / (double)m, work, term);
        }
        double share = 1.0; /* m times the integral of u^(m - 1) times polynomial k over 0..1 */
        for (uint32_t k = 0; k < shapes; k++) {
            share *= (k > 0u) ? ((double)m - (double)k) / (double)(m + k) : 1.0; /* 0 from k = m on */
            for (uint32_t i = 0; i < self->moving; i++) {
                out[k].end[i] += share * term[i];
                out[k].mean[i] += means->share[m][k] * term[i];
            }
        }
    }
}

/* Time derivatives of a state and of its derivatives in stages, into rate of work and of stages. */
static bool flow(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                 const double *state, const double *torque, zygos_propagation_stages_t *stages,
                 zygos_propagation_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->base_rates;
    const uint32_t moving = self->moving;
    const uint32_t constants = self->parameters + ((self->friction != 0u) ? n : 0u);
    const uint32_t columns = moving + constants + n;
    if (!zygos_propagation_slopes(self, config, dynamics, state, torque, work)) {
        return false;
    }
    for (uint32_t k = 0; k < 2u * n; k++) {
        work->rate[w + k] = state[w + 2u * n + k];
        memcpy(stages->rate[w + k], stages->stage[w + 2u * n + k], columns * sizeof stages->rate[0][0]);
    }
    for (uint32_t k = 0; k < w + 2u * n; k++) {
        const uint32_t row = (k < w) ? k : k + 2u * n;
        double *out = stages->rate[row];
        work->rate[row] = work->y[k];
        memset(out, 0, moving * sizeof out[0]);
        memcpy(&out[moving], work->by_constant[k], constants * sizeof out[0]);
        memcpy(&out[moving + constants], work->by_torque[k], n * sizeof out[0]);
        for (uint32_t i = 0; i < moving; i++) {
            const double factor = work->by_state[k][i];
            for (uint32_t c = 0; c < columns; c++) {
                out[c] += factor * stages->stage[i][c];
            }
        }
    }
    return true;
}

bool zygos_propagate(const zygos_propagation_t *self, const zygos_config_t *config, const zygos_dynamics_t *dynamics,
                     double *state, const double *torque, double (*slope)[ZYGOS_MAX_SLOPES],
                     zygos_propagation_stages_t *stages, zygos_propagation_work_t *work)
{
    static const double share[4] = { 0.0, 0.5, 0.5, 1.0 };
    static const double weight[4] = { 1.0, 2.0, 2.0, 1.0 };
    const uint32_t moving = self->moving;
    const uint32_t columns =
        moving + self->parameters + ((self->friction != 0u) ? 2u * config->joints : config->joints);
    const double h = config->period_s / (double)self->steps;
    for (uint32_t i = 0; i < moving; i++) {
        memset(slope[i], 0, columns * sizeof slope[i][0]);
        slope[i][i] = 1.0;
    }
    for (uint32_t step = 0; step < self->steps; step++) {
        for (uint32_t i = 0; i < moving; i++) {
            work->sum[i] = state[i];
            memcpy(stages->sum[i], slope[i], columns * sizeof slope[i][0]);
        }
        for (uint32_t part = 0; part < 4u; part++) {
            for (uint32_t i = 0; i < moving; i++) {
                const double ahead = share[part] * h;
                work->stage[i] = state[i] + ((part > 0u) ? ahead * work->rate[i] : 0.0);
                for (uint32_t c = 0; c < columns; c++) {
                    stages->stage[i][c] = slope[i][c] + ((part > 0u) ? ahead * stages->rate[i][c] : 0.0);
                }
            }
            if (!flow(self, config, dynamics, work->stage, torque, stages, work)) {
                return false;
            }
            const double factor = h / 6.0 * weight[part];
            for (uint32_t i = 0; i < moving; i++) {
                work->sum[i] += factor * work->rate[i];
                for (uint32_t c = 0; c < columns; c++) {
                    stages->sum[i][c] += factor * stages->rate[i][c];
                }
            }
        }
        for (uint32_t i = 0; i < moving; i++) {
            state[i] = work->sum[i];
            memcpy(slope[i], stages->sum[i], columns * sizeof slope[i][0]);
        }
    }
    return true;
}
