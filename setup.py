# SPDX-License-Identifier: MIT
"""Builds the C library into the package, one shared object and its declarations, loaded through cffi in ABI mode; and
puts the examples beside it.

No Python.h is needed, and one wheel serves every Python 3.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
PACKAGED = ("paper", "lively", "spatial", "seven", "gap", "telemetry", "pendulum", "notebook", "urdf")
"""The folders of examples/ that a wheel has: those of `zygos example` (harness/zygos/files/examples.py)."""


def version() -> str:
    """That of the C library: include/zygos/types.h has the only one that is written by hand."""
    text = (ROOT / "include" / "zygos" / "types.h").read_text(encoding="utf-8")
    return ".".join(re.findall(r"^#define ZYGOS_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)$", text, re.M))


class BuildWithLibrary(build_py):
    """Compiles the library and collects the examples with the package."""

    def run(self) -> None:
        """Collect the package, and run tools/build_native.py into it; in an editable install, into the sources.

        An editable install finds the examples where they are. A wheel is built in an empty folder: modules that were
        deleted must not come back from the build before.
        """
        package = ROOT / "harness" / "zygos" if self.editable_mode else Path(self.build_lib) / "zygos"
        if not self.editable_mode:
            shutil.rmtree(package, ignore_errors=True)
        super().run()
        script = ROOT / "tools" / "build_native.py"
        subprocess.run([sys.executable, str(script), str(package / "_native")], check=True)
        if not self.editable_mode:
            for name in PACKAGED:
                shutil.copytree(ROOT / "examples" / name, package / "_examples" / name)


class PlatformWheel(bdist_wheel):
    """A wheel for this platform and any Python 3: the shared object does not know Python."""

    def finalize_options(self) -> None:
        """Mark the wheel as not pure."""
        super().finalize_options()
        self.root_is_pure = False

    def get_tag(self) -> tuple[str, str, str]:
        """Return py3-none-PLATFORM."""
        return "py3", "none", super().get_tag()[2]


setup(version=version(), cmdclass={"build_py": BuildWithLibrary, "bdist_wheel": PlatformWheel})
