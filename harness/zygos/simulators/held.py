# SPDX-License-Identifier: MIT
"""What the files of simulators can hold of the effects of the catalogue, and what a control loop has to do instead."""

from __future__ import annotations

from collections.abc import Sequence

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.simulators.robot import Format

_SIZES = {
    "viscous_asymmetry": "-c * n * abs(qd[j])",
    "link_viscous_asymmetry": "-c * abs(qd[j])",
    "load_friction": "-c * abs(tau[j]) * np.tanh(qd[j] / 0.01)",
    "torque_gain": "c * tau[j]",
    "torque_offset": "-c * n",
    "motor_stribeck": "-c * n * np.exp(-((qd[j] / s) ** 2)) * np.clip(qd[j] / 1e-3, -1, 1)",
    "link_stribeck": "-c * np.exp(-((qd[j] / s) ** 2)) * np.clip(qd[j] / 1e-3, -1, 1)",
    "ripple_sin": "c * n * np.sin(s * n * q[j])",
    "ripple_cos": "c * n * np.cos(s * n * q[j])",
}
"""Torque at a joint (Nm) of effects that are functions of the instant. c: the coefficient, s: the shape, n: the gear
ratio; q, qd, tau: angles, rates and the torques of the actuators at the joints."""


def kept_by(file: Format, arm: Arm, effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """The effects of an arm with rigid joints that a file of this format holds, and those that it cannot."""
    for one in effects:
        one.index(arm)
    held = tuple(one for one in effects if (one.kind.mjcf if file == "MJCF" else one.kind.urdf).holds)
    return held, tuple(one for one in effects if one not in held)


def snippet(arm: Arm, lost: Sequence[Effect]) -> str:
    """Python for the loop that controls the simulation, with the torques of effects that its file cannot hold.

    An effect with a memory, or of an own law, is named in a comment, with its law in words.
    """
    lines = [
        '"""Torques of the effects that the corrected file cannot hold. In the control loop:',
        "",
        "    data.qfrc_applied[dofs] = extra(data.qpos[qs], data.qvel[dofs], data.qfrc_actuator[dofs])",
        '"""',
        "",
        "import numpy as np",
        "",
        "",
        "def extra(q, qd, tau):",
        f'    """Nm at the joints {", ".join(joint.name for joint in arm.joints)}."""',
        "    out = np.zeros_like(tau)",
    ]
    for one in lost:
        j = one.index(arm)
        n, s = float(arm.gear_ratios[j]), "None" if one.shape is None else repr(one.shape)
        where = f"{one.kind.title}, {one.joint}"
        if one.kind.key in _SIZES:
            lines.append(f"    j, n, c, s = {j}, {n!r}, {one.value!r}, {s}  # {where}")
            lines.append(f"    out[j] += {_SIZES[one.kind.key]}")
        elif one.kind.lags:
            lines.append(f"    # {where}: apply the torque of joint {j} later by {one.value!r} s")
        else:
            lines.append(f"    # {where}: c = {one.value!r} {one.kind.unit}, shape {s}; law f: {one.kind.formula}")
    return "\n".join([*lines, "    return out", ""])
