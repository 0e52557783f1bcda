/* SPDX-License-Identifier: MIT */
#include "zygos/priv/store.h"

#include "zygos/priv/accumulator.h"
#include "zygos/priv/momentumsums.h"
#include "zygos/priv/motorsums.h"
#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

_Static_assert(ZYGOS_MAX_IMPULSE + 2 <= ZYGOS_MAX_ANY_ROW, "a scan has room for each row of a motor");
_Static_assert(ZYGOS_MAX_MOMENTUM_ROW <= ZYGOS_MAX_ANY_ROW, "a scan has room for each row of the momentum");
_Static_assert(ZYGOS_MIN_ARCS < ZYGOS_MAX_MOTOR_BLOCKS, "an arc that closes needs a block");
_Static_assert((ZYGOS_MOMENTUM == 0) || (ZYGOS_MIN_ARCS < ZYGOS_MAX_MOMENTUM_BLOCKS),
               "an arc that closes needs a block");
_Static_assert(ZYGOS_MIN_BLOCKS + 2u + ZYGOS_SPARE_BLOCKS <= ZYGOS_MAX_BLOCKS,
               "an arc that begins needs two blocks while another one is closing");
_Static_assert(ZYGOS_ORDER_PLACES <= 136, "places are numbers of eight bits");
_Static_assert(offsetof(zygos_accumulator_t, store) == 0, "the store is found by the address of the sums");
_Static_assert(offsetof(zygos_motor_sums_t, store) == 0, "the store is found by the address of the sums");
_Static_assert(offsetof(zygos_momentum_sums_t, store) == 0, "the store is found by the address of the sums");

#define COUNTED 1e-9 /* counts add up exactly */
#define MOST_CONSTANTS 3u
/* The newest blocks of the open arc that may still be added to: two of the open segment, and one of the segment before,
   whose last rows may wait in a buffer. */
#define IN_USE 3u
/* ---------------------------------------------------------------- kinds of rows */

/* A matrix and its row sums. */
typedef struct {
    double *gram;
    double *sum;
    uint32_t width;
} matrix_t;

/* What a kind of rows is. Where something is, is in bytes: from the store, or in a block. */
typedef struct {
    uint32_t blocks;
    uint32_t places; /* of blocks */
    uint32_t block;  /* size of one */
    uint32_t parts;  /* matrices in a block */
    uint32_t part;
    uint32_t sum;
    uint32_t instants; /* of each part */
    uint32_t extras;   /* numbers before the head, which are under its checksum */
    uint32_t head;
    uint32_t fading;     /* how many of the extras fade */
    uint32_t noise_open; /* of the open and of the closing arc; 0: noise is not summed */
    uint32_t noise_closed;
    uint32_t noise; /* size of one */
    uint32_t noise_sum;
    double noise_adds; /* additions to it in an instant */
    /* Number of cycles in which a task reads or changes each entry of a matrix once, and the least number of entries.
     */
    uint32_t cycles_verify;
    uint32_t cycles_eliminate;
    uint32_t cycles;
    uint32_t least;
    uint32_t begins;   /* blocks with which an arc begins */
    uint32_t spare;    /* free blocks that are aimed at */
    uint32_t fewest;   /* blocks that are not merged */
    uint32_t overlaps; /* 1: an arc has several blocks, which share rows, and keep their last row as deviations */
} layout_t;

#define AT(type, member) ((uint32_t)offsetof(type, member))

static const layout_t layouts[ZYGOS_KINDS_OF_ROWS] = {
    [ZYGOS_ENERGY_ROWS] = {
        .blocks = AT(zygos_accumulator_t, block),
        .places = ZYGOS_MAX_BLOCKS,
        .block = (uint32_t)sizeof(zygos_block_t),
        .parts = 1u,
        .sum = AT(zygos_block_t, sum),
        .instants = AT(zygos_block_t, head) + AT(zygos_block_head_t, total),
        .extras = AT(zygos_block_t, square),
        .head = AT(zygos_block_t, head),
        .fading = 2u, /* of the noise of torques, what is left is in proportion to the instants */
        .noise_open = AT(zygos_accumulator_t, noise_open),
        .noise_closed = AT(zygos_accumulator_t, noise_closed),
        .noise = (uint32_t)sizeof(zygos_noise_sums_t),
        .noise_sum = AT(zygos_noise_sums_t, sum),
        .noise_adds = 8.0, /* each sensor by itself, and rounding is alike as long as the arm rests */
        .cycles_verify = ZYGOS_PASS_CYCLES + 1u, /* an entry costs more than one whose constant is eliminated */
        .cycles_eliminate = ZYGOS_PASS_CYCLES - 1u,
        .cycles = ZYGOS_PASS_CYCLES,
        .least = 48u,
        .begins = 2u,
        .spare = ZYGOS_SPARE_BLOCKS,
        .fewest = ZYGOS_MIN_BLOCKS,
        .overlaps = 1u,
    },
    [ZYGOS_MOTOR_ROWS] = {
        .blocks = AT(zygos_motor_sums_t, block),
        .places = ZYGOS_MAX_MOTOR_BLOCKS + 1u,
        .block = (uint32_t)sizeof(zygos_motor_block_t),
        .parts = ZYGOS_MAX_JOINTS,
        .part = (uint32_t)sizeof(zygos_motor_gram_t),
        .sum = AT(zygos_motor_gram_t, sum),
        .instants = AT(zygos_motor_block_t, instants),
        .extras = AT(zygos_motor_block_t, instants),
        .head = AT(zygos_motor_block_t, head),
        .fading = ZYGOS_MAX_JOINTS,
        .cycles_verify = 6u,
        .cycles_eliminate = 6u,
        .cycles = 6u,
        .least = 24u,
        .begins = 1u,
        .spare = 1u,
    },
    [ZYGOS_MOMENTUM_ROWS] = {
        .blocks = AT(zygos_momentum_sums_t, block),
        .places = ZYGOS_MOMENTUM_PLACES + 1u,
        .block = (uint32_t)sizeof(zygos_momentum_block_t),
        .parts = 1u,
        .sum = AT(zygos_momentum_gram_t, sum),
        .instants = AT(zygos_momentum_block_t, head) + AT(zygos_block_head_t, total),
        .extras = AT(zygos_momentum_block_t, head),
        .head = AT(zygos_momentum_block_t, head),
        .noise_open = AT(zygos_momentum_sums_t, noise_open),
        .noise_closed = AT(zygos_momentum_sums_t, noise_closed),
        .noise = (uint32_t)sizeof(zygos_momentum_gram_t),
        .noise_sum = AT(zygos_momentum_gram_t, sum),
        .noise_adds = 1.0,
        .cycles_verify = 6u,
        .cycles_eliminate = 6u,
        .cycles = 6u,
        .least = 24u,
        .begins = 1u,
        .spare = 1u,
    },
};

static const layout_t *layout_of(uint32_t kind)
{
    return &layouts[(kind < (uint32_t)ZYGOS_KINDS_OF_ROWS) ? kind : 0u];
}

/* The rest of a kind, which is the memory of the whole. */
static zygos_accumulator_t *energy_of(zygos_store_t *self)
{
    return (zygos_accumulator_t *)(void *)self;
}

static const zygos_motor_sums_t *motors_of(const zygos_store_t *self)
{
    return (const zygos_motor_sums_t *)(const void *)self;
}

static const zygos_momentum_sums_t *momentum_of(const zygos_store_t *self)
{
    return (const zygos_momentum_sums_t *)(const void *)self;
}

/* Who only reads uses the same functions. */
static zygos_store_t *readable(const zygos_store_t *self)
{
    return (zygos_store_t *)(uintptr_t)self;
}

static bool is_buffered(uint32_t kind)
{
    return kind == (uint32_t)ZYGOS_ENERGY_ROWS;
}

static uint32_t constants_of(const zygos_store_t *self, uint32_t kind)
{
    const uint32_t found = (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS) ? momentum_of(self)->components : 1u;
    return (found <= MOST_CONSTANTS) ? found : MOST_CONSTANTS;
}

/* The length of a row, of which there is room for, whatever memory says. */
static uint32_t width_of(const zygos_store_t *self, uint32_t kind, uint32_t part)
{
    uint32_t most = ZYGOS_MAX_ROW;
    uint32_t found = 0;
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        found = ((const zygos_accumulator_t *)(const void *)self)->width;
    } else if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        most = ZYGOS_MAX_MOTOR_ROW;
        found = motors_of(self)->column_map.count[part] + 2u;
    } else {
        most = ZYGOS_MAX_MOMENTUM_ROW;
        found = momentum_of(self)->columns + constants_of(self, kind);
    }
    return zygos_least(found, most);
}

static unsigned char *block_at(zygos_store_t *self, const layout_t *layout, uint32_t place)
{
    unsigned char *memory = (unsigned char *)(void *)self;
    return memory + layout->blocks + ((place < layout->places) ? (size_t)place * layout->block : 0u);
}

static matrix_t matrix_of(zygos_store_t *self, uint32_t kind, uint32_t place, uint32_t part)
{
    const layout_t *layout = layout_of(kind);
    unsigned char *at = block_at(self, layout, place) + (size_t)part * layout->part;
    const matrix_t out = { (double *)(void *)at, (double *)(void *)(at + layout->sum), width_of(self, kind, part) };
    return out;
}

static zygos_block_head_t *head_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    return (zygos_block_head_t *)(void *)(block_at(self, layout, place) + layout->head);
}

/* Of each part of a block. */
static double *instants_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    return (double *)(void *)(block_at(self, layout, place) + layout->instants);
}

static double *extras_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    return (double *)(void *)(block_at(self, layout, place) + layout->extras);
}

static zygos_block_t *overlapping(zygos_store_t *self, uint32_t place)
{
    return &energy_of(self)->block[(place < (uint32_t)ZYGOS_MAX_BLOCKS) ? place : 0u];
}

static uint32_t closing_noise(const zygos_store_t *self)
{
    return (self->parity & 1u) ^ 1u;
}

static bool has_noise(uint32_t kind)
{
    return layout_of(kind)->noise_open != 0;
}

static bool sums_noise(const zygos_store_t *self, uint32_t kind)
{
    return has_noise(kind) && (!is_buffered(kind) || (((const zygos_accumulator_t *)(const void *)self)->noisy != 0));
}

/* It has no constants. */
static matrix_t noise_of(zygos_store_t *self, uint32_t kind, uint32_t which)
{
    const layout_t *layout = layout_of(kind);
    unsigned char *memory = (unsigned char *)(void *)self;
    unsigned char *at =
        memory + ((which < ZYGOS_NOISE_OF_CLOSED) ? layout->noise_open + which * layout->noise : layout->noise_closed);
    const matrix_t out = { (double *)(void *)at, (double *)(void *)(at + layout->noise_sum),
                           width_of(self, kind, 0) - constants_of(self, kind) };
    return out;
}

static void copy_matrix(matrix_t from, matrix_t to)
{
    zygos_copy_words(to.gram, from.gram, zygos_gram_entries(from.width));
    zygos_copy_words(to.sum, from.sum, from.width);
}

void zygos_store_copy_block(const zygos_store_t *from, zygos_store_t *to, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    zygos_store_t *all = readable(from);
    for (uint32_t part = 0; part < layout->parts; part++) {
        copy_matrix(matrix_of(all, kind, place, part), matrix_of(to, kind, place, part));
    }
    zygos_copy_words(extras_of(to, kind, place), extras_of(all, kind, place), (layout->block - layout->extras) / 8u);
}

void zygos_store_copy_noise(const zygos_store_t *from, zygos_store_t *to, uint32_t kind, uint32_t which)
{
    if (has_noise(kind)) {
        copy_matrix(noise_of(readable(from), kind, which), noise_of(to, kind, which));
    }
}

/* ---------------------------------------------------------------- seals */

#define SEALED ((uint32_t)offsetof(zygos_store_t, checksum))
_Static_assert(SEALED % 8u == 0, "whole words");

static uint64_t store_checksum(const zygos_store_t *self)
{
    return zygos_checksum_memory(0, self, SEALED);
}

static void reseal(zygos_store_t *self)
{
    self->checksum = store_checksum(self);
    self->twin = zygos_store_twin(self);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_store_t *self)
{
    const bool repaired = zygos_checksum_repair(self, SEALED, self->checksum);
    if (repaired) {
        reseal(self);
    }
    return repaired;
}

/* Whether what tells which blocks there are leads nowhere else. */
static bool are_places_possible(const zygos_store_t *self, uint32_t kind)
{
    const uint32_t places = layout_of(kind)->places;
    bool good = (self->count <= places) && (self->fresh <= self->count) && (self->closed <= self->fresh) &&
                (self->ready <= places - self->count);
    for (uint32_t r = 0; r < places; r++) {
        good = good && (self->order[r] < places);
    }
    return good && (is_buffered(kind) ? (self->count != self->fresh + 1u) && (self->fresh != self->closed + 1u)
                                      : (self->count == self->fresh + 1u) && (self->fresh <= self->closed + 1u) &&
                                            (self->open == self->order[self->fresh]));
}

static void clear_matrix(matrix_t matrix)
{
    memset(matrix.gram, 0, zygos_gram_entries(matrix.width) * sizeof matrix.gram[0]);
    memset(matrix.sum, 0, matrix.width * sizeof matrix.sum[0]);
}

/* All but the matrices. */
static void clear_rest(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    memset(extras_of(self, kind, place), 0, layout->head - layout->extras);
    *head_of(self, kind, place) = (zygos_block_head_t){ 0.0, 1.0, 0u, 0u };
}

static void clear_block(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
        clear_matrix(matrix_of(self, kind, place, part));
    }
    clear_rest(self, kind, place);
}

/* No block is in use but that of an open arc that has one. What others contain is not known: none is ready. */
static void forget_places(zygos_store_t *self, uint32_t kind)
{
    self->count = 0;
    self->closed = 0;
    self->fresh = 0;
    self->ready = 0;
    self->open = 0;
    self->task = ZYGOS_TASK_NONE;
    self->closing_instants = 0;
    for (uint32_t r = 0; r < layout_of(kind)->places; r++) {
        self->order[r] = (uint8_t)r;
    }
    if (!is_buffered(kind)) {
        clear_block(self, kind, 0);
        self->arc_instants = 0;
        self->count = 1u;
    }
}

/* Verifies the checksum, before anything that it protects is changed. What cannot be repaired must not lead outside. */
static void verify_seal(zygos_store_t *self, uint32_t kind)
{
    if ((self->checksum == store_checksum(self)) || repair(self)) {
        return;
    }
    self->corrupt = 1;
    if (!are_places_possible(self, kind)) {
        forget_places(self, kind);
    }
}

static uint64_t checksum_of_block(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const layout_t *layout = layout_of(kind);
    const uint32_t bytes = layout->head - layout->extras + (uint32_t)offsetof(zygos_block_head_t, checksum);
    uint64_t checksum = 1u;
    if (layout->overlaps != 0) {
        const matrix_t rows = matrix_of(self, kind, place, 0);
        checksum = zygos_checksum_doubles(checksum, &rows.gram[zygos_gram_entries(rows.width - 1u)], rows.width);
    }
    return zygos_checksum_memory(checksum, extras_of(self, kind, place), bytes);
}

/* Of a block of closed arcs. */
static bool is_block_sealed(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    return head_of(self, kind, place)->checksum == checksum_of_block(self, kind, place);
}

/* Of a block of closed arcs that has changed; what was wrong before remains wrong. */
static void seal_block(zygos_store_t *self, uint32_t kind, uint32_t place, bool whole)
{
    const uint64_t checksum = checksum_of_block(self, kind, place);
    head_of(self, kind, place)->checksum = whole ? checksum : ~checksum;
}

/* ---------------------------------------------------------------- which blocks there are */

uint32_t zygos_store_place(const zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    const uint32_t places = layout_of(kind)->places;
    const uint32_t place = self->order[(rank < places) ? rank : 0u];
    return (place < places) ? place : 0u;
}

const zygos_block_head_t *zygos_store_head(const zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    return head_of(readable(self), kind, zygos_store_place(self, kind, rank));
}

static double fade_of(const zygos_block_head_t *head)
{
    return (head->checksum != 0) ? head->fade : 1.0;
}

double zygos_store_instants_of(const zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    const zygos_block_head_t *head = zygos_store_head(self, kind, rank);
    return fade_of(head) * head->total;
}

double zygos_store_instants(const zygos_store_t *self, uint32_t kind)
{
    double total = 0.0;
    for (uint32_t r = 0; r < self->closed; r++) {
        total += zygos_store_instants_of(self, kind, r);
    }
    return total;
}

uint64_t zygos_store_accepted(const zygos_store_t *self)
{
    return self->accepted + self->closing_instants + self->arc_instants;
}

/* Takes the blocks of the ranks from first to before end out of the order; they are free, and have to be cleared. */
static void free_ranks(zygos_store_t *self, uint32_t first, uint32_t end)
{
    uint32_t *const behind[4] = { &self->count, &self->closed, &self->fresh, &self->rank };
    for (uint32_t n = first; n < end; n++) {
        const uint8_t place = self->order[first];
        for (uint32_t r = first; r + 1u < self->count; r++) {
            self->order[r] = self->order[r + 1u];
        }
        self->order[self->count - 1u] = place;
        for (uint32_t k = 0; k < 4u; k++) {
            *behind[k] -= (first < *behind[k]) ? 1u : 0u;
        }
    }
}

/* The rank of a place among those from first to before end, or end. */
static uint32_t rank_of(const zygos_store_t *self, uint32_t place, uint32_t first, uint32_t end)
{
    uint32_t r = first;
    while ((r < end) && (self->order[r] != place)) {
        r++;
    }
    return r;
}

/* A free block that is cleared becomes the newest. */
static void append_block(zygos_store_t *self, uint32_t kind)
{
    const uint32_t from = layout_of(kind)->places - self->ready;
    const uint8_t place = self->order[from];
    self->order[from] = self->order[self->count];
    self->order[self->count] = place;
    self->count++;
    self->ready--;
}

static uint32_t unused_of(const zygos_store_t *self, uint32_t kind)
{
    return layout_of(kind)->places - self->count;
}

/* Whether blocks have to be merged. Where an arc has no more than one, none merge before the closing arc is admitted.
 */
static bool lacks_blocks(const zygos_store_t *self, uint32_t kind)
{
    const layout_t *layout = layout_of(kind);
    const uint32_t used = is_buffered(kind) ? self->count : self->closed + 1u;
    return used + layout->spare > layout->places;
}

static bool is_dirty(const zygos_store_t *self, uint32_t kind)
{
    return unused_of(self, kind) > self->ready;
}

/* ---------------------------------------------------------------- tasks */
/* Begins with the first matrix that has rows from this one on; behind the last one it is the number of matrices. */
static void begin_part(zygos_store_t *self, uint32_t kind, uint32_t part)
{
    const uint32_t parts = layout_of(kind)->parts;
    const uint32_t empty = constants_of(self, kind) + ((kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? 1u : 0u);
    while ((part < parts) && (width_of(self, kind, part) <= empty)) {
        part++;
    }
    self->part = part;
    self->row = 0;
    if ((part < parts) && ((self->task == ZYGOS_TASK_VERIFY) || (self->task == ZYGOS_TASK_VERIFY_NOISE))) {
        const size_t used = width_of(self, kind, part) * sizeof self->scan.sum[0];
        memset(self->scan.sum, 0, used);
        memset(self->scan.most, 0, used);
        self->scan.largest = 0.0;
    }
}

static void begin_task(zygos_store_t *self, uint32_t kind, uint32_t task, uint32_t pair)
{
    self->task = task;
    self->pair = pair;
    begin_part(self, kind, 0);
}

static bool has_parts(const zygos_store_t *self, uint32_t kind)
{
    return self->part < layout_of(kind)->parts;
}

/* Turns to the next matrix of the block, and returns whether there is one. */
static bool turn_to_next_part(zygos_store_t *self, uint32_t kind)
{
    begin_part(self, kind, self->part + 1u);
    return has_parts(self, kind);
}

uint32_t zygos_store_part(const zygos_store_t *self, uint32_t kind)
{
    const layout_t *layout = layout_of(kind);
    const bool verifies = (self->task == ZYGOS_TASK_VERIFY) || (self->task == ZYGOS_TASK_VERIFY_NOISE);
    const uint32_t other = (self->task == ZYGOS_TASK_ELIMINATE) ? layout->cycles_eliminate : layout->cycles;
    const uint32_t cycles = verifies ? layout->cycles_verify : other;
    const uint32_t width = has_parts(self, kind) ? width_of(self, kind, self->part) : 0u;
    const uint32_t share = (zygos_gram_entries(width) + cycles - 1u) / cycles;
    const uint32_t most = (share > layout->least) ? share : layout->least;
    uint32_t end = self->row;
    for (uint32_t n = 0; (end < width) && (n < most); end++) {
        n += end + 1u;
    }
    return end;
}

static void clear_part(zygos_store_t *self, uint32_t kind)
{
    const uint32_t place = zygos_store_first_of(self->pair);
    if (has_parts(self, kind)) {
        const matrix_t rows = matrix_of(self, kind, place, self->part);
        const uint32_t end = zygos_store_part(self, kind);
        const uint32_t first = zygos_gram_entries(self->row);
        memset(&rows.gram[first], 0, (zygos_gram_entries(end) - first) * sizeof rows.gram[0]);
        self->row = end;
        if (end < rows.width) {
            return;
        }
        memset(rows.sum, 0, rows.width * sizeof rows.sum[0]);
        if (turn_to_next_part(self, kind)) {
            return;
        }
    }
    clear_rest(self, kind, place);
    verify_seal(self, kind);
    const uint32_t last = layout_of(kind)->places - self->ready;
    const uint32_t rank = rank_of(self, place, self->count, last);
    if (rank < last) {
        self->order[rank] = self->order[last - 1u];
        self->order[last - 1u] = (uint8_t)place;
        self->ready++;
    }
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

/* A last row that the checksums are of changes behind them. */
static void merge(zygos_store_t *self, uint32_t kind)
{
    const layout_t *layout = layout_of(kind);
    const uint32_t to = zygos_store_first_of(self->pair);
    const uint32_t from = zygos_store_second_of(self->pair);
    zygos_block_head_t *head = head_of(self, kind, to);
    const zygos_block_head_t *other_head = head_of(self, kind, from);
    const double own = fade_of(head);
    const double other = fade_of(other_head);
    const uint32_t part = has_parts(self, kind) ? self->part : 0u;
    const matrix_t target = matrix_of(self, kind, to, part);
    const matrix_t source = matrix_of(self, kind, from, part);
    const uint32_t end = zygos_store_part(self, kind);
    const uint32_t last = zygos_gram_entries(target.width - layout->overlaps);
    if (has_parts(self, kind) && (self->row < target.width)) {
        for (uint32_t k = zygos_gram_entries(self->row); (k < zygos_gram_entries(end)) && (k < last); k++) {
            target.gram[k] = own * target.gram[k] + other * source.gram[k];
        }
        self->row = end;
        if ((end < target.width) || (layout->overlaps != 0)) {
            return;
        }
    }
    const bool closed = (head->checksum != 0);
    const bool whole = closed && is_block_sealed(self, kind, to) && is_block_sealed(self, kind, from);
    if (has_parts(self, kind)) {
        for (uint32_t k = last; k < zygos_gram_entries(target.width); k++) {
            target.gram[k] = own * target.gram[k] + other * source.gram[k];
        }
        for (uint32_t i = 0; i < target.width; i++) {
            target.sum[i] = own * target.sum[i] + other * source.sum[i];
        }
        begin_part(self, kind, part + 1u);
        if (has_parts(self, kind)) {
            return;
        }
    }
    if (layout->overlaps != 0) { /* they share no rows with each other any more */
        overlapping(self, to)->square += 2.0 * overlapping(self, to)->overlap;
        overlapping(self, to)->overlap = 0.0;
    }
    double *extra = extras_of(self, kind, to);
    for (uint32_t k = 0; k < (layout->head - layout->extras) / (uint32_t)sizeof extra[0]; k++) {
        extra[k] = own * extra[k] + other * extras_of(self, kind, from)[k];
    }
    head->total = own * head->total + other * other_head->total;
    head->fade = 1.0;
    head->end = other_head->end;
    if (closed) {
        seal_block(self, kind, to, whole);
    }
    verify_seal(self, kind);
    const uint32_t rank = rank_of(self, from, 0, self->count);
    if (rank < self->count) {
        free_ranks(self, rank, rank + 1u);
    }
    self->task = ZYGOS_TASK_NONE;
    reseal(self);
}

/* The sizes of the blocks: their instants; of closed arcs of energy rows their share in all of these, or, where that is
   larger, in the spread of the work, so that blocks of motion do not merge while the arm rests. */
static void write_sizes(const zygos_store_t *self, uint32_t kind, double *size)
{
    if (!is_buffered(kind)) {
        for (uint32_t r = 0; r < self->count; r++) {
            size[r] = zygos_store_instants_of(self, kind, r);
        }
        return;
    }
    const zygos_accumulator_t *sums = (const zygos_accumulator_t *)(const void *)self;
    const uint32_t work = (sums->width > 1u) ? zygos_gram_entries(sums->width - 1u) - 1u : 0u;
    double spread[ZYGOS_ORDER_PLACES] = { 0.0 };
    double instants = 0.0;
    double all = 0.0;
    for (uint32_t r = 0; r < self->count; r++) {
        const uint32_t place = self->order[r];
        const zygos_block_t *block = &sums->block[(place < (uint32_t)ZYGOS_MAX_BLOCKS) ? place : 0u];
        const double fade = fade_of(&block->head);
        const bool closed = (r < self->closed);
        size[r] = fade * block->head.total;
        spread[r] = fade * block->gram[work];
        instants += closed ? size[r] : 0.0;
        all += closed ? spread[r] : 0.0;
    }
    const double scale = (all > 0.0) ? instants / all : 0.0;
    for (uint32_t r = 0; r < self->closed; r++) {
        const double share = scale * spread[r];
        size[r] = zygos_larger(share, size[r]);
    }
}

/* The rank of the first of the two smallest neighbours that fit into one block, or count. Blocks of closed arcs never
   merge with those of the closing or the open one, whose constants are still in them; nor do blocks that may still be
   added to. Where none fits the target doubles, and the next call finds the pair: the blocks are looked through once a
   cycle. */
static uint32_t pair_to_merge(zygos_store_t *self, uint32_t kind)
{
    const uint32_t used = (self->count < self->fresh + IN_USE) ? self->fresh : self->count - IN_USE;
    const uint32_t region[2] = { 0, self->fresh };
    const uint32_t end[2] = { self->closed, used };
    double size[ZYGOS_ORDER_PLACES] = { 0.0 };
    double least = 2.0 * ZYGOS_MAX_INSTANTS;
    uint32_t fits = self->count;
    write_sizes(self, kind, size);
    for (uint32_t g = 0; g < 2u; g++) {
        for (uint32_t r = region[g]; r + 1u < end[g]; r++) {
            const double both = size[r] + size[r + 1u];
            fits = ((both < least) && (both <= self->target)) ? r : fits;
            least = (both < least) ? both : least;
        }
    }
    if (self->count <= layout_of(kind)->fewest) {
        return self->count;
    }
    for (uint32_t tries = 0; (least <= ZYGOS_MAX_INSTANTS) && (self->target < least) && (tries < 64u); tries++) {
        self->target *= 2.0;
    }
    return fits;
}

/* What does not match is left out. */
static void reject(zygos_store_t *self, uint32_t kind)
{
    self->quarantined++;
    self->arcs_dropped++;
    self->admitted = 0;
    begin_task(self, kind, ZYGOS_TASK_ADMIT, 0);
}

/* The next block of the closing arc. */
static void begin_closing(zygos_store_t *self, uint32_t kind)
{
    if (self->closing_instants == 0) { /* the arc was too short */
        self->admitted = 0;
        begin_task(self, kind, ZYGOS_TASK_ADMIT, 0);
    } else if (is_buffered(kind) && (self->rank == self->closed) && !zygos_accumulator_take_means(energy_of(self))) {
        reject(self, kind);
    } else {
        begin_task(self, kind, ZYGOS_TASK_VERIFY, zygos_store_place(self, kind, self->rank));
    }
}

/* Begins to merge two blocks. Returns false where there is no such pair. */
static bool begin_merge(zygos_store_t *self, uint32_t kind)
{
    const double target = self->target;
    const uint32_t rank = pair_to_merge(self, kind);
    if (self->target > target) {
        self->checksum = store_checksum(self);
        return true;
    }
    if (rank < self->count) {
        begin_task(self, kind, ZYGOS_TASK_MERGE,
                   ZYGOS_PAIR((uint32_t)self->order[rank], (uint32_t)self->order[rank + 1u]));
        return true;
    }
    if (!is_buffered(kind)) { /* a changed target or number of instants */
        forget_places(self, kind);
        self->corrupt = 1;
        reseal(self);
        return true;
    }
    return false;
}

static void begin_next_task(zygos_store_t *self, uint32_t kind)
{
    const bool closing = zygos_store_closing(self) && (!is_buffered(kind) || !zygos_accumulator_waits(energy_of(self)));
    const bool lacking = lacks_blocks(self, kind);
    const bool dirty = is_dirty(self, kind);
    if (!closing && !lacking && !dirty) {
        return; /* rows of the closing arc are still in buffers */
    }
    verify_seal(self, kind);
    if (dirty && ((self->ready < layout_of(kind)->spare) || !(closing || lacking))) {
        begin_task(self, kind, ZYGOS_TASK_CLEAR, self->order[layout_of(kind)->places - self->ready - 1u]);
    } else if (!(lacking && begin_merge(self, kind)) && closing) {
        begin_closing(self, kind);
    }
}

/* Whether the accepted instants of all parts are those of the block. */
static bool add_up(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    double off = -head_of(self, kind, place)->total;
    for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
        off += instants_of(self, kind, place)[part];
    }
    return (off > -COUNTED) && (off < COUNTED);
}

/* Whether what was scanned of a matrix matches; the diagonal of the constants counts instants, too. */
static bool is_matrix_whole(zygos_store_t *self, uint32_t kind, uint32_t place, matrix_t matrix)
{
    const double instants = instants_of(self, kind, place)[self->part];
    if (!(zygos_gram_scanned(&self->scan, matrix.gram, matrix.width, matrix.sum, instants) <= 1.0)) {
        return false;
    }
    if (is_buffered(kind)) {
        return zygos_accumulator_verified(energy_of(self), overlapping(self, place));
    }
    double off = -instants;
    for (uint32_t c = 0; c < constants_of(self, kind); c++) {
        off += matrix.gram[zygos_gram_entries(matrix.width - c) - 1u];
    }
    return (off > -COUNTED) && (off < COUNTED);
}

/* Whether the part of a task before this row is followed by another one of the matrix: by more rows, or by what follows
   the last one, which is a part of its own but for motors, where it costs little. */
static bool goes_on(matrix_t matrix, uint32_t end)
{
    return (end < matrix.width) || (matrix.width > (uint32_t)ZYGOS_MAX_MOTOR_ROW);
}

/* Compares the next rows of a block with their row sums. */
static void verify(zygos_store_t *self, uint32_t kind)
{
    const uint32_t place = zygos_store_first_of(self->pair);
    if (has_parts(self, kind)) {
        const matrix_t matrix = matrix_of(self, kind, place, self->part);
        if (self->row < matrix.width) {
            const uint32_t end = zygos_store_part(self, kind);
            zygos_gram_scan(&self->scan, matrix.gram, self->row, end);
            self->row = end;
            if (goes_on(matrix, end)) {
                return;
            }
        }
        if (!is_matrix_whole(self, kind, place, matrix)) {
            reject(self, kind);
            return;
        }
        if (turn_to_next_part(self, kind)) {
            return;
        }
    }
    if (add_up(self, kind, place)) {
        const bool noise = sums_noise(self, kind) && !is_buffered(kind);
        begin_task(self, kind, noise ? ZYGOS_TASK_VERIFY_NOISE : ZYGOS_TASK_ELIMINATE, self->pair);
    } else {
        reject(self, kind);
    }
}

/* That of energy rows is behind the last block, of which it was subtracted before. */
static void verify_noise(zygos_store_t *self, uint32_t kind)
{
    const matrix_t noise = noise_of(self, kind, closing_noise(self));
    const double instants = (double)self->closing_instants;
    const uint32_t end = zygos_least(zygos_store_part(self, kind), noise.width);
    zygos_gram_scan(&self->scan, noise.gram, self->row, end);
    self->row = end;
    if (end < noise.width) {
        return;
    }
    if (!(zygos_gram_scanned(&self->scan, noise.gram, noise.width, noise.sum, layout_of(kind)->noise_adds * instants) <=
          1.0)) {
        reject(self, kind);
    } else if (is_buffered(kind)) {
        begin_task(self, kind, ZYGOS_TASK_JUDGE, self->pair);
    } else {
        zygos_momentum_sums_add_rotors(momentum_of(self), instants, noise.gram, noise.sum);
        begin_task(self, kind, ZYGOS_TASK_ELIMINATE, self->pair);
    }
}

/* Eliminates the constants from row a, subtracts the noise, and adds the row and its column to the row sums. mean: of
   this column in the rows of each constant. Two entries at a time. */
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

/* The next rows of a matrix of the momentum: G - s s^T / n for each constant, less the noise. */
static void eliminate_constants(zygos_store_t *self, uint32_t kind, matrix_t rows, uint32_t end)
{
    const uint32_t constants = constants_of(self, kind);
    const uint32_t p = rows.width - constants;
    const double *noise = noise_of(self, kind, closing_noise(self)).gram;
    const double *constant[MOST_CONSTANTS];
    double share[MOST_CONSTANTS] = { 0.0 }; /* 1 / number of rows; 0 of a constant that there is not */
    for (uint32_t c = 0; c < MOST_CONSTANTS; c++) {
        const uint32_t there = (c < constants) ? c : 0u;
        constant[c] = &rows.gram[zygos_gram_entries(p + there)];
        const double n = constant[c][p + there];
        share[c] = ((c < constants) && (n > 0.0)) ? 1.0 / n : 0.0;
    }
    for (uint32_t a = self->row; a < end; a++) {
        const uint32_t at = zygos_gram_entries(a);
        const double mean[MOST_CONSTANTS] = { constant[0][a] * share[0], constant[1][a] * share[1],
                                              constant[2][a] * share[2] };
        eliminate_row(&rows.gram[at], rows.sum, constant, mean, &noise[at], a);
    }
}

/* The same of a motor, whose noise is known for an instant, and whose last column but the constant has none. */
static void eliminate_constant(const zygos_store_t *self, matrix_t rows, double n, uint32_t end)
{
    const uint32_t p = rows.width - 2u;
    const double *s = &rows.gram[zygos_gram_entries(p + 1u)];
    const double *noise = motors_of(self)->noise[self->part];
    for (uint32_t a = self->row; (n > 0.0) && (a < end); a++) {
        double *entry = &rows.gram[zygos_gram_entries(a)];
        for (uint32_t b = 0; b <= a; b++) {
            entry[b] -= s[a] * s[b] / n + ((a < p) ? n * noise[zygos_gram_entries(a) + b] : 0.0);
            rows.sum[a] += entry[b];
            rows.sum[b] += (b < a) ? entry[b] : 0.0;
        }
    }
}

/* The rows of the constants are 0 then, but for those of energy rows, which keep the deviations of the block. */
static bool end_elimination(zygos_store_t *self, uint32_t kind, uint32_t place, matrix_t rows)
{
    if (is_buffered(kind)) {
        return zygos_accumulator_eliminated(energy_of(self), overlapping(self, place));
    }
    const uint32_t size = zygos_gram_entries(rows.width - constants_of(self, kind));
    memset(&rows.gram[size], 0, (zygos_gram_entries(rows.width) - size) * sizeof rows.gram[0]);
    return true;
}

static void eliminate_rows(zygos_store_t *self, uint32_t kind, matrix_t rows, uint32_t end)
{
    const uint32_t place = zygos_store_first_of(self->pair);
    if (self->row == 0) {
        memset(rows.sum, 0, rows.width * sizeof rows.sum[0]);
    }
    if (kind == (uint32_t)ZYGOS_ENERGY_ROWS) {
        zygos_accumulator_eliminate(energy_of(self), overlapping(self, place), end);
    } else if (kind == (uint32_t)ZYGOS_MOTOR_ROWS) {
        eliminate_constant(self, rows, instants_of(self, kind, place)[self->part], end);
    } else {
        eliminate_constants(self, kind, rows, end);
    }
    self->row = end;
}

static void eliminate(zygos_store_t *self, uint32_t kind)
{
    const uint32_t place = zygos_store_first_of(self->pair);
    if (has_parts(self, kind)) {
        const matrix_t rows = matrix_of(self, kind, place, self->part);
        const uint32_t last = rows.width - constants_of(self, kind);
        if (self->row < last) {
            const uint32_t part = zygos_store_part(self, kind);
            eliminate_rows(self, kind, rows, zygos_least(part, last));
            if (goes_on(rows, part)) {
                return;
            }
        }
        if (!end_elimination(self, kind, place, rows)) {
            reject(self, kind);
            return;
        }
        if (turn_to_next_part(self, kind)) {
            return;
        }
    }
    head_of(self, kind, place)->end = self->closing_end;
    head_of(self, kind, place)->fade = 1.0;
    seal_block(self, kind, place, true);
    begin_task(self, kind, ZYGOS_TASK_JUDGE, self->pair);
}

bool zygos_store_is_noise(const zygos_store_t *self)
{
    return self->rank >= self->fresh;
}

bool zygos_store_is_first_part(const zygos_store_t *self, uint32_t kind)
{
    uint32_t part = 0;
    while ((part < self->part) && (width_of(self, kind, part) <= constants_of(self, kind) + 1u)) {
        part++;
    }
    return (self->rank == self->closed) && (self->row == 0) && (part >= self->part);
}

/* Whether there are more rows of the closing arc behind those that were compared. */
static bool has_more(zygos_store_t *self, uint32_t kind, uint32_t end)
{
    if (has_parts(self, kind) && (end < width_of(self, kind, self->part) - constants_of(self, kind))) {
        self->row = end;
        return true;
    }
    if (zygos_store_is_noise(self)) {
        return false;
    }
    if (turn_to_next_part(self, kind)) {
        return true;
    }
    self->rank++;
    const bool noise = zygos_store_is_noise(self);
    if (!noise || (is_buffered(kind) && sums_noise(self, kind))) {
        begin_task(self, kind, noise ? ZYGOS_TASK_VERIFY_NOISE : ZYGOS_TASK_NONE, 0);
        return true;
    }
    return false;
}

bool zygos_store_judged_rows(zygos_store_t *self, uint32_t kind, uint32_t end)
{
    const bool more = has_more(self, kind, end);
    self->twin = zygos_store_twin(self);
    return more;
}

void zygos_store_judged(zygos_store_t *self, uint32_t kind, bool admitted)
{
    self->admitted = admitted ? 1u : 0u;
    begin_task(self, kind, ZYGOS_TASK_ADMIT, 0);
    self->twin = zygos_store_twin(self);
}

/* The noise of the closing arc moves to that of closed arcs, or is left out. Returns whether all of it had, but for the
   row sums. */
static bool move_noise(zygos_store_t *self, uint32_t kind)
{
    const matrix_t closed = noise_of(self, kind, ZYGOS_NOISE_OF_CLOSED);
    const matrix_t noise = noise_of(self, kind, closing_noise(self));
    const bool admitted = (self->admitted != 0);
    const double factor = 1.0 / self->noise_fade;
    if (self->row < noise.width) {
        const uint32_t end = zygos_least(zygos_store_part(self, kind), noise.width);
        for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(end); k++) {
            closed.gram[k] += admitted ? factor * noise.gram[k] : 0.0; /* what is rejected may be no number */
            noise.gram[k] = 0.0;
        }
        self->row = end;
        return false;
    }
    for (uint32_t i = 0; i < noise.width; i++) {
        closed.sum[i] += admitted ? factor * noise.sum[i] : 0.0;
        noise.sum[i] = 0.0;
    }
    return true;
}

static void leave_out(zygos_store_t *self)
{
    free_ranks(self, self->closed, self->fresh);
    self->closing_instants = 0;
    self->closing_cycles = 0;
    self->task = ZYGOS_TASK_NONE;
}

static void admit(zygos_store_t *self, uint32_t kind)
{
    if (sums_noise(self, kind) && !move_noise(self, kind)) {
        return;
    }
    verify_seal(self, kind);
    if (self->admitted != 0) {
        self->closed = self->fresh;
        self->accepted += self->closing_instants;
        self->arcs++;
    }
    leave_out(self); /* of what was not admitted */
    reseal(self);
}

void zygos_store_proceed(zygos_store_t *self, uint32_t kind)
{
    if (!zygos_store_has_work(self, kind)) {
        return;
    }
    switch (self->task) {
    case ZYGOS_TASK_CLEAR:
        clear_part(self, kind);
        break;
    case ZYGOS_TASK_MERGE:
        merge(self, kind);
        break;
    case ZYGOS_TASK_VERIFY:
        verify(self, kind);
        break;
    case ZYGOS_TASK_VERIFY_NOISE:
        verify_noise(self, kind);
        break;
    case ZYGOS_TASK_ELIMINATE:
        eliminate(self, kind);
        break;
    case ZYGOS_TASK_ADMIT:
        admit(self, kind);
        break;
    case ZYGOS_TASK_JUDGE:
        break;
    default:
        begin_next_task(self, kind);
        if ((self->task == ZYGOS_TASK_VERIFY) && (self->rank > self->closed)) { /* else the means have cost enough */
            verify(self, kind);
        }
        break;
    }
    self->twin = zygos_store_twin(self);
}

bool zygos_store_busy(const zygos_store_t *self, uint32_t kind)
{
    return zygos_store_closing(self) || (self->task != ZYGOS_TASK_NONE) ||
           (!is_buffered(kind) && lacks_blocks(self, kind));
}

bool zygos_store_has_work(const zygos_store_t *self, uint32_t kind)
{
    return zygos_store_busy(self, kind) || lacks_blocks(self, kind) || is_dirty(self, kind);
}

bool zygos_store_rests(const zygos_store_t *self)
{
    return (self->closing_instants == 0) && (self->task != ZYGOS_TASK_MERGE);
}

bool zygos_store_can_close(const zygos_store_t *self, uint32_t kind, bool fading)
{
    const bool free = is_buffered(kind) || ((self->ready > 0) && !lacks_blocks(self, kind));
    return !zygos_store_closing(self) && free && (!fading || zygos_store_rests(self));
}

/* Finishes a task of that kind, each part of which has one row at least. */
static void finish(zygos_store_t *self, uint32_t kind, uint32_t task)
{
    const uint32_t most = layout_of(kind)->parts * (ZYGOS_MAX_ANY_ROW + 2u);
    for (uint32_t tries = 0; (tries < most) && (self->task == task); tries++) {
        zygos_store_proceed(self, kind);
    }
}

/* Finishes a task that concerns free or closed blocks only. */
static void finish_upkeep(zygos_store_t *self, uint32_t kind)
{
    finish(self, kind, ZYGOS_TASK_CLEAR);
    finish(self, kind, ZYGOS_TASK_MERGE);
}

/* Makes so many blocks ready at once, where the tasks had no time to: after arcs of a few instants. */
static void make_ready(zygos_store_t *self, uint32_t kind, uint32_t needed)
{
    const uint32_t places = layout_of(kind)->places;
    for (uint32_t tries = 0; (self->ready < needed) && (tries < 4u * places); tries++) {
        if ((self->task == ZYGOS_TASK_CLEAR) || (self->task == ZYGOS_TASK_MERGE)) {
            finish_upkeep(self, kind); /* which may make a block ready */
        } else if (self->count + self->ready < places) {
            clear_block(self, kind, self->order[places - self->ready - 1u]);
            self->ready++;
        } else if (self->task == ZYGOS_TASK_NONE) {
            begin_next_task(self, kind);
        }
    }
}

void zygos_store_open_block(zygos_store_t *self, uint32_t kind)
{
    const uint32_t begins = layout_of(kind)->begins;
    verify_seal(self, kind); /* which may leave no block in use */
    const uint32_t needed = (self->count == self->fresh) ? begins : 1u;
    make_ready(self, kind, needed);
    if (self->ready < needed) {
        forget_places(self, kind); /* a changed target or number of instants */
        make_ready(self, kind, begins);
        self->corrupt = 1;
    }
    do {
        append_block(self, kind);
    } while (self->count < self->fresh + begins);
    self->open = is_buffered(kind) ? 0u : self->order[self->count - 1u];
    reseal(self);
}

/* ---------------------------------------------------------------- arcs */

void zygos_store_clear(zygos_store_t *self, uint32_t kind, double target)
{
    memset(self, 0, sizeof *self);
    self->target = target;
    self->noise_fade = 1.0;
    for (uint32_t place = 0; place < layout_of(kind)->places; place++) {
        self->order[place] = (uint8_t)place;
        clear_block(self, kind, place);
    }
    for (uint32_t which = 0; has_noise(kind) && (which <= ZYGOS_NOISE_OF_CLOSED); which++) {
        clear_matrix(noise_of(self, kind, which));
    }
    self->ready = layout_of(kind)->places;
    if (is_buffered(kind)) {
        reseal(self);
    } else {
        self->checksum = store_checksum(self);
        zygos_store_open_block(self, kind);
    }
}

/* Reduces the noise of closed arcs in proportion; where nothing is left it begins anew. */
static void fade_noise(zygos_store_t *self, uint32_t kind, double factor)
{
    self->noise_fade *= factor;
    if (!(self->noise_fade > 0.0)) {
        if (has_noise(kind)) {
            clear_matrix(noise_of(self, kind, ZYGOS_NOISE_OF_CLOSED));
        }
        self->noise_fade = 1.0;
    }
}

/* has_rows: there is something to clear. */
static void drop_open(zygos_store_t *self, uint32_t kind, bool has_rows)
{
    verify_seal(self, kind);
    if ((self->task == ZYGOS_TASK_MERGE) &&
        (rank_of(self, zygos_store_first_of(self->pair), self->fresh, self->count) < self->count)) {
        self->task = ZYGOS_TASK_NONE;
    }
    if (is_buffered(kind)) {
        self->arcs_dropped += (self->count > self->fresh) ? 1u : 0u;
        self->count = self->fresh;
        zygos_accumulator_drop_rows(energy_of(self), self->parity, has_rows);
    } else if (has_rows) {
        clear_block(self, kind, self->open);
    }
    if (has_rows && sums_noise(self, kind)) {
        clear_matrix(noise_of(self, kind, self->parity & 1u));
    }
    self->arc_instants = 0;
    self->cycles = 0;
    reseal(self);
}

static void drop_closing(zygos_store_t *self, uint32_t kind)
{
    if (is_buffered(kind)) {
        zygos_accumulator_drop_rows(energy_of(self), closing_noise(self), true);
    }
    if (sums_noise(self, kind)) {
        clear_matrix(noise_of(self, kind, closing_noise(self)));
    }
    self->arcs_dropped += (self->closing_instants > 0) ? 1u : 0u;
    leave_out(self);
    reseal(self);
}

bool zygos_store_is_short(const zygos_store_t *self)
{
    return self->arc_instants < ZYGOS_MIN_ARC_INSTANTS;
}

void zygos_store_close(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    const bool brief = zygos_store_is_short(self);
    if (brief && (!is_buffered(kind) || zygos_store_closing(self) || (self->count == self->fresh))) {
        drop_open(self, kind, self->arc_instants > 0); /* refused instants have added no rows */
        return;
    }
    verify_seal(self, kind);
    if (brief) {
        self->arcs_dropped++;
        self->arc_instants = 0;
    }
    if (is_buffered(kind)) {
        zygos_accumulator_end_rows(energy_of(self));
    } else {
        head_of(self, kind, self->open)->total = (double)self->arc_instants;
    }
    self->rank = self->closed;
    self->fresh = self->count;
    self->closing_instants = self->arc_instants;
    self->closing_cycles = self->cycles;
    self->closing_end = cycle;
    self->parity ^= 1u;
    self->arc_instants = 0;
    self->cycles = 0;
    reseal(self);
    if (!is_buffered(kind)) {
        zygos_store_open_block(self, kind);
    }
}

void zygos_store_forget(zygos_store_t *self, uint32_t kind, double factor)
{
    double left = 0.0;
    verify_seal(self, kind);
    for (uint32_t r = 0; r < self->closed; r++) {
        const uint32_t place = zygos_store_place(self, kind, r);
        const bool whole = is_block_sealed(self, kind, place);
        const double instants = factor * zygos_store_instants_of(self, kind, r);
        head_of(self, kind, place)->fade *= (instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        seal_block(self, kind, place, whole);
        left += (instants >= ZYGOS_NEGLIGIBLE_INSTANTS) ? instants : 0.0;
    }
    fade_noise(self, kind, (left > 0.0) ? factor : 0.0);
    reseal(self);
}

/* Bits of an estimate depend on how this is rounded: those of the momentum rows are sums, the others products. */
static void fade_matrix(matrix_t matrix, uint32_t kind, double fade)
{
    const bool sums = (kind == (uint32_t)ZYGOS_MOMENTUM_ROWS);
    for (uint32_t k = 0; k < zygos_gram_entries(matrix.width); k++) {
        matrix.gram[k] = sums ? matrix.gram[k] + (fade - 1.0) * matrix.gram[k] : fade * matrix.gram[k];
    }
    for (uint32_t i = 0; i < matrix.width; i++) {
        matrix.sum[i] = sums ? matrix.sum[i] + (fade - 1.0) * matrix.sum[i] : fade * matrix.sum[i];
    }
}

void zygos_store_apply_fade(zygos_store_t *self, uint32_t kind)
{
    for (uint32_t r = 0; r < self->closed; r++) {
        const uint32_t place = zygos_store_place(self, kind, r);
        zygos_block_head_t *head = head_of(self, kind, place);
        if (head->fade >= 1.0) {
            continue;
        }
        const bool whole = is_block_sealed(self, kind, place);
        for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
            fade_matrix(matrix_of(self, kind, place, part), kind, head->fade);
        }
        for (uint32_t k = 0; k < layout_of(kind)->fading; k++) {
            extras_of(self, kind, place)[k] *= head->fade;
        }
        head->total *= head->fade;
        head->fade = 1.0;
        seal_block(self, kind, place, whole);
    }
    if (has_noise(kind) && (self->noise_fade < 1.0)) {
        fade_matrix(noise_of(self, kind, ZYGOS_NOISE_OF_CLOSED), kind, self->noise_fade);
    }
    self->noise_fade = 1.0;
    reseal(self);
}

/* The block behind that of this rank, with which it shared rows, is gone. */
static void end_overlap(zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    const uint32_t place = zygos_store_place(self, kind, rank);
    if (layout_of(kind)->overlaps != 0) {
        const bool whole = is_block_sealed(self, kind, place);
        overlapping(self, place)->overlap = 0.0;
        seal_block(self, kind, place, whole);
    }
}

/* Takes the share of dropped blocks off the noise of closed arcs, and counts the instants that are left. */
static void reduce_noise(zygos_store_t *self, uint32_t kind, double before)
{
    const double kept = zygos_store_instants(self, kind);
    if (kept < before) {
        self->accepted = (uint64_t)((double)self->accepted * kept / before + 0.5);
        fade_noise(self, kind, kept / before);
    }
    reseal(self);
}

/* Whether an arc ends with the block of this rank; the number of its newest cycle is in each of its blocks. */
static bool ends_arc(const zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    return (rank + 1u >= self->closed) ||
           (zygos_store_head(self, kind, rank)->end != zygos_store_head(self, kind, rank + 1u)->end);
}

void zygos_store_drop_after(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    finish_upkeep(self, kind);
    finish(self, kind, ZYGOS_TASK_ADMIT); /* a part of its noise may be in that of closed arcs */
    drop_open(self, kind, true);
    uint32_t kept = self->closed;
    uint32_t arcs = 0;
    for (; (kept > 0) && (zygos_store_head(self, kind, kept - 1u)->end > cycle); kept--) {
        arcs += ends_arc(self, kind, kept - 1u) ? 1u : 0u;
    }
    /* Numbers of cycles may have begun anew: the closing arc goes with blocks before it. */
    if (zygos_store_closing(self) && ((kept < self->closed) || (self->closing_end > cycle))) {
        drop_closing(self, kind);
    }
    const double before = zygos_store_instants(self, kind);
    self->arcs -= arcs;
    self->arcs_dropped += arcs;
    if (kept < self->closed) {
        free_ranks(self, kept, self->closed);
        if (kept > 0) {
            end_overlap(self, kind, kept - 1u);
        }
    }
    reduce_noise(self, kind, before);
}

uint32_t zygos_store_drop_until(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    finish_upkeep(self, kind);
    verify_seal(self, kind);
    const double before = zygos_store_instants(self, kind);
    uint32_t drop = 0;
    uint32_t dropped = 0;
    for (; (drop < self->closed) && (zygos_store_head(self, kind, drop)->end <= cycle); drop++) {
        dropped += ends_arc(self, kind, drop) ? 1u : 0u;
    }
    free_ranks(self, 0, drop);
    self->arcs -= zygos_least(dropped, self->arcs);
    reduce_noise(self, kind, before);
    return dropped;
}

/* ---------------------------------------------------------------- memory that was changed */

static bool is_factor(double fade)
{
    return (fade >= 0.0) && (fade <= 1.0);
}

/* Instants and target decide whether blocks merge, and so whether blocks are free. */
bool zygos_store_intact(const zygos_store_t *self, uint32_t kind, bool used)
{
    const bool closing = zygos_store_closing(self);
    const bool task = (self->task < ZYGOS_TASKS) && (self->part <= layout_of(kind)->parts) &&
                      (self->row <= ZYGOS_MAX_ANY_ROW) &&
                      (!closing || ((self->rank >= self->closed) && (self->rank <= self->fresh)));
    const bool unused = (self->closed == 0) && (self->task == ZYGOS_TASK_NONE) && (self->arc_instants == 0);
    bool good = zygos_store_steady(self) && are_places_possible(self, kind) && task && is_factor(self->noise_fade) &&
                (self->noise_fade > 0.0) && zygos_is_count(self->target) && (used ? (self->target >= 1.0) : unused);
    for (uint32_t r = 0; good && (r < self->count); r++) {
        const zygos_block_head_t *head = zygos_store_head(self, kind, r);
        good = zygos_is_count(head->total) && is_factor(fade_of(head));
    }
    return good;
}

/* The largest violation of row sums, of a matrix or in a block. */
static double violation(matrix_t matrix, double adds)
{
    return zygos_gram_check(matrix.gram, matrix.width, matrix.sum, adds);
}

static double worst_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    double worst = 0.0;
    for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
        matrix_t matrix = matrix_of(self, kind, place, part);
        matrix.width -= (head_of(self, kind, place)->checksum != 0) ? layout_of(kind)->overlaps : 0u;
        worst = zygos_larger(violation(matrix, instants_of(self, kind, place)[part]), worst);
    }
    return worst;
}

static bool is_noise_whole(zygos_store_t *self, uint32_t kind, uint32_t which)
{
    const double adds = layout_of(kind)->noise_adds * (double)zygos_store_accepted(self);
    return !has_noise(kind) || (violation(noise_of(self, kind, which), adds) <= 1.0);
}

static bool is_closed_whole(zygos_store_t *self, uint32_t kind, uint32_t rank)
{
    const uint32_t place = zygos_store_place(self, kind, rank);
    const zygos_block_head_t *head = head_of(self, kind, place);
    return is_block_sealed(self, kind, place) && zygos_is_count(head->total) && is_factor(head->fade) &&
           (worst_of(self, kind, place) <= 1.0);
}

/* Whether the sums of the open arc match, and what has yet to be added to them. */
static bool is_open_whole(zygos_store_t *self, uint32_t kind)
{
    bool whole = (!is_buffered(kind) || zygos_accumulator_is_open_whole(energy_of(self))) &&
                 is_noise_whole(self, kind, 0u) && is_noise_whole(self, kind, 1u);
    for (uint32_t r = self->fresh; whole && (r < self->count); r++) {
        const zygos_block_head_t *head = zygos_store_head(self, kind, r);
        whole = (head->checksum == 0) && zygos_is_count(head->total) &&
                (worst_of(self, kind, zygos_store_place(self, kind, r)) <= 1.0);
    }
    return whole;
}

bool zygos_store_is_whole(const zygos_store_t *self, uint32_t kind)
{
    zygos_store_t *all = readable(self);
    bool whole = (self->corrupt == 0) && (self->checksum == store_checksum(self)) &&
                 is_noise_whole(all, kind, ZYGOS_NOISE_OF_CLOSED) && is_open_whole(all, kind);
    for (uint32_t r = 0; whole && (r < self->closed); r++) {
        whole = is_closed_whole(all, kind, r);
    }
    return whole;
}

/* Drops the closed blocks that do not match. */
static void quarantine(zygos_store_t *self, uint32_t kind)
{
    const uint32_t was = self->closed;
    bool previous = false; /* whether the block before was kept */
    double before = 0.0;
    double after = 0.0;
    for (uint32_t r = 0; r < self->closed;) {
        const double instants = zygos_store_instants_of(self, kind, r);
        const bool kept = is_closed_whole(self, kind, r);
        before += zygos_is_count(instants) ? instants : 0.0;
        after += kept ? instants : 0.0;
        if (!kept && previous) {
            end_overlap(self, kind, r - 1u);
        }
        if (!kept) {
            free_ranks(self, r, r + 1u);
        }
        r += kept ? 1u : 0u;
        previous = kept;
    }
    if (self->closed < was) {
        self->quarantined += was - self->closed;
        self->accepted = (uint64_t)after;
        fade_noise(self, kind, (before > 0.0) ? after / before : 0.0);
    }
}

/* Whether what all blocks have in common can be trusted, after a repair where one is possible. */
static bool is_common_whole(zygos_store_t *self, uint32_t kind)
{
    return ((self->checksum == store_checksum(self)) || repair(self)) && (self->corrupt != 1u) &&
           are_places_possible(self, kind) && (self->target >= 1.0) && is_factor(self->noise_fade) &&
           (self->noise_fade > 0.0) && is_noise_whole(self, kind, ZYGOS_NOISE_OF_CLOSED);
}

bool zygos_store_scrub(zygos_store_t *self, uint32_t kind)
{
    if (!is_common_whole(self, kind)) {
        return false;
    }
    const bool moved = !zygos_store_steady(self); /* the noise may be that of the other arc */
    self->parity &= 1u;
    if (moved || (self->task != ZYGOS_TASK_NONE) || zygos_store_closing(self)) {
        self->quarantined++;
        drop_closing(self, kind);
    }
    if (moved || !is_open_whole(self, kind)) {
        self->quarantined++;
        self->ready = 0; /* what is in free blocks is not known */
        self->checksum = store_checksum(self);
        if (is_buffered(kind)) {
            zygos_accumulator_forget_rows(energy_of(self));
        }
        drop_open(self, kind, true);
        for (uint32_t which = 0; has_noise(kind) && (which < ZYGOS_NOISE_OF_CLOSED); which++) {
            clear_matrix(noise_of(self, kind, which));
        }
    }
    self->corrupt = 0;
    self->pair = 0;
    quarantine(self, kind);
    begin_part(self, kind, 0);
    reseal(self);
    return true;
}
