# SPDX-License-Identifier: MIT
"""A mission: up to a month of one arm, and the estimate of the flight library at its end.

A mission repeats a few stored motions without sensor errors, and draws the errors of all sensors anew each time.
Between two motions some cycles are missing. A share of the traffic is lost, and at regular intervals the state is
sealed into a snapshot and resumed from it.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from zygos.accuracy.cases import Case
from zygos.accuracy.cell import STREAM
from zygos.arm import Arm
from zygos.files.output import write_bytes
from zygos.native import snapshot
from zygos.native.flight import Estimate, Flight, encode
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import record, simulate
from zygos.simulation.sensors import draw_noise, no_noise, torque_error

Floats = NDArray[np.float64]
Line = dict[str, Any]

MOTION_S = 300.0
MOTIONS, REPEATED = 24, 4
"""Number of stored motions, each with its own encoder errors in the servo, and how many of them one mission repeats."""
MISSING = 5
"""Number of cycles that are missing between two motions."""
LOST = 1e-4
"""Share of the lost frames, or of the lost cycles if the library is fed with cycles."""
RESUMED_S = 86_400.0
"""Time between two snapshots, s; one hour in missions shorter than a day."""


@dataclass(frozen=True)
class Length:
    """Duration and number of missions, and the input of the library."""

    name: str
    duration_s: float
    draws: int
    door: str
    """Input of the library: "frames" are the CAN frames of a bus; "cycles" are cycles in SI units, five times as
    fast."""


LENGTHS = (
    Length("60s", 60.0, 200, "frames"),
    Length("300s", 300.0, 200, "frames"),
    Length("3h", 10_800.0, 60, "frames"),
    Length("30d", 2_592_000.0, 12, "cycles"),
)


@dataclass(frozen=True)
class Mission:
    """Job for one process."""

    case: Case
    length: Length
    number: int
    folder: Path
    """Folder of the stored motions."""
    code: str
    """Fingerprint of the code that created the job."""

    @property
    def key(self) -> str:
        """Key of the result: it depends on everything that is computed, including the code."""
        return hashlib.sha256(repr(replace(self, folder=Path())).encode()).hexdigest()[:16]

    def motions(self) -> list[int]:
        """Numbers of the stored motions that are repeated, in order: one per motion's time, four at most."""
        count = min(REPEATED, max(1, round(self.length.duration_s / MOTION_S)))
        order = np.random.default_rng([self.number, 4]).permutation(MOTIONS)
        return [int(k) for k in order[:count]]

    def run(self) -> Line:
        """Simulate or read the motions, feed the library, and return its estimate at the end."""
        with threadpool_limits(1):
            every = stored(self.case, self.folder)
            motions = [every[k] for k in self.motions()]
            begin = time.perf_counter()
            flight, cycles, resumed = flown_mission(self, motions)
            found = flight.estimate()
        return {
            "case": self.case.name,
            "length": self.length.name,
            "mission": self.number,
            "cycles": cycles,
            "resumed": resumed,
            "seconds": round(time.perf_counter() - begin, 1),
            **_answer(found, len(self.case.arm.parameter_names)),
        }


def _answer(found: Estimate, own: int) -> Line:
    """An estimate as stored in a line of the file, without the effects."""

    def digits(values: Floats) -> list[float | None]:
        return [float(f"{x:.9g}") if np.isfinite(x) else None for x in values[:own].tolist()]

    return {
        "validity": found.validity,
        "reason": found.reason,
        "value": digits(found.value),
        "sigma": digits(found.sigma),
        "half95": digits(found.half95),
        "refused": found.refused,
        "arcs": found.arcs,
        "blocks": found.blocks,
        "gate": float(f"{found.signal_to_noise:.6g}") if np.isfinite(found.signal_to_noise) else None,
        "noise_ratio": float(f"{found.noise_ratio:.6g}") if np.isfinite(found.noise_ratio) else None,
        "cluster": float(f"{found.cluster:.6g}"),
    }


def stored(case: Case, folder: Path) -> list[Cycles]:
    """The motions of a case without sensor errors: read from the folder, or simulated and stored there."""
    described = repr((case.plant, case.model, case.scenario, case.engine, MOTIONS, MOTION_S))
    return kept(folder, case.name, described, lambda: simulated(case))


def kept(folder: Path, name: str, described: str, make: Callable[[], list[Cycles]]) -> list[Cycles]:
    """Motions of equal length from a file in the folder, which is written where there is none of that description."""
    path = folder / f"{name}-{hashlib.sha256(described.encode()).hexdigest()[:12]}.npz"
    if not path.exists():
        write_bytes(path, _packed(make()))
    return _read(path)


def simulated(case: Case, count: int = MOTIONS) -> list[Cycles]:
    """The motions of seeds 0 .. count-1, which differ because the servo reads encoders with different errors."""
    run = simulate(
        case.plant,
        case.model,
        case.scenario,
        engine=case.engine,
        seeds=range(count),
        noise=True,
        duration_s=MOTION_S,
        rtol=1e-9,
        atol=1e-11,
    )
    silent = replace(run, noise=no_noise(run.arm, len(run.t), run.seeds))
    return [record(silent, index) for index in range(count)]


def _packed(motions: Sequence[Cycles]) -> bytes:
    with tempfile.TemporaryFile() as file:
        columns: Any = {name: np.stack([getattr(one, name) for one in motions]) for name in vars(motions[0])}
        np.savez(file, **columns)
        file.seek(0)
        return file.read()


@lru_cache(maxsize=1)
def _read(path: Path) -> list[Cycles]:
    with np.load(path) as file:
        held = dict(file)
    return [Cycles(**{name: column[k] for name, column in held.items()}) for k in range(len(held["sync"]))]


def flown_mission(mission: Mission, motions: Sequence[Cycles]) -> tuple[Flight, int, int]:
    """The library after a mission, the number of cycles sent, and how often it was resumed from a snapshot."""
    arm, length = mission.case.arm, mission.length
    flight = Flight(arm)
    every = RESUMED_S if length.duration_s > RESUMED_S else 3600.0
    resumed, sent = 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        for cycles in sensed_motions(arm, motions, round(length.duration_s / arm.period_s), mission.number):
            if cycles.sync[0] * arm.period_s >= (resumed + 1) * every:
                snapshot.write(Path(scratch) / "state", "state", flight.native)
                flight = Flight(arm)
                snapshot.resume(flight, Path(scratch) / "state")
                resumed += 1
            sent += len(cycles)
            rng = np.random.default_rng([mission.number, int(cycles.sync[0]), 6])
            if length.door == "frames":
                frames = encode(arm, cycles)
                flight.frames(frames[rng.random(len(frames)) >= LOST])
            else:
                flight.cycles(taken(cycles, np.flatnonzero(rng.random(len(cycles)) >= LOST)))
    return flight, sent, resumed


def sensed_motions(arm: Arm, motions: Sequence[Cycles], total: int, seed: int) -> Iterator[Cycles]:
    """The motions in turn with fresh errors of the sensors, `total` cycles in all, MISSING ones between two motions."""
    left, sync = total, 0
    bias = np.zeros(3)
    turn = 0
    while left > 0:
        motion = motions[turn % len(motions)]
        n = min(left, len(motion))
        noise = draw_noise(arm, n, [seed + turn * STREAM])
        yield Cycles(
            sync=np.arange(sync, sync + n, dtype=np.uint64),
            q=motion.q[:n] + noise.link[0],
            theta=motion.theta[:n] + noise.motor[0],
            tau=motion.tau[:n] + torque_error(motion.tau[:n], noise.torque[0], noise.torque_share[0]),
            omega=motion.omega[:n] + noise.gyro[0] + bias,
            flags=motion.flags[:n],
        )
        bias += noise.bias[0, -1]
        sync += n + MISSING
        left -= n
        turn += 1


def taken(cycles: Cycles, places: NDArray[np.int64]) -> Cycles:
    """The cycles at the given places."""
    return Cycles(**{name: column[places] for name, column in vars(cycles).items()})
