# SPDX-License-Identifier: MIT
"""Effects without a column, too small to be seen in `cluster` alone: how many wrong values are called doubtful."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_support import with_gain_sigma
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import TORQUE_GAIN_SIGMA, Arm, Encoder, load_arm
from zygos.effects import effect
from zygos.model.model import load_model
from zygos.native.flight import REASONS, Flight, encode
from zygos.simulation.plant import record
from zygos.simulation.scenario import load_scenario
from zygos.simulation.sensors import draw_noise

pytestmark = pytest.mark.slow

CLUSTER_LIMIT, UNCLOSED = 5.0, REASONS[6]
HIDDEN = (
    ("motor_coulomb", 0, 0.14, None),
    ("motor_coulomb", 1, 0.22, None),
    ("cubic_stiffness", 0, 40.0, None),
    ("cubic_stiffness", 1, 40.0, None),
    ("backlash", 0, 1000.0, 0.02),
    ("backlash", 1, 1000.0, 0.02),
)
"""Coulomb friction of 1 % of the typical torque, springs that are 10 % stiffer at the largest deflection, and backlash
of 0.02 rad to each side."""
SEEDS = 12


@pytest.mark.parametrize("sigma", [0.0, TORQUE_GAIN_SIGMA])
def test_half_of_the_wrong_values_are_doubted(sigma: float) -> None:
    """Of the runs with a value that is more than 5 sigmas and 2 % off, and in which the residuals look like noise."""
    wrong, caught, worst = 0, 0, 0.0
    for example in ("paper", "lively"):
        folder = ROOT / "examples" / example
        arm = load_arm(folder / "arm.toml")
        known = with_gain_sigma(arm, sigma)
        model, scenario = load_model(folder / "model.toml"), load_scenario(folder / "scenario.toml")
        true = model.base_values(known)
        for key, joint, value, shape in HIDDEN:
            plant = replace(model, effects=(effect(key, known.joints[joint].name, value, shape=shape),))
            motion = replace(trajectory_of(arm, plant, scenario, seeds=range(SEEDS), noise=True), arm=known)
            for seed in range(SEEDS):
                flight = Flight(known)
                flight.frames(encode(known, record(motion, seed)))
                found = flight.estimate()
                off = np.abs(found.value[: len(true)] - true)
                far = (off > 5.0 * found.sigma[: len(true)]) & (off > 0.02 * np.abs(true))
                if found.cluster > CLUSTER_LIMIT or not far.any():
                    continue
                wrong, caught = wrong + 1, caught + (found.reason == UNCLOSED)
                if found.reason != UNCLOSED:
                    worst = max(worst, float((off / np.abs(true))[far].max()))
    others = f"the worst value of the others is {100.0 * worst:.1f} % off"
    print(f"declared gains {sigma}: {caught} of {wrong} doubted, {others}")
    assert wrong >= 24
    assert caught >= 0.45 * wrong


@pytest.mark.parametrize("sigma", [0.0, TORQUE_GAIN_SIGMA])
def test_sound_runs_are_not_doubted(sigma: float) -> None:
    """At most one in a hundred, with noise as declared, and 0.7 and 1.4 times as large."""
    alarms, runs = 0, 0
    for example in ("paper", "lively"):
        folder = ROOT / "examples" / example
        arm = load_arm(folder / "arm.toml")
        known = with_gain_sigma(arm, sigma)
        model, scenario = load_model(folder / "model.toml"), load_scenario(folder / "scenario.toml")
        motion = trajectory_of(arm, model, scenario, seeds=range(SEEDS), noise=True)
        for share in (0.7, 1.0, 1.4):
            plant = scaled(known, share)
            for draw in range(3):
                noise = draw_noise(plant, len(motion.t), [1000 * draw + seed for seed in range(SEEDS)])
                for seed in range(SEEDS):
                    flight = Flight(known)
                    flight.frames(encode(known, record(replace(motion, arm=plant, noise=noise), seed)))
                    found = flight.estimate()
                    alarms, runs = alarms + (found.reason == UNCLOSED), runs + 1
    print(f"declared gains {sigma}: {alarms} of {runs} sound runs doubted because the balance does not close")
    assert alarms <= 0.01 * runs


def scaled(arm: Arm, share: float) -> Arm:
    """The arm with encoders whose noise is so many times as large."""

    def of(encoder: Encoder) -> Encoder:
        return replace(encoder, quantum_rad=share * encoder.quantum_rad)

    joints = (
        replace(one, link_encoder=of(one.link_encoder), motor_encoder=of(one.motor_encoder)) for one in arm.joints
    )
    return replace(arm, joints=tuple(joints))
