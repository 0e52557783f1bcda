"""What a valid cycle costs does not depend on its data, in instructions of gcc -O2 on x86-64."""

from __future__ import annotations

import json
import platform
import shutil
from pathlib import Path

import numpy as np
import pytest

from bench.count import CONFIGURATIONS, main
from conftest import need


def test_a_cycle_costs_the_same_whatever_its_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At rest, at random and in motion, accepted by the bandwidth test or refused; call by call."""
    for tool in ("gcc", "valgrind"):
        need(shutil.which(tool), f"{tool}: the instructions of a cycle stay uncounted")
    need(platform.machine() == "x86_64", "an x86-64 machine: the instructions of a cycle stay uncounted")
    main(tmp_path / "count.json")
    with capsys.disabled():
        print(capsys.readouterr().out)
    found = json.loads((tmp_path / "count.json").read_text())["configurations"]
    assert set(found) == set(CONFIGURATIONS)
    for name, one in found.items():
        assert one["spread_by_data"] == 0, name
        assert one["turns_shared"] >= 10, f"{name}: hardly a call was compared"
        runs = one["data"]
        assert min(run["cycle"]["calls"] for run in runs.values()) >= 400
        assert runs["random"]["arc"]["calls"] > runs["rest"]["arc"]["calls"], "nothing was refused: no arc ended early"
        # a product and a sum for each entry of the normal equations, at the least
        entries = (one["parameters"] + 2) * (one["parameters"] + 3) / 2
        assert all(run["cycle"]["min"] >= 2 * entries for run in runs.values())
    assert found["paper"]["parameters"] == 12
    extra = {name: found[name]["data"]["rest"]["cycle"]["min"] - found["paper"]["data"]["rest"]["cycle"]["min"]
             for name in ("paper, friction", "paper, spring offsets")}  # fmt: skip
    assert all(np.array(list(extra.values())) > 0), extra
