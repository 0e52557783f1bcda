# SPDX-License-Identifier: MIT
"""Equations of motion of the planar free-floating arm, from its base parameters and effects only (docs/theory.md).

Body i (0 = base) turns at the absolute rate f_i; f_0 = omega_0, f_i = f_{i-1} + qd_i; phi_i is its absolute angle. With
c = phi_j - phi_i the kinetic energy of Nanos & Papadopoulos eq. (11) is

    T = 1/2 sum_i a_ii f_i^2 + sum_{i<j} f_i f_j [a_ij cos c + b_ij sin c]
        + sum_i [1/2 Im_i n_i^2 thetad_i^2 + Im_i n_i thetad_i f_{i-1}]

and its Lagrange equations in (phi_0 .. phi_N, theta_1 .. theta_N) are solved here for the accelerations. Nothing else
is needed: neither masses nor lengths, and of the base only its rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.dynamics.joints import START, Drives, Moment, by_name, drives
from zygos.effects import Effect
from zygos.errors import ZygosError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PlanarDynamics(Drives):
    """A planar arm of N joints. Every method takes arrays with any leading batch axes."""

    a: Array
    """(N+1, N+1) symmetric a_ij, kg m^2."""
    b: Array
    """(N+1, N+1) antisymmetric b_ij (b[i, j] = b_ij for i < j), kg m^2; zero for a planar-symmetric arm."""
    skewed: bool = False
    """Whether the arm has parameters b_ij."""

    @classmethod
    def from_parameters(cls, arm: Arm, values: ArrayLike, effects: Sequence[Effect] = ()) -> Self:
        """Dynamics from base parameters in the order of `arm.parameter_names`, shape (p,), and effects.

        Errors: ZygosError if the number of values is not p or if some posture would have negative kinetic energy.
        """
        value = by_name(arm, values)
        bodies = arm.n + 1
        a = np.zeros((bodies, bodies))
        b = np.zeros((bodies, bodies))
        for i in range(bodies):
            for j in range(i, bodies):
                a[i, j] = a[j, i] = value[f"a{i}{j}"]
                if i < j:
                    b[i, j] = value.get(f"b{i}{j}", 0.0)
                    b[j, i] = -b[i, j]
        dynamics = cls(a=a, b=b, skewed=arm.kinetic == "planar", **drives(arm, value, effects))
        if dynamics.margin <= 0.0:
            raise ZygosError(
                f"arm {arm.name}: these a_ij give negative kinetic energy in some posture (smallest "
                f"eigenvalue {dynamics.margin:g} kg m^2); remedy: take the a_ij from one set of masses "
                "and lengths, they cannot be varied independently"
            )
        return dynamics

    @cached_property
    def margin(self) -> float:
        """Smallest eigenvalue of the inertia matrix over all postures, rotors free, kg m^2.

        f_i exp(i phi_i) covers all complex vectors, so the Hermitian matrix a + ib minus the rotors' share decides.
        """
        carried = np.append(self.coupling**2 * self.rotor_inertia, 0.0)
        return float(np.linalg.eigvalsh(self.a - np.diag(carried) + 1j * self.b)[0])

    @property
    def body_values(self) -> Array:
        """As `Drives.body_values`: a_ij, then b_ij where the arm has them."""
        i, j = np.triu_indices(self.n + 1)
        first, second = np.triu_indices(self.n + 1, 1)
        skew = self.b[first, second] if self.skewed else np.zeros(0)
        return np.concatenate([self.a[i, j], skew])

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
    def rotor_mass(self) -> Array:
        """(N+1, N+1) contribution of the rotors to the inertia matrix after their own accelerations are eliminated."""
        mass = -np.diag(np.append(np.where(self.rigid, 0.0, self.coupling**2 * self.rotor_inertia), 0.0))
        for i in np.flatnonzero(self.rigid):
            turn, carrier = np.zeros(self.n + 1), np.zeros(self.n + 1)
            turn[i], turn[i + 1], carrier[i] = -1.0, 1.0, 1.0
            rotor = self.rotor_inertia[i] * self.gear_ratio[i]
            both = np.outer(turn, carrier)
            mass += rotor * self.gear_ratio[i] * np.outer(turn, turn) + rotor * self.coupling[i] * (both + both.T)
        return mass

    def accelerations(
        self,
        q: Array,
        theta: Array,
        omega0: ArrayLike,
        qd: Array,
        thetad: Array,
        tau: Array,
        moment: Moment = START,
    ) -> tuple[Array, Array, Array]:
        """Accelerations (base (...,), joints (..., N), motors after the gear (..., N)), rad/s^2.

        q, theta rad; omega0, qd, thetad rad/s; tau the rotor torque before the gear, Nm (Nanos & Papadopoulos
        eqs. (14)-(18) in absolute angles, docs/theory.md); moment: for effects that depend on the time or on the
        base's angle.
        """
        if self.later is not None:
            return self._changing(self.later, q, theta, np.asarray(omega0), qd, thetad, tau, moment)
        f = self.rates(omega0, qd)
        inertia, slope = self.inertia(q)
        spring, motor_loss, link_loss = self.forces(q, theta, qd, thetad, tau, moment)
        ratio = self.gear_ratio
        drive = tau - motor_loss
        # a rigid gear transmits the torque that drives the rotor, a spring transmits its own torque
        rigid = self.rigid.any()
        force = (np.where(self.rigid, ratio * drive, spring) if rigid else spring) - link_loss
        right = -(slope @ (f * f)[..., None])[..., 0]
        right[..., 1:] += force
        if (pushing := self._base_torque(q, np.asarray(omega0, dtype=np.float64), moment)) is not None:
            right[..., 0] += pushing
        # the reaction on the body that carries rotor i is the difference of motor torque and gear reaction
        pushed = self.coupling * (drive - spring / ratio)
        right[..., :-1] -= force + (np.where(self.rigid, 0.0, pushed) if rigid else pushed)
        absolute = np.asarray(np.linalg.solve(inertia + self.rotor_mass, right[..., None])[..., 0], dtype=np.float64)
        joint = absolute[..., 1:] - absolute[..., :-1]
        motor = (ratio * drive - spring) / (ratio * ratio * np.where(self.rigid, 1.0, self.rotor_inertia))
        motor -= self.coupling * absolute[..., :-1] / ratio
        return absolute[..., 0], joint, np.where(self.rigid, joint, motor) if rigid else motor

    def mobility(self, q: Array) -> Array:
        """As `Drives.mobility`."""
        n = self.n
        joints = np.eye(n, n + 1, 1) - np.eye(n, n + 1)
        inertia = self.inertia(q)[0] + self.rotor_mass
        return np.asarray(joints @ np.linalg.solve(inertia, np.broadcast_to(joints.T, (*inertia.shape[:-1], n))))

    def gravity_energy(self, q: Array) -> Array:
        """(...,) 0: a free-floating arm falls with its orbit."""
        return np.zeros(q.shape[:-1])

    def kinetic_energy(self, q: Array, omega0: ArrayLike, qd: Array, thetad: Array) -> Array:
        """(...,) kinetic energy T, J, without that of the mass centre (Nanos & Papadopoulos eq. (11))."""
        f = self.rates(omega0, qd)
        carried = self.coupling * f[..., :-1]
        rotor = self.rotor_inertia * self.gear_ratio * thetad * (0.5 * self.gear_ratio * thetad + carried)
        energy: Array = 0.5 * np.einsum("...i,...ij,...j->...", f, self.inertia(q)[0], f) + rotor.sum(axis=-1)
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
