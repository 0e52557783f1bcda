# SPDX-License-Identifier: MIT
"""examples/onboard: what users would write around the library, built as they would and run where it can."""

from __future__ import annotations

import ctypes
import random
import re
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cantools
import cli_support
import numpy as np
import pytest
from build_support import ONBOARD, ROOT, emulated, flags_of, onboard, run, tool
from loop_support import Loop
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.bus import write_log
from zygos.native.flight import FRAME, accepted, config_of, encode, ffi, lib
from zygos.simulation.plant import Trajectory

PAYLOAD_CHANGED = 0x7F0
TELEMETRY = 0x1A0
Estimates = dict[int, tuple[int, int, dict[int, tuple[float, float]]]]
"""By cycle: validity, reason, and value and half95 of what is known."""


@pytest.fixture(scope="module")
def program() -> Path:
    return onboard() / "onboard"


@pytest.fixture(scope="module")
def frames(arm: Arm, noisy: Trajectory) -> NDArray[Any]:
    """The run of examples/lively, 60 s."""
    return encode(arm, noisy.cycles())


def starts(frames: NDArray[Any]) -> NDArray[np.intp]:
    """Where the SYNCs are."""
    return np.flatnonzero(frames["id"] == 0x080)


def log_of(frames: NDArray[Any], arm: Arm, folder: Path, name: str = "run.log") -> Path:
    write_log(folder / name, frames, arm.period_s)
    return folder / name


def estimates(text: str) -> Estimates:
    found: Estimates = {}
    for block in re.split(r"^cycle ", text, flags=re.M)[1:]:
        head = re.match(r"(\d+): validity (\d+), reason (\d+), learned in cycle (\d+)\n", block)
        assert head is not None
        values = re.findall(r"^ +(\d+)  (\S+) \+- (\S+)$", block, re.M)
        known = {int(i): (float(value), float(half)) for i, value, half in values}
        found[int(head[1])] = int(head[2]), int(head[3]), known
    return found


def telemetry(text: str) -> list[str]:
    """Frames that the host program sent, as slcan writes them."""
    return [f"t{m[1]}{len(m[2]) // 2}{m[2]}" for m in re.finditer(r"can0 ([0-9A-F]{3})#([0-9A-F]+)$", text, re.M)]


class Expected:
    """The same calls through cffi: what each estimate of the example has to be."""

    def __init__(self, arm: Arm) -> None:
        self.loop = Loop(config_of(arm))
        self.known: dict[int, tuple[float, float]] = {}
        self.found: Estimates = {}
        self.payload = False
        self.told = 0
        """Frames of telemetry."""

    def frames(self, frames: NDArray[Any]) -> None:
        """Feed frames, one by one."""
        frame = ffi.from_buffer("zygos_frame_t[]", frames.tobytes())
        for k in range(len(frames)):
            self.loop.receive(frame + k)
            if self.payload:
                lib.zygos_restart(self.loop.native, lib.ZYGOS_KEEP_FAULTS | lib.ZYGOS_KEEP_JOINTS)
                self.payload = False
            while self.loop.step() == 1:
                pass
            if self.loop.solve() == 1:
                self._use(self.loop.estimate)

    def _use(self, estimate: Any) -> None:
        self.told += 2
        if estimate.validity >= lib.ZYGOS_PARTIAL:
            rows = [i for i in range(estimate.parameters) if estimate.identifiable[i] == 1]
            self.known |= {i: (estimate.value[i], estimate.half95[i]) for i in rows}
            self.told += 2 * len(rows)
        self.found[estimate.cycle] = estimate.validity, estimate.reason, dict(self.known)


@pytest.mark.parametrize("text", ["080#A", "080#A\n", "080#+1\n", "080\n", "#01\n", "080#010203040506070809\n"])
def test_a_line_that_is_none_is_refused(program: Path, tmp_path: Path, text: str) -> None:
    log = tmp_path / "bad.log"
    log.write_text("(0.0) can0 080#01\n(0.0) can0 " + text)
    done = subprocess.run([program, log], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "no line of candump's; remedy: " in done.stderr


def test_the_loop_gives_the_bits_of_the_library(
    program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path, true: NDArray[np.float64]
) -> None:
    text = run([str(program), str(log_of(frames, arm, tmp_path))], tmp_path)
    found = estimates(text)
    expected = Expected(arm)
    expected.frames(frames)
    assert found == expected.found
    assert len(found) >= 5
    newest = max(found)
    validity, _, known = found[newest]
    assert newest > 600
    assert validity == lib.ZYGOS_VALID
    assert np.array([known[i][0] for i in range(12)]) == pytest.approx(true, rel=0.02)
    # zygos.dbc reads what goes to the ground: the same in single precision, with the counter of the SYNC behind
    decode = cantools.database.load_file(ROOT / "include" / "zygos" / "zygos.dbc").decode_message
    sent = [decode(TELEMETRY, bytes.fromhex(line[5:])) for line in telemetry(text)]
    told = {name: value for signals in sent for name, value in signals.items() if name in arm.parameter_names}
    assert told == {name: np.float32(known[i][0]) for i, name in enumerate(arm.parameter_names)}
    for name, of in (("verdict_validity", 0), ("verdict_reason", 1)):
        assert [signals[name] for signals in sent if name in signals] == [row[of] for row in found.values()]


@pytest.mark.slow
def test_a_big_endian_leon3_gives_the_same_bits(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    """flight.c and the library, compiled for LEON3, in QEMU's user mode. It refuses a state of the other byte order."""
    qemu, log = tool("qemu-sparc32plus"), log_of(frames, arm, tmp_path)
    tool("sparc64-linux-gnu-gcc")
    words = ["CC=sparc64-linux-gnu-gcc", "CFLAGS=-m32 -mcpu=leon3 -static", f"ZYGOS={onboard('leon3') / 'zygos'}"]
    run([tool("make"), "-s", f"BUILD={tmp_path / 'build'}", *words], ONBOARD)
    leon3 = tmp_path / "build" / "onboard"
    little, big = tmp_path / "little", tmp_path / "big"
    text = run([str(program), str(log), str(little)], tmp_path)
    assert run([qemu, str(leon3), str(log), str(big)], tmp_path) == text
    assert run([str(program), str(log), str(little)], tmp_path) == run([qemu, str(leon3), str(log), str(big)], tmp_path)
    assert run([str(program), str(log), str(big)], tmp_path).startswith("started")


@pytest.mark.slow
def test_an_aarch64_gives_the_same_bits(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    """flight.c and the library in QEMU's user mode: the same text and the same stored state, from which both go on."""
    words = [*emulated(), str(onboard("aarch64") / "onboard"), str(log_of(frames, arm, tmp_path))]
    here, there = tmp_path / "here", tmp_path / "there"
    for begin in ("started", "resumed"):
        text = run([str(program), words[-1], str(here)], tmp_path)
        assert text.startswith(begin)
        assert run([*words, str(there)], tmp_path) == text
        assert there.read_bytes() == here.read_bytes()


def test_a_payload_starts_the_bodies_anew(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    change = np.zeros(1, dtype=FRAME)
    change["id"] = PAYLOAD_CHANGED
    at = starts(frames)[700] + 3
    found = estimates(run([str(program), str(log_of(np.insert(frames, at, change), arm, tmp_path))], tmp_path))
    expected = Expected(arm)
    expected.frames(frames[:at])
    assert accepted(expected.loop.state) > 0
    expected.payload = True
    expected.known = {i: known for i, known in expected.known.items() if i >= len(arm.body_parameters)}
    expected.frames(frames[at:])
    assert found == expected.found


# Estimates as they are told, every 200 cycles, in place of the library's; the payload changes at the fourth.
SOLVER = """
#include "flight.h"
#include <string.h>

int __wrap_zygos_solve(zygos_t *self, zygos_estimate_t *out)
{
    static const uint32_t validity[] = { ZYGOS_PARTIAL, ZYGOS_DOUBTFUL, ZYGOS_REFUSED, ZYGOS_VALID, ZYGOS_VALID };
    static uint32_t calls;
    if ((self->state.cycles < 200u * (calls + 1u)) || (calls > 4u)) {
        return 0;
    }
    memset(out, 0, sizeof *out);
    out->cycle = 200u * (calls + 1u);
    out->parameters = 12;
    out->validity = validity[calls];
    out->reason = (out->validity == ZYGOS_REFUSED) ? ZYGOS_REASON_CORRUPT : ZYGOS_REASON_NONE;
    for (uint32_t i = 0; i < 12; i++) {
        out->identifiable[i] = (uint32_t)((calls > 0) || (i % 2 == 0));
        out->value[i] = 100.0 * (calls + 1) + i;
    }
    calls++;
    if (calls == 4) {
        zygos_frame_t changed = { .id = FLIGHT_PAYLOAD_CHANGED };
        flight_receive(&changed);
        return 0; /* as the library does after a restart */
    }
    return 1;
}
"""


def test_what_is_believed_follows_from_validity(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    (tmp_path / "solver.c").write_text(SOLVER)
    zygos = program.parent / "zygos"
    flags = run(
        [tool("pkg-config"), "--cflags", "--libs", "zygos"],
        tmp_path,
        PKG_CONFIG_LIBDIR=str(zygos / "lib" / "pkgconfig"),
    ).split()
    sources = [str(ONBOARD / "flight.c"), str(ONBOARD / "host.c"), "solver.c"]
    command = [tool("gcc"), "-std=c11", f"-I{ONBOARD}", *sources, *flags, "-Wl,--wrap=zygos_solve", "-o", "scripted"]
    run(command, tmp_path)
    text = run([str(tmp_path / "scripted"), str(log_of(frames, arm, tmp_path))], tmp_path)
    known = {cycle: {i: value for i, (value, _) in row[2].items()} for cycle, row in estimates(text).items()}
    partial = {i: 100.0 + i for i in range(0, 12, 2)}
    assert known[200] == known[400] == known[600] == partial  # what is doubtful or refused replaces nothing
    assert known[1000] == {i: 500.0 + i for i in range(12)}
    verdicts = [bytes.fromhex(line[5:]) for line in telemetry(text) if line[11:13] == "03"]
    assert [(data[2], np.frombuffer(data[4:], "<f4")[0]) for data in verdicts[4:6]] == [
        (0, lib.ZYGOS_REFUSED),
        (1, lib.ZYGOS_REASON_CORRUPT),
    ]


def test_a_stored_state_goes_on(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    half = int(starts(frames)[650])
    first, second = log_of(frames[:half], arm, tmp_path, "a.log"), log_of(frames[half:], arm, tmp_path, "b.log")
    state = tmp_path / "state"
    assert run([str(program), str(first), str(state)], tmp_path).startswith("started")
    kept = state.read_bytes()
    text = run([str(program), str(second), str(state)], tmp_path)
    assert text.startswith("resumed")
    expected = Expected(arm)
    expected.frames(frames[:half])
    loop, head = expected.loop, ffi.new("uint8_t[]", lib.ZYGOS_SNAPSHOT_HEAD_VALUE)
    assert lib.zygos_seal(loop.native, head) == 1
    length = len(head) + ffi.sizeof("zygos_arm_t")
    memory = ffi.sizeof(loop.memory[0])
    assert lib.zygos_resume(loop.native, loop.config, loop.memory, memory, head, length) == 1
    expected.known, expected.found = {}, {}
    expected.frames(frames[half:])
    assert len(expected.found) >= 2
    assert estimates(text) == expected.found
    # whatever is wrong with it, the estimate starts from nothing
    fresh = run([str(program), str(second)], tmp_path)
    assert fresh.startswith("started")
    assert estimates(fresh) != expected.found
    spoilt = bytearray(kept)
    spoilt[len(kept) // 2] ^= 1
    for bad in (bytes(spoilt), kept[:-1], kept + b"\0", b"", b"no state"):
        state.write_bytes(bad)
        assert run([str(program), str(second), str(state)], tmp_path) == fresh


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "usage"),
        (["nowhere.log"], "remedy: name a log"),
        (["bad.log"], "remedy: record with candump"),
        (["empty.log", "nowhere/state"], "the state cannot be written"),
    ],
)
def test_the_program_refuses_what_it_cannot_use(program: Path, words: list[str], told: str, tmp_path: Path) -> None:
    (tmp_path / "bad.log").write_text("(0.0) vcan0 080#01\nSYNC 1\n")
    (tmp_path / "empty.log").write_text("")
    done = subprocess.run([str(program), *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert told in done.stderr


def test_what_the_library_does_not_decode_passes(program: Path, frames: NDArray[Any], arm: Arm, tmp_path: Path) -> None:
    """Frames of all kinds that candump writes change nothing, but an error frame of bus-off, which ends the arc."""
    expected = run([str(program), str(log_of(frames, arm, tmp_path))], tmp_path)
    lines = (tmp_path / "run.log").read_text().splitlines()
    foreign = ["12345678#0011223344556677", "080##1AABB", "181#R", "181#R8", "20000004#0000000000000000", "7FF#"]
    for k, line in enumerate(foreign):
        lines.insert(100 * (k + 1), f"(1.0) can0 {line}")
    (tmp_path / "more.log").write_text("\n".join(lines) + "\n")
    assert run([str(program), str(tmp_path / "more.log")], tmp_path) == expected
    lines.insert(3000, "(1.0) can0 20000040#0000000000000000")
    (tmp_path / "more.log").write_text("\n".join(lines) + "\n")
    assert run([str(program), str(tmp_path / "more.log")], tmp_path) != expected


def test_the_configuration_is_that_of_the_paper(tmp_path: Path) -> None:
    """arm_config.h and arm.zyg are what `zygos compile-model` writes."""
    assert cli_support.run("compile-model", ROOT / "examples/paper/arm.toml", "-o", tmp_path) == 0
    assert (ONBOARD / "arm_config.h").read_text() == (tmp_path / "arm_config.h").read_text()
    assert (ONBOARD / "arm.zyg").read_bytes() == (tmp_path / "arm.zyg").read_bytes()


def test_a_copy_of_the_folder_links_what_is_installed(program: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(ONBOARD, tmp_path / "mine", ignore=shutil.ignore_patterns("build"))
    run([tool("make"), "-s", f"ZYGOS={program.parent / 'zygos'}", "CC=gcc", f"CFLAGS={flags_of('gcc')}"], copy)
    assert (copy / "build" / "host" / "onboard").read_bytes() == program.read_bytes()


def test_another_target_is_refused(tmp_path: Path) -> None:
    command = [tool("make"), "TARGET=z80", f"BUILD={tmp_path / 'b'}"]
    done = subprocess.run(command, cwd=ONBOARD, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "remedy: TARGET=host" in done.stderr
    assert not (tmp_path / "b").exists()


def test_an_arm_that_the_build_does_not_hold_is_refused(tmp_path: Path) -> None:
    """arm_config.h knows what capacities it needs."""
    prefix = shutil.copytree(onboard() / "zygos", tmp_path / "zygos")
    package = prefix / "lib" / "pkgconfig" / "zygos.pc"
    package.write_text(package.read_text().replace("MAX_JOINTS=2", "MAX_JOINTS=1"))
    command = [tool("make"), f"BUILD={tmp_path}/build", f"ZYGOS={prefix}"]
    done = subprocess.run(command, cwd=ONBOARD, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "remedy: compile with -DZYGOS_MAX_JOINTS=2" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "machine", "prefix"),
    [("m7", "ARM", "arm-none-eabi"), ("m4f", "ARM", "arm-none-eabi"), ("leon3", "Sparc", "sparc64-linux-gnu")],
)
def test_cross_builds_are_whole(target: str, machine: str, prefix: str, tmp_path: Path) -> None:
    tool(f"{prefix}-gcc")
    elf = str(onboard(target) / "onboard")
    head = run([tool(f"{prefix}-readelf"), "-h", elf], tmp_path)
    assert re.search(rf"Machine: +{machine}$", head, re.M), head  # code of V9 would make it "Sparc v8+"
    assert re.search(r"Type: +EXEC", head)
    assert run([tool(f"{prefix}-nm"), "-u", elf], tmp_path) == ""
    if target == "leon3":
        listing = run([tool(f"{prefix}-objdump"), "-d", "-m", "sparc:sparclite", elf], tmp_path)
        assert len(listing.splitlines()) > 5000
        assert "unknown" not in listing, "an instruction that SPARC V8 does not have"


def test_the_v8_runtime_computes_as_the_processor_does(tmp_path: Path) -> None:
    """sparc-v8.c under other names on this machine, against Python's integers and floats."""
    names = ["memcpy", "memmove", "memset", "memcmp", "__fixdfdi", "__fixunsdfdi", "__floatundidf"]
    renamed = [f"-D{name}=v8_{name.strip('_')}" for name in names]
    command = [tool("gcc"), "-std=c11", "-O2", "-ffreestanding", "-shared", "-fPIC", *renamed]
    run([*command, str(ONBOARD / "sparc-v8.c"), "-o", "v8.so"], tmp_path)
    v8 = ctypes.CDLL(str(tmp_path / "v8.so"))
    v8.v8_fixdfdi.argtypes, v8.v8_fixdfdi.restype = [ctypes.c_double], ctypes.c_int64
    v8.v8_fixunsdfdi.argtypes, v8.v8_fixunsdfdi.restype = [ctypes.c_double], ctypes.c_uint64
    v8.v8_floatundidf.argtypes, v8.v8_floatundidf.restype = [ctypes.c_uint64], ctypes.c_double
    draw = random.Random(0)
    integers = [0, 1, 2**32 - 1, 2**32, 2**53 + 1, 2**53 + 3, 2**63 - 1, 2**63, 2**64 - 1]
    integers += [draw.getrandbits(draw.randint(1, 64)) for _ in range(2000)]
    for value in integers:
        assert v8.v8_floatundidf(value) == float(value)
        if float(value) < 2.0**64:
            assert v8.v8_fixunsdfdi(float(value)) == int(float(value))
        if float(value) < 2.0**63:
            assert v8.v8_fixdfdi(-float(value)) == -int(float(value))
    for real in (0.0, 0.999, 1.5, 4294967295.5, 4294967296.75, 1e15 + 0.5):
        assert v8.v8_fixunsdfdi(real) == int(real)
        assert v8.v8_fixdfdi(-real) == int(-real)
    text = bytes(range(64))
    for at, to, size in ((0, 5, 40), (5, 0, 40), (3, 3, 9), (0, 1, 0)):
        moved = ctypes.create_string_buffer(text, 64)
        base = ctypes.addressof(moved)
        v8.v8_memmove(ctypes.c_void_p(base + to), ctypes.c_void_p(base + at), ctypes.c_size_t(size))
        assert moved.raw == text[:to] + text[at : at + size] + text[to + size :]
    set_to = ctypes.create_string_buffer(text, 64)
    v8.v8_memset(set_to, 0x1FF, ctypes.c_size_t(10))
    assert set_to.raw == b"\xff" * 10 + text[10:]
    for one, other in ((b"ab\xff", b"ab\x01"), (b"abc", b"abd"), (b"abc", b"abc")):
        assert np.sign(v8.v8_memcmp(one, other, ctypes.c_size_t(3))) == (one > other) - (one < other)


class Serial:
    """A program in QEMU and its serial line."""

    def __init__(self, command: list[str]) -> None:
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.text = ""
        self.changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while part := self.process.stdout.read1():  # type: ignore[attr-defined]
            with self.changed:
                self.text += part.decode("ascii")
                self.changed.notify()

    def send(self, text: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(text.encode("ascii"))
        self.process.stdin.flush()

    def wait(self, pattern: str, count: int) -> None:
        """Until the text that came holds a pattern so many times; a minute at the most."""

        def ready() -> bool:
            return len(re.findall(pattern, self.text)) >= count

        with self.changed:
            assert self.changed.wait_for(ready, timeout=60.0), self.text[-500:]


@pytest.fixture
def qemu() -> Iterator[Callable[[str, Path], Serial]]:
    started: list[Serial] = []

    def start(machine: str, elf: Path) -> Serial:
        command = [tool("qemu-system-arm"), "-M", machine, "-display", "none", "-monitor", "none", "-serial", "stdio"]
        started.append(Serial([*command, "-kernel", str(elf)]))
        return started[-1]

    yield start
    for one in started:
        one.process.kill()
        one.process.wait()


@pytest.mark.slow
@pytest.mark.parametrize(("target", "machine"), [("m7", "mps2-an500"), ("m4f", "mps2-an386")])
def test_a_cortex_m_sends_what_the_host_sends(
    target: str,
    machine: str,
    program: Path,
    frames: NDArray[Any],
    arm: Arm,
    tmp_path: Path,
    qemu: Callable[[str, Path], Serial],
) -> None:
    """600 cycles of frames over slcan: the verdicts and values of all estimates come back, bit by bit.

    The frames of a cycle are awaited before the next, and so is each estimate: a ring holds 40 cycles, and how long the
    solver takes depends on what else runs here.
    """
    tool("arm-none-eabi-gcc")
    syncs = starts(frames)[:601]
    some = frames[: syncs[-1] + 1]
    expected = telemetry(run([str(program), str(log_of(some, arm, tmp_path))], tmp_path))
    here, sent = Expected(arm), {}
    for k, part in enumerate(np.split(some, syncs[1:])):
        before = len(here.found)
        here.frames(part)
        if len(here.found) > before:
            sent[k] = here.told
    assert sent[max(sent)] == len(expected) >= 2 * len(sent) + 2 * 8
    line = qemu(machine, onboard(target) / "onboard")
    line.send("O\r")
    line.wait("\r", 1)
    for k, part in enumerate(np.split(some, syncs[1:])):
        line.send("".join(f"t{f['id']:03X}{f['length']}{bytes(f['data'][: f['length']]).hex()}\r" for f in part))
        line.wait(r"z\r", int(syncs[k]) + len(part))
        if k in sent:
            line.wait(r"t1A0\w+\r", sent[k])
    answers = [word for word in line.text.replace("z\r", "").split("\r") if word]
    assert answers == expected
