# SPDX-License-Identifier: MIT
"""The sums of the momentum rows in the flight library: against numpy, over gaps, drops and merges, and when refused."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_support import random_arm
from flight_support import balanced, joined, part, sines, symmetric
from numpy.typing import NDArray
from rows_support import awkward, smoothed, wandering
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from conftest import ROOT, need
from zygos import reference
from zygos.arm import Arm, Encoder, Kinetic, load_arm
from zygos.balances import momentum
from zygos.balances.arcs import MIN_ARC_INSTANTS
from zygos.balances.energy import energy_columns
from zygos.balances.state import State
from zygos.dynamics.engines import engine
from zygos.errors import ZygosError
from zygos.native import flight as flight_module
from zygos.native.flight import Estimate, Flight, closed_blocks, config_of, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles

Floats = NDArray[np.float64]

ARMS = [("spatial", (True, False, True)), ("planar", (True, True, False)), ("planar-symmetric", (True, True))]
LONGEST = 60


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
    return ffi.addressof(flight.native, "sums", "momentum")


def closed(arm: Arm, cycles: Cycles) -> tuple[list[Floats], Floats, Any]:
    """Normal matrices of the blocks, the noise that was taken off them, and the sums; the open arc is ended."""
    flight = Flight(arm)
    flight.cycles(cycles)
    sums = sums_of(flight)
    assert lib.zygos_arm_end_arcs(flight.native) == 1
    lib.zygos_store_apply_fade(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    blocks = [symmetric(block.rows.gram, sums.columns) for block in closed_blocks(sums)]
    noise = symmetric(sums.noise_closed.gram, sums.columns)
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
    assert [block.head.total for block in closed_blocks(sums)] == [n for n in instants_of if n >= MIN_ARC_INSTANTS]
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)


def test_turns_miss_nothing() -> None:
    """Of slow motion, the rows in turns are a third of all rows, and their noise a third of all noise."""
    arm = replace(arm_of("spatial", (True, False, True)), momentum_max_s=3.0)
    cycles = wandering(arm, 165)
    _, instants, arc = smoothed(arm, cycles, 150)
    found, noise, _ = closed(replace(arm, compensate_every=0), cycles)[0][0], closed(arm, cycles)[1], None
    inside = arc == 0
    rows = momentum.momentum_rows(arm, instants, arc)[inside]
    rows = rows - rows.mean(axis=0)
    whole = np.einsum("mkp,mkq->pq", rows, rows)
    owed = momentum.momentum_noise(arm, instants)[inside].sum(axis=0)
    for a, b in ((found, whole), (noise, owed)):
        scale = np.sqrt(np.diag(b))
        assert np.abs((3.0 * a - b) / np.outer(scale, scale)).max() < 0.1


def test_blocks_merge_and_lose_nothing() -> None:
    longest = 150  # no arc waits for the one before it to close
    arm = arm_of("planar", (True, True, False))
    arm = replace(arm, momentum_max_s=longest * arm.period_s)
    cycles = wandering(arm, 60 + 40 * longest + 29)
    expected, owed = of_numpy(arm, cycles)
    blocks, noise, (sums, flight) = closed(arm, cycles)
    assert list(flight.native.waited) == [0, 0, 0]
    capacity = len(sums.block) - 1
    assert capacity == 16 < len(expected)
    assert 4 <= len(blocks) <= capacity
    total = sum(expected, start=np.zeros(()))
    assert_close(sum(blocks, start=noise), total, 1e-12)
    assert_close(noise, sum(owed, start=np.zeros(())), 1e-9)
    assert sum(block.head.total for block in closed_blocks(sums)) == len(cycles) - 6 - 3
    ends = [block.head.end for block in closed_blocks(sums)]
    assert ends == sorted(ends)
    assert ends[-1] == cycles.sync[-1]
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)


def test_no_block_of_several_arcs_is_longer_than_the_target() -> None:
    """Arcs that differ in length by three."""
    arm = replace(arm_of("planar", (True, True, False)), momentum_max_s=3.0)
    cycles = wandering(arm, 4500)
    at = 0
    for number in range(37):
        at += (60, 150, 90, 170)[number % 4]
        cycles.flags[at] = BREAK_BEFORE
    blocks, _, (sums, _) = closed(arm, cycles)
    instants = [block.head.total for block in closed_blocks(sums)]
    assert len(blocks) < 16 and max(instants) <= sums.store.target < sum(instants) / 3.0


def test_doubtful_cycles_take_their_arcs_along() -> None:
    arm = arm_of("planar-symmetric", (True, True))
    before, after = wandering(arm, 300), wandering(arm, 30)
    after = replace(after, sync=after.sync + np.uint64(300))
    after.flags[0] = VOID_BEFORE | (100 << VOID_SHIFT)
    flight = Flight(arm)
    flight.cycles(before)
    sums = sums_of(flight)
    blocks = [(block.head.end, symmetric(block.rows.gram, sums.columns)) for block in closed_blocks(sums)]
    noise = symmetric(sums.noise_closed.gram, sums.columns)
    instants = sum(block.head.total for block in closed_blocks(sums))
    flight.cycles(joined(after))
    kept = [block for end, block in blocks if end <= 200]
    assert 0 < len(kept) < len(blocks)
    assert sums.store.closed == len(kept)
    for b, block in enumerate(kept):
        np.testing.assert_array_equal(symmetric(closed_blocks(sums)[b].rows.gram, sums.columns), block)
    share = sum(block.head.total for block in closed_blocks(sums)) / instants
    assert_close(sums.store.noise_fade * symmetric(sums.noise_closed.gram, sums.columns), share * noise, 1e-14)
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)


def test_blocks_up_to_a_cycle_are_dropped_with_their_share_of_the_noise() -> None:
    arm = arm_of("planar", (True, True, False))
    blocks, noise, (sums, _) = closed(arm, wandering(arm, 330))
    assert len(blocks) >= 5
    instants = [block.head.total for block in closed_blocks(sums)]
    ends = [int(block.head.end) for block in closed_blocks(sums)]
    assert lib.zygos_store_drop_until(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS, ends[1]) == 2
    assert [int(block.head.end) for block in closed_blocks(sums)] == ends[2:]
    for b, whole in enumerate(blocks[2:]):
        np.testing.assert_array_equal(symmetric(closed_blocks(sums)[b].rows.gram, sums.columns), whole)
    lib.zygos_store_apply_fade(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    left = symmetric(sums.noise_closed.gram, sums.columns)
    np.testing.assert_allclose(left, noise * sum(instants[2:]) / sum(instants), rtol=1e-12)
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    assert lib.zygos_store_drop_until(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS, ends[1]) == 0


def test_a_restart_forgets_all() -> None:
    arm = arm_of("spatial", (True, False, True))
    cycles = wandering(arm, 300)
    fresh, again = Flight(arm), Flight(arm)
    again.cycles(cycles)
    assert lib.zygos_arm_restart(again.native, lib.ZYGOS_KEEP_NOTHING) == 1
    later = replace(cycles, sync=cycles.sync + np.uint64(1000))
    for flight in (fresh, again):
        flight.cycles(later)
    one, other = sums_of(fresh), sums_of(again)
    assert one.store.closed == other.store.closed == 4
    for b in range(4):
        assert ffi.buffer(closed_blocks(one)[b].rows.gram)[:] == ffi.buffer(closed_blocks(other)[b].rows.gram)[:]
    assert ffi.buffer(one.noise_closed.gram)[:] == ffi.buffer(other.noise_closed.gram)[:]
    assert one.store.cycles == other.store.cycles


@pytest.mark.parametrize("where", ["open", "block", "noise_open", "noise_closed"])
def test_corrupt_sums_are_refused(where: str) -> None:
    arm = arm_of("planar", (True, True, False))
    flight = Flight(arm)
    flight.cycles(wandering(arm, 290))
    sums = sums_of(flight)
    rows = {
        "open": sums.block[sums.store.open].rows,
        "block": closed_blocks(sums)[1].rows,
        "noise_open": sums.noise_open[sums.store.parity],
        "noise_closed": sums.noise_closed,
    }[where]
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    rows.gram[7] += 1e-3 * max(abs(entry) for entry in rows.gram)
    assert not lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    assert flight.estimate().reason == "the accumulated sums are corrupt: memory was changed from outside"


def test_a_corrupt_arc_is_dropped_when_it_closes() -> None:
    arm = arm_of("planar", (True, True, False))
    cycles = wandering(arm, 340)
    flight = Flight(arm)
    flight.cycles(part(cycles, 0, 40))
    sums = sums_of(flight)
    sums.noise_open[sums.store.parity].gram[4] *= 1.5
    flight.cycles(part(cycles, 40, 340))
    assert sums.store.closed > 3
    assert sums.store.quarantined == 1
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)


def test_sums_fade_with_the_arcs() -> None:
    """Each arc counts by how long ago it ended, when the newest one ends."""
    arm = arm_of("planar", (True, True, False))
    cycles = wandering(arm, 290)
    whole, _, (kept, _) = closed(arm, cycles)
    memory = replace(arm, memory_s=4.0)
    faded, noise, (sums, _flight) = closed(memory, cycles)
    keep = np.exp(-arm.period_s / 4.0)
    last = closed_blocks(sums)[-1].head.end
    ages = [int(last) - int(block.head.end) for block in closed_blocks(sums)]
    assert ages[0] > 150
    for old, new, age in zip(whole, faded, ages, strict=True):
        assert_close(new, keep**age * old, 1e-12)
    assert [block.head.total for block in closed_blocks(sums)] == pytest.approx(
        [keep**age * closed_blocks(kept)[b].head.total for b, age in enumerate(ages)]
    )
    assert lib.zygos_store_is_whole(ffi.addressof(sums, "store"), lib.ZYGOS_MOMENTUM_ROWS)
    assert np.trace(noise) < np.trace(symmetric(kept.noise_closed.gram, kept.columns))


def test_a_fixed_base_is_refused(tmp_path: Path) -> None:
    arm, _ = random_arm(1, 2, "fixed", "spatial")
    assert arm.momentum_arc_s == 0.0
    config: Any = config_of(arm)
    native = ffi.new("zygos_arm_t *")
    assert lib.zygos_arm_init(native, config) == 1
    config.momentum_arc_cycles = 100
    assert lib.zygos_arm_init(native, config) == lib.ZYGOS_E_BASE
    path = tmp_path / "arm.toml"
    text = 'name = "a"\nbase = "fixed"\nkinetic = "spatial"\n[arc]\nmomentum_max_s = 5\n'
    path.write_text(text + '[[joint]]\nname = "j"\nnode = 1\naxis = [0, 0, 1]\ngear_ratio = 2\nflexible = false\n'
                    "motor_encoder = { counts = 100, side = \"output\" }\n")  # fmt: skip
    with pytest.raises(ZygosError, match=r"arc\.momentum_max_s: a fixed base .*; remedy: remove it"):
        load_arm(path)


def test_which_arms_have_momentum_rows() -> None:
    def cycles_of(kinetic: Kinetic, momentum_max_s: float | None) -> int:
        arm, _ = random_arm(1, 2, "free", kinetic)
        config: Any = config_of(replace(arm, period_s=0.02, momentum_max_s=momentum_max_s))
        return int(config.momentum_arc_cycles)

    assert cycles_of("spatial", None) == 500
    assert cycles_of("planar", None) == cycles_of("spatial", 0.0) == 0
    assert cycles_of("planar", 3.0) == 150
    arm, _ = random_arm(1, 2, "free", "spatial")
    with pytest.raises(ZygosError, match="momentum_max_s is shorter than 20 cycles"):
        Flight(replace(arm, period_s=0.02, momentum_max_s=0.3))


@pytest.mark.slow
def test_a_build_without_room_refuses_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need(shutil.which(os.environ.get("CC", "cc").split()[0]), "a C compiler")
    script = [sys.executable, str(ROOT / "tools" / "build_native.py"), str(tmp_path)]
    subprocess.run(script, env={**os.environ, "CFLAGS": "-DZYGOS_MOMENTUM=0"}, check=True)
    arm = arm_of("spatial", (True, True))
    cycles = wandering(arm, 200)
    large, none = ffi.sizeof("zygos_arm_t"), replace(arm, momentum_max_s=0.0)
    whole = Flight(none)
    whole.cycles(cycles)
    expected = whole.normal_equations()[0]
    monkeypatch.setattr(flight_module, "_FOLDER", tmp_path)
    small_ffi, small = flight_module._load()
    monkeypatch.setattr(flight_module, "ffi", small_ffi)
    monkeypatch.setattr(flight_module, "lib", small)
    assert small_ffi.sizeof("zygos_arm_t") < large - 15 * ffi.sizeof("zygos_momentum_block_t")
    with pytest.raises(ZygosError, match=r"no room for them; remedy: momentum_max_s = 0 in \[arc\]"):
        Flight(arm)
    config: Any = config_of(none)
    config.momentum_arc_cycles = 100
    native = small_ffi.new("zygos_arm_t *")
    assert small.zygos_arm_init(native, config) == small.ZYGOS_E_ARC
    slim = Flight(none)
    slim.cycles(cycles)
    np.testing.assert_array_equal(slim.normal_equations()[0], expected)


GYRO = 1e-5
STEP = 3e-5


@pytest.fixture(scope="module")
def floating() -> tuple[Arm, Floats, Cycles]:
    """Three joints in space that move as told for 40 s, without noise; and the true parameters.

    The base turns as Pinocchio's momentum makes it, and the torques balance the energy: no equation of motion is
    solved. Those of single motors mean nothing.
    """
    arm, model = random_arm(1, 3, "free", "spatial")
    encoder = Encoder(quantum_rad=STEP)
    joints = tuple(replace(joint, link_encoder=encoder, motor_encoder=encoder) for joint in arm.joints)
    imu = replace(arm.imu, rate_sigma=GYRO)
    arm = replace(arm, joints=joints, imu=imu, period_s=0.02, impulse_arc_s=0.0, arc_max_s=10.0)
    told, oracle, still = sines(arm, 2000), engine("pinocchio", arm, model), np.zeros(3)
    time = arm.period_s * np.arange(len(told))
    q, theta = CubicSpline(time, told.q), CubicSpline(time, told.theta)

    def base_rate(t: float, attitude: Rotation) -> Floats:
        inertia = np.stack([oracle.momentum(q(t), unit, still, still) for unit in np.eye(3)], axis=1)
        share = oracle.momentum(q(t), still, q(t, 1), theta(t, 1))
        return np.asarray(np.linalg.solve(inertia, attitude.inv().apply([2.0, -1.0, 1.5]) - share))

    omega, attitude, h = [], Rotation.identity(), arm.period_s
    for t in time:
        omega.append(base_rate(t, attitude))
        middle = base_rate(t + h / 2, attitude * Rotation.from_rotvec(h / 2 * omega[-1]))
        attitude = attitude * Rotation.from_rotvec(h * middle)
    values = model.base_values(arm)
    moved = replace(told, omega=np.array(omega) @ arm.mount)
    # over one long arc, for noise moves the ends of short ones
    return arm, values, balanced(replace(arm, momentum_max_s=0.0, arc_max_s=1e3), moved, values)


def noisy(cycles: Cycles, seed: int) -> Cycles:
    rng = np.random.default_rng(seed)
    sigma = Encoder(quantum_rad=STEP).over_the_wire.sigma_rad
    q, theta = (angle + sigma * rng.standard_normal(angle.shape) for angle in (cycles.q, cycles.theta))
    return replace(cycles, q=q, theta=theta, omega=cycles.omega + GYRO * rng.standard_normal(cycles.omega.shape))


def estimated(arm: Arm, cycles: Cycles, momentum_max_s: float) -> Estimate:
    flight = Flight(replace(arm, momentum_max_s=momentum_max_s))
    flight.cycles(cycles)
    return flight.estimate()


def test_the_solver_is_numpys(floating: tuple[Arm, Floats, Cycles]) -> None:
    """Values, what is left of the energy rows, and how near the noise is."""
    arm, _, clean = floating
    cycles = noisy(clean, 0)
    found = estimated(arm, cycles, 5.0)
    expected = reference.chain(replace(arm, momentum_max_s=5.0), cycles).solution
    off = np.abs(np.asarray(found.solution) - expected.x)
    assert (off <= 1e-9 * np.abs(expected.x) + 1e-6 * found.sigma).all()
    assert found.residual == pytest.approx(expected.residual, rel=1e-6)
    assert found.signal_to_noise == pytest.approx(expected.signal_to_noise, rel=1e-6)
    assert found.condition == pytest.approx(expected.condition, rel=1e-6)


def test_sigmas_come_from_blocks_of_both_kinds(floating: tuple[Arm, Floats, Cycles]) -> None:
    """The estimate without a block, times what the block pulls by itself, over energy and momentum blocks."""
    arm, _, clean = floating
    flight = Flight(replace(arm, momentum_max_s=5.0))
    flight.cycles(noisy(clean, 0))
    found, work = flight.estimate(), flight._work
    p, sums = len(found.names), work.sums.momentum
    places = [k for k, name in enumerate(found.names) if name.startswith(("N", "Im"))]
    blocks = closed_blocks(work.sums.energy)
    parts = [symmetric(block.gram, p + 2)[: p + 1, : p + 1] for block in blocks]
    factors = [sum(block.head.total for block in blocks) / sum(block.square for block in blocks)] * len(parts)
    for block in closed_blocks(sums):
        own = np.zeros((p + 1, p + 1))
        own[np.ix_(places, places)] = work.solver.momentum_weight * symmetric(block.rows.gram, sums.columns)
        parts.append(own)
        factors.append(1.0)
    assert sums.store.closed == 8
    whole = sum(parts, start=np.zeros(()))
    scale = 1.0 / np.sqrt(np.diag(whole))[:p]

    def solved(gram: Floats, right: Floats) -> Floats:
        return np.asarray(scale * np.linalg.solve(gram[:p, :p] * np.outer(scale, scale), right * scale))

    x = solved(whole, whole[p, :p])
    np.testing.assert_allclose(found.solution, x, rtol=1e-9)
    covariance, variances = np.zeros((p, p)), np.zeros((2, p))
    for part_of, factor in zip(parts, factors, strict=True):
        left_out = x - solved(whole - part_of, (whole - part_of)[p, :p])
        pull = part_of[p, :p] - part_of[:p, :p] @ x
        alone = solved(whole, pull)
        covariance += factor * max(1.0, pull @ left_out / (pull @ alone)) * np.outer(alone, alone)
        variances += factor * np.array([left_out * alone, alone**2])
    share = np.sqrt(variances.max(axis=0) / np.diag(covariance))
    covariance *= np.outer(share, share)
    # blocks whose residuals add up are taken to be alike; what undeclared noise may hide is added to the diagonal
    # and so is, in an arc, what the declared noise does not explain
    adds = (len(blocks) - 1) * max(0.0, 1.0 - 1.0 / found.cluster)
    unexplained = 1.0 - work.solver.noise_scale / found.noise_ratio if found.noise_ratio > 0.0 else 1.0
    arcs = sum(block.head.total for block in blocks) / work.sums.config.arc_cycles
    covariance *= 1.0 + max(adds, arcs * max(0.125, unexplained))
    # the noise of the torques, all along each block, between whose ends the sums of rows change evenly: two places
    # of Gauss are exact for the square of what is linear
    sums_of_rows, places_of = np.zeros(p), 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    for block in blocks:
        step = np.array(
            list(lib.zygos_accumulator_deviation(ffi.addressof(work, "sums", "energy"), ffi.addressof(block))[0:p])
        )
        moved = np.array([solved(whole, sums_of_rows + share_of * step) for share_of in places_of])
        covariance += block.variance[0] * moved.T @ moved / len(places_of)
        sums_of_rows += step
    apart = ~np.eye(p, dtype=bool)
    size = np.outer(found.sigma, found.sigma)
    np.testing.assert_allclose(found.covariance[apart] / size[apart], covariance[apart] / size[apart], atol=1e-6)


@pytest.mark.parametrize("momentum_max_s", [0.0, 5.0])
def test_the_covariance_is_positive_semidefinite(floating: tuple[Arm, Floats, Cycles], momentum_max_s: float) -> None:
    """There are fewer blocks than parameters, so that the covariance is singular, but no combination of values has a
    negative variance."""
    arm, _, clean = floating
    found = estimated(arm, noisy(clean, 0), momentum_max_s)
    known = np.isfinite(found.sigma)
    assert found.blocks < known.sum()
    correlation = (found.covariance / np.outer(found.sigma, found.sigma))[np.ix_(known, known)]
    assert np.linalg.eigvalsh(correlation).min() > -1e-12


def test_momentum_tells_the_inertias_apart(floating: tuple[Arm, Floats, Cycles]) -> None:
    """Kinetic energies of motions that were not seen, over eight seeds, with sigmas that are not too small."""
    arm, values, clean = floating
    rng = np.random.default_rng(1)
    states = State(*rng.normal(size=(4, 40, 3)), rng.normal(size=(40, 3)))
    bodies = np.array([name.startswith(("N", "Im")) for name in arm.parameter_names])
    columns = energy_columns(arm, states, np.zeros((40, 3)))[:, bodies]
    true = columns @ values[bodies]
    errors: dict[float, list[float]] = {0.0: [], 5.0: []}
    off = []
    for seed in range(8):
        cycles = noisy(clean, seed)
        for longest, listed in errors.items():
            estimate = estimated(arm, cycles, longest)
            assert estimate.validity in ("valid", "partial")
            listed.append(float(np.sqrt(np.mean((columns @ estimate.solution[bodies] / true - 1.0) ** 2))))
        off.append((estimate.solution - values) / estimate.sigma)
    without, beside = (np.sqrt(np.mean(np.square(errors[longest]))) for longest in errors)
    print(f"kinetic energy off by {without:.1e} without momentum rows, {beside:.1e} with them")
    assert beside < 0.2 * without
    # the parameters share their noise: eight seeds are eight draws, so three standard errors are a factor of two
    assert np.sqrt(np.nanmean(np.square(off))) < 2.0


def test_without_three_arcs_or_declared_noise_they_are_left_out(floating: tuple[Arm, Floats, Cycles]) -> None:
    arm, _, clean = floating
    cycles = noisy(clean, 0)
    plain = estimated(arm, cycles, 0.0)
    assert not np.array_equal(estimated(arm, cycles, 12.0).solution, plain.solution)  # four arcs
    for name in ("solution", "sigma", "covariance"):
        np.testing.assert_array_equal(getattr(estimated(arm, cycles, 20.0), name), getattr(plain, name))
    silent = replace(arm, compensate_every=0)
    one, other = (estimated(silent, cycles, longest) for longest in (0.0, 5.0))
    # tasks of the momentum rows take turns with those that merge blocks, so that the blocks are others
    np.testing.assert_allclose(one.solution, other.solution, rtol=1e-7)
