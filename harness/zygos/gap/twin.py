# SPDX-License-Identifier: MIT
"""The null twin of a run: what the same sensors would have seen of the same motion, had the model been right.

The model is integrated once along the measured path, each arc from its measured state, under the measured torques and
a weak servo that keeps it on that path; the servo's torque goes into the twin's log, so that the twin is an exact
solution of the model. Then only the sensors' noise is drawn anew. Whatever balances, smoother and fit make of noise, of
finite windows and of held torques, they make of the twin as well, and are read against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.field import nadir_along
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.joints import START, Drives, Moment
from zygos.dynamics.replay import exact_readings, replay, substeps
from zygos.effects import Effect, sensed
from zygos.errors import Undecided
from zygos.gap.balances import Layout, Sums, accumulate, balance_rows
from zygos.gap.memory import memory_along
from zygos.gap.record import MeasuredRun, smoothed_states
from zygos.simulation.sensors import draw_noise, torque_error

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Twin:
    """A noise-free twin of a record."""

    arm: Arm
    exact: Readings
    """What exact sensors would have read."""


def follow(dynamics: Drives, records: Sequence[MeasuredRun], sensors: Sequence[Effect] = ()) -> list[Twin]:
    """Twins of the records, integrated as one batch, with the model's h where it assumes one. sensors: their errors."""
    arm = records[0].arm
    h, half = arm.period_s, arm.smoother.points // 2
    # one cycle more than the arcs have, for what latches after the last SYNC
    longest = max(record.cycles for record in records) + 1
    paths: list[Array] = []
    torques: list[Array] = []
    for record in records:
        # the arcs with what the smoother needs before their first sample and behind their last
        at = record.starts[:, None] - half + np.arange(record.cycles + 1 + 2 * half)
        s = record.samples
        state = smoothed_states(arm, Readings(s.q[at], s.theta[at], record.omega0[at], s.tau[at]))
        path = state.packed()
        missing = longest - 1 - record.cycles
        paths.append(np.pad(path, ((0, 0), (0, missing), (0, 0)), mode="edge"))
        tau = record.samples.tau[record.starts[:, None] - 1 + np.arange(record.cycles + 2)]
        torques.append(np.pad(tau, ((0, 0), (0, missing), (0, 0)), mode="edge"))
    path, tau = np.concatenate(paths), np.concatenate(torques)
    # a model whose joints do not bend is far from an arm whose joints do
    rate = limits.SERVO_RIGID.value * limits.SERVO_RATE.value if dynamics.rigid.any() else limits.SERVO_RATE.value
    seen = [record.readings() for record in records]
    begin = Moment(*(np.concatenate([getattr(one, name)[:, 0] for one in seen]) for name in ("time", "turned")))
    kept = [memory[:, 0] for one in seen if (memory := memory_along(dynamics, arm, one)) is not None]
    begin = replace(begin, memory=np.concatenate(kept)) if kept else begin
    faced = [one.nadir[:, 0] for one in seen if one.nadir is not None]
    begin = replace(begin, nadir=np.concatenate(faced)) if faced else begin
    moved, applied = _servo(dynamics, path, tau, h, min(rate, limits.SERVO_OF_SAMPLING.value / h), begin)
    twins, first = [], 0
    for record, own in zip(records, seen, strict=True):
        rows_of = slice(first, first + len(record.starts))
        first += len(record.starts)
        twin = _twin(dynamics, arm, moved[rows_of, : record.cycles + 1], applied[rows_of, : record.cycles + 1])
        exact = replace(twin.exact, time=own.time, turned=own.turned, nadir=own.nadir)
        twins.append(replace(twin, exact=sensed(arm, exact, sensors)))
    return twins


def retrace(dynamics: Drives, record: MeasuredRun, speed: float, amplitude: float) -> Twin:
    """What a record would have looked like at another speed and amplitude of the motors' motion, had the model been
    right; as many cycles at the most."""
    arm = record.arm
    s, half, h = record.samples, record.half, record.arm.period_s
    begin, end = int(record.starts[0]) - half, int(record.starts[-1]) + record.cycles + half
    at = np.arange(begin, end)[None]
    state = smoothed_states(arm, Readings(s.q[at], s.theta[at], record.omega0[at], s.tau[at]))
    path = state.packed()[0]
    width = path.shape[1] - 4 * arm.n
    rest = np.concatenate([np.zeros(width), path[:, width : width + 2 * arm.n].mean(axis=0), np.zeros(2 * arm.n)])
    path = rest + amplitude * (path - rest)
    last = min(len(path) - 1, int(speed * (len(path) - 1)))
    when = np.arange(int(last / speed)) * speed
    slow = np.stack([np.interp(when, np.arange(len(path)), column) for column in path.T], axis=1)
    slow[:, [*range(width), *range(width + 2 * arm.n, slow.shape[1])]] *= speed
    arcs = max(1, len(slow) // record.cycles)
    cycles = min(record.cycles, len(slow))
    cut = slow[: arcs * cycles].reshape(arcs, cycles, -1)
    moved, applied = _servo(
        dynamics,
        cut,
        np.zeros((arcs, cycles + 1, arm.n)),
        h,
        min(limits.SERVO_RIGID.value * limits.SERVO_RATE.value, limits.SERVO_OF_SAMPLING.value / h),
    )
    twin = _twin(dynamics, arm, moved, applied)
    time = h * np.arange(twin.exact.q.shape[0] * twin.exact.q.shape[1]).reshape(twin.exact.q.shape[:2])
    rate = np.zeros(time.shape) if arm.spatial or not arm.free else twin.exact.omega0
    nadir = None
    if arm.nadir is not None:
        omega = twin.exact.omega0.reshape(-1, 3)
        nadir = nadir_along(np.array(arm.nadir), omega, time.ravel()).reshape(*time.shape, 3)
    turned = h * np.cumsum(rate).reshape(time.shape)
    return replace(twin, exact=replace(twin.exact, time=time, turned=turned, nadir=nadir))


def _twin(dynamics: Drives, arm: Arm, moved: Array, applied: Array) -> Twin:
    q, theta, omega0 = exact_readings(dynamics, arm, moved, applied)
    if not arm.free:
        omega0 = np.zeros((*q.shape[:-1], 3) if arm.spatial else q.shape[:-1])
    return Twin(arm, Readings(q, theta, omega0, applied[:, :-1]))


def _servo(
    dynamics: Drives, path: Array, tau: Array, h: float, rate: float, begin: Moment = START
) -> tuple[Array, Array]:
    """Move along a path (B, n, 4N+W) from its start under torques (B, n+1, N), the first that of the period before,
    and a servo of the given bandwidth, rad/s. Returns states and torques at every SYNC."""
    joints = dynamics.n
    reference = State.unpacked(path)
    first = State.unpacked(path[:, 0])
    states = replace(
        first,
        theta=np.where(dynamics.rigid, first.q, first.theta),
        thetad=np.where(dynamics.rigid, first.qd, first.thetad),
    )
    if dynamics.held_momentum is not None:
        base = dynamics.base_rate(states.q, dynamics.held_momentum, states.qd, states.thetad)
        states = replace(states, base=base)
    start = states.packed()
    postures = reference.q[:, :: limits.POSTURES_EVERY.value]
    # what a motor has to move: its rotor, or at a rigid joint and against gravity the link as well
    link = 1.0 / np.diagonal(dynamics.mobility(postures), axis1=-2, axis2=-1).reshape(-1, joints).max(axis=0)
    link /= dynamics.gear_ratio
    rotor = dynamics.rotor_inertia * dynamics.gear_ratio
    moved = np.where(dynamics.rigid, link, rotor)
    falls = _falling(dynamics, postures)
    if falls > 0.0:
        moved = np.where(dynamics.rigid, link, rotor + link)
        rate = min(max(rate, limits.SERVO_HOLDS.value * falls), limits.SERVO_OF_SAMPLING.value / h)

    def torque(k: int, now: State) -> Array:
        behind, slower = reference.theta[:, k] - now.theta, reference.thetad[:, k] - now.thetad
        return np.asarray(tau[:, k + 1] + moved * rate * (rate * behind + 2.0 * slower), dtype=np.float64)

    with np.errstate(over="ignore", invalid="ignore"):
        steps = substeps(dynamics, postures, h)
        went, applied = replay(dynamics, h, start, torque, tau[:, 0], path.shape[1], steps, begin)
    if not np.isfinite(went).all():
        raise Undecided(
            "the fitted model cannot be kept on the measured path, so far is it from the arm; remedy: check gear "
            "ratios, signs, zeros and torque_law of the arm file, then the simulation's values"
        )
    return went, applied


def _falling(dynamics: Drives, q: Array) -> float:
    """Rate at which the arm falls away from the postures q (..., N) at the most, 1/s; 0 where nothing falls."""
    n, step = dynamics.n, limits.FALL_STEP.value
    shifts = step * np.eye(n)
    rise = np.stack([dynamics.gravity_energy(q + e) - dynamics.gravity_energy(q - e) for e in shifts], axis=-1)
    if not rise.any():
        return 0.0

    def slope(at: Array) -> Array:
        """(..., N)"""
        parts = [dynamics.gravity_energy(at + e) - dynamics.gravity_energy(at - e) for e in shifts]
        return np.stack(parts, axis=-1) / (2.0 * step)

    bend = np.stack([(slope(q + e) - slope(q - e)) / (2.0 * step) for e in shifts], axis=-1)
    growth = np.linalg.eigvals(-dynamics.mobility(q) @ bend)
    return float(np.sqrt(max(0.0, np.max(growth.real))))


def measure(twin: Twin, seed: int) -> Readings:
    """One reading of a twin: its exact readings with the errors of the declared sensors and the wire, drawn
    for this seed."""
    arm, exact = twin.arm.over_the_wire, twin.exact
    arcs, cycles, _ = exact.q.shape
    noise = draw_noise(arm, arcs * cycles, [limits.TWIN_SEEDS.value + seed])

    def shaped(x: Array) -> Array:
        return np.asarray(x[0].reshape(arcs, cycles, -1), dtype=np.float64)

    signs = [
        [e.sign for e in side] for side in zip(*((j.link_encoder, j.motor_encoder) for j in arm.joints), strict=True)
    ]
    theta = exact.theta + np.array(signs[1]) * shaped(noise.motor)
    q = exact.q + np.array(signs[0]) * shaped(noise.link)
    omega0 = exact.omega0
    if arm.free:
        gyro = shaped(noise.gyro) @ arm.mount.T
        omega0 = omega0 + (gyro if arm.spatial else gyro @ arm.axis)
    # the motor's encoder measures both angles of a rigid joint
    q = np.where([joint.flexible for joint in arm.joints], q, theta)
    tau = exact.tau + torque_error(exact.tau, shaped(noise.torque), shaped(noise.torque_share))
    return replace(exact, q=q, theta=theta, omega0=omega0, tau=tau)


def draws(
    twin: Twin,
    accepted: NDArray[np.bool_],
    count: int,
    layout: Layout,
    uncentred: Sequence[int],
    zeros: tuple[Array, ...],
    values: Array,
    seed: int = 0,
    every: int = 1,
    known: Array | None = None,
) -> Sums:
    """Sums (count, ...) of readings of a twin, with seeds seed .. seed + count - 1, and what noise adds to them on
    average. zeros, values, every: as of `balance_rows`; known: the twin's own coefficients, as of `accumulate`."""

    def sums(readings: Sequence[Readings]) -> Sums:
        rows = balance_rows(layout, stacked(readings), values, zeros=zeros, every=every)
        return accumulate(rows, accepted, uncentred, known)

    # several at a time, as many as stay in the cache of a processor; the exact readings are the first
    seen = [twin.exact, *(measure(twin, seed + k) for k in range(count))]
    together = max(1, limits.DRAWN_TOGETHER.value // (twin.exact.omega0.size * twin.arm.n))
    parts = [sums(seen[k : k + together]) for k in range(0, count + 1, together)]
    grams = [np.concatenate(each) for each in zip(*(one.gram for one in parts), strict=True)]
    scores = [np.concatenate(each)[1:] for each in zip(*(one.scores or () for one in parts), strict=True)]
    drawn = tuple(gram[1:] for gram in grams)
    noise = tuple(own.mean(axis=0) - gram[0] for own, gram in zip(drawn, grams, strict=True))
    return Sums(drawn, parts[0].count, noise, tuple(scores) or None)


def stacked(readings: Sequence[Readings]) -> Readings:
    """Readings of the same arcs with an axis more, in front."""
    fields = ("q", "theta", "omega0", "tau")
    return replace(readings[0], **{name: np.stack([getattr(one, name) for one in readings]) for name in fields})
