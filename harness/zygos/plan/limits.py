# SPDX-License-Identifier: MIT
"""Limits that a planned motion keeps: angle, rate and torque of each joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError

Floats = NDArray[np.float64]

ANGLE_RAD = 0.5 * math.pi
"""Largest angle to both sides where none is given, rad."""
RATE_RAD_S = 1.0
"""Largest rate where none is given, rad/s."""


@dataclass(frozen=True)
class Limits:
    """Limits of N joints."""

    low: Floats
    """(N,) smallest angle, rad; -inf where there is no limit."""
    high: Floats
    """(N,) largest angle, rad; inf where there is no limit."""
    rate: Floats
    """(N,) largest rate, rad/s; inf where there is no limit."""
    torque: Floats
    """(N,) largest torque as the frames report it, Nm; inf where there is no limit."""

    @property
    def assumed(self) -> Limits:
        """The same limits, with `ANGLE_RAD` and `RATE_RAD_S` where there is none: a search needs them."""
        return Limits(
            np.where(np.isfinite(self.low), self.low, -ANGLE_RAD),
            np.where(np.isfinite(self.high), self.high, ANGLE_RAD),
            np.where(np.isfinite(self.rate), self.rate, RATE_RAD_S),
            self.torque,
        )

    def violation(self, arm: Arm, angle: Floats, rate: Floats, torque: Floats | None = None) -> str | None:
        """The limit that a motion exceeds most, in words; None if it keeps all.

        angle (m, N) rad, rate (m, N) rad/s, torque (m, N) Nm as the frames report it; None: not judged.
        """
        listed = [
            ("angle", "rad", angle.min(axis=0), self.low, -1.0),
            ("angle", "rad", angle.max(axis=0), self.high, 1.0),
            ("rate", "rad/s", np.abs(rate).max(axis=0), self.rate, 1.0),
        ]
        if torque is not None:
            listed.append(("torque", "Nm", np.abs(torque).max(axis=0), self.torque, 1.0))
        worst: tuple[float, str] = (0.0, "")
        for what, unit, reached, limit, sign in listed:
            over = np.where(np.isfinite(limit), sign * (reached - limit), -1.0) / np.maximum(
                np.minimum(np.abs(limit), 1e9), 1e-9
            )
            at = int(np.argmax(over))
            if over[at] > max(worst[0], 1e-9):
                worst = (
                    float(over[at]),
                    f"the {what} of joint {arm.joints[at].name} reaches {reached[at]:.4g} {unit}, beyond its limit of "
                    f"{limit[at]:.4g} {unit}",
                )
        return worst[1] or None


def limits_of(arm: Arm, angle: str | None, rate: str | None, torque: str | None) -> Limits:
    """Limits from texts such as "1.5", "-2:1", or "shoulder=-2:1,elbow=0:2.4,1.5": entries with a comma between them,
    of which one without a name is for all joints that have none of their own.

    angle: largest angle to both sides, or lowest and highest with a colon, rad. rate: rad/s. torque: as the frames
    report it, Nm. What is not given has no limit. Errors: ZygosError for an unknown joint, for what is no number, and
    for a limit that leaves no room.
    """
    names = [joint.name for joint in arm.joints]
    ranges = [_range(text, name) for name, text in per_joint(names, "angle", angle, "inf").items()]
    low, high = (np.array(side) for side in zip(*ranges, strict=True))
    return Limits(
        low,
        high,
        _largest("rate", per_joint(names, "rate", rate, "inf")),
        _largest("torque", per_joint(names, "torque", torque, "inf")),
    )


def per_joint(names: Sequence[str], what: str, text: str | None, default: str) -> dict[str, str]:
    """The value of each joint, as text, from entries with a comma between them; see `limits_of`."""
    values: dict[str, str] = {}
    for entry in (text or "").split(","):
        name, equals, value = entry.rpartition("=")
        if equals and name.strip() not in names:
            raise ZygosError(
                f"{what} {entry.strip()!r}: the arm has no joint {name.strip()!r}; remedy: one of {', '.join(names)}"
            )
        key = name.strip() if equals else ""
        if key in values:
            raise ZygosError(f"{what} {text!r}: {key or 'all joints'} has two values; remedy: keep one")
        if value.strip():
            values[key] = value.strip()
    return {name: values.get(name, values.get("", default)) for name in names}


def _largest(what: str, texts: Mapping[str, str]) -> Floats:
    values = np.array([as_number(what, text) for text in texts.values()])
    for name, value in zip(texts, values, strict=True):
        if not value > 0.0:
            raise ZygosError(f"{what} {value:g} of joint {name} leaves no motion; remedy: give a number above 0")
    return values


def _range(text: str, joint: str) -> tuple[float, float]:
    first, colon, second = text.partition(":")
    low, high = as_number("angle", first), as_number("angle", second if colon else first)
    low = low if colon else -low
    if not low < high:
        raise ZygosError(
            f"angle {text!r} of joint {joint} is no range; remedy: give the largest angle, or LOW:HIGH in rad with LOW "
            "below HIGH"
        )
    return low, high


def as_number(what: str, text: str) -> float:
    """A number that is not NaN. Errors: ZygosError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise ZygosError(f"{what} {text!r} is not a number; remedy: write for example 1.5, or NAME=1.5,NAME=2")
    return value
