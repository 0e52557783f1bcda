"""The report pages of results: one HTML file each, with nothing outside it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from zygos.audit.check import ArmCheck
from zygos.audit.page import write_audit_report
from zygos.errors import ZygosError
from zygos.estimation.estimate import Estimation
from zygos.estimation.page import write_estimate_report
from zygos.gap.explanation import Explanation
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.page import write_ground_gap_report
from zygos.gap.page import write_gap_report
from zygos.reference.check import Check
from zygos.reference.page import write_check_report
from zygos.refinement.page import write_refine_report
from zygos.refinement.refine import Refinement
from zygos.report.provenance import Provenance


def _provenance(function: str, runs: Sequence[Path | None]) -> Provenance:
    """The function that gave a result, and the digests of the runs that were read from files."""
    files = [run for run in runs if run is not None and run.is_file()]
    listed = tuple(("run", str(file), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files)
    return Provenance(f"zygos.{function}, called from Python", version("zygos"), listed)


def _explanation(result: Explanation, path: Path) -> None:
    """Write the page of an explained gap."""
    write_gap_report(path, result, _provenance("explain", [record.path for record in result.refit.records]))


def _ground_explanation(result: GroundExplanation, path: Path) -> None:
    """Write the page of an explained gap of an arm on the ground."""
    runs = [run.path for run in (*result.measured, *result.validated)]
    write_ground_gap_report(path, result, _provenance("explain", runs))


def _estimation(result: Estimation, path: Path) -> None:
    """Write the page of an estimate that kept its trace."""
    if not result.watch.traced:
        raise ZygosError("the estimate has no trace to draw; remedy: zygos.estimate(run, trace=True)")
    write_estimate_report(path, result, _provenance("estimate", [result.run.path if result.run else None]))


def _check(result: Check, path: Path) -> None:
    """Write the page of a comparison of C with numpy."""
    write_check_report(path, result, _provenance("check", [result.run.path]))


def _arm_check(result: ArmCheck, path: Path) -> None:
    """Write the page of a run that was compared with its arm file."""
    write_audit_report(path, result.run, result.audit, _provenance("check_arm", [result.run.path]))


def _refinement(result: Refinement, path: Path) -> None:
    """Write the page of a refinement."""
    damage = [text for run in result.runs for text in run.damage]
    write_refine_report(path, result, _provenance("refine", [run.path for run in result.runs]), damage=damage)


WRITERS: dict[type[Any], Callable[[Any, Path], None]] = {
    Explanation: _explanation,
    GroundExplanation: _ground_explanation,
    Estimation: _estimation,
    Check: _check,
    ArmCheck: _arm_check,
    Refinement: _refinement,
}
"""The writer of each kind of result that has a page."""

Reported = Explanation | GroundExplanation | Estimation | Check | ArmCheck | Refinement
"""The kinds of results that have a page."""


def write_report(result: Reported, path: str | Path) -> None:
    """Write the page of a result as one HTML file: of an `Explanation`, `GroundExplanation`, `Estimation`, `Check`,
    `ArmCheck` or `Refinement`.

    Errors: ZygosError if the file cannot be written or an estimate kept no trace, TypeError for results without a page.
    """
    writer = WRITERS.get(type(result))
    if writer is None:
        kinds = ", ".join(kind.__name__ for kind in WRITERS)
        raise TypeError(f"a {type(result).__name__} has no report page; there is one of: {kinds}")
    writer(result, Path(path))
