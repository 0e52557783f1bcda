# SPDX-License-Identifier: MIT
"""Two runs, a hypothesis about them, and its twin: everything a search asks again and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.equations import from_parameters, parameters
from zygos.dynamics.joints import Drives
from zygos.effects import CATALOGUE, Effect
from zygos.errors import Undecided, ZygosError
from zygos.gap.balances import (
    Acting,
    Layout,
    Lost,
    Sums,
    accumulate,
    acting,
    balance_rows,
    corrected,
    kept_rows,
    thinning,
    zero_columns,
)
from zygos.gap.fit import Fit, Hypothesis, fit
from zygos.gap.record import MeasuredRun, followed, smoothed_states
from zygos.gap.twin import Twin, draws, follow
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """A hypothesis fitted to runs, beside its twin."""

    records: tuple[MeasuredRun, ...]
    accepted: tuple[NDArray[np.bool_], ...]
    """Per run (A, instants): where the smoother follows."""
    hypothesis: Hypothesis
    sums: tuple[Sums, ...]
    """Of the runs."""
    model: Drives
    """What the twins are made of."""
    twins: tuple[Twin, ...]
    twin_sums: tuple[Sums, ...]
    """Of the twins, (draws, ...)."""
    noise: Array
    """(runs, balances) root mean square of what the same fit leaves over of the twin."""
    wobble: Array
    """(runs, balances) standard deviation of the square of that, over the draws, as a share of its mean."""
    fit: Fit
    bias: Array
    """(coefficients,) what the fit makes of the twin, less what the twin was made with."""
    spread: Array
    """(coefficients,) one standard deviation over the twin's draws."""
    applied: Array
    """(runs, zeros) errors of the sensors that were taken off the records."""
    sensors: tuple[Effect, ...]
    """Errors of the sensors that the twins were made with."""
    lost: tuple[tuple[Lost, Lost], ...]
    """Of each run and its twin: what `zero_columns` has computed."""

    @property
    def sizes(self) -> dict[str, float]:
        """By name, of the errors of sensors that the twins were made with."""
        return _sizes(self.hypothesis.layout, self.sensors)

    @property
    def layout(self) -> Layout:
        """Names of balances and columns."""
        return self.hypothesis.layout

    @property
    def weight(self) -> Array:
        """(balances,) 1/noise, less where the rows of a balance share their noise; 0 for one that is not used."""
        return _weight(self.noise, self.wobble, np.array([one.count for one in self.sums]))

    @property
    def independent(self) -> Array:
        """(runs, balances) rows that would be as many, did they not share their noise."""
        return _independent(self.wobble, np.array([one.count for one in self.sums]))

    @property
    def value(self) -> Array:
        """(coefficients,) without the bias that noise in the columns causes."""
        return np.asarray(self.fit.value - self.bias, dtype=np.float64)

    @property
    def made(self) -> Array:
        """(coefficients,) what the twins were made with."""
        return np.asarray(self.of_twin(self.hypothesis).value.mean(axis=0) - self.bias, dtype=np.float64)

    @cached_property
    def by_run(self) -> tuple[Array, Array]:
        """(runs, coefficients) of a fit of each run alone, without what it makes of the values that its twin was made
        with, and standard deviations."""
        each = np.stack([self.of(self.hypothesis, [k]).value for k in range(len(self.records))])
        drawn = np.stack([self.of_twin(self.hypothesis, [k]).value for k in range(len(self.records))])
        return each - drawn.mean(axis=1) + self.made, drawn.std(axis=1, ddof=1)

    @property
    def zeros(self) -> Array:
        """(runs, zeros) errors of the sensors: those that were taken off the records, and what is found beside them."""
        return np.asarray(self.applied + self.fit.zeros, dtype=np.float64)

    @property
    def pulls(self) -> Array:
        """(runs, zeros) errors of the sensors in deviations of what the arm file knows of them: what a fit pays for
        them."""
        return np.asarray(self.zeros / self.layout.declared_sigma, dtype=np.float64)

    @property
    def excess(self) -> Array:
        """(runs, balances) rho: what is left over of each balance, in units of what is left over of the twin's."""
        return np.asarray(self.fit.rms / self.noise, dtype=np.float64)

    @property
    def physical(self) -> bool:
        """Whether an arm can have the values that were fitted."""
        try:
            realise(self.hypothesis, self.value)
        except ZygosError:
            return False
        return True

    @cached_property
    def mean_sums(self) -> tuple[Sums, ...]:
        """Of the twins, mean over the draws; with the noise taken off these are the sums of exact readings."""
        return tuple(
            replace(one, gram=tuple(gram.mean(axis=0) for gram in one.gram), scores=None) for one in self.twin_sums
        )

    def dynamics(self) -> Drives:
        """The model that was fitted, or as much of it as an arm can be."""
        return _possible(self.hypothesis, self.value, self.model)

    def dynamics_of(self, hypothesis: Hypothesis) -> Drives:
        """The model that another hypothesis fits, or as much of it as an arm can be; its bias is that on these twins.

        Errors: Undecided as `fit`; ZygosError where no arm has such parameters.
        """
        made = np.array([coefficient(self.model, hypothesis, name, self.sensors) for name in hypothesis.names])
        bias = self.of_twin(hypothesis).value.mean(axis=0) - made
        return _possible(hypothesis, self.of(hypothesis).value - bias, self.model)

    def local(self) -> Array:
        """(runs, balances) rho where each balance is fitted by itself: whatever happens elsewhere does not touch it.

        The momentum, and that of the link of a flexible joint, have no scale of their own; their rho is that of the
        common fit.
        """
        out = self.excess.copy()
        for balance in self.hypothesis.balances:
            name = self.layout.balances[balance]
            if name in self.layout.momenta or (name[0] == "L" and self.layout.arm.joints[int(name[1:]) - 1].flexible):
                continue
            try:
                own = fit(self.hypothesis, self.sums, self.weight, alone=balance)
                twin = fit(self.hypothesis, self.twin_sums, self.weight, alone=balance)
            except Undecided:
                continue
            noise = np.sqrt(np.mean(twin.rms[..., balance] ** 2, axis=0))
            # what closes with values that suit every balance closes with values of its own
            out[:, balance] = np.fmin(out[:, balance], own.rms[:, balance] / noise)
        return out

    def of(self, hypothesis: Hypothesis, runs: Sequence[int] | None = None, fixed: Array | None = None) -> Fit:
        """Another hypothesis on the same sums: all runs, or some."""
        chosen = self.sums if runs is None else [self.sums[k] for k in runs]
        return fit(hypothesis, chosen, self.weight, fixed)

    def of_twin(self, hypothesis: Hypothesis, runs: Sequence[int] | None = None) -> Fit:
        """Another hypothesis on the twin's readings."""
        chosen = self.twin_sums if runs is None else [self.twin_sums[k] for k in runs]
        return fit(hypothesis, chosen, self.weight)


def residuals(study: Study, run: int) -> tuple[Array, State]:
    """What the fit leaves over of every balance of a run, (balances, A, instants) about each arc's mean, NaN where the
    smoother does not follow or the balance is not used; and the smoothed states."""
    record, kept = study.records[run], study.accepted[run]
    readings = record.readings()
    table = balance_rows(study.layout, readings, base_values(study.model, study.layout), sizes=study.sizes)
    full = np.concatenate([study.fit.zeros[run], study.fit.value, [-1.0]])
    mix = study.hypothesis.basis() @ full
    out = np.full((len(table.balances), *kept.shape), np.nan)
    for k in study.hypothesis.balances:
        rows, used = table.balances[k], study.layout.used[k]
        left = rows.left @ mix[used] + rows.right * mix[-1]
        left[~kept_rows(rows, kept)] = np.nan
        if rows.begin is not None:
            out[k][:, (rows.begin + rows.end) // 2] = left
        else:
            out[k][:, rows.end] = left if k in study.hypothesis.uncentred else left - _mean(left)
    return out, smoothed_states(record.arm, readings)


def own_errors(study: Study, record: MeasuredRun) -> Array:
    """(zeros,) errors of the sensors of a run that the study does not have, beside the coefficients of the study."""
    layout, arm = study.layout, record.arm
    every = thinning(arm)
    rows = balance_rows(layout, record.readings(), base_values(study.model, layout), every=every, sizes=study.sizes)
    sums = accumulate(rows, followed(arm, record.readings()), study.hypothesis.uncentred)
    return np.asarray(fit(study.hypothesis, [sums], study.weight, study.value).zeros[0], dtype=np.float64)


def read_hypothesis(layout: Layout, model: Model) -> Hypothesis:
    """The equations that a model stands for. Errors: ZygosError for a share of coupling that is neither 0 nor 1."""
    arm = layout.arm
    values = model.base_values(arm)
    known = dict(zip(arm.parameter_names, values.tolist(), strict=True))
    uncoupled = [False] * arm.n
    momentum: float | None = None
    own: list[Acting] = []
    for effect in model.effects:
        if effect.kind.key == "rotor_coupling":
            if effect.value not in {0.0, 1.0}:
                raise ZygosError(
                    f"model {model.name}: rotor_coupling at {effect.joint} is {effect.value:g}; remedy: write 1, as in "
                    "nature, or 0 for a simulator that leaves it out"
                )
            uncoupled[effect.index(arm)] = effect.value == 0.0
        elif effect.kind.key == "angular_momentum":
            momentum = effect.value
        else:
            own.append(acting(effect, arm))
    rigid = tuple(bool(known.get(f"k{i + 1}", np.inf) == np.inf) for i in range(arm.n))
    known_ones = replace(layout, own=tuple(own))
    return Hypothesis(known_ones, rigid, tuple(uncoupled), momentum, tuple(one.name for one in own))


def realise(hypothesis: Hypothesis, value: Array) -> Drives:
    """The model of a hypothesis with these coefficients. Errors: ZygosError where it is not physical."""
    arm = hypothesis.layout.arm
    base, effects = split(hypothesis, value)
    unphysical = [
        one.name for one, x in zip(arm.parameters, base, strict=True) if one.symbol in ("Im", "k") and not x > 0.0
    ]
    if unphysical:
        raise ZygosError(f"{', '.join(unphysical)} came out negative; remedy: see the verdict")
    return from_parameters(arm, base, effects)


def split(hypothesis: Hypothesis, value: Array) -> tuple[Array, list[Effect]]:
    """Base parameters (p,) in the arm's order, and effects, of coefficients."""
    arm = hypothesis.layout.arm
    found = dict(zip(hypothesis.names, value.tolist(), strict=True))
    base = np.array(
        [found.get(one.name, np.inf if one.symbol == "k" else 0.0) for one in arm.parameters], dtype=np.float64
    )
    effects: list[Effect] = []
    names = [joint.name for joint in arm.joints]
    for i, uncoupled in enumerate(hypothesis.uncoupled):
        if uncoupled and f"rotor_coupling{i + 1}" not in hypothesis.effects:
            effects.append(Effect(CATALOGUE["rotor_coupling"], names[i], 0.0))
    if hypothesis.momentum is not None and "angular_momentum" not in hypothesis.effects:
        effects.append(Effect(CATALOGUE["angular_momentum"], None, hypothesis.momentum))
    for one in hypothesis.layout.effects:
        if one.name in hypothesis.effects:
            # the coupling's coefficient is a rotor inertia, its value a share of it
            scale = found[f"Im{one.joint + 1}"] if one.kind.place == "rotor" else 1.0
            effects.append(one.effect(arm, found[one.name] / scale))
    return base, effects


def begin(records: Sequence[MeasuredRun], hypothesis: Hypothesis, dynamics: Drives) -> Study:
    """Fit a hypothesis to runs. dynamics: any model of it that is about right; it weights the balances, and the study
    is then made again with what was learned. Errors: Undecided where the runs do not tell the parameters apart."""
    accepted = tuple(followed(record.arm, record.readings()) for record in records)
    applied = np.zeros((len(records), len(hypothesis.layout.zeros)))
    first = _study(tuple(records), accepted, hypothesis, dynamics, limits.FEW_DRAWS.value, applied)
    return again(again(first, hypothesis, limits.FEW_DRAWS.value) if hypothesis.layout.loose else first, hypothesis)


def again(study: Study, hypothesis: Hypothesis, count: int = limits.DRAWS.value, layout: Layout | None = None) -> Study:
    """The same runs under another hypothesis: its fit, and a twin of its own with `count` draws. layout: other columns
    than those of the study.

    Errors of sensors that are free are taken off the records, because their columns are those of small errors. Those
    that the hypothesis has are found step by step: the column of a large one depends on its size.
    """
    wanted = hypothesis if layout is None else replace(hypothesis, layout=layout)
    for _ in range(limits.ERROR_STEPS.value):
        first = study.of(hypothesis)
        sensors = sensor_effects(hypothesis, first.value)
        if all(
            abs(now.value - was.value) < limits.ERROR_CLOSE.value * abs(now.value)
            for now, was in _pairs(sensors, study.sensors)
        ):
            break
        study, hypothesis = _again(study, hypothesis, limits.FEW_DRAWS.value, wanted), wanted
    return _again(study, hypothesis, count, wanted)


def _pairs(sensors: Sequence[Effect], known: Sequence[Effect]) -> list[tuple[Effect, Effect]]:
    """Errors of sensors, each with the same one of a study, or with none of its kind."""
    return [
        (one, next((was for was in known if replace(was, value=one.value) == one), replace(one, value=0.0)))
        for one in sensors
    ]


def _again(study: Study, hypothesis: Hypothesis, count: int, wanted: Hypothesis) -> Study:
    first = study.of(hypothesis)
    records, applied = study.records, study.applied
    free = np.array([name in wanted.layout.loose for name in study.layout.zeros], dtype=np.bool_)
    off = np.where(free, applied + first.zeros, 0.0)
    if not np.array_equal(off, applied):
        changed = zip(records, off - applied, strict=True)
        records = tuple(corrected(record, study.layout, change) for record, change in changed)
    misread = np.where(study.layout.of_torque, first.zeros, 0.0)
    model = _possible(hypothesis, first.value, study.model)
    return _study(records, study.accepted, wanted, model, count, off, first.value, misread)


def laid_out(study: Study, layout: Layout, count: int = limits.DRAWS.value) -> Study:
    """The same runs, hypothesis and twins with other columns to search among, and `count` draws."""
    hypothesis = replace(study.hypothesis, layout=layout)
    return _fitted(
        study.records, study.accepted, hypothesis, study.model, study.twins, study.sensors, count, study.applied,
        study.lost,
    )  # fmt: skip


def part_of(study: Study, arcs: Sequence[slice], hypothesis: Hypothesis) -> Study:
    """Some arcs of each run under another hypothesis, beside the twins that the study has, with a few draws.

    Errors: Undecided where they do not tell the parameters apart.
    """
    kept = [k for k, own in enumerate(arcs) if len(study.records[k].starts[own])]
    if not kept:
        raise Undecided("no arc was recorded there")
    records, twins = [], []
    for k in kept:
        record, exact = study.records[k], study.twins[k].exact
        own = arcs[k]
        records.append(replace(record, starts=record.starts[own]))
        known = (x if x is None else x[own] for x in (exact.time, exact.turned, exact.nadir))
        read = Readings(exact.q[own], exact.theta[own], exact.omega0[own], exact.tau[own], *known)
        twins.append(replace(study.twins[k], exact=read))
    accepted = tuple(study.accepted[k][arcs[k]] for k in kept)
    applied = study.applied[kept]
    return _fitted(
        tuple(records), accepted, hypothesis, study.model, tuple(twins), study.sensors, limits.FEW_DRAWS.value, applied
    )


def price(study: Study, found: Fit) -> float:
    """What a fit leaves over beyond noise, and what it pays for errors of sensors: squares of their deviations."""
    known = ~study.layout.of_torque
    pulls = (study.applied + found.zeros)[:, known] / study.layout.zero_sigma[known]
    return float(np.nansum(study.independent * ((found.rms / study.noise) ** 2 - 1.0)) + np.sum(pulls**2))


def _possible(hypothesis: Hypothesis, value: Array, known: Drives) -> Drives:
    """The model of these coefficients, or of as much of them, beside a known model's, as some arm can have."""
    layout = hypothesis.layout
    arm = layout.arm
    base, effects = split(hypothesis, value)
    kept = [effect for effect in effects if not (effect.kind.positive and effect.value < 0.0)]
    late = limits.LATEST.value * arm.period_s
    kept = [replace(e, value=min(e.value, late)) if e.kind.key == "torque_lag" else e for e in kept]
    rigid = np.isinf(base)
    share = 1.0
    while share > 1e-6:
        mixed = share * np.where(rigid, 0.0, base) + (1.0 - share) * base_values(known, layout)
        for k, one in enumerate(arm.parameters):
            if one.symbol == "b" and one.joint is not None:
                mixed[k] = max(mixed[k], 0.0)
        mixed[rigid] = np.inf
        if all(x > 0.0 for one, x in zip(arm.parameters, mixed, strict=True) if one.symbol in ("Im", "k")):
            try:
                return from_parameters(arm, mixed, kept)
            except ZygosError:
                pass
        share *= 0.5
    raise ZygosError(
        "no arm has the parameters that fit these runs; remedy: check gear ratios, signs and the torque_law of the arm "
        "file"
    )


def _mean(x: Array) -> Array:
    """Mean over the last axis of what is not NaN; 0 where nothing is."""
    known = np.isfinite(x)
    total = np.where(known, x, 0.0).sum(axis=-1, keepdims=True)
    return np.asarray(total / np.maximum(known.sum(axis=-1, keepdims=True), 1), dtype=np.float64)


def _weight(noise: Array, wobble: Array, count: Array) -> Array:
    """Torques' noise adds up along an arc, that of the gyro does not: a balance counts as many rows as are independent,
    or it would outweigh others, and what the arm file knows of the sensors."""
    square = (noise**2).mean(axis=0)
    share = (_independent(wobble, count) / np.maximum(count, 1.0)).mean(axis=0)
    return np.where(np.isfinite(square), np.sqrt(share / square), 0.0)


def _independent(wobble: Array, count: Array) -> Array:
    """Rows whose mean square would vary as much, all of them independent."""
    return np.asarray(np.minimum(2.0 / np.maximum(wobble, 1e-6) ** 2, count), dtype=np.float64)


def _study(
    records: tuple[MeasuredRun, ...],
    accepted: tuple[NDArray[np.bool_], ...],
    hypothesis: Hypothesis,
    dynamics: Drives,
    count: int,
    applied: Array,
    value: Array | None = None,
    misread: Array | None = None,
) -> Study:
    """misread: (runs, zeros) offsets and gains of the torques as far as they are known. They act on no arm, and would
    keep the twin off the path: its readings would have other noise in the balances than those of the arm."""
    sensors = sensor_effects(hypothesis, value)
    acted = records
    if misread is not None:
        acted = tuple(corrected(one, hypothesis.layout, own) for one, own in zip(records, misread, strict=True))
    twins = tuple(follow(dynamics, acted, sensors))
    return _fitted(records, accepted, hypothesis, dynamics, twins, sensors, count, applied)


def _fitted(
    records: tuple[MeasuredRun, ...],
    accepted: tuple[NDArray[np.bool_], ...],
    hypothesis: Hypothesis,
    dynamics: Drives,
    twins: tuple[Twin, ...],
    sensors: tuple[Effect, ...],
    count: int,
    applied: Array,
    lost: tuple[tuple[Lost, Lost], ...] = (),
) -> Study:
    layout = hypothesis.layout
    arm, uncentred = layout.arm, hypothesis.uncentred
    base = base_values(dynamics, layout)
    every = thinning(arm)
    lost = lost or tuple(({}, {}) for _ in records)
    sizes = _sizes(layout, sensors)
    zeros = [
        zero_columns(layout, record.readings(), base, every, known, sizes=sizes)
        for record, (known, _) in zip(records, lost, strict=True)
    ]
    made = np.array([coefficient(dynamics, hypothesis, name, sensors) for name in hypothesis.names])
    known = hypothesis.basis() @ np.concatenate([np.zeros(len(layout.zeros)), made, [-1.0]])
    # those of a record, for a twin that moves a little otherwise, bend all its coefficients
    drawn = tuple(
        draws(
            twin, kept, count, layout, uncentred,
            zero_columns(layout, twin.exact, base, every, own, sizes=sizes), base, count * k, every, known,
        )
        for k, (twin, kept, (_, own)) in enumerate(zip(twins, accepted, lost, strict=True))
    )  # fmt: skip
    sums = tuple(
        replace(
            accumulate(balance_rows(layout, record.readings(), base, zeros=own, every=every), kept, uncentred),
            noise=twin.noise,
            applied=off,
        )
        for record, kept, twin, own, off in zip(records, accepted, drawn, zeros, applied, strict=True)
    )
    used = list(hypothesis.balances)
    weight = np.zeros(len(layout.balances))
    # right sides and columns differ in size by orders, so the first weights only bring the balances to one scale
    weight[used] = 1.0 / np.sqrt(np.mean([_size(one)[used] for one in drawn], axis=0))
    for _ in range(3):
        guess = fit(hypothesis, drawn, weight)
        noise = np.sqrt(np.mean(guess.rms**2, axis=0))
        wobble = (guess.rms**2).std(axis=0, ddof=1) / noise**2
        weight = _weight(noise, wobble, np.array([one.count for one in sums]))
    return Study(
        records,
        accepted,
        hypothesis,
        sums,
        dynamics,
        twins,
        drawn,
        noise,
        wobble,
        fit(hypothesis, sums, weight),
        guess.value.mean(axis=0) - made,
        guess.value.std(axis=0, ddof=1),
        applied,
        sensors,
        lost,
    )


def _sizes(layout: Layout, sensors: Sequence[Effect]) -> dict[str, float]:
    """Of errors of sensors, by the names of their columns in a layout."""
    found = {effect.column(layout.arm): effect.value for effect in sensors}
    return {one.name: found[one.plain] for one in layout.sensors if one.plain in found}


def _size(sums: Sums) -> Array:
    """(balances,) mean square of all columns together."""
    trace = [np.trace(gram, axis1=-2, axis2=-1).mean(axis=0) for gram in sums.gram]
    return np.asarray(trace / sums.count, dtype=np.float64)


def base_values(dynamics: Drives, layout: Layout) -> Array:
    """(p,) base parameters of a model in the arm's order; 0 for what a rigid joint has not."""
    values = parameters(layout.arm, dynamics)
    return np.where(np.isfinite(values), values, 0.0)


def sensor_effects(hypothesis: Hypothesis, value: Array | None) -> tuple[Effect, ...]:
    """The errors of sensors in a hypothesis with these coefficients; 0 without them."""
    found = dict.fromkeys(hypothesis.names, 0.0) if value is None else dict(zip(hypothesis.names, value, strict=True))
    arm, sensors = hypothesis.layout.arm, hypothesis.layout.sensors
    return tuple(one.effect(arm, float(found[one.name])) for one in sensors if one.name in hypothesis.effects)


def coefficient(dynamics: Drives, hypothesis: Hypothesis, name: str, sensors: Sequence[Effect] = ()) -> float:
    """What a model, whose sensors have these errors, has for a coefficient of a hypothesis."""
    arm = hypothesis.layout.arm
    if name in arm.parameter_names:
        return float(parameters(arm, dynamics)[arm.parameter_names.index(name)])
    if name == "angular_momentum":
        return dynamics.angular_momentum or 0.0
    one = hypothesis.layout.find(name)
    if one.kind.lags:
        return 0.0 if dynamics.torque_lag is None else float(dynamics.torque_lag[one.joint])
    if one.kind.place == "rotor":
        return float(dynamics.coupling[one.joint] * dynamics.rotor_inertia[one.joint])
    if one.kind.place == "sensor":
        return sum(effect.value for effect in sensors if effect.column(arm) == one.plain)
    number = one.kind.components(arm).index(one.component)
    same = (one.kind.key, one.joint, number)
    laws = (*dynamics.laws, *dynamics.base_laws)
    own = [law.value for law in laws if (law.kind.key, law.joint, law.component) == same]
    return dynamics.gradient if one.kind.place == "field" else sum(own)
