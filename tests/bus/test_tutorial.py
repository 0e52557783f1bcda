# SPDX-License-Identifier: MIT
"""The tutorial as it is written, on an arm that MuJoCo moves, whose friction nobody tells.

`ZYGOS_TUTORIAL_SEEDS=5 .venv/bin/pytest -s tests/bus/test_tutorial.py` tries more seeds of noise, delays and jitter
than the first.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run

from conftest import ROOT
from oracles import openarm

PAGE = (ROOT / "docs" / "tutorial-openarm.md").read_text()
URDF = ROOT / "examples" / "openarm" / "openarm.urdf"
SEEDS = range(int(os.environ.get("ZYGOS_TUTORIAL_SEEDS", "1")))
COMMANDS = [shlex.split(line) for line in re.findall(r"^    (.+)$", PAGE, re.MULTILINE)]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> openarm.Flight:
    folder = tmp_path_factory.mktemp("motion")
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(program, {})
    table = np.loadtxt(folder / "motion.csv", delimiter=",")
    return openarm.fly(URDF, table[:, 0], table[:, 1:])


def carried_out(flight: openarm.Flight, seed: int) -> Iterator[tuple[str, int]]:
    """Each command of the page in the present folder, and its exit code."""
    Path("openarm.urdf").write_bytes(URDF.read_bytes())
    for program, *arguments in COMMANDS:
        if program == "candump":
            openarm.candump(flight, Path(arguments[-1]), seed)
        elif program == "zygos":
            more = ["--json", "found.json"] if arguments[0] == "explain" else []
            yield arguments[0], run(*arguments, *more)


def friction(found: dict[str, Any]) -> dict[str, tuple[float, float, float]]:
    """Value, half of the 95 % interval and truth of each of the 14, at the joint."""
    out = {}
    for kind, truth in (("motor_coulomb", openarm.COULOMB_NM), ("motor_viscous", openarm.VISCOUS_NMS_RAD)):
        for j in range(7):
            named = [f for f in found["findings"] if (f["effect"], f["joint"]) == (kind, f"joint{j + 1}")]
            value, sigma = (named[0]["value"], named[0]["sigma"]) if named else (0.0, 0.0)
            out[f"{kind}{j + 1}"] = (openarm.GEAR[j] * value, 1.96 * openarm.GEAR[j] * sigma, truth[j])
    return out


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_tutorial(flight: openarm.Flight, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert dict(carried_out(flight, seed)) == {"convert": 0, "explain": 0}
    found = json.loads(Path("found.json").read_text())
    values = friction(found)
    inside = [name for name, (value, half95, truth) in values.items() if abs(value - truth) <= half95]
    (gap,) = found["simulator"]["runs"]
    shrinks = gap["as_delivered"]["energy"] / gap["corrected"]["energy"]
    outside = {name: value for name, value in values.items() if name not in inside}
    print(f"seed {seed}: {len(inside)} of 14 within their intervals, gap / {shrinks:.3g}, outside: {outside}")
    assert len(inside) >= 12
    assert shrinks >= 10.0
    assert Path("corrected.xml").is_file()
