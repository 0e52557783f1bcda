# SPDX-License-Identifier: MIT
"""The library as one file: it compiles without a warning, and every bit of an estimate is that of the many files."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import pytest
from build_support import ROOMS, run, tool
from golden_support import CONFIGURATIONS, EXPECTED, bits, flown

from conftest import tool_module
from zygos.native.flight import ffi


def test_no_name_is_in_two_files() -> None:
    """Functions and types that a file keeps for itself."""
    own = re.compile(r"^static [^;={]*?\b(\w+)\(|^\} (\w+);|^typedef .*?\b(\w+);", re.M)
    found = Counter(
        name for room in ROOMS for name in {next(filter(None, names)) for names in own.findall(room.read_text())}
    )
    assert len(found) > 500
    assert [name for name, files in found.items() if files > 1] == []


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_one_file_gives_the_same_bits(compiler: str, tmp_path: Path) -> None:
    tool_module("amalgamate").main(tmp_path)
    build = tool_module("build_native")
    flags = [*build.FLAGS.split(), "-O1", "-Werror", f"-I{tmp_path}", f"-I{build.HOST}", "-shared"]
    sources = [str(tmp_path / "zygos.c"), str(build.HOST / "batch.c")]
    run([tool(compiler), *flags, *sources, "-lm", "-o", str(tmp_path / "libzygos.so")], tmp_path)
    library = ffi.dlopen(str(tmp_path / "libzygos.so"))
    expected = json.loads(EXPECTED.read_text())
    for name in CONFIGURATIONS:
        assert [bits(estimate) for estimate in flown(name, library)] == expected[name], name
