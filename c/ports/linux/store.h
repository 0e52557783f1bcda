/* SPDX-License-Identifier: MIT */
/// Snapshots in files.
///
/// A state is kept in two generations: FILE, and FILE.previous, which was FILE one save before. A save writes
/// FILE.partial, flushes it to the disk, lets FILE.previous be another name of FILE, and renames FILE.partial to FILE:
/// wherever it ends, one of the two is whole. A FILE that a start could not use becomes FILE.unusable, unless there is
/// one already, and is never made FILE.previous.

#ifndef ZYGOS_NODE_STORE_H
#define ZYGOS_NODE_STORE_H

#include <stdbool.h>
#include <stddef.h>

#include "zygos/zygos.h"

typedef struct {
    const char *path; ///< FILE, or null where no state is kept.
    bool alone;       ///< The generation before could not be kept.
    bool good;        ///< FILE, if it is there, can be used.
    int lock;         ///< Descriptor of the lock, or -1 where nothing can be saved.
    int failure;      ///< errno of the last save, 0 when it succeeded: the same failure is logged once.
    uint32_t failed;  ///< Saves that failed since the last that did not.
} node_store_t;

/// Reads and checks a configuration. Returns 1, or -1 after logging the reason.
int node_store_config(const char *path, zygos_config_t *config);

/// The folder of a path, in a buffer of the caller's.
const char *node_store_folder(const char *path, char *buffer, size_t size);

/// Chooses the file of the state, or none (null), and locks it until the process ends. Returns 1, or -1 after logging
/// why there can be no such file: its name is too long, its folder is not there, it is a folder, a device, or the
/// configuration, or another node has it in use. A folder that is not open for writing is complained of and accepted.
int node_store_open(node_store_t *self, const char *path, const char *config);

/// Goes on from the newest generation that is whole, as zygos_resume() does, logs what is wrong with the others, and
/// puts FILE aside when it cannot be used. Returns 1; 0 when there are no files, or no path; -1 when none of them can
/// be used. Unless it returns 1, *arm must be initialised.
int node_store_load(node_store_t *self, const zygos_config_t *config, zygos_t *arm, zygos_background_t *memory);

/// Saves a state behind the head that zygos_seal() wrote. Returns 1, or -1 after logging the reason.
int node_store_save(node_store_t *self, const uint8_t *head, const zygos_arm_t *state);

#endif
