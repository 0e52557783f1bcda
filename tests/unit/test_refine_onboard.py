# SPDX-License-Identifier: MIT
"""The refinement as a task on board: against the whole filter, in slices, over gaps, and what it publishes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_support import arm_of_known_lengths, random_arm
from numpy.typing import NDArray
from refine_support import Case, drawing, flown, learned, plant, reseal, scenario_of, selected
from scipy.linalg import expm

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import Flight, config_of, cycles_to_native, ffi, lib, text_of
from zygos.native.refine import Onboard, OnboardRefiner, Refined
from zygos.native.refiner import Refiner, Settings
from zygos.refinement.bound import bound
from zygos.refinement.inertia import inertia_errors
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]
STEPS_LEVEL = 30.0
"""ZYGOS_REFINE_STEPS"""
INNOVATIONS, LEVEL, APART, FAILED, ENERGY, WAITS, CORRUPT = 4, 5, 6, 3, 2, 1, 8


def begun_with(arm: Arm, values: Floats, settings: Onboard | None = None) -> OnboardRefiner:
    """A task that begins with the values (p,) of a model alone, because nothing is known from a flight."""
    flight, task = Flight(arm), OnboardRefiner(arm, settings)
    flight.estimate()
    flight._estimate.validity = lib.ZYGOS_PARTIAL  # which leaves every value open
    prior = ffi.new("double[]", values.tolist())
    assert lib.zygos_refine_start(task.native, task._config, flight._estimate, prior) == 1
    return task


def sizes_of(task: OnboardRefiner) -> Floats:
    """(p,) what errors of the parameters are compared with."""
    count = task.native.filter.propagation.parameters
    return np.frombuffer(ffi.buffer(task.native.filter.settings.size), dtype=np.float64)[:count]


def refined(case: Case, seed: int) -> tuple[OnboardRefiner, Refined]:
    """The refinement of the second half of a run, and what it publishes."""
    flight, rest = learned(case.arm, flown(case, seed))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(rest)
    flight.cycles(rest)
    return task, task.judge(flight)


def test_it_is_the_whole_filter() -> None:
    """Derivatives at the middle of a period, by a series, are those of the Runge-Kutta method up to small terms: at the
    end, the deviations are the same within 1 %, and the values are apart by less than a tenth of them."""
    case = Case()
    arm = case.arm
    flight, rest = learned(arm, flown(case, 0))
    task = OnboardRefiner(arm, Onboard(window=100_000))  # no window ends, so that the level stays
    task.start(flight)
    n = 5
    task.cycles(selected(rest, slice(0, n - 1)))  # the state begins with the fourth
    entries = task.native.filter.entries
    x = np.frombuffer(ffi.buffer(task.native.filter.x), dtype=np.float64)[:entries].copy()
    packed = np.frombuffer(ffi.buffer(task.native.filter.root), dtype=np.float64)
    size = np.frombuffer(ffi.buffer(task.native.filter.settings.size), dtype=np.float64)[:12].copy()
    whole = Refiner(arm, Settings(size, 5, zeros=True))
    fast, end = whole.fast, whole.fast + len(size)
    whole.start(np.concatenate([x[:fast], x[fast:end] * size, x[end:]]), np.ones(entries), np.diag((0.01 * size) ** 2))
    np.frombuffer(ffi.buffer(whole._native.root), dtype=np.float64)[: len(packed)] = packed
    for k in range(n - 1, len(rest)):
        whole.advance(rest.tau[k - 1])
        whole.read(rest.q[k], rest.theta[k], rest.omega[k])
    task.cycles(selected(rest, slice(n - 1, None)))
    (ours, deviation), (theirs, covariance) = task.estimate, whole.estimate()
    expected = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(deviation, expected, rtol=0.01)
    assert np.sqrt(np.mean(((ours - theirs) / expected) ** 2)) < 0.1


def test_slices_are_the_whole() -> None:
    """Few slices after each cycle, with cycles that wait, give the same bits as all of them."""
    arm = Case().arm
    flight, rest = learned(arm, flown(Case(), 0))
    images = []
    for slices in (None, 45, 40):
        task = OnboardRefiner(arm)
        task.start(flight)
        task.cycles(rest, slices)
        assert task.native.overrun == 0
        entries = task.native.filter.entries
        images.append(bytes(ffi.buffer(task.native.filter.root)) + bytes(ffi.buffer(task.native.filter.x)))
        assert task.native.used == len(rest) - 3 and entries == 26
    assert images[0] == images[1] == images[2]


def test_the_work_of_a_cycle_is_bounded() -> None:
    """Every cycle takes the same number of slices, whatever its data are."""
    arm = Case().arm
    flight, rest = learned(arm, flown(Case(), 0))
    task = OnboardRefiner(arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 4)))
    slices = set()
    for k in range(4, 400):
        lib.zygos_refine_cycle(task.native, cycles_to_native(selected(rest, slice(k, k + 1))))
        count = 0
        while lib.zygos_refine_step(task.native, task._config) == 1:
            count += 1
        slices.add(count)
    assert len(slices) == 1


def test_a_full_queue_is_counted_and_bridged() -> None:
    arm = Case().arm
    flight, rest = learned(arm, flown(Case(), 0))
    task = OnboardRefiner(arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 100)))
    task.cycles(selected(rest, slice(100, 120)), slices=0)  # nobody works for 20 cycles, and the queue holds 8
    task.cycles(selected(rest, slice(120, 600)))
    assert task.native.overrun == 12 and task.native.lost == 12
    assert task.native.restarts == 0 and task.native.filter.failed == 0


@pytest.mark.parametrize("lost", [1, 7, 20])
def test_lost_cycles_are_bridged(lost: int) -> None:
    """Torques that nobody reported are interpolated; the innovations stay as expected."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    kept = np.ones(len(rest), dtype=np.bool_)
    for k in range(200, 1100, 100):
        kept[k : k + lost] = False
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, kept))
    flight.cycles(selected(rest, kept))
    answer = task.judge(flight)
    assert (answer.lost, answer.restarts) == (9 * lost, 0)
    assert answer.published and np.all(answer.nis < 1.5)


def test_after_a_long_gap_the_state_begins_anew() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    kept = np.ones(len(rest), dtype=np.bool_)
    kept[400:421] = False
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 400)))
    before = task.estimate
    task.cycles(selected(rest, slice(421, 423)))
    np.testing.assert_array_equal(task.estimate[0], before[0])
    task.cycles(selected(rest, slice(423, None)))
    flight.cycles(selected(rest, kept))
    answer = task.judge(flight)
    assert (answer.lost, answer.restarts) == (0, 1)
    assert answer.published and np.all(task.estimate[1] < before[1])


def test_a_glitch_is_rejected() -> None:
    """One reading that is far off has a ratio above 1, is not used, and does not take the values off the air."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    q = rest.q.copy()
    q[1150, 0] += 0.5
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(replace(rest, q=q))
    flight.cycles(rest)
    answer = task.judge(flight)
    assert answer.rejected == 1 and answer.ratio[0] < 1.0 and answer.published


def test_what_was_not_as_expected_is_awaited_four_times_as_long() -> None:
    """Encoders that are loud for a while: each window of it asks for four that are as expected, up to twenty;
    of the first eight only the newest counts."""
    case, window = Case(), 20
    flight, rest = learned(case.arm, flown(case, 0))
    q = rest.q.copy()
    q[300:480] += (
        30.0 * config_of(case.arm).joint[0].link_sigma_rad * np.random.default_rng(0).standard_normal((180, case.arm.n))
    )
    rest = replace(rest, q=q)
    task = OnboardRefiner(case.arm, Onboard(window=window))
    task.start(flight)
    counts = window * np.array([case.arm.n, case.arm.n, 1])
    limits = 1.0 + 0.1 + 3.0 * np.sqrt(2.0 / counts)
    expected, windows, longest, waited = 0, 0, 0, 0
    for k in range(0, 1600):
        cycle = selected(rest, slice(k, k + 1))
        task.cycles(cycle)
        if task.native.windows == windows:
            continue
        windows += 1
        calm = all(nis <= limit for nis, limit in zip(task.native.nis, limits, strict=True))
        expected = max(expected - 1, 0) if calm else min(expected * (windows > 8) + 4, 20)
        assert task.native.awaited == expected
        longest = max(longest, expected)
        if expected > 0 and windows >= 4:
            assert task.judge(flight).reason == INNOVATIONS
            waited += 1
    assert windows > 50 and longest == 20 and waited > 20
    assert task.native.awaited == 0


@pytest.mark.slow
def test_a_start_that_is_off_beside_torques_noisier_than_declared_does_no_harm() -> None:
    """Three joints in space: the values of a model that are 4.3 % off, and a noise of 0.5 % that nobody declared. Some
    windows look right by chance; no value is published that is off by more than 5 sigmas and 0.5 %."""
    flying, case = Case("spatial", noise=0.005), Case("spatial", noise=0.005, declared=0.0)
    cycles = flown(flying, 0, 60.0)
    truth = plant("spatial").base_values(case.arm)
    prior = truth * (1.0 + 0.043 * np.random.default_rng(0).standard_normal(len(truth)))
    flight, task = Flight(case.arm), OnboardRefiner(case.arm, Onboard(every=1, terms=6))
    begin, judged = 20_000, 0
    flight.cycles(selected(cycles, slice(0, begin)))
    task.start(flight, prior)
    for k in range(begin, len(cycles), 400):
        piece = selected(cycles, slice(k, k + 400))
        task.cycles(piece)
        flight.cycles(piece)
        answer = task.judge(flight)
        judged += task.native.windows > 4
        error = np.abs(answer.value - truth)
        assert not (answer.published and np.any((error > 5.0 * answer.sigma) & (error > 0.005 * sizes_of(task))))
    assert judged > 20


def test_published_values_are_better_than_the_estimate() -> None:
    """By a factor of 10 at least, with innovations as expected."""
    task, answer = refined(Case(), 0)
    flight, _ = learned(Case().arm, flown(Case(), 0))
    truth = plant("paper").base_values(Case().arm)
    assert answer.published and answer.reason == 0
    np.testing.assert_array_equal(answer.value, task.estimate[0])
    assert abs(np.log(answer.level)) < 4.0 * answer.level_error
    assert np.all(answer.nis < 1.3) and np.all(answer.ratio < 0.6)
    ours, theirs = (np.sqrt(np.mean((one / truth - 1.0) ** 2)) for one in (answer.value, flight.estimate().value))
    assert 10.0 * ours < theirs


@pytest.mark.slow(but=["0"])
@pytest.mark.parametrize("seed", range(2))
def test_encoders_that_are_mounted_to_a_step_do_no_harm(seed: int) -> None:
    """Zeros that are off by up to half of a step, of which the arm file says nothing: the values are published, and
    better than the estimate by a factor of 10."""
    case = Case(mounted=True)
    _, answer = refined(case, seed)
    flight, _ = learned(case.arm, flown(case, seed))
    truth = plant("paper").base_values(case.arm)
    assert answer.published, answer.text
    ours, theirs = (np.sqrt(np.mean((one / truth - 1.0) ** 2)) for one in (answer.value, flight.estimate().value))
    assert 10.0 * ours < theirs


@pytest.mark.slow
def test_errors_are_within_the_bound_and_what_is_stated() -> None:
    """12 runs: errors at most 1.3 times the bound, and 95 % intervals that hold."""
    case = Case()
    scenario = replace(scenario_of("paper"), duration_s=60.0)
    (best,) = bound(case.arm, plant("paper"), scenario, [case.noise])
    truth = plant("paper").base_values(case.arm)
    errors, shares, published = [], [], 0
    for seed in range(12):
        task, answer = refined(case, seed)
        value, sigma = task.estimate
        published += answer.published
        errors.append((value - truth) / best.sigma)
        shares.append(np.mean(np.abs(value - truth) < 1.959964 * sigma))
    assert published >= 11
    assert np.sqrt(np.mean(np.square(errors))) < 1.3
    assert np.mean(shares) > 0.92


@pytest.mark.slow
def test_the_level_follows_the_torques() -> None:
    """Torques that are twice as noisy as declared are seen, and half as noisy ones; the former are not published."""
    _, loud = refined(Case(noise=0.01, declared=0.005), 0)
    assert loud.level == pytest.approx(2.0, abs=0.5)
    assert not loud.published and loud.reason == LEVEL
    _, quiet = refined(Case(noise=0.005, declared=0.01), 0)
    assert quiet.level == pytest.approx(0.5, abs=0.2) and quiet.published


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "reasons"),
    [
        (Case(gain=1.02), {LEVEL, APART, INNOVATIONS}),
        (Case(gain=1.05), {ENERGY, FAILED, LEVEL, APART, INNOVATIONS}),
        (Case(effects=(("torque_lag", 0.01),)), {ENERGY, LEVEL, APART, INNOVATIONS}),
        (Case(effects=(("cubic_stiffness", 3.0),)), {FAILED, LEVEL, APART, INNOVATIONS}),
    ],
)
def test_a_model_that_lacks_something_is_not_published(case: Case, reasons: set[int]) -> None:
    task, answer = refined(case, 0)
    assert not answer.published and answer.reason in reasons
    assert answer.text == text_of(lib.zygos_refine_text, answer.reason) != "unknown code"
    assert not np.array_equal(answer.value, task.estimate[0])


def test_what_is_not_refined_is_the_estimate_from_energy_rows() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    before = task.judge(flight)
    assert before.reason == WAITS and not before.published
    np.testing.assert_array_equal(before.value, flight.estimate().value)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 100)))
    assert task.judge(flight).reason == WAITS  # fewer than four windows
    empty = Flight(case.arm)
    assert task.judge(empty).reason == ENERGY
    task.cycles(selected(rest, slice(100, 101)))
    flags = np.array([lib.ZYGOS_CYCLE_VOID], dtype=np.uint32)
    task.cycles(replace(selected(rest, slice(101, 102)), flags=flags))
    assert task.judge(flight).reason == FAILED  # what it has used cannot be taken back
    task.start(flight)
    assert task.judge(flight).reason == WAITS


def test_the_first_values_are_told_after_four_windows() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    told = []
    for k in range(0, 520, 20):
        task.cycles(selected(rest, slice(k, k + 20)))
        told.append((int(task.native.windows), task.judge(flight).reason != WAITS))
    assert {known for windows, known in told if windows < 4} == {False}
    assert {known for windows, known in told if windows >= 4} == {True}
    assert min(windows for windows, known in told if known) == 4


def test_what_it_cannot_follow_is_refused() -> None:
    case = Case()
    with pytest.raises(ZygosError, match=r"refuses it: .*; remedy"):
        OnboardRefiner(replace(case.arm, torque_law="sampled"))
    with pytest.raises(ZygosError, match="refuses it"):
        OnboardRefiner(case.arm, Onboard(every=1001))
    with pytest.raises(ZygosError, match="gives no start; remedy"):
        OnboardRefiner(case.arm).start(Flight(case.arm))


def test_sizes_are_those_of_the_solver() -> None:
    """An inertia that couples two bodies is compared with the geometric mean of theirs, all others with themselves."""
    arm = Case().arm
    flight, _ = learned(arm, flown(Case(), 0))
    task = OnboardRefiner(arm)
    task.start(flight)
    size = sizes_of(task)
    value = flight.estimate().value
    a00, a01, a02, a11, a12, a22 = value[:6]
    least = np.sqrt([a00 * a00, a00 * a11, a00 * a22, a11 * a11, a11 * a22, a22 * a22])
    np.testing.assert_allclose(size[:6], np.maximum(least, np.abs([a00, a01, a02, a11, a12, a22])), rtol=1e-12)
    np.testing.assert_array_equal(size[6:], value[6:])


SETTINGS = (
    ("every", 0, 1001), ("terms", 1, 21), ("window", 19, 100_001), ("apart", 0, 1001), ("bias_sigma", -1.0, 1e4),
    ("filter.steps", 0, 1001), ("filter.friction", 2, 7), ("filter.offsets", 2, 7), ("filter.zeros", 2, 7),
    ("filter.bias_walk", -1.0, 1e4),
    ("filter.second_order", -1.0, 1e4), ("filter.gyro_sigma", 0.0, 1e4),
)  # fmt: skip
OF_JOINTS = (
    ("beside_sigma", -1.0, 1e7), ("filter.link_sigma", 0.0, 11.0), ("filter.motor_sigma", 0.0, 11.0),
    ("filter.torque_sigma", -1.0, 1e7), ("filter.torque_relative_sigma", -0.1, 1.1),
)  # fmt: skip


@pytest.mark.parametrize(("member", "low", "high"), [*SETTINGS, *OF_JOINTS])
def test_settings_out_of_their_range_are_refused(member: str, low: float, high: float) -> None:
    """And those between are not."""
    config, task, settings = config_of(Case().arm), ffi.new("zygos_refine_t *"), ffi.new("zygos_refine_settings_t *")
    *way, name = member.split(".")
    for value in (low, high, float("nan")):
        lib.zygos_refine_defaults(settings, config)
        assert lib.zygos_refine_init(task, config, settings) == 1
        place = settings.filter if way else settings
        if isinstance(getattr(place, name), int) and np.isnan(value):
            continue
        if (member, low, high) in OF_JOINTS:
            getattr(place, name)[1] = value
        else:
            setattr(place, name, value)
        assert lib.zygos_refine_init(task, config, settings) == lib.ZYGOS_E_VALUE, value


def test_whatever_was_in_the_memory_before_does_not_matter() -> None:
    config, settings = config_of(Case().arm), ffi.new("zygos_refine_settings_t *")
    lib.zygos_refine_defaults(settings, config)
    tasks = [ffi.new("zygos_refine_t *") for _ in range(2)]
    ffi.memmove(tasks[1], b"\xa5" * ffi.sizeof("zygos_refine_t"), ffi.sizeof("zygos_refine_t"))
    assert [lib.zygos_refine_init(task, config, settings) for task in tasks] == [1, 1]
    assert bytes(ffi.buffer(tasks[0])) == bytes(ffi.buffer(tasks[1]))


def test_a_gyro_that_latches_late_is_refused() -> None:
    arm = Case().arm
    with pytest.raises(ZygosError, match="a gyro that latches at SYNC"):
        OnboardRefiner(replace(arm, imu=replace(arm.imu, latch_us=100)))


def test_a_call_without_its_arguments_changes_nothing() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 10)))
    before = bytes(ffi.buffer(task.native))
    native, config, estimate, null = task.native, task._config, flight._estimate, ffi.NULL
    settings, out = ffi.new("zygos_refine_settings_t *"), ffi.new("zygos_refined_t *")
    for call, arguments in (
        (lib.zygos_refine_defaults, (settings, config)),
        (lib.zygos_refine_scrub, (native, config)),
        (lib.zygos_refine_init, (native, config, settings)),
        (lib.zygos_refine_start, (native, config, estimate)),
        (lib.zygos_refine_step, (native, config)),
        (lib.zygos_refine_judge, (native, config, estimate, out)),
    ):
        for k in range(len(arguments)):
            given = [null if i == k else one for i, one in enumerate(arguments)]
            assert call(*given, *((null,) if call is lib.zygos_refine_start else ())) == lib.ZYGOS_E_NULL
    assert lib.zygos_refine_cycle(null, ffi.new("zygos_cycle_t *")) == lib.ZYGOS_E_NULL
    assert lib.zygos_refine_cycle(native, null) == 0  # zygos_cycle_at() has no more
    assert bytes(ffi.buffer(task.native)) == before


def test_values_of_a_model_stand_in_for_what_the_estimate_leaves_open() -> None:
    """A joint that has not moved: the prior's value, with a deviation of 1 %; a prior without it is refused."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    flight.estimate()
    native, truth = flight._estimate, plant("paper").base_values(case.arm)
    task = OnboardRefiner(case.arm)
    values = ffi.new("double[]", truth.tolist())

    def start(prior: object) -> int:
        return int(lib.zygos_refine_start(task.native, task._config, native, prior))

    native.value[3] = native.sigma[3] = native.half95[3] = float("nan")
    for k in range(12):
        native.covariance[max(k, 3) * (max(k, 3) + 1) // 2 + min(k, 3)] = float("nan")
    assert start(ffi.NULL) == lib.ZYGOS_E_VALUE
    assert start(values) == 1
    native.value[3] = 2.0 * truth[3]  # without a sigma nobody vouches for it
    assert start(values) == 1
    value, sigma = task.estimate
    assert value[3] == pytest.approx(truth[3]) and 0.005 < sigma[3] / abs(truth[3]) < 0.012
    task.cycles(selected(rest, slice(0, 200)))
    assert task.native.filter.failed == 0
    values[3] = float("inf")
    assert start(values) == lib.ZYGOS_E_VALUE
    values[3] = 0.0
    assert start(values) == 1 and task.native.filter.settings.size[3] > 0.0
    right = native.covariance[0]
    native.covariance[0] = -1e12
    assert start(values) == lib.ZYGOS_E_VALUE
    native.covariance[0] = right
    native.parameters = 11
    assert start(values) == lib.ZYGOS_E_VALUE
    native.parameters = 12
    assert start(values) == 1
    native.validity = lib.ZYGOS_REFUSED
    assert start(values) == lib.ZYGOS_E_VALUE


def test_no_parameter_begins_with_a_deviation_above_a_percent_of_its_size() -> None:
    case = Case()
    flight, _ = learned(case.arm, flown(case, 0))
    flight.estimate()
    for k in range(12):
        flight._estimate.covariance[k * (k + 3) // 2] *= 1e8
    task = OnboardRefiner(case.arm)
    assert lib.zygos_refine_start(task.native, task._config, flight._estimate, ffi.NULL) == 1
    assert (task.estimate[1] < 0.0101 * sizes_of(task)).all()


def test_a_single_joint_in_a_plane_begins_with_the_rate_of_its_gyro() -> None:
    arm, model = random_arm(0, 1, "free", "planar", True)
    task, count = begun_with(arm, np.array(model.base_values(arm))), 100
    turning = np.tile(0.3 * np.array(arm.joints[0].axis), (count, 1))
    zero = np.zeros((count, 1))
    task.cycles(Cycles(np.arange(count, dtype=np.uint64), zero, zero, zero, turning, np.zeros(count, dtype=np.uint32)))
    assert task.native.moving == 1
    assert task.native.filter.x[0] == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize(("joints", "period_s", "every", "terms"), [
    (1, 0.002, 1, 6), (2, 0.002, 1, 6), (3, 0.002, 20, 12), (7, 0.004, 10, 12), (3, 0.06, 1, 6)
])  # fmt: skip
def test_arms_of_many_joints_are_corrected_more_rarely(joints: int, period_s: float, every: int, terms: int) -> None:
    """Every 0.04 s, over which the series needs more terms."""
    config, settings = ffi.new("zygos_config_t *"), ffi.new("zygos_refine_settings_t *")
    config.joints, config.period_s = joints, period_s
    for joint in config.joint:
        joint.gear_ratio = 100.0
    lib.zygos_refine_defaults(settings, config)
    assert (settings.every, settings.terms, settings.window) == (every, terms, 100)


def test_torques_without_a_declared_noise_have_the_steps_of_their_frames() -> None:
    """Then the level may be as large as 30, with which the filter begins."""
    case = Case(noise=0.0)
    flight, rest = learned(case.arm, flown(case, 0))
    settings = ffi.new("zygos_refine_settings_t *")
    task = OnboardRefiner(case.arm)
    lib.zygos_refine_defaults(settings, task._config)
    assert settings.filter.torque_sigma[0] == pytest.approx(1e-4 / np.sqrt(12.0))
    config = config_of(case.arm)
    config.joint[0].torque_sigma = 0.5
    lib.zygos_refine_defaults(settings, config)
    assert settings.filter.torque_sigma[0] == pytest.approx(0.5 / case.arm.joints[0].gear_ratio)
    assert settings.filter.torque_sigma[1] == pytest.approx(1e-4 / np.sqrt(12.0))
    task.start(flight)
    assert task.native.level == STEPS_LEVEL
    task.cycles(rest)
    flight.cycles(rest)
    answer = task.judge(flight)
    assert answer.published and answer.level < 1.2 * STEPS_LEVEL


def test_readings_may_be_used_every_second_cycle_also_over_gaps() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    kept = np.ones(len(rest), dtype=np.bool_)
    for k, lost in enumerate((1, 2, 3, 6)):
        kept[200 + 150 * k : 200 + 150 * k + lost] = False
    task = OnboardRefiner(case.arm, Onboard(every=2, window=50))
    task.start(flight)
    task.cycles(selected(rest, kept))
    flight.cycles(selected(rest, kept))
    answer = task.judge(flight)
    assert (answer.lost, answer.restarts) == (12, 0)
    assert answer.published


def test_an_arm_in_space_begins_with_its_reduced_parameters() -> None:
    """Sizes of combinations of entries of the inertia matrix are those of the entries."""
    case = Case("spatial", noise=0.005)
    cycles, truth = flown(case, 0, 0.6), plant("spatial").base_values(case.arm)
    task = begun_with(case.arm, truth, Onboard(every=1))
    size = sizes_of(task)
    assert len(size) == len(truth) and (size >= 0.999999 * np.abs(truth)).all() and (size < 1e6).all()
    task.cycles(cycles)
    assert task.native.filter.failed == 0 and task.native.used > 50


def with_readings_every(arm: Arm, every: int, cycles: Cycles) -> OnboardRefiner:
    """A task in space after a few uses of readings, when all is known of the cycles after them and the covariance has
    yet to be moved."""
    task, table = begun_with(arm, plant("spatial").base_values(arm), Onboard(every=every, terms=20, window=20)), 5
    for k in range(len(cycles)):
        lib.zygos_refine_cycle(task.native, cycles_to_native(selected(cycles, slice(k, k + 1))))
        while lib.zygos_refine_step(task.native, task._config) == 1:
            if task.native.phase == table and task.native.used > 2:
                assert task.native.filter.failed == 0
                return task
    raise AssertionError("too few cycles")


def a_period(arm: Arm, task: OnboardRefiner) -> tuple[Floats, Floats, Floats]:
    """By the derivatives that were taken last for three joints in space: what a state (15,) becomes in a period, what
    constants and torques add to it, and what the readings (9,) are of a state, as matrices."""
    work, n, w, moving = task.native.work.propagation, 3, 3, 15
    constants = task.native.filter.propagation.parameters
    rows = [*range(w), *range(w + 2 * n, moving)]
    rates, pushes = np.zeros((moving, moving)), np.zeros((moving, constants + n))
    rates[w : w + 2 * n, w + 2 * n :] = np.eye(2 * n)
    rates[rows] = np.array([list(row)[:moving] for row in work.by_state])[: w + 2 * n]
    pushes[rows, :constants] = np.array([list(row)[:constants] for row in work.by_constant])[: w + 2 * n]
    pushes[rows, constants:] = np.array([list(row)[:n] for row in work.by_torque])[: w + 2 * n]
    below = np.zeros((constants + n, moving + constants + n))
    both = expm(np.block([[rates, pushes], [below]]) * arm.period_s)
    readings = np.zeros((2 * n + w, moving))
    for k, joint in enumerate((*arm.joints, *arm.joints)):
        encoder = joint.link_encoder if k < n else joint.motor_encoder
        readings[k, w + k], readings[k, w + 2 * n + k] = 1.0, 1e-6 * (joint.latch_us + encoder.latch_us)
    readings[2 * n :, :w] = np.eye(w)
    return both[:moving, :moving], both[:moving, moving:], readings


@pytest.mark.parametrize("every", [2, 7, 20])
def test_readings_between_are_used_as_means(every: int) -> None:
    """The derivatives of the mean of the readings over the cycles by state, parameters and torques are the means of
    those at the end of each cycle, by exponentials of the same derivatives of the accelerations."""
    case = Case("spatial", noise=0.005)
    task = with_readings_every(case.arm, every, flown(case, 0, 0.6))
    carried, pushed, readings = a_period(case.arm, task)
    slope = np.concatenate([np.eye(15), np.zeros_like(pushed)], axis=1)
    mean = np.zeros((len(readings), slope.shape[1]))
    for _ in range(every):
        slope = carried @ slope
        slope[:, 15:] += pushed
        mean += readings @ slope / every
    work, rows = task.native.work, slice(15, 15 + len(readings))
    by_state = np.array([list(row)[:15] for row in work.across])[rows]
    by_torque = np.array([list(row)[:3] for row in work.push])[rows]
    added = np.array([list(row)[:9] for row in work.pushed])[rows]  # by additions to the accelerations
    by_constant = added @ np.array([list(row)[:54] for row in work.propagation.by_constant])[:9]
    size = np.max(np.abs(mean), axis=0)
    assert np.all(size > 0.0)
    found = np.concatenate([by_state, by_constant, by_torque], axis=1)
    np.testing.assert_allclose(found / size, mean / size, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("every", [2, 7, 20])
def test_the_readings_of_all_cycles_between_are_summed(every: int) -> None:
    case = Case("spatial", noise=0.005)
    cycles = flown(case, 0, 0.6)
    task = with_readings_every(case.arm, every, cycles)
    seen = np.concatenate([cycles.q, cycles.theta, cycles.omega @ case.arm.mount.T], axis=1)
    (newest,) = np.flatnonzero((seen[:, :6] == list(task.native.signal)[:6]).all(axis=1))
    expected = np.sum(seen[newest - every + 1 : newest + 1], axis=0)
    np.testing.assert_allclose(list(task.native.readings)[:9], expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("every", [1, 2, 3, 7, 20])
def test_noise_of_torques_is_another_one_in_each_cycle(every: int) -> None:
    """What the torques of the cycles between two uses of readings do to state and covariance is the sum over these
    cycles, each carried to the end by the exponential of the same derivatives."""
    case = Case("spatial", noise=0.005)
    task = with_readings_every(case.arm, every, flown(case, 0, 0.6))
    native, n, moving, shapes = task.native, 3, 15, task.native.work.shapes
    carried, pushed, readings = a_period(case.arm, task)
    own = pushed[:, -n:]
    # of the noise of each cycle: the mean of the readings at the ends of all cycles, and the state at the last one
    responses = np.zeros((every, len(readings) + moving, n))
    for cycle in range(every):
        state, mean = own, np.zeros((len(readings), n))
        for _ in range(cycle, every):
            mean, last = mean + readings @ state / every, state
            state = carried @ state
        responses[cycle] = np.concatenate([mean, last])
    rows = [list(row)[: shapes * n] for row in native.work.push]
    push = np.array(rows[moving : moving + len(readings)] + rows[:moving]).reshape(-1, shapes, n)
    if every == 1:  # readings are no means
        responses, push = responses[:, len(readings) :], push[len(readings) :]
    expected = np.einsum("cin,cjn->nij", responses, responses)
    size = np.sqrt(np.einsum("nii->ni", expected))

    def off(shapes: int) -> float:
        """The largest error of a covariance; the noise of the task is that of a mean over the cycles."""
        found = np.einsum("ikn,jkn->nij", push[:, :shapes], push[:, :shapes]) / every
        return float(np.max(np.abs(found - expected) / (size[:, :, None] * size[:, None, :])))

    assert shapes == min(every, 4) and native.work.leads == (len(readings) if every > 1 else 0)
    # a polynomial stands for steps of a cycle: where there are two, it is rough for links that have hardly moved
    assert off(shapes) < {1: 1e-9, 2: 0.3, 3: 0.08, 7: 0.02, 20: 0.004}[every]
    assert every == 1 or off(1) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "worst"), [(0.0, 0.05), (0.005, 0.06)])
def test_means_of_readings_suffice_for_an_arm_in_space(noise: float, worst: float) -> None:
    """Three joints, encoders mounted to a step, means of readings over 40 ms: in four runs, refined values are
    published, their intervals hold, and the inertia matrix is right to so many per cent in the worst of 200 postures
    (rms of the runs), after 60 s with an estimate of 60 s at first."""
    case, errors, within = Case("spatial", noise=noise, mounted=True), [], []
    truth = plant("spatial").base_values(case.arm)
    for seed in range(4):
        flight, rest = learned(case.arm, flown(case, seed))
        task = OnboardRefiner(case.arm)
        assert (task.native.settings.every, task.native.settings.terms) == (20, 12)
        task.start(flight, drawing("spatial", 0).base_values(case.arm))
        task.cycles(rest)
        flight.cycles(rest)
        answer = task.judge(flight)
        assert answer.published and answer.reason == 0 and answer.used > 1490
        assert np.all(answer.nis < 1.3)
        of_matrix = inertia_errors(case.arm, answer.value[None], truth)
        assert of_matrix is not None
        errors.append(of_matrix[0])
        within.append(np.mean(np.abs(answer.value - truth) < 1.959964 * answer.sigma))
    assert np.sqrt(np.mean(np.square(errors))) < worst
    # the parameters of a run are correlated: shares of single runs scatter by 0.09
    assert abs(np.mean(within) - 0.95) < 3.0 * 0.09 / np.sqrt(4.0)


def test_where_a_cycle_was_lost_the_newest_readings_are_used() -> None:
    """A mean over cycles of which one is unknown has no model; the next one is a mean again."""
    case = Case("spatial", noise=0.005)
    cycles = flown(case, 0, 0.6)
    kept = np.ones(len(cycles), dtype=np.bool_)
    kept[150] = False
    task, leads = begun_with(case.arm, plant("spatial").base_values(case.arm), Onboard(every=20, window=20)), []
    for k in np.flatnonzero(kept):
        before = task.native.used
        task.cycles(selected(cycles, slice(k, k + 1)))
        if task.native.used > before:
            leads.append(task.native.work.leads)
    assert leads.count(0) == 2 and leads[0] == 0 and set(leads) == {0, 9}  # one of them is the beginning
    assert task.native.filter.failed == 0


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("angle", 1e7),
        ("rate", 1e7),
        ("rate", -1e7),
        ("rate", float("nan")),
        ("inertia", float("nan")),
        ("inertia", -1e12),
    ],
)
def test_a_state_that_cannot_be_ends_the_refinement(place: str, value: float) -> None:
    """What a model that is far off has led to."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 20)))
    assert task.native.filter.failed == 0
    at = {"angle": 0, "rate": 6, "inertia": task.native.filter.fast}
    task.native.filter.x[at[place]] = value
    reseal(task)
    task.cycles(selected(rest, slice(20, 24)))
    assert task.native.filter.failed == 1
    assert task.judge(flight).reason == FAILED
    assert lib.zygos_refine_step(task.native, task._config) == 0


@pytest.mark.parametrize("how", ["repeated", "break", "wrapped"])
def test_what_does_not_follow_from_the_cycle_before_ends_the_state(how: str) -> None:
    """Nobody knows what moved the arm in between: the state begins with the readings that follow."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 100)))
    assert (task.native.restarts, task.native.moving) == (0, 1)
    if how == "repeated":
        task.cycles(selected(rest, slice(99, 100)))
    elif how == "break":
        flags = np.array([lib.ZYGOS_CYCLE_BREAK], dtype=np.uint32)
        task.cycles(replace(selected(rest, slice(100, 101)), flags=flags))
    else:  # both encoders of a joint have passed the end of their range
        one = selected(rest, slice(100, 101))
        task.cycles(replace(one, q=one.q + np.array([60.0, 0.0]), theta=one.theta + np.array([60.0, 0.0])))
    assert (task.native.restarts, task.native.moving) == (1, 0)
    task.cycles(selected(rest, slice(101, 200)))
    assert (task.native.restarts, task.native.moving, task.native.filter.failed) == (1, 1, 0)


def test_derivatives_that_do_not_exist_end_the_refinement() -> None:
    """Memory changes between the slices that move the state and those that linearise."""
    case, slopes = Case(), 2
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 20)))
    lib.zygos_refine_cycle(task.native, cycles_to_native(selected(rest, slice(20, 21))))
    while task.native.phase != slopes:
        assert lib.zygos_refine_step(task.native, task._config) == 1
    for row in task.native.work.dynamics.matrix:
        for k in range(len(row)):
            row[k] = -1e12
    assert lib.zygos_refine_step(task.native, task._config) == 1
    assert (task.native.filter.failed, task.native.moving) == (1, 0)
    assert lib.zygos_refine_step(task.native, task._config) == 0
    assert task.judge(flight).reason == FAILED


@pytest.mark.parametrize("phase", [9, 2**31])
def test_a_phase_that_cannot_be_is_refused_until_the_refinement_begins_anew(phase: int) -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 20)))
    task.native.phase = phase
    lib.zygos_refine_cycle(task.native, cycles_to_native(selected(rest, slice(20, 21))))
    assert [lib.zygos_refine_step(task.native, task._config) for _ in range(2)] == [lib.ZYGOS_E_STATE] * 2
    assert task.judge(flight).reason == CORRUPT
    task.start(flight)
    assert task.judge(flight).reason == WAITS and task.native.abandoned == 1
    task.cycles(selected(rest, slice(21, 60)))
    assert task.native.moving == 1 and task.native.filter.failed == 0


@pytest.mark.parametrize(("level", "bound"), [(1e-6, 1e-4), (1e5, 1e4)])
def test_the_level_has_bounds(level: float, bound: float) -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm, Onboard(window=20))
    task.start(flight)
    task.cycles(selected(rest, slice(0, 10)))
    task.native.level = level
    reseal(task)
    task.cycles(selected(rest, slice(10, 25)))
    assert task.native.windows == 1
    assert task.native.level == bound


def test_the_level_moves_towards_the_noise_of_the_torques() -> None:
    """In a few windows, long before it is there: up where torques are noisier than declared, down where less."""
    levels = []
    for declared in (0.0025, 0.01):
        case = Case(declared=declared)
        flight, rest = learned(case.arm, flown(case, 0))
        task = OnboardRefiner(case.arm, Onboard(window=20))
        task.start(flight)
        task.cycles(selected(rest, slice(0, 400)))
        levels.append(task.native.level)
    assert levels[0] > 1.2 and levels[1] < 0.9, levels


def test_a_window_begins_with_nothing() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm, Onboard(window=20))
    task.start(flight)
    begun = 0
    for k in range(50):
        task.cycles(selected(rest, slice(k, k + 1)))
        native = task.native
        sums = [*native.count, *native.square, *native.largest, native.score, native.share]
        begun += native.used > 0 and native.used % 20 == 0
        assert any(sums) == (native.used % 20 != 0)
    assert begun >= 2


def test_torques_noisier_than_declared_widen_what_is_stated() -> None:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    stated = []
    for level in (1.0, 3.0):
        task = OnboardRefiner(case.arm, Onboard(window=100_000))  # no window ends, so that the level stays
        task.start(flight)
        task.native.level = level
        task.cycles(selected(rest, slice(0, 400)))
        stated.append(task.estimate[1])
    assert (stated[1] >= stated[0]).all() and (stated[1] > 1.05 * stated[0]).any()


def test_values_that_no_arm_has_are_not_published() -> None:
    """A rotor inertia, stiffness or damping below zero, where it is not sooner noticed."""
    task, answer = refined(Case(), 0)
    flight, rest = learned(Case().arm, flown(Case(), 0))
    flight.cycles(rest)
    assert answer.published
    task.native.filter.x[task.native.filter.fast + 11] *= -1.0
    reseal(task)
    answer = task.judge(flight)
    assert not answer.published and answer.reason == APART
    flight.estimate()
    for k in range(12):
        flight._estimate.half95[k] = 1e9
    out = ffi.new("zygos_refined_t *")
    assert lib.zygos_refine_judge(task.native, task._config, flight._estimate, out) == 0
    assert out.reason == lib.ZYGOS_REFINE_PHYSICAL


def with_nuisances(arm: Arm, **settings: object) -> OnboardRefiner:
    """A task that carries rotor friction, torque offsets and zeros of encoders beside the parameters."""
    task, native = OnboardRefiner(arm), ffi.new("zygos_refine_settings_t *")
    native[0] = task.native.settings
    for name in ("friction", "offsets", "zeros"):
        setattr(native.filter, name, 1)
    for k in range(4 * arm.n):
        native.beside_sigma[k] = 1e-3
    for name, value in settings.items():
        setattr(native, name, value)
    assert lib.zygos_refine_init(task.native, task._config, native) == 1
    return task


def test_friction_offsets_and_zeros_may_be_carried_beside_the_parameters() -> None:
    """They widen what is stated, and a plant without them is published."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    flight.cycles(rest)
    answers = []
    for task in (OnboardRefiner(case.arm), with_nuisances(case.arm)):
        start, _ = learned(case.arm, flown(case, 0))
        task.start(start)
        task.cycles(rest)
        answers.append(task.judge(flight))
    plain, wider = answers
    assert wider.published and wider.reason == 0
    assert (wider.sigma >= 0.99 * plain.sigma).all() and (wider.sigma > 1.02 * plain.sigma).any()
    truth = plant("paper").base_values(case.arm)
    assert (np.abs(wider.value - truth) < 5.0 * wider.sigma).all()


def test_torques_that_act_in_the_cycle_after_their_frame_are_followed() -> None:
    case = Case()
    arm = replace(case.arm, torque_law="applied_previous_cycle")
    cycles = flown(case, 0)
    delayed = replace(cycles, tau=np.roll(cycles.tau, 1, axis=0))  # a frame tells what acted before
    flight, rest = learned(arm, selected(delayed, slice(1, None)))
    task = OnboardRefiner(arm)
    task.start(flight)
    task.cycles(rest)
    flight.cycles(rest)
    assert task.judge(flight).published


def test_cycles_that_cannot_be_used_are_skipped() -> None:
    """Invalid ones, and those in which one encoder of a joint has passed the end of its range and the other has not."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.cycles(selected(rest, slice(0, 5)))  # not started
    task.start(flight)
    task.cycles(selected(rest, slice(0, 100)))
    flags, theta = rest.flags.copy(), rest.theta.copy()
    flags[100], theta[101, 1] = lib.ZYGOS_CYCLE_INVALID, theta[101, 1] + 1500.0
    task.cycles(selected(replace(rest, flags=flags, theta=theta), slice(100, 200)))
    assert task.native.filter.failed == 0 and task.native.restarts == 0
    assert task.native.lost == 2


def test_an_arm_of_known_lengths_begins_with_its_independent_parameters() -> None:
    """Their sizes are those of the columns that they stand for. Innovations of the gyro, of which it has none, are as
    expected."""
    known, values = arm_of_known_lengths()
    assert known.structure.reduces
    task = begun_with(known, values, Onboard(window=20))
    size = sizes_of(task)
    assert len(size) == len(values) and (size >= np.abs(values)).all() and (size > 0.0).all()
    still = np.zeros((100, known.n))
    sync = np.arange(100, dtype=np.uint64)
    task.cycles(Cycles(sync, still, still, still, np.zeros((100, 3)), np.zeros(100, dtype=np.uint32)))
    assert task.native.used > 50
    assert task.native.windows >= 2 and list(task.native.nis)[2] == 1.0
