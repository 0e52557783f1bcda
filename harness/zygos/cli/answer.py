"""The end of `zygos estimate` and `zygos listen`: table, model file, JSON, and messages."""

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


def finish_estimate(
    result: Estimate, watch: Watch, out: Path, prior: Model | None, json: str | None, heading: Mapping[str, Any]
) -> None:
    """Print the table, write the model, report a change of the arm, and raise Undecided if the estimate is not
    valid."""
    flight, drift = watch.flight, watch.look()
    found = {
        name: Quantity(float(value), float(sigma), "zygos", unit)
        for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
        if np.isfinite(value)
    }
    known = (prior.base_parameters(flight.arm) if prior is not None else {}) | found
    quantities = {name: known[name] for name in flight.arm.parameter_names if name in known}
    given = prior.effects if prior is not None else ()
    # an offset that is estimated only because of the arm file is left out if the run does not determine it
    asked = (one for one in flight.effects if one not in given and one.column(flight.arm) in found)
    effects = tuple(learned(effect, found.get(effect.column(flight.arm))) for effect in (*given, *asked))
    if not quiet(out, json):
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
            + (" · input: table of cycles" if heading["door"] == "cycle" else "")
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
    try:
        if result.validity != "refused":
            save_model(Model(name=flight.arm.name, parameters=quantities, effects=effects), out)
    finally:
        if json:
            write_json(json, report_estimate(result, watch, drift, heading))
    if result.validity != "valid":
        where = "no model written" if result.validity == "refused" else f"{named(out)} written"
        changed = "read the warning: the arm changed" if drift and drift.changed else ""
        number_of = measured(result, flight)
        raise Undecided(
            f"{result.validity}: {result.reason}{f': {number_of}' if number_of else ''} ({where}); remedy: "
            f"{changed or remedy(result, flight, watch.known)}"
        )
