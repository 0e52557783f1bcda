/* zygos-node: the flight library on a CAN interface of Linux. docs/node.md. */

#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "bus.h"
#include "log.h"
#include "options.h"
#include "privileges.h"
#include "signals.h"
#include "store.h"
#include "telemetry.h"
#include "zygos/refine.h"

#define REFUSED 2
#define HEARTBEAT_S 1.0
/* Longest time to process the frames that had been received when the node was asked to stop. */
#define PATIENCE_S 10.0

static node_options_t options;
static zygos_config_t config;
static zygos_arm_t arm;
static node_bus_t bus;
static node_telemetry_t telemetry;
static node_store_t store;
static zygos_refine_t fine;

static double now_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Waits for a frame, a signal or the time. */
static void wait_until(double deadline_s, const sigset_t *mask)
{
    const double left_s = deadline_s - now_s();
    const double wait_s = (left_s > 0.0) ? left_s : 0.0;
    const struct timespec timeout = { .tv_sec = (time_t)wait_s,
                                      .tv_nsec = (long)(1e9 * (wait_s - (double)(time_t)wait_s)) };
    struct pollfd socket = { .fd = bus.fd, .events = POLLIN };
    (void)ppoll(&socket, 1, &timeout, mask);
}

/* From what is stored; otherwise, unless files were tried and *arm is spoiled, from what memory still has; otherwise
   from nothing. Returns 1, or -1 after logging the reason. */
static int begin(bool initialised)
{
    const int loaded = node_store_load(&store, &config, &arm, &telemetry.work);
    if ((loaded == 1) || ((loaded == 0) && initialised && (zygos_arm_restart(&arm, ZYGOS_KEEP_FAULTS) == 1) &&
                          (zygos_arm_check(&arm, &config, &telemetry.work) == 1))) {
        return 1;
    }
    const int verdict = zygos_arm_init(&arm, &config);
    return (verdict == 1)
               ? 1
               : node_log("%s: the library refuses the configuration with code %d; remedy: compile the model again",
                          options.config, verdict);
}

/* Prepares the refinement, which begins with the next valid estimate. Returns 1, also where none was asked for, or -1
   after logging the reason. */
static int prepare_refinement(void)
{
    zygos_refine_settings_t settings;
    if (options.refine < 0.0) {
        return 1;
    }
    (void)zygos_refine_defaults(&settings, &config);
    for (uint32_t i = 0; i < config.joints; i++) {
        settings.filter.torque_relative_sigma[i] = options.refine;
    }
    if ((config.effects == zygos_effects_gains(&config)) && (zygos_refine_init(&fine, &config, &settings) == 1)) {
        return 1;
    }
    return node_log("%s: --refine cannot refine this arm; remedy: no effects, flexible joints, torques that are held "
                    "from SYNC to SYNC, and a gyro that latches at SYNC",
                    options.config);
}

/* Takes the next cycle, and does all that the refinement has to do with it: what is sent depends on the frames alone.
   Returns what zygos_arm_step() does. */
static int step(void)
{
    if (options.refine >= 0.0) {
        (void)zygos_refine_cycle(&fine, zygos_receiver_front(&arm.receiver));
        while (zygos_refine_step(&fine, &arm.config) == 1) {
        }
    }
    return zygos_arm_step(&arm);
}

/* Judges what is refined by a new estimate. It begins with the first valid one, and again after a failure. */
static void judge(void)
{
    static zygos_refined_t refined;
    (void)zygos_refine_judge(&fine, &arm.config, &telemetry.estimate, &refined);
    node_telemetry_refined(&telemetry, &refined);
    const bool ended =
        (refined.reason == (uint32_t)ZYGOS_REFINE_FAILED) || (refined.reason == (uint32_t)ZYGOS_REFINE_CORRUPT);
    if (((fine.started == 0u) || ended) && (telemetry.estimate.validity == (uint32_t)ZYGOS_VALID)) {
        (void)zygos_refine_start(&fine, &arm.config, &telemetry.estimate, NULL);
    }
}

static bool configuration_changed(void)
{
    return memcmp(&arm.config, &config, sizeof config) != 0;
}

/* Memory was changed from outside. Which of the two configurations it was in, the file tells. Returns 1, or -1 after
   logging why the estimate cannot start. */
static int start_over(void)
{
    static zygos_config_t again;
    const bool configured = !configuration_changed();
    bus.losses.corrupt++;
    node_log("memory was changed: %s; the estimate starts over; remedy: none if it is rare, otherwise test the memory",
             configured ? "sums or counts are corrupt" : "the configuration is not what was compiled");
    if (!configured && (node_store_config(options.config, &again) == 1)) {
        config = again;
    }
    if ((begin(true) < 1) || (prepare_refinement() < 1)) {
        return -1;
    }
    node_log("%s cycle %llu", (arm.accumulator.accepted > 0u) ? "goes on behind" : "starts at",
             (unsigned long long)arm.cycle);
    return 1;
}

/* A call found memory changed. What can be repaired in place is; otherwise the estimate starts over. Returns 1, or -1
   as start_over() does. */
static int mend(void)
{
    const int found = zygos_arm_scrub(&arm, &config);
    if (found < 0) {
        return start_over();
    }
    bus.losses.corrupt++;
    node_log(
        "memory was changed: repaired in place (zygos_arm_scrub(): %d); remedy: none if it is rare, otherwise test "
        "the memory",
        found);
    return 1;
}

/* A corrupt state is not saved. A failure has been logged. Returns 1, or -1. */
static int save(void)
{
    if (store.path == NULL) {
        return 1;
    }
    const int verdict = zygos_arm_check(&arm, &config, &telemetry.work);
    if (verdict < 1) {
        (void)start_over();
    }
    const int saved = (verdict == 1) ? node_store_save(&store, &arm) : -1;
    bus.losses.unsaved += (saved == 1) ? 0u : 1u;
    return saved;
}

/* Reads one batch and processes it. *frames and *syncs count. Returns enum node_reading. */
static int process_batch(uint64_t *frames, uint64_t *syncs)
{
    zygos_frame_t frame[NODE_BATCH];
    uint32_t count = 0;
    const int reading = node_bus_read(&bus, frame, &count);
    /* Looked at with each batch: a wrong node number can hide every SYNC, a wrong place is written to. */
    if ((configuration_changed() || !zygos_receiver_intact(&arm.receiver)) && (start_over() < 1)) {
        return NODE_FAILED;
    }
    for (uint32_t i = 0; i < count; i++) {
        const int verdict = zygos_arm_frame(&arm, &frame[i]);
        int stepped = step();
        while (stepped == 1) {
            stepped = step();
        }
        if (((verdict < 0) || (stepped < 0)) && (mend() < 1)) {
            return NODE_FAILED;
        }
        if ((verdict == ZYGOS_ACCEPTED) && (frame[i].flags == 0u) && (frame[i].id == ZYGOS_ID_SYNC)) {
            (*syncs)++;
            const int solved = node_telemetry_sync(&telemetry, &arm, &bus.losses);
            if ((solved == 2) && (options.refine >= 0.0)) {
                judge();
            }
            for (zygos_frame_t out; node_telemetry_next(&telemetry, &arm, &out) == 1;) {
                node_bus_send(&bus, &out);
            }
            if ((solved < 1) && (start_over() < 1)) {
                return NODE_FAILED;
            }
            if ((options.save_every > 0u) && (*syncs % options.save_every == 0u)) {
                (void)save(); /* the last save decides */
            }
        }
    }
    *frames += count;
    return reading;
}

static void send_heartbeat(enum node_heartbeat state)
{
    zygos_frame_t frame;
    node_telemetry_heartbeat(state, &frame);
    node_bus_send(&bus, &frame);
}

/* Until the end is asked for, or comes. Returns the last enum node_reading. */
static int run(const sigset_t *mask)
{
    const double idle_s = options.idle_s;
    uint64_t frames = 0;
    uint64_t syncs = 0;
    uint64_t frames_before = 0;
    uint64_t syncs_before = 0;
    double heartbeat_s = now_s() + HEARTBEAT_S;
    double last_frame_s = now_s();
    int reading = NODE_EMPTY;
    send_heartbeat(NODE_BOOT);
    while (!node_signals_ended() && (reading >= NODE_EMPTY)) {
        const double idle_end_s = (idle_s > 0.0) ? last_frame_s + idle_s : heartbeat_s;
        wait_until((idle_end_s < heartbeat_s) ? idle_end_s : heartbeat_s, mask);
        reading = process_batch(&frames, &syncs);
        const double now = now_s();
        last_frame_s = (frames != frames_before) ? now : last_frame_s;
        frames_before = frames;
        if (now >= heartbeat_s) {
            send_heartbeat((syncs != syncs_before) ? NODE_OPERATIONAL : NODE_WAITING);
            node_bus_again(&bus, &config);
            syncs_before = syncs;
            heartbeat_s = now + HEARTBEAT_S;
        }
        if ((idle_s > 0.0) && (now - last_frame_s >= idle_s)) {
            break;
        }
    }
    const double latest_s = now_s() + PATIENCE_S;
    while ((reading >= NODE_EMPTY) && (now_s() < latest_s)) {
        reading = process_batch(&frames, &syncs);
        if (reading == NODE_EMPTY) {
            break;
        }
    }
    send_heartbeat(NODE_STOPPED);
    return reading;
}

int main(int argc, char **argv)
{
    const int understood = node_options_read(argc, argv, &options);
    if (understood < 1) {
        return (understood == 0) ? 0 : REFUSED;
    }
    node_signals_ignore();
    if ((node_store_config(options.config, &config) < 1) || (node_bus_open(&bus, &options, &config) < 1) ||
        (node_privileges_drop(&options) < 1) || (node_store_open(&store, options.state, options.config) < 1) ||
        (begin(false) < 1) || (prepare_refinement() < 1)) {
        return REFUSED;
    }
    node_telemetry_init(&telemetry, options.every);
    const sigset_t mask = node_signals_catch();
    node_log("listening on %s, %u joints, %u parameters, %s cycle %llu", options.interface ? options.interface : "--fd",
             config.joints, arm.column_map.parameters, (arm.cycles > 0u) ? "goes on behind" : "starts at",
             (unsigned long long)arm.cycle);
    const int reading = run(&mask);
    store.failure = 0; /* a failure of the last save is logged in any case */
    const int saved = save();
    uint64_t counter[NODE_COUNTERS];
    node_counters(&arm, &bus.losses, counter);
    for (uint32_t i = 0; i < NODE_COUNTERS; i++) {
        printf("%-20s %llu\n", node_counter_name[i], (unsigned long long)counter[i]);
    }
    return ((saved == 1) && (reading != NODE_FAILED)) ? 0 : REFUSED;
}
