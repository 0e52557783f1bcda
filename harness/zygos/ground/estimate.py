# SPDX-License-Identifier: MIT
"""An estimate on the ground: an arm with a fixed base and rigid joints, learned from one or several runs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm, Smoother
from zygos.can.run import Run
from zygos.effects import CATALOGUE, Effect
from zygos.errors import Undecided, ZygosError
from zygos.ground.motion import Motion, cutoff_hz, torque_noise
from zygos.ground.rows import RunRows, columns_of, friction, run_rows
from zygos.ground.score import Score, rms, score
from zygos.ground.solution import Solution, solve
from zygos.ground.sums import MOST_BLOCKS, Sums, sums_of
from zygos.ground.twin import predicted_load
from zygos.model.correlation import Correlation
from zygos.model.model import Model, Quantity
from zygos.quantiles import student_factor
from zygos.report.values import Valued

Floats = NDArray[np.float64]

SPANS_S = (0.1, 0.2, 0.3, 0.5)
"""Lengths of increments from which one is chosen, s: the shortest at which the angles' noise is small."""
DEFAULT_FRICTION = ("motor_coulomb", "motor_viscous")
"""Effects at every joint that are estimated unless others are asked for."""
_GRAVITY = 9.81
"""m/s^2."""
_LOAD_ROUNDS = 3
_TOTAL_BLOCKS = 40


@dataclass(frozen=True)
class Elsewhere:
    """A direction of gravity that the arm file does not have."""

    gravity: tuple[float, float, float]
    """m/s^2, in the frame of the base."""
    share: float
    """Root mean square over the joints of what is left of their held-out torques with it."""


@dataclass(frozen=True, eq=False, repr=False)
class GroundEstimate(Valued):
    """What joint rows say of an arm: p parameters, those of the arm first, then the effects; N joints, R runs."""

    arm: Arm
    runs: tuple[Run, ...]
    effects: tuple[Effect, ...]
    """Those that were estimated, without their values."""
    span_s: float
    """Length of the increments, s."""
    solution: Solution
    increments: int
    noise_share: float
    """Share of the squared residuals that the declared noise of the angles causes."""
    excess: Floats
    """(N,) residuals in units of what the noise of torques and angles causes."""
    without_run: Floats
    """(R, p) the values without each of the runs; empty for a single run."""
    across: Floats
    """(R, R) share of the impulse of each run (second) that the values of one run alone (first) leave. NaN where that
    run determines too little; empty for a single run."""
    smoothing: Floats
    """(2, p) the values with a cut-off of the smoother 0.7 and 1.4 times as high; NaN where there is none."""
    validated: tuple[Score, ...] = ()
    doubtful: bool = False
    """Whether values are given that the runs do not determine."""
    prior: Model | None = None
    elsewhere: Elsewhere | None = None
    """Another direction of gravity, with which much less is left."""

    @property
    def names(self) -> tuple[str, ...]:
        """(p,)"""
        return columns_of(self.arm, self.effects)

    @property
    def units(self) -> tuple[str, ...]:
        """(p,)"""
        return (*self.arm.parameter_units, *(self.arm.unit(effect.kind.unit) for effect in self.effects))

    @property
    def determined(self) -> NDArray[np.bool_]:
        """(p,) whether the 95 % interval is narrower than the size of the parameter.

        The size of a parameter of a body is the largest value in the same unit of the same body. Effects may be zero,
        and count as determined where the motion shows them.
        """
        own = np.arange(len(self.names)) < len(self.arm.parameter_names)
        narrow = self._half(limits.CONFIDENCE.value) <= sizes(self.names, self.units, self.solution.value)
        return np.asarray(self.solution.seen & (narrow | ~own), dtype=np.bool_)

    @property
    def value(self) -> Floats:
        """(p,) NaN for what the runs do not determine, unless `doubtful`."""
        shown = self.solution.seen if self.doubtful else self.determined
        return np.where(shown, self.solution.value, np.nan)

    @property
    def _sigma(self) -> Floats:
        """(p,) standard deviations from the scatter over blocks of time.

        From three runs on they are at least those from leaving out a run. Where the residuals are not noise, half of
        what another cut-off of the smoother changes is added, because what the rows lack differs from one to another.
        """
        sigma = self.solution.sigma
        if len(self.without_run) > 2:
            sigma = np.maximum(sigma, self.spread)
        if self.excess.max() > limits.EXCESS_OF_NOISE.value:
            moved = np.nan_to_num(np.abs(self.smoothing - self.solution.value)).max(axis=0)
            sigma = np.hypot(sigma, 0.5 * moved)
        return np.asarray(sigma, dtype=np.float64)

    def _half(self, confidence: float) -> Floats:
        return np.asarray(student_factor(confidence, self.solution.freedom) * self._sigma, dtype=np.float64)

    @property
    def sigma(self) -> Floats:
        """(p,) standard deviations; NaN as `value`."""
        return np.where(np.isfinite(self.value), self._sigma, np.nan)

    @property
    def half95(self) -> Floats:
        """(p,) half widths of the 95 % intervals; NaN as `value`."""
        return np.where(np.isfinite(self.value), self._half(limits.CONFIDENCE.value), np.nan)

    @property
    def spread(self) -> Floats:
        """(p,) standard deviation of the values from leaving out one run at a time; NaN for a single run."""
        runs = len(self.without_run)
        if runs < 2:
            return np.full(len(self.names), np.nan)
        far = self.without_run - self.without_run.mean(axis=0)
        return np.asarray(np.sqrt((runs - 1) / runs * np.sum(far**2, axis=0)), dtype=np.float64)

    @property
    def relative(self) -> bool:
        """Whether torques are known up to a factor only, so that only ratios of values are."""
        return self.arm.torque_unit == "A"

    @property
    def torque_sigma(self) -> Floats:
        """(N,) standard deviation of one torque reading that the residuals show, before the gear where torques are
        reported there, Nm."""
        steps = self.span_s / self.arm.period_s
        return np.asarray(self.solution.sigma_w / (self.arm.period_s * np.sqrt(steps) * self.arm.gear_ratios))

    @property
    def evaluated(self) -> NDArray[np.bool_]:
        """(N,) whether the torque of a joint is large enough beside its noise for shares of it to say something; all
        where none is."""
        squares = (np.mean(part**2, axis=0) for part in (self.solution.measured, self.solution.residual))
        measured, residual = (np.sqrt(square) for square in squares)
        few = measured * self.excess < limits.EVALUATED.value * residual
        return np.asarray(~few if not few.all() else np.ones_like(few), dtype=np.bool_)

    @property
    def validity(self) -> str:
        """One of "valid", "partial", "doubtful" and "refused"."""
        return self._verdict[0]

    @property
    def reason(self) -> str:
        """Why it is not valid, with the number that was measured; empty where it is valid."""
        return self._verdict[1]

    @property
    def remedy(self) -> str:
        """What to do about it; empty where it is valid."""
        return self._verdict[2]

    @property
    def _verdict(self) -> tuple[str, str, str]:
        seen, joints = self.evaluated, self.arm.joints
        share = np.where(seen, self.solution.share, 0.0)
        worst = int(np.argmax(share))
        if self.elsewhere is not None:
            return (
                "doubtful",
                f"gravity in the arm file seems wrong: {100 * rms(share[seen]):.2g} % of the held-out torques are "
                f"left, and {100 * self.elsewhere.share:.2g} % with gravity = {list(self.elsewhere.gravity)}",
                "correct gravity in the arm file; it belongs to the frame of the base",
            )
        if share[seen].min() >= 1.0:
            return (
                "refused",
                f"the model predicts held-out torques worse than none would: {100 * share[worst]:.0f} % are left at "
                f"{joints[worst].name}",
                "check units, signs, delays, zeros and gear ratios with `zygos check-arm`",
            )
        negative = self._impossible()
        if negative:
            return (
                "doubtful",
                f"not physical: {negative}",
                "check the arm file with `zygos check-arm`, or estimate another law with --friction",
            )
        if share[worst] > limits.DOUBTFUL.value:
            return (
                "doubtful",
                f"{100 * share[worst]:.0f} % of the held-out torque at {joints[worst].name} are not predicted",
                "check the arm file with `zygos check-arm`, or lower the cut-off of the smoother",
            )
        loud, far = int(np.argmax(self.solution.cluster)), int(np.argmax(self.excess))
        close = self.excess[far] <= limits.EXCESS_OF_NOISE.value and (
            self.solution.cluster[loud] <= limits.CLUSTER.value
        )
        strange = "" if close else self._strange_gain()
        if strange:
            return (
                "doubtful",
                f"{strange} is more than a torque sensor is off, and something is left of the torques: what the model "
                "lacks looks like a gain",
                "name the friction of the joints, too (--friction), or correct the scale of that torque in the arm "
                "file or the map",
            )
        texts, remedies = [], []
        unsure = [name for name, good in zip(self.names, self.determined, strict=True) if not good]
        if unsure:
            listed = ", ".join(unsure[:6]) + (", …" if len(unsure) > 6 else "")
            texts.append(f"the motion does not determine {len(unsure)} of {len(self.names)} parameters ({listed})")
            remedies.append("a motion that excites them (`zygos plan`)")
        if self.excess[far] > limits.EXCESS_OF_NOISE.value:
            texts.append(
                f"what is left is not noise: {100 * share[far]:.1f} % of the torque at {joints[far].name}, "
                f"{self.excess[far]:.1f} times the noise of its readings"
            )
        elif not close:
            texts.append(
                f"what is left is not noise: at {joints[loud].name} squared sums of residuals are "
                f"{self.solution.cluster[loud]:.0f} times those of noise ({100 * share[loud]:.1f} % of the torque)"
            )
        if not close:
            remedies.append(
                "`zygos check-arm`, which finds delays and wrong scales; else another law of friction (--friction), or "
                "the lengths of the arm file; the intervals contain what is left, if runs are alike"
            )
        return ("partial", "; ".join(texts), "; ".join(remedies)) if texts else ("valid", "", "")

    def _strange_gain(self) -> str:
        """The gain of a torque sensor that its prior holds for out of the question; empty where there is none. A motor
        current has no gain that one could know."""
        if self.arm.torque_unit == "A":
            return ""
        most = limits.STRANGE_GAIN.value * limits.GAIN_PRIOR.value
        p = len(self.arm.parameter_names)
        for effect, name, value in zip(self.effects, self.names[p:], self.solution.value[p:], strict=True):
            if effect.kind.gain and abs(value) > most:
                return f"{name} = {value:.2g}"
        return ""

    def _impossible(self) -> str:
        """A value that is negative by more than three of its deviations, but cannot be; empty where there is none."""
        positive = [
            *(
                one.symbol == "Im" or (one.symbol in ("N", "a") and one.ends[0] == one.ends[1])
                for one in self.arm.parameters
            ),
            *(effect.kind.positive for effect in self.effects),
        ]
        for name, value, half, must, good in zip(
            self.names,
            self.solution.value,
            self._half(limits.SURE_CONFIDENCE.value),
            positive,
            self.determined,
            strict=True,
        ):
            if must and good and value < -half:
                return f"{name} is {value:.3g}, negative beyond its interval of {half:.2g}"
        return ""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know beside the values, in sentences."""
        said = []
        if self.relative:
            said.append(
                "the torques are motor currents with unknown torque constants: values are relative to that of joint "
                f"{self.arm.joints[0].name}"
            )
        with np.errstate(invalid="ignore", divide="ignore"):
            moved = np.abs(self.smoothing - self.solution.value) / self.solution.half(limits.CONFIDENCE.value)
        moved = np.where(self.determined, moved, np.nan)
        if np.isfinite(moved).any() and np.nanmax(moved) > limits.CUTOFF_MOVES.value:
            worst = int(np.unravel_index(np.nanargmax(moved), moved.shape)[1])
            said.append(
                f"the values depend on the smoother's cut-off of {cutoff_hz(self.arm):.1f} Hz: between 0.7 and 1.4 "
                f"times it {self.names[worst]} moves by {np.nanmax(moved):.1f} half widths of its interval; if the arm "
                "is not rigid up to there, lower cutoff_hz"
            )
        return tuple(said)

    def to_model(self) -> Model:
        """The model with what was learned; what the runs do not determine comes from the model that was given. What
        cannot be negative is 0 where its estimate is, by its noise. Errors: Undecided where the estimate is refused."""
        if self.validity == "refused":
            raise Undecided(f"refused: {self.reason}; remedy: {self.remedy}")
        found = {
            name: Quantity(float(value), float(sigma), "zygos", unit)
            for name, unit, value, sigma in zip(self.names, self.units, self.value, self.sigma, strict=True)
            if np.isfinite(value)
        }
        known = (self.prior.base_parameters(self.arm) if self.prior is not None else {}) | found
        quantities = {name: known[name] for name in self.arm.parameter_names if name in known}
        effects = []
        for effect in self.effects:
            one = found.get(effect.column(self.arm))
            if one is not None:
                value = max(one.value, 0.0) if effect.kind.positive else one.value
                effects.append(replace(effect, value=value, sigma=one.sigma, source="zygos"))
        seen = np.flatnonzero([name in found for name in self.names])
        correlation = Correlation.of([self.names[k] for k in seen], self.solution.covariance[np.ix_(seen, seen)])
        return Model(name=self.arm.name, parameters=quantities, effects=tuple(effects), correlation=correlation)

    def as_dict(self, heading: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What `zygos estimate --json` writes of an estimate on the ground."""
        s = self.solution
        return {
            **(heading or {}),
            "arm": self.arm.name,
            "estimator": "ground",
            "validity": self.validity,
            "reason": self.reason or None,
            "remedy": self.remedy or None,
            "notes": self.notes,
            "relative": self.relative,
            "runs": [str(run.path) if run.path else None for run in self.runs],
            "increment_s": self.span_s,
            "increments": self.increments,
            "cutoff_hz": cutoff_hz(self.arm),
            "noise_share": self.noise_share,
            "joints": [
                {
                    "joint": joint.name,
                    "held_out_share": float(s.share[j]),
                    "evaluated": bool(self.evaluated[j]),
                    "residual_share": float(np.sqrt(np.mean(s.residual[:, j] ** 2) / np.mean(s.measured[:, j] ** 2))),
                    "torque_sigma_nm": float(self.torque_sigma[j]),
                    "noise_ratio": float(self.excess[j]),
                    "cluster": float(s.cluster[j]),
                    "offset_nm": s.offset[:, j].tolist(),
                }
                for j, joint in enumerate(self.arm.joints)
            ],
            "parameters": [
                {
                    "name": name,
                    "unit": unit,
                    "value": float(value),
                    "sigma": float(sigma),
                    "half95": float(half),
                    "freedom": float(freedom),
                    "determined": bool(good),
                    "spread": float(spread),
                }
                for name, unit, value, sigma, half, freedom, good, spread in zip(
                    self.names,
                    self.units,
                    self.value,
                    self.sigma,
                    self.half95,
                    s.freedom,
                    self.determined,
                    self.spread,
                    strict=True,
                )
            ],
            "covariance": s.covariance.tolist(),
            "across": self.across.tolist(),
            "validated": [one.as_dict() for one in self.validated],
        }

    def __repr__(self) -> str:
        """Validity, and a line for each parameter."""
        lines = [f"{self.validity}{f': {self.reason}' if self.reason else ''}"]
        for name, unit, value, half in zip(self.names, self.units, self.value, self.half95, strict=True):
            lines.append(f"{name:<18}{value:>14.7g} ± {half:<10.2g} {unit}")
        return "\n".join(lines)


def sizes(names: Sequence[str], units: Sequence[str], values: Floats) -> Floats:
    """(p,) the largest value in the same unit of the same body; the body of a parameter is the highest number in its
    name. The inertia of a rotor has its own size, because it is before the gear."""
    keys = [
        ("rotor" if name.startswith("Im") else unit, max(map(int, re.findall(r"\d+", name)), default=0))
        for name, unit in zip(names, units, strict=True)
    ]
    largest: dict[tuple[str, int], float] = {}
    for key, value in zip(keys, values, strict=True):
        largest[key] = max(largest.get(key, 0.0), abs(float(value)))
    return np.array([largest[key] for key in keys])


def estimate_ground(
    runs: Sequence[Run],
    *,
    model: Model | None = None,
    effects: Sequence[Effect] | None = None,
    validate: Sequence[Run] = (),
    doubtful: bool = False,
    progress: Callable[[float], None] | None = None,
) -> GroundEstimate:
    """Learn an arm with a fixed base and rigid joints from one or several runs, by least squares of joint rows.

    Shared by all runs: the arm's parameters and the effects; by default Coulomb and viscous friction at every motor, or
    those of the model. A constant offset of each torque belongs to a run. validate: runs that are only predicted.
    doubtful: give values that the runs do not determine, too.

    An estimate that is not valid is no error: see `GroundEstimate.validity`, `reason` and `remedy`.

    Errors: ZygosError for an arm with a free base or a flexible joint, runs of different arms, or a run that is too
    short. Undecided where there are fewer rows than unknowns.
    """
    arm = runs[0].arm
    for run in (*runs, *validate):
        if run.arm.parameter_names != arm.parameter_names or run.arm.gear_ratios.tolist() != arm.gear_ratios.tolist():
            raise ZygosError(
                f"{run.path or 'a run'}: it is of another arm ({run.arm.name}) than the first run ({arm.name}); "
                "remedy: give runs of one arm"
            )
    wanted = tuple(effects) if effects is not None else _default_effects(arm, model)
    told = progress or (lambda share: None)
    motions = [Motion.of(run) for run in runs]
    span, sums, solution = at_best_span(arm, motions, wanted)
    told(0.4)
    without: list[Floats] = []
    if len(runs) > 1:
        without = [solve([*sums[:k], *sums[k + 1 :]], solution.sigma_w).value for k in range(len(sums))]
    told(0.6)
    smoothing = _with_other_cutoffs(arm, runs, motions, wanted, span, len(solution.value))
    told(0.9)
    found = GroundEstimate(
        arm=arm,
        runs=tuple(runs),
        effects=wanted,
        span_s=span,
        solution=solution,
        increments=int(sum(one.count.sum(axis=0).max() for one in sums)),
        noise_share=_noise_share(sums, solution),
        excess=_excess(arm, motions, sums, solution, span),
        without_run=np.array(without),
        across=_across(sums, solution) if len(runs) > 1 else np.zeros((0, 0)),
        smoothing=smoothing,
        doubtful=doubtful,
        prior=model,
    )
    if found.excess.max() > limits.EXCESS_OF_NOISE.value:
        found = replace(found, elsewhere=_gravity_elsewhere(arm, runs, wanted, span, solution))
    if validate and found.validity != "refused":
        whole = replace(found, doubtful=True).to_model()
        found = replace(found, validated=tuple(score(run, complete(whole, arm)) for run in validate))
    told(1.0)
    return found


def _gravity_elsewhere(
    arm: Arm, runs: Sequence[Run], effects: Sequence[Effect], span: float, found: Solution
) -> Elsewhere | None:
    """Gravity along another axis of the base, or along none, if it leaves less than a third of what is left. Shares are
    of what was measured less the offset that was found: another gravity has another offset."""
    left = rms(found.share)
    size = float(np.linalg.norm(arm.gravity)) or _GRAVITY
    best: Elsewhere | None = None
    for axis in ((0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, 0, 0)):
        gravity = (size * axis[0], size * axis[1], size * axis[2])
        if np.allclose(gravity, arm.gravity, atol=1e-3 * size):
            continue
        try:
            motions = [Motion.of(run, replace(run.arm, gravity=gravity)) for run in runs]
            _, solution, _ = _solved(motions, span, effects)
        except ZygosError:
            continue
        share = rms(replace(solution, measured=found.measured).share)
        if share < min(left / 3.0, best.share if best is not None else 1.0):
            best = Elsewhere(gravity, share)
    return best


def complete(model: Model, arm: Arm) -> Model:
    """The model with zeros for parameters that no motion of the runs moved."""
    missing = {name: Quantity(0.0) for name in arm.parameter_names if name not in model.parameters}
    return replace(model, parameters={**model.parameters, **missing})


def _default_effects(arm: Arm, model: Model | None) -> tuple[Effect, ...]:
    """The effects of the model; without one, friction at every motor; where torques are currents, also the gains."""
    given = model.effects if model is not None else ()
    if not given:
        given = friction(arm, [CATALOGUE[key] for key in DEFAULT_FRICTION])
    if arm.torque_unit == "A" and not any(effect.kind.key == "torque_gain" for effect in given):
        given = (*given, *friction(arm, [CATALOGUE["torque_gain"]])[1:])
    return given


def at_best_span(arm: Arm, motions: Sequence[Motion], effects: Sequence[Effect]) -> tuple[float, list[Sums], Solution]:
    """The shortest increments at which the declared noise of the angles is a small part of the residuals; those of the
    arm file, if it says."""
    spans = (arm.joint_increment_s,) if arm.joint_increment_s else SPANS_S
    for last, span in enumerate(spans, 1):
        sums, solution, rows = _solved(motions, span, effects)
        if last == len(spans) or _noise_share(sums, solution) <= limits.ANGLE_NOISE.value:
            break
    return rows[0].span_s, sums, solution


def _solved(
    motions: Sequence[Motion], span: float, effects: Sequence[Effect]
) -> tuple[list[Sums], Solution, list[RunRows]]:
    """Sums and solution; friction with the load is found in rounds, with the torque that the round before predicts."""
    solution: Solution | None = None
    for _ in range(load_rounds(effects)):
        values = solution.value if solution is not None else None
        rows = [run_rows(motion, span, effects, predicted_torque(motion, values)) for motion in motions]
        sums = [sums_of(run, max(4, min(MOST_BLOCKS, _TOTAL_BLOCKS // len(motions)))) for run in rows]
        solution = solve(sums, solution.sigma_w if solution is not None else None)
    assert solution is not None
    return sums, solution, rows


def load_rounds(effects: Sequence[Effect]) -> int:
    """How often an estimate is repeated with the torque that the one before predicts: for friction with the load."""
    return _LOAD_ROUNDS if any(effect.kind.place == "load" for effect in effects) else 1


def predicted_torque(motion: Motion, values: Floats | None) -> Floats | None:
    """As `predicted_load`; None without values: nothing is predicted yet."""
    return None if values is None else predicted_load(motion, values)


def _noise_share(sums: Sequence[Sums], solution: Solution) -> float:
    """Share of the squared residuals that the declared noise of the angles causes, over all joints by their weight."""
    caused = _by_angles(sums, solution)
    return float(np.nanmean(caused / (_rows(sums) * solution.sigma_w**2)))


def _rows(sums: Sequence[Sums]) -> Floats:
    """(N,) number of rows of each joint, at least 1."""
    return np.asarray(np.maximum(np.sum([one.count.sum(axis=0) for one in sums], axis=0), 1), dtype=np.float64)


def _by_angles(sums: Sequence[Sums], solution: Solution) -> Floats:
    """(N,) squared residuals of the torque as it is reported that the declared noise of the angles causes."""
    noise = np.sum([one.noise.sum(axis=0) for one in sums], axis=0)
    moved = np.array([[bool(one[k, :-1].any() and not one[k, -1]) for k in range(len(one) - 2)] for one in noise])
    value = np.where(moved, solution.value, 0.0)
    squares = np.einsum("jp,jpq,jq->j", value, noise[:, :-2, :-2], value)
    return np.asarray(squares / _gained(sums[0], solution.value) ** 2, dtype=np.float64)


def _gained(sums: Sums, value: Floats) -> Floats:
    """(N,) 1 + g of the gain of each torque sensor."""
    out = np.ones(sums.gram.shape[1])
    for joint, column in sums.gains:
        out[joint] += value[column]
    return out


def _with_other_cutoffs(
    arm: Arm, runs: Sequence[Run], motions: Sequence[Motion], effects: Sequence[Effect], span: float, p: int
) -> Floats:
    """(2, p) the values with windows of the smoother that are longer and shorter."""
    out = []
    own = motions[0].arm.smoother
    for factor in (1.0 / factor for factor in limits.OTHER_CUTOFFS.value):
        half = max(own.order // 2 + 1, round(factor * (own.points // 2)))
        other = replace(arm, smoother=Smoother(2 * half + 1, own.order, half))
        try:
            out.append(_solved([Motion.of(run, other) for run in runs], span, effects)[1].value)
        except (ZygosError, Undecided):
            out.append(np.full(p, np.nan))
    return np.array(out)


def _across(sums: Sequence[Sums], solution: Solution) -> Floats:
    """(R, R) what the values of each run alone leave of the impulse of every run less its offset in the estimate from
    all, by the weight of the joints."""
    table = np.full((len(sums), len(sums)), np.nan)
    for a, own in enumerate(sums):
        try:
            alone = solve([own])
        except Undecided:
            continue
        for b, other in enumerate(sums):
            whole = solution.measured[b] ** 2 * np.maximum(other.count.sum(axis=0), 1)
            table[a, b] = float(np.sqrt(np.mean(_left(other, alone.value) / np.maximum(whole, 1e-300))))
    return table


def _left(sums: Sums, value: Floats) -> Floats:
    """(N,) squared residuals of a run with its own offset, of the torque as it is reported."""
    gram, x = sums.gram.sum(axis=0) + sums.noise.sum(axis=0), np.append(value, 0.0)
    left = np.zeros(len(gram))
    for j, own in enumerate(gram):
        x[-1] = (own[-2, -1] - own[-2, :-2] @ value) / own[-2, -2]
        full = np.append(-x, 1.0)
        left[j] = full @ own @ full
    return np.asarray(left / _gained(sums, value) ** 2, dtype=np.float64)


def _excess(arm: Arm, motions: Sequence[Motion], sums: Sequence[Sums], solution: Solution, span: float) -> Floats:
    """(N,) standard deviation of the residuals of an increment, in units of what noise causes."""
    steps = span / arm.period_s
    # a deviation that is declared too small is no reason to look for another law
    reading = np.array([np.maximum(torque_noise(motion), torque_noise(motion, False)) for motion in motions])
    of_torque = arm.gear_ratios**2 * np.mean(reading**2, axis=0) * arm.period_s**2 * steps
    return np.asarray(
        solution.sigma_w / np.sqrt(of_torque + _by_angles(sums, solution) / _rows(sums)), dtype=np.float64
    )
