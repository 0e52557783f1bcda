# SPDX-License-Identifier: MIT
"""Commands in this process."""

from __future__ import annotations

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
