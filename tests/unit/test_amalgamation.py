# SPDX-License-Identifier: MIT
"""The library as one file: it compiles without a warning, and every bit of an estimate is that of the many files."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from build_support import tool

from conftest import tool_module


def golden() -> ModuleType:
    """The runs of test_golden.py, as a module of its own, of which the library can be another one."""
    path = Path(__file__).with_name("test_golden.py")
    spec = importlib.util.spec_from_file_location("golden_of_one_file", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_one_file_gives_the_same_bits(compiler: str, tmp_path: Path) -> None:
    tool_module("amalgamate").main(tmp_path)
    build = tool_module("build_native")
    flags = [*build.FLAGS.split(), "-O1", "-Werror", f"-I{tmp_path}", f"-I{build.HOST}", "-shared"]
    sources = [str(tmp_path / "zygos.c"), str(build.HOST / "batch.c")]
    subprocess.run([tool(compiler), *flags, *sources, "-lm", "-o", str(tmp_path / "libzygos.so")], check=True)
    runs = golden()
    runs.lib = runs.ffi.dlopen(str(tmp_path / "libzygos.so"))
    expected = json.loads((runs.GOLDEN / "estimates.json").read_text())
    for name in runs.CONFIGURATIONS:
        assert [runs.bits(estimate) for estimate in runs.flown(name)] == expected[name], name
