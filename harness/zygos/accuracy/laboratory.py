# SPDX-License-Identifier: MIT
"""A draw of the campaign on the ground: a stored motion with new sensor errors, estimated, and compared with the truth.

The motion is simulated once, with exact sensors and Pinocchio's equations. A draw adds errors to its readings: the
first step of every encoder begins at an angle that is drawn, and torques have white noise.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from zygos.accuracy.idim import idim
from zygos.arm import Arm, load_arm
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.ground.estimate import estimate_ground
from zygos.ground.score import Score, score
from zygos.model.model import Model, load_model
from zygos.runs.cycles import Cycles
from zygos.simulation import plant
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]
Variant = Literal["as declared", "offset", "noise"]
Line = dict[str, Any]

ARMS = ("ur10e", "panda", "lwr4")
"""Folders of examples/laboratory."""
VARIANTS: tuple[Variant, ...] = ("as declared", "offset", "noise")
"""What the torques have beyond what the arm file declares: nothing; a constant in each; white noise, where the arm file
declares none."""
OFFSETS_NM = (0.01, 0.05)
"""Smallest and largest constant of the variant "offset", as reported."""
NOISE_FACTOR = 5.0
"""Noise of the variant "noise" in units of that of the arm files, which is 1 % of the typical torque."""
LEARNED, HELD = "learn", "held"
"""Names of the scenarios of an arm: the motion that is learned from, and the one that is predicted."""


@dataclass(frozen=True)
class Laboratory:
    """An arm of examples/laboratory: what estimators get of it, and the plant."""

    name: str
    folder: Path

    @classmethod
    def of(cls, name: str, examples: Path = Path("examples")) -> Laboratory:
        """The arm of a folder. Errors: ZygosError if it is not there."""
        folder = examples / "laboratory" / name
        if not (folder / "arm.toml").is_file():
            raise ZygosError(
                f"{folder / 'arm.toml'}: no such file; remedy: run inside a checkout, with arms of {', '.join(ARMS)}"
            )
        return cls(name, folder)

    @cached_property
    def arm(self) -> Arm:
        """The arm file."""
        return load_arm(self.folder / "arm.toml")

    @property
    def truth(self) -> Model:
        """The plant."""
        return load_model(self.folder / "model.toml")

    def stored(self, motion: str, store: Path, progress: Callable[[float], None] | None = None) -> Path:
        """The exact readings of a motion, simulated unless the store has them: (n, N) theta [rad] and tau [Nm]."""
        files = [self.folder / name for name in ("arm.toml", "model.toml", f"{motion}.toml")]
        digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]
        path = store / f"{self.name}-{motion}-{digest}.npz"
        if not path.is_file():
            exact = plant.simulate(
                self.arm, self.truth, load_scenario(files[-1]), engine="pinocchio", noise=False, progress=progress
            ).cycles()
            store.mkdir(parents=True, exist_ok=True)
            partial = path.with_suffix(".partial.npz")
            np.savez(partial, theta=exact.theta, tau=exact.tau)
            partial.replace(path)
        return path


def recorded(arm: Arm, exact: Path, rng: np.random.Generator, variant: Variant) -> Run:
    """A run with new errors, as the frames of a bus carry it."""
    with np.load(exact) as readings:
        theta, tau = readings["theta"], readings["tau"]
    n = len(theta)
    step = np.array([joint.motor_encoder.quantum_rad for joint in arm.joints])
    begin = step * rng.uniform(size=arm.n)
    angles = step * np.rint((theta + begin) / step) - begin
    sigma = np.array([joint.torque_sigma for joint in arm.joints])
    noise = sigma * rng.standard_normal(tau.shape)
    known = arm
    if variant == "noise":
        noise = NOISE_FACTOR * noise
        known = replace(arm, joints=tuple(replace(joint, torque_sigma=0.0) for joint in arm.joints))
    constant = np.zeros(arm.n)
    if variant == "offset":
        constant = rng.uniform(*OFFSETS_NM, size=arm.n) * rng.choice([-1.0, 1.0], size=arm.n)
    cycles = Cycles(
        sync=np.arange(n, dtype=np.uint64),
        q=angles,
        theta=angles,
        tau=tau + noise + constant,
        omega=np.zeros((n, 3)),
        flags=np.zeros(n, dtype=np.uint32),
    )
    return Run.of_cycles(known, cycles)


@dataclass(frozen=True)
class Draw:
    """Job for one process."""

    laboratory: Laboratory
    variant: Variant
    number: int
    learned: Path
    held: Path
    """Files of exact readings."""
    code: str
    """Fingerprint of the code that created the job."""

    @property
    def key(self) -> str:
        """Key of the result: it depends on everything that is computed, including the code."""
        said = (self.laboratory.name, self.variant, self.number, self.learned.name, self.held.name, self.code)
        return hashlib.sha256(repr(said).encode()).hexdigest()[:16]

    def run(self) -> Line:
        """Estimate, predict the other motion, and compare both with the plant."""
        with threadpool_limits(1):
            own = self.laboratory
            rng = np.random.default_rng([self.number, VARIANTS.index(self.variant)])
            learned, held = (recorded(own.arm, path, rng, self.variant) for path in (self.learned, self.held))
            found = estimate_ground([learned], validate=[held])
            predicted = found.validated[0] if found.validated else None
            batch, floor = None, None
            if predicted is not None and predicted.cutoff_hz is not None:
                batch = idim([learned], found.effects, predicted.cutoff_hz).score(held)
            truth = own.truth
            if predicted is not None:
                floor = score(held, truth, cutoff=predicted.cutoff_hz)
        values = dict(zip(own.arm.parameter_names, truth.base_values(own.arm).tolist(), strict=True))
        values |= {effect.column(own.arm): effect.value for effect in truth.effects}
        return {
            "arm": own.name,
            "variant": self.variant,
            "number": self.number,
            "validity": found.validity,
            "reason": found.reason,
            "names": list(found.names),
            "true": [values[name] for name in found.names],
            "value": _digits(found.solution.value),
            "half95": _digits(found.solution.half(0.95)),
            "half999": _digits(found.solution.half(0.999)),
            "determined": found.determined.tolist(),
            "torque_sigma": _digits(found.torque_sigma),
            "span_s": found.span_s,
            "cutoff_hz": predicted.cutoff_hz if predicted else None,
            "error_nm": _errors(predicted),
            "idim_nm": _errors(batch),
            "floor_nm": _errors(floor),
            "measured_nm": [joint.measured_nm for joint in predicted.joints] if predicted else None,
        }


def _errors(found: Score | None) -> list[float] | None:
    return None if found is None else [joint.error_nm for joint in found.joints]


def _digits(values: Floats) -> list[float]:
    return [float(f"{x:.9g}") for x in values.tolist()]
