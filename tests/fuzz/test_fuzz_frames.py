"""A million valid, damaged and random frames, three times, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_support import build, counts

MILLION = 1_000_000


@pytest.mark.slow(but=["a-few"])
@pytest.mark.parametrize(
    ("seed", "joints", "fine", "frames"),
    [(1, 2, 1, MILLION // 4), (1, 2, 1, MILLION), (2, 2, 0, MILLION), (3, 7, 1, MILLION)],
    ids=["a-few", "fine-gyro", "coarse-gyro", "seven-joints"],
)
def test_what_a_frame_may_change(tmp_path: Path, seed: int, joints: int, fine: int, frames: int) -> None:
    # few blocks of planar arms keep it small
    program = build(tmp_path, "fuzz_frames", MAX_JOINTS=joints, MAX_BLOCKS=12, SPATIAL=0)
    found = counts(program, seed, frames, joints, fine)
    assert found["foreign"] + found["accepted"] + found["rejected"] >= frames
    missed = [name for name, count in found.items() if count == 0]
    assert not missed, f"the frames did not provoke {missed}"
    assert found["rows"] > 1000, "too few rows for an effect on them to show"
