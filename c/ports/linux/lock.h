/* SPDX-License-Identifier: MIT */
/// The lock of a file that one node alone may use.

#ifndef ZYGOS_NODE_LOCK_H
#define ZYGOS_NODE_LOCK_H

/// Locks path by the file path.lock, which is made and stays; the kernel ends the lock with the process. Returns the
/// descriptor that holds it, or -1 after logging the reason, also where another process has it.
int node_lock(const char *path);

#endif
