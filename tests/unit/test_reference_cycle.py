"""Calibration, torque laws and segments of the numpy cycle room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference_support import make_arm
from zygos.cycles import Cycles
from zygos.errors import ZygosError
from zygos.reference.cycle import calibrate, segments


def record(n: int = 12) -> Cycles:
    rng = np.random.default_rng(3)
    return Cycles(
        sync=np.arange(5, 5 + n, dtype=np.uint64),
        q=rng.normal(size=(n, 2)),
        theta=rng.normal(size=(n, 2)),
        tau=rng.normal(size=(n, 2)),
        omega=rng.normal(size=(n, 3)),
        flags=np.zeros(n, dtype=np.uint32),
    )


def test_segments_end_at_jumps_breaks_and_invalid_cycles() -> None:
    #                 0  1  2   3   4   5   6   7   8   9  10
    sync = np.array([1, 2, 3, 10, 11, 12, 13, 14, 15, 15, 16], dtype=np.uint64)
    flags = np.array([0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 3], dtype=np.uint32)
    assert segments(sync, flags) == ((0, 3), (3, 5), (5, 7), (8, 9), (9, 10))


def test_segments_of_nothing_and_of_only_invalid_cycles() -> None:
    assert segments(np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=np.uint32)) == ()
    assert segments(np.arange(3, dtype=np.uint64), np.full(3, 2, dtype=np.uint32)) == ()


def test_a_sync_that_goes_back_is_a_jump() -> None:
    sync = np.array([7, 8, 7, 8], dtype=np.uint64)
    assert segments(sync, np.zeros(4, dtype=np.uint32)) == ((0, 2), (2, 4))


def test_sign_and_zero(tmp_path: Path) -> None:
    arm = make_arm(tmp_path, encoder="sign = -1, zero_rad = 0.25")
    cycles = record()
    samples = calibrate(arm, cycles)
    np.testing.assert_allclose(samples.q, 0.25 - cycles.q, rtol=1e-15)
    np.testing.assert_allclose(samples.theta, 0.25 - cycles.theta, rtol=1e-15)


def test_mount_turns_the_sensor_into_the_base(tmp_path: Path) -> None:
    """A sensor turned +90 degrees about the base's x axis has its z axis along the base's -y axis."""
    half = np.sqrt(0.5)
    arm = make_arm(tmp_path, imu=f"mount_xyzw = [{half}, 0, 0, {half}]")
    cycles = record()
    omega = calibrate(arm, cycles).omega
    expected = np.stack([cycles.omega[:, 0], -cycles.omega[:, 2], cycles.omega[:, 1]], axis=1)
    np.testing.assert_allclose(omega, expected, atol=1e-15)


@pytest.mark.parametrize(
    ("law", "alpha", "beta"),
    [("applied_from_sync", 1.0, 0.0), ("applied_previous_cycle", 0.0, 1.0), ("sampled", 0.5, 0.5)],
)
def test_torque_laws(tmp_path: Path, law: str, alpha: float, beta: float) -> None:
    cycles = record()
    cycles.flags[6] = 1
    tau = calibrate(make_arm(tmp_path, law=law), cycles).tau
    expected = alpha * cycles.tau[:-1] + beta * cycles.tau[1:]
    inner = [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]
    np.testing.assert_allclose(tau[inner], expected[inner], rtol=1e-15)
    # The last torque of a segment needs a cycle that does not continue it.
    assert np.all(np.isnan(tau[[5, 11]]) == (beta > 0.0))


def test_a_record_of_another_arm_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="2 joints, arm 'test' has 3"):
        calibrate(make_arm(tmp_path, joints=3), record())
