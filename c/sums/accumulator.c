/* SPDX-License-Identifier: MIT */
#include "zygos/priv/accumulator.h"

#include "zygos/priv/numbers.h"

#include <string.h>

/* Initial number of segments of the longest arc: many, but none shorter than a second unless the arc would have only a
   few. The error by the noise of rates at the ends of a block decreases with the time in which its weight changes. */
#define SEGMENTS 48u
#define SEGMENT_S 1.0
#define FEWEST 4u
#define MOST 1024u /* largest initial length of a segment in instants */
#define MIN_BUFFERS 3u
#define KIND ((uint32_t)ZYGOS_ENERGY_ROWS)

_Static_assert(ZYGOS_BUFFER_ROWS == 8, "add_matrix_row() has eight products");

/* What rounding may make of a sum of so many weights, relative to it. A flipped bit that changes less does no harm. */
static double rounded(double instants)
{
    return 1e-9 + 2.220446049250313e-16 * instants;
}

static zygos_block_t *energy_block(zygos_accumulator_t *self, uint32_t place)
{
    return &self->block[(place < (uint32_t)ZYGOS_MAX_BLOCKS) ? place : 0u];
}

const zygos_block_t *zygos_accumulator_at(const zygos_accumulator_t *self, uint32_t rank)
{
    return &self->block[zygos_store_place(&self->store, KIND, rank)];
}

const double *zygos_accumulator_deviation(const zygos_accumulator_t *self, const zygos_block_t *block)
{
    return &block->gram[zygos_gram_entries(self->width - 1u)];
}

/* noisy: there may be noise in it. */
static void clear_buffer(const zygos_accumulator_t *self, zygos_row_buffer_t *buffer, bool noisy)
{
    if (noisy) {
        memset(buffer->gram, 0, zygos_gram_entries(self->width) * sizeof buffer->gram[0]);
        memset(buffer->sum, 0, self->width * sizeof buffer->sum[0]);
    }
    buffer->instants = 0.0;
    buffer->variance = 0.0;
    buffer->shared = ZYGOS_BUFFER_SLICES;
    buffer->row = self->width;
}

void zygos_accumulator_forget_rows(zygos_accumulator_t *self)
{
    self->filled = 0;
    self->filling = 0;
    self->segment = 0.0;
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        clear_buffer(self, &self->buffer[b], true);
        self->buffer[b].blocks = 0;
        self->buffer[b].parity = self->store.parity & 1u;
    }
    self->twin = zygos_accumulator_twin(self);
}

void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s)
{
    const uint64_t most = arc_cycles / FEWEST;
    const uint64_t slow = (uint64_t)(SEGMENT_S / period_s);
    const uint64_t least = (slow < most) ? slow : most;
    const uint64_t many = (arc_cycles / SEGMENTS < MOST) ? arc_cycles / SEGMENTS : MOST;
    const uint64_t steps = ((many > least) ? many : least) / ZYGOS_BUFFER_ROWS;
    const uint32_t noisy = self->noisy;
    memset(self, 0, sizeof *self);
    self->noisy = noisy;
    self->width = parameters + 2u;
    zygos_store_clear(&self->store, KIND, (double)(ZYGOS_BUFFER_ROWS * ((steps > MIN_BUFFERS) ? steps : MIN_BUFFERS)));
    zygos_accumulator_forget_rows(self);
}

/* ---------------------------------------------------------------- the closing arc */

bool zygos_accumulator_waits(const zygos_accumulator_t *self)
{
    uint32_t waiting = 0; /* counted without branches: the cost is the same whichever buffer waits */
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        waiting += (uint32_t)(self->buffer[b].parity != self->store.parity) *
                   (uint32_t)(self->buffer[b].shared < ZYGOS_BUFFER_SLICES);
    }
    return waiting > 0;
}

/* Of what all blocks of the closing arc are centred with, for as long as that takes. */
static uint32_t checksum_of_means(const zygos_accumulator_t *self)
{
    const uint64_t means = zygos_checksum_doubles(2u, self->mean, self->width);
    const uint64_t sum =
        zygos_checksum_number(zygos_checksum_number(means, self->store.closing_end), self->store.closing_instants);
    return (uint32_t)(sum ^ (sum >> 32u));
}

bool zygos_accumulator_take_means(zygos_accumulator_t *self)
{
    const uint32_t last = zygos_gram_entries(self->width - 1u);
    memset(self->mean, 0, sizeof self->mean);
    for (uint32_t r = self->store.closed; r < self->store.fresh; r++) {
        const double *s = &zygos_accumulator_at(self, r)->gram[last];
        for (uint32_t i = 0; i < self->width; i++) {
            self->mean[i] += s[i];
        }
    }
    for (uint32_t i = 0; i < self->width; i++) {
        self->mean[i] /= (double)self->store.closing_instants;
    }
    self->overlap = 0.0;
    self->means_checksum = checksum_of_means(self);
    /* The last column counts instants as well. */
    const double counted = self->mean[self->width - 1u];
    const double few = rounded((double)self->store.closing_instants);
    return (counted > 1.0 - few) && (counted < 1.0 + few);
}

/* Whether both copies of a sum of squares are the same, and possible. */
static bool is_twice(const double *variance)
{
    const double off = variance[0] - variance[1];
    return (variance[0] >= 0.0) && (off >= 0.0) && (off <= 0.0);
}

/* Whether a block of the open arc has as many instants as its sums count, and of these the weights that its segments
   gave it: those of an instant add up to 1, so w = w^2 + what w shares with the block before and the one behind. */
static bool weighs_what_it_should(const zygos_block_t *block, uint32_t width, double before)
{
    const double off = block->gram[zygos_gram_entries(width) - 1u] - block->head.total;
    const double shared = block->head.total - block->square - block->overlap - before;
    const double few = rounded(block->head.total) * (1.0 + block->head.total);
    return (block->head.checksum == 0) && (off >= -few) && (off <= few) && (shared >= -few) && (shared <= few) &&
           is_twice(block->variance);
}

bool zygos_accumulator_verified(zygos_accumulator_t *self, const zygos_block_t *block)
{
    const bool whole = weighs_what_it_should(block, self->width, self->overlap);
    zygos_gram_scan_t *scan = &self->store.scan;
    const double *s = zygos_accumulator_deviation(self, block);
    const double *mean = self->mean;
    const double n = s[self->width - 1u];
    double all = 0.0;
    double means = 0.0;
    double size = 0.0;
    double size_of_means = 0.0;
    self->overlap = block->overlap;
    for (uint32_t i = 0; i < self->width; i++) {
        all += s[i];
        means += mean[i];
        size += __builtin_fabs(s[i]);
        size_of_means += __builtin_fabs(mean[i]);
    }
    /* The scan keeps what the row sums will be, for a bit may flip while the constant is eliminated, and how large what
       is added is: the mean of the arc may be far from the rows of this block. */
    for (uint32_t i = 0; i < self->width; i++) {
        const double far = __builtin_fabs(mean[i]);
        scan->sum[i] += n * mean[i] * means - s[i] * means - mean[i] * all;
        scan->most[i] += (__builtin_fabs(s[i]) + n * far) * size_of_means + far * size;
    }
    scan->sum[self->width - 1u] = all - n * means; /* of the deviations */
    return whole;
}

/* Eliminates the constant from row i of a block, G - s m^T - m s^T + n m m^T, and adds the row and its column to the
   row sums. s: the sums of the columns of n rows. Two entries at a time. */
static void centre_row(double *restrict entry, double *restrict sum, const double *restrict mean,
                       const double *restrict s, double n, uint32_t i)
{
    const double own = mean[i];
    const double deviation = s[i] - n * own;
    double even = 0.0;
    double odd = 0.0;
    uint32_t j = 0;
    for (; j + 1u < i; j += 2u) {
        const double left = entry[j] - (deviation * mean[j] + own * s[j]);
        const double right = entry[j + 1u] - (deviation * mean[j + 1u] + own * s[j + 1u]);
        entry[j] = left;
        entry[j + 1u] = right;
        sum[j] += left;
        sum[j + 1u] += right;
        even += left;
        odd += right;
    }
    if (j < i) {
        entry[j] -= deviation * mean[j] + own * s[j];
        sum[j] += entry[j];
        even += entry[j];
    }
    entry[i] -= deviation * own + own * s[i];
    sum[i] += even + odd + entry[i];
}

void zygos_accumulator_eliminate(zygos_accumulator_t *self, zygos_block_t *block, uint32_t end)
{
    const uint32_t last = self->width - 1u;
    const double *s = &block->gram[zygos_gram_entries(last)];
    for (uint32_t i = self->store.row; i < end; i++) {
        centre_row(&block->gram[zygos_gram_entries(i)], block->sum, self->mean, s, s[last], i);
    }
}

bool zygos_accumulator_eliminated(zygos_accumulator_t *self, zygos_block_t *block)
{
    const uint32_t last = self->width - 1u;
    double *s = &block->gram[zygos_gram_entries(last)];
    const double n = s[last];
    for (uint32_t i = 0; i < self->width; i++) {
        s[i] -= n * self->mean[i];
        block->sum[last] += s[i];
    }
    return (self->means_checksum == checksum_of_means(self)) && is_twice(block->variance) &&
           (zygos_gram_scanned(&self->store.scan, block->gram, self->width, block->sum, block->head.total) <= 1.0);
}

/* ---------------------------------------------------------------- rows */

/* Adds to one row of the matrix of two blocks, by their weights, the products of the rows in a buffer and, where noise
   is declared, what is subtracted for it. Two entries at a time, of eight instants each. Inlined, because with a branch
   in the loop it would cost half as much more. */
__attribute__((always_inline)) static inline void add_matrix_row(zygos_row_buffer_t *restrict buffer,
                                                                 zygos_block_t *restrict falling,
                                                                 zygos_block_t *restrict rising, uint32_t i, bool noisy)
{
    const double *x = &buffer->pair[i / 2u][0][i % 2u];
    const double x0 = x[0];
    const double x1 = x[2];
    const double x2 = x[4];
    const double x3 = x[6];
    const double x4 = x[8];
    const double x5 = x[10];
    const double x6 = x[12];
    const double x7 = x[14];
    const double early = buffer->early;
    const double late = buffer->late;
    const double *t = buffer->total;
    const double *z = buffer->pair[0][0];
    double *noise = &buffer->gram[zygos_gram_entries(i)];
    double *older = &falling->gram[zygos_gram_entries(i)];
    double *newer = &rising->gram[zygos_gram_entries(i)];
    for (const double *end = older + (i + 1u) / 2u * 2u; older != end; older += 2) {
        double left = x0 * z[0] + x1 * z[2] + x2 * z[4] + x3 * z[6] + x4 * z[8] + x5 * z[10] + x6 * z[12] + x7 * z[14];
        double right = x0 * z[1] + x1 * z[3] + x2 * z[5] + x3 * z[7] + x4 * z[9] + x5 * z[11] + x6 * z[13] + x7 * z[15];
        if (noisy) {
            left += noise[0];
            right += noise[1];
            noise[0] = 0.0;
            noise[1] = 0.0;
            noise += 2;
        }
        older[0] += early * left;
        older[1] += early * right;
        newer[0] += late * left;
        newer[1] += late * right;
        newer += 2;
        z += 2u * ZYGOS_BUFFER_ROWS;
    }
    double last = x0 * x0 + x1 * x1 + x2 * x2 + x3 * x3 + x4 * x4 + x5 * x5 + x6 * x6 + x7 * x7;
    double sum = x0 * t[0] + x1 * t[1] + x2 * t[2] + x3 * t[3] + x4 * t[4] + x5 * t[5] + x6 * t[6] + x7 * t[7];
    if (noisy) {
        sum += buffer->sum[i];
        buffer->sum[i] = 0.0;
    }
    if (i % 2u == 0) {
        if (noisy) {
            last += noise[0];
            noise[0] = 0.0;
        }
        older[0] += early * last;
        newer[0] += late * last;
    }
    falling->sum[i] += early * sum;
    rising->sum[i] += late * sum;
}

/* Adds the next slices of a buffer to its blocks. A slice ends with that row of the matrix which is the nearest to its
   share of all entries. */
static void add_slices(zygos_accumulator_t *self, zygos_row_buffer_t *buffer, uint32_t slices)
{
    zygos_block_t *falling = energy_block(self, zygos_store_first_of(buffer->blocks));
    zygos_block_t *rising = energy_block(self, zygos_store_second_of(buffer->blocks));
    buffer->shared += slices;
    const uint32_t most = zygos_gram_entries(self->width) * buffer->shared;
    uint32_t row = buffer->row;
    for (; (row < self->width) && (ZYGOS_BUFFER_SLICES / 2u * (row + 1u) * (row + 1u) <= most); row++) {
        if (self->noisy != 0) {
            add_matrix_row(buffer, falling, rising, row, true);
        } else {
            add_matrix_row(buffer, falling, rising, row, false);
        }
    }
    buffer->row = row;
}

/* The buffers behind the one that is filled, the older one first. */
static zygos_row_buffer_t *buffer_behind(zygos_accumulator_t *self, uint32_t step)
{
    const uint32_t b = self->filling + step;
    return &self->buffer[(b < ZYGOS_ROW_BUFFERS) ? b : b - ZYGOS_ROW_BUFFERS];
}

static uint32_t left_of(const zygos_row_buffer_t *buffer)
{
    return ZYGOS_BUFFER_SLICES - buffer->shared;
}

/* The next slices of the buffers that wait, two of one that waits alone. Returns the number of buffers. */
static uint32_t share_slices(zygos_accumulator_t *self, uint32_t of_two)
{
    zygos_row_buffer_t *older = buffer_behind(self, 1u);
    zygos_row_buffer_t *newer = buffer_behind(self, 2u);
    const uint32_t waiting = (left_of(older) > 0 ? 1u : 0u) + (left_of(newer) > 0 ? 1u : 0u);
    const uint32_t slices = (waiting > 1u) ? of_two : 2u;
    const uint32_t first = zygos_least(left_of(older), slices);
    const uint32_t rest = slices - first;
    add_slices(self, older, first);
    add_slices(self, newer, zygos_least(left_of(newer), rest));
    return waiting;
}

bool zygos_accumulator_share_slices(zygos_accumulator_t *self)
{
    return share_slices(self, 2u) > 0;
}

void zygos_accumulator_share_out(zygos_accumulator_t *self)
{
    for (uint32_t step = 1; step < ZYGOS_ROW_BUFFERS; step++) {
        add_slices(self, buffer_behind(self, step), left_of(buffer_behind(self, step)));
    }
}

/* Opens the next segment. Where few blocks are ready it goes on. */
static void next_segment(zygos_accumulator_t *self)
{
    if ((self->store.count > self->store.fresh) && (self->store.ready < ZYGOS_SPARE_BLOCKS)) {
        return;
    }
    zygos_store_open_block(&self->store, KIND);
    self->segment = 0.0;
    self->length = self->store.target;
}

/* Of an arc that ends before its buffer is full. */
static void leave_empty(zygos_row_buffer_t *buffer, uint32_t instant, uint32_t width)
{
    for (uint32_t i = 0; i < (width + 1u) / 2u; i++) {
        buffer->pair[i][instant][0] = 0.0;
        buffer->pair[i][instant][1] = 0.0;
    }
    buffer->total[instant] = 0.0;
}

/* The buffer that is filled is added to the two newest blocks from here on; the next one is empty, and is filled. */
static void next_buffer(zygos_accumulator_t *self)
{
    zygos_row_buffer_t *buffer = &self->buffer[self->filling];
    for (uint32_t r = self->filled; r < ZYGOS_BUFFER_ROWS; r++) {
        leave_empty(buffer, r, self->width);
    }
    const uint32_t older = self->store.order[self->store.count - 2u];
    const uint32_t newer = self->store.order[self->store.count - 1u];
    zygos_block_t *falling = energy_block(self, older);
    zygos_block_t *rising = energy_block(self, newer);
    const double n = buffer->instants;
    const double reached = (self->segment + 0.5 * n) / self->length;
    const double late = (reached < 1.0) ? reached : 1.0;
    const double early = 1.0 - late;
    falling->head.total += n * early;
    falling->square += n * early * early;
    falling->overlap += n * early * late;
    rising->head.total += n * late;
    rising->square += n * late * late;
    const double falls = early * buffer->variance;
    const double rises = late * buffer->variance;
    falling->variance[0] += falls;
    falling->variance[1] += falls;
    rising->variance[0] += rises;
    rising->variance[1] += rises;
    buffer->variance = 0.0;
    self->segment += n;
    buffer->early = early;
    buffer->late = late;
    buffer->blocks = ZYGOS_PAIR(older, newer);
    buffer->shared = 0;
    buffer->row = 0;
    buffer->parity = self->store.parity;
    buffer->instants = 0.0;
    self->filling = (self->filling + 1u) % ZYGOS_ROW_BUFFERS;
    self->filled = 0;
    add_slices(self, &self->buffer[self->filling], left_of(&self->buffer[self->filling])); /* none, as a rule */
    self->twin = zygos_accumulator_twin(self);
}

/* The rows in the buffer that is filled, if there are any. */
static void hand_rows_over(zygos_accumulator_t *self)
{
    if ((self->filled > 0) && (self->store.count > self->store.fresh)) {
        next_buffer(self);
    }
}

void zygos_accumulator_flush(zygos_accumulator_t *self)
{
    zygos_accumulator_share_out(self);
    hand_rows_over(self);
    zygos_accumulator_share_out(self);
}

/* Puts z = w [row, W, 1] of an instant into a buffer. */
static void put_row(zygos_row_buffer_t *buffer, uint32_t instant, const zygos_row_t *row, uint32_t p, double weight)
{
    double total = weight + weight * row->work;
    for (uint32_t i = 0; i < p / 2u; i++) {
        double *z = buffer->pair[i][instant];
        z[0] = weight * row->column[2u * i];
        z[1] = weight * row->column[2u * i + 1u];
        total += z[0] + z[1];
    }
    if (p % 2u != 0) {
        const double last = weight * row->column[p - 1u];
        buffer->pair[p / 2u][instant][0] = last;
        total += last;
    }
    buffer->pair[p / 2u][instant][p % 2u] = weight * row->work;
    buffer->pair[(p + 1u) / 2u][instant][(p + 1u) % 2u] = weight;
    buffer->total[instant] = total;
}

bool zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight)
{
    const uint32_t p = self->width - 2u;
    bool opens = (self->store.count == self->store.fresh);
    if (opens) {
        next_segment(self);
    }
    zygos_row_buffer_t *buffer = &self->buffer[self->filling];
    put_row(buffer, self->filled, row, p, weight);
    buffer->instants += weight;
    buffer->variance += row->variance; /* the work of a refused instant is in those behind it */
    self->filled++;
    /* Two buffers wait where an arc has ended. Three slices in a cycle are enough: the older buffer is the next one
       that is filled, and the newer one has been shared out before that one is full. */
    const bool two = (share_slices(self, 3u) > 1u);
    if (self->filled >= ZYGOS_BUFFER_ROWS) {
        if (self->segment >= self->length) {
            next_segment(self);
            opens = true;
        }
        next_buffer(self);
    }
    const uint32_t one = (uint32_t)(weight > 0.0);
    self->store.arc_instants += one;
    self->refused += 1u - one;
    return opens || (two && (self->width > ZYGOS_WIDE));
}

/* ---------------------------------------------------------------- for the store */

void zygos_accumulator_end_rows(zygos_accumulator_t *self)
{
    hand_rows_over(self);
    self->segment = 0.0;
}

void zygos_accumulator_drop_rows(zygos_accumulator_t *self, uint32_t parity, bool has_rows)
{
    const bool open = (parity == self->store.parity);
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        zygos_row_buffer_t *buffer = &self->buffer[b];
        const bool fills = open && (b == self->filling);
        const bool waits = (buffer->shared < ZYGOS_BUFFER_SLICES) && (buffer->parity == parity);
        buffer->variance = fills ? 0.0 : buffer->variance; /* which instants add to that have no rows */
        if (has_rows && (waits || fills)) {
            clear_buffer(self, buffer, self->noisy != 0);
        }
    }
    if (open) {
        self->segment = 0.0;
        self->filled = 0;
    }
}

bool zygos_accumulator_steady(const zygos_accumulator_t *self)
{
    uint32_t parities = 0;
    bool good = (self->filling < ZYGOS_ROW_BUFFERS) && (self->filled < (uint32_t)ZYGOS_BUFFER_ROWS) &&
                (self->twin == zygos_accumulator_twin(self));
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        good = good && (self->buffer[b].shared <= (uint32_t)ZYGOS_BUFFER_SLICES);
        parities |= self->buffer[b].parity;
    }
    return good && (parities <= 1u);
}

/* Without blocks there is no segment. */
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters)
{
    const bool is_open = (self->store.count > self->store.fresh);
    return (parameters <= (uint32_t)ZYGOS_MAX_PARAMETERS) && (self->width == parameters + 2u) &&
           zygos_store_intact(&self->store, KIND, true) && zygos_accumulator_steady(self) &&
           zygos_is_count(self->segment) && (is_open || !(self->segment > 0.0)) &&
           (!is_open || ((self->length >= 1.0) && zygos_is_count(self->length)));
}

bool zygos_accumulator_is_open_whole(const zygos_accumulator_t *self)
{
    bool whole = zygos_accumulator_steady(self) && zygos_is_count(self->segment);
    for (uint32_t r = self->store.fresh; whole && (r < self->store.count); r++) {
        whole = is_twice(zygos_accumulator_at(self, r)->variance);
    }
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        whole = whole && zygos_is_count(self->buffer[b].instants) && (self->buffer[b].variance >= 0.0);
    }
    return whole;
}
