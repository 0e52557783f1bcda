# SPDX-License-Identifier: MIT
"""A compiled MJCF in the posture in which it is written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from zygos.simulators.robot import Lump


@dataclass(frozen=True)
class View:
    """A compiled file in the posture in which it is written, in the axes of the base of the arm."""

    tree: Any
    data: Any
    root: int | None
    """The body of a base that floats."""

    @property
    def attitude(self) -> Any:
        """(3, 3) of the base in the world."""
        return np.eye(3) if self.root is None else self.data.xmat[self.root].reshape(3, 3)

    def place(self, at: Any) -> Any:
        """A place of the world (3,), m."""
        origin = np.zeros(3) if self.root is None else self.data.xpos[self.root]
        return self.attitude.T @ (at - origin)

    def pose(self, body: int) -> tuple[Any, Any]:
        """Attitude (3, 3) and origin (3,) of a body or, 0, of the world, m."""
        return self.attitude.T @ self.data.xmat[body].reshape(3, 3), self.place(self.data.xpos[body])

    def lump(self, body: int) -> Lump:
        """The mass of a body."""
        axes = self.attitude.T @ self.data.ximat[body].reshape(3, 3)
        tensor = axes @ np.diag(self.tree.body_inertia[body]) @ axes.T
        return Lump(float(self.tree.body_mass[body]), self.place(self.data.xipos[body]), tensor)
