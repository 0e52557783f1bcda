# SPDX-License-Identifier: MIT
"""Valid, damaged and random frames under the address and undefined-behaviour sanitizers; `make verify` flies more."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import tool
from fuzz_support import FEW_BLOCKS, build, counts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cc", "seed", "joints", "fine", "frames"),
    [("clang", 1, 2, 1, 80_000), ("gcc", 2, 2, 0, 250_000), ("gcc", 3, 7, 1, 300_000)],
    ids=["fine-gyro", "coarse-gyro", "seven-joints"],
)
def test_what_a_frame_may_change(tmp_path: Path, cc: str, seed: int, joints: int, fine: int, frames: int) -> None:
    """clang compiles in half the time; gcc's sanitizer knows the size of the last member of a struct, too."""
    program = build(tmp_path, "fuzz_frames", tool(cc), MAX_JOINTS=joints, SPATIAL=0, **FEW_BLOCKS)
    found = counts(program, seed, frames, joints, fine)
    assert found["foreign"] + found["accepted"] + found["rejected"] >= frames
    missed = [name for name, count in found.items() if count == 0]
    assert not missed, f"the frames did not provoke {missed}"
    assert found["rows"] > 1000, "too few rows for an effect on them to show"
