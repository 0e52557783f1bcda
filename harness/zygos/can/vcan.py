# SPDX-License-Identifier: MIT
"""Frames through a real SocketCAN interface: kernel counts, and a transfer from one socket to another.

python-can sends and a plain AF_CAN socket receives, so that the two ends share no code. Only classical frames are
supported. Linux only; `tools/with-vcan` runs a command where vcan0 exists.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Semaphore

import can

from zygos.errors import ZygosError

# Frames that are sent but not received yet, at most. A socket buffer of default size holds 278, then drops silently.
WINDOW = 128
# The remaining frames count as lost after that time without a frame [s].
PATIENCE_S = 5.0

# Bytes of the enlarged buffer; a frame takes 768 of them, and the kernel doubles the requested size.
_ROOM = 8_000_000
_SO_RCVBUFFORCE = 33

# struct can_frame: identifier and flags, length, 3 bytes that are not used, data.
_FRAME = struct.Struct("=IB3x8s")


@dataclass(frozen=True)
class KernelCounts:
    """Number of frames that the kernel has counted on an interface since it was created."""

    sent: int
    received: int
    dropped: int

    def __sub__(self, earlier: KernelCounts) -> KernelCounts:
        """Counts since `earlier`."""
        return KernelCounts(self.sent - earlier.sent, self.received - earlier.received, self.dropped - earlier.dropped)


def kernel_counts(ifname: str) -> KernelCounts:
    """Reads the kernel's counters of an interface. Raises ZygosError when there is no such interface."""
    folder = Path("/sys/class/net") / ifname / "statistics"

    def count(*names: str) -> int:
        return sum(int((folder / name).read_text(encoding="ascii")) for name in names)

    try:
        return KernelCounts(count("tx_packets"), count("rx_packets"), count("tx_dropped", "rx_dropped"))
    except OSError as error:
        raise ZygosError(f"no interface {ifname}; remedy: tools/with-vcan COMMAND, or name another channel") from error


def open_receiver(channel: str) -> socket.socket:
    """A raw CAN socket that receives every frame on `channel`. Raises ZygosError when there is no such interface."""
    try:
        receiver = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise ZygosError("this kernel has no CAN support; remedy: tools/with-vcan COMMAND") from error
    try:
        receiver.bind((channel,))
    except OSError as error:
        receiver.close()
        raise ZygosError(f"no interface {channel}; remedy: tools/with-vcan COMMAND, or name another channel") from error
    receiver.settimeout(PATIENCE_S)
    return receiver


def make_room(receiver: socket.socket) -> None:
    """Enlarge a socket's buffer to thousands of unread frames, as far as this user's rights allow."""
    try:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _ROOM)
    except PermissionError:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ROOM)


def read_frame(receiver: socket.socket) -> can.Message:
    """The next frame; its timestamp is 0. Raises TimeoutError after PATIENCE_S, ZygosError when it is not classical."""
    raw = receiver.recv(72)
    if len(raw) != _FRAME.size:
        raise ZygosError(f"a CAN FD frame came ({len(raw)} bytes read); remedy: send classical frames only")
    word, length, data = _FRAME.unpack(raw)
    extended = bool(word & socket.CAN_EFF_FLAG)
    remote = bool(word & socket.CAN_RTR_FLAG)
    return can.Message(
        arbitration_id=word & (socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=bool(word & socket.CAN_ERR_FLAG),
        dlc=length,
        data=None if remote else data[:length],
    )


def same(one: can.Message, other: can.Message) -> bool:
    """Whether two messages are the same frame, regardless of their time and channel."""
    return one.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)


def transfer(frames: Sequence[can.Message], channel: str) -> list[can.Message]:
    """Sends frames from one thread as fast as possible, receives them in another, and returns them in order of arrival.

    Time stamps are not transferred: those returned are 0. Foreign frames on the channel are left out. Raises ZygosError
    a frame is missing at the end.
    """
    credit = Semaphore(WINDOW)
    came: list[can.Message] = []

    def receive() -> None:
        newest = time.monotonic()
        while len(came) < len(frames):
            frame = read_frame(receiver)
            if same(frame, frames[len(came)]):
                newest = time.monotonic()
                came.append(frame)
                credit.release()
            elif time.monotonic() - newest > PATIENCE_S:
                raise TimeoutError

    with (
        open_receiver(channel) as receiver,
        can.Bus(channel=channel, interface="socketcan") as sender,
        ThreadPoolExecutor(1) as pool,
    ):
        receiving = pool.submit(receive)
        for frame in frames:
            if not credit.acquire(timeout=PATIENCE_S):
                break
            sender.send(frame)
        try:
            receiving.result()
        except TimeoutError as error:
            raise ZygosError(
                f"{len(came)} of {len(frames)} frames came through {channel}; remedy: check that it is up, "
                f"and its counts (ip -s link show {channel})"
            ) from error
    return came
