# SPDX-License-Identifier: MIT
"""A campaign of few trials."""

from __future__ import annotations

from pathlib import Path

import pytest

from upset.campaign import OUTCOMES, fly, members, sizes

TRIALS = 300


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar", "in_place", "pairs"])
def test_no_flipped_bit_makes_the_library_crash_or_hang(name: str, tmp_path: Path) -> None:
    records = fly(name, TRIALS, folder=tmp_path)
    counts = {outcome: int((records["outcome"] == k).sum()) for k, outcome in enumerate(OUTCOMES)}
    assert counts["crash"] == counts["hang"] == counts["unfinished"] == 0
    assert counts["silent"] <= 2
    assert counts["detected"] > TRIALS // 20
    records["other"] = records["bit"]
    hit = members(name, records)
    assert sum(hit.values()) == TRIALS
    ((largest, size),) = sizes(name).most_common(1)
    share = size / sizes(name).total()
    assert abs(hit[largest] - share * TRIALS) < 3.0 * (share * (1.0 - share) * TRIALS) ** 0.5
