# SPDX-License-Identifier: MIT
"""The refinement on board with memory that changes, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from build_support import tool
from fuzz_support import build, counts

from bench.onboard import CASES, write_run

PLANAR = replace(CASES["planar, 2 joints, every cycle"], cycles=100)


def flown(folder: Path, seed: int, tries: int) -> dict[str, int]:
    """What came of so many changes."""
    write_run(PLANAR, folder / "run.bin")
    program = build(folder, "fuzz_refine", tool("gcc"), MAX_JOINTS=2, SPATIAL=0)
    return counts(program, folder / "run.bin", seed, tries)


@pytest.mark.slow
@pytest.mark.parametrize("tries", [3000])
def test_no_change_of_its_memory_makes_the_refinement_crash_or_hang(tmp_path: Path, tries: int) -> None:
    """One bit, the same bit of two words, some words and all of it, between any two slices; wild arguments before."""
    found = flown(tmp_path, tries, tries)
    assert found["one_bit"] == tries // 2 and found["pair_of_words"] > tries // 10
    assert found["one_bit_noticed"] > tries // 20
    assert found["all_noticed"] == found["all"] and found["words_noticed"] > found["words"] // 3
    assert sum(found[name] for name in found if name.endswith("_silent")) <= tries // 100
