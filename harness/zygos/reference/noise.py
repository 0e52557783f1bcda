# SPDX-License-Identifier: MIT
"""Mean contribution of the sensors' noise to rows and to their squares (include/zygos/noise.h).

With S the covariance of the smoothed signals and J the derivative of the augmented row [columns, work] with respect to
them, the mean error of a column is 1/2 sum_s S_ss d2(column)/dx_s^2, and that of a square is J S J^T. Derivatives are
exact differences of the columns at shifted states: a column is quadratic in every rate and in the motors' angles, and
its part from bodies and rotors is a trigonometric polynomial in every link angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.energy import EnergyRows, full_energy_columns
from zygos.balances.kinematics import body_columns
from zygos.balances.state import State
from zygos.effects import Effect, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed, coefficients

Floats = NDArray[np.float64]
Side = Literal["q", "theta"]

GYRO_SHARE = 1e-4
"""A gyro whose variance is below this share of that of every link's rate is treated as exact."""

TURNS = np.pi * np.array([0.25, 0.75, 1.25, 1.75])
RIESZ = np.array([1.0, -1.0, 1.0, -1.0]) / (8.0 * np.sin(0.5 * TURNS) ** 2)
"""The derivative of a trigonometric polynomial f of degree 2 is sum_t RIESZ_t f(x + TURNS_t). M. Riesz 1914."""


@dataclass(frozen=True)
class Spread:
    """Covariances of the smoothed signals; different sensors are independent.

    link, motor: (N, 2, 2) of value and rate of each joint's signal [rad, rad/s]. gyro: variance of a component of the
    smoothed base rate [rad^2/s^2]; 0 on a fixed base.
    """

    link: Floats
    motor: Floats
    gyro: float


@dataclass(frozen=True)
class Instants:
    """m instants: their states, and the torques (m, N) before and after each [Nm]."""

    state: State
    tau: Floats
    tau_next: Floats

    def at(self, rows: NDArray[np.int64]) -> Instants:
        """A selection of the instants."""
        s = self.state
        state = State(s.q[rows], s.theta[rows], s.qd[rows], s.thetad[rows], s.base[rows])
        return Instants(state, self.tau[rows], self.tau_next[rows])


@dataclass(frozen=True)
class RowNoise:
    """Mean contribution of noise to a record's rows; m rows, p columns.

    mean: (m, p) to each column. moment: (arcs, p+1, p+1) to the sum of the squares of [columns, work] over the accepted
    rows of each arc.
    """

    mean: Floats
    moment: Floats


def spread(arm: Arm) -> Spread:
    """Covariances from the declared deviations and the smoother's coefficients."""
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s

    def of(latch_us: int, sigma: float) -> Floats:
        late = -1e-6 * latch_us / h
        reader = np.stack([coefficients(points, order, late), coefficients(points, order, late, 1) / h])
        return np.asarray(sigma**2 * reader @ reader.T, dtype=np.float64)

    links = [(joint.latch_us, joint.link_encoder.over_the_wire) for joint in arm.joints]
    motors = [(joint.latch_us, joint.motor_encoder.over_the_wire) for joint in arm.joints]
    link = np.stack([of(own + encoder.latch_us, encoder.sigma_rad) for own, encoder in links])
    motor = np.stack([of(own + encoder.latch_us, encoder.sigma_rad) for own, encoder in motors])
    gyro = float(of(arm.imu.latch_us, arm.imu.over_the_wire.rate_sigma)[0, 0]) if arm.free else 0.0
    return Spread(link, motor, gyro if gyro >= GYRO_SHARE * link[:, 1, 1].min() else 0.0)


def noise_of(
    arm: Arm, samples: Samples, smoothed: Smoothed, balance: EnergyRows, effects: Sequence[Effect] = ()
) -> RowNoise:
    """Mean contribution of noise to the rows of a balance; zeros if the arm switches the compensation off."""
    m, p = balance.z.shape
    arcs = int(balance.arc.max(initial=-1)) + 1
    mean, moment = np.zeros((m, p)), np.zeros((arcs, p + 1, p + 1))
    if arm.compensation == 0:
        return RowNoise(mean, moment)
    here = row_instants(arm, samples, smoothed, balance)
    known = spread(arm)
    since_origin = np.arange(m) - np.searchsorted(balance.arc, balance.arc)
    bodies = means(arm, known, here.state)
    joints = since_origin[:, None] * drift(arm, known, effects)
    mean[:] = arm.structure.reduced(np.hstack([bodies, joints]))
    for arc in range(arcs):
        used = np.flatnonzero(balance.accepted & (balance.arc == arc))
        moment[arc] = moments(arm, known, here.at(used), since_origin[used], effects)
    return RowNoise(mean, moment)


def row_instants(arm: Arm, samples: Samples, smoothed: Smoothed, balance: EnergyRows) -> Instants:
    """The instants of a balance's rows."""
    of = np.searchsorted(smoothed.index, balance.index)
    whole = Instants(State.smoothed(arm, smoothed), samples.tau[smoothed.index - 1], samples.tau[smoothed.index])
    return whole.at(of)


def means(arm: Arm, known: Spread, state: State) -> Floats:
    """1/2 S d2(column)/d(rate)^2 of the bodies' full columns, (m, B), summed over joints and gyro."""

    def curvature(place: str, i: int) -> Floats:
        columns = [body_columns(arm, _moved(state, place, i, by))[0] for by in (-1.0, 0.0, 1.0)]
        return np.asarray(columns[0] - 2.0 * columns[1] + columns[2], dtype=np.float64)

    mean = np.zeros((len(state.q), len(arm.full_body_names)))
    for i in range(arm.n):
        mean += 0.5 * known.link[i, 1, 1] * curvature("qd", i)
    for axis in range(_gyro_axes(arm)):
        mean += 0.5 * known.gyro * curvature("base", axis)
    return mean


def drift(arm: Arm, known: Spread, effects: Sequence[Effect] = ()) -> Floats:
    """Mean contribution of noise per step to the full columns after those of bodies, which integrate squared rates."""
    h, rate = arm.period_s, known.motor[:, 1, 1]
    slip = [h * (known.link[i, 1, 1] + rate[i]) if kind == "b" else 0.0 for kind, i in arm.full_joint_parameters]

    def square(effect: Effect) -> float:
        i = effect.index(arm)
        if not effect.kind.viscous:
            return 0.0
        return float(arm.gear_ratios[i] * rate[i] if effect.kind.place == "motor" else known.link[i, 1, 1])

    of_effects = [h * square(effect) for effect in estimated(arm, effects)]
    return np.array([*slip, *of_effects])


def moments(arm: Arm, known: Spread, here: Instants, turn: NDArray[np.int64], effects: Sequence[Effect] = ()) -> Floats:
    """Sum of J S J^T over instants, (p+1, p+1), the work last.

    turn: (m,) sensor s (link encoders, motor encoders, axes of the gyro) is evaluated where turn % `arm.compensation`
    is s modulo the same number, and then represents all other instants.
    """
    every, n = arm.compensation, arm.n
    p = len(arm.parameter_names) + len(estimated(arm, effects))
    total = np.zeros((p + 1, p + 1))

    def add(weight: float, covariance: Floats, *slopes: Floats) -> None:
        for a, left in enumerate(slopes):
            for b, right in enumerate(slopes):
                total[:] += weight * covariance[a, b] * left.T @ right

    def at(sensor: int) -> Instants:
        return here.at(np.flatnonzero(turn % every == sensor % every))

    for i, joint in enumerate(arm.joints):
        link = slopes(arm, at(i), "q", i, effects)
        if joint.flexible:
            add(every, known.link[i], *link)
            add(every, known.motor[i], *slopes(arm, at(n + i), "theta", i, effects))
        else:
            motor = slopes(arm, at(i), "theta", i, effects)
            add(every, known.motor[i], link[0] + motor[0], link[1] + motor[1])
    for axis in range(_gyro_axes(arm)):
        some = at(2 * n + axis)
        columns = [full_energy_columns(arm, _moved(some.state, "base", axis, by), _none(some)) for by in (-1.0, 1.0)]
        slope = _row(arm, 0.5 * (columns[1] - columns[0]), effects)
        add(every, np.array([[known.gyro]]), arm.structure.reduced(slope))
    return total


def slopes(arm: Arm, here: Instants, side: Side, i: int, effects: Sequence[Effect] = ()) -> tuple[Floats, Floats]:
    """Derivatives of [columns, work], (m, p+1) each, in the angle and in the rate of joint i's link or motor.

    For a column that is integrated since the start of the arc, the part caused by the noise of this instant is the
    integrand over the rate, times the noise of the angle.
    """

    def columns(place: str, by: float) -> Floats:
        return full_energy_columns(arm, _moved(here.state, place, i, by), _none(here))

    def central(place: str) -> Floats:
        return 0.5 * (columns(place, 1.0) - columns(place, -1.0))

    of_springs = [kind == "k" for kind, _ in arm.full_joint_parameters]
    first = len(arm.full_body_names)
    angle = central(side)
    if side == "q":
        turned = sum(weight * columns("q", by) for weight, by in zip(RIESZ, TURNS, strict=True))
        angle = np.where([*[False] * first, *of_springs], angle, turned)
    deflection = (here.state.theta - here.state.q)[:, i]
    slip = (here.state.thetad - here.state.qd)[:, i]
    sign = 1.0 if side == "theta" else -1.0
    for k, (kind, joint) in enumerate(arm.full_joint_parameters):
        if kind == "b" and joint == i:
            angle[:, first + k] = 2.0 * sign * slip
    by_angle = _row(arm, angle, effects)
    by_rate = _row(arm, central(side + "d"), effects)
    ratio, jump = arm.gear_ratios[i], here.tau_next[:, i] - here.tau[:, i]
    rate = (here.state.thetad if side == "theta" else here.state.qd)[:, i]
    for k, effect in enumerate(estimated(arm, effects), start=len(arm.full_names)):
        torque, place = effect.kind.torque, effect.kind.place
        if effect.index(arm) != i:
            continue
        if effect.kind.gain:
            by_angle[:, k] = -ratio * here.tau[:, i] if side == "theta" else 0.0
            by_rate[:, k] = -arm.held_s * ratio * jump if side == "theta" else 0.0
            continue
        if place == "torque":
            by_rate[:, k] = 0.5 * ratio * jump if side == "theta" else 0.0
            continue
        assert torque is not None
        if effect.kind.potential is not None:
            by_angle[:, k] = sign * torque(deflection)
        elif place == {"q": "link", "theta": "motor"}[side]:
            # d(f(v) v)/dv where f grows with the rate, or is constant above the slowest rate
            one, two = torque(np.array([1.0, 2.0]))
            grows = float(two / one)
            by_angle[:, k] = grows * (ratio if side == "theta" else 1.0) * torque(rate)
    if side == "theta":
        by_angle[:, -1] = ratio * here.tau[:, i]
        by_rate[:, -1] = arm.held_s * ratio * jump
    return arm.structure.reduced(by_angle), arm.structure.reduced(by_rate)


def _gyro_axes(arm: Arm) -> int:
    return 0 if not arm.free else 3 if arm.spatial else 1


def _none(here: Instants) -> Floats:
    return np.zeros_like(here.state.q)


def _row(arm: Arm, columns: Floats, effects: Sequence[Effect]) -> Floats:
    """Full columns (m, p_full) of the arm, with zeros for those of effects and for the work."""
    return np.pad(columns, ((0, 0), (0, len(estimated(arm, effects)) + 1)))


def _moved(state: State, place: str, i: int, by: float) -> State:
    """The state with component i of one of its arrays changed."""
    value: Floats = getattr(state, place).copy()
    if value.ndim == 1:
        value += by
    else:
        value[:, i] += by
    return replace(state, **{place: value})
