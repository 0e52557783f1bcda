#include "zygos/accumulator.h"

#include "zygos/gram.h"

#include <string.h>

/* Initial number of segments of the longest arc: many, but none shorter than a second unless the arc would have only a
   few. The error by the noise of rates at the ends of a block decreases with the time in which its weight changes. */
#define SEGMENTS 48u
#define SEGMENT_S 1.0
#define FEWEST 4u
#define MOST 1024u /* largest initial length of a segment in instants */
#define MIN_BUFFERS 3u
#define MERGED_BLOCKS (3u * ZYGOS_MAX_BLOCKS / 4u) /* largest number of blocks after merging */

_Static_assert((ZYGOS_MIN_BLOCKS + 2u <= ZYGOS_MAX_BLOCKS) && (MERGED_BLOCKS + 2u <= ZYGOS_MAX_BLOCKS),
               "an arc that begins needs two blocks");

/* What rounding may make of a sum of so many weights, relative to it. A flipped bit that changes less does no harm. */
static double rounded(double instants)
{
    return 1e-9 + 2.220446049250313e-16 * instants;
}

/* What the checksum protects. */
#define WORDS 8u

static void gather(const zygos_accumulator_t *self, uint64_t *word)
{
    memcpy(&word[0], &self->enough, sizeof word[0]);
    memcpy(&word[1], &self->target, sizeof word[1]);
    word[2] = self->width;
    word[3] = self->count;
    word[4] = self->open;
    word[5] = self->newest;
    word[6] = self->window;
    word[7] = self->arcs;
}

static uint64_t checksum_of(const zygos_accumulator_t *self)
{
    uint64_t word[WORDS];
    uint64_t checksum = 0;
    gather(self, word);
    for (uint32_t i = 0; i < WORDS; i++) {
        checksum = zygos_checksum_number(checksum, word[i]);
    }
    return checksum;
}

static void reseal(zygos_accumulator_t *self)
{
    self->checksum = checksum_of(self);
    self->twin = ZYGOS_ACCUMULATOR_TWIN(self);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_accumulator_t *self)
{
    uint64_t word[WORDS];
    gather(self, word);
    if (!zygos_checksum_repair(word, WORDS, self->checksum)) {
        return false;
    }
    memcpy(&self->enough, &word[0], sizeof word[0]);
    memcpy(&self->target, &word[1], sizeof word[1]);
    self->width = (uint32_t)word[2];
    self->count = (uint32_t)word[3];
    self->open = (uint32_t)word[4];
    self->newest = (uint32_t)word[5];
    self->window = (uint32_t)word[6];
    self->arcs = (uint32_t)word[7];
    reseal(self);
    return true;
}

/* Verifies the checksum, before anything that it protects is changed. What cannot be repaired must not lead outside. */
static void judge(zygos_accumulator_t *self)
{
    if ((self->checksum == checksum_of(self)) || repair(self)) {
        return;
    }
    self->corrupt = 1;
    self->newest = (self->newest <= self->open) ? self->newest : 0u;
    self->window = (self->window <= self->open) ? self->window : self->open;
    self->newest = (self->newest <= self->window) ? self->newest : self->window;
}

static uint64_t checksum_of_block(const zygos_block_t *block, uint32_t width)
{
    const double weights[3] = { block->instants, block->square, block->overlap };
    return zygos_checksum_number(
        zygos_checksum_doubles(zygos_checksum_doubles(1u, block->deviation, width), weights, 3), block->end);
}

/* Of a block of closed arcs. */
static bool is_whole(const zygos_block_t *block, uint32_t width)
{
    return block->checksum == checksum_of_block(block, width);
}

/* Of a block of closed arcs that has changed; what was wrong before remains wrong. */
static void seal(zygos_block_t *block, uint32_t width, bool whole)
{
    const uint64_t checksum = checksum_of_block(block, width);
    block->checksum = whole ? checksum : ~checksum;
}

void zygos_accumulator_init(zygos_accumulator_t *self, uint32_t parameters, uint64_t arc_cycles, double period_s)
{
    const uint64_t most = arc_cycles / FEWEST;
    const uint64_t slow = (uint64_t)(SEGMENT_S / period_s);
    const uint64_t least = (slow < most) ? slow : most;
    const uint64_t many = (arc_cycles / SEGMENTS < MOST) ? arc_cycles / SEGMENTS : MOST;
    const uint64_t steps = ((many > least) ? many : least) / ZYGOS_BUFFER_ROWS;
    memset(self, 0, sizeof *self);
    self->width = parameters + 2u;
    self->target = (double)(ZYGOS_BUFFER_ROWS * ((steps > MIN_BUFFERS) ? steps : MIN_BUFFERS));
    self->enough = 0.5 * (double)arc_cycles;
    reseal(self);
}

static void add_share(zygos_noise_sums_t *to, const zygos_noise_sums_t *from, double factor, uint32_t width)
{
    const uint32_t size = zygos_gram_entries(width);
    for (uint32_t k = 0; k < size; k++) {
        to->gram[k] += factor * from->gram[k];
    }
    for (uint32_t i = 0; i < width; i++) {
        to->sum[i] += factor * from->sum[i];
    }
}

static void clear_share(zygos_noise_sums_t *share, uint32_t width)
{
    memset(share->gram, 0, zygos_gram_entries(width) * sizeof share->gram[0]);
    memset(share->sum, 0, width * sizeof share->sum[0]);
}

static void add_block(zygos_block_t *to, const zygos_block_t *from, uint32_t width)
{
    const bool closed = (to->checksum != 0);
    const bool whole = closed && is_whole(to, width) && is_whole(from, width);
    const uint32_t size = zygos_gram_entries(width);
    for (uint32_t k = 0; k < size; k++) {
        to->gram[k] += from->gram[k];
    }
    for (uint32_t i = 0; i < width; i++) {
        to->sum[i] += from->sum[i];
        to->deviation[i] += from->deviation[i];
    }
    to->instants += from->instants;
    to->square += from->square + 2.0 * to->overlap;
    to->overlap = from->overlap;
    to->end = from->end;
    if (closed) {
        seal(to, width, whole);
    }
}

/* Merges neighbours in [first, end) that fit into one block, as long as blocks are to spare, and puts the results at
   to, to + 1, ... Returns the place behind them. */
static uint32_t merge(zygos_accumulator_t *self, uint32_t first, uint32_t end, uint32_t to, uint32_t *spare)
{
    const uint32_t begin = to;
    const double most = self->target;
    for (uint32_t from = first; from < end; from++) {
        if ((to > begin) && (*spare > 0) && (self->block[to - 1u].instants + self->block[from].instants <= most)) {
            (*spare)--;
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

/* Blocks of closed arcs never merge with those of the open one, whose constant is still in them; nor do those of the
   newest closed arc with older ones, from which it may differ; nor does the newest block, whose weight has yet to
   decrease.
   The target doubles only when merging up to it is not enough; once it holds all instants there are, each group is one
   block: the loop ends. */
static void free_blocks(zygos_accumulator_t *self)
{
    for (uint32_t tries = 0; tries < 64u; tries++) {
        const uint32_t fading = (self->count > self->open) ? 1u : 0u;
        uint32_t spare = (self->count > ZYGOS_MIN_BLOCKS) ? self->count - ZYGOS_MIN_BLOCKS : 0u;
        const uint32_t newest = merge(self, 0, self->newest, 0, &spare);
        const uint32_t window = merge(self, self->newest, self->window, newest, &spare);
        const uint32_t open = merge(self, self->window, self->open, window, &spare);
        const uint32_t rest = merge(self, self->open, self->count - fading, open, &spare);
        if ((fading != 0) && (rest != self->count - 1u)) {
            self->block[rest] = self->block[self->count - 1u];
        }
        self->newest = newest;
        self->window = window;
        self->open = open;
        self->count = rest + fading;
        if (self->count <= ((MERGED_BLOCKS > ZYGOS_MIN_BLOCKS) ? MERGED_BLOCKS : ZYGOS_MIN_BLOCKS)) {
            return;
        }
        self->target *= 2.0;
    }
}

static void append_block(zygos_accumulator_t *self)
{
    zygos_block_t *block = &self->block[self->count];
    memset(block->gram, 0, zygos_gram_entries(self->width) * sizeof block->gram[0]);
    memset(block->sum, 0, self->width * sizeof block->sum[0]);
    memset(block->deviation, 0, self->width * sizeof block->deviation[0]);
    block->instants = 0.0;
    block->square = 0.0;
    block->overlap = 0.0;
    block->end = 0;
    block->checksum = 0;
    self->count++;
}

/* Moves the noise of a segment to that of its arc, and takes it off the two blocks that share the segment; two entries
   at a time, the last of which may lie beyond, where all is 0. */
static void take_off(double *restrict noise, double *restrict open, double *restrict falling, double *restrict rising,
                     double late, uint32_t count)
{
    const double early = 1.0 - late;
    for (const double *end = noise + count; noise < end; noise += 2) {
        falling[0] -= early * noise[0];
        falling[1] -= early * noise[1];
        rising[0] -= late * noise[0];
        rising[1] -= late * noise[1];
        open[0] += noise[0];
        open[1] += noise[1];
        noise[0] = 0.0;
        noise[1] = 0.0;
        falling += 2;
        rising += 2;
        open += 2;
    }
}

/* Takes the noise of the open segment off its two blocks, as they share its instants. */
static void end_segment(zygos_accumulator_t *self)
{
    if (!(self->segment > 0.0)) {
        return;
    }
    const uint32_t width = self->width - 1u;
    zygos_block_t *falling = &self->block[self->count - 2u];
    zygos_block_t *rising = &self->block[self->count - 1u];
    const double late = rising->instants / self->segment;
    take_off(self->noise.gram, self->noise_open.gram, falling->gram, rising->gram, late, zygos_gram_entries(width));
    take_off(self->noise.sum, self->noise_open.sum, falling->sum, rising->sum, late, width);
    self->segment = 0.0;
}

static void next_segment(zygos_accumulator_t *self)
{
    judge(self);
    bool first = (self->count == self->open);
    end_segment(self);
    if (self->count + 2u > ZYGOS_MAX_BLOCKS) {
        free_blocks(self);
    }
    if (self->count + 2u > ZYGOS_MAX_BLOCKS) { /* a changed target or number of instants */
        self->corrupt = 1;
        self->count = 0;
        self->open = 0;
        self->newest = 0;
        self->window = 0;
        first = true;
    }
    append_block(self);
    if (first) {
        append_block(self);
    }
    reseal(self);
}

/* Of so many entries, those of a slice: an even number. The last slice reaches beyond the entries, where all is 0. */
static uint32_t slice_of(uint32_t entries)
{
    return 2u * ((entries + 2u * ZYGOS_BUFFER_ROWS - 1u) / (2u * ZYGOS_BUFFER_ROWS));
}

/* Moves an even number of entries of a buffer to its two blocks, by their weights. */
static void move(double *restrict buffer, double *restrict falling, double *restrict rising, double early, double late,
                 uint32_t count)
{
    for (const double *end = buffer + count; buffer != end; buffer += 2) {
        falling[0] += early * buffer[0];
        falling[1] += early * buffer[1];
        rising[0] += late * buffer[0];
        rising[1] += late * buffer[1];
        buffer[0] = 0.0;
        buffer[1] = 0.0;
        falling += 2;
        rising += 2;
    }
}

/* Adds the next slices of the older buffer to the blocks. */
static void add_slices(zygos_accumulator_t *self, uint32_t slices)
{
    zygos_row_buffer_t *buffer = &self->buffer[1u - self->filling];
    zygos_block_t *falling = &self->block[self->count - 2u];
    zygos_block_t *rising = &self->block[self->count - 1u];
    const uint32_t entries = slice_of(zygos_gram_entries(self->width));
    const uint32_t sums = slice_of(self->width);
    const uint32_t entry = self->shared * entries;
    const uint32_t row = self->shared * sums;
    move(&buffer->gram[entry], &falling->gram[entry], &rising->gram[entry], self->early, self->late, slices * entries);
    move(&buffer->sum[row], &falling->sum[row], &rising->sum[row], self->early, self->late, slices * sums);
    self->shared += slices;
}

/* When the buffer is full (1, else 0), its slices are added from here on; the other one is empty, and is filled.
   Factors are used instead of a branch, so that all cycles cost the same. */
static void next_buffer(zygos_accumulator_t *self, uint32_t full)
{
    if (full * self->segment >= self->target) {
        next_segment(self);
    }
    zygos_row_buffer_t *buffer = &self->buffer[self->filling];
    zygos_block_t *falling = &self->block[self->count - 2u];
    zygos_block_t *rising = &self->block[self->count - 1u];
    const double n = full * buffer->instants;
    const double reached = (self->segment + 0.5 * n) / self->target;
    const double end[2] = { 1.0, reached };
    const double late = end[reached < 1.0];
    const double share[2][2] = { { self->early, self->late }, { 1.0 - late, late } };
    const double early = share[1][0];
    falling->instants += n * early;
    falling->square += n * early * early;
    falling->overlap += n * early * late;
    rising->instants += n * late;
    rising->square += n * late * late;
    self->segment += n;
    self->early = share[full][0];
    self->late = share[full][1];
    buffer->instants -= n;
    self->filling ^= full;
    self->filled *= 1u - full;
    self->shared *= 1u - full;
}

void zygos_accumulator_flush(zygos_accumulator_t *self)
{
    for (uint32_t round = 0; (round < 2u) && (self->count > self->open); round++) {
        add_slices(self, ZYGOS_BUFFER_ROWS - self->shared);
        if ((round == 0) && (self->filled > 0)) {
            next_buffer(self, 1u);
        }
    }
}

void zygos_accumulator_add(zygos_accumulator_t *self, const zygos_row_t *row, double weight)
{
    const uint32_t width = self->width;
    const uint32_t p = width - 2u;
    if (self->count == self->open) {
        next_segment(self);
    }
    zygos_row_buffer_t *buffer = &self->buffer[self->filling];
    double z[ZYGOS_MAX_ROW];
    for (uint32_t i = 0; i < p / 2u; i++) { /* two at a time, and the last where p is odd */
        z[2u * i] = weight * row->column[2u * i];
        z[2u * i + 1u] = weight * row->column[2u * i + 1u];
    }
    z[p - 1u] = weight * row->column[p - 1u];
    z[p] = weight * row->work;
    z[p + 1u] = weight;
    zygos_gram_add(buffer->gram, buffer->sum, width, z);
    buffer->instants += weight;
    self->filled++;
    add_slices(self, 1u);
    next_buffer(self, self->filled / ZYGOS_BUFFER_ROWS);
    const uint32_t one = (uint32_t)(weight > 0.0);
    self->arc_instants += one;
    self->accepted += one;
    self->refused += 1u - one;
}

/* G - s m^T - m s^T + n m m^T, entry by entry; s is the last row of G, which changes last and each entry by itself. */
static void centre(zygos_block_t *block, uint32_t width, const double *mean)
{
    const double *s = &block->gram[(width - 1u) * width / 2u];
    const double n = s[width - 1u];
    for (uint32_t i = 0; i < width; i++) {
        block->deviation[i] = s[i] - n * mean[i];
    }
    uint32_t k = 0;
    for (uint32_t i = 0; i < width; i++) {
        const double si = s[i];
        for (uint32_t j = 0; j <= i; j++) {
            block->gram[k] += n * mean[i] * mean[j] - si * mean[j] - mean[i] * s[j];
            k++;
        }
    }
    zygos_gram_row_sums(block->gram, width, block->sum);
}

/* Whether a block of the open arc has as many instants as its sums count, and of these the weights that its segments
   gave it: those of an instant add up to 1, so w = w^2 + what w shares with the block before and the one behind. */
static bool weighs_what_it_should(const zygos_block_t *block, uint32_t width, double before)
{
    const double off = block->gram[zygos_gram_entries(width) - 1u] - block->instants;
    const double shared = block->instants - block->square - block->overlap - before;
    const double few = rounded(block->instants) * (1.0 + block->instants);
    return (block->checksum == 0) && (off >= -few) && (off <= few) && (shared >= -few) && (shared <= few);
}

static void forget_open_arc(zygos_accumulator_t *self)
{
    clear_share(&self->noise, self->width - 1u);
    clear_share(&self->noise_open, self->width - 1u);
    for (uint32_t k = 0; k < 2u; k++) {
        memset(self->buffer[k].gram, 0, zygos_gram_entries(self->width) * sizeof self->buffer[k].gram[0]);
        memset(self->buffer[k].sum, 0, self->width * sizeof self->buffer[k].sum[0]);
        self->buffer[k].instants = 0.0;
    }
    self->arc_instants = 0;
    self->segment = 0.0;
    self->filled = 0;
    self->shared = 0;
    self->early = 0.0;
    self->late = 0.0;
}

void zygos_accumulator_leave_out(zygos_accumulator_t *self)
{
    judge(self);
    self->accepted -= self->arc_instants;
    self->count = self->open;
    reseal(self);
    forget_open_arc(self);
}

static void drop_open_arc(zygos_accumulator_t *self)
{
    self->arcs_dropped += (self->count > self->open) ? 1u : 0u;
    zygos_accumulator_leave_out(self);
}

static double closed_instants(const zygos_accumulator_t *self)
{
    double total = 0.0;
    for (uint32_t b = 0; b < self->open; b++) {
        total += self->block[b].instants;
    }
    return total;
}

void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle)
{
    drop_open_arc(self);
    const double before = closed_instants(self);
    while ((self->open > 0) && (self->block[self->open - 1u].end > cycle)) {
        const zygos_block_t *last = &self->block[self->open - 1u];
        const bool first_of_arc = (self->open == 1) || (self->block[self->open - 2u].end != last->end);
        self->arcs -= first_of_arc ? 1u : 0u;
        self->arcs_dropped += first_of_arc ? 1u : 0u;
        self->open--;
    }
    self->count = self->open;
    if (self->open > 0) {
        zygos_block_t *last = &self->block[self->open - 1u];
        const bool whole = is_whole(last, self->width);
        last->overlap = 0.0; /* the block behind is gone, or another arc's */
        seal(last, self->width, whole);
    }
    self->newest = (self->newest < self->open) ? self->newest : self->open;
    self->window = (self->window < self->open) ? self->window : self->open;
    reseal(self);
    const double kept = closed_instants(self);
    if (kept < before) {
        self->accepted = (uint64_t)((double)self->accepted * kept / before + 0.5);
        add_share(&self->noise_closed, &self->noise_closed, kept / before - 1.0, self->width - 1u);
    }
}

uint32_t zygos_accumulator_drop_until(zygos_accumulator_t *self, uint64_t cycle)
{
    judge(self);
    const double before = closed_instants(self);
    uint32_t drop = 0;
    uint32_t dropped = 0;
    while ((drop < self->open) && (self->block[drop].end <= cycle)) {
        const bool last_of_arc = (drop + 1u == self->open) || (self->block[drop + 1u].end != self->block[drop].end);
        dropped += last_of_arc ? 1u : 0u;
        drop++;
    }
    for (uint32_t b = drop; (drop > 0) && (b < self->count); b++) {
        self->block[b - drop] = self->block[b];
    }
    self->count -= drop;
    self->open -= drop;
    self->newest -= (self->newest < drop) ? self->newest : drop;
    self->window -= (self->window < drop) ? self->window : drop;
    self->arcs -= (dropped < self->arcs) ? dropped : self->arcs;
    const double kept = closed_instants(self);
    if (kept < before) {
        const uint64_t closed = self->accepted - self->arc_instants;
        self->accepted = self->arc_instants + (uint64_t)((double)closed * kept / before + 0.5);
        add_share(&self->noise_closed, &self->noise_closed, kept / before - 1.0, self->width - 1u);
    }
    reseal(self);
    return dropped;
}

void zygos_accumulator_forget(zygos_accumulator_t *self, double factor)
{
    const uint32_t size = zygos_gram_entries(self->width);
    double left = 0.0;
    for (uint32_t b = 0; b < self->open; b++) {
        zygos_block_t *block = &self->block[b];
        const bool whole = is_whole(block, self->width);
        const double kept = (factor * block->instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        for (uint32_t k = 0; k < size; k++) {
            block->gram[k] *= kept;
        }
        for (uint32_t i = 0; i < self->width; i++) {
            block->sum[i] *= kept;
            block->deviation[i] *= kept;
        }
        block->instants *= kept;
        block->square *= kept;
        block->overlap *= kept;
        seal(block, self->width, whole);
        left += block->instants;
    }
    add_share(&self->noise_closed, &self->noise_closed, ((left > 0.0) ? factor : 0.0) - 1.0, self->width - 1u);
}

bool zygos_accumulator_close(zygos_accumulator_t *self)
{
    const uint32_t width = self->width;
    if (self->arc_instants < ZYGOS_MIN_ARC_INSTANTS) {
        drop_open_arc(self);
        return false;
    }
    judge(self);
    zygos_accumulator_flush(self);
    bool whole = (zygos_gram_check(self->noise.gram, width - 1u, self->noise.sum, self->segment) <= 1.0);
    end_segment(self);
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
    /* The last column counts instants as well. */
    const double counted = mean[width - 1u];
    const double few = rounded((double)self->arc_instants);
    whole = whole && (counted > 1.0 - few) && (counted < 1.0 + few);
    double before = 0.0; /* what a block shares with the one before it */
    for (uint32_t b = self->open; b < self->count; b++) {
        whole = whole && weighs_what_it_should(&self->block[b], width, before);
        before = self->block[b].overlap;
        /* Centring cancels: the row sums are judged before, and taken anew after. */
        whole =
            whole && (zygos_gram_check(self->block[b].gram, width, self->block[b].sum, self->block[b].instants) <= 1.0);
        centre(&self->block[b], width, mean);
    }
    if (!whole) {
        self->quarantined++;
        drop_open_arc(self);
    }
    return whole;
}

void zygos_accumulator_admit(zygos_accumulator_t *self, uint64_t cycle)
{
    for (uint32_t b = self->open; b < self->count; b++) {
        self->block[b].end = cycle;
        self->block[b].checksum = checksum_of_block(&self->block[b], self->width);
    }
    add_share(&self->noise_closed, &self->noise_open, 1.0, self->width - 1u);
    if ((double)self->arc_instants >= self->enough) {
        self->window = self->open; /* it speaks without the short ones before it */
    }
    self->open = self->count;
    double instants = 0.0;
    for (uint32_t b = self->window; b < self->open; b++) {
        instants += self->block[b].instants;
    }
    if (instants >= self->enough) {
        self->newest = self->window;
        self->window = self->open;
    }
    self->arcs++;
    reseal(self);
    forget_open_arc(self);
}

void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle)
{
    if (zygos_accumulator_close(self)) {
        zygos_accumulator_admit(self, cycle);
    }
}

static bool is_count(double instants)
{
    return (instants >= 0.0) && (instants <= ZYGOS_MAX_INSTANTS);
}

/* An open arc has two blocks at least, and without blocks there is no segment. Instants and target decide whether
   blocks merge, and so whether blocks are free. */
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters)
{
    const bool is_open = (self->count > self->open);
    bool good = (parameters <= (uint32_t)ZYGOS_MAX_PARAMETERS) && (self->width == parameters + 2u) &&
                (self->count <= (uint32_t)ZYGOS_MAX_BLOCKS) && (self->open <= self->count) &&
                (self->count != self->open + 1u) && (self->window <= self->open) && (self->newest <= self->window) &&
                (self->filling <= 1u) && (self->filled < (uint32_t)ZYGOS_BUFFER_ROWS) &&
                (self->shared < (uint32_t)ZYGOS_BUFFER_ROWS) && is_count(self->segment) &&
                (is_open || !(self->segment > 0.0)) && is_count(self->buffer[0].instants) &&
                is_count(self->buffer[1].instants) && (self->target >= 1.0) && is_count(self->target);
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = is_count(self->block[b].instants);
    }
    return good;
}

/* Whether the sums of the open arc match; of a block that is added to, and of what has yet to be added. */
static bool is_open_arc_whole(const zygos_accumulator_t *self)
{
    const uint32_t width = self->width;
    bool whole = (self->filling <= 1u) && (self->filled < (uint32_t)ZYGOS_BUFFER_ROWS) &&
                 (self->shared < (uint32_t)ZYGOS_BUFFER_ROWS) && is_count(self->segment);
    for (uint32_t b = self->open; b < self->count; b++) {
        whole = whole && (self->block[b].checksum == 0) && is_count(self->block[b].instants);
    }
    const double adds = (double)self->accepted;
    whole = whole && (zygos_gram_check(self->noise.gram, width - 1u, self->noise.sum, adds) <= 1.0) &&
            (zygos_gram_check(self->noise_open.gram, width - 1u, self->noise_open.sum, adds) <= 1.0);
    return whole;
}

static bool is_block_whole(const zygos_block_t *block, uint32_t width)
{
    return is_whole(block, width) && is_count(block->instants) &&
           (zygos_gram_check(block->gram, width, block->sum, block->instants) <= 1.0);
}

static void quarantine(zygos_accumulator_t *self)
{
    bool previous = false; /* whether the block before was kept */
    uint32_t to = 0;
    uint32_t newest = 0;
    uint32_t window = 0;
    double before = 0.0;
    double after = 0.0;
    for (uint32_t b = 0; b < self->open; b++) {
        const bool kept = is_block_whole(&self->block[b], self->width);
        before += kept || is_count(self->block[b].instants) ? self->block[b].instants : 0.0;
        after += kept ? self->block[b].instants : 0.0;
        if (!kept && previous) { /* the block that it shared with is gone */
            self->block[to - 1u].overlap = 0.0;
            seal(&self->block[to - 1u], self->width, true);
        }
        if (kept && (to != b)) {
            self->block[to] = self->block[b];
        }
        to += kept ? 1u : 0u;
        newest += (kept && (b < self->newest)) ? 1u : 0u;
        window += (kept && (b < self->window)) ? 1u : 0u;
        previous = kept;
    }
    if (to == self->open) {
        return;
    }
    self->quarantined += self->open - to;
    self->newest = newest;
    self->window = window;
    self->count = to;
    self->open = to;
    self->accepted = (uint64_t)after;
    reseal(self);
    add_share(&self->noise_closed, &self->noise_closed, ((before > 0.0) ? after / before : 0.0) - 1.0,
              self->width - 1u);
}

bool zygos_accumulator_scrub(zygos_accumulator_t *self, uint32_t parameters)
{
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->width != parameters + 2u) || (self->count > (uint32_t)ZYGOS_MAX_BLOCKS) || (self->open > self->count) ||
        (self->window > self->open) || (self->newest > self->window) || !(self->target >= 1.0) ||
        !(zygos_gram_check(self->noise_closed.gram, self->width - 1u, self->noise_closed.sum, (double)self->accepted) <=
          1.0)) {
        return false;
    }
    self->corrupt = 0;
    self->twin = ZYGOS_ACCUMULATOR_TWIN(self);
    bool whole = true;
    for (uint32_t b = 0; b < self->open; b++) {
        whole = whole && is_block_whole(&self->block[b], self->width);
    }
    if (!is_open_arc_whole(self) || !whole) {
        self->quarantined += is_open_arc_whole(self) ? 0u : 1u;
        self->filling &= 1u;
        drop_open_arc(self);
    }
    if (!whole) {
        quarantine(self);
    }
    return true;
}

void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram)
{
    const uint32_t size = zygos_gram_entries(self->width);
    memset(gram, 0, size * sizeof gram[0]);
    for (uint32_t b = 0; b < self->open; b++) {
        for (uint32_t k = 0; k < size; k++) {
            gram[k] += self->block[b].gram[k];
        }
    }
}

double zygos_accumulator_check(const zygos_accumulator_t *self)
{
    double worst = ((self->corrupt != 0) || (self->checksum != checksum_of(self))) ? 2.0 : 0.0;
    const zygos_noise_sums_t *shares[3] = { &self->noise, &self->noise_open, &self->noise_closed };
    for (uint32_t s = 0; s < 3; s++) {
        const double here = zygos_gram_check(shares[s]->gram, self->width - 1u, shares[s]->sum, (double)self->accepted);
        worst = (here > worst) ? here : worst;
    }
    for (uint32_t b = 0; b < self->count; b++) {
        const double here =
            zygos_gram_check(self->block[b].gram, self->width, self->block[b].sum, self->block[b].instants);
        worst = (here > worst) ? here : worst;
        const bool good = (b < self->open) ? is_whole(&self->block[b], self->width) : (self->block[b].checksum == 0);
        worst = good ? worst : 2.0;
    }
    return worst;
}
