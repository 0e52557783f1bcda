"""What the tests of builds share: tools that may be missing, commands that must be silent, and `make install`."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from conftest import need

ROOT = Path(__file__).resolve().parents[2]


def tool(name: str) -> str:
    """The program, or a skipped test; on a build server a failed one."""
    path = shutil.which(name)
    need(path, f"{name}: what it builds stays unchecked")
    return str(path)


def run(command: list[str], folder: Path, **environment: str) -> str:
    """Standard output of a command that must succeed and write nothing else."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        command, cwd=folder, env={**inherited, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    assert not done.stderr, done.stderr
    return done.stdout


def make(target: str, build: Path, tree: Path = ROOT, **variables: str | Path) -> str:
    """Run `make TARGET NAME=value ..` in a source tree, objects below `build`; what it prints."""
    words = [f"{name}={value}" for name, value in variables.items()]
    return run([tool("make"), "--no-print-directory", "-j2", target, f"BUILD={build}", *words], tree)
