"""Stored states with a good CRC and wild contents, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_support import build, counts

TRIES = 4000


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "spatial"), [(1, 0), (2, 1)], ids=["planar", "with-room-for-spatial"])
def test_no_state_takes_the_library_out_of_its_memory(tmp_path: Path, seed: int, spatial: int) -> None:
    program = build(
        tmp_path,
        "fuzz_states",
        **{"MAX_JOINTS": 2, "SPATIAL": spatial, "MAX_BLOCKS": 16, "MAX_MOTOR_BLOCKS": 4, "MAX_MOMENTUM_BLOCKS": 4},
    )
    found = counts(program, seed, TRIES, 2)
    assert found["resumed"] + found["refused_state"] + found["refused_otherwise"] == TRIES
    assert (
        min(
            found["resumed"],
            found["refused_state"],
            found["corrupt"],
            found["values"],
            found["configured"],
            found["in_place"],
        )
        > TRIES / 20
    )
    assert found["refused_otherwise"] > 0
