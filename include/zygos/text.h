/// zygos/text.h: the meaning of codes in words, for logs and consoles.
///
/// There is one function for each enumeration whose values mean one thing each; enumerations of bits have none, because
/// their values are combinations. Every function returns a constant string in English, without a full stop, and
/// "unknown code" for a number that is no value of its enumeration; it never returns null. The strings are read-only
/// data. A program that calls none of these functions does not link them: they are an object file of their own in the
/// library.

#ifndef ZYGOS_TEXT_H
#define ZYGOS_TEXT_H

#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What a call returned: enum zygos_error, and "no error" for 0 and above. The texts of the codes from ZYGOS_E_SNAPSHOT
/// down continue a sentence that begins with the name of the stored file.
const char *zygos_text(int code);

/// Texts of enum zygos_validity and of enum zygos_reason, from an estimate.
const char *zygos_validity_text(uint32_t validity);
const char *zygos_reason_text(uint32_t reason);

/// Text of a kind of rows, enum zygos_rows.
const char *zygos_rows_text(uint32_t rows);

/// Text of a kind of readings whose innovations are counted, enum zygos_channel.
const char *zygos_channel_text(uint32_t channel);

/// Text of why refined values are not published, enum zygos_refine_reason.
const char *zygos_refine_text(uint32_t reason);

/// Texts of enum zygos_reception, which zygos_arm_frame() returns, of enum zygos_message and of enum zygos_wire_fault.
const char *zygos_reception_text(uint32_t reception);
const char *zygos_message_text(uint32_t message);
const char *zygos_wire_fault_text(uint32_t fault);

/// Text of what a fault counter counts. counter: its place in zygos_faults_t, 0 .. ZYGOS_FAULT_COUNTERS - 1.
const char *zygos_fault_text(uint32_t counter);

/// Texts of the enumerations in a configuration: enum zygos_kinetic, zygos_base, zygos_torque_law, zygos_effect_kind.
const char *zygos_kinetic_text(uint32_t kinetic);
const char *zygos_base_text(uint32_t base);
const char *zygos_torque_law_text(uint32_t torque_law);
const char *zygos_effect_text(uint32_t kind);

/// Text of where a solution is, enum zygos_stage.
const char *zygos_stage_text(uint32_t stage);

/// Text of a kind of snapshot, enum zygos_snapshot_kind.
const char *zygos_snapshot_kind_text(uint32_t kind);

#ifdef __cplusplus
}
#endif
#endif
