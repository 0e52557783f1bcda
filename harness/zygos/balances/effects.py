# SPDX-License-Identifier: MIT
"""Columns of the catalogue's effects in the balances of energy and of motor impulse (docs/theory.md, "Effects").

A balance is linear in the coefficients of effects; the column of an effect is what a unit of its coefficient adds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.quadrature import FromOrigin
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.effects import UNKNOWN, Effect, Kind, Motion, estimated
from zygos.errors import ZygosError
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Signals:
    """What the columns of a joint's effects are made of, at m instants with any leading axes."""

    deflection: Floats
    """(..., m) theta - q, rad."""
    link_rate: Floats
    """(..., m) rad/s."""
    motor_angle: Floats
    """(..., m) after the gear, rad."""
    motor_rate: Floats
    """(..., m) after the gear, rad/s."""
    before: Floats
    """(..., m) rotor torque of the cycle before the instant, Nm."""
    after: Floats
    """(..., m) rotor torque from the instant on, Nm."""
    gear_ratio: float
    totals: FromOrigin
    jump_s: float = 0.0
    """`zygos.arm.Arm.held_s`: only gains need it."""
    time: Floats = UNKNOWN
    """(..., m) or (m,) time since the start of the run, s; only laws that depend on time need it."""
    load: Floats = UNKNOWN
    """(..., m) torque through the gear as a model predicts it, after the gear, Nm; only laws of the load need it."""
    torques: dict[tuple[str, float | None], Floats] = field(default_factory=dict, compare=False, repr=False)
    """What `torque` has answered: a law stands in several balances, and one with a memory is dear."""

    @classmethod
    def of(
        cls,
        arm: Arm,
        state: State,
        before: Floats,
        after: Floats,
        joint: int,
        totals: FromOrigin,
        *,
        time: Floats = UNKNOWN,
        load: Floats = UNKNOWN,
    ) -> Signals:
        """Of a joint (from 0); states, torques and loads (..., m, N)."""
        return cls(
            state.theta[..., joint] - state.q[..., joint],
            state.qd[..., joint],
            state.theta[..., joint],
            state.thetad[..., joint],
            before[..., joint],
            after[..., joint],
            float(arm.gear_ratios[joint]),
            totals,
            arm.held_s,
            time,
            load if load is UNKNOWN else load[..., joint],
        )

    @property
    def link_angle(self) -> Floats:
        """(..., m) rad."""
        return self.motor_angle - self.deflection

    @property
    def slip(self) -> Floats:
        """(..., m) rate of the deflection, rad/s."""
        return self.motor_rate - self.link_rate

    def side(self, kind: Kind) -> tuple[Floats, Floats]:
        """(..., m) rate, rad/s, and angle, rad, of what the law of an entry acts on."""
        return {
            "motor": (self.motor_rate, self.motor_angle),
            "link": (self.link_rate, self.link_angle),
            "spring": (self.slip, self.deflection),
        }[kind.side]

    def torque(self, kind: Kind, shape: float) -> Floats:
        """(..., m) f along the motion, per unit of its coefficient. Errors: ZygosError for a site without such laws."""
        key = kind.key, None if np.isnan(shape) else shape
        if key not in self.torques:
            self.torques[key] = _law(kind)(self.motion(kind, shape), shape)
        return self.torques[key]

    def motion(self, kind: Kind, shape: float) -> Motion:
        """What a law depends on."""
        rate, angle = self.side(kind)
        motion = Motion(
            rate=rate,
            angle=angle,
            deflection=self.deflection,
            slip=self.slip,
            applied=self.after,
            load=self.load,
            time=np.broadcast_to(self.time, rate.shape),
            ratio=self.gear_ratio,
        )
        return kind.memory.along(motion, shape, self.totals.period_s) if kind.memory else motion


@dataclass(frozen=True)
class BaseSignals:
    """What the columns of the base's effects are made of, at m instants with any leading axes."""

    rate: Floats
    """(..., m) base rate about the axis of a planar arm, (..., m, 3) in base axes of a spatial one, rad/s."""
    totals: FromOrigin
    time: Floats = UNKNOWN
    """(..., m) or (m,) time since the start of the run, s."""
    angle: Floats = UNKNOWN
    """(..., m) angle that the base of a planar arm has turned since the start of the run, rad."""
    turned: Floats | None = None
    """(..., m, 3, 3) rotation from base axes to those in which the momentum of a spatial arm is stated; None in a
    plane."""
    torques: dict[tuple[str, float | None, int], Floats] = field(default_factory=dict, compare=False, repr=False)
    """What `torque` has answered."""

    def torque(self, kind: Kind, shape: float, component: int) -> Floats:
        """(..., m) f along the motion, per unit of its coefficient."""
        key = kind.key, None if np.isnan(shape) else shape, component
        if key not in self.torques:
            assert kind.law is not None
            self.torques[key] = kind.law(self.motion(kind, shape, component), shape)
        return self.torques[key]

    def rate_about(self, component: int) -> Floats:
        """(..., m) rate about an axis of the base, or about that of a planar arm, rad/s."""
        return self.rate[..., component] if self.turned is not None else self.rate

    def motion(self, kind: Kind, shape: float, component: int) -> Motion:
        """What a law depends on; the angle is that of a planar arm."""
        rate = self.rate_about(component)
        motion = Motion(rate=rate, angle=self.angle, time=np.broadcast_to(self.time, rate.shape))
        return kind.memory.along(motion, shape, self.totals.period_s) if kind.memory else motion


def energy_column(kind: Kind, signals: Signals | BaseSignals, shape: float | None = None, component: int = 0) -> Floats:
    """Column (..., m) in the energy balance, J per unit: what the effect stored or took away since the arc's origin.

    shape: of the law, without it `Kind.shape`. component: of an effect of the base of a spatial arm. Errors:
    ZygosError for a site whose columns other functions have.
    """
    form = kind.shape if shape is None else shape
    if isinstance(signals, BaseSignals):
        rate = signals.rate_about(component)
        return (
            np.zeros_like(rate)
            if kind.law is None
            else -signals.totals.integral(signals.torque(kind, form, component) * rate)
        )
    s = signals
    if kind.place == "torque":
        return _torque_energy_column(kind, s, form)
    if kind.potential is not None:
        return kind.potential(s.deflection, form)
    factor = s.gear_ratio if kind.place == "motor" else 1.0
    return s.totals.integral(factor * s.torque(kind, form) * s.side(kind)[0])


def _torque_energy_column(kind: Kind, s: Signals, form: float) -> Floats:
    """The same of an effect by which the motor's torque exceeds the reported one."""
    if kind.gain:
        moved = np.diff(s.motor_angle, append=s.motor_angle[..., -1:])
        jump = s.jump_s * (s.after - s.before) * s.motor_rate
        return -s.gear_ratio * (s.totals.sum_before(s.after * moved) + jump)
    if kind.lags:
        step = s.gear_ratio * (s.after - s.before) * s.motor_rate
        # a motor that is late by T misses step T of each torque step; of the one at the instant half of it shows
        return s.totals.sum_before(step) + 0.5 * step
    if kind.potential is not None:
        return -kind.potential(s.gear_ratio * s.motor_angle, form)
    return -_held(kind, s, form, s.gear_ratio * s.motor_rate)


def impulse_column(kind: Kind, signals: Signals, shape: float | None = None) -> Floats:
    """Column (..., m) in the balance of the motor's impulse, before the gear, Nms per unit, up to a constant in each
    arc; 0 of what acts on the link alone. Errors: as `energy_column`."""
    form, s = kind.shape if shape is None else shape, signals
    if kind.impulse is not None:
        return kind.impulse(s.motor_angle)
    if kind.lags:
        return np.asarray(0.5 * (s.before + s.after), dtype=np.float64)
    if kind.place == "link":
        return np.zeros_like(s.link_rate)
    if kind.gain:
        return -motor_impulse(s)
    if kind.place == "torque":
        return -_held(kind, s, form, np.ones_like(s.motor_rate))
    return s.totals.integral(s.torque(kind, form)) / (1.0 if kind.place == "motor" else s.gear_ratio)


def motor_impulse(signals: Signals) -> Floats:
    """Impulse of the motor since the arc's origin, before the gear, (..., m) [Nms], raised by what a torque step adds
    to the rate that is read."""
    s = signals
    return s.totals.period_s * s.totals.sum_before(s.after) + s.jump_s * (s.after - s.before)


def joint_column(kind: Kind, signals: Signals, flexible: bool, shape: float | None = None) -> Floats:
    """Column (..., m) in the row of the joint, Nms per unit, up to a constant in each arc.

    The motor of a flexible joint does not act on the link. Errors: as `energy_column`.
    """
    form, s = kind.shape if shape is None else shape, signals
    if kind.place == "spring":
        return -s.totals.integral(s.torque(kind, form))
    if kind.place == "link":
        return s.totals.integral(s.torque(kind, form))
    return np.zeros_like(s.link_rate) if flexible else s.gear_ratio * impulse_column(kind, s, shape)


def momentum_column(kind: Kind, signals: BaseSignals, shape: float | None = None, component: int = 0) -> Floats:
    """Column (..., m, r) of an effect of the base in the balance of the angular momentum, Nms per unit, up to a
    constant in each arc; r is 3 in space, else 1.

    The angular momentum itself is the constant -1. Errors: ZygosError for another site.
    """
    if kind.place != "base":
        raise ZygosError(f"effect {kind.key}: has no column in the angular momentum; remedy: an effect of the base")
    s = signals
    if kind.law is None:
        return np.full((*s.rate.shape, 1), -1.0)
    form = kind.shape if shape is None else shape
    torque = s.torque(kind, form, component)
    if s.turned is None:
        return -s.totals.integral(torque)[..., None]
    along = s.turned[..., component] * torque[..., None]
    return np.stack([-s.totals.integral(along[..., k]) for k in range(3)], axis=-1)


def sensor_column(
    rows: Callable[[Readings], Floats],
    kind: Kind,
    arm: Arm,
    readings: Readings,
    joint: int,
    component: int,
    step: float,
) -> Floats:
    """Column of a sensor's error in any balance: what one unit of it would take away from what is left over.

    rows(readings): what a balance leaves over with the parameters that are believed, (columns . parameters - right
    side). step: size of the differences, in the unit of the kind; errors are of its square.
    """
    more = rows(kind.transform(arm, readings, joint, step, component))
    less = rows(kind.transform(arm, readings, joint, -step, component))
    return (less - more) / (2.0 * step)


def body_column(columns: Floats, time: Floats, instant: float) -> Floats:
    """Column (..., m) of a base parameter that is larger by 1 from an instant on, from its own column (..., m) in any
    balance; time: (m,) or (..., m) since the start of the run, s.

    The motion goes on without a jump, as where the hand lets go of a mass, so that the column is the parameter's own
    less its value at the instant.
    """
    since = np.broadcast_to(time, columns.shape) >= instant
    # where the whole arc lies behind the instant, its constant takes what the column begins with
    first = np.argmax(since, axis=-1)[..., None]
    return np.where(since, columns - np.take_along_axis(columns, first, axis=-1), 0.0)


def _law(kind: Kind) -> Callable[[Motion, float], Floats]:
    if kind.law is None or kind.place not in ("motor", "link", "load", "spring", "torque"):
        raise ZygosError(
            f"effect {kind.key}: the site {kind.place} has no column at a joint; remedy: a site where a law acts"
        )
    return kind.law


def _held(kind: Kind, s: Signals, form: float, factor: Floats) -> Floats:
    """Integral of f times a factor (..., m), where f may depend on the torque, which is constant in each step."""
    law, motion = _law(kind), s.motion(kind, form)

    def at(shift: int) -> Floats:
        # what stands before the arc's first instant is not used
        begin, end = max(0, 1 - shift), max(0, factor.shape[-1] - shift)

        def then(value: Floats) -> Floats:
            return np.broadcast_to(value, factor.shape)[..., begin:end]

        there = replace(
            motion,
            rate=then(motion.rate),
            angle=then(motion.angle),
            deflection=then(motion.deflection),
            slip=then(motion.slip),
            applied=s.after[..., max(shift - 1, 0) : -1],
            load=then(motion.load),
            time=then(motion.time),
        )
        out = np.zeros((*factor.shape[:-1], factor.shape[-1] - 1))
        out[..., max(shift - 1, 0) :] = law(there, form) * factor[..., begin:end]
        return out

    return s.totals.held(at)


def effect_columns(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effects: Sequence[Effect]
) -> Floats:
    """Columns (m, E) of the E effects that `estimated` names at the m smoothed instants, in J per unit of each.

    arc: (m,) number of the arc that an instant belongs to, -1 for none. Integrals and sums begin with their arc; what
    stands where there is no arc means nothing. Errors: as `estimated`, and ZygosError for an effect at no joint.
    """
    state, totals = State.smoothed(arm, smoothed), FromOrigin(arm.period_s, arc)
    before, after = samples.tau[smoothed.index - 1], samples.tau[smoothed.index]
    columns = [
        energy_column(effect.kind, Signals.of(arm, state, before, after, effect.index(arm), totals), effect.shape)
        for effect in estimated(arm, effects)
    ]
    return np.stack(columns, axis=1) if columns else np.zeros((len(arc), 0))
