/* SPDX-License-Identifier: MIT */
/// zygos/wire.h: decodes one CAN frame into one record, and encodes it. zygos.dbc defines the frames.
///
/// The fields are integers, except for the f32 of the telemetry; their codes are converted to doubles in SI units. The
/// functions have no state; cycle.h decides what a frame means for its cycle. Any identifier, length, flag and byte may
/// arrive: for an invalid frame a decoder returns a fault and no value.

#ifndef ZYGOS_WIRE_H
#define ZYGOS_WIRE_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Bits of zygos_frame_t.flags.
enum zygos_frame_flag {
    ZYGOS_FRAME_EXTENDED = 1, ///< The identifier has 29 bits: the frame is foreign.
    ZYGOS_FRAME_REMOTE = 2,   ///< Remote request: the frame is foreign.
    ZYGOS_FRAME_ERROR = 4, ///< The controller reports an error, with its class in the identifier as in SocketCAN. It is
                           ///< counted, and bus-off (class 0x40) ends the arc.
    ZYGOS_FRAME_FD = 8     ///< CAN FD frame: the frame is foreign.
};

/// A classical CAN frame, in 16 bytes.
typedef struct {
    uint32_t id;     ///< 11-bit identifier.
    uint8_t length;  ///< Number of data bytes, 0..8. A larger value is rejected.
    uint8_t flags;   ///< Bits of enum zygos_frame_flag.
    uint8_t pad[2];  ///< Not read.
    uint8_t data[8]; ///< Bytes beyond length are not read.
} zygos_frame_t;

/// The messages of an arm.
enum zygos_message {
    ZYGOS_MSG_FOREIGN = 0, ///< Any other message.
    ZYGOS_MSG_SYNC,        ///< SYNC.
    ZYGOS_MSG_ANGLES,      ///< TPDO1 of a joint.
    ZYGOS_MSG_TORQUE,      ///< TPDO2 of a joint.
    ZYGOS_MSG_RATE_XY,     ///< TPDO1 of a fine gyro.
    ZYGOS_MSG_RATE_Z,      ///< TPDO3 of a fine gyro.
    ZYGOS_MSG_RATE_COARSE, ///< TPDO1 of a coarse gyro.
    ZYGOS_MSG_FTIME        ///< TPDO3 of the flight computer, node 32.
};

/// Why a frame has no value.
enum zygos_wire_fault {
    ZYGOS_WIRE_OK = 0, ///< It has one.
    ZYGOS_WIRE_LENGTH, ///< The length (DLC) is not that of the message.
    ZYGOS_WIRE_CRC,    ///< The CRC or the data identifier of E2E profile 2 is wrong.
    ZYGOS_WIRE_RANGE   ///< A field is outside its range (a SYNC counter of 0 or above 240).
};

/// Status bits in the frames of the joints. All of them must be 1, otherwise the cycle is dropped.
enum zygos_joint_status {
    ZYGOS_STATUS_LINK_VALID = 1,
    ZYGOS_STATUS_MOTOR_VALID = 2,
    ZYGOS_STATUS_TORQUE_VALID = 4,
    ZYGOS_STATUS_ENABLED = 8 ///< The drive is enabled and the brake is open.
};
/// Status bits in the frames of the gyro.
enum zygos_imu_status { ZYGOS_STATUS_RATE_VALID = 1, ZYGOS_STATUS_ATTITUDE_VALID = 2 };

#define ZYGOS_ID_SYNC 0x080u
#define ZYGOS_ID_TPDO1 0x180u
#define ZYGOS_ID_TPDO2 0x280u
#define ZYGOS_ID_TPDO3 0x380u
#define ZYGOS_NODE_COMPUTER 32u
#define ZYGOS_SYNC_MODULUS 240u /* SYNC counts 1..240; 240 = 15 * 16, so the 4-bit counter is continuous. */

/// Scales: an angle is ZYGOS_ANGLE_UNIT times its code; torques and rates are their code divided by the other
/// constants.
#define ZYGOS_ANGLE_UNIT (6.283185307179586476925286766559 / 1048576.0)
#define ZYGOS_TORQUE_CODES 1e4
/// Standard deviation of what a torque loses by the steps of its code [Nm]: a step divided by the root of 12.
#define ZYGOS_TORQUE_ROUNDING (0.28867513459481287 / ZYGOS_TORQUE_CODES)
#define ZYGOS_RATE_FINE_CODES 2097152.0
#define ZYGOS_RATE_COARSE_CODES 8192.0

#define ZYGOS_CODE_ANGLE_INVALID (-8388608)
#define ZYGOS_CODE_I24_MAX 8388607
#define ZYGOS_CODE_I24_MIN (-8388608)
#define ZYGOS_CODE_I16_MAX 32767
#define ZYGOS_CODE_I16_MIN (-32768)

/// A decoded frame: the header of its message, and integer codes.
typedef struct {
    uint8_t counter;    ///< SYNC counter modulo 16, from the header.
    uint8_t status;     ///< Status bits.
    uint8_t sync;       ///< In SYNC and FTIME: the SYNC counter, 1..240.
    int8_t temperature; ///< In torque frames: motor temperature [degree Celsius].
    uint16_t latch_us;  ///< In torque frames: latch delay after SYNC.
    uint16_t reserved;
    uint32_t time_us; ///< In FTIME: clock of the SYNC producer [us], wraps.
    int32_t code[3];  ///< Angles: link, motor. Torque: one. Rates: the axes of the frame.
} zygos_record_t;

/// Computes the CRC of E2E profile 2: CRC-8 with polynomial 0x2F over data[1..length-1] and then the data identifier of
/// the counter, (32 f + node + 17 counter) mod 251. f is 0, 1, 2 for TPDO1, 2, 3 and 3 for telemetry. Needs
/// length 2..8. Returns the CRC. Cost: one table look-up for each byte.
uint8_t zygos_wire_crc(const uint8_t *data, uint32_t length, uint32_t f, uint32_t node);

/// Checks whether a frame is valid for a message of a node. Returns enum zygos_wire_fault. Cost: one CRC.
int zygos_wire_check(const zygos_frame_t *frame, uint32_t message, uint32_t node);

/// Decodes a frame as a message of a node. Returns ZYGOS_WIRE_OK and writes *out, or another enum zygos_wire_fault and
/// does not change *out. Cost: one CRC.
int zygos_wire_decode(const zygos_frame_t *frame, uint32_t message, uint32_t node, zygos_record_t *out);

/// Encodes a record as a message of a node, including its CRC. Codes outside the range of a field saturate. A SYNC
/// counter outside 1..240 is encoded as it is, and the receiver rejects it. Returns 1; or 0, without a change of *out,
/// when the message cannot be sent.
int zygos_wire_encode(const zygos_record_t *record, uint32_t message, uint32_t node, zygos_frame_t *out);

/// Decode and encode the telemetry of node 32 (identifier 0x1A0): index, kind and one f32. Decoding a NaN or an
/// infinity returns ZYGOS_WIRE_RANGE.
int zygos_wire_decode_telemetry(const zygos_frame_t *frame, uint8_t *counter, uint8_t *index, uint8_t *kind,
                                float *value);
void zygos_wire_encode_telemetry(uint8_t counter, uint8_t index, uint8_t kind, float value, zygos_frame_t *out);

/// Convert codes to SI units and back. Angles are multi-turn, +-8 turns, and wrap modulo 16 turns; a value that is not
/// finite becomes the invalid code. Torques and rates saturate at the largest and smallest code, which the receiver
/// regards as saturated; a value that is not finite becomes the smallest code. Rounding is to nearest, ties to even.
double zygos_wire_angle(int32_t code);
double zygos_wire_torque(int32_t code);
double zygos_wire_rate_fine(int32_t code);
double zygos_wire_rate_coarse(int32_t code);
int32_t zygos_wire_angle_code(double angle_rad);
int32_t zygos_wire_torque_code(double torque_nm);
int32_t zygos_wire_rate_fine_code(double rate);
int32_t zygos_wire_rate_coarse_code(double rate);

#ifdef __cplusplus
}
#endif
#endif
