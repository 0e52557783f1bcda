"""What an audit tells a machine, and what a person is to do about it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from zygos.audit.findings import Audit
from zygos.files.output import counted


def as_json(found: Audit) -> dict[str, Any]:
    """The content of an audit's JSON."""
    return {key: value for key, value in asdict(found).items() if key not in ("still", "short")}


def summary(found: Audit) -> str:
    """What is found, in a line."""
    if found.findings:
        first = found.findings[0]
        return f"{counted(len(found.findings), 'finding')}, the first: {first.signal} {first.fault}"
    if not found.ok:
        names = ", ".join(signal.name for signal in found.signals if not signal.decided)
        return f"no fault was found, but nothing confirms {names}"
    return "the run confirms every signal of the arm file"


def advice(found: Audit) -> str:
    """The remedy for the first finding, or what would confirm the signals that nothing confirms; else empty."""
    if found.findings:
        return found.findings[0].remedy
    if found.ok:
        return ""
    if found.still:
        return f"a run in which {', '.join(found.still)} moves"
    if found.short:
        return "a longer run without gaps"
    return 'a run that moves every joint faster and at different speeds; the lines with "open" give the reasons'
