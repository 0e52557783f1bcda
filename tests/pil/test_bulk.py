# SPDX-License-Identifier: MIT
"""Recorded vectors on a Cortex-M7 and a Cortex-M4F: every byte that the host's library comes to, and no other."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from build_support import ROOMS, capacities
from numpy.typing import NDArray

from pil.conftest import Agree, Measured
from pil.pil_support import (
    BUILDS,
    END,
    PAPER,
    TARGETS,
    Build,
    Record,
    Section,
    compare,
    cycles_section,
    firmware,
    frames_section,
    on_host,
    on_target,
    place,
    recorded,
)
from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect
from zygos.native import flight
from zygos.runs.cycles import Cycles

FUZZ_FRAMES = 20_000


@dataclass(frozen=True)
class Case:
    """What is switched on, at which arm."""

    example: str
    options: Sequence[tuple[str, Any]] = ()
    kinds: Sequence[str] = ()
    """Effects, each at every joint."""
    motion: tuple[float, float] | None = None
    """Period and duration of the run, s, where they are not those of the example."""

    def of(self) -> tuple[Arm, tuple[Effect, ...], Cycles]:
        arm, cycles = recorded(self.example, *(self.motion or ()))
        effects = tuple(Effect(CATALOGUE[kind], joint.name, 0.0) for kind in self.kinds for joint in arm.joints)
        return replace(arm, **dict(self.options)), effects, cycles


FRICTION = ("motor_coulomb", "motor_viscous", "link_coulomb", "cubic_stiffness")
CASES = {
    "paper": Case("paper"),
    "paper, not compensated": Case("paper", [("compensate_every", 0)]),
    "paper, short arcs that fade": Case("paper", [("arc_max_s", 10.0), ("memory_s", 60.0)]),
    "paper, four effects": Case("paper", kinds=FRICTION),
    "paper, lag and offsets": Case("paper", kinds=("torque_lag", "spring_offset")),
    "three in space": Case("spatial"),
    "three in space, not compensated": Case("spatial", [("compensate_every", 0)]),
    "three in space, momentum rows": Case("spatial", [("momentum_max_s", 0.4), ("arc_max_s", 0.5)]),
    # 100 Hz, so that few cycles have more segments of joint rows than there are groups
    "three in space, joint rows": Case("spatial", [("joint_increment_s", 0.2)], motion=(0.01, 30.0)),
    "seven in space": Case("seven"),
    "seven in space, not compensated": Case("seven", [("compensate_every", 0)]),
}


def both(
    folder: Path,
    target: str,
    build: Build,
    config: Any,
    sections: Sequence[Section],
    arithmetic: tuple[str, ...] = (),
    drills: tuple[str, ...] = (),
    rooms: Sequence[Path] = ROOMS,
) -> tuple[list[Record], list[Record], Any]:
    """What host and target come to, and the target's sizes. The library in use must be that of the build."""
    elf = firmware(target, "bulk", build, drills=drills, arithmetic=arithmetic, rooms=rooms)
    records, sizes = on_target(target, elf, folder, config, sections)
    return on_host(config, sections), records, sizes


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", CASES)
def test_from_frames_to_the_estimate(name: str, target: str, tmp_path: Path, agree: Agree, measured: Measured) -> None:
    """Reception, queue, smoother, kinematics, row, noise, sums: the whole zygos_arm_t, padding too; and the solver."""
    case = CASES[name]
    build = BUILDS[case.example]
    with capacities(*build.defines):
        arm, effects, cycles = case.of()
        sections = [frames_section(flight.encode(arm, cycles)), *END]
        host, records, sizes = both(tmp_path, target, build, flight.config_of(arm, effects), sections)
        kinds = Counter(record.kind for record in host)
        assert kinds["instant"] == len(cycles)
        assert kinds["image"] == 2
        what = f"{len(cycles):,} cycles of frames: each row, zygos_arm_t, estimate"
        agree(target, name, what, compare(host, records))
        if name == case.example or not (case.options or case.kinds):
            measured(target, build.name, sizes)
            estimate = flight.ffi.from_buffer("zygos_estimate_t *", host[-2].data)
            assert estimate.validity >= (2 if case.example == "paper" else 0)
        joints = flight.ffi.from_buffer("zygos_arm_t *", host[-1].data).sums.joints
        assert not case.motion or joints.segments > flight.lib.ZYGOS_JOINT_GROUPS_VALUE


@pytest.mark.parametrize(("target", "level"), [("m7", "-O3"), ("m4f", "-Os")])
def test_other_levels_of_optimisation(target: str, level: str, tmp_path: Path, agree: Agree) -> None:
    with capacities(*PAPER.defines):
        arm, _, cycles = CASES["paper"].of()
        config, sections = flight.config_of(arm), [frames_section(flight.encode(arm, cycles)), *END]
        host, records, _ = both(tmp_path, target, PAPER, config, sections, (level,))
        agree(target, f"paper, {level}", "the same", compare(host, records))


REARRANGED = (
    "-funsafe-math-optimizations",
    *(f"-U__{name}__" for name in ("ASSOCIATIVE_MATH", "RECIPROCAL_MATH", "NO_SIGNED_ZEROS")),
)


@pytest.mark.parametrize(
    ("target", "flags"),
    [("m7", ("-ffp-contract=fast",)), ("m4f", REARRANGED)],
    ids=["fused", "rearranged"],
)
def test_other_arithmetic_is_noticed(target: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    """Multiply and add in one operation, or sums in another order: the comparison must fail, and say where.
    One room of the library is enough. The header refuses the second kind by the compiler's macros: they are undefined
    here, as in a compiler that has none."""
    room = [path for path in ROOMS if path.stem == "balance"]
    with capacities(*PAPER.defines):
        arm, _, cycles = CASES["paper"].of()
        config, sections = flight.config_of(arm), [frames_section(flight.encode(arm, cycles)), *END]
        found = compare(*both(tmp_path, target, PAPER, config, sections, flags, rooms=room)[:2])
        print(f"{target} {' '.join(flags)}: {found}")
        assert 0 < found.equal < found.total
        assert "zygos_" in found.first


def damaged(arm: Arm, cycles: Cycles, count: int, seed: int) -> NDArray[Any]:
    """Frames of a run, of which every second is not as it should be."""
    rng = np.random.default_rng(seed)
    sound = flight.encode(arm, cycles)
    frames = sound[np.sort(rng.integers(0, len(sound), count))].copy()
    ours = np.unique(sound["id"])
    for k in np.flatnonzero(rng.random(count) < 0.5):
        frame = frames[k : k + 1]
        match rng.integers(0, 7):
            case 0:  # noise under one of our identifiers
                frame["data"] = rng.integers(0, 256, 8)
            case 1:  # somebody else's
                frame["id"], frame["data"] = rng.integers(0, 2**11), rng.integers(0, 256, 8)
            case 2:
                frame["data"][0, rng.integers(0, 8)] ^= np.uint8(1 << rng.integers(0, 8))
            case 3:
                frame["length"] = rng.integers(0, 256)
            case 4:
                frame["flags"] = rng.integers(0, 16)
            case 5:
                frame["id"] = rng.choice(ours)
            case 6:  # sound in itself and of this cycle, with any other field
                counter = frame["data"][0, 0 if frame["id"][0] == 0x080 else 1] & 15
                frames[k] = any_sound(rng, arm, int(rng.choice([counter, counter, rng.integers(0, 16)])))
    return frames


def any_sound(rng: np.random.Generator, arm: Arm, counter: int) -> Any:
    """A frame of ours with a valid CRC and fields at random, the outermost ones often."""
    ffi, lib = flight.ffi, flight.lib
    record = ffi.new("zygos_record_t *")
    record.counter, record.status = counter, rng.choice([15, 15, 15, 14, 13, 11, 7, rng.integers(0, 16)])
    record.sync, record.time_us = rng.integers(0, 256), rng.integers(0, 2**32)
    record.latch_us = rng.choice([0, 60, 300, 65535])
    for i in range(3):
        record.code[i] = rng.choice([-(2**23), 2**23 - 1, 0, rng.integers(-(2**23), 2**23)])
    message = int(rng.integers(1, 8))
    node = {2: arm.joints[0].node, 3: arm.joints[-1].node, 4: arm.imu.node, 5: arm.imu.node, 6: arm.imu.node}
    out = ffi.new("zygos_frame_t *")
    assert lib.zygos_wire_encode(record, message, node.get(message, 32), out) == 1
    return np.frombuffer(ffi.buffer(out), dtype=flight.FRAME)[0]


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("example", ["paper", "seven"])
def test_damaged_and_foreign_frames(example: str, target: str, tmp_path: Path, agree: Agree) -> None:
    """The same verdict on each, the same fault counters, the same bits of what got through."""
    build = BUILDS[example]
    with capacities(*build.defines):
        arm, cycles = recorded(example)
        # long stretches of sound frames, so that some arcs get far enough for rows
        sound = flight.encode(arm, cycles)
        frames = np.concatenate([sound[2:9], damaged(arm, cycles, FUZZ_FRAMES, 1), sound])
        sections = [frames_section(frames), *END]
        host, records, _ = both(tmp_path, target, build, flight.config_of(arm), sections)
        agree(target, f"{example}, half of the frames damaged", f"{len(frames):,} verdicts, …", compare(host, records))
        found = flight.ffi.from_buffer("zygos_arm_t *", host[-1].data).receiver.faults
        missed = {name for name, _ in flight.ffi.typeof(found).fields if getattr(found, name) == 0}
        assert missed <= {"overrun", "time_lost"}, "faults that the frames did not provoke"


def special(cycles: Cycles, seed: int) -> Cycles:
    """Cycles whose values are often none, or at a border."""
    rng = np.random.default_rng(seed)
    values = [np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e-310, 1e4, -1e4, 1e6, -1e6]
    values += [np.nextafter(1e4, 2e4), np.nextafter(1e6, 2e6), 1.7e308, np.pi, 1e-160, 1e-200]
    columns = {}
    for name in ("q", "theta", "tau", "omega"):
        x = getattr(cycles, name).copy()
        # most cycles have none of them, so that they are used; in the second half many are tiny
        share = rng.choice([0.0, 0.02, 0.5], size=(len(x), 1), p=[0.7, 0.2, 0.1])
        x[len(x) // 2 :] *= rng.choice([1.0, 1e-308, 1e-315, 0.0, -0.0], (len(x) - len(x) // 2, 1))
        at = rng.random(x.shape) < share
        x[at] = rng.choice(values, at.sum())
        columns[name] = x
    return replace(cycles, **columns)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["paper, four effects", "three in space"])
def test_special_doubles(name: str, target: str, tmp_path: Path, agree: Agree) -> None:
    """NaN, infinities, zeros of both signs, denormals and borders through the cycle door."""
    build = BUILDS[CASES[name].example]
    with capacities(*build.defines):
        arm, effects, cycles = CASES[name].of()
        tiny = special(cycles, 2)
        sections = [cycles_section(flight.cycles_to_native(tiny), len(tiny)), *END]
        host, records, _ = both(tmp_path, target, build, flight.config_of(arm, effects), sections)
        verdicts = Counter(struct.unpack("<b", record.data)[0] for record in host if record.kind == "verdicts")
        assert verdicts[0] > 50
        assert verdicts[1] > 250
        agree(target, f"{name}, special doubles", f"{len(tiny):,} cycles", compare(host, records))


def test_denormals_that_are_flushed_are_noticed(tmp_path: Path) -> None:
    with capacities(*PAPER.defines):
        arm, _, cycles = CASES["paper"].of()
        tiny = special(cycles, 2)
        sections = [cycles_section(flight.cycles_to_native(tiny), len(tiny)), *END]
        config = flight.config_of(arm)
        found = compare(*both(tmp_path, "m7", PAPER, config, sections, drills=("drill_flush",))[:2])
        assert "zygos_" in found.first


def refused(change: Callable[[Any], None]) -> Any:
    """The paper's configuration, changed for the worse."""
    config = flight.config_of(recorded("paper")[0])
    change(config)
    return config


@pytest.mark.parametrize("target", TARGETS)
def test_a_configuration_is_refused_for_the_same_reason(target: str, tmp_path: Path) -> None:
    changes: list[tuple[str, Any]] = [
        ("joints", 3),
        ("period_s", 0.1),
        ("smoother_lag", 1),
        ("forgetting_factor", float("nan")),
    ]
    with capacities(*PAPER.defines):
        for field, value in changes:
            config = refused(lambda c, f=field, v=value: setattr(c, f, v))
            host, records, _ = both(tmp_path, target, PAPER, config, END)
            assert len(host) == 1
            assert struct.unpack("<i", host[0].data)[0] < 0
            assert records == host


def test_the_place_of_a_byte() -> None:
    with capacities(*PAPER.defines):
        kind = flight.ffi.typeof("zygos_arm_t")
        offset = flight.ffi.offsetof("zygos_arm_t", "sums", "energy", "block", 3, "gram", 5)
        assert place(kind, offset + 7) == ".sums.energy.block[3].gram[5]"
        assert place(kind, 0) == ".magic"
