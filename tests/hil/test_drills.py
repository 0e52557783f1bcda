# SPDX-License-Identifier: MIT
"""Faults on a real vcan: the device counts each of them, learns from what survived, and from nothing else.

What a drill expects is its own arithmetic. `Dut.judge` holds the device against it, against the numpy reference and,
bit by bit, against the C library in this process.
"""

from __future__ import annotations

import pytest

from zygos.can.vcan import kernel_counts
from zygos.testing import Dut, Fault, Plant, faults

DRILLS: dict[str, tuple[int, list[Fault], dict[str, int]]] = {
    "clean": (600, [], {}),
    "lost": (400, [faults.drop(joint=2, cycles=range(100, 103))], {"incomplete": 3, "dropped": 3}),
    # of each joint one frame in a cycle of its own
    "late": (
        400,
        [faults.late(joint=1, message="angles", cycles=[100, 120]), faults.late(message="rates", cycles=[140])],
        {"late": 4, "incomplete": 3, "dropped": 3},
    ),
    # FTIME of cycle 100 comes with cycle 101: nothing of the arm is missing
    "late time": (400, [faults.late(message="time", cycles=[100])], {"late": 1}),
    "repeated": (
        400,
        [faults.repeat(joint=1, message="torque", cycles=[100, 110], times=2)],
        {"repeated": 4, "dropped": 2},
    ),
    "SYNC repeated": (400, [faults.repeat(message="sync", cycles=[100])], {"sync_repeated": 1, "dropped": 1}),
    "reordered": (400, [faults.reorder(cycles=range(400))], {}),
    "truncated": (
        400,
        [faults.truncate(message="rates", cycles=[100], length=4)],
        {"length": 2, "incomplete": 1, "dropped": 1},
    ),
    # the SYNC of cycle 101 is none: its six frames fall into cycle 100, which is whole without them
    "SYNC truncated": (
        400,
        [faults.truncate(message="sync", cycles=[101], length=0)],
        {"length": 1, "counter": 6, "sync_jumped": 1},
    ),
    "flipped": (
        400,
        [faults.flip(joint=2, cycles=range(100, 110), bits=2)],
        {"crc": 20, "incomplete": 10, "dropped": 10},
    ),
    # Both frames of a drive stand still from cycle 100 on. They are late in cycle 101, and again sixteen and thirty-two
    # cycles on; in 116 and 132 their counter fits and the cycle stands alone; in the other 34 cycles it does not.
    "stuck": (
        400,
        [faults.stick(joint=1, cycles=range(100, 140))],
        {"late": 6, "counter": 68, "incomplete": 37, "dropped": 37},
    ),
    "outage": (400, [faults.outage(start=100, cycles=40)], {"sync_jumped": 1}),
    # The counter goes on as if nothing had been, until the FTIME of cycle 350 says otherwise.
    "outage of 240": (600, [faults.outage(start=70, cycles=240)], {"time_jumped": 1}),
    "babble": (400, [faults.babble(cycles=range(400), per_cycle=30)], {}),
    "error frames": (
        400,
        [faults.error(kind="controller", cycles=[90, 91]), faults.error(kind="no-acknowledge", cycles=[100])],
        {"bus_error": 3},
    ),
    "bus-off": (
        400,
        [faults.error(kind="bus-off", cycles=[100]), faults.outage(start=101, cycles=7)],
        {"bus_error": 1, "sync_jumped": 1, "incomplete": 0, "dropped": 0},
    ),
}


@pytest.mark.parametrize("name", DRILLS)
def test_drill(name: str, plant: Plant, dut: Dut) -> None:
    cycles, happens, expected = DRILLS[name]
    stream = plant.run(cycles).through(*happens)
    if any(stream.frames["flags"] & 4):
        dut.own("error frames come from its own controller; another node can send them on a virtual bus only")
    dut.start()
    before = kernel_counts(plant.channel)
    plant.send(stream)
    assert (kernel_counts(plant.channel) - before).sent >= len(stream)
    dut.judge(stream, **expected)
