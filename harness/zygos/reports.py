# SPDX-License-Identifier: MIT
"""The report pages of results: one HTML file each, with nothing outside it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from zygos.audit import sections as audit_sections
from zygos.audit.check import ArmCheck
from zygos.errors import ZygosError
from zygos.estimation import sections as estimation_sections
from zygos.estimation.estimate import Estimation
from zygos.gap import sections
from zygos.gap.explanation import Explanation
from zygos.gap.ground import sections as ground_sections
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.predict import Prediction
from zygos.gap.prediction import answer_of as prediction_answer
from zygos.ground.estimate import GroundEstimate
from zygos.ground.sections import estimate_answer
from zygos.reference import sections as reference_sections
from zygos.reference.check import Check
from zygos.refinement import sections as refinement_sections
from zygos.refinement.refine import Refinement
from zygos.report.answer import Answer
from zygos.report.html import write_page
from zygos.report.provenance import Provenance


def _provenance(function: str, runs: Sequence[Path | None]) -> Provenance:
    """The function that gave a result, and the digests of the runs that were read from files."""
    files = [run for run in runs if run is not None and run.is_file()]
    listed = tuple(("run", str(file), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files)
    return Provenance(f"zygos.{function}, called from Python", version("zygos"), listed)


def _of_explanation(result: Explanation) -> tuple[Answer, Provenance]:
    return sections.answer_of(result, draw=True), _provenance("explain", [record.path for record in result.records])


def _of_ground_explanation(result: GroundExplanation) -> tuple[Answer, Provenance]:
    runs = [run.path for run in (*result.measured, *result.validated)]
    return ground_sections.answer_of(result, draw=True), _provenance("explain", runs)


def _of_estimation(result: Estimation) -> tuple[Answer, Provenance]:
    if not result.watch.traced:
        raise ZygosError("the estimate has no trace to draw; remedy: zygos.estimate(run, trace=True)")
    runs = [result.run.path if result.run else None]
    return estimation_sections.answer_of(result, draw=True), _provenance("estimate", runs)


def _of_ground_estimate(result: GroundEstimate) -> tuple[Answer, Provenance]:
    return estimate_answer(result, draw=True), _provenance("estimate_ground", [run.path for run in result.runs])


def _of_prediction(result: Prediction) -> tuple[Answer, Provenance]:
    return prediction_answer([result], draw=True), _provenance("predict", [result.torques.run.path])


def _of_check(result: Check) -> tuple[Answer, Provenance]:
    return reference_sections.answer_of(result, draw=True), _provenance("check", [result.run.path])


def _of_arm_check(result: ArmCheck) -> tuple[Answer, Provenance]:
    return audit_sections.answer_of(result.run, result.audit, draw=True), _provenance("check_arm", [result.run.path])


def _of_refinement(result: Refinement) -> tuple[Answer, Provenance]:
    damage = [text for run in result.runs for text in run.damage]
    runs = [run.path for run in result.runs]
    return refinement_sections.answer_of(result, damage=damage, draw=True), _provenance("refine", runs)


ANSWERS: dict[type[Any], Callable[[Any], tuple[Answer, Provenance]]] = {
    Explanation: _of_explanation,
    GroundExplanation: _of_ground_explanation,
    Estimation: _of_estimation,
    GroundEstimate: _of_ground_estimate,
    Prediction: _of_prediction,
    Check: _of_check,
    ArmCheck: _of_arm_check,
    Refinement: _of_refinement,
}
"""The answer of each kind of result that has a page, with its charts, and what it was made from."""

Reported = Explanation | GroundExplanation | Estimation | GroundEstimate | Prediction | Check | ArmCheck | Refinement
"""The kinds of results that have a page."""


def write_report(result: Reported, path: str | Path) -> None:
    """Write the page of a result as one HTML file: of an `Explanation`, `GroundExplanation`, `Estimation`,
    `GroundEstimate`, `Prediction`, `Check`, `ArmCheck` or `Refinement`.

    Errors: ZygosError if the file cannot be written or an estimate kept no trace, TypeError for results without a page.
    """
    build = ANSWERS.get(type(result))
    if build is None:
        kinds = ", ".join(kind.__name__ for kind in ANSWERS)
        raise TypeError(f"a {type(result).__name__} has no report page; there is one of: {kinds}")
    write_page(Path(path), *build(result))
