# SPDX-License-Identifier: MIT
"""Runs the C rooms of motor impulse and momentum behind a `Flight`, cycle by cycle; and simulated runs for both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from arm_support import random_arm
from flight_support import part
from numpy.typing import NDArray
from plant_support import lively
from runs_support import trajectory_of

from zygos.arm import Arm, Encoder, Smoother, load_arm
from zygos.balances import arcs
from zygos.effects import CATALOGUE, Effect
from zygos.model.model import load_model
from zygos.native.flight import Flight, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]
SPATIAL = Path(__file__).parents[2] / "examples" / "spatial"


def effect(key: str, joint: str, value: float = 0.0) -> Effect:
    return Effect(CATALOGUE[key], joint, value)


LIVELY_EFFECTS = (
    effect("motor_coulomb", "shoulder", 0.4),
    effect("cubic_stiffness", "elbow", 800.0),
    effect("torque_lag", "elbow", 2e-3),
    effect("motor_viscous", "elbow", 1.5),
)
"""Their order is mixed on purpose."""


@cache
def run(name: str) -> tuple[Arm, Cycles, Floats, tuple[Effect, ...]]:
    """An arm, its cycles without noise, its true parameters and those of its effects: "lively" (20 ms, four effects),
    "lively 10 ms" without effects, "spatial" (5 ms, three joints)."""
    if name == "spatial":
        arm = load_arm(SPATIAL / "arm.toml").at_period(0.005)
        model, scenario = load_model(SPATIAL / "model.toml"), load_scenario(SPATIAL / "scenario.toml")
        arm = replace(arm, smoother=Smoother(7, 4, 3))
        moved = trajectory_of(arm, model, scenario, noise=False, duration_s=2.5, rtol=1e-9, atol=1e-11)
        return arm, moved.cycles(), model.base_values(arm), ()
    arm, model, scenario = lively()
    effects = LIVELY_EFFECTS if name == "lively" else ()
    plant = replace(model, effects=effects)
    moved = trajectory_of(
        arm, plant, scenario, noise=False, period_s=0.02 if effects else 0.01, duration_s=8.0, rtol=1e-9, atol=1e-11
    )
    values = np.concatenate([model.base_values(arm), [one.value for one in effects]])
    return moved.arm, moved.cycles(), values, effects


def awkward(seed: int, joints: int, kinetic: str, flexible: Sequence[bool], latch_us: int = 0) -> Arm:
    """A random arm; encoders of different noise that latch late, and a gyro that is noisy and latches sooner."""
    arm, _ = random_arm(seed, joints, "free", kinetic, flexible)  # type: ignore[arg-type]
    changed = []
    for i, joint in enumerate(arm.joints):
        motor = Encoder(quantum_rad=2e-3 * (1 + i), latch_us=latch_us // 2)
        link = Encoder(quantum_rad=1e-3 * (1 + i)) if joint.flexible else motor
        changed.append(replace(joint, gear_ratio=2.0 + i, latch_us=latch_us, link_encoder=link, motor_encoder=motor))
    imu = replace(arm.imu, rate_sigma=0.02, latch_us=latch_us // 4)
    return replace(arm, joints=tuple(changed), imu=imu, period_s=0.02)


def wandering(arm: Arm, n: int, gap: int | None = None) -> Cycles:
    """Motion and torques without meaning; the cycle numbers jump at `gap`."""
    rng = np.random.default_rng(7)
    t = arm.period_s * np.arange(n)[:, None]
    phase = rng.uniform(0, 6, (6, arm.n))
    q = np.sin(1.3 * t + phase[0]) + 0.5 * np.sin(2.9 * t + phase[1])
    theta = q + 0.05 * np.sin(4.1 * t + phase[2])
    omega = 0.5 * np.sin([0.9, 1.7, 2.3] * t + phase[3, 0])
    sync = np.arange(n, dtype=np.uint64)
    if gap is not None:
        sync[gap:] += np.uint64(5)
    return Cycles(sync, q, theta, rng.normal(size=q.shape), omega, np.zeros(n, dtype=np.uint32))


def smoothed(arm: Arm, cycles: Cycles, longest: int) -> tuple[Samples, Smoothed, NDArray[np.int64]]:
    """The record, its smoothed instants and the arcs they belong to."""
    samples = calibrate(arm, cycles)
    instants = smooth(arm, samples)
    return samples, instants, arcs.numbered(instants, longest)


@dataclass(frozen=True)
class Rooms:
    """What the C rooms make of the smoothed instants that belong to an arc; m instants."""

    arc: NDArray[np.int64]
    impulse: Floats
    """(m, N, columns + 1), NaN where a joint has none; the impulse last."""
    momentum: Floats
    """(m, rows, K + N)"""
    noise: Floats
    """(m, K + N, K + N) that the noise of the rates owes."""


def c_rooms(arm: Arm, cycles: Cycles, longest: int, effects: Sequence[Effect] = (), noise: bool = False) -> Rooms:
    """Feed cycles to a `Flight` and its states to the two rooms; both begin an arc after `longest` instants."""
    flight = Flight(arm, effects)
    native, config = flight.native, ffi.addressof(flight.native, "sums", "config")
    impulse, momentum = ffi.new("zygos_impulse_t *"), ffi.new("zygos_momentum_t *")
    column_map = ffi.new("zygos_impulse_column_map_t *")
    pushed = ffi.new("zygos_impulse_rows_t *")
    names = (("sums", "column_map"), ("arm_state",), ("motion",))
    parts = [ffi.addressof(native, *name) for name in names]
    lib.zygos_impulse_column_map(config, column_map)
    lib.zygos_impulse_reset(impulse)
    lib.zygos_momentum_reset(momentum)
    width = native.sums.column_map.kinetic + arm.n
    rows = lib.zygos_momentum_count(config)
    line = ffi.new("double[]", width)
    variance, rotor = ffi.new("double[]", arm.n + 3), ffi.new("double[]", arm.n)
    lib.zygos_momentum_variance(
        config, ffi.addressof(native, "smoother"), arm.imu.over_the_wire.rate_sigma, variance, rotor
    )
    found: list[tuple[int, Floats, Floats, Floats]] = []
    arc, inside = -1, longest
    for k in range(len(cycles)):
        flight.cycles(part(cycles, k, k + 1))
        if native.smoother.filled < native.smoother.window:
            lib.zygos_impulse_reset(impulse)
            lib.zygos_momentum_reset(momentum)
            inside = longest
            continue
        at = native.balance.torque_at
        before = native.balance.torque[0][at]
        after = native.balance.torque[0][0 if at == config.smoother_half_width else at + 1]
        of_arc = lib.zygos_impulse_row(impulse, config, column_map, parts[1], parts[2], before, after, pushed)
        assert lib.zygos_momentum_advance(momentum, config, parts[1]) == of_arc
        if not of_arc:
            continue
        if inside == longest:
            arc, inside = arc + 1, 0
        inside += 1
        own = np.full((arm.n, 3 + len(effects) + 1), np.nan)
        for i in range(arm.n):
            if column_map.count[i]:
                own[i, : column_map.count[i]] = list(pushed.column[i])[: column_map.count[i]]
                own[i, -1] = pushed.impulse[i]
        owed = np.zeros((width, width))
        if noise:
            for component, signal in np.ndindex(rows, arm.n + (3 if arm.spatial else 1)):
                lib.zygos_momentum_derivative(momentum, config, parts[2], component, signal, line)
                owed += variance[signal] * np.outer(list(line), list(line))
            owed[range(width - arm.n, width), range(width - arm.n, width)] += list(rotor)
        matrix = np.zeros((rows, width))
        for component in range(rows):
            lib.zygos_momentum_row(momentum, config, *parts[1:], component, line)
            matrix[component] = list(line)
        if inside == longest:
            lib.zygos_impulse_new_arc(impulse)
            lib.zygos_momentum_new_arc(momentum)
        found.append((arc, own, matrix, owed))
    numbers, own_rows, matrices, debts = zip(*found, strict=True)
    return Rooms(np.array(numbers), np.stack(own_rows), np.stack(matrices), np.stack(debts))


def less_means(rows: Floats, arc: NDArray[np.int64]) -> Floats:
    """Rows (m, ...) less the mean of their arc."""
    out = rows.copy()
    for number in np.unique(arc):
        out[arc == number] -= out[arc == number].mean(axis=0)
    return out
