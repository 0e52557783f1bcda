"""The content of the JSON of `zygos refine`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from zygos.native.flight import CHANNELS

if TYPE_CHECKING:
    from zygos.refinement.refine import Refinement


def report_refinement(found: Refinement, heading: Mapping[str, Any]) -> dict[str, Any]:
    """All of a refinement; without values where it is not published."""
    p, shown = len(found.names), found.published
    times = np.full(p, np.nan) if found.times_bound is None else found.times_bound
    bound = np.full(p, np.nan) if found.limit is None else found.limit.sigma
    columns = (found.value, found.sigma, found.half95) if shown else (np.full(p, np.nan),) * 3
    return {
        **heading,
        "arm": found.arm.name,
        "published": shown,
        "reason": found.reason or None,
        "cycles": found.record.cycles,
        "lost": found.record.lost,
        "left_out": found.record.left_out,
        "pieces": [
            {"run": piece.run, "first": piece.first, "cycles": int(piece.read.sum())} for piece in found.record.pieces
        ],
        "energy": {"validity": found.energy.validity, "reason": found.energy.reason or None},
        "levels": [
            {"joint": joint.name, "found": level, "declared": declared}
            for joint, level, declared in zip(found.arm.joints, found.level, found.declared, strict=True)
        ],
        "level_error": found.level_error,
        "tried": [{"level": level, "deviance": deviance} for level, deviance in found.tried],
        "innovations": [
            {
                "channel": channel,
                "mean": float(found.squares[k]),
                "limit": float(found.band(found.record.cycles)[k]),
                "windows": [
                    {
                        "first": part.start,
                        "last": part.stop - 1,
                        "mean": float(means[k]),
                        "limit": float(found.band(part.stop - part.start)[k]),
                    }
                    for part, means in found.windows
                ],
            }
            for k, channel in enumerate(CHANNELS)
            if found.final.counts[k] > 0.0
        ],
        "rules": [rule.as_dict() for rule in found.rules],
        "rivals": [
            {"title": one.title, "value": one.value, "unit": one.unit, "sigmas": one.sigmas} for one in found.rivals
        ],
        "times_bound": None if found.times_bound is None else float(np.mean(times)),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "value": float(value),
                "sigma": float(sigma),
                "half95": float(half),
                "size": float(size),
                "bound": float(best),
                "times_bound": float(ratio),
            }
            for name, unit, value, sigma, half, size, best, ratio in zip(
                found.names, found.units, *columns, found.size, bound, times, strict=True
            )
        ],
        "effects": [
            {
                "kind": one.kind.key,
                "joint": one.joint,
                "unit": one.kind.unit,
                "value": one.value if shown else float("nan"),
                "sigma": one.sigma if shown else float("nan"),
            }
            for one in found.effects
        ],
        "covariance": found.covariance.tolist() if shown else None,
    }
