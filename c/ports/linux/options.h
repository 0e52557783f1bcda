/* SPDX-License-Identifier: MIT */
/// The command line of zygos-node.

#ifndef ZYGOS_NODE_OPTIONS_H
#define ZYGOS_NODE_OPTIONS_H

#include <stdint.h>

typedef struct {
    const char *config;    ///< File of a sealed configuration.
    const char *interface; ///< CAN interface, or null.
    int fd;                ///< A socket that is open already, or -1.
    const char *state;     ///< File of a sealed state, or null.
    const char *user;      ///< Name of the user that root becomes, or null.
    uint32_t every;        ///< SYNCs from one estimate to the next.
    uint32_t save_every;   ///< SYNCs from one save to the next; 0: saved at the end alone.
    double refine;         ///< Noise of the torques as a share of their size, 0: none declared; -1: no refinement.
    double idle_s;         ///< The end after so many seconds without a frame; 0: never.
} node_options_t;

/// Reads the command line. Returns 1; 0 when help was asked for and printed; -1 when it was refused and the reason
/// logged.
int node_options_read(int argc, char **argv, node_options_t *out);

#endif
