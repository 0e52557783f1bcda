# SPDX-License-Identifier: MIT
"""The documentation site, and the tutorials as a new user follows them: every command, in an empty folder."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from build_support import tool

from conftest import ROOT

DOCS = ROOT / "docs"
TUTORIALS = sorted(page for page in DOCS.glob("tutorial-*.md") if "```sh\n" in page.read_text(encoding="utf-8"))


def built(source: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """What sphinx-build says of a folder of pages, with warnings as errors."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", source, out]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_site_has_every_page_once_and_a_search(tmp_path: Path) -> None:
    done = built(DOCS, tmp_path)
    assert done.returncode == 0, done.stderr
    pages = {str(path.relative_to(DOCS).with_suffix(".html")) for path in DOCS.rglob("*.md")}
    assert pages <= {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.html")}
    assert (tmp_path / "search.html").is_file() and (tmp_path / "searchindex.js").is_file()
    index = (tmp_path / "README.html").read_text()
    assert [index.index(f">{word}<") for word in ("Tutorials", "How-to", "Reference", "Explanation", "Evidence")]
    assert not re.findall(r'<(?:script|link)[^>]*(?:src|href)="https?://', index), "the site is for reading offline"


@pytest.mark.slow
def test_a_broken_link_ends_the_build(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copytree(ROOT / "include", tmp_path / "include")
    shutil.copy(DOCS / "conf.py", tmp_path / "docs")
    (tmp_path / "docs" / "accuracy.html").write_text("")
    (tmp_path / "docs" / "tasks.md").write_text("# Tasks\n")
    for said, good in (("", True), ("[gone](gone.md)", False), ("[gone](tasks.md#gone)", False)):
        (tmp_path / "docs" / "README.md").write_text(f"# Pages\n\n## How-to\n\n[tasks](tasks.md) {said}\n")
        done = built(tmp_path / "docs", tmp_path / "out")
        assert (done.returncode == 0) == good, done.stderr
        assert good or "gone" in done.stderr


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_as_it_is_written(page: Path, tmp_path: Path) -> None:
    """Its programs are written into the folder and its commands run, in order. The bus is one of the local network."""
    tool("cc")
    text = page.read_text()
    names, programs = re.findall(r"^Write `(.*?)`", text, re.M), re.findall(r"^```c\n(.*?)^```", text, re.M | re.S)
    for name, program in zip(names, programs, strict=True):
        (tmp_path / name).write_text(program)
    script = "".join(re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S))
    script = script.replace("../zygos/", f"{ROOT}/").replace("socketcan -c vcan0", "udp_multicast -c 239.74.163.2")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "-ec", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for said in re.findall(r"It prints `(.*?)`", text):
        assert said in done.stdout
    assert not re.search("^(estimate: )?refused: ", done.stdout, re.M)
