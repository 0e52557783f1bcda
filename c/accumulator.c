#include "zygos/priv/accumulator.h"

#include <string.h>

/* Initial number of segments of the longest arc: many, but none shorter than a second unless the arc would have only a
   few. The error by the noise of rates at the ends of a block decreases with the time in which its weight changes. */
#define SEGMENTS 48u
#define SEGMENT_S 1.0
#define FEWEST 4u
#define MOST 1024u /* largest initial length of a segment in instants */
#define MIN_BUFFERS 3u
/* The newest blocks of the open arc that may still be added to: two of the open segment, and one of the segment before,
   whose last rows may wait in a buffer. */
#define IN_USE 3u
/* Up to this width what follows the last row that is verified costs little beside the rest of a cycle, and is no part
   of its own. */
#define NARROW 16u
/* Additions to the noise in an instant: each sensor by itself, and the rounding is alike as long as the arm rests. */
#define NOISE_ADDS 8.0

_Static_assert(ZYGOS_MIN_BLOCKS + 2u + ZYGOS_SPARE_BLOCKS <= ZYGOS_MAX_BLOCKS,
               "an arc that begins needs two blocks while another one is closing");
_Static_assert(ZYGOS_MAX_BLOCKS <= 128, "places are numbers of eight bits");
_Static_assert(ZYGOS_BUFFER_ROWS == 8, "add_matrix_row() has eight products");

/* What rounding may make of a sum of so many weights, relative to it. A flipped bit that changes less does no harm. */
static double rounded(double instants)
{
    return 1e-9 + 2.220446049250313e-16 * instants;
}

/* What the checksum protects. */
#define MEMBERS 11u
#define ORDER_WORDS (ZYGOS_ORDER_PLACES / 8u)
#define WORDS (MEMBERS + ORDER_WORDS)

/* The compiler's own memcpy() is a few loads, also where a freestanding build has no other than that of a library. */
static void gather(const zygos_accumulator_t *self, uint64_t *word)
{
    __builtin_memcpy(&word[0], &self->enough, sizeof word[0]);
    __builtin_memcpy(&word[1], &self->target, sizeof word[1]);
    word[2] = self->width;
    word[3] = self->count;
    word[4] = self->closed;
    word[5] = self->fresh;
    word[6] = self->newest;
    word[7] = self->window;
    word[8] = self->ready;
    word[9] = self->arcs;
    __builtin_memcpy(&word[10], &self->noise_fade, sizeof word[10]);
    for (uint32_t i = 0; i < ORDER_WORDS; i++) {
        __builtin_memcpy(&word[MEMBERS + i], &self->order[8u * i], sizeof word[0]);
    }
}

static uint64_t checksum_of(const zygos_accumulator_t *self)
{
    uint64_t word[WORDS];
    gather(self, word);
    return zygos_checksum_words(0, word, WORDS);
}

static void reseal(zygos_accumulator_t *self)
{
    self->checksum = checksum_of(self);
    self->twin = zygos_accumulator_twin(self);
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
    self->closed = (uint32_t)word[4];
    self->fresh = (uint32_t)word[5];
    self->newest = (uint32_t)word[6];
    self->window = (uint32_t)word[7];
    self->ready = (uint32_t)word[8];
    self->arcs = (uint32_t)word[9];
    memcpy(&self->noise_fade, &word[10], sizeof word[10]);
    memcpy(self->order, &word[MEMBERS], sizeof self->order);
    reseal(self);
    return true;
}

/* Whether the members that tell which blocks there are lead nowhere else. */
static bool are_places_possible(const zygos_accumulator_t *self)
{
    bool good = (self->count <= (uint32_t)ZYGOS_MAX_BLOCKS) && (self->fresh <= self->count) &&
                (self->closed <= self->fresh) && (self->count != self->fresh + 1u) &&
                (self->fresh != self->closed + 1u) && (self->window <= self->closed) &&
                (self->newest <= self->window) && (self->ready <= (uint32_t)ZYGOS_MAX_BLOCKS - self->count);
    for (uint32_t r = 0; r < (uint32_t)ZYGOS_MAX_BLOCKS; r++) {
        good = good && (self->order[r] < (uint32_t)ZYGOS_MAX_BLOCKS);
    }
    return good;
}

/* No block is in use. What they contain is not known: none is ready. */
static void forget_places(zygos_accumulator_t *self)
{
    self->count = 0;
    self->closed = 0;
    self->fresh = 0;
    self->newest = 0;
    self->window = 0;
    self->ready = 0;
    self->task = ZYGOS_TASK_NONE;
    self->closing_instants = 0;
    for (uint32_t r = 0; r < (uint32_t)ZYGOS_MAX_BLOCKS; r++) {
        self->order[r] = (uint8_t)r;
    }
}

/* Verifies the checksum, before anything that it protects is changed. What cannot be repaired must not lead outside. */
static void judge(zygos_accumulator_t *self)
{
    if ((self->checksum == checksum_of(self)) || repair(self)) {
        return;
    }
    self->corrupt = 1;
    if (!are_places_possible(self)) {
        forget_places(self);
    }
}

/* The block at a place, which was verified: by the checksum or by the twin. */
static zygos_block_t *at(zygos_accumulator_t *self, uint32_t place)
{
    return &self->block[(place < (uint32_t)ZYGOS_MAX_BLOCKS) ? place : 0u];
}

static uint32_t first_of(uint32_t places)
{
    return places & 255u;
}

static uint32_t second_of(uint32_t places)
{
    return places >> 8u;
}

zygos_block_t *zygos_accumulator_block(zygos_accumulator_t *self, uint32_t rank)
{
    return at(self, self->order[rank]);
}

const zygos_block_t *zygos_accumulator_at(const zygos_accumulator_t *self, uint32_t rank)
{
    const uint32_t place = self->order[rank];
    return &self->block[(place < (uint32_t)ZYGOS_MAX_BLOCKS) ? place : 0u];
}

static double fade_of(const zygos_block_t *block)
{
    return (block->checksum != 0) ? block->fade : 1.0;
}

double zygos_accumulator_instants(const zygos_accumulator_t *self, uint32_t rank)
{
    const zygos_block_t *block = zygos_accumulator_at(self, rank);
    return fade_of(block) * block->instants;
}

static const double *last_row(const double *gram, uint32_t width)
{
    return &gram[zygos_gram_entries(width - 1u)];
}

const double *zygos_accumulator_deviation(const zygos_accumulator_t *self, const zygos_block_t *block)
{
    return last_row(block->gram, self->width);
}

static uint64_t checksum_of_block(const zygos_block_t *block, uint32_t width)
{
    const double weights[6] = { block->instants, block->square,      block->overlap,
                                block->fade,     block->variance[0], block->variance[1] };
    return zygos_checksum_number(
        zygos_checksum_doubles(zygos_checksum_doubles(1u, last_row(block->gram, width), width), weights, 6),
        block->end);
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
    const uint32_t noisy = self->noisy;
    memset(self, 0, sizeof *self);
    self->noisy = noisy;
    self->width = parameters + 2u;
    self->target = (double)(ZYGOS_BUFFER_ROWS * ((steps > MIN_BUFFERS) ? steps : MIN_BUFFERS));
    self->enough = 0.5 * (double)arc_cycles;
    self->ready = ZYGOS_MAX_BLOCKS;
    self->noise_fade = 1.0;
    for (uint32_t r = 0; r < (uint32_t)ZYGOS_MAX_BLOCKS; r++) {
        self->order[r] = (uint8_t)r;
    }
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        self->buffer[b].shared = ZYGOS_BUFFER_SLICES;
        self->buffer[b].row = self->width;
    }
    reseal(self);
}

static void clear_noise(zygos_noise_sums_t *noise, uint32_t width)
{
    const uint32_t rows = width - 1u;
    memset(noise->gram, 0, zygos_gram_entries(rows) * sizeof noise->gram[0]);
    memset(noise->sum, 0, rows * sizeof noise->sum[0]);
}

static void clear_buffer(zygos_accumulator_t *self, zygos_row_buffer_t *buffer)
{
    memset(buffer->gram, 0, zygos_gram_entries(self->width) * sizeof buffer->gram[0]);
    memset(buffer->sum, 0, self->width * sizeof buffer->sum[0]);
    buffer->instants = 0.0;
    buffer->variance = 0.0;
    buffer->shared = ZYGOS_BUFFER_SLICES;
    buffer->row = self->width;
}

/* ---------------------------------------------------------------- which blocks there are */

/* Takes the blocks of the ranks from first to before end out of the order; they are free, and have to be cleared. */
static void free_ranks(zygos_accumulator_t *self, uint32_t first, uint32_t end)
{
    for (uint32_t n = first; n < end; n++) {
        const uint8_t place = self->order[first];
        for (uint32_t r = first; r + 1u < self->count; r++) {
            self->order[r] = self->order[r + 1u];
        }
        self->order[self->count - 1u] = place;
        self->count--;
    }
}

/* The rank of a place among those from first to before end, or end. */
static uint32_t rank_of(const zygos_accumulator_t *self, uint32_t place, uint32_t first, uint32_t end)
{
    uint32_t r = first;
    while ((r < end) && (self->order[r] != place)) {
        r++;
    }
    return r;
}

/* A free block that is cleared becomes the newest. */
static void append_block(zygos_accumulator_t *self)
{
    const uint32_t from = (uint32_t)ZYGOS_MAX_BLOCKS - self->ready;
    const uint8_t place = self->order[from];
    self->order[from] = self->order[self->count];
    self->order[self->count] = place;
    self->count++;
    self->ready--;
}

/* ---------------------------------------------------------------- tasks */

/* How many entries a part of a task has. To eliminate the constant costs less than to verify; what follows the last row
   that is verified takes a cycle of its own. */
static uint32_t entries_of_part(const zygos_accumulator_t *self)
{
    const uint32_t size = zygos_gram_entries(self->width);
    /* An entry that is verified costs more than one whose constant is eliminated. */
    const uint32_t more = (self->task == ZYGOS_TASK_VERIFY) ? 2u : ((self->task == ZYGOS_TASK_CENTRE) ? 0u : 1u);
    const uint32_t cycles = ZYGOS_PASS_CYCLES - 1u + more;
    const uint32_t part = (size + cycles - 1u) / cycles;
    return (part > ZYGOS_LEAST_PART) ? part : ZYGOS_LEAST_PART;
}

uint32_t zygos_accumulator_part(const zygos_accumulator_t *self)
{
    const uint32_t most = entries_of_part(self);
    uint32_t end = self->row;
    for (uint32_t n = 0; (end < self->width) && (n < most); end++) {
        n += end + 1u;
    }
    return end;
}

static void begin_task(zygos_accumulator_t *self, uint32_t task, uint32_t places)
{
    self->task = task;
    self->places = places;
    self->row = 0;
    self->twin = zygos_accumulator_twin(self);
}

/* Whether the rows from first to before end of the task are all of its rows; then it has ended. */
static bool task_ends(zygos_accumulator_t *self, uint32_t end)
{
    self->row = end;
    return end >= self->width;
}

/* All but the sums of products. */
static void clear_rest(zygos_block_t *block, uint32_t width)
{
    memset(block->sum, 0, width * sizeof block->sum[0]);
    block->instants = 0.0;
    block->square = 0.0;
    block->overlap = 0.0;
    memset(block->variance, 0, sizeof block->variance);
    block->fade = 1.0;
    block->end = 0;
    block->checksum = 0;
}

static void clear_block(zygos_block_t *block, uint32_t width)
{
    memset(block->gram, 0, zygos_gram_entries(width) * sizeof block->gram[0]);
    clear_rest(block, width);
}

static void proceed_clear(zygos_accumulator_t *self)
{
    const uint32_t end = zygos_accumulator_part(self);
    const uint32_t first = zygos_gram_entries(self->row);
    zygos_block_t *block = at(self, first_of(self->places));
    memset(&block->gram[first], 0, (zygos_gram_entries(end) - first) * sizeof block->gram[0]);
    if (!task_ends(self, end)) {
        return;
    }
    clear_rest(block, self->width);
    judge(self);
    const uint32_t last = (uint32_t)ZYGOS_MAX_BLOCKS - self->ready;
    const uint32_t rank = rank_of(self, first_of(self->places), self->count, last);
    if (rank < last) {
        self->order[rank] = self->order[last - 1u];
        self->order[last - 1u] = (uint8_t)first_of(self->places);
        self->ready++;
    }
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

/* The last row and what follows it is a part of its own: the checksums are of that. */
static void proceed_merge(zygos_accumulator_t *self)
{
    zygos_block_t *to = at(self, first_of(self->places));
    const zygos_block_t *from = at(self, second_of(self->places));
    const double own = fade_of(to);
    const double other = fade_of(from);
    const uint32_t last = zygos_gram_entries(self->width - 1u);
    if (self->row < self->width) {
        const uint32_t end = zygos_accumulator_part(self);
        for (uint32_t k = zygos_gram_entries(self->row); (k < zygos_gram_entries(end)) && (k < last); k++) {
            to->gram[k] = own * to->gram[k] + other * from->gram[k];
        }
        self->row = end;
        return;
    }
    judge(self);
    const bool closed = (to->checksum != 0);
    const bool whole = closed && is_whole(to, self->width) && is_whole(from, self->width);
    for (uint32_t i = 0; i < self->width; i++) {
        to->gram[last + i] = own * to->gram[last + i] + other * from->gram[last + i];
        to->sum[i] = own * to->sum[i] + other * from->sum[i];
    }
    to->square = own * (to->square + 2.0 * to->overlap) + other * from->square;
    to->instants = own * to->instants + other * from->instants;
    to->overlap = other * from->overlap;
    for (uint32_t k = 0; k < 2u; k++) { /* in proportion to the instants that are left, like its deviations */
        to->variance[k] = own * to->variance[k] + other * from->variance[k];
    }
    to->end = from->end;
    to->fade = 1.0;
    if (closed) {
        seal(to, self->width, whole);
    }
    const uint32_t rank = rank_of(self, second_of(self->places), 0, self->count);
    if (rank < self->count) {
        free_ranks(self, rank, rank + 1u);
        self->newest -= (rank < self->newest) ? 1u : 0u;
        self->window -= (rank < self->window) ? 1u : 0u;
        self->closed -= (rank < self->closed) ? 1u : 0u;
        self->fresh -= (rank < self->fresh) ? 1u : 0u;
        self->rank -= (rank < self->rank) ? 1u : 0u;
    }
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

/* The first pair of neighbours that fits into one block, by the rank of its first, or count. Blocks of closed arcs
   never merge with those of the closing or the open one, whose constant is still in them; nor do those of the newest
   closed arc with older ones, from which it may differ; nor do blocks that may still be added to. Where none fits the
   target doubles, and the next call finds the pair: the blocks are looked through once a cycle. */
static uint32_t pair_to_merge(zygos_accumulator_t *self)
{
    const uint32_t used = (self->count < self->fresh + IN_USE) ? self->fresh : self->count - IN_USE;
    const uint32_t region[5] = { 0, self->newest, self->window, self->closed, self->fresh };
    const uint32_t end[5] = { self->newest, self->window, self->closed, self->closed, used };
    double least = 2.0 * ZYGOS_MAX_INSTANTS;
    uint32_t fits = self->count;
    for (uint32_t g = 0; g < 5u; g++) {
        for (uint32_t r = region[g]; r + 1u < end[g]; r++) {
            const double both = zygos_accumulator_instants(self, r) + zygos_accumulator_instants(self, r + 1u);
            least = (both < least) ? both : least;
            fits = ((both <= self->target) && (fits == self->count)) ? r : fits;
        }
    }
    if (self->count <= ZYGOS_MIN_BLOCKS) {
        return self->count;
    }
    for (uint32_t tries = 0; (least <= ZYGOS_MAX_INSTANTS) && (self->target < least) && (tries < 64u); tries++) {
        self->target *= 2.0;
    }
    return fits;
}

/* Whether all rows of the closing arc are in its blocks. */
static bool is_shared_out(const zygos_accumulator_t *self)
{
    uint32_t waiting = 0; /* counted without branches: the cost is the same whichever buffer waits */
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        waiting += (uint32_t)(self->buffer[b].parity != self->parity) *
                   (uint32_t)(self->buffer[b].shared < ZYGOS_BUFFER_SLICES);
    }
    return waiting == 0;
}

/* Of what all blocks of the closing arc are centred with, for as long as that takes. */
static uint32_t checksum_of_means(const zygos_accumulator_t *self)
{
    const uint64_t means = zygos_checksum_doubles(2u, self->mean, self->width);
    const uint64_t sum = zygos_checksum_number(zygos_checksum_number(means, self->closing_end), self->closing_instants);
    return (uint32_t)(sum ^ (sum >> 32u));
}

static void take_means(zygos_accumulator_t *self)
{
    const uint32_t last = zygos_gram_entries(self->width - 1u);
    memset(self->mean, 0, sizeof self->mean);
    for (uint32_t r = self->closed; r < self->fresh; r++) {
        const double *s = &zygos_accumulator_at(self, r)->gram[last];
        for (uint32_t i = 0; i < self->width; i++) {
            self->mean[i] += s[i];
        }
    }
    for (uint32_t i = 0; i < self->width; i++) {
        self->mean[i] /= (double)self->closing_instants;
    }
    /* The last column counts instants as well. */
    const double counted = self->mean[self->width - 1u];
    const double few = rounded((double)self->closing_instants);
    self->whole = ((counted > 1.0 - few) && (counted < 1.0 + few)) ? 1u : 0u;
    self->overlap = 0.0;
    self->means_checksum = checksum_of_means(self);
}

/* The next part of the closing arc, of which nothing is left when it does not match. */
static void begin_closing_task(zygos_accumulator_t *self)
{
    if (self->closing_instants == 0) { /* the arc was too short */
        self->admitted = 0;
        begin_task(self, ZYGOS_TASK_ADMIT, 0);
        return;
    }
    if (self->rank == self->closed) {
        take_means(self);
    }
    if (self->whole == 0) {
        self->admitted = 0;
        self->quarantined++;
        self->arcs_dropped++;
        begin_task(self, ZYGOS_TASK_ADMIT, 0);
    } else {
        memset(&self->scan, 0, sizeof self->scan);
        begin_task(self, ZYGOS_TASK_VERIFY, (self->rank < self->fresh) ? self->order[self->rank] : 0u);
    }
}

static void begin_next_task(zygos_accumulator_t *self)
{
    const uint32_t unused = (uint32_t)ZYGOS_MAX_BLOCKS - self->count;
    const bool closing = (self->fresh > self->closed) && is_shared_out(self);
    const bool lacking = (unused < ZYGOS_SPARE_BLOCKS);
    const bool dirty = (unused > self->ready);
    if (!closing && !lacking && !dirty) {
        return;
    }
    judge(self);
    if (dirty && ((self->ready < ZYGOS_SPARE_BLOCKS) || !(closing || lacking))) {
        begin_task(self, ZYGOS_TASK_CLEAR, self->order[(uint32_t)ZYGOS_MAX_BLOCKS - self->ready - 1u]);
        return;
    }
    if (lacking) {
        const double target = self->target;
        const uint32_t rank = pair_to_merge(self);
        if (self->target > target) {
            self->checksum = checksum_of(self);
            return;
        }
        if (rank < self->count) {
            begin_task(self, ZYGOS_TASK_MERGE,
                       ZYGOS_PLACES((uint32_t)self->order[rank], (uint32_t)self->order[rank + 1u]));
            return;
        }
    }
    if (closing) {
        begin_closing_task(self);
    }
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
    const double off = block->gram[zygos_gram_entries(width) - 1u] - block->instants;
    const double shared = block->instants - block->square - block->overlap - before;
    const double few = rounded(block->instants) * (1.0 + block->instants);
    return (block->checksum == 0) && (off >= -few) && (off <= few) && (shared >= -few) && (shared <= few) &&
           is_twice(block->variance);
}

/* Behind the last block of the closing arc: its noise. */
static void proceed_verify_noise(zygos_accumulator_t *self)
{
    const zygos_noise_sums_t *noise = &self->noise_open[self->parity ^ 1u];
    const uint32_t rows = self->width - 1u;
    if (self->noisy == 0) {
        begin_task(self, ZYGOS_TASK_JUDGE, 0);
        return;
    }
    const uint32_t end = zygos_accumulator_part(self);
    zygos_gram_scan(&self->scan, noise->gram, self->row, (end < rows) ? end : rows);
    if (!task_ends(self, end)) {
        return;
    }
    if (zygos_gram_scanned(&self->scan, noise->gram, rows, noise->sum, NOISE_ADDS * (double)self->closing_instants) >
        1.0) {
        self->whole = 0;
        begin_task(self, ZYGOS_TASK_NONE, 0);
    } else {
        begin_task(self, ZYGOS_TASK_JUDGE, 0);
    }
}

static void proceed_verify(zygos_accumulator_t *self)
{
    if (self->rank >= self->fresh) {
        proceed_verify_noise(self);
        return;
    }
    zygos_block_t *block = at(self, first_of(self->places));
    if (self->row < self->width) {
        const uint32_t end = zygos_accumulator_part(self);
        zygos_gram_scan(&self->scan, block->gram, self->row, end);
        if (!task_ends(self, end) || (self->width > NARROW)) {
            return;
        }
    }
    const bool whole = weighs_what_it_should(block, self->width, self->overlap) &&
                       (zygos_gram_scanned(&self->scan, block->gram, self->width, block->sum, block->instants) <= 1.0);
    self->whole &= whole ? 1u : 0u;
    self->overlap = block->overlap;
    const double *s = last_row(block->gram, self->width);
    const double *mean = self->mean;
    const double n = s[self->width - 1u];
    double all = 0.0;
    double means = 0.0;
    double size = 0.0;
    double size_of_means = 0.0;
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
        self->scan.sum[i] += n * mean[i] * means - s[i] * means - mean[i] * all;
        self->scan.most[i] += (__builtin_fabs(s[i]) + n * far) * size_of_means + far * size;
        block->sum[i] = 0.0;
    }
    self->scan.sum[self->width - 1u] = all - n * means; /* of the deviations */
    begin_task(self, ZYGOS_TASK_CENTRE, self->places);
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

static void proceed_centre(zygos_accumulator_t *self)
{
    const uint32_t end = zygos_accumulator_part(self);
    zygos_block_t *block = at(self, first_of(self->places));
    const uint32_t last = self->width - 1u;
    double *s = &block->gram[zygos_gram_entries(last)];
    for (uint32_t i = self->row; (i < end) && (i < last); i++) {
        centre_row(&block->gram[zygos_gram_entries(i)], block->sum, self->mean, s, s[last], i);
    }
    if (task_ends(self, end)) {
        const double n = s[last];
        for (uint32_t i = 0; i < self->width; i++) {
            s[i] -= n * self->mean[i];
            block->sum[last] += s[i];
        }
        block->end = self->closing_end;
        block->fade = 1.0;
        const bool whole =
            (self->means_checksum == checksum_of_means(self)) && is_twice(block->variance) &&
            (zygos_gram_scanned(&self->scan, block->gram, self->width, block->sum, block->instants) <= 1.0);
        self->whole &= whole ? 1u : 0u;
        seal(block, self->width, self->whole != 0);
        begin_task(self, ZYGOS_TASK_JUDGE, self->places);
    }
}

void zygos_accumulator_judged_block(zygos_accumulator_t *self)
{
    self->rank++;
    begin_task(self, ZYGOS_TASK_NONE, 0);
}

void zygos_accumulator_judged_arc(zygos_accumulator_t *self, bool admitted)
{
    self->admitted = admitted ? 1u : 0u;
    begin_task(self, ZYGOS_TASK_ADMIT, 0);
}

static void admit(zygos_accumulator_t *self)
{
    if ((double)self->closing_instants >= self->enough) {
        self->window = self->closed; /* it speaks without the short ones before it */
    }
    self->closed = self->fresh;
    double instants = 0.0;
    for (uint32_t r = self->window; r < self->closed; r++) {
        instants += zygos_accumulator_instants(self, r);
    }
    if (instants >= self->enough) {
        self->newest = self->window;
        self->window = self->closed;
    }
    self->arcs++;
}

static void leave_out(zygos_accumulator_t *self)
{
    self->accepted -= self->closing_instants;
    free_ranks(self, self->closed, self->fresh);
    self->fresh = self->closed;
}

/* What follows the last row is a part of its own. */
static void proceed_admit(zygos_accumulator_t *self)
{
    zygos_noise_sums_t *open = &self->noise_open[self->parity ^ 1u];
    const bool admitted = (self->admitted != 0);
    const double factor = 1.0 / self->noise_fade;
    const uint32_t rows = self->width - 1u;
    if ((self->noisy != 0) && (self->row < self->width)) {
        const uint32_t end = zygos_accumulator_part(self);
        const uint32_t last = (end < rows) ? end : rows;
        for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(last); k++) {
            self->noise_closed.gram[k] += admitted ? factor * open->gram[k] : 0.0; /* it may be no number */
            open->gram[k] = 0.0;
        }
        self->row = end;
        return;
    }
    for (uint32_t i = 0; i < rows; i++) {
        self->noise_closed.sum[i] += admitted ? factor * open->sum[i] : 0.0;
        open->sum[i] = 0.0;
    }
    judge(self);
    if (admitted) {
        admit(self);
    } else {
        leave_out(self);
    }
    self->closing_instants = 0;
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

void zygos_accumulator_proceed(zygos_accumulator_t *self)
{
    switch (self->task) {
    case ZYGOS_TASK_CLEAR:
        proceed_clear(self);
        break;
    case ZYGOS_TASK_MERGE:
        proceed_merge(self);
        break;
    case ZYGOS_TASK_VERIFY:
        proceed_verify(self);
        break;
    case ZYGOS_TASK_CENTRE:
        proceed_centre(self);
        break;
    case ZYGOS_TASK_ADMIT:
        proceed_admit(self);
        break;
    case ZYGOS_TASK_JUDGE:
        break;
    default:
        begin_next_task(self);
        break;
    }
}

/* Finishes a task of that kind, each part of which has one row at least. */
static void finish(zygos_accumulator_t *self, uint32_t task)
{
    const uint32_t most = self->width + 1u;
    for (uint32_t tries = 0; (tries < most) && (self->task == task); tries++) {
        zygos_accumulator_proceed(self);
    }
}

/* Finishes a task that concerns free or closed blocks only. */
static void finish_upkeep(zygos_accumulator_t *self)
{
    finish(self, ZYGOS_TASK_CLEAR);
    finish(self, ZYGOS_TASK_MERGE);
}

bool zygos_accumulator_closing(const zygos_accumulator_t *self)
{
    return self->fresh > self->closed;
}

bool zygos_accumulator_rests(const zygos_accumulator_t *self)
{
    return (self->closing_instants == 0) && (self->task != (uint32_t)ZYGOS_TASK_MERGE);
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
    zygos_block_t *falling = at(self, first_of(buffer->places));
    zygos_block_t *rising = at(self, second_of(buffer->places));
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
static zygos_row_buffer_t *behind(zygos_accumulator_t *self, uint32_t step)
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
    zygos_row_buffer_t *older = behind(self, 1u);
    zygos_row_buffer_t *newer = behind(self, 2u);
    const uint32_t waiting = (left_of(older) > 0 ? 1u : 0u) + (left_of(newer) > 0 ? 1u : 0u);
    const uint32_t slices = (waiting > 1u) ? of_two : 2u;
    const uint32_t first = (left_of(older) < slices) ? left_of(older) : slices;
    const uint32_t rest = slices - first;
    add_slices(self, older, first);
    add_slices(self, newer, (left_of(newer) < rest) ? left_of(newer) : rest);
    return waiting;
}

bool zygos_accumulator_share_slices(zygos_accumulator_t *self)
{
    return share_slices(self, 2u) > 0;
}

void zygos_accumulator_share_out(zygos_accumulator_t *self)
{
    for (uint32_t step = 1; step < ZYGOS_ROW_BUFFERS; step++) {
        add_slices(self, behind(self, step), left_of(behind(self, step)));
    }
}

/* Makes so many blocks ready at once, where the tasks had no time to: after arcs of a few instants. */
static void make_ready(zygos_accumulator_t *self, uint32_t needed)
{
    for (uint32_t tries = 0; (self->ready < needed) && (tries < 4u * (uint32_t)ZYGOS_MAX_BLOCKS); tries++) {
        if ((self->task == ZYGOS_TASK_CLEAR) || (self->task == ZYGOS_TASK_MERGE)) {
            finish_upkeep(self); /* which may make a block ready */
        } else if (self->count + self->ready < (uint32_t)ZYGOS_MAX_BLOCKS) {
            clear_block(at(self, self->order[(uint32_t)ZYGOS_MAX_BLOCKS - self->ready - 1u]), self->width);
            self->ready++;
        } else if (self->task == ZYGOS_TASK_NONE) {
            begin_next_task(self);
        }
    }
}

/* Opens the next segment; of an arc that begins with two blocks. Where few blocks are ready the segment goes on. */
static void next_segment(zygos_accumulator_t *self)
{
    if ((self->count > self->fresh) && (self->ready < ZYGOS_SPARE_BLOCKS)) {
        return;
    }
    judge(self); /* which may leave no block in use */
    const uint32_t needed = (self->count == self->fresh) ? 2u : 1u;
    make_ready(self, needed);
    if (self->ready < needed) {
        forget_places(self); /* a changed target or number of instants */
        make_ready(self, 2u);
        self->corrupt = 1;
    }
    self->segment = 0.0;
    self->length = self->target;
    append_block(self);
    if (self->count == self->fresh + 1u) {
        append_block(self);
    }
    reseal(self);
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
    const uint32_t older = self->order[self->count - 2u];
    const uint32_t newer = self->order[self->count - 1u];
    zygos_block_t *falling = at(self, older);
    zygos_block_t *rising = at(self, newer);
    const double n = buffer->instants;
    const double reached = (self->segment + 0.5 * n) / self->length;
    const double late = (reached < 1.0) ? reached : 1.0;
    const double early = 1.0 - late;
    falling->instants += n * early;
    falling->square += n * early * early;
    falling->overlap += n * early * late;
    rising->instants += n * late;
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
    buffer->places = ZYGOS_PLACES(older, newer);
    buffer->shared = 0;
    buffer->row = 0;
    buffer->parity = self->parity;
    buffer->instants = 0.0;
    self->filling = (self->filling + 1u) % ZYGOS_ROW_BUFFERS;
    self->filled = 0;
    add_slices(self, &self->buffer[self->filling], left_of(&self->buffer[self->filling])); /* none, as a rule */
    self->twin = zygos_accumulator_twin(self);
}

void zygos_accumulator_flush(zygos_accumulator_t *self)
{
    zygos_accumulator_share_out(self);
    if ((self->filled > 0) && (self->count > self->fresh)) {
        next_buffer(self);
        zygos_accumulator_share_out(self);
    }
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
    bool opens = (self->count == self->fresh);
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
    self->arc_instants += one;
    self->accepted += one;
    self->refused += 1u - one;
    return opens || (two && (self->width > ZYGOS_WIDE));
}

/* ---------------------------------------------------------------- arcs */

/* Of the open arc, or of the closing one. */
static void clear_rows(zygos_accumulator_t *self, uint32_t parity)
{
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        zygos_row_buffer_t *buffer = &self->buffer[b];
        const bool waits = (buffer->shared < ZYGOS_BUFFER_SLICES) && (buffer->parity == parity);
        if (waits || ((b == self->filling) && (parity == self->parity))) {
            clear_buffer(self, buffer);
        }
    }
    if (self->noisy != 0) {
        clear_noise(&self->noise_open[parity & 1u], self->width);
    }
}

static void drop_open_arc(zygos_accumulator_t *self, bool has_rows)
{
    judge(self);
    self->arcs_dropped += (self->count > self->fresh) ? 1u : 0u;
    if ((self->task == ZYGOS_TASK_MERGE) &&
        (rank_of(self, first_of(self->places), self->fresh, self->count) < self->count)) {
        self->task = ZYGOS_TASK_NONE;
    }
    self->accepted -= self->arc_instants;
    self->count = self->fresh;
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) { /* which instants add to that have no rows */
        if (b == self->filling) {
            self->buffer[b].variance = 0.0;
        }
    }
    if (has_rows) {
        clear_rows(self, self->parity);
    }
    self->arc_instants = 0;
    self->segment = 0.0;
    self->filled = 0;
    reseal(self);
}

static void drop_closing_arc(zygos_accumulator_t *self)
{
    clear_rows(self, self->parity ^ 1u);
    self->arcs_dropped += (self->closing_instants > 0) ? 1u : 0u;
    leave_out(self);
    self->closing_instants = 0;
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

bool zygos_accumulator_is_short(const zygos_accumulator_t *self)
{
    return self->arc_instants < ZYGOS_MIN_ARC_INSTANTS;
}

bool zygos_accumulator_close(zygos_accumulator_t *self, uint64_t cycle, uint32_t cycles)
{
    const bool brief = zygos_accumulator_is_short(self);
    if (brief && (zygos_accumulator_closing(self) || (self->count == self->fresh))) {
        drop_open_arc(self, self->arc_instants > 0); /* refused instants have added no rows */
        return false;
    }
    judge(self);
    if (brief) {
        self->accepted -= self->arc_instants;
        self->arcs_dropped++;
        self->arc_instants = 0;
    }
    if ((self->filled > 0) && (self->count > self->fresh)) {
        next_buffer(self);
    }
    self->fresh = self->count;
    self->rank = self->closed;
    self->closing_instants = self->arc_instants;
    self->closing_end = cycle;
    self->closing_cycles = cycles;
    self->parity ^= 1u;
    self->arc_instants = 0;
    self->segment = 0.0;
    reseal(self);
    return !brief;
}

bool zygos_accumulator_busy(const zygos_accumulator_t *self)
{
    return zygos_accumulator_closing(self) || (self->task != (uint32_t)ZYGOS_TASK_NONE);
}

bool zygos_accumulator_has_work(const zygos_accumulator_t *self)
{
    const uint32_t unused = (uint32_t)ZYGOS_MAX_BLOCKS - self->count;
    return zygos_accumulator_busy(self) || (unused < ZYGOS_SPARE_BLOCKS) || (unused > self->ready);
}

void zygos_accumulator_settle(zygos_accumulator_t *self)
{
    const uint32_t most = 8u * ZYGOS_PASS_CYCLES * (uint32_t)ZYGOS_MAX_BLOCKS;
    zygos_accumulator_share_out(self);
    for (uint32_t tries = 0; (tries < most) && zygos_accumulator_busy(self); tries++) {
        if (self->task != ZYGOS_TASK_JUDGE) {
            zygos_accumulator_proceed(self);
        } else if (self->rank < self->fresh) {
            zygos_accumulator_judged_block(self);
        } else {
            zygos_accumulator_judged_arc(self, true);
        }
    }
}

void zygos_accumulator_end_arc(zygos_accumulator_t *self, uint64_t cycle)
{
    zygos_accumulator_settle(self);
    (void)zygos_accumulator_close(self, cycle, self->arc_instants);
    zygos_accumulator_settle(self);
}

static double closed_instants(const zygos_accumulator_t *self)
{
    double total = 0.0;
    for (uint32_t r = 0; r < self->closed; r++) {
        total += zygos_accumulator_instants(self, r);
    }
    return total;
}

/* Takes the share of dropped blocks off the noise of closed arcs, and counts the instants that are left. */
static void reduce(zygos_accumulator_t *self, double before)
{
    const double kept = closed_instants(self);
    if (kept < before) {
        const uint64_t unclosed = (uint64_t)self->arc_instants + self->closing_instants;
        const uint64_t closed = self->accepted - unclosed;
        self->accepted = unclosed + (uint64_t)((double)closed * kept / before + 0.5);
        self->noise_fade *= kept / before;
    }
    if (!(self->noise_fade > 0.0)) {
        clear_noise(&self->noise_closed, self->width);
        self->noise_fade = 1.0;
    }
}

void zygos_accumulator_drop_after(zygos_accumulator_t *self, uint64_t cycle)
{
    finish_upkeep(self);
    finish(self, ZYGOS_TASK_ADMIT); /* a part of its noise may be in that of closed arcs */
    drop_open_arc(self, true);
    if (zygos_accumulator_closing(self)) {
        if (self->closing_end <= cycle) {
            return;
        }
        drop_closing_arc(self);
    }
    const double before = closed_instants(self);
    while ((self->closed > 0) && (zygos_accumulator_at(self, self->closed - 1u)->end > cycle)) {
        const uint64_t end = zygos_accumulator_at(self, self->closed - 1u)->end;
        const bool first_of_arc = (self->closed == 1) || (zygos_accumulator_at(self, self->closed - 2u)->end != end);
        self->arcs -= first_of_arc ? 1u : 0u;
        self->arcs_dropped += first_of_arc ? 1u : 0u;
        self->closed--;
    }
    self->count = self->closed;
    self->fresh = self->closed;
    if (self->closed > 0) {
        zygos_block_t *last = zygos_accumulator_block(self, self->closed - 1u);
        const bool whole = is_whole(last, self->width);
        last->overlap = 0.0; /* the block that it shared with is gone */
        seal(last, self->width, whole);
    }
    self->newest = (self->newest < self->closed) ? self->newest : self->closed;
    self->window = (self->window < self->closed) ? self->window : self->closed;
    reduce(self, before);
    reseal(self);
}

uint32_t zygos_accumulator_drop_until(zygos_accumulator_t *self, uint64_t cycle)
{
    finish_upkeep(self);
    judge(self);
    const double before = closed_instants(self);
    uint32_t drop = 0;
    uint32_t dropped = 0;
    while ((drop < self->closed) && (zygos_accumulator_at(self, drop)->end <= cycle)) {
        const uint64_t end = zygos_accumulator_at(self, drop)->end;
        const bool last_of_arc = (drop + 1u == self->closed) || (zygos_accumulator_at(self, drop + 1u)->end != end);
        dropped += last_of_arc ? 1u : 0u;
        drop++;
    }
    free_ranks(self, 0, drop);
    self->closed -= drop;
    self->fresh -= drop;
    self->newest -= (self->newest < drop) ? self->newest : drop;
    self->window -= (self->window < drop) ? self->window : drop;
    self->arcs -= (dropped < self->arcs) ? dropped : self->arcs;
    reduce(self, before);
    reseal(self);
    return dropped;
}

void zygos_accumulator_forget(zygos_accumulator_t *self, double factor)
{
    double left = 0.0;
    judge(self);
    for (uint32_t r = 0; r < self->closed; r++) {
        zygos_block_t *block = zygos_accumulator_block(self, r);
        const bool whole = is_whole(block, self->width);
        const double instants = factor * zygos_accumulator_instants(self, r);
        block->fade *= (instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        seal(block, self->width, whole);
        left += (instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? instants : 0.0;
    }
    self->noise_fade *= (left > 0.0) ? factor : 0.0;
    if (!(self->noise_fade > 0.0)) {
        clear_noise(&self->noise_closed, self->width);
        self->noise_fade = 1.0;
    }
    reseal(self);
}

void zygos_accumulator_apply_fade(zygos_accumulator_t *self)
{
    for (uint32_t r = 0; r < self->closed; r++) {
        zygos_block_t *block = zygos_accumulator_block(self, r);
        const double fade = block->fade;
        if (fade >= 1.0) {
            continue;
        }
        const bool whole = is_whole(block, self->width);
        for (uint32_t k = 0; k < zygos_gram_entries(self->width); k++) {
            block->gram[k] *= fade;
        }
        for (uint32_t i = 0; i < self->width; i++) {
            block->sum[i] *= fade;
        }
        block->instants *= fade;
        block->square *= fade;
        block->overlap *= fade;
        block->fade = 1.0;
        seal(block, self->width, whole);
    }
    const uint32_t rows = self->width - 1u;
    for (uint32_t k = 0; (k < zygos_gram_entries(rows)) && (self->noise_fade < 1.0); k++) {
        self->noise_closed.gram[k] *= self->noise_fade;
    }
    for (uint32_t i = 0; (i < rows) && (self->noise_fade < 1.0); i++) {
        self->noise_closed.sum[i] *= self->noise_fade;
    }
    self->noise_fade = 1.0;
    reseal(self);
}

static bool is_count(double instants)
{
    return (instants >= 0.0) && (instants <= ZYGOS_MAX_INSTANTS);
}

static bool is_factor(double fade)
{
    return (fade >= 0.0) && (fade <= 1.0);
}

bool zygos_accumulator_steady(const zygos_accumulator_t *self)
{
    uint32_t parities = self->parity;
    bool good = (self->filling < ZYGOS_ROW_BUFFERS) && (self->filled < (uint32_t)ZYGOS_BUFFER_ROWS) &&
                (self->task < (uint32_t)ZYGOS_TASKS) && (self->row <= self->width);
    for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
        good = good && (self->buffer[b].shared <= (uint32_t)ZYGOS_BUFFER_SLICES);
        parities |= self->buffer[b].parity;
    }
    return good && (parities <= 1u);
}

/* Without blocks there is no segment. Instants and target decide whether blocks merge, and so whether blocks are free.
 */
bool zygos_accumulator_intact(const zygos_accumulator_t *self, uint32_t parameters)
{
    const bool is_open = (self->count > self->fresh);
    bool good = (parameters <= (uint32_t)ZYGOS_MAX_PARAMETERS) && (self->width == parameters + 2u) &&
                are_places_possible(self) && zygos_accumulator_steady(self) &&
                (self->twin == zygos_accumulator_twin(self)) && is_count(self->segment) &&
                (is_open || !(self->segment > 0.0)) && (self->target >= 1.0) && is_count(self->target) &&
                (!is_open || ((self->length >= 1.0) && is_count(self->length))) && is_factor(self->noise_fade) &&
                (self->noise_fade > 0.0) && (self->rank >= self->closed || self->fresh == self->closed) &&
                (self->rank <= self->fresh || self->fresh == self->closed);
    for (uint32_t r = 0; good && (r < self->count); r++) {
        good = is_count(zygos_accumulator_at(self, r)->instants) && is_factor(fade_of(zygos_accumulator_at(self, r)));
    }
    return good;
}

/* Whether the sums of the open arc match; of a block that is added to, and of what has yet to be added. */
static bool is_open_arc_whole(const zygos_accumulator_t *self)
{
    const uint32_t width = self->width;
    bool whole = zygos_accumulator_steady(self) && is_count(self->segment);
    for (uint32_t r = self->fresh; r < self->count; r++) {
        const zygos_block_t *block = zygos_accumulator_at(self, r);
        whole = whole && (block->checksum == 0) && is_count(block->instants) && is_twice(block->variance) &&
                (zygos_gram_check(block->gram, width, block->sum, block->instants) <= 1.0);
    }
    const double adds = NOISE_ADDS * (double)self->accepted;
    for (uint32_t b = 0; whole && (b < ZYGOS_ROW_BUFFERS); b++) {
        whole = is_count(self->buffer[b].instants) && (self->buffer[b].variance >= 0.0);
    }
    for (uint32_t n = 0; whole && (n < 2u); n++) {
        const zygos_noise_sums_t *noise = &self->noise_open[n];
        whole = (zygos_gram_check(noise->gram, width - 1u, noise->sum, adds) <= 1.0);
    }
    return whole;
}

static bool is_block_whole(const zygos_block_t *block, uint32_t width)
{
    return is_whole(block, width) && is_count(block->instants) && is_factor(block->fade) &&
           (zygos_gram_check(block->gram, width - 1u, block->sum, block->instants) <= 1.0);
}

/* Drops the closed blocks that do not match. Needs that no other blocks are in use. */
static void quarantine(zygos_accumulator_t *self)
{
    const uint32_t was = self->closed;
    bool previous = false; /* whether the block before was kept */
    double before = 0.0;
    double after = 0.0;
    for (uint32_t r = 0; r < self->closed;) {
        zygos_block_t *block = zygos_accumulator_block(self, r);
        const double instants = zygos_accumulator_instants(self, r);
        const bool kept = is_block_whole(block, self->width);
        before += is_count(instants) ? instants : 0.0;
        after += kept ? instants : 0.0;
        if (!kept && previous) { /* the block that it shared with is gone */
            zygos_block_t *last = zygos_accumulator_block(self, r - 1u);
            last->overlap = 0.0;
            seal(last, self->width, true);
        }
        if (!kept) {
            free_ranks(self, r, r + 1u);
            self->newest -= (r < self->newest) ? 1u : 0u;
            self->window -= (r < self->window) ? 1u : 0u;
            self->closed--;
        }
        r += kept ? 1u : 0u;
        previous = kept;
    }
    self->fresh = self->closed;
    self->quarantined += was - self->closed;
    self->accepted = (uint64_t)after;
    self->noise_fade *= (before > 0.0) ? after / before : 0.0;
    if (!(self->noise_fade > 0.0)) {
        clear_noise(&self->noise_closed, self->width);
        self->noise_fade = 1.0;
    }
    reseal(self);
}

bool zygos_accumulator_scrub(zygos_accumulator_t *self, uint32_t parameters)
{
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->width != parameters + 2u) || !are_places_possible(self) || !(self->target >= 1.0) ||
        !is_factor(self->noise_fade) || !(self->noise_fade > 0.0) ||
        !(zygos_gram_check(self->noise_closed.gram, self->width - 1u, self->noise_closed.sum,
                           NOISE_ADDS * (double)self->accepted) <= 1.0)) {
        return false;
    }
    self->corrupt = 0;
    bool whole = !zygos_accumulator_closing(self) && (self->task == ZYGOS_TASK_NONE) &&
                 (self->twin == zygos_accumulator_twin(self));
    for (uint32_t r = 0; whole && (r < self->closed); r++) {
        whole = is_block_whole(zygos_accumulator_at(self, r), self->width);
    }
    const bool open = is_open_arc_whole(self);
    if (!open || !whole) {
        self->quarantined += open ? 0u : 1u;
        self->filling = (self->filling < ZYGOS_ROW_BUFFERS) ? self->filling : 0u;
        self->parity &= 1u;
        begin_task(self, ZYGOS_TASK_NONE, 0);
        for (uint32_t b = 0; b < ZYGOS_ROW_BUFFERS; b++) {
            clear_buffer(self, &self->buffer[b]);
            self->buffer[b].parity = self->parity;
            self->buffer[b].places = 0;
        }
        clear_noise(&self->noise_open[0], self->width);
        clear_noise(&self->noise_open[1], self->width);
        drop_open_arc(self, true);
        if (zygos_accumulator_closing(self)) {
            drop_closing_arc(self);
        }
        self->ready = 0; /* what is in free blocks is not known */
        reseal(self);
    }
    if (!whole) {
        quarantine(self);
    }
    self->twin = zygos_accumulator_twin(self);
    return true;
}

void zygos_accumulator_total(const zygos_accumulator_t *self, double *gram)
{
    const uint32_t size = zygos_gram_entries(self->width);
    memset(gram, 0, size * sizeof gram[0]);
    for (uint32_t r = 0; r < self->closed; r++) {
        const zygos_block_t *block = zygos_accumulator_at(self, r);
        const double fade = fade_of(block);
        for (uint32_t k = 0; k < size; k++) {
            gram[k] += fade * block->gram[k];
        }
    }
}

double zygos_accumulator_check(const zygos_accumulator_t *self)
{
    double worst = ((self->corrupt != 0) || (self->checksum != checksum_of(self))) ? 2.0 : 0.0;
    const zygos_noise_sums_t *shares[3] = { &self->noise_open[0], &self->noise_open[1], &self->noise_closed };
    for (uint32_t s = 0; s < 3; s++) {
        const double adds = NOISE_ADDS * (double)self->accepted;
        const double here = zygos_gram_check(shares[s]->gram, self->width - 1u, shares[s]->sum, adds);
        worst = (here > worst) ? here : worst;
    }
    for (uint32_t r = 0; r < self->count; r++) {
        const zygos_block_t *block = zygos_accumulator_at(self, r);
        const bool closed = (r < self->closed);
        const uint32_t rows = self->width - (closed ? 1u : 0u);
        const double here = zygos_gram_check(block->gram, rows, block->sum, block->instants);
        worst = (here > worst) ? here : worst;
        const bool good = closed ? is_whole(block, self->width) : (block->checksum == 0);
        worst = good ? worst : 2.0;
    }
    return worst;
}
