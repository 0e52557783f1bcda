# SPDX-License-Identifier: MIT
"""What an estimate reports to a person besides its values, in sentences."""

from __future__ import annotations

import numpy as np

from zygos.arm import Arm
from zygos.effects import GAIN
from zygos.estimation.remedies import NO_FRAMES, UNCLOSED
from zygos.estimation.watch import Watch
from zygos.files.output import (
    counted,
    number,
)
from zygos.native.flight import MIN_SIGNAL_TO_NOISE, OVERDECLARED, ROWS, Drift, Estimate, Flight

LEFT_OUT_SHOWN = 6
"""Number of arcs of each kind of rows whose times are listed."""


def losses(flight: Flight) -> str:
    """The cycles and frames that the receiver lost, in words."""
    rejected = flight.fd_frames + sum(count for name, count in flight.faults.items() if name not in NO_FRAMES)
    return f"{counted(flight.faults['dropped'], 'cycle')} dropped, {counted(rejected, 'frame')} rejected"


def about_noise(result: Estimate) -> str:
    """How noise affects an estimate; empty where the effect is small."""
    if result.rank == 0:
        return ""  # nothing was solved, so nothing was compared with the noise
    if result.signal_to_noise < MIN_SIGNAL_TO_NOISE:
        return (
            f"noise: in some combination of parameters the motion is {number(result.signal_to_noise, 2)} times as "
            "large as the sensors' noise"
            + ("; the intervals cover the bias of that" if np.isfinite(result.half95).any() else "")
        )
    if result.noise_ratio < OVERDECLARED:
        return (
            f"noise: the sum of squared residuals is {number(result.noise_ratio, 2)} of what the arm file's sigmas "
            "predict; the declared noise was scaled down accordingly"
        )
    if result.noise_ratio > 1.0 / OVERDECLARED:
        return (
            f"noise: the sum of squared residuals is {number(result.noise_ratio, 2)} times what the arm file's sigmas "
            "predict: the sensors have more noise, or an effect is missing in the balance"
            + ("; the intervals cover the bias of that" if np.isfinite(result.half95).any() else "")
        )
    return ""


def about_left_out(result: Estimate, watch: Watch) -> str:
    """Number and times of the arcs that contradicted the others; empty if there are none."""
    if not any(result.left_out):
        return ""
    period, found = watch.flight.arm.period_s, []
    for rows, count in zip(ROWS, result.left_out, strict=True):
        spans = [f"{arc.first * period:.0f}..{arc.last * period:.0f} s" for arc in watch.left_out if arc.rows == rows]
        opened = ["the newest, still open"] if count > watch.flight.native.sums.guard.left_out[ROWS.index(rows)] else []
        shown = [*spans[:LEFT_OUT_SHOWN], *(["…"] if len(spans) > LEFT_OUT_SHOWN else []), *opened]
        said = f"{counted(count, 'arc')} of the {rows} rows"
        if watch.flight.joints_alone:
            said = f"{counted(count, 'segment')} of the joint rows"
        found += [f"{said} ({', '.join(shown)})"] if count else []
    return f"arcs left out because they contradict the others: {'; '.join(found)}"


def shows_change(result: Estimate, drift: Drift) -> bool:
    """Whether a contradiction is one of the arm: the balance of all data closes, and more than gains of torque sensors
    contradicts."""
    gains = all(name.startswith(GAIN) for name in drift.changed)
    return bool(drift.changed) and result.reason != UNCLOSED and not gains


def about_change(result: Estimate, drift: Drift, arm: Arm) -> str:
    """A message that the arm changed, or another reason why an arc contradicts those before it, with the remedy."""
    values = "are those before the change" if result.consecutive else "are a mixture of before and after"
    names = ", ".join(
        f"{name} by {abs(far):.0f}"
        for name, far in zip(drift.names, drift.deviation, strict=True)
        if name in drift.contradicting
    )
    at = f"after {drift.until * arm.period_s:.0f} s"
    if drift.changed and not shows_change(result, drift):
        return (
            f"the data {at} contradict the data before, in standard deviations: {names}; a change of the arm is the "
            "cause, or an error of the readings that different motions show differently, as a delay or a scale; "
            "remedy: `zygos check-arm`, and where it confirms the run, split the log there, or let old arcs fade "
            "([arc] memory_min)"
        )
    if drift.changed:
        return (
            f"the arm changed {at}, in standard deviations: {names}; the values {values}; remedy: split "
            "the log there, or let old arcs fade ([arc] memory_min); on board call zygos_arm_restart()"
        )
    return (
        f"the data {at} contradict the data before, in standard deviations: {names}; but what the values of their own "
        "leave over is not noise, so the cause is a delay or a scale, an effect without a column, for instance "
        "friction, in a different motion, or a change of the arm; remedy: `zygos check-arm`, then name friction with "
        "--model, and estimate both parts of the log separately: if each balance closes, the arm is another one there"
    )
