# SPDX-License-Identifier: MIT
"""The equations of motion of `zygos.dynamics.serial`, compiled (c/ports/host/multibody.c), and steps of time.

For steps of time the catalogue's laws are compiled, but for an oscillator; elsewhere effects follow their laws in
Python. The compiled code computes the same matrix in a different order, and shares no code with the library that
estimates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import across
from zygos.balances.kinematics import posture
from zygos.dynamics.joints import START, Drives, Moment
from zygos.dynamics.planar import PlanarDynamics
from zygos.dynamics.serial import SpatialDynamics
from zygos.effects import compiled_form
from zygos.native.flight import ffi, lib

Array = NDArray[np.float64]


class Compiled(NamedTuple):
    """An arm as the compiled code takes it."""

    arm: Any
    """The struct zygos_multibody_t."""
    scratch: int
    """Doubles that a call needs as work space."""
    kept: list[Any]
    """Memory that the struct points to."""


def _compile(dynamics: Drives, floating: bool, fields: dict[str, Array]) -> Compiled:
    """The struct from geometry and matrices, and from what all drives have."""
    fields |= {"ratio": dynamics.gear_ratio, "rotor": dynamics.rotor_inertia, "coupling": dynamics.coupling}
    native = ffi.new("zygos_multibody_t *", {"joints": dynamics.n, "floating": int(floating)})
    kept: list[Any] = []
    for name, values in fields.items():
        kept.append(ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=np.float64)))
        setattr(native, name, kept[-1])
    kept.append(ffi.from_buffer("uint8_t[]", dynamics.rigid.astype(np.uint8)))
    native.rigid = kept[-1]
    return Compiled(native, int(lib.zygos_multibody_scratch(dynamics.n)), kept)


def _frames(axes: Array, mounts: Array) -> dict[str, Array]:
    """Joint axes (N, 3) and orientations of the joints' frames (N, 3, 3), as the struct has them."""
    along = axes[:, :, None] * axes[:, None, :]
    # Rodrigues' formula: the constant part of a rotation about the axis, and the parts of its cosine and sine
    turning = np.stack([along, np.eye(3) - along, np.cross(np.eye(3), axes[:, None, :])], axis=1)
    sides = np.stack([across(axis).T for axis in axes])
    return {"turn": mounts[:, None] @ turning, "axis": axes, "across": sides}


@dataclass(frozen=True, kw_only=True)
class Planar(PlanarDynamics):
    """A planar arm that floats, with the accelerations of all states computed by one call of compiled code."""

    @cached_property
    def compiled(self) -> Compiled:
        """The arm for the compiled code."""
        compiled = _compile(self, True, {"matrix": np.stack([self.a, self.b, self.rotor_mass])})
        compiled.arm.planar = 1
        return compiled

    def __getstate__(self) -> dict[str, Any]:
        """The state without pointers into this process; a copy creates its own."""
        return {name: value for name, value in self.__dict__.items() if name != "compiled"}

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
        """As `PlanarDynamics.accelerations`, which computes them of an arm whose bodies change."""
        if self.later is not None:
            return super().accelerations(q, theta, omega0, qd, thetad, tau, moment)
        spring, motor_loss, link_loss = self.forces(q, theta, qd, thetad, tau, moment)
        n, batch = self.n, q.shape[:-1]
        state, force = np.empty((*batch, 1 + 4 * n)), np.empty((*batch, 3 * n + 1))
        state[..., 0] = omega0
        for k, part in enumerate((q, theta, qd, thetad)):
            state[..., 1 + k * n : 1 + (k + 1) * n] = part
        for k, part in enumerate((spring, tau - motor_loss, -link_loss)):
            force[..., k * n : (k + 1) * n] = part
        pushing = self._base_torque(q, np.asarray(omega0, dtype=np.float64), moment)
        force[..., 3 * n] = 0.0 if pushing is None else pushing
        result = np.empty(state.shape)
        lib.zygos_multibody_rates(
            self.compiled.arm,
            result.size // (1 + 4 * n),
            1,
            ffi.from_buffer("double[]", state),
            ffi.from_buffer("double[]", force),
            ffi.from_buffer("double[]", result),
            ffi.from_buffer("double[]", np.empty(self.compiled.scratch)),
        )
        return result[..., 0], result[..., 1 + 2 * n : 1 + 3 * n], result[..., 1 + 3 * n :]


def _laws(dynamics: Drives) -> Any:
    """The laws at joints and on the base, all of which the compiled code has."""
    laws = [*(law for law, _, _ in dynamics.acting), *dynamics.base_laws]
    native = ffi.new("zygos_multibody_law_t[]", len(laws))
    for one, law in zip(native, laws, strict=True):
        form = compiled_form(law.kind)
        assert form is not None
        site = getattr(lib, f"ZYGOS_SITE_{law.kind.place.upper()}")
        at = law.joint if law.joint >= 0 else law.component
        one.joint, one.site, one.form = at, site, getattr(lib, f"ZYGOS_LAW_{form.name}")
        one.value, one.shape, one.width = law.value, law.shape if form.shape is None else form.shape, form.width
        one.first = dynamics.places[law].start if law.kind.memory else 0
    return native


class Stepper:
    """RK4 steps of one arm, many states at once."""

    def __init__(self, dynamics: Planar | Multibody) -> None:
        """Steps of an arm that `of` does not refuse."""
        compiled = dynamics.compiled
        self._dynamics, self._arm, self._kept = dynamics, compiled.arm, compiled.kept
        self._scratch = ffi.from_buffer("double[]", np.empty(compiled.scratch))
        damping = np.where(dynamics.rigid, 0.0, dynamics.damping)
        self._spring = ffi.from_buffer("double[]", np.concatenate([dynamics.soft_stiffness, damping]))
        self._laws = _laws(dynamics)

    @classmethod
    def of(cls, dynamics: Drives) -> Stepper | None:
        """None where the compiled code does not know the arm: a change of bodies, laws that it does not have, equations
        by another engine."""
        if not isinstance(dynamics, Planar | Multibody) or dynamics.later is not None:
            return None
        known = all(compiled_form(law.kind) is not None for law in (*dynamics.laws, *dynamics.base_laws))
        return cls(dynamics) if known else None

    def advance(self, state: Array, torque: Array, step_s: float, steps: int, now: Moment) -> tuple[Array, Moment]:
        """States (B, 4N+W) after so many steps under torques (B, N), Nm before the gear, that stay constant."""
        n = self._dynamics.n
        width = state.shape[1] - 4 * n
        after = np.array(state, dtype=np.float64, order="C")
        held = np.ascontiguousarray(np.broadcast_to(torque, (len(state), n)))
        memory = np.zeros((len(state), 1)) if now.memory is None else np.real(now.memory).copy()
        clock = np.zeros((len(state), 5))
        clock[:, 0], clock[:, 1] = now.time, now.angle
        if now.nadir is not None:
            clock[:, 2:] = now.nadir
        lib.zygos_multibody_advance(
            self._arm,
            len(state),
            width,
            self._spring,
            self._laws,
            len(self._laws),
            0.0 if now.nadir is None else self._dynamics.gradient,
            ffi.from_buffer("double[]", held),
            step_s,
            steps,
            ffi.from_buffer("double[]", after),
            ffi.from_buffer("double[]", clock),
            memory.shape[1],
            ffi.from_buffer("double[]", memory),
            self._scratch,
        )
        nadir = None if now.nadir is None else clock[:, 2:]
        bent = None if now.memory is None else memory.astype(np.complex128)
        return after, replace(now, time=clock[:, 0], angle=clock[:, 1], nadir=nadir, memory=bent)


@dataclass(frozen=True, kw_only=True)
class Multibody(SpatialDynamics):
    """Any arm of `SpatialDynamics`, with the accelerations of all states computed by one call of compiled code."""

    @cached_property
    def compiled(self) -> Compiled:
        """The arm for the compiled code."""
        axes = np.array([joint.axis for joint in self.arm.joints])
        mounts = np.stack([Rotation.from_euler("xyz", joint.frame_rpy).as_matrix() for joint in self.arm.joints])
        fields = _frames(axes, mounts)
        fields |= {"matrix": self.matrix, "moment": self.moments, "gravity": np.array(self.arm.gravity)}
        return _compile(self, self.arm.free, fields)

    def __getstate__(self) -> dict[str, Any]:
        """The state without pointers into this process; a copy creates its own."""
        return {name: value for name, value in self.__dict__.items() if name != "compiled"}

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
        """As `SpatialDynamics.accelerations`, which computes them of an arm whose bodies change."""
        if self.later is not None:
            return super().accelerations(q, theta, omega0, qd, thetad, tau, moment)
        spring, motor_loss, link_loss = self.forces(q, theta, qd, thetad, tau, moment)
        n, batch = self.n, q.shape[:-1]
        state = np.empty((*batch, 6 + 6 * n))
        state[..., :3] = omega0 if self.arm.free else 0.0
        for k, part in enumerate((q, qd, thetad, spring, tau - motor_loss, -link_loss)):
            state[..., 3 + k * n : 3 + (k + 1) * n] = part
        pushing = self._base_torque(q, omega0, moment)
        state[..., 3 + 6 * n :] = 0.0 if pushing is None or not self.arm.free else pushing
        if self.gradient and (pulling := self._pull(posture(self.arm, q), moment)) is not None:
            state[..., 3 + 5 * n : 3 + 6 * n] += pulling.joints
            state[..., 3 + 6 * n :] += pulling.base
        native, size, _ = self.compiled
        result = np.empty((*batch, 3 + 2 * n))
        lib.zygos_multibody_accelerations(
            native,
            result.size // (3 + 2 * n),
            ffi.from_buffer("double[]", state),
            ffi.from_buffer("double[]", result),
            ffi.from_buffer("double[]", np.empty(size)),
        )
        base = result[..., :3] if self.arm.free else np.zeros_like(omega0)
        return base, result[..., 3 : 3 + n], result[..., 3 + n :]
