# SPDX-License-Identifier: MIT
"""Packages that cannot be imported: the installation without extras, in this process."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from conftest import ROOT

IMPORTS = {
    "engines": ("pinocchio", "mujoco"),
    "urdf": ("urdf_parser_py", "lxml"),
    "tables": ("polars",),
    "mf4": ("asammdf",),
    "ros": ("mcap", "mcap_ros2"),
    "fit": ("cvxpy", "clarabel"),
    "view": ("matplotlib", "mpl_toolkits", "trimesh", "viser"),
    "cluster": ("distributed",),
    "serial": ("serial",),
    "testing": ("pytest",),
}
"""The modules of each extra of pyproject.toml."""
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@contextmanager
def absent(*names: str) -> Iterator[None]:
    """Context in which these packages are not installed. Modules of zygos are imported anew in it, and those from
    before come back at its end."""

    def loaded() -> dict[str, ModuleType]:
        return {name: one for name, one in sys.modules.items() if name.partition(".")[0] in (*names, "zygos")}

    kept = loaded()
    for name in kept:
        del sys.modules[name]
    blocked: dict[str, Any] = dict.fromkeys(names)  # what is None there cannot be imported
    sys.modules.update(blocked)
    try:
        yield
    finally:
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(kept)
