/* SPDX-License-Identifier: MIT */
#include "zygos/wire.h"

#include <string.h>

#include "zygos/priv/fields.h"
#include "zygos/priv/numbers.h"

/* x^8 + x^5 + x^3 + x^2 + x + 1 (0x2F), most significant bit first. */
const uint8_t zygos_wire_crc_table[256] = {
    0x00, 0x2F, 0x5E, 0x71, 0xBC, 0x93, 0xE2, 0xCD, 0x57, 0x78, 0x09, 0x26, 0xEB, 0xC4, 0xB5, 0x9A, 0xAE, 0x81, 0xF0,
    0xDF, 0x12, 0x3D, 0x4C, 0x63, 0xF9, 0xD6, 0xA7, 0x88, 0x45, 0x6A, 0x1B, 0x34, 0x73, 0x5C, 0x2D, 0x02, 0xCF, 0xE0,
    0x91, 0xBE, 0x24, 0x0B, 0x7A, 0x55, 0x98, 0xB7, 0xC6, 0xE9, 0xDD, 0xF2, 0x83, 0xAC, 0x61, 0x4E, 0x3F, 0x10, 0x8A,
    0xA5, 0xD4, 0xFB, 0x36, 0x19, 0x68, 0x47, 0xE6, 0xC9, 0xB8, 0x97, 0x5A, 0x75, 0x04, 0x2B, 0xB1, 0x9E, 0xEF, 0xC0,
    0x0D, 0x22, 0x53, 0x7C, 0x48, 0x67, 0x16, 0x39, 0xF4, 0xDB, 0xAA, 0x85, 0x1F, 0x30, 0x41, 0x6E, 0xA3, 0x8C, 0xFD,
    0xD2, 0x95, 0xBA, 0xCB, 0xE4, 0x29, 0x06, 0x77, 0x58, 0xC2, 0xED, 0x9C, 0xB3, 0x7E, 0x51, 0x20, 0x0F, 0x3B, 0x14,
    0x65, 0x4A, 0x87, 0xA8, 0xD9, 0xF6, 0x6C, 0x43, 0x32, 0x1D, 0xD0, 0xFF, 0x8E, 0xA1, 0xE3, 0xCC, 0xBD, 0x92, 0x5F,
    0x70, 0x01, 0x2E, 0xB4, 0x9B, 0xEA, 0xC5, 0x08, 0x27, 0x56, 0x79, 0x4D, 0x62, 0x13, 0x3C, 0xF1, 0xDE, 0xAF, 0x80,
    0x1A, 0x35, 0x44, 0x6B, 0xA6, 0x89, 0xF8, 0xD7, 0x90, 0xBF, 0xCE, 0xE1, 0x2C, 0x03, 0x72, 0x5D, 0xC7, 0xE8, 0x99,
    0xB6, 0x7B, 0x54, 0x25, 0x0A, 0x3E, 0x11, 0x60, 0x4F, 0x82, 0xAD, 0xDC, 0xF3, 0x69, 0x46, 0x37, 0x18, 0xD5, 0xFA,
    0x8B, 0xA4, 0x05, 0x2A, 0x5B, 0x74, 0xB9, 0x96, 0xE7, 0xC8, 0x52, 0x7D, 0x0C, 0x23, 0xEE, 0xC1, 0xB0, 0x9F, 0xAB,
    0x84, 0xF5, 0xDA, 0x17, 0x38, 0x49, 0x66, 0xFC, 0xD3, 0xA2, 0x8D, 0x40, 0x6F, 0x1E, 0x31, 0x76, 0x59, 0x28, 0x07,
    0xCA, 0xE5, 0x94, 0xBB, 0x21, 0x0E, 0x7F, 0x50, 0x9D, 0xB2, 0xC3, 0xEC, 0xD8, 0xF7, 0x86, 0xA9, 0x64, 0x4B, 0x3A,
    0x15, 0x8F, 0xA0, 0xD1, 0xFE, 0x33, 0x1C, 0x6D, 0x42,
};

static inline uint8_t crc_of(const uint8_t *data, uint32_t length, uint32_t f, uint32_t node)
{
    if (length == 8) {
        return (uint8_t)zygos_wire_crc_of_8(data, f, node);
    }
    uint32_t crc = 0xFFu;
    for (uint32_t i = 1; i < length; i++) {
        crc = zygos_wire_crc_table[crc ^ data[i]];
    }
    return (uint8_t)zygos_wire_crc_end(crc, data, f, node);
}

uint8_t zygos_wire_crc(const uint8_t *data, uint32_t length, uint32_t f, uint32_t node)
{
    return crc_of(data, length, f, node);
}

static uint32_t get32(const uint8_t *p)
{
    return zygos_wire_u16(p) | (zygos_wire_u16(p + 2) << 16);
}

static int32_t clamp(int32_t value, int32_t low, int32_t high)
{
    return (value < low) ? low : ((value > high) ? high : value);
}

/* Of each message: identifier without the node, DLC, and DataIDList family f. */
typedef struct {
    uint32_t id;
    uint8_t length; /* 0: there is no such message */
    uint8_t f;
} frame_layout_t;

static frame_layout_t column_map(uint32_t message)
{
    static const frame_layout_t known[] = {
        [ZYGOS_MSG_SYNC] = { ZYGOS_ID_SYNC, 1, 0 },    [ZYGOS_MSG_ANGLES] = { ZYGOS_ID_TPDO1, 8, 0 },
        [ZYGOS_MSG_TORQUE] = { ZYGOS_ID_TPDO2, 8, 1 }, [ZYGOS_MSG_RATE_XY] = { ZYGOS_ID_TPDO1, 8, 0 },
        [ZYGOS_MSG_RATE_Z] = { ZYGOS_ID_TPDO3, 5, 2 }, [ZYGOS_MSG_RATE_COARSE] = { ZYGOS_ID_TPDO1, 8, 0 },
        [ZYGOS_MSG_FTIME] = { ZYGOS_ID_TPDO3, 7, 2 },
    };
    return known[(message < sizeof known / sizeof known[0]) ? message : 0u];
}

static bool is_counter(uint32_t sync)
{
    return (sync >= 1u) && (sync <= ZYGOS_SYNC_MODULUS);
}

int zygos_wire_check(const zygos_frame_t *frame, uint32_t message, uint32_t node)
{
    const uint8_t *d = frame->data;
    const frame_layout_t own = column_map(message);
    if (own.length == 0) {
        return ZYGOS_WIRE_RANGE;
    }
    if (frame->length != own.length) {
        return ZYGOS_WIRE_LENGTH;
    }
    if (message == ZYGOS_MSG_SYNC) {
        return is_counter(d[0]) ? ZYGOS_WIRE_OK : ZYGOS_WIRE_RANGE;
    }
    if (d[0] != crc_of(d, own.length, own.f, node)) {
        return ZYGOS_WIRE_CRC;
    }
    return ((message == ZYGOS_MSG_FTIME) && !is_counter(d[2])) ? ZYGOS_WIRE_RANGE : ZYGOS_WIRE_OK;
}

int zygos_wire_decode(const zygos_frame_t *frame, uint32_t message, uint32_t node, zygos_record_t *out)
{
    const uint8_t *d = frame->data;
    const int fault = zygos_wire_check(frame, message, node);
    if (fault != ZYGOS_WIRE_OK) {
        return fault;
    }
    memset(out, 0, sizeof *out);
    if (message == ZYGOS_MSG_SYNC) {
        out->sync = d[0];
        out->counter = d[0] & 0x0Fu;
        return ZYGOS_WIRE_OK;
    }
    out->counter = d[1] & 0x0Fu;
    out->status = d[1] >> 4;
    switch (message) {
    case ZYGOS_MSG_TORQUE:
        out->code[0] = zygos_wire_i24(d + 2);
        out->latch_us = (uint16_t)zygos_wire_u16(d + 5);
        out->temperature = (int8_t)((int32_t)d[7] - ((d[7] & 0x80u) ? 0x100 : 0));
        break;
    case ZYGOS_MSG_RATE_Z:
        out->code[0] = zygos_wire_i24(d + 2);
        break;
    case ZYGOS_MSG_RATE_COARSE:
        for (uint32_t i = 0; i < 3; i++) {
            out->code[i] = zygos_wire_i16(d + 2 + 2 * i);
        }
        break;
    case ZYGOS_MSG_FTIME:
        out->sync = d[2];
        out->time_us = get32(d + 3);
        break;
    default: /* two i24: angles, or rates about x and y */
        out->code[0] = zygos_wire_i24(d + 2);
        out->code[1] = zygos_wire_i24(d + 5);
        break;
    }
    return ZYGOS_WIRE_OK;
}

int zygos_wire_encode(const zygos_record_t *record, uint32_t message, uint32_t node, zygos_frame_t *out)
{
    if (message == ZYGOS_MSG_SYNC) {
        memset(out, 0, sizeof *out);
        out->id = ZYGOS_ID_SYNC;
        out->length = 1;
        out->data[0] = record->sync;
        return 1;
    }
    const frame_layout_t own = column_map(message);
    if (own.length == 0) {
        return 0;
    }
    memset(out, 0, sizeof *out);
    uint8_t *d = out->data;
    out->id = own.id + node;
    out->length = own.length;
    d[1] = (uint8_t)((record->counter & 0x0Fu) | (uint32_t)(record->status << 4));
    switch (message) {
    case ZYGOS_MSG_TORQUE:
        zygos_put(d + 2, (uint32_t)clamp(record->code[0], ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX), 3);
        zygos_put(d + 5, record->latch_us, 2);
        d[7] = (uint8_t)record->temperature;
        break;
    case ZYGOS_MSG_RATE_Z:
        zygos_put(d + 2, (uint32_t)clamp(record->code[0], ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX), 3);
        break;
    case ZYGOS_MSG_RATE_COARSE:
        for (uint32_t i = 0; i < 3; i++) {
            zygos_put(d + 2 + 2 * i, (uint32_t)clamp(record->code[i], ZYGOS_CODE_I16_MIN, ZYGOS_CODE_I16_MAX), 2);
        }
        break;
    case ZYGOS_MSG_FTIME:
        d[2] = record->sync;
        zygos_put(d + 3, record->time_us, 4);
        break;
    default:
        zygos_put(d + 2, (uint32_t)clamp(record->code[0], ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX), 3);
        zygos_put(d + 5, (uint32_t)clamp(record->code[1], ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX), 3);
        break;
    }
    d[0] = zygos_wire_crc(d, own.length, own.f, node);
    return 1;
}

int zygos_wire_decode_telemetry(const zygos_frame_t *frame, uint8_t *counter, uint8_t *index, uint8_t *kind,
                                float *value)
{
    if (frame->length != 8) {
        return ZYGOS_WIRE_LENGTH;
    }
    if (frame->data[0] != zygos_wire_crc(frame->data, 8, 3, ZYGOS_NODE_COMPUTER)) {
        return ZYGOS_WIRE_CRC;
    }
    const uint32_t bits = get32(frame->data + 4);
    if ((bits & 0x7F800000u) == 0x7F800000u) {
        return ZYGOS_WIRE_RANGE;
    }
    *counter = frame->data[1] & 0x0Fu;
    *index = frame->data[2];
    *kind = frame->data[3];
    memcpy(value, &bits, sizeof bits);
    return ZYGOS_WIRE_OK;
}

void zygos_wire_encode_telemetry(uint8_t counter, uint8_t index, uint8_t kind, float value, zygos_frame_t *out)
{
    memset(out, 0, sizeof *out);
    out->id = ZYGOS_ID_TPDO1 + ZYGOS_NODE_COMPUTER;
    out->length = 8;
    out->data[1] = counter & 0x0Fu;
    out->data[2] = index;
    out->data[3] = kind;
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    zygos_put(out->data + 4, bits, 4);
    out->data[0] = zygos_wire_crc(out->data, 8, 3, ZYGOS_NODE_COMPUTER);
}

double zygos_wire_angle(int32_t code)
{
    return code * ZYGOS_ANGLE_UNIT;
}

double zygos_wire_torque(int32_t code)
{
    return code / ZYGOS_TORQUE_CODES;
}

double zygos_wire_rate_fine(int32_t code)
{
    return code / ZYGOS_RATE_FINE_CODES;
}

double zygos_wire_rate_coarse(int32_t code)
{
    return code / ZYGOS_RATE_COARSE_CODES;
}

/* Nearest integer, ties to even, of |x| < 2^51: adding 1.5 * 2^52 leaves no bits for the fraction. */
static double nearest(double x)
{
    const double magic = 6755399441055744.0;
    volatile double sum = x + magic; /* volatile: x87-style excess precision or reassociation must not undo it */
    return sum - magic;
}

/* NaN compares false with everything, so it ends at low, like -infinity. */
static int32_t saturate(double x, int32_t low, int32_t high)
{
    if (!(x > low)) {
        return low;
    }
    if (x >= high) {
        return high;
    }
    return (int32_t)nearest(x);
}

int32_t zygos_wire_angle_code(double angle_rad)
{
    if (!((angle_rad > -1e9) && (angle_rad < 1e9))) {
        return ZYGOS_CODE_ANGLE_INVALID;
    }
    const double codes = nearest(angle_rad * (1.0 / ZYGOS_ANGLE_UNIT));
    const int64_t wrapped = ((int64_t)codes + 8388608) & 0xFFFFFF;
    const int32_t code = (int32_t)wrapped - 8388608;
    /* The lowest code is never sent as a value: -8 turns becomes the code beside it. */
    return (code == ZYGOS_CODE_ANGLE_INVALID) ? ZYGOS_CODE_ANGLE_INVALID + 1 : code;
}

int32_t zygos_wire_torque_code(double torque_nm)
{
    return saturate(torque_nm * ZYGOS_TORQUE_CODES, ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX);
}

int32_t zygos_wire_rate_fine_code(double rate)
{
    return saturate(rate * ZYGOS_RATE_FINE_CODES, ZYGOS_CODE_I24_MIN, ZYGOS_CODE_I24_MAX);
}

int32_t zygos_wire_rate_coarse_code(double rate)
{
    return saturate(rate * ZYGOS_RATE_COARSE_CODES, ZYGOS_CODE_I16_MIN, ZYGOS_CODE_I16_MAX);
}
