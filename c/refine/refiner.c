/* SPDX-License-Identifier: MIT */
#include "zygos/priv/refiner.h"

#include "zygos/priv/numbers.h"

#include <string.h>

/* No reading is rejected. */
#define UNLIMITED 1e300

/* Where column j of the root begins. */
static uint32_t column(uint32_t j)
{
    return j * (j + 1u) / 2u;
}

static double inner(const double *a, const double *b, uint32_t count)
{
    double sum = 0.0;
    for (const double *end = a + count; a != end; a++, b++) {
        sum += *a * *b;
    }
    return sum;
}

int zygos_refiner_init(zygos_refiner_t *self, const zygos_config_t *config, const zygos_refiner_settings_t *settings)
{
    const uint32_t n = config->joints;
    const uint32_t flags = settings->friction | settings->offsets | settings->gains | settings->zeros;
    const zygos_propagation_t *propagation = &self->propagation;
    memset(self, 0, sizeof *self);
    self->failed = 1u;
    if (zygos_propagation_init(&self->propagation, config, settings->steps, settings->friction) != 1) {
        return ZYGOS_E_VALUE;
    }
    bool good = (flags <= 1u) && zygos_within(settings->bias_walk, 0.0, 1e3) &&
                zygos_within(settings->second_order, 0.0, 1e3) &&
                ((propagation->base_rates == 0u) || zygos_within(settings->gyro_sigma, 1e-12, 1e3));
    for (uint32_t i = 0; i < n; i++) {
        good = good && zygos_within(settings->link_sigma[i], 1e-12, 10.0) &&
               zygos_within(settings->motor_sigma[i], 1e-12, 10.0) &&
               zygos_within(settings->torque_sigma[i], 0.0, 1e6) &&
               zygos_within(settings->torque_relative_sigma[i], 0.0, 1.0);
    }
    for (uint32_t k = 0; k < propagation->parameters; k++) {
        good = good && zygos_within(settings->size[k], 1e-300, 1e300);
    }
    if (!good) {
        return ZYGOS_E_VALUE;
    }
    self->settings = *settings;
    self->joints = n;
    self->fast = propagation->moving + propagation->base_rates;
    self->constants =
        propagation->parameters + n * (settings->friction + settings->offsets + settings->gains + 2u * settings->zeros);
    self->entries = self->fast + self->constants;
    return 1;
}

/* Replaces the covariance in the columns of the parameters by the upper triangular U with U U' = covariance. Returns
 * false where it is not positive definite. */
static bool factorise_covariance(zygos_refiner_t *self)
{
    const uint32_t p = self->propagation.parameters;
    for (uint32_t j = p; j > 0u; j--) {
        const uint32_t at = j - 1u;
        double *own = &self->root[column(self->fast + at) + self->fast];
        for (uint32_t i = j; i > 0u; i--) {
            double sum = own[i - 1u];
            for (uint32_t k = j; k < p; k++) {
                const double *later = &self->root[column(self->fast + k) + self->fast];
                sum -= later[i - 1u] * later[at];
            }
            if (i < j) {
                own[i - 1u] = sum / own[at];
            } else if (sum > 0.0) {
                own[at] = __builtin_sqrt(sum);
            } else {
                return false;
            }
        }
    }
    return true;
}

int zygos_refiner_begin(zygos_refiner_t *self, const double *x, const double *sigma)
{
    const uint32_t p = self->propagation.parameters;
    for (uint32_t k = 0; k < self->entries; k++) {
        const bool parameter = (k >= self->fast) && (k < self->fast + p);
        if (!parameter && !zygos_within(sigma[k], 0.0, 1e300)) {
            return ZYGOS_E_VALUE;
        }
    }
    self->failed = 1u;
    for (uint32_t k = 0; k < self->entries; k++) {
        const bool parameter = (k >= self->fast) && (k < self->fast + p);
        double *own = &self->root[column(k)];
        memset(own, 0, (parameter ? self->fast : k + 1u) * sizeof own[0]);
        self->x[k] = parameter ? x[k] / self->settings.size[k - self->fast] : x[k];
        if (!parameter) {
            own[k] = sigma[k];
        }
    }
    if (!factorise_covariance(self)) {
        return ZYGOS_E_VALUE;
    }
    memset(self->count, 0, sizeof self->count);
    memset(self->square, 0, sizeof self->square);
    self->volume = 1.0;
    self->volume_exponent = 0.0;
    self->failed = 0u;
    return 1;
}

int zygos_refiner_start(zygos_refiner_t *self, const double *x, const double *sigma, const double *covariance)
{
    const uint32_t p = self->propagation.parameters;
    const double *size = self->settings.size;
    for (uint32_t j = 0; j < p; j++) {
        double *own = &self->root[column(self->fast + j) + self->fast];
        for (uint32_t i = 0; i <= j; i++) {
            own[i] = covariance[i * p + j] / (size[i] * size[j]);
        }
    }
    return zygos_refiner_begin(self, x, sigma);
}

void zygos_refiner_resume(zygos_refiner_t *self, const double *x, const double *sigma)
{
    memcpy(self->x, x, self->fast * sizeof x[0]);
    for (uint32_t k = 0; k < self->entries; k++) {
        double *own = &self->root[column(k)];
        memset(own, 0, ((k < self->fast) ? k + 1u : self->fast) * sizeof own[0]);
        if (k < self->fast) {
            own[k] = sigma[k];
        }
    }
}

/* Multiplies the volume by a variance, and moves powers of 2 into its exponent. */
static void scale_volume(zygos_refiner_t *self, double variance)
{
    const double product = self->volume * variance;
    uint64_t bits;
    memcpy(&bits, &product, sizeof bits);
    self->volume_exponent += (double)((bits >> 52) & 0x7FFu) - 1022.0;
    bits = (bits & 0x800FFFFFFFFFFFFFu) | 0x3FE0000000000000u;
    memcpy(&self->volume, &bits, sizeof bits);
}

/* What a reading sees of column j of the root, beside what it sees as a mean. */
static double seen(const zygos_refiner_t *self, const zygos_innovation_t *one, double mean, uint32_t j)
{
    const double *own = &self->root[column(j)];
    double sum = mean;
    for (uint32_t t = 0; (t < one->terms) && (one->entry[t] <= j); t++) {
        sum += one->weight[t] * own[one->entry[t]];
    }
    return sum;
}

/* A step of Carlson's update: alpha is the variance of the reading up to this column, of which the reading sees f. */
typedef struct {
    double keep;
    double share;
} step_t;

static step_t step_of(double *alpha, double f)
{
    const double before = *alpha;
    *alpha += f * f;
    const step_t out = { __builtin_sqrt(before / *alpha), f / __builtin_sqrt(before * *alpha) };
    return out;
}

static void rotate(double *restrict own, double *restrict gain, uint32_t first, uint32_t count, step_t step, double f)
{
    for (uint32_t i = first; i < count; i++) {
        const double entry = own[i];
        own[i] = entry * step.keep - gain[i] * step.share;
        gain[i] += entry * f;
    }
}

/* Carlson's update of estimate and root by one reading with a variance, unless its square is above the limit. Where
   there are means, it is mean k, to whose entry those of `one` are added. */
static void update(zygos_refiner_t *self, zygos_innovation_t *one, uint32_t k, double value, double variance,
                   double limit, zygos_refiner_work_t *work)
{
    const uint32_t leads = work->leads;
    const uint32_t first = (leads > 0u) ? 0u : one->entry[0];
    double *lead_gain = work->gain;
    double *gain = &work->gain[leads];
    double innovation = value - ((leads > 0u) ? work->lead_x[k] : 0.0);
    double alpha = variance;
    for (uint32_t t = 0; t < one->terms; t++) {
        innovation -= one->weight[t] * self->x[one->entry[t]];
    }
    /* the first pass tells the expected variance, the second one changes the root */
    for (uint32_t j = k; j < leads; j++) {
        const double f = work->crown[column(j) + k];
        alpha += f * f;
    }
    for (uint32_t j = first; j < self->entries; j++) {
        work->seen[j] = seen(self, one, (leads > 0u) ? work->lead[j][k] : 0.0, j);
        alpha += work->seen[j] * work->seen[j];
    }
    const double square = innovation * innovation / alpha;
    one->variance = alpha;
    one->rejected = (square <= limit) ? 0u : 1u;
    one->square = (square <= limit) ? square : limit;
    if (one->rejected != 0u) {
        return;
    }
    alpha = variance;
    memset(work->gain, 0, (leads + self->entries) * sizeof gain[0]);
    for (uint32_t j = k; j < leads; j++) {
        const double f = work->crown[column(j) + k];
        rotate(&work->crown[column(j)], lead_gain, k + 1u, j + 1u, step_of(&alpha, f), f);
    }
    for (uint32_t j = first; j < self->entries; j++) {
        const double f = work->seen[j];
        const step_t step = step_of(&alpha, f);
        rotate(work->lead[j], lead_gain, k + 1u, leads, step, f);
        rotate(&self->root[column(j)], gain, 0u, j + 1u, step, f);
    }
    const double shift = innovation / alpha;
    for (uint32_t i = k + 1u; i < leads; i++) { /* means are used in their order, and then no more */
        work->lead_x[i] += lead_gain[i] * shift;
    }
    for (uint32_t i = 0; i < self->entries; i++) {
        self->x[i] += gain[i] * shift;
    }
}

/* The sum of the variances of the link rates. */
static double rate_variance(const zygos_refiner_t *self, uint32_t n)
{
    const uint32_t first = self->propagation.base_rates + 2u * n;
    double sum = 0.0;
    for (uint32_t j = first; j < self->entries; j++) {
        const double *own = &self->root[column(j)];
        for (uint32_t i = first; (i < first + n) && (i <= j); i++) {
            sum += own[i] * own[i];
        }
    }
    return sum;
}

double zygos_refiner_latch_s(const zygos_config_t *config, uint32_t k)
{
    const uint32_t n = config->joints;
    const zygos_joint_config_t *joint = &config->joint[(k < n) ? k : k - n];
    return 1e-6 * (double)joint->latch_us + ((k < n) ? joint->link_latch_s : joint->motor_latch_s);
}

/* Adds an entry to those of which a reading is the sum. */
static void term(zygos_innovation_t *one, uint32_t entry, double weight)
{
    one->entry[one->terms] = entry;
    one->weight[one->terms] = weight;
    one->terms++;
}

zygos_innovation_t zygos_refiner_use(zygos_refiner_t *self, const zygos_config_t *config, uint32_t k, double value,
                                     double limit, zygos_refiner_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->propagation.base_rates;
    const bool mean = (work->leads > 0u); /* in which the state is already */
    const double cycles = mean ? (double)work->cycles : 1.0;
    zygos_innovation_t one = { 0 };
    double variance;
    if (k < 2u * n) {
        const double sigma = (k < n) ? self->settings.link_sigma[k] : self->settings.motor_sigma[k - n];
        one.channel = (k < n) ? (uint32_t)ZYGOS_CHANNEL_LINK : (uint32_t)ZYGOS_CHANNEL_MOTOR;
        variance = sigma * sigma / cycles;
        if (!mean) {
            term(&one, w + k, 1.0);
            term(&one, w + 2u * n + k, zygos_refiner_latch_s(config, k));
        }
        if (self->settings.zeros != 0u) {
            term(&one, self->entries - 2u * n + k, 1.0);
        }
    } else {
        if (k == 2u * n) {
            const double rough = self->settings.second_order * rate_variance(self, n);
            self->gyro_variance = self->settings.gyro_sigma * self->settings.gyro_sigma / cycles + rough * rough;
        }
        one.channel = (uint32_t)ZYGOS_CHANNEL_GYRO;
        variance = self->gyro_variance;
        if (!mean) {
            term(&one, k - 2u * n, 1.0);
        }
        term(&one, self->propagation.moving + k - 2u * n, 1.0);
    }
    update(self, &one, k, value, variance, limit, work);
    self->count[one.channel] += 1.0;
    self->square[one.channel] += one.square;
    scale_volume(self, one.variance);
    return one;
}

void zygos_refiner_pin(zygos_refiner_t *self, uint32_t entry, double sigma, zygos_refiner_work_t *work)
{
    zygos_innovation_t one = { .terms = 1u, .entry = { entry, 0u, 0u }, .weight = { 1.0, 0.0, 0.0 } };
    update(self, &one, 0u, self->x[entry], sigma * sigma, UNLIMITED, work);
}

void zygos_refiner_read(zygos_refiner_t *self, const zygos_config_t *config, const double *q, const double *theta,
                        const double *omega, zygos_refiner_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->propagation.base_rates;
    const double *axis = config->joint[0].axis;
    work->leads = 0u;
    for (uint32_t k = 0; k < 2u * n + w; k++) {
        double value;
        if (k < 2u * n) {
            value = (k < n) ? q[k] : theta[k - n];
        } else if (w == 3u) {
            value = omega[k - 2u * n];
        } else {
            value = zygos_dot3(axis, omega);
        }
        (void)zygos_refiner_use(self, config, k, value, UNLIMITED, work);
    }
}

/* Takes the component along a row of length 1 out of another row, and returns it. */
static double take_out(double *restrict other, const double *restrict row, uint32_t columns)
{
    const double along = inner(other, row, columns);
    for (uint32_t c = 0; c < columns; c++) {
        other[c] -= along * row[c];
    }
    return along;
}

/* The upper triangular R with R R' = T T' of the table T, by the modified method of Gram and Schmidt. */
void zygos_refiner_row(zygos_refiner_t *self, uint32_t at, zygos_refiner_work_t *work)
{
    const uint32_t moving = self->propagation.moving;
    const uint32_t biases = self->fast + self->propagation.base_rates;
    const bool of_mean = (at >= self->fast);
    const bool of_bias = (at >= moving) && !of_mean; /* these have entries in few columns */
    const uint32_t begin = of_bias ? moving : 0u;
    const uint32_t columns = (of_bias ? biases : biases + work->shapes * self->joints) - begin;
    const uint32_t first = of_mean ? self->fast : 0u; /* row of the first entry of the column */
    double *own = of_mean ? &work->crown[column(at - first)] : &self->root[column(at)];
    double *row = &work->table[at][begin];
    const double square = inner(row, row, columns);
    own[at - first] = __builtin_sqrt(square);
    const double scale = (square > 0.0) ? 1.0 / own[at - first] : 0.0;
    for (uint32_t c = 0; c < columns; c++) {
        row[c] *= scale;
    }
    for (uint32_t i = first; i < at; i++) {
        own[i - first] = take_out(&work->table[i][begin], row, columns);
    }
    for (uint32_t i = 0; (i < work->leads) && !of_mean; i++) {
        work->lead[at][i] = take_out(&work->table[self->fast + i][begin], row, columns);
    }
}

void zygos_refiner_table(const zygos_refiner_t *self, const double *noise, double walk, zygos_refiner_work_t *work)
{
    const uint32_t n = self->joints;
    const uint32_t moving = self->propagation.moving;
    const uint32_t w = self->propagation.base_rates;
    const uint32_t pushes = work->shapes * n;
    const uint32_t columns = self->fast + pushes + w;
    for (uint32_t i = moving; i < self->fast; i++) {
        memset(work->table[i], 0, columns * sizeof work->table[i][0]);
        work->table[i][self->fast + i - moving] = walk;
        for (uint32_t j = i; j < self->fast; j++) {
            work->table[i][j] = self->root[column(j) + i];
        }
    }
    for (uint32_t i = 0; i < moving + work->leads; i++) {
        double *row = work->table[(i < moving) ? i : i - moving + self->fast];
        for (uint32_t j = 0; j < self->fast; j++) {
            const double *own = &self->root[column(j)];
            row[j] = inner(work->across[i], own, (j < moving) ? j + 1u : moving);
        }
        for (uint32_t k = 0; k < pushes; k++) {
            row[self->fast + w + k] = work->push[i][k] * noise[k % n];
        }
        memset(&row[self->fast], 0, w * sizeof row[0]);
    }
}

/* out[rows] = matrix[rows][count] x, or is added to it. */
static void multiply_rows(const double *matrix, uint32_t stride, uint32_t rows, uint32_t count, const double *x,
                          bool add, double *out)
{
    for (uint32_t i = 0; i < rows; i++) {
        out[i] = (add ? out[i] : 0.0) + inner(&matrix[i * stride], x, count);
    }
}

void zygos_refiner_carry(zygos_refiner_t *self, uint32_t c, const double (*slope)[ZYGOS_MAX_SLOPES],
                         zygos_refiner_work_t *work)
{
    const uint32_t n = self->joints;
    const uint32_t moving = self->propagation.moving;
    const uint32_t accelerations = self->propagation.base_rates + 2u * n;
    const uint32_t rows = moving + work->leads;
    const uint32_t p = self->propagation.parameters;
    const uint32_t motion = p + ((self->settings.friction != 0u) ? n : 0u);
    const uint32_t gains = motion + ((self->settings.offsets != 0u) ? n : 0u);
    const uint32_t depends = gains + ((self->settings.gains != 0u) ? n : 0u);
    const uint32_t by_motion = (c < motion) ? c + 1u : motion;
    const uint32_t by_torque = (c < motion) ? 0u : n;
    double *own = &self->root[column(self->fast + c)];
    const double *below = &own[self->fast];
    double scaled[ZYGOS_MAX_MOTION_CONSTANTS + ZYGOS_MAX_JOINTS];
    double moved[ZYGOS_MAX_MOVED];
    for (uint32_t k = 0; k < by_motion; k++) {
        scaled[k] = below[k] * ((k < p) ? self->settings.size[k] : 1.0);
    }
    /* An offset is what a torque is reported too large by; a gain, of it, too small. */
    for (uint32_t i = 0; i < by_torque; i++) {
        const bool offset = (motion + i < gains) && (motion + i <= c);
        const bool gain = (gains + i < depends) && (gains + i <= c);
        scaled[motion + i] = (gain ? work->torque[i] * below[gains + i] : 0.0) - (offset ? below[motion + i] : 0.0);
    }
    multiply_rows(work->across[0], ZYGOS_MAX_MOVING, rows, moving, own, false, moved);
    if (slope != NULL) {
        multiply_rows(&slope[0][moving], ZYGOS_MAX_SLOPES, moving, by_motion + by_torque, scaled, true, moved);
    } else {
        double added[ZYGOS_MAX_ACCELERATIONS];
        multiply_rows(work->propagation.by_constant[0], ZYGOS_MAX_MOTION_CONSTANTS, accelerations, by_motion, scaled,
                      false, added);
        multiply_rows(work->propagation.by_torque[0], ZYGOS_MAX_JOINTS, accelerations, by_torque, &scaled[by_motion],
                      true, added);
        multiply_rows(work->pushed[0], ZYGOS_MAX_ACCELERATIONS, rows, accelerations, added, true, moved);
    }
    memcpy(own, moved, moving * sizeof own[0]);
    memcpy(work->lead[self->fast + c], &moved[moving], work->leads * sizeof moved[0]);
}

void zygos_refiner_constants(const zygos_refiner_t *self, double *constant)
{
    const uint32_t p = self->propagation.parameters;
    const uint32_t friction = (self->settings.friction != 0u) ? self->joints : 0u;
    for (uint32_t k = 0; k < p + friction; k++) {
        constant[k] = self->x[self->fast + k] * ((k < p) ? self->settings.size[k] : 1.0);
    }
}

void zygos_refiner_drive(const zygos_refiner_t *self, const double *tau, double *drive)
{
    const uint32_t n = self->joints;
    const uint32_t friction = (self->settings.friction != 0u) ? n : 0u;
    const double *offset = &self->x[self->fast + self->propagation.parameters + friction];
    const double *gain = &offset[(self->settings.offsets != 0u) ? n : 0u];
    for (uint32_t i = 0; i < n; i++) {
        const double share = (self->settings.gains != 0u) ? gain[i] : 0.0;
        drive[i] = tau[i] + share * tau[i] - ((self->settings.offsets != 0u) ? offset[i] : 0.0);
    }
}

bool zygos_refiner_advance(zygos_refiner_t *self, const zygos_config_t *config, const double *tau, double lost,
                           zygos_propagation_stages_t *stages, zygos_refiner_work_t *work)
{
    const uint32_t n = config->joints;
    double drive[ZYGOS_MAX_JOINTS];
    double noise[ZYGOS_MAX_JOINTS];
    if (self->failed != 0u) {
        return false;
    }
    for (uint32_t i = 0; i < n; i++) {
        const double relative = self->settings.torque_relative_sigma[i] * tau[i];
        const double own = self->settings.torque_sigma[i];
        noise[i] = __builtin_sqrt(own * own + relative * relative + lost * lost);
    }
    memcpy(work->torque, tau, n * sizeof tau[0]);
    zygos_refiner_drive(self, tau, drive);
    zygos_refiner_constants(self, work->constant);
    zygos_dynamics_set(&work->dynamics, &self->propagation, config, work->constant);
    bool good = zygos_propagate(&self->propagation, config, &work->dynamics, self->x, drive, stages->slope, stages,
                                &work->propagation);
    for (uint32_t k = 0; k < self->propagation.moving; k++) {
        good = good && zygos_within(self->x[k], -1e6, 1e6);
    }
    if (!good) {
        self->failed = 1u;
        return false;
    }
    const uint32_t torques =
        self->propagation.moving + self->propagation.parameters + ((self->settings.friction != 0u) ? n : 0u);
    work->shapes = 1u;
    work->leads = 0u;
    for (uint32_t i = 0; i < self->propagation.moving; i++) {
        memcpy(work->across[i], stages->slope[i], self->propagation.moving * sizeof work->across[i][0]);
        memcpy(work->push[i], &stages->slope[i][torques], n * sizeof work->push[i][0]);
    }
    zygos_refiner_table(self, noise, self->settings.bias_walk, work);
    for (uint32_t c = 0; c < self->constants; c++) {
        zygos_refiner_carry(self, c, (const double(*)[ZYGOS_MAX_SLOPES])stages->slope, work);
    }
    for (uint32_t j = self->fast; j > 0u; j--) {
        zygos_refiner_row(self, j - 1u, work);
    }
    return true;
}

void zygos_refiner_parameters(const zygos_refiner_t *self, double *value, double *covariance)
{
    const uint32_t p = self->propagation.parameters;
    const double *size = self->settings.size;
    for (uint32_t i = 0; i < p; i++) {
        value[i] = self->x[self->fast + i] * size[i];
        for (uint32_t j = 0; (covariance != NULL) && (j <= i); j++) {
            double sum = 0.0;
            for (uint32_t k = i; k < self->constants; k++) {
                const double *own = &self->root[column(self->fast + k) + self->fast];
                sum += own[i] * own[j];
            }
            covariance[i * p + j] = sum * size[i] * size[j];
            covariance[j * p + i] = covariance[i * p + j];
        }
    }
}
