# SPDX-License-Identifier: MIT
"""Equations of motion with their derivatives with respect to state, parameters and torques (docs/theory.md, "The
information limit").

The residual r(x, y; p) of the equations of motion is linear in the parameters p and in the accelerations y = (base,
joints, motors). With M = dr/dy it follows that dy/dx = -M^-1 dr/dx, and that the columns of dy/dp are -M^-1 times the
residual of one parameter alone. Everything is written in directions rho_a that are fixed in bodies: with A_a the
acceleration of a direction and W_u the Jacobians of the bodies' angular velocities, the residual of N_ab is
W_u . (rho_a x A_b + rho_b x A_a).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.ground.estimate import sizes

Floats = NDArray[np.float64]
Places = NDArray[np.int64]


class Slopes(NamedTuple):
    """Accelerations in B states, and their derivatives; g = W + 2N accelerations of an arm whose base has W rates."""

    acceleration: Floats
    """(B, g) of base, joints and motors after the gear, rad/s^2."""
    of_state: Floats
    """(B, g, W + 4N) by base rates, q, theta, and their rates."""
    of_parameters: Floats
    """(B, g, p)."""
    of_torque: Floats
    """(B, g, N) by the torques before the gear."""


def base_rates(arm: Arm) -> int:
    """W: 3 in space, 1 in a plane, 0 where the base is fixed."""
    return 0 if not arm.free else 3 if arm.spatial else 1


@dataclass(frozen=True)
class FlexibleMotion:
    """An arm whose joints are all flexible; V directions, N joints, W rates of its base (3 in space, 1 in a plane, 0
    where it is fixed), p parameters in the order of `arm.parameters`."""

    arm: Arm
    values: Floats
    """(p,) parameters, SI units."""

    def __post_init__(self) -> None:
        """Errors: ZygosError where a joint is rigid."""
        for joint in self.arm.joints:
            if not joint.flexible:
                raise ZygosError(
                    f"arm {self.arm.name}: joint {joint.name} is rigid, and derivatives of the motion are known for "
                    "arms whose joints are all flexible; remedy: state a spring for the joint (flexible = true)"
                )

    @property
    def base_rates(self) -> int:
        """W."""
        return base_rates(self.arm)

    @property
    def states(self) -> int:
        """Length of a state: W base rates, q, theta, and their rates, as `State.packed`."""
        return self.base_rates + 4 * self.arm.n

    @cached_property
    def size(self) -> Floats:
        """(p,) to which errors of the parameters are compared, SI units: the value; of N and of b_ij of bodies at least
        the geometric mean of the two moments of inertia that belong to it; where that is 0, the largest value with the
        same unit of the same body."""
        a, b, _ = self._pairs
        matrix = self._full[0]
        mean = np.zeros(len(self.arm.full_parameters))
        mean[: len(a)] = np.sqrt(np.abs(matrix[a, a] * matrix[b, b]))
        of_full = dict(zip(self.arm.full_names, mean.tolist(), strict=True))
        least = [
            of_full.get(one.name, 0.0) if one.symbol in ("N", "b") and one.joint is None else 0.0
            for one in self.arm.parameters
        ]
        size = np.maximum(np.abs(self.values), least)
        return np.where(size > 0.0, size, sizes(self.arm.parameter_names, self.arm.parameter_units, self.values))

    @cached_property
    def _directions(self) -> tuple[Places, Floats]:
        """(V,) body of each direction, and (V, 3) the direction in the frame of its body."""
        arm = self.arm
        across = arm.across.transpose(0, 2, 1)
        first = 0 if arm.free else 1
        if arm.spatial:
            of_base = np.eye(3) if arm.free else np.zeros((0, 3))
            joints = np.repeat(np.arange(1, arm.n + 1), 2)
            return np.concatenate([np.zeros(len(of_base), np.int64), joints]), np.concatenate(
                [of_base, across.reshape(-1, 3)]
            )
        sides = 2 if arm.kinetic == "planar" or any(arm.feels_gravity) else 1
        return np.repeat(np.arange(first, arm.n + 1), sides), np.tile(across[0, :sides], (arm.n + 1 - first, 1))

    @cached_property
    def _pairs(self) -> tuple[Places, Places, Floats]:
        """Of each parameter of the kinetic energy the two directions, and the factor to N_ab."""
        arm = self.arm
        body, _ = self._directions
        place = {(int(i), int(np.sum(body[:k] == i))): k for k, i in enumerate(body)}
        side = {"x": 0, "y": 1, "z": 2, "u": 0, "v": 1}
        hand = float(np.sign(np.cross(arm.axis, arm.across[0, :, 0]) @ arm.across[0, :, 1])) if not arm.spatial else 1.0
        a, b, factor = [], [], []
        for one in arm.full_parameters:
            if one.joint is not None or one.symbol not in ("N", "a", "b"):
                continue
            ends = [(int(end[:-1]), side[end[-1]]) for end in one.ends] if one.symbol == "N" else [
                (int(end), 0) for end in one.ends
            ]  # fmt: skip
            if one.symbol == "b":
                ends[0] = (ends[0][0], 1)
            a.append(place[ends[0]])
            b.append(place[ends[1]])
            factor.append(hand if one.symbol == "b" else 1.0)
        return np.array(a), np.array(b), np.array(factor)

    @cached_property
    def _moment_at(self) -> Places:
        """Of each first moment its direction."""
        body, _ = self._directions
        felt = np.concatenate([[False], self.arm.feels_gravity])
        return np.flatnonzero(felt[body]) if any(self.arm.feels_gravity) else np.zeros(0, np.int64)

    @cached_property
    def _full(self) -> tuple[Floats, Floats, Floats]:
        """Matrix N (V, V), first moments (V,) and (3, N) rotor inertias, stiffnesses and dampings."""
        full = self.arm.structure.expanded(self.values)
        a, b, factor = self._pairs
        size = len(self._directions[0])
        matrix, moment = np.zeros((size, size)), np.zeros(size)
        matrix[a, b] = factor * full[: len(a)]
        matrix[b, a] = matrix[a, b]
        moment[self._moment_at] = full[len(a) : len(a) + len(self._moment_at)]
        # all joints are flexible, but the rotor of a first joint on a fixed base may be part of its link
        drive = np.zeros((3, self.arm.n))
        rows = {"Im": 0, "k": 1, "b": 2}
        joints = self.arm.full_joint_parameters
        for (symbol, joint), value in zip(joints, full[len(full) - len(joints) :], strict=True):
            drive[rows[symbol], joint] = value
        return matrix, moment, drive

    @cached_property
    def _mounts(self) -> Floats:
        """(N, 3, 3) attitude of each joint's frame in the body that carries it."""
        return np.stack([Rotation.from_euler("xyz", joint.frame_rpy).as_matrix() for joint in self.arm.joints])

    def slopes(self, state: Floats, tau: Floats) -> Slopes:
        """Accelerations and their derivatives in the states (B, W + 4N), as `State.packed`, under the torques (B, N)
        before the gear, Nm."""
        n, width, batch = self.arm.n, self.base_rates, len(state)
        moved = width + n  # coordinates of the bodies
        ratio = self.arm.gear_ratios
        matrix, moment, (rotor, stiffness, damping) = self._full
        of, _ = self._directions
        q, theta, qd, thetad = (state[:, width + i * n : width + (i + 1) * n] for i in range(4))

        axis, rho = self._places(q)
        # Jacobians of the angular velocities of the bodies with respect to the rates of base and joints
        turn = np.zeros((batch, n + 1, moved, 3))
        turn[:, :, :width] = (np.eye(3) if width == 3 else self.arm.axis[None] if width else np.zeros((0, 3)))[
            None, None
        ]
        for k in range(n):
            turn[:, k + 1 :, width + k] = axis[:, None, k]
        rates = np.concatenate([state[:, :width], qd], axis=1)
        omega = np.einsum("biuc,bu->bic", turn, rates)
        lean = _cross(omega[:, :-1], axis)  # rates of the axes
        drift = np.zeros((batch, n + 1, 3))
        np.cumsum(lean * qd[..., None], axis=1, out=drift[:, 1:])

        swing = _cross(omega[:, of], _cross(omega[:, of], rho))
        weight = moment[:, None] * np.array(self.arm.gravity)
        # what remains of the residual without accelerations
        force = np.einsum("ab,zbc->zac", matrix, _cross(drift[:, of], rho) + swing) - weight
        load = _by_body(_cross(rho, force), of, n + 1)
        load[:, :-1] += (rotor * ratio * thetad)[..., None] * lean
        spring = stiffness * (theta - q) + damping * (thetad - qd)
        rest = np.zeros((batch, moved + n))
        rest[:, :moved] = np.einsum("biuc,bic->bu", turn, load)
        rest[:, width:moved] -= spring
        rest[:, moved:] = rotor * ratio * np.sum(axis * drift[:, :-1], axis=-1) + spring - ratio * tau

        pushed = np.einsum("ab,zubc->zuac", matrix, _cross(np.swapaxes(turn, 1, 2)[:, :, of], rho[:, None]))
        inertia = np.zeros((batch, moved + n, moved + n))
        inertia[:, :moved, :moved] = np.einsum(
            "ziuc,zwic->zuw", turn, _by_body(_cross(rho[:, None], pushed), of, n + 1)
        )
        along = np.einsum("biuc,bic->bui", turn[:, :-1], axis) * (rotor * ratio)
        inertia[:, :moved, moved:] = along
        inertia[:, moved:, :moved] = np.swapaxes(along, 1, 2)
        inertia[:, moved:, moved:] = np.diag(rotor * ratio**2)
        inverse = np.linalg.inv(inertia)
        y = -np.einsum("buw,bw->bu", inverse, rest)

        spin = drift + np.einsum("biuc,bu->bic", turn, y[:, :moved])
        acceleration = _cross(spin[:, of], rho) + swing
        force = np.einsum("ab,zbc->zac", matrix, acceleration) - weight
        load = _by_body(_cross(rho, force), of, n + 1)
        reaction = y[:, moved:, None] * axis + thetad[..., None] * lean  # of a rotor on its carrier, by n Im
        load[:, :-1] += (rotor * ratio)[:, None] * reaction

        by_state = np.zeros((batch, moved + n, self.states))
        self._by_angles(by_state, (axis, rho, turn, omega, spin, force, load), qd, thetad, y)
        self._by_rates(by_state, (axis, rho, turn, omega, lean), thetad, qd)
        self._by_springs(by_state)
        columns = self._columns(axis, rho, turn, acceleration, reaction, y[:, moved:], spin, theta - q, thetad - qd)
        return Slopes(
            y,
            -inverse @ by_state,
            -inverse @ self.arm.structure.reduced(columns),
            inverse[:, :, moved:] * ratio,
        )

    def _places(self, q: Floats) -> tuple[Floats, Floats]:
        """(B, N, 3) axes and (B, V, 3) directions at the angles (B, N), in base axes."""
        body, own = self._directions
        attitude = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        listed, axes = [attitude], []
        for i, joint in enumerate(self.arm.joints):
            axis = np.array(joint.axis)
            attitude = attitude @ self._mounts[i] @ Rotation.from_rotvec(q[:, i, None] * axis).as_matrix()
            axes.append(attitude @ axis)
            listed.append(attitude)
        return np.stack(axes, axis=1), np.einsum("bacd,ad->bac", np.stack(listed, axis=1)[:, body], own)

    def _by_angles(self, out: Floats, seen: tuple[Floats, ...], qd: Floats, thetad: Floats, y: Floats) -> None:
        """Add the derivatives of the residual by q to `out`: each angle turns all that lies beyond its joint."""
        n, width = self.arm.n, self.base_rates
        moved = width + n
        axis, rho, turn, omega, spin, force, load = seen
        matrix, _, (rotor, _, _) = self._full
        of, _ = self._directions
        geared = rotor * self.arm.gear_ratios
        beyond = np.arange(n)[None, :] >= np.arange(n)[:, None]
        tilt = _cross(axis[:, :, None], axis[:, None]) * beyond[..., None]  # (B, m, k, 3) of axis k by angle m
        shift = _cross(axis[:, :, None], rho[:, None]) * (of[None, :] > np.arange(n)[:, None])[..., None]
        faster = np.zeros((len(qd), n, n + 1, 3))
        np.cumsum(tilt * qd[:, None, :, None], axis=2, out=faster[:, :, 1:])
        bend = _cross(faster[:, :, :-1], axis[:, None]) + _cross(omega[:, None, :-1], tilt)
        later = np.zeros_like(faster)
        np.cumsum(tilt * y[:, None, width:moved, None] + bend * qd[:, None, :, None], axis=2, out=later[:, :, 1:])
        slow, w = spin[:, None, of], omega[:, None, of]
        change = (
            _cross(later[:, :, of], rho[:, None])
            + _cross(slow, shift)
            + _cross(faster[:, :, of], _cross(w, rho[:, None]))
            + _cross(w, _cross(faster[:, :, of], rho[:, None]) + _cross(w, shift))
        )
        pushed = np.einsum("ab,zmbc->zmac", matrix, change)
        torque = _by_body(_cross(shift, force[:, None]) + _cross(rho[:, None], pushed), of, n + 1)
        torque[:, :, :-1] += geared[:, None] * (y[:, None, moved:, None] * tilt + thetad[:, None, :, None] * bend)
        place = slice(width, width + n)
        out[:, :moved, place] += np.einsum("ziuc,zmic->zum", turn, torque)
        # an axis that is turned takes another component of the load beyond it
        beyond_load = np.cumsum(load[:, :0:-1], axis=1)[:, ::-1]
        out[:, width:moved, place] += np.einsum("zmkc,zkc->zkm", tilt, beyond_load)
        out[:, moved:, place] += np.swapaxes(
            geared
            * (np.einsum("zmkc,zkc->zmk", tilt, spin[:, :-1]) + np.einsum("zkc,zmkc->zmk", axis, later[:, :, :-1])),
            1,
            2,
        )

    def _by_rates(self, out: Floats, seen: tuple[Floats, ...], thetad: Floats, qd: Floats) -> None:
        """Add the derivatives of the residual by the rates of base, joints and motors to `out`."""
        n, width = self.arm.n, self.base_rates
        moved = width + n
        axis, rho, turn, omega, lean = seen
        matrix, _, (rotor, _, _) = self._full
        of, _ = self._directions
        geared = rotor * self.arm.gear_ratios
        faster = np.swapaxes(turn, 1, 2)  # (B, u, i, 3)
        bend = _cross(faster[:, :, :-1], axis[:, None])
        later = np.zeros_like(faster)
        np.cumsum(bend * qd[:, None, :, None], axis=2, out=later[:, :, 1:])
        for k in range(n):
            later[:, width + k, k + 1 :] += lean[:, None, k]
        w = omega[:, None, of]
        change = (
            _cross(later[:, :, of], rho[:, None])
            + _cross(faster[:, :, of], _cross(w, rho[:, None]))
            + _cross(w, _cross(faster[:, :, of], rho[:, None]))
        )
        torque = _by_body(_cross(rho[:, None], np.einsum("ab,zubc->zuac", matrix, change)), of, n + 1)
        torque[:, :, :-1] += geared[:, None] * thetad[:, None, :, None] * bend
        places = np.concatenate([np.arange(width), width + 2 * n + np.arange(n)])
        out[:, :moved, places] += np.einsum("ziuc,zwic->zuw", turn, torque)
        out[:, moved:, places] += np.swapaxes(geared * np.einsum("zkc,zukc->zuk", axis, later[:, :, :-1]), 1, 2)
        out[:, :moved, width + 3 * n :] += geared * np.einsum("ziuc,zic->zui", turn[:, :-1], lean)

    def _by_springs(self, out: Floats) -> None:
        """Add the derivatives of the residual by deflections and their rates to `out`."""
        n, width = self.arm.n, self.base_rates
        moved = width + n
        _, stiffness, damping = self._full[2]
        joints, motors = np.arange(n) + width, np.arange(n) + moved
        for factor, first in ((stiffness, width), (damping, width + 2 * n)):
            links, rotors = np.arange(n) + first, np.arange(n) + first + n
            out[:, joints, links] += factor
            out[:, motors, rotors] += factor
            out[:, joints, rotors] -= factor
            out[:, motors, links] -= factor

    def _columns(
        self,
        axis: Floats,
        rho: Floats,
        turn: Floats,
        acceleration: Floats,
        reaction: Floats,
        motor: Floats,
        spin: Floats,
        bent: Floats,
        bending: Floats,
    ) -> Floats:
        """(B, g, p_full) residual of each full parameter alone."""
        n, width = self.arm.n, self.base_rates
        moved = width + n
        ratio = self.arm.gear_ratios
        of, _ = self._directions
        a, b, factor = self._pairs
        columns = np.zeros((len(rho), moved + n, len(self.arm.full_parameters)))
        pairs = np.einsum("zkuc,zkc->zuk", turn[:, of[a]], _cross(rho[:, a], acceleration[:, b]))
        pairs += (a != b) * np.einsum("zkuc,zkc->zuk", turn[:, of[b]], _cross(rho[:, b], acceleration[:, a]))
        columns[:, :moved, : len(a)] = factor * pairs
        at = self._moment_at
        pull = _cross(rho[:, at], np.array(self.arm.gravity))
        columns[:, :moved, len(a) : len(a) + len(at)] = -np.einsum("zkuc,zkc->zuk", turn[:, of[at]], pull)
        joints = self.arm.full_joint_parameters
        for place, (symbol, i) in enumerate(joints, columns.shape[2] - len(joints)):
            if symbol == "Im":
                columns[:, :moved, place] = ratio[i] * np.einsum("zuc,zc->zu", turn[:, i], reaction[:, i])
                columns[:, moved + i, place] = ratio[i] ** 2 * motor[:, i] + ratio[i] * np.sum(
                    axis[:, i] * spin[:, i], axis=-1
                )
            else:
                part = bent[:, i] if symbol == "k" else bending[:, i]
                columns[:, width + i, place] = -part
                columns[:, moved + i, place] = part
        return columns

    def step(self, state: Floats, tau: Floats, h: float, steps: int) -> tuple[Floats, Floats]:
        """The states (B, x) after h s under held torques (B, N), by classical Runge-Kutta, and their derivatives
        (B, x, x + p + N) with respect to the states before, the parameters and the torques; x = W + 4N."""
        batch, size, p = len(state), self.states, len(self.values)
        slope = np.zeros((batch, size, size + p + self.arm.n))
        slope[:, :, :size] = np.eye(size)
        x, part = state, h / steps
        for _ in range(steps):
            first = self._flow(x, slope, tau)
            second = self._flow(x + 0.5 * part * first[0], slope + 0.5 * part * first[1], tau)
            third = self._flow(x + 0.5 * part * second[0], slope + 0.5 * part * second[1], tau)
            fourth = self._flow(x + part * third[0], slope + part * third[1], tau)
            x = x + part / 6.0 * (first[0] + 2.0 * (second[0] + third[0]) + fourth[0])
            slope = slope + part / 6.0 * (first[1] + 2.0 * (second[1] + third[1]) + fourth[1])
        return x, slope

    def _flow(self, x: Floats, slope: Floats, tau: Floats) -> tuple[Floats, Floats]:
        """Time derivatives of states and of their derivatives."""
        n, width, size = self.arm.n, self.base_rates, self.states
        found = self.slopes(x, tau)
        rate, of_slope = np.empty_like(x), np.empty_like(slope)
        angles, rates = slice(width, width + 2 * n), slice(width + 2 * n, size)
        rate[:, angles], of_slope[:, angles] = x[:, rates], slope[:, rates]
        turned = found.of_state @ slope
        turned[:, :, size : size + len(self.values)] += found.of_parameters
        turned[:, :, size + len(self.values) :] += found.of_torque
        rate[:, :width], of_slope[:, :width] = found.acceleration[:, :width], turned[:, :width]
        rate[:, rates], of_slope[:, rates] = found.acceleration[:, width:], turned[:, width:]
        return rate, of_slope


def _cross(a: Floats, b: Floats) -> Floats:
    """Products a x b of (..., 3); faster than numpy's on small arrays."""
    shape = np.broadcast_shapes(a.shape, b.shape)
    out = np.empty(shape)
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def _by_body(torque: Floats, of: Places, bodies: int) -> Floats:
    """(..., bodies, 3) sums of the torques (..., V, 3) of directions that lie in the same body."""
    return np.stack([torque[..., of == i, :].sum(axis=-2) for i in range(bodies)], axis=-2)
