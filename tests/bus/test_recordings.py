# SPDX-License-Identifier: MIT
"""What is done with a recording before it is used: gzip, UTF-16, copies of a second interface, --from and --to."""

from __future__ import annotations

import gzip
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cli_support import run
from dialect_support import write_dialect
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.run import Run, load_run, save_run
from zygos.errors import ZygosError
from zygos.files import inputs
from zygos.native.flight import FRAME
from zygos.runs.span import reading

pytest_plugins = ["recorded_support"]

Log = NDArray[Any]
ARM = EXAMPLE / "arm.toml"
CASES = Path(ROOT).parent / "shared" / "cases"


@pytest.fixture(scope="module")
def brief(brief_recording: Path) -> Log:
    return bus.read_log(brief_recording).frames


@pytest.fixture(scope="module")
def stamps(brief: Log, arm: Arm) -> list[float]:
    return [message.timestamp for message in bus.to_messages(brief, arm.period_s)]


@pytest.fixture
def stdin(monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes], None]:
    def put(content: bytes) -> None:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))

    return put


# ---------------------------------------------------------------------------------------------- compressed, or UTF-16


@pytest.mark.slow(but=[".csv"])
@pytest.mark.parametrize("suffix", [".log", ".blf", ".asc", ".npz", ".csv"])
def test_a_compressed_run(suffix: str, brief: Log, arm: Arm, tmp_path: Path, stdin: Callable[[bytes], None]) -> None:
    """By its suffix, by its first bytes, in two parts, and on standard input."""
    plain = tmp_path / f"plain{suffix}"
    save_run(Run(arm, brief), plain)
    wanted = load_run(plain, arm).cycles
    content = plain.read_bytes()
    packed = gzip.compress(content[:5000]) + gzip.compress(content[5000:])
    for name in (f"run{suffix}.gz", f"run{suffix}", f"run{suffix.upper()}.GZ"):
        (tmp_path / name).write_bytes(packed)
        found = load_run(tmp_path / name, arm)
        assert found.damage == ()
        np.testing.assert_array_equal(found.cycles.q, wanted.q)
        assert len(found) == len(wanted)
    stdin(packed)
    assert run("check-arm", "-", "--arm", ARM, "--json", tmp_path / "a.json") in (0, 3)
    assert run("check-arm", plain, "--arm", ARM, "--json", tmp_path / "b.json") in (0, 3)
    one, other = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    assert one == {**other, "run": "-"}


def test_compression_that_breaks_off(brief: Log, arm: Arm, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A log and a table are read as far as they go, but for the last row, which may be wrong."""
    for suffix in (".log", ".csv"):
        plain = tmp_path / f"plain{suffix}"
        save_run(Run(arm, brief), plain)
        content = gzip.compress(plain.read_bytes())
        (tmp_path / f"run{suffix}.gz").write_bytes(content[: len(content) // 2])
    log = tmp_path / "run.log.gz"
    assert run("self-test", log, "--arm", ARM) in (3, 4)
    assert f"warning: {log} is compressed, and its end is missing" in capsys.readouterr().err
    found = bus.read_log(log)
    assert found.damage[0].startswith(f"{log} ends in the middle of line")
    np.testing.assert_array_equal(found.frames, brief[: len(found.frames)])
    assert len(found.frames) > 1000
    table = tmp_path / "run.csv.gz"
    assert run("self-test", table, "--arm", ARM) in (3, 4)
    assert f"warning: {table} is compressed, and its end is missing" in capsys.readouterr().err
    whole, cut = load_run(tmp_path / "plain.csv", arm).cycles, load_run(table, arm).cycles
    np.testing.assert_array_equal(cut.omega, whole.omega[: len(cut)])
    assert 50 < len(cut) < len(whole)


def test_names_of_compressed_files(brief: Log, arm: Arm, tmp_path: Path) -> None:
    """A name that ends in .gz does not make a file compressed; one that is missing, and a folder, are named."""
    bus.write_log(tmp_path / "run.log", brief[:100], arm.period_s)
    plain = (tmp_path / "run.log").rename(tmp_path / "run.log.gz")
    assert len(bus.read_log(plain).frames) == 100
    for path, said in ((tmp_path / "none.log.gz", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(ZygosError, match=f"{path}: {said}; remedy: give a"):
            bus.read_log(path)


def test_a_bag_of_ros_is_named_with_the_command_that_converts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("r.db3", "r.bag"):
        (tmp_path / name).write_bytes(b"SQLite format 3\0")
        assert run("convert", tmp_path / name, "--map", CASES / "m.toml", "--arm", ARM, "-o", tmp_path / "r.npz") == 2
        assert f"remedy: `mcap convert {name} NEW.mcap`" in capsys.readouterr().err.replace("\n", " ")


def test_copies_are_removed(brief: Log, arm: Arm, tmp_path: Path) -> None:
    path = tmp_path / "run.log.gz"
    bus.write_log(tmp_path / "run.log", brief, arm.period_s)
    path.write_bytes(gzip.compress((tmp_path / "run.log").read_bytes()))
    with inputs.standard_input():
        copy = inputs.local(path)
        assert copy.is_file()
        assert inputs.local(path) == copy
    assert not copy.exists()


@pytest.mark.slow(only=["candump -L-utf-16"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
@pytest.mark.parametrize("name", ["candump -L", "candump -x", "BUSMASTER", "asc", "trc 2.1", "SavvyCAN"])
def test_text_of_any_encoding(name: str, encoding: str, brief: Log, stamps: list[float], tmp_path: Path) -> None:
    """Windows PowerShell writes what is sent to a file in UTF-16."""
    path = write_dialect(tmp_path, name, brief[:200], stamps[:200], stamps="from zero")
    path.write_bytes(path.read_text(encoding="latin-1").encode(encoding))
    log = bus.read_log(path)
    assert log.damage == ()
    np.testing.assert_array_equal(log.frames, brief[:200])


@pytest.mark.parametrize(("written", "named"), [(".blf", ".log"), (".asc", ".trc"), (".trc", ".asc"), (".log", ".blf")])
def test_a_log_under_the_suffix_of_another(written: str, named: str, brief: Log, arm: Arm, tmp_path: Path) -> None:
    """The remedy, carried out, helps."""
    bus.write_log(tmp_path / f"run{written}", brief[:100], arm.period_s)
    wrong = (tmp_path / f"run{written}").rename(tmp_path / f"other{named}")
    with pytest.raises(ZygosError, match=rf"nothing can be read, .*; remedy: name it \{written}, as which it begins"):
        bus.read_log(wrong)
    assert len(bus.read_log(wrong.rename(tmp_path / f"right{written}")).frames) == 100


# ------------------------------------------------------------------------------------------------ several interfaces


def recorded(path: Path, frames: Log, period_s: float, channels: Callable[[int, int], list[tuple[int, bool]]]) -> None:
    """A log in which each frame is recorded by the given interfaces: channel, and whether it was received there."""
    with can.Logger(path) as writer:
        for k, message in enumerate(bus.to_messages(frames, period_s)):
            for channel, received in channels(k, message.arbitration_id):
                message.channel, message.is_rx = channel, received
                writer.on_message_received(message)


@pytest.mark.parametrize(
    ("channels", "copies"),
    [
        (lambda k, _: [(0, True), (1, True)], 2000),
        (lambda k, _: [(k % 2, True), (1 - k % 2, True)], 2000),
        (lambda k, _: [(0, False), (0, True)], 2000),
        (lambda k, _: [(0, True), (1, True), (2, True)], 4000),
        # a gateway that forwards SYNC to the bus of the second joint
        (lambda k, i: [(0, True), (1, True)] if i == 0x080 else [(int(i in (0x182, 0x282)), True)], 0),
    ],
    ids=["two", "in turn", "echo", "three", "gateway"],
)
def test_several_interfaces(
    channels: Callable[[int, int], list[tuple[int, bool]]], copies: int, brief: Log, arm: Arm, tmp_path: Path
) -> None:
    """Each frame is taken once, and the copies are named."""
    frames = brief[:2000]
    path = tmp_path / "run.blf"
    recorded(path, frames, arm.period_s, channels)
    log = bus.read_log(path)
    np.testing.assert_array_equal(log.frames, frames)
    (remark,) = log.remarks
    assert remark.startswith(f"{path} holds what several interfaces recorded (0 (")
    assert f"{copies or np.count_nonzero(frames['id'] == 0x080):,} frames came on two of them" in remark


@pytest.mark.slow
def test_two_interfaces_on_the_command_line(
    brief: Log, arm: Arm, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A warning that names them, and the values of one of them."""
    out = []
    for name, interfaces in (("one", [(0, True)]), ("two", [(0, True), (1, True)])):
        recorded(tmp_path / f"{name}.log", brief, arm.period_s, lambda k, _, chosen=interfaces: chosen)
        model = tmp_path / f"{name}.toml"
        assert run("estimate", "--energy", tmp_path / f"{name}.log", "--arm", ARM, "-o", model) == 0
        out.append(model.read_text())
        assert ("several interfaces recorded (can0 (Rx), can1 (Rx))" in capsys.readouterr().err) == (name == "two")
    assert out[0] == out[1]


def test_a_repetition_on_one_interface_stays(brief: Log, arm: Arm, tmp_path: Path) -> None:
    """It is a fault of the bus, which the receiver counts; on one interface nothing is a copy."""
    frames = np.repeat(brief[:400], 2)
    bus.write_log(tmp_path / "run.blf", frames, arm.period_s)
    log = bus.read_log(tmp_path / "run.blf")
    assert log.remarks == ()
    with pytest.raises(
        ZygosError, match=r"repeated [\d,]+.*; remedy: every frame is there twice under the name of one"
    ):
        Run(arm, log.frames).check_cycles()


def test_other_traffic_on_a_second_channel_stays(brief: Log, arm: Arm, tmp_path: Path) -> None:
    """The same identifiers with other data, and the same data much later, are no copies."""
    constant = np.zeros(1, dtype=FRAME)
    constant["id"], constant["length"] = 0x701, 1
    frames = np.concatenate([constant, brief[:1500], constant])
    recorded(tmp_path / "run.blf", frames, arm.period_s, lambda k, i: [(int(k > 1000), True)])
    log = bus.read_log(tmp_path / "run.blf")
    assert log.remarks == ()
    np.testing.assert_array_equal(log.frames, frames)


# ------------------------------------------------------------------------------------------------- --from and --to


def test_a_part_of_a_log_and_of_its_table(brief: Log, arm: Arm, tmp_path: Path) -> None:
    """The same cycles, whatever holds them; times count from the first frame or row, and begin is in and end is not."""
    log, table = tmp_path / "run.log", tmp_path / "run.csv"
    whole = Run(arm, brief)
    save_run(whole, log)
    save_run(whole, table)
    parts = [load_run(file, arm, from_s=5.0, to_s=10.0) for file in (log, table)]
    for part in parts:
        np.testing.assert_array_equal(part.q[:99], whole.q[100:199])
    # a cycle of a log is closed by the SYNC of the next one
    assert [len(part) for part in parts] == [99, 100]
    assert len(load_run(table, arm)) == len(whole)
    assert len(load_run(table, arm, from_s=19.95)) == 1
    with pytest.raises(ZygosError, match=r"has nothing from 20 s to inf s, and ends 19\.95 s after its beginning"):
        load_run(table, arm, from_s=20.0)


def test_a_table_that_begins_late(brief: Log, arm: Arm, tmp_path: Path) -> None:
    """Its first row is its beginning, whatever its number."""
    cycles = Run(arm, brief).cycles
    cycles.sync[:] += 100_000
    save_run(Run(arm, table=cycles), tmp_path / "run.npz")
    assert load_run(tmp_path / "run.npz", arm, to_s=1.0).cycles.sync.tolist() == list(range(100_000, 100_020))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--from", "10", "--to", "5"), "from 10 s to 5 s: nothing lies between; remedy"),
        (("--from", "-1"), "from -1 s to inf s: nothing lies between; remedy"),
        (("--to", "nan"), "nothing lies between; remedy"),
        (("--from", "100"), "has nothing from 100 s to inf s, and ends 20 s after its beginning; remedy"),
    ],
)
def test_a_part_that_is_empty(
    options: tuple[str, ...], said: str, brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("estimate", brief_recording, "-o", tmp_path / "m.toml", *options) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_every_command_that_reads_a_recording(
    brief_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each reads the same ten seconds."""
    seen: list[int] = []
    read = bus.read_messages

    def spy(*arguments: Any, **options: Any) -> Any:
        found = list(read(*arguments, **options))
        seen.append(sum(message.arbitration_id == 0x080 for message in found))
        return iter(found)

    monkeypatch.setattr(bus, "read_messages", spy)
    telemetry, out = ROOT / "examples" / "telemetry", tmp_path / "out"
    model = EXAMPLE / "model.toml"
    commands: list[tuple[object, ...]] = [
        ("estimate", "--energy", brief_recording, "-o", out / "m.toml"),
        ("self-test", brief_recording),
        ("check-arm", brief_recording, "--arm", ARM),
        ("refine", brief_recording, "-o", out / "r.toml"),
        ("predict", brief_recording, "--model", model),
        ("view", brief_recording, "--model", model, "--html", out / "v.html"),
        ("bus-load", brief_recording, "--arm", ARM),
    ]
    for command in commands:
        run(*command, "--from", 5, "--to", 15)
        assert seen == [200], command
        seen.clear()
    run("convert", telemetry / "run.blf", "--dbc", telemetry / "arm.dbc", "--map", telemetry / "map.toml",
        "--arm", telemetry / "arm.toml", "-o", out / "c.npz", "--from", 5, "--to", 15)  # fmt: skip
    assert len(load_run(out / "c.npz")) == 200


# ------------------------------------------------------------------------------------------- cases from public reports


def case(name: str) -> Path:
    path = CASES / name
    need(path.is_file(), f"a small input that failed, {path}")
    return path


SAME = (
    "asc_classical_frames_on_CANFD_lines_flags_without_EDL.asc.gz",
    "candump_screen_output_tz.log.gz",
    "estimate_negative_timestamps.asc.gz",
    "savvycan_ragged_csv_header_called_preamble.csv.gz",
)
"""One run of the example in four formats."""


@pytest.mark.slow
def test_four_cases_are_one_run(model: Any, arm: Arm) -> None:
    logs = [bus.read_log(case(name)) for name in SAME]
    assert [log.damage for log in logs] == [()] * 4
    for log in logs[1:]:
        np.testing.assert_array_equal(log.frames, logs[0].frames)
    assert len(Run(arm, logs[0].frames)) == 1200


def test_a_case_of_can_fd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = case("log_all_frames_FD.log.gz")
    arm = case("paper_arm.toml")
    assert run("estimate", log, "--arm", arm, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 3
    said = capsys.readouterr()
    assert "8,425 frames rejected" in said.out
    assert "remedy: 8,425 frames of this arm are CAN FD" in said.err
    assert json.loads((tmp_path / "m.json").read_text())["counts"]["fd_frames"] == 8425
    # the remedy, carried out
    classical = tmp_path / "classical.log"
    classical.write_text(gzip.decompress(log.read_bytes()).decode().replace("##1", "#"))
    np.testing.assert_array_equal(bus.read_log(classical).frames, bus.read_log(case(SAME[1])).frames)


def test_a_case_of_relative_stamps(tmp_path: Path) -> None:
    """Accumulated, they are those of the recording, and with them the clock of the map is right."""
    log = case("convert_relative_timestamps.asc.gz")
    with reading(59.0, None):
        last = list(bus.read_messages(log, []))
    assert [m.timestamp for m in last[::7]] == pytest.approx(np.arange(59.0, 59.99, 0.05).tolist(), abs=1e-3)
    out = tmp_path / "run.npz"
    described = ("--dbc", case("arm.dbc"), "--map", case("recv.toml"), "--arm", case("telemetry_arm.toml"))
    assert run("convert", log, *described, "-o", out) == 0
    assert len(load_run(out)) >= 1190
    assert run("estimate", "--energy", out, "-o", tmp_path / "m.toml") == 0
    assert load_arm(out.with_name("arm.toml")).period_s == 0.05
