#include "zygos/priv/motorsums.h"

#include "zygos/priv/gram.h"

#include <string.h>

_Static_assert(ZYGOS_MAX_IMPULSE + 1 <= ZYGOS_MAX_ANY_ROW, "a scan has room for each row");
_Static_assert(ZYGOS_MIN_ARCS < ZYGOS_MAX_MOTOR_BLOCKS, "an arc that closes needs a block");

#define COUNTED 1e-9 /* counts add up exactly */

static uint64_t checksum_of(const zygos_motor_sums_t *self)
{
    return zygos_checksum_number(zygos_checksum_doubles(0u, &self->target, 1), self->count);
}

static uint64_t checksum_of_block(const zygos_motor_block_t *block)
{
    const uint64_t instants = zygos_checksum_doubles(1u, block->instants, ZYGOS_MAX_JOINTS);
    const double numbers[2] = { block->total, block->fade };
    return zygos_checksum_number(zygos_checksum_doubles(instants, numbers, 2), block->end);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_motor_sums_t *self)
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
static void judge(zygos_motor_sums_t *self)
{
    if ((self->checksum != checksum_of(self)) && !repair(self)) {
        self->corrupt = 1;
    }
    self->count = (self->count <= (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS) ? self->count : 0u;
}

static bool is_whole(const zygos_motor_block_t *block)
{
    return block->checksum == checksum_of_block(block);
}

/* Of a block that has changed; what was wrong before remains wrong. */
static void seal(zygos_motor_block_t *block, bool whole)
{
    const uint64_t checksum = checksum_of_block(block);
    block->checksum = whole ? checksum : ~checksum;
}

/* The length of a joint's row. What lies behind the sums of such rows is 0, and nobody reads it. */
static uint32_t width_of(const zygos_motor_sums_t *self, uint32_t joint)
{
    const uint32_t width = self->column_map.count[joint] + 2u;
    return (width <= (uint32_t)ZYGOS_MAX_MOTOR_ROW) ? width : (uint32_t)ZYGOS_MAX_MOTOR_ROW;
}

static void copy_block(const zygos_motor_sums_t *self, zygos_motor_block_t *to, const zygos_motor_block_t *from)
{
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_JOINTS; i++) {
        const uint32_t width = width_of(self, i);
        memcpy(to->joint[i].gram, from->joint[i].gram, zygos_gram_entries(width) * sizeof to->joint[i].gram[0]);
        memcpy(to->joint[i].sum, from->joint[i].sum, width * sizeof to->joint[i].sum[0]);
    }
    memcpy(to->instants, from->instants, sizeof to->instants);
    to->total = from->total;
    to->fade = from->fade;
    to->end = from->end;
    to->checksum = from->checksum;
}

/* to := own to + other from, without what belongs to the whole block. */
static void add_joint(const zygos_motor_sums_t *self, uint32_t i, double own, zygos_motor_block_t *to, double other,
                      const zygos_motor_block_t *from)
{
    const uint32_t width = width_of(self, i);
    for (uint32_t k = 0; k < zygos_gram_entries(width); k++) {
        to->joint[i].gram[k] = own * to->joint[i].gram[k] + other * from->joint[i].gram[k];
    }
    for (uint32_t k = 0; k < width; k++) {
        to->joint[i].sum[k] = own * to->joint[i].sum[k] + other * from->joint[i].sum[k];
    }
}

void zygos_motor_sums_clear(zygos_motor_sums_t *self, const zygos_config_t *config)
{
    self->target = 2.0 * (double)config->impulse_arc_cycles;
    self->count = 0;
    self->corrupt = 0;
    self->quarantined = 0;
    self->instants = 0;
    self->cycles = 0;
    memset(&self->open, 0, sizeof self->open);
    memset(&self->closing, 0, sizeof self->closing);
    self->task = ZYGOS_MOTOR_NONE;
    self->joint = 0;
    self->place = 0;
    self->closing_cycles = 0;
    self->checksum = checksum_of(self);
}

void zygos_motor_sums_tables(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_smoother_t *smoother)
{
    zygos_impulse_column_map(config, &self->column_map);
    memset(self->noise, 0, sizeof self->noise);
    for (uint32_t i = 0; (i < config->joints) && (config->compensation != 0); i++) {
        if (self->column_map.count[i] > 0) {
            zygos_impulse_noise(config, &self->column_map, smoother, config->imu_sigma, i, self->noise[i]);
        }
    }
}

static bool same_layout(const zygos_impulse_column_map_t *column_map, const zygos_config_t *config)
{
    zygos_impulse_column_map_t own;
    bool same = true;
    zygos_impulse_column_map(config, &own);
    for (uint32_t i = 0; i < config->joints; i++) {
        same = same && (column_map->count[i] == own.count[i]);
        for (uint32_t e = 0; e < ZYGOS_EFFECT_PLACES; e++) {
            same = same && (column_map->effect[i][e] == own.effect[i][e]);
        }
    }
    return same;
}

/* Instants and target decide whether blocks merge, and so whether blocks are free. */
bool zygos_motor_sums_intact(const zygos_motor_sums_t *self, const zygos_config_t *config)
{
    const bool none = (config->impulse_arc_cycles == 0);
    bool good = same_layout(&self->column_map, config) && zygos_motor_sums_steady(self) &&
                (none ? (self->count == 0) && (self->instants == 0)
                      : (self->target >= 1.0) && (self->target <= ZYGOS_MAX_INSTANTS));
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = (self->block[b].total >= 0.0) && (self->block[b].total <= ZYGOS_MAX_INSTANTS) &&
               (self->block[b].fade >= 0.0) && (self->block[b].fade <= 1.0);
    }
    return good;
}

void zygos_motor_sums_add(zygos_motor_sums_t *self, const zygos_config_t *config, const zygos_impulse_rows_t *rows,
                          double weight)
{
    const uint32_t i = self->cycles % config->joints;
    const uint32_t p = self->column_map.count[i];
    if (p > 0) {
        double z[ZYGOS_MAX_MOTOR_ROW];
        for (uint32_t k = 0; k < p; k++) {
            z[k] = weight * rows->column[i][k];
        }
        z[p] = weight * rows->impulse[i];
        z[p + 1u] = weight;
        zygos_gram_add(self->open.joint[i].gram, self->open.joint[i].sum, p + 2u, z);
    }
    self->open.instants[i] += weight;
    self->instants += (weight > 0.0) ? 1u : 0u;
    self->cycles++;
}

static bool matches(const zygos_motor_gram_t *joint, uint32_t width, double adds)
{
    return zygos_gram_check(joint->gram, width, joint->sum, adds) <= 1.0;
}

/* G - s s^T / n without its last row, less n times the noise. */
static void close_gram(zygos_motor_gram_t *joint, uint32_t p, double n, const double *noise)
{
    double s[ZYGOS_MAX_MOTOR_ROW];
    memcpy(s, &joint->gram[zygos_gram_entries(p + 1u)], (p + 1u) * sizeof s[0]);
    uint32_t k = 0;
    for (uint32_t a = 0; a <= p; a++) {
        for (uint32_t b = 0; b <= a; b++) {
            joint->gram[k] -= s[a] * s[b] / n + ((a < p) ? n * noise[k] : 0.0);
            k++;
        }
    }
    memset(&joint->gram[k], 0, (p + 2u) * sizeof joint->gram[0]);
    zygos_gram_row_sums(joint->gram, p + 2u, joint->sum);
}

static double total_of(const zygos_motor_block_t *block)
{
    return block->fade * block->total;
}

static void begin_task(zygos_motor_sums_t *self, uint32_t task)
{
    self->task = task;
    self->joint = 0;
}

static void leave_closing_out(zygos_motor_sums_t *self)
{
    self->closing.total = 0.0;
    self->closing_cycles = 0;
    self->place = 0;
    begin_task(self, ZYGOS_MOTOR_NONE);
}

bool zygos_motor_sums_is_short(const zygos_motor_sums_t *self)
{
    return self->instants < ZYGOS_MIN_ARC_INSTANTS;
}

bool zygos_motor_sums_close(zygos_motor_sums_t *self, uint64_t cycle)
{
    if (zygos_motor_sums_is_short(self)) {
        zygos_motor_sums_leave_out(self);
        return false;
    }
    copy_block(self, &self->closing, &self->open);
    self->closing.total = (double)self->instants;
    self->closing.fade = 1.0;
    self->closing.end = cycle;
    self->closing_cycles = self->cycles;
    double turns = -self->closing.total;
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_JOINTS; i++) {
        turns += self->closing.instants[i];
    }
    self->whole = ((turns > -COUNTED) && (turns < COUNTED)) ? 1u : 0u;
    zygos_motor_sums_leave_out(self);
    begin_task(self, ZYGOS_MOTOR_CLOSE);
    return true;
}

static void close_joint(zygos_motor_sums_t *self, const zygos_config_t *config)
{
    const uint32_t i = self->joint;
    const uint32_t p = self->column_map.count[i];
    const double n = self->closing.instants[i];
    if ((p > 0) && (n > 0.0)) {
        zygos_motor_gram_t *rows = &self->closing.joint[i];
        /* The last entry counts instants as well. */
        const double off = n - rows->gram[zygos_gram_entries(p + 2u) - 1u];
        const bool counted = (off > -COUNTED) && (off < COUNTED);
        self->whole &= (counted && matches(rows, p + 2u, n)) ? 1u : 0u;
        close_gram(rows, p, n, self->noise[i]);
    }
    self->joint++;
    if (self->joint < config->joints) {
        return;
    }
    if (self->whole == 0) {
        self->quarantined++;
        leave_closing_out(self);
    } else {
        begin_task(self, ZYGOS_MOTOR_JUDGE);
    }
}

void zygos_motor_sums_judged(zygos_motor_sums_t *self, bool admitted)
{
    if (admitted) {
        begin_task(self, ZYGOS_MOTOR_ADMIT);
    } else {
        leave_closing_out(self);
    }
}

/* The first pair of neighbours that fits into one block. The target doubles when none fits. */
static void begin_merge(zygos_motor_sums_t *self)
{
    double least = 2.0 * ZYGOS_MAX_INSTANTS;
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        const double both = total_of(&self->block[b]) + total_of(&self->block[b + 1u]);
        least = (both < least) ? both : least;
    }
    for (uint32_t tries = 0; (self->target < least) && (tries < 64u); tries++) {
        self->target *= 2.0;
    }
    self->checksum = checksum_of(self);
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        if (total_of(&self->block[b]) + total_of(&self->block[b + 1u]) <= self->target) {
            self->place = b;
            begin_task(self, ZYGOS_MOTOR_MERGE);
            return;
        }
    }
    self->corrupt = 1; /* a changed target or number of instants */
    self->count = 0;
    self->checksum = checksum_of(self);
}

static void admit(zygos_motor_sums_t *self)
{
    judge(self);
    if (self->count < (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS) {
        self->closing.checksum = checksum_of_block(&self->closing);
        copy_block(self, &self->block[self->count], &self->closing);
        self->count++;
        self->checksum = checksum_of(self);
    }
    leave_closing_out(self);
    if (self->count >= (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS) {
        begin_merge(self);
    }
}

static void merge_joint(zygos_motor_sums_t *self)
{
    const uint32_t i = self->joint;
    zygos_motor_block_t *to = &self->block[self->place];
    const zygos_motor_block_t *from = &self->block[(self->place + 1u < self->count) ? self->place + 1u : self->place];
    add_joint(self, i, to->fade, to, from->fade, from);
    self->joint++;
    if (self->joint < (uint32_t)ZYGOS_MAX_JOINTS) {
        return;
    }
    const bool whole = is_whole(to) && is_whole(from);
    for (uint32_t j = 0; j < (uint32_t)ZYGOS_MAX_JOINTS; j++) {
        to->instants[j] = to->fade * to->instants[j] + from->fade * from->instants[j];
    }
    to->total = total_of(to) + total_of(from);
    to->fade = 1.0;
    to->end = from->end;
    seal(to, whole);
    self->place++;
    begin_task(self, ZYGOS_MOTOR_SHIFT);
}

/* Moves the block behind a place that is free to it. */
static void shift(zygos_motor_sums_t *self)
{
    if (self->place + 1u >= self->count) {
        judge(self);
        self->count -= (self->count > 0) ? 1u : 0u;
        self->checksum = checksum_of(self);
        leave_closing_out(self);
        return;
    }
    copy_block(self, &self->block[self->place], &self->block[self->place + 1u]);
    self->place++;
}

bool zygos_motor_sums_steady(const zygos_motor_sums_t *self)
{
    return (self->task < (uint32_t)ZYGOS_MOTOR_TASKS) && (self->joint < (uint32_t)ZYGOS_MAX_JOINTS) &&
           (self->place < (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS) && (self->count <= (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS);
}

void zygos_motor_sums_proceed(zygos_motor_sums_t *self, const zygos_config_t *config)
{
    switch (self->task) {
    case ZYGOS_MOTOR_CLOSE:
        close_joint(self, config);
        break;
    case ZYGOS_MOTOR_ADMIT:
        admit(self);
        break;
    case ZYGOS_MOTOR_MERGE:
        merge_joint(self);
        break;
    case ZYGOS_MOTOR_SHIFT:
        shift(self);
        break;
    default:
        break;
    }
}

void zygos_motor_sums_leave_out(zygos_motor_sums_t *self)
{
    zygos_motor_block_t *open = &self->open;
    for (uint32_t i = 0; i < (uint32_t)ZYGOS_MAX_JOINTS; i++) {
        memset(open->joint[i].gram, 0, zygos_gram_entries(width_of(self, i)) * sizeof open->joint[i].gram[0]);
        memset(open->joint[i].sum, 0, width_of(self, i) * sizeof open->joint[i].sum[0]);
    }
    memset(open->instants, 0, sizeof open->instants);
    self->instants = 0;
    self->cycles = 0;
}

void zygos_motor_sums_forget(zygos_motor_sums_t *self, double factor)
{
    judge(self);
    for (uint32_t b = 0; b < self->count; b++) {
        zygos_motor_block_t *block = &self->block[b];
        const bool whole = is_whole(block);
        block->fade *= (factor * total_of(block) >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        seal(block, whole);
    }
}

void zygos_motor_sums_apply_fade(zygos_motor_sums_t *self)
{
    for (uint32_t b = 0; b < self->count; b++) {
        zygos_motor_block_t *block = &self->block[b];
        if (block->fade >= 1.0) {
            continue;
        }
        const bool whole = is_whole(block);
        for (uint32_t i = 0; i < ZYGOS_MAX_JOINTS; i++) {
            add_joint(self, i, block->fade, block, 0.0, block);
            block->instants[i] *= block->fade;
        }
        block->total *= block->fade;
        block->fade = 1.0;
        seal(block, whole);
    }
}

void zygos_motor_sums_drop_after(zygos_motor_sums_t *self, uint64_t cycle)
{
    zygos_motor_sums_leave_out(self);
    for (uint32_t tries = 0;
         (tries < 4u * (uint32_t)(ZYGOS_MAX_MOTOR_BLOCKS + ZYGOS_MAX_JOINTS)) &&
         ((self->task == (uint32_t)ZYGOS_MOTOR_MERGE) || (self->task == (uint32_t)ZYGOS_MOTOR_SHIFT));
         tries++) {
        (self->task == (uint32_t)ZYGOS_MOTOR_MERGE) ? merge_joint(self) : shift(self);
    }
    if ((self->task != (uint32_t)ZYGOS_MOTOR_NONE) && (self->closing.end > cycle)) {
        leave_closing_out(self);
    }
    judge(self);
    while ((self->count > 0) && (self->block[self->count - 1u].end > cycle)) {
        self->count--;
    }
    self->checksum = checksum_of(self);
}

uint32_t zygos_motor_sums_drop_until(zygos_motor_sums_t *self, uint64_t cycle)
{
    judge(self);
    uint32_t drop = 0;
    while ((drop < self->count) && (self->block[drop].end <= cycle)) {
        drop++;
    }
    for (uint32_t b = drop; (drop > 0) && (b < self->count); b++) {
        copy_block(self, &self->block[b - drop], &self->block[b]);
    }
    self->count -= drop;
    self->checksum = checksum_of(self);
    return drop;
}

double zygos_motor_sums_check(const zygos_motor_sums_t *self, const zygos_config_t *config)
{
    bool good = (self->corrupt == 0) && (self->checksum == checksum_of(self));
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = (self->block[b].checksum == checksum_of_block(&self->block[b]));
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        const uint32_t width = self->column_map.count[i] + 2u;
        good = good && matches(&self->open.joint[i], width, self->open.instants[i]);
        for (uint32_t b = 0; good && (b < self->count); b++) {
            good = matches(&self->block[b].joint[i], width, self->block[b].instants[i]);
        }
    }
    return good ? 0.0 : 2.0;
}

static bool is_block_whole(const zygos_motor_sums_t *self, const zygos_config_t *config,
                           const zygos_motor_block_t *block)
{
    bool whole = is_whole(block) && (block->total >= 0.0) && (block->total <= ZYGOS_MAX_INSTANTS) &&
                 (block->fade >= 0.0) && (block->fade <= 1.0);
    for (uint32_t i = 0; i < config->joints; i++) {
        whole = whole && matches(&block->joint[i], self->column_map.count[i] + 2u, block->instants[i]);
    }
    return whole;
}

bool zygos_motor_sums_scrub(zygos_motor_sums_t *self, const zygos_config_t *config)
{
    if (config->impulse_arc_cycles == 0) {
        zygos_motor_sums_clear(self, config); /* rows that nobody adds must not stop those that are */
        return true;
    }
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->count > (uint32_t)ZYGOS_MAX_MOTOR_BLOCKS)) {
        return false;
    }
    if ((self->task != (uint32_t)ZYGOS_MOTOR_NONE) || (self->joint != 0)) {
        self->quarantined += (self->task != (uint32_t)ZYGOS_MOTOR_NONE) ? 1u : 0u;
        leave_closing_out(self);
    }
    self->place = 0;
    self->corrupt = 0;
    uint32_t to = 0;
    for (uint32_t b = 0; b < self->count; b++) {
        if (!is_block_whole(self, config, &self->block[b])) {
            continue;
        }
        if (to != b) {
            copy_block(self, &self->block[to], &self->block[b]);
        }
        to++;
    }
    self->quarantined += self->count - to;
    self->count = to;
    self->checksum = checksum_of(self);
    bool whole = true;
    for (uint32_t i = 0; i < config->joints; i++) {
        whole = whole && matches(&self->open.joint[i], self->column_map.count[i] + 2u, self->open.instants[i]);
    }
    if (!whole) {
        self->quarantined++;
        zygos_motor_sums_leave_out(self);
    }
    return true;
}
