# SPDX-License-Identifier: MIT
"""The content of the JSON that `zygos explain` writes of an arm on the ground."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from zygos.gap.content import verdict_json
from zygos.gap.ground.explanation import GroundExplanation, GroundGap
from zygos.gap.ground.predictions import Prediction, run_name
from zygos.gap.ground.search import false_alarms, threshold
from zygos.gap.ground.sentences import against
from zygos.report.provenance import Provenance


def as_json(found: GroundExplanation, source: Provenance) -> dict[str, Any]:
    """The content of a verdict's JSON."""
    tried = len(found.search.rounds[0]) if found.search.rounds else 0
    return {
        "estimator": "explain-ground",
        **verdict_json(found, source),
        "gap": None if found.gap is None else _gap(found.gap),
        "joints": [
            {
                "joint": one.joint,
                "unit": "Nm",
                "as_delivered": list(one.delivered),
                "refit": list(one.refit),
                "closed": list(one.closed),
                "floor": list(one.floor),
            }
            for one in found.joints
        ],
        "candidates": [
            {
                "name": one.name,
                "unit": one.candidate.unit,
                "value": one.value,
                "each": [_number(x) for x in one.each],
                "z": one.z,
                "explained": one.explained,
                "limit": _number(one.limit),
                "twins": list(one.twins),
                "against": against(one) or None,
            }
            for one in (found.search.rounds[0] if found.search.rounds else ())
        ],
        "limits": [
            {"name": one.name, "unit": one.candidate.unit, "limit": one.limit}
            for one in found.search.beyond
            if math.isfinite(one.limit)
        ],
        "threshold": None
        if not tried
        else {"deviations": threshold(tried), "false_alarms": false_alarms(tried), "candidates": tried},
        "increment_s": found.span_s,
        "runs": [
            {"run": str(run.path) if run.path else None, "cycles": len(run), "faults": run.faults}
            for run in (*found.measured, *found.validated)
        ],
    }


def predicted_errors(gap: GroundGap) -> list[tuple[str, float, list[float]]]:
    """For each model, and for noise alone: error of the energy over one second as share, and rms error of the torque of
    each joint over all untouched runs, Nm."""
    rows = []
    for name, share in (
        ("as delivered", gap.delivered),
        ("refit", gap.refit),
        ("plain estimate", gap.plain),
        ("closed", gap.closed),
    ):
        each = np.array([[j.error_nm for j in dict(one.scores)[name].joints] for one in gap.predictions])
        rows.append((name, share, np.sqrt(np.mean(each**2, axis=0)).tolist()))
    floor = np.sqrt(np.mean([one.floor_nm**2 for one in gap.predictions], axis=0))
    return [*rows, ("floor", gap.floor, floor.tolist())]


def _gap(gap: GroundGap) -> dict[str, Any]:
    return {
        "unit": "share of the work in one second",
        "as_delivered": gap.delivered,
        "refit": gap.refit,
        "plain_estimate": gap.plain,
        "closed": gap.closed,
        "floor": gap.floor,
        "shrinks": gap.refit / gap.closed if gap.closed > 0.0 else None,
        "runs": [_run(one) for one in gap.predictions],
    }


def _run(one: Prediction) -> dict[str, Any]:
    keys = {"as delivered": "as_delivered", "plain estimate": "plain_estimate"}
    return {
        "run": run_name(one.run),
        "path": str(one.run.path) if one.run.path else None,
        "energy": {keys.get(name, name): score.arm_energy_share for name, score in one.scores},
        "torque": [
            {
                "joint": joint.name,
                "unit": "Nm",
                "measured": one.closed.joints[j].measured_nm,
                **{keys.get(name, name): score.joints[j].error_nm for name, score in one.scores},
            }
            for j, joint in enumerate(one.run.arm.joints)
        ],
        "cutoff_hz": one.rows.cutoff_hz,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
