# SPDX-License-Identifier: MIT
"""Instructions on a Cortex-M, counted by a plugin of QEMU's: what it executes, exactly and repeatably. No cycles: QEMU
does not know the processor's pipeline.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.counting import DRIVER, ENTRIES, FOLDED, MARKS, STAGES, TOPS, Count, Tally, joined
from conftest import ROOT, tool_module
from zygos.errors import ZygosError

firmware = tool_module("build_firmware")
PLUGIN = DRIVER.with_name("plugin.c")
_TOP, _RUNTIME, _OUTSIDE = -1, -2, -3
"""As enum room of bench/plugin.c."""


def build(target: str, folder: Path, capacities: tuple[str, ...]) -> Path:
    """Compile library and driver as firmware for m7 or m4f. Returns the image."""
    elf: Path = firmware.build(target, folder / "driver.elf", [DRIVER], capacities)
    return elf


def count(target: str, folder: Path) -> Count:
    """Run folder/driver.elf on folder/run.bin and count. Errors: ZygosError without QEMU, or what the program says."""
    names = write_symbols(folder / "driver.elf", folder / "symbols.txt")
    parts = run(target, folder / "driver.elf", folder).reshape(-1, len(STAGES) + len(names))
    cycles, last = parts[:-1:MARKS], parts[-1]
    ran = {name: cycles[:, len(STAGES) + k] for k, name in enumerate(names) if cycles[:, len(STAGES) + k].any()}
    tally = Tally(cycles[:, : len(STAGES)], ran, int(last[STAGES.index("solve")]))
    return joined(tally, folder, "QEMU")


def run(target: str, elf: Path, folder: Path) -> NDArray[np.int64]:
    """Run an image in a folder that has symbols.txt. Returns all that the plugin wrote. Errors: as `count`."""
    if firmware.missing():
        raise ZygosError(f"not installed: {', '.join(firmware.missing())}; remedy: apt install {firmware.PACKAGES}")
    plugin = folder / "plugin.so"
    subprocess.run(["gcc", "-std=c11", "-O2", "-shared", "-fPIC", str(PLUGIN), "-o", str(plugin)], check=True)
    arguments = f"{plugin.resolve()},symbols=symbols.txt,out=parts.bin"
    command = [*firmware.run(target, elf.resolve()), "-plugin", arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"{elf.name} failed under QEMU: {(done.stdout + done.stderr).strip()}; remedy: see there")
    parts = np.fromfile(folder / "parts.bin", dtype="<i8").astype(np.int64)
    (folder / "parts.bin").unlink()
    return parts


def write_symbols(elf: Path, path: Path) -> list[str]:
    """Write what bench/plugin.c reads. Returns the names of the functions, with their rooms."""
    listing = subprocess.run(
        ["arm-none-eabi-nm", "-n", "-l", "--defined-only", str(elf)], capture_output=True, text=True, check=True
    ).stdout
    found: dict[int, tuple[str, str]] = {}
    phases = {entry: STAGES.index(stage) for stage, entry in ENTRIES.items()}
    phases["zygos_refine_step"] = phases["zygos_step"]  # in bench/refine.c, which has no loop
    for address, name, file in re.findall(r"^([0-9a-f]+) [TtWw] (\S+)(?:\t(.*):\d+)?$", listing, re.M):
        found.setdefault(int(address, 16), (name, file))
    ends = [*list(found)[1:], max(found) + 0x10000]
    lines, names = [f"{len(STAGES)} {STAGES.index('cycle')} {STAGES.index('wire')}"], []
    for (address, (name, file)), end in zip(found.items(), ends, strict=True):
        room = _room(file)
        lines.append(f"{address:x} {end - address} {room} {phases.get(name, -1)} {int(name == 'driver_mark')}")
        names.append(f"{Path(file).stem or '???'}: {name}")
    path.write_text("\n".join(lines) + "\n")
    return names


def _room(file: str) -> int:
    """What the instructions of a file's functions are booked on, as bench/plugin.c wants it."""
    path = Path(file)
    if path.parent.parent == ROOT / "c":
        room = FOLDED.get(path.stem, path.stem)
        return _TOP if room in TOPS else STAGES.index(room) if room in STAGES else _RUNTIME
    # the port's soft double is the compiler's runtime, too
    return _OUTSIDE if path.is_relative_to(ROOT) and path.stem != "addition" else _RUNTIME
