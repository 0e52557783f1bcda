"""Equations of motion of the planar free-floating arm, from its base parameters and effects alone (docs/theory.md).

Body i (0 = base) turns at the absolute rate f_i; f_0 = omega_0, f_i = f_{i-1} + qd_i; phi_i is its absolute angle. With
c = phi_j - phi_i the kinetic energy of Nanos & Papadopoulos eq. (11) is

    T = 1/2 sum_i a_ii f_i^2 + sum_{i<j} f_i f_j [a_ij cos c + b_ij sin c]
        + sum_i [1/2 Im_i n_i^2 thetad_i^2 + Im_i n_i thetad_i f_{i-1}]

and its Lagrange equations in (phi_0 .. phi_N, theta_1 .. theta_N) are solved here for the accelerations. Nothing else
of the arm is needed: neither masses nor lengths, and no state of the base beyond its rate. A joint of infinite
stiffness is rigid, theta = q. Effects of the catalogue act as their entries say; of torque lag, which is a matter of
when a torque begins to act, only the size is kept here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.effects import SLOWEST_RATE, Effect, Kind, Place
from zygos.errors import ZygosError
from zygos.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlanarDynamics:
    """A planar arm of N joints. Every method takes arrays with any leading batch axes."""

    a: Array
    """(N+1, N+1) symmetric a_ij, kg m^2."""
    b: Array
    """(N+1, N+1) antisymmetric b_ij (b[i, j] = b_ij for i < j), kg m^2; zero for a planar-symmetric arm."""
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
    """(N,) delay of each motor behind its reported torque, s; None: none."""
    angular_momentum: float | None = None
    """h that the model assumes, Nms; None: none in particular."""

    @classmethod
    def from_model(cls, arm: Arm, model: Model) -> PlanarDynamics:
        """Dynamics of a model, its effects included. Errors: as `from_parameters`, and what does not fit the arm."""
        return cls.from_parameters(arm, model.base_values(arm), model.effects)

    @classmethod
    def from_parameters(cls, arm: Arm, values: ArrayLike, effects: Sequence[Effect] = ()) -> PlanarDynamics:
        """Dynamics from base parameters in the order of `arm.parameter_names`, shape (p,), and effects.

        Errors: ZygosError if the number of values is not p or if some posture would have negative kinetic energy.
        """
        vector = np.asarray(values, dtype=np.float64)
        names = arm.parameter_names
        if vector.shape != (len(names),):
            raise ZygosError(
                f"arm {arm.name} has {len(names)} parameters, {vector.shape} values were given; "
                f"remedy: give one value for each of {', '.join(names)}"
            )
        value = dict(zip(names, vector.tolist(), strict=True))
        bodies = arm.n + 1
        a = np.zeros((bodies, bodies))
        b = np.zeros((bodies, bodies))
        for i in range(bodies):
            for j in range(i, bodies):
                a[i, j] = a[j, i] = value[f"a{i}{j}"]
                if i < j:
                    b[i, j] = value.get(f"b{i}{j}", 0.0)
                    b[j, i] = -b[i, j]
        joints = range(1, bodies)
        coupling, lag = np.ones(arm.n), np.zeros(arm.n)
        momentum: float | None = None
        laws: list[tuple[Kind, int, float]] = []
        for effect in effects:
            joint = effect.index(arm)
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
                "remedy: a lag of whole periods belongs into torque_law of the arm file"
            )
        dynamics = cls(
            a,
            b,
            np.array([value[f"Im{i}"] for i in joints]),
            np.array([value[f"k{i}"] for i in joints]),
            np.array([value[f"b{i}"] for i in joints]),
            arm.gear_ratios,
            coupling,
            tuple(laws),
            lag if lag.any() else None,
            momentum,
        )
        if dynamics.margin <= 0.0:
            raise ZygosError(
                f"arm {arm.name}: these a_ij give negative kinetic energy in some posture (smallest "
                f"eigenvalue {dynamics.margin:g} kg m^2); remedy: take the a_ij from one set of masses "
                "and lengths, they cannot be varied independently"
            )
        return dynamics

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.rotor_inertia)

    @cached_property
    def margin(self) -> float:
        """Smallest eigenvalue of the inertia matrix over all postures, rotors free, kg m^2.

        f_i exp(i phi_i) ranges over all complex vectors, so the Hermitian matrix a + ib less the rotors decides.
        """
        carried = np.append(self.coupling**2 * self.rotor_inertia, 0.0)
        return float(np.linalg.eigvalsh(self.a - np.diag(carried) + 1j * self.b)[0])

    def rates(self, omega0: ArrayLike, qd: Array) -> Array:
        """(..., N+1) absolute rates f from the base rate (...,) and the joint rates (..., N), rad/s."""
        return np.cumsum(np.concatenate([np.asarray(omega0, dtype=np.float64)[..., None], qd], axis=-1), axis=-1)

    def inertia(self, q: Array) -> tuple[Array, Array]:
        """The matrix G of the kinetic energy in the absolute rates and its derivative, both (..., N+1, N+1).

        G[i, j] = a_ij cos c + b_ij sin c; the second is dG[i, j]/dphi_j, c = phi_j - phi_i.
        """
        phi = np.cumsum(np.concatenate([np.zeros_like(q[..., :1]), q], axis=-1), axis=-1)
        angle = phi[..., None, :] - phi[..., :, None]
        cosine, sine = np.cos(angle), np.sin(angle)
        return self.a * cosine + self.b * sine, self.b * cosine - self.a * sine

    @cached_property
    def rigid(self) -> NDArray[np.bool_]:
        """(N,) joints whose stiffness is infinite."""
        return np.isinf(self.stiffness)

    @cached_property
    def _soft(self) -> Array:
        """(N,) stiffness; 0 at a rigid joint, whose torque is a constraint."""
        return np.where(self.rigid, 0.0, self.stiffness)

    @cached_property
    def _none(self) -> Array:
        return np.zeros(self.n)

    def friction_slope(self, place: Place) -> Array:
        """(N,) damping that friction at motors or links amounts to around standstill, Nms/rad after the gear."""
        slope = np.zeros(self.n)
        for kind, i, value in self.laws:
            if kind.place == place and kind.torque is not None:
                step = kind.torque(np.array([SLOWEST_RATE]))[0] / SLOWEST_RATE
                slope[i] += value * step * (self.gear_ratio[i] if place == "motor" else 1.0)
        return slope

    @cached_property
    def rotor_mass(self) -> Array:
        """(N+1, N+1) what the rotors add to the inertia matrix once their own accelerations are eliminated."""
        mass = -np.diag(np.append(np.where(self.rigid, 0.0, self.coupling**2 * self.rotor_inertia), 0.0))
        for i in np.flatnonzero(self.rigid):
            turn, carrier = np.zeros(self.n + 1), np.zeros(self.n + 1)
            turn[i], turn[i + 1], carrier[i] = -1.0, 1.0, 1.0
            rotor = self.rotor_inertia[i] * self.gear_ratio[i]
            both = np.outer(turn, carrier)
            mass += rotor * self.gear_ratio[i] * np.outer(turn, turn) + rotor * self.coupling[i] * (both + both.T)
        return mass

    def _forces(self, q: Array, theta: Array, qd: Array, thetad: Array) -> tuple[Array, Array, Array]:
        """(..., N) torques: of the springs on the links, of friction at motors (before the gear) and at links."""
        deflection = theta - q
        spring = self._soft * deflection + self.damping * (thetad - qd)
        if not self.laws:
            return spring, self._none, self._none
        motor, link = np.zeros_like(q), np.zeros_like(q)
        for kind, i, value in self.laws:
            assert kind.torque is not None
            if kind.place == "spring":
                spring[..., i] += value * kind.torque(deflection[..., i])
            elif kind.place == "motor":
                motor[..., i] += value * kind.torque(thetad[..., i])
            else:
                link[..., i] += value * kind.torque(qd[..., i])
        return spring, motor, link

    def spring(self, q: Array, theta: Array, qd: Array, thetad: Array) -> Array:
        """(..., N) torque of spring and damper on the link, Nm: k (theta - q) + b (thetad - qd), and what effects add.

        Zero for a rigid joint, whose torque is a constraint.
        """
        return self._forces(q, theta, qd, thetad)[0]

    def accelerations(
        self, q: Array, theta: Array, omega0: ArrayLike, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations (base (...,), joints (..., N), motors after the gear (..., N)), rad/s^2.

        q, theta rad; omega0, qd, thetad rad/s; tau the rotor torque before the gear, Nm (Nanos & Papadopoulos
        eqs. (14)-(18) in absolute angles, docs/theory.md).
        """
        f = self.rates(omega0, qd)
        inertia, slope = self.inertia(q)
        spring, motor_loss, link_loss = self._forces(q, theta, qd, thetad)
        ratio = self.gear_ratio
        drive = tau - motor_loss
        # a rigid gear hands on what drives the rotor, a spring what it holds
        rigid = self.rigid.any()
        force = (np.where(self.rigid, ratio * drive, spring) if rigid else spring) - link_loss
        right = -(slope @ (f * f)[..., None])[..., 0]
        right[..., 1:] += force
        # rotor i pushes off the body that carries it, with what its motor and the reaction of its gear leave over
        pushed = self.coupling * (drive - spring / ratio)
        right[..., :-1] -= force + (np.where(self.rigid, 0.0, pushed) if rigid else pushed)
        absolute = np.asarray(np.linalg.solve(inertia + self.rotor_mass, right[..., None])[..., 0], dtype=np.float64)
        joint = absolute[..., 1:] - absolute[..., :-1]
        motor = (ratio * drive - spring) / (ratio * ratio * self.rotor_inertia)
        motor -= self.coupling * absolute[..., :-1] / ratio
        return absolute[..., 0], joint, np.where(self.rigid, joint, motor) if rigid else motor

    def kinetic_energy(self, q: Array, omega0: ArrayLike, qd: Array, thetad: Array) -> Array:
        """(...,) kinetic energy T, J, without that of the mass centre (Nanos & Papadopoulos eq. (11))."""
        f = self.rates(omega0, qd)
        carried = self.coupling * f[..., :-1]
        rotor = self.rotor_inertia * self.gear_ratio * thetad * (0.5 * self.gear_ratio * thetad + carried)
        energy: Array = 0.5 * np.einsum("...i,...ij,...j->...", f, self.inertia(q)[0], f) + rotor.sum(axis=-1)
        return energy

    def elastic_energy(self, q: Array, theta: Array) -> Array:
        """(...,) energy in the joints' springs, J."""
        deflection = theta - q
        energy: Array = 0.5 * (self._soft * deflection**2).sum(axis=-1)
        for kind, i, value in self.laws:
            if kind.potential is not None:
                energy = energy + value * kind.potential(deflection[..., i])
        return energy

    def momentum(self, q: Array, omega0: ArrayLike, qd: Array, thetad: Array) -> Array:
        """(...,) angular momentum h about the mass centre along the joint axis, Nms."""
        rotor = self.coupling * self.rotor_inertia * self.gear_ratio * thetad
        total: Array = (self.inertia(q)[0] @ self.rates(omega0, qd)[..., None]).sum(axis=(-2, -1)) + rotor.sum(axis=-1)
        return total

    def base_rate(
        self,
        q: Array,
        momentum: float | Array,
        qd: Sequence[float] | Array | None = None,
        thetad: Sequence[float] | Array | None = None,
    ) -> Array:
        """(...,) base rate omega_0, rad/s, at which the arm has the given angular momentum, Nms."""
        joint = np.zeros_like(q) if qd is None else np.broadcast_to(np.asarray(qd, dtype=np.float64), q.shape)
        motor = np.zeros_like(q) if thetad is None else np.broadcast_to(np.asarray(thetad, dtype=np.float64), q.shape)
        rest = self.momentum(q, np.zeros(q.shape[:-1]), joint, motor)
        rate: Array = (momentum - rest) / self.inertia(q)[0].sum(axis=(-2, -1))
        return rate
