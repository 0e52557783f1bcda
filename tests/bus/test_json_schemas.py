# SPDX-License-Identifier: MIT
"""Each JSON output matches its schema in docs/reference/schemas, which describes every key.

`schema_support` also holds all JSON that commands write in other tests against these schemas.
"""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bus_support import playing
from cli_support import run
from jsonschema import Draft202012Validator
from schema_support import OF_COMMAND, SCHEMAS, hold

from conftest import EXAMPLE, ROOT
from zygos import testing
from zygos.cli import COMMANDS, FORMER, load
from zygos.effects import CATALOGUE, Effect
from zygos.model.model import load_model, save_model

ARM, MODEL, SCENARIO = (EXAMPLE / f"{name}.toml" for name in ("arm", "model", "scenario"))
TELEMETRY, URDF = ROOT / "examples" / "telemetry", ROOT / "examples" / "urdf"


@pytest.fixture(scope="module")
def folder(brief_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the example, its estimate, an arm imported from a URDF, and the example with a motion of 10 s."""
    folder = tmp_path_factory.mktemp("outputs")
    shutil.copytree(brief_recording.parent, folder, dirs_exist_ok=True)
    shutil.copytree(EXAMPLE, folder / "brief")
    scenario = SCENARIO.read_text().replace("duration_s = 60.0", "duration_s = 10.0")
    (folder / "brief" / SCENARIO.name).write_text(scenario)
    assert run("estimate", "--energy", folder / "run.blf", "-o", folder / "m.toml", "--json", folder / "m.json") == 0
    assert run("import", URDF / "arm.urdf", "--answers", URDF / "answers.toml", "-o", folder / "urdf") == 0
    return folder


CASES: dict[str, tuple[object, ...]] = {
    "simulate": ("simulate", "{in}/brief/scenario.toml", "-o", "{out}/run.blf"),
    "estimate": ("estimate", "{in}/run.blf", "-o", "{out}/m.toml"),
    "predict": ("predict", "{in}/run.blf", "--model", MODEL),
    "self-test": ("self-test", "{in}/run.blf"),
    "check-arm": ("check-arm", "{in}/run.blf", "--arm", ARM),
    "convert": (
        *("convert", TELEMETRY / "run.blf", "--dbc", TELEMETRY / "arm.dbc", "--map", TELEMETRY / "map.toml"),
        *("--arm", TELEMETRY / "arm.toml", "-o", "{out}/run.blf"),
    ),
    "view": ("view", "{in}/run.blf", "--png", "{out}/a.png", "--at", "1"),
    "import": ("import", URDF / "arm.urdf", "--answers", URDF / "answers.toml", "-o", "{out}/arm"),
    "import, questions": ("import", URDF / "arm.urdf", "--template", "{out}/answers.toml"),
    "export": (
        *("export", "--arm", "{in}/urdf/arm.toml", "--model", "{in}/urdf/model.toml"),
        *("--urdf", URDF / "arm.urdf", "-o", "{out}/new.urdf"),
    ),
    "fit": ("fit", "{in}/m.json", "--arm", ARM, "--model", MODEL, "-o", "{out}/fit.toml"),
    "dbc": ("dbc", "--arm", ARM, "-o", "{out}/arm.dbc"),
    "parameters": ("parameters", ARM),
    "plan": ("plan", ARM, "--model", MODEL, "--candidates", "{in}/brief/scenario.toml"),
    "plan, bound": ("plan", "{in}/brief/scenario.toml", "--by", "bound"),
    "refine": ("refine", "{in}/run.blf", "-o", "{out}/m.toml"),
    "bound": ("bound", "{in}/brief/scenario.toml", "--torque-noise", 0, "--torque-noise", 0.005),
    "compile-model": ("compile-model", ARM, "-o", "{out}"),
    "bus-load": ("bus-load", "--arm", ARM),
    "bus-load, log": ("bus-load", "{in}/run.blf", "--arm", ARM),
}


@pytest.mark.slow(
    but=["bound", "bus*", "self-test", "compile*", "dbc", "estimate", "export", "fit", "import, questions", "import"]
)
@pytest.mark.parametrize("case", CASES)
def test_the_output_of_a_command(case: str, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "output.json"
    arguments = [str(word).replace("{in}", str(folder)).replace("{out}", str(tmp_path)) for word in CASES[case]]
    assert run(*arguments, "--json", out) == 0
    hold(OF_COMMAND[arguments[0]], json.loads(out.read_text()))


@pytest.mark.slow
def test_the_output_of_explain(tmp_path: Path) -> None:
    friction = Effect(CATALOGUE["motor_coulomb"], "elbow", 2.0)
    save_model(replace(load_model(MODEL), effects=(friction,)), tmp_path / "rubbing.toml")
    runs = [tmp_path / f"{seed}.blf" for seed in range(3)]
    for seed, path in enumerate(runs):
        assert run("simulate", SCENARIO, "-o", path, "--model", tmp_path / "rubbing.toml", "--seed", seed) == 0
    files = (*runs[:2], "--simulation", MODEL, "--validate", runs[2], "-o", tmp_path / "new.toml")
    assert run("explain", *files, "--json", tmp_path / "verdict.json") == 0
    hold("explain", json.loads((tmp_path / "verdict.json").read_text()))


@pytest.mark.slow
def test_the_output_of_listen(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "live.json"
    where = ("-i", "virtual", "-c", "test_schemas", "--idle", 1)
    with playing("test_schemas", folder / "run.blf"):
        assert run("listen", "--arm", ARM, *where, "-o", tmp_path / "live.toml", "--json", out) == 0
    hold("estimate", json.loads(out.read_text()))


def test_the_output_of_drills(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = {"frames": 3, "expected": {"dropped": 1}, "found": {"dropped": 1}}
    passed = SimpleNamespace(user_properties=[(testing._DRILL, record)], when="call", nodeid="a::test_b")
    skipped = SimpleNamespace(
        user_properties=[(testing._DRILL, {"frames": 0, "expected": None, "found": None})],
        nodeid="a::test_c",
        longrepr=("a", 1, "Skipped: not evaluated: no controller"),
    )
    reporter = SimpleNamespace(getreports=lambda outcome: {"passed": [passed], "skipped": [skipped]}.get(outcome, []))
    options = {"--zygos-json": tmp_path / "hil.json", "--zygos-channel": "vcan0"}
    testing.pytest_terminal_summary(reporter, SimpleNamespace(getoption=options.get))  # type: ignore[arg-type]
    content = json.loads((tmp_path / "hil.json").read_text())
    assert len(content["drills"]) == 2
    hold("hil", content)


def test_every_command_that_writes_json_has_a_schema() -> None:
    """That of `zygos paper` is held by `schema_support` where test_cli.py runs it."""
    writing = {name for name in COMMANDS | FORMER if any("--json" in option.opts for option in load(name).params)} - {
        "check"
    }
    assert set(OF_COMMAND) == writing
    assert {case.partition(",")[0] for case in CASES} | {"explain", "listen", "paper"} == writing


def properties(schema: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Each property of a schema, however deep."""
    for key, inner in schema.get("properties", {}).items():
        yield f"{path}.{key}", inner
        yield from properties(inner, f"{path}.{key}")
    for key in ("items", "additionalProperties"):
        if isinstance(schema.get(key), dict):
            yield from properties(schema[key], path)


def types(schema: Any) -> set[str]:
    named = schema.get("type", [])
    return {named} if isinstance(named, str) else set(named)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_describes_every_key(name: str) -> None:
    """With the unit of every number, and no key but those that it lists."""
    schema = SCHEMAS[name]
    Draft202012Validator.check_schema(schema)
    for path, described in properties(schema):
        assert described["description"].endswith("."), path
    pending = [(name, schema)]
    while pending:
        path, part = pending.pop()
        if types(part) & {"number", "integer"}:
            assert part["unit"], path
        if "object" in types(part):
            assert "additionalProperties" in part, path
        inner = {key: part[key] for key in ("items", "additionalProperties") if isinstance(part.get(key), dict)}
        pending += [(f"{path}.{key}", value) for key, value in {**part.get("properties", {}), **inner}.items()]


@pytest.mark.parametrize("key", ["arm", "parameters"])
def test_a_key_too_many_or_too_few_is_noticed(key: str, folder: Path) -> None:
    content = json.loads((folder / "m.json").read_text())
    hold("estimate", content)
    shorter = {name: value for name, value in content.items() if name != key}
    with pytest.raises(AssertionError, match=f"'{key}' is a required property"):
        hold("estimate", shorter)
    longer = copy.deepcopy(content)
    longer["parameters"][0]["extra"] = 1.0
    with pytest.raises(AssertionError, match="'extra' was unexpected"):
        hold("estimate", longer)
