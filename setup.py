"""Builds the C library into the package: one shared object and its declarations, loaded through cffi in ABI mode.

No Python.h is needed, and one wheel serves every Python 3.
"""

import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent


class BuildWithLibrary(build_py):
    """Compiles the library before the package is collected."""

    def run(self) -> None:
        """Run tools/build_native.py into the source package, then collect."""
        script = ROOT / "tools" / "build_native.py"
        subprocess.run([sys.executable, str(script), str(ROOT / "harness" / "zygos" / "_native")], check=True)
        super().run()


class PlatformWheel(bdist_wheel):
    """A wheel for this platform and any Python 3: the shared object does not know Python."""

    def finalize_options(self) -> None:
        """Mark the wheel as not pure."""
        super().finalize_options()
        self.root_is_pure = False

    def get_tag(self) -> tuple[str, str, str]:
        """Return py3-none-PLATFORM."""
        return "py3", "none", super().get_tag()[2]


setup(cmdclass={"build_py": BuildWithLibrary, "bdist_wheel": PlatformWheel})
