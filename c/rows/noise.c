/* SPDX-License-Identifier: MIT */
#include "zygos/priv/noise.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>
#include <string.h>

#define ROUNDED 1e-9 /* a correlation that is none */

/* Sums a[j] b[j]. */
static double sum_of_products(const double *a, const double *b, uint32_t n)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum;
}

_Static_assert(ZYGOS_MAX_COLUMNS + 1 < 256, "the index of a column is a byte");

static void put_place(zygos_column_list_t *list, uint32_t place)
{
    list->place[list->count] = (uint8_t)place;
    list->count++;
}

_Static_assert((sizeof(zygos_column_list_t) == 8u * (ZYGOS_LIST_WORDS + 1u)) &&
                   (offsetof(zygos_column_list_t, place) == 8u),
               "a list of columns consists of words");

/* Word w of a list behind its seal. */
static inline uint64_t word_of(const zygos_column_list_t *list, uint32_t w)
{
    const uint8_t *bytes = (const uint8_t *)list; /* words reach over both members */
    uint64_t word;
    __builtin_memcpy(&word, &bytes[8u * (w + 1u)], sizeof word); /* no call, also where the compiler knows no library */
    return word;
}

static uint64_t list_seal_of(const zygos_column_list_t *list)
{
    uint64_t seal = 0;
    for (uint32_t w = 0; w < (uint32_t)ZYGOS_LIST_WORDS; w++) {
        seal ^= word_of(list, w);
    }
    return seal;
}

/* Kinetic columns that are not zero. */
static void put_products(zygos_column_list_t *list, const zygos_config_t *config, const zygos_column_map_t *column_map,
                         const double (*x)[3], const double (*y)[3], double *column)
{
    (void)zygos_kinetic_products(config, x, y, column);
    for (uint32_t k = 0; k < column_map->kinetic; k++) {
        if (column[k] > 0.0 || column[k] < 0.0) {
            put_place(list, k);
        }
    }
}

/* A motion that has nothing special, and the directions that a joint carries: from begin to before end. */
static void fill_motion(uint32_t begin, uint32_t end, double (*others)[3], double (*carried)[3])
{
    for (uint32_t a = 0; a < ZYGOS_MAX_DIRECTIONS; a++) {
        for (uint32_t k = 0; k < 3; k++) {
            others[a][k] = 1.0 + (double)(3u * a + k * k);
            carried[a][k] = ((a >= begin) && (a < end)) ? 1.0 : 0.0;
        }
    }
}

/* Kinetic columns that the rate of joint i is in, or that of the base for i = N, and of those the ones that its angle
   is in. */
static void put_bodies(zygos_column_list_t *angle, zygos_column_list_t *rate, const zygos_config_t *config,
                       const zygos_column_map_t *column_map, uint32_t i)
{
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    const bool free = (config->base == ZYGOS_BASE_FREE);
    const uint32_t base = free ? (space ? 3u : 1u) : (space ? 0u : 1u);
    const uint32_t size = space ? base + 2u * config->joints : config->joints + 1u;
    const uint32_t begin = (i == config->joints) ? 0u : (space ? base + 2u * i : i + 1u);
    double others[ZYGOS_MAX_DIRECTIONS][3];
    double carried[ZYGOS_MAX_DIRECTIONS][3];
    double column[ZYGOS_MAX_BODY] = { 0.0 };
    fill_motion(begin, size, others, carried);
    put_products(rate, config, column_map, (const double(*)[3])others, (const double(*)[3])carried, column);
    /* In a plane, what joint i carries turns together. */
    for (uint32_t a = begin; (a < ZYGOS_MAX_DIRECTIONS) && !space; a++) {
        memset(others[a], 0, sizeof others[a]);
    }
    memset(column, 0, sizeof column);
    put_products(angle, config, column_map, (const double(*)[3])others, (const double(*)[3])carried, column);
    for (uint32_t k = column_map->kinetic; (k < column_map->body) && (i < config->joints); k++) {
        put_place(angle, k);
    }
}

/* Rotors that the bodies behind joint i carry, as far as they notice. */
static void put_rotors(zygos_column_list_t *list, const zygos_column_map_t *column_map, uint32_t joints, uint32_t from)
{
    for (uint32_t i = from; (i < joints) && (i < (uint32_t)ZYGOS_MAX_JOINTS); i++) {
        if (column_map->rotor[i] != 0u) {
            put_place(list, column_map->joint[i]);
        }
    }
}

/* Spring and damper, and the effects of the joint that an angle is in. */
static void put_spring(zygos_column_list_t *list, const zygos_config_t *config, const zygos_column_map_t *column_map,
                       uint32_t i)
{
    if (config->joint[i].rigid == 0) {
        put_place(list, column_map->joint[i] + column_map->rotor[i]);
        put_place(list, column_map->joint[i] + column_map->rotor[i] + 1u);
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            put_place(list, column_map->effects + e);
        }
    }
}

/* What a motor's rate is in. */
static void put_motor(zygos_column_list_t *list, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      uint32_t i)
{
    if (column_map->rotor[i] != 0u) {
        put_place(list, column_map->joint[i]);
    }
    for (uint32_t e = 0; e < config->effects; e++) {
        const bool steps =
            (config->effect[e].kind == ZYGOS_TORQUE_LAG) || (config->effect[e].kind == ZYGOS_TORQUE_GAIN);
        if ((config->effect[e].joint == i) && steps) {
            put_place(list, column_map->effects + e);
        }
    }
    put_place(list, column_map->count);
}

static void sort(zygos_column_list_t *list)
{
    for (uint32_t i = 1; i < list->count; i++) {
        const uint8_t place = list->place[i];
        uint32_t j = i;
        while ((j > 0) && (list->place[j - 1u] > place)) {
            list->place[j] = list->place[j - 1u];
            j--;
        }
        list->place[j] = place;
    }
    list->seal = list_seal_of(list);
}

/* Puts a place into a sorted list, which may have it. */
static void insert(zygos_column_list_t *list, uint32_t place)
{
    uint32_t k = 0;
    while ((k < list->count) && (list->place[k] != place)) {
        k++;
    }
    if (k == list->count) {
        put_place(list, place);
        sort(list);
    }
}

/* Sorts, with the places of another list. */
static void join(zygos_column_list_t *list, const zygos_column_list_t *other)
{
    sort(list);
    for (uint32_t k = 0; k < other->count; k++) {
        insert(list, other->place[k]);
    }
}

/* Makes pairs of neighbours, such as add_pairs() needs. A column that is put into the list for that contains no noise.
 */
static void make_pairs(zygos_column_list_t *list, const zygos_column_map_t *column_map)
{
    for (uint32_t k = 0; k < list->count; k += 2u) {
        if (list->place[k] < column_map->count) {
            insert(list, list->place[k] + 1u);
        }
    }
}

static void find_places(zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map)
{
    const uint32_t n = config->joints;
    const bool space = (config->kinetic == ZYGOS_SPATIAL_ARM);
    for (uint32_t i = 0; i < n; i++) {
        zygos_column_list_t *angle[2] = { &self->signal[i], &self->signal[n + i] };
        zygos_column_list_t rate[2] = { { 0 } };
        put_bodies(angle[0], &rate[0], config, column_map, i);
        put_rotors(&rate[0], column_map, n, i + 1u);
        put_rotors(angle[0], column_map, n, space ? i + 1u : n);
        put_spring(angle[0], config, column_map, i);
        /* One sensor speaks for both sides of a rigid joint. */
        const uint32_t motor = (config->joint[i].rigid == 0) ? 1u : 0u;
        if (motor == 1u) {
            put_spring(angle[1], config, column_map, i);
        }
        put_place(angle[motor], column_map->count);
        put_motor(&rate[motor], config, column_map, i);
        for (uint32_t k = 0; k < 2; k++) {
            join(angle[k], &rate[k]);
            make_pairs(angle[k], column_map);
        }
    }
    zygos_column_list_t none = { 0 };
    put_bodies(&none, &self->gyro, config, column_map, n);
    put_rotors(&self->gyro, column_map, n, 0);
    sort(&self->gyro);
    make_pairs(&self->gyro, column_map);
}

void zygos_noise_init(zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_smoother_t *smoother)
{
    const uint32_t n = config->joints;
    memset(self, 0, sizeof *self);
    for (uint32_t s = 0; s < 2u * n; s++) {
        const zygos_joint_config_t *joint = &config->joint[s % n];
        const double sigma = ((s < n) && (joint->rigid == 0)) ? joint->link_sigma_rad : joint->motor_sigma_rad;
        double variance[3];
        zygos_smoother_variance(smoother, s, variance);
        const double value_norm = __builtin_sqrt(variance[0]);
        const double both = variance[1] / value_norm;
        /* Rounding leaves a little of it also where a signal latches at SYNC. */
        const double shared = (both * both > ROUNDED * ROUNDED * variance[2]) ? both : 0.0;
        const double rest = variance[2] - shared * shared;
        self->factor[s][0] = sigma * value_norm;
        self->factor[s][1] = sigma * shared;
        self->factor[s][2] = sigma * __builtin_sqrt(zygos_larger(rest, 0.0));
        self->rate_variance[s] = sigma * sigma * variance[2];
    }
    double gyro[3];
    zygos_smoother_variance(smoother, 2u * n, gyro);
    const double gyro_variance = config->imu_sigma * config->imu_sigma * gyro[0];
    double least = 1e300;
    for (uint32_t i = 0; i < n; i++) {
        least = (self->rate_variance[i] < least) ? self->rate_variance[i] : least;
    }
    self->gyro_variance = (gyro_variance >= ZYGOS_GYRO_SHARE * least) ? gyro_variance : 0.0;
    find_places(self, config, column_map);
    for (uint32_t i = 0; (i < n) && (config->compensation != 0); i++) {
        self->integral_bias.dissipation[i] = config->period_s * (self->rate_variance[i] + self->rate_variance[n + i]);
    }
    for (uint32_t e = 0; (e < config->effects) && (config->compensation != 0); e++) {
        const uint32_t i = config->effect[e].joint;
        const double variance = zygos_effects_at_link(&config->effect[e])
                                    ? self->rate_variance[i]
                                    : config->joint[i].gear_ratio * self->rate_variance[n + i];
        self->integral_bias.effect[e] = zygos_effects_viscous(&config->effect[e]) ? config->period_s * variance : 0.0;
    }
}

/* In a plane, what two bodies have in common: the rates of the base and of the joints up to the one nearer to it. */
static void planar_means(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                         double *column)
{
    const uint32_t n = config->joints;
    const bool free = (config->base == ZYGOS_BASE_FREE);
    for (uint32_t skew = 0; skew < ((config->kinetic == ZYGOS_PLANAR) ? 2u : 1u); skew++) {
        double variance = free ? self->gyro_variance : self->rate_variance[0];
        for (uint32_t a = free ? 0u : 1u; a <= n; a++) {
            const double *d = motion->direction[a];
            if (skew == 0) {
                *column -= 0.5 * variance;
                column++;
            }
            for (uint32_t b = a + 1u; b <= n; b++) {
                const double *e = motion->direction[b];
                *column -= variance * (skew ? d[0] * e[1] - d[1] * e[0] : d[0] * e[0] + d[1] * e[1]);
                column++;
            }
            variance += (a < n) ? self->rate_variance[a] : 0.0;
        }
    }
}

/* In space, each direction replaced by sum_j variance_j (z_j x (d x z_j)) over the joints before its body, and by the
   gyro's. */
static void blur(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                 double (*out)[3])
{
    const uint32_t n = config->joints;
    const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? 3u : 0u;
    const double gyro = (base > 0) ? 2.0 * self->gyro_variance : 0.0;
    double m[3][3] = { { gyro, 0.0, 0.0 }, { 0.0, gyro, 0.0 }, { 0.0, 0.0, gyro } };
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
            out[a][k] = sum_of_products(m[k], motion->direction[a], 3);
        }
    }
}

void zygos_noise_means(const zygos_noise_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                       zygos_row_t *row)
{
    if (config->compensation == 0) {
        return;
    }
    if ((ZYGOS_SPATIAL == 0) || (config->kinetic != ZYGOS_SPATIAL_ARM)) {
        planar_means(self, config, motion, row->column);
        return;
    }
    double blurred[ZYGOS_MAX_DIRECTIONS][3];
    double mean[ZYGOS_MAX_BODY] = { 0.0 };
    blur(self, config, motion, blurred);
    const double *end = zygos_kinetic_products(config, (const double(*)[3])blurred, motion->direction, mean);
    const uint32_t kinetic = (uint32_t)(end - mean);
    for (uint32_t k = 0; k < kinetic; k++) {
        row->column[k] -= mean[k];
    }
}

/* Adds to entries of two neighbours, and subtracts it from those of the rows. */
static inline void add_two(double *restrict gram, double *restrict rows, double first, double second)
{
    gram[0] += first;
    gram[1] += second;
    rows[0] -= first;
    rows[1] -= second;
}

static inline void add_one(double *restrict gram, double *restrict rows, double entry)
{
    *gram += entry;
    *rows -= entry;
}

/* target += x x^T + y y^T at those places, two rows and two columns at a time: places ascend in pairs of neighbours,
   and the last one may be alone. */
static void add_pairs(const uint8_t *place, uint32_t count, const double *x, const double *y,
                      const zygos_noise_target_t *target)
{
    double total_x = 0.0;
    double total_y = 0.0;
    for (uint32_t i = 0; i < count; i++) {
        total_x += x[i];
        total_y += y[i];
    }
    for (uint32_t i = 0; i < count; i++) {
        add_one(&target->sum[place[i]], &target->row_sum[place[i]], x[i] * total_x + y[i] * total_y);
    }
    uint32_t i = 0;
    for (; i + 1u < count; i += 2u) {
        const uint32_t row = place[i];
        double *gram = &target->gram[zygos_gram_entries(row)];
        double *rows = &target->rows[zygos_gram_entries(row)];
        double *gram_below = gram + row + 1u;
        double *rows_below = rows + row + 1u;
        const double upper_x = x[i];
        const double lower_x = x[i + 1u];
        const double upper_y = y[i];
        const double lower_y = y[i + 1u];
        const uint8_t *column = place;
        const double *v = y;
        for (const double *u = x; u != x + i; u += 2) {
            const double above[2] = { upper_x * u[0] + upper_y * v[0], upper_x * u[1] + upper_y * v[1] };
            const double below[2] = { lower_x * u[0] + lower_y * v[0], lower_x * u[1] + lower_y * v[1] };
            const size_t at = *column;
            add_two(&gram[at], &rows[at], above[0], above[1]);
            add_two(&gram_below[at], &rows_below[at], below[0], below[1]);
            v += 2;
            column += 2;
        }
        add_one(&gram[row], &rows[row], upper_x * upper_x + upper_y * upper_y);
        add_two(&gram_below[row], &rows_below[row], lower_x * upper_x + lower_y * upper_y,
                lower_x * lower_x + lower_y * lower_y);
    }
    for (uint32_t j = 0; (i < count) && (j <= i); j++) {
        const uint32_t entry = zygos_gram_entries(place[i]) + place[j];
        add_one(&target->gram[entry], &target->rows[entry], x[i] * x[j] + y[i] * y[j]);
    }
}

/* Turns the columns of a list into parameters, with the work behind them. */
static void reduce_list(const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_column_list_t *list, double *x)
{
    double columns[ZYGOS_MAX_COLUMNS + 1] = { 0.0 };
    for (uint32_t i = 0; i < list->count; i++) {
        columns[list->place[i]] = x[i];
    }
    zygos_reduce(config, column_map, columns, x);
    x[column_map->parameters] = columns[column_map->count];
}

/* The same of the parameters: where a column may count for several, all of them change. */
static void add_reduced(const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_column_list_t *list, double *x, double *y, const zygos_noise_target_t *target)
{
    const uint32_t count = column_map->parameters + 1u;
    uint8_t place[ZYGOS_MAX_PARAMETERS + 1];
    for (uint32_t i = 0; i < count; i++) {
        place[i] = (uint8_t)i;
    }
    reduce_list(config, column_map, list, x);
    reduce_list(config, column_map, list, y);
    add_pairs(place, count, x, y, target);
}

/* Clears the entries of x and y that a list names, for not all of them contain noise. Returns false where the list was
   changed. */
static bool clear(const zygos_column_list_t *list, double *x, double *y)
{
    if (list->seal != list_seal_of(list)) {
        return false;
    }
    for (uint32_t i = 0; i < list->count; i++) {
        x[list->place[i]] = 0.0;
        y[list->place[i]] = 0.0;
    }
    return true;
}

/* The entries of x and y that a list names, times the factor of a signal. Places ascend, so what stands there can move
   to the front of its own array. */
static void add_list(const zygos_config_t *config, const zygos_column_map_t *column_map,
                     const zygos_column_list_t *list, const double factor[3], double *x, double *y,
                     const zygos_noise_target_t *target)
{
    for (uint32_t i = 0; i < list->count; i++) {
        const uint32_t place = list->place[i];
        x[i] = factor[0] * x[place] + factor[1] * y[place];
        y[i] = factor[2] * y[place];
    }
    if (config->reduced > 0) {
        add_reduced(config, column_map, list, x, y, target);
    } else {
        add_pairs(list->place, list->count, x, y, target);
    }
}

/* Of a motion about joint i: bodies, and the rotors that they carry. */
static void link_slopes(const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                        uint32_t i, double *by_angle, double *by_rate)
{
    zygos_kinematics_slopes(geometry, config, motion, i, by_angle, by_rate);
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    for (uint32_t r = i + 1u; r < config->joints; r++) { /* each of which has a rotor column */
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
            along = sum_of_products(axis, z, 3);
        }
        by_angle[column_map->joint[r]] = rotor * turned;
        by_rate[column_map->joint[r]] = rotor * along;
    }
}

/* What spring, damper, effects and work of joint i change with when its motor turns. The dissipation since the arc
   began changes with the newest angle by 2 (theta' - q'), as the work does by the torque before. */
static void motor_slopes(const zygos_config_t *config, const zygos_column_map_t *column_map,
                         const zygos_arm_state_t *state, const zygos_motion_t *motion, const double *tau,
                         const double *tau_next, uint32_t i, double *by_angle, double *by_rate)
{
    const double ratio = config->joint[i].gear_ratio;
    const uint32_t place = column_map->joint[i];
    if (column_map->rotor[i] != 0u) {
        by_angle[place] = 0.0;
        by_rate[place] = ratio * (ratio * state->theta_rate[i] + motion->carrier_rate[i]);
    }
    if (config->joint[i].rigid == 0) {
        by_angle[place + column_map->rotor[i]] = state->theta[i] - state->q[i];
        by_angle[place + column_map->rotor[i] + 1u] = 2.0 * (state->theta_rate[i] - state->q_rate[i]);
        by_rate[place + column_map->rotor[i]] = 0.0;
        by_rate[place + column_map->rotor[i] + 1u] = 0.0;
    }
    by_angle[column_map->count] = ratio * tau[i];
    by_rate[column_map->count] = zygos_effects_jump(config) * ratio * (tau_next[i] - tau[i]);
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            zygos_effects_motor_slopes(config, e, state, tau[i], tau_next[i], &by_angle[column_map->effects + e],
                                       &by_rate[column_map->effects + e]);
        }
    }
}

/* The same when its link does: the deflection has it the other way round. */
static void opposing_slopes(const zygos_config_t *config, const zygos_column_map_t *column_map,
                            const zygos_arm_state_t *state, uint32_t i, double *by_angle, double *by_rate)
{
    const uint32_t place = column_map->joint[i] + column_map->rotor[i];
    by_angle[place] = state->q[i] - state->theta[i];
    by_angle[place + 1u] = 2.0 * (state->q_rate[i] - state->theta_rate[i]);
    by_rate[place] = 0.0;
    by_rate[place + 1u] = 0.0;
    for (uint32_t e = 0; e < config->effects; e++) {
        if (config->effect[e].joint == i) {
            by_angle[column_map->effects + e] = zygos_effects_link_slope(config, e, state);
            by_rate[column_map->effects + e] = 0.0;
        }
    }
}

/* The axes that the gyro's noise acts about: x, y and z; z here, and the base, in a plane. */
static void gyro_slopes(const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_arm_state_t *state, const zygos_motion_t *motion, uint32_t axis, double *by_rate)
{
    const uint32_t n = config->joints;
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    memset(by_rate, 0, column_map->kinetic * sizeof by_rate[0]);
    if (space) {
        double moved[ZYGOS_MAX_DIRECTIONS][3];
        for (uint32_t a = 0; a < 2u * n + 3u; a++) {
            const double *d = motion->direction[a];
            moved[a][axis] = 0.0;
            moved[a][(axis + 1u) % 3u] = -d[(axis + 2u) % 3u];
            moved[a][(axis + 2u) % 3u] = d[(axis + 1u) % 3u];
        }
        (void)zygos_kinetic_products(config, motion->rate, (const double(*)[3])moved, by_rate);
        (void)zygos_kinetic_products(config, (const double(*)[3])moved, motion->rate, by_rate);
    } else {
        (void)zygos_kinetic_products(config, motion->rate, motion->direction, by_rate);
        (void)zygos_kinetic_products(config, motion->direction, motion->rate, by_rate);
    }
    for (uint32_t r = 0; r < n; r++) { /* each of which has a rotor column on a free base */
        const double rotor = config->joint[r].gear_ratio * state->theta_rate[r];
        by_rate[column_map->joint[r]] = rotor * (space ? motion->axis[r][axis] : 1.0);
    }
}

/* The share of one axis of the gyro. */
static bool add_gyro(const zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                     const zygos_arm_state_t *state, const zygos_motion_t *motion, uint32_t axis, double weight,
                     const zygos_noise_target_t *target)
{
    const double factor[3] = { weight * __builtin_sqrt(self->gyro_variance), 0.0, 0.0 };
    double rate[ZYGOS_MAX_COLUMNS + 1];
    double none[ZYGOS_MAX_COLUMNS + 1];
    if (!clear(&self->gyro, rate, none)) {
        return false;
    }
    gyro_slopes(config, column_map, state, motion, axis, rate);
    add_list(config, column_map, &self->gyro, factor, rate, none, target);
    return true;
}

/* The share of one encoder: those of the links first, then those of the motors. */
static bool add_encoder(const zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                        const double *tau, const double *tau_next, uint32_t sensor, double weight,
                        const zygos_noise_target_t *target)
{
    const uint32_t n = config->joints;
    const uint32_t i = sensor % n;
    const bool rigid = (config->joint[i].rigid != 0);
    const double factor[3] = { weight * self->factor[sensor][0], weight * self->factor[sensor][1],
                               weight * self->factor[sensor][2] };
    double angle[ZYGOS_MAX_COLUMNS + 1];
    double rate[ZYGOS_MAX_COLUMNS + 1];
    if (rigid && (sensor >= n)) {
        return true; /* it spoke for both sides */
    }
    if (!clear(&self->signal[sensor], angle, rate)) {
        return false;
    }
    if (sensor < n) {
        link_slopes(config, column_map, geometry, state, motion, i, angle, rate);
    }
    if ((sensor < n) && !rigid) {
        opposing_slopes(config, column_map, state, i, angle, rate);
    } else {
        motor_slopes(config, column_map, state, motion, tau, tau_next, i, angle, rate);
    }
    add_list(config, column_map, &self->signal[sensor], factor, angle, rate, target);
    return true;
}

bool zygos_noise_add(const zygos_noise_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                     const zygos_geometry_t *geometry, const zygos_arm_state_t *state, const zygos_motion_t *motion,
                     const double *tau, const double *tau_next, uint32_t turn, double weight,
                     const zygos_noise_target_t *target)
{
    const uint32_t stride = config->compensation;
    if (stride == 0) {
        return true;
    }
    bool whole = true;
    const bool gyro = (self->gyro_variance > 0.0) && (config->base == ZYGOS_BASE_FREE);
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t encoders = 2u * config->joints;
    const uint32_t sensors = encoders + (gyro ? (space ? 3u : 1u) : 0u);
    const double share = weight * __builtin_sqrt((double)stride);
    for (uint32_t sensor = turn % stride; sensor < sensors; sensor += stride) {
        if (sensor >= encoders) {
            whole = add_gyro(self, config, column_map, state, motion, sensor - encoders, share, target) && whole;
        } else {
            whole =
                add_encoder(self, config, column_map, geometry, state, motion, tau, tau_next, sensor, share, target) &&
                whole;
        }
    }
    return whole;
}
