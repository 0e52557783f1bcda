# SPDX-License-Identifier: MIT
"""Rows and arcs of the numpy energy balance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_support import Motion, make_arm, move, true_parameters

from zygos.arm import Arm
from zygos.balances.arcs import arc_cycles
from zygos.balances.energy import EnergyRows, energy_rows
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth

PERIOD = 0.005


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    return make_arm(tmp_path_factory.mktemp("arm"), period=PERIOD)


@pytest.fixture(scope="module")
def motion(arm: Arm) -> Motion:
    return move(arm, momentum=0.0)


def balance_of(arm: Arm, cycles: Cycles) -> EnergyRows:
    samples = calibrate(arm, cycles)
    return energy_rows(arm, samples, smooth(arm, samples))


@pytest.mark.slow
def test_rows_balance_with_the_true_parameters(arm: Arm, motion: Motion) -> None:
    """z . pi - W is a constant of the arc, to what the filters lose at the torque steps."""
    balance = balance_of(arm, motion.cycles())
    rest = balance.z @ true_parameters(arm) - balance.w
    assert np.ptp(rest) < 1e-3 * np.ptp(balance.w)


@pytest.mark.slow
def test_a_torque_shifted_by_one_cycle_is_seen(tmp_path: Path) -> None:
    """At 20 ms the wrong torque law spoils the balance tenfold; a common shift of the record changes nothing."""
    right = make_arm(tmp_path)
    cycles = move(right, 2.5).cycles()
    pi = true_parameters(right)

    def spread(arm: Arm, record: Cycles) -> float:
        balance = balance_of(arm, record)
        return float(np.ptp(balance.z @ pi - balance.w))

    wrong = make_arm(tmp_path, law="applied_previous_cycle")
    assert spread(wrong, cycles) > 10.0 * spread(right, cycles)
    shifted = Cycles(cycles.sync + np.uint64(7), cycles.q, cycles.theta, cycles.tau, cycles.omega, cycles.flags)
    assert spread(right, shifted) == spread(right, cycles)


@pytest.mark.slow(only=["applied_previous_cycle"])
@pytest.mark.parametrize("law", ["applied_previous_cycle", "sampled"])
def test_torque_laws_give_the_same_rows_for_their_own_record(tmp_path: Path, motion: Motion, law: str) -> None:
    """A drive that reports the past cycle gives, by its law, the rows of one that reports the present cycle."""
    plain = balance_of(make_arm(tmp_path, period=PERIOD), motion.cycles())
    cycles = motion.cycles()
    if law == "applied_previous_cycle":
        cycles.tau[1:] = motion.tau[:-1]
        tolerance = 1e-12
    else:
        # Sampled values whose mean over each step is the held torque do not exist; smooth torques come close.
        tolerance = 0.02
    balance = balance_of(make_arm(tmp_path, period=PERIOD, law=law), cycles)
    assert np.max(np.abs(balance.w - plain.w)) <= tolerance * np.max(np.abs(plain.w))


def test_arcs_partition_the_segments(tmp_path: Path, motion: Motion) -> None:
    arm = make_arm(tmp_path, period=PERIOD, head="[arc]\nmax_s = 1.5")
    assert arc_cycles(arm) == 300
    cycles = motion.cycles()
    cycles.flags[700] = 1
    balance = balance_of(arm, cycles)
    # The smoother takes three cycles at each end of a segment, g the first three smoothed instants.
    expected = [(6, 306), (306, 606), (606, 697), (706, 798)]
    for number, (start, stop) in enumerate(expected):
        of = balance.arc == number
        np.testing.assert_array_equal(balance.index[of], np.arange(start, stop))
        np.testing.assert_array_equal(balance.z[of][0, [8, 11]], 0.0)
    assert balance.arc.max() == len(expected) - 1
    assert balance.void == frozenset()


@pytest.mark.parametrize(("position", "void"), [(700, {2}), (609, set()), (610, {2})])
def test_void_is_the_arc_that_is_open_and_no_other(
    tmp_path: Path, motion: Motion, position: int, void: set[int]
) -> None:
    """Arcs that ended by their length stay; 609 cycles are two arcs of 300 instants and what fills the filters."""
    arm = make_arm(tmp_path, period=PERIOD, head="[arc]\nmax_s = 1.5")
    cycles = motion.cycles()
    cycles.flags[position] = 5
    assert balance_of(arm, cycles).void == void


def test_an_arc_ends_at_a_snap_from_an_eighth_of_the_longest_on(tmp_path: Path, motion: Motion) -> None:
    """A refused instant is the last of its arc, unless that would hold fewer instants than an eighth of the longest."""
    arm = make_arm(tmp_path, period=PERIOD, head="[arc]\nmax_s = 1.5")
    cycles = motion.cycles()
    cycles.flags[700] = 1
    samples = calibrate(arm, cycles)
    smoothed = smooth(arm, samples)
    assert smoothed.accepted.all()

    def spans(*refused: int) -> list[tuple[int, int]]:
        balance = energy_rows(arm, samples, replace(smoothed, accepted=~np.isin(smoothed.index, refused)))
        np.testing.assert_array_equal(balance.index[~balance.accepted], [at for at in refused if at >= 6])
        found = []
        for number in range(balance.arc.max() + 1):
            of = balance.arc == number
            np.testing.assert_array_equal(np.diff(balance.index[of]), 1)
            np.testing.assert_array_equal(balance.z[of][0, [8, 11]], 0.0)
            found.append((int(balance.index[of][0]), int(balance.index[of][-1])))
        return found

    # 37 instants are an eighth of 300: an arc from 6 on may end at 42
    whole = [(6, 305), (306, 605), (606, 696), (706, 797)]
    assert spans(4, 10, 41) == whole
    assert spans(42) == [(6, 42), (43, 342), (343, 642), (643, 696), (706, 797)]
    assert spans(42, 43, 78, 79, 80) == [(6, 42), (43, 79), (80, 379), (380, 679), (680, 696), (706, 797)]
    assert spans(304) == [(6, 304), (305, 604), (605, 696), (706, 797)]
    assert spans(305, 306) == whole
    assert spans(696, 741, 742) == [*whole[:3], (706, 742), (743, 797)]


@pytest.mark.parametrize(("refused", "void"), [(450, {2}), (495, {2}), (496, set())])
def test_an_arc_that_a_snap_ended_is_not_void(tmp_path: Path, motion: Motion, refused: int, void: set[int]) -> None:
    """The arc behind the snap is open at a void cycle, if it has an instant; that that the snap ended is not."""
    arm = make_arm(tmp_path, period=PERIOD, head="[arc]\nmax_s = 1.5")
    cycles = motion.cycles()
    cycles.flags[500] = 5
    samples = calibrate(arm, cycles)
    smoothed = smooth(arm, samples)
    assert energy_rows(arm, samples, smoothed).void == {1}
    assert energy_rows(arm, samples, replace(smoothed, accepted=smoothed.index != refused)).void == void


def test_work_and_dissipation_of_an_arc_do_not_depend_on_where_it_starts(tmp_path: Path, motion: Motion) -> None:
    """Filters run on over the end of an arc: the increments are those of one long arc."""
    long = balance_of(make_arm(tmp_path, period=PERIOD), motion.cycles())
    short = balance_of(make_arm(tmp_path, period=PERIOD, head="[arc]\nmax_s = 0.5"), motion.cycles())
    for arc in range(3):
        of = short.arc == arc
        for x, y in ((short.w, long.w), (short.z[:, 8], long.z[:, 8])):
            np.testing.assert_allclose(x[of] - x[of][0], y[of] - y[of][0], atol=1e-12 * np.abs(y).max())


def test_dissipation_is_that_of_the_exact_motion(arm: Arm, motion: Motion) -> None:
    balance = balance_of(arm, motion.cycles())
    for joint, column in ((0, 8), (1, 11)):
        exact = motion.slip2[balance.index, joint]
        exact = exact - exact[0]
        assert np.max(np.abs(balance.z[:, column] - exact)) < 0.02 * exact[-1]


def test_quadrature_is_exact_for_a_cubic_slip(tmp_path: Path) -> None:
    """g = (theta' - q')^2 = t^2, whose integral the rule has exactly."""
    arm = make_arm(tmp_path, joints=1)
    t = arm.period_s * np.arange(60, dtype=np.float64)
    cycles = Cycles(
        sync=np.arange(60, dtype=np.uint64),
        q=np.zeros((60, 1)),
        theta=0.5 * t[:, None] ** 2,
        tau=np.zeros((60, 1)),
        omega=np.zeros((60, 3)),
        flags=np.zeros(60, dtype=np.uint32),
    )
    balance = balance_of(arm, cycles)
    np.testing.assert_array_equal(balance.index, np.arange(6, 57))
    np.testing.assert_allclose(balance.z[:, -1], (t[6:57] ** 3 - t[6] ** 3) / 3.0, atol=1e-14)


@pytest.mark.parametrize("law", ["applied_from_sync", "applied_previous_cycle", "sampled"])
def test_work_of_each_torque_law(tmp_path: Path, law: str) -> None:
    """Held torques: those of a step times its angle, and the correction of the instant. Sampled ones: their mean."""
    arm = make_arm(tmp_path, joints=1, law=law)
    reported = np.random.default_rng(1).normal(size=40)
    t = arm.period_s * np.arange(40)
    theta = 0.3 + 0.2 * t - 0.5 * t**2
    rate = 0.2 - t
    cycles = Cycles(
        sync=np.arange(40, dtype=np.uint64),
        q=theta[:, None],
        theta=theta[:, None],
        tau=reported[:, None],
        omega=np.zeros((40, 3)),
        flags=np.zeros(40, dtype=np.uint32),
    )
    step, stairs = {  # torque from SYNC k to k + 1; torque behind SYNC k less that before it
        "applied_from_sync": (lambda k: reported[k], lambda k: reported[k] - reported[k - 1]),
        "applied_previous_cycle": (lambda k: reported[k + 1], lambda k: reported[k + 1] - reported[k]),
        "sampled": (lambda k: (reported[k] + reported[k + 1]) / 2.0, lambda k: 0.0),
    }[law]
    expected = [
        sum(50.0 * step(j) * (theta[j + 1] - theta[j]) for j in range(6, k))
        + arm.period_s / 12.0 * 50.0 * stairs(k) * rate[k]
        for k in range(6, 37)
    ]
    balance = balance_of(arm, cycles)
    np.testing.assert_array_equal(balance.index, np.arange(6, 37))
    np.testing.assert_allclose(balance.w, expected, atol=1e-13)


@pytest.mark.parametrize("law", ["applied_from_sync", "applied_previous_cycle"])
def test_a_torque_staircase_balances_exactly(tmp_path: Path, law: str) -> None:
    """A rotor on a base that stays put, under a torque that steps by as much at each SYNC.

    The samples then lie on a cubic, which the filters have exactly, and its slope differs from the true rate. With the
    correction of the work the balance closes to rounding; without it, or one cycle off, it does not.
    """
    inertia, ratio, h = 0.01, 50.0, 0.02
    held = 0.4 + 0.03 * (np.arange(80) - 30)
    acceleration = held / (inertia * ratio)
    rate = -0.7 + h * np.concatenate([[0.0], np.cumsum(acceleration)[:-1]])
    theta = np.concatenate([[0.0], np.cumsum(h * rate + h**2 / 2 * acceleration)[:-1]])
    cycles = Cycles(
        sync=np.arange(80, dtype=np.uint64),
        q=np.zeros((80, 1)),
        theta=theta[:, None],
        tau=(held if law == "applied_from_sync" else np.concatenate([[0.0], held[:-1]]))[:, None],
        omega=np.zeros((80, 3)),
        flags=np.zeros(80, dtype=np.uint32),
    )
    arm = make_arm(tmp_path, joints=1, law=law, period=h)
    samples = calibrate(arm, cycles)
    smoothed = smooth(arm, samples)
    np.testing.assert_allclose(smoothed.thetad[:, 0] - rate[smoothed.index], h / 12.0 * 0.03 / (inertia * ratio))
    balance = energy_rows(arm, samples, smoothed)
    energy = balance.z[:, list(arm.parameter_names).index("Im1")] * inertia
    assert np.ptp(energy - balance.w) < 1e-12 * np.ptp(energy)


def test_a_segment_that_only_fills_the_filters_has_no_row(arm: Arm, motion: Motion) -> None:
    cycles = motion.cycles()
    few = Cycles(*(getattr(cycles, name)[:9] for name in ("sync", "q", "theta", "tau", "omega", "flags")))
    assert len(balance_of(arm, few).w) == 0
