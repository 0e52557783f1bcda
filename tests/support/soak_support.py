# SPDX-License-Identifier: MIT
"""A stored motion that is repeated for as long as one likes, with the sensors' noise drawn anew each time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from runs_support import trajectory_of

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import Flight, closed_blocks, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.simulation.scenario import Scenario

DURATION_S = 60.0


def with_all_rows(arm: Arm) -> Arm:
    """The arm with energy, motor and momentum rows."""
    return replace(arm, momentum_max_s=10.0)


def with_short_arcs(arm: Arm) -> Arm:
    """The same in arcs of a few hundred cycles or fewer, which fade in ten minutes."""
    return replace(arm, arc_max_s=20.0, impulse_arc_s=5.0, momentum_max_s=10.0, memory_s=600.0)


def stored(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return trajectory_of(arm, model, scenario, noise=False, duration_s=DURATION_S).cycles()


def again(arm: Arm, motion: Cycles, first: int, rng: np.random.Generator) -> Cycles:
    """The motion with fresh noise, from cycle `first` on; an arc begins."""
    link = np.array([joint.link_encoder.over_the_wire.sigma_rad for joint in arm.joints])
    motor = np.array([joint.motor_encoder.over_the_wire.sigma_rad for joint in arm.joints])
    flags = np.zeros(len(motion), dtype=np.uint32)
    flags[0] = BREAK_BEFORE
    return replace(
        motion,
        sync=np.arange(first, first + len(motion), dtype=np.uint64),
        q=motion.q + link * rng.normal(size=motion.q.shape),
        theta=motion.theta + motor * rng.normal(size=motion.theta.shape),
        omega=motion.omega + arm.imu.rate_sigma * rng.normal(size=motion.omega.shape),
        flags=flags,
    )


def fly(flight: Flight, motion: Cycles, times: int, rng: np.random.Generator) -> None:
    """Repeat the motion behind what the flight has seen."""
    for _ in range(times):
        flight.cycles(again(flight.arm, motion, int(flight.native.sums.cycle) + 1, rng))


def instants(flight: Flight) -> dict[str, list[float]]:
    """Of the blocks of closed arcs."""
    energy, motors, momentum = flight.native.sums.energy, flight.native.sums.motors, flight.native.sums.momentum
    return {
        kind: [block.head.fade * block.head.total for block in closed_blocks(sums)]
        for kind, sums in (("energy", energy), ("motors", motors), ("momentum", momentum))
    }


def settle(flight: Flight) -> None:
    """Finish the tasks that go on beside the cycles."""
    for kind in range(lib.ZYGOS_KINDS_OF_ROWS):
        lib.zygos_guard_settle(ffi.addressof(flight.native, "sums"), kind)
