# SPDX-License-Identifier: MIT
"""The filter of the C library as it runs on board (``zygos/refine.h``): a task that is fed with cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import TORQUE_STEP, Arm
from zygos.errors import ZygosError
from zygos.native.flight import CHANNELS, Flight, config_of, cycles_to_native, ffi, lib, text_of
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Onboard:
    """Settings of the task; None: as the library chooses them for the arm."""

    every: int | None = None
    """Cycles from one use of readings to the next."""
    steps: int | None = None
    """Runge-Kutta steps in a cycle."""
    terms: int | None = None
    """Of the series of the derivatives over `every` cycles."""
    window: int | None = None
    """Uses of readings that are judged together."""
    apart: int | None = None
    """Cycles between the readings with which the state begins."""


@dataclass(frozen=True)
class Refined:
    """What is published; p parameters, SI units."""

    published: bool
    """Whether value and sigma are refined; otherwise they are those of the energy rows."""
    reason: int
    """enum zygos_refine_reason,"""
    text: str
    """and in words."""
    value: Floats
    """(p,)"""
    sigma: Floats
    """(p,)"""
    level: float
    """Noise of the torques, divided by the declared one."""
    level_error: float
    """Standard error of its logarithm."""
    nis: Floats
    """(channels,) mean normalised squared innovation of the newest window."""
    ratio: Floats
    """(channels,) its largest ratio: below 0.5 normal, 1 where one was rejected."""
    farthest: int
    """Index of the value that is farthest from the energy rows,"""
    distance: float
    """and its distance, divided by what passes."""
    cycle: int
    """SYNC number of the newest cycle that was used."""
    used: int
    """Uses of readings."""
    lost: int
    """Cycles that were bridged."""
    restarts: int
    rejected: int
    """Readings."""


class OnboardRefiner:
    """The task beside a flight. Feed both with the same cycles."""

    def __init__(self, arm: Arm, settings: Onboard | None = None) -> None:
        """Errors: ZygosError where the library refuses the arm or the settings."""
        self.arm = arm
        settings = settings or Onboard()
        self._config, self.native = config_of(arm), ffi.new("zygos_refine_t *")
        native = ffi.new("zygos_refine_settings_t *")
        lib.zygos_refine_defaults(native, self._config)
        for i, joint in enumerate(arm.joints):
            native.filter.torque_sigma[i] = math.hypot(joint.torque_sigma, TORQUE_STEP / math.sqrt(12.0))
            native.filter.torque_relative_sigma[i] = joint.torque_relative_sigma
        encoders = [one.link_encoder for one in arm.joints] + [one.motor_encoder for one in arm.joints]
        for k, encoder in enumerate(encoders, start=arm.n * native.filter.gains):
            native.beside_sigma[k] = max(native.beside_sigma[k], encoder.zero_sigma_rad)
        native.filter.bias_walk = arm.imu.bias_walk * math.sqrt(arm.period_s)
        native.filter.steps = settings.steps or native.filter.steps
        native.every, native.terms = settings.every or native.every, settings.terms or native.terms
        native.window, native.apart = settings.window or native.window, settings.apart or native.apart
        verdict = lib.zygos_refine_init(self.native, self._config, native)
        if verdict != 1:
            raise ZygosError(
                f"arm {arm.name}: the refinement on board refuses it: {text_of(lib.zygos_text, verdict)}; remedy: "
                "flexible joints, torques that are held from SYNC to SYNC, and a gyro that latches at SYNC"
            )
        self._refined = ffi.new("zygos_refined_t *")

    def start(self, flight: Flight, prior: Floats | None = None) -> None:
        """Begin with the newest estimate of a flight; prior: (p,) values of what it leaves open, SI units.

        Errors: ZygosError where a value is missing.
        """
        flight.estimate()
        own = ffi.NULL if prior is None else ffi.from_buffer("double[]", np.ascontiguousarray(prior))
        if lib.zygos_refine_start(self.native, self._config, flight._estimate, own) != 1:
            raise ZygosError(
                f"arm {self.arm.name}: the estimate gives no start; remedy: a motion that moves all joints, or "
                "values of a model for what the estimate leaves open"
            )

    def cycles(self, cycles: Cycles, slices: int | None = None) -> None:
        """Feed cycles, and after each of them do so many slices of the work; None: all of it."""
        native = cycles_to_native(cycles)
        for k in range(len(cycles)):
            lib.zygos_refine_cycle(self.native, native + k)
            left = slices if slices is not None else -1
            while left != 0 and lib.zygos_refine_step(self.native, self._config) == 1:
                left -= 1
        while slices is not None and lib.zygos_refine_step(self.native, self._config) == 1:
            pass

    def judge(self, flight: Flight) -> Refined:
        """Compare with the newest estimate of a flight."""
        flight.estimate()
        out: Any = self._refined
        published = lib.zygos_refine_judge(self.native, self._config, flight._estimate, out) == 1
        p = out.parameters
        return Refined(
            published,
            out.reason,
            text_of(lib.zygos_refine_text, out.reason),
            _array(out.value, p),
            _array(out.sigma, p),
            out.level,
            out.level_error,
            _array(out.nis, len(CHANNELS)),
            _array(out.ratio, len(CHANNELS)),
            out.farthest,
            out.distance,
            int(out.cycle),
            int(out.used),
            int(out.lost),
            int(out.restarts),
            int(out.rejected),
        )

    @property
    def estimate(self) -> tuple[Floats, Floats]:
        """Parameters (p,) and their standard deviations, SI units, whether published or not."""
        p = self.native.filter.propagation.parameters
        value, covariance = np.empty(p), np.empty((p, p))
        pointers = [ffi.from_buffer("double[]", part) for part in (value, covariance)]
        lib.zygos_refiner_parameters(ffi.addressof(self.native, "filter"), *pointers)
        return value, np.sqrt(np.diag(covariance))


def _array(native: Any, count: int) -> Floats:
    return np.frombuffer(ffi.buffer(native), dtype=np.float64, count=count).copy()
