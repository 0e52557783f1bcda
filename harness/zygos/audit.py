"""What a run says of its own arm file: which signal is swapped, inverted, stuck, saturated, skewed or of another scale.

No model is needed. Angles, rates and accelerations come from one smooth window phi(t) that slides over the readings:
a reading's mean, and after integration by parts those of its rate and acceleration, are sums of readings with weights
phi, -phi' and phi'' (Shinbrot's modulating functions). Nothing is differentiated, and a reading that is latched late is
weighted where it was taken. What these means must satisfy decides (docs/check-arm.md):

    motor of a flexible joint   tau = Im n thetadd + k/n (theta - q) + b/n (thetad - qd) + friction, Im, k, b >= 0
    both encoders of a joint    theta - q = what the spring carries + skew * rate + zero
    the whole arm               the energy balance of the C library closes (`Estimate.residual`)

Each fault is a change to the readings; the one under which the equations hold best is named, if it wins by `SURE`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, nnls

from zygos.arm import Arm, Encoder, Joint, TorqueLaw
from zygos.cycles import Cycles
from zygos.errors import ZygosError
from zygos.flight import Flight
from zygos.gap.record import ANGLE_STEP, COARSE_RATE_STEP, RATE_STEP
from zygos.reference.cycle import segments

Array = NDArray[np.float64]

SURE = 1.5
"""What the equations leave unexplained must shrink by this factor before a fault is named. Trials: wrong readings of
the examples leave 1.9 times as much or more; changes to right ones win nothing (tests/unit/test_audit.py)."""
SURE_LAW = 1.15
"""The same for the torque law, whose error is small: 1.27 or more in the trials, and 1.02 from seed to seed."""
EXPLAINED = 0.9
"""Share of a torque that may stay unexplained before nothing is said of its sign."""
STIFF = 0.99
"""Correlation of the two encoders' rates from which on the deflection is a small difference."""
SKEW_SIGMAS, SKEW_SHARE = 4.0, 0.02
"""A skew is named from so many standard errors on, and from this share of the period on."""
ZERO_SIGMAS = 6.0
NOISE_FACTOR = 4.0
"""Noise above so many times the declared one is named: the held torque's own steps reach 2.1 in the trials."""
BLOCKS = 8
"""Blocks of the jackknife: rows close to each other err alike."""
FLAT_CYCLES, FLAT_QUANTA, FLAT_SHARE = 20, 20.0, 0.02
"""A reading that keeps its code so long, while its partner moves so far (quanta, and share of its range), is stuck."""
FLAT_TOPS, FLAT_TOP_CYCLES = 3, 3
"""So many stretches of so many equal codes at an end of the range are a limit, not chance."""
LOST = 0.02
"""Share of the cycles whose loss is worth a word."""
MOST_CYCLES = 20_000
"""The balance of the whole arm is tried on so many cycles at the most: it is repeated for every fault."""


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a signal."""

    signal: str
    fault: str
    """For instance "inverted", "swapped with elbow link angle", "stuck", "skewed 3.0 ms ± 0.1"."""
    evidence: str
    """The number that says how sure it is."""
    remedy: str


@dataclass(frozen=True)
class Signal:
    """What a signal is like. Numbers are NaN where there are none."""

    name: str
    unit: str
    share: float
    """Cycles received of those expected."""
    low: float
    high: float
    step: float
    """Smallest step of the readings where they lie on a grid."""
    quantum: float
    """The declared step."""
    noise: float
    """Standard deviation of what changes from cycle to cycle without rhyme."""
    declared: float
    """Its declared value."""
    decided: bool
    """Whether its sign and its place were confirmed."""
    verdict: str


@dataclass(frozen=True)
class Pair:
    """The two encoders of a flexible joint."""

    joint: str
    skew_s: float
    """By how much the motor encoder's reading is newer than the link encoder's, after the latches of the arm file."""
    skew_sigma_s: float
    zero_rad: float
    """theta - q where the spring carries nothing."""
    zero_sigma_rad: float
    stiffness: float
    """Nm/rad, of the difference as it is read; NaN where it is not determined."""
    stiffness_unskewed: float
    """Nm/rad, with the skew taken out."""
    stiff: bool
    """Whether the deflection is a small difference, whose skew is told from the load's accelerations."""


@dataclass(frozen=True)
class Audit:
    """All that is found in a run."""

    signals: tuple[Signal, ...]
    findings: tuple[Finding, ...]
    pairs: tuple[Pair, ...]
    laws: dict[str, float] = field(default_factory=dict)
    """rms residual of the energy balance in J under each torque law; empty where the C library has no columns."""
    notes: tuple[str, ...] = ()
    """What could not be decided, and why."""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong and every signal's sign and place is confirmed."""
        return not self.findings and all(signal.decided for signal in self.signals)


@dataclass(frozen=True)
class Traffic:
    """What only the frames show. The keys are signal names as in `signal_names`."""

    share: dict[str, float] = field(default_factory=dict)
    saturated: dict[str, int] = field(default_factory=dict)
    """Frames with the outermost code of the wire."""
    period_s: float = math.nan
    """Of the SYNC producer's own clock (FTIME)."""


def signal_names(arm: Arm) -> list[tuple[str, str, int]]:
    """Name, field of `Cycles` and column of each signal. A rigid joint has one angle."""
    out = []
    for i, joint in enumerate(arm.joints):
        if joint.flexible:
            out.append((f"{joint.name} link angle", "q", i))
        out += [(f"{joint.name} motor angle", "theta", i), (f"{joint.name} torque", "tau", i)]
    if arm.free:
        out += [(f"gyro {axis}", "omega", i) for i, axis in enumerate("xyz")]
    return out


def audit(
    arm: Arm, cycles: Cycles, traffic: Traffic | None = None, progress: Callable[[float], None] | None = None
) -> Audit:
    """Audit a run against its arm file. progress is called with the share that is done.

    Errors: ZygosError where the run has another number of joints than the arm.
    """
    if cycles.q.shape[1] != arm.n:
        raise ZygosError(
            f"the run has {cycles.q.shape[1]} joints, arm {arm.name} has {arm.n}; remedy: give the arm file the run "
            "was made with"
        )
    return _Auditor(arm, cycles, traffic or Traffic(), progress or (lambda _: None)).audit()


# ---------------------------------------------------------------------------------------------------- the window


_BELL = (1.0 - Polynomial([0.0, 1.0]) ** 2) ** 6


class Window:
    """The sliding window, as wide on either side as two windows of the arm's smoother."""

    def __init__(self, arm: Arm, cycles: Cycles) -> None:
        """Errors: ZygosError where no stretch of the run is long enough for it to slide."""
        self.h = arm.period_s
        self.width = 2 * arm.smoother.points * self.h
        self.reach = math.ceil(self.width / self.h) + 1
        self.stride = max(1, 2 * arm.smoother.points // 8)
        self.ranges = [r for r in segments(cycles).ranges if r[1] - r[0] > 2 * self.reach]
        self.count = sum(len(range(0, b - a - 2 * self.reach, self.stride)) for a, b in self.ranges)

    def __call__(self, readings: Array, derivative: int = 0, late_s: float = 0.0) -> Array:
        """(instants,) the windowed mean of a reading (n,), or of its derivative, taken late_s after SYNC."""
        at = self.h * np.arange(-self.reach, self.reach + 1, dtype=np.float64)

        def bell(t: Array, order: int) -> Array:
            x = t / self.width
            inside: Array = np.where(np.abs(x) < 1.0, _BELL.deriv(order)(x), 0.0)
            return inside

        weights = (-1.0 / self.width) ** derivative * bell(at + late_s, derivative) / bell(at, 0).sum()
        middle = float(np.mean(readings[self.ranges[0][0] : self.ranges[-1][1]]))
        middle = middle if math.isfinite(middle) else 0.0
        parts = [
            np.convolve(readings[a:b] - middle, weights[::-1], mode="valid")[:: self.stride][
                : len(range(0, b - a - 2 * self.reach, self.stride))
            ]
            for a, b in self.ranges
        ]
        return np.concatenate(parts) + (middle if derivative == 0 else 0.0)


def calibrated(arm: Arm, cycles: Cycles) -> tuple[Array, Array]:
    """(n, N) link and motor angles, rad, signs and zeros applied."""

    def angles(encoders: Sequence[Encoder], readings: Array) -> Array:
        out: Array = np.array([e.sign for e in encoders]) * (readings - np.array([e.zero_rad for e in encoders]))
        return out

    motors = angles([j.motor_encoder for j in arm.joints], cycles.theta)
    links = angles([j.link_encoder for j in arm.joints], cycles.q)
    rigid = [not j.flexible for j in arm.joints]
    links[:, rigid] = motors[:, rigid]
    return links, motors


_TORQUE_LATE = {"applied_from_sync": 0.5, "applied_previous_cycle": -0.5, "sampled": 0.0}
"""Middle of the time that a torque record stands for, in periods after SYNC."""


class Means:
    """Windowed means of all signals of an arm: lists by joint, then by derivative."""

    def __init__(self, arm: Arm, cycles: Cycles) -> None:
        """Slide the window over a run. Errors: ZygosError as `Window`."""
        window = Window(arm, cycles)
        self.arm, self.count = arm, window.count
        if not self.count:
            return
        q, theta = calibrated(arm, cycles)
        late = [
            (1e-6 * (j.latch_us + j.link_encoder.latch_us), 1e-6 * (j.latch_us + j.motor_encoder.latch_us))
            for j in arm.joints
        ]
        torque_late = _TORQUE_LATE[arm.torque_law] * arm.period_s
        self.q = [[window(q[:, i], d, late[i][0]) for d in range(3)] for i in range(arm.n)]
        self.theta = [[window(theta[:, i], d, late[i][1]) for d in range(3)] for i in range(arm.n)]
        self.tau = [window(cycles.tau[:, i], 0, torque_late) for i in range(arm.n)]
        self.one = np.ones(self.count)

    def moves(self, joint: int) -> bool:
        """Whether an encoder of the joint sees it move."""
        pair = self.arm.joints[joint]
        return bool(
            np.ptp(self.q[joint][0]) > FLAT_QUANTA * pair.link_encoder.quantum_rad
            or np.ptp(self.theta[joint][0]) > FLAT_QUANTA * pair.motor_encoder.quantum_rad
        )


# ------------------------------------------------------------------------------------- what must hold at a motor


@dataclass(frozen=True)
class Change:
    """A fault as a change that undoes it: link angle, motor angle and torque of joint i are `sign * scale` times those
    of the joints `source[kind][i]`; the two encoders of the joints in `exchanged` change places."""

    what: str
    """"inverted", "swapped", "exchanged", "scaled"."""
    kind: str = ""
    """Field of `Cycles`."""
    joints: tuple[int, ...] = ()
    source: tuple[int, ...] = ()
    factor: float = 1.0


NOTHING = Change("nothing")


def changed(cycles: Cycles, change: Change, zeros: dict[str, Array]) -> Cycles:
    """The run as it would be without the fault. zeros: (N,) of each kind of reading, about which signs turn."""
    if change.what == "nothing":
        return cycles
    if change.what == "exchanged":
        q, theta = cycles.q.copy(), cycles.theta.copy()
        for i in change.joints:
            q[:, i], theta[:, i] = cycles.theta[:, i], cycles.q[:, i]
        return replace(cycles, q=q, theta=theta)
    readings: Array = getattr(cycles, change.kind).copy()
    zero = zeros.get(change.kind, np.zeros(readings.shape[1]))
    for i, j in zip(change.joints, change.source, strict=True):
        readings[:, i] = zero[i] + change.factor * (getattr(cycles, change.kind)[:, j] - zero[i])
    fields: dict[str, Any] = {change.kind: readings}
    return replace(cycles, **fields)


def _unexplained(y: Array, positive: Sequence[Array], free: Sequence[Array]) -> float:
    """Share of y, beside what the free columns take, that non-negative amounts of the positive columns do not give."""
    basis, _ = np.linalg.qr(np.column_stack([c / max(float(np.linalg.norm(c)), 1e-300) for c in free]))

    def beside(x: Array) -> Array:
        out: Array = x - basis @ (basis.T @ x)
        return out

    target = beside(y)
    size = float(np.linalg.norm(target))
    if size <= 1e-9 * float(np.linalg.norm(y)) or size == 0.0:
        return 1.0
    columns = []
    for x in positive:
        rest = beside(x)
        length = float(np.linalg.norm(rest))
        if length > 1e-9 * max(float(np.linalg.norm(x)), 1e-300):
            columns.append(rest / length)
    if not columns:
        return 1.0
    _, left = nnls(np.column_stack(columns), target)
    return float(left) / size


def _law(means: Means, joint: int, q: list[Array], theta: list[Array], tau: Array) -> float:
    """Unexplained share of a torque under the motor's law (module docstring). Friction may have any size."""
    rate = theta[1]
    direction = np.tanh(rate / max(0.05 * float(np.std(rate)), 1e-300))
    if means.arm.joints[joint].flexible:
        return _unexplained(tau, [theta[2], theta[0] - q[0], theta[1] - q[1]], [means.one, rate, direction])
    free = [means.one]
    if means.arm.feels_gravity[joint]:
        free += [f(other[0]) for other in means.theta for f in (np.sin, np.cos)]
    return _unexplained(tau, [theta[2], rate, direction], free)


class _Motors:
    """How well every fault that is confined to angles and torques of joints explains the run."""

    def __init__(self, means: Means, use: Sequence[int]) -> None:
        self.means, self.use = means, list(use)
        self.arm = means.arm
        rates = [
            max(abs(self._correlation(means.q[j][1], means.theta[i][1])) for j in self.use) if i in self.use else 0.0
            for i in range(self.arm.n)
        ]
        self.stiff = [joint.flexible and rate >= STIFF for joint, rate in zip(self.arm.joints, rates, strict=True)]
        self._known: dict[Any, float] = {}

    @staticmethod
    def _correlation(x: Array, y: Array) -> float:
        spread = float(np.std(x) * np.std(y))
        return float(np.mean((x - x.mean()) * (y - y.mean()))) / spread if spread > 0.0 else 0.0

    def score(self, joint: int, change: Change) -> float:
        """Logarithm of what stays unexplained at a joint: of its torque, and of a stiff joint's one rate by the
        other, whose scale is 1 as well."""
        m = self.means
        source = {"q": joint, "theta": joint, "tau": joint}
        factor = {"q": 1.0, "theta": 1.0, "tau": 1.0}
        exchanged = change.what == "exchanged" and joint in change.joints
        if change.kind and joint in change.joints:
            source[change.kind] = change.source[change.joints.index(joint)]
            factor[change.kind] = change.factor
        key = (joint, *source.values(), *factor.values(), exchanged)
        if key not in self._known:
            q = [factor["q"] * x for x in m.q[source["q"]]]
            theta = [factor["theta"] * x for x in m.theta[source["theta"]]]
            if not self.arm.joints[joint].flexible:
                q = theta
            if exchanged:
                q, theta = theta, q
            value = math.log(max(_law(m, joint, q, theta, factor["tau"] * m.tau[source["tau"]]), 1e-6))
            if self.stiff[joint]:
                # as the slope of a stiff joint is 1, a scale or a sign leaves the difference of the rates
                left = np.std(theta[1] - q[1]) / max(float(np.std(theta[1])), float(np.std(q[1])), 1e-300)
                value += math.log(max(float(left), 1e-6))
            self._known[key] = value
        return self._known[key]

    def total(self, change: Change) -> float:
        """Sum of the scores of the joints in use."""
        return sum(self.score(i, change) for i in self.use)

    def changes(self) -> Iterator[Change]:
        """The faults that are told apart."""
        for i in self.use:
            flexible = self.arm.joints[i].flexible
            ratio = float(self.arm.gear_ratios[i])
            for kind in ("q", "theta", "tau") if flexible else ("tau",):
                yield Change("inverted", kind, (i,), (i,), -1.0)
            if flexible and not self.stiff[i]:
                yield Change("exchanged", "", (i,))
            if flexible:
                scales = {ratio, 1.0 / ratio} - {1.0}
                if self.stiff[i]:
                    scales = {float(np.std(self.means.q[i][1]) / np.std(self.means.theta[i][1]))}
                for scale in scales:
                    yield Change("scaled", "q", (i,), (i,), 1.0 / scale)
                    yield Change("scaled", "theta", (i,), (i,), scale)
        for kind in ("q", "theta", "tau"):
            swap = self._best_assignment(kind)
            if swap is not None:
                yield swap

    def _best_assignment(self, kind: str) -> Change | None:
        joints = [i for i in self.use if kind == "tau" or self.arm.joints[i].flexible]
        if len(joints) < 2:
            return None
        costs = np.array([[self.score(i, Change("swapped", kind, (i,), (j,))) for j in joints] for i in joints])
        rows, columns = linear_sum_assignment(costs)
        moved = [(joints[r], joints[c]) for r, c in zip(rows, columns, strict=True) if r != c]
        if not moved:
            # the second best is wanted as a rival
            best = min(
                itertools.combinations(range(len(joints)), 2),
                key=lambda p: costs[p[0], p[1]] + costs[p[1], p[0]] - costs[p[0], p[0]] - costs[p[1], p[1]],
            )
            moved = [(joints[best[0]], joints[best[1]]), (joints[best[1]], joints[best[0]])]
        return Change("swapped", kind, tuple(i for i, _ in moved), tuple(j for _, j in moved))


# ------------------------------------------------------------------------------------------------ encoder pairs


def jackknifed(columns: Sequence[Array], y: Array) -> tuple[Array, Array]:
    """Coefficients of y on columns by least squares and their standard errors by a jackknife over `BLOCKS` blocks."""
    x = np.column_stack(columns)
    scale = np.sqrt(np.mean(x**2, axis=0))
    x = x / np.where(scale > 0.0, scale, 1.0)
    whole = np.linalg.lstsq(x, y, rcond=None)[0]
    gram, right = x.T @ x, x.T @ y
    blocks = np.array_split(np.arange(len(y)), BLOCKS)
    each = np.array([np.linalg.lstsq(gram - x[b].T @ x[b], right - x[b].T @ y[b], rcond=None)[0] for b in blocks])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
    back = np.where(scale > 0.0, scale, np.inf)
    return whole / back, spread / back


def pair(means: Means, joint: int, stiff: bool) -> Pair:
    """Skew, zero and apparent stiffness of a joint's two encoders.

    theta - q = s/k - (b/k)(thetad - qd) + skew * qd + zero, with s the torque that the spring carries. Where the joint
    is stiff, s is what accelerates the links, so that friction in the motor has no part in it; friction behind the
    spring that grows with the rate has, and looks like a skew. Where it is soft, the links' motion is no linear
    function of their accelerations, and s = n tau - Im n^2 thetadd.
    """
    m, ratio = means, float(means.arm.gear_ratios[joint])
    q, theta, torque = m.q[joint], m.theta[joint], ratio * m.tau[joint]
    difference, slip = theta[0] - q[0], theta[1] - q[1]
    loads = [other[2] for other in m.q]
    motor = [torque, theta[2], slip]
    rest = loads if stiff else motor + loads
    value, sigma = jackknifed([m.one, q[1], *rest], difference)
    carried = [torque, theta[2]] if stiff else motor
    zero, zero_sigma = jackknifed([m.one, q[1], *carried], difference)

    def stiffness(columns: list[Array]) -> float:
        per, error = jackknifed(columns, difference)
        return 1.0 / float(per[-1]) if per[-1] > 3.0 * error[-1] else math.nan

    return Pair(
        joint=means.arm.joints[joint].name,
        skew_s=float(value[1]),
        skew_sigma_s=float(sigma[1]),
        zero_rad=float(zero[0]),
        zero_sigma_rad=float(zero_sigma[0]),
        stiffness=stiffness([m.one, *carried[1:], torque]),
        stiffness_unskewed=stiffness([m.one, q[1], *carried[1:], torque]),
        stiff=stiff,
    )


# ------------------------------------------------------------------------------------------------ single signals


def runs_of_equal(readings: Array, ranges: Sequence[tuple[int, int]], at_least: int) -> list[tuple[int, int]]:
    """Half-open ranges of `at_least` or more equal readings."""
    out = []
    for start, stop in ranges:
        edges = np.flatnonzero(np.diff(readings[start:stop]) != 0.0) + 1 + start
        bounds = np.concatenate([[start], edges, [stop]])
        out += [(int(a), int(b)) for a, b in itertools.pairwise(bounds) if b - a >= at_least]
    return out


def grid_step(readings: Array, ranges: Sequence[tuple[int, int]], finest: float) -> float:
    """Step of the grid that readings lie on, within rounding to steps of `finest`; NaN where they lie on none that is
    at least four times coarser."""
    steps = np.abs(np.concatenate([np.diff(readings[a:b]) for a, b in ranges] or [np.zeros(0)]))
    steps = steps[steps > max(0.5 * finest, 1e-12)]
    if len(steps) < 20:
        return math.nan
    step = float(np.min(steps))
    if step < 4.0 * finest:
        return math.nan
    for reach in (1.5, 4.5, 20.5, 100.5, 1000.5):
        near = steps[steps < reach * step]
        times = np.rint(near / step)
        step = float(near @ times / (times @ times))
    off = np.abs(steps - step * np.rint(steps / step))
    on_grid = float(np.mean(off <= 1.01 * finest + 1e-6 * step))
    return step if on_grid > 0.99 else math.nan


def noise_level(readings: Array, ranges: Sequence[tuple[int, int]]) -> float:
    """Standard deviation of what changes from cycle to cycle without rhyme: median of the fourth differences."""
    fourth = [np.diff(readings[a:b], 4) for a, b in ranges if b - a > 8]
    if not fourth:
        return math.nan
    return 1.4826 * float(np.median(np.abs(np.concatenate(fourth)))) / math.sqrt(70.0)  # 1 + 16 + 36 + 16 + 1


# -------------------------------------------------------------------------------------------------- everything


class _Auditor:
    def __init__(self, arm: Arm, cycles: Cycles, traffic: Traffic, progress: Callable[[float], None]) -> None:
        self.arm, self.cycles, self.traffic, self.progress = arm, cycles, traffic, progress
        self.names = signal_names(arm)
        self.findings: list[Finding] = []
        self.notes: list[str] = []
        self.undecided: set[str] = set()
        self.laws: dict[str, float] = {}
        self.pairs: list[Pair] = []
        self._grid: dict[tuple[str, int], float] = {}

    @cached_property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        return segments(self.cycles).ranges

    @cached_property
    def zeros(self) -> dict[str, Array]:
        return {
            "q": np.array([j.link_encoder.zero_rad for j in self.arm.joints]),
            "theta": np.array([j.motor_encoder.zero_rad for j in self.arm.joints]),
        }

    def name(self, kind: str, index: int) -> str:
        return next((n for n, k, i in self.names if (k, i) == (kind, index)), f"{self.arm.joints[index].name} {kind}")

    def find(self, signal: str, fault: str, evidence: str, remedy: str) -> None:
        self.findings.append(Finding(signal, fault, evidence, remedy))

    def audit(self) -> Audit:
        self._traffic()
        broken = self._flat()
        self.progress(0.1)
        repaired = self.cycles
        means = Means(self.arm, self.cycles)
        if not means.count:
            self.notes.append(
                "no stretch without a gap is long enough to compare signals with each other "
                f"({4 * self.arm.smoother.points + 4} cycles)"
            )
            self.undecided |= {name for name, _, _ in self.names}
        else:
            use = [i for i in range(self.arm.n) if i not in broken and means.moves(i)]
            for i in range(self.arm.n):
                if i not in broken and not means.moves(i):
                    self.notes.append(f"{self.arm.joints[i].name}: does not move, so nothing is decided")
                    self.undecided |= {self.name(kind, i) for kind in ("q", "theta", "tau")}
            repaired, motors, clean = self._motors(use, means)
            self.progress(0.4)
            skewed = self._pairs(motors, clean)
            self.progress(0.5)
            if self.arm.free and broken:
                self._no_balance("signals that are stuck or saturated spoil it")
            else:
                self._balance(repaired, skewed)
        self._steps()
        self.progress(1.0)
        signals = tuple(self._signal(*entry) for entry in self.names)
        return Audit(signals, tuple(self.findings), tuple(self.pairs), self.laws, tuple(self.notes))

    # -- each signal by itself

    def _traffic(self) -> None:
        measured = self.traffic.period_s
        if math.isfinite(measured) and abs(measured / self.arm.period_s - 1.0) > 0.005:
            self.find(
                "SYNC",
                f"every {1e3 * measured:.4g} ms, not {1e3 * self.arm.period_s:.4g} ms",
                "FTIME against the count of SYNCs",
                f"period_s = {measured:.6g}",
            )
        for name, _, _ in self.names:
            share = self._share(name)
            if share < 1.0 - LOST:
                self.find(
                    name,
                    "missing" if share == 0.0 else f"loses {100 * (1 - share):.1f} %",
                    f"{100 * share:.1f} % of the cycles",
                    "compare the node numbers of the arm file with the bus"
                    if share == 0.0
                    else "repair the bus or the recording",
                )
            count = self.traffic.saturated.get(name, 0)
            if count:
                self.find(
                    name, "saturated", f"{count} frames at the end of the wire's range", "a sensor with a larger range"
                )

    def _share(self, name: str) -> float:
        if name in self.traffic.share:
            return self.traffic.share[name]
        if not self.ranges:
            return 0.0
        used = sum(b - a for a, b in self.ranges)
        first, last = int(self.cycles.sync[self.ranges[0][0]]), int(self.cycles.sync[self.ranges[-1][1] - 1])
        return used / max(last - first + 1, 1)

    def _flat(self) -> set[int]:
        """Name what is stuck or saturated; returns the joints that are spoilt by it (-1: the gyro)."""
        broken = set()
        for name, kind, i in self.names:
            if kind == "omega" and not self._used_axis(i):
                continue
            verdict = self._flat_one(kind, i)
            if verdict is not None:
                fault, evidence = verdict
                if not any(f.signal == name and f.fault == fault for f in self.findings):
                    remedy = "repair the sensor or its telemetry"
                    if fault == "saturated":
                        remedy = (
                            "a sensor with a larger range, or a slower motion; nothing if the drive itself stops there"
                        )
                    self.find(name, fault, evidence, remedy)
                broken.add(-1 if kind == "omega" else i)
        return broken

    def _flat_one(self, kind: str, i: int) -> tuple[str, str] | None:
        readings: Array = getattr(self.cycles, kind)[:, i]
        flat = runs_of_equal(readings, self.ranges, FLAT_TOP_CYCLES)
        if not flat:
            return None
        valid = np.concatenate([readings[a:b] for a, b in self.ranges])
        ends = (float(valid.min()), float(valid.max()))
        moving = [(a, b) for a, b in flat if self._partner_moves(kind, i, a, b)]
        if ends[0] < ends[1]:
            for end in ends:
                tops = [(a, b) for a, b in flat if readings[a] == end]
                # at a turning point an encoder keeps its code: there the partner must go on
                tops = tops if kind in ("tau", "omega") else [t for t in tops if t in moving]
                length = sum(b - a for a, b in tops)
                if len(tops) >= FLAT_TOPS and length > 0.002 * len(valid):
                    return "saturated", f"{length} cycles at {end:.6g}, in {len(tops)} stretches"
        stuck = [(a, b) for a, b in moving if b - a >= FLAT_CYCLES and not (kind == "tau" and readings[a] == 0.0)]
        if ends[0] == ends[1]:
            stuck = moving
        if stuck:
            a, b = max(stuck, key=lambda r: r[1] - r[0])
            fault = "saturated" if ends[0] < ends[1] and readings[a] in ends else "stuck"
            return fault, f"{b - a} cycles at {readings[a]:.6g} from cycle {int(self.cycles.sync[a])} on"
        return None

    def _partner_moves(self, kind: str, i: int, a: int, b: int) -> bool:
        """Whether what goes with a signal moves from a to b, far enough that the signal should."""
        joints = range(self.arm.n) if kind == "omega" else (i,)
        for j in joints:
            joint = self.arm.joints[j]
            partners = {"q": ("theta",), "theta": ("q",) if joint.flexible else (), "tau": ("theta",)}.get(
                kind, ("theta",)
            )
            for partner in partners:
                readings: Array = getattr(self.cycles, partner)[:, j]
                quanta = FLAT_QUANTA * (self._step("q", j) + self._step("theta", j))
                whole = max(float(np.ptp(readings[c:d])) for c, d in self.ranges)
                if float(np.ptp(readings[a:b])) > max(quanta, FLAT_SHARE * whole):
                    return True
        return False

    def _encoder(self, kind: str, i: int) -> Encoder:
        joint: Joint = self.arm.joints[i]
        return joint.link_encoder if kind == "q" else joint.motor_encoder

    def _step(self, kind: str, i: int) -> float:
        """The larger of an encoder's declared step and the one that is seen, rad."""
        seen = self._seen_step(kind, i)
        return max(self._encoder(kind, i).quantum_rad, seen if math.isfinite(seen) else 0.0)

    def _seen_step(self, kind: str, i: int) -> float:
        if (kind, i) not in self._grid:
            self._grid[kind, i] = grid_step(getattr(self.cycles, kind)[:, i], self.ranges, ANGLE_STEP)
        return self._grid[kind, i]

    def _steps(self) -> None:
        for name, kind, i in self.names:
            if kind not in ("q", "theta") or any(
                f.signal == name and f.fault.startswith("scaled") for f in self.findings
            ):
                continue
            encoder, readings = self._encoder(kind, i), getattr(self.cycles, kind)[:, i]
            step = self._seen_step(kind, i)
            quantum = encoder.quantum_rad
            if math.isfinite(step) and abs(step / max(quantum, ANGLE_STEP) - 1.0) > 0.02:
                self.find(
                    name,
                    f"moves in steps of 2π/{2 * math.pi / step:.0f}, not 2π/{2 * math.pi / quantum:.0f}",
                    f"{step:.4g} rad against {quantum:.4g} rad",
                    f"quantum_rad = {step:.6g}",
                )
                continue
            noise = noise_level(readings, self.ranges)
            declared = self._declared_noise(kind, i)
            if noise > NOISE_FACTOR * declared:
                self.find(
                    name,
                    f"noisier than declared by {noise / declared:.1f}",
                    f"{noise:.2g} rad against {declared:.2g} rad",
                    "repair the sensor, or state counts (quantum_rad) as they are",
                )

    def _declared_noise(self, kind: str, i: int) -> float:
        if kind == "tau":
            return self.arm.joints[i].torque_sigma
        if kind == "omega":
            step = COARSE_RATE_STEP if self.arm.imu.resolution == "coarse" else RATE_STEP
            return math.hypot(self.arm.imu.rate_sigma, step / math.sqrt(12.0))
        return math.hypot(self._encoder(kind, i).sigma_rad, ANGLE_STEP / math.sqrt(12.0))

    def _used_axis(self, axis: int) -> bool:
        """Whether the arm turns about that axis of the gyro."""
        if not self.arm.free:
            return False
        return self.arm.spatial or abs(float((self.arm.mount.T @ self.arm.axis)[axis])) > 1e-6

    # -- signals against each other

    def _motors(self, use: list[int], means: Means) -> tuple[Cycles, _Motors, list[int]]:
        """Name faults of angles and torques, one after the other, each undone before the next is looked for. Returns
        the run without them and the joints in which nothing was wrong."""
        cycles, touched = self.cycles, set()
        motors = _Motors(means, use)
        for _ in range(3 * len(use)):
            now = motors.total(NOTHING)
            ranked = sorted(((motors.total(c), k, c) for k, c in enumerate(motors.changes())), key=lambda r: r[:2])
            if not ranked or now - ranked[0][0] < math.log(SURE):
                break
            total, _, change = ranked[0]
            rivals = [
                r[2] for r in ranked[1:] if r[0] - total < math.log(SURE) and set(r[2].joints) & set(change.joints)
            ]
            if change.what == "scaled":
                # a motor's law has no scale of its own: the angle whose noise is off is the one
                alike = sorted(
                    (self._noise_off(c), k, c) for k, c in enumerate([change, *rivals]) if c.what == "scaled"
                )
                change = alike[0][2]
                rivals = [c for off, _, c in alike[1:] if off - alike[0][0] < math.log(NOISE_FACTOR)]
            self._name(change, math.exp(now - total), rivals[0] if rivals else None)
            touched |= set(change.joints)
            cycles = changed(cycles, change, self.zeros)
            means = Means(self.arm, cycles)
            motors = _Motors(means, use)
        for i in use:
            joint = self.arm.joints[i]
            if i in touched:
                continue
            here = motors.score(i, NOTHING)
            turned = motors.score(i, Change("inverted", "tau", (i,), (i,), -1.0))
            if turned - here < math.log(SURE) or math.exp(here) > EXPLAINED:
                self.undecided.add(self.name("tau", i))
                self.notes.append(
                    f"{joint.name}: the sign of the torque is not decided "
                    f"(turned round it explains {math.exp(here - turned):.2f} times as well)"
                )
            if joint.flexible and motors.stiff[i]:
                self.notes.append(f"{joint.name}: too stiff to tell whether motor and link encoder are exchanged")
        return cycles, motors, [i for i in use if i not in touched]

    def _noise_off(self, change: Change) -> float:
        """How far the noise of an angle, with its scale put right, is from the declared: logarithm of the ratio."""
        i = change.joints[0]
        noise = change.factor * noise_level(getattr(self.cycles, change.kind)[:, i], self.ranges)
        return abs(math.log(max(noise, 1e-300) / self._declared_noise(change.kind, i)))

    def _name(self, change: Change, ratio: float, rival: Change | None) -> None:
        evidence = f"explains the run {ratio:.3g} times better"
        if rival is not None:
            evidence += f"; {self._called(rival)} would do as well"
        if change.what == "exchanged":
            i = change.joints[0]
            for kind, other in (("q", "theta"), ("theta", "q")):
                self.find(
                    self.name(kind, i),
                    f"swapped with {self.name(other, i)}",
                    evidence,
                    "exchange link and motor encoder where the log is written",
                )
        elif change.what == "swapped":
            for i, j in zip(change.joints, change.source, strict=True):
                self.find(
                    self.name(change.kind, i),
                    f"swapped with {self.name(change.kind, j)}",
                    evidence,
                    "exchange the names (or nodes) of the two where the log is written",
                )
        elif change.what == "inverted":
            remedy = "turn its sign where the log is written"
            if change.kind != "tau":
                encoder = self._encoder(change.kind, change.joints[0])
                remedy = f"sign = {-encoder.sign} of the {'link' if change.kind == 'q' else 'motor'}_encoder"
            self.find(self.name(change.kind, change.joints[0]), "inverted", evidence, remedy)
        else:
            self.find(
                self.name(change.kind, change.joints[0]),
                f"scaled by {1.0 / change.factor:.4g}",
                evidence,
                "angles are after the gear: divide by the gear ratio once, where the log is written",
            )

    def _called(self, change: Change) -> str:
        who = " and ".join(self.name(change.kind or "theta", i) for i in change.joints)
        return f"{who} {change.what}"

    def _pairs(self, motors: _Motors, clean: list[int]) -> dict[int, float]:
        """Audit the encoder pairs; returns the skews that were named, s."""
        named: dict[int, float] = {}
        for i in clean:
            joint = self.arm.joints[i]
            if not joint.flexible:
                continue
            found = pair(motors.means, i, motors.stiff[i])
            self.pairs.append(found)
            if abs(found.skew_s) > max(SKEW_SIGMAS * found.skew_sigma_s, SKEW_SHARE * self.arm.period_s):
                named[i] = found.skew_s
                self._name_skew(joint, found)
            first, second = joint.link_encoder, joint.motor_encoder
            allowed = 3.0 * math.hypot(first.zero_sigma_rad, second.zero_sigma_rad)
            allowed += first.quantum_rad + second.quantum_rad + ZERO_SIGMAS * found.zero_sigma_rad
            if abs(found.zero_rad) > allowed:
                self.find(
                    self.name("q", i),
                    f"zero off by {1e3 * -found.zero_rad:.3g} mrad ± {1e3 * found.zero_sigma_rad:.1g}",
                    f"{abs(found.zero_rad) / max(found.zero_sigma_rad, 1e-300):.1f} standard errors",
                    f"zero_rad = {first.zero_rad - first.sign * found.zero_rad:.6g} of the link_encoder, or as much "
                    "the other way of the motor_encoder; a bias of the torque looks alike",
                )
        return named

    def _name_skew(self, joint: Joint, found: Pair) -> None:
        newer, older = ("motor", "link") if found.skew_s > 0 else ("link", "motor")
        encoder = joint.motor_encoder if newer == "motor" else joint.link_encoder
        latch = encoder.latch_us + 1e6 * abs(found.skew_s)
        self.find(
            f"{joint.name} {newer} angle",
            f"skewed {1e3 * abs(found.skew_s):.3g} ms ± {1e3 * found.skew_sigma_s:.1g}",
            f"newer than the {older} angle, {abs(found.skew_s) / found.skew_sigma_s:.0f} standard errors",
            f"latch_us = {latch:.0f} of the {newer}_encoder; if it is the {older} angle that comes from the past, "
            "torque and gyro are newer as well",
        )

    # -- the whole arm

    def _no_balance(self, why: str) -> None:
        self.notes.append(f"torque law and gyro are not decided: {why}")
        self.undecided |= {name for name, kind, i in self.names if kind == "omega" and self._used_axis(i)}

    def _residual(self, arm: Arm, cycles: Cycles) -> float:
        """rms residual of the energy balance in J. Errors: ZygosError where the C library has no columns."""
        flight = Flight(arm)
        flight.cycles(cycles)
        return float(flight.estimate().residual)

    def _balance(self, cycles: Cycles, skewed: dict[int, float]) -> None:
        part = Cycles(*(getattr(cycles, name)[:MOST_CYCLES] for name in Cycles.__dataclass_fields__))
        arm = unskewed(self.arm, skewed)
        try:
            now = self._residual(arm, part)
        except ZygosError as error:
            self._no_balance(str(error).split("; remedy")[0])
            return
        if not (math.isfinite(now) and now > 0.0):
            self._no_balance("the run is too short for a balance of the whole arm")
            return
        named = self._whole(arm, part, now) if self.arm.free else False
        if not named:
            self._torque_law(arm, part, bool(skewed))

    def _whole(self, arm: Arm, cycles: Cycles, now: float) -> bool:
        """Gyro, and joints as a whole; returns whether something was named."""
        trials: list[tuple[float, int, str, Any]] = []
        identity = np.eye(3)
        turns = [
            np.diag(signs) @ identity[list(order)]
            for order in itertools.permutations(range(3))
            for signs in itertools.product((1.0, -1.0), repeat=3)
        ]
        axis = None if arm.spatial else arm.mount.T @ arm.axis
        seen: list[Array] = []
        # changes that differ in what the arm does not feel are one; the simplest comes first
        for turn in sorted(turns, key=lambda t: float(np.abs(t - identity).sum())):
            felt = turn if axis is None else turn.T @ axis
            if any(np.allclose(felt, other) for other in seen):
                continue
            seen.append(felt)
            if len(seen) > 1:
                trials.append(
                    (self._residual(arm, replace(cycles, omega=cycles.omega @ turn.T)), len(trials), "gyro", turn)
                )
        for i in range(arm.n):
            trials.append((self._residual(arm, self._joint_turned(cycles, i)), len(trials), "inverted", (i,)))
        for a, b in itertools.combinations(range(arm.n), 2):
            order = list(range(arm.n))
            order[a], order[b] = b, a
            moved = replace(cycles, q=cycles.q[:, order], theta=cycles.theta[:, order], tau=cycles.tau[:, order])
            trials.append((self._residual(arm, moved), len(trials), "swapped", (a, b)))
        trials = [t for t in trials if math.isfinite(t[0]) and t[0] > 0.0]
        best = min(trials, key=lambda t: t[:2], default=None)
        if best is None:
            self._no_balance("the run is too short for a balance of the whole arm")
            return False
        residual, _, what, detail = best
        if now / residual >= SURE:
            self._name_whole(what, detail, f"the energy balance closes {now / residual:.3g} times better")
            return True
        against = min((t[0] for t in trials if t[2] == "gyro"), default=math.inf)
        if against / now < SURE:
            self.undecided |= {name for name, kind, i in self.names if kind == "omega" and self._used_axis(i)}
            self.notes.append(
                f"gyro: signs and axes are not decided (changed, the energy balance closes {now / against:.2f} times "
                "as well)"
            )
        return False

    def _joint_turned(self, cycles: Cycles, i: int) -> Cycles:
        for kind in ("q", "theta", "tau"):
            cycles = changed(cycles, Change("inverted", kind, (i,), (i,), -1.0), self.zeros)
        return cycles

    def _name_whole(self, what: str, detail: Any, evidence: str) -> None:
        if what == "gyro":
            for i in range(3):
                source = int(np.argmax(np.abs(detail[i])))
                sign = detail[i, source]
                if source == i and sign > 0:
                    continue
                if not (self._used_axis(i) or self._used_axis(source)):
                    continue
                fault = "inverted" if source == i else f"swapped with gyro {'xyz'[source]}"
                fault += " and inverted" if source != i and sign < 0 else ""
                self.find(
                    f"gyro {'xyz'[i]}",
                    fault,
                    evidence,
                    "mount_xyzw of the arm file, or the signs where the log is written",
                )
            return
        kinds = [
            (kind, i) for i in detail for kind in ("q", "theta", "tau") if kind != "q" or self.arm.joints[i].flexible
        ]
        for kind, i in kinds:
            other = self.arm.joints[detail[1 - detail.index(i)]].name if what == "swapped" else ""
            self.find(
                self.name(kind, i),
                f"swapped with {other}'s, as all signals of the joint"
                if other
                else "inverted, as all signals of the joint",
                evidence,
                "exchange the nodes of the two joints" if other else "turn axis of the joint round",
            )

    def _torque_law(self, arm: Arm, cycles: Cycles, skewed: bool) -> None:
        laws: tuple[TorqueLaw, ...] = ("applied_from_sync", "applied_previous_cycle", "sampled")
        self.laws = {law: self._residual(replace(arm, torque_law=law), cycles) for law in laws}
        ordered = sorted(laws, key=lambda law: self.laws[law])
        declared, best = self.laws[arm.torque_law], self.laws[ordered[0]]
        second = self.laws[ordered[1]]
        if skewed:
            self.notes.append("torque_law: decided only when the encoders are no longer skewed")
        elif second / best < SURE_LAW:
            self.notes.append(
                f"torque_law: not decided ({ordered[1]} closes the energy balance {best / second:.2f} times as well as "
                f"{ordered[0]})"
            )
        elif ordered[0] != arm.torque_law:
            self.find(
                "torques",
                f"not {arm.torque_law}",
                f"the energy balance closes {declared / best:.3g} times better",
                f'torque_law = "{ordered[0]}", unless the drives are late by as much',
            )

    # -- the table

    def _signal(self, name: str, kind: str, i: int) -> Signal:
        readings: Array = getattr(self.cycles, kind)[:, i]
        valid = np.concatenate([readings[a:b] for a, b in self.ranges] or [np.full(1, math.nan)])
        angle = kind in ("q", "theta")
        faults = [f.fault for f in self.findings if f.signal == name]
        decided = name not in self.undecided or bool(faults)
        return Signal(
            name=name,
            unit={"tau": "Nm", "omega": "rad/s"}.get(kind, "rad"),
            share=self._share(name),
            low=float(valid.min()),
            high=float(valid.max()),
            step=self._seen_step(kind, i) if angle else math.nan,
            quantum=self._encoder(kind, i).quantum_rad if angle else math.nan,
            noise=noise_level(readings, self.ranges),
            declared=self._declared_noise(kind, i),
            decided=decided,
            verdict="; ".join(faults) or ("ok" if decided else "not decidable"),
        )


def unskewed(arm: Arm, skews: dict[int, float]) -> Arm:
    """The arm with later latches for the encoders that are newer: skews in s by joint, as `Pair.skew_s`."""
    joints = list(arm.joints)
    for i, skew in skews.items():
        side = "motor_encoder" if skew > 0.0 else "link_encoder"
        encoder: Encoder = getattr(joints[i], side)
        late = replace(encoder, latch_us=encoder.latch_us + round(1e6 * abs(skew)))
        joints[i] = replace(joints[i], motor_encoder=late) if skew > 0.0 else replace(joints[i], link_encoder=late)
    return replace(arm, joints=tuple(joints))
