# SPDX-License-Identifier: MIT
"""The page docs/soak.md, from what `make soak` found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from soak.endurance import FAR_SHARE, FAR_SIGMAS, LOOKS, LOST, SOAKS, STALE, Outcome
from zygos.accuracy.mission import MISSING
from zygos.files.output import counted
from zygos.report.provenance import measured_commit

INTRODUCTION = f"""\
# Weeks of flight at an accelerated pace

`make soak` writes this page and `out/soak.json`; `make soak FULL=1` flies the whole duration of each soak. The C
library receives the CAN frames of a few stored motions, which are repeated, as fast as it takes them. The errors of
all sensors are drawn anew in each repetition, and {MISSING} cycles are missing between two of them. A share of
{LOST:g} of all frames is lost, SYNC and FTIME included. A share of {STALE:g} of the frames of drives and gyro has the
content of the cycle before, as from a node that hangs for a cycle. At regular intervals the state is sealed into a
snapshot, and another instance of the library resumes from it.

Three conditions are checked; the command exits with 1 if one does not hold.

- At each of {LOOKS} looks the estimate is valid; where the motion does not determine every parameter it is *partial*:
  the parameters that are determined are published, and no other.
- At the last look, the published 95 % intervals contain the true values in a share of at least 95 % less three standard
  errors, as if they were independent. At no look is a value off by more than {FAR_SIGMAS:g} sigmas and
  {100.0 * FAR_SHARE:g} %.
- All counters of the library equal those that follow from the disturbed frames by the rules of [wire](wire.md) and
  [snapshot](snapshot.md). `tests/soak/traffic.py` computes them without decoding a frame.

A soak is one mission. [mission](mission.md) has the coverage of the intervals over many of them.
"""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]


def _row(one: Outcome) -> list[str]:
    last = one.looks[-1]
    return [
        one.name,
        f"{one.joints} joints, p = {one.parameters}, {one.rate_hz:g} Hz",
        f"{one.days:.3g} of {SOAKS[one.name].days:g} days",
        f"{one.cycles:,}",
        f"{one.lost:,} / {one.stale:,} of {one.frames:,}",
        counted(one.resumed, "time"),
        last.validity,
        f"{last.covered} of {last.published}",
        "exact" if one.expected == one.found else "wrong",
        "; ".join(one.failures) or "pass",
    ]


def page(found: Sequence[Outcome]) -> str:
    """The page as Markdown."""
    lines = [INTRODUCTION]
    head = ("soak", "arm", "duration", "cycles", "frames lost / stale", "resumed", "validity")
    head += ("95 % intervals that hold", "counters", "verdict")
    lines += [*_table(head, map(_row, found)), "", f"Measured with commit {measured_commit()}."]
    for one in found:
        if one.share < 1.0:
            lines += [
                "",
                f"Of `{one.name}`, a share of {one.share:g} was flown. `make soak FULL=1` flies all of it, "
                f"which takes {one.seconds / one.share / 60.0:.0f} minutes at this pace.",
            ]
    for one in found:
        pace = one.cycles / one.rate_hz / one.seconds
        lines += [
            "",
            f"## {one.name}",
            "",
            f"The run took {one.seconds:,.0f} s on a shared machine, {one.library_s:,.0f} s of them in the library: it "
            f"was {pace:,.0f} times as fast as the arm. Counters of the library that are not zero: "
            + ", ".join(f"`{name}` {count:,}" for name, count in one.found.items())
            + ".",
            "",
        ]
        lines += _table(
            ("cycles", "validity", "published", "intervals that hold", "largest error, σ", "median half width, %"),
            [
                [
                    f"{look.cycles:,}",
                    look.validity,
                    f"{look.published}",
                    f"{look.covered}",
                    f"{look.worst_sigmas:.2f}",
                    f"{look.half95_percent:g}",
                ]
                for look in one.looks
            ],
        )
    return "\n".join(lines) + "\n"
