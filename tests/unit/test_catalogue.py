"""Every column of the catalogue is what its effect does, on three arms.

A motion with an effect of any size obeys, with the true base parameters,

    columns of the base parameters . true values - right side = -size * column of the effect (+ constant)

on its own trajectory, so that no difference of two diverging motions has to be small. The motion comes from the
simulator, at the instants of SYNC without any error. Simulator and column share the law alone.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from catalogue_support import ARMS, DURATION_S, PERIOD_S, arm_of, columns, exact, moved, read, residuals, scales

from zygos.balances.readings import Readings
from zygos.effects import CATALOGUE, Effect, EffectColumn, Kind, Motion, columns_at, effect, laws, load_laws
from zygos.errors import ZygosError
from zygos.native.flight import Flight

SHARE = 0.005
"""Size of an effect: what it does is so much of the largest term of the balance that sees it best."""
RIGHT = 1e-2
"""Share of a column by which it may differ from what its effect does."""
HALF_A_STEP = 5e-2
"""The same of a lag, whose column expects a smoothed rate: half of the torque step at an instant shows in it, and nothing
of it in an exact rate (with smoothed readings, `test_gap_balances`)."""
SLIGHT = 0.1
"""A balance that sees less of an effect, in units of its own largest term, than this share of what the best sees, has to
stay closed to `RIGHT` of that."""


def places(name: str) -> list[EffectColumn]:
    """First and last place of every entry that an arm can have."""
    arm, _, _ = arm_of(name)
    out = []
    for kind in CATALOGUE.values():
        every = columns_at(arm, kind)
        out += sorted({every[0], every[-1]}) if every else []
    return out


CASES = [(name, column.key, column) for name in ARMS for column in places(name)]
SHAPE = {
    "motor_stribeck": 0.3, "link_stribeck": 0.3, "backlash": 1e-4, "ripple_sin": 0.05, "ripple_cos": 0.05,
    "base_leak": 0.701, "detent_sin": 3.0, "detent_cos": 3.0, "body_change": 0.701,
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
        return 0.02 * PERIOD_S
    if kind.place == "sensor":
        return min(value, 1e-4)
    return value


def quick(case: tuple[str, str, EffectColumn]) -> bool:
    return case[0].startswith("planar") and case[2].joint <= 0


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
    right = HALF_A_STEP if kind.lags else RIGHT
    acting = {key: value * column for key, column in each.items()}
    most = max(float(np.std(acts)) / scale[key] for key, acts in acting.items())
    for balance, acts in acting.items():
        wrong, size = float(np.std(rest[balance] + acts)), float(np.std(acts))
        print(balance, f"{wrong / scale[balance] / most:.1e} of {size / scale[balance] / most:.1e}")
        # a balance that hardly sees the effect has to stay closed
        assert wrong <= right * max(size, SLIGHT * most * scale[balance]), balance
