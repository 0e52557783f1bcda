# SPDX-License-Identifier: MIT
"""Double arithmetic on the targets is that of IEEE 754, which numpy has from the host's processor.

Operands are such that software gets them wrong: far apart, near powers of two, denormal, halfway between two results.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pil.conftest import Agree
from pil.pil_support import HERE, TARGETS, Comparison, build_firmware

Floats = NDArray[np.float64]
COUNT = 60_000
"""Of each operation."""

OPERATIONS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "square root": lambda a, b: np.sqrt(a),
    "less": lambda a, b: (a < b).astype(float),
    "from uint64": lambda a, b: a.view(np.uint64).astype(float),
    "to int32": lambda a, b: a.astype(np.int32).astype(float),
    "to float": lambda a, b: a.astype(np.float32).astype(float),
}
"""By numpy, in the order of arithmetic.c."""


def awkward(rng: np.random.Generator, n: int) -> Floats:
    """Doubles of all sizes, a third of them within a few units in the last place of a power of two."""
    size = 2.0 ** rng.choice([rng.integers(-1074, 1024, n), rng.integers(-70, 70, n), rng.integers(-3, 3, n)], axis=0)
    x = np.where(rng.random(n) < 0.4, rng.uniform(1.0, 2.0, n), 1.0) * size
    x = (x.view(np.int64) + rng.choice([0, 0, 1, -1, 2, 2**31, 2**32 - 1], n)).view(np.float64)
    x[rng.random(n) < 0.02] = rng.choice([0.0, np.inf, np.nan, 5e-324, 1.7e308])
    return x * rng.choice([1.0, -1.0], n)


def operands(name: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    a, b = awkward(rng, COUNT), awkward(rng, COUNT)
    near = rng.random(COUNT) < 0.5  # the second within 64 powers of two of the first
    b[near] = np.ldexp(np.frexp(b[near])[0], np.frexp(a[near])[1] + rng.integers(-64, 64, near.sum()))
    if name == "square root":
        a = np.abs(a)
    if name == "to int32":  # beyond its range C leaves the answer open
        a = rng.uniform(-(2.0**31), 2.0**31 - 1.0, COUNT) * rng.choice([1.0, 1e-3, 1e-8, 0.0], COUNT)
    return a, b


@pytest.mark.parametrize("target", TARGETS)
def test_every_operation_is_rounded_as_on_the_host(
    target: str, tmp_path: Path, agree: Agree, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed = [room for room in build_firmware.ROOMS if room.stem in ("core", "semihosting", "capacities")]
    monkeypatch.setattr(build_firmware, "ROOMS", needed)
    elf = build_firmware.build(target, tmp_path / "arithmetic.elf", [HERE / "arithmetic.c"])
    rng = np.random.default_rng(0)
    with np.errstate(all="ignore"):
        drawn = {name: operands(name, rng) for name in OPERATIONS}
        expected = np.concatenate([OPERATIONS[name](*pair) for name, pair in drawn.items()])
    table = np.zeros((len(expected), 3))
    for k, pair in enumerate(drawn.values()):
        rows = table[k * COUNT : (k + 1) * COUNT]
        rows[:, 0].view(np.uint64)[:] = k
        rows[:, 1:] = np.stack(pair, axis=1)
    (tmp_path / "ops.bin").write_bytes(table.tobytes())
    subprocess.run(build_firmware.run(target, elf), cwd=tmp_path, check=True, timeout=120)
    found = np.fromfile(tmp_path / "results.bin", dtype=np.float64)
    assert len(found) == len(expected)
    # which NaN it is, IEEE 754 leaves open
    same = (found.view(np.uint64) == expected.view(np.uint64)) | (np.isnan(found) & np.isnan(expected))
    wrong = np.flatnonzero(~same)
    name = list(OPERATIONS)[wrong[0] // COUNT] if len(wrong) else ""
    first = f"{name} {table[wrong[0], 1].hex()} {table[wrong[0], 2].hex()}" if len(wrong) else ""
    agree(
        target,
        "operations on doubles",
        f"{COUNT:,} of each of {len(OPERATIONS)}",
        Comparison(int(same.sum()) * 8, 8 * len(same), first),
    )
