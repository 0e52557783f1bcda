"""Frames on buses and in logs: `FRAME` records on our side, python-can on the other."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from zygos import vcan
from zygos.errors import ZygosError
from zygos.flight import FRAME

LOG_SUFFIXES = (".log", ".blf", ".asc", ".mf4")
"""Formats of python-can that keep classical frames whole."""
_EXTENDED, _REMOTE, _ERROR, _FD = 1, 2, 4, 8
_SYNC = 0x080
_SLOT_S = 150e-6
"""Spacing of the frames of a cycle in the stamps of a log: a little more than a frame lasts at 1 Mbit/s."""


def to_messages(frames: NDArray[Any], period_s: float) -> list[can.Message]:
    """`FRAME` records (n,) as messages; the k-th SYNC is stamped k * period_s. The stamps are for people only."""
    cycle = np.maximum(np.cumsum(frames["id"] == _SYNC) - 1, 0)
    first = np.maximum.accumulate(np.where(frames["id"] == _SYNC, np.arange(len(frames)), 0))
    stamps = cycle * period_s + (np.arange(len(frames)) - first) * min(_SLOT_S, period_s / 20)
    return [
        can.Message(
            timestamp=float(stamp),
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(frame["flags"] & _EXTENDED),
            is_remote_frame=bool(frame["flags"] & _REMOTE),
            data=bytes(frame["data"][: frame["length"]]),
        )
        for frame, stamp in zip(frames, stamps, strict=True)
    ]


def from_messages(messages: Iterable[can.Message]) -> NDArray[Any]:
    """Messages as `FRAME` records (n,), foreign and error frames included."""
    ids, lengths, flags, data = [], [], [], []
    for message in messages:
        ids.append(message.arbitration_id)
        flags.append(
            _EXTENDED * message.is_extended_id
            + _REMOTE * message.is_remote_frame
            + _ERROR * message.is_error_frame
            + _FD * message.is_fd
        )
        payload = b"" if message.is_remote_frame else bytes(message.data or b"")
        lengths.append(min(len(payload), 255))
        data.append(payload[:8].ljust(8, b"\0"))
    frames = np.zeros(len(ids), dtype=FRAME)
    frames["id"], frames["length"], frames["flags"] = ids, lengths, flags
    frames["data"] = np.frombuffer(b"".join(data), dtype=np.uint8).reshape(-1, 8)
    return frames


def check_log_name(path: Path) -> None:
    """Refuse a file name whose suffix is none of `LOG_SUFFIXES`."""
    if path.suffix.lower() not in LOG_SUFFIXES:
        raise ZygosError(f"{path}: no CAN log of a known kind; remedy: use one of {' '.join(LOG_SUFFIXES)}")


def write_log(path: Path, frames: NDArray[Any], period_s: float) -> None:
    """Write a log in the format of the suffix: whole, or not at all."""
    check_log_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{os.getpid()}.partial{path.suffix}")
    try:
        with can.Logger(str(partial)) as logger:
            for message in to_messages(frames, period_s):
                message.channel = "can0" if path.suffix.lower() == ".log" else 0
                logger.on_message_received(message)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _counted(messages: Iterable[can.Message], progress: Callable[[int], None] | None) -> Iterator[can.Message]:
    for count, message in enumerate(messages, start=1):
        if progress is not None and count % 5000 == 0:
            progress(count)
        yield message


def read_log(path: Path, progress: Callable[[int], None] | None = None) -> NDArray[Any]:
    """Read all frames of a log; progress is called now and then with the number read so far.

    Raises ZygosError when the file is missing, of no known kind, unreadable, or holds no frame.
    """
    check_log_name(path)
    if not path.is_file():
        raise ZygosError(f"{path}: no such file; remedy: give a CAN log, for instance one that `zygos simulate` wrote")
    try:
        with can.LogReader(str(path)) as reader:
            frames = from_messages(_counted(reader, progress))
    except Exception as error:  # each reader of python-can raises errors of its own
        raise ZygosError(
            f"{path}: not a readable {path.suffix} log ({type(error).__name__}: {error}); remedy: record it again, "
            "or convert it with python-can's `can_logconvert`"
        ) from error
    if len(frames) == 0:
        raise ZygosError(f"{path}: the log holds no frame; remedy: record with the bus running")
    return frames


def open_bus(interface: str | None, channel: str | None, bitrate: int | None = None) -> can.BusABC:
    """Open a bus as python-can does (`can.conf` honoured).

    Raises ZygosError when it cannot be opened.
    """
    options: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
    try:
        return can.Bus(channel=channel, interface=interface, receive_own_messages=False, **options)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise ZygosError(
            f"bus {interface or 'of can.conf'} {channel or ''} cannot be opened ({error}); remedy: check -i and -c, "
            "bring the interface up, or run under tools/with-vcan"
        ) from error


def receive(bus: can.BusABC, idle_s: float, stop: Callable[[], bool] = lambda: False) -> Iterator[can.Message]:
    """Messages of a bus until it has been silent for idle_s after the first one, or stop() is true."""
    first = True
    while not stop():
        message = bus.recv(timeout=None if first and idle_s <= 0 else (10 * idle_s if first else idle_s))
        if message is None:
            return
        first = False
        yield message


def transfer(frames: NDArray[Any], period_s: float, interface: str = "virtual", channel: str = "zygos") -> NDArray[Any]:
    """Send frames from one end of a bus to another, and return what arrived.

    On SocketCAN the sender waits for the receiver, whose buffer would overflow without a word (zygos.vcan). Raises
    ZygosError when the bus cannot be opened or lost a frame.
    """
    if interface == "socketcan":
        return from_messages(vcan.transfer(to_messages(frames, period_s), channel))
    with open_bus(interface, channel) as sender, open_bus(interface, channel) as receiver:
        arrived: list[can.Message] = []

        def collect() -> None:
            while len(arrived) < len(frames):
                message = receiver.recv(timeout=2.0)
                if message is None:
                    return
                arrived.append(message)

        thread = threading.Thread(target=collect)
        thread.start()
        for message in to_messages(frames, period_s):
            sender.send(message, timeout=2.0)
        thread.join()
    if len(arrived) != len(frames):
        raise ZygosError(
            f"bus {interface} {channel}: {len(frames)} frames sent, {len(arrived)} arrived; remedy: enlarge the "
            "receive buffer (net.core.rmem_max) or send more slowly"
        )
    return from_messages(arrived)
