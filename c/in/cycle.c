/* SPDX-License-Identifier: MIT */
#include "zygos/priv/cycle.h"

#include "zygos/priv/fields.h"
#include "zygos/priv/gram.h"
#include "zygos/priv/numbers.h"

#include <string.h>

/* A longer silence of FTIME could hide an outage of exactly 240 cycles, which the SYNC counter cannot see. */
#define MAX_CYCLES_WITHOUT_TIME 120u
/* Latch delays within this of the configured one cost less than 0.1 % of parameter error. */
#define LATCH_TOLERANCE_US 50
/* Error class of an error frame, as SocketCAN puts it into the identifier. */
#define BUS_OFF 0x40u
/* Of an identifier. */
#define NODE 0x7Fu
/* Of the data of a joint's or the gyro's frame. */
#define STATUS(data) ((uint32_t)(data)[1] >> 4)
#define HALF_RANGE_RAD 50.26548245743669
/* Of timed: there is an FTIME to compare with, and one before an outage of unknown length. */
#define TIMED 1u
#define RESUMED 2u

void zygos_receiver_init(zygos_receiver_t *self)
{
    memset(self, 0, sizeof *self);
    self->assembly.broken = ZYGOS_CYCLE_BREAK;
}

bool zygos_receiver_intact(const zygos_receiver_t *self)
{
    const uint32_t head = __atomic_load_n(&self->queue.head, __ATOMIC_ACQUIRE);
    return (head <= (uint32_t)ZYGOS_CYCLE_QUEUE) && (self->queue.tail <= (uint32_t)ZYGOS_CYCLE_QUEUE);
}

static uint32_t behind_cycle(uint32_t place)
{
    return (place == ZYGOS_CYCLE_QUEUE) ? 0u : place + 1u;
}

/* Turned by 1..31 places. For a place that is not known before, a core of 32 bits needs many instructions unless it is
   told that none is beyond a half. */
static uint64_t turned_bits(uint64_t bits, uint32_t place)
{
    if (sizeof(uintptr_t) == sizeof(uint32_t)) {
        const uint32_t low = (uint32_t)bits;
        const uint32_t high = (uint32_t)(bits >> 32u);
        return ((uint64_t)((high << place) | (low >> (32u - place))) << 32u) |
               ((low << place) | (high >> (32u - place)));
    }
    return (bits << place) | (bits >> (64u - place));
}

/* The exclusive or of all readings is that of a cycle, whatever their order. Each is turned by a place of its own, so
   that the same bit of two does not cancel: a rate by 1, 2 or 3, those of a joint by 4, 5 and 6, and by 3 more for each
   joint before it. These are turned by what they differ in before they are turned together. */
static uint64_t folded_joint(double q, double theta, double tau)
{
    return zygos_bits_of(q) ^ turned_bits(zygos_bits_of(theta), 1u) ^ turned_bits(zygos_bits_of(tau), 2u);
}

static uint64_t folded_rates(const double *omega)
{
    return turned_bits(zygos_bits_of(omega[0]), 1u) ^ turned_bits(zygos_bits_of(omega[1]), 2u) ^
           turned_bits(zygos_bits_of(omega[2]), 3u);
}

/* Of what is known when a cycle is complete. */
static uint64_t fold_of_head(const zygos_cycle_t *cycle)
{
    return cycle->sync ^ ((uint64_t)cycle->flags << 32u);
}

const zygos_cycle_t *zygos_receiver_front(const zygos_receiver_t *self)
{
    const zygos_queue_t *queue = &self->queue;
    const uint32_t head = __atomic_load_n(&queue->head, __ATOMIC_ACQUIRE);
    return (head == queue->tail) ? NULL : &queue->slot[queue->tail];
}

bool zygos_receiver_front_is_whole(const zygos_receiver_t *self, const zygos_config_t *config)
{
    const zygos_cycle_t *cycle = &self->queue.slot[self->queue.tail];
    uint64_t fold = 0;
    for (uint32_t i = config->joints; i > 0; i--) { /* each is turned by 3 for each joint before it */
        fold = turned_bits(fold, 3u) ^ folded_joint(cycle->q[i - 1u], cycle->theta[i - 1u], cycle->tau[i - 1u]);
    }
    fold = turned_bits(fold, 4u) ^ fold_of_head(cycle);
    fold ^= (config->imu_node != 0) ? folded_rates(cycle->omega) : 0u;
    return fold == self->queue.fold[self->queue.tail];
}

void zygos_receiver_pop(zygos_receiver_t *self)
{
    __atomic_store_n(&self->queue.tail, behind_cycle(self->queue.tail), __ATOMIC_RELEASE);
}

uint32_t zygos_receiver_discard(zygos_receiver_t *self)
{
    uint32_t waiting = 0;
    if (!zygos_receiver_intact(self)) {
        uint32_t head = __atomic_load_n(&self->queue.head, __ATOMIC_ACQUIRE);
        if (head > (uint32_t)ZYGOS_CYCLE_QUEUE) { /* the producer keeps its open cycle there */
            head = 0;
            __atomic_store_n(&self->queue.head, head, __ATOMIC_RELEASE);
        }
        __atomic_store_n(&self->queue.tail, head, __ATOMIC_RELEASE);
        return 0;
    }
    while ((waiting < (uint32_t)ZYGOS_CYCLE_QUEUE) && (zygos_receiver_front(self) != NULL)) {
        zygos_receiver_pop(self);
        waiting++;
    }
    return waiting;
}

void zygos_receiver_resume(zygos_receiver_t *self)
{
    self->faults.dropped += zygos_receiver_discard(self);
    self->assembly.received = 0;
    self->assembly.timed = (self->assembly.timed != 0) ? RESUMED : 0u;
    self->status.spoiled = 1;
}

/* zygos_arm_step() reports a number that cannot be. */
static uint32_t joints_of(const zygos_config_t *config)
{
    return (config->joints <= (uint32_t)ZYGOS_MAX_JOINTS) ? config->joints : 0u;
}

static zygos_cycle_t *open_cycle(zygos_receiver_t *self)
{
    const uint32_t head = self->queue.head; /* as with the number of joints */
    return &self->queue.slot[(head <= (uint32_t)ZYGOS_CYCLE_QUEUE) ? head : 0u];
}

/* Adds readings of a joint that have been stored, 0 for the others, and stores a rate of the gyro. */
static void fold_joint(zygos_receiver_t *self, uint32_t joint, uint64_t readings)
{
    self->assembly.fold ^= turned_bits(readings, 4u + 3u * joint);
}

static void store_rate(zygos_receiver_t *self, uint32_t axis, double rate)
{
    open_cycle(self)->omega[axis] = rate;
    self->assembly.fold ^= turned_bits(zygos_bits_of(rate), 1u + axis);
}

static void push(zygos_receiver_t *self)
{
    zygos_queue_t *queue = &self->queue;
    const uint32_t next = behind_cycle(queue->head);
    if (next == __atomic_load_n(&queue->tail, __ATOMIC_ACQUIRE)) {
        self->faults.overrun++;
        self->faults.dropped++;
        self->assembly.broken |= ZYGOS_CYCLE_BREAK;
        return;
    }
    __atomic_store_n(&queue->head, next, __ATOMIC_RELEASE);
    self->assembly.broken = 0;
}

/* How many cycles before the open one cannot be trusted, in its place among the flags. */
static uint32_t void_cycles(const zygos_assembly_t *a)
{
    const uint64_t most = UINT32_MAX >> ZYGOS_CYCLE_VOID_SHIFT;
    const uint64_t cycles = (a->sync - a->void_from < most) ? a->sync - a->void_from : most;
    return (a->broken & ZYGOS_CYCLE_VOID) ? (uint32_t)cycles << ZYGOS_CYCLE_VOID_SHIFT : 0u;
}

static void close_cycle(zygos_receiver_t *self, const zygos_config_t *config)
{
    zygos_assembly_t *a = &self->assembly;
    const uint32_t rates = (config->imu_node == 0) ? 0u : (config->imu_fine ? 2u : 1u);
    const uint32_t n = joints_of(config);
    const uint32_t all = (1u << (2u * n + rates)) - 1u;
    const bool complete = (n > 0) && (a->received == all);
    if (complete && !self->status.spoiled) {
        zygos_cycle_t *cycle = open_cycle(self);
        cycle->sync = a->sync;
        cycle->flags = a->broken | void_cycles(a);
        self->queue.fold[cycle - self->queue.slot] = a->fold ^ fold_of_head(cycle);
        push(self);
        return;
    }
    /* No flag is left for the next cycle: its number does not follow that of the last complete one. */
    self->faults.incomplete += complete ? 0u : 1u;
    self->faults.dropped++;
}

/* What is rare is not inline, so that a usual frame saves fewer registers. */
__attribute__((noinline)) static int reject_frame(zygos_receiver_t *self, uint32_t *fault)
{
    (*fault)++;
    self->status.last_verdict = ZYGOS_REJECTED;
    return ZYGOS_REJECTED;
}

static int spoil(zygos_receiver_t *self, uint32_t *fault)
{
    self->status.spoiled = 1;
    return reject_frame(self, fault);
}

__attribute__((noinline)) static int reject_wire(zygos_receiver_t *self, int fault)
{
    zygos_faults_t *f = &self->faults;
    return reject_frame(self,
                        (fault == ZYGOS_WIRE_LENGTH) ? &f->length : ((fault == ZYGOS_WIRE_CRC) ? &f->crc : &f->range));
}

static int accept(zygos_receiver_t *self)
{
    self->status.last_verdict = ZYGOS_ACCEPTED;
    return ZYGOS_ACCEPTED;
}

__attribute__((noinline)) static int take_sync(zygos_receiver_t *self, const zygos_config_t *config,
                                               const zygos_frame_t *frame)
{
    const uint32_t counter = frame->data[0];
    if ((frame->length != 1u) || (counter < 1u) || (counter > ZYGOS_SYNC_MODULUS)) {
        return reject_wire(self, zygos_wire_check(frame, ZYGOS_MSG_SYNC, 0));
    }
    zygos_assembly_t *a = &self->assembly;
    if (a->counter != 0) {
        const uint32_t step = (counter + ZYGOS_SYNC_MODULUS - a->counter) % ZYGOS_SYNC_MODULUS;
        if (step == 0) {
            /* Which of the two cycles a frame belongs to is unknown: the cycle is not used. */
            return spoil(self, &self->faults.sync_repeated);
        }
        close_cycle(self, config);
        if (step != 1) {
            self->faults.sync_jumped++;
            a->broken |= ZYGOS_CYCLE_BREAK;
        }
        a->sync += step;
        const uint32_t silence = a->since_time;
        a->since_time += (silence > MAX_CYCLES_WITHOUT_TIME) ? 0u : step;
        if (a->since_time > MAX_CYCLES_WITHOUT_TIME) {
            /* Counted once per silence; every cycle of a silence stands alone. */
            self->faults.time_lost += (silence <= MAX_CYCLES_WITHOUT_TIME) ? 1u : 0u;
            a->broken |= ZYGOS_CYCLE_BREAK;
        }
    }
    a->counter = counter;
    a->received = 0;
    a->fold = 0;
    self->status.spoiled = 0;
    return accept(self);
}

/* The counter tells the length of an outage modulo 240 cycles. The time since the FTIME before it tells the rest, where
   it fits. */
static void catch_up(zygos_receiver_t *self, const zygos_config_t *config, uint32_t time_us)
{
    zygos_assembly_t *a = &self->assembly;
    const double turn_s = ZYGOS_SYNC_MODULUS * config->period_s;
    const double elapsed_s = (double)(uint32_t)(time_us - a->time_us) * 1e-6;
    const double missing_s = elapsed_s - (double)(a->sync - a->time_sync) * config->period_s;
    const uint64_t turns = (missing_s > 0.0) ? (uint64_t)(missing_s / turn_s + 0.5) : 0u;
    const double error = missing_s - (double)turns * turn_s;
    const double tolerance = 0.5 * config->period_s;
    if ((error > tolerance) || (error < -tolerance)) {
        self->faults.time_jumped++;
        return;
    }
    a->sync += turns * ZYGOS_SYNC_MODULUS;
}

__attribute__((noinline)) static int take_time(zygos_receiver_t *self, const zygos_config_t *config,
                                               const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    zygos_assembly_t *a = &self->assembly;
    if (a->counter == 0) {
        return reject_frame(self, &self->faults.unsynced);
    }
    if ((record.sync != a->counter) || (record.counter != (a->counter & 0x0Fu))) {
        const uint32_t behind = (a->counter + ZYGOS_SYNC_MODULUS - record.sync) % ZYGOS_SYNC_MODULUS;
        const bool late = (behind == 1) && (record.counter == (record.sync & 0x0Fu));
        return reject_frame(self, late ? &self->faults.late : &self->faults.counter);
    }
    if (a->timed == RESUMED) {
        catch_up(self, config, record.time_us);
    } else if (a->timed == TIMED) {
        /* Modulo 2^32, nearest to 0: a clock that starts anew runs backwards. */
        const double elapsed_s = (double)(int32_t)(record.time_us - a->time_us) * 1e-6;
        const double counted_s = (double)(a->sync - a->time_sync) * config->period_s;
        const double error = elapsed_s - counted_s;
        const double tolerance = 0.5 * config->period_s;
        if ((error > tolerance) || (error < -tolerance)) {
            self->faults.time_jumped++;
            a->broken |= ZYGOS_CYCLE_BREAK;
        }
        if (error > tolerance) {
            /* Cycles were lost without a gap in the counters (240 of them), somewhere behind the last FTIME. A count
               that runs ahead of time, because of a false SYNC, has ended the arc already and lost nothing. */
            a->void_from = (a->broken & ZYGOS_CYCLE_VOID) ? a->void_from : a->time_sync;
            a->broken |= ZYGOS_CYCLE_VOID;
        }
    }
    a->timed = TIMED;
    a->time_us = record.time_us;
    a->time_sync = a->sync;
    a->since_time = 0;
    return accept(self);
}

/* What of a joint's status forbids the use of the cycle, or null. */
static uint32_t *status_fault(zygos_faults_t *faults, uint32_t status)
{
    const uint32_t all =
        ZYGOS_STATUS_ENABLED | ZYGOS_STATUS_LINK_VALID | ZYGOS_STATUS_MOTOR_VALID | ZYGOS_STATUS_TORQUE_VALID;
    if ((status & all) == all) {
        return NULL;
    }
    if (!(status & ZYGOS_STATUS_ENABLED)) {
        return &faults->disabled;
    }
    if (!(status & ZYGOS_STATUS_LINK_VALID)) {
        return &faults->link_invalid;
    }
    return (status & ZYGOS_STATUS_MOTOR_VALID) ? &faults->torque_invalid : &faults->motor_invalid;
}

/* The code of 24 bits behind a byte. Read with that byte, it is one load where the processor can. */
static int32_t code_behind(const uint8_t *data)
{
    const uint32_t word =
        (uint32_t)data[0] | ((uint32_t)data[1] << 8u) | ((uint32_t)data[2] << 16u) | ((uint32_t)data[3] << 24u);
    return (int32_t)((word >> 8u) ^ 0x800000u) - 0x800000;
}

/* The four that follow store the values of a frame that was checked, or return the counter of what forbids the use of
   the cycle. */
static uint32_t *take_angles(zygos_receiver_t *self, const zygos_config_t *config, uint32_t joint, const uint8_t *data)
{
    const uint32_t rigid = config->joint[joint].rigid;
    const int32_t motor = code_behind(data + 4);
    const int32_t link = rigid ? motor : code_behind(data + 1);
    uint32_t *const fault =
        status_fault(&self->faults, STATUS(data) | (rigid ? (uint32_t)ZYGOS_STATUS_LINK_VALID : 0u));
    if (fault != NULL) {
        return fault;
    }
    if (!rigid && (link == ZYGOS_CODE_ANGLE_INVALID)) {
        return &self->faults.link_invalid;
    }
    if (motor == ZYGOS_CODE_ANGLE_INVALID) {
        return &self->faults.motor_invalid;
    }
    zygos_cycle_t *cycle = open_cycle(self);
    cycle->q[joint] = link * ZYGOS_ANGLE_UNIT;
    cycle->theta[joint] = motor * ZYGOS_ANGLE_UNIT;
    fold_joint(self, joint, folded_joint(link * ZYGOS_ANGLE_UNIT, motor * ZYGOS_ANGLE_UNIT, 0.0));
    return NULL;
}

static uint32_t *take_torque(zygos_receiver_t *self, const zygos_config_t *config, uint32_t joint, const uint8_t *data)
{
    const int32_t torque = code_behind(data + 1);
    const int32_t latch_error = (int32_t)zygos_wire_u16(data + 5) - (int32_t)config->joint[joint].latch_us;
    uint32_t *const fault = status_fault(&self->faults, STATUS(data));
    if (fault != NULL) {
        return fault;
    }
    if ((torque == ZYGOS_CODE_I24_MIN) || (torque == ZYGOS_CODE_I24_MAX)) {
        return &self->faults.saturated;
    }
    if ((latch_error > LATCH_TOLERANCE_US) || (latch_error < -LATCH_TOLERANCE_US)) {
        return &self->faults.latch;
    }
    open_cycle(self)->tau[joint] = torque / ZYGOS_TORQUE_CODES;
    fold_joint(self, joint, folded_joint(0.0, 0.0, torque / ZYGOS_TORQUE_CODES));
    return NULL;
}

static uint32_t *take_rates(zygos_receiver_t *self, uint32_t message, const uint8_t *data)
{
    const int32_t first = code_behind(data + 1);
    const int32_t second = (message == ZYGOS_MSG_RATE_XY) ? code_behind(data + 4) : 0;
    if (!(STATUS(data) & ZYGOS_STATUS_RATE_VALID)) {
        return &self->faults.gyro_invalid;
    }
    if ((first == ZYGOS_CODE_I24_MIN) || (first == ZYGOS_CODE_I24_MAX) || (second == ZYGOS_CODE_I24_MIN) ||
        (second == ZYGOS_CODE_I24_MAX)) {
        return &self->faults.saturated;
    }
    if (message == ZYGOS_MSG_RATE_XY) {
        store_rate(self, 0, first / ZYGOS_RATE_FINE_CODES);
        store_rate(self, 1, second / ZYGOS_RATE_FINE_CODES);
    } else {
        store_rate(self, 2, first / ZYGOS_RATE_FINE_CODES);
    }
    return NULL;
}

__attribute__((noinline)) static uint32_t *take_coarse_rates(zygos_receiver_t *self, const uint8_t *data)
{
    if (!(STATUS(data) & ZYGOS_STATUS_RATE_VALID)) {
        return &self->faults.gyro_invalid;
    }
    for (uint32_t i = 0; i < 3; i++) {
        const int32_t code = zygos_wire_i16(data + 2u + 2u * i);
        if ((code == ZYGOS_CODE_I16_MIN) || (code == ZYGOS_CODE_I16_MAX)) {
            return &self->faults.saturated;
        }
    }
    for (uint32_t i = 0; i < 3; i++) {
        store_rate(self, i, zygos_wire_i16(data + 2u + 2u * i) / ZYGOS_RATE_COARSE_CODES);
    }
    return NULL;
}

/* Whether a frame that has passed zygos_wire_check(), with that result, is of the open cycle and the first with this
   bit of what a cycle receives. Otherwise it is rejected. */
static inline bool is_due(zygos_receiver_t *self, const zygos_frame_t *frame, int wire, uint32_t bit)
{
    const zygos_assembly_t *a = &self->assembly;
    const uint32_t counter = frame->data[1] & 0x0Fu;
    if (wire != ZYGOS_WIRE_OK) {
        (void)reject_wire(self, wire);
        return false;
    }
    if (a->counter == 0) {
        (void)reject_frame(self, &self->faults.unsynced);
        return false;
    }
    if (counter != (a->counter & 0x0Fu)) {
        const bool late = (counter == ((a->counter + 15u) & 0x0Fu));
        (void)reject_frame(self, late ? &self->faults.late : &self->faults.counter);
        return false;
    }
    if ((a->received & bit) != 0) {
        (void)spoil(self, &self->faults.repeated);
        return false;
    }
    return true;
}

/* As zygos_wire_check() for messages of 5 or 8 bytes, which is a call for each of nearly all frames. */
static inline int check_of(const zygos_frame_t *frame, uint32_t length, uint32_t f)
{
    if (frame->length != length) {
        return ZYGOS_WIRE_LENGTH;
    }
    const uint32_t node = frame->id & NODE;
    const uint32_t crc =
        (length == 8u) ? zygos_wire_crc_of_8(frame->data, f, node) : zygos_wire_crc_of_5(frame->data, f, node);
    return (frame->data[0] == crc) ? ZYGOS_WIRE_OK : ZYGOS_WIRE_CRC;
}

/* Ends the reception of a frame whose values were stored, or cannot be used for the fault. */
static inline int end(zygos_receiver_t *self, uint32_t *fault, uint32_t bit)
{
    if (fault != NULL) {
        return spoil(self, fault);
    }
    self->assembly.received |= bit;
    return accept(self);
}

/* A frame of a joint. They are functions of their own, of which each saves few registers. */
__attribute__((noinline)) static int receive_angles(zygos_receiver_t *self, const zygos_config_t *config,
                                                    const zygos_frame_t *frame, uint32_t joint)
{
    const uint32_t bit = 1u << (2u * joint);
    return is_due(self, frame, check_of(frame, 8u, 0), bit)
               ? end(self, take_angles(self, config, joint, frame->data), bit)
               : ZYGOS_REJECTED;
}

__attribute__((noinline)) static int receive_torque(zygos_receiver_t *self, const zygos_config_t *config,
                                                    const zygos_frame_t *frame, uint32_t joint)
{
    const uint32_t bit = 2u << (2u * joint);
    return is_due(self, frame, check_of(frame, 8u, 1u), bit)
               ? end(self, take_torque(self, config, joint, frame->data), bit)
               : ZYGOS_REJECTED;
}

/* A frame of the gyro, whose bits are behind those of n joints. */
__attribute__((noinline)) static int receive_rates(zygos_receiver_t *self, const zygos_frame_t *frame, uint32_t message,
                                                   uint32_t n)
{
    const uint32_t bit = ((message == ZYGOS_MSG_RATE_Z) ? 2u : 1u) << (2u * n);
    const int wire = (message == ZYGOS_MSG_RATE_Z) ? check_of(frame, 5u, 2u) : check_of(frame, 8u, 0);
    if (!is_due(self, frame, wire, bit)) {
        return ZYGOS_REJECTED;
    }
    return end(self,
               (message == ZYGOS_MSG_RATE_COARSE) ? take_coarse_rates(self, frame->data)
                                                  : take_rates(self, message, frame->data),
               bit);
}

/* The third axis of a fine gyro, where a coarse one is configured: its other frame would pass for a coarse one's. */
__attribute__((noinline)) static int take_fine_rate(zygos_receiver_t *self, const zygos_config_t *config,
                                                    const zygos_frame_t *frame)
{
    if (zygos_wire_check(frame, ZYGOS_MSG_RATE_Z, config->imu_node) != ZYGOS_WIRE_OK) {
        return ZYGOS_FOREIGN;
    }
    if (self->assembly.counter == 0) {
        return reject_frame(self, &self->faults.unsynced);
    }
    return spoil(self, &self->faults.gyro_invalid);
}

/* A frame of no joint: n is their number. */
static int receive_other(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame, uint32_t n)
{
    const uint32_t node = frame->id & NODE;
    const uint32_t kind = frame->id - node;
    if (frame->id == ZYGOS_ID_SYNC) {
        return take_sync(self, config, frame);
    }
    if (frame->id == ZYGOS_ID_TPDO3 + ZYGOS_NODE_COMPUTER) {
        return take_time(self, config, frame);
    }
    if ((config->imu_node == 0) || (config->imu_node != node)) {
        return ZYGOS_FOREIGN;
    }
    if (kind == ZYGOS_ID_TPDO1) {
        return receive_rates(self, frame, config->imu_fine ? ZYGOS_MSG_RATE_XY : ZYGOS_MSG_RATE_COARSE, n);
    }
    if (kind != ZYGOS_ID_TPDO3) {
        return ZYGOS_FOREIGN;
    }
    return (config->imu_fine == 0) ? take_fine_rate(self, config, frame)
                                   : receive_rates(self, frame, ZYGOS_MSG_RATE_Z, n);
}

/* A frame that is no classical data frame with a base identifier. */
__attribute__((noinline)) static int take_unusual(zygos_receiver_t *self, const zygos_frame_t *frame)
{
    if ((frame->flags & ZYGOS_FRAME_ERROR) == 0) {
        return ZYGOS_FOREIGN;
    }
    self->assembly.broken |= (frame->id & BUS_OFF) ? (uint32_t)ZYGOS_CYCLE_BREAK : 0u;
    self->faults.bus_error++;
    self->status.last_verdict = ZYGOS_ACCEPTED;
    return ZYGOS_ACCEPTED;
}

int zygos_receiver_frame(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame)
{
    const uint32_t unusual = ZYGOS_FRAME_ERROR | ZYGOS_FRAME_EXTENDED | ZYGOS_FRAME_REMOTE | ZYGOS_FRAME_FD;
    if ((frame->flags & unusual) != 0u) {
        return take_unusual(self, frame);
    }
    const uint32_t n = joints_of(config);
    const uint32_t node = frame->id & NODE;
    const uint32_t kind = frame->id - node;
    for (uint32_t i = 0; i < n; i++) {
        if (config->joint[i].node == node) {
            return (kind == ZYGOS_ID_TPDO1)   ? receive_angles(self, config, frame, i)
                   : (kind == ZYGOS_ID_TPDO2) ? receive_torque(self, config, frame, i)
                                              : ZYGOS_FOREIGN;
        }
    }
    return receive_other(self, config, frame, n);
}

int zygos_cycle_wrapped(const zygos_previous_cycle_t *previous, const zygos_config_t *config,
                        const zygos_cycle_t *cycle)
{
    double farthest = 0.0;
    for (uint32_t i = 0; i < config->joints; i++) {
        const double link = config->joint[i].rigid ? 0.0 : __builtin_fabs(cycle->q[i] - previous->q[i]);
        const double motor = __builtin_fabs(cycle->theta[i] - previous->theta[i]);
        farthest = zygos_larger(link, farthest);
        farthest = zygos_larger(motor, farthest);
    }
    return (farthest > HALF_RANGE_RAD) ? 1 : 0;
}

int zygos_cycle_apart(const double *signal, uint32_t joints)
{
    double widest = 0.0;
    for (uint32_t i = 0; i < joints; i++) {
        const double apart = __builtin_fabs(signal[joints + i] - signal[i]);
        widest = zygos_larger(apart, widest);
    }
    return (widest > HALF_RANGE_RAD) ? 1 : 0;
}

void zygos_cycle_calibrate(zygos_previous_cycle_t *previous, const zygos_config_t *config, const zygos_cycle_t *cycle,
                           double *signal, double *tau)
{
    const uint32_t n = config->joints;
    /* Shares of the torque reported before and of the one reported with this SYNC. */
    static const double share[3][2] = { { 1.0, 0.0 }, { 0.0, 1.0 }, { 0.5, 0.5 } };
    for (uint32_t i = 0; i < n; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        signal[n + i] = joint->motor_sign * (cycle->theta[i] - joint->motor_zero_rad);
        signal[i] = joint->rigid ? signal[n + i] : joint->link_sign * (cycle->q[i] - joint->link_zero_rad);
        tau[i] = share[config->torque_law][0] * previous->reported[i] + share[config->torque_law][1] * cycle->tau[i];
        previous->reported[i] = cycle->tau[i];
        previous->q[i] = cycle->q[i];
        previous->theta[i] = cycle->theta[i];
    }
    for (uint32_t i = 0; i < 3; i++) {
        const double *row = &config->imu_to_base[3 * i];
        const double rate = zygos_dot3(row, cycle->omega);
        signal[2 * n + i] = (config->base == ZYGOS_BASE_FREE) ? rate : 0.0;
    }
}
