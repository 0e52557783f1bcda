# SPDX-License-Identifier: MIT
"""Instructions of each cycle, stage by stage: what a tool counted, and where the driver says that the cycle stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conftest import ROOT
from zygos.errors import ZygosError

ROOMS = (
    "wire",
    "cycle",
    "smoother",
    "kinematics",
    "balance",
    "impulse",
    "momentum",
    "joint",
    "noise",
    "accumulator",
    "tables",
    "handover",
    "solver",
)
"""In the order in which a sample walks through them, then what verifies tables and copies sums beside that. What one
costs is counted from a file of TOPS calling a function of its file until that returns; of `cycle`, which calls it,
`wire` is taken off. Rooms and TOPS themselves add up to all."""
TOPS = ("zygos", "arm")
"""The files that call those of rooms: the loop, and the cycle of an arm."""
WHOLE = ("frame", "step", "solve")
"""Receiving all frames of a cycle in the interrupt; the task, which decodes and processes them; one solution."""
STAGES = (*ROOMS, *WHOLE)
ENTRIES = {"frame": "zygos_frame", "step": "zygos_step", "solve": "zygos_work_solve"}
"""The function of each of WHOLE."""
MARKS = 2
"""Parts of a cycle, each of which the driver ends by a mark: the cycle, and what the background does behind it."""
TOGETHER = "frame + step"
"""A full cycle: its frames in, its row accumulated, and its part of everything else."""
FOLDED = {
    "motorsums": "impulse", "momentumsums": "momentum", "jointsums": "joint", "reduction": "balance",
    "change": "solver",
}  # fmt: skip
"""Files that are part of another room."""
KINDS = ("fills", "block", "arc", "cycle", "waits", "hands")
"""Of cycles, as bench/driver.c numbers them."""
SIZES = (
    "parameters", "cycle", "smoother", "kinematics", "balance", "impulse", "momentum", "joint", "noise", "accumulator",
    "tables", "handover", "whole", "solver",
)  # fmt: skip
PLACES = (
    "frames", "turn", "joint_turn", "momentum_turn", "filled", "torque_at", "position", "first",
    "row_turn", "row_step", "row_signal", "row_moved", "row_waits", "energy_task", "motor_task", "momentum_task",
    "stage", "patrol", "copy",
)  # fmt: skip
"""Where a cycle stands, as bench/driver.c has it."""
RELEVANT: dict[str, tuple[str, ...]] = {
    "wire": ("frames",), "cycle": ("frames",), "smoother": ("position",), "kinematics": (), "balance": ("torque_at",),
    "impulse": ("joint_turn", "torque_at", "motor_task", "row_turn"),
    "momentum": ("momentum_turn", "momentum_task", "row_turn"),
    "joint": ("row_turn", "row_step", "row_signal", "row_moved", "row_waits"), "noise": ("turn", "torque_at"),
    "accumulator": ("filled", "first", "energy_task"), "tables": ("patrol",),
    "handover": ("copy",), "frame": ("frames",),
}  # fmt: skip
"""On which of them the cost of a stage may depend."""
REST = ("frames", "row_turn", "energy_task", "motor_task", "momentum_task", "stage", "patrol", "copy")
"""On which of them the rest of a step may depend, which is TOPS themselves."""
DRIVER = ROOT / "tests" / "bench" / "driver.c"


@dataclass(frozen=True)
class Tally:
    """What a tool counted between two marks of the driver, for n cycles."""

    stages: NDArray[np.int64]
    """(n, len(STAGES))"""
    functions: dict[str, NDArray[np.int64]]
    """(n,) of each function that ran: its own instructions, without those of what it calls."""
    solve: int
    """Of the solution at the end."""


@dataclass(frozen=True)
class Count:
    """A tally, with what the driver says of each cycle."""

    tally: Tally
    sizes: dict[str, int]
    """Parameters, and bytes of state."""
    kinds: NDArray[np.int64]
    """(n,) index into KINDS."""
    places: NDArray[np.int64]
    """(n, len(PLACES)) all on which the cost of a cycle may depend beside its data."""
    rank: int
    """Of the solution."""
    validity: int
    """Of the solution, `enum zygos_validity`."""

    def stage(self, name: str) -> NDArray[np.int64]:
        """(n,) instructions of a stage in each cycle."""
        parts = name.split(" + ")
        return np.asarray(self.tally.stages[:, [STAGES.index(part) for part in parts]].sum(axis=1), dtype=np.int64)

    def waits(self) -> NDArray[np.bool_]:
        """(n,) cycles in which an arc that has ended waits until the one before it is closed."""
        return np.asarray(self.kinds == KINDS.index("waits"), dtype=np.bool_)

    def ordinary(self) -> NDArray[np.bool_]:
        """(n,) cycles that form a row, and neither open a block, begin or end an arc, nor copy sums for a solution."""
        return np.asarray(self.kinds == KINDS.index("cycle"), dtype=np.bool_)

    def hands(self) -> NDArray[np.bool_]:
        """(n,) cycles in which a part of the sums is copied for a solution, or its estimate is adopted."""
        return np.asarray(self.kinds == KINDS.index("hands"), dtype=np.bool_)


def read_places(path: Path) -> tuple[dict[str, int], NDArray[np.int64], int, int]:
    """What bench/driver.c wrote: sizes, (n, 19) a kind and a place for each cycle, and rank and validity."""
    words = np.fromfile(path, dtype="<u4").astype(np.int64)
    body, rank, validity = words[len(SIZES) : -2].reshape(-1, 1 + len(PLACES)), int(words[-2]), int(words[-1])
    return dict(zip(SIZES, words[: len(SIZES)].tolist(), strict=True)), body, rank, validity


def joined(tally: Tally, folder: Path, tool: str) -> Count:
    """A tally and the driver's places. Errors: ZygosError when they are not of as many cycles."""
    sizes, places, rank, validity = read_places(folder / "places.bin")
    if len(places) != len(tally.stages):
        raise ZygosError(f"{tool} told {len(tally.stages)} cycles of {len(places)}; remedy: another version of {tool}")
    return Count(tally, sizes, places[:, 0], places[:, 1:], rank, validity)


def _spread(counted: NDArray[np.int64], places: NDArray[np.int64]) -> int:
    """Most by which entries of counted (n,) differ whose places (n, k) are equal."""
    _, group = np.unique(places, axis=0, return_inverse=True)
    most = np.full(group.max() + 1, np.iinfo(np.int64).min)
    least = np.full(group.max() + 1, np.iinfo(np.int64).max)
    np.maximum.at(most, group, counted)
    np.minimum.at(least, group, counted)
    return int((most - least).max())


def spread_by_data(count: Count, stage: str) -> int:
    """Most instructions by which ordinary cycles differ that stand at the same place.

    That of `step` is the sum over its rooms and what is left of it, which is not less than its own.
    """
    if stage == TOGETHER:
        return spread_by_data(count, "frame") + spread_by_data(count, "step")
    chosen = count.ordinary()
    if stage == "step":
        rooms = [room for room in ROOMS if room not in ("wire", "cycle", "solver")]
        rest = count.stage("step") - count.stage(" + ".join(rooms))
        return sum(spread_by_data(count, room) for room in rooms) + _spread(rest[chosen], _at(count, REST))
    return _spread(count.stage(stage)[chosen], _at(count, RELEVANT[stage]))


def _at(count: Count, relevant: Sequence[str]) -> NDArray[np.int64]:
    """(n, 1 + k) places of the ordinary cycles."""
    places = count.places[count.ordinary()][:, [PLACES.index(one) for one in relevant]]
    return np.column_stack([np.zeros(len(places), np.int64), places])
