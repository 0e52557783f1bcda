# SPDX-License-Identifier: MIT
"""MJCF: read by MuJoCo itself, and mapped to the elements of the file that state what was read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from zygos.errors import ZygosError, installs
from zygos.simulators.added import add_springs, attributes, gap, inertial, stiffness
from zygos.simulators.robot import Hinge, Lump, Owner, Robot, Spring, written
from zygos.simulators.springs import HINGE, spring_of, springs_of, terms
from zygos.simulators.view import View
from zygos.simulators.xml import Document, Edits, Element, read_document

_MAKERS = ("replicate", "attach", "composite", "flexcomp")
"""Elements that make bodies of which the file has no element of their own."""
_FALSIFYING = {
    "settotalmass": "scales all masses",
    "inertiafromgeom": "replaces inertials by those of geoms",
    "balanceinertia": "changes inertias",
    "boundmass": "raises masses",
    "boundinertia": "raises inertias",
}
"""Attributes of `<compiler>` with which the numbers of an `<inertial>` are not those that are simulated."""
_TURNS = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")
"""What an `<inertial>` with fullinertia must not have."""
_SWITCHED_OFF = ("", "false", "auto", "0", "-1")
_TENDONS = ("fixed", "spatial")
_FREE = 0
"""Kind of a joint, as mujoco.mjtJoint has it."""


def load_mujoco() -> Any:
    """The package. Errors: ZygosError where it is not installed."""
    try:
        import mujoco  # noqa: PLC0415  (an extra)
    except ImportError:
        raise ZygosError(f"MJCF is read by MuJoCo, which is not installed; remedy: {installs('engines')}") from None
    return mujoco


def compiled(path: Path) -> Any:
    """The MjModel of a file. Errors: ZygosError with MuJoCo's reason."""
    mujoco = load_mujoco()
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError) as error:
        raise ZygosError(
            f"{path}: MuJoCo does not read it ({' '.join(str(error).split())}); remedy: correct the file"
        ) from None


def bodies_of(document: Document, tree: Any) -> list[Element]:
    """The element of each body of a compiled file but the world, in MuJoCo's order.

    Errors: ZygosError where some bodies have no element of their own.
    """
    found: list[Element] = []

    def visit(element: Element) -> None:
        for child in element.children:
            if child.tag in _MAKERS:
                raise ZygosError(
                    f"{child.file}: line {child.line}: <{child.tag}> makes bodies that have no element of their own "
                    "to be corrected; remedy: write them out (MuJoCo's `MjSpec.to_xml` does)"
                )
            if child.tag == "body":
                found.append(child)
            if child.tag in ("body", "frame", "worldbody"):
                visit(child)

    visit(document.root)
    names = [tree.body(i).name for i in range(1, tree.nbody)]
    if names != [element.attributes.get("name", "") for element in found]:
        raise ZygosError(
            f"{document.path}: the bodies that MuJoCo makes of it are not those that are written there; remedy: write "
            "every body as an element of its own"
        )
    return found


def joints_of(body: Element) -> list[Element]:
    """The elements of a body's joints, in order."""
    out: list[Element] = []
    for child in body.children:
        if child.tag in ("joint", "freejoint"):
            out.append(child)
        elif child.tag == "frame":
            out += joints_of(child)
    return out


def check_compiler(document: Document) -> None:
    """Refuse, with ZygosError, options with which inertials would not be simulated as they are written."""
    for element in document.root.walk():
        if element.tag != "compiler":
            continue
        for name, does in _FALSIFYING.items():
            if element.attributes.get(name, "") not in _SWITCHED_OFF:
                raise ZygosError(
                    f"{element.file}: line {element.line}: {name} of <compiler> {does}, so that a corrected inertial "
                    "would not be what is simulated; remedy: remove it, and write the inertials that MuJoCo uses"
                )


def read_mjcf(path: Path, joints: Sequence[str] | int | None) -> Robot:
    """The serial arm of a file.

    joints: names of the joints in the order from the base, or their number, counted along the only chain; None: all
    hinges of the only chain. Other joints are held where the file has them.

    Errors: ZygosError for a file that MuJoCo does not read, for a base that moves otherwise than by a free joint, for a
    chain that is not one of hinges, and for what zygos has no equations for.
    """
    document = read_document(path, includes=True)
    check_compiler(document)
    tree = compiled(path)
    mujoco = load_mujoco()
    if (joints is None or isinstance(joints, int)) and _floats_or_bends(mujoco, tree):
        raise ZygosError(
            f"{path}: its arm floats or has springs, whose encoders, gears and gyro no file of a simulator states; "
            "remedy: give the arm file with --arm, and logs or tables that `zygos convert` wrote"
        )
    chosen = _chosen(path, tree, joints)
    root = _root(path, tree, chosen[0])
    springs = springs_of(path, mujoco, tree, chosen)
    _check(path, mujoco, tree, chosen, [t for one in springs.values() for t in (one.tendon, one.second)])
    bodies_of(document, tree)
    view = _view(tree, root)
    data = view.data
    carriers = [int(tree.jnt_bodyid[j]) for j in chosen]
    rotors = {int(tree.jnt_bodyid[one.number]) for one in springs.values()}
    hinges = tuple(
        Hinge(
            tree.joint(j).name or f"joint{k}",
            view.place(data.xanchor[j]),
            _clean(view.attitude.T @ data.xaxis[j]),
            float(tree.qpos0[tree.jnt_qposadr[j]]),
            float(tree.dof_armature[tree.jnt_dofadr[j]]),
            float(tree.dof_frictionloss[tree.jnt_dofadr[j]]),
            float(tree.dof_damping[tree.jnt_dofadr[j]]),
            _gear(mujoco, tree, j),
            j,
            tree.joint(j).name,
            (float(tree.jnt_range[j, 0]), float(tree.jnt_range[j, 1])) if tree.jnt_limited[j] else None,
            spring_of(path, view, springs[j], j, carriers) if j in springs else None,
        )
        for k, j in enumerate(chosen, start=1)
    )
    members: dict[int, list[int]] = {body: [] for body in ([] if root is None else [root]) + carriers}
    for body in range(1, tree.nbody):
        at = body
        while at and at not in members:
            at = int(tree.body_parentid[at])
        if at and body not in rotors:
            members[at].append(body)
    named = ["the base", *(f"what joint {hinge.name} moves" for hinge in hinges)]
    owners = [
        _owner(path, view, bodies, said) for said, bodies in zip(named[-len(members) :], members.values(), strict=True)
    ]
    base = owners.pop(0) if root is not None else None
    known = {*chosen, *(one.number for one in springs.values())}
    held = [tree.joint(j).name for j in range(tree.njnt) if j not in known and tree.jnt_type[j] != _FREE]
    notes = [f"held where the file has it: joint {', '.join(held)}"] if held else []
    return Robot(
        path, "MJCF", hinges, tuple(owners), np.array(tree.opt.gravity) @ view.attitude, tuple(notes), base=base
    )


def _owner(path: Path, view: View, bodies: Sequence[int], said: str) -> Owner:
    """Of bodies that move together, the one whose inertial is changed: the heaviest. said: what they are."""
    tree = view.tree
    heaviest = max(bodies, key=lambda b: float(tree.body_mass[b]))
    if not tree.body_mass[heaviest] > 0.0:
        raise ZygosError(f"{path}: {said} has no mass; remedy: give its body an <inertial>")
    lumps = {b: view.lump(b) for b in bodies}
    return Owner(
        tree.body(heaviest).name or f"body {heaviest}",
        *view.pose(heaviest),
        lumps.pop(heaviest),
        tuple(lumps.values()),
        heaviest,
    )


def corrected_mjcf(old: Robot, new: Robot, rename: Callable[[Path], str]) -> dict[Path, bytes]:
    """The bytes of a file, and of those that it includes and that change, with the inertials, armatures, friction and
    damping of another robot. rename: what an `<include>` calls a changed file.

    Errors: ZygosError where a body has no element of its own.
    """
    document = read_document(old.path, includes=True)
    tree = compiled(old.path)
    elements, edits = bodies_of(document, tree), Edits(document)
    arm = int(tree.body_rootid[int(tree.jnt_bodyid[old.hinges[0].number])])
    view = _view(tree, None if old.base is None else arm)

    def joint(number: int) -> Element:
        body = int(tree.jnt_bodyid[number])
        return joints_of(elements[body - 1])[number - int(tree.body_jntadr[body])]

    def weigh(body: int, lump: Lump) -> None:
        entries = inertial(lump)
        present = elements[body - 1].first("inertial")
        if present is None:
            edits.insert(elements[body - 1], f"<inertial {attributes(entries)}/>")
        else:
            edits.give(present, **entries, **dict.fromkeys(_TURNS))

    for before, after in zip(old.hinges, new.hinges, strict=True):
        _change(
            edits,
            joint(before.number),
            ("armature", before.armature, after.armature),
            ("frictionloss", before.friction, after.friction),
            ("damping", before.damping, after.damping),
        )
        was, now = before.spring, after.spring
        if was is None or now is None or was is now or was.added:
            continue
        _change(edits, joint(was.number), ("frictionloss", was.friction, now.friction), ("damping", was.rub, now.rub))
        _tie(edits, document, tree, was, now)
        if now.rotor is not was.rotor:
            body = int(tree.jnt_bodyid[was.number])
            weigh(body, now.rotor.in_frame(*view.pose(body)))
    if new.added:
        add_springs(edits, elements, view, new.added)
    for carried, owner in zip(old.bodies, new.bodies, strict=True):
        if carried.own is not owner.own:
            weigh(owner.number, owner.own.in_frame(owner.attitude, owner.origin))
    return edits.result(rename)


def _change(edits: Edits, element: Element, *numbers: tuple[str, float, float]) -> None:
    """Give an element those attributes that become other numbers: name, before and after."""
    for name, was, now in numbers:
        if was != now:
            edits.give(element, **{name: written([now])})


def _tie(edits: Edits, document: Document, tree: Any, was: Spring, now: Spring) -> None:
    """Change the tendons of a spring."""
    tendons = tendons_of(document)
    tendon, size = tendons[was.tendon], (was.coefficient * was.ratio) ** 2
    _change(edits, tendon, ("damping", was.damping / size, now.damping / size))
    if (was.stiffness, was.slack, was.cubic) != (now.stiffness, now.slack, now.cubic):
        edits.give(tendon, stiffness=stiffness(now))
    if (was.slack, was.gap_rad) != (now.slack, now.gap_rad):
        own = gap(now, float(tree.tendon_length0[was.tendon]))
        if was.second >= 0:
            edits.give(tendons[was.second], **own)
        else:
            inner = "".join(f"<joint {attributes(one.attributes)}/>" for one in tendon.all("joint"))
            section = next(one for one in document.root.all("tendon") if tendon in one.children)
            edits.insert(section, f"<fixed {attributes(own)}>{inner}</fixed>")
    if (was.stiffness, was.offset) != (now.stiffness, now.offset) and (was.offset or now.offset):
        # the length at the zeros, and what the offset adds to it
        low = float(tree.tendon_lengthspring[was.tendon, 0])
        of_joint = -was.coefficient * was.ratio
        low += of_joint * (now.offset / now.stiffness - was.offset / was.stiffness)
        edits.give(tendon, springlength=written([low]))


def _view(tree: Any, root: int | None) -> View:
    """A compiled file in the posture in which it is written. root: body of a base that floats."""
    mujoco = load_mujoco()
    data = mujoco.MjData(tree)
    mujoco.mj_kinematics(tree, data)
    return View(tree, data, root)


def tendons_of(document: Document) -> list[Element]:
    """The elements of the tendons, in MuJoCo's order."""
    return [one for section in document.root.all("tendon") for one in section.children if one.tag in _TENDONS]


def _chosen(path: Path, tree: Any, joints: Sequence[str] | int | None) -> list[int]:
    """Numbers of the joints of the arm in the order from the base."""
    names = [tree.joint(j).name for j in range(tree.njnt)]
    if joints is not None and not isinstance(joints, int) and all(name in names for name in joints):
        chosen = [names.index(name) for name in joints]
        for before, behind in pairwise(chosen):
            if not _carries(tree, int(tree.jnt_bodyid[before]), int(tree.jnt_bodyid[behind])):
                raise ZygosError(
                    f"{path}: joint {names[before]} does not carry joint {names[behind]}; remedy: name the joints in "
                    "the arm file in the order from the base outwards"
                )
        return chosen
    count = joints if isinstance(joints, int) else None if joints is None else len(joints)
    chosen = list[int]()
    at = 0
    while count is None or len(chosen) < count:
        after = [
            j for j in range(tree.njnt) if tree.jnt_type[j] == HINGE and j not in chosen and _next(tree, j, at, chosen)
        ]
        if not after:
            break
        if len(after) > 1:
            raise ZygosError(
                f"{path}: the chain branches: joints {', '.join(names[j] for j in after)}; remedy: name the joints of "
                "the arm with an arm file (--arm)"
            )
        chosen.append(after[0])
        at = int(tree.jnt_bodyid[after[0]])
    if not chosen or (count is not None and len(chosen) < count):
        raise ZygosError(
            f"{path}: has {len(chosen)} hinges in a chain from the base, the runs have {count or 'some'}; remedy: give "
            "the file of this arm"
        )
    return chosen


def _floats_or_bends(mujoco: Any, tree: Any) -> bool:
    """Whether a body that floats carries hinges, or a tendon is a spring between two hinges."""
    hinged = [int(tree.body_rootid[tree.jnt_bodyid[j]]) for j in range(tree.njnt) if tree.jnt_type[j] == HINGE]
    floats = any(tree.jnt_type[j] == _FREE and int(tree.jnt_bodyid[j]) in hinged for j in range(tree.njnt))
    return floats or any(
        tree.tendon_stiffness[t] != 0.0
        and tree.tendon_num[t] == 2
        and tree.wrap_type[int(tree.tendon_adr[t])] == mujoco.mjtWrap.mjWRAP_JOINT
        for t in range(tree.ntendon)
    )


def _root(path: Path, tree: Any, first: int) -> int | None:
    """The body of a base that floats; None where it is fixed. first: number of the first joint of the arm.

    Errors: ZygosError where another body floats."""
    root = int(tree.body_rootid[int(tree.jnt_bodyid[first])])
    free = [j for j in range(tree.njnt) if tree.jnt_type[j] == _FREE]
    other = [j for j in free if tree.jnt_bodyid[j] != root]
    if other:
        raise ZygosError(
            f"{path}: body {tree.body(int(tree.jnt_bodyid[other[0]])).name or 'without a name'} floats, and is not the "
            "base of the arm; remedy: leave it out of the file that is corrected"
        )
    return root if free else None


def _carries(tree: Any, body: int, other: int) -> bool:
    """Whether a body carries another one."""
    while other and other != body:
        other = int(tree.body_parentid[other])
    return other == body


def _next(tree: Any, joint: int, body: int, chosen: Sequence[int]) -> bool:
    """Whether a hinge is the next one behind a body: no hinge lies between them."""
    at = int(tree.jnt_bodyid[joint])
    hinged = {int(tree.jnt_bodyid[j]) for j in range(tree.njnt) if tree.jnt_type[j] == HINGE and j != joint}
    hinged -= {int(tree.jnt_bodyid[j]) for j in chosen}
    at = int(tree.body_parentid[at])
    while at != body:
        if at == 0 or at in hinged:
            return False
        at = int(tree.body_parentid[at])
    return True


def _check(  # noqa: PLR0912  (a list of refusals)
    path: Path, mujoco: Any, tree: Any, chosen: Sequence[int], springs: Sequence[int]
) -> None:
    """Refuse, with ZygosError, what zygos has no equations for."""

    def refuse(what: str, remedy: str) -> None:
        raise ZygosError(f"{path}: {what}; remedy: {remedy}")

    bodies = [int(tree.jnt_bodyid[j]) for j in chosen]
    between = bodies[-1]
    while between:
        for j in range(tree.njnt):
            if tree.jnt_bodyid[j] == between and j not in chosen and tree.jnt_type[j] != _FREE:
                refuse(
                    f"joint {tree.joint(j).name} lies between the joints of the arm and is none of them",
                    "give all joints of the arm in the arm file; linear axes are not supported",
                )
        between = int(tree.body_parentid[between])
    if len(set(bodies)) < len(bodies):
        refuse("a body has two joints", "put a body with mass between them")
    for j in chosen:
        name, dof = tree.joint(j).name, int(tree.jnt_dofadr[j])
        if tree.jnt_type[j] != HINGE:
            refuse(f"joint {name} does not turn", "linear axes are not supported")
        if tree.jnt_stiffness[j] != 0.0:
            refuse(
                f"joint {name} has a stiffness to the body that carries it, for which zygos has no equations",
                "remove the spring, or explain the arm without it",
            )
        if np.any(terms(tree, "dof_dampingpoly", dof) != 0.0):
            refuse(f"the damping of joint {name} is a polynomial", "write a single number")
        body = int(tree.jnt_bodyid[j])
        if tree.body_gravcomp[body] != 0.0:
            refuse(f"body {tree.body(body).name} has gravcomp", "compensate gravity in the controller")
    if tree.opt.density != 0.0 or tree.opt.viscosity != 0.0:
        refuse("<option> has density or viscosity, for which zygos has no equations", "set both to 0")
    for t in range(tree.ntendon):
        start, count = int(tree.tendon_adr[t]), int(tree.tendon_num[t])
        acts = tree.tendon_stiffness[t] != 0.0 or tree.tendon_damping[t] != 0.0 or tree.tendon_frictionloss[t] != 0.0
        of = [
            int(tree.wrap_objid[w])
            for w in range(start, start + count)
            if tree.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT
        ]
        if acts and t not in springs and any(j in chosen for j in of):
            refuse(
                f"tendon {tree.tendon(t).name} acts on the joints of the arm, and ties none of them to its rotor",
                "a fixed tendon between the joint and the hinge of its rotor (docs/simulators.md), or a model.toml as "
                "--simulation",
            )
    for e in range(tree.neq):
        if tree.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and {int(tree.eq_obj1id[e]), int(tree.eq_obj2id[e])} & set(
            chosen
        ):
            refuse("an equality couples joints of the arm", "remove it; coupled axes are not supported")


def _gear(mujoco: Any, tree: Any, joint: int) -> float | None:
    """Of the only actuator of a joint, where it is a gear."""
    gears = [
        abs(float(tree.actuator_gear[a, 0]))
        for a in range(tree.nu)
        if tree.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT and tree.actuator_trnid[a, 0] == joint
    ]
    return gears[0] if len(gears) == 1 and gears[0] > 1.5 else None


def _clean(axis: Any) -> Any:
    """A unit vector without what rounding leaves of a zero."""
    found = np.where(np.abs(axis) < 1e-9, 0.0, axis)
    return found / np.linalg.norm(found)
