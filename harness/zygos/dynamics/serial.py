# SPDX-License-Identifier: MIT
"""Equations of motion of any serial arm, by projection of its constant matrix N (docs/theory.md, "Equations …").

With the directions rho_a of all bodies, their Jacobians J_a with respect to u = (omega_0, qd) and the matrix N_ab of
the kinetic energy, the inertia matrix is sum N_ab J_a' J_b, and the velocity terms are sum N_ab J_a' times the
accelerations that the directions have at constant u. No Christoffel symbols are needed, and only the rate of the base.
A fixed base has no omega_0 and may stand in gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zygos.arm import Arm
from zygos.balances.field import Pull, pull
from zygos.balances.kinematics import Posture, body_rates, posture
from zygos.dynamics.joints import START, Drives, Moment, by_name, drives
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.model import gram

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SpatialDynamics(Drives):
    """Any arm of N joints and V directions. Every method takes arrays with any leading batch axes.

    omega0 is (..., 3) in base axes. On a fixed base it is not read and returned as zeros; it may be (..., 0).
    """

    arm: Arm
    matrix: Array
    """(V, V) N, kg m^2."""
    moments: Array
    """(V,) first moments on which gravity acts, kg m."""

    @classmethod
    def from_parameters(cls, arm: Arm, values: ArrayLike, effects: Sequence[Effect] = ()) -> Self:
        """Dynamics from base parameters in the order of `arm.parameter_names`, shape (p,), and effects.

        Errors: ZygosError if the number of values is not p, or if no arm has this N minus the rotors' contribution.
        """
        value = by_name(arm, values)
        kinetic = np.array(list(value.values()))[: len(gram.pairs(arm)[0])]
        matrix = gram.from_parameters(arm, kinetic) if arm.spatial else _lifted(arm, value)
        moments = np.zeros(2 * arm.n + (3 if arm.free else 0))
        for i in np.flatnonzero(arm.feels_gravity):
            moments[len(moments) - 2 * (arm.n - i) :][:2] = value[f"G[{i + 1}u]"], value[f"G[{i + 1}v]"]
        dynamics = cls(arm=arm, matrix=matrix, moments=moments, **drives(arm, value, effects))
        if dynamics.angular_momentum is not None:
            raise ZygosError(
                f"arm {arm.name}: angular_momentum is an effect of planar arms; remedy: remove it from the model, and "
                "state angular_momentum_nms in the scenario"
            )
        if arm.structure.reduces:
            # such N is one of many with the same rows, and need not be that of bodies
            if dynamics.least_energy() < 0.0:
                raise ZygosError(
                    f"arm {arm.name}: these parameters give negative kinetic energy in some posture; remedy: take all "
                    "of them from one set of bodies, they cannot be varied independently"
                )
            return dynamics
        size = float(np.abs(matrix).max())
        share = gram.of_rotors(arm, dynamics.coupling**2 * np.where(dynamics.rigid, 0.0, dynamics.rotor_inertia))
        bodies = gram.from_parameters(arm, kinetic - gram.to_parameters(arm, share)) if arm.spatial else matrix
        least = float(np.linalg.eigvalsh(bodies)[0])
        if arm.spatial and least < -1e-9 * size:
            raise ZygosError(
                f"arm {arm.name}: no arm has these N (smallest eigenvalue {least:g} kg m^2); remedy: take all of them "
                "from one set of bodies, they cannot be varied independently"
            )
        return dynamics

    def least_energy(self) -> float:
        """Smallest eigenvalue of the inertia matrix, scaled to a unit diagonal, over 64 postures; -1 if an entry of the
        diagonal is not positive."""
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (64, self.n))
        soft = np.flatnonzero(~self.rigid)
        count = self._first + self.n + len(soft)
        rates = np.eye(count)

        def energy(u: Array) -> Array:
            qd = np.broadcast_to(u[self._first : self._first + self.n], q.shape)
            thetad = qd.copy()
            thetad[:, soft] = u[self._first + self.n :]
            base = np.broadcast_to(u[:3] if self._first else np.zeros(3), (len(q), 3))
            return self.kinetic_energy(q, base, qd, thetad)

        own = np.array([energy(unit) for unit in rates])
        matrix = np.empty((len(q), count, count))
        for i in range(count):
            for j in range(i, count):
                matrix[:, i, j] = matrix[:, j, i] = energy(rates[i] + rates[j]) - own[i] - own[j]
        scale = np.einsum("mii->mi", matrix)
        if not np.all(scale > 0.0):
            return -1.0
        size = np.sqrt(scale)
        return float(np.linalg.eigvalsh(matrix / (size[:, :, None] * size[:, None, :]))[:, 0].min())

    @cached_property
    def _bodies(self) -> NDArray[np.int64]:
        """(V,) body of each direction."""
        joints = np.repeat(np.arange(1, self.n + 1), 2)
        return np.concatenate([[0, 0, 0], joints]) if self.arm.free else joints

    @property
    def _first(self) -> int:
        """Number of coordinates of the base in u."""
        return 3 if self.arm.free else 0

    def _turns(self, places: Posture) -> Array:
        """(..., N+1, 3, U) Jacobians of the bodies' angular velocities with respect to u."""
        axis = places.axis
        turns = np.zeros((*axis.shape[:-2], self.n + 1, 3, self._first + self.n))
        if self._first:
            turns[..., :3] = np.eye(3)
        for i in range(self.n):
            turns[..., i + 1 :, :, self._first + i] = axis[..., None, i, :]
        return turns

    @property
    def body_values(self) -> Array:
        """As `Drives.body_values`."""
        if self.arm.spatial:
            kinetic = gram.to_parameters(self.arm, self.matrix)
        else:
            i, j = np.triu_indices(self.n)
            kinetic = self.matrix[2 * i, 2 * j]
            if self.arm.kinetic == "planar":
                kinetic = np.concatenate([kinetic, _hand(self.arm) * self.matrix[2 * i + 1, 2 * j][i < j]])
        last = self.moments[-2 * self.n :]
        return np.concatenate([kinetic, last[np.repeat(self.arm.feels_gravity, 2)]])

    def _rate_of_base(self, q: Array, omega0: Array) -> Array:
        """(..., 3) base rate; 0 where the base is fixed."""
        return omega0 if self.arm.free else np.zeros((*q.shape[:-1], 3))

    def mobility(self, q: Array) -> Array:
        """As `Drives.mobility`."""
        places = posture(self.arm, q)
        turns = self._turns(places)
        jacobian, weighed = self._inertia(places, turns)
        mass = np.einsum("...acu,...acw->...uw", jacobian, weighed)
        self._add_rotors(mass, np.einsum("...icu,...ic->...iu", turns[..., :-1, :, :], places.axis))
        torque = np.eye(mass.shape[-1])[:, self._first :]
        solved = np.linalg.solve(mass, np.broadcast_to(torque, (*mass.shape[:-2], *torque.shape)))
        return np.asarray(solved[..., self._first :, :], dtype=np.float64)

    def _pull(self, places: Posture, moment: Moment) -> Pull | None:
        """What the gravity gradient does: J, Nm; None where there is none."""
        if not self.gradient or moment.nadir is None:
            return None
        return pull(places, self.gradient * self.matrix, moment.nadir)

    def _add_rotors(self, mass: Array, along: Array) -> None:
        """Add what the rotors do to the inertia matrix after their own accelerations are eliminated. along: (..., N, U)
        rates of the carrying bodies about the axes."""
        ratio, rotor, coupling = self.gear_ratio, self.rotor_inertia, self.coupling
        mass -= np.einsum("i,...iu,...iw->...uw", np.where(self.rigid, 0.0, coupling**2 * rotor), along, along)
        for i in np.flatnonzero(self.rigid):
            turn = np.zeros(mass.shape[-1])
            turn[self._first + i] = 1.0
            both = coupling[i] * rotor[i] * ratio[i] * along[..., i, :, None] * turn
            mass += rotor[i] * ratio[i] ** 2 * np.outer(turn, turn) + both + np.swapaxes(both, -1, -2)

    def _inertia(self, places: Posture, turns: Array) -> tuple[Array, Array]:
        """Jacobians of the directions, and N times them; both (..., V, 3, U)."""
        jacobian = -np.cross(places.direction[..., :, :, None], turns[..., self._bodies, :, :], axis=-2)
        return jacobian, np.einsum("ab,...bcu->...acu", self.matrix, jacobian)

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
        """Accelerations (base (..., 3) in base axes, joints (..., N), motors after the gear (..., N)), rad/s^2.

        q, theta rad; omega0, qd, thetad rad/s; tau the rotor torque before the gear, Nm. moment: for effects that
        depend on the time.
        """
        if self.later is not None:
            return self._changing(self.later, q, theta, omega0, qd, thetad, tau, moment)
        places = posture(self.arm, q)
        turns = self._turns(places)
        jacobian, weighed = self._inertia(places, turns)
        mass = np.einsum("...acu,...acw->...uw", jacobian, weighed)
        axis, rho = places.axis, places.direction
        omega = body_rates(self._rate_of_base(q, omega0), axis, qd)
        # accelerations of bodies and directions at constant u
        slip = np.cross(omega[..., :-1, :], axis) * qd[..., None]
        alpha = np.concatenate([np.zeros_like(omega[..., :1, :]), np.cumsum(slip, axis=-2)], axis=-2)
        of = self._bodies
        swing = np.cross(alpha[..., of, :], rho) + np.cross(omega[..., of, :], np.cross(omega[..., of, :], rho))
        right = -np.einsum("...acu,...ac->...u", weighed, swing)
        if self.moments.any():
            weight = self.moments[:, None] * np.array(self.arm.gravity)
            right += np.einsum("...acu,ac->...u", jacobian, weight)

        spring, motor_loss, link_loss = self.forces(q, theta, qd, thetad, tau, moment)
        ratio, rotor, coupling = self.gear_ratio, self.rotor_inertia, self.coupling
        drive = tau - motor_loss
        force = np.where(self.rigid, ratio * drive, spring) - link_loss
        right[..., self._first :] += force
        if (pushing := self._base_torque(q, omega0, moment)) is not None:
            right[..., : self._first] += pushing
        if (pulling := self._pull(places, moment)) is not None:
            right[..., : self._first] += pulling.base
            right[..., self._first :] += pulling.joints
        carrier = turns[..., :-1, :, :]
        along = np.einsum("...icu,...ic->...iu", carrier, axis)  # g_i: rate of the carrier about the axis
        gained = np.sum(axis * alpha[..., :-1, :], axis=-1)
        gyroscopic = np.einsum("...icu,...ic->...iu", carrier, np.cross(omega[..., :-1, :], axis))
        spin = coupling * rotor * ratio * np.where(self.rigid, qd, thetad)
        right -= np.einsum("...i,...iu->...u", spin, gyroscopic)
        pushed = coupling * (drive - spring / ratio - coupling * rotor * gained)
        right -= np.einsum("...i,...iu->...u", np.where(self.rigid, 0.0, pushed), along)
        self._add_rotors(mass, along)
        for i in np.flatnonzero(self.rigid):
            right[..., self._first + i] -= coupling[i] * rotor[i] * ratio[i] * gained[..., i]

        solved = np.linalg.solve(mass, right[..., None])[..., 0]
        base = solved[..., :3] if self._first else np.zeros_like(omega0)
        joint = solved[..., self._first :]
        free = np.where(self.rigid, 1.0, rotor)
        motor = (ratio * drive - spring) / (ratio * ratio * free)
        motor -= coupling * (np.einsum("...iu,...u->...i", along, solved) + gained) / ratio
        return base, joint, np.where(self.rigid, joint, motor)

    def kinetic_energy(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """(...,) kinetic energy T, J; of a free-floating arm without that of the mass centre."""
        places = posture(self.arm, q)
        omega = body_rates(self._rate_of_base(q, omega0), places.axis, qd)
        rate = np.cross(omega[..., self._bodies, :], places.direction)
        spin = self.gear_ratio * thetad
        carried = self.coupling * np.sum(places.axis * omega[..., :-1, :], axis=-1)
        rotors = self.rotor_inertia * spin * (0.5 * spin + carried)
        energy: Array = 0.5 * np.einsum("ab,...ac,...bc->...", self.matrix, rate, rate) + rotors.sum(axis=-1)
        return energy

    def gravity_energy(self, q: Array) -> Array:
        """(...,) potential energy in gravity, J, up to a constant."""
        pull: Array = -(posture(self.arm, q).direction @ np.array(self.arm.gravity)) @ self.moments
        return pull

    def momentum(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """(..., 3) angular momentum h about the mass centre of a free-floating arm, base axes, Nms."""
        places = posture(self.arm, q)
        omega = body_rates(omega0, places.axis, qd)
        rate = np.cross(omega[..., self._bodies, :], places.direction)
        spin = self.coupling * self.rotor_inertia * self.gear_ratio * thetad
        weighed = np.einsum("ab,...bc->...ac", self.matrix, rate)
        total: Array = np.cross(places.direction, weighed).sum(axis=-2) + np.sum(spin[..., None] * places.axis, axis=-2)
        return total

    def base_rate(self, q: Array, momentum: ArrayLike, qd: Array | None = None, thetad: Array | None = None) -> Array:
        """(..., 3) base rate, rad/s, at which a free-floating arm has the angular momentum (..., 3), Nms, base axes."""
        joint = np.zeros_like(q) if qd is None else qd
        motor = np.zeros_like(q) if thetad is None else thetad
        places = posture(self.arm, q)
        jacobian, weighed = self._inertia(places, self._turns(places))
        mass = np.einsum("...acu,...acw->...uw", jacobian[..., :3], weighed[..., :3])
        rest = self.momentum(q, np.zeros((*q.shape[:-1], 3)), joint, motor)
        rate: Array = np.linalg.solve(mass, (np.asarray(momentum) - rest)[..., None])[..., 0]
        return rate


def _hand(arm: Arm) -> float:
    """1 or -1: R_i P_i turns by +phi_i or -phi_i in the order (u, v), depending on whether the axis points along u x v
    or against it."""
    return float(np.sign(np.linalg.det(np.column_stack([posture(arm, np.zeros(arm.n)).direction[:2].T, arm.axis]))))


def _lifted(arm: Arm, value: dict[str, float]) -> Array:
    """N (V, V) of a planar arm on a fixed base: as all rates are along one axis, v_iu . v_ju = f_i f_j cos."""
    matrix = np.zeros((2 * arm.n, 2 * arm.n))
    hand = _hand(arm)
    for i in range(1, arm.n + 1):
        for j in range(i, arm.n + 1):
            row, column = 2 * (i - 1), 2 * (j - 1)
            matrix[row, column] = matrix[column, row] = value[f"a{i}{j}"]
            skew = hand * value.get(f"b{i}{j}", 0.0)
            if skew:
                matrix[row + 1, column] = matrix[column, row + 1] = skew
    return matrix
