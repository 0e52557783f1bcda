# SPDX-License-Identifier: MIT
"""Which motion would tell two effects apart that these runs cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import Undecided, ZygosError
from zygos.gap.balances import accumulate, balance_rows
from zygos.gap.fit import fit
from zygos.gap.record import followed
from zygos.gap.study import Study, base_values
from zygos.gap.twin import measure, retrace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Experiment:
    """A motion, and how well it would tell."""

    speed: float
    """Of the first run's motion."""
    amplitude: float
    """Of the first run's motion, about its mean posture."""
    z: float
    """Standard deviations by which the named effect would stand out beside the other; these runs: `now`."""
    now: float

    @property
    def tells(self) -> bool:
        """Whether it would tell the two apart."""
        return self.z > limits.NAMED_Z.value


def propose(study: Study, name: str, other: str) -> tuple[Experiment, ...]:
    """Variants of the first run's motion, best first, by how well they tell two effects of a study apart."""
    both = replace(study.hypothesis, effects=(*study.hypothesis.effects, other))
    record = study.records[0]
    arm, dynamics = record.arm, study.dynamics()
    values, uncentred = base_values(dynamics, study.layout), study.hypothesis.uncentred
    size = abs(float(study.value[study.hypothesis.names.index(name)]))

    def stands_out(speed: float, amplitude: float) -> float:
        twin = retrace(dynamics, record, speed, amplitude)
        seen = [measure(twin, k) for k in range(limits.MOTION_DRAWS.value)]
        sums = [accumulate(balance_rows(study.layout, one, values), followed(arm, one), uncentred) for one in seen]
        found = np.array([float(fit(both, [one], study.weight).of(name)) for one in sums])
        return size / float(found.std(ddof=1))

    out: list[Experiment] = []
    try:
        now = stands_out(1.0, 1.0)
    except Undecided:
        return ()
    for speed, amplitude in limits.VARIANTS.value:
        try:
            out.append(Experiment(speed, amplitude, stands_out(speed, amplitude), now))
        except (Undecided, ZygosError):
            continue
    return tuple(sorted(out, key=lambda one: -one.z))
