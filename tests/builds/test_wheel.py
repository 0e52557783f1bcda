# SPDX-License-Identifier: MIT
"""A wheel, seen from outside: built from a source distribution, installed into an empty environment, used elsewhere."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from build_support import emulated

import zygos
from conftest import ROOT
from zygos.files.examples import EXAMPLES

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

INPUTS = ("c", "docs", "examples", "harness", "include", "tools", *"LICENSE MANIFEST.in README.md".split())
BUILDERS = ("pyproject.toml", "setup.py")


def outside(command: list[str | Path], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in another folder, without what points this process to the checkout. A build is optimised less."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "MAKE", "PIP_"))}
    return subprocess.run(
        command, cwd=folder, env={**kept, "CFLAGS": "-O1", **environment}, capture_output=True, text=True, check=False
    )


def done(command: list[str | Path], folder: Path, **environment: str) -> str:
    """Standard output of a command that must succeed."""
    ended = outside(command, folder, **environment)
    assert ended.returncode == 0, f"{command}\n{ended.stdout}{ended.stderr}"
    return ended.stdout


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout without anything that was built."""
    folder = tmp_path_factory.mktemp("sources")
    built = shutil.ignore_patterns("_native", "*.egg-info", "__pycache__", "build", "*_cache")
    for name in (*INPUTS, *BUILDERS):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=built)
        else:
            shutil.copy(ROOT / name, folder)
    return folder


@pytest.fixture(scope="module")
def archive(sources: Path) -> Path:
    """The source distribution."""
    code = "from setuptools.build_meta import build_sdist; build_sdist('dist')"
    done([sys.executable, "-c", code], sources)
    (found,) = (sources / "dist").glob("*.tar.gz")
    return found


@pytest.fixture(scope="module")
def wheel(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that pip builds from the source distribution."""
    return built(archive, tmp_path_factory.mktemp("wheel"))


def built(source: Path, folder: Path, **environment: str) -> Path:
    """What `pip wheel` makes of a source distribution or of a checkout, without downloading anything."""
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--no-cache-dir", "--disable-pip-version-check"]
    done([sys.executable, "-m", "pip", "wheel", *options, "-w", folder, source], folder, **environment)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that has the wheel, and nothing else but the libraries that it needs.

    These are taken from the environment of the tests through a .pth file: the .pth file of its own editable install is
    not read by that.
    """
    folder = tmp_path_factory.mktemp("environment")
    done([sys.executable, "-m", "venv", "--without-pip", folder], folder)
    found = folder / "bin" / "python"
    options = ["--no-deps", "--no-index", "--disable-pip-version-check"]
    done([sys.executable, "-m", "pip", "--python", found, "install", *options, wheel], folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return found


@pytest.fixture(scope="module")
def elsewhere(python: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is no checkout, with three examples in it."""
    folder = tmp_path_factory.mktemp("elsewhere")
    where = done([python, "-c", "import zygos; print(zygos.__file__)"], folder).strip()
    assert Path(where).is_relative_to(python.parents[1]), "the package of the wheel is the one that is imported"
    for name in ("paper", "gap", "lively"):
        done([program(python), "example", name], folder)
    return folder


def program(python: Path) -> Path:
    """The `zygos` of an environment."""
    return python.parent / "zygos"


def test_a_source_distribution_holds_what_building_needs_and_nothing_built(archive: Path) -> None:
    with tarfile.open(archive) as files:
        names = {name.partition("/")[2] for name in files.getnames()}
    sources = ("c/flags.txt", "c/loop/zygos.c")
    for wanted in ("pyproject.toml", "setup.py", "MANIFEST.in", "LICENSE", "README.md", *sources):
        assert wanted in names
    assert {"include/zygos/zygos.h", "tools/build_native.py", "examples/gap/demo/a.blf"} <= names
    ours = {str(path.relative_to(ROOT)) for path in (ROOT / "harness").rglob("*.py") if "_native" not in path.parts}
    assert ours <= names
    assert not [name for name in names if re.search(r"/_native/|\.so$|\.pyc$|\.o$|\.venv|^tests|^build", name)]


def test_a_wheel_holds_the_package_with_library_pages_and_examples(wheel: Path) -> None:
    assert re.fullmatch(r"zygos-[\d.]+-py3-none-\w+\.whl", wheel.name)
    names = {re.sub(r"^[^/]*\.data/\w+/", "", name) for name in zipfile.ZipFile(wheel).namelist()}
    wanted = {f"zygos/{path.relative_to(ROOT / 'harness' / 'zygos')}" for path in (ROOT / "harness").rglob("*.html")}
    wanted |= {
        f"zygos/_native/{name}" for name in ("libzygos.so", "declarations.py", "zygos.dbc", "zygos-coarse-gyro.dbc")
    }
    for example in EXAMPLES:
        tracked = [path for path in (ROOT / "examples" / example).rglob("*") if path.is_file()]
        wanted |= {f"zygos/_examples/{path.relative_to(ROOT / 'examples')}" for path in tracked}
    assert wanted <= names
    assert {name.split("/")[2] for name in names if name.startswith("zygos/_examples/")} == set(EXAMPLES)
    assert "zygos/py.typed" in names


def test_a_wheel_of_a_checkout_is_the_same_and_leaves_the_sources_alone(
    wheel: Path, sources: Path, tmp_path: Path
) -> None:
    """Also where a module was deleted since the wheel before: pip builds in the checkout."""
    stale = sources / "build" / "lib" / "zygos" / "forgotten.py"
    stale.parent.mkdir(parents=True)
    stale.touch()
    again = built(sources, tmp_path)
    first, second = ({name for name in zipfile.ZipFile(path).namelist()} for path in (wheel, again))
    assert first == second
    assert not (sources / "harness" / "zygos" / "_native").exists()


def test_the_list_of_examples(python: Path, elsewhere: Path) -> None:
    listed = done([program(python), "example"], elsewhere)
    assert [line.split()[0] for line in listed.splitlines()] == list(EXAMPLES)


def test_an_example_is_written(python: Path, elsewhere: Path) -> None:
    said = done([program(python), "example", "spatial", "-o", "new/mine"], elsewhere).splitlines()
    assert said[-1] == "new/mine: 3 files"
    for line in said[:-1]:
        assert (elsewhere / line).read_bytes() == (ROOT / "examples" / "spatial" / Path(line).name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["papier"], f"there is no example 'papier'; remedy: one of {', '.join(EXAMPLES)}"),
        (["../paper"], "there is no example '../paper'; remedy: one of"),
        (["paper"], "paper: exists; remedy: remove it, or name another folder"),
        (["spatial", "-o", "paper/arm.toml"], "paper/arm.toml: exists; remedy:"),
        (["spatial", "-o", "paper/arm.toml/x"], "paper/arm.toml/x: cannot be written"),
        (["-o", "somewhere"], "which example is to be written?; remedy: one of"),
    ],
)
def test_an_example_is_refused(arguments: list[str | Path], said: str, python: Path, elsewhere: Path) -> None:
    before = sorted(elsewhere.rglob("*"))
    ended = outside([program(python), "example", *arguments], elsewhere)
    assert ended.returncode == 2
    assert said in ended.stderr and "Traceback" not in ended.stderr
    assert sorted(elsewhere.rglob("*")) == before


def test_simulate_estimate_and_check(python: Path, elsewhere: Path) -> None:
    done([program(python), "simulate", "lively/scenario.toml", "-o", "out/run.blf"], elsewhere)
    done([program(python), "estimate", "out/run.blf", "-o", "out/model.toml", "--json", "out/model.json"], elsewhere)
    assert json.loads((elsewhere / "out" / "model.json").read_text())["validity"] == "valid"
    learned = tomllib.loads((elsewhere / "out" / "model.toml").read_text())["parameters"]
    assert learned["k2"]["value"] == pytest.approx(1000.0, rel=0.01)
    assert "differs" not in done([program(python), "self-test", "out/run.blf"], elsewhere)


def test_the_paper(python: Path, elsewhere: Path) -> None:
    said = done([program(python), "paper", "--seeds", "2", "--json", "out/paper.json"], elsewhere)
    assert "Table III" in said and "Table IV" in said
    assert json.loads((elsewhere / "out" / "paper.json").read_text())["arm"] == "paper"


def test_a_gap_is_explained(python: Path, elsewhere: Path) -> None:
    arguments = "gap/demo/a.blf --simulation gap/cad.toml --validate gap/demo/c.blf"
    arguments += " --arm gap/arm.toml -o out/new.toml --report out/gap.html --json out/gap.json"
    done([program(python), "explain", *arguments.split()], elsewhere)
    found = json.loads((elsewhere / "out" / "gap.json").read_text())
    hidden = json.loads((elsewhere / "gap" / "demo" / "sealed.json").read_text())
    assert [(f["effect"], f["joint"]) for f in found["findings"]] == [(hidden["hidden"], hidden["where"])]
    assert "<script" in (elsewhere / "out" / "gap.html").read_text()


def test_the_python_interface(python: Path, elsewhere: Path) -> None:
    code = """
import zygos
folder = zygos.example("lively")
arm, model = zygos.load_arm(folder / "arm.toml"), zygos.load_model(folder / "model.toml")
run = zygos.simulate(arm, model, zygos.load_scenario(folder / "scenario.toml"), seed=5, duration_s=30.0)
found = zygos.estimate(run)
print(folder, found.validity, zygos.check(run).equal, zygos.check_arm(run).ok, zygos.__version__)
"""
    folder, *said, version = done([python, "-c", code], elsewhere).split()
    assert Path(folder).is_relative_to(python.parents[1])
    assert said == ["valid", "True", "True"]
    assert version == zygos.__version__


CALLS = """
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
int main(int count, char **names)
{
    void *library = dlopen(names[count - 1], RTLD_NOW);
    if (library == NULL) { (void)puts(dlerror()); return 1; }
    uint32_t (*digest)(void) = (uint32_t (*)(void))dlsym(library, "zygos_declarations_digest");
    (void)printf("%u\\n", (unsigned)digest());
    return 0;
}
"""


def test_a_wheel_for_aarch64(archive: Path, tmp_path: Path) -> None:
    """Built across, as docs/python.md says; the library is loaded by the emulator, and fits the declarations beside it.

    There is no Python for aarch64 here, so that nothing else of the wheel runs.
    """
    emulator = emulated()
    made = built(archive, tmp_path, CC="aarch64-linux-gnu-gcc", _PYTHON_HOST_PLATFORM="linux-aarch64")
    assert made.name.endswith("-py3-none-linux_aarch64.whl")
    with zipfile.ZipFile(made) as content:
        content.extractall(tmp_path / "installed")
    (native,) = (path.parent for path in (tmp_path / "installed").rglob("libzygos.so"))
    assert (native / "libzygos.so").read_bytes()[18:20] == b"\xb7\x00", "EM_AARCH64"
    (tmp_path / "calls.c").write_text(CALLS)
    done(["aarch64-linux-gnu-gcc", "calls.c", "-o", "calls", "-ldl"], tmp_path)
    said = done([*emulator, tmp_path / "calls", native / "libzygos.so"], tmp_path)
    assert f"DIGEST = {said.strip()}\n" in (native / "declarations.py").read_text()
