# SPDX-License-Identifier: MIT
"""`python -m zygos.accuracy.ground`, used by `make ground`: estimates of laboratory arms compared with their plants."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import Progress, TaskID

from zygos.accuracy import campaign
from zygos.accuracy.cell import fingerprint
from zygos.accuracy.laboratory import ARMS, HELD, LEARNED, VARIANTS, Draw, Laboratory
from zygos.errors import ZygosError
from zygos.files.output import (
    check_outputs,
    counted,
    errors_end_the_program,
    number,
    say,
    table,
    write_json,
    write_text,
)
from zygos.files.progress import progress
from zygos.report.provenance import measured_commit

Line = dict[str, Any]

FOLDER = Path("out/ground")
PAGE = Path("docs/laboratory.md")
BEGIN, END = "<!-- make ground writes this -->\n", "<!-- to here -->\n"
_NAMES = {"ur10e": "UR10e", "panda": "Panda", "lwr4": "LWR4+"}
_SAID = {"as declared": "as declared", "offset": "0.01 to 0.05 Nm in each", "noise": "5 % noise, not declared"}


def summarised(lines: Sequence[Line]) -> list[Line]:
    """One entry for each arm and variant, which compares the estimates with the true values."""
    out = []
    for name in ARMS:
        for variant in VARIANTS:
            own = [line for line in lines if (line["arm"], line["variant"]) == (name, variant)]
            if own:
                out.append(_summary(name, variant, own))
    return out


def _summary(name: str, variant: str, own: Sequence[Line]) -> Line:
    true, value, half, wide = (np.array([line[key] for line in own]) for key in ("true", "value", "half95", "half999"))
    given = np.array([line["determined"] for line in own])
    holds = np.abs(value - true) <= half
    each = [float(h[g].mean()) for h, g in zip(holds, given, strict=True) if g.any()]
    error, batch, floor = (
        np.array([line[key] for line in own], dtype=np.float64) for key in ("error_nm", "idim_nm", "floor_nm")
    )
    return {
        "arm": name,
        "variant": variant,
        "draws": len(own),
        "valid": sum(line["validity"] == "valid" for line in own),
        "reasons": sorted({line["reason"] for line in own if line["reason"]}),
        "parameters": given.shape[1],
        "least_determined": int(given.sum(axis=1).min()),
        "coverage95": float(np.mean(each)) if each else None,
        "coverage95_error": float(np.std(each, ddof=1) / np.sqrt(len(each))) if len(each) > 1 else None,
        "least_coverage95": float(min(h[g].mean() for h, g in zip(holds.T, given.T, strict=True) if g.any())),
        "intervals": int(given.sum()),
        "beyond999": int((given & (np.abs(value - true) > wide)).sum()),
        "of_floor": _ratios(error, floor),
        "of_batch": _ratios(error, batch),
    }


def _ratios(error: np.ndarray[Any, Any], other: np.ndarray[Any, Any]) -> Line:
    """Ratios of the errors of the predicted torques: of their root mean squares over all draws for each joint, and the
    largest of one joint in one draw."""
    over_draws = np.sqrt((error**2).mean(axis=0) / (other**2).mean(axis=0))
    return {"joints": over_draws.tolist(), "largest": float((error / other).max())}


def ground_table(entries: Sequence[Line]) -> str:
    """The numbers as Markdown."""
    lines = [
        "| arm | torques | draws | valid | parameters determined | 95 % intervals that hold, % | beyond 99.9 % | "
        "error / true model's | error / batch |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in entries:
        lines.append("| " + " | ".join(_cells(one)) + " |")
    return "\n".join(lines) + "\n"


def _cells(one: Line) -> list[str]:
    off = one["coverage95_error"]
    return [
        _NAMES[one["arm"]],
        _SAID[one["variant"]],
        str(one["draws"]),
        str(one["valid"]),
        f"{one['least_determined']} of {one['parameters']}",
        f"{100 * one['coverage95']:.1f}" + (f" ± {100 * off:.1f}" if off is not None else ""),
        f"{one['beyond999']} of {one['intervals']:,}",
        *(f"{max(one[key]['joints']):.3f} ({one[key]['largest']:.3f})" for key in ("of_floor", "of_batch")),
    ]


def _written(page: Path, text: str) -> None:
    """Put the table between its marks. Errors: ZygosError if they are not there."""
    before = page.read_text(encoding="utf-8")
    after, count = re.subn(re.escape(BEGIN) + ".*?" + re.escape(END), lambda _: BEGIN + text + END, before, flags=re.S)
    if count != 1:
        raise ZygosError(f"{page}: has no place for the table; remedy: restore the lines {BEGIN.strip()} {END.strip()}")
    write_text(page, after)


def _tell(bar: Progress, task: TaskID, share: float) -> None:
    bar.update(task, completed=share)


def ground(
    arms: Annotated[
        list[str] | None, typer.Argument(metavar="[ARM]...", help="ur10e, panda, lwr4; default: all.")
    ] = None,
    draws: Annotated[int, typer.Option(min=1, help="Draws of the sensors' errors.")] = 50,
    others: Annotated[int, typer.Option(min=0, help="Draws with torques that are not as declared.")] = 5,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    folder: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder of stored motions, finished draws and results.")
    ] = FOLDER,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The page of the table; default: docs/laboratory.md if all run")
    ] = None,
) -> None:
    """Simulate laboratory arms, estimate them from their frames, and count how often the intervals hold.

    A motion is simulated once with exact sensors; every draw adds errors of encoders and torques to it. Finished draws
    of an earlier start are used again.

    Example: python -m zygos.accuracy.ground ur10e --draws 5
    """
    begin = time.monotonic()
    for name in arms or []:
        if name not in ARMS:
            raise ZygosError(f"there is no arm {name!r}; remedy: use one of {', '.join(ARMS)}")
    whole = not arms and draws >= 50 and others
    target = page or (PAGE if whole else None)
    folder.mkdir(parents=True, exist_ok=True)
    json = folder / "ground.json"
    check_outputs([json, folder / "draws.jsonl"], [])
    laboratories = [Laboratory.of(name) for name in arms or ARMS]
    files = {}
    with progress() as bar:
        for own in laboratories:
            for motion in (LEARNED, HELD):
                task = bar.add_task(f"{own.name}, {motion}", total=1.0)
                files[own.name, motion] = own.stored(motion, folder, partial(_tell, bar, task))
                _tell(bar, task, 1.0)
    code = fingerprint()
    jobs = [
        Draw(own, variant, k, files[own.name, LEARNED], files[own.name, HELD], code)
        for variant in VARIANTS
        for k in range(draws if variant == VARIANTS[0] else others)
        for own in laboratories
    ]
    found = campaign.run(jobs, folder / "draws.jsonl", lambda: campaign.executor(None, workers))
    entries = summarised(found)
    write_json(json, {"draws": entries})
    if target is not None:
        _written(target, ground_table(entries) + f"\nMeasured with commit {measured_commit()}.\n")
    heads = ("arm", "torques", "draws", "valid", "determined", "95 % holds, %", "beyond 99.9 %")
    table((*heads, "of true model's error", "of batch"), [_cells(one) for one in entries])
    for one in entries:
        for reason in one["reasons"]:
            say(f"{_NAMES[one['arm']]}, {_SAID[one['variant']]}: {reason}")
    where = f" · {target}" if target is not None else ""
    say(f"{counted(len(jobs), 'draw')} in {number(time.monotonic() - begin, 3)} s · {json}{where}")


def main(arguments: list[str] | None = None) -> None:
    """Run with the arguments of the command line, or with the given ones."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(ground)
    with errors_end_the_program():
        app(args=arguments, prog_name="python -m zygos.accuracy.ground")


if __name__ == "__main__":
    main()
