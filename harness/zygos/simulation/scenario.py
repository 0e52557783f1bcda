# SPDX-License-Identifier: MIT
"""The run to simulate: manoeuvre, controller, duration and seed (`scenario.toml`)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tomlkit
from numpy.typing import ArrayLike, NDArray

from zygos.errors import ZygosError
from zygos.files.output import write_text
from zygos.files.toml import Table

Array = NDArray[np.float64]
EncoderNoise = Literal["gaussian", "quantised"]
FeedbackAngle = Literal["motor", "link"]
ManoeuvreKind = Literal["constant", "sines", "ramp"]

_ENCODER_NOISES: tuple[EncoderNoise, ...] = ("gaussian", "quantised")
_FEEDBACK_ANGLES: tuple[FeedbackAngle, ...] = ("motor", "link")
_KINDS: tuple[ManoeuvreKind, ...] = ("constant", "sines", "ramp")
_MOMENTUM = (
    "Angular momentum of the whole arm at the start, for a free base: a number about the joint axis of a planar arm, "
    "or a vector in the axes of the base. For an arm in space a number is about the z axis."
)


@dataclass(frozen=True)
class Sine:
    """The function amplitude * sin(omega t + phase)."""

    amplitude: float
    """rad."""
    omega: float
    """rad/s."""
    phase: float = 0.0
    """rad."""


@dataclass(frozen=True)
class Ramp:
    """A change that starts and ends at rest: change/2 * (1 - cos(pi (t - start) / duration)) in between."""

    start_s: float
    duration_s: float
    change: float
    """rad."""


@dataclass(frozen=True)
class Motion:
    """Desired motion of one joint: an offset (rad) plus sines plus ramps."""

    offset: float = 0.0
    sines: tuple[Sine, ...] = ()
    ramps: tuple[Ramp, ...] = ()

    def desired(self, t: ArrayLike) -> tuple[Array, Array]:
        """Desired angle, rad, and rate, rad/s, each of the shape of the times t, s."""
        time = np.asarray(t, dtype=np.float64)
        angle = np.full_like(time, self.offset)
        rate = np.zeros_like(time)
        for sine in self.sines:
            angle += sine.amplitude * np.sin(sine.omega * time + sine.phase)
            rate += sine.amplitude * sine.omega * np.cos(sine.omega * time + sine.phase)
        for ramp in self.ramps:
            turn = np.pi * np.clip((time - ramp.start_s) / ramp.duration_s, 0.0, 1.0)
            angle += 0.5 * ramp.change * (1.0 - np.cos(turn))
            rate += 0.5 * ramp.change * np.pi / ramp.duration_s * np.sin(turn)
        return angle, rate

    def acceleration(self, t: ArrayLike) -> Array:
        """Desired acceleration, rad/s^2, of the shape of the times t, s; 0 before and after a ramp."""
        time = np.asarray(t, dtype=np.float64)
        total = np.zeros_like(time)
        for sine in self.sines:
            total -= sine.amplitude * sine.omega**2 * np.sin(sine.omega * time + sine.phase)
        for ramp in self.ramps:
            turn = np.pi * (time - ramp.start_s) / ramp.duration_s
            inside = (turn >= 0.0) & (turn <= np.pi)
            total += inside * 0.5 * ramp.change * (np.pi / ramp.duration_s) ** 2 * np.cos(turn)
        return total


@dataclass(frozen=True)
class Controller:
    """The sampled servo of every joint: n tau = gain * [kp (q_d - angle) + kd (qd_d - rate)], plus n times the
    feedforward torque."""

    kp: float | tuple[float, ...] = 1000.0
    """Nm/rad, after the gear; one for all joints, or (N,)."""
    kd: float | tuple[float, ...] = 250.0
    """Nms/rad, after the gear; one for all joints, or (N,)."""
    gain: float = 1.0
    angle: FeedbackAngle = "motor"
    """The encoder whose angle is fed back."""
    feedforward: bool = False
    """Whether the torque that the desired motion needs, computed with the simulated equations of motion, is added."""


@dataclass(frozen=True)
class Scenario:
    """One run: the motion that the arm has to perform, and the conditions."""

    name: str
    arm: Path
    """Path of `arm.toml`."""
    plant: Path
    """Path of the `model.toml` that is simulated."""
    duration_s: float
    manoeuvre: dict[str, Motion]
    """Desired motion by joint name."""
    controller: Controller = Controller()
    seed: int = 0
    noise: bool = True
    """False: sensors are exact, including the encoder that is fed back."""
    encoder_noise: EncoderNoise = "gaussian"
    """"gaussian": sigma = quantum/sqrt(12) (Nanos & Papadopoulos eq. (28)); "quantised": readings are rounded."""
    angular_momentum_nms: float | tuple[float, float, float] = 1.0
    """Angular momentum at the start, Nms: about the joint axis of a planar arm, else a vector in base axes, where a
    single number is about z."""
    initial_angles_rad: tuple[float, ...] = ()
    """(N,) link and motor angles at the start, with springs relaxed and all joints at rest; empty: zeros."""

    def motions(self, names: Sequence[str]) -> list[Motion]:
        """Desired motion of each named joint. Errors: ZygosError if the manoeuvre names other joints."""
        if sorted(names) != sorted(self.manoeuvre):
            raise ZygosError(
                f"scenario {self.name}: the manoeuvre has joints {sorted(self.manoeuvre)}, the arm has "
                f"{list(names)}; remedy: give each joint of the arm at least one [[manoeuvre]]"
            )
        return [self.manoeuvre[name] for name in names]

    def desired(self, names: Sequence[str], t: ArrayLike) -> tuple[Array, Array]:
        """Desired angles, rad, and rates, rad/s, of the named joints at the times t (n,), s: each (n, N)."""
        pairs = [motion.desired(t) for motion in self.motions(names)]
        return np.stack([angle for angle, _ in pairs], axis=-1), np.stack([rate for _, rate in pairs], axis=-1)

    def accelerations(self, names: Sequence[str], t: ArrayLike) -> Array:
        """Desired accelerations of the named joints at the times t (n,), s: (n, N) rad/s^2. Errors: as `motions`."""
        return np.stack([motion.acceleration(t) for motion in self.motions(names)], axis=-1)


def load_scenario(path: str | Path) -> Scenario:
    """Read `scenario.toml`; paths in it are relative to the file. Errors: ZygosError naming file, key and remedy."""
    return read_scenario(Table.load(path, "a scenario"))


def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Write `scenario.toml` so that a reader sees the old file or the whole new one; paths in it are relative to it.

    Errors: ZygosError if it cannot be written.
    """
    folder = Path(path).absolute().parent
    document = tomlkit.document()
    document.update({"name": scenario.name, "duration_s": scenario.duration_s})
    document["arm"] = Path(os.path.relpath(scenario.arm.absolute(), folder)).as_posix()
    document["plant"] = Path(os.path.relpath(scenario.plant.absolute(), folder)).as_posix()
    document.update({"seed": scenario.seed, "noise": scenario.noise, "encoder_noise": scenario.encoder_noise})
    momentum = scenario.angular_momentum_nms
    document["angular_momentum_nms"] = list(momentum) if isinstance(momentum, tuple) else momentum
    if scenario.initial_angles_rad:
        document["initial_angles_rad"] = list(scenario.initial_angles_rad)
    servo = scenario.controller
    control = tomlkit.table()
    control["kp"] = list(servo.kp) if isinstance(servo.kp, tuple) else servo.kp
    control["kd"] = list(servo.kd) if isinstance(servo.kd, tuple) else servo.kd
    control.update({"gain": servo.gain, "angle": servo.angle, "feedforward": servo.feedforward})
    document["controller"] = control
    manoeuvre = tomlkit.aot()
    for joint, motion in scenario.manoeuvre.items():
        entry = tomlkit.table()
        if motion.sines:
            entry.update({"joint": joint, "kind": "sines", "offset_rad": motion.offset})
            sines = tomlkit.array()
            for sine in motion.sines:
                line = tomlkit.inline_table()
                line.update({"amplitude_rad": sine.amplitude, "omega_rad_s": sine.omega, "phase_rad": sine.phase})
                sines.append(line)
            entry["sines"] = sines.multiline(True)
        else:
            entry.update({"joint": joint, "kind": "constant", "angle_rad": motion.offset})
        manoeuvre.append(entry)
        for ramp in motion.ramps:
            entry = tomlkit.table()
            entry.update({"joint": joint, "kind": "ramp", "start_s": ramp.start_s, "duration_s": ramp.duration_s})
            entry["change_rad"] = ramp.change
            manoeuvre.append(entry)
    document["manoeuvre"] = manoeuvre
    write_text(Path(path), tomlkit.dumps(document))


def read_scenario(top: Table) -> Scenario:
    """The scenario of a table with the keys of `scenario.toml`. Errors: as `load_scenario`."""
    manoeuvre = _manoeuvre(
        top.tables("manoeuvre", "The desired motion of each joint. Several entries for one joint add up.")
    )
    control = top.table("controller", "The servo of every joint.", optional=True)
    controller = Controller(
        _gain(control, "kp", "Gain on the error of the angle, after the gear", 1000.0, len(manoeuvre), "Nm/rad"),
        _gain(control, "kd", "Gain on the error of the rate, after the gear", 250.0, len(manoeuvre), "Nms/rad"),
        control.number("gain", "Factor on the torque that kp and kd give.", 1.0, low=0.0),
        control.choice("angle", "The encoder whose angle is fed back.", _FEEDBACK_ANGLES, "motor"),
        control.boolean(
            "feedforward",
            "Whether the torque that the desired motion needs is added to that of the servo, so that the arm follows "
            "the motion. It is computed with the simulated plant, and needs a fixed base and rigid joints.",
            False,
        ),
    )
    control.finish()
    momentum: float | tuple[float, float, float]
    if top.has("angular_momentum_nms") and isinstance(top.peek("angular_momentum_nms"), list):
        x, y, z = top.vector("angular_momentum_nms", _MOMENTUM, 3, unit="Nms", otherwise="1.0")
        momentum = (x, y, z)
    else:
        momentum = top.number("angular_momentum_nms", _MOMENTUM, 1.0, unit="Nms")
    scenario = Scenario(
        name=top.text("name", "Name of the scenario, for messages."),
        arm=_file(top, "arm", "The arm file, as a path relative to the scenario file.", "arm.toml"),
        plant=_file(
            top, "plant", "The model file that is simulated, as a path relative to the scenario file.", "model.toml"
        ),
        duration_s=top.number("duration_s", "Duration of the run.", above=0.0, high=1e6, unit="s"),
        manoeuvre=manoeuvre,
        controller=controller,
        seed=top.integer("seed", "Seed of the random numbers.", 0, low=0, high=2**63 - 1),
        noise=top.boolean("noise", "Whether the sensors have noise. Without it all readings are exact.", True),
        encoder_noise=top.choice(
            "encoder_noise",
            'Error of the encoders. "gaussian": noise with the standard deviation quantum/sqrt(12); "quantised": '
            "readings are rounded to the quantum.",
            _ENCODER_NOISES,
            "gaussian",
        ),
        angular_momentum_nms=momentum,
        initial_angles_rad=top.vector(
            "initial_angles_rad",
            "Angles of the joints at the start, one for each joint. All joints start at rest with relaxed springs.",
            len(manoeuvre),
            (0.0,) * len(manoeuvre),
            unit="rad",
            otherwise="0 for each joint",
        ),
    )
    top.finish()
    return scenario


def _only(kind: ManoeuvreKind) -> str:
    return f"required where {_allowed(kind)}"


def _allowed(kind: ManoeuvreKind) -> str:
    return f'kind is "{kind}", refused elsewhere'


def _gain(table: Table, key: str, meaning: str, default: float, joints: int, unit: str) -> float | tuple[float, ...]:
    meaning = f"{meaning}: one number for all joints, or one for each joint."
    if not (table.has(key) and isinstance(table.peek(key), list)):
        return table.number(key, meaning, default, low=0.0, unit=unit)
    gains = table.vector(key, meaning, joints, unit=unit, otherwise=f"{default}")
    if min(gains) < 0.0:
        raise table.error(key, f"{min(gains):g} is negative", "write gains >= 0")
    return gains


def _file(top: Table, key: str, meaning: str, default: str) -> Path:
    file = top.file.parent / top.text(key, meaning, default)
    if not file.is_file():
        raise top.error(key, f"{file}: no such file", "give a path relative to the scenario file")
    return file


def _manoeuvre(tables: list[Table]) -> dict[str, Motion]:
    """Desired motion by joint name; several entries for the same joint are added."""
    motions: dict[str, Motion] = {}
    for table in tables:
        joint = table.text("joint", "Name of the joint.")
        kind = table.choice("kind", "The form of the motion, which says what other keys there are.", _KINDS)
        before = motions.get(joint, Motion())
        offset, sines, ramps = before.offset, before.sines, before.ramps
        if kind == "constant":
            offset += table.number("angle_rad", "The angle that is held.", unit="rad", otherwise=_only("constant"))
        elif kind == "sines":
            offset += table.number(
                "offset_rad",
                "Angle that is added to the sines.",
                0.0,
                unit="rad",
                otherwise=f"0.0 where {_allowed('sines')}",
            )
            for entry in table.tables("sines", "Sines, which are added.", otherwise=_only("sines")):
                sines += (
                    Sine(
                        entry.number("amplitude_rad", "Amplitude.", unit="rad"),
                        entry.number("omega_rad_s", "Angular frequency.", unit="rad/s"),
                        entry.number("phase_rad", "Phase at the start of the run.", 0.0, unit="rad"),
                    ),
                )
                entry.finish()
        else:
            ramps += (
                Ramp(
                    table.number("start_s", "Start of the ramp.", low=0.0, unit="s", otherwise=_only("ramp")),
                    table.number("duration_s", "Duration of the ramp.", above=0.0, unit="s", otherwise=_only("ramp")),
                    table.number(
                        "change_rad",
                        "Change of the angle from start to end, along half a period of a cosine.",
                        unit="rad",
                        otherwise=_only("ramp"),
                    ),
                ),
            )
        table.finish()
        motions[joint] = Motion(offset, sines, ramps)
    return motions
