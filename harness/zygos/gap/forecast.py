# SPDX-License-Identifier: MIT
"""The gap: how well a model predicts the next half second of an untouched run, in units of the sensors' noise.

The state at the start of a segment is fitted to half a second of readings with the model under test, and the half
second behind it is predicted under the measured torques. The motion is chaotic, so longer predictions compare nothing;
a start from smoothed states alone would add their noise, and a fit over the scored half second would hide the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.joints import Drives, Moment
from zygos.dynamics.replay import exact_readings, replay, substeps
from zygos.effects import Effect, sensed
from zygos.errors import ZygosError
from zygos.gap.memory import memory_along
from zygos.gap.record import MeasuredRun, smoothed_states
from zygos.gap.twin import Twin, measure
from zygos.runs.smoother import coefficients

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stretches:
    """Stretches of a run, one second each, that begin every half second or, in a long run, are evenly spread.

    S segments of 2n cycles. W: 1 in a plane, 3 in space, 0 on a fixed base."""

    arm: Arm
    readings: Array
    """(S, 2n, 2N+W) q, theta, omega0: rad, rad/s."""
    tau: Array
    """(S, 2n, N) Nm."""
    before: Array
    """(S, N) torque of the period before the segment, Nm."""
    guess: Array
    """(S, 4N+W) smoothed state at the first sample, packed as `State.packed`."""
    time_s: Array
    """(S, 2n) since the run's first cycle."""
    turned: Array
    """(S,) angle that the base of a planar arm has turned since then, at the first sample, rad."""
    nadir: Array | None
    """(S, 3) unit vector to the Earth in base axes, at the first sample; None of an arm that does not know it."""
    runs: tuple[Readings, ...]
    """The arcs of the runs that they are cut from."""
    begin: NDArray[np.int64]
    """(S, 3) run, arc and cycle of the first sample."""

    @classmethod
    def joined(cls, parts: Sequence[Stretches]) -> Stretches:
        """Stretches of several runs of one arm, one run after the other."""
        return cls(
            parts[0].arm,
            np.concatenate([one.readings for one in parts]),
            np.concatenate([one.tau for one in parts]),
            np.concatenate([one.before for one in parts]),
            np.concatenate([one.guess for one in parts]),
            np.concatenate([one.time_s for one in parts]),
            np.concatenate([one.turned for one in parts]),
            np.concatenate(faced) if (faced := [x for one in parts if (x := one.nadir) is not None]) else None,
            tuple(run for one in parts for run in one.runs),
            np.concatenate([one.begin + np.array([k, 0, 0]) for k, one in enumerate(parts)]),
        )

    @property
    def run(self) -> NDArray[np.int64]:
        """(S,) number of each one's run, from 0."""
        return self.begin[:, 0]

    def thinned(self, every: int) -> Stretches:
        """Every so many of them."""
        own = slice(None, None, every)
        return replace(
            self,
            readings=self.readings[own],
            tau=self.tau[own],
            before=self.before[own],
            guess=self.guess[own],
            time_s=self.time_s[own],
            turned=self.turned[own],
            nadir=None if self.nadir is None else self.nadir[own],
            begin=self.begin[own],
        )

    def memory(self, dynamics: Drives) -> NDArray[np.complex128] | None:
        """(S, ·) internal states of a model's laws at the first samples; None where it has none."""
        each = [memory for run in self.runs if (memory := memory_along(dynamics, self.arm, run)) is not None]
        if not each:
            return None
        return np.stack([each[run][arc, cycle] for run, arc, cycle in self.begin.tolist()])

    @property
    def sigma(self) -> Array:
        """(2N+W,) declared deviations of one reading of q, theta, omega0 that came over the wire."""
        arm = self.arm.over_the_wire
        link, motor = [j.link_encoder.sigma_rad for j in arm.joints], [j.motor_encoder.sigma_rad for j in arm.joints]
        return np.array([*link, *motor, *[arm.imu.rate_sigma] * self.width])

    @property
    def width(self) -> int:
        """W, signals of the base."""
        return int(self.guess.shape[-1]) - 4 * self.arm.n


@dataclass(frozen=True)
class Forecast:
    """Predictions of the second half of every segment."""

    residual: Array
    """(S, n, 2N+W) predicted less measured, in units of sigma."""
    path: Array
    """(S, 2n, 2N+W) q, theta, omega0 from the fitted start on, rad and rad/s: the first half is fitted."""
    solver: Array
    """(S, states, readings + states) by which what is left of the first half second corrects a start."""
    run: NDArray[np.int64]
    """(S,) number of each segment's run, from 0."""

    @property
    def predicted(self) -> Array:
        """(S, n, 2N+W) q, theta, omega0: rad, rad/s."""
        return self.path[:, self.path.shape[1] // 2 :]

    def of_run(self, run: int) -> Forecast:
        """The predictions of one run."""
        return self._of(self.run == run)

    def thinned(self, every: int) -> Forecast:
        """Those of every so many segments."""
        return self._of(slice(None, None, every))

    def repeated(self, times: int) -> Forecast:
        """The same predictions so many times, one after the other."""
        arrays = (self.residual, self.path, self.solver, self.run)
        return Forecast(*(np.concatenate([x] * times) for x in arrays))

    def _of(self, own: slice | NDArray[np.bool_]) -> Forecast:
        return Forecast(self.residual[own], self.path[own], self.solver[own], self.run[own])

    @property
    def gap(self) -> float:
        """Root mean square residual, sigma; infinite where a prediction diverges."""
        return float(np.sqrt(np.mean(self._square)))

    @property
    def median(self) -> float:
        """Median over the segments of their root mean square residual, sigma."""
        return float(np.median(self._each))

    @property
    def tenth(self) -> float:
        """What a tenth of the segments exceeds, sigma."""
        return float(np.percentile(self._each, limits.TAIL_PERCENT.value, method="higher"))

    @property
    def signals(self) -> Array:
        """(2N+W,) root mean square residual of each signal, sigma."""
        return np.asarray(np.sqrt(np.mean(self._square, axis=(0, 1))), dtype=np.float64)

    @cached_property
    def _square(self) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            square = self.residual**2
        # beyond all reason is as good as infinite, and sums without overflow
        return np.where(square < limits.DIVERGED.value, square, np.inf)

    @property
    def _each(self) -> Array:
        return np.asarray(np.sqrt(np.mean(self._square, axis=(1, 2))), dtype=np.float64)


def cut(record: MeasuredRun) -> Stretches:
    """Segments of the arcs of a run, as those of its twin. Errors: ZygosError where an arc has no second."""
    s = record.samples
    seen = Readings(s.q, s.theta, record.omega0, s.tau, record.clock_s, record.turned, record.nadir)
    stretches = [(int(start), int(start) + record.cycles) for start in record.starts]
    return _segments(record.arm, seen, stretches, record.readings(), str(record.path))


def cut_twin(twin: Twin, seed: int = 0) -> Stretches:
    """Segments of one reading of a twin, whose arcs are stretches."""
    seen = measure(twin, seed)
    arcs, cycles, _ = seen.q.shape
    assert seen.time is not None
    assert seen.turned is not None
    signals = (seen.q, seen.theta, seen.omega0, seen.tau, seen.time, seen.turned)
    flat = Readings(*(x.reshape(arcs * cycles, *x.shape[2:]) for x in signals))
    flat = replace(flat, nadir=None if seen.nadir is None else seen.nadir.reshape(arcs * cycles, 3))
    stretches = [(i * cycles, (i + 1) * cycles) for i in range(arcs)]
    return _segments(twin.arm, flat, stretches, seen, "the twin")


def _segments(arm: Arm, samples: Readings, stretches: Sequence[tuple[int, int]], run: Readings, name: str) -> Stretches:
    half, n = arm.smoother.points // 2, max(2, round(limits.HORIZON_S.value / arm.period_s))
    first = max(half, 1)
    listed = [
        (at, k, at - a)
        for k, (a, b) in enumerate(stretches)
        for at in range(a + first, b - max(2 * n, half + 1) + 1, n)
    ]
    if not listed:
        raise ZygosError(f"{name}: no stretch is long enough to predict anything; remedy: a run from a better bus")
    placed = np.array(listed)
    most = min(limits.MOST_STRETCHES.value, limits.MOST_STRETCHES.value * limits.LONG_STATE.value // (4 * arm.n + 4))
    if len(placed) > most:
        placed = placed[np.linspace(0, len(placed) - 1, most).round().astype(np.int64)]
    starts = placed[:, 0]
    at = starts[:, None] + np.arange(2 * n)
    around = starts[:, None] + np.arange(-half, half + 1)
    state = smoothed_states(
        arm, Readings(samples.q[around], samples.theta[around], samples.omega0[around], samples.tau[around])
    )
    guess = state.packed()[:, 0]
    base = [samples.omega0[at].reshape(*at.shape, -1)] if arm.free else []
    readings = np.concatenate([samples.q[at], samples.theta[at], *base], axis=-1)
    assert samples.time is not None
    assert samples.turned is not None
    turned = samples.turned[starts]
    nadir = None if samples.nadir is None else samples.nadir[starts]
    begin = placed.copy()
    begin[:, 0] = 0
    before = samples.tau[starts - 1]
    return Stretches(arm, readings, samples.tau[at], before, guess, samples.time[at], turned, nadir, (run,), begin)


def forecast(
    dynamics: Drives, segments: Stretches, sensors: Sequence[Effect] = (), near: Forecast | None = None
) -> Forecast:
    """Predict every segment with a model, whose sensors have these errors. Where it assumes an angular momentum, the
    base rate follows from it. near: predictions of the same segments with a model that differs little; the motion
    depends on its start as it does there."""
    # a model that is far off may diverge: then the gap is infinite, and says so
    with np.errstate(over="ignore", invalid="ignore"):
        return _forecast(dynamics, segments, sensors, near)


def _forecast(dynamics: Drives, segments: Stretches, sensors: Sequence[Effect], near: Forecast | None) -> Forecast:
    arm, joints = segments.arm, segments.arm.n
    n = segments.readings.shape[1] // 2
    steps = substeps(dynamics, segments.readings[:, ::n, :joints], arm.period_s)
    sigma = segments.sigma
    unpack, free = _free(dynamics, joints, segments.width)
    width = segments.width
    scale = np.concatenate([sigma[2 * joints :], np.tile(sigma[: 2 * joints], 2)])
    scale[width + 2 * joints :] /= limits.HORIZON_S.value
    scale = scale[free]

    memory = segments.memory(dynamics)

    def move(x: Array, copies: int, cycles: int) -> Array:
        """(copies * S, cycles, 2N+1) q, theta, omega0."""
        tau = np.tile(np.concatenate([segments.tau, segments.tau[:, -1:]], axis=1), (copies, 1, 1))
        before = np.tile(segments.before, (copies, 1))
        begin = Moment(
            np.tile(segments.time_s[:, 0], copies),
            np.tile(segments.turned, copies),
            None if memory is None else np.tile(memory, (copies, 1)),
            None if segments.nadir is None else np.tile(segments.nadir, (copies, 1)),
        )
        states, torques = replay(
            dynamics, arm.period_s, unpack(x), lambda k, _: tau[:, k], before, cycles + 1, steps, begin
        )
        q, theta, omega0 = exact_readings(dynamics, arm, states, torques)
        if sensors:
            seen = sensed(arm, Readings(q, theta, omega0, torques[:, :-1]), sensors)
            q, theta, omega0 = seen.q, seen.theta, seen.omega0
        return np.concatenate([q, theta, omega0.reshape(*q.shape[:-1], width)], axis=-1)

    def misfit(seen: Array) -> Array:
        """(copies, S, instants * signals) in sigma."""
        count = seen.shape[1]
        shaped = seen.reshape(-1, len(segments.tau), count, seen.shape[-1])
        return np.asarray((shaped - segments.readings[:, :count]) / sigma, dtype=np.float64).reshape(
            *shaped.shape[:2], -1
        )

    x = segments.guess[:, free]
    size = len(free)
    hold = np.broadcast_to(np.diag(scale / _held(segments)[free]), (len(x), size, size))
    if near is None or near.solver.shape[1] != size:
        shifted = np.concatenate([x, *(x + scale * (np.arange(size) == k) for k in range(size))])
        first = misfit(move(shifted, size + 1, n))
        # in half a second the motion is all but linear in its start, so one Jacobian serves all rounds
        jacobian = np.moveaxis(first[1:] - first[0], 0, -1)
        solver, left, guess = np.linalg.pinv(np.concatenate([jacobian, hold], axis=1)), first[0], x
    else:
        solver, left, guess = near.solver, misfit(move(x, 1, n))[0], x
    for _ in range(limits.FORECAST_ROUNDS.value):
        strayed = (hold @ ((x - guess) / scale)[..., None])[..., 0]
        x = x - (solver @ np.concatenate([left, strayed], axis=1)[..., None])[..., 0] * scale
        left = misfit(move(x, 1, n))[0]
    path = move(x, 1, 2 * n)
    return Forecast((path - segments.readings)[:, n:] / sigma, path, solver, segments.run)


def _held(segments: Stretches) -> Array:
    """(4N+W,) how far a start may stray from the smoothed state: many deviations of it, which binds no model that is
    about right, and keeps a wrong one from absurd states."""
    arm, joints = segments.arm, segments.arm.n
    rate = float(np.linalg.norm(coefficients(arm.smoother.points, arm.smoother.order, 0.0, 1))) / arm.period_s
    angles = segments.sigma[: 2 * joints]
    return limits.STRAY.value * np.concatenate([segments.sigma[2 * joints :], angles, rate * angles])


def _free(dynamics: Drives, joints: int, width: int) -> tuple[Callable[[Array], Array], NDArray[np.int64]]:
    """How a packed state follows from its free entries, and which these are."""
    held = dynamics.held_momentum
    rigid = np.flatnonzero(dynamics.rigid)
    motors = [*(width + joints + rigid).tolist(), *(width + 3 * joints + rigid).tolist()]
    tied = {*motors, *([] if held is None else [0])}
    free = np.array([k for k in range(width + 4 * joints) if k not in tied])

    def unpack(x: Array) -> Array:
        out = np.zeros((len(x), width + 4 * joints))
        out[:, free] = x
        out[:, width + joints + rigid] = out[:, width + rigid]
        out[:, width + 3 * joints + rigid] = out[:, width + 2 * joints + rigid]
        if held is not None:
            s = State.unpacked(out)
            out[:, 0] = dynamics.base_rate(s.q, held, s.qd, s.thetad)
        return out

    return unpack, free
