# SPDX-License-Identifier: MIT
"""zygos' own files from a URDF chain: the model of its inertials, and the text of its arm file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import tomlkit

from zygos.model.model import Body, Model, Quantity
from zygos.urdf.answers import Answers
from zygos.urdf.chain import Chain, Inertial


def model_of(chain: Chain, inertials: Sequence[Inertial], answers: Answers) -> Model:
    """The model of the inertials of a chain, with the drives that the answers describe."""
    bodies: list[Body] = []
    for index, (segment, inertial) in enumerate(zip(chain.segments, inertials, strict=True)):
        ixx, ixy, ixz, iyy, iyz, izz = (
            Quantity(float(entry), 0.0, "CAD", "kg m^2") for entry in inertial.tensor[np.triu_indices(3)]
        )
        x, y, z = (float(value) for value in inertial.centre)
        bodies.append(
            Body(
                segment.link,
                Quantity(inertial.mass, 0.0, "CAD", "kg"),
                (x, y, z),
                (ixx, ixy, ixz, iyy, iyz, izz),
                chain.hinges[index].xyz if index < len(chain.hinges) else None,
            )
        )
    return Model(chain.name, tuple(bodies), answers.drives())


def arm_text(arm: dict[str, Any], origin: str) -> str:
    """The text of an arm file from its content. origin: the comment at its beginning."""
    document = tomlkit.document()
    document.add(tomlkit.comment(origin))
    for key, value in arm.items():
        if key == "joint":
            joints = tomlkit.aot()
            for joint in value:
                entry = tomlkit.table()
                for name, content in joint.items():
                    entry[name] = _inline(content) if isinstance(content, dict) else content
                joints.append(entry)
            document["joint"] = joints
        elif not isinstance(value, dict):
            document[key] = value
    for key, value in arm.items():
        if isinstance(value, dict):
            document[key] = value
    return tomlkit.dumps(document)


def _inline(content: dict[str, Any]) -> Any:
    entry = tomlkit.inline_table()
    entry.update(content)
    return entry
