"""A million valid, damaged and random frames, three times, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_support import build, counts

FRAMES = 1_000_000


@pytest.mark.slow(but=["fine-gyro"])
@pytest.mark.parametrize(
    ("seed", "joints", "fine"), [(1, 2, 1), (2, 2, 0), (3, 7, 1)], ids=["fine-gyro", "coarse-gyro", "seven-joints"]
)
def test_what_a_frame_may_change(tmp_path: Path, seed: int, joints: int, fine: int) -> None:
    # few blocks of planar arms keep it small
    program = build(tmp_path, "fuzz_frames", MAX_JOINTS=joints, MAX_BLOCKS=8, SPATIAL=0)
    found = counts(program, seed, FRAMES, joints, fine)
    assert found["foreign"] + found["accepted"] + found["rejected"] >= FRAMES
    missed = [name for name, count in found.items() if count == 0]
    assert not missed, f"the frames did not provoke {missed}"
    assert found["rows"] > 1000, "too few rows for an effect on them to show"
