# SPDX-License-Identifier: MIT
"""URDF: the chain of an arm with friction and damping, and its file with other numbers in the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.errors import ZygosError
from zygos.simulators.robot import Hinge, Lump, Owner, Robot, written
from zygos.simulators.xml import Document, Edits, Element, end_of, parsed, read_document
from zygos.urdf.chain import Chain, read_chain, read_chain_of

Array = NDArray[np.float64]
ON_EARTH = (0.0, 0.0, -9.81)
_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_UPPER = np.triu_indices(3)


def read_urdf(path: Path, joints: Sequence[str] | int | None, gravity: Sequence[float] = ON_EARTH) -> Robot:
    """The serial arm of a file. joints: as of `read_mjcf`. gravity: in the axes of the base, m/s^2, which no URDF has.

    Errors: ZygosError as `zygos.urdf.chain.read_chain`, and for a chain with fewer joints.
    """
    document = read_document(path)
    chain = _chain(path, document, joints)
    links = {one.attributes.get("name", ""): one for one in document.root.all("link")}
    made = {one.attributes.get("name", ""): one for one in document.root.all("joint")}
    attitude, origin = np.eye(3), np.zeros(3)
    hinges, owners = [], []
    for hinge, segment in zip(chain.hinges, chain.segments[1:], strict=True):
        origin = origin + attitude @ np.array(hinge.xyz)
        attitude = attitude @ Rotation.from_euler("xyz", hinge.rpy).as_matrix()
        dynamics = made[hinge.name].first("dynamics")
        damping, friction = (
            float(dynamics.attributes.get(key, "0")) if dynamics is not None else 0.0 for key in ("damping", "friction")
        )
        limit = made[hinge.name].first("limit")
        bounded = made[hinge.name].attributes.get("type") == "revolute" and limit is not None
        low, high = (float(limit.attributes.get(key, "0")) if limit is not None else 0.0 for key in ("lower", "upper"))
        axis = attitude @ np.array(hinge.axis)
        axis = np.where(np.abs(axis) < 1e-9, 0.0, axis)
        hinges.append(
            Hinge(
                hinge.name,
                origin,
                axis / np.linalg.norm(axis),
                friction=friction,
                damping=damping,
                written=hinge.name,
                range_rad=(low, high) if bounded and low < high else None,
            )
        )
        lumps = [(segment.link, attitude, origin, _lump(links[segment.link], attitude, origin))]
        for name, pose in segment.riders:
            frame = (attitude @ pose.attitude, origin + attitude @ pose.origin)
            lumps.append((name, *frame, _lump(links[name], *frame)))
        heaviest = max(range(len(lumps)), key=lambda k: lumps[k][3].mass)
        if not lumps[heaviest][3].mass > 0.0:
            raise ZygosError(f"{path}: what joint {hinge.name} moves has no mass; remedy: give its link an <inertial>")
        name, own_attitude, own_origin, own = lumps.pop(heaviest)
        owners.append(Owner(name, own_attitude, own_origin, own, tuple(lump for *_, lump in lumps)))
    x, y, z = (float(value) for value in gravity)
    notes = [note for note in chain.notes if not note.startswith(("<dynamics>", "<limit>"))]
    return Robot(path, "URDF", tuple(hinges), tuple(owners), np.array([x, y, z]), tuple(notes))


def _chain(path: Path, document: Document, joints: Sequence[str] | int | None) -> Chain:
    made = {one.attributes.get("name", ""): one for one in document.root.all("joint")}
    if joints is not None and not isinstance(joints, int) and all(name in made for name in joints):
        return read_chain_of(path, end_of(made[joints[0]], "parent"), joints)
    if joints is None:
        return read_chain(path, weighed=False)[0]
    count = joints if isinstance(joints, int) else len(joints)

    def moving(link: str) -> list[str]:
        """The joints that move what is fixed to a link."""
        found = []
        for name, joint in made.items():
            if end_of(joint, "parent") == link:
                found += moving(end_of(joint, "child")) if joint.attributes.get("type") == "fixed" else [name]
        return found

    children = {end_of(made[name], "child") for name in made}
    names: list[str] = []
    after = [
        name
        for root in dict.fromkeys(end_of(made[name], "parent") for name in made)
        if root not in children
        for name in moving(root)
    ]
    while len(names) < count and len(after) == 1:
        names += after
        after = moving(end_of(made[names[-1]], "child"))
    if len(names) < count and after:
        raise ZygosError(
            f"{path}: the chain branches: joints {', '.join(after)}; remedy: name the joints of the arm with an arm "
            "file (--arm)"
        )
    if len(names) < count:
        raise ZygosError(
            f"{path}: has {len(names)} joints in a chain from the base, the runs have {count}; remedy: give the file "
            "of this arm"
        )
    return read_chain(path, tip=end_of(made[names[-1]], "child"), weighed=False)[0]


def _lump(link: Element, attitude: Array, origin: Array) -> Lump:
    """The inertial of a link whose frame has that attitude and origin in the base's."""
    inertial = link.first("inertial")
    if inertial is None:
        return Lump(0.0, np.zeros(3), np.zeros((3, 3)))
    pose, mass, inertia = (inertial.first(tag) for tag in ("origin", "mass", "inertia"))
    xyz, rpy = (
        np.array([float(x) for x in (pose.attributes.get(key) or "0 0 0").split()]) if pose is not None else np.zeros(3)
        for key in ("xyz", "rpy")
    )
    tensor = np.zeros((3, 3))
    if inertia is not None:
        tensor[_UPPER] = [float(inertia.attributes.get(key, "0")) for key in _KEYS]
        tensor = tensor + tensor.T - np.diag(np.diag(tensor))
    axes = attitude @ Rotation.from_euler("xyz", rpy).as_matrix()
    return Lump(
        0.0 if mass is None else float(mass.attributes["value"]), origin + attitude @ xyz, axes @ tensor @ axes.T
    )


def corrected_urdf(old: Robot, new: Robot) -> dict[Path, bytes]:
    """The bytes of a file with the inertials, friction and damping of another robot."""
    document = read_document(old.path)
    links = {one.attributes.get("name", ""): one for one in document.root.all("link")}
    made = {one.attributes.get("name", ""): one for one in document.root.all("joint")}
    edits = Edits(document)
    for before, after in zip(old.hinges, new.hinges, strict=True):
        changed = {
            key: written([now])
            for key, was, now in (
                ("damping", before.damping, after.damping),
                ("friction", before.friction, after.friction),
            )
            if was != now
        }
        if changed:
            _child(edits, made[before.written], "dynamics", changed)
    for was, now in zip(old.owners, new.owners, strict=True):
        if was.own is now.own:
            continue
        lump = now.own.in_frame(now.attitude, now.origin)
        inertial = links[now.name].first("inertial")
        assert inertial is not None, "an owner has mass"
        place = written(lump.centre)
        entries = dict(zip(_KEYS, written(lump.tensor[_UPPER]).split(), strict=True))
        _child(edits, inertial, "origin", {"xyz": place, "rpy": "0 0 0"})
        _child(edits, inertial, "mass", {"value": written([lump.mass])})
        _child(edits, inertial, "inertia", entries)
    return edits.result()


def _child(edits: Edits, parent: Element, tag: str, attributes: dict[str, str]) -> None:
    """Give the child of a tag attributes, or make one."""
    child = parent.first(tag)
    if child is None:
        edits.insert(parent, f"<{tag} " + " ".join(f'{k}="{v}"' for k, v in attributes.items()) + "/>")
    else:
        edits.give(child, **attributes)


def without_geometry(content: bytes) -> bytes:
    """A URDF without visual and collision, whose meshes need not be there: for its dynamics alone."""
    document = parsed(Path("robot.urdf"), content)
    edits = Edits(document)
    for link in document.root.all("link"):
        for child in link.children:
            if child.tag in ("visual", "collision"):
                edits.remove(child)
    return edits.result()[document.path]
