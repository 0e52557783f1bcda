# SPDX-License-Identifier: MIT
"""Errors that a user can cause and repair; the command line prints them and exits with their code."""

from __future__ import annotations

import importlib.util
import shlex
import sys


class ZygosError(Exception):
    """Bad input. The message says what is wrong and how to repair it: ``"what is wrong: …; remedy: …"``."""

    exit_code: int = 2


class Undecided(ZygosError):
    """The question is valid, but the data do not answer it."""

    exit_code = 3


class Damaged(ZygosError):
    """The question was answered, but from a log that is incomplete."""

    exit_code = 4


def installs(extra: str) -> str:
    """The command that installs an extra of zygos into the environment in use, for a remedy."""
    return pip_installs(f"'zygos[{extra}]'")


def pip_installs(package: str) -> str:
    """The command that installs a package into the environment in use; one without pip is named to another pip."""
    python = shlex.quote(sys.executable)
    pip = f"{python} -m pip" if importlib.util.find_spec("pip") else f"pip --python {python}"
    return f"{pip} install {package}"
