# SPDX-License-Identifier: MIT
"""The joints' dynamics: rotors, springs, dampers and the effects of the catalogue, for any arm.

A joint of infinite stiffness is rigid, theta = q. Effects act as their entries in the catalogue define. For a torque
lag, which delays the torque, only the length is stored here. Effects of sensors do not act on the motion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.effects import SLOWEST_RATE, UNKNOWN, Effect, Kind, Memory, Motion, Place
from zygos.effects.memory import at_rest
from zygos.errors import ZygosError
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """What laws may depend on beside the state of the joints."""

    time: Array | float = 0.0
    """(...,) time since the start of the run, s."""
    angle: Array | float = 0.0
    """(...,) angle that the base of a planar arm has turned since then, rad."""
    memory: NDArray[np.complex128] | None = None
    """(..., S) internal states of the laws with a memory, in the order of `Drives.remembering`; None: all are 0."""
    nadir: Array | None = None
    """(..., 3) unit vector to the Earth in base axes; None: its gravity has no gradient."""


START = Moment()


class Law(NamedTuple):
    """An effect that acts as a torque."""

    kind: Kind
    joint: int
    """From 0; -1 of the base."""
    value: float
    shape: float = np.nan
    component: int = 0
    """Base axis along which it acts in space."""

    def torque(self, motion: Motion) -> Array:
        """The effect's torque, without the sign of its site."""
        assert self.kind.law is not None
        return self.value * self.kind.law(motion, self.shape)


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
    laws: tuple[Law, ...] = ()
    """Torque laws at joints."""
    base_laws: tuple[Law, ...] = ()
    """Torque laws at the base."""
    gradient: float = 0.0
    """Coefficient of the gravity gradient, 1/s^2."""
    later: Drives | None = None
    """The arm from the instant `change_s` on; None: it does not change."""
    change_s: float = np.inf
    """Instant of a change of bodies, s since the start of the run."""
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
        self,
        q: Array,
        theta: Array,
        omega0: Array,
        qd: Array,
        thetad: Array,
        tau: Array,
        moment: Moment = START,
    ) -> tuple[Array, Array, Array]:
        """Accelerations of base (as omega0), joints (..., N) and motors after the gear (..., N), rad/s^2.

        q, theta rad; omega0, qd, thetad rad/s; tau the rotor torque before the gear, Nm. omega0: as `State.base`.
        moment: for effects that depend on the time or on the angle of the base.
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

    @property
    def held_momentum(self) -> float | None:
        """Angular momentum that the arm keeps, Nms; None: no assumption, or a torque acts on the base."""
        return None if self.base_laws or self.gradient else self.angular_momentum

    @cached_property
    def rigid(self) -> NDArray[np.bool_]:
        """(N,) joints whose stiffness is infinite."""
        return np.isinf(self.stiffness)

    @cached_property
    def soft_stiffness(self) -> Array:
        """(N,) stiffness; 0 at a rigid joint, whose torque is a constraint torque."""
        return np.where(self.rigid, 0.0, self.stiffness)

    @cached_property
    def acting(self) -> tuple[tuple[Law, float, bool], ...]:
        """The laws at joints with the gear ratio, and whether the joint is rigid. Friction with the load comes last: it
        needs what the others make of the torque through the gear."""
        ordered = sorted(self.laws, key=lambda law: law.kind.place == "load")
        return tuple((law, float(self.gear_ratio[law.joint]), bool(self.rigid[law.joint])) for law in ordered)

    @cached_property
    def _none(self) -> Array:
        return np.zeros(self.n)

    @cached_property
    def _unchanged(self) -> Drives:
        """The arm before the change."""
        return replace(self, later=None)

    def _changing(
        self, later: Drives, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array, moment: Moment
    ) -> tuple[Array, Array, Array]:
        """Accelerations of an arm whose bodies change."""
        since = np.broadcast_to(np.asarray(moment.time) >= self.change_s, q.shape[:-1])
        state = (q, theta, omega0, qd, thetad, tau, moment)
        if since.all() or not since.any():
            return (later if since.all() else self._unchanged).accelerations(*state)
        both = zip(self._unchanged.accelerations(*state), later.accelerations(*state), strict=True)
        base, link, motor = (np.where(since.reshape(since.shape + (1,) * (x.ndim - since.ndim)), y, x) for x, y in both)
        return base, link, motor

    def friction_slope(self, place: Place) -> Array:
        """(N,) damping equivalent to the friction at motors or links near standstill, Nms/rad after the gear."""
        slope, speed = np.zeros(self.n), np.array([-SLOWEST_RATE, SLOWEST_RATE])
        still = np.zeros(2)
        for law in self.laws:
            if law.kind.place == place and law.kind.memory is None:
                ratio = float(self.gear_ratio[law.joint])
                less, more = law.torque(Motion(speed, still, still, still, still, still, still, ratio))
                slope[law.joint] += (more - less) / (2.0 * SLOWEST_RATE) * (ratio if place == "motor" else 1.0)
        return slope

    def presliding_stiffness(self, place: Place) -> Array:
        """(N,) stiffness of what friction with a memory bends at motors, links or springs, Nm/rad after the gear."""
        slope, one = np.zeros(self.n), np.ones(1)
        for law in self.remembering:
            memory = law.kind.memory
            if law.kind.place == place and memory is not None:
                motion = Motion(one, one, one, one, ratio=float(self.gear_ratio[law.joint]))
                bent, _ = memory.rates(motion, law.shape)
                force = law.torque(replace(motion, memory=bent)) - law.torque(replace(motion, memory=0.0 * bent))
                ratio = float(self.gear_ratio[law.joint]) if place == "motor" else 1.0
                slope[law.joint] += abs(float(force[0])) * ratio
        return slope

    @cached_property
    def remembering(self) -> tuple[Law, ...]:
        """The laws with a memory."""
        return tuple(law for law in (*self.laws, *self.base_laws) if law.kind.memory is not None)

    @cached_property
    def places(self) -> dict[Law, slice]:
        """Where the internal states of each stand in `Moment.memory`."""
        sizes = [law.kind.memory.size for law in self.remembering if law.kind.memory is not None]
        ends = np.cumsum([0, *sizes]).tolist()
        return {law: slice(*part) for law, part in zip(self.remembering, pairwise(ends), strict=True)}

    @property
    def states(self) -> int:
        """S, internal states of the laws with a memory."""
        return sum(law.kind.memory.size for law in self.remembering if law.kind.memory is not None)

    def memory_rates(self, state: State) -> list[tuple[Law, Memory, slice, Any, Any]]:
        """Of each law with a memory: itself, the memory, the place of its states, and b and a (..., s) of them."""
        out = []
        for law in self.remembering:
            memory = law.kind.memory
            assert memory is not None
            out.append((law, memory, self.places[law], *memory.rates(self._motion(law, state), law.shape)))
        return out

    def memory_derivative(self, state: State, memory: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(..., S) rates of internal states (..., S)."""
        rate = np.empty_like(memory)
        for _, kept, at, b, a in self.memory_rates(state):
            rate[..., at] = kept.derivative(memory[..., at], b, a)
        return rate

    def remembered(self, state: State, memory: NDArray[np.complex128], span: float) -> NDArray[np.complex128]:
        """(..., S) internal states after so many seconds at the rates of a state."""
        after = np.empty_like(memory)
        for _, kept, at, b, a in self.memory_rates(state):
            after[..., at] = kept.advanced(memory[..., at], b, a, span)
        return after

    def memory_at_rest(self, state: State) -> NDArray[np.complex128]:
        """(..., S) internal states with which a motion begins."""
        memory = np.zeros((*state.q.shape[:-1], self.states), dtype=np.complex128)
        for _, _, at, b, a in self.memory_rates(state):
            memory[..., at] = at_rest(b, a)
        return memory

    def memory_along(self, state: State, time: Array, period_s: float) -> NDArray[np.complex128]:
        """(A, m, S) internal states along A arcs of m instants, a period apart, at times (A, m)."""
        memory = np.zeros((*time.shape, self.states), dtype=np.complex128)
        for law, kept, at, _, _ in self.memory_rates(state):
            motion = replace(self._motion(law, state), time=time)
            memory[..., at] = kept.along(motion, law.shape, period_s).memory
        return memory

    def _motion(
        self, law: Law, state: State, moment: Moment = START, applied: Array = UNKNOWN, load: Array = UNKNOWN
    ) -> Motion:
        """What a law depends on."""
        i, own = law.joint, UNKNOWN
        if law.kind.memory is not None and moment.memory is not None:
            own = moment.memory[..., self.places[law]]
        elif law.kind.memory is not None:
            own = np.zeros((*state.q.shape[:-1], law.kind.memory.size))
        if i < 0:
            rate = state.base if state.base.ndim < state.q.ndim else state.base[..., law.component]
            angle, time = (np.broadcast_to(x, rate.shape) for x in (moment.angle, moment.time))
            return Motion(rate=rate, angle=angle, time=time, memory=own)
        q, theta, qd, thetad = state.q[..., i], state.theta[..., i], state.qd[..., i], state.thetad[..., i]
        deflection, slip = theta - q, thetad - qd
        side = law.kind.side
        rate, angle = (thetad, theta) if side == "motor" else (qd, q) if side == "link" else (slip, deflection)
        known = isinstance(moment.time, np.ndarray) and moment.time.shape == q.shape
        time = np.asarray(moment.time if known else np.broadcast_to(moment.time, q.shape))
        return Motion(rate, angle, deflection, slip, applied, load, time, float(self.gear_ratio[i]), own)

    def forces(
        self, q: Array, theta: Array, qd: Array, thetad: Array, tau: Array | None = None, moment: Moment = START
    ) -> tuple[Array, Array, Array]:
        """Torques (..., N): of the springs on the links, what motors lack of their reported torque (before the gear),
        and of friction at links. Without tau the reported torques are unknown."""
        deflection = theta - q
        spring = self.soft_stiffness * deflection + self.damping * (thetad - qd)
        if not self.laws:
            return spring, self._none, self._none
        motor, link = np.zeros_like(q), np.zeros_like(q)
        state = State(q, theta, qd, thetad, q[..., :0])
        for law, ratio, rigid in self.acting:
            place, i = law.kind.place, law.joint
            applied = UNKNOWN if tau is None else tau[..., i]
            passed = ratio * (applied - motor[..., i]) if rigid else spring[..., i]
            torque = law.torque(self._motion(law, state, moment, applied, passed))
            if place == "spring":
                # the torque of a rigid joint is a constraint torque
                spring[..., i] += 0.0 if rigid else torque
            elif place == "motor":
                motor[..., i] += torque
            elif place == "load":
                motor[..., i] += torque / ratio
            elif place == "torque":
                motor[..., i] -= torque
            else:
                link[..., i] += torque
        return spring, motor, link

    def _base_torque(self, q: Array, omega0: Array, moment: Moment) -> Array | None:
        """Torque of effects on the base, shape of omega0, Nm in base axes; None where there is none."""
        if not self.base_laws:
            return None
        total = np.zeros_like(omega0)
        state = State(q, q, q, q, omega0)
        for law in self.base_laws:
            torque = law.torque(self._motion(law, state, moment))
            if omega0.ndim == q.ndim:
                total[..., law.component] += torque
            else:
                total += torque
        return total

    def spring(self, q: Array, theta: Array, qd: Array, thetad: Array) -> Array:
        """(..., N) torque of spring and damper on the link, Nm: k (theta - q) + b (thetad - qd), plus the effects
        there.

        Zero for a rigid joint, whose torque is a constraint torque.
        """
        return self.forces(q, theta, qd, thetad)[0]

    def elastic_energy(self, q: Array, theta: Array) -> Array:
        """(...,) energy in the joints' springs, J."""
        deflection = theta - q
        energy: Array = 0.5 * (self.soft_stiffness * deflection**2).sum(axis=-1)
        for law in self.laws:
            if law.kind.place == "spring" and law.kind.potential is not None:
                energy = energy + law.value * law.kind.potential(deflection[..., law.joint], law.shape)
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
    gradient = 0.0
    laws: list[Law] = []
    base_laws: list[Law] = []
    for effect in effects:
        joint, place = effect.index(arm), effect.kind.place
        if place == "spring" and value.get(f"k{joint + 1}", np.inf) == np.inf:
            raise ZygosError(
                f"effect {effect.kind.key} at {effect.joint}: the joint's stiffness is infinite, so it has no spring; "
                "remedy: remove the entry, or give a finite stiffness"
            )
        shape = np.nan if effect.shape is None else effect.shape
        if effect.kind.lags:
            lag[joint] = effect.value
        elif place in ("motor", "link", "spring", "torque", "load"):
            laws.append(Law(effect.kind, joint, effect.value, shape))
        elif place == "rotor":
            coupling[joint] = effect.value
        elif place == "base" and effect.kind.law is not None:
            base_laws.append(Law(effect.kind, joint, effect.value, shape, effect.component_index(arm)))
        elif place == "base":
            momentum = effect.value
        elif place == "field":
            gradient += effect.value
        elif place != "sensor":
            raise ZygosError(
                f"effect {effect.kind.key}: the simulator has no law of the site {place}; remedy: remove the entry "
                "from the model that is simulated"
            )
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
        "base_laws": tuple(base_laws),
        "torque_lag": lag if lag.any() else None,
        "angular_momentum": momentum,
        "gradient": gradient,
    }
