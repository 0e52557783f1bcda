# SPDX-License-Identifier: MIT
"""zygos-node among other programs: it writes into no file but its own, shares its state with no other node, gives up
its rights, and ends in order."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from node_support import Log, Node, build, saved

from conftest import ROOT, need

NOBODY = 65534
"""Number of a user and of a group without rights."""
PLAIN = (f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
"""Options of setpriv, for that user."""


def named(state: Path, suffix: str) -> Path:
    return state.with_name(state.name + suffix)


def refused(node: Node) -> str:
    """What a node says that does not start."""
    try:
        assert node.process.wait(20.0) == 2
    finally:
        node.__exit__()
    assert "remedy: " in node.complaints
    return node.complaints


# ---------------------------------------------------------------- the file that is written


@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_no_file_of_others_is_written(
    link: Callable[[Path, Path], None], config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """A name for it stands where the node writes: the file stays, and the state is saved."""
    state, victim = tmp_path / "state.zyg", tmp_path / "victim"
    victim.write_text("of others")
    link(victim, named(state, ".partial"))
    with Node("--config", config, "--state", state) as node:
        node.send(frames[: syncs[30]])
        node.end()
    assert victim.read_text() == "of others"
    assert saved(state)
    assert state.is_file()
    assert not state.is_symlink()


def test_a_pipe_where_it_writes_holds_nothing_up(config: Path, tmp_path: Path) -> None:
    state = tmp_path / "state.zyg"
    os.mkfifo(named(state, ".partial"))
    with Node("--config", config, "--state", state) as node:
        node.end()
    assert saved(state)


# ---------------------------------------------------------------- the lock


def test_a_second_node_on_the_same_state_is_refused(config: Path, tmp_path: Path) -> None:
    """Also under another path to the folder. The file of the lock stays, and locks nothing when its node has ended."""
    state, folder = tmp_path / "states" / "state.zyg", tmp_path / "folder"
    state.parent.mkdir()
    folder.symlink_to(state.parent)
    with Node("--config", config, "--state", state) as first:
        for path in (state, folder / "state.zyg"):
            said = refused(Node("--config", config, "--state", path))
            assert said.startswith(f"zygos-node: {path}: another node has this state in use; remedy: ")
        with Node("--config", config, "--state", tmp_path / "states" / "other.zyg") as second:
            second.end()
        assert first.process.poll() is None
        first.process.kill()
        first.process.wait()
    assert named(state, ".lock").exists()
    with Node("--config", config, "--state", state) as third:
        assert third.complaints == ""
        third.end()


def test_what_stands_in_the_way_of_the_lock_is_said(config: Path, tmp_path: Path) -> None:
    state, victim = tmp_path / "state.zyg", tmp_path / "victim"
    named(state, ".lock").symlink_to(victim)
    said = refused(Node("--config", config, "--state", state))
    assert f"{state}.lock: cannot be locked (Too many levels of symbolic links); remedy: remove it" in said
    assert not victim.exists()
    named(state, ".lock").unlink()
    os.mkfifo(named(state, ".lock"))
    with Node("--config", config, "--state", state) as node:
        node.end()


# ---------------------------------------------------------------- signals


def test_a_closed_terminal_ends_it_in_order(config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    state = tmp_path / "state.zyg"
    # the tests themselves may run under nohup
    with Node("--config", config, "--state", state, through=("env", "--default-signal=HUP")) as node:
        node.send(frames[: syncs[30]])
        node.process.send_signal(signal.SIGHUP)
        code, counters, said = node.wait()
    assert (code, counters["count_cycles"], said) == (0, 29, "")
    assert saved(state)


def test_a_closed_terminal_does_not_end_it_under_nohup(config: Path) -> None:
    with Node("--config", config, through=("env", "--ignore-signal=HUP")) as node:
        node.process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            node.process.wait(0.3)
        node.end()


# ---------------------------------------------------------------- the user


def setpriv(*words: str) -> tuple[str, ...]:
    """A command that starts another one with these rights."""
    found = shutil.which("setpriv")
    need(found, "setpriv (util-linux)")
    return (str(found), *words)


@pytest.fixture
def shared(config: Path) -> Iterator[Path]:
    """A folder that every user can reach and that belongs to nobody, with the configuration."""
    need(os.geteuid() == 0, "root, who may become another user")
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        shutil.copy(config, folder / "arm.zyg")
        folder.chmod(0o755)
        os.chown(folder, NOBODY, NOBODY)
        yield folder


def rights(node: Node) -> dict[str, str]:
    """What the kernel says of the rights of the running node."""
    status = Path(f"/proc/{node.process.pid}/status").read_text()
    return {name: " ".join(value.split()) for name, value in re.findall(r"^(\w+):(.*)$", status, re.M)}


@pytest.mark.parametrize(
    ("owner", "user", "becomes"),
    [(NOBODY, (), NOBODY), (0, ("--user", "nobody"), NOBODY), (0, (), 0), (NOBODY, ("--user", "root"), 0)],
)
def test_root_gives_up_its_rights(owner: int, user: tuple[str, ...], becomes: int, shared: Path) -> None:
    """It becomes the user that is asked for, otherwise the owner of the folder of the state; no capability is left."""
    state = shared / "state.zyg"
    os.chown(shared, owner, owner)
    shared.chmod(0o777)
    with Node("--config", shared / "arm.zyg", "--state", state, *user, through=setpriv("--groups=0,1")) as node:
        found = rights(node)
        assert node.complaints == ""
        node.end()
    assert found["Uid"].split() == found["Gid"].split() == 4 * [str(becomes)]
    assert becomes == 0 or found["Groups"] == ""
    assert {found[name] for name in ("CapInh", "CapPrm", "CapEff", "CapAmb")} == {"0000000000000000"}
    assert found["NoNewPrivs"] == "1"
    assert state.stat().st_uid == becomes


def test_a_capability_that_a_supervisor_gives_is_given_up(shared: Path) -> None:
    """As the unit for systemd does, for the buffer of the socket."""
    user = setpriv(*PLAIN, "--inh-caps=+net_admin", "--ambient-caps=+net_admin")
    program = shutil.copy(build(), shared / "zygos-node")
    with Node("--config", shared / "arm.zyg", through=user, program=program) as node:
        assert {rights(node)[name] for name in ("CapInh", "CapPrm", "CapEff", "CapAmb")} == {"0000000000000000"}
        node.end()


def test_without_a_state_it_becomes_the_owner_of_the_configuration(shared: Path) -> None:
    os.chown(shared / "arm.zyg", NOBODY, NOBODY)
    with Node("--config", shared / "arm.zyg") as node:
        assert rights(node)["Uid"].split() == 4 * [str(NOBODY)]
        node.end()


def test_a_configuration_that_the_user_cannot_read_again_is_complained_of(shared: Path) -> None:
    (shared / "arm.zyg").chmod(0o600)
    with Node("--config", shared / "arm.zyg", "--state", shared / "state.zyg") as node:
        node.end()
    assert node.complaints.startswith(f"zygos-node: {shared}/arm.zyg: user {NOBODY} cannot read it (Permission denied)")
    assert "; remedy: " in node.complaints


def test_a_user_that_it_cannot_become_is_refused(shared: Path) -> None:
    config = ("--config", shared / "arm.zyg")
    assert "--user nobody9: no such user; remedy: " in refused(Node(*config, "--user", "nobody9"))
    plain = setpriv(*PLAIN)
    program = shutil.copy(build(), shared / "zygos-node")
    said = refused(Node(*config, "--user", "root", through=plain, program=program))
    assert "--user root: cannot be taken (Operation not permitted); remedy: start as root" in said
    with Node(*config, "--user", "nobody", through=plain, program=program) as node:
        node.end()


# ---------------------------------------------------------------- the service


def test_it_is_installed_as_a_service(tmp_path: Path) -> None:
    """Program and unit, with the path of the program and with options that it has. The unit gives no right that the
    node does not need; systemd, where it is there, knows all keys and rates it."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    words = ["make", "--silent", f"PREFIX={tmp_path}", f"BUILD={build().parent}"]
    subprocess.run([*words, "install-node"], cwd=ROOT, env=environment, check=True)
    (path,) = tmp_path.glob("lib/systemd/system/*")
    lines = [line.partition("=") for line in path.read_text().splitlines() if "=" in line and not line.startswith("#")]
    unit = {key: value for key, _, value in lines}
    command = unit["ExecStart"].split()
    said = subprocess.run([command[0], "--help"], capture_output=True, text=True, check=True).stdout
    assert command[0] == str(tmp_path / "bin" / "zygos-node")
    assert all(word in said for word in command if word.startswith("-"))
    assert unit["DynamicUser"] == unit["NoNewPrivileges"] == unit["PrivateDevices"] == "yes"
    assert unit["ProtectSystem"] == "strict"
    assert unit["CapabilityBoundingSet"] == unit["AmbientCapabilities"] == "CAP_NET_ADMIN"
    assert unit["RestrictAddressFamilies"] == "AF_CAN AF_UNIX"
    filters = [value for key, _, value in lines if key == "SystemCallFilter"]
    assert filters == ["@system-service", "~@privileged @resources", "capset"]
    assert command[command.index("--state") + 1].startswith(f"/var/lib/{unit['StateDirectory']}/")
    systemd = shutil.which("systemd-analyze")
    for asked in [["verify"], ["security", "--offline=true", "--threshold=20"]] if systemd else []:
        done = subprocess.run([str(systemd), *asked, path], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert path.name not in done.stderr, done.stderr
    subprocess.run([*words, "uninstall"], cwd=ROOT, env=environment, check=True)
    assert not [left for left in tmp_path.rglob("*") if left.is_file()]
