# SPDX-License-Identifier: MIT
"""Log files that are cut or spoilt: what survives is read, the rest is named, and no arc goes on across it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cli_support import run
from log_support import containers, write
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm
from zygos.can import bus
from zygos.errors import ZygosError
from zygos.native.flight import Flight
from zygos.runs.cycles import BREAK_BEFORE

Frames = NDArray[Any]
ARM = EXAMPLE / "arm.toml"
SMALL = 2048
"""Bytes that the containers of a .blf hold here."""
OBJECT = 48
"""Bytes of a classical frame in a .blf, by the format's description: two headers of 16 and the frame's 16."""


def held(frames: Frames, lost: set[int], size: int = SMALL) -> NDArray[np.bool_]:
    """(n,) which frames lie in no lost container of a .blf: the k-th takes bytes k·48 … k·48+47 of the content."""
    first = np.arange(len(frames)) * OBJECT
    return ~np.isin(first // size, list(lost)) & ~np.isin((first + OBJECT - 1) // size, list(lost))


def lines_held(sound: bytes, bad: set[int]) -> NDArray[np.bool_]:
    """(n,) which of the lines with a frame are not among the bad ones. Those of a frame have a data byte or two."""
    lines = sound.splitlines()
    return np.array([k not in bad for k, line in enumerate(lines) if b"#" in line or b" d " in line or b" DT " in line])


Spoil = Callable[[bytes, Frames], tuple[bytes, NDArray[np.bool_]]]
"""Sound bytes and their frames to spoilt bytes, and which of the frames survive."""


def cut_in_a_line(sound: bytes, _: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    at = sound.index(b"\n", len(sound) * 2 // 3) - 5
    line = sound[:at].count(b"\n")
    return sound[:at], lines_held(sound, set(range(line, sound.count(b"\n"))))


def garbage_in_lines(sound: bytes, _: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """Text that is no line of a log, bytes that are no text, zeros, and half a line."""
    lines = sound.splitlines(keepends=True)
    half = len(lines) // 2
    lines[half] = b"the recorder was here\n"
    lines[half + 20] = b"\xff\xfe\x80\x00\xa7\n"
    lines[half + 40] = bytes(500) + b"\n"
    lines[half + 60] = lines[half + 60][: len(lines[half + 60]) // 3] + b"\n"
    return b"".join(lines), lines_held(sound, {half, half + 20, half + 40, half + 60})


def identifier_too_large(sound: bytes, _: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    found = re.compile(rb" 0?181 ").search(sound, len(sound) // 2)
    assert found is not None
    at, end = found.span()
    return sound[:at] + b" 123456789 " + sound[end:], lines_held(sound, {sound[:at].count(b"\n")})


def zeros_for_a_sector(sound: bytes, _: Frames, within: int = 12) -> tuple[bytes, NDArray[np.bool_]]:
    at = sound.index(b"\n", len(sound) // 2) + 1 + within
    bad = range(sound[:at].count(b"\n"), sound[: at + 512].count(b"\n") + 1)
    return sound[:at] + bytes(512) + sound[at + 512 :], lines_held(sound, set(bad))


def bit_in_a_block(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """zlib notices; the containers before and behind are whole."""
    begin, end = containers(sound)[20]
    spoilt = bytearray(sound)
    spoilt[(begin + end) // 2] ^= 0x10
    return bytes(spoilt), held(frames, {20})


def bits_in_three_blocks(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """Three containers hold a whole number of objects: the halves before and behind would make one that never was."""
    assert 3 * SMALL % OBJECT == 0
    assert 19 * SMALL % OBJECT > 0
    spoilt = bytearray(sound)
    for begin, end in containers(sound)[19:22]:
        spoilt[(begin + end) // 2] ^= 0x10
    return bytes(spoilt), held(frames, {19, 20, 21})


def block_without_end(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """A flipped bit that zlib does not mind, but then the end of the stream never comes: nothing vouches for it."""
    begin, end = containers(sound)[20]
    for bit in range(8 * (begin + 40), 8 * end):
        spoilt = bytearray(sound)
        spoilt[bit // 8] ^= 1 << bit % 8
        stream = zlib.decompressobj()
        try:
            stream.decompress(spoilt[begin + 32 : end])
        except zlib.error:
            continue
        if not stream.eof:
            return bytes(spoilt), held(frames, {20})
    raise AssertionError("no such bit")


def mark_of_a_container(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    spoilt = bytearray(sound)
    spoilt[containers(sound)[20][0]] ^= 1
    return bytes(spoilt), held(frames, {20})


def mark_of_a_stored_container(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """The objects within have marks of their own. The one that reaches into it from the container before is torn."""
    torn = 20 * SMALL // OBJECT
    return mark_of_a_container(sound, frames)[0], np.arange(len(frames)) != torn


def size_of_a_container(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """Too large by far: zlib knows where its data end, so nothing is lost."""
    spoilt = bytearray(sound)
    spoilt[containers(sound)[20][0] + 10] ^= 1
    return bytes(spoilt), held(frames, set())


def a_container_less(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """Marks and blocks are in order, and still frames are missing: the header knows how many there were."""
    (begin, _), (end, _) = containers(sound)[20:22]
    return sound[:begin] + sound[end:], held(frames, {20})


def cut_between_containers(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    return sound[: containers(sound)[30][0]], held(frames, set(range(30, 100)))


def cut_in_a_stored_container(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    """Up to the cut there are whole objects: those of 30 containers, and 1000 bytes of the next."""
    whole = (30 * SMALL + 1000) // OBJECT
    return sound[: containers(sound)[30][0] + 32 + 1000], np.arange(len(frames)) < whole


def header_gone(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    return bytes(144) + sound[144:], held(frames, set())


def garbage_behind(sound: bytes, frames: Frames) -> tuple[bytes, NDArray[np.bool_]]:
    return sound + bytes(range(256)), held(frames, set())


TEXT = [".log", ".asc", ".trc"]
CASES: list[tuple[str, Spoil, str]] = [
    *[(kind, cut_in_a_line, "ends in the middle of line") for kind in TEXT],
    *[(kind, garbage_in_lines, "has no frame in line") for kind in TEXT],
    *[(kind, zeros_for_a_sector, "has no frame in line") for kind in TEXT],
    *[(kind, identifier_too_large, "has no frame in line") for kind in (".asc", ".trc")],
    ("small.blf", bit_in_a_block, "is damaged in the object at byte"),
    ("small.blf", bits_in_three_blocks, "is damaged in the object at byte"),
    ("small.blf", block_without_end, "is damaged in the object at byte"),
    ("small.blf", mark_of_a_container, "is damaged in the object at byte"),
    ("small.blf", size_of_a_container, "is damaged in the object at byte"),
    ("small.blf", a_container_less, "objects in its header"),
    ("small.blf", cut_between_containers, "in its header"),
    ("small.blf", header_gone, "does not begin with the header"),
    ("small.blf", garbage_behind, "is damaged in the object at byte"),
    ("stored.blf", cut_in_a_stored_container, "is damaged in the object at byte"),
    ("stored.blf", mark_of_a_stored_container, "is damaged in the object at byte"),
]


def spoilt_log(folder: Path, kind: str, spoil: Spoil, frames: Frames) -> tuple[Path, Frames, tuple[str, ...]]:
    """A log of these frames that was spoilt; the frames that are read from it, and what is said of it."""
    path = write(folder, kind, frames, 0.05, SMALL)
    spoilt, survives = spoil(path.read_bytes(), frames)
    assert len(survives) == len(frames)
    path.write_bytes(spoilt)
    log = bus.read_log(path)
    assert log.frames.tobytes() == frames[survives].tobytes()
    return path, log.frames, log.damage


@pytest.mark.parametrize(("kind", "spoil", "said"), CASES, ids=lambda case: getattr(case, "__name__", None))
def test_what_survives_is_read(kind: str, spoil: Spoil, said: str, frames: Frames, tmp_path: Path) -> None:
    _, _, damage = spoilt_log(tmp_path, kind, spoil, frames[:1600])
    assert any(said in text for text in damage)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "spoil"), [(".log", garbage_in_lines), ("small.blf", bit_in_a_block)])
def test_what_survives_is_answered_from(
    kind: str, spoil: Spoil, arm: Arm, frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same bits as from a sound log of the survivors, exit code 4, C equals numpy, and no gap is bridged."""
    frames = frames[:2801]
    path, survivors, damage = spoilt_log(tmp_path, kind, spoil, frames)
    sound = tmp_path / "sound.log"
    bus.write_log(sound, survivors, arm.period_s)
    answers = []
    for run_file, code in ((path, 4), (sound, 0)):
        numbers = tmp_path / "m.json"
        capsys.readouterr()
        assert run("estimate", "--energy", run_file, "--arm", ARM, "-o", tmp_path / "m.toml", "--json", numbers) == code
        answers.append(json.loads(numbers.read_text()))
        error = capsys.readouterr().err
        assert (f"warning: {path} " in error) == (code == 4)
        assert ("based on the readable part of a damaged log" in error) == (code == 4)
    assert answers[0].pop("run") != answers[1].pop("run")
    assert answers[0].pop("damage") == list(damage)
    assert answers[1].pop("damage") is None
    assert answers[0] == answers[1]
    assert run("self-test", path, "--arm", ARM, "--json", tmp_path / "check.json") == 4
    rooms = json.loads((tmp_path / "check.json").read_text())
    assert rooms["damage"] == list(damage)
    assert [room["room"] for room in rooms["rooms"] if not room["equal"]] == []
    assert rooms["rooms"][-1]["room"] == "solution"

    # Neighbours that an arc joins are neighbours of the run as it was.
    whole, left = (Flight(arm).frames(each, trace=True) for each in (frames, survivors))
    assert whole is not None and left is not None
    place = {
        row.tobytes(): k for k, row in enumerate(np.hstack([whole.cycles.q, whole.cycles.theta, whole.cycles.tau]))
    }
    origin = np.array([place[row.tobytes()] for row in np.hstack([left.cycles.q, left.cycles.theta, left.cycles.tau])])
    apart = np.diff(origin) != 1
    broken = (np.diff(left.cycles.sync.astype(np.int64)) != 1) | ((left.cycles.flags[1:] & BREAK_BEFORE) != 0)
    assert np.all(broken[apart])


@pytest.mark.slow
@pytest.mark.parametrize("kind", TEXT)
def test_zeros_from_anywhere_in_a_line(kind: str, arm: Arm, frames: Frames, tmp_path: Path) -> None:
    path = write(tmp_path, kind, frames[:80], arm.period_s)
    sound = path.read_bytes()
    for within in range(70):
        spoilt, survives = zeros_for_a_sector(sound, frames, within)
        path.write_bytes(spoilt)
        log = bus.read_log(path)
        assert log.frames.tobytes() == frames[:80][survives].tobytes()
        assert log.damage


@pytest.mark.slow
def test_a_hole_of_240_cycles_is_not_bridged(arm: Arm, frames: Frames, tmp_path: Path) -> None:
    """The counters look as if nothing were missing; FTIME tells, and what was learned across the hole is taken back."""
    syncs = frames["id"] == 0x080
    size, lost = next(
        (size, k)
        for size in range(79_000, 82_000, OBJECT // 2)
        for k in (1, 2)
        if np.sum(syncs & ~held(frames, {k}, size)) == 240
    )
    path = write(tmp_path, "small.blf", frames, arm.period_s, size)
    spoilt = bytearray(path.read_bytes())
    begin, end = containers(bytes(spoilt))[lost]
    spoilt[(begin + end) // 2] ^= 1
    path.write_bytes(spoilt)
    log = bus.read_log(path)
    assert log.frames.tobytes() == frames[held(frames, {lost}, size)].tobytes()
    flight = Flight(arm)
    flight.frames(log.frames)
    flight.estimate()
    assert flight.faults["time_jumped"] == 1
    assert flight.counts["arcs_dropped"] >= 1
    assert run("self-test", path, "--arm", ARM) == 4


@pytest.mark.slow
def test_an_mf4_is_read_up_to_the_damaged_block(arm: Arm, frames: Frames, tmp_path: Path) -> None:
    """asammdf compresses 4 MB at a time, some 50,000 frames."""
    many = np.tile(frames, 7)
    path = write(tmp_path, ".mf4", many, arm.period_s)
    spoilt = bytearray(path.read_bytes())
    second = spoilt.index(b"##DZ", spoilt.index(b"##DZ") + 4)
    spoilt[second + 5000] ^= 1
    path.write_bytes(spoilt)
    log = bus.read_log(path)
    assert 40_000 < len(log.frames) < len(many)
    assert log.frames.tobytes() == many[: len(log.frames)].tobytes()
    (text,) = log.damage
    assert f"{path} cannot be read beyond frame {len(log.frames):,}" in text
    assert run("estimate", "--energy", path, "--arm", ARM, "-o", tmp_path / "m.toml") in {3, 4}


@pytest.mark.slow
def test_a_crash_of_asammdf_is_a_refusal(arm: Arm, frames: Frames, tmp_path: Path) -> None:
    """A record that is said to begin 2 GB further on, which asammdf 8 believes."""
    path = write(tmp_path, ".mf4", frames[:500], arm.period_s)
    spoilt = bytearray(path.read_bytes())
    # the byte offset of each channel within a record: 24 bytes of header, 8 links, 4 bytes of type and so on
    at = -1
    while (at := spoilt.find(b"##CN", at + 1)) >= 0:
        links = int.from_bytes(spoilt[at + 16 : at + 24], "little")
        spoilt[at + 24 + 8 * links + 7] ^= 0x40
    path.write_bytes(spoilt)
    command = [sys.executable, "-m", "zygos.cli", "estimate", path, "--arm", ARM, "-o", tmp_path / "m.toml"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "asammdf fails" in done.stderr and "remedy" in done.stderr and "Traceback" not in done.stderr


def test_a_recorder_that_was_killed(arm: Arm, frames: Frames, tmp_path: Path) -> None:
    """A .blf whose header was never completed, and an .asc without its last line."""
    frames = frames[:1000]
    writer = can.BLFWriter(tmp_path / "open.blf", max_container_size=SMALL)
    for message in bus.to_messages(frames, arm.period_s):
        writer.on_message_received(message)
    writer.file.flush()
    path = tmp_path / "killed.blf"
    path.write_bytes((tmp_path / "open.blf").read_bytes())
    writer.stop()
    log = bus.read_log(path)
    written = len(frames) * OBJECT // SMALL * SMALL // OBJECT
    assert log.frames.tobytes() == frames[:written].tobytes()
    assert log.damage[-1].endswith("was killed, and the end may be missing")

    path = write(tmp_path, "small.blf", frames, arm.period_s, SMALL)
    path.write_bytes(path.read_bytes()[:16].ljust(144, b"\0") + path.read_bytes()[144:])
    assert bus.read_log(path).damage == ()  # some recorders leave zeros in the header

    path = write(tmp_path, ".asc", frames, arm.period_s)
    path.write_bytes(path.read_bytes().removesuffix(b"End TriggerBlock\n"))
    log = bus.read_log(path)
    assert log.frames.tobytes() == frames.tobytes()
    assert log.damage == (f"{path} ends without its end mark, End TriggerBlock",)


def test_a_damaged_log_that_is_refused_warns(
    arm: Arm, frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused goes before damaged."""
    path = write(tmp_path, ".log", frames[:300], arm.period_s)
    path.write_bytes(path.read_bytes()[:-4])
    assert run("estimate", path, "--arm", ARM, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 3
    error = capsys.readouterr().err
    assert f"warning: {path} ends in the middle of line 300, which is left out" in error
    assert "refused" in error
    assert not (tmp_path / "m.toml").exists()
    assert len(json.loads((tmp_path / "m.json").read_text())["damage"]) == 1
    assert run("self-test", path, "--arm", ARM) == 3
    assert "warning" in capsys.readouterr().err


def nothing_to_read(path: Path) -> None:
    with pytest.raises(ZygosError, match=f"{path.name}: .*remedy") as refusal:
        bus.read_log(path)
    assert refusal.value.exit_code == 2


@pytest.mark.parametrize("suffix", bus.LOG_SUFFIXES)
def test_nothing_to_read_is_bad_input(suffix: str, tmp_path: Path) -> None:
    """Nothing at all, zeros, bytes, a picture, a table of text; one as an .mf4, because each needs a process."""
    contents = [b"", bytes(4096), bytes(range(256)) * 16, b"\x89PNG\r\n\x1a\n" + bytes(100), b"time;id\n1.0;80\n" * 20]
    for content in contents[2:3] if suffix == ".mf4" else contents:
        (path := tmp_path / f"run{suffix}").write_bytes(content)
        nothing_to_read(path)


@pytest.mark.parametrize("written", bus.LOG_SUFFIXES)
def test_a_log_under_another_suffix(written: str, arm: Arm, frames: Frames, tmp_path: Path) -> None:
    content = write(tmp_path, written, frames[:70], arm.period_s).read_bytes()
    for named in set(bus.LOG_SUFFIXES) - {written, ".mf4"}:
        (path := tmp_path / f"other{named}").write_bytes(content)
        nothing_to_read(path)


@pytest.mark.slow
def test_a_table_of_cycles_with_a_row_that_is_not_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The cycle is missing, and the answer is that of the table without it."""
    telemetry, paper = ROOT / "examples" / "telemetry", ROOT / "examples" / "paper" / "arm.toml"
    whole = tmp_path / "whole" / "run.csv"
    options = ("--dbc", telemetry / "arm.dbc", "--map", telemetry / "map.toml", "--arm", paper)
    assert run("convert", telemetry / "run.blf", *options, "-o", whole) == 0
    lines = whole.read_text().splitlines(keepends=True)
    short = [*lines[:700], ",".join(lines[700].split(",")[:7]) + "\n", *lines[701:]]
    values = []
    for name, rows, code in (("short", short, 4), ("without", lines[:700] + lines[701:], 0)):
        table, numbers = whole.with_name(f"{name}.csv"), tmp_path / f"{name}.json"
        table.write_text("".join(rows))
        assert run("estimate", "--energy", table, "-o", tmp_path / f"{name}.toml", "--json", numbers) == code
        content = json.loads(numbers.read_text())
        values.append(content["parameters"])
        said = f"{table} has 7 of 11 columns in line 701, which is left out"
        assert content["damage"] == ([said] if code else None)
    assert values[0] == values[1]
    assert f"warning: {tmp_path / 'whole' / 'short.csv'} has 7 of 11" in capsys.readouterr().err
