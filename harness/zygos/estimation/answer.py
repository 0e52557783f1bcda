"""The results of an estimate: the content of its JSON, and the effects of a model with their estimated values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from zygos.effects import Effect, is_column
from zygos.estimation.watch import Watch
from zygos.model.model import Quantity
from zygos.native.flight import ROWS, Drift, Estimate


def report_estimate(result: Estimate, watch: Watch, drift: Drift | None, heading: Mapping[str, Any]) -> dict[str, Any]:
    """The content of an estimate's JSON."""
    flight = watch.flight
    return {
        **heading,
        "arm": flight.arm.name,
        "validity": result.validity,
        "reason": result.reason or None,
        "cycles": flight.counts["cycles"],
        "accepted": result.accepted,
        "refused": result.refused,
        "arcs": result.arcs,
        "left_out": dict(zip(ROWS, result.left_out, strict=True)),
        "left_out_arcs": [
            {"rows": arc.rows, "from_s": arc.first * flight.arm.period_s, "to_s": arc.last * flight.arm.period_s}
            for arc in watch.left_out
        ],
        "blocks": result.blocks,
        "rank": result.rank,
        "condition": result.condition,
        "residual_j": result.residual,
        "cluster": result.cluster,
        "noise_ratio": result.noise_ratio,
        "gate": result.signal_to_noise,
        "drift": dict(zip(drift.names, drift.deviation.tolist(), strict=True)) if drift else None,
        "changed": drift.changed if drift else (),
        "contradicting": drift.contradicting if drift else (),
        "changed_after_s": drift.until * flight.arm.period_s if drift and drift.changed else None,
        "faults": flight.faults,
        "counts": flight.counts,
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "value": float(value),
                "sigma": float(sigma),
                "half95": float(half95),
                "significance": float(significance) if is_column(name) else None,
            }
            for name, unit, value, sigma, half95, significance in zip(
                result.names, result.units, result.value, result.sigma, result.half95, result.significance, strict=True
            )
        ],
        "solution": result.solution.tolist(),
        "covariance": result.covariance.tolist(),
        # the normal equations contain the correlations of the columns in this motion, which `zygos fit` uses as weights
        "normal": flight.normal_equations()[0].tolist(),
    }


def learned(effect: Effect, found: Quantity | None) -> Effect:
    """An effect with its estimated value. Negative friction or lag, which only noise can cause, is set to zero."""
    if found is None:
        return effect
    value = max(found.value, 0.0) if effect.kind.positive else found.value
    return replace(effect, value=value, sigma=found.sigma, source=found.source)
