/* SPDX-License-Identifier: MIT */
/// The signals of zygos-node.

#ifndef ZYGOS_NODE_SIGNALS_H
#define ZYGOS_NODE_SIGNALS_H

#include <signal.h>
#include <stdbool.h>

/// A reader of stderr who has gone, and a limit to the size of files, are answered by the calls that meet them.
void node_signals_ignore(void);

/// From here on SIGTERM, SIGINT and SIGHUP ask for the end. SIGHUP stays ignored where it is at the start, as by nohup.
/// They come in while ppoll() waits with the mask that is returned, and at no other time: none is missed.
sigset_t node_signals_catch(void);

/// Whether the end was asked for, also where frames always wait and ppoll() never does.
bool node_signals_ended(void);

#endif
