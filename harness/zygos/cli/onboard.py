# SPDX-License-Identifier: MIT
"""What a flight computer on the bus tells of its refinement, as a table and for the JSON of `zygos listen`."""

from __future__ import annotations

from typing import Any

from zygos.arm import Arm
from zygos.can.rounds import Telemetry, refined_of
from zygos.files.output import counted, number, ratio, say, table
from zygos.native.flight import CHANNELS
from zygos.native.refine import Refined
from zygos.native.refiner import NORMAL_95


def report_refined(telemetry: Telemetry, arm: Arm, shown: bool) -> dict[str, Any] | None:
    """The newest result that was told, for the JSON; None where there was none. shown: also print it."""
    found = refined_of(telemetry.newest or {}, arm.parameter_names)
    if found is not None and shown:
        _show(found, arm)
    return None if found is None else _as_dict(found, arm)


def _show(found: Refined, arm: Arm) -> None:
    """Print the refined values where they are published, the innovations, and why."""
    if found.published:
        parameters = zip(arm.parameter_names, arm.parameter_units, found.value, NORMAL_95 * found.sigma, strict=True)
        rows = [
            (name, unit, number(value, 8), number(half, 2), number(100.0 * ratio(half, abs(value)), 2))
            for name, unit, value, half in parameters
        ]
        table(("refined on board", "unit", "value", "±95 %", "in %"), rows)
    innovations = [(channel, number(nis, 3), number(most, 3)) for channel, nis, most in _innovations(found, arm)]
    table(("innovations on board", "mean square", "largest ratio"), innovations)
    say(
        f"on board: {found.text} · noise of the torques {number(found.level, 3)} times the declared one · "
        f"{arm.parameter_names[found.farthest]} is at {number(found.distance, 2)} of the distance that passes · "
        f"{counted(found.used, 'use')} of readings, {found.lost:,} cycles bridged, {found.restarts:,} restarts, "
        f"{found.rejected:,} readings rejected"
    )


def _as_dict(found: Refined, arm: Arm) -> dict[str, Any]:
    """All of it in numbers, texts, lists and dictionaries."""
    return {
        "published": found.published,
        "reason": None if found.published else found.text,
        "cycle": found.cycle,
        "used": found.used,
        "lost": found.lost,
        "restarts": found.restarts,
        "rejected": found.rejected,
        "level": found.level,
        "level_error": found.level_error,
        "farthest": arm.parameter_names[found.farthest],
        "distance": found.distance,
        "innovations": [
            {"channel": channel, "mean": nis, "ratio": most} for channel, nis, most in _innovations(found, arm)
        ],
        "parameters": [
            {"name": name, "unit": unit, "value": float(value), "sigma": float(sigma)}
            for name, unit, value, sigma in zip(
                arm.parameter_names, arm.parameter_units, found.value, found.sigma, strict=True
            )
        ],
    }


def _innovations(found: Refined, arm: Arm) -> list[tuple[str, float, float]]:
    """Kind of sensor, mean normalised square and largest ratio; an arm on a fixed base has no gyro."""
    rows = list(zip(CHANNELS, found.nis.tolist(), found.ratio.tolist(), strict=True))
    return rows if arm.free else rows[:-1]
