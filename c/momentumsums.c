#include "zygos/priv/momentumsums.h"

#include "zygos/priv/gram.h"

#include <string.h>

_Static_assert((ZYGOS_MOMENTUM == 0) || (ZYGOS_MIN_ARCS < ZYGOS_MAX_MOMENTUM_BLOCKS),
               "an arc that closes needs a block");
_Static_assert(ZYGOS_MAX_MOMENTUM_ROW <= ZYGOS_MAX_ANY_ROW, "the scan has room for each row");

#define COUNTED 1e-9 /* counts add up exactly */
#define MOST_COMPONENTS 3u

static uint32_t width_of(const zygos_momentum_sums_t *self)
{
    return self->columns + self->components;
}

static uint64_t checksum_of(const zygos_momentum_sums_t *self)
{
    const double numbers[2] = { self->target, self->noise_fade };
    return zygos_checksum_number(zygos_checksum_doubles(0u, numbers, 2), self->count);
}

static uint64_t checksum_of_block(const zygos_momentum_block_t *block)
{
    const double numbers[2] = { block->instants, block->fade };
    return zygos_checksum_number(zygos_checksum_doubles(1u, numbers, 2), block->end);
}

static void reseal(zygos_momentum_sums_t *self)
{
    self->checksum = checksum_of(self);
    self->twin = zygos_momentum_sums_twin(self);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_momentum_sums_t *self)
{
    uint64_t word[3] = { 0, 0, self->count };
    memcpy(&word[0], &self->target, sizeof word[0]);
    memcpy(&word[1], &self->noise_fade, sizeof word[1]);
    if (!zygos_checksum_repair(word, 3, self->checksum)) {
        return false;
    }
    memcpy(&self->target, &word[0], sizeof word[0]);
    memcpy(&self->noise_fade, &word[1], sizeof word[1]);
    self->count = (uint32_t)word[2];
    reseal(self);
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

/* What rows of that width use of a block. */
static void copy_block(zygos_momentum_block_t *to, const zygos_momentum_block_t *from, uint32_t width)
{
    memcpy(to->rows.gram, from->rows.gram, zygos_gram_entries(width) * sizeof to->rows.gram[0]);
    memcpy(to->rows.sum, from->rows.sum, width * sizeof to->rows.sum[0]);
    to->instants = from->instants;
    to->fade = from->fade;
    to->end = from->end;
    to->checksum = from->checksum;
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

/* Reduces the noise of closed arcs in proportion; where nothing is left it begins anew. */
static void fade_noise(zygos_momentum_sums_t *self, double factor)
{
    self->noise_fade *= factor;
    if (!(self->noise_fade > 0.0)) {
        clear_gram(&self->noise_closed, self->columns);
        self->noise_fade = 1.0;
    }
}

void zygos_momentum_sums_leave_out(zygos_momentum_sums_t *self)
{
    clear_gram(&self->arc.rows, width_of(self));
    clear_gram(&ZYGOS_MOMENTUM_NOISE_OPEN(self), self->columns);
    self->arc.instants = 0.0;
    self->cycles = 0;
}

static void begin_task(zygos_momentum_sums_t *self, uint32_t task)
{
    self->task = task;
    self->row = 0;
}

static void leave_closing_out(zygos_momentum_sums_t *self)
{
    clear_gram(&ZYGOS_MOMENTUM_NOISE_CLOSING(self), self->columns);
    self->closing_cycles = 0;
    self->twin = zygos_momentum_sums_twin(self);
    begin_task(self, ZYGOS_MOMENTUM_NONE);
}

void zygos_momentum_sums_clear(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    self->target = 2.0 * (double)config->momentum_arc_cycles;
    self->count = 0;
    self->place = 0;
    self->corrupt = 0;
    self->quarantined = 0;
    self->noise_fade = 1.0;
    reseal(self);
    clear_gram(&self->noise_closed, self->columns);
    leave_closing_out(self);
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

static bool is_factor(double fade)
{
    return (fade >= 0.0) && (fade <= 1.0);
}

static bool is_of_closing_arc(uint32_t task)
{
    return (task >= (uint32_t)ZYGOS_MOMENTUM_VERIFY_ROWS) && (task <= (uint32_t)ZYGOS_MOMENTUM_ADMIT);
}

bool zygos_momentum_sums_steady(const zygos_momentum_sums_t *self)
{
    if (ZYGOS_MOMENTUM == 0) { /* there is never a task, nor a block */
        return (self->task | self->row | self->place | self->count | self->parity | self->closing_cycles) == 0;
    }
    return (self->task < ((self->columns > 0) ? (uint32_t)ZYGOS_MOMENTUM_TASKS : 1u)) &&
           (self->row <= width_of(self)) && (self->place < (uint32_t)ZYGOS_MOMENTUM_PLACES) &&
           (self->count <= (uint32_t)ZYGOS_MOMENTUM_PLACES) &&
           (is_of_closing_arc(self->task) == (self->closing_cycles > 0)) &&
           (self->twin == zygos_momentum_sums_twin(self));
}

/* Instants and target decide whether blocks merge, and so whether blocks are free. */
bool zygos_momentum_sums_intact(const zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    const bool none = (config->momentum_arc_cycles == 0);
    bool good =
        (self->columns == columns_of(config)) && (self->components == components_of(config)) &&
        (self->signals == signals_of(config)) && (width_of(self) <= (uint32_t)ZYGOS_MAX_MOMENTUM_ROW) &&
        (self->count <= (uint32_t)ZYGOS_MOMENTUM_PLACES) && is_count(self->arc.instants) &&
        ((self->closing_cycles == 0) || is_count(ZYGOS_MOMENTUM_CLOSING(self).instants)) &&
        zygos_momentum_sums_steady(self) && is_factor(self->noise_fade) && (self->noise_fade > 0.0) &&
        (none ? (self->count == 0) && !(self->arc.instants > 0.0) : (self->target >= 1.0) && is_count(self->target));
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = is_count(self->block[b].instants) && is_factor(self->block[b].fade);
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
    zygos_gram_add(self->arc.rows.gram, self->arc.rows.sum, width_of(self), z);
    if (self->signals > 0) {
        const uint32_t signal = self->cycles / self->components % self->signals;
        zygos_momentum_derivative(momentum, config, motion, component, signal, z);
        for (uint32_t k = 0; k < self->columns; k++) {
            z[k] *= weight * self->deviation[signal];
        }
        zygos_gram_add(ZYGOS_MOMENTUM_NOISE_OPEN(self).gram, ZYGOS_MOMENTUM_NOISE_OPEN(self).sum, self->columns, z);
    }
    self->arc.instants += weight;
    self->cycles++;
}

static double violation(const zygos_momentum_gram_t *rows, uint32_t width, double adds)
{
    return zygos_gram_check(rows->gram, width, rows->sum, adds);
}

uint32_t zygos_momentum_sums_part(const zygos_momentum_sums_t *self)
{
    const uint32_t width = width_of(self);
    const uint32_t share = (zygos_gram_entries(width) + ZYGOS_MOMENTUM_PASS_CYCLES - 1u) / ZYGOS_MOMENTUM_PASS_CYCLES;
    const uint32_t part = (share > ZYGOS_MOMENTUM_LEAST_PART) ? share : ZYGOS_MOMENTUM_LEAST_PART;
    uint32_t end = self->row;
    for (uint32_t n = 0; (end < width) && (n < part); end++) {
        n += end + 1u;
    }
    return end;
}

static double instants_of(const zygos_momentum_block_t *block)
{
    return block->fade * block->instants;
}

bool zygos_momentum_sums_is_short(const zygos_momentum_sums_t *self)
{
    return self->arc.instants < (double)ZYGOS_MIN_ARC_INSTANTS;
}

bool zygos_momentum_sums_close(zygos_momentum_sums_t *self, uint64_t cycle)
{
    if (zygos_momentum_sums_is_short(self)) {
        if (self->arc.instants > 0.0) { /* refused instants have added nothing */
            zygos_momentum_sums_leave_out(self);
        }
        self->cycles = 0;
        return false;
    }
    judge(self);
    zygos_momentum_block_t *closing = &ZYGOS_MOMENTUM_CLOSING(self);
    copy_block(closing, &self->arc, width_of(self));
    closing->fade = 1.0;
    closing->end = cycle;
    clear_gram(&self->arc.rows, width_of(self));
    self->arc.instants = 0.0;
    self->parity ^= 1u;
    self->closing_cycles = self->cycles;
    self->twin = zygos_momentum_sums_twin(self);
    self->cycles = 0;
    self->admitted = 0;
    memset(&self->scan, 0, sizeof self->scan);
    begin_task(self, ZYGOS_MOMENTUM_VERIFY_ROWS);
    return true;
}

/* Of the closing arc. What does not match is left out. */
static void reject(zygos_momentum_sums_t *self)
{
    self->quarantined++;
    self->admitted = 0;
    begin_task(self, ZYGOS_MOMENTUM_ADMIT);
}

static void verify_rows(zygos_momentum_sums_t *self)
{
    const uint32_t end = zygos_momentum_sums_part(self);
    const zygos_momentum_gram_t *rows = &ZYGOS_MOMENTUM_CLOSING(self).rows;
    zygos_gram_scan(&self->scan, rows->gram, self->row, end);
    self->row = end;
    if (end < width_of(self)) {
        return;
    }
    const double instants = ZYGOS_MOMENTUM_CLOSING(self).instants;
    double off = -instants; /* the constants' diagonal counts as well */
    for (uint32_t c = 0; c < self->components; c++) {
        off += rows->gram[zygos_gram_entries(self->columns + c + 1u) - 1u];
    }
    if ((off > -COUNTED) && (off < COUNTED) &&
        (zygos_gram_scanned(&self->scan, rows->gram, width_of(self), rows->sum, instants) <= 1.0)) {
        memset(&self->scan, 0, sizeof self->scan);
        begin_task(self, ZYGOS_MOMENTUM_VERIFY_NOISE);
    } else {
        reject(self);
    }
}

static void verify_noise(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    const uint32_t end = zygos_momentum_sums_part(self);
    const uint32_t last = (end < self->columns) ? end : self->columns;
    zygos_momentum_gram_t *noise = &ZYGOS_MOMENTUM_NOISE_CLOSING(self);
    const double instants = ZYGOS_MOMENTUM_CLOSING(self).instants;
    zygos_gram_scan(&self->scan, noise->gram, self->row, last);
    self->row = last;
    if (last < self->columns) {
        return;
    }
    if (!(zygos_gram_scanned(&self->scan, noise->gram, self->columns, noise->sum, instants) <= 1.0)) {
        reject(self);
        return;
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const uint32_t place = self->columns - config->joints + i;
        const double owed = instants * self->rotor[i] / (double)self->components;
        noise->gram[zygos_gram_entries(place + 1u) - 1u] += owed;
        noise->sum[place] += owed;
    }
    memset(ZYGOS_MOMENTUM_CLOSING(self).rows.sum, 0, width_of(self) * sizeof ZYGOS_MOMENTUM_CLOSING(self).rows.sum[0]);
    begin_task(self, ZYGOS_MOMENTUM_ELIMINATE);
}

/* Eliminates the constants from row a, subtracts the noise, and adds the row and its column to the row sums. mean: of
   this column in the rows of each component. Two entries at a time. */
static void eliminate_row(double *restrict entry, double *restrict sum, const double *const *constant,
                          const double *mean, const double *restrict noise, uint32_t a)
{
    const double *restrict x = constant[0];
    const double *restrict y = constant[1];
    const double *restrict z = constant[2];
    const double mx = mean[0];
    const double my = mean[1];
    const double mz = mean[2];
    double even = 0.0;
    double odd = 0.0;
    uint32_t b = 0;
    for (; b + 1u < a; b += 2u) {
        const double left = entry[b] - (mx * x[b] + my * y[b] + mz * z[b] + noise[b]);
        const double right = entry[b + 1u] - (mx * x[b + 1u] + my * y[b + 1u] + mz * z[b + 1u] + noise[b + 1u]);
        entry[b] = left;
        entry[b + 1u] = right;
        sum[b] += left;
        sum[b + 1u] += right;
        even += left;
        odd += right;
    }
    if (b < a) {
        entry[b] -= mx * x[b] + my * y[b] + mz * z[b] + noise[b];
        sum[b] += entry[b];
        even += entry[b];
    }
    entry[a] -= mx * x[a] + my * y[a] + mz * z[a] + noise[a];
    sum[a] += even + odd + entry[a];
}

/* G - s s^T / n for each component, less the noise; the constants' rows, which are the last, are no more. */
static void eliminate(zygos_momentum_sums_t *self)
{
    const uint32_t p = self->columns;
    const uint32_t end = zygos_momentum_sums_part(self);
    zygos_momentum_gram_t *rows = &ZYGOS_MOMENTUM_CLOSING(self).rows;
    const zygos_momentum_gram_t *noise = &ZYGOS_MOMENTUM_NOISE_CLOSING(self);
    const double *constant[MOST_COMPONENTS];
    double share[MOST_COMPONENTS] = { 0.0 }; /* 1 / number of rows; 0 of a component that there is not */
    for (uint32_t c = 0; c < MOST_COMPONENTS; c++) {
        const uint32_t there = (c < self->components) ? c : 0u;
        constant[c] = &rows->gram[zygos_gram_entries(p + there)];
        const double n = constant[c][p + there];
        share[c] = ((c < self->components) && (n > 0.0)) ? 1.0 / n : 0.0;
    }
    for (uint32_t a = self->row; (a < end) && (a < p); a++) {
        const uint32_t at = zygos_gram_entries(a);
        const double mean[MOST_COMPONENTS] = { constant[0][a] * share[0], constant[1][a] * share[1],
                                               constant[2][a] * share[2] };
        eliminate_row(&rows->gram[at], rows->sum, constant, mean, &noise->gram[at], a);
    }
    self->row = end;
    if (end < width_of(self)) {
        return;
    }
    const uint32_t size = zygos_gram_entries(p);
    memset(&rows->gram[size], 0, (zygos_gram_entries(width_of(self)) - size) * sizeof rows->gram[0]);
    begin_task(self, ZYGOS_MOMENTUM_JUDGE);
}

void zygos_momentum_sums_judged(zygos_momentum_sums_t *self, bool admitted)
{
    self->admitted = admitted ? 1u : 0u;
    begin_task(self, ZYGOS_MOMENTUM_ADMIT);
}

/* The first pair of neighbours that fits into one block. The target doubles when none fits. */
static void begin_merge(zygos_momentum_sums_t *self)
{
    double least = 2.0 * ZYGOS_MAX_INSTANTS;
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        const double both = instants_of(&self->block[b]) + instants_of(&self->block[b + 1u]);
        least = (both < least) ? both : least;
    }
    for (uint32_t tries = 0; (self->target < least) && (tries < 64u); tries++) {
        self->target *= 2.0;
    }
    reseal(self);
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        if (instants_of(&self->block[b]) + instants_of(&self->block[b + 1u]) <= self->target) {
            self->place = b;
            begin_task(self, ZYGOS_MOMENTUM_MERGE);
            return;
        }
    }
    self->corrupt = 1; /* a changed target or number of instants */
    self->count = 0;
    reseal(self);
}

/* The closing arc becomes one of the closed ones, and its noise moves to theirs; or both are left out. */
static void admit(zygos_momentum_sums_t *self)
{
    const uint32_t part = zygos_momentum_sums_part(self);
    const uint32_t end = (part < self->columns) ? part : self->columns;
    const bool admitted = (self->admitted != 0);
    const double factor = 1.0 / self->noise_fade;
    zygos_momentum_gram_t *noise = &ZYGOS_MOMENTUM_NOISE_CLOSING(self);
    for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(end); k++) {
        self->noise_closed.gram[k] += admitted ? factor * noise->gram[k] : 0.0; /* what is rejected may be no number */
        noise->gram[k] = 0.0;
    }
    self->row = end;
    if (end < self->columns) {
        return;
    }
    for (uint32_t i = 0; i < self->columns; i++) {
        self->noise_closed.sum[i] += admitted ? factor * noise->sum[i] : 0.0;
        noise->sum[i] = 0.0;
    }
    judge(self);
    zygos_momentum_block_t *closing = &ZYGOS_MOMENTUM_CLOSING(self);
    closing->checksum = checksum_of_block(closing);
    self->count += (admitted && (self->count < (uint32_t)ZYGOS_MOMENTUM_PLACES)) ? 1u : 0u;
    self->closing_cycles = 0;
    reseal(self);
    begin_task(self, ZYGOS_MOMENTUM_NONE);
    if (self->count >= (uint32_t)ZYGOS_MOMENTUM_PLACES) {
        begin_merge(self);
    }
}

static void merge(zygos_momentum_sums_t *self)
{
    const uint32_t end = zygos_momentum_sums_part(self);
    zygos_momentum_block_t *to = &self->block[self->place];
    zygos_momentum_block_t *from = &self->block[(self->place + 1u < self->count) ? self->place + 1u : self->place];
    for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(end); k++) {
        to->rows.gram[k] = to->fade * to->rows.gram[k] + from->fade * from->rows.gram[k];
    }
    self->row = end;
    if (end < width_of(self)) {
        return;
    }
    const bool whole = is_whole(to) && is_whole(from);
    for (uint32_t i = 0; i < width_of(self); i++) {
        to->rows.sum[i] = to->fade * to->rows.sum[i] + from->fade * from->rows.sum[i];
    }
    to->instants = instants_of(to) + instants_of(from);
    to->fade = 1.0;
    to->end = from->end;
    seal(to, whole);
    self->place++;
    begin_task(self, ZYGOS_MOMENTUM_SHIFT);
}

/* Moves the block behind a place that is free to it. */
static void shift(zygos_momentum_sums_t *self)
{
    if (self->place + 1u >= self->count) {
        judge(self);
        self->count -= (self->count > 0) ? 1u : 0u;
        reseal(self);
        begin_task(self, ZYGOS_MOMENTUM_NONE);
        self->place = 0;
        return;
    }
    const zygos_momentum_block_t *from = &self->block[self->place + 1u];
    zygos_momentum_block_t *to = &self->block[self->place];
    copy_block(to, from, width_of(self));
    self->place++;
}

/* Whether the task changes the sums of closed arcs. */
static bool changes_blocks(const zygos_momentum_sums_t *self)
{
    return (self->task == (uint32_t)ZYGOS_MOMENTUM_ADMIT) || (self->task == (uint32_t)ZYGOS_MOMENTUM_MERGE) ||
           (self->task == (uint32_t)ZYGOS_MOMENTUM_SHIFT);
}

static void proceed_with_blocks(zygos_momentum_sums_t *self)
{
    if (self->task == (uint32_t)ZYGOS_MOMENTUM_ADMIT) {
        admit(self);
    } else if (self->task == (uint32_t)ZYGOS_MOMENTUM_MERGE) {
        merge(self);
    } else {
        shift(self);
    }
}

void zygos_momentum_sums_proceed(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    if (changes_blocks(self)) {
        proceed_with_blocks(self);
        return;
    }
    switch (self->task) {
    case ZYGOS_MOMENTUM_VERIFY_ROWS:
        verify_rows(self);
        break;
    case ZYGOS_MOMENTUM_VERIFY_NOISE:
        verify_noise(self, config);
        break;
    case ZYGOS_MOMENTUM_ELIMINATE:
        eliminate(self);
        break;
    default:
        break;
    }
}

void zygos_momentum_sums_forget(zygos_momentum_sums_t *self, double factor)
{
    double left = 0.0;
    judge(self);
    for (uint32_t b = 0; b < self->count; b++) {
        zygos_momentum_block_t *block = &self->block[b];
        const bool whole = is_whole(block);
        const bool counts = (factor * instants_of(block) >= ZYGOS_NEGLIGIBLE_INSTANTS);
        block->fade *= counts ? factor : 0.0;
        seal(block, whole);
        left += instants_of(block);
    }
    fade_noise(self, (left > 0.0) ? factor : 0.0);
    reseal(self);
}

void zygos_momentum_sums_apply_fade(zygos_momentum_sums_t *self)
{
    for (uint32_t b = 0; b < self->count; b++) {
        zygos_momentum_block_t *block = &self->block[b];
        if (block->fade >= 1.0) {
            continue;
        }
        const bool whole = is_whole(block);
        add_gram(&block->rows, &block->rows, block->fade - 1.0, self->columns);
        block->instants *= block->fade;
        block->fade = 1.0;
        seal(block, whole);
    }
    add_gram(&self->noise_closed, &self->noise_closed, self->noise_fade - 1.0, self->columns);
    self->noise_fade = 1.0;
    reseal(self);
}

static double closed_instants(const zygos_momentum_sums_t *self)
{
    double total = 0.0;
    for (uint32_t b = 0; b < self->count; b++) {
        total += instants_of(&self->block[b]);
    }
    return total;
}

void zygos_momentum_sums_drop_after(zygos_momentum_sums_t *self, uint64_t cycle)
{
    zygos_momentum_sums_leave_out(self);
    for (uint32_t tries = 0; (tries < 4u * (uint32_t)ZYGOS_MOMENTUM_PLACES) && changes_blocks(self); tries++) {
        proceed_with_blocks(self);
    }
    judge(self);
    /* Numbers of cycles may have begun anew; the closing arc stands behind the last block that is kept. */
    const bool drops = (self->count > 0) && (self->block[self->count - 1u].end > cycle);
    if ((self->task != (uint32_t)ZYGOS_MOMENTUM_NONE) && (drops || (ZYGOS_MOMENTUM_CLOSING(self).end > cycle))) {
        leave_closing_out(self);
    }
    const double before = closed_instants(self);
    while ((self->count > 0) && (self->block[self->count - 1u].end > cycle)) {
        self->count--;
    }
    const double kept = closed_instants(self);
    if (kept < before) {
        fade_noise(self, kept / before);
    }
    reseal(self);
}

uint32_t zygos_momentum_sums_drop_until(zygos_momentum_sums_t *self, uint64_t cycle)
{
    judge(self);
    const double before = closed_instants(self);
    uint32_t drop = 0;
    while ((drop < self->count) && (self->block[drop].end <= cycle)) {
        drop++;
    }
    for (uint32_t b = 0; (drop > 0) && (b + drop < self->count); b++) {
        self->block[b] = self->block[b + drop];
    }
    self->count -= drop;
    const double kept = closed_instants(self);
    if (kept < before) {
        fade_noise(self, kept / before);
    }
    reseal(self);
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
    double worst = violation(&self->arc.rows, width, self->arc.instants);
    const double open = violation(&ZYGOS_MOMENTUM_NOISE_OPEN(self), self->columns, self->arc.instants);
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
    return is_whole(block) && is_count(block->instants) && is_factor(block->fade) &&
           (violation(&block->rows, width_of(self), block->instants) <= 1.0);
}

bool zygos_momentum_sums_scrub(zygos_momentum_sums_t *self, const zygos_config_t *config)
{
    if (self->columns == 0) {
        zygos_momentum_sums_clear(self, config); /* rows that nobody adds must not stop those that are */
        return true;
    }
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->count > (uint32_t)ZYGOS_MOMENTUM_PLACES) || !is_factor(self->noise_fade) || !(self->noise_fade > 0.0)) {
        return false;
    }
    const bool moved = (self->twin != zygos_momentum_sums_twin(self)); /* the noise may be that of the other arc */
    const bool closing = moved || (self->task != (uint32_t)ZYGOS_MOMENTUM_NONE) || (self->closing_cycles > 0);
    if (closing || (self->row != 0)) {
        self->quarantined += closing ? 1u : 0u;
        leave_closing_out(self);
    }
    if (moved) {
        zygos_momentum_sums_leave_out(self);
    }
    self->place = 0;
    self->corrupt = 0;
    double before = 0.0;
    double after = 0.0;
    uint32_t to = 0;
    for (uint32_t b = 0; b < self->count; b++) {
        before += is_count(instants_of(&self->block[b])) ? instants_of(&self->block[b]) : 0.0;
        if (!is_block_whole(self, &self->block[b])) {
            continue;
        }
        after += instants_of(&self->block[b]);
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
        fade_noise(self, (before > 0.0) ? after / before : 0.0);
    }
    self->count = to;
    reseal(self);
    if (!is_count(self->arc.instants) || !(violation(&self->arc.rows, width_of(self), self->arc.instants) <= 1.0) ||
        !(violation(&ZYGOS_MOMENTUM_NOISE_OPEN(self), self->columns, self->arc.instants) <= 1.0)) {
        self->quarantined++;
        zygos_momentum_sums_leave_out(self);
    }
    return true;
}
