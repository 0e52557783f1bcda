# SPDX-License-Identifier: MIT
"""The planner: limits, slopes of its measure, torques against Pinocchio, sigmas against the scatter of estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_support import random_arm
from laboratory_support import laboratory_arm
from plant_support import lively
from runs_support import trajectory_of

from zygos.arm import Arm, Encoder, Smoother
from zygos.can.run import Run
from zygos.dynamics.equations import equations
from zygos.effects import effect
from zygos.errors import Undecided, ZygosError
from zygos.ground.estimate import estimate_ground
from zygos.model.model import Model, Quantity
from zygos.model.nearest import nearest_bodies
from zygos.plan.expected import Expectation
from zygos.plan.limits import limits_of
from zygos.plan.planning import Motion, Planner, ranked
from zygos.plan.rows import Grounded
from zygos.plan.search import _Goal
from zygos.plan.series import Space
from zygos.refinement.bound import bound
from zygos.simulation.plant import needed_torque
from zygos.simulation.scenario import Controller, Scenario

HERE = Path("arm.toml"), Path("model.toml")
SIGMA = 0.05


def _two_joints(friction: float = 0.1) -> tuple[Arm, Model]:
    """Two joints in a plane with gravity, encoders of 16 bits, and friction at the motors."""
    arm, model = random_arm(3, 2, "fixed", "planar", False)
    encoder = Encoder(quantum_rad=2.0 * np.pi / 2**16, counts=2**16)
    joints = tuple(
        replace(joint, motor_encoder=encoder, link_encoder=encoder, torque_sigma=SIGMA) for joint in arm.joints
    )
    arm = replace(arm, joints=joints, period_s=0.005, smoother=Smoother(15, 4, 7))
    kinds = ("motor_coulomb", "motor_viscous") if friction else ()
    effects = tuple(effect(kind, joint.name, friction) for joint in joints for kind in kinds)
    return arm, replace(model, effects=effects)


@pytest.fixture(scope="module")
def planned() -> tuple[Arm, Model, Planner, Scenario, Expectation]:
    arm, model = _two_joints()
    planner = Planner(arm, model, limits_of(arm, "2", "1.5", "joint1=2.5,joint2=1.1"), np.full(2, SIGMA))
    return arm, model, planner, *planner.plan("planned", Motion(), *HERE, None)


def test_limits_are_read_for_all_and_for_single_joints() -> None:
    arm, _ = _two_joints()
    limits = limits_of(arm, "joint2=-1:0.5,2", "1.5", None)
    np.testing.assert_array_equal(limits.low, [-2.0, -1.0])
    np.testing.assert_array_equal(limits.high, [2.0, 0.5])
    np.testing.assert_array_equal(limits.torque, [np.inf, np.inf])
    angle, rate = np.array([[0.0, 0.0], [1.0, 0.6]]), np.zeros((2, 2))
    assert "angle of joint joint2 reaches 0.6 rad" in str(limits.violation(arm, angle, rate))
    assert limits.violation(arm, 0.5 * angle, rate) is None


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (("wrist=1", None, None), "no joint 'wrist'; remedy: one of joint1, joint2"),
        ((None, "0", None), "leaves no motion; remedy"),
        ((None, "fast", None), "is not a number; remedy"),
        (("1:1", None, None), "is no range; remedy"),
        ((None, None, "joint1=1,joint1=2"), "has two values; remedy"),
    ],
)
def test_limits_that_make_no_sense_are_refused(texts: tuple[str | None, str | None, str | None], words: str) -> None:
    with pytest.raises(ZygosError, match=words):
        limits_of(_two_joints()[0], *texts)


def test_every_motion_of_the_space_keeps_the_limits_and_is_at_rest_at_its_ends() -> None:
    arm, _ = laboratory_arm("UR10e")
    limits = limits_of(arm, "joint3=-2.5:-0.5,joint5=0.2,2", "joint6=3,1", None)
    space = Space(limits, 8.0, 5)
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 8.0, 4001)
    for _ in range(20):
        angle, rate, acceleration = space.motion(3.0 * rng.normal(size=space.size)).at(t)
        assert limits.violation(arm, angle, rate) is None
        assert np.abs(rate[[0, -1]]).max() < 1e-12 and np.abs(acceleration[[0, -1]]).max() < 1e-11
        np.testing.assert_allclose(np.gradient(angle, t, axis=0)[5:-5], rate[5:-5], atol=1e-3)


@pytest.mark.slow
def test_the_slopes_of_the_measure_are_its_differences() -> None:
    arm, model = laboratory_arm("UR10e")
    grounded = Grounded(arm, model, np.array([joint.torque_sigma for joint in arm.joints]))
    # limits of the torques that the motion exceeds, so that their cost has slopes too
    limits = limits_of(arm, "2.5", "1.5", "1.2")
    space = Space(limits, 4.0, 4)
    goal = _Goal(grounded, space, limits)
    rng = np.random.default_rng(1)
    x = space.draw(rng)
    _, slope = goal.value_and_slope(x)
    for _ in range(3):
        way = rng.normal(size=len(x)) / np.sqrt(len(x))
        difference = (goal.value(x + 1e-5 * way) - goal.value(x - 1e-5 * way)) / 2e-5
        assert slope @ way == pytest.approx(difference, rel=2e-2, abs=1e-3)


@pytest.mark.parametrize("name", ["UR10e", "Panda", "LWR4+"])
def test_columns_times_the_model_are_the_torques_of_pinocchio(name: str) -> None:
    arm, model = laboratory_arm(name)
    grounded = Grounded(arm, model, np.array([joint.torque_sigma for joint in arm.joints]))
    motion = Space(limits_of(arm, "2", "1", None), 10.0, 4).motion(np.random.default_rng(0).normal(size=arm.n * 8))
    step = 1e-4
    t = np.array([0.7, 2.9, 5.3])
    before, now, after = (motion.at(t + shift) for shift in (-step, 0.0, step))
    change = (grounded.at(*after[:2])[0] - grounded.at(*before[:2])[0]) / (2.0 * step)
    torque = (change - grounded.at(*now[:2])[1]) @ grounded.coefficients / arm.gear_ratios
    pinocchio = needed_torque(arm, equations(arm, model, "pinocchio"), *now)
    np.testing.assert_allclose(torque, pinocchio, rtol=1e-5, atol=1e-5 * np.abs(pinocchio).max())


@pytest.mark.slow
def test_a_planned_motion_tells_more_than_a_random_one_and_its_run_keeps_the_limits(
    planned: tuple[Arm, Model, Planner, Scenario, Expectation],
) -> None:
    arm, model, planner, scenario, expectation = planned
    assert planner.grounded is not None
    space = Space(planner.limits, 10.0, 5)
    rng = np.random.default_rng(5)
    others = []
    for _ in range(5):
        motion = space.motion(space.draw(rng))
        names = [joint.name for joint in arm.joints]
        others.append(
            planner.expected(replace(scenario, name="r", manoeuvre=dict(zip(names, motion.motions(), strict=True))))
        )
    assert expectation.measure < min(other.measure for other in others) - 0.2
    run = trajectory_of(arm, model, scenario, noise=False)
    # the drive holds its torque, and therefore differs a little from the continuous one
    wider = replace(planner.limits, torque=1.02 * planner.limits.torque, rate=planner.limits.rate + 2e-3)
    assert wider.violation(arm, run.q[0], run.qd[0], run.tau[0]) is None
    assert np.abs(run.q[0] - run.desired).max() < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("law", ["applied_from_sync", "sampled"])
def test_expected_sigmas_are_the_scatter_of_estimates(
    planned: tuple[Arm, Model, Planner, Scenario, Expectation], law: str
) -> None:
    """Squared deviations over expected variances have the mean 1; parameters of one run are correlated, so that the
    runs alone count."""
    arm, model, _, scenario, expectation = planned
    arm = replace(arm, torque_law=law)
    runs = 12
    trajectory = trajectory_of(arm, model, scenario, seeds=range(runs), rtol=1e-8, atol=1e-10)
    values = np.array(
        [
            estimate_ground([Run.of_cycles(arm, trajectory.cycles(k))], effects=model.effects).solution.value
            for k in range(runs)
        ]
    )
    count = values.shape[1]
    true = np.array([column.value for column in expectation.columns[:count]])
    square = ((values - true) / expectation.sigma[:count]) ** 2
    each = square.mean(axis=1)
    assert abs(each.mean() - 1.0) < 3.0 * each.std(ddof=1) / np.sqrt(runs) + 0.1


@pytest.mark.slow
def test_the_feedforward_torque_follows_a_motion_with_both_engines(
    planned: tuple[Arm, Model, Planner, Scenario, Expectation],
) -> None:
    arm, model, _, scenario, _ = planned
    for law in ("applied_from_sync", "sampled"):
        of_law = replace(arm, torque_law=law)
        runs = [trajectory_of(of_law, model, scenario, engine=name, duration_s=1.0) for name in ("zygos", "pinocchio")]
        np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-9)
        assert np.abs(runs[0].q[0] - runs[0].desired).max() < 5e-3


def test_what_cannot_be_planned_is_refused() -> None:
    arm, model = _two_joints()
    sigma = np.full(2, SIGMA)
    with pytest.raises(ZygosError, match=r"no motion within the limits was found: the torque of joint.*remedy"):
        Planner(arm, model, limits_of(arm, "2", "1", "0.001"), sigma).plan("p", Motion(4.0, 3), *HERE, None)
    with pytest.raises(ZygosError, match="not a whole number of periods"):
        Planner(arm, model, limits_of(arm, "2", "1", None), sigma).plan("p", Motion(duration_s=15.0), *HERE, None)
    with pytest.raises(ZygosError, match="noise of the torque of joint1, joint2 is not known; remedy: declare"):
        Planner(arm, model, limits_of(arm, "2", "1", None), np.zeros(2))
    floating, body, scenario = lively()
    with pytest.raises(ZygosError, match=r"floats or has springs.*remedy: give a scenario"):
        Planner(floating, body, limits_of(floating, None, None, None), np.zeros(2)).plan("p", Motion(), *HERE, None)
    with pytest.raises(ZygosError, match="base is fixed and all joints are rigid; remedy: leave feedforward"):
        trajectory_of(floating, body, replace(scenario, controller=Controller(feedforward=True)), duration_s=0.1)


@pytest.mark.slow
def test_floating_motions_are_ranked_by_what_the_estimator_says() -> None:
    """The planned run's reported sigmas are those of other noise within a factor of 2, in the median."""
    arm, model, scenario = lively()
    slow = replace(scenario, name="slow", duration_s=15.0, manoeuvre={
        name: replace(motion, sines=tuple(replace(sine, amplitude=0.5 * sine.amplitude) for sine in motion.sines))
        for name, motion in scenario.manoeuvre.items()
    })  # fmt: skip
    planner = Planner(arm, model, limits_of(arm, None, None, None), np.zeros(2))
    fast = replace(scenario, name="fast", duration_s=15.0)
    expected = [planner.expected(one) for one in (slow, fast)]
    assert [one.name for one in ranked(expected)] == ["fast", "slow"]
    other = planner.expected(replace(fast, seed=7))
    assert 0.5 < np.median(other.sigma / expected[1].sigma) < 2.0
    tight = Planner(arm, model, limits_of(arm, None, "0.5", None), np.zeros(2))
    with pytest.raises(ZygosError, match=r"rate of joint .* beyond its limit of 0.5 rad/s; remedy"):
        ranked([tight.expected(fast)])


def _short(relative: float = 0.005) -> tuple[Arm, Model, Scenario]:
    """Five seconds of examples/lively with noise in proportion to the torques."""
    arm, model, scenario = lively()
    joints = tuple(replace(joint, torque_relative_sigma=relative) for joint in arm.joints)
    return replace(arm, joints=joints), model, replace(scenario, duration_s=5.0)


def test_motions_are_ranked_by_the_bound_of_each() -> None:
    arm, model, fast = _short()
    slow = replace(fast, name="slow", manoeuvre={
        name: replace(motion, sines=tuple(replace(sine, amplitude=0.3 * sine.amplitude) for sine in motion.sines))
        for name, motion in fast.manoeuvre.items()
    })  # fmt: skip
    still = replace(
        fast,
        name="still",
        manoeuvre={name: replace(one, offset=0.0, sines=()) for name, one in fast.manoeuvre.items()},
        initial_angles_rad=(0.0, 0.0),
        angular_momentum_nms=0.0,
        noise=False,
    )
    planner = Planner(arm, model, limits_of(arm, None, None, None), np.zeros(2), "bound")
    seen: list[float] = []
    expected = [planner.expected(still), planner.expected(slow), planner.expected(fast, seen.append)]
    assert [one.name for one in ranked(expected)] == ["lively", "slow", "still"]
    for one, scenario in zip(expected[1:], (slow, fast), strict=True):
        (least,) = bound(arm, model, scenario)
        np.testing.assert_allclose(one.percent, least.percent, rtol=1e-6)
        assert one.mean_percent == pytest.approx(least.mean_percent, rel=1e-6)
        assert one.worst == int(least.percent.argmax())
    assert seen == sorted(seen) and len(seen) > 10 and seen[-1] == pytest.approx(1.0)
    assert np.isnan(expected[0].sigma).all()
    with pytest.raises(Undecided, match=r"motion still: .* does not determine .*remedy"):
        ranked(expected[:1])
    # a motion that exceeds a limit comes after one that leaves something open
    tight = Planner(arm, model, limits_of(arm, None, "0.5", None), np.zeros(2), "bound")
    with pytest.raises(Undecided, match="motion still"):
        ranked([tight.expected(fast), expected[0]])


@pytest.mark.slow
def test_the_given_noise_of_the_torques_is_that_of_the_bound() -> None:
    arm, model, scenario = _short()
    given = Planner(arm, model, limits_of(arm, None, None, None), np.array([0.5, 1.0]), "bound").expected(scenario)
    joints = tuple(replace(one, torque_sigma=sigma) for one, sigma in zip(arm.joints, (0.5, 1.0), strict=True))
    (declared,), (without,) = bound(replace(arm, joints=joints), model, scenario), bound(arm, model, scenario)
    np.testing.assert_allclose(given.sigma, declared.sigma, rtol=1e-6)
    assert np.all(given.sigma > 1.5 * without.sigma)


def test_a_search_by_the_bound_finds_the_best_of_its_motions() -> None:
    arm, model, template = _short()
    planner = Planner(arm, model, limits_of(arm, "2", "1.5", None), np.zeros(2), "bound")
    seen: list[float] = []
    found = []
    for count in (1, 2):
        seen.clear()
        sought = Motion(period_s=5.0, seed=4, simulated=count)
        found.append(planner.plan("p", sought, *HERE, template, seen.append))
        assert seen == sorted(seen) and len(seen) > 10 * count and seen[-1] == pytest.approx(1.0)
    (_, first), (scenario, best) = found
    assert best.measure < first.measure
    again = planner.expected(scenario)
    assert again.measure == best.measure and best.excess is None
    assert best.measure == pytest.approx(np.log(0.01 * best.mean_percent))
    # a motion beyond a limit is left out before its bound is computed, and the last reason is said
    tight = Planner(arm, model, limits_of(arm, "2", "1.5", "0.001"), np.zeros(2), "bound")
    with pytest.raises(ZygosError, match=r"none of 1 motions can be used; the last one: the torque of joint .*remedy"):
        tight.plan("p", Motion(period_s=5.0, simulated=1), *HERE, template)


def test_what_has_no_bound_is_not_ranked_by_it() -> None:
    arm, model, _ = lively()
    free, sigma = limits_of(arm, None, None, None), np.zeros(2)
    rubbing = replace(model, effects=(effect("motor_coulomb", "elbow", 1.0),))
    with pytest.raises(ZygosError, match=r"effects \(motor_coulomb\); remedy: .*, or leave out --by bound"):
        Planner(arm, rubbing, free, sigma, "bound")
    with pytest.raises(ZygosError, match=r"held from SYNC to SYNC; remedy: .*, or leave out --by bound"):
        Planner(replace(arm, torque_law="sampled"), model, free, sigma, "bound")
    for base in ("free", "fixed"):
        rigid, solid = random_arm(1, 2, base, "planar", False)
        with pytest.raises(ZygosError, match=r"joint joint1 is rigid.*remedy: .*, or leave out --by bound"):
            Planner(rigid, solid, limits_of(rigid, None, None, None), np.full(2, SIGMA), "bound")


@pytest.mark.slow
def test_a_fixed_base_without_mass_can_be_exported() -> None:
    arm, model = laboratory_arm("UR10e", friction=False)
    arm = replace(arm, joints=arm.joints[:3])
    model = replace(
        model, bodies=(*model.bodies[:3], replace(model.bodies[3], joint_xyz=None)), joints=model.joints[:3]
    )
    drawing = replace(model, bodies=tuple(replace(b, mass=Quantity(1.2 * b.mass.value)) for b in model.bodies))
    values = dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True))
    given = Model("given", parameters={name: Quantity(value) for name, value in values.items()})
    found = nearest_bodies(arm, drawing, given).model
    np.testing.assert_allclose(found.base_values(arm), model.base_values(arm), rtol=1e-6, atol=1e-9)
