# SPDX-License-Identifier: MIT
"""What a release holds: the licence in each source file."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
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
