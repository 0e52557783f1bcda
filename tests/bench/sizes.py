"""Write the bytes of the three structs into docs/integrate.md, and their sums into README.md and docs/cost.md.

PYTHONPATH=tests:tests/support python -m bench.sizes
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from conftest import ROOT
from zygos.files.output import write_text

ROW = re.compile(r"^(\| (\d) \| (\d) \| (\d+) \|).*$", re.M)
"""A row of the manual's table: joints, whether spatial, blocks."""


def sizes(joints: str, spatial: str, blocks: str) -> dict[str, int]:
    """Bytes of zygos_t, zygos_work_t and zygos_estimate_t at these capacities, by the compiler of this machine."""
    flags = [f"-DZYGOS_MAX_JOINTS={joints}", f"-DZYGOS_SPATIAL={spatial}", f"-DZYGOS_MAX_BLOCKS={blocks}"]
    source = '#include "zygos/zygos.h"\nchar arm[sizeof(zygos_t)], work[sizeof(zygos_work_t)], '
    source += "estimate[sizeof(zygos_estimate_t)];\n"
    with TemporaryDirectory() as folder:
        out = str(Path(folder, "sizes.o"))
        command = ["cc", "-std=c11", *flags, "-I", str(ROOT / "include"), "-x", "c", "-c", "-o", out, "-"]
        subprocess.run(command, input=source, text=True, check=True)
        listed = subprocess.run(["nm", "-S", "-t", "d", out], capture_output=True, text=True, check=True).stdout
    return {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B (\w+)$", listed, re.M)}


def main() -> None:
    """Measure every row that the manual has."""

    def row(found: re.Match[str]) -> str:
        size = sizes(found[2], found[3], found[4])
        cells = (size["arm"], size["work"], size["estimate"], sum(size.values()))
        return f"{found[1]} {' | '.join(f'{cell:,}' for cell in cells)} |"

    manual, readme, cost = ROOT / "docs" / "integrate.md", ROOT / "README.md", ROOT / "docs" / "cost.md"
    write_text(manual, ROW.sub(row, manual.read_text()))
    small, large = (sum(sizes(*capacities).values()) for capacities in (("2", "0", "64"), ("7", "1", "64")))
    text = re.sub(r"take \d+ kB at -DZYGOS", f"take {small / 1000:.0f} kB at -DZYGOS", readme.read_text())
    write_text(readme, re.sub(r"(estimate, take) [\d.]+ MB", rf"\1 {large / 1e6:.1f} MB", text))
    write_text(cost, re.sub(r"(joints take) [\d.]+ MB", rf"\1 {large / 1e6:.1f} MB", cost.read_text()))


if __name__ == "__main__":
    main()
