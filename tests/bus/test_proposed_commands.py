# SPDX-License-Identifier: MIT
"""What the messages of commands propose, read from what they print and carried out."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import telemetry_support as foreign
from arm_support import random_arm
from cli_support import run

from conftest import EXAMPLE
from zygos.arm import load_arm, save_arm
from zygos.can.run import load_run
from zygos.model.model import save_model
from zygos.runs.tables import write_cycles

pytest_plugins = ["recorded_support"]

Command = tuple[object, ...]
FILE = re.compile(r"\b(RUN\.\.\.|RUN|ARM\.toml|MODEL\.toml|NEW|MAP\.toml)(?= |$)")


@dataclass(frozen=True)
class Proposal:
    """A command and what of its message is carried out."""

    command: Command
    code: int
    """The exit code with which it proposes something."""
    said: str
    """Pattern of the proposal: its first group is a command behind `zygos`, or an option that is added."""
    then: tuple[int, ...] = (0,)
    """Exit codes of what is proposed."""


PROPOSALS = {
    "convert": Proposal(
        (*("convert", foreign.EXAMPLE / "run.blf", "--dbc", foreign.EXAMPLE / "arm.dbc"),
         *("--map", foreign.EXAMPLE / "map.toml", "--arm", foreign.EXAMPLE / "arm.toml", "-o", "{out}/run.npz")),
        0, r"next: zygos (.+?) ·", (0, 3)),
    "convert, no arm file": Proposal(
        (*("convert", foreign.EXAMPLE / "run.blf", "--dbc", foreign.EXAMPLE / "arm.dbc"),
         *("--map", "{in}/alone/map.toml", "-o", "{out}/run.npz")), 2, r"remedy: give it with (--arm)"),
    "check-arm": Proposal(("check-arm", "{in}/spikes.npz"), 3, r"remedy: zygos (convert [^,]+),"),
    "check-arm, swapped": Proposal(("check-arm", "{in}/arm.toml"), 2, r"`zygos ([^`]+)`", (0, 3)),
    "estimate, swapped": Proposal(("estimate", "{in}/arm.toml", "-o", "{out}/m.toml"), 2, r"`zygos ([^`]+)`"),
    "explain": Proposal(
        (*("explain", "{run}", "--simulation", "{run}", "--arm", "{in}/arm.toml"),
         *("-o", "{out}/m.toml", "--next-motion", "{out}/next.toml")), 2, r"`zygos (estimate [^`]+)`"),
    "plan": Proposal(("plan", "--arm", "{in}/planar.toml", "--model", "{in}/bodies.toml", "-o", "{out}/s.toml",
                      "--rate", "1.5", "--period", "4", "--harmonics", "3"), 2, r"give (--torque-noise)"),
    "predict": Proposal(("predict", "{in}/model.toml", "{run}"), 2, r"`zygos ([^`]+)`"),
    "refine, gyro": Proposal(("refine", "{run}", "--arm", "{in}/late.toml", "-o", "{out}/m.toml"), 2,
                             r"remedy: `zygos (estimate)`", (0, 3)),
    "listen": Proposal(("listen", "--arm", "{in}/arm.toml", "-i", "virtual", "-c", "proposed", "--duration", 0.2,
                        "-o", "{out}/m"), 2, r"suffix (\.toml)", (3,)),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(brief_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("proposed")
    arm = load_arm(EXAMPLE / "arm.toml")
    save_arm(arm, folder / "arm.toml")
    (folder / "model.toml").write_bytes((EXAMPLE / "model.toml").read_bytes())
    (folder / "alone").mkdir()
    (folder / "alone" / "map.toml").write_bytes((foreign.EXAMPLE / "map.toml").read_bytes())
    save_arm(replace(arm, imu=replace(arm.imu, latch_us=200)), folder / "late.toml")
    found = load_run(brief_recording, arm).cycles
    q = found.q.copy()
    q[[100, 200, 300], 1] += 0.8
    write_cycles(folder / "spikes.npz", replace(found, q=q))
    planar, bodies = random_arm(3, 2, "fixed", "planar", False)
    planar = replace(planar, period_s=0.01, joints=tuple(replace(one, torque_sigma=0.0) for one in planar.joints))
    save_arm(planar, folder / "planar.toml")
    save_model(bodies, folder / "bodies.toml")
    return folder


@pytest.fixture
def filled(folder: Path, brief_recording: Path, tmp_path: Path) -> Callable[[object], str]:
    def fill(word: object) -> str:
        names = {"{in}": folder, "{out}": tmp_path, "{run}": brief_recording}
        text = str(word)
        for name, path in names.items():
            text = text.replace(name, str(path))
        return text

    return fill


def carried_out(name: str, proposed: str, command: list[str], filled: Callable[[object], str]) -> list[str]:
    """The arguments of what is proposed, with the files for which its capitals stand."""
    if proposed == "--arm":
        return [*command, proposed, str(foreign.EXAMPLE / "arm.toml")]
    if proposed == "--torque-noise":
        return [*command, proposed, "0.05"]
    if proposed == ".toml":
        return [*command[:-1], command[-1] + proposed]
    if proposed == "estimate":
        return [proposed, *command[1:]]
    new = ".npz" if proposed.startswith("convert") else ".toml"
    run_file = "{in}/spikes.npz" if name == "check-arm" else "{run}"
    model = "{out}/new.toml" if proposed.startswith("estimate") else "{in}/model.toml"
    files = {"RUN...": run_file, "RUN": run_file, "ARM.toml": "{in}/arm.toml", "MODEL.toml": model}
    files["NEW"] = "{out}/new/run" + new
    return shlex.split(filled(FILE.sub(lambda found: files[found[0]], proposed)))


@pytest.mark.slow(but=["convert, no arm file", "predict", "listen", "refine, gyro"])
@pytest.mark.parametrize("name", PROPOSALS)
def test_what_a_message_proposes_is_carried_out(
    name: str, filled: Callable[[object], str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = PROPOSALS[name]
    command = [filled(word) for word in case.command]
    assert run(*command) == case.code
    told = capsys.readouterr()
    said = re.sub(r"\s+", " ", told.out + told.err)
    found = re.search(case.said, said)
    assert found, said
    (tmp_path / "new").mkdir()
    assert run(*carried_out(name, found[1], command, filled)) in case.then, capsys.readouterr().err
