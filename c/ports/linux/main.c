/* SPDX-License-Identifier: MIT */
/* zygos-node: the flight library on a CAN interface of Linux. docs/node.md. */

#include <stdio.h>
#include <time.h>

#include "bus.h"
#include "log.h"
#include "options.h"
#include "privileges.h"
#include "signals.h"
#include "store.h"
#include "telemetry.h"

#define REFUSED 2
#define HEARTBEAT_S 1.0
#define NEVER_S 1e18
/* Longest time to process the frames that had been received when the node was asked to stop. */
#define PATIENCE_S 10.0

static node_options_t options;
static zygos_config_t config;
static zygos_t arm;
static zygos_background_t memory;
static node_bus_t bus;
static node_telemetry_t telemetry;
static node_store_t store;
static zygos_refine_t fine;
static uint64_t noticed; /* Of what the arm has repaired and lost since it began. */
static double last_frame_s;

static double now_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Attaches the refinement, if one was asked for. Returns 1, or -1 after logging the reason. */
static int attach_refinement(void)
{
    zygos_refine_settings_t settings;
    if (options.refine < 0.0) {
        return 1;
    }
    (void)zygos_refine_defaults(&settings, &config);
    for (uint32_t i = 0; i < config.joints; i++) {
        settings.filter.torque_relative_sigma[i] = options.refine;
    }
    if ((config.effects == zygos_effects_gains(&config)) && (zygos_refine(&arm, &fine, &settings, 0) == 1)) {
        return 1;
    }
    return node_log("%s: --refine cannot refine this arm; remedy: no effects, flexible joints, torques that are held "
                    "from SYNC to SYNC, and a gyro that latches at SYNC",
                    options.config);
}

/* From what is stored, otherwise from nothing. Returns 1, or -1 after logging the reason. */
static int begin(void)
{
    const int loaded = node_store_load(&store, &config, &arm, &memory);
    const int begun = (loaded == 1) ? 1 : zygos_init(&arm, &config, &memory, (uint32_t)sizeof memory);
    if (begun < 1) {
        return node_log("%s: the library refuses the configuration with code %d; remedy: compile the model again",
                        options.config, begun);
    }
    node_telemetry_follow(&telemetry, &arm);
    noticed = 0;
    return attach_refinement();
}

/* Looks at what a call returned, and at what the library found in memory. It repairs what it can; where sums were lost,
   or the configuration here is not its own any more, the file of the configuration and the stored state are read again.
   Returns 1, or -1 after logging why the estimate cannot start. */
static int heal(int returned)
{
    static zygos_config_t again;
    const uint64_t found = arm.repairs + arm.losses;
    if ((returned >= 0) && (found == noticed)) {
        return 1;
    }
    bus.losses.corrupt += (found > noticed) ? (uint32_t)(found - noticed) : 1u;
    noticed = found;
    if ((returned >= 0) && (arm.losses == 0u)) {
        node_log("memory was changed: repaired in place; remedy: none if it is rare, otherwise test the memory");
        return 1;
    }
    node_log("memory was changed: %s; the estimate starts over; remedy: none if it is rare, otherwise test the memory",
             (returned == ZYGOS_E_CONFIG) ? "the configuration is not what was compiled"
                                          : "sums or counts are corrupt");
    if (node_store_config(options.config, &again) == 1) {
        config = again;
    }
    const int begun = begin();
    node_log("%s cycle %llu", (arm.state.cycles > 0u) ? "goes on behind" : "starts at",
             (unsigned long long)arm.state.sums.cycle);
    return begun;
}

/* Saves the state, if it is kept. A failure has been logged. Returns 1, or -1. */
static int save(void)
{
    uint8_t head[ZYGOS_SNAPSHOT_HEAD];
    if (store.path == NULL) {
        return 1;
    }
    const int sealed = zygos_seal(&arm, head);
    const int saved = (sealed == 1) ? node_store_save(&store, head, &arm.state) : -1;
    bus.losses.unsaved += (saved == 1) ? 0u : 1u;
    return ((heal(sealed) == 1) && (saved == 1)) ? 1 : -1;
}

/* Frame by frame, each estimate at its SYNC: what is sent depends on the frames alone. Returns enum node_reading. */
static int process_batch(void)
{
    zygos_frame_t frame[NODE_BATCH];
    uint32_t count = 0;
    const int reading = node_bus_read(&bus, frame, &count);
    for (uint32_t i = 0; i < count; i++) {
        const uint64_t before = telemetry.syncs;
        for (bool more = (zygos_frame(&arm, &frame[i]) != 0); more;) {
            const int stepped = zygos_step(&arm);
            if (heal(stepped) < 1) {
                return NODE_FAILED;
            }
            (void)node_telemetry_step(&telemetry, &arm, &bus.losses);
            for (zygos_frame_t out; node_telemetry_next(&telemetry, &arm, &out) == 1;) {
                node_bus_send(&bus, &out);
            }
            more = (stepped == 1) || (telemetry.wanted == 1u);
        }
        if ((telemetry.syncs != before) && (options.save_every > 0u) && (telemetry.syncs % options.save_every == 0u)) {
            (void)save(); /* the last save decides */
        }
    }
    last_frame_s = (count > 0u) ? now_s() : last_frame_s;
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
    const double idle_s = (options.idle_s > 0.0) ? options.idle_s : NEVER_S;
    uint64_t syncs_before = 0;
    double heartbeat_s = now_s() + HEARTBEAT_S;
    int reading = NODE_EMPTY;
    last_frame_s = now_s();
    send_heartbeat(NODE_BOOT);
    while (!node_signals_ended() && (reading >= NODE_EMPTY) && (now_s() < last_frame_s + idle_s)) {
        const double idle_end_s = last_frame_s + idle_s;
        node_bus_wait(&bus, ((idle_end_s < heartbeat_s) ? idle_end_s : heartbeat_s) - now_s(), mask);
        reading = process_batch();
        if (now_s() >= heartbeat_s) {
            send_heartbeat((telemetry.syncs != syncs_before) ? NODE_OPERATIONAL : NODE_WAITING);
            node_bus_again(&bus, &config);
            syncs_before = telemetry.syncs;
            heartbeat_s = now_s() + HEARTBEAT_S;
        }
    }
    reading = (reading >= NODE_EMPTY) ? NODE_READ : reading;
    for (const double latest_s = now_s() + PATIENCE_S; (reading == NODE_READ) && (now_s() < latest_s);) {
        reading = process_batch();
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
    node_telemetry_init(&telemetry, options.every, (options.refine >= 0.0) ? 1u : 0u);
    if ((node_store_config(options.config, &config) < 1) || (node_bus_open(&bus, &options, &config) < 1) ||
        (node_privileges_drop(&options) < 1) || (node_store_open(&store, options.state, options.config) < 1) ||
        (begin() < 1)) {
        return REFUSED;
    }
    const sigset_t mask = node_signals_catch();
    node_log("listening on %s, %u joints, %u parameters, %s cycle %llu", options.interface ? options.interface : "--fd",
             config.joints, arm.state.sums.column_map.parameters,
             (arm.state.cycles > 0u) ? "goes on behind" : "starts at", (unsigned long long)arm.state.sums.cycle);
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
