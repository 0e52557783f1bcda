# SPDX-License-Identifier: MIT
"""Balances of exactly known motions of three arms, for the test that every column is what its effect does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from arm_support import random_arm
from numpy.typing import NDArray
from runs_support import trajectory_of
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from zygos.arm import Arm, load_arm
from zygos.balances import energy, joint, momentum
from zygos.balances.effects import (
    BaseSignals,
    Signals,
    body_column,
    energy_column,
    impulse_column,
    joint_column,
    momentum_column,
    sensor_column,
)
from zygos.balances.field import pull
from zygos.balances.kinematics import body_columns, posture
from zygos.balances.quadrature import FromOrigin, integral
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.effects import Effect, Kind
from zygos.model import gram
from zygos.model.model import Model, load_model
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Controller, Scenario, Sine, load_scenario

Floats = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[2] / "examples"
PERIOD_S = 0.002
DURATION_S = 1.6
NADIR = (0.48, -0.6, 0.64)
"""Where the Earth is when a run of an arm that floats in space begins."""
ARMS = ("planar free flexible", "spatial free flexible", "fixed rigid")


@cache
def arm_of(name: str) -> tuple[Arm, Model, Scenario]:
    """An arm, its model and a motion in which every joint turns round."""
    if name == "fixed rigid":
        arm, model = random_arm(3, 3, "fixed", "spatial", flexible=False)
        sines = {one.name: (Sine(0.5 + 0.1 * i, 3.0 + 0.7 * i, 0.4 * i),) for i, one in enumerate(arm.joints)}
        scenario = load_scenario(EXAMPLES / "spatial" / "scenario.toml")
        motion = type(next(iter(scenario.manoeuvre.values())))
        manoeuvre = {key: motion(sines=value) for key, value in sines.items()}
        control = Controller(kp=2000.0, kd=300.0, feedforward=True)
        return arm, model, replace(scenario, manoeuvre=manoeuvre, controller=control)
    folder = EXAMPLES / ("gap" if name.startswith("planar") else "spatial")
    files = ("cad.toml", "b.toml") if name.startswith("planar") else ("model.toml", "scenario.toml")
    arm = load_arm(folder / "arm.toml")
    return (
        replace(arm, nadir=NADIR) if arm.spatial else arm,
        replace(load_model(folder / files[0]), effects=()),
        load_scenario(folder / files[1]),
    )


@cache
def moved(name: str, *effects: Effect) -> Trajectory:
    """The motion with effects, without noise."""
    arm, model, scenario = arm_of(name)
    return trajectory_of(
        arm,
        replace(model, effects=effects),
        scenario,
        noise=False,
        seeds=[0],
        period_s=PERIOD_S,
        duration_s=DURATION_S,
        rtol=1e-9,
        atol=1e-11,
    )


@dataclass(frozen=True)
class Exact:
    """A motion at m instants without any error."""

    arm: Arm
    state: State
    tau: Floats
    time: Floats
    turned: Floats | None
    """(m, 3, 3) from base to inertial axes, of a base that turns in space."""
    angle: Floats
    """(m,) angle of the base of a planar arm."""

    @property
    def before(self) -> Floats:
        """(m, N) torques of the cycle before, 0 before the first."""
        return np.concatenate([np.zeros_like(self.tau[:1]), self.tau[:-1]])

    @property
    def totals(self) -> FromOrigin:
        """Integrals from the first instant on."""
        return FromOrigin(self.arm.period_s)

    def load(self, values: dict[str, float]) -> Floats:
        """(m, N) torque through the gears, without effects."""
        s, out = self.state, self.arm.gear_ratios * self.tau
        for i, one in enumerate(self.arm.joints):
            if one.flexible:
                slip = (s.thetad - s.qd)[:, i]
                out[:, i] = values[f"k{i + 1}"] * (s.theta - s.q)[:, i] + values[f"b{i + 1}"] * slip
        return out

    def signals(self, i: int, values: dict[str, float]) -> Signals:
        """Of a joint."""
        return Signals.of(
            self.arm, self.state, self.before, self.tau, i, self.totals, time=self.time, load=self.load(values)
        )

    def base(self) -> BaseSignals:
        """Of the base."""
        return BaseSignals(self.state.base, self.totals, self.time, self.angle, self.turned)


def exact(run: Trajectory) -> Exact:
    """The motion that the simulator knows."""
    arm = run.arm
    state = State(run.q[0], run.theta[0], run.qd[0], run.thetad[0], run.omega0[0])
    return _of(arm, run, state)


def _of(arm: Arm, run: Trajectory, state: State) -> Exact:
    turned = Rotation.from_quat(run.attitude[0]).as_matrix() if arm.free and arm.spatial else None
    angle = run.attitude[0] if run.attitude.ndim == 2 else np.zeros(len(run.t))
    return Exact(arm, state, run.tau[0], run.t, turned, angle)


def read(run: Trajectory, readings: Readings) -> Exact:
    """The motion that readings show, whose rates are those of splines."""
    q, theta = (CubicSpline(run.t, angles) for angles in (readings.q, readings.theta))
    state = State(readings.q, readings.theta, q(run.t, 1), theta(run.t, 1), readings.omega0)
    seen = _of(run.arm, run, state)
    if seen.turned is None:
        return seen
    # the base's attitude is the integral of what the gyro reads
    turns = [np.eye(3)]
    rate = readings.omega0
    step = integral(rate, run.arm.period_s, axis=0)
    for k in range(1, len(rate)):
        both = run.arm.period_s**2 / 12.0 * np.cross(rate[k - 1], rate[k])
        turns.append(turns[-1] @ Rotation.from_rotvec(step[k] - step[k - 1] + both).as_matrix())
    return replace(seen, turned=np.stack(turns))


def balances(name: str, seen: Exact) -> Iterator[tuple[str, Floats, Floats]]:
    """Names of balances, columns (m, c) of the base parameters that they have, right sides (m,)."""
    arm, s, h = seen.arm, seen.state, seen.arm.period_s
    lost = integral((s.thetad - s.qd) ** 2, h, axis=0)
    work = np.concatenate([[0.0], np.cumsum(energy.step_work(arm, s.theta, seen.tau))])
    yield "E", energy.energy_columns(arm, s, lost), work
    impulse = h * (np.cumsum(seen.tau, axis=0) - seen.tau)
    carried = body_columns(arm, s)[1]
    ratio = arm.gear_ratios
    none = np.zeros((len(s.q), len(arm.parameter_names)))
    running = None
    for i, one in enumerate(arm.joints):
        if one.flexible:
            columns, d = none.copy(), (s.theta - s.q)[:, i]
            own = {f"Im{i + 1}": ratio[i] * s.thetad[:, i] + carried[:, i], f"b{i + 1}": d / ratio[i]}
            for key, column in (own | {f"k{i + 1}": integral(d, h) / ratio[i]}).items():
                columns[:, arm.parameter_names.index(key)] = column
            yield f"M{i + 1}", columns, impulse[:, i]
        else:
            if running is None:
                part = joint.joint_columns(arm, s)
                running = joint.in_order(
                    arm,
                    part.momentum - integral(part.force, h, axis=0),
                    part.rotor_momentum - integral(part.rotor_force, h, axis=0),
                )
            yield f"L{i + 1}", running[:, i], ratio[i] * impulse[:, i]
    if arm.free:
        columns = momentum.momentum_columns(arm, s)
        kinetic, spin = columns[..., : -arm.n], columns[..., -arm.n :]
        zero = np.zeros_like(spin[..., 0])
        listed = [spin[..., i] if symbol == "Im" else zero for symbol, i in arm.full_joint_parameters]
        all_of_them = arm.structure.reduced(np.concatenate([kinetic, np.stack(listed, axis=-1)], axis=-1))
        if seen.turned is not None:
            all_of_them = seen.turned @ all_of_them
        for k in range(all_of_them.shape[-2]):
            yield "H" + "xyz"[k] * (all_of_them.shape[-2] == 3), all_of_them[:, k], np.zeros(len(s.q))


def residuals(name: str, seen: Exact) -> dict[str, Floats]:
    """What the true parameters leave over of each balance, (m,)."""
    arm, model, _ = arm_of(name)
    values = model.base_values(arm)
    return {key: columns @ values - right for key, columns, right in balances(name, seen)}


def scales(name: str, seen: Exact) -> dict[str, float]:
    """Spread of the largest term of each balance."""
    arm, model, _ = arm_of(name)
    values = model.base_values(arm)
    return {
        key: float(max(np.std(columns * values, axis=0).max(), np.std(right)))
        for key, columns, right in balances(name, seen)
    }


def columns(
    name: str, seen: Exact, run: Trajectory, kind: Kind, i: int, component: int, shape: float | None
) -> dict[str, Floats]:
    """(m,) column of an effect in each balance; 0 where it has none."""
    arm, model, _ = arm_of(name)
    values = dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True))
    rest = residuals(name, seen)
    out = {key: np.zeros_like(left) for key, left in rest.items()}
    if kind.place == "sensor":
        readings = Readings(seen.state.q, seen.state.theta, seen.state.base, seen.tau)

        def left(one: Readings) -> Floats:
            return np.stack(list(residuals(name, read(run, one)).values()))

        each = sensor_column(left, kind, run.arm, readings, i, component, 1e-5)
        return dict(zip(out, each, strict=True))
    if kind.place == "body":
        assert shape is not None
        which = kind.components(arm)[component]
        at = arm.parameter_names.index(which)
        return {key: body_column(z[:, at], seen.time, shape) for key, z, _ in balances(name, seen)}
    if kind.place == "base":
        base = seen.base()
        out["E"] = energy_column(kind, base, shape, component)
        turned = momentum_column(kind, base, shape, component)
        for k in range(turned.shape[-1]):
            out["H" + "xyz"[k] * (turned.shape[-1] == 3)] = turned[:, k]
        return out
    if kind.place == "field":
        assert seen.turned is not None
        kinetic = np.array([values[name] for name in arm.full_body_names])
        one = pull(posture(arm, seen.state.q), gram.from_parameters(arm, kinetic), np.array(NADIR) @ seen.turned)
        out["E"] = one.energy
        along = integral((seen.turned @ one.base[..., None])[..., 0], PERIOD_S, axis=0)
        return out | {f"H{axis}": -along[:, k] for k, axis in enumerate("xyz")}
    if kind.place == "rotor":
        carried = body_columns(arm, seen.state)[1][:, i]
        ratio, spin = arm.gear_ratios[i], seen.state.thetad[:, i]
        inertia = model.joints[i].rotor_inertia.value
        out["E"] = inertia * ratio * spin * carried
        if arm.joints[i].flexible:
            out[f"M{i + 1}"] = inertia * carried
        part = joint.joint_columns(arm, seen.state)
        running = part.rotor_momentum - integral(part.rotor_force, seen.arm.period_s, axis=0)
        for j, one in enumerate(arm.joints):
            if not one.flexible:
                # the rotor's own spin does not need the carrying body
                out[f"L{j + 1}"] = inertia * (running[:, j, i] - (ratio**2 * spin if j == i else 0.0))
        if not arm.free:
            return out
        along = momentum.momentum_columns(arm, seen.state)[..., i - arm.n]
        along = along if seen.turned is None else (seen.turned @ along[..., None])[..., 0]
        for k in range(along.shape[-1]):
            out["H" + "xyz"[k] * (along.shape[-1] == 3)] = inertia * along[:, k]
        return out
    signals = seen.signals(i, values)
    out["E"] = energy_column(kind, signals, shape)
    if arm.joints[i].flexible:
        out[f"M{i + 1}"] = impulse_column(kind, signals, shape)
    else:
        out[f"L{i + 1}"] = joint_column(kind, signals, flexible=False, shape=shape)
    return out
