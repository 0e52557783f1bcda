# SPDX-License-Identifier: MIT
"""`python -m zygos.accuracy`, used by `make accuracy`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from zygos.accuracy import campaign
from zygos.accuracy.against import against, check_draws, read_cells
from zygos.accuracy.cases import all_cases, chosen
from zygos.accuracy.cell import cells, fingerprint
from zygos.accuracy.figure4 import Figure4
from zygos.accuracy.limit import Limit
from zygos.accuracy.page import write_accuracy_report
from zygos.accuracy.summary import compare, summarise
from zygos.files.output import check_outputs, counted, errors_end_the_program, number, quiet, say, table, write_json

FIGURE_CASE = "paper-60"
CELLS = Path("out/accuracy/cells.jsonl")


def accuracy(
    cases: Annotated[list[str] | None, typer.Argument(metavar="[CASE]...", help="Cases; default: all of them.")] = None,
    seeds: Annotated[int, typer.Option(min=2, max=10_000, help="Seeds 0 .. SEEDS-1 of each case.")] = 50,
    draws: Annotated[int, typer.Option(min=1, help="Draws of sensor errors of each case, for the coverage.")] = 1000,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="A Dask cluster instead of processes here.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes here; default: one per core.")] = None,
    lines: Annotated[Path, typer.Option(metavar="FILE", help="File in which finished cells are stored.")] = CELLS,
    json: Annotated[Path, typer.Option(metavar="FILE", help="File of the results.")] = Path("out/accuracy.json"),
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The page; default: docs/accuracy.html, if all cases run.")
    ] = None,
    other: Annotated[
        Path | None,
        typer.Option(
            "--against", metavar="FILE", help="Cells of another state of the code, which are compared with these."
        ),
    ] = None,
) -> None:
    """Measure errors, coverage and refusals of all estimators. Finished cells of an earlier start are used again.

    Example: python -m zygos.accuracy paper-60 --seeds 10
    """
    begin = time.monotonic()
    wanted = chosen(all_cases(), cases or [])
    target = page or Path("out/accuracy.html" if cases else "docs/accuracy.html")
    check_outputs([lines, json, target], [other] if other else [])
    others = read_cells(other) if other else []
    own = cells(wanted, seeds, draws)
    check_draws(own, others)
    work: list[campaign.Job] = [*own]
    work += [Limit(case, fingerprint()) for case in wanted if all(joint.flexible for joint in case.plant.joints)]
    work += [Figure4(case, 0, fingerprint()) for case in wanted if case.name == FIGURE_CASE]
    found = campaign.run(work, lines, lambda: campaign.executor(scheduler, workers))
    summary, compared = summarise(wanted, found), compare(wanted, found)
    beside = against(wanted, found, others)
    figure = next((line for line in found if line.get("figure")), None)
    short = figure and {
        key: figure[key]
        for key in (
            *("seed", "free_rms_rad", "free_rms_percent", "parting"),
            *("servo_rms_rad", "horizon_s", "arcs_rad", "missing"),
        )
    }
    write_json(
        json,
        {"seeds": seeds, "draws": draws, "cases": summary, "compared": compared, "against": beside, "figure4": short},
    )
    write_accuracy_report(target, wanted, summary, compared, figure, draws)
    if quiet(json, target):
        return
    table(
        ("case", "estimator", "seeds", "refused", "mean %", "max %", "× bound", "coverage 95 %, %", "wild"),
        [
            (
                entry["case"],
                entry["estimator"],
                str(entry["seeds"]),
                str(entry["refused"]),
                number(entry["mean_rms_percent"], 3),
                number(entry["max_rms_percent"], 3),
                number(entry["times_bound"], 3),
                _span([x for x in (entry["coverage95"] or {}).values() if x is not None]),
                "–" if entry["wild"] is None else str(entry["wild"]),
            )
            for entry in summary
        ],
    )
    if compared:
        table(
            ("case", "beside", "seeds", "draws", "error, ratio", "sigma, ratio", "coverage beside, %", "coverage, %"),
            [
                (
                    entry["case"],
                    entry["beside"],
                    str(entry["seeds"]),
                    str(entry["draws"]),
                    number(entry["error_ratio"], 3),
                    number(entry["sigma_ratio"], 3),
                    number(100.0 * entry["coverage95_beside"], 3),
                    number(100.0 * entry["coverage95"], 3),
                )
                for entry in compared
            ],
        )
    if other:
        table(
            ("case", "seeds", "draws", "published", "bias / spread", "spread, ratio", "half width, ratio",
             "coverage, %", "± 3 s.e.", "wild", "worse"),
            [
                (
                    entry["case"],
                    str(entry["seeds"]),
                    str(entry["draws"]),
                    f"{entry['published_other']} → {entry['published']}",
                    f"{_of(entry['bias_other'])} → {_of(entry['bias'])}",
                    _of(entry["spread_ratio"]),
                    _of(entry["half95_ratio"]),
                    f"{_of(entry['coverage95_other'], 100.0)} → {_of(entry['coverage95'], 100.0)}",
                    _of(entry["coverage95_margin"], 100.0),
                    f"{entry['wild_other']} → {entry['wild']}",
                    ", ".join(entry["worse"]) or "–",
                )
                for entry in beside
            ],
        )  # fmt: skip
    say(f"{counted(len(work), 'cell')} in {time.monotonic() - begin:.0f} s · {json} · {target}")


def _of(value: float | None, scale: float = 1.0) -> str:
    return "–" if value is None else number(scale * value, 3)


def _span(shares: list[float]) -> str:
    return f"{100 * min(shares):.1f} … {100 * max(shares):.1f}" if shares else "–"


def main(arguments: list[str] | None = None) -> None:
    """Run with the arguments of the command line, or with the given ones."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(accuracy)
    with errors_end_the_program():
        app(args=arguments, prog_name="python -m zygos.accuracy")


if __name__ == "__main__":
    main()
