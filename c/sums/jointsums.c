/* SPDX-License-Identifier: MIT */
#include "zygos/priv/jointsums.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"
#include "zygos/priv/reduction.h"

#include <stddef.h>
#include <string.h>

/* What happens to the segment that is complete: its entries are added to the group, then the sums of each joint's rows
   to the matrix of such sums. */
#define IDLE 0u
#define ENTRIES 1u
#define JOINTS 2u

_Static_assert(ZYGOS_SEGMENT_INCREMENTS *ZYGOS_MIN_INCREMENT / 4u > ZYGOS_MAX_JOINTS + 1,
               "a segment must be added before the next one is complete");

#define SEALED ((uint32_t)(offsetof(zygos_joint_sums_t, checksum) - offsetof(zygos_joint_sums_t, filling)))
_Static_assert(SEALED % 8u == 0, "whole words");

static unsigned char *sealed_of(zygos_joint_sums_t *self)
{
    return (unsigned char *)(void *)self + offsetof(zygos_joint_sums_t, filling);
}

static uint64_t joints_checksum(const zygos_joint_sums_t *self)
{
    return zygos_checksum_memory(0, (const unsigned char *)self + offsetof(zygos_joint_sums_t, filling), SEALED);
}

/* Verifies the checksum, and flips a bit back where that explains it. */
static bool are_joints_sealed(zygos_joint_sums_t *self)
{
    const bool good =
        (self->checksum == joints_checksum(self)) || zygos_checksum_repair(sealed_of(self), SEALED, self->checksum);
    self->checksum = good ? joints_checksum(self) : self->checksum;
    return good;
}

bool zygos_joint_sums_suffice(const zygos_config_t *config)
{
    bool rigid = (ZYGOS_JOINT_ROWS != 0) && (config->joint_row_cycles > 0) && (config->base == ZYGOS_BASE_FIXED);
    for (uint32_t i = 0; i < config->joints; i++) {
        rigid = rigid && (config->joint[i].rigid != 0);
    }
    return rigid;
}

static uint32_t joint_row_width(const zygos_config_t *config, const zygos_column_map_t *column_map)
{
    return (config->joint_row_cycles > 0) ? column_map->parameters + 1u : 0u;
}

static uint32_t increments_of(const zygos_config_t *config)
{
    if (config->joint_row_cycles == 0) {
        return 0;
    }
    const double least = ZYGOS_SEGMENT_S / (0.5 * (double)config->joint_row_cycles * config->period_s);
    const double most = 1e6;
    const uint32_t long_enough = (uint32_t)((least < most) ? least : most);
    return (long_enough > ZYGOS_SEGMENT_INCREMENTS) ? long_enough : ZYGOS_SEGMENT_INCREMENTS;
}

uint32_t zygos_joint_sums_longest(const zygos_config_t *config)
{
    return increments_of(config) * (config->joint_row_cycles / 2u);
}

double zygos_joint_sums_torque_noise(const zygos_joint_sums_t *self, const zygos_config_t *config)
{
    double sum = 0.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        const double row = self->weight[i] * config->joint[i].torque_sigma * config->period_s;
        sum += row * row * (double)config->joint_row_cycles;
    }
    return sum / (double)config->joints;
}

/* The cursor has half of the shortest time that a segment takes. The product is twice the length of a segment in
   cycles, 16 of the longest increments at the most, which is far below 2^32. A division of 64 bits would need a routine
   that 32-bit targets may lack. */
static uint32_t slice_of(const zygos_config_t *config, uint32_t width, uint32_t increments)
{
    const uint32_t cycles = increments * config->joint_row_cycles / 4u;
    const uint32_t entries = zygos_gram_entries(width);
    return (cycles > 0) ? (entries + cycles - 1u) / cycles : 0u;
}

static uint32_t pairs_of(uint32_t rows)
{
    return (rows + 1u) / 2u;
}

/* How often two rows are added for so many rows, with their noise. */
static uint32_t passes_of(const zygos_config_t *config, uint32_t rows)
{
    return ((config->compensation > 0) ? 2u : 1u) * pairs_of(rows);
}

/* The rows of all joints are added in the cycles of a half in which none is formed. */
static uint32_t share_of(const zygos_config_t *config, uint32_t width)
{
    const uint32_t half = config->joint_row_cycles / 2u;
    const uint32_t entries = passes_of(config, config->joints) * zygos_gram_entries(width);
    const uint32_t cycles = (half > config->joints) ? half - config->joints : 1u;
    return (entries + cycles - 1u) / cycles;
}

void zygos_joint_sums_tables(zygos_joint_sums_t *self, const zygos_config_t *config,
                             const zygos_column_map_t *column_map, const zygos_smoother_t *smoother)
{
    const uint32_t n = config->joints;
    const uint32_t signals = zygos_joint_signals(config);
    self->width = joint_row_width(config, column_map);
    self->increments = increments_of(config);
    self->slice = slice_of(config, self->width, self->increments);
    self->share = share_of(config, self->width);
    memset(self->weight, 0, sizeof self->weight);
    memset(self->deviation, 0, sizeof self->deviation);
    memset(self->rotor_variance, 0, sizeof self->rotor_variance);
    bool declared = true;
    for (uint32_t i = 0; i < n; i++) {
        declared = declared && (config->joint[i].torque_sigma > 0.0);
    }
    for (uint32_t i = 0; i < n; i++) {
        self->weight[i] = declared ? 1.0 / config->joint[i].torque_sigma : 1.0;
    }
    if (config->compensation == 0) {
        return;
    }
    const double both_ends = 2.0;
    for (uint32_t s = 0; s < signals; s++) {
        double variance[3];
        zygos_smoother_variance(smoother, (s < n) ? s : 2u * n, variance);
        const zygos_joint_config_t *joint = &config->joint[(s < n) ? s : 0u];
        const double reading = (joint->rigid != 0) ? joint->motor_sigma_rad : joint->link_sigma_rad;
        const double square =
            (s < n) ? reading * reading * variance[2] : config->imu_sigma * config->imu_sigma * variance[0];
        self->deviation[s] = __builtin_sqrt(both_ends * (double)signals * square);
    }
    for (uint32_t i = 0; i < n; i++) {
        double variance[3];
        zygos_smoother_variance(smoother, n + i, variance);
        const double reading = (config->joint[i].rigid != 0) ? 0.0 : config->joint[i].motor_sigma_rad;
        self->rotor_variance[i] = both_ends * reading * reading * variance[2];
    }
}

bool zygos_joint_sums_intact(const zygos_joint_sums_t *self, const zygos_config_t *config,
                             const zygos_column_map_t *column_map)
{
    const uint32_t width = joint_row_width(config, column_map);
    const uint32_t increments = increments_of(config);
    bool good = (self->width == width) && (width <= (uint32_t)ZYGOS_MAX_JOINT_ROW) &&
                (self->increments == increments) && (self->slice == slice_of(config, width, increments)) &&
                (self->share == share_of(config, width)) && zygos_joint_sums_steady(self, config) &&
                (self->filled <= increments) && zygos_is_count(self->joint_sums);
    for (uint32_t g = 0; g <= (uint32_t)ZYGOS_SET_ASIDE; g++) {
        good = good && zygos_is_count(self->count[g]) && (self->fade[g] >= 0.0) && (self->fade[g] <= 1.0);
    }
    for (uint32_t s = 0; s < 2u; s++) {
        for (uint32_t j = 0; j < (uint32_t)ZYGOS_JOINT_PLACES; j++) {
            good = good && zygos_is_count(self->segment[s].count[j]);
        }
    }
    return good;
}

static void clear_gram(zygos_joint_gram_t *gram, uint32_t width)
{
    memset(gram->gram, 0, zygos_gram_entries(width) * sizeof gram->gram[0]);
    memset(gram->sum, 0, width * sizeof gram->sum[0]);
}

static void clear_segment(zygos_joint_segment_t *segment, uint32_t width)
{
    clear_gram(&segment->rows, width);
    clear_gram(&segment->noise, width);
    memset(segment->joint, 0, sizeof segment->joint);
    memset(segment->count, 0, sizeof segment->count);
}

static void clear_waiting(zygos_joint_sums_t *self)
{
    self->waiting = 0;
    self->pass = 0;
    self->row = 0;
}

void zygos_joint_sums_clear(zygos_joint_sums_t *self)
{
    memset(sealed_of(self), 0, offsetof(zygos_joint_sums_t, noise) - offsetof(zygos_joint_sums_t, filling));
    self->keep = 1.0;
    self->keep_group = 1.0;
    memset(self->wait, 0, sizeof self->wait);
    clear_gram(&self->noise, self->width);
    clear_gram(&self->joints, self->width);
    for (uint32_t s = 0; s < 2u; s++) {
        clear_segment(&self->segment[s], self->width);
    }
    for (uint32_t g = 0; g <= (uint32_t)ZYGOS_SET_ASIDE; g++) {
        clear_gram(&self->group[g], self->width);
        self->fade[g] = 1.0;
    }
    self->checksum = joints_checksum(self);
}

/* Whether the segment that is added belongs to the estimate. */
static bool is_admitted(const zygos_joint_sums_t *self)
{
    return self->target != (uint32_t)ZYGOS_SET_ASIDE;
}

/* Adds the sums of one joint's rows in the complete segment to the matrix of such sums. */
static void add_joint(zygos_joint_sums_t *self, uint32_t joints)
{
    zygos_joint_segment_t *segment = &self->segment[1u - self->filling];
    const uint32_t j = self->joint;
    const double n = segment->count[j];
    const double share = is_admitted(self) ? 1.0 / __builtin_sqrt((n > 0.0) ? 2.0 * n : 1.0) : 0.0;
    for (uint32_t k = 0; k < self->width; k++) {
        segment->joint[j][k] *= share;
    }
    zygos_gram_add(self->joints.gram, self->joints.sum, self->width, segment->joint[j]);
    memset(segment->joint[j], 0, self->width * sizeof segment->joint[j][0]);
    segment->count[j] = 0.0;
    self->joint++;
    self->adding = (self->joint < joints) ? JOINTS : IDLE;
}

typedef struct {
    double *restrict rows;
    double *restrict noise;
    double *restrict group;
    double *restrict total;
    double *restrict joints;
} entries_t;

/* Moves some entries of a segment to its group and to the total of the noise. What is there fades. */
static void move_entries(const zygos_joint_sums_t *self, entries_t from, uint32_t count)
{
    const double keep = self->keep;
    const double keep_group = self->keep_group;
    const double share = is_admitted(self) ? 1.0 : 0.0;
    for (uint32_t k = 0; k < count; k++) {
        from.group[k] = keep_group * from.group[k] + (from.rows[k] - from.noise[k]);
        from.total[k] = keep * from.total[k] + share * from.noise[k];
        from.joints[k] = keep * from.joints[k];
        from.rows[k] = 0.0;
        from.noise[k] = 0.0;
    }
}

/* Adds entries of the complete segment to its group, and the row sums with the last of them. */
static void add_entries(zygos_joint_sums_t *self, uint32_t most)
{
    zygos_joint_segment_t *segment = &self->segment[1u - self->filling];
    zygos_joint_gram_t *group = &self->group[self->target];
    const uint32_t entries = zygos_gram_entries(self->width);
    const uint32_t count = zygos_least(most, entries - self->cursor);
    const uint32_t at = self->cursor;
    move_entries(self,
                 (entries_t){ &segment->rows.gram[at], &segment->noise.gram[at], &group->gram[at],
                              &self->noise.gram[at], &self->joints.gram[at] },
                 count);
    self->cursor += count;
    if (self->cursor == entries) {
        move_entries(
            self, (entries_t){ segment->rows.sum, segment->noise.sum, group->sum, self->noise.sum, self->joints.sum },
            self->width);
        self->adding = JOINTS;
    }
}

static void advance_entries(zygos_joint_sums_t *self, uint32_t joints, uint32_t entries)
{
    if (self->adding == ENTRIES) {
        add_entries(self, entries);
    } else if (self->adding == JOINTS) {
        add_joint(self, joints);
    }
}

/* Whether the second half of a segment, in which each joint's sums have their turn, has as many cycles without a row as
   there are joints. */
static bool has_turns(const zygos_joint_sums_t *self, const zygos_config_t *config)
{
    const uint32_t half = config->joint_row_cycles / 2u;
    return (self->increments >= 4u) && ((self->increments / 2u - 1u) * (half - config->joints) >= config->joints);
}

/* Adds two rows that wait to row i of the matrix, two entries at a time. */
static void add_pair(zygos_joint_gram_t *to, const double (*z)[2], const double *total, uint32_t i)
{
    const double first = z[i][0];
    const double second = z[i][1];
    const double *restrict x = z[0];
    double *restrict entry = &to->gram[zygos_gram_entries(i)];
    for (const double *end = entry + (i + 1u) / 2u * 2u; entry != end; entry += 2) {
        entry[0] += first * x[0] + second * x[1];
        entry[1] += first * x[2] + second * x[3];
        x += 4;
    }
    if (i % 2u == 0) {
        entry[0] += first * first + second * second;
    }
    to->sum[i] += first * total[0] + second * total[1];
}

/* Adds rows that wait to so many entries or a few more. */
static void add_waiting(zygos_joint_sums_t *self, const zygos_config_t *config, uint32_t entries)
{
    zygos_joint_segment_t *segment = &self->segment[self->filling];
    const uint32_t pairs = pairs_of(self->waiting);
    const uint32_t passes = passes_of(config, self->waiting);
    uint32_t done = 0;
    while ((self->pass < passes) && (done < entries)) {
        const uint32_t kind = (self->pass < pairs) ? 0u : 1u;
        const uint32_t k = self->pass - ((kind == 0) ? 0u : pairs);
        zygos_joint_gram_t *to = (kind == 0) ? &segment->rows : &segment->noise;
        for (; (self->row < self->width) && (done < entries); self->row++) {
            add_pair(to, (const double(*)[2])self->wait[kind].pair[k], self->wait[kind].total[k], self->row);
            done += self->row + 1u;
        }
        if (self->row >= self->width) {
            self->row = 0;
            self->pass++;
        }
    }
    if (self->pass >= passes) {
        clear_waiting(self);
    }
}

static void add_all_waiting(zygos_joint_sums_t *self, const zygos_config_t *config)
{
    add_waiting(self, config, passes_of(config, self->waiting) * zygos_gram_entries(self->width));
}

bool zygos_joint_sums_step(zygos_joint_sums_t *self, const zygos_config_t *config, double accepted, bool row)
{
    const uint64_t one = (uint64_t)(accepted > 0.0);
    self->accepted += one;
    self->refused += 1u - one;
    if (!row || (self->adding != JOINTS) || !has_turns(self, config)) {
        advance_entries(self, config->joints, self->slice);
    }
    if (!row && (self->waiting > 0)) {
        add_waiting(self, config, self->share);
    }
    return (self->waiting == 0) && (self->filled >= self->increments);
}

/* Ends the segment that is filled, which is added to the given group from here on. anew: to nothing else. */
static void end_segment(zygos_joint_sums_t *self, const zygos_config_t *config, uint32_t target, bool anew,
                        uint64_t cycle, double *forgetting)
{
    const zygos_joint_segment_t *segment = &self->segment[self->filling];
    const double share = zygos_kept_share(config, *forgetting);
    self->corrupt |= are_joints_sealed(self) ? 0u : 1u;
    self->target = target;
    self->segments += is_admitted(self) ? 1u : 0u;
    self->filling = 1u - self->filling;
    self->filled = 0;
    self->adding = ENTRIES;
    self->cursor = 0;
    self->joint = 0;
    self->end = cycle;
    for (uint32_t g = 0; g <= (uint32_t)ZYGOS_SET_ASIDE; g++) {
        self->fade[g] *= share;
    }
    self->keep = share;
    self->keep_group = anew ? 0.0 : self->fade[target];
    self->fade[target] = 1.0;
    self->count[target] *= self->keep_group;
    self->joint_sums *= share;
    for (uint32_t j = 0; j < config->joints; j++) {
        self->count[target] += segment->count[j];
        self->joint_sums += (is_admitted(self) && (segment->count[j] > 0.0)) ? 1.0 : 0.0;
    }
    self->checksum = joints_checksum(self);
    *forgetting = 1.0;
}

void zygos_joint_sums_admit(zygos_joint_sums_t *self, const zygos_config_t *config, uint64_t cycle, double *forgetting)
{
    /* 32 bits of the number suffice: groups may be filled in any order, and their turn is interrupted at most once in
       2^32 segments. */
    const uint32_t target = (uint32_t)self->segments % (uint32_t)ZYGOS_GROUP_PLACES;
    end_segment(self, config, target, false, cycle, forgetting);
}

void zygos_joint_sums_set_aside(zygos_joint_sums_t *self, const zygos_config_t *config, uint64_t cycle,
                                double *forgetting, bool anew)
{
    end_segment(self, config, (uint32_t)ZYGOS_SET_ASIDE, anew, cycle, forgetting);
}

/* A row, or its noise, waits behind those before it. The place beside it is empty until the next one comes. */
static void queue_row(zygos_joint_wait_t *wait, uint32_t k, const double *z, uint32_t width)
{
    const uint32_t side = k % 2u;
    double(*pair)[2] = wait->pair[k / 2u];
    if (side == 0) {
        memset(pair, 0, width * sizeof pair[0]);
        memset(wait->total[k / 2u], 0, sizeof wait->total[0]);
    }
    double total = 0.0;
    for (uint32_t i = 0; i < width; i++) {
        pair[i][side] = z[i];
        total += z[i];
    }
    wait->total[k / 2u][side] = total;
}

/* The noise of one signal in a row, and of the rotors behind springs. */
static void add_noise(zygos_joint_sums_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                      const zygos_joint_t *joint, const zygos_joint_row_t *row, double weight)
{
    zygos_joint_gram_t *noise = &self->segment[self->filling].noise;
    double columns[ZYGOS_MAX_COLUMNS];
    double rotor[ZYGOS_MAX_JOINTS];
    double z[ZYGOS_MAX_PARAMETERS + 1];
    zygos_joint_derivative(joint, config, column_map, row->joint, self->turn, columns, rotor);
    for (uint32_t k = 0; k < column_map->count; k++) {
        columns[k] *= weight * self->deviation[self->turn];
    }
    zygos_reduce(config, column_map, columns, z);
    z[self->width - 1u] = 0.0;
    queue_row(&self->wait[1], self->waiting, z, self->width);
    for (uint32_t i = row->joint + 1u; i < config->joints; i++) {
        if (config->joint[i].rigid == 0) {
            const uint32_t known = column_map->place[column_map->joint[i]];
            const uint32_t place =
                (known < self->width) ? known : 0u; /* zygos_arm_scrub() reports one that cannot be */
            const double square = weight * weight * self->rotor_variance[i] * rotor[i] * rotor[i];
            noise->gram[zygos_gram_entries(place + 1u) - 1u] += square;
            noise->sum[place] += square;
        }
    }
}

void zygos_joint_sums_add(zygos_joint_sums_t *self, const zygos_config_t *config, const zygos_column_map_t *column_map,
                          const zygos_joint_t *joint, const zygos_joint_row_t *row)
{
    if ((row->joint == 0) || (self->waiting >= config->joints)) {
        add_all_waiting(self, config); /* none, unless a gap has come in between */
    }
    zygos_joint_segment_t *segment = &self->segment[self->filling];
    const double weight = row->accepted * self->weight[row->joint];
    double columns[ZYGOS_MAX_COLUMNS];
    double z[ZYGOS_MAX_PARAMETERS + 1];
    for (uint32_t k = 0; k < column_map->count; k++) {
        columns[k] = weight * row->column[k];
    }
    zygos_reduce(config, column_map, columns, z);
    z[self->width - 1u] = weight * row->impulse;
    queue_row(&self->wait[0], self->waiting, z, self->width);
    for (uint32_t k = 0; k < self->width; k++) {
        segment->joint[row->joint][k] += z[k];
    }
    segment->count[row->joint] += row->accepted;
    if (config->compensation > 0) {
        add_noise(self, config, column_map, joint, row, weight);
        self->turn = (self->turn + row->last) % zygos_joint_signals(config);
    }
    self->waiting++;
    self->filled += row->last * (uint32_t)(row->accepted > 0.0);
}

double zygos_joint_sums_open_rows(const zygos_joint_sums_t *self, const zygos_config_t *config)
{
    const zygos_joint_segment_t *segment = &self->segment[self->filling];
    double rows = 0.0;
    for (uint32_t j = 0; (j < config->joints) && (self->width > 0); j++) {
        rows += segment->count[j];
    }
    return rows;
}

double zygos_joint_sums_rows(const zygos_joint_sums_t *self)
{
    double rows = 0.0;
    for (uint32_t g = 0; g < (uint32_t)ZYGOS_GROUP_PLACES; g++) {
        rows += self->fade[g] * self->count[g];
    }
    return rows;
}

void zygos_joint_sums_flush(zygos_joint_sums_t *self, const zygos_config_t *config)
{
    const uint32_t entries = zygos_gram_entries(self->width);
    add_all_waiting(self, config);
    for (uint32_t step = 0; (step <= config->joints) && (self->adding != IDLE); step++) {
        advance_entries(self, config->joints, entries);
    }
}

void zygos_joint_sums_drop_after(zygos_joint_sums_t *self, uint64_t cycle)
{
    self->dropped += (self->segment[self->filling].count[0] > 0.0) ? 1u : 0u;
    self->doubtful += ((self->segments > 0) && (self->end > cycle)) ? 1u : 0u;
    clear_segment(&self->segment[self->filling], self->width);
    clear_waiting(self);
    self->filled = 0;
}

static bool matches(const zygos_joint_sums_t *self, const zygos_joint_gram_t *gram, double adds)
{
    return zygos_gram_check(gram->gram, self->width, gram->sum, adds) <= 1.0;
}

/* Whether the sums beside groups match, to which rows of the groups up to end were added. */
static bool are_others_whole(const zygos_joint_sums_t *self, uint32_t end)
{
    double adds = self->joint_sums;
    for (uint32_t g = 0; g < end; g++) {
        adds += self->count[g];
    }
    return matches(self, &self->noise, adds) && matches(self, &self->joints, adds);
}

bool zygos_joint_sums_is_whole(const zygos_joint_sums_t *self)
{
    bool good = (self->corrupt == 0) && ((self->width == 0) || (self->checksum == joints_checksum(self)));
    for (uint32_t g = 0; good && (g <= (uint32_t)ZYGOS_SET_ASIDE); g++) {
        good = matches(self, &self->group[g], self->count[g]);
    }
    return good && are_others_whole(self, (uint32_t)ZYGOS_SET_ASIDE + 1u);
}

bool zygos_joint_sums_steady(const zygos_joint_sums_t *self, const zygos_config_t *config)
{
    return (self->filling < 2u) && (self->adding <= JOINTS) && (self->cursor <= zygos_gram_entries(self->width)) &&
           (self->turn < zygos_joint_signals(config)) && (self->joint <= config->joints) &&
           (self->target <= (uint32_t)ZYGOS_SET_ASIDE) && (self->waiting <= config->joints) &&
           (self->row <= self->width);
}

bool zygos_joint_sums_scrub(zygos_joint_sums_t *self, const zygos_config_t *config,
                            const zygos_column_map_t *column_map)
{
    if (self->width == 0) {
        zygos_joint_sums_clear(self); /* its places are used where other sums are dropped */
        return true;
    }
    if (!are_joints_sealed(self) || (self->corrupt == 1u) || !zygos_joint_sums_intact(self, config, column_map)) {
        return false;
    }
    self->corrupt = 0;
    add_all_waiting(self, config);
    zygos_joint_segment_t *segment = &self->segment[self->filling];
    const double rows = zygos_joint_sums_open_rows(self, config);
    if (!matches(self, &segment->rows, rows) || !matches(self, &segment->noise, rows)) {
        self->quarantined++;
        clear_segment(segment, self->width);
        self->filled = 0;
    }
    if (self->adding != IDLE) {
        return true; /* a part of the sums is under way: the next call verifies them */
    }
    const bool good = are_others_whole(self, (uint32_t)ZYGOS_GROUP_PLACES);
    for (uint32_t g = 0; g <= (uint32_t)ZYGOS_SET_ASIDE; g++) {
        if (!matches(self, &self->group[g], self->count[g])) {
            self->quarantined++;
            clear_gram(&self->group[g], self->width);
            self->count[g] = 0.0;
        }
    }
    self->checksum = joints_checksum(self);
    return good;
}
