"""C against numpy on one log, room by room."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.cycles import Cycles
from zygos.errors import Undecided
from zygos.flight import Flight, Trace
from zygos.reference.accumulator import design
from zygos.reference.balance import rows
from zygos.reference.cycle import calibrate
from zygos.reference.momentum import turns
from zygos.reference.motors import motors, solve_with_others
from zygos.reference.noise import noise_of
from zygos.reference.smoother import smooth
from zygos.reference.wire import Frame, Reception, receive

ROW_TOLERANCE = 1e-12
"""Of each column's largest entry."""
NOISE_TOLERANCE = 1e-9
"""Of the root of the product of the two diagonal entries."""
FLOOR = 0.1
"""The least size (rad, rad/s, J per unit) that a column of states or rows is measured by: at rest it holds rounding."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Room:
    """Result of one comparison."""

    name: str
    compared: int
    """Numbers compared."""
    difference: float
    """Largest difference, relative to the largest entry of its column."""
    cycle: int | None
    """SYNC number at which it occurs."""
    tolerance: float

    @property
    def equal(self) -> bool:
        """Whether the difference is within the tolerance."""
        return self.difference <= self.tolerance

    def as_json(self) -> dict[str, Any]:
        """For the command's JSON."""
        return {
            "room": self.name,
            "compared": self.compared,
            "difference": self.difference,
            "cycle": self.cycle,
            "tolerance": self.tolerance,
            "equal": self.equal,
        }


def _compare(
    name: str, c: Floats, numpy: Floats, sync: NDArray[np.uint64], tolerance: float, floor: float = 1e-300
) -> Room:
    """Compare two tables (n, columns) whose rows belong to the cycles sync (n,)."""
    if c.shape != numpy.shape:
        return Room(name, 0, float("inf"), None, tolerance)
    if c.size == 0:
        return Room(name, 0, 0.0, None, tolerance)
    scale = np.maximum(np.abs(numpy).max(axis=0), floor)
    relative = np.abs(c - numpy) / scale
    row = int(np.argmax(relative.max(axis=1)))
    largest = float(relative[row].max())
    return Room(name, c.size, largest, int(sync[row]) if largest > 0.0 else None, tolerance)


def _compare_noise(c: Floats, numpy: Floats, rows: Floats) -> Room:
    """Compare what noise adds to the squares (p+1, p+1) of rows (m, p+1), with each entry's own size.

    A column without noise holds the rounding of its own derivatives.
    """
    size = np.maximum(np.sqrt(np.diag(numpy)), 1e-9 * np.linalg.norm(rows, axis=0))
    difference = float(np.max(np.abs(c - numpy) / np.outer(size, size)))
    return Room("noise", c.size, difference, None, NOISE_TOLERANCE)


def _compare_sums(c: Floats, numpy: Floats, z: Floats, w: Floats) -> Room:
    """Compare normal equations (p, p+1) of rows z (m, p), w (m,), with the lengths of the two columns of an entry."""
    length = np.linalg.norm(np.column_stack([z, w]), axis=0)
    difference = float(np.max(np.abs(c - numpy) / np.outer(length[:-1], length)))
    return Room("normal equations", c.size, difference, None, ROW_TOLERANCE)


def _columns(cycles: Cycles) -> Floats:
    return np.hstack([cycles.q, cycles.theta, cycles.tau, cycles.omega])


def sizes(arm: Arm, x: Floats) -> Floats:
    """What differences of the parameters x (p,) are measured by, (p,).

    The value; of a kinetic one, which may be zero, at least the root of the product of the two diagonal ones that it
    couples; of a first moment the largest of them.
    """
    out: Floats = np.abs(x)
    value: dict[str, float] = dict(zip(arm.parameter_names, out.tolist(), strict=False))
    largest = max((value[name] for name, unit in arm.body_parameters if unit == "kg m"), default=0.0)

    def own(end: str) -> float:
        # on a fixed base the first body's two directions share a parameter
        name = f"N[{end},{end}]" if arm.spatial else f"a{end}{end}"
        return value[name] if name in value else value["N[1u,1u]"]

    for k, (name, unit) in enumerate(arm.body_parameters):
        first, second = name[2:-1].split(",") if unit != "kg m" and arm.spatial else (name[1], name[2])
        out[k] = largest if unit == "kg m" else max(out[k], float(np.sqrt(own(first) * own(second))))
    return out


def check_chain(arm: Arm, trace: Trace, flight: Flight) -> list[Room]:
    """Compare what the rooms behind the receiver made of a run with numpy's result on the same cycles.

    The last room is "solution", unless the run determines none: too short for an instant it ends with the smoother,
    without any parameter known with the bandwidth test.
    """
    samples = calibrate(arm, trace.cycles)
    smoothed = smooth(arm, samples)
    if len(smoothed.index) == 0:
        return [Room("smoother", 0, float(trace.instant.sum()), None, 0.0)]
    raw = rows(arm, samples, smoothed, flight.effects)
    added = noise_of(arm, samples, smoothed, raw, flight.effects)
    balance = replace(raw, z=raw.z - added.mean)
    half = arm.smoother.lag
    at = smoothed.index + half  # the instant k comes out with cycle k + M
    numpy_state = np.hstack([smoothed.q, smoothed.theta, smoothed.qd, smoothed.thetad, smoothed.omega])
    rooms = [_compare("smoother", trace.state[at], numpy_state, smoothed.sync, ROW_TOLERANCE, FLOOR)]
    instants = np.flatnonzero(trace.instant)
    numpy_rows = np.column_stack([balance.z, balance.w])
    sync = trace.cycles.sync[instants] - half
    rooms.append(_compare("balance", trace.row[instants], numpy_rows, sync, ROW_TOLERANCE, FLOOR))
    c_accepted = trace.accepted[instants].astype(float)[:, None]
    rooms.append(_compare("bandwidth test", c_accepted, balance.accepted.astype(float)[:, None], sync, 0.0))
    estimate = flight.estimate()
    known = np.isfinite(estimate.value)  # the library withholds what is not identifiable
    if not known.any():
        return rooms
    used = design(balance, added.moment)
    if not balance.void:
        # of arcs that are dropped later the library takes the noise in proportion
        rooms.append(_compare_noise(flight.noise(), used.noise, np.column_stack([used.z, used.w])))
    a, b = flight.normal_equations()
    numpy_a, numpy_b = used.normal()
    rooms.append(_compare_sums(np.column_stack([a, b]), np.column_stack([numpy_a, numpy_b]), used.z, used.w))
    try:
        of_motors, momentum = motors(arm, samples, smoothed, flight.effects), turns(arm, samples, smoothed)
        solution = solve_with_others(arm, used, of_motors, momentum, flight.effects)
    except Undecided:
        return rooms
    tolerance = max(1e-9, 1e-14 * estimate.condition)
    size = sizes(arm, solution.x)
    # an effect may be zero; what it could explain at the most is its size then
    first = len(arm.parameter_names)
    size[first:] = np.linalg.norm(used.w) / np.linalg.norm(used.z[:, first:], axis=0)
    relative = (np.abs(estimate.value - solution.x) / size)[known]
    worst = float(np.max(relative, initial=0.0)) if np.all(np.isfinite(relative)) else float("inf")
    rooms.append(Room("solution", len(relative), worst, None, tolerance))
    return rooms


def decode(arm: Arm, frames: NDArray[Any]) -> Reception:
    """`FRAME` records as numpy's side receives them."""
    return receive(arm, [_frame(f) for f in frames])


def _frame(record: Any) -> Frame:
    length = int(record["length"])
    return Frame(int(record["id"]), bytes(record["data"])[:length].ljust(length, b"\0"), int(record["flags"]))


def check_frames(arm: Arm, frames: NDArray[Any], flight: Flight | None = None) -> list[Room]:
    """Compare all rooms on a log, beginning with the frames, which a fresh `flight` takes in."""
    flight = flight or Flight(arm)
    trace = flight.frames(frames, trace=True)
    assert trace is not None
    reception = decode(arm, frames)
    ours, theirs = trace.cycles, reception.cycles
    rooms = [_compare("wire and cycles", _columns(ours), _columns(theirs), ours.sync, 1e-15)]
    if len(ours) == len(theirs):
        unlike = (ours.sync != theirs.sync) | (ours.flags != theirs.flags)
        first = int(ours.sync[np.argmax(unlike)]) if unlike.any() else None
        rooms.append(Room("cycle numbers and breaks", len(ours), float(unlike.sum()), first, 0.0))
    c_faults = flight.faults
    off = sum(abs(count - reception.faults[name]) for name, count in c_faults.items())
    rooms.append(Room("fault counters", len(c_faults), float(off), None, 0.0))
    return rooms + check_chain(arm, trace, flight)


def check_cycles(arm: Arm, cycles: Cycles, flight: Flight | None = None) -> list[Room]:
    """Compare the rooms behind the receiver on cycles that came through the other door of a fresh `flight`."""
    flight = flight or Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    return check_chain(arm, trace, flight)
