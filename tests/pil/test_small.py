# SPDX-License-Identifier: MIT
"""Images that lie in a small memory as a whole: what does not fit does not link, and the bytes are the host's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from arm_support import exact_torques
from build_support import capacities

from pil.conftest import Agree, Measured
from pil.pil_support import (
    END,
    Build,
    compare,
    firmware,
    frames_section,
    on_host,
    on_target,
    recorded,
)
from zygos.native import flight

LEAST = (
    "-DZYGOS_MAX_BLOCKS=11",
    "-DZYGOS_MAX_MOTOR_BLOCKS=4",
    "-DZYGOS_MAX_MOMENTUM_BLOCKS=4",
    "-DZYGOS_MAX_EFFECTS=0",
    "-DZYGOS_MAX_REDUCTION=0",
    "-DZYGOS_JOINT_ROWS=0",
)
"""The least capacities that hold an arm with springs and exact torque sensors, on a free base."""


@dataclass(frozen=True)
class Small:
    """An arm, with everything on, and the memory of its flight computer."""

    build: Build
    ram_bytes: int
    stack_bytes: int

    @property
    def flags(self) -> tuple[str, ...]:
        return (
            "-DIN_PLACE=1",
            f"-Wl,--defsym=board_ram_bytes={self.ram_bytes}",
            f"-Wl,--defsym=core_stack_bytes={self.stack_bytes}",
        )


SMALL = {
    "spatial": Small(Build("three joints, least", ("-DZYGOS_MAX_JOINTS=3", *LEAST)), 512 * 1024, 8192),
    "seven": Small(Build("seven joints, least", ("-DZYGOS_MAX_JOINTS=7", *LEAST)), 3_600_000, 16384),
}


@pytest.mark.parametrize("example", SMALL)
def test_everything_fits(example: str, tmp_path: Path, agree: Agree, measured: Measured) -> None:
    """Frames, all rows with compensation, and an estimate in place, in RAM that holds nothing else."""
    small = SMALL[example]
    with capacities(*small.build.defines):
        arm, cycles = recorded(example)
        arm = replace(exact_torques(arm), arc_max_s=0.3, momentum_max_s=0.3, impulse_arc_s=0.3)
        config = flight.config_of(arm)
        assert config.compensation > 0
        sections = [frames_section(flight.encode(arm, cycles)), *END]
        elf = firmware("m7", "bulk", small.build, small.flags, board="mps2-an500-small")
        records, sizes = on_target("m7", elf, tmp_path, config, sections)
        host = on_host(config, sections, in_place=True)
        agree(
            "m7", small.build.name, f"all in {small.ram_bytes:,} bytes of RAM, solved in place", compare(host, records)
        )
        measured("m7", small.build.name, sizes)
        estimate = flight.ffi.from_buffer("zygos_estimate_t *", host[-2].data)
        state = flight.ffi.from_buffer("zygos_arm_t *", host[-1].data)
        assert estimate.blocks >= 6
        assert state.sums.motors.store.closed > 0
        assert state.sums.momentum.store.closed > 0
        assert sizes.state + sizes.work + sizes.estimate + small.stack_bytes <= small.ram_bytes
        assert sizes.stack <= 0.8 * small.stack_bytes


def test_what_does_not_fit_does_not_link() -> None:
    small = replace(SMALL["spatial"], ram_bytes=384_000)
    with pytest.raises(Exception, match="returned non-zero exit status"):
        firmware("m7", "bulk", small.build, small.flags, board="mps2-an500-small")
