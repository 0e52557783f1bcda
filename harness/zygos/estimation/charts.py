# SPDX-License-Identifier: MIT
"""Charts of a run as the estimator saw it: the motion, the energy balance, and what is left over of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, Parameter
from zygos.effects import column_named, is_column, spoken
from zygos.estimation.ledger import Ledger
from zygos.native.flight import Estimate, Trace
from zygos.report.figures import signed
from zygos.report.page import Entry, joint_colour, numbers, series, thinned
from zygos.structure import SECOND, STANDARD

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

_JOINT_KINDS = {"Im": "rotor inertia", "k": "stiffness", "b": "damping"}


@dataclass(frozen=True)
class Drawn:
    """The cycles of a run that a page draws."""

    states: Places
    """Of each stretch the first cycle that completed an instant, or its first of all."""
    cycles: Places
    """The first of each stretch."""
    stretch: int
    """Cycles in a stretch."""


def drawn(trace: Trace, most: int | None = None) -> Drawn:
    """Every cycle, or `most` at the most, evenly spaced."""
    count = len(trace.cycles)
    cycles = thinned(count, max(1, count) if most is None else most)
    stretch = int(cycles[1]) if len(cycles) > 1 else max(1, count)
    states = cycles.copy()
    for k, first in enumerate(cycles.tolist()):
        found = np.flatnonzero(trace.instant[first : first + stretch])
        states[k] += found[0] if len(found) else 0
    return Drawn(states, cycles, stretch)


def times(arm: Arm, trace: Trace, at: Drawn) -> tuple[Entry, list[int]]:
    """Instants of the states and of the cycles in s, and the positions of refused ones among the states."""
    time = trace.cycles.sync.astype(np.float64) * arm.period_s
    state_time = time - arm.smoother.lag * arm.period_s
    refused = (trace.instant & ~trace.accepted)[at.states]
    named = {"state": numbers(state_time[at.states]), "cycle": numbers(time[at.cycles])}
    return named, np.flatnonzero(refused).tolist()


def meaning(arm: Arm, name: str) -> tuple[str, int | None]:
    """What a parameter or the coefficient of an effect is, and the joint it belongs to, if to one."""
    if is_column(name):
        joint = column_named(name).joint
        return spoken(arm, name), joint if joint >= 0 else None
    parameter = next(one for one in arm.parameters if one.name == name)
    if parameter.joint is not None:
        return f"{_JOINT_KINDS[parameter.symbol]}, {arm.joints[parameter.joint].name}", parameter.joint
    return _of_bodies(arm, parameter), None


def _of_bodies(arm: Arm, parameter: Parameter) -> str:
    """What a parameter of bodies is."""
    if parameter.symbol in STANDARD:
        link, along = f"link {parameter.ends[0]}", parameter.symbol[1:]
        if parameter.symbol in SECOND:
            return f"inertia of {link} about its joint, {along}"
        return f"first moment of {link}, {along}" if along else f"mass of {link}"
    if parameter.symbol == "G":
        (end,) = parameter.ends
        return f"first moment behind {arm.joints[int(end[:-1]) - 1].name}, direction {end[-1]}"
    if parameter.symbol == "N":
        return f"inertia of {' with '.join(parameter.ends)}"
    first, second = ("base" if end == "0" else f"link {end}" for end in parameter.ends)
    crossed = ", crossed" if parameter.symbol == "b" else ""
    return f"inertia, {first}" if first == second else f"inertia, {first} with {second}{crossed}"


def trajectories(arm: Arm, trace: Trace, at: Drawn) -> list[Entry]:
    """What the estimator saw: smoothed and calibrated, except the torque."""
    n = arm.n
    state = np.where(trace.instant[at.states, None], trace.state[at.states], np.nan)
    q, theta = state[:, :n], state[:, n : 2 * n]
    tau = trace.cycles.tau[at.cycles]
    longest = at.stretch if at.stretch == 1 else 2 * at.stretch
    tau[1:][np.diff(trace.cycles.sync[at.cycles]) > longest] = np.nan  # no line across a gap
    joints = [(i, joint.name, joint_colour(i)) for i, joint in enumerate(arm.joints)]
    angles = [
        series(f"{name}, {end}", colour, values[:, i], dash=end == "motor")
        for i, name, colour in joints
        for end, values in (("link", q), ("motor", theta))
        if end == "motor" or arm.joints[i].flexible
    ]
    deflection = [series(name, c, theta[:, i] - q[:, i]) for i, name, c in joints if arm.joints[i].flexible]
    torque = [series(name, colour, tau[:, i], step=True) for i, name, colour in joints]
    charts: list[Entry] = [
        {"id": "angles", "title": "Joint angles", "unit": "rad", "time": "state", "series": angles},
        {
            "id": "deflection",
            "title": "Deflection, motor angle − link angle",
            "unit": "rad",
            "time": "state",
            "series": deflection,
        },
        {
            "id": "base",
            "title": "Turning rate of the base",
            "unit": "rad/s",
            "time": "state",
            "series": _base(arm, state[:, 4 * n :]),
        },
        {"id": "torque", "title": "Motor torque, before the gear", "unit": "N m", "time": "cycle", "series": torque},
    ]
    return [chart for chart in charts if chart["series"]]


def _base(arm: Arm, omega: Floats) -> list[Entry]:
    if not arm.free:
        return []
    if not arm.spatial:
        return [series("base", "ink", omega @ arm.axis)]
    return [series(axis, joint_colour(i), omega[:, i]) for i, axis in enumerate("xyz")]


def rates(arm: Arm, trace: Trace, at: Drawn) -> list[Entry]:
    """Rates of the motors, after the gear."""
    n = arm.n
    state = np.where(trace.instant[at.states, None], trace.state[at.states], np.nan)
    lines = [series(j.name, joint_colour(i), state[:, 3 * n + i]) for i, j in enumerate(arm.joints)]
    return [{"id": "rates", "title": "Motor rates, after the gear", "unit": "rad/s", "time": "state", "series": lines}]


def energy(ledger: Ledger, at: Drawn) -> list[Entry]:
    """The parts of the energy, stacked, and the work of the motors."""
    return [
        {
            "id": "energy",
            "title": "Work of the motors, and where the energy is",
            "unit": "J",
            "time": "state",
            "height": 300,
            "series": [
                series("dissipated", "dissipated", ledger.dissipated[at.states], stack=True),
                series("elastic", "elastic", ledger.elastic[at.states], stack=True),
                series("kinetic", "kinetic", ledger.kinetic[at.states], stack=True),
                series("work of the motors + energy at the start", "ink", ledger.supplied[at.states], wide=True),
            ],
        }
    ]


def residual(ledger: Ledger, estimate: Estimate, at: Drawn) -> list[Entry]:
    """What the balance leaves over, between lines at ± its root mean square."""
    return [
        {
            "id": "residual",
            "title": "Work not accounted for by the parameters",
            "unit": "J",
            "time": "state",
            "height": 220,
            "lines": [0.0, *([estimate.residual, -estimate.residual] if math.isfinite(estimate.residual) else [])],
            "series": [series("residual", "ink", ledger.residual[at.states], mark=True)],
        }
    ]


def sheet(ledger: Ledger, time: Floats) -> Entry | None:
    """The ledger at the last instant."""
    at = np.flatnonzero(np.isfinite(ledger.residual))
    if not at.size:
        return None
    last = at[-1]
    names = ("supplied", "kinetic", "elastic", "dissipated", "residual")
    return {"time": f"{time[last]:.2f}"} | {name: signed(getattr(ledger, name)[last], 1) for name in names}
