# SPDX-License-Identifier: MIT
"""Frames in an interrupt, at any instruction of the task that works off cycles, give the bits of frames in order.

QEMU counts instructions as its clock here, so that a timer interrupts where it is told to, and each run is the same.
"""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from build_support import capacities
from numpy.typing import NDArray

from pil.conftest import Agree
from pil.live_support import compiled_in
from pil.pil_support import (
    END,
    LIMIT_S,
    PAPER,
    TARGETS,
    Record,
    build_firmware,
    compare,
    firmware,
    frames_section,
    on_host,
    recorded,
)
from zygos.arm import Arm
from zygos.native import flight
from zygos.native.flight import Flight, encode

CLOCK = ["-icount", "shift=5,sleep=off"]
"""32 ns an instruction; a tick of SysTick is 40 ns."""
BETWEEN = {"m7": (100, 1_400), "m4f": (1_000, 16_000)}
"""Ticks between two frames, at the least and at the most: the task falls behind, and hardly a frame finds it idle."""


def stormed(
    folder: Path, target: str, arm: Arm, frames: NDArray[Any], drills: tuple[str, ...] = ()
) -> tuple[Record, int]:
    """zygos_arm_t behind frames that came in interrupts, and how many came while a cycle was worked off."""
    elf = firmware(target, "storm", PAPER, compiled_in(folder, Flight(arm)), drills)
    (folder / "storm.bin").write_bytes(struct.pack("<3I", len(frames), *BETWEEN[target]) + frames.tobytes())
    subprocess.run([*build_firmware.run(target, elf), *CLOCK], cwd=folder, check=True, timeout=LIMIT_S)
    out = (folder / "storm.out").read_bytes()
    return Record("image", out[:-4]), struct.unpack("<I", out[-4:])[0]


def in_order(arm: Arm, frames: NDArray[Any]) -> Record:
    return on_host(flight.config_of(arm), [frames_section(frames), END[0]])[-1]


@pytest.mark.parametrize("target", TARGETS)
def test_frames_in_interrupts_give_the_bits_of_frames_in_order(target: str, tmp_path: Path, agree: Agree) -> None:
    with capacities(*PAPER.defines):
        arm, cycles = recorded("paper")
        frames = encode(arm, cycles)
        found, interrupted = stormed(tmp_path, target, arm, frames)
        what = f"zygos_arm_t; {interrupted:,} of {len(frames):,} frames interrupted a step"
        agree(target, "paper, frames in interrupts", what, compare([in_order(arm, frames)], [found]))
        assert interrupted > len(frames) / 4


def test_registers_that_are_not_saved_are_noticed(tmp_path: Path) -> None:
    """Without the processor's help, an interrupt that calculates destroys what the task calculates. Software keeps a
    double in core registers, which every interrupt saves; so this is for the Cortex-M7."""
    with capacities(*PAPER.defines):
        arm, cycles = recorded("paper")
        frames = encode(arm, cycles)
        found, _ = stormed(tmp_path, "m7", arm, frames, drills=("drill_context",))
        assert compare([in_order(arm, frames)], [found]).first
