"""A cell: some seeds of one case, simulated, sent as CAN frames and put to every estimator.

A seed numbers the errors of its sensors. Intervals are tried on further draws of those errors over the stored motion;
draw d of a seed has the number seed + d * 1,000,000, and draw 0 is what the servo saw, too.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import zygos
from zygos.accuracy.cases import BLOCK, Case
from zygos.accuracy.estimators import ESTIMATORS, EstimatorResult, Told
from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import encode
from zygos.simulation.plant import Trajectory, record, simulate
from zygos.simulation.sensors import draw_noise

Floats = NDArray[np.float64]

STREAM = 1_000_000
_SYNC = 0x080
_FACES = ("cli", "demo", "report", "view")
"""Sub-packages that no answer depends on."""
_MAKERS = ("cases.py", "cell.py", "estimators.py", "figure4.py", "mission.py")


@cache
def fingerprint() -> str:
    """Digest of all code that a cell's answers can depend on."""
    package = Path(zygos.__file__).parent
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*")):
        if path.suffix not in {".py", ".so"} or path.relative_to(package).parts[0] in _FACES:
            continue
        if path.parent == here and path.name not in _MAKERS:
            continue
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Cell:
    """Work for one process."""

    case: Case
    seeds: tuple[int, ...]
    draws: int
    """Of each seed's sensor errors."""
    code: str
    """Fingerprint of whoever ordered it."""

    @property
    def key(self) -> str:
        """Names what is computed, down to the code that does it."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def run(self) -> dict[str, Any]:
        """Simulate, encode, estimate. Errors: ZygosError where the code here is not that of whoever asks."""
        if fingerprint() != self.code:
            raise ZygosError(
                "a worker runs another zygos; remedy: install the same build on every machine of the cluster"
            )
        case = self.case
        with threadpool_limits(1):
            begin = time.perf_counter()
            motions = _motions(case, self.seeds[:: case.share])
            simulated = time.perf_counter()
            answers = {one.name: _Column() for one in ESTIMATORS if one.fits(case.arm)}
            told = Told(case.scenario.angular_momentum_nms, case.rest_s)
            for place, seed in enumerate(self.seeds):
                trajectory, index = motions[place // case.share]
                for draw in range(self.draws):
                    arm, frames = sensed(case, trajectory, index, seed + draw * STREAM)
                    for estimator in ESTIMATORS:
                        if estimator.name in answers and (draw == 0 or estimator.redrawn):
                            answers[estimator.name].add(seed, draw, estimator.estimate(arm, frames, told))
        return {
            "case": case.name,
            "seeds": list(self.seeds),
            "answers": {name: column.content(case.arm.spatial) for name, column in answers.items()},
            "simulate_s": round(simulated - begin, 2),
            "estimate_s": round(time.perf_counter() - simulated, 2),
        }


def cells(cases: Sequence[Case], seeds: int, draws: int) -> list[Cell]:
    """The work of a campaign with so many seeds and, of each case, at least so many draws."""
    each = max(1, -(-draws // seeds))
    return [
        Cell(case, tuple(range(first, min(first + BLOCK, seeds))), each, fingerprint())
        for case in cases
        for first in range(0, seeds, BLOCK)
    ]


def _motions(case: Case, seeds: Sequence[int]) -> list[tuple[Trajectory, int]]:
    """A trajectory for each seed, and its place therein."""
    if case.scenario.encoder_noise == "gaussian":
        together = simulate(case.plant, case.model, case.scenario, seeds=seeds, engine=case.engine, noise=True)
        return [(together, index) for index in range(len(seeds))]
    # encoders that round err by where their codes begin
    alone = [
        simulate(
            _with_zeros(case.plant, _codes(case, seed)), case.model, case.scenario, seeds=[seed], engine=case.engine
        )
        for seed in seeds
    ]
    return [(one, 0) for one in alone]


def _codes(case: Case, number: int) -> Floats:
    """(2, N) where the codes of link and motor encoders begin, rad: anywhere within a quantum, and known."""
    quanta = [
        [j.link_encoder.quantum_rad for j in case.plant.joints],
        [j.motor_encoder.quantum_rad for j in case.plant.joints],
    ]
    codes: Floats = np.random.default_rng([number, 1]).uniform(-0.5, 0.5, (2, case.plant.n)) * np.array(quanta)
    return codes


def _with_zeros(arm: Arm, zeros: Floats) -> Arm:
    """The arm with zeros (2, N), rad, added to those of link and motor encoders."""
    joints = tuple(
        replace(
            joint,
            link_encoder=replace(joint.link_encoder, zero_rad=joint.link_encoder.zero_rad + float(link)),
            motor_encoder=replace(joint.motor_encoder, zero_rad=joint.motor_encoder.zero_rad + float(motor)),
        )
        for joint, link, motor in zip(arm.joints, *zeros, strict=True)
    )
    return replace(arm, joints=joints)


def sensed(case: Case, trajectory: Trajectory, index: int, number: int) -> tuple[Arm, NDArray[Any]]:
    """The arm file and the CAN frames of one motion, read by sensors whose errors have that number."""
    told, plant = case.arm, case.plant
    cycles = len(trajectory.t)
    if case.scenario.encoder_noise == "quantised":
        codes = _codes(case, number)
        told, plant = _with_zeros(told, codes), _with_zeros(plant, codes)
    if case.zeros_rad:
        signs = np.random.default_rng([number, 2]).choice([-1.0, 1.0], (2, plant.n))
        plant = _with_zeros(plant, case.zeros_rad * signs)
    noise = draw_noise(plant, cycles, [number], case.scenario.encoder_noise)
    alone = _one(trajectory, index)
    frames = encode(told, record(replace(alone, arm=plant, noise=noise)))
    return told, _lose(case, frames, number) if case.lost else frames


def _one(trajectory: Trajectory, index: int) -> Trajectory:
    """The run of one seed by itself."""
    of_seeds = (
        "attitude",
        "omega0",
        "q",
        "qd",
        "theta",
        "thetad",
        "tau",
        "slip2",
        "q_latched",
        "theta_latched",
        "omega0_latched",
    )
    here = slice(index, index + 1)
    return replace(
        trajectory,
        seeds=trajectory.seeds[here],
        **{name: getattr(trajectory, name)[here] for name in of_seeds},
    )


def _lose(case: Case, frames: NDArray[Any], number: int) -> NDArray[Any]:
    """The frames without those of one joint, any, in some of the cycles."""
    rng = np.random.default_rng([number, 3])
    cycle = np.cumsum(frames["id"] == _SYNC)
    node = np.array([joint.node for joint in case.arm.joints])[rng.integers(case.arm.n, size=cycle[-1] + 1)]
    unlucky = rng.random(cycle[-1] + 1) < case.lost
    own = (frames["id"] == 0x180 + node[cycle]) | (frames["id"] == 0x280 + node[cycle])
    kept: NDArray[Any] = frames[~(own & unlucky[cycle])]
    return kept


class _Column:
    """The answers of one estimator."""

    def __init__(self) -> None:
        self.seeds: list[int] = []
        self.draws: list[int] = []
        self.answers: list[EstimatorResult] = []

    def add(self, seed: int, draw: int, answer: EstimatorResult) -> None:
        self.seeds.append(seed)
        self.draws.append(draw)
        self.answers.append(answer)

    def content(self, spatial: bool) -> dict[str, Any]:
        """As a line holds it; solutions only where something is made of them."""
        out: dict[str, Any] = {
            "seed": self.seeds,
            "draw": self.draws,
            "validity": [answer.validity for answer in self.answers],
            "reason": [answer.reason for answer in self.answers],
            "value": [_digits(answer.value) for answer in self.answers],
            "half95": [_digits(answer.half95) for answer in self.answers],
            "sigma": [_digits(answer.sigma) for answer in self.answers],
        }
        if spatial:
            out["solution"] = [
                _digits(answer.solution) if draw == 0 else None
                for answer, draw in zip(self.answers, self.draws, strict=True)
            ]
        return out


def _digits(values: Floats | None) -> list[float | None] | None:
    """More digits than an estimate has."""
    if values is None:
        return None
    return [float(f"{x:.9g}") if np.isfinite(x) else None for x in values.tolist()]
