# SPDX-License-Identifier: MIT
"""Columns of the joint rows: derivatives of the energy's columns, which share no formula with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from zygos.arm import NO_IMU, Arm, load_arm
from zygos.balances.energy import energy_columns
from zygos.balances.joint import joint_columns
from zygos.balances.state import State

EXAMPLES = Path(__file__).parents[2] / "examples"
STEP = 1e-6


def _arms() -> list[Arm]:
    spatial, seven, plane = (load_arm(EXAMPLES / name / "arm.toml") for name in ("spatial", "seven", "lively"))
    free = [spatial, seven, plane, replace(plane, kinetic="planar")]
    fixed = [replace(arm, base="fixed", imu=NO_IMU, gravity=(1.0, 2.0, -9.0)) for arm in free]
    rigid = [
        replace(arm, joints=tuple(replace(joint, flexible=False) for joint in arm.joints)) for arm in (*free, *fixed)
    ]
    return [*free, *fixed, *rigid]


@pytest.mark.parametrize("arm", _arms(), ids=lambda arm: f"{arm.name}-{arm.base}-{arm.joints[0].flexible}")
def test_columns_are_derivatives_of_the_energy(arm: Arm) -> None:
    rng = np.random.default_rng(0)
    q, qd, theta, thetad = rng.normal(size=(4, 5, arm.n))
    rigid = not arm.joints[0].flexible
    if rigid:
        theta, thetad = q, qd
    state = State(q, theta, qd, thetad, rng.normal(size=(5, 3) if arm.spatial else 5))
    columns = joint_columns(arm, state)
    bodies = columns.momentum.shape[-1]
    weights = 2 * sum(arm.feels_gravity)
    sign = np.where(np.arange(bodies) < bodies - weights, 1.0, -1.0)  # the potential energy acts the other way

    def slope(change: Callable[[NDArray[np.float64]], State], unit: NDArray[np.float64]) -> NDArray[np.float64]:
        ahead, behind = (energy_columns(arm, change(s * STEP * unit), np.zeros_like(q)) for s in (1.0, -1.0))
        return (ahead - behind) / (2.0 * STEP)

    for j in range(arm.n):
        unit = np.eye(arm.n)[j]
        by_rate = slope(lambda d: replace(state, qd=qd + d, thetad=thetad + rigid * d), unit)
        by_angle = slope(lambda d: replace(state, q=q + d, theta=theta + d), unit)
        np.testing.assert_allclose(columns.momentum[:, j], by_rate[:, :bodies], atol=1e-7)
        np.testing.assert_allclose(columns.force[:, j], (sign * by_angle[:, :bodies]), atol=1e-7)
        for k, (kind, i, _) in enumerate(arm.joint_parameters):
            if kind == "Im":
                np.testing.assert_allclose(columns.rotor_momentum[:, j, i], by_rate[:, bodies + k], atol=1e-5)
                np.testing.assert_allclose(columns.rotor_force[:, j, i], by_angle[:, bodies + k], atol=1e-5)
