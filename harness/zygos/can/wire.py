# SPDX-License-Identifier: MIT
"""The meaning of the CAN frames: the shipped DBC and the identifiers of an arm."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import cantools
from cantools.database.can import Database, Message

from zygos.arm import Arm

DBC_FOLDER = Path(__file__).resolve().parents[1] / "_native"


SYNC_MODULUS = 240


COMPUTER_NODE = 32


EXTENDED, REMOTE, ERROR, FD = 1, 2, 4, 8
"""Bits of Frame.flags."""


BUS_OFF = 0x40
"""Class of an error frame, a bit of its identifier: the controller is bus-off."""


UNWANTED = "unwanted"
"""Part of a cycle that makes it unusable: a frame of the fine gyro, where the arm declares a coarse one."""


class Frame(NamedTuple):
    """A CAN frame: identifier, data, and the flags EXTENDED, REMOTE, ERROR, FD."""

    id: int
    data: bytes
    flags: int = 0


class MessageKind(NamedTuple):
    """Meaning of an identifier for an arm: its message in the DBC, its E2E family and node, the joint it belongs to.

    content: what the frame contributes to a cycle, "angles" or "torque" of the joint, or of the gyro; None for SYNC and
    FTIME.
    """

    message: Message
    family: int | None
    node: int
    joint: int = 0
    content: str | None = None

    @property
    def of_joint(self) -> bool:
        """Whether the frame comes from the drive of a joint."""
        return self.content in ("angles", "torque")

    @property
    def part(self) -> str | None:
        """The part of a cycle that the frame contributes; None for SYNC and FTIME."""
        return f"{self.content}{self.joint}" if self.of_joint else self.content


@cache
def database(coarse_gyro: bool = False) -> Database:
    """The shipped DBC; with `coarse_gyro` the messages of the coarse gyro replace those of the fine one."""
    loaded = cantools.database.load_file(DBC_FOLDER / ("zygos-coarse-gyro.dbc" if coarse_gyro else "zygos.dbc"))
    assert isinstance(loaded, Database)
    return loaded


def identifiers(arm: Arm) -> dict[int, MessageKind]:
    """Identifiers of the arm's messages. The DBC names joints by node 1 to 7; other nodes have the same layout."""
    messages = {message.name: message for message in database().messages}
    kinds = {
        0x080: MessageKind(messages["SYNC"], None, COMPUTER_NODE),
        0x380 + COMPUTER_NODE: MessageKind(messages["FTIME"], 2, COMPUTER_NODE),
    }
    for i, joint in enumerate(arm.joints):
        kinds[0x180 + joint.node] = MessageKind(messages["JOINT1_ANGLES"], 0, joint.node, i, "angles")
        kinds[0x280 + joint.node] = MessageKind(messages["JOINT1_TORQUE"], 1, joint.node, i, "torque")
    node = arm.imu.node
    if node == 0:
        return kinds
    if arm.imu.resolution == "coarse":
        kinds[0x180 + node] = MessageKind(database(coarse_gyro=True).get_message_by_frame_id(0x190), 0, node, 0, "rate")
        kinds[0x380 + node] = MessageKind(messages["IMU_RATE_Z"], 2, node, 0, UNWANTED)
    else:
        kinds[0x180 + node] = MessageKind(messages["IMU_RATE_XY"], 0, node, 0, "rate_xy")
        kinds[0x380 + node] = MessageKind(messages["IMU_RATE_Z"], 2, node, 0, "rate_z")
    return kinds


def data_ids(family: int, node: int) -> bytes:
    """DataIDList of E2E profile 2: one identifier for each of the sixteen counters."""
    return bytes((32 * family + node + 17 * counter) % 251 for counter in range(16))
