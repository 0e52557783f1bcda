# SPDX-License-Identifier: MIT
"""The bound of a case: the smallest errors that any unbiased estimator can have from its frames."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from zygos.accuracy.cases import Case
from zygos.errors import ZygosError
from zygos.refinement.bound import bound


@dataclass(frozen=True)
class Limit:
    """Job for one process. The bound belongs to the motion of seed 0; those of other seeds differ little."""

    case: Case
    code: str

    @property
    def key(self) -> str:
        """Key of the job, as for a cell."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def run(self) -> dict[str, Any]:
        """Standard deviations of the parameters in per cent of their values, or why there are none."""
        case = self.case
        try:
            with threadpool_limits(1):
                (found,) = bound(case.plant, case.model, case.scenario)
        except ZygosError as error:
            return {"limit": case.name, "percent": None, "why": str(error)}
        return {"limit": case.name, "percent": (100.0 * found.sigma / abs(found.value)).tolist(), "why": ""}
