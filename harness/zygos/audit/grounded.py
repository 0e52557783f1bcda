# SPDX-License-Identifier: MIT
"""Faults of an arm with a fixed base and rigid joints, by the law of the whole arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from zygos import limits
from zygos.arm import Arm, TorqueLaw
from zygos.audit import remedies
from zygos.audit.case import Case
from zygos.audit.delays import Delay, Group, find_delay, groups, shifted
from zygos.audit.means import TORQUE_LATE
from zygos.audit.rigid import Reading, RigidLaw, with_angles
from zygos.audit.units import FACTORS, Scale, common_torque_scale, find_scale, find_torque_scale, nearest, scales
from zygos.audit.whole import find_late
from zygos.runs.cycles import Cycles

_FEW = 3
"""Largest number of joints of which every angle is searched for a delay: another angle changes all columns."""


def check_grounded(case: Case, use: list[int], broken: set[int]) -> None:
    """Decide delays, signs, places and scales of the readings, and go on with the run after correction."""
    law = RigidLaw(case.arm, case.cycles, broken)
    names = {case.name("tau", i) for i in use}
    if not law.enough:
        case.undecided |= names
        case.short = True
        case.notes.append(
            "signs and places of the torques: not decided, because the run is too short for the law of the whole arm, "
            f"which has {law.unknown} parameters"
        )
        return
    declared = Reading.declared(case.arm.n)
    if _currents(case):
        declared = law.with_fitted_scales(declared, use)
    best = _best_reading(case, law, declared, use)
    late = known = _delay(case, law, declared, use, broken)
    if late is not None and _gain(late, law.with_rows) > law.score(declared).total - law.score(best).total:
        law, known = _correct_delay(case, law, late, broken), None
        best = _best_reading(case, law, declared, use)
    kept = declared
    if best != declared and _closes(law, best, use):
        _find_reading(case, law, declared, best)
        kept, known = best, None
    for _ in use if late is not None or kept != declared else ():
        late, known = known or _delay(case, law, kept, use, broken), None
        if late is None:
            break
        law = _correct_delay(case, law, late, broken)
    _confirm(case, law, kept, [i for i in use if i not in declared.differs(kept)])
    case.correct(_reread(case, kept))


def _currents(case: Case) -> bool:
    """Whether torques are motor currents, so that the scale of each torque is unknown and no fault."""
    return case.arm.torque_unit == "A"


def _closes(law: RigidLaw, reading: Reading, use: Sequence[int]) -> bool:
    share = law.score(reading).share[[i for i in use if i in law.with_rows]]
    return bool(np.all(share <= limits.AUDIT_CLOSES.value))


def _best_reading(case: Case, law: RigidLaw, declared: Reading, use: list[int]) -> Reading:
    """The hypothesis to which each step is clearly better than the one before."""

    def best_of(trials: Iterator[Reading]) -> Reading:
        return min(trials, key=lambda one: law.score(one).total)

    now = declared
    for _ in range(3 * len(use)):
        best = best_of(law.torque_changes(now, use))
        if not _clearly(law, now, best, limits.AUDIT_SURE.value):
            break
        now = best
    if not _closes(law, now, use):
        # the columns of each angle change take long, so that these come only where no torque is the reason
        best = best_of(law.angle_changes(declared, use))
        if _clearly(law, now, best, limits.AUDIT_SURE.value) and _closes(law, best, use):
            now = best
    if _currents(case):
        return min(declared, now, key=lambda one: law.score(one).total)
    # a torque of a wrong scale may look inverted, so that scales are also tried on the arm file's own readings
    ends = [_with_scales(law, start, use) for start in dict.fromkeys((declared, now))]
    return min(ends, key=lambda one: law.score(one).total)


def _with_scales(law: RigidLaw, reading: Reading, use: list[int]) -> Reading:
    """The hypothesis with each scale that is clearly better, the best one first: a wrong scale of one torque lets
    those of others seem wrong."""
    now = reading
    for _ in use:
        tried = [(law.rescaled(now, i), i) for i in use if now.factor[i] == reading.factor[i]]
        tried += [(now.scaled(own, i), i) for _, i in tried for own in FACTORS["torque"].values()]
        better = [
            one
            for one, i in tried
            if abs(math.log(abs(one.factor[i] / now.factor[i]))) > math.log(limits.SCALE_OFF.value)
            and _clearly(law, now, one, limits.SURE_SCALE.value)
        ]
        if not better:
            break
        now = min(better, key=lambda one: law.score(one).total)
        # the torques of two joints show their ratio alone: either may be the wrong one
        alike = (one for one in better if not _clearly(law, one, now, limits.AUDIT_SURE.value))
        now = next((one for one in alike if _mistakes(law.arm, one, reading)), now)
    return now


def _mistakes(arm: Arm, one: Reading, other: Reading) -> bool:
    """Whether each scale that a hypothesis adds to another is a common mistake: that of a unit, or of the gear."""
    return all(common_torque_scale(arm, i, abs(one.factor[i] / other.factor[i])) for i in other.differs(one))


def _clearly(law: RigidLaw, one: Reading, other: Reading, factor: float) -> bool:
    """Whether the second hypothesis is better by that factor for each joint that it changes."""
    changes = max(len(one.differs(other)), 1)
    before, after = law.score(one).total, law.score(other).total
    return math.isfinite(after) and before - after >= changes * math.log(factor)


def _find_reading(case: Case, law: RigidLaw, declared: Reading, best: Reading) -> None:
    before, after = law.score(declared), law.score(best)
    seen = max(law.with_rows, key=lambda i: before.share[i] / after.share[i])
    for i in declared.differs(best):
        shown = i if before.share[i] > limits.AUDIT_SURE.value * after.share[i] else seen
        evidence = (
            f"the law of the whole arm leaves {100 * after.share[shown]:.2g} % of "
            f"{'this torque' if shown == i else case.name('tau', shown)} unexplained, and "
            f"{100 * before.share[shown]:.2g} % as the arm file says"
        )
        name, factor, angle = case.name("tau", i), best.factor[i], best.angle[i]
        if angle < 0.0:
            remedy = remedies.inverted(case.arm, "theta", i)
            case.find(case.name("theta", i), "inverted", evidence, remedy)
        elif angle != 1.0:
            known = nearest(scales(case.arm, "theta", i), angle)
            find_scale(case, "theta", i, known or Scale(angle), evidence)
        if best.source[i] != i:
            case.find(
                name,
                f"swapped with {case.name('tau', best.source[i])}" + (" and inverted" if factor < 0.0 else ""),
                evidence,
                remedies.swapped(case.arm, "tau", i, best.source[i]),
            )
        elif factor < 0.0:
            case.find(name, "inverted", evidence, remedies.inverted(case.arm, "tau", i))
        if abs(factor) != 1.0 and not _currents(case):
            find_torque_scale(case, i, abs(factor), evidence)


def _gain(late: Delay, rows: Sequence[int]) -> float:
    """By how much the logarithm of the residuals of all joints falls without a delay."""
    return len(_shows(late.group, rows)) * math.log(late.ratio)


def _shows(group: Group, rows: Sequence[int]) -> Sequence[int]:
    """The joints whose torques show a delay of a group."""
    return group.columns if group.kind == "tau" else rows


def _delay(case: Case, law: RigidLaw, kept: Reading, use: list[int], broken: set[int]) -> Delay | None:
    """The delay of all torques, of one, or of one angle that explains most, if the law closes without it."""
    rows = [i for i in use if i in law.with_rows]
    found: list[Delay] = []
    torques = groups(rows, gyro=False)

    @cache
    def moved(group: Group, periods: float) -> RigidLaw:
        return RigidLaw(case.arm, shifted(law.cycles, group, periods), broken)

    for group in torques:
        found += _own_delay(law, kept, group, rows, partial(moved, torques[0]))
    angles = [Group("theta", (i,)) for i in rows] if len(rows) > 1 else []
    if len(rows) > _FEW:
        # a late angle makes torques seem early
        late = max(found, key=lambda one: _gain(one, rows), default=None)
        angles = [min(angles, key=lambda group: moved(group, -late.periods).score(kept).total)] if late else []
    for group in angles:
        found += _own_delay(law, kept, group, rows, partial(moved, group))
    return max(found, key=lambda one: _gain(one, rows), default=None)


def _own_delay(
    law: RigidLaw, kept: Reading, group: Group, rows: Sequence[int], moved: Callable[[float], RigidLaw]
) -> list[Delay]:
    """The delay of a group, if there is one without which the law closes. moved: the law without so many periods."""

    def taken(periods: float, block: int | None) -> RigidLaw:
        return law.taking(kept, moved(periods), _shows(group, rows), block)

    def left(periods: float, block: int | None) -> float:
        """The geometric mean of the shares that are left of the torques that show the delay."""
        share = taken(periods, block).score(kept).share
        return float(np.exp(np.mean(np.log(share[list(_shows(group, rows))]))))

    own = find_delay(group, left, left(0.0, None), law.arm.period_s)
    return [own] if own is not None and _closes(taken(own.periods, None), kept, rows) else []


def _correct_delay(case: Case, law: RigidLaw, late: Delay, broken: set[int]) -> RigidLaw:
    """Report a delay; returns the law without it."""
    law_of_delay = _torque_law(case, late)
    if law_of_delay is None:
        find_late(case, late, "the law of the whole arm explains the torques")
    else:
        evidence = f"the law of the whole arm explains the torques {late.ratio:.3g} times better"
        case.find("torques", f"not {case.arm.torque_law}", evidence, remedies.torque_law(law_of_delay))
    cycles = shifted(case.cycles, late.group, late.periods)
    case.correct(cycles)
    return RigidLaw(case.arm, cycles, broken)


def _torque_law(case: Case, late: Delay) -> TorqueLaw | None:
    """The torque law under which torques are not late; None where there is none."""
    arm = case.arm
    if arm.torque_averaged or late.group.kind != "tau" or len(late.group.columns) < arm.n:
        return None
    acts = TORQUE_LATE[arm.torque_law] - late.periods
    law = min(TORQUE_LATE, key=lambda one: abs(TORQUE_LATE[one] - acts))
    near = abs(TORQUE_LATE[law] - acts) <= max(limits.SKEW_Z.value * late.sigma, limits.SKEW.value)
    return law if near and law != arm.torque_law else None


def _confirm(case: Case, law: RigidLaw, kept: Reading, use: list[int]) -> None:
    """Note which signs and places the law does not confirm."""
    now = law.score(kept)
    for i in use:
        name, left = case.name("tau", i), float(now.share[i])
        if not left <= limits.MOTOR_FITS.value:
            case.undecided.add(name)
            case.notes.append(
                f"{name}: sign and place are not decided (the law of the whole arm leaves {100 * left:.0f} % of "
                "the torque unexplained)"
            )
    for other in law.torque_changes(kept, use):
        better = now.total - law.score(other).total
        changes = kept.differs(other)
        if (
            -better < len(changes) * math.log(limits.AUDIT_SURE.value)
            and not {case.name("tau", i) for i in changes} <= case.undecided
        ):
            case.undecided |= {case.name("tau", i) for i in changes}
            what = "inverted" if other.source == kept.source else "swapped"
            case.notes.append(
                f"{' and '.join(case.name('tau', i) for i in changes)}: "
                f"{'sign is' if what == 'inverted' else 'places are'} not decided ({what}, the law of the whole "
                f"arm explains the torques {math.exp(better / len(changes)):.2f} times as well)"
            )


def _reread(case: Case, reading: Reading) -> Cycles:
    """The run under a hypothesis."""
    cycles = with_angles(case.arm, case.cycles, reading.angle)
    return replace(cycles, tau=cycles.tau[:, list(reading.source)] * np.array(reading.factor))
