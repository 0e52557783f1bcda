# SPDX-License-Identifier: MIT
"""Compares C with numpy on one log, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.arcs import arc_cycles
from zygos.balances.energy import EnergyRows, energy_rows
from zygos.balances.impulse import impulse_names
from zygos.balances.momentum import Turns, turns
from zygos.can.wire import Frame
from zygos.effects import Effect
from zygos.errors import Undecided
from zygos.estimation.watch import Watch
from zygos.native.flight import MIN_SIGNAL_TO_NOISE, ROWS, Estimate, Flight, LeftOut, Trace
from zygos.reference.accumulator import Design, design
from zygos.reference.combination import Combined, MotorRows, combine, motors
from zygos.reference.gains import Prior, Sums, prior_of
from zygos.reference.joints import Groups, groups, suffice
from zygos.reference.noise import noise_of
from zygos.reference.sigmas import Block, Intervals, intervals, joint_intervals
from zygos.reference.solver import Rows
from zygos.reference.wire import Reception, receive_log
from zygos.runs.cycles import Cycles
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

ROW_TOLERANCE = 1e-12
"""Tolerance relative to each column's largest entry where rounding errors are not larger."""
ROUNDING = 32.0
"""Largest difference of two correct programs, as a multiple of the effect of one rounding of every reading and of every
coefficient of the smoother on the results."""
LARGEST_TOLERANCE = 1e-9
"""A larger difference is not attributed to rounding, whatever the readings are."""
NOISE_TOLERANCE = 1e-9
"""Tolerance of noise terms, relative to the square root of the product of their two diagonal entries."""
SIGMA_TOLERANCE = 1e-5
"""Tolerance relative to each sigma, where the solution is more accurate than that."""
SIGMA_DIGITS = 0.01
"""If the solutions are only accurate to this share of a sigma, as in a run without noise, sigmas are rounding
errors."""
NOISE_ABSENT = 0.1
"""Below this ratio of the residuals' square to the declared noise, scatter is a matter of rounding."""
STUDENT_TOLERANCE = 0.02
"""Tolerance relative to each half width, from 2 degrees of freedom upwards."""
FLOOR = 0.1
"""Smallest scale (rad, rad/s, J per unit) of a column of states or rows; at rest a column contains only rounding
errors."""

EPSILON = float(np.finfo(np.float64).eps)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """Differences over the cycles of a run."""

    sync: NDArray[np.uint64]
    """(n,) SYNC numbers."""
    difference: Floats
    """(n,) largest of each cycle, relative to the largest entries of the columns."""


@dataclass(frozen=True)
class Room:
    """Result of one comparison."""

    name: str
    compared: int
    """Number of values compared."""
    difference: float
    """Largest difference, relative to the largest entry of its column."""
    cycle: int | None
    """SYNC number at which it occurs."""
    tolerance: float
    over: Curve | None = field(default=None, compare=False, repr=False)
    """Where it has one number or more a cycle."""

    @property
    def equal(self) -> bool:
        """Whether the difference is within the tolerance."""
        return self.difference <= self.tolerance

    def as_json(self) -> dict[str, Any]:
        """The result as it appears in the command's JSON."""
        return {
            "room": self.name,
            "compared": self.compared,
            "difference": self.difference,
            "cycle": self.cycle,
            "tolerance": self.tolerance,
            "equal": self.equal,
        }


@dataclass(frozen=True)
class Tables:
    """The numpy results that are compared with C; n smoothed instants, m rows, p columns."""

    balance: EnergyRows
    used: Design
    state: Floats
    """(n, 4N+3) smoothed states."""
    row: Floats
    """(m, p+1) columns and work."""

    def lengths(self) -> Floats:
        """(p+1,) lengths of the columns and of the work over the rows in use, minus the mean of each arc.

        They are above 0 even if nothing moved.
        """
        length: Floats = np.linalg.norm(np.column_stack([self.used.z, self.used.w]), axis=0)
        return np.maximum(length, 1e-150)

    def in_lengths(self, a: Floats, b: Floats) -> Floats:
        """(p, p+1) normal equations a (p, p), b (p,), each entry divided by the lengths of its two columns."""
        length = self.lengths()
        out: Floats = np.column_stack([a, b]) / np.outer(length[:-1], length)
        return out


def tables(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> Tables:
    """Apply numpy's remaining stages to a calibrated and smoothed record."""
    raw = energy_rows(arm, samples, smoothed, effects)
    added = noise_of(arm, samples, smoothed, raw, effects)
    balance = replace(raw, z=raw.z - added.mean)
    state = np.hstack([smoothed.q, smoothed.theta, smoothed.qd, smoothed.thetad, smoothed.omega])
    row = np.column_stack([balance.z, balance.w])
    return Tables(balance, design(balance, added.moment), state, row)


@dataclass(frozen=True)
class Rounding:
    """Tolerances: the effect of rounding on a table, as a share of each column's largest entry."""

    state: Floats
    """(4N+3,)"""
    row: Floats
    """(p+1,)"""
    equations: Floats
    """(p, p+1) tolerances in the unit of `Tables.in_lengths`."""


def rounding(arm: Arm, samples: Samples, known: Tables, effects: Sequence[Effect] = ()) -> Rounding:
    """Measure the effect of rounding: everything is computed again from readings that are shifted by up to one rounding
    of their column's largest value.

    A rounded coefficient of the smoother has the same error at every instant, so angles and rates are also shifted as a
    whole. In this way a tolerance follows the conditioning of the readings (angles many turns from zero, rates from
    small differences) and the length of the arcs over which integrals accumulate. The library sums squares before it
    subtracts the means of an arc, which causes larger rounding errors for larger means.
    """
    generator = np.random.default_rng(0)

    def largest(table: Floats) -> Floats:
        out: Floats = EPSILON * np.max(np.abs(np.nan_to_num(table)), axis=0, initial=0.0)
        return out

    def moved(table: Floats) -> Floats:
        out: Floats = table + largest(table) * generator.uniform(-1.0, 1.0, table.shape)
        return out

    def shifted(table: Floats, readings: Floats, unit: float = 1.0) -> Floats:
        size = largest(readings) / unit
        out: Floats = table + size * generator.choice([-1.0, 1.0], size.shape)
        return out

    q, theta, tau, omega = moved(samples.q), moved(samples.theta), moved(samples.tau), moved(samples.omega)
    readings = replace(samples, q=q, theta=theta, tau=tau, omega=omega)
    again = smooth(arm, readings)
    smoothed = replace(
        again,
        q=shifted(again.q, q),
        theta=shifted(again.theta, theta),
        qd=shifted(again.qd, q, arm.period_s),
        thetad=shifted(again.thetad, theta, arm.period_s),
        omega=shifted(again.omega, omega),
    )
    other = tables(arm, readings, smoothed, effects)

    def tolerance(off: Floats) -> Floats:
        out: Floats = np.clip(ROUNDING * off, ROW_TOLERANCE, LARGEST_TOLERANCE)
        return out

    def share(ours: Floats, theirs: Floats) -> Floats:
        off = np.abs(ours - theirs).max(axis=0, initial=0.0)
        return tolerance(off / np.maximum(np.abs(ours).max(axis=0, initial=0.0), FLOOR))

    used = np.isin(known.balance.sync, known.used.sync)
    cancelled = np.linalg.norm(known.row[used], axis=0) / known.lengths()
    sums = EPSILON * np.sqrt(used.sum()) * np.outer(cancelled[:-1], cancelled)
    off = np.abs(known.in_lengths(*other.used.normal()) - known.in_lengths(*known.used.normal()))
    return Rounding(share(known.state, other.state), share(known.row, other.row), tolerance(off + sums))


def _closest(difference: Floats, tolerance: Floats | float) -> tuple[int, float, float]:
    """Position of the difference that is the largest share of its tolerance, with the difference and tolerance
    there."""
    most = np.broadcast_to(tolerance, difference.shape)
    place = int(np.argmax(difference / np.maximum(most, 1e-300)))
    return place, float(difference.flat[place]), float(most.flat[place])


def _compare(
    name: str, c: Floats, numpy: Floats, sync: NDArray[np.uint64], tolerance: Floats | float, floor: float = 1e-300
) -> Room:
    """Compare two tables (n, columns) whose rows belong to the cycles sync (n,).

    tolerance: of each column, or one for all; a share of the column's largest entry.
    """
    if c.shape != numpy.shape:
        return Room(name, 0, float("inf"), None, float(np.max(tolerance)))
    if c.size == 0:
        return Room(name, 0, 0.0, None, float(np.max(tolerance)))
    scale = np.maximum(np.abs(numpy).max(axis=0), floor)
    relative = np.nan_to_num(np.abs(c - numpy) / scale, nan=np.inf)
    column, difference, most = _closest(relative.max(axis=0), tolerance)
    cycle = int(sync[np.argmax(relative[:, column])]) if difference > 0.0 else None
    return Room(name, c.size, difference, cycle, most, Curve(sync, relative.max(axis=1)))


def _compare_noise(c: Floats, numpy: Floats, rows: Floats) -> Room:
    """Compare the noise terms in the squares (p+1, p+1) of rows (m, p+1), relative to each entry's own size.

    A column without noise contains only rounding errors of its derivatives.
    """
    size = np.maximum(np.sqrt(np.diag(numpy)), 1e-9 * np.linalg.norm(rows, axis=0))
    difference = float(np.max(np.abs(c - numpy) / np.outer(size, size)))
    return Room("noise", c.size, difference, None, NOISE_TOLERANCE)


def _columns(cycles: Cycles) -> Floats:
    return np.hstack([cycles.q, cycles.theta, cycles.tau, cycles.omega])


def sizes(arm: Arm, x: Floats) -> Floats:
    """(p,) sizes relative to which differences of the parameters x (p,) are measured.

    The size is the value; for a kinetic parameter, which may be zero, at least the square root of the product of the
    two diagonal ones that it couples; for a first moment the largest of them.
    """
    own = len(arm.parameter_names)
    if arm.structure.reduces:
        # an error of a parameter is one of all full parameters that contain it
        basis = np.abs(arm.structure.basis)
        full = _full_sizes(arm, arm.structure.expanded(x[:own]))
        shares = np.divide(full[:, None], basis, out=np.full_like(basis, np.inf), where=basis > 0.0)
        least = np.min(shares, axis=0)
        return np.concatenate([np.maximum(np.abs(x[:own]), least), np.abs(x[own:])])
    return _full_sizes(arm, x)


def _full_sizes(arm: Arm, x: Floats) -> Floats:
    """`sizes` of full parameters x (p_full,)."""
    out: Floats = np.abs(x)
    values: list[float] = out.tolist()
    listed = list(zip(arm.full_parameters, values, strict=False))
    diagonal = {one.ends[0]: value for one, value in listed if one.symbol in ("N", "a") and len(set(one.ends)) == 1}
    largest = max((value for one, value in listed if one.symbol == "G"), default=0.0)

    def own(end: str) -> float:
        # on a fixed base one parameter serves both directions of the first body
        return diagonal[end] if end in diagonal else diagonal["1u"]

    for k, (one, value) in enumerate(listed):
        if one.joint is None:
            out[k] = largest if one.symbol == "G" else max(value, float(np.sqrt(own(one.ends[0]) * own(one.ends[1]))))
    return out


def left_out(flight: Flight, ended: Sequence[LeftOut]) -> dict[str, frozenset[int]]:
    """Last cycles of the arcs that a flight left out, by kind of rows: of finished arcs and of open ones."""
    estimate, guard = flight.estimate(), flight.native.sums.guard
    out = {}
    for k, kind in enumerate(ROWS):
        still = {estimate.cycle} if estimate.left_out[k] > guard.left_out[k] else set()
        out[kind] = frozenset({arc.last for arc in ended if arc.rows == kind} | still)
    return out


def waited(trace: Trace, at: NDArray[np.int64]) -> dict[str, frozenset[int]]:
    """What `Samples.waited` is for a record in which the cycles of a trace have the positions at, (n,)."""
    return {kind: frozenset(at[of].tolist()) for kind, of in zip(ROWS, trace.waited.T, strict=True)}


def check_chain(arm: Arm, trace: Trace, flight: Flight, ended: Sequence[LeftOut] = ()) -> list[Room]:
    """Compare the results of the stages after the receiver with numpy's on the same cycles.

    The last stage is "solution", unless the run determines none: a run too short for any instant ends with the
    smoother, and one without any determined parameter with the bandwidth test. ended: finished arcs that the flight
    left out; numpy leaves out the same arcs, since it does not judge them itself, and the instants that have no row
    because an arc waited for its end, since it closes arcs at once.
    """
    told = left_out(flight, ended)
    samples = replace(calibrate(arm, trace.cycles), left_out=told, waited=waited(trace, np.arange(len(trace.cycles))))
    smoothed = smooth(arm, samples)
    if len(smoothed.index) == 0:
        return [Room("smoother", 0, float(trace.instant.sum()), None, 0.0)]
    known = tables(arm, samples, smoothed, flight.effects)
    balance, used = known.balance, known.used
    rounds = rounding(arm, samples, known, flight.effects)
    half = arm.smoother.lag
    at = smoothed.index + half  # the result for instant k comes out with cycle k + M
    rooms = [_compare("smoother", trace.state[at], known.state, smoothed.sync, rounds.state, FLOOR)]
    instants = np.flatnonzero(trace.instant)
    sync = trace.cycles.sync[instants] - half
    rooms.append(_compare("balance", trace.row[instants], known.row, sync, rounds.row, FLOOR))
    c_accepted = trace.accepted[instants].astype(float)[:, None]
    rooms.append(_compare("bandwidth test", c_accepted, balance.accepted.astype(float)[:, None], sync, 0.0))
    of_joints = groups(arm, samples, smoothed, flight.effects)
    if of_joints is not None and len(of_joints.rows.z) and not samples.voids:
        rooms.append(_compare_groups(flight, of_joints))
    estimate = flight.estimate()
    if not np.isfinite(estimate.value).any():  # the library gives no value for what is not identifiable
        return rooms
    if not balance.void:
        # the library subtracts the noise of arcs that are discarded later in proportion
        rooms.append(_compare_noise(flight.noise(), used.noise, np.column_stack([used.z, used.w])))
        if arm.memory_s is None:
            rooms.append(_compare_walk(flight, used))
    off = np.abs(known.in_lengths(*flight.normal_equations()) - known.in_lengths(*used.normal()))
    _, difference, tolerance = _closest(off, rounds.equations)
    rooms.append(Room("normal equations", off.size, difference, None, tolerance))
    try:
        solved = _solved(arm, flight, samples, smoothed, used, of_joints)
    except Undecided:
        return rooms
    return [*rooms, *_compare_solution(arm, flight, estimate, known, of_joints, solved)]


@dataclass(frozen=True)
class _Solved:
    """The estimate from all rows, the library's own sums of them, and the prior of the gains, if there are any."""

    combined: Combined
    sums: Sums
    prior: Prior | None


def _solved(
    arm: Arm, flight: Flight, samples: Samples, smoothed: Smoothed, used: Design, of_joints: Groups | None
) -> _Solved:
    """Solve all rows. Raises Undecided as `combine`."""
    effects = flight.effects
    of_motors, momentum = motors(arm, samples, smoothed, effects), turns(arm, samples, smoothed)
    combined = combine(arm, used, of_motors, momentum, of_joints, effects)
    sums = sums_of(arm, flight, used, of_motors, momentum, of_joints, combined)
    if not arm.relative_gains:
        return _Solved(combined, sums, None)
    prior = prior_of(arm, combined.solution, sums)
    combined = combine(arm, used, of_motors, momentum, of_joints, effects, prior)
    return _Solved(combined, sums_of(arm, flight, used, of_motors, momentum, of_joints, combined), prior)


def _sizes_with_effects(arm: Arm, x: Floats, used: Design, of_joints: Groups | None) -> Floats:
    """(p,) `sizes`, and of an effect, which may be zero, the largest value that the data would allow."""
    size, first = sizes(arm, x), len(arm.parameter_names)
    own = Rows(used.z, used.w, used.noise) if of_joints is None or not suffice(arm) else of_joints.rows
    size[first:] = np.linalg.norm(own.w) / np.linalg.norm(own.z[:, first:], axis=0)
    return size


def solution_of(arm: Arm, cycles: Cycles) -> tuple[Floats, Floats]:
    """numpy's solution (p,) of cycles, with its sizes (p,); the prior of gains has the blocks of the library. Raises
    ZygosError for input that does not fit the arm, Undecided for a record that does not determine the parameters."""
    flight = Flight(arm)
    flight.cycles(cycles)
    samples = calibrate(arm, cycles)
    smoothed = smooth(arm, samples)
    used = tables(arm, samples, smoothed, flight.effects).used
    of_joints = groups(arm, samples, smoothed, flight.effects)
    x = _solved(arm, flight, samples, smoothed, used, of_joints).combined.solution.x
    return x, _sizes_with_effects(arm, x, used, of_joints)


def _compare_solution(
    arm: Arm, flight: Flight, estimate: Estimate, known: Tables, of_joints: Groups | None, solved: _Solved
) -> list[Room]:
    """Compare the solution, and sigmas and half widths where every parameter has them."""
    used, sums, solution = known.used, solved.sums, solved.combined.solution
    has_value = np.isfinite(estimate.value)
    tolerance = max(1e-9, 1e-14 * estimate.condition)
    size = _sizes_with_effects(arm, solution.x, used, of_joints)
    relative = (np.abs(estimate.value - solution.x) / size)[has_value]
    worst = float(np.max(relative, initial=0.0)) if np.all(np.isfinite(relative)) else float("inf")
    of_solution = Room("solution", len(relative), worst, None, tolerance)
    clear = estimate.signal_to_noise >= MIN_SIGNAL_TO_NOISE and not estimate.noise_ratio < NOISE_ABSENT
    if known.balance.void or not has_value.all() or not clear:
        return [of_solution]
    # a sigma is computed from differences of solutions
    closest = max(SIGMA_TOLERANCE, tolerance * float(np.max(size / estimate.sigma)))
    if closest > SIGMA_DIGITS:
        return [of_solution]
    if of_joints is not None and suffice(arm):
        expected = _of_groups(arm, flight, of_joints, solved.prior)
    else:
        scale, longest = solution.noise_scale, arc_cycles(arm)
        expected = intervals(sums.energy, sums.others, sums.noise, sums.own, scale, longest, solved.prior)
    return [_compare_sigmas(estimate, expected, closest), of_solution]


def _compare_groups(flight: Flight, joints: Groups) -> Room:
    """Compare the sums of each group of joint rows, relative to the lengths of the columns in all of them."""
    table = np.column_stack([joints.rows.z, joints.rows.w])
    length = np.maximum(np.linalg.norm(table, axis=0), 1e-150)
    ours = [sums for sums, _ in flight.blocks().joints]
    off = [np.max(np.abs(sums - joints.sums(g)) / np.outer(length, length)) for g, sums in enumerate(ours)]
    return Room("joint rows", len(ours) * len(length) ** 2, float(max(off)), None, LARGEST_TOLERANCE)


def _compare_walk(flight: Flight, used: Design) -> Room:
    """Compare what the noise of torques adds to the variance of the work."""
    ours = sum(block[4] for block in flight.blocks().energy)
    off = abs(ours - used.walk) / used.walk if used.walk > 0.0 else abs(ours)
    return Room("torque noise", 1, off, None, LARGEST_TOLERANCE)


def _of_groups(arm: Arm, flight: Flight, joints: Groups, prior: Prior | None) -> Intervals:
    """Sigmas and half widths from the library's own groups of joint rows."""
    blocks = [(sums, count) for sums, count in flight.blocks().joints if count > 0.0]
    apart = joints.apart()
    counts = np.array([count for _, count in blocks])
    half_s = 0.5 * arm.period_s * float(flight.native.sums.config.joint_row_cycles)
    elapsed_s = float(counts.sum()) / arm.n * half_s
    return joint_intervals(
        [sums for sums, _ in blocks], counts, joints.rows.noise, apart, apart[1] / arm.n, elapsed_s, prior
    )


def sums_of(
    arm: Arm,
    flight: Flight,
    used: Design,
    of_motors: Sequence[MotorRows],
    momentum: Turns | None,
    joints: Groups | None,
    combined: Combined,
) -> Sums:
    """The library's own blocks of the rows that are solved."""
    names = list(flight.names)
    blocks = flight.blocks()
    if joints is not None and suffice(arm):
        zero = np.zeros(len(names) + 1)
        groups_of = [Block(own, zero) for own, count in blocks.joints if count > 0.0]
        return Sums((), groups_of, joints.rows.noise, np.zeros_like(joints.rows.noise))

    def spread_out(own: Sequence[str], sums: Floats, factor: float) -> Floats:
        """(p+1, p+1) with the sums of some columns, and of their right-hand side if it has one.

        Columns that no parameter stands for alone are left out, as the library does.
        """
        kept = [k for k, name in enumerate(own) if name in names] + list(range(len(own), len(sums)))
        places = [names.index(own[k]) if k < len(own) else len(names) for k in kept]
        out = np.zeros((len(names) + 1, len(names) + 1))
        out[np.ix_(places, places)] = factor * sums[np.ix_(kept, kept)]
        return out

    noise = used.noise.copy()
    arcs = []
    zero = np.zeros(len(names) + 1)
    of_joint = [(own, factor) for own, factor in zip(of_motors, combined.weights, strict=True) if factor > 0.0]
    columns = {own.joint: impulse_names(arm, own.joint, flight.effects) for own, _ in of_joint}
    for block in blocks.motors if of_joint else []:
        sums = [spread_out(columns[own.joint], block[own.joint][0], factor) for own, factor in of_joint]
        arcs.append(Block(np.sum(sums, axis=0), zero))
    for own, factor in of_joint:
        noise += factor * own.rows.noise
    if momentum is not None and combined.momentum_weight > 0.0:
        factor = combined.momentum_weight
        arcs += [Block(spread_out(momentum.names, sums, factor), zero) for sums in blocks.momentum]
        noise += spread_out(momentum.names, momentum.noise.sum(axis=0), factor)
    if joints is not None and combined.joints_weight > 0.0:
        arcs += [Block(combined.joints_weight * sums, zero) for sums, _ in blocks.joints]
        noise += combined.joints_weight * joints.rows.noise
    return Sums([Block(*block) for block in blocks.energy], arcs, noise, used.noise)


def _compare_sigmas(estimate: Estimate, expected: Intervals, tolerance: float) -> Room:
    """Compare sigmas and half widths where every parameter has them, computed from the library's own blocks."""
    sigma = np.abs(estimate.sigma / expected.sigma - 1.0)
    half = np.abs(estimate.half95 / expected.half95 - 1.0)
    # the library computes Student's factor by a series expansion
    difference = float(max(sigma.max(), half.max() * tolerance / (STUDENT_TOLERANCE + tolerance)))
    return Room("sigmas", 2 * len(sigma), difference, None, tolerance)


def decode(arm: Arm, frames: NDArray[Any]) -> Reception:
    """`FRAME` records as numpy's side receives them."""
    return receive_log(arm, [_frame(f) for f in frames])


def _frame(record: Any) -> Frame:
    length = int(record["length"])
    return Frame(int(record["id"]), bytes(record["data"])[:length].ljust(length, b"\0"), int(record["flags"]))


def check_frames(arm: Arm, frames: NDArray[Any], flight: Flight | None = None) -> list[Room]:
    """Compare all stages on a log, beginning with its frames, which are fed to a newly created `flight`."""
    watch = Watch(flight or Flight(arm), trace=True)
    watch.frames(frames)
    flight, trace = watch.flight, watch.trace()
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
    return rooms + check_chain(arm, trace, flight, watch.left_out)


def check_cycles(arm: Arm, cycles: Cycles, flight: Flight | None = None) -> list[Room]:
    """Compare the stages after the receiver on cycles that are fed directly to a newly created `flight`."""
    watch = Watch(flight or Flight(arm), trace=True)
    watch.cycles(cycles)
    return check_chain(arm, watch.trace(), watch.flight, watch.left_out)
