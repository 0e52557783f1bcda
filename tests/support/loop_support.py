# SPDX-License-Identifier: MIT
"""An arm as a flight computer has it: zygos_t with its memory, fed by frames or by cycles."""

from __future__ import annotations

from typing import Any

from zygos.native.flight import Flight, cycles_to_native, encode, ffi, lib
from zygos.runs.cycles import Cycles

IDLE, ASKED, GIVEN, SOLVED = (
    lib.ZYGOS_STAGE_IDLE, lib.ZYGOS_STAGE_ASKED, lib.ZYGOS_STAGE_GIVEN, lib.ZYGOS_STAGE_SOLVED,
)  # fmt: skip


class Loop:
    """zygos_t, a configuration of its own and memory for solutions."""

    def __init__(self, config: Any, *, in_place: bool = False) -> None:
        self.config = ffi.new("zygos_config_t *", config[0])
        self.memory = ffi.new("zygos_in_place_t *" if in_place else "zygos_background_t *")
        self.native = ffi.new("zygos_t *")
        self.estimate = ffi.new("zygos_estimate_t *")
        self.begun = lib.zygos_init(self.native, self.config, self.memory, ffi.sizeof(self.memory[0]))

    @property
    def state(self) -> Any:
        """zygos_arm_t."""
        return self.native.state

    @property
    def sums(self) -> Any:
        """zygos_arm_t *."""
        return ffi.addressof(self.native, "state")

    def solve(self) -> int:
        return int(lib.zygos_solve(self.native, self.estimate))

    def step(self) -> int:
        return int(lib.zygos_step(self.native))

    def receive(self, frame: Any) -> int:
        return int(lib.zygos_frame(self.native, frame))

    def cycle(self, cycle: Any) -> int:
        return int(lib.zygos_cycle(self.native, cycle))


def native_cycles(cycles: Cycles) -> Any:
    """zygos_cycle_t[n]."""
    return cycles_to_native(cycles)


def frames_of(flight: Flight, cycles: Cycles) -> Any:
    """zygos_frame_t[n], and their number."""
    frames = encode(flight.arm, cycles)
    return ffi.from_buffer("zygos_frame_t[]", frames.copy()), len(frames)
