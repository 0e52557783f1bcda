# SPDX-License-Identifier: MIT
"""What all commands have in common: help, version, completion, narrow terminals, standard input and output."""

from __future__ import annotations

import inspect
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer
from cli_support import run

from conftest import EXAMPLE, ROOT
from zygos.arm import load_arm
from zygos.can import bus
from zygos.cli import COMMANDS, FORMER, app, load
from zygos.files.tables import TABLE_SUFFIXES
from zygos.native.flight import Flight
from zygos.runs.tables import write_cycles


def words(text: str) -> str:
    """Letters and brackets alone: no frames, no line breaks, no marks of Markdown."""
    return re.sub(r"[^\w\[\]]+", " ", text)


def test_the_list_begins_with_the_five_that_everybody_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(COMMANDS)[:5] == ["estimate", "explain", "check-arm", "simulate", "view"]
    assert run("-h") == 0
    said = capsys.readouterr().out
    assert [said.index(f"│ {command} ") for command in COMMANDS] == sorted(said.index(f"│ {c} ") for c in COMMANDS)
    assert run("estimate", "-h") == 0


def test_former_names_go_on_and_say_what_has_their_place(
    brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of commands, and of arguments that stood elsewhere; none of them is in the list of commands."""
    for arguments, code, said in (
        (("check", "none.blf"), 2, "check goes in the next version: it is called `zygos self-test`"),
        (("refine", "none.blf", "--arm", EXAMPLE / "arm.toml"), 2, "`zygos estimate` refines by itself"),
        (("bound", "none.toml"), 2, "`zygos plan SCENARIO.toml --by bound`"),
        (("check-arm", EXAMPLE / "arm.toml", "none.blf"), 2, "`zygos check-arm RUN --arm ARM.toml`"),
        (
            ("plan", EXAMPLE / "arm.toml", "--model", "none.toml", "b.toml"),
            2,
            "`zygos plan SCENARIO... --arm ARM.toml`",
        ),
        (("explain", "--simulation", "m.toml", "--measured", "none.blf"), 2, "`zygos explain RUN...`"),
        (("bus-load", "--arm", EXAMPLE / "arm.toml", "--run", "none.blf"), 2, "`zygos bus-load RUN --arm ARM.toml`"),
    ):
        assert run(*arguments) == code
        error = capsys.readouterr().err
        assert said in error and "remedy" in error, error
    assert run("--help") == 0
    listed = capsys.readouterr().out
    assert not any(f"│ {name} " in listed for name in FORMER)


def test_the_list_of_commands_loads_nothing_that_is_slow() -> None:
    """No command, and none of the packages that they compute with; it is shown in 0.2 to 0.4 s."""
    slow = ("numpy", "scipy", "can", "cffi", "jinja2", "tomlkit", "matplotlib", "zygos.arm")
    script = "import sys\nfrom zygos.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    script += f"sys.exit(', '.join(one for one in {slow} if one in sys.modules) or 0)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_answer_needs_no_model_file(
    brief_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("estimate", brief_recording, "--energy") == 0
    assert "no model written" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert run("estimate", brief_recording, "-o") == 2
    assert "requires an argument" in capsys.readouterr().err


def test_a_wrong_name_is_told_what_was_meant(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("estimat") == 2
    assert "No such command 'estimat'. Did you mean 'estimate'?" in capsys.readouterr().err
    assert run("nonsense") == 2
    assert "Did you mean" not in capsys.readouterr().err
    assert run("estimate", "a.blf", "--reprot", "a.html") == 2
    assert "--report" in capsys.readouterr().err


@pytest.mark.slow(only=["simulate-60", "simulate*"])
@pytest.mark.parametrize("width", [60, 80])
@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_is_whole(
    command: str | None, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every word that a command says of itself is there, [[effect]] and [view] included, and no name is cut."""
    monkeypatch.setenv("COLUMNS", str(width))
    assert run(*([command] if command else []), "--help") == 0
    said = capsys.readouterr().out
    assert "…" not in said
    described: Any = load(command) if command else typer.main.get_command(app)
    assert words(inspect.cleandoc(described.callback.__doc__ or described.help)) in words(said)
    for option in (one for one in described.params if not getattr(one, "hidden", False)):
        for name in (*option.opts, *option.secondary_opts):
            assert not name.startswith("-") or re.search(rf"(?<![\w-]){name}(?![\w-])", said), name


@pytest.mark.parametrize("command", COMMANDS)
def test_the_list_of_commands_has_the_first_line_of_each(command: str) -> None:
    assert COMMANDS[command][1] == str(load(command).help).splitlines()[0]


def test_brackets_of_toml_are_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    for command, said in (("estimate", "[[effect]] entries"), ("view", "'zygos[view]'"), ("fit", "'zygos[fit]'")):
        assert run(command, "--help") == 0
        assert said in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [("[red]nothing[/]",), ("estimate", "--[bold]"), ("self-test", "run[/].db")])
def test_brackets_are_in_the_refusal(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) == 2
    assert arguments[-1] in capsys.readouterr().err


def test_completion_can_be_installed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--help") == 0
    assert "--install-completion" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"zygos {version('zygos')}\n"


@pytest.mark.slow
def test_bash_completes() -> None:
    """As the function does that bash calls when Tab is pressed, from the script that is installed."""
    cases = {
        "zygos esti": "estimate",
        "zygos check": "check-arm",
        "zygos estimate --mo": "--model",
        "zygos x": "",
    }
    folder = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    asked = {**environment, "_ZYGOS_COMPLETE": "source_bash"}
    script = subprocess.run([folder / "zygos"], env=asked, capture_output=True, text=True, check=True).stdout
    for line in cases:
        script += f"COMP_WORDS=({line}); COMP_CWORD={len(line.split()) - 1}; _zygos_completion zygos\n"
        script += 'echo "${COMPREPLY[@]}"\n'
    done = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert [sorted(line.split()) for line in done.stdout.splitlines()] == [words.split() for words in cases.values()]


@pytest.fixture
def brief_scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario of a copy of the example that lasts 20 s."""
    scenario = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("example") / "example") / "scenario.toml"
    text = scenario.read_text()
    assert "duration_s = 60.0" in text
    scenario.write_text(text.replace("duration_s = 60.0", "duration_s = 20.0"))
    return scenario


@pytest.fixture
def stdin(monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes], None]:
    """What comes on standard input."""

    def put(content: bytes) -> None:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))

    return put


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".blf", ".log", ".asc", ".trc", ".mf4", ".npz", ".csv", ".parquet"])
def test_a_run_comes_on_standard_input(
    kind: str, brief_recording: Path, tmp_path: Path, stdin: Callable[[bytes], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its kind, which is seen from how it begins; the arm file is then that of the current folder."""
    file, arm = tmp_path / f"run{kind}", load_arm(brief_recording.with_name("arm.toml"))
    frames = bus.read_log(brief_recording).frames
    if kind in TABLE_SUFFIXES:
        trace = Flight(arm).frames(frames, trace=True)
        assert trace is not None
        write_cycles(file, trace.cycles)
    else:
        bus.write_log(file, frames, arm.period_s)
    monkeypatch.chdir(brief_recording.parent)
    run(
        "estimate",
        "--energy",
        file,
        "--arm",
        "arm.toml",
        "-o",
        tmp_path / "named.toml",
        "--json",
        tmp_path / "named.json",
    )
    stdin(file.read_bytes())
    run("estimate", "--energy", "-", "-o", tmp_path / "piped.toml", "--json", tmp_path / "piped.json")
    assert (tmp_path / "piped.toml").read_bytes() == (tmp_path / "named.toml").read_bytes()
    named, piped = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("named", "piped"))
    assert piped == {**named, "run": "-"}


@pytest.mark.parametrize("content", [b"", b"MZ\x90\0", b"name = 'paper'\n", b"hello\n"])
def test_standard_input_that_is_no_run(
    content: bytes, stdin: Callable[[bytes], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stdin(content)
    assert run("estimate", "-", "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml") == 2
    assert "-: standard input does not begin like a CAN log; remedy" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_every_kind_of_file_comes_on_standard_input(
    brief_scenario: Path,
    tmp_path: Path,
    stdin: Callable[[bytes], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Arm, model, scenario, DBC, map, answers, URDF, with the result that the file by its name gives."""
    monkeypatch.chdir(brief_scenario.parent)
    telemetry, urdf = ROOT / "examples" / "telemetry", ROOT / "examples" / "urdf"
    model, out = EXAMPLE / "model.toml", tmp_path / "out"
    arm = EXAMPLE / "arm.toml"
    log, named, maps = telemetry / "run.blf", telemetry / "arm.toml", telemetry / "map.toml"
    convert = ["convert", log, "--arm", named, "-o", out / "run.blf"]
    cases: list[tuple[list[object], Path]] = [
        (["dbc", "-o", out / "arm.dbc", "--arm"], arm),
        (["dbc", "--arm", arm, "-o", out / "arm.dbc", "--model"], model),
        (["bus-load", "--json", out / "load.json", "--arm"], arm),
        (["simulate", "-o", out / "run.blf"], brief_scenario),
        (["simulate", "scenario.toml", "-o", out / "run.blf", "--model"], model),
        ([*convert, "--map", maps, "--dbc"], telemetry / "arm.dbc"),
        ([*convert, "--dbc", telemetry / "arm.dbc", "--map"], maps),
        (["import", "--template", out / "answers.toml"], urdf / "arm.urdf"),
        (["import", urdf / "arm.urdf", "-o", out, "--answers"], urdf / "answers.toml"),
    ]
    for arguments, file in cases:
        found = []
        for name in (file, Path("-")):
            shutil.rmtree(out, ignore_errors=True)
            stdin(file.read_bytes())
            assert run(*arguments, name) in (0, 3), arguments
            found.append({path.name: path.read_bytes() for path in out.iterdir() if path.suffix != ".blf"})
        assert found[0] == found[1]
        assert found[0] or "simulate" in arguments
    assert "standard input" not in capsys.readouterr().err
    stdin(b"{}")
    assert run("fit", "-", "--arm", arm, "--model", model, "-o", out / "m.toml") == 2
    assert "-: has no arm" in capsys.readouterr().err


def test_only_one_file_comes_on_standard_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("dbc", "--arm", "-", "--model", "-", "-o", tmp_path / "a.dbc") == 2
    assert "standard input more than once" in capsys.readouterr().err


@pytest.mark.slow
def test_only_one_file_goes_to_standard_output(brief_recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("estimate", brief_recording, "-o", "-", "--json", "-") == 2
    said = capsys.readouterr()
    assert "standard output more than once" in said.err
    assert said.out == ""


@pytest.mark.slow(only=["arguments4*", "arguments0*", "arguments1*", "arguments2*"])
@pytest.mark.parametrize(
    ("arguments", "option", "suffix"),
    [
        (("estimate", "{run}"), "-o", ".toml"),
        (("estimate", "--energy", "{run}", "-o", "{out}/x.toml"), "--json", ".json"),
        (("dbc", "--arm", EXAMPLE / "arm.toml"), "-o", ".dbc"),
        (("import", ROOT / "examples" / "urdf" / "arm.urdf"), "--template", ".toml"),
        (("view", "{run}", "--model", EXAMPLE / "model.toml", "--at", "1"), "--png", ".png"),
    ],
)
def test_standard_output_has_the_file_and_nothing_else(
    arguments: Sequence[object], option: str, suffix: str, brief_recording: Path, tmp_path: Path,
    capfdbinary: pytest.CaptureFixture[bytes],
) -> None:  # fmt: skip
    given = [str(part).format(run=brief_recording, out=tmp_path) for part in arguments]
    assert run(*given, option, tmp_path / f"file{suffix}") == 0
    assert capfdbinary.readouterr().out
    assert run(*given, option, "-") == 0
    assert capfdbinary.readouterr().out == (tmp_path / f"file{suffix}").read_bytes()


@pytest.mark.slow
def test_a_pipe_from_the_plant_to_the_estimate(brief_scenario: Path, tmp_path: Path) -> None:
    """candump's lines on the way; no file is written."""
    zygos, arm = [sys.executable, "-m", "zygos.cli"], str(EXAMPLE / "arm.toml")
    command = [*zygos, "simulate", str(brief_scenario), "-o", "-"]
    log = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True).stdout
    assert re.match(rb"\(\d+\.\d+\) can0 080#[0-9A-F]{2}", log)
    command = [*zygos, "estimate", "--energy", "-", "--arm", arm, "-o", "-"]
    done = subprocess.run(command, cwd=tmp_path, input=log, capture_output=True, check=True)
    recording = brief_scenario.with_name("run.blf")
    assert run("simulate", brief_scenario, "-o", recording) == 0
    assert run("estimate", "--energy", recording, "-o", tmp_path / "m.toml") == 0
    assert done.stdout == (tmp_path / "m.toml").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["m.toml"]


OUTPUTS: list[tuple[tuple[object, ...], str, str]] = [
    (("simulate", EXAMPLE / "scenario.toml"), "-o", ".blf"),
    (("simulate", EXAMPLE / "scenario.toml", "-o", "{out}/x.blf"), "--json", ".json"),
    (("estimate", "{run}"), "-o", ".toml"),
    (("estimate", "--energy", "{run}", "-o", "{out}/x.toml"), "--json", ".json"),
    (("estimate", "--energy", "{run}", "-o", "{out}/x.toml"), "--report", ".html"),
    (("self-test", "{run}"), "--json", ".json"),
    (("self-test", "{run}"), "--report", ".html"),
    (("check-arm", "{run}", "--arm", EXAMPLE / "arm.toml"), "--report", ".html"),
    (("check-arm", "{run}", "--arm", EXAMPLE / "arm.toml"), "--json", ".json"),
    (("convert", ROOT / "examples/telemetry/run.blf", "--dbc", ROOT / "examples/telemetry/arm.dbc", "--map",
      ROOT / "examples/telemetry/map.toml"), "-o", ".blf"),
    (("view", "{run}"), "--png", ".png"),
    (("view", "{run}"), "--html", ".html"),
    (("view", "{run}", "--png", "{out}/x.png"), "--json", ".json"),
    (("explain", "--simulation", ROOT / "examples/gap/cad.toml", ROOT / "examples/gap/demo/a.blf",
      ROOT / "examples/gap/demo/b.blf", "--arm", ROOT / "examples/gap/arm.toml"), "-o", ".toml"),
    (("explain", "--simulation", ROOT / "examples/gap/cad.toml", ROOT / "examples/gap/demo/a.blf",
      ROOT / "examples/gap/demo/b.blf", "--arm", ROOT / "examples/gap/arm.toml", "-o", "{out}/x.toml"), "--report",
     ".html"),
    (("import", ROOT / "examples/urdf/arm.urdf"), "--template", ".toml"),
    (("dbc", "--arm", EXAMPLE / "arm.toml"), "-o", ".dbc"),
    (("parameters", EXAMPLE / "arm.toml"), "--json", ".json"),
    (("plan", EXAMPLE / "scenario.toml"), "-o", ".toml"),
    (("refine", "{run}"), "-o", ".toml"),
    (("refine", "{run}", "-o", "{out}/x.toml"), "--json", ".json"),
    (("refine", "{run}", "-o", "{out}/x.toml"), "--report", ".html"),
    (("bound", EXAMPLE / "scenario.toml"), "--json", ".json"),
    (("plan", EXAMPLE / "scenario.toml"), "--json", ".json"),
    (("plan", EXAMPLE / "scenario.toml"), "--report", ".html"),
    (("compile-model", EXAMPLE / "arm.toml", "-o", "{out}/x"), "--json", ".json"),
    (("bus-load", "--arm", EXAMPLE / "arm.toml"), "--json", ".json"),
    (("paper",), "--json", ".json"),
]  # fmt: skip


def no_work(*_: object, **__: object) -> None:
    pytest.fail("work was begun before the outputs were looked at")


@pytest.mark.parametrize("wrong", ["a folder", "below a file", "no folder for files"])
@pytest.mark.parametrize(("arguments", "option", "suffix"), OUTPUTS)
def test_an_output_that_cannot_be_written_is_noticed_before_the_work(
    arguments: Sequence[object], option: str, suffix: str, wrong: str, brief_recording: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    given = [str(part).format(run=brief_recording, out=tmp_path / "out") for part in arguments]
    (tmp_path / "file").write_text("")
    (tmp_path / f"folder{suffix}").mkdir()
    # /proc takes no files, whoever asks: neither permissions nor the user's number say so
    places = {"a folder": tmp_path / f"folder{suffix}", "below a file": tmp_path / "file" / f"x{suffix}"}
    place = places.get(wrong, Path(f"/proc/x{suffix}"))
    for name in ("zygos.can.bus.read_messages", "zygos.simulation.plant.DOP853", "zygos.native.flight.Flight.__init__"):
        monkeypatch.setattr(name, no_work)
    assert run(*given, option, place) == 2
    said = capsys.readouterr().err
    assert f"{place}: " in said
    assert "remedy" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", f"folder{suffix}"]


@pytest.mark.slow(only=["Ctrl*"])
@pytest.mark.parametrize(("how", "code"), [("Ctrl-C", 130), ("SIGTERM", 143), ("an error", 2)])
def test_work_that_does_not_end_leaves_nothing(
    how: str, code: int, brief_scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    before = signal.getsignal(signal.SIGTERM)

    def interrupted(*_: object, **__: object) -> None:
        if how == "an error":
            raise OSError(28, "No space left on device")
        os.kill(os.getpid(), signal.SIGTERM if how == "SIGTERM" else signal.SIGINT)
        time.sleep(10)

    monkeypatch.setattr("can.BLFWriter.on_message_received", interrupted)
    assert run("simulate", brief_scenario, "-o", tmp_path / "run.blf") == code
    assert list(tmp_path.iterdir()) == []
    assert "Traceback" not in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is before
