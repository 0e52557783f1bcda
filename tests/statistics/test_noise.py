# SPDX-License-Identifier: MIT
"""What noise adds to the rows' squares: the flight library against draws of raw samples, and against its numpy twin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from arm_support import State as Sample
from arm_support import random_arm, random_state
from flight_support import sines, waits
from noise_support import Floats, NoiseRoom, measured, noisy_rows
from scipy.stats import norm

from zygos import reference
from zygos.arm import Arm, load_arm
from zygos.effects import CATALOGUE, Effect
from zygos.native.flight import Flight
from zygos.runs.cycles import Cycles

DRAWS = 10_000
PAIRS = 70
LATE = (1500, 2300, 900)
"""Link encoders, motor encoders and gyro, us."""
PAPER = Path(__file__).parents[2] / "examples" / "paper" / "arm.toml"


class Drawn(NamedTuple):
    """Averages over draws and their standard errors, (p+1, p+1) or (k,)."""

    mean: Floats
    error: Floats


ARMS: dict[str, Callable[[], Arm]] = {
    "paper": lambda: load_arm(PAPER),
    "planar": lambda: random_arm(1, 3, "free", "planar")[0],
    "space": lambda: random_arm(2, 3, "free")[0],
    "fixed": lambda: random_arm(3, 3, "fixed")[0],
    "fixed plane": lambda: random_arm(4, 2, "fixed", "planar")[0],
    "rigid": lambda: random_arm(5, 3, "free", "spatial", [True, False, True])[0],
    "rigid, fixed": lambda: random_arm(6, 2, "fixed", "planar-symmetric", [False, True])[0],
}
CASES = [(name, latch) for name in ARMS for latch in ((0, 0, 0), LATE)]
IDS = [f"{name}, {'late' if any(latch) else 'prompt'}" for name, latch in CASES]


def state_of(arm: Arm) -> tuple[Sample, Floats]:
    """A state, and the torques after it."""
    rng = np.random.default_rng(arm.n)
    sample = random_state(rng, arm)
    return sample, sample.tau + rng.normal(size=arm.n)


def drawn_moment(arm: Arm, sample: Sample, tau_next: Floats) -> Drawn:
    """E z z^T - z0 z0^T. A draw and its opposite together leave out what is linear in the noise."""
    rng = np.random.default_rng(0)
    total, squares, done = np.zeros(()), np.zeros(()), 0
    while done < DRAWS:
        truth, ahead, back = noisy_rows(rng, arm, sample, tau_next, 2_000)
        pairs = [row[:, :, None] * row[:, None, :] for row in (ahead, back)]
        added = 0.5 * (pairs[0] + pairs[1]) - np.outer(truth, truth)
        # what noise adds to the mean row is another matter, and comes in with the truth beside it
        bent = 0.5 * (ahead + back) - truth
        added -= bent[:, :, None] * truth[None, None, :] + truth[None, :, None] * bent[:, None, :]
        total, squares = total + added.sum(axis=0), squares + (added**2).sum(axis=0)
        done += len(ahead)
    mean = total / done
    return Drawn(mean, np.sqrt(np.maximum(squares / done - mean**2, 0.0) / done))


def agree(drawn: Drawn, value: Floats, floor: Floats) -> bool:
    """Whether all entries lie within what the largest of so many standard normal numbers stays in 997 times of 1000.

    floor: what rounding leaves of an entry.
    """
    band = norm.isf(0.0027 / 2.0 / value.size)
    return bool(np.all(np.abs(drawn.mean - value) <= band * drawn.error + floor))


@pytest.mark.slow(but=["paper, prompt", "paper, late"])
@pytest.mark.parametrize(("name", "latch"), CASES, ids=IDS)
def test_squares_grow_as_the_library_says(name: str, latch: tuple[int, int, int]) -> None:
    arm = measured(ARMS[name](), period_s=0.02, sigma=2e-5, gyro=4e-4, latch_us=latch)
    sample, tau_next = state_of(arm)
    moment = NoiseRoom(arm).moment(sample, tau_next)
    # what has been integrated until the instant is the other tests' matter
    kinds = ["body"] * len(arm.body_parameters) + [kind for kind, _, _ in arm.joint_parameters] + ["work"]
    alive = np.array(kinds) != "b"
    drawn = drawn_moment(arm, sample, tau_next)
    size = np.sqrt(np.diag(drawn.mean))
    floor = 1e-6 * np.outer(size, size)
    assert np.all(size[alive] > 0.0)
    drawn = Drawn(drawn.mean[np.ix_(alive, alive)], drawn.error[np.ix_(alive, alive)])
    moment, floor = moment[np.ix_(alive, alive)], floor[np.ix_(alive, alive)]
    assert agree(drawn, moment, floor)
    # the band is narrow enough to see an error of a tenth, in all or in one entry
    assert not agree(drawn, 1.1 * moment, floor)
    i, j = np.unravel_index(np.argmax(np.abs(np.tril(moment, -1)) / drawn.error), moment.shape)
    wrong = moment.copy()
    wrong[i, j] *= 1.1
    assert not agree(drawn, wrong, floor)


@pytest.mark.slow(but=["paper, prompt", "paper, late", "fixed, late"])
@pytest.mark.parametrize(("name", "latch"), CASES, ids=IDS)
def test_kinetic_columns_grow_as_the_library_says(name: str, latch: tuple[int, int, int]) -> None:
    """At a short period: what the noise of the angles adds is smaller by the square of period times rate."""
    latch = tuple(late // 10 for late in latch)  # type: ignore[assignment]
    arm = measured(ARMS[name](), period_s=0.002, sigma=2e-6, gyro=4e-4, latch_us=latch)
    sample, tau_next = state_of(arm)
    mean = NoiseRoom(arm).mean(sample)
    truth, ahead, back = noisy_rows(np.random.default_rng(1), arm, sample, tau_next, DRAWS)
    kinetic = [k for k, (_, unit) in enumerate(arm.body_parameters) if unit == "kg m^2"]
    assert not np.any(np.delete(mean, kinetic))
    grown = (0.5 * (ahead + back) - truth)[:, kinetic]
    drawn = Drawn(grown.mean(axis=0), grown.std(axis=0) / np.sqrt(DRAWS))
    floor = np.full(len(kinetic), 2e-3 * np.abs(mean).max())
    assert agree(drawn, mean[kinetic], floor)
    assert not agree(drawn, 1.1 * mean[kinetic], floor)


def moving(arm: Arm, n: int) -> Cycles:
    """Slow motion with torques that have nothing to do with it: what noise adds to rows does not depend on that."""
    cycles = sines(arm, n)
    t = arm.period_s * np.arange(n)[:, None]
    cycles.tau[:] = 0.3 * np.sin((1.1 + 0.2 * np.arange(arm.n)) * t)
    soft = np.array([joint.flexible for joint in arm.joints])
    cycles.theta[:] = np.where(soft, cycles.theta, cycles.q)
    omega = 0.3 * np.sin(t * [0.57, 0.71, 0.33] + [0.5, 1.0, 2.0])
    return replace(cycles, omega=omega if arm.free else np.zeros_like(omega))


def noises(rng: np.random.Generator, arm: Arm, cycles: Cycles) -> tuple[Floats, Floats, Floats]:
    """Of link angles, motor angles and gyro of a record."""
    links = np.array([joint.link_encoder.over_the_wire.sigma_rad for joint in arm.joints])
    motors = np.array([joint.motor_encoder.over_the_wire.sigma_rad for joint in arm.joints])
    gyro = arm.imu.over_the_wire.rate_sigma if arm.free else 0.0
    return (
        links * rng.normal(size=cycles.q.shape),
        motors * rng.normal(size=cycles.theta.shape),
        gyro * rng.normal(size=cycles.omega.shape),
    )


def with_noise(cycles: Cycles, errors: tuple[Floats, Floats, Floats], sign: float = 1.0) -> Cycles:
    q, theta, omega = errors
    return replace(cycles, q=cycles.q + sign * q, theta=cycles.theta + sign * theta, omega=cycles.omega + sign * omega)


def every_effect(arm: Arm) -> list[Effect]:
    """One of each kind that has a column, the joints taken in turn."""
    kinds = [kind for kind in CATALOGUE.values() if kind.flies and kind.place not in ("rotor", "base")]
    return [Effect(kind, arm.joints[k % arm.n].name, 0.0) for k, kind in enumerate(kinds)]


RANDOM = [
    (seed, joints, base, kinetic, kind, (None, 1, 2, 3)[seed % 4])
    for seed, (joints, base, kinetic, kind) in enumerate(
        [
            (1, "free", "spatial", "flexible"),
            (2, "free", "planar-symmetric", "mixed"),
            (3, "free", "planar", "flexible"),
            (3, "free", "spatial", "mixed"),
            (5, "free", "spatial", "flexible"),
            (7, "free", "spatial", "mixed"),
            (1, "fixed", "spatial", "flexible"),
            (2, "fixed", "spatial", "rigid"),
            (3, "fixed", "planar", "mixed"),
            (4, "fixed", "planar-symmetric", "flexible"),
            (4, "fixed", "spatial", "mixed"),
            (7, "fixed", "spatial", "flexible"),
        ]
    )
]
"""Of these twelve, each law of the torques meets each way to take the noise off."""


@pytest.mark.slow(only=["*-7-*", "4*", "10*", "9*", "3*"])
@pytest.mark.parametrize(("seed", "joints", "base", "kinetic", "kind", "every"), RANDOM)
def test_library_and_twin(seed: int, joints: int, base: str, kinetic: str, kind: str, every: int | None) -> None:
    flexible = [{"flexible": True, "rigid": False, "mixed": i % 2 == seed % 2}[kind] for i in range(joints)]
    arm, _ = random_arm(seed, joints, base, kinetic, flexible)  # type: ignore[arg-type]
    law = ("applied_from_sync", "applied_previous_cycle", "sampled")[seed % 3]
    arm = measured(arm, period_s=0.02, sigma=2e-5, gyro=4e-4, latch_us=LATE)
    arm = replace(arm, torque_law=law, compensate_every=every, arc_max_s=2.3)  # type: ignore[arg-type]
    cycles = moving(arm, 280)
    cycles = with_noise(cycles, noises(np.random.default_rng(seed), arm, cycles))
    cycles.q[57, 0] += 0.01  # the bandwidth test refuses the instants around
    cycles.theta[62, 0] += 0.01
    springs = {joint.name for joint in arm.joints if joint.flexible}
    effects = [effect for effect in every_effect(arm) if effect.joint in springs]
    flight = Flight(arm, effects)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    samples = replace(reference.calibrate(arm, cycles), waited=waits(cycles, trace))
    smoothed = reference.smooth(arm, samples)
    raw = reference.energy_rows(arm, samples, smoothed, effects)
    added = reference.noise_of(arm, samples, smoothed, raw, effects)
    rows = np.column_stack([raw.z - added.mean, raw.w])
    assert 4 <= np.sum(~raw.accepted) < 0.1 * len(raw.w)
    scale = np.abs(rows).max(axis=0)
    assert np.max(np.abs(trace.row[trace.instant] - rows) / scale) < 1e-12
    design = reference.design(raw, added.moment)
    size = np.sqrt(np.diag(design.noise))
    assert np.all(size > 0.0)
    assert np.max(np.abs(flight.noise() - design.noise) / np.outer(size, size)) < 1e-11


def test_switched_off() -> None:
    arm = replace(measured(load_arm(PAPER), period_s=0.02, sigma=2e-5, gyro=4e-4), compensate_every=0)
    cycles = moving(arm, 200)
    flight = Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    chain = reference.chain(arm, cycles)
    assert not flight.noise().any()
    assert not chain.design.noise.any()
    np.testing.assert_array_equal(NoiseRoom(arm).mean(state_of(arm)[0]), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "planar", "fixed plane", "rigid"])
def test_sums_of_a_run_are_those_without_noise(name: str) -> None:
    """The whole chain, integrals included: what is summed over noisy runs is on average what a silent run sums.

    The mean of an arc, which is taken off, holds some of the noise: a share like 1 / instants of each square remains.
    And a column that waves with an angle shrinks by half the square of its noise, and so does the size of its
    parameter.
    """
    arm = measured(ARMS[name](), period_s=0.02, sigma=2e-5, gyro=4e-5)
    silent = moving(arm, 300)
    rng = np.random.default_rng(3)

    def sums(cycles: Cycles, every: int) -> Floats | None:
        flight = Flight(replace(arm, compensate_every=every))
        flight.cycles(cycles)
        return None if flight.counts["refused"] else np.vstack(flight.normal_equations())

    truth = sums(silent, 0)
    assert truth is not None
    taken = []
    for _ in range(PAIRS):
        errors = noises(rng, arm, silent)
        pair = [sums(with_noise(silent, errors, sign), 1) for sign in (1.0, -1.0)]
        if pair[0] is not None and pair[1] is not None:
            taken.append(0.5 * (pair[0] + pair[1]) - truth)
    assert len(taken) > 0.8 * PAIRS
    drawn = Drawn(np.mean(taken, axis=0), np.std(taken, axis=0) / np.sqrt(len(taken)))
    flight = Flight(arm)
    trace = flight.cycles(silent, trace=True)
    assert trace is not None
    added = flight.noise()[:, :-1]
    size = np.sqrt(np.diag(flight.noise()))
    length = np.linalg.norm(trace.row[trace.instant] - trace.row[trace.instant].mean(axis=0), axis=0)
    waves = sum(joint.motor_encoder.sigma_rad**2 + joint.link_encoder.sigma_rad**2 for joint in arm.joints)
    shrunk = 2.0 * waves * np.outer(length, length)
    bodies = len(arm.body_parameters)
    shrunk[bodies:, bodies:] = 0.0
    floor = (0.025 * np.outer(size, size) + shrunk)[:, :-1]
    assert agree(drawn, np.zeros_like(added), floor)
    assert not agree(drawn, 0.1 * added, floor)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "planar", "fixed plane", "rigid"])
def test_what_is_integrated_is_correlated_with_the_instant(name: str) -> None:
    """Half the difference of a noisy run and its opposite is linear in the noise: its squares are what is summed.

    Work and dissipation since the arc began are among its columns. What their steps hold is not quite the noise of the
    newest angle: the rule of the dissipation's steps passes up to 15 % less of its square, and torques that change add
    some to that of the work. What they share with the other columns is as good as the rest.
    """
    arm = measured(ARMS[name](), period_s=0.02, sigma=2e-5, gyro=4e-5)
    silent = moving(arm, 300)
    rng = np.random.default_rng(4)
    squares = []
    for _ in range(PAIRS):
        errors = noises(rng, arm, silent)
        ahead, back = (Flight(arm).cycles(with_noise(silent, errors, sign), trace=True) for sign in (1.0, -1.0))
        assert ahead is not None and back is not None
        odd = 0.5 * (ahead.row - back.row)[ahead.instant]
        odd -= odd.mean(axis=0)
        squares.append(odd.T @ odd)
    flight = Flight(arm)
    flight.cycles(silent)
    added = flight.noise()
    size = np.sqrt(np.diag(added))
    drawn = Drawn(np.mean(squares, axis=0), np.std(squares, axis=0) / np.sqrt(PAIRS))
    kinds = np.array(["body"] * len(arm.body_parameters) + [kind for kind, _, _ in arm.joint_parameters] + ["work"])
    integral = np.isin(kinds, ["b", "work"])
    share = np.where(np.outer(integral, integral), 0.2, 0.025)
    floor = share * np.outer(size, size)
    assert agree(drawn, added, floor)
    for wrong in (0.9, 1.1):
        assert not agree(drawn, wrong * added, floor)
    for kind in ("b", "work"):
        k = int(np.flatnonzero(kinds == kind)[0])
        half = added.copy()
        half[k, k] *= 0.5
        assert not agree(drawn, half, floor)
