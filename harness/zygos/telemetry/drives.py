# SPDX-License-Identifier: MIT
"""Drive profiles: the frames that drives of laboratory arms send, as a DBC and a template of the map.

A profile is data, `zygos/drives/NAME.toml` and `NAME.dbc`; its frames are decoded as those of any other DBC.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from cantools.database.can import Message

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.telemetry.dictionary import Dictionary
from zygos.telemetry.map import UNITS, Map, closest, map_of

_FOLDER = Path(__file__).resolve().parents[1] / "drives"
PERIOD_S = 0.01
"""Period of the grid of an arm file that is made from a URDF."""


def profiles() -> dict[str, dict[str, Any]]:
    """The content of each profile by its name."""
    return {path.stem: tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(_FOLDER.glob("*.toml"))}


@dataclass(frozen=True)
class Drives:
    """The drives of an arm, one for each joint from the base on."""

    name: str
    """Of the profile."""
    nodes: tuple[int, ...]
    models: tuple[str, ...]
    """Names of the motors; empty where the profile has none."""

    @property
    def profile(self) -> dict[str, Any]:
        """Its content."""
        return profiles()[self.name]

    def entry(self, index: int, kind: str) -> dict[str, Any]:
        """The entry of the map for a joint (from 0). kind: motor, torque, or, where the drives have it, link."""
        profile = self.profile
        entry = dict(profile["torque_entry" if kind == "torque" else kind])
        message = f"{entry.pop('message', 'Drive')}{self.nodes[index]}"
        entry["signal"] = f"{message}.{entry['signal']}"
        model = profile["model"][self.models[index]] if self.models else {}
        return entry | ({"scale": model["torque_range_Nm"]} if model and kind == "torque" else {})

    def dictionary(self) -> Dictionary:
        """The messages of all nodes. Errors: as `Dictionary.load`."""
        profile = self.profile
        shipped = Dictionary.load([_FOLDER / f"{self.name}.dbc"])
        template = next(iter(message.name[-1] for message in shipped.messages.values()))
        messages: dict[str, Message] = {}
        for node in self.nodes:
            for message in shipped.messages.values():
                clone = deepcopy(message)
                steps = node - int(template)
                clone.name = f"{message.name[:-1]}{node}"
                clone.frame_id += steps * profile["id_step"]
                clone.is_extended_frame = message.is_extended_frame or clone.frame_id > 0x7FF
                for signal in clone.signals:
                    if signal.multiplexer_ids:
                        step = steps * profile.get("multiplexer_step", 0)
                        signal.multiplexer_ids = [one + step for one in signal.multiplexer_ids]
                clone.refresh()
                messages[clone.name] = clone
        return replace(shipped, messages=messages, ignored_bits=profile.get("ignored_bits", 0))

    @cached_property
    def _known(self) -> Dictionary:
        return self.dictionary()

    def step(self, index: int, kind: str) -> float | None:
        """The change of angle or torque of one count, rad or Nm; None for values in floating point."""
        entry = self.entry(index, kind)
        _, signal = self._known.find(entry["signal"], self.name)
        if signal.is_float:
            return None
        unit = UNITS["torque" if kind == "torque" else "angle"][entry["unit"]]
        return abs(float(signal.scale)) * float(entry.get("scale", 1.0)) * unit

    def mapping(self, arm: Arm) -> Map:
        """The map for an arm. Errors: ZygosError if the arm does not have a joint for each node."""
        if len(arm.joints) != len(self.nodes):
            raise ZygosError(
                f"--nodes names {len(self.nodes)} drives, but arm {arm.name} has {len(arm.joints)} joints; remedy: "
                "name the node of each joint, from the base on"
            )
        joints: list[dict[str, Any]] = []
        described = self.profile.get("eds")
        for i, joint in enumerate(arm.joints):
            kinds = ["motor", "torque", *(["link"] if joint.flexible and described else [])]
            joints.append({"name": joint.name} | {kind: self.entry(i, kind) for kind in kinds})
        time = {"source": "receive", "interpolation": "cubic"}
        return map_of({"time": time, "joint": joints}, f"drive {self.name}", arm, "log")

    def answers(self, joints: Sequence[str]) -> dict[str, Any]:
        """What the drives say of an arm that a URDF does not, with the keys of `answers.toml`.

        Errors: ZygosError if the profile does not know gear ratios or steps.
        """
        profile = self.profile
        ratios = [profile["model"][model].get("gear_ratio") for model in self.models]
        if None in ratios or not ratios:
            raise ZygosError(
                f"--drive {self.name}: the frames do not tell gear ratios and encoders; remedy: make the arm file with "
                "`zygos import`, and give it with --arm instead of --urdf"
            )
        if len(joints) != len(self.nodes):
            raise ZygosError(
                f"--nodes names {len(self.nodes)} drives, but the chain of the URDF has {len(joints)} joints "
                f"({', '.join(joints)}); remedy: name the node of each joint, from the base on, and its end with --tip"
            )
        each: dict[str, Any] = {}
        for index, name in enumerate(joints):
            ratio = ratios[index]
            angle, torque = self.step(index, "motor"), self.step(index, "torque")
            assert angle is not None and torque is not None
            each[name] = {
                "node": index + 1,
                "gear_ratio": ratio,
                "flexible": False,
                "motor_encoder": {"quantum_rad": angle, "side": "output"},
                "torque_sigma": torque / math.sqrt(12.0) / ratio,
            }
        return {"base": "fixed", "period_s": PERIOD_S, "torque_law": "sampled", "joint": each}

    def described(self) -> list[str]:
        """A line for each kind of motor: what its torque is, and how coarse its steps are."""
        lines = [f"{self.profile['title']}: the torque is {self.profile['torque']}"]
        alike: dict[str, list[str]] = {}
        for index, node in enumerate(self.nodes):
            angle, torque = self.step(index, "motor"), self.step(index, "torque")
            steps = (
                "angle and torque in floating point"
                if angle is None or torque is None
                else f"steps of {1e3 * angle:.3g} mrad and {1e3 * torque:.3g} mNm"
            )
            alike.setdefault(f"{self.models[index]}, {steps}" if self.models else steps, []).append(str(node))
        return lines + [f"node {', '.join(nodes)}: {text}" for text, nodes in alike.items()]


def read_drives(drive: str, nodes: str, eds: Sequence[Path] = ()) -> Drives:
    """The drives that --drive NAME[:MODEL,...], --nodes 1-7 and --eds name. Errors: ZygosError naming option and
    remedy."""
    name, _, models = drive.partition(":")
    known = profiles()
    if name not in known:
        raise ZygosError(f'--drive {drive}: there is no "{name}"; remedy: {closest(name, known, "profiles")}')
    profile = known[name]
    numbers = _nodes(nodes)
    low, high = profile["nodes"]
    if outside := [node for node in numbers if not low <= node <= high]:
        raise ZygosError(f"--nodes {nodes}: {outside[0]} is no node; remedy: nodes of {name} are {low} to {high}")
    motors = profile.get("model", {})
    chosen = [part.strip() for part in models.split(",")] if models else []
    usual = profile.get("models_of_nodes", [])
    if not chosen and motors:
        if not usual or max(numbers) > len(usual):
            raise ZygosError(
                f"--drive {name}: the scale of the frames depends on the motors; remedy: name them, for instance "
                f"--drive {name}:{next(iter(motors))}, or one for each node, of {', '.join(motors)}"
            )
        chosen = [usual[node - 1] for node in numbers]
    if chosen and not motors:
        raise ZygosError(f"--drive {drive}: {name} needs no motors; remedy: write --drive {name}")
    for model in chosen:
        if model not in motors:
            raise ZygosError(f'--drive {drive}: no motor "{model}"; remedy: {closest(model, motors, "motors")}')
    if bool(eds) != bool(profile.get("eds")):
        raise ZygosError(
            f"--drive {name}: what its drives send is in their EDS or DCF; remedy: give it with --eds"
            if not eds
            else f"--eds: the frames of {name} are known; remedy: leave it out"
        )
    if eds:
        from zygos.telemetry.canopen import CanopenDrives, devices_of  # noqa: PLC0415  (is built on this module)

        return CanopenDrives(name, numbers, (), devices_of(eds, numbers))
    if len(chosen) == 1:
        chosen *= len(numbers)
    if chosen and len(chosen) != len(numbers):
        raise ZygosError(
            f"--drive {drive}: {len(chosen)} motors for {len(numbers)} nodes; remedy: name one, or one for each node"
        )
    return Drives(name, numbers, tuple(chosen))


def _nodes(text: str) -> tuple[int, ...]:
    """Numbers and ranges, upwards or downwards, with commas between them. Errors: ZygosError."""
    found: list[int] = []
    for part in text.split(","):
        span = re.fullmatch(r"([0-9]{1,5})(?:-([0-9]{1,5}))?", part.strip())
        if span is None:
            raise ZygosError(f"--nodes {text}: not a list of numbers; remedy: write for instance 1-7, or 1,2,5")
        begin, end = int(span[1]), int(span[2] or span[1])
        found += range(begin, end + 1) if begin <= end else range(begin, end - 1, -1)
    if not found or len(set(found)) != len(found):
        raise ZygosError(f"--nodes {text}: nodes must differ; remedy: write for instance 1-7, or 1,2,5")
    return tuple(found)
