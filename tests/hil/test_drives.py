# SPDX-License-Identifier: MIT
"""Drives on a real bus: canplayer sends the answers of seven motors at 500 Hz in CAN FD frames to `zygos listen`."""

from __future__ import annotations

import subprocess
import threading
import time
from pathlib import Path

import can
import pytest
from cli_support import run
from vcan_support import CHANNEL, GUEST, listeners, wait_for_listeners

from conftest import ROOT
from oracles import openarm
from zygos.can import bus
from zygos.cli import listen

SECONDS = 4.0
URDF = ROOT / "examples" / "openarm" / "openarm.urdf"


def test_listening_to_seven_drives_at_500_hz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frame is heard and recorded, and on a kernel that is no guest within half a second of its stamp."""
    sent, heard = tmp_path / "sent.log", tmp_path / "heard.log"
    openarm.candump(openarm.wave(SECONDS), sent, seed=0)
    late_s: list[float] = []
    counts = listen._Answers.counts

    def counted(self: listen._Answers, message: can.Message) -> bool:
        if message.arbitration_id == 0x11:
            late_s.append(time.time() - message.timestamp)
        return counts(self, message)

    monkeypatch.setattr(listen._Answers, "counts", counted)
    others = listeners()

    def play() -> None:
        wait_for_listeners(others + 1)
        subprocess.run(["canplayer", "-I", str(sent), f"{CHANNEL}=can0"], check=True, stdin=subprocess.DEVNULL)

    player = threading.Thread(target=play)
    player.start()
    named = ("--drive", "damiao", "--nodes", "1-7", "--urdf", URDF, "--idle", 2)
    run("listen", *named, "-i", "socketcan", "-c", CHANNEL, "--log", heard)
    player.join()
    messages = [list(bus.read_messages(file, [])) for file in (sent, heard)]
    told, known = ([(one.arbitration_id, bytes(one.data), one.is_fd) for one in part] for part in messages)
    assert told == known and len(told) > 3000 * SECONDS
    lasted = messages[1][-1].timestamp - messages[1][0].timestamp
    print(f"{len(told) / lasted:.0f} frames/s for {lasted:.1f} s, at most {max(late_s):.3f} s late")
    if not GUEST:
        assert lasted < 1.2 * SECONDS
        assert max(late_s) < 0.5
