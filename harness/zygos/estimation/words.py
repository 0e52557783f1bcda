"""What an estimate tells a person besides its values, in sentences."""

from __future__ import annotations

import numpy as np

from zygos.arm import Arm
from zygos.estimation.remedies import NO_FRAMES
from zygos.estimation.watch import Watch
from zygos.files.output import (
    counted,
    number,
)
from zygos.native.flight import GATE, OVERDECLARED, ROWS, Drift, Estimate, Flight

LEFT_OUT_SHOWN = 6
"""Arcs of a kind whose times are said."""


def losses(flight: Flight) -> str:
    """What the receiver lost, in words."""
    rejected = sum(count for name, count in flight.faults.items() if name not in NO_FRAMES)
    return f"{counted(flight.faults['dropped'], 'cycle')} dropped, {counted(rejected, 'frame')} rejected"


def about_noise(result: Estimate) -> str:
    """What the noise did to an estimate, where that is worth a word."""
    if result.rank == 0:
        return ""  # nothing was solved, so nothing was weighed against the noise
    if result.gate < GATE:
        return (
            f"noise: in some combination of parameters the motion is {number(result.gate, 2)} times as large as the "
            "sensors' noise" + ("; the intervals hold what that may hide" if np.isfinite(result.half95).any() else "")
        )
    if result.noise_ratio < OVERDECLARED:
        return (
            f"noise: the residuals' square is {number(result.noise_ratio, 2)} of what the arm file's sigmas make of it;"
            " they were believed to that extent"
        )
    if result.noise_ratio > 1.0 / OVERDECLARED:
        return (
            f"noise: the residuals' square is {number(result.noise_ratio, 2)} times what the arm file's sigmas make of "
            "it: sensors are noisier, or something is not in the balance"
            + ("; the intervals hold what that may hide" if np.isfinite(result.half95).any() else "")
        )
    return ""


def about_left_out(result: Estimate, watch: Watch) -> str:
    """How many arcs contradicted the others, and when; empty where none did."""
    if not any(result.left_out):
        return ""
    period, found = watch.flight.arm.period_s, []
    for rows, count in zip(ROWS, result.left_out, strict=True):
        spans = [f"{arc.first * period:.0f}..{arc.last * period:.0f} s" for arc in watch.left_out if arc.rows == rows]
        opened = ["the newest, still open"] if count > watch.flight.native.guard.left_out[ROWS.index(rows)] else []
        shown = [*spans[:LEFT_OUT_SHOWN], *(["…"] if len(spans) > LEFT_OUT_SHOWN else []), *opened]
        found += [f"{counted(count, 'arc')} of the {rows} rows ({', '.join(shown)})"] if count else []
    return f"left out, for they contradict the others: {'; '.join(found)}"


def about_change(result: Estimate, drift: Drift, arm: Arm) -> str:
    """That the arm changed, or what else may have made an arc contradict those before it, and what to do."""
    values = "are those of the arm before" if result.in_a_row else "mix what it was and is"
    names = ", ".join(
        f"{name} by {abs(far):.0f}"
        for name, far in zip(drift.names, drift.deviation, strict=True)
        if name in drift.contradicting
    )
    at = f"after {drift.until * arm.period_s:.0f} s"
    if drift.changed:
        return (
            f"the arm changed {at}, in standard deviations: {names}; the values {values}; remedy: split "
            "the log there, or let old arcs fade ([arc] memory_min); on board zygos_restart()"
        )
    return (
        f"what comes {at} contradicts what came before, in standard deviations: {names}; but the balance does not "
        f"close on both sides (residuals add up {drift.cluster:.0f} times in a block, noise once), so this is an "
        "effect without a column, friction for instance, in a motion that was another, or a change of the arm; remedy: "
        "name friction with --model, and estimate both parts of the log by themselves: where each closes, the arm "
        "changed"
    )
