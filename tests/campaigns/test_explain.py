# SPDX-License-Identifier: MIT
"""Each verdict where it is the right answer, on runs of a plant that shares no code with the simulator."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT, need
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.gap.explanation import Explanation
from zygos.gap.record import read_measured_run
from zygos.gap.verdicts import Changed, Inseparable, NotAdmissible
from zygos.model.model import Model, Quantity, load_model, save_model
from zygos.native.flight import Flight
from zygos.runs.cycles import Cycles

need(importlib.util.find_spec("mujoco"), "mujoco, which makes the runs")

from oracles import laws  # noqa: E402
from oracles.campaign import ELBOW, SHOULDER, Bench, Case, frames, lively, modern, plant, score, simulation, verdict  # noqa: E402
from oracles.laws import Law  # noqa: E402


def _case(bench: Bench, name: str) -> Case:
    return next(case for case in bench.cases if case.name == name)


@cache
def judge(bench_name: str, name: str) -> Explanation:
    """The verdict on seed 0 of a case of the campaign."""
    bench = {"modern": modern, "lively": lively}[bench_name]()
    case = _case(bench, name)
    return verdict(bench, simulation(case), frames(bench, case))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["motor_coulomb elbow", "link_coulomb shoulder"])
def test_names_an_effect_and_closes_the_gap(name: str) -> None:
    found = judge("modern", name)
    result = score(_case(modern(), name), 0, found)
    assert result["right"], found.sentence
    assert found.gap is not None
    assert result["refit"] >= 8.0 * result["floor"]
    assert result["closed"] <= 1.5 * result["floor"]
    assert found.gap.wrong is not None
    assert found.gap.wrong.gap > 3.0 * found.gap.closed.gap
    # the law differs in form from the column, so its size is no truth to the last digit
    size = _case(modern(), name).law.size  # type: ignore[union-attr]
    assert abs(found.findings[0].value / size - 1.0) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["motor_coulomb shoulder", "motor_viscous elbow", "flexibility"])
def test_names_an_effect_with_coarse_sensors(name: str) -> None:
    found = judge("lively", name)
    assert score(_case(lively(), name), 0, found)["right"], found.sentence


@pytest.mark.slow
def test_says_nothing_missing_with_the_limits() -> None:
    found = judge("lively", "null as drawn")
    assert found.answer == "nothing missing"
    assert found.search is not None
    limits = {c.name: c.limit for c in found.search.rounds[0]}
    assert len(limits) == 11
    assert all(np.isfinite(limit) and limit > 0.0 for limit in limits.values())
    assert found.findings == ()
    assert found.where == "Every balance closes as well as its twin's."


@pytest.mark.slow
def test_a_limit_is_a_size_from_which_an_effect_is_named() -> None:
    search = judge("lively", "null as drawn").search
    assert search is not None
    bench = lively()
    limit = next(c.limit for c in search.rounds[0] if c.name == "motor_coulomb2")
    seen = []
    for size in (0.4 * limit, 1.5 * limit):
        case = Case("limit", "named", (("motor_coulomb", "elbow"),), laws.MotorCoulomb(ELBOW, size), exact=True)
        seen.append(verdict(bench, simulation(case), frames(bench, case)).answer)
    # below the limit no name is given, whether the residual is seen or not
    assert seen[0] in {"nothing missing", "values differ", "unknown"} and seen[1] == "named"


@pytest.mark.slow
def test_says_which_values_differ() -> None:
    found = judge("lively", "values")
    assert found.answer == "values differ"
    differing = {value.name: value.change for value in found.values if value.differs}
    assert differing == {"k1": pytest.approx(-0.20, abs=0.002), "Im2": pytest.approx(0.10, abs=0.002)}
    assert "k1" in found.sentence and "Im2" in found.sentence
    assert found.findings == ()


@pytest.mark.slow
def test_a_detent_of_the_base_is_found_among_the_entries_that_are_searched_last() -> None:
    found = judge("lively", "base detent")
    assert found.answer in {"named", "part named"}, found.sentence
    assert {one.kind for one in found.findings} <= {"detent_sin", "detent_cos"}


@pytest.mark.slow
def test_does_not_name_what_is_not_in_the_catalogue() -> None:
    found = judge("lively", "rate stiffness elbow")
    assert found.answer == "unknown", found.sentence
    assert found.findings == ()
    assert found.model is None


def _stiff(model: Model) -> Model:
    """Joints that bend by less than the encoders see."""
    joints = [replace(j, stiffness=Quantity(1e7), damping=Quantity(1e3)) for j in model.joints]
    return replace(model, joints=tuple(joints))


@pytest.mark.slow
def test_cannot_tell_motor_from_link_where_they_turn_as_one() -> None:
    bench, case = lively(), Case("stiff", "cannot tell", law=laws.LinkCoulomb(SHOULDER, 100.0), lacks="flexibility")
    found = verdict(bench, simulation(case), frames(bench, case, models=[_stiff(plant(case, 0))] * 3))
    assert found.answer == "cannot tell", found.sentence
    (finding,) = found.findings
    told = {_column(finding.kind, finding.joint), *finding.instead}
    assert told >= {"motor_coulomb1", "link_coulomb1"}
    # hysteresis over a distance that is far shorter than each motion is Coulomb friction, too
    others = {name.partition("@")[0] for name in told - {"motor_coulomb1", "link_coulomb1"}}
    assert others <= {f"{side}_{law}1" for side in ("motor", "link") for law in ("dahl", "maxwell")}
    assert found.model is None
    # no motion bends a rigid joint
    assert found.experiments
    assert max(experiment.z for experiment in found.experiments) < 4.5


def _column(kind: str, joint: str | None) -> str:
    return f"{kind}{('shoulder', 'elbow').index(joint) + 1}" if joint else kind


def test_timing_comes_before_physics() -> None:
    """A late link encoder looks like a spring to a simulation whose joints are rigid."""
    bench, case = lively(), Case("late", "unknown", lacks="flexibility")

    def late(cycles: Cycles) -> Cycles:
        q = cycles.q.copy()
        q[1:, ELBOW] = cycles.q[:-1, ELBOW]
        return replace(cycles, q=q)

    seen = frames(bench, case, models=[_stiff(plant(case, 0))] * 3, change=late)
    found = verdict(bench, simulation(case), seen)
    assert found.answer == "unknown"
    assert "Timing first" in found.sentence and "elbow" in found.sentence
    (bent,) = [d for d in found.deflections if d.joint == "elbow"]
    assert abs(bent.skew_s) == pytest.approx(0.05, rel=0.05)


@pytest.mark.slow
def test_where_is_the_side_that_fails() -> None:
    motor, link = judge("modern", "motor_coulomb elbow"), judge("modern", "link_coulomb shoulder")
    e, m1, m2 = (motor.refit.layout.balances.index(name) for name in ("E", "M1", "M2"))
    assert np.all(motor.local[:, m2] > 5.0) and np.all(motor.local[:, m1] < 1.1)
    assert "motor side of the elbow" in motor.where
    assert np.all(link.local[:, e] > 2.0) and np.all(link.local[:, [m1, m2]] < 1.1)
    assert "link side" in link.where


@pytest.mark.slow
def test_simulator_and_estimator_read_the_entry_that_was_written(tmp_path: Path) -> None:
    found = judge("modern", "motor_coulomb elbow")
    assert found.model is not None
    save_model(found.model, tmp_path / "new.toml")
    model = load_model(tmp_path / "new.toml")
    entry = next(effect for effect in model.effects if effect.kind.key == "motor_coulomb")
    assert (entry.joint, entry.source) == ("elbow", "zygos")
    assert entry.value == found.findings[0].value
    assert "95 % interval" in entry.evidence

    bench, case = modern(), _case(modern(), "motor_coulomb elbow")
    flight = Flight(bench.arm, model.effects)
    flight.frames(frames(bench, case)[0])
    estimate = flight.estimate()
    assert estimate.validity == "valid"
    again = estimate.value[estimate.names.index("motor_coulomb2")]
    assert again == pytest.approx(entry.value, rel=0.02)


@pytest.mark.slow
def test_explained_model_leaves_nothing_to_explain() -> None:
    """The model that was written, as the simulation of the same runs: the verdict is that nothing is missing."""
    bench, case = lively(), _case(lively(), "motor_coulomb shoulder")
    first = judge("lively", "motor_coulomb shoulder")
    assert first.model is not None
    second = verdict(bench, first.model, frames(bench, case))
    assert second.answer in {"nothing missing", "values differ"}, second.sentence
    assert second.gap is not None and first.gap is not None
    assert second.gap.delivered.gap == pytest.approx(first.gap.closed.gap, rel=0.2)


def test_a_run_without_a_whole_stretch_is_refused() -> None:
    bench = lively()
    seen = frames(bench, _case(bench, "null as drawn"))[0]
    with pytest.raises(ZygosError, match="no stretch of 2 s"):
        read_measured_run(bench.arm, Path("short.blf"), seen[:200])
    # every twentieth SYNC is lost, and with it its cycle
    syncs = np.flatnonzero(seen["id"] == 0x080)
    with pytest.raises(ZygosError, match="no stretch of 2 s"):
        read_measured_run(bench.arm, Path("holes.blf"), np.delete(seen, syncs[::20]))


def _explained(
    law: Law | Sequence[Law] | None,
    *,
    sim: Model | None = None,
    second: Model | None = None,
    bench: Bench | None = None,
) -> Explanation:
    """A verdict with the paper's sensors on an arm with these laws; `second` moves in the second run."""
    bench, case = bench or lively(), Case("", "", exact=True)
    moved = plant(case, 0)
    seen = frames(bench, case, models=(moved, second or moved, moved), hidden=[law] * 3)
    return verdict(bench, sim or simulation(case), seen)


def _named(found: Explanation) -> dict[tuple[str, str | None], float]:
    return {(f.kind, f.joint): f.value for f in found.findings}


@pytest.mark.slow
def test_names_two_effects_of_different_size() -> None:
    found = _explained((laws.MotorCoulomb(ELBOW, 3.0), laws.MotorCoulomb(SHOULDER, 0.6)))
    assert found.answer == "named", found.sentence
    assert _named(found) == {
        ("motor_coulomb", "elbow"): pytest.approx(3.0, rel=0.05),
        ("motor_coulomb", "shoulder"): pytest.approx(0.6, rel=0.05),
    }


@pytest.mark.slow
def test_a_payload_between_the_runs_is_a_change() -> None:
    drawn = plant(Case("", "", exact=True), 0)
    last = replace(drawn.bodies[2], mass=replace(drawn.bodies[2].mass, value=1.2 * drawn.bodies[2].mass.value))
    found = _explained(None, second=replace(drawn, bodies=(*drawn.bodies[:2], last)))
    assert found.answer == "changed", found.sentence
    assert isinstance(found.verdict, Changed)
    (mass,) = [one for one in found.verdict.payload if one.name == "m2"]
    assert abs(mass.value - 0.2 * drawn.bodies[2].mass.value) < 3.0 * mass.sigma
    assert found.model is not None


@pytest.mark.slow
def test_a_law_of_another_form_is_not_adopted_where_it_predicts_worse() -> None:
    """A friction that reverses within 0.3 rad/s looks like a viscous one below and like a Coulomb friction above that
    rate, 3 Nm. The viscous one would have another size in each run; with the other one, fast stretches of the untouched
    run are predicted worse than without. Where the runs do not tell it from others, no model is written either."""
    found = _explained(laws.MotorCoulomb(ELBOW, 3.0, v0=0.3), bench=lively(60.0))
    assert isinstance(found.verdict, Inseparable | NotAdmissible), found.sentence
    guess = found.verdict.findings[0]
    assert (guess.kind, guess.joint) == ("motor_coulomb", "elbow")
    assert 1.0 < guess.value < 3.0
    assert guess.title in found.sentence
    if isinstance(found.verdict, NotAdmissible):
        assert all("90th percentile" in check.name for check in found.verdict.failed)
        assert guess.title in found.partly
    assert found.model is None


@dataclass
class _Late(laws.MotorCoulomb):
    """Coulomb friction that begins within a run."""

    from_s: float = 20.0
    time: float = field(default=0.0, init=False)

    def begin(self, now: laws.Local) -> None:
        self.time += now.step

    def torque(self, now: laws.Local) -> float:
        return super().torque(now) if self.time >= self.from_s else 0.0


@pytest.mark.slow
def test_a_friction_that_begins_within_a_run_is_a_change() -> None:
    bench, case = lively(), Case("", "changed", exact=True)
    of_run = (None, _Late(ELBOW, 3.0), laws.MotorCoulomb(ELBOW, 3.0))
    found = verdict(bench, simulation(case), frames(bench, case, hidden=of_run))
    assert found.answer == "changed", found.sentence
    change = found.verdict.change  # type: ignore[union-attr]
    assert (change.what, change.run, change.between) == ("motor_coulomb2", 1, False)
    # to the arcs on either side
    assert 9.0 < change.before_s < 20.0 < change.after_s < 31.0
    assert (change.old[0], change.new[0]) == (0.0, pytest.approx(3.0, rel=0.05))
    assert found.findings == ()
    assert found.model is not None
    (friction,) = [effect for effect in found.model.effects if effect.kind.key == "motor_coulomb"]
    assert (friction.joint, friction.value) == ("elbow", pytest.approx(3.0, rel=0.05))


def _with_friction(size: float) -> Model:
    drawn = load_model(ROOT / "examples" / "gap" / "cad.toml")
    return replace(drawn, effects=(*drawn.effects, Effect(CATALOGUE["motor_coulomb"], "elbow", size)))


@pytest.mark.slow
def test_an_effect_of_the_wrong_size_is_a_value_that_differs(tmp_path: Path) -> None:
    found = _explained(laws.MotorCoulomb(ELBOW, 2.0), sim=_with_friction(4.0))
    assert found.answer == "values differ", found.sentence
    assert "motor_coulomb2" in found.sentence
    assert found.model is not None
    save_model(found.model, tmp_path / "new.toml")
    effect = next(e for e in load_model(tmp_path / "new.toml").effects if e.kind.key == "motor_coulomb")
    assert effect.value == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
def test_an_offset_of_a_spring_changes_no_verdict() -> None:
    """The zeros of each run stand for it; it is not predicted with either."""
    drawn = simulation(Case("", "", exact=True))
    offset = Effect(CATALOGUE["spring_offset"], "shoulder", 30.0)
    found = _explained(None, sim=replace(drawn, effects=(*drawn.effects, offset)))
    assert found.answer == "nothing missing", found.sentence
    assert found.model is None or offset.kind not in [effect.kind for effect in found.model.effects]


@pytest.mark.slow
def test_an_effect_that_the_arm_does_not_have_leaves_the_model(tmp_path: Path) -> None:
    found = _explained(None, sim=_with_friction(3.0))
    assert found.answer == "values differ", found.sentence
    assert "which these runs do not show" in found.sentence
    assert found.model is not None
    save_model(found.model, tmp_path / "new.toml")
    assert all(effect.kind.key != "motor_coulomb" for effect in load_model(tmp_path / "new.toml").effects)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"torque_law": "applied_previous_cycle"}, "Timing first: the torques act"),
        ({"quantum_rad": 0.006}, "Sensors first"),
        ({"zero_rad": 0.02}, ""),
    ],
)
def test_an_arm_file_that_is_wrong_is_said_first(change: dict[str, object], says: str) -> None:
    bench, case = lively(), _case(lively(), "null as drawn")
    arm, (first, second) = bench.arm, bench.arm.joints
    if "torque_law" in change:
        arm = replace(arm, **change)  # type: ignore[arg-type]
    elif "quantum_rad" in change:
        coarse = (
            replace(j, link_encoder=replace(j.link_encoder, **change), motor_encoder=replace(j.motor_encoder, **change))
            for j in (first, second)
        )
        arm = replace(arm, joints=tuple(coarse))
    else:
        arm = replace(arm, joints=(first, replace(second, motor_encoder=replace(second.motor_encoder, **change))))
    found = verdict(replace(bench, arm=arm), simulation(case), frames(bench, case))
    if says:
        assert found.answer == "unknown" and says in found.sentence, found.sentence
        assert found.model is None
    else:
        assert any("zeros of the sensors are off" in note and "joint 2" in note for note in found.notes)


@pytest.mark.slow
def test_a_gyro_bias_is_no_angular_momentum() -> None:
    bench, case = modern(), Case("bias", "nothing missing", exact=True)
    seen = frames(bench, case, change=lambda cycles: replace(cycles, omega=cycles.omega + np.array([0.0, 0.0, 1e-4])))
    found = verdict(bench, simulation(case), seen)
    assert found.answer == "nothing missing", found.sentence
    assert any("gyro bias +0.1 mrad/s" in note for note in found.notes)


@pytest.mark.slow
def test_names_a_pair_of_which_neither_passes_alone() -> None:
    bench, case = modern(), Case("pair", "named", exact=True)
    pair = (laws.LinkCoulomb(SHOULDER, 0.3), laws.LinkCoulomb(ELBOW, 0.36))
    found = verdict(bench, simulation(case), frames(bench, case, hidden=[pair] * 3))
    assert found.answer == "named", found.sentence
    assert _named(found) == {
        ("link_coulomb", "shoulder"): pytest.approx(0.3, rel=0.02),
        ("link_coulomb", "elbow"): pytest.approx(0.36, rel=0.02),
    }
