# SPDX-License-Identifier: MIT
"""The balances of the gap search: they close for the true parameters, and every column is what its effect does.

A simulated run with an effect of size eps obeys, with the true base parameters,

    columns of the base parameters . true values - right side = -eps * column of the effect (+ constant of the arc)

on its own trajectory, whatever its size, so that no difference of two diverging motions has to be small. Readings are
exact: the wire's steps of 6e-6 rad would hide what is looked for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gap_support import (
    Dense,
    Floats,
    base_values,
    centred,
    dense,
    effect,
    exact,
    example,
    moved,
    rms,
    true_columns,
)

from zygos.arm import ANGLE_STEP, Encoder
from zygos.balances.quadrature import integral
from zygos.balances.readings import Readings
from zygos.effects import CATALOGUE, Effect, column_name
from zygos.gap import balances
from zygos.gap.balances import Acting, Layout, balance_rows, zero_columns
from zygos.gap.record import followed, smoothed_states
from zygos.native.flight import config_of

BALANCES = ("E", "M1", "M2", "H")
DURATION_S = {-1: 2.0, 0: 2.0, 1: 4.0}
"""Of the runs with an effect at a joint: the elbow moves less."""

CLOSED = {"E": 6e-7, "M1": 3e-6, "M2": 3e-6, "H": 6e-6}
"""What smoother and quadrature leave over, in units of the spread of the largest term of a balance."""

RIGHT = 2.5e-3
"""Share of a column by which it may differ from what its effect does: half a torque step of lag is as much as that."""

SIZE = {
    "motor_coulomb": 0.2,
    "motor_viscous": 0.5,
    "link_coulomb": 5.0,
    "cubic_stiffness": 1000.0,
    "torque_lag": 1e-3,
    "rotor_coupling": 0.0,
    "angular_momentum": 10.0,
}
"""Values in the plant; what they do lies far above what the balances leave over."""

SEEN = {
    "motor_coulomb": "E M", "motor_viscous": "E M", "link_coulomb": "E", "cubic_stiffness": "E M",
    "torque_lag": "E M", "rotor_coupling": "E M H", "angular_momentum": "H",
}  # fmt: skip
"""Balances in which an entry has a column; M is that of its joint."""

PLACES = [(key, i) for key in SIZE for i in ((0, 1) if CATALOGUE[key].at_joint else (-1,))]


def sees(balance: str, key: str, joint: int) -> bool:
    """Whether an entry is to have a column in a balance."""
    return balance[0] in SEEN[key].split() and (balance[0] != "M" or balance == f"M{joint + 1}")


def left_over(table: Dense, *, constant: bool = True) -> Floats:
    """(balances, A, instants) with the true base parameters; about each arc's mean where it has a constant."""
    arm, _, _ = example()
    rest = table.left @ true_columns(arm, base_values()) - table.right
    return centred(rest) if constant else rest


def scale(table: Dense) -> Floats:
    """(balances,) spread of the largest term of each balance."""
    arm, _, _ = example()
    terms = table.left * true_columns(arm, base_values())
    each = np.concatenate([terms, table.right[..., None]], axis=-1)
    return np.asarray(rms(centred(np.moveaxis(each, -1, 0))).max(axis=0), dtype=np.float64)


def table(run: str, *effects: Effect, duration_s: float = 2.0) -> Dense:
    """Balances of a run of the plant with effects."""
    return dense(balance_rows(Layout(example()[0]), exact(moved(run, duration_s, *effects)), base_values()))


def errors(key: str, joint: int) -> dict[str, float]:
    """By balance: how far a column is from what its effect does, as a share of it; where there is no column, what is
    left over as a share of the balance's largest term."""
    arm, _, _ = example()
    seen = table("b", effect(arm, key, joint, SIZE[key]), duration_s=DURATION_S[joint])
    column = seen.left[..., Layout(arm).columns.index(column_name(CATALOGUE[key], joint))]
    size = SIZE[key]
    if key == "rotor_coupling":
        # the model couples by 1, and its coefficient is an inertia
        size = (size - 1.0) * base_values()[arm.parameter_names.index(f"Im{joint + 1}")]
    out = {}
    for k, balance in enumerate(BALANCES):
        # of an angular momentum there is nothing but the constant
        constant = key != "angular_momentum" or balance != "H"
        acts = size * (centred(column[k]) if constant else column[k])
        rest = left_over(seen, constant=constant)[k] + acts
        assert (rms(acts) > 0.0) == sees(balance, key, joint)
        out[balance] = float(rms(rest) / (rms(acts) if sees(balance, key, joint) else scale(seen)[k]))
    print(key, joint + 1, {name: f"{x:.1e}" for name, x in out.items()})
    return out


def proved(key: str, joint: int) -> bool:
    """Whether every column is right, and the balances without one stay closed.

    Where Coulomb friction turns around, rates bend, which a smooth curve does not follow: such balances close less
    well, by far less than a column could explain.
    """
    slack = 8.0 if key.endswith("coulomb") else 1.5
    return all(
        x <= (RIGHT if sees(name, key, joint) else slack * CLOSED[name]) for name, x in errors(key, joint).items()
    )


@pytest.mark.slow
@pytest.mark.parametrize("run", ["a", "b"])
def test_balances_close_for_the_true_parameters(run: str) -> None:
    seen = table(run)
    share = rms(left_over(seen)) / scale(seen)
    print({name: f"{x:.1e}" for name, x in zip(BALANCES, share, strict=True)})
    assert dict(zip(BALANCES, share <= list(CLOSED.values()), strict=True)) == dict.fromkeys(BALANCES, True)
    # without angular momentum H needs no constant
    assert rms(left_over(seen, constant=False)[-1]) <= 1.5 * CLOSED["H"] * scale(seen)[-1]


def test_every_entry_is_listed() -> None:
    arm, _, _ = example()
    # the zeros of its encoders stand for a spring's offset
    assert set(SIZE) == set(SEEN) == {one.key for one in CATALOGUE.values() if one.searched} - {"spring_offset"}
    assert Layout(arm).balances == BALANCES
    assert [(one.kind.key, one.joint) for one in Layout(arm).effects] == PLACES


@pytest.mark.slow
@pytest.mark.parametrize(("key", "joint"), PLACES)
def test_column_is_what_the_effect_does(key: str, joint: int) -> None:
    assert proved(key, joint)


@pytest.mark.parametrize("key", ["motor_coulomb", "cubic_stiffness"])
def test_a_column_that_is_1_percent_off_is_found(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test above sees a broken column: here one of a law that differs from the plant's."""
    law, potential = CATALOGUE[key].law, CATALOGUE[key].potential
    assert law is not None
    broken: Any = replace(
        CATALOGUE[key],
        law=lambda motion, shape: 1.01 * law(motion, shape),
        potential=None if potential is None else lambda x, shape: 1.01 * potential(x, shape),
    )
    monkeypatch.setattr(balances, "CATALOGUE", dict(CATALOGUE) | {key: broken})
    assert not proved(key, 0)


@pytest.mark.slow
def test_effects_add_up() -> None:
    """All torque laws at both joints at once: the columns of one do not depend on the others."""
    arm, _, _ = example()
    sizes = {"motor_coulomb": 0.1, "motor_viscous": 0.3, "link_coulomb": 3.0, "cubic_stiffness": 500.0}
    effects = tuple(effect(arm, key, i, value) for key, value in sizes.items() for i in (0, 1))
    seen = table("b", *effects)
    coefficients = np.zeros(seen.left.shape[-1])
    for one in effects:
        coefficients[Layout(arm).columns.index(one.column(arm))] = one.value
    acts = centred(seen.left @ coefficients)
    rest = left_over(seen) + acts
    assert np.all(rms(rest)[:3] <= 0.003 * rms(acts)[:3])
    assert rms(rest)[3] <= 8.0 * CLOSED["H"] * scale(seen)[3]


@pytest.mark.parametrize("joint", [0, 1])
def test_columns_of_zeros_are_what_the_closed_form_says(joint: int) -> None:
    """The columns are differences of balances; here they are derived by hand, for a planar arm."""
    arm, _, _ = example()
    base, plain = base_values(), exact(moved("b", 2.0))
    value = dict(zip(arm.parameter_names, base.tolist(), strict=True))
    state = smoothed_states(arm, plain)
    f, phi, i = state.f, state.phi, joint
    k = value[f"k{i + 1}"]
    gained, turning, locked = (np.zeros_like(state.base) for _ in range(3))
    for a in range(arm.n + 1):
        for b in range(a, arm.n + 1):
            # turned as one piece, the arm has this inertia
            locked += value[f"a{a}{b}"] * (1 if a == b else 2) * np.cos(phi[..., b] - phi[..., a])
            if a <= i < b:
                turned = -value[f"a{a}{b}"] * np.sin(phi[..., b] - phi[..., a])
                gained += turned * f[..., a] * f[..., b]
                turning += turned * (f[..., a] + f[..., b])
    spring = k * (state.theta - state.q)[..., i]
    pushed = k / arm.gear_ratios[i] * arm.period_s * np.arange(f.shape[-2]) * np.ones_like(state.base)
    seen = dense(balance_rows(Layout(arm), plain, base)).left
    none = np.zeros_like(locked)
    rotor = value[f"Im{i + 1}"]
    wanted = {
        f"link_zero{i + 1}": {"E": spring - gained, f"M{i + 1}": pushed, "H": -turning},
        f"motor_zero{i + 1}": {"E": -spring, f"M{i + 1}": -pushed},
        "gyro_bias": {"H": -locked, f"M{i + 1}": np.full_like(locked, -rotor)},
    }
    for name, columns in wanted.items():
        for at, balance in enumerate(BALANCES):
            if name == "gyro_bias" and balance not in columns:
                continue
            got = seen[at, ..., Layout(arm).columns.index(name)]
            want = columns.get(balance, none)
            print(name, balance, float(rms(got - want)), float(rms(want)))
            assert rms(centred(got - want)) <= 1e-5 * rms(want) + 1e-5
            assert balance != "H" or rms(got - want) <= 1e-5 * rms(want) + 1e-5


def test_columns_of_errors_that_are_known_are_not_computed_again() -> None:
    arm, _, _ = example()
    plain, base, known = exact(moved("b", 2.0)), base_values(), {}
    first = zero_columns(Layout(arm), plain, base, known=known)
    usual = list(Layout(arm).zeros)
    assert list(known) == usual
    # another layout of the same arm has more of them
    wide = Layout(arm, wide=True)
    more = zero_columns(wide, plain, base, known=known)
    listed = [*(one.name for one in wide.sensors), *usual]
    assert set(known) == set(listed)
    assert len(listed) > len(usual)
    for few, all_of_them, again in zip(first, more, zero_columns(wide, plain, base), strict=True):
        np.testing.assert_array_equal(all_of_them, again)
        np.testing.assert_array_equal(all_of_them[..., len(listed) - len(usual) :], few)
    known[usual[0]] = [7.0 + 0.0 * own for own in known[usual[0]]]
    assert all(np.all(own[..., 0] == 7.0) for own in zero_columns(Layout(arm), plain, base, known=known))


@pytest.mark.parametrize(
    ("key", "size"),
    [("gyro_scale", 0.05), ("link_scale", 0.05), ("link_eccentricity_sin", 0.02), ("motor_eccentricity_sin", 2e-4)],
)
def test_a_large_error_of_a_sensor_has_the_column_of_its_size(key: str, size: float) -> None:
    """Readings with the error and so much of its column leave what exact readings leave; to first order they do not."""
    arm, _, _ = example()
    base, plain = base_values(), exact(moved("b", 2.0))
    joint = 0 if CATALOGUE[key].at_joint else -1
    one = Acting(CATALOGUE[key], joint)
    layout = Layout(arm, own=(one,))
    wrong = one.kind.transform(arm, plain, joint, size)
    true = np.zeros(len(layout.columns))
    true[: len(base)] = base
    column, missed = layout.columns.index(one.name), []

    def left(readings: Readings, share: float, sizes: dict[str, float]) -> Floats:
        seen = dense(balance_rows(layout, readings, base, sizes=sizes))
        true[column] = share
        return centred(seen.left @ true - seen.right)

    still = left(plain, 0.0, {})
    acts = rms(left(wrong, 0.0, {}) - still)
    for sizes in ({}, {one.name: size}):
        rest = rms(left(wrong, size, sizes) - still)
        missed.append(float(np.max(rest[acts > 0.0] / acts[acts > 0.0])))
    print(key, missed)
    assert missed[1] < 1e-5
    assert missed[0] > 1e-2


@pytest.mark.parametrize(("key", "joint"), [(k, i) for k, i in PLACES if "coulomb" in k or "viscous" in k])
def test_friction_only_takes_energy(key: str, joint: int) -> None:
    """Its energy column never falls: a positive coefficient can only dissipate."""
    arm, _, _ = example()
    assert CATALOGUE[key].positive
    for run in "ab":
        column = table(run).left[0, ..., Layout(arm).columns.index(column_name(CATALOGUE[key], joint))]
        lost = np.diff(column)
        assert column[0, 0] == 0.0 < column[0, -1]
        # the cubic through four values of |rate| may dip where the rate changes its sign
        assert lost.min() >= -0.1 * lost.mean()


def test_a_lag_of_a_period_is_the_torque_of_the_cycle_before() -> None:
    """In the motors' impulse: both are a matter of the torque alone."""
    arm, _, _ = example()
    plain, base = exact(moved("b", 2.0)), base_values()
    late = replace(plain, tau=np.concatenate([0.0 * plain.tau[:, :1], plain.tau[:, :-1]], axis=1))
    seen, delayed = dense(balance_rows(Layout(arm), plain, base)), dense(balance_rows(Layout(arm), late, base))
    for i in range(arm.n):
        column = Layout(arm).columns.index(f"torque_lag{i + 1}")
        lost = centred(delayed.right[1 + i] - seen.right[1 + i])
        acts = arm.period_s * centred(seen.left[1 + i, ..., column])
        print(f"{rms(lost + acts) / rms(acts):.1e}")
        # to first order in a period, in which the torque changes by some percent
        assert rms(lost + acts) <= 0.05 * rms(acts)


def test_integral_is_exact_for_cubics() -> None:
    """From the third step on, one-sided; trapezoids before, of linear functions exact too."""
    h = 0.1
    t: Floats = h * np.arange(30.0)
    np.testing.assert_allclose(integral(1.0 + 2.0 * t, h), t + t**2, rtol=0, atol=1e-13)
    cubic = 4.0 * t**3 - 3.0 * t**2 + 1.0
    got, want = integral(cubic, h), t**4 - t**3 + t
    np.testing.assert_allclose(np.diff(got)[2:], np.diff(want)[2:], rtol=0, atol=1e-11)


def test_rounding_in_the_frames_counts_for_every_sensor() -> None:
    """In the gap as in flight: of encoders and a gyro finer than the frames, rounding is all the noise there is."""
    arm, _, _ = example()
    fine = tuple(
        replace(joint, link_encoder=Encoder(2.0 * np.pi / 2**24), motor_encoder=Encoder(2.0 * np.pi / 2**24))
        for joint in arm.joints
    )
    arm = replace(arm, joints=fine, imu=replace(arm.imu, rate_sigma=0.0))
    config = config_of(arm)
    assert config.imu_sigma == pytest.approx(2.0**-21 / np.sqrt(12.0), rel=1e-12)
    assert config.joint[0].link_sigma_rad == pytest.approx(ANGLE_STEP / np.sqrt(12.0), rel=0.01)
    angles = ANGLE_STEP * np.random.default_rng(0).uniform(-0.5, 0.5, (1, 500, arm.n))
    readings = Readings(angles, angles, np.zeros((1, 500)), np.zeros_like(angles))
    assert followed(arm, readings).all()
