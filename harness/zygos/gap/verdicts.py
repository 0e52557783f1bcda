# SPDX-License-Identifier: MIT
"""The verdicts on a simulation and what must be added to them, as data; `zygos.gap.sentences` says them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from zygos import limits
from zygos.gap.adopted import Check
from zygos.gap.changes import Change
from zygos.gap.findings import Disagreement, Finding, Value
from zygos.gap.payload import PayloadValue

Answer = Literal[
    "nothing missing", "values differ", "named", "part named", "changed", "plain estimate", "cannot tell", "unknown"
]


@dataclass(frozen=True)
class NothingMissing:
    """Every balance closes, and no value differs."""

    answer: ClassVar[Answer] = "nothing missing"


@dataclass(frozen=True)
class ValuesDiffer:
    """The equations are right, and some values are not."""

    answer: ClassVar[Answer] = "values differ"
    changed: tuple[Value, ...]


@dataclass(frozen=True)
class Lacking:
    """The simulation lacks effects that were named."""

    answer: ClassVar[Answer] = "named"
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Remainder:
    """What the named effects leave over on the untouched run, or of a balance."""

    where: str
    """A joint, or a balance."""
    size: float
    unit: str
    """Nm, sigma or 1 (a ratio to the floor)."""
    floor: float
    """What noise alone would leave over, in the same unit; NaN where it is not known."""
    over: str
    """What it varies with most: rate, angle, deflection, load, time; empty where it varies with none."""
    share: float
    """Share of its square that goes with that."""


@dataclass(frozen=True)
class PartNamed:
    """The family, place and size of effects were found, but something is left over: the law is not exactly this."""

    answer: ClassVar[Answer] = "part named"
    findings: tuple[Finding, ...]
    left: tuple[Remainder, ...]
    """Largest first."""
    unsteady: tuple[Disagreement, ...] = ()
    """Sizes of effects, by column, that differ between the runs by more than noise."""


@dataclass(frozen=True)
class Inseparable:
    """Effects would explain the runs that these do not tell from others."""

    answer: ClassVar[Answer] = "cannot tell"
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class SkewedEncoders:
    """What parts link and motor of a joint goes with its rate, as if one encoder latched later than the other."""

    answer: ClassVar[Answer] = "unknown"
    joint: str
    skew_s: float


@dataclass(frozen=True)
class LateTorques:
    """The torques act later than the arm file says."""

    answer: ClassVar[Answer] = "unknown"
    periods: float
    """SYNC periods."""


@dataclass(frozen=True)
class WrongGravity:
    """Gravity is another than the arm file says."""

    answer: ClassVar[Answer] = "unknown"
    found: tuple[float, float, float]
    """m/s^2, in base axes."""
    stated: tuple[float, float, float]
    """m/s^2, in the arm file."""


@dataclass(frozen=True)
class DeclaredTooNoisy:
    """The balances close better than the declared noise of the sensors allows."""

    answer: ClassVar[Answer] = "unknown"
    least: float
    """The smallest residual, in units of the null twin's."""


@dataclass(frozen=True)
class RunsDisagree:
    """Each run closes by itself, with values that are not those of the other."""

    answer: ClassVar[Answer] = "unknown"
    parameters: tuple[Disagreement, ...]


@dataclass(frozen=True)
class Changed:
    """The arm, or what acts on it, is another from an instant on."""

    answer: ClassVar[Answer] = "changed"
    change: Change
    runs: tuple[str, ...]
    """Names of the runs."""
    payload: tuple[PayloadValue, ...] = ()
    """The change of bodies as a payload of the last one; empty where it is none, or not identified."""


@dataclass(frozen=True)
class Unexplained:
    """The catalogue does not hold what is missing."""

    answer: ClassVar[Answer] = "unknown"
    residual: float
    """The largest that is left over, in units of the null twin's."""
    guess: tuple[str, ...]
    """Columns of the best guess; empty where none passed."""
    completeness: float
    """Share of the excess that the guess takes away."""
    partly: tuple[Finding, ...]
    """What a part of it looks like; empty where the guess explains too little."""
    untouched: bool = True
    """Whether an untouched run shows it; else only the measured ones, which were fitted."""
    unsigned: tuple[Finding, ...] = ()
    """Of the guess, effects whose interval does not even contain one sign alone."""


@dataclass(frozen=True)
class NotPredicted:
    """Effects would explain the balances, but predict the untouched run no better."""

    answer: ClassVar[Answer] = "unknown"
    findings: tuple[Finding, ...]
    closed_median: float
    """Of the errors of predictions with the effects, sigma."""
    struck_median: float
    """The same without them."""


@dataclass(frozen=True)
class Unpredicted:
    """Every balance closes, but an untouched run is predicted far worse than noise and the errors of values allow."""

    answer: ClassVar[Answer] = "unknown"
    run: str
    median: float
    """Of the errors of predictions, sigma."""
    allowed: float
    """The largest median of the same model on its own twin, also with redrawn values, sigma."""


@dataclass(frozen=True)
class PlainEstimate:
    """The model with what was found does not pass the gate, and that of `zygos estimate` does."""

    answer: ClassVar[Answer] = "plain estimate"
    failed: tuple[Check, ...]
    """What the model with what was found does not meet."""
    findings: tuple[Finding, ...]
    """What it has beside the simulation."""
    left: tuple[Remainder, ...] = ()
    """What the plain estimate leaves over on the untouched runs, the largest first; empty where it closes."""


@dataclass(frozen=True)
class NotAdmissible:
    """Neither the model with what was found nor that of `zygos estimate` passes the gate."""

    answer: ClassVar[Answer] = "unknown"
    failed: tuple[Check, ...]
    """What the model with what was found does not meet."""
    findings: tuple[Finding, ...]


ArmFileFirst = SkewedEncoders | LateTorques | WrongGravity | DeclaredTooNoisy
"""The arm file has to be put right before anything can be said."""
Verdict = (
    NothingMissing
    | ValuesDiffer
    | Lacking
    | PartNamed
    | Changed
    | Inseparable
    | ArmFileFirst
    | RunsDisagree
    | Unexplained
    | NotPredicted
    | Unpredicted
    | PlainEstimate
    | NotAdmissible
)

_CLOSES = (limits.CLOSED_BALANCE, limits.CLOSED)
_NAMES = (limits.NAMED_Z, limits.FALSE_ALARMS, limits.COMPLETE, limits.MATERIAL, *_CLOSES)
_DECIDED: dict[type[Verdict], tuple[limits.Limit[float], ...]] = {
    NothingMissing: _CLOSES,
    ValuesDiffer: (limits.DIFFERS_Z, limits.MATERIAL_DIFFERENCE, *_CLOSES),
    Lacking: _NAMES,
    PartNamed: _NAMES,
    Changed: (limits.CHANGE_Z, limits.CHANGE_TAKES),
    Inseparable: (limits.STANDS_IN, *_NAMES),
    SkewedEncoders: (limits.DEFLECTED_Z, limits.SKEWED),
    LateTorques: (limits.LATE, limits.LATE_EXPLAINS, limits.LATE_ALIKE),
    WrongGravity: (limits.GRAVITY_OFF, limits.GRAVITY_EXPLAINS),
    DeclaredTooNoisy: (limits.CLOSED_BALANCE,),
    RunsDisagree: (limits.DISAGREE_Z,),
    Unexplained: (limits.PARTLY, *_NAMES),
    NotPredicted: (limits.CHANGE_LEAVES, limits.CLEARLY),
    Unpredicted: (limits.CLOSED, limits.CLOSED_TORQUES),
    PlainEstimate: (limits.NOT_WORSE, limits.PLAIN_LEAVES, limits.PLAIN_WRONG, limits.EVALUATED, *_CLOSES),
    NotAdmissible: (limits.NOT_WORSE, *_CLOSES),
}


def decided_by(verdict: Verdict) -> tuple[limits.Limit[float], ...]:
    """The limits that a verdict rests on."""
    return _DECIDED[type(verdict)]


def partly(verdict: Verdict) -> tuple[Finding, ...]:
    """What a part of something unknown looks like."""
    match verdict:
        case Unexplained():
            return verdict.partly
        case NotPredicted() | NotAdmissible():
            return verdict.findings
    return ()


@dataclass(frozen=True)
class TorquesSampled:
    """The torque law of the arm file is one that the twins follow only to second order in the period."""


@dataclass(frozen=True)
class BrokenRun:
    """A good part of a run does not lie in unbroken stretches."""

    run: str
    share: float


@dataclass(frozen=True)
class DrawingPredictsBetter:
    """The model as delivered predicts the untouched run better than the fitted one."""


@dataclass(frozen=True)
class ZerosOff:
    """Zeros of the sensors that are off by more than the arm file admits, or look like it."""

    zeros: tuple[tuple[str, float], ...]
    """Columns, and by how much: rad, of the gyro rad/s."""
    certain: bool = False
    """Whether they explain more than any effect does in their place. Others may stand for one that the model lacks."""


@dataclass(frozen=True)
class GainOff:
    """The gain of a torque sensor against that of the first joint is off by more than such sensors are."""

    joint: str
    first: str
    share: float
    """By which the torque that is read is too large."""


@dataclass(frozen=True)
class TorquesMisread:
    """The untouched runs close with constant errors of torque sensors that the balances alone do not show."""

    joints: tuple[tuple[str, float, float], ...]
    """Joint, mean offset of its torque over the measured runs, Nm, and share by which it reads too large against the
    first."""


@dataclass(frozen=True)
class NoUntouchedRun:
    """No run was kept apart."""


@dataclass(frozen=True)
class NearestArm:
    """No arm can have the values that were fitted; the nearest is used."""


@dataclass(frozen=True)
class Impossible:
    """The best other candidate has no size that an arm could have."""

    column: str


@dataclass(frozen=True)
class NoFloor:
    """The untouched run has no twin."""

    reason: str


@dataclass(frozen=True)
class StillLeft:
    """A balance leaves something over after everything was named."""

    residual: float
    """In units of the null twin's."""


@dataclass(frozen=True)
class AboveFloor:
    """Predictions of an untouched run err by much more than noise makes them."""

    run: str
    ratio: float


@dataclass(frozen=True)
class Disagreements:
    """Parameters on which the two runs disagree beside what was named."""

    parameters: tuple[Disagreement, ...]


Remark = (
    TorquesSampled
    | BrokenRun
    | DrawingPredictsBetter
    | ZerosOff
    | GainOff
    | TorquesMisread
    | NoUntouchedRun
    | NearestArm
    | Impossible
    | NoFloor
    | StillLeft
    | AboveFloor
    | Disagreements
)
