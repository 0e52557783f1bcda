/// Snapshots in files.

#ifndef ZYGOS_NODE_STORE_H
#define ZYGOS_NODE_STORE_H

#include "zygos/zygos.h"

/// Reads and checks a configuration. Returns 1, or -1 after saying why not.
int node_store_config(const char *path, zygos_config_t *config);

/// Goes on from a state, or starts from nothing where there is no such file, or no path. Returns 1, or -1 after saying
/// why not. The folder of the file must be there and open for writing.
int node_store_begin(const char *path, const zygos_config_t *config, zygos_t *arm);

/// Saves a state: the file is whole, or as it was. Does nothing without a path. Returns 1, or -1 after saying why not.
int node_store_save(const char *path, const zygos_t *arm);

#endif
