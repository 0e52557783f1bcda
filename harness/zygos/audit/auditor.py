# SPDX-License-Identifier: MIT
"""The audit: each signal alone, signals compared with each other, and the whole arm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zygos.arm import Arm, TorqueLaw
from zygos.audit.alone import check_flat, check_steps, check_traffic
from zygos.audit.case import GROUPS, Case
from zygos.audit.drives import check_coupled, check_motors, check_skews, check_zeros, confirm_torques
from zygos.audit.findings import Audit, Pair, Signal, Traffic
from zygos.audit.grounded import check_grounded
from zygos.audit.means import Means
from zygos.audit.remedies import KINDS, Kind
from zygos.audit.units import check_impossible, check_units, check_wraps, stretches
from zygos.audit.whole import (
    check_gains,
    check_smoother,
    check_timing,
    check_whole,
    judge_law,
    make_balance,
    no_balance,
)
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles


def audit(
    arm: Arm, cycles: Cycles, traffic: Traffic | None = None, progress: Callable[[float], None] | None = None
) -> Audit:
    """Audit a run against its arm file. progress is called with the share that is finished.

    Errors: ZygosError if the run has a different number of joints than the arm.
    """
    if cycles.q.shape[1] != arm.n:
        raise ZygosError(
            f"the run has {cycles.q.shape[1]} joints, arm {arm.name} has {arm.n}; remedy: give the arm file with "
            "which the run was made"
        )
    report = progress or (lambda _: None)
    case = Case(arm, cycles, traffic or Traffic())
    check_wraps(case)
    check_impossible(case)
    check_units(case)
    check_traffic(case)
    broken = check_flat(case)
    report(0.1)
    means = Means(arm, case.cycles)
    pairs: list[Pair] = []
    laws: dict[TorqueLaw, float] = {}
    if means.count:
        pairs, laws = _together(case, means, broken, report)
    else:
        case.undecided |= {name for name, _, _ in case.names}
        case.short = len(cycles) > 0
        case.notes.append(
            "the run has no part without a gap that is long enough to compare signals with each other "
            f"({4 * arm.smoother.points + 4} cycles)"
            if len(cycles)
            else f"no complete cycle of arm {arm.name} was received, so nothing can be compared"
        )
    check_steps(case)
    report(1.0)
    return Audit(
        signals=_signals(case),
        # noise spoils nothing else
        findings=tuple(sorted(case.findings, key=lambda one: one.fault.startswith("noisier"))),
        pairs=tuple(pairs),
        laws=laws,
        notes=tuple(case.notes),
        remarks=tuple(case.remarks),
        still=tuple(case.still),
        short=case.short,
    )


def _together(
    case: Case, means: Means, broken: set[int], report: Callable[[float], None]
) -> tuple[list[Pair], dict[TorqueLaw, float]]:
    """Compare signals with each other; returns the encoder pairs, and what each torque law leaves."""
    use = []
    for i, joint in enumerate(case.arm.joints):
        if i in broken:
            continue
        if means.moves(i):
            use.append(i)
        else:
            case.notes.append(f"{joint.name}: does not move, so nothing is decided")
            case.still.append(joint.name)
            case.undecided |= {case.name(kind, i) for kind in KINDS}
    if case.arm.grounded and use:
        check_grounded(case, use, broken)
        report(0.8)
        balance = make_balance(case, broken)
        if balance is None:
            return [], {}
        laws = judge_law(case, balance, {})
        check_smoother(case, balance)
        return [], laws
    motors, clean = check_motors(case, use, means, broken)
    unfit = confirm_torques(case, motors, clean)
    report(0.4)
    if not use:
        no_balance(case, "no joint with working signals moves")
        return [], {}
    pairs = check_zeros(case, motors, clean)
    balance = check_coupled(case, make_balance(case, broken), motors, unfit)
    late = None
    if balance is not None:
        balance, late = check_whole(case, check_gains(case, balance), pairs)
    report(0.8)
    skewed = check_skews(case, pairs, balance)
    if balance is None:
        return list(pairs.values()), {}
    if late is not None and not skewed:
        balance = check_timing(case, balance, late, pairs)
    laws = judge_law(case, balance, skewed)
    check_smoother(case, balance)
    return list(pairs.values()), laws


def _signals(case: Case) -> tuple[Signal, ...]:
    """The table: the readings as they were read, and what is said of them."""
    read = Case(case.arm, case.read, case.traffic)
    read.ranges = tuple(stretches(case.read))
    return tuple(_signal(case, read, *entry) for entry in case.names)


def _signal(case: Case, read: Case, name: str, kind: Kind, i: int) -> Signal:
    valid = read.valid(kind, i)
    angle = kind in ("q", "theta")
    faults = [f.fault for f in case.findings if f.signal in (name, GROUPS[kind], *(["angles"] if angle else []))]
    decided = name not in case.undecided or bool(faults)
    return Signal(
        name=name,
        unit={"tau": case.arm.torque_unit, "omega": "rad/s"}.get(kind, "rad"),
        share=case.share(name),
        low=float(np.min(valid)),
        high=float(np.max(valid)),
        step=read.seen_step(kind, i) if angle else np.nan,
        quantum=case.encoder(kind, i).quantum_rad if angle else np.nan,
        noise=read.noise(kind, i),
        declared=case.declared_noise(kind, i),
        decided=decided,
        verdict="; ".join(faults) or ("ok" if decided else "not decidable"),
    )
