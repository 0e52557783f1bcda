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

void zygos_kinematics(const zygos_config_t *config, const zygos_state_t *state, zygos_motion_t *out)
{
    const uint32_t n = config->joints;
    const double *axis = config->joint[0].axis;
    double x[ZYGOS_MAX_JOINTS + 1];
    double y[ZYGOS_MAX_JOINTS + 1];
    double rate = axis[0] * state->omega[0] + axis[1] * state->omega[1] + axis[2] * state->omega[2];
    double angle = 0.0;
    x[0] = rate;
    y[0] = 0.0;
    for (uint32_t i = 0; i < n; i++) {
        out->carrier_rate[i] = rate;
        rate += state->q_rate[i];
        angle += state->q[i];
        double s;
        double c;
        zygos_sincos(angle, &s, &c);
        x[i + 1] = rate * c;
        y[i + 1] = rate * s;
    }
    uint32_t k = 0;
    for (uint32_t i = 0; i <= n; i++) {
        for (uint32_t j = i; j <= n; j++) {
            out->gram[k] = x[i] * x[j] + y[i] * y[j];
            k++;
        }
    }
}
