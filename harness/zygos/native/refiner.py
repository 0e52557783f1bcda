# SPDX-License-Identifier: MIT
"""The square-root filter of the C library over a record (``zygos/refiner.h``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import TORQUE_STEP, Arm
from zygos.errors import ZygosError
from zygos.native.flight import CHANNELS, config_of, ffi, lib

Floats = NDArray[np.float64]

NORMAL_95 = 1.959964
"""Half the width of an interval that holds 95 % of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Settings:
    """What is estimated beside parameters, state and gyro bias, and the noise that is assumed."""

    size: Floats
    """(p,) scale of each parameter, SI units."""
    steps: int
    """Runge-Kutta steps in a period."""
    torque_relative_sigma: Sequence[float] | None = None
    """(N,) noise of the torques as a share of their size; None: as the arm declares."""
    friction: bool = False
    """Coulomb friction of each rotor."""
    offsets: bool = False
    """An offset of each torque."""
    gains: bool = False
    """The share by which each torque exceeds the reported one."""
    zeros: bool = False
    """Zeros of link and motor encoders."""
    second_order: float = 20.0
    """Factor of the variance of the link rates by which the noise of the gyro is increased, s."""


class Refiner:
    """One filter. Its entries are the state (W base rates, q, theta and their rates), W biases of the gyro, p
    parameters, and N frictions, N offsets, N gains, and 2N zeros where they are estimated."""

    def __init__(self, arm: Arm, settings: Settings) -> None:
        """Errors: ZygosError where a joint is rigid or a setting is out of range."""
        self.arm = arm
        wire = arm.over_the_wire
        native = ffi.new("zygos_refiner_settings_t *")
        native.steps, native.friction = settings.steps, int(settings.friction)
        native.offsets, native.gains, native.zeros = int(settings.offsets), int(settings.gains), int(settings.zeros)
        native.size[0 : len(settings.size)] = settings.size.tolist()
        for i, joint in enumerate(wire.joints):
            native.torque_sigma[i] = math.hypot(arm.joints[i].torque_sigma, TORQUE_STEP / math.sqrt(12.0))
            share = settings.torque_relative_sigma
            native.torque_relative_sigma[i] = joint.torque_relative_sigma if share is None else share[i]
            native.link_sigma[i], native.motor_sigma[i] = joint.link_encoder.sigma_rad, joint.motor_encoder.sigma_rad
        native.gyro_sigma = wire.imu.rate_sigma
        native.bias_walk = arm.imu.bias_walk * math.sqrt(arm.period_s)
        native.second_order = settings.second_order
        self._config, self._native = config_of(arm), ffi.new("zygos_refiner_t *")
        self._work, self._stages = ffi.new("zygos_refiner_work_t *"), ffi.new("zygos_propagation_stages_t *")
        if lib.zygos_refiner_init(self._native, self._config, native) != 1:
            raise ZygosError(
                f"arm {arm.name}: a joint is rigid, or the noise of a sensor is 0; remedy: an arm of flexible joints "
                "whose encoders have steps"
            )
        self.parameters = len(settings.size)

    @property
    def entries(self) -> int:
        """Number of entries."""
        return int(self._native.entries)

    @property
    def fast(self) -> int:
        """Number of entries before the parameters."""
        return int(self._native.fast)

    def start(self, x: Floats, sigma: Floats, covariance: Floats) -> None:
        """Begin at entries x (n,) with standard deviations (n,) and the covariance of the parameters (p, p), SI units.

        Errors: ZygosError if the covariance is not positive definite.
        """
        if lib.zygos_refiner_start(self._native, _pointer(x), _pointer(sigma), _pointer(covariance)) != 1:
            raise ZygosError(
                "the covariance with which the filter begins is not positive definite; remedy: an estimate that is "
                "valid"
            )

    def resume(self, x: Floats, sigma: Floats) -> None:
        """Begin again after an interruption: state and bias x (fast,) are others, with standard deviations (fast,), and
        everything else is kept."""
        lib.zygos_refiner_resume(self._native, _pointer(x), _pointer(sigma))

    def read(self, q: Floats, theta: Floats, omega: Floats) -> None:
        """Use the readings at a SYNC: angles (N,), rad, after sign and zero, and the base rate (3,), rad/s."""
        lib.zygos_refiner_read(self._native, self._config, _pointer(q), _pointer(theta), _pointer(omega), self._work)

    def advance(self, tau: Floats, lost: float = 0.0) -> None:
        """Move to the next SYNC under torques (N,), Nm before the gear, of which `lost` is a further deviation, Nm.

        Errors: ZygosError if the filter has failed.
        """
        native, stages, work = self._native, self._stages, self._work
        if not lib.zygos_refiner_advance(native, self._config, _pointer(tau), lost, stages, work):
            raise ZygosError(
                f"arm {self.arm.name}: the filter has left the possible arms; remedy: begin with a better estimate, or "
                "explain the run with `zygos explain` first"
            )

    @property
    def states(self) -> int:
        """Length of the state, without the bias of the gyro."""
        return int(self._native.propagation.moving)

    @property
    def sums(self) -> Floats:
        """(3,) sums of the squared innovations of each of `CHANNELS`, divided by their expected variances."""
        return _array(self._native.square, len(CHANNELS))

    @property
    def x(self) -> Floats:
        """(n,) the entries, parameters in units of their sizes."""
        return _array(self._native.x, self.entries)

    @property
    def root(self) -> Floats:
        """(n, n) upper triangular S with the covariance S S'."""
        n = self.entries
        packed = _array(self._native.root, n * (n + 1) // 2)
        root = np.zeros((n, n))
        root.T[np.tril_indices(n)] = packed
        return root

    def estimate(self) -> tuple[Floats, Floats]:
        """Parameters (p,) and their covariance (p, p), SI units."""
        value, covariance = np.empty(self.parameters), np.empty((self.parameters, self.parameters))
        lib.zygos_refiner_parameters(self._native, _pointer(value), _pointer(covariance))
        return value, covariance

    @property
    def squares(self) -> Floats:
        """(3,) mean of the squared innovations of each of `CHANNELS`, divided by their expected variances."""
        square, count = (_array(part, len(CHANNELS)) for part in (self._native.square, self._native.count))
        return np.asarray(square / np.where(count > 0.0, count, 1.0))

    @property
    def deviance(self) -> float:
        """Sum of ln s + e^2/s over all innovations e with variances s: the lower, the more the readings favour the
        settings."""
        squares = _array(self._native.square, len(CHANNELS)).sum()
        return float(squares + math.log(self._native.volume) + self._native.volume_exponent * math.log(2.0))


def _array(native: Any, count: int) -> Floats:
    return np.frombuffer(ffi.buffer(native), dtype=np.float64, count=count).copy()


def _pointer(values: Floats) -> Any:
    return ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=np.float64))
