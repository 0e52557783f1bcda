# SPDX-License-Identifier: MIT
"""Joint rows in the flight library: against numpy's rows, against the bodies that moved, and what an estimate is worth.

The rows' columns are derived in numpy from the energy (test_joint_rows.py); motions and torques are Pinocchio's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_support import arm_of_known_lengths, exact_torques, random_arm
from flight_support import part, symmetric
from motion_support import FLEXIBLE, laboratory, random_ground, sines
from numpy.typing import NDArray
from runs_support import trajectory_of

from zygos.arm import Arm, load_arm
from zygos.balances.joint import joint_rows
from zygos.effects import Effect, effect
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native.flight import Flight, config_of, encode, ffi, lib
from zygos.reference.compare import check_frames
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[2] / "examples"
KINDS = list(product((1, 2, 3, 7), ("free", "fixed"), ("spatial", "planar", "planar-symmetric"), FLEXIBLE))


def rows_of(arm: Arm, cycles: Cycles, effects: tuple[Effect, ...] = ()) -> tuple[Floats, Floats, Floats]:
    """Columns (m, N, c) before they are reduced, right sides (m, N) and whether they count (m,), cycle by cycle."""
    flight = Flight(arm, effects)
    native, count = flight.native, flight.native.sums.column_map.count
    found: list[tuple[Floats, float, float]] = []
    for k in range(len(cycles)):
        turn, complete = native.joint.turn, native.joint.halves == 3
        flight.cycles(part(cycles, k, k + 1))
        if complete and turn < arm.n and native.joint.turn == turn + 1:
            row = native.joint_row
            assert row.joint == turn
            found.append((np.array(list(row.column)[:count]), row.impulse, row.accepted))
    m = len(found) // arm.n * arm.n
    z, w, accepted = (np.array(x) for x in zip(*found[:m], strict=True))
    return z.reshape(-1, arm.n, count), w.reshape(-1, arm.n), accepted.reshape(-1, arm.n)[:, 0]


@pytest.mark.slow(but=["2-*"])
@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), KINDS)
def test_rows_are_numpys(joints: int, base: str, kinetic: str, kind: str) -> None:
    """Of any motion with any torques, with a gap."""
    arm, _ = random_arm(joints, joints, base, kinetic, [FLEXIBLE[kind](i) for i in range(joints)])  # type: ignore[arg-type]
    assert not arm.structure.reduces
    arm = replace(arm, joint_increment_s=0.06)
    keys = ("motor_coulomb", "link_coulomb", "torque_lag", "motor_viscous", "torque_offset", "viscous_asymmetry")
    effects = [effect(key, joint.name) for key in keys for joint in arm.joints[-2:]]
    springs = [joint.name for joint in arm.joints if joint.flexible][:1]
    effects += [effect(key, name) for key in ("cubic_stiffness", "spring_offset") for name in springs]
    cycles = sines(arm, 300)
    cycles.sync[170:] += 3
    z, w, accepted = rows_of(arm, cycles, tuple(effects))
    samples = calibrate(arm, cycles)
    expected = joint_rows(arm, samples, smooth(arm, samples), 0.06, effects)
    m = len(z)
    assert 10 <= expected.count - 1 <= m <= expected.count
    scale = np.maximum(np.abs(expected.z).max(axis=(0, 1)), 1e-300)
    np.testing.assert_allclose(z / scale, expected.z[:m] / scale, rtol=0, atol=1e-12)
    np.testing.assert_allclose(w, expected.w[:m], rtol=0, atol=1e-12 * np.abs(expected.w).max())
    np.testing.assert_array_equal(accepted > 0.0, expected.accepted[:m])


@pytest.mark.slow(but=["1-*", "3-*"])
@pytest.mark.parametrize(
    ("joints", "kinetic"), [(1, "planar"), (2, "planar-symmetric"), (3, "spatial"), (7, "spatial")]
)
def test_rows_balance_for_the_bodies_that_moved(joints: int, kinetic: str) -> None:
    """A fixed base, rigid joints, Pinocchio's torques: nothing is left but the trapezoid of the sampled torques."""
    known = random_ground(joints, kinetic, 1500)
    z, w, _ = rows_of(known.arm, known.cycles())
    assert len(z) >= 50
    left = np.abs(z @ known.true - w)
    assert (left.max(axis=0) <= 5e-4 * np.sqrt((w**2).mean(axis=0))).all()


@pytest.mark.slow(but=["lively*"])
@pytest.mark.parametrize(("example", "period_s"), [("lively", 0.01), ("spatial", 0.005)])
def test_rows_balance_for_springs_that_moved(example: str, period_s: float) -> None:
    """A free base, flexible joints, torques that are held; the right side is 0, its terms are not."""
    folder = EXAMPLES / example
    arm, model = exact_torques(load_arm(folder / "arm.toml")).at_period(period_s), load_model(folder / "model.toml")
    arm = replace(arm, joint_increment_s=0.2)
    run = trajectory_of(
        arm, model, load_scenario(folder / "scenario.toml"), noise=False, duration_s=6.0, rtol=1e-10, atol=1e-12
    )
    z, w, accepted = rows_of(arm, run.cycles())
    terms = z * model.base_values(arm)
    np.testing.assert_array_equal(w, 0.0)
    left, size = terms.sum(axis=-1)[accepted > 0.0], np.abs(terms).max(axis=-1)[accepted > 0.0]
    assert len(left) >= 40
    assert (np.abs(left).max(axis=0) <= 2e-3 * size.max(axis=0)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["UR10e", "Panda", "LWR4+"])
def test_an_arm_on_the_ground_from_frames(name: str) -> None:
    """Every stage is numpy's; every parameter, friction and offset has a value, and those are as right as they say."""
    known = laboratory(name, 7500)
    offset = 0.01 * np.arange(1, known.arm.n + 1) * (-1.0) ** np.arange(known.arm.n)
    true = known.true + np.concatenate([np.zeros(len(known.true) - known.arm.n), offset])
    flight = Flight(known.arm, known.effects)
    rooms = check_frames(known.arm, encode(known.arm, known.cycles(0, offset)), flight)
    assert [room.name for room in rooms if not room.equal] == []
    assert {"joint rows", "sigmas", "solution"} <= {room.name for room in rooms}
    estimate = flight.estimate()
    assert (estimate.validity, estimate.reason) == ("valid", "")
    assert np.isfinite(estimate.value).all()
    assert 0.3 <= estimate.cluster <= 1.5
    assert 0.9 <= estimate.noise_ratio <= 1.1
    off = np.abs(estimate.value - true) / estimate.half95
    # 58 values or more, with few degrees of freedom: chance leaves 5 % outside of their intervals
    assert np.mean(off > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(off))
    assert off.max() <= 4.0


@pytest.mark.slow
def test_torque_noise_leaves_the_balance_closed_and_a_constant_torque_does_not() -> None:
    known = random_ground(6, "spatial", 7500)
    rms = np.sqrt((known.tau**2).mean(axis=0))
    for share, declared in ((0.01, False), (0.05, False), (0.05, True), (0.5, False)):
        sigma = [float(share * size) for size in rms]
        noisy = replace(
            known.arm,
            joints=tuple(replace(j, torque_sigma=s) for j, s in zip(known.arm.joints, sigma, strict=True)),
        )
        cycles = replace(known, arm=noisy).cycles(0)
        flight = Flight(noisy if declared else known.arm)
        flight.cycles(cycles)
        estimate = flight.estimate()
        assert estimate.cluster <= 1.5, share
        assert not estimate.reason.startswith("the balance"), share
        if share <= 0.05:
            assert np.isfinite(estimate.value).sum() >= 70
    flight = Flight(known.arm)
    flight.cycles(known.cycles(0, offset=0.05))
    estimate = flight.estimate()
    assert estimate.cluster >= 5.0
    assert estimate.reason == "the balance does not close: what the solution leaves over is no noise"
    assert estimate.validity == "doubtful"


def test_noise_of_the_rates_is_what_a_sample_of_it_shows() -> None:
    """Squares of noisy rows less those of exact ones, on average over draws, for every pair of columns."""
    known = random_ground(2, "spatial", 1000)
    arm = replace(known.arm, compensate_every=1)
    sigma = (
        arm.joints[0].motor_encoder.sigma_rad * 40.0
    )  # 40 times the noise, so that products with the signal are small
    encoder = replace(arm.joints[0].motor_encoder, quantum_rad=sigma * np.sqrt(12.0))
    arm = replace(arm, joints=tuple(replace(j, link_encoder=encoder, motor_encoder=encoder) for j in arm.joints))
    draws, p = 60, len(arm.parameter_names)
    samples = calibrate(arm, known.cycles())
    exact = joint_rows(arm, samples, smooth(arm, samples), arm.joint_row_s).z.reshape(-1, p)
    excess = np.zeros((draws, p, p))
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        q = samples.q + sigma * rng.normal(size=samples.q.shape)
        noisy = replace(samples, q=q, theta=q)
        off = joint_rows(arm, noisy, smooth(arm, noisy), arm.joint_row_s).z.reshape(-1, p) - exact
        excess[seed] = off.T @ off
    flight = Flight(arm)
    flight.cycles(known.cycles())
    flight.estimate()
    rows, columns = np.tril_indices(p)
    packed = noise_of_all(flight)[rows, columns]
    mean, spread = excess.mean(axis=0)[rows, columns], excess.std(axis=0)[rows, columns] / np.sqrt(draws)
    size = np.sqrt(excess.mean(axis=0).diagonal())
    # rows are linear in the rates of kinetic columns and rotors; what angles alone are in has noise of second order
    of_rates = np.array([not name.startswith("G") for name in arm.parameter_names])
    compared = of_rates[rows] & of_rates[columns]
    assert of_rates.sum() >= 9
    # the rows of the last increment are not formed, and one signal stands for three in turn
    pair = size[rows] * size[columns]
    off = np.abs(packed - mean) - 3.0 * spread
    assert (off <= 0.15 * pair)[compared].all()
    np.testing.assert_allclose(packed[(rows == columns) & compared], mean[(rows == columns) & compared], rtol=0.2)


def test_a_run_in_pieces_of_any_length_gives_the_same_sums() -> None:
    """zygos_arm_take() at any time, with a segment half added, sees the same rows."""
    known = random_ground(3, "spatial", 1800)
    whole = Flight(known.arm)
    totals = []
    for stop in range(200, 1800, 37):
        whole.cycles(part(known.cycles(), max(0, stop - 37) if stop > 200 else 0, stop))
        taken = whole.blocks().joints
        totals.append(np.sum([sums for sums, _ in taken], axis=0))
        count = sum(n for _, n in taken)
        z, w, _ = rows_of(known.arm, part(known.cycles(), 0, stop)) if stop in (200, 1199) else ([], [], [])
        if len(z):
            table = np.concatenate([z, w[..., None]], axis=-1).reshape(-1, z.shape[-1] + 1)
            assert len(table) <= count < len(table) + known.arm.n
    grown = [np.linalg.eigvalsh(b - a)[0] / np.trace(b) for a, b in pairwise(totals)]
    assert min(grown) >= -1e-9  # rows are added, none is lost


def noise_of_all(flight: Flight) -> Floats:
    """What the estimate that was made last knows of the noise of joint rows, (p, p). Nothing else tells of it."""
    sums = flight._work.sums.joints
    return symmetric(sums.noise.gram, sums.width)[:-1, :-1]


@pytest.mark.slow(but=["2-*", "3-*"])
@pytest.mark.parametrize(("joints", "lost"), [(2, 0), (3, 1), (4, 3)])
def test_rows_that_wait_are_in_the_sums_whatever_was_added_of_them(joints: int, lost: int) -> None:
    """After every cycle, also where a gap loses the last rows of an increment: those before it stay. Void cycles drop
    the segment that is filled."""
    known = random_ground(joints, "spatial", 450)
    cycles = known.cycles(0)
    flight, noisy = (Flight(replace(known.arm, compensate_every=every)) for every in (0, 1))
    native, p = flight.native, len(flight.names)
    weight, rows, noise, formed = np.ones(joints), np.zeros((p + 1, p + 1)), np.zeros((p + 1, p + 1)), 0
    broken = lost == 0

    def total(of: Flight) -> Floats:
        return np.asarray(sum(sums for sums, _ in of.blocks().joints))

    for k in range(len(cycles)):
        turn, complete = native.joint.turn, native.joint.halves == 3
        gap = complete and turn == lost and not broken
        if gap:
            cycles.flags[k] = BREAK_BEFORE
            broken = True
        for one in (flight, noisy):
            one.cycles(part(cycles, k, k + 1))
        forms = complete and turn < joints and not gap
        if forms:
            z = np.append(list(native.joint_row.column)[:p], native.joint_row.impulse) * native.joint_row.accepted
            if weight[turn] == 1.0 and z.any():  # the first row of a joint tells what weighs its rows
                weight[turn] = np.sqrt((total(flight) - rows)[-1, -1] / z[-1] ** 2)
            rows = rows + np.outer(z, z) * weight[turn] ** 2
            formed += 1
        elif k % 9:
            continue
        found, before = total(flight), noise
        noise = found - total(noisy)
        size = np.sqrt(np.diag(rows)) + 1e-150
        assert np.max(np.abs(found - rows) / np.outer(size, size)) <= 1e-12
        if forms:
            assert np.trace(noise) > np.trace(before)
        else:
            np.testing.assert_allclose(noise, before, rtol=1e-6, atol=1e-9 * np.trace(rows))
    assert formed > 8 * joints and broken
    void = part(known.cycles(0), 0, 1)
    void.sync[0], void.flags[0] = len(cycles) + 1, BREAK_BEFORE | VOID_BEFORE | 5 << VOID_SHIFT
    flight.cycles(void)
    assert sum(count for _, count in flight.blocks().joints) == 0.0


def test_void_cycles_drop_the_segment_that_is_filled_and_no_other() -> None:
    known = random_ground(2, "spatial", 1800)
    cycles = known.cycles()
    flight = Flight(known.arm)
    flight.cycles(part(cycles, 0, 1500))
    before = sum(count for _, count in flight.blocks().joints)
    cycles.flags[1500] = BREAK_BEFORE | VOID_BEFORE | 5 << VOID_SHIFT
    flight.cycles(part(cycles, 1500, 1501))
    after = sum(count for _, count in flight.blocks().joints)
    assert 0.6 * before < after < before


def test_blocks_are_the_groups_that_have_rows() -> None:
    """At the beginning fewer groups have rows than there is room for."""
    known = random_ground(3, "spatial", 3000)
    flight, told = Flight(known.arm), []
    for begin in range(0, 3000, 300):
        flight.cycles(part(known.cycles(), begin, begin + 300))
        blocks = flight.estimate().blocks
        groups = [count for _, count in flight.blocks().joints]
        told.append((blocks, sum(count > 0.0 for count in groups), len(groups)))
    print(told)
    assert all(blocks == filled for blocks, filled, _ in told)
    assert 0 < told[0][0] < told[0][2]


@pytest.mark.slow
def test_forgetting_fades_the_groups() -> None:
    """The same record twice: with a memory the second half counts more."""
    known = random_ground(3, "spatial", 6000)
    arm = replace(known.arm, memory_s=5.0, arc_max_s=2.0)
    flight, lasting = Flight(arm), Flight(replace(arm, memory_s=None))
    for one in (flight, lasting):
        one.cycles(known.cycles())
    count, all_rows = (sum(n for _, n in one.blocks().joints) for one in (flight, lasting))
    half_s = 0.5 * arm.joint_row_s
    expected = 3 * 5.0 / half_s * (1.0 - np.exp(-6000 * arm.period_s / 5.0))
    assert abs(count / expected - 1.0) <= 0.25  # a segment of 2 s counts as a whole
    assert all_rows >= 3.0 * count
    # weight falls to 1/e in 5 s: the energy of the right side agrees with a sum of the rows with these weights
    _, w, _ = rows_of(known.arm, known.cycles())
    age = half_s * np.arange(len(w))[::-1]
    weighed = float(np.sum(np.exp(-age / 5.0)[:, None] * w**2))
    total = float(sum(sums[-1, -1] for sums, _ in flight.blocks().joints))
    assert abs(total / weighed - 1.0) <= 0.3


def test_a_configuration_that_does_not_fit_is_refused() -> None:
    arm = random_ground(3, "spatial", 1500).arm
    config = config_of(arm)
    state = ffi.new("zygos_arm_t *")
    for cycles in (7, 6, 49, 2_000_000):
        config.joint_row_cycles = cycles
        assert lib.zygos_arm_init(state, config) == lib.ZYGOS_E_ARC
    config.joint_row_cycles = 0
    config.arc_cycles = 0
    assert lib.zygos_arm_init(state, config) == lib.ZYGOS_E_ARC
    config.joint_row_cycles = 50
    assert lib.zygos_arm_init(state, config) == 1
    config.joint[1].torque_sigma = -1.0
    assert lib.zygos_arm_init(state, config) == lib.ZYGOS_E_VALUE
    with pytest.raises(ZygosError, match=r"joint_rows\.increment_s is shorter than 8 cycles"):
        Flight(replace(arm, joint_increment_s=0.02))


@pytest.mark.slow
def test_energy_rows_can_be_left_out_where_joint_rows_suffice() -> None:
    known = random_ground(3, "spatial", 6000)
    answers = []
    for arc_cycles in (0, 15000):
        state, work, out = (ffi.new(f"{name} *") for name in ("zygos_arm_t", "zygos_work_t", "zygos_estimate_t"))
        config = config_of(known.arm)
        config.arc_cycles = arc_cycles
        assert lib.zygos_arm_init(state, config) == 1
        flight = Flight(known.arm)
        flight.native = state
        flight.cycles(known.cycles(0))
        lib.zygos_arm_take(state, work)
        assert lib.zygos_work_solve(work, out) == 1
        answers.append(list(out.value)[: out.parameters] + list(out.sigma)[: out.parameters])
        assert lib.zygos_arm_adopt(state, out) == 1
        lib.zygos_arm_take(state, work)
        assert lib.zygos_work_solve(work, out) == 1
        assert np.isnan(list(work.solver.newest.deviation)).all()
    np.testing.assert_array_equal(*answers)


def test_the_scale_of_the_groups_takes_a_degree_of_freedom() -> None:
    """Without energy rows it comes from the groups themselves; two degrees are left in any case."""
    known = random_ground(3, "spatial", 6000)
    flight = Flight(known.arm)
    flight.cycles(known.cycles())
    estimate = flight.estimate()
    assert estimate.validity != "refused"
    p = len(estimate.value)
    assert flight._work.solver.joints_alone
    first, second = (np.array(list(row[0:p])) for row in flight._work.solver.information)
    expected = np.maximum(first**2 / second - 1.0, 2.0)
    assert (expected > 2.0).sum() >= 3
    np.testing.assert_allclose(list(flight._work.solver.degrees_of_freedom[0:p]), expected, rtol=1e-12)


def test_a_sigma_is_compared_with_the_largest_moment_or_the_parameter_itself() -> None:
    """Of the moments of the bodies, which gravity tells, the largest counts for all, and for nothing behind them."""
    known = random_ground(3, "spatial", 6000)
    flight = Flight(known.arm)
    flight.cycles(known.cycles())
    assert flight.estimate().validity != "refused"
    work = flight._work
    columns, p = work.sums.column_map, work.sums.column_map.parameters
    assert columns.kinetic < columns.body < p == columns.count
    size, solution = np.array(list(work.solver.size[0:p])), np.abs(list(work.solver.solution[0:p]))
    moments, behind = slice(columns.kinetic, columns.body), slice(columns.body, p)
    np.testing.assert_array_equal(size[moments], solution[moments].max())
    np.testing.assert_array_equal(size[behind], solution[behind])


def reduced(arm: Arm, matrix: Floats) -> int:
    """What zygos_arm_init() says of a matrix (columns, parameters), its entries in order."""
    config = config_of(replace(arm, joint_increment_s=None))
    columns, parameters = np.nonzero(matrix)
    config.reduced, config.reductions = matrix.shape[1], len(columns)
    for entry, column, parameter in zip(config.reduction, columns.tolist(), parameters.tolist(), strict=False):
        entry.column, entry.parameter, entry.factor = column, parameter, matrix[column, parameter]
    return int(lib.zygos_arm_init(ffi.new("zygos_arm_t *"), config))


def test_values_of_columns_are_those_of_the_matrix_whatever_stood_in_their_place() -> None:
    arm, values = arm_of_known_lengths()
    effects = (effect("motor_coulomb", "joint1"), effect("cubic_stiffness", "joint2"))
    config, flight = config_of(arm, effects), Flight(arm, effects)
    columns = flight.native.sums.column_map
    matrix = np.zeros((columns.effects, len(values)))
    for entry in list(config.reduction)[: config.reductions]:
        matrix[entry.column, entry.parameter] = entry.factor
    given, found = np.append(values, [0.3, -2.0]), np.full(columns.count, np.nan)
    lib.zygos_expand(config, ffi.addressof(columns), *(ffi.from_buffer("double[]", one) for one in (given, found)))
    np.testing.assert_allclose(found, np.append(matrix @ values, [0.3, -2.0]), rtol=1e-12, atol=1e-15)


def test_effects_have_their_places_behind_the_independent_parameters() -> None:
    arm, values = arm_of_known_lengths()
    flight = Flight(arm, (effect("motor_coulomb", "joint1"), effect("cubic_stiffness", "joint2")))
    places = flight.native.sums.column_map
    assert places.reduced == len(values) < places.effects
    assert list(places.place)[places.effects : places.effects + 2] == [len(values), len(values) + 1]


def test_which_reductions_are_refused() -> None:
    fixed, _ = random_arm(1, 3, "fixed", "spatial", False)
    mixed, _ = random_arm(1, 3, "fixed", "spatial", [True, False, False])
    free, _ = random_arm(1, 3, "free", "spatial", True)
    unit = np.eye(len(fixed.full_parameters))
    for matrix in (unit, unit[:, :-4], unit + np.eye(len(unit), k=1)):
        assert reduced(fixed, matrix) == 1
    assert reduced(fixed, np.column_stack([unit, unit[:, 0]])) == lib.ZYGOS_E_REDUCTION  # more parameters than columns
    assert reduced(fixed, unit * np.where(np.arange(len(unit)) == 3, 0.0, 1.0)) == lib.ZYGOS_E_REDUCTION  # an empty one
    assert reduced(fixed, np.nan * unit) == reduced(fixed, 1e12 * unit) == lib.ZYGOS_E_REDUCTION
    names = mixed.full_names
    stiffness, unit = names.index("k1"), np.eye(len(names))
    assert reduced(mixed, unit) == 1
    doubled = unit.copy()
    doubled[stiffness, stiffness] = 2.0
    assert reduced(mixed, doubled) == reduced(mixed, np.delete(unit, stiffness, axis=1)) == lib.ZYGOS_E_REDUCTION
    unit = np.eye(len(free.full_parameters))
    assert reduced(free, np.delete(unit, 5, axis=1)) == 1
    assert reduced(free, unit[:, ::-1]) == reduced(free, 0.5 * unit) == lib.ZYGOS_E_REDUCTION
    largest, _ = random_arm(1, 7, "free", "spatial", True)
    assert reduced(largest, np.eye(len(largest.full_parameters))) == 1
    config = config_of(fixed)
    config.reductions = 1
    assert lib.zygos_arm_init(ffi.new("zygos_arm_t *"), config) == lib.ZYGOS_E_REDUCTION


def test_a_reduction_of_more_columns_than_the_build_has_is_refused() -> None:
    """Gravity on a free base, which only changed memory can say, has columns for which there is no room."""
    config = config_of(random_arm(1, 7, "free", "spatial", True)[0])
    config.reduced = config.reductions = 1
    config.reduction[0].column, config.reduction[0].parameter, config.reduction[0].factor = 0, 0, 1.0
    for i in range(config.joints):
        config.joint[i].rigid = 1
    capacity = len(ffi.new("zygos_column_map_t *").place)
    few = lib.zygos_balance_columns(config)
    column_map = ffi.new("zygos_column_map_t *")
    lib.zygos_balance_column_map(config, column_map)
    assert few == column_map.count < capacity
    assert lib.zygos_reduction_check(config) == 1
    config.gravity[2] = -9.81
    assert lib.zygos_balance_columns(config) == few + 2 * config.joints
    config.effects = capacity - lib.zygos_balance_columns(config) + 1
    assert lib.zygos_reduction_check(config) == lib.ZYGOS_E_REDUCTION


def test_sums_are_those_of_the_columns_times_the_matrix() -> None:
    """Energy rows, joint rows and the noise of both, with a reduction of any factors."""
    known = random_ground(3, "spatial", 1500)
    rng = np.random.default_rng(0)
    p = len(known.arm.full_parameters)
    matrix = np.where(rng.uniform(size=(p, p - 6)) < 0.2, rng.normal(size=(p, p - 6)), 0.0) + np.eye(p, p - 6)
    whole, state = Flight(known.arm), ffi.new("zygos_arm_t *")
    config = config_of(known.arm)
    columns, parameters = np.nonzero(matrix)
    config.reduced, config.reductions = p - 6, len(columns)
    for entry, column, parameter in zip(config.reduction, columns.tolist(), parameters.tolist(), strict=False):
        entry.column, entry.parameter, entry.factor = column, parameter, matrix[column, parameter]
    assert lib.zygos_arm_init(state, config) == 1
    fewer = Flight(known.arm)
    fewer.native, fewer.names = state, whole.names[: p - 6]
    for flight in (whole, fewer):
        flight.cycles(known.cycles(0))
    own = np.zeros((p + 1, p - 5))
    own[:-1, :-1], own[-1, -1] = matrix, 1.0

    def close(less: Floats, more: Floats) -> None:
        turned = own[: len(more)].T[: len(less)] @ more @ own[: len(more), : len(less)]
        size = np.sqrt(np.abs(np.diag(turned)))
        assert np.max(np.abs(less - turned) / np.outer(size, size)) <= 1e-9

    a, b = whole.normal_equations()
    c, d = fewer.normal_equations()
    close(c, a)
    np.testing.assert_allclose(d, matrix.T @ b, rtol=1e-9, atol=1e-9 * np.abs(d).max())
    close(fewer.noise(), whole.noise())
    for (less, _), (more, _) in zip(fewer.blocks().joints, whole.blocks().joints, strict=True):
        if less.any():
            close(less, more)


def test_an_increment_with_a_refused_instant_does_not_count() -> None:
    """Jitter of a few cycles, which the bandwidth test refuses."""
    arm = replace(random_arm(2, 2, "fixed", "spatial", False)[0], joint_increment_s=0.06)
    cycles = sines(arm, 400)
    for first in (100, 233):
        cycles.q[first : first + 4] += 1e-2 * np.random.default_rng(first).normal(size=(4, arm.n))
    cycles.theta[:] = cycles.q
    z, _, accepted = rows_of(arm, cycles)
    samples = calibrate(arm, cycles)
    expected = joint_rows(arm, samples, smooth(arm, samples), 0.06)
    assert 4 <= np.count_nonzero(~expected.accepted) <= expected.count - 4
    np.testing.assert_array_equal(accepted > 0.0, expected.accepted[: len(z)])


def sensed_apart(kinetic: str) -> Arm:
    """An arm on a free base with springs, each sensor of which has a noise of its own."""
    arm, _ = random_arm(2, 3, "free", kinetic, [True, False, True])  # type: ignore[arg-type]
    joints = []
    for i, joint in enumerate(arm.joints):
        motor = replace(joint.motor_encoder, quantum_rad=(7 + 2 * i) * 1e-4)
        link = replace(joint.link_encoder, quantum_rad=(3 + i) * 1e-4) if joint.flexible else motor
        joints.append(replace(joint, link_encoder=link, motor_encoder=motor))
    gyro = replace(arm.imu, rate_sigma=5e-3)
    return replace(arm, joints=tuple(joints), imu=gyro, joint_increment_s=0.06, compensate_every=1)


@pytest.mark.slow(but=["spatial"])
@pytest.mark.parametrize("kinetic", ["spatial", "planar"])
def test_sums_of_an_arm_with_springs_on_a_free_base(kinetic: str) -> None:
    """Rows and noise, also that of the gyro and of the rotors behind springs."""
    arm = sensed_apart(kinetic)
    flight = Flight(arm)
    rooms = {room.name: room for room in check_frames(arm, encode(arm, sines(arm, 1300)), flight)}
    assert sum(count for _, count in flight.blocks().joints) >= 60
    assert rooms["joint rows"].equal


@pytest.mark.slow(but=["lively"])
@pytest.mark.parametrize("example", ["lively", "spatial"])
def test_an_estimate_with_joint_rows_beside_energy_rows(example: str) -> None:
    """Their weight is numpy's, and they take away neither validity nor accuracy."""
    folder = EXAMPLES / example
    arm, model = replace(load_arm(folder / "arm.toml"), joint_increment_s=0.4), load_model(folder / "model.toml")
    run = trajectory_of(arm, model, load_scenario(folder / "scenario.toml"), noise=True, duration_s=40.0)
    flight = Flight(arm)
    rooms = check_frames(arm, encode(arm, run.cycles()), flight)
    assert [room.name for room in rooms if not room.equal] == []
    assert {"joint rows", "solution"} <= {room.name for room in rooms}
    estimate = flight.estimate()
    assert flight._work.solver.joints_weight > 0.0
    assert (estimate.validity, estimate.reason) == ("valid", "")
    true = np.append(model.base_values(arm), np.zeros(len(arm.relative_gains)))
    off = np.abs(estimate.value - true) / estimate.half95
    # chance leaves 5 % outside of their intervals
    assert np.mean(off > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(off))
    assert off.max() <= 4.0


def test_a_parameter_whose_place_cannot_be_leads_to_no_other_memory() -> None:
    """Of a rotor behind a spring, whose noise is added to the rows of the joints before it."""
    arm = sensed_apart("spatial")
    flight = Flight(arm)
    cycles = sines(arm, 400)
    flight.cycles(part(cycles, 0, 200))
    pristine = ffi.new("zygos_config_t *", flight.native.sums.config)
    assert lib.zygos_arm_scrub(flight.native, pristine) == 0
    flight.native.sums.column_map.place[flight.native.sums.column_map.joint[2]] = 2**31
    flight.cycles(part(cycles, 200, 400))
    assert lib.zygos_arm_scrub(flight.native, pristine) & lib.ZYGOS_SCRUBBED_TABLES
    assert lib.zygos_arm_scrub(flight.native, pristine) == 0


def test_noise_of_a_rigid_joint_is_that_of_its_motors_encoder() -> None:
    """It has no other, whatever a configuration says of one."""
    arm = sensed_apart("spatial")
    found = []
    for factor in (1.0, 100.0):
        flight, config = Flight(arm), config_of(arm)
        config.joint[1].link_sigma_rad *= factor
        assert lib.zygos_arm_init(flight.native, config) == 1
        flight.cycles(sines(arm, 400))
        flight.estimate()
        found.append(noise_of_all(flight))
    assert found[0].any()
    np.testing.assert_array_equal(*found)


def test_which_configurations_of_joint_rows_are_refused() -> None:
    fixed, _ = random_arm(1, 3, "fixed", "spatial", False)
    unit = np.eye(len(fixed.full_parameters))

    def verdict(change: Callable[[Any], None]) -> int:
        config = config_of(replace(fixed, joint_increment_s=None))
        columns, parameters = np.nonzero(unit)
        config.reduced, config.reductions = len(unit), len(columns)
        for entry, column, parameter in zip(config.reduction, columns.tolist(), parameters.tolist(), strict=False):
            entry.column, entry.parameter, entry.factor = column, parameter, 1.0
        change(config)
        return int(lib.zygos_arm_init(ffi.new("zygos_arm_t *"), config))

    def setting(name: str, value: float) -> Callable[[Any], None]:
        return lambda config: setattr(config, name, value)

    assert verdict(lambda config: None) == 1
    for cycles in (7, 2, 8, 2**20):  # odd, too few steps, no room for three rows, too long
        assert verdict(setting("joint_row_cycles", cycles)) == lib.ZYGOS_E_ARC, cycles
    assert verdict(setting("arc_cycles", 3)) == lib.ZYGOS_E_ARC
    assert verdict(setting("momentum_arc_cycles", 100)) == lib.ZYGOS_E_BASE
    for name, value in (
        *(("torque_sigma", value) for value in (-1.0, np.nan, 1e12)),
        *(("torque_relative_sigma", value) for value in (-1e-9, np.nan, 1.0 + 1e-9)),
    ):
        wrong = verdict(lambda config, n=name, v=value: setattr(config.joint[1], n, v))  # type: ignore[misc]
        assert wrong == lib.ZYGOS_E_VALUE, (name, value)
    assert verdict(setting("reductions", 10**6)) == lib.ZYGOS_E_REDUCTION
    for name, value in (
        ("column", 10**6),
        ("parameter", 10**6),
        ("column", 0),
        ("parameter", len(unit)),
        ("factor", 0.0),
    ):
        change = lambda config, n=name, v=value: setattr(config.reduction[2], n, v)  # noqa: E731
        assert verdict(change) == lib.ZYGOS_E_REDUCTION, (name, value)
