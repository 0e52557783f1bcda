#include "zygos/momentumsums.h"

#include "zygos/gram.h"

#include <string.h>

_Static_assert((ZYGOS_MOMENTUM == 0) || (ZYGOS_MIN_ARCS < ZYGOS_MAX_MOMENTUM_BLOCKS),
               "an arc that closes needs a block");

#define COUNTED 1e-9 /* counts add up exactly */

static uint32_t width_of(const zygos_momentum_sums_t *self)
{
    return self->columns + self->components;
}

static uint64_t checksum_of(const zygos_momentum_sums_t *self)
{
    return zygos_checksum_number(zygos_checksum_doubles(0u, &self->target, 1), self->count);
}

static uint64_t checksum_of_block(const zygos_momentum_block_t *block)
{
    return zygos_checksum_number(zygos_checksum_doubles(1u, &block->instants, 1), block->end);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_momentum_sums_t *self)
{
    uint64_t word[2] = { 0, self->count };
    memcpy(&word[0], &self->target, sizeof word[0]);
    if (!zygos_checksum_repair(word, 2, self->checksum)) {
        return false;
    }
    memcpy(&self->target, &word[0], sizeof word[0]);
    self->count = (uint32_t)word[1];
    self->checksum = checksum_of(self);
    return true;
}

/* Verifies the checksum, before anything that it protects is changed. What cannot be repaired must not lead outside. */
static void judge(zygos_momentum_sums_t *self)
{
    if ((self->checksum != checksum_of(self)) && !repair(self)) {
        self->corrupt = 1;
    }
    self->count = (self->count <= (uint32_t)ZYGOS_MOMENTUM_PLACES) ? self->count : 0u;
}

static bool is_whole(const zygos_momentum_block_t *block)
{
    return block->checksum == checksum_of_block(block);
}

/* Of a block that has changed; what was wrong before remains wrong. */
static void seal(zygos_momentum_block_t *block, bool whole)
{
    const uint64_t checksum = checksum_of_block(block);
    block->checksum = whole ? checksum : ~checksum;
}

static void clear_gram(zygos_momentum_gram_t *gram, uint32_t width)
{
    memset(gram->gram, 0, zygos_gram_entries(width) * sizeof gram->gram[0]);
    memset(gram->sum, 0, width * sizeof gram->sum[0]);
}

static void add_gram(zygos_momentum_gram_t *to, const zygos_momentum_gram_t *from, double factor, uint32_t width)
{
    const uint32_t size = zygos_gram_entries(width);
    for (uint32_t k = 0; k < size; k++) {
        to->gram[k] += factor * from->gram[k];
    }
    for (uint32_t i = 0; i < width; i++) {
        to->sum[i] += factor * from->sum[i];
    }
}

void zygos_momentum_sums_leave_out(zygos_momentum_sums_t *self)
{
    clear_gram(&self->open.rows, width_of(self));
    clear_gram(&self->noise_open, self->columns);
    self->open.instants = 0.0;
    self->cycles = 0;
}

void zygos_momentum_sums_clear(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    self->target = 2.0 * (double)config->momentum_arc_cycles;
    self->count = 0;
    self->corrupt = 0;
    self->quarantined = 0;
    self->checksum = checksum_of(self);
    clear_gram(&self->noise_closed, self->columns);
    zygos_momentum_sums_leave_out(self);
}

static uint32_t columns_of(const zygos_config_t *config)
{
    return (config->momentum_arc_cycles > 0) ? zygos_kinetic_parameters(config) + config->joints : 0u;
}

static uint32_t components_of(const zygos_config_t *config)
{
    return (config->momentum_arc_cycles > 0) ? zygos_momentum_count(config) : 0u;
}

static uint32_t signals_of(const zygos_config_t *config)
{
    return ((config->momentum_arc_cycles > 0) && (config->compensation > 0)) ? config->joints + components_of(config)
                                                                             : 0u;
}

void zygos_momentum_sums_tables(zygos_momentum_sums_t *self, const zygos_config_t *config,
                                const zygos_smoother_t *smoother)
{
    self->columns = columns_of(config);
    self->components = components_of(config);
    self->signals = signals_of(config);
    memset(self->deviation, 0, sizeof self->deviation);
    memset(self->rotor, 0, sizeof self->rotor);
    if (self->signals == 0) {
        return;
    }
    zygos_momentum_variance(config, smoother, config->imu_sigma, self->deviation, self->rotor);
    for (uint32_t s = 0; s < self->signals; s++) {
        self->deviation[s] = __builtin_sqrt((double)self->signals * self->deviation[s]);
    }
}

static bool is_count(double instants)
{
    return (instants >= 0.0) && (instants <= ZYGOS_MAX_INSTANTS);
}

/* Instants and target decide whether blocks merge, and so whether blocks are free. */
bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    const bool none = (config->momentum_arc_cycles == 0);
    bool good =
        (self->columns == columns_of(config)) && (self->components == components_of(config)) &&
        (self->signals == signals_of(config)) && (width_of(self) <= (uint32_t)ZYGOS_MAX_MOMENTUM_ROW) &&
        (self->count <= (uint32_t)ZYGOS_MOMENTUM_PLACES) && is_count(self->open.instants) &&
        (none ? (self->count == 0) && !(self->open.instants > 0.0) : (self->target >= 1.0) && is_count(self->target));
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = is_count(self->block[b].instants);
    }
    return good;
}

void zygos_momentum_sums_add(zygos_momentum_sums_t *self, const zygos_config_t *config,
                             const zygos_momentum_t *momentum, const zygos_arm_state_t *state,
                             const zygos_motion_t *motion, double weight)
{
    const uint32_t component = self->cycles % self->components;
    double z[ZYGOS_MAX_MOMENTUM + 3];
    zygos_momentum_row(momentum, config, state, motion, component, z);
    for (uint32_t k = 0; k < self->columns; k++) {
        z[k] *= weight;
    }
    for (uint32_t k = 0; k < self->components; k++) {
        z[self->columns + k] = (k == component) ? weight : 0.0;
    }
    zygos_gram_add(self->open.rows.gram, self->open.rows.sum, width_of(self), z);
    if (self->signals > 0) {
        const uint32_t signal = self->cycles / self->components % self->signals;
        zygos_momentum_derivative(momentum, config, motion, component, signal, z);
        for (uint32_t k = 0; k < self->columns; k++) {
            z[k] *= weight * self->deviation[signal];
        }
        zygos_gram_add(self->noise_open.gram, self->noise_open.sum, self->columns, z);
    }
    self->open.instants += weight;
    self->cycles++;
}

static double violation(const zygos_momentum_gram_t *rows, uint32_t width, double adds)
{
    return zygos_gram_check(rows->gram, width, rows->sum, adds);
}

/* G - s s^T / n for each component, less the noise; the constants' rows are no more. */
static void close_block(zygos_momentum_sums_t *self, zygos_momentum_gram_t *rows)
{
    const uint32_t p = self->columns;
    for (uint32_t c = 0; c < self->components; c++) {
        const double *s = &rows->gram[zygos_gram_entries(p + c)];
        const double part = (s[p + c] > 0.0) ? 1.0 / s[p + c] : 0.0;
        double *entry = rows->gram;
        for (uint32_t a = 0; a < p; a++) {
            for (uint32_t b = 0; b <= a; b++) {
                *entry -= part * s[a] * s[b];
                entry++;
            }
        }
    }
    const uint32_t size = zygos_gram_entries(p);
    memset(&rows->gram[size], 0, (zygos_gram_entries(width_of(self)) - size) * sizeof rows->gram[0]);
    add_gram(rows, &self->noise_open, -1.0, p);
    zygos_gram_row_sums(rows->gram, width_of(self), rows->sum);
}

/* The target doubles only when merging up to it is not enough; once it holds all instants, one block is left. */
static void make_room(zygos_momentum_sums_t *self)
{
    for (uint32_t tries = 0; tries < 64u; tries++) {
        uint32_t to = 0;
        for (uint32_t from = 0; from < self->count; from++) {
            const zygos_momentum_block_t *next = &self->block[from];
            zygos_momentum_block_t *last = &self->block[(to > 0) ? to - 1u : 0u];
            const uint32_t left = to + (self->count - from);
            if ((to > 0) && (left > ZYGOS_MIN_ARCS) && (last->instants + next->instants <= self->target)) {
                const bool whole = is_whole(last) && is_whole(next);
                add_gram(&last->rows, &next->rows, 1.0, self->columns);
                last->instants += next->instants;
                last->end = next->end;
                seal(last, whole);
                continue;
            }
            if (to != from) {
                self->block[to] = *next;
            }
            to++;
        }
        self->count = to;
        if (self->count <= 3u * ZYGOS_MOMENTUM_PLACES / 4u) {
            return;
        }
        self->target *= 2.0;
    }
    if (self->count == (uint32_t)ZYGOS_MOMENTUM_PLACES) { /* a changed target or number of instants */
        self->corrupt = 1;
        self->count = 0;
    }
}

bool zygos_momentum_sums_close(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    const double instants = self->open.instants;
    if (instants < (double)ZYGOS_MIN_ARC_INSTANTS) {
        zygos_momentum_sums_leave_out(self);
        return false;
    }
    const double worst = violation(&self->open.rows, width_of(self), instants);
    double off = -instants; /* the constants' diagonal counts as well */
    for (uint32_t c = 0; c < self->components; c++) {
        off += self->open.rows.gram[zygos_gram_entries(self->columns + c + 1u) - 1u];
    }
    judge(self);
    if (!((off > -COUNTED) && (off < COUNTED) && (worst <= 1.0) &&
          (violation(&self->noise_open, self->columns, instants) <= 1.0))) {
        self->quarantined++;
        zygos_momentum_sums_leave_out(self);
        return false;
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const uint32_t place = self->columns - config->joints + i;
        const double owed = instants * self->rotor[i] / (double)self->components;
        self->noise_open.gram[zygos_gram_entries(place + 1u) - 1u] += owed;
        self->noise_open.sum[place] += owed;
    }
    close_block(self, &self->open.rows);
    return true;
}

void zygos_momentum_sums_admit(zygos_momentum_sums_t *self, uint64_t cycle)
{
    judge(self);
    add_gram(&self->noise_closed, &self->noise_open, 1.0, self->columns);
    if (self->count == (uint32_t)ZYGOS_MOMENTUM_PLACES) {
        make_room(self);
    }
    self->open.end = cycle;
    self->open.checksum = checksum_of_block(&self->open);
    self->block[self->count] = self->open;
    self->count++;
    self->checksum = checksum_of(self);
    zygos_momentum_sums_leave_out(self);
}

void zygos_momentum_sums_end_arc(zygos_momentum_sums_t *self, const zygos_config_t *config, uint64_t cycle)
{
    if (zygos_momentum_sums_close(self, config)) {
        zygos_momentum_sums_admit(self, cycle);
    }
}

void zygos_momentum_sums_forget(zygos_momentum_sums_t *self, double factor)
{
    double left = 0.0;
    judge(self);
    for (uint32_t b = 0; b < self->count; b++) {
        const bool whole = is_whole(&self->block[b]);
        const double kept = (factor * self->block[b].instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        add_gram(&self->block[b].rows, &self->block[b].rows, kept - 1.0, self->columns);
        self->block[b].instants *= kept;
        seal(&self->block[b], whole);
        left += self->block[b].instants;
    }
    add_gram(&self->noise_closed, &self->noise_closed, ((left > 0.0) ? factor : 0.0) - 1.0, self->columns);
}

static double closed_instants(const zygos_momentum_sums_t *self)
{
    double total = 0.0;
    for (uint32_t b = 0; b < self->count; b++) {
        total += self->block[b].instants;
    }
    return total;
}

void zygos_momentum_sums_drop_after(zygos_momentum_sums_t *self, uint64_t cycle)
{
    zygos_momentum_sums_leave_out(self);
    judge(self);
    const double before = closed_instants(self);
    while ((self->count > 0) && (self->block[self->count - 1u].end > cycle)) {
        self->count--;
    }
    self->checksum = checksum_of(self);
    const double kept = closed_instants(self);
    if (kept < before) {
        add_gram(&self->noise_closed, &self->noise_closed, kept / before - 1.0, self->columns);
    }
}

uint32_t zygos_momentum_sums_drop_until(zygos_momentum_sums_t *self, uint64_t cycle)
{
    judge(self);
    const double before = closed_instants(self);
    uint32_t drop = 0;
    while ((drop < self->count) && (self->block[drop].end <= cycle)) {
        drop++;
    }
    for (uint32_t b = drop; (drop > 0) && (b < self->count); b++) {
        self->block[b - drop] = self->block[b];
    }
    self->count -= drop;
    const double kept = closed_instants(self);
    if (kept < before) {
        add_gram(&self->noise_closed, &self->noise_closed, kept / before - 1.0, self->columns);
    }
    self->checksum = checksum_of(self);
    return drop;
}

double zygos_momentum_sums_check(const zygos_momentum_sums_t *self)
{
    const uint32_t width = width_of(self);
    bool whole = (self->corrupt == 0) && (self->checksum == checksum_of(self));
    for (uint32_t b = 0; whole && (b < self->count); b++) {
        whole = (self->block[b].checksum == checksum_of_block(&self->block[b]));
    }
    if (!whole) {
        return 2.0;
    }
    double worst = violation(&self->open.rows, width, self->open.instants);
    const double open = violation(&self->noise_open, self->columns, self->open.instants);
    const double closed = violation(&self->noise_closed, self->columns, closed_instants(self));
    worst = (open > worst) ? open : worst;
    worst = (closed > worst) ? closed : worst;
    for (uint32_t b = 0; b < self->count; b++) {
        const double here = violation(&self->block[b].rows, width, self->block[b].instants);
        worst = (here > worst) ? here : worst;
    }
    return worst;
}

static bool is_block_whole(const zygos_momentum_sums_t *self, const zygos_momentum_block_t *block)
{
    return is_whole(block) && is_count(block->instants) &&
           (violation(&block->rows, width_of(self), block->instants) <= 1.0);
}

bool zygos_momentum_sums_scrub(zygos_momentum_sums_t *self)
{
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->count > (uint32_t)ZYGOS_MOMENTUM_PLACES)) {
        return false;
    }
    self->corrupt = 0;
    double before = 0.0;
    double after = 0.0;
    uint32_t to = 0;
    for (uint32_t b = 0; b < self->count; b++) {
        before += is_count(self->block[b].instants) ? self->block[b].instants : 0.0;
        if (!is_block_whole(self, &self->block[b])) {
            continue;
        }
        after += self->block[b].instants;
        if (to != b) {
            self->block[to] = self->block[b];
        }
        to++;
    }
    if (!(violation(&self->noise_closed, self->columns, before) <= 1.0)) {
        return false;
    }
    if (to < self->count) {
        self->quarantined += self->count - to;
        add_gram(&self->noise_closed, &self->noise_closed, ((before > 0.0) ? after / before : 0.0) - 1.0,
                 self->columns);
    }
    self->count = to;
    self->checksum = checksum_of(self);
    if (!is_count(self->open.instants) || !(violation(&self->open.rows, width_of(self), self->open.instants) <= 1.0) ||
        !(violation(&self->noise_open, self->columns, self->open.instants) <= 1.0)) {
        self->quarantined++;
        zygos_momentum_sums_leave_out(self);
    }
    return true;
}
