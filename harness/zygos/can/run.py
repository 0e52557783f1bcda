# SPDX-License-Identifier: MIT
"""A recorded run of an arm: the frames of its bus, or a table of cycles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.errors import ZygosError
from zygos.files.inputs import local
from zygos.files.output import counted
from zygos.files.tables import check_table, is_table
from zygos.native.flight import Flight, encode, receivable
from zygos.runs.cycles import Cycles
from zygos.runs.samples import usable
from zygos.runs.span import reading
from zygos.runs.tables import read_cycles, write_cycles

Array = NDArray[np.float64]

COMPARE_BUS = (
    "compare the node numbers and the gyro of the arm file with the bus; where the drives have messages of their own, "
    "convert the log first (`zygos convert`)"
)
"""What helps where no whole cycle of the arm came."""


def of_fd(count: int) -> str:
    """What to do about frames of CAN FD with identifiers of the arm."""
    return (
        f"{counted(count, 'frame')} of this arm are CAN FD, which is not read: send classical frames; where only the "
        "recorder marks them so, remove the marks of a candump log (sed 's/##./#/')"
    )


def without_cycle(faults: Mapping[str, int], fd: int) -> str:
    """What to do about frames of which no cycle is whole; fd: how many of the arm's are CAN FD."""
    if fd:
        return of_fd(fd)
    if faults.get("repeated", 0) > faults.get("dropped", 0) > 0:
        return (
            "every frame is there twice under the name of one interface: record one interface only, and leave out the "
            "sender's echo"
        )
    return COMPARE_BUS


_GAP_CYCLES = 3
"""Number of the first cycle of a run less that of the last cycle of the run before, where runs are joined."""


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """What the sensors of an arm said: n cycles of N joints, before sign, zero and mount correction.

    It comes from CAN frames, or from a table of cycles of which nobody saw the frames. It holds readings only: the run
    of a simulation has no true values in it.
    """

    arm: Arm
    frames: NDArray[Any] | None = None
    """Frames in the order of the bus, records with the fields id, length, flags and data; None: a table of cycles."""
    table: Cycles | None = None
    """The cycles of a table; None: the frames say what the cycles are."""
    path: Path | None = None
    """The file that it was read from, if any."""
    damage: tuple[str, ...] = ()
    """What is missing of a damaged file, in sentences; empty for a whole one."""
    remarks: tuple[str, ...] = ()
    """What else is unusual in a log, in sentences."""

    @classmethod
    def of_cycles(cls, arm: Arm, cycles: Cycles) -> Run:
        """The run whose bus traffic carries these cycles. Values are rounded as the bus rounds them."""
        return cls(arm, encode(arm, cycles))

    @cached_property
    def _received(self) -> tuple[Cycles, dict[str, int], int]:
        """The cycles, the counters of the receiver's faults, and the number of frames of this arm that are CAN FD."""
        if self.table is not None:
            return self.table, {}, 0
        flight = Flight(receivable(self.arm))
        trace = flight.frames(self.frames, trace=True) if self.frames is not None else None
        assert trace is not None
        return trace.cycles, flight.faults, flight.fd_frames

    @property
    def cycles(self) -> Cycles:
        """The cycles, as the receiver of the C library completes them."""
        return self._received[0]

    @property
    def faults(self) -> dict[str, int]:
        """How often the receiver met each kind of fault of the bus; empty for a table, which had no receiver."""
        return self._received[1]

    @property
    def t(self) -> Array:
        """(n,) time of each cycle, s: its number times the SYNC period."""
        return np.asarray(self.cycles.sync * self.arm.period_s, dtype=np.float64)

    @property
    def q(self) -> Array:
        """(n, N) link encoder readings, rad."""
        return self.cycles.q

    @property
    def theta(self) -> Array:
        """(n, N) motor encoder readings after the gear, rad."""
        return self.cycles.theta

    @property
    def tau(self) -> Array:
        """(n, N) rotor torque before the gear, Nm."""
        return self.cycles.tau

    @property
    def omega(self) -> Array:
        """(n, 3) gyro readings in the sensor's frame, rad/s."""
        return self.cycles.omega

    def check_cycles(self) -> None:
        """Refuse, with ZygosError, a run that has not one whole cycle of the arm."""
        if len(self) == 0:
            _, faults, fd = self._received
            seen = ", ".join(f"{name} {count:,}" for name, count in faults.items() if count)
            none = "only frames of CAN FD came" if fd else "no frame of this arm came"
            raise ZygosError(
                f"{self.path or 'the run'}: not one whole cycle of arm {self.arm.name} is in it "
                f"({seen or none}); remedy: {without_cycle(faults, fd)}"
            )

    def __len__(self) -> int:
        """Number of cycles."""
        return len(self.cycles)

    def __repr__(self) -> str:
        """Arm, size and origin."""
        kind = "table of cycles" if self.frames is None else "CAN frames"
        name = "" if self.path is None else f" from {self.path}"
        return f"<Run of arm {self.arm.name}: {len(self):,} cycles, {kind}{name}>"


def find_arm(run: Path, arm: Path | None = None) -> Path:
    """The arm file of a run: the given one, or arm.toml beside it. Errors: ZygosError if the run or the file is not
    there."""
    if is_table(run):
        check_table(run)
    else:
        bus.check_log(run)
    chosen = arm or run.parent / "arm.toml"
    if not local(chosen).is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give the arm (--arm), or put arm.toml beside the run")
    return chosen


def read_run(path: Path, arm: Arm, progress: Callable[[int], None] | None = None) -> Run:
    """Read a log or a table of cycles; `Run.damage` says what is missing of it. progress: as in `read_log`.

    Errors: as `load_run`.
    """
    if is_table(path):
        damage: list[str] = []
        cycles = read_cycles(path, arm, damage)
        return Run(arm, table=cycles, path=path, damage=tuple(f"{path} {text}" for text in damage))
    log = bus.read_log(path, progress)
    return Run(arm, log.frames, path=path, damage=log.damage, remarks=log.remarks)


def load_run(
    path: str | Path,
    arm: Arm | str | Path | None = None,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Run:
    """Read a run: a CAN log (.log .blf .asc .trc .mf4) or a table of cycles (.npz .csv .parquet).

    arm: the arm, or its file; None: arm.toml beside the run. from_s, to_s: the part to read, in s after the first
    frame or row; None: from the beginning, or to the end. Of a damaged log what can be read is read; `Run.damage` and a
    Python warning say what is missing.

    Errors: ZygosError when a file is missing, of no known kind, unreadable, empty, or does not fit the arm.
    """
    file = Path(path)
    known = arm if isinstance(arm, Arm) else load_arm(find_arm(file) if arm is None else arm)
    with reading(from_s, to_s):
        run = read_run(file, known)
    for text in (*run.remarks, *run.damage):
        warnings.warn(text, stacklevel=2)
    return run


def same_recording(one: Run, other: Run) -> bool:
    """Whether two runs have the same cycles, in whatever format; runs without a cycle are no recordings."""
    if len(one) == 0 or len(other) == 0:
        return False
    return np.array_equal(one.cycles.tau, other.cycles.tau) and np.array_equal(one.cycles.theta, other.cycles.theta)


def check_distinct(run: Run, others: Sequence[Run]) -> None:
    """Refuse, with ZygosError, a run that has the same cycles as one of those before it."""
    for number, other in enumerate(others, start=1):
        if same_recording(run, other):
            raise ZygosError(
                f"{other.path or f'run {number}'} and {run.path or f'run {len(others) + 1}'} are the same recording; "
                "remedy: give different runs to learn from and to validate, because a result from one run must hold on "
                "another"
            )


def joined(runs: Sequence[Run]) -> Run:
    """Runs of one arm as one: their cycles one after the other, with a gap between. A single run stays as it is.

    Errors: ZygosError for runs of different arms.
    """
    first = runs[0]
    if len(runs) == 1:
        return first
    begin, parts = 0, []
    for run in runs:
        if run.arm != first.arm:
            raise ZygosError(
                f"{run.path or 'a run'} is of another arm than the first run; remedy: give runs of one arm"
            )
        cycles = run.cycles
        if not len(cycles):
            continue
        # a number that is left out is a gap, over which nothing is integrated
        sync = cycles.sync - cycles.sync[0] + np.uint64(begin)
        parts.append(replace(cycles, sync=sync))
        begin = int(sync[-1]) + _GAP_CYCLES
    whole = Cycles(*(np.concatenate([getattr(one, f.name) for one in parts]) for f in fields(Cycles)))
    damage = tuple(text for run in runs for text in run.damage)
    return Run(first.arm, table=whole, path=first.path, damage=damage)


def save_run(run: Run, path: str | Path) -> None:
    """Write a run, whole or not at all: as CAN log (.log .blf .asc .trc .mf4) or as table of cycles (.npz .csv
    .parquet), by the suffix.

    A table has no frames: what the receiver rejected is not in it. The cycles of a table become the frames that carry
    them. The arm is not written: `save_arm` does that.

    Errors: ZygosError for another suffix, for a table that lacks cycles as log, or if the file cannot be written.
    """
    file = Path(path)
    if is_table(file):
        write_cycles(file, run.cycles)
        return
    bus.check_log_name(file)
    frames = run.frames
    if frames is None:
        cycles = run.cycles
        # nothing comes before the first cycle, so that a break there says nothing
        whole = np.all(np.diff(cycles.sync) == 1) and not np.any(cycles.flags[1:]) and np.all(usable(cycles))
        if not whole:
            raise ZygosError(
                f"{file}: cycles of this table are missing or not valid, which the frames of a log cannot say; remedy: "
                "save it as .npz, .csv or .parquet"
            )
        frames = encode(run.arm, run.cycles)
    bus.write_log(file, frames, run.arm.period_s)


def make_run(
    arm: Arm,
    *,
    q: ArrayLike,
    theta: ArrayLike,
    tau: ArrayLike,
    omega: ArrayLike | None = None,
    sync: ArrayLike | None = None,
    flags: ArrayLike | None = None,
) -> Run:
    """A run from arrays of n cycles of an arm with N joints: a table of cycles, which needs no bus.

    q, theta: (n, N) link and motor encoder readings after the gear, rad; of a rigid joint the motor's counts.
    tau: (n, N) rotor torque before the gear, Nm, recorded as the arm's `torque_law` says.
    omega: (n, 3) gyro reading in the sensor's frame, rad/s; a fixed base has none.
    sync: (n,) numbers of the cycles, rising; by default 0, 1, 2 ... Leave numbers out where cycles are missing.
    flags: (n,) as `Cycles.flags`; by default 0. Cycles whose values are not finite are passed over.

    Errors: ZygosError for arrays of another shape, or for numbers that do not rise.
    """
    if omega is None:
        if arm.free:
            raise ZygosError(f"arm {arm.name} floats freely, but omega is missing; remedy: give the gyro's readings")
        omega = np.zeros((np.shape(q)[0] if np.ndim(q) else 0, 3))
    n = np.shape(q)[0] if np.ndim(q) else 0
    wanted = {"q": (q, arm.n), "theta": (theta, arm.n), "tau": (tau, arm.n), "omega": (omega, 3)}
    readings = {name: np.asarray(values, dtype=np.float64) for name, (values, _) in wanted.items()}
    for name, (_, width) in wanted.items():
        if readings[name].shape != (n, width) or n == 0:
            raise ZygosError(
                f"{name} has the shape {readings[name].shape}; remedy: one row for each cycle and {width} columns, "
                f"{(n or 'n', width)}"
            )
    numbers = np.arange(n) if sync is None else np.asarray(sync)
    marks = np.zeros(n) if flags is None else np.asarray(flags)
    for name, values in (("sync", numbers), ("flags", marks)):
        if values.shape != (n,) or not np.all((values >= 0) & (values == np.floor(values))):
            raise ZygosError(f"{name} is not {n} whole numbers from 0; remedy: one for each cycle")
    if np.any(np.diff(numbers.astype(np.int64)) <= 0):
        raise ZygosError("the numbers of sync do not rise; remedy: sort the cycles by their number, each one once")
    cycles = Cycles(
        sync=numbers.astype(np.uint64),
        q=readings["q"],
        theta=readings["theta"],
        tau=readings["tau"],
        omega=readings["omega"],
        flags=marks.astype(np.uint32),
    )
    return Run(arm, table=cycles)
