#include "zygos/accumulator.h"

#include <string.h>

#define FIRST_TARGET ZYGOS_MIN_ARC_INSTANTS
#define EPSILON 2.220446049250313e-16

static double magnitude(double x)
{
    return (x < 0.0) ? -x : x;
}

void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters)
{
    memset(self, 0, sizeof *self);
    self->width = parameters + 2u;
    self->target = FIRST_TARGET;
}

/* Row sums from the matrix itself, where it was changed as a whole. */
static void sum_rows(zygos_block_t *block, uint32_t width)
{
    memset(block->sum, 0, sizeof block->sum);
    uint32_t k = 0;
    for (uint32_t i = 0; i < width; i++) {
        for (uint32_t j = 0; j < i; j++) {
            block->sum[i] += block->gram[k];
            block->sum[j] += block->gram[k];
            k++;
        }
        block->sum[i] += block->gram[k];
        k++;
    }
}

static void add_block(zygos_block_t *to, const zygos_block_t *from, uint32_t width)
{
    for (uint32_t k = 0; k < width * (width + 1u) / 2u; k++) {
        to->gram[k] += from->gram[k];
    }
    for (uint32_t i = 0; i < width; i++) {
        to->sum[i] += from->sum[i];
    }
    for (uint32_t i = 0; i < width; i++) {
        to->deviation[i] += from->deviation[i];
    }
    to->instants += from->instants;
    to->end = from->end;
}

/* Merges neighbours in [first, end) that fit into one block and puts the results at to, to + 1, ...
   Returns the place behind them. */
static uint32_t merge(zygos_accumulator_t *self, uint32_t first, uint32_t end, uint32_t to)
{
    const uint32_t begin = to;
    for (uint32_t from = first; from < end; from++) {
        if ((to > begin) && (self->block[to - 1u].instants + self->block[from].instants <= self->target)) {
            add_block(&self->block[to - 1u], &self->block[from], self->width);
            continue;
        }
        if (to != from) {
            self->block[to] = self->block[from];
        }
        to++;
    }
    return to;
}

/* Blocks of closed arcs never merge with those of the open one, whose constant is still in them. The target doubles
   only when merging up to it is not enough; once it holds all instants there are, each group is one block: the loop
   ends. */
static void make_room(zygos_accumulator_t *self)
{
    for (uint32_t tries = 0; tries < 64u; tries++) {
        const uint32_t open = merge(self, 0, self->open, 0);
        self->count = merge(self, self->open, self->count, open);
        self->open = open;
        if (self->count <= 3u * ZYGOS_MAX_BLOCKS / 4u) {
            return;
        }
        self->target *= 2u;
    }
}

static zygos_block_t *current_block(zygos_accumulator_t *self)
{
    const bool none = (self->count == self->open);
    if (none || (self->block[self->count - 1u].instants >= self->target)) {
        if (self->count == ZYGOS_MAX_BLOCKS) {
            make_room(self);
        }
        memset(&self->block[self->count], 0, sizeof self->block[0]);
        self->count++;
    }
    return &self->block[self->count - 1u];
}

void zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight)
{
    const uint32_t width = self->width;
    const uint32_t p = width - 2u;
    zygos_block_t *block = current_block(self);
    double z[ZYGOS_MAX_ROW];
    double total = 0.0;
    for (uint32_t i = 0; i < p; i++) {
        z[i] = weight * row->column[i];
        total += z[i];
    }
    z[p] = weight * row->work;
    z[p + 1u] = weight;
    total += z[p] + z[p + 1u];
    double *gram = block->gram;
    for (uint32_t i = 0; i < width; i++) {
        const double zi = z[i];
        for (uint32_t j = 0; j <= i; j++) {
            gram[j] += zi * z[j];
        }
        gram += i + 1u;
        block->sum[i] += zi * total;
    }
    const uint32_t one = (weight > 0.0) ? 1u : 0u;
    block->instants += one;
    self->arc_instants += one;
    self->accepted += one;
    self->refused += 1u - one;
}

static double check_block(const zygos_block_t *block, uint32_t width)
{
    double sum[ZYGOS_MAX_ROW] = { 0.0 };
    double largest = 0.0;
    double worst = 0.0;
    uint32_t k = 0;
    for (uint32_t i = 0; i < width; i++) {
        for (uint32_t j = 0; j < i; j++) {
            largest = (magnitude(block->gram[k]) > largest) ? magnitude(block->gram[k]) : largest;
            sum[i] += block->gram[k];
            sum[j] += block->gram[k];
            k++;
        }
        largest = (magnitude(block->gram[k]) > largest) ? magnitude(block->gram[k]) : largest;
        sum[i] += block->gram[k];
        k++;
    }
    const double tolerance = 64.0 * EPSILON * (double)width * largest;
    for (uint32_t i = 0; i < width; i++) {
        const double off = magnitude(sum[i] - block->sum[i]);
        /* Not-a-number compares false with everything; neither it nor infinity is a sum. */
        const bool good = (off <= tolerance) && (tolerance < 1e300);
        const double ratio = good ? off / (tolerance + 1e-300) : 2.0;
        worst = (ratio > worst) ? ratio : worst;
    }
    return worst;
}

/* G - s m^T - m s^T + n m m^T, entry by entry; s is the last row of G. */
static void centre(zygos_block_t *block, uint32_t width, const double *mean)
{
    double s[ZYGOS_MAX_ROW];
    const double *last = &block->gram[(width - 1u) * width / 2u];
    memcpy(s, last, width * sizeof s[0]);
    const double n = s[width - 1u];
    for (uint32_t i = 0; i < width; i++) {
        block->deviation[i] = s[i] - n * mean[i];
    }
    uint32_t k = 0;
    for (uint32_t i = 0; i < width; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            block->gram[k] += n * mean[i] * mean[j] - s[i] * mean[j] - mean[i] * s[j];
            k++;
        }
    }
    sum_rows(block, width);
}

static void drop_open_arc(zygos_accumulator_t *self)
{
    self->arcs_dropped += (self->count > self->open) ? 1u : 0u;
    self->accepted -= self->arc_instants;
    self->arc_instants = 0;
    self->count = self->open;
}

void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle)
{
    drop_open_arc(self);
    while ((self->open > 0) && (self->block[self->open - 1u].end > cycle)) {
        const zygos_block_t *last = &self->block[self->open - 1u];
        const bool first_of_arc = (self->open == 1) || (self->block[self->open - 2u].end != last->end);
        self->accepted -= last->instants;
        self->arcs -= first_of_arc ? 1u : 0u;
        self->arcs_dropped += first_of_arc ? 1u : 0u;
        self->open--;
    }
    self->count = self->open;
}

void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle)
{
    const uint32_t width = self->width;
    if (self->arc_instants < ZYGOS_MIN_ARC_INSTANTS) {
        drop_open_arc(self);
    } else {
        double mean[ZYGOS_MAX_ROW] = { 0.0 };
        const uint32_t last = (width - 1u) * width / 2u;
        for (uint32_t b = self->open; b < self->count; b++) {
            for (uint32_t i = 0; i < width; i++) {
                mean[i] += self->block[b].gram[last + i];
            }
        }
        for (uint32_t i = 0; i < width; i++) {
            mean[i] /= (double)self->arc_instants;
        }
        for (uint32_t b = self->open; b < self->count; b++) {
            /* Centring cancels: the row sums are judged before, and taken anew after. */
            self->corrupt |= (check_block(&self->block[b], width) <= 1.0) ? 0u : 1u;
            centre(&self->block[b], width, mean);
            self->block[b].end = cycle;
        }
        self->open = self->count;
        self->arcs++;
    }
    self->arc_instants = 0;
}

void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram)
{
    const uint32_t entries = self->width * (self->width + 1u) / 2u;
    memset(gram, 0, entries * sizeof gram[0]);
    for (uint32_t b = 0; b < self->open; b++) {
        for (uint32_t k = 0; k < entries; k++) {
            gram[k] += self->block[b].gram[k];
        }
    }
}

double zygos_accumulator_check(const zygos_accumulator_t *self)
{
    double worst = self->corrupt ? 2.0 : 0.0;
    for (uint32_t b = 0; b < self->count; b++) {
        const double here = check_block(&self->block[b], self->width);
        worst = (here > worst) ? here : worst;
    }
    return worst;
}
