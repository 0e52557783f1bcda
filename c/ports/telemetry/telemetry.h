/* SPDX-License-Identifier: MIT */
/// The messages of a flight computer on the bus: the estimate, its intervals, what a refinement makes of it, every
/// counter, and a heartbeat. zygos.dbc defines them. They are the same for every port.

#ifndef ZYGOS_NODE_TELEMETRY_H
#define ZYGOS_NODE_TELEMETRY_H

#include "zygos/refine.h"
#include "zygos/zygos.h"

/// Kinds of telemetry; the index beside it counts parameters, counters, verdicts or what a refinement tells.
enum node_kind {
    NODE_ESTIMATE = 0,
    NODE_SIGMA = 1,
    NODE_COUNTER = 2, ///< Modulo 2^24, which a float holds exactly.
    NODE_VERDICT = 3,
    NODE_HALF95 = 4,
    NODE_REFINED = 5,       ///< Refined value, only while it is published,
    NODE_REFINED_SIGMA = 6, ///< and its standard deviation.
    NODE_REFINEMENT = 7     ///< Why it is or is not published, and the innovations.
};

#define NODE_COUNTERS 38u
#define NODE_VERDICTS 14u
#define NODE_REFINEMENTS 16u
#define NODE_MAX_ITEMS (5u * ZYGOS_MAX_PARAMETERS + NODE_COUNTERS + NODE_VERDICTS + NODE_REFINEMENTS)

/// States of the heartbeat, as in CANopen.
enum node_heartbeat { NODE_BOOT = 0x00, NODE_STOPPED = 0x04, NODE_OPERATIONAL = 0x05, NODE_WAITING = 0x7F };

typedef struct {
    uint32_t every;   ///< SYNCs from one estimate to the next.
    uint32_t refines; ///< 1: a refinement is attached to the arm.
    uint64_t syncs;   ///< SYNCs that were accepted since node_telemetry_init().
    uint32_t counter; ///< Of the newest of them, 0: none.
    uint32_t wanted;  ///< 1: an estimate is due, and not there yet.
    uint32_t judged;  ///< 0: the verdict on the refinement is still to come.
    uint32_t items;   ///< Values that belong to the newest estimate,
    uint32_t next;    ///< the one that is sent next,
    uint32_t due;     ///< and the first that has to wait for the next SYNC.
    double value[NODE_MAX_ITEMS];
    uint8_t index[NODE_MAX_ITEMS];
    uint8_t kind[NODE_MAX_ITEMS];
    zygos_estimate_t estimate;
} node_telemetry_t;

/// What only the port can count. 0 where it cannot happen.
typedef struct {
    uint32_t overflow;  ///< Frames, or characters of frames, that came faster than they were taken.
    uint32_t misshapen; ///< What came and was no frame.
    uint32_t down;      ///< Times that the bus went down.
    uint32_t unsent;    ///< Frames of ours that the bus did not take.
    uint32_t corrupt;   ///< Times that memory was found changed.
    uint32_t unsaved;   ///< States that could not be saved.
} node_losses_t;

/// Counters in the order of their indices, called as in zygos.dbc.
extern const char *const node_counter_name[NODE_COUNTERS];
void node_counters(const zygos_t *arm, const node_losses_t *losses, uint64_t *out);

/// every: SYNCs from one estimate to the next. refines: 1 where zygos_refine() is called for the arm.
void node_telemetry_init(node_telemetry_t *self, uint32_t every, uint32_t refines);

/// Call when the arm has begun, by zygos_init() or zygos_resume(): from here on its SYNCs are counted.
void node_telemetry_follow(node_telemetry_t *self, const zygos_t *arm);

/// Call after each zygos_step(), and send what node_telemetry_next() then has. At the first SYNC, and every so many
/// SYNCs behind it, an estimate is wanted; it comes some calls later, because zygos_step() copies the sums in parts.
/// Who calls that until it is there has it at its SYNC. Then, and after each SYNC, as many values are due as it takes
/// to have sent all before the next estimate. What has no value is passed over. Nothing here depends on a clock.
/// Returns 2 when *self holds a new estimate, 1 when a SYNC was accepted, and otherwise 0.
int node_telemetry_step(node_telemetry_t *self, zygos_t *arm, const node_losses_t *losses);

/// Takes the next value that is due. Returns 1 and its frame, or 0 when none is.
int node_telemetry_next(node_telemetry_t *self, const zygos_t *arm, zygos_frame_t *out);

/// Writes the heartbeat's frame.
void node_telemetry_heartbeat(enum node_heartbeat state, zygos_frame_t *out);

#endif
