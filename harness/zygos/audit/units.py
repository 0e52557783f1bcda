# SPDX-License-Identifier: MIT
"""The most common mistakes, which each signal shows by itself: angles that wrap, and readings in another unit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zygos import limits
from zygos.arm import Arm
from zygos.audit import remedies
from zygos.audit.case import Case
from zygos.audit.means import Array
from zygos.audit.readings import grid_step
from zygos.audit.remedies import Kind
from zygos.files.output import counted
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, Cycles
from zygos.runs.outliers import far_off, outliers
from zygos.runs.samples import LARGEST_ANGLE_RAD
from zygos.runs.wraps import wraps_of

FACTORS: dict[str, dict[str, float]] = {
    "angle": {"deg": math.pi / 180.0, "mrad": 1e-3, "turn": 2.0 * math.pi},
    "rate": {
        "deg/s": math.pi / 180.0,
        "rpm": 2.0 * math.pi / 60.0,
        "mrad/s": 1e-3,
        "mdeg/s": math.pi / 180e3,
        "turn/s": 2.0 * math.pi,
    },
    "torque": {"mNm": 1e-3},
    "current": {"mA": 1e-3},
}
"""SI units per unit of `zygos.telemetry.map`, for those units in which a reading may be by mistake."""
QUANTITY = {"q": "angle", "theta": "angle", "omega": "rate", "tau": "torque"}
SI = {"angle": "rad", "rate": "rad/s", "torque": "Nm", "current": "A"}


@dataclass(frozen=True)
class Scale:
    """A factor that a reading may lack."""

    factor: float
    """The quantity in SI units is this times the reading."""
    unit: str = ""
    """The reading's unit, if it is one; "counts" is one."""


def quantity(arm: Arm, kind: Kind) -> str:
    """Key of `FACTORS` for a field of `Cycles`."""
    return "current" if kind == "tau" and arm.torque_unit == "A" else QUANTITY[kind]


def scales(arm: Arm, kind: Kind, i: int) -> list[Scale]:
    """What the readings of a signal may be multiplied by, by mistake or for lack of it."""
    known = [Scale(factor, unit) for unit, factor in FACTORS[quantity(arm, kind)].items()]
    if kind in ("q", "theta"):
        joint = arm.joints[i]
        encoder = joint.link_encoder if kind == "q" else joint.motor_encoder
        known.append(Scale(encoder.quantum_rad, "counts"))
        ratio = float(joint.gear_ratio)
        known += [Scale(factor) for factor in (1.0 / ratio, ratio) if ratio != 1.0]
    return known


def nearest(known: list[Scale], factor: float, within: float = 1.0 + limits.STEP_OFF.value) -> Scale | None:
    """The scale that a measured factor is, within a ratio, that of steps by default; None where it is none of them."""
    best = min(known, key=lambda one: abs(math.log(one.factor / factor)))
    return best if abs(math.log(best.factor / factor)) <= math.log(within) else None


def rescaled(cycles: Cycles, kind: Kind, columns: list[int], factor: float) -> Cycles:
    """The run with readings multiplied."""
    readings: Array = getattr(cycles, kind).copy()
    readings[:, columns] *= factor
    fields: dict[str, Any] = {kind: readings}
    return replace(cycles, **fields)


def find_scale(case: Case, kind: Kind, i: int, scale: Scale, evidence: str) -> None:
    """Report a signal in another unit, or without its gear ratio."""
    name = case.name(kind, i)
    if not scale.unit:
        case.find(
            name,
            f"scaled by {1.0 / scale.factor:.4g}",
            evidence,
            remedies.scaled(case.arm, kind, i, scale.factor),
        )
        return
    own = SI[quantity(case.arm, kind)]
    case.find(
        name,
        f"in {scale.unit}, not in {own} (a factor of {max(scale.factor, 1.0 / scale.factor):.4g})",
        evidence,
        remedies.unit(case.arm, kind, i, scale.unit, scale.factor),
    )


def find_torque_scale(case: Case, i: int, factor: float, evidence: str) -> None:
    """Report a torque that has to be multiplied by a measured factor: in another unit, or by a wrong gear ratio."""
    unit = _torque_unit(case.arm, factor)
    if unit is not None:
        find_scale(case, "tau", i, unit, evidence)
        return
    case.find(
        case.name("tau", i), f"scaled by {1.0 / factor:.4g}", evidence, remedies.torque_scale(case.arm, i, factor)
    )


def common_torque_scale(arm: Arm, i: int, factor: float) -> bool:
    """Whether a factor by which a torque has to be multiplied is that of a unit or of the other side of its gear."""
    return _torque_unit(arm, factor) is not None or remedies.other_side(arm, i, factor)


def _torque_unit(arm: Arm, factor: float) -> Scale | None:
    units = [Scale(own, unit) for unit, own in FACTORS[quantity(arm, "tau")].items()]
    return nearest(units, factor, limits.SCALE_OFF.value)


def stretches(cycles: Cycles) -> list[tuple[int, int]]:
    """Half-open ranges of cycles in a row with finite readings, whatever their size."""
    finite = np.all(np.isfinite(np.hstack([cycles.q, cycles.theta, cycles.tau, cycles.omega])), axis=1)
    use = finite & ((cycles.flags & INVALID) == 0)
    joined = np.zeros(len(use), dtype=np.bool_)
    joined[1:] = use[1:] & use[:-1] & (np.diff(cycles.sync.astype(np.int64)) == 1)
    joined &= (cycles.flags & (BREAK_BEFORE | VOID_BEFORE)) == 0
    starts = np.flatnonzero(use & ~joined)
    ends = np.flatnonzero(use & ~np.append(joined[1:], False)) + 1
    return [(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]


def check_wraps(case: Case) -> None:
    """Report angles that start again after a turn, and go on with the run without the jumps."""
    for name, kind, i in case.names:
        if kind not in ("q", "theta"):
            continue
        found = wraps_of(case.arm, case.cycles, kind, i)
        if found is None:
            continue
        readings: Array = getattr(case.cycles, kind).copy()
        low, high = (float(np.nanmin(readings[:, i])), float(np.nanmax(readings[:, i])))
        readings[:, i] = found.readings
        fields: dict[str, Any] = {kind: readings}
        case.correct(replace(case.cycles, **fields))
        ends = f"±{found.half}" if low < -0.25 * found.turn else f"0 and {found.whole}"
        case.find(
            name,
            f"wraps {len(found.at)} time{'s' if len(found.at) > 1 else ''} at {ends}",
            f"readings from {low:.4g} to {high:.4g}; jumps by {found.whole} from one cycle to the next, the first "
            f"before cycle {int(case.cycles.sync[found.at[0]])}",
            remedies.wraps(case.arm, kind, i, found.turn),
        )


def check_impossible(case: Case) -> None:
    """Report samples that no arm could have produced between their neighbours, and go on with the run without them."""
    flags = case.cycles.flags.copy()
    for name, kind, i in case.names:
        readings = case.readings(kind, i)
        valid = np.flatnonzero(np.isfinite(readings) & ((flags & INVALID) == 0))
        x = readings[valid]
        found = outliers(x, case.declared_noise(kind, i))
        found = valid[found if kind in ("q", "theta") else far_off(x, found)]
        if 0 < len(found) <= limits.SECOND_SOURCE.value * len(x):
            case.find(
                name,
                f"has {counted(len(found), 'sample')} that no arm makes",
                f"first in cycle {int(case.cycles.sync[found[0]])} ({readings[found[0]]:.6g}), far from what the "
                "cycles beside it say",
                remedies.by_hand("`zygos convert RUN --arm ARM.toml -o NEW`, which leaves these cycles out"),
            )
            flags[found] |= np.uint32(INVALID)
    case.correct(replace(case.cycles, flags=flags))


def check_units(case: Case) -> None:
    """Report angles whose steps or noise are the declared ones in another unit, and go on with the run in radians."""
    ranges = stretches(case.cycles)
    angles: list[tuple[Kind, int]] = [(kind, i) for _, kind, i in case.names if kind in ("q", "theta")]
    for kind, i in angles:
        quantum = case.encoder(kind, i).quantum_rad
        readings = case.readings(kind, i)
        largest = max((float(np.abs(readings[a:b]).max()) for a, b in ranges), default=0.0)
        if largest > LARGEST_ANGLE_RAD:
            evidence = f"readings up to {largest:.4g}, which are no angles in rad"
            _correct_unit(case, kind, i, Scale(quantum, "counts"), evidence)
            continue
        step = grid_step(readings, ranges, 0.0)
        if not math.isfinite(step) or abs(step / quantum - 1.0) <= limits.STEP_OFF.value:
            continue
        known = [one for one in scales(case.arm, kind, i) if one.unit not in ("", "turn")]
        scale = nearest(known, quantum / step)
        if scale is not None:
            evidence = f"moves in steps of {step:.4g}, which are the declared {quantum:.4g} rad in {scale.unit}"
            _correct_unit(case, kind, i, scale, evidence)
    _check_noises(case, angles)


def _correct_unit(case: Case, kind: Kind, i: int, scale: Scale, evidence: str) -> None:
    find_scale(case, kind, i, scale, evidence)
    case.correct(rescaled(case.cycles, kind, [i], scale.factor))


def _check_noises(case: Case, angles: list[tuple[Kind, int]]) -> None:
    """Angles that are all noisier than declared by the factor of a unit are in that unit, and with them the gyro."""
    if len(angles) < 2 or case.findings:
        return
    rates: list[tuple[Kind, int]] = [(kind, i) for _, kind, i in case.names if kind == "omega"]
    for unit, factor in FACTORS["angle"].items():
        if factor < 1.0 and _noisier(case, angles, 1.0 / factor):
            found = [(one, unit) for one in angles]
            found += [(one, f"{unit}/s") for one in rates if _noisier(case, rates, 1.0 / factor)]
            for (kind, i), own in found:
                ratio = case.noise(kind, i) / case.declared_noise(kind, i)
                evidence = f"the noise of all of them is that of a unit, here {ratio:.3g} times the declared one"
                _correct_unit(case, kind, i, Scale(factor, own), evidence)
            return


def _noisier(case: Case, names: list[tuple[Kind, int]], factor: float) -> bool:
    """Whether all signals are noisier than declared by about a factor; motion makes the noise of some seem larger."""
    ratios = [case.noise(kind, i) / case.declared_noise(kind, i) for kind, i in names]
    least, middle = min(ratios, default=0.0), float(np.median(ratios or [0.0]))
    return factor / limits.AUDIT_SURE.value < least and middle < factor * limits.AUDIT_SURE.value
