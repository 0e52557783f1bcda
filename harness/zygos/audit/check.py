"""A run held against its own arm."""

from __future__ import annotations

from collections.abc import Callable

from zygos.audit.auditor import audit
from zygos.audit.findings import Audit
from zygos.audit.traffic import traffic_of
from zygos.can.run import Run


def check_arm(run: Run, *, progress: Callable[[float], None] | None = None) -> Audit:
    """Say whether a run agrees with the description of its arm: signals that are swapped, inverted, scaled, stuck or
    skewed, and the numbers that show it.

    `Audit.ok` is true where nothing is wrong and every signal is confirmed. progress is called now and then with the
    share that is done. Errors: ZygosError where the run has another number of joints than its arm.
    """
    traffic = None if run.frames is None else traffic_of(run.arm, run.frames)
    return audit(run.arm, run.cycles, traffic, progress)
