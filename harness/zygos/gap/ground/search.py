# SPDX-License-Identifier: MIT
"""Forward selection of what a simulation lacks: each candidate must be significant, repeat on every run, and matter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.gap.findings import ROTOR_INERTIA
from zygos.gap.ground.candidates import GAIN, Candidate
from zygos.gap.ground.columns import Table
from zygos.gap.ground.fit import Fit, Scores, fit, jackknife, score
from zygos.quantiles import normal_isf, normal_sf, student_isf

Floats = NDArray[np.float64]
Against = Literal["insignificant", "inconsistent", "negative", "too late", "not transferable", "immaterial"]


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
    last: tuple[Tried, ...] = ()
    """Every entry of the catalogue beside what was named, the best first; empty where one of those that are searched
    last was named."""

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
    names = [one.name for one in begun.named] if begun is not None else []
    sets = list(begun.sets) if begun is not None else []
    rounds = list(begun.rounds[:-1]) if begun is not None else []
    free = [*layout.basis, *(layout.at(name) for name in names)]
    fitted = fit(table, free)
    if names:
        kept, sets = _retested(table, fitted, names, sets)
        if kept != names:
            names, free = kept, [*layout.basis, *(layout.at(name) for name in kept)]
            fitted = fit(table, free)
    for _ in range(limits.MOST_TERMS.value):
        taken = {(one.key, one.joint) for one in layout.candidates if one.name in names}
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
        free += [layout.at(name) for name in added]
        fitted = fit(table, free)
        kept, sets = _retested(table, fitted, names, sets)
        if kept != names:
            names, free = kept, [*layout.basis, *(layout.at(name) for name in kept)]
            fitted = fit(table, free)
    named = tuple(_beside_the_others(table, names))
    return Search(before, fitted, named, tuple(sets), tuple(rounds))


def without(table: Table, found: Search, left_out: Sequence[str]) -> Search:
    """A search without some of what it named."""
    names = [one.name for one in found.named if one.name not in left_out]
    fitted = fit(table, [*table.layout.basis, *(table.layout.at(name) for name in names)])
    sets = tuple(group for group in found.sets if group[0] in names)
    return replace(found, after=fitted, named=tuple(_beside_the_others(table, names)), sets=sets)


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
    layout, names = table.layout, [one.name for one in found.named]
    taken = {(one.candidate.key, one.candidate.joint) for one in found.named}
    listed = [one for one in layout.candidates if (one.key, one.joint) not in taken]
    fitted = fit(table, [*layout.basis, *(layout.at(name) for name in names)])
    tried = try_all(table, fitted, listed) if listed else []
    return replace(found, last=tuple(sorted(tried, key=lambda one: (not one.passes, -one.gain))))


def try_all(table: Table, fitted: Fit, candidates: Sequence[Candidate]) -> list[Tried]:
    """Every candidate, each alone beside the columns of a fit, judged."""
    scores = score(table, fitted, [table.layout.at(one.name) for one in candidates])
    needed = threshold(len(candidates))
    return [_judged(table, scores, k, one, needed) for k, one in enumerate(candidates)]


def _judged(table: Table, scores: Scores, k: int, one: Candidate, needed: float) -> Tried:
    value, sigma, z = float(scores.value[k]), float(scores.sigma[k]), float(scores.z[k])
    each, each_sigma = scores.alone[:, k], scores.alone_sigma[:, k]
    # values of bodies give way to a wrong gain, so that other joints show it as well
    explained, worst = _explained(table, scores, k, range(table.layout.arm.n) if is_gain(one) else (one.joint,))
    against: Against | None = None
    far = bool(np.all(scores.before[:, one.joint] > (limits.FAR.value * table.floor[:, one.joint]) ** 2))
    if not np.isfinite(sigma) or abs(z) < (
        limits.SEEN_Z.value if far and explained > limits.EXPLAINS_MOST.value else needed
    ):
        against = "insignificant"
    elif one.positive and value < 0.0:
        against = "negative"
    elif _too_late(table, one, value):
        against = "too late"
    elif not _agrees(table, value, sigma, each, each_sigma):
        against = "inconsistent"
    elif worst < 0.0 and one.key != ROTOR_INERTIA:
        against = "not transferable"
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
        tuple(each.tolist()),
        explained,
        limit,
        against,
    )


def _too_late(table: Table, one: Candidate, value: float) -> bool:
    """Whether a torque would begin to act after its own period: it is then something else that looks so."""
    return one.effect is not None and one.effect.kind.lags and value >= table.layout.arm.period_s


def _agrees(table: Table, value: float, sigma: float, each: Floats, each_sigma: Floats) -> bool:
    """Whether every run by itself has the same sign and size, as far as it shows the candidate."""
    blocks = np.bincount(table.owner, minlength=len(each))
    for own, wide, count in zip(each.tolist(), each_sigma.tolist(), blocks.tolist(), strict=True):
        if not np.isfinite(own):
            continue
        # a standard deviation from few blocks is not known well itself
        limit = student_isf(normal_sf(limits.AGREE_Z.value), max(2.0, 0.5 * count)) * np.hypot(wide, sigma)
        if abs(own - value) > max(limit, limits.AGREE_SHARE.value * abs(value)):
            return False
        if own * value < 0.0 and abs(own) > 2.0 * wide:
            return False
    return True


def _explained(table: Table, scores: Scores, k: int, joints: Sequence[int]) -> tuple[float, float]:
    """Share of the squared residual beyond noise at joints that a candidate takes away over all runs, each joint in
    units of its noise, and the least change on a run that shows it."""
    unit = table.floor[:, joints] ** 2
    before, after = scores.before[:, joints] / unit, scores.after[:, k][:, joints] / unit
    rest = np.maximum(before - limits.NOISE.value, 0.0)
    shows = np.isfinite(scores.alone[:, k]) & (np.abs(scores.value[k]) > 2.0 * scores.alone_sigma[:, k])
    better = np.sum(before - after, axis=1)
    whole = float(rest.sum())
    share = float(better.sum()) / whole if whole > 0.0 else float(np.sign(better.sum()))
    return share, float(np.min(better[shows], initial=0.0))


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
    table: Table, fitted: Fit, names: list[str], sets: list[tuple[str, ...]]
) -> tuple[list[str], list[tuple[str, ...]]]:
    """What was named, without what beside the others is not significant any more, negative or too late."""
    by_name = {one.name: one for one in table.layout.candidates}
    covariance, freedom, _ = jackknife(table, fitted)
    kept = list(names)
    for name in names[:-1]:
        if is_gain(by_name[name]):
            continue
        place = table.layout.at(name)
        k = fitted.free.index(place)
        value, sigma = float(fitted.x[place]), float(np.sqrt(max(covariance[k, k], 1e-300)))
        weak = abs(value) < student_isf(normal_sf(limits.KEPT_Z.value), freedom[k]) * sigma
        if weak or (by_name[name].positive and value < 0.0) or _too_late(table, by_name[name], value):
            kept.remove(name)
    return kept, [group for group in sets if group[0] in kept]


def _beside_the_others(table: Table, names: Sequence[str]) -> list[Tried]:
    """What was named, each beside all others."""
    by_name = {one.name: one for one in table.layout.candidates}
    out, sigma = list[Tried](), None
    for name in names:
        others = [table.layout.at(other) for other in names if other != name]
        fitted = fit(table, [*table.layout.basis, *others], sigma)
        out.append(try_all(table, fitted, [by_name[name]])[0])
    return out


def is_gain(one: Candidate) -> bool:
    """Whether it is the error of a torque sensor's gain. If one differs, all may."""
    return one.key == GAIN
