# SPDX-License-Identifier: MIT
"""The flight library against its numpy twin, room by room, over arms that differ in all that an arm file can say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from cases_support import CASES, Case, arm_of, parameters_of, record_of
from flight_support import part, waits
from numpy.typing import NDArray
from scipy.stats import t as student

from zygos import reference
from zygos.arm import Arm
from zygos.balances.arcs import arc_cycles
from zygos.native.flight import Flight, Trace, ffi, lib
from zygos.reference.accumulator import Design
from zygos.reference.compare import Room, Rounding, check_cycles, rounding, tables
from zygos.reference.noise import moments, row_instants, spread
from zygos.reference.solver import Rows, explained, scatter, that_stays
from zygos.runs.cycles import Cycles
from zygos.runs.samples import usable

Floats = NDArray[np.float64]

STEP = 8  # ZYGOS_BUFFER_ROWS
QUICK = ("plain", "over the end", "turned back", "one joint, all", "two joints, all",
         "three joints, all")  # fmt: skip
"""Cases in which everything occurs that an arm file can say."""


@dataclass(frozen=True)
class Both:
    """The same record through both."""

    case: Case
    arm: Arm
    cycles: Cycles
    flight: Flight
    trace: Trace
    chain: reference.ReferenceStages
    rounds: Rounding
    """At least 1e-12 of each column's largest entry, at the most 1e-9."""


@cache
def both_of(name: str, last: int | None = None) -> Both:
    """The whole record of a case, or its first cycles."""
    case = CASES[name]
    arm = arm_of(case)
    whole = record_of(case)
    cycles = part(whole, 0, last) if last is not None else whole
    flight = Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    chain = reference.chain(arm, cycles, waited=waits(cycles, trace))
    rounds = rounding(arm, chain.samples, tables(arm, chain.samples, chain.smoothed))
    return Both(case, arm, cycles, flight, trace, chain, rounds)


@pytest.fixture(params=[pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES])
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
    lib.zygos_arm_take(both.flight.native, work)
    assert lib.zygos_sums_end_copy(ffi.addressof(work, "sums"))
    sums, design, counts = work.sums.energy, both.chain.design, both.flight.counts
    assert (sums.store.arcs, sums.store.arcs_dropped) == (design.arcs, design.dropped_arcs)
    assert (sums.store.accepted, sums.refused) == (len(design.w), design.refused)
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
    assert (estimate.signal_to_noise, solution.noise_scale) == (
        pytest.approx(solution.signal_to_noise, rel=0.05 if known else 1e-6),
        1.0,
    )


def test_the_record_is_one_from_which_the_parameters_come_back(both: Both) -> None:
    """Otherwise the two would agree on numbers that mean nothing."""
    np.testing.assert_allclose(both.flight.estimate().value, parameters_of(both.arm), rtol=0.3)


UNMERGED = 1200
"""Cycles in which no blocks merge: segments of a second, at 50 Hz."""


def overlapping(both: Both) -> tuple[Floats, Floats, Floats]:
    """Weights (K, m) of the accepted rows in blocks, what noise adds to each block's squares (K, p+1, p+1), and to the
    variance of the work in it, by torques (K,).

    In each segment of an arc one block fades out and the next fades in, from one step of instants to the next. A step
    that the end of the arc cuts short begins no segment. The noise of a step has the weights of the step.
    """
    arm, chain = both.arm, both.chain
    design, balance = chain.design, chain.balance
    arc_cycles, second = round(arm.arc_max_s / arm.period_s), round(1.0 / arm.period_s)
    longest = max(arc_cycles // 48, min(second, arc_cycles // 4)) // STEP * STEP
    here, known = row_instants(arm, chain.samples, chain.smoothed, balance), spread(arm)
    since_origin = np.arange(len(balance.arc)) - np.searchsorted(balance.arc, balance.arc)
    weights: list[Floats] = []
    noise: list[Floats] = []
    walk: list[float] = []
    for arc in np.unique(design.arc):
        rows = np.flatnonzero(balance.arc == arc)
        good = balance.accepted[rows]
        place = np.where(good, np.flatnonzero(design.arc == arc)[0] + np.cumsum(good) - 1, -1)
        weights.append(np.zeros(len(design.w)))
        noise.append(np.zeros_like(design.noise))
        walk.append(0.0)
        held = longest
        for start in range(0, len(rows), STEP):
            step = slice(start, start + STEP)
            if held >= longest and (start == 0 or start + STEP <= len(rows)):
                weights.append(np.zeros(len(design.w)))
                noise.append(np.zeros_like(design.noise))
                walk.append(0.0)
                held = 0
            mine = place[step][good[step]]
            late = min(1.0, (held + 0.5 * len(mine)) / longest)
            counted = rows[step][good[step]]
            added = moments(arm, known, here.at(counted), since_origin[counted])
            weights[-2][mine], weights[-1][mine] = 1.0 - late, late
            noise[-2] += (1.0 - late) * added
            noise[-1] += late * added
            walk[-2] += (1.0 - late) * balance.walk[rows[step]].sum()
            walk[-1] += late * balance.walk[rows[step]].sum()
            held += len(mine)
    return np.array(weights), np.array(noise), np.array(walk)


def walked(a: Floats, design: Design, weights: Floats, walk: Floats) -> Floats:
    """(p, p) what the noise of torques adds to the covariance: each step of the work shifts all rows of its arc behind
    it. Along a block the sums of rows change evenly: two places of Gauss are exact for the square of what is linear."""
    sums = np.vstack([np.zeros(design.z.shape[1]), np.cumsum(weights @ design.z, axis=0)])
    places = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    total = np.zeros_like(a)
    for begin, end, variance in zip(sums[:-1], sums[1:], walk, strict=True):
        moved = np.linalg.solve(a, (begin + places[:, None] * (end - begin)).T)
        total += variance * moved @ moved.T / len(places)
    return total


@dataclass(frozen=True)
class Scatter:
    """What numpy finds of the errors of a solution."""

    covariance: Floats
    """(p, p) by the scatter of overlapping blocks."""
    sigma: Floats
    """(p,) with what undeclared noise may hide."""
    freedom: Floats
    weights: Floats
    left: Floats
    """(m,) what the rows leave over."""


def scatter_of(both: Both) -> Scatter:
    """Where no blocks have merged."""
    design, solution = both.chain.design, both.chain.solution
    weights, noise, walk = overlapping(both)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(noise.sum(axis=0), design.noise, rtol=1e-9, atol=1e-12 * np.abs(design.noise).max())
    told = scatter(design.z, design.w, weights, noise)
    stays = that_stays(Rows(design.z, design.w, design.noise), solution, arc_cycles(both.arm))
    left = design.w - design.z @ solution.x
    a, b = design.normal()
    covariance = (1.0 + stays) * told.covariance + walked(a, design, weights, walk)
    excess = max(0.0, left @ left - explained(design.noise, solution.x)) / (solution.x**2 @ np.diag(a))
    hidden = np.linalg.solve(a + excess * np.diag(np.sum(design.z**2, axis=0)), b) - np.linalg.solve(a, b)
    return Scatter(covariance, np.sqrt(np.diag(covariance) + hidden**2), told.freedom, weights, left)


@pytest.mark.slow(but=["turned back", "two joints, all"])
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.arc_s == 60.0])
def test_sigmas_from_the_same_blocks(name: str) -> None:
    both = both_of(name, UNMERGED)
    estimate, told = both.flight.estimate(), scatter_of(both)
    sigma = told.sigma
    assert estimate.blocks == len(told.weights) > 8
    assert estimate.cluster < 1.0  # nothing adds up within blocks
    np.testing.assert_allclose(estimate.sigma, sigma, rtol=1e-6)
    np.testing.assert_allclose(estimate.half95 / estimate.sigma, student.ppf(0.975, told.freedom), rtol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)), estimate.sigma, rtol=1e-14)
    np.testing.assert_allclose(
        estimate.covariance - np.diag(estimate.sigma**2),
        told.covariance - np.diag(np.diag(told.covariance)),
        atol=1e-6 * np.abs(np.outer(sigma, sigma)).max(),
        rtol=0,
    )
    cluster = np.mean((told.weights @ told.left) ** 2 / np.sum(told.weights**2, axis=1)) / estimate.residual**2
    assert estimate.cluster == pytest.approx(cluster, rel=1e-5)


@pytest.mark.parametrize("name", ["turned back"])
def test_the_error_of_an_imprecise_value_is_also_in_the_others(name: str) -> None:
    """Every column is in the solution; what moves where the imprecise ones are left out widens the other intervals."""
    both = both_of(name, 500)
    estimate, told, x = both.flight.estimate(), scatter_of(both), both.chain.solution.x
    precise = told.sigma < 0.25 * np.abs(x)  # ZYGOS_SIGMA_LIMIT
    kept = np.isfinite(estimate.value)
    assert estimate.validity == "partial" and estimate.rank == len(x) > precise.sum() > kept.sum()
    a, b = both.chain.design.normal()
    without = np.zeros(len(x))
    without[precise] = np.linalg.solve(a[np.ix_(precise, precise)], b[precise])
    shift = (without - x)[kept]
    assert (np.abs(shift) > told.sigma[kept]).any()
    np.testing.assert_allclose(estimate.sigma[kept], np.hypot(told.sigma[kept], shift), rtol=1e-6)


def test_a_sigma_that_is_too_small_is_not_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    """With and without the part that stays: `zygos self-test` tells them apart."""
    both = both_of("plain")

    def room() -> Room:
        rooms = {room.name: room for room in check_cycles(both.arm, both.cycles)}
        return rooms["sigmas"]

    assert room().equal
    monkeypatch.setattr("zygos.reference.sigmas.SYSTEMATIC", 0.0)
    assert not room().equal
    assert room().difference > 1e-3
