# SPDX-License-Identifier: MIT
"""The counts that `make soak` expects, against the C library and the numpy reference, on traffic that is far worse."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from soak.traffic import Book, disturbed
from zygos.arm import Arm
from zygos.native import snapshot
from zygos.native.flight import Flight, encode
from zygos.reference.compare import decode
from zygos.runs.cycles import Cycles

CYCLES, MISSING = 600, 5


def at_rest(arm: Arm, first: int) -> Cycles:
    table = np.zeros((CYCLES, arm.n))
    sync = np.arange(first, first + CYCLES, dtype=np.uint64)
    return Cycles(sync, table, table, table, np.zeros((CYCLES, 3)), np.zeros(CYCLES, dtype=np.uint32))


@pytest.mark.slow(only=["0.0-0.01", "0.02*"])
@pytest.mark.parametrize(("lost", "stale"), [(0.0, 0.0), (0.0, 1e-2), (0.02, 0.02), (0.2, 0.1)])
def test_the_book_counts_what_c_and_numpy_count(arm: Arm, lost: float, stale: float) -> None:
    rng, book, flight = np.random.default_rng(3), Book(2 * arm.n + 2), Flight(arm)
    arrived = []
    for turn in range(2):
        first = turn * (CYCLES + MISSING)
        frames = encode(arm, at_rest(arm, first))
        sent = disturbed(frames[:-1], first, lost, stale, rng)
        sent.lost[0] &= turn > 0  # nothing can be said of frames before the first SYNC
        book.hear(sent)
        arrived.append(sent.arriving)
    arrived.append(frames[-1:])
    book.end()
    flight.frames(np.concatenate(arrived))
    reference = decode(arm, np.concatenate(arrived))
    assert +book.faults == +Counter(flight.faults)
    assert +book.faults == +reference.faults
    assert book.cycles == flight.counts["cycles"] == len(reference.cycles)


@pytest.mark.slow
def test_the_book_after_a_snapshot(arm: Arm, tmp_path: Path) -> None:
    """The cycle that is open then is lost."""
    rng, book, flight = np.random.default_rng(4), Book(2 * arm.n + 2), Flight(arm)
    for turn in range(3):
        first = turn * (CYCLES + MISSING)
        frames = encode(arm, at_rest(arm, first))
        sent = disturbed(frames[:-1], first, 0.01 * (turn > 0), 0.01, rng)
        book.hear(sent)
        flight.frames(sent.arriving)
        snapshot.write(tmp_path / "state", "state", flight.native)
        flight = Flight(arm)
        snapshot.resume(flight, tmp_path / "state")
        book.resume()
    flight.frames(frames[-1:])
    book.end()
    assert +book.faults == +Counter(flight.faults)
    assert book.cycles == flight.counts["cycles"]
    assert book.faults["sync_jumped"] >= 2
