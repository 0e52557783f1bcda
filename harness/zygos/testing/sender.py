# SPDX-License-Identifier: MIT
"""Sends frames on a SocketCAN interface, as a separate process: python sender.py CHANNEL PACE PATIENCE < frames.

Each frame on stdin is a double, its time in seconds, and a `struct can_frame`. Only the standard library is used, so
that it starts quickly. On stdout it writes what was sent and with which delay, as JSON.

PACE real: each frame at its time. fast: as soon as the device under test has answered all but the newest SYNCs; after
PATIENCE seconds without an answer it gives up. flood: at once, even if frames are lost.
"""

import errno
import json
import select
import socket
import struct
import sys
import time
from collections import deque

RECORD = struct.Struct("=d16s")
CAN_FRAME = struct.Struct("=IB3x8s")
SYNC = 0x080
TELEMETRY = 0x1A0
UNANSWERED = 15
"""Largest number of SYNCs without answer, because the counter of an answer is that of its SYNC modulo 16. With the
frames of two joints that is less than half of what a socket's buffer of default size holds."""
QUIET_S = 0.3
"""At the end, a device that sends nothing for that long has finished, s: not each SYNC has an answer."""


def main(channel: str, pace: str, patience: str) -> None:
    """Send the frames from stdin."""
    raw = sys.stdin.buffer.read()
    records = [RECORD.unpack_from(raw, at) for at in range(0, len(raw), RECORD.size)]
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
        exact = TELEMETRY, socket.CAN_SFF_MASK | socket.CAN_EFF_FLAG | socket.CAN_RTR_FLAG
        can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, struct.pack("=II", *exact))
        can.bind((channel,))
        unanswered: deque[int] = deque()
        begin = time.monotonic()
        latest = 0.0
        for due, frame in records:
            word, _, data = CAN_FRAME.unpack(frame)
            if pace == "real":
                wait = begin + due - time.monotonic()
                if wait > 0.0:
                    time.sleep(wait)
                latest = max(latest, -wait)
            if pace == "fast" and word == SYNC:
                if not hear(can, unanswered, UNANSWERED - 1, float(patience)):
                    sys.exit(f"no answer (frame 0x{TELEMETRY:X}) to {UNANSWERED} SYNCs for {patience} s")
                unanswered.append(data[0] % 16)
            put(can, frame)
        if pace == "fast":
            hear(can, unanswered, 0, QUIET_S)
        took = time.monotonic() - begin
    json.dump({"frames": len(records), "seconds": took, "latest_s": latest}, sys.stdout)


def hear(can: socket.socket, unanswered: "deque[int]", most: int, patience_s: float) -> bool:
    """Receive answers until at most `most` SYNCs are without one. False if no more come."""
    while len(unanswered) > most:
        if not select.select([can], [], [], patience_s)[0]:
            return False
        _, _, data = CAN_FRAME.unpack(can.recv(CAN_FRAME.size))
        counter = data[1] % 16
        if counter in unanswered:
            while unanswered.popleft() != counter:
                pass
    return True


def put(can: socket.socket, frame: bytes) -> None:
    """Send a frame; wait while the queue of the interface or its controller is full."""
    while True:
        try:
            can.send(frame)
            return
        except OSError as error:
            if error.errno != errno.ENOBUFS:
                raise
            time.sleep(1e-4)


if __name__ == "__main__":
    main(*sys.argv[1:])
