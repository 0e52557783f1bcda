"""`zygos estimate` and `zygos predict` for arms on the ground as a user types them: runs, a payload, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ground_support import heavier, recorded, short_arm

from zygos.arm import save_arm
from zygos.can.run import save_run
from zygos.cli import main
from zygos.model.model import load_model, save_model

ROOT = Path(__file__).parents[2]


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs as CAN logs, a third as a table, one with a payload, and the true model."""
    folder = tmp_path_factory.mktemp("ground")
    arm, model = short_arm()
    save_arm(arm, folder / "arm.toml")
    save_model(model, folder / "true.toml")
    save_run(recorded(arm, model, path=0, seed=0, offset=0.01), folder / "a.blf")
    save_run(recorded(arm, model, path=1, seed=1, offset=-0.02), folder / "b.log")
    third = recorded(arm, model, path=2, seed=2)
    save_run(third, folder / "c.npz")
    save_run(third, folder / "c.blf")
    save_run(recorded(arm, heavier(model, 2.0, (0.0, 0.05, 0.1)), path=1, seed=3), folder / "loaded.blf")
    return folder


def test_several_runs_a_validation_and_a_prediction(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = run("estimate", folder / "a.blf", folder / "b.log", "--validate", folder / "c.npz", "-o", folder / "m.toml",
               "--json", folder / "m.json")  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "2 runs" in said.out and "from" in said.out
    answer = json.loads((folder / "m.json").read_text())
    assert answer["estimator"] == "ground" and answer["validity"] == "valid"
    assert len(answer["validated"]) == 1 and answer["validated"][0]["share"] < 0.02
    assert all(one["held_out_share"] < 0.05 for one in answer["joints"])
    assert load_model(folder / "m.toml").parameters
    assert run("predict", folder / "c.npz", "--model", folder / "m.toml", "--json", folder / "p.json") == 0
    assert json.loads((folder / "p.json").read_text())["runs"][0]["share"] == answer["validated"][0]["share"]


def test_tables_and_logs_give_the_same_answer(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shares = []
    for name in ("c.npz", "c.blf"):
        assert run("predict", folder / name, "--model", folder / "true.toml", "--json", folder / "s.json") == 0
        shares.append(json.loads((folder / "s.json").read_text())["runs"][0]["share"])
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)


def test_a_payload_and_none(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, file = folder / "loaded.toml", folder / "payload.json"
    assert run("estimate", folder / "loaded.blf", "--since", folder / "true.toml", "-o", out, "--json", file) == 0
    found = {one["name"]: one for one in json.loads(file.read_text())["parameters"]}
    assert abs(found["m3"]["value"] - 2.0) < 4.0 * found["m3"]["sigma"]
    assert out.exists()
    again = folder / "none.toml"
    assert run("estimate", folder / "a.blf", "--since", folder / "true.toml", "-o", again) == 3
    assert "no payload" in capsys.readouterr().err
    assert not again.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--friction", "sticky"), "there is no 'sticky'"),
        (("--since", "true.toml", "--doubtful"), "with --since"),
        (("--flight", "--doubtful"), "only an estimate on the ground"),
        (("--validate", "nowhere.blf"), "nowhere.blf"),
    ],
)
def test_refusals_of_estimate(
    folder: Path, arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [folder / one if one.endswith((".toml", ".blf")) else one for one in arguments]
    out = folder / "refused.toml"
    assert run("estimate", folder / "a.blf", *given, "-o", out) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_refusals_of_predict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("predict", folder / "a.blf", "--model", folder / "true.toml", "--cutoff", "1e6") == 2
    assert "cut-off" in capsys.readouterr().err
    (folder / "half.toml").write_text('name = "half"\n[parameters]\nIzz1 = 1.0\n')
    assert run("predict", folder / "a.blf", "--model", folder / "half.toml") == 2
    assert "--doubtful" in capsys.readouterr().err
