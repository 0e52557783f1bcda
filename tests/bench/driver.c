/* SPDX-License-Identifier: MIT */
/* Flies the loop of an onboard program with recorded frames, and says of each cycle what it was, for a tool that counts
   its instructions: zygos_frame() for all frames of the cycle, one zygos_step(), and, behind a mark, zygos_solve().
   Reads run.bin: three uint32 (size of a configuration, size of a frame, number of frames), the configuration and the
   frames as they lie in memory. Writes places.bin: the sizes below, then a record for each cycle, all of uint32, then
   rank and validity of a solution. What is solved is the state in state.bin, zygos_arm_t as it lies in memory; where
   there is none, it is the state behind the frames, which is stored in end.bin. */

#include "semihosting.h"
#include "zygos/priv/gram.h"
#include "zygos/zygos.h"

#include <stddef.h>

int main(void);
void driver_mark(void);

static zygos_t loop;
static zygos_background_t memory;
static zygos_estimate_t estimate;
static zygos_receiver_t listener; /* tells which frame completes a cycle, which the library finds in zygos_step() */

/* Bytes of state in this build. */
static struct {
    uint32_t parameters, cycle, smoother, kinematics, balance, impulse, momentum, joint, noise, accumulator, tables,
        handover, whole, solver;
} sizes = {
    .cycle = (uint32_t)(sizeof(zygos_receiver_t) + sizeof(zygos_previous_cycle_t)),
    .smoother = (uint32_t)(sizeof(zygos_smoother_t) + sizeof(zygos_arm_state_t)),
    .kinematics = (uint32_t)(sizeof(zygos_geometry_t) + sizeof(zygos_motion_t)),
    .balance = (uint32_t)(sizeof(zygos_column_map_t) + sizeof(zygos_balance_t) + sizeof(zygos_row_t)),
    .impulse = (uint32_t)(sizeof(zygos_impulse_t) + sizeof(zygos_impulse_rows_t) + sizeof(zygos_motor_sums_t)),
    .momentum = (uint32_t)(sizeof(zygos_momentum_t) + sizeof(zygos_momentum_sums_t)),
    .joint = (uint32_t)(sizeof(zygos_joint_t) + sizeof(zygos_joint_row_t) + sizeof(zygos_joint_sums_t)),
    .noise = (uint32_t)sizeof(zygos_noise_t),
    .accumulator = (uint32_t)sizeof(zygos_accumulator_t),
    .tables = (uint32_t)sizeof(zygos_patrol_t),
    .handover = (uint32_t)sizeof(zygos_handover_t),
    .whole = (uint32_t)sizeof(zygos_t),
    .solver = (uint32_t)(sizeof(zygos_background_t) + sizeof(zygos_estimate_t)),
};

enum kind {
    KIND_FILLS, /* the windows are not full yet: no row */
    KIND_BLOCK, /* the row opens a segment, and so a block of the normal equations; a task begins or ends; or a segment
                   of joint rows is complete */
    KIND_ARC,   /* the row begins or ends its arc, or that of the motor or momentum rows */
    KIND_CYCLE, /* any other row */
    KIND_WAITS, /* an arc waits for its end, or has waited until this cycle */
    KIND_HANDS  /* a part of the sums is copied for a solution, or its estimate is adopted */
};

/* What a cycle was, and all on which its cost may depend beside its data: its frames, whose turn it is, and where rings
   and steps stand. Of the joint rows: which one is formed, the step in the half of an increment, the signal whose noise
   is added, what is moved of a complete segment, and where the adding of rows that wait stands. */
typedef struct {
    uint32_t kind, frames, turn, joint_turn, momentum_turn, filled, torque_at, position, first;
    uint32_t row_turn, row_step, row_signal, row_moved, row_waits;
    uint32_t energy_task, motor_task, momentum_task;
    uint32_t stage, patrol, copy;
} place_t;

/* The slices that have been added of a buffer behind the one that is filled. */
static uint32_t shared(const zygos_accumulator_t *sums, uint32_t behind)
{
    return sums->buffer[(sums->filling + behind) % ZYGOS_ROW_BUFFERS].shared;
}

/* The part of a task that a cycle does, or what decides which one begins. */
static uint32_t task_of(const zygos_store_t *store, uint32_t kind, uint32_t places)
{
    const uint32_t closing = zygos_store_closing(store) ? 1u : 0u;
    const uint32_t noise = ((closing == 1u) && zygos_store_is_noise(store)) ? 1u : 0u;
    const uint32_t work = zygos_store_has_work(store, kind) ? 1u : 0u;
    const uint32_t dirty = (places - store->count > store->ready) ? 1u : 0u;
    return (store->task << 16u) | (closing << 15u) | (noise << 14u) | (work << 13u) | (dirty << 12u) |
           ((store->task != ZYGOS_TASK_NONE) ? (store->part << 8u) | store->row : 0u);
}

/* What counts instructions sees this call behind each cycle, and behind the background's work that follows it. */
__attribute__((noinline)) void driver_mark(void)
{
    __asm__ volatile("" ::: "memory");
}

static place_t step(uint32_t frames)
{
    const zygos_arm_t *const arm = &loop.state;
    const zygos_accumulator_t *sums = &arm->sums.energy;
    const zygos_config_t *config = &arm->sums.config;
    const double segment = sums->segment;
    const zygos_store_t *store = &sums->store;
    const zygos_store_t *motor_store = &arm->sums.motors.store;
    const zygos_store_t *momentum_store = &arm->sums.momentum.store;
    const uint32_t blocks = store->count;
    const uint32_t arcs = store->arcs + store->arcs_dropped;
    const zygos_joint_sums_t *joints = &arm->sums.joints;
    const uint64_t segments = joints->segments;
    const uint64_t instants = joints->accepted + joints->refused;
    const uint32_t row = (arm->joint.turn < config->joints) ? 1u + arm->joint.turn : 0u;
    const uint32_t complete = (arm->joint.halves == 3u) ? 1u : 0u; /* else the row is formed but not added */
    const uint32_t signal = joints->turn;
    const uint32_t cursor = joints->cursor;
    const uint32_t adding = joints->adding;
    /* rows that wait are added where none is formed; elsewhere only whether there are any decides */
    const uint32_t added = (row == 0) ? joints->pass * joints->width + joints->row : 0u;
    const uint32_t waits = (joints->waiting > 0) ? 1u + added : 0u;
    const uint32_t tasks[3] = { store->task, motor_store->task, momentum_store->task };
    const uint32_t of_energy = task_of(store, ZYGOS_ENERGY_ROWS, ZYGOS_MAX_BLOCKS) | (shared(sums, 1u) << 24u) |
                               (shared(sums, 2u) << 19u); /* and what is added from buffers beside it */
    const uint32_t of_motors = task_of(motor_store, ZYGOS_MOTOR_ROWS, ZYGOS_MAX_MOTOR_BLOCKS + 1u);
    const uint32_t of_momentum = task_of(momentum_store, ZYGOS_MOMENTUM_ROWS, ZYGOS_MOMENTUM_PLACES + 1u);
    const bool work[2] = { zygos_store_has_work(motor_store, ZYGOS_MOTOR_ROWS),
                           zygos_store_has_work(momentum_store, ZYGOS_MOMENTUM_ROWS) };
    const uint32_t ending = arm->sums.ending;
    const bool has_work = zygos_store_has_work(store, ZYGOS_ENERGY_ROWS);
    const uint32_t stage = loop.stage;
    const uint32_t patrol = (loop.patrol.region << 16u) | loop.patrol.offset;
    (void)zygos_step(&loop);
    driver_mark();
    const bool turned =
        (store->task != tasks[0]) || (motor_store->task != tasks[1]) || (momentum_store->task != tasks[2]);
    /* a cycle that is for the tasks of the energy rows asks nothing of the others */
    const uint32_t yields = (has_work && ((arm->cycles & 1u) == 0u)) ? 1u << 31u : 0u;
    /* what else a cycle has done, of which one part is enough: a joint row, or a task of the other rows */
    const bool motors = (yields == 0) && work[0];
    const bool momentum = (yields == 0) && work[1];
    const uint32_t busy = ((row > 0) && (complete == 1u)) ? 3u : (motors ? 2u : (momentum ? 1u : 0u));
    const bool energy = (config->arc_cycles > 0);
    const bool instant = energy ? (arm->instant == 1) : (joints->accepted + joints->refused != instants);
    const uint32_t left = config->joint_row_cycles / 2u - arm->joint.position;
    const bool others = ((config->impulse_arc_cycles > 0) && (arm->sums.motors.store.cycles <= 1)) ||
                        ((config->momentum_arc_cycles > 0) && (arm->sums.momentum.store.cycles <= 1));
    const bool edge = others || (energy && ((store->arcs + store->arcs_dropped != arcs) || (arm->sums.arc <= 1)));
    const bool first = (arm->sums.arc <= (uint32_t)ZYGOS_BUFFER_ROWS); /* nothing is shared out yet */
    const bool opened = (sums->segment < segment) || (store->count != blocks) || (first && (sums->filled == 0));
    const bool block = (energy && opened) || turned || (joints->segments != segments);
    const uint32_t kind = edge ? KIND_ARC : (block ? KIND_BLOCK : KIND_CYCLE);
    const uint32_t sensors = (config->compensation > 0) ? config->compensation : 1u;
    const uint32_t first_link =
        ((arm->sums.arc % sensors) == 1u) ? 1u : 0u; /* its noise was added: no part of a task */
    const bool hands = (arm->beside != 0) || (stage == (uint32_t)ZYGOS_STAGE_SOLVED);
    const uint32_t usual = hands ? KIND_HANDS : (instant ? kind : KIND_FILLS);
    return (place_t){
        .kind = ((ending | arm->sums.ending) != 0u) ? KIND_WAITS : usual,
        .frames = frames,
        .turn = (arm->sums.arc + sensors - 1u) % sensors,
        .joint_turn = arm->sums.motors.store.cycles % config->joints,
        .momentum_turn = arm->sums.momentum.store.cycles % (3u * (config->joints + 3u)),
        .filled = sums->filled,
        .torque_at = arm->balance.torque_at,
        .position = arm->smoother.position,
        .first = first ? 1u : 0u,
        .row_turn = 2u * row + complete,
        .row_step = (left < 3u) ? left : ((arm->joint.position == 0) ? 0u : 4u), /* 0: at the end of a half */
        .row_signal = (row > 0) ? signal : 0u,
        .row_moved =
            adding + (((adding == 1u) && (cursor + joints->slice >= zygos_gram_entries(joints->width))) ? 2u : 0u),
        .row_waits = waits,
        .energy_task = of_energy | (first_link << 29u) | (busy << 30u),
        .motor_task = of_motors | yields,
        .momentum_task = of_momentum | yields,
        .stage = stage,
        .patrol = patrol,
        .copy = 2u * loop.handover.kind + ((loop.handover.waited > 0) ? 1u : 0u), /* which copy waits */
    };
}

static int refuse(const char *why)
{
    semihosting_print(why);
    semihosting_print("\n");
    return 1;
}

int main(void)
{
    const int32_t run = semihosting_open("run.bin", SEMIHOSTING_READ);
    const int32_t places = semihosting_open("places.bin", SEMIHOSTING_WRITE);
    uint32_t head[3];
    zygos_config_t config;
    if ((run < 0) || (places < 0) || (semihosting_read(run, head, sizeof head) != sizeof head)) {
        return refuse("run.bin cannot be read or places.bin not written");
    }
    if ((head[0] != sizeof config) || (head[1] != sizeof(zygos_frame_t)) ||
        (semihosting_read(run, &config, sizeof config) != sizeof config)) {
        return refuse("run.bin was written with other headers or capacities");
    }
    config.abi = ZYGOS_ABI;
    if (zygos_init(&loop, &config, &memory, sizeof memory) < 0) {
        return refuse("the configuration is refused");
    }
    zygos_receiver_init(&listener);
    sizes.parameters = loop.state.sums.column_map.parameters;
    bool written = (semihosting_write(places, &sizes, sizeof sizes) == sizeof sizes);
    uint32_t frames = 0;
    for (uint32_t k = 0; k < head[2]; k++) {
        zygos_frame_t frame;
        if (semihosting_read(run, &frame, sizeof frame) != sizeof frame) {
            return refuse("frames are missing");
        }
        if ((zygos_frame(&loop, &frame) != 1) || (zygos_receiver_frame(&listener, &config, &frame) != ZYGOS_ACCEPTED)) {
            return refuse("a frame is not accepted");
        }
        frames++;
        if (zygos_receiver_front(&listener) != NULL) {
            zygos_receiver_pop(&listener);
            const place_t place = step(frames);
            (void)zygos_solve(&loop, &estimate);
            driver_mark();
            written = written && (semihosting_write(places, &place, sizeof place) == sizeof place);
            frames = 0;
        }
    }
    const int32_t flown = semihosting_open("state.bin", SEMIHOSTING_READ);
    if (flown >= 0) {
        if (semihosting_read(flown, &loop.state, sizeof loop.state) != sizeof loop.state) {
            return refuse("state.bin was written with other capacities");
        }
    } else {
        const int32_t end = semihosting_open("end.bin", SEMIHOSTING_WRITE);
        written = written && (end >= 0) &&
                  (semihosting_write(end, &loop.state, sizeof loop.state) == sizeof loop.state) &&
                  (semihosting_close(end) == 0);
    }
    zygos_arm_take(&loop.state, &memory.work);
    (void)zygos_work_solve(&memory.work, &estimate);
    const uint32_t found[2] = { estimate.rank, estimate.validity };
    written = (semihosting_write(places, found, sizeof found) == sizeof found) && written;
    return (written && (semihosting_close(places) == 0)) ? 0 : refuse("places.bin or end.bin cannot be written");
}
