# SPDX-License-Identifier: MIT
"""Springs of joints in MJCF: fixed tendons between a joint and the hinge of its rotor, a body beside the joint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from zygos.errors import ZygosError
from zygos.simulators.robot import Lump, Spring
from zygos.simulators.view import View

HINGE = 3
"""Kind of a joint, as mujoco.mjtJoint has it."""
_SAME = 1e-6
"""Largest difference of what has to be equal, as share of it, or in m."""
_SAME_ANGLE = 1e-9
"""Largest deflection of a spring that counts as none, rad."""


@dataclass(frozen=True)
class Tie:
    """A tendon that ties a joint of the arm to the hinge of its rotor."""

    tendon: int
    number: int
    """Of the hinge of the rotor."""
    of_joint: float
    """Length for each radian, m."""
    of_rotor: float
    second: int = -1
    """A tendon between the same two with a gap; -1: none."""


def springs_of(path: Path, mujoco: Any, tree: Any, chosen: Sequence[int]) -> dict[int, Tie]:
    """The springs of joints, by number of the joint. Errors: ZygosError for two of them at one joint, of which not one
    has a gap."""
    out: dict[int, Tie] = {}
    gaps: dict[int, Tie] = {}
    for t in range(tree.ntendon):
        start, count = int(tree.tendon_adr[t]), int(tree.tendon_num[t])
        if count != 2 or any(tree.wrap_type[start : start + 2] != mujoco.mjtWrap.mjWRAP_JOINT):
            continue
        ends = [(int(tree.wrap_objid[w]), float(tree.wrap_prm[w])) for w in (start, start + 1)]
        ends.sort(key=lambda end: end[0] not in chosen)
        (joint, own), (other, behind) = ends
        acts = tree.tendon_stiffness[t] != 0.0 or tree.tendon_damping[t] != 0.0
        if joint not in chosen or other in chosen or tree.jnt_type[other] != HINGE or not acts:
            continue
        kind = gaps if tree.tendon_lengthspring[t, 0] < tree.tendon_lengthspring[t, 1] else out
        if joint in kind:
            raise ZygosError(f"{path}: joint {tree.joint(joint).name} has two springs; remedy: keep one of the tendons")
        kind[joint] = Tie(t, other, own, behind)
    for joint, gap in gaps.items():
        tie = out.get(joint)
        if tie is None or (tie.number, tie.of_joint, tie.of_rotor) != (gap.number, gap.of_joint, gap.of_rotor):
            raise ZygosError(
                f"{path}: the spring of joint {tree.joint(joint).name} with a gap (two numbers of springlength) has no "
                "tendon without one beside it; remedy: add one with the same coefficients, and the damping"
            )
        out[joint] = replace(tie, second=gap.tendon)
    return out


def spring_of(path: Path, view: View, tie: Tie, joint: int, carriers: Sequence[int]) -> Spring:
    """What a tendon and a rotor say of the spring of a joint. carriers: bodies that the joints of the arm move.

    Errors: ZygosError for what zygos has no equations for.
    """
    tree, t, r = view.tree, tie.tendon, tie.number
    refuse = partial(_refuse, path, tree.joint(joint).name)
    lump = _rotor(view, tie, joint, carriers, refuse)
    if tree.tendon_limited[t] or tree.tendon_frictionloss[t] != 0.0 or tree.tendon_armature[t] != 0.0:
        refuse("is tied by a tendon with a range, friction or an armature", "remove these from the tendon")
    stiffer = terms(tree, "tendon_stiffnesspoly", t)
    if np.any(terms(tree, "tendon_dampingpoly", t) != 0.0) or stiffer[0] != 0.0:
        refuse("is tied by a tendon with a polynomial", "one damping, and at most a stiffness and its cubic term")
    main, size = float(tree.tendon_stiffness[t]), tie.of_joint**2
    slack, gap = _gap(tree, tie, refuse) if tie.second >= 0 else (0.0, 0.0)
    if not main * size + slack > 0.0:
        refuse("is tied by a tendon without stiffness", "write one")
    cubic, bent = float(stiffer[1]) * size**2, float(tree.tendon_lengthspring[t, 0] - tree.tendon_length0[t])
    offset = tie.of_joint * main * bent if abs(bent) > _SAME_ANGLE * abs(tie.of_joint) else 0.0
    if (cubic or slack) and offset:
        refuse("is tied by tendons with a springlength beside a cubic stiffness or a gap", "remove springlength")
    return Spring(
        lump,
        float(tree.qpos0[int(tree.jnt_qposadr[r])]),
        -tie.of_joint / tie.of_rotor,
        main * size + slack,
        float(tree.tendon_damping[t]) * size,
        cubic,
        offset,
        slack,
        gap,
        float(tree.dof_frictionloss[int(tree.jnt_dofadr[r])]),
        float(tree.dof_damping[int(tree.jnt_dofadr[r])]),
        r,
        t,
        tie.second,
        tie.of_rotor,
    )


def terms(tree: Any, name: str, at: int) -> Any:
    """(2,) further terms of a stiffness or a damping; MuJoCo has them from 4.0 on."""
    return getattr(tree, name, np.zeros((at + 1, 2)))[at]


def _refuse(path: Path, joint: str, what: str, remedy: str) -> NoReturn:
    raise ZygosError(f"{path}: the rotor of joint {joint} {what}; remedy: {remedy}")


def _gap(tree: Any, tie: Tie, refuse: Callable[[str, str], NoReturn]) -> tuple[float, float]:
    """Stiffness beyond the gap of the second tendon, and half the width of the gap, both behind the gear."""
    near, far = (float(x - tree.tendon_length0[tie.second]) for x in tree.tendon_lengthspring[tie.second])
    if abs(near + far) > _SAME * (far - near) or np.any(terms(tree, "tendon_stiffnesspoly", tie.second) != 0.0):
        refuse("is tied by a tendon whose gap has another middle, or a polynomial", "a gap about the relaxed spring")
    if tree.tendon_damping[tie.second] != 0.0:
        refuse("is tied by a tendon with a gap and damping", "the damping in the other tendon")
    return float(tree.tendon_stiffness[tie.second]) * tie.of_joint**2, 0.5 * (far - near) / abs(tie.of_joint)


def _rotor(view: View, tie: Tie, joint: int, carriers: Sequence[int], refuse: Callable[[str, str], NoReturn]) -> Lump:
    """The mass of a rotor, which is round and turns about the axis of its joint."""
    tree, data, r = view.tree, view.data, tie.number
    body, dof = int(tree.jnt_bodyid[r]), int(tree.jnt_dofadr[r])

    def moves_with(at: int) -> int:
        stops = {*carriers, view.root, 0}
        while at not in stops:
            at = int(tree.body_parentid[at])
        return at

    if moves_with(int(tree.body_parentid[body])) != moves_with(int(tree.body_parentid[int(tree.jnt_bodyid[joint])])):
        refuse("is not carried by the body before the joint", "put its body there")
    if np.any(tree.body_parentid == body) or tree.body_jntnum[body] != 1:
        refuse("carries a body or has a second joint", "keep one hinge, and fix other bodies to the link")
    axis, apart = data.xaxis[joint], data.xanchor[r] - data.xanchor[joint]
    if np.dot(axis, data.xaxis[r]) < 1.0 - _SAME or np.linalg.norm(np.cross(axis, apart)) > _SAME:
        refuse("does not turn about the axis of the joint", "give both hinges one axis, with the same sign")
    if not -tie.of_joint / tie.of_rotor > 0.0:
        refuse("turns the other way", "coefficients 1/n for the rotor and -1 for the joint, n being the gear ratio")
    if tree.dof_armature[dof] != 0.0 or tree.dof_armature[int(tree.jnt_dofadr[joint])] != 0.0:
        refuse(
            "or the joint itself has an armature, which takes no part in the motion of the body that carries it",
            "write the inertia of the rotor into its <inertial>, and no armature",
        )
    if tree.jnt_stiffness[r] != 0.0 or np.any(terms(tree, "dof_dampingpoly", dof) != 0.0):
        refuse("has a spring of its own or a damping polynomial", "write one damping, and no stiffness")
    axis, lump = view.attitude.T @ axis, view.lump(body)
    about = float(axis @ lump.tensor @ axis)
    across = 0.5 * (float(np.trace(lump.tensor)) - about)
    even = about * np.outer(axis, axis) + across * (np.eye(3) - np.outer(axis, axis))
    off = np.cross(axis, lump.centre - view.place(data.xanchor[joint]))
    if np.max(np.abs(lump.tensor - even)) > _SAME * max(about, across) or np.linalg.norm(off) > _SAME:
        refuse(
            "is not round: turned, it is another body for the arm",
            "a mass centre on the axis, and equal moments of inertia across it",
        )
    return lump
