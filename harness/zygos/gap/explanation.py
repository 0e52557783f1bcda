# SPDX-License-Identifier: MIT
"""Everything that an explained gap consists of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.gap import sentences
from zygos.gap.adopted import Adopted
from zygos.gap.experiment import Experiment
from zygos.gap.findings import Deflection, Finding, Gap, Value
from zygos.gap.record import MeasuredRun
from zygos.gap.search import Search
from zygos.gap.simulated import Simulated
from zygos.gap.study import Study
from zygos.gap.verdicts import Answer, Remark, Verdict, partly
from zygos.gap.whereabouts import Whereabouts
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Explanation:
    """Everything that is known in the end."""

    arm: Arm
    simulation: Model
    verdict: Verdict
    whereabouts: Whereabouts
    refit: Study
    """The simulation's own equations, its values fitted."""
    search: Search | None
    """Where the simulation lacks the joints' flexibility, what is searched is what it lacks beside."""
    findings: tuple[Finding, ...]
    values: tuple[Value, ...]
    deflections: tuple[Deflection, ...]
    experiments: tuple[Experiment, ...]
    gap: Gap | None
    local: Array
    """(runs, balances) rho of each balance by itself, before."""
    adopted: Adopted | None
    """The model that is written; None where there is none."""
    remarks: tuple[Remark, ...]
    validated: tuple[MeasuredRun, ...] = ()
    """The runs that were kept apart."""
    simulated: Simulated | None = None
    """Where the simulation's values come from, if it is known by a run alone."""

    @property
    def model(self) -> Model | None:
        """The model that is written; None where there is none."""
        return None if self.adopted is None else self.adopted.model

    @property
    def records(self) -> tuple[MeasuredRun, ...]:
        """All runs: those that were learned from, then those that were kept apart."""
        return (*self.refit.records, *self.validated)

    @property
    def closed(self) -> Study:
        """The runs with everything that was named."""
        return self.search.after if self.search is not None else self.refit

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
        """Which balances fail and where to look, in words."""
        return sentences.where(self.arm, self.whereabouts)

    @property
    def partly(self) -> str:
        """With an unknown effect, what part of it looks like, in words; empty where it looks like nothing."""
        return sentences.listed(partly(self.verdict))

    @property
    def remedy(self) -> str:
        """What to do where the answer is unknown or cannot tell, in words."""
        nearest = None if self.search is None else self.search.rounds[0][0]
        return sentences.remedy(self.arm, self.verdict, self.whereabouts, self.experiments, nearest)

    @property
    def notes(self) -> tuple[str, ...]:
        """The remarks in words."""
        known = () if self.simulated is None else (self.simulated.sentence,)
        return (*known, *(sentences.remark(one) for one in self.remarks))
