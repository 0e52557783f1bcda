"""The joints' dynamics: rotors, springs, dampers and the effects of the catalogue, for any arm.

A joint of infinite stiffness is rigid, theta = q. Effects act as their entries in the catalogue define. For a torque
lag, which delays the torque, only the length is stored here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.effects import SLOWEST_RATE, Effect, Kind, Place
from zygos.errors import ZygosError
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Drives(ABC):
    """The N drives of an arm, whose bodies are those of a subclass."""

    rotor_inertia: Array
    """(N,) Im, kg m^2, about the rotor's own axis, before the gear."""
    stiffness: Array
    """(N,) k, Nm/rad, after the gear."""
    damping: Array
    """(N,) b, Nms/rad, after the gear."""
    gear_ratio: Array
    """(N,) n."""
    coupling: Array
    """(N,) share of Im that the rotation of the carrying body acts on: 1 in nature."""
    laws: tuple[tuple[Kind, int, float], ...] = ()
    """Torque laws with the index of their joint and their coefficient."""
    torque_lag: Array | None = None
    """(N,) delay of each motor behind its reported torque, s; None: no delay."""
    angular_momentum: float | None = None
    """Angular momentum that the model assumes, Nms; None: no assumption."""

    @classmethod
    def from_model(cls, arm: Arm, model: Model) -> Self:
        """Dynamics of a model, its effects included. Errors: as `from_parameters`, and what does not fit the arm."""
        return cls.from_parameters(arm, model.base_values(arm), model.effects)

    @classmethod
    @abstractmethod
    def from_parameters(cls, arm: Arm, values: ArrayLike, effects: Sequence[Effect] = ()) -> Self:
        """Dynamics from base parameters in the order of `arm.parameter_names`, shape (p,), and effects."""

    @abstractmethod
    def accelerations(
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations of base (as omega0), joints (..., N) and motors after the gear (..., N), rad/s^2.

        q, theta rad; omega0, qd, thetad rad/s; tau the rotor torque before the gear, Nm. omega0: as `State.base`.
        """

    @abstractmethod
    def mobility(self, q: Array) -> Array:
        """(..., N, N) accelerations of the joints per unit torque at each, 1/(kg m^2), at the postures q (..., N)."""

    @abstractmethod
    def kinetic_energy(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """(...,) kinetic energy T, J; of a free-floating arm without that of the mass centre."""

    @abstractmethod
    def gravity_energy(self, q: Array) -> Array:
        """(...,) potential energy in gravity, J, up to a constant."""

    @abstractmethod
    def momentum(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """Angular momentum about the mass centre of a free-floating arm, Nms, as omega0: (...) or (..., 3)."""

    @abstractmethod
    def base_rate(self, q: Array, momentum: Any, qd: Any = None, thetad: Any = None) -> Array:
        """Base rate, rad/s, at which a free-floating arm has that angular momentum, Nms; joints at rest by default."""

    @property
    @abstractmethod
    def body_values(self) -> Array:
        """Values of `arm.full_body_names`."""

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.rotor_inertia)

    @cached_property
    def rigid(self) -> NDArray[np.bool_]:
        """(N,) joints whose stiffness is infinite."""
        return np.isinf(self.stiffness)

    @cached_property
    def _soft(self) -> Array:
        """(N,) stiffness; 0 at a rigid joint, whose torque is a constraint torque."""
        return np.where(self.rigid, 0.0, self.stiffness)

    @cached_property
    def _none(self) -> Array:
        return np.zeros(self.n)

    def friction_slope(self, place: Place) -> Array:
        """(N,) damping equivalent to the friction at motors or links near standstill, Nms/rad after the gear."""
        slope = np.zeros(self.n)
        for kind, i, value in self.laws:
            if kind.place == place and kind.torque is not None:
                step = kind.torque(np.array([SLOWEST_RATE]))[0] / SLOWEST_RATE
                slope[i] += value * step * (self.gear_ratio[i] if place == "motor" else 1.0)
        return slope

    def _forces(self, q: Array, theta: Array, qd: Array, thetad: Array) -> tuple[Array, Array, Array]:
        """Torques (..., N): of the springs on the links, of friction at motors (before the gear) and at links."""
        deflection = theta - q
        spring = self._soft * deflection + self.damping * (thetad - qd)
        if not self.laws:
            return spring, self._none, self._none
        motor, link = np.zeros_like(q), np.zeros_like(q)
        for kind, i, value in self.laws:
            assert kind.torque is not None
            if kind.place == "spring":
                # the torque of a rigid joint is a constraint torque
                spring[..., i] += 0.0 if self.rigid[i] else value * kind.torque(deflection[..., i])
            elif kind.place == "motor":
                motor[..., i] += value * kind.torque(thetad[..., i])
            else:
                link[..., i] += value * kind.torque(qd[..., i])
        return spring, motor, link

    def spring(self, q: Array, theta: Array, qd: Array, thetad: Array) -> Array:
        """(..., N) torque of spring and damper on the link, Nm: k (theta - q) + b (thetad - qd), plus the effects
        there.

        Zero for a rigid joint, whose torque is a constraint torque.
        """
        return self._forces(q, theta, qd, thetad)[0]

    def elastic_energy(self, q: Array, theta: Array) -> Array:
        """(...,) energy in the joints' springs, J."""
        deflection = theta - q
        energy: Array = 0.5 * (self._soft * deflection**2).sum(axis=-1)
        for kind, i, value in self.laws:
            if kind.potential is not None:
                energy = energy + value * kind.potential(deflection[..., i])
        return energy


def by_name(arm: Arm, values: ArrayLike) -> dict[str, float]:
    """Full parameters by name, in the order of `arm.full_names`, with the rows of base parameters (p,) in the order of
    `arm.parameter_names`. Errors: ZygosError if there are not p values."""
    vector = np.asarray(values, dtype=np.float64)
    names = arm.parameter_names
    if vector.shape != (len(names),):
        raise ZygosError(
            f"arm {arm.name} has {len(names)} parameters, but values of shape {vector.shape} were given; "
            f"remedy: give one value for each of {', '.join(names)}"
        )
    return dict(zip(arm.full_names, arm.structure.expanded(vector).tolist(), strict=True))


def drives(arm: Arm, value: Mapping[str, float], effects: Sequence[Effect]) -> dict[str, Any]:
    """The fields of `Drives` from parameters by name and effects.

    Errors: ZygosError for a torque lag that is not less than a SYNC period, for an effect that the arm cannot have, and
    for a spring effect where the stiffness is infinite.
    """
    joints = range(1, arm.n + 1)
    coupling, lag = np.ones(arm.n), np.zeros(arm.n)
    momentum: float | None = None
    laws: list[tuple[Kind, int, float]] = []
    for effect in effects:
        joint = effect.index(arm)
        if effect.kind.place == "spring" and value.get(f"k{joint + 1}", np.inf) == np.inf:
            raise ZygosError(
                f"effect {effect.kind.key} at {effect.joint}: the joint's stiffness is infinite, so it has no spring; "
                "remedy: remove the entry, or give a finite stiffness"
            )
        if effect.kind.on_ground:
            raise ZygosError(
                f"effect {effect.kind.key} at {effect.joint}: the simulator has no law for it; remedy: remove "
                "the entry from the model that is simulated"
            )
        if effect.kind.torque is not None:
            laws.append((effect.kind, joint, effect.value))
        elif effect.kind.key == "rotor_coupling":
            coupling[joint] = effect.value
        elif effect.kind.key == "torque_lag":
            lag[joint] = effect.value
        else:
            momentum = effect.value
    if not (np.all(lag >= 0.0) and np.all(lag < arm.period_s)):
        raise ZygosError(
            f"arm {arm.name}: torque lags of {lag.tolist()} s are not within a SYNC period ({arm.period_s} s); "
            "remedy: describe a lag of whole periods by torque_law in the arm file"
        )
    return {
        # the inertia of a rotor that turns with its link alone is part of the link's
        "rotor_inertia": np.array([value.get(f"Im{i}", 0.0) for i in joints]),
        "stiffness": np.array([value.get(f"k{i}", np.inf) for i in joints]),
        "damping": np.array([value.get(f"b{i}", 0.0) for i in joints]),
        "gear_ratio": arm.gear_ratios,
        "coupling": coupling,
        "laws": tuple(laws),
        "torque_lag": lag if lag.any() else None,
        "angular_momentum": momentum,
    }
