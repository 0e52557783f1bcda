"""The report pages of results: one HTML file each, with nothing outside it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from zygos.gap.explain import Explanation
from zygos.gap.page import write_gap_report
from zygos.gap.provenance import Provenance


def _explanation(result: Explanation, path: Path) -> None:
    """Of an explained gap; the runs that came from files are named with their digests."""
    files = [record.path for record in result.refit.records if record.path.is_file()]
    listed = tuple(("measured", str(file), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files)
    write_gap_report(path, result, Provenance("zygos.explain, called from Python", version("zygos"), listed))


WRITERS: dict[type[Any], Callable[[Any, Path], None]] = {
    Explanation: _explanation,
}
"""The writer of each kind of result that has a page."""

Reported = Explanation
"""The kinds of results that have a page."""


def write_report(result: Reported, path: str | Path) -> None:
    """Write the page of a result, an `Explanation`, as one HTML file.

    Errors: ZygosError if the file cannot be written, TypeError for a result that has no page.
    """
    writer = WRITERS.get(type(result))
    if writer is None:
        kinds = ", ".join(kind.__name__ for kind in WRITERS)
        raise TypeError(f"a {type(result).__name__} has no report page; there is one of: {kinds}")
    writer(result, Path(path))
