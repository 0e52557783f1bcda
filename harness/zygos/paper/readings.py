# SPDX-License-Identifier: MIT
"""Several interpretations of what the paper leaves open, and how close each comes to its Table IV."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.paper import printed
from zygos.paper.methods import de, eb, exact_record, noisy_states
from zygos.paper.tables import Example, noisy_record
from zygos.reference.solver import Rows, solve
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Scenario
from zygos.simulation.score import score

Floats = NDArray[np.float64]


PRINTED_VARIANCE = 0.003 / 12.0
"""Variance of an angle, rad^2, as in (48) (docs/paper-tables.md, erratum 4)."""


FINER_RAD = 0.0021


SPARSE = 10


@dataclass(frozen=True)
class Reading:
    """One interpretation of what the paper leaves open; everything else is as in the example."""

    description: str
    scenario: Callable[[Scenario], Scenario] = lambda scenario: scenario
    arm: Callable[[Arm], Arm] = lambda arm: arm
    rates: eb.Rates = "backward"
    every: int = 1
    """Only every that many rows are used."""


def _duration(duration_s: float) -> Reading:
    return Reading(f"{duration_s:g} s", lambda scenario: replace(scenario, duration_s=duration_s))


def _quantum(arm: Arm, quantum_rad: float) -> Arm:
    joints = tuple(
        replace(
            joint,
            link_encoder=replace(joint.link_encoder, quantum_rad=quantum_rad),
            motor_encoder=replace(joint.motor_encoder, quantum_rad=quantum_rad),
        )
        for joint in arm.joints
    )
    return replace(arm, joints=joints)


def _start(scenario: Scenario) -> Scenario:
    largest = tuple(motion.sines[0].amplitude for motion in scenario.manoeuvre.values())
    return replace(scenario, initial_angles_rad=largest)


READINGS = (
    Reading("as the example"),
    *(_duration(duration) for duration in (30.0, 90.0, 120.0, 150.0)),
    Reading("start at 20°, 40°", _start),
    Reading(
        "servo on link angle",
        lambda scenario: replace(scenario, controller=replace(scenario.controller, angle="link")),
    ),
    Reading(
        "servo: tau, not n tau",
        lambda scenario: replace(scenario, controller=replace(scenario.controller, gain=50.0)),
    ),
    Reading("q = 0.0021 rad", arm=lambda arm: _quantum(arm, FINER_RAD)),
    Reading("variances of (48)", arm=lambda arm: _quantum(arm, float(np.sqrt(12.0 * PRINTED_VARIANCE)))),
    Reading("mid-step differences", rates="midpoint"),
    Reading("one row in ten", every=SPARSE),
)


COLUMNS = {
    "DE": "equations of motion, central and second differences",
    "DE (32)": "equations of motion, noise of the variances (32) added to exact angles, rates and accelerations",
    "EB": "energy balance, differences",
    "EB (32)": "energy balance, noise of the variances (32) added to exact angles and rates",
}


def compare(
    example: Example, seeds: int, progress: Callable[[str, float], None] = lambda *_: None
) -> list[dict[str, Any]]:
    """How close each of `READINGS` comes to Table IV: for each its name, and by column the result of `closeness`.

    progress: called with the current reading and the finished share. Errors: ZygosError for an arm that is not the
    paper's, and for a motion that does not consist of sines.
    """
    if not printed.describes(example.arm, example.true):
        raise ZygosError(
            f"arm {example.arm.name}: its true values are not those of the paper's Table III, with which the readings "
            "are compared; remedy: examples/paper, or a copy of it with another scenario"
        )
    if any(not motion.sines for motion in example.scenario.manoeuvre.values()):
        raise ZygosError(
            f"scenario {example.scenario.name}: a joint has no sines, as the paper's motion (47) has; remedy: "
            'write `kind = "sines"` for each joint'
        )
    model = load_model(example.scenario.plant)
    found = []
    for index, reading in enumerate(READINGS):
        progress(reading.description, index / len(READINGS))
        arm, scenario = reading.arm(example.arm), reading.scenario(example.scenario)
        noisy = simulate(arm, model, scenario, seeds=range(seeds), noise=True, rtol=1e-9, atol=1e-11)
        exact = exact_record(simulate(arm, model, scenario, seeds=[0], noise=False))
        record, states = noisy_record(arm, noisy), noisy_states(arm, exact, range(seeds))
        estimates = {
            "DE": de.regressor(arm, record),
            "DE (32)": de.regressor(arm, states, exact=True),
            "EB": eb.regressor(arm, record, reading.rates),
            "EB (32)": eb.regressor(arm, states, "exact"),
        }
        close: dict[str, Any] = {"reading": reading.description}
        for name, (z, w) in estimates.items():
            value = solved(z, w, reading.every, 2 * arm.n + 1 if "DE" in name else 1)
            close[name] = closeness(name, value, example.true, arm)
        found.append(close)
    return found


def solved(z: Floats, w: Floats, every: int, equations: int) -> Floats:
    """(B, p) least squares over every `every`-th instant, each with the given number of equations."""
    kept = np.arange(w.shape[1]) // equations % every == 0
    return np.stack([solve(Rows.exact(a[kept], b[kept])).x for a, b in zip(z, w, strict=True)])


def closeness(name: str, value: Floats, true: Floats, arm: Arm) -> dict[str, Any]:
    """Distance of estimates (B, p) from the printed errors: mean size, and number of signs and sizes that agree."""
    mean = dict(zip(arm.parameter_names, score(value, true).error_percent.mean(axis=0), strict=True))
    words = [printed.agreement(float(mean[n]), error) for n, error in printed.ERRORS[name[:2]].items()]
    return {
        "mean_size_percent": float(np.mean(np.abs(list(mean.values())))),
        "signs": sum("sign" in word for word in words),
        "sizes": sum("size" in word for word in words),
        "error_percent": {n: float(e) for n, e in mean.items()},
    }
