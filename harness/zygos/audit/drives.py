# SPDX-License-Identifier: MIT
"""Faults of angles and torques by the laws of the motors, one after the other, and of the encoder pairs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

from zygos import limits
from zygos.arm import Joint
from zygos.audit import remedies
from zygos.audit.balance import Balance
from zygos.audit.case import Case
from zygos.audit.encoders import pair, unskewed
from zygos.audit.findings import Pair
from zygos.audit.means import Means
from zygos.audit.motors import NOTHING, Change, Motors, changed
from zygos.audit.readings import noise_level
from zygos.audit.remedies import ANGLES
from zygos.audit.units import Scale, find_scale, nearest, scales
from zygos.errors import ZygosError


def check_motors(case: Case, use: list[int], means: Means, broken: set[int]) -> tuple[Motors, list[int]]:
    """Report faults of angles and torques; each is corrected before the next is searched. Returns the laws of the
    corrected run and the joints in which nothing was wrong."""
    touched: set[int] = set()
    motors = Motors(means, use)
    for _ in range(3 * len(use)):
        now = motors.total(NOTHING)
        ranked = sorted(((motors.total(c), k, c) for k, c in enumerate(motors.changes())), key=lambda r: r[:2])
        held = [
            r for r in ranked if now - r[0] < math.log(limits.AUDIT_SURE.value) or _holds(case, motors, r[2], broken)
        ]
        if not held or now - held[0][0] < math.log(limits.AUDIT_SURE.value):
            _doubt(case, motors, ranked[0][2] if ranked and ranked[0] not in held else NOTHING)
            break
        ranked = held
        total, _, change = ranked[0]
        rivals = [
            r[2]
            for r in ranked[1:]
            if r[0] - total < math.log(limits.AUDIT_SURE.value) and set(r[2].joints) & set(change.joints)
        ]
        if change.what == "scaled":
            # the scale of a motor's law is unknown: the wrong angle is the one whose noise differs from the declared
            alike = sorted((_noise_off(case, c), k, c) for k, c in enumerate([change, *rivals]) if c.what == "scaled")
            change = alike[0][2]
            rivals = [c for off, _, c in alike[1:] if off - alike[0][0] < math.log(limits.NOISE_OFF.value)]
            # a factor that is a unit's rather than one that fits a little better
            same = [change, *(c for c in rivals if c.kind == change.kind)]
            rivals = [c for c in rivals if c.kind != change.kind]
            change = next((c for c in same if _scale(case, c) is not None), change)
        find_change(case, change, math.exp(now - total), rivals[0] if rivals else None)
        touched |= set(change.joints)
        case.correct(changed(case.cycles, change, case.zeros))
        motors = Motors(Means(case.arm, case.cycles), use)
    return motors, [i for i in use if i not in touched]


def confirm_torques(case: Case, motors: Motors, clean: list[int]) -> list[int]:
    """Note which signs the laws do not confirm; returns the rigid joints whose torque no law of a single motor
    explains."""
    unfit = []
    for i in clean:
        joint = case.arm.joints[i]
        if motors.left(i, NOTHING) > limits.MOTOR_FITS.value and not joint.flexible and len(motors.use) > 1:
            unfit.append(i)
            continue
        here = motors.score(i, NOTHING)
        turned = motors.score(i, Change("inverted", "tau", (i,), (i,), -1.0))
        if turned - here < math.log(limits.AUDIT_SURE.value) or math.exp(here) > limits.SIGN_EXPLAINED.value:
            case.undecided.add(case.name("tau", i))
            case.notes.append(
                f"{joint.name}: the sign of the torque is not decided "
                f"(inverted, it is explained {math.exp(here - turned):.2f} times as well)"
            )
        if joint.flexible and motors.stiff[i]:
            case.remarks.append(f"{joint.name}: too stiff to decide whether motor and link encoder are exchanged")
    return unfit


def _holds(case: Case, motors: Motors, change: Change, broken: set[int]) -> bool:
    """Whether the best change is accepted: the motors' laws must fit after it, and where they do not fit well, the
    balance of the whole arm, if there is one, must not contradict."""
    if change.kind != "tau" and all(motors.stiff[i] for i in change.joints):
        return True  # the two rates are sufficient evidence
    left = max(motors.left(i, change) for i in change.joints)
    if left > limits.MOTOR_FITS.value:
        return False
    if left <= limits.MOTOR_FITS_WELL.value or change.kind != "tau" or broken:
        return True
    try:
        balance = Balance(case.arm, case.cycles)
    except ZygosError:
        return True
    # if both residuals are infinite, the comparison is False, and the law alone decides
    return (
        not balance.residual(case.arm, changed(balance.cycles, change, case.zeros))
        > limits.AUDIT_SURE.value * balance.residual_j
    )


def _doubt(case: Case, motors: Motors, change: Change) -> None:
    """Note that a change of flexible joints would explain the run better, but is not proven."""
    for i in change.joints:
        if case.arm.joints[i].flexible:
            case.undecided.add(case.name(change.kind or "theta", i))
            case.notes.append(
                f"{case.arm.joints[i].name}: {_called(case, change)} would explain the run better, but even then "
                f"the law of the motor leaves {100 * motors.left(i, change):.0f} % of the torque unexplained, or "
                "the energy balance contradicts; it is therefore not reported as a fault"
            )


def _noise_off(case: Case, change: Change) -> float:
    """Distance of an angle's noise, after correction of its scale, from the declared one: logarithm of the ratio."""
    i = change.joints[0]
    assert change.kind is not None
    noise = change.factor * noise_level(case.readings(change.kind, i), case.ranges)
    return abs(math.log(max(noise, 1e-300) / case.declared_noise(change.kind, i)))


def find_change(case: Case, change: Change, ratio: float, rival: Change | None, *, whole: bool = False) -> None:
    """Report a fault. whole: the evidence is the balance of the whole arm."""
    evidence = f"{'the energy balance closes' if whole else 'explains the run'} {ratio:.3g} times better"
    if rival is not None:
        evidence += f"; {_called(case, rival)} would explain it equally well"
    if change.kind is None:
        i = change.joints[0]
        for kind, other in (("q", "theta"), ("theta", "q")):
            case.find(
                case.name(kind, i), f"swapped with {case.name(other, i)}", evidence, remedies.exchanged(case.arm, i)
            )
    elif change.what == "swapped":
        for i, j in zip(change.joints, change.source, strict=True):
            case.find(
                case.name(change.kind, i),
                f"swapped with {case.name(change.kind, j)}",
                evidence,
                remedies.swapped(case.arm, change.kind, i, j),
            )
    elif change.what == "inverted":
        i = change.joints[0]
        case.find(case.name(change.kind, i), "inverted", evidence, remedies.inverted(case.arm, change.kind, i))
    else:
        i = change.joints[0]
        if case.beside_counts(change.kind, i):
            name = case.name(change.kind, i)
            case.undecided.add(name)
            case.notes.append(
                f"{name}: its scale is not decided, because the other angle is in counts: check counts_per_turn"
            )
            return
        find_scale(case, change.kind, i, _scale(case, change) or Scale(change.factor), evidence)


def _scale(case: Case, change: Change) -> Scale | None:
    """The unit or gear ratio that a change of scale is; None for another factor."""
    assert change.kind is not None
    known = scales(case.arm, change.kind, change.joints[0])
    return nearest(known, change.factor, 1.0 + 1e-9)


def _called(case: Case, change: Change) -> str:
    who = " and ".join(case.name(change.kind or "theta", i) for i in change.joints)
    return f"{who} {change.what}"


def check_zeros(case: Case, motors: Motors, clean: list[int]) -> dict[int, Pair]:
    """Compare the two encoders of each joint, report zeros that are off, and go on with the run without them."""
    found = {i: pair(motors.means, i, motors.stiff[i]) for i in clean if case.arm.joints[i].flexible}
    q = case.cycles.q.copy()
    for i, own in found.items():
        first, second = case.arm.joints[i].link_encoder, case.arm.joints[i].motor_encoder
        allowed = 3.0 * math.hypot(first.zero_sigma_rad, second.zero_sigma_rad)
        allowed += first.quantum_rad + second.quantum_rad + limits.ZERO_Z.value * own.zero_sigma_rad
        if abs(own.zero_rad) > allowed:
            case.find(
                case.name("q", i),
                f"zero off by {1e3 * -own.zero_rad:.3g} mrad ± {1e3 * own.zero_sigma_rad:.1g}",
                f"{abs(own.zero_rad) / max(own.zero_sigma_rad, 1e-300):.1f} standard errors",
                remedies.zero(case.arm, i, -own.zero_rad),
            )
            q[:, i] += first.sign * own.zero_rad
    case.correct(replace(case.cycles, q=q))
    return found


def check_skews(case: Case, found: dict[int, Pair], balance: Balance | None) -> dict[int, float]:
    """Report encoders that are read at another time than their partner; returns the skews that were reported, s."""
    named: dict[int, float] = {}
    wanted = {
        i: p.skew_s
        for i, p in found.items()
        if abs(p.skew_s) > max(limits.SKEW_Z.value * p.skew_sigma_s, limits.SKEW.value * case.arm.period_s)
        and not any(case.late(kind, i) for kind in ANGLES)
    }
    for i in wanted:
        joint, own = case.arm.joints[i], found[i]
        if not _is_friction(case, i, own, wanted, balance):
            named[i] = own.skew_s
            _find_skew(case, i, joint, own)
            continue
        late = f"{1e3 * abs(own.skew_s):.3g} ms ± {1e3 * own.skew_sigma_s:.1g}"
        if balance is None:
            why = "a newer link encoder or viscous friction of the motor, which only a balance could decide"
            case.notes.append(f"{joint.name}: {late} between the encoders are {why}")
        else:
            why = "viscous friction of the motor and not a skew: with a latch the energy balance closes worse"
            case.remarks.append(f"{joint.name}: {late} between the encoders are {why}")
    return named


def _is_friction(case: Case, i: int, own: Pair, wanted: dict[int, float], balance: Balance | None) -> bool:
    """Whether the apparent skew of a newer link encoder is viscous friction of the motor.

    For a soft joint, s = n tau - Im n^2 thetadd - friction: friction that grows with the rate reduces theta - q as
    a newer link encoder does. The balance of the whole arm includes friction, and closes worse with a latch that is
    not real.
    """
    if own.stiff or own.skew_s > 0.0:
        return False
    if balance is None:
        return True
    others = {j: skew for j, skew in wanted.items() if j != i}
    without = balance.residual(*unskewed(case.arm, balance.cycles, others))
    return not balance.residual(*unskewed(case.arm, balance.cycles, wanted)) < without


def _find_skew(case: Case, i: int, joint: Joint, own: Pair) -> None:
    newer, older = ("motor", "link") if own.skew_s > 0 else ("link", "motor")
    case.find(
        f"{joint.name} {newer} angle",
        f"skewed {1e3 * abs(own.skew_s):.3g} ms ± {1e3 * own.skew_sigma_s:.1g}",
        f"newer than the {older} angle, {abs(own.skew_s) / own.skew_sigma_s:.0f} standard errors",
        remedies.skew(case.arm, i, own.skew_s),
    )


def _torque_changes(unfit: list[int], use: list[int]) -> Iterator[Change]:
    """The torque of one of the unfit joints inverted, or exchanged with that of another joint in use."""
    for i in unfit:
        yield Change("inverted", "tau", (i,), (i,), -1.0)
    for i, j in itertools.combinations(use, 2):
        if i in unfit or j in unfit:
            yield Change("swapped", "tau", (i, j), (j, i))


def check_coupled(case: Case, balance: Balance | None, motors: Motors, unfit: list[int]) -> Balance | None:
    """Decide signs and places of torques that no motor's law explains, by the balance of the whole arm, which includes
    the coupling of the joints; returns the balance after correction of the reported fault."""
    if not unfit:
        return balance
    left = ", ".join(f"{case.arm.joints[i].name} {100 * motors.left(i, NOTHING):.0f} %" for i in unfit)
    problem = f"the law of a single motor does not fit, it leaves unexplained: {left} of the torque"
    names = {case.name("tau", i) for i in unfit}
    if balance is None:
        case.undecided |= names
        case.notes.append(f"{problem}; signs and places of these torques are not decided")
        return None
    now = balance.residual_j
    trials = sorted(
        (
            (balance.residual(case.arm, changed(balance.cycles, change, case.zeros)), k, change)
            for k, change in enumerate(_torque_changes(unfit, motors.use))
        ),
        key=lambda trial: trial[:2],
    )
    best, _, change = trials[0]
    if now / best >= limits.AUDIT_SURE.value:
        # with all torques inverted the balance is the same, so it cannot decide which one of two is wrong
        rival = next((c for value, _, c in trials[1:] if value / best < limits.SURE_LAW.value), None)
        find_change(case, change, now / best, rival, whole=True)
        return Balance(case.arm, changed(balance.cycles, change, case.zeros))
    if best / now < limits.AUDIT_SURE.value:
        case.undecided |= names
        case.notes.append(
            f"{problem}; signs and places of these torques are not decided ({_called(case, change)}, the energy "
            f"balance of the whole arm closes {now / best:.2f} times as well)"
        )
    else:
        case.remarks.append(
            f"{problem}; the energy balance of the whole arm, which includes their coupling, confirms signs and "
            f"places (any change closes it worse by {best / now:.2g} or more), except for an inversion of all "
            "torques together"
        )
    return balance
