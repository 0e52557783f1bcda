# SPDX-License-Identifier: MIT
"""The content of the JSON that `zygos explain` writes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from zygos.gap.adopted import Adopted, Check
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Finding, Gap, Value
from zygos.gap.forecast import Forecast
from zygos.gap.sentences import against, evidence
from zygos.gap.simulated import Simulated
from zygos.gap.verdicts import Changed, NotAdmissible, PartNamed, PlainEstimate, Verdict, ZerosOff, decided_by
from zygos.plan.separating import Separating
from zygos.report.provenance import Provenance

if TYPE_CHECKING:
    from zygos.gap.ground.explanation import GroundExplanation


def predictions(gap: Gap) -> list[tuple[str, Forecast]]:
    """The gap's numbers by name: as delivered, refit, closed, floor, and, if there is one, with the best other."""
    listed = [("as delivered", gap.delivered), ("refit", gap.refit), ("closed", gap.closed), ("floor", gap.floor)]
    return listed + ([(f"with {gap.wrong_name} instead", gap.wrong)] if gap.wrong is not None else [])


def _finding(found: Finding) -> dict[str, Any]:
    """An effect that was found."""
    return {
        "effect": found.kind,
        "title": found.title,
        "joint": found.joint,
        "value": found.value,
        "sigma": found.sigma,
        "interval": list(found.interval),
        "unit": found.unit,
        "evidence": evidence(found),
        "cannot_tell_from": list(found.instead),
        "shape": found.shape,
        "component": found.component or None,
    }


def _value(value: Value) -> dict[str, Any]:
    """A value beside that of the simulation."""
    return {
        "name": value.name,
        "unit": value.unit,
        "simulation": value.delivered,
        "simulation_sigma": value.delivered_sigma,
        "found": value.found,
        "sigma": value.sigma,
        "differs": value.differs,
    }


def planned_json(planned: Separating | None) -> dict[str, Any] | None:
    """The motion that was planned; None where none was."""
    if planned is None:
        return None
    return {
        "scenario": planned.scenario.name,
        "duration_s": planned.scenario.duration_s,
        "motion": planned.form,
        "z": planned.z,
        "motions": planned.tried,
    }


def simulation_json(simulated: Simulated | None) -> dict[str, Any] | None:
    """The run that the simulation's values come from; None where they come from a model file."""
    if simulated is None:
        return None
    run, torques = simulated.run, simulated.torques_of
    return {"run": run and str(run), "torques_of": torques and str(torques)}


def _source(source: Provenance) -> dict[str, Any]:
    """Where an answer is from."""
    return {
        "command": source.command,
        "version": source.version,
        "files": [{"role": role, "path": path, "sha256": digest} for role, path, digest in source.files],
    }


def _remainders(verdict: Verdict) -> list[dict[str, Any]]:
    """What the answer leaves over, largest first; empty where it closes."""
    return [
        {
            "where": rest.where,
            "size": rest.size,
            "unit": rest.unit,
            "floor": rest.floor if math.isfinite(rest.floor) else None,
            "over": rest.over or None,
            "share": rest.share,
        }
        for rest in (verdict.left if isinstance(verdict, PartNamed | PlainEstimate) else ())
    ]


def decided(adopted: Adopted | None, verdict: Verdict) -> tuple[Check, ...]:
    """What decided whether a model is written: the checks that did not hold, then those that the written one passed."""
    failed = verdict.failed if isinstance(verdict, PlainEstimate | NotAdmissible) else ()
    return (*failed, *(() if adopted is None else adopted.checks))


def _checks(adopted: Adopted | None, verdict: Verdict) -> list[dict[str, Any]]:
    """The same for the JSON."""
    return [
        {
            "name": one.name,
            "unit": one.unit,
            "found": one.found if math.isfinite(one.found) else None,
            "lowest": one.lowest if math.isfinite(one.lowest) else None,
            "highest": one.highest if math.isfinite(one.highest) else None,
            "beside": one.beside or None,
            "holds": one.holds,
        }
        for one in decided(adopted, verdict)
    ]


def _limits(verdict: Verdict) -> list[dict[str, Any]]:
    """The limits that decided the answer (docs/reference/limits.md)."""
    return [{"name": one.name, "value": one.value, "unit": one.unit} for one in decided_by(verdict)]


def change_json(verdict: Verdict) -> dict[str, Any] | None:
    """What changed and when; None where the answer is another."""
    if not isinstance(verdict, Changed):
        return None
    change = verdict.change
    return {
        "what": change.what,
        "run": verdict.runs[change.run],
        "between_runs": change.between,
        "before_s": None if change.between else change.before_s,
        "after_s": None if change.between else change.after_s,
        "coefficients": [
            {"name": name, "old": old, "new": new, "sigma": sigma}
            for name, old, new, sigma in zip(
                change.names, change.old.tolist(), change.new.tolist(), change.sigma.tolist(), strict=True
            )
        ],
        "payload": [
            {"name": one.name, "unit": one.unit, "value": one.value, "sigma": one.sigma, "interval": list(one.interval)}
            for one in verdict.payload
        ]
        or None,
        "z": change.z,
        "share": change.share,
    }


def verdict_json(found: Explanation | GroundExplanation, source: Provenance) -> dict[str, Any]:
    """The answer and what it rests on, as of every arm."""
    return {
        "answer": found.answer,
        "sentence": found.sentence,
        "where": found.where,
        "findings": [_finding(f) for f in found.findings],
        "partly": found.partly or None,
        "left": _remainders(found.verdict),
        "change": change_json(found.verdict),
        "checks": _checks(found.adopted, found.verdict),
        "decided_by": _limits(found.verdict),
        "values": [_value(v) for v in found.values],
        "simulation": simulation_json(found.simulated),
        "remarks": list(found.notes),
        **_source(source),
    }


def as_json(found: Explanation, source: Provenance) -> dict[str, Any]:
    """The content of a verdict's JSON."""
    layout = found.refit.layout
    gap = found.gap
    return {
        **verdict_json(found, source),
        "gap": gap
        and {
            "unit": "sigma",
            "as_delivered": gap.delivered.gap,
            "refit": gap.refit.gap,
            "closed": gap.closed.gap,
            "floor": gap.floor.gap,
            "shrinks": gap.refit.gap / gap.closed.gap,
            "median": {name: one.median for name, one in predictions(gap)[:4]},
            "ninetieth": {name: one.tenth for name, one in predictions(gap)[:4]},
            "best_wrong": gap.wrong and {"candidate": gap.wrong_name, "gap": gap.wrong.gap},
        },
        "balances": [
            {
                "name": name,
                "before": found.refit.excess[:, k].tolist(),
                "alone": found.local[:, k].tolist(),
                "after": found.closed.excess[:, k].tolist(),
            }
            for k, name in enumerate(layout.balances)
        ],
        "candidates": []
        if found.search is None
        else [
            {
                "name": c.name,
                "unit": c.kind.unit,
                "value": c.value,
                "each": list(c.each),
                "z": list(c.z),
                "completeness": list(c.completeness),
                "limit": c.limit,
                "twins": list(c.kind.twins),
                "against": against(c) or None,
            }
            for c in found.search.rounds[0]
        ],
        "limits": []
        if found.search is None
        else [{"name": one.name, "unit": one.kind.unit, "limit": one.value} for one in found.search.beyond],
        "threshold": found.search
        and {
            "deviations": found.search.chance.threshold,
            "false_alarms": found.search.chance.false_alarms,
            "candidates": found.search.chance.candidates,
        },
        "completeness": None if found.search is None else list(found.search.completeness),
        "experiments": [
            {"speed": e.speed, "amplitude": e.amplitude, "z": e.z, "z_now": e.now} for e in found.experiments
        ],
        "zeros": [
            {
                "name": name,
                "unit": "rad/s" if name.startswith("gyro") else "rad",
                "value": value,
                "certain": one.certain,
            }
            for one in found.remarks
            if isinstance(one, ZerosOff)
            for name, value in one.zeros
        ],
        "runs": [{"run": str(r.path), "arcs": len(r.starts), "faults": r.faults} for r in found.records],
    }
