"""The end of `zygos estimate` for an arm on the ground: tables, model file, JSON, and messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zygos.cli.shared import conclude
from zygos.files.output import counted, named, number, quiet, ratio, say, table, write_json
from zygos.gap.predict import Prediction
from zygos.ground.estimate import GroundEstimate
from zygos.ground.payload import Payload, check_found
from zygos.ground.score import Score
from zygos.model.model import save_model
from zygos.report.provenance import Provenance


def finish_ground(
    found: GroundEstimate, out: Path, json: str | None, report: Path | None, source: Provenance | None
) -> None:
    """Print the tables, write the model, and raise Undecided if the estimate is doubtful or refused.

    report: a page to write; source: what it was made from.
    """
    if not quiet(out, json, report):
        _print_parameters(found)
        _print_joints(found)
        if len(found.runs) > 1:
            _print_across(found)
        for one in found.validated:
            print_score(one, "validated on ")
        shares = ", ".join(f"{100 * share:.1f}" for share in found.solution.share)
        say(
            f"arm {found.arm.name} · {counted(len(found.runs), 'run')} · {counted(found.increments, 'increment')} of "
            f"{found.span_s:g} s · held-out torque left: {shares} % · "
            f"{int(found.determined.sum())} of {counted(len(found.names), 'parameter')} · {found.validity}"
        )
        for text in found.notes:
            say(text)
    where = "no model written" if found.validity == "refused" else f"{named(out)} written"
    try:
        if found.validity != "refused":
            save_model(found.to_model(), out)
        if report is not None and source is not None:
            from zygos.ground.page import write_ground_report  # noqa: PLC0415  (only a report needs charts)

            write_ground_report(report, found, source, written=where)
    finally:
        if json:
            write_json(json, found.as_dict())
    conclude(found.validity, f"{found.validity}: {found.reason} ({where}); remedy: {found.remedy}")


def finish_payload(found: Payload, out: Path, json: str | None) -> None:
    """Print the tables, write the model with the payload, and raise Undecided where there is none."""
    if not quiet(out, json):
        rows = [
            (one.name, one.unit, number(value), number(float(f"{half:.2g}")), group)
            for one, value, half, group in zip(found.parameters, found.value, found.half95, found.groups, strict=True)
        ]
        table(("change of the last body", "unit", "estimate", "±95 %", "stands for"), rows)
        shares = [
            (joint.name, number(100 * float(before), 3), number(100 * float(after), 3))
            for joint, before, after in zip(found.arm.joints, found.before, found.after, strict=True)
        ]
        table(("joint", "torque left before, %", "held-out left with it, %"), shares)
        if found.relative:
            say("the torques are motor currents: the values are relative to the torque constants of the model")
    if json:
        write_json(json, found.as_dict())
    check_found(found)
    save_model(found.to_model(), out)


def _print_parameters(found: GroundEstimate) -> None:
    several = np.isfinite(found.spread).any()
    rows = [
        (
            name,
            unit,
            number(value),
            number(float(f"{half:.2g}")),
            number(100 * ratio(half, abs(value)), 2),
            *((number(float(f"{spread:.2g}")),) if several else ()),
        )
        for name, unit, value, half, spread in zip(
            found.names, found.units, found.value, found.half95, found.spread, strict=True
        )
    ]
    table(("name", "unit", "estimate", "±95 %", "in %", *(("without a run",) if several else ())), rows)


def _print_joints(found: GroundEstimate) -> None:
    s = found.solution
    rows = [
        (
            joint.name,
            number(100 * float(s.share[j]), 3),
            number(float(found.torque_sigma[j]), 3),
            number(float(found.excess[j]), 3),
            " ".join(number(float(one), 2) for one in s.offset[:, j]),
        )
        for j, joint in enumerate(found.arm.joints)
    ]
    unit = found.arm.torque_unit
    table(("joint", "held-out left, %", f"residual as noise, {unit}", "in noise", f"offset by run, {unit}"), rows)


def _print_across(found: GroundEstimate) -> None:
    """What each run alone leaves of the others."""
    names = [run.path.parent.name + "/" + run.path.name if run.path else str(k) for k, run in enumerate(found.runs)]
    rows = [
        (f"from {name}", *(number(100 * float(cell), 3) for cell in line))
        for name, line in zip(names, found.across, strict=True)
    ]
    table(("torque left, %", *(f"in {name}" for name in names)), rows)


def print_score(score: Score, before: str = "") -> None:
    """Table of a prediction."""
    flexible = any(np.isfinite(one.spring_nm) for one in score.joints)
    rests = any(one.rest_share > 0.0 for one in score.joints)
    rows = [
        (
            one.joint,
            number(one.measured_nm, 4),
            number(one.error_nm, 3),
            number(one.floor_nm, 3),
            number(100 * one.share, 3) if one.evaluated else "not evaluated",
            number(one.offset_nm, 2),
            number(100 * one.raw_share, 3),
            number(one.energy_error_j, 3),
            number(100 * one.energy_share, 3),
            number(one.sigmas, 3),
            *((f"{number(one.rest_nm, 3)} ({100 * one.rest_share:.0f} %)",) if rests else ()),
            *((number(one.spring_nm, 3),) if flexible else ()),
        )
        for one in score.joints
    ]
    heads = (
        "joint",
        "torque, Nm",
        "error, Nm",
        "floor, Nm",
        "in %",
        "offset, Nm",
        "with offset, %",
        "work in 1 s, J",
        "in %",
        "σ",
    )
    how = f"at {score.cutoff_hz:.1f} Hz" if score.cutoff_hz else f"over increments of {score.increment_s:g} s"
    apart = (*(("at rest, Nm",) if rests else ()), *(("spring, Nm",) if flexible else ()))
    table((*heads, *apart), rows, title=f"{before}{score.run.path or 'the run'} {how}")
    say(f"work of all motors in 1 s: {100 * score.arm_energy_share:.3g} % are left by the energy of the arm")


def print_prediction(one: Prediction) -> None:
    """Tables of a prediction."""
    print_score(one.torques)
    ahead = one.ahead
    if ahead is not None:
        table(
            ("half a second ahead", "error", "floor", "unit"),
            [
                (name, number(error, 3), number(floor, 3), unit)
                for name, error, floor, unit in zip(
                    ahead.signals, ahead.error.tolist(), ahead.floor.tolist(), ahead.units, strict=True
                )
            ],
        )
        say(
            f"half a second ahead, {len(ahead.distance)} stretches: {ahead.median:.3g} σ in the median, 90th percentile"
            f" {ahead.tenth:.3g} σ; near 1 only noise is left"
        )
    elif one.reason:
        say(f"not predicted half a second ahead: {one.reason}")
