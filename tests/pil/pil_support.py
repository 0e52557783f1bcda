# SPDX-License-Identifier: MIT
"""What the tests on an emulated Cortex-M share: firmware and the host's library at the same capacities, runs of both on
the same vectors, and a comparison that names the first byte that differs."""

from __future__ import annotations

import functools
import importlib.util
import re
import struct
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from build_support import ROOMS, kept, objects
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import ROOT, need
from zygos.arm import Arm, load_arm
from zygos.model.model import load_model
from zygos.native import flight
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

sys.path.insert(0, str(ROOT / "tools"))
import build_firmware

HERE = Path(__file__).parent
PORT = build_firmware.PORT
TARGETS = tuple(build_firmware.TARGETS)
LIMIT_S = 240.0
"""Longest that a run on a target may take."""

FRAMES, CYCLES, IMAGE, ESTIMATE = 1, 2, 3, 4
"""Sections of run.bin, as c/ports/cortex-m/bulk.c has them."""
RECORDS = {1: "init", 2: "verdicts", 3: "instant", 4: "image", 5: "estimate", 6: "sizes"}
"""Records of out.bin."""


@dataclass(frozen=True)
class Build:
    """Capacities that host and target are built with."""

    name: str
    defines: tuple[str, ...]


PAPER = Build("two joints", ("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0", "-DZYGOS_CYCLE_QUEUE=1024"))
"""With a long queue, so that nothing is lost however fast the frames come."""
HASTY = Build("two joints, short queue", PAPER.defines[:2])
SPATIAL = Build("three joints in space", ("-DZYGOS_MAX_JOINTS=3", "-DZYGOS_MAX_BLOCKS=12"))
FEW_BLOCKS = ("-DZYGOS_MAX_BLOCKS=12", "-DZYGOS_MAX_MOTOR_BLOCKS=8", "-DZYGOS_MAX_MOMENTUM_BLOCKS=8")
SEVEN = Build("seven joints in space", ("-DZYGOS_MAX_JOINTS=7", *FEW_BLOCKS))
"""The emulated boards have 16 MB."""
BUILDS = {"paper": PAPER, "spatial": SPATIAL, "seven": SEVEN}
DURATION_S = {"paper": 60.0, "spatial": 1.2, "seven": 1.6}
"""1,200 cycles, 600 and 400."""


@functools.cache
def recorded(example: str, period_s: float | None = None, duration_s: float | None = None) -> tuple[Arm, Cycles]:
    """The motion of an example, with noise; bits need no accurate plant. By default with the period of the example and
    as long as DURATION_S says."""
    folder = ROOT / "examples" / example
    arm, scenario = load_arm(folder / "arm.toml"), load_scenario(folder / "scenario.toml")
    model = load_model(folder / "model.toml")
    arm = arm if period_s is None else arm.at_period(period_s)
    seconds = DURATION_S[example] if duration_s is None else duration_s
    run = trajectory_of(arm, model, scenario, noise=True, duration_s=seconds, rtol=1e-6, atol=1e-8)
    return arm, run.cycles()


@dataclass(frozen=True)
class Section:
    """A part of run.bin."""

    kind: int
    items: int
    payload: bytes = b""


def frames_section(frames: NDArray[Any]) -> Section:
    """`FRAME` records through zygos_arm_frame() and zygos_arm_step()."""
    return Section(FRAMES, len(frames), np.ascontiguousarray(frames, dtype=flight.FRAME).tobytes())


def cycles_section(native: Any, count: int) -> Section:
    """A `zygos_cycle_t` array of the build in use through zygos_arm_cycle()."""
    return Section(CYCLES, count, bytes(flight.ffi.buffer(native))[: count * flight.ffi.sizeof("zygos_cycle_t")])


END = (Section(IMAGE, 0), Section(ESTIMATE, 0), Section(IMAGE, 0))
"""The whole zygos_arm_t, the estimate, and once more the zygos_arm_t, which that must not change."""


@dataclass(frozen=True)
class Record:
    """A part of out.bin."""

    kind: str
    data: bytes


def on_host(config: Any, sections: Sequence[Section], in_place: bool = False) -> list[Record]:
    """What bulk.c does, by the library in use. in_place: the estimate is solved without a copy of the sums."""
    ffi, lib = flight.ffi, flight.lib
    arm = ffi.new("zygos_arm_t *")
    solver = ffi.new("zygos_solver_t *")
    work, estimate = ffi.new("zygos_work_t *"), ffi.new("zygos_estimate_t *")
    records: list[Record] = []

    def add(kind: str, data: Any) -> None:
        records.append(Record(kind, bytes(data)))

    def instant() -> None:
        head = struct.pack("<QII", arm.sums.cycle, arm.instant, int(arm.accepted > 0.0))
        add("instant", head + b"".join(bytes(ffi.buffer(x)) for x in parts))

    parts = [ffi.addressof(arm, name) for name in ("arm_state", "motion", "row")]
    verdict = lib.zygos_arm_init(arm, config)
    add("init", struct.pack("<i", verdict))
    for section in sections if verdict == 1 else ():
        if section.kind in (FRAMES, CYCLES):
            kind = "zygos_frame_t" if section.kind == FRAMES else "zygos_cycle_t"
            vectors = ffi.from_buffer(f"{kind}[]", section.payload)
            for k in range(section.items):
                said = (lib.zygos_arm_frame if section.kind == FRAMES else lib.zygos_arm_cycle)(arm, vectors + k)
                add("verdicts", struct.pack("<b", said))
                if section.kind == CYCLES and said == 1:
                    instant()
                while section.kind == FRAMES and lib.zygos_arm_step(arm) == 1:
                    instant()
        elif section.kind == IMAGE:
            add("image", ffi.buffer(arm))
        elif section.kind == ESTIMATE:
            if in_place:
                lib.zygos_arm_solve(arm, solver, estimate)
            else:
                lib.zygos_arm_take(arm, work)
                lib.zygos_work_solve(work, estimate)
            add("estimate", ffi.buffer(estimate))
    return records


def firmware(
    target: str,
    program: str,
    build: Build,
    flags: tuple[str, ...] = (),
    drills: tuple[str, ...] = (),
    board: str = "",
    arithmetic: tuple[str, ...] = (),
    rooms: Sequence[Path] = ROOMS,
) -> Path:
    """Firmware whose main() is in PROGRAM.c, here or in c/ports/cortex-m, built once.

    drills: sources in this folder whose __wrap_ functions stand before those of the firmware. board: another linker
    script than that of the machine. flags: of the program and the linker; arithmetic: of these rooms of the library.
    """
    own = HERE / f"{program}.c"
    sources = [own if own.exists() else PORT / own.name, *(HERE / f"{drill}.c" for drill in drills)]
    names = {name for source in sources[1:] for name in re.findall(r"__wrap_(\w+)\(", source.read_text())}
    wrapped = [f"-Wl,--wrap={name}" for name in sorted(names)]
    compiler = [*build_firmware.compiler(target), "-ffunction-sections", "-fdata-sections", *build.defines]
    usual = [room for room in build_firmware.ROOMS if not arithmetic or room not in rooms]
    library = objects(compiler, usual) if usual else []
    library += objects([*compiler, *arithmetic], rooms) if arithmetic else []
    included = [Path(flag) / "arm_config.h" for flag in flags if Path(flag).is_dir()]

    def link(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(build_firmware, "ROOMS", library)
            build_firmware.build(target, folder / "image.elf", sources, [*build.defines, *flags, *wrapped], board)

    options = [*map(str, library), *(flag for flag in flags if not Path(flag).is_dir()), *wrapped]
    return kept(link, "firmware", target, program, board, *options, sources=[*sources, *included]) / "image.elf"


@dataclass(frozen=True)
class Sizes:
    """Memory on a target."""

    state: int
    """Bytes of zygos_arm_t,"""
    work: int
    """zygos_work_t,"""
    estimate: int
    """zygos_estimate_t,"""
    stack: int
    """and of stack in use at the most."""
    code: int
    """Bytes of instructions and constants of the image."""


def on_target(
    target: str, elf: Path, folder: Path, config: Any, sections: Sequence[Section]
) -> tuple[list[Record], Sizes]:
    """What bulk firmware comes to on these vectors, run in folder."""
    folder.mkdir(parents=True, exist_ok=True)
    head = struct.pack("<I", config.abi) + bytes(flight.ffi.buffer(config))
    body = b"".join(struct.pack("<II", s.kind, s.items) + s.payload for s in sections)
    (folder / "run.bin").write_bytes(head + body)
    subprocess.run(build_firmware.run(target, elf), cwd=folder, check=True, timeout=LIMIT_S)
    out, at, records = (folder / "out.bin").read_bytes(), 0, []
    while at < len(out):
        kind, size = struct.unpack_from("<II", out, at)
        records.append(Record(RECORDS[kind], out[at + 8 : at + 8 + size]))
        at += 8 + size
    assert records[-1].kind == "sizes", "the run ended early"
    return records[:-1], Sizes(*struct.unpack("<4I", records[-1].data), code_bytes(elf))


def code_bytes(elf: Path) -> int:
    """Instructions, constants and initial values of an image."""
    done = subprocess.run(["arm-none-eabi-size", str(elf)], capture_output=True, text=True, check=True)
    text, data = done.stdout.splitlines()[1].split()[:2]
    return int(text) + int(data)


def place(kind: Any, offset: int) -> str:
    """The member of a struct that lies at a byte, or "padding"."""
    if kind.kind == "struct":
        for name, field in kind.fields:
            if field.offset <= offset < field.offset + flight.ffi.sizeof(field.type):
                inner = place(field.type, offset - field.offset)
                return f".{name}{inner}"
        return ".padding"
    if kind.kind == "array":
        size = flight.ffi.sizeof(kind.item)
        return f"[{offset // size}]{place(kind.item, offset % size)}"
    return ""


def where(record: Record, offset: int) -> str:
    """The member of a record's struct at a byte."""
    if record.kind == "image":
        return "zygos_arm_t" + place(flight.ffi.typeof("zygos_arm_t"), offset)
    if record.kind == "estimate":
        return "zygos_estimate_t" + place(flight.ffi.typeof("zygos_estimate_t"), offset)
    if record.kind == "instant":
        offset -= 16
        for name in ("arm_state", "motion", "row"):
            kind = flight.ffi.typeof(f"zygos_{name}_t")
            if 0 <= offset < flight.ffi.sizeof(kind):
                return f"zygos_{name}_t" + place(kind, offset)
            offset -= flight.ffi.sizeof(kind)
    return f"byte {offset}"


@dataclass(frozen=True)
class Comparison:
    """Two lists of records, byte by byte."""

    equal: int
    """Bytes that are equal."""
    total: int
    first: str
    """Where the first difference is, in words; empty when there is none."""


def compare(host: Sequence[Record], target: Sequence[Record]) -> Comparison:
    """Compare what host and target came to."""
    equal = total = 0
    first = ""
    for k, (one, other) in enumerate(zip(host, target, strict=False)):
        if one.kind != other.kind or len(one.data) != len(other.data):
            first = first or f"record {k}: {one.kind} of {len(one.data)} bytes, {other.kind} of {len(other.data)}"
            break
        total += len(one.data)
        if one.data == other.data:
            equal += len(one.data)
            continue
        different = np.flatnonzero(np.frombuffer(one.data, np.uint8) != np.frombuffer(other.data, np.uint8))
        equal += len(one.data) - len(different)
        first = first or f"record {k}: {one.kind}, {where(one, int(different[0]))}"
    if len(host) != len(target):
        first = first or f"{len(host)} records and {len(target)}"
    return Comparison(equal, total, first)


def need_tools() -> None:
    """What a build and a run need."""
    lost = build_firmware.missing()
    need(not lost, f"{' '.join(lost)}: nothing runs on a target; remedy: sudo apt install {build_firmware.PACKAGES}")
    need(importlib.util.find_spec("serial"), "pyserial: nobody speaks slcan; remedy: pip install 'zygos[serial]'")
