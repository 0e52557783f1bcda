# SPDX-License-Identifier: MIT
"""The bodies of a chain as a table and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zygos.files.output import number, table
from zygos.model.model import Model

if TYPE_CHECKING:
    from zygos.urdf.chain import Chain


def table_of_bodies(chain: Chain, model: Model) -> None:
    """Print the bodies of a chain."""
    rows = []
    for segment, body in zip(chain.segments, model.bodies, strict=True):
        moments = np.linalg.eigvalsh(body.tensor)
        values = [body.mass.value, *body.origin_xyz, *moments]
        rows.append((segment.link, str(len(segment.merged)), *(number(float(value), 4) for value in values)))
    table(("link", "merged", "mass, kg", "x, m", "y, m", "z, m", "I1, kg m^2", "I2, kg m^2", "I3, kg m^2"), rows)


def links_as_json(chain: Chain, model: Model) -> list[dict[str, Any]]:
    """Name, mass, mass centre and inertia of each link of a chain, for the JSON of import and export."""
    return [
        {
            "link": segment.link,
            "merged": list(segment.merged),
            "mass": body.mass.value,
            "centre": list(body.origin_xyz),
            "inertia": [entry.value for entry in body.inertia],
        }
        for segment, body in zip(chain.segments, model.bodies, strict=True)
    ]
