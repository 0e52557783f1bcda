# SPDX-License-Identifier: MIT
"""Runs a command once for each of two sets of BLAS and numpy kernels that this processor has besides its own choice.

    python tools/with_kernels.py COMMAND [ARGUMENT ...]

OpenBLAS and numpy choose their kernels by the processor, and each rounds in its own way. The oldest set runs on every
x86-64; the one for AVX-512, where the processor has it, else the one for AVX2. Ends with the command's first failure.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

SHOWN = """
import numpy as np
from threadpoolctl import threadpool_info
np.ones((2, 2)) @ np.ones((2, 2))
print(*sorted({pool["architecture"] for pool in threadpool_info() if pool["internal_api"] == "openblas"}))
"""


@dataclass(frozen=True)
class Kernels:
    """A set that the environment selects."""

    blas: str
    """As OPENBLAS_CORETYPE has it."""
    without: tuple[str, ...]
    """Processor features that numpy does without."""

    def environment(self) -> dict[str, str]:
        """Variables that select it."""
        chosen = {"OPENBLAS_CORETYPE": self.blas, "OPENBLAS_NUM_THREADS": "1"}
        if self.without:
            chosen["NPY_DISABLE_CPU_FEATURES"] = " ".join(self.without)
        return {**os.environ, **chosen}


def sets(found: tuple[str, ...]) -> tuple[Kernels, Kernels]:
    """The two sets of a processor for which numpy dispatches the features `found`."""
    wide = any("AVX512" in name or name == "X86_V4" for name in found)
    return Kernels("Nehalem", found), Kernels("SkylakeX" if wide else "Haswell", ())


def main() -> int:
    """Run the command under both."""
    found = tuple(np.show_config(mode="dicts")["SIMD Extensions"]["found"])
    for kernels in sets(found):
        environment = kernels.environment()
        shown = subprocess.run(
            [sys.executable, "-c", SHOWN], env=environment, capture_output=True, text=True, check=True
        )
        print(
            f"== OpenBLAS kernels {shown.stdout.strip()}, numpy without {' '.join(kernels.without) or 'nothing'}",
            flush=True,
        )
        if shown.stdout.strip() != kernels.blas:
            print(
                f"OpenBLAS did not take its kernels for {kernels.blas}; remedy: numpy from PyPI, which brings OpenBLAS"
            )
            return 1
        code = subprocess.run(sys.argv[1:], env=environment, check=False).returncode
        if code != 0:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
