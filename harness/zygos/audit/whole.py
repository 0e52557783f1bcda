# SPDX-License-Identifier: MIT
"""Faults that only the arm as a whole shows: the gyro, all signals of a joint, units, delays, torque law, smoother."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import TorqueLaw
from zygos.audit import remedies
from zygos.audit.balance import Balance, WholeFault, flattened
from zygos.audit.case import GROUPS, Case
from zygos.audit.delays import Delay, Group, find_delay, groups, shifted, without
from zygos.audit.encoders import unskewed
from zygos.audit.findings import Pair
from zygos.audit.means import Array
from zygos.audit.remedies import ANGLES, KINDS, Kind
from zygos.audit.units import FACTORS, Scale, find_scale, find_torque_scale, rescaled
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles

_MOST_FAULTS = 4
"""Largest number of faults of the whole arm that are corrected one after the other."""


@dataclass(frozen=True)
class Hypothesis:
    """A fault, the residual of the balance without it, J, and how to report it."""

    left: float
    cycles: Cycles
    report: Callable[[str], None]
    """Given the evidence."""


def make_balance(case: Case, broken: set[int]) -> Balance | None:
    """The balance of the run; None where there is none, with a note. Before that, units with which there is one are
    looked for."""
    if broken:
        no_balance(case, "stuck or saturated signals make the balance of the whole arm useless")
        return None
    try:
        balance = Balance(case.arm, case.cycles)
    except ZygosError as error:
        no_balance(case, str(error).split("; remedy")[0])
        return None
    if math.isfinite(balance.residual_j):
        return balance
    few, reason = balance.few, balance.reason
    for found in _units(case, balance):
        # where there is no balance, one that closes without doubt is clear by itself
        if math.isfinite(found.left) and balance.closes(found.cycles):
            share = balance.share(found.cycles)
            found.report(f"the energy balance leaves {100 * share:.2g} % of the work, and without it there is none")
            case.correct(found.cycles)
            return Balance(case.arm, found.cycles)
    case.short |= few
    no_balance(case, f"the run has no balance of the whole arm ({reason})")
    return None


def no_balance(case: Case, why: str) -> None:
    """Note what is open without a balance."""
    open_ones = [*([] if case.arm.torque_averaged else ["torque_law"]), *(["gyro"] if case.arm.free else [])]
    if open_ones:
        case.notes.append(f"{' and '.join(open_ones)}: not decided, because {why}")
    else:
        case.remarks.append(f"the energy balance tells nothing: {why}")
    case.open_gyro()


def _units(case: Case, balance: Balance) -> Iterator[Hypothesis]:
    """Readings in another unit: all angles, both angles of a joint, and the gyro."""
    arm, cycles = case.arm, balance.cycles

    def hypothesis(signals: list[tuple[Kind, int]], scale: Scale) -> Hypothesis:
        moved = cycles
        for kind, i in signals:
            moved = rescaled(moved, kind, [i], scale.factor)

        def report(evidence: str) -> None:
            for kind, i in signals:
                find_scale(case, kind, i, scale, evidence)

        return Hypothesis(balance.residual(arm, moved), moved, report)

    angles = [[(kind, i) for kind in KINDS[:2] if kind == "theta" or arm.joints[i].flexible] for i in range(arm.n)]
    for unit, factor in FACTORS["angle"].items():
        for signals in [list(itertools.chain(*angles)), *(angles if arm.n > 1 else [])]:
            if all(_louder(case, kind, i, factor) for kind, i in signals):
                yield hypothesis(signals, Scale(factor, unit))
    if arm.free:
        for unit, factor in FACTORS["rate"].items():
            yield hypothesis([("omega", axis) for axis in range(3)], Scale(factor, unit))


def _louder(case: Case, kind: Kind, i: int, factor: float) -> bool:
    """Whether the noise of an angle is nearer to the declared one with a factor."""
    off = math.log(max(case.noise(kind, i), 1e-300) / case.declared_noise(kind, i))
    return abs(off + math.log(factor)) < abs(off)


def check_gains(case: Case, balance: Balance) -> Balance:
    """Report torques whose scale is not that of the first joint's: in another unit, or by a factor; returns the balance
    after their correction. The run shows no scale that all torques have in common."""
    arm, cycles = case.arm, balance.cycles
    if arm.n == 1 or arm.torque_unit == "A":
        return balance
    gains = balance.gains(cycles)
    if gains is None:
        for i in range(arm.n):
            for unit, factor in FACTORS["torque"].items():
                moved = rescaled(cycles, "tau", [i], factor)
                others = balance.gains(moved)
                if others is not None and not _off(others).any():
                    evidence = f"the energy balance closes with gains of 1 to {100 * np.abs(others - 1.0).max():.2g} %"
                    find_scale(case, "tau", i, Scale(factor, unit), evidence)
                    return Balance(arm, moved)
        return balance
    for i in np.flatnonzero(_off(gains)).tolist():
        evidence = f"reports {gains[i]:.4g} times the torque that fits {case.name('tau', 0)}"
        find_torque_scale(case, i, 1.0 / float(gains[i]), evidence)
        cycles = rescaled(cycles, "tau", [i], 1.0 / float(gains[i]))
    return Balance(arm, cycles) if _off(gains).any() else balance


def _off(gains: Array) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = np.abs(np.log(np.maximum(gains, 1e-300))) > math.log(limits.SCALE_OFF.value)
    return found


def check_whole(case: Case, balance: Balance, pairs: dict[int, Pair]) -> tuple[Balance, list[Delay] | None]:
    """Report faults of units, gyro, whole joints and timing, the one that explains most first; returns the balance
    after their correction, and the delays that it shows; None if those were reported. pairs: by joint."""
    late: list[Delay] | None = []
    for _ in range(_MOST_FAULTS):
        now = balance.residual_j
        turns = [(left, fault) for left, fault in balance.trials(case.zeros)] if case.arm.free else []
        trials = [*_units(case, balance)]
        trials += [Hypothesis(left, fault.cycles, partial(_find_whole, case, fault)) for left, fault in turns]
        late = None if late is None else _delays(case, balance, pairs)
        if late and all(late[0].residual < one.left for one in trials) and late[0].ratio >= limits.AUDIT_SURE.value:
            balance, late = check_timing(case, balance, late, pairs), None
            continue
        best = min(trials, key=lambda trial: trial.left, default=None)
        if best is not None and now / best.left >= limits.AUDIT_SURE.value:
            best.report(f"the energy balance closes {now / best.left:.3g} times better")
            balance = Balance(case.arm, best.cycles)
            continue
        against = min((left for left, fault in turns if fault.what == "gyro"), default=math.inf)
        if against / now < limits.AUDIT_SURE.value:
            case.open_gyro()
            case.notes.append(
                f"gyro: signs and axes are not decided (after a change, the energy balance closes "
                f"{now / against:.2f} times as well)"
            )
        break
    return balance, late


def _find_whole(case: Case, fault: WholeFault, evidence: str) -> None:
    if fault.what == "gyro":
        remedy = remedies.mount(case.arm, fault.turn)
        for i in range(3):
            source = int(np.argmax(np.abs(fault.turn[i])))
            sign = fault.turn[i, source]
            if source == i and sign > 0:
                continue
            if not (case.used_axis(i) or case.used_axis(source)):
                continue
            fault_text = "inverted" if source == i else f"swapped with gyro {'xyz'[source]}"
            fault_text += " and inverted" if source != i and sign < 0 else ""
            case.find(f"gyro {'xyz'[i]}", fault_text, evidence, remedy)
        return
    for i in fault.joints:
        fault_text, remedy = "inverted, as all signals of the joint", remedies.turned_joint(case.arm, i)
        if fault.what == "swapped":
            j = sum(fault.joints) - i
            fault_text = f"swapped with {case.arm.joints[j].name}'s, as all signals of the joint"
            remedy = remedies.swapped_joints(case.arm, i, j)
        for kind in KINDS if case.arm.joints[i].flexible else KINDS[1:]:
            case.find(case.name(kind, i), fault_text, evidence, remedy)


# -- timing


def _delays(case: Case, balance: Balance, pairs: dict[int, Pair]) -> list[Delay]:
    """The delays that the balance shows, that which explains most first; none where that is one of angles within a
    period, which the comparison of the two encoders measures better."""
    now, found = balance.residual_j, list[Delay | None]()
    if balance.noisy:
        return []
    flexible = [i for i, joint in enumerate(case.arm.joints) if joint.flexible]
    for group in groups(range(case.arm.n), flexible, gyro=case.arm.free):

        def left(periods: float, block: int | None, group: Group = group) -> float:
            return balance.residual(case.arm, without(shifted(balance.cycles, group, periods), block))

        found.append(find_delay(group, left, now, case.arm.period_s))
    late = [_by_pairs(one, pairs, case.arm.period_s) for one in found if one is not None]
    late.sort(key=lambda one: one.residual)
    one_side = late and late[0].group.kind in ANGLES and not late[0].group.both
    return [] if one_side and abs(late[0].periods) < 1.0 else late


def _by_pairs(late: Delay, pairs: dict[int, Pair], period_s: float) -> Delay:
    """A delay of angles as the comparison of the two encoders measures it, where that is more precise and agrees."""
    group = late.group
    if group.kind not in ANGLES or group.both or not set(group.columns) <= pairs.keys():
        return late
    skew, sigma = (
        np.array([getattr(pairs[i], name) for i in group.columns]) / period_s for name in ("skew_s", "skew_sigma_s")
    )
    weight = 1.0 / sigma**2
    periods = float(weight @ skew / weight.sum()) * (1.0 if group.kind == "q" else -1.0)
    better = float(weight.sum() ** -0.5)
    agrees = abs(periods - late.periods) < limits.SKEW_Z.value * math.hypot(better, late.sigma)
    return replace(late, periods=periods, sigma=better) if better < late.sigma and agrees else late


def check_timing(case: Case, balance: Balance, late: list[Delay], pairs: dict[int, Pair]) -> Balance:
    """Report the torque law, or delays of gyro and torques, whichever explains more; returns the balance after their
    correction. late: the delays that the balance shows."""
    arm = case.arm
    for _ in range(arm.n + 1):
        first = late[0] if late else None
        laws = balance.laws(arm, balance.cycles)
        law = min(laws, key=lambda one: laws[one])
        declared = laws[arm.torque_law]
        of_law = declared / laws[law] >= limits.SURE_LAW.value and not arm.torque_averaged
        if of_law and (first is None or first.ratio <= limits.LIKELY_LAW.value * declared / laws[law]):
            case.find(
                "torques",
                f"not {arm.torque_law}",
                f"the energy balance closes {declared / laws[law]:.3g} times better",
                remedies.torque_law(law),
            )
            return balance
        if first is None:
            return balance
        find_late(case, first, "the energy balance closes")
        balance = Balance(arm, shifted(balance.cycles, first.group, first.periods))
        late = _delays(case, balance, pairs)
    return balance


def find_late(case: Case, late: Delay, what: str) -> None:
    """Report a delay."""
    arm, group = case.arm, late.group
    seconds = late.periods * arm.period_s
    text = f"{1e3 * abs(seconds):.3g} ms ± {1e3 * late.sigma * arm.period_s:.1g}"
    evidence = f"{what} {late.ratio:.3g} times better"
    alone = len(group.columns) == 1 and (group.kind != "tau" or arm.n > 1)
    signal = "angles" if group.both else case.name(group.kind, group.columns[0]) if alone else GROUPS[group.kind]
    remedy = remedies.delay(arm, group.kind, group.columns, seconds, both=group.both)
    case.find(signal, f"{'late' if seconds > 0.0 else 'early'} by {text}", evidence, remedy)


def judge_law(case: Case, balance: Balance, skewed: dict[int, float]) -> dict[TorqueLaw, float]:
    """rms residual of the balance under each torque law, J. Notes where they are too much alike."""
    laws = balance.laws(*unskewed(case.arm, balance.cycles, skewed))
    first, second, _ = sorted(laws, key=lambda law: laws[law])
    if skewed:
        case.notes.append("torque_law: can be decided only after the skew of the encoders is corrected")
    elif case.faulty("torques") or case.arm.torque_averaged:
        pass  # means about an instant have one law only
    elif first != case.arm.torque_law or laws[second] / laws[first] < limits.LIKELY_LAW.value:
        case.notes.append(
            f"torque_law: not decided ({first} leaves {laws[first]:.4g} J of the energy balance, {second} "
            f"{laws[second]:.4g} J); remedy: keep the law that the manual of the drives states"
        )
    return laws


def check_smoother(case: Case, balance: Balance) -> None:
    """Report a smoother that takes more off the motion than the intervals contain; in a run that has no other fault,
    which would move the values as well."""
    if case.findings:
        return
    found = flattened(case.arm, case.cycles, balance.friction)
    if found is None or found.sigmas < limits.FLATTENED_Z.value:
        return
    other = found.smoother
    case.find(
        "smoother",
        f"of order {case.arm.smoother.order} flattens the motion",
        f"with order {other.order} in a window of {other.points} points, {found.parameter} moves by "
        f"{found.sigmas:.2g} standard deviations: the intervals are too narrow",
        remedies.smoother(other.order, other.points),
    )
