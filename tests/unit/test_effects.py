# SPDX-License-Identifier: MIT
"""Effects from the model file to the columns of the flight library: one catalogue, and what each column is worth."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from arm_support import exact_torques
from cases_support import CASES, arm_of, record_of
from flight_support import CHOSEN, balanced, bytes_of, chosen, energy_only, sines
from numpy.typing import NDArray
from plant_support import LIVELY, lively, random_arm
from reference_support import make_arm
from runs_support import trajectory_of
from scipy import stats

from conftest import ROOT
from zygos import reference
from zygos.arm import NO_IMU, Arm, load_arm
from zygos.dynamics.equations import equations
from zygos.effects import CATALOGUE, GAIN, SLOWEST_RATE, Effect, Motion, estimated
from zygos.errors import ZygosError
from zygos.model.model import load_model, save_model
from zygos.native import flight
from zygos.native.flight import REASONS, Flight, config_of, encode, ffi, lib
from zygos.reference.compare import Room, check_chain
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory

Floats = NDArray[np.float64]

COLUMNS = [key for key, kind in CATALOGUE.items() if kind.flies and kind.place not in ("rotor", "base")]
NOT_PHYSICAL, UNCLOSED = REASONS[4], REASONS[6]


def effect(key: str, joint: str, value: float = 0.0) -> Effect:
    return Effect(CATALOGUE[key], joint, value)


def silent(arm: Arm) -> Arm:
    """For runs without noise, from which none is to be taken off."""
    return replace(arm, compensate_every=0)


# ---------------------------------------------------------------- catalogue


def test_every_column_has_its_kind_in_the_flight_library() -> None:
    kinds = {name for name in ffi.typeof("enum zygos_effect_kind").elements.values()}
    assert kinds == {f"ZYGOS_{key.upper()}" for key in [*COLUMNS, GAIN]}
    lawful = {key for key, kind in CATALOGUE.items() if kind.torque is not None and kind.flies}
    assert lawful | {"torque_lag"} == set(COLUMNS)


def test_catalogue_and_flight_library_agree_on_what_they_share() -> None:
    header = (ROOT / "include" / "zygos" / "priv" / "effects.h").read_text()
    found = re.search(r"#define ZYGOS_COULOMB_FULL_RATE (\S+)", header)
    assert found is not None
    assert float(found[1]) == SLOWEST_RATE
    arm, *_ = lively()
    for key in COLUMNS:
        config = config_of(arm, [effect(key, "elbow")])
        assert (config.effects, config.effect[0].joint) == (1, 1)
        assert lib.zygos_effects_positive(config) == int(CATALOGUE[key].positive)


@pytest.mark.parametrize("key", [key for key, kind in CATALOGUE.items() if kind.becomes])
def test_a_law_with_a_shape_becomes_the_one_without(key: str) -> None:
    """At a speed that is never reached, or a distance that is short beside the motion."""
    kind, time = CATALOGUE[key], np.linspace(0.0, 10.0, 20001)
    plain = CATALOGUE[kind.becomes]
    assert plain.place == kind.place and plain.torque is not None and kind.law is not None
    motion = Motion(rate=np.cos(time), angle=np.sin(time), time=time)
    if kind.memory is not None:
        motion = kind.memory.along(motion, 1e-4, time[1])
    torque = kind.law(motion, 1e6 if kind.memory is None else 1e-4)
    rate = motion.rate
    moving = (np.abs(rate) > 0.1) & (time > 0.0)
    np.testing.assert_allclose(torque[moving], plain.torque(rate)[moving], atol=1e-3)


def test_leaving_a_law_out_leaves_out_what_becomes_it() -> None:
    left = {key for key, kind in CATALOGUE.items() if kind.left_out(["motor_coulomb"])}
    assert left == {"motor_coulomb", "motor_dahl", "motor_maxwell", "motor_stribeck"}


@pytest.mark.parametrize("key", CATALOGUE)
def test_entries_make_sense(key: str) -> None:
    kind = CATALOGUE[key]
    assert kind.key == key
    assert set(kind.twins) <= set(CATALOGUE) - {key}
    assert not kind.becomes or (kind.shapes and kind.becomes in kind.twins)
    if kind.torque is None:
        return
    x = np.linspace(-2.0, 2.0, 4001)
    law = kind.torque(x)
    if key == "torque_offset" or key.endswith("viscous_asymmetry"):
        np.testing.assert_allclose(law, law[::-1], atol=1e-12)
    elif key != "spring_offset":
        np.testing.assert_allclose(law, -law[::-1], atol=1e-12)
        assert (law * x >= 0.0).all()
    if kind.potential is not None:
        np.testing.assert_allclose(np.gradient(kind.potential(x, np.nan), x)[1:-1], law[1:-1], atol=1e-5)


def test_what_has_no_column_is_passed_over_or_refused() -> None:
    arm, *_ = lively()
    friction = effect("motor_coulomb", "elbow", 0.3)
    natural = effect("rotor_coupling", "shoulder", 1.0)
    momentum = Effect(CATALOGUE["angular_momentum"], None, 4.0)
    assert estimated(arm, [natural, friction, momentum]) == (friction,)
    assert Flight(arm, [natural, friction, momentum]).names == (*arm.parameter_names, "motor_coulomb2")
    for coupling in (0.0, 0.5):
        with pytest.raises(ZygosError, match=r"rotor_coupling at elbow.*remedy"):
            Flight(arm, [effect("rotor_coupling", "elbow", coupling)])


# ---------------------------------------------------------------- model file


def test_model_file_round_trip(tmp_path: Path) -> None:
    _, model, _ = lively()
    effects = [
        Effect(
            kind, "elbow" if kind.at_joint else None, 0.25, 0.01, "test", "because", shape=0.5 if kind.shapes else None
        )
        for kind in CATALOGUE.values()
    ]
    effects += [effect("motor_coulomb", "shoulder"), effect("cubic_stiffness", "shoulder", -3.0)]
    model = replace(model, effects=tuple(effects))
    save_model(model, tmp_path / "model.toml")
    assert load_model(tmp_path / "model.toml") == model
    assert 'unit = "Nms/rad"' in (tmp_path / "model.toml").read_text()


ENTRY = '[[effect]]\nkind = "motor_coulomb"\njoint = "elbow"\nvalue = 0.3\nunit = "Nm"\n'


@pytest.mark.parametrize(
    ("find", "put", "message"),
    [
        ("motor_coulomb", "stiction", r"effect\[0\]\.kind: 'stiction' is not known"),
        ('joint = "elbow"\n', "", r"effect\[0\]\.joint: is missing"),
        ('"Nm"', '"mNm"', r"effect\[0\]\.unit: 'mNm' is not the unit of motor_coulomb"),
        ("0.3", "-0.3", r"effect\[0\]\.value: -0.3 is out of range"),
        ("0.3", "nan", r"effect\[0\]\.value"),
        ("value = 0.3\n", "", r"effect\[0\]\.value: is missing"),
        ("0.3", "0.3\nsigma = -1.0", r"effect\[0\]\.sigma"),
        ("0.3", '0.3\nsource = "guess"', r"effect\[0\]\.source"),
        ("0.3", '0.3\nvalues = 3', r"effect\[0\]\.values: unknown key"),
        ('motor_coulomb"', 'angular_momentum"', r"effect\[0\]\.joint: unknown key|effect\[0\]\.unit"),
        (ENTRY, ENTRY + ENTRY, r"effect\[1\]\.kind: motor_coulomb at elbow appears twice"),
    ],
)  # fmt: skip
def test_model_file_refusals(tmp_path: Path, find: str, put: str, message: str) -> None:
    assert find in ENTRY
    file = tmp_path / "model.toml"
    file.write_text((LIVELY / "model.toml").read_text() + ENTRY)
    load_model(file)
    file.write_text((LIVELY / "model.toml").read_text() + ENTRY.replace(find, put))
    with pytest.raises(ZygosError, match=rf"model\.toml: .*(?:{message}).*; remedy: "):
        load_model(file)


# ---------------------------------------------------------------- configuration


def test_refused_configurations_change_nothing() -> None:
    arm, *_ = lively()
    used = Flight(arm, [effect("motor_coulomb", "elbow")])
    before = bytes_of(used.native)
    most, wrong = lib.ZYGOS_MAX_EFFECTS_VALUE, 2**32 - 1
    for count, *pairs in (
        (most + 1,), (wrong,), (1, (8, 0)), (1, (wrong, 0)), (1, (0, 2)), (1, (0, wrong)),
        (2, (0, 1), (0, 1)), (3, (4, 0), (0, 1), (4, 0)), (4, (0, 0), (1, 0), (2, 0), (3, 7)),
    ):  # fmt: skip
        config = config_of(arm)
        config.effects = count
        for k, (kind, joint) in enumerate(pairs):
            config.effect[k].kind, config.effect[k].joint = kind, joint
        assert lib.zygos_arm_init(used.native, config) == lib.ZYGOS_E_EFFECT, (count, pairs)
        assert bytes_of(used.native) == before


@pytest.mark.parametrize("key", COLUMNS)
def test_a_rigid_joint_has_no_spring(key: str) -> None:
    """In the library's configuration, in the estimator and in the simulator."""
    arm, model, _ = lively()
    shoulder, elbow = arm.joints
    stiff = replace(arm, joints=(shoulder, replace(elbow, flexible=False, link_encoder=elbow.motor_encoder)))
    infinite = replace(model.joints[1], stiffness=replace(model.joints[1].stiffness, value=np.inf))
    rigid = replace(model, joints=(model.joints[0], infinite), effects=(effect(key, "elbow"),))
    config, native = config_of(arm, [effect(key, "elbow")]), Flight(arm).native
    assert lib.zygos_arm_init(native, config) == 1
    config.joint[1].rigid = 1
    before = bytes_of(native)
    if CATALOGUE[key].place != "spring":
        assert lib.zygos_arm_init(native, config) == 1
        assert Flight(stiff, rigid.effects).names[-1] == f"{key}2"
        equations(stiff, rigid, "zygos")
        return
    assert lib.zygos_arm_init(native, config) == lib.ZYGOS_E_EFFECT
    assert bytes_of(native) == before
    with pytest.raises(ZygosError, match=rf"effect {key} at elbow: the joint is rigid in arm {arm.name}.*remedy"):
        Flight(stiff, rigid.effects)
    for one, wrong in ((stiff, "the joint is rigid"), (arm, "the joint's stiffness is infinite")):
        with pytest.raises(ZygosError, match=rf"effect {key} at elbow: {wrong}.*remedy"):
            equations(one, rigid, "zygos")
    config.effect[0].joint = 0
    assert lib.zygos_arm_init(native, config) == 1


def test_effects_of_a_base_that_cannot_turn() -> None:
    arm, *_ = lively()
    momentum = Effect(CATALOGUE["angular_momentum"], None, 1.0)
    fixed, space = replace(arm, base="fixed", imu=NO_IMU), replace(arm, kinetic="spatial")
    assert momentum.index(arm) == -1
    for other, said in ((fixed, "the base of arm lively is fixed"), (space, "moves in space")):
        with pytest.raises(ZygosError, match=rf"angular_momentum: .*{said}.*remedy"):
            estimated(other, [momentum])
    assert estimated(fixed, [effect("rotor_coupling", "elbow", 1.0)]) == ()
    with pytest.raises(ZygosError, match=r"rotor_coupling at shoulder: .*does not turn; remedy"):
        estimated(fixed, [effect("rotor_coupling", "shoulder", 1.0)])


def test_the_binding_names_what_is_refused() -> None:
    arm, *_ = lively()
    with pytest.raises(ZygosError, match=r"stands twice.*remedy: correct the effects"):
        Flight(arm, [effect("torque_lag", "elbow"), effect("torque_lag", "elbow")])
    with pytest.raises(ZygosError, match=r"no joint 'wrist'.*remedy"):
        Flight(arm, [effect("torque_lag", "wrist")])
    long = exact_torques(load_arm(ROOT / "examples" / "seven" / "arm.toml"))
    many = [effect(key, joint.name) for key in COLUMNS for joint in long.joints]
    with pytest.raises(ZygosError, match=rf"{len(many)} effects.*this build holds 21; remedy"):
        Flight(long, many)


# ---------------------------------------------------------------- columns against the simulator


# A size that moves the arm little, and still does work far above what the balance of 10 ms cycles leaves over.
SIZES = {
    "motor_coulomb": (0.2, 5e-5),
    "motor_viscous": (2.0, 5e-5),
    "link_coulomb": (10.0, 5e-5),
    "cubic_stiffness": (1000.0, 5e-5),
    "spring_offset": (1.0, 5e-5),
    "torque_lag": (1e-4, 3e-4),
    "torque_offset": (0.1, 5e-5),
    "viscous_asymmetry": (2.0, 5e-5),
}
QUICK = "motor_coulomb"


def moved(*effects: Effect) -> tuple[Arm, Cycles]:
    """The motion of examples/lively with these effects, read without noise every 10 ms."""
    arm, model, scenario = lively()
    plant = replace(model, effects=effects)
    run = trajectory_of(arm, plant, scenario, noise=False, period_s=0.01, duration_s=8.0, rtol=1e-9, atol=1e-11)
    return silent(run.arm), run.cycles()


def balance_left_over(one: Effect, *acting: Effect) -> tuple[Floats, Floats]:
    """row . true parameters - W of a motion, without the effect, and the effect's column, both less their means (one
    arc)."""
    arm, cycles = moved(*acting)
    trace = Flight(arm, [one]).cycles(cycles, trace=True)
    assert trace is not None
    rows = trace.row[trace.instant]
    p = len(arm.parameter_names)
    rest = rows[:, :p] @ lively()[1].base_values(arm) - rows[:, -1]
    return rest - rest.mean(), rows[:, p] - rows[:, p].mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "joint"), [*((key, "elbow") for key in SIZES), ("motor_coulomb", "shoulder"), ("torque_lag", "shoulder")]
)
def test_column_is_what_the_effect_does_to_the_balance(key: str, joint: str) -> None:
    """Its derivative by the coefficient, from two simulations."""
    assert set(SIZES) == set(COLUMNS)
    size, tolerance = SIZES[key]
    one = effect(key, joint)
    with_it, column = balance_left_over(one, replace(one, value=size))
    without, _ = balance_left_over(one)
    difference = (with_it - without) / size + column
    error = np.sqrt(np.mean(difference**2) / np.mean(column**2))
    print(f"{key} {joint}: {error:.1e}")
    assert error <= tolerance


# ---------------------------------------------------------------- C against numpy


def same(arm: Arm, cycles: Cycles, effects: Sequence[Effect]) -> list[Room]:
    """Every room of `zygos self-test`, with rows within 1e-12 of each column's largest entry or what the readings' own
    rounding does."""
    run = Flight(arm, effects)
    trace = run.cycles(cycles, trace=True)
    assert trace is not None
    rows = trace.row[trace.instant]
    assert rows.shape[1] == len(run.names) + 1 == len(arm.parameter_names) + len(effects) + 1
    assert (np.abs(rows).max(axis=0) > 0.0).all()
    rooms = check_chain(arm, trace, run)
    assert [room for room in rooms if not room.equal] == []
    assert {room.name: room.compared for room in rooms}["balance"] == rows.size
    return rooms


@pytest.mark.slow(but=["one joint, all"])
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if not case.far])
def test_c_equals_numpy_with_effects(name: str) -> None:
    """As many as the build holds, other ones at other arms."""
    arm, cycles = arm_of(CASES[name]), record_of(CASES[name])
    # these records do not tell an offset and an asymmetry of one joint from its other columns
    keys = [key for key in COLUMNS if arm.n > 1 or key not in ("torque_offset", "viscous_asymmetry")]
    every = [effect(key, joint.name) for joint in arm.joints for key in keys]
    same(arm, cycles, every[::-1][: lib.ZYGOS_MAX_EFFECTS_VALUE])


@pytest.mark.slow
def test_c_equals_numpy_with_every_effect_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a build that has room for them."""
    arm, model, scenario = lively()
    effects = [effect(key, joint.name) for key in COLUMNS for joint in arm.joints]
    script = [sys.executable, str(ROOT / "tools" / "build_native.py"), str(tmp_path)]
    capacities = f"-DZYGOS_MAX_EFFECTS={len(effects)} -DZYGOS_MAX_JOINTS={arm.n}"
    subprocess.run(script, env={**os.environ, "CFLAGS": capacities}, check=True)
    monkeypatch.setattr(flight, "_FOLDER", tmp_path)
    for name, value in zip(("ffi", "lib"), flight._load(), strict=True):
        monkeypatch.setattr(flight, name, value)
    trajectory = trajectory_of(arm, model, scenario, noise=False, period_s=0.02, duration_s=30.0, rtol=1e-9)
    rooms = same(silent(trajectory.arm), trajectory.cycles(), effects)
    assert (rooms[-1].name, rooms[-1].compared) == ("solution", len(arm.parameter_names) + len(effects))


def test_no_effects_no_difference(tmp_path: Path) -> None:
    """The columns of the others have the same bits with effects and without."""
    arm = make_arm(tmp_path)
    cycles = balanced(arm, sines(arm, 500), chosen(arm))
    plain, more = Flight(arm), Flight(arm, [effect("cubic_stiffness", "joint1"), effect("torque_lag", "joint2")])
    without, with_them = plain.cycles(cycles, trace=True), more.cycles(cycles, trace=True)
    assert without is not None and with_them is not None
    np.testing.assert_array_equal(without.row, np.delete(with_them.row, [12, 13], axis=1))


def test_integrals_begin_with_the_arc(tmp_path: Path) -> None:
    """Also with one that follows another without a gap; the energy of a spring is a state and has no beginning."""
    arm = replace(make_arm(tmp_path), arc_max_s=2.0)
    cycles = balanced(arm, sines(arm, 500), chosen(arm))
    effects = [effect(key, "joint2") for key in ("motor_viscous", "link_coulomb", "torque_lag", "cubic_stiffness")]
    trace = Flight(arm, effects).cycles(cycles, trace=True)
    assert trace is not None
    rows = trace.row[trace.instant]
    origins = np.arange(0, len(rows), 100)
    friction = rows[:, [12, 13]]
    assert (friction[origins] == 0.0).all()
    assert (np.delete(friction, origins, axis=0) > 0.0).all()
    assert (rows[:, 15] > 0.0).all()
    np.testing.assert_allclose(rows[:, 15], rows[:, 10] ** 2, rtol=1e-12)  # (d^2 / 2)^2
    now = 50.0 * np.diff(cycles.tau[:, 1], prepend=0.0)[trace.cycles.sync[trace.instant] - 1 - arm.smoother.lag]
    half = 0.5 * now * trace.state[trace.instant][:, 7]
    np.testing.assert_allclose(rows[origins, 14], half[origins], rtol=1e-9, atol=1e-12)


# ---------------------------------------------------------------- estimates


def estimate_of(arm: Arm, cycles: Cycles, effects: Sequence[Effect]) -> flight.Estimate:
    run = Flight(arm, effects)
    run.frames(encode(arm, cycles))
    return run.estimate()


@pytest.mark.slow
def test_friction_at_the_elbow_is_found() -> None:
    """With the paper's noise, through frames; without the column the balance does not close."""
    arm, model, scenario = lively()
    friction = effect("motor_coulomb", "elbow", 0.8)
    plant = replace(model, effects=(friction,))
    trajectory = trajectory_of(arm, plant, scenario, seeds=range(3), noise=True)
    for k in range(3):
        blind = estimate_of(arm, trajectory.cycles(k), ())
        assert (blind.validity, blind.reason) in {("doubtful", UNCLOSED), ("refused", UNCLOSED)}
        found = estimate_of(arm, trajectory.cycles(k), [replace(friction, value=0.0)])
        assert (found.validity, found.reason) == ("valid", "")
        assert (found.names[-1], found.units[-1]) == ("motor_coulomb2", "Nm")
        assert found.value[-1] == pytest.approx(0.8, rel=0.05)
        assert 0.0 < found.sigma[-1] < 0.05
        assert np.abs(found.value[:-1] / model.base_values(arm) - 1.0).mean() <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("key", COLUMNS)
def test_every_coefficient_is_found_without_noise(key: str) -> None:
    """From the motions with which its column is compared; the lag is 3 ms, whose square the column leaves out."""
    value = 3e-3 if key == "torque_lag" else SIZES[key][0]
    arm, cycles = moved(effect(key, "elbow", value))
    run = Flight(arm, [effect(key, "elbow")])
    run.cycles(cycles)
    found = run.estimate()
    assert (found.validity, found.reason) == ("valid", "")
    assert found.value[-1] == pytest.approx(value, rel=5e-4)
    assert np.abs(found.value[:-1] / lively()[1].base_values(arm) - 1.0).max() <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value"), [("motor_viscous", -0.5), ("cubic_stiffness", -20.0), ("spring_offset", -1.0)]
)
def test_a_plant_that_creates_energy_is_not_physical(key: str, value: float) -> None:
    """A spring may soften all the same."""
    arm, cycles = moved(effect(key, "elbow", value))
    run = Flight(arm, [effect(key, "elbow")])
    run.cycles(cycles)
    found = run.estimate()
    assert found.value[-1] == pytest.approx(value, rel=0.01)
    assert (found.validity, found.reason) == (("doubtful", NOT_PHYSICAL) if CATALOGUE[key].positive else ("valid", ""))


# ---------------------------------------------------------------- encoders whose zeros are off


def unsure(arm: Arm, joints: Sequence[int] = (0, 1)) -> Arm:
    """The arm file does not vouch for the zeros of these joints' motor encoders."""
    sigma = {i: 1e-3 for i in joints}
    listed = [
        replace(joint, motor_encoder=replace(joint.motor_encoder, zero_sigma_rad=sigma.get(i, 0.0)))
        for i, joint in enumerate(arm.joints)
    ]
    return replace(arm, joints=tuple(listed))


def test_a_zero_that_is_not_vouched_for_gives_its_spring_an_offset() -> None:
    arm, *_ = lively()
    plain = arm.parameter_names
    assert estimated(arm, ()) == ()
    link = replace(arm.joints[1].link_encoder, zero_sigma_rad=1e-6)
    for one in (unsure(arm, [1]), replace(arm, joints=(arm.joints[0], replace(arm.joints[1], link_encoder=link)))):
        assert Flight(one).names == (*plain, "spring_offset2")
        friction = effect("motor_coulomb", "shoulder")
        assert Flight(one, [friction]).names == (*plain, "motor_coulomb1", "spring_offset2")
        # the model may name it itself, and others
        named = [effect("spring_offset", "elbow", 0.3), effect("spring_offset", "shoulder")]
        assert Flight(one, named).names == (*plain, "spring_offset2", "spring_offset1")
    rigid = replace(unsure(arm), joints=tuple(replace(joint, flexible=False) for joint in unsure(arm).joints))
    assert estimated(rigid, ()) == ()
    seven, _ = random_arm(np.random.default_rng(0), 7)
    effects = Flight(unsure(seven, range(7)), [effect("torque_lag", "joint7")]).effects
    assert [one.column(seven) for one in effects] == ["torque_lag7", *(f"spring_offset{i + 1}" for i in range(7))]


@pytest.mark.slow
def test_c_equals_numpy_with_the_offsets_that_an_arm_file_asks_for(tmp_path: Path) -> None:
    arm = unsure(make_arm(tmp_path))
    cycles = balanced(make_arm(tmp_path), sines(arm, 500), chosen(make_arm(tmp_path)))
    for effects in ([], [effect("torque_lag", "joint2")]):
        run = Flight(arm, effects)
        trace = run.cycles(cycles, trace=True)
        assert trace is not None
        chain = reference.chain(arm, cycles, effects)
        assert chain.balance.z.shape[1] == len(run.names) == 14 + len(effects)
        assert [room for room in check_chain(arm, trace, run) if not room.equal] == []


@pytest.fixture(scope="module")
def modern() -> Trajectory:
    """The motion of examples/lively with sensors of today, 20 bits and 200 Hz."""
    _, model, scenario = lively()
    arm = exact_torques(load_arm(LIVELY.parent / "gap" / "arm.toml"))
    return trajectory_of(arm, model, scenario, noise=True, duration_s=24.0,
                         rtol=1e-9, atol=1e-11)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0, 1])
def test_a_motor_encoders_zero_that_is_off_by_a_milliradian(modern: Trajectory, joint: int) -> None:
    """Without the offset it ruins the estimate, what of it is not withheld by a hundred sigmas and more, and the
    balance says so; with it, it costs nothing, and neither does a column where nothing is off."""
    arm, (_, model, _) = modern.arm, lively()
    true, exact = model.base_values(arm), modern.cycles()
    off = replace(exact, theta=exact.theta + 1e-3 * np.eye(2)[joint])
    error, answers = {}, {}
    for name, one, cycles in (
        ("exact", arm, exact), ("exact, with columns", unsure(arm), exact),
        ("off", arm, off), ("off, with columns", unsure(arm), off),
    ):  # fmt: skip
        answers[name] = estimate_of(one, cycles, ())
        error[name] = float(np.nanmax(np.abs(answers[name].value[:12] / true - 1.0)))
    print({name: f"{100.0 * share:.4f} %" for name, share in error.items()})
    blind, found = answers["off"], answers["off, with columns"]
    assert error["off"] >= 1e-3
    assert np.nanmax(np.abs(blind.value - true) / answers["exact"].sigma) >= 100.0
    assert blind.cluster >= 20.0  # four times the limit
    assert {answers["exact"].validity, answers["exact, with columns"].validity, found.validity} == {"valid"}
    assert found.cluster <= 3.0
    assert error["off, with columns"] <= 1.2 * error["exact"] + 1e-5
    assert error["exact, with columns"] <= 1.2 * error["exact"] + 1e-5
    stiffness = true[[arm.parameter_names.index("k1"), arm.parameter_names.index("k2")]]
    expected = -1e-3 * stiffness * np.eye(2)[joint]
    assert found.names[12:] == ("spring_offset1", "spring_offset2")
    assert np.all(np.abs(found.value[12:] - expected) <= 5.0 * found.sigma[12:])


@pytest.mark.slow(only=["1"])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_link_encoders_zero_turns_the_bodies_behind_it(tmp_path: Path, joint: int) -> None:
    """The offset takes what it does to the spring; what the arm then looks like is no planar-symmetric one, but a
    planar one with b_ij = 1 mrad of the a_ij across the joint."""
    arm = energy_only(make_arm(tmp_path))
    cycles = balanced(arm, sines(arm, 800), chosen(arm))
    off = replace(cycles, q=cycles.q + 1e-3 * np.eye(2)[joint])
    flights = [Flight(one) for one in (arm, unsure(arm), replace(unsure(arm), kinetic="planar"))]
    for one in flights:
        one.cycles(off)
    blind, half, found = (one.estimate() for one in flights)
    assert blind.validity != "valid" and min(blind.cluster, half.cluster) > 10.0
    assert found.validity == "valid" and found.cluster < 1.0
    value = dict(zip(found.names, found.value.tolist(), strict=True))
    for name, true in CHOSEN.items():
        assert value[name] == pytest.approx(true, rel=1e-6)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a = CHOSEN[f"a{i}{j}"]
        assert value[f"b{i}{j}"] == pytest.approx(1e-3 * a if i <= joint < j else 0.0, abs=1e-6 * a)


def answer(columns: Floats, work_done: Floats, joints: int = 2, positive: int = 0) -> Any:
    """The solver's answer to rows (n, 12 + effects) that are given to the accumulator itself."""
    work, out, row = ffi.new("zygos_work_t *"), ffi.new("zygos_estimate_t *"), ffi.new("zygos_row_t *")
    sums = ffi.addressof(work, "sums", "energy")
    count = columns.shape[1]
    lib.zygos_accumulator_init(sums, count, lib.ZYGOS_MIN_ARC_INSTANTS_VALUE, 0.02)
    work.sums.config.joints, work.sums.config.effects, work.sums.config.arc_cycles = joints, count - 12, len(columns)
    cannot, can = (
        (lib.ZYGOS_MOTOR_COULOMB, lib.ZYGOS_MOTOR_VISCOUS),
        (lib.ZYGOS_CUBIC_STIFFNESS, lib.ZYGOS_SPRING_OFFSET),
    )
    for e in range(count - 12):
        work.sums.config.effect[e].kind = (cannot if positive >> e & 1 else can)[e // 2]
        work.sums.config.effect[e].joint = e % 2
    lib.zygos_impulse_column_map(ffi.addressof(work, "sums", "config"), ffi.addressof(work.sums.motors, "column_map"))
    for kind in (lib.ZYGOS_MOTOR_ROWS, lib.ZYGOS_MOMENTUM_ROWS):
        lib.zygos_sums_clear(ffi.addressof(work, "sums"), kind)
    for column, done in zip(columns, work_done, strict=True):
        row.column[0:count] = column.tolist()
        row.work = float(done)
        lib.zygos_accumulator_add(sums, row, 1.0)
    work.sums.checksum = lib.zygos_sums_checksum(ffi.addressof(work, "sums"))
    lib.zygos_work_solve(work, out)
    return out


def solved(
    values: Sequence[float],
    noise: float = 1e-2,
    *,
    positive: int = 0,
    size: Mapping[int, float] = MappingProxyType({}),
    joints: int = 2,
    seed: int = 0,
    n: int = 600,
) -> Any:
    """An estimate from random rows of unit columns, given to the accumulator itself: two joints with CHOSEN parameters,
    up to four effects with these values, and white noise on the work. size: of a column, where it is not 1."""
    truth = np.array([*CHOSEN.values(), *values])
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(n, len(truth)))
    columns[:, list(size)] *= list(size.values())
    return answer(columns, columns @ truth + noise * rng.normal(size=n), joints, positive)


def test_an_effect_may_be_zero() -> None:
    """Its sigma then exceeds its value, which is no reason to withhold it or anything else. Chance alone has one that
    cannot be negative beyond three sigmas, as seldom as Student's law says of some 25 blocks."""
    runs, doubtful, wide = 100, 0, 0
    for seed in range(runs):
        out = solved([0.0, 0.0], 1e-4, positive=3, seed=seed)
        assert [out.identifiable[i] for i in range(14)] == [1] * 14
        least = min(out.value[i] / out.sigma[i] for i in (12, 13))
        expected = (lib.ZYGOS_VALID, 0) if least >= -3.0 else (lib.ZYGOS_DOUBTFUL, lib.ZYGOS_REASON_NOT_PHYSICAL)
        assert (out.validity, out.reason) == expected
        doubtful += least < -3.0
        wide += sum(abs(out.value[i]) > out.half95[i] for i in (12, 13))
    assert stats.binomtest(doubtful, 2 * runs, stats.t.sf(3.0, 25)).pvalue > 0.003
    assert stats.binomtest(wide, 2 * runs, 0.05).pvalue > 0.003


@pytest.mark.parametrize(("value", "positive", "physical"), [(-0.01, 1, False), (-0.01, 0, True), (0.01, 1, True)])
def test_a_friction_that_drives_is_not_physical(value: float, positive: int, physical: bool) -> None:
    out = solved([value], 1e-4, positive=positive)
    assert out.value[12] == pytest.approx(value, rel=0.05)
    assert abs(value) > 10.0 * out.sigma[12]
    expected = (lib.ZYGOS_VALID, 0) if physical else (lib.ZYGOS_DOUBTFUL, lib.ZYGOS_REASON_NOT_PHYSICAL)
    assert (out.validity, out.reason) == expected


def test_each_effect_has_its_own_bit() -> None:
    for bit in range(4):
        values = [0.3, 0.3, 0.3, 0.3]
        values[bit] = -0.3
        for positive in range(16):
            doubtful = solved(values, 1e-4, positive=positive, n=200).validity == lib.ZYGOS_DOUBTFUL
            assert doubtful == bool(positive >> bit & 1)


def test_an_effect_that_never_acts_has_no_value() -> None:
    """A column of zeros: the others are as they would be without it."""
    out, without = solved([0.2], size={12: 0.0}, n=300), solved([], n=300)
    assert (out.validity, out.reason) == (lib.ZYGOS_PARTIAL, lib.ZYGOS_REASON_NOT_IDENTIFIABLE)
    assert np.isnan(out.value[12])
    assert np.isnan(out.sigma[12])
    assert [out.identifiable[i] for i in range(13)] == [1] * 12 + [0]
    assert without.validity == lib.ZYGOS_VALID


@pytest.mark.parametrize("size", [1.0, 0.0])
def test_a_blurred_parameter_has_no_value_and_the_others_owe_it_nothing(size: float) -> None:
    """Random columns are independent: without the blurred one the others are the same, but for their noise."""
    out = solved([0.2], 1e-3, size={11: 1e-5, 12: size}, n=300)
    assert (out.validity, out.reason) == (lib.ZYGOS_PARTIAL, lib.ZYGOS_REASON_NOT_IDENTIFIABLE)
    assert [bool(np.isnan(out.value[i])) for i in range(12)] == [False] * 11 + [True]
    truth, value, sigma = (np.array(list(x)[:11]) for x in (CHOSEN.values(), out.value, out.sigma))
    assert np.all(np.abs(value - truth) <= 5.0 * sigma)


def test_what_a_blurred_parameter_can_be_exchanged_for_has_no_value_either() -> None:
    """Columns 3 and 11 differ by less than the noise shows."""
    rng = np.random.default_rng(3)
    truth = np.array(list(CHOSEN.values()))
    columns = rng.normal(size=(600, 12))
    columns[:, 11] = columns[:, 3] + 1e-6 * rng.normal(size=600)
    out = answer(columns, columns @ truth + 1e-4 * rng.normal(size=600))
    assert [i for i in range(12) if np.isnan(out.value[i])] == [3, 11]


def test_effects_alone_are_no_answer() -> None:
    """Every parameter blurred, and one of them gone, so that the others would have their blur to themselves."""
    out = solved([1e5], 5e3, size={0: 0.0}, n=300)
    assert out.validity == lib.ZYGOS_REFUSED
    assert np.isnan(list(out.value)[:13]).all()


def test_more_columns_than_the_build_knows_are_corrupt() -> None:
    for joints in (1, 3):
        out = solved([], joints=joints, n=100)
        assert (out.validity, out.reason) == (lib.ZYGOS_REFUSED, lib.ZYGOS_REASON_CORRUPT)


def test_noise_is_taken_from_every_column_however_often_it_is_computed(arm: Arm) -> None:
    """Where it is computed for one signal in each instant, or for all of them."""
    viscous = (effect("motor_viscous", "elbow"),)
    for every in (1, 2, 5):
        noise = Flight(replace(arm, compensate_every=every), viscous).native
        bias = noise.noise.integral_bias
        assert bias.effect[0] > 0.0 and min(bias.dissipation[i] for i in range(arm.n)) > 0.0
    none = Flight(replace(arm, compensate_every=0), viscous).native
    assert none.noise.integral_bias.effect[0] == pytest.approx(0.0)
