# SPDX-License-Identifier: MIT
"""The simulated arm: sampled servo, torque held between SYNCs, SciPy's DOP853 in between.

Between SYNCs the equations of motion are smooth and autonomous, so each period is integrated separately, all seeds as
one state; no integration step crosses a step of the torque. The servo reads the same encoder errors that the run
records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.equations import Dynamics, EngineName, equations
from zygos.dynamics.joints import Drives, Moment
from zygos.dynamics.planar import PlanarDynamics
from zygos.effects import Effect, sensed
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario
from zygos.simulation.sensors import (
    Noise,
    draw_noise,
    encoder_angle,
    encoder_reading,
    gyro_reading,
    no_noise,
    torque_record,
)

Array = NDArray[np.float64]

_STEPS_MAX = 400
"""Largest number of DOP853 steps in a SYNC period; an arm that needs more is too stiff for an explicit method."""


@dataclass(frozen=True)
class Trajectory:
    """The exact motion of B seeds at n SYNC instants t_k = k * period; N joints."""

    arm: Arm
    """The arm, at the period that was simulated."""
    dynamics: Dynamics
    seeds: tuple[int, ...]
    t: Array
    """(n,) time, s."""
    attitude: Array
    """Attitude of the base: (B, n) angle about the axis of a planar arm, rad; (B, n, 4) quaternion from base to
    inertial axes, scalar last, where the base turns in space; (B, n, 0) where it is fixed."""
    omega0: Array
    """(B, n) base rate of a planar arm, rad/s; (B, n, 3) in base axes where it turns in space or is fixed."""
    q: Array
    """(B, n, N) link angles, rad."""
    qd: Array
    """(B, n, N) link rates, rad/s."""
    theta: Array
    """(B, n, N) motor angles after the gear, rad."""
    thetad: Array
    """(B, n, N) motor rates after the gear, rad/s."""
    tau: Array
    """(B, n, N) rotor torque before the gear, Nm, which acts on [t_k, t_{k+1})."""
    slip2: Array
    """(B, n, N) integral of (thetad - qd)^2 from 0 to t_k, rad^2/s."""
    desired: Array
    """(n, N) desired angles, rad."""
    q_latched: Array
    """(B, n, N) link angles when the link encoders latch, rad; equal to q where no latch is late."""
    theta_latched: Array
    """(B, n, N) motor angles when the motor encoders latch, rad."""
    omega0_latched: Array
    """Base rate when the gyro latches, rad/s; shape as omega0."""
    noise: Noise
    """The errors that the servo reads and `cycles` records."""
    memory: NDArray[np.complex128]
    """(B, n, S) internal states of the laws with a memory."""
    sensors: tuple[Effect, ...] = ()
    """Effects of sensors, which `cycles` records. The servo does not read them."""

    def accelerations(self) -> tuple[Array, Array, Array]:
        """Exact accelerations just after each SYNC: base as omega0, links (B, n, N), motors after the gear (B, n, N),
        rad/s^2."""
        angle = self.attitude if self.attitude.ndim == 2 else 0.0
        nadir = _nadir(self.arm, self.attitude) if self.arm.nadir else None
        moment = Moment(np.broadcast_to(self.t, self.q.shape[:-1]), angle, self.memory, nadir)
        return self.dynamics.accelerations(self.q, self.theta, self.omega0, self.qd, self.thetad, self.tau, moment)

    def cycles(self, index: int = 0) -> Cycles:
        """Sensor readings of the run of `seeds[index]`."""
        return record(self, index)


def record(trajectory: Trajectory, index: int = 0) -> Cycles:
    """Sensor readings of the run of `trajectory.seeds[index]`: n cycles, numbered from 0."""
    arm, noise = trajectory.arm, trajectory.noise
    n = len(trajectory.t)
    exact = Readings(
        trajectory.q_latched[index],
        trajectory.theta_latched[index],
        trajectory.omega0_latched[index],
        trajectory.tau[index],
    )
    exact = sensed(arm, exact, trajectory.sensors)
    return Cycles(
        sync=np.arange(n, dtype=np.uint64),
        q=encoder_reading([joint.link_encoder for joint in arm.joints], exact.q, noise.link[index], noise.rounding),
        theta=encoder_reading(
            [joint.motor_encoder for joint in arm.joints],
            exact.theta,
            noise.motor[index],
            noise.rounding,
        ),
        tau=torque_record(arm, trajectory.tau[index], noise.torque[index], noise.torque_share[index]),
        omega=gyro_reading(arm, _vector(arm, exact.omega0[None])[0], noise.gyro[index]),
        flags=np.zeros(n, dtype=np.uint32),
    )


def _vector(arm: Arm, omega0: Array) -> Array:
    """(B, n, 3) base rate in base axes."""
    return omega0 if omega0.ndim == 3 else omega0[..., None] * arm.axis


def simulate(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    *,
    engine: EngineName = "zygos",
    dynamics: Dynamics | None = None,
    seeds: Sequence[int] | None = None,
    noise: bool | None = None,
    period_s: float | None = None,
    duration_s: float | None = None,
    rtol: float = 1e-12,
    atol: float = 1e-14,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Simulate the scenario in closed loop, with the effects of the model.

    An angular momentum in the model has priority over the scenario's. engine: the name of the equations of motion;
    those of independent engines support bodies only, no effects. dynamics: other equations of motion of this arm,
    instead of the engine's.

    seeds (default: the scenario's) are integrated together; noise, duration_s and period_s replace the values of
    scenario and arm. There are round(duration / period) cycles. rtol and atol are DOP853's. A trajectory depends on the
    other seeds of its batch through the choice of steps, within the tolerances; a chaotic motion amplifies this. Its
    noise does not depend on them.

    progress is called from time to time with the share that is finished.

    Errors: ZygosError if model, scenario and arm do not fit each other, or if the motion diverges.
    """
    if period_s is not None:
        arm = arm.at_period(period_s)
    chosen = tuple(seeds) if seeds is not None else (scenario.seed,)
    n = round((scenario.duration_s if duration_s is None else duration_s) / arm.period_s)
    if n < 2 or not chosen:
        raise ZygosError(
            f"scenario {scenario.name}: {n} cycles of {len(chosen)} seeds cannot be simulated; remedy: give "
            "a duration of at least two SYNC periods, and at least one seed"
        )
    dynamics = equations(arm, model, engine) if dynamics is None else dynamics
    noisy = scenario.noise if noise is None else noise
    errors = draw_noise(arm, n, chosen, scenario.encoder_noise) if noisy else no_noise(arm, n, chosen)
    planar = isinstance(dynamics, PlanarDynamics)
    run = _Run(arm, dynamics, scenario, planar=planar, seeds=chosen, n=n, noise=errors, rtol=rtol, atol=atol)
    sensors = tuple(effect for effect in model.effects if effect.kind.place == "sensor")
    return replace(run.trajectory(progress), sensors=sensors)


class _Run:
    """State of one simulation; the state vector is B rows of attitude, omega0, q, qd, theta, thetad, slip2, and of what
    laws remember, real and imaginary parts."""

    def __init__(
        self,
        arm: Arm,
        dynamics: Dynamics,
        scenario: Scenario,
        *,
        planar: bool,
        seeds: tuple[int, ...],
        n: int,
        noise: Noise,
        rtol: float,
        atol: float,
    ) -> None:
        self.arm, self.dynamics, self.scenario, self.seeds = arm, dynamics, scenario, seeds
        self.n, self.noise = n, noise
        self.rtol, self.atol = rtol, atol
        joints = arm.n
        self.planar = planar
        widths = [1, 1] if planar else [4, 3] if arm.free else [0, 0]
        self.drives = dynamics if isinstance(dynamics, Drives) and dynamics.states else None
        states = self.drives.states if self.drives else 0
        self.sees_earth = isinstance(dynamics, Drives) and bool(dynamics.gradient)
        ends = np.cumsum([0, *widths, *[joints] * 5, 2 * states]).tolist()
        self.attitude, self.omega, *self.slices, self.kept = (slice(a, b) for a, b in pairwise(ends))
        self.ratio = arm.gear_ratios
        self.step = arm.period_s
        self.begin = 0.0
        self.tau = np.zeros((len(seeds), joints))
        self.tau_rate = np.zeros((len(seeds), joints))
        # of a continuous torque that is sampled, the drive commands the value at the end of the period
        self.ramps = scenario.controller.feedforward and arm.torque_law == "sampled"
        angles = scenario.initial_angles_rad or (0.0,) * joints
        if len(angles) != joints:
            raise ZygosError(
                f"scenario {scenario.name}: {len(angles)} initial angles for {joints} joints; remedy: "
                "give initial_angles_rad one number per joint"
            )
        for key, gain in (("kp", scenario.controller.kp), ("kd", scenario.controller.kd)):
            if isinstance(gain, tuple) and len(gain) != joints:
                raise ZygosError(
                    f"scenario {scenario.name}: {len(gain)} {key} for {joints} joints; remedy: give one number, or one "
                    "for each joint"
                )
        self.state = np.zeros((len(seeds), ends[-1]))
        q, _, theta, _, _ = self.slices
        self.state[:, q] = self.state[:, theta] = np.array(angles)
        self._start_turning(planar)
        if self.drives:
            self._set_memory(self.state, self.drives.memory_at_rest(self._joints(self.state)))

    def _start_turning(self, planar: bool) -> None:
        arm, dynamics, scenario = self.arm, self.dynamics, self.scenario
        if not arm.free:
            return
        q = self.slices[0]
        if not planar:
            self.state[:, self.attitude] = [0.0, 0.0, 0.0, 1.0]
        assumed = dynamics.angular_momentum
        momentum = np.array(scenario.angular_momentum_nms if assumed is None else assumed, dtype=np.float64)
        if planar and momentum.ndim:
            raise ZygosError(
                f"scenario {scenario.name}: angular_momentum_nms is a vector, but arm {arm.name} moves in a plane; "
                "remedy: give one number"
            )
        if not planar and not momentum.ndim:
            momentum = momentum * (arm.axis if not arm.spatial else np.array([0.0, 0.0, 1.0]))
        self._set_omega0(self.state, dynamics.base_rate(self.state[:, q], momentum))

    def _omega0(self, state: Array) -> Array:
        """Base rate in a state (..., width), in the form that the equations of motion need."""
        if not self.arm.free:
            return np.zeros((*state.shape[:-1], 3))
        return state[..., self.omega.start] if self.planar else state[..., self.omega]

    def _memory(self, state: Array) -> NDArray[np.complex128]:
        """(..., S) internal states of laws in a state (..., width)."""
        parts = state[..., self.kept]
        return np.asarray(parts[..., 0::2] + 1j * parts[..., 1::2])

    def _set_memory(self, state: Array, memory: NDArray[np.complex128]) -> None:
        parts = state[..., self.kept]
        parts[..., 0::2], parts[..., 1::2] = memory.real, memory.imag

    def _joints(self, state: Array) -> State:
        q, qd, theta, thetad, _ = (state[..., part] for part in self.slices)
        return State(q, theta, qd, thetad, self._omega0(state))

    def _set_omega0(self, state: Array, rate: Array) -> None:
        if self.arm.free:
            state[..., self.omega] = rate[..., None] if self.planar else rate

    def trajectory(self, progress: Callable[[float], None] | None) -> Trajectory:
        arm, joints = self.arm, self.arm.n
        shape = (len(self.seeds), self.n)
        t: Array = arm.period_s * np.arange(self.n, dtype=np.float64)
        desired, desired_rate = self.scenario.desired([joint.name for joint in arm.joints], t)
        states = np.empty((*shape, self.state.shape[1]))
        taus = np.empty((*shape, joints))
        needed = self._feedforward()
        command = np.broadcast_to(needed[0], self.tau.shape)
        latches = _Latches(arm, self.slices, self.omega)
        pauses = _pauses(latches, self.dynamics.torque_lag)
        latched = np.empty((*shape, latches.width)) if latches.late else None
        slip = self.slices[4]
        total = np.zeros((len(self.seeds), joints))
        before: Array | None = None
        for k in range(self.n):
            if progress is not None and k % 20 == 0:
                progress(k / self.n)
            states[:, k] = self.state
            states[:, k, slip] = total
            angle = self._measured(k)
            rate = np.zeros_like(angle) if before is None else (angle - before) / arm.period_s
            before = angle
            servo = self.scenario.controller
            previous, command = (
                command,
                needed[k + 1 if self.ramps else k]
                + (
                    servo.gain
                    * (np.array(servo.kp) * (desired[k] - angle) + np.array(servo.kd) * (desired_rate[k] - rate))
                    / self.ratio
                ),
            )
            begin = previous if self.ramps else command
            taus[:, k] = begin
            self.state[:, slip] = 0.0
            reached = 0.0
            for offset, columns, motors in pauses:
                self._integrate(offset - reached, t[k], t[k] + reached)
                reached = offset
                self.tau[:, motors] = begin[:, motors]
                self.tau_rate[:, motors] = (command - begin)[:, motors] / arm.period_s
                if latched is not None:
                    latched[:, k, columns[0]] = self.state[:, columns[1]]
            self._integrate(arm.period_s - reached, t[k], t[k] + reached)
            total += self.state[:, slip]
        q, qd, theta, thetad, _ = (states[..., part] for part in self.slices)
        omega0 = omega0_latched = self._omega0(states)
        q_latched, theta_latched = q, theta
        if latched is not None:
            q_latched, theta_latched = latched[..., :joints], latched[..., joints : 2 * joints]
            if arm.free:
                omega0_latched = latched[..., -1] if self.planar else latched[..., 2 * joints :]
        return Trajectory(
            arm,
            self.dynamics,
            self.seeds,
            t,
            states[..., 0] if self.planar else states[..., self.attitude],
            omega0,
            q,
            qd,
            theta,
            thetad,
            taus,
            states[..., slip],
            desired,
            q_latched,
            theta_latched,
            omega0_latched,
            self.noise,
            self._memory(states),
        )

    def _measured(self, k: int) -> Array:
        """(B, N) angles that the servo reads at SYNC k, rad."""
        if self.scenario.controller.angle == "motor":
            encoders = [joint.motor_encoder for joint in self.arm.joints]
            angle, error = self.state[:, self.slices[2]], self.noise.motor[:, k]
        else:
            encoders = [joint.link_encoder for joint in self.arm.joints]
            angle, error = self.state[:, self.slices[0]], self.noise.link[:, k]
        return encoder_angle(encoders, encoder_reading(encoders, angle, error, self.noise.rounding))

    def _derivative(self, since: float, flat: Array) -> Array:
        state = flat.reshape(self.state.shape)
        q, qd, theta, thetad, slip = self.slices
        omega0 = self._omega0(state)
        memory = self._memory(state) if self.drives else None
        base, link, motor = self.dynamics.accelerations(
            state[:, q],
            state[:, theta],
            omega0,
            state[:, qd],
            state[:, thetad],
            self.tau + since * self.tau_rate,
            Moment(
                self.begin + since,
                state[:, 0] if self.planar else 0.0,
                memory,
                _nadir(self.arm, state[:, self.attitude]) if self.sees_earth else None,
            ),
        )
        rate = np.empty_like(state)
        if self.drives and memory is not None:
            self._set_memory(rate, self.drives.memory_derivative(self._joints(state), memory))
        if self.planar:
            rate[:, 0] = omega0
        elif self.arm.free:
            rate[:, self.attitude] = _quaternion_rate(state[:, self.attitude], omega0)
        self._set_omega0(rate, base)
        rate[:, q] = state[:, qd]
        rate[:, qd] = link
        rate[:, theta] = state[:, thetad]
        rate[:, thetad] = motor
        rate[:, slip] = (state[:, thetad] - state[:, qd]) ** 2
        return rate.ravel()

    def _integrate(self, span: float, t: float, begin: float) -> None:
        """Advance the state by `span` s under a torque that is held or ramps, from `begin` s on; local time starts at
        zero, so that its rounding error does not affect the step."""
        if span <= 0.0:
            return
        self.begin = begin
        with np.errstate(over="ignore", invalid="ignore"):
            solver = DOP853(
                self._derivative,
                0.0,
                self.state.ravel(),
                span,
                first_step=min(self.step, span),
                rtol=self.rtol,
                atol=self.atol,
            )
            for _ in range(_STEPS_MAX):
                solver.step()
                if solver.status != "running":
                    break
        if solver.status == "running":
            raise ZygosError(
                f"scenario {self.scenario.name}: one SYNC period takes more than {_STEPS_MAX} integration "
                f"steps at t = {t:.3f} s; remedy: check the units of stiffness, damping and rotor inertia "
                "in the model (Nm/rad and Nms/rad after the gear, kg m^2 before it)"
            )
        turned = solver.y.reshape(self.state.shape)[:, self.slices[0]] - self.state[:, self.slices[0]]
        # a sampled servo cannot follow a joint that turns by more than half a turn between two samples
        if solver.status != "finished" or not np.max(np.abs(turned)) < np.pi:
            raise ZygosError(
                f"scenario {self.scenario.name}: the motion diverges at t = {t:.3f} s; remedy: lower the "
                "controller's gain, feed back the motor angle, or shorten period_s"
            )
        # the size that the step control proposes is the best initial value for the next period
        self.step = min(solver.h_abs, self.arm.period_s)
        self.state = solver.y.reshape(self.state.shape)
        if self.drives:
            # what has stopped is where it stops
            self._set_memory(
                self.state, self.drives.remembered(self._joints(self.state), self._memory(self.state), 0.0)
            )
        self.tau += span * self.tau_rate

    def _feedforward(self) -> Array:
        """(n + 1, N) torques before the gear that the desired motion needs, Nm; zeros without feedforward.

        Of a torque that is held, those in the middle of each period; of one that ramps, those at the SYNCs.
        """
        arm, joints = self.arm, self.arm.n
        if not self.scenario.controller.feedforward:
            return np.zeros((self.n + 1, joints))
        t = arm.period_s * (np.arange(self.n + 1, dtype=np.float64) + (0.0 if self.ramps else 0.5))
        names = [joint.name for joint in arm.joints]
        angle, rate = self.scenario.desired(names, t)
        return needed_torque(arm, self.dynamics, angle, rate, self.scenario.accelerations(names, t))


def needed_torque(arm: Arm, dynamics: Dynamics, angle: Array, rate: Array, acceleration: Array) -> Array:
    """(m, N) rotor torques before the gear, Nm, at which a grounded arm has these accelerations (m, N), rad/s^2, at
    angles (m, N), rad, and rates (m, N), rad/s.

    Accelerations are affine in the torques, so that those of N + 1 torques determine them, whatever equations of motion
    there are. Errors: ZygosError if the arm floats or has a flexible joint.
    """
    if not arm.grounded:
        raise ZygosError(
            f"arm {arm.name}: the torque of a desired motion is computed only where the base is fixed and all joints "
            "are rigid; remedy: leave feedforward out of the scenario"
        )
    base = np.zeros((len(angle), 3))

    def reached(tau: Array) -> Array:
        torque = np.broadcast_to(tau, angle.shape)
        return dynamics.accelerations(angle, angle, base, rate, rate, torque)[1]

    # a unit that turns the link noticeably, so that no digits are lost in the difference
    unit = 1.0 / arm.gear_ratios
    rest = reached(np.zeros(arm.n))
    gain = np.stack([(reached(unit * row) - rest) for row in np.eye(arm.n)], axis=-1)
    return np.asarray(unit * np.linalg.solve(gain, (acceleration - rest)[..., None])[..., 0], dtype=np.float64)


def _nadir(arm: Arm, attitude: Array) -> Array:
    """(..., 3) unit vector to the Earth in base axes, where the attitude is (..., 4)."""
    back = Rotation.from_quat(attitude.reshape(-1, 4)).inv()
    return np.asarray(back.apply(np.array(arm.nadir)), dtype=np.float64).reshape(*attitude.shape[:-1], 3)


_TURN_OF = np.array([[3, 2, 1], [2, 3, 0], [1, 0, 3], [0, 1, 2]])
_TURN_SIGN = 0.5 * np.array([[1, -1, 1], [1, 1, -1], [-1, 1, 1], [-1, -1, -1]])
"""Components and factors of the matrix whose product with the angular velocity is a quaternion's rate."""


def _quaternion_rate(attitude: Array, omega: Array) -> Array:
    """(B, 4) derivative of the attitude (scalar last) of a base that turns at omega (B, 3) in its own axes, rad/s."""
    rate: Array = ((_TURN_SIGN * attitude[:, _TURN_OF]) @ omega[:, :, None])[:, :, 0]
    return rate


def _pauses(latches: _Latches, lag: Array | None) -> list[tuple[float, tuple[list[int], list[int]], list[int]]]:
    """Events after SYNC, in order: (time in s, columns that latch as in `_Latches`, motors whose torque takes
    effect)."""
    happens: dict[float, tuple[tuple[list[int], list[int]], list[int]]] = {
        offset: (columns, []) for offset, columns in latches.groups
    }
    for motor, late in enumerate([0.0] * latches.joints if lag is None else lag.tolist()):
        happens.setdefault(late, (([], []), []))[1].append(motor)
    return [(offset, *happens[offset]) for offset in sorted(happens)]


class _Latches:
    """Instants at which readings are latched, in order: (s after SYNC, (columns of the record, of the state))."""

    def __init__(self, arm: Arm, slices: list[slice], omega: slice) -> None:
        at: dict[int, tuple[list[int], list[int]]] = {}
        for i, joint in enumerate(arm.joints):
            for encoder, column, source in (
                (joint.link_encoder, i, slices[0].start + i),
                (joint.motor_encoder, arm.n + i, slices[2].start + i),
            ):
                into, out = at.setdefault(joint.latch_us + encoder.latch_us, ([], []))
                into.append(column)
                out.append(source)
        into, out = at.setdefault(arm.imu.latch_us, ([], []))
        rates = omega.stop - omega.start
        into += range(2 * arm.n, 2 * arm.n + rates)
        out += range(omega.start, omega.stop)
        self.width = 2 * arm.n + rates
        self.joints = arm.n
        self.late = any(offset > 0 for offset in at)
        self.groups = [(offset * 1e-6, columns) for offset, columns in sorted(at.items())]
