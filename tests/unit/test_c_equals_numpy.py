"""The flight library against its numpy twin, room by room, over arms that differ in all that an arm file can say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from flight_support import balanced, energy_only
from numpy.typing import NDArray
from scipy.stats import t as student

from zygos import reference
from zygos.arm import Arm, Encoder, Imu, Joint, Smoother, TorqueLaw
from zygos.balances.arcs import arc_cycles
from zygos.native.flight import Flight, Trace, ffi, lib
from zygos.reference.compare import Room, Rounding, check_cycles, rounding, tables
from zygos.reference.noise import instants, moments, spread
from zygos.reference.solver import Rows, explained, scatter, that_stays
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.runs.samples import usable

Floats = NDArray[np.float64]

TURN = 2.0 * np.pi
PERIOD = 0.02
CYCLES = 3000
SIGMA = 4e-5
STEP = 8  # ZYGOS_STEP


@dataclass(frozen=True)
class Case:
    """One arm and one record of it. latch_us: joint, link encoder, motor encoder, gyro."""

    joints: int = 2
    points: int = 7
    order: int = 4
    law: TorqueLaw = "applied_from_sync"
    latch_us: tuple[int, int, int, int] = (0, 0, 0, 0)
    signs: tuple[int, int] = (1, 1)
    zeros: tuple[float, float] = (0.0, 0.0)
    mount: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arc_s: float = 60.0
    damaged: bool = False
    far: bool = False
    """8 turns away from zero, where both lose digits to the size of the angles."""


TURNED = (0.1825741858350554, -0.3651483716701107, 0.5477225575051661, 0.7302967433402214)
LATE = (1500, 700, 2300, 900)
CASES = {
    "plain": Case(),
    "one joint": Case(joints=1, points=5, order=2),
    "three joints": Case(joints=3),
    "5/2": Case(points=5, order=2, law="sampled", latch_us=LATE),
    "11/6": Case(points=11, order=6, law="applied_previous_cycle", latch_us=LATE),
    "15/4": Case(points=15, order=4, latch_us=LATE, arc_s=7.3),
    "previous cycle": Case(law="applied_previous_cycle", arc_s=7.3, damaged=True),
    "sampled": Case(law="sampled", arc_s=7.3, damaged=True),
    "over the end": Case(far=True),
    "turned": Case(signs=(-1, 1), zeros=(0.4, -1.1), mount=TURNED, rpy=(0.3, -1.2, 0.7)),
    "turned back": Case(signs=(1, -1), zeros=(-2.2, 0.3), mount=TURNED, rpy=(1.4, 0.2, 0.0), damaged=True),
    "one joint, all": Case(1, 11, 6, "sampled", LATE, (-1, -1), (0.2, 0.9), TURNED, (0.0, 0.5, 1.0), 7.3, True),
    "two joints, all": Case(2, 15, 4, "applied_from_sync", LATE, (-1, -1), (7.2, 0.9), TURNED, damaged=True),
    "three joints, all": Case(
        3, 7, 4, "applied_previous_cycle", LATE, (-1, 1), (0.2, -0.9), TURNED, (0.2, 0.5, 1.0), 7.3, True
    ),
}


def arm_of(case: Case) -> Arm:
    joint_us, link_us, motor_us, gyro_us = case.latch_us
    joints = []
    for i in range(case.joints):
        # The second joint has its encoders' signs exchanged, so that the joints differ.
        link, motor = case.signs if i != 1 else case.signs[::-1]
        quantum = SIGMA * np.sqrt(12.0)
        joints.append(
            Joint(
                name=f"joint{i + 1}",
                node=i + 3,
                axis=(0.0, 0.0, 1.0),
                frame_rpy=case.rpy if i == 0 else (0.0, 0.0, 0.0),
                gear_ratio=50.0 + 30.0 * i,
                link_encoder=Encoder(quantum, sign=link, zero_rad=case.zeros[0] + i, latch_us=link_us + 100 * i),
                motor_encoder=Encoder(quantum, sign=motor, zero_rad=case.zeros[1] - i, latch_us=motor_us),
                latch_us=joint_us + 200 * i,
            )
        )
    half = case.points // 2
    imu = Imu(9, case.mount, rate_sigma=1e-6, bias_walk=0.0, latch_us=gyro_us)
    arm = Arm(
        name="varied",
        base="free",
        kinetic="planar-symmetric",
        period_s=PERIOD,
        torque_law=case.law,
        torque_at="rotor",
        joints=tuple(joints),
        imu=imu,
        smoother=Smoother(case.points, case.order, half),
        arc_max_s=case.arc_s,
    )
    return energy_only(arm, noise=True)


def parameters_of(arm: Arm) -> Floats:
    """A positive definite (a_ij), and Im, k, b of each joint."""
    rng = np.random.default_rng(arm.n)
    root = np.eye(arm.n + 1) * np.sqrt([24.0, 8.0, 4.0, 2.0][: arm.n + 1]) + 0.2 * rng.normal(size=(arm.n + 1,) * 2)
    a = root @ root.T
    drives = [(0.01, 400.0, 3.0), (0.008, 250.0, 2.0), (0.005, 150.0, 2.5)][: arm.n]
    return np.concatenate([a[np.triu_indices(arm.n + 1)], np.ravel(drives)])


def readings(arm: Arm, link: Floats, motor: Floats, base: Floats) -> Cycles:
    """What the sensors say of link and motor angles (n, N) and of base rates (n, 3) in base axes."""
    links = [joint.link_encoder for joint in arm.joints]
    motors = [joint.motor_encoder for joint in arm.joints]
    flags = np.zeros(len(link), dtype=np.uint32)
    flags[0] = BREAK_BEFORE
    return Cycles(
        sync=np.arange(1, len(link) + 1, dtype=np.uint64),
        q=np.array([e.sign for e in links]) * link + np.array([e.zero_rad for e in links]),
        theta=np.array([e.sign for e in motors]) * motor + np.array([e.zero_rad for e in motors]),
        tau=np.zeros_like(link),
        omega=base @ arm.mount,
        flags=flags,
    )


def record_of(case: Case, arm: Arm) -> Cycles:
    """Sums of sines with torques that balance them, and noise on top."""
    rng = np.random.default_rng(7)
    t = PERIOD * np.arange(CYCLES)[:, None]
    i = np.arange(arm.n)
    link = 0.9 * np.sin((0.91 - 0.13 * i) * t + i) + 0.5 * np.cos((1.73 + 0.21 * i) * t)
    if arm.n == 1:
        link = 0.2 * link + 0.6 * (t - t.mean())  # a single motor can do work only while it turns
    motor = link + 0.05 * np.sin((2.3 + 0.37 * i) * t) + 0.03 * np.cos((1.1 + 0.19 * i) * t + 0.5)
    about = 0.35 * np.sin(0.57 * t + 0.2) + 0.2 * np.cos(1.31 * t)
    across = np.cross(rng.normal(size=3), arm.axis)
    base = about * arm.axis + 0.1 * np.cos(0.8 * t) * across  # a rate across the joint axes has no part in the rows
    whole = replace(arm, arc_max_s=PERIOD * CYCLES)
    cycles = balanced(whole, readings(arm, link, motor, base), parameters_of(arm))
    cycles.q[:] += rng.normal(scale=SIGMA, size=cycles.q.shape)
    cycles.theta[:] += rng.normal(scale=SIGMA, size=cycles.theta.shape)
    cycles.omega[:] += rng.normal(scale=1e-6, size=cycles.omega.shape)
    for position in (40, 411, 1203, 2222):
        cycles.q[position, position % arm.n] += 50.0 * SIGMA  # the bandwidth test refuses the instants around
    if case.far:
        # One joint turns over the end of its encoders' range, the motor a little later than the link.
        for reading, end in ((cycles.q, 1700), (cycles.theta, 1703)):
            reading[:end, -1] += 8.0 * TURN
            reading[end:, -1] -= 8.0 * TURN
    return damage(cycles) if case.damaged else cycles


def damage(cycles: Cycles) -> Cycles:
    """Breaks, invalid cycles, lost cycles, wraps and a void arc."""
    flags, joint = cycles.flags, cycles.q.shape[1] - 1
    flags[300] = BREAK_BEFORE
    flags[[500, 507, 2990]] = INVALID
    flags[530] = BREAK_BEFORE  # few instants in between: an arc too short
    flags[700:760:9] = INVALID  # no instant in between
    cycles.tau[900, 0] = np.nan
    cycles.theta[930, joint] = 2e4
    cycles.sync[1000:] += 3
    cycles.sync[1500:] -= 700
    cycles.q[1700, joint] += 9.0 * TURN
    cycles.theta[1800, joint] -= 9.0 * TURN
    # before blocks of several arcs merge, which are dropped together
    flags[640] = BREAK_BEFORE | VOID_BEFORE
    flags[990] = VOID_BEFORE | 300 << VOID_SHIFT
    return cycles


@dataclass(frozen=True)
class Both:
    """The same record through both."""

    case: Case
    arm: Arm
    cycles: Cycles
    flight: Flight
    trace: Trace
    chain: reference.Chain
    rounds: Rounding
    """At least 1e-12 of each column's largest entry, at the most 1e-9."""


@cache
def both_of(name: str) -> Both:
    case = CASES[name]
    arm = arm_of(case)
    cycles = record_of(case, arm)
    flight = Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    chain = reference.chain(arm, cycles)
    rounds = rounding(arm, chain.samples, tables(arm, chain.samples, chain.smoothed))
    return Both(case, arm, cycles, flight, trace, chain, rounds)


@pytest.fixture(params=CASES)
def both(request: pytest.FixtureRequest) -> Both:
    return both_of(request.param)


def close(c: Floats, numpy: Floats, tolerance: Floats) -> None:
    """Within a share of the largest entry of each column."""
    assert c.shape == numpy.shape
    assert (np.abs(c - numpy) / np.abs(numpy).max(axis=0) <= tolerance).all()


def test_states_and_rows(both: Both) -> None:
    balance, smoothed, lag = both.chain.balance, both.chain.smoothed, both.arm.smoother.lag
    used = np.flatnonzero(usable(both.cycles))
    np.testing.assert_array_equal(both.trace.cycles.sync, both.cycles.sync[used])
    assert len(balance.w) > 1000
    instants = np.flatnonzero(both.trace.instant)
    np.testing.assert_array_equal(used[instants] - lag, balance.index)
    close(both.trace.row[instants], np.column_stack([balance.z, balance.w]), both.rounds.row)
    states = np.hstack([smoothed.q, smoothed.theta, smoothed.qd, smoothed.thetad, smoothed.omega])
    close(both.trace.state[instants], states[np.isin(smoothed.index, balance.index)], both.rounds.state)


def test_bandwidth_verdicts(both: Both) -> None:
    instants = np.flatnonzero(both.trace.instant)
    np.testing.assert_array_equal(both.trace.accepted[instants], both.chain.balance.accepted)
    assert 4 <= np.sum(~both.chain.balance.accepted) < 0.05 * len(instants)


def test_arcs_and_counts(both: Both) -> None:
    work = ffi.new("zygos_work_t *")
    lib.zygos_take(both.flight.native, work)
    lib.zygos_accumulator_end_arc(ffi.addressof(work, "accumulator"), work.cycle)
    sums, design, counts = work.accumulator, both.chain.design, both.flight.counts
    assert (sums.arcs, sums.arcs_dropped) == (design.arcs, design.dropped_arcs)
    assert (sums.accepted, sums.refused) == (len(design.w), design.refused)
    assert counts["wraps"] == both.chain.samples.wraps
    assert counts["invalid"] == np.sum(~usable(both.cycles))
    assert counts["wraps"] == (4 if both.case.damaged else 2 if both.case.far else 0)
    if both.case.damaged:
        assert design.dropped_arcs >= 3
        assert len(both.chain.balance.void) >= 2


def test_what_noise_adds(both: Both) -> None:
    """A closed arc that is dropped later takes a share with it in proportion only: there the two cannot be equal.

    No encoder is heard in the rate of the base, and the gyro is so quiet that neither counts it.
    """
    noise, expected = both.flight.noise(), both.chain.design.noise
    size = np.sqrt(np.diag(expected))
    columns = np.linalg.norm(np.column_stack([both.chain.design.z, both.chain.design.w]), axis=0)
    heard = size > 1e-15 * columns
    assert [name for name, is_heard in zip(both.arm.parameter_names, heard, strict=False) if not is_heard] == ["a00"]
    assert not noise[~heard].any()
    if not both.chain.balance.void:
        off = (np.abs(noise - expected) / np.outer(size, size))[np.ix_(heard, heard)]
        assert np.max(off) <= (1e-9 if both.case.far else 1e-11)


def test_normal_equations(both: Both) -> None:
    """In units of the lengths of the two columns that an entry is the product of."""
    (a, b), (numpy_a, numpy_b) = both.flight.normal_equations(), both.chain.design.normal()
    columns, work = np.linalg.norm(both.chain.design.z, axis=0), np.linalg.norm(both.chain.design.w)
    off = np.column_stack([np.abs(a - numpy_a) / np.outer(columns, columns), np.abs(b - numpy_b) / (columns * work)])
    assert (off <= both.rounds.equations).all()


def test_solution(both: Both) -> None:
    estimate, solution = both.flight.estimate(), both.chain.solution
    assert np.isfinite(estimate.value).all()
    worst = np.max(np.abs(estimate.value / solution.x - 1.0))
    assert worst <= max(1e-9, 1e-14 * estimate.condition)
    assert estimate.condition == pytest.approx(solution.condition, rel=1e-6)
    # the library knows the noise of arcs that were dropped later in proportion only
    known = explained(both.flight.noise(), solution.x) - explained(both.chain.design.noise, solution.x)
    square = solution.residual**2 + known / len(both.chain.design.w)
    assert estimate.residual == pytest.approx(np.sqrt(square), rel=1e-6)
    assert (estimate.gate, solution.believed) == (pytest.approx(solution.gate, rel=0.05 if known else 1e-6), 1.0)


def test_the_record_is_one_from_which_the_parameters_come_back(both: Both) -> None:
    """Otherwise the two would agree on numbers that mean nothing."""
    np.testing.assert_allclose(both.flight.estimate().value, parameters_of(both.arm), rtol=0.3)


def overlapping(both: Both) -> tuple[Floats, Floats]:
    """Weights (K, m) of the accepted rows in blocks, and what noise adds to each block's squares (K, p+1, p+1).

    In each segment of an arc one block fades out and the next fades in, from one step of instants to the next. Of a
    segment's noise each has its share of the segment's instants; that of a step goes to the segment that was open
    while the step filled.
    """
    arm, chain = both.arm, both.chain
    design, balance = chain.design, chain.balance
    arc_cycles, second = round(arm.arc_max_s / arm.period_s), round(1.0 / arm.period_s)
    longest = max(arc_cycles // 48, min(second, arc_cycles // 4)) // STEP * STEP
    here, known = instants(arm, chain.samples, chain.smoothed, balance), spread(arm)
    since_origin = np.arange(len(balance.arc)) - np.searchsorted(balance.arc, balance.arc)
    weights: list[Floats] = []
    noise: list[Floats] = []
    for arc in np.unique(design.arc):
        rows = np.flatnonzero(balance.arc == arc)
        good = balance.accepted[rows]
        place = np.where(good, np.flatnonzero(design.arc == arc)[0] + np.cumsum(good) - 1, -1)
        weights.append(np.zeros(len(design.w)))
        noise.append(np.zeros_like(design.noise))
        begins: list[int] = []  # of the noise of each segment
        rising: list[float] = []
        held = longest
        for start in range(0, len(rows), STEP):
            step = slice(start, start + STEP)
            if held >= longest:
                weights.append(np.zeros(len(design.w)))
                begins.append(min(start + STEP - 1, len(rows)) if begins else 0)
                rising.append(0.0)
                held = 0
            mine = place[step][good[step]]
            late = min(1.0, (held + 0.5 * len(mine)) / longest)
            weights[-2][mine], weights[-1][mine] = 1.0 - late, late
            rising[-1] = (rising[-1] * held + late * len(mine)) / max(1, held + len(mine))
            held += len(mine)
        for begin, end, share in zip(begins, [*begins[1:], len(rows)], rising, strict=True):
            counted = rows[begin:end][good[begin:end]]
            added = moments(arm, known, here.at(counted), since_origin[counted])
            noise[-1] += (1.0 - share) * added
            noise.append(share * added)
    return np.array(weights), np.array(noise)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.arc_s == 60.0])
def test_sigmas_from_the_same_blocks(name: str) -> None:
    """Where no blocks have merged: the scatter of overlapping blocks, and what undeclared noise may hide."""
    both = both_of(name)
    design, solution, estimate = both.chain.design, both.chain.solution, both.flight.estimate()
    weights, noise = overlapping(both)
    assert estimate.blocks == len(weights) > 8
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(noise.sum(axis=0), design.noise, rtol=1e-9, atol=1e-12 * np.abs(design.noise).max())
    told = scatter(design.z, design.w, weights, noise)
    stays = that_stays(Rows(design.z, design.w, design.noise), solution, arc_cycles(both.arm))
    assert estimate.cluster < 1.0  # nothing adds up within blocks
    covariance = (1.0 + stays) * told.covariance
    left = design.w - design.z @ solution.x
    a, b = design.normal()
    excess = max(0.0, left @ left - explained(design.noise, solution.x)) / (solution.x**2 @ np.diag(a))
    hidden = np.linalg.solve(a + excess * np.diag(np.sum(design.z**2, axis=0)), b) - np.linalg.solve(a, b)
    sigma = np.sqrt(np.diag(covariance) + hidden**2)
    np.testing.assert_allclose(estimate.sigma, sigma, rtol=1e-6)
    np.testing.assert_allclose(estimate.half95 / estimate.sigma, student.ppf(0.975, told.freedom), rtol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)), estimate.sigma, rtol=1e-14)
    np.testing.assert_allclose(
        estimate.covariance - np.diag(estimate.sigma**2),
        covariance - np.diag(np.diag(covariance)),
        atol=1e-6 * np.abs(np.outer(sigma, sigma)).max(),
        rtol=0,
    )
    cluster = np.mean((weights @ left) ** 2 / np.sum(weights**2, axis=1)) / estimate.residual**2
    assert estimate.cluster == pytest.approx(cluster, rel=1e-5)


def test_a_sigma_that_is_too_small_is_not_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    """With and without the part that stays: `zygos check` tells them apart."""
    both = both_of("plain")

    def room() -> Room:
        rooms = {room.name: room for room in check_cycles(both.arm, both.cycles)}
        return rooms["sigmas"]

    assert room().equal
    monkeypatch.setattr("zygos.reference.sigmas.SYSTEMATIC", 0.0)
    assert not room().equal
    assert room().difference > 1e-3
