# SPDX-License-Identifier: MIT
"""Commands in this process."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from runs_support import trajectory_of

import zygos.cli.simulate
from zygos.cli import main

zygos.cli.simulate.simulate = trajectory_of  # `zygos simulate` takes its trajectory from the cache


def run(*arguments: object) -> int:
    """A command as a user types it. Returns the exit code."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


def in_process(command: list[str], **_: object) -> SimpleNamespace:
    """`subprocess.run` of a command of zygos, in this process."""
    assert command[1:3] == ["-m", "zygos.cli"]
    return SimpleNamespace(returncode=run(*command[3:]), stderr="")
