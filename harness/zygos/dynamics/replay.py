# SPDX-License-Identifier: MIT
"""Integrates many short pieces of motion at once, with torques that are constant from SYNC to SYNC.

The pieces, for instance of a simulated run or of predictions of the next half second, begin at known states. They share
their steps, so a fixed-step RK4 is used; `zygos.simulation.plant` is the simulator for exact results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.kinematics import crossed
from zygos.balances.state import State
from zygos.dynamics.compiled import Stepper
from zygos.dynamics.joints import START, Drives, Moment

Array = NDArray[np.float64]

STEP_OF_MODE = 0.15
"""Longest step in units of 1/omega of the fastest mode: RK4 then has an error of 1e-6 of the mode's motion per
cycle."""


def substeps(dynamics: Drives, q: Array, period_s: float) -> int:
    """RK4 steps per SYNC period that resolve the arm's fastest mode at the postures q (..., N)."""
    turning = np.where(dynamics.rigid, np.inf, dynamics.rotor_inertia * dynamics.gear_ratio**2)
    links, rotors = dynamics.mobility(q), np.diag(1.0 / turning)
    stiff = np.where(dynamics.rigid, 0.0, dynamics.stiffness)
    damped = np.where(dynamics.rigid, 0.0, dynamics.damping)
    # a spring turns its link against the carrying body, and its rotor against both; friction turns one of them
    # friction that bends is a spring of what it rubs on
    bent = {place: dynamics.presliding_stiffness(place) for place in ("motor", "link", "spring")}
    own = np.where(dynamics.rigid, links, rotors)
    stiffest = _largest((links + rotors) * (stiff + bent["spring"]) + own * bent["motor"] + links * bent["link"])
    fastest = np.sqrt(stiffest)
    rub = dynamics.friction_slope("motor")
    loss = max(
        _largest((links + rotors) * damped), _largest(own * rub), _largest(links * dynamics.friction_slope("link"))
    )
    return max(1, int(np.ceil(period_s * max(fastest / STEP_OF_MODE, loss))))


def _largest(matrices: Array) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrices)), initial=0.0))


def replay(
    dynamics: Drives,
    period_s: float,
    start: Array,
    torque: Callable[[int, State], Array],
    before: Array,
    cycles: int,
    steps: int,
    begin: Moment = START,
) -> tuple[Array, Array]:
    """Integrate B pieces of motion from their states `start` (B, 4N+W) at the first SYNC (layout of `State.packed`).

    Internal states of laws with a memory are held within a step, and follow in half steps before and behind it.

    torque(k, states) gives the torques (B, N) of period k, Nm before the gear; `before` (B, N) are those of the period
    before the first. begin: time (B,), angle of the base (B,), direction to the Earth (B, 3) and internal states of
    laws at the first SYNC, for effects that depend on them. Returns the states (B, cycles, 4N+W) at each SYNC and the
    torques (B, cycles, N).
    """
    lag = dynamics.torque_lag
    instants = np.unique(np.concatenate([[0.0, period_s], [] if lag is None else lag]))
    state, now = start.copy(), begin
    if dynamics.states and begin.memory is None:
        now = replace(begin, memory=dynamics.memory_at_rest(State.unpacked(start)))
    compiled = Stepper.of(dynamics)
    states = np.empty((len(start), cycles, start.shape[1]))
    torques = np.empty((len(start), cycles, dynamics.n))
    for k in range(cycles):
        states[:, k] = state
        command = torque(k, State.unpacked(state))
        torques[:, k] = command
        if k == cycles - 1:
            break
        for first, stop in pairwise(instants):
            tau = command if lag is None else np.where(first >= lag, command, before)
            parts = max(1, int(np.ceil(steps * (stop - first) / period_s - 1e-9)))
            step_s = (stop - first) / parts
            if compiled:
                state, now = compiled.advance(state, tau, step_s, parts, now)
                continue
            for _ in range(parts):
                state, now = _step(dynamics, state, tau, step_s, now)
        before = command
    return states, torques


def exact_readings(dynamics: Drives, arm: Arm, states: Array, torques: Array) -> tuple[Array, Array, Array]:
    """Readings of exact sensors for states (B, n+1, 4N+W) under torques (B, n+1, N), in the first n cycles.

    Returns q, theta (B, n, N) and omega0 (B, n), (B, n, 3) in space or (B, n, 0) on a fixed base, each at the instant
    of its latch, which may be after SYNC. Between two SYNCs an angle is a cubic polynomial and a rate a parabola
    through the known values at both.
    """
    now, then, h = State.unpacked(states[:, :-1]), State.unpacked(states[:, 1:]), arm.period_s

    def angle(x: Array, y: Array, xd: Array, yd: Array, late_us: list[int]) -> Array:
        s = 1e-6 * np.array(late_us) / h
        basis = (2 * s**3 - 3 * s**2 + 1, h * (s**3 - 2 * s**2 + s), 3 * s**2 - 2 * s**3, h * (s**3 - s**2))
        return np.asarray(basis[0] * x + basis[1] * xd + basis[2] * y + basis[3] * yd, dtype=np.float64)

    q = angle(now.q, then.q, now.qd, then.qd, [j.latch_us + j.link_encoder.latch_us for j in arm.joints])
    late = [j.latch_us + j.motor_encoder.latch_us for j in arm.joints]
    theta = angle(now.theta, then.theta, now.thetad, then.thetad, late)
    if arm.imu.latch_us == 0 or not arm.free:
        return q, theta, now.base
    share = 1e-6 * arm.imu.latch_us / h
    rise = h * dynamics.accelerations(now.q, now.theta, now.base, now.qd, now.thetad, torques[:, :-1])[0]
    bend = then.base - now.base - rise
    return q, theta, np.asarray(now.base + share * rise + share**2 * bend, dtype=np.float64)


def _step(dynamics: Drives, x: Array, tau: Array, h: float, now: Moment) -> tuple[Array, Moment]:
    def later(share: float, rate: Array) -> Moment:
        turned = rate[..., 0] if _in_a_plane(x) else 0.0
        nadir = now.nadir
        if nadir is not None:
            # it stands still while the base turns; the third order of a step's turn is nothing
            turn = share * h * rate[..., :3]
            once = crossed(nadir, turn)
            nadir = nadir + once + 0.5 * crossed(once, turn)
        return replace(now, time=now.time + share * h, angle=now.angle + share * h * turned, nadir=nadir)

    if now.memory is not None:
        now = replace(now, memory=dynamics.remembered(State.unpacked(x), now.memory, 0.5 * h))
    first = _rate(dynamics, x, tau, now)
    second = _rate(dynamics, x + 0.5 * h * first, tau, later(0.5, x))
    third = _rate(dynamics, x + 0.5 * h * second, tau, later(0.5, x + 0.5 * h * first))
    fourth = _rate(dynamics, x + h * third, tau, later(1.0, x + 0.5 * h * second))
    # the base's angle is the integral of its rate by the same rule
    turning = x + h / 6.0 * (first + second + third)
    after, then = x + h / 6.0 * (first + 2.0 * (second + third) + fourth), later(1.0, turning)
    if then.memory is not None:
        then = replace(then, memory=dynamics.remembered(State.unpacked(after), then.memory, 0.5 * h))
    return after, then


def _in_a_plane(x: Array) -> bool:
    """Whether states have a base rate that is a number."""
    return bool(x.shape[-1] % 4 == 1)


def _rate(dynamics: Drives, x: Array, tau: Array, now: Moment) -> Array:
    s = State.unpacked(x)
    base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau, now)
    return State(s.qd, s.thetad, link, motor, base).packed()
