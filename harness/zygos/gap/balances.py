"""The balances of a gap: what every parameter and every effect of the catalogue adds to each, for batches of arcs.

Energy E of the whole arm: work of the motors = change of kinetic and spring energy + losses. Motor impulse M_i, local
to joint i: int tau = Im (n thetad + f_(i-1)) + 1/n int spring + int friction. Momentum H of the whole arm about its
mass centre, of which a planar arm has one component, so that the base's attitude drops out. A balance is

    columns . coefficients = right side + constant of the arc

The columns are those of `zygos.balances`, without accelerations (docs/gap.md; Nanos & Papadopoulos eqs. (11), (37)). H
has no constant where a model assumes an angular momentum: then its value is a column of its own. The columns of the
sensors' zeros are derived here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances import energy, impulse, momentum
from zygos.balances.effects import Signals, energy_column, impulse_column
from zygos.balances.kinematics import body_columns
from zygos.balances.quadrature import FromOrigin, from_first, integral
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.effects import CATALOGUE, OFFSET, Kind, column_name
from zygos.gap.record import smoothed_states

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Names of all balances and columns of an arm."""

    arm: Arm

    @cached_property
    def balances(self) -> tuple[str, ...]:
        """E, M1 .. MN, H."""
        return ("E", *(f"M{i + 1}" for i in range(self.arm.n)), "H")

    @cached_property
    def effects(self) -> tuple[tuple[Kind, int], ...]:
        """Entries of the catalogue and joints (from 0; -1 for the base) in the order of their columns.

        The offset of a spring is none of them: the zeros of its encoders stand for it.
        """
        joints, kinds = range(self.arm.n), [kind for kind in CATALOGUE.values() if kind.searched and kind.key != OFFSET]
        return tuple((kind, i) for kind in kinds for i in (joints if kind.at_joint else (-1,)))

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Base parameters, effects, zeros of the sensors.

        Im_i stands for the rotor's own share alone, rotor_coupling_i for what its spin shares with the carrying body;
        in nature both coefficients are Im_i.
        """
        effects = [column_name(kind, i) for kind, i in self.effects]
        return (*self.arm.parameter_names, *effects, *self.zeros)

    @cached_property
    def zeros(self) -> tuple[str, ...]:
        """Columns of the sensors' zeros: the encoders', rad, known to a quantum at best, which is enough to look like
        an effect; and the gyro's bias, rad/s, which looks like an angular momentum."""
        encoders = [f"{side}_zero{i + 1}" for i in range(self.arm.n) for side in ("link", "motor")]
        return (*encoders, "gyro_bias")

    @cached_property
    def zero_sigma(self) -> Array:
        """(2N+1,) how well the arm file knows them, rad and rad/s, in the order of `zeros`."""
        pairs = [(joint.link_encoder, joint.motor_encoder) for joint in self.arm.joints]
        encoders = [max(e.zero_sigma_rad, e.quantum_rad) for pair in pairs for e in pair]
        return np.array([*encoders, self.arm.over_the_wire.imu.rate_sigma])


@dataclass(frozen=True)
class BalanceRows:
    """All balances at every instant."""

    left: Array
    """(..., balances, A, instants, columns)"""
    right: Array
    """(..., balances, A, instants)"""


def balance_rows(arm: Arm, readings: Readings, values: Array) -> BalanceRows:
    """Balances of arcs of readings, in the units of energy (J), impulse before the gear (Nms) and momentum (Nms).

    values: base parameters (p,), about right: what an encoder's zero does to the balances depends on them.
    """
    state = smoothed_states(arm, readings)
    half = arm.smoother.points // 2
    cycles = readings.tau.shape[-2]
    after = readings.tau[..., half : cycles - half, :]
    before = readings.tau[..., half - 1 : cycles - half - 1, :]
    layout = Layout(arm)
    shape = (*state.base.shape[:-2], len(layout.balances), *state.base.shape[-2:])
    out = BalanceRows(np.zeros((*shape, len(layout.columns))), np.zeros(shape))
    put = _Put(layout, out)
    bodies, carried = body_columns(arm, state)
    _energy(arm, state, bodies, carried, put)
    work = from_first(energy.step_work(arm, state.theta, after))
    put.right("E", work + energy.torque_jump_energy(arm, state.thetad, before, after))
    _momentum(arm, state, put)
    for i in range(arm.n):
        signals = Signals.of(arm, state, before, after, i, FromOrigin(arm.period_s))
        _impulse(arm, signals, i, carried[..., i], put)
        for kind, joint in layout.effects:
            if joint == i and kind.place in ("motor", "link", "spring", "torque"):
                put("E", column_name(kind, i), energy_column(kind, signals))
                if kind.place != "link":
                    put(f"M{i + 1}", column_name(kind, i), impulse_column(kind, signals))
    _zeros(arm, state, values, put)
    return out


@dataclass(frozen=True)
class _Put:
    layout: Layout
    rows: BalanceRows

    def __call__(self, balance: str, column: str, values: Array | float) -> None:
        self.rows.left[..., self.layout.balances.index(balance), :, :, self.layout.columns.index(column)] = values

    def right(self, balance: str, values: Array) -> None:
        self.rows.right[..., self.layout.balances.index(balance), :, :] = values


def _energy(arm: Arm, state: State, bodies: Array, carried: Array, put: _Put) -> None:
    for k, (name, _) in enumerate(arm.body_parameters):
        put("E", name, bodies[..., k])
    slip = state.thetad - state.qd
    own = energy.drive_energy_columns(arm, state, carried, integral(slip**2, arm.period_s, axis=-2))
    columns = {"Im": own.rotor, "rotor_coupling": own.coupling, "k": own.spring, "b": own.damper}
    for key, column in columns.items():
        for i in range(arm.n):
            put("E", f"{key}{i + 1}", column[..., i])


def _impulse(arm: Arm, signals: Signals, i: int, carried: Array, put: _Put) -> None:
    own = impulse.drive_impulse_columns(signals, carried)
    columns = {"Im": own.rotor, "rotor_coupling": own.coupling, "k": own.spring, "b": own.damper}
    for key, column in columns.items():
        put(f"M{i + 1}", f"{key}{i + 1}", column)
    put.right(f"M{i + 1}", impulse.motor_impulse(arm, signals))


def _momentum(arm: Arm, state: State, put: _Put) -> None:
    columns = momentum.momentum_columns(arm, state)[..., 0, :]
    names = [name for name, _ in arm.body_parameters] + [f"rotor_coupling{i + 1}" for i in range(arm.n)]
    for k, name in enumerate(names):
        put("H", name, columns[..., k])
    put("H", "angular_momentum", -1.0)


def _zeros(arm: Arm, state: State, values: Array, put: _Put) -> None:
    """What zeros that are off by 1 rad, or 1 rad/s, would take away, to first order."""
    value = dict(zip(arm.parameter_names, np.where(np.isfinite(values), values, 0.0).tolist(), strict=True))
    f, phi = state.f, state.phi
    bodies = range(arm.n + 1)
    # turned as one piece, the arm has this inertia
    locked = sum(
        value[f"a{j}{k}"] * (1 if j == k else 2) * np.cos(phi[..., k] - phi[..., j]) for j in bodies for k in bodies[j:]
    )
    put("H", "gyro_bias", -np.asarray(locked))
    time = arm.period_s * np.arange(f.shape[-2])
    for i in range(arm.n):
        gained, turning = np.zeros_like(state.base), np.zeros_like(state.base)
        for j in range(i + 1):
            for k in range(i + 1, arm.n + 1):
                turned = -value[f"a{j}{k}"] * np.sin(phi[..., k] - phi[..., j])
                gained += turned * f[..., j] * f[..., k]
                turning += turned * (f[..., j] + f[..., k])
        spring = value[f"k{i + 1}"] * (state.theta - state.q)[..., i]
        pushed = value[f"k{i + 1}"] / arm.gear_ratios[i] * time
        put("E", f"link_zero{i + 1}", spring - gained)
        put("H", f"link_zero{i + 1}", -turning)
        put(f"M{i + 1}", f"link_zero{i + 1}", pushed)
        put("E", f"motor_zero{i + 1}", -spring)
        put(f"M{i + 1}", f"motor_zero{i + 1}", -pushed)


@dataclass(frozen=True)
class Sums:
    """Products of all columns and the right side, summed over the accepted instants of a run."""

    gram: Array
    """(..., balances, columns + 1, columns + 1), the right side last; arc constants eliminated."""
    count: Array
    """(balances,) instants."""
    noise: Array | float = 0.0
    """(balances, columns + 1, columns + 1) what the sensors' noise is expected to add to `gram`."""


def accumulate(rows: BalanceRows, accepted: NDArray[np.bool_], uncentred: Sequence[int] = ()) -> Sums:
    """Sum a run. accepted: (A, instants). The balances listed in `uncentred` keep no constant for each arc."""
    z = np.concatenate([rows.left, rows.right[..., None]], axis=-1)
    weight = accepted.astype(np.float64)[..., None]
    count = weight.sum(axis=-2, keepdims=True)
    mean = (z * weight).sum(axis=-2, keepdims=True) / np.maximum(count, 1.0)
    for balance in uncentred:
        mean[..., balance, :, :, :] = 0.0
    z = (z - mean) * weight
    flat = z.reshape((*z.shape[:-3], -1, z.shape[-1]))
    total = np.asarray(np.swapaxes(flat, -1, -2) @ flat, dtype=np.float64)
    return Sums(total, np.full(z.shape[-4], accepted.sum(), dtype=np.float64))
