# SPDX-License-Identifier: MIT
"""Arm files of any size, and runs of them, for tests of what an arm puts on the wire."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from zygos.arm import Arm
from zygos.runs.cycles import Cycles

SEVEN_NODES = (31, 3, 17, 1, 29, 5, 11)
"""Odd node numbers of a seven-joint arm, out of order."""


def arm_text(
    names: Sequence[str],
    nodes: Sequence[int],
    *,
    gyro: str | None = "fine",
    imu_node: int = 9,
    kinetic: str = "",
    period_s: float = 0.02,
) -> str:
    """An arm file with these joints; a fixed base where there is no gyro. Each joint has zeros and a latch of its own,
    and every second one counts backwards."""
    kinetic = kinetic or ("planar" if gyro is None else "planar-symmetric")
    base = 'base = "fixed"\ngravity = [0, -9.81, 0]' if gyro is None else 'base = "free"'
    lines = [f'name = "made up"\n{base}\nkinetic = "{kinetic}"\nperiod_s = {period_s}']
    lines.append('torque_law = "sampled"\ntorque_at = "rotor"')
    for i, (name, node) in enumerate(zip(names, nodes, strict=True)):
        lines.append(f"[[joint]]\nname = {json.dumps(name)}\nnode = {node}\naxis = [0, 0, 1]\ngear_ratio = 50")
        lines.append(
            f"latch_us = {10 * i}\nlink_encoder = {{ counts = 4096, sign = {(-1) ** i}, zero_rad = {0.25 * i} }}"
        )
        lines.append('motor_encoder = { counts = 4096, side = "rotor" }')
    if gyro is not None:
        lines.append(f'[imu]\nnode = {imu_node}\nrate_sigma = 1e-4\nbias_walk = 1e-6\nresolution = "{gyro}"')
    return "\n".join(lines) + "\n"


def wandering(arm: Arm, n: int, seed: int) -> Cycles:
    """n cycles that wander through the wire's ranges at random: eight turns either way, 800 Nm, 3.9 rad/s."""
    rng = np.random.default_rng(seed)
    q, theta = np.clip(np.cumsum(rng.normal(0.0, 3.0, (2, n, arm.n)), axis=1), -50.0, 50.0)
    return Cycles(
        sync=np.arange(1, n + 1, dtype=np.uint64),
        q=q,
        theta=theta,
        tau=rng.uniform(-800.0, 800.0, (n, arm.n)),
        omega=rng.uniform(-3.9, 3.9, (n, 3)) * arm.free,
        flags=np.zeros(n, dtype=np.uint32),
    )
