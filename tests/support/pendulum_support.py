# SPDX-License-Identifier: MIT
"""The measured double pendulum of examples/pendulum, as runs."""

from __future__ import annotations

from pathlib import Path

from cli_support import run

from zygos.arm import load_arm
from zygos.can.run import Run
from zygos.runs.tables import read_cycles

PENDULUM = Path(__file__).parents[2] / "examples" / "pendulum"
NAMES = ("00", "01", "02", "03", "11")
"""Of its recordings."""


def recordings(folder: Path) -> dict[str, Run]:
    """The recordings by name, converted into a folder."""
    out = {}
    for name in NAMES:
        table = folder / name / "run.npz"
        table.parent.mkdir()
        options = ("--dbc", PENDULUM / "arm.dbc", "--map", PENDULUM / "map.toml", "-o", table)
        assert run("convert", PENDULUM / f"{name}.blf", *options) == 0
        arm = load_arm(table.parent / "arm.toml")
        out[name] = Run(arm, table=read_cycles(table, arm), path=table)
    return out
