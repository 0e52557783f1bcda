#include "zygos/noise.h"

#include <string.h>

static double root(double x)
{
    return __builtin_sqrt(x);
}

/* Sums a[j] b[j]. */
static double product(const double *a, const double *b, uint32_t n)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum;
}

static void put(zygos_places_t *list, uint32_t place)
{
    list->place[list->count] = place;
    list->count++;
}

static void put_effects(zygos_places_t *list, const zygos_config_t *config, const zygos_layout_t *layout, uint32_t i)
{
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            put(list, layout->effects + e);
        }
    }
}

/* Columns that change when joint i moves, or with the base rate for i = N: those of a motion in which everything is
   different. */
static void put_bodies(zygos_places_t *list, const zygos_config_t *config, const zygos_layout_t *layout, uint32_t i)
{
    const bool space = (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? (space ? 3u : 1u) : (space ? 0u : 1u);
    const uint32_t size = space ? base + 2u * config->joints : config->joints + 1u;
    const uint32_t begin = (i == config->joints) ? 0u : (space ? base + 2u * i : i + 1u);
    double one[ZYGOS_MAX_DIRECTIONS][3];
    double moved[ZYGOS_MAX_DIRECTIONS][3] = { { 0.0 } };
    double column[ZYGOS_MAX_BODY] = { 0.0 };
    for (uint32_t a = 0; a < ZYGOS_MAX_DIRECTIONS; a++) {
        for (uint32_t k = 0; k < 3; k++) {
            one[a][k] = 1.0 + (double)(3u * a + k * k);
            moved[a][k] = ((a >= begin) && (a < size)) ? 1.0 : 0.0;
        }
    }
    (void)zygos_kinetic_products(config, (const double(*)[3])one, (const double(*)[3])moved, column);
    for (uint32_t k = 0; k < layout->kinetic; k++) {
        if (column[k] > 0.0 || column[k] < 0.0) {
            put(list, k);
        }
    }
    for (uint32_t k = layout->kinetic; (k < layout->body) && (i < config->joints); k++) {
        put(list, k);
    }
}

/* Rotors that the bodies behind joint i carry. */
static void put_rotors(zygos_places_t *list, const zygos_layout_t *layout, uint32_t joints, uint32_t from)
{
    for (uint32_t i = from; i < joints; i++) {
        if (layout->rotor[i]) {
            put(list, layout->joint[i]);
        }
    }
}

static void put_joint(zygos_places_t *list, const zygos_config_t *config, const zygos_layout_t *layout, uint32_t i)
{
    if (layout->rotor[i]) {
        put(list, layout->joint[i]);
    }
    if (config->joint[i].rigid == 0) {
        put(list, layout->joint[i] + layout->rotor[i]);
        put(list, layout->joint[i] + layout->rotor[i] + 1u);
    }
}

static void sort(zygos_places_t *list)
{
    for (uint32_t i = 1; i < list->count; i++) {
        const uint32_t place = list->place[i];
        uint32_t j = i;
        for (; (j > 0) && (list->place[j - 1u] > place); j--) {
            list->place[j] = list->place[j - 1u];
        }
        list->place[j] = place;
    }
}

void zygos_noise_init(zygos_noise_t *self, const zygos_config_t *config, const zygos_layout_t *layout,
                      const zygos_smoother_t *smoother)
{
    const uint32_t n = config->joints;
    memset(self, 0, sizeof *self);
    for (uint32_t s = 0; s < 2u * n; s++) {
        const zygos_joint_config_t *joint = &config->joint[s % n];
        const double sigma = ((s < n) && (joint->rigid == 0)) ? joint->link_sigma_rad : joint->motor_sigma_rad;
        const double *value = smoother->value[s];
        const double *slope = smoother->slope[s];
        const double value_norm = root(product(value, value, smoother->window));
        const double shared = product(value, slope, smoother->window) / value_norm;
        const double rest = product(slope, slope, smoother->window) - shared * shared;
        self->factor[s][0] = sigma * value_norm;
        self->factor[s][1] = sigma * shared;
        self->factor[s][2] = sigma * root((rest > 0.0) ? rest : 0.0);
        self->rate_variance[s] = sigma * sigma * product(slope, slope, smoother->window);
    }
    const double *gyro = smoother->value[2u * n];
    self->gyro_variance = config->imu_sigma * config->imu_sigma * product(gyro, gyro, smoother->window);
    for (uint32_t i = 0; i < n; i++) {
        zygos_places_t *link = &self->link[i];
        zygos_places_t *motor = &self->motor[i];
        put_bodies(link, config, layout, i);
        put_rotors(link, layout, n, i + 1u);
        put_joint(motor, config, layout, i);
        if (config->joint[i].rigid == 0) {
            put(link, layout->joint[i] + layout->rotor[i]);
            put(link, layout->joint[i] + layout->rotor[i] + 1u);
            put_effects(link, config, layout, i);
            put_effects(motor, config, layout, i);
            put(motor, layout->count);
        } else {
            /* One sensor speaks for both sides. */
            put_joint(link, config, layout, i);
            put_effects(link, config, layout, i);
            put(link, layout->count);
        }
        sort(link);
        sort(motor);
    }
    for (uint32_t i = 0; (i < n) && (config->compensation != 0); i++) {
        self->drift.slip[i] = config->period_s * (self->rate_variance[i] + self->rate_variance[n + i]);
    }
    for (uint32_t e = 0; (e < config->effects) && (config->compensation != 0); e++) {
        const uint32_t i = config->effect[e].joint;
        const bool square = (config->effect[e].kind == ZYGOS_MOTOR_VISCOUS);
        self->drift.effect[e] =
            square ? config->period_s * config->joint[i].gear_ratio * self->rate_variance[n + i] : 0.0;
    }
    put_bodies(&self->gyro, config, layout, n);
    put_rotors(&self->gyro, layout, n, 0);
    sort(&self->gyro);
}

/* x_a replaced by sum_j variance_j (z_j x (x_a x z_j)) over the joints before a body, and by the gyro's. */
static void blur(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                 double (*out)[3])
{
    const uint32_t n = config->joints;
    const bool free = (config->base == ZYGOS_BASE_FREE);
    const double gyro = free ? self->gyro_variance : 0.0;
    if ((ZYGOS_SPATIAL == 0) || (config->kinetic != ZYGOS_SPATIAL_ARM)) {
        double variance = gyro;
        for (uint32_t i = 0; i <= n; i++) {
            variance += (i > 0) ? self->rate_variance[i - 1u] : 0.0;
            out[i][0] = variance * motion->direction[i][0];
            out[i][1] = variance * motion->direction[i][1];
        }
        return;
    }
    double m[3][3] = { { 2.0 * gyro, 0.0, 0.0 }, { 0.0, 2.0 * gyro, 0.0 }, { 0.0, 0.0, 2.0 * gyro } };
    const uint32_t base = free ? 3u : 0u;
    for (uint32_t a = 0; a < base + 2u * n; a++) {
        if ((a >= base) && ((a - base) % 2u == 0)) {
            const double *z = motion->axis[(a - base) / 2u];
            const double variance = self->rate_variance[(a - base) / 2u];
            for (uint32_t k = 0; k < 3; k++) {
                for (uint32_t l = 0; l < 3; l++) {
                    m[k][l] += variance * (((k == l) ? 1.0 : 0.0) - z[k] * z[l]);
                }
            }
        }
        for (uint32_t k = 0; k < 3; k++) {
            out[a][k] = product(m[k], motion->direction[a], 3);
        }
    }
}

void zygos_noise_means(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                       zygos_row_t *row)
{
    double blurred[ZYGOS_MAX_DIRECTIONS][3];
    double mean[ZYGOS_MAX_BODY] = { 0.0 };
    if (config->compensation == 0) {
        return;
    }
    blur(self, config, motion, blurred);
    const double *end = zygos_kinetic_products(config, (const double(*)[3])blurred, motion->direction, mean);
    const uint32_t kinetic = (uint32_t)(end - mean);
    for (uint32_t k = 0; k < kinetic; k++) {
        row->column[k] -= mean[k];
    }
}

/* packed += a a^T + b b^T at the places of the list. */
static void add(const zygos_places_t *list, const double *a, const double *b, double *packed, double *sum)
{
    double x[ZYGOS_MAX_PARAMETERS + 1];
    double y[ZYGOS_MAX_PARAMETERS + 1];
    double total_x = 0.0;
    double total_y = 0.0;
    for (uint32_t i = 0; i < list->count; i++) {
        x[i] = a[list->place[i]];
        y[i] = b[list->place[i]];
        total_x += x[i];
        total_y += y[i];
    }
    for (uint32_t i = 0; i < list->count; i++) {
        const uint32_t place = list->place[i];
        double *line = &packed[place * (place + 1u) / 2u];
        for (uint32_t j = 0; j <= i; j++) {
            line[list->place[j]] += x[i] * x[j] + y[i] * y[j];
        }
        sum[place] += x[i] * total_x + y[i] * total_y;
    }
}

/* Of a motion about joint i: bodies, and the rotors that they carry. */
static void link_slopes(const zygos_config_t *config, const zygos_layout_t *layout, const zygos_skeleton_t *skeleton,
                        const zygos_state_t *state, const zygos_motion_t *motion, uint32_t i, double *by_angle,
                        double *by_rate)
{
    zygos_kinematics_slopes(skeleton, config, motion, i, by_angle, by_rate);
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    for (uint32_t r = i + 1u; r < config->joints; r++) {
        if (!layout->rotor[r]) {
            continue;
        }
        const double rotor = config->joint[r].gear_ratio * state->theta_rate[r];
        double turned = 0.0;
        double along = 1.0;
        if (space) {
            /* z_r . w_(r-1) changes by z_i . (z_r x w_(i-1)) and by z_i . z_r. */
            const double *z = motion->axis[r];
            const double *w = motion->spin[i];
            const double *axis = motion->axis[i];
            turned = axis[0] * (z[1] * w[2] - z[2] * w[1]) + axis[1] * (z[2] * w[0] - z[0] * w[2]) +
                     axis[2] * (z[0] * w[1] - z[1] * w[0]);
            along = product(axis, z, 3);
        }
        by_angle[layout->joint[r]] = rotor * turned;
        by_rate[layout->joint[r]] = rotor * along;
    }
}

/* What spring, damper, effects and work of joint i change with when its motor turns. The dissipation since the arc
   began changes with the newest angle by 2 (theta' - q'), as the work does by the torque before. */
static void motor_slopes(const zygos_config_t *config, const zygos_layout_t *layout, const zygos_state_t *state,
                         const zygos_motion_t *motion, const double *tau, const double *tau_next, uint32_t i,
                         double *by_angle, double *by_rate)
{
    const double ratio = config->joint[i].gear_ratio;
    const uint32_t place = layout->joint[i];
    if (layout->rotor[i]) {
        by_angle[place] = 0.0;
        by_rate[place] = ratio * (ratio * state->theta_rate[i] + motion->carrier_rate[i]);
    }
    if (config->joint[i].rigid == 0) {
        by_angle[place + layout->rotor[i]] = state->theta[i] - state->q[i];
        by_angle[place + layout->rotor[i] + 1u] = 2.0 * (state->theta_rate[i] - state->q_rate[i]);
        by_rate[place + layout->rotor[i]] = 0.0;
        by_rate[place + layout->rotor[i] + 1u] = 0.0;
    }
    const double held = (config->torque_law == ZYGOS_TORQUE_SAMPLED) ? 0.0 : config->period_s / 12.0;
    by_angle[layout->count] = ratio * tau[i];
    by_rate[layout->count] = held * ratio * (tau_next[i] - tau[i]);
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            zygos_effects_motor_slopes(config, e, state, tau_next[i] - tau[i], &by_angle[layout->effects + e],
                                       &by_rate[layout->effects + e]);
        }
    }
}

/* The same when its link does: the deflection has it the other way round. */
static void against(const zygos_config_t *config, const zygos_layout_t *layout, const zygos_state_t *state, uint32_t i,
                    double *by_angle, double *by_rate)
{
    const uint32_t place = layout->joint[i] + layout->rotor[i];
    by_angle[place] = state->q[i] - state->theta[i];
    by_angle[place + 1u] = 2.0 * (state->q_rate[i] - state->theta_rate[i]);
    by_rate[place] = 0.0;
    by_rate[place + 1u] = 0.0;
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            by_angle[layout->effects + e] = zygos_effects_link_slope(config, e, state);
            by_rate[layout->effects + e] = 0.0;
        }
    }
}

/* a := f0 a + f1 b, b := f2 b at the places of the list: independent of each other and of variance 1. */
static void scale(const zygos_places_t *list, const double *factor, double weight, double *a, double *b)
{
    for (uint32_t i = 0; i < list->count; i++) {
        const uint32_t k = list->place[i];
        a[k] = weight * (factor[0] * a[k] + factor[1] * b[k]);
        b[k] = weight * factor[2] * b[k];
    }
}

static void add_gyro(const zygos_noise_t *self, const zygos_config_t *config, const zygos_layout_t *layout,
                     const zygos_state_t *state, const zygos_motion_t *motion, double weight, double *packed,
                     double *sum)
{
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t n = config->joints;
    const double deviation = weight * root(self->gyro_variance);
    double slope[3][ZYGOS_MAX_PARAMETERS + 1];
    memset(slope, 0, sizeof slope);
    for (uint32_t k = 0; k < (space ? 3u : 1u); k++) {
        double moved[ZYGOS_MAX_DIRECTIONS][3];
        const uint32_t count = space ? 2u * n + 3u : n + 1u;
        for (uint32_t a = 0; a < count; a++) {
            const double *d = motion->direction[a];
            if (space) {
                moved[a][k] = 0.0;
                moved[a][(k + 1u) % 3u] = -d[(k + 2u) % 3u];
                moved[a][(k + 2u) % 3u] = d[(k + 1u) % 3u];
            } else {
                moved[a][0] = d[0];
                moved[a][1] = d[1];
            }
        }
        (void)zygos_kinetic_products(config, motion->rate, (const double(*)[3])moved, slope[k]);
        (void)zygos_kinetic_products(config, (const double(*)[3])moved, motion->rate, slope[k]);
        for (uint32_t r = 0; r < n; r++) {
            if (layout->rotor[r]) {
                const double rotor = config->joint[r].gear_ratio * state->theta_rate[r];
                slope[k][layout->joint[r]] = rotor * (space ? motion->axis[r][k] : 1.0);
            }
        }
        for (uint32_t i = 0; i < self->gyro.count; i++) {
            slope[k][self->gyro.place[i]] *= deviation;
        }
    }
    add(&self->gyro, slope[0], slope[1], packed, sum);
    if (space) {
        const double none[ZYGOS_MAX_PARAMETERS + 1] = { 0.0 };
        add(&self->gyro, slope[2], none, packed, sum);
    }
}

void zygos_noise_add(const zygos_noise_t *self, const zygos_config_t *config, const zygos_layout_t *layout,
                     const zygos_skeleton_t *skeleton, const zygos_state_t *state, const zygos_motion_t *motion,
                     const double *tau, const double *tau_next, uint32_t turn, double weight, double *packed,
                     double *sum)
{
    const uint32_t n = config->joints;
    if (config->compensation == 0) {
        return;
    }
    const uint32_t stride = config->compensation;
    const double share = weight * root((double)stride);
    for (uint32_t i = turn % stride; i < n; i += stride) {
        double angle[ZYGOS_MAX_PARAMETERS + 1];
        double rate[ZYGOS_MAX_PARAMETERS + 1];
        link_slopes(config, layout, skeleton, state, motion, i, angle, rate);
        if (config->joint[i].rigid == 0) {
            double motor_angle[ZYGOS_MAX_PARAMETERS + 1];
            double motor_rate[ZYGOS_MAX_PARAMETERS + 1];
            against(config, layout, state, i, angle, rate);
            scale(&self->link[i], self->factor[i], share, angle, rate);
            add(&self->link[i], angle, rate, packed, sum);
            motor_slopes(config, layout, state, motion, tau, tau_next, i, motor_angle, motor_rate);
            scale(&self->motor[i], self->factor[n + i], share, motor_angle, motor_rate);
            add(&self->motor[i], motor_angle, motor_rate, packed, sum);
        } else {
            motor_slopes(config, layout, state, motion, tau, tau_next, i, angle, rate);
            scale(&self->link[i], self->factor[n + i], share, angle, rate);
            add(&self->link[i], angle, rate, packed, sum);
        }
    }
    if ((self->gyro_variance > 0.0) && (config->base == ZYGOS_BASE_FREE)) {
        add_gyro(self, config, layout, state, motion, weight, packed, sum);
    }
}
