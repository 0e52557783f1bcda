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
    uint32_t every; ///< SYNCs from one estimate to the next.
    uint32_t syncs; ///< Since the last.
    uint32_t items; ///< Values that belong to it,
    uint32_t next;  ///< the one that is sent next,
    uint32_t due;   ///< and the first that has to wait for the next SYNC.
    double value[NODE_MAX_ITEMS];
    uint8_t index[NODE_MAX_ITEMS];
    uint8_t kind[NODE_MAX_ITEMS];
    zygos_work_t work;
    zygos_estimate_t estimate;
} node_telemetry_t;

/// What only the port can count. 0 where it cannot happen.
typedef struct {
    uint32_t overflow;  ///< Frames, or characters of frames, that came faster than they were taken.
    uint32_t misshapen; ///< What came and was no frame.
    uint32_t down;      ///< Times that the bus went down.
    uint32_t unsent;    ///< Frames of ours that the bus did not take.
    uint32_t corrupt;   ///< Times that memory was found changed, and the estimate started over.
    uint32_t unsaved;   ///< States that could not be saved.
} node_losses_t;

/// Counters in the order of their indices, called as in zygos.dbc.
extern const char *const node_counter_name[NODE_COUNTERS];
void node_counters(const zygos_arm_t *arm, const node_losses_t *losses, uint64_t *out);

/// every: SYNCs from one estimate to the next.
void node_telemetry_init(node_telemetry_t *self, uint32_t every);

/// Call after each accepted SYNC, when the cycle that it closed is worked off: at the first and every so many SYNCs
/// behind it, solves, and has the arm adopt a valid estimate; after each, as many values are due as it takes to have
/// sent all by the next estimate. What has no value is passed over. Nothing here depends on a clock. Returns 1; 2 when
/// this was a solution; or ZYGOS_E_SUMS when it was one and found the sums corrupt: the port then starts the estimate
/// over, and counts it.
int node_telemetry_sync(node_telemetry_t *self, zygos_arm_t *arm, const node_losses_t *losses);

/// Adds what zygos_refine_judge() has written to the values that are due with this solution. Call it between a
/// node_telemetry_sync() that returned 2 and node_telemetry_next(). Values and deviations are added where they are
/// published, the rest always.
void node_telemetry_refined(node_telemetry_t *self, const zygos_refined_t *refined);

/// Takes the next value that is due. Returns 1 and its frame, or 0 when none is.
int node_telemetry_next(node_telemetry_t *self, const zygos_arm_t *arm, zygos_frame_t *out);

/// Writes the heartbeat's frame.
void node_telemetry_heartbeat(enum node_heartbeat state, zygos_frame_t *out);

#endif
