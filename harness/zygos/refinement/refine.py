# SPDX-License-Identifier: MIT
"""Parameters near the information limit from recorded runs, by least squares for all readings (docs/theory.md, "All
readings at once").

The estimate from energy rows is the start. Solutions with very noisy torques bring the parameters into the range in
which the motion is linear; then the noise that the readings favour most is found. The values are published only if
everything that can be checked without knowing the truth speaks for the model: see `Rule`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import TORQUE_STEP, Arm
from zygos.can.run import Run, joined
from zygos.effects import Effect, gains
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import Estimation, estimate
from zygos.files.output import number
from zygos.model.model import Model, Quantity
from zygos.native.flight import CHANNELS
from zygos.native.refiner import NORMAL_95
from zygos.quantiles import chi_square_isf, normal_isf
from zygos.refinement.blocks import blocks_of, within_memory
from zygos.refinement.bound import Bound, bound_from
from zygos.refinement.follow import Pass, triangle_of
from zygos.refinement.motion import FlexibleMotion
from zygos.refinement.record import Record, record_of
from zygos.refinement.rivals import Rival, rivals, typical_torque
from zygos.refinement.search import REMEDY, Found, Search
from zygos.refinement.sections import report_refinement
from zygos.refinement.start import LEARNED, begin
from zygos.report.values import Valued

Floats = NDArray[np.float64]
Progress = Callable[[float], None]

_WINDOWS = 12
"""Windows in which the innovations are counted apart."""
UNNEEDED = ("angular_momentum",)
"""Effects that stay as they are: the rates of the base are followed, whatever momentum they have."""


@dataclass(frozen=True)
class Rule:
    """A condition for publication."""

    key: str
    title: str
    """What is checked, in words."""
    value: float
    """What was found."""
    limit: float
    """The largest value that passes."""
    holds: bool
    sentence: str
    """What it means that the rule failed; empty where it holds."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "key": self.key,
            "title": self.title,
            "value": self.value,
            "limit": self.limit,
            "holds": self.holds,
            "sentence": self.sentence or None,
        }


@dataclass(frozen=True, eq=False)
class Refinement(Valued):
    """What a refinement has found; p parameters, e effects."""

    arm: Arm
    record: Record
    energy: Estimation
    """The estimate from energy rows, with which it began and which it must agree with."""
    final: Pass
    """The solution at the level that was found."""
    level: tuple[float, ...]
    """(N,) noise of the torques as a share of their size, found."""
    declared: tuple[float, ...]
    """(N,) the same, by the arm file."""
    level_error: float
    """Standard error of the logarithm of the level; 0 where the level is 0."""
    tried: tuple[tuple[float, float], ...]
    """Each level that was tried with its deviance, largest joint."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    size: Floats
    """(p,) as `FlexibleMotion.size`."""
    effects: tuple[Effect, ...]
    """(e,) with their values and sigmas."""
    prior: Model | None
    limit: Bound | None
    """The bound of the same motion at the level found; None where the motion does not determine everything."""
    rivals: tuple[Rival, ...]
    """Models with one thing more."""
    rules: tuple[Rule, ...] = ()
    runs: tuple[Run, ...] = ()
    """What it was made from."""
    shortened: bool = False
    """Whether the record is only the beginning of the runs, which the memory holds."""

    @property
    def value(self) -> Floats:
        """(p,) in `units`, whether published or not."""
        return self.final.value

    @property
    def sigma(self) -> Floats:
        """(p,) standard deviations."""
        return np.sqrt(np.diag(self.final.covariance))

    @property
    def covariance(self) -> Floats:
        """(p, p) covariance of the values."""
        return self.final.covariance

    @property
    def half95(self) -> Floats:
        """(p,) half widths of the 95 % intervals."""
        return NORMAL_95 * self.sigma

    @property
    def published(self) -> bool:
        """Whether all rules hold."""
        return all(rule.holds for rule in self.rules)

    @property
    def part(self) -> str:
        """Of what the values are, where the memory was too small for all, such as the first 20 of 60 minutes; otherwise
        empty."""
        whole = (self.record.cycles + self.record.left_out) * self.arm.period_s / 60.0
        used = self.record.cycles * self.arm.period_s / 60.0
        return f"the first {number(used, 3)} of {number(whole, 3)} minutes" if self.shortened else ""

    @property
    def reason(self) -> str:
        """Which rules failed and what follows, in a sentence; empty where all hold."""
        failed = [rule.sentence for rule in self.rules if not rule.holds]
        return "; ".join(failed)

    @property
    def squares(self) -> Floats:
        """(channels,) mean normalised squared innovation of all readings."""
        return _means(self.final, slice(None))

    @property
    def windows(self) -> tuple[tuple[slice, Floats], ...]:
        """Parts of the readings, and (channels,) as `squares` of each."""
        edges = np.linspace(0, len(self.final.squares), _WINDOWS + 1).astype(int)
        parts = [slice(int(a), int(b)) for a, b in pairwise(edges)]
        return tuple((part, _means(self.final, part)) for part in parts)

    def band(self, readings: int) -> Floats:
        """(channels,) the largest mean of so many readings of the arm that passes: of all channels and windows,
        chance exceeds it once in 1 / FALSE_ALARM complete models."""
        counts = readings * self.final.counts
        looks = (_WINDOWS + 1) * int(np.count_nonzero(counts))
        means = np.full(len(counts), np.inf)
        means[counts > 0.0] = (
            chi_square_isf(limits.FALSE_ALARMS.value / looks, counts[counts > 0.0]) / counts[counts > 0.0]
        )
        return np.asarray(limits.INNOVATION_EXCESS.value + means)

    @property
    def times_bound(self) -> Floats | None:
        """(p,) sigmas divided by the bound; None where there is none."""
        return None if self.limit is None else self.sigma / self.limit.sigma

    def as_dict(self, heading: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """All of it in numbers, texts, lists and dictionaries: what `zygos refine --json` writes behind a heading."""
        return report_refinement(self, heading or {})

    def __repr__(self) -> str:
        """Whether it is published, and a line for each parameter where it is."""
        lines = ["published" if self.published else f"not published: {self.reason}"]
        for name, unit, value, half in zip(self.names, self.units, self.value, self.half95, strict=True):
            if self.published:
                lines.append(f"{name:<18}{value:>14.7g} ± {half:<10.2g} {unit}")
        return "\n".join(lines)

    def to_model(self) -> Model:
        """The model with the refined values. Errors: Undecided where a rule failed."""
        if not self.published:
            raise Undecided(f"not published: {self.reason}; remedy: {REMEDY}")
        quantities = {
            name: Quantity(float(value), float(sigma), "zygos", unit)
            for name, unit, value, sigma in zip(self.names, self.units, self.value, self.sigma, strict=True)
        }
        kept = () if self.prior is None else tuple(one for one in self.prior.effects if one.kind.key in UNNEEDED)
        return Model(name=self.arm.name, parameters=quantities, effects=(*kept, *self.effects))


def refine_runs(
    runs: Run | Sequence[Run],
    *,
    model: Model | None = None,
    energy: Estimation | None = None,
    progress: Progress = lambda share: None,
) -> Refinement:
    """Estimate the parameters of an arm with flexible joints from all that the readings of one or several runs hold.

    `Refinement.published` says whether the values can be trusted; where it is false, `reason` says which rules failed.
    model: its Coulomb frictions of motors and offsets of torques are estimated as well, and its values are the start of
    parameters that energy rows do not determine. energy: the estimate from energy rows of the same runs and model,
    where there is one already. Of runs whose derivatives would take more than 1 GB, the beginning is refined (`part`).
    progress is called now and then with the share that is done.

    Errors: ZygosError where the arm or the model has what a refinement does not know; Undecided where energy rows give
    no start, or the values do not settle.
    """
    runs = (runs,) if isinstance(runs, Run) else tuple(runs)
    if not runs:
        raise ZygosError("there is no run to refine from; remedy: give at least one")
    arm = runs[0].arm
    check_supported(arm, () if model is None else model.effects)
    named = () if model is None else tuple(one for one in model.effects if one.kind.key in LEARNED)
    effects = (*(one for one in named if not one.kind.gain), *gains(arm))
    whole = record_of(arm, runs)
    blocks = within_memory(blocks_of(whole), len(arm.parameters)) if whole.pieces else None
    record = whole if blocks is None else blocks.record
    energy = estimate(joined(runs), model=model) if energy is None else energy
    progress(0.02)
    start, around, beside = begin(arm, energy, model, effects, record)
    assert blocks is not None  # `begin` refuses a record without pieces
    search = Search(arm, blocks, start, around, beside, lambda share: progress(0.02 + 0.96 * share))
    found = search.run()
    final, levels = found.final, search.levels(found.level)
    motion = FlexibleMotion(arm, final.value)
    learned = tuple(
        replace(one, value=float(value), sigma=float(sigma), source="zygos")
        for one, value, sigma in _learned(arm, effects, final)
    )
    answer = Refinement(
        arm,
        record,
        energy,
        final,
        levels,
        tuple(joint.torque_relative_sigma for joint in arm.joints),
        found.error,
        found.tried,
        arm.parameter_names,
        arm.parameter_units,
        motion.size,
        learned,
        model,
        _limit(motion, record, found, levels),
        rivals(arm, final, found.prior),
    )
    progress(1.0)
    return replace(answer, rules=_rules(answer), runs=runs, shortened=record is not whole)


def _limit(motion: FlexibleMotion, record: Record, found: Found, levels: Sequence[float]) -> Bound | None:
    """The bound of the motion that was followed: what the readings alone tell of the parameters, where nobody knows
    states, biases, gains and zeros."""
    p, n = len(motion.size), motion.arm.n
    unknown = np.flatnonzero(found.prior.solved >= p + 2 * n)
    known = np.zeros((len(unknown), len(unknown) + p))
    known[:, : len(unknown)] = found.prior.root[np.ix_(unknown, unknown)]
    columns = [*found.prior.solved[unknown].tolist(), *range(p)]
    information = triangle_of(np.concatenate([found.final.triangle[:, columns], known]))
    try:
        return bound_from(motion, information[len(unknown) :, len(unknown) :], np.array(levels), record.cycles)
    except Undecided:
        return None


def _rules(answer: Refinement) -> tuple[Rule, ...]:
    """The rules, in the order in which their sentences are worth reading."""
    return (_energy_rule(answer.energy), _agreement(answer), _innovations(answer), _level(answer), _rival(answer))


def _energy_rule(energy: Estimation) -> Rule:
    """Whether the estimate from energy rows can vouch for the refined one."""
    holds = energy.validity in ("valid", "partial")
    text = f"the estimate from energy rows, which has to vouch for these values, is {energy.validity}: {energy.reason}"
    return Rule(
        "energy",
        "the estimate from energy rows is valid or partial",
        float(not holds),
        0.0,
        holds,
        "" if holds else text,
    )


def _agreement(answer: Refinement) -> Rule:
    """Whether both estimates agree where both have values."""
    p = len(answer.names)
    value, sigma = answer.energy.value[:p], answer.energy.sigma[:p]
    known = np.isfinite(value) & np.isfinite(sigma)
    apart = np.abs(np.where(known, value - answer.value, 0.0))
    # all values are looked at, and the farthest one decides
    sigmas = float(normal_isf(0.5 * limits.FALSE_ALARMS.value / max(1, known.sum())))
    allowed = sigmas * np.hypot(np.where(known, sigma, 0.0), answer.sigma) + limits.ENERGY_BIAS.value * answer.size
    worst = int(np.argmax(apart / allowed))
    ratio = float(apart[worst] / allowed[worst])
    text = (
        f"{answer.names[worst]} is {number(float(answer.value[worst]))} {answer.units[worst]}, but energy rows say "
        f"{number(float(value[worst]))}, which is {number(ratio, 2)} times farther than both intervals allow"
    )
    return Rule(
        "agreement",
        "distance from the estimate by energy rows, in what both intervals allow",
        ratio,
        1.0,
        ratio <= 1.0,
        "" if ratio <= 1.0 else text,
    )


def _innovations(answer: Refinement) -> Rule:
    """Whether no channel has larger innovations than the model expects, in the whole and in each window."""
    parts = [(slice(0, len(answer.final.squares)), answer.squares), *answer.windows]
    ratios = np.array([means / answer.band(part.stop - part.start) for part, means in parts])
    place, channel = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
    part, means = parts[int(place)]
    worst = float(ratios[place, channel])
    where = "of all readings" if place == 0 else f"of readings {part.start:,} to {part.stop:,}"
    text = (
        f"the innovations of the {CHANNELS[channel]} are too large: the mean normalised square {where} is "
        f"{number(float(means[channel]), 3)}, at most {number(float(answer.band(part.stop - part.start)[channel]), 3)} "
        "would be noise"
    )
    return Rule(
        "innovations",
        "normalised squared innovations, largest of the channels and windows, in what passes",
        worst,
        1.0,
        worst <= 1.0,
        "" if worst <= 1.0 else text,
    )


def _level(answer: Refinement) -> Rule:
    """Whether the torques are not noisier than declared."""
    typical = typical_torque(answer.record)
    own = np.array([math.hypot(joint.torque_sigma, TORQUE_STEP / math.sqrt(12.0)) for joint in answer.arm.joints])
    declared = np.array(answer.declared) * math.exp(limits.RULE_Z.value * answer.level_error)
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = np.hypot(declared, np.nan_to_num(limits.LINEAR_ERROR.value * own / typical))
    found = np.array(answer.level)
    worst = int(np.argmax(found - allowed))
    holds = bool(np.all(found <= allowed))
    text = (
        f"the readings need torques with noise of {number(100.0 * float(found[worst]), 2)} % of their size at "
        f"{answer.arm.joints[worst].name}, and the arm file declares "
        f"{number(100.0 * float(answer.declared[worst]), 2)} % (torque_relative_sigma)"
    )
    return Rule(
        "level",
        "noise of the torques as a share of their size, found",
        float(found[worst]),
        float(allowed[worst]),
        holds,
        "" if holds else text,
    )


def _rival(answer: Refinement) -> Rule:
    """Whether no model with one thing more follows the readings far better."""
    worst = max(answer.rivals, key=lambda one: one.sigmas, default=None)
    sigmas = 0.0 if worst is None else worst.sigmas
    text = (
        ""
        if worst is None
        else (
            f"the readings are followed better with {worst.title} ({number(worst.value, 2)} {worst.unit}, "
            f"{number(worst.sigmas, 2)} σ)"
        )
    )
    return Rule(
        "rivals",
        "standard deviations by which the readings favour a model with one thing more",
        sigmas,
        limits.RIVAL_Z.value,
        sigmas <= limits.RIVAL_Z.value,
        "" if sigmas <= limits.RIVAL_Z.value else text,
    )


def check_supported(arm: Arm, effects: Sequence[Effect]) -> None:
    """Refuse what a refinement does not know. Errors: ZygosError naming it and the remedy."""
    FlexibleMotion(arm, np.ones(len(arm.parameters)))
    other = sorted({one.kind.key for one in effects} - set(LEARNED) - set(UNNEEDED))
    if other:
        raise ZygosError(
            f"the model has effects that a refinement does not know ({', '.join(other)}); remedy: estimate them with "
            f"`zygos estimate --model`, or leave them out of the model of --model; it knows {' and '.join(LEARNED)}"
        )
    if arm.torque_law == "sampled":
        raise ZygosError(
            f"arm {arm.name}: a refinement needs torques that are held from SYNC to SYNC, but these are sampled; "
            'remedy: record commanded torques, and state torque_law = "applied_from_sync" or "applied_previous_cycle"'
        )
    if arm.torque_unit != "Nm":
        raise ZygosError(
            f"arm {arm.name}: the torques are motor currents, and a refinement needs Nm; remedy: `zygos estimate`"
        )
    wire = arm.over_the_wire
    noise = [one.sigma_rad for joint in wire.joints for one in (joint.link_encoder, joint.motor_encoder)]
    if min([*noise, wire.imu.rate_sigma] if arm.free else noise) <= 0.0:
        raise ZygosError(f"arm {arm.name}: the noise of a sensor is 0; remedy: state the steps of all encoders")
    if arm.free and arm.imu.latch_us:
        raise ZygosError(
            f"arm {arm.name}: the gyro latches {arm.imu.latch_us} µs after SYNC, and a refinement takes its rates at "
            "SYNC; remedy: `zygos estimate`, or a gyro that latches at SYNC"
        )


def _learned(arm: Arm, effects: Sequence[Effect], found: Pass) -> list[tuple[Effect, float, float]]:
    """Each effect with value and sigma."""
    at = [LEARNED.index(one.kind.key) * arm.n + one.index(arm) for one in effects]
    return [(one, found.beside[k], found.beside_sigma[k]) for one, k in zip(effects, at, strict=True)]


def _means(found: Pass, part: slice) -> Floats:
    """(channels,) mean normalised squared innovation of some readings; 1 where a channel has none."""
    counts = np.where(found.counts > 0.0, found.counts, 1.0)
    return np.where(found.counts > 0.0, found.squares[part].mean(axis=0) / counts, 1.0)
