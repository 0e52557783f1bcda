# SPDX-License-Identifier: MIT
"""A change of the bodies of an arm that floats, as a payload of its last body: mass, first moments and inertia.

Momentum and energy of a floating arm hold masses only relative to each other. The bodies of the simulation give the
scale, so that the model has to be one of bodies. The inertial parameters are no linear functions of a payload: it is
sought by Gauss-Newton iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from zygos import limits
from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.quantiles import student_factor

Array = NDArray[np.float64]

_ELEMENTS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
_PLANE = ("m", "mx", "my", "Izz")
_UNITS = {"m": "kg", "I": "kg m^2"}


@dataclass(frozen=True)
class PayloadValue:
    """One element of a payload, about the origin of the last joint's frame and in its axes."""

    name: str
    unit: str
    value: float
    sigma: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return self.value - limits.INTERVAL_Z.value * self.sigma, self.value + limits.INTERVAL_Z.value * self.sigma


def payload_of(arm: Arm, model: Model, names: tuple[str, ...], change: Array, drawn: Array) -> tuple[PayloadValue, ...]:
    """What the last body took on, or lost, by the change (c,) of the parameters of these names.

    drawn: (draws, c) what noise makes of these changes. Empty where the model has no bodies, or the parameters do not
    tell the elements of a payload apart.
    """
    if not model.bodies or not arm.free:
        return ()
    try:
        before = model.base_values(arm)
    except ZygosError:
        return ()
    at = [arm.parameter_names.index(name) for name in names]
    covariance = np.atleast_2d(np.cov(drawn, rowvar=False)) + np.diag((limits.SYSTEMATIC.value * before[at]) ** 2)
    weight = 1.0 / np.sqrt(np.diag(covariance))
    own = [k for k, one in enumerate(_ELEMENTS) if arm.spatial or one in _PLANE]

    def grown(x: Array) -> Array:
        elements = np.zeros(len(_ELEMENTS))
        elements[own] = x
        loaded = _loaded(model, elements)
        return np.asarray((loaded.unchecked_values(arm) - before)[at], dtype=np.float64)

    last = model.bodies[-1]
    scale = _scale(last.mass.value, last.origin_xyz, np.array([one.value for one in last.inertia]))[own]

    def slope(x: Array) -> Array:
        step = limits.DIFFERENCE_STEP.value * scale
        columns = [(grown(x + s) - grown(x - s)) / (2.0 * limits.DIFFERENCE_STEP.value) for s in np.diag(step)]
        return np.asarray(np.stack(columns, axis=1) * weight[:, None], dtype=np.float64)

    size = np.linalg.norm(slope(np.zeros(len(own))), axis=0)
    seen = size > limits.BLIND.value * size.max()
    own, scale = [k for k, good in zip(own, seen, strict=True) if good], scale[seen]
    if len(own) > len(at):
        return ()
    found = least_squares(
        lambda y: weight * (grown(scale * y) - change), np.zeros(len(own)), jac=lambda y: slope(scale * y), method="lm"
    )
    columns = slope(scale * found.x)
    unit = np.linalg.norm(columns, axis=0)
    eigen = np.linalg.eigvalsh((columns / unit).T @ (columns / unit))
    if not found.success or eigen[0] < limits.ELEMENTS_TOLD_APART.value:
        return ()
    inverse = np.linalg.pinv(columns) * weight
    # the deviations come from few draws
    wide = float(student_factor(limits.CONFIDENCE.value, max(1, len(drawn) - 1))) / limits.INTERVAL_Z.value
    sigma = wide * scale * np.sqrt(np.diag(inverse @ covariance @ inverse.T))
    body = len(model.bodies) - 1
    return tuple(
        PayloadValue(
            f"{_ELEMENTS[k]}{body}",
            "kg m" if len(_ELEMENTS[k]) == 2 else _UNITS[_ELEMENTS[k][0]],
            float(value),
            float(spread),
        )
        for k, value, spread in zip(own, scale * found.x, sigma, strict=True)
    )


def _scale(mass: float, origin: tuple[float, float, float], inertia: Array) -> Array:
    """Sizes of the ten elements of a body."""
    reach = max(float(np.linalg.norm(origin)), limits.LEAST_REACH_M.value)
    return np.array([mass, *[mass * reach] * 3, *[max(float(np.abs(inertia).max()), mass * reach**2)] * 6])


def _loaded(model: Model, elements: Array) -> Model:
    """The model with a payload (10,) on its last body."""
    body = model.bodies[-1]
    mass, centre = body.mass.value, np.array(body.origin_xyz)
    ixx, ixy, ixz, iyy, iyz, izz = elements[4:]
    whole = mass + elements[0]
    first = mass * centre + elements[1:4]
    about = body.tensor + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    about = about + np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    there = first / whole
    own = about - whole * (there @ there * np.eye(3) - np.outer(there, there))
    ixx, ixy, ixz, iyy, iyz, izz = (
        replace(quantity, value=float(own[place]))
        for quantity, place in zip(body.inertia, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), strict=True)
    )
    loaded = replace(
        body,
        mass=replace(body.mass, value=float(whole)),
        origin_xyz=(float(there[0]), float(there[1]), float(there[2])),
        inertia=(ixx, ixy, ixz, iyy, iyz, izz),
    )
    return replace(model, bodies=(*model.bodies[:-1], loaded))
