/* SPDX-License-Identifier: MIT */
#include "zygos/priv/kinematics.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <string.h>

/* Cody-Waite: pi/2 in three parts of 33, 33 and 53 bits, so that quadrant * part is exact for the first two. */
#define PIO2_1 1.5707963267341256
#define PIO2_2 6.077100506303966e-11
#define PIO2_3 2.0222662487959506e-21
#define TWO_OVER_PI 0.63661977236758134308

void zygos_sincos(double angle, double *sine, double *cosine)
{
    /* Adding 1.5 * 2^52 rounds to the nearest integer; the low bits of the sum are the quadrant. */
    const double magic = 6755399441055744.0;
    const double shifted = angle * TWO_OVER_PI + magic;
    const uint64_t bits = zygos_bits_of(shifted);
    const double quadrant = shifted - magic;

    /* angle - quadrant * pi/2 as r + tail, |r| <= pi/4 and a little. */
    const double high = angle - quadrant * PIO2_1;
    const double middle = quadrant * PIO2_2;
    const double first = high - middle;
    const double error = (high - first) - middle;
    const double low = quadrant * PIO2_3;
    const double r = first + (error - low);
    const double tail = ((first - r) + error) - low;

    const double z = r * r;
    const double ps =
        -0.16666666666666666 +
        z * (0.008333333333333331 +
             z * (-0.0001984126984126506 +
                  z * (2.7557319219335453e-06 +
                       z * (-2.5052106231157904e-08 + z * (1.605853141458901e-10 + z * (-7.586685070091267e-13))))));
    const double pc =
        0.041666666666666664 +
        z * (-0.0013888888888888887 +
             z * (2.4801587301584645e-05 +
                  z * (-2.755731922140076e-07 +
                       z * (2.0876755790363397e-09 + z * (-1.1470460773969325e-11 + z * (4.7458652037874553e-14))))));
    /* sin(r + t) = r + (t + r^3 (S1 + ...) - t z/2); the leading terms are added last. */
    const double s = r + (tail + (r * z * ps - 0.5 * z * tail));
    /* cos(r + t) = 1 - z/2 + z^2 (...) - r t, with the rounding error of 1 - z/2 put back. */
    const double half = 0.5 * z;
    const double one = 1.0 - half;
    const double c = one + (((1.0 - one) - half) + (z * z * pc - r * tail));

    /* Odd quadrants swap; 0 * x + 1 * y is exact. */
    const double odd = (double)(bits & 1u);
    const double even = 1.0 - odd;
    const double sine_sign = 1.0 - (double)(bits & 2u);
    const double cosine_sign = 1.0 - (double)((bits + 1u) & 2u);
    *sine = sine_sign * (even * s + odd * c);
    *cosine = cosine_sign * (even * c + odd * s);
}

void zygos_perpendicular(const double *axis, double *u, double *v)
{
    uint32_t largest = 0;
    for (uint32_t k = 1; k < 3; k++) {
        largest = (zygos_magnitude(axis[k]) > zygos_magnitude(axis[largest])) ? k : largest;
    }
    const double sign = (axis[largest] < 0.0) ? -1.0 : 1.0;
    const double scale = 1.0 / (1.0 + zygos_magnitude(axis[largest]));
    double *out[2] = { u, v };
    for (uint32_t i = 0; i < 2; i++) {
        const uint32_t next = (largest + 1u + i) % 3u;
        for (uint32_t k = 0; k < 3; k++) {
            const double mirror = axis[k] + ((k == largest) ? sign : 0.0);
            out[i][k] = ((k == next) ? 1.0 : 0.0) - axis[next] * scale * mirror;
        }
    }
}

/* out = a b, row-major 3 x 3. */
static void product33(const double *a, const double *b, double *out)
{
    for (uint32_t i = 0; i < 3; i++) {
        for (uint32_t j = 0; j < 3; j++) {
            out[3u * i + j] = a[3u * i] * b[j] + a[3u * i + 1u] * b[3u + j] + a[3u * i + 2u] * b[6u + j];
        }
    }
}

void zygos_geometry_init(zygos_geometry_t *self, const zygos_config_t *config)
{
    double before[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 }; /* frame of the body before, transposed */
    double attitude[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    static const double aligned[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    const double *g = config->gravity;
    uint32_t has_gravity = 0;
    memset(self, 0, sizeof *self);
    for (uint32_t i = 0; i < config->joints; i++) {
        const double *mount = (config->kinetic == ZYGOS_SPATIAL_ARM) ? config->joint[i].frame : aligned;
        const double *axis = config->joint[(config->kinetic == ZYGOS_SPATIAL_ARM) ? i : 0u].axis;
        double frame[3][3]; /* rows: u, v, axis */
        double normal[3];
        zygos_perpendicular(axis, frame[0], frame[1]);
        memcpy(frame[2], axis, sizeof frame[2]);
        zygos_cross3(frame[0], frame[1], normal);
        self->handedness[i] = (zygos_dot3(normal, axis) < 0.0) ? -1.0 : 1.0;
        double columns[9];
        double mounted[9];
        for (uint32_t k = 0; k < 9; k++) {
            columns[k] = frame[k % 3u][k / 3u];
        }
        product33(mount, columns, mounted);
        product33(before, mounted, self->rotation[i]);
        memcpy(before, frame, sizeof before);

        double turned[9];
        double moment[3];
        product33(attitude, mount, turned);
        memcpy(attitude, turned, sizeof attitude);
        const double z[3] = { zygos_dot3(&turned[0], axis), zygos_dot3(&turned[3], axis),
                              zygos_dot3(&turned[6], axis) };
        zygos_cross3(z, g, moment);
        has_gravity |= (zygos_dot3(moment, moment) > 1e-18 * zygos_dot3(g, g)) ? 1u : 0u;
        self->has_gravity[i] = has_gravity;
    }
    double u[3];
    double v[3];
    zygos_perpendicular(config->joint[0].axis, u, v);
    self->plane_gravity[0] = -zygos_dot3(g, u);
    self->plane_gravity[1] = -self->handedness[0] * zygos_dot3(g, v);
}

uint32_t zygos_kinetic_parameters(const zygos_config_t *config)
{
    const uint32_t n = config->joints;
    const uint32_t free = (config->base == ZYGOS_BASE_FREE) ? 1u : 0u;
    if (config->kinetic == ZYGOS_SPATIAL_ARM) {
        return free ? (n + 2u) * (2u * n + 3u) : 2u * n * n + n - 2u;
    }
    const uint32_t bodies = n + free;
    return (config->kinetic == ZYGOS_PLANAR) ? bodies * bodies : bodies * (bodies + 1u) / 2u;
}

uint32_t zygos_gravity_parameters(const zygos_config_t *config)
{
    zygos_geometry_t geometry;
    zygos_geometry_init(&geometry, config);
    uint32_t count = 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        count += 2u * geometry.has_gravity[i];
    }
    return count;
}

/* out_ab += x_a . y_b for first <= a <= b < count, halved for a = b. Returns the place behind them. */
static double *gram(const double (*x)[3], const double (*y)[3], uint32_t first, uint32_t count, double *out)
{
    for (uint32_t a = first; a < count; a++) {
        *out += 0.5 * zygos_dot3(x[a], y[a]);
        out++;
        for (uint32_t b = a + 1u; b < count; b++) {
            *out += zygos_dot3(x[a], y[b]);
            out++;
        }
    }
    return out;
}

static double *spatial_products(const zygos_config_t *config, const double (*x)[3], const double (*y)[3], double *out)
{
    const uint32_t n = config->joints;
    if (config->base == ZYGOS_BASE_FREE) {
        return gram(x, y, 0, 2u * n + 3u, out);
    }
    /* Body 1 turns about its axis only: N[1u,1u] and N[1v,1v] share a column, and N[1u,1v] has none. */
    *out += 0.5 * zygos_dot3(x[0], y[0]);
    out++;
    for (uint32_t a = 0; a < 2; a++) {
        for (uint32_t b = 2; b < 2u * n; b++) {
            *out += zygos_dot3(x[a], y[b]);
            out++;
        }
    }
    return gram(x, y, 2, 2u * n, out);
}

static double *planar_products(const zygos_config_t *config, const double (*x)[3], const double (*y)[3], double *out)
{
    const uint32_t n = config->joints;
    const uint32_t first = (config->base == ZYGOS_BASE_FREE) ? 0u : 1u;
    for (uint32_t i = first; i <= n; i++) {
        *out += 0.5 * (x[i][0] * y[i][0] + x[i][1] * y[i][1]);
        out++;
        for (uint32_t j = i + 1u; j <= n; j++) {
            *out += x[i][0] * y[j][0] + x[i][1] * y[j][1];
            out++;
        }
    }
    for (uint32_t i = first; (i <= n) && (config->kinetic == ZYGOS_PLANAR); i++) {
        for (uint32_t j = i + 1u; j <= n; j++) {
            *out += x[i][0] * y[j][1] - x[i][1] * y[j][0];
            out++;
        }
    }
    return out;
}

double *zygos_kinetic_products(const zygos_config_t *config, const double (*x)[3], const double (*y)[3], double *out)
{
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        return spatial_products(config, x, y, out);
    }
    return planar_products(config, x, y, out);
}

/* pull[2i], pull[2i + 1] of the joints that feel gravity. */
static void gravity_columns(const zygos_geometry_t *self, uint32_t joints, const double *gravity, double *column)
{
    for (uint32_t i = 0; i < joints; i++) {
        if (self->has_gravity[i] != 0u) {
            column[0] = gravity[2u * i];
            column[1] = gravity[2u * i + 1u];
            column += 2;
        }
    }
}

static void planar(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                   zygos_motion_t *out)
{
    const uint32_t n = config->joints;
    double gravity[2 * ZYGOS_MAX_JOINTS];
    double rate = (config->base == ZYGOS_BASE_FREE) ? zygos_dot3(config->joint[0].axis, state->omega) : 0.0;
    double angle = 0.0;
    out->direction[0][0] = 1.0;
    out->direction[0][1] = 0.0;
    out->rate[0][0] = rate;
    out->rate[0][1] = 0.0;
    for (uint32_t i = 0; i < n; i++) {
        out->carrier_rate[i] = rate;
        rate += state->q_rate[i];
        angle += state->q[i];
        double s;
        double c;
        zygos_sincos(angle, &s, &c);
        out->direction[i + 1][0] = c;
        out->direction[i + 1][1] = s;
        out->rate[i + 1][0] = rate * c;
        out->rate[i + 1][1] = rate * s;
        gravity[2u * i] = c * self->plane_gravity[0] + s * self->plane_gravity[1];
        gravity[2u * i + 1u] = self->handedness[0] * (c * self->plane_gravity[1] - s * self->plane_gravity[0]);
    }
    memset(out->column, 0, zygos_kinetic_parameters(config) * sizeof out->column[0]);
    double *column = planar_products(config, (const double(*)[3])out->rate, (const double(*)[3])out->rate, out->column);
    gravity_columns(self, n, gravity, column);
}

static void spatial(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                    zygos_motion_t *out)
{
    const uint32_t n = config->joints;
    double gravity[2 * ZYGOS_MAX_JOINTS];
    double omega[3] = { 0.0, 0.0, 0.0 };
    uint32_t count = 0;
    if (config->base == ZYGOS_BASE_FREE) {
        static const double base[3][3] = { { 1.0, 0.0, 0.0 }, { 0.0, 1.0, 0.0 }, { 0.0, 0.0, 1.0 } };
        memcpy(omega, state->omega, sizeof omega);
        const double own[3][3] = { { 0.0, omega[2], -omega[1] },
                                   { -omega[2], 0.0, omega[0] },
                                   { omega[1], -omega[0], 0.0 } };
        memcpy(out->rate, own, sizeof own);
        memcpy(out->direction, base, sizeof base);
        count = 3;
    }
    double frame[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 }; /* columns: u, v, axis of the body before */
    for (uint32_t i = 0; i < n; i++) {
        double turned[9];
        product33(frame, self->rotation[i], turned);
        double s;
        double c;
        zygos_sincos(self->handedness[i] * state->q[i], &s, &c);
        double *u = out->direction[count];
        double *v = out->direction[count + 1u];
        double *axis = out->axis[i];
        memcpy(out->spin[i], omega, sizeof omega);
        for (uint32_t k = 0; k < 3; k++) {
            axis[k] = turned[3u * k + 2u];
            u[k] = c * turned[3u * k] + s * turned[3u * k + 1u];
            v[k] = c * turned[3u * k + 1u] - s * turned[3u * k];
            frame[3u * k] = u[k];
            frame[3u * k + 1u] = v[k];
            frame[3u * k + 2u] = axis[k];
        }
        out->carrier_rate[i] = zygos_dot3(axis, omega);
        for (uint32_t k = 0; k < 3; k++) {
            omega[k] += axis[k] * state->q_rate[i];
        }
        zygos_cross3(omega, u, out->rate[count]);
        zygos_cross3(omega, v, out->rate[count + 1u]);
        count += 2u;
        gravity[2u * i] = -zygos_dot3(config->gravity, u);
        gravity[2u * i + 1u] = -zygos_dot3(config->gravity, v);
    }
    memset(out->column, 0, zygos_kinetic_parameters(config) * sizeof out->column[0]);
    double *column =
        spatial_products(config, (const double(*)[3])out->rate, (const double(*)[3])out->rate, out->column);
    gravity_columns(self, n, gravity, column);
}

void zygos_kinematics(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_arm_state_t *state,
                      zygos_motion_t *out)
{
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        spatial(self, config, state, out);
    } else {
        planar(self, config, state, out);
    }
}

/* A vector in the plane, or the one across it. */
static inline void turned_by(bool skew, const double *x, double *out)
{
    out[0] = skew ? x[1] : x[0];
    out[1] = skew ? -x[0] : x[1];
}

/* Pairs of bodies that joint i both carries turn together: only their rates tell of it. */
static double *planar_slopes(const zygos_config_t *config, const zygos_motion_t *motion, uint32_t i, double *by_angle,
                             double *by_rate)
{
    double unused[ZYGOS_MAX_BODY];
    by_rate = (by_rate != NULL) ? by_rate : unused;
    const uint32_t n = config->joints;
    const uint32_t first = (config->base == ZYGOS_BASE_FREE) ? 0u : 1u;
    for (uint32_t skew = 0; skew < ((config->kinetic == ZYGOS_PLANAR) ? 2u : 1u); skew++) {
        for (uint32_t a = first; a <= n; a++) {
            for (uint32_t b = a + skew; b <= n; b++) {
                const double *v = motion->rate[a];
                const double *d = motion->direction[a];
                double w[2];
                double e[2];
                turned_by(skew != 0, motion->rate[b], w);
                turned_by(skew != 0, motion->direction[b], e);
                const double both = (a > i) ? d[0] * w[0] + d[1] * w[1] : 0.0;
                const double later = v[0] * e[0] + v[1] * e[1];
                const double turned = v[1] * w[0] - v[0] * w[1];
                *by_angle = ((b > i) && (a <= i)) ? turned : 0.0;
                *by_rate = (b > i) ? ((a == b) ? later : later + both) : 0.0;
                by_angle++;
                by_rate++;
            }
        }
    }
    return by_angle;
}

/* out_ab = v_a . t_b + t_a . v_b for b from the given one on, halved for a = b, where t is 0 for the directions before
   begin. Returns the place behind them. */
static double *carried_products(const double (*v)[3], const double (*t)[3], uint32_t begin, uint32_t a, uint32_t b,
                                uint32_t count, double *out)
{
    for (; (b < count) && (b < begin); b++) {
        *out = 0.0;
        out++;
    }
    for (; b < count; b++) {
        const double later = zygos_dot3(v[a], t[b]);
        *out = (a == b) ? later : later + ((a >= begin) ? zygos_dot3(t[a], v[b]) : 0.0);
        out++;
    }
    return out;
}

/* The same for all pairs, in the order of spatial_products(). */
static void turned_products(const zygos_config_t *config, const double (*v)[3], const double (*t)[3], uint32_t begin,
                            double *out)
{
    const bool free = (config->base == ZYGOS_BASE_FREE);
    const uint32_t count = 2u * config->joints + (free ? 3u : 0u);
    if (!free) {
        *out = (begin == 0) ? zygos_dot3(v[0], t[0]) : 0.0;
        out++;
    }
    for (uint32_t a = 0; a < count; a++) {
        out = carried_products(v, t, begin, a, (!free && (a < 2u)) ? 2u : a, count, out);
    }
}

/* The directions of the bodies that joint i carries follow its axis by the right hand; the axes of the joints behind it
   do, too, so that a body's rate vector w x d turns as a whole, but for the share of w that joint i does not carry. */
static double *spatial_slopes(const zygos_config_t *config, const zygos_motion_t *motion, uint32_t i, double *by_angle,
                              double *by_rate, double (*moved)[3])
{
    const uint32_t n = config->joints;
    const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? 3u : 0u;
    const uint32_t kinetic = zygos_kinetic_parameters(config);
    const double(*v)[3] = motion->rate;
    const double *axis = motion->axis[i];
    const uint32_t begin = base + 2u * i; /* those before it do not turn, and are not read of turned */
    double turned[ZYGOS_MAX_DIRECTIONS][3];
    double lag[3];
    zygos_cross3(axis, motion->spin[i], lag);
    for (uint32_t b = begin; b < base + 2u * n; b++) {
        double behind[3];
        zygos_cross3(axis, v[b], turned[b]);
        zygos_cross3(lag, motion->direction[b], behind);
        for (uint32_t k = 0; k < 3; k++) {
            turned[b][k] -= behind[k];
        }
        zygos_cross3(axis, motion->direction[b], moved[b]);
    }
    turned_products(config, v, (const double(*)[3])turned, begin, by_angle);
    if (by_rate == NULL) {
        return by_angle + kinetic;
    }
    memset(moved, 0, begin * sizeof moved[0]);
    memset(by_rate, 0, kinetic * sizeof by_rate[0]);
    (void)spatial_products(config, v, (const double(*)[3])moved, by_rate);
    (void)spatial_products(config, (const double(*)[3])moved, v, by_rate);
    return by_angle + kinetic;
}

void zygos_kinematics_swing(const zygos_config_t *config, const zygos_motion_t *motion, const double *axis,
                            uint32_t body, double (*out)[3])
{
    const bool space = (ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? 3u : 0u;
    const uint32_t first = (space && (body > 0)) ? base + 2u * body - 2u : body;
    for (uint32_t a = 0; a < (space ? base + 2u * config->joints : config->joints + 1u); a++) {
        const double moves = (a < first) ? 0.0 : 1.0;
        if (space) {
            zygos_cross3(axis, motion->direction[a], out[a]);
        }
        for (uint32_t k = 0; k < 3; k++) {
            out[a][k] = moves * (space ? out[a][k] : ((k < 2u) ? motion->direction[a][k] : 0.0));
        }
    }
}

void zygos_kinematics_slopes(const zygos_geometry_t *self, const zygos_config_t *config, const zygos_motion_t *motion,
                             uint32_t i, double *by_angle, double *by_rate)
{
    const uint32_t n = config->joints;
    double gravity[2 * ZYGOS_MAX_JOINTS] = { 0.0 };
    double *gravity_place = NULL;
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        double moved[ZYGOS_MAX_DIRECTIONS][3];
        gravity_place = spatial_slopes(config, motion, i, by_angle, by_rate, moved);
        const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? 3u : 0u;
        for (uint32_t b = 2u * i; (b < 2u * n) && self->has_gravity[n - 1u]; b++) {
            gravity[b] = -zygos_dot3(config->gravity, moved[base + b]);
        }
    } else {
        gravity_place = planar_slopes(config, motion, i, by_angle, by_rate);
        for (uint32_t b = i; (b < n) && self->has_gravity[n - 1u]; b++) {
            const double *d = motion->direction[b + 1u];
            gravity[2u * b] = d[0] * self->plane_gravity[1] - d[1] * self->plane_gravity[0];
            gravity[2u * b + 1u] =
                -self->handedness[0] * (d[0] * self->plane_gravity[0] + d[1] * self->plane_gravity[1]);
        }
    }
    if (self->has_gravity[n - 1u] != 0u) {
        gravity_columns(self, n, gravity, gravity_place);
        if (by_rate != NULL) {
            const double none[2 * ZYGOS_MAX_JOINTS] = { 0.0 };
            gravity_columns(self, n, none, &by_rate[gravity_place - by_angle]);
        }
    }
}
