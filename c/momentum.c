#include "zygos/momentum.h"

#include <string.h>

static void cross3(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

uint32_t zygos_momentum_count(const zygos_config_t *config)
{
    if (config->base != ZYGOS_BASE_FREE) {
        return 0;
    }
    return (config->kinetic == ZYGOS_SPATIAL_ARM) ? 3u : 1u;
}

void zygos_momentum_gap(zygos_momentum_t *self)
{
    memset(self, 0, sizeof *self);
    self->origin = 1;
}

void zygos_momentum_new_arc(zygos_momentum_t *self)
{
    self->origin = 1;
}

/* Turns the attitude by one step of the base rate; at the origin of an arc it is that of the base. */
static void turn(zygos_momentum_t *self, double h, const double *omega, double keep)
{
    double angle[3];
    cross3(self->past[0], omega, angle);
    double half_square = 0.0;
    for (uint32_t k = 0; k < 3; k++) {
        const double mean = 9.0 * omega[k] + 19.0 * self->past[0][k] - 5.0 * self->past[1][k] + self->past[2][k];
        angle[k] = h / 24.0 * mean + h * h / 12.0 * angle[k];
        half_square += 0.25 * angle[k] * angle[k];
        self->past[2][k] = self->past[1][k];
        self->past[1][k] = self->past[0][k];
        self->past[0][k] = omega[k];
    }
    /* cos x and sin x / x of half the angle x, by their series: of use up to a radian a step. */
    const double z = half_square;
    const double c = 1.0 + z * (-1.0 / 2.0 + z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z / 40320.0)));
    const double s = 0.5 * (1.0 + z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z / 362880.0))));
    const double v[3] = { s * angle[0], s * angle[1], s * angle[2] };
    const double *p = self->attitude;
    double around[3];
    cross3(p, v, around);
    double turned[4] = { 0.0, 0.0, 0.0, p[3] * c - p[0] * v[0] - p[1] * v[1] - p[2] * v[2] };
    double square = turned[3] * turned[3];
    for (uint32_t k = 0; k < 3; k++) {
        turned[k] = p[3] * v[k] + c * p[k] + around[k];
        square += turned[k] * turned[k];
    }
    /* Where there is no attitude yet, 1 stands in for its length. */
    const double scale = keep / __builtin_sqrt(square + (1.0 - keep));
    for (uint32_t k = 0; k < 4; k++) {
        self->attitude[k] = scale * turned[k];
    }
    self->attitude[3] += 1.0 - keep;
}

/* What the columns are made of. */
typedef struct {
    double direction[ZYGOS_MAX_DIRECTIONS][3];
    double rate[ZYGOS_MAX_DIRECTIONS][3];
    double axis[ZYGOS_MAX_JOINTS][3]; /* of a spatial arm */
    double spin[ZYGOS_MAX_JOINTS];    /* rate of each motor after the gear */
} vectors_t;

static void spatial_columns(const zygos_config_t *config, const zygos_layout_t *layout, const vectors_t *of,
                            double (*out)[ZYGOS_MAX_MOMENTUM])
{
    const uint32_t directions = 2u * config->joints + 3u;
    uint32_t column = 0;
    for (uint32_t a = 0; a < directions; a++) {
        for (uint32_t b = a; b < directions; b++) {
            double one[3];
            double other[3];
            cross3(of->direction[a], of->rate[b], one);
            cross3(of->direction[b], of->rate[a], other);
            const double twice = (a == b) ? 0.0 : 1.0;
            for (uint32_t k = 0; k < 3; k++) {
                out[k][column] = one[k] + twice * other[k];
            }
            column++;
        }
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        for (uint32_t k = 0; k < 3; k++) {
            out[k][layout->kinetic + i] = config->joint[i].gear_ratio * of->spin[i] * of->axis[i][k];
        }
    }
}

static void planar_columns(const zygos_config_t *config, const zygos_layout_t *layout, const vectors_t *of, double *out)
{
    const uint32_t n = config->joints;
    uint32_t column = 0;
    for (uint32_t skew = 0; skew < ((config->kinetic == ZYGOS_PLANAR) ? 2u : 1u); skew++) {
        for (uint32_t i = 0; i <= n; i++) {
            for (uint32_t j = i + skew; j <= n; j++) {
                const double *d = of->direction[i];
                const double *e = of->direction[j];
                const double *v = of->rate[i];
                const double *w = of->rate[j];
                const double along = d[0] * w[0] + d[1] * w[1] + v[0] * e[0] + v[1] * e[1];
                const double across = d[0] * w[1] - d[1] * w[0] + v[0] * e[1] - v[1] * e[0];
                out[column] = skew ? across : ((i == j) ? 0.5 * along : along);
                column++;
            }
        }
    }
    for (uint32_t i = 0; i < n; i++) {
        out[layout->kinetic + i] = config->joint[i].gear_ratio * of->spin[i];
    }
}

static void columns(const zygos_config_t *config, const zygos_layout_t *layout, const vectors_t *of,
                    zygos_momentum_rows_t *out)
{
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        spatial_columns(config, layout, of, out->column);
    } else {
        planar_columns(config, layout, of, out->column[0]);
    }
}

/* Turns vectors from base axes to those of the arc's origin. */
static void to_origin(const double *quaternion, uint32_t count, double (*vector)[3])
{
    for (uint32_t c = 0; c < count; c++) {
        double once[3];
        double twice[3];
        cross3(quaternion, vector[c], once);
        cross3(quaternion, once, twice);
        for (uint32_t k = 0; k < 3; k++) {
            vector[c][k] += 2.0 * (quaternion[3] * once[k] + twice[k]);
        }
    }
}

int zygos_momentum_row(zygos_momentum_t *self, const zygos_config_t *config, const zygos_layout_t *layout,
                       const zygos_state_t *state, const zygos_motion_t *motion, zygos_momentum_rows_t *out)
{
    const uint32_t n = config->joints;
    const bool spatial = (config->kinetic == ZYGOS_SPATIAL_ARM);
    self->instants += (self->instants < 4u) ? 1u : 0u;
    if (spatial) {
        turn(self, config->period_s, state->omega, self->origin ? 0.0 : 1.0);
    }
    if (self->instants < 4u) {
        return 0;
    }
    self->origin = 0;
    vectors_t of;
    memcpy(of.direction, motion->direction, sizeof of.direction);
    memcpy(of.rate, motion->rate, sizeof of.rate);
    memcpy(of.axis, motion->axis, sizeof of.axis);
    memcpy(of.spin, state->theta_rate, sizeof of.spin);
    if (spatial) {
        to_origin(self->attitude, 2u * n + 3u, of.direction);
        to_origin(self->attitude, 2u * n + 3u, of.rate);
        to_origin(self->attitude, n, of.axis);
    }
    columns(config, layout, &of, out);
    return 1;
}

void zygos_momentum_derivative(const zygos_config_t *config, const zygos_layout_t *layout, const zygos_motion_t *motion,
                               uint32_t signal, zygos_momentum_rows_t *out)
{
    const uint32_t n = config->joints;
    const bool of_link = (signal < n);
    const uint32_t first = of_link ? signal + 1u : 0u; /* the first body that turns faster */
    vectors_t of;
    memcpy(of.direction, motion->direction, sizeof of.direction);
    memcpy(of.axis, motion->axis, sizeof of.axis);
    memset(of.rate, 0, sizeof of.rate);
    memset(of.spin, 0, sizeof of.spin);
    if (of_link) {
        of.spin[signal] = config->joint[signal].rigid ? 1.0 : 0.0;
    }
    if (config->kinetic == ZYGOS_SPATIAL_ARM) {
        double axis[3] = { 0.0, 0.0, 0.0 };
        if (of_link) {
            memcpy(axis, motion->axis[signal], sizeof axis);
        } else {
            axis[signal - n] = 1.0;
        }
        for (uint32_t a = of_link ? 2u * first + 1u : 0u; a < 2u * n + 3u; a++) {
            cross3(axis, of.direction[a], of.rate[a]);
        }
    } else {
        for (uint32_t i = first; i <= n; i++) {
            memcpy(of.rate[i], of.direction[i], sizeof of.rate[i]);
        }
    }
    columns(config, layout, &of, out);
}

static double sum_of_squares(const double *x, uint32_t n)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < n; j++) {
        sum += x[j] * x[j];
    }
    return sum;
}

void zygos_momentum_variance(const zygos_config_t *config, const zygos_smoother_t *smoother, double imu_sigma,
                             double *variance, double *rotor)
{
    const uint32_t n = config->joints;
    const uint32_t w = smoother->window;
    for (uint32_t i = 0; i < n; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        const double sigma = joint->rigid ? joint->motor_sigma_rad : joint->link_sigma_rad;
        const double spin = joint->gear_ratio * joint->motor_sigma_rad;
        variance[i] = sigma * sigma * sum_of_squares(smoother->slope[i], w);
        rotor[i] = joint->rigid ? 0.0 : spin * spin * sum_of_squares(smoother->slope[n + i], w);
    }
    for (uint32_t k = 0; k < 3; k++) {
        variance[n + k] = imu_sigma * imu_sigma * sum_of_squares(smoother->value[2u * n + k], w);
    }
}
