# SPDX-License-Identifier: MIT
"""The gap of an arm on the ground: each verdict where it is the right one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground_gap_support import Array, Law, axis, measured, nothing, sign, size
from ground_support import recorded, short_arm
from pendulum_support import recordings

from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.gap.ground.content import as_json
from zygos.gap.ground.explain import explain_ground
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.sections import answer_of
from zygos.gap.verdicts import PlainEstimate
from zygos.ground.score import score
from zygos.model.model import Model, Quantity
from zygos.report.html import write_page
from zygos.report.provenance import provenance
from zygos.reports import write_report

SECONDS = 8.0


def _explained(runs: list[Run], model: Model | None = None) -> GroundExplanation:
    arm, simulation = axis()
    return explain_ground(arm, model or simulation, runs[:2], runs[2:])


def _lacking(laws: Sequence[Law] | Law = nothing, **options: Any) -> GroundExplanation:
    """What is said of three runs with laws of friction; options: as of `measured`."""
    return _explained(measured(laws, **{"seconds": SECONDS} | options))


@cache
def _bent() -> GroundExplanation:
    """What is said of a friction that is not quite any of the catalogue."""
    return _lacking(lambda q, qd: 0.1 * size() * (qd + 0.5 * qd**3))


def _sizes(x: GroundExplanation) -> dict[str, float]:
    return {finding.kind: finding.value for finding in x.findings}


def _coulomb(share: float) -> Law:
    return lambda q, qd: share * size() * sign(qd)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "offset"), [(0.0, 0.0), (1.0, 0.1)])
def test_nothing_is_missing_whatever_the_offset_of_the_torque(noise: float, offset: float) -> None:
    x = _lacking(noise=noise, offset=offset * size())
    assert (x.answer, x.findings) == ("nothing missing", ()), x.sentence
    assert all(np.isfinite(candidate.limit) and candidate.limit > 0.0 for candidate in x.search.rounds[0])
    assert x.model is not None


@pytest.mark.slow
def test_seeds_without_an_effect_have_no_name() -> None:
    assert {_lacking(seed=seed, offset=0.01 * seed).answer for seed in range(1, 7)} == {"nothing missing"}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_coulomb_friction_then_viscous_friction_that_differs_between_the_directions(noise: float) -> None:
    c, forward, backward = 0.1 * size(), 0.08 * size(), 0.03 * size()

    def law(q: Array, qd: Array) -> Array:
        return c * sign(qd) + np.where(qd > 0.0, forward, backward) * qd

    x = _lacking(law, noise=noise)
    assert x.answer == "named", x.sentence
    assert list(_sizes(x)) == ["motor_coulomb", "motor_viscous", "viscous_asymmetry"]
    mean, half = 0.5 * (forward + backward), 0.5 * (forward - backward)
    assert list(_sizes(x).values()) == pytest.approx([c, mean, half], rel=0.01)
    assert x.gap is not None
    assert x.gap.closed < 0.1 * x.gap.refit
    assert x.model is not None
    assert {effect.kind.key for effect in x.model.effects} == set(_sizes(x))


@pytest.mark.slow
def test_coulomb_friction_that_differs_between_the_directions_looks_like_an_offset() -> None:
    def law(q: Array, qd: Array) -> Array:
        return np.where(qd > 0.0, 0.12, 0.06) * size() * sign(qd)

    runs = measured(law, seconds=SECONDS)
    moving = _explained(runs)
    assert moving.answer == "named", moving.sentence
    assert [(f.kind, f.instead) for f in moving.findings] == [
        ("motor_coulomb", ()),
        ("torque_offset", ("coulomb_asymmetry1",)),
    ]
    assert "cannot tell apart" in moving.sentence
    assert moving.model is not None
    assert [effect.kind.key for effect in moving.model.effects] == ["motor_coulomb"]
    # nothing else is missing
    undecided = _explained(runs, moving.model)
    assert undecided.answer == "cannot tell", undecided.sentence
    assert [f.instead for f in undecided.findings] == [("coulomb_asymmetry1",)]
    assert undecided.model is None
    assert "rest" in undecided.remedy
    resting = _lacking(law, rests=True, seconds=20.0)
    assert _sizes(resting)["coulomb_asymmetry"] == pytest.approx(0.03 * size(), rel=0.1)
    assert not any(f.instead for f in resting.findings)


def test_an_offset_that_stays_at_rest_is_an_offset() -> None:
    x = _lacking(_coulomb(0.1), offset=0.03 * size(), rests=True, seconds=10.0)
    assert (x.answer, list(_sizes(x))) == ("named", ["motor_coulomb"]), x.sentence
    assert any("also at rest" in note for note in x.notes)


@pytest.mark.slow
def test_a_law_that_is_not_exactly_that_of_the_catalogue_is_named_in_part() -> None:
    x = _bent()
    assert x.answer == "part named", x.sentence
    assert list(_sizes(x)) == ["motor_viscous"]
    (rest,) = x.verdict.left  # type: ignore[union-attr]
    assert rest.over == "rate"
    assert rest.size > 3.0 * rest.floor


@pytest.mark.slow
def test_a_plain_estimate_that_predicts_little_is_no_answer() -> None:
    """It is far better than a simulation with a wrong mass, and leaves a third of the work."""
    _, simulation = axis()
    base, link = simulation.bodies
    wrong = replace(simulation, bodies=(base, replace(link, mass=replace(link.mass, value=20.0 * link.mass.value))))
    x = _explained(measured(lambda q, qd: 1.2 * size() * np.sin(7.0 * q), seconds=SECONDS), wrong)
    assert x.gap is not None
    assert x.gap.plain < 0.5 * x.gap.delivered and x.gap.plain > 0.25
    assert (x.answer, x.model) == ("unknown", None), x.sentence
    assert "the untouched run leaves" in x.sentence


def test_a_law_with_which_most_of_an_untouched_run_is_predicted_worse_is_not_adopted() -> None:
    """Viscous friction in the place of a cube of the rate helps fast stretches, and spoils the others. What decided is
    what is told."""
    x = _lacking(lambda q, qd: 0.1 * size() * qd**3)
    assert (x.answer, x.findings) == ("plain estimate", ()), x.sentence
    assert isinstance(x.verdict, PlainEstimate)
    assert [finding.kind for finding in x.verdict.findings] == ["motor_viscous"]
    failed = next(check for check in x.verdict.failed if check.name.startswith("the median error of the torques"))
    assert failed.found > failed.highest
    assert x.verdict.failed[0].sentence in x.sentence
    assert "It does not close: " in x.sentence and x.verdict.left[0].size > 3.0 * x.verdict.left[0].floor
    # the model that is written is the one that is reported and that predicts
    assert x.model is not None and x.gap is not None
    (one,) = x.gap.predictions
    assert score(one.run, x.model).arm_energy_share == pytest.approx(one.closed.arm_energy_share)
    assert {value.name: value.found for value in x.values} == {
        name: value.value for name, value in x.model.base_parameters(x.arm).items()
    }


@pytest.mark.slow(but=["0.38-*"])
@pytest.mark.parametrize(("speed", "seed", "seconds"), [(0.38, 0, SECONDS), (0.21, 1, 20.0)])
def test_a_stribeck_velocity_between_those_of_the_catalogue(speed: float, seed: int, seconds: float) -> None:
    sizes = {"motor_coulomb": 0.1 * size(), "motor_viscous": 0.1 * size(), "motor_stribeck": 0.08 * size()}

    def law(q: Array, qd: Array) -> Array:
        coulomb, viscous, stribeck = sizes.values()
        return (coulomb + stribeck * np.exp(-((qd / speed) ** 2))) * sign(qd) + viscous * qd

    x = _lacking(law, seed=seed, seconds=seconds)
    assert x.answer == "named", x.sentence
    findings = {finding.kind: finding for finding in x.findings}
    assert set(findings) == set(sizes)
    # the grid has 0.158, 0.281 and 0.5 rad/s
    assert findings["motor_stribeck"].shape == pytest.approx(speed, rel=0.06)
    for kind, wanted in sizes.items():
        low, high = findings[kind].interval
        assert low < wanted < high, kind


@pytest.mark.slow
def test_what_the_twin_shows_as_well_is_no_effect() -> None:
    arm, model = short_arm(2, friction=False, torque_noise=0.003)
    runs = [recorded(arm, model, path=k, seed=k, noise=0.3, more={"load": 0.1}) for k in range(3)]
    x = explain_ground(arm, model, runs[:2], runs[2:])
    # the smoother's error at reversals is a lag of 0.1 ms of the first joint's torque
    assert x.answer == "named", x.sentence
    assert {(f.kind, f.joint) for f in x.findings} == {("load_friction", "joint1"), ("load_friction", "joint2")}


@pytest.mark.slow
def test_a_torque_of_the_angle_is_unknown() -> None:
    x = _lacking(lambda q, qd: 0.05 * size() * np.sin(7.0 * q))
    assert (x.answer, x.model) == ("unknown", None), x.sentence
    assert x.remedy


@pytest.mark.slow
def test_a_friction_of_the_simulation_that_is_too_large_and_a_wrong_body_are_values() -> None:
    arm, model = axis()
    base = model.base_parameters(arm)
    base["mz1"] = Quantity(1.1 * base["mz1"].value, 0.0, "CAD", base["mz1"].unit)
    x = _explained(measured(nothing, seconds=SECONDS), Model("heavier", parameters=base))
    assert x.answer == "values differ", x.sentence
    assert [value.name for value in x.values if value.differs] == ["mz1"]


@pytest.mark.slow
def test_a_friction_that_begins_in_the_second_run_is_a_change() -> None:
    x = _lacking([nothing, _coulomb(0.1), _coulomb(0.1)])
    assert x.answer == "changed", x.sentence
    change = x.verdict.change  # type: ignore[union-attr]
    assert (change.what, change.run, change.between) == ("motor_coulomb1", 1, True)
    assert change.new[0] == pytest.approx(0.1 * size(), rel=0.02)


@pytest.mark.slow
def test_a_load_from_the_second_run_on_is_a_change_and_no_friction() -> None:
    """Far more than noise is left over of all runs together, but what takes it up is not the usual friction."""
    x = _lacking([nothing, *[lambda q, qd: 0.2 * size() * np.sin(q)] * 2])
    assert x.answer == "changed", x.sentence
    assert x.model is not None and not x.model.effects
    assert not x.search.beside


def test_torques_that_are_reported_late_are_timing_first() -> None:
    runs = [
        replace(moved, frames=None, table=replace(moved.cycles, tau=np.roll(moved.cycles.tau, 2, axis=0)))
        for moved in measured(_coulomb(0.1), seconds=SECONDS)
    ]
    x = _explained(runs)
    assert (x.answer, x.findings, x.model) == ("unknown", (), None)
    assert x.sentence.startswith("Timing first")
    assert x.verdict.periods == pytest.approx(-2.0, abs=0.1)  # type: ignore[union-attr]


@pytest.mark.slow
def test_motor_currents_are_turned_into_torques() -> None:
    arm, model = axis()
    amps = replace(arm, torque_unit="A", joints=(replace(arm.joints[0], torque_sigma=0.0),))
    runs = [
        replace(moved, arm=amps, frames=None, table=replace(moved.cycles, tau=moved.cycles.tau / 7.0))
        for moved in measured(_coulomb(0.1), seconds=SECONDS)
    ]
    x = explain_ground(amps, model, runs[:2], runs[2:])
    assert (x.answer, list(_sizes(x))) == ("named", ["motor_coulomb"]), x.sentence
    assert _sizes(x)["motor_coulomb"] == pytest.approx(0.1 * size(), rel=0.02)
    assert any("motor currents" in note for note in x.notes)


@pytest.mark.slow
def test_a_single_run_is_cut_into_thirds() -> None:
    arm, model = axis()
    x = explain_ground(arm, model, measured(_coulomb(0.1), seconds=2.0 * SECONDS)[:1])
    assert (x.answer, list(_sizes(x))) == ("named", ["motor_coulomb"]), x.sentence
    assert (len(x.measured), len(x.validated)) == (2, 1)
    with pytest.raises(ZygosError, match="cannot be cut into 3 parts"):
        explain_ground(arm, model, [measured(nothing, seconds=4.0)[0]])


def test_what_is_no_arm_on_the_ground_is_refused() -> None:
    arm, model = axis()
    with pytest.raises(ZygosError, match="floats or has flexible joints"):
        explain_ground(
            replace(arm, joints=(replace(arm.joints[0], flexible=True),)), model, measured(nothing, seconds=SECONDS)
        )
    with pytest.raises(ZygosError, match="no measured run"):
        explain_ground(arm, model, [])


def test_page_and_json_say_the_verdict(tmp_path: Path) -> None:
    x = _bent()
    source = provenance(["explain"], [])
    write_page(tmp_path / "gap.html", answer_of(x, draw=True), source)
    page = (tmp_path / "gap.html").read_text()
    assert "part named" in page
    assert "median of the torque left over the rate" in page
    write_report(x, tmp_path / "again.html")
    assert "zygos.explain, called from Python" in (tmp_path / "again.html").read_text()
    written = json.loads(json.dumps(as_json(x, source), allow_nan=False))
    assert written["answer"] == "part named"
    assert written["findings"][0]["effect"] == "motor_viscous"
    assert written["gap"]["closed"] < written["gap"]["refit"]


@pytest.mark.slow
def test_the_published_pendulum_lacks_friction_and_the_inertia_of_a_rotor(tmp_path: Path) -> None:
    runs = list(recordings(tmp_path).values())
    arm = runs[0].arm
    known = {"mz1": -0.349118, "Ixx1": 0.107862, "mz2": -0.111065, "Ixx2": 0.0239237}
    base = {
        name: Quantity(known.get(name, 0.0), 0.0, "test", unit)
        for name, unit in zip(arm.parameter_names, arm.parameter_units, strict=True)
    }
    x = explain_ground(arm, Model("published without friction", parameters=base), runs[:3], runs[3:])
    assert x.answer == "part named", x.sentence
    assert {(f.kind, f.joint) for f in x.findings} == {("motor_coulomb", "elbow"), ("rotor_inertia", "elbow")}
    assert x.model is not None
    # at the shoulder the runs disagree too much for a name, and the model has it with its wide interval
    rubbed = {e.joint: e for e in x.model.effects if e.kind.key == "motor_coulomb"}
    for joint, published in (("shoulder", 0.02435), ("elbow", 0.02042)):
        assert abs(rubbed[joint].value - published) < 2.0 * rubbed[joint].sigma < published
    assert "not sure enough" in rubbed["shoulder"].evidence and "not sure enough" in " ".join(x.notes)
    assert x.gap is not None
    shares = [(p.delivered.arm_energy_share, p.closed.arm_energy_share) for p in x.gap.predictions]
    assert shares[0][0] > 0.8
    assert shares[0][1] < 0.15
    assert shares[1][0] > 0.35
    assert shares[1][1] < 0.18


@pytest.mark.slow
@pytest.mark.parametrize(("inertia", "answer"), [(0.0, "named"), (1e-12, "values differ")])
def test_a_rotor_without_inertia_is_found_as_such(inertia: float, answer: str) -> None:
    """A drawing may say that it has none, and no friction is named in its place."""
    arm, model = short_arm(3)
    drives = (*model.joints[:2], replace(model.joints[2], rotor_inertia=Quantity(inertia)))
    runs = [recorded(arm, model, path=k, seed=k, seconds=8.0) for k in range(3)]
    found = explain_ground(arm, replace(model, joints=drives), runs[:2], runs[2:])
    assert found.answer == answer and "Im3" in found.sentence + "Im3" * (answer == "named")
    assert {one.kind for one in found.findings} <= {"rotor_inertia"}
    assert found.model is not None
    true = model.joints[2].rotor_inertia.value
    assert found.model.base_parameters(arm)["Im3"].value == pytest.approx(true, rel=0.05)
    assert "e+" not in found.sentence
