# SPDX-License-Identifier: MIT
"""The balances of a gap: what every parameter and every effect of the catalogue adds to each, for batches of arcs.

Energy E of the whole arm: work of the motors = change of kinetic and potential energy + losses. Motor impulse M_i,
local to a flexible joint i: int tau = Im (n thetad + f_(i-1)) + 1/n int spring + int friction. Momentum L_j of the
link angle
of a rigid joint j, over short increments. Angular momentum H of a floating arm about its mass centre: one component
in a plane, where the base's attitude drops out, and Hx, Hy, Hz in space, in the axes that the base had at the arc's
origin. A balance is

    columns . coefficients = right side + constant of the arc

The columns are those of `zygos.balances`, without accelerations (docs/gap-method.md; the paper's eqs. (11), (37)). H
has no constant where a model assumes an angular momentum: then its value is a column of its own. An increment has no
constant. The columns of errors of the sensors are differences of the balances of readings with and without them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos import limits
from zygos.arm import JOINT_ROW_S, Arm
from zygos.balances import energy, joint, momentum
from zygos.balances.effects import (
    BaseSignals,
    Signals,
    energy_column,
    impulse_column,
    joint_column,
    momentum_column,
    motor_impulse,
)
from zygos.balances.field import Pull, pull
from zygos.balances.kinematics import Posture, body_columns, posture
from zygos.balances.quadrature import FromOrigin, from_first, integral, step_integrals
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.joints import by_name
from zygos.effects import CATALOGUE, OFFSET, Effect, Kind, column_name, columns_at
from zygos.gap.parts import acted_on
from zygos.gap.record import MeasuredRun, smoothed_states
from zygos.model import gram

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SEEN = ("q", "theta", "omega0")
"""Fields of `Readings` that an entry of the catalogue at a sensor changes."""
NONE: Mapping[str, float] = MappingProxyType({})
_ACTING = ("motor", "link", "spring", "torque", "load")
"""Places of effects that act at a joint."""


Lost = dict[str, list[Array]]
"""By column of an error of a sensor, and balance (..., A, m): what 1 unit of it would take away."""


@dataclass(frozen=True)
class SensorError:
    """An error that a run's sensor may have: a constant one, or of its gain."""

    sigma: float
    """How well the arm file knows it: rad, rad/s, Nm, or a share."""
    signals: tuple[str, ...]
    """Fields of `Readings` that have it."""
    direction: Array
    """Which of the components of a signal."""
    gain: bool = False
    """Whether the error is this share of the signal."""

    def added(self, readings: Readings, size: float) -> Readings:
        """Readings with so much more of this error."""
        old = {name: getattr(readings, name) for name in self.signals}
        new = {name: x + size * self.direction * (x if self.gain else 1.0) for name, x in old.items()}
        return replace(readings, **new)


class Acting(NamedTuple):
    """An entry of the catalogue where it may act, with a shape of its law."""

    kind: Kind
    joint: int
    """From 0; -1 for the base or the gyro."""
    component: str = ""
    shape: float | None = None

    @property
    def plain(self) -> str:
        """Name of its column, without the shape."""
        return column_name(self.kind, self.joint, self.component)

    @property
    def name(self) -> str:
        """Name of its column, with @ and the shape of a law that has one."""
        return self.plain if self.shape is None else f"{self.plain}@{self.shape:.6g}"

    def effect(self, arm: Arm, value: float, sigma: float = 0.0, source: str = "zygos") -> Effect:
        """As an effect of a model."""
        joint = None if self.joint < 0 else arm.joints[self.joint].name
        return Effect(self.kind, joint, value, sigma, source, shape=self.shape, component=self.component)


def _coarse(kind: Kind) -> tuple[float | None, ...]:
    """The shapes that a search begins with: orders are whole numbers, what lies between others is found later."""
    if not kind.shapes:
        return (None,)
    whole = all(x % 1.0 == 0.0 for x in kind.shapes)
    if whole or len(kind.shapes) < limits.MANY_SHAPES.value:
        return kind.shapes
    return kind.shapes[1 :: 2 if len(kind.shapes) < 2 * limits.MANY_SHAPES.value else 3]


def acting(effect: Effect, arm: Arm) -> Acting:
    """Where an effect of a model acts. Errors: as `Effect.index`."""
    return Acting(effect.kind, effect.index(arm), effect.component, effect.shape)


@dataclass(frozen=True)
class Layout:
    """Names of all balances and columns of an arm."""

    arm: Arm
    wide: bool = False
    """Whether it also has the entries of the catalogue that are searched last."""
    shapes: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """Shapes that replace those of the catalogue, by the name of the column without its shape."""
    own: tuple[Acting, ...] = ()
    """Entries that it has in any case: those of the simulation."""
    loose: tuple[str, ...] = ()
    """Errors of sensors of which the arm file is not believed to know anything."""

    @cached_property
    def balances(self) -> tuple[str, ...]:
        """E, M of every flexible joint, L of the joints of `links`, H or Hx, Hy, Hz of a base that floats."""
        joints = [f"M{i + 1}" for i, one in enumerate(self.arm.joints) if one.flexible]
        return ("E", *joints, *(f"L{i + 1}" for i in self.links), *self.momenta)

    @cached_property
    def links(self) -> tuple[int, ...]:
        """Joints with a balance of the momentum of their link angle: rigid ones, and on a fixed base, which has no
        momentum of its own, every joint: the energy alone tells few inertias apart there."""
        return tuple(i for i, one in enumerate(self.arm.joints) if not (one.flexible and self.arm.free))

    @cached_property
    def momenta(self) -> tuple[str, ...]:
        """The balances of the angular momentum."""
        return () if not self.arm.free else ("Hx", "Hy", "Hz") if self.arm.spatial else ("H",)

    @cached_property
    def effects(self) -> tuple[Acting, ...]:
        """Entries of the catalogue in the order of their columns, as far as the arm can have them; those of sensors
        last.

        The offset of a spring is none of them: the zeros of its encoders stand for it. Nor are the errors that each run
        has for itself.
        """
        listed = [*self.own]
        shapes = dict(self.shapes)
        for kind in CATALOGUE.values():
            if kind.key == OFFSET or not (kind.searched or (self.wide and kind.searched_last)):
                continue
            for column in columns_at(self.arm, kind):
                one = Acting(kind, column.joint, column.component)
                if one.plain in self._covered or (kind.gain and column.joint == 0):
                    continue
                listed += [one._replace(shape=shape) for shape in shapes.get(one.plain, _coarse(kind))]
        by_name = {one.name: one for one in listed}
        return tuple(sorted(by_name.values(), key=lambda one: one.kind.place == "sensor"))

    def covers(self, one: Acting) -> bool:
        """Whether an error of the sensors that each run has for itself stands for an entry."""
        return one.plain in self._covered

    @cached_property
    def _covered(self) -> frozenset[str]:
        """Columns of effects for which the errors of the sensors of each run stand."""
        covered = {name.replace("torque_zero", "torque_offset") for name in self.errors}
        covered |= {name.replace("torque_scale", "torque_gain") for name in self.errors}
        return frozenset(covered)

    def find(self, name: str) -> Acting:
        """The entry of a column. Errors: KeyError where there is none."""
        return self._entries[name]

    @cached_property
    def _entries(self) -> dict[str, Acting]:
        return {one.name: one for one in self.effects}

    @cached_property
    def sensors(self) -> tuple[Acting, ...]:
        """The entries at sensors."""
        return tuple(one for one in self.effects if one.kind.place == "sensor")

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Base parameters, effects, errors of the sensors.

        rotor_coupling_i is what the coupling adds to the column of Im_i where it exceeds that of nature.
        """
        return (*self.arm.parameter_names, *(one.name for one in self.effects), *self.zeros)

    @cached_property
    def index(self) -> dict[str, int]:
        """Position of each column."""
        return {name: k for k, name in enumerate(self.columns)}

    @cached_property
    def zeros(self) -> tuple[str, ...]:
        """Columns of the sensors' errors, which each run has for itself: the encoders' zeros, rad, known to a quantum
        at best, which is enough to look like an effect; the gyro's bias, rad/s, which looks like an angular momentum;
        of torques that are not perfect a constant offset, Nm, and the gain of each against the first."""
        return tuple(self.errors)

    @cached_property
    def zero_sigma(self) -> Array:
        """(zeros,) how well the arm file knows them, in the order of `zeros`."""
        return np.array([limits.LOOSE.value if name in self.loose else one.sigma for name, one in self.errors.items()])

    @cached_property
    def of_torque(self) -> NDArray[np.bool_]:
        """(zeros,) which of them are errors of torque sensors."""
        return np.array([one.signals == ("tau",) for one in self.errors.values()])

    @cached_property
    def declared_sigma(self) -> Array:
        """(zeros,) what the arm file says of them, whether that is believed or not."""
        return np.array([one.sigma for one in self.errors.values()])

    @cached_property
    def errors(self) -> dict[str, SensorError]:
        """The errors of sensors that each run has for itself, by column."""
        arm = self.arm
        unit = np.eye(arm.n)
        # a gain that is an effect is the same in all runs
        gained = {one.joint for one in self.own if one.kind.gain}
        out: dict[str, SensorError] = {}
        for i, one in enumerate(arm.joints):
            link, motor = (e.zero_uncertainty_rad for e in (one.link_encoder, one.motor_encoder))
            if one.flexible:
                out[f"link_zero{i + 1}"] = SensorError(link, ("q",), unit[i])
            out[f"motor_zero{i + 1}"] = SensorError(motor, ("theta",) if one.flexible else ("q", "theta"), unit[i])
        if arm.free:
            sigma = arm.over_the_wire.imu.rate_sigma
            if arm.spatial:
                out |= {
                    f"gyro_bias{a}": SensorError(sigma, ("omega0",), e) for a, e in zip("xyz", np.eye(3), strict=True)
                }
            else:
                out["gyro_bias"] = SensorError(sigma, ("omega0",), np.array(1.0))
        for i, one in enumerate(arm.joints):
            if one.torque_sigma > 0.0:
                out[f"torque_zero{i + 1}"] = SensorError(limits.OFFSET_NM.value, ("tau",), unit[i])
                if i > 0 and i not in gained:
                    # all gains, masses and frictions can grow together: one gain is taken as known
                    out[f"torque_scale{i + 1}"] = SensorError(limits.GAIN.value, ("tau",), unit[i], gain=True)
        return out

    @cached_property
    def used(self) -> tuple[Indices, ...]:
        """By balance, the columns that it has."""
        return tuple(np.array([self.index[name] for name in self._used(balance)]) for balance in self.balances)

    def _used(self, balance: str) -> Iterator[str]:
        arm = self.arm
        own = int(balance[1:]) - 1 if balance[0] in "ML" else -1
        if balance[0] == "M":
            yield from (f"Im{own + 1}", f"k{own + 1}", f"b{own + 1}")
        elif balance[0] == "H":
            yield from (one.name for one in arm.parameters if one.joint is None or one.symbol == "Im")
        else:
            yield from arm.parameter_names
        yield from (one.name for one in self.effects if self._acts(one, balance, own))
        yield from self.zeros

    def _acts(self, one: Acting, balance: str, own: int) -> bool:
        """Whether an entry has a column in a balance; own: joint of the balance."""
        place = one.kind.place
        if place in _ACTING:
            return balance == "E" or (one.joint == own and _acts(self.arm, one.kind, own, balance))
        if place == "rotor":
            return balance[0] != "M" or one.joint == own
        if place == "base":
            return balance[0] == "H" or (balance == "E" and one.kind.law is not None)
        if place == "field":
            # a rotor looks alike from every side
            return balance[0] != "M"
        return place == "sensor"


def corrected(record: MeasuredRun, layout: Layout, errors: Array) -> MeasuredRun:
    """A record without errors (zeros,) of its sensors, in the order of `Layout.zeros`."""
    s = record.samples
    seen = Readings(s.q, s.theta, record.omega0, s.tau)
    fields = ("q", "theta", "omega0", "tau")
    plain = {name: getattr(seen, name) for name in fields}
    for size, error in zip(errors.tolist(), layout.errors.values(), strict=True):
        # a gain is a share of what was read
        wrong = error.added(seen, size)
        plain = {name: plain[name] - getattr(wrong, name) + getattr(seen, name) for name in fields}
    samples = replace(s, q=plain["q"], theta=plain["theta"], tau=plain["tau"])
    return replace(record, samples=samples, omega0=plain["omega0"])


def thinning(arm: Arm) -> int:
    """Rows of a sum stand at every so many instants: smoothed readings next to each other share nearly all their
    noise."""
    return max(1, arm.smoother.points // limits.ROWS_OF_A_WINDOW.value)


def _acts(arm: Arm, kind: Kind, i: int, balance: str) -> bool:
    """Whether an effect at a joint has a column in the balance of this joint's motor or link angle."""
    if balance[0] == "M":
        return kind.place != "link"
    return kind.place in ("link", "spring") or not arm.joints[i].flexible


@dataclass(frozen=True)
class Rows:
    """Rows of one balance."""

    left: Array
    """(..., A, m, columns), those of `Layout.used`."""
    right: Array
    """(..., A, m)"""
    end: Indices
    """(m,) instant of each row; of an increment its last one."""
    begin: Indices | None = None
    """(m,) first instant of each increment."""


@dataclass(frozen=True)
class BalanceRows:
    """All balances, in the order of `Layout.balances`."""

    layout: Layout
    balances: tuple[Rows, ...]


def balance_rows(
    layout: Layout,
    readings: Readings,
    values: Array | None = None,
    *,
    zeros: tuple[Array, ...] | None = None,
    every: int = 1,
    sizes: Mapping[str, float] = NONE,
) -> BalanceRows:
    """Balances of arcs of readings, in the units of energy (J), impulse before the gear (Nms) and momentum (Nms).

    values: base parameters (p,), about right: what an error of a sensor does to the balances, and the torque through a
    gear, depend on them. zeros: the columns of these errors, by balance, as `zero_columns` has them; sizes: as there.
    every: rows stand at every so many instants. One of values and zeros may be left out: values where no effect depends
    on the load.
    """
    arm = layout.arm
    if zeros is None:
        assert values is not None
        zeros = zero_columns(layout, readings, values, every, sizes=sizes)
    moving = _Moving.of(arm, readings, every, values=values)
    bodies = [*_bodies(layout, moving)]
    out = []
    for k, (name, own, right) in enumerate(zip(layout.balances, bodies, _right(layout, moving), strict=True)):
        columns = np.empty((*right.shape, len(layout.used[k])))
        count = own.shape[-1]
        columns[..., :count] = own
        for at, effect in enumerate(_effects(layout, moving, name), start=count):
            columns[..., at] = effect
        columns[..., columns.shape[-1] - zeros[k].shape[-1] :] = zeros[k]
        out.append(Rows(columns, right, *moving.places(name)))
    return BalanceRows(layout, tuple(out))


def zero_columns(
    layout: Layout,
    readings: Readings,
    values: Array,
    every: int = 1,
    known: Lost | None = None,
    *,
    sizes: Mapping[str, float] = NONE,
) -> tuple[Array, ...]:
    """By balance (..., A, m, ·): what errors of the sensors of 1 unit would take away, to first order: the entries of
    the catalogue at sensors, then the errors that each run has for itself.

    sizes: of entries at sensors as far as they are known, by name: the column of such an error is what an error of this
    size has taken away, per unit, because a large one is not in proportion to a small one. known: columns of layouts of
    the same arm, for the same readings, values and sizes, that need not be computed again; those that are missing are
    added.
    """
    value = np.where(np.isfinite(values), values, 0.0)
    names = layout.arm.parameter_names
    own_values = [value[[names.index(layout.columns[c]) for c in used if c < len(names)]] for used in layout.used]
    columns = {} if known is None else known

    def left_over(moving: _Moving) -> list[Array]:
        rows = zip(_bodies(layout, moving), own_values, _right(layout, moving), strict=True)
        return [own @ x - right for own, x, right in rows]

    still = _Moving.of(layout.arm, readings, every)
    without: list[Array] = []

    def lost(wrong: Readings) -> list[Array]:
        without[:] = without or left_over(still)
        # what errors of this size do in the second order is 1e-5 of it at the most
        with_it = left_over(_Moving.of(layout.arm, wrong, every))
        return [(a - b) / limits.SHIFT.value for a, b in zip(without, with_it, strict=True)]

    def taken(error: SensorError) -> list[Array]:
        if error.signals == ("tau",):
            # the right sides are linear in the torques, and nothing else depends on them
            wrong = _Moving.of(layout.arm, error.added(readings, 1.0), every, still.state)
            return [b - a for a, b in zip(_right(layout, still), _right(layout, wrong), strict=True)]
        return lost(error.added(readings, limits.SHIFT.value))

    def misread(one: Acting) -> list[Array]:
        number, size = one.kind.components(layout.arm).index(one.component), sizes.get(one.name, 0.0)
        if abs(size) <= limits.SHIFT.value:
            return lost(one.kind.transform(layout.arm, readings, one.joint, limits.SHIFT.value, number))
        plain = readings
        for _ in range(limits.INVERTED.value):
            again = one.kind.transform(layout.arm, plain, one.joint, size, number)
            parts = {name: getattr(plain, name) + getattr(readings, name) - getattr(again, name) for name in _SEEN}
            plain = replace(plain, **parts)
        without[:] = without or left_over(still)
        return [(b - a) / size for a, b in zip(without, left_over(_Moving.of(layout.arm, plain, every)), strict=True)]

    for one in layout.sensors:
        if one.name not in columns:
            columns[one.name] = misread(one)
    for name, error in layout.errors.items():
        if name not in columns:
            columns[name] = taken(error)
    each = [columns[name] for name in (*(one.name for one in layout.sensors), *layout.zeros)]
    return tuple(np.stack(parts, axis=-1) for parts in zip(*each, strict=True))


def law_along(layout: Layout, one: Acting, readings: Readings, values: Array) -> tuple[Array, Array]:
    """(..., A, instants) torque of a law per unit of its coefficient along arcs of readings, and the size of what it
    acts on (`acted_on`). values: as of `balance_rows`."""
    assert one.kind.law is not None
    moving = _Moving.of(layout.arm, readings, 1, values=values)
    shape = one.kind.shape if one.shape is None else one.shape
    if one.joint < 0:
        motion = moving.base.motion(one.kind, shape, one.kind.components(layout.arm).index(one.component))
    else:
        motion = moving.signals[one.joint].motion(one.kind, shape)
    size = acted_on(one.kind, motion)
    return np.broadcast_to(one.kind.law(motion, shape), size.shape), size


@dataclass(frozen=True)
class _Moving:
    """Arcs of readings, as the balances need them."""

    arm: Arm
    state: State
    """At every instant."""
    before: Array
    after: Array
    """(..., A, instants, N) torques before and from each instant on, Nm."""
    every: int
    time: Array
    """(A, instants) s."""
    turned: Array
    """(A, instants) rad."""
    values: Array | None = None
    """(p,) base parameters."""
    nadir: Array | None = None
    """(A, instants, 3) unit vector to the Earth, base axes."""

    @classmethod
    def of(
        cls, arm: Arm, readings: Readings, every: int, state: State | None = None, values: Array | None = None
    ) -> _Moving:
        half = arm.smoother.points // 2
        cycles = readings.tau.shape[-2]
        after = readings.tau[..., half : cycles - half, :]
        before = readings.tau[..., half - 1 : cycles - half - 1, :]
        clocks = (np.full(after.shape[-3:-1], np.nan) if x is None else x for x in (readings.time, readings.turned))
        time, turned = (x[:, half : cycles - half] if x.shape[-1] == cycles else x for x in clocks)
        nadir = None if readings.nadir is None else readings.nadir[:, half : cycles - half]
        smoothed = smoothed_states(arm, readings) if state is None else state
        return cls(arm, smoothed, before, after, every, time, turned, values, nadir)

    @cached_property
    def thin(self) -> State:
        """At the instants of the rows."""
        s, step = self.state, slice(None, None, self.every)
        base = s.base[..., step, :] if s.base.ndim == s.q.ndim else s.base[..., step]
        return State(s.q[..., step, :], s.theta[..., step, :], s.qd[..., step, :], s.thetad[..., step, :], base)

    @cached_property
    def postures(self) -> Posture | None:
        """At the instants of the rows; None of an arm in a plane without gravity, where nothing needs it."""
        needed = self.arm.spatial or any(self.arm.feels_gravity)
        return posture(self.arm, self.thin.q) if needed else None

    @cached_property
    def carried(self) -> Array:
        """(..., A, m, N) rates of the carrying bodies about the axes at the instants of the rows."""
        return self.bodies[1]

    @cached_property
    def bodies(self) -> tuple[Array, Array]:
        """Columns of bodies in the energy, and `carried`."""
        return body_columns(self.arm, self.thin, self.postures)

    @cached_property
    def momentum(self) -> Array:
        """Columns (..., A, m, r, K + N) as `momentum.momentum_columns`, at the instants of the rows; in space in the
        axes of the arc's origin."""
        attitude = self.attitude if self.arm.spatial else None
        return momentum.momentum_columns(self.arm, self.thin, self.postures, attitude)

    @cached_property
    def spin(self) -> Array:
        """(..., A, m, r, N) momentum of unit rotors, in space in the axes of the arc's origin."""
        return np.asarray(self.momentum[..., self.momentum.shape[-1] - self.arm.n :], dtype=np.float64)

    def thinned(self, x: Array) -> Array:
        """(..., A, m) of (..., A, instants)."""
        return x[..., :: self.every]

    @cached_property
    def instants(self) -> int:
        """Instants of an arc."""
        return int(self.after.shape[-2])

    def places(self, balance: str) -> tuple[Indices, Indices | None]:
        """Instants at which the rows of a balance end, and begin."""
        if balance[0] != "L":
            return np.arange(0, self.instants, self.every), None
        wanted = (self.arm.joint_row_s or JOINT_ROW_S) / (2.0 * self.arm.period_s * self.every)
        half = max(1, round(wanted)) * self.every
        begin = np.arange(0, self.instants - 2 * half, half)
        return begin + 2 * half, begin

    @cached_property
    def signals(self) -> list[Signals]:
        """Of each joint."""
        totals = FromOrigin(self.arm.period_s)
        return [
            Signals.of(self.arm, self.state, self.before, self.after, i, totals, time=self.time, load=self.load)
            for i in range(self.arm.n)
        ]

    @cached_property
    def load(self) -> Array:
        """(..., A, instants, N) torques through the gears, after them, Nm: of the springs, of which other effects are a
        trifle, and of the motors of rigid joints. NaN without values."""
        if self.values is None:
            return np.full(self.after.shape, np.nan)
        arm, s, value = self.arm, self.state, by_name(self.arm, self.values)
        load = arm.gear_ratios * self.after
        for i, one in enumerate(arm.joints):
            if one.flexible:
                spring, damper = value[f"k{i + 1}"], value[f"b{i + 1}"]
                load[..., i] = spring * (s.theta - s.q)[..., i] + damper * (s.thetad - s.qd)[..., i]
        return np.asarray(load, dtype=np.float64)

    @cached_property
    def base(self) -> BaseSignals:
        """Of the base."""
        turned = self.turning if self.arm.spatial else None
        return BaseSignals(self.state.base, FromOrigin(self.arm.period_s), self.time, self.turned, turned)

    @cached_property
    def pull(self) -> Pull:
        """What a gravity gradient does, at every instant; NaN without values."""
        arm, q = self.arm, self.state.q
        places, size = posture(arm, q), gram.directions(arm)
        matrix = np.full((size, size), np.nan)
        if self.values is not None:
            kinetic = [by_name(arm, self.values)[name] for name in arm.full_body_names]
            matrix = gram.from_parameters(arm, np.array(kinetic))
        assert self.nadir is not None
        return pull(places, matrix, np.broadcast_to(self.nadir, (*q.shape[:-1], 3)))

    def increments(self, running: Array) -> Array:
        """What grows over each increment, (..., A, m) of a running total (..., A, instants)."""
        end, begin = self.places("L")
        assert begin is not None
        return np.asarray(running[..., end] - running[..., begin], dtype=np.float64)

    @cached_property
    def links(self) -> joint.JointColumns:
        """Columns of the link angles' momenta, at the instants of the rows."""
        return joint.joint_columns(self.arm, self.thin)

    def grown(self, momentum: Array, force: Array) -> Array:
        """(..., A, m, N, ·) what momenta grow by over each increment beyond forces (..., A, instants of rows, N, ·)."""
        end, begin = self.places("L")
        assert begin is not None
        running = integral(force, self.every * self.arm.period_s, axis=-3)
        first, last = begin // self.every, end // self.every
        moved = momentum[..., last, :, :] - momentum[..., first, :, :]
        return np.asarray(moved - running[..., last, :, :] + running[..., first, :, :], dtype=np.float64)

    @cached_property
    def attitude(self) -> Array:
        """(..., A, m, 3, 3) from base axes to those at the arc's origin, at the instants of the rows."""
        return self.turning[..., :: self.every, :, :]

    @cached_property
    def turning(self) -> Array:
        """(..., A, instants, 3, 3) as `momentum.base_attitudes`."""
        h, omega = self.arm.period_s, self.state.base
        step = step_integrals(omega, h, axis=-2) + h * h / 12.0 * np.cross(omega[..., :-1, :], omega[..., 1:, :])
        turn = np.concatenate([np.zeros_like(step[..., :1, :]), step], axis=-2)
        whole = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(*turn.shape, 3)
        return _running_product(whole)


def _running_product(turns: Array) -> Array:
    """(..., m, 3, 3) products of the first k of m rotations, in blocks, so that the loops are short."""
    count = turns.shape[-3]
    size = max(1, round(np.sqrt(count)))
    blocks = -(-count // size)
    padded = np.empty((*turns.shape[:-3], blocks * size, 3, 3))
    padded[..., :count, :, :] = turns
    padded[..., count:, :, :] = np.eye(3)
    cut = padded.reshape(*turns.shape[:-3], blocks, size, 3, 3)
    for k in range(1, size):
        cut[..., k, :, :] = cut[..., k - 1, :, :] @ cut[..., k, :, :]
    for k in range(1, blocks):
        cut[..., k, :, :, :] = cut[..., k - 1, -1:, :, :] @ cut[..., k, :, :, :]
    return np.asarray(cut.reshape(padded.shape)[..., :count, :, :], dtype=np.float64)


def _bodies(layout: Layout, moving: _Moving) -> Iterator[Array]:
    """By balance, columns (..., A, m, ·) of the base parameters that it has."""
    arm, thin = layout.arm, moving.thin
    flexible = [i for i, one in enumerate(arm.joints) if one.flexible]
    links, s = list(layout.links), moving.state
    # a rigid joint has no spring, so nothing is lost in it
    lost = integral((s.thetad - s.qd) ** 2, arm.period_s, axis=-2)[..., :: moving.every, :] if flexible else thin.q
    bodies, carried = moving.bodies
    own = energy.drive_energy_columns(arm, thin, carried, lost)
    of_joint = {"Im": own.rotor + own.coupling, "k": own.spring, "b": own.damper}
    joints = [of_joint[symbol][..., i] for symbol, i in arm.full_joint_parameters]
    yield arm.structure.reduced(np.concatenate([bodies, np.stack(joints, axis=-1)] if joints else [bodies], axis=-1))
    for i in flexible:
        signals = moving.signals[i]
        spring = signals.totals.integral(signals.deflection) / signals.gear_ratio
        ratio = signals.gear_ratio
        yield np.stack(
            [
                ratio * thin.thetad[..., i] + carried[..., i],
                moving.thinned(spring),
                (thin.theta - thin.q)[..., i] / ratio,
            ],
            axis=-1,
        )
    if links:
        part = moving.links
        deflection = s.theta - s.q
        wound = np.swapaxes(moving.increments(np.swapaxes(integral(deflection, arm.period_s, -2), -1, -2)), -1, -2)
        damped = np.swapaxes(moving.increments(np.swapaxes(deflection, -1, -2)), -1, -2)
        single = np.eye(arm.n)[links]
        grown = joint.in_order(
            arm,
            moving.grown(part.momentum[..., links, :], part.force[..., links, :]),
            moving.grown(part.rotor_momentum[..., links, :], part.rotor_force[..., links, :]),
            {"k": -wound[..., None, :] * single, "b": -damped[..., None, :] * single},
        )
        for k in range(len(links)):
            yield grown[..., k, :]
    if arm.free:
        columns = moving.momentum
        kinetic = columns[..., : columns.shape[-1] - arm.n]
        spin = columns[..., columns.shape[-1] - arm.n :]
        none = np.zeros_like(spin[..., 0])
        listed = [spin[..., i] if symbol == "Im" else none for symbol, i in arm.full_joint_parameters]
        reduced = arm.structure.reduced(np.concatenate([kinetic, np.stack(listed, axis=-1)], axis=-1))
        kept = [k for k, one in enumerate(arm.parameters) if one.joint is None or one.symbol == "Im"]
        if arm.spatial:
            yield from (reduced[..., k, kept] for k in range(3))
        else:
            yield reduced[..., 0, kept]


def _right(layout: Layout, moving: _Moving) -> Iterator[Array]:
    """By balance, right sides (..., A, m)."""
    arm, s = layout.arm, moving.state
    work = from_first(energy.step_work(arm, s.theta, moving.after))
    yield moving.thinned(work + energy.torque_jump_energy(arm, s.thetad, moving.before, moving.after))
    for i, one in enumerate(arm.joints):
        if one.flexible:
            yield moving.thinned(motor_impulse(moving.signals[i]))
    for i in layout.links:
        ratio = 0.0 if arm.joints[i].flexible else moving.signals[i].gear_ratio
        yield moving.increments(ratio * motor_impulse(moving.signals[i]))
    for _ in layout.momenta:
        yield np.zeros(moving.thin.q.shape[:-1])


def _effects(layout: Layout, moving: _Moving, balance: str) -> Iterator[Array]:
    """Columns (..., A, m) of the effects that a balance has, in their order."""
    arm = layout.arm
    own = int(balance[1:]) - 1 if balance[0] in "ML" else -1
    for one in layout.effects:
        kind, i = one.kind, one.joint
        if not layout._acts(one, balance, own):
            continue
        if kind.place in _ACTING:
            if balance == "E":
                yield moving.thinned(energy_column(kind, moving.signals[i], one.shape))
            elif balance[0] == "M":
                yield moving.thinned(impulse_column(kind, moving.signals[i], one.shape))
            else:
                column = joint_column(kind, moving.signals[i], arm.joints[i].flexible, one.shape)
                yield moving.increments(column)
        elif kind.place == "rotor":
            yield from _coupling(arm, moving, balance, i)
        elif kind.place == "base":
            yield _on_base(arm, moving, balance, one)
        elif kind.place == "field":
            yield _pulled(arm, moving, balance)


def _on_base(arm: Arm, moving: _Moving, balance: str, one: Acting) -> Array:
    """(..., A, m) column of an effect of the base."""
    number = one.kind.components(arm).index(one.component)
    if balance == "E":
        return moving.thinned(energy_column(one.kind, moving.base, one.shape, number))
    column = momentum_column(one.kind, moving.base, one.shape, number)
    column = column[..., "xyz".index(balance[1])] if arm.spatial else _since_start(column[..., 0], moving.time)
    return moving.thinned(column)


def _pulled(arm: Arm, moving: _Moving, balance: str) -> Array:
    """(..., A, m) column of the gravity gradient."""
    if balance == "E":
        return moving.thinned(moving.pull.energy)
    if balance[0] == "L":
        return moving.increments(-integral(moving.pull.joints[..., int(balance[1:]) - 1], arm.period_s))
    torque = (moving.turning @ moving.pull.base[..., None])[..., "xyz".index(balance[1]), 0]
    return moving.thinned(-integral(torque, arm.period_s))


def _since_start(column: Array, time: Array) -> Array:
    """A running integral (..., A, m) that begins with each arc, as one that begins with the run.

    A momentum that a model assumes has no constant in each arc. What lies between two arcs is taken as what lies at the
    end of the first.
    """
    grown = column[..., -1] - column[..., 0]
    if not np.isfinite(time).all() or column.shape[-1] < 2:
        return column
    step = time[:, 1] - time[:, 0]
    slope = (column[..., -1] - column[..., -2]) / step
    between = np.append(time[1:, 0] - time[:-1, -1], 0.0)
    first = (column[..., :1, 1] - column[..., :1, 0]) / step[:1] * time[:1, 0]
    total = np.cumsum(grown + slope * between, axis=-1)
    start = np.concatenate([np.zeros_like(total[..., :1]), total[..., :-1]], axis=-1) + first
    return np.asarray(column + start[..., None], dtype=np.float64)


def _coupling(arm: Arm, moving: _Moving, balance: str, i: int) -> Iterator[Array]:
    """What the coupling of a rotor adds to a balance beside the rotor's own share."""
    if balance == "E":
        yield arm.gear_ratios[i] * moving.thin.thetad[..., i] * moving.carried[..., i]
    elif balance[0] == "M":
        if int(balance[1:]) - 1 == i:
            yield moving.carried[..., i]
    elif balance[0] == "L":
        yield _coupled_momentum(arm, moving, int(balance[1:]) - 1, i)
    else:
        yield moving.spin[..., "xyz".index(balance[1]) if arm.spatial else 0, i]


def _coupled_momentum(arm: Arm, moving: _Moving, at: int, rotor: int) -> Array:
    """(..., A, m) what the coupling of a rotor adds to the balance of the link angle of a joint."""
    part = moving.links
    pair = (..., slice(at, at + 1), slice(rotor, rotor + 1))
    grown = moving.grown(part.rotor_momentum[pair], part.rotor_force[pair])[..., 0, 0]
    if at == rotor and not arm.joints[at].flexible:
        grown = grown - moving.increments(arm.gear_ratios[at] ** 2 * moving.state.thetad[..., at])
    return np.asarray(grown, dtype=np.float64)


@dataclass(frozen=True)
class Sums:
    """Products of all columns and the right side, summed over the accepted rows of a run."""

    gram: tuple[Array, ...]
    """By balance (..., columns + 1, columns + 1): columns of `Layout.used`, the right side last; arc constants
    eliminated."""
    count: Array
    """(balances,) rows."""
    noise: tuple[Array, ...] | None = None
    """By balance (columns + 1, columns + 1): what the sensors' noise is expected to add to `gram`."""
    scores: tuple[Array, ...] | None = None
    """By balance (..., A, columns + 1): products of all columns and of what known coefficients leave over, by arc."""
    applied: Array | None = None
    """(zeros,) errors of the sensors that have been taken off the readings before."""

    def reading(self, number: int) -> Sums:
        """Of one reading (from 0) of several."""
        return replace(self, gram=tuple(gram[number] for gram in self.gram), scores=None)


def accumulate(
    rows: BalanceRows, accepted: NDArray[np.bool_], uncentred: Sequence[int] = (), known: Array | None = None
) -> Sums:
    """Sum a run. accepted: (A, instants). The balances listed in `uncentred` keep no constant for each arc.

    known: (columns + 1,) coefficients of all columns and of the right side, for `Sums.scores`.
    """
    grams, counts, scores = [], [], []
    for balance, own in enumerate(rows.balances):
        kept = kept_rows(own, accepted)
        z = np.concatenate([own.left, own.right[..., None]], axis=-1)
        weight = kept.astype(np.float64)[..., None]
        if own.begin is None and balance not in uncentred:
            count = weight.sum(axis=-2, keepdims=True)
            z -= (z * weight).sum(axis=-2, keepdims=True) / np.maximum(count, 1.0)
        if not kept.all():
            z *= weight
        flat = z.reshape((*z.shape[:-3], -1, z.shape[-1]))
        grams.append(np.asarray(np.swapaxes(flat, -1, -2) @ flat, dtype=np.float64))
        counts.append(float(kept.sum()))
        if known is not None:
            left = z @ known[np.append(rows.layout.used[balance], -1)]
            scores.append(np.asarray((left[..., None, :] @ z)[..., 0, :], dtype=np.float64))
    return Sums(tuple(grams), np.array(counts), scores=tuple(scores) or None)


def kept_rows(rows: Rows, accepted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(A, m) rows whose instants are accepted (A, instants), all of them."""
    if rows.begin is None:
        return accepted[:, rows.end]
    refused = np.concatenate([np.zeros((len(accepted), 1), dtype=np.int64), np.cumsum(~accepted, axis=1)], axis=1)
    return np.asarray(refused[:, rows.end + 1] == refused[:, rows.begin], dtype=np.bool_)
