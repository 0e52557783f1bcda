# SPDX-License-Identifier: MIT
"""Properties of an arm that a URDF does not contain: motors, gears, springs, sensors, the bus (`answers.toml`).

The keys are those of arm.toml and model.toml, whose readers check the values: [default] holds for every joint,
[joint.NAME] for one of them. See docs/urdf.md.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import tomlkit
import typer

from zygos import arm as hardware
from zygos.errors import ZygosError
from zygos.files.toml import Table
from zygos.model import model as beliefs
from zygos.model.model import JointModel
from zygos.urdf.chain import Chain

_ENCODERS = ("link_encoder", "motor_encoder")
_DRIVE = ("rotor_mass", "rotor_inertia", "stiffness", "damping")
_SPRING = ("link_encoder", "stiffness", "damping")
"""Keys that a rigid joint does not have."""
JOINT = ("node", "gear_ratio", *_ENCODERS, "torque_sigma", "latch_us", "flexible", *_DRIVE)
TOP = ("base", "period_s", "torque_law", "gravity", "imu", "smoother", "arc")
_OPTIONAL = "# optional, too: rotor_mass, torque_sigma, flexible, latch_us, and the other keys of an encoder"
_ON_EARTH = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Question:
    """One value that must be given: its dotted key, its meaning, and usual values."""

    key: str
    what: str
    usual: str
    example: str
    """A usual value, as TOML."""
    check: Callable[[Table, str, str], object]
    """Reads the answer, given the table, the last part of the key and `what`."""
    instead: str = ""
    """Another key that may be given in its place."""


def _above(limit: float, unit: str) -> Callable[[Table, str, str], object]:
    return lambda table, key, what: table.number(key, what, above=limit, unit=unit)


def _from(limit: float, unit: str) -> Callable[[Table, str, str], object]:
    return lambda table, key, what: table.number(key, what, low=limit, unit=unit)


def _whole(low: int, high: int) -> Callable[[Table, str, str], object]:
    return lambda table, key, what: table.integer(key, what, low=low, high=high)


def _one_of(*words: str) -> Callable[[Table, str, str], object]:
    return lambda table, key, what: table.choice(key, what, words)


_BASE = Question("base", "whether the base floats or is fixed", '"free" or "fixed"', '"free"', _one_of("free", "fixed"))
_BUS = (
    Question("period_s", "SYNC period, s", "0.001 to 0.05", "0.005", _above(0.0, "s")),
    Question(
        "torque_law",
        "when a reported torque acts",
        '"applied_from_sync", "applied_previous_cycle" or "sampled"',
        '"applied_from_sync"',
        _one_of("applied_from_sync", "applied_previous_cycle", "sampled"),
    ),
)
_GYRO = (
    Question("imu.node", "CAN node of the base's gyro", "1 to 31", "16", _whole(1, 31)),
    Question("imu.rate_sigma", "white noise of one gyro sample, rad/s", "1e-6 to 1e-3", "1e-5", _from(0.0, "rad/s")),
    Question(
        "imu.bias_walk", "random walk of the gyro's bias, rad/s^1.5", "1e-10 to 1e-5", "1e-8", _from(0.0, "rad/s^1.5")
    ),
)
_MOTOR = (
    Question("gear_ratio", "gear ratio, motor turns per joint turn", "30 to 2000", "100", _above(0.0, "")),
    Question(
        "rotor_inertia",
        "inertia of the rotor about its axis, before the gear, kg m^2",
        "1e-6 to 1e-2",
        "1e-4",
        _above(0.0, "kg m^2"),
    ),
    Question(
        "motor_encoder.counts", "steps per turn of the motor encoder", "2^10 to 2^24", "4096", _whole(4, 2**32),
        "motor_encoder.quantum_rad",
    ),
    Question(
        "motor_encoder.side", "where the motor encoder sits", '"rotor" or "output" of the gear', '"rotor"',
        _one_of("rotor", "output"),
    ),
)  # fmt: skip
_FLEXIBLE = (
    Question("stiffness", "stiffness after the gear, Nm/rad", "1e3 to 1e6", "1e4", _above(0.0, "Nm/rad")),
    Question("damping", "damping of the spring, after the gear, Nms/rad", "0.1 to 1e3", "10", _from(0.0, "Nms/rad")),
    Question(
        "link_encoder.counts", "steps per turn of the link encoder", "2^10 to 2^24", "1048576", _whole(4, 2**32),
        "link_encoder.quantum_rad",
    ),
)  # fmt: skip
_NODE = Question("node", "CAN node", "1 to 31", "1", _whole(1, 31))
QUESTIONS = (_BASE, *_BUS, *_GYRO, _NODE, *_MOTOR, *_FLEXIBLE)
"""All values that must be answered for an arm with a free base and flexible joints."""


class Answers:
    """The answers so far; `ask` adds to them."""

    def __init__(
        self, path: Path | None, joints: Sequence[str], *, driven: bool = True, known: dict[str, Any] | None = None
    ) -> None:
        """Read `path`, or take `known` with the same keys (neither: no answers yet), for an arm with these joints.

        driven: whether rotors and springs, which only model.toml has, must be answered. Errors:
        ZygosError for unknown keys and joints.
        """
        self.driven = driven
        self.file = path or Path("answers")
        self.joints = tuple(joints)
        top = Table.load(path) if path else Table(known or {}, self.file)
        self.default = _known(
            top.table("default", "What holds for every joint that does not say otherwise.", optional=True), JOINT
        )
        each = top.table("joint", "What holds for one joint, by its name.", optional=True)
        self.own: dict[str, dict[str, Any]] = {joint: {} for joint in self.joints}
        for joint in each.names():
            if joint not in self.own:
                raise each.error(joint, "the chain has no such joint", f"its joints are {', '.join(self.joints)}")
            self.own[joint] = _known(each.table(joint, "One joint."), JOINT)
        self.top = _known(top, TOP)

    def missing(self) -> list[tuple[str, Question]]:
        """The questions without an answer, each with its joint ("" if it concerns the whole arm)."""
        found = [("", question) for question in (_BASE, *_BUS) if not _has(self.top, question)]
        if self.top.get("base") != "fixed":
            found += [("", question) for question in _GYRO if not _has(self.top, question)]
        for joint in self.joints:
            values = self._of(joint)
            questions = (_NODE, *_MOTOR, *(() if values.get("flexible") is False else _FLEXIBLE))
            found += [
                (joint, question)
                for question in questions
                if (self.driven or question.key not in _DRIVE) and not _has(values, question)
            ]
        return found

    def ask(self) -> None:
        """Ask the user at the terminal for missing values. The last answer for another joint is offered as the
        default."""
        previous: dict[str, str] = {}
        asked: set[tuple[str, str]] = set()
        while missing := [entry for entry in self.missing() if (entry[0], entry[1].key) not in asked]:
            joint, question = missing[0]  # an answer may make the questions after it unnecessary
            asked.add((joint, question.key))
            value = typer.prompt(
                f"{f'joint {joint}: ' if joint else ''}{question.what} (usually {question.usual})",
                default=previous.get(question.key),
                value_proc=partial(_checked, question),
                err=True,
            )
            if question is not _NODE:  # node numbers are never repeated
                previous[question.key] = str(value)
            target = self.own[joint] if joint else self.top
            *tables, key = question.key.split(".")
            for table in tables:
                target = target.setdefault(table, {})
            target[key] = value

    def template(self, chain: Chain) -> str:
        """An answers.toml with the known values; missing ones are comments with a usual value."""
        missing = self.missing()
        lines = [
            f"# Values that the URDF of {chain.name} does not contain. Lines after a # are missing: correct them, "
            "remove the #.",
            "# [default] holds for every joint; [joint.NAME] holds for one, and goes before [default].",
            *_open(missing, "", ("base", *(question.key for question in _BUS))),
            *_written({key: value for key, value in self.top.items() if not isinstance(value, dict)}),
        ]
        tables = {key: value for key, value in self.top.items() if isinstance(value, dict)}
        if any(question.key.startswith("imu.") for joint, question in missing if not joint):
            tables.setdefault("imu", {})
        for key, value in tables.items():
            lines += ["", f"[{key}]" + ("  # for a free base only; a fixed one has no gyro" if key == "imu" else "")]
            lines += [line.replace(f"# {key}.", "# ") for line in _open(missing, "", (), f"{key}.")]
            lines += _written(value)
        # a value that several joints lack is stated once for all of them
        seen: dict[str, Question] = {}
        for joint, question in missing:
            if joint and question is not _NODE:
                seen.setdefault(question.key, question)
        lines += ["", "[default]", _OPTIONAL, *(_line(question) for question in seen.values()), *_written(self.default)]
        for node, joint in enumerate(self.joints, start=1):
            lines += ["", f"[joint.{tomlkit.key(joint).as_string()}]"]
            if (joint, _NODE) in missing:
                lines.append(f"# node = {node}  # {_NODE.what}, {_NODE.usual}")
            lines += _written(self.own[joint])
        return "\n".join(lines) + "\n"

    def arm(self, chain: Chain) -> dict[str, Any]:
        """The content of arm.toml. Errors: ZygosError for values that are not allowed there."""
        if lacking := self.missing():
            whose: dict[Question, list[str]] = {}
            for owner, question in lacking:
                whose.setdefault(question, []).append(owner)
            listed = "\n".join(
                f"  {question.key}: {question.what}, usually {question.usual}" + _whose(joints, self.joints)
                for question, joints in whose.items()
            )
            raise ZygosError(
                f"{self.file}: {len(lacking)} values are missing that a URDF does not contain:\n{listed}\n"
                "remedy: write them into a file like this, and give it with --answers (--template FILE writes it):\n\n"
                f"{self.template(chain)}"
            )
        joints: list[dict[str, Any]] = []
        for hinge in chain.hinges:
            values = self._of(hinge.name)
            geometry = {"name": hinge.name, "axis": list(hinge.axis), "frame_rpy": list(hinge.rpy)}
            geometry["position_m"] = list(hinge.xyz)
            joint = geometry | {key: values[key] for key in JOINT if key in values and key not in _DRIVE}
            hardware.read_joint(Table(joint, self.file, f"joint.{hinge.name}"))
            joints.append(joint)
        top = {"name": chain.name, "kinetic": "spatial", "torque_at": "rotor"} | self.top | {"joint": joints}
        if top["base"] == "fixed":
            top.setdefault("gravity", list(_ON_EARTH))
        hardware.read_arm(Table(top, self.file))
        return top

    def drives(self) -> tuple[JointModel, ...]:
        """(N,) the joints of model.toml. Errors: ZygosError for values that are not allowed there."""
        found: list[JointModel] = []
        for joint in self.joints:
            values = self._of(joint)
            drive = {"name": joint} | {key: values[key] for key in _DRIVE if key in values}
            table = Table(drive, self.file, f"joint.{joint}")
            if values.get("flexible") is False:
                for key in ("stiffness", "damping"):
                    if table.has(key):
                        raise table.error(key, "a rigid joint has no spring", "remove it, or write flexible = true")
                table = Table(drive | {"stiffness": math.inf, "damping": 0.0}, self.file, f"joint.{joint}")
            found.append(beliefs.read_joint_model(table, "CAD"))
        return tuple(found)

    def _of(self, joint: str) -> dict[str, Any]:
        """The known values of a joint: its own answers, and for other keys the default ones."""
        own, default = self.own[joint], self.default
        if own.get("flexible", default.get("flexible")) is False:
            default = {key: value for key, value in default.items() if key not in _SPRING}
        values = default | own
        for key in _ENCODERS:
            if isinstance(own.get(key), dict) and isinstance(default.get(key), dict):
                # quantum and counts are two ways to state the same property
                other = {"counts": "quantum_rad", "quantum_rad": "counts"}
                hidden = {other[name] for name in own[key] if name in other}
                values[key] = {name: entry for name, entry in default[key].items() if name not in hidden} | own[key]
        return values


def _whose(joints: Sequence[str], every: Sequence[str]) -> str:
    if len(joints) == len(every) > 1:
        return " (every joint)"
    return f" (joint {', '.join(joints)})" if all(joints) else ""


def _known(table: Table, keys: Sequence[str]) -> dict[str, Any]:
    """The entries of a table, whose keys must be in `keys` or already read."""
    values: dict[str, Any] = {}
    for key in table.names():
        if table.where == "" and key in ("default", "joint"):
            continue
        if key not in keys:
            raise table.error(key, "unknown key", f"remove it; known here: {', '.join(keys)}")
        values[key] = table.peek(key)
    return values


def _has(values: Mapping[str, Any], question: Question) -> bool:
    return any(_holds(values, key) for key in (question.key, question.instead) if key)


def _holds(values: Mapping[str, Any], dotted: str) -> bool:
    first, _, rest = dotted.partition(".")
    if first not in values:
        return False
    # a value in place of a table is refused later by the reader
    return not rest or not isinstance(values[first], dict) or _holds(values[first], rest)


def _checked(question: Question, text: str) -> Any:
    """The user's input as a value that the question allows."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    key = question.key.rpartition(".")[2]
    try:
        question.check(Table({key: value}, Path("answer")), key, question.what)
    except ZygosError as error:
        raise typer.BadParameter(str(error).removeprefix("answer: ")) from None
    return value


def _line(question: Question) -> str:
    return f"# {question.key} = {question.example}  # {question.what}, usually {question.usual}"


def _open(missing: Sequence[tuple[str, Question]], joint: str, keys: Sequence[str], prefix: str = "") -> list[str]:
    return [
        _line(question)
        for owner, question in missing
        if owner == joint and (question.key in keys or (prefix and question.key.startswith(prefix)))
    ]


def _written(values: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Lines of TOML. Tables are written as dotted keys, so that a missing entry can be added to them."""
    lines: list[str] = []
    for key, value in values.items():
        if isinstance(value, dict):
            lines += _written(value, f"{prefix}{key}.")
        else:
            lines.append(f"{prefix}{key} = {tomlkit.item(value).as_string()}")
    return lines
