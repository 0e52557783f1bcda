# SPDX-License-Identifier: MIT
"""Simulated runs over CAN, of plants that have more than the filter knows or not, refined and scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from arm_support import exact_torques
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import Arm, load_arm
from zygos.can.run import Run
from zygos.effects import effect
from zygos.errors import Undecided
from zygos.model.model import Model, Quantity, load_model
from zygos.native.flight import Flight, ffi, lib
from zygos.native.refine import OnboardRefiner
from zygos.refinement.inertia import inertia_errors
from zygos.refinement.refine import Refinement, refine_runs
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario, load_scenario
from zygos.simulation.sensors import draw_noise

Floats = NDArray[np.float64]

SIGMAS, SHARE = 5.0, 0.005
"""A published value may be off by so many sigmas, or by so much of its size; not by both."""
LEARNED_S = 60.0
"""From so much of a run comes the estimate with which the refinement begins."""


@dataclass(frozen=True)
class Case:
    """What a run has, and what its arm file says of it."""

    example: str = "paper"
    noise: float = 0.005
    """Of the torques, as a share of their size."""
    declared: float | None = None
    """The same by the arm file; None: as it is."""
    effects: tuple[tuple[str, float], ...] = ()
    """Effects of all joints of the plant, of which the filter is not told, and their values."""
    gain: float = 1.0
    """Of the last joint's torque, reported divided by acting one."""
    duration_s: float | None = None
    mounted: bool = False
    """Whether the zero of each encoder is off by up to half of its step."""

    @property
    def arm(self) -> Arm:
        """The arm as its file describes it."""
        return noisy(self.example, self.noise if self.declared is None else self.declared)


@dataclass(frozen=True)
class Score:
    """A refinement beside the truth; p parameters."""

    found: Refinement | None
    """None where there was no start."""
    reason: str
    """Why nothing was published; empty where it was."""
    error: Floats
    """(p,) in units of the sizes; NaN without a result."""
    sigma: Floats
    """(p,) likewise."""
    inertia: tuple[float, float] | None
    """Worst and median error of the inertia matrix, per cent; of an arm in space."""

    @property
    def published(self) -> bool:
        return not self.reason

    @property
    def harmful(self) -> bool:
        """Whether a published value is far off, and its interval does not say so."""
        off = np.abs(self.error)
        return self.published and bool(np.any((off > SIGMAS * self.sigma) & (off > SHARE)))


def noisy(example: str, share: float) -> Arm:
    """The arm of an example with noise of its torques, whose sensors have exact gains."""
    arm = exact_torques(load_arm(ROOT / "examples" / example / "arm.toml"))
    return replace(arm, joints=tuple(replace(joint, torque_relative_sigma=share) for joint in arm.joints))


@cache
def plant(example: str, effects: tuple[tuple[str, float], ...] = ()) -> Model:
    """The model of an example with effects at all joints."""
    arm = load_arm(ROOT / "examples" / example / "arm.toml")
    listed = tuple(effect(key, joint.name, value) for key, value in effects for joint in arm.joints)
    return replace(load_model(ROOT / "examples" / example / "model.toml"), effects=listed)


def drawing(example: str, seed: int, share: float = 0.01) -> Model:
    """The model of an example as a drawing office may have it: masses, inertias and drives are off by a share."""
    model, rng = plant(example), np.random.default_rng([seed, 1])

    def off(one: Quantity) -> Quantity:
        return replace(one, value=one.value * (1.0 + share * float(rng.normal())))

    bodies = tuple(
        replace(one, mass=off(one.mass), inertia=tuple(replace(part, value=part.value * scale) for part in one.inertia))
        for one, scale in zip(model.bodies, 1.0 + share * rng.normal(size=len(model.bodies)), strict=True)
    )
    joints = tuple(
        replace(one, rotor_inertia=off(one.rotor_inertia), stiffness=off(one.stiffness), damping=off(one.damping))
        for one in model.joints
    )
    return replace(model, bodies=bodies, joints=joints)


@cache
def moved(
    example: str, effects: tuple[tuple[str, float], ...], duration_s: float | None, rtol: float = 1e-10
) -> Trajectory:
    """One simulated motion. The noise of the torques has no part in it, and that of other seeds may be read from it."""
    arm = load_arm(ROOT / "examples" / example / "arm.toml")
    return trajectory_of(
        arm, plant(example, effects), scenario_of(example), seeds=[0], duration_s=duration_s, rtol=rtol, atol=rtol / 100
    )


def scenario_of(example: str) -> Scenario:
    """The motion of an example."""
    return load_scenario(ROOT / "examples" / example / "scenario.toml")


def sensed(case: Case, seed: int, run: Trajectory) -> Cycles:
    """What the sensors of a seed say of a motion."""
    arm, encoder_noise = noisy(case.example, case.noise), scenario_of(case.example).encoder_noise
    noise = draw_noise(arm, len(run.t), [seed], encoder_noise)
    return reported(case, seed, replace(run, noise=noise).cycles())


def runs(case: Case, seeds: Sequence[int]) -> Mapping[int, Run]:
    """What the sensors of each seed say, as frames of the bus."""
    run = moved(case.example, case.effects, case.duration_s)
    return {seed: Run.of_cycles(case.arm, sensed(case, seed, run)) for seed in seeds}


def reported(case: Case, seed: int, cycles: Cycles) -> Cycles:
    """Cycles as the sensors of the case report them: with the gain of the last joint's torque, and with their zeros."""
    gains = np.ones(case.arm.n)
    gains[-1] = case.gain
    off = zeros(case.arm, seed) * case.mounted
    return replace(cycles, q=cycles.q + off[0], theta=cycles.theta + off[1], tau=cycles.tau * gains)


def zeros(arm: Arm, seed: int) -> Floats:
    """(2, N) zeros of link and motor encoders that are mounted to a step, rad."""
    steps = [
        [one.link_encoder.quantum_rad for one in arm.joints],
        [one.motor_encoder.quantum_rad for one in arm.joints],
    ]
    return np.asarray(np.array(steps) * np.random.default_rng([seed, 2]).uniform(-0.5, 0.5, (2, arm.n)))


def score(case: Case, run: Run, prior: Model | None = None) -> Score:
    """Refine a run, and compare with the truth."""
    arm, truth = case.arm, plant(case.example).base_values(case.arm)
    try:
        found = refine_runs([run], model=prior)
    except Undecided as refused:
        nothing = np.full(len(truth), np.nan)
        return Score(None, str(refused), nothing, nothing, None)
    inertia = inertia_errors(arm, found.value[None], truth) if arm.free and arm.spatial else None
    return Score(found, found.reason, (found.value - truth) / found.size, found.sigma / found.size, inertia)


@cache
def flown(case: Case, seed: int, duration_s: float = 120.0) -> Cycles:
    """The cycles of a run, as the sensors of the case report them."""
    return sensed(case, seed, moved(case.example, case.effects, duration_s, 1e-6))


def selected(cycles: Cycles, chosen: slice | NDArray[np.bool_]) -> Cycles:
    """Some of the cycles."""
    names = ("sync", "q", "theta", "tau", "omega", "flags")
    return replace(cycles, **{name: getattr(cycles, name)[chosen] for name in names})


def learned(arm: Arm, cycles: Cycles) -> tuple[Flight, Cycles]:
    """A flight that knows the first part of a run, and the rest."""
    n = round(LEARNED_S / arm.period_s)
    flight = Flight(arm)
    flight.cycles(selected(cycles, slice(0, n)))
    return flight, selected(cycles, slice(n, None))


def reseal(task: OnboardRefiner) -> None:
    """Seal estimate and sums of a task that waits for a cycle and uses readings in each: as if what was changed in
    them had come about in flight."""
    native = task.native
    native.estimate_seal = lib.zygos_checksum_doubles(0, native.filter.x, native.filter.entries)
    first, end = (ffi.offsetof("zygos_refine_t", name) for name in ("walk", "means"))
    seal = lib.zygos_checksum_memory(0, ffi.cast("char *", native) + first, end - first)
    for name in ("previous", "angle"):
        member = ffi.addressof(native, name)
        seal = lib.zygos_checksum_memory(seal, member, ffi.sizeof(member[0]))
    native.sums_seal = seal
