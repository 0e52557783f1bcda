# SPDX-License-Identifier: MIT
"""zygos-node for aarch64, the processor of the small computers that have a CAN interface, in QEMU's user mode."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

import pytest
from build_support import ROOT, emulated, kept, make, run
from node_support import Log, Node, build, compiled
from runs_support import trajectory_of

from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.native.flight import encode
from zygos.simulation.scenario import load_scenario

pytestmark = pytest.mark.slow
CROSS = "aarch64-linux-gnu-gcc"
# QEMU does not know the count of frames that were dropped; a pair of sockets drops none.
SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/socket.h>

int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    int (*next)(int, int, int, const void *, socklen_t) =
        (int (*)(int, int, int, const void *, socklen_t))dlsym(RTLD_NEXT, "setsockopt");
    return ((level == SOL_SOCKET) && (name == SO_RXQ_OVFL)) ? 0 : next(fd, level, name, value, size);
}
"""


@pytest.fixture(scope="module")
def emulator() -> list[str]:
    return emulated()


@pytest.fixture(scope="module")
def node(emulator: list[str]) -> Path:
    """A folder with the node and with what it lacks in QEMU."""

    def cross(folder: Path) -> None:
        make("node", folder, CC=CROSS)
        (folder / "shim.c").write_text(SHIM)
        run([CROSS, "-shared", "-fPIC", "shim.c", "-o", "shim.so"], folder)

    assert emulator
    return kept(cross, "node", CROSS, SHIM)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Log]:
    """A configuration, and 30 s of frames of its arm."""
    example = ROOT / "examples" / "spatial"
    arm, model = load_arm(example / "arm.toml"), load_model(example / "model.toml")
    scenario = load_scenario(example / "scenario.toml")
    run_of = trajectory_of(arm, model, scenario, seeds=[0], noise=True, duration_s=30.0, rtol=1e-8)
    return compiled(tmp_path_factory.mktemp("onboard"), example / "arm.toml"), encode(arm, run_of.cycles(0))


def test_the_same_frames_give_the_same_bits(
    case: tuple[Path, Log], node: Path, emulator: list[str], tmp_path: Path
) -> None:
    """Of the saved state, of the telemetry with the refined values, and of all counters."""
    config, frames = case
    through = (*emulator, "-E", f"LD_PRELOAD={node / 'shim.so'}")
    here, there = tmp_path / "here.zyg", tmp_path / "there.zyg"
    told = []
    for state, program, how in ((here, build(), ()), (there, node / "zygos-node", through)):
        with Node("--config", config, "--state", state, "--refine", 0, program=program, through=how) as one:
            one.send(frames)
            counters = one.end()
            told.append((counters, one.of(0x1A0)))
    assert told[0][0]["count_cycles"] > 500
    assert len(told[0][1]) > 100
    assert told[1] == told[0]
    assert there.read_bytes() == here.read_bytes()


def test_help_and_refusals(node: Path, emulator: list[str], tmp_path: Path) -> None:
    """The words and the codes are those of the host."""
    config = compiled(tmp_path)
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        for words, code in (
            (["--help"], 0),
            (["--config", "nowhere.zyg", "--fd", "0"], 2),
            (["--config", str(config), "-i", "nothere0"], 2),
            (["--config", str(config), "--fd", str(far.fileno()), "--state", str(tmp_path)], 2),
        ):
            shim = ["-E", f"LD_PRELOAD={node / 'shim.so'}"]
            done = [
                subprocess.run([*command, *words], pass_fds=[far.fileno()], capture_output=True, text=True, check=False)
                for command in ([str(build())], [*emulator, *shim, str(node / "zygos-node")])
            ]
            assert [one.returncode for one in done] == [code, code]
            assert [one.stdout for one in done] == 2 * [done[0].stdout]
            assert all("usage: " in one.stdout if code == 0 else "remedy: " in one.stderr for one in done)
