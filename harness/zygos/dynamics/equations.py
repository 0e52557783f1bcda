"""The equations of motion for a simulation: our own, or those of an independent engine."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.dynamics.compiled import Multibody
from zygos.dynamics.engines import Engine, engine
from zygos.dynamics.planar import PlanarDynamics
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
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations of base, joints (..., N) and motors after the gear (..., N), rad/s^2."""

    def base_rate(self, q: Array, momentum: float | Array) -> Array:
        """Base rate, rad/s, at which the arm with all joints at rest has that angular momentum, Nms."""


class _Engine:
    """An engine applied to one state after the other; it treats every arm as spatial."""

    torque_lag: Array | None = None
    angular_momentum: float | None = None

    def __init__(self, inner: Engine) -> None:
        self.inner = inner

    def accelerations(
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        rows = [self.inner.accelerations(*one) for one in zip(q, theta, omega0, qd, thetad, tau, strict=True)]
        base, joint, motor = (np.stack(part) for part in zip(*rows, strict=True))
        return base, joint, motor

    def base_rate(self, q: Array, momentum: float | Array) -> Array:
        still = np.zeros(q.shape[-1])
        inertia = [np.stack([self.inner.momentum(one, unit, still, still) for unit in np.eye(3)], 1) for one in q]
        return np.stack([np.linalg.solve(one, np.asarray(momentum)) for one in inertia])


def equations(arm: Arm, model: Model, name: EngineName = "zygos") -> Dynamics:
    """The equations of motion of a model. Errors: ZygosError if it does not fit the arm or the engine."""
    if name != "zygos":
        return _Engine(engine(name, arm, model))
    return (PlanarDynamics if arm.free and not arm.spatial else Multibody).from_model(arm, model)
