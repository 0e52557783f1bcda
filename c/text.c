#include "zygos/zygos.h"

#include <stddef.h>

#include "zygos/priv/cycle.h"
#include "zygos/priv/guard.h"
#include "zygos/priv/refiner.h"
#include "zygos/priv/solver.h"

#define UNKNOWN "unknown code"
#define LENGTH(table) ((uint32_t)(sizeof(table) / sizeof((table)[0])))

static const char *text_at(const char *const *table, uint32_t length, uint32_t code)
{
    return ((code < length) && (table[code] != NULL)) ? table[code] : UNKNOWN;
}

static const char *const error_texts[] = {
    [-ZYGOS_E_NULL] = "a required pointer is null",
    [-ZYGOS_E_ABI] = "the library was built with other headers",
    [-ZYGOS_E_JOINTS] = "too many joints for this build",
    [-ZYGOS_E_KINETIC] = "this build has no columns of that `kinetic`",
    [-ZYGOS_E_PERIOD] = "period_s must be within 1e-5 .. 0.065",
    [-ZYGOS_E_TORQUE_LAW] = "unknown torque_law",
    [-ZYGOS_E_SMOOTHER] =
        ("the smoother's half width, order or lag are out of range (lag must equal the half width: end-point "
         "filters are refused)"),
    [-ZYGOS_E_NODE] = "node numbers must be 1..31, each used once",
    [-ZYGOS_E_AXIS] = "joint axes must be unit vectors, parallel where the arm is planar",
    [-ZYGOS_E_VALUE] =
        ("a ratio, sign, zero, sigma, latch delay, forgetting_factor, compensation, imu_fine or imu_to_base is "
         "out of range"),
    [-ZYGOS_E_ARC] =
        ("arc_cycles, impulse_arc_cycles or momentum_arc_cycles is below 20, joint_row_cycles is odd or too "
         "short, or this build has no room for such rows"),
    [-ZYGOS_E_ORDER] = "zygos_init() or zygos_resume() has not succeeded on this struct",
    [-ZYGOS_E_KEEP] = "zygos_restart() does not know one of the bits, or there are no motor rows to keep",
    [-ZYGOS_E_EFFECT] = "an effect stands twice, or has no columns in this build",
    [-ZYGOS_E_BASE] = "base, gravity and gyro do not fit each other",
    [-ZYGOS_E_SNAPSHOT] = "is no snapshot of zygos",
    [-ZYGOS_E_FORMAT] = "is a snapshot of a format that this version does not read",
    [-ZYGOS_E_KIND] = "is a snapshot of the other kind",
    [-ZYGOS_E_BYTE_ORDER] = "was written by a machine of the other byte order",
    [-ZYGOS_E_LAYOUT] = "was written by a build with other capacities, structs or version",
    [-ZYGOS_E_LENGTH] = "is cut off, or has more bytes than its head says",
    [-ZYGOS_E_CRC] = "is damaged: its CRC does not fit its bytes",
    [-ZYGOS_E_CONFIG] = "is the state of another configuration",
    [-ZYGOS_E_STATE] =
        ("holds an index, count or length that cannot be: memory was changed, in a stored state before it was "
         "sealed"),
    [-ZYGOS_E_SUMS] =
        ("holds sums that do not match their row sums: memory was changed, in a stored state before it was "
         "sealed"),
    [-ZYGOS_E_REDUCTION] = "the reduction to independent columns does not fit the arm or this build",
    [-ZYGOS_E_ARITHMETIC] = "the library was compiled with flags that break IEEE arithmetic",
    [-ZYGOS_E_MEMORY] = "the memory for solutions is smaller than a zygos_in_place_t",
};

const char *zygos_text(int code)
{
    if (code >= 0) {
        return "no error";
    }
    return text_at(error_texts, LENGTH(error_texts), 0u - (uint32_t)code);
}

static const char *const validity_texts[] = {
    [ZYGOS_REFUSED] = "refused",
    [ZYGOS_DOUBTFUL] = "doubtful",
    [ZYGOS_PARTIAL] = "partial",
    [ZYGOS_VALID] = "valid",
};

const char *zygos_validity_text(uint32_t validity)
{
    return text_at(validity_texts, LENGTH(validity_texts), validity);
}

static const char *const reason_texts[] = {
    [ZYGOS_REASON_NONE] = "none",
    [ZYGOS_REASON_NO_DATA] = "too few accepted instants",
    [ZYGOS_REASON_NOT_IDENTIFIABLE] = "the motion so far does not determine every parameter",
    [ZYGOS_REASON_TOO_FAST] =
        "motion too fast for this sample rate: more than 5 % of the instants failed the bandwidth test",
    [ZYGOS_REASON_NOT_PHYSICAL] =
        ("the estimate is not physical: an inertia matrix that is not positive definite, or a negative Im, k, b "
         "or friction"),
    [ZYGOS_REASON_CORRUPT] = "the accumulated sums are corrupt: memory was changed from outside",
    [ZYGOS_REASON_UNCLOSED] = "the balance does not close: what the solution leaves over is no noise",
    [ZYGOS_REASON_NOISE] = "sensor noise is as large as the motion in some combination of parameters",
    [ZYGOS_REASON_DECLARED] = "the declared sensor noise is not in the data: the residuals are far smaller",
    [ZYGOS_REASON_CHANGED] = "the arm changed: its newest arcs contradict what those before them say, several in a row",
    [ZYGOS_REASON_UNEXPLAINED] =
        "the balance leaves more than a tenth of the work unexplained, and what it leaves is no noise",
    [ZYGOS_REASON_GAIN] = "the gain of a torque sensor differs from what is declared of it",
    [ZYGOS_REASON_OLD] = "no row was added for longer than an arc",
};

const char *zygos_reason_text(uint32_t reason)
{
    return text_at(reason_texts, LENGTH(reason_texts), reason);
}

static const char *const rows_texts[] = {
    [ZYGOS_ENERGY_ROWS] = "energy",
    [ZYGOS_MOTOR_ROWS] = "motor",
    [ZYGOS_MOMENTUM_ROWS] = "momentum",
};

const char *zygos_rows_text(uint32_t rows)
{
    return text_at(rows_texts, LENGTH(rows_texts), rows);
}

static const char *const channel_texts[] = {
    [ZYGOS_CHANNEL_LINK] = "link encoders",
    [ZYGOS_CHANNEL_MOTOR] = "motor encoders",
    [ZYGOS_CHANNEL_GYRO] = "gyro",
};

const char *zygos_channel_text(uint32_t channel)
{
    return text_at(channel_texts, LENGTH(channel_texts), channel);
}

static const char *const refine_texts[] = {
    [ZYGOS_REFINE_NONE] = "the refined values are published",
    [ZYGOS_REFINE_WAITS] = "the refinement has not begun, or has used too few readings",
    [ZYGOS_REFINE_ENERGY] = "the estimate from energy rows, which has to vouch for the refined values, has none",
    [ZYGOS_REFINE_FAILED] = "the filter has left the possible arms",
    [ZYGOS_REFINE_INNOVATIONS] = "the innovations of a sensor are larger than noise",
    [ZYGOS_REFINE_LEVEL] = "the torques need more noise than is declared",
    [ZYGOS_REFINE_APART] = "the estimate from energy rows contradicts the refined values",
    [ZYGOS_REFINE_PHYSICAL] = "a refined stiffness, damping or rotor is not positive",
    [ZYGOS_REFINE_CORRUPT] = "memory was changed from outside",
};

const char *zygos_refine_text(uint32_t reason)
{
    return text_at(refine_texts, LENGTH(refine_texts), reason);
}

static const char *const reception_texts[] = {
    [ZYGOS_FOREIGN] = "not a frame of this arm",
    [ZYGOS_ACCEPTED] = "accepted",
    [ZYGOS_REJECTED] = "rejected and counted",
};

const char *zygos_reception_text(uint32_t reception)
{
    return text_at(reception_texts, LENGTH(reception_texts), reception);
}

static const char *const message_texts[] = {
    [ZYGOS_MSG_FOREIGN] = "not a message of this arm",
    [ZYGOS_MSG_SYNC] = "SYNC",
    [ZYGOS_MSG_ANGLES] = "angles of a joint",
    [ZYGOS_MSG_TORQUE] = "torque of a joint",
    [ZYGOS_MSG_RATE_XY] = "rates about x and y of a fine gyro",
    [ZYGOS_MSG_RATE_Z] = "rate about z of a fine gyro",
    [ZYGOS_MSG_RATE_COARSE] = "rates of a coarse gyro",
    [ZYGOS_MSG_FTIME] = "FTIME",
};

const char *zygos_message_text(uint32_t message)
{
    return text_at(message_texts, LENGTH(message_texts), message);
}

static const char *const wire_fault_texts[] = {
    [ZYGOS_WIRE_OK] = "no fault",
    [ZYGOS_WIRE_LENGTH] = "wrong length",
    [ZYGOS_WIRE_CRC] = "wrong CRC or data identifier",
    [ZYGOS_WIRE_RANGE] = "a field outside its range",
};

const char *zygos_wire_fault_text(uint32_t fault)
{
    return text_at(wire_fault_texts, LENGTH(wire_fault_texts), fault);
}

#define AT(counter) ((uint32_t)(offsetof(zygos_faults_t, counter) / sizeof(uint32_t)))

_Static_assert(ZYGOS_FAULT_COUNTERS == 22u, "a fault counter without a text");

static const char *const fault_texts[] = {
    [AT(length)] = "frames with a wrong length",
    [AT(crc)] = "frames with a wrong CRC or data identifier",
    [AT(range)] = "frames with a field outside its range",
    [AT(late)] = "frames of the cycle that closed last",
    [AT(counter)] = "frames whose counter belongs neither to the open cycle nor to the last one",
    [AT(repeated)] = "frames that came twice in one cycle",
    [AT(unsynced)] = "frames before the first SYNC",
    [AT(latch)] = "torque frames whose latch delay differs from the configured one",
    [AT(link_invalid)] = "frames that report an invalid link angle",
    [AT(motor_invalid)] = "frames that report an invalid motor angle",
    [AT(torque_invalid)] = "frames that report an invalid torque",
    [AT(disabled)] = "frames that report a disabled drive or a closed brake",
    [AT(gyro_invalid)] = "frames that report an invalid base rate, or are of the other kind of gyro",
    [AT(saturated)] = "frames with a saturated torque or rate",
    [AT(incomplete)] = "cycles that closed with a frame missing or rejected",
    [AT(dropped)] = "cycles that were not used, for any reason",
    [AT(sync_repeated)] = "SYNCs with the counter of the SYNC before",
    [AT(sync_jumped)] = "SYNCs that skipped at least one counter",
    [AT(time_lost)] = "times that more than 120 cycles passed without FTIME",
    [AT(time_jumped)] = "FTIMEs that disagree with the SYNC count",
    [AT(overrun)] = "complete cycles that were lost because the queue was full",
    [AT(bus_error)] = "error frames from the CAN controller",
};

const char *zygos_fault_text(uint32_t counter)
{
    return text_at(fault_texts, LENGTH(fault_texts), counter);
}

static const char *const kinetic_texts[] = {
    [ZYGOS_PLANAR_SYMMETRIC] = "planar, centres of mass on the lines between the joints",
    [ZYGOS_PLANAR] = "planar",
    [ZYGOS_SPATIAL_ARM] = "spatial",
};

const char *zygos_kinetic_text(uint32_t kinetic)
{
    return text_at(kinetic_texts, LENGTH(kinetic_texts), kinetic);
}

static const char *const base_texts[] = {
    [ZYGOS_BASE_FREE] = "free-floating base",
    [ZYGOS_BASE_FIXED] = "fixed base",
};

const char *zygos_base_text(uint32_t base)
{
    return text_at(base_texts, LENGTH(base_texts), base);
}

static const char *const torque_law_texts[] = {
    [ZYGOS_TORQUE_APPLIED_FROM_SYNC] = "the reported torque is applied from the SYNC that opens its cycle",
    [ZYGOS_TORQUE_APPLIED_PREVIOUS_CYCLE] = "the reported torque was applied during the previous cycle",
    [ZYGOS_TORQUE_SAMPLED] = "the torque varies and is sampled at each SYNC",
};

const char *zygos_torque_law_text(uint32_t torque_law)
{
    return text_at(torque_law_texts, LENGTH(torque_law_texts), torque_law);
}

static const char *const effect_texts[] = {
    [ZYGOS_MOTOR_COULOMB] = "Coulomb friction at the motor",
    [ZYGOS_MOTOR_VISCOUS] = "viscous friction at the motor",
    [ZYGOS_LINK_COULOMB] = "Coulomb friction at the link",
    [ZYGOS_CUBIC_STIFFNESS] = "cubic joint stiffness",
    [ZYGOS_TORQUE_LAG] = "torque lag",
    [ZYGOS_SPRING_OFFSET] = "offset of the spring",
    [ZYGOS_TORQUE_OFFSET] = "constant offset of the torque",
    [ZYGOS_VISCOUS_ASYMMETRY] = "difference of viscous friction between the directions",
    [ZYGOS_TORQUE_GAIN] = "error of the torque sensor's gain",
};

const char *zygos_effect_text(uint32_t kind)
{
    return text_at(effect_texts, LENGTH(effect_texts), kind);
}

static const char *const snapshot_kind_texts[] = {
    [ZYGOS_SNAPSHOT_CONFIG] = "configuration",
    [ZYGOS_SNAPSHOT_STATE] = "state",
};

const char *zygos_snapshot_kind_text(uint32_t kind)
{
    return text_at(snapshot_kind_texts, LENGTH(snapshot_kind_texts), kind);
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
