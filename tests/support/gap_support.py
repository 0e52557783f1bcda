# SPDX-License-Identifier: MIT
"""The gap example, and runs of it that no sensor touched, for the tests of balances, twin and replay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from runs_support import trajectory_of

from zygos.arm import Arm, load_arm
from zygos.balances.readings import Readings
from zygos.effects import CATALOGUE, Effect
from zygos.gap.balances import BalanceRows, Layout
from zygos.model.model import Model, load_model
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario, load_scenario

Floats = NDArray[np.float64]
GAP = Path(__file__).parents[2] / "examples" / "gap"


@cache
def example(run: str = "a") -> tuple[Arm, Model, Scenario]:
    """Arm, model and one of the scenarios a, b, c of examples/gap."""
    return load_arm(GAP / "arm.toml"), load_model(GAP / "cad.toml"), load_scenario(GAP / f"{run}.toml")


@cache
def base_values() -> Floats:
    """(p,) of the example's model."""
    arm, model, _ = example()
    values = model.base_values(arm)
    values.flags.writeable = False
    return values


def effect(arm: Arm, key: str, joint: int, value: float) -> Effect:
    """An entry of the catalogue at a joint (from 0; -1 for the base)."""
    return Effect(CATALOGUE[key], arm.joints[joint].name if joint >= 0 else None, value)


@cache
def moved(run: str, duration_s: float, *effects: Effect) -> Trajectory:
    """A run of the example without noise, with effects in the plant; simulated once a session."""
    arm, model, scenario = example(run)
    return trajectory_of(
        arm, replace(model, effects=effects), scenario, noise=False, duration_s=duration_s, rtol=1e-10, atol=1e-12
    )


@cache
def noisy(run: str, duration_s: float = 16.0) -> Trajectory:
    """A run of the example at 100 Hz with the noise of its sensors, whose servo sees truly quantised encoders."""
    arm, model, scenario = example(run)
    assert scenario.encoder_noise == "quantised"
    return trajectory_of(arm, model, scenario, noise=True, duration_s=duration_s, period_s=0.01, rtol=1e-9, atol=1e-11)


def exact(trajectory: Trajectory) -> Readings:
    """What exact sensors read of a run, as one arc for each seed: the wire's steps would hide small effects."""
    return Readings(trajectory.q, trajectory.theta, trajectory.omega0, trajectory.tau)


def true_columns(arm: Arm, base: Floats) -> Floats:
    """(columns,) coefficients of an arm without effects, whose rotors couple as in nature; base: (p,)."""
    out = np.zeros(len(Layout(arm).columns))
    out[: len(base)] = base
    return out


@dataclass(frozen=True)
class Dense:
    """Balances with every column, at the instants of the rows: of an arm without rows over increments."""

    left: Floats
    """(balances, ..., A, m, columns)"""
    right: Floats
    """(balances, ..., A, m)"""


def dense(rows: BalanceRows) -> Dense:
    """Every balance as one array; a column that a balance has not is 0."""
    parts = []
    for one, used in zip(rows.balances, rows.layout.used, strict=True):
        whole = np.zeros((*one.right.shape, len(rows.layout.columns)))
        whole[..., used] = one.left
        parts.append(whole)
    return Dense(np.stack(parts), np.stack([one.right for one in rows.balances]))


def rms(x: Floats) -> Floats:
    """Root mean square over arcs and instants, the last two axes."""
    return np.asarray(np.sqrt(np.mean(x**2, axis=(-2, -1))), dtype=np.float64)


def centred(x: Floats) -> Floats:
    """About the mean of each arc."""
    return np.asarray(x - x.mean(axis=-1, keepdims=True), dtype=np.float64)
