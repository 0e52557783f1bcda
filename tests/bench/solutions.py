# SPDX-License-Identifier: MIT
"""What solutions cost by what their answer is: pairs of Cholesky factorisations and instructions, counted by callgrind.

Most of a solution are its factorisations, of which the solver makes two at a time. How many there are depends on the
rows and on the answer, so that the dearest solution is found among states of all kinds: early and late, refused, with
gains, with bad arcs, of a changed arm.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from arm_support import exact_torques, with_gain_sigma
from flight_support import part

from bench.callgrind import COMPILER, ENVIRONMENT, parts
from bench.configurations import CONFIGURATIONS
from bench.counting import DRIVER
from bench.flown import motion
from conftest import ROOT
from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native import flight
from zygos.native.flight import REASONS, VALIDITY, Flight, ffi
from zygos.report.provenance import measured_commit
from zygos.runs.cycles import Cycles

USUAL = "valid, after the whole run"
"""The case with which the others are compared."""
SOLVED = ("paper", "spatial, joint rows")
"""Configurations whose solutions are counted: every case of the first, and some of the other, which has all kinds of
rows."""
ROUND, JOINT_ROUNDS = 5, 10
"""Pairs that weigh a kind of rows: a solution; where more than half of a combination of columns is noise, two for its
share; and two for the scale of the noise. Joint rows beside others are weighed twice."""
ARC_S = 10.0
"""Of the paper's arm here, so that there are several arcs."""
PROGRAM = DRIVER.with_name("solve.c")
_LIBRARY = flight._FOLDER / "libzygos.so"
_PAIR = "solve_both"


@dataclass(frozen=True)
class Bound:
    """The most pairs of factorisations of a solution, as include/zygos/priv/solver.h states at zygos_work_solve()."""

    energy: int
    """Blocks of energy rows."""
    others: int
    """Of motor and momentum rows."""
    groups: int
    """Of joint rows, where they take part."""
    weighing: int
    """c: of the rows of other kinds that are weighed beside the energy rows."""
    gains: bool
    repeats: bool
    """Whether old arcs may be left out."""

    @property
    def once(self) -> int:
        """Of all arcs."""
        return _left_out(self.energy + self.others + self.groups) + self._beside(self.weighing)

    @property
    def most(self) -> int:
        """With those of the newest three quarters and of the newer half, in which joint rows take no part."""
        newer = (self.energy - self.energy // 4, self.energy - self.energy // 2)
        beside = self._beside(self.weighing - (JOINT_ROUNDS if self.groups else 0))
        return self.once + (sum(_left_out(one + self.others) + beside for one in newer) if self.repeats else 0)

    def _beside(self, weighing: int) -> int:
        return 2 * weighing + 17 if self.gains else weighing + 6


def _left_out(blocks: int) -> int:
    """Pairs of blocks that are left out."""
    return (blocks + 1) // 2


@dataclass(frozen=True)
class Solution:
    """A solution that was counted."""

    configuration: str
    case: str
    parameters: int
    validity: str
    reason: str
    left_out: bool
    """Whether it is that without old arcs."""
    pairs: int
    """Of factorisations."""
    once: int
    """The bound of a solution of all arcs."""
    most: int
    """The bound, with solutions without old arcs."""
    instructions: int


def bound(flown: Flight) -> Bound:
    """Of the state that was solved last."""
    work = flown._work
    joints_alone = flown.joints_alone
    energy, motors, momenta = (
        0 if joints_alone else int(count)
        for count in (work.sums.energy.store.closed, work.sums.motors.store.closed, work.sums.momentum.store.closed)
    )
    rows = [float(count) for count in work.sums.joints.count][:-1]
    joints = sum(rows) > 0.0
    weighing = 0
    if not joints_alone:
        weighing += ROUND * (motors + momenta > 0 or joints) + ROUND * (momenta > 0) + JOINT_ROUNDS * joints
    gains = any(effect.kind.key == "torque_gain" for effect in flown.effects)
    repeats = bool(work.sums.guard.adopting) and not joints_alone
    return Bound(energy, motors + momenta, len(rows) if joints else 0, weighing, gains, repeats)


def _fed(arm: Arm, cycles: Cycles) -> Flight:
    flown = Flight(arm)
    flown.cycles(cycles)
    _adopt(flown)
    return flown


def _adopt(flown: Flight) -> None:
    """Adopt the estimate if it is valid, and solve again as from then on."""
    flown.estimate()
    flown.adopt()
    flown.estimate()


def _stuck(cycles: Cycles, arm: Arm, spans: list[tuple[float, float]]) -> Cycles:
    """The first joint's encoder repeats its reading for so many seconds behind an instant."""
    q = cycles.q.copy()
    for begin_s, length_s in spans:
        first, end = (round(t / arm.period_s) for t in (begin_s, begin_s + length_s))
        q[first:end, 0] = q[first - 1, 0]
    return replace(cycles, q=q)


def cases(name: str) -> dict[str, Callable[[], Flight]]:
    """What flies to each state of a configuration. All adopt what is valid, as in flight."""
    one = CONFIGURATIONS[name]()
    cycles, whole = motion(one), len(motion(one))
    every = name == SOLVED[0]
    arm = exact_torques(replace(one.arm, arc_max_s=ARC_S) if every else one.arm)
    gains = with_gain_sigma(arm, 0.01)
    wrong = replace(cycles, tau=cycles.tau * np.linspace(1.0, 1.06, arm.n))
    out: dict[str, Callable[[], Flight]] = {
        USUAL: lambda: _fed(arm, cycles),
        "the gains of the torque sensors are free": lambda: _fed(gains, cycles),
        "a gain is wrong": lambda: _fed(gains, wrong),
    }
    if not every:
        return out
    spans = {
        "a bad first arc": [(5.0, 3.0)],
        "bad first arcs": [(5.0, 35.0)],
        "every arc is bad": [(2.0 + ARC_S * k, 3.0) for k in range(round(whole * arm.period_s / ARC_S))],
    }
    out |= {
        "early": lambda: _fed(arm, part(cycles, 0, whole // 3)),
        "too early": lambda: _fed(arm, part(cycles, 0, whole // 12)),
        "the arm has changed": lambda: _changed(replace(arm, arc_max_s=2.0 * ARC_S), cycles),
        "the arm has changed, short arcs": lambda: _changed(arm, cycles),
    }
    for says, of in spans.items():
        out[says] = partial(_fed, arm, _stuck(cycles, arm, of))
        out[f"{says}, gains free"] = partial(_fed, gains, _stuck(cycles, arm, of))
    return out


def _changed(arm: Arm, cycles: Cycles) -> Flight:
    """The last third is flown by an arm that is heavier and stiffer by 30 %."""
    whole = len(cycles)
    flown = _fed(arm, part(cycles, 0, 2 * whole // 3))
    flown.cycles(part(replace(cycles, tau=1.3 * cycles.tau), 2 * whole // 3, whole))
    flown.estimate()
    return flown


def build(folder: Path) -> Path:
    """Compile the program that solves, beside the library of the harness. Returns it."""
    program = folder / "solve"
    folder.mkdir(parents=True, exist_ok=True)
    includes = [f"-I{ROOT / 'include'}", f"-I{ROOT / 'c' / 'ports' / 'cortex-m'}"]
    options = [one for one in COMPILER if one != "-static"]
    sources = [str(PROGRAM), str(DRIVER.with_name("host.c")), str(_LIBRARY.resolve()), "-lm"]
    subprocess.run(
        [*options, *includes, *sources, f"-Wl,-rpath,{_LIBRARY.parent.resolve()}", "-o", program], check=True
    )
    return program


def counted(name: str, folder: Path, only: Sequence[str] = ()) -> list[Solution]:
    """Solve the states of a configuration, of all cases or of some, and count. Errors: ZygosError without valgrind, or
    where it fails."""
    if shutil.which("valgrind") is None:
        raise ZygosError("valgrind is not installed, which counts the instructions; remedy: apt install valgrind")
    build(folder)
    states = [(case, fly()) for case, fly in cases(name).items() if not only or case in only]
    with (folder / "states.bin").open("wb") as file:
        for _, flown in states:
            file.write(ffi.buffer(flown.native))
    out = folder / "callgrind.out"
    when = ["--toggle-collect=zygos_work_solve", "--dump-after=solve_mark", "--combine-dumps=yes"]
    command = ["valgrind", "--tool=callgrind", *when, f"--callgrind-out-file={out.name}", "./solve"]
    environment = {**ENVIRONMENT, "LD_BIND_NOW": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"the solver failed under callgrind: {done.stderr.strip()[-500:]}; remedy: see there")
    (folder / "states.bin").unlink()
    found = np.fromfile(folder / "found.bin", dtype="<u4").reshape(-1, 3)
    if len(found) != len(states):
        raise ZygosError(f"{len(found)} of {len(states)} states were solved; remedy: run `make build`")
    solutions = []
    for (case, flown), part_of, (validity, reason, left_out) in zip(states, parts(out), found, strict=False):
        most = bound(flown)
        solutions.append(
            Solution(
                name,
                case,
                len(flown.names),
                VALIDITY[validity],
                REASONS[reason],
                bool(left_out),
                part_of.calls[_PAIR],
                most.once,
                most.most,
                part_of.of("zygos_work_solve"),
            )
        )
    out.unlink()
    return solutions


def dearest(found: Sequence[Mapping[str, Any]], cost: str) -> float:
    """The dearest solution, divided by the dearest valid one for as many parameters; the most of any number of them."""
    ratios = []
    for p in {one["parameters"] for one in found}:
        here = [one for one in found if one["parameters"] == p]
        ratios.append(max(one[cost] for one in here) / max(one[cost] for one in here if one["validity"] == "valid"))
    return float(max(ratios))


def measure(folder: Path) -> dict[str, Any]:
    """What docs/bench.json has of them."""
    found = [asdict(one) for name in SOLVED for one in counted(name, folder)]
    return {"zygos": f"zygos of commit {measured_commit()}", "cases": found}
