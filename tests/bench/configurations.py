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

from conftest import ROOT, tool_module
from zygos import flight
from zygos.arm import Arm, load_arm
from zygos.cycles import Cycles
from zygos.effects import CATALOGUE, Effect
from zygos.model import load_model
from zygos.plant import simulate
from zygos.scenario import load_scenario

SEGMENT = 250
"""Cycles that are of one kind: at rest, at random, smooth."""


@dataclass(frozen=True)
class Configuration:
    """An arm, what is switched on at it, and the capacities of the build that holds it."""

    example: str
    arm: Arm
    capacities: tuple[str, ...]
    effects: tuple[Effect, ...] = ()


def _bare(arm: Arm) -> Arm:
    return replace(arm, compensate_every=0, impulse_arc_s=0.0, momentum_max_s=0.0)


def _example(name: str, *capacities: str, change: Callable[[Arm], Arm] = lambda arm: arm) -> Configuration:
    arm = change(load_arm(ROOT / "examples" / name / "arm.toml"))
    return Configuration(name, arm, tuple(f"-DZYGOS_{one}" for one in capacities))


_PAPER = ("MAX_JOINTS=2", "SPATIAL=0", "MOMENTUM=0")

CONFIGURATIONS: dict[str, Callable[[], Configuration]] = {
    "paper, bare": lambda: _example("paper", *_PAPER, change=_bare),
    "paper": lambda: _example("paper", *_PAPER),
    "spatial, bare": lambda: _example("spatial", "MAX_JOINTS=3", change=_bare),
    "spatial": lambda: _example("spatial", "MAX_JOINTS=3"),
    "seven, bare": lambda: _example("seven", "MAX_JOINTS=7", "MAX_BLOCKS=8", change=_bare),
    "seven": lambda: _example("seven", "MAX_JOINTS=7", "MAX_BLOCKS=8"),
}
"""By name. "bare": the energy rows alone, neither compensated nor with rows of motors or momentum."""


def random_cycles(arm: Arm, count: int) -> Cycles:
    """Cycles that are valid, in turns: at rest, at random (which the bandwidth test refuses), smooth with noise."""
    rng = np.random.default_rng(0)
    kind = np.arange(count) // SEGMENT % 3
    time = np.arange(count) * arm.period_s
    signal = np.zeros((count, 3 * arm.n + 3))
    for column in signal.T:
        rates, phases, amplitudes = rng.uniform(0.1, 2.0, 3), rng.uniform(0.0, 6.0, 3), rng.normal(size=3)
        smooth = (amplitudes[:, None] * np.sin(np.outer(rates, time) + phases[:, None])).sum(axis=0)
        column[:] = np.where(kind == 1, rng.normal(size=count), np.where(kind == 2, smooth, 0.0))
    q, theta, tau, omega = np.split(signal, [arm.n, 2 * arm.n, 3 * arm.n], axis=1)
    sync = np.arange(1, count + 1, dtype=np.uint64)
    return Cycles(sync, q, q + 1e-3 * theta, tau, 0.1 * omega, np.zeros(count, dtype=np.uint32))


def motion(one: Configuration, duration_s: float) -> Cycles:
    """The example's own motion, from which its parameters can be told."""
    folder = ROOT / "examples" / one.example
    model, scenario = load_model(folder / "model.toml"), load_scenario(folder / "scenario.toml")
    engine = "pinocchio" if one.arm.spatial else "zygos"
    return simulate(one.arm, model, scenario, engine=engine, noise=True, duration_s=duration_s).cycles()


@contextmanager
def build_of(capacities: tuple[str, ...]) -> Iterator[Any]:
    """`zygos.flight` with the declarations of another build; nothing of it can be run."""
    ffi = FFI()
    ffi.cdef(tool_module("build_native").declarations(*capacities))
    with patch.multiple(flight, ffi=ffi, lib=ffi.dlopen(str(flight._FOLDER / "libzygos.so"))):
        yield ffi


def write_run(one: Configuration, cycles: Cycles, path: Path) -> None:
    """Write what bench/driver.c reads: a configuration and the frames of the cycles."""
    frames = flight.encode(one.arm, cycles)
    with build_of(one.capacities) as ffi:
        config = bytes(ffi.buffer(flight.config_of(one.arm, one.effects)))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("=3I", len(config), flight.FRAME.itemsize, len(frames)) + config + frames.tobytes())
