/// zygos/snapshot.h: memory that can be stored, sent and trusted again.
///
/// A snapshot is a head of ZYGOS_SNAPSHOT_HEAD bytes and, behind it, the memory of a zygos_config_t or a zygos_t as it
/// is. The head says what follows, of which layout and byte order, and holds a CRC-32C over all of it. docs/snapshot.md
/// has the bytes. The CRC finds accidents; who wants to deceive can compute one, and what was in memory by accident is
/// sealed with it. zygos_init() and zygos_resume() therefore check what they are given.
///
///     zygos_check(&arm, &config, &work);                                 // zygos.h: never seal what is corrupt
///     zygos_snapshot_seal(ZYGOS_SNAPSHOT_STATE, &arm, head);             // in the task that steps; then store both
///     ...
///     zygos_snapshot_check(ZYGOS_SNAPSHOT_STATE, head, &arm, length);    // after both were read back
///     zygos_check(&arm, &config, &work);
///     zygos_resume(&arm, &config);
///
/// zygos_snapshot_check() on a configuration in memory tells at any time whether it is still what was sealed.

#ifndef ZYGOS_SNAPSHOT_H
#define ZYGOS_SNAPSHOT_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ZYGOS_SNAPSHOT_HEAD 24u
/// Version of the head and of what the images mean, counted apart from the library's.
#define ZYGOS_SNAPSHOT_FORMAT 1u

enum zygos_snapshot_kind {
    ZYGOS_SNAPSHOT_CONFIG = 1, ///< The image is a zygos_config_t.
    ZYGOS_SNAPSHOT_STATE = 2   ///< The image is a zygos_t.
};

/// Writes the head of an image into head[ZYGOS_SNAPSHOT_HEAD]. kind: enum zygos_snapshot_kind. Of a state: same task as
/// zygos_step(), while no frame is being received. Returns 1, ZYGOS_E_NULL or ZYGOS_E_KIND. Cost: two table look-ups a
/// byte of the image.
int zygos_snapshot_seal(uint32_t kind, const void *image, uint8_t *head);

/// Checks what was read back: length bytes, of which the first ZYGOS_SNAPSHOT_HEAD are in head and the others in image.
/// Changes nothing. Returns 1 when the image is what was sealed; an image that does not pass must not be used.
/// Otherwise the first of ZYGOS_E_NULL, ZYGOS_E_SNAPSHOT, ZYGOS_E_FORMAT, ZYGOS_E_KIND, ZYGOS_E_BYTE_ORDER,
/// ZYGOS_E_LAYOUT, ZYGOS_E_LENGTH and ZYGOS_E_CRC that applies. Cost: as zygos_snapshot_seal().
int zygos_snapshot_check(uint32_t kind, const uint8_t *head, const void *image, uint32_t length);

#ifdef __cplusplus
}
#endif
#endif
