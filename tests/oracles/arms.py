# SPDX-License-Identifier: MIT
"""The arms of the trials: what is drawn, what was built, how they move, and what their sensors make of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from laboratory_support import laboratory_arm
from numpy.typing import NDArray

from oracles.demo_log import built
from oracles.hidden import Law, Motion, Readings, SensorError
from oracles.tree import Payload, Swinging, TreePlant
from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother, load_arm
from zygos.model.model import Body, JointModel, Model, Quantity, load_model
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Controller, Scenario, Sine, load_scenario
from zygos.simulation.scenario import Motion as Desired

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


NADIR = (0.48, -0.6, 0.64)
"""Where the Earth is when a run of the satellite begins, in the axes of its base."""


@dataclass(frozen=True)
class Trial:
    """An arm as drawn, with the motions of three runs."""

    arm: Arm
    drawn: Model
    scenarios: tuple[Scenario, Scenario, Scenario]
    table: bool
    """Whether runs are tables of cycles, and not CAN logs."""


@dataclass(frozen=True)
class Dirt:
    """What the torque sensors of a plant have and its arm file does not say."""

    noise: Array
    """(N,) share of the torque's rms."""
    gain: Array
    """(N,) share by which the reported torque is too large; 0 at the first joint, since only ratios can be known."""
    offset: Array
    """(N,) share of the torque's rms."""


def _loose(model: Model, share: float) -> Model:
    """The model with a standard deviation of every mass, moment and drive."""

    def unsure(quantity: Quantity, times: float = 1.0) -> Quantity:
        return replace(quantity, sigma=times * share * abs(quantity.value) if np.isfinite(quantity.value) else 0.0)

    bodies = []
    for body in model.bodies:
        # products of inertia keep their share of the moments
        ixx, ixy, ixz, iyy, iyz, izz = body.inertia
        inertia = (unsure(ixx), ixy, ixz, unsure(iyy), iyz, unsure(izz))
        bodies.append(replace(body, mass=unsure(body.mass), inertia=inertia))
    joints = [
        replace(
            joint,
            rotor_inertia=unsure(joint.rotor_inertia, 2.0),
            stiffness=unsure(joint.stiffness, 2.0),
            damping=unsure(joint.damping, 4.0),
        )
        for joint in model.joints
    ]
    return replace(model, bodies=tuple(bodies), joints=tuple(joints))


def _sines(
    arm: Arm, seed: int, centre: Sequence[float], reach: float, slow: float, fast: float, count: int = 4
) -> dict[str, Desired]:
    """Sums of sines that no two joints share, with random amplitudes and phases, from rest."""
    rng = np.random.default_rng([77, seed])
    out = {}
    for i, joint in enumerate(arm.joints):
        omega = np.geomspace(slow, fast, count) * (1.0 + 0.07 * i + rng.uniform(-0.03, 0.03, count))
        size = rng.uniform(0.4, 1.0, count) * (slow / omega) ** 0.5
        size *= reach / size.sum()
        # cosines start at rest
        sign = rng.choice([-1.0, 1.0], count)
        sines = tuple(Sine(float(a), float(w), float(s * np.pi / 2)) for a, w, s in zip(size, omega, sign, strict=True))
        out[joint.name] = Desired(float(centre[i]), sines)
    return out


def _start(arm: Arm, motions: dict[str, Desired]) -> tuple[float, ...]:
    return tuple(float(motions[joint.name].desired(np.zeros(1))[0][0]) for joint in arm.joints)


def _scenarios(
    arm: Arm,
    duration: float,
    centres: Sequence[Sequence[float]],
    reach: float,
    slow: float,
    fast: float,
    controller: Controller,
) -> tuple[Scenario, Scenario, Scenario]:
    runs = []
    for k, centre in enumerate(centres):
        motions = _sines(arm, k, centre, reach, slow, fast)
        path = Path("arm.toml")
        runs.append(
            Scenario(
                "abc"[k],
                path,
                path,
                duration,
                motions,
                controller,
                angular_momentum_nms=0.0,
                initial_angles_rad=_start(arm, motions),
            )
        )
    return runs[0], runs[1], runs[2]


@cache
def planar() -> Trial:
    """The paper's arm with modern sensors: planar, free, two flexible joints (examples/gap)."""
    folder = EXAMPLES / "gap"
    runs = [load_scenario(folder / f"{name}.toml") for name in "abc"]
    return Trial(load_arm(folder / "arm.toml"), load_model(folder / "cad.toml"), (runs[0], runs[1], runs[2]), False)


@cache
def coarse() -> Trial:
    """The same arm with the sensors of the paper, 3 mrad at 20 Hz, and large motions (examples/lively)."""
    folder = EXAMPLES / "lively"
    # the example's longer window shows how the laws differ in form from the columns
    arm = replace(load_arm(folder / "arm.toml"), smoother=Smoother())
    one = load_scenario(folder / "scenario.toml")
    motions = ((0.9, 0.6, 0.8, 1.1), (0.8, 0.75, 0.7, 1.0), (0.9, 0.5, 0.8, 1.3))
    runs = [
        replace(
            one,
            angular_momentum_nms=0.0,
            manoeuvre={
                "shoulder": Desired(1.25, (Sine(first, slow),)),
                "elbow": Desired(-2.0, (Sine(second, fast),)),
            },
        )
        for first, slow, second, fast in motions
    ]
    return Trial(arm, load_model(EXAMPLES / "gap" / "cad.toml"), (runs[0], runs[1], runs[2]), False)


@cache
def spatial() -> Trial:
    """A servicing arm with three flexible joints on a satellite that floats in space (examples/spatial)."""
    folder = EXAMPLES / "spatial"
    arm = replace(
        load_arm(folder / "arm.toml").at_period(0.004), arc_max_s=10.0, smoother=Smoother(9, 4, 4), nadir=NADIR
    )
    model = _loose(load_model(folder / "model.toml"), 0.01)
    controller = Controller((260.0, 220.0, 90.0), (45.0, 40.0, 17.0))
    centres = ((0.0, -0.3, 0.9), (0.4, -0.1, 1.3), (-0.3, 0.1, 0.7))
    return Trial(arm, model, _scenarios(arm, 30.0, centres, 1.1, 0.9, 3.4, controller), False)


@cache
def pendulum() -> Trial:
    """Two rigid joints in a vertical plane on the ground: geared drives that report the torque of their motors."""
    encoder = Encoder(2.0 * np.pi / 2**18, 2**18)
    joints = tuple(
        Joint(name, node, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 6.0, encoder, encoder, flexible=False, position_m=place)
        for name, node, place in (("shoulder", 1, (0.0, 0.0, 0.0)), ("elbow", 2, (0.0, 0.0, -0.3)))
    )
    arm = Arm("pendulum", "fixed", "planar", 0.004, "sampled", "rotor", joints, NO_IMU, smoother=Smoother(21, 4, 10),
              gravity=(0.0, 0.0, -9.81))  # fmt: skip

    def body(name: str, mass: float, centre: float, moment: float, end: tuple[float, float, float] | None) -> Body:
        moments = tuple(Quantity(x) for x in (moment, 0.0, 0.0, moment, 0.0, 0.1 * moment))
        return Body(name, Quantity(mass), (0.0, 0.01, centre), moments, end)  # type: ignore[arg-type]

    bodies = (
        Body("stand", Quantity(0.0), (0.0, 0.0, 0.0), (Quantity(0.0),) * 6, (0.0, 0.0, 0.0)),
        body("upper", 0.95, -0.22, 0.03, (0.0, 0.0, -0.3)),
        body("lower", 0.55, -0.15, 0.008, None),
    )
    drives = tuple(
        JointModel(joint.name, Quantity(0.0), Quantity(6e-5), Quantity(np.inf), Quantity(0.0)) for joint in joints
    )
    model = _loose(Model("pendulum", bodies, drives), 0.01)
    centres = ((0.3, 0.2), (-0.5, 0.6), (0.1, -0.7))
    return Trial(arm, model, _scenarios(arm, 40.0, centres, 2.0, 1.1, 7.0, Controller()), True)


@cache
def six() -> Trial:
    """The geometry of a UR10e on the ground, with torque sensors behind the gears."""
    arm, model = laboratory_arm("UR10e", period_s=0.004, torque_law="sampled", friction=False)
    encoder = Encoder(2.0 * np.pi / 2**19, 2**19)
    joints = tuple(
        replace(joint, torque_sigma=0.0, link_encoder=encoder, motor_encoder=encoder, gear_ratio=1.0)
        for joint in arm.joints
    )
    arm = replace(arm, torque_at="joint", joints=joints, smoother=Smoother(21, 4, 10))
    drives = tuple(replace(joint, rotor_inertia=Quantity(1e-9)) for joint in model.joints)
    model = _loose(replace(model, joints=drives, effects=()), 0.01)
    centres = ((0.2, -0.6, 0.9, -0.3, 0.5, 0.0), (-0.4, -0.2, 0.3, 0.6, -0.5, 0.4), (0.5, 0.3, -0.6, 0.2, 0.9, -0.3))
    return Trial(arm, model, _scenarios(arm, 40.0, centres, 1.6, 0.8, 3.6, Controller()), True)


ARMS: dict[str, Callable[[], Trial]] = {
    "planar": planar,
    "coarse": coarse,
    "spatial": spatial,
    "pendulum": pendulum,
    "six": six,
}


@dataclass(frozen=True)
class Plant:
    """What is hidden of one plant; nothing of it reaches the product."""

    trial: Trial
    model: Model
    """As it was built."""
    laws: tuple[Law, ...] = ()
    sensors: tuple[SensorError, ...] = ()
    payload: Payload | None = None
    momentum: float | None = None
    dirt: Dirt | None = None
    swinging: Swinging | None = None

    def run(self, which: int, seed: int, duration_s: float | None = None) -> tuple[Cycles, Motion]:
        """What is recorded of run 0, 1 or 2, and its exact motion. seed: of the sensors."""
        arm, scenario = self.trial.arm, self.trial.scenarios[which]
        if self.momentum is not None:
            scenario = replace(scenario, angular_momentum_nms=self.momentum)
        quantum = np.array([joint.motor_encoder.quantum_rad for joint in arm.joints])
        plant = TreePlant(arm, self.model, self.swinging)
        # the arm takes its payload up in the second run, and keeps it
        payload = self.payload
        if payload is not None:
            payload = (None, payload, replace(payload, instant=0.0))[which]
        motion = plant.run(scenario, self.laws, quantum=quantum, payload=payload, duration_s=duration_s)
        return self._recorded(motion, np.random.default_rng([seed, which, 1757])), motion

    def _recorded(self, motion: Motion, random: np.random.Generator) -> Cycles:
        arm, n = self.trial.arm, len(motion.t)
        readings = Readings(motion.q, motion.theta, motion.omega, motion.tau)
        for error in self.sensors:
            readings = error.change(motion, readings, error.joint, error.size)
        tau = readings.tau
        if self.dirt is not None:
            rms = np.sqrt(np.mean(tau**2, axis=0))
            white = random.standard_normal(tau.shape)
            tau = (1.0 + self.dirt.gain) * tau + rms * (self.dirt.offset + self.dirt.noise * white)
        if self.trial.table:
            # of 16 bits, over four times the largest torque
            step = 4.0 * np.max(np.abs(motion.tau), axis=0) / 2**16
            tau = step * np.rint(tau / step)
        angles = []
        for values, side in ((readings.q, "link_encoder"), (readings.theta, "motor_encoder")):
            encoders = [getattr(joint, side) for joint in arm.joints]
            quantum = np.array([encoder.quantum_rad for encoder in encoders])
            mounted = quantum * random.uniform(-0.5, 0.5, arm.n)
            angles.append(quantum * np.rint((values + mounted) / quantum))
        flexible = np.array([joint.flexible for joint in arm.joints])
        q = np.where(flexible, angles[0], angles[1])
        omega = np.zeros((n, 3))
        if arm.free:
            walk = arm.imu.bias_walk * np.sqrt(arm.period_s) * random.standard_normal((n, 3))
            omega = readings.omega + arm.imu.rate_sigma * random.standard_normal((n, 3)) + np.cumsum(walk, axis=0)
            omega = omega @ arm.mount
        return Cycles(np.arange(n, dtype=np.uint64), q, angles[1], tau, omega, np.zeros(n, dtype=np.uint32))


def as_built(trial: Trial, seed: int) -> Model:
    """The arm that moves: every value off by up to its standard deviation."""
    return replace(built(trial.drawn, 1000 + seed), effects=())
