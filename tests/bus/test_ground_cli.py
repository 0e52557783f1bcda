# SPDX-License-Identifier: MIT
"""`zygos estimate` and `zygos predict` for arms on the ground as a user types them: runs, a payload, refusals."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import run
from ground_support import heavier, recorded, short_arm

from zygos.arm import Arm, save_arm
from zygos.can.run import save_run
from zygos.model.model import Model, load_model, save_model

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of two joints as CAN logs, a third one in both forms, and the true model."""
    folder = tmp_path_factory.mktemp("ground")
    arm, model = short_arm(2)
    save_arm(arm, folder / "arm.toml")
    save_model(model, folder / "true.toml")
    save_run(recorded(arm, model, path=0, seed=0, offset=0.01, seconds=8.0), folder / "a.blf")
    save_run(recorded(arm, model, path=1, seed=1, offset=-0.02, seconds=8.0), folder / "b.log")
    third = recorded(arm, model, path=2, seed=2, seconds=8.0)
    save_run(third, folder / "c.npz")
    save_run(third, folder / "c.blf")
    return folder


@pytest.mark.slow
def test_several_runs_a_validation_and_a_prediction(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = run("estimate", folder / "a.blf", folder / "b.log", "--validate", folder / "c.npz", "-o", folder / "m.toml",
               "--json", folder / "m.json", "--details")  # fmt: skip
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


@pytest.mark.slow
def test_tables_and_logs_give_the_same_answer(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shares = []
    for name in ("c.npz", "c.blf"):
        assert run("predict", folder / name, "--model", folder / "true.toml", "--json", folder / "s.json") == 0
        shares.append(json.loads((folder / "s.json").read_text())["runs"][0]["share"])
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)


CONTRADICTIONS = [
    (lambda arm: replace(arm, gravity=(0.0, 0.0, 9.81)), "gravity is"),
    (lambda arm: replace(arm, period_s=2.0 * arm.period_s), "period_s is"),
    (lambda arm: replace(arm, joints=arm.joints[:-1]), "number of joints is 1, not 2"),
    (
        lambda arm: replace(arm, joints=(replace(arm.joints[0], gear_ratio=7.0), *arm.joints[1:])),
        r"joints\[0\].gear_ratio is 7.0, not",
    ),
    (
        lambda arm: replace(
            arm,
            joints=(
                *arm.joints[:-1],
                replace(arm.joints[-1], motor_encoder=replace(arm.joints[-1].motor_encoder, sign=-1)),
            ),
        ),
        r"joints\[1\].motor_encoder.sign is -1, not 1",
    ),
]


@pytest.mark.parametrize(("change", "said"), CONTRADICTIONS)
@pytest.mark.parametrize("command", ["estimate", "predict", "explain"])
def test_arm_files_that_contradict_each_other_are_refused(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    change: Callable[[Arm], Arm],
    said: str,
) -> None:
    save_arm(change(short_arm(2)[0]), tmp_path / "arm.toml")
    (tmp_path / "b.log").write_bytes((folder / "b.log").read_bytes())
    model, runs = folder / "true.toml", (folder / "a.blf", tmp_path / "b.log")
    words = {
        "estimate": (*runs, "-o", tmp_path / "m.toml"),
        "predict": (*runs, "--model", model),
        "explain": ("--simulation", model, *runs, "-o", tmp_path / "m.toml"),
    }[command]
    assert run(command, *words) == 2
    error = capsys.readouterr().err
    assert re.search(f"{re.escape(str(tmp_path / 'arm.toml'))} is of another arm than .*: {said}", error)
    assert "--arm" in error


@pytest.mark.slow
def test_each_run_has_the_noise_that_is_declared_beside_it(folder: Path, tmp_path: Path) -> None:
    """With --arm, one file is that of all runs."""
    arm, _ = short_arm(2)
    louder = replace(arm, name="other", joints=tuple(replace(j, torque_sigma=4.0 * j.torque_sigma) for j in arm.joints))
    save_arm(louder, tmp_path / "arm.toml")
    (tmp_path / "b.log").write_bytes((folder / "b.log").read_bytes())
    runs, scores = (folder / "a.blf", tmp_path / "b.log"), []
    for more in ((), ("--arm", folder / "arm.toml")):
        given = ("--model", folder / "true.toml", "--json", tmp_path / "scores.json", *more)
        assert run("predict", *runs, *given) == 0
        scores.append(json.loads((tmp_path / "scores.json").read_text())["runs"][1]["joints"][0])
    beside, declared = scores
    assert beside["floor_nm"] > 2.0 * declared["floor_nm"]  # quanta and filters are in it, too
    assert beside["sigmas"] == pytest.approx(beside["error_nm"] / beside["floor_nm"])
    assert beside["error_nm"] == pytest.approx(declared["error_nm"], rel=1e-9)


def test_a_payload_since_a_partial_model_says_what_it_rests_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the motion of the empty arm did not determine is assumed to be anything of its size."""
    arm, model = short_arm(3)
    save_run(recorded(arm, heavier(model, 2.0, (0.0, 0.05, 0.1)), path=1, seed=3, seconds=8.0), tmp_path / "loaded.blf")
    known = model.base_parameters(arm)
    lacking = "Ixy3" if "Ixy3" in known else list(known)[-1]
    partly = Model("partly", parameters={k: v for k, v in known.items() if k != lacking}, effects=model.effects)
    save_model(partly, tmp_path / "partly.toml")
    widths = []
    for sigma in (0.0, 0.1):
        save_arm(replace(arm, torque_scale_sigma=sigma), tmp_path / "arm.toml")
        given = (tmp_path / "loaded.blf", "--since", tmp_path / "partly.toml", "-o", tmp_path / "m.toml")
        assert run("estimate", *given, "--json", tmp_path / "p.json") == 0
        said, found = capsys.readouterr().out, json.loads((tmp_path / "p.json").read_text())
        mass = next(one for one in found["parameters"] if one["name"] == "m3")
        assert found["lacking"] == [lacking] and lacking in said and "torque_scale_sigma" in said
        assert abs(mass["value"] - 2.0) < 4.0 * mass["sigma"]
        assert set(load_model(tmp_path / "m.toml").parameters) == set(known) - {lacking}
        widths.append(mass["half95"])
    assert widths[1] == pytest.approx(np.hypot(widths[0], 1.96 * 0.1 * mass["value"]), rel=0.01)


@pytest.mark.slow
def test_a_recording_is_given_once(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("estimate", folder / "a.blf", "--validate", folder / "a.blf", "-o", tmp_path / "m.toml") == 2
    assert "are the same recording" in capsys.readouterr().err
    assert not (tmp_path / "m.toml").exists()


@pytest.mark.slow
def test_a_payload_and_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm, model = short_arm(3)
    save_arm(arm, tmp_path / "arm.toml")
    save_model(model, tmp_path / "true.toml")
    save_run(recorded(arm, model, path=0, seed=0, offset=0.01, seconds=8.0), tmp_path / "a.blf")
    payload = heavier(model, 2.0, (0.0, 0.05, 0.1))
    save_run(recorded(arm, payload, path=1, seed=3, seconds=8.0), tmp_path / "loaded.blf")
    out, file = tmp_path / "loaded.toml", tmp_path / "payload.json"
    assert run("estimate", tmp_path / "loaded.blf", "--since", tmp_path / "true.toml", "-o", out, "--json", file) == 0
    found = {one["name"]: one for one in json.loads(file.read_text())["parameters"]}
    assert abs(found["m3"]["value"] - 2.0) < 4.0 * found["m3"]["sigma"]
    assert out.exists()
    again = tmp_path / "none.toml"
    assert run("estimate", tmp_path / "a.blf", "--since", tmp_path / "true.toml", "-o", again) == 3
    assert "no payload" in capsys.readouterr().err
    assert not again.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--friction", "sticky"), "there is no 'sticky'"),
        (("--friction", "gain, gain"), "gain is named twice"),
        (("--since", "true.toml", "--doubtful"), "with --since"),
        (("--energy",), "nothing is refined"),
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
