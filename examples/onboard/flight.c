#include "flight.h"

#include "arm_config.h"

#include <stdatomic.h>
#include <stddef.h>

#define RING 256u        /* frames between interrupt and task: 40 cycles of this arm */
#define SOLVE_EVERY 200u /* cycles: ten seconds */

enum kind { TELEMETRY_ESTIMATE = 0, TELEMETRY_SIGMA = 1, TELEMETRY_VERDICT = 3 }; /* as in zygos.dbc */

static zygos_arm_t arm;           /* belongs to flight_task() */
static zygos_work_t work;         /* changes hands by work_is_full */
static zygos_estimate_t estimate; /* belongs to flight_solve(), as does what is learned; while no work is full, to
                                    flight_task() */
static flight_learned_t learned;
static uint8_t estimate_counter;
static uint32_t payload_of_learned;

static zygos_frame_t ring[RING];
static _Atomic uint32_t ring_head; /* written by the interrupt */
static _Atomic uint32_t ring_tail; /* written by the task */

static _Atomic uint32_t work_is_full; /* set by flight_task(), cleared by flight_solve() */
static _Atomic uint32_t corrupt;      /* the other way round */
static _Atomic uint32_t payload;      /* how often the payload changed; written by the task */
static uint32_t payload_of_work;
static uint8_t counter_of_work; /* of the SYNC at which it was taken, modulo 16 */
static uint64_t taken_at;

int flight_start(void)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    const uint32_t length = port_load(head, &arm, sizeof arm);
    if ((zygos_snapshot_check(ZYGOS_SNAPSHOT_STATE, head, &arm, length) == 1) &&
        (zygos_arm_check(&arm, &arm_config, &work) == 1) && (zygos_arm_resume(&arm, &arm_config) == 1)) {
        taken_at = arm.cycles;
        return 2;
    }
    return zygos_arm_init(&arm, &arm_config); /* over whatever was read */
}

int flight_store(void)
{
    /* Where power may fail while this writes, keep two places and write them in turn: the CRC tells a half-written one.
       A CRC also fits what memory errors have changed: what is stored already is then better. */
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    return (zygos_arm_check(&arm, &arm_config, &work) == 1) &&
           (zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, &arm, head) == 1) &&
           (port_save(head, &arm, sizeof arm) == sizeof head + sizeof arm);
}

void flight_receive(const zygos_frame_t *frame)
{
    const uint32_t head = atomic_load_explicit(&ring_head, memory_order_relaxed);
    if (head - atomic_load_explicit(&ring_tail, memory_order_acquire) == RING) {
        return; /* lost like a frame on the bus: the library notices that its cycle is incomplete */
    }
    ring[head % RING] = *frame;
    atomic_store_explicit(&ring_head, head + 1u, memory_order_release);
}

int flight_waiting(void)
{
    return atomic_load_explicit(&ring_head, memory_order_relaxed) !=
           atomic_load_explicit(&ring_tail, memory_order_relaxed);
}

/* Frames that zygos does not know are the spacecraft's own. */
static void own_frame(const zygos_frame_t *frame)
{
    if ((frame->id == FLIGHT_PAYLOAD_CHANGED) && (frame->flags == 0u)) {
        /* Rotors, springs and dampers are as they were, and faults are counted on. */
        (void)zygos_arm_restart(&arm, ZYGOS_KEEP_FAULTS | ZYGOS_KEEP_JOINTS);
        const uint32_t times = atomic_load_explicit(&payload, memory_order_relaxed);
        atomic_store_explicit(&payload, times + 1u, memory_order_release);
    }
}

static void take_when_due(void)
{
    if ((arm.cycles - taken_at < SOLVE_EVERY) || (atomic_load_explicit(&work_is_full, memory_order_acquire) != 0u)) {
        return;
    }
    taken_at = arm.cycles;
    (void)zygos_arm_adopt(&arm, &estimate); /* the solver is idle; what it found last judges the arcs to come */
    zygos_arm_take(&arm, &work);
    counter_of_work = (uint8_t)(arm.receiver.assembly.counter % 16u);
    payload_of_work = atomic_load_explicit(&payload, memory_order_relaxed);
    atomic_store_explicit(&work_is_full, 1u, memory_order_release);
}

/* Memory was changed from outside: nothing learned is kept. Where it was not in the sums, a restart does not help. The
   ring is ours, so that no frame is received meanwhile. */
static void heal(void)
{
    if ((zygos_arm_restart(&arm, ZYGOS_KEEP_FAULTS) != 1) || (zygos_arm_check(&arm, &arm_config, &work) != 1)) {
        (void)zygos_arm_init(&arm, &arm_config);
        taken_at = 0;
    }
}

void flight_task(void)
{
    if ((atomic_load_explicit(&corrupt, memory_order_acquire) != 0u) &&
        (atomic_load_explicit(&work_is_full, memory_order_acquire) == 0u)) {
        heal();
        atomic_store_explicit(&corrupt, 0u, memory_order_release);
    }
    uint32_t tail = atomic_load_explicit(&ring_tail, memory_order_relaxed);
    while (tail != atomic_load_explicit(&ring_head, memory_order_acquire)) {
        if (zygos_arm_frame(&arm, &ring[tail % RING]) == ZYGOS_FOREIGN) {
            own_frame(&ring[tail % RING]);
        }
        tail++;
        atomic_store_explicit(&ring_tail, tail, memory_order_release);
        int stepped = zygos_arm_step(&arm);
        while (stepped == 1) {
            take_when_due();
            stepped = zygos_arm_step(&arm);
        }
        if ((stepped < 0) && (zygos_arm_scrub(&arm, &arm_config) < 0)) { /* memory was changed */
            heal();
        }
    }
}

static void tell(uint32_t index, enum kind kind, double value)
{
    zygos_frame_t frame;
    zygos_wire_encode_telemetry(estimate_counter, (uint8_t)index, (uint8_t)kind, (float)value, &frame);
    port_send(&frame);
}

/* The bodies with another payload are other bodies. */
static void forget_bodies(void)
{
    const uint32_t now = atomic_load_explicit(&payload, memory_order_acquire);
    for (uint32_t i = 0; (now != payload_of_learned) && (i < arm.column_map.body); i++) { /* the columns never change */
        learned.known[i] = 0u;
    }
    payload_of_learned = now;
}

/* What to do with an estimate is decided by its validity, before any value is looked at. */
static void use(void)
{
    tell(0, TELEMETRY_VERDICT, estimate.validity);
    tell(1, TELEMETRY_VERDICT, estimate.reason);
    if (estimate.reason == ZYGOS_REASON_CORRUPT) {
        atomic_store_explicit(&corrupt, 1u, memory_order_release);
    }
    if ((estimate.validity != ZYGOS_VALID) && (estimate.validity != ZYGOS_PARTIAL)) {
        return; /* doubtful or refused: what was known before is better, and the reason says what to look for */
    }
    for (uint32_t i = 0; i < estimate.parameters; i++) {
        if (estimate.identifiable[i] == 1u) {
            learned.known[i] = 1u;
            learned.value[i] = estimate.value[i];
            learned.half95[i] = estimate.half95[i];
            tell(i, TELEMETRY_ESTIMATE, estimate.value[i]);
            tell(i, TELEMETRY_SIGMA, estimate.sigma[i]);
        }
    }
    learned.cycle = estimate.cycle;
}

const zygos_estimate_t *flight_solve(void)
{
    forget_bodies();
    if (atomic_load_explicit(&work_is_full, memory_order_acquire) == 0u) {
        return NULL;
    }
    const uint32_t of = payload_of_work;
    estimate_counter = counter_of_work;
    (void)zygos_work_solve(&work, &estimate);
    atomic_store_explicit(&work_is_full, 0u, memory_order_release);
    if (of != atomic_load_explicit(&payload, memory_order_acquire)) {
        return NULL; /* the payload changed meanwhile: this is another arm's */
    }
    use();
    return &estimate;
}

const flight_learned_t *flight_learned(void)
{
    return &learned;
}
