# SPDX-License-Identifier: MIT
"""Forward selection of what a simulation lacks: each candidate must be significant, repeat on every run, and matter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.gap.ground.candidates import GAIN, Candidate
from zygos.gap.ground.columns import Layout, Table
from zygos.gap.ground.fit import Fit, Scores, fit, gains, jackknife, residual, score
from zygos.ground.estimate import DEFAULT_FRICTION
from zygos.quantiles import normal_isf, normal_sf, student_isf

Floats = NDArray[np.float64]
Against = Literal["insignificant", "negative", "too late", "immaterial"]


@dataclass(frozen=True)
class Tried:
    """A candidate, with its coefficient beside the columns of a fit."""

    candidate: Candidate
    value: float
    sigma: float
    freedom: float
    z: float
    gain: float
    """Reduction of the weighted squared residual."""
    each: tuple[float, ...]
    """On each run by itself; NaN where the run does not show it."""
    explained: float
    """Share of the squared residual beyond noise that it takes away at its joint, at the value of the other runs."""
    limit: float
    """Size from which on it would be significant."""
    against: Against | None
    """Why it is not named; None where it passes."""

    @property
    def name(self) -> str:
        """Of its column."""
        return self.candidate.name

    @property
    def twins(self) -> tuple[str, ...]:
        """Keys of effects that look alike in some motions."""
        return () if self.candidate.effect is None else self.candidate.effect.kind.twins

    @property
    def passes(self) -> bool:
        """Whether it passes all tests."""
        return self.against is None


@dataclass(frozen=True)
class Search:
    """What was found, in the order in which it was found."""

    before: Fit
    after: Fit
    named: tuple[Tried, ...]
    """With their values beside all others."""
    sets: tuple[tuple[str, ...], ...]
    """For each that was named, its column and those that the runs cannot tell from it."""
    rounds: tuple[tuple[Tried, ...], ...]
    """Candidates of each round, the best first."""
    beside: tuple[str, ...] = ()
    """Columns of the usual friction and of rotors that stay in the model, whether they are named or not."""
    last: tuple[Tried, ...] = ()
    """Every entry of the catalogue beside what was named, the best first; empty where one of those that are searched
    last was named."""

    def free(self, layout: Layout) -> list[int]:
        """Columns of the simulation's own equations, and of what was named or stays beside."""
        return _free(layout, self.beside, [one.name for one in self.named])

    def unnamed(self, layout: Layout) -> list[Candidate]:
        """What stays in the model without being named."""
        staying = set(self.beside) - {one.name for one in self.named}
        return [one for one in layout.candidates if one.name in staying]

    @property
    def nearest(self) -> Tried | None:
        """What would explain most of what is left over; None where nothing was tried."""
        tried = self.last or (self.rounds[-1] if self.rounds else ())
        return max(tried, key=lambda one: one.gain, default=None)

    @property
    def beyond(self) -> tuple[Tried, ...]:
        """Entries that are searched last, where nothing was named but gains of torque sensors: their limits hold beside
        the simulation's own equations and these gains."""
        usual = {one.name for one in self.rounds[0]} if self.rounds else set()
        nothing = all(is_gain(one.candidate) for one in self.named)
        return tuple(one for one in self.last if one.name not in usual) if nothing else ()


def threshold(count: int) -> float:
    """Standard deviations that one of so many candidates needs."""
    return max(limits.NAMED_Z.value, float(normal_isf(0.5 * limits.FALSE_ALARMS.value / max(count, 1))))


def false_alarms(count: int) -> float:
    """Limit of the share of searches on runs that lack nothing in which noise brings one of so many candidates to the
    threshold."""
    return min(1.0, 2.0 * count * float(normal_sf(threshold(count))))


def search(table: Table, step: Callable[[str], None], begun: Search | None = None) -> Search:
    """Add one candidate after the other. begun: a search on nearly the same sums, whose names are kept."""
    layout = table.layout
    before = fit(table, layout.basis)
    beside = _beside(table) if begun is None else begun.beside
    names = [one.name for one in begun.named if one.name not in beside] if begun is not None else []
    sets = [group for group in begun.sets if group[0] in names] if begun is not None else []
    rounds = list(begun.rounds[:-1]) if begun is not None else []
    fitted = fit(table, _free(layout, beside, names))
    if names:
        names, sets, fitted = _retested(table, fitted, beside, names, sets)
    for _ in range(limits.MOST_TERMS.value):
        taken = {(one.key, one.joint) for one in layout.candidates if one.name in (*names, *beside)}
        open_ones = [one for one in layout.candidates if (one.key, one.joint) not in taken]
        if not open_ones:
            break
        tried = try_all(table, fitted, open_ones)
        rounds.append(tuple(sorted(tried, key=lambda one: (not one.passes, -one.gain))))
        best = rounds[-1][0]
        if not best.passes:
            break
        step(best.name)
        added = [one.name for one in open_ones if is_gain(one)] if is_gain(best.candidate) else [best.name]
        sets += [(name, *(_alike(table, fitted, best, rounds[-1]) if name == best.name else ())) for name in added]
        names += added
        fitted = fit(table, _free(layout, beside, names))
        names, sets, fitted = _retested(table, fitted, beside, names, sets)
    stays, alike = _earned(table, beside, names)
    if rounds:
        rounds[0] = tuple(sorted((*rounds[0], *stays), key=lambda one: (not one.passes, -one.gain)))
    earned = [one for one in stays if one.passes]
    beside = _needed(table, [one.name for one in earned], beside, names)
    fitted = fit(table, _free(layout, beside, names))
    named = (*earned, *_beside_the_others(table, beside, names))
    return Search(before, fitted, named, (*alike, *sets), tuple(rounds), beside)


def _needed(table: Table, earned: Sequence[str], beside: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """What stays in the model with what was named: all that is not below zero, where far more than noise is left over
    without it."""
    layout, kept = table.layout, list(beside)
    without_it = fit(table, _free(layout, earned, names))
    if not np.any(_far(table, residual(table, without_it.x))):
        return tuple(earned)
    while True:
        x = fit(table, _free(layout, kept, names)).x
        below = [name for name in kept if name not in earned and x[layout.at(name)] < 0.0]
        if not below:
            return tuple(kept)
        kept = [name for name in kept if name not in below]


def _free(layout: Layout, *names: Sequence[str]) -> list[int]:
    return [*layout.basis, *dict.fromkeys(layout.at(name) for each in names for name in each)]


def _beside(table: Table) -> tuple[str, ...]:
    """The usual friction and the rotors that a simulation lacks, where with all of them far more than noise is left
    over: each is then found beside the others, because one alone would take up what others do. None below zero."""
    layout = table.layout
    usual = [one for one in layout.candidates if one.key in DEFAULT_FRICTION or one.effect is None]
    while usual:
        fitted = fit(table, _free(layout, [one.name for one in usual]))
        if not np.any(_far(table, residual(table, fitted.x))):
            return ()
        places = [layout.at(one.name) for one in usual]
        size = np.sqrt(np.einsum("j,bjpp->p", 1.0 / fitted.sigma**2, table.gram)[places]) * fitted.x[places]
        worst = int(np.argmin(size))
        if size[worst] >= 0.0:
            break
        del usual[worst]
    return tuple(one.name for one in usual)


def _far(table: Table, left: Floats) -> NDArray[np.bool_]:
    """(N,) where a mean square residual (R, N) is far above noise over all runs."""
    return np.asarray(np.mean(left / table.floor**2, axis=0) > limits.FAR.value**2)


def _earned(table: Table, beside: Sequence[str], names: Sequence[str]) -> tuple[list[Tried], list[tuple[str, ...]]]:
    """What stays in the model, each judged beside all others, and the sets of those that pass."""
    layout = table.layout
    by_name = {one.name: one for one in layout.candidates}
    taken = {(by_name[name].key, by_name[name].joint) for name in (*beside, *names)}
    stays, alike = list[Tried](), list[tuple[str, ...]]()
    for name in beside:
        fitted = fit(table, _free(layout, [other for other in beside if other != name], names))
        one = _judged(table, score(table, fitted, [layout.at(name)]), 0, by_name[name], threshold(len(by_name)))
        stays.append(one)
        if one.passes:
            others = [
                other
                for other in layout.candidates
                if other.joint == one.candidate.joint and (other.key, other.joint) not in taken
            ]
            gained = gains(table, fitted, [layout.at(other.name) for other in others])
            close = limits.STANDS_IN.value * one.gain
            others = [other for other, gain in zip(others, gained.tolist(), strict=True) if gain >= close]
            tried = try_all(table, fitted, others) if others else []
            alike.append((name, *_alike(table, fitted, one, tried)))
    return stays, alike


def without(table: Table, found: Search, left_out: Sequence[str]) -> Search:
    """A search without some of what it named."""
    beside = tuple(name for name in found.beside if name not in left_out)
    names = [one.name for one in found.named if one.name not in left_out]
    fitted = fit(table, _free(table.layout, beside, names))
    sets = tuple(group for group in found.sets if group[0] in names)
    return replace(found, after=fitted, named=tuple(_beside_the_others(table, beside, names)), sets=sets, beside=beside)


def in_time(table: Table, found: Search) -> Search:
    """A search without lags of torques that became longer than a period beside what was named after them."""
    late = [
        one.name
        for one in found.named
        if _too_late(table, one.candidate, float(found.after.x[table.layout.at(one.name)]))
    ]
    return without(table, found, late) if late else found


def beside_all(table: Table, found: Search) -> Search:
    """A search with every other candidate of a table beside what it named: an entry that a wider search named, and that
    was not kept, has a limit as well."""
    layout, names = table.layout, {*found.beside, *(one.name for one in found.named)}
    taken = {(one.key, one.joint) for one in layout.candidates if one.name in names}
    listed = [one for one in layout.candidates if (one.key, one.joint) not in taken]
    fitted = fit(table, found.free(layout))
    tried = try_all(table, fitted, listed) if listed else []
    return replace(found, last=tuple(sorted(tried, key=lambda one: (not one.passes, -one.gain))))


def try_all(table: Table, fitted: Fit, candidates: Sequence[Candidate]) -> list[Tried]:
    """Every candidate, each alone beside the columns of a fit, judged."""
    scores = score(table, fitted, [table.layout.at(one.name) for one in candidates])
    needed = threshold(len(candidates))
    return [_judged(table, scores, k, one, needed) for k, one in enumerate(candidates)]


def _judged(table: Table, scores: Scores, k: int, one: Candidate, needed: float) -> Tried:
    value, sigma, z = float(scores.value[k]), float(scores.sigma[k]), float(scores.z[k])
    # values of bodies give way to a wrong gain, so that other joints show it as well
    explained = _explained(table, scores, k, range(table.layout.arm.n) if is_gain(one) else (one.joint,))
    against: Against | None = None
    far = bool(_far(table, scores.before)[one.joint])
    if not np.isfinite(sigma) or abs(z) < (
        limits.SEEN_Z.value if far and explained > limits.EXPLAINS_MOST.value else needed
    ):
        against = "insignificant"
    elif one.positive and value < 0.0:
        against = "negative"
    elif _too_late(table, one, value):
        against = "too late"
    elif explained < limits.MATERIAL.value:
        against = "immaterial"
    limit = float(student_isf(normal_sf(needed), scores.freedom[k]) * sigma)
    return Tried(
        one,
        value,
        sigma,
        float(scores.freedom[k]),
        z,
        float(scores.gain[k]),
        tuple(scores.alone[:, k].tolist()),
        explained,
        limit,
        against,
    )


def _too_late(table: Table, one: Candidate, value: float) -> bool:
    """Whether a torque would begin to act after its own period: it is then something else that looks so."""
    return one.effect is not None and one.effect.kind.lags and value >= table.layout.arm.period_s


def _explained(table: Table, scores: Scores, k: int, joints: Sequence[int]) -> float:
    """Share of the squared residual beyond noise at joints that a candidate takes away over all runs, each joint in
    units of its noise."""
    unit = table.floor[:, joints] ** 2
    before, after = scores.before[:, joints] / unit, scores.after[:, k][:, joints] / unit
    rest = np.maximum(before - limits.NOISE.value, 0.0)
    better, whole = float(np.sum(before - after)), float(rest.sum())
    return better / whole if whole > 0.0 else float(np.sign(better))


def _alike(table: Table, fitted: Fit, best: Tried, tried: Sequence[Tried]) -> list[str]:
    """Candidates that explain as much as the best one, and beside which it is not significant."""
    out = []
    for other in tried:
        if other is best or not other.passes or other.gain < limits.STANDS_IN.value * best.gain:
            continue
        if other.candidate.joint != best.candidate.joint:
            continue
        beside = fit(table, [*fitted.free, table.layout.at(other.name)], fitted.sigma)
        if abs(float(score(table, beside, [table.layout.at(best.name)]).z[0])) < limits.KEPT_Z.value:
            out.append(other.name)
    return out


def _retested(
    table: Table, fitted: Fit, beside: Sequence[str], names: list[str], sets: list[tuple[str, ...]]
) -> tuple[list[str], list[tuple[str, ...]], Fit]:
    """What was named, without what beside the others is not significant any more, negative or too late, and its fit."""
    by_name = {one.name: one for one in table.layout.candidates}
    covariance, freedom, spread = jackknife(table, fitted)
    each = np.fmax(np.sqrt(np.maximum(np.diag(covariance), 1e-300)), spread)
    kept = list(names)
    for name in names[:-1]:
        if is_gain(by_name[name]):
            continue
        place = table.layout.at(name)
        k = fitted.free.index(place)
        value, sigma = float(fitted.x[place]), float(each[k])
        weak = abs(value) < student_isf(normal_sf(limits.KEPT_Z.value), freedom[k]) * sigma
        if weak or (by_name[name].positive and value < 0.0) or _too_late(table, by_name[name], value):
            kept.remove(name)
    fitted = fitted if kept == names else fit(table, _free(table.layout, beside, kept))
    return kept, [group for group in sets if group[0] in kept], fitted


def _beside_the_others(table: Table, beside: Sequence[str], names: Sequence[str]) -> list[Tried]:
    """What was named, each beside all others."""
    by_name = {one.name: one for one in table.layout.candidates}
    out = list[Tried]()
    for name in names:
        others = [other for other in (*beside, *names) if other != name]
        out.append(try_all(table, fit(table, _free(table.layout, others)), [by_name[name]])[0])
    return out


def is_gain(one: Candidate) -> bool:
    """Whether it is the error of a torque sensor's gain. If one differs, all may."""
    return one.key == GAIN
