# SPDX-License-Identifier: MIT
"""The end of `zygos estimate` and `zygos listen`: answer, model file, JSON, and messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zygos.cli.shared import Wanted, conclude, deliver, save_corrected, warn
from zygos.estimation import sections
from zygos.estimation.estimate import Estimation
from zygos.files.output import is_dash, named
from zygos.ground.estimate import GroundEstimate
from zygos.ground.payload import Payload, check_found
from zygos.ground.sections import estimate_answer, payload_answer
from zygos.model.model import Model, save_model
from zygos.report.answer import Answer
from zygos.report.provenance import Provenance

if TYPE_CHECKING:
    from zygos.cli.best import Best
    from zygos.simulators.explain import InSimulator

Source = Callable[[], Provenance]


def finish_estimate(
    found: Estimation,
    out: Path | None,
    heading: Mapping[str, Any],
    wanted: Wanted,
    source: Source,
    best: Best | None = None,
) -> None:
    """End an estimate of the flight library. Raises Undecided if it is doubtful or refused.

    heading: what the JSON begins with; source: what the estimate was made from; best: what its refinement came to, or
    None where nobody asked. For a page it must have kept its trace.
    """
    where = _where(found.validity, out)
    damage = heading.get("damage") or ()

    def answer(draw: bool) -> Answer:
        of_energy = sections.answer_of(found, written=where, damage=damage, draw=draw)
        return of_energy if best is None else best.answer(of_energy, draw=draw)

    deliver(
        wanted,
        answer,
        lambda: {**found.as_dict(heading), **({} if best is None else best.as_dict())},
        source,
        out,
        save=_saved(found.validity, found.to_model if best is None else lambda: best.model, out),
    )
    if found.change:
        warn([found.change])
    measured = f": {found.measured}" if found.measured else ""
    conclude(found.validity, f"{found.validity}: {found.reason}{measured} ({where}); remedy: {found.remedy}")


def finish_ground(
    found: GroundEstimate, out: Path | None, wanted: Wanted, source: Source, own: InSimulator | None = None
) -> None:
    """End an estimate on the ground. Raises Undecided if it is doubtful or refused. own: the corrected file of the
    simulator."""
    in_file = own is not None and out is not None and not is_dash(out) and out.suffix.lower() != ".toml"
    where = "" if in_file and own is not None and not own.good else _where(found.validity, out)

    def answer(draw: bool) -> Answer:
        whole = estimate_answer(found, written=where, draw=draw)
        return whole if own is None else own.beside(whole)

    def content() -> dict[str, Any]:
        return found.as_dict() if own is None else {**found.as_dict(), "simulator": own.as_json()}

    def save() -> None:
        assert own is not None and out is not None
        save_corrected(own, out)

    saved = save if in_file else _saved(found.validity, found.to_model, out)
    deliver(wanted, answer, content, source, out, save=saved)
    conclude(found.validity, f"{found.validity}: {found.reason} ({where}); remedy: {found.remedy}")


def finish_payload(found: Payload, out: Path | None, wanted: Wanted, source: Source) -> None:
    """End the estimate of a payload. Raises Undecided where there is none."""
    where = f"{named(out)} written" if found.found and out else ""
    deliver(wanted, lambda draw: payload_answer(found, written=where), found.as_dict, source, out)
    check_found(found)
    if out:
        save_model(found.to_model(), out)


def _where(validity: str, out: Path | None) -> str:
    return "no model written" if validity == "refused" or out is None else f"{named(out)} written"


def _saved(validity: str, model: Callable[[], Model], out: Path | None) -> Callable[[], None] | None:
    return None if validity == "refused" or out is None else lambda: save_model(model(), out)
