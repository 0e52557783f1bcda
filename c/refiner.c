#include "zygos/refiner.h"

#include <string.h>

/* Where column j of the root begins. */
static uint32_t column(uint32_t j)
{
    return j * (j + 1u) / 2u;
}

static bool within(double x, double low, double high)
{
    return (x >= low) && (x <= high);
}

int zygos_refiner_init(zygos_refiner_t *self, const zygos_config_t *config, const zygos_refiner_settings_t *settings)
{
    const uint32_t n = config->joints;
    const uint32_t flags = settings->friction | settings->offsets | settings->zeros;
    const zygos_propagation_t *propagation = &self->propagation;
    memset(self, 0, sizeof *self);
    self->failed = 1u;
    if (zygos_propagation_init(&self->propagation, config, settings->steps, settings->friction) != 1) {
        return ZYGOS_E_VALUE;
    }
    bool good = (flags <= 1u) && within(settings->bias_walk, 0.0, 1e3) && within(settings->second_order, 0.0, 1e3) &&
                ((propagation->base_rates == 0u) || within(settings->gyro_sigma, 1e-12, 1e3));
    for (uint32_t i = 0; i < n; i++) {
        good = good && within(settings->link_sigma[i], 1e-12, 10.0) && within(settings->motor_sigma[i], 1e-12, 10.0) &&
               within(settings->torque_sigma[i], 0.0, 1e6) && within(settings->torque_relative_sigma[i], 0.0, 1.0);
    }
    for (uint32_t k = 0; k < propagation->parameters; k++) {
        good = good && within(settings->size[k], 1e-300, 1e300);
    }
    if (!good) {
        return ZYGOS_E_VALUE;
    }
    self->settings = *settings;
    self->fast = propagation->moving + propagation->base_rates;
    self->constants = propagation->parameters + n * (settings->friction + settings->offsets + 2u * settings->zeros);
    self->entries = self->fast + self->constants;
    return 1;
}

/* The upper triangular U with U U' = covariance / (size size'), into the columns of the parameters. Returns false where
 * the covariance is not positive definite; the root is then unchanged outside of these columns. */
static bool factorise(const zygos_refiner_t *self, const double *covariance, double *root)
{
    const uint32_t p = self->propagation.parameters;
    const double *size = self->settings.size;
    for (uint32_t j = p; j > 0u; j--) {
        const uint32_t at = j - 1u;
        double *own = &root[column(self->fast + at) + self->fast];
        for (uint32_t i = j; i > 0u; i--) {
            double sum = covariance[(i - 1u) * p + at] / (size[i - 1u] * size[at]);
            for (uint32_t k = j; k < p; k++) {
                const double *later = &root[column(self->fast + k) + self->fast];
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

int zygos_refiner_start(zygos_refiner_t *self, const double *x, const double *sigma, const double *covariance)
{
    const uint32_t p = self->propagation.parameters;
    for (uint32_t k = 0; k < self->entries; k++) {
        const bool parameter = (k >= self->fast) && (k < self->fast + p);
        if (!parameter && !within(sigma[k], 0.0, 1e300)) {
            return ZYGOS_E_VALUE;
        }
    }
    self->failed = 1u;
    memset(self->root, 0, sizeof self->root);
    if (!factorise(self, covariance, self->root)) {
        return ZYGOS_E_VALUE;
    }
    for (uint32_t k = 0; k < self->entries; k++) {
        const bool parameter = (k >= self->fast) && (k < self->fast + p);
        self->x[k] = parameter ? x[k] / self->settings.size[k - self->fast] : x[k];
        if (!parameter) {
            self->root[column(k) + k] = sigma[k];
        }
    }
    memset(self->count, 0, sizeof self->count);
    memset(self->square, 0, sizeof self->square);
    self->volume = 1.0;
    self->volume_exponent = 0.0;
    self->failed = 0u;
    return 1;
}

/* One reading as a sum of entries of the filter. */
typedef struct {
    uint32_t terms;
    uint32_t entry[3]; /* ascending */
    double weight[3];
} reading_t;

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

/* Carlson's update of estimate and root by one reading with a variance. */
static void update(zygos_refiner_t *self, const reading_t *reading, double value, double variance, uint32_t channel,
                   double *gain)
{
    double innovation = value;
    double alpha = variance;
    for (uint32_t t = 0; t < reading->terms; t++) {
        innovation -= reading->weight[t] * self->x[reading->entry[t]];
    }
    memset(gain, 0, self->entries * sizeof gain[0]);
    for (uint32_t j = reading->entry[0]; j < self->entries; j++) {
        double *own = &self->root[column(j)];
        double f = 0.0;
        for (uint32_t t = 0; (t < reading->terms) && (reading->entry[t] <= j); t++) {
            f += reading->weight[t] * own[reading->entry[t]];
        }
        const double before = alpha;
        alpha += f * f;
        const double keep = __builtin_sqrt(before / alpha);
        const double share = f / __builtin_sqrt(before * alpha);
        for (uint32_t i = 0; i <= j; i++) {
            const double entry = own[i];
            own[i] = entry * keep - gain[i] * share;
            gain[i] += entry * f;
        }
    }
    const double step = innovation / alpha;
    for (uint32_t i = 0; i < self->entries; i++) {
        self->x[i] += gain[i] * step;
    }
    self->count[channel] += 1.0;
    self->square[channel] += innovation * step;
    scale_volume(self, alpha);
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

void zygos_refiner_read(zygos_refiner_t *self, const zygos_config_t *config, const double *q, const double *theta,
                        const double *omega, zygos_refiner_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t w = self->propagation.base_rates;
    const uint32_t zero = self->entries - 2u * n;
    for (uint32_t side = 0; side < 2u; side++) {
        for (uint32_t i = 0; i < n; i++) {
            const zygos_joint_config_t *joint = &config->joint[i];
            const uint32_t at = side * n + i;
            const double late =
                1e-6 * (double)joint->latch_us + ((side == 0u) ? joint->link_latch_s : joint->motor_latch_s);
            const double sigma = (side == 0u) ? self->settings.link_sigma[i] : self->settings.motor_sigma[i];
            const reading_t reading = { (self->settings.zeros != 0u) ? 3u : 2u,
                                        { w + at, w + 2u * n + at, zero + at },
                                        { 1.0, late, 1.0 } };
            update(self, &reading, (side == 0u) ? q[i] : theta[i], sigma * sigma, side, work->gain);
        }
    }
    const double rough = self->settings.second_order * rate_variance(self, n);
    const double variance = self->settings.gyro_sigma * self->settings.gyro_sigma + rough * rough;
    for (uint32_t k = 0; k < w; k++) {
        const double *axis = config->joint[0].axis;
        const double rate = (w == 3u) ? omega[k] : axis[0] * omega[0] + axis[1] * omega[1] + axis[2] * omega[2];
        const reading_t reading = { 2u, { k, self->propagation.moving + k, 0u }, { 1.0, 1.0, 0.0 } };
        update(self, &reading, rate, variance, ZYGOS_CHANNEL_GYRO, work->gain);
    }
}

/* The upper triangular R with R R' = T T' of the table T, by the modified method of Gram and Schmidt from the last row
 * on, into the root. */
static void triangularise(zygos_refiner_t *self, uint32_t columns, zygos_refiner_work_t *work)
{
    for (uint32_t j = self->fast; j > 0u; j--) {
        const uint32_t at = j - 1u;
        double *own = &self->root[column(at)];
        double *row = work->table[at];
        double square = 0.0;
        for (uint32_t c = 0; c < columns; c++) {
            square += row[c] * row[c];
        }
        own[at] = __builtin_sqrt(square);
        const double scale = (square > 0.0) ? 1.0 / own[at] : 0.0;
        for (uint32_t c = 0; c < columns; c++) {
            row[c] *= scale;
        }
        for (uint32_t i = 0; i < at; i++) {
            double *other = work->table[i];
            double product = 0.0;
            for (uint32_t c = 0; c < columns; c++) {
                product += other[c] * row[c];
            }
            own[i] = product;
            for (uint32_t c = 0; c < columns; c++) {
                other[c] -= product * row[c];
            }
        }
    }
}

/* The table whose square is the covariance of state and bias after the period. Returns the number of its columns. */
static uint32_t tabulate(zygos_refiner_t *self, uint32_t n, const double *noise, zygos_refiner_work_t *work)
{
    const uint32_t moving = self->propagation.moving;
    const uint32_t w = self->propagation.base_rates;
    const uint32_t columns = self->fast + n + w;
    const uint32_t torques = moving + self->propagation.parameters + ((self->settings.friction != 0u) ? n : 0u);
    for (uint32_t i = 0; i < self->fast; i++) {
        memset(work->table[i], 0, columns * sizeof work->table[i][0]);
    }
    for (uint32_t j = 0; j < self->fast; j++) {
        const double *own = &self->root[column(j)];
        const uint32_t last = (j < moving) ? j + 1u : moving;
        for (uint32_t i = 0; i < moving; i++) {
            double sum = 0.0;
            for (uint32_t k = 0; k < last; k++) {
                sum += work->slope[i][k] * own[k];
            }
            work->table[i][j] = sum;
        }
        for (uint32_t i = moving; i <= j; i++) {
            work->table[i][j] = own[i];
        }
    }
    for (uint32_t k = 0; k < n; k++) {
        for (uint32_t i = 0; i < moving; i++) {
            work->table[i][self->fast + k] = work->slope[i][torques + k] * noise[k];
        }
    }
    for (uint32_t k = 0; k < w; k++) {
        work->table[moving + k][self->fast + n + k] = self->settings.bias_walk;
    }
    return columns;
}

/* Moves the columns of the constants in the root: how the state depends on them. */
static void carry(zygos_refiner_t *self, uint32_t n, zygos_refiner_work_t *work)
{
    const uint32_t moving = self->propagation.moving;
    const uint32_t p = self->propagation.parameters;
    const uint32_t friction = (self->settings.friction != 0u) ? n : 0u;
    const uint32_t offsets = (self->settings.offsets != 0u) ? n : 0u;
    for (uint32_t c = 0; c < self->constants; c++) {
        double *own = &self->root[column(self->fast + c)];
        const double *below = &own[self->fast];
        const uint32_t depends = p + friction + offsets;
        const uint32_t last = (c < depends) ? c + 1u : depends;
        for (uint32_t i = 0; i < moving; i++) {
            const double *slope = work->slope[i];
            double sum = 0.0;
            for (uint32_t k = 0; k < moving; k++) {
                sum += slope[k] * own[k];
            }
            for (uint32_t k = 0; k < last; k++) {
                /* an offset is what a torque is reported too large by */
                const bool offset = (k >= p + friction);
                const double factor = (k < p) ? self->settings.size[k] : (offset ? -1.0 : 1.0);
                sum += factor * slope[moving + k] * below[k];
            }
            work->moved[i] = sum;
        }
        memcpy(own, work->moved, moving * sizeof own[0]);
    }
}

bool zygos_refiner_advance(zygos_refiner_t *self, const zygos_config_t *config, const double *tau, double lost,
                           zygos_refiner_work_t *work)
{
    const uint32_t n = config->joints;
    const uint32_t p = self->propagation.parameters;
    const uint32_t friction = (self->settings.friction != 0u) ? n : 0u;
    const double *constant = &self->x[self->fast];
    double drive[ZYGOS_MAX_JOINTS];
    double noise[ZYGOS_MAX_JOINTS];
    if (self->failed != 0u) {
        return false;
    }
    for (uint32_t k = 0; k < p + friction; k++) {
        work->constant[k] = constant[k] * ((k < p) ? self->settings.size[k] : 1.0);
    }
    for (uint32_t i = 0; i < n; i++) {
        const double relative = self->settings.torque_relative_sigma[i] * tau[i];
        const double own = self->settings.torque_sigma[i];
        drive[i] = tau[i] - ((self->settings.offsets != 0u) ? constant[p + friction + i] : 0.0);
        noise[i] = __builtin_sqrt(own * own + relative * relative + lost * lost);
    }
    zygos_dynamics_set(&work->dynamics, &self->propagation, config, work->constant);
    bool good =
        zygos_propagate(&self->propagation, config, &work->dynamics, self->x, drive, work->slope, &work->propagation);
    for (uint32_t k = 0; k < self->propagation.moving; k++) {
        good = good && within(self->x[k], -1e6, 1e6);
    }
    if (!good) {
        self->failed = 1u;
        return false;
    }
    const uint32_t columns = tabulate(self, n, noise, work);
    carry(self, n, work);
    triangularise(self, columns, work);
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
