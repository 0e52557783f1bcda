/// zygos/snapshot.h: stores a configuration or a state, and checks it before it is used again.
///
/// A snapshot is a head of ZYGOS_SNAPSHOT_HEAD bytes, followed by the memory of a zygos_config_t or a zygos_arm_t, the
/// image. The head contains the kind of the image, its memory layout and byte order, and a CRC-32C over all of it;
/// docs/snapshot.md has the format. The CRC detects accidental errors only: anybody can compute one, and errors that
/// were in memory before are sealed with it. Therefore zygos_seal() and zygos_resume() (zygos.h), which seal and check
/// the state of an arm by these functions, verify it beside that.
///
/// zygos_snapshot_check() may also be used at any time to check that a configuration in memory is unchanged.

#ifndef ZYGOS_SNAPSHOT_H
#define ZYGOS_SNAPSHOT_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Length of the head in bytes.
#define ZYGOS_SNAPSHOT_HEAD 24u
/// Version of the head and of the meaning of the images, independent of the version of the library.
#define ZYGOS_SNAPSHOT_FORMAT 1u

/// The content of a snapshot.
enum zygos_snapshot_kind {
    ZYGOS_SNAPSHOT_CONFIG = 1, ///< The image is a zygos_config_t.
    ZYGOS_SNAPSHOT_STATE = 2   ///< The image is a zygos_arm_t.
};

/// Writes the head of an image into head[ZYGOS_SNAPSHOT_HEAD]. kind: enum zygos_snapshot_kind. For a state, call it in
/// the task of zygos_arm_step(), while no frame is being received. Returns 1, ZYGOS_E_NULL or ZYGOS_E_KIND. Cost: two
/// table look-ups for each byte of the image.
int zygos_snapshot_seal(uint32_t kind, const void *image, uint8_t *head);

/// Checks a snapshot that was read back: length is the number of bytes, of which the first ZYGOS_SNAPSHOT_HEAD are in
/// head and the others in image. Changes nothing. Returns 1 when the image is what was sealed; otherwise the image must
/// not be used, and the result is the first of ZYGOS_E_NULL, ZYGOS_E_SNAPSHOT, ZYGOS_E_FORMAT, ZYGOS_E_KIND,
/// ZYGOS_E_BYTE_ORDER, ZYGOS_E_LAYOUT, ZYGOS_E_LENGTH and ZYGOS_E_CRC that applies. Cost: as zygos_snapshot_seal().
int zygos_snapshot_check(uint32_t kind, const uint8_t *head, const void *image, uint32_t length);

#ifdef __cplusplus
}
#endif
#endif
