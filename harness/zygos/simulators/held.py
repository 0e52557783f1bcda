# SPDX-License-Identifier: MIT
"""What the files of simulators can hold of the effects of the catalogue, and what a control loop has to do instead."""

from __future__ import annotations

from collections.abc import Sequence

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.simulators.robot import Format

_SIZES = {
    "viscous_asymmetry": "-c * m * abs(v)",
    "link_viscous_asymmetry": "-c * abs(v)",
    "load_friction": "-c * abs(tau[j]) * np.tanh(v / 0.01)",
    "torque_gain": "c * tau[j]",
    "torque_offset": "-c * m",
    "motor_stribeck": "-c * m * np.exp(-((v / s) ** 2)) * np.clip(v / 1e-3, -1, 1)",
    "link_stribeck": "-c * np.exp(-((v / s) ** 2)) * np.clip(v / 1e-3, -1, 1)",
    "ripple_sin": "c * m * np.sin(s * n * a)",
    "ripple_cos": "c * m * np.cos(s * n * a)",
}
"""Torque at a joint, or at its rotor where it is flexible (Nm), of effects that are functions of the instant. c: the
coefficient, s: the shape, n: the gear ratio; a, v: angle and rate after the gear; tau: the torques of the actuators;
m: what the torque of a motor is multiplied with there, n at a joint and 1 at a rotor."""


def kept_by(file: Format, arm: Arm, effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """The effects of an arm that a file of this format holds, and those that it cannot."""
    # a tendon with a cubic stiffness, and one with a gap, have their zero where the spring is relaxed
    about_zero = {one.joint for one in effects if one.kind.key in ("cubic_stiffness", "backlash")}
    held = []
    for one in effects:
        one.index(arm)
        holds = (one.kind.mjcf if file == "MJCF" else one.kind.urdf).holds
        if holds and not (one.kind.key == "spring_offset" and one.joint in about_zero):
            held.append(one)
    return tuple(held), tuple(one for one in effects if one not in held)


def in_snippet(lost: Sequence[Effect]) -> list[Effect]:
    """Those that lines in the control loop can add; errors of sensors and a base's momentum are no part of a robot."""
    return [one for one in lost if one.kind.mjcf.how != "no" or one.kind.key == "rotor_coupling"]


def snippet(arm: Arm, lost: Sequence[Effect]) -> str:
    """Python for the loop that controls the simulation, with the torques of effects that its file cannot hold.

    An effect with a memory, or of an own law, is named in a comment, with its law in words.
    """
    flexible = any(joint.flexible for joint in arm.joints)
    names = [joint.name for joint in arm.joints] + [f"rotor of {joint.name}" for joint in arm.joints if flexible]
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
        f'    """Nm at the joints {", ".join(names)}."""',
        "    out = np.zeros_like(tau)",
    ]
    for one in in_snippet(lost):
        j = one.index(arm)
        n, s = float(arm.gear_ratios[j]), "None" if one.shape is None else repr(one.shape)
        where = one.kind.title if one.joint is None else f"{one.kind.title}, {one.joint}"
        if one.kind.key in _SIZES:
            rotor = arm.joints[j].flexible and one.kind.side == "motor"
            at, a, v, m = (arm.n + j, "q[j] / n", "qd[j] / n", 1.0) if rotor else (j, "q[j]", "qd[j]", n)
            lines.append(f"    j, n, c, s, m = {at}, {n!r}, {one.value!r}, {s}, {m!r}  # {where}")
            lines.append(f"    a, v = {a}, {v}")
            lines.append(f"    out[j] += {_SIZES[one.kind.key]}")
        elif one.kind.lags:
            lines.append(f"    # {where}: apply the torque of joint {j} later by {one.value!r} s")
        else:
            lines.append(f"    # {where}: c = {one.value!r} {one.kind.unit}, shape {s}; law f: {one.kind.formula}")
    return "\n".join([*lines, "    return out", ""])
