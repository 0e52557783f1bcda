# SPDX-License-Identifier: MIT
"""What an answer was made from."""

from __future__ import annotations

import hashlib
import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from zygos.files.inputs import given


@dataclass(frozen=True)
class Provenance:
    """Command, version and inputs of an answer."""

    command: str
    version: str
    files: tuple[tuple[str, str, str], ...]
    """Role, path and SHA-256 of each file that was read."""


def provenance(command: Sequence[str], files: Sequence[tuple[str, Path]]) -> Provenance:
    """That of a command, its arguments without `zygos`, and of the files that it reads: role and path."""
    hashed = ((role, str(path), hashlib.sha256(given(path).read_bytes()).hexdigest()) for role, path in files)
    return Provenance(shlex.join(["zygos", *command]), version("zygos"), tuple(hashed))


def measured_commit(checkout: Path = Path(__file__).parent) -> str:
    """Commit of a checkout, by default of these sources, with a plus where sources or tests have changes. "no commit"
    outside a checkout."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=checkout, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", *(f":/{folder}" for folder in ("harness", "c", "include", "tests")))
    return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "") or "no commit"
