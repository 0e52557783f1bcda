# SPDX-License-Identifier: MIT
"""Writes a release of the newest commit: source distribution, wheel, C sources, software bill of materials, checksums.

Usage: dist.py FOLDER. Two runs on one machine give equal bytes: all is built in a fresh copy of the commit, its path is
taken out of what the compiler writes, and archives have sorted names and the time of the commit.
"""

import gzip
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import uuid
import zipfile
from collections.abc import Iterable
from importlib.metadata import requires
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
C_SOURCES = (
    "amalgamation/zygos.c",
    "c/*/*.c",
    "c/flags.txt",
    "include/**/*.h",
    "include/**/*.dbc",
    "tools/package/*.in",
    "CMakeLists.txt",
    "LICENSE",
)
"""What the C library is built from by CMake, or by a compiler alone: its sources, and the same as one file."""


def git(*words: str) -> bytes:
    """What git answers in this repository."""
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, check=True).stdout


def write_tar(path: Path, prefix: str, files: Iterable[tuple[str, bytes, int]], at: int) -> None:
    """Write a .tar.gz of names, contents and modes, all of one time."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name, content, mode in sorted(files):
            entry = tarfile.TarInfo(f"{prefix}/{name}")
            entry.size, entry.mtime, entry.mode = len(content), at, 0o755 if mode & 0o100 else 0o644
            tar.addfile(entry, io.BytesIO(content))
    path.write_bytes(gzip.compress(packed.getvalue(), 9, mtime=0))


def sorted_tar(path: Path, at: int) -> None:
    """Write a .tar.gz again, in order and of one time."""
    with tarfile.open(path) as tar:
        held = [(one, tar.extractfile(one)) for one in tar.getmembers()]
        files = [(one.name.partition("/")[2], content.read(), one.mode) for one, content in held if content is not None]
    write_tar(path, path.name.removesuffix(".tar.gz"), files, at)


def sorted_zip(path: Path, at: int) -> None:
    """Write a .whl again, in order and of one time."""
    stamp = time.gmtime(at)[:6]
    with zipfile.ZipFile(path) as archive:
        files = {one.filename: (archive.read(one), one.external_attr) for one in archive.infolist() if not one.is_dir()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, (content, mode) in sorted(files.items()):
            entry = zipfile.ZipInfo(name, stamp)
            entry.external_attr, entry.compress_type = mode, zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)


def required(names: Iterable[str]) -> dict[str, set[str]]:
    """The packages that these need at run time, however deep, each with those that it needs."""
    found: dict[str, set[str]] = {}
    pending = list(names)
    while pending:
        name = pending.pop()
        if name in found:
            continue
        wanted = (Requirement(text) for text in requires(name) or ())
        found[name] = {normal(one.name) for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})}
        pending += found[name]
    return found


def normal(name: str) -> str:
    """A name as package indices compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def bill(sources: Path, version: str, at: int, commit: str) -> str:
    """The software bill of materials in the form of CycloneDX 1.5: the package of these sources, and what it needs at
    run time in the versions of their constraints.txt."""
    lines = (sources / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {normal(name): number for name, _, number in (line.partition("==") for line in lines) if number}
    project = tomllib.loads((sources / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    direct = {normal(Requirement(text).name) for text in project["dependencies"]}
    found = required(direct)
    reference = {name: f"pkg:pypi/{name}@{pinned[name]}" for name in found}
    own = f"pkg:pypi/zygos@{version}"
    mit = [{"license": {"id": "MIT"}}]
    content = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, f'{own}#{commit}')}",
        "version": 1,
        "metadata": {
            "timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(at)),
            "component": {"type": "library", "bom-ref": own, "name": "zygos", "version": version, "purl": own,
                          "licenses": mit},
        },
        "components": [
            {"type": "library", "bom-ref": reference[name], "name": name, "version": pinned[name],
             "purl": reference[name], "scope": "required"}
            for name in sorted(found)
        ],
        "dependencies": [
            {"ref": own, "dependsOn": sorted(reference[name] for name in direct)},
            *({"ref": reference[name], "dependsOn": sorted(reference[one] for one in found[name])}
              for name in sorted(found)),
        ],
    }  # fmt: skip
    return json.dumps(content, indent=1) + "\n"


def build(sources: Path, out: Path, at: int) -> None:
    """Source distribution and wheel, by setuptools, without downloading anything."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "MAKE", "PIP_"))}
    flags = f"{os.environ.get('CFLAGS', '')} -ffile-prefix-map={sources}=zygos".strip()
    code = f"from setuptools import build_meta as b; b.build_sdist({str(out)!r}); b.build_wheel({str(out)!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=sources, env={**kept, "SOURCE_DATE_EPOCH": str(at), "CFLAGS": flags},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        sys.exit(done.stdout + done.stderr)


def main(folder: Path) -> None:
    """Write the files of a release into the folder, which is emptied first."""
    at, commit = int(git("log", "-1", "--format=%ct")), git("rev-parse", "HEAD").decode().strip()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as place:
        sources = Path(place) / "zygos"
        with tarfile.open(fileobj=io.BytesIO(git("archive", "HEAD"))) as tar:
            tar.extractall(sources, filter="data")
        build(sources, folder, at)
        (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
        sorted_tar(sdist, at)
        sorted_zip(wheel, at)
        version = sdist.name.removeprefix("zygos-").removesuffix(".tar.gz")
        subprocess.run([sys.executable, sources / "tools" / "amalgamate.py", sources / "amalgamation"], check=True)
        names = sorted({path for pattern in C_SOURCES for path in sources.glob(pattern)})
        held = [(str(path.relative_to(sources)), path.read_bytes(), path.stat().st_mode) for path in names]
        write_tar(folder / f"zygos-c-{version}.tar.gz", f"zygos-c-{version}", held, at)
        (folder / f"zygos-{version}.cdx.json").write_text(bill(sources, version, at, commit), encoding="utf-8")
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in sorted(folder.iterdir())]
    (folder / "SHA256SUMS").write_text("\n".join(sums) + "\n", encoding="ascii")
    print("\n".join(sums))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
