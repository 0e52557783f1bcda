# SPDX-License-Identifier: MIT
"""What is measured: arms, what is switched on at them, and the inputs that they are fed."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from cffi import FFI
from laboratory_support import laboratory_arm

from conftest import ROOT, tool_module
from zygos.arm import JOINT_ROW_S, Arm, Smoother, load_arm
from zygos.effects import CATALOGUE, Effect
from zygos.native import flight
from zygos.runs.cycles import Cycles

SEGMENT = 250
"""Cycles that are of one kind: at rest, at random, smooth."""
LOST = (600, 660)
"""Cycles before which one is lost, so that the second arc ends while the first is closing."""


@dataclass(frozen=True)
class Configuration:
    """An arm, what is switched on at it, and the capacities of the build that holds it."""

    example: str
    """Folder in examples/; empty for an arm that has none."""
    arm: Arm
    capacities: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    energy: bool = True
    """Whether there are energy rows; on a fixed base with rigid joints they can be left out."""


def _bare(arm: Arm) -> Arm:
    return replace(arm, compensate_every=0, impulse_arc_s=0.0, momentum_max_s=0.0)


def _short(arm: Arm) -> Arm:
    return replace(arm, arc_max_s=300 * arm.period_s)


def _example(name: str, capacities: str, *changes: Callable[[Arm], Arm]) -> Configuration:
    arm = load_arm(ROOT / "examples" / name / "arm.toml")
    for change in changes:
        arm = change(arm)
    return Configuration(name, arm, tuple(f"-DZYGOS_{one}" for one in capacities.split()))


def _joint_rows(arm: Arm) -> Arm:
    return replace(arm, joint_increment_s=JOINT_ROW_S)


def _ground(energy: bool) -> Configuration:
    """A UR10e's geometry at 250 Hz: rigid joints, known lengths, and an offset and friction of each motor."""
    arm, model = laboratory_arm("UR10e", period_s=GROUND_PERIOD_S)
    offsets = tuple(Effect(CATALOGUE["torque_offset"], joint.name, 0.0) for joint in arm.joints)
    capacities = tuple(f"-DZYGOS_{one}" for one in _GROUND.split())
    return Configuration("", replace(arm, smoother=Smoother(21, 4, 10)), capacities, (*model.effects, *offsets), energy)


GROUND_PERIOD_S = 0.004
BARE, JOINT_ROWS = ", bare", ", joint rows"
_GROUND = "MAX_JOINTS=6 MAX_PARAMETERS=58 MAX_BLOCKS=12 MOMENTUM=0"
_PAPER, _SPATIAL, _SEVEN = (
    "MAX_JOINTS=2 SPATIAL=0 MOMENTUM=0",
    "MAX_JOINTS=3",
    "MAX_JOINTS=7 MAX_BLOCKS=12 MAX_MOTOR_BLOCKS=8 MAX_MOMENTUM_BLOCKS=8",
)

CONFIGURATIONS: dict[str, Callable[[], Configuration]] = {
    "paper, bare": lambda: _example("paper", _PAPER, _bare),
    "paper": lambda: _example("paper", _PAPER),
    "spatial, bare": lambda: _example("spatial", _SPATIAL, _short, _bare),
    "spatial": lambda: _example("spatial", _SPATIAL, _short),
    "seven, bare": lambda: _example("seven", _SEVEN, _short, _bare),
    "seven": lambda: _example("seven", _SEVEN, _short),
    "ground, joint rows": lambda: _ground(False),
    "ground": lambda: _ground(True),
    "spatial, joint rows": lambda: _example("spatial", _SPATIAL, _short, _joint_rows),
}
"""By name. BARE: the energy rows alone, neither compensated nor with rows of motors or momentum. The arms in space have
arcs of 300 cycles, so that some end. JOINT_ROWS: on the ground joint rows alone, in space beside all others."""


def with_effects(key: str) -> Configuration:
    """The paper's arm with an effect at each joint."""
    one = CONFIGURATIONS["paper"]()
    return replace(one, effects=tuple(Effect(CATALOGUE[key], joint.name, 0.0) for joint in one.arm.joints))


def random_cycles(arm: Arm, count: int) -> Cycles:
    """Cycles that are valid, in turns: at rest, at random (which the bandwidth test refuses), smooth with noise.

    LOST cycles are missing.
    """
    rng = np.random.default_rng(0)
    kind = np.arange(count) // SEGMENT % 3
    time = np.arange(count) * arm.period_s
    signal = np.zeros((count, 3 * arm.n + 3))
    for column in signal.T:
        rates, phases, amplitudes = rng.uniform(0.1, 2.0, 3), rng.uniform(0.0, 6.0, 3), rng.normal(size=3)
        smooth = (amplitudes[:, None] * np.sin(np.outer(rates, time) + phases[:, None])).sum(axis=0)
        column[:] = np.where(kind == 1, rng.normal(size=count), np.where(kind == 2, smooth, 0.0))
    q, theta, tau, omega = np.split(signal, [arm.n, 2 * arm.n, 3 * arm.n], axis=1)
    sync = 50 + np.arange(count, dtype=np.uint64)  # the first cycle has an FTIME, which nothing is compared with
    for lost in LOST:
        sync[lost:] += 1
    return Cycles(sync, q, q + 1e-3 * theta, tau, 0.1 * omega, np.zeros(count, dtype=np.uint32))


@contextmanager
def build_of(capacities: tuple[str, ...]) -> Iterator[Any]:
    """`zygos.native.flight` with the declarations of another build; nothing of it can be run."""
    ffi = FFI()
    ffi.cdef(tool_module("build_native").declarations(*capacities))
    with patch.multiple(flight, ffi=ffi, lib=ffi.dlopen(str(flight._FOLDER / "libzygos.so"))):
        yield ffi


def write_run(one: Configuration, cycles: Cycles, path: Path) -> None:
    """Write what bench/driver.c reads: a configuration and the frames of the cycles."""
    frames = flight.encode(one.arm, cycles)
    with build_of(one.capacities) as ffi:
        native = flight.config_of(one.arm, one.effects)
        native.arc_cycles *= int(one.energy)
        config = bytes(ffi.buffer(native))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("=3I", len(config), flight.FRAME.itemsize, len(frames)) + config + frames.tobytes())
