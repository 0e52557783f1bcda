"""The equations of motion of `zygos.dynamics.serial`, compiled (c/ports/host/multibody.c).

Only the bodies are compiled; springs, friction and other effects follow their laws in Python. The compiled code
computes the same matrix in a different order, and shares no code with the library that estimates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import across
from zygos.dynamics.joints import START, Moment
from zygos.dynamics.serial import SpatialDynamics
from zygos.native.flight import ffi, lib

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Multibody(SpatialDynamics):
    """Any arm of `SpatialDynamics`, with the accelerations of all states computed by one call of compiled code."""

    @cached_property
    def _compiled(self) -> tuple[Any, int, list[Any]]:
        """The arm for the compiled code, the number of doubles it needs as work space, and memory that must stay
        allocated."""
        axes = np.array([joint.axis for joint in self.arm.joints])
        mounts = np.stack([Rotation.from_euler("xyz", joint.frame_rpy).as_matrix() for joint in self.arm.joints])
        along = axes[:, :, None] * axes[:, None, :]
        # Rodrigues' formula: the constant part of a rotation about the axis, and the parts of its cosine and sine
        turning = np.stack([along, np.eye(3) - along, np.cross(np.eye(3), axes[:, None, :])], axis=1)
        fields: dict[str, Array] = {
            "turn": mounts[:, None] @ turning,
            "axis": axes,
            "across": np.stack([across(axis).T for axis in axes]),
            "matrix": self.matrix,
            "moment": self.moments,
            "gravity": np.array(self.arm.gravity),
            "ratio": self.gear_ratio,
            "rotor": self.rotor_inertia,
            "coupling": self.coupling,
        }
        native = ffi.new("zygos_multibody_t *", {"joints": self.n, "floating": int(self.arm.free)})
        kept: list[Any] = [native]
        for name, values in fields.items():
            kept.append(ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=np.float64)))
            setattr(native, name, kept[-1])
        kept.append(ffi.from_buffer("uint8_t[]", self.rigid.astype(np.uint8)))
        native.rigid = kept[-1]
        return native, int(lib.zygos_multibody_scratch(self.n)), kept

    def __getstate__(self) -> dict[str, Any]:
        """The state without pointers into this process; a copy creates its own."""
        return {name: value for name, value in self.__dict__.items() if name != "_compiled"}

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
        """As `SpatialDynamics.accelerations`, which computes them where a torque acts on the base."""
        if self.base_laws or self.later is not None:
            return super().accelerations(q, theta, omega0, qd, thetad, tau, moment)
        spring, motor_loss, link_loss = self._forces(q, theta, qd, thetad, tau, moment)
        n, batch = self.n, q.shape[:-1]
        state = np.empty((*batch, 3 + 6 * n))
        state[..., :3] = omega0 if self.arm.free else 0.0
        for k, part in enumerate((q, qd, thetad, spring, tau - motor_loss, -link_loss)):
            state[..., 3 + k * n : 3 + (k + 1) * n] = part
        native, size, _ = self._compiled
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
