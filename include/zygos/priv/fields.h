/* SPDX-License-Identifier: MIT */
/// zygos/priv/fields.h: the fields and the CRC of a frame, inline because each frame is read with them.

#ifndef ZYGOS_PRIV_FIELDS_H
#define ZYGOS_PRIV_FIELDS_H

#include <stdint.h>

/// Read a field of a frame, least significant byte first.
static inline uint32_t zygos_wire_u16(const uint8_t *p)
{
    return (uint32_t)p[0] | ((uint32_t)p[1] << 8);
}

static inline int32_t zygos_wire_i16(const uint8_t *p)
{
    return (int32_t)(zygos_wire_u16(p) ^ 0x8000u) - 0x8000;
}

static inline int32_t zygos_wire_i24(const uint8_t *p)
{
    return (int32_t)((zygos_wire_u16(p) | ((uint32_t)p[2] << 16)) ^ 0x800000u) - 0x800000;
}

/// The CRC of one byte.
extern const uint8_t zygos_wire_crc_table[256];

/// Returns the CRC that was continued with all data of a frame of this family, continued with its data identifier,
/// whose counter is in data[1].
static inline uint32_t zygos_wire_crc_end(uint32_t crc, const uint8_t *data, uint32_t f, uint32_t node)
{
    const uint32_t id = 32u * f + node + 17u * (data[1] & 0x0Fu);
    return zygos_wire_crc_table[crc ^ ((id < 251u) ? id : id - 251u)] ^ 0xFFu;
}

/// Return what zygos_wire_crc() does for 5 and for 8 bytes, which nearly all frames have: without a loop they cost
/// half.
static inline uint32_t zygos_wire_crc_of_four(const uint8_t *data)
{
    uint32_t crc = zygos_wire_crc_table[0xFFu ^ data[1]];
    crc = zygos_wire_crc_table[crc ^ data[2]];
    crc = zygos_wire_crc_table[crc ^ data[3]];
    return zygos_wire_crc_table[crc ^ data[4]];
}

static inline uint32_t zygos_wire_crc_of_5(const uint8_t *data, uint32_t f, uint32_t node)
{
    return zygos_wire_crc_end(zygos_wire_crc_of_four(data), data, f, node);
}

static inline uint32_t zygos_wire_crc_of_8(const uint8_t *data, uint32_t f, uint32_t node)
{
    uint32_t crc = zygos_wire_crc_of_four(data);
    crc = zygos_wire_crc_table[crc ^ data[5]];
    crc = zygos_wire_crc_table[crc ^ data[6]];
    crc = zygos_wire_crc_table[crc ^ data[7]];
    return zygos_wire_crc_end(crc, data, f, node);
}

#endif
