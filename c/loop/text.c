/* SPDX-License-Identifier: MIT */
#include "zygos/zygos.h"

#include <stddef.h>

#include "zygos/priv/cycle.h"
#include "zygos/priv/guard.h"
#include "zygos/priv/refiner.h"
#include "zygos/priv/solver.h"

#define UNKNOWN "unknown code"

/* No switch over an enumeration has a default, so that the compiler warns of an enumerator without a text. There are no
   tables of strings: their pointers would be writable data in code that is independent of its place. */

/* NULL where the code is none of a configuration. */
static const char *configuration_text(int code)
{
    switch (code) {
    case ZYGOS_E_JOINTS:
        return "too many joints for this build";
    case ZYGOS_E_KINETIC:
        return "this build has no columns of that `kinetic`";
    case ZYGOS_E_PERIOD:
        return "period_s must be within 1e-5 .. 0.065";
    case ZYGOS_E_TORQUE_LAW:
        return "unknown torque_law";
    case ZYGOS_E_SMOOTHER:
        return "the smoother's half width, order or lag are out of range (lag must equal the half width: end-point "
               "filters are refused)";
    case ZYGOS_E_NODE:
        return "node numbers must be 1..31, each used once";
    case ZYGOS_E_AXIS:
        return "joint axes must be unit vectors, parallel where the arm is planar";
    case ZYGOS_E_VALUE:
        return "a ratio, sign, zero, sigma, latch delay, forgetting_factor, compensation, imu_fine or imu_to_base is "
               "out of range";
    case ZYGOS_E_ARC:
        return "arc_cycles, impulse_arc_cycles or momentum_arc_cycles is below 20, joint_row_cycles is odd or too "
               "short, or this build has no room for such rows";
    case ZYGOS_E_EFFECT:
        return "an effect stands twice, or has no columns in this build";
    case ZYGOS_E_BASE:
        return "base, gravity and gyro do not fit each other";
    case ZYGOS_E_REDUCTION:
        return "the reduction to independent columns does not fit the arm or this build";
    default:
        return NULL;
    }
}

/* NULL where the code is none of a stored or changed state. */
static const char *stored_text(int code)
{
    switch (code) {
    case ZYGOS_E_SNAPSHOT:
        return "is no snapshot of zygos";
    case ZYGOS_E_FORMAT:
        return "is a snapshot of a format that this version does not read";
    case ZYGOS_E_KIND:
        return "is a snapshot of the other kind";
    case ZYGOS_E_BYTE_ORDER:
        return "was written by a machine of the other byte order";
    case ZYGOS_E_LAYOUT:
        return "was written by a build with other capacities, structs or version";
    case ZYGOS_E_LENGTH:
        return "is cut off, or has more bytes than its head says";
    case ZYGOS_E_CRC:
        return "is damaged: its CRC does not fit its bytes";
    case ZYGOS_E_CONFIG:
        return "is the state of another configuration";
    case ZYGOS_E_STATE:
        return "holds an index, count or length that cannot be: memory was changed, in a stored state before it was "
               "sealed";
    case ZYGOS_E_SUMS:
        return "holds sums that do not match their row sums: memory was changed, in a stored state before it was "
               "sealed";
    default:
        return NULL;
    }
}

const char *zygos_text(int code)
{
    if (code >= 0) {
        return "no error";
    }
    switch (code) {
    case ZYGOS_E_NULL:
        return "a required pointer is null";
    case ZYGOS_E_ABI:
        return "the library was built with other headers";
    case ZYGOS_E_ORDER:
        return "zygos_init() or zygos_resume() has not succeeded on this struct";
    case ZYGOS_E_KEEP:
        return "zygos_restart() does not know one of the bits, or there are no motor rows to keep";
    case ZYGOS_E_ARITHMETIC:
        return "the library was compiled with flags that break IEEE arithmetic";
    case ZYGOS_E_MEMORY:
        return "the memory for solutions is smaller than a zygos_in_place_t";
    default:
        break;
    }
    const char *text = configuration_text(code);
    text = (text != NULL) ? text : stored_text(code);
    return (text != NULL) ? text : UNKNOWN;
}

const char *zygos_validity_text(uint32_t validity)
{
    switch ((enum zygos_validity)validity) {
    case ZYGOS_REFUSED:
        return "refused";
    case ZYGOS_DOUBTFUL:
        return "doubtful";
    case ZYGOS_PARTIAL:
        return "partial";
    case ZYGOS_VALID:
        return "valid";
    }
    return UNKNOWN;
}

const char *zygos_reason_text(uint32_t reason)
{
    switch ((enum zygos_reason)reason) {
    case ZYGOS_REASON_NONE:
        return "none";
    case ZYGOS_REASON_NO_DATA:
        return "too few accepted instants";
    case ZYGOS_REASON_NOT_IDENTIFIABLE:
        return "the motion so far does not determine every parameter";
    case ZYGOS_REASON_TOO_FAST:
        return "motion too fast for this sample rate: more than 5 % of the instants failed the bandwidth test";
    case ZYGOS_REASON_NOT_PHYSICAL:
        return "the estimate is not physical: an inertia matrix that is not positive definite, or a negative Im, k, b "
               "or friction";
    case ZYGOS_REASON_CORRUPT:
        return "the accumulated sums are corrupt: memory was changed from outside";
    case ZYGOS_REASON_UNCLOSED:
        return "the balance does not close: what the solution leaves over is no noise";
    case ZYGOS_REASON_NOISE:
        return "sensor noise is as large as the motion in some combination of parameters";
    case ZYGOS_REASON_DECLARED:
        return "the declared sensor noise is not in the data: the residuals are far smaller";
    case ZYGOS_REASON_CHANGED:
        return "the arm changed: its newest arcs contradict what those before them say, several in a row";
    case ZYGOS_REASON_UNEXPLAINED:
        return "the balance leaves more than a tenth of the work unexplained, and what it leaves is no noise";
    case ZYGOS_REASON_GAIN:
        return "the gain of a torque sensor differs from what is declared of it";
    case ZYGOS_REASON_OLD:
        return "no row was added for longer than an arc";
    }
    return UNKNOWN;
}

const char *zygos_rows_text(uint32_t rows)
{
    switch ((enum zygos_rows)rows) {
    case ZYGOS_ENERGY_ROWS:
        return "energy";
    case ZYGOS_MOTOR_ROWS:
        return "motor";
    case ZYGOS_MOMENTUM_ROWS:
        return "momentum";
    case ZYGOS_KINDS_OF_ROWS:
        break;
    }
    return UNKNOWN;
}

const char *zygos_channel_text(uint32_t channel)
{
    switch ((enum zygos_channel)channel) {
    case ZYGOS_CHANNEL_LINK:
        return "link encoders";
    case ZYGOS_CHANNEL_MOTOR:
        return "motor encoders";
    case ZYGOS_CHANNEL_GYRO:
        return "gyro";
    case ZYGOS_KINDS_OF_CHANNEL:
        break;
    }
    return UNKNOWN;
}

const char *zygos_refine_text(uint32_t reason)
{
    switch ((enum zygos_refine_reason)reason) {
    case ZYGOS_REFINE_NONE:
        return "the refined values are published";
    case ZYGOS_REFINE_WAITS:
        return "the refinement has not begun, or has used too few readings";
    case ZYGOS_REFINE_ENERGY:
        return "the estimate from energy rows, which has to vouch for the refined values, has none";
    case ZYGOS_REFINE_FAILED:
        return "the filter has left the possible arms";
    case ZYGOS_REFINE_INNOVATIONS:
        return "the innovations of a sensor are larger than noise";
    case ZYGOS_REFINE_LEVEL:
        return "the torques need more noise than is declared";
    case ZYGOS_REFINE_APART:
        return "the estimate from energy rows contradicts the refined values";
    case ZYGOS_REFINE_PHYSICAL:
        return "a refined stiffness, damping or rotor is not positive";
    case ZYGOS_REFINE_CORRUPT:
        return "memory was changed from outside";
    }
    return UNKNOWN;
}

const char *zygos_reception_text(uint32_t reception)
{
    switch ((enum zygos_reception)reception) {
    case ZYGOS_FOREIGN:
        return "not a frame of this arm";
    case ZYGOS_ACCEPTED:
        return "accepted";
    case ZYGOS_REJECTED:
        return "rejected and counted";
    }
    return UNKNOWN;
}

const char *zygos_message_text(uint32_t message)
{
    switch ((enum zygos_message)message) {
    case ZYGOS_MSG_FOREIGN:
        return "not a message of this arm";
    case ZYGOS_MSG_SYNC:
        return "SYNC";
    case ZYGOS_MSG_ANGLES:
        return "angles of a joint";
    case ZYGOS_MSG_TORQUE:
        return "torque of a joint";
    case ZYGOS_MSG_RATE_XY:
        return "rates about x and y of a fine gyro";
    case ZYGOS_MSG_RATE_Z:
        return "rate about z of a fine gyro";
    case ZYGOS_MSG_RATE_COARSE:
        return "rates of a coarse gyro";
    case ZYGOS_MSG_FTIME:
        return "FTIME";
    }
    return UNKNOWN;
}

const char *zygos_wire_fault_text(uint32_t fault)
{
    switch ((enum zygos_wire_fault)fault) {
    case ZYGOS_WIRE_OK:
        return "no fault";
    case ZYGOS_WIRE_LENGTH:
        return "wrong length";
    case ZYGOS_WIRE_CRC:
        return "wrong CRC or data identifier";
    case ZYGOS_WIRE_RANGE:
        return "a field outside its range";
    }
    return UNKNOWN;
}

#define AT(counter) ((uint32_t)(offsetof(zygos_faults_t, counter) / sizeof(uint32_t)))

_Static_assert(ZYGOS_FAULT_COUNTERS == 22u, "a fault counter without a text");

/* NULL where the counter is none of frames. */
static const char *frame_fault_text(uint32_t counter)
{
    switch (counter) {
    case AT(length):
        return "frames with a wrong length";
    case AT(crc):
        return "frames with a wrong CRC or data identifier";
    case AT(range):
        return "frames with a field outside its range";
    case AT(late):
        return "frames of the cycle that closed last";
    case AT(counter):
        return "frames whose counter belongs neither to the open cycle nor to the last one";
    case AT(repeated):
        return "frames that came twice in one cycle";
    case AT(unsynced):
        return "frames before the first SYNC";
    case AT(latch):
        return "torque frames whose latch delay differs from the configured one";
    case AT(link_invalid):
        return "frames that report an invalid link angle";
    case AT(motor_invalid):
        return "frames that report an invalid motor angle";
    case AT(torque_invalid):
        return "frames that report an invalid torque";
    case AT(disabled):
        return "frames that report a disabled drive or a closed brake";
    case AT(gyro_invalid):
        return "frames that report an invalid base rate, or are of the other kind of gyro";
    case AT(saturated):
        return "frames with a saturated torque or rate";
    default:
        return NULL;
    }
}

const char *zygos_fault_text(uint32_t counter)
{
    switch (counter) {
    case AT(incomplete):
        return "cycles that closed with a frame missing or rejected";
    case AT(dropped):
        return "cycles that were not used, for any reason";
    case AT(sync_repeated):
        return "SYNCs with the counter of the SYNC before";
    case AT(sync_jumped):
        return "SYNCs that skipped at least one counter";
    case AT(time_lost):
        return "times that more than 120 cycles passed without FTIME";
    case AT(time_jumped):
        return "FTIMEs that disagree with the SYNC count";
    case AT(overrun):
        return "complete cycles that were lost because the queue was full";
    case AT(bus_error):
        return "error frames from the CAN controller";
    default:
        break;
    }
    const char *text = frame_fault_text(counter);
    return (text != NULL) ? text : UNKNOWN;
}

const char *zygos_kinetic_text(uint32_t kinetic)
{
    switch ((enum zygos_kinetic)kinetic) {
    case ZYGOS_PLANAR_SYMMETRIC:
        return "planar, centres of mass on the lines between the joints";
    case ZYGOS_PLANAR:
        return "planar";
    case ZYGOS_SPATIAL_ARM:
        return "spatial";
    }
    return UNKNOWN;
}

const char *zygos_base_text(uint32_t base)
{
    switch ((enum zygos_base)base) {
    case ZYGOS_BASE_FREE:
        return "free-floating base";
    case ZYGOS_BASE_FIXED:
        return "fixed base";
    }
    return UNKNOWN;
}

const char *zygos_torque_law_text(uint32_t torque_law)
{
    switch ((enum zygos_torque_law)torque_law) {
    case ZYGOS_TORQUE_APPLIED_FROM_SYNC:
        return "the reported torque is applied from the SYNC that opens its cycle";
    case ZYGOS_TORQUE_APPLIED_PREVIOUS_CYCLE:
        return "the reported torque was applied during the previous cycle";
    case ZYGOS_TORQUE_SAMPLED:
        return "the torque varies and is sampled at each SYNC";
    }
    return UNKNOWN;
}

const char *zygos_effect_text(uint32_t kind)
{
    switch ((enum zygos_effect_kind)kind) {
    case ZYGOS_MOTOR_COULOMB:
        return "Coulomb friction at the motor";
    case ZYGOS_MOTOR_VISCOUS:
        return "viscous friction at the motor";
    case ZYGOS_LINK_COULOMB:
        return "Coulomb friction at the link";
    case ZYGOS_CUBIC_STIFFNESS:
        return "cubic joint stiffness";
    case ZYGOS_TORQUE_LAG:
        return "torque lag";
    case ZYGOS_SPRING_OFFSET:
        return "offset of the spring";
    case ZYGOS_TORQUE_OFFSET:
        return "constant offset of the torque";
    case ZYGOS_VISCOUS_ASYMMETRY:
        return "difference of viscous friction between the directions";
    case ZYGOS_TORQUE_GAIN:
        return "error of the torque sensor's gain";
    }
    return UNKNOWN;
}

const char *zygos_snapshot_kind_text(uint32_t kind)
{
    switch ((enum zygos_snapshot_kind)kind) {
    case ZYGOS_SNAPSHOT_CONFIG:
        return "configuration";
    case ZYGOS_SNAPSHOT_STATE:
        return "state";
    }
    return UNKNOWN;
}

const char *zygos_stage_text(uint32_t stage)
{
    switch ((enum zygos_stage)stage) {
    case ZYGOS_STAGE_IDLE:
        return "no solution is asked for";
    case ZYGOS_STAGE_ASKED:
        return "the sums are being copied";
    case ZYGOS_STAGE_GIVEN:
        return "the sums are with the solver";
    case ZYGOS_STAGE_SOLVED:
        return "an estimate waits to be adopted";
    }
    return UNKNOWN;
}
