# SPDX-License-Identifier: MIT
"""Synthetic motions for the tests of the flight library, and frames written one at a time.

The motions are sums of sines. Their torques are chosen afterwards, so that the rows which the library itself forms
balance exactly for parameters of our choice: any row that goes in must then give these parameters back. No plant is
needed, and nothing of the solver is shared.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from zygos.arm import Arm
from zygos.native.flight import Flight, Trace, ffi, lib
from zygos.reference.compare import waited
from zygos.runs.cycles import Cycles
from zygos.runs.samples import usable

Floats = NDArray[np.float64]

CHOSEN = {
    "a00": 24.0, "a01": 4.2, "a02": 0.96, "a11": 8.2, "a12": 1.97, "a22": 1.9,
    "Im1": 0.01, "k1": 400.0, "b1": 3.0, "Im2": 0.008, "k2": 250.0, "b2": 2.0,
}  # fmt: skip
"""Physical parameters of a two-joint arm."""


def symmetric(packed: Any, width: int) -> Floats:
    """(width, width) from a lower triangle by rows."""
    out = np.zeros((width, width))
    out[np.tril_indices(width)] = np.frombuffer(ffi.buffer(packed))[: width * (width + 1) // 2]
    return np.asarray(out + np.tril(out, -1).T)


def energy_only(arm: Arm, *, noise: bool = False) -> Arm:
    """The arm as the records of `balanced` want it: with energy rows only, and without noise unless there is some.

    The torques of those records close the energy of the whole arm and nothing else. They are not what the motors'
    equations of motion ask for, nor does the momentum stay the same: rows of these contradict the parameters.
    """
    compensate_every = arm.compensate_every if noise else 0
    return replace(arm, impulse_arc_s=0.0, momentum_max_s=0.0, compensate_every=compensate_every)


def chosen(arm: Arm) -> Floats:
    return np.array([CHOSEN[name] for name in arm.parameter_names])


def sines(arm: Arm, n: int, *, first: int = 1, still: tuple[int, ...] = (), angle: float = 0.4) -> Cycles:
    """n cycles of slow motion from cycle `first` on, without torque; the joints in `still` stay at `angle`."""
    t = arm.period_s * np.arange(first, first + n, dtype=np.float64)
    q = np.zeros((n, arm.n))
    theta = np.zeros((n, arm.n))
    for i in range(arm.n):
        if i in still:
            q[:, i] = theta[:, i] = angle
            continue
        q[:, i] = 0.9 * np.sin((0.91 - 0.13 * i) * t + i) + 0.5 * np.cos((1.73 + 0.21 * i) * t)
        theta[:, i] = q[:, i] + 0.05 * np.sin((2.3 + 0.37 * i) * t) + 0.03 * np.cos((1.1 + 0.19 * i) * t + 0.5)
    omega = np.zeros((n, 3))
    omega[:, 2] = 0.35 * np.sin(0.57 * t + 0.2) + 0.2 * np.cos(1.31 * t)
    sync = np.arange(first, first + n, dtype=np.uint64)
    return Cycles(
        sync=sync, q=q, theta=theta, tau=np.zeros((n, arm.n)), omega=omega, flags=np.zeros(n, dtype=np.uint32)
    )


def traced(arm: Arm, cycles: Cycles) -> Trace:
    trace = Flight(arm).cycles(cycles, trace=True)
    assert trace is not None
    return trace


def waits(cycles: Cycles, trace: Trace) -> dict[str, frozenset[int]]:
    """Positions of the cycles at which an arc of each kind of rows waited, as numpy is told."""
    return waited(trace, np.flatnonzero(usable(cycles)))


def arcs(arm: Arm, trace: Trace) -> list[tuple[int, int]]:
    """Ranges of trace positions that form an arc: unbroken instants, at most as many as the arm file allows."""
    longest = round(arm.arc_max_s / arm.period_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], trace.instant.astype(int), [0]])))
    out = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        out += [(i, min(i + longest, int(stop))) for i in range(int(start), int(stop), longest)]
    return out


def balanced(arm: Arm, cycles: Cycles, parameters: Floats) -> Cycles:
    """The same motion with the smallest torques that make every row of an arc balance exactly for the parameters.

    The work is linear in the torques, and a torque changes the steps of the work close to its own cycle only. So one
    run with unit torques in every eighth cycle shows the response to each of them.
    """
    spread, before = 8, 2
    trace = traced(arm, cycles)
    n = len(cycles)
    inner = np.zeros(n, dtype=bool)
    for start, stop in arcs(arm, trace):
        inner[start + 1 : stop] = True
    ends = np.flatnonzero(inner)  # steps from row c - 1 to row c, both of one arc
    response = sparse.lil_matrix((n, n * arm.n))
    for joint in range(arm.n):
        for first in range(spread):
            tau = np.zeros_like(cycles.tau)
            tau[first::spread, joint] = 1.0
            steps = np.diff(traced(arm, replace(cycles, tau=tau)).row[:, -1], prepend=0.0)
            # The step that ends in row c is the one from instant c - M - 1 to c - M.
            source = ends - arm.smoother.lag - before
            source += (first - source) % spread
            kept = source < n
            response[ends[kept], source[kept] * arm.n + joint] = steps[ends[kept]]
    matrix = response.tocsr()[ends]
    wanted = np.diff(trace.row[:, :-1] @ parameters, prepend=0.0)[ends]
    solve = sparse.linalg.factorized((matrix @ matrix.T).tocsc())
    tau = matrix.T @ solve(wanted)
    for _ in range(2):
        tau += matrix.T @ solve(wanted - matrix @ tau)
    return replace(cycles, tau=tau.reshape(n, arm.n))


def joined(*parts: Cycles) -> Cycles:
    return Cycles(*(np.concatenate([getattr(part, name) for part in parts]) for name in Cycles.__dataclass_fields__))


def part(cycles: Cycles, start: int, stop: int) -> Cycles:
    return Cycles(*(getattr(cycles, name)[start:stop] for name in Cycles.__dataclass_fields__))


def copy_of(flight: Flight) -> Flight:
    """Another one with the same memory, which may be changed."""
    out = Flight(flight.arm, flight.effects)
    ffi.memmove(out.native, flight.native, ffi.sizeof("zygos_arm_t"))
    return out


def bytes_of(pointer: Any) -> bytes:
    return bytes(ffi.buffer(pointer))


def masked(flight: Flight) -> bytes:
    """zygos_arm_t without the two parts that a rejected frame may change."""
    image = bytearray(bytes_of(flight.native))
    for part in ("faults", "status"):
        start = ffi.offsetof("zygos_arm_t", "receiver", part)
        size = ffi.sizeof(getattr(flight.native.receiver, part))
        image[start : start + size] = bytes(size)
    return bytes(image)


class Bus:
    """Writes frames by hand and feeds them to one arm, one after the other."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.flight = Flight(arm)
        self.config = self.flight.native.sums.config

    def frame(self, message: int, node: int, counter: int, **fields: Any) -> Any:
        """Encode a frame of the cycle with this SYNC counter."""
        record = ffi.new("zygos_record_t *")
        record.counter = counter & 15
        record.sync = counter
        for name, value in fields.items():
            setattr(record, name, value)
        out = ffi.new("zygos_frame_t *")
        assert lib.zygos_wire_encode(record, message, node, out) == 1
        return out

    def sync(self, counter: int) -> Any:
        return self.frame(lib.ZYGOS_MSG_SYNC, 0, counter)

    def ftime(self, counter: int, time_us: int = 0) -> Any:
        return self.frame(lib.ZYGOS_MSG_FTIME, 32, counter, time_us=time_us % 2**32)

    def angles(self, joint: int, counter: int, link: int = 1000, motor: int = 1100, status: int = 15) -> Any:
        node = self.config.joint[joint].node
        return self.frame(lib.ZYGOS_MSG_ANGLES, node, counter, code=[link, motor, 0], status=status)

    def torque(self, joint: int, counter: int, torque: int = 50, latch: int | None = None, status: int = 15) -> Any:
        own = self.config.joint[joint]
        latch = own.latch_us if latch is None else latch
        fields = {"code": [torque, 0, 0], "latch_us": latch, "status": status}
        return self.frame(lib.ZYGOS_MSG_TORQUE, own.node, counter, **fields)

    def rates(self, counter: int, codes: tuple[int, int, int] = (1, 2, 3), status: int = 1) -> list[Any]:
        node = self.config.imu_node
        x, y, z = codes
        if self.config.imu_fine:
            return [
                self.frame(lib.ZYGOS_MSG_RATE_XY, node, counter, code=[x, y, 0], status=status),
                self.frame(lib.ZYGOS_MSG_RATE_Z, node, counter, code=[z, 0, 0], status=status),
            ]
        return [self.frame(lib.ZYGOS_MSG_RATE_COARSE, node, counter, code=[x, y, z], status=status)]

    def data(self, counter: int) -> list[Any]:
        """All data frames of a good cycle: angles and torque of each joint, then the gyro."""
        out = []
        for i in range(self.arm.n):
            out += [self.angles(i, counter), self.torque(i, counter)]
        return out + self.rates(counter)

    def send(self, *frames: Any) -> list[int]:
        """Feed without stepping. Returns the verdicts."""
        return [lib.zygos_arm_frame(self.flight.native, frame) for frame in frames]

    def cycles(self, first: int, count: int = 1) -> None:
        """Feed good cycles, from the SYNC with counter `first` on; the last one stays open."""
        for k in range(count):
            counter = (first - 1 + k) % 240 + 1
            assert set(self.send(self.sync(counter), *self.data(counter))) == {lib.ZYGOS_ACCEPTED}

    def drain(self) -> list[tuple[int, int]]:
        """Take all complete cycles out of the queue: (number, flags) of each."""
        out = []
        receiver = ffi.addressof(self.flight.native, "receiver")
        while (cycle := lib.zygos_receiver_front(receiver)) != ffi.NULL:
            out.append((int(cycle.sync), int(cycle.flags)))
            lib.zygos_receiver_pop(receiver)
        return out

    def faults(self) -> dict[str, int]:
        """The counters that are not zero."""
        return {name: count for name, count in self.flight.faults.items() if count}
