# SPDX-License-Identifier: MIT
"""The compiled equations of motion are those of numpy and of engines by others; what a simulation with them errs by."""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from arm_support import random_arm
from motion_support import FLEXIBLE, sampled_arm
from plant_support import example
from scipy.spatial.transform import Rotation

from bench.simulator import far
from conftest import ROOT
from zygos import effects
from zygos.arm import Arm
from zygos.balances.state import State
from zygos.dynamics.compiled import Multibody, Planar, Stepper
from zygos.dynamics.engines import engine
from zygos.dynamics.equations import equations, from_model
from zygos.dynamics.joints import Drives, Moment
from zygos.dynamics.planar import PlanarDynamics
from zygos.dynamics.replay import replay
from zygos.dynamics.serial import SpatialDynamics
from zygos.effects import CATALOGUE, Effect, Kind, effect
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.native.flight import ffi, lib
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Motion, Sine

ARMS = [
    (joints, base, kinetic, kind)
    for joints in (1, 3, 9)
    for base in ("free", "fixed")
    for kinetic in ("spatial", "planar", "planar-symmetric")
    for kind in ("flexible", "rigid", "mixed")
    if (base == "fixed" or kinetic == "spatial") and (joints < 9 or kind == "mixed")
]
Accelerations = Sequence[np.ndarray]
BOUND = 1e-9
"""What a simulation may err by, of each signal's size."""


def alike(got: Accelerations, wanted: Accelerations, tolerance: float = 1e-11) -> None:
    """Accelerations of base, links and motors, each against its largest entry."""
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * np.abs(other).max())


@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), ARMS)
def test_accelerations_are_those_of_numpy_and_of_engines(joints: int, base: str, kinetic: str, kind: str) -> None:
    arm, model, samples = sampled_arm(joints, base, kinetic, kind)
    ours, numpys = Multibody.from_model(arm, model), SpatialDynamics.from_model(arm, model)
    engines = [engine(name, arm, model) for name in ("pinocchio", "mujoco")]
    for sample in samples:
        found = ours.accelerations(*sample)
        alike(found, numpys.accelerations(*sample))
        for oracle in engines:
            alike(found, oracle.accelerations(*sample), 1e-10)


@pytest.mark.parametrize("kind", FLEXIBLE)
@pytest.mark.parametrize("kinetic", ["planar", "planar-symmetric"])
@pytest.mark.parametrize("joints", [1, 2, 5])
def test_accelerations_of_a_planar_arm_that_floats_are_numpys(joints: int, kinetic: str, kind: str) -> None:
    arm, model, samples = sampled_arm(joints, "free", kinetic, kind)
    ours, numpys = Planar.from_model(arm, model), PlanarDynamics.from_model(arm, model)
    assert isinstance(from_model(arm, model), Planar)
    copied = pickle.loads(pickle.dumps(ours))
    for sample in samples:
        state = sample._replace(omega0=sample.omega0[..., 2])
        for dynamics in (ours, copied):
            alike(dynamics.accelerations(*state), numpys.accelerations(*state))


def _stribeck(motion: effects.Motion, _shape: float) -> np.ndarray:
    rate = motion.rate
    return np.tanh(rate / 0.01) * (1.0 + 0.5 * np.exp(-((rate / 0.05) ** 2)))


OWN = Kind("own_stribeck", "Stribeck friction", "Nm", "link", _stribeck)
"""A law of somebody's own: any callable."""


def laws(arm: Arm) -> tuple[Effect, ...]:
    """Every torque law of the catalogue that the arm has a place for, and one of our own, and a coupling that is not
    nature's."""
    first, last = arm.joints[0].name, arm.joints[-1].name
    values = {"motor_coulomb": 0.02, "motor_viscous": 0.01, "link_coulomb": 0.3}
    common = [Effect(CATALOGUE[key], last, value) for key, value in values.items()]
    springs = [joint.name for joint in arm.joints if joint.flexible]
    if springs:
        common.append(Effect(CATALOGUE["cubic_stiffness"], springs[-1], 900.0))
        common.append(Effect(CATALOGUE["spring_offset"], springs[0], 0.4))
    # the carrier of a fixed arm's first rotor does not turn
    coupled = Effect(CATALOGUE["rotor_coupling"], first if arm.free else last, 0.3)
    return (*common, coupled, Effect(OWN, first, 0.7))


@pytest.mark.parametrize("kind", FLEXIBLE)
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_effects_act_as_in_numpy(base: str, kind: str) -> None:
    arm, model, samples = sampled_arm(4, base, "spatial", kind)
    plain, model = Multibody.from_model(arm, model), replace(model, effects=laws(arm))
    ours, numpys = Multibody.from_model(arm, model), SpatialDynamics.from_model(arm, model)
    for sample in samples:
        alike(ours.accelerations(*sample), numpys.accelerations(*sample))
        assert np.abs(ours.accelerations(*sample)[1] - plain.accelerations(*sample)[1]).max() > 1e-3


# sizes that bend the motion within the steps below
SIZES = {"motor_coulomb": 0.02, "motor_viscous": 0.01, "link_viscous": 0.1, "load_friction": 0.2, "torque_gain": 0.1,
         "cubic_stiffness": 5e7, "backlash": 50.0, "viscous_asymmetry": 0.01, "motor_stribeck": 0.02}  # fmt: skip


ONSET_S = 0.50052
"""Seconds after which a torque on the base begins: at the second of three states within the steps below, and of a
step."""


@pytest.mark.parametrize("kind", FLEXIBLE)
@pytest.mark.parametrize("kinetic", ["planar", "spatial"])
def test_torques_on_the_base_act_as_in_numpy(kinetic: str, kind: str) -> None:
    arm, model, samples = sampled_arm(3, "free", kinetic, kind)
    pushed = [Effect(CATALOGUE["base_leak"], None, 40.0, shape=2.0, component=c) for c in arm_axes(arm)]
    loaded = replace(model, effects=(*pushed, Effect(CATALOGUE["motor_viscous"], arm.joints[0].name, 0.01)))
    numpys = (SpatialDynamics if arm.spatial else PlanarDynamics).from_model(arm, loaded)
    ours = from_model(arm, loaded)
    assert isinstance(ours, Multibody | Planar)
    for sample in samples:
        state = sample if arm.spatial else sample._replace(omega0=sample.omega0[..., 2])
        alike(ours.accelerations(*state, Moment(3.0)), numpys.accelerations(*state, Moment(3.0)))
        before, after = (ours.accelerations(*state, Moment(at))[0] for at in (1.0, 3.0))
        assert np.all(np.abs(after - before) > 1e-3)


def arm_axes(arm: Arm) -> tuple[str, ...]:
    """The components of a torque on the base."""
    return CATALOGUE["base_leak"].components(arm)


@pytest.mark.slow(only=["free-spatial-mixed", "free-planar-mixed"])
@pytest.mark.parametrize("kind", ["rigid", "mixed"])
@pytest.mark.parametrize(("base", "kinetic"), [("free", "planar"), ("free", "spatial"), ("fixed", "planar")])
def test_steps_of_time_are_those_in_python(base: str, kinetic: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With every law that is compiled, one after the other; at the second joint, which is flexible in a mixed arm."""
    arm, model, samples = sampled_arm(2, base, kinetic, kind, states=3)
    width, joint = 3 if kinetic == "spatial" else 1, arm.joints[1].name
    entries = [one for one in CATALOGUE.values() if effects.compiled_form(one) is not None]
    acting: list[tuple[Effect, ...]] = [()]
    for one in entries:
        shape = one.shapes[-1] if one.shapes else None
        if one.place == "base":
            # an onset within the steps
            shape = ONSET_S if one.key == "base_leak" else shape
            if arm.free and one.world != ("space" if kinetic == "planar" else "plane"):
                acting.append((Effect(one, None, 50.0, shape=shape, component=one.components(arm)[-1]),))
            continue
        if arm.joints[1].flexible or one.place != "spring":
            acting.append((Effect(one, joint, SIZES.get(one.key, 0.2), shape=shape),))
    if arm.free and arm.spatial:
        arm = replace(arm, nadir=(0.6, 0.0, -0.8))
        acting.append((effect("gravity_gradient", value=30.0),))
    ends: list[np.ndarray] = []
    for laws_of in acting:
        dynamics = from_model(arm, replace(model, effects=laws_of))
        packed = []
        for sample in samples:
            bent = np.where(dynamics.rigid, 0.0, 1e-3 * (sample.theta - sample.q))
            motor = np.where(dynamics.rigid, sample.qd, sample.thetad)
            rate = np.atleast_1d(sample.omega0)[: width if arm.free else 0]
            packed.append(State(sample.q, sample.q + bent, sample.qd, motor, rate).packed())
        torque = np.stack([sample.tau for sample in samples])

        def moved(
            dynamics: Drives = dynamics, packed: list[np.ndarray] = packed, tau: np.ndarray = torque
        ) -> np.ndarray:
            faced = Rotation.random(3, rng=1).as_matrix()[:, 0] if arm.nadir else None
            begin = Moment(np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.4, 0.8]), nadir=faced)
            return replay(dynamics, 1e-4, np.stack(packed), lambda _k, _now: tau, tau, 8, 2, begin)[0]

        quick = moved()
        assert Stepper.of(dynamics) is not None
        with monkeypatch.context() as patch:
            patch.setattr(Stepper, "of", lambda _dynamics: None)
            slow = moved()
        size = np.abs(slow).max(axis=(0, 1))
        np.testing.assert_allclose(quick, slow, rtol=0, atol=1e-10 * size.max())
        ends.append(quick[:, -1])
    for number, end in enumerate(ends[1:]):
        assert np.abs(end - ends[0]).max() > 1e-8 * np.abs(ends[0]).max(), acting[number + 1]


def test_steps_of_what_is_not_compiled_are_left_to_python() -> None:
    arm, model = random_arm(2, 2, "free", "planar", [True, True])
    joint = arm.joints[0].name
    for one in (Effect(CATALOGUE["base_oscillator"], None, 0.1, shape=1.0), Effect(OWN, joint, 0.7)):
        assert Stepper.of(from_model(arm, replace(model, effects=(one,)))) is None
    assert Stepper.of(from_model(arm, model)) is not None


def test_a_batch_is_its_members() -> None:
    arm, model, samples = sampled_arm(3, "free", "spatial", "mixed")
    dynamics = Multibody.from_model(arm, model)
    stacked = [np.stack([part, part]) for part in map(np.stack, zip(*samples, strict=True))]
    for k, part in enumerate(dynamics.accelerations(*stacked)):
        assert part.shape[:2] == (2, len(samples))
        for row in part:
            np.testing.assert_array_equal(row, [dynamics.accelerations(*sample)[k] for sample in samples])
    with pytest.raises(ValueError, match="broadcast"):
        dynamics.accelerations(*stacked[:-1], samples[0].tau[:2])


def test_a_copy_in_another_process_moves_alike() -> None:
    arm, model, samples = sampled_arm(2, "free", "spatial", "flexible")
    dynamics = Multibody.from_model(arm, model)
    before = dynamics.accelerations(*samples[0])
    copied = pickle.loads(pickle.dumps(dynamics))
    np.testing.assert_array_equal(np.hstack(copied.accelerations(*samples[0])), np.hstack(before))


@pytest.mark.slow(only=["free-12", "fixed-12"])
@pytest.mark.parametrize("joints", [1, 3, 12])
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_memory_is_what_it_says(joints: int, base: str) -> None:
    """It fills its scratch memory to the last double and not beyond, and nothing of it is read before it is written."""
    arm, model, samples = sampled_arm(joints, base, "spatial", "mixed")
    dynamics = Multibody.from_model(arm, model)
    native, room, _ = dynamics.compiled
    rates = (samples[0].omega0, samples[0].q, samples[0].qd, samples[0].thetad)
    state = np.concatenate([*rates, *np.ones((3, joints)), np.ones(3)])
    results = []
    for filling in (np.nan, 7.0):
        scratch, result = np.full(room + 50, filling), np.full(3 + 2 * joints + 50, filling)
        views = [ffi.from_buffer("double[]", array) for array in (state, result, scratch)]
        lib.zygos_multibody_accelerations(native, 1, *views)
        for array, used in ((scratch, room), (result, 3 + 2 * joints)):
            np.testing.assert_array_equal(array[used:], filling)
        moved = np.concatenate([state[: 3 + 4 * joints], np.full(50, filling)])
        spring, torque = (ffi.from_buffer("double[]", np.ones(count)) for count in (2 * joints, joints))
        place = ffi.from_buffer("double[]", moved)
        clock = np.concatenate([np.zeros(2), [0.6, 0.0, 0.8], np.full(50, filling)])
        times = ffi.from_buffer("double[]", clock)
        held = ffi.from_buffer("double[]", np.ones(1))
        lib.zygos_multibody_advance(
            native, 1, 3, spring, ffi.NULL, 0, 0.1, torque, 1e-4, 2, place, times, 1, held, views[2]
        )
        for array, used in ((scratch, room), (moved, 3 + 4 * joints), (clock, 5)):
            np.testing.assert_array_equal(array[used:], filling)
        if base == "free":
            assert scratch[room - 1] != filling
        results.append(np.concatenate([result[: 3 + 2 * joints], moved[: 3 + 4 * joints]]))
    assert np.isfinite(results[0]).all()
    np.testing.assert_array_equal(*results)


def test_where_no_inertia_resists_nothing_is_finite() -> None:
    """Not a crash, and no number that looks like one."""
    arm, model, samples = sampled_arm(2, "free", "spatial", "flexible")
    dynamics = Multibody.from_model(arm, model)
    empty = replace(dynamics, matrix=np.zeros_like(dynamics.matrix), coupling=np.zeros(2))
    assert not np.isfinite(np.hstack(empty.accelerations(*samples[0]))).any()


def test_nothing_is_shared_with_the_library_that_estimates() -> None:
    text = (ROOT / "c" / "ports" / "host" / "multibody.c").read_text()
    text += (ROOT / "c" / "ports" / "host" / "multibody.h").read_text()
    assert set(re.findall(r'#include ["<](.*)[">]', text)) == {"multibody.h", "math.h", "string.h", "stdint.h"}
    assert set(re.findall(r"\b(zygos_\w+)\(", text)) == {
        f"zygos_multibody_{name}" for name in ("scratch", "accelerations", "rates", "advance")
    }


# of each scenario in space: SYNC period and seconds beside numpy, which takes 3 and 20 CPU seconds a second
SHIPPED = {"spatial": (0.01, 0.06, 1.0), "seven": (0.004, 0.012, 0.4)}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_simulation_errs_by_less_than_it_may(name: str) -> None:
    """Against DOP853 on numpy's equations at a tighter tolerance; and longer against itself at that tolerance.

    Sensors are exact: an encoder that rounds tips over at differences of any size. Nothing amplifies an error here: the
    servos hold every joint, and after the start the difference does not grow.
    """
    arm, model, scenario = example(name)
    period, beside_s, longer_s = SHIPPED[name]

    def run(duration: float, law: type[SpatialDynamics], **tolerance: float) -> Trajectory:
        dynamics = law.from_model(arm, model)
        return simulate(
            arm, model, scenario, dynamics=dynamics, noise=False, period_s=period, duration_s=duration, **tolerance
        )

    tight = {"rtol": 1e-13, "atol": 1e-15}
    assert isinstance(equations(arm, model), Multibody)
    short, long = run(beside_s, Multibody), run(longer_s, Multibody)
    assert far(short, run(beside_s, SpatialDynamics, **tight)) < BOUND
    assert far(long, run(longer_s, Multibody, **tight)) < BOUND
    # and the bound is one: a coarser integration does not keep it
    assert far(run(beside_s, Multibody, rtol=1e-5, atol=1e-7), short) > BOUND


@pytest.mark.slow
def test_laws_in_python_move_an_arm_in_space() -> None:
    arm, model, scenario = example("spatial")
    arm = arm.at_period(0.01)
    acting = (
        Effect(CATALOGUE["cubic_stiffness"], "elbow", 2e5),
        Effect(CATALOGUE["motor_viscous"], "yaw", 1e-3),
        Effect(CATALOGUE["torque_lag"], "shoulder", 0.004),
        Effect(OWN, "shoulder", 0.5),
    )
    drawn = replace(model, effects=acting)

    def run(law: type[SpatialDynamics], model: Model) -> Trajectory:
        dynamics = law.from_model(arm, model)
        return simulate(arm, model, scenario, dynamics=dynamics, noise=False, duration_s=0.05, seeds=[0, 1])

    moved = run(Multibody, drawn)
    assert far(moved, run(SpatialDynamics, drawn)) < BOUND
    assert far(moved, run(Multibody, model)) > 1e-3
    np.testing.assert_array_equal(moved.q[0], moved.q[1])


@pytest.mark.slow
def test_a_motion_that_no_number_follows_is_refused() -> None:
    """Gains far too high for the sample rate: NaN and infinity end in a message, not in a result."""
    arm, model, scenario = example("spatial")
    wild = replace(scenario, controller=replace(scenario.controller, kp=1e9, kd=1e8))
    with pytest.raises(ZygosError, match=r"(diverges|integration steps).*remedy"):
        simulate(arm, model, wild, period_s=0.01, duration_s=1.0)


@pytest.mark.slow
def test_six_joints_conserve_momentum() -> None:
    arm, model = random_arm(6, 6, "free")
    moves = {joint.name: Motion(sines=(Sine(0.3, 0.7 + 0.3 * i),)) for i, joint in enumerate(arm.joints)}
    scenario = replace(
        example("spatial")[2], manoeuvre=moves, initial_angles_rad=(), angular_momentum_nms=(3.0, 1.0, -2.0)
    )
    scenario = replace(scenario, controller=replace(scenario.controller, kp=40.0, kd=10.0))
    run = simulate(arm, model, scenario, noise=False, period_s=0.01, duration_s=0.5)
    law = run.dynamics
    assert isinstance(law, Multibody)
    h = law.momentum(run.q[0], run.omega0[0], run.qd[0], run.thetad[0])
    np.testing.assert_allclose(np.linalg.norm(h, axis=1), np.linalg.norm([3.0, 1.0, -2.0]), rtol=1e-10)
    assert np.abs(run.q[0]).max() > 0.1
