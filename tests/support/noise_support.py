# SPDX-License-Identifier: MIT
"""The flight library's noise room at one state, and rows of noisy samples that it has no part in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from arm_support import State as Sample
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from zygos.arm import Arm, Encoder
from zygos.balances.energy import energy_columns
from zygos.balances.state import State
from zygos.native.flight import config_of, ffi, lib

Floats = NDArray[np.float64]


def measured(
    arm: Arm, *, period_s: float, sigma: float, gyro: float, latch_us: tuple[int, int, int] = (0, 0, 0)
) -> Arm:
    """The arm with that noise, and its link encoders, motor encoders and gyro late; joints differ from each other."""
    joints = []
    for i, joint in enumerate(arm.joints):
        link = Encoder((1.0 + 0.3 * i) * sigma * np.sqrt(12.0), latch_us=latch_us[0])
        motor = Encoder((0.7 + 0.2 * i) * sigma * np.sqrt(12.0), latch_us=latch_us[1])
        joints.append(replace(joint, link_encoder=link if joint.flexible else motor, motor_encoder=motor))
    imu = replace(arm.imu, rate_sigma=gyro, latch_us=latch_us[2]) if arm.free else arm.imu
    return replace(arm, period_s=period_s, joints=tuple(joints), imu=imu, compensate_every=1)


class NoiseRoom:
    """zygos_noise_t of an arm, called at one state after the other."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self.config = arm, config_of(arm)
        self.column_map, self.geometry = ffi.new("zygos_column_map_t *"), ffi.new("zygos_geometry_t *")
        self.smoother, self.noise = ffi.new("zygos_smoother_t *"), ffi.new("zygos_noise_t *")
        lib.zygos_balance_column_map(self.config, self.column_map)
        lib.zygos_geometry_init(self.geometry, self.config)
        lib.zygos_smoother_init(self.smoother, self.config)
        lib.zygos_noise_init(self.noise, self.config, self.column_map, self.smoother)

    def _at(self, sample: Sample) -> tuple[Any, Any]:
        state, motion = ffi.new("zygos_arm_state_t *"), ffi.new("zygos_motion_t *")
        n = self.arm.n
        state.q[0:n], state.q_rate[0:n] = sample.q.tolist(), sample.qd.tolist()
        state.theta[0:n], state.theta_rate[0:n] = sample.theta.tolist(), sample.thetad.tolist()
        state.omega = sample.omega0.tolist()
        lib.zygos_kinematics(self.geometry, self.config, state, motion)
        return state, motion

    def mean(self, sample: Sample) -> Floats:
        """What is taken off the columns (p,)."""
        row = ffi.new("zygos_row_t *")
        lib.zygos_noise_means(self.noise, self.config, self._at(sample)[1], row)
        return -np.array(list(row.column)[: self.column_map.count])

    def moment(self, sample: Sample, tau_next: Floats, turn: int = 0) -> Floats:
        """J S J^T, (p+1, p+1); sample.tau is the torque before the instant."""
        width = self.column_map.count + 1
        size = width * (width + 1) // 2
        gram, rows = ffi.new("double[]", size), ffi.new("double[]", size)
        sums, row_sums = ffi.new("double[]", width), ffi.new("double[]", width)
        target = ffi.new("zygos_noise_target_t *", (gram, sums, rows, row_sums))
        state, motion = self._at(sample)
        before, after = (ffi.new("double[]", tau.tolist()) for tau in (sample.tau, tau_next))
        lib.zygos_noise_add(
            self.noise,
            self.config,
            self.column_map,
            self.geometry,
            state,
            motion,
            before,
            after,
            turn,
            1.0,
            target,
        )
        np.testing.assert_array_equal(list(rows), -np.array(list(gram)))
        np.testing.assert_array_equal(list(row_sums), -np.array(list(sums)))
        out = np.zeros((width, width))
        out[np.tril_indices(width)] = list(gram)
        out += np.tril(out, -1).T
        np.testing.assert_allclose(list(sums), out.sum(axis=0), rtol=0, atol=1e-12 * np.abs(out).max() * width)
        return out


def noisy_rows(rng: np.random.Generator, arm: Arm, sample: Sample, tau_next: Floats, draws: int) -> tuple[Floats, ...]:
    """Rows [columns, work] without noise (p+1,), and of draws of raw windows and of the opposite draws (draws, p+1).

    The work is what the newest torque does on the newest angle, and what a held torque adds; dissipation is left at 0.
    """
    n, h, half = arm.n, arm.period_s, arm.smoother.points // 2

    def smoothed(sigma: float, latch_us: int) -> tuple[Floats, Floats]:
        window = sigma * rng.normal(size=(draws, arm.smoother.points))
        place = half - 1e-6 * latch_us / h
        value, slope = (
            savgol_coeffs(arm.smoother.points, arm.smoother.order, deriv=d, delta=h, pos=place, use="dot")
            for d in (0, 1)
        )
        return window @ value, window @ slope

    errors = {name: np.zeros((draws, n)) for name in ("q", "qd", "theta", "thetad")}
    for i, joint in enumerate(arm.joints):
        late = joint.latch_us + joint.motor_encoder.latch_us
        theta = smoothed(joint.motor_encoder.over_the_wire.sigma_rad, late)
        late = joint.latch_us + joint.link_encoder.latch_us
        q = smoothed(joint.link_encoder.over_the_wire.sigma_rad, late) if joint.flexible else theta
        errors["q"][:, i], errors["qd"][:, i] = q
        errors["theta"][:, i], errors["thetad"][:, i] = theta
    base = [smoothed(arm.imu.over_the_wire.rate_sigma, arm.imu.latch_us)[0] for _ in range(3 if arm.free else 0)]
    omega = np.stack(base, axis=1) if base else np.zeros((draws, 3))
    held = 0.0 if arm.torque_law == "sampled" else h / 12.0

    def row(sign: float) -> Floats:
        at = {name: getattr(sample, name) + sign * error for name, error in errors.items()}
        omega0 = sample.omega0 + sign * omega
        columns = energy_columns(
            arm, State(**at, base=omega0 if arm.spatial else omega0 @ arm.axis), np.zeros((draws, n))
        )
        work = arm.gear_ratios * (sample.tau * at["theta"] + held * (tau_next - sample.tau) * at["thetad"])
        return np.column_stack([columns, work.sum(axis=1)])

    return row(0.0)[0], row(1.0), row(-1.0)
