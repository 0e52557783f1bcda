#include "zygos/cycle.h"

#include <string.h>

/* A longer silence of FTIME could hide an outage of exactly 240 cycles, which the SYNC counter cannot see. */
#define MAX_CYCLES_WITHOUT_TIME 120u
/* Latch delays within this of the configured one cost less than 0.1 % of parameter error. */
#define LATCH_TOLERANCE_US 50
/* Error class of an error frame, as SocketCAN puts it into the identifier. */
#define BUS_OFF 0x40u
#define HALF_RANGE_RAD 50.26548245743669
/* Of timed: there is an FTIME to compare with, and one before an outage of unknown length. */
#define TIMED 1u
#define RESUMED 2u

void zygos_receiver_init(zygos_receiver_t *self)
{
    memset(self, 0, sizeof *self);
    self->assembly.broken = ZYGOS_CYCLE_BREAK;
}

void zygos_receiver_resume(zygos_receiver_t *self)
{
    self->faults.dropped += self->queue.head - self->queue.tail;
    self->queue.tail = self->queue.head;
    self->assembly.received = 0;
    self->assembly.broken |= ZYGOS_CYCLE_BREAK;
    self->assembly.timed = (self->assembly.timed != 0) ? RESUMED : 0u;
    self->status.spoiled = 1;
}

int zygos_receiver_pop(zygos_receiver_t *self, zygos_cycle_t *out)
{
    zygos_queue_t *queue = &self->queue;
    const uint32_t tail = queue->tail;
    if (__atomic_load_n(&queue->head, __ATOMIC_ACQUIRE) == tail) {
        return 0;
    }
    *out = queue->slot[tail & (ZYGOS_CYCLE_QUEUE - 1u)];
    __atomic_store_n(&queue->tail, tail + 1u, __ATOMIC_RELEASE);
    return 1;
}

static void push(zygos_receiver_t *self)
{
    zygos_queue_t *queue = &self->queue;
    const uint32_t head = queue->head;
    if (head - __atomic_load_n(&queue->tail, __ATOMIC_ACQUIRE) >= ZYGOS_CYCLE_QUEUE) {
        self->faults.overrun++;
        self->faults.dropped++;
        self->assembly.broken |= ZYGOS_CYCLE_BREAK;
        return;
    }
    queue->slot[head & (ZYGOS_CYCLE_QUEUE - 1u)] = self->assembly.cycle;
    __atomic_store_n(&queue->head, head + 1u, __ATOMIC_RELEASE);
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
    const uint32_t all = (1u << (2u * config->joints + rates)) - 1u;
    const bool complete = (a->received == all);
    if (complete && !self->status.spoiled) {
        a->cycle.sync = a->sync;
        a->cycle.flags = a->broken | void_cycles(a);
        push(self);
        return;
    }
    /* No flag is left for the next cycle: its number does not follow that of the last complete one. */
    self->faults.incomplete += complete ? 0u : 1u;
    self->faults.dropped++;
}

static int reject(zygos_receiver_t *self, uint32_t *fault)
{
    (*fault)++;
    self->status.last_verdict = ZYGOS_REJECTED;
    return ZYGOS_REJECTED;
}

static int spoil(zygos_receiver_t *self, uint32_t *fault)
{
    self->status.spoiled = 1;
    return reject(self, fault);
}

static int reject_wire(zygos_receiver_t *self, int fault)
{
    zygos_faults_t *f = &self->faults;
    return reject(self, (fault == ZYGOS_WIRE_LENGTH) ? &f->length : ((fault == ZYGOS_WIRE_CRC) ? &f->crc : &f->range));
}

static int accept(zygos_receiver_t *self)
{
    self->status.last_verdict = ZYGOS_ACCEPTED;
    return ZYGOS_ACCEPTED;
}

static int take_sync(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, ZYGOS_MSG_SYNC, 0, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    zygos_assembly_t *a = &self->assembly;
    if (a->counter != 0) {
        const uint32_t step = (record.sync + ZYGOS_SYNC_MODULUS - a->counter) % ZYGOS_SYNC_MODULUS;
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
    a->counter = record.sync;
    a->received = 0;
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

static int take_time(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, ZYGOS_MSG_FTIME, ZYGOS_NODE_COMPUTER, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    zygos_assembly_t *a = &self->assembly;
    if (a->counter == 0) {
        return reject(self, &self->faults.unsynced);
    }
    if ((record.sync != a->counter) || (record.counter != (a->counter & 0x0Fu))) {
        const uint32_t behind = (a->counter + ZYGOS_SYNC_MODULUS - record.sync) % ZYGOS_SYNC_MODULUS;
        const bool late = (behind == 1) && (record.counter == (record.sync & 0x0Fu));
        return reject(self, late ? &self->faults.late : &self->faults.counter);
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

/* The checks that every frame of a cycle shares. Returns true when the frame is the first of its kind in this cycle. */
static bool belongs(zygos_receiver_t *self, const zygos_record_t *record, uint32_t bit, int *verdict)
{
    const zygos_assembly_t *a = &self->assembly;
    if (a->counter == 0) {
        *verdict = reject(self, &self->faults.unsynced);
        return false;
    }
    if (record->counter != (a->counter & 0x0Fu)) {
        const bool late = (record->counter == ((a->counter + 15u) & 0x0Fu));
        *verdict = reject(self, late ? &self->faults.late : &self->faults.counter);
        return false;
    }
    if ((a->received & (1u << bit)) != 0) {
        *verdict = spoil(self, &self->faults.repeated);
        return false;
    }
    return true;
}

/* A status bit of a joint's frame that is 0 and forbids the use of the cycle, or null. */
static uint32_t *status_fault(zygos_faults_t *faults, uint32_t status)
{
    if (!(status & ZYGOS_STATUS_ENABLED)) {
        return &faults->disabled;
    }
    if (!(status & ZYGOS_STATUS_LINK_VALID)) {
        return &faults->link_invalid;
    }
    if (!(status & ZYGOS_STATUS_MOTOR_VALID)) {
        return &faults->motor_invalid;
    }
    return (status & ZYGOS_STATUS_TORQUE_VALID) ? NULL : &faults->torque_invalid;
}

static int take_angles(zygos_receiver_t *self, const zygos_config_t *config, uint32_t joint, const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, ZYGOS_MSG_ANGLES, config->joint[joint].node, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    int verdict = ZYGOS_REJECTED;
    if (!belongs(self, &record, 2u * joint, &verdict)) {
        return verdict;
    }
    const bool rigid = (config->joint[joint].rigid != 0);
    uint32_t *const status =
        status_fault(&self->faults, record.status | (rigid ? (uint32_t)ZYGOS_STATUS_LINK_VALID : 0u));
    if (status != NULL) {
        return spoil(self, status);
    }
    record.code[0] = rigid ? record.code[1] : record.code[0];
    if (!rigid && (record.code[0] == ZYGOS_CODE_ANGLE_INVALID)) {
        return spoil(self, &self->faults.link_invalid);
    }
    if (record.code[1] == ZYGOS_CODE_ANGLE_INVALID) {
        return spoil(self, &self->faults.motor_invalid);
    }
    self->assembly.cycle.q[joint] = zygos_wire_angle(record.code[0]);
    self->assembly.cycle.theta[joint] = zygos_wire_angle(record.code[1]);
    self->assembly.received |= 1u << (2u * joint);
    return accept(self);
}

static int take_torque(zygos_receiver_t *self, const zygos_config_t *config, uint32_t joint, const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, ZYGOS_MSG_TORQUE, config->joint[joint].node, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    int verdict = ZYGOS_REJECTED;
    if (!belongs(self, &record, 2u * joint + 1u, &verdict)) {
        return verdict;
    }
    uint32_t *const status = status_fault(&self->faults, record.status);
    if (status != NULL) {
        return spoil(self, status);
    }
    if ((record.code[0] == ZYGOS_CODE_I24_MIN) || (record.code[0] == ZYGOS_CODE_I24_MAX)) {
        return spoil(self, &self->faults.saturated);
    }
    const int32_t latch_error = (int32_t)record.latch_us - (int32_t)config->joint[joint].latch_us;
    if ((latch_error > LATCH_TOLERANCE_US) || (latch_error < -LATCH_TOLERANCE_US)) {
        return spoil(self, &self->faults.latch);
    }
    self->assembly.cycle.tau[joint] = zygos_wire_torque(record.code[0]);
    self->assembly.received |= 1u << (2u * joint + 1u);
    return accept(self);
}

static int take_rates(zygos_receiver_t *self, const zygos_config_t *config, uint32_t message,
                      const zygos_frame_t *frame)
{
    zygos_record_t record;
    const int fault = zygos_wire_decode(frame, message, config->imu_node, &record);
    if (fault != ZYGOS_WIRE_OK) {
        return reject_wire(self, fault);
    }
    const bool coarse = (message == ZYGOS_MSG_RATE_COARSE);
    const uint32_t first = (message == ZYGOS_MSG_RATE_Z) ? 2u : 0u;
    const uint32_t axes = coarse ? 3u : ((message == ZYGOS_MSG_RATE_Z) ? 1u : 2u);
    const uint32_t bit = 2u * config->joints + ((message == ZYGOS_MSG_RATE_Z) ? 1u : 0u);
    int verdict = ZYGOS_REJECTED;
    if (!belongs(self, &record, bit, &verdict)) {
        return verdict;
    }
    if (!(record.status & ZYGOS_STATUS_RATE_VALID)) {
        return spoil(self, &self->faults.gyro_invalid);
    }
    const int32_t low = coarse ? ZYGOS_CODE_I16_MIN : ZYGOS_CODE_I24_MIN;
    const int32_t high = coarse ? ZYGOS_CODE_I16_MAX : ZYGOS_CODE_I24_MAX;
    for (uint32_t i = 0; i < axes; i++) {
        if ((record.code[i] == low) || (record.code[i] == high)) {
            return spoil(self, &self->faults.saturated);
        }
    }
    for (uint32_t i = 0; i < axes; i++) {
        self->assembly.cycle.omega[first + i] =
            coarse ? zygos_wire_rate_coarse(record.code[i]) : zygos_wire_rate_fine(record.code[i]);
    }
    self->assembly.received |= 1u << bit;
    return accept(self);
}

/* The third axis of a fine gyro, where a coarse one is configured: its other frame would pass for a coarse one's. */
static int take_fine_rate(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame)
{
    zygos_record_t record;
    if (zygos_wire_decode(frame, ZYGOS_MSG_RATE_Z, config->imu_node, &record) != ZYGOS_WIRE_OK) {
        return ZYGOS_FOREIGN;
    }
    if (self->assembly.counter == 0) {
        return reject(self, &self->faults.unsynced);
    }
    return spoil(self, &self->faults.gyro_invalid);
}

int zygos_receiver_frame(zygos_receiver_t *self, const zygos_config_t *config, const zygos_frame_t *frame)
{
    if (frame->flags & ZYGOS_FRAME_ERROR) {
        self->assembly.broken |= (frame->id & BUS_OFF) ? (uint32_t)ZYGOS_CYCLE_BREAK : 0u;
        self->faults.bus_error++;
        self->status.last_verdict = ZYGOS_ACCEPTED;
        return ZYGOS_ACCEPTED;
    }
    if (frame->flags & (ZYGOS_FRAME_EXTENDED | ZYGOS_FRAME_REMOTE | ZYGOS_FRAME_FD)) {
        return ZYGOS_FOREIGN;
    }
    if (frame->id == ZYGOS_ID_SYNC) {
        return take_sync(self, config, frame);
    }
    if (frame->id == ZYGOS_ID_TPDO3 + ZYGOS_NODE_COMPUTER) {
        return take_time(self, config, frame);
    }
    if ((config->imu_node != 0) && (frame->id == ZYGOS_ID_TPDO1 + config->imu_node)) {
        return take_rates(self, config, config->imu_fine ? ZYGOS_MSG_RATE_XY : ZYGOS_MSG_RATE_COARSE, frame);
    }
    if ((config->imu_node != 0) && (frame->id == ZYGOS_ID_TPDO3 + config->imu_node)) {
        return config->imu_fine ? take_rates(self, config, ZYGOS_MSG_RATE_Z, frame)
                                : take_fine_rate(self, config, frame);
    }
    for (uint32_t i = 0; i < config->joints; i++) {
        if (frame->id == ZYGOS_ID_TPDO1 + config->joint[i].node) {
            return take_angles(self, config, i, frame);
        }
        if (frame->id == ZYGOS_ID_TPDO2 + config->joint[i].node) {
            return take_torque(self, config, i, frame);
        }
    }
    return ZYGOS_FOREIGN;
}

/* 1 or 0, without a branch: most of what is compared is near. */
static uint32_t far(double a, double b)
{
    return (uint32_t)(a - b > HALF_RANGE_RAD) | (uint32_t)(b - a > HALF_RANGE_RAD);
}

int zygos_cycle_wrapped(const zygos_hold_t *hold, const zygos_config_t *config, const zygos_cycle_t *cycle)
{
    uint32_t wrapped = 0;
    for (uint32_t i = 0; i < config->joints; i++) {
        const uint32_t flexible = (config->joint[i].rigid == 0) ? 1u : 0u;
        wrapped |= (flexible & far(cycle->q[i], hold->q[i])) | far(cycle->theta[i], hold->theta[i]);
    }
    return (int)wrapped;
}

void zygos_cycle_calibrate(zygos_hold_t *hold, const zygos_config_t *config, const zygos_cycle_t *cycle, double *signal,
                           double *tau)
{
    const uint32_t n = config->joints;
    /* Shares of the torque reported before and of the one reported with this SYNC. */
    static const double share[3][2] = { { 1.0, 0.0 }, { 0.0, 1.0 }, { 0.5, 0.5 } };
    for (uint32_t i = 0; i < n; i++) {
        const zygos_joint_config_t *joint = &config->joint[i];
        signal[n + i] = joint->motor_sign * (cycle->theta[i] - joint->motor_zero_rad);
        signal[i] = joint->rigid ? signal[n + i] : joint->link_sign * (cycle->q[i] - joint->link_zero_rad);
        tau[i] = share[config->torque_law][0] * hold->reported[i] + share[config->torque_law][1] * cycle->tau[i];
        hold->reported[i] = cycle->tau[i];
        hold->q[i] = cycle->q[i];
        hold->theta[i] = cycle->theta[i];
    }
    for (uint32_t i = 0; i < 3; i++) {
        const double *row = &config->imu_to_base[3 * i];
        const double rate = row[0] * cycle->omega[0] + row[1] * cycle->omega[1] + row[2] * cycle->omega[2];
        signal[2 * n + i] = (config->base == ZYGOS_BASE_FREE) ? rate : 0.0;
    }
}
