# SPDX-License-Identifier: MIT
"""Columns of the joint rows along a motion that is given as a function of time, and what they are worth.

The columns are those that an estimate on the ground uses (`zygos.balances.joint`), of the motion itself instead of
smoothed readings, with the columns of friction and of a constant offset of each torque.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.joint import in_order, joint_columns
from zygos.balances.state import State
from zygos.dynamics.equations import Dynamics, equations
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.ground.estimate import DEFAULT_FRICTION
from zygos.ground.rows import friction
from zygos.model.model import Model
from zygos.simulation.plant import needed_torque

Floats = NDArray[np.float64]


OFFSET = "torque_offset"
"""Key of the constant offset that every estimate on the ground has for each torque."""


@dataclass(frozen=True)
class Column:
    """A column of the rows: a parameter, the coefficient of an effect, or a constant offset of a torque."""

    name: str
    unit: str
    value: float
    """In the model, SI units; 0 of an offset."""
    structural: bool
    """Whether it is a parameter of the arm, not a property of its torques that is estimated beside them."""


class Grounded:
    """An arm with a fixed base and rigid joints, with its model: rows, torques and noise of any motion."""

    def __init__(self, arm: Arm, model: Model, torque_sigma: Floats) -> None:
        """torque_sigma: (N,) standard deviation of a reported torque, Nm. Errors: ZygosError if the arm floats or has a
        flexible joint, if the model does not fit it, or if a deviation is 0."""
        if not arm.grounded:
            raise ZygosError(
                f"arm {arm.name}: rows of its joints alone are planned only where the base is fixed and all joints are "
                "rigid; remedy: plan its motion by simulation"
            )
        if not np.all(torque_sigma > 0.0):
            without = [joint.name for joint, sigma in zip(arm.joints, torque_sigma, strict=True) if not sigma > 0.0]
            raise ZygosError(
                f"arm {arm.name}: the noise of the torque of {', '.join(without)} is not known; remedy: declare "
                "torque_sigma in the arm file, or give --torque-noise"
            )
        if not model.effects:
            # an estimate assumes friction where the model says nothing
            model = replace(model, effects=friction(arm, [CATALOGUE[key] for key in DEFAULT_FRICTION]))
        self.arm, self.model = arm, model
        self.dynamics: Dynamics = equations(arm, model)
        self.friction: tuple[Effect, ...] = tuple(
            effect
            for effect in model.effects
            if effect.kind.torque is not None and effect.kind.place in ("motor", "link") and effect.kind.key != OFFSET
        )
        self.increment_s = arm.joint_row_s
        self.impulse_sigma = arm.gear_ratios * torque_sigma * np.sqrt(arm.period_s * self.increment_s)
        """(N,) standard deviation of the impulse of a motor over an increment, after the gear, Nms."""
        known = {effect.joint: effect.value for effect in model.effects if effect.kind.key == OFFSET}
        offsets = [known.get(joint.name, 0.0) for joint in arm.joints]
        self.columns = (
            *(Column(name, one.unit, one.value, True) for name, one in model.base_parameters(arm).items()),
            *(Column(one.column(arm), one.kind.unit, one.value, False) for one in self.friction),
            *(Column(f"{OFFSET}{i + 1}", "Nm", value, False) for i, value in enumerate(offsets)),
        )

    @property
    def structural(self) -> int:
        """Number of the parameters of the arm, which are the first columns."""
        return sum(column.structural for column in self.columns)

    def at(self, angle: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Momentum and force of each joint (m, N, c) per unit of all c columns, at angles and rates (m, N)."""
        arm = self.arm
        momentum, force = _columns(arm, angle, rate)
        beside = len(self.friction) + arm.n
        losses = np.zeros((*angle.shape, beside))
        for k, effect in enumerate(self.friction):
            joint = effect.index(arm)
            assert effect.kind.torque is not None
            lever = arm.joints[joint].gear_ratio if effect.kind.place == "motor" else 1.0
            losses[:, joint, k] = -lever * effect.kind.torque(rate[:, joint])
        for joint in range(arm.n):
            losses[:, joint, len(self.friction) + joint] = -arm.gear_ratios[joint]
        none = np.zeros_like(losses)
        return np.concatenate([momentum, none], axis=-1), np.concatenate([force, losses], axis=-1)

    @property
    def coefficients(self) -> Floats:
        """(c,) values of the columns in the model."""
        return np.array([column.value for column in self.columns])

    def torque(self, angle: Floats, rate: Floats, acceleration: Floats) -> Floats:
        """(m, N) torques as the frames report them, Nm, that a motion (m, N) needs, by the equations of motion."""
        return needed_torque(self.arm, self.dynamics, angle, rate, acceleration)

    def covariance(self, rows: Floats) -> Floats:
        """(c, c) covariance that weighted least squares have on rows (m, N, c) of half overlapping increments.

        The torques' noise is white, so that neighbouring rows share half of its variance. Errors: ZygosError if the
        rows do not determine all columns.
        """
        weighed = rows / self.impulse_sigma[:, None]
        scale = np.sqrt(np.einsum("kjc,kjc->c", weighed, weighed))
        scale = np.where(scale > 0.0, scale, 1.0)
        weighed = weighed / scale
        normal = np.einsum("kjc,kjd->cd", weighed, weighed)
        eigen, vectors = np.linalg.eigh(normal)
        if eigen[0] < 1e-12 * eigen[-1]:
            worst = self.columns[int(np.argmax(np.abs(vectors[:, 0])))].name
            raise ZygosError(
                f"the motion does not determine every parameter (least of all {worst}); remedy: move every joint, with "
                "different frequencies, and begin from another posture"
            )
        inverse = (vectors / eigen) @ vectors.T
        shared = np.einsum("kjc,kjd->cd", weighed[1:], weighed[:-1])
        spread: Floats = inverse @ (normal + 0.5 * (shared + shared.T)) @ inverse / np.outer(scale, scale)
        return spread

    def rows(self, momentum: Floats, force: Floats, step_s: float, steps: int) -> Floats:
        """(k, N, c) rows over half overlapping increments of 2 steps, from instants (m, N, c) that are step_s apart."""
        inner = np.arange(1, 2 * steps)
        weights = np.concatenate([[1.0], np.where(inner % 2 == 1, 4.0, 2.0), [1.0]]) * step_s / 3.0
        begins = np.arange(0, len(momentum) - 2 * steps, steps)
        impulse = sum(w * force[begins + i] for i, w in enumerate(weights))
        return np.asarray(momentum[begins + 2 * steps] - momentum[begins] - impulse)


def _columns(arm: Arm, angle: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Columns (m, N, p) of momentum and force at angles and rates (m, N)."""
    still = np.zeros((len(angle), 3)) if arm.spatial else np.zeros(len(angle))
    parts = joint_columns(arm, State(angle, angle, rate, rate, still))
    return in_order(arm, parts.momentum, parts.rotor_momentum), in_order(arm, parts.force, parts.rotor_force)
