# SPDX-License-Identifier: MIT
"""The table of limits is the only place of numbers that decide an answer of `zygos explain`."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from conftest import ROOT
from zygos import limits

GAP = ROOT / "harness" / "zygos" / "gap"
DRAWN = {"charts.py", "picture.py", "sections.py"}
"""Modules whose numbers are those of a drawing."""
PLAIN = {0, 1, 2, 3, 4, 5, 9, 10, 26, 50, 0.5, 6, 12, 100, 1000, 1e-6, 1e-300}
"""Numbers that are no limits: places, orders, halves, medians, letters and digits, the ten elements of a body, the
variance of a uniform distribution, units, and the smallest number that one divides by."""
PROGRESS = {"step", "progress"}
"""Functions that are told how far the work is."""


def numbers(source: str) -> Iterator[tuple[int, float]]:
    """Line and value of each number that stands in a module's code, but for those that say how far the work is."""
    tree = ast.parse(source)
    told = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in PROGRESS
        for argument in node.args
        for inner in ast.walk(argument)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float) and id(node) not in told:
            yield node.lineno, node.value


def constants(source: str) -> Iterator[int]:
    """Line of each assignment of a number, or of numbers, in the body of a module."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Constant | ast.Tuple | ast.UnaryOp
        ):
            inner = [one for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
            if any(type(one.value) in (int, float) for one in inner):
                yield node.lineno


def test_no_number_decides_outside_of_the_table() -> None:
    found = []
    for path in sorted(GAP.rglob("*.py")):
        if path.name not in DRAWN:
            source = path.read_text(encoding="utf-8")
            found += [f"{path}:{line}: {value!r}" for line, value in numbers(source) if value not in PLAIN]
            found += [f"{path}:{line}: a constant" for line in constants(source)]
    assert not found, "remedy: give it a name, a meaning and a source in harness/zygos/limits.py"


def test_a_number_is_found() -> None:
    source = "LIMIT = 3\ndef f(x):\n    progress(0.3)\n    return x > 1.7\n"
    assert list(numbers(source)) == [(1, 3), (4, 1.7)] and list(constants(source)) == [1]


def test_every_limit_has_its_identifier_as_name_and_is_used() -> None:
    text = "".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "harness").rglob("*.py") if path.name != "limits.py"
    )
    for identifier, one in vars(limits).items():
        if isinstance(one, limits.Limit):
            assert one.name == identifier.lower().replace("_", " ")
            assert one.meaning.endswith(".")
            assert f"limits.{identifier}" in text, f"{identifier} is not used"
