"""The commands as a user types them, with an answer and with a refusal each."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from conftest import EXAMPLE
from zygos import bus
from zygos.arm import load_arm
from zygos.cli import main
from zygos.model import load_model


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", folder / "run.blf", "--seed", 3) == 0
    return folder


def test_simulate_leaves_a_run_and_its_arm_and_no_truth(simulated: Path) -> None:
    assert sorted(path.name for path in simulated.iterdir()) == ["arm.toml", "run.blf"]
    assert (simulated / "arm.toml").read_bytes() == (EXAMPLE / "arm.toml").read_bytes()


def test_estimate_where_no_truth_exists(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("run.blf", "arm.toml"):
        shutil.copy(simulated / name, tmp_path)
    out, numbers = tmp_path / "m.toml", tmp_path / "m.json"
    assert run("estimate", tmp_path / "run.blf", "-o", out, "--json", numbers) == 0
    assert "a11" in capsys.readouterr().out
    content = json.loads(numbers.read_text())
    assert content["validity"] == "valid"
    model = load_model(out)
    arm = load_arm(tmp_path / "arm.toml")
    values = [parameter["value"] for parameter in content["parameters"]]
    assert np.allclose(model.base_values(arm), values, rtol=1e-12)
    assert {quantity.source for quantity in model.parameters.values()} == {"zygos"}


def test_estimate_json_to_stdout_is_all_there_is(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("estimate", simulated / "run.blf", "-o", tmp_path / "m.toml", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["arm"] == "paper"


def test_the_estimate_can_be_simulated(simulated: Path, tmp_path: Path) -> None:
    assert run("estimate", simulated / "run.blf", "-o", tmp_path / "m.toml") == 0
    assert run("simulate", EXAMPLE / "scenario.toml", "--model", tmp_path / "m.toml", "-o", tmp_path / "again.log") == 0


def test_estimate_of_too_short_a_run_is_undecided(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = bus.read_log(simulated / "run.blf")
    short = tmp_path / "short.blf"
    bus.write_log(short, frames[:150], 0.05)
    code = run(
        "estimate", short, "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json"
    )
    assert code == 3
    assert not (tmp_path / "m.toml").exists()
    assert "too few" in capsys.readouterr().err
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["validity"] == "refused"
    assert content["parameters"][0]["value"] is None


def test_check(simulated: Path, tmp_path: Path) -> None:
    assert run("check", simulated / "run.blf", "--json", tmp_path / "check.json") == 0
    rooms = {room["room"]: room for room in json.loads((tmp_path / "check.json").read_text())["rooms"]}
    assert all(room["equal"] for room in rooms.values())
    assert rooms["balance"]["compared"] > 10_000


def test_check_says_when_c_and_numpy_differ(simulated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from zygos import reference

    chain = reference.chain

    def bent(arm: object, cycles: object) -> reference.Chain:
        from dataclasses import replace

        straight = chain(arm, cycles)  # type: ignore[arg-type]
        return replace(straight, smoothed=replace(straight.smoothed, qd=straight.smoothed.qd * (1 + 1e-9)))

    monkeypatch.setattr(reference, "chain", bent)
    assert run("check", simulated / "run.blf") == 3


def test_listen(simulated: Path, tmp_path: Path) -> None:
    arm = load_arm(EXAMPLE / "arm.toml")
    messages = bus.to_messages(bus.read_log(simulated / "run.blf"), arm.period_s)

    def play() -> None:
        time.sleep(1.0)
        with bus.open_bus("virtual", "test_listen") as out:
            for message in messages:
                out.send(message)

    player = threading.Thread(target=play)
    player.start()
    code = run(
        "listen",
        "--arm",
        EXAMPLE / "arm.toml",
        "-i",
        "virtual",
        "-c",
        "test_listen",
        "--idle",
        1,
        "-o",
        tmp_path / "live.toml",
        "--log",
        tmp_path / "live.blf",
    )
    player.join()
    assert code == 0
    assert run("estimate", simulated / "run.blf", "-o", tmp_path / "replayed.toml") == 0
    assert (tmp_path / "live.toml").read_bytes() == (tmp_path / "replayed.toml").read_bytes()
    assert bus.read_log(tmp_path / "live.blf").tobytes() == bus.read_log(simulated / "run.blf").tobytes()


def test_paper(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("paper", "--seeds", 2, "--example", EXAMPLE, "--json", tmp_path / "paper.json") == 0
    said = capsys.readouterr().out
    assert "Table III" in said
    assert "Table IV" in said
    assert "23774.1975" in said
    methods = {entry["method"]: entry for entry in json.loads((tmp_path / "paper.json").read_text())["methods"]}
    assert methods["EB, exact data"]["max_rms_percent"] < 1e-6


@pytest.mark.parametrize(
    "arguments",
    [
        ("estimate", "none.blf", "-o", "m.toml"),
        ("estimate", "run.csv", "--arm", EXAMPLE / "arm.toml", "-o", "m.toml"),
        ("check", "none.blf", "--arm", EXAMPLE / "arm.toml"),
        ("simulate", "none.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", "run.csv"),
        ("simulate", EXAMPLE / "arm.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "--model", EXAMPLE / "arm.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", "run.blf", "--seed", "-1"),
        ("listen", "--arm", EXAMPLE / "arm.toml", "-i", "no_such_interface", "-c", "x", "-o", "m.toml"),
        ("listen", "--arm", "none.toml", "-i", "virtual", "-o", "m.toml"),
        ("paper", "--example", "nowhere"),
        ("paper", "--seeds", "many"),
        ("no_such_command",),
        ("estimate", "--no-such-option"),
    ],
)
def test_bad_input(
    arguments: Sequence[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    said = capsys.readouterr().err
    assert said.strip()
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_another_arm_beside_the_run_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.toml").write_text("name = 'mine'\n")
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", tmp_path / "run.blf") == 2
    assert "another arm" in capsys.readouterr().err
    assert (tmp_path / "arm.toml").read_text() == "name = 'mine'\n"
    assert not (tmp_path / "run.blf").exists()


@pytest.mark.parametrize("command", ["simulate", "estimate", "check", "listen", "paper"])
def test_help_teaches(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "--help") == 0
    assert f"zygos {command}" in capsys.readouterr().out
