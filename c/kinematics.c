#include "zygos/kinematics.h"

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
    uint64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
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

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static double magnitude(double x)
{
    return (x < 0.0) ? -x : x;
}

void zygos_across(const double *axis, double *u, double *v)
{
    uint32_t largest = 0;
    for (uint32_t k = 1; k < 3; k++) {
        largest = (magnitude(axis[k]) > magnitude(axis[largest])) ? k : largest;
    }
    const double sign = (axis[largest] < 0.0) ? -1.0 : 1.0;
    const double scale = 1.0 / (1.0 + magnitude(axis[largest]));
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

void zygos_skeleton_init(zygos_skeleton_t *self, const zygos_config_t *config)
{
    double before[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 }; /* frame of the body before, transposed */
    double attitude[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    static const double aligned[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 };
    const double *g = config->gravity;
    uint32_t heavy = 0;
    memset(self, 0, sizeof *self);
    for (uint32_t i = 0; i < config->joints; i++) {
        const double *mount = (config->kinetic == ZYGOS_SPATIAL_ARM) ? config->joint[i].frame : aligned;
        const double *axis = config->joint[(config->kinetic == ZYGOS_SPATIAL_ARM) ? i : 0u].axis;
        double frame[3][3]; /* rows: u, v, axis */
        double normal[3];
        zygos_across(axis, frame[0], frame[1]);
        memcpy(frame[2], axis, sizeof frame[2]);
        cross3(frame[0], frame[1], normal);
        self->hand[i] = (dot3(normal, axis) < 0.0) ? -1.0 : 1.0;
        double columns[9];
        double mounted[9];
        for (uint32_t k = 0; k < 9; k++) {
            columns[k] = frame[k % 3u][k / 3u];
        }
        product33(mount, columns, mounted);
        product33(before, mounted, self->turn[i]);
        memcpy(before, frame, sizeof before);

        double turned[9];
        double moment[3];
        product33(attitude, mount, turned);
        memcpy(attitude, turned, sizeof attitude);
        const double z[3] = { dot3(&turned[0], axis), dot3(&turned[3], axis), dot3(&turned[6], axis) };
        cross3(z, g, moment);
        heavy |= (dot3(moment, moment) > 1e-18 * dot3(g, g)) ? 1u : 0u;
        self->heavy[i] = heavy;
    }
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
    zygos_skeleton_t skeleton;
    zygos_skeleton_init(&skeleton, config);
    uint32_t count = 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        count += 2u * skeleton.heavy[i];
    }
    return count;
}

/* v_a . v_b for first <= a <= b < count, halved for a = b. Returns the place behind them. */
static double *gram(double (*v)[3], uint32_t first, uint32_t count, double *out)
{
    for (uint32_t a = first; a < count; a++) {
        *out = 0.5 * dot3(v[a], v[a]);
        out++;
        for (uint32_t b = a + 1u; b < count; b++) {
            *out = dot3(v[a], v[b]);
            out++;
        }
    }
    return out;
}

/* pull[2i], pull[2i + 1] of the joints that feel gravity. */
static void gravity_columns(const zygos_skeleton_t *self, uint32_t joints, const double *pull, double *column)
{
    for (uint32_t i = 0; i < joints; i++) {
        if (self->heavy[i]) {
            column[0] = pull[2u * i];
            column[1] = pull[2u * i + 1u];
            column += 2;
        }
    }
}

/* The direction and the rate vector of body i of a planar arm. */
static void in_plane(zygos_motion_t *out, uint32_t i, double c, double s, double rate)
{
    const double direction[3] = { c, s, 0.0 };
    memcpy(out->direction[i], direction, sizeof direction);
    for (uint32_t k = 0; k < 3; k++) {
        out->rate[i][k] = rate * direction[k];
    }
}

static void planar(const zygos_skeleton_t *self, const zygos_config_t *config, const zygos_state_t *state,
                   zygos_motion_t *out)
{
    const uint32_t n = config->joints;
    const uint32_t first = (config->base == ZYGOS_BASE_FREE) ? 0u : 1u;
    double u[3];
    double v[3];
    zygos_across(config->joint[0].axis, u, v);
    const double pull_u = -dot3(config->gravity, u);
    const double pull_v = -self->hand[0] * dot3(config->gravity, v);
    double pull[2 * ZYGOS_MAX_JOINTS];
    double rate = first ? 0.0 : dot3(config->joint[0].axis, state->omega);
    double angle = 0.0;
    in_plane(out, 0, 1.0, 0.0, rate);
    for (uint32_t i = 0; i < n; i++) {
        out->carrier_rate[i] = rate;
        rate += state->q_rate[i];
        angle += state->q[i];
        double s;
        double c;
        zygos_sincos(angle, &s, &c);
        in_plane(out, i + 1u, c, s, rate);
        pull[2u * i] = c * pull_u + s * pull_v;
        pull[2u * i + 1u] = self->hand[0] * (c * pull_v - s * pull_u);
    }
    double(*rates)[3] = out->rate;
    double *column = out->column;
    for (uint32_t i = first; i <= n; i++) {
        *column = 0.5 * (rates[i][0] * rates[i][0] + rates[i][1] * rates[i][1]);
        column++;
        for (uint32_t j = i + 1u; j <= n; j++) {
            *column = rates[i][0] * rates[j][0] + rates[i][1] * rates[j][1];
            column++;
        }
    }
    for (uint32_t i = first; (i <= n) && (config->kinetic == ZYGOS_PLANAR); i++) {
        for (uint32_t j = i + 1u; j <= n; j++) {
            *column = rates[i][0] * rates[j][1] - rates[i][1] * rates[j][0];
            column++;
        }
    }
    gravity_columns(self, n, pull, column);
}

static void spatial(const zygos_skeleton_t *self, const zygos_config_t *config, const zygos_state_t *state,
                    zygos_motion_t *out)
{
    const uint32_t n = config->joints;
    const bool fixed = (config->base == ZYGOS_BASE_FIXED);
    double(*rate)[3] = out->rate;
    double pull[2 * ZYGOS_MAX_JOINTS];
    double omega[3] = { 0.0, 0.0, 0.0 };
    uint32_t count = 0;
    if (!fixed) {
        memcpy(omega, state->omega, sizeof omega);
        const double own[3][3] = { { 0.0, omega[2], -omega[1] },
                                   { -omega[2], 0.0, omega[0] },
                                   { omega[1], -omega[0], 0.0 } };
        static const double base[3][3] = { { 1.0, 0.0, 0.0 }, { 0.0, 1.0, 0.0 }, { 0.0, 0.0, 1.0 } };
        memcpy(out->direction, base, sizeof base);
        memcpy(rate, own, sizeof own);
        count = 3;
    }
    double frame[9] = { 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 }; /* columns: u, v, axis of the body before */
    for (uint32_t i = 0; i < n; i++) {
        double turned[9];
        product33(frame, self->turn[i], turned);
        double s;
        double c;
        zygos_sincos(self->hand[i] * state->q[i], &s, &c);
        double u[3];
        double v[3];
        const double axis[3] = { turned[2], turned[5], turned[8] };
        out->carrier_rate[i] = dot3(axis, omega);
        for (uint32_t k = 0; k < 3; k++) {
            u[k] = c * turned[3u * k] + s * turned[3u * k + 1u];
            v[k] = c * turned[3u * k + 1u] - s * turned[3u * k];
            frame[3u * k] = u[k];
            frame[3u * k + 1u] = v[k];
            frame[3u * k + 2u] = axis[k];
            omega[k] += axis[k] * state->q_rate[i];
        }
        memcpy(out->direction[count], u, sizeof u);
        memcpy(out->direction[count + 1u], v, sizeof v);
        memcpy(out->axis[i], axis, sizeof axis);
        cross3(omega, u, rate[count]);
        cross3(omega, v, rate[count + 1u]);
        count += 2u;
        pull[2u * i] = -dot3(config->gravity, u);
        pull[2u * i + 1u] = -dot3(config->gravity, v);
    }
    double *column = out->column;
    if (fixed) {
        /* Body 1 turns about its axis only: N[1u,1u] and N[1v,1v] share a column, and N[1u,1v] has none. */
        *column = 0.5 * dot3(rate[0], rate[0]);
        column++;
        for (uint32_t a = 0; a < 2; a++) {
            for (uint32_t b = 2; b < count; b++) {
                *column = dot3(rate[a], rate[b]);
                column++;
            }
        }
        column = gram(rate, 2, count, column);
    } else {
        column = gram(rate, 0, count, column);
    }
    gravity_columns(self, n, pull, column);
}

void zygos_kinematics(const zygos_skeleton_t *self, const zygos_config_t *config, const zygos_state_t *state,
                      zygos_motion_t *out)
{
    if ((ZYGOS_SPATIAL != 0) && (config->kinetic == ZYGOS_SPATIAL_ARM)) {
        spatial(self, config, state, out);
    } else {
        planar(self, config, state, out);
    }
}
