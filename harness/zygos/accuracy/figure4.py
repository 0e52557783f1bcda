"""Figure 4 of the paper: motions predicted with true and with estimated parameters (docs/paper.md, erratum 10).

All parameters drive the same servo along the same desired angles from the same start, as in the paper. Since the motion
is chaotic, two more comparisons stand beside it: the true arm from a start that is off by a hair, and short arcs that
begin in true states, under the torques of the true run.
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
from zygos.accuracy.estimators import ESTIMATORS, Told
from zygos.dynamics import PlanarDynamics
from zygos.errors import ZygosError
from zygos.plant import Trajectory, simulate
from zygos.replay import States, replay, substeps
from zygos.scenario import Scenario

Floats = NDArray[np.float64]

HAIR_RAD = 1e-6
"""By which one start is off."""
SCALE = 0.1
ARC_S = 5.0
EVERY_S = 1.0
"""Short arcs begin so far apart."""
_PAPER = "EB"


@dataclass(frozen=True)
class Figure4:
    """Work for one process."""

    case: Case
    seed: int
    code: str

    @property
    def key(self) -> str:
        """As of a cell."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def run(self) -> dict[str, Any]:
        """Estimate from one run, then predict with all parameters. What has no motion is named with the reason."""
        with threadpool_limits(1):
            case, arm = self.case, self.case.arm
            noisy = simulate(case.plant, case.model, case.scenario, seeds=[self.seed], noise=True)
            told_arm, frames = sensed(case, noisy, 0, self.seed)
            told = Told(case.scenario.angular_momentum_nms, case.rest_s)
            asked = [one for one in ESTIMATORS if one.ours or one.name == _PAPER]
            answers = {one.name: one.estimate(told_arm, frames, told).value for one in asked}

            true = case.model.base_values(arm)
            sets: dict[str, Floats | None] = {"true": true, **answers}
            sets |= {"+10 %": (1.0 + SCALE) * true, "−10 %": (1.0 - SCALE) * true}
            exact = simulate(case.plant, case.model, case.scenario, seeds=[self.seed], noise=False)
            start = States(exact.omega0, exact.q, exact.theta, exact.qd, exact.thetad).packed()[0]
            motions, arcs, missing = {}, {}, {}
            for name, values in sets.items():
                try:
                    dynamics = PlanarDynamics.from_parameters(arm, _whole(values))
                    motions[name] = _servoed(dynamics, case.scenario, exact, start[0])
                    arcs[name] = _apart(_arcs(dynamics, exact, start), exact)
                except ZygosError as error:
                    missing[name] = str(error)
            hair = start[0].copy()
            hair[1] += HAIR_RAD
            motions["true, off by a hair"] = _servoed(
                PlanarDynamics.from_parameters(arm, true), case.scenario, exact, hair
            )
        return {
            "figure": 4,
            "seed": self.seed,
            "joints": [joint.name for joint in arm.joints],
            "time_s": exact.t.tolist(),
            "motions": {name: np.round(q, 5).T.tolist() for name, q in motions.items()},
            "rms_rad": {name: float(np.sqrt(np.mean((q - motions["true"]) ** 2))) for name, q in motions.items()},
            "horizon_s": (arm.period_s * np.arange(1, len(arcs["true"]) + 1)).tolist(),
            "arcs_rad": {name: [float(f"{x:.4g}") for x in apart] for name, apart in arcs.items()},
            "missing": missing,
        }


def _whole(values: Floats | None) -> Floats:
    if values is None or not np.isfinite(values).all():
        raise ZygosError("not all parameters are known")
    return values


def _servoed(dynamics: PlanarDynamics, scenario: Scenario, exact: Trajectory, start: Floats) -> Floats:
    """(n, N) link angles [rad] under the scenario's servo with exact encoders, from a state (4N+1,)."""
    arm, servo = exact.arm, scenario.controller
    desired, desired_rate = scenario.desired([joint.name for joint in arm.joints], exact.t)
    before: list[Floats] = []

    def torque(k: int, states: States) -> Floats:
        angle = states.theta if servo.angle == "motor" else states.q
        rate = (angle - before[-1]) / arm.period_s if before else np.zeros_like(angle)
        before.append(angle)
        pull = np.array(servo.kp) * (desired[k] - angle) + np.array(servo.kd) * (desired_rate[k] - rate)
        return np.asarray(servo.gain * pull / arm.gear_ratios, dtype=np.float64)

    steps = substeps(dynamics, exact.q[0], arm.period_s)
    states, _ = replay(dynamics, arm.period_s, start[None], torque, np.zeros((1, arm.n)), len(exact.t), steps)
    return States.of(states[0]).q


def _arcs(dynamics: PlanarDynamics, exact: Trajectory, states: Floats) -> Floats:
    """(A, n, N) link angles [rad] of arcs that begin in true states (cycles, 4N+1), under the true run's torques."""
    arm = exact.arm
    at, cycles = _begins(exact)
    steps = substeps(dynamics, exact.q[0], arm.period_s)
    torques = exact.tau[0][at[:, None] + np.arange(cycles)]
    moved, _ = replay(
        dynamics, arm.period_s, states[at], lambda k, _: torques[:, k], np.zeros((len(at), arm.n)), cycles, steps
    )
    return States.of(moved).q


def _begins(exact: Trajectory) -> tuple[NDArray[np.int64], int]:
    period = exact.arm.period_s
    cycles = round(ARC_S / period) + 1
    return np.arange(0, len(exact.t) - cycles + 1, round(EVERY_S / period)), cycles


def _apart(predicted: Floats, exact: Trajectory) -> list[float]:
    """By how much predictions are off after 1, 2, … cycles: median over the arcs of the joints' rms [rad]."""
    at, cycles = _begins(exact)
    true = exact.q[0][at[:, None] + np.arange(cycles)]
    off = np.sqrt(np.mean((predicted - true) ** 2, axis=-1))
    return np.median(off, axis=0)[1:].tolist()  # type: ignore[no-any-return]
