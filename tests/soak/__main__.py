# SPDX-License-Identifier: MIT
"""Weeks of flight at an accelerated pace (`make soak`).

    python -m soak [NAME ...] [--share SHARE | --full] [--json FILE]

Writes out/soak.json, in which the results of other soaks stay if they are of the same sources of the library, and
docs/soak.md if the file has all soaks and none is shorter than by default. The exit code is 1 if a check fails.
"""

from __future__ import annotations

import sys
import time
from json import loads
from pathlib import Path
from typing import Annotated

import typer

from conftest import ROOT
from soak.endurance import SOAKS, Outcome, fly
from soak.page import page
from verify.result import digest
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, errors_end_the_program, say, table, write_json, write_text
from zygos.files.progress import progress

DOCUMENT = ROOT / "docs" / "soak.md"


def row(one: Outcome) -> tuple[str, ...]:
    """A line of the table at the end."""
    last = one.looks[-1]
    return (
        one.name,
        f"{one.cycles:,}",
        f"{one.days:.3g} of {one.days / one.share:.3g} days",
        last.validity,
        f"{last.covered} of {last.published}",
        "exact" if one.expected == one.found else "wrong",
        f"{one.seconds:.0f} s",
        "; ".join(one.failures) or "pass",
    )


def others(file: Path) -> list[Outcome]:
    """The results in the file, if they are of these sources. Errors: ZygosError for a file of another content."""
    if not file.exists():
        return []
    try:
        content = loads(file.read_text())
        found = [Outcome.of_json(one) for one in content["soaks"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ZygosError(f"{file}: no results of a soak; remedy: remove the file, or give --json another") from error
    return found if content.get("sources") == digest() else []


def soak(
    names: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", help="Default: all.")] = None,
    share: Annotated[
        float | None, typer.Option(min=1e-4, max=1.0, help="Part of each duration; default: that of the table.")
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="The whole duration of each.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all noise and losses.")] = 0,
    json: Annotated[Path, typer.Option(metavar="FILE", help="Results.")] = Path("out/soak.json"),
) -> None:
    """Fly weeks of CAN frames with losses, stale frames and restarts, and check estimates, intervals and counters.

    Example: python -m soak two --share 0.01
    """
    unknown = [name for name in names or [] if name not in SOAKS]
    if unknown:
        raise ZygosError(f"there is no soak {unknown[0]!r}; remedy: use some of {', '.join(SOAKS)}")
    check_outputs([json], [])
    before = others(json)
    chosen = [one for name, one in SOAKS.items() if not names or name in names]
    shares = {one.name: 1.0 if full else share or one.share for one in chosen}
    begin, found = time.monotonic(), []
    with progress() as bar:
        for one in chosen:
            task = bar.add_task(one.name, total=1.0)
            found.append(
                fly(
                    one,
                    shares[one.name],
                    json.parent / "soak",
                    seed,
                    lambda part, t=task: bar.update(t, completed=part),
                )
            )
    known = {one.name: one for one in (*before, *found)}
    every = [known[name] for name in SOAKS if name in known]
    write_json(json, {"sources": digest(), "soaks": [one.as_json() for one in every]})
    if len(every) == len(SOAKS) and all(one.share >= SOAKS[one.name].share for one in every):
        write_text(DOCUMENT, page(every))
    head = ("soak", "cycles", "duration", "validity", "95 % intervals that hold", "counters", "took", "verdict")
    table(head, [row(one) for one in found])
    say(f"{time.monotonic() - begin:.0f} s · {json}")
    if any(one.failures for one in found):
        raise typer.Exit(1)


def main(arguments: list[str] | None = None) -> None:
    """Run with the arguments of the command line, or with the given ones."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(soak)
    with errors_end_the_program():
        app(args=arguments, prog_name="python -m soak")


if __name__ == "__main__":
    main(sys.argv[1:])
