"""Parts of the tests: each test is in one of them, and what is no part is refused."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

import pytest
import tiers

from conftest import ROOT


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_each_test_is_in_one_part(parts: int) -> None:
    names = [f"tests/unit/test_some.py::test_{k}[case]" for k in range(200)]
    found = Counter(k for name in names for k in range(parts) if tiers.in_part(name, k, parts))
    assert sum(found.values()) == len(names)
    assert len(found) == parts and min(found.values()) > 100 / parts


@pytest.mark.parametrize("text", ["", "0/3", "4/3", "1", "1/0", "a/b", "-1/3", "1/3/5"])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(pytest.UsageError, match="remedy: for example --part 1/3"):
        tiers.part_of(text)


@pytest.mark.parametrize(
    ("case", "chosen", "slow"),
    [
        ("one", {}, True),
        ("one", {"but": ["one"]}, False),
        ("one-2", {"but": ["two-*", "one-*"]}, False),
        ("one-2", {"but": ["one"]}, True),
        ("one-2", {"only": ["one-*"]}, True),
        ("two-2", {"only": ["one-*"]}, False),
        ("one-2", {"only": ["one-*"], "but": ["*-2"]}, False),
    ],
)
def test_which_cases_are_slow(case: str, chosen: dict[str, list[str]], slow: bool) -> None:
    assert tiers.is_slow(case, **chosen) == slow


@pytest.mark.slow
def test_pytest_runs_a_part() -> None:
    """The names of both halves are those of all."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-p", "no:cacheprovider", __file__]

    def listed(*options: str) -> list[str]:
        done = subprocess.run([*command, *options], cwd=ROOT, capture_output=True, text=True, check=False)
        return [line for line in done.stdout.splitlines() if "::" in line]

    whole, *halves = listed(), listed("--part", "1/2"), listed("--part", "2/2")
    assert len(whole) == 19 and sorted(halves[0] + halves[1]) == sorted(whole)
    assert all(halves)
    done = subprocess.run([*command, "--part", "3/2"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 4 and "remedy: for example --part 1/3" in done.stderr + done.stdout
