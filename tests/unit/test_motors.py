# SPDX-License-Identifier: MIT
"""Motor rows beside those of the energy: whose turn it is, which arcs count, and what weight they have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_support import make_arm
from rows_support import awkward, effect, wandering

from zygos.arm import Arm, Encoder
from zygos.balances import impulse
from zygos.reference.accumulator import Design
from zygos.reference.combination import MotorRows, combine, motors, weight
from zygos.reference.solver import Rows
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth

SLIP, TORQUE = (0.3, -0.5), (2.0, 3.0)
FIRST, LAST = 6, 116
"""Smoothed cycles of 120 behind those that fill the integrals."""


def short(arm: Arm) -> Arm:
    """With motor arcs of 25 instants."""
    return replace(arm, impulse_arc_s=25 * arm.period_s)


def winding(h: float) -> Cycles:
    """120 cycles of a base and links at rest, whose two motors turn at a constant SLIP under a constant TORQUE."""
    zero = np.zeros((120, 2))
    theta = h * np.arange(120)[:, None] * np.array(SLIP)
    omega, flags = np.zeros((120, 3)), np.zeros(120, dtype=np.uint32)
    return Cycles(np.arange(120, dtype=np.uint64), zero, theta, zero + np.array(TORQUE), omega, flags)


def beside(arm: Arm, cycles: Cycles, refused: tuple[int, ...] = ()) -> tuple[MotorRows, ...]:
    """The motor rows of a record of which the smoother refuses the cycles named, and no other."""
    samples = calibrate(arm, cycles)
    instants = smooth(arm, samples)
    return motors(arm, samples, replace(instants, accepted=~np.isin(instants.index, refused)))


def expected(arm: Arm, joint: int, arcs: list[list[int]]) -> Rows:
    """The rows of a joint of `winding` at some cycles of each arc: d = SLIP t, whose integral is SLIP t^2 / 2."""
    names, z, w = list(arm.parameter_names), [], []
    for cycles in arcs:
        t = arm.period_s * np.array(cycles)
        own = np.zeros((len(t), len(names)))
        own[:, names.index(f"k{joint + 1}")] = SLIP[joint] * (t**2 - np.mean(t**2)) / 2.0
        own[:, names.index(f"b{joint + 1}")] = SLIP[joint] * (t - np.mean(t))
        z.append(own)
        w.append(50.0 * TORQUE[joint] * (t - np.mean(t)))
    return Rows.exact(np.concatenate(z), np.concatenate(w))


def assert_rows(found: Rows, known: Rows) -> None:
    assert len(found.w) == len(known.w)
    np.testing.assert_allclose(found.z, known.z, atol=1e-9)  # a constant rate times 50^2 is of that accuracy
    np.testing.assert_allclose(found.w, known.w, atol=1e-12)


def test_joints_take_turns_from_each_arcs_first_instant_on(tmp_path: Path) -> None:
    arm = short(make_arm(tmp_path))
    found = beside(arm, winding(arm.period_s))
    assert [own.joint for own in found] == [0, 1]
    for own in found:
        assert own.arcs == 4  # and 11 instants that are too few for one
        arcs = [list(range(origin + own.joint, origin + 25, 2)) for origin in range(FIRST, LAST - 11, 25)]
        assert_rows(own.rows, expected(arm, own.joint, arcs))


def test_a_refused_instant_has_its_turn_but_no_row(tmp_path: Path) -> None:
    """Five of the first arc are refused, six of the second, which leaves too few of it; arcs do not end at them."""
    arm = short(make_arm(tmp_path))
    refused = (6, 7, 8, 20, 24, *range(40, 46))
    for own in beside(arm, winding(arm.period_s), refused):
        assert own.arcs == 3
        arcs = [
            [at for at in range(origin + own.joint, origin + 25, 2) if at not in refused]
            for origin in (FIRST, FIRST + 50, FIRST + 75)
        ]
        assert_rows(own.rows, expected(arm, own.joint, arcs))


@pytest.mark.parametrize("at", [42, 60, 80])
def test_turns_begin_anew_behind_a_gap(tmp_path: Path, at: int) -> None:
    """Three cycles before a gap fill the window, and six behind it fill window and integrals, as at the start."""
    arm = short(make_arm(tmp_path))
    cycles = winding(arm.period_s)
    cycles.flags[at] = BREAK_BEFORE
    segments = ((FIRST, at - 3), (at + FIRST, LAST + 1))
    spans = [(origin, min(origin + 25, stop)) for start, stop in segments for origin in range(start, stop, 25)]
    for own in beside(arm, cycles):
        arcs = [list(range(start + own.joint, stop, 2)) for start, stop in spans if stop - start >= 20]
        assert own.arcs == len(arcs)
        assert_rows(own.rows, expected(arm, own.joint, arcs))


def test_void_is_the_motor_arc_that_is_open(tmp_path: Path) -> None:
    """Cycles 6 .. 76 before the break are two full arcs and one of 21 instants; 86 .. 116 behind it one, and six."""
    arm = short(make_arm(tmp_path))
    cycles = winding(arm.period_s)
    for flag, arcs in ((BREAK_BEFORE, 4), (BREAK_BEFORE | VOID_BEFORE, 3)):
        cycles.flags[80] = flag
        assert [own.arcs for own in beside(arm, cycles)] == [arcs, arcs]


def test_an_arm_may_go_without(tmp_path: Path) -> None:
    arm = replace(make_arm(tmp_path), impulse_arc_s=0.0)
    assert beside(arm, winding(arm.period_s)) == ()


@pytest.mark.parametrize("every", [None, 0])
def test_columns_and_noise_of_a_rigid_joints_neighbours(every: int | None) -> None:
    """A rigid joint has no rows, and its turn passes; noise is that of one row times their number, or switched off."""
    arm = short(replace(awkward(5, 3, "planar", (True, False, True)), compensate_every=every))
    effects = (effect("torque_lag", "joint3"), effect("link_coulomb", "joint1"), effect("motor_viscous", "joint1"))
    samples = calibrate(arm, wandering(arm, 160))
    instants = smooth(arm, samples)
    instants = replace(instants, accepted=np.ones_like(instants.accepted))
    found = motors(arm, samples, instants, effects)
    assert [own.joint for own in found] == [0, 2]
    names = [*arm.parameter_names, *(one.column(arm) for one in effects)]
    own_names = {0: ["Im1", "k1", "b1", effects[2].column(arm)], 2: ["Im3", "k3", "b3", effects[0].column(arm)]}
    for own in found:
        places = [names.index(name) for name in own_names[own.joint]]
        per_arc = len(range(own.joint, 25, 3))
        assert own.rows.z.shape == (per_arc * own.arcs, len(names))
        assert own.arcs == 6
        assert np.abs(own.rows.z[:, places]).max(axis=0).min() > 0.0
        np.testing.assert_array_equal(np.delete(own.rows.z, places, axis=1), 0.0)
        noise = np.zeros((len(names) + 1, len(names) + 1))
        noise[np.ix_(places, places)] = impulse.impulse_noise(arm, own.joint, effects)
        np.testing.assert_allclose(
            own.rows.noise, 0.0 * noise if every == 0 else per_arc * own.arcs * noise, rtol=1e-12
        )


def with_sigmas(arm: Arm, link: float, motor: float) -> Arm:
    """Encoders of given deviations of their readings over the wire."""

    def encoder(sigma: float) -> Encoder:
        wire = 2.0 * np.pi / 2**20
        return Encoder(quantum_rad=float(np.sqrt(12.0 * sigma**2 - wire**2)))

    joints = tuple(replace(joint, link_encoder=encoder(link), motor_encoder=encoder(motor)) for joint in arm.joints)
    return replace(arm, joints=joints)


def made(arm: Arm, joint: int, arcs: int = 3, seed: int = 0) -> MotorRows:
    """40 rows of a joint without meaning, and noise in its first two columns that are correlated."""
    rng = np.random.default_rng(seed)
    names, p = list(arm.parameter_names), len(arm.parameter_names)
    z, noise = np.zeros((40, p)), np.zeros((p + 1, p + 1))
    places = [names.index(f"{kind}{joint + 1}") for kind in ("Im", "k", "b")]
    z[:, places] = rng.normal(size=(40, 3))
    noise[np.ix_(places[:2], places[:2])] = 40.0 * np.array([[9e-6, 1e-6], [1e-6, 4e-6]])
    return MotorRows(joint, Rows(z, rng.normal(size=40), noise), arcs)


def test_weight_is_the_ratio_of_the_noise_in_a_row(tmp_path: Path) -> None:
    """Of 3 and 4 mrad the deflection has 5 mrad, which stiffness 200 makes a torque of 1 Nm, over 2 s."""
    arm = replace(with_sigmas(make_arm(tmp_path), 3e-3, 4e-3), impulse_arc_s=2.0)
    names = list(arm.parameter_names)
    x = np.zeros(len(names))
    x[[names.index(name) for name in ("a00", "k1", "Im2", "k2")]] = 5.0, 123.0, 0.5, 200.0
    energy = np.zeros((len(names) + 1, len(names) + 1))
    energy[0, 0], energy[-1, -1], energy[0, -1], energy[-1, 0] = 0.04, 3.0, 0.1, 0.1
    of_energy = 25.0 * 0.04 - 2.0 * 5.0 * 0.1 + 3.0
    of_motor = 0.25 * 9e-6 + 2.0 * 0.5 * 200.0 * 1e-6 + 200.0**2 * 4e-6 + (200.0 * 5e-3 * 2.0) ** 2 / 10.0
    assert weight(arm, made(arm, 1), energy, x) == pytest.approx(of_energy / of_motor, rel=1e-9)
    assert weight(arm, made(arm, 1, arcs=2), energy, x) == 0.0
    silent = replace(made(arm, 1), rows=Rows.exact(np.ones((40, len(names))), np.ones(40)))
    exact = with_sigmas(arm, 3e-3, 4e-3)
    exact = replace(
        exact, joints=tuple(replace(j, link_encoder=Encoder(0.0), motor_encoder=Encoder(0.0)) for j in exact.joints)
    )
    assert weight(exact, silent, energy, x) == 0.0


def test_the_estimate_is_that_of_all_rows_by_their_weights(tmp_path: Path) -> None:
    """The weights are those at the estimate by the energy alone; a joint whose arcs are few stays out."""
    arm = replace(with_sigmas(make_arm(tmp_path), 3e-3, 4e-3), impulse_arc_s=0.4)
    p = len(arm.parameter_names)
    rng = np.random.default_rng(3)
    z = rng.normal(size=(400, p))
    w = z @ rng.normal(size=p) + rng.normal(size=400)
    noise = 400.0 * np.diag(np.append(np.full(p, 1e-3), 0.5))
    none = np.zeros(400, dtype=np.int64)
    design = Design(z, w, none, none.astype(np.uint64), 1, 0, 0, noise, 0.0)
    first, second, few = made(arm, 0), made(arm, 1, seed=1), made(arm, 1, arcs=2, seed=2)

    a, b = z.T @ z - noise[:p, :p], z.T @ w
    alone = np.linalg.solve(a, b)
    for own in (first, second):
        factor = weight(arm, own, noise / 400.0, alone)
        assert factor > 0.1
        a += factor * (own.rows.z.T @ own.rows.z - own.rows.noise[:p, :p])
        b += factor * own.rows.z.T @ own.rows.w
    solution = combine(arm, design, (first, second, few), None).solution
    assert solution.noise_scale == 1.0
    np.testing.assert_allclose(solution.x, np.linalg.solve(a, b), rtol=1e-10)
    assert np.abs(solution.x - alone).max() > 1e-2
