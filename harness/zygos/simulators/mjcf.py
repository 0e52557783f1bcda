# SPDX-License-Identifier: MIT
"""MJCF: read by MuJoCo itself, and mapped to the elements of the file that state what was read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from zygos.errors import ZygosError, installs
from zygos.simulators.robot import Hinge, Lump, Owner, Robot, written
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

    Errors: ZygosError for a file that MuJoCo does not read, for a base that moves, for a chain that is not one of
    hinges, and for what zygos has no equations for.
    """
    document = read_document(path, includes=True)
    check_compiler(document)
    tree = compiled(path)
    return robot_of(path, tree, joints, document)


def robot_of(path: Path, tree: Any, joints: Sequence[str] | int | None, document: Document | None = None) -> Robot:
    """The serial arm of a compiled file; document: its elements, each of which must have a place to be corrected at.

    Errors: as `read_mjcf`."""
    mujoco = load_mujoco()
    data = mujoco.MjData(tree)
    mujoco.mj_kinematics(tree, data)
    chosen = _chosen(path, tree, joints)
    _check(path, mujoco, tree, chosen)
    if document is not None:
        bodies_of(document, tree)
    carriers = [int(tree.jnt_bodyid[j]) for j in chosen]
    hinges = tuple(
        Hinge(
            tree.joint(j).name or f"joint{k}",
            data.xanchor[j].copy(),
            _clean(data.xaxis[j]),
            float(tree.qpos0[tree.jnt_qposadr[j]]),
            float(tree.dof_armature[tree.jnt_dofadr[j]]),
            float(tree.dof_frictionloss[tree.jnt_dofadr[j]]),
            float(tree.dof_damping[tree.jnt_dofadr[j]]),
            _gear(mujoco, tree, j),
            j,
            tree.joint(j).name,
            (float(tree.jnt_range[j, 0]), float(tree.jnt_range[j, 1])) if tree.jnt_limited[j] else None,
        )
        for k, j in enumerate(chosen, start=1)
    )
    members: list[list[int]] = [[] for _ in chosen]
    for body in range(1, tree.nbody):
        at = body
        while at and at not in carriers:
            at = int(tree.body_parentid[at])
        if at:
            members[carriers.index(at)].append(body)
    owners = []
    for hinge, bodies in zip(hinges, members, strict=True):
        heaviest = max(bodies, key=lambda b: float(tree.body_mass[b]))
        if not tree.body_mass[heaviest] > 0.0:
            raise ZygosError(f"{path}: what joint {hinge.name} moves has no mass; remedy: give its body an <inertial>")
        lumps = {b: _lump(tree, data, b) for b in bodies}
        owners.append(
            Owner(
                tree.body(heaviest).name or f"body {heaviest}",
                data.xmat[heaviest].reshape(3, 3).copy(),
                data.xpos[heaviest].copy(),
                lumps.pop(heaviest),
                tuple(lumps.values()),
                heaviest,
            )
        )
    held = [tree.joint(j).name for j in range(tree.njnt) if j not in chosen]
    notes = [f"held where the file has it: joint {', '.join(held)}"] if held else []
    return Robot(path, "MJCF", hinges, tuple(owners), np.array(tree.opt.gravity), tuple(notes))


def corrected_mjcf(old: Robot, new: Robot, rename: Callable[[Path], str]) -> dict[Path, bytes]:
    """The bytes of a file, and of those that it includes and that change, with the inertials, armatures, friction and
    damping of another robot. rename: what an `<include>` calls a changed file.

    Errors: ZygosError where a body has no element of its own.
    """
    document = read_document(old.path, includes=True)
    tree = compiled(old.path)
    elements, edits = bodies_of(document, tree), Edits(document)
    for before, after in zip(old.hinges, new.hinges, strict=True):
        body = int(tree.jnt_bodyid[before.number])
        own = joints_of(elements[body - 1])[before.number - int(tree.body_jntadr[body])]
        for name, was, now in (
            ("armature", before.armature, after.armature),
            ("frictionloss", before.friction, after.friction),
            ("damping", before.damping, after.damping),
        ):
            if was != now:
                edits.give(own, **{name: written([now])})
    for carried, owner in zip(old.owners, new.owners, strict=True):
        if carried.own is owner.own:
            continue
        lump = owner.own.in_frame(owner.attitude, owner.origin)
        full = lump.tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        entries = {"pos": written(lump.centre), "mass": written([lump.mass]), "fullinertia": written(full)}
        element = elements[owner.number - 1]
        inertial = element.first("inertial")
        if inertial is None:
            edits.insert(element, "<inertial " + " ".join(f'{k}="{v}"' for k, v in entries.items()) + "/>")
        else:
            edits.give(inertial, **entries, **dict.fromkeys(_TURNS))
    return edits.result(rename)


def _chosen(path: Path, tree: Any, joints: Sequence[str] | int | None) -> list[int]:
    """Numbers of the joints of the arm in the order from the base."""
    free = [j for j in range(tree.njnt) if tree.jnt_type[j] == 0]
    if free:
        raise ZygosError(
            f"{path}: the base floats (free joint {tree.joint(free[0]).name or 'without a name'}), and files of a "
            "simulator are for a fixed base; remedy: a model.toml as --simulation"
        )
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
            j for j in range(tree.njnt) if tree.jnt_type[j] == 3 and j not in chosen and _next(tree, j, at, chosen)
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


def _carries(tree: Any, body: int, other: int) -> bool:
    """Whether a body carries another one."""
    while other and other != body:
        other = int(tree.body_parentid[other])
    return other == body


def _next(tree: Any, joint: int, body: int, chosen: Sequence[int]) -> bool:
    """Whether a hinge is the next one behind a body: no hinge lies between them."""
    at = int(tree.jnt_bodyid[joint])
    hinged = {int(tree.jnt_bodyid[j]) for j in range(tree.njnt) if tree.jnt_type[j] == 3 and j != joint}
    hinged -= {int(tree.jnt_bodyid[j]) for j in chosen}
    at = int(tree.body_parentid[at])
    while at != body:
        if at == 0 or at in hinged:
            return False
        at = int(tree.body_parentid[at])
    return True


def _check(path: Path, mujoco: Any, tree: Any, chosen: Sequence[int]) -> None:  # noqa: PLR0912  (a list of refusals)
    """Refuse, with ZygosError, what zygos has no equations for."""

    def refuse(what: str, remedy: str) -> None:
        raise ZygosError(f"{path}: {what}; remedy: {remedy}")

    bodies = [int(tree.jnt_bodyid[j]) for j in chosen]
    between = bodies[-1]
    while between:
        for j in range(tree.njnt):
            if tree.jnt_bodyid[j] == between and j not in chosen:
                refuse(
                    f"joint {tree.joint(j).name} lies between the joints of the arm and is none of them",
                    "give all joints of the arm in the arm file; linear axes are not supported",
                )
        between = int(tree.body_parentid[between])
    if len(set(bodies)) < len(bodies):
        refuse("a body has two joints", "put a body with mass between them")
    for j in chosen:
        name, dof = tree.joint(j).name, int(tree.jnt_dofadr[j])
        if tree.jnt_type[j] != 3:
            refuse(f"joint {name} does not turn", "linear axes are not supported")
        if tree.jnt_stiffness[j] != 0.0:
            refuse(
                f"joint {name} has a stiffness to the body that carries it, for which zygos has no equations",
                "remove the spring, or explain the arm without it",
            )
        if np.any(getattr(tree, "dof_dampingpoly", np.zeros((tree.nv, 1)))[dof] != 0.0):
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
        if acts and any(j in chosen for j in of):
            refuse(
                f"tendon {tree.tendon(t).name} acts on the joints of the arm",
                "a model.toml with flexible joints as --simulation",
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


def _lump(tree: Any, data: Any, body: int) -> Lump:
    axes = data.ximat[body].reshape(3, 3)
    return Lump(float(tree.body_mass[body]), data.xipos[body].copy(), axes @ np.diag(tree.body_inertia[body]) @ axes.T)


def _clean(axis: Any) -> Any:
    """A unit vector without what rounding leaves of a zero."""
    found = np.where(np.abs(axis) < 1e-9, 0.0, axis)
    return found / np.linalg.norm(found)
