# SPDX-License-Identifier: MIT
"""What the last body of an arm took on since a model was made: mass, first moments and inertia of a payload."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm, Parameter
from zygos.can.run import Run
from zygos.errors import Undecided, ZygosError
from zygos.ground.estimate import SPANS_S, load_rounds, predicted_torque, sizes
from zygos.ground.motion import Motion
from zygos.ground.rows import run_rows
from zygos.ground.solution import Solution, solve
from zygos.ground.sums import MOST_BLOCKS, Sums, sums_of
from zygos.model.correlation import Correlation
from zygos.model.model import Model, Quantity
from zygos.quantiles import student_isf
from zygos.structure import STANDARD, independent

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Payload:
    """The change of the last body's inertial parameters, about the origin of its joint's frame and in its axes."""

    arm: Arm
    runs: tuple[Run, ...]
    since: Model
    parameters: tuple[Parameter, ...]
    """The r that the motion can tell from each other; others of the ten have the same effect as some of these."""
    groups: tuple[str, ...]
    """(r,) what each stands for."""
    solution: Solution
    before: Floats
    """(N,) share of the torque that the model leaves without the payload."""
    after: Floats
    """(N,) held-out share of the torque that is left with the payload."""
    base: Floats
    """(p, r) change of the arm's base parameters per unit of each."""
    scatter: Floats
    """(r, r) covariance by the scatter between blocks of the runs alone."""
    slope: Floats
    """(r, p + e) change of each value per unit of an error of the model's base parameters and effects."""
    span_s: float
    lacking: tuple[str, ...] = ()
    """Base parameters that the model does not have: they are taken as 0, with a deviation of their size."""

    @property
    def names(self) -> tuple[str, ...]:
        """(r,) such as m6, mx6, Ixx6."""
        return tuple(one.name for one in self.parameters)

    @property
    def value(self) -> Floats:
        """(r,) kg, kg m and kg m^2."""
        return self.solution.value

    @property
    def sigma(self) -> Floats:
        """(r,) standard deviations, with that of the scale of all torques where the arm file declares it."""
        return np.hypot(self.solution.sigma, self.arm.torque_scale_sigma * np.abs(self.value))

    @property
    def half95(self) -> Floats:
        """(r,) half widths of the 95 % intervals."""
        scale = limits.INTERVAL_Z.value * self.arm.torque_scale_sigma * np.abs(self.value)
        return np.hypot(self.solution.half(limits.CONFIDENCE.value), scale)

    @property
    def found(self) -> bool:
        """Whether the arm carries more or less than in the model: some value differs from 0 beyond chance."""
        limit = float(student_isf(0.00135 / len(self.names), max(2.0, float(self.solution.freedom.min()))))
        return bool(np.any(np.abs(self.value) > limit * self.solution.sigma))

    @property
    def rests_on(self) -> str:
        """What the values take for granted, in words."""
        scale = self.arm.torque_scale_sigma
        said = (
            f"the interval contains an error of {100 * scale:.2g} % that all torques have in common "
            "(torque_scale_sigma)"
            if scale
            else "the values are in proportion to the scale of the torques, of which nothing is declared "
            "(torque_scale_sigma in the arm file)"
        )
        if self.lacking:
            said += (
                f"; the model has no value of {', '.join(self.lacking)}: 0 is assumed, with a deviation of their size"
            )
        return said

    @property
    def relative(self) -> bool:
        """Whether torques are currents, so that the values are relative to the model's."""
        return self.arm.torque_unit == "A"

    def to_model(self) -> Model:
        """The model with the payload in its base parameters."""
        own, before = self.since.base_parameters(self.arm), self.since.covariance(self.arm)
        change = np.zeros((len(before), len(self.names)))
        change[: len(self.base)] = self.base
        # what the payload takes back of an error of the model is an error of the sum no more
        carried = np.eye(len(before)) + change @ self.slope
        covariance = carried @ before @ carried.T + change @ self.scatter @ change.T
        sigma = np.sqrt(np.diag(covariance))
        quantities = {
            name: Quantity(one.value + float(more), float(wide), "zygos", one.unit)
            for (name, one), more, wide in zip(own.items(), self.base @ self.value, sigma[: len(own)], strict=True)
            if name not in self.lacking
        }
        effects = self.since.effects
        names = [*own, *(effect.column(self.arm) for effect in effects)]
        kept = [k for k, name in enumerate(names) if name not in self.lacking]
        return Model(
            name=self.since.name,
            parameters=quantities,
            effects=effects,
            correlation=Correlation.of([names[k] for k in kept], covariance[np.ix_(kept, kept)]),
        )

    def as_dict(self, heading: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What `zygos estimate --since --json` writes."""
        return {
            **(heading or {}),
            "arm": self.arm.name,
            "estimator": "payload",
            "found": self.found,
            "relative": self.relative,
            "rests_on": self.rests_on,
            "lacking": list(self.lacking),
            "runs": [str(run.path) if run.path else None for run in self.runs],
            "increment_s": self.span_s,
            "parameters": [
                {
                    "name": one.name,
                    "unit": self.arm.unit(one.unit),
                    "value": float(value),
                    "sigma": float(sigma),
                    "half95": float(half),
                    "stands_for": group,
                }
                for one, value, sigma, half, group in zip(
                    self.parameters, self.value, self.sigma, self.half95, self.groups, strict=True
                )
            ],
            "joints": [
                {"joint": joint.name, "share_before": float(before), "held_out_share": float(after)}
                for joint, before, after in zip(self.arm.joints, self.before, self.after, strict=True)
            ],
        }


def payload(runs: Sequence[Run], since: Model) -> Payload:
    """Estimate what the last body took on or lost since a model was made, from runs with it.

    Everything else is taken from the model, but for a constant offset of each torque in each run, and the uncertainty
    of the model's values is part of that of the payload. The reference point is the origin of the last joint's frame.

    Errors: ZygosError where the lengths of the arm are not known, or the model does not fit it.
    """
    arm = runs[0].arm
    since, lacking = _completed(since, arm)
    structure = arm.structure
    if structure.candidates_are_full:
        raise ZygosError(
            f"arm {arm.name}: without the lengths between its joints a payload has no mass of its own; remedy: write "
            "position_m into every [[joint]] of the arm file"
        )
    motions = [Motion.of(run) for run in runs]
    # what lies along the axis, and turns with it only, comes last: gravity shows the rest better
    own = [k for k, one in enumerate(structure.candidates) if one.symbol in STANDARD and one.ends == (str(arm.n),)]
    kept = independent(structure.groups, own)
    base = structure.groups[:, kept]
    groups = tuple(_group(structure.groups, kept, k, own, structure.candidates) for k in kept)
    values = np.concatenate([since.base_values(arm), [effect.value for effect in since.effects]])
    span = arm.joint_increment_s or SPANS_S[1]
    rounds = load_rounds(since.effects)
    now, solution = values[: len(base)], None
    for _ in range(rounds):
        asked = now if rounds > 1 else None  # only friction with the load needs what the model predicts
        rows = [run_rows(motion, span, since.effects, predicted_torque(motion, asked)) for motion in motions]
        sums = [sums_of(run, max(4, MOST_BLOCKS // len(motions))) for run in rows]
        changed = [_changed(one, values, base) for one in sums]
        solution = solve(changed)
        now = values[: len(base)] + base @ solution.value
    assert solution is not None
    slope = _slope(sums, base, solution.sigma_w)
    scatter = solution.covariance
    whole = np.maximum(_beside_offset(sums), 1e-300)
    counts = np.stack([one.count.sum(axis=0) for one in sums])
    return Payload(
        arm=arm,
        runs=tuple(runs),
        since=since,
        parameters=tuple(structure.candidates[k] for k in kept),
        groups=groups,
        solution=replace(solution, covariance=scatter + slope @ since.covariance(arm) @ slope.T),
        before=np.sqrt(_beside_offset(changed) / whole),
        after=np.sqrt((solution.held_out**2 * counts).sum(axis=0) / whole),
        base=base,
        scatter=scatter,
        slope=slope,
        span_s=span,
        lacking=lacking,
    )


def _completed(model: Model, arm: Arm) -> tuple[Model, tuple[str, ...]]:
    """The model with 0 for the base parameters that it lacks, each with a deviation of the largest value in the same
    unit of the same body, or of the arm; and their names."""
    names, units = arm.parameter_names, arm.parameter_units
    lacking = () if model.bodies else tuple(name for name in names if name not in model.parameters)
    if not lacking or len(lacking) == len(names):
        return model, ()
    values = np.array([model.parameters[name].value if name not in lacking else 0.0 for name in names])
    of_arm = {unit: max(abs(x) for x, own in zip(values, units, strict=True) if own == unit) for unit in units}
    known = dict(model.parameters)
    for name, unit, size in zip(names, units, sizes(names, units, values).tolist(), strict=True):
        if name in lacking:
            known[name] = Quantity(0.0, size or of_arm[unit], unit=unit)
    return replace(model, parameters={name: known[name] for name in [*names, *(set(known) - set(names))]}), lacking


def _slope(sums: Sequence[Sums], base: Floats, sigma: Floats) -> Floats:
    """(r, p + e) change of the solution per unit of the model's parameters and effects, whose columns they multiply.
    sigma: (N,) weights of the joints."""
    size = sums[0].gram.shape[-1] - 2
    normal = np.zeros((size, size))
    for one in sums:
        gram = one.gram.sum(axis=0)
        for joint, own in enumerate(gram):
            offset = np.outer(own[:size, -2], own[-2, :size]) / max(float(own[-2, -2]), 1e-300)
            normal += (own[:size, :size] - offset) / sigma[joint] ** 2
    change = np.zeros((size, base.shape[1]))
    change[: len(base)] = base
    return np.asarray(-np.linalg.solve(change.T @ normal @ change, change.T @ normal), dtype=np.float64)


def _changed(sums: Sums, values: Floats, base: Floats) -> Sums:
    """The sums with the columns of the payload in place of those of the arm, and what the model leaves in place of the
    impulse."""
    p, extra = len(base), len(values) - len(base)
    turn = np.zeros((p + extra + 2, base.shape[1] + 2))
    turn[:p, : base.shape[1]] = base
    turn[-2, -2] = 1.0
    turn[-1, -1] = 1.0
    turn[: p + extra, -1] = -values
    return replace(
        sums,
        gains=(),
        gram=turn.T @ sums.gram @ turn,
        noise=turn.T @ sums.noise @ turn,
        total=sums.total @ turn,
    )


def _group(groups: Floats, kept: Sequence[int], one: int, own: Sequence[int], candidates: Sequence[Parameter]) -> str:
    """The sum of the body's parameters that a kept one stands for."""
    parts = np.linalg.lstsq(groups[:, kept], groups[:, own], rcond=None)[0][list(kept).index(one)]
    said = candidates[one].name
    for k, size in zip(own, parts.tolist(), strict=True):
        if k != one and abs(size) > 1e-9:
            said += f" {'-' if size < 0.0 else '+'} {abs(size):.6g} {candidates[k].name}"
    return said


def _beside_offset(sums: Sequence[Sums]) -> Floats:
    """(N,) sum of the squares of the impulses, or of what takes their place, without the offset of each run."""
    left = np.zeros(sums[0].gram.shape[1])
    for one in sums:
        gram = one.gram.sum(axis=0)
        left += gram[:, -1, -1] - gram[:, -1, -2] ** 2 / np.maximum(gram[:, -2, -2], 1e-300)
    return left


def check_found(found: Payload) -> None:
    """Errors: Undecided where no value differs from 0 beyond chance."""
    if not found.found:
        raise Undecided(
            "no payload: nothing differs from the model beyond its interval; remedy: a motion that turns the last body "
            "against gravity and accelerates it"
        )
