/* SPDX-License-Identifier: MIT */
#include "multibody.h"

#include <math.h>
#include <string.h>

// With the directions d_a of all bodies, J_a the Jacobians of their rates and W_i those of the bodies' angular
// velocities with respect to u = (base rate, link rates), J_a' J_b = W_i' [(d_a . d_b) 1 - d_b d_a'] W_k. So the
// inertia matrix sum N_ab J_a' J_b needs of each pair of bodies one 3 x 3 matrix, and of these the sums over all bodies
// at or beyond two joints. What acts on the bodies at given rates is summed likewise.

#define SPACE 3u
#define MATRIX 9u
#define CLOCK 5u

uint64_t zygos_multibody_scratch(uint32_t joints)
{
    const uint64_t bodies = joints + 1u;
    const uint64_t directions = 2u * bodies + 1u;
    const uint64_t unknowns = SPACE + joints;
    const uint64_t state = SPACE + 4u * (uint64_t)joints;
    return MATRIX * bodies * bodies + SPACE * (directions + 4u * bodies) + MATRIX * bodies +
           unknowns * (unknowns + 1u) + 3u * (state + joints + 1u);
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void add(double out[3], double factor, const double a[3])
{
    for (uint32_t i = 0; i < SPACE; i++) {
        out[i] += factor * a[i];
    }
}

static void transform(const double matrix[9], const double a[3], double out[3])
{
    for (uint32_t i = 0; i < SPACE; i++) {
        out[i] = dot(&matrix[SPACE * i], a);
    }
}

// What is known of one state; vectors in base axes.
typedef struct {
    double *pair;      // (N+1)^2 x 9: E_ik of bodies i and k, then its sums over all bodies at or beyond i and k
    double *direction; // V x 3
    double *axis;      // (N+1) x 3: joint axes, from 1
    double *omega;     // (N+1) x 3: rates of the bodies
    double *alpha;     // (N+1) x 3: their accelerations while u stands still
    double *load;      // (N+1) x 3: torque that resists on each body, then its sums over all bodies at or beyond i
    double *swing;     // (N+1) x 9: what takes a direction of body i to its acceleration while u stands still
    double *mass;      // U x U
    double *right;     // U
} state_t;

static double *take(double **scratch, uint64_t count)
{
    double *const part = *scratch;
    *scratch += count;
    return part;
}

static state_t carve(uint32_t joints, double *scratch)
{
    const uint64_t bodies = joints + 1u;
    const uint64_t unknowns = SPACE + joints;
    state_t s;
    s.pair = take(&scratch, MATRIX * bodies * bodies);
    s.direction = take(&scratch, SPACE * (2u * bodies + 1u));
    s.axis = take(&scratch, SPACE * bodies);
    s.omega = take(&scratch, SPACE * bodies);
    s.alpha = take(&scratch, SPACE * bodies);
    s.load = take(&scratch, SPACE * bodies);
    s.swing = take(&scratch, MATRIX * bodies);
    s.mass = take(&scratch, unknowns * unknowns);
    s.right = take(&scratch, unknowns);
    return s;
}

// Axes, directions, rates, and accelerations while u stands still. tide: 3 x 3, what a field takes a mass at x from the
// mass centre to its acceleration with [1/s^2], base axes; NULL where there is none.
static void place(const zygos_multibody_t *self, const double *base_rate, const double *q, const double *rate,
                  const double *tide, const state_t *s)
{
    double attitude[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    double *direction = s->direction;
    if (self->floating) {
        memcpy(direction, attitude, sizeof attitude);
        direction += MATRIX;
    }
    memcpy(s->omega, base_rate, SPACE * sizeof base_rate[0]);
    memset(s->alpha, 0, SPACE * sizeof s->alpha[0]);
    for (uint32_t i = 1; i <= self->joints; i++) {
        const double *const turn = &self->turn[3u * MATRIX * (i - 1u)];
        const double cosine = cos(q[i - 1u]);
        const double sine = sin(q[i - 1u]);
        double carrier[9];
        memcpy(carrier, attitude, sizeof carrier);
        for (uint32_t column = 0; column < SPACE; column++) {
            double local[3];
            for (uint32_t row = 0; row < SPACE; row++) {
                const uint32_t at = SPACE * row + column;
                local[row] = turn[at] + cosine * turn[MATRIX + at] + sine * turn[2u * MATRIX + at];
            }
            for (uint32_t row = 0; row < SPACE; row++) {
                attitude[SPACE * row + column] = dot(&carrier[SPACE * row], local);
            }
        }
        double *const axis = &s->axis[SPACE * i];
        transform(attitude, &self->axis[SPACE * (i - 1u)], axis);
        for (uint32_t side = 0; side < 2; side++) {
            transform(attitude, &self->across[SPACE * (2u * (i - 1u) + side)], direction);
            direction += SPACE;
        }
        const double *const carried = &s->omega[SPACE * (i - 1u)];
        double *const omega = &s->omega[SPACE * i];
        double *const alpha = &s->alpha[SPACE * i];
        double slip[3];
        cross(carried, axis, slip);
        memcpy(omega, carried, SPACE * sizeof omega[0]);
        add(omega, rate[i - 1u], axis);
        memcpy(alpha, &s->alpha[SPACE * (i - 1u)], SPACE * sizeof alpha[0]);
        add(alpha, rate[i - 1u], slip);
    }
    for (uint32_t i = 0; i <= self->joints; i++) {
        // alpha x d + omega x (omega x d)
        const double *const w = &s->omega[SPACE * i];
        const double *const a = &s->alpha[SPACE * i];
        double *const swing = &s->swing[MATRIX * i];
        const double square = dot(w, w);
        for (uint32_t row = 0; row < SPACE; row++) {
            for (uint32_t column = 0; column < SPACE; column++) {
                swing[SPACE * row + column] = w[row] * w[column] - ((row == column) ? square : 0.0);
            }
        }
        swing[1] -= a[2];
        swing[2] += a[1];
        swing[3] += a[2];
        swing[5] -= a[0];
        swing[6] -= a[1];
        swing[7] += a[0];
        for (uint32_t at = 0; (tide != NULL) && (at < MATRIX); at++) {
            swing[at] -= tide[at];
        }
    }
}

// How many directions a body has.
static uint32_t directions(const zygos_multibody_t *self, uint32_t body)
{
    return (body > 0) ? 2u : (self->floating ? 3u : 0u);
}

// E_ik of all bodies, and the load on each of what its directions accelerate by while u stands still, and of gravity.
static void gather(const zygos_multibody_t *self, const state_t *s)
{
    const uint32_t bodies = self->joints + 1u;
    const uint32_t all = 2u * self->joints + (self->floating ? 3u : 0u);
    uint32_t first = 0;
    for (uint32_t i = 0; i < bodies; i++) {
        double *const load = &s->load[SPACE * i];
        memset(load, 0, SPACE * sizeof load[0]);
        uint32_t second = 0;
        double pushed[3][3] = { { 0.0 } }; // of the directions of body i: sum N_ab of the accelerations
        for (uint32_t k = 0; k < bodies; k++) {
            double *const pair = &s->pair[MATRIX * (i * bodies + k)];
            double outer[9] = { 0.0 }; // sum N_ab d_b d_a'
            for (uint32_t a = 0; a < directions(self, i); a++) {
                const double *const entry = &self->matrix[(first + a) * all + second];
                double weighed[3] = { 0.0 };
                for (uint32_t b = 0; b < directions(self, k); b++) {
                    add(weighed, entry[b], &s->direction[SPACE * (second + b)]);
                }
                for (uint32_t row = 0; row < SPACE; row++) {
                    add(&outer[SPACE * row], weighed[row], &s->direction[SPACE * (first + a)]);
                }
                double swung[3];
                transform(&s->swing[MATRIX * k], weighed, swung);
                add(pushed[a], 1.0, swung);
            }
            const double trace = outer[0] + outer[4] + outer[8];
            for (uint32_t at = 0; at < MATRIX; at++) {
                pair[at] = ((at % 4u == 0) ? trace : 0.0) - outer[at];
            }
            second += directions(self, k);
        }
        for (uint32_t a = 0; a < directions(self, i); a++) {
            double torque[3];
            add(pushed[a], -self->moment[first + a], self->gravity);
            cross(&s->direction[SPACE * (first + a)], pushed[a], torque);
            add(load, 1.0, torque);
        }
        first += directions(self, i);
    }
}

// A flexible joint's rotor is free to turn: it takes nothing of its carrier's inertia about its axis, and pushes off
// it.
static void push_off(const zygos_multibody_t *self, const double *motor_rate, const double *spring, const double *drive,
                     const double *rate, const state_t *s)
{
    const uint32_t bodies = self->joints + 1u;
    for (uint32_t i = 1; i < bodies; i++) {
        const uint32_t joint = i - 1u;
        const double *const axis = &s->axis[SPACE * i];
        const double held = self->coupling[joint] * self->rotor[joint];
        double *const load = &s->load[SPACE * joint];
        double turned[3];
        cross(&s->omega[SPACE * joint], axis, turned);
        add(load, held * self->ratio[joint] * (self->rigid[joint] ? rate[joint] : motor_rate[joint]), turned);
        if (self->rigid[joint]) {
            continue;
        }
        const double gained = dot(axis, &s->alpha[SPACE * joint]);
        const double left = drive[joint] - spring[joint] / self->ratio[joint] - held * gained;
        add(load, self->coupling[joint] * left, axis);
        double *const own = &s->pair[MATRIX * (joint * bodies + joint)];
        for (uint32_t row = 0; row < SPACE; row++) {
            add(&own[SPACE * row], -self->coupling[joint] * held * axis[row], axis);
        }
    }
}

// Sums over all bodies at or beyond each.
static void sum_outward(uint32_t bodies, const state_t *s)
{
    for (uint32_t i = bodies; i-- > 0;) {
        for (uint32_t at = 0; (i + 1u < bodies) && (at < SPACE); at++) {
            s->load[SPACE * i + at] += s->load[SPACE * (i + 1u) + at];
        }
        for (uint32_t at = 0; at < MATRIX * bodies; at++) {
            s->pair[MATRIX * bodies * i + at] += (i + 1u < bodies) ? s->pair[MATRIX * bodies * (i + 1u) + at] : 0.0;
        }
    }
    for (uint32_t i = 0; i < bodies; i++) {
        for (uint32_t at = MATRIX * (bodies - 1u); at-- > 0;) {
            s->pair[MATRIX * bodies * i + at] += s->pair[MATRIX * bodies * i + at + MATRIX];
        }
    }
}

// The inertia matrix with respect to u, and what drives it.
static void project(const zygos_multibody_t *self, const double *spring, const double *drive, const double *link,
                    const double *push, const state_t *s)
{
    const uint32_t bodies = self->joints + 1u;
    const uint32_t base = self->floating ? SPACE : 0u;
    const uint32_t unknowns = base + self->joints;
    for (uint32_t row = 0; row < base; row++) {
        for (uint32_t column = 0; column < base; column++) {
            s->mass[row * unknowns + column] = s->pair[SPACE * row + column];
        }
        s->right[row] = push[row] - s->load[row];
    }
    for (uint32_t k = 1; k < bodies; k++) {
        const uint32_t column = base + k - 1u;
        const double *const axis = &s->axis[SPACE * k];
        double felt[3];
        transform(&s->pair[MATRIX * k], axis, felt);
        for (uint32_t row = 0; row < base; row++) {
            s->mass[row * unknowns + column] = s->mass[column * unknowns + row] = felt[row];
        }
        for (uint32_t i = 1; i <= k; i++) {
            const uint32_t row = base + i - 1u;
            transform(&s->pair[MATRIX * (i * bodies + k)], axis, felt);
            s->mass[row * unknowns + column] = s->mass[column * unknowns + row] = dot(&s->axis[SPACE * i], felt);
        }
        s->right[column] = link[k - 1u] - dot(axis, &s->load[SPACE * k]);
        if (!self->rigid[k - 1u]) {
            s->right[column] += spring[k - 1u];
        }
    }
    for (uint32_t i = 1; i < bodies; i++) {
        // a rotor that turns with its link
        if (!self->rigid[i - 1u]) {
            continue;
        }
        const uint32_t row = base + i - 1u;
        const double *const axis = &s->axis[SPACE * i];
        const double spun = self->rotor[i - 1u] * self->ratio[i - 1u];
        const double held = self->coupling[i - 1u] * spun;
        for (uint32_t column = 0; column < row; column++) {
            const double along = (column < base) ? axis[column] : dot(axis, &s->axis[SPACE * (column - base + 1u)]);
            s->mass[row * unknowns + column] += held * along;
            s->mass[column * unknowns + row] += held * along;
        }
        s->mass[row * unknowns + row] += spun * self->ratio[i - 1u];
        s->right[row] += self->ratio[i - 1u] * drive[i - 1u] - held * dot(axis, &s->alpha[SPACE * (i - 1u)]);
    }
}

// right := mass^-1 right, by elimination with row exchanges.
static void solve(uint32_t unknowns, double *mass, double *right)
{
    for (uint32_t k = 0; k < unknowns; k++) {
        uint32_t largest = k;
        for (uint32_t i = k + 1u; i < unknowns; i++) {
            if (fabs(mass[i * unknowns + k]) > fabs(mass[largest * unknowns + k])) {
                largest = i;
            }
        }
        for (uint32_t j = k; (largest != k) && (j < unknowns); j++) {
            const double swapped = mass[k * unknowns + j];
            mass[k * unknowns + j] = mass[largest * unknowns + j];
            mass[largest * unknowns + j] = swapped;
        }
        const double swapped = right[k];
        right[k] = right[largest];
        right[largest] = swapped;
        for (uint32_t i = k + 1u; i < unknowns; i++) {
            const double factor = mass[i * unknowns + k] / mass[k * unknowns + k];
            for (uint32_t j = k + 1u; j < unknowns; j++) {
                mass[i * unknowns + j] -= factor * mass[k * unknowns + j];
            }
            right[i] -= factor * right[k];
        }
    }
    for (uint32_t k = unknowns; k-- > 0;) {
        for (uint32_t j = k + 1u; j < unknowns; j++) {
            right[k] -= mass[k * unknowns + j] * right[j];
        }
        right[k] /= mass[k * unknowns + k];
    }
}

// Accelerations of base, links and motors in one state.
static void accelerate(const zygos_multibody_t *self, const double *base_rate, const double *q, const double *rate,
                       const double *motor_rate, const double *spring, const double *drive, const double *link,
                       const double *push, const double *tide, const state_t *s, double *base_out, double *link_out,
                       double *motor_out)
{
    const uint32_t joints = self->joints;
    const uint32_t base = self->floating ? SPACE : 0u;
    place(self, base_rate, q, rate, tide, s);
    gather(self, s);
    push_off(self, motor_rate, spring, drive, rate, s);
    sum_outward(joints + 1u, s);
    project(self, spring, drive, link, push, s);
    solve(base + joints, s->mass, s->right);

    double carrier[3] = { 0.0, 0.0, 0.0 }; // acceleration of the carrying body
    if (base > 0) {
        memcpy(carrier, s->right, sizeof carrier);
    }
    memcpy(base_out, carrier, sizeof carrier);
    for (uint32_t i = 0; i < joints; i++) {
        const double *const axis = &s->axis[SPACE * (i + 1u)];
        const double ratio = self->ratio[i];
        link_out[i] = motor_out[i] = s->right[base + i];
        if (!self->rigid[i]) {
            const double carried = dot(axis, carrier) + dot(axis, &s->alpha[SPACE * i]);
            motor_out[i] =
                (ratio * drive[i] - spring[i]) / (ratio * ratio * self->rotor[i]) - self->coupling[i] * carried / ratio;
        }
        add(carrier, link_out[i], axis);
    }
}

void zygos_multibody_accelerations(const zygos_multibody_t *self, uint64_t n, const double *in, double *out,
                                   double *scratch)
{
    const uint32_t joints = self->joints;
    const state_t s = carve(joints, scratch);
    for (uint64_t at = 0; at < n; at++) {
        const double *const base_rate = &in[at * (2u * SPACE + 6u * joints)];
        const double *const q = base_rate + SPACE;
        double *const base_out = &out[at * (SPACE + 2u * joints)];
        accelerate(self, base_rate, q, q + joints, q + 2u * joints, q + 3u * joints, q + 4u * joints, q + 5u * joints,
                   q + 6u * joints, NULL, &s, base_out, base_out + SPACE, base_out + SPACE + joints);
    }
}

// The closed form: Lagrange equations in the absolute angles of bodies whose axes are parallel.
static void accelerate_in_plane(const zygos_multibody_t *self, double base_rate, const double *q, const double *rate,
                                const double *spring, const double *drive, const double *link, double push,
                                double *scratch, double *base_out, double *link_out, double *motor_out)
{
    const uint32_t joints = self->joints;
    const uint32_t bodies = joints + 1u;
    const double *const a = self->matrix;
    const double *const b = a + (uint64_t)bodies * bodies;
    const double *const added = b + (uint64_t)bodies * bodies;
    double *const cosine = take(&scratch, bodies);
    double *const sine = take(&scratch, bodies);
    double *const square = take(&scratch, bodies);
    double *const right = take(&scratch, bodies);
    double *const mass = take(&scratch, (uint64_t)bodies * bodies);
    double angle = 0.0;
    double turn = base_rate;
    for (uint32_t i = 0; i < bodies; i++) {
        cosine[i] = cos(angle);
        sine[i] = sin(angle);
        square[i] = turn * turn;
        right[i] = 0.0;
        if (i < joints) {
            angle += q[i];
            turn += rate[i];
        }
    }
    for (uint32_t i = 0; i < bodies; i++) {
        for (uint32_t j = 0; j < bodies; j++) {
            const uint32_t at = i * bodies + j;
            const double along = cosine[i] * cosine[j] + sine[i] * sine[j];
            const double across = cosine[i] * sine[j] - sine[i] * cosine[j];
            mass[at] = a[at] * along + b[at] * across + added[at];
            right[i] -= (b[at] * along - a[at] * across) * square[j];
        }
    }
    right[0] += push;
    for (uint32_t i = 0; i < joints; i++) {
        const double through = self->rigid[i] ? self->ratio[i] * drive[i] : spring[i];
        const double pushed = self->rigid[i] ? 0.0 : self->coupling[i] * (drive[i] - spring[i] / self->ratio[i]);
        right[i + 1u] += through + link[i];
        right[i] -= through + link[i] + pushed;
    }
    solve(bodies, mass, right);
    *base_out = right[0];
    for (uint32_t i = 0; i < joints; i++) {
        const double ratio = self->ratio[i];
        link_out[i] = motor_out[i] = right[i + 1u] - right[i];
        if (!self->rigid[i]) {
            motor_out[i] = (ratio * drive[i] - spring[i]) / (ratio * ratio * self->rotor[i]) -
                           self->coupling[i] * right[i] / ratio;
        }
    }
}

// Time derivative of a packed state.
static void derive(const zygos_multibody_t *self, uint32_t width, const double *state, const double *spring,
                   const double *drive, const double *link, const double *push, const double *tide, double *scratch,
                   double *out)
{
    const uint32_t joints = self->joints;
    const double *const q = state + width;
    const double *const rate = q + 2u * joints;
    double *const out_rate = out + width + 2u * joints;
    memcpy(out + width, rate, 2u * joints * sizeof rate[0]);
    if (self->planar) {
        accelerate_in_plane(self, state[0], q, rate, spring, drive, link, push[0], scratch, out, out_rate,
                            out_rate + joints);
        return;
    }
    const state_t s = carve(joints, scratch);
    double base_rate[3] = { 0.0, 0.0, 0.0 };
    double base_out[3];
    if (self->floating) {
        memcpy(base_rate, state, width * sizeof base_rate[0]);
    }
    accelerate(self, base_rate, q, rate, rate + joints, spring, drive, link, push, tide, &s, base_out, out_rate,
               out_rate + joints);
    memcpy(out, base_out, width * sizeof base_out[0]);
}

void zygos_multibody_rates(const zygos_multibody_t *self, uint64_t n, uint32_t width, const double *state,
                           const double *force, double *out, double *scratch)
{
    const uint32_t joints = self->joints;
    const uint32_t size = width + 4u * joints;
    for (uint64_t at = 0; at < n; at++) {
        const double *const spring = &force[(3u * joints + width) * at];
        derive(self, width, &state[at * size], spring, spring + joints, spring + 2u * joints, spring + 3u * joints,
               NULL, scratch, &out[at * size]);
    }
}

static double within(double x, double limit)
{
    return fmin(fmax(x, -limit), limit);
}

// Torque of a law at a joint per unit coefficient.
static double torque_of(const zygos_multibody_law_t *law, double rate, double angle, double bent, double reported,
                        double load, const double *memory)
{
    double sum = 0.0;
    switch (law->form) {
    case ZYGOS_LAW_BRISTLE:
        return memory[law->first];
    case ZYGOS_LAW_SLIDERS:
        for (uint32_t j = 0; j < (uint32_t)ZYGOS_LAW_SLIDING; j++) {
            sum += memory[law->first + j];
        }
        return sum / (double)ZYGOS_LAW_SLIDING;
    case ZYGOS_LAW_RATE:
        return rate;
    case ZYGOS_LAW_SIZE:
        return fabs(rate);
    case ZYGOS_LAW_SIGN:
        return within(rate / law->width, 1.0);
    case ZYGOS_LAW_STRIBECK:
        return exp(-(rate / law->shape) * (rate / law->shape)) * within(rate / law->width, 1.0);
    case ZYGOS_LAW_LOAD:
        return tanh(rate / law->width) * fabs(load);
    case ZYGOS_LAW_REPORTED:
        return reported;
    case ZYGOS_LAW_CUBE:
        return bent * bent * bent;
    case ZYGOS_LAW_GAP:
        return -within(bent, law->shape);
    case ZYGOS_LAW_SINE:
        return sin(law->shape * angle);
    case ZYGOS_LAW_COSINE:
        return cos(law->shape * angle);
    default:
        return 1.0;
    }
}

// Rate and angle, before the gear, of what a law at a joint acts on. q: the angles and rates of a packed state.
static double rate_at(const zygos_multibody_t *self, const zygos_multibody_law_t *law, const double *q, double *angle)
{
    const uint32_t n = self->joints;
    const uint32_t i = law->joint;
    const double ratio = self->ratio[i];
    if (law->site == ZYGOS_SITE_LINK) {
        *angle = ratio * q[i];
        return q[2u * n + i];
    }
    if (law->site == ZYGOS_SITE_SPRING) {
        *angle = ratio * (q[n + i] - q[i]);
        return q[3u * n + i] - q[2u * n + i];
    }
    *angle = ratio * q[n + i];
    return q[3u * n + i];
}

// The states of laws after so many seconds at the rates of a packed state. q: its angles and rates.
static void remember(const zygos_multibody_t *self, const zygos_multibody_law_t *laws, uint32_t count, const double *q,
                     double span_s, double *memory)
{
    for (uint32_t k = 0; k < count; k++) {
        const zygos_multibody_law_t *const law = &laws[k];
        if ((law->form != ZYGOS_LAW_BRISTLE) && (law->form != ZYGOS_LAW_SLIDERS)) {
            continue;
        }
        double angle;
        double *const z = &memory[law->first];
        const double way = rate_at(self, law, q, &angle) * span_s / law->shape;
        if (law->form == ZYGOS_LAW_BRISTLE) {
            z[0] = z[0] * exp(-fabs(way)) + copysign(-expm1(-fabs(way)), way);
            continue;
        }
        for (uint32_t j = 0; j < (uint32_t)ZYGOS_LAW_SLIDING; j++) {
            z[j] = within(z[j] + way * (double)ZYGOS_LAW_SLIDING / (double)(j + 1u), 1.0);
        }
    }
}

// Torque of a law on the base per unit coefficient.
static double torque_on_base(const zygos_multibody_law_t *law, double time, double angle)
{
    if (law->form == ZYGOS_LAW_SINCE) {
        return (time >= law->shape) ? 1.0 : 0.0;
    }
    return torque_of(law, 0.0, angle, 0.0, 0.0, 0.0, NULL);
}

// Torques of springs on links, on rotors, on links besides, and on the base. force: 3N + 3. q: the angles and rates of
// a packed state.
static void act(const zygos_multibody_t *self, const double *spring, const zygos_multibody_law_t *laws, uint32_t count,
                const double *torque, const double *q, double time, double angle_of_base, const double *memory,
                double *force)
{
    const uint32_t n = self->joints;
    double *const drive = force + n;
    double *const link = drive + n;
    for (uint32_t i = 0; i < n; i++) {
        force[i] = spring[i] * (q[n + i] - q[i]) + spring[n + i] * (q[3u * n + i] - q[2u * n + i]);
        drive[i] = torque[i];
        link[i] = 0.0;
    }
    double *const push = link + n;
    memset(push, 0, SPACE * sizeof push[0]);
    for (uint32_t k = 0; k < count; k++) {
        const zygos_multibody_law_t *const law = &laws[k];
        const uint32_t i = law->joint;
        if (law->site == ZYGOS_SITE_BASE) {
            push[i] += law->value * torque_on_base(law, time, angle_of_base);
            continue;
        }
        const double bent = q[n + i] - q[i];
        const double ratio = self->ratio[i];
        double angle;
        const double rate = rate_at(self, law, q, &angle);
        const double load = self->rigid[i] ? ratio * drive[i] : force[i];
        const double acting = law->value * torque_of(law, rate, angle, bent, torque[i], load, memory);
        if (law->site == ZYGOS_SITE_LINK) {
            link[i] -= acting;
        } else if (law->site == ZYGOS_SITE_SPRING) {
            force[i] += self->rigid[i] ? 0.0 : acting;
        } else if (law->site == ZYGOS_SITE_LOAD) {
            drive[i] -= acting / ratio;
        } else if (law->site == ZYGOS_SITE_TORQUE) {
            drive[i] += acting;
        } else {
            drive[i] -= acting;
        }
    }
}

// A direction that stands still, in axes that turn by a small vector; the third order of the turn is left out.
static void turn_back(const double direction[3], const double turn[3], double out[3])
{
    double once[3];
    double twice[3];
    cross(direction, turn, once);
    cross(once, turn, twice);
    for (uint32_t i = 0; i < SPACE; i++) {
        out[i] = direction[i] + once[i] + 0.5 * twice[i];
    }
}

// What the gravity gradient takes a place to its acceleration with.
static void tide_of(double gradient, const double nadir[3], double tide[9])
{
    for (uint32_t row = 0; row < SPACE; row++) {
        for (uint32_t column = 0; column < SPACE; column++) {
            tide[SPACE * row + column] = gradient * (nadir[row] * nadir[column] - ((row == column) ? 1.0 / 3.0 : 0.0));
        }
    }
}

void zygos_multibody_advance(const zygos_multibody_t *self, uint64_t n, uint32_t width, const double *spring,
                             const zygos_multibody_law_t *laws, uint32_t count, double gradient, const double *torque,
                             double step_s, uint64_t steps, double *state, double *clock, uint32_t states,
                             double *memory, double *scratch)
{
    static const double SHARE[4] = { 0.0, 0.5, 0.5, 1.0 };
    static const double WEIGHT[4] = { 1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0 };
    const uint32_t joints = self->joints;
    const uint32_t size = width + 4u * joints;
    const int pulled = (width == SPACE) && (gradient != 0.0);
    double *const rate = take(&scratch, size);
    double *const at = take(&scratch, size);
    double *const sum = take(&scratch, size);
    double *const force = take(&scratch, 3u * (uint64_t)joints + SPACE);
    for (uint64_t piece = 0; piece < n; piece++) {
        double *const x = &state[piece * size];
        double *const time = &clock[CLOCK * piece];
        double *const angle = time + 1;
        double *const nadir = time + 2;
        double *const bent = &memory[piece * states];
        for (uint64_t k = 0; k < steps; k++) {
            remember(self, laws, count, x + width, 0.5 * step_s, bent);
            memset(rate, 0, size * sizeof rate[0]);
            memcpy(sum, x, size * sizeof sum[0]);
            double turning[3] = { 0.0, 0.0, 0.0 }; // rate of the base in the stage before; of a planar one the first
            double turned[3] = { 0.0, 0.0, 0.0 };
            for (uint32_t stage = 0; stage < 4u; stage++) {
                const double share = SHARE[stage] * step_s;
                for (uint32_t i = 0; i < size; i++) {
                    at[i] = x[i] + share * rate[i];
                }
                double tide[9];
                if (pulled) {
                    const double turn[3] = { share * turning[0], share * turning[1], share * turning[2] };
                    double seen[3];
                    turn_back(nadir, turn, seen);
                    tide_of(gradient, seen, tide);
                }
                act(self, spring, laws, count, &torque[piece * joints], at + width, *time + share,
                    *angle + (self->planar ? share * turning[0] : 0.0), bent, force);
                derive(self, width, at, force, force + joints, force + 2u * joints, force + 3u * joints,
                       pulled ? tide : NULL, scratch, rate);
                memcpy(turning, at, width * sizeof turning[0]);
                add(turned, WEIGHT[stage] * step_s, turning);
                for (uint32_t i = 0; i < size; i++) {
                    sum[i] += WEIGHT[stage] * step_s * rate[i];
                }
            }
            memcpy(x, sum, size * sizeof x[0]);
            remember(self, laws, count, x + width, 0.5 * step_s, bent);
            *time += step_s;
            *angle += self->planar ? turned[0] : 0.0;
            if (pulled) {
                double seen[3];
                turn_back(nadir, turned, seen);
                memcpy(nadir, seen, sizeof seen);
            }
        }
    }
}
