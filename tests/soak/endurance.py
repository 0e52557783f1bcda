# SPDX-License-Identifier: MIT
"""One soak: weeks of CAN frames through the C library as fast as it takes them, with losses, stale frames and restarts.

A few stored motions are repeated; the errors of all sensors are drawn anew each time. What the library counts is held
against `soak.traffic.Book`, and its intervals against the values that the motions were simulated with.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from runs_support import trajectory_of

from conftest import ROOT
from soak.traffic import Book, disturbed
from zygos.accuracy.mission import kept, sensed_motions
from zygos.arm import Arm, load_arm
from zygos.model.model import Model, load_model
from zygos.native import snapshot
from zygos.native.flight import Estimate, Flight, encode
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import record
from zygos.simulation.scenario import Scenario, load_scenario
from zygos.simulation.sensors import no_noise

LOST, STALE = 1e-4, 1e-5
"""Shares of all frames that are lost, and of the frames of drives and gyro that are those of the cycle before."""
LOOKS = 10
"""How often the estimate is looked at, at equal distances."""
FAR_SIGMAS, FAR_SHARE = 5.0, 0.005
"""An interval is wrong in spite of its confidence if its value is off by more of its sigmas and of the true value."""


@dataclass(frozen=True)
class Soak:
    """What is flown, and for how long."""

    name: str
    example: str
    days: float
    """Duration of the whole soak."""
    share: float
    """Share of it that is flown unless more is asked for."""
    motion_s: float
    motions: int
    resumed_s: float
    """From one snapshot to the next."""
    validity: str
    """What the estimate has to be: "partial" where the motion does not determine every parameter."""

    def arm(self) -> Arm:
        """The arm of the example."""
        return load_arm(ROOT / "examples" / self.example / "arm.toml")

    def model(self) -> Model:
        """The model of the example, which has the true values."""
        return load_model(ROOT / "examples" / self.example / "model.toml")

    def scenario(self) -> Scenario:
        """The motion of the example."""
        return load_scenario(ROOT / "examples" / self.example / "scenario.toml")


SOAKS = {
    one.name: one
    for one in (
        Soak("two", "paper", 30.0, 1.0, 300.0, 4, 86_400.0, "valid"),
        Soak("seven", "seven", 3.0, 1.0 / 20.0, 60.0, 4, 1_800.0, "partial"),
    )
}
"""By name. The frames of seven joints for three days take the library half an hour or more."""


@dataclass(frozen=True)
class Look:
    """The estimate after so many cycles."""

    cycles: int
    validity: str
    reason: str
    published: int
    covered: int
    """Published 95 % intervals that contain the true value."""
    worst_sigmas: float
    """Largest error of a published value in its sigmas."""
    wrong: int
    """Published values that are off by more than FAR_SIGMAS and FAR_SHARE."""
    half95_percent: float
    """Median half width, in percent of the true value."""


@dataclass
class Outcome:
    """What came of a soak."""

    name: str
    joints: int
    parameters: int
    rate_hz: float
    days: float
    share: float
    wanted: str
    """What the estimate has to be."""
    cycles: int = 0
    frames: int = 0
    lost: int = 0
    stale: int = 0
    resumed: int = 0
    expected: dict[str, int] = field(default_factory=dict)
    found: dict[str, int] = field(default_factory=dict)
    looks: list[Look] = field(default_factory=list)
    library_s: float = 0.0
    """Time in the calls of the library that take frames."""
    seconds: float = 0.0
    """Time of the whole soak, without the simulation of the motions."""

    @property
    def failures(self) -> list[str]:
        """What does not hold, in words."""
        last = self.looks[-1]
        odd = [look for look in self.looks if look.validity != self.wanted]
        least = 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / max(last.published, 1))
        out = [f"the estimate after {one.cycles:,} cycles is {one.validity}: {one.reason}" for one in odd]
        if self.expected != self.found:
            out.append(f"the counters are {self.found}, not {self.expected}")
        if not last.published or last.covered < least * last.published:
            hold = f"{last.covered} of {last.published} intervals contain the true value"
            out.append(f"{hold}, which is below {100.0 * least:.0f} %")
        if any(look.wrong for look in self.looks):
            out.append(f"values are off by more than {FAR_SIGMAS:g} sigmas and {100.0 * FAR_SHARE:g} %")
        return out

    def as_json(self) -> dict[str, Any]:
        """For the file."""
        return asdict(self) | {"failures": self.failures}

    @classmethod
    def of_json(cls, stored: dict[str, Any]) -> Outcome:
        """What `as_json` made of one."""
        own = {name: value for name, value in stored.items() if name != "failures"}
        return cls(**own | {"looks": [Look(**look) for look in own["looks"]]})


def stored(soak: Soak, folder: Path) -> list[Cycles]:
    """The motions without errors of the sensors: read from the folder, or simulated and stored there. They differ
    because the servo reads encoders with errors of its own."""
    arm, model, scenario = soak.arm(), soak.model(), soak.scenario()
    told = repr((arm, model, scenario, soak.motion_s, soak.motions))

    def simulated() -> list[Cycles]:
        run = trajectory_of(arm, model, scenario, noise=True, seeds=range(soak.motions), duration_s=soak.motion_s)
        silent = replace(run, noise=no_noise(run.arm, len(run.t), run.seeds))
        return [record(silent, k) for k in range(soak.motions)]

    return kept(folder, soak.example, told, simulated)


def look_at(found: Estimate, true: np.ndarray[Any, np.dtype[np.float64]], cycles: int) -> Look:
    """Compare an estimate with the true values (p,)."""
    published = np.isfinite(found.value)
    error, sigma = np.abs(found.value - true)[published], found.sigma[published]
    half, size = found.half95[published], np.abs(true[published])
    shares = 100.0 * half[size > 0.0] / size[size > 0.0]
    return Look(
        cycles=cycles,
        validity=found.validity,
        reason=found.reason,
        published=int(published.sum()),
        covered=int((error <= half).sum()),
        worst_sigmas=round(float((error / sigma).max(initial=0.0)), 2),
        wrong=int(((error > FAR_SIGMAS * sigma) & (error > FAR_SHARE * size)).sum()),
        half95_percent=float(f"{np.median(shares) if len(shares) else np.nan:.3g}"),
    )


def fly(soak: Soak, share: float, folder: Path, seed: int, passed: Callable[[float], object]) -> Outcome:
    """Fly a share of a soak. passed: is told which part of it has been flown."""
    arm, true = soak.arm(), soak.model().base_values(soak.arm())
    motions = stored(soak, folder)
    total = max(len(motions[0]), round(share * soak.days * 86_400.0 / arm.period_s))
    flight, book = Flight(arm), Book(2 * arm.n + (2 if arm.free else 0))
    rng = np.random.default_rng([seed, 7])
    out = Outcome(
        soak.name, arm.n, len(arm.parameter_names), 1.0 / arm.period_s, soak.days * share, share, soak.validity
    )
    begin = time.perf_counter()
    last = np.empty(0)
    with tempfile.TemporaryDirectory() as scratch:
        for cycles in sensed_motions(arm, motions, total, seed):
            first = int(cycles.sync[0])
            if first * arm.period_s >= (out.resumed + 1) * soak.resumed_s:
                snapshot.write(Path(scratch) / "state", "state", flight.native)
                flight = Flight(arm)
                snapshot.resume(flight, Path(scratch) / "state")
                book.resume()
                out.resumed += 1
            frames = encode(arm, cycles)
            last = frames[-1:]
            sent = disturbed(frames[:-1], first, LOST * (first > 0), STALE, rng)
            book.hear(sent)
            arriving = sent.arriving
            before = time.perf_counter()
            flight.frames(arriving)
            out.library_s += time.perf_counter() - before
            out.cycles += len(cycles)
            out.frames += len(sent.frames)
            out.lost += int(sent.lost.sum())
            out.stale += int(sent.stale.sum())
            if out.cycles * LOOKS // total > len(out.looks):
                out.looks.append(look_at(flight.estimate(), true, out.cycles))
            passed(out.cycles / total)
    flight.frames(last)  # closes the last cycle
    book.end()
    out.expected = dict(sorted((+book.faults).items())) | {"cycles": book.cycles}
    out.found = dict(sorted((+Counter(flight.faults)).items())) | {"cycles": flight.counts["cycles"]}
    out.seconds = round(time.perf_counter() - begin, 1)
    out.library_s = round(out.library_s, 1)
    return out
