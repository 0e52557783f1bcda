# SPDX-License-Identifier: MIT
"""Runs of an arm that a file of a simulator describes, as plain tables: time, angles and torques at the joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run, make_run
from zygos.errors import ZygosError
from zygos.files.tables import is_table, read_columns
from zygos.ground.motion import LEAST_NOISE
from zygos.simulators.file import read_robot
from zygos.simulators.robot import Robot

Floats = NDArray[np.float64]

_TIMES = ("t", "time")
_EVEN = 0.02
"""Largest deviation of a time step from their median, as share of it."""
_NEEDS = "t (s), q1 .. qN (rad) and tau1 .. tauN (Nm, at the joints)"


def read_plain(paths: Sequence[Path], simulation: Path) -> tuple[Robot, Arm, list[Run]]:
    """The robot of a file, its arm, and runs of it that have no arm file: tables with a time column, whose angles count
    as those of the file and whose torques act at the joints.

    Period and noise are those of the first table. Errors: ZygosError for a log, for columns that are missing, and for
    instants that are not evenly spaced; as `read_robot`.
    """
    tables = [_read(path) for path in paths]
    t, q, _ = tables[0]
    period = float(np.median(np.diff(t)))
    for path, (at, angles, _) in zip(paths, tables, strict=True):
        if angles.shape[1] != q.shape[1]:
            raise ZygosError(
                f"{path}: has {angles.shape[1]} joints, {paths[0]} has {q.shape[1]}; remedy: give runs of one arm"
            )
        if np.max(np.abs(np.diff(at) - period)) > _EVEN * period:
            raise ZygosError(
                f"{path}: its instants are not {period:g} s apart; remedy: `zygos convert` resamples a recording "
                "(docs/telemetry.md), and writes an arm file for it"
            )
    robot = read_robot(simulation, None, q.shape[1])
    arm = robot.arm(period, [step(column) for column in q.T])
    runs = []
    for path, (_, angles, torques) in zip(paths, tables, strict=True):
        run = make_run(arm, q=angles, theta=angles, tau=torques / arm.gear_ratios)
        runs.append(Run(arm, table=run.table, path=path))
    return robot, arm, runs


def _read(path: Path) -> tuple[Floats, Floats, Floats]:
    """Time (n,), angles and torques (n, N) of a table."""
    if not is_table(path):
        raise ZygosError(
            f"{path}: a CAN log needs an arm file, which says what its frames mean; remedy: give it with --arm, or a "
            f"table (.csv .npz .parquet) with {_NEEDS}"
        )
    columns = {re.sub(r"\[(\d+)\]$", lambda k: str(int(k[1]) + 1), name): x for name, x in read_columns(path).items()}
    at = next((name for name in _TIMES if name in columns), None)
    count = sum(1 for name in columns if re.fullmatch(r"q\d+", name))
    wanted = [f"{block}{i}" for block in ("q", "tau") for i in range(1, count + 1)]
    missing = [name for name in wanted if name not in columns]
    if at is None or not count or missing:
        lacks = ", ".join(missing) or ("t" if at is None else "q1")
        raise ZygosError(
            f"{path}: has no column {lacks}; remedy: without an arm file a run needs {_NEEDS}; give the arm file of "
            "other runs with --arm"
        )
    for name in (at, *wanted):
        if columns[name].dtype.kind not in "iuf" or not np.all(np.isfinite(columns[name])):
            raise ZygosError(f"{path}: column {name} has values that are not numbers; remedy: correct the table")
    numbers = {name: columns[name].astype(np.float64) for name in (at, *wanted)}
    if len(numbers[at]) < 16 or not np.all(np.diff(numbers[at]) > 0.0):
        raise ZygosError(f"{path}: its time does not rise over 16 rows; remedy: sort them")
    q, tau = (np.column_stack([numbers[f"{block}{i}"] for i in range(1, count + 1)]) for block in ("q", "tau"))
    return numbers[at], q, tau


def step(angles: Floats) -> float:
    """The step of an encoder whose uniform error is the noise that neighbouring readings (n,) show, rad."""
    noise = float(np.median(np.abs(np.diff(angles, n=4)))) / 0.6745 / np.sqrt(70.0)
    return float(np.sqrt(12.0) * max(noise, LEAST_NOISE * float(np.std(angles)), 1e-12))
