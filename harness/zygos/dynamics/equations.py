# SPDX-License-Identifier: MIT
"""The equations of motion for a simulation: our own, or those of an independent engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.dynamics.compiled import Multibody, Planar
from zygos.dynamics.engines import Engine, engine
from zygos.dynamics.joints import START, Drives, Law, Moment
from zygos.effects import Effect, Motion
from zygos.errors import ZygosError
from zygos.model.model import Model

Array = NDArray[np.float64]
EngineName = Literal["zygos", "pinocchio", "mujoco"]
ENGINES: tuple[EngineName, ...] = ("zygos", "pinocchio", "mujoco")


class Dynamics(Protocol):
    """Equations of motion of an arm, with any leading batch axes; omega0 is (...,) in a plane, else (..., 3)."""

    @property
    def torque_lag(self) -> Array | None:
        """(N,) delay of each motor behind its reported torque, s; None: no delay."""

    @property
    def angular_momentum(self) -> float | None:
        """Angular momentum that the model assumes, Nms; None: no assumption."""

    def accelerations(
        self,
        q: Array,
        theta: Array,
        omega0: Array,
        qd: Array,
        thetad: Array,
        tau: Array,
        moment: Moment = START,
    ) -> tuple[Array, Array, Array]:
        """Accelerations of base, joints (..., N) and motors after the gear (..., N), rad/s^2."""

    def base_rate(self, q: Array, momentum: float | Array) -> Array:
        """Base rate, rad/s, at which the arm with all joints at rest has that angular momentum, Nms."""


class _Engine:
    """An engine applied to one state after the other; it treats every arm as spatial. Friction at motors, and at the
    links of rigid joints, is subtracted from the torques that the engine receives."""

    torque_lag: Array | None = None
    angular_momentum: float | None = None

    def __init__(self, arm: Arm, inner: Engine, laws: Sequence[Law]) -> None:
        self.ratio, self.inner, self.laws = arm.gear_ratios, inner, laws

    def accelerations(
        self,
        q: Array,
        theta: Array,
        omega0: Array,
        qd: Array,
        thetad: Array,
        tau: Array,
        moment: Moment = START,
    ) -> tuple[Array, Array, Array]:
        tau = self._driving(q, theta, qd, thetad, tau, moment)
        rows = [self.inner.accelerations(*one) for one in zip(q, theta, omega0, qd, thetad, tau, strict=True)]
        base, joint, motor = (np.stack(part) for part in zip(*rows, strict=True))
        return base, joint, motor

    def _driving(self, q: Array, theta: Array, qd: Array, thetad: Array, tau: Array, moment: Moment) -> Array:
        """(..., N) torques before the gear less friction."""
        driving, time = tau.copy(), np.broadcast_to(moment.time, q.shape[:-1])
        for law in self.laws:
            i, own = law.joint, law.kind.side == "motor"
            motion = Motion(
                rate=(thetad if own else qd)[..., i],
                angle=(theta if own else q)[..., i],
                deflection=theta[..., i] - q[..., i],
                slip=thetad[..., i] - qd[..., i],
                applied=tau[..., i],
                time=time,
                ratio=float(self.ratio[i]),
            )
            share = {"motor": -1.0, "torque": 1.0}.get(law.kind.place, -1.0 / float(self.ratio[i]))
            driving[..., i] += share * law.torque(motion)
        return driving

    def base_rate(self, q: Array, momentum: float | Array) -> Array:
        still = np.zeros(q.shape[-1])
        inertia = [np.stack([self.inner.momentum(one, unit, still, still) for unit in np.eye(3)], 1) for one in q]
        return np.stack([np.linalg.solve(one, np.asarray(momentum)) for one in inertia])


def equations(arm: Arm, model: Model, name: EngineName = "zygos") -> Dynamics:
    """The equations of motion of a model. Errors: ZygosError if it does not fit the arm or the engine."""
    if name != "zygos":
        outside = [effect for effect in model.effects if _acts_as_torque(arm, effect)]
        lasting = [effect.kind.key for effect in outside if effect.kind.memory]
        if lasting:
            raise ZygosError(
                f"engine {name}: has no internal states for {', '.join(lasting)}; remedy: the engine zygos"
            )
        inside = tuple(effect for effect in model.effects if effect not in outside)
        laws = [Law(one.kind, one.index(arm), one.value, np.nan if one.shape is None else one.shape) for one in outside]
        return _Engine(arm, engine(name, arm, replace(model, effects=inside)), laws)
    return from_model(arm, model)


def from_model(arm: Arm, model: Model) -> Drives:
    """Our own equations of motion of a model, its effects included. Errors: ZygosError if it does not fit the arm."""
    return from_parameters(arm, model.base_values(arm), model.effects)


def from_parameters(arm: Arm, values: ArrayLike, effects: Sequence[Effect] = ()) -> Drives:
    """Our own equations of motion from base parameters (p,) in the order of `arm.parameter_names`, and effects.

    The closed form of a planar arm that floats is the fast case. Errors: ZygosError where no arm has these values.
    """
    form: type[Drives] = Planar if arm.free and not arm.spatial else Multibody
    changes = [effect for effect in effects if effect.kind.place == "body"]
    lasting = [effect for effect in effects if effect.kind.place != "body"]
    dynamics = form.from_parameters(arm, values, lasting)
    if not changes:
        return dynamics
    changed = np.array(values, dtype=np.float64)
    for effect in changes:
        effect.index(arm)
        changed[arm.parameter_names.index(effect.component)] += effect.value
    instants = {effect.shape for effect in changes}
    if len(instants) > 1:
        raise ZygosError(
            f"arm {arm.name}: changes of bodies at {len(instants)} instants cannot be simulated; remedy: give all of "
            "them one instant"
        )
    later = form.from_parameters(arm, changed, lasting)
    return replace(dynamics, later=later, change_s=float(instants.pop() or 0.0))


def parameters(arm: Arm, dynamics: Drives) -> Array:
    """(p,) base parameters of equations of motion, in the order of `arm.parameter_names`; infinite for the stiffness
    of a rigid joint whose arm could bend there."""
    of_joint = {"Im": dynamics.rotor_inertia, "k": dynamics.stiffness, "b": dynamics.damping}
    joints = np.array([of_joint[symbol][i] for symbol, i in arm.full_joint_parameters])
    rigid = np.isinf(joints)
    full = np.concatenate([dynamics.body_values, np.where(rigid, 0.0, joints)])
    basis = arm.structure.basis
    values = np.linalg.lstsq(basis, full, rcond=None)[0] if arm.structure.reduces else full
    stiff = {f"k{i + 1}" for (_, i), infinite in zip(arm.full_joint_parameters, rigid, strict=True) if infinite}
    return np.array([np.inf if n in stiff else x for n, x in zip(arm.parameter_names, values.tolist(), strict=True)])


def _acts_as_torque(arm: Arm, effect: Effect) -> bool:
    """Whether an effect is a torque on a rotor: at its motor, of its drive, or at the link of a rigid joint."""
    place, joint = effect.kind.place, effect.index(arm)
    return (
        place == "motor"
        or (place == "torque" and not effect.kind.lags)
        or (place == "link" and not arm.joints[joint].flexible)
    )
