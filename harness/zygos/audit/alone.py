# SPDX-License-Identifier: MIT
"""Each signal of a run alone: what came of it, whether it is stuck or saturated, its steps and its noise."""

from __future__ import annotations

import math

import numpy as np

from zygos import limits
from zygos.arm import ANGLE_STEP
from zygos.audit import remedies
from zygos.audit.case import Case
from zygos.audit.readings import noise_level, runs_of_equal
from zygos.audit.remedies import Kind, by_hand


def check_traffic(case: Case) -> None:
    """Report what only the frames show: the period, losses, and codes at the end of a signal's range."""
    measured, declared = case.traffic.period_s, case.arm.period_s
    if math.isfinite(measured) and abs(measured / declared - 1.0) > limits.PERIOD_OFF.value:
        case.find(
            "SYNC",
            f"every {1e3 * measured:.4g} ms, not {1e3 * declared:.4g} ms",
            "FTIME compared with the count of SYNCs",
            remedies.period(measured),
        )
    for name, _, _ in case.names:
        share = case.share(name)
        if share < 1.0 - limits.LOST.value:
            case.find(
                name,
                "missing" if share == 0.0 else f"loses {100 * (1 - share):.1f} %",
                f"{100 * share:.1f} % of the cycles",
                by_hand(
                    "compare the node numbers of the arm file with the bus"
                    if share == 0.0
                    else "repair the bus or the recording"
                ),
            )
        count = case.traffic.saturated.get(name, 0)
        if count:
            case.find(
                name,
                "saturated",
                f"{count} frames at the end of the CAN signal's range",
                by_hand("use a sensor with a larger range"),
            )


def check_flat(case: Case) -> set[int]:
    """Report stuck or saturated signals; returns the joints that cannot be used because of them (-1: the gyro)."""
    broken = set()
    for name, kind, i in case.names:
        if kind == "omega" and not case.used_axis(i):
            continue
        verdict = _flat(case, kind, i)
        if verdict is not None:
            fault, evidence = verdict
            if not any(f.signal == name and f.fault == fault for f in case.findings):
                remedy = "repair the sensor or its telemetry"
                if fault == "saturated":
                    remedy = "use a sensor with a larger range, or a slower motion; nothing if the drive stops there"
                case.find(name, fault, evidence, by_hand(remedy))
            broken.add(-1 if kind == "omega" else i)
    return broken


def _flat(case: Case, kind: Kind, i: int) -> tuple[str, str] | None:
    readings = case.readings(kind, i)
    flat = runs_of_equal(readings, case.ranges, limits.FLAT_TOP_CYCLES.value)
    if not flat:
        return None
    valid = case.valid(kind, i)
    ends = (float(valid.min()), float(valid.max()))
    moving = [(a, b) for a, b in flat if _partner_moves(case, kind, i, a, b)]
    if ends[0] < ends[1]:
        for end in ends:
            tops = [(a, b) for a, b in flat if readings[a] == end]
            # at a turning point the code of an encoder is constant; there the partner must continue to move
            tops = tops if kind in ("tau", "omega") else [t for t in tops if t in moving]
            length = sum(b - a for a, b in tops)
            if len(tops) >= limits.FLAT_TOPS.value and length > limits.FLAT_TOP.value * len(valid):
                return "saturated", f"{length} cycles at {end:.6g}, in {len(tops)} runs"
    stuck = [
        (a, b) for a, b in moving if b - a >= limits.FLAT_CYCLES.value and not (kind == "tau" and readings[a] == 0.0)
    ]
    if ends[0] == ends[1]:
        stuck = moving
    if stuck:
        a, b = max(stuck, key=lambda r: r[1] - r[0])
        fault = "saturated" if ends[0] < ends[1] and readings[a] in ends else "stuck"
        return fault, f"{b - a} cycles at {readings[a]:.6g}, starting at cycle {int(case.cycles.sync[a])}"
    return None


def _partner_moves(case: Case, kind: Kind, i: int, a: int, b: int) -> bool:
    """Whether the partner of a signal moves between a and b, far enough that the signal should move as well."""
    joints = range(case.arm.n) if kind == "omega" else (i,)
    for j in joints:
        flexible = case.arm.joints[j].flexible
        partners = {"q": ("theta",), "theta": ("q",) if flexible else (), "tau": ("theta",)}.get(kind, ("theta",))
        for partner in partners:
            readings = case.readings(partner, j)
            quanta = limits.FLAT_QUANTA.value * (_step(case, "q", j) + _step(case, "theta", j))
            whole = max(float(np.ptp(readings[c:d])) for c, d in case.ranges)
            if float(np.ptp(readings[a:b])) > max(quanta, limits.FLAT.value * whole):
                return True
    return False


def _step(case: Case, kind: Kind, i: int) -> float:
    """The larger one of an encoder's declared step and its observed step, rad."""
    seen = case.seen_step(kind, i)
    return max(case.encoder(kind, i).quantum_rad, seen if math.isfinite(seen) else 0.0)


def check_steps(case: Case) -> None:
    """Report steps and noise that are not the declared ones."""
    for name, kind, i in case.names:
        if kind == "omega":
            _gyro_noise(case, name, i)
        elif kind != "tau" and not (
            case.faulty(name, "scaled", "in ") or (name in case.undecided and case.beside_counts(kind, i))
        ):
            _angle_steps(case, name, kind, i)
    # a torque's own noise cannot be separated from the encoder noise that a controller passes on, if the controller
    # reads different values
    spoilt = ("moves in steps", "noisier", "stuck", "saturated")
    if any(f.fault.startswith(spoilt) and f.signal.endswith("angle") for f in case.findings):
        return
    # nor can it if an encoder is not read at SYNC, at which the controller reads it
    late = {i for name, _, i in case.names if case.faulty(name, "skewed")}
    late |= {
        i
        for i, joint in enumerate(case.arm.joints)
        if joint.latch_us + joint.link_encoder.latch_us + joint.motor_encoder.latch_us > 0
    }
    for name, kind, i in case.names:
        if kind == "tau" and name not in case.undecided and i not in late and not case.faulty(name):
            _torque_noise(case, name, i)


def _angle_steps(case: Case, name: str, kind: Kind, i: int) -> None:
    step, quantum = case.seen_step(kind, i), case.encoder(kind, i).quantum_rad
    noise, declared = case.noise(kind, i), case.declared_noise(kind, i)
    interpolated = step < quantum and noise_level(case.readings(kind, i), case.ranges) >= (
        limits.AS_NOISY.value * declared
    )
    if math.isfinite(step) and abs(step / max(quantum, ANGLE_STEP) - 1.0) > limits.STEP_OFF.value and not interpolated:
        case.find(
            name,
            f"moves in steps of 2π/{2 * math.pi / step:.0f}, not 2π/{2 * math.pi / quantum:.0f}",
            f"{step:.4g} rad, declared {quantum:.4g} rad",
            remedies.steps(case.arm, kind, i, step),
        )
    elif noise > limits.NOISE_OFF.value * declared:
        case.find(
            name,
            f"noisier than declared by a factor of {noise / declared:.1f}",
            f"{noise:.2g} rad in every band of the spectrum, declared {declared:.2g} rad",
            remedies.noisy_angle(case.arm, kind, i, noise),
        )


def _gyro_noise(case: Case, name: str, axis: int) -> None:
    noise, declared = case.noise("omega", axis), case.declared_noise("omega", axis)
    if noise > limits.NOISE_OFF.value * declared and not case.faulty(name):
        case.find(
            name,
            f"noisier than declared by a factor of {noise / declared:.1f}",
            f"{noise:.2g} rad/s in every band of the spectrum, declared {declared:.2g} rad/s",
            remedies.noisy_gyro(noise),
        )


def _torque_noise(case: Case, name: str, i: int) -> None:
    sigma, readings, unit = case.arm.joints[i].torque_sigma, case.readings("tau", i), case.arm.torque_unit
    own, whole = case.noise("tau", i), noise_level(readings, case.ranges)
    declared = case.arm.over_the_wire.joints[i].torque_sigma
    if not own > max(
        limits.NOISE_OFF.value * declared, limits.TORQUE_NOISE_SEEN.value * float(np.std(case.valid("tau", i)))
    ):
        return
    remedy = remedies.noisy_torque(case.arm, i, own)
    if limits.FOLLOWS.value < own / whole < limits.ALONE.value:
        case.remarks.append(
            f"{name}: changes from cycle to cycle by {whole:.2g} {unit}, and {100 * (1 - (own / whole) ** 2):.0f} % of "
            "the variance is correlated with the readings of encoders and gyro: either a controller that reads "
            f"different values applies this torque, or the torque is noisier than declared ({sigma:.2g} {unit})"
        )
    elif sigma == 0.0:
        case.remarks.append(f"{name}: changes by {own:.2g} {unit} at random, and no noise is declared; {remedy.text}")
    else:
        case.find(
            name,
            f"noisier than declared by a factor of {own / sigma:.1f}",
            f"{own:.2g} {unit}, declared {sigma:.2g} {unit}, without the part that follows the noise of encoders and "
            "gyro",
            remedy,
        )
