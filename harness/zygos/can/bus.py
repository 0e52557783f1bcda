# SPDX-License-Identifier: MIT
"""Frames on buses and in logs: converts between `FRAME` records and python-can's messages."""

from __future__ import annotations

import errno
import importlib.util
import math
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
import numpy as np
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.socketcan.socketcan import capture_message
from numpy.typing import NDArray

from zygos.can import damaged as salvage
from zygos.can import vcan
from zygos.errors import ZygosError, installs, pip_installs
from zygos.files import inputs
from zygos.files.inputs import LOG_SUFFIXES
from zygos.files.output import cannot_be_written, is_dash, write_bytes
from zygos.native.flight import FRAME
from zygos.runs.span import WHOLE, span

_EXTENDED, _REMOTE, _ERROR, _FD = 1, 2, 4, 8
_SYNC = 0x080
_POLL_S = 0.2
"""Longest time until a listener notices that it is to stop, s."""
_BURST = 256
"""Frames taken at most from a socket before the time is looked at again."""
_SLOT_S = 150e-6
"""Spacing of the time stamps of a cycle's frames in a log, s: slightly more than a frame takes at 1 Mbit/s."""


def to_messages(frames: NDArray[Any], period_s: float) -> list[can.Message]:
    """`FRAME` records (n,) as messages; the k-th SYNC has the time stamp k * period_s. The stamps are only for
    people to read."""
    cycle = np.maximum(np.cumsum(frames["id"] == _SYNC) - 1, 0)
    first = np.maximum.accumulate(np.where(frames["id"] == _SYNC, np.arange(len(frames)), 0))
    stamps = cycle * period_s + (np.arange(len(frames)) - first) * min(_SLOT_S, period_s / 20)
    return [
        can.Message(
            timestamp=float(stamp),
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(frame["flags"] & _EXTENDED),
            is_remote_frame=bool(frame["flags"] & _REMOTE),
            is_error_frame=bool(frame["flags"] & _ERROR),
            is_fd=bool(frame["flags"] & _FD),
            data=bytes(frame["data"][: frame["length"]]),
        )
        for frame, stamp in zip(frames, stamps, strict=True)
    ]


def from_messages(messages: Iterable[can.Message]) -> NDArray[Any]:
    """Messages as `FRAME` records (n,), including foreign frames and error frames."""
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
    """Refuse a file name whose suffix is not in `LOG_SUFFIXES`, or whose format is not installed."""
    _check_suffix(path, path.suffix.lower())


def _check_suffix(path: Path, suffix: str) -> None:
    if suffix == ".db":
        raise ZygosError(
            f"{path}: python-can loses frames when it writes a .db; remedy: record, or send the frames with "
            "`can_player`, into a .blf"
        )
    if suffix in (".db3", ".bag"):
        raise ZygosError(f"{path}: a bag of ROS is read as MCAP; remedy: `mcap convert {path.name} NEW.mcap`")
    if suffix not in LOG_SUFFIXES:
        raise ZygosError(f"{path}: not a known kind of CAN log; remedy: use one of {' '.join(LOG_SUFFIXES)}")
    if suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise ZygosError(f"{path}: .mf4 needs asammdf; remedy: {installs('mf4')}, or use a .blf")


def check_log(path: Path) -> None:
    """Refuse a log that does not exist or is of no known kind."""
    suffix = inputs.suffix(path)
    if is_dash(path) and suffix not in LOG_SUFFIXES:
        raise ZygosError(
            f"{path}: standard input does not begin like a CAN log; remedy: send it the bytes of a "
            f"{' '.join(LOG_SUFFIXES)} file, the lines of `candump -L`, or, where the command takes one, of a table"
        )
    inputs.check_file(path, "give a CAN log, for instance one that `zygos simulate` wrote")
    _check_suffix(path, suffix)


class LogWriter:
    """A log, in the format of the suffix, to which messages are added. It gets its name when it is finished.

    Every method raises ZygosError, naming the log, when it cannot be written; the incomplete file is then removed.
    """

    def __init__(self, path: Path) -> None:
        """Begin an empty log in the folder of `path`."""
        check_log_name(path)
        self.path = path
        self.count = 0
        self._partial = path.with_name(f".{os.getpid()}.partial{path.suffix}")
        self._classical_only = path.suffix.lower() == ".trc"  # python-can would omit the other frames
        self._channel = "can0" if path.suffix.lower() == ".log" else 0
        with self._refusing():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._logger = can.Logger(str(self._partial))

    def append(self, messages: Iterable[can.Message]) -> None:
        """Add messages at the end."""
        with self._refusing():
            for message in messages:
                if self._classical_only and (message.is_fd or message.is_remote_frame or message.is_error_frame):
                    kind = "an FD" if message.is_fd else "a remote" if message.is_remote_frame else "an error"
                    raise ZygosError(f"{self.path}: a .trc cannot hold {kind} frame; remedy: write a .blf")
                message.channel = self._channel
                self._logger.on_message_received(message)
                self.count += 1

    def finish(self) -> None:
        """Give the log its name; a log without messages is removed."""
        with self._refusing():
            self._logger.stop()
            if self.count:
                self._partial.replace(self.path)
        self._partial.unlink(missing_ok=True)

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self._partial.unlink(missing_ok=True)
            if isinstance(error, Exception) and not isinstance(
                error, ZygosError
            ):  # each writer of python-can raises different errors
                raise cannot_be_written(self.path, error) from error
            raise


def write_log(path: Path, frames: NDArray[Any], period_s: float) -> None:
    """Write frames as `write_messages`, with time stamps as of `to_messages`."""
    write_messages(path, to_messages(frames, period_s))


def write_messages(path: Path, messages: Iterable[can.Message]) -> None:
    """Write a log in the format of the suffix, completely or not at all; "-" is standard output in candump's format.

    Errors: ZygosError if it cannot be written.
    """
    if is_dash(path):
        with TemporaryDirectory() as folder:
            log = Path(folder, "run.log")
            write_messages(log, messages)
            write_bytes(path, log.read_bytes())
        return
    recording = LogWriter(path)
    recording.append(messages)
    recording.finish()


_NEAR = 48
"""Number of frames within which two interfaces record the same frame: those of 16 cycles of the smallest arm, after
which the counter in its frames, and so a whole frame, may come again."""


def _one_bus(messages: Iterable[can.Message], remarks: list[str]) -> Iterator[can.Message]:
    """Messages without the copies of those that another interface, or the sender's echo, had recorded before.

    Two interfaces at one bus record every frame twice, and the receiver would take the second for a repetition. What
    was left out is appended to remarks.
    """
    recent: dict[tuple[Any, ...], tuple[int, set[tuple[Any, bool]]]] = {}
    seen_by: dict[tuple[Any, bool], None] = {}
    copies = 0
    for count, message in enumerate(messages):
        own = (message.channel, message.is_rx)
        seen_by[own] = None
        content = bytes(message.data or b"")
        key = (message.arbitration_id, message.is_extended_id, message.is_error_frame, message.is_fd, content)
        before, by = recent.get(key, (-_NEAR, set()))
        if count - before < _NEAR and own not in by:
            by.add(own)
            copies += 1
            continue
        recent[key] = (count, {own})
        if len(recent) > 2 * _NEAR:
            recent = {one: entry for one, entry in recent.items() if count - entry[0] < _NEAR}
        yield message
    if copies:
        listed = ", ".join(f"{channel} ({'Rx' if rx else 'Tx'})" for channel, rx in seen_by)
        remarks.append(
            f"holds what several interfaces recorded ({listed}): {copies:,} frames came on two of them, and are taken "
            "once"
        )


def _within(path: Path, messages: Iterable[can.Message]) -> Iterator[can.Message]:
    """The messages in the span that is read."""
    wanted = span()
    if wanted == WHOLE:
        yield from messages
        return
    begin, last_s, found = math.nan, 0.0, False
    for message in messages:
        begin = message.timestamp if math.isnan(begin) else begin
        time_s = message.timestamp - begin
        last_s = max(last_s, time_s)
        if wanted.holds(time_s):
            found = True
            yield message
    if not found or not last_s > 0.0:
        raise wanted.nothing(path, last_s)


def _counted(messages: Iterable[can.Message], progress: Callable[[int], None] | None) -> Iterator[can.Message]:
    for count, message in enumerate(messages, start=1):
        if progress is not None and count % 5000 == 0:
            progress(count)
        yield message


@dataclass(frozen=True)
class Log:
    """The content of a log."""

    frames: NDArray[Any]
    """`FRAME` records (n,) in file order."""
    damage: tuple[str, ...]
    """Sentences about what is missing, each beginning with the log's name; empty for a log that looks complete."""
    remarks: tuple[str, ...] = ()
    """Sentences about what else is unusual, likewise."""


def read_log(path: Path, progress: Callable[[int], None] | None = None) -> Log:
    """Read all frames of a log; of a damaged log all readable ones.

    progress is called from time to time with the number of frames read so far. Raises ZygosError when the file is
    missing, of no known kind, unreadable, or holds no frame.
    """
    damage: list[str] = []
    remarks: list[str] = []
    frames = from_messages(read_messages(path, damage, progress, remarks))
    if len(frames) == 0:
        if not damage:
            raise ZygosError(f"{path}: the log holds no frame; remedy: record while the bus is running")
        kind, content = inputs.suffix(path), inputs.content(path).suffix
        raise ZygosError(
            f"{path}: nothing can be read, the log {damage[0]}; remedy: "
            + (
                f"name it {content}, as which it begins"
                if content not in ("", kind)
                else f"check that it is a {kind} log, and record it again"
            )
        )
    return Log(frames, tuple(f"{path} {text}" for text in damage), tuple(f"{path} {text}" for text in remarks))


def read_messages(
    path: Path,
    damage: list[str],
    progress: Callable[[int], None] | None = None,
    remarks: list[str] | None = None,
) -> Iterator[can.Message]:
    """The messages of any log, in the span that is read (`zygos.runs.span`), each one once; progress as in `read_log`.

    Descriptions of missing parts are appended to damage, and of what else is unusual to remarks; each continues a
    sentence that begins with "the log". Raises ZygosError when the file is missing, of no known kind, or unreadable, or
    has nothing in the span.
    """
    check_log(path)
    try:
        messages = _one_bus(salvage.messages(path, damage), [] if remarks is None else remarks)
        yield from _within(path, _counted(messages, progress))
    except ZygosError:
        raise
    except Exception as error:  # of the file, or of a reader at some unexpected kind of damage
        raise ZygosError(
            f"{path}: not a readable {inputs.suffix(path)} log ({type(error).__name__}: {error}); remedy: record it "
            "again, or convert it with python-can's `can_logconvert`"
        ) from error


def open_bus(interface: str | None, channel: str | None, bitrate: int | None = None) -> can.BusABC:
    """Open a bus in the way of python-can (a `can.conf` is used), on SocketCAN with CAN FD.

    Raises ZygosError when it cannot be opened.
    """
    options: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
    if interface == "socketcan":
        options["fd"] = True  # a socket of Linux takes CAN FD beside classical frames; others need bit rates for it
    try:
        opened = can.Bus(channel=channel, interface=interface, receive_own_messages=False, **options)
        if isinstance(opened, SocketcanBus):
            vcan.make_room(opened.socket)
        return opened
    except (can.CanError, OSError, ValueError, ImportError) as error:
        called = f"bus {interface or 'of can.conf'} {channel or ''}".strip()
        if "msgpack" in str(error):  # python-can does not say who needs it
            raise ZygosError(f"{called}: udp_multicast needs msgpack; remedy: {pip_installs('msgpack')}") from error
        raise ZygosError(
            f"{called} cannot be opened ({error}); remedy: check -i and -c, bring the interface up, or run under "
            "tools/with-vcan"
        ) from error


def is_sync(message: can.Message) -> bool:
    """Whether a message is the SYNC of an arm."""
    return message.arbitration_id == _SYNC and not message.is_extended_id


def received_messages(
    bus: can.BusABC,
    idle_s: float,
    stop: Callable[[], bool] = lambda: False,
    counts: Callable[[can.Message], bool] = is_sync,
) -> Iterator[can.Message]:
    """Messages of a bus until none that counts came for idle_s, or for ten times idle_s before the first one, or stop()
    is true.

    Not all count, because other nodes may send heartbeats for ever. Raises can.CanError when the bus fails.
    """
    patience = 10 * idle_s
    newest = time.monotonic()
    if isinstance(bus, SocketcanBus):
        bus.socket.setblocking(False)
    while not stop() and time.monotonic() - newest < patience:
        try:
            for message in _burst(bus, min(_POLL_S, patience)):
                if counts(message):
                    patience, newest = idle_s, time.monotonic()
                yield message
        except OSError as error:
            raise can.CanOperationError(str(error)) from error


def _burst(bus: can.BusABC, timeout: float) -> Iterator[can.Message]:
    """What has come, after a wait of at most timeout [s] for the first message.

    Each further message of a socket, which must not block, costs one system call in place of three.
    """
    first = bus.recv(timeout=timeout)
    if first is None:
        return
    yield first
    if not isinstance(bus, SocketcanBus):
        return
    for _ in range(_BURST):
        try:
            message = capture_message(bus.socket)
        except can.CanOperationError as error:
            if error.error_code == errno.EAGAIN:
                return
            raise
        if message is not None:
            message.channel = first.channel
            yield message


def transferred(
    frames: NDArray[Any], period_s: float, interface: str = "virtual", channel: str = "zygos"
) -> NDArray[Any]:
    """Send frames from one end of a bus to another, and return what arrived.

    Foreign frames on that bus are left out. On SocketCAN the sender waits for the receiver, whose buffer would
    otherwise overflow without an error (zygos.can.vcan). Raises ZygosError when the bus cannot be opened or lost a
    frame.
    """
    sent = to_messages(frames, period_s)
    if interface == "socketcan":
        return from_messages(vcan.transfer(sent, channel))
    with open_bus(interface, channel) as sender, open_bus(interface, channel) as receiver:
        arrived: list[can.Message] = []

        def collect() -> None:
            newest = time.monotonic()
            while len(arrived) < len(sent) and time.monotonic() - newest < 2.0:
                message = receiver.recv(timeout=2.0)
                if message is not None and vcan.same(message, sent[len(arrived)]):
                    newest = time.monotonic()
                    arrived.append(message)

        thread = threading.Thread(target=collect)
        thread.start()
        for message in sent:
            sender.send(message, timeout=2.0)
        thread.join()
    if len(arrived) != len(frames):
        raise ZygosError(
            f"bus {interface} {channel}: {len(frames)} frames sent, {len(arrived)} arrived; remedy: enlarge the "
            "receive buffer (net.core.rmem_max) or send more slowly"
        )
    return from_messages(arrived)
