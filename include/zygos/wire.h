/// zygos/wire.h: one CAN frame to one record, and back. The layout is zygos.dbc.
///
/// Fields are integers, but for the f32 of the telemetry; codes become SI values as doubles. Stateless: what a frame
/// means for its cycle is decided in cycle.h. Trusted: nothing. Any identifier, length, flag and byte may arrive; a
/// decoder answers with a fault and no value.

#ifndef ZYGOS_WIRE_H
#define ZYGOS_WIRE_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Bits of zygos_frame_t.flags.
enum zygos_frame_flag {
    ZYGOS_FRAME_EXTENDED = 1, ///< 29-bit identifier: foreign.
    ZYGOS_FRAME_REMOTE = 2,   ///< Remote request: foreign.
    ZYGOS_FRAME_ERROR = 4, ///< The controller reports an error, its class in the identifier as in SocketCAN: counted,
                           ///< and bus-off (class 0x40) ends the arc.
    ZYGOS_FRAME_FD = 8     ///< CAN FD frame: foreign.
};

/// A classical CAN frame. 16 bytes, so that logs of millions pass in one call.
typedef struct {
    uint32_t id;     ///< 11-bit identifier.
    uint8_t length;  ///< Bytes of data, 0..8. A larger value is rejected.
    uint8_t flags;   ///< Bits of enum zygos_frame_flag.
    uint8_t pad[2];  ///< Not read.
    uint8_t data[8]; ///< Bytes beyond length are not read.
} zygos_frame_t;

enum zygos_message {
    ZYGOS_MSG_FOREIGN = 0,
    ZYGOS_MSG_SYNC,
    ZYGOS_MSG_ANGLES,      ///< TPDO1 of a joint.
    ZYGOS_MSG_TORQUE,      ///< TPDO2 of a joint.
    ZYGOS_MSG_RATE_XY,     ///< TPDO1 of a fine gyro.
    ZYGOS_MSG_RATE_Z,      ///< TPDO3 of a fine gyro.
    ZYGOS_MSG_RATE_COARSE, ///< TPDO1 of a coarse gyro.
    ZYGOS_MSG_FTIME        ///< TPDO3 of the flight computer, node 32.
};

/// Why a frame has no value.
enum zygos_wire_fault {
    ZYGOS_WIRE_OK = 0,
    ZYGOS_WIRE_LENGTH, ///< Not the DLC of its message.
    ZYGOS_WIRE_CRC,    ///< E2E profile 2 CRC or data identifier.
    ZYGOS_WIRE_RANGE   ///< A field outside its range (a SYNC counter of 0 or above 240).
};

/// Status nibble of the joints' frames; each bit must be 1 for the cycle to count.
enum zygos_joint_status {
    ZYGOS_STATUS_LINK_VALID = 1,
    ZYGOS_STATUS_MOTOR_VALID = 2,
    ZYGOS_STATUS_TORQUE_VALID = 4,
    ZYGOS_STATUS_ENABLED = 8 ///< Drive enabled and brake open.
};
/// Status nibble of the gyro's frames.
enum zygos_imu_status { ZYGOS_STATUS_RATE_VALID = 1, ZYGOS_STATUS_ATTITUDE_VALID = 2 };

#define ZYGOS_ID_SYNC 0x080u
#define ZYGOS_ID_TPDO1 0x180u
#define ZYGOS_ID_TPDO2 0x280u
#define ZYGOS_ID_TPDO3 0x380u
#define ZYGOS_NODE_COMPUTER 32u
#define ZYGOS_SYNC_MODULUS 240u /* SYNC counts 1..240; 240 = 15 * 16, so the 4-bit counter runs on across the wrap. */

/// SI to codes: an angle is ZYGOS_ANGLE_UNIT times its code; torques and rates are their code divided by the others.
#define ZYGOS_ANGLE_UNIT (6.283185307179586476925286766559 / 1048576.0)
#define ZYGOS_TORQUE_CODES 1e4
#define ZYGOS_RATE_FINE_CODES 2097152.0
#define ZYGOS_RATE_COARSE_CODES 8192.0

#define ZYGOS_CODE_ANGLE_INVALID (-8388608)
#define ZYGOS_CODE_I24_MAX 8388607
#define ZYGOS_CODE_I24_MIN (-8388608)
#define ZYGOS_CODE_I16_MAX 32767
#define ZYGOS_CODE_I16_MIN (-32768)

/// A decoded frame: integer codes, and the header of its message.
typedef struct {
    uint8_t counter;    ///< SYNC counter mod 16, as stated in the header.
    uint8_t status;     ///< Status nibble.
    uint8_t sync;       ///< SYNC and FTIME: the SYNC counter, 1..240.
    int8_t temperature; ///< Torque: motor temperature [degree Celsius].
    uint16_t latch_us;  ///< Torque: latch delay after SYNC.
    uint16_t reserved;
    uint32_t time_us; ///< FTIME: clock of the SYNC producer [us], wraps.
    int32_t code[3];  ///< Angles: link, motor. Torque: torque. Rates: as many axes as the frame has.
} zygos_record_t;

/// CRC of E2E profile 2: CRC-8 with polynomial 0x2F over data[1..length-1] and then the data identifier of the counter,
/// (32 f + node + 17 counter) mod 251. f is 0, 1, 2 for TPDO1, 2, 3 and 3 for telemetry.
/// Needs length 2..8. Returns the CRC. Cost: one table look-up a byte.
uint8_t zygos_wire_crc(const uint8_t *data, uint32_t length, uint32_t f, uint32_t node);

/// Whether a frame is a good one of the given message of the given node. Returns enum zygos_wire_fault. Bounded: one
/// CRC.
int zygos_wire_check(const zygos_frame_t *frame, uint32_t message, uint32_t node);

/// Decodes a frame as the given message of the given node. Returns ZYGOS_WIRE_OK and fills *out, or another
/// enum zygos_wire_fault and leaves *out as it was. Bounded: one CRC.
int zygos_wire_decode(const zygos_frame_t *frame, uint32_t message, uint32_t node, zygos_record_t *out);

/// Encodes a record as the given message of the given node, CRC included; codes outside the field saturate.
/// A SYNC counter outside 1..240 is sent as it is, and the receiver rejects it.
/// Returns 1, or 0 and leaves *out as it was when message is none that can be sent.
int zygos_wire_encode(const zygos_record_t *record, uint32_t message, uint32_t node, zygos_frame_t *out);

/// Telemetry of node 32 (0x1A0): index, kind and one f32. Decoding a NaN or an infinity is ZYGOS_WIRE_RANGE.
int zygos_wire_decode_telemetry(const zygos_frame_t *frame, uint8_t *counter, uint8_t *index, uint8_t *kind,
                                float *value);
void zygos_wire_encode_telemetry(uint8_t counter, uint8_t index, uint8_t kind, float value, zygos_frame_t *out);

/// Codes to SI and back. Angles are multi-turn, +-8 turns, and wrap modulo 16 turns; a value that is not finite becomes
/// the invalid code. Torque and rates saturate at the outermost codes, which mean "saturated" to the receiver; a value
/// that is not finite becomes the lowest code. Rounding is to nearest, ties to even.
double zygos_wire_angle(int32_t code);
double zygos_wire_torque(int32_t code);
double zygos_wire_rate_fine(int32_t code);
double zygos_wire_rate_coarse(int32_t code);
int32_t zygos_wire_angle_code(double angle_rad);
int32_t zygos_wire_torque_code(double torque_nm);
int32_t zygos_wire_rate_fine_code(double rate);
int32_t zygos_wire_rate_coarse_code(double rate);

#ifndef ZYGOS_DECLARATIONS_ONLY
/// Fields as they lie in a frame, least byte first. Inline: they are read with each frame.
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
#endif

#ifdef __cplusplus
}
#endif
#endif
