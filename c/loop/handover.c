/* SPDX-License-Identifier: MIT */
#include "zygos/priv/handover.h"

#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

#define WORD 8u
#define WORDS(bytes) ((uint32_t)((bytes) / WORD))
/* Copy from the first member of a struct to before another one, or to its end. */
#define COPY_FROM(to, from, type, first, bytes)                                                                        \
    zygos_copy_words((unsigned char *)(to) + offsetof(type, first),                                                    \
                     (const unsigned char *)(from) + offsetof(type, first), WORDS((bytes)-offsetof(type, first)))
#define COPY_SPAN(to, from, type, first, end) COPY_FROM(to, from, type, first, offsetof(type, end))
#define COPY_REST(to, from, type, first) COPY_FROM(to, from, type, first, sizeof(type))

static void cut_store(const zygos_store_t *from, zygos_store_t *to)
{
    COPY_SPAN(to, from, zygos_store_t, count, scan);
}

/* What a task has scanned, and the noise of the arc that is closing in the copy. */
static void cut_closing(const zygos_store_t *from, zygos_store_t *to, uint32_t kind)
{
    to->scan = from->scan;
    zygos_store_copy_noise(from, to, kind, (to->parity & 1u) ^ 1u);
}

/* ---------------------------------------------------------------- energy rows */

/* A width that is not possible is found by the cycle that follows; here it only must not lead out of memory. */
static uint32_t energy_width(const zygos_accumulator_t *from)
{
    const uint32_t width = zygos_least(from->width, (uint32_t)ZYGOS_MAX_ROW);
    return (width > 0) ? width : 1u;
}

static void cut_block(zygos_handover_t *self, const zygos_accumulator_t *from, zygos_accumulator_t *to, uint32_t place)
{
    if ((place < (uint32_t)ZYGOS_MAX_BLOCKS) && (self->copied[place] == 0)) {
        zygos_store_copy_block(&from->store, &to->store, (uint32_t)ZYGOS_ENERGY_ROWS, place);
        self->copied[place] = 1;
    }
}

/* A buffer with rows that are not in the blocks yet. */
static bool has_rows(const zygos_accumulator_t *from, uint32_t b)
{
    return (from->buffer[b].shared < ZYGOS_BUFFER_SLICES) || ((b == from->filling) && (from->filled > 0));
}

static void cut_buffer(const zygos_accumulator_t *from, zygos_accumulator_t *to, uint32_t b)
{
    const zygos_row_buffer_t *buffer = &from->buffer[b];
    const uint32_t width = energy_width(from);
    if (has_rows(from, b)) {
        zygos_copy_words(to->buffer[b].pair, buffer->pair, (width + 1u) / 2u * (uint32_t)WORDS(sizeof buffer->pair[0]));
        COPY_SPAN(&to->buffer[b], buffer, zygos_row_buffer_t, total, gram);
        if (from->noisy != 0) {
            zygos_copy_words(to->buffer[b].gram, buffer->gram, zygos_gram_entries(width));
            zygos_copy_words(to->buffer[b].sum, buffer->sum, width);
        }
    }
    COPY_REST(&to->buffer[b], buffer, zygos_row_buffer_t, instants);
}

static void copy_sums(const double *gram, const double *sum, double *to_gram, double *to_sum, uint32_t width)
{
    zygos_copy_words(to_gram, gram, zygos_gram_entries(width));
    zygos_copy_words(to_sum, sum, width);
}
#define COPY_SUMS(from, to, width) copy_sums((from)->gram, (from)->sum, (to)->gram, (to)->sum, width)

/* Slices of a buffer that a cycle adds to blocks, at the most (zygos_accumulator_add()). */
#define MOST_SLICES 3u
_Static_assert(MOST_SLICES *ZYGOS_HANDOVER_QUARTERS <= ZYGOS_BUFFER_SLICES,
               "rows of a block are copied before rows that wait are added to them");
_Static_assert(ZYGOS_HANDOVER_QUARTERS < ZYGOS_BUFFER_ROWS, "no other buffer is added to the blocks in this time");

/* With no rows in the buffer that is filled, the fewest have to be copied. None of another buffer is half added, and
   the next arc finds cleared blocks although tasks wait from here on. */
static bool suits_energy(const zygos_accumulator_t *from)
{
    bool good = (from->filled == 0) && (from->store.ready >= ZYGOS_SPARE_BLOCKS);
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        const uint32_t shared = from->buffer[b].shared;
        good = good && ((shared == 0) || (shared == ZYGOS_BUFFER_SLICES));
    }
    return good;
}

/* The blocks to which rows are being added, or are going to be. Returns their number. */
#define MOST_OPEN (2u * ZYGOS_ROW_BUFFERS + 2u)
static uint32_t open_blocks(const zygos_accumulator_t *sums, uint32_t *place)
{
    uint32_t found[MOST_OPEN];
    uint32_t n = 0;
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        if (sums->buffer[b].shared < ZYGOS_BUFFER_SLICES) {
            found[n++] = zygos_store_first_of(sums->buffer[b].blocks);
            found[n++] = zygos_store_second_of(sums->buffer[b].blocks);
        }
    }
    for (uint32_t newest = 1; newest <= 2u; newest++) {
        if ((sums->store.count >= sums->store.fresh + newest) && (sums->store.count <= (uint32_t)ZYGOS_MAX_BLOCKS)) {
            found[n++] = sums->store.order[sums->store.count - newest];
        }
    }
    uint32_t kept = 0;
    for (uint32_t i = 0; i < n; i++) {
        bool known = (found[i] >= (uint32_t)ZYGOS_MAX_BLOCKS);
        for (uint32_t j = 0; j < kept; j++) {
            known = known || (place[j] == found[i]);
        }
        if (!known) {
            place[kept++] = found[i];
        }
    }
    return kept;
}

/* The first row that the quarters before this one do not contain. No quarter has fewer rows than what is added in a
   cycle, for which the number of rows is found in the same way. */
static uint32_t quarter_begins(uint32_t width, uint32_t quarter)
{
    const uint32_t most = zygos_gram_entries(width) * (ZYGOS_BUFFER_SLICES / ZYGOS_HANDOVER_QUARTERS) * quarter;
    uint32_t row = 0;
    while ((row < width) && (ZYGOS_BUFFER_SLICES / 2u * (row + 1u) * (row + 1u) <= most)) {
        row++;
    }
    return (quarter >= ZYGOS_HANDOVER_QUARTERS) ? width : row;
}

/* Copies the rows of a quarter of the open blocks. Which these are, the cut has copied. */
static void copy_quarter(const zygos_accumulator_t *from, zygos_accumulator_t *to, uint32_t quarter)
{
    uint32_t place[MOST_OPEN];
    const uint32_t n = open_blocks(to, place);
    const uint32_t first = quarter_begins(energy_width(from), quarter);
    const uint32_t end = quarter_begins(energy_width(from), quarter + 1u);
    const uint32_t entry = zygos_gram_entries(first);
    for (uint32_t i = 0; i < n; i++) {
        const zygos_block_t *block = &from->block[place[i]];
        zygos_block_t *block_out = &to->block[place[i]];
        zygos_copy_words(&block_out->gram[entry], &block->gram[entry], zygos_gram_entries(end) - entry);
        zygos_copy_words(&block_out->sum[first], &block->sum[first], end - first);
    }
}

static void cut_energy(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    const zygos_accumulator_t *from = &sums->energy;
    zygos_accumulator_t *to = &out->energy;
    uint32_t place[MOST_OPEN];
    memset(self->copied, 0, sizeof self->copied);
    cut_store(&from->store, &to->store);
    COPY_SPAN(to, from, zygos_accumulator_t, width, mean);
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        cut_buffer(from, to, b);
    }
    self->whole = suits_energy(from) ? 0u : 1u;
    const uint32_t n = open_blocks(from, place);
    for (uint32_t i = 0; i < n; i++) {
        if (self->whole != 0) {
            cut_block(self, from, to, place[i]);
        } else {
            COPY_REST(&to->block[place[i]], &from->block[place[i]], zygos_block_t, square);
            self->copied[place[i]] = 1;
        }
    }
    if (self->whole == 0) {
        copy_quarter(from, to, 0);
    }
    if (from->noisy != 0) {
        zygos_store_copy_noise(&from->store, &to->store, (uint32_t)ZYGOS_ENERGY_ROWS, from->store.parity & 1u);
    }
    out->arc = sums->arc;
}

/* Whether rows of two buffers are added in the next cycle, beside which a block is not copied where it is large. */
static bool two_wait(const zygos_accumulator_t *from)
{
    uint32_t waiting = 0;
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        waiting += (from->buffer[b].shared < ZYGOS_BUFFER_SLICES) ? 1u : 0u;
    }
    return (waiting > 1u) && (from->width > ZYGOS_WIDE);
}

/* What follows the cut: the other quarters of the open blocks, means and noise of the closing arc, noise of the closed
   ones, and block by block. Returns false behind the last unit. */
static bool energy_unit(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    const zygos_accumulator_t *from = &sums->energy;
    zygos_accumulator_t *to = &out->energy;
    const uint32_t quarter = self->unit + 1u;
    if (quarter < ZYGOS_HANDOVER_QUARTERS) {
        if (self->whole == 0) {
            copy_quarter(from, to, quarter);
        }
        return true;
    }
    const uint32_t unit = quarter - ZYGOS_HANDOVER_QUARTERS;
    if (two_wait(from) && (self->tries < ZYGOS_HANDOVER_TRIES)) {
        self->unit--; /* the same unit in a later cycle */
        return true;
    }
    if (unit == 0) {
        zygos_copy_words(to->mean, from->mean, energy_width(from));
        cut_closing(&from->store, &to->store, (uint32_t)ZYGOS_ENERGY_ROWS);
    } else if (unit == 1u) {
        zygos_store_copy_noise(&from->store, &to->store, (uint32_t)ZYGOS_ENERGY_ROWS, ZYGOS_NOISE_OF_CLOSED);
    } else if (unit - 2u < zygos_least(to->store.count, (uint32_t)ZYGOS_MAX_BLOCKS)) {
        cut_block(self, from, to, to->store.order[unit - 2u]);
    } else {
        return false;
    }
    return true;
}

/* ---------------------------------------------------------------- motor and momentum rows */

static void cut_rows(const zygos_sums_t *sums, zygos_sums_t *out, uint32_t kind)
{
    const zygos_store_t *from = zygos_sums_store(sums, kind);
    zygos_store_t *to = zygos_sums_store(out, kind);
    cut_store(from, to);
    zygos_store_copy_noise(from, to, kind, from->parity & 1u);
    zygos_store_copy_block(from, to, kind, from->open);
}

static void copy_tables(const zygos_sums_t *sums, zygos_sums_t *out, uint32_t kind)
{
    if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        COPY_SPAN(&out->motors, &sums->motors, zygos_motor_sums_t, column_map, block);
    } else {
        COPY_SPAN(&out->momentum, &sums->momentum, zygos_momentum_sums_t, columns, noise_open);
    }
}

/* Units before the first block: the tables, and the noise of closed arcs where there is some. */
static uint32_t units_before(uint32_t kind)
{
    return (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS) ? 2u : 1u;
}

/* The tables with the noise of the closing arc, that of the closed ones, then block by block, the closing arc last. */
static bool row_unit(const zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    const uint32_t kind = self->kind;
    const zygos_store_t *from = zygos_sums_store(sums, kind);
    zygos_store_t *to = zygos_sums_store(out, kind);
    const uint32_t before = units_before(kind);
    if (self->unit == 0) {
        copy_tables(sums, out, kind);
        cut_closing(from, to, kind);
    } else if (self->unit < before) {
        zygos_store_copy_noise(from, to, kind, ZYGOS_NOISE_OF_CLOSED);
    } else if (self->unit - before < zygos_least(to->fresh, (uint32_t)ZYGOS_ORDER_PLACES)) {
        zygos_store_copy_block(from, to, kind, zygos_store_place(to, kind, self->unit - before));
    } else {
        return false;
    }
    return true;
}

/* ---------------------------------------------------------------- joint rows */

static uint32_t joint_width(const zygos_joint_sums_t *from)
{
    return zygos_least(from->width, (uint32_t)ZYGOS_MAX_JOINT_ROW);
}

static void cut_segment(const zygos_joint_sums_t *from, zygos_joint_sums_t *to, uint32_t s)
{
    const uint32_t width = joint_width(from);
    COPY_SUMS(&from->segment[s].rows, &to->segment[s].rows, width);
    COPY_SUMS(&from->segment[s].noise, &to->segment[s].noise, width);
    COPY_REST(&to->segment[s], &from->segment[s], zygos_joint_segment_t, joint);
}

static void cut_group(const zygos_joint_sums_t *from, zygos_joint_sums_t *to, uint32_t g)
{
    COPY_SUMS(&from->group[g], &to->group[g], joint_width(from));
}

/* Half of the time no segment is being added to a group. */
static bool suits_joints(const zygos_joint_sums_t *from)
{
    return from->adding == 0;
}

static void cut_joints(const zygos_sums_t *sums, zygos_sums_t *out)
{
    const zygos_joint_sums_t *from = &sums->joints;
    zygos_joint_sums_t *to = &out->joints;
    COPY_SPAN(to, from, zygos_joint_sums_t, filling, noise);
    if (from->width == 0) {
        return;
    }
    for (uint32_t kind = 0; kind < 2u; kind++) {
        if (from->waiting > 0) {
            to->wait[kind] = from->wait[kind];
        }
    }
    const uint32_t filling = from->filling & 1u;
    cut_segment(from, to, filling);
    if (from->adding != 0) {
        cut_segment(from, to, filling ^ 1u);
        COPY_SUMS(&from->noise, &to->noise, joint_width(from));
        COPY_SUMS(&from->joints, &to->joints, joint_width(from));
        cut_group(from, to, zygos_least(from->target, (uint32_t)ZYGOS_SET_ASIDE));
    }
}

/* The tables with noise and joints' sums, then group by group; the cut has copied what a segment is added to. */
static bool joint_unit(const zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    const zygos_joint_sums_t *from = &sums->joints;
    zygos_joint_sums_t *to = &out->joints;
    if ((from->width == 0) || (self->unit > 1u + (uint32_t)ZYGOS_SET_ASIDE)) {
        return false;
    }
    const bool adding = (to->adding != 0);
    if (self->unit == 0) {
        COPY_SPAN(to, from, zygos_joint_sums_t, width, filling);
        if (!adding) {
            COPY_SUMS(&from->noise, &to->noise, joint_width(from));
            COPY_SUMS(&from->joints, &to->joints, joint_width(from));
        }
    } else if (!adding || (self->unit - 1u != to->target)) {
        cut_group(from, to, self->unit - 1u);
    }
    return true;
}

/* ---------------------------------------------------------------- running solution */

static void cut_guard(const zygos_sums_t *sums, zygos_sums_t *out)
{
    COPY_SPAN(&out->guard, &sums->guard, zygos_guard_t, known, checksum);
    out->cycle = sums->cycle;
    out->checksum = sums->checksum;
}

/* The running solution, then the arcs that are held. */
static bool guard_unit(const zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    const zygos_guard_t *from = &sums->guard;
    const uint32_t p = zygos_least(from->parameters, (uint32_t)ZYGOS_MAX_PARAMETERS);
    if (self->unit == 0) {
        COPY_SPAN(&out->guard, from, zygos_guard_t, checksum, covariance);
        zygos_copy_words(out->guard.covariance, from->covariance, zygos_gram_entries(p));
    } else {
        COPY_SPAN(&out->guard, from, zygos_guard_t, held_after, held);
        COPY_SUMS(&from->held, &out->guard.held, p + 1u);
    }
    return self->unit == 0;
}

/* ---------------------------------------------------------------- all kinds */

/* Whether what follows the cut will be copied before the open arc ends, which would have to wait. An arc that is not
   much longer than that ends too often to be waited for. */
static bool has_time(uint32_t units, uint32_t done, uint32_t longest)
{
    const uint32_t cycles = units + 2u;
    return (longest < 2u * cycles) || (done + cycles < longest);
}

static bool suits(const zygos_sums_t *sums, uint32_t kind)
{
    const zygos_config_t *config = &sums->config;
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        return suits_energy(&sums->energy) &&
               has_time(sums->energy.store.count + 2u + ZYGOS_HANDOVER_QUARTERS, sums->arc, config->arc_cycles);
    }
    if (kind < (uint32_t)ZYGOS_KINDS_OF_ROWS) {
        const zygos_store_t *store = zygos_sums_store(sums, kind);
        return has_time(store->fresh + units_before(kind), store->cycles, zygos_store_longest(config, kind));
    }
    return (kind != ZYGOS_JOINT_KIND) || suits_joints(&sums->joints);
}

/* Zero of what is zero. */
static uint32_t fold_of(const zygos_handover_t *self)
{
    uint32_t fold = zygos_folded_count(self->kind, self->cut);
    fold = zygos_folded_count(zygos_folded_count(fold, self->unit), self->waited);
    fold = zygos_folded_count(zygos_folded_count(fold, self->tries), self->whole);
    uint64_t all = zygos_folded(fold, self->dropped);
    for (uint32_t at = 0; at < (uint32_t)sizeof self->copied; at += WORD) {
        uint64_t word;
        __builtin_memcpy(&word, &self->copied[at], sizeof word);
        all = zygos_folded(all, word);
    }
    return (uint32_t)(zygos_fold_end(all) >> 32u);
}

void zygos_handover_begin(zygos_handover_t *self)
{
    memset(self, 0, sizeof *self);
}

uint32_t zygos_handover_held(const zygos_handover_t *self)
{
    return ((self->cut != 0) && (self->kind < (uint32_t)ZYGOS_KINDS_OF_ROWS)) ? 1u << self->kind : 0u;
}

/* An arc that waits for its end is one of the open rows, too. */
static void cut_ending(const zygos_sums_t *sums, zygos_sums_t *out, uint32_t kind)
{
    const uint32_t bit = 1u << kind;
    out->ending = (out->ending & ~bit) | (sums->ending & bit);
    out->ended[kind] = sums->ended[kind];
    out->ended_forgetting[kind] = sums->ended_forgetting[kind];
}

static void cut(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    switch (self->kind) {
    case ZYGOS_ENERGY_ROWS:
        cut_energy(self, sums, out);
        break;
    case ZYGOS_MOTOR_ROWS:
    case ZYGOS_MOMENTUM_ROWS:
        cut_rows(sums, out, self->kind);
        break;
    case ZYGOS_JOINT_KIND:
        cut_joints(sums, out);
        break;
    default:
        cut_guard(sums, out);
        break;
    }
    if (self->kind < (uint32_t)ZYGOS_KINDS_OF_ROWS) {
        cut_ending(sums, out, self->kind);
    }
    if (self->kind < ZYGOS_KINDS_OF_SUMS) {
        out->forgetting[self->kind] = sums->forgetting[self->kind];
    }
    self->cut = 1;
    self->waited = 0;
    self->unit = 0;
    self->dropped = sums->dropped;
}

/* Copies the next unit of what follows the cut. Returns false where there is none. */
static bool copy_unit(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    switch (self->kind) {
    case ZYGOS_ENERGY_ROWS:
        return energy_unit(self, sums, out);
    case ZYGOS_MOTOR_ROWS:
    case ZYGOS_MOMENTUM_ROWS:
        return row_unit(self, sums, out);
    case ZYGOS_JOINT_KIND:
        return joint_unit(self, sums, out);
    default:
        return guard_unit(self, sums, out);
    }
}

/* Whether the blocks of the open arc have been copied, so that it may end where it is short, and be dropped. */
static bool has_open_blocks(const zygos_handover_t *self, const zygos_accumulator_t *to)
{
    return (to->store.count <= to->store.fresh + 2u) &&
           ((self->whole != 0) || (self->unit + 1u >= ZYGOS_HANDOVER_QUARTERS));
}

/* Whether blocks of energy rows that are still to be copied have changed. */
static bool is_disturbed_energy(const zygos_handover_t *self, const zygos_accumulator_t *from,
                                const zygos_accumulator_t *to)
{
    const bool may_end = has_open_blocks(self, to);
    const uint32_t needed = may_end ? to->store.fresh : to->store.count;
    bool disturbed = (from->store.closed != to->store.closed) || (!may_end && (from->store.fresh != to->store.fresh)) ||
                     (from->store.count < needed);
    for (uint32_t r = 0; (r < needed) && (r < (uint32_t)ZYGOS_MAX_BLOCKS); r++) {
        disturbed = disturbed || (from->store.order[r] != to->store.order[r]);
    }
    return disturbed;
}

/* Whether something that was to rest has changed since the cut: sums were dropped, or, where there was no block for the
   open arc, blocks were merged at once; a segment of joint rows has ended. */
static bool is_disturbed(const zygos_handover_t *self, const zygos_sums_t *sums, const zygos_sums_t *out)
{
    return (sums->dropped != self->dropped) ||
           ((self->kind == (uint32_t)ZYGOS_ENERGY_ROWS) && is_disturbed_energy(self, &sums->energy, &out->energy)) ||
           ((self->kind == ZYGOS_JOINT_KIND) && (sums->joints.end != out->joints.end));
}

static void next_kind(zygos_handover_t *self)
{
    self->kind++;
    self->cut = 0;
    self->waited = 0;
    self->tries = 0;
}

/* Returns whether all is copied. */
static bool proceed(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    if (self->kind >= ZYGOS_HANDOVER_KINDS) {
        return true;
    }
    if ((self->cut != 0) && is_disturbed(self, sums, out)) {
        self->cut = 0;
        self->waited = 0;
        self->tries++;
    }
    const bool at_once = (self->tries >= ZYGOS_HANDOVER_TRIES);
    if (self->cut == 0) {
        if (!suits(sums, self->kind) && (self->waited < ZYGOS_HANDOVER_PATIENCE) && !at_once) {
            self->waited++;
            return false;
        }
        cut(self, sums, out);
        if (!at_once) {
            return false;
        }
    }
    bool more = copy_unit(self, sums, out);
    for (self->unit++; at_once && more; self->unit++) {
        more = copy_unit(self, sums, out);
    }
    if (!more) {
        next_kind(self);
    }
    return self->kind >= ZYGOS_HANDOVER_KINDS;
}

bool zygos_handover_part(zygos_handover_t *self, const zygos_sums_t *sums, zygos_sums_t *out)
{
    if (self->fold != fold_of(self)) {
        zygos_handover_begin(self);
    }
    const bool done = proceed(self, sums, out);
    self->fold = fold_of(self);
    return done;
}
