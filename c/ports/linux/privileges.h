/* SPDX-License-Identifier: MIT */
/// The user that zygos-node runs as.

#ifndef ZYGOS_NODE_PRIVILEGES_H
#define ZYGOS_NODE_PRIVILEGES_H

#include "options.h"

/// Once the socket is open: becomes the user of the options, or, where root names none, the owner of the folder of the
/// state or else of the configuration; gives up all capabilities, and never gets any again. A configuration that this
/// user cannot read is complained of and accepted. Returns 1, or -1 after logging the reason.
int node_privileges_drop(const node_options_t *options);

#endif
