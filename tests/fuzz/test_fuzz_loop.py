# SPDX-License-Identifier: MIT
"""The loop with random bytes over its memory, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import tool
from fuzz_support import FEW_BLOCKS, build, counts


@pytest.mark.slow
@pytest.mark.parametrize(("tries", "spatial"), [(6000, 0), (1500, 1)], ids=["planar", "in-space"])
def test_no_bytes_in_its_memory_make_a_call_of_the_loop_crash_or_hang(tmp_path: Path, tries: int, spatial: int) -> None:
    program = build(tmp_path, "fuzz_loop", tool("gcc"), MAX_JOINTS=2, SPATIAL=spatial, **FEW_BLOCKS)
    found = counts(program, 1, tries, 2)
    assert min(found[name] for name in ("refused", "solved", "restarted", "sealed", "refined")) > tries / 10
    assert found["stepped"] > 4 * tries
