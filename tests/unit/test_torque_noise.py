# SPDX-License-Identifier: MIT
"""Noise of the torques walks in the work of an arc. Intervals contain it; the scatter of blocks hardly shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cases_support import CASES, arm_of, record_of
from flight_support import part
from soak_support import again, fly, settle

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import Flight, closed_blocks, ffi, lib
from zygos.reference.compare import Room, check_cycles
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory

DRAWS = 30
SHARE = 0.005


def told(arm: Arm, sigma: float, share: float) -> Arm:
    """The arm with torques of such deviations."""
    joints = (replace(joint, torque_sigma=sigma, torque_relative_sigma=share) for joint in arm.joints)
    return replace(arm, joints=tuple(joints))


def walk(name: str, sigma: float, share: float) -> Room:
    """What numpy finds of the library's variance of the work."""
    case = CASES[name]
    cycles = part(record_of(case), 0, 1200)
    rooms = {room.name: room for room in check_cycles(told(arm_of(case), sigma, share), cycles)}
    return rooms["torque noise"]


@pytest.mark.slow(only=["three joints*", "15/4*", "11/6*"])
@pytest.mark.parametrize(
    ("name", "sigma", "share"),
    [("plain", 0.0, 0.0), ("11/6", 1e-3, 0.0), ("15/4", 1e-3, 0.01), ("three joints", 0.0, 0.01)],
)
def test_the_variance_of_the_work_is_that_of_numpy(name: str, sigma: float, share: float) -> None:
    """Also of instants that the bandwidth test refuses, and of several arcs."""
    assert walk(name, sigma, share).equal


def test_another_step_of_a_torque_frame_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zygos.arm.TORQUE_STEP", 1.001e-4)
    assert not walk("plain", 0.0, 0.0).equal
    assert walk("plain", 1e-3, 0.01).equal


def test_a_rounded_torque_is_the_least_noise(arm: Arm, motion: Cycles) -> None:
    """A declaration of less than nothing does not exist; one of more widens, and moves no value."""
    sigmas, values = [], []
    for sigma in (0.0, 1e-9, 1e-2, 1e-1):
        flight = Flight(told(arm, sigma, 0.0))
        flight.cycles(again(arm, motion, 1, np.random.default_rng(0)))
        found = flight.estimate()
        sigmas.append(found.sigma)
        values.append(found.solution)
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=1e-9)  # over the wire it is that of the steps
    assert (sigmas[2] > sigmas[1]).all() and (sigmas[3] > sigmas[2]).all()
    for value in values[1:]:
        np.testing.assert_array_equal(value, values[0])


@pytest.fixture(scope="module")
def motion(clean: Callable[[], Trajectory]) -> Cycles:
    """A minute without noise."""
    return clean().cycles()


def coverage(arm: Arm, motion: Cycles, true: np.ndarray, declared: float) -> np.ndarray:  # type: ignore[type-arg]
    """(p,) share of the draws in which each interval holds."""
    hold = []
    for draw in range(DRAWS):
        rng = np.random.default_rng(draw)
        cycles = again(arm, motion, 1, rng)
        flight = Flight(told(arm, 0.0, declared))
        flight.cycles(replace(cycles, tau=cycles.tau * (1.0 + SHARE * rng.normal(size=cycles.tau.shape))))
        found = flight.estimate()
        assert found.validity == "valid"
        hold.append(np.abs(found.value - true) <= found.half95)
    return np.asarray(np.mean(hold, axis=0))


@pytest.mark.slow
def test_intervals_hold_with_noise_of_the_torques(arm: Arm, model: Model, motion: Cycles) -> None:
    """Those of an arm that does not declare it are too narrow for the damping."""
    true = model.base_values(arm)
    least = 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / DRAWS)
    assert coverage(arm, motion, true, SHARE).min() >= least
    assert coverage(arm, motion, true, 0.0).min() < least


def accumulate(all_sums: Any, rng: np.random.Generator, instants: int, weight: float) -> None:
    """Rows of three columns, each of which adds 1 to the variance."""
    row = ffi.new("zygos_row_t *")
    for _ in range(instants):
        row.column[0:3] = rng.normal(size=3).tolist()
        row.work, row.variance = rng.normal(), 1.0
        lib.zygos_accumulator_add(ffi.addressof(all_sums, "energy"), row, weight)
        lib.zygos_guard_proceed(all_sums, lib.ZYGOS_ENERGY_ROWS)


def test_an_arc_that_is_dropped_leaves_no_variance_to_the_next() -> None:
    """Of refused instants alone, while the arc before it is closing."""
    sums, rng, kind = ffi.new("zygos_sums_t *"), np.random.default_rng(0), lib.ZYGOS_ENERGY_ROWS
    store = ffi.addressof(sums.energy, "store")
    lib.zygos_accumulator_init(ffi.addressof(sums, "energy"), 3, 1000, 0.05)
    accumulate(sums, rng, 200, 1.0)
    lib.zygos_store_close(store, kind, 200)
    accumulate(sums, rng, 5, 0.0)
    assert (store.closed, store.closing_instants) == (0, 200)
    lib.zygos_store_close(store, kind, 205)
    assert (store.closed, store.closing_instants) == (0, 200)
    accumulate(sums, rng, 300, 1.0)
    lib.zygos_guard_settle(sums, kind)
    lib.zygos_store_close(store, kind, 505)
    lib.zygos_guard_settle(sums, kind)
    assert store.arcs == 2
    assert sum(block.variance[0] for block in closed_blocks(sums.energy)) == pytest.approx(500.0)


def test_the_variance_of_what_is_forgotten_fades_with_it(arm: Arm, motion: Cycles) -> None:
    """Blocks merge for as long as one likes; what they keep of variance is in proportion to what they keep of rows."""
    flight, rng = Flight(replace(arm, memory_s=120.0)), np.random.default_rng(0)
    fly(flight, motion, 1, rng)

    def rates() -> list[float]:
        settle(flight)
        return [block.variance[0] / block.head.total for block in closed_blocks(flight.native.sums.energy)]

    fly(flight, motion, 1, rng)
    first = rates()
    fly(flight, motion, 80, rng)
    last = rates()
    assert len(last) < flight.native.sums.energy.store.arcs  # blocks of several arcs have merged
    assert max(last) < 2.0 * max(first)
