# SPDX-License-Identifier: MIT
"""python-can's converter of logs in a module that imports nothing else, so that a fork loads it quickly."""

from __future__ import annotations

import faulthandler
import os
import sys

import can.logconvert


def logconvert(source: str, target: str) -> None:
    """Convert a log as `python -m can.logconvert` does, without a word."""
    faulthandler.disable()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    sys.argv = ["logconvert", source, target]
    can.logconvert.main()
