# SPDX-License-Identifier: MIT
"""Equations of motion of independent engines: an arm's bodies in Pinocchio or in MuJoCo.

Both are built only from the `[[body]]` and `[[joint]]` of a model file, without base parameters and without any formula
of `zygos.dynamics.planar`. Rotor i is a separate body on body i-1, a thin disc about joint i, geared to theta. The
engines serve as plants for the simulator, and to verify each other and our equations.
"""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError, installs
from zygos.model.model import Model

Array = NDArray[np.float64]

ENGINES = {"pinocchio": "PinocchioEngine", "mujoco": "MujocoEngine"}
"""Name of the module here, which is also that of the required package, and its class."""


class Engine(Protocol):
    """An arm of N joints in one state at a time.

    q: link angles, theta: motor angles after the gear, both (N,), rad. qd, thetad: their rates, rad/s. omega0: (3,)
    inertial rate of the base in base axes, rad/s; zero on a fixed base. tau: (N,) rotor torques before the gear, Nm.
    At a rigid joint theta and thetad are not used: the rotor turns with the link. A free arm's mass centre is at rest.
    """

    def accelerations(
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Time derivatives of omega0 (3,), qd (N,) and thetad (N,), rad/s^2."""

    def kinetic_energy(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> float:
        """Kinetic energy of bodies and rotors, J."""

    def potential_energy(self, q: Array) -> float:
        """Potential energy in the gravity that a fixed base feels, J, up to a constant; without that of the springs."""

    def momentum(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """(3,) angular momentum of a free arm about its mass centre in base axes, Nms."""


def engine(name: str, arm: Arm, model: Model) -> Engine:
    """The arm in one of `ENGINES`.

    Errors: ZygosError for an unknown engine or one that is not installed, and for a model without bodies, with effects,
    or that does not fit the arm.
    """
    if name not in ENGINES:
        raise ZygosError(f"there is no engine {name!r}; remedy: use one of {', '.join(ENGINES)}")
    if not model.bodies:
        raise ZygosError(
            f"model {model.name} is given by base parameters, engine {name} needs bodies; "
            'remedy: a model with [[body]] and [[joint]], or engine "zygos"'
        )
    if model.effects:
        carried = ", ".join(sorted({effect.kind.key for effect in model.effects}))
        raise ZygosError(
            f"model {model.name} has effects ({carried}), engine {name} supports none of them; "
            'remedy: engine "zygos", or a model without [[effect]]'
        )
    model.check_fits(arm)
    try:
        module = import_module(f"{__name__}.{name}")
    except ImportError as error:
        raise ZygosError(f"engine {name} cannot be loaded ({error}); remedy: {installs('engines')}") from None
    return cast(Engine, getattr(module, ENGINES[name])(arm, model))
