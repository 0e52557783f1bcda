# SPDX-License-Identifier: MIT
"""Calibration, torque laws and segments of the numpy cycle room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference_support import make_arm

from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles
from zygos.runs.samples import HALF_RANGE_RAD, calibrate, segments, usable


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


def at_rest(sync: list[int], flags: list[int]) -> Cycles:
    n = len(sync)
    return Cycles(
        sync=np.array(sync, dtype=np.uint64),
        q=np.zeros((n, 2)),
        theta=np.zeros((n, 2)),
        tau=np.zeros((n, 2)),
        omega=np.zeros((n, 3)),
        flags=np.array(flags, dtype=np.uint32),
    )


def test_segments_end_at_jumps_breaks_and_invalid_cycles() -> None:
    #                 0  1  2   3   4   5   6   7   8   9  10
    sync = [1, 2, 3, 10, 11, 12, 13, 14, 15, 15, 16]
    flags = [0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 3]
    cut = segments(at_rest(sync, flags))
    assert cut.ranges == ((0, 3), (3, 5), (5, 7), (8, 9), (9, 10))
    assert (cut.voids, cut.wraps) == ((), 0)


def test_segments_of_nothing_and_of_only_invalid_cycles() -> None:
    assert segments(at_rest([], [])).ranges == ()
    assert segments(at_rest([0, 1, 2], [2, 2, 2])).ranges == ()


def test_a_sync_that_goes_back_is_a_jump() -> None:
    assert segments(at_rest([7, 8, 7, 8], [0, 0, 0, 0])).ranges == ((0, 2), (2, 4))


def test_a_void_cycle_breaks_and_may_say_what_can_be_trusted() -> None:
    #                             0  1  2  3  4  5  6  7  8
    cut = segments(at_rest([1, 2, 3, 4, 5, 8, 9, 10, 11], [5, 0, 0, 5, 0, 0, 2, 5 | 7 << 8, 0]))
    assert cut.ranges == ((0, 3), (3, 5), (5, 6), (7, 9))
    assert cut.voids == ((0, None), (3, None), (7, 3))


@pytest.mark.parametrize("encoder", ["q", "theta"])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_angle_that_goes_over_the_end_of_its_range_ends_the_segment(encoder: str, joint: int, way: float) -> None:
    cycles = at_rest(list(range(9)), [0] * 9)
    reading = getattr(cycles, encoder)
    reading[4:, joint] = way * HALF_RANGE_RAD
    assert segments(cycles).ranges == ((0, 9),)
    reading[4:, joint] = way * np.nextafter(HALF_RANGE_RAD, 100.0)
    cut = segments(cycles)
    assert (cut.ranges, cut.wraps, cut.voids) == (((0, 4), (4, 9)), 1, ())
    cycles.flags[4] = 1
    assert segments(cycles).wraps == 0
    assert HALF_RANGE_RAD == 50.26548245743669


def test_a_cycle_with_its_angles_on_both_sides_of_the_end_belongs_to_no_segment(tmp_path: Path) -> None:
    """Of the calibrated angles: readings may differ by as much as signs and zeros make of them."""
    arm = make_arm(tmp_path, encoder="sign = -1, zero_rad = 0.25")
    for other, apart in ((HALF_RANGE_RAD - 1e-9, False), (HALF_RANGE_RAD + 1e-9, True)):
        cycles = at_rest(list(range(9)), [0] * 9)
        cycles.theta[3:6, 1] = -other
        samples = calibrate(arm, cycles)
        assert samples.segments == (((0, 3), (6, 9)) if apart else ((0, 9),))
        assert samples.wraps == (2 if apart else 0)
        cycles.sync[4:] += 7
        assert calibrate(arm, cycles).segments == (((0, 3), (6, 9)) if apart else ((0, 4), (4, 9)))


@pytest.mark.parametrize(("signal", "largest"), [("q", 1e4), ("theta", 1e4), ("tau", 1e6), ("omega", 1e6)])
def test_values_beyond_reason_are_of_no_use(signal: str, largest: float) -> None:
    for value in (np.nan, np.inf, -np.inf, np.nextafter(largest, np.inf), -1.01 * largest):
        cycles = record()
        getattr(cycles, signal)[3, 1] = value
        np.testing.assert_array_equal(np.flatnonzero(~usable(cycles)), [3])
        assert segments(cycles).ranges == ((0, 3), (4, 12))
    cycles = record()
    getattr(cycles, signal)[3, 1] = -largest
    assert usable(cycles).all()


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
