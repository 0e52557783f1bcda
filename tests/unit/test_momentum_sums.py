"""The sums of the momentum rows in the flight library: against numpy, over gaps, drops and merges, and when refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flight_support import joined, part
from numpy.typing import NDArray
from rows_support import awkward, smoothed, wandering

from zygos.arm import Arm
from zygos.cycles import VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.flight import Flight, ffi, lib
from zygos.reference import momentum
from zygos.reference.accumulator import MIN_ARC_INSTANTS

Floats = NDArray[np.float64]

ARMS = [("spatial", (True, False, True)), ("planar", (True, True, False)), ("planar-symmetric", (True, True))]
LONGEST = 50


def arm_of(kinetic: str, flexible: tuple[bool, ...], every: int | None = None) -> Arm:
    """Arcs of LONGEST cycles."""
    arm = awkward(8, len(flexible), kinetic, flexible, latch_us=2000)
    return replace(arm, momentum_max_s=LONGEST * arm.period_s, compensate_every=every)


def shaken(arm: Arm, n: int, gap: int | None = None) -> Cycles:
    """Two short jolts on the way, which the bandwidth test refuses."""
    cycles = wandering(arm, n, gap)
    for start in (70, 71, 230):
        cycles.theta[start] += 0.3
    return cycles


def sums_of(flight: Flight) -> Any:
    return ffi.addressof(flight.native, "momentum_sums")


def matrix(packed: Any, width: int) -> Floats:
    out = np.zeros((width, width))
    rows, columns = np.tril_indices(width)
    out[rows, columns] = out[columns, rows] = np.frombuffer(ffi.buffer(packed))[: len(rows)]
    return out


def closed(arm: Arm, cycles: Cycles) -> tuple[list[Floats], Floats, Any]:
    """Normal matrices of the blocks, the noise that was taken off them, and the sums; the open arc is ended."""
    flight = Flight(arm)
    flight.cycles(cycles)
    sums = sums_of(flight)
    lib.zygos_momentum_sums_end_arc(sums, ffi.addressof(flight.native, "config"), flight.native.cycle)
    blocks = [matrix(sums.block[b].rows.gram, sums.columns) for b in range(sums.count)]
    noise = matrix(sums.noise_closed.gram, sums.columns)
    return blocks, noise, (sums, flight)


def of_numpy(arm: Arm, cycles: Cycles) -> tuple[list[Floats], list[Floats]]:
    """Normal matrices of the arcs, and the noise in each."""
    samples, instants, _ = smoothed(arm, cycles, LONGEST)
    found = momentum.turns(arm, samples, instants)
    assert found is not None
    rows = [found.z[found.arc == number] for number in np.unique(found.arc)]
    return [z.T @ z for z in rows], list(found.noise)


def assert_close(found: Floats, expected: Floats, tolerance: float) -> None:
    """Entry by entry, each against the size of its row and column."""
    scale = np.sqrt(np.diag(expected))
    assert (scale > 0.0).all()
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected / np.outer(scale, scale), rtol=0, atol=tolerance
    )


@pytest.mark.parametrize(("kinetic", "flexible"), ARMS)
def test_c_is_numpy(kinetic: str, flexible: tuple[bool, ...]) -> None:
    arm = arm_of(kinetic, flexible)
    cycles = shaken(arm, 330, gap=120)
    _, instants, arc = smoothed(arm, cycles, LONGEST)
    expected, owed = of_numpy(arm, cycles)
    assert 0 < np.count_nonzero(~instants.accepted) < 60
    assert len(expected) >= 6
    raw, none, _ = closed(replace(arm, compensate_every=0), cycles)
    assert not none.any()
    assert len(raw) == len(expected)
    for own, other in zip(raw, expected, strict=True):
        assert_close(own, other, 1e-12)
    less, noise, (sums, _) = closed(arm, cycles)
    assert_close(noise, sum(owed, start=np.zeros(())), 1e-9)
    for own, other, part_of in zip(less, expected, owed, strict=True):
        assert_close(other - own, part_of, 1e-9)
    instants_of = [np.count_nonzero(instants.accepted[arc == k]) for k in range(arc.max() + 1)]
    assert [sums.block[b].instants for b in range(sums.count)] == [n for n in instants_of if n >= MIN_ARC_INSTANTS]
    assert lib.zygos_momentum_sums_check(sums) <= 1.0


def test_turns_miss_nothing() -> None:
    """Of slow motion, the rows in turns are a third of all rows, and their noise a third of all noise."""
    arm = replace(arm_of("spatial", (True, False, True)), momentum_max_s=3.0)
    cycles = wandering(arm, 165)
    _, instants, arc = smoothed(arm, cycles, 150)
    found, noise, _ = closed(replace(arm, compensate_every=0), cycles)[0][0], closed(arm, cycles)[1], None
    inside = arc == 0
    rows = momentum.rows(arm, instants, arc)[inside]
    rows = rows - rows.mean(axis=0)
    whole = np.einsum("mkp,mkq->pq", rows, rows)
    owed = momentum.noise(arm, instants)[inside].sum(axis=0)
    for a, b in ((found, whole), (noise, owed)):
        scale = np.sqrt(np.diag(b))
        assert np.abs((3.0 * a - b) / np.outer(scale, scale)).max() < 0.1


def test_blocks_merge_and_lose_nothing() -> None:
    arm = arm_of("planar", (True, True, False))
    cycles = wandering(arm, 60 + 40 * LONGEST + 29)
    expected, owed = of_numpy(arm, cycles)
    blocks, noise, (sums, _) = closed(arm, cycles)
    capacity = len(sums.block)
    assert capacity == 16 < len(expected)
    assert 4 <= len(blocks) <= capacity
    total = sum(expected, start=np.zeros(()))
    assert_close(sum(blocks, start=noise), total, 1e-12)
    assert_close(noise, sum(owed, start=np.zeros(())), 1e-9)
    assert sum(sums.block[b].instants for b in range(sums.count)) == len(cycles) - 6 - 3
    ends = [sums.block[b].end for b in range(sums.count)]
    assert ends == sorted(ends)
    assert ends[-1] == cycles.sync[-1]
    assert lib.zygos_momentum_sums_check(sums) <= 1.0


def test_doubtful_cycles_take_their_arcs_along() -> None:
    arm = arm_of("planar-symmetric", (True, True))
    before, after = wandering(arm, 300), wandering(arm, 30)
    after = replace(after, sync=after.sync + np.uint64(300))
    after.flags[0] = VOID_BEFORE | (100 << VOID_SHIFT)
    flight = Flight(arm)
    flight.cycles(before)
    sums = sums_of(flight)
    blocks = [(sums.block[b].end, matrix(sums.block[b].rows.gram, sums.columns)) for b in range(sums.count)]
    noise = matrix(sums.noise_closed.gram, sums.columns)
    instants = sum(sums.block[b].instants for b in range(sums.count))
    flight.cycles(joined(after))
    kept = [block for end, block in blocks if end <= 200]
    assert 0 < len(kept) < len(blocks)
    assert sums.count == len(kept)
    for b, block in enumerate(kept):
        np.testing.assert_array_equal(matrix(sums.block[b].rows.gram, sums.columns), block)
    share = sum(sums.block[b].instants for b in range(sums.count)) / instants
    assert_close(matrix(sums.noise_closed.gram, sums.columns), share * noise, 1e-14)
    assert lib.zygos_momentum_sums_check(sums) <= 1.0


def test_a_restart_forgets_all() -> None:
    arm = arm_of("spatial", (True, False, True))
    cycles = wandering(arm, 250)
    fresh, again = Flight(arm), Flight(arm)
    again.cycles(cycles)
    assert lib.zygos_restart(again.native, lib.ZYGOS_KEEP_NOTHING) == 1
    later = replace(cycles, sync=cycles.sync + np.uint64(1000))
    for flight in (fresh, again):
        flight.cycles(later)
    one, other = sums_of(fresh), sums_of(again)
    assert one.count == other.count == 4
    for b in range(4):
        assert ffi.buffer(one.block[b].rows.gram)[:] == ffi.buffer(other.block[b].rows.gram)[:]
    assert ffi.buffer(one.noise_closed.gram)[:] == ffi.buffer(other.noise_closed.gram)[:]
    assert one.cycles == other.cycles


@pytest.mark.parametrize("where", ["open", "block", "noise_open", "noise_closed"])
def test_corrupt_sums_are_refused(where: str) -> None:
    arm = arm_of("planar", (True, True, False))
    flight = Flight(arm)
    flight.cycles(wandering(arm, 290))
    sums = sums_of(flight)
    rows = {
        "open": sums.open.rows,
        "block": sums.block[1].rows,
        "noise_open": sums.noise_open,
        "noise_closed": sums.noise_closed,
    }[where]
    assert lib.zygos_momentum_sums_check(sums) <= 1.0
    rows.gram[7] += 1e-3 * max(abs(entry) for entry in rows.gram)
    assert lib.zygos_momentum_sums_check(sums) > 1.0
    assert flight.estimate().reason == "the accumulated sums are corrupt: memory was changed from outside"


def test_a_corrupt_arc_stays_known_when_it_closes() -> None:
    arm = arm_of("planar", (True, True, False))
    cycles = wandering(arm, 290)
    flight = Flight(arm)
    flight.cycles(part(cycles, 0, 40))
    sums = sums_of(flight)
    sums.noise_open.gram[4] *= 1.5
    flight.cycles(part(cycles, 40, 290))
    assert sums.count > 3
    assert lib.zygos_momentum_sums_check(sums) > 1.0
