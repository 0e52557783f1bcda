# SPDX-License-Identifier: MIT
"""How well a model predicts the torques of a run, joint by joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.ground.increments import increments
from zygos.ground.motion import Motion, TorqueRows, both_ways, cutoff_hz, torque_noise, torque_rows
from zygos.ground.rest import at_rest
from zygos.ground.rows import torque_columns
from zygos.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class JointScore:
    """Measured and predicted torque of one joint, after the gear, while it moves; `rest_nm` is apart."""

    joint: str
    measured_nm: float
    """Root mean square of the measured torque less its offset, Nm; NaN of a joint that only rests."""
    error_nm: float
    """Root mean square of the measured torque less the predicted one and the offset, Nm."""
    share: float
    """error_nm / measured_nm."""
    offset_nm: float
    """Mean of the measured less the predicted torque, which is taken as the offset of this run's torque, Nm."""
    raw_share: float
    """Error with the offset in it, as share of the measured torque with the offset in it."""
    energy_error_j: float
    """Root mean square, over windows of one second, of the work of error_nm, J."""
    energy_share: float
    """The same as share of the work that was measured."""
    sigmas: float
    """error_nm over floor_nm: the error in standard deviations of the noise of all sensors."""
    floor: float
    """Root mean square of the unfiltered measured torque less the prediction, in standard deviations of the torque's
    noise: 1 where only noise is left. NaN where increments are compared."""
    spring_nm: float = float("nan")
    """Root mean square of the torque at the link that neither spring nor bodies explain, Nm; NaN at a rigid joint."""
    floor_nm: float = float("nan")
    """What noise makes of error_nm, Nm: on the ground the error of the model on its own simulated twin, which noise,
    quanta and filters cause; of increments, their standard deviation by the noise of rates and torques."""
    rest_nm: float = float("nan")
    """Root mean square of the same error while the joint rests (`zygos.ground.rest`), where friction may be anything up
    to that of a joint that moves, Nm; NaN where it never rests, and where increments are compared."""
    rest_share: float = 0.0
    """Share of the time in which it rests."""

    @property
    def evaluated(self) -> bool:
        """Whether the joint moves, and its torque is large enough to say something of a model."""
        return not (math.isnan(self.measured_nm) or self.measured_nm < limits.EVALUATED.value * self.floor_nm)


@dataclass(frozen=True, eq=False, repr=False)
class Score:
    """The prediction of a run by a model; m instants, N joints."""

    run: Run
    model: str
    cutoff_hz: float | None
    """Of the filter of angles and torques; None where mean torques over increments are compared."""
    increment_s: float | None
    """Length of the increments; None where filtered torques are compared."""
    arm_energy_share: float
    """Root mean square of what the energy of the whole arm leaves of the work in one second, as share of that work."""
    joints: tuple[JointScore, ...]
    t: Floats
    """(m,) s."""
    measured: Floats
    """(m, N) torque after the gear less its offset, Nm."""
    predicted: Floats
    """(m, N) Nm."""
    resting: NDArray[np.bool_]
    """(m, N) where a joint rests."""
    arm_energy_error_j: float
    """Root mean square of what the energy of the whole arm leaves of the work in one second, J."""

    @property
    def share(self) -> float:
        """Root mean square of the shares of the joints that are evaluated; NaN where none is."""
        shares = [joint.share**2 for joint in self.joints if joint.evaluated]
        return float(np.sqrt(np.mean(shares))) if shares else float("nan")

    def as_dict(self, heading: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What `zygos predict --json` writes of a run."""
        return {
            **(heading or {}),
            "run": str(self.run.path) if self.run.path else None,
            "arm": self.run.arm.name,
            "unit": self.run.arm.unit("Nm"),
            "model": self.model,
            "cutoff_hz": self.cutoff_hz,
            "increment_s": self.increment_s,
            "arm_energy_share": self.arm_energy_share,
            "share": self.share,
            "joints": [{**asdict(joint), "evaluated": joint.evaluated} for joint in self.joints],
        }

    def __repr__(self) -> str:
        """A line for each joint."""
        unit = self.run.arm.unit("Nm")
        lines = [f"{one.joint:<16}{one.error_nm:>12.4g} {unit} {100 * one.share:>7.2f} %" for one in self.joints]
        return "\n".join(lines)


def score(run: Run, model: Model, *, cutoff: float | None = None) -> Score:
    """Compare the torques of a run with those that a model predicts from its motion.

    For an arm with a fixed base and rigid joints, angles and torques pass a filter without delay at `cutoff` Hz, by
    default that of the arm's smoother and at most 10 Hz; the accelerations are derivatives of the filtered angles. For
    another arm mean torques over short increments are compared, for which momenta are enough. Each torque's constant
    offset in this run is a nuisance: it is taken out of `share`, and `raw_share` has it.

    Errors: ZygosError where the model lacks a parameter of the arm, or the run is too short.
    """
    arm = run.arm
    lacking = [name for name in arm.parameter_names if name not in model.parameters] if not model.bodies else []
    if lacking:
        raise ZygosError(
            f"model {model.name} has no value of {', '.join(lacking)}, so that it predicts no torque; remedy: estimate "
            "it with --doubtful, or with --model for values that the runs do not determine"
        )
    if not arm.grounded:
        if cutoff is not None:
            raise ZygosError(
                f"--cutoff: arm {arm.name} floats or has flexible joints, so that mean torques over increments are "
                "compared; remedy: leave it out"
            )
        return _by_increments(run, model)
    motion = Motion.of(run)
    wanted = min(cutoff_hz(arm), limits.HIGHEST_CUTOFF_HZ.value) if cutoff is None else cutoff
    if not 0.0 < wanted < 0.5 / arm.period_s:
        raise ZygosError(
            f"a cut-off of {wanted:g} Hz is not below half the rate of the cycles, {0.5 / arm.period_s:g} Hz; remedy: "
            "a lower cut-off"
        )
    rows = torque_rows(arm, motion.samples, wanted)
    values = model.base_values(arm)
    found = scored(run, model.name, rows, values, model.effects, motion)
    from zygos.ground.twin import floor  # noqa: PLC0415  (a twin is scored as its run is)

    least = floor(motion, rows, values, model.effects)
    return with_floor(found, np.array([one.error_nm for one in least.joints]))


def with_floor(found: Score, floor_nm: Floats) -> Score:
    """The score beside the errors (N,) of the model on its own twin, Nm, which are the floor."""
    joints = zip(found.joints, floor_nm.tolist(), strict=True)
    return replace(
        found,
        joints=tuple(replace(one, floor_nm=least, sigmas=_ratio(one.error_nm, least)) for one, least in joints),
    )


def beside(found: Score, other: Score) -> Score:
    """The score with shares of what was measured less the offset of another model, by which both can be compared: each
    model has an offset of its own, and what is measured beside a large one is large."""

    def of(part: float, error: float, share: float) -> float:
        return _ratio(part, _ratio(error, share))

    joints = tuple(
        replace(
            one,
            measured_nm=two.measured_nm,
            share=_ratio(one.error_nm, two.measured_nm),
            energy_share=of(one.energy_error_j, two.energy_error_j, two.energy_share),
        )
        for one, two in zip(found.joints, other.joints, strict=True)
    )
    work = of(found.arm_energy_error_j, other.arm_energy_error_j, other.arm_energy_share)
    return replace(found, joints=joints, arm_energy_share=work)


def scored(run: Run, name: str, rows: TorqueRows, values: Floats, effects: Sequence[Effect], motion: Motion) -> Score:
    """The score of parameters in the order of the arm, and of effects, on torque rows."""
    predicted, sharp = (predict_torques(run.arm, rows, values, effects, filtered) for filtered in (True, False))
    return scored_torques(run, name, rows, predicted, sharp, motion)


def scored_torques(run: Run, name: str, rows: TorqueRows, predicted: Floats, sharp: Floats, motion: Motion) -> Score:
    """The score of torques (m, N) that were predicted on torque rows, Nm after the gear, whose friction has passed the
    filter of the rows. sharp: (m, N) the same with friction as it is."""
    arm, kept, h = run.arm, rows.kept, rows.period_s
    error = rows.tau - predicted
    resting = at_rest(rows.state.qd, rows.segment, h)
    moving = ~resting & kept[:, None]
    offset = np.array([_mean(error[moving[:, j] if moving[:, j].any() else kept, j]) for j in range(arm.n)])
    noise = torque_noise(motion) * arm.gear_ratios
    through = _noise_gain(rows)
    raw = _unfiltered(arm, motion, rows)
    window = max(2, round(limits.WORK_WINDOW_S.value / h))
    scores = []
    for j, joint in enumerate(arm.joints):
        of, still = moving[:, j], resting[:, j] & kept
        left, own = (error - offset)[of, j], (rows.tau - offset)[of, j]
        rate = rows.state.qd[kept, j]
        lost, done = (_work(x[kept, j] * rate, window, h) for x in (error - offset, rows.tau - offset))
        scores.append(
            JointScore(
                joint=joint.name,
                measured_nm=rms(own),
                error_nm=rms(left),
                share=_ratio(rms(left), rms(own)),
                offset_nm=float(offset[j]),
                raw_share=_ratio(rms(error[of, j]), rms(rows.tau[of, j])),
                energy_error_j=rms(lost),
                energy_share=_ratio(rms(lost), rms(done)),
                sigmas=_ratio(rms(left), noise[j] * through),
                floor=_ratio(rms((raw - sharp - offset)[of, j]), noise[j]),
                rest_nm=rms((error - offset)[still, j]),
                rest_share=float(np.mean(still[kept])),
            )
        )
    whole = ((rows.tau - offset) * rows.state.qd).sum(axis=1)[kept]
    all_lost = rms(_work(((error - offset) * rows.state.qd).sum(axis=1)[kept], window, h))
    return Score(
        run=run,
        model=name,
        cutoff_hz=rows.cutoff_hz,
        increment_s=None,
        arm_energy_share=_ratio(all_lost, rms(_work(whole, window, h))),
        joints=tuple(scores),
        t=np.asarray(np.flatnonzero(kept) * h, dtype=np.float64),
        measured=(rows.tau - offset)[kept],
        predicted=predicted[kept],
        resting=resting[kept],
        arm_energy_error_j=all_lost,
    )


def _by_increments(run: Run, model: Model) -> Score:
    """The score of an arm that floats or has flexible joints."""
    arm = run.arm
    own = increments(run, model.base_values(arm), model.effects, limits.WORK_WINDOW_S.value)
    offset = (own.measured - own.predicted).mean(axis=0)
    window = max(1, round(2.0 * limits.WORK_WINDOW_S.value / own.span_s))
    scores = []
    for j, joint in enumerate(arm.joints):
        measured = own.measured[:, j] - offset[j]
        left = measured - own.predicted[:, j]
        # neighbouring increments overlap by half
        lost, done = (_work(x * own.rate[:, j], window, 0.5 * own.span_s) for x in (left, measured))
        scores.append(
            JointScore(
                joint=joint.name,
                measured_nm=rms(measured),
                error_nm=rms(left),
                share=_ratio(rms(left), rms(measured)),
                offset_nm=float(offset[j]),
                raw_share=_ratio(rms(left + offset[j]), rms(own.measured[:, j])),
                energy_error_j=rms(lost),
                energy_share=_ratio(rms(lost), rms(done)),
                sigmas=_ratio(rms(left), float(own.noise[j])),
                floor=float("nan"),
                spring_nm=rms(own.spring[:, j]) if joint.flexible else float("nan"),
                floor_nm=float(own.noise[j]),
            )
        )
    return Score(
        run=run,
        model=model.name,
        cutoff_hz=None,
        increment_s=own.span_s,
        arm_energy_share=_ratio(rms(own.work_left), rms(own.work)) if len(own.work) else float("nan"),
        joints=tuple(scores),
        t=np.asarray(own.at * arm.period_s, dtype=np.float64),
        measured=own.measured - offset,
        predicted=own.predicted,
        resting=np.zeros(own.predicted.shape, dtype=np.bool_),
        arm_energy_error_j=rms(own.work_left),
    )


def predict_torques(
    arm: Arm, rows: TorqueRows, values: Floats, effects: Sequence[Effect], filtered: bool = True
) -> Floats:
    """(m, N) predicted torque after the gear, Nm: what a drive without offset would report. filtered: as of
    `torque_columns`."""
    bodies = np.asarray(rows.z @ values, dtype=np.float64)
    columns = torque_columns(arm, rows, effects, bodies, filtered)[..., len(values) :]
    extra = np.array([effect.value for effect in effects])
    return bodies + columns @ extra if len(extra) else bodies


def _unfiltered(arm: Arm, motion: Motion, rows: TorqueRows) -> Floats:
    """(m, N) the torque after the gear as it was reported at the instants of the rows."""
    out = []
    for number, (start, stop) in enumerate(motion.samples.segments):
        if number not in rows.segment:
            continue
        tau = motion.samples.tau[start:stop]
        good = np.flatnonzero(np.all(np.isfinite(tau), axis=1))
        out.append(motion.run.cycles.tau[start + good[0] : start + good[-1] + 1])
    return np.asarray(np.concatenate(out) * arm.gear_ratios, dtype=np.float64)


def _noise_gain(rows: TorqueRows) -> float:
    """What the filter leaves of the standard deviation of white noise."""
    pulse = np.zeros(4001)
    pulse[2000] = 1.0
    return float(np.linalg.norm(both_ways(rows.taps, pulse)))


def _work(power: Floats, window: int, h: float) -> Floats:
    """(windows,) integral of a power over windows."""
    whole = len(power) // window * window
    return np.asarray(power[:whole].reshape(-1, window).sum(axis=1) * h) if whole else np.array([power.sum() * h])


def rms(x: Floats) -> float:
    """Root mean square of all values; NaN where there is none."""
    return float(np.sqrt(_mean(x**2)))


def _mean(x: Floats) -> float:
    return float(np.mean(x)) if x.size else float("nan")


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else float("nan")
