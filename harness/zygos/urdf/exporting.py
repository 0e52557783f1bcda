# SPDX-License-Identifier: MIT
"""The export of a model to a URDF: the bodies nearest to its parameters, and the chain to which they belong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.model.model import Model, load_model
from zygos.model.nearest import ENTRIES, Nearest
from zygos.urdf.chain import Chain, read_chain_of

_SAME = 1e-9
"""Largest difference of lengths (relative to the longest) and of attitudes between a URDF and an arm."""


def bodies_of(model_file: Path, model: Model, cad: Path | None) -> Model:
    """The model itself if it is given by bodies, otherwise the drawing."""
    if model.bodies:
        if cad is not None:
            raise ZygosError(f"{model_file}: is given by bodies, which are written unchanged; remedy: leave out --cad")
        return model
    if cad is None:
        raise ZygosError(
            f"{model_file}: base parameters do not determine each single inertial; remedy: give the drawing that "
            "determines the rest with --cad MODEL.toml"
        )
    drawing = load_model(cad)
    if not drawing.bodies:
        raise ZygosError(f"{cad}: contains base parameters; remedy: give a model with [[body]] and [[joint]]")
    return drawing


def chain_of(urdf: Path, arm: Arm, model: Model, base: str | None) -> Chain:
    """The chain of a URDF that has this arm's joints and this model's lengths."""
    names = [joint.name for joint in arm.joints]
    if [joint.name for joint in model.joints] != names:
        raise ZygosError(
            f"model {model.name} has joints {[joint.name for joint in model.joints]}, arm {arm.name} has {names}; "
            "remedy: use the same joint names, in order from the base outwards"
        )
    chain = read_chain_of(urdf, base or model.bodies[0].name, names)
    reach = max(float(np.linalg.norm(hinge.xyz)) for hinge in chain.hinges) or 1.0
    for hinge, joint, body in zip(chain.hinges, arm.joints, model.bodies[:-1], strict=True):
        for what, own, other, scale in (
            ("attitude", _attitude(hinge.rpy), _attitude(joint.frame_rpy), 1.0),
            ("axis", np.array(hinge.axis), np.array(joint.axis), 1.0),
            ("place (m)", np.array(hinge.xyz), np.array(body.joint_xyz), reach),
        ):
            if np.max(np.abs(own - other)) > _SAME * scale:
                raise ZygosError(
                    f"{urdf}: the {what} of joint {hinge.name} is {own.tolist()}, but arm {arm.name} and model "
                    f"{model.name} say {other.tolist()}; remedy: give files of the same arm; a fit "
                    "with `zygos fit --lengths 0` has the lengths of its drawing"
                )
    return chain


def _attitude(rpy: Sequence[float]) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = Rotation.from_euler("xyz", rpy).as_matrix()
    return matrix


def comment(found: Nearest, given: Model, cad: Model) -> str:
    """The comment in the file: the source of its inertials, and which of their entries are determined."""
    lines = [
        f" Inertials by `zygos export`: of all bodies with the base parameters of model {given.name}, those nearest to",
        f"     model {cad.name}. The base parameters determine these entries; all others depend on that model:",
    ]
    for body, determined in zip(found.model.bodies, found.determined, strict=True):
        names = [entry for entry, yes in zip(ENTRIES, determined, strict=True) if yes]
        lines.append(f"     {body.name}: {', '.join(names) or 'none'}")
    return "\n".join(lines) + " "
