# SPDX-License-Identifier: MIT
"""Sentences about the gap of an arm on the ground."""

from __future__ import annotations

from collections.abc import Sequence

from zygos import limits
from zygos.arm import Arm
from zygos.gap import sentences
from zygos.gap.findings import ASYMMETRY, ROTOR_INERTIA, Finding
from zygos.gap.ground.candidates import OFFSET_OF_TORQUE
from zygos.gap.ground.search import Against, Search, Tried
from zygos.gap.verdicts import (
    Inseparable,
    Lacking,
    LateTorques,
    NothingMissing,
    NotPredicted,
    PartNamed,
    Unexplained,
    Verdict,
    WrongGravity,
)
from zygos.report.figures import figure

_AGAINST: dict[Against, str] = {
    "insignificant": "not beyond chance, or what the runs disagree on its size",
    "negative": "it would have to create energy",
    "too late": "the torque would act after its period",
    "immaterial": "at the size of the other runs it explains too little of what is left",
}


def after_gear(arm: Arm, finding: Finding) -> str:
    """Its value after the gear, where that differs; empty otherwise."""
    names = [joint.name for joint in arm.joints]
    ratio = float(arm.gear_ratios[names.index(finding.joint)]) if finding.joint in names else 1.0
    factor = {"Nm": ratio, "Nms/rad": ratio, "kg m^2": ratio**2}.get(finding.unit, 1.0)
    before = finding.kind in (ROTOR_INERTIA, ASYMMETRY)
    before = before or (finding.entry is not None and finding.entry.place == "motor")
    return "" if not before or factor == 1.0 else f"{factor * finding.value:.3g} {finding.unit}"


def listed(arm: Arm, findings: Sequence[Finding]) -> str:
    """Effects with their places and sizes; those of one kind together."""
    kinds = dict.fromkeys(finding.title for finding in findings)
    return " and ".join(_of_kind(arm, [one for one in findings if one.title == kind]) for kind in kinds)


def _of_kind(arm: Arm, findings: Sequence[Finding]) -> str:
    first = findings[0]
    if len(findings) == 1:
        after = after_gear(arm, first)
        return sentences.listed([first]) + (f" ({after} after the gear)" if after else "")
    if len(findings) > limits.SIZED.value:
        return f"{first.title} ({', '.join(sorted(str(f.joint) for f in findings))})"
    return f"{first.title} ({'; '.join(f'{f.joint} {sentences.sized(f.value, f.sigma, f.unit)}' for f in findings)})"


def sets(arm: Arm, findings: Sequence[Finding]) -> str:
    """What the runs cannot tell apart; empty where there is nothing of the kind."""
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for one in findings:
        if one.instead:
            groups.setdefault((one.kind, *(name.rstrip("0123456789") for name in one.instead)), []).append(one)
    said = []
    for group in groups.values():
        names = (sentences.title(arm, name) for name in group[0].instead)
        # of several joints, the sizes stand for the places
        others = [name.rpartition(" (")[0] if len(group) > 1 else name for name in names]
        said.append(" or ".join((listed(arm, group), *others)))
    return f"These runs cannot tell apart: {'; '.join(said)}." if said else ""


def _certain(arm: Arm, findings: Sequence[Finding]) -> str:
    told = [finding for finding in findings if not finding.instead]
    return f"The simulation lacks {listed(arm, told)}" if told else ""


def verdict(arm: Arm, found: Verdict) -> str:  # noqa: PLR0911  (one sentence a verdict)
    """What a verdict says."""
    match found:
        case Lacking():
            return f"{_certain(arm, found.findings)}. {sets(arm, found.findings)}".rstrip()
        case PartNamed():
            left = (
                f", but the law is not exactly this: {'; '.join(map(sentences.left, found.left))}" if found.left else ""
            )
            return f"{_certain(arm, found.findings)}{left}. {sets(arm, found.findings)}".rstrip()
        case NothingMissing():
            return "Nothing is missing above the detection limits, and no value differs."
        case LateTorques():
            late = "later" if found.periods > 0 else "earlier"
            return (
                f"Timing first: the torques act {abs(found.periods):.2f} SYNC periods {late} than the arm file says; "
                "no effect is named until it is right."
            )
        case Unexplained():
            guess = ", ".join(sentences.title(arm, column) for column in found.guess)
            share = f"; the best guess ({guess}) explains {100 * found.completeness:.0f} % of it" if guess else ""
            runs = "the untouched run leaves" if found.untouched else "the measured runs leave"
            return (
                f"Something is missing that the catalogue does not hold: {runs} "
                f"{figure(found.residual)} times the torque that noise does{share}."
            )
        case NotPredicted():
            return (
                f"{listed(arm, found.findings)} would explain the measured runs, but the untouched run is predicted "
                f"better without ({figure(found.closed_median)} floors of torque left with, "
                f"{figure(found.struck_median)} without): not adopted."
            )
        case Inseparable():
            first = _certain(arm, found.findings)
            return f"{first}. {sets(arm, found.findings)}" if first else sets(arm, found.findings)
    return sentences.verdict(arm, found)


def where(joints: Sequence[tuple[str, float, float, float]]) -> str:
    """Which joints fail: name, torque left by the refit and by the closed model, and noise, Nm."""
    fails = [one for one in joints if one[1] > limits.FAILS.value * one[3]]
    if not fails:
        return "The torques of all joints close."
    said = "; ".join(f"{name} {figure(before)} → {figure(after)} Nm" for name, before, after, _ in fails)
    others = [one[0] for one in joints if one not in fails]
    head = "Torque left over by the simulation's own equations → with what was found"
    return f"{head}: {said}." + (f" The others close: {', '.join(others)}." if others else "")


def remedy(arm: Arm, found: Verdict, search: Search) -> str:
    """What to do where nothing is adopted, or where something is left to tell."""
    match found:
        case LateTorques():
            return "correct torque_law or latch_us in the arm file; `zygos check-arm` examines the signals of a run"
        case WrongGravity():
            return f"write gravity = {sentences.vector(found.found)} in the arm file"
        case Inseparable():
            if any(f.instead and f.kind == OFFSET_OF_TORQUE for f in found.findings):
                return "record a run in which these joints also rest in several postures; --next-motion plans it"
            return "record a run with another motion; --next-motion plans it"
    near = search.nearest
    if near is None:
        return ""
    said = "check signs, zeros, gear ratios and timing with `zygos check-arm`"
    if near.explained > 0.0:
        share = 100 * min(1.0, near.explained)
        nearest = sentences.title(arm, near.name)
        said += f"; the nearest in the catalogue, {nearest}, explains {share:.0f} % of what is left"
    return said


def against(one: Tried) -> str:
    """What speaks against a candidate; empty where nothing does."""
    return _AGAINST[one.against] if one.against is not None else ""


def offset(joint: str, size: float, sigma: float) -> str:
    """A constant torque that is there at rest as well."""
    return (
        f"the torque of the {joint} has a constant offset of {size:.3g} ± {limits.INTERVAL_Z.value * sigma:.1g} Nm, "
        "also at rest: that of "
        "its sensor, of a cable or of a brake"
    )


def gains(arm: Arm, found: Sequence[Finding]) -> str:
    """Gains of torque sensors within their usual errors."""
    each = ", ".join(
        f"{f.joint} {-100 * f.value:+.2g} ± {100 * limits.INTERVAL_Z.value * f.sigma:.1g} %" for f in found
    )
    return (
        f"the torque sensors read differently: against that of the {arm.joints[0].name} too much by {each}; the values "
        "are found with these gains"
    )


def unnamed(arm: Arm, columns: Sequence[str]) -> str:
    """Usual effects that a model has beside what was named."""
    each = ", ".join(sentences.title(arm, column) for column in columns)
    return f"the model also has {each}: usual in such arms, but not sure enough in these runs to be named"
