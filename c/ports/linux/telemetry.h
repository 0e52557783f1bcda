/// What the node answers on the bus: the estimate, its intervals, every counter, and a heartbeat. zygos.dbc has it all.

#ifndef ZYGOS_NODE_TELEMETRY_H
#define ZYGOS_NODE_TELEMETRY_H

#include "bus.h"
#include "zygos/zygos.h"

/// Kinds of telemetry; the index beside it counts parameters, counters or verdicts.
enum node_kind {
    NODE_ESTIMATE = 0,
    NODE_SIGMA = 1,
    NODE_COUNTER = 2, ///< Modulo 2^24, which a float holds exactly.
    NODE_VERDICT = 3,
    NODE_HALF95 = 4
};

#define NODE_COUNTERS 34u
#define NODE_VERDICTS 13u
#define NODE_MAX_ITEMS (3u * ZYGOS_MAX_PARAMETERS + NODE_COUNTERS + NODE_VERDICTS)

/// States of the heartbeat, as in CANopen.
enum node_heartbeat { NODE_BOOT = 0x00, NODE_STOPPED = 0x04, NODE_OPERATIONAL = 0x05, NODE_WAITING = 0x7F };

typedef struct {
    uint32_t every; ///< SYNCs from one estimate to the next.
    uint32_t syncs; ///< Since the last.
    uint32_t items; ///< Values that belong to it,
    uint32_t next;  ///< the one that is sent next,
    double value[NODE_MAX_ITEMS];
    uint8_t index[NODE_MAX_ITEMS];
    uint8_t kind[NODE_MAX_ITEMS];
    zygos_work_t work;
    zygos_estimate_t estimate;
} node_telemetry_t;

/// Counters in the order of their indices, called as in zygos.dbc.
extern const char *const node_counter_name[NODE_COUNTERS];
void node_counters(const zygos_t *arm, const node_bus_t *bus, uint64_t *out);

/// every: SYNCs from one estimate to the next.
void node_telemetry_init(node_telemetry_t *self, uint32_t every);

/// Call after each accepted SYNC, when the cycle that it closed is worked off: at the first and every so many SYNCs
/// behind it, solves; after each, sends as many values as it takes to have sent all by the next estimate. What has no
/// value is passed over. Nothing here depends on a clock.
void node_telemetry_sync(node_telemetry_t *self, const zygos_t *arm, node_bus_t *bus);

/// Sends the heartbeat.
void node_telemetry_heartbeat(node_bus_t *bus, enum node_heartbeat state);

#endif
