#include "zygos/priv/store.h"

#include "zygos/priv/momentumsums.h"
#include "zygos/priv/motorsums.h"

#include <stddef.h>
#include <string.h>

_Static_assert(ZYGOS_MAX_IMPULSE + 2 <= ZYGOS_MAX_ANY_ROW, "a scan has room for each row of a motor");
_Static_assert(ZYGOS_MAX_MOMENTUM_ROW <= ZYGOS_MAX_ANY_ROW, "a scan has room for each row of the momentum");
_Static_assert(ZYGOS_MIN_ARCS < ZYGOS_MAX_MOTOR_BLOCKS, "an arc that closes needs a block");
_Static_assert((ZYGOS_MOMENTUM == 0) || (ZYGOS_MIN_ARCS < ZYGOS_MAX_MOMENTUM_BLOCKS),
               "an arc that closes needs a block");
_Static_assert(offsetof(zygos_motor_sums_t, store) == 0, "the store is found by the address of the sums");
_Static_assert(offsetof(zygos_momentum_sums_t, store) == 0, "the store is found by the address of the sums");

#define COUNTED 1e-9 /* counts add up exactly */
#define MOST_CONSTANTS 3u

/* ---------------------------------------------------------------- kinds of rows */

/* A matrix and its row sums. */
typedef struct {
    double *gram;
    double *sum;
    uint32_t width;
} matrix_t;

/* Where a kind of rows has its sums, in bytes: from the store, or from a block. */
typedef struct {
    uint32_t open;
    uint32_t blocks;
    uint32_t places; /* of blocks */
    uint32_t block;
    uint32_t parts; /* matrices in a block */
    uint32_t part;
    uint32_t sum;
    uint32_t instants; /* of each part, in a block */
    uint32_t counts;   /* how many of these there are beside the total: parts, or none */
    uint32_t head;
} layout_t;

static const layout_t *layout_of(uint32_t kind)
{
    static const layout_t of_motors = {
        .open = (uint32_t)offsetof(zygos_motor_sums_t, open),
        .blocks = (uint32_t)offsetof(zygos_motor_sums_t, block),
        .places = ZYGOS_MAX_MOTOR_BLOCKS,
        .block = (uint32_t)sizeof(zygos_motor_block_t),
        .parts = ZYGOS_MAX_JOINTS,
        .part = (uint32_t)sizeof(zygos_motor_gram_t),
        .sum = (uint32_t)offsetof(zygos_motor_gram_t, sum),
        .instants = (uint32_t)offsetof(zygos_motor_block_t, instants),
        .counts = ZYGOS_MAX_JOINTS,
        .head = (uint32_t)offsetof(zygos_motor_block_t, head),
    };
    static const layout_t of_momentum = {
        .open = (uint32_t)offsetof(zygos_momentum_sums_t, open),
        .blocks = (uint32_t)offsetof(zygos_momentum_sums_t, block),
        .places = ZYGOS_MOMENTUM_PLACES,
        .block = (uint32_t)sizeof(zygos_momentum_block_t),
        .parts = 1u,
        .part = (uint32_t)sizeof(zygos_momentum_gram_t),
        .sum = (uint32_t)offsetof(zygos_momentum_gram_t, sum),
        .instants = (uint32_t)(offsetof(zygos_momentum_block_t, head) + offsetof(zygos_block_head_t, total)),
        .counts = 0u,
        .head = (uint32_t)offsetof(zygos_momentum_block_t, head),
    };
    return (kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? &of_motors : &of_momentum;
}

/* The rest of a kind, which is the memory of the whole. */
static const zygos_motor_sums_t *motors_of(const zygos_store_t *self)
{
    return (const zygos_motor_sums_t *)(const void *)self;
}

static const zygos_momentum_sums_t *momentum_of(const zygos_store_t *self)
{
    return (const zygos_momentum_sums_t *)(const void *)self;
}

static uint32_t constants_of(const zygos_store_t *self, uint32_t kind)
{
    const uint32_t found = (kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? 1u : momentum_of(self)->components;
    return (found <= MOST_CONSTANTS) ? found : MOST_CONSTANTS;
}

/* The length of a row, of which there is room for, whatever memory says. */
static uint32_t width_of(const zygos_store_t *self, uint32_t kind, uint32_t part)
{
    const bool motors = (kind == (uint32_t)ZYGOS_MOTOR_ROWS);
    const uint32_t most = motors ? (uint32_t)ZYGOS_MAX_MOTOR_ROW : (uint32_t)ZYGOS_MAX_MOMENTUM_ROW;
    const uint32_t found =
        motors ? motors_of(self)->column_map.count[part] + 2u : momentum_of(self)->columns + constants_of(self, kind);
    return (found < most) ? found : most;
}

/* A block; at the places, the open arc. */
static unsigned char *block_at(zygos_store_t *self, const layout_t *layout, uint32_t place)
{
    unsigned char *memory = (unsigned char *)(void *)self;
    return (place < layout->places) ? memory + layout->blocks + (size_t)place * layout->block : memory + layout->open;
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

/* Who only reads uses the same functions. */
static zygos_store_t *readable(const zygos_store_t *self)
{
    return (zygos_store_t *)(uintptr_t)self;
}

static uint32_t places_of(uint32_t kind)
{
    return layout_of(kind)->places;
}

static uint32_t open_of(uint32_t kind)
{
    return layout_of(kind)->places;
}

static uint32_t closing_of(const zygos_store_t *self, uint32_t kind)
{
    return (self->count < places_of(kind)) ? self->count : 0u;
}

/* Which noise: that of the open or of the closing arc, by parity, or that of closed arcs. */
#define CLOSED 2u

static uint32_t closing_noise(const zygos_store_t *self)
{
    return (self->parity & 1u) ^ 1u;
}

/* Where noise is summed beside the rows, which is so of the momentum. It has no constants. */
static bool sums_noise(uint32_t kind)
{
    return kind != (uint32_t)ZYGOS_MOTOR_ROWS;
}

static matrix_t noise_of(zygos_store_t *self, uint32_t kind, uint32_t which)
{
    zygos_momentum_sums_t *sums = (zygos_momentum_sums_t *)(void *)self;
    zygos_momentum_gram_t *noise = (which < CLOSED) ? &sums->noise_arc[which] : &sums->noise_closed;
    const matrix_t out = { noise->gram, noise->sum, width_of(self, kind, 0) - constants_of(self, kind) };
    return out;
}

/* ---------------------------------------------------------------- seals */

static uint64_t checksum_of(const zygos_store_t *self)
{
    const double numbers[2] = { self->target, self->noise_fade };
    return zygos_checksum_number(zygos_checksum_doubles(0u, numbers, 2), self->count);
}

static void reseal(zygos_store_t *self)
{
    self->checksum = checksum_of(self);
    self->twin = zygos_store_twin(self);
}

/* Flips a bit back where that explains the checksum. */
static bool repair(zygos_store_t *self)
{
    uint64_t word[3] = { zygos_bits_of(self->target), zygos_bits_of(self->noise_fade), self->count };
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
static void verify_seal(zygos_store_t *self, uint32_t kind)
{
    if ((self->checksum != checksum_of(self)) && !repair(self)) {
        self->corrupt = 1;
    }
    self->count = (self->count <= places_of(kind)) ? self->count : 0u;
}

static uint64_t checksum_of_block(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const zygos_block_head_t *head = head_of(self, kind, place);
    const double numbers[2] = { head->total, head->fade };
    const uint64_t counts = zygos_checksum_doubles(1u, instants_of(self, kind, place), layout_of(kind)->counts);
    return zygos_checksum_number(zygos_checksum_doubles(counts, numbers, 2), head->end);
}

static bool is_sealed(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    return head_of(self, kind, place)->checksum == checksum_of_block(self, kind, place);
}

/* Of a block that has changed; what was wrong before remains wrong. */
static void seal(zygos_store_t *self, uint32_t kind, uint32_t place, bool whole)
{
    const uint64_t checksum = checksum_of_block(self, kind, place);
    head_of(self, kind, place)->checksum = whole ? checksum : ~checksum;
}

/* ---------------------------------------------------------------- matrices and blocks */

static void clear_matrix(matrix_t matrix)
{
    memset(matrix.gram, 0, zygos_gram_entries(matrix.width) * sizeof matrix.gram[0]);
    memset(matrix.sum, 0, matrix.width * sizeof matrix.sum[0]);
}

static double violation(matrix_t matrix, double adds)
{
    return zygos_gram_check(matrix.gram, matrix.width, matrix.sum, adds);
}

/* What rows of their width use of a block. */
static void copy_block(zygos_store_t *self, uint32_t kind, uint32_t to, uint32_t from)
{
    const layout_t *layout = layout_of(kind);
    for (uint32_t part = 0; part < layout->parts; part++) {
        const matrix_t source = matrix_of(self, kind, from, part);
        const matrix_t target = matrix_of(self, kind, to, part);
        memcpy(target.gram, source.gram, zygos_gram_entries(source.width) * sizeof source.gram[0]);
        memcpy(target.sum, source.sum, source.width * sizeof source.sum[0]);
    }
    memcpy(instants_of(self, kind, to), instants_of(self, kind, from), layout->counts * sizeof(double));
    *head_of(self, kind, to) = *head_of(self, kind, from);
}

static double total_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const zygos_block_head_t *head = head_of(self, kind, place);
    return head->fade * head->total;
}

static bool is_count(double instants)
{
    return (instants >= 0.0) && (instants <= ZYGOS_MAX_INSTANTS);
}

static bool is_factor(double fade)
{
    return (fade >= 0.0) && (fade <= 1.0);
}

/* The largest violation of the row sums of a block. */
static double worst_of(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    double worst = 0.0;
    for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
        const double here = violation(matrix_of(self, kind, place, part), instants_of(self, kind, place)[part]);
        worst = (here > worst) ? here : worst;
    }
    return worst;
}

static bool is_open_whole(zygos_store_t *self, uint32_t kind)
{
    const double instants = head_of(self, kind, open_of(kind))->total;
    return is_count(instants) && (worst_of(self, kind, open_of(kind)) <= 1.0) &&
           (!sums_noise(kind) || (violation(noise_of(self, kind, self->parity & 1u), instants) <= 1.0));
}

static void drop_open(zygos_store_t *self, uint32_t kind)
{
    const layout_t *layout = layout_of(kind);
    for (uint32_t part = 0; part < layout->parts; part++) {
        clear_matrix(matrix_of(self, kind, open_of(kind), part));
    }
    if (sums_noise(kind)) {
        clear_matrix(noise_of(self, kind, self->parity & 1u));
    }
    memset(instants_of(self, kind, open_of(kind)), 0, layout->counts * sizeof(double));
    head_of(self, kind, open_of(kind))->total = 0.0;
    self->cycles = 0;
}

/* Reduces the noise of closed arcs in proportion; where nothing is left it begins anew. */
static void fade_noise(zygos_store_t *self, uint32_t kind, double factor)
{
    self->noise_fade *= factor;
    if (!(self->noise_fade > 0.0)) {
        if (sums_noise(kind)) {
            clear_matrix(noise_of(self, kind, CLOSED));
        }
        self->noise_fade = 1.0;
    }
}

/* ---------------------------------------------------------------- the pass over an arc */

/* Begins with the first matrix that has rows from this one on; behind the last one it is the number of matrices. */
static void begin_part(zygos_store_t *self, uint32_t kind, uint32_t part)
{
    const uint32_t empty = constants_of(self, kind) + ((kind == (uint32_t)ZYGOS_MOTOR_ROWS) ? 1u : 0u);
    while ((part < layout_of(kind)->parts) && (width_of(self, kind, part) <= empty)) {
        part++;
    }
    self->part = part;
    self->row = 0;
    if ((self->task == ZYGOS_STORE_VERIFY) || (self->task == ZYGOS_STORE_VERIFY_NOISE)) {
        memset(&self->scan, 0, sizeof self->scan);
    }
    self->twin = zygos_store_twin(self);
}

static void begin_task(zygos_store_t *self, uint32_t kind, uint32_t task)
{
    self->task = task;
    begin_part(self, kind, 0);
}

static bool has_parts(const zygos_store_t *self, uint32_t kind)
{
    return self->part < layout_of(kind)->parts;
}

static void drop_closing(zygos_store_t *self, uint32_t kind)
{
    if (sums_noise(kind)) {
        clear_matrix(noise_of(self, kind, closing_noise(self)));
    }
    self->closing_cycles = 0;
    begin_task(self, kind, ZYGOS_STORE_NONE);
}

uint32_t zygos_store_part(const zygos_store_t *self, uint32_t kind)
{
    const uint32_t width = has_parts(self, kind) ? width_of(self, kind, self->part) : 0u;
    const uint32_t share = (zygos_gram_entries(width) + ZYGOS_STORE_PASS_CYCLES - 1u) / ZYGOS_STORE_PASS_CYCLES;
    const uint32_t most = (share > ZYGOS_STORE_LEAST_PART) ? share : ZYGOS_STORE_LEAST_PART;
    uint32_t end = self->row;
    for (uint32_t n = 0; (end < width) && (n < most); end++) {
        n += end + 1u;
    }
    return end;
}

/* What does not match is left out. */
static void reject(zygos_store_t *self, uint32_t kind)
{
    self->quarantined++;
    self->admitted = 0;
    begin_task(self, kind, ZYGOS_STORE_ADMIT);
}

/* Whether the accepted instants of all parts are those of the arc. */
static bool add_up(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    double off = -head_of(self, kind, place)->total;
    for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
        off += instants_of(self, kind, place)[part];
    }
    return (off > -COUNTED) && (off < COUNTED);
}

/* Compares the next rows of the closing arc with their row sums; the diagonal of the constants counts instants, too. */
static void verify(zygos_store_t *self, uint32_t kind)
{
    const uint32_t place = closing_of(self, kind);
    if (has_parts(self, kind)) {
        const matrix_t matrix = matrix_of(self, kind, place, self->part);
        const double instants = instants_of(self, kind, place)[self->part];
        const uint32_t end = zygos_store_part(self, kind);
        zygos_gram_scan(&self->scan, matrix.gram, self->row, end);
        self->row = end;
        if (end < matrix.width) {
            return;
        }
        double off = -instants;
        for (uint32_t c = 0; c < constants_of(self, kind); c++) {
            off += matrix.gram[zygos_gram_entries(matrix.width - c) - 1u];
        }
        if (!(off > -COUNTED) || !(off < COUNTED) ||
            !(zygos_gram_scanned(&self->scan, matrix.gram, matrix.width, matrix.sum, instants) <= 1.0)) {
            reject(self, kind);
            return;
        }
        begin_part(self, kind, self->part + 1u);
        if (has_parts(self, kind)) {
            return;
        }
    }
    if (add_up(self, kind, place)) {
        begin_task(self, kind, sums_noise(kind) ? ZYGOS_STORE_VERIFY_NOISE : ZYGOS_STORE_ELIMINATE);
    } else {
        reject(self, kind);
    }
}

static void verify_noise(zygos_store_t *self, uint32_t kind)
{
    const uint32_t part = zygos_store_part(self, kind);
    const matrix_t noise = noise_of(self, kind, closing_noise(self));
    const uint32_t end = (part < noise.width) ? part : noise.width;
    const double instants = head_of(self, kind, closing_of(self, kind))->total;
    zygos_gram_scan(&self->scan, noise.gram, self->row, end);
    self->row = end;
    if (end < noise.width) {
        return;
    }
    if (zygos_gram_scanned(&self->scan, noise.gram, noise.width, noise.sum, instants) <= 1.0) {
        zygos_momentum_sums_add_rotors(momentum_of(self), instants, noise.gram, noise.sum);
        begin_task(self, kind, ZYGOS_STORE_ELIMINATE);
    } else {
        reject(self, kind);
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

static void eliminate(zygos_store_t *self, uint32_t kind)
{
    if (has_parts(self, kind)) {
        const uint32_t place = closing_of(self, kind);
        const matrix_t rows = matrix_of(self, kind, place, self->part);
        const uint32_t last = rows.width - constants_of(self, kind);
        const uint32_t part = zygos_store_part(self, kind);
        const uint32_t end = (part < last) ? part : last;
        if (self->row == 0) {
            memset(rows.sum, 0, rows.width * sizeof rows.sum[0]);
        }
        if (sums_noise(kind)) {
            eliminate_constants(self, kind, rows, end);
        } else {
            eliminate_constant(self, rows, instants_of(self, kind, place)[self->part], end);
        }
        self->row = part;
        if (part < rows.width) {
            return;
        }
        const uint32_t size = zygos_gram_entries(last);
        memset(&rows.gram[size], 0, (zygos_gram_entries(rows.width) - size) * sizeof rows.gram[0]);
        begin_part(self, kind, self->part + 1u);
    }
    if (!has_parts(self, kind)) {
        begin_task(self, kind, ZYGOS_STORE_JUDGE);
    }
}

bool zygos_store_judged_rows(zygos_store_t *self, uint32_t kind, uint32_t end)
{
    if (has_parts(self, kind) && (end < width_of(self, kind, self->part) - constants_of(self, kind))) {
        self->row = end;
        self->twin = zygos_store_twin(self);
        return true;
    }
    begin_part(self, kind, self->part + 1u);
    return has_parts(self, kind);
}

void zygos_store_judged(zygos_store_t *self, uint32_t kind, bool admitted)
{
    self->admitted = admitted ? 1u : 0u;
    begin_task(self, kind, ZYGOS_STORE_ADMIT);
}

/* The first pair of neighbours that fits into one block. The target doubles when none fits. */
static void begin_merge(zygos_store_t *self, uint32_t kind)
{
    double least = 2.0 * ZYGOS_MAX_INSTANTS;
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        const double both = total_of(self, kind, b) + total_of(self, kind, b + 1u);
        least = (both < least) ? both : least;
    }
    for (uint32_t tries = 0; (self->target < least) && (tries < 64u); tries++) {
        self->target *= 2.0;
    }
    for (uint32_t b = 0; b + 1u < self->count; b++) {
        if (total_of(self, kind, b) + total_of(self, kind, b + 1u) <= self->target) {
            self->place = b;
            begin_task(self, kind, ZYGOS_STORE_MERGE);
            reseal(self);
            return;
        }
    }
    self->corrupt = 1; /* a changed target or number of instants */
    self->count = 0;
    reseal(self);
}

/* The noise of the closing arc moves to that of closed arcs, or is left out. Returns whether all of it has. */
static bool move_noise(zygos_store_t *self, uint32_t kind)
{
    const uint32_t part = zygos_store_part(self, kind);
    const matrix_t closed = noise_of(self, kind, CLOSED);
    const matrix_t noise = noise_of(self, kind, closing_noise(self));
    const uint32_t end = (part < noise.width) ? part : noise.width;
    const bool admitted = (self->admitted != 0);
    const double factor = 1.0 / self->noise_fade;
    for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(end); k++) {
        closed.gram[k] += admitted ? factor * noise.gram[k] : 0.0; /* what is rejected may be no number */
        noise.gram[k] = 0.0;
    }
    self->row = end;
    for (uint32_t i = 0; (end == noise.width) && (i < noise.width); i++) {
        closed.sum[i] += admitted ? factor * noise.sum[i] : 0.0;
        noise.sum[i] = 0.0;
    }
    return end == noise.width;
}

/* The closing arc becomes one of the closed ones, or is left out. */
static void admit(zygos_store_t *self, uint32_t kind)
{
    if (sums_noise(kind) && !move_noise(self, kind)) {
        return;
    }
    verify_seal(self, kind);
    seal(self, kind, closing_of(self, kind), true);
    self->count += ((self->admitted != 0) && (self->count < places_of(kind))) ? 1u : 0u;
    self->closing_cycles = 0;
    begin_task(self, kind, ZYGOS_STORE_NONE);
    reseal(self);
    if (self->count >= places_of(kind)) {
        begin_merge(self, kind);
    }
}

static void merge(zygos_store_t *self, uint32_t kind)
{
    const uint32_t to = self->place;
    const uint32_t from = (to + 1u < self->count) ? to + 1u : to;
    zygos_block_head_t *head = head_of(self, kind, to);
    const zygos_block_head_t *other = head_of(self, kind, from);
    if (has_parts(self, kind)) {
        const matrix_t target = matrix_of(self, kind, to, self->part);
        const matrix_t source = matrix_of(self, kind, from, self->part);
        const uint32_t end = zygos_store_part(self, kind);
        for (uint32_t k = zygos_gram_entries(self->row); k < zygos_gram_entries(end); k++) {
            target.gram[k] = head->fade * target.gram[k] + other->fade * source.gram[k];
        }
        self->row = end;
        if (end < target.width) {
            return;
        }
        for (uint32_t i = 0; i < target.width; i++) {
            target.sum[i] = head->fade * target.sum[i] + other->fade * source.sum[i];
        }
        begin_part(self, kind, self->part + 1u);
        if (has_parts(self, kind)) {
            return;
        }
    }
    const bool whole = is_sealed(self, kind, to) && is_sealed(self, kind, from);
    double *instants = instants_of(self, kind, to);
    for (uint32_t j = 0; j < layout_of(kind)->counts; j++) {
        instants[j] = head->fade * instants[j] + other->fade * instants_of(self, kind, from)[j];
    }
    head->total = total_of(self, kind, to) + total_of(self, kind, from);
    head->fade = 1.0;
    head->end = other->end;
    seal(self, kind, to, whole);
    self->place = from;
    begin_task(self, kind, ZYGOS_STORE_SHIFT);
}

/* Moves the block behind a place that is free to it. */
static void shift(zygos_store_t *self, uint32_t kind)
{
    if (self->place + 1u < self->count) {
        copy_block(self, kind, self->place, self->place + 1u);
        self->place++;
        return;
    }
    verify_seal(self, kind);
    self->count -= (self->count > 0) ? 1u : 0u;
    self->place = 0;
    begin_task(self, kind, ZYGOS_STORE_NONE);
    reseal(self);
}

void zygos_store_proceed(zygos_store_t *self, uint32_t kind)
{
    switch (self->task) {
    case ZYGOS_STORE_VERIFY:
        verify(self, kind);
        break;
    case ZYGOS_STORE_VERIFY_NOISE:
        verify_noise(self, kind);
        break;
    case ZYGOS_STORE_ELIMINATE:
        eliminate(self, kind);
        break;
    case ZYGOS_STORE_ADMIT:
        admit(self, kind);
        break;
    case ZYGOS_STORE_MERGE:
        merge(self, kind);
        break;
    case ZYGOS_STORE_SHIFT:
        shift(self, kind);
        break;
    default:
        break;
    }
    self->twin = zygos_store_twin(self);
}

/* Whether the task changes the sums of closed arcs. */
static bool changes_blocks(const zygos_store_t *self)
{
    return (self->task == ZYGOS_STORE_ADMIT) || (self->task == ZYGOS_STORE_MERGE) || (self->task == ZYGOS_STORE_SHIFT);
}

/* ---------------------------------------------------------------- arcs */

void zygos_store_clear(zygos_store_t *self, uint32_t kind, uint32_t arc_cycles)
{
    self->target = 2.0 * (double)arc_cycles;
    self->count = 0;
    self->corrupt = 0;
    self->quarantined = 0;
    self->noise_fade = 1.0;
    self->place = 0;
    self->admitted = 0;
    self->parity = 0;
    if (sums_noise(kind)) {
        clear_matrix(noise_of(self, kind, CLOSED));
    }
    drop_closing(self, kind);
    drop_open(self, kind);
    reseal(self);
}

bool zygos_store_is_short(const zygos_store_t *self, uint32_t kind)
{
    return head_of(readable(self), kind, open_of(kind))->total < (double)ZYGOS_MIN_ARC_INSTANTS;
}

void zygos_store_close(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    if (zygos_store_is_short(self, kind)) {
        if (head_of(self, kind, open_of(kind))->total > 0.0) { /* refused instants have added nothing */
            drop_open(self, kind);
        }
        self->cycles = 0;
        return;
    }
    verify_seal(self, kind);
    const uint32_t place = closing_of(self, kind);
    copy_block(self, kind, place, open_of(kind));
    head_of(self, kind, place)->fade = 1.0;
    head_of(self, kind, place)->end = cycle;
    self->closing_cycles = self->cycles;
    self->parity ^= 1u;
    drop_open(self, kind);
    self->admitted = 0;
    begin_task(self, kind, ZYGOS_STORE_VERIFY);
}

const zygos_block_head_t *zygos_store_closing(const zygos_store_t *self, uint32_t kind)
{
    return head_of(readable(self), kind, closing_of(self, kind));
}

double zygos_store_instants(const zygos_store_t *self, uint32_t kind)
{
    double total = 0.0;
    for (uint32_t b = 0; (b < self->count) && (b < places_of(kind)); b++) {
        total += total_of(readable(self), kind, b);
    }
    return total;
}

void zygos_store_forget(zygos_store_t *self, uint32_t kind, double factor)
{
    double left = 0.0;
    verify_seal(self, kind);
    for (uint32_t b = 0; b < self->count; b++) {
        const bool whole = is_sealed(self, kind, b);
        head_of(self, kind, b)->fade *= (factor * total_of(self, kind, b) >= ZYGOS_NEGLIGIBLE_INSTANTS) ? factor : 0.0;
        seal(self, kind, b, whole);
        left += total_of(self, kind, b);
    }
    fade_noise(self, kind, (left > 0.0) ? factor : 0.0);
    reseal(self);
}

/* Bits of an estimate depend on how this is rounded: the sums of motors are products, those of the momentum sums. */
static void fade_matrix(matrix_t matrix, uint32_t kind, double fade)
{
    const bool motors = (kind == (uint32_t)ZYGOS_MOTOR_ROWS);
    for (uint32_t k = 0; k < zygos_gram_entries(matrix.width); k++) {
        matrix.gram[k] = motors ? fade * matrix.gram[k] : matrix.gram[k] + (fade - 1.0) * matrix.gram[k];
    }
    for (uint32_t i = 0; i < matrix.width; i++) {
        matrix.sum[i] = motors ? fade * matrix.sum[i] : matrix.sum[i] + (fade - 1.0) * matrix.sum[i];
    }
}

void zygos_store_apply_fade(zygos_store_t *self, uint32_t kind)
{
    for (uint32_t b = 0; b < self->count; b++) {
        zygos_block_head_t *head = head_of(self, kind, b);
        if (head->fade >= 1.0) {
            continue;
        }
        const bool whole = is_sealed(self, kind, b);
        for (uint32_t part = 0; part < layout_of(kind)->parts; part++) {
            fade_matrix(matrix_of(self, kind, b, part), kind, head->fade);
        }
        for (uint32_t j = 0; j < layout_of(kind)->counts; j++) {
            instants_of(self, kind, b)[j] *= head->fade;
        }
        head->total *= head->fade;
        head->fade = 1.0;
        seal(self, kind, b, whole);
    }
    if (sums_noise(kind)) {
        fade_matrix(noise_of(self, kind, CLOSED), kind, self->noise_fade);
    }
    self->noise_fade = 1.0;
    reseal(self);
}

/* Takes the share of dropped blocks off the noise of closed arcs. */
static void reduce(zygos_store_t *self, uint32_t kind, double before)
{
    const double kept = zygos_store_instants(self, kind);
    if (kept < before) {
        fade_noise(self, kind, kept / before);
    }
    reseal(self);
}

void zygos_store_drop_after(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    const uint32_t most = 4u * (places_of(kind) + layout_of(kind)->parts + ZYGOS_STORE_PASS_CYCLES);
    drop_open(self, kind);
    for (uint32_t tries = 0; (tries < most) && changes_blocks(self); tries++) {
        zygos_store_proceed(self, kind);
    }
    verify_seal(self, kind);
    /* Numbers of cycles may have begun anew; the closing arc stands behind the last block that is kept. */
    const bool drops = (self->count > 0) && (head_of(self, kind, self->count - 1u)->end > cycle);
    if ((self->task != ZYGOS_STORE_NONE) && (drops || (zygos_store_closing(self, kind)->end > cycle))) {
        drop_closing(self, kind);
    }
    const double before = zygos_store_instants(self, kind);
    while ((self->count > 0) && (head_of(self, kind, self->count - 1u)->end > cycle)) {
        self->count--;
    }
    reduce(self, kind, before);
}

uint32_t zygos_store_drop_until(zygos_store_t *self, uint32_t kind, uint64_t cycle)
{
    verify_seal(self, kind);
    const double before = zygos_store_instants(self, kind);
    uint32_t drop = 0;
    while ((drop < self->count) && (head_of(self, kind, drop)->end <= cycle)) {
        drop++;
    }
    for (uint32_t b = drop; (drop > 0) && (b < self->count); b++) {
        copy_block(self, kind, b - drop, b);
    }
    self->count -= drop;
    reduce(self, kind, before);
    return drop;
}

/* ---------------------------------------------------------------- memory that was changed */

/* Instants and target decide whether blocks merge, and so whether blocks are free. */
bool zygos_store_intact(const zygos_store_t *self, uint32_t kind, bool used)
{
    zygos_store_t *all = readable(self);
    const double open = head_of(all, kind, open_of(kind))->total;
    bool good = zygos_store_steady(self) && (self->task < ZYGOS_STORE_TASKS) && (self->place < places_of(kind)) &&
                (self->part <= layout_of(kind)->parts) && (self->row <= ZYGOS_MAX_ANY_ROW) &&
                (self->count <= places_of(kind)) && is_factor(self->noise_fade) && (self->noise_fade > 0.0) &&
                is_count(open) && ((self->closing_cycles == 0) || is_count(zygos_store_closing(self, kind)->total)) &&
                (used ? (self->target >= 1.0) && is_count(self->target)
                      : (self->count == 0) && (self->task == ZYGOS_STORE_NONE) && !(open > 0.0));
    for (uint32_t b = 0; good && (b < self->count); b++) {
        good = is_count(head_of(all, kind, b)->total) && is_factor(head_of(all, kind, b)->fade);
    }
    return good;
}

double zygos_store_check(const zygos_store_t *self, uint32_t kind)
{
    zygos_store_t *all = readable(self);
    bool whole = (self->corrupt == 0) && (self->checksum == checksum_of(self));
    for (uint32_t b = 0; whole && (b < self->count); b++) {
        whole = is_sealed(all, kind, b) && (worst_of(all, kind, b) <= 1.0);
    }
    whole = whole && is_open_whole(all, kind) &&
            (!sums_noise(kind) || (violation(noise_of(all, kind, CLOSED), zygos_store_instants(self, kind)) <= 1.0));
    return whole ? 0.0 : 2.0;
}

static bool is_block_whole(zygos_store_t *self, uint32_t kind, uint32_t place)
{
    const zygos_block_head_t *head = head_of(self, kind, place);
    return is_sealed(self, kind, place) && is_count(head->total) && is_factor(head->fade) &&
           (worst_of(self, kind, place) <= 1.0);
}

/* Drops the blocks that do not match. Returns false where the noise of all does not. */
static bool quarantine(zygos_store_t *self, uint32_t kind)
{
    double before = 0.0;
    double after = 0.0;
    uint32_t to = 0;
    for (uint32_t b = 0; b < self->count; b++) {
        const double total = total_of(self, kind, b);
        before += is_count(total) ? total : 0.0;
        if (is_block_whole(self, kind, b)) {
            after += total;
            if (to != b) {
                copy_block(self, kind, to, b);
            }
            to++;
        }
    }
    if (sums_noise(kind) && !(violation(noise_of(self, kind, CLOSED), before) <= 1.0)) {
        return false;
    }
    if (to < self->count) {
        self->quarantined += self->count - to;
        fade_noise(self, kind, (before > 0.0) ? after / before : 0.0);
    }
    self->count = to;
    reseal(self);
    return true;
}

bool zygos_store_scrub(zygos_store_t *self, uint32_t kind)
{
    if (((self->checksum != checksum_of(self)) && !repair(self)) || (self->corrupt == 1u) ||
        (self->count > places_of(kind)) || !is_factor(self->noise_fade) || !(self->noise_fade > 0.0)) {
        return false;
    }
    const bool moved = (self->twin != zygos_store_twin(self)); /* the noise may be that of the other arc */
    if (moved || (self->task != ZYGOS_STORE_NONE) || (self->closing_cycles > 0)) {
        self->quarantined++;
        drop_closing(self, kind);
    }
    if (moved) {
        drop_open(self, kind);
    }
    self->place = 0;
    self->corrupt = 0;
    begin_part(self, kind, 0);
    if (!quarantine(self, kind)) {
        return false;
    }
    if (!is_open_whole(self, kind)) {
        self->quarantined++;
        drop_open(self, kind);
    }
    return true;
}
