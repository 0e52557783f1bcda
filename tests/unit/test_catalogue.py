# SPDX-License-Identifier: MIT
"""Every column of the catalogue is what its effect does, on three arms.

A motion with an effect of any size obeys, with the true base parameters,

    columns of the base parameters . true values - right side = -size * column of the effect (+ constant)

on its own trajectory, so that no difference of two diverging motions has to be small. The motion comes from the
simulator, at the instants of SYNC without any error. Simulator and column share the law alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from catalogue_support import ARMS, PERIOD_S, arm_of, columns, exact, moved, read, residuals, scales
from runs_support import trajectory_of

from zygos.balances.readings import Readings
from zygos.dynamics.equations import equations
from zygos.effects import (
    CATALOGUE,
    Effect,
    EffectColumn,
    Kind,
    Memory,
    Motion,
    column_named,
    columns_at,
    effect,
    is_column,
    laws,
    load_laws,
)
from zygos.errors import ZygosError
from zygos.model.model import load_model, save_model
from zygos.native.flight import Flight

SHARE = 0.005
"""Size of an effect: what it does is so much of the largest term of the balance that sees it best."""
RIGHT = 1e-2
"""Share of a column by which it may differ from what its effect does."""
HALF_A_STEP = 5e-2
"""The same of a lag, whose column expects a smoothed rate: half of the torque step at an instant shows in it, and
nothing of it in an exact rate (with smoothed readings, `test_gap_balances`)."""
A_KINK = 2e-2
"""The same of a law that jumps where it is largest: within a step, the quadrature does not know when."""
SLIGHT = 0.1
"""A balance that sees less of an effect, in units of its own largest term, than this share of what the best sees, has
to stay closed to `RIGHT` of that."""


QUICK = ("ripple_sin", "gyro_bias", "link_late")


def places(name: str) -> list[EffectColumn]:
    """The last place of every entry that an arm can have, or the first one of those that are tried quickly."""
    arm, _, _ = arm_of(name)
    out = []
    for kind in CATALOGUE.values():
        every = columns_at(arm, kind)
        out += every[:1] if kind.key in QUICK else every[-1:]
    return out


def form(kind: Kind) -> tuple[object, ...]:
    """What decides how an entry's column is made, beside its law; each error of a sensor is a form of its own."""
    own = kind.key if kind.place == "sensor" else ""
    return kind.place, kind.law is None, kind.memory is None, kind.lags, kind.potential is None, own


def cases() -> Iterator[tuple[str, str, EffectColumn]]:
    """Every entry on the first arm that can have it, and one entry of each form of a torque on every arm."""
    known: set[str] = set()
    for name in ARMS:
        keys = list(dict.fromkeys(column.key for column in places(name)))
        first = {form(CATALOGUE[key]): key for key in reversed(keys)}
        for column in places(name):
            kind = CATALOGUE[column.key]
            if column.key not in known or (kind.place != "sensor" and first[form(kind)] == column.key):
                yield name, column.key, column
        known.update(keys)


CASES = list(cases())
SHAPE = {
    "motor_stribeck": 1.0, "link_stribeck": 1.0, "backlash": 1e-4, "ripple_sin": 0.05, "ripple_cos": 0.05,
    "base_leak": 0.701, "detent_sin": 3.0, "detent_cos": 3.0, "body_change": 0.701,
    "motor_dahl": 0.01, "link_dahl": 0.01, "joint_dahl": 1e-3, "motor_maxwell": 0.01, "link_maxwell": 0.01,
    "joint_maxwell": 1e-3, "base_oscillator": 1.0,
}  # fmt: skip
"""Shapes that this motion of 1.6 s excites; any number is a shape."""


def built(name: str, column: EffectColumn, value: float) -> Effect:
    arm, _, _ = arm_of(name)
    joint = arm.joints[column.joint].name if column.joint >= 0 else None
    return Effect(CATALOGUE[column.key], joint, value, shape=SHAPE.get(column.key), component=column.component)


def sized(name: str, column: EffectColumn) -> float:
    """A value that does as much as `SHARE` says."""
    run = moved(name)
    seen = exact(run)
    kind = CATALOGUE[column.key]
    number = kind.components(run.arm).index(column.component)
    each = columns(name, seen, run, kind, column.joint, number, SHAPE.get(column.key))
    scale = scales(name, seen)
    value = SHARE / max(float(np.std(each[key])) / scale[key] for key in each)
    if kind.lags:
        return 0.1 * PERIOD_S
    if kind.place == "sensor":
        # an eccentric motor encoder bends the rate by its gear ratio more
        return min(value, 1e-5 if column.key.startswith("motor_eccentricity") else 1e-4)
    return value


def quick(case: tuple[str, str, EffectColumn]) -> bool:
    return case[0] == "planar free flexible" and case[1] in QUICK and case[2].joint <= 0


@pytest.mark.parametrize(
    ("name", "key", "column"),
    [
        pytest.param(*case, marks=() if quick(case) else pytest.mark.slow, id=f"{case[0]}-{case[2].name}")
        for case in CASES
    ],
)
def test_column_is_what_the_effect_does(name: str, key: str, column: EffectColumn) -> None:
    kind = CATALOGUE[key]
    if key == "angular_momentum":
        run = moved(name, built(name, column, 7.0))
        np.testing.assert_allclose(residuals(name, exact(run))["H"], 7.0, rtol=1e-6)
        return
    value = sized(name, column)
    if kind.place == "rotor":
        value = 0.0
    run = moved(name) if kind.place == "sensor" else moved(name, built(name, column, value))
    seen = exact(run)
    if kind.place == "sensor":
        readings = Readings(seen.state.q, seen.state.theta, seen.state.base, seen.tau)
        number = kind.components(run.arm).index(column.component)
        changed = read(run, kind.transform(run.arm, readings, column.joint, value, number))
        ideal = residuals(name, read(run, readings))
        rest = {key: left - ideal[key] for key, left in residuals(name, changed).items()}
    else:
        rest = residuals(name, seen)
    number = kind.components(run.arm).index(column.component)
    each = columns(name, seen, run, kind, column.joint, number, SHAPE.get(key))
    scale = scales(name, seen)
    if kind.place == "rotor":
        value = -1.0
    right = HALF_A_STEP if kind.lags else A_KINK if key.endswith("stribeck") else RIGHT
    acting = {key: value * column for key, column in each.items()}
    most = max(float(np.std(acts)) / scale[key] for key, acts in acting.items())
    for balance, acts in acting.items():
        # the torque begins with a step at the first instant
        wrong, size = float(np.std((rest[balance] + acts)[3:])), float(np.std(acts[3:]))
        print(balance, f"{wrong / scale[balance] / most:.1e} of {size / scale[balance] / most:.1e}")
        # a balance that hardly sees the effect has to stay closed
        assert wrong <= right * max(size, SLIGHT * most * scale[balance]), balance


# ---------------------------------------------------------------- laws of one's own

OWN = """\
import numpy as np
from zygos.effects import Kind


def cogging(motion, shape):
    return np.sin(shape * motion.angle)


LAWS = [Kind("cogging", "cogging torque", "Nm", "motor", cogging, positive=False, shapes=(6.0, 12.0))]
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "my_laws.py"
    path.write_text(OWN)
    return path


@pytest.mark.slow
def test_a_law_of_ones_own_is_an_entry_within_its_block(own: Path) -> None:
    before = list(CATALOGUE)
    with laws(own) as (kind,):
        assert [*before, "cogging"] == list(CATALOGUE)
        assert len(CATALOGUE) == len(before) + 1
        assert CATALOGUE["cogging"] is kind
        assert column_named("cogging2") == EffectColumn("cogging", 1)
        column = EffectColumn("cogging", 0)
        SHAPE["cogging"] = 12.0
        try:
            test_column_is_what_the_effect_does(ARMS[0], "cogging", column)
        finally:
            del SHAPE["cogging"]
        with pytest.raises(ZygosError, match="two effects 'cogging'"), laws(own):
            pass
    assert list(CATALOGUE) == before
    assert not is_column("cogging2")


def test_a_law_of_ones_own_may_have_a_memory() -> None:
    def bristles(motion: Motion, distance: float) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
        rate = motion.rate[..., None]
        return rate / distance, abs(rate) / (distance * (1.0 + 0.3 * np.exp(-((rate / 0.02) ** 2))))

    own = Kind(
        "motor_lugre",
        "LuGre friction",
        "Nm",
        "motor",
        lambda motion, _: motion.memory[..., 0].real,
        shapes=(1e-3, 1e-2),
        memory=Memory(bristles),
    )
    with laws(own):
        SHAPE[own.key] = 1e-2
        try:
            test_column_is_what_the_effect_does(ARMS[0], own.key, EffectColumn(own.key, 0))
        finally:
            del SHAPE[own.key]


def test_a_model_with_a_law_of_ones_own_is_read_within_its_block(own: Path, tmp_path: Path) -> None:
    _, model, _ = arm_of(ARMS[0])
    with laws(own):
        mine = replace(model, effects=(effect("cogging", "elbow", 0.3, shape=12.0),))
        save_model(mine, tmp_path / "model.toml")
        assert load_model(tmp_path / "model.toml") == mine
    with pytest.raises(ZygosError, match=r"effect\[0\].kind: 'cogging' is not known"):
        load_model(tmp_path / "model.toml")


@pytest.mark.parametrize(
    ("find", "put", "message"),
    [
        ("LAWS", "laws", "states no list LAWS of entries"),
        ("LAWS = [", "LAWS = [3, ", "states no list LAWS of entries"),
        ("def cogging", "def cogging(", "SyntaxError"),
        ("import numpy", "import nunpy", "ModuleNotFoundError"),
        ('"cogging", "cog', '"motor_coulomb", "cog', "there is already an effect 'motor_coulomb'"),
        ('"cogging", "cog', '"cogging2", "cog', "ends with a letter"),
        ('"motor"', '"gear"', "there is no site 'gear'"),
        ("cogging, positive", "positive", "needs the function law"),
    ],
)
def test_a_file_that_is_no_laws_is_refused(own: Path, find: str, put: str, message: str) -> None:
    own.write_text(OWN.replace(find, put))
    with pytest.raises(ZygosError, match=f"{message}.*remedy"):
        load_laws(own)


def test_a_missing_file_of_laws_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="there is no such file; remedy"):
        load_laws(tmp_path / "none.py")


# ---------------------------------------------------------------- what an arm cannot have


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("fixed rigid", effect("base_torque", component="x"), "the base of arm random is fixed"),
        ("fixed rigid", effect("gravity_gradient"), "the base of arm random is fixed"),
        ("planar free flexible", effect("gravity_gradient"), "moves in a plane"),
        ("fixed rigid", effect("backlash", "joint1", shape=1e-3), "the joint is rigid"),
        ("fixed rigid", effect("motor_zero", "joint1"), "has one encoder"),
        ("planar free flexible", effect("gyro_misalignment"), "moves in a plane"),
        ("spatial free flexible", effect("detent_sin", shape=3.0), "moves in space"),
        ("spatial free flexible", effect("gyro_bias"), "has no component ''"),
        ("planar free flexible", effect("gyro_bias", component="x"), "has no component 'x'"),
        ("planar free flexible", Effect(CATALOGUE["motor_stribeck"], "elbow", 0.1), "needs a shape"),
        ("planar free flexible", Effect(CATALOGUE["motor_coulomb"], "elbow", 0.1, shape=1.0), "has no shape"),
    ],
)
def test_what_an_arm_cannot_have_is_refused(name: str, wrong: Effect, message: str) -> None:
    arm, model, _ = arm_of(name)
    with pytest.raises(ZygosError, match=f"{message}.*remedy"):
        equations(arm, replace(model, effects=(wrong,)))


def test_a_gravity_gradient_needs_an_arm_that_knows_where_the_earth_is() -> None:
    arm, model, _ = arm_of("spatial free flexible")
    wrong = replace(model, effects=(effect("gravity_gradient", value=1e-6),))
    equations(arm, wrong)
    lost = replace(arm, nadir=None)
    assert not columns_at(lost, CATALOGUE["gravity_gradient"])
    with pytest.raises(ZygosError, match=r"does not say where the Earth is; remedy: .*state nadir in the arm file"):
        equations(lost, wrong)


@pytest.mark.parametrize("key", [key for key, kind in CATALOGUE.items() if not (kind.flies or kind.gain)])
def test_what_the_flight_library_lacks_is_refused(key: str) -> None:
    arm, _, _ = arm_of(ARMS[0])
    kind = CATALOGUE[key]
    lacking = Effect(kind, "elbow" if kind.at_joint else None, 0.0, shape=SHAPE.get(key))
    with pytest.raises(ZygosError, match=f"the flight library has no column for {key}.*; remedy"):
        Flight(arm, (lacking,))


def test_a_simulated_sensor_reads_what_the_entry_makes_of_it() -> None:
    arm, model, scenario = arm_of(ARMS[1])
    wrong = (effect("link_late", "shoulder", 2e-4), effect("gyro_misalignment", value=0.01, component="y"))
    seen = trajectory_of(arm, replace(model, effects=wrong), scenario, noise=False, seeds=[0], duration_s=0.2)
    plain = seen.cycles().omega @ arm.mount.T
    exact_rate = seen.omega0[0]
    turned = np.cross(exact_rate, [0.0, 0.01, 0.0])
    np.testing.assert_allclose(plain - exact_rate, turned, atol=1e-4 * np.abs(exact_rate).max())
    late = (seen.cycles().q - replace(seen, sensors=()).cycles().q)[:, 1]
    np.testing.assert_allclose(late[5:-5], 2e-4 * seen.qd[0, 5:-5, 1], atol=1e-2 * 2e-4 * np.abs(seen.qd).max())
