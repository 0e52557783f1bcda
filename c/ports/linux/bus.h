/* SPDX-License-Identifier: MIT */
/// The socket that frames come from and go to. CAN_RAW, or another one whose packets are struct can_frame.

#ifndef ZYGOS_NODE_BUS_H
#define ZYGOS_NODE_BUS_H

#include <signal.h>
#include <stdbool.h>
#include <stdint.h>

#include "options.h"
#include "telemetry.h"
#include "zygos/zygos.h"

/// Frames that one call reads at the most.
#define NODE_BATCH 64u

typedef struct {
    int fd;
    const char *interface; ///< Null where the descriptor was given.
    bool away;             ///< The interface was removed.
    bool stream_ends;      ///< An empty packet means that the other end is closed.
    uint32_t drops;        ///< What the kernel counted last.
    /// Overflow: frames that the kernel dropped because the receive buffer was full. Misshapen: packets that are no
    /// frame.
    node_losses_t losses;
} node_bus_t;

enum node_reading {
    NODE_READ = 1,   ///< There may be more.
    NODE_EMPTY = 0,  ///< Nothing was waiting.
    NODE_ENDED = -1, ///< The other end is closed.
    NODE_FAILED = -2 ///< The reason was logged.
};

/// Opens the interface, or takes over the descriptor, and asks for the frames of this arm and for error frames.
/// Returns 1, or -1 after logging the reason.
int node_bus_open(node_bus_t *self, const node_options_t *options, const zygos_config_t *config);

/// Binds the socket to an interface that was removed, if it is there again. Where nothing is missing it does nothing.
void node_bus_again(node_bus_t *self, const zygos_config_t *config);

/// Waits for a frame, for one of the signals that the mask lets through, or for so long.
void node_bus_wait(const node_bus_t *self, double seconds, const sigset_t *mask);

/// Reads what is waiting, without blocking, into frame[NODE_BATCH]; *count is their number. Returns enum node_reading.
int node_bus_read(node_bus_t *self, zygos_frame_t *frame, uint32_t *count);

/// Sends a frame without blocking. One that is not taken is counted and forgotten.
void node_bus_send(node_bus_t *self, const zygos_frame_t *frame);

#endif
