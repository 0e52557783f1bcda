# SPDX-License-Identifier: MIT
"""The layout of the tests (docs/testing.md)."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from conftest import ROOT

TESTS = ROOT / "tests"
MODULES = sorted(TESTS.rglob("test_*.py"))


def imported(module: Path) -> set[str]:
    """The last parts of all module names that it imports, and the names that it imports from them."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[-1] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {(node.module or "").split(".")[-1], *(name.name for name in node.names)}
    return found


def test_no_test_module_imports_another() -> None:
    names = {module.stem for module in MODULES}
    named = re.compile(r"\btest_\w+")
    suspects = [module for module in MODULES if names.intersection(named.findall(module.read_text(encoding="utf-8")))]
    assert {module.name: both for module in suspects if (both := imported(module) & names)} == {}


def test_every_folder_of_tests_has_its_line_in_the_manual() -> None:
    manual = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    folders = {path.parent.relative_to(TESTS).parts[0] for path in TESTS.rglob("*.py") if path.parent != TESTS}
    assert {folder for folder in folders if f"| `{folder}/` |" not in manual} == set()
