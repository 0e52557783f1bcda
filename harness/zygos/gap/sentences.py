# SPDX-License-Identifier: MIT
"""Every sentence about an explained gap, from the data of its verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from zygos import limits
from zygos.arm import Arm
from zygos.effects import CATALOGUE, column_named, is_column, spoken
from zygos.files.output import ratio
from zygos.gap.changes import BODIES
from zygos.gap.experiment import Experiment
from zygos.gap.findings import ASYMMETRY, Deflection, Disagreement, Finding, Gap, Repeated, Value
from zygos.gap.search import Against, Candidate
from zygos.gap.verdicts import (
    AboveFloor,
    Answer,
    BrokenRun,
    Changed,
    DeclaredTooNoisy,
    Disagreements,
    DrawingPredictsBetter,
    GainOff,
    Impossible,
    Inseparable,
    Lacking,
    LateTorques,
    NearestArm,
    NoFloor,
    NotAdmissible,
    NothingMissing,
    NotPredicted,
    NoUntouchedRun,
    PartNamed,
    PlainEstimate,
    Remainder,
    Remark,
    RunsDisagree,
    SkewedEncoders,
    StillLeft,
    TorquesMisread,
    TorquesSampled,
    Unexplained,
    Unpredicted,
    ValuesDiffer,
    Verdict,
    WrongGravity,
    ZerosOff,
    partly,
)
from zygos.gap.whereabouts import Failing, Whereabouts
from zygos.report.figures import figure

_BASE = "the base, the gyro, or the momentum that is assumed"
"""Refit over floor from which on a gap is plain to see."""
_AGAINST: dict[Against, str] = {
    "insignificant": "not beyond its twin on both runs",
    "inconsistent": "the runs disagree on its size",
    "negative": "it would have to create energy",
    "not transferable": "what the first run says of it does not help on the second",
    "not the rotor": "its size is not that of the rotor's inertia",
}


# verdict


def verdict(arm: Arm, found: Verdict) -> str:  # noqa: PLR0911, PLR0912  (one sentence a verdict)
    """What a verdict says."""
    match found:
        case NothingMissing():
            return "Nothing is missing above the detection limits, and no value differs."
        case ValuesDiffer():
            return _values_differ(arm, found.changed)
        case Lacking():
            return f"The simulation lacks {listed(found.findings)}."
        case PartNamed():
            return (
                f"The simulation lacks {listed(found.findings)}, but the law is not exactly this: "
                f"{'; '.join((*map(left, found.left), *(_sizes(arm, one) for one in found.unsteady)))}."
            )
        case Changed():
            return _changed(arm, found)
        case Inseparable():
            sets = "; ".join(" or ".join((_named(f), *(spoken(arm, n) for n in f.instead))) for f in found.findings)
            return f"These runs cannot tell apart: {sets}."
        case SkewedEncoders():
            return (
                f"Timing first: what parts link and motor at the {found.joint} goes with its rate, as if one encoder "
                f"latched {abs(found.skew_s) * 1e3:.3g} ms after the other; no effect is named until latch_us is right."
            )
        case LateTorques():
            return (
                f"Timing first: the torques act {found.periods:.2f} SYNC periods later than torque_law of the arm file "
                "says; no effect is named until it is right."
            )
        case WrongGravity():
            return (
                f"The arm file first: gravity is {vector(found.found)} m/s^2, and the arm file says "
                f"{vector(found.stated)}; no effect is named until it is right."
            )
        case DeclaredTooNoisy():
            return (
                f"Sensors first: the balances leave only {found.least:.2f} times what they would with the declared "
                "noise; no value is right until quanta, rate_sigma and torque_sigma of the arm file are."
            )
        case RunsDisagree():
            return (
                f"The arm is not the same in the two runs: they disagree on {_disagreements(found.parameters)}, and "
                "each closes by itself."
            )
        case Unexplained():
            guess = ", ".join(spoken(arm, column) for column in found.guess)
            share = f"; the best guess ({guess}) takes {100 * found.completeness:.0f} % of the excess away"
            if found.unsigned:
                share += f", but not even the sign is certain of {listed(found.unsigned)}"
            return (
                f"Something is missing that the catalogue does not hold: {found.residual:.3g} times the residual of "
                f"the null twin is left over{share if guess else ''}."
            )
        case NotPredicted():
            return (
                f"{listed(found.findings)} would explain the balances, but the untouched run is predicted better "
                f"without (median {found.closed_median:.3g} sigma with, {found.struck_median:.3g} without): not "
                "adopted."
            )
        case Unpredicted():
            return (
                f"Something is missing that no balance shows: every balance closes, but {found.run} is predicted with "
                f"a median error of {figure(found.median)} σ, where noise and the errors of the values make at most "
                f"{figure(found.allowed)} σ."
            )
        case PlainEstimate():
            said = "The model of `zygos estimate` from the same runs is the answer."
            if found.failed:
                said += f" That with {_searched(found.findings)} is not adopted: {found.failed[0].sentence}."
            else:
                said += " No effect of the catalogue explains what it leaves over."
            return said + (f" It does not close: {left(found.left[0])}." if found.left else "")
        case NotAdmissible():
            return (
                f"Neither the model with {_searched(found.findings)} nor that of `zygos estimate` is adopted: "
                f"{found.failed[0].sentence}."
            )


def _searched(findings: Sequence[Finding]) -> str:
    """What a model has that a search found."""
    return listed(findings) if findings else "the simulation's own equations"


def left(rest: Remainder) -> str:
    """What is left over, in words."""
    floor = f", where noise leaves {figure(rest.floor)}" if math.isfinite(rest.floor) else ""
    unit = {"1": "times the floor", "sigma": "σ"}.get(rest.unit, rest.unit)
    goes = f", {100 * rest.share:.0f} % of it as a function of the {rest.over}" if rest.over else ""
    return f"{figure(rest.size)} {unit} are left over at {rest.where}{floor}{goes}"


def _sizes(arm: Arm, one: Disagreement) -> str:
    return f"{spoken(arm, one.name)} is {figure(one.first)} on the first run and {figure(one.second)} on another"


def _changed(arm: Arm, found: Changed) -> str:
    change = found.change
    now = found.runs[change.run]
    when = (
        f"between {found.runs[change.run - 1]} and {now}"
        if change.between
        else f"in {now}, between {change.before_s:.0f} and {change.after_s:.0f} s"
    )
    if change.what == BODIES and found.payload:
        body = arm.joints[-1].name
        elements = ", ".join(f"{one.name} {sized(one.value, one.sigma, one.unit)}" for one in found.payload)
        return f"The body behind the {body} took on or lost a payload {when}: {elements}."
    if change.what == BODIES:
        each = zip(change.names, change.old, change.new, change.sigma, strict=True)
        parts = [
            f"{n} {old:.5g} → {sized(new, sigma, '1')}" for n, old, new, sigma in each if abs(new - old) > 3 * sigma
        ]
        return f"The bodies changed {when}, as with a payload that is taken up or left: {', '.join(parts)}."
    old, new, sigma = float(change.old[0]), float(change.new[0]), float(change.sigma[0])
    if not is_column(change.what):
        return f"{change.what} changed {when}, from {old:.5g} to {sized(new, sigma, '1')}."
    unit = CATALOGUE[column_named(change.what).key].unit
    began = "began" if old == 0.0 else f"changed from {old:.5g}"
    return f"{_upper(spoken(arm, change.what))} {began} {when}: {sized(new, sigma, unit)}."


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def _values_differ(arm: Arm, changed: Sequence[Value]) -> str:
    gone = [spoken(arm, v.name) for v in changed if v.absent]
    others = _first_of(
        f"{v.name} {sized(v.found, v.sigma, v.unit)} (simulation {v.delivered:.5g}"
        + (f": {100 * v.change:+.3g} %)" if math.isfinite(v.change) else ")")
        for v in sorted(changed, key=lambda v: -abs(v.found - v.delivered) / max(v.sigma, 1e-300))
        if not v.absent
    )
    parts = [f"The simulation has {' and '.join(gone)}, which these runs do not show."] if gone else []
    parts += [f"The equations are right, values differ: {others}."] if others else []
    return " ".join(parts)


def _disagreements(parameters: Sequence[Disagreement]) -> str:
    return _first_of(f"{p.name} ({p.first:.5g} on the first, {p.second:.5g} on the second)" for p in parameters)


def _first_of(texts: Iterable[str]) -> str:
    """As many of them as a sentence holds, and how many others there are."""
    listed = list(texts)
    more = len(listed) - limits.SAID.value
    return ", ".join(listed[: limits.SAID.value]) + (f" and {more} more" if more > 0 else "")


# findings


def title(arm: Arm, column: str) -> str:
    """A column in sentences."""
    column = column.partition("@")[0]
    if is_column(column):
        return spoken(arm, column)
    if column.startswith(ASYMMETRY):
        joint = arm.joints[int(column[len(ASYMMETRY) :]) - 1].name
        return f"Coulomb friction that differs between the directions ({joint})"
    number = column[2:]
    return f"inertia of the rotor ({arm.joints[int(number) - 1].name})" if number.isdigit() else column


def evidence(finding: Finding) -> str:
    """The evidence for it."""
    match finding.evidence:
        case Deflection() as bent:
            return f"link and motor part by {bent.rms_rad:.3g} rad rms, {_parted(bent)} their noise"
        case Repeated() as proof:
            return _repeated(proof, finding.unit)
        case proof:
            return (
                f"{proof.z:.0f} standard deviations of the null twin on either run, {100 * proof.completeness:.1f} % "
                "of the excess explained by all that is named"
            )


def _repeated(proof: Repeated, unit: str) -> str:
    if not math.isfinite(proof.z):
        return ""
    each = ", ".join(f"{x:.3g}" for x in proof.each if math.isfinite(x))
    runs = f", {each} {unit} on the runs by themselves" if each else ""
    said = f"{abs(proof.z):.0f} standard deviations from the scatter over blocks of time and runs{runs}"
    if math.isfinite(proof.completeness):
        share = 100 * min(1.0, proof.completeness)
        said += f", {share:.0f} % of the squared torque beyond noise explained at its joint"
    return said


def entry_evidence(finding: Finding) -> str:
    """The evidence of its entry in a model file."""
    low, high = finding.interval
    return f"95 % interval {low:.4g} .. {high:.4g} {finding.unit}; {evidence(finding)}"


def listed(findings: Sequence[Finding]) -> str:
    """Effects with their places and sizes."""
    return " and ".join(f"{_named(f)}, {sized(f.value, f.sigma, f.unit)}" for f in findings)


def _named(finding: Finding) -> str:
    at = "of the arm" if finding.joint is None else f"({finding.joint})"
    along = f" along {finding.component}" if finding.component else ""
    kind = finding.entry
    form = (
        ""
        if kind is None or finding.shape is None
        else f" with {kind.shape_title} {finding.shape:.3g} {kind.shape_unit}"
    )
    return f"{finding.title}{along} {at}{form}"


def sized(value: float, sigma: float, unit: str) -> str:
    """A value and its 95 % interval to two digits of the latter, in words."""
    half = limits.INTERVAL_Z.value * sigma
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 9)) if 0.0 < half < np.inf else 4
    return f"{value:,.{digits}f} ± {half:.{digits}f}" + ("" if unit == "1" else f" {unit}")


def against(candidate: Candidate) -> str:
    """What speaks against a candidate; empty where nothing does."""
    return _AGAINST[candidate.against] if candidate.against else ""


# where


def where(arm: Arm, found: Whereabouts) -> str:
    """One sentence on which balance fails, from each balance by itself, and on where to look."""
    parts = [f"link and motor of the {bent.joint} part by {_parted(bent)} their noise" for bent in found.bent]
    parts += [f"{_balance(arm, one)} leaves {_times(one.rho)} what its twin does" for one in found.failing]
    if not parts:
        return "Every balance closes as well as its twin's."
    tail = ""
    if found.named:
        places = dict.fromkeys(_place(finding) for finding in found.named)
        tail = f": what explains it acts {' and '.join(places)}"
    elif found.look:
        only = [one.balance for one in found.failing] == ["E"] and found.look == ("link",)
        tail = f"{' while every motor balance closes' if only else ''}: {look_at(found)}"
    whole = "; ".join(parts) + tail + "."
    return _upper(whole)


def look_at(found: Whereabouts) -> str:
    """Where to look; empty where there is no need to."""
    match found.look:
        case ():
            return ""
        case ("motors", *others):
            motors = f"look at the motor side of the {' and the '.join(found.motors)}"
            return motors + (f", and at {_BASE}" if others else "")
        case ("joints",):
            return "look at the joints' flexibility first"
        case ("base", *others):
            return f"look at {_BASE}" + (", and at the link side" if others else "")
        case (_, *others):
            return "look at the link side" + (f", then at {_BASE}" if others else "")
    raise AssertionError(found.look)


def balance_title(arm: Arm, balance: str) -> str:
    """A balance as the head of a row or a chart: E, M or L and the number of a joint, H or Hx, Hy, Hz."""
    if balance[0] in "ML":
        side = "motor balance" if balance[0] == "M" else "momentum of the link angle"
        return f"{side}, {arm.joints[int(balance[1:]) - 1].name}"
    along = f", {balance[1:]}" if balance[1:] else ""
    return "energy of the whole arm" if balance == "E" else f"angular momentum of the whole arm{along}"


def _balance(arm: Arm, failing: Failing) -> str:
    name = failing.balance
    if name[0] in "ML":
        side = "the motor balance" if name[0] == "M" else "the momentum of the link angle"
        return f"{side} of the {arm.joints[int(name[1:]) - 1].name}"
    along = f" along {name[1:]}" if name[1:] else ""
    return "the energy balance" if name == "E" else f"the momentum{along}"


def _place(finding: Finding) -> str:
    """Where a finding acts."""
    kind = finding.entry
    if finding.joint is None:
        return "on all bodies" if kind and kind.place == "field" else "on the base"
    side = {"motor": "at the motor side", "torque": "at the motor side", "link": "at the link side"}
    return f"{side.get(kind.place if kind else '', 'at the joint')} of the {finding.joint}"


def _parted(bent: Deflection) -> str:
    return _times(bent.rms_rad / bent.noise_rad)


def vector(components: Sequence[float]) -> str:
    """Components as an arm file has them."""
    return f"[{', '.join(f'{x:.3g}' for x in np.round(components, 2))}]"


def _times(ratio: float) -> str:
    return f"{ratio:,.0f} times" if ratio >= 10.0 else f"{ratio:.1f} times"


def predicted(answer: Answer, gap: Gap, *, added: bool) -> list[str]:
    """What the errors of predictions mean. added: whether the closed model has more than the refit."""
    delivered, refit, closed, floor = (one.gap for one in (gap.delivered, gap.refit, gap.closed, gap.floor))
    out: list[str] = []
    if answer in {"named", "part named"} and closed < delivered:
        out.append(f"Against the simulation as delivered it shrinks {figure(ratio(delivered, closed))} ×.")
    if refit > limits.NOT_WORSE.value * delivered:
        out.append("The refit predicts worse than what was delivered: its values bend to fit what they cannot express.")
    if math.isfinite(ratio(refit, floor)) and answer not in {"nothing missing", "values differ"}:
        seen = (
            "plain to see"
            if refit >= limits.VISIBLE.value * floor
            else "above the floor"
            if refit > limits.CLEARLY.value * floor
            else "faint"
        )
        out.append(f"The refit's is {figure(ratio(refit, floor))} × the floor: {seen}.")
    if math.isfinite(ratio(closed, floor)) and (added or answer != "unknown"):
        out.append(f"What is closed is left with {figure(ratio(closed, floor))} × the floor.")
    return out


# remarks


def remark(found: Remark) -> str:  # noqa: PLR0911, PLR0912  (one sentence a remark)
    """What a remark says."""
    match found:
        case TorquesSampled():
            return (
                'torques are taken as constant at their mean over a SYNC period: with torque_law = "sampled" twins '
                "err by the square of period_s"
            )
        case BrokenRun():
            return f"{found.run}: {100 * found.share:.0f} % of the run lies in unbroken stretches and is used"
        case DrawingPredictsBetter():
            return (
                "the drawing's values predict better than the fitted ones: these runs do not determine all values well"
            )
        case ZerosOff():
            zeros = ", ".join(_zero(column, by) for column, by in found.zeros)
            if found.certain:
                return f"zeros of the sensors are off: {zeros}; predictions are made with that taken off"
            return (
                f"either zeros of the sensors are off ({zeros}), or an effect that the model lacks looks like it: take "
                "the zeros of the encoders at rest; predictions are made with that taken off"
            )
        case GainOff():
            return (
                f"the torque of the {found.joint} reads {100.0 * found.share:+.2g} % against that of the "
                f"{found.first}: its gain, or a gear ratio, is off"
            )
        case TorquesMisread():
            each = ", ".join(f"{name} {off:+.3g} Nm and {100.0 * share:+.2g} %" for name, off, share in found.joints)
            return (
                "the untouched run is predicted with an offset and a gain of each torque sensor, which noise hides in "
                f"the balances: {each}; a calibration of the torque sensors would tell"
            )
        case NoUntouchedRun():
            return "no run was kept apart (--validate): the gap is not known"
        case NearestArm():
            return "no arm has the values that fit these runs; predictions are made with the nearest that has"
        case Impossible():
            return f"{found.column}, the best other candidate, has no size that an arm could have"
        case NoFloor():
            return f"the untouched run has no twin, so the gap has no floor: {found.reason}"
        case StillLeft():
            return (
                f"a balance still leaves {found.residual:.2g} times what its twin does: the law is not exactly this, "
                "or something smaller is missing beside it"
            )
        case AboveFloor():
            return (
                f"predictions of {found.run} err by {found.ratio:.2g} times the floor: the values are not known as "
                "well as these sensors would show, or the arm is another in this run"
            )
        case Disagreements():
            return f"the two runs disagree on {_disagreements(found.parameters)}"


def _zero(column: str, off: float) -> str:
    sensor = column.replace("_zero", " encoder of joint ").replace("_", " ")
    return f"{sensor} {1e3 * off:+.2g} mrad" + ("/s" if column == "gyro_bias" else "")


# what to do


def motion(experiment: Experiment) -> str:
    """The motion of an experiment."""
    speed = {0.5: "at half the speed", 1.0: "at the same speed", 2.0: "at twice the speed"}[experiment.speed]
    return f"the motion of the first run {speed}, with {100 * experiment.amplitude:.0f} % of its amplitude"


def remedy(
    arm: Arm, found: Verdict, place: Whereabouts, experiments: Sequence[Experiment], nearest: Candidate | None
) -> str:
    """What to do where nothing is adopted. experiments: best first; nearest: the candidate that leaves least over."""
    if experiments:
        best = experiments[0]
        variant = (
            f"{motion(best)} would tell them apart" if best.tells else "no variant of these motions tells them apart"
        )
        return f"{variant}; --next-motion plans one"
    if partial := partly(found):
        return f"part of it looks like {listed(partial)}"
    match found:
        case SkewedEncoders() | LateTorques() | WrongGravity() | DeclaredTooNoisy():
            return "correct the arm file; `zygos check-arm` on one of the runs examines its signals"
        case RunsDisagree():
            return "give two runs of the same arm; `zygos estimate` gives the values for each run"
        case Unpredicted():
            return (
                "see which signal is predicted worst, and when; a declared `torque_sigma` and longer runs make the "
                "errors of offsets and gains of the torques smaller"
            )
    said = [look_at(place)] if place.look else []
    if nearest is not None:
        share = 100 * max(0.0, nearest.complete)
        said.append(f"the nearest in the catalogue, {spoken(arm, nearest.name)}, explains {share:.0f} % of it")
    return "; ".join(said)


def asked_of_candidates(threshold: float, false_alarms: float, runs: str) -> str:
    """The significance that is asked of a candidate, and how often noise reaches it, in words. runs: on which."""
    return (
        f"A candidate needs |z| of {threshold:.2g} {runs}; where nothing is missing, noise brings one to it in at most "
        f"{false_alarms:.1g} of the searches."
    )
