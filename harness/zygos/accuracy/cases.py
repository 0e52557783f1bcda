# SPDX-License-Identifier: MIT
"""The cases: what is simulated, and what the estimators know of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zygos.arm import JOINT_ROW_S, NO_IMU, TORQUE_GAIN_SIGMA, Arm, Smoother, load_arm
from zygos.dynamics.equations import EngineName
from zygos.effects import Effect, effect
from zygos.errors import ZygosError
from zygos.model.model import Model, load_model
from zygos.simulation.scenario import Motion, Ramp, Scenario, load_scenario

BLOCK = 25
"""Number of seeds that one cell simulates together."""
REST_S = 1.0
"""Time for which the arm of the case "rest" is at rest, s."""
ZERO_RAD = 1e-3
LOST = 0.01
SNAP_S = 2.0


@dataclass(frozen=True)
class Case:
    """One plant with its sensors and motion, and the arm file that the estimators are given."""

    name: str
    description: str
    """Description of the case, for the page."""
    arm: Arm
    """The arm file that the estimators get."""
    plant: Arm
    """The actual hardware."""
    model: Model
    """The model that is simulated."""
    scenario: Scenario
    benign: bool = True
    """Whether nothing is wrong, so that no estimator should refuse."""
    zeros_rad: float = 0.0
    """Size of every encoder's unknown zero error, rad; its sign is drawn."""
    lost: float = 0.0
    """Share of the cycles in which the frames of one joint are lost."""
    rest_s: float = 0.0
    """Time for which the arm is known to be at rest at the start, s."""
    share: int = 1
    """Number of seeds that share one motion, each with its own sensor errors."""
    engine: EngineName = "zygos"
    beside: str = ""
    """Name of the case with the same runs and another arm file, with which this one is compared."""


def all_cases(folder: Path = Path("examples")) -> tuple[Case, ...]:
    """The cases, from the examples of a checkout. Errors: ZygosError if they are not there."""
    paper, lively, spatial, gap = (folder / name for name in ("paper", "lively", "spatial", "gap"))
    if not (paper / "scenario.toml").is_file():
        raise ZygosError(f"{paper / 'scenario.toml'}: no such file; remedy: run inside a checkout")
    arm, model = load_arm(paper / "arm.toml"), load_model(paper / "model.toml")
    scenario = load_scenario(paper / "scenario.toml")

    def at(name: str, description: str, duration_s: float = 60.0) -> Case:
        """The paper's own run, or a shorter or longer version of it."""
        return Case(name, description, arm, arm, model, replace(scenario, duration_s=duration_s))

    def modern(rate_hz: int) -> Case:
        # gyro and arcs are those of the arm that examples/gap has at 200 Hz
        hardware = replace(load_arm(gap / "arm.toml").at_period(1.0 / rate_hz), smoother=Smoother(25, 6, 12))
        moves = replace(scenario, encoder_noise="quantised")
        description = f"20-bit encoders on both sides, {rate_hz} Hz, T = 60 s"
        return Case(f"modern-{rate_hz}", description, hardware, hardware, model, moves, share=BLOCK)

    usual = at("paper-60", "the paper's run, T = 60 s")
    moving = load_arm(lively / "arm.toml")
    larger = Case(
        "lively",
        "the paper's sensors on an arm with a stiffer shoulder in a larger and faster motion, T = 60 s",
        moving,
        moving,
        load_model(lively / "model.toml"),
        load_scenario(lively / "scenario.toml"),
    )
    space = load_arm(spatial / "arm.toml")
    floating = Case(
        "spatial",
        "three joints in space, 20-bit and geared 14-bit encoders, 500 Hz, T = 60 s; motion by Pinocchio",
        space,
        space,
        load_model(spatial / "model.toml"),
        load_scenario(spatial / "scenario.toml"),
        share=BLOCK,
        engine="pinocchio",
    )
    shorter = replace(
        floating,
        name="spatial-20",
        description="the run of spatial, T = 20 s",
        scenario=replace(floating.scenario, duration_s=20.0),
    )

    def noisy(share: float) -> Case:
        hardware = replace(arm, joints=tuple(replace(joint, torque_relative_sigma=share) for joint in arm.joints))
        description = f"reported torques with white noise of {100.0 * share:g} % of their size, as declared"
        name = f"torque-{100.0 * share:g}"
        return replace(usual, name=name, description=description, arm=hardware, plant=hardware, benign=False)

    def lacking(name: str, description: str, *hidden: Effect) -> Case:
        told = noisy(0.005)
        return replace(
            told,
            name=name,
            description=f"{description}, of which no estimator is told; torques with noise of 0.5 %",
            model=replace(model, effects=hidden),
        )

    def at_joints(key: str, value: float) -> tuple[Effect, ...]:
        return tuple(effect(key, joint.name, value) for joint in arm.joints)

    declared = noisy(0.005).arm
    uncertain = replace(
        declared, joints=tuple(replace(joint, torque_gain_sigma=TORQUE_GAIN_SIGMA) for joint in declared.joints)
    )
    grounded = modern(200)
    # a lower order flattens this motion by more than is left of the noise, as `zygos check-arm` finds
    bolted = replace(grounded.plant, base="fixed", imu=NO_IMU, smoother=Smoother(25, 8, 12))

    def with_joint_rows(case: Case) -> Case:
        return replace(
            case,
            name=f"{case.name}-joints",
            description=f"the runs of {case.name}, with joint rows of {JOINT_ROW_S:g} s",
            arm=replace(case.arm, joint_increment_s=JOINT_ROW_S),
            beside=case.name,
        )

    return (
        # little more than one period of the slower sine
        replace(at("paper-30", "the paper's run, T = 30 s, too short for most seeds", 30.0), benign=False),
        usual,
        at("paper-120", "the paper's run, T = 120 s", 120.0),
        at("paper-300", "the paper's run, T = 300 s", 300.0),
        larger,
        replace(
            usual,
            name="gain-50",
            description="stiff servo, gain 50: torque steps",
            scenario=replace(scenario, controller=replace(scenario.controller, gain=50.0)),
            benign=False,
        ),
        modern(200),
        modern(500),
        replace(
            usual,
            name="quantised",
            description="readings rounded to the quantum instead of Gaussian noise",
            scenario=replace(scenario, encoder_noise="quantised"),
        ),
        replace(
            usual,
            name="sigma-half",
            description="declared σ half of the true one",
            plant=_coarser(arm, 2.0),
            benign=False,
        ),
        replace(
            usual,
            name="sigma-double",
            description="declared σ twice the true one",
            plant=_coarser(arm, 0.5),
            benign=False,
        ),
        replace(usual, name="lost", description="1 % of the cycles lack the frames of one joint", lost=LOST),
        replace(
            usual,
            name="zeros",
            description="encoder zeros off by 1 mrad, signs at random; "
            "the arm file says that they are uncertain by as much",
            arm=_uncertain(arm),
            zeros_rad=ZERO_RAD,
        ),
        replace(
            larger,
            name="rest",
            description="the arm of lively from a turning point, T = 60 s, "
            f"the first {REST_S:g} s of it known to be at rest",
            scenario=_from_rest(larger.scenario, [joint.name for joint in moving.joints]),
            rest_s=REST_S,
        ),
        *(noisy(share) for share in (0.001, 0.005, 0.01)),
        lacking(
            "scale", "torques of the elbow 2 % larger than reported", effect("torque_gain", arm.joints[-1].name, 0.02)
        ),
        replace(
            lacking(
                "gain",
                "torques of the elbow 5 % larger than reported",
                effect("torque_gain", arm.joints[-1].name, 0.05),
            ),
            arm=uncertain,
            description="torques of the elbow 5 % larger than reported; the arm file declares errors of 1 %; "
            "torques with noise of 0.5 %",
        ),
        lacking("lag", "torques that begin 5 ms late", *at_joints("torque_lag", 0.005)),
        lacking("cubic", "springs with a cubic part of 3 Nm/rad³", *at_joints("cubic_stiffness", 3.0)),
        lacking("friction", "Coulomb friction of 0.01 Nm at the motors", *at_joints("motor_coulomb", 0.01)),
        lacking(
            "backlash",
            "backlash of 0.02 rad to each side in the spring of the elbow",
            effect("backlash", arm.joints[-1].name, 1000.0, shape=0.02),
        ),
        replace(
            at("snap", f"moves of {SNAP_S:g} s with as long rests, T = 300 s", 300.0),
            scenario=_snaps(replace(scenario, duration_s=300.0)),
            benign=False,
        ),
        replace(
            grounded,
            name="fixed",
            description="the arm of modern-200 on a fixed base, with a smoother of order 8",
            arm=bolted,
            plant=bolted,
            scenario=replace(grounded.scenario, angular_momentum_nms=0.0),
        ),
        floating,
        with_joint_rows(floating),
        shorter,
        with_joint_rows(shorter),
    )


def chosen(cases: Sequence[Case], names: Sequence[str]) -> tuple[Case, ...]:
    """The named cases, or all. Errors: ZygosError for a name that no case has."""
    known = {case.name: case for case in cases}
    for name in names:
        if name not in known:
            raise ZygosError(f"there is no case {name!r}; remedy: use one of {', '.join(known)}")
    return tuple(case for case in cases if not names or case.name in names)


def _coarser(arm: Arm, factor: float) -> Arm:
    """The arm with encoders whose quantum is `factor` times as large."""
    joints = tuple(
        replace(
            joint,
            link_encoder=replace(joint.link_encoder, quantum_rad=factor * joint.link_encoder.quantum_rad),
            motor_encoder=replace(joint.motor_encoder, quantum_rad=factor * joint.motor_encoder.quantum_rad),
        )
        for joint in arm.joints
    )
    return replace(arm, joints=joints)


def _uncertain(arm: Arm) -> Arm:
    """The arm with a standard deviation for the encoders' zeros."""
    joints = tuple(
        replace(
            joint,
            link_encoder=replace(joint.link_encoder, zero_sigma_rad=ZERO_RAD),
            motor_encoder=replace(joint.motor_encoder, zero_sigma_rad=ZERO_RAD),
        )
        for joint in arm.joints
    )
    return replace(arm, joints=joints)


def _snaps(scenario: Scenario) -> Scenario:
    """Moves of SNAP_S to and fro between the ends of the sines of a scenario, with rests between, which begin later at
    each joint."""
    manoeuvre = {}
    for k, (name, motion) in enumerate(scenario.manoeuvre.items()):
        (sine,) = motion.sines
        starts = np.arange((1.0 + 0.5 * k) * SNAP_S, scenario.duration_s - SNAP_S, 2.0 * SNAP_S)
        ramps = tuple(Ramp(float(at), SNAP_S, sine.amplitude * (-1) ** n) for n, at in enumerate(starts))
        manoeuvre[name] = Motion(motion.offset, ramps=ramps)
    return replace(scenario, manoeuvre=manoeuvre)


def _from_rest(scenario: Scenario, names: Sequence[str]) -> Scenario:
    """The same sines, started from a turning point at which the arm is at rest first.

    Ramps of half a period each, alternately up and down, form a sine.
    """
    manoeuvre, start = {}, []
    for name in names:
        (sine,) = scenario.manoeuvre[name].sines
        half = float(np.pi / sine.omega)
        count = int(np.ceil((scenario.duration_s - REST_S) / half))
        ramps = tuple(Ramp(REST_S + k * half, half, 2.0 * sine.amplitude * (-1) ** k) for k in range(count))
        start.append(scenario.manoeuvre[name].offset - sine.amplitude)
        manoeuvre[name] = Motion(start[-1], ramps=ramps)
    return replace(scenario, manoeuvre=manoeuvre, initial_angles_rad=tuple(start))
