# SPDX-License-Identifier: MIT
"""Which effect is missing: candidates one after the other, each read against the null twin and on both runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.effects import Kind
from zygos.errors import Undecided, ZygosError
from zygos.gap.balances import Acting
from zygos.gap.findings import Disagreement
from zygos.gap.fit import Fit, Hypothesis, fit, shares_of_pairs
from zygos.gap.null import Chance, chance, null_sigmas
from zygos.gap.study import Study, again, laid_out, price
from zygos.quantiles import chi_square_isf, chi_square_ppf, normal_sf

Array = NDArray[np.float64]
Against = Literal["", "insignificant", "inconsistent", "negative", "not transferable", "not the rotor"]
"""What speaks against a candidate: not beyond its twin on both runs, of another size on each run, creating energy, of
no help on the second run, not of the size of the rotor's inertia; empty where nothing does."""


@dataclass(frozen=True)
class Candidate:
    """An entry of the catalogue at a place, beside what has been named before."""

    name: str
    kind: Kind
    joint: int
    """From 0; -1 for the base."""
    shape: float | None
    """Of its law, where that has one."""
    value: float
    """Coefficient fitted on all runs, in the entry's unit."""
    each: tuple[float, ...]
    """Fitted on each run alone."""
    z: tuple[float, ...]
    """Each run's coefficient less the twin's mean, in the twin's standard deviations."""
    sigma: float
    """Standard deviation on all runs together."""
    completeness: tuple[float, ...]
    """Share of each run's excess that it takes away, with those named before."""
    of_rest: float
    """Share of what was left over before it that it takes away, on the run where it takes less."""
    left: float
    """Sum of rho^2 over runs and balances with it."""
    paid: float
    """For errors of sensors beyond what is known of them, in the unit of `left`."""
    frozen: float
    """Sum of rho^2 on the last run with what was fitted on the others, and what is paid there, as a share of that
    without it."""
    limit: float
    """The size from which on this search would name it on these runs."""
    against: Against

    @property
    def passes(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.against

    @property
    def complete(self) -> float:
        """Completeness on the run where it is worse."""
        return min(self.completeness)


@dataclass(frozen=True)
class Limit:
    """From which size on an entry that is searched last would make a search go on to it, and be named."""

    name: str
    kind: Kind
    joint: int
    """From 0; -1 for the base."""
    shape: float | None
    value: float


@dataclass(frozen=True)
class Search:
    """What came of it."""

    before: Study
    """The model's own equations, refitted."""
    after: Study
    """With the named effects."""
    named: tuple[Candidate, ...]
    rounds: tuple[tuple[Candidate, ...], ...]
    """Every candidate of every round, best first."""
    completeness: tuple[float, ...]
    """Of the named set, on each run."""
    sets: tuple[tuple[str, ...], ...]
    """For each named effect the names that the runs cannot tell from it, itself first."""
    chance: Chance
    """How often noise alone names one of the candidates."""
    beyond: tuple[Limit, ...] = ()
    """Of the entries that were not searched, because nothing was left over."""


def excess(study: Study) -> bool:
    """Whether a balance of a study leaves something to explain."""
    return bool(np.any(study.excess**2 - 1.0 > allowed(study)[1]))


def allowed(study: Study) -> tuple[Array, Array]:
    """(runs, balances) by how much less and more than 1 the squared ratio of a residual to its twin's may be.

    It varies as a sum of squares does whose deviation is the twin's. Beyond that, `EXCESS` is allowed for.
    """
    freedom = 2.0 / np.maximum(study.wobble, 1e-6) ** 2
    tail = normal_sf(limits.EXCESS_Z.value)
    least, most = 1.0 - chi_square_ppf(tail, freedom) / freedom, chi_square_isf(tail, freedom) / freedom - 1.0
    return np.maximum(least, limits.EXCESS.value), np.maximum(most, limits.EXCESS.value)


def noisy(study: Study) -> bool:
    """Whether noise of the torques, which adds up along an arc, hides in each balance what candidates can show: then
    their scores say whether there is something to explain."""
    return bool(study.layout.of_torque.any() and np.nanmax(limits.EXCESS_Z.value * study.wobble) > limits.EXCESS.value)


def completeness(before: Study, rms: Array) -> tuple[float, ...]:
    """Share of each run's excess over a study's twin that is gone when its balances leave rms (runs, balances); 1 where
    there was none. What the twin itself varies by is no excess."""
    out = []
    after = (rms / before.noise) ** 2 - 1.0
    for old, kept, wobble in zip(before.excess**2 - 1.0, after, before.wobble, strict=True):
        counts = np.isfinite(old) & (old > limits.EXCESS.value)
        left = np.maximum(kept - 2.0 * wobble, 0.0)
        out.append(1.0 - float(np.sum(left[counts]) / np.sum(old[counts])) if counts.any() else 1.0)
    return tuple(out)


def paid(study: Study, found: Fit, runs: Sequence[int] | None = None) -> Array:
    """(runs,) what a fit pays for errors of encoders and gyro beyond what is known of them, as a sum of rho^2."""
    chosen = list(range(len(study.records)) if runs is None else runs)
    layout = study.layout
    held = ~layout.of_torque & np.array([name not in layout.loose for name in layout.zeros], dtype=np.bool_)
    pulls = (study.applied[chosen] + found.zeros) / layout.declared_sigma
    over = np.where(held, np.maximum(pulls**2 - limits.LARGE_ERROR_Z.value**2, 0.0), 0.0)
    return np.asarray(over.sum(axis=1) / np.nanmean(study.independent[chosen], axis=1), dtype=np.float64)


def search(study: Study, step: Callable[[str], None] = lambda _: None, every: Study | None = None) -> Search:
    """Look for what the study's hypothesis lacks. step is told what is being done. every: the same study `widened`,
    where every entry of the catalogue is searched, not only the usual ones."""
    own = study.layout.own
    now = before = study if every is None else shortlisted(study, every, own)
    others = 0 if every is None else _possible_of(every) - _possible_of(before)
    named: list[Candidate] = []
    rounds: list[tuple[Candidate, ...]] = []
    share: tuple[float, ...] = tuple(1.0 for _ in study.records)
    luck = chance(
        before, [one.name for one in before.layout.effects if possible(before.hypothesis, one)], others=others
    )
    while True:
        step(f"round {len(rounds) + 1}: every candidate")
        listed = candidates(now, before, luck.threshold)
        freed = _freed(now, listed)
        if freed is not None:
            now, before = freed, before if named else freed
            continue
        rounds.append(listed)
        done = bool(named) and min(share) >= limits.COMPLETE.value
        passing = (c for c in listed if c.passes and (not done or c.of_rest >= limits.REST.value))
        best = _simplest(next(passing, None), listed)
        if best is None and not named and excess(now):
            step("pairs of candidates")
            paired = _paired(now, listed, luck.threshold)
            if paired is not None:
                named, now = paired
                share = completeness(before, now.excess * before.noise)
                continue
        over = (bool(named) and not done) or excess(now) or noisy(now)
        if best is None or not over or len(named) >= limits.MOST_EFFECTS.value:
            break
        try:
            step(f"{best.kind.title}: its twin")
            grown, turned = _grown(now, named, best)
        except Undecided:
            break
        gained = completeness(before, grown.excess * before.noise)
        if (named and not done and min(gained) < min(share) + limits.GAINS.value) or (
            turned and min(gained) <= min(share)
        ):
            break
        named = [*(one for one in named if one not in turned), best]
        now, share = grown, gained
        if every is not None and (min(share) < limits.COMPLETE.value or excess(now)):
            step(f"round {len(rounds) + 1}: every entry of the catalogue")
            now = shortlisted(now, widened(now), own)
    named, now = _retest(named, _held_again(now) if named else now, before)
    share = completeness(before, now.excess * before.noise)
    sets = tuple(_inseparable(candidate, now, before) for candidate in named)
    return Search(before, now, tuple(named), tuple(rounds), share, sets, luck)


def refined(found: Search, every: Study) -> Search:
    """The search where laws are compared about their own models: every law of its family in the place of each one that
    was named, and every entry of the catalogue beside them all. Those are taken, one after the other, that leave far
    less over; itself where none do. every: the closed study `widened`."""
    luck = found.chance.beside(_possible_of(every) - _possible_of(found.before))
    now = replace(found, chance=luck)
    wide: Study | None = every
    if found.after.layout.loose:
        # errors of sensors won against the usual entries, and compete with all others once more
        held = replace(found.after.layout, loose=())
        now, wide = replace(now, after=again(found.after, found.after.hypothesis, limits.FEW_DRAWS.value, held)), None
    first, begun = now.after, _left(now)
    with suppress(Undecided):
        while _left(now) > limits.TRIFLE.value * begun:
            wide = widened(now.after) if wide is None else wide
            tried = [_put(now, wide, one, old) for one, old in _proposals(now, wide)]
            best = min((one for one in tried if one is not None), key=_left, default=None)
            if best is None or _left(best) > limits.STEP_LEAVES.value * _left(now):
                break
            now, wide = best, None
    if now.after is first or _left(now) > (1.0 - limits.REST.value) * begun:
        return found
    now = polished(replace(now, after=again(now.after, now.after.hypothesis)))
    old = {one.name for one in found.named}
    named = [one if one.name in old else _judged(now.after, now, one.name) for one in now.named]
    fitted = now.after.fit
    if any(one is None or not one.passes or (one.kind.positive and fitted.of(one.name) < 0.0) for one in named):
        return found
    share = completeness(found.before, now.after.excess * found.before.noise)
    now = replace(now, named=tuple(one for one in named if one is not None), completeness=share)
    wide = widened(now.after)
    return replace(now, sets=tuple(_inseparable(one, wide, now.before) for one in now.named))


def _left(found: Search) -> float:
    """Sum of rho^2 - 1 that was named leaves over beyond what is allowed, and pays for errors of sensors."""
    after = found.after
    over = np.maximum(after.excess**2 - 1.0 - allowed(found.before)[1], 0.0)
    return float(np.nansum(over) + paid(after, after.fit).sum())


def _proposals(found: Search, every: Study) -> list[tuple[Acting, Candidate | None]]:
    """Entries of the catalogue, each with the named law in whose place it is put, or None, that leave least over about
    the model as it is; of each the best shape. A law with a shape is put in the place of one of its family."""
    kept: dict[tuple[str, str], tuple[float, Acting, Candidate | None]] = {}
    families = {(one.kind.family, one.joint) for one in found.named}
    more = [None] if len(found.named) < limits.MOST_EFFECTS.value else []
    for old in (*found.named, *more):
        rest = tuple(name for name in every.hypothesis.effects if old is None or name != old.name)
        for one in every.layout.effects:
            own = one.kind.family, one.joint
            fits = (own not in families or one.shape is None) if old is None else own == (old.kind.family, old.joint)
            if not fits or not possible(every.hypothesis, one):
                continue
            with suppress(Undecided):
                fitted = every.of(replace(every.hypothesis, effects=(*rest, one.name)))
                cost, key = _cost(every, fitted), (one.plain, "" if old is None else old.name)
                if not (one.kind.positive and fitted.of(one.name) < 0.0) and cost < kept.get(key, (np.inf,))[0]:
                    kept[key] = cost, one, old
    listed = sorted(kept.values(), key=lambda x: x[0])[: limits.CONTENDERS.value]
    return [(one, old) for _, one, old in listed]


def _put(found: Search, every: Study, one: Acting, old: Candidate | None) -> Search | None:
    """The search with an entry of the catalogue beside what was named, or in the place of one of them, about its own
    model and in its best shape, with a few draws; None where no arm is like it."""
    kept = tuple(other for other in found.named if other is not old)
    rest = tuple(name for name in every.hypothesis.effects if old is None or name != old.name)
    layout = every.layout
    named = [layout.find(name) for name in (*rest, one.name)]
    narrow = replace(layout, wide=False, own=tuple(dict.fromkeys((*layout.own, *named))))
    few = limits.FEW_DRAWS.value
    try:
        now = again(every, replace(every.hypothesis, effects=(*rest, one.name)), few, narrow)
        first = _judged(now, found, one.name)
        if first is None:
            return None
        names = (*kept, first)
        return shaped(replace(found, after=now, named=names, sets=tuple((x.name,) for x in names)), few)
    except (Undecided, ZygosError):
        return None


def _judged(study: Study, found: Search, name: str) -> Candidate | None:
    """A law that a study has, beside the others of its hypothesis; None where these runs do not tell them apart."""
    rest = tuple(other for other in study.hypothesis.effects if other != name)
    made = float(study.made[study.hypothesis.names.index(name)])
    without = replace(study, hypothesis=replace(study.hypothesis, effects=rest))
    return _candidate(without, found.before, study.layout.find(name), found.chance.threshold, made)


def widened(study: Study) -> Study:
    """The same study with every entry of the catalogue, beside a few draws of its twins: enough to rank them."""
    return laid_out(study, replace(study.layout, wide=True), limits.FEW_DRAWS.value)


def shortlisted(study: Study, every: Study, own: tuple[Acting, ...]) -> Study:
    """The study with those entries of the same study `widened` that explain most, alone or two together. own: entries
    that it has in any case."""
    hypothesis = every.hypothesis
    usual = {one.name for one in replace(study.layout, own=()).effects}
    left: dict[Acting, float] = {}
    for one in every.layout.effects:
        if one.name not in hypothesis.effects and possible(hypothesis, one):
            with suppress(Undecided):
                wider = replace(hypothesis, effects=(*hypothesis.effects, one.name))
                left[one] = _cost(every, every.of(wider))
    kept: list[Acting] = []
    seen: dict[str, int] = {}
    for one in sorted((x for x in left if x.name not in usual), key=left.__getitem__):
        if seen.get(one.plain, 0) < limits.LATE_SHAPES.value and (
            one.plain in seen or len(seen) < limits.LATE_ENTRIES.value
        ):
            seen[one.plain] = seen.get(one.plain, 0) + 1
            kept.append(one)
    # a momentum that is assumed is part of the right side: its column is no addition
    tried = [one for one in left if one.kind.key != "angular_momentum"]
    shares = shares_of_pairs(hypothesis, every.sums, every.weight, [one.name for one in tried])
    pairs = [(i, j) for i, j in combinations(range(len(tried)), 2) if tried[i].plain != tried[j].plain]
    for i, j in sorted(pairs, key=lambda at: -shares[at])[: limits.LATE_PAIRS.value]:
        kept += [tried[i], tried[j]]
    named = [every.layout.find(name) for name in hypothesis.effects if name not in {one.name for one in own}]
    return laid_out(study, replace(study.layout, wide=False, own=tuple(dict.fromkeys((*own, *named, *kept)))))


def _possible_of(study: Study) -> int:
    return sum(possible(study.hypothesis, one) for one in study.layout.effects)


def limits_beyond(study: Study, every: Study) -> tuple[Limit, ...]:
    """Of the entries that only the same study `widened` has, from which size on they would leave something over that
    the usual ones do not explain, and stand out of the twin on each run, nineteen times in twenty."""
    usual = {one.name for one in study.layout.effects}
    listed = [one for one in every.layout.effects if one.name not in usual and possible(every.hypothesis, one)]
    names = [one.name for one in listed]
    sigma = np.max([null_sigmas(every, names, [run]) for run in range(len(every.records))], axis=0)
    least = np.sqrt(allowed(study)[1] + limits.CHANCE_Z.value * study.wobble)
    out = []
    for one, own in zip(listed, sigma.tolist(), strict=True):
        with suppress(Undecided):
            unit = fit(every.hypothesis, every.sums, every.weight, target=one.name).rms / every.noise
            with np.errstate(divide="ignore"):
                seen = float(np.nanmin(least / unit))
            value = max((limits.NAMED_Z.value + limits.CHANCE_Z.value) * own, seen)
            if np.isfinite(value):
                out.append(Limit(one.name, one.kind, one.joint, one.shape, value))
    return tuple(out)


def unsteady(found: Search) -> tuple[Disagreement, ...]:
    """The named effects whose size is another on each run, by more than noise and than a trifle."""
    study, out = found.after, []
    for one in found.named:
        k = study.hypothesis.names.index(one.name)
        each, spread = (x[:, k] for x in study.by_run)
        apart = max(limits.AGREE_Z.value * spread.max(), limits.STEADY_SHARE.value * abs(float(study.value[k])))
        if np.ptp(each) > apart:
            other = float(each[np.argmax(np.abs(each - each[0]))])
            out.append(Disagreement(one.name, float(each[0]), other))
    return tuple(out)


def rivals(found: Search, every: Study) -> tuple[Acting, ...]:
    """Entries of the catalogue that have not been searched, and that may be what was named instead; of a law the best
    shape. every: the closed study `widened`.

    Each of two laws is tried beside the other (Davidson and MacKinnon's test of hypotheses of which neither contains
    the other): a right one leaves nothing for a wrong one to explain. So an entry counts that explains as much in the
    place of what was named and beside which that is not significant, or creates energy; and one that leaves less over
    and is significant beside it on each run. A law with a shape that becomes the named one is no rival: it contains it.
    """
    plain, usual = every.hypothesis, {one.name for one in found.before.layout.effects}
    listed = [one for one in every.layout.effects if one.name not in usual and possible(plain, one)]
    left = _cost(every, every.fit)
    kept: dict[str, tuple[float, Acting]] = {}
    for named in found.named:
        rest = tuple(name for name in plain.effects if name != named.name)
        for one in listed:
            if one.kind.becomes == named.kind.key and one.joint == named.joint:
                continue
            with suppress(Undecided):
                alone = every.of(replace(plain, effects=(*rest, one.name)))
                creates = one.kind.positive and alone.of(one.name) < 0.0
                if creates or min(completeness(found.before, alone.rms)) < limits.COMPLETE.value:
                    continue
                own = _cost(every, alone)
                if not (_stands_aside(every, named, one) or (own < left and _stands_out(every, one, found.chance))):
                    continue
                if one.plain not in kept or own < kept[one.plain][0]:
                    kept[one.plain] = own, one
    return tuple(one for _, one in kept.values())


def _stands_aside(every: Study, named: Candidate, one: Acting) -> bool:
    """Whether what was named is not significant beside another entry, or creates energy beside it."""
    both = replace(every.hypothesis, effects=(*every.hypothesis.effects, one.name))
    value = float(every.of(both).of(named.name))
    sigma = float(null_sigmas(replace(every, hypothesis=both), [named.name])[0])
    return abs(value) < limits.NAMED_Z.value * sigma or (named.kind.positive and value < 0.0)


def _stands_out(every: Study, one: Acting, luck: Chance) -> bool:
    """Whether an entry is significant on each run beside all that was named."""
    both = replace(every.hypothesis, effects=(*every.hypothesis.effects, one.name))
    for run in range(len(every.records)):
        value = float(every.of(both, [run]).of(one.name) - every.of_twin(both, [run]).of(one.name).mean())
        if abs(value) < luck.threshold * float(null_sigmas(every, [one.name], [run])[0]):
            return False
    return True


def with_rivals(basis: Study, every: Sequence[Acting]) -> Study:
    """A study whose search tries these entries of the catalogue as well."""
    return laid_out(basis, replace(basis.layout, own=(*basis.layout.own, *every)))


def polished(found: Search) -> Search:
    """The search with the best shapes of the named laws, without what they have no need of."""
    return _needed(shaped(found))


def shaped(found: Search, count: int = limits.DRAWS.value) -> Search:
    """The search with the shapes of the named laws between those of the catalogue's grid: the best of finer and finer
    grids, twice, and up to five times while a balance still leaves something over; beside a twin with `count` draws,
    where few are for a comparison, and twice is enough."""
    for number in range(limits.MOST_POLISHES.value):
        if number >= limits.POLISHES.value and (count < limits.DRAWS.value or not excess(found.after)):
            break
        for one in found.named:
            if one.shape is not None and one.kind.shape_varies:
                found = _reshaped(found, one, count)
    return found


def _needed(found: Search) -> Search:
    """The search without what stood in for a part of a law whose shape was not yet right."""
    for one in reversed(found.named):
        rest = tuple(name for name in found.after.hypothesis.effects if name != one.name)
        hypothesis = replace(found.after.hypothesis, effects=rest)
        if (
            len(found.named) < 2
            or min(completeness(found.before, found.after.of(hypothesis).rms)) < limits.COMPLETE.value
        ):
            continue
        with suppress(Undecided):
            less = struck(found, one)
            found = found if excess(less.after) else less
    return found


def struck(found: Search, one: Candidate) -> Search:
    """The search as if one of its names had not been given: the other coefficients are fitted without it, beside a twin
    of their own. Errors: Undecided where the runs do not tell them apart."""
    rest = tuple(name for name in found.after.hypothesis.effects if name != one.name)
    now = again(found.after, replace(found.after.hypothesis, effects=rest))
    kept = [k for k, other in enumerate(found.named) if other is not one]
    share = completeness(found.before, now.excess * found.before.noise)
    named, sets = tuple(found.named[k] for k in kept), tuple(found.sets[k] for k in kept)
    return replace(found, after=now, named=named, sets=sets, completeness=share)


def judged_beside(found: Search, study: Study) -> Search | None:
    """The search with the same names in another study of them on the same runs, which has more unknowns of the sensors;
    None where a name is no candidate beside these, they do not explain nearly everything, or another entry of the
    catalogue might take the place of one. Errors: Undecided where the runs do not tell the columns apart."""
    share = completeness(found.before, study.excess * study.noise)
    (each, spread), level, named = study.by_run, found.chance.threshold, []
    for one in found.named:
        k = study.hypothesis.names.index(one.name)
        value, own, sigma = float(study.value[k]), each[:, k].tolist(), spread[:, k].tolist()
        z = tuple(x / s for x, s in zip(own, sigma, strict=True))
        if min(map(abs, z)) < level or not _one_size(own, sigma, value) or (one.kind.positive and value < 0.0):
            return None
        named.append(replace(one, value=value, each=tuple(own), z=z, sigma=float(study.spread[k]), completeness=share))
    sets = tuple(_inseparable(one, study, found.before) for one in named)
    instead = replace(found, after=study, named=tuple(named), completeness=share, sets=sets)
    return None if min(share) < limits.COMPLETE.value or rivals(instead, widened(study)) else instead


def _reshaped(found: Search, one: Candidate, count: int) -> Search:
    after = found.after
    assert one.shape is not None
    shape: float = one.shape
    layout, plain = after.layout, one.name.partition("@")[0]
    own = [x.shape for x in layout.effects if x.plain == plain and x.shape is not None]
    # the best of a finer grid may lie at its end
    known = sorted({*(dict(layout.shapes).get(plain) or own), *one.kind.shapes, shape})
    at = min(range(len(known)), key=lambda k: abs(np.log(known[k] / shape)))
    low, high = known[max(at - 1, 0)], known[min(at + 1, len(known) - 1)]
    fine = tuple(float(f"{x:.6g}") for x in np.geomspace(low, high, limits.FINE_SHAPES.value))
    shapes = (*((name, grid) for name, grid in layout.shapes if name != plain), (plain, fine))
    others = tuple(name for name in after.hypothesis.effects if name != one.name)
    # what was named, and what cannot be told from it, is all that is still asked for
    kept = {*after.hypothesis.effects, *(name for names in found.sets for name in names)}
    told = tuple(x for x in layout.effects if x.name in kept)
    finer = tuple(layout.find(one.name)._replace(shape=x) for x in fine)
    study = laid_out(after, replace(layout, wide=False, shapes=shapes, own=(*told, *finer)), limits.FEW_DRAWS.value)
    best: tuple[float, str] | None = None
    for shape in fine:
        name = f"{plain}@{shape:.6g}"
        try:
            left = _total(study.of(replace(study.hypothesis, effects=(*others, name))).rms, study.noise)
        except Undecided:
            continue
        if best is None or left < best[0]:
            best = left, name
    if best is None or best[1] == one.name:
        return found
    chosen = replace(study.hypothesis, effects=(*others, best[1]))
    now = again(study, chosen, count)
    value = float(now.value[now.hypothesis.names.index(best[1])])
    again_named = replace(one, name=best[1], shape=now.layout.find(best[1]).shape, value=value)
    named = tuple(again_named if other is one else other for other in found.named)
    return replace(
        found, after=now, named=named, completeness=completeness(found.before, now.excess * now.noise),
        sets=tuple((again_named.name, *names[1:]) if names[0] == one.name else names for names in found.sets),
    )  # fmt: skip


def _freed(now: Study, listed: Sequence[Candidate]) -> Study | None:
    """The study with a few errors of sensors free that explain more than any candidate does, and half of
    what the fit costs; None where there are none. What the arm file says of the sensors spreads a large error of one of
    them over several."""
    bar = cost = price(now, now.fit)
    kept: Hypothesis | None = None
    layout = now.layout
    while len(layout.loose) < limits.MOST_FREED.value:
        fitted = now.fit if kept is None else now.of(kept)
        bound = now.layout.of_torque | np.array([name in layout.loose for name in layout.zeros])
        pulls = np.where(bound, 0.0, np.abs((now.applied + fitted.zeros) / layout.declared_sigma).max(axis=0))
        tried = []
        for k in np.argsort(-pulls)[: limits.FREED_AT_A_TIME.value]:
            if pulls[k] > limits.LARGE_ERROR_Z.value:
                free = replace(layout, loose=(*layout.loose, layout.zeros[k]))
                hypothesis = replace(now.hypothesis, layout=free)
                tried.append((price(replace(now, hypothesis=hypothesis), now.of(hypothesis)), hypothesis))
        least, best = min(tried, key=lambda one: one[0], default=(np.inf, now.hypothesis))
        if not _worth(cost, least):
            break
        cost, kept, layout = least, best, best.layout
    if kept is None:
        return None
    passing = (one for one in listed if one.passes)
    best_one = min(passing, key=lambda one: one.left + one.paid, default=None)
    if best_one is not None:
        wider = replace(now.hypothesis, effects=(*now.hypothesis.effects, best_one.name))
        bar = price(now, now.of(wider))
    if cost < bar:
        with suppress(Undecided):
            return again(again(now, kept, limits.FEW_DRAWS.value), kept)
    return None


def _worth(held: float, free: float) -> bool:
    """Whether to free an error of a sensor, from what fits cost."""
    return held - free > max((1.0 - limits.FREED_LEAVES.value) * held, limits.LARGE_ERROR_Z.value**2)


def _held_again(now: Study) -> Study:
    """The study without freedom of those errors of sensors that explain little of what it costs to hold them."""
    for name in now.layout.loose:
        held = replace(now.layout, loose=tuple(other for other in now.layout.loose if other != name))
        hypothesis = replace(now.hypothesis, layout=held)
        cost = price(replace(now, hypothesis=hypothesis), now.of(hypothesis))
        if not _worth(cost, price(now, now.fit)):
            now = again(now, hypothesis)
    return now


def _paired(now: Study, listed: Sequence[Candidate], level: float) -> tuple[list[Candidate], Study] | None:
    """The two candidates that explain everything together where each alone passes for nothing, the best such pair, and
    the study with both."""
    best: list[Candidate] | None = None
    for first, second in _promising(now, listed):
        wider = replace(now.hypothesis, effects=(*now.hypothesis.effects, first.name, second.name))
        try:
            share = completeness(now, now.of(wider).rms)
            if min(share) < limits.COMPLETE.value:
                continue
            each = [_beside(now, first, second, level), _beside(now, second, first, level)]
        except Undecided:
            continue
        found = [one for one in each if one is not None and one.passes]
        if len(found) == 2 and (best is None or found[1].left < best[1].left):
            best = found
    if best is not None:
        both = (*now.hypothesis.effects, *(candidate.name for candidate in best))
        with suppress(Undecided):
            return best, again(now, replace(now.hypothesis, effects=both))
    return None


def _promising(now: Study, listed: Sequence[Candidate]) -> Iterator[tuple[Candidate, Candidate]]:
    """Pairs of different laws that may explain everything, by one solve for all of them."""
    # a momentum that is assumed is part of the right side: its column is no addition
    plain = [one for one in listed if one.kind.key != "angular_momentum"]
    at = {one.name: k for k, one in enumerate(plain)}
    shares = shares_of_pairs(now.hypothesis, now.sums, now.weight, [one.name for one in plain])
    for first, second in combinations(listed, 2):
        if first.name.partition("@")[0] == second.name.partition("@")[0]:
            continue
        known = first.name in at and second.name in at
        if not known or shares[at[first.name], at[second.name]] > limits.PROMISING.value:
            yield first, second


def _beside(now: Study, other: Candidate, one: Candidate, level: float) -> Candidate | None:
    """A candidate judged beside another."""
    effects = (*now.hypothesis.effects, other.name)
    beside = replace(now, hypothesis=replace(now.hypothesis, effects=effects))
    return _candidate(beside, now, now.layout.find(one.name), level)


def _retest(named: list[Candidate], now: Study, before: Study) -> tuple[list[Candidate], Study]:
    """Earlier names once more beside the later ones: a first guess may have stood for two others."""
    for candidate in list(named):
        rest = tuple(name for name in now.hypothesis.effects if name != candidate.name)
        without = completeness(before, now.of(replace(now.hypothesis, effects=rest)).rms)
        if len(named) > 1 and min(without) > limits.COMPLETE.value and candidate.of_rest < limits.REST.value:
            named = [other for other in named if other is not candidate]
            now = again(now, replace(now.hypothesis, effects=rest))
    return named, now


def _grown(now: Study, named: Sequence[Candidate], best: Candidate) -> tuple[Study, list[Candidate]]:
    """The study with one candidate more, and without those named before that would create energy beside it, which
    stood for a part of it; and these. Errors: Undecided where the runs do not tell them apart."""
    grown = again(now, replace(now.hypothesis, effects=(*now.hypothesis.effects, best.name)))
    turned = [one for one in named if one.kind.positive and grown.fit.of(one.name) < 0.0]
    if turned:
        gone = {one.name for one in turned}
        kept = tuple(name for name in grown.hypothesis.effects if name not in gone)
        grown = again(grown, replace(grown.hypothesis, effects=kept))
    return grown, turned


def _simplest(best: Candidate | None, listed: Sequence[Candidate]) -> Candidate | None:
    """The candidate, or the law without a shape that it becomes where that explains as much."""
    if best is None or not best.kind.becomes:
        return best
    enough = best.complete - limits.SHAPE_GAINS.value
    plain = (one for one in listed if one.kind.key == best.kind.becomes and one.joint == best.joint and one.passes)
    return next((one for one in plain if one.complete >= enough), best)


def candidates(now: Study, before: Study, level: float) -> tuple[Candidate, ...]:
    """All that could be added to a study's hypothesis, best first. level: deviations that are asked on each run."""
    out = [_candidate(now, before, one, level) for one in now.layout.effects if possible(now.hypothesis, one)]
    return tuple(sorted((one for one in out if one is not None), key=lambda one: one.left + one.paid))


def possible(hypothesis: Hypothesis, one: Acting) -> bool:
    """Whether an entry of the catalogue could be added to a hypothesis. A law is not added with a second shape, and one
    that is left out does not come back as another one that becomes it."""
    if one.kind.left_out(hypothesis.without) or one.plain in {name.partition("@")[0] for name in hypothesis.effects}:
        return False
    if one.kind.place == "rotor":
        return hypothesis.uncoupled[one.joint]
    if one.kind.place == "base" and one.kind.law is None:
        return bool(hypothesis.uncentred)
    # nothing deflects at a rigid joint; motor and link turn as one there, and so cannot be told apart
    return not (one.joint >= 0 and hypothesis.rigid[one.joint] and one.kind.place == "spring")


def _candidate(now: Study, before: Study, one: Acting, level: float, made: float = 0.0) -> Candidate | None:
    """An entry beside a study's hypothesis. made: the size with which its twins were made."""
    name, kind, joint = one.name, one.kind, one.joint
    wider = replace(now.hypothesis, effects=(*now.hypothesis.effects, name))
    runs = range(len(now.records))
    try:
        whole = now.of(wider)
        each = [now.of(wider, [k]) for k in runs]
        null = [now.of_twin(wider, [k]).of(name) for k in runs]
        null_all = now.of_twin(wider).of(name)
    except Undecided:
        return None
    value = float(whole.of(name) - null_all.mean()) + made
    found = [float(one.of(name)) for one in each]
    z = [(x - draw.mean() + made) / draw.std(ddof=1) for x, draw in zip(found, null, strict=True)]
    sigma = float(null_all.std(ddof=1))
    *first, last = runs
    plain, with_it = now.of(now.hypothesis, first).value, now.of(wider, first).value
    frozen = _cost(now, now.of(wider, [last], with_it), [last]) / _cost(
        now, now.of(now.hypothesis, [last], plain), [last]
    )
    share = completeness(before, whole.rms)
    against: Against = ""
    if min(abs(one) for one in z) < level:
        against = "insignificant"
    elif not _one_size(found, [float(draw.std(ddof=1)) for draw in null], float(whole.of(name))):
        against = "inconsistent"
    elif kind.positive and value < 0.0:
        against = "negative"
    elif frozen >= 1.0:
        against = "not transferable"
    elif kind.key == "rotor_coupling" and not (
        limits.COUPLING.value[0] < value / whole.of(f"Im{joint + 1}") < limits.COUPLING.value[1]
    ):
        against = "not the rotor"
    return Candidate(
        name,
        kind,
        joint,
        one.shape,
        value,
        tuple(found),
        tuple(float(one) for one in z),
        sigma,
        share,
        min(completeness(now, whole.rms)),
        _total(whole.rms, now.noise),
        float(paid(now, whole).sum()),
        frozen,
        _limit(now, name, null, level),
        against,
    )


def _one_size(each: Sequence[float], sigma: Sequence[float], pooled: float) -> bool:
    """Whether the coefficients of the runs, with these deviations, and that of all runs together are one.

    Where a law acts elsewhere than its column, the other coefficients of each run make up for it, and may let the runs
    agree; one set of them for all runs cannot (Hausman's test: of a right model the runs' coefficients scatter about
    the pooled one by no more than their own deviation).
    """
    trifle = limits.AGREE_SHARE.value * abs(pooled)
    if min(each) < 0.0 < max(each) or max(each) - min(each) > max(limits.AGREE_Z.value * max(sigma), trifle):
        return False
    return all(abs(x - pooled) <= max(limits.AGREE_Z.value * s, trifle) for x, s in zip(each, sigma, strict=True))


def _total(rms: Array, noise: Array) -> float:
    return float(np.nansum((rms / noise) ** 2))


def _cost(study: Study, found: Fit, runs: Sequence[int] | None = None) -> float:
    """Sum of rho^2 that a fit of some runs leaves over, and what it pays for errors of sensors."""
    noise = study.noise if runs is None else study.noise[list(runs)]
    return _total(found.rms, noise) + float(paid(study, found, runs).sum())


def _limit(now: Study, name: str, null: list[Array], level: float) -> float:
    """The size at which a candidate passes on these runs nineteen times in twenty: it must stand out of its twin and,
    where noise does not hide it, leave an excess behind that the other coefficients do not absorb."""
    stand_out = (level + limits.CHANCE_Z.value) * max(float(draw.std(ddof=1)) for draw in null)
    if noisy(now):
        return stand_out
    unit = fit(now.hypothesis, now.sums, now.weight, target=name).rms / now.noise
    return max(stand_out, float(np.sqrt(limits.EXCESS.value) / np.min(np.nanmax(unit, axis=1))))


def _inseparable(candidate: Candidate, now: Study, before: Study) -> tuple[str, ...]:
    """The candidate, and what explains as much in its place while it is not significant beside it.

    Where a law in its best shape leaves something over, it is not exactly this law, and which of its family is nearest
    is open.
    """
    open_form = candidate.kind.shape_varies and float(np.nanmax(now.excess)) > limits.CLOSED_BALANCE.value
    rest = tuple(name for name in now.hypothesis.effects if name != candidate.name)
    together = [candidate.name]
    seen = {candidate.name.partition("@")[0]}
    for one in now.layout.effects:
        kind, other = one.kind, one.name
        if not possible(now.hypothesis, one) or one.plain in seen:
            continue
        instead = replace(now.hypothesis, effects=(*rest, other))
        both = replace(now.hypothesis, effects=(*now.hypothesis.effects, other))
        try:
            alone = now.of(instead)
            if min(completeness(before, alone.rms)) < limits.COMPLETE.value:
                continue
            if kind.positive and alone.of(other) < 0.0:
                continue
        except Undecided:
            continue
        if open_form and (kind.family, one.joint) == (candidate.kind.family, candidate.joint):
            together.append(other)
            seen.add(one.plain)
            continue
        try:
            beside, spread = now.of(both).of(candidate.name), now.of_twin(both).of(candidate.name).std(ddof=1)
        except Undecided:
            together.append(other)
            seen.add(one.plain)
            continue
        if abs(float(beside)) < limits.NAMED_Z.value * float(spread):
            together.append(other)
            seen.add(one.plain)
    return tuple(together)
