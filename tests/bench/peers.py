# SPDX-License-Identifier: MIT
"""One sample of the normal equations by others: Pinocchio with Eigen, in C++ and in Python, and numpy.

All get the same states of the same arm and add one row to sums of the same width. Pinocchio gets its own part for
nothing: the velocity of the base, which nobody measures, the columns of rotors, springs and dampers, and the reduction
of its ten parameters a body to those that can be identified.
"""

from __future__ import annotations

import struct
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from bench import callgrind
from bench.configurations import CONFIGURATIONS, Configuration
from conftest import ROOT
from zygos.balances.energy import energy_columns
from zygos.balances.state import State
from zygos.model.model import load_model
from zygos.native.flight import config_of, ffi

SAMPLES = 500
ROUNDS = 20
"""Of a timing; the fastest counts."""
EIGEN = Path("/usr/include/eigen3")
FLAGS = "-std=c++20 -w -DNDEBUG -DBOOST_VARIANT_USE_RELAXED_GET_BY_DEFAULT".split()
"""Relaxed: Pinocchio asks for kinds of joints that bench/peers.cpp leaves out. No assertions: Eigen has many."""
OPTIMISED = {"-O2": ["-O2"], "-O3 -march=native": ["-O3", "-march=native"]}
"""How C++ and C are compiled, the same for both; the first is what is meant where nothing is said."""
ZYGOS = "zygos"
KINEMATICS = "zygos: kinematics"
SUMS = "zygos: balance + accumulator"
PINOCCHIO = "Pinocchio C++ + Eigen"
OWN = "Pinocchio C++ + Eigen, ten parameters a body"
_PARTS = ("peer_zygos_columns", "peer_zygos_sums", "peer_pinocchio", "peer_eigen", "peer_eigen_own")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Peer:
    """What one sample costs."""

    configuration: str
    name: str
    instructions: float | None
    """Mean; None where they are not counted."""
    nanoseconds: float | None
    """None where it is a part of another."""


def build(folder: Path, optimised: str) -> Path:
    """Compile bench/peers.cpp with the library, as OPTIMISED names it."""
    folder.mkdir(parents=True, exist_ok=True)
    flags = OPTIMISED[optimised]
    c = [flag for flag in callgrind.COMPILER if flag not in ("-O2", "-static")]
    includes = ["-I", str(ROOT / "include")]
    prefix = next(parent for parent in Path(pin.__file__).parents if parent.name == "cmeel.prefix")
    sources = [str(path) for path in sorted((ROOT / "c").glob("*/*.c"))]
    subprocess.run([*c, *flags, *includes, "-c", *sources], cwd=folder, check=True)
    objects = [str(path) for path in sorted(folder.glob("*.o"))]
    system = ["-isystem", str(prefix / "include"), "-isystem", str(EIGEN)]
    program = folder / "peers"
    source = str(Path(__file__).with_name("peers.cpp"))
    subprocess.run(["g++", *FLAGS, "-g", *flags, *includes, *system, source, *objects, "-o", str(program)], check=True)
    return program


def states(one: Configuration) -> State:
    """(SAMPLES, ...) moderate motion."""
    rng = np.random.default_rng(0)
    q, qd, spring, slip = (scale * rng.normal(size=(SAMPLES, one.arm.n)) for scale in (1.0, 0.3, 1e-3, 1e-3))
    base = 0.1 * rng.normal(size=(SAMPLES, 3))
    return State(q=q, qd=qd, theta=q + spring, thetad=qd + slip, base=base if one.arm.spatial else base[:, 2])


def write_input(one: Configuration, motion: State, path: Path) -> None:
    """Write what bench/peers.cpp reads."""
    model = load_model(ROOT / "examples" / one.example / "model.toml")
    doubles: list[Floats] = []
    for joint, body in zip(one.arm.joints, model.bodies, strict=False):
        doubles += [pin.rpy.rpyToMatrix(*joint.frame_rpy).ravel(), np.array(body.joint_xyz), np.array(joint.axis)]
    base = motion.base if one.arm.spatial else motion.base[:, None] * np.array(one.arm.axis)
    doubles.append(np.concatenate([motion.q, motion.theta, motion.qd, motion.thetad, base], axis=1).ravel())
    head = struct.pack("=2i", one.arm.n, SAMPLES) + bytes(ffi.buffer(config_of(one.arm)))
    path.write_bytes(head + np.concatenate(doubles, dtype=np.float64).tobytes())


def native(name: str, folder: Path, programs: dict[str, Path]) -> list[Peer]:
    """zygos and Pinocchio in C and C++: counted at -O2, timed in turns by each program."""
    write_input(CONFIGURATIONS[name](), states(CONFIGURATIONS[name]()), folder / "peers.bin")
    watched = [f"--toggle-collect={part}" for part in _PARTS]
    out = folder / "callgrind.peers"
    command = ["valgrind", "--tool=callgrind", *watched, f"--callgrind-out-file={out.name}", str(programs["-O2"])]
    subprocess.run(command, cwd=folder, env=callgrind.ENVIRONMENT, check=True, capture_output=True)
    (whole,) = callgrind.parts(out)
    columns, sums, regressor, rank, rank_own = (whole.of(part) / SAMPLES for part in _PARTS)
    counted: dict[str, float | None] = {
        ZYGOS: columns + sums, KINEMATICS: columns, SUMS: sums,
        PINOCCHIO: regressor + rank, f"{PINOCCHIO}: regressor": regressor, f"{PINOCCHIO}: rank-1 update": rank,
        OWN: regressor + rank_own,
    }  # fmt: skip
    timed: dict[str, float] = {}
    for optimised, program in programs.items():
        run = subprocess.run([str(program), str(ROUNDS)], cwd=folder, check=True, capture_output=True, text=True)
        ours, theirs, _ = map(float, run.stdout.split())
        suffix = "" if optimised == "-O2" else f", {optimised}"
        timed |= {f"{ZYGOS}{suffix}": ours, f"{PINOCCHIO}{suffix}": theirs}
    return [Peer(name, key, counted.get(key), timed.get(key)) for key in {**counted, **timed}]


def _fastest(one: Callable[[], None]) -> float:
    """Nanoseconds a sample of what works off all of them."""
    best = np.inf
    for _ in range(3):
        begin = time.perf_counter()
        one()
        best = min(best, time.perf_counter() - begin)
    return 1e9 * best / SAMPLES


def interpreted(name: str) -> list[Peer]:
    """Pinocchio's Python, and numpy sample by sample and as a batch; timed."""
    one = CONFIGURATIONS[name]()
    motion, arm = states(one), one.arm
    slip = np.zeros((SAMPLES, arm.n))
    width = len(arm.parameter_names) + 2
    gram = np.zeros((width, width))
    model = pin.Model()
    carrier = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    bodies = load_model(ROOT / "examples" / one.example / "model.toml").bodies
    for i, joint in enumerate(arm.joints):
        place = pin.SE3(pin.rpy.rpyToMatrix(*joint.frame_rpy), np.array(bodies[i].joint_xyz))
        carrier = model.addJoint(carrier, pin.JointModelRevoluteUnaligned(*joint.axis), place, f"link{i}")
    data = model.createData()
    rest = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (SAMPLES, 1))
    base = motion.base if arm.spatial else motion.base[:, None] * np.array(arm.axis)
    positions = np.concatenate([rest, motion.q], axis=1)
    velocities = np.concatenate([0.1 * np.ones((SAMPLES, 3)), base, motion.qd], axis=1)
    row = np.ones(width)

    def pinocchio() -> None:
        for position, velocity in zip(positions, velocities, strict=True):
            regressor = pin.computeKineticEnergyRegressor(model, data, position, velocity)
            shared = min(width, regressor.size)
            row[:shared] = regressor[:shared]
            np.add(gram, np.outer(row, row), out=gram)

    def samples() -> None:
        for k in range(SAMPLES):
            at = State(
                q=motion.q[k], qd=motion.qd[k], theta=motion.theta[k], thetad=motion.thetad[k], base=motion.base[k]
            )
            row[:-2] = energy_columns(arm, at, slip[k])
            np.add(gram, np.outer(row, row), out=gram)

    def batch() -> None:
        rows = np.ones((SAMPLES, width))
        rows[:, :-2] = energy_columns(arm, motion, slip)
        np.add(gram, rows.T @ rows, out=gram)

    named = {"Pinocchio Python + numpy": pinocchio, "numpy, sample by sample": samples, "numpy, as a batch": batch}
    return [Peer(name, key, None, _fastest(run)) for key, run in named.items()]
