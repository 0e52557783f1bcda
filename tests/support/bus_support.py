# SPDX-License-Identifier: MIT
"""Recorded frames played on a bus inside this process, to a command that listens there."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
from can.interfaces import virtual

from zygos.can import bus

PATIENCE_S = 60.0


def _await(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("nobody listens on the virtual bus, or what listens does not read")
        time.sleep(0.01)


@contextlib.contextmanager
def playing(channel: str, log: Path, after: Callable[[], None] = lambda: None) -> Iterator[None]:
    """
    The frames of `log`, with its time stamps, go to `channel` of the virtual bus from another thread, as soon as one
    more listens there.

    A virtual bus keeps nothing for those who come later, and on a loaded machine a command takes seconds until it
    listens. `after` is called a second after everything was read.
    """
    before = tuple(virtual.channels.get(channel, ()))
    messages = list(bus.read_messages(log, []))

    def play() -> None:
        _await(lambda: len(virtual.channels.get(channel, ())) > len(before))
        readers = [queue for queue in virtual.channels[channel] if queue not in before]
        with can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as out:
            for message in messages:
                out.send(message)
            _await(lambda: all(queue.empty() for queue in readers))
            time.sleep(1.0)
        after()

    player = threading.Thread(target=play)
    player.start()
    yield
    player.join()
