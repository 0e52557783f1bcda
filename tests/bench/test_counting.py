# SPDX-License-Identifier: MIT
"""What counts instructions, counts right: on programs and files whose instructions were counted by hand."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bench import callgrind, cortex
from bench.counting import PLACES, ROOMS, STAGES, Count, Tally, spread_by_data
from conftest import need

KNOWN = r"""
int main(void);
__attribute__((naked, noinline)) void loop(void) /* 2 + 10 * 3 + 1 */
{
    __asm volatile("mov r0, #10\n nop\n 1: nop\n subs r0, #1\n bne 1b\n bx lr");
}
__attribute__((naked, noinline)) void stage(void) /* 5 beside the loop, twice */
{
    __asm volatile("push {r4, lr}\n bl loop\n nop\n bl loop\n pop {r4, pc}");
}
__attribute__((naked, noinline)) void mark(void)
{
    __asm volatile("bx lr");
}
int main(void)
{
    for (int k = 0; k < 3; k++) {
        stage();
        mark();
    }
    return 0;
}
"""

CALLGRIND = """\
desc: Trigger: --dump-after=driver_mark

fl=(1) /x/c/zygos.c
fn=(1) zygos_frame
1 10

fn=(3) zygos_step
1 3
cfi=(2) /x/c/cycle.c
cfn=(2) zygos_receiver_frame
calls=1 5
* 100
cfi=(8) /x/c/arm.c
cfn=(10) zygos_arm_step
calls=1 2
+1 212

fl=(8)
fn=(10)
1 5
cfn=(4) helper
calls=1 2
+1 207

fn=(4)
9 1
cfi=(3) /x/c/smoother.c
cfn=(5) zygos_smoother_push
calls=1 1
* 200
* 2
cfn=(6) aside
calls=1 1
* 4

fl=(2)
fn=(2)
1 30
fi=(4) /x/include/inlined.h
2 10
fe=(2)
cfi=(5) /x/c/wire.c
cfn=(7) zygos_wire_decode
calls=2 1
* 60

fl=(5)
fn=(7)
1 60

fl=(3)
fn=(5)
1 200

fl=(8)
fn=(6)
1 4

desc: Trigger: --dump-after=driver_mark

fl=(6) /x/c/solver.c
fn=(8) zygos_work_solve
1 77

desc: Trigger: Program termination

fl=(6)
fn=(8)
1 5
cfi=(7) /x/libm.c
cfn=(9) sqrt
calls=1 1
* 6
"""


def test_the_plugin_counts_what_a_processor_executes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop of assembly, called twice a part; each function on its own, and the stage with all that it calls."""
    for program in (*cortex.firmware.TOOLS, "arm-none-eabi-nm"):
        need(shutil.which(program), f"{program}: the counts on Cortex-M stay unchecked")
    needed = [room for room in cortex.firmware.ROOMS if room.stem in ("core", "semihosting", "capacities")]
    monkeypatch.setattr(cortex.firmware, "ROOMS", needed)
    (tmp_path / "known.c").write_text(KNOWN)
    elf = cortex.firmware.build("m7", tmp_path / "known.elf", [tmp_path / "known.c"])
    listing = subprocess.run(["arm-none-eabi-nm", "-n", str(elf)], capture_output=True, text=True, check=True).stdout
    symbols = [line.split() for line in listing.splitlines() if line.split()[1] in "TtWw"]
    room = {"stage": 2, "loop": -2, "mark": -3}
    lines = []
    for k, (address, _, name) in enumerate(symbols):
        end = int(symbols[k + 1][0], 16) if k + 1 < len(symbols) else int(address, 16) + 0x1000
        size = end - int(address, 16)
        lines.append(f"{address} {size} {room.get(name, -3)} {1 if name == 'stage' else -1} {int(name == 'mark')}")
    (tmp_path / "symbols.txt").write_text("3 0 1\n" + "\n".join(lines) + "\n")
    parts = cortex.run("m7", elf, tmp_path)
    columns = parts.reshape(-1, 3 + len(lines))
    names = [name for _, _, name in symbols]
    assert columns.shape[0] == 4, "three marks, and the end"
    loop, stage = 2 + 10 * 3 + 1, 5
    np.testing.assert_array_equal(columns[:3, 3 + names.index("loop")], 2 * loop)
    np.testing.assert_array_equal(columns[:3, 3 + names.index("stage")], stage)
    np.testing.assert_array_equal(columns[:3, 2], stage + 2 * loop)
    np.testing.assert_array_equal(columns[:3, 1], stage + 2 * loop)
    assert not columns[3].any()


def test_stages_of_a_callgrind_file(tmp_path: Path) -> None:
    """Calls from zygos.c and arm.c are booked on the file of the callee, those of cycle.c into wire.c on wire; what
    the background does between two cycles is not counted."""
    path = tmp_path / "callgrind.out"
    path.write_text(CALLGRIND)
    tally = callgrind.tally_of(path)
    found = dict(zip(STAGES, tally.stages[0].tolist(), strict=True))
    assert len(tally.stages) == 1
    assert (found["frame"], found["step"]) == (10, 315)
    assert (found["cycle"], found["wire"], found["smoother"]) == (40, 60, 200)
    assert tally.solve == 11
    assert {name: int(calls[0]) for name, calls in tally.functions.items()} == {
        "zygos: zygos_frame": 10,
        "zygos: zygos_step": 3,
        "arm: zygos_arm_step": 5,
        "arm: helper": 3,
        "arm: aside": 4,
        "cycle: zygos_receiver_frame": 40,
        "wire: zygos_wire_decode": 60,
        "smoother: zygos_smoother_push": 200,
    }


def test_the_spread_is_that_of_cycles_at_the_same_place() -> None:
    """Rooms that differ by their rings have none; one instruction that a place does not explain is one."""
    n = 240
    places = np.zeros((n, len(PLACES)), dtype=np.int64)
    places[:, PLACES.index("position")] = np.arange(n) % 11
    places[:, PLACES.index("filled")] = np.arange(n) % 8
    stages = np.zeros((n, len(STAGES)), dtype=np.int64)
    stages[:, STAGES.index("smoother")] = 100 + places[:, PLACES.index("position")]
    stages[:, STAGES.index("accumulator")] = 500 + 40 * places[:, PLACES.index("filled")]
    stages[:, STAGES.index("step")] = stages[:, [STAGES.index(room) for room in ROOMS]].sum(axis=1) + 20
    kinds = np.full(n, 3)

    def spread(stage: str) -> int:
        return spread_by_data(Count(Tally(stages, {}, 0), {}, kinds, places, 0, 0), stage)

    assert {stage: spread(stage) for stage in ("smoother", "accumulator", "step")} == {
        "smoother": 0, "accumulator": 0, "step": 0,
    }  # fmt: skip
    stages[100, STAGES.index("smoother")] += 1
    stages[100, STAGES.index("step")] += 1
    assert (spread("smoother"), spread("accumulator"), spread("step")) == (1, 0, 1)
    kinds[100] = 2
    assert spread("step") == 0, "an arc ends there"
