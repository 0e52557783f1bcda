# SPDX-License-Identifier: MIT
"""zygos-node where memory, files or the disk fail: it goes on, with what can be trusted, and says so."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from node_support import TELEMETRY, Log, Node, Teller, flip, image, saved
from round_support import told

from conftest import ROOT, need
from zygos.arm import Arm
from zygos.can.dbc import arm_database
from zygos.native import snapshot
from zygos.native.flight import Flight, accepted, ffi, lib
from zygos.testing.twin import Twin

CORRUPT = lib.ZYGOS_REASON_CORRUPT
CHANGED = "zygos-node: memory was changed:"
REPAIRED = f"{CHANGED} repaired in place; remedy: none if it is rare, otherwise test the memory\n"


def place_of(struct: str, *members: str | int) -> int:
    return int(ffi.offsetof(struct, *members))


GRAM = place_of("zygos_arm_t", "sums", "energy", "block", 0, "gram", 0)
"""An entry of the sums that is far from 0: the square of the first column."""


def upset(node: Node) -> None:
    """One bit of a sum: its exponent changes."""
    node.flip(GRAM + 7, 4)


def listened(node: Node, arm: Arm) -> list[tuple[str, float]]:
    """Name and value of all telemetry, decoded by the arm's DBC and checked by its CRC."""
    dbc = arm_database(arm)
    return [told(dbc, data)[:2] for data in node.of(TELEMETRY)]


def values(heard: list[tuple[str, float]], name: str) -> list[float]:
    return [value for told_name, value in heard if told_name == name]


# ---------------------------------------------------------------- memory


def test_a_corrupt_sum_is_dropped_and_the_others_stay(
    arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """The verdict of the solution, the counter and a line on stderr tell; what is sent, and what is saved at the end,
    is what the library in this process has after the same upset."""
    state, twin = tmp_path / "state.zyg", Teller(arm, every=50)
    with Node("--config", config, "--every", 50, "--state", state) as node:
        node.send(frames[: syncs[420] + 1])
        node.worked_off(421)
        upset(node)
        node.send(frames[syncs[420] + 1 :])
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
        heard = listened(node, arm)
    assert code == 0
    assert said == REPAIRED
    reasons = values(heard, "verdict_reason")
    assert reasons.count(CORRUPT) == 1
    assert reasons[9] == CORRUPT  # behind SYNC 451
    assert values(heard, "node_corrupt")[:12] == 10 * [0.0] + 2 * [1.0]
    assert (counters["node_corrupt"], counters["node_unsaved"]) == (1, 0)
    assert values(heard, "verdict_validity")[-1] == 3.0
    twin.hear(frames[: syncs[420] + 1])
    flip(twin, GRAM + 7, 4)
    twin.hear(frames[syncs[420] + 1 :])
    assert node.of(TELEMETRY) == twin.sent
    assert saved(state) == image(twin)
    assert twin.native.quarantined == 1
    assert not any(n for name, n in counters.items() if name.startswith("fault_"))
    assert counters["count_cycles"] == 1200


def test_a_save_repairs_what_it_saves(arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """No estimate is due between the upset and the end."""
    state, twin = tmp_path / "state.zyg", Twin(arm, every=1000, save_every=200)
    with Node("--config", config, "--state", state, "--save-every", 200, "--every", 1000) as node:
        node.send(frames[: syncs[250] + 1])
        node.worked_off(251)
        upset(node)
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
    assert (code, counters["node_corrupt"], counters["node_unsaved"]) == (0, 1, 0)
    assert said == REPAIRED
    twin.hear(frames[: syncs[250] + 1])
    flip(twin, GRAM + 7, 4)
    assert saved(state) == image(twin)
    assert snapshot.read(state, "state").quarantined == 1


GEAR = place_of("zygos_config_t", "joint", 1, "gear_ratio") + 6
"""An upset of the node's own configuration, of which the library has a copy and its checksum."""


@pytest.mark.parametrize("kept", [True, False], ids=["from a file", "from nothing"])
def test_it_goes_back_to_the_last_good_state(
    kept: bool, arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """Where its own configuration is not that of the library any more, it reads the file again, and the state."""
    state, twin = tmp_path / "state.zyg", Teller(arm, every=50, save_every=400 if kept else 0)
    files = ("--state", state, "--save-every", 400) if kept else ()
    with Node("--config", config, "--every", 50, *files) as node:
        node.send(frames[: syncs[420] + 1])
        node.worked_off(421)
        good = state.read_bytes() if kept else b""
        node.flip_config(GEAR, 5)
        node.send(frames[syncs[420] + 1 : syncs[1100]])
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
    assert code == 0
    twin.hear(frames[: syncs[420] + 1])
    assert twin.saved == good
    memory = ffi.buffer(twin.config)
    memory[GEAR] = bytes([memory[GEAR][0] ^ 1 << 5])
    twin.hear(frames[syncs[420] + 1 : syncs[1100]])
    assert node.of(TELEMETRY) == twin.sent
    first, second = said.splitlines()
    assert first.startswith(f"{CHANGED} the configuration is not what was compiled; the estimate starts over; remedy: ")
    assert second.startswith("zygos-node: goes on behind cycle " if kept else "zygos-node: starts at cycle 0")
    assert (counters["node_corrupt"], counters["node_unsaved"]) == (1, 0)
    assert counters["count_accepted"] == twin.counts["accepted"] > 600
    assert twin.answers[-1].estimate.validity == lib.ZYGOS_VALID
    if kept:
        assert saved(state) == image(twin)


def test_corrupt_memory_is_not_saved_at_the_end(
    arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """The last good state stays, exit code 2 tells."""
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 200, "--every", 1000) as node:
        node.send(frames[: syncs[250] + 1])
        node.worked_off(251)
        good = state.read_bytes()
        node.flip_config(GEAR, 5)
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
    assert (code, counters["node_corrupt"], counters["node_unsaved"]) == (2, 1, 1)
    assert "memory was changed" in said
    assert state.read_bytes() == good
    stored = snapshot.read(state, "state")
    assert accepted(stored) > 150


@pytest.mark.slow(only=["columns*", "magic"])
@pytest.mark.parametrize(
    ("where", "bit"),
    [
        (place_of("zygos_arm_t", "sums", "config", "joint", 1, "gear_ratio") + 6, 5),
        (place_of("zygos_arm_t", "sums", "config", "joints"), 0),
        (place_of("zygos_arm_t", "sums", "config", "joint", 1, "node"), 1),
        (place_of("zygos_arm_t", "magic") + 3, 2),
        (place_of("zygos_arm_t", "sums", "motors", "column_map", "count", 0), 1),
        (place_of("zygos_arm_t", "receiver", "queue", "head") + 2, 4),
    ],
    ids=["gear ratio", "joints", "node", "magic", "columns of the motor rows", "place in the queue"],
)
def test_other_memory_heals_too(where: int, bit: int, arm: Arm, config: Path, frames: Log, syncs: Log) -> None:
    """A configuration that was changed makes every value wrong and no check of sums notices, or leaves no cycle
    complete; a magic number that is lost stops the library; tables that follow from the configuration are computed
    anew."""
    twin = Teller(arm, every=50)
    with Node("--config", config, "--every", 50) as node:
        node.send(frames[: syncs[220] + 1])
        node.worked_off(221)
        node.flip(where, bit)
        node.send(frames[syncs[220] + 1 :])
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
        heard = listened(node, arm)
    assert (code, counters["node_corrupt"]) == (0, 1), (said, counters)
    assert said == REPAIRED
    assert values(heard, "verdict_validity")[-1] == 3.0
    twin.hear(frames[: syncs[220] + 1])
    flip(twin, where, bit)
    twin.hear(frames[syncs[220] + 1 :])
    assert node.of(TELEMETRY) == twin.sent
    flight = Flight(arm)
    flight.frames(frames[syncs[300] :])
    known = flight.estimate()
    for name, value, half in zip(known.names, known.value, known.half95, strict=True):
        assert abs(values(heard, name)[-1] - value) < 3.0 * half


# ---------------------------------------------------------------- two generations


def cycle_in(state: Path) -> int:
    """Number of the newest cycle of a stored state."""
    native = snapshot.read(state, "state")
    return int(native.sums.cycle)


def run_to(config: Path, state: Path, frames: Log, end: int) -> int:
    """Let a node hear these frames and save. Returns the cycle that it knows."""
    with Node("--config", config, "--state", state) as node:
        node.send(frames[:end])
        node.end()
    return cycle_in(state)


def went_on(config: Path, state: Path) -> int:
    """The cycle behind which a start goes on, 0 where it starts from nothing."""
    with Node("--config", config, "--state", state) as node:
        return int(node.first.split()[-1])


@pytest.fixture(scope="module")
def saved_twice(
    config: Path, frames: Log, syncs: Log, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, int, int]:
    """A folder with a state and the one before it; their cycles, newest first."""
    folder = tmp_path_factory.mktemp("generations")
    state = folder / "state.zyg"
    older = run_to(config, state, frames, syncs[100])
    first = state.read_bytes()
    newest = run_to(config, state, frames, syncs[180])
    assert (folder / "state.zyg.previous").read_bytes() == first
    assert sorted(path.name for path in folder.iterdir()) == ["state.zyg", "state.zyg.lock", "state.zyg.previous"]
    assert newest > older > 90
    return folder, newest, older


@pytest.fixture
def generations(saved_twice: tuple[Path, int, int], tmp_path: Path) -> tuple[Path, int, int]:
    """A copy of them that may be spoiled: the newest state, and the cycles of both."""
    folder, newest, older = saved_twice
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return tmp_path / "state.zyg", newest, older


def sealed_corrupt(path: Path) -> None:
    """Sums that were changed in memory, and then sealed with a CRC that fits."""
    native = snapshot.read(path, "state")
    native.sums.energy.block[0].gram[0] *= 2.0
    path.write_bytes(snapshot.seal("state", native))


SPOILED: dict[str, tuple[Callable[[Path], object], str]] = {
    "sealed corrupt": (sealed_corrupt, "holds sums that do not match their row sums"),
    "empty": (lambda path: path.write_bytes(b""), "is no snapshot of zygos"),
    "cut off": (lambda path: os.truncate(path, path.stat().st_size // 2), "is cut off"),
    "gone": (lambda path: path.unlink(), "is not there"),
}


@pytest.mark.parametrize("how", SPOILED)
def test_the_older_state_where_the_newest_cannot_be_used(
    how: str, config: Path, frames: Log, syncs: Log, generations: tuple[Path, int, int]
) -> None:
    """And it stays the older one when the next state is saved: what could not be used does not take its place."""
    state, _, older = generations
    previous = state.with_name("state.zyg.previous")
    kept = previous.read_bytes()
    spoil, reason = SPOILED[how]
    spoil(state)
    with Node("--config", config, "--state", state) as node:
        assert f"goes on behind cycle {older}\n" in node.first
        assert f"{state}: {reason}" in node.complaints
        assert f"goes on from {previous}, the state before it" in node.complaints
        assert state.with_name("state.zyg.unusable").exists() == (how != "gone")
        node.send(frames[syncs[190] : 300 + syncs[190]])
        node.end()
    assert cycle_in(state) > older
    assert previous.read_bytes() == kept


@pytest.mark.parametrize("how", ["sealed corrupt", "empty"])
def test_from_nothing_where_neither_can_be_used(
    how: str, config: Path, frames: Log, syncs: Log, generations: tuple[Path, int, int]
) -> None:
    state, _, _ = generations
    spoil, reason = SPOILED[how]
    spoil(state)
    spoil(state.with_name("state.zyg.previous"))
    with Node("--config", config, "--state", state) as node:
        assert "goes on behind" not in node.first
        node.send(frames[: syncs[60]])
        node.end()
    assert cycle_in(state) > 50
    first, second, third = node.complaints.splitlines()
    assert first.startswith(f"zygos-node: {state}: {reason}")
    assert first.endswith(f" {state}.unusable")
    assert second.startswith(f"zygos-node: {state}.previous: {reason}")
    assert second.endswith(f" {state}.previous")
    assert f"{state}: no state can be used, starts from nothing; remedy: " in third


@pytest.fixture(scope="module")
def power_cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    cc = shutil.which("cc")
    need(cc, "cc")
    library = tmp_path_factory.mktemp("cut") / "power_cut.so"
    source = ROOT / "tests" / "bus" / "power_cut.c"
    subprocess.run([str(cc), "-O1", "-shared", "-fPIC", source, "-o", library, "-ldl"], check=True)
    return library


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "links"), [("both good", True), ("both good", False), ("gone", True), ("sealed corrupt", True)]
)
def test_power_is_lost_at_any_change_of_the_disk(
    how: str,
    links: bool,
    config: Path,
    frames: Log,
    syncs: Log,
    generations: tuple[Path, int, int],
    power_cut: Path,
    tmp_path: Path,
) -> None:
    """Before each of the changes that a start and a save make, also on a disk where a file has but one name. A state is
    there whenever it comes: the newest that there was before, or the one that was being saved."""
    state, newest, older = generations
    known = newest if how == "both good" else older
    if how in SPOILED:
        SPOILED[how][0](state)
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    log = tmp_path / "log"
    environment = {"LD_PRELOAD": str(power_cut), "CUT_LOG": str(log)} | ({} if links else {"NO_LINKS": "1"})
    begins: list[int] = []
    code = -signal.SIGKILL
    while code == -signal.SIGKILL:
        for path in tmp_path.iterdir():
            path.unlink()
        for path, content in files.items():
            path.write_bytes(content)
        cut = len(begins) + 1
        node = Node("--config", config, "--state", state, environment=environment | {"CUT": str(cut)})
        if node.first:  # the start got through
            node.send(frames[syncs[190] : syncs[200]])
            node.process.send_signal(signal.SIGTERM)
        code = node.process.wait(30.0)
        node.__exit__()
        changes = log.read_text().splitlines() if log.exists() else []
        if code:
            assert len(changes) == cut - 1
            begins.append(went_on(config, state))
    assert code == 0
    assert set(changes) == {"unlink", "open", "write", "fsync", "rename", "fsync of the folder"} | (
        {"link"} if how == "both good" else set()
    )
    assert changes.count("write") > 3
    assert begins[:-1] == (len(changes) - 1) * [known]
    assert begins[-1] > known  # all but the folder was flushed


# ---------------------------------------------------------------- the disk


def limit(node: Node, size: int) -> None:
    """Files may be so large from here on: the disk is full in the middle of a write."""
    hard = resource.prlimit(node.process.pid, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(node.process.pid, resource.RLIMIT_FSIZE, (size, hard))


def test_a_full_disk_ends_nothing(arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """It is said once, and that it is over; the counter is on the bus; the states that there were stay."""
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 50, "--every", 100) as node:
        node.send(frames[: syncs[110] + 1])
        node.worked_off(111)
        good, older = state.read_bytes(), state.with_name("state.zyg.previous").read_bytes()
        limit(node, 1_000_000)
        node.send(frames[syncs[110] + 1 : syncs[330] + 1])
        node.worked_off(331)
        assert state.read_bytes() == good
        assert state.with_name("state.zyg.previous").read_bytes() == older
        assert not state.with_name("state.zyg.partial").exists()
        limit(node, resource.RLIM_INFINITY)
        node.send(frames[syncs[330] + 1 : syncs[390]])
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
        heard = listened(node, arm)
    assert (code, counters["node_unsaved"], counters["node_corrupt"]) == (0, 4, 0)
    assert said.splitlines() == [
        f"zygos-node: {state}: cannot be saved (File too large); remedy: check the folder and its space",
        f"zygos-node: {state}: saved again, after 4 times that it could not be",
    ]
    assert values(heard, "node_unsaved") == [0.0, 0.0, 2.0, 4.0]
    twin = Twin(arm, save_every=50)
    twin.hear(frames[: syncs[390]])
    assert saved(state) == image(twin)


def plain_user() -> tuple[str, ...]:
    """Root may write everywhere, unless that is taken from it."""
    if os.geteuid():
        return ()
    setpriv = shutil.which("setpriv")
    need(setpriv, "setpriv (util-linux)")
    return (str(setpriv), "--bounding-set=-dac_override", "--inh-caps=-dac_override")


def test_a_folder_that_is_not_open_for_writing(config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """As a disk that the kernel has made read-only after an error: what was stored is used, and nothing saved."""
    folder = tmp_path / "states"
    folder.mkdir()
    state = folder / "state.zyg"
    cycle = run_to(config, state, frames, syncs[100])
    good = state.read_bytes()
    folder.chmod(0o555)
    try:
        with Node("--config", config, "--state", state, through=plain_user()) as node:
            assert f"goes on behind cycle {cycle}" in node.first
            node.send(frames[syncs[110] : syncs[140]])
            node.process.send_signal(signal.SIGTERM)
            code, counters, said = node.wait()
    finally:
        folder.chmod(0o755)
    assert node.complaints.startswith(f"zygos-node: {state}: cannot be saved (Permission denied); remedy: ")
    assert (code, counters["node_unsaved"], counters["count_cycles"]) == (2, 1, cycle + 1 + 29)
    assert said.startswith(f"zygos-node: {state}: cannot be saved (Permission denied); remedy: ")
    assert state.read_bytes() == good


def test_what_stands_in_the_way_of_the_older_state_is_said_once(
    config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """The newest is saved all the same."""
    state = tmp_path / "state.zyg"
    (tmp_path / "state.zyg.previous").mkdir()
    with Node("--config", config, "--state", state, "--save-every", 40) as node:
        node.send(frames[: syncs[100]])
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
    assert (code, counters["node_unsaved"]) == (0, 0)
    assert said.count("\n") == 1
    assert f"{state}: cannot be kept as {state}.previous (Is a directory); remedy: remove what stands there" in said
    assert cycle_in(state) == 98


def test_a_pipe_is_no_state(config: Path, tmp_path: Path) -> None:
    """Nor does it wait for somebody who writes into it."""
    pipe = tmp_path / "state.zyg"
    os.mkfifo(pipe)
    node = Node("--config", config, "--state", pipe)
    assert node.process.wait(20.0) == 2
    node.__exit__()
    assert f"{pipe}: cannot be read (Not a regular file); remedy: name a file with --state" in node.complaints


def test_nobody_reads_what_it_says(arm: Arm, config: Path, frames: Log, syncs: Log) -> None:
    """Whoever kept its log has ended: that is no reason to end as well."""
    with Node("--config", config, "--every", 50) as node:
        assert node.process.stderr is not None
        node.process.stderr.close()
        node.send(frames[: syncs[220] + 1])
        node.worked_off(221)
        upset(node)
        node.send(frames[syncs[220] + 1 : syncs[345]])
        node.worked_off(345)
        assert node.process.poll() is None
        node.listen()
        assert values(listened(node, arm), "node_corrupt")[-1] == 1.0
