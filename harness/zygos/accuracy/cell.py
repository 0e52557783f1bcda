# SPDX-License-Identifier: MIT
"""A cell: some seeds of one case, simulated, sent as CAN frames and given to every estimator.

A seed is the number of a set of sensor errors. The coverage of intervals is measured with further draws of those errors
on the stored motion; draw d of a seed has the number seed + d * 1,000,000. The servo also reads the sensors of draw 0.
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

from zygos.accuracy.cases import BLOCK, Case
from zygos.accuracy.estimators import ESTIMATORS, EstimatorResult, Prior
from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import encode
from zygos.simulation.plant import Trajectory, record, simulate
from zygos.simulation.sensors import draw_noise

Floats = NDArray[np.float64]

STREAM = 1_000_000
_SYNC = 0x080
_FACES = ("cli", "demo", "report", "view")
"""Sub-packages on which no answer depends."""
_MAKERS = ("cases.py", "cell.py", "estimators.py", "figure4.py", "idim.py", "laboratory.py", "limit.py", "mission.py")


@cache
def fingerprint() -> str:
    """Digest of all code on which a cell's answers can depend."""
    package = Path(__file__).parents[1]
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
    """Job for one process."""

    case: Case
    seeds: tuple[int, ...]
    draws: int
    """Number of draws of sensor errors for each seed."""
    code: str
    """Fingerprint of the code that created the job."""

    @property
    def key(self) -> str:
        """Key of the result: it depends on everything that is computed, including the code."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def run(self) -> dict[str, Any]:
        """Simulate, encode, estimate. Errors: ZygosError if the code here differs from that which created the job."""
        if fingerprint() != self.code:
            raise ZygosError(
                "a worker runs a different version of zygos; remedy: install the same build on every machine"
            )
        case = self.case
        with threadpool_limits(1):
            begin = time.perf_counter()
            motions = _motions(case, self.seeds[:: case.share])
            simulated = time.perf_counter()
            answers = {one.name: _Column() for one in ESTIMATORS if one.fits(case.arm)}
            prior = Prior(case.scenario.angular_momentum_nms, case.rest_s)
            for place, seed in enumerate(self.seeds):
                trajectory, index = motions[place // case.share]
                for draw in range(self.draws):
                    arm, frames = sensed(case, trajectory, index, seed + draw * STREAM)
                    for estimator in ESTIMATORS:
                        if estimator.name in answers and estimator.takes(seed, draw):
                            answers[estimator.name].add(seed, draw, estimator.estimate(arm, frames, prior))
        return {
            "case": case.name,
            "seeds": list(self.seeds),
            "answers": {name: column.content(case.arm.spatial) for name, column in answers.items()},
            "simulate_s": round(simulated - begin, 2),
            "estimate_s": round(time.perf_counter() - simulated, 2),
        }


def cells(cases: Sequence[Case], seeds: int, draws: int) -> list[Cell]:
    """The cells of a campaign with that many seeds and at least that many draws for each case."""
    each = max(1, -(-draws // seeds))
    return [
        Cell(case, tuple(range(first, min(first + BLOCK, seeds))), each, fingerprint())
        for case in cases
        for first in range(0, seeds, BLOCK)
    ]


def _motions(case: Case, seeds: Sequence[int]) -> list[tuple[Trajectory, int]]:
    """A trajectory for each seed, and the seed's index in it."""
    if case.scenario.encoder_noise == "gaussian":
        together = simulate(case.plant, case.model, case.scenario, seeds=seeds, engine=case.engine, noise=True)
        return [(together, index) for index in range(len(seeds))]
    # the error of an encoder that rounds depends on where its codes begin
    alone = [
        simulate(
            _with_zeros(case.plant, _codes(case, seed)), case.model, case.scenario, seeds=[seed], engine=case.engine
        )
        for seed in seeds
    ]
    return [(one, 0) for one in alone]


def _codes(case: Case, number: int) -> Floats:
    """(2, N) start of the codes of link and motor encoders, rad: drawn within a quantum, and known to the
    estimators."""
    quanta = [
        [j.link_encoder.quantum_rad for j in case.plant.joints],
        [j.motor_encoder.quantum_rad for j in case.plant.joints],
    ]
    codes: Floats = np.random.default_rng([number, 1]).uniform(-0.5, 0.5, (2, case.plant.n)) * np.array(quanta)
    return codes


def _with_zeros(arm: Arm, zeros: Floats) -> Arm:
    """The arm with `zeros` (2, N), rad, added to the zeros of link and motor encoders."""
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
    """The arm file and the CAN frames of one motion; `number` selects the sensor errors."""
    stated, plant = case.arm, case.plant
    cycles = len(trajectory.t)
    if case.scenario.encoder_noise == "quantised":
        codes = _codes(case, number)
        stated, plant = _with_zeros(stated, codes), _with_zeros(plant, codes)
    if case.zeros_rad:
        signs = np.random.default_rng([number, 2]).choice([-1.0, 1.0], (2, plant.n))
        plant = _with_zeros(plant, case.zeros_rad * signs)
    noise = draw_noise(plant, cycles, [number], case.scenario.encoder_noise)
    alone = _one(trajectory, index)
    frames = encode(stated, record(replace(alone, arm=plant, noise=noise)))
    return stated, _lose(case, frames, number) if case.lost else frames


def _one(trajectory: Trajectory, index: int) -> Trajectory:
    """The run of one seed."""
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
    """The frames without those of one randomly chosen joint in some of the cycles."""
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
        """Content of a line of the file; solutions are included only if they are evaluated later."""
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
    """Values rounded to more digits than are significant in an estimate."""
    if values is None:
        return None
    return [float(f"{x:.9g}") if np.isfinite(x) else None for x in values.tolist()]
