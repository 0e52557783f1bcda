"""The paper's tables, reproduced: its three methods in batch, and beside them the chain that flies.

K. Nanos, E. Papadopoulos, "On Parameter Estimation of Space Manipulator Systems with Flexible Joints Using the Energy
Balance". docs/paper.md says what is read how, and which of its printed formulas had to be corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import printed
from zygos.arm import Arm, load_arm
from zygos.commands import progress
from zygos.errors import ZygosError
from zygos.flight import Flight, encode
from zygos.methods import Record, amc, de, eb, exact_record, noisy_states, record_of
from zygos.model import load_model
from zygos.output import check_outputs, number, say, table, write_json
from zygos.plant import Trajectory, simulate
from zygos.reference.cycle import calibrate
from zygos.response import HAIR_RAD, PARTING, apart_percent, respond
from zygos.scenario import Scenario, load_scenario
from zygos.score import Score, score

Floats = NDArray[np.float64]

NOISE = (
    "encoders: quantum q = 0.003 rad (500 lines, decoded fourfold), white, variance q²/12 = 7.5e-7 rad²; "
    "gyro: white part 0.31623 µrad/s^½, bias walk 3.1623e-4 µrad/s^1.5; torque exact"
)


@dataclass(frozen=True)
class Example:
    """The files of an example, and what the scorer knows."""

    arm: Arm
    scenario: Scenario
    true: Floats
    """(p,)"""
    files: tuple[Path, ...]
    """Where all that was read."""


def load_example(folder: Path | None) -> Example:
    """Read arm, scenario and plant of a folder; by default examples/paper of the checkout."""
    chosen = folder or Path("examples/paper")
    if not (chosen / "scenario.toml").is_file():
        raise ZygosError(
            f"{chosen / 'scenario.toml'}: no such file; remedy: run inside a checkout, or name the folder by --example"
        )
    scenario = load_scenario(chosen / "scenario.toml")
    arm = load_arm(scenario.arm)
    files = (chosen / "scenario.toml", scenario.arm, scenario.plant)
    return Example(arm, scenario, load_model(scenario.plant).base_values(arm), files)


def noisy_record(arm: Arm, trajectory: Trajectory) -> Record:
    """What the sensors said of all seeds, as the batch methods take it."""
    return record_of(arm, *(calibrate(arm, trajectory.cycles(k)) for k in range(len(trajectory.seeds))))


def flight_estimates(arm: Arm, trajectory: Trajectory) -> Floats:
    """(B, p) estimates of the C library from CAN frames."""
    values = []
    for k in range(len(trajectory.seeds)):
        flight = Flight(arm)
        flight.frames(encode(arm, trajectory.cycles(k)))
        values.append(flight.estimate().value[: len(arm.parameter_names)])
    return np.array(values)


def paper_example(folder: Path | None) -> tuple[Example, float]:
    """An example that the paper's methods can be tried on, and its angular momentum, Nms. Errors: ZygosError."""
    example = load_example(folder)
    momentum = example.scenario.angular_momentum_nms
    if example.arm.spatial or not example.arm.free or isinstance(momentum, tuple):
        raise ZygosError(
            f"arm {example.arm.name}: the paper's methods are those of a free-floating arm that moves in a plane; "
            "remedy: `zygos estimate` for any other"
        )
    return example, momentum


NOISY = ("AMC", "DE", "EB", "EB (32)", "flight")
EXACT = ("DE, exact data", "EB, exact data", "flight, no noise")
SAID = {
    "AMC": "angular momentum, backward differences",
    "DE": "equations of motion, central and second differences",
    "EB": "energy balance, backward differences",
    "EB (32)": "energy balance, exact states with independent noise of the variances (32) added to angles and rates",
    "flight": "the C library from CAN frames",
    "DE, exact data": "equations of motion, exact rates and accelerations",
    "EB, exact data": "energy balance, exact rates and dissipation",
    "flight, no noise": "the C library from CAN frames of exact sensors",
}


def run_paper(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print Tables III and IV and the numbers of Fig. 4(b); see `zygos paper --help`."""
    example, momentum = paper_example(folder)
    check_outputs([json], example.files)
    arm, true = example.arm, example.true
    model = load_model(example.scenario.plant)
    with progress() as bar:
        task = bar.add_task(f"simulating {seeds} seeds", total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)

        noisy = simulate(arm, model, example.scenario, seeds=range(seeds), noise=True, progress=show)
        bar.update(task, description="simulating without noise", completed=0.0)
        clean = simulate(arm, model, example.scenario, seeds=[0], noise=False, progress=show)
        bar.update(task, description="estimating", completed=0.0)
        record, exact = noisy_record(arm, noisy), exact_record(clean)
        estimates: dict[str, Floats] = {
            "AMC": amc.estimate(arm, record, momentum_nms=momentum),
            "DE": de.estimate(arm, record),
            "EB": eb.estimate(arm, record, rates="backward", start="rest"),
            "EB (32)": eb.estimate(arm, noisy_states(arm, exact, range(seeds)), rates="exact", start="rest"),
            "flight": flight_estimates(arm, noisy),
            "DE, exact data": de.estimate(arm, exact, exact=True),
            "EB, exact data": eb.estimate(arm, exact, rates="exact", start="rest"),
            "flight, no noise": flight_estimates(arm, clean),
        }
        bar.update(task, description="responding to the torques (50)", completed=0.5)
        told = printed.describes(arm, true)
        figure = responses(arm, true, estimates, momentum) if told else None
    scores = {name: score(value, true) for name, value in estimates.items()}
    content: dict[str, Any] = {
        "arm": arm.name,
        "seeds": seeds,
        "duration_s": example.scenario.duration_s,
        "noise": NOISE,
        "methods": [_summary(name, estimates[name], scores[name], arm) for name in estimates],
    }
    if told:
        content["printed"] = {
            "actual": printed.ACTUAL,
            "estimates": printed.ESTIMATES,
            "errors_percent": printed.ERRORS,
            "agreement": {name: _agreements(name, scores[name], arm) for name in printed.ERRORS},
        }
    if figure is not None:
        content["figure4b"] = figure
    if json:
        write_json(json, content)
    if json == "-":
        return
    say(f"Noise, as read here: {NOISE}.")
    say(f"{seeds} seeds, {example.scenario.duration_s:g} s at {1 / arm.period_s:g} Hz\n")
    _table_3(arm, true, estimates, told)
    _table_4(arm, scores, told)
    if figure is not None:
        _table_figure(figure, arm)


def _summary(name: str, value: Floats, result: Score, arm: Arm) -> dict[str, Any]:
    seen = np.isfinite(result.rms)
    return {
        "method": name,
        "said": SAID[name],
        "seen": int(seen.sum()),
        "mean_rms_percent": float(np.mean(result.rms[seen])),
        "max_rms_percent": float(np.max(result.rms[seen])),
        "per_parameter": {
            n: {"mean": float(v), "mean_error_percent": float(e), "rms_percent": float(r)}
            for n, v, e, r in zip(arm.parameter_names, value.mean(axis=0), _mean_error(result), result.rms, strict=True)
        },
    }


def _mean_error(result: Score) -> Floats:
    """(p,) mean over the seeds, with its sign, %."""
    return np.asarray(result.error_percent.mean(axis=0), dtype=np.float64)


def _agreements(name: str, result: Score, arm: Arm) -> dict[str, str]:
    """In what our mean error of each parameter agrees with the printed one."""
    mean = dict(zip(arm.parameter_names, _mean_error(result), strict=True))
    return {n: printed.agreement(float(mean[n]), error) for n, error in printed.ERRORS[name].items()}


def _order(arm: Arm, told: bool) -> list[int]:
    """Rows of a table: the paper's order where it is the paper's arm."""
    names = list(arm.parameter_names)
    return [names.index(n) for n in printed.PARAMETERS] if told else list(range(len(names)))


def _table_3(arm: Arm, true: Floats, estimates: dict[str, Floats], told: bool) -> None:
    rows = []
    for k in _order(arm, told):
        n = arm.parameter_names[k]
        row = [n, number(float(true[k]), 9)]
        for name in ("DE", "EB", "EB (32)", "flight"):
            if told and name in printed.ESTIMATES:
                row.append(number(printed.ESTIMATES[name][n], 6))
            row.append(number(float(estimates[name][:, k].mean()), 5))
        rows.append(row)
    paired = ("DE printed", "DE", "EB printed", "EB") if told else ("DE", "EB")
    title = "Table III: estimates in SI units, mean over the seeds"
    table(["", "true", *paired, "EB (32)", "flight"], rows, title=title)
    if told:
        say(
            "\nThe DE estimates are printed with the sign of their error turned round: a00 is 47320, which\n"
            "is 99 % too high, and Table IV says -99 %. Table IV is right: noise attenuates.\n"
        )


def _table_4(arm: Arm, scores: dict[str, Score], told: bool) -> None:
    if told:
        for left, right, title in (
            ("DE, exact data", "EB, exact data", "Table IV, exact data: error, %"),
            ("DE", "EB", "Table IV, noise: error, %, mean over the seeds"),
        ):
            heads = ["", "DE printed", "here", "agree in", "EB printed", "here", "agree in"]
            means = {name: _mean_error(scores[name]) for name in (left, right)}
            rows = []
            for k in _order(arm, told):
                n = arm.parameter_names[k]
                cells = [n]
                for name in (left, right):
                    ours = float(means[name][k])
                    cells += [number(printed.ERRORS[name][n], 3), number(ours, 3)]
                    cells.append(printed.agreement(ours, printed.ERRORS[name][n]))
                rows.append(cells)
            said = ["in all"]
            for name in (left, right):
                words = list(_agreements(name, scores[name], arm).values())
                sizes = [np.mean([abs(x) for x in column]) for column in (printed.ERRORS[name].values(), means[name])]
                said += [*(number(float(size), 3) for size in sizes), _counted(words)]
            table(heads, [*rows, said], title=title)
            say("")
        say(
            f"Sizes agree within a factor of {printed.SIZE:g}. In all: mean size of the errors; how many signs + sizes "
            "agree.\nWhat DE leaves on exact data is rounding, here as there.\n"
        )
    names = (*NOISY, *EXACT[1:])
    rows = [[arm.parameter_names[k], *(number(float(scores[n].rms[k]), 3) for n in names)] for k in _order(arm, told)]
    rows.append(["mean", *(number(float(np.nanmean(scores[n].rms)), 3) for n in names)])
    rows.append(["largest", *(number(float(np.nanmax(scores[n].rms)), 3) for n in names)])
    heads = ["", *NOISY, *(name.replace(", ", "\n") for name in EXACT[1:])]
    table(heads, rows, title="Root mean square error over the seeds, %")
    say(f"\nEB (32): {SAID['EB (32)']}. The flight chain reads CAN frames; the last two columns have no noise.")


def _counted(words: Sequence[str]) -> str:
    if "rounding" in words:
        return "rounding"
    return f"{sum('sign' in w for w in words)} + {sum('size' in w for w in words)} of {len(words)}"


INSTANTS_S = (5.0, 10.0, 20.0, 30.0, 60.0, 90.0, 120.0)


def responses(arm: Arm, true: Floats, estimates: dict[str, Floats], momentum_nms: float) -> dict[str, Any]:
    """Fig. 4(b) as numbers: by how much the responses to (50) differ, in per cent of the largest angle so far."""
    sets = {
        "EB printed": printed.eb_values(true, arm.parameter_names),
        "EB": estimates["EB"][0],
        "flight": estimates["flight"][0],
        "+10 %": 1.1 * true,
        "-10 %": 0.9 * true,
    }
    exact = respond(arm, true, momentum_nms)
    at = np.rint(np.array(INSTANTS_S) / arm.period_s).astype(np.int64)
    content: dict[str, Any] = {
        "time_s": list(INSTANTS_S),
        "true_rad": exact[at].T.tolist(),
        "error_percent": {},
        "rms_percent": {},
        "missing": {},
    }
    for name, values in sets.items():
        try:
            off = apart_percent(respond(arm, values, momentum_nms), exact)
        except ZygosError as error:
            content["missing"][name] = str(error)
            continue
        content["error_percent"][name] = off[at].T.tolist()
        content["rms_percent"][name] = float(np.sqrt(np.mean(off**2)))
    hair = respond(arm, true, momentum_nms, HAIR_RAD)
    content["parting"] = float(np.max(np.abs(hair - exact)) / HAIR_RAD)
    return content


def _table_figure(figure: dict[str, Any], arm: Arm) -> None:
    names = list(figure["error_percent"])
    rows = []
    for joint, label in enumerate(joint.name for joint in arm.joints):
        for k, t in enumerate(figure["time_s"]):
            errors = (number(figure["error_percent"][name][joint][k], 3) for name in names)
            rows.append([f"{label} {t:g} s", number(figure["true_rad"][joint][k], 3), *errors])
    rows.append(["rms, both", "", *(number(figure["rms_percent"][name], 3) for name in names)])
    say("")
    table(
        ["", "true, rad", *names],
        rows,
        title="Fig. 4(b): response to the torques (50), error in % of the largest angle of that joint so far",
    )
    for name, why in figure["missing"].items():
        say(f"{name} has no response: {why}")
    say(
        f"\nEB and flight: from seed 0. The motion is not chaotic: a start {1e3 * HAIR_RAD:g} mrad aside gets at most "
        f"{figure['parting']:.1f} times as far apart."
        if figure["parting"] < PARTING
        else f"\nEB and flight: from seed 0. The motion is chaotic: a start {1e3 * HAIR_RAD:g} mrad aside gets "
        f"{figure['parting']:.0f} times as far apart."
    )
