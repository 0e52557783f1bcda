# SPDX-License-Identifier: MIT
"""Gains of torque sensors from 0.8 to 1.3 on arms of two and three joints: no value is wrong and confident."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import pytest
from arm_support import with_gain_sigma
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import TORQUE_GAIN_SIGMA, load_arm
from zygos.model.model import load_model
from zygos.native.flight import Flight, encode
from zygos.simulation.plant import record
from zygos.simulation.scenario import load_scenario
from zygos.simulation.sensors import draw_noise

pytestmark = pytest.mark.slow

GAINS = (0.8, 0.9, 0.95, 0.99, 1.0, 1.01, 1.05, 1.1, 1.2, 1.3)


@dataclass(frozen=True)
class Runs:
    example: str
    motions: int
    draws: int
    """Draws of the sensors' noise for each motion and gain."""
    duration_s: float = 60.0


@pytest.mark.parametrize(
    "runs",
    [
        Runs("paper", 6, 1),
        Runs("lively", 6, 1),
        Runs("spatial", 1, 2),
        Runs("lively", 1, 1, 900.0),
    ],
    ids=lambda runs: f"{runs.example}-{runs.duration_s:g}",
)
def test_no_gain_makes_a_value_wrong_and_confident(runs: Runs) -> None:
    """The sensor of each joint in turn. Nothing that is valid or partial is more than 5 sigmas and 2 % off; the gain is
    found; the intervals of sound sensors hold."""
    folder = ROOT / "examples" / runs.example
    arm, model = with_gain_sigma(load_arm(folder / "arm.toml"), TORQUE_GAIN_SIGMA), load_model(folder / "model.toml")
    scenario = load_scenario(folder / "scenario.toml")
    motion = trajectory_of(arm, model, scenario, seeds=range(runs.motions), noise=True, duration_s=runs.duration_s)
    numbers = [[1000 * draw + seed for seed in range(runs.motions)] for draw in range(runs.draws)]
    noises = [draw_noise(arm, len(motion.t), of) for of in numbers]
    told: Counter[tuple[float, str]] = Counter()
    inside: list[NDArray[np.bool_]] = []
    for number, gain in enumerate(GAINS):
        for k in range(runs.motions * runs.draws):
            joint = (number + k) % arm.n
            gains = np.where(np.arange(arm.n) == joint, gain, 1.0)
            scaled = replace(motion, tau=motion.tau * gains, noise=noises[k // runs.motions])
            flight = Flight(arm)
            flight.frames(encode(arm, record(scaled, k % runs.motions)))
            found = flight.estimate()
            told[gain, found.reason or found.validity] += 1
            unit = float(gains[arm.gain_reference])
            true = np.concatenate([
                unit * model.base_values(arm), [unit / gains[i] - 1.0 for i in arm.relative_gains]
            ])  # fmt: skip
            off, p = np.abs(found.value - true), len(arm.parameters)
            if found.validity in ("valid", "partial"):
                wrong = (off > 5.0 * found.sigma) & (off > 0.02 * np.abs(true))
                assert not wrong[:p].any(), (gain, joint, np.array(found.names)[wrong])
            if np.isfinite(found.value).any():
                assert np.nanmax((off / found.sigma)[p:]) < 6.0
            if gain == 1.0:
                inside.append((off <= found.half95)[np.isfinite(found.value)])
    print(runs, dict(told), "coverage of sound sensors", np.mean(np.concatenate(inside)))
    assert np.mean(np.concatenate(inside)) > 0.93 - 3.0 * np.sqrt(0.05 * 0.95 / len(np.concatenate(inside)))
