# SPDX-License-Identifier: MIT
"""Motion over a SYNC period with its derivatives, by the C library (``zygos/propagation.h``)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import config_of, ffi, lib

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Propagation:
    """An arm whose joints are all flexible. The constants c are its p parameters, and N Coulomb frictions of the rotors
    where there is friction."""

    arm: Arm
    steps: int
    """Runge-Kutta steps in a period."""
    friction: bool = False

    @cached_property
    def _native(self) -> tuple[Any, Any, Any, Any]:
        config, native = config_of(self.arm), ffi.new("zygos_propagation_t *")
        if lib.zygos_propagation_init(native, config, self.steps, int(self.friction)) != 1:
            raise ZygosError(
                f"arm {self.arm.name}: a joint is rigid, or {self.steps} steps are not from 1 to 1000; remedy: an arm "
                "of flexible joints"
            )
        return config, native, ffi.new("zygos_propagation_stages_t *"), ffi.new("zygos_propagation_work_t *")

    def step(self, constants: Floats, state: Floats, tau: Floats) -> tuple[Floats, Floats]:
        """The state (x,) after one period under held torques (N,), Nm before the gear, and its derivatives
        (x, x + c + N) by the state before, the constants (c,), SI units, and the torques.

        Errors: ZygosError where no inertia resists.
        """
        config, native, stages, work = self._native
        dynamics, slope = ffi.new("zygos_dynamics_t *"), ffi.new(f"double[{native.moving}][{_slopes()}]")
        after = np.array(state, dtype=np.float64)
        lib.zygos_dynamics_set(dynamics, native, config, _pointer(constants))
        if not lib.zygos_propagate(native, config, dynamics, _pointer(after), _pointer(tau), slope, stages, work):
            raise self._impossible()
        columns = native.moving + len(constants) + self.arm.n
        table = np.frombuffer(ffi.buffer(slope), dtype=np.float64).reshape(native.moving, -1)
        return after, table[:, :columns].copy()

    def path(self, constants: Floats, states: Floats, tau: Floats) -> Floats:
        """The states (B, m * steps + 1, x) at all steps of m periods, from states (B, x) under torques (B, m, N) that
        are held in each period, Nm before the gear.

        Errors: ZygosError where no inertia resists.
        """
        config, native, _, work = self._native
        dynamics = ffi.new("zygos_dynamics_t *")
        lib.zygos_dynamics_set(dynamics, native, config, _pointer(constants))
        blocks, cycles, joints = tau.shape
        out = np.empty((blocks, cycles * self.steps + 1, states.shape[1]))
        out[:, 0] = states
        held, time = np.ascontiguousarray(tau), self.arm.period_s / self.steps
        at, torque = ffi.from_buffer("double[]", out), ffi.from_buffer("double[]", held)
        width, good = states.shape[1], True
        for block in range(blocks):
            for step in range(cycles * self.steps):
                here = at + (block * out.shape[1] + step) * width
                ffi.memmove(here + width, here, 8 * width)
                acting = torque + (block * cycles + step // self.steps) * joints
                good &= lib.zygos_propagation_move(native, config, dynamics, time, here + width, acting, work)
        if not good or not np.all(np.abs(out) < 1e6):
            raise self._impossible()
        return out

    def _impossible(self) -> ZygosError:
        return ZygosError(
            f"arm {self.arm.name}: these parameters give negative kinetic energy; remedy: take them all from one "
            "set of bodies"
        )


def _slopes() -> int:
    return int(ffi.typeof("zygos_propagation_stages_t").fields[-1][1].type.item.length)


def _pointer(values: Floats) -> Any:
    return ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=np.float64))
