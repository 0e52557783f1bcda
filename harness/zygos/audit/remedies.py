# SPDX-License-Identifier: MIT
"""What a finding proposes: keys of the arm file or of the map of `zygos convert`, with their values.

Every key that a finding proposes is made here. `tests/bus/test_remedies.py` carries each out on a run with its fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos import limits
from zygos.arm import Arm, Encoder, Joint, TorqueLaw

Value = float | int | str | tuple[float, ...]
Kind = Literal["q", "theta", "tau", "omega"]
"""Field of `Cycles`."""
KINDS: tuple[Kind, ...] = ("q", "theta", "tau")
"""Those of a joint."""
ANGLES: tuple[Kind, ...] = ("q", "theta")

IN_MAP = {"q": "link", "theta": "motor", "tau": "torque"}
"""Table of a reading in the map, by field of `Cycles`; that of the gyro has its axis."""
IN_ARM = {"q": "link_encoder", "theta": "motor_encoder"}
"""Table of an encoder in the arm file."""


@dataclass(frozen=True)
class Setting:
    """A key and the value that it should have."""

    file: Literal["arm", "map"]
    """The arm file, or the map with which `zygos convert` makes a run of the recording."""
    table: tuple[str, ...]
    """Table of the key: ("joint", name of the joint, "motor_encoder"), ("gyro", "x"), or () for the top of the file."""
    key: str
    value: Value

    def __str__(self) -> str:
        """As a person writes it."""
        if isinstance(self.value, str):
            value = f'"{self.value}"'
        elif isinstance(self.value, tuple):
            value = f"[{', '.join(f'{one:.6g}' for one in self.value)}]"
        else:
            value = str(self.value)
        return f"{self.key} = {value}"


@dataclass(frozen=True)
class Remedy:
    """What removes the cause of a finding."""

    text: str
    settings: tuple[Setting, ...] = ()
    """The keys that the text proposes; all of them together. Empty where no key helps."""


def _encoder(arm: Arm, kind: Kind, i: int) -> tuple[Joint, Encoder]:
    joint = arm.joints[i]
    return joint, joint.link_encoder if kind == "q" and joint.flexible else joint.motor_encoder


def _in_arm(arm: Arm, kind: Kind, i: int, key: str, value: Value) -> Setting:
    """A key of an encoder, or of a joint where kind is "tau"."""
    name = arm.joints[i].name
    return Setting("arm", ("joint", name, IN_ARM[kind]) if kind in IN_ARM else ("joint", name), key, value)


def _in_map(arm: Arm, kind: Kind, i: int, key: str, value: Value) -> Setting:
    table = ("gyro", "xyz"[i]) if kind == "omega" else ("joint", arm.joints[i].name, IN_MAP[kind])
    return Setting("map", table, key, value)


def _of_map(setting: Setting) -> str:
    """Where a key of the map belongs, in words."""
    return f"{setting} of {'the gyro' if setting.table[0] == 'gyro' else setting.table[2]} in the map (`zygos convert`)"


def period(period_s: float) -> Remedy:
    """Of a SYNC period that is not the declared one."""
    setting = Setting("arm", (), "period_s", float(f"{period_s:.6g}"))
    return Remedy(str(setting), (setting,))


def steps(arm: Arm, kind: Kind, i: int, step: float) -> Remedy:
    """Of an angle that moves in steps (rad, after the gear) which are not the declared ones."""
    setting = _quantum(arm, kind, i, step)
    return Remedy(f"{setting} of the {setting.table[2]}", (setting,))


def _quantum(arm: Arm, kind: Kind, i: int, step: float) -> Setting:
    """The key that declares a step: the one that the arm file has, for the encoder's own disc."""
    joint, encoder = _encoder(arm, kind, i)
    own = step * (joint.gear_ratio if encoder.side == "rotor" and kind == "theta" else 1.0)
    if encoder.counts is not None and own < 0.5 * math.pi:
        return _in_arm(arm, kind, i, "counts", round(2.0 * math.pi / own))
    return _in_arm(arm, kind, i, "quantum_rad", float(f"{own:.6g}"))


def noisy_angle(arm: Arm, kind: Kind, i: int, noise: float) -> Remedy:
    """Of an angle whose noise (rad) is white and larger than the declared one."""
    setting = _quantum(arm, kind, i, math.sqrt(12.0) * noise)
    return Remedy(f"repair the sensor, or state its noise: {setting} of the {setting.table[2]}", (setting,))


def noisy_gyro(noise: float) -> Remedy:
    """Of a gyro whose noise (rad/s) is larger than the declared one."""
    setting = Setting("arm", ("imu",), "rate_sigma", float(f"{noise:.3g}"))
    return Remedy(f"repair the sensor, or state its noise: {setting} of [imu]", (setting,))


def noisy_torque(arm: Arm, i: int, noise: float) -> Remedy:
    """Of a torque whose noise is larger than the declared one. Where it is so by a unit, this is said first; a scale
    that all torques have in common shows nowhere else."""
    setting = _in_arm(arm, "tau", i, "torque_sigma", float(f"{noise:.2g}"))
    text = (
        f"{setting} of the joint; nothing if the drive really applies torques that change so much from cycle to cycle"
    )
    sigma = arm.joints[i].torque_sigma
    if arm.torque_unit == "Nm" and sigma > 0.0 and noise > limits.UNIT_NOISE.value * sigma:
        text = (
            'check the unit: of currents, unit = "mA" and torque_constant of torque in the map (`zygos convert`), '
            f'about {1e3 * sigma / noise:.1g} Nm/A if torque_sigma is right; of mNm, unit = "mNm"; only if it is Nm, '
            f"{text}"
        )
    ratio = float(arm.joints[i].gear_ratio)
    off = limits.SCALE_OFF.value
    if arm.torque_at == "rotor" and sigma > 0.0 and off**2 < ratio and ratio / off < noise / sigma < ratio * off:
        side = _in_map(arm, "tau", i, "at", "output")
        text = f"if the torque is measured behind the gear, {_of_map(side)}; else {text}"
    return Remedy(text, (setting,))


def inverted(arm: Arm, kind: Kind, i: int) -> Remedy:
    """Of one reading with the wrong sign."""
    if kind in IN_ARM:
        setting = _in_arm(arm, kind, i, "sign", -_encoder(arm, kind, i)[1].sign)
        return Remedy(f"{setting} of the {setting.table[2]}", (setting,))
    setting = _in_map(arm, kind, i, "sign", -1)
    return Remedy(f"change its sign in the drive, or write {_of_map(setting)}", (setting,))


def swapped(arm: Arm, kind: Kind, i: int, j: int) -> Remedy:
    """Of a reading that is that of another joint, or of another axis of the gyro. The value of "source" in the settings
    names the table whose source it should have."""
    source = _in_map(arm, kind, j, "source", "").table
    setting = _in_map(arm, kind, i, "source", ".".join(source))
    return Remedy(
        "exchange the sources of the two in the map (`zygos convert`), or the nodes of the drives", (setting,)
    )


def exchanged(arm: Arm, i: int) -> Remedy:
    """Of link and motor encoder of a joint that are exchanged."""
    name = arm.joints[i].name
    settings = tuple(
        Setting("map", ("joint", name, one), "source", f"joint.{name}.{other}")
        for one, other in (("link", "motor"), ("motor", "link"))
    )
    return Remedy(
        "exchange the sources of link and motor in the map (`zygos convert`), or the two encoders at the drive",
        settings,
    )


def unit(arm: Arm, kind: Kind, i: int, name: str, factor: float) -> Remedy:
    """Of a reading in another unit than that of the run; factor: SI units per unit."""
    setting = _in_map(arm, kind, i, "unit", name)
    if name != "counts":
        return Remedy(_of_map(setting), (setting,))
    encoder = _encoder(arm, kind, i)[1]
    as_declared = abs(factor / encoder.quantum_rad - 1.0) < 1e-9
    turn = encoder.counts if as_declared and encoder.counts is not None else float(f"{2.0 * math.pi / factor:.6g}")
    counts = _in_map(arm, kind, i, "counts_per_turn", turn)
    return Remedy(f"{setting} and {_of_map(counts)}", (setting, counts))


def scaled(arm: Arm, kind: Kind, i: int, factor: float) -> Remedy:
    """Of a reading that has to be multiplied by a factor which is no unit's."""
    ratio = float(arm.joints[i].gear_ratio) if kind != "omega" else 1.0
    setting = _in_map(arm, kind, i, "scale", float(f"{factor:.6g}"))
    text = _of_map(setting)
    if kind in IN_ARM and abs(math.log(factor * ratio)) < 1e-6:
        text = f'angles are after the gear: side = "rotor" of the {IN_MAP[kind]} in the map, or {text}'
    return Remedy(text, (setting,))


INVERSE = "; if the torque of the other joint is wrong instead, the inverse factor there"


def other_side(arm: Arm, i: int, factor: float) -> bool:
    """Whether a torque that has to be multiplied by this factor is measured on the other side of its gear."""
    ratio = float(arm.joints[i].gear_ratio)
    wanted = 1.0 / ratio if arm.torque_at == "rotor" else ratio
    off = limits.SCALE_OFF.value
    return ratio > off**2 and abs(math.log(factor / wanted)) <= math.log(off)


def torque_scale(arm: Arm, i: int, factor: float) -> Remedy:
    """Of a torque that has to be multiplied by a factor which is no unit's. Of two joints, the law does not say which
    of the torques is the wrong one."""
    if not other_side(arm, i, factor):
        if arm.torque_at == "joint":
            setting = _in_map(arm, "tau", i, "scale", float(f"{factor:.4g}"))
            text = f"{_of_map(setting)}, or the unit where the torque is measured"
        else:
            setting = _in_arm(arm, "tau", i, "gear_ratio", float(f"{arm.joints[i].gear_ratio * factor:.4g}"))
            text = f"{setting} of the joint, or the unit or the torque constant where the torque is measured"
        other = INVERSE
    elif arm.torque_at == "joint":
        setting = _in_map(arm, "tau", i, "scale", float(arm.joints[i].gear_ratio))
        text, other = f"measured before the gear: {_of_map(setting)}", INVERSE
    else:
        setting = _in_map(arm, "tau", i, "at", "output")
        text = f"measured behind the gear: {_of_map(setting)}"
        other = '; if the other joint has the wrong side instead, at = "rotor" of its torque'
    return Remedy(text + (other if arm.n == 2 else ""), (setting,))


def wraps(arm: Arm, kind: Kind, i: int, modulo: float) -> Remedy:
    """Of an angle that starts again after a turn."""
    setting = _in_map(arm, kind, i, "modulo", float(f"{modulo:.12g}"))
    return Remedy(
        "`zygos convert RUN --arm ARM.toml -o NEW`, which unwraps it; where RUN was converted, the key modulo of the "
        f"{setting.table[2]} in its map as well",
        (setting,),
    )


def zero(arm: Arm, i: int, off_rad: float) -> Remedy:
    """Of a link angle that is off_rad too large where the spring carries no torque."""
    encoder = arm.joints[i].link_encoder
    setting = _in_arm(arm, "q", i, "zero_rad", float(f"{encoder.zero_rad + encoder.sign * off_rad:.6g}"))
    return Remedy(
        f"{setting} of the link_encoder, or the same change in the opposite direction of the motor_encoder; a bias of "
        "the torque looks the same",
        (setting,),
    )


def skew(arm: Arm, i: int, skew_s: float) -> Remedy:
    """Of two encoders of a joint that are read at different times; skew_s > 0: the motor's later."""
    newer: Kind = "theta" if skew_s > 0.0 else "q"
    older: Kind = "q" if skew_s > 0.0 else "theta"
    latch = _latch(arm, newer, i, abs(skew_s))
    if latch is None:
        return delay(arm, older, [i], abs(skew_s))
    return Remedy(
        f"{latch} of the {latch.table[-1]}; if instead the {IN_MAP[older]} angle is old, torque and gyro are newer as "
        "well",
        (latch,),
    )


def _latch(arm: Arm, kind: Kind, i: int, later_s: float) -> Setting | None:
    """The key for a sensor that is read later_s later than the arm file says; None where the period has no room."""
    if kind == "omega":
        before, latch = 0, arm.imu.latch_us
    else:
        joint, encoder = _encoder(arm, kind, i)
        before, latch = joint.latch_us, encoder.latch_us
    latch += round(1e6 * later_s)
    if before + latch + 0.5 >= 1e6 * arm.period_s:
        return None
    return Setting("arm", ("imu",), "latch_us", latch) if kind == "omega" else _in_arm(arm, kind, i, "latch_us", latch)


def delay(arm: Arm, kind: Kind, columns: Sequence[int], delay_s: float, *, both: bool = False) -> Remedy:
    """Of readings of one kind, or of both angles, that are older than their stamps by delay_s; negative: newer."""
    latches = [None if kind == "tau" or delay_s > 0.0 or both else _latch(arm, kind, i, -delay_s) for i in columns]
    if None not in latches:
        settings = tuple(dict.fromkeys(latch for latch in latches if latch is not None))
        return Remedy(f"{settings[0]} of {'[imu]' if kind == 'omega' else f'the {settings[0].table[-1]}'}", settings)
    kinds: list[tuple[Kind, int]] = [(kind, i) for i in columns]
    kinds += [("q", i) for i in columns if both and arm.joints[i].flexible]
    settings = tuple(_in_map(arm, one, i, "delay_s", float(f"{delay_s:.4g}")) for one, i in kinds)
    more = "; of link as well" if both and len(kinds) > len(columns) else ""
    if kind == "tau" and delay_s < 0.0:
        more = "; of a drive that acts later: the effect torque_lag of a model (`zygos estimate --model`)"
    return Remedy(_of_map(settings[0]) + more, settings)


def torque_law(law: TorqueLaw) -> Remedy:
    """Of a torque law under which the balance closes worse than under this one."""
    setting = Setting("arm", (), "torque_law", law)
    return Remedy(str(setting), (setting,))


def mount(arm: Arm, turn: NDArray[np.float64]) -> Remedy:
    """Of a gyro whose true reading is turn (3, 3) @ reading.

    A rotation goes into the arm file. A reflection is made one by an axis about which the arm does not turn; if it
    turns about all, the map exchanges and inverts axes.
    """
    proper = turn.copy()
    if np.linalg.det(proper) < 0.0 and not arm.spatial:
        proper[int(np.argmin(np.abs(arm.mount.T @ arm.axis)))] *= -1.0
    if np.linalg.det(proper) > 0.0:
        x, y, z, w = (float(one) for one in Rotation.from_matrix(arm.mount @ proper).as_quat())
        setting = Setting("arm", ("imu",), "mount_xyzw", (x, y, z, w))
        return Remedy(f"{setting} of [imu]", (setting,))
    settings: list[Setting] = []
    for i in range(3):
        j = int(np.argmax(np.abs(turn[i])))
        settings += [_in_map(arm, "omega", i, "source", f"gyro.{'xyz'[j]}")] if j != i else []
        settings += [_in_map(arm, "omega", i, "sign", -1)] if turn[i, j] < 0.0 else []
    return Remedy(
        "exchange and invert the axes of the gyro in the map (`zygos convert`), because no mount mirrors",
        tuple(settings),
    )


def turned_joint(arm: Arm, i: int) -> Remedy:
    """Of a joint whose signals are all inverted."""
    joint = arm.joints[i]
    if arm.spatial:
        x, y, z = (-one for one in joint.axis)
        setting = Setting("arm", ("joint", joint.name), "axis", (x, y, z))
        return Remedy(f"{setting} of the joint", (setting,))
    kinds: tuple[Kind, ...] = ("q", "theta") if joint.flexible else ("theta",)
    settings = (*(inverted(arm, kind, i).settings[0] for kind in kinds), inverted(arm, "tau", i).settings[0])
    return Remedy("the other sign of its encoders in the arm file, and of its torque in the map", settings)


def swapped_joints(arm: Arm, i: int, j: int) -> Remedy:
    """Of a joint whose signals are all those of another one."""
    setting = Setting("arm", ("joint", arm.joints[i].name), "node", arm.joints[j].node)
    return Remedy(
        f"exchange the nodes of the two joints ({setting} of this one), or their sources in the map", (setting,)
    )


def smoother(order: int, points: int) -> Remedy:
    """Of a smoother that takes too much off the motion."""
    settings = (Setting("arm", ("smoother",), "order", order), Setting("arm", ("smoother",), "points", points))
    return Remedy(f"order = {order} and points = {points} in [smoother], or slower motion", settings)


def by_hand(text: str) -> Remedy:
    """What no key does."""
    return Remedy(text)
