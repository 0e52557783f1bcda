# SPDX-License-Identifier: MIT
"""Compiles the C library and a program as firmware for a Cortex-M, and says how to run it under QEMU.

Usage: build_firmware.py m7|m4f ELF SOURCE... [-DNAME=VALUE ...] [-O... -f... -I...]

SOURCE holds main() and what it needs beside the library and the port (core.h, semihosting.h, uart.h, slcan.h in
c/ports/cortex-m, telemetry.h).
m7 has a hardware double, m4f a soft one. Options go to the compiler behind the house flags.
"""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from build_native import FLAGS, ROOT

PORT = ROOT / "c" / "ports" / "cortex-m"
TELEMETRY = ROOT / "c" / "ports" / "telemetry"
ROOMS = [
    *sorted((ROOT / "c").glob("*/*.c")),
    *(PORT / f"{noun}.c" for noun in ("core", "semihosting", "slcan", "uart")),
    TELEMETRY / "telemetry.c",
]
"""The flight library and what firmware may need. Sections that nobody calls are left out of the image."""
HOUSE = [flag for flag in FLAGS.split() if flag != "-fPIC"]
INCLUDES = ["-I", str(ROOT / "include"), "-I", str(PORT), "-I", str(TELEMETRY)]
LINK = "-nostartfiles -ffunction-sections -fdata-sections -Wl,--gc-sections -Wl,--fatal-warnings"


@dataclass(frozen=True)
class Target:
    """A processor, and a machine of QEMU's that has it."""

    machine: str
    """Name for ``qemu-system-arm -M``, and of the linker script."""
    flags: tuple[str, ...]
    soft: bool
    """No double in hardware."""


TARGETS = {
    "m7": Target("mps2-an500", ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"), soft=False),
    "m4f": Target("mps2-an386", ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"), soft=True),
}
ADDITION = ("__aeabi_dadd", "__aeabi_dsub", "__aeabi_drsub")
"""Functions of libgcc before which the port's own stand where double is soft (c/ports/cortex-m/addition.c)."""
TOOLS = ("arm-none-eabi-gcc", "qemu-system-arm")
"""What a build and a run need,"""
PACKAGES = "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
"""and where Debian has it."""


def missing() -> list[str]:
    """Those of the tools that are not installed."""
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def compiler(target: str) -> list[str]:
    """Compiler and flags for the sources of a target."""
    return ["arm-none-eabi-gcc", *TARGETS[target].flags, "-ffreestanding", *HOUSE, "-Werror", *INCLUDES]


def build(target: str, elf: Path, sources: Sequence[Path], flags: Sequence[str] = (), board: str = "") -> Path:
    """Write an image for m7 or m4f. Returns elf. Errors: CalledProcessError, the compiler's text on stderr.

    board: another linker script of the port than that of the machine.
    """
    elf.parent.mkdir(parents=True, exist_ok=True)
    soft = TARGETS[target].soft
    rooms = [*ROOMS, *([PORT / "addition.c"] if soft else [])]
    link = [*LINK.split(), f"-L{PORT}", f"-Wl,-T,{board or TARGETS[target].machine}.ld", "-lm"]
    link += [f"-Wl,--wrap={name}" for name in ADDITION if soft]
    command = [*compiler(target), *flags, *map(str, [*rooms, *sources]), *link, "-o", str(elf)]
    subprocess.run(command, check=True)
    return elf


def run(target: str, elf: Path) -> list[str]:
    """The command that runs an image until it exits, with main()'s status; its files are those of the working folder.

    Options of QEMU may follow, for instance -serial or -plugin.
    """
    hosted = "-semihosting-config enable=on,target=native -display none -monitor none".split()
    return ["qemu-system-arm", "-M", TARGETS[target].machine, *hosted, "-kernel", str(elf)]


if __name__ == "__main__":
    if len(sys.argv) < 4 or sys.argv[1] not in TARGETS:
        sys.exit(__doc__)
    rest = sys.argv[3:]
    chosen, options = [Path(x) for x in rest if not x.startswith("-")], [x for x in rest if x.startswith("-")]
    build(sys.argv[1], Path(sys.argv[2]), chosen, options)
    print(" ".join(run(sys.argv[1], Path(sys.argv[2]))))
