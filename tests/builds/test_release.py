# SPDX-License-Identifier: MIT
"""What a release holds: the licence in each source file, one version, and archives that are the same each time."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from build_support import run, tool

from conftest import ROOT

FOLDERS = ("c", "examples", "harness", "include", "tests", "tools")
SOURCES = (".py", ".c", ".h", ".cpp")
BUILT = {"build", "_native", "__pycache__", "arm_config.h"}
"""Folders and files that a program writes."""


def without_licence(root: Path) -> list[str]:
    """Source files below the folders of the repository that do not say their licence in one of the first two lines."""
    return [
        str(path.relative_to(root))
        for folder in FOLDERS
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in SOURCES
        and not BUILT & set(path.relative_to(root).parts)
        and not any("SPDX-License-Identifier: MIT" in line for line in path.read_text().splitlines()[:2])
    ]


def test_each_source_file_says_its_licence(tmp_path: Path) -> None:
    assert without_licence(ROOT) == []
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "new.c").write_text("int zygos_new;\n")
    assert without_licence(tmp_path) == ["c/new.c"]


def test_library_package_changelog_and_citation_have_one_version() -> None:
    """The one of the C library is written by hand; the package takes it from there."""
    header = (ROOT / "include/zygos/types.h").read_text()
    version = ".".join(re.findall(r"#define ZYGOS_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", header))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["dynamic"] == ["version"] and "version" not in project
    released = re.findall(r"^## \[(\d.*?)\] - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert released[0][0] == version
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {version}\ndate-released: {released[0][1]}\n" in citation


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_releases_are_equal_and_hold_what_they_should(tmp_path: Path) -> None:
    """Made from the newest commit, in folders of different names; the C sources build by CMake."""
    first, second = tmp_path / "first", tmp_path / "another name"
    for folder in (first, second):
        command = [sys.executable, ROOT / "tools" / "dist.py", folder]
        subprocess.run(command, env={**os.environ, "CFLAGS": "-O0"}, check=True, capture_output=True)
    made = {path.name: path.read_bytes() for path in first.iterdir()}
    assert made == {path.name: path.read_bytes() for path in second.iterdir()}
    sums = dict(reversed(line.split("  ")) for line in made.pop("SHA256SUMS").decode().splitlines())
    assert sums == {name: hashlib.sha256(content).hexdigest() for name, content in made.items()}

    (sdist,) = (name for name in made if re.fullmatch(r"zygos-[\d.]+\.tar\.gz", name))
    version = sdist.removeprefix("zygos-").removesuffix(".tar.gz")
    assert set(made) == {sdist, f"zygos-c-{version}.tar.gz", f"zygos-{version}.cdx.json",
                         *(name for name in made if name.endswith(".whl"))}  # fmt: skip
    (wheel,) = first.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert any(name.endswith("zygos/_native/libzygos.so") for name in names) and any(
        name.endswith("licenses/LICENSE") for name in names
    )
    bill = json.loads(made[f"zygos-{version}.cdx.json"])
    held = {one["name"]: one["version"] for one in bill["components"]}
    assert (bill["bomFormat"], bill["metadata"]["component"]["version"]) == ("CycloneDX", version)
    assert {"numpy", "scipy", "python-can", "pycparser"} <= set(held) and "pytest" not in held
    assert f"numpy=={held['numpy']}" in (ROOT / "constraints.txt").read_text()
    referred = {one["bom-ref"] for one in bill["components"]}
    assert all(set(one["dependsOn"]) <= referred for one in bill["dependencies"])

    with tarfile.open(first / f"zygos-c-{version}.tar.gz") as tar:
        tar.extractall(tmp_path, filter="data")
    tree = tmp_path / f"zygos-c-{version}"
    assert sorted(path.name for path in tree.iterdir()) == [
        "CMakeLists.txt",
        "LICENSE",
        "amalgamation",
        "c",
        "include",
        "tools",
    ]
    run([tool("cmake"), "-S", str(tree), "-B", "b", "-DCMAKE_C_FLAGS=-O0"], tmp_path)
    run([tool("cmake"), "--build", "b"], tmp_path)
    run([tool("cmake"), "--install", "b", "--prefix", "p"], tmp_path)
    assert (tmp_path / "p" / "lib" / "libzygos.a").is_file()
