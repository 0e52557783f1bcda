# SPDX-License-Identifier: MIT
"""The reference pages list every key that a reader asks for, state truly which are required, and are up to date."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import zygos
from conftest import ROOT, tool_module
from zygos.errors import ZygosError

HARNESS = ROOT / "harness" / "zygos"
READERS = ("arm.py", "model/correlation.py", "model/model.py", "simulation/scenario.py", "telemetry/map.py")
METHODS = {"number", "integer", "boolean", "text", "choice", "vector", "table", "tables"}


tool = tool_module("reference")
keys = tool_module("reference_pages.keys")


def test_the_pages_are_up_to_date() -> None:
    written = {path.name: path.read_text() for path in tool.PAGES.glob("*.md") if path.name != "README.md"}
    assert written == tool.pages(), "remedy: make reference"


def calls(path: Path) -> Iterator[tuple[str, int, int]]:
    """Where a module reads keys: file, last line and last column of each call of a table's method."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args):
            continue
        if node.func.attr in METHODS:
            assert node.end_lineno is not None and node.end_col_offset is not None
            yield str(path.resolve()), node.end_lineno, node.end_col_offset


def test_every_call_that_reads_a_key_is_on_a_page() -> None:
    """The samples lead the readers through all their branches."""
    recorded = {read.place for file in keys.FILES for read in file.reads()}
    read = {call for reader in READERS for call in calls(HARNESS / reader)}
    assert read - recorded == set(), "remedy: a file in tools/samples/ with the key that is read there"


def test_no_other_module_reads_files_of_keys() -> None:
    importing = {
        str(path.relative_to(HARNESS))
        for path in HARNESS.rglob("*.py")
        if "from zygos.files.toml import" in path.read_text()
    }
    assert importing == {*READERS, "urdf/answers.py"}, "remedy: a page of its own in tools/reference.py"


def test_every_enumeration_of_the_headers_is_on_the_page() -> None:
    headers = "".join(path.read_text() for path in (ROOT / "include" / "zygos").rglob("*.h"))
    page = (tool.PAGES / "codes.md").read_text()
    assert set(re.findall(r"^enum (\w+) \{", headers, re.MULTILINE)) == set(re.findall(r"## `enum (\w+)`", page))


def test_every_function_of_the_public_headers_is_on_the_page() -> None:
    page = (tool.PAGES / "c.md").read_text()
    for header in sorted((ROOT / "include" / "zygos").glob("*.h")):
        declared = set(re.findall(r"^[a-z][\w *]*?\b(zygos_\w+)\([^;{]*\);", header.read_text(), re.MULTILINE))
        assert {name for name in declared if f"`{name}()`" not in page} == set(), header.name


def test_every_name_of_the_python_interface_is_on_the_page() -> None:
    page = (tool.PAGES / "python.md").read_text()
    named = set(re.findall(r"^## (?:Function|Class) `(\w+)`$", page, re.MULTILINE))
    assert named | {"__version__"} == set(zygos.__all__)


def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of each key in a document."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield (*path, key)
            yield from leaves(value, (*path, key))
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        for place, value in enumerate(data):
            yield from leaves(value, (*path, place))


def said_without(file: Any, path: Path, leaf: tuple[Any, ...]) -> str:
    """What the reader says of a file without this key; empty if it reads the file."""
    table = shortened = tomllib.loads(path.read_text())
    for part in leaf[:-1]:
        table = table[part]
    del table[leaf[-1]]
    try:
        file.read(keys.Recorder(shortened, path))
    except ZygosError as error:
        return str(error)
    return ""


@pytest.mark.slow
def test_the_pages_say_which_keys_are_required() -> None:
    """Without a key that is required the reader refuses the file; without another it does not ask for it. Of the places
    where the same is stated of a key the first is tried."""
    wrong, tried = [], set()
    for file, path in [(each, path) for each in keys.FILES for path in each.samples]:
        recorded = list(keys.recorded(file.read, path))
        first: dict[tuple[str, ...], tuple[Any, ...]] = {}
        for leaf in leaves(tomllib.loads(path.read_text())):
            first.setdefault(tuple(part for part in leaf if isinstance(part, str)), leaf)
        for (*tables, key), leaf in first.items():
            where = ".".join(tables)
            stated = {keys.default_of(read.entry) for read in recorded if read.table == where and read.entry.key == key}
            if (file.name, where, key, *sorted(stated)) in tried:
                continue
            tried.add((file.name, where, key, *sorted(stated)))
            refusal = said_without(file, path, leaf)
            if where == "parameters":
                right = refusal == ""  # the names in this table are the user's
            elif where == "correlation":
                right = "is missing" not in refusal  # so are those in this one, and their order counts
            elif any(words.startswith("required") for words in stated):
                right = refusal != ""
            else:
                right = f"{key}: is missing" not in refusal
            if not right:
                wrong.append((path.parent.name, file.name, leaf, stated, refusal))
    assert wrong == []
