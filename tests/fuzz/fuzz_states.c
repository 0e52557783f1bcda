/* SPDX-License-Identifier: MIT */
/* Stores states of an arm at work, changes them, seals them again, and goes on with them: whatever was in a file with a
 * good CRC, zygos_arm_resume() refuses it and leaves it as it was, or all that follows stays within its memory, under
 * the sanitizers this is compiled with. The same of work that is changed before zygos_work_solve(), and of
 * configurations.
 *
 * Usage: fuzz_states SEED TRIES JOINTS. Prints counts; status 1 and a message when a check failed. */

#include <math.h>
#include <stddef.h>

#include "traffic.h"

#define STATES 24u
#define CYCLES_BETWEEN 97u
#define ROTOR_INERTIA 2e-3
#define CODES_PER_RAD (1.0 / ZYGOS_ANGLE_UNIT)

static zygos_arm_t good[STATES];
static uint64_t good_cycle[STATES];
static zygos_arm_t arm;
static zygos_arm_t before;
static zygos_work_t work;
static zygos_solver_t solver;
static zygos_estimate_t estimate;
static slot_t slot[4 + 2 * ZYGOS_MAX_JOINTS];
static uint32_t slot_count;

static void check(bool holds, const char *what)
{
    if (!holds) {
        printf("%s\n", what);
        exit(1);
    }
}

static double noise(void)
{
    return (double)below(2001) / 1000.0 - 1.0;
}

/* Rotors that obey their torques, and so little of everything else that the balance closes: the solver finds values. */
static zygos_record_t motion_of(slot_t at, uint64_t cycle)
{
    zygos_record_t record = record_of(at, cycle);
    memset(record.code, 0, sizeof record.code);
    /* A torque is held until the next cycle. */
    const double held = (at.message == ZYGOS_MSG_TORQUE) ? 0.5 : 0.0;
    const double t = 1e-6 * PERIOD_US * ((double)cycle + held);
    const double w[2] = { 0.3 + 0.05 * at.node, 0.9 + 0.07 * at.node };
    const double angle = 0.8 * sin(w[0] * t) + 0.3 * sin(w[1] * t);
    const double acceleration = -0.8 * w[0] * w[0] * sin(w[0] * t) - 0.3 * w[1] * w[1] * sin(w[1] * t);
    if (at.message == ZYGOS_MSG_ANGLES) {
        record.code[0] = (int32_t)(CODES_PER_RAD * (angle + 0.001 * sin(1.7 * w[0] * t) + 1e-5 * noise()));
        record.code[1] = (int32_t)(CODES_PER_RAD * (angle + 1e-5 * noise()));
    } else if (at.message == ZYGOS_MSG_TORQUE) {
        record.code[0] = (int32_t)(ZYGOS_TORQUE_CODES * 50.0 * ROTOR_INERTIA * acceleration);
    } else if ((at.message == ZYGOS_MSG_RATE_XY) || (at.message == ZYGOS_MSG_RATE_Z)) {
        record.code[0] = (int32_t)(ZYGOS_RATE_FINE_CODES * (0.05 * sin(0.5 * t) + 1e-5 * noise()));
        record.code[1] = (int32_t)(ZYGOS_RATE_FINE_CODES * (0.04 * sin(0.4 * t) + 1e-5 * noise()));
    }
    return record;
}

static void run(uint64_t from, uint64_t cycles)
{
    for (uint64_t cycle = from; cycle < from + cycles; cycle++) {
        for (uint32_t i = 0; i < slot_count; i++) {
            const zygos_record_t record = motion_of(slot[i], cycle);
            const zygos_frame_t frame = encode(&record, slot[i]);
            check(zygos_arm_frame(&arm, &frame) >= 0, "a frame was refused");
        }
        for (uint32_t i = 0; (i < 2u * ZYGOS_CYCLE_QUEUE) && (zygos_arm_step(&arm) == 1); i++) {
        }
    }
}

/* What decides about places and lengths lies here; elsewhere are mostly sums. */
typedef struct {
    size_t offset;
    size_t size;
} region_t;

#define REGIONS (22u + ZYGOS_MAX_BLOCKS + ZYGOS_MAX_MOTOR_BLOCKS + ZYGOS_MOMENTUM_PLACES)
#define BETWEEN(type, first, end)                                                                                      \
    {                                                                                                                  \
        offsetof(type, first), offsetof(type, end) - offsetof(type, first)                                             \
    }

static uint32_t regions_of_sums(region_t *out, size_t accumulator, size_t joints, size_t momenta)
{
    static const region_t scalars[4] = { BETWEEN(zygos_accumulator_t, width, mean), BETWEEN(zygos_store_t, count, scan),
                                         BETWEEN(zygos_motor_sums_t, column_map, noise),
                                         BETWEEN(zygos_momentum_sums_t, columns, noise_open) };
    uint32_t n = 0;
    out[n++] = (region_t){ accumulator + scalars[0].offset, scalars[0].size };
    out[n++] = (region_t){ accumulator, scalars[1].size };
    out[n++] = (region_t){ joints, scalars[1].size };
    out[n++] = (region_t){ momenta, scalars[1].size };
    out[n++] = (region_t){ joints + scalars[2].offset, scalars[2].size };
    out[n++] = (region_t){ momenta + scalars[3].offset, scalars[3].size };
    for (uint32_t s = 0; s < ZYGOS_ROW_BUFFERS; s++) {
        out[n++] = (region_t){ accumulator + offsetof(zygos_accumulator_t, buffer) + s * sizeof(zygos_row_buffer_t) +
                                   offsetof(zygos_row_buffer_t, instants),
                               40 };
    }
    for (uint32_t b = 0; b < ZYGOS_MAX_BLOCKS; b++) {
        out[n++] = (region_t){ accumulator + offsetof(zygos_accumulator_t, block) + b * sizeof(zygos_block_t) +
                                   offsetof(zygos_block_t, square),
                               56 };
    }
    for (uint32_t b = 0; b <= ZYGOS_MAX_MOTOR_BLOCKS; b++) {
        out[n++] = (region_t){ joints + offsetof(zygos_motor_sums_t, block) + b * sizeof(zygos_motor_block_t) +
                                   offsetof(zygos_motor_block_t, head),
                               24 };
    }
    for (uint32_t b = 0; b <= ZYGOS_MOMENTUM_PLACES; b++) {
        out[n++] = (region_t){ momenta + offsetof(zygos_momentum_sums_t, block) + b * sizeof(zygos_momentum_block_t) +
                                   offsetof(zygos_momentum_block_t, head),
                               24 };
    }
    return n;
}

static uint32_t regions_of_state(region_t *out)
{
    uint32_t n = regions_of_sums(out, offsetof(zygos_arm_t, sums.energy), offsetof(zygos_arm_t, sums.motors),
                                 offsetof(zygos_arm_t, sums.momentum));
    out[n++] = (region_t){ 0, offsetof(zygos_arm_t, sums.config) };
    out[n++] = (region_t){ offsetof(zygos_arm_t, sums.column_map), sizeof(zygos_column_map_t) };
    out[n++] = (region_t){ offsetof(zygos_arm_t, receiver), offsetof(zygos_receiver_t, queue.slot) };
    out[n++] = (region_t){ offsetof(zygos_arm_t, previous), sizeof(zygos_previous_cycle_t) };
    out[n++] = (region_t){ offsetof(zygos_arm_t, smoother), 16 };
    out[n++] = (region_t){ offsetof(zygos_arm_t, noise), sizeof(zygos_noise_t) };
    out[n++] = (region_t){ offsetof(zygos_arm_t, balance), 16 };
    return n;
}

static uint32_t regions_of_work(region_t *out)
{
    uint32_t n = regions_of_sums(out, offsetof(zygos_work_t, sums.energy), offsetof(zygos_work_t, sums.motors),
                                 offsetof(zygos_work_t, sums.momentum));
    out[n++] = (region_t){ offsetof(zygos_work_t, sums.config), sizeof(zygos_config_t) };
    out[n++] = (region_t){ offsetof(zygos_work_t, sums.cycle), 8 };
    return n;
}

/* One to three bits, words or numbers, or the same number in neighbouring blocks; of size 0: in the regions only. */
static void change(void *memory, size_t size, const region_t *region, uint32_t regions)
{
    static const uint32_t words[] = { 0, 1,  2,           3,           4,           7,           8,
                                      9, 17, 0x7FFFFFFFu, 0x80000000u, 0xFFFFFFFFu, 0xFFFFFFFEu, 0xFFFFFFF8u };
    static const double numbers[] = { 0.0,    -1.0,   0.5,    1.0,      1e16,      -1e16,      1e300,
                                      -1e300, 1e-300, 5e-324, INFINITY, -INFINITY, (double)NAN };
    unsigned char *bytes = memory;
    if (below(8) == 0) {
        const double number = numbers[below(13)];
        const uint32_t first = below(regions);
        const uint32_t length = 1u + below(16);
        for (uint32_t r = first; (r < first + length) && (r < regions) && (region[r].size == region[first].size); r++) {
            if (region[r].size >= 8u) {
                memcpy(&bytes[region[r].offset], &number, 8);
            }
        }
        return;
    }
    for (uint32_t times = 1u + below(3); times > 0; times--) {
        const region_t at = region[below(regions)];
        const uint32_t kind = below(8);
        if ((kind == 0) && (size > 0)) {
            bytes[(size_t)draw() % size] ^= (unsigned char)(1u << below(8));
        } else if (kind == 1) {
            bytes[at.offset + (size_t)draw() % at.size] ^= (unsigned char)(1u << below(8));
        } else if (kind < 6) {
            const uint32_t word = (kind == 2) ? (uint32_t)draw() : ((kind == 3) ? below(300) : words[below(14)]);
            memcpy(&bytes[at.offset + 4u * below((uint32_t)at.size / 4u)], &word, 4);
        } else if (at.size >= 8u) {
            memcpy(&bytes[at.offset + 8u * below((uint32_t)at.size / 8u)], &numbers[below(13)], 8);
        }
    }
}

/* Whoever can change a state can seal it, too: what lies behind the seals must hold by itself. */
static void forge_store(zygos_store_t *store)
{
    store->checksum = zygos_checksum_memory(0u, store, (uint32_t)offsetof(zygos_store_t, checksum));
    store->twin = zygos_store_twin(store);
}

/* From the first number that is under the checksum; it continues with what was before. */
static void forge_head(zygos_block_head_t *head, const void *first, uint64_t checksum)
{
    const uint32_t bytes = (uint32_t)((const unsigned char *)&head->checksum - (const unsigned char *)first);
    head->checksum = (head->checksum == 0) ? 0u : zygos_checksum_memory(checksum, first, bytes);
}

static void forge(zygos_accumulator_t *sums, zygos_motor_sums_t *joints, zygos_momentum_sums_t *momenta)
{
    const uint32_t width = (sums->width < (uint32_t)ZYGOS_MAX_ROW) ? sums->width : (uint32_t)ZYGOS_MAX_ROW;
    forge_store(&sums->store);
    sums->twin = zygos_accumulator_twin(sums);
    for (uint32_t b = 0; b < ZYGOS_MAX_BLOCKS; b++) {
        zygos_block_t *block = &sums->block[b];
        const double *deviation = &block->gram[(width > 0) ? zygos_gram_entries(width - 1u) : 0u];
        forge_head(&block->head, &block->square, zygos_checksum_doubles(1u, deviation, width));
    }
    forge_store(&joints->store);
    for (uint32_t b = 0; b <= ZYGOS_MAX_MOTOR_BLOCKS; b++) {
        forge_head(&joints->block[b].head, joints->block[b].instants, 1u);
    }
    forge_store(&momenta->store);
    for (uint32_t b = 0; b <= ZYGOS_MOMENTUM_PLACES; b++) {
        forge_head(&momenta->block[b].head, &momenta->block[b].head, 1u);
    }
}

static void store_states(const zygos_config_t *config)
{
    check(zygos_arm_init(&arm, config) == 1, "zygos_arm_init refuses the configuration");
    uint64_t cycle = 0;
    for (uint32_t k = 0; k < STATES; k++) {
        run(cycle, CYCLES_BETWEEN);
        cycle += CYCLES_BETWEEN;
        good[k] = arm;
        good_cycle[k] = cycle;
    }
}

/* Memory of the sums that changes in flight, between two cycles, and is verified now and then. */
static void fly_on(uint64_t from, uint64_t cycles, const region_t *region, uint32_t regions,
                   const zygos_config_t *config)
{
    change(&arm, 0, region, regions);
    run(from, cycles);
    if (below(2) == 0) {
        change(&arm, 0, region, regions);
        check(zygos_arm_scrub(&arm, config) >= 0, "not scrubbed");
        run(from + cycles, cycles);
    }
}

/* A word of so many bytes: in one of the regions, or anywhere. */
static size_t word_of(size_t size, const region_t *region, uint32_t regions)
{
    const region_t at = region[below(regions)];
    return (below(4) == 0) ? (size_t)draw() % (sizeof arm / size) : (at.offset + below((uint32_t)at.size)) / size;
}

/* The same bit of two words, some words, or all of *self but its magic number and, mostly, its configuration. */
static void upset(zygos_arm_t *self, const region_t *region, uint32_t regions)
{
    unsigned char *bytes = (unsigned char *)self;
    const uint32_t kind = below(8);
    if (kind < 6u) {
        const size_t size = (kind < 4u) ? 4u : 8u;
        const size_t bit = (below(3) == 0) ? (size_t)draw() % (8u * size) : below(8);
        for (uint32_t k = 0; k < 2u; k++) {
            bytes[word_of(size, region, regions) * size + bit / 8u] ^= (unsigned char)(1u << (bit % 8u));
        }
    } else if (kind == 6u) {
        for (uint32_t times = 1u + below(4); times > 0; times--) {
            const uint32_t word = (below(2) == 0) ? (uint32_t)draw() : below(200);
            memcpy(bytes + 4u * ((size_t)draw() % (sizeof *self / 4u)), &word, sizeof word);
        }
    } else {
        const uint32_t magic = self->magic;
        const zygos_config_t configured = self->sums.config;
        for (size_t at = 0; at < sizeof *self; at++) {
            bytes[at] = (unsigned char)draw();
        }
        self->magic = magic;
        self->sums.config = (below(4) == 0) ? self->sums.config : configured;
    }
}

/* Every call on a state that memory errors have changed, until it is scrubbed. Returns whether that repaired it. */
static bool misuse(uint64_t from, const zygos_config_t *config, const region_t *region, uint32_t regions)
{
    upset(&arm, region, regions);
    for (uint32_t times = below(4); times > 0; times--) {
        const uint32_t call = below(8);
        if (call == 0) {
            (void)zygos_arm_end_arcs(&arm);
        } else if (call == 1) {
            (void)zygos_arm_restart(&arm, below(4));
        } else if (call == 2) {
            (void)zygos_arm_check(&arm, config, &work);
        } else if (call == 3) {
            zygos_arm_take(&arm, &work);
            (void)zygos_work_solve(&work, &estimate);
        } else if (call == 4) {
            (void)zygos_arm_adopt(&arm, &estimate);
        } else if (call == 5) {
            (void)zygos_arm_resume(&arm, config);
        } else if (call == 6) {
            (void)zygos_arm_solve(&arm, &solver, &estimate);
        } else {
            for (uint32_t i = 0; i < 3u * slot_count; i++) {
                const zygos_record_t record = motion_of(slot[i % slot_count], from + i / slot_count);
                const zygos_frame_t frame = encode(&record, slot[i % slot_count]);
                (void)zygos_arm_frame(&arm, &frame);
                (void)zygos_arm_step(&arm);
            }
        }
    }
    const int found = zygos_arm_scrub(&arm, config);
    if (found >= 0) {
        run(from + 3u, 25u);
        check(zygos_arm_scrub(&arm, config) >= 0, "not scrubbed again");
    }
    return found >= 0;
}

static int solve(void)
{
    zygos_arm_take(&arm, &work);
    return zygos_work_solve(&work, &estimate);
}

int main(int count, char **argument)
{
    if (count != 4) {
        printf("usage: fuzz_states SEED TRIES JOINTS\n");
        return 2;
    }
    random_state = strtoull(argument[1], NULL, 10) * 2u + 1u;
    const uint64_t tries = strtoull(argument[2], NULL, 10);
    const uint32_t joints = (uint32_t)strtoul(argument[3], NULL, 10);
    slot_count = slots(slot, joints, 1);
    zygos_config_t config = config_of(joints, 1);
    for (uint32_t i = 0; i < joints; i++) {
        config.joint[i].link_sigma_rad = config.joint[i].motor_sigma_rad = 1e-4;
    }
    config.imu_sigma = 1e-5;
    config.arc_cycles = 60;
    config.impulse_arc_cycles = 30;
    config.momentum_arc_cycles = (ZYGOS_MOMENTUM != 0) ? 30u : 0u;
    store_states(&config);

    static region_t of_state[REGIONS];
    static region_t of_work[REGIONS];
    static region_t of_sums[REGIONS];
    const region_t of_config = { 0, sizeof(zygos_config_t) };
    const uint32_t state_regions = regions_of_state(of_state);
    const uint32_t work_regions = regions_of_work(of_work);
    const uint32_t sums_regions =
        regions_of_sums(of_sums, offsetof(zygos_arm_t, sums.energy), offsetof(zygos_arm_t, sums.motors),
                        offsetof(zygos_arm_t, sums.momentum));
    uint64_t refused_state = 0;
    uint64_t refused_otherwise = 0;
    uint64_t resumed = 0;
    uint64_t configured = 0;
    uint64_t values = 0;
    uint64_t corrupt = 0;
    uint64_t in_place = 0;
    uint64_t scrubbed = 0;
    for (uint64_t k = 0; k < tries; k++) {
        uint8_t head[ZYGOS_SNAPSHOT_HEAD];
        const uint32_t from = below(STATES);
        arm = good[from];
        change(&arm, sizeof arm, of_state, state_regions);
        if (k % 4u != 0) {
            forge(&arm.sums.energy, &arm.sums.motors, &arm.sums.momentum);
        }
        check(zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, &arm, head) == 1, "not sealed");
        check(zygos_snapshot_check(ZYGOS_SNAPSHOT_STATE, head, &arm, sizeof head + sizeof arm) == 1,
              "not what was sealed");
        memcpy(&before, &arm, sizeof arm);
        const int verdict = zygos_arm_resume(&arm, &config);
        if (verdict < 0) {
            refused_state += (verdict == ZYGOS_E_STATE) ? 1u : 0u;
            refused_otherwise += (verdict == ZYGOS_E_STATE) ? 0u : 1u;
            check(memcmp(&arm, &before, sizeof arm) == 0, "refused, but changed");
        } else {
            resumed++;
            run(good_cycle[from] + below(500), (k % 8u == 0) ? 150u : 25u);
            values += (solve() == 1) ? 1u : 0u;
            corrupt += (estimate.reason == ZYGOS_REASON_CORRUPT) ? 1u : 0u;
        }
        arm = good[from];
        fly_on(good_cycle[from], (k % 8u == 0) ? 150u : 25u, of_sums, sums_regions, &config);
        (void)solve();
        if (zygos_arm_solve(&arm, &solver, &estimate) == 1) {
            in_place++;
            check(zygos_arm_scrub(&arm, &config) >= 0, "not scrubbed behind a solution in place");
        }
        run(good_cycle[from] + 500u, 25u);
        for (uint32_t times = 0; times < 4u; times++) {
            arm = good[from];
            scrubbed += misuse(good_cycle[from], &config, of_state, state_regions) ? 1u : 0u;
        }
        zygos_config_t wild = config;
        change(&wild, sizeof wild, &of_config, 1);
        if (zygos_arm_init(&arm, &wild) == 1) {
            configured++;
            run(0, (k % 8u == 0) ? 150u : 25u);
            (void)solve();
        }
        zygos_arm_take(&good[from], &work);
        change(&work, sizeof work, of_work, work_regions);
        if (k % 4u != 0) {
            forge(&work.sums.energy, &work.sums.motors, &work.sums.momentum);
        }
        values += (zygos_work_solve(&work, &estimate) == 1) ? 1u : 0u;
        corrupt += (estimate.reason == ZYGOS_REASON_CORRUPT) ? 1u : 0u;
    }
    printf("resumed %" PRIu64 "\nrefused_state %" PRIu64 "\nrefused_otherwise %" PRIu64 "\nvalues %" PRIu64
           "\ncorrupt %" PRIu64 "\nconfigured %" PRIu64 "\nin_place %" PRIu64 "\nscrubbed %" PRIu64 "\n",
           resumed, refused_state, refused_otherwise, values, corrupt, configured, in_place, scrubbed);
    return 0;
}
