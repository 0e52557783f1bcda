# SPDX-License-Identifier: MIT
"""A run as a table of cycles: the input of the flight library's function for cycles, for arms on other buses.

CSV and Parquet have the columns sync, q1 .. qN, theta1 .. thetaN, tau1 .. tauN, wx, wy, wz, flags; NPZ has the fields
of `zygos.runs.cycles.Cycles` under their names. All values are in SI units and, as there, without corrections of sign,
zero and mount.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.files.inputs import suffix
from zygos.files.tables import Columns, read_columns, write_columns
from zygos.runs.cycles import Cycles
from zygos.runs.span import span

_BLOCKS = ("q", "theta", "tau")


def _names(joints: int) -> list[str]:
    return ["sync", *(f"{block}{i + 1}" for block in _BLOCKS for i in range(joints)), "wx", "wy", "wz", "flags"]


def write_cycles(path: Path, cycles: Cycles) -> None:
    """Write a cycle table in the format of the suffix, completely or not at all."""
    if path.suffix.lower() == ".npz":
        write_columns(path, {name: getattr(cycles, name) for name in Cycles.__dataclass_fields__})
        return
    joints = cycles.q.shape[1]
    values = [cycles.sync, *cycles.q.T, *cycles.theta.T, *cycles.tau.T, *cycles.omega.T, cycles.flags]
    write_columns(path, dict(zip(_names(joints), values, strict=True)))


def read_cycles(path: Path, arm: Arm, damage: list[str] | None = None) -> Cycles:
    """Read a cycle table of an arm, in the span that is read. Values may be NaN; the flight library drops such cycles.

    damage: as of `read_columns`.
    Raises ZygosError naming the column if it is missing, unknown or not numeric, if cycle numbers or flags are not
    integers, or if cycle numbers do not increase.
    """
    columns = read_columns(path, damage)
    if suffix(path) == ".npz":
        columns = {_of_npz(name): values for name, values in columns.items()}
    wanted = _names(arm.n)
    for name in wanted:
        if name not in columns:
            raise ZygosError(
                f"{path}: the cycle table of arm {arm.name} has no column {name}; remedy: it needs {' '.join(wanted)} "
                "(docs/telemetry.md); convert other tables with `zygos convert --map`"
            )
    for name in columns:
        if name not in wanted:
            close = difflib.get_close_matches(name, wanted, n=1)
            hint = f", did you mean {close[0]}?" if close else ""
            raise ZygosError(f"{path}: {name} is no column of a cycle table of {arm.n} joints; remedy: remove it{hint}")
    values = {name: _numbers(path, name, columns) for name in wanted[1:-1]}
    sync, flags = _whole(path, "sync", columns, 2**63), _whole(path, "flags", columns, 2**32)
    falls = np.flatnonzero(np.diff(sync) <= 0)
    if len(falls):
        raise ZygosError(
            f"{path}: sync does not increase after row {falls[0] + 1} ({sync[falls[0]]}, then {sync[falls[0] + 1]}); "
            "remedy: number the cycles upwards, and skip the numbers of missing cycles"
        )

    def block(names: list[str]) -> NDArray[np.float64]:
        return np.column_stack([values[name] for name in names])

    rows = span().rows(path, (sync - sync[0]) * arm.period_s)
    return Cycles(
        sync=sync.astype(np.uint64)[rows],
        q=block([f"q{i + 1}" for i in range(arm.n)])[rows],
        theta=block([f"theta{i + 1}" for i in range(arm.n)])[rows],
        tau=block([f"tau{i + 1}" for i in range(arm.n)])[rows],
        omega=block(["wx", "wy", "wz"])[rows],
        flags=flags.astype(np.uint32)[rows],
    )


def _of_npz(name: str) -> str:
    """Name in a CSV for a column of an NPZ: q[0] is q1, omega[0] is wx."""
    found = re.fullmatch(r"(\w+)\[(\d+)\]", name)
    if found is None:
        return name
    k = int(found[2])
    return "wx wy wz".split()[k] if found[1] == "omega" and k < 3 else f"{found[1]}{k + 1}"


def _numbers(path: Path, name: str, columns: Columns) -> NDArray[np.float64]:
    values = columns[name]
    if values.dtype.kind not in "iuf":
        raise ZygosError(f"{path}: column {name} has values that are not numbers; remedy: correct the table")
    return values.astype(np.float64)


def _whole(path: Path, name: str, columns: Columns, end: int) -> NDArray[np.int64]:
    values = columns[name]
    if values.dtype.kind not in "iuf" or not np.all((values >= 0) & (values < end) & (values == np.floor(values))):
        raise ZygosError(f"{path}: column {name} has values that are not whole numbers from 0; remedy: correct it")
    return values.astype(np.int64)
