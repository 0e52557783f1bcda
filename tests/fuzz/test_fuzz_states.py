# SPDX-License-Identifier: MIT
"""Stored states with a good CRC and wild contents, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import tool
from fuzz_support import FEW_BLOCKS, build, counts

TRIES = 1000


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "spatial"), [(1, 0), (2, 1)], ids=["planar", "with-room-for-spatial"])
def test_no_state_takes_the_library_out_of_its_memory(tmp_path: Path, seed: int, spatial: int) -> None:
    program = build(tmp_path, "fuzz_states", tool("gcc"), MAX_JOINTS=2, SPATIAL=spatial, **FEW_BLOCKS)
    found = counts(program, seed, TRIES, 2)
    assert found["resumed"] + found["refused_state"] + found["refused_otherwise"] == TRIES
    often = ("resumed", "refused_state", "corrupt", "values", "configured", "in_place")
    assert min(found[name] for name in often) > TRIES / 20
    assert found["refused_otherwise"] > 0
