/* SPDX-License-Identifier: MIT */
#include "zygos/zygos.h"

#include "zygos/priv/numbers.h"

#include <stddef.h>
#include <string.h>

/* As of PNG: a transfer that strips the eighth bit or translates line ends spoils it. */
static const uint8_t magic[8] = { 0x89, 'z', 'y', 'g', 'o', 's', '\r', '\n' };

static bool has_magic(const uint8_t *head)
{
    bool same = true;
    for (uint32_t i = 0; i < sizeof magic; i++) {
        same = same && (head[i] == magic[i]);
    }
    return same;
}

/* Where the fields of the head are. */
#define FORMAT 8u
#define KIND 10u
#define BYTE_ORDER_OF_IMAGE 11u
#define LAYOUT 12u
#define LENGTH 16u
#define CRC 20u

static uint32_t get(const uint8_t *in, uint32_t bytes)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < bytes; i++) {
        value |= (uint32_t)in[i] << (8u * i);
    }
    return value;
}

/* CRC-32C (Castagnoli, reflected polynomial 0x82F63B78), half a byte at a time; ~0 goes in first, the complement of
   what comes out last is the CRC. */
static uint32_t crc32c(uint32_t crc, const uint8_t *data, uint32_t length)
{
    static const uint32_t table[16] = { 0x00000000u, 0x105EC76Fu, 0x20BD8EDEu, 0x30E349B1u, 0x417B1DBCu, 0x5125DAD3u,
                                        0x61C69362u, 0x7198540Du, 0x82F63B78u, 0x92A8FC17u, 0xA24BB5A6u, 0xB21572C9u,
                                        0xC38D26C4u, 0xD3D3E1ABu, 0xE330A81Au, 0xF36E6F75u };
    for (uint32_t i = 0; i < length; i++) {
        crc ^= data[i];
        crc = (crc >> 4) ^ table[crc & 0x0Fu];
        crc = (crc >> 4) ^ table[crc & 0x0Fu];
    }
    return crc;
}

static uint32_t snapshot_crc(const uint8_t *head, const uint8_t *image, uint32_t size)
{
    return ~crc32c(crc32c(0xFFFFFFFFu, head, CRC), image, size);
}

/* 1 where the least byte of a number comes first in memory, 2 where it comes last. */
static uint8_t byte_order(void)
{
    const uint16_t two_bytes = 0x0201u;
    uint8_t first;
    memcpy(&first, &two_bytes, 1);
    return first;
}

/* Bytes of an image; 0 for a kind that there is not. */
static uint32_t size_of(uint32_t kind)
{
    if (kind == ZYGOS_SNAPSHOT_CONFIG) {
        return (uint32_t)sizeof(zygos_config_t);
    }
    return (kind == ZYGOS_SNAPSHOT_STATE) ? (uint32_t)sizeof(zygos_arm_t) : 0u;
}

int zygos_snapshot_seal(uint32_t kind, const void *image, uint8_t *head)
{
    if ((image == NULL) || (head == NULL)) {
        return ZYGOS_E_NULL;
    }
    const uint32_t size = size_of(kind);
    if (size == 0u) {
        return ZYGOS_E_KIND;
    }
    memcpy(head, magic, sizeof magic);
    zygos_put(head + FORMAT, ZYGOS_SNAPSHOT_FORMAT, 2);
    zygos_put(head + KIND, kind, 1);
    head[BYTE_ORDER_OF_IMAGE] = byte_order();
    zygos_put(head + LAYOUT, ZYGOS_ABI, 4);
    zygos_put(head + LENGTH, size, 4);
    zygos_put(head + CRC, snapshot_crc(head, (const uint8_t *)image, size), 4);
    return 1;
}

int zygos_snapshot_check(uint32_t kind, const uint8_t *head, const void *image, uint32_t length)
{
    if ((image == NULL) || (head == NULL)) {
        return ZYGOS_E_NULL;
    }
    if ((length < ZYGOS_SNAPSHOT_HEAD) || !has_magic(head)) {
        return ZYGOS_E_SNAPSHOT;
    }
    if (get(head + FORMAT, 2) != ZYGOS_SNAPSHOT_FORMAT) {
        return ZYGOS_E_FORMAT;
    }
    const uint32_t size = size_of(kind);
    if ((size == 0u) || (head[KIND] != kind)) {
        return ZYGOS_E_KIND;
    }
    if (head[BYTE_ORDER_OF_IMAGE] != byte_order()) {
        return ZYGOS_E_BYTE_ORDER;
    }
    if (get(head + LAYOUT, 4) != ZYGOS_ABI) {
        return ZYGOS_E_LAYOUT;
    }
    if ((get(head + LENGTH, 4) != size) || (length - ZYGOS_SNAPSHOT_HEAD != size)) {
        return ZYGOS_E_LENGTH;
    }
    return (get(head + CRC, 4) == snapshot_crc(head, (const uint8_t *)image, size)) ? 1 : ZYGOS_E_CRC;
}
