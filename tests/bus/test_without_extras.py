# SPDX-License-Identifier: MIT
"""The installation without extras: what it does, and what it says of the rest."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from blocking_support import EXTRAS, IMPORTS, absent

from conftest import ROOT

LIVELY, TELEMETRY = ROOT / "examples" / "lively", ROOT / "examples" / "telemetry"
BLOCKED = [module for extra, modules in IMPORTS.items() if extra != "testing" for module in modules]


@pytest.fixture(scope="module", autouse=True)
def base_install() -> Iterator[None]:
    with absent(*BLOCKED, "msgpack"):
        yield


def run(*arguments: object) -> int:
    """A command as a user types it, of the modules that were imported without extras."""
    with pytest.raises(SystemExit) as end:
        import_module("zygos.cli").main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


@pytest.mark.slow
def test_every_command_has_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    for command in import_module("zygos.cli").COMMANDS:
        assert run(command, "--help") == 0
        assert "Usage:" in capsys.readouterr().out


def test_a_csv_becomes_a_csv_and_an_estimate(tmp_path: Path) -> None:
    """From frames to a table, and from that table, as telemetry of somebody, to a table with the same cycles."""
    options = ("--dbc", TELEMETRY / "arm.dbc", "--arm", ROOT / "examples" / "paper" / "arm.toml")
    first, second = tmp_path / "first" / "run.csv", tmp_path / "second" / "run.csv"
    assert run("convert", TELEMETRY / "run.blf", *options, "--map", TELEMETRY / "map.toml", "-o", first) == 0
    joints = "".join(
        f'[[joint]]\nname = "{name}"\nlink = {{ column = "q{k}", unit = "rad" }}\n'
        f'motor = {{ column = "theta{k}", unit = "rad", side = "output" }}\n'
        f'torque = {{ column = "tau{k}", unit = "Nm" }}\n'
        for k, name in ((1, "shoulder"), (2, "elbow"))
    )
    gyro = "".join(f'{axis} = {{ column = "w{axis}", unit = "rad/s" }}\n' for axis in "xyz")
    (tmp_path / "map.toml").write_text(f'[time]\nsource = "sync"\ncolumn = "sync"\n{joints}[gyro]\n{gyro}')
    assert run("convert", first, "--map", tmp_path / "map.toml", *options[2:], "-o", second) == 0
    assert second.read_text() == first.read_text()
    assert run("estimate", "--energy", second, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    assert json.loads((tmp_path / "m.json").read_text())["validity"] == "valid"


def remedies(folder: Path) -> list[tuple[tuple[object, ...], str]]:
    """Commands that need an extra, and what they need."""
    (folder / "x.parquet").touch()
    (folder / "x.mcap").touch()
    (folder / "x.mf4").touch()
    (folder / "arm.toml").write_bytes((LIVELY / "arm.toml").read_bytes())
    bus = ("--arm", LIVELY / "arm.toml", "-o", folder / "m.toml", "-c", "239.74.163.2")
    signals = (TELEMETRY / "map.toml").read_text().split("[[joint]]", 1)[1].replace("signal =", "topic =")
    (folder / "topics.toml").write_text(f'[time]\nsource = "header"\ninterpolation = "linear"\n[[joint]]{signals}')
    mapped = ("--map", folder / "topics.toml", "--arm", LIVELY / "arm.toml", "-o", folder / "r.npz")
    return [
        (("estimate", folder / "x.parquet", "-o", folder / "m.toml"), "zygos[tables]"),
        (("estimate", folder / "x.mf4", "-o", folder / "m.toml"), "zygos[mf4]"),
        (("view", TELEMETRY / "run.blf", "--arm", LIVELY / "arm.toml"), "zygos[view]"),
        (("import", ROOT / "examples" / "urdf" / "arm.urdf", "-o", folder / "arm"), "zygos[urdf]"),
        (("listen", *bus, "-i", "udp_multicast"), "msgpack"),
        (("convert", folder / "x.mcap", *mapped), "zygos[ros]"),
    ]


def test_the_remedy_is_a_command_of_this_environment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """pip takes it: what is asked for exists. Nothing is downloaded, since zygos itself is there."""
    for arguments, package in remedies(tmp_path):
        assert run(*arguments) in (0, 2)
        said = capsys.readouterr().err
        found: Any = re.search(r"remedy: (.* -m pip install \S+?),? ?(or |\n|$)", said)
        assert found, said
        command = shlex.split(found[1])
        assert command == [sys.executable, "-m", "pip", "install", package]
        assert package == "msgpack" or package[6:-1] in EXTRAS
    every = f"zygos[{','.join(IMPORTS)}]"
    options = ["--no-deps", "--no-index", "--dry-run", "--disable-pip-version-check"]
    ended = subprocess.run([*command[:-1], every, *options], capture_output=True, text=True, check=False)
    assert ended.returncode == 0 and "does not provide the extra" not in ended.stderr


def test_the_extras_that_messages_name_exist() -> None:
    named = {
        extra
        for file in (ROOT / "harness").rglob("*.py")
        for extra in re.findall(r"(?<!_)installs\(.(\w+).\)", file.read_text())
    }
    assert named == set(IMPORTS) - {"serial"}
    assert set(IMPORTS) <= set(EXTRAS)


def test_an_environment_without_pip_names_it_to_another_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = import_module("zygos.errors")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert errors.installs("view") == f"pip --python {sys.executable} install 'zygos[view]'"
