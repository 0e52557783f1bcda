# SPDX-License-Identifier: MIT
"""The answer of `zygos predict`: its sections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zygos.files.output import number
from zygos.gap.predict import Ahead, Prediction
from zygos.ground.sections import READING, run_names, score_sections
from zygos.report.answer import Answer, Section, Text, section, sections, table

_AHEAD = (
    "Half a second ahead",
    "The state is fitted to half a second of readings with the model, and the half second behind it is predicted under "
    "the measured torques, again and again. The error is weighted with the covariance that the noise of all sensors "
    "gives it, so that 1 is noise alone.",
)


def answer_of(predictions: Sequence[Prediction], *, draw: bool = False) -> Answer:
    """The answer of predictions of one or several runs. draw: with charts of the torques."""
    scores = [one.torques for one in predictions]
    parts, drawn = score_sections(scores, draw=draw)
    shares = [one.share for one in scores if np.isfinite(one.share)]
    share = number(100 * float(np.sqrt(np.mean(np.square(shares)))), 3) if shares else "–"
    ahead = [one.ahead for one in predictions]
    seen = [one.median for one in ahead if one is not None]
    lead = [
        Text("Root mean square over joints and runs, without a constant offset of each torque in each run.", "lead")
    ]
    if seen:
        listed = ", ".join(f"{x:.3g}" for x in seen)
        lead.append(
            Text(f"Half a second ahead the motion errs by {listed} σ in the median; near 1 only noise is left.")
        )
    unseen = [one.reason for one in predictions if one.reason]
    lead += [Text(f"Not predicted half a second ahead: {text}.", "note") for text in unseen]
    names = run_names([score.run.path for score in scores])
    return Answer(
        about="measured and predicted torques",
        arm=scores[0].run.arm.name,
        verdict="prediction",
        tone="differ",
        sentence=f"the model {scores[0].model} leaves {share} % of the torques"
        if shares
        else f"no torque is large enough to say something of {scores[0].model}",
        lead=tuple(lead),
        reading=(*READING, *((_AHEAD,) if seen else ())),
        sections=sections(
            *parts,
            *(_ahead(k, name, one) for k, (name, one) in enumerate(zip(names, ahead, strict=True)) if one is not None),
        ),
        drawn=drawn,
    )


def _ahead(k: int, name: str, ahead: Ahead) -> Section | None:
    """Error and floor of each signal."""
    rows = zip(ahead.signals, ahead.error.tolist(), ahead.floor.tolist(), ahead.units, strict=True)
    return section(
        f"ahead-{k + 1}",
        f"{name}, half a second ahead",
        Text(
            f"{len(ahead.distance)} stretches: {ahead.median:.3g} σ in the median, 90th percentile {ahead.tenth:.3g} σ."
        ),
        table(
            "signal | error::main | floor | unit::unit",
            [(signal, number(error, 3), number(floor, 3), unit) for signal, error, floor, unit in rows],
        ),
    )
