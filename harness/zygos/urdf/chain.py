# SPDX-License-Identifier: MIT
"""URDF input and output: the serial chain of an arm with all links fixed to it, and inertials written back.

ROS's own library, urdf_parser_py (package urdfdom_py), parses the file; docs/urdf.md describes the conversion.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.errors import ZygosError, installs
from zygos.files.inputs import local
from zygos.model.model import Body, is_possible

try:
    from lxml import etree
    from urdf_parser_py.urdf import URDF, Inertia, Link
    from urdf_parser_py.xml_reflection import core
except ImportError as missing:
    raise ZygosError(f"URDF needs the package {missing.name}; remedy: {installs('urdf')}") from missing

Array = NDArray[np.float64]
Vector3 = tuple[float, float, float]

_TURNING = ("revolute", "continuous")
_LOOSE = ("floating", "planar")
"""Types of joints that do not fix a link to the arm."""
_WORLD = "world"
"""A link that a joint may name although the file does not have it."""
_ROUNDED = 0.05
"""Largest share of a principal moment by which it may exceed the sum of the other two because of rounding: the
resolution of two digits."""
_READ = {"link": ("inertial",), "joint": ("origin", "axis", "parent", "child", "dynamics", "mimic")}
"""Elements that zygos reads. Nothing else is parsed, so that no mesh, plugin or transmission can cause an error."""


@dataclass(frozen=True)
class Pose:
    """Position of a frame in another: attitude (3, 3) and origin (3,), m."""

    attitude: Array
    origin: Array

    def __matmul__(self, inner: Pose) -> Pose:
        """The frame `inner`, which is given in this frame, expressed in this one's parent."""
        return Pose(self.attitude @ inner.attitude, self.origin + self.attitude @ inner.origin)

    @property
    def inverse(self) -> Pose:
        """The parent's frame, expressed in this one."""
        return Pose(self.attitude.T, -self.attitude.T @ self.origin)


_CORRECT = "correct its <inertia>: all must be positive, and none larger than the sum of the other two"
_ARM_ALONE = "write the arm file alone, which needs no masses, with -o ARM.toml"
_HERE = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Hinge:
    """A joint of the chain."""

    name: str
    axis: Vector3
    """Unit vector in the joint's frame."""
    xyz: Vector3
    """Origin of the joint's frame in the body that carries it, m."""
    rpy: Vector3
    """Attitude of the joint's frame in the body that carries it, rad, as URDF's <origin rpy>."""


@dataclass(frozen=True)
class Segment:
    """A body of the chain: a link, and the links fixed to it with their poses in its frame."""

    link: str
    riders: tuple[tuple[str, Pose], ...]

    @property
    def merged(self) -> tuple[str, ...]:
        """Names of the links fixed to it."""
        return tuple(name for name, _ in self.riders)


@dataclass(frozen=True)
class Inertial:
    """Mass and inertia of a body in the frame of its link, which is that of its joint."""

    mass: float
    """kg."""
    centre: Array
    """(3,) mass centre, m."""
    tensor: Array
    """(3, 3) inertia about the mass centre, kg m^2."""


@dataclass(frozen=True)
class Chain:
    """A serial arm as its URDF describes it: N+1 segments, N hinges."""

    name: str
    segments: tuple[Segment, ...]
    hinges: tuple[Hinge, ...]
    notes: tuple[str, ...]
    """Content of the URDF that zygos does not use."""


def read_chain(
    path: str | Path, base: str | None = None, tip: str | None = None, *, weighed: bool = True
) -> tuple[Chain, tuple[Inertial, ...]]:
    """Read the chain from link `base` (default: the root) to link `tip` (default: the end of the only chain), and the
    inertials (N+1) of its segments with everything fixed to them; none if they are not to be weighed, or if no link of
    the chain has one.

    Errors: ZygosError for a file that is not a URDF or not a tree, a chain with joints that do not turn or that other
    joints drive, physically impossible links, and bodies without mass.
    """
    tree = _Tree(Path(path))
    chain = tree.chain(base, tip)
    links = [link for one in chain.segments for link in (one.link, *one.merged)]
    if not weighed or all(tree.links[link].inertial is None for link in links):
        return chain, ()
    inertials = tuple(tree.weigh(segment, base=index == 0) for index, segment in enumerate(chain.segments))
    return replace(chain, notes=(*chain.notes, *tree.rounded)), inertials


def read_chain_of(path: str | Path, base: str, joints: Sequence[str]) -> Chain:
    """Read the chain that begins at link `base` and has exactly these joints; its inertials are not read.

    Errors: ZygosError as `read_chain`, and if there is no such chain.
    """
    tree = _Tree(Path(path))
    if joints[-1] not in tree.joints:
        raise tree.error(f"has no joint {joints[-1]}", "give the URDF of this arm, with the same joint names")
    if base not in tree.links:
        raise tree.error(f"has no link {base} as the base", "state with --base at which link the arm begins")
    chain = tree.chain(base, tree.joints[joints[-1]].child)
    if (names := [hinge.name for hinge in chain.hinges]) != list(joints):
        raise tree.error(
            f"the joints from link {base} are {', '.join(names)}, those of the arm {', '.join(joints)}",
            "give the URDF of this arm, or state with --base at which link the arm begins",
        )
    return chain


def with_inertials(path: str | Path, segments: Sequence[Segment], bodies: Sequence[Body], comment: str = "") -> str:
    """The URDF `path` with the inertials of `bodies` (N+1) on the links of `segments`, none on the links merged into
    them, and a comment at the top. Everything else is unchanged. Errors: ZygosError if the file cannot be read."""
    tree = _parse(Path(path))
    root = tree.getroot()
    links = {link.get("name"): link for link in root.findall("link")}
    for segment, body in zip(segments, bodies, strict=True):
        for name in segment.merged:
            for inertial in links[name].findall("inertial"):
                links[name].remove(inertial)
        link = links[segment.link]
        inertial = link.find("inertial")
        if inertial is None:
            inertial = etree.Element("inertial")
            inertial.tail = link.text  # the same indentation as the first sibling
            link.insert(0, inertial)
        tail, inner = inertial.tail, inertial.text if len(inertial) else None
        inertial.clear()
        etree.SubElement(inertial, "origin", xyz=" ".join(map(repr, body.origin_xyz)), rpy="0 0 0")
        etree.SubElement(inertial, "mass", value=repr(body.mass.value))
        entries = {key: repr(entry.value) for key, entry in zip(Inertia.KEYS, body.inertia, strict=True)}
        etree.SubElement(inertial, "inertia", entries)
        inertial.tail = tail
        if inner is not None:
            inertial.text = inner
            for child in inertial:
                child.tail = inner
            inertial[-1].tail = tail if inertial.getnext() is not None else inner
    if comment:
        # two hyphens would end an XML comment
        root.insert(0, etree.Comment(comment.replace("--", "- -")))
        root[0].tail = root.text
    # lxml drops line ends outside the root
    parts = [*reversed(list(root.itersiblings(preceding=True))), root, *root.itersiblings()]
    lines = [etree.tostring(part, encoding="unicode", with_tail=False) for part in parts]
    return "\n".join(['<?xml version="1.0" encoding="utf-8"?>', *lines, ""])


class _Tree:
    """Links and joints of a file, which are checked to form one tree."""

    def __init__(self, file: Path) -> None:
        self.file = file
        root = _parse(file).getroot()
        self.limited = [joint.get("name") for joint in root.findall("joint") if joint.find("limit") is not None]
        self.last_digits = {link.get("name"): _last_digit(link) for link in root.findall("link")}
        self.rounded: list[str] = []
        """Notes about inertias that were changed within their digits."""
        robot, self.complaints = _read(file, root)
        self.name: str = robot.name
        self.links: dict[str, Any] = self._by_name("link", robot.links)
        self.joints: dict[str, Any] = self._by_name("joint", robot.joints)
        if _WORLD not in self.links and any(joint.parent == _WORLD for joint in robot.joints):
            self.links[_WORLD] = Link(name=_WORLD)
            self.complaints.append(f"the file has no link {_WORLD}, which is taken as an empty one")
        for joint in robot.joints:
            for link in (joint.parent, joint.child):
                if link not in self.links:
                    raise self.error(
                        f"joint {joint.name} names the link {link}, which the file does not have",
                        _like(link, self.links),
                    )
        self.above: dict[str, Any] = {}
        for joint in robot.joints:
            if (other := self.above.setdefault(joint.child, joint)) is not joint:
                raise self.error(
                    f"link {joint.child} is the child of two joints, {other.name} and {joint.name}",
                    "open the loop: a link has one parent",
                )
        if not self.links:
            raise self.error("has no <link>", "give a file with links and joints")
        roots = [link for link in self.links if link not in self.above]
        looped = sorted(set(self.links).difference(*(self.beside(root, None) for root in roots)))
        if looped:
            raise self.error(f"the links {', '.join(looped)} form a loop", "give every link one parent, up to a root")
        self.roots = roots

    def error(self, wrong: str, remedy: str) -> ZygosError:
        return ZygosError(f"{self.file}: {wrong}; remedy: {remedy}")

    def _by_name(self, noun: str, listed: Sequence[Any]) -> dict[str, Any]:
        named = {entry.name: entry for entry in listed}
        for name in named:
            if sum(entry.name == name for entry in listed) > 1:
                raise self.error(f"two {noun}s are called {name}", f"give every {noun} a different name")
        return named

    @cached_property
    def _neighbours(self) -> dict[str, list[tuple[Any, str]]]:
        found: dict[str, list[tuple[Any, str]]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            found[joint.parent].append((joint, joint.child))
            found[joint.child].append((joint, joint.parent))
        return found

    def beside(self, link: str, without: Any) -> set[str]:
        """The links connected to `link`, itself included, when the joint `without` is removed."""
        found, waiting = {link}, [link]
        while waiting:
            for joint, other in self._neighbours[waiting.pop()]:
                if joint is not without and other not in found:
                    found.add(other)
                    waiting.append(other)
        return found

    def chain(self, base: str | None, tip: str | None) -> Chain:
        for link, option in ((base, "--base"), (tip, "--tip")):
            if link is not None and link not in self.links:
                raise self.error(f"{option}: there is no link {link}", _like(link, self.links))
        base = base or (self._ancestors(tip)[0] if tip else self._only_root())
        path = self._path(base, tip or self._only_tip(base))
        hinges: list[Hinge] = []
        starts = [base]
        pose, between = _HERE, 0
        for joint in path:
            pose = pose @ self._pose(f"joint {joint.name}", joint.origin)
            if joint.type == "fixed":
                between += 1
                continue
            if joint.type not in _TURNING:
                raise self.error(
                    f"joint {joint.name} is {joint.type}: the joints of the chain must turn",
                    'make it type="fixed" if it does not move, or choose another chain with --base and --tip',
                )
            if joint.mimic is not None:
                raise self.error(
                    f"joint {joint.name} mimics {joint.mimic.joint}: it has no motor of its own, and coupled joints "
                    "are not supported",
                    'make it type="fixed", remove <mimic>, or choose another chain with --base and --tip',
                )
            # a frame without a fixed joint before it has exactly the numbers of the file
            rpy = _rpy(pose.attitude) if between else _numbers(joint.origin.rpy if joint.origin else (0.0, 0.0, 0.0))
            hinges.append(Hinge(joint.name, self._axis(joint), _numbers(pose.origin), rpy))
            starts.append(joint.child)
            pose, between = _HERE, 0
        if not hinges:
            raise self.error(
                f"no joint turns from {base} to {tip or 'its end'}", "choose another chain with --base and --tip"
            )
        names = {hinge.name for hinge in hinges}
        held: list[str] = []
        segments = tuple(self._segment(start, names, held) for start in starts)
        taken = {link for segment in segments for link in (segment.link, *segment.merged)}
        apart = [link for link in self.links if link not in taken]
        return Chain(self.name, segments, tuple(hinges), tuple(self._notes(names, held, apart)))

    def _only_root(self) -> str:
        """The root, if only one has joints."""
        jointed = [root for root in self.roots if self._neighbours[root]] or self.roots
        if len(jointed) > 1:
            raise self.error(
                f"the links {', '.join(jointed)} have no parent: there is more than one tree",
                "choose the beginning of the arm with --base, or connect them",
            )
        return jointed[0]

    def _path(self, base: str, tip: str) -> list[Any]:
        joints: list[Any] = []
        link = tip
        while link != base:
            if link not in self.above:
                raise self.error(
                    f"link {tip} is not connected to link {base}",
                    f"choose --base among {', '.join(self._ancestors(tip))}",
                )
            joints.append(self.above[link])
            link = self.above[link].parent
        return joints[::-1]

    def _ancestors(self, link: str) -> list[str]:
        found = [link]
        while found[-1] in self.above:
            found.append(self.above[found[-1]].parent)
        return found[::-1]

    def _only_tip(self, base: str) -> str:
        """The link after the last moving joint, if there is only one such joint."""
        below = [
            joint for joint in self.joints.values() if joint.type != "fixed" and base in self._ancestors(joint.parent)
        ]
        carrying = {link for joint in below for link in self._ancestors(joint.parent)}
        tips = [joint.child for joint in below if joint.child not in carrying]
        if len(tips) > 1:
            shared = set.intersection(*(set(self._ancestors(tip)) for tip in tips))
            parting = max(shared, key=lambda link: len(self._ancestors(link)))
            raise self.error(
                f"the tree branches at link {parting}: moving joints end at the links {', '.join(tips)}",
                f"choose the end of the arm with --tip, for instance --tip {parting}, and its beginning with --base",
            )
        return tips[0] if tips else base

    def _segment(self, start: str, hinges: set[str], held: list[str]) -> Segment:
        """The link and everything fixed to it; moving joints outside the chain are fixed at zero, and links behind
        floating and planar joints are left out."""
        riders: list[tuple[str, Pose]] = []
        waiting: list[tuple[str, Pose, Any]] = [(start, _HERE, None)]
        while waiting:
            link, pose, through = waiting.pop(0)
            if link != start:
                riders.append((link, pose))
            for joint, other in self._neighbours[link]:
                if joint is through or joint.name in hinges or joint.type in _LOOSE:
                    continue
                if joint.type != "fixed":
                    held.append(joint.name)
                origin = self._pose(f"joint {joint.name}", joint.origin)
                waiting.append((other, pose @ (origin if other == joint.child else origin.inverse), joint))
        return Segment(start, tuple(riders))

    def weigh(self, segment: Segment, *, base: bool) -> Inertial:
        """The inertial of a segment with everything fixed to it. A base may have no mass, since it may be fixed."""
        parts: list[tuple[float, Array, Array]] = []
        for link, pose in ((segment.link, _HERE), *segment.riders):
            mass, centre, tensor = self._inertial(self.links[link])
            attitude = pose.attitude
            parts.append((mass, pose.origin + attitude @ centre, attitude @ tensor @ attitude.T))
        total = math.fsum(mass for mass, _, _ in parts)
        if total <= 0.0 and base:
            return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
        if total <= 0.0:
            raise self.error(
                f"link {segment.link} has no mass, and nothing with mass is fixed to it",
                f"give it an <inertial>, make a joint at one of its ends fixed, or {_ARM_ALONE}",
            )
        centre = parts[0][1] if len(parts) == 1 else np.sum([mass * place for mass, place, _ in parts], axis=0) / total
        # parallel axis theorem
        tensor = np.sum([part + mass * _about(place - centre) for mass, place, part in parts], axis=0)
        if not is_possible(tensor):
            raise self.error(
                f"link {segment.link} with what is fixed to it has the principal moments "
                f"{np.linalg.eigvalsh(tensor).tolist()} kg m^2, which no body can have",
                f"{_CORRECT}, or {_ARM_ALONE}",
            )
        return Inertial(total, centre, tensor)

    def _inertial(self, link: Any) -> tuple[float, Array, Array]:
        """Mass, centre and inertia about the centre in the link's frame; zeros without an <inertial>."""
        inertial = link.inertial
        if inertial is None:
            return 0.0, np.zeros(3), np.zeros((3, 3))
        where = f"link {link.name}"
        mass = float(inertial.mass)
        if not (math.isfinite(mass) and mass >= 0.0):
            raise self.error(f"{where} has the mass {mass:g} kg", "give it a positive mass, or no <inertial>")
        if inertial.inertia is None:
            raise self.error(
                f"{where} has an <inertial> without <inertia>", "add the six moments, or remove <inertial>"
            )
        pose = self._pose(f"{where}: <inertial>", inertial.origin)
        tensor = np.array(inertial.inertia.to_matrix())
        if not np.isfinite(tensor).all():
            raise self.error(f"{where} has the inertia {tensor.tolist()}", "write numbers, kg m^2")
        if mass == 0.0 and np.any(tensor):
            raise self.error(f"{where} has inertia but no mass", "give it a positive mass, or no <inertial>")
        # a point mass is allowed if something is fixed to it
        if np.any(tensor) and not is_possible(tensor):
            tensor = self._rounded(link.name, tensor)
        return mass, pose.origin, pose.attitude @ tensor @ pose.attitude.T

    def _rounded(self, link: str, tensor: Array) -> Array:
        """The nearest inertia (3, 3) that a body can have, where the given one breaks the triangle inequality by less
        than its last digit."""
        principal = np.linalg.eigvalsh(tensor)
        excess = float(principal[2] - principal[0] - principal[1])
        if principal[0] <= 0.0 or excess > min(self.last_digits[link], _ROUNDED * float(principal[2])):
            raise self.error(
                f"link {link} has the principal moments {principal.tolist()} kg m^2, which no body can have",
                f"{_CORRECT}, or {_ARM_ALONE}",
            )
        # a body can have an inertia if its second moment of mass, tr(I)/2 E - I, is positive semi-definite
        # (Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018)
        moments, axes = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
        second: Array = (axes * np.maximum(moments, 0.0)) @ axes.T
        self.rounded.append(
            f"link {link}: the largest principal moment exceeded the sum of the other two by {excess:.2g} kg m^2, less "
            "than the last digit of its <inertia>, and was rounded to that sum"
        )
        possible: Array = np.trace(second) * np.eye(3) - second
        return possible

    def _pose(self, where: str, origin: Any) -> Pose:
        if origin is None:
            return _HERE
        if not (np.isfinite(origin.xyz).all() and np.isfinite(origin.rpy).all()):
            raise self.error(f"{where}: <origin> is not finite", "write three numbers each into xyz (m) and rpy (rad)")
        return Pose(Rotation.from_euler("xyz", origin.rpy).as_matrix(), np.array(origin.xyz))

    def _axis(self, joint: Any) -> Vector3:
        axis = np.array((1.0, 0.0, 0.0) if joint.axis is None else joint.axis)
        length = float(np.linalg.norm(axis))
        if not (math.isfinite(length) and length > 0.0):
            raise self.error(f"joint {joint.name}: the axis {axis.tolist()} has no direction", "write a unit vector")
        return _numbers(axis if length == 1.0 else axis / length)

    def _notes(self, hinges: set[str], held: list[str], apart: list[str]) -> Iterator[str]:
        yield from self.complaints
        if apart:
            yield f"left out, because nothing fixes it to the arm: link {', '.join(apart)}"
        if held:
            yield f"outside the chain and fixed at zero: joint {', '.join(held)}"
        lossy = [
            f"{joint.name} (damping {joint.dynamics.damping or 0:g}, friction {joint.dynamics.friction or 0:g})"
            for joint in self.joints.values()
            if joint.name in hinges and joint.dynamics is not None
        ]
        if lossy:
            yield (
                f"<dynamics> is not used: {', '.join(lossy)}; in zygos damping is a property of the spring, and "
                "friction an [[effect]] of model.toml"
            )
        if limited := [name for name in self.limited if name in hinges]:
            yield f"<limit> is not used, because arm.toml has no limits: {', '.join(limited)}"


def _parse(file: Path) -> Any:
    """The XML tree of a URDF."""
    try:
        tree = etree.ElementTree(etree.fromstring(local(file).read_bytes(), etree.XMLParser(resolve_entities=False)))
    except OSError as error:
        raise ZygosError(f"{file}: cannot be read ({error.strerror}); remedy: check the path") from None
    except etree.XMLSyntaxError as error:
        raise ZygosError(f"{file}: is not valid XML ({error}); remedy: correct that line") from None
    root = tree.getroot()
    if any("xacro" in str(uri) for element in root.iter() for uri in element.nsmap.values()) and any(
        isinstance(element.tag, str) and "xacro" in element.tag for element in root.iter()
    ):
        raise ZygosError(f"{file}: is a xacro file; remedy: expand it first: xacro FILE.xacro > ARM.urdf")
    if root.tag != "robot":
        raise ZygosError(
            f"{file}: is not a URDF, its root is <{root.tag}>; remedy: give a file that begins with <robot>"
        )
    return tree


def _read(file: Path, root: Any) -> tuple[Any, list[str]]:
    """The links and joints as parsed by the library, and its complaints."""
    pruned = etree.Element("robot", name=root.get("name") or file.stem)
    for kind, tags in _READ.items():
        for element in root.findall(kind):
            copy = etree.SubElement(pruned, kind, dict(element.attrib))
            for tag in tags:
                found = element.findall(tag)
                if len(found) > 1:
                    raise ZygosError(
                        f"{file}: {kind} {element.get('name')} has {len(found)} <{tag}>; remedy: keep one of them"
                    )
                copy.extend(deepcopy(child) for child in found)
    etree.strip_elements(pruned, etree.Comment, etree.ProcessingInstruction, with_tail=False)
    try:
        with _complaints() as complaints:
            return URDF.from_xml_string(etree.tostring(pruned)), complaints
    except core.ParseError as error:
        wrong = " ".join(str(error).removeprefix("ParseError in ").split())
        raise ZygosError(f"{file}: is not valid URDF ({wrong}); remedy: correct that element") from None
    except Exception as error:  # the library passes on errors from the conversion of a word
        raise ZygosError(f"{file}: is not valid URDF ({error!r}); remedy: correct that value") from None


@contextmanager
def _complaints() -> Iterator[list[str]]:
    """Collects messages that the library would print."""
    found: list[str] = []
    usual, core.on_error = core.on_error, found.append
    try:
        yield found
    finally:
        core.on_error = usual


def _last_digit(link: Any) -> float:
    """The unit of the last digit of the coarsest entry of an <inertia>, kg m^2; 0 without entries that are not 0."""
    steps = [0.0]
    for text in (value for entry in link.iterfind("inertial/inertia") for value in entry.attrib.values()):
        try:
            written = Decimal(text.strip())
        except InvalidOperation:
            continue
        exponent = written.as_tuple().exponent
        if written and isinstance(exponent, int):
            steps.append(10.0**exponent)
    return max(steps)


def _like(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]}?" if close else f"the links are {', '.join(known)}"


def _numbers(values: Iterable[float]) -> Vector3:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _about(arm: Array) -> Array:
    """(3, 3) inertia of a unit mass at `arm` about the origin, m^2."""
    inertia: Array = (arm @ arm) * np.eye(3) - np.outer(arm, arm)
    return inertia


def _rpy(attitude: Array) -> Vector3:
    """Roll, pitch and yaw of an attitude, exact also at a pitch of 90 degrees, where scipy loses digits (1e-7) (R.
    Paul, Robot Manipulators, 1981, ch. 3: each angle is computed after the previous rotations are undone)."""
    roll = math.atan2(attitude[2, 1], attitude[2, 2])
    sine, cosine = math.sin(roll), math.cos(roll)
    pitch = math.atan2(-attitude[2, 0], math.hypot(attitude[2, 1], attitude[2, 2]))
    yaw = math.atan2(sine * attitude[0, 2] - cosine * attitude[0, 1], cosine * attitude[1, 1] - sine * attitude[1, 2])
    return roll, pitch, yaw
