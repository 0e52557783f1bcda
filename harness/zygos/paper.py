"""The paper's tables, reproduced: its three methods in batch, and beside them the chain that flies.

K. Nanos, E. Papadopoulos, "On Parameter Estimation of Space Manipulator Systems with Flexible Joints Using the Energy
Balance". docs/paper.md says what is read how, and which of its printed formulas had to be corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, load_arm
from zygos.commands import progress
from zygos.errors import ZygosError
from zygos.flight import Flight, encode
from zygos.methods import Record, amc, de, eb, exact_record, record_of
from zygos.model import load_model
from zygos.output import check_outputs, console, number, table, write_json
from zygos.plant import Trajectory, simulate
from zygos.reference.cycle import calibrate
from zygos.scenario import Scenario, load_scenario
from zygos.score import Score, score

Floats = NDArray[np.float64]

NOISE = (
    "encoders: quantum q = 0.003 rad (500 lines, decoded fourfold), white, variance q²/12 = 7.5e-7 rad²; "
    "gyro: white part 0.31623 µrad/s^½, bias walk 3.1623e-4 µrad/s^1.5; torque exact"
)
PRINTED = {
    "AMC": "fails",
    "DE": "about +100 % (the sign reads flipped: −99 %)",
    "EB": "4 to 9 %",
    "EB, exact data": "1e-6 %",
}
"""What the paper itself reports of each method, as far as its conditions are known."""


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


def run_paper(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print Tables III and IV; see `zygos paper --help`."""
    example = load_example(folder)
    check_outputs([json], example.files)
    arm, true = example.arm, example.true
    model = load_model(example.scenario.plant)
    momentum = example.scenario.angular_momentum_nms
    if arm.spatial or not arm.free or isinstance(momentum, tuple):
        raise ZygosError(
            f"arm {arm.name}: the paper's methods are those of a free-floating arm that moves in a plane; remedy: "
            "`zygos estimate` for any other"
        )
    with progress() as bar:
        task = bar.add_task(f"simulating {seeds} seeds", total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)

        noisy = simulate(arm, model, example.scenario, seeds=range(seeds), noise=True, progress=show)
        bar.update(task, description="simulating without noise", completed=0.0)
        clean = simulate(arm, model, example.scenario, seeds=[0], noise=False, progress=show)
    record, exact = noisy_record(arm, noisy), exact_record(clean)
    estimates: dict[str, Floats] = {
        "AMC": amc.estimate(arm, record, momentum_nms=momentum),
        "DE": de.estimate(arm, record),
        "EB": eb.estimate(arm, record, rates="backward", start="rest"),
        "flight (C, CAN)": flight_estimates(arm, noisy),
        "EB, exact data": eb.estimate(arm, exact, rates="exact", start="rest"),
        "flight, no noise": flight_estimates(arm, clean),
    }
    scores = {name: score(value, true) for name, value in estimates.items()}
    content = {
        "seeds": seeds,
        "duration_s": example.scenario.duration_s,
        "noise": NOISE,
        "methods": [_summary(name, estimates[name], scores[name], arm.parameter_names) for name in estimates],
    }
    if json:
        write_json(json, content)
    if json == "-":
        return
    noisy_names = ("AMC", "DE", "EB", "flight (C, CAN)")
    console.print(f"Noise, as read here: {NOISE}.", highlight=False, soft_wrap=True)
    console.print(f"{seeds} seeds, {example.scenario.duration_s:g} s at {1 / arm.period_s:g} Hz\n", highlight=False)
    _table_3(arm, true, noisy_names, estimates)
    _table_4(arm, noisy_names, scores, PRINTED)


def _summary(name: str, value: Floats, result: Score, parameters: Sequence[str]) -> dict[str, object]:
    seen = np.isfinite(result.rms)
    return {
        "method": name,
        "seen": int(seen.sum()),
        "mean_rms_percent": float(np.mean(result.rms[seen])),
        "max_rms_percent": float(np.max(result.rms[seen])),
        "per_parameter": {
            n: {"mean": float(v), "rms_percent": float(r)}
            for n, v, r in zip(parameters, value.mean(axis=0), result.rms, strict=True)
        },
    }


def _table_3(arm: Arm, true: Floats, names: Sequence[str], estimates: dict[str, Floats]) -> None:
    means = [estimates[name].mean(axis=0) for name in names]
    table(
        ("parameter", "unit", "true", *names),
        [
            (n, u, number(float(t), 9), *(number(float(mean[k]), 6) for mean in means))
            for k, (n, u, t) in enumerate(zip(arm.parameter_names, arm.parameter_units, true, strict=True))
        ],
        title="Table III, on this run: estimates, mean over the seeds",
    )
    console.print()


def _table_4(arm: Arm, noisy: Sequence[str], scores: dict[str, Score], printed: dict[str, str]) -> None:
    names = (*noisy, "EB, exact data", "flight, no noise")
    rows = [(n, *(number(float(scores[name].rms[k]), 3) for name in names)) for k, n in enumerate(arm.parameter_names)]
    rows.append(("mean", *(number(float(np.nanmean(scores[name].rms)), 3) for name in names)))
    rows.append(("largest", *(number(float(np.nanmax(scores[name].rms)), 3) for name in names)))
    table(("parameter", *names), rows, title="Table IV, on this run: error, % (rms over the seeds)")
    console.print(
        "\nThe paper reports: " + "; ".join(f"{name}: {text}" for name, text in printed.items()) + ".",
        highlight=False,
        soft_wrap=True,
    )
