# SPDX-License-Identifier: MIT
"""A run as a recording: its readings, with which `zygos convert` needs no map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.runs.cycles import INVALID, Cycles
from zygos.runs.wraps import wraps_of
from zygos.telemetry.map import UNITS, Channel, Clock, Field, Map, Quantity, Recording, SourceSamples

_KINDS: dict[Field, tuple[str, Quantity]] = {
    "q": ("link", "angle"),
    "theta": ("motor", "angle"),
    "tau": ("torque", "torque"),
    "omega": ("gyro", "rate"),
}


def run_map(run: Run) -> Map:
    """The map of a run, in which each angle that starts again has its modulo."""
    clock = Clock("sync", "sync", "counts", run.arm.period_s, where=str(run.path))
    return Map(clock, tuple(_channel(run, field, i) for field, i in _readings(run.arm)))


def run_recording(run: Run, mapping: Map) -> Recording:
    """The valid cycles of a run as a recording with a counter. Errors: ZygosError for a run without a valid cycle."""
    cycles = run.cycles
    valid = np.flatnonzero((cycles.flags & INVALID) == 0)
    if not len(valid):
        raise ZygosError(
            f"{run.path}: has no cycle of arm {run.arm.name}; remedy: give the map of a recording of another system "
            "(--map)"
        )
    nowhere = np.full(len(valid), np.nan)
    sources = {
        channel.source: SourceSamples(
            getattr(cycles, channel.field)[valid, channel.index], np.arange(len(valid)), nowhere
        )
        for channel in mapping.channels
    }
    numbers = cycles.sync[valid].astype(np.float64)
    return Recording(sources, numbers - numbers[0], nowhere, None, missing=run.damage, remarks=run.remarks)


def _readings(arm: Arm) -> list[tuple[Field, int]]:
    """Field and column of each reading of an arm."""
    found: list[tuple[Field, int]] = []
    for i, joint in enumerate(arm.joints):
        fields: tuple[Field, ...] = ("q", "theta", "tau") if joint.flexible else ("theta", "tau")
        found += [(field, i) for field in fields]
    return found + ([("omega", i) for i in range(3)] if arm.free else [])


def _channel(run: Run, field: Field, i: int) -> Channel:
    arm, (key, quantity) = run.arm, _KINDS[field]
    label = f"gyro.{'xyz'[i]}" if field == "omega" else f"{arm.joints[i].name}.{key}"
    angle = field in ("q", "theta")
    wraps = wraps_of(arm, run.cycles, field, i) if angle else None
    unit = arm.torque_unit if field == "tau" else next(iter(UNITS[quantity]))
    return Channel(
        label,
        field,
        i,
        quantity,
        f"{field}{i + 1}",
        unit,
        1.0,
        0.0,
        bare=True,
        where=str(run.path),
        turn=2.0 * math.pi if angle else math.inf,
        modulo=wraps.turn if wraps else None,
    )


def with_breaks(cycles: Cycles, run: Run) -> Cycles:
    """The converted cycles, with the breaks that the run says."""
    valid = (run.cycles.flags & INVALID) == 0
    number = run.cycles.sync[valid] - run.cycles.sync[valid][0]
    _, here, there = np.intersect1d(cycles.sync, number, assume_unique=True, return_indices=True)
    flags = cycles.flags.copy()
    flags[here] |= run.cycles.flags[valid][there]
    return replace(cycles, flags=flags)
