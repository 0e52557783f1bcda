# SPDX-License-Identifier: MIT
"""Snapshots: the bytes are those of docs/snapshot.md, every damage is refused, and what resumes loses only time."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cffi import FFI
from flight_support import copy_of
from numpy.typing import NDArray
from snapshot_support import HEAD, MAGIC, layout_digest, sealed
from state_support import config_of_its_own, lose_the_way, one_of_each

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.native import snapshot
from zygos.native.flight import Flight, config_of, encode, ffi, lib
from zygos.simulation.plant import Trajectory

SYNC = 0x080


def image_of(flight: Flight) -> bytes:
    return bytes(ffi.buffer(flight.native))


@pytest.fixture(scope="module")
def frames(noisy: Trajectory) -> NDArray[Any]:
    return encode(load_arm(EXAMPLE / "arm.toml"), noisy.cycles(0))


def cycle_starts(frames: NDArray[Any]) -> NDArray[np.int64]:
    return np.flatnonzero(frames["id"] == SYNC)


# The layout


def test_the_digest_of_the_layout_is_up_to_date() -> None:
    found = layout_digest(ffi)
    assert found == lib.ZYGOS_LAYOUT_VALUE, f"a struct changed; remedy: #define ZYGOS_LAYOUT 0x{found:08X}u in zygos.h"


def test_the_digest_sees_what_moves_and_no_name() -> None:
    def digest(text: str) -> int:
        binding = FFI()
        binding.cdef(f"typedef struct {{ double x[2]; }} in_t; typedef struct {{ {text} }} x_t;")
        return layout_digest(binding, ("x_t",))

    first = digest("in_t a; double b; uint32_t c, d;")
    assert digest("in_t other; double names; uint32_t of, all;") == first
    for changed in (
        "in_t a; uint32_t c, d; double b;",
        "in_t a; double b; uint32_t c; int32_t d;",
        "in_t a; double b; uint64_t c;",
        "in_t a[2]; double b; uint32_t c, d;",
        "double a[2]; double b; uint32_t c, d;",
        "in_t a; double b; uint32_t c, d; uint64_t e;",
    ):
        assert digest(changed) != first, changed


def test_capacities_change_the_hash(tmp_path: Path) -> None:
    """What no reader of the text sees: each capacity gives another number."""
    program = '#include "zygos/zygos.h"\n#include <stdio.h>\nint main(void) { printf("%u\\n", ZYGOS_ABI); return 0; }\n'
    (tmp_path / "abi.c").write_text(program)
    found = []
    for flag in (
        *("", "MAX_JOINTS=2", "MAX_HALF_WIDTH=14", "MAX_BLOCKS=30", "CYCLE_QUEUE=16", "SPATIAL=0", "MOMENTUM=0"),
    ):
        define = [f"-DZYGOS_{flag}"] if flag else []
        command = ["cc", "-std=c11", "-I", str(ROOT / "include"), *define, str(ROOT / "c" / "loop" / "capacities.c")]
        subprocess.run([*command, str(tmp_path / "abi.c"), "-o", str(tmp_path / "abi")], check=True)
        found.append(int(subprocess.run([tmp_path / "abi"], capture_output=True, check=True).stdout))
    assert found[0] == lib.zygos_abi()
    assert len(set(found)) == len(found)


# The bytes


def test_bytes_are_as_specified(arm: Arm, frames: NDArray[Any]) -> None:
    """Head by struct, CRC-32C by the package crc32c, image by cffi."""
    flight = Flight(arm)
    flight.frames(frames[:2000])
    assert snapshot.seal("state", flight.native) == sealed(2, image_of(flight), lib.zygos_abi())
    config = config_of(arm)
    assert snapshot.seal("configuration", config) == sealed(1, bytes(ffi.buffer(config)), lib.zygos_abi())
    assert HEAD.size == lib.ZYGOS_SNAPSHOT_HEAD_VALUE == 24


def check(content: bytes, kind: int, size: int) -> int:
    """`zygos_snapshot_check` on bytes as a reader has them: whatever is missing of the image is 0."""
    image = content[24:].ljust(size, b"\0")
    return int(lib.zygos_snapshot_check(kind, content[:24].ljust(24, b"\0"), ffi.from_buffer(image), len(content)))


def test_each_refusal_has_its_code(arm: Arm) -> None:
    image, abi = bytes(ffi.buffer(config_of(arm))), lib.zygos_abi()
    size = len(image)
    good = sealed(1, image, abi)
    assert check(good, 1, size) == 1
    cases = {
        lib.ZYGOS_E_SNAPSHOT: [
            (b"", 1),
            (good[:23], 1),
            (sealed(1, image, abi, magic=b"\x89zygos\n\n"), 1),
            (b"\0" * len(good), 1),
        ],
        lib.ZYGOS_E_FORMAT: [(sealed(1, image, abi, form=form), 1) for form in (0, 2, 257)],
        lib.ZYGOS_E_KIND: [(sealed(2, image, abi), 1), (good, 2), (good, 0), (good, 3), (sealed(3, image, abi), 3)],
        lib.ZYGOS_E_BYTE_ORDER: [(sealed(1, image, abi, order=order), 1) for order in (0, 2)],
        lib.ZYGOS_E_LAYOUT: [(sealed(1, image, abi ^ 1), 1)],
        lib.ZYGOS_E_LENGTH: [
            (good[:24], 1),
            (good[:-1], 1),
            (good + b"\0", 1),
            (sealed(1, image[:-8], abi), 1),
            (sealed(1, image + bytes(8), abi), 1),
        ],
        lib.ZYGOS_E_CRC: [(good[:-1] + bytes([good[-1] ^ 1]), 1), (good[:20] + b"\0\0\0\0" + good[24:], 1)],
    }
    for code, contents in cases.items():
        for content, kind in contents:
            assert check(content, kind, size) == code


def test_every_flipped_bit_is_refused(arm: Arm) -> None:
    image = bytes(ffi.buffer(config_of(arm)))
    good = bytearray(sealed(1, image, lib.zygos_abi()))
    for bit in [*range(8 * 40), *range(8 * 40, 8 * len(good), 331)]:  # of the head all
        good[bit // 8] ^= 1 << bit % 8
        assert check(bytes(good), 1, len(image)) < 0
        good[bit // 8] ^= 1 << bit % 8
    assert check(bytes(good), 1, len(image)) == 1


def test_misuse_changes_nothing(arm: Arm) -> None:
    config, head = config_of(arm), ffi.new("uint8_t[24]", b"\xaa" * 24)
    assert lib.zygos_snapshot_seal(1, ffi.NULL, head) == lib.ZYGOS_E_NULL
    assert lib.zygos_snapshot_seal(1, config, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_snapshot_seal(0, config, head) == lib.ZYGOS_E_KIND
    assert lib.zygos_snapshot_seal(3, config, head) == lib.ZYGOS_E_KIND
    assert bytes(head) == b"\xaa" * 24
    assert lib.zygos_snapshot_check(1, ffi.NULL, config, 24) == lib.ZYGOS_E_NULL
    assert lib.zygos_snapshot_check(1, head, ffi.NULL, 24) == lib.ZYGOS_E_NULL


def test_files(arm: Arm, tmp_path: Path) -> None:
    path = tmp_path / "arm.zyg"
    snapshot.write(path, "configuration", config_of(arm))
    assert bytes(ffi.buffer(snapshot.read(path, "configuration"))) == bytes(ffi.buffer(config_of(arm)))
    content = path.read_bytes()
    assert content.startswith(MAGIC)
    for damaged, word in (
        (b"no snapshot, but text", "is no snapshot of zygos"),
        (content[:-1], "is cut off"),
        (content[:100] + b"\1" + content[101:], "is damaged"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(ZygosError, match=f"arm.zyg: {word}.*; remedy: "):
            snapshot.read(path, "configuration")
    path.write_bytes(content)
    with pytest.raises(ZygosError, match="something else, no state; remedy: "):
        snapshot.read(path, "state")
    with pytest.raises(ZygosError, match=r"cannot be read .*; remedy: "):
        snapshot.read(tmp_path / "nothing.zyg", "state")


# Resuming


def stored(flight: Flight, folder: Path) -> Path:
    path = folder / "state.zyg"
    snapshot.write(path, "state", flight.native)
    return path


def resumed(arm: Arm, flight: Flight, folder: Path) -> Flight:
    again = Flight(arm)
    snapshot.resume(again, stored(flight, folder))
    return again


def test_resume_refuses_what_it_was_not_made_for(arm: Arm, tmp_path: Path) -> None:
    flight = Flight(arm)
    path = stored(flight, tmp_path)
    other = Flight(replace(arm, arc_max_s=2.0 * arm.arc_max_s))
    before = image_of(other)
    with pytest.raises(ZygosError, match="state of another configuration"):
        snapshot.resume(other, path)
    assert image_of(other) == before
    config, raw = config_of(arm), ffi.new("zygos_arm_t *")
    assert lib.zygos_arm_resume(ffi.NULL, config) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_resume(flight.native, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_resume(raw, config) == lib.ZYGOS_E_ORDER
    config.period_s = 1.0
    assert lib.zygos_arm_resume(flight.native, config) == lib.ZYGOS_E_PERIOD


def test_a_number_that_cannot_be_is_refused(arm: Arm, frames: NDArray[Any], tmp_path: Path) -> None:
    """The CRC is good: memory was changed before it was sealed. Whatever any member is, the state is refused and stays
    as it is, or what follows stays within its memory."""
    flight = Flight(arm)
    flight.frames(frames[:2000])
    damaged, own, rng, refused = copy_of(flight), config_of_its_own(flight), np.random.default_rng(0), 0
    listed = one_of_each(flight.native, rng, without=("config",))
    for k, place in enumerate(listed):
        ffi.memmove(damaged.native, flight.native, ffi.sizeof("zygos_arm_t"))
        number, wrong = place.values(damaged.native), (np.nan, -1.0)[k % 2]
        number[0] = wrong if place.leaf.kind == "double" else np.iinfo(place.leaf.dtype).max
        verdict = lib.zygos_arm_resume(damaged.native, own)
        if verdict == 1:
            damaged.frames(frames[2000:2160])
            damaged.estimate()
            continue
        assert verdict == (lib.ZYGOS_E_ORDER if place.leaf.offset == 0 else lib.ZYGOS_E_STATE), place
        refused += 1
        number[0] = place.values(flight.native)[0]
        assert ffi.buffer(damaged.native) == ffi.buffer(flight.native), place
    assert refused > 0.1 * len(listed)
    lose_the_way(flight)
    with pytest.raises(ZygosError, match=r"memory was changed, in a stored state before it was sealed; remedy: "):
        snapshot.resume(Flight(arm), stored(flight, tmp_path))


def test_what_was_learned_and_counted_stays(arm: Arm, frames: NDArray[Any], tmp_path: Path) -> None:
    flight = Flight(arm)
    flight.frames(np.concatenate([frames[:40], frames[30:3000]]))
    again = resumed(arm, flight, tmp_path)
    assert again.faults == flight.faults
    assert again.counts == flight.counts | {"gaps": flight.counts["gaps"] + 1}
    assert again.faults["repeated"] > 0
    assert again.counts["accepted"] > 300
    for ours, theirs in zip(again.normal_equations(), flight.normal_equations(), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_resumed_state_is_that_of_a_gap(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    """A state that resumes behind lost cycles equals one that saw the gap, but for how the loss is counted."""
    cycles = noisy.cycles(1)
    frames = encode(arm, cycles)
    starts = cycle_starts(frames)
    first, second = frames[: starts[500] + 3], frames[starts[507] :]
    whole = Flight(arm)
    whole.frames(np.concatenate([first, second]))
    parts = Flight(arm)
    parts.frames(first)
    parts = resumed(arm, parts, tmp_path)
    parts.frames(second)
    assert parts.faults == whole.faults
    assert parts.faults["dropped"] == parts.faults["sync_jumped"] == 1
    assert parts.counts == whole.counts
    assert parts.native.sums.cycle == whole.native.sums.cycle == len(cycles) - 1
    for ours, theirs in zip(parts.normal_equations(), whole.normal_equations(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    one, other = parts.estimate(), whole.estimate()
    np.testing.assert_array_equal(one.value, other.value)
    np.testing.assert_array_equal(one.half95, other.half95)


@pytest.mark.parametrize("lost", [239, 240, 560])
def test_time_tells_how_long_the_outage_was(lost: int, arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    """The counter tells the outage modulo 240; the first FTIME tells the rest. Nothing that was learned is void."""
    cycles = noisy.cycles(2)
    frames = encode(arm, cycles)
    starts = cycle_starts(frames)
    flight = Flight(arm)
    flight.frames(frames[: starts[420] + 3])
    accepted = flight.counts["accepted"]
    again = resumed(arm, flight, tmp_path)
    again.frames(frames[starts[420 + lost] :])
    assert again.native.sums.cycle == len(cycles) - 1
    assert again.faults["time_jumped"] == 0
    assert again.faults["sync_jumped"] == int(lost % 240 not in (0, 1))
    assert again.faults["sync_repeated"] == int(lost % 240 == 0)
    assert again.counts["accepted"] > accepted + 0.5 * (len(cycles) - 420 - lost)


def test_a_clock_that_started_anew_only_breaks_the_count(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    cycles = noisy.cycles(3)
    frames = encode(arm, cycles)
    starts = cycle_starts(frames)
    flight = Flight(arm)
    flight.frames(frames[: starts[420] + 3])
    accepted = flight.counts["accepted"]
    again = resumed(arm, flight, tmp_path)
    again.frames(frames)  # the plant was switched off and on: counter and clock begin at their first values
    assert again.faults["time_jumped"] == 1
    assert again.counts["accepted"] > accepted + 0.9 * len(cycles)
    assert again.counts["arcs_dropped"] == flight.counts["arcs_dropped"]
    assert again.native.sums.cycle > 420 + len(cycles) - 10


def test_the_open_cycle_is_not_completed_by_another(arm: Arm, frames: NDArray[Any], tmp_path: Path) -> None:
    """Sixteen cycles on, frames bear the same counter; the SYNC before them was missed."""
    starts = cycle_starts(frames)
    flight = Flight(arm)
    flight.frames(frames[: starts[420] + 1])
    again = resumed(arm, flight, tmp_path)
    again.frames(frames[starts[436] + 1 : starts[440] + 1])
    assert again.counts["cycles"] == 420 + 3
    assert again.faults["dropped"] == 1


def test_cycles_in_the_queue_are_forgotten_and_counted(arm: Arm, frames: NDArray[Any], tmp_path: Path) -> None:
    flight = Flight(arm)
    starts = cycle_starts(frames)
    pointer = ffi.cast("zygos_frame_t *", frames.ctypes.data)
    for k in range(int(starts[5]) + 1):
        assert lib.zygos_arm_frame(flight.native, pointer + k) == lib.ZYGOS_ACCEPTED
    again = resumed(arm, flight, tmp_path)
    assert again.faults["dropped"] == 5
    assert lib.zygos_arm_step(again.native) == 0
    assert again.counts["cycles"] == 0


def test_tables_are_computed_anew(arm: Arm, frames: NDArray[Any]) -> None:
    """What follows from the configuration does not rest on the memory that was stored: what is the same in a state that
    has just begun is right again, where the state is not refused."""
    flight = Flight(arm)
    flight.frames(frames[:3000])
    own, rng, anew = config_of_its_own(flight), np.random.default_rng(0), 0
    assert lib.zygos_arm_resume(flight.native, own) == 1
    damaged, begun = copy_of(flight), Flight(arm)
    for place in one_of_each(begun.native, rng, without=("config",)):
        right = place.values(begun.native)[0]
        if right != 0 and right == place.values(flight.native)[0] and place.leaf.kind == "double":
            ffi.memmove(damaged.native, flight.native, ffi.sizeof("zygos_arm_t"))
            place.values(damaged.native)[0] *= 1.0 + 1e-6
            if lib.zygos_arm_resume(damaged.native, own) == 1:
                anew += bool(place.values(damaged.native)[0] == right)
    assert anew > 8
