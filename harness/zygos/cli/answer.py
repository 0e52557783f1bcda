"""The end of `zygos estimate` and `zygos listen`: table, model file, JSON, and messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zygos.cli.shared import conclude, warn
from zygos.estimation.estimate import Estimation
from zygos.estimation.words import losses
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
from zygos.model.model import save_model
from zygos.report.provenance import Provenance


def finish_estimate(
    found: Estimation,
    out: Path,
    json: str | None,
    heading: Mapping[str, Any],
    report: Path | None = None,
    source: Provenance | None = None,
) -> None:
    """Print the table, write the model, report a change of the arm, and raise Undecided if the estimate is
    doubtful or refused.

    report: a page to write, for which the estimate must have kept its trace; source: what it was made from.
    """
    result, flight = found.result, found.watch.flight
    if not quiet(out, json, report):
        rows: list[tuple[str, ...]] = [
            (name, unit, number(value), number(float(f"{half95:.2g}")), number(100 * ratio(half95, abs(value)), 2))
            for name, unit, value, half95 in zip(result.names, result.units, result.value, result.half95, strict=True)
        ]
        columns: tuple[str, ...] = ("name", "unit", "estimate", "±95 %", "in %")
        if flight.effects:
            effects = len(rows) - len(flight.effects)
            shown = [""] * effects + [number(one, 3) for one in result.significance[effects:]]
            columns, rows = (*columns, "significance"), [(*row, one) for row, one in zip(rows, shown, strict=True)]
        table(columns, rows)
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
        for text in found.notes:
            say(text)
    if found.change:
        warn([found.change])
    where = "no model written" if found.validity == "refused" else f"{named(out)} written"
    try:
        if found.validity != "refused":
            save_model(found.to_model(), out)
        if report is not None and source is not None:
            from zygos.estimation.page import write_estimate_report  # noqa: PLC0415  (only a report needs charts)

            write_estimate_report(report, found, source, written=where, damage=heading.get("damage") or ())
    finally:
        if json:
            write_json(json, found.as_dict(heading))
    number_of = f": {found.measured}" if found.measured else ""
    conclude(found.validity, f"{found.validity}: {found.reason}{number_of} ({where}); remedy: {found.remedy}")
