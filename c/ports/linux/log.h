/* SPDX-License-Identifier: MIT */
/// Messages of zygos-node to people, on stderr.

#ifndef ZYGOS_NODE_LOG_H
#define ZYGOS_NODE_LOG_H

/// Prints "zygos-node: " and a line. Returns -1, for refusals.
int node_log(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
