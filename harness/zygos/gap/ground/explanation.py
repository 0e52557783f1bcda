# SPDX-License-Identifier: MIT
"""Everything that an explained gap of an arm on the ground consists of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.gap.adopted import Adopted, Check
from zygos.gap.findings import Finding, Value
from zygos.gap.ground import sentences
from zygos.gap.ground.predictions import Prediction, Stage, run_name, share_of_energy
from zygos.gap.ground.search import Search
from zygos.gap.simulated import Simulated
from zygos.gap.verdicts import Answer, Verdict, partly
from zygos.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GroundGap:
    """Error of the energy predicted over one second, as share of the work, over all untouched runs."""

    predictions: tuple[Prediction, ...]
    stages: tuple[Stage, ...]
    """The models that predict: as delivered, refit, plain estimate, and the one that was found."""

    def closed_by(self, stage: Stage) -> GroundGap:
        """With another model as the one that was found."""
        return GroundGap(tuple(one.closed_by(stage) for one in self.predictions), (*self.stages[:3], stage))

    def comparisons(self) -> tuple[Check, ...]:
        """The model found beside the best baseline, on each run."""
        return tuple(check for one in self.predictions for check in one.comparisons())

    def plain_beside_delivered(self, *, alone: bool) -> tuple[Check, ...]:
        """The plain estimate beside the model as delivered, on each run, by the work or the torques that it predicts
        wrongly. alone: whether it has to be an answer by itself, because nothing else is known."""
        most = limits.PLAIN_LEAVES.value if alone else limits.NOT_WORSE.value
        checks = []
        for one in self.predictions:
            work = one.plain.arm_energy_share / one.delivered.arm_energy_share
            torques = one.plain.share / one.delivered.share
            name = f"the error of the plain estimate over that of the model as delivered in {run_name(one.run)}"
            checks.append(Check(name, min(work, torques), "1", highest=most))
            if alone:
                name = f"the share of {run_name(one.run)} that the plain estimate predicts wrongly"
                wrong = min(one.plain.arm_energy_share, one.plain.share)
                checks.append(Check(name, wrong, "1", highest=limits.PLAIN_WRONG.value))
        return tuple(checks)

    @property
    def delivered(self) -> float:
        """By the simulation as it came."""
        return share_of_energy(self.predictions, "as delivered")

    @property
    def refit(self) -> float:
        """By its own equations, values fitted."""
        return share_of_energy(self.predictions, "refit")

    @property
    def plain(self) -> float:
        """By the estimate of `zygos estimate`."""
        return share_of_energy(self.predictions, "plain estimate")

    @property
    def closed(self) -> float:
        """With what was found."""
        return share_of_energy(self.predictions, "closed")

    @property
    def floor(self) -> float:
        """That noise alone leaves."""
        return share_of_energy(self.predictions, "floor")


@dataclass(frozen=True)
class JointRest:
    """The residual of one joint's increments on the measured runs, as mean torque; R runs."""

    joint: str
    delivered: tuple[float, ...]
    """(R,) Nm."""
    refit: tuple[float, ...]
    closed: tuple[float, ...]
    floor: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class GroundExplanation:
    """What is known in the end of an arm with a fixed base and rigid joints."""

    arm: Arm
    simulation: Model
    measured: tuple[Run, ...]
    verdict: Verdict
    findings: tuple[Finding, ...]
    values: tuple[Value, ...]
    search: Search
    joints: tuple[JointRest, ...]
    gap: GroundGap | None
    span_s: float
    """Length of the increments, s."""
    adopted: Adopted | None
    """The model that is written; None where there is none."""
    remarks: tuple[str, ...]
    """What was noticed beside, in sentences."""
    likely: Model | None = None
    """The model with what was found, whether it is to be adopted or not; None where nothing is known."""
    simulated: Simulated | None = None
    """Where the simulation's values come from, if it is known by a run alone."""

    @property
    def model(self) -> Model | None:
        """The model that is written; None where there is none."""
        return None if self.adopted is None else self.adopted.model

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know beside, in sentences."""
        return self.remarks if self.simulated is None else (self.simulated.sentence, *self.remarks)

    @property
    def answer(self) -> Answer:
        """The kind of verdict."""
        return self.verdict.answer

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return sentences.verdict(self.arm, self.verdict)

    @property
    def where(self) -> str:
        """At which joints the simulation fails, in words."""
        return sentences.where([(one.joint, _rms(one.refit), _rms(one.closed), _rms(one.floor)) for one in self.joints])

    @property
    def partly(self) -> str:
        """With an unknown effect, what part of it looks like, in words; empty where it looks like nothing."""
        return sentences.listed(self.arm, partly(self.verdict))

    @property
    def remedy(self) -> str:
        """What to do where the answer is unknown or cannot tell, in words."""
        return sentences.remedy(self.arm, self.verdict, self.search)

    @property
    def validated(self) -> tuple[Run, ...]:
        """The runs that were kept apart."""
        return () if self.gap is None else tuple(one.run for one in self.gap.predictions)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
