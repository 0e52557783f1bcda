# SPDX-License-Identifier: MIT
"""The demonstration that `make` runs: the paper's example from CAN frames to parameters, a gap explained, and a report.

Each step runs as a separate process, and those that estimate get no file with true values: `zygos simulate` writes
a log, its frames are sent over a bus, `zygos estimate` and numpy read what arrived, and only then the scoring step
reads the plant's model.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import reference
from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.run import Run
from zygos.demo.bars import draw_gap
from zygos.demo.page import Convergence, write_report
from zygos.errors import ZygosError
from zygos.estimation.estimate import estimate
from zygos.estimation.words import losses
from zygos.files.output import check_outputs, note, number, ratio, say, table, write_json
from zygos.model.model import load_model
from zygos.native.flight import Estimate, Flight, Trace
from zygos.reference.compare import decode
from zygos.simulation.scenario import load_scenario
from zygos.simulation.score import score

EXAMPLE, GAP = Path("examples/paper"), Path("examples/gap")
SNAPSHOT_CYCLES = 20
DOORS = (
    ("link it into a flight computer:", "make -C examples/onboard", "docs/tutorial-flight-computer.md"),
    ("put it beside a bus:", "zygos listen --help", "docs/tutorial-bus.md"),
    ("explain your own arm:", "zygos explain --help", "docs/tutorial-arm.md"),
)
"""Where to go on: what one does, the command that it begins with, and the page that leads through it."""
GAPS = {"as_delivered": "as delivered", "refit": "refit", "closed": "closed", "floor": "floor"}


def choose_bus() -> tuple[str, str]:
    """python-can's interface and channel: vcan0 if it exists and is up, otherwise the in-process bus."""
    flags = Path("/sys/class/net/vcan0/flags")
    if flags.exists() and int(flags.read_text(), 16) & 1:
        return "socketcan", "vcan0"
    return "virtual", "zygos"


def run_zygos(*arguments: str | Path) -> None:
    """Run a zygos command in a separate process."""
    command = [sys.executable, "-m", "zygos.cli", *map(str, arguments)]
    if subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode != 0:
        raise ZygosError(f"`zygos {' '.join(map(str, arguments))}` failed; remedy: read its message above")


def converge(arm: Arm, frames: NDArray[Any]) -> Convergence:
    """Estimates of the C library during the run, one for every second of it."""
    flight = Flight(arm)
    starts = np.flatnonzero(frames["id"] == 0x080)
    time_s, values, halves = [], [], []
    for first, last in zip(
        starts[:-1:SNAPSHOT_CYCLES], [*starts[SNAPSHOT_CYCLES::SNAPSHOT_CYCLES], len(frames)], strict=False
    ):
        flight.frames(frames[first:last])
        now = flight.estimate()
        time_s.append(now.cycle * arm.period_s)
        values.append(now.value)
        halves.append(now.half95)
    return Convergence(np.array(time_s), np.array(values), np.array(halves))


def explain_gap(folder: Path) -> dict[str, Any]:
    """Explain the logs of examples/gap/demo, which contain a hidden effect, and compare with the sealed solution.

    Writes folder/gap.html, folder/gap.json and folder/explained.toml. Errors: ZygosError if a log is not the one that
    was sealed, or if no effect could be named.
    """
    logs = [GAP / "demo" / f"{name}.blf" for name in "abc"]
    verdict_file, report = folder / "gap.json", folder / "gap.html"
    arguments: list[str | Path] = [*logs[:2], "--simulation", GAP / "cad.toml", "--validate", logs[2]]
    arguments += ["--arm", GAP / "arm.toml", "-o", folder / "explained.toml", "--report", report]
    arguments += ["--json", verdict_file]
    run_zygos("explain", *arguments)

    # Scoring starts here: the verdict has been written, and nothing below changes it.
    verdict = json.loads(verdict_file.read_text())
    sealed = json.loads((GAP / "demo" / "sealed.json").read_text())
    for log in logs:
        if hashlib.sha256(log.read_bytes()).hexdigest() != sealed["sha256"][log.name]:
            raise ZygosError(f"{log} is not the log that was sealed; remedy: `make demo-log`, or restore it from git")
    if not verdict["findings"]:
        raise ZygosError(f"no effect was named: {verdict['sentence']}; remedy: read {report}")
    found, gap = verdict["findings"][0], verdict["gap"]
    return {
        "hidden": sealed["hidden"],
        "named": found["effect"],
        "where": found["joint"],
        "right": [(f["effect"], f["joint"]) for f in verdict["findings"]] == [(sealed["hidden"], sealed["where"])],
        "title": found["title"],
        "size": sealed["size"],
        "value": found["value"],
        "interval": found["interval"],
        "unit": found["unit"],
        "sentence": verdict["sentence"],
        "report": report.name,
        **{name: gap[name] for name in GAPS},
    }


@dataclass(frozen=True)
class Learned:
    """The results for the paper's example."""

    arm: Arm
    trace: Trace
    estimate: Estimate
    numpy_value: NDArray[np.float64]
    """(p,) estimate of the batch reference."""
    true: NDArray[np.float64]
    """(p,) true values, read only after the estimate was written."""
    convergence: Convergence
    losses: str
    content: dict[str, Any]
    """Their part of demo.json."""


def learn(folder: Path) -> Learned:
    """Simulate the paper's example, send its frames over a bus, estimate, score. Writes run, arm and estimate."""
    folder.mkdir(parents=True, exist_ok=True)
    sent, run = folder / "sent.blf", folder / "run.blf"
    estimate_file = folder / "estimate.toml"
    for written in (folder / "arm.toml", estimate_file):
        written.unlink(missing_ok=True)

    note("simulating the paper's arm …")
    run_zygos("simulate", EXAMPLE / "scenario.toml", "-o", sent)
    arm_file = folder / "arm.toml"
    arm = load_arm(arm_file)

    interface, channel = choose_bus()
    name = f"{interface} {channel}" + ("" if interface == "socketcan" else " (in-process: this machine has no vcan0)")
    note(f"sending its frames over {name} …")
    frames = bus.transferred(bus.read_log(sent).frames, arm.period_s, interface, channel)
    bus.write_log(run, frames, arm.period_s)

    found = estimate(Run(arm, frames, path=run), trace=True)
    flight, result = found.watch.flight, found.result
    if any(flight.faults.values()):
        seen = ", ".join(f"{fault} {count}" for fault, count in flight.faults.items() if count)
        raise ZygosError(
            f"frames were lost or damaged on {interface} {channel} ({seen}); remedy: check that nothing else sends on "
            "that bus, and run again"
        )

    note("estimating …")
    estimate_json = estimate_file.with_suffix(".json")
    run_zygos("estimate", run, "--arm", arm_file, "-o", estimate_file, "--json", estimate_json)
    published = {one["name"]: one for one in json.loads(estimate_json.read_text())["values"]}
    refined = [published[name] for name in arm.parameter_names]
    numpy_value = reference.chain(arm, decode(arm, frames).cycles).solution.x
    convergence = converge(arm, frames)

    # Scoring starts here: the estimate has been written, and nothing below changes it.
    scenario = load_scenario(EXAMPLE / "scenario.toml")
    true = load_model(scenario.plant).base_values(arm)
    percent = score(result.value, true).error_percent
    refined_percent = score(np.array([entry["value"] for entry in refined]), true).error_percent
    parameters: list[dict[str, Any]] = [
        {
            "name": n,
            "unit": u,
            "true": float(t),
            "numpy": float(x),
            "c": float(c),
            "half95": float(h),
            "error_percent": float(e),
            "refined": better["value"],
            "refined_half95": better["half95"],
            "refined_error_percent": float(r),
        }
        for n, u, t, x, c, h, e, better, r in zip(
            arm.parameter_names,
            arm.parameter_units,
            true,
            numpy_value,
            result.value,
            result.half95,
            percent,
            refined,
            refined_percent,
            strict=True,
        )
    ]
    content: dict[str, Any] = {
        "bus": f"{interface} {channel}",
        "validity": result.validity,
        "cycles": flight.counts["cycles"],
        "faults": flight.faults,
        "parameters": parameters,
    }
    return Learned(arm, found.watch.trace(), result, numpy_value, true, convergence, losses(flight), content)


def run_demo(folder: Path = Path("out/demo")) -> None:
    """Estimate the paper's arm, explain a gap, and write folder/report.html, folder/gap.svg and folder.json."""
    begin = time.monotonic()
    check_outputs([folder / "report.html", folder.with_suffix(".json")], [])
    learned = learn(folder)
    content = learned.content
    note("explaining a gap with a hidden effect …")
    gap = content["gap"] = explain_gap(folder)
    write_json(folder.with_suffix(".json"), content)
    draw_gap(folder / "gap.svg", gap)
    write_report(
        folder / "report.html",
        learned.arm,
        learned.trace,
        learned.estimate,
        learned.numpy_value,
        learned.true,
        learned.convergence,
        content,
    )

    _print_parameters(content["parameters"])
    say(
        f"hidden effect: {'found' if gap['right'] else 'MISNAMED as'} {gap['title']}, {gap['where']}, "
        f"{number(gap['value'], 4)} {gap['unit']} (hidden: {gap['size']})"
    )
    shrinks = [f"{number(gap[key], 3)} {word}" for key, word in GAPS.items()]
    say(f"gap between simulation and measurement, sigma: {', '.join(shrinks)}")
    note_of_bus = f"{learned.losses} · C and numpy differ by at most {_difference(content['parameters']):.0e}"
    say(f"arm {learned.arm.name} · bus {content['bus']} · {content['cycles']:,} cycles · {note_of_bus}")
    say(f"report: {folder / 'report.html'} · numbers: {folder.with_suffix('.json')} · {time.monotonic() - begin:.0f} s")
    say("where next:")
    for door, command, page in DOORS:
        say(f"  {door:32} {command:34} {page}")


def _print_parameters(parameters: list[dict[str, Any]]) -> None:
    """True values, those of the energy balance, and the refined ones, with their 95 % intervals and errors."""

    def cells(value: float, half95: float, error_percent: float, decimals: int) -> tuple[str, str, str]:
        return number(value, 7), f"{100.0 * ratio(half95, value):.{decimals}f} %", f"{error_percent:+.{decimals}f} %"

    def mean(key: str, decimals: int) -> str:
        return f"{float(np.mean([abs(p[key]) for p in parameters])):.{decimals}f} %"

    table(
        ("name", "unit", "true", "energy balance", "±95 %", "error", "refined", "±95 %", "error"),
        [
            (
                p["name"],
                p["unit"],
                number(p["true"], 7),
                *cells(p["c"], p["half95"], p["error_percent"], 2),
                *cells(p["refined"], p["refined_half95"], p["refined_error_percent"], 5),
            )
            for p in parameters
        ]
        + [("mean |error|", *[""] * 4, mean("error_percent", 2), *[""] * 2, mean("refined_error_percent", 5))],
    )


def _difference(parameters: list[dict[str, Any]]) -> float:
    """The largest relative difference between the estimates of C and of numpy."""
    return max(abs(ratio(p["c"], p["numpy"]) - 1.0) for p in parameters)
