# SPDX-License-Identifier: MIT
"""An MJCF from a URDF: the same bodies, joints and geometry, with motors and a place for the inertia of the rotors."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.errors import ZygosError
from zygos.simulators.robot import written
from zygos.simulators.xml import Element, end_of, parsed

_KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "fixed": ""}
"""Types of joints, and what MJCF calls them."""
_FULL = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_HEAD = """\
  <compiler angle="radian" eulerseq="XYZ" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast" gravity="{gravity}"/>

  <default>
    <joint solreffriction="0.004 1"/>  <!-- stiff enough that friction stops a joint within 4 ms -->
    <default class="visual">
      <geom contype="0" conaffinity="0" group="1" mass="0"/>
    </default>
    <default class="collision">
      <geom group="3" mass="0"/>
    </default>
  </default>
"""


class Translation:
    """A URDF in the words of MJCF."""

    def __init__(self, path: Path, content: bytes, gravity: NDArray[np.float64], folder: Path) -> None:
        """path: of the URDF, for places of meshes. content: its bytes. gravity: m/s^2. folder: of the MJCF.

        Errors: ZygosError for a joint that has no word in MJCF.
        """
        self._path, self._gravity, self._folder = path, gravity, folder
        root = parsed(path, content).root
        self._name = root.attributes.get("name", path.stem)
        self._links = {one.attributes["name"]: one for one in root.all("link")}
        self._joints = list(root.all("joint"))
        self._materials = {one.attributes.get("name", ""): one for one in root.all("material")}
        self._meshes: dict[str, str] = {}
        self._lost: dict[str, list[str]] = {}
        self._solid: set[str] = set()
        for joint in self._joints:
            if joint.attributes.get("type") not in _KINDS:
                raise ZygosError(
                    f"{path}: joint {joint.attributes['name']} is {joint.attributes.get('type', 'of no type')}, for "
                    "which no MJCF is written; remedy: make it fixed, or leave out the link that it carries"
                )

    def text(self, armatures: Mapping[str, float]) -> str:
        """The MJCF. armatures: of joints by name, kg m^2."""
        bodies = [line for root in self._roots() for line in self._body(root, "    ", None, armatures)]
        assets = [f"    <mesh name={quoteattr(name)} {rest}/>" for rest, name in self._meshes.items()]
        parts = [
            f"<!-- From {self._path.name.replace('--', '- -')} -->",
            f"<mujoco model={quoteattr(self._name)}>",
            _HEAD.format(gravity=written(self._gravity)),
            *(["  <asset>", *assets, "  </asset>", ""] if assets else []),
            "  <worldbody>",
            *bodies,
            "  </worldbody>",
        ]
        for tag, lines in (
            ("contact", self._excluded()),
            ("equality", self._coupled()),
            ("actuator", self._motors()),
        ):
            if lines:
                parts += ["", f"  <{tag}>", *(f"    {line}" for line in lines), f"  </{tag}>"]
        return "\n".join([*parts, "</mujoco>", ""])

    @property
    def notes(self) -> list[str]:
        """What the MJCF lacks of the URDF, in sentences, after `text`."""
        return [f"{what}: {', '.join(of)}" for what, of in self._lost.items()]

    def _roots(self) -> list[str]:
        children = {end_of(joint, "child") for joint in self._joints}
        parents = [end_of(joint, "parent") for joint in self._joints]
        return [one for one in dict.fromkeys([*self._links, *parents]) if one not in children]

    def _body(self, link: str, indent: str, joint: Element | None, armatures: Mapping[str, float]) -> Iterator[str]:
        """Lines of a link, with those that it carries. joint: that carries it."""
        element, inside = self._links.get(link), indent + "  "
        world = link == "world" and joint is None
        if world:
            inside = indent
        else:
            origin = None if joint is None else joint.first("origin")
            yield f"{indent}<body name={quoteattr(link)}{_origin(origin)}>"
        if element is not None:
            if not world:
                yield from self._inertial(element, inside)
            if joint is not None:
                yield from self._joint(joint, inside, armatures)
            yield from self._geometry(element, inside)
        for one in self._joints:
            if end_of(one, "parent") == link:
                yield from self._body(end_of(one, "child"), inside, one, armatures)
        if not world:
            yield f"{indent}</body>"

    def _inertial(self, link: Element, indent: str) -> Iterator[str]:
        inertial = link.first("inertial")
        mass = None if inertial is None else inertial.first("mass")
        if inertial is None or mass is None or float(mass.attributes["value"]) <= 0.0:
            return
        origin, inertia = inertial.first("origin"), inertial.first("inertia")
        entries = {} if inertia is None else inertia.attributes
        full = [entries.get(key, "0") for key in _FULL]
        turn = _numbers(origin, "rpy")
        if np.any(turn):
            axes = Rotation.from_euler("xyz", turn).as_matrix()
            xx, yy, zz, xy, xz, yz = (float(one) for one in full)
            tensor = axes @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes.T
            full = written(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]).split()
        place = _text(origin, "xyz", "0 0 0")
        yield f'{indent}<inertial pos="{place}" mass="{mass.attributes["value"]}" fullinertia="{" ".join(full)}"/>'

    def _joint(self, joint: Element, indent: str, armatures: Mapping[str, float]) -> Iterator[str]:
        kind = _KINDS[joint.attributes["type"]]
        if not kind:
            return
        name = joint.attributes["name"]
        limit, dynamics = joint.first("limit"), joint.first("dynamics")
        words = [f"name={quoteattr(name)}", f'type="{kind}"', f'axis="{_text(joint.first("axis"), "xyz", "1 0 0")}"']
        if joint.attributes["type"] != "continuous" and limit is not None:
            low, high = (limit.attributes.get(key, "0") for key in ("lower", "upper"))
            if float(low) < float(high):
                words.append(f'range="{low} {high}"')
        for key, of in (("damping", "damping"), ("frictionloss", "friction")):
            size = "0" if dynamics is None else dynamics.attributes.get(of, "0")
            if float(size) != 0.0:
                words.append(f'{key}="{size}"')
        if armatures.get(name, 0.0) != 0.0:
            words.append(f'armature="{written([armatures[name]])}"')
        if limit is not None and float(limit.attributes.get("velocity", "0")) > 0.0:
            self._lost.setdefault("MJCF has no largest rate of a joint", []).append(name)
        yield f"{indent}<joint {' '.join(words)}/>"

    def _geometry(self, link: Element, indent: str) -> Iterator[str]:
        for tag in ("visual", "collision"):
            for one in link.all(tag):
                geometry = one.first("geometry")
                shape = self._shape(geometry.children[0]) if geometry is not None and geometry.children else ""
                if not shape:
                    continue
                if tag == "collision":
                    self._solid.add(link.attributes["name"])
                colour = self._colour(one) if tag == "visual" else ""
                yield f'{indent}<geom class="{tag}" {shape}{_origin(one.first("origin"))}{colour}/>'

    def _shape(self, shape: Element) -> str:
        """Attributes of a geom; empty for one that MuJoCo cannot have."""
        of = shape.attributes
        if shape.tag == "mesh":
            return self._mesh(of.get("filename", ""), of.get("scale", "1 1 1"))
        if shape.tag == "box":
            size = [0.5 * float(x) for x in of["size"].split()]
        elif shape.tag == "sphere":
            size = [float(of["radius"])]
        elif shape.tag in ("cylinder", "capsule"):
            size = [float(of["radius"]), 0.5 * float(of["length"])]
        else:
            self._lost.setdefault("left out, because MJCF has no such shape", []).append(shape.tag)
            return ""
        return f'type="{shape.tag}" size="{written(size)}"'

    def _mesh(self, named: str, scale: str) -> str:
        file = _found(self._path, named)
        if file is None:
            self._lost.setdefault("left out, because MuJoCo reads .obj and binary .stl that are there", []).append(
                named
            )
            return ""
        place = Path(os.path.relpath(file, self._folder)).as_posix()
        rest = f"file={quoteattr(place)}" + ("" if scale == "1 1 1" else f' scale="{scale}"')
        name = self._meshes.setdefault(rest, f"{file.stem} {len(self._meshes) + 1}")
        return f'type="mesh" mesh={quoteattr(name)}'

    def _colour(self, visual: Element) -> str:
        material = visual.first("material")
        if material is not None and material.first("color") is None:
            material = self._materials.get(material.attributes.get("name", ""))
        colour = None if material is None else material.first("color")
        return "" if colour is None else f' rgba="{colour.attributes["rgba"]}"'

    def _excluded(self) -> list[str]:
        """Contacts between links that a joint connects, which MuJoCo leaves out only where the first one moves."""
        fixed = {one for root in self._roots() for one in self._welded(root)}
        pairs = []
        for joint in self._joints:
            if _KINDS[joint.attributes["type"]] and end_of(joint, "parent") in fixed:
                behind = [one for one in self._welded(end_of(joint, "child")) if one in self._solid]
                pairs += [(one, other) for one in fixed & self._solid for other in behind]
        return [f"<exclude body1={quoteattr(one)} body2={quoteattr(other)}/>" for one, other in sorted(pairs)]

    def _welded(self, link: str) -> Iterator[str]:
        yield link
        for joint in self._joints:
            if end_of(joint, "parent") == link and not _KINDS[joint.attributes["type"]]:
                yield from self._welded(end_of(joint, "child"))

    def _coupled(self) -> list[str]:
        lines = []
        for joint in self._joints:
            if (mimic := joint.first("mimic")) is not None:
                of = mimic.attributes
                lines.append(
                    f"<joint joint1={quoteattr(joint.attributes['name'])} joint2={quoteattr(of['joint'])} "
                    f'polycoef="{of.get("offset", "0")} {of.get("multiplier", "1")} 0 0 0"/>'
                )
        return lines

    def _motors(self) -> list[str]:
        lines = []
        for joint in self._joints:
            if not _KINDS[joint.attributes["type"]] or joint.first("mimic") is not None:
                continue
            name, limit = quoteattr(joint.attributes["name"]), joint.first("limit")
            effort = 0.0 if limit is None else float(limit.attributes.get("effort", "0"))
            most = f' ctrlrange="{written([-effort])} {written([effort])}"' if effort > 0.0 else ""
            lines.append(f"<motor name={name} joint={name}{most}/>")
        return lines


def _text(element: Element | None, key: str, usual: str) -> str:
    return (None if element is None else element.attributes.get(key)) or usual


def _numbers(element: Element | None, key: str) -> list[float]:
    return [float(one) for one in _text(element, key, "0 0 0").split()]


def _origin(origin: Element | None) -> str:
    """Position and attitude that are not zero, in the digits of the URDF."""
    return "".join(
        f' {word}="{_text(origin, key, "")}"'
        for word, key in (("pos", "xyz"), ("euler", "rpy"))
        if np.any(_numbers(origin, key))
    )


def _found(urdf: Path, named: str) -> Path | None:
    """The file of a mesh that MuJoCo reads; a package is looked for among the folders that the URDF lies in."""
    if named.startswith("package://"):
        package, _, rest = named.removeprefix("package://").partition("/")
        above = [folder.resolve() for folder in (urdf.parent, *urdf.resolve().parents)]
        places = [
            place
            for folder in above
            for place in (folder / package / rest, *([folder / rest] * (folder.name == package)))
        ]
    else:
        places = [urdf.parent / named.removeprefix("file://")]
    file = next((place for place in places if place.is_file()), None)
    if file is None or file.suffix.lower() not in (".obj", ".stl"):
        return None
    if file.suffix.lower() == ".stl":
        content = file.read_bytes()
        if len(content) < 84 or len(content) != 84 + 50 * int.from_bytes(content[80:84], "little"):
            return None
    return file
