# SPDX-License-Identifier: MIT
"""Springs of flexible joints for an MJCF that has none: a rotor on a hinge beside the joint, and a tendon between the
two. What acts on the joint then acts on the rotor, and the angles of keyframes are completed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.simulators.robot import Hinge, Lump, Robot, Spring, written
from zygos.simulators.view import View
from zygos.simulators.xml import Document, Edits, Element, read_document

_ROTOR = 0.01
"""Mass of an added rotor, as share of that of the segment behind its joint: only its inertia matters, because the body
that carries it becomes lighter by it."""
_SMALL = 1e-9
"""Inertia of a rotor whose value is given later, kg m^2."""


def with_springs(robot: Robot, arm: Arm) -> Robot:
    """The robot with a spring at each joint that is flexible in an arm and rigid in the file; its values are given
    later. Errors: ZygosError for a joint without a name."""
    hinges = []
    for hinge, joint, segment in zip(robot.hinges, arm.joints, robot.segments[-arm.n :], strict=True):
        if not joint.flexible or hinge.spring is not None:
            hinges.append(hinge)
            continue
        if not hinge.written:
            raise ZygosError(
                f"{robot.path}: joint {hinge.name} has no name, which its tendon needs; remedy: give it one"
            )
        disc = _SMALL * (0.5 * np.eye(3) + 0.5 * np.outer(hinge.axis, hinge.axis))
        rotor = Lump(_ROTOR * segment.mass, hinge.anchor, disc)
        spring = Spring(rotor, 0.0, joint.gear_ratio, 0.0, 0.0, coefficient=1.0 / joint.gear_ratio)
        hinges.append(replace(hinge, spring=spring))
    return replace(robot, hinges=tuple(hinges))


def stiffness(spring: Spring) -> str:
    """The attribute of its tendon."""
    size = (spring.coefficient * spring.ratio) ** 2
    linear = max(spring.stiffness - spring.slack, 0.0) / size
    orders = [linear, *([0.0, spring.cubic / size**2] if spring.cubic else [])]
    return " ".join(f"{x:.10g}" for x in orders)


def gap(spring: Spring, length: float) -> dict[str, str]:
    """The attributes of the tendon with its gap. length: of the tendon in the posture of the file, m."""
    reach = spring.coefficient * spring.ratio
    half = spring.gap_rad * abs(reach)
    return {"stiffness": written([spring.slack / reach**2]), "springlength": written([length - half, length + half])}


def add_springs(edits: Edits, elements: Sequence[Element], view: View, hinges: Sequence[Hinge]) -> None:
    """Give the file the springs of these joints. elements: of its bodies, in MuJoCo's order."""
    document, tree = edits.document, view.tree
    tendons = []
    for hinge in hinges:
        spring = hinge.spring
        assert spring is not None
        motor = _new_name(document, f"{hinge.written}_motor")
        carrier = int(tree.body_parentid[int(tree.jnt_bodyid[hinge.number])])
        parent = elements[carrier - 1] if carrier else document.root.first("worldbody")
        assert parent is not None
        attitude, origin = view.pose(carrier)
        turning = {
            "name": motor, "type": "hinge", "pos": "0 0 0", "axis": written(attitude.T @ hinge.axis), "ref": "0",
            "stiffness": "0", "springref": "0", "damping": written([spring.rub]),
            "frictionloss": written([spring.friction]), "armature": "0", "limited": "false",
        }  # fmt: skip
        rotor = spring.rotor.in_frame(attitude, hinge.anchor)
        place = {"name": _new_name(document, f"{hinge.written}_rotor")}
        place["pos"] = written(attitude.T @ (hinge.anchor - origin))
        edits.insert(
            parent,
            f"<body {attributes(place)}><joint {attributes(turning)}/><inertial {attributes(inertial(rotor))}/></body>",
        )
        tendons += _tendons(hinge, spring, motor)
        _act_on_rotor(edits, tree, hinge, spring, motor)
    section = document.root.first("tendon")
    if section is None:
        edits.insert(document.root, f"<tendon>{''.join(tendons)}</tendon>")
    else:
        edits.insert(section, "".join(tendons))
    _complete_keyframes(edits, tree, hinges)


def attributes(values: Mapping[str, str]) -> str:
    """Attributes as they stand in a start tag."""
    return " ".join(f"{name}={quoteattr(value)}" for name, value in values.items())


def other_actuators(robot: Robot) -> list[str]:
    """Which actuators of joints with added springs are no motors, in sentences: what they should do is not clear."""
    added = {hinge.written for hinge in robot.added}
    return [
        f"{one.file.name}, line {one.line}: <{one.tag}> still acts on joint {one.attributes['joint']}, behind its "
        f"spring: let it act on {one.attributes['joint']}_motor, which turns with the motor"
        for section in read_document(robot.path, includes=True).root.all("actuator")
        for one in section.children
        if one.attributes.get("joint") in added and one.tag != "motor"
    ]


def inertial(lump: Lump) -> dict[str, str]:
    """The attributes of an `<inertial>`, in the axes of the lump."""
    full = lump.tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return {"pos": written(lump.centre), "mass": written([lump.mass]), "fullinertia": written(full)}


def _new_name(document: Document, name: str) -> str:
    """A name that no element has."""
    taken = {one.attributes.get("name") for one in document.root.walk()}
    while name in taken:
        name += "_"
    return name


def _tendons(hinge: Hinge, spring: Spring, motor: str) -> list[str]:
    """The tendon of a spring, and the one with its gap."""
    ends = (
        f"<joint {attributes({'joint': motor, 'coef': written([spring.coefficient])})}/>"
        f"<joint {attributes({'joint': hinge.written, 'coef': '-1'})}/>"
    )
    length = -hinge.zero_rad
    relaxed = 0.0 + length - (spring.offset / spring.stiffness if spring.offset else 0.0)
    # MuJoCo's own resting length is that at the springref of both joints
    own = {"stiffness": stiffness(spring), "damping": written([spring.damping]), "springlength": f"{relaxed:.16g}"}
    every = [own, *([gap(spring, length)] if spring.slack else [])]
    plain = {"limited": "false", "frictionloss": "0"}
    return [f"<fixed {attributes(plain | one)}>{ends}</fixed>" for one in every]


def _act_on_rotor(edits: Edits, tree: Any, hinge: Hinge, spring: Spring, motor: str) -> None:
    """Let the motors of a joint act on its rotor, with the same power."""
    every = [one for section in edits.document.root.all("actuator") for one in section.children]
    for number, one in enumerate(every):
        if one.tag == "motor" and one.attributes.get("joint") == hinge.written:
            edits.give(one, joint=motor, gear=written([float(tree.actuator_gear[number, 0]) / spring.ratio]))


def _complete_keyframes(edits: Edits, tree: Any, hinges: Sequence[Hinge]) -> None:
    """Give keyframes the angles and rates of the rotors, which stand behind those of the body that carries them."""
    carriers = [int(tree.body_parentid[int(tree.jnt_bodyid[hinge.number])]) for hinge in hinges]
    behind = [int(np.argmax(tree.jnt_bodyid > carrier)) for carrier in carriers]
    for section in edits.document.root.all("keyframe"):
        for key in section.children:
            for name, addresses in (("qpos", tree.jnt_qposadr), ("qvel", tree.jnt_dofadr)):
                if name not in key.attributes:
                    continue
                values = [float(x) for x in key.attributes[name].split()]
                turned = [
                    hinge.spring.ratio
                    * (values[int(addresses[hinge.number])] - (hinge.zero_rad if name == "qpos" else 0.0))
                    for hinge in hinges
                    if hinge.spring is not None
                ]
                edits.give(key, **{name: " ".join(f"{x:.10g}" for x in np.insert(values, addresses[behind], turned))})
