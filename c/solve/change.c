/* SPDX-License-Identifier: MIT */
#include "zygos/priv/change.h"

#include "zygos/priv/effects.h"
#include "zygos/priv/numbers.h"
#include "zygos/priv/solver.h"

#include <string.h>

/* A diagonal entry of the factor below this share of that of the matrix is of a column that the rows do not determine.
 */
#define LEAST_PIVOT 1e-6
/* What the noise at the ends of an arc adds to the scatter, as so many windows of the smoother would. */
#define ENDS 24.0
/* Additions to the sums that are held: two for each part of a task that has added to a block. */
#define HELD_ADDS 1024.0

/* The newest rows, and memory for their solution: triangles and vectors in the buffers of the energy rows, which are
   empty when arcs have ended. */
typedef struct {
    const zygos_guard_t *guard;
    const double *gram;  /* Sums of products without constants, the right side last. */
    double *noise;       /* The declared noise, */
    double share;        /* of which this share was subtracted. */
    double torque_noise; /* What that of the torques adds to the mean square besides. */
    double *factor;      /* Cholesky factor of the scaled matrix; 0 where the running solution's value is kept. */
    double *scale;
    double *shift; /* From the running solution to that of these rows. */
    double *column;
    double instants;
    double square; /* Mean square of the residuals, times the correlation of rows. */
    double arcs;
    uint32_t columns; /* Without the gains, of which the prior tells more than one arc, */
    uint32_t gains;   /* and these, which are the last. */
} newest_t;

/* An entry of the sums from which as much noise is subtracted as from those of the running solution. */
static double newest_entry(const newest_t *self, uint32_t i, uint32_t j)
{
    return zygos_gram_entry(self->gram, i, j) + (1.0 - self->share) * zygos_gram_entry(self->noise, i, j);
}

/* Cholesky factor of the matrix, scaled by its diagonal with the noise. */
static void factorise_newest(const newest_t *self)
{
    for (uint32_t i = 0; i < self->columns; i++) {
        const double square = zygos_gram_entry(self->gram, i, i) + zygos_gram_entry(self->noise, i, i);
        self->scale[i] = (square > 0.0) ? 1.0 / __builtin_sqrt(square) : 0.0;
        double *row = &self->factor[zygos_gram_entries(i)];
        for (uint32_t j = 0; j <= i; j++) {
            const double *other = &self->factor[zygos_gram_entries(j)];
            double sum = newest_entry(self, i, j) * self->scale[i] * self->scale[j];
            for (uint32_t k = 0; k < j; k++) {
                sum -= row[k] * other[k];
            }
            if (i == j) {
                row[j] = (sum > LEAST_PIVOT) ? __builtin_sqrt(sum) : 0.0;
            } else {
                row[j] = (other[j] > 0.0) ? sum / other[j] : 0.0;
            }
        }
    }
}

/* x := A^-1 x of the columns that are determined, 0 of the others. */
static void solve_newest(const newest_t *self, double *x)
{
    const uint32_t n = self->columns;
    for (uint32_t i = 0; i < n; i++) {
        const double *row = &self->factor[zygos_gram_entries(i)];
        double sum = x[i] * self->scale[i];
        for (uint32_t j = 0; j < i; j++) {
            sum -= row[j] * x[j];
        }
        x[i] = (row[i] > 0.0) ? sum / row[i] : 0.0;
    }
    for (uint32_t i = n; i-- > 0;) {
        const double own = zygos_gram_entry(self->factor, i, i);
        double sum = x[i];
        for (uint32_t j = i + 1u; j < n; j++) {
            sum -= zygos_gram_entry(self->factor, j, i) * x[j];
        }
        x[i] = (own > 0.0) ? sum / own : 0.0;
    }
    for (uint32_t i = 0; i < n; i++) {
        x[i] *= self->scale[i];
    }
}

/* x' G x of the sums with their noise. */
static double newest_form(const newest_t *self, const double *x, uint32_t n)
{
    return zygos_gram_form(self->gram, x, n) + zygos_gram_form(self->noise, x, n);
}

/* Solves the rows for the shift from the running solution: what it leaves of the right side, times A^-1. */
static void shift_to_newest(const newest_t *self)
{
    const uint32_t p = self->columns + self->gains;
    factorise_newest(self);
    for (uint32_t i = 0; i < self->columns; i++) {
        self->shift[i] = newest_entry(self, p, i);
        for (uint32_t j = 0; j < p; j++) {
            self->shift[i] -= newest_entry(self, i, j) * self->guard->solution[j];
        }
    }
    solve_newest(self, self->shift);
}

/* Whether the residuals of this solution are noise. Writes what a row scatters. */
static bool is_explained(newest_t *self, const zygos_config_t *config)
{
    const uint32_t p = self->columns + self->gains;
    const zygos_guard_t *guard = self->guard;
    const double window = 2.0 * (double)config->smoother_half_width + 1.0;
    for (uint32_t i = 0; i < p; i++) {
        self->column[i] = guard->solution[i] + ((i < self->columns) ? self->shift[i] : 0.0);
    }
    self->column[p] = -1.0;
    const double left = newest_form(self, self->column, p + 1u);
    const double declared = zygos_gram_form(self->noise, self->column, p + 1u) + self->torque_noise * self->instants;
    const double known = guard->energy.residual * self->instants;
    const double expected = zygos_larger(guard->noise_ratio * declared, known);
    self->square =
        zygos_larger(left, known) / self->instants * (guard->cluster + ENDS * window * self->arcs / self->instants);
    return left <= zygos_guard_chi_square_limit(self->instants / window) * expected +
                       ZYGOS_GUARD_SHARE * ZYGOS_GUARD_SHARE * zygos_gram_entry(self->gram, p, p);
}

static void compare_newest(const newest_t *self, zygos_change_t *out)
{
    for (uint32_t i = 0; i < self->columns; i++) {
        memset(self->column, 0, self->columns * sizeof self->column[0]);
        self->column[i] = 1.0;
        solve_newest(self, self->column);
        const double scatter = self->square * newest_form(self, self->column, self->columns);
        if (zygos_gram_entry(self->factor, i, i) > 0.0) {
            out->deviation[i] =
                self->shift[i] / __builtin_sqrt(zygos_gram_entry(self->guard->covariance, i, i) + scatter);
        }
    }
}

/* Whether there are enough of them among all instants, and those that are held are whole. */
static bool are_enough(const zygos_sums_t *sums, const newest_t *self, uint32_t width, double all)
{
    if (!(self->instants > 0.0) || !(all > 0.0)) {
        return false;
    }
    if (zygos_joint_sums_suffice(&sums->config)) {
        return sums->guard.changed != 0;
    }
    return (self->instants >= zygos_guard_enough(&sums->config, width - 1u)) &&
           !(zygos_gram_check(self->gram, width, sums->guard.held.sum, HELD_ADDS) > 1.0);
}

/* Chooses the sums that are held of energy rows, or the segments of joint rows that were set aside, and shares out the
   declared noise of all. Returns whether there are enough of them. */
static bool choose_newest(zygos_sums_t *sums, newest_t *self, zygos_change_t *out)
{
    const zygos_config_t *config = &sums->config;
    const uint32_t width = self->columns + self->gains + 1u;
    const bool joints = zygos_joint_sums_suffice(config);
    const double aside = sums->joints.count[ZYGOS_SET_ASIDE];
    const double all = joints ? zygos_joint_sums_rows(&sums->joints)
                              : zygos_store_instants(&sums->energy.store, (uint32_t)ZYGOS_ENERGY_ROWS);
    self->instants = joints ? aside : sums->guard.held_instants;
    self->gram = joints ? sums->joints.group[ZYGOS_SET_ASIDE].gram : sums->guard.held.gram;
    self->arcs = joints ? 0.0 : (double)sums->guard.held_arcs;
    self->torque_noise = joints ? zygos_joint_sums_torque_noise(&sums->joints, config) : 0.0;
    out->until = joints ? sums->guard.agreed : sums->guard.held_after;
    if (!are_enough(sums, self, width, all)) {
        return false;
    }
    const double *noise = joints ? sums->joints.noise.gram : sums->energy.noise_closed.gram;
    for (uint32_t k = 0; k < zygos_gram_entries(width); k++) {
        self->noise[k] = self->instants / all * noise[k];
    }
    return true;
}

void zygos_change_compare(zygos_sums_t *sums, zygos_change_t *out)
{
    const uint32_t p = sums->column_map.parameters;
    zygos_row_buffer_t *buffer = sums->energy.buffer;
    const double ratio = sums->guard.noise_ratio;
    double *rows = buffer[0].pair[0][0];
    newest_t newest = { .guard = &sums->guard,
                        .noise = buffer[0].gram,
                        .factor = buffer[1].gram,
                        .scale = rows,
                        .shift = &rows[p + 1u],
                        .column = &rows[2u * (p + 1u)],
                        .share = ((ratio > 0.0) && (ratio < ZYGOS_OVERDECLARED)) ? ratio : 1.0,
                        .gains = zygos_effects_gains(&sums->config) };
    newest.columns = p - newest.gains;
    memset(out, 0, sizeof *out);
    out->reason = ZYGOS_REASON_NO_DATA;
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_PARAMETERS; i++) {
        out->deviation[i] = (double)__builtin_nanf("");
    }
    if (zygos_guard_has_solution(&sums->guard, p) && choose_newest(sums, &newest, out)) {
        shift_to_newest(&newest);
        out->reason = is_explained(&newest, &sums->config) ? ZYGOS_REASON_NONE : ZYGOS_REASON_UNCLOSED;
        compare_newest(&newest, out);
    }
    memset(buffer[0].gram, 0, sizeof buffer[0].gram);
    memset(buffer[1].gram, 0, sizeof buffer[1].gram);
}

bool zygos_change_found(const zygos_change_t *self)
{
    bool found = false;
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_PARAMETERS; i++) {
        found = found || (self->deviation[i] >= ZYGOS_CHANGE_ALARM) || (self->deviation[i] <= -ZYGOS_CHANGE_ALARM);
    }
    return found && (self->reason == (uint32_t)ZYGOS_REASON_NONE);
}
