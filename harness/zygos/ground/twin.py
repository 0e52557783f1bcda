# SPDX-License-Identifier: MIT
"""The null twin of a run of an arm with rigid joints: what a model would have reported along the same motion.

The filtered angles of the run are the motion of the twin, and its torques follow from the model by inverse dynamics.
Its sensors have the quanta of the arm file, and the torques the noise of the run. What the model leaves of them comes
from noise, quanta, filters and differences alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from zygos import limits
from zygos.arm import Arm
from zygos.balances.joint import in_order, joint_columns
from zygos.balances.state import State
from zygos.effects import Effect
from zygos.ground.motion import Motion, TorqueRows, cutoff_hz, torque_noise, torque_rows
from zygos.ground.rows import RunRows, resting_share, run_rows, torque_columns
from zygos.ground.score import Score, scored
from zygos.runs.samples import Samples
from zygos.runs.smoother import smooth

Floats = NDArray[np.float64]

_AT_REST = ("motor_coulomb", "link_coulomb", "motor_stribeck", "link_stribeck")
_STEP = 0.1
"""Of the differences in time of the momentum, in periods."""


def floor(motion: Motion, rows: TorqueRows, values: Floats, effects: Sequence[Effect], seed: int = 0) -> Score:
    """The score of a model on its own twin. rows: of the measured run."""
    acting = acting_of(effects)
    twin = torque_rows(motion.arm, _samples(motion, rows, values, acting, seed), rows.cutoff_hz)
    return scored(motion.run, "floor", twin, values, acting, motion)


class Twins:
    """Twins of runs, each made once: several questions are asked of the twin of one model."""

    def __init__(self) -> None:
        """None is known."""
        self._known: list[tuple[Motion, Floats, Sequence[Effect], Motion]] = []

    def of(self, motion: Motion, values: Floats, effects: Sequence[Effect]) -> Motion:
        """As `twin_of`."""
        acting = acting_of(effects)
        for run, known, acted, twin in self._known:
            if run is motion and acted == acting and np.array_equal(known, values):
                return twin
        self._known.append((motion, values, acting, twin_of(motion, values, acting)))
        return self._known[-1][-1]


def increments_floor(measured: RunRows, values: Floats, effects: Sequence[Effect], twins: Twins) -> Floats:
    """(N,) what a model leaves of the increments of its own twin, with the best offset of each torque, as standard
    deviation, Nms. Beside noise these are the errors of smoothing and quadrature, and friction of joints that rest,
    which may be anything up to that of a joint that moves.

    measured: the rows of the run. NaN at joints without an increment that counts. Errors: ZygosError for a run that is
    too short for the filter.
    """
    motion, acting = measured.motion, acting_of(effects)
    arm = motion.arm
    twin = twins.of(motion, values, acting)
    own = run_rows(twin, measured.span_s, acting, predicted_load(twin, values))
    left = own.w - own.z @ np.array([*values, *(effect.value for effect in acting)])
    used = measured.rows.accepted[:, None] & ~measured.lingers & np.isfinite(left)
    resting = resting_share(arm, State.smoothed(arm, motion.smoothed), measured.rows) * measured.span_s
    resting *= _resting_friction(arm, acting)
    each = [(left[used[:, j], j], resting[used[:, j], j]) for j in range(arm.n)]
    return np.array([np.hypot(np.std(x), np.sqrt(np.mean(r**2))) if len(x) else np.nan for x, r in each])


def twin_of(motion: Motion, values: Floats, effects: Sequence[Effect], seed: int = 0) -> Motion:
    """The motion that the twin's sensors read. Errors: ZygosError for a run that is too short for the filter."""
    arm = motion.arm
    rows = torque_rows(arm, motion.samples, min(cutoff_hz(arm), limits.HIGHEST_CUTOFF_HZ.value))
    samples = _samples(motion, rows, values, acting_of(effects), seed)
    return Motion(motion.run, samples, replace(smooth(arm, samples), accepted=motion.smoothed.accepted))


def _resting_friction(arm: Arm, effects: Sequence[Effect]) -> Floats:
    """(N,) torque of friction near rest, after the gear, Nm."""
    out = np.zeros(arm.n)
    for effect in effects:
        if effect.kind.key in _AT_REST:
            joint = effect.index(arm)
            out[joint] += abs(effect.value) * (arm.gear_ratios[joint] if effect.kind.place == "motor" else 1.0)
    return out


def predicted_load(motion: Motion, values: Floats) -> Floats:
    """(m, N) torque of bodies and rotors after the gear at the smoothed instants, Nm. values: those of the arm's
    parameters come first."""
    arm, h = motion.arm, motion.arm.period_s
    columns = motion.columns
    z = in_order(
        arm,
        np.gradient(columns.momentum, h, axis=0) - columns.force,
        np.gradient(columns.rotor_momentum, h, axis=0) - columns.rotor_force,
    )
    return np.asarray(z @ values[: z.shape[-1]], dtype=np.float64)


def acting_of(effects: Sequence[Effect]) -> list[Effect]:
    """Those that are torques of the twin, and not errors of its sensors."""
    return [effect for effect in effects if not (effect.kind.gain or effect.kind.lags)]


def _samples(motion: Motion, rows: TorqueRows, values: Floats, effects: Sequence[Effect], seed: int) -> Samples:
    """What the sensors of the twin read."""
    rng = np.random.default_rng(seed)
    samples, arm = motion.samples, motion.arm
    theta, tau = samples.theta.copy(), np.full_like(samples.tau, np.nan)
    noise = np.maximum(torque_noise(motion), torque_noise(motion, declared=False))
    for number, (start, stop) in enumerate(samples.segments):
        own = rows.segment == number
        if not own.any():
            continue
        good = np.flatnonzero(np.all(np.isfinite(samples.tau[start:stop]), axis=1))
        of = slice(start + int(good[0]), start + int(good[-1]) + 1)
        angle = rows.state.q[own]
        made = _torques(arm, angle, rows, values, effects)
        white = noise * rng.standard_normal((len(made) + 1, arm.n))
        shaken = 0.5 * (white[1:] + white[:-1]) if arm.torque_law == "sampled" else white[1:]
        tau[of] = made / arm.gear_ratios + shaken
        theta[of] = _read(arm, angle, rng)
    return replace(samples, q=theta, theta=theta, tau=tau)


def _torques(arm: Arm, angle: Floats, rows: TorqueRows, values: Floats, effects: Sequence[Effect]) -> Floats:
    """(n, N) mean torque after the gear in each period from an instant on, Nm."""
    h = rows.period_s
    t = np.asarray(np.arange(len(angle)) * h, dtype=np.float64)
    path = make_interp_spline(t, angle, k=5, axis=0)
    begin = _torque(arm, path, t, rows, values, effects)
    if arm.torque_law == "sampled":
        return 0.5 * (begin + np.vstack([begin[1:], begin[-1:]]))
    middle = _torque(arm, path, t + 0.5 * h, rows, values, effects)
    return (begin + 4.0 * middle + np.vstack([begin[1:], begin[-1:]])) / 6.0


def _torque(arm: Arm, path: BSpline, t: Floats, rows: TorqueRows, values: Floats, effects: Sequence[Effect]) -> Floats:
    """(n, N) torque after the gear at instants of a motion, Nm."""
    step = _STEP * rows.period_s

    def momentum(at: Floats) -> Floats:
        columns = joint_columns(arm, _state(arm, path(at), path(at, 1)))
        return np.asarray(in_order(arm, columns.momentum, columns.rotor_momentum) @ values, dtype=np.float64)

    slope = (momentum(t + step) - momentum(t - step)) / (2.0 * step)
    state = _state(arm, path(t), path(t, 1))
    columns = joint_columns(arm, state)
    bodies = slope - in_order(arm, columns.force, columns.rotor_force) @ values
    if not effects:
        return np.asarray(bodies, dtype=np.float64)
    instants = replace(rows, state=state, z=np.zeros((*bodies.shape, 0)), tau=bodies)
    extra = torque_columns(arm, instants, effects, bodies, filtered=False)
    return np.asarray(bodies + extra @ np.array([effect.value for effect in effects]), dtype=np.float64)


def _state(arm: Arm, q: Floats, qd: Floats) -> State:
    """Rigid joints on a base that does not move."""
    return State(q, q, qd, qd, np.zeros((len(q), 3)) if arm.spatial else np.zeros(len(q)))


def _read(arm: Arm, angle: Floats, rng: np.random.Generator) -> Floats:
    """(n, N) angles in the steps of the encoders, which begin anywhere."""
    step = np.array([joint.over_the_wire.motor_encoder.quantum_rad for joint in arm.joints])
    size = np.where(step > 0.0, step, 1.0)
    begin = step * rng.uniform(size=arm.n)
    return np.where(step > 0.0, size * np.rint((angle + begin) / size) - begin, angle)
