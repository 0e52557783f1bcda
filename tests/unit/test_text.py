# SPDX-License-Identifier: MIT
"""Codes in words: every enumerator of the library has a text of its own, and every other number the same one."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from conftest import house_flags
from zygos.effects import CATALOGUE
from zygos.native.flight import REASONS, ROWS, VALIDITY, ffi, lib, text_of

ROOT = Path(__file__).resolve().parents[2]
HEADERS = sorted((ROOT / "include" / "zygos").rglob("*.h"))
TEXTS = {
    "zygos_error": lib.zygos_text,
    "zygos_validity": lib.zygos_validity_text,
    "zygos_reason": lib.zygos_reason_text,
    "zygos_rows": lib.zygos_rows_text,
    "zygos_channel": lib.zygos_channel_text,
    "zygos_refine_reason": lib.zygos_refine_text,
    "zygos_reception": lib.zygos_reception_text,
    "zygos_message": lib.zygos_message_text,
    "zygos_wire_fault": lib.zygos_wire_fault_text,
    "zygos_kinetic": lib.zygos_kinetic_text,
    "zygos_base": lib.zygos_base_text,
    "zygos_torque_law": lib.zygos_torque_law_text,
    "zygos_effect_kind": lib.zygos_effect_text,
    "zygos_snapshot_kind": lib.zygos_snapshot_kind_text,
    "zygos_stage": lib.zygos_stage_text,
}
BITS = {
    "zygos_cycle_flag",
    "zygos_frame_flag",
    "zygos_joint_status",
    "zygos_imu_status",
    "zygos_keep",
    "zygos_scrubbed",
}
"""Enumerations of bits: their values are combinations, and have no text."""
UNKNOWN = "unknown code"


def values_of(enum: str) -> list[int]:
    """Of every enumerator but the one that counts the others."""
    elements = ffi.typeof(f"enum {enum}").elements
    return [value for value, name in elements.items() if not name.startswith("ZYGOS_KINDS_")]


def test_every_enumeration_has_texts_or_is_one_of_bits() -> None:
    text = "\n".join(header.read_text() for header in HEADERS)
    assert set(re.findall(r"^enum (zygos_\w+) \{", text, re.M)) == set(TEXTS) | BITS


def check(function: Any, values: list[int]) -> None:
    """One-line texts, each of its own, and one for all numbers beside them."""
    texts = [text_of(function, value) for value in values]
    assert len(set(texts)) == len(values)
    for text in texts:
        assert text == text.strip() != ""
        assert text.isprintable() and text.isascii() and not text.endswith(".")
        assert text != UNKNOWN
    assert text_of(function, max(values) + 1 if min(values) >= 0 else min(values) - 1) == UNKNOWN
    assert text_of(function, -(2**31) if min(values) < 0 else 2**32 - 1) == UNKNOWN


@pytest.mark.parametrize("enum", TEXTS)
def test_every_enumerator_has_a_text_of_its_own(enum: str) -> None:
    check(TEXTS[enum], values_of(enum))


def test_every_fault_counter_has_a_text_of_its_own() -> None:
    check(lib.zygos_fault_text, list(range(len(ffi.typeof("zygos_faults_t").fields))))


def test_a_call_that_succeeded_has_no_error() -> None:
    assert [text_of(lib.zygos_text, code) for code in (0, 1, 2**31 - 1)] == ["no error"] * 3


def test_the_harness_has_the_texts_of_the_library() -> None:
    """By value, as an estimate holds them; no reason is none."""
    assert VALIDITY[lib.ZYGOS_VALID] == "valid" and len(VALIDITY) == len(values_of("zygos_validity"))
    assert REASONS[lib.ZYGOS_REASON_NONE] == "" and len(REASONS) == len(values_of("zygos_reason"))
    assert REASONS[lib.ZYGOS_REASON_CORRUPT].startswith("the accumulated sums are corrupt")
    assert (ROWS[lib.ZYGOS_MOTOR_ROWS], len(ROWS)) == ("motor", lib.ZYGOS_KINDS_OF_ROWS)


def test_an_effect_has_the_same_name_on_board_and_in_the_catalogue() -> None:
    for value, name in ffi.typeof("enum zygos_effect_kind").elements.items():
        assert text_of(lib.zygos_effect_text, value) == CATALOGUE[name.removeprefix("ZYGOS_").lower()].title


@pytest.mark.slow
def test_a_program_that_asks_for_no_text_links_none(tmp_path: Path) -> None:
    """The library as it is installed: an archive, whose members are linked where something needs them."""
    subprocess.run(["make", "-C", str(ROOT), "library", f"BUILD={tmp_path}"], capture_output=True, check=True)
    found = []
    for call in ("zygos_arm_init(&arm, 0)", "(zygos_text(zygos_arm_init(&arm, 0))[0] == 'a')"):
        source = tmp_path / "main.c"
        source.write_text(
            f'#include "zygos/zygos.h"\nstatic zygos_arm_t arm;\nint main(void)\n{{\n    return {call};\n}}\n'
        )
        program = tmp_path / "program"
        command = ["cc", *house_flags(), "-Werror", "-I", str(ROOT / "include"), str(source)]
        subprocess.run([*command, str(tmp_path / "libzygos.a"), "-lm", "-o", str(program)], check=True)
        names = subprocess.run(["nm", str(program)], capture_output=True, text=True, check=True).stdout
        found.append("zygos_reason_text" in names)
    assert found == [False, True]
