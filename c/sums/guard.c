/* SPDX-License-Identifier: MIT */
#include "zygos/priv/guard.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"
#include "zygos/priv/sums.h"

#include <stddef.h>
#include <string.h>

#define LARGEST_SUM 1e150
#define TWO_SIGMAS 1.959964 /* 95 % of a normal distribution */
#define SIGMAS 6.0
/* Divisor of the mean square of a random walk about its own mean, as in the solver. */
#define WALK 10.0
/* Parts of tasks with which those of an arc have ended, whatever memory says. */
#define MOST_PARTS                                                                                                     \
    (8u * ZYGOS_PASS_CYCLES * (uint32_t)(ZYGOS_MAX_BLOCKS + ZYGOS_MAX_MOTOR_BLOCKS + ZYGOS_MOMENTUM_PLACES))
/* Shorter arcs are held together, until they are so many times as long as is enough to be compared. */
#define HELD_TOGETHER 3.0
/* An arc counts as agreeing when a residual of this share of its spread would have contradicted. */
#define INFORMATIVE 0.1

void zygos_guard_clear(zygos_guard_t *self, bool counters, uint64_t cycle)
{
    uint32_t left_out[ZYGOS_KINDS_OF_ROWS];
    zygos_left_out_t newest[ZYGOS_GUARD_ARCS];
    const uint32_t lost = counters ? 0u : self->lost;
    memcpy(left_out, self->left_out, sizeof left_out);
    memcpy(newest, self->newest, sizeof newest);
    memset(self, 0, sizeof *self);
    if (!counters) {
        memcpy(self->left_out, left_out, sizeof left_out);
        memcpy(self->newest, newest, sizeof newest);
    }
    self->lost = lost;
    self->since = cycle;
}

/* Each iteration is a bijection, so that every flipped bit changes the result. */
static uint64_t guard_checksum(const zygos_guard_t *self)
{
    const unsigned char *from = (const unsigned char *)&self->noise_ratio;
    const size_t fixed = offsetof(zygos_guard_t, covariance) - offsetof(zygos_guard_t, noise_ratio);
    const uint32_t p = zygos_least(self->parameters, (uint32_t)ZYGOS_MAX_PARAMETERS);
    const size_t words = fixed / sizeof(uint64_t) + zygos_gram_entries(p);
    uint64_t hash = 14695981039346656037u ^ self->parameters;
    for (size_t i = 0; i < words; i++) {
        uint64_t word;
        memcpy(&word, from + i * sizeof word, sizeof word);
        hash = (hash ^ word) * 1099511628211u;
    }
    return hash;
}

bool zygos_guard_intact(const zygos_guard_t *self)
{
    bool good = (self->known <= 1u) && (self->changed <= 1u) && (self->held_instants >= 0.0) &&
                (self->held_instants <= ZYGOS_MAX_INSTANTS);
    for (uint32_t k = 0; k < (uint32_t)ZYGOS_KINDS_OF_ROWS; k++) {
        good = good && (self->instants[k] >= 0.0) && (self->instants[k] <= ZYGOS_MAX_INSTANTS);
    }
    return good;
}

bool zygos_guard_has_solution(zygos_guard_t *self, uint32_t parameters)
{
    if (self->known == 0) {
        return false;
    }
    if ((self->parameters != parameters) || (self->checksum != guard_checksum(self))) {
        self->known = 0;
        self->lost++;
        return false;
    }
    return true;
}

/* Adds x~' G x~ and tr(G C) of the rows from first to before end of the columns at place[], or of those of all
   parameters. Returns the sum of the terms on the diagonal. */
static double add_residuals(const zygos_guard_t *self, const double *gram, const uint32_t *place, uint32_t first,
                            uint32_t end, zygos_finding_t *out)
{
    const double *from = &gram[zygos_gram_entries(first)];
    double diagonal = 0.0;
    for (uint32_t a = first; a < end; a++) {
        const uint32_t i = place ? place[a] : a;
        double product = 0.0;
        double trace = 0.0;
        for (uint32_t b = 0; (b < a) && (i < (uint32_t)ZYGOS_MAX_PARAMETERS); b++) {
            const uint32_t j = place ? place[b] : b;
            if (j < (uint32_t)ZYGOS_MAX_PARAMETERS) {
                product += from[b] * self->solution[j];
                trace += from[b] * zygos_gram_entry(self->covariance, i, j);
            }
        }
        if (i < (uint32_t)ZYGOS_MAX_PARAMETERS) {
            const double own = from[a] * self->solution[i];
            out->residual += self->solution[i] * (2.0 * product + own);
            out->uncertainty += 2.0 * trace + from[a] * zygos_gram_entry(self->covariance, i, i);
            diagonal += self->solution[i] * own;
        }
        from += a + 1u;
    }
    return diagonal;
}

/* Adds what the right side behind these columns adds to that. */
static void add_right_side(const zygos_guard_t *self, const double *gram, const uint32_t *place, uint32_t columns,
                           zygos_finding_t *out)
{
    const double *right = &gram[zygos_gram_entries(columns)];
    for (uint32_t a = 0; a < columns; a++) {
        out->residual -= 2.0 * right[a] * self->solution[place ? place[a] : a];
    }
    out->residual += right[columns];
    out->spread += right[columns];
}

double zygos_guard_chi_square_limit(double freedom)
{
    const double u = 2.0 / (9.0 * zygos_larger(freedom, 1.0));
    const double third = 1.0 - u + SIGMAS * __builtin_sqrt(u);
    return ZYGOS_GUARD_MARGIN * third * third * third;
}

/* The limit of the residuals: what n instants of the run leave on average, by number and by spread, or what the
   declared noise leaves. */
static double limit_of(const zygos_finding_t *found, const zygos_mean_squares_t *run, double n, double freedom)
{
    const double spread = zygos_larger(found->spread, n * run->spread);
    const double alike =
        zygos_larger(n * run->residual, (run->spread > 0.0) ? run->residual / run->spread * spread : 0.0);
    return zygos_guard_chi_square_limit(freedom) * zygos_larger(found->expected, alike) +
           SIGMAS * SIGMAS * zygos_larger(found->uncertainty, 0.0) + ZYGOS_GUARD_SHARE * ZYGOS_GUARD_SHARE * spread;
}

static uint32_t longest(const zygos_config_t *config, uint32_t rows)
{
    const bool joints = (rows == (uint32_t)ZYGOS_ENERGY_ROWS) && zygos_joint_sums_suffice(config);
    return joints ? zygos_joint_sums_longest(config) : zygos_store_longest(config, rows);
}

/* Number of consecutive arcs that mean a change of the arm. */
static uint32_t consecutive_limit(const zygos_config_t *config, uint32_t rows)
{
    const uint32_t own = longest(config, rows);
    if (rows == (uint32_t)ZYGOS_ENERGY_ROWS) {
        return ZYGOS_CONSECUTIVE_ARCS;
    }
    return ZYGOS_CONSECUTIVE_ARCS *
           (((own > 0) && (own < config->arc_cycles)) ? (config->arc_cycles + own - 1u) / own : 1u);
}

/* Counts an arc that was compared. informative: it could have contradicted. there: instants in the sums. */
static void count(zygos_guard_t *self, const zygos_config_t *config, uint32_t rows, bool contradicts, bool informative,
                  double n, double there, uint64_t cycle, uint32_t cycles)
{
    if (contradicts) {
        const uint32_t place = (self->left_out[0] + self->left_out[1] + self->left_out[2]) % ZYGOS_GUARD_ARCS;
        self->newest[place] = (zygos_left_out_t){ cycle, cycles, rows };
        self->left_out[rows]++;
        self->consecutive[rows]++;
        self->instants[rows] += n;
        self->agreeing_instants[rows] = 0.0;
    } else {
        self->agreeing_instants[rows] += informative ? n : 0.0;
    }
    if (self->agreeing_instants[rows] >= 0.5 * (double)longest(config, rows)) {
        self->consecutive[rows] = 0;
        self->instants[rows] = 0.0;
        self->agreeing_instants[rows] = 0.0;
    }
    self->changed = 0;
    for (uint32_t k = 0; k < (uint32_t)ZYGOS_KINDS_OF_ROWS; k++) {
        self->changed |= (self->consecutive[k] >= consecutive_limit(config, k)) ? 1u : 0u;
    }
    if ((self->changed != 0) && (self->instants[rows] > there)) {
        /* The sums hold fewer instants than the arcs that contradict; they are not adopted again before half an arc has
           been admitted. */
        self->known = 0;
        self->since = cycle + longest(config, (uint32_t)ZYGOS_ENERGY_ROWS) / 2u;
    }
}

/* Adds the rows of a part of the task: x~' G x~ and tr(G C) of the sums, and d' C d of the deviations, if there are. */
static void add_part(zygos_guard_t *self, const zygos_accumulator_t *sums, uint32_t end, const double *gram,
                     const double *deviation, zygos_finding_t *out)
{
    const uint32_t p = sums->width - 2u;
    const uint32_t row = sums->store.row;
    const uint32_t first = zygos_gram_entries(row);
    const double *from = &gram[first];
    const double *covariance = &self->covariance[(row < p) ? first : 0u];
    for (uint32_t i = row; (i < end) && (i < p); i++) {
        double product = 0.0;
        double trace = 0.0;
        double walk = 0.0;
        for (uint32_t j = 0; j < i; j++) {
            product += from[j] * self->solution[j];
            trace += from[j] * covariance[j];
            walk += deviation ? deviation[j] * covariance[j] : 0.0;
        }
        out->residual += self->solution[i] * (2.0 * product + from[i] * self->solution[i]);
        out->uncertainty += 2.0 * trace + from[i] * covariance[i];
        self->walk += deviation ? deviation[i] * (2.0 * walk + deviation[i] * covariance[i]) : 0.0;
        from += i + 1u;
        covariance += i + 1u;
    }
    if ((row <= p) && (end > p)) {
        add_right_side(self, gram, NULL, p, out);
    }
}

/* The sum of residuals of a block. */
static void add_block_residuals(zygos_guard_t *self, const zygos_block_t *block, const double *deviation, uint32_t p)
{
    if (!(block->square > 0.0)) {
        return;
    }
    double sum = deviation[p];
    for (uint32_t i = 0; i < p; i++) {
        sum -= self->solution[i] * deviation[i];
    }
    self->blocks.residual += sum * sum / block->square;
    self->blocks.uncertainty += self->walk / block->square;
    self->share += block->head.total * block->head.total / block->square;
    self->compared += 1.0;
}

/* The residuals of the closing arc over their limit, of which all blocks are compared. */
static double contradiction_of_energy(zygos_guard_t *self, const zygos_config_t *config, double n, bool *informative)
{
    const double window = 2.0 * (double)config->smoother_half_width + 1.0;
    self->rows.expected = self->noise_ratio * self->noise.residual;
    self->rows.residual += self->noise.residual;
    const double limit = limit_of(&self->rows, &self->energy, n, n / window);
    /* The squared sums of residuals in blocks: by the cluster statistic of the run and the expected mean square. */
    const double expected = zygos_larger(self->rows.expected / n, self->energy.residual);
    const double most = zygos_guard_chi_square_limit(0.5 * self->compared) * self->cluster * expected * self->compared +
                        SIGMAS * SIGMAS * zygos_larger(self->blocks.uncertainty, 0.0) +
                        ZYGOS_GUARD_SHARE * ZYGOS_GUARD_SHARE * self->energy.spread * self->share;
    const double first = (limit > 0.0) ? self->rows.residual / limit : 0.0;
    const double second = (most > 0.0) ? self->blocks.residual / most : 0.0;
    *informative = limit < INFORMATIVE * self->rows.spread;
    return zygos_larger(first, second);
}

double zygos_guard_enough(const zygos_config_t *config, uint32_t parameters)
{
    return zygos_larger(0.5 * (double)config->arc_cycles, ZYGOS_GUARD_HELD * (double)parameters);
}

/* Whether the closing arc is added to those that are held, or replaces them. */
static void begin_to_hold(zygos_guard_t *self, const zygos_config_t *config, const zygos_accumulator_t *sums)
{
    const zygos_store_t *store = &sums->store;
    const double enough = zygos_guard_enough(config, sums->width - 2u);
    const bool added = (self->held_instants > 0.0) && (self->held_instants < HELD_TOGETHER * enough) &&
                       ((double)store->closing_instants < enough);
    if (!added) {
        self->held_after = (store->closed > 0) ? zygos_accumulator_at(sums, store->closed - 1u)->head.end : 0u;
    }
    self->held_anew = added ? 0u : 1u;
    self->held_before = added ? self->held_instants : 0.0;
    self->held_arcs = added ? self->held_arcs + 1u : 1u;
    self->held_instants = 0.0;
}

/* Adds the rows of the part of the task. */
static void hold_part(zygos_guard_t *self, const zygos_accumulator_t *sums, uint32_t end, const zygos_block_t *block)
{
    const bool first = (self->held_anew != 0) && (sums->store.rank == sums->store.closed);
    const uint32_t rows = sums->width - 1u;
    const uint32_t last = zygos_gram_entries(zygos_least(end, rows));
    for (uint32_t k = zygos_gram_entries(sums->store.row); k < last; k++) {
        self->held.gram[k] = block->gram[k] + (first ? 0.0 : self->held.gram[k]);
    }
    for (uint32_t i = 0; (i < rows) && (end >= rows); i++) {
        self->held.sum[i] = block->sum[i] + (first ? 0.0 : self->held.sum[i]);
    }
}

/* Compares the next rows of the closing arc of energy rows, of a block or of the noise. */
static void judge_energy(zygos_guard_t *self, const zygos_accumulator_t *sums, uint32_t end)
{
    if (zygos_store_is_noise(&sums->store)) {
        add_part(self, sums, end, sums->noise_open[(sums->store.parity & 1u) ^ 1u].gram, NULL, &self->noise);
        return;
    }
    const zygos_block_t *block = zygos_accumulator_at(sums, sums->store.rank);
    const double *deviation = zygos_accumulator_deviation(sums, block);
    self->walk = (sums->store.row == 0) ? 0.0 : self->walk;
    add_part(self, sums, end, block->gram, deviation, &self->rows);
    hold_part(self, sums, end, block);
    if (end + 1u >= sums->width) {
        add_block_residuals(self, block, deviation, sums->width - 2u);
    }
}

/* The residuals of a joint's rows in a block, and their expected value by the declared noise. */
static void add_motor_residuals(const zygos_guard_t *self, const zygos_config_t *config,
                                const zygos_column_map_t *column_map, const zygos_motor_sums_t *sums,
                                const zygos_motor_block_t *block, uint32_t i, zygos_finding_t *out)
{
    uint32_t place[ZYGOS_MAX_IMPULSE + 1] = { 0 };
    const uint32_t columns = zygos_motor_sums_places(sums, column_map, i, place);
    const zygos_joint_config_t *joint = &config->joint[i];
    zygos_finding_t noise = { 0.0, 0.0, 0.0, 0.0 };
    (void)add_residuals(self, sums->noise[i], place, 0, columns, &noise);
    (void)add_residuals(self, block->joint[i].gram, place, 0, columns, out);
    add_right_side(self, block->joint[i].gram, place, columns, out);
    const double n = block->instants[i];
    const double stiffness = self->solution[place[1]];
    const double reading =
        joint->link_sigma_rad * joint->link_sigma_rad + joint->motor_sigma_rad * joint->motor_sigma_rad;
    const double arc_s = config->period_s * (double)config->impulse_arc_cycles;
    out->residual += n * noise.residual;
    out->expected += n * (noise.residual + stiffness * stiffness * reading * arc_s * arc_s / WALK);
}

/* Compares the next joint of the closing arc. */
static void judge_joint(zygos_guard_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                        const zygos_motor_sums_t *sums)
{
    const uint32_t i = sums->store.part;
    if (i >= config->joints) { /* no joint has motor rows */
        return;
    }
    const zygos_motor_block_t *closing = zygos_motor_sums_at(sums, sums->store.closed);
    const double n = closing->instants[i];
    if (!(n > 0.0) || !(self->motor[i].residual > 0.0)) {
        return;
    }
    zygos_finding_t found = { 0.0, 0.0, 0.0, 0.0 };
    add_motor_residuals(self, config, column_map, sums, closing, i, &found);
    const double limit = limit_of(&found, &self->motor[i], n, 1.0);
    self->motor_informative |= (limit < INFORMATIVE * found.spread) ? 1u : 0u;
    self->motor_worst = (limit > 0.0) ? zygos_larger(self->motor_worst, found.residual / limit) : self->motor_worst;
}

/* Compares the next rows of the closing arc of momentum rows. Their right side is zero: the terms that must cancel are
   used as its spread. */
static void judge_momentum(zygos_guard_t *self, const zygos_column_map_t *column_map, const zygos_momentum_sums_t *sums,
                           uint32_t part)
{
    const zygos_store_t *store = &sums->store;
    const zygos_momentum_block_t *closing = zygos_momentum_sums_at(sums, store->closed);
    const double *noise = sums->noise_open[(store->parity & 1u) ^ 1u].gram;
    uint32_t place[ZYGOS_MAX_MOMENTUM];
    const uint32_t end = zygos_least(part, zygos_momentum_sums_places(sums, column_map, place));
    self->momentum_noise.spread += add_residuals(self, noise, place, store->row, end, &self->momentum_noise);
    self->momenta.spread += add_residuals(self, closing->rows.gram, place, store->row, end, &self->momenta);
}

/* The residuals of the closing arc of momentum rows over their limit. */
static double contradiction_of_momentum(const zygos_guard_t *self, double n, bool *informative)
{
    zygos_finding_t found = self->momenta;
    found.residual += self->momentum_noise.residual;
    found.expected = self->momentum_noise.residual;
    const double limit = limit_of(&found, &self->momentum, n, 1.0);
    *informative = (limit < INFORMATIVE * found.spread);
    return (limit > 0.0) ? found.residual / limit : 0.0;
}

static bool compares_kind(const zygos_guard_t *self, uint32_t kind)
{
    return ((self->comparing >> kind) & 1u) != 0;
}

static void begin_comparison(zygos_sums_t *sums, uint32_t kind)
{
    const zygos_finding_t none = { 0.0, 0.0, 0.0, 0.0 };
    zygos_guard_t *self = &sums->guard;
    bool compares = zygos_guard_has_solution(self, sums->column_map.parameters);
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        self->rows = none;
        self->noise = none;
        self->blocks = none;
        self->share = 0.0;
        self->compared = 0.0;
        compares = compares && !zygos_joint_sums_suffice(&sums->config) && (self->energy.residual > 0.0);
        begin_to_hold(self, &sums->config, &sums->energy);
    } else if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        self->motor_worst = 0.0;
        self->motor_informative = 0;
    } else {
        self->momenta = none;
        self->momentum_noise = none;
        compares = compares && (self->momentum.residual > 0.0);
    }
    self->comparing = (self->comparing & ~(1u << kind)) | ((compares ? 1u : 0u) << kind);
}

/* Compares the part of the closing arc of which it is the turn. Returns the row before which it ends. */
static uint32_t compare_part(zygos_sums_t *sums, const zygos_store_t *store, uint32_t kind)
{
    zygos_guard_t *self = &sums->guard;
    const uint32_t end = zygos_store_part(store, kind);
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        judge_energy(self, &sums->energy, end);
        return end;
    }
    if (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS) {
        judge_momentum(self, &sums->column_map, &sums->momentum, end);
        return end;
    }
    judge_joint(self, &sums->config, &sums->column_map, &sums->motors);
    return ZYGOS_MAX_ANY_ROW; /* a matrix of a motor is a small one */
}

/* Whether the closing arc, all of which was compared, contradicts the running solution. It is counted. */
static bool is_contradiction(zygos_sums_t *sums, const zygos_store_t *store, uint32_t kind)
{
    zygos_guard_t *self = &sums->guard;
    const double n = (double)store->closing_instants;
    bool informative = (self->motor_informative != 0);
    double found = self->motor_worst;
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        found = contradiction_of_energy(self, &sums->config, n, &informative);
        const bool mixed = (self->held_before > 0.0) && ((found > 1.0) != (self->consecutive[kind] > 0));
        self->held_instants = mixed ? 0.0 : self->held_before + n;
    } else if (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS) {
        found = contradiction_of_momentum(self, n, &informative);
    }
    self->contradiction[kind] = found;
    count(self, &sums->config, kind, found > 1.0, informative, n, zygos_store_instants(store, kind), store->closing_end,
          store->closing_cycles);
    return found > 1.0;
}

void zygos_guard_proceed(zygos_sums_t *sums, uint32_t kind)
{
    zygos_store_t *store = zygos_sums_store(sums, kind);
    if (store->task != ZYGOS_TASK_JUDGE) {
        zygos_store_proceed(store, kind);
        return;
    }
    if (zygos_store_is_first_part(store, kind)) {
        begin_comparison(sums, kind);
    }
    const uint32_t end = compares_kind(&sums->guard, kind) ? compare_part(sums, store, kind) : ZYGOS_MAX_ANY_ROW;
    if (!zygos_store_judged_rows(store, kind, end)) {
        zygos_store_judged(store, kind, !compares_kind(&sums->guard, kind) || !is_contradiction(sums, store, kind));
    }
}

void zygos_guard_settle(zygos_sums_t *sums, uint32_t kind)
{
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        zygos_accumulator_share_out(&sums->energy);
    }
    for (uint32_t tries = 0; (tries < MOST_PARTS) && zygos_sums_is_busy(sums, kind); tries++) {
        zygos_guard_proceed(sums, kind);
    }
}

void zygos_guard_end_joints(zygos_sums_t *all)
{
    zygos_guard_t *self = &all->guard;
    zygos_joint_sums_t *sums = &all->joints;
    const zygos_config_t *config = &all->config;
    double *forgetting = &all->forgetting[ZYGOS_JOINT_KIND];
    const uint64_t cycle = all->cycle;
    const double rows = zygos_joint_sums_open_rows(sums, config);
    if (!(rows > 0.0)) {
        return;
    }
    if (!zygos_joint_sums_suffice(config) || !zygos_guard_has_solution(self, sums->width - 1u) ||
        !(self->energy.residual > 0.0)) {
        zygos_joint_sums_admit(sums, config, cycle, forgetting);
        return;
    }
    const zygos_joint_segment_t *segment = &sums->segment[sums->filling];
    zygos_finding_t found = { 0.0, 0.0, 0.0, 0.0 };
    zygos_finding_t noise = { 0.0, 0.0, 0.0, 0.0 };
    (void)add_residuals(self, segment->noise.gram, NULL, 0, sums->width - 1u, &noise);
    (void)add_residuals(self, segment->rows.gram, NULL, 0, sums->width - 1u, &found);
    add_right_side(self, segment->noise.gram, NULL, sums->width - 1u, &noise);
    add_right_side(self, segment->rows.gram, NULL, sums->width - 1u, &found);
    found.expected = noise.residual + rows * zygos_joint_sums_torque_noise(sums, config);
    const double of_one_joint = rows / (double)config->joints;
    const double limit = limit_of(&found, &self->energy, rows, 0.5 * of_one_joint);
    const bool contradicts = (limit > 0.0) && (found.residual > limit);
    const double instants = 0.5 * (double)config->joint_row_cycles / (double)config->joints;
    self->contradiction[ZYGOS_ENERGY_ROWS] = (limit > 0.0) ? found.residual / limit : 0.0;
    count(self, config, (uint32_t)ZYGOS_ENERGY_ROWS, contradicts, limit < INFORMATIVE * found.spread, rows * instants,
          zygos_joint_sums_rows(sums) * instants, cycle, (uint32_t)(rows * instants));
    if (contradicts) {
        /* The change is in the first of them, which belongs to neither arm: the group begins anew with the second. */
        const uint32_t consecutive = self->consecutive[ZYGOS_ENERGY_ROWS];
        self->agreed = (consecutive == 1u) ? sums->end : self->agreed;
        zygos_joint_sums_set_aside(sums, config, cycle, forgetting, consecutive <= 2u);
    } else {
        zygos_joint_sums_admit(sums, config, cycle, forgetting);
    }
}

static zygos_mean_squares_t mean_squares_of(const zygos_finding_t *found, double n)
{
    zygos_mean_squares_t out = { 0.0, 0.0 };
    if ((n > 0.0) && (found->residual > 0.0)) {
        out.residual = found->residual / n;
        out.spread = zygos_larger(found->spread, 0.0) / n;
    }
    return out;
}

/* Mean square of the right side. */
static double spread_of_energy(const zygos_accumulator_t *sums)
{
    double spread = 0.0;
    double n = 0.0;
    for (uint32_t r = 0; r < sums->store.closed; r++) {
        const zygos_block_t *block = zygos_accumulator_at(sums, r);
        const double instants = zygos_store_instants_of(&sums->store, (uint32_t)ZYGOS_ENERGY_ROWS, r);
        spread += (block->head.total > 0.0)
                      ? instants / block->head.total * block->gram[zygos_gram_entries(sums->width - 1u) - 1u]
                      : 0.0;
        n += instants;
    }
    return (n > 0.0) ? zygos_larger(spread, 0.0) / n : 0.0;
}

static double spread_of_joints(const zygos_joint_sums_t *sums)
{
    const double n = zygos_joint_sums_rows(sums);
    double spread = 0.0;
    for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
        spread += sums->fade[g] * sums->group[g].gram[zygos_gram_entries(sums->width) - 1u];
    }
    return (n > 0.0) ? zygos_larger(spread, 0.0) / n : 0.0;
}

static void activate(zygos_guard_t *self, uint32_t parameters)
{
    if (self->known == 0) { /* the first, or that of another arm */
        memset(self->consecutive, 0, sizeof self->consecutive);
        memset(self->instants, 0, sizeof self->instants);
        memset(self->agreeing_instants, 0, sizeof self->agreeing_instants);
        self->changed = 0;
    }
    self->known = 1;
    self->parameters = parameters;
}

/* Mean squares of the motor rows of a joint in closed arcs. */
static zygos_mean_squares_t mean_squares_of_joint(const zygos_sums_t *sums, uint32_t i)
{
    const zygos_motor_sums_t *motors = &sums->motors;
    zygos_finding_t found = { 0.0, 0.0, 0.0, 0.0 };
    double n = 0.0;
    for (uint32_t b = 0; (b < motors->store.closed) && (motors->column_map.count[i] > 0); b++) {
        const zygos_motor_block_t *of = zygos_motor_sums_at(motors, b);
        zygos_finding_t block = { 0.0, 0.0, 0.0, 0.0 };
        add_motor_residuals(&sums->guard, &sums->config, &sums->column_map, motors, of, i, &block);
        found.residual += of->head.fade * block.residual;
        found.spread += of->head.fade * block.spread;
        n += of->head.fade * of->instants[i];
    }
    return mean_squares_of(&found, n);
}

/* The same of the momentum rows. */
static zygos_mean_squares_t mean_squares_of_momentum(const zygos_sums_t *sums)
{
    const zygos_momentum_sums_t *momentum = &sums->momentum;
    uint32_t place[ZYGOS_MAX_MOMENTUM];
    const uint32_t columns = zygos_momentum_sums_places(momentum, &sums->column_map, place);
    zygos_finding_t found = { 0.0, 0.0, 0.0, 0.0 };
    double n = 0.0;
    for (uint32_t b = 0; b < momentum->store.closed; b++) {
        const zygos_momentum_block_t *of = zygos_momentum_sums_at(momentum, b);
        zygos_finding_t block = { 0.0, 0.0, 0.0, 0.0 };
        found.spread += of->head.fade * add_residuals(&sums->guard, of->rows.gram, place, 0, columns, &block);
        found.residual += of->head.fade * block.residual;
        n += of->head.fade * of->head.total;
    }
    if (n > 0.0) {
        const double fade = momentum->store.noise_fade;
        zygos_finding_t noise = { 0.0, 0.0, 0.0, 0.0 };
        found.spread += fade * add_residuals(&sums->guard, momentum->noise_closed.gram, place, 0, columns, &noise);
        found.residual += fade * noise.residual;
    }
    return mean_squares_of(&found, n);
}

/* Activates the running solution that was written (noise_ratio, cluster, energy.residual, solution, covariance). */
static void begin_solution(zygos_sums_t *sums)
{
    zygos_guard_t *self = &sums->guard;
    self->energy.spread =
        zygos_joint_sums_suffice(&sums->config) ? spread_of_joints(&sums->joints) : spread_of_energy(&sums->energy);
    memset(self->motor, 0, sizeof self->motor);
    for (uint32_t i = 0; i < sums->config.joints; i++) {
        self->motor[i] = mean_squares_of_joint(sums, i);
    }
    self->momentum = mean_squares_of_momentum(sums);
    activate(self, sums->column_map.parameters);
    self->checksum = guard_checksum(self);
}

/* Whether an estimate is one that arcs can be compared with. */
static bool is_adoptable(const zygos_sums_t *sums, const zygos_estimate_t *estimate)
{
    const zygos_guard_t *self = &sums->guard;
    const uint32_t p = sums->column_map.parameters;
    const bool after_change = (estimate->validity == (uint32_t)ZYGOS_DOUBTFUL) &&
                              (estimate->reason == (uint32_t)ZYGOS_REASON_CHANGED) && (self->known == 0);
    /* One that is of the newest arc, too, waits until that was compared with the solution before it. */
    const bool waits = (self->known != 0) && (self->held_instants > 0.0) &&
                       (self->held_instants < zygos_guard_enough(&sums->config, p));
    return ((estimate->validity == (uint32_t)ZYGOS_VALID) || after_change) && !waits && (estimate->parameters == p) &&
           (estimate->cycle > self->since) && zygos_within(estimate->residual, 0.0, LARGEST_SUM);
}

bool zygos_guard_adopt(zygos_sums_t *sums, const zygos_estimate_t *estimate)
{
    zygos_guard_t *self = &sums->guard;
    const uint32_t p = sums->column_map.parameters;
    bool good = is_adoptable(sums, estimate);
    double wider[ZYGOS_MAX_PARAMETERS];
    for (uint32_t i = 0; good && (i < p); i++) {
        wider[i] = (estimate->sigma[i] > 0.0) ? estimate->half95[i] / (TWO_SIGMAS * estimate->sigma[i]) : 1.0;
        good =
            zygos_within(estimate->solution[i], -LARGEST_SUM, LARGEST_SUM) && zygos_within(wider[i], 0.0, LARGEST_SUM);
    }
    if (!good) {
        return false;
    }
    if (estimate->since > 0) {
        for (uint32_t kind = 0; kind < (uint32_t)ZYGOS_KINDS_OF_ROWS; kind++) {
            self->left_out[kind] += zygos_sums_drop_until(sums, kind, estimate->since);
        }
        self->dropped = estimate->since;
    }
    const double ratio = estimate->noise_ratio;
    self->noise_ratio = zygos_within(ratio, 0.0, LARGEST_SUM) ? ratio : 0.0;
    self->cluster = zygos_larger(estimate->cluster, ZYGOS_GUARD_CLUSTER);
    self->energy.residual = estimate->residual * estimate->residual;
    memcpy(self->solution, estimate->solution, sizeof self->solution);
    for (uint32_t i = 0, k = 0; i < p; i++) {
        for (uint32_t j = 0; j <= i; j++, k++) {
            self->covariance[k] = wider[i] * wider[j] * estimate->covariance[k];
        }
    }
    begin_solution(sums);
    return true;
}

void zygos_guard_take_over(zygos_guard_t *self, const zygos_guard_t *from)
{
    const uint32_t p = zygos_least(from->parameters, (uint32_t)ZYGOS_MAX_PARAMETERS);
    const size_t fixed = offsetof(zygos_guard_t, covariance) - offsetof(zygos_guard_t, checksum);
    memcpy(&self->checksum, &from->checksum, fixed);
    memcpy(self->covariance, from->covariance, zygos_gram_entries(p) * sizeof from->covariance[0]);
    activate(self, p);
}
