# SPDX-License-Identifier: MIT
"""What the flight library publishes when somebody lies to it, and what it says when its memory has changed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_support import exact_torques
from flight_support import bytes_of, part
from numpy.typing import NDArray
from plant_support import lively as example
from runs_support import trajectory_of

from zygos.arm import Arm, load_arm
from zygos.model.model import load_model
from zygos.native.flight import REASONS, Estimate, Flight, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import load_scenario
from zygos.simulation.sensors import draw_noise

Floats = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[2] / "examples"
UNCLOSED, CORRUPT = REASONS[6], REASONS[5]
SIGMAS, SHARE = 5.0, 0.02
"""A published value may be off by so many sigmas, or by so much of its size; not by both."""


def lively() -> tuple[Trajectory, Floats]:
    """A run that no sensor touched, and the true parameters."""
    arm, plant, scenario = example()
    return trajectory_of(arm, plant, scenario, noise=False, period_s=arm.period_s), plant.base_values(arm)


def modern() -> tuple[Trajectory, Floats]:
    arm, plant = exact_torques(load_arm(EXAMPLES / "gap" / "arm.toml")), load_model(EXAMPLES / "gap" / "cad.toml")
    scenario = load_scenario(EXAMPLES / "gap" / "a.toml")
    run = trajectory_of(arm, plant, scenario, noise=False, duration_s=40.0, rtol=1e-9, atol=1e-11)
    return run, plant.base_values(arm)


def read(run: Trajectory, seed: int) -> Cycles:
    """The run as the arm's own sensors see it, with the errors of a seed."""
    return replace(run, noise=draw_noise(run.arm, len(run.t), [seed])).cycles()


def told(arm: Arm, cycles: Cycles) -> Estimate:
    flight = Flight(arm)
    flight.cycles(cycles)
    return flight.estimate()


def lies(estimate: Estimate, true: Floats) -> list[str]:
    """Parameters that are published and off by more than they may be."""
    if estimate.validity not in ("valid", "partial"):
        return []
    error = np.abs(np.nan_to_num(estimate.value - true))
    far = (error > SIGMAS * np.nan_to_num(estimate.sigma)) & (error > SHARE * np.abs(true))
    return [name for name, there in zip(estimate.names, far, strict=True) if there]


def pieces(cycles: Cycles, arm: Arm, span_s: float) -> Iterator[Cycles]:
    n = round(span_s / arm.period_s)
    for start in range(0, len(cycles) - n + 1, n):
        yield part(cycles, start, start + n)


@pytest.mark.parametrize("span_s", [12.0, 20.0, 30.0, 60.0])
def test_pieces_of_a_run(span_s: float) -> None:
    run, true = lively()
    found = [told(run.arm, piece) for seed in range(5) for piece in pieces(read(run, seed), run.arm, span_s)]
    assert [lies(estimate, true) for estimate in found] == [[] for _ in found]
    assert all(estimate.validity == "valid" or estimate.reason for estimate in found)


def late(arm: Arm, latch_us: int) -> Arm:
    """The arm file believes that all encoders latch late."""
    return replace(arm, joints=tuple(replace(joint, latch_us=latch_us) for joint in arm.joints))


@pytest.mark.slow
@pytest.mark.parametrize("latch_us", [300, 1000, 2000])
def test_a_wrong_latch_is_in_the_sigmas_of_fine_encoders(latch_us: int) -> None:
    """The residuals are no noise then, and the same in every block: blocks that agree do not make an error smaller."""
    run, true = modern()
    for seed in range(2):
        estimate = told(late(run.arm, latch_us), read(run, seed))
        assert estimate.cluster > 5.0
        assert lies(estimate, true) == []
        assert (estimate.validity == "valid") or (estimate.reason == UNCLOSED)


# ---------------------------------------------------------------- memory that changes


def flipped(flight: Flight, byte: int, bit: int) -> None:
    memory = ffi.buffer(flight.native)
    memory[byte : byte + 1] = bytes([bytes_of(flight.native)[byte] ^ (1 << bit)])


def sums_of(flight: Flight) -> list[tuple[int, int]]:
    """Places and lengths in zygos_arm_t of the sums that are in use."""
    arm, sums = flight.arm, flight.native.sums.energy
    p = len(flight.names)
    row, noise = 4 * (p + 2) * (p + 3), 4 * (p + 1) * (p + 2)
    at = ffi.offsetof("zygos_arm_t", "sums", "energy")
    block, buffer = ffi.sizeof("zygos_block_t"), ffi.sizeof("zygos_row_buffer_t")
    shares = ("noise_open", sums.store.parity), ("noise_open", sums.store.parity ^ 1), ("noise_closed", 0)
    own = ffi.sizeof("zygos_noise_sums_t")
    out = [(at + ffi.offsetof("zygos_accumulator_t", name) + n * own, noise) for name, n in shares]
    out += [
        (at + ffi.offsetof("zygos_accumulator_t", "block") + b * block, row)
        for b in sums.store.order[0 : sums.store.count]
    ]
    out += [(at + ffi.offsetof("zygos_accumulator_t", "buffer") + b * buffer, row) for b in range(2)]
    at = ffi.offsetof("zygos_arm_t", "sums", "motors")
    own, whole = ffi.sizeof("zygos_motor_gram_t"), ffi.sizeof("zygos_motor_block_t")
    first, store = at + ffi.offsetof("zygos_motor_sums_t", "block"), flight.native.sums.motors.store
    places = [first + b * whole for b in store.order[0 : store.count]]
    return out + [(place + i * own, 8 * 15) for place in places for i in range(arm.n)]


@pytest.mark.slow
def test_no_bit_of_the_sums_moves_an_estimate_unnoticed() -> None:
    """Columns differ in size by orders of magnitude: a bit that is small beside the work is not small for a spring."""
    run, _ = lively()
    cycles = read(run, 5)
    before, after = part(cycles, 0, 1600), part(cycles, 1600, 1660)
    flight = Flight(run.arm)
    flight.cycles(before)
    image, places = bytes_of(flight.native), sums_of(flight)
    flight.cycles(after)
    known = flight.estimate()
    assert known.validity == "valid"
    rng = np.random.default_rng(0)
    lengths = np.array([length for _, length in places])
    noticed = 0
    for _ in range(500):
        place, length = places[rng.choice(len(places), p=lengths / lengths.sum())]
        ffi.memmove(flight.native, image, len(image))
        flipped(flight, place + int(rng.integers(length)), int(rng.integers(8)))
        flight.cycles(after)
        estimate = flight.estimate()
        noticed += estimate.reason == CORRUPT
        if estimate.reason != CORRUPT:
            assert (np.abs(estimate.value - known.value) <= 0.5 * known.sigma).all()
    assert noticed > 300


@pytest.mark.parametrize("bit", [0, 3, 9, 30])
def test_a_wrong_count_of_an_arc_is_noticed(bit: int) -> None:
    run, _ = lively()
    flight = Flight(run.arm)
    flight.cycles(read(run, 5))
    flight.native.sums.energy.store.arc_instants ^= 1 << bit
    assert flight.native.sums.energy.store.arc_instants >= lib.ZYGOS_MIN_ARC_INSTANTS_VALUE
    assert flight.estimate().reason == CORRUPT


@pytest.mark.slow
def test_a_long_arc_is_not_corrupt() -> None:
    """Like numbers added 130 000 times round always the same way, and rows of noise are alike at rest."""
    run, _ = modern()
    n, arm = 130_000, replace(run.arm, arc_max_s=1e4, impulse_arc_s=1e4, momentum_max_s=1e4)
    noise = draw_noise(arm, n, [0])
    zero = np.zeros((n, arm.n))
    sync, flags = np.arange(n, dtype=np.uint64), np.zeros(n, dtype=np.uint32)
    flight = Flight(arm)
    flight.cycles(Cycles(sync, noise.link[0], noise.motor[0], zero, noise.gyro[0], flags))
    assert flight.native.sums.momentum.store.cycles > 120_000
    assert flight.estimate().reason != CORRUPT
