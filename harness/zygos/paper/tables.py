# SPDX-License-Identifier: MIT
"""The paper's tables, reproduced: its three methods in batch, and for comparison the flight library.

K. Nanos, E. Papadopoulos, "On Parameter Estimation of Space Manipulator Systems with Flexible Joints Using the Energy
Balance". docs/paper.md states how the paper is interpreted, and which of its printed formulas had to be corrected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.files.examples import example
from zygos.model.model import load_model
from zygos.native.flight import Flight, encode
from zygos.paper import printed
from zygos.paper.methods import Record, amc, de, eb, exact_record, noisy_states, record_of
from zygos.paper.response import HAIR_RAD, apart_percent, respond
from zygos.runs.samples import calibrate
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario, load_scenario
from zygos.simulation.score import Score, score

Floats = NDArray[np.float64]


NOISE = (
    "encoders: quantum q = 0.003 rad (500 lines, decoded fourfold), white, variance q²/12 = 7.5e-7 rad²; "
    "gyro: white part 0.31623 µrad/s^½, bias walk 3.1623e-4 µrad/s^1.5; torque exact"
)


@dataclass(frozen=True)
class Example:
    """The files of an example, and the true parameters, which only the scoring uses."""

    arm: Arm
    scenario: Scenario
    true: Floats
    """(p,)"""
    files: tuple[Path, ...]
    """All files that were read."""


def load_example(folder: Path | None) -> Example:
    """Read arm, scenario and plant of a folder; by default the example `paper` of the package."""
    chosen = folder or example("paper")
    scenario = load_scenario(chosen / "scenario.toml")
    arm = load_arm(scenario.arm)
    files = (chosen / "scenario.toml", scenario.arm, scenario.plant)
    return Example(arm, scenario, load_model(scenario.plant).base_values(arm), files)


def noisy_record(arm: Arm, trajectory: Trajectory) -> Record:
    """The sensor readings of all seeds, as input of the batch methods."""
    return record_of(arm, *(calibrate(arm, trajectory.cycles(k)) for k in range(len(trajectory.seeds))))


def flight_estimates(arm: Arm, trajectory: Trajectory) -> Floats:
    """(B, p) estimates of the C library from CAN frames."""
    values = []
    for k in range(len(trajectory.seeds)):
        flight = Flight(arm)
        flight.frames(encode(arm, trajectory.cycles(k)))
        values.append(flight.estimate().value[: len(arm.parameter_names)])
    return np.array(values)


def paper_example(folder: Path | None) -> tuple[Example, float]:
    """An example to which the paper's methods apply, and its angular momentum, Nms. Errors: ZygosError."""
    example = load_example(folder)
    momentum = example.scenario.angular_momentum_nms
    if example.arm.spatial or not example.arm.free or isinstance(momentum, tuple):
        raise ZygosError(
            f"arm {example.arm.name}: the paper's methods need a free-floating arm that moves in a plane; "
            "remedy: use `zygos estimate` for any other"
        )
    return example, momentum


NOISY = ("AMC", "DE", "EB", "EB (32)", "flight")


EXACT = ("DE, exact data", "EB, exact data", "flight, no noise")


SAID = {
    "AMC": "angular momentum, backward differences",
    "DE": "equations of motion, central and second differences",
    "EB": "energy balance, backward differences",
    "EB (32)": "energy balance, exact states with independent noise of the variances (32) added to angles and rates",
    "flight": "the C library from CAN frames",
    "DE, exact data": "equations of motion, exact rates and accelerations",
    "EB, exact data": "energy balance, exact rates and dissipation",
    "flight, no noise": "the C library from CAN frames of exact sensors",
}


@dataclass(frozen=True)
class Reproduction:
    """The estimates of all methods, and their errors."""

    example: Example
    seeds: int
    estimates: dict[str, Floats]
    """(seeds, p) by method; (1, p) for exact data."""
    described: bool
    """Whether the arm is the one whose numbers the paper prints."""
    figure: dict[str, Any] | None
    """Fig. 4(b) as numbers; None for a different arm."""

    @cached_property
    def scores(self) -> dict[str, Score]:
        """Errors by method."""
        return {name: score(value, self.example.true) for name, value in self.estimates.items()}

    def as_json(self) -> dict[str, Any]:
        """The content of the command's JSON."""
        arm = self.example.arm
        content: dict[str, Any] = {
            "arm": arm.name,
            "seeds": self.seeds,
            "duration_s": self.example.scenario.duration_s,
            "noise": NOISE,
            "methods": [summary(name, value, self.scores[name], arm) for name, value in self.estimates.items()],
        }
        if self.described:
            content["printed"] = {
                "actual": printed.ACTUAL,
                "estimates": printed.ESTIMATES,
                "errors_percent": printed.ERRORS,
                "agreement": {name: agreements(name, self.scores[name], arm) for name in printed.ERRORS},
            }
        if self.figure is not None:
            content["figure4b"] = self.figure
        return content


def reproduce(
    example: Example, momentum_nms: float, seeds: int, progress: Callable[[str, float], None] = lambda *_: None
) -> Reproduction:
    """Simulate an example with the noise of seeds 0 .. seeds-1 and without noise, and apply every method.

    momentum_nms: the angular momentum given to AMC. progress: called with the name of the current step and the finished
    share.
    """
    arm, true, scenario = example.arm, example.true, example.scenario
    model = load_model(scenario.plant)
    what = f"simulating {seeds} seeds"
    noisy = simulate(arm, model, scenario, seeds=range(seeds), noise=True, progress=lambda share: progress(what, share))
    quiet = "simulating without noise"
    clean = simulate(arm, model, scenario, seeds=[0], noise=False, progress=lambda share: progress(quiet, share))
    progress("estimating", 0.0)
    record, exact = noisy_record(arm, noisy), exact_record(clean)
    estimates: dict[str, Floats] = {
        "AMC": amc.estimate(arm, record, momentum_nms=momentum_nms),
        "DE": de.estimate(arm, record),
        "EB": eb.estimate(arm, record, rates="backward", start="rest"),
        "EB (32)": eb.estimate(arm, noisy_states(arm, exact, range(seeds)), rates="exact", start="rest"),
        "flight": flight_estimates(arm, noisy),
        "DE, exact data": de.estimate(arm, exact, exact=True),
        "EB, exact data": eb.estimate(arm, exact, rates="exact", start="rest"),
        "flight, no noise": flight_estimates(arm, clean),
    }
    progress("responding to the torques (50)", 0.5)
    described = printed.describes(arm, true)
    figure = responses(arm, true, estimates, momentum_nms) if described else None
    return Reproduction(example, seeds, estimates, described, figure)


def summary(name: str, value: Floats, result: Score, arm: Arm) -> dict[str, Any]:
    """The entry of a method in the JSON: its errors over all parameters, and those of each."""
    seen = np.isfinite(result.rms)
    return {
        "method": name,
        "said": SAID[name],
        "seen": int(seen.sum()),
        "mean_rms_percent": float(np.mean(result.rms[seen])),
        "max_rms_percent": float(np.max(result.rms[seen])),
        "per_parameter": {
            n: {"mean": float(v), "mean_error_percent": float(e), "rms_percent": float(r)}
            for n, v, e, r in zip(arm.parameter_names, value.mean(axis=0), mean_error(result), result.rms, strict=True)
        },
    }


def mean_error(result: Score) -> Floats:
    """(p,) signed mean over the seeds, %."""
    return np.asarray(result.error_percent.mean(axis=0), dtype=np.float64)


def agreements(name: str, result: Score, arm: Arm) -> dict[str, str]:
    """Agreement of our mean error of each parameter with the printed one: in sign, size, both or none."""
    mean = dict(zip(arm.parameter_names, mean_error(result), strict=True))
    return {n: printed.agreement(float(mean[n]), error) for n, error in printed.ERRORS[name].items()}


INSTANTS_S = (5.0, 10.0, 20.0, 30.0, 60.0, 90.0, 120.0)


def responses(arm: Arm, true: Floats, estimates: dict[str, Floats], momentum_nms: float) -> dict[str, Any]:
    """Fig. 4(b) as numbers: differences of the responses to (50), in per cent of the largest angle so far."""
    sets = {
        "EB printed": printed.eb_values(true, arm.parameter_names),
        "EB": estimates["EB"][0],
        "flight": estimates["flight"][0],
        "+10 %": 1.1 * true,
        "-10 %": 0.9 * true,
    }
    exact = respond(arm, true, momentum_nms)
    at = np.rint(np.array(INSTANTS_S) / arm.period_s).astype(np.int64)
    content: dict[str, Any] = {
        "time_s": list(INSTANTS_S),
        "true_rad": exact[at].T.tolist(),
        "error_percent": {},
        "rms_percent": {},
        "missing": {},
    }
    for name, values in sets.items():
        try:
            off = apart_percent(respond(arm, values, momentum_nms), exact)
        except ZygosError as error:
            content["missing"][name] = str(error)
            continue
        content["error_percent"][name] = off[at].T.tolist()
        content["rms_percent"][name] = float(np.sqrt(np.mean(off**2)))
    hair = respond(arm, true, momentum_nms, HAIR_RAD)
    content["parting"] = float(np.max(np.abs(hair - exact)) / HAIR_RAD)
    return content
