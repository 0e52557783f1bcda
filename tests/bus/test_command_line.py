"""What all commands have in common: help, version, completion, narrow terminals, standard input and output."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

from conftest import ROOT
from zygos.cli import app, main

COMMANDS = sorted(str(name) for name in typer.main.get_command(app).commands)  # type: ignore[attr-defined]


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


def shell(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    command = [sys.executable, "-m", "zygos.cli", *map(str, arguments)]
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


def words(text: str) -> str:
    """Letters and brackets alone: no frames, no line breaks, no marks of Markdown."""
    return re.sub(r"[^\w\[\]]+", " ", text)


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 15


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
    group = typer.main.get_command(app)
    described = group.commands[command] if command else group  # type: ignore[attr-defined]
    assert words(inspect.cleandoc(described.callback.__doc__ or described.help)) in words(said)
    for option in described.params:
        for name in (*option.opts, *option.secondary_opts):
            assert not name.startswith("-") or re.search(rf"(?<![\w-]){name}(?![\w-])", said), name


def test_brackets_of_toml_are_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    for command, said in (("estimate", "[[effect]] entries"), ("view", "'zygos[view]'"), ("fit", "'zygos[fit]'")):
        assert run(command, "--help") == 0
        assert said in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [("[red]nothing[/]",), ("estimate", "--[bold]"), ("check", "run[/].db")])
def test_brackets_are_in_the_refusal(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) == 2
    assert arguments[-1] in capsys.readouterr().err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"zygos {version('zygos')}\n"


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("zygos esti", ["estimate"]),
        ("zygos check", ["check", "check-arm"]),
        ("zygos estimate --mo", ["--model"]),
        ("zygos nothing", []),
    ],
)
def test_bash_completes(line: str, completed: list[str]) -> None:
    """As the function does that bash calls when Tab is pressed."""
    script = subprocess.run(
        [Path(sys.executable).parent / "zygos", "--show-completion", "bash"], capture_output=True, text=True, check=True
    ).stdout
    asked = f"COMP_WORDS=({line}); COMP_CWORD={len(line.split()) - 1}; _zygos_completion zygos; echo ${{COMPREPLY[@]}}"
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", f"{script}\n{asked}"],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == completed


def test_what_completes_is_installed(tmp_path: Path) -> None:
    home = {"HOME": str(tmp_path), "SHELL": "/bin/bash"}
    zygos = Path(sys.executable).parent / "zygos"
    done = subprocess.run([zygos, "--install-completion", "bash"], env={**os.environ, **home}, check=False)
    assert done.returncode == 0
    assert "zygos" in (tmp_path / ".bashrc").read_text()
