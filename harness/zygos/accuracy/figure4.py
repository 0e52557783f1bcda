# SPDX-License-Identifier: MIT
"""Figure 4 of the paper: motions predicted with true and with estimated parameters (docs/paper-tables.md, erratum 10).

Each parameter set, the paper's own EB estimates among them, predicts a free motion under the torques (50). Two further
predictions show whether such a motion is chaotic: one with a slightly different start, and one with parameters changed
by 0.1 %. Two more comparisons use a run of the true arm without noise: the motion under the servo, which holds the
motors at their desired angles, and short arcs under the run's torques that begin in true states.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from zygos.accuracy.cases import Case
from zygos.accuracy.cell import sensed
from zygos.accuracy.estimators import ESTIMATORS, Prior
from zygos.balances.state import State
from zygos.dynamics.compiled import Planar
from zygos.dynamics.replay import replay, substeps
from zygos.errors import ZygosError
from zygos.paper import printed
from zygos.paper.response import HAIR_RAD, apart_percent, respond, sync_instants
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

SCALES = {"+10 %": 1.1, "−10 %": 0.9, "+0.1 %": 1.001}
HAIR = f"true, {1e3 * HAIR_RAD:g} mrad off"
ARC_S = 5.0
EVERY_S = 1.0
"""Time between the starts of short arcs, s."""
_PAPER = "EB"
PRINTED = "EB, printed"


@dataclass(frozen=True)
class Figure4:
    """Job for one process."""

    case: Case
    seed: int
    code: str

    @property
    def key(self) -> str:
        """Key of the job, as for a cell."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def run(self) -> dict[str, Any]:
        """Estimate from one run, then predict with all parameters. A failed prediction is listed with its reason."""
        with threadpool_limits(1):
            case, arm = self.case, self.case.arm
            noisy = simulate(case.plant, case.model, case.scenario, seeds=[self.seed], noise=True)
            stated_arm, frames = sensed(case, noisy, 0, self.seed)
            prior = Prior(case.scenario.angular_momentum_nms, case.rest_s)
            asked = [one for one in ESTIMATORS if one.ours or one.name == _PAPER]
            answers = {one.name: one.estimate(stated_arm, frames, prior).value for one in asked}

            true = case.model.base_values(arm)
            scaled = {name: scale * true for name, scale in SCALES.items()}
            printed_sets = (
                {PRINTED: printed.eb_values(true, arm.parameter_names)} if printed.describes(arm, true) else {}
            )
            sets: dict[str, Floats | None] = {"true": true, **printed_sets, **answers, **scaled, HAIR: true}
            momentum = case.scenario.angular_momentum_nms
            assert not isinstance(momentum, tuple)
            exact = simulate(case.plant, case.model, case.scenario, seeds=[self.seed], noise=False)
            states = State(exact.q, exact.theta, exact.qd, exact.thetad, exact.omega0).packed()[0]
            free, servoed, arcs, missing = {}, {}, {}, {}
            for name, values in sets.items():
                try:
                    dynamics = Planar.from_parameters(arm, _whole(values))
                    free[name] = respond(arm, _whole(values), momentum, HAIR_RAD if name == HAIR else 0.0)
                except ZygosError as error:
                    missing[name] = str(error)
                    continue
                start = states[:1].copy()
                start[0, 1] += HAIR_RAD if name == HAIR else 0.0
                servoed[name] = _servoed(dynamics, case.scenario, exact, start)
                if name != HAIR:
                    arcs[name] = _apart(dynamics, exact, states)
        return {
            "figure": 4,
            "seed": self.seed,
            "joints": [joint.name for joint in arm.joints],
            "duration_s": case.scenario.duration_s,
            "time_s": sync_instants(arm).tolist(),
            "free": {name: np.round(q, 5).T.tolist() for name, q in free.items()},
            "free_rms_rad": {name: _rms(q - free["true"]) for name, q in free.items()},
            "free_rms_percent": {name: _rms(apart_percent(q, free["true"])) for name, q in free.items()},
            "parting": float(np.max(np.abs(free[HAIR] - free["true"])) / HAIR_RAD),
            "servo_rms_rad": {name: _rms(q - exact.q[0]) for name, q in servoed.items()},
            "horizon_s": (arm.period_s * np.arange(1, round(ARC_S / arm.period_s) + 1)).tolist(),
            "arcs_rad": arcs,
            "missing": missing,
        }


def _rms(off: Floats) -> float:
    return float(np.sqrt(np.mean(off**2)))


def _whole(values: Floats | None) -> Floats:
    if values is None or not np.isfinite(values).all():
        raise ZygosError("not all parameters are known")
    return values


def _servoed(dynamics: Planar, scenario: Scenario, exact: Trajectory, start: Floats) -> Floats:
    """(n, N) link angles [rad] under the scenario's servo with exact encoders, from a state (1, 4N+1)."""
    arm, servo = exact.arm, scenario.controller
    desired, desired_rate = scenario.desired([joint.name for joint in arm.joints], exact.t)
    before: list[Floats] = []

    def torque(k: int, states: State) -> Floats:
        angle = states.theta if servo.angle == "motor" else states.q
        rate = (angle - before[-1]) / arm.period_s if before else np.zeros_like(angle)
        before.append(angle)
        pull = np.array(servo.kp) * (desired[k] - angle) + np.array(servo.kd) * (desired_rate[k] - rate)
        return np.asarray(servo.gain * pull / arm.gear_ratios, dtype=np.float64)

    steps = substeps(dynamics, exact.q[0], arm.period_s)
    moved, _ = replay(dynamics, arm.period_s, start, torque, np.zeros((1, arm.n)), len(exact.t), steps)
    return State.unpacked(moved[0]).q


def _free(dynamics: Planar, exact: Trajectory, starts: Floats, at: NDArray[np.int64], cycles: int) -> Floats:
    """(A, cycles, N) link angles [rad] from the states `starts` (A, 4N+1) at the instants `at` (A,), under the true
    run's torques."""
    arm = exact.arm
    steps = substeps(dynamics, exact.q[0], arm.period_s)
    torques = exact.tau[0][at[:, None] + np.arange(cycles)]
    before = np.zeros((len(at), arm.n))
    moved, _ = replay(dynamics, arm.period_s, starts, lambda k, _: torques[:, k], before, cycles, steps)
    return State.unpacked(moved).q


def _apart(dynamics: Planar, exact: Trajectory, states: Floats) -> list[float]:
    """Errors of short arcs after 1, 2, … cycles: median over the arcs of the joints' rms [rad]."""
    period = exact.arm.period_s
    cycles = round(ARC_S / period) + 1
    at = np.arange(0, len(exact.t) - cycles + 1, round(EVERY_S / period))
    off = _free(dynamics, exact, states[at], at, cycles) - exact.q[0][at[:, None] + np.arange(cycles)]
    median = np.median(np.sqrt(np.mean(off**2, axis=-1)), axis=0)[1:]
    return [float(f"{x:.4g}") for x in median]
