/* SPDX-License-Identifier: MIT */
#include "zygos/priv/solver.h"

#include "zygos/priv/numbers.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>
#include <string.h>

#define MAX_REFUSED_SHARE 0.05
#define INSTANTS_PER_PARAMETER 3u
/* The power method ends when no component changes by more, and at the latest after so many rounds. */
#define POWER_CHANGE 1e-8
#define POWER_ROUNDS 40u
/* Divisor of the mean square of a random walk about its own mean: between 6, and 15 without its trend. */
#define WALK 10.0
/* Ratio of squared residuals to noise above which a bad arc may be in the sums, from before the first running solution.
 */
#define CORRUPTED_RATIO 2.0
/* Ratio of squared residuals of joint rows to declared noise above which they are something else. */
#define NOISE_EXCEEDED 4.0
#define TWO_SIGMAS 1.959964 /* 95 % of a normal distribution */
/* Factor by which the variance of momentum rows is increased, because the noise of neighbouring rows is correlated. */
#define MOMENTUM_CORRELATION 5.0
/* The same of joint rows, whose increments share halves. */
#define JOINT_CORRELATION 2.0
/* Time in which the systematic part of joint rows counts once. */
#define SYSTEMATIC_S 60.0
/* The least share of a gain's own information that its prior is given, so that a gain which the rows do not tell apart
   from other parameters leaves the rank full. */
#define LEAST_PRIOR 1e-9

/* Place of entry (i, j), j <= i, in a packed lower triangle. */
static uint32_t entry_at(uint32_t i, uint32_t j)
{
    return zygos_gram_entries(i) + j;
}

static double not_a_number(void)
{
    return (double)__builtin_nanf("");
}

static double infinity(void)
{
    return (double)__builtin_inff();
}

/* out += factor times n numbers, four at a time. */
static void increase(double *out, const double *in, double factor, uint32_t n)
{
    const double *end = &in[n & ~3u];
    for (; in < end; in += 4, out += 4) {
        const double sum[4] = { out[0] + factor * in[0], out[1] + factor * in[1], out[2] + factor * in[2],
                                out[3] + factor * in[3] };
        for (uint32_t k = 0; k < 4u; k++) {
            out[k] = sum[k];
        }
    }
    for (end += n & 3u; in < end; in++, out++) {
        *out += factor * *in;
    }
}

/* y := A x of a symmetric matrix of order n. */
static void multiply_symmetric(const double *packed, const double *x, uint32_t n, double *y)
{
    for (uint32_t i = 0; i < n; i++) {
        const double *row = &packed[entry_at(i, 0)];
        double sum = row[i] * x[i];
        for (uint32_t j = 0; j < i; j++) {
            sum += row[j] * x[j];
            y[j] += row[j] * x[i];
        }
        y[i] = sum;
    }
}

/* Two numbers side by side, with which a processor that can reckons at once. A compiler that has to take them apart
   keeps an array of them in memory. */
#if defined(__SSE2__) || defined(__aarch64__)
typedef double both_t __attribute__((vector_size(2 * sizeof(double)), aligned(sizeof(double)), may_alias));

static inline both_t both_at(const double *x)
{
    return *(const both_t *)x;
}

static inline void put_both(double *x, both_t value)
{
    *(both_t *)x = value;
}

/* a + b c, a - b c, and (a - b) / c. */
static inline both_t increased(both_t a, both_t b, both_t c)
{
    return a + b * c;
}

static inline both_t decreased(both_t a, both_t b, both_t c)
{
    return a - b * c;
}

static inline both_t quotient(both_t a, both_t b, both_t c)
{
    return (a - b) / c;
}
#else
typedef struct {
    double first;
    double second;
} both_t;

static inline both_t both_at(const double *x)
{
    return (both_t){ x[0], x[1] };
}

static inline void put_both(double *x, both_t value)
{
    x[0] = value.first;
    x[1] = value.second;
}

static inline both_t increased(both_t a, both_t b, both_t c)
{
    return (both_t){ a.first + b.first * c.first, a.second + b.second * c.second };
}

static inline both_t decreased(both_t a, both_t b, both_t c)
{
    return (both_t){ a.first - b.first * c.first, a.second - b.second * c.second };
}

static inline both_t quotient(both_t a, both_t b, both_t c)
{
    return (both_t){ (a.first - b.first) / c.first, (a.second - b.second) / c.second };
}
#endif

/* sum += a b of two numbers side by side. */
static inline void accumulate(double *sum, const double *a, const double *b)
{
    put_both(sum, increased(both_at(sum), both_at(a), both_at(b)));
}

/* Entry k of a row of two factors side by side, or of one that stands for both. */
static inline both_t entry_of(const double *row, uint32_t factors, size_t k)
{
    return (factors == 2u) ? both_at(&row[2u * k]) : (both_t){ row[k], row[k] };
}

/* Entry k of x less a sum, divided by entry k of a row. */
static inline both_t rest_of(double (*x)[2], both_t sum, const double *row, uint32_t factors, size_t k)
{
    put_both(x[k], quotient(both_at(x[k]), sum, entry_of(row, factors, k)));
    return both_at(x[k]);
}

/* x := L^-1 x of two factors side by side, or of one for both; the rows from first to before n. What is before first is
   0. Inline, so that the compiler knows the number of factors. */
__attribute__((always_inline)) static inline void forward(const double *l, uint32_t factors, uint32_t first, uint32_t n,
                                                          double (*x)[2])
{
    uint32_t i = first;
    for (; i + 4u <= n; i += 4u) {
        const double *a = &l[factors * entry_at(i, 0)];
        const double *b = &l[factors * entry_at(i + 1u, 0)];
        const double *c = &l[factors * entry_at(i + 2u, 0)];
        const double *d = &l[factors * entry_at(i + 3u, 0)];
        both_t sum_a = { 0.0, 0.0 };
        both_t sum_b = { 0.0, 0.0 };
        both_t sum_c = { 0.0, 0.0 };
        both_t sum_d = { 0.0, 0.0 };
        for (size_t k = first; k < i; k++) {
            const both_t own = both_at(x[k]);
            sum_a = increased(sum_a, entry_of(a, factors, k), own);
            sum_b = increased(sum_b, entry_of(b, factors, k), own);
            sum_c = increased(sum_c, entry_of(c, factors, k), own);
            sum_d = increased(sum_d, entry_of(d, factors, k), own);
        }
        const both_t y = rest_of(x, sum_a, a, factors, i);
        sum_b = increased(sum_b, entry_of(b, factors, i), y);
        const both_t z = rest_of(x, sum_b, b, factors, i + 1u);
        sum_c = increased(increased(sum_c, entry_of(c, factors, i), y), entry_of(c, factors, i + 1u), z);
        const both_t v = rest_of(x, sum_c, c, factors, i + 2u);
        sum_d = increased(increased(sum_d, entry_of(d, factors, i), y), entry_of(d, factors, i + 1u), z);
        sum_d = increased(sum_d, entry_of(d, factors, i + 2u), v);
        (void)rest_of(x, sum_d, d, factors, i + 3u);
    }
    for (; i < n; i++) {
        const double *row = &l[factors * entry_at(i, 0)];
        both_t sum = { 0.0, 0.0 };
        for (size_t k = first; k < i; k++) {
            sum = increased(sum, entry_of(row, factors, k), both_at(x[k]));
        }
        (void)rest_of(x, sum, row, factors, i);
    }
}

/* x := L^-T x of the same, its entries from first on. */
__attribute__((always_inline)) static inline void backward(const double *l, uint32_t factors, uint32_t first,
                                                           uint32_t n, double (*x)[2])
{
    const both_t none = { 0.0, 0.0 };
    uint32_t i = n;
    for (; i >= first + 2u; i -= 2u) {
        const double *lower = &l[factors * entry_at(i - 1u, 0)];
        const double *upper = &l[factors * entry_at(i - 2u, 0)];
        const both_t y = rest_of(x, none, lower, factors, i - 1u);
        put_both(x[i - 2u], decreased(both_at(x[i - 2u]), entry_of(lower, factors, i - 2u), y));
        const both_t z = rest_of(x, none, upper, factors, i - 2u);
        for (size_t k = first; k < i - 2u; k++) {
            const both_t rest = decreased(both_at(x[k]), entry_of(lower, factors, k), y);
            put_both(x[k], decreased(rest, entry_of(upper, factors, k), z));
        }
    }
    if (i > first) {
        (void)rest_of(x, none, &l[factors * entry_at(first, 0)], factors, first);
    }
}

/* x := L^-T L^-1 x of n columns and two right sides, its entries from first on. What is before first is 0. */
__attribute__((noinline)) static void substitute(const double *l, uint32_t first, uint32_t n, double (*x)[2])
{
    forward(l, 1u, first, n, x);
    backward(l, 1u, first, n, x);
}

/* Diagonal of the inverse of the factorised matrix of all rows; 0 for columns that are left out. Returns the 1-norm of
   the inverse, of which the entries below the diagonal stand for those above. */
static double invert(const zygos_solver_t *work, uint32_t p, double *diagonal)
{
    double(*x)[2] = work->column;
    double *sum = work->product;
    double norm = 0.0;
    memset(sum, 0, p * sizeof sum[0]);
    for (uint32_t i = 0; i < p; i += 2u) {
        memset(x, 0, (p + 1u) * sizeof x[0]);
        x[i][0] = 1.0;
        x[i + 1u][1] = 1.0;
        substitute(work->factor, i, p, x);
        for (uint32_t side = 0; (side < 2u) && (i + side < p); side++) {
            const uint32_t own = i + side;
            diagonal[own] = x[own][side];
            sum[own] += zygos_magnitude(x[own][side]);
            for (uint32_t j = own + 1u; j < p; j++) {
                sum[own] += zygos_magnitude(x[j][side]);
                sum[j] += zygos_magnitude(x[j][side]);
            }
            norm = zygos_larger(sum[own], norm);
        }
    }
    return norm;
}

/* Cholesky of the scaled matrix with symmetric pivoting, in work->factor; rows are reordered by work->pivot. Returns
   the number of columns that are independent. */
static uint32_t independent(zygos_solver_t *work, uint32_t p)
{
    double *l = work->factor;
    double *left = work->column[0];
    for (uint32_t i = 0; i < p; i++) {
        work->pivot[i] = i;
        left[i] = work->matrix[entry_at(i, i)][0];
    }
    for (uint32_t k = 0; k < p; k++) {
        uint32_t best = k;
        for (uint32_t i = k + 1u; i < p; i++) {
            best = (left[i] > left[best]) ? i : best;
        }
        if (!(left[best] > ZYGOS_PIVOT_LIMIT)) {
            return k;
        }
        const double diagonal = __builtin_sqrt(left[best]);
        const uint32_t swap = work->pivot[k];
        work->pivot[k] = work->pivot[best];
        work->pivot[best] = swap;
        left[best] = left[k];
        for (uint32_t j = 0; j < k; j++) {
            const double t = l[entry_at(k, j)];
            l[entry_at(k, j)] = l[entry_at(best, j)];
            l[entry_at(best, j)] = t;
        }
        l[entry_at(k, k)] = diagonal;
        for (uint32_t i = k + 1u; i < p; i++) {
            double *row = &l[entry_at(i, 0)];
            double sum = work->matrix[zygos_gram_place(work->pivot[i], work->pivot[k])][0];
            for (uint32_t j = 0; j < k; j++) {
                sum -= row[j] * l[entry_at(k, 0) + j];
            }
            row[k] = sum / diagonal;
            left[i] -= row[k] * row[k];
        }
    }
    return p;
}

/* x := L^-1 x of two factors side by side, the rows from first to before n. What is before first is 0. */
__attribute__((noinline)) static void forward_both(const double (*l)[2], uint32_t first, uint32_t n, double (*x)[2])
{
    forward(l[0], 2u, first, n, x);
}

/* Cholesky of two systems of scaled equations side by side, in place; their right sides become L^-1 of them. The
   diagonal is infinite of a column that depends on those before it, or is to be left out, which makes all else of it 0.
   rank: the numbers of columns that are independent. */
static void factorise_both(double (*l)[2], uint32_t p, uint32_t *rank)
{
    rank[0] = 0;
    rank[1] = 0;
    for (uint32_t i = 0; i <= p; i++) {
        double(*row)[2] = &l[entry_at(i, 0)];
        double square[2] = { 0.0 };
        forward_both((const double(*)[2])l, 0, i, row);
        for (uint32_t k = 0; k < i; k++) {
            accumulate(square, row[k], row[k]);
        }
        for (uint32_t side = 0; (side < 2u) && (i < p); side++) {
            const double left = row[i][side] - square[side];
            row[i][side] = (left > ZYGOS_PIVOT_LIMIT) ? __builtin_sqrt(left) : infinity();
            rank[side] += (left > ZYGOS_PIVOT_LIMIT) ? 1u : 0u;
        }
    }
}

static void scale_both(const zygos_solver_t *work, uint32_t p, double (*x)[2])
{
    for (uint32_t i = 0; i < p; i++) {
        x[i][0] *= work->scale[i];
        x[i][1] *= work->scale[i];
    }
}

/* Factorises the two systems of scaled equations in work->matrix. Their solutions, unscaled, are in change. */
static void solve_both(const zygos_solver_t *work, uint32_t p, uint32_t *rank)
{
    double(*x)[2] = work->change;
    factorise_both(work->matrix, p, rank);
    memcpy(x, work->matrix[entry_at(p, 0)], p * sizeof x[0]);
    backward(work->matrix[0], 2u, 0, p, x);
    scale_both(work, p, x);
}

/* Diagonals of the inverses of the two factorised matrices; 0 for columns that are left out. */
static void inverse_diagonals(const zygos_solver_t *work, uint32_t p, double (*out)[2])
{
    double(*x)[2] = work->column;
    for (uint32_t i = 0; i < p; i++) {
        double square[2] = { 0.0 };
        memset(x[i], 0, (p - i) * sizeof x[0]);
        x[i][0] = 1.0;
        x[i][1] = 1.0;
        forward_both((const double(*)[2])work->matrix, i, p, x);
        for (uint32_t k = i; k < p; k++) {
            accumulate(square, x[k], x[k]);
        }
        out[i][0] = square[0];
        out[i][1] = square[1];
    }
}

/* The standard deviation of the error of the torque sensor that gain g (from 0) is of. */
static double gain_sigma(const zygos_solver_t *work, uint32_t g)
{
    const zygos_config_t *config = &work->sums->config;
    return config->joint[config->effect[config->effects - work->gains + g].joint].torque_gain_sigma;
}

/* What all entries of the prior of the gains have in common, which every factorisation needs. */
static void prepare_prior(zygos_solver_t *work)
{
    const double reference = zygos_effects_reference_sigma(&work->sums->config);
    double all = 0.0;
    for (uint32_t g = 0; g < work->gains; g++) {
        const double sigma = gain_sigma(work, g);
        all += reference * reference / (sigma * sigma);
    }
    work->gain_reference = reference;
    work->gain_ratios = all;
}

/* Entry of the prior of the gains as it stands beside the sums: the inverse of diag(s_g^2) + s_r^2, times what
   information costs in variance. */
static double prior(const zygos_solver_t *work, uint32_t g, uint32_t h)
{
    const double reference = work->gain_reference;
    const double by_g = 1.0 / gain_sigma(work, g);
    const double by_h = 1.0 / gain_sigma(work, h);
    const double common = by_g * by_h * reference * reference / (1.0 + work->gain_ratios);
    return work->gain_cost[g] * work->gain_cost[h] * by_g * by_h * (((g == h) ? 1.0 : 0.0) - common);
}

/* Holds column i of the scaled equations at a value. */
static void hold(const zygos_solver_t *work, uint32_t p, uint32_t i, double value)
{
    for (uint32_t side = 0; side < 2u; side++) {
        for (uint32_t j = 0; j < p; j++) {
            double *both = &work->matrix[zygos_gram_place(i, j)][side];
            work->matrix[entry_at(p, j)][side] -= *both * value;
            *both = (i == j) ? 1.0 : 0.0;
        }
        work->matrix[entry_at(p, i)][side] = value;
    }
}

/* Adds the prior of the gains, which are the last columns, to the scaled equations; or holds the gains. */
static void restrict_gains(const zygos_solver_t *work, uint32_t p)
{
    const uint32_t first = p - work->gains;
    for (uint32_t i = first; i < p; i++) {
        for (uint32_t j = first; (j <= i) && (work->gains_held == 0); j++) {
            const double more = prior(work, i - first, j - first) * (work->scale[i] * work->scale[j]);
            work->matrix[entry_at(i, j)][0] += more;
            work->matrix[entry_at(i, j)][1] += more;
        }
        if (work->gains_held != 0) {
            hold(work, p, i, (work->scale[i] > 0.0) ? work->gain_value[i - first] / work->scale[i] : 0.0);
        }
    }
}

/* Two systems of scaled equations in work->matrix, their right sides in row p: of the sums of all rows, less what is in
   work->matrix, plus so much of the declared noise that was subtracted. Columns that depend on the first rank of
   work->pivot are left out. */
static void equations(const zygos_solver_t *work, uint32_t p, uint32_t rank, const double *back)
{
    work->scale[p] = 1.0;
    for (uint32_t i = 0; i <= p; i++) {
        const double *scale = work->scale;
        const double *total = &work->total[entry_at(i, 0)];
        const double *noise = &work->noise[entry_at(i, 0)];
        double(*out)[2] = &work->matrix[entry_at(i, 0)];
        for (uint32_t j = 0; j <= i; j++) {
            const double factor = scale[i] * scale[j];
            const double sum[2] = { total[j] + back[0] * noise[j], total[j] + back[1] * noise[j] };
            const double rest[2] = { (sum[0] - out[j][0]) * factor, (sum[1] - out[j][1]) * factor };
            out[j][0] = rest[0];
            out[j][1] = rest[1];
        }
    }
    restrict_gains(work, p);
    for (uint32_t d = rank; d < p; d++) {
        work->matrix[entry_at(work->pivot[d], work->pivot[d])][0] = 0.0;
        work->matrix[entry_at(work->pivot[d], work->pivot[d])][1] = 0.0;
    }
}

/* The same of all rows, without two shares of the declared noise. */
static void equations_of_all(const zygos_solver_t *work, uint32_t p, uint32_t rank, double noise, double other)
{
    const double back[2] = { 1.0 - noise, 1.0 - other };
    memset(work->matrix, 0, entry_at(p + 1u, 0) * sizeof work->matrix[0]);
    equations(work, p, rank, back);
}

/* The solutions x for two other right sides, which are x, by the factor of all rows. */
static void solve_again(const zygos_solver_t *work, uint32_t p, double (*x)[2])
{
    substitute(work->factor, 0, p, x);
    scale_both(work, p, x);
}

/* Every stride-th number of out += factor times a packed matrix whose columns have these places, or none. */
static void embed(const double *local, const uint32_t *place, uint32_t count, double factor, double *out,
                  uint32_t stride)
{
    for (uint32_t a = 0; a < count; a++) {
        for (uint32_t b = 0; (b <= a) && (place[a] != ZYGOS_NO_PLACE); b++) {
            if (place[b] != ZYGOS_NO_PLACE) {
                out[stride * zygos_gram_place(place[a], place[b])] += factor * local[entry_at(a, b)];
            }
        }
    }
}

/* The entries of x at these places, 0 where there is none. */
static void entries_at(const double *x, const uint32_t *place, uint32_t count, double *out)
{
    for (uint32_t a = 0; a < count; a++) {
        out[a] = (place[a] != ZYGOS_NO_PLACE) ? x[place[a]] : 0.0;
    }
}

/* The places of the columns of the motor rows of joint i, with that of the right side. Returns their number, 0 where
   there are no such rows. */
static uint32_t motor_places(const zygos_solver_t *work, uint32_t i, uint32_t *place)
{
    const uint32_t count = zygos_motor_sums_places(&work->sums->motors, &work->column_map, i, place);
    return (count > 0) ? count + 1u : 0u;
}

static uint32_t momentum_places(const zygos_solver_t *work, uint32_t *place)
{
    return zygos_momentum_sums_places(&work->sums->momentum, &work->column_map, place);
}

/* The factor of a group of joint rows in the total. */
static double group_factor(const zygos_solver_t *work, uint32_t g)
{
    return work->joints_weight * work->sums->joints.fade[g];
}

/* A dependent column can be exchanged for the independent ones it is made of: neither then has a value. */
static void mark_identifiable(zygos_solver_t *work, uint32_t p, uint32_t rank, zygos_estimate_t *out)
{
    for (uint32_t i = 0; i < p; i++) {
        out->identifiable[i] = 1;
    }
    double(*x)[2] = work->column;
    for (uint32_t d = rank; d < p; d++) {
        out->identifiable[work->pivot[d]] = 0;
        for (uint32_t i = 0; i < rank; i++) {
            x[i][0] = work->matrix[zygos_gram_place(work->pivot[i], work->pivot[d])][0];
            x[i][1] = 0.0;
        }
        substitute(work->factor, 0, rank, x);
        for (uint32_t i = 0; i < rank; i++) {
            if (zygos_magnitude(x[i][0]) > 1e-6) {
                out->identifiable[work->pivot[i]] = 0;
            }
        }
    }
}

/* 1-norm of the scaled matrix of the independent columns. */
static double norm_of(const zygos_solver_t *work, uint32_t p, uint32_t rank)
{
    double norm = 0.0;
    equations_of_all(work, p, rank, work->noise_scale, work->noise_scale);
    for (uint32_t i = 0; i < p; i++) {
        double column = 0.0;
        for (uint32_t j = 0; (j < p) && (work->factor[entry_at(i, i)] < infinity()); j++) {
            column += (work->factor[entry_at(j, j)] < infinity())
                          ? zygos_magnitude(work->matrix[zygos_gram_place(i, j)][0])
                          : 0.0;
        }
        norm = zygos_larger(column, norm);
    }
    return norm;
}

/* Student's factor for 95 %, by its expansion in 1 / freedom: within 1 % from 3 degrees of freedom on. */
static double student(double degrees_of_freedom)
{
    const double u = 1.0 / degrees_of_freedom;
    return TWO_SIGMAS + u * (2.372272 + u * (2.822499 + u * (2.555852 + u * 1.589536)));
}

/* By how much the square of a block's own influence is too small, at least 1: the change without the block over its own
   influence, both along its score. */
static double enlargement(const zygos_solver_t *work, uint32_t p, uint32_t side)
{
    double whole = 0.0;
    double own = 0.0;
    for (uint32_t i = 0; i < p; i++) {
        const double pull = work->pull[i][side] / work->scale[i];
        whole += pull * work->change[i][side];
        own += pull * work->influence[i][side];
    }
    return ((own > 0.0) && (whole > own)) ? whole / own : 1.0;
}

/* covariance += the sum of factor x x' of two vectors side by side. */
static void add_squares(double *covariance, uint32_t p, double (*x)[2], const double *factor)
{
    for (uint32_t i = 0; i < p; i++) {
        const double first = factor[0] * x[i][0];
        const double second = factor[1] * x[i][1];
        double *row = &covariance[entry_at(i, 0)];
        for (uint32_t j = 0; j <= i; j++) {
            row[j] += first * x[j][0] + second * x[j][1];
        }
    }
}

/* The blocks of all kinds of rows, in the order in which they are left out. */
typedef struct {
    uint32_t end[ZYGOS_KINDS_OF_SUMS]; ///< Number of blocks of each kind, with those of the kinds before it.
    double overlap; ///< Blocks of energy rows overlap: the squares of their weights add up to less than the weights.
} parts_t;

static uint32_t blocks_of(const zygos_solver_t *work, uint32_t kind)
{
    return work->blocks[kind].end - work->blocks[kind].first;
}

static uint32_t blocks_of_all(const parts_t *parts)
{
    return parts->end[ZYGOS_JOINT_KIND];
}

static parts_t parts_of(const zygos_solver_t *work)
{
    parts_t out = { .overlap = 1.0 };
    double instants = 0.0;
    double square = 0.0;
    uint32_t end = 0;
    for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        end += blocks_of(work, kind);
        out.end[kind] = end;
    }
    out.end[ZYGOS_JOINT_KIND] = end + ((work->joints_weight > 0.0) ? (uint32_t)ZYGOS_GROUP_PLACES : 0u);
    for (uint32_t b = work->blocks[ZYGOS_ENERGY_ROWS].first; b < work->blocks[ZYGOS_ENERGY_ROWS].end; b++) {
        instants += zygos_accumulator_at(&work->sums->energy, b)->head.total;
        square += zygos_accumulator_at(&work->sums->energy, b)->square;
    }
    out.overlap = (square > 0.0) ? instants / square : 1.0;
    return out;
}

/* Two blocks, or the last one alone, and the share of each in the declared noise: of its own rows, and of what is left
   out with it. */
typedef struct {
    uint32_t count;
    double factor[2]; ///< Of the square of its influence.
    double own[2];
    double share[2];
} couple_t;

/* Adds an arc of motor rows, or of momentum rows, to every stride-th number of out. */
static void add_motor_arc(const zygos_solver_t *work, uint32_t rank, double *out, uint32_t stride)
{
    const zygos_motor_block_t *arc = zygos_motor_sums_at(&work->sums->motors, rank);
    for (uint32_t i = 0; i < work->sums->config.joints; i++) {
        if (work->weight[i] > 0.0) {
            uint32_t place[ZYGOS_MAX_IMPULSE + 1];
            embed(arc->joint[i].gram, place, motor_places(work, i, place), work->weight[i], out, stride);
        }
    }
}

static void add_momentum_arc(const zygos_solver_t *work, uint32_t rank, double *out, uint32_t stride)
{
    uint32_t place[ZYGOS_MAX_MOMENTUM];
    const uint32_t columns = momentum_places(work, place);
    const zygos_momentum_block_t *arc = zygos_momentum_sums_at(&work->sums->momentum, rank);
    embed(arc->rows.gram, place, columns, work->momentum_weight, out, stride);
}

/* Adds the sums of block b to one side of work->matrix. */
static void add_block(const zygos_solver_t *work, uint32_t p, const parts_t *parts, uint32_t b, couple_t *couple)
{
    const uint32_t side = couple->count++;
    double *out = &work->matrix[0][side];
    const double *gram = NULL;
    double weight = 1.0;
    uint32_t kind = 0;
    while ((kind < ZYGOS_JOINT_KIND) && (b >= parts->end[kind])) {
        kind++;
    }
    const uint32_t rank = b - ((kind > 0) ? parts->end[kind - 1u] : 0u);
    couple->factor[side] = 1.0;
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        const zygos_block_t *block = zygos_accumulator_at(&work->sums->energy, work->blocks[kind].first + rank);
        gram = block->gram;
        couple->factor[side] = parts->overlap;
        couple->share[side] = block->head.total / work->instants;
        couple->own[side] = couple->share[side];
    } else if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        add_motor_arc(work, work->blocks[kind].first + rank, out, 2u);
    } else if (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS) {
        add_momentum_arc(work, work->blocks[kind].first + rank, out, 2u);
    } else {
        gram = work->sums->joints.group[rank].gram;
        weight = group_factor(work, rank);
        couple->share[side] =
            work->joints_alone ? work->sums->joints.fade[rank] * work->sums->joints.count[rank] / work->instants : 0.0;
    }
    for (uint32_t k = 0; (gram != NULL) && (k < entry_at(p + 1u, 0)); k++) {
        out[2u * k] = weight * gram[k];
    }
}

/* Two blocks from b on: their sums in work->matrix, their scores, which are right side less matrix times solution,
   scaled, in pull, and their own influences on the solution. */
static couple_t influences(zygos_solver_t *work, uint32_t p, const parts_t *parts, uint32_t b)
{
    couple_t out = { .count = 0 };
    memset(work->matrix, 0, entry_at(p + 1u, 0) * sizeof work->matrix[0]);
    for (uint32_t k = b; (k < b + 2u) && (k < blocks_of_all(parts)); k++) {
        add_block(work, p, parts, k, &out);
    }
    for (uint32_t i = 0; i <= p; i++) {
        double(*row)[2] = &work->matrix[entry_at(i, 0)];
        double sum[2] = { 0.0 };
        const double own[2] = { work->solution[i], work->solution[i] };
        for (uint32_t j = 0; j < i; j++) {
            const double other[2] = { work->solution[j], work->solution[j] };
            accumulate(sum, row[j], other);
            accumulate(work->pull[j], row[j], own);
        }
        accumulate(sum, row[i], own);
        work->pull[i][0] = sum[0];
        work->pull[i][1] = sum[1];
    }
    const double back = 1.0 - work->noise_scale;
    for (uint32_t i = 0; i < p; i++) {
        for (uint32_t side = 0; side < 2u; side++) {
            const double noisy = back * out.own[side] * work->right_side[i];
            work->pull[i][side] = -(work->pull[i][side] + noisy) * work->scale[i];
            work->influence[i][side] = work->pull[i][side];
        }
    }
    solve_again(work, p, work->influence);
    return out;
}

/* right_side := the declared noise of the energy rows times the solution, which the scores of the blocks share. */
static void score_noise(const zygos_solver_t *work, uint32_t p)
{
    multiply_symmetric(work->sums->energy.noise_closed.gram, work->solution, p + 1u, work->right_side);
    for (uint32_t i = 0; i < p; i++) {
        work->right_side[i] *= work->noise_fraction;
    }
}

/* Solves without each of two blocks, whose sums are in work->matrix, and adds what follows to the sums over the blocks.
   Returns false where the equations lose rank. */
static bool leave_out_both(const zygos_solver_t *work, uint32_t p, uint32_t rank, const couple_t *couple,
                           double *covariance)
{
    const double noise = 1.0 - work->noise_scale;
    const double back[2] = { noise * (1.0 - couple->share[0]), noise * (1.0 - couple->share[1]) };
    double enlarged[2] = { 0.0 };
    uint32_t left[2];
    equations(work, p, rank, back);
    solve_both(work, p, left);
    for (uint32_t i = 0; i < p; i++) {
        work->change[i][0] = work->solution[i] - work->change[i][0];
        work->change[i][1] = work->solution[i] - work->change[i][1];
    }
    for (uint32_t side = 0; side < couple->count; side++) {
        enlarged[side] = couple->factor[side] * enlargement(work, p, side);
    }
    add_squares(covariance, p, work->influence, enlarged);
    inverse_diagonals(work, p, work->pull);
    for (uint32_t side = 0; side < couple->count; side++) {
        const double factor = couple->factor[side];
        for (uint32_t i = 0; i < p; i++) {
            const double gain = work->pull[i][side] - work->inverse[i];
            const double more = zygos_larger(gain, 0.0);
            const double own = factor * work->influence[i][side];
            work->information[0][i] += more;
            work->information[1][i] += more * more;
            work->product[i] += own * work->change[i][side];
            work->linearised_variance[i] += own * work->influence[i][side];
        }
    }
    return (left[0] == rank) && ((couple->count < 2u) || (left[1] == rank));
}

/* Covariance and degrees of freedom from the sums over the blocks. */
static void finish_jackknife(zygos_solver_t *work, uint32_t p, double *covariance)
{
    for (uint32_t i = 0; i < p; i++) {
        const double several = work->information[0][i] * work->information[0][i];
        double degrees_of_freedom = (work->information[1][i] > 0.0) ? several / work->information[1][i] : 1.0;
        degrees_of_freedom -= work->joints_alone ? 1.0 : 0.0;
        work->degrees_of_freedom[i] = zygos_larger(degrees_of_freedom, 2.0);
        /* By an accident of few blocks the product may be too small, even negative; the square of the one is not. */
        const double variance = zygos_larger(work->product[i], work->linearised_variance[i]);
        work->product[i] = (variance > 0.0) ? __builtin_sqrt(variance / covariance[entry_at(i, i)]) : 1.0;
    }
    for (uint32_t i = 0; i < p; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            covariance[entry_at(i, j)] *= work->product[i] * work->product[j];
        }
    }
}

/* Covariance by leaving out one block at a time. Blocks overlap, so the squares of their weights add up to less than
   their weights. Each variance is the product of the change without a block and of the block's own influence, which is
   right on average; but a matrix of such products need not be positive semi-definite. The correlations are therefore
   those of squares: of the blocks' own influences, each enlarged by what it is too small by in its own direction. A
   parameter whose information comes from few blocks has few degrees of freedom. A block without which the equations
   lose rank leaves all sigmas infinite: the motion was informative once only. Needs the factor of the solution. */
static void jackknife(zygos_solver_t *work, uint32_t p, uint32_t rank, double *covariance)
{
    const parts_t parts = parts_of(work);
    double *const sums[] = { work->information[0], work->information[1], work->product, work->linearised_variance };
    bool once = false;
    for (uint32_t k = 0; k < sizeof sums / sizeof sums[0]; k++) {
        memset(sums[k], 0, p * sizeof sums[k][0]);
    }
    memset(covariance, 0, entry_at(p, 0) * sizeof covariance[0]);
    score_noise(work, p);
    for (uint32_t b = 0; (b < blocks_of_all(&parts)) && !once; b += 2u) {
        const couple_t couple = influences(work, p, &parts, b);
        once = !leave_out_both(work, p, rank, &couple, covariance);
    }
    finish_jackknife(work, p, covariance);
    if (once) {
        memset(covariance, 0, entry_at(p, 0) * sizeof covariance[0]);
    }
    for (uint32_t i = 0; (i < p) && once; i++) {
        covariance[entry_at(i, i)] = infinity();
    }
}

/* The two directions of a spatial arm, or the two bodies of a planar one, that kinetic parameter k couples. Returns
   whether it is one of the b_ij. */
static bool pair_of(const zygos_config_t *config, uint32_t k, uint32_t *a, uint32_t *b)
{
    const bool space = (config->kinetic == ZYGOS_SPATIAL_ARM);
    const bool free = (config->base == ZYGOS_BASE_FREE);
    const uint32_t size = space ? 2u * config->joints + (free ? 3u : 0u) : config->joints + (free ? 1u : 0u);
    uint32_t place = k;
    if (space && !free && (k > 0)) {
        place += (k < size - 1u) ? 1u : 2u; /* N[1u,1v] and N[1v,1v] are left out */
    }
    const bool cross = !space && (k >= size * (size + 1u) / 2u);
    const uint32_t strict = cross ? 1u : 0u;
    place -= cross ? size * (size + 1u) / 2u : 0u;
    uint32_t row = 0;
    while ((row + 1u < size) && (place >= size - strict - row)) {
        place -= size - strict - row;
        row++;
    }
    *a = row;
    *b = row + strict + place;
    return cross;
}

/* What the sigma of a column's coefficient is compared with: see ZYGOS_SIGMA_LIMIT. */
static void measure_columns(const zygos_solver_t *work, const double *x, double *size)
{
    const zygos_column_map_t *column_map = &work->column_map;
    double diagonal[ZYGOS_MAX_DIRECTIONS] = { 0.0 };
    double moment = 0.0;
    uint32_t a = 0;
    uint32_t b = 0;
    for (uint32_t k = 0; k < column_map->body; k++) {
        if (k >= column_map->kinetic) {
            moment = zygos_larger(zygos_magnitude(x[k]), moment);
        } else if (!pair_of(&work->sums->config, k, &a, &b) && (a == b)) {
            diagonal[a] = zygos_magnitude(x[k]);
        }
    }
    if ((work->sums->config.kinetic == ZYGOS_SPATIAL_ARM) && (work->sums->config.base == ZYGOS_BASE_FIXED)) {
        diagonal[1] = diagonal[0];
    }
    for (uint32_t k = 0; k < column_map->count; k++) {
        size[k] = (k < column_map->body) ? moment : 0.0;
        if (k < column_map->kinetic) {
            (void)pair_of(&work->sums->config, k, &a, &b);
            size[k] = __builtin_sqrt(diagonal[a] * diagonal[b]);
        }
        size[k] = zygos_larger(size[k], zygos_magnitude(x[k]));
    }
}

/* The same for the parameters: one that counts for several columns by factors changes none of them by more than its
   size. It is at least the parameter itself. */
static void measure_parameters(zygos_solver_t *work)
{
    const zygos_config_t *config = &work->sums->config;
    double columns[ZYGOS_MAX_COLUMNS];
    double size[ZYGOS_MAX_COLUMNS];
    zygos_expand(config, &work->column_map, work->solution, columns);
    measure_columns(work, columns, size);
    if (config->reduced == 0) {
        memcpy(work->size, size, work->column_map.parameters * sizeof size[0]);
        return;
    }
    for (uint32_t r = 0; r < work->column_map.parameters; r++) {
        work->size[r] = infinity();
    }
    for (uint32_t k = 0; k < config->reductions; k++) {
        const zygos_reduction_t *entry_k = &config->reduction[k];
        const double own = size[entry_k->column] / zygos_magnitude(entry_k->factor);
        work->size[entry_k->parameter] = (own < work->size[entry_k->parameter]) ? own : work->size[entry_k->parameter];
    }
    for (uint32_t r = 0; r < work->column_map.parameters; r++) {
        const double own = zygos_magnitude(work->solution[r]);
        work->size[r] = ((work->size[r] > own) && (work->size[r] < infinity())) ? work->size[r] : own;
    }
}

/* m := m - Im y y^T of each rotor i and each direction y of it: a thin disk on the body before its joint, with half of
   Im along both directions across the axis. What lies along a body's own joint axis is carried on to the body before.
 */
static void subtract_rotors(const zygos_solver_t *work, double *m, uint32_t size)
{
    const zygos_config_t *config = &work->sums->config;
    const bool space = (config->kinetic == ZYGOS_SPATIAL_ARM);
    const uint32_t base = (config->base == ZYGOS_BASE_FREE) ? (space ? 3u : 2u) : 0u;
    zygos_geometry_t geometry;
    zygos_geometry_init(&geometry, config);
    for (uint32_t i = (base > 0) ? 0u : 1u; i < config->joints; i++) {
        const double rotor = work->solution[work->column_map.joint[i]];
        for (uint32_t d = 0; d < 2; d++) {
            double y[ZYGOS_MAX_DIRECTIONS] = { 0.0 };
            /* Direction d of body i + 1 in the frame (u, v, axis) of the body before. */
            double c[3] = { geometry.rotation[i][d], geometry.rotation[i][3u + d], geometry.rotation[i][6u + d] };
            for (uint32_t body = i; body > 0; body--) {
                const double *rotation = geometry.rotation[body - 1u];
                const double along = c[2];
                y[base + 2u * body - 2u] = c[0];
                y[base + 2u * body - 1u] = c[1];
                c[0] = rotation[2] * along;
                c[1] = rotation[5] * along;
                c[2] = rotation[8] * along;
            }
            if (space) {
                memcpy(y, c, base * sizeof y[0]);
            } else {
                /* Of a planar arm each direction has all of Im, for each a_ij stands once a direction. */
                memset(y, 0, sizeof y);
                y[base + 2u * i - 2u + d] = __builtin_sqrt(2.0);
            }
            for (uint32_t a = 0; a < size; a++) {
                for (uint32_t b = 0; b <= a; b++) {
                    m[entry_at(a, b)] -= 0.5 * rotor * y[size - 1u - a] * y[size - 1u - b];
                }
            }
        }
    }
}

/* Eliminates a symmetric matrix in its own place, up to the column split. Returns whether each pivot, and the sum of
   the rest of the diagonal, is positive. */
static bool eliminates(double *m, uint32_t size, uint32_t split)
{
    double rest = 0.0;
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            double sum = m[entry_at(i, j)];
            for (uint32_t k = 0; (k < j) && (k < split); k++) {
                sum -= m[entry_at(i, k)] * m[entry_at(j, k)];
            }
            if (j >= split) {
                rest += (i == j) ? sum : 0.0;
            } else if (i > j) {
                m[entry_at(i, j)] = sum / m[entry_at(j, j)];
            } else if (sum > 0.0) {
                m[entry_at(i, i)] = __builtin_sqrt(sum);
            } else {
                return false;
            }
        }
    }
    return (split == size) || (rest > 0.0);
}

/* A kinetic energy that is positive for every motion needs the matrix of the bodies less the rotors' share to be
   positive definite; its diagonal may fall short by some sigmas. A planar arm's has each a_ij once for each direction.
   The order of the directions is reversed: of the last two on a fixed base only the sum of the diagonal is known. */
static bool positive_definite(zygos_solver_t *work, const double *sigma)
{
    const zygos_config_t *config = &work->sums->config;
    const bool space = (config->kinetic == ZYGOS_SPATIAL_ARM);
    const bool free = (config->base == ZYGOS_BASE_FREE);
    const uint32_t size = 2u * config->joints + (free ? (space ? 3u : 2u) : 0u);
    const uint32_t split = (space && !free) ? size - 2u : size;
    double *m = work->matrix[0];
    memset(m, 0, entry_at(size, 0) * sizeof m[0]);
    for (uint32_t k = 0; k < work->column_map.kinetic; k++) {
        uint32_t a = 0;
        uint32_t b = 0;
        const bool cross = pair_of(config, k, &a, &b);
        const double value = work->solution[k] + ((a == b) ? ZYGOS_NEGATIVE_SIGMAS * sigma[k] : 0.0);
        if (space) {
            m[entry_at(size - 1u - a, size - 1u - b)] = value;
        } else if (cross) {
            m[entry_at(size - 2u - 2u * a, size - 1u - 2u * b)] = value;
            m[entry_at(size - 1u - 2u * a, size - 2u - 2u * b)] = -value;
        } else {
            m[entry_at(size - 1u - 2u * a, size - 1u - 2u * b)] = value;
            m[entry_at(size - 2u - 2u * a, size - 2u - 2u * b)] = value;
        }
    }
    subtract_rotors(work, m, size);
    return eliminates(m, size, split);
}

/* Whether each kinetic diagonal and each Im that has a value is positive, and, when all have, the matrix of the bodies.
   Needs a parameter for each column. */
static bool bodies_physical(zygos_solver_t *work, const zygos_estimate_t *out)
{
    const zygos_column_map_t *column_map = &work->column_map;
    bool all = true;
    bool good = true;
    for (uint32_t k = 0; k < column_map->kinetic; k++) {
        uint32_t a = 0;
        uint32_t b = 0;
        const bool cross = pair_of(&work->sums->config, k, &a, &b);
        all = all && out->identifiable[k];
        good = good && (cross || (a != b) || !out->identifiable[k] || (out->value[k] > 0.0));
    }
    for (uint32_t i = 0; i < work->sums->config.joints; i++) {
        const uint32_t k = column_map->joint[i];
        all = all && (!column_map->rotor[i] || out->identifiable[k]);
        good = good && (!column_map->rotor[i] || !out->identifiable[k] || (out->value[k] > 0.0));
    }
    return good && (!all || positive_definite(work, out->sigma));
}

/* Im, k and b of flexible joints that have a value must be positive; the bodies are judged where every column has a
   parameter of its own. An effect that cannot be negative may come out so by its noise. */
static bool physical(zygos_solver_t *work, const zygos_estimate_t *out)
{
    const zygos_column_map_t *column_map = &work->column_map;
    const uint32_t positive = zygos_effects_positive(&work->sums->config);
    bool good = true;
    for (uint32_t i = 0; i < work->sums->config.joints; i++) {
        for (uint32_t c = 0; (c < 3u) && (work->sums->config.joint[i].rigid == 0); c++) {
            const uint32_t k = column_map->place[column_map->joint[i] + c];
            good = good && (!out->identifiable[k] || (out->value[k] > 0.0));
        }
    }
    for (uint32_t k = column_map->reduced; k < column_map->parameters; k++) {
        const bool bounded = ((positive >> (k - column_map->reduced)) & 1u) != 0;
        const double least = -ZYGOS_NEGATIVE_SIGMAS * out->sigma[k];
        good = good && (!bounded || !out->identifiable[k] || (out->value[k] >= least));
    }
    return good && (!zygos_reduction_selects_all(column_map) || bodies_physical(work, out));
}

static void withhold(zygos_estimate_t *out, uint32_t i, uint32_t p)
{
    out->identifiable[i] = 0;
    out->value[i] = not_a_number();
    out->sigma[i] = not_a_number();
    out->half95[i] = not_a_number();
    for (uint32_t j = 0; j < p; j++) {
        out->covariance[zygos_gram_place(i, j)] = not_a_number();
    }
}

/* The mean square of the undeclared noise for each scaled column, if it alone causes the residuals and is the same in
   all columns. It biases the values by its contribution to the squares of the columns. */
static double noise_square(const zygos_solver_t *work, uint32_t p, double unexplained)
{
    double length = 0.0;
    for (uint32_t i = 0; i < p; i++) {
        length += work->solution[i] * work->solution[i] * work->total[entry_at(i, i)];
    }
    return (unexplained > 0.0) ? unexplained / length : 0.0;
}

/* Factorises the sums without a share of the declared noise, and solves; those without another share are factorised
   beside it. Writes the rank of either. */
static void solve_with(const zygos_solver_t *work, uint32_t p, uint32_t rank, double noise, double other,
                       uint32_t *ranks)
{
    equations_of_all(work, p, rank, noise, other);
    solve_both(work, p, ranks);
    for (uint32_t i = 0; i < p; i++) {
        work->solution[i] = work->change[i][0];
    }
    work->solution[p] = -1.0; /* beside the right side */
    for (uint32_t k = 0; k < entry_at(p, 0); k++) {
        work->factor[k] = work->matrix[k][0];
    }
}

/* The error that noise may hide: the change of the solution by the same amount of noise again; and, where not all could
   be subtracted, by what was. */
static void shift_by_noise(const zygos_solver_t *work, uint32_t p, double noise, bool noisy)
{
    uint32_t rank[2];
    equations_of_all(work, p, p, work->noise_scale, 0.0);
    for (uint32_t i = 0; i < p; i++) {
        work->matrix[entry_at(i, i)][0] += noise;
    }
    solve_both(work, p, rank);
    for (uint32_t i = 0; i < p; i++) {
        const double shift[2] = { work->change[i][0] - work->solution[i], work->change[i][1] - work->solution[i] };
        work->noise_square[i] = shift[0] * shift[0] + (noisy ? shift[1] * shift[1] : 0.0);
    }
}

/* Largest ratio of declared noise to sums over all combinations of the independent columns, by the power method. */
static double noise_share(zygos_solver_t *work, uint32_t p, uint32_t rank)
{
    const uint32_t columns = p - (work->gains_held ? work->gains : 0u);
    double *scaled = work->matrix[0];
    double *v = work->right_side;
    double *noisy = work->change[0];
    double *along = work->product; /* the sums times v */
    double(*next)[2] = work->column;
    double change = infinity();
    double share = 0.0;
    uint32_t ranks[2];
    solve_with(work, p, rank, 0.0, 0.0, ranks);
    for (uint32_t i = 0; i < p; i++) {
        v[i] = 1.0 + 0.1 * (double)(i % 7u);
        along[i] = 0.0;
        for (uint32_t j = 0; j <= i; j++) {
            scaled[entry_at(i, j)] =
                (i < columns) ? work->noise[entry_at(i, j)] * work->scale[i] * work->scale[j] : 0.0;
        }
    }
    for (uint32_t round = 0; (round < POWER_ROUNDS) && ((round < 2u) || (change > POWER_CHANGE)); round++) {
        double noise = 0.0;
        double sums = 0.0;
        double length = 0.0;
        multiply_symmetric(scaled, v, p, noisy);
        for (uint32_t i = 0; i < p; i++) {
            noise += v[i] * noisy[i];
            sums += v[i] * along[i];
            next[i][0] = noisy[i];
            next[i][1] = 0.0;
        }
        share = (sums > 0.0) ? noise / sums : 0.0;
        substitute(work->factor, 0, p, next);
        for (uint32_t i = 0; i < p; i++) {
            length = zygos_larger(zygos_magnitude(next[i][0]), length);
        }
        change = 0.0;
        for (uint32_t i = 0; (i < p) && (length > 0.0); i++) {
            change = zygos_larger(zygos_magnitude(next[i][0] / length - v[i]), change);
            v[i] = next[i][0] / length;
            along[i] = noisy[i] / length;
        }
    }
    return share;
}

/* Sum over the columns of the momentum rows of x_a x_b entry. */
static double momentum_form(const zygos_solver_t *work, const zygos_momentum_gram_t *rows)
{
    uint32_t place[ZYGOS_MAX_MOMENTUM];
    double local[ZYGOS_MAX_MOMENTUM];
    const uint32_t columns = momentum_places(work, place);
    entries_at(work->solution, place, columns, local);
    return zygos_gram_form(rows->gram, local, columns);
}

/* The squared residuals of the energy rows at the solution, including noise, and the part of the declared noise in them
   [J^2]; or of the joint rows where they alone are solved. */
static double energy_left(const zygos_solver_t *work, uint32_t p, double *explained)
{
    const double *x = work->solution;
    const zygos_sums_t *sums = work->sums;
    double left = zygos_gram_form(work->total, x, p + 1u);
    if (work->joints_alone != 0u) {
        *explained = zygos_gram_form(work->noise, x, p + 1u);
        left += *explained;
        *explained += work->instants * zygos_joint_sums_torque_noise(&sums->joints, &sums->config);
        return zygos_larger(left, 0.0);
    }
    for (uint32_t g = 0; (g < (uint32_t)ZYGOS_GROUP_PLACES) && (work->joints_weight > 0.0); g++) {
        left -= group_factor(work, g) * zygos_gram_form(sums->joints.group[g].gram, x, p + 1u);
    }
    const zygos_range_t arcs = work->blocks[ZYGOS_MOTOR_ROWS];
    for (uint32_t i = 0; i < sums->config.joints; i++) {
        uint32_t place[ZYGOS_MAX_IMPULSE + 1];
        double local[ZYGOS_MAX_IMPULSE + 1] = { 0.0 };
        const uint32_t columns = motor_places(work, i, place);
        entries_at(x, place, columns, local);
        for (uint32_t b = arcs.first; (b < arcs.end) && (columns > 0); b++) {
            left -=
                work->weight[i] * zygos_gram_form(zygos_motor_sums_at(&sums->motors, b)->joint[i].gram, local, columns);
        }
    }
    const zygos_range_t momenta = work->blocks[ZYGOS_MOMENTUM_ROWS];
    for (uint32_t b = momenta.first; (b < momenta.end) && (work->momentum_weight > 0.0); b++) {
        left -= work->momentum_weight * momentum_form(work, &zygos_momentum_sums_at(&sums->momentum, b)->rows);
    }
    *explained = work->noise_fraction * zygos_gram_form(sums->energy.noise_closed.gram, x, p + 1u);
    left += *explained;
    return zygos_larger(left, 0.0);
}

/* Chooses the share of the declared noise that is subtracted: as much as the residuals show if that is clearly less,
   and not more than half of any combination of columns; and solves without it. Half of one is noise where the sums less
   twice the noise are not positive. signal_to_noise: null, or where that ratio is written, which costs more. Returns
   the rank. */
static uint32_t solve_beside_noise(zygos_solver_t *work, uint32_t p, uint32_t rank, double *signal_to_noise)
{
    uint32_t ranks[2] = { 0, 0 };
    double share = 0.0;
    double seen = 1.0;
    double most = 1.0;
    if (signal_to_noise == NULL) {
        solve_with(work, p, rank, 1.0, 2.0, ranks);
    }
    if (ranks[1] < rank) {
        share = noise_share(work, p, rank);
        most = (ZYGOS_MIN_SIGNAL_TO_NOISE * share > 1.0) ? 1.0 / (ZYGOS_MIN_SIGNAL_TO_NOISE * share) : 1.0;
        solve_with(work, p, rank, most, most, ranks);
    }
    work->noise_scale = most;
    for (uint32_t round = 0; round < 2u; round++) {
        double explained = 0.0;
        const double unexplained = energy_left(work, p, &explained);
        seen = (unexplained < ZYGOS_OVERDECLARED * explained) ? unexplained / explained : 1.0;
        const double next = (seen < most) ? seen : most;
        if ((next < work->noise_scale) || (next > work->noise_scale)) {
            work->noise_scale = next;
            solve_with(work, p, rank, next, next, ranks);
        }
    }
    if (signal_to_noise != NULL) {
        *signal_to_noise = (share > 0.0) ? 1.0 / (share * seen) : infinity();
    }
    return ranks[0];
}

/* Scales to the sums with their noise. Returns their rank. */
static uint32_t scale_sums(zygos_solver_t *work, uint32_t p)
{
    for (uint32_t i = 0; i < p; i++) {
        const double square = work->total[entry_at(i, i)] + work->noise[entry_at(i, i)];
        work->scale[i] = (square > 0.0) ? 1.0 / __builtin_sqrt(square) : 0.0;
    }
    equations_of_all(work, p, p, 0.0, 0.0);
    return independent(work, p);
}

/* The values x of the columns of the motor rows of joint i, with -1 for the right side. Returns the mean square of the
   noise that the signals of an instant have in such a row. */
static double motor_noise(const zygos_solver_t *work, uint32_t i, double *x)
{
    const zygos_motor_sums_t *sums = &work->sums->motors;
    uint32_t place[ZYGOS_MAX_IMPULSE + 1];
    const uint32_t columns = motor_places(work, i, place);
    double sum = 0.0;
    entries_at(work->solution, place, columns, x);
    for (uint32_t a = 0; a + 1u < columns; a++) {
        for (uint32_t b = 0; b <= a; b++) {
            sum += ((a == b) ? 1.0 : 2.0) * x[a] * x[b] * sums->noise[i][entry_at(a, b)];
        }
    }
    return sum;
}

/* Mean square of the noise in a motor row of joint i: that of the signals of the instant, and that of the integral of
   the deflection, the mean over an arc of a random walk about its own mean. */
static double joint_variance(const zygos_solver_t *work, uint32_t i)
{
    const zygos_joint_config_t *joint = &work->sums->config.joint[i];
    double x[ZYGOS_MAX_IMPULSE + 1] = { 0.0 };
    const double noise = motor_noise(work, i, x);
    const double arc_s = work->sums->config.period_s * (double)work->sums->config.impulse_arc_cycles;
    const double reading =
        joint->link_sigma_rad * joint->link_sigma_rad + joint->motor_sigma_rad * joint->motor_sigma_rad;
    return noise + x[1] * x[1] * reading * arc_s * arc_s / WALK;
}

/* Adds the motor rows of each joint to those of the energy, weighted by their noise where they have no weights yet.
   energy: mean square of the noise in an energy row. */
static void add_motors(zygos_solver_t *work, double energy)
{
    const zygos_motor_sums_t *sums = &work->sums->motors;
    const zygos_range_t arcs = work->blocks[ZYGOS_MOTOR_ROWS];
    const bool enough = (arcs.end - arcs.first >= ZYGOS_MIN_ARCS);
    for (uint32_t i = 0; i < work->sums->config.joints; i++) {
        uint32_t place[ZYGOS_MAX_IMPULSE + 1];
        const uint32_t columns = motor_places(work, i, place);
        if ((columns > 0) && !(work->weight[i] > 0.0)) {
            const double joint = joint_variance(work, i);
            work->weight[i] = ((joint > 0.0) && enough) ? energy / joint : 0.0;
        }
        for (uint32_t b = arcs.first; (b < arcs.end) && (work->weight[i] > 0.0); b++) {
            const zygos_motor_block_t *arc = zygos_motor_sums_at(sums, b);
            embed(arc->joint[i].gram, place, columns, work->weight[i], work->total, 1u);
            embed(sums->noise[i], place, (columns > 0) ? columns - 1u : 0u, work->weight[i] * arc->instants[i],
                  work->noise, 1u);
        }
    }
}

/* Adds the error that noise may hide to the sigmas. */
static void widen(const zygos_solver_t *work, uint32_t p, zygos_estimate_t *out)
{
    for (uint32_t i = 0; i < p; i++) {
        out->covariance[entry_at(i, i)] += work->noise_square[i];
        out->sigma[i] = __builtin_sqrt(out->covariance[entry_at(i, i)]);
    }
}

/* The jackknife shows only errors that differ between blocks. Two parts of the residuals may be the same in all blocks
   and do not average out: the part that adds up within a block, and the part that the declared noise does not explain.
   Of the latter, the error of one arc of the longest kind is kept. */
static void add_common_error(const zygos_solver_t *work, uint32_t p, double systematic, zygos_estimate_t *out)
{
    const double half_s = 0.5 * work->sums->config.period_s * (double)work->sums->config.joint_row_cycles;
    const double joints = (double)work->sums->config.joints;
    const double blocks = work->joints_alone ? work->sums->joints.joint_sums / joints
                                             : (double)blocks_of(work, (uint32_t)ZYGOS_ENERGY_ROWS);
    const double arcs = work->joints_alone ? work->instants / joints * half_s / SYSTEMATIC_S
                                           : work->instants / (double)work->sums->config.arc_cycles;
    /* The noise of torques adds up from row to row, as far as any noise does. */
    const double noise = work->joints_alone ? ZYGOS_CLUSTER_LIMIT : ZYGOS_CLUSTER_NOISE;
    const double alike = (out->cluster > noise) ? 1.0 - noise / out->cluster : 0.0;
    const double adds = (blocks - 1.0) * alike;
    const double stays = arcs * zygos_larger(systematic, ZYGOS_SYSTEMATIC);
    for (uint32_t k = 0; k < entry_at(p, 0); k++) {
        out->covariance[k] *= 1.0 + zygos_larger(adds, stays);
    }
}

/* Adds the deviation of a block, scaled, to every second number of out. */
static void scale_deviation(const zygos_solver_t *work, uint32_t p, uint32_t b, double *out)
{
    const zygos_accumulator_t *sums = &work->sums->energy;
    const double *deviation = zygos_accumulator_deviation(sums, zygos_accumulator_at(sums, b));
    for (uint32_t i = 0; i < p; i++) {
        out[2u * i] += deviation[i] * work->scale[i];
    }
}

/* The noise of torques walks in the work of an arc, so that its errors are alike in neighbouring blocks, and the
   scatter of blocks shows too little of them. A step of the walk acts on the sums of all centred rows behind it. These
   are the sums of the deviations of the blocks, in order of time; within a block they change evenly, from u to next.
   Where a block of an arc is lacking they do not end with 0; the rest is shared out to all instants. */
static void add_torque_noise(zygos_solver_t *work, uint32_t p, double *covariance)
{
    double(*x)[2] = work->influence; /* the sums so far, and the next ones */
    double(*step)[2] = work->column; /* of two blocks */
    double(*rest)[2] = work->change;
    const zygos_range_t used = work->blocks[ZYGOS_ENERGY_ROWS];
    memset(x, 0, p * sizeof x[0]);
    memset(rest, 0, p * sizeof rest[0]);
    for (uint32_t b = used.first; b < used.end; b++) {
        scale_deviation(work, p, b, &rest[0][0]);
    }
    solve_again(work, p, rest);
    for (uint32_t b = used.first; b < used.end; b++) {
        const zygos_block_t *block = zygos_accumulator_at(&work->sums->energy, b);
        const uint32_t side = (b - used.first) % 2u;
        if (side == 0u) {
            memset(step, 0, p * sizeof step[0]);
            scale_deviation(work, p, b, &step[0][0]);
            if (b + 1u < used.end) {
                scale_deviation(work, p, b + 1u, &step[0][1]);
            }
            solve_again(work, p, step);
        }
        const double share = block->head.total / work->instants;
        /* The integral of the square of what goes from u to v, u u' + (u v' + v u') / 2 + v v', as two squares. */
        const double factor[2] = { block->variance[0] / 3.0, block->variance[0] / 4.0 };
        for (uint32_t i = 0; i < p; i++) {
            x[i][1] = x[i][0] + step[i][side] - share * rest[i][0];
            x[i][0] += 0.5 * x[i][1];
        }
        add_squares(covariance, p, x, factor);
        for (uint32_t i = 0; i < p; i++) {
            x[i][0] = x[i][1];
        }
    }
}

/* Sets what a unit of information on gain g costs in variance, at least so much that its prior leaves the rank full. */
static void set_gain_cost(zygos_solver_t *work, uint32_t p, uint32_t g, double cost)
{
    const double scale = work->scale[p - work->gains + g];
    const double least = (scale > 0.0) ? __builtin_sqrt(LEAST_PRIOR) * gain_sigma(work, g) / scale : 0.0;
    work->gain_cost[g] = (cost > least * least) ? __builtin_sqrt(cost) : least;
}

/* Gives the gains, which were held, their prior. It stands beside the sums as information does that is worth as much:
   what a unit costs in variance is seen from the scatter of the blocks, with gains of which next to nothing is assumed.
   covariance: scratch memory. */
static void release_gains(zygos_solver_t *work, uint32_t p, uint32_t rank, double *covariance)
{
    const uint32_t first = p - work->gains;
    double explained = 0.0;
    const double left = energy_left(work, p, &explained) / work->instants;
    work->gains_held = 0;
    for (uint32_t g = 0; g < work->gains; g++) {
        set_gain_cost(work, p, g, left * gain_sigma(work, g) * gain_sigma(work, g));
    }
    uint32_t ranks[2];
    solve_with(work, p, rank, work->noise_scale, work->noise_scale, ranks);
    (void)invert(work, p, work->inverse);
    memset(covariance, 0, entry_at(p, 0) * sizeof covariance[0]);
    const parts_t parts = parts_of(work);
    score_noise(work, p);
    for (uint32_t b = 0; b < blocks_of_all(&parts); b += 2u) {
        const couple_t couple = influences(work, p, &parts, b);
        for (uint32_t g = first; g < p; g++) {
            for (uint32_t side = 0; side < couple.count; side++) {
                covariance[entry_at(g, g)] += couple.factor[side] * work->influence[g][side] * work->influence[g][side];
            }
        }
    }
    if (work->joints_alone == 0) {
        add_torque_noise(work, p, covariance);
    }
    for (uint32_t g = 0; g < work->gains; g++) {
        const double scale = work->scale[first + g];
        const double information = work->inverse[first + g] * scale * scale;
        set_gain_cost(work, p, g, (information > 0.0) ? covariance[entry_at(first + g, first + g)] / information : 0.0);
    }
}

/* Adds what the errors of the sensors' gains make of the solution: u = A^-1 prior e of each gain, and their sum of the
   sensor that the gains are relative to. Of each gain the estimate without a prior is so judged as well: it has the
   error of the gain itself, less what the prior takes off, and that of the rows. */
static void add_prior(zygos_solver_t *work, uint32_t p, double *covariance)
{
    const uint32_t first = p - work->gains;
    const double limit = ZYGOS_GAIN_SIGMAS * ZYGOS_GAIN_SIGMAS;
    double(*u)[2] = work->change;
    double *all = work->right_side;
    memset(all, 0, p * sizeof all[0]);
    double scatter[ZYGOS_MAX_JOINTS] = { 0.0 };
    double expected[ZYGOS_MAX_JOINTS] = { 0.0 };
    memset(work->prior_variance, 0, p * sizeof work->prior_variance[0]);
    for (uint32_t g = 0; g < work->gains; g++) {
        scatter[g] = covariance[entry_at(first + g, first + g)];
    }
    for (uint32_t g = 0; (g <= work->gains) && (work->gains > 0); g++) {
        const bool reference = (g == work->gains);
        const double sigma = reference ? work->gain_reference : gain_sigma(work, g);
        const double square[2] = { sigma * sigma, 0.0 };
        memset(u, 0, p * sizeof u[0]);
        for (uint32_t h = 0; h < work->gains; h++) {
            u[first + h][0] = reference ? all[first + h] : prior(work, g, h) * work->scale[first + h];
            all[first + h] += u[first + h][0];
        }
        solve_again(work, p, u);
        for (uint32_t i = 0; i < p; i++) {
            work->prior_variance[i] += square[0] * u[i][0] * u[i][0];
        }
        add_squares(covariance, p, u, square);
        for (uint32_t h = 0; h < work->gains; h++) {
            const double passes = (((h == g) || reference) ? 1.0 : 0.0) - u[first + h][0];
            expected[h] += square[0] * passes * passes;
        }
    }
    work->gains_differ = 0;
    work->gains_seen = 0;
    for (uint32_t g = 0; g < work->gains; g++) {
        const double square = work->solution[first + g] * work->solution[first + g];
        const double factor = student(work->degrees_of_freedom[first + g]) / TWO_SIGMAS;
        const double unsure = factor * factor * scatter[g];
        work->gains_differ += (square > limit * (expected[g] + unsure)) ? 1u : 0u;
        work->gains_seen += (square > limit * unsure) ? 1u : 0u;
    }
}

/* The 95 % intervals: Student's factor for what is known from the scatter of blocks, that of a normal distribution for
   the prior. */
static void write_intervals(const zygos_solver_t *work, uint32_t p, zygos_estimate_t *out)
{
    for (uint32_t i = 0; i < p; i++) {
        const double certain = work->prior_variance[i];
        const double scatter = zygos_larger(out->sigma[i] * out->sigma[i] - certain, 0.0);
        const double factor = student(work->degrees_of_freedom[i]);
        const double square = factor * factor * scatter + TWO_SIGMAS * TWO_SIGMAS * certain;
        out->half95[i] = (certain > 0.0) ? __builtin_sqrt(square) : factor * out->sigma[i];
    }
}

static bool is_precise(const zygos_solver_t *work, const zygos_estimate_t *out, uint32_t i, double limit)
{
    return out->sigma[i] <= limit * work->size[i];
}

/* The error of an imprecise value is also in the others: where the rank is full only because of noise, every value is
   determined by noise. Therefore the equations are solved again without the imprecise values, and the change is added
   to the sigmas of the others. Columns that were removed from the factorisation have no such influence. An effect may
   be zero, so that its sigma cannot be compared with a size. */
static void withhold_imprecise(zygos_solver_t *work, bool full, zygos_estimate_t *out)
{
    const uint32_t p = work->column_map.parameters;
    const uint32_t effects = work->column_map.reduced;
    bool imprecise = false;
    for (uint32_t i = 0; i < effects; i++) {
        imprecise = imprecise || !is_precise(work, out, i, ZYGOS_SIGMA_LIMIT);
    }
    if (imprecise && full) {
        uint32_t rank[2];
        equations_of_all(work, p, p, work->noise_scale, work->noise_scale);
        for (uint32_t i = 0; i < effects; i++) {
            if (!is_precise(work, out, i, ZYGOS_SIGMA_LIMIT)) {
                hold(work, p, i, 0.0);
            }
        }
        solve_both(work, p, rank);
        for (uint32_t i = 0; i < p; i++) {
            const double shift = work->change[i][0] - out->value[i];
            out->sigma[i] = __builtin_sqrt(out->sigma[i] * out->sigma[i] + shift * shift);
            out->covariance[entry_at(i, i)] += shift * shift;
        }
    }
    const double limit = (imprecise && full) ? ZYGOS_SIGMA_LIMIT_BESIDE : ZYGOS_SIGMA_LIMIT;
    for (uint32_t i = 0; i < effects; i++) {
        if (!out->identifiable[i] || !is_precise(work, out, i, limit)) {
            withhold(out, i, p);
        }
    }
}

static int refuse(zygos_estimate_t *out, uint32_t p, uint32_t reason)
{
    for (uint32_t i = 0; i < p; i++) {
        withhold(out, i, p);
        out->solution[i] = not_a_number();
    }
    out->validity = ZYGOS_REFUSED;
    out->reason = reason;
    return 0;
}

/* Mean over the blocks of (sum of residuals)^2 / sum of squared weights, in units of the mean square residual; *share
   is the root mean square of the blocks' mean residuals, in units of the work's spread. */
static double cluster(const zygos_solver_t *work, uint32_t p, double residual, double *share)
{
    const zygos_range_t used = work->blocks[ZYGOS_ENERGY_ROWS];
    double squares = 0.0;
    double means = 0.0;
    for (uint32_t b = used.first; b < used.end; b++) {
        const zygos_block_t *block = zygos_accumulator_at(&work->sums->energy, b);
        const double *deviation = zygos_accumulator_deviation(&work->sums->energy, block);
        double sum = deviation[p];
        for (uint32_t i = 0; i < p; i++) {
            sum -= work->solution[i] * deviation[i];
        }
        squares += (block->square > 0.0) ? sum * sum / block->square : 0.0;
        means += (block->head.total > 0.0) ? sum * sum / (block->head.total * block->head.total) : 0.0;
    }
    const double blocks = (double)(used.end - used.first);
    const double spread = __builtin_sqrt(work->spread / work->instants);
    *share = __builtin_sqrt(means / blocks) / spread;
    return squares / (blocks * residual * residual);
}

/* The first of the closed blocks from a rank on that ends behind a cycle, or their number. */
static uint32_t first_behind(const zygos_store_t *store, uint32_t kind, uint32_t rank, uint64_t cycle)
{
    while ((rank < store->closed) && (zygos_store_head(store, kind, rank)->end <= cycle)) {
        rank++;
    }
    return rank;
}

/* Begins to choose rows: no blocks are, and nothing is in their sums. */
static void choose_none(zygos_solver_t *work, uint32_t p, bool joints)
{
    memset(work->blocks, 0, sizeof work->blocks);
    memset(work->total, 0, entry_at(p + 1u, 0) * sizeof work->total[0]);
    memset(work->noise, 0, entry_at(p + 1u, 0) * sizeof work->noise[0]);
    work->instants = 0.0;
    work->joints_alone = joints ? 1u : 0u;
    work->joints_used = joints ? 1u : 0u;
    work->joints_weight = joints ? 1.0 : 0.0;
}

/* Chooses the blocks that are used, and sums those of the energy. The weights of all rows follow from the solution. */
static void choose(zygos_solver_t *work, uint32_t p, uint32_t first, uint32_t end)
{
    const zygos_accumulator_t *sums = &work->sums->energy;
    const uint64_t after = (first > 0) ? zygos_accumulator_at(sums, first - 1u)->head.end : 0u;
    const bool all_of = (end == sums->store.closed); /* also what has ended since the newest block of energy rows */
    const uint64_t until = all_of ? UINT64_MAX : ((end > 0) ? zygos_accumulator_at(sums, end - 1u)->head.end : 0u);
    double all = 0.0;
    choose_none(work, p, false);
    memset(work->weight, 0, sizeof work->weight);
    work->momentum_weight = 0.0;
    work->joints_used = ((first == 0) && all_of) ? 1u : 0u;
    work->blocks[ZYGOS_ENERGY_ROWS] = (zygos_range_t){ first, end };
    for (uint32_t kind = ZYGOS_MOTOR_ROWS; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
        const zygos_store_t *store = zygos_sums_store(work->sums, kind);
        const uint32_t from = first_behind(store, kind, 0, after);
        work->blocks[kind] = (zygos_range_t){ from, first_behind(store, kind, from, until) };
    }
    for (uint32_t b = 0; b < sums->store.closed; b++) {
        const zygos_block_t *block = zygos_accumulator_at(sums, b);
        all += block->head.total;
        if ((b >= first) && (b < end)) {
            increase(work->total, block->gram, 1.0, entry_at(p + 1u, 0));
            work->instants += block->head.total;
        }
    }
    work->spread = work->total[entry_at(p, p)];
    work->noise_fraction = (all > 0.0) ? work->instants / all : 0.0;
    increase(work->noise, sums->noise_closed.gram, work->noise_fraction, entry_at(p + 1u, 0));
}

/* Chooses joint rows alone, of all groups, with all of their declared noise. */
static void choose_joints(zygos_solver_t *work, uint32_t p)
{
    const zygos_joint_sums_t *sums = &work->sums->joints;
    choose_none(work, p, true);
    for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
        increase(work->total, sums->group[g].gram, group_factor(work, g), entry_at(p + 1u, 0));
        work->instants += sums->fade[g] * sums->count[g];
    }
    const double all = zygos_joint_sums_rows(sums);
    increase(work->noise, sums->noise.gram, (all > 0.0) ? work->instants / all : 0.0, entry_at(p + 1u, 0));
    work->spread = work->total[entry_at(p, p)];
    work->noise_fraction = 1.0;
}

/* Number of groups with rows. */
static uint32_t groups_of(const zygos_joint_sums_t *sums)
{
    uint32_t groups = 0;
    for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
        groups += (sums->count[g] > 0.0) ? 1u : 0u;
    }
    return groups;
}

/* Solves the energy rows of the chosen blocks, weighs the motor rows beside them unless they have weights, and scales
   the sums of both. Returns their rank. */
static uint32_t with_motors(zygos_solver_t *work, uint32_t p)
{
    const uint32_t rank = scale_sums(work, p);
    const bool others =
        (blocks_of(work, (uint32_t)ZYGOS_MOMENTUM_ROWS) > 0) || (zygos_joint_sums_rows(&work->sums->joints) > 0.0);
    work->alone = 0.0;
    if (((blocks_of(work, (uint32_t)ZYGOS_MOTOR_ROWS) == 0) && !others) || (rank == 0)) {
        return rank;
    }
    double weight[ZYGOS_MAX_JOINTS];
    memcpy(weight, work->weight, sizeof weight);
    memset(work->weight, 0, sizeof work->weight);
    (void)solve_beside_noise(work, p, rank, NULL);
    double explained = 0.0;
    work->alone = energy_left(work, p, &explained);
    memcpy(work->weight, weight, sizeof weight);
    add_motors(work, explained / work->instants);
    return scale_sums(work, p);
}

/* Weighs the momentum rows of the chosen blocks unless they have a weight, by what the declared noise makes of a row of
   either kind at the solution so far, and scales the sums of all rows. Returns their rank. Rows of fewer than three
   arcs are left out, and without declared noise all. */
static uint32_t with_momentum(zygos_solver_t *work, uint32_t p, uint32_t rank)
{
    const zygos_momentum_sums_t *sums = &work->sums->momentum;
    zygos_range_t *used = &work->blocks[ZYGOS_MOMENTUM_ROWS];
    if ((rank == 0) || (used->end < used->first + ZYGOS_MIN_ARCS)) {
        used->end = used->first;
        return rank;
    }
    double weight = work->momentum_weight;
    double all = 0.0;
    double chosen = 0.0;
    for (uint32_t b = 0; b < sums->store.closed; b++) {
        const double instants = zygos_momentum_sums_at(sums, b)->head.total;
        all += instants;
        chosen += ((b >= used->first) && (b < used->end)) ? instants : 0.0;
    }
    work->momentum_weight = 0.0;
    if (!(weight > 0.0)) {
        double energy = 0.0;
        (void)solve_beside_noise(work, p, rank, NULL);
        (void)energy_left(work, p, &energy);
        const double noise = momentum_form(work, &sums->noise_closed) / all;
        weight = (noise > 0.0) ? energy / work->instants / (MOMENTUM_CORRELATION * noise) : 0.0;
    }
    used->end = (weight > 0.0) ? used->end : used->first;
    work->momentum_weight = weight;
    for (uint32_t b = used->first; b < used->end; b++) {
        add_momentum_arc(work, b, work->total, 1u);
    }
    uint32_t place[ZYGOS_MAX_MOMENTUM];
    embed(sums->noise_closed.gram, place, momentum_places(work, place), weight * chosen / all, work->noise, 1u);
    return scale_sums(work, p);
}

/* Weighs the joint rows beside the others, by what the declared noise makes of an energy row, and by the mean square
   residual of the joint rows: first as declared at the solution so far, then as it is at the solution with them. Scales
   the sums of all rows. Returns their rank. Where parts of the arcs are chosen they are left out, for the groups belong
   to the whole run. */
static uint32_t with_joints(zygos_solver_t *work, uint32_t p, uint32_t rank)
{
    const zygos_joint_sums_t *sums = &work->sums->joints;
    if ((rank == 0) || (work->joints_used == 0) || (sums->width == 0) || (groups_of(sums) < ZYGOS_MIN_GROUPS)) {
        return rank;
    }
    uint32_t now = rank;
    double rows = 0.0;
    double weighed = 0.0;
    for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
        rows += sums->fade[g] * sums->count[g];
    }
    for (uint32_t round = 0; round < 2u; round++) {
        double explained = 0.0;
        (void)solve_beside_noise(work, p, now, NULL);
        (void)energy_left(work, p, &explained);
        double square = zygos_gram_form(sums->noise.gram, work->solution, p + 1u);
        for (uint32_t g = 0; (g < (uint32_t)ZYGOS_GROUP_PLACES) && (round > 0); g++) {
            square += sums->fade[g] * zygos_gram_form(sums->group[g].gram, work->solution, p + 1u);
        }
        const double energy = explained / work->instants;
        const double weight = (square > 0.0) ? energy * rows / (JOINT_CORRELATION * square) : 0.0;
        if (!(weight > 0.0)) {
            return scale_sums(work, p); /* of the sums with their noise again */
        }
        const double more = weight - weighed;
        for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
            increase(work->total, sums->group[g].gram, more * sums->fade[g], entry_at(p + 1u, 0));
        }
        increase(work->noise, sums->noise.gram, more, entry_at(p + 1u, 0));
        weighed = weight;
        work->joints_weight = weight;
        now = scale_sums(work, p);
    }
    return now;
}

/* Weighs all rows of the chosen blocks, and scales their sums. Returns their rank. */
static uint32_t combine(zygos_solver_t *work, uint32_t p)
{
    if (work->joints_alone != 0u) {
        return scale_sums(work, p);
    }
    return with_joints(work, p, with_momentum(work, p, with_motors(work, p)));
}

/* The same of the joint rows: by the sums of each joint's residuals in a segment. */
static double cluster_of_joints(const zygos_solver_t *work, uint32_t p, double residual, double *share)
{
    const zygos_joint_sums_t *sums = &work->sums->joints;
    const double apart = zygos_gram_form(sums->joints.gram, work->solution, p + 1u);
    const double squares = (sums->joint_sums > 0.0) ? apart / sums->joint_sums : 0.0;
    /* Each sum is divided by the root of twice its number of rows. */
    const double rows = (sums->joint_sums > 0.0) ? work->instants / sums->joint_sums : 1.0;
    *share = (work->spread > 0.0) ? __builtin_sqrt(2.0 * squares / rows * work->instants / work->spread) : 0.0;
    return squares / (residual * residual);
}

/* What the noise of the torques, which walks in the work of an arc, adds to the statistic of cluster(), times the mean
   square residual: at most, for the solution takes most of it. */
static double walk_in_clusters(const zygos_solver_t *work)
{
    const zygos_range_t used = work->blocks[ZYGOS_ENERGY_ROWS];
    double sum = 0.0;
    double walked = 0.0; /* by the arc so far */
    double weights = 0.0;
    for (uint32_t b = used.first; b < used.end; b++) {
        const zygos_block_t *block = zygos_accumulator_at(&work->sums->energy, b);
        const bool last =
            (b + 1u == used.end) || (zygos_accumulator_at(&work->sums->energy, b + 1u)->head.end != block->head.end);
        walked += block->variance[0];
        weights += (block->square > 0.0) ? block->head.total * block->head.total / block->square : 0.0;
        sum += last ? weights * walked / 6.0 : 0.0; /* mean square of a walk about its own mean */
        walked = last ? 0.0 : walked;
        weights = last ? 0.0 : weights;
    }
    return sum / (double)(used.end - used.first);
}

/* What the solution leaves over of the energy rows; or of the joint rows where they alone are solved. */
typedef struct {
    double square;    /* squared residuals, including noise [J^2] */
    double explained; /* the part of the declared noise in them */
    double cluster;   /* see ZYGOS_CLUSTER_LIMIT */
    double share;     /* see cluster() */
    double walk;      /* what the noise of the torques adds to the cluster statistic; 0 of joint rows */
} residuals_t;

static residuals_t residuals_of(const zygos_solver_t *work, uint32_t p)
{
    residuals_t out = { .share = 0.0 };
    out.square = energy_left(work, p, &out.explained);
    const double residual = __builtin_sqrt(out.square / work->instants);
    if ((residual > 0.0) && (work->joints_alone != 0)) {
        out.cluster = cluster_of_joints(work, p, residual, &out.share);
    } else if (residual > 0.0) {
        out.cluster = cluster(work, p, residual, &out.share);
        out.walk = walk_in_clusters(work) / (residual * residual);
    }
    return out;
}

/* Whether the residuals are noise: see ZYGOS_CLUSTER_LIMIT. Writes residual, noise_ratio and cluster. */
static bool report_residuals(const zygos_solver_t *work, const residuals_t *left, zygos_estimate_t *out)
{
    const double least = work->joints_alone ? ZYGOS_JOINT_CLUSTER_SHARE : ZYGOS_CLUSTER_SHARE;
    out->residual = __builtin_sqrt(left->square / work->instants);
    out->noise_ratio = (left->explained > 0.0) ? left->square / left->explained : not_a_number();
    out->cluster = left->cluster;
    return (left->cluster <= ZYGOS_CLUSTER_LIMIT) || (left->share <= least);
}

/* Sum of the squares of a joint's motor rows that no values of their own parameters explain: what is left of the right
   side when all columns have been eliminated. count: of columns, the gain not among them. */
static double least_left(double *gram, uint32_t count)
{
    for (uint32_t k = 0; k < count; k++) {
        const double pivot = gram[entry_at(k, k)];
        for (uint32_t i = k + 1u; (i <= count) && (pivot > 0.0); i++) {
            const double factor = gram[entry_at(i, k)] / pivot;
            for (uint32_t j = k + 1u; j <= i; j++) {
                gram[entry_at(i, j)] -= factor * gram[entry_at(j, k)];
            }
        }
    }
    return gram[entry_at(count, count)];
}

/* Whether rows leave over more together with others than alone: excess, of what they leave alone, and as a share of the
   squares of their right side. */
static bool disturbed(double excess, double left, double limit, double squares)
{
    return (excess > limit * left) && (excess > ZYGOS_MISFIT_SHARE * ZYGOS_MISFIT_SHARE * squares);
}

/* The same of the energy rows. */
static bool energy_disturbed(const zygos_solver_t *work, uint32_t p, double together, double alone, double allowed)
{
    const double least = zygos_larger(ZYGOS_MISFIT_ENERGY, 2.0 * (double)p / work->instants);
    return (alone > 0.0) && disturbed(together - alone, alone, least * allowed, work->spread);
}

/* The same of the motor rows of joint i. allowed: factor of the limit. */
static bool motors_disturbed(const zygos_solver_t *work, uint32_t i, double allowed)
{
    const zygos_motor_sums_t *sums = &work->sums->motors;
    const zygos_range_t arcs = work->blocks[ZYGOS_MOTOR_ROWS];
    const uint32_t count = sums->column_map.count[i];
    double gram[ZYGOS_MAX_PACKED_IMPULSE + ZYGOS_MAX_IMPULSE + 1] = { 0.0 };
    double x[ZYGOS_MAX_IMPULSE + 1] = { 0.0 };
    double instants = 0.0;
    if ((count == 0) || !(work->weight[i] > 0.0)) {
        return false;
    }
    for (uint32_t b = arcs.first; b < arcs.end; b++) {
        for (uint32_t k = 0; k < entry_at(count + 1u, 0); k++) {
            gram[k] += zygos_motor_sums_at(sums, b)->joint[i].gram[k];
        }
        instants += zygos_motor_sums_at(sums, b)->instants[i];
    }
    const double noise = instants * motor_noise(work, i, x);
    const double together = zygos_gram_form(gram, x, count + 1u);
    const double squares = gram[entry_at(count, count)];
    /* The gain's column, the last one, is the right side with the other sign. */
    const uint32_t gain = ((count > 3u) && (work->sums->config.effect[sums->column_map.effect[i][count - 4u]].kind ==
                                            (uint32_t)ZYGOS_TORQUE_GAIN))
                              ? 1u
                              : 0u;
    const double reported = (gain != 0u) ? 1.0 + x[count - 1u] : 1.0;
    for (uint32_t a = 0; (a <= count - gain) && (gain != 0u); a++) {
        gram[entry_at(count - gain, a)] = (a < count - gain) ? gram[entry_at(count, a)] : gram[entry_at(count, count)];
    }
    const double alone = reported * reported * least_left(gram, count - gain);
    const double least = zygos_larger(ZYGOS_MISFIT_MOTORS, (double)count / instants);
    return disturbed(together - alone, alone + noise, least * allowed, squares);
}

/* Whether the solution fits all rows: no kind leaves over more than alone, and residuals do not add up in a block. It
   takes no declared noise of angles and rates. alone: squared residuals of the energy rows solved alone; 0 where there
   are no others. Where joint rows alone are solved, nothing is judged. */
static bool fits(const zygos_solver_t *work, uint32_t p, const residuals_t *left, double alone)
{
    const double walk = left->walk;
    if ((work->joints_alone != 0) || !(left->square > 0.0) || (walk > 1.0)) {
        return true;
    }
    bool good = (left->cluster <= ZYGOS_MISFIT_CLUSTER * (1.0 + walk)) || (left->share <= ZYGOS_MISFIT_CLUSTER_SHARE);
    good = good && !energy_disturbed(work, p, left->square, alone, 1.0 + walk);
    for (uint32_t i = 0; i < work->sums->config.joints; i++) {
        good = good && !motors_disturbed(work, i, 1.0 + walk);
    }
    return good;
}

/* Weighs all rows. Where gains are held while that is done, it judges whether the rows fit, gives the gains their
   priors, and weighs the rows again. Scales their sums, and returns their rank; 0: nothing is determined. */
static uint32_t weigh_rows(zygos_solver_t *work, uint32_t p, zygos_estimate_t *out)
{
    const uint32_t rank = combine(work, p);
    if ((rank == 0) || (work->gains_held == 0)) {
        return rank;
    }
    (void)solve_beside_noise(work, p, rank, NULL);
    const residuals_t left = residuals_of(work, p);
    work->fits = fits(work, p, &left, work->alone) ? 1u : 0u;
    release_gains(work, p, rank, out->covariance);
    if (work->joints_alone != 0) {
        return scale_sums(work, p);
    }
    /* Weights follow from a solution, and one with held gains may have been far off. */
    choose(work, p, work->blocks[ZYGOS_ENERGY_ROWS].first, work->blocks[ZYGOS_ENERGY_ROWS].end);
    return combine(work, p);
}

/* The same where the rows tell gains from 0, for which the energy rows alone have to be solved with these gains. It
   ends the use of the sums. left: of the solution. */
static bool fits_with_gains(zygos_solver_t *work, uint32_t p, const residuals_t *left)
{
    double explained = 0.0;
    if (work->joints_alone != 0) {
        return true;
    }
    const bool good = fits(work, p, left, 0.0);
    for (uint32_t g = 0; g < work->gains; g++) {
        work->gain_value[g] = work->solution[p - work->gains + g];
    }
    work->gains_held = 1;
    choose(work, p, work->blocks[ZYGOS_ENERGY_ROWS].first, work->blocks[ZYGOS_ENERGY_ROWS].end);
    (void)solve_beside_noise(work, p, scale_sums(work, p), NULL);
    const double alone = energy_left(work, p, &explained);
    return good && ((left->walk > 1.0) || !energy_disturbed(work, p, left->square, alone, 1.0 + left->walk));
}

/* A solution, and what its estimate is judged by. */
typedef struct {
    residuals_t left;
    double inverse; /* 1-norm of the inverse of the scaled matrix */
    double excess;  /* squared residuals that no subtracted noise explains */
    double hidden;  /* noise_square() of them */
    uint32_t rank;
    uint32_t known; /* number of parameters with a value */
    bool full;      /* whether the rank is, but for effects */
    bool closed;
    bool noisy; /* whether the signal-to-noise ratio is below its limit */
} solved_t;

/* What tells whether the residuals of a solution are those of bad arcs. */
typedef struct {
    double noise_ratio;
    double cluster;
} suspect_t;

/* Whether a solution without old arcs has far smaller residuals than that of all arcs. */
static bool far_smaller(const zygos_estimate_t *out, const suspect_t *all)
{
    return (CORRUPTED_RATIO * out->noise_ratio < all->noise_ratio) ||
           (ZYGOS_CLUSTER_LIMIT * out->cluster < all->cluster);
}

/* Begins the estimate from the given block on, with which an arc begins: what it is made of. */
static void describe(const zygos_solver_t *work, uint32_t first, zygos_estimate_t *out)
{
    const zygos_accumulator_t *sums = &work->sums->energy;
    double before = 0.0;
    memset(out, 0, sizeof *out);
    memcpy(out->left_out, work->sums->guard.left_out, sizeof out->left_out);
    for (uint32_t b = 0; b < first; b++) {
        before += zygos_accumulator_at(sums, b)->head.total;
        out->left_out[ZYGOS_ENERGY_ROWS] +=
            (zygos_accumulator_at(sums, b)->head.end != zygos_accumulator_at(sums, b + 1u)->head.end) ? 1u : 0u;
    }
    out->cycle = work->sums->cycle;
    out->refused = sums->refused;
    out->parameters = work->column_map.parameters;
    out->accepted = zygos_store_accepted(&sums->store) - (uint64_t)(before + 0.5);
    out->arcs = sums->store.arcs - (out->left_out[ZYGOS_ENERGY_ROWS] - work->sums->guard.left_out[ZYGOS_ENERGY_ROWS]);
    out->blocks = sums->store.closed - first;
    if (zygos_joint_sums_suffice(&work->sums->config)) {
        out->accepted = work->sums->joints.accepted;
        out->refused = work->sums->joints.refused;
        out->arcs = (uint32_t)work->sums->joints.segments;
        out->blocks = groups_of(&work->sums->joints);
    }
    out->since = (first > 0) ? zygos_accumulator_at(sums, first - 1u)->head.end : 0u;
    out->consecutive = work->sums->guard.consecutive[ZYGOS_ENERGY_ROWS];
}

/* Chooses the rows of the estimate. Returns the reason for which there are too few, if they are. */
static uint32_t choose_from(zygos_solver_t *work, uint32_t p, uint32_t first, const zygos_estimate_t *out)
{
    const bool joints = zygos_joint_sums_suffice(&work->sums->config);
    work->gains_held = (work->gains > 0) ? 1u : 0u;
    memset(work->gain_value, 0, sizeof work->gain_value);
    if (joints) {
        choose_joints(work, p);
    } else {
        choose(work, p, first, work->sums->energy.store.closed);
    }
    const double rows = joints ? work->instants : (double)out->accepted;
    if ((rows < (double)(INSTANTS_PER_PARAMETER * p)) ||
        (out->blocks < ((joints || (first > 0)) ? ZYGOS_MIN_GROUPS : ZYGOS_LEAST_BLOCKS))) {
        /* A refused instant costs a whole increment, so that no row may be left of a fast motion. */
        return (joints && (out->refused > out->accepted)) ? ZYGOS_REASON_TOO_FAST : ZYGOS_REASON_NO_DATA;
    }
    return ZYGOS_REASON_NONE;
}

/* Solves the chosen rows. Returns the reason for which there is no solution, if there is none. */
static uint32_t solve_chosen_rows(zygos_solver_t *work, uint32_t p, solved_t *found, zygos_estimate_t *out)
{
    found->rank = weigh_rows(work, p, out);
    out->rank = found->rank;
    if (found->rank == 0) {
        return ZYGOS_REASON_NOT_IDENTIFIABLE;
    }
    mark_identifiable(work, p, found->rank, out);
    found->full = true;
    for (uint32_t d = found->rank; d < p; d++) {
        found->full = found->full && (work->pivot[d] >= work->column_map.reduced);
    }
    if (solve_beside_noise(work, p, found->rank, &out->signal_to_noise) < found->rank) {
        return ZYGOS_REASON_NOISE;
    }
    found->left = residuals_of(work, p);
    if (work->gains == 0) {
        work->fits = fits(work, p, &found->left, work->alone) ? 1u : 0u;
    }
    found->inverse = invert(work, p, work->inverse);
    out->condition = found->inverse * norm_of(work, p, found->rank);
    memcpy(out->value, work->solution, p * sizeof out->value[0]);
    memcpy(out->solution, work->solution, p * sizeof out->solution[0]);
    found->closed = report_residuals(work, &found->left, out);
    found->noisy = !(out->signal_to_noise >= ZYGOS_MIN_SIGNAL_TO_NOISE);
    return ZYGOS_REASON_NONE;
}

/* The reason for which a solution does not tell the parameters. */
static uint32_t unidentified(const solved_t *found)
{
    if (!found->closed) {
        return ZYGOS_REASON_UNCLOSED;
    }
    return found->noisy ? ZYGOS_REASON_NOISE : ZYGOS_REASON_NOT_IDENTIFIABLE;
}

/* Returns the reason for which the residuals of a solution are too large, if they are. */
static uint32_t judge_residuals(const zygos_solver_t *work, uint32_t p, solved_t *found, const zygos_estimate_t *out)
{
    if (!(found->left.square < ZYGOS_UNEXPLAINED_LIMIT * work->spread)) {
        /* The residuals are no noise, so the arm moved. A torque whose sign follows the motion adds up to nothing in a
           segment of joint rows; it shows in that much more is left than the declared noise, of a motion that is no
           noise. */
        const bool louder = work->joints_alone && (out->noise_ratio > NOISE_EXCEEDED) && !found->noisy;
        return (found->closed && !louder) ? ZYGOS_REASON_NOT_IDENTIFIABLE : ZYGOS_REASON_UNEXPLAINED;
    }
    /* What joint rows leave over is in their right side, as the noise of torques is. */
    const double subtracted = work->joints_alone ? found->left.square : work->noise_scale * found->left.explained;
    found->excess = (found->left.square > subtracted) ? found->left.square - subtracted : 0.0;
    found->hidden = noise_square(work, p, found->excess);
    return (found->hidden * found->inverse <= ZYGOS_NOISE_LIMIT) ? ZYGOS_REASON_NONE : unidentified(found);
}

/* Writes the standard deviations and the intervals, and withholds what is not identifiable. Returns the reason for
   which most is not, if it is. */
static uint32_t write_sigmas(zygos_solver_t *work, uint32_t p, solved_t *found, zygos_estimate_t *out)
{
    const uint32_t effects = work->column_map.reduced;
    jackknife(work, p, found->rank, out->covariance);
    add_common_error(work, p, (found->excess > 0.0) ? found->excess / found->left.square : 0.0, out);
    if (work->joints_alone == 0) {
        add_torque_noise(work, p, out->covariance);
    }
    add_prior(work, p, out->covariance);
    shift_by_noise(work, p, found->hidden, found->noisy);
    widen(work, p, out);
    measure_parameters(work);
    withhold_imprecise(work, found->full, out);
    found->known = 0;
    for (uint32_t i = 0; i < effects; i++) {
        found->known += out->identifiable[i];
    }
    if (4u * found->known < effects) {
        return unidentified(found);
    }
    write_intervals(work, p, out);
    for (uint32_t i = effects; i < p; i++) {
        if (!out->identifiable[i] || !(out->sigma[i] < infinity())) {
            withhold(out, i, p);
        }
        found->known += out->identifiable[i];
    }
    return ZYGOS_REASON_NONE;
}

/* Why an estimate is doubtful, if it is. */
static uint32_t doubt_of(zygos_solver_t *work, uint32_t p, const solved_t *found, const zygos_estimate_t *out)
{
    const bool sound = physical(work, out);
    const bool fit = (work->gains_seen > 0) ? fits_with_gains(work, p, &found->left) : (work->fits != 0);
    if ((double)out->refused > MAX_REFUSED_SHARE * (double)(out->accepted + out->refused)) {
        return ZYGOS_REASON_TOO_FAST;
    }
    if (!sound) {
        return ZYGOS_REASON_NOT_PHYSICAL;
    }
    if (!found->closed || (!fit && !found->noisy && (found->known == p))) {
        return ZYGOS_REASON_UNCLOSED;
    }
    if (work->sums->guard.changed != 0) {
        return ZYGOS_REASON_CHANGED;
    }
    if (work->gains_differ > 0) {
        return ZYGOS_REASON_GAIN;
    }
    return (out->noise_ratio < ZYGOS_NOISE_ABSENT) ? ZYGOS_REASON_DECLARED : ZYGOS_REASON_NONE;
}

/* Solves the blocks from the given one on, with which an arc begins. all: null, or what the solution of all blocks has;
   then there is no answer where the residuals are not far smaller, or where the balance does not close: it would not be
   used, and the standard deviations are most of the cost. */
static int solve_from(zygos_solver_t *work, zygos_estimate_t *out, uint32_t first, const suspect_t *all)
{
    const uint32_t p = work->column_map.parameters;
    solved_t found = { .rank = 0 };
    describe(work, first, out);
    uint32_t reason = choose_from(work, p, first, out);
    if (reason == (uint32_t)ZYGOS_REASON_NONE) {
        reason = solve_chosen_rows(work, p, &found, out);
    }
    if ((reason == (uint32_t)ZYGOS_REASON_NONE) && (all != NULL) && (!found.closed || !far_smaller(out, all))) {
        reason = ZYGOS_REASON_UNCLOSED;
    }
    if (reason == (uint32_t)ZYGOS_REASON_NONE) {
        reason = judge_residuals(work, p, &found, out);
    }
    if (reason == (uint32_t)ZYGOS_REASON_NONE) {
        reason = write_sigmas(work, p, &found, out);
    }
    if (reason != (uint32_t)ZYGOS_REASON_NONE) {
        return refuse(out, p, reason);
    }
    out->reason = doubt_of(work, p, &found, out);
    out->validity = (out->reason != (uint32_t)ZYGOS_REASON_NONE) ? ZYGOS_DOUBTFUL : ZYGOS_VALID;
    if (out->validity == (uint32_t)ZYGOS_VALID) {
        if (found.noisy) {
            out->validity = (found.known < p) ? ZYGOS_PARTIAL : ZYGOS_DOUBTFUL;
            out->reason = ZYGOS_REASON_NOISE;
        } else if (found.known < p) {
            out->validity = ZYGOS_PARTIAL;
            out->reason = ZYGOS_REASON_NOT_IDENTIFIABLE;
        }
    }
    return 1;
}

/* Whether the cause of an invalid estimate may be in old arcs: the residuals are larger than noise. */
static bool may_hold_bad_arcs(const zygos_estimate_t *out)
{
    return (out->validity != (uint32_t)ZYGOS_VALID) && (out->reason != (uint32_t)ZYGOS_REASON_NO_DATA) &&
           (out->reason != (uint32_t)ZYGOS_REASON_CHANGED) &&
           ((out->reason == (uint32_t)ZYGOS_REASON_UNCLOSED) || (out->reason == (uint32_t)ZYGOS_REASON_UNEXPLAINED) ||
            (out->noise_ratio > CORRUPTED_RATIO));
}

/* First block of an arc, from the given one on. */
static uint32_t next_arc(const zygos_accumulator_t *sums, uint32_t from)
{
    uint32_t b = from;
    while ((b > 0) && (b < sums->store.closed) &&
           (zygos_accumulator_at(sums, b)->head.end == zygos_accumulator_at(sums, b - 1u)->head.end)) {
        b++;
    }
    return b;
}

/* Whether the blocks from the given one on are at least half of all, and of several arcs: the balance of a short piece
   closes even if that of the whole does not. */
static bool several_behind(const zygos_accumulator_t *sums, uint32_t first)
{
    double before = 0.0;
    double behind = 0.0;
    uint32_t arcs = 0;
    for (uint32_t b = 0; b < sums->store.closed; b++) {
        const bool last_of_arc = (b + 1u == sums->store.closed) || (zygos_accumulator_at(sums, b + 1u)->head.end !=
                                                                    zygos_accumulator_at(sums, b)->head.end);
        before += (b < first) ? zygos_accumulator_at(sums, b)->head.total : 0.0;
        behind += (b < first) ? 0.0 : zygos_accumulator_at(sums, b)->head.total;
        arcs += ((b >= first) && last_of_arc) ? 1u : 0u;
    }
    return (first + ZYGOS_MIN_GROUPS <= sums->store.closed) && (behind >= before) && (arcs >= ZYGOS_CONSECUTIVE_ARCS);
}

/* Couples of vectors of the solver, whose entries lie side by side, and vectors; and those of an estimate that is put
   aside, beside which one has its flags. */
#define COUPLES 4u
#define VECTORS 10u
#define ASIDE 4u
_Static_assert(2u * COUPLES + VECTORS + ASIDE + 1u <= ZYGOS_ROW_BUFFERS * ZYGOS_BUFFER_ROWS, "vectors without a place");
_Static_assert((ZYGOS_BUFFER_ROWS % 2u) == 0u, "a couple of vectors in two buffers");
_Static_assert(ZYGOS_MAX_PACKED <= ZYGOS_MAX_PACKED_ROW, "a covariance without a place");
_Static_assert(ZYGOS_MAX_NOISE_ROW > ZYGOS_MAX_PARAMETERS, "two systems of equations without a place");

/* A vector of p entries, where rows wait otherwise: eight in a buffer. */
static double *vector(zygos_accumulator_t *sums, uint32_t k)
{
    double *rows = sums->buffer[k / ZYGOS_BUFFER_ROWS].pair[0][0];
    return &rows[2u * ZYGOS_MAX_ROW_PAIRS * (k % ZYGOS_BUFFER_ROWS)];
}

/* What the solver needs beside the sums lies in the buffers and in the noise of open arcs, which are empty when all
   arcs have ended. Its matrices are empty again behind it; rows that waited need not be. */
static void borrow(zygos_solver_t *work)
{
    zygos_accumulator_t *sums = &work->sums->energy;
    zygos_balance_column_map(&work->sums->config, &work->column_map);
    work->gains = zygos_effects_gains(&work->sums->config);
    work->gains_held = (work->gains > 0) ? 1u : 0u;
    work->gains_differ = 0;
    work->gains_seen = 0;
    prepare_prior(work);
    memset(work->gain_cost, 0, sizeof work->gain_cost);
    memset(work->gain_value, 0, sizeof work->gain_value);
    work->total = sums->buffer[0].gram;
    work->noise = sums->buffer[1].gram;
    work->factor = sums->buffer[2].gram;
    work->matrix = (double(*)[2])sums->noise_open;
    double **vectors[VECTORS] = {
        &work->scale,          &work->right_side,     &work->solution,           &work->inverse,
        &work->information[0], &work->information[1], &work->degrees_of_freedom, &work->linearised_variance,
        &work->product,        &work->prior_variance
    };
    work->pull = (double(*)[2])vector(sums, 0);
    work->influence = (double(*)[2])vector(sums, 2u);
    work->change = (double(*)[2])vector(sums, 4u);
    work->column = (double(*)[2])vector(sums, 6u);
    for (uint32_t k = 0; k < VECTORS; k++) {
        *vectors[k] = vector(sums, 2u * COUPLES + k);
    }
    work->size = vector(sums, 0);
    work->noise_square = vector(sums, 1);
}

static void give_back(const zygos_solver_t *work)
{
    const uint32_t entries = entry_at(work->column_map.parameters + 1u, 0);
    memset(work->total, 0, entries * sizeof work->total[0]);
    memset(work->noise, 0, entries * sizeof work->noise[0]);
    memset(work->factor, 0, entries * sizeof work->factor[0]);
    memset(work->matrix, 0, entries * sizeof work->matrix[0]);
}

/* The free block with the last place; there is one while fewer than all are in use. */
static double *free_triangle(zygos_accumulator_t *sums)
{
    return sums->block[sums->store.order[ZYGOS_MAX_BLOCKS - 1]].gram;
}

/* What comes before the vectors of an estimate. */
typedef struct {
    unsigned char byte[offsetof(zygos_estimate_t, identifiable)];
} head_t;

/* Copies what an estimate has to a place, or back. */
static void carry_aside(void *own, void *aside, size_t size, bool back)
{
    memcpy(back ? own : aside, back ? aside : own, size);
}

/* Puts an estimate aside, or takes it back: its vectors into the places behind those of the solver, its covariance into
   a free block. */
static void put_aside(zygos_solver_t *work, zygos_estimate_t *out, head_t *head, bool back)
{
    zygos_accumulator_t *sums = &work->sums->energy;
    double *own[ASIDE] = { out->solution, out->value, out->sigma, out->half95 };
    const uint32_t p = work->column_map.parameters;
    const uint32_t first = 2u * COUPLES + VECTORS;
    for (uint32_t k = 0; k < ASIDE; k++) {
        carry_aside(own[k], vector(sums, first + k), p * sizeof(double), back);
    }
    carry_aside(out, head, sizeof *head, back);
    carry_aside(out->identifiable, vector(sums, first + ASIDE), p * sizeof out->identifiable[0], back);
    carry_aside(out->covariance, free_triangle(sums), entry_at(p, 0) * sizeof(double), back);
}

/* Repeats the solution without old arcs where they may be bad. The solution of all arcs is put aside meanwhile, so that
   it need not be made again. Where every block is in use, as at most in the first instants of an arc, there is no place
   for it, and it is the answer. */
static int solve_well(zygos_solver_t *work, zygos_estimate_t *out)
{
    const zygos_accumulator_t *sums = &work->sums->energy;
    int answer = solve_from(work, out, 0, NULL);
    if ((work->sums->guard.adopting == 0) || (work->joints_alone != 0) || !may_hold_bad_arcs(out) ||
        (sums->store.count >= (uint32_t)ZYGOS_MAX_BLOCKS)) {
        return answer;
    }
    const suspect_t all = { .noise_ratio = out->noise_ratio, .cluster = out->cluster };
    const int whole = answer;
    head_t head;
    uint32_t first = 0;
    bool better = false;
    put_aside(work, out, &head, false);
    for (uint32_t quarter = 1; !better && (quarter <= 2u); quarter++) {
        const uint32_t next = next_arc(sums, quarter * sums->store.closed / 4u);
        if ((next > first) && several_behind(sums, next)) {
            first = next;
            answer = solve_from(work, out, first, &all);
            better = ((out->validity == (uint32_t)ZYGOS_VALID) || (out->reason == (uint32_t)ZYGOS_REASON_CHANGED)) &&
                     far_smaller(out, &all);
        }
    }
    if (!better) {
        put_aside(work, out, &head, true);
        answer = whole;
    }
    memset(free_triangle(&work->sums->energy), 0, entry_at(work->column_map.parameters, 0) * sizeof(double));
    return answer;
}

int zygos_solver_solve(zygos_solver_t *self, zygos_estimate_t *out)
{
    borrow(self);
    const int answer = solve_well(self, out);
    give_back(self);
    zygos_change_compare(self->sums, &self->newest);
    return answer;
}

int zygos_solver_refuse(zygos_estimate_t *out)
{
    memset(out, 0, sizeof *out);
    return refuse(out, ZYGOS_MAX_PARAMETERS, ZYGOS_REASON_CORRUPT);
}

/* The sums are those of the copy. */
static zygos_solver_t *solver_of(zygos_work_t *work)
{
    work->solver.sums = &work->sums;
    return &work->solver;
}

int zygos_work_solve(zygos_work_t *work, zygos_estimate_t *out)
{
    if ((work == NULL) || (out == NULL)) {
        return ZYGOS_E_NULL;
    }
    return zygos_sums_end_copy(&work->sums) ? zygos_solver_solve(solver_of(work), out) : zygos_solver_refuse(out);
}
