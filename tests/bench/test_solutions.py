# SPDX-License-Identifier: MIT
"""The dearest solution is no dearer than include/zygos/priv/solver.h states, and a refused one no dearer than a valid
one."""

from __future__ import annotations

import json
import platform
import shutil
from dataclasses import asdict
from pathlib import Path

import pytest

from bench import tables
from bench.solutions import JOINT_ROUNDS, ROUND, SOLVED, USUAL, Bound, Solution, counted, dearest
from conftest import ROOT, need
from zygos.native.flight import ffi

WORST = 1.5
"""Most that the dearest solution takes of the dearest valid one for as many parameters."""
FULL = 0.6
"""Least share of its bound that the dearest solution of all arcs reaches: a bound that nothing comes near says nothing.
Rows are weighed by one pair in place of ROUND where less than half of them is noise, as here."""


def need_tools() -> None:
    need(platform.machine() == "x86_64", "an x86-64 machine: the cost of a solution stays uncounted")
    for program in ("gcc", "valgrind"):
        need(shutil.which(program), f"{program}: the cost of a solution stays uncounted")


def judge(found: list[Solution]) -> None:
    """What holds for every set of solutions that has a valid one."""
    for one in found:
        assert 0 < one.pairs <= one.most, one
    for cost in ("pairs", "instructions"):
        assert dearest([asdict(one) for one in found], cost) <= WORST, cost
    usual = next(one for one in found if one.case == USUAL)
    assert usual.validity == "valid" and FULL * usual.once <= usual.pairs <= usual.once


@pytest.mark.slow
def test_a_refused_solution_costs_hardly_more_than_a_valid_one(tmp_path: Path) -> None:
    """With bad arcs that cannot be left out, where solutions without old arcs are tried and of no use."""
    need_tools()
    found = counted(SOLVED[0], tmp_path, [USUAL, "bad first arcs"])
    judge(found)
    assert found[1].validity == "refused"


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVED)
def test_no_solution_takes_more_than_is_stated(name: str, tmp_path: Path) -> None:
    """Early and late, refused, with gains, with bad arcs, of a changed arm."""
    need_tools()
    found = counted(name, tmp_path)
    judge(found)
    if name == SOLVED[0]:
        assert {"valid", "doubtful", "refused"} == {one.validity for one in found}
        assert any(one.left_out for one in found) and any("the arm changed" in one.reason for one in found)


def test_what_was_measured_is_within_what_is_stated() -> None:
    """docs/bench.json; remedy: see docs/cost.md."""
    content = json.loads(tables.COMMITTED.read_text())["solutions"]["cases"]
    for name in SOLVED:
        judge([Solution(**one) for one in content if one["configuration"] == name])


def test_the_header_and_the_documents_state_the_same_bound() -> None:
    """That of all kinds of rows, with gains and old arcs; and of the capacities of this build."""
    weighing = 2 * ROUND + JOINT_ROUNDS
    once = Bound(0, 0, 0, weighing, gains=True, repeats=False).most
    newer = Bound(0, 0, 0, weighing - JOINT_ROUNDS, gains=True, repeats=False).most
    work = ffi.new("zygos_work_t *")
    others = len(work.sums.motors.block) + len(work.sums.momentum.block)
    groups = len(work.sums.joints.group) - 1
    full = Bound(len(work.sums.energy.block), others, groups, weighing, gains=True, repeats=True).most
    header = (ROOT / "include" / "zygos" / "priv" / "solver.h").read_text().replace("\n///", "")
    whole = f"3 (B + 1) / 2 + {once + 2 * newer}"
    for text in (f"(B + 1) / 2 + {once}", f"(B + 1) / 2 + {newer}", f"{whole}, and {full} with the usual capacities"):
        assert text in header
    manual = (ROOT / "docs" / "integrate.md").read_text()
    assert f"at most (B + 1) / 2 + {once} pairs of Cholesky factorisations" in manual and whole in manual
