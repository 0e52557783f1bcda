"""The end of `zygos estimate` and `zygos listen`: table, model file, JSON, and what is undecided."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zygos.cli.shared import warn
from zygos.errors import Undecided
from zygos.estimation.answer import learned, report_estimate
from zygos.estimation.remedies import measured, remedy
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_change, about_left_out, about_noise, losses
from zygos.files.output import (
    counted,
    named,
    number,
    quiet,
    ratio,
    say,
    table,
    write_json,
)
from zygos.model.model import Model, Quantity, save_model
from zygos.native.flight import Estimate
from zygos.report.provenance import Provenance


def finish_estimate(
    result: Estimate,
    watch: Watch,
    out: Path,
    prior: Model | None,
    json: str | None,
    heading: Mapping[str, Any],
    report: tuple[Path, Provenance] | None = None,
) -> None:
    """Print the table, write the model, say that the arm changed and what is undecided.

    report: the page to write, and what the answer was made from; the watch must have kept its trace then.
    """
    flight, drift = watch.flight, watch.look()
    found = {
        name: Quantity(float(value), float(sigma), "zygos", unit)
        for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
        if np.isfinite(value)
    }
    known = (prior.base_parameters(flight.arm) if prior is not None else {}) | found
    quantities = {name: known[name] for name in flight.arm.parameter_names if name in known}
    given = prior.effects if prior is not None else ()
    # an offset that only the arm file asked for, and the run is silent on, is none
    asked = (one for one in flight.effects if one not in given and one.column(flight.arm) in found)
    effects = tuple(learned(effect, found.get(effect.column(flight.arm))) for effect in (*given, *asked))
    if not quiet(out, json, report[0] if report else None):
        rows = [
            (name, unit, number(value), number(float(f"{half95:.2g}")), number(100 * ratio(half95, abs(value)), 2))
            for name, unit, value, half95 in zip(result.names, result.units, result.value, result.half95, strict=True)
        ]
        table(("name", "unit", "estimate", "±95 %", "in %"), rows)
        say(
            f"arm {flight.arm.name} · {counted(flight.counts['cycles'], 'cycle')} · {losses(flight)} · "
            f"{counted(result.accepted, 'instant')} accepted, {result.refused:,} refused · "
            f"{counted(result.arcs, 'arc')}, {flight.counts['arcs_dropped']:,} dropped, "
            f"{result.left_out[0]:,} left out · "
            f"{np.isfinite(result.value).sum()} of {counted(len(result.names), 'parameter')} · {result.validity}"
            + (" · door: cycle" if heading["door"] == "cycle" else "")
        )
        seen = [f"{name} {count:,}" for name, count in flight.faults.items() if count]
        if seen:
            say("faults: " + ", ".join(seen))
        if left_out := about_left_out(result, watch):
            say(left_out)
        if noise := about_noise(result):
            say(noise)
    if drift and drift.contradicting:
        warn([about_change(result, drift, flight.arm)])
    where = "nothing written" if result.validity == "refused" else f"{named(out)} written"
    number_of = advice = ""
    if result.validity != "valid":
        number_of = measured(result, flight)
        changed = "see the warning: the arm changed" if drift and drift.changed else ""
        advice = changed or remedy(result, flight, watch.known)
    try:
        if result.validity != "refused":
            save_model(Model(name=flight.arm.name, parameters=quantities, effects=effects), out)
        if report is not None:
            from zygos.estimation.page import Outcome, write_estimate_report  # noqa: PLC0415  (only a report needs charts)

            page, source = report
            outcome = Outcome(number_of, advice, where)
            write_estimate_report(page, result, watch, drift, outcome, heading.get("damage") or (), source)
    finally:
        if json:
            write_json(json, report_estimate(result, watch, drift, heading))
    if result.validity != "valid":
        raise Undecided(
            f"{result.validity}: {result.reason}{f': {number_of}' if number_of else ''} ({where}); remedy: {advice}"
        )
