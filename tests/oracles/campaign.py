# SPDX-License-Identifier: MIT
"""Cases of the tests of explain: effects hidden in runs of the planar MuJoCo plant, explained from their CAN frames.

Each case is a hidden effect, or none, at one place; its seeds differ in the arm that was built (every value off by up
to its sigma) and in the sensors' noise. What is explained is frames, an arm file and the drawing's model; the truth
meets the verdict only in `score`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from runs_support import kept

from oracles import laws
from oracles.demo_log import EXAMPLE, built
from oracles.laws import Law
from oracles.simulate import run
from zygos.arm import Arm, Smoother, load_arm
from zygos.effects import CATALOGUE, Effect, column_named
from zygos.gap.explain import explain
from zygos.gap.explanation import Explanation
from zygos.gap.record import read_measured_run
from zygos.model.model import Model, Quantity, load_model
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Motion, Scenario, Sine, load_scenario

LIVELY = EXAMPLE.parent / "lively"
SHOULDER, ELBOW = 0, 1
PLACES = ("shoulder", "elbow")
Hidden = Law | Sequence[Law] | None
"""What acts in a run beside the model."""


@dataclass(frozen=True)
class Case:
    """What is hidden, and what the right answer is."""

    name: str
    answer: str
    """The right answer: named, values differ, nothing missing, unknown."""
    hidden: tuple[tuple[str, str | None], ...] = ()
    """Effects, by name in the catalogue, and their joints."""
    law: Law | None = None
    momentum: float = 0.0
    lacks: str = ""
    """What the simulation leaves out: flexibility or coupling."""
    exact: bool = False
    """The arm was built exactly as drawn."""
    changed: bool = False
    """k1 is 20 % lower than drawn, Im2 10 % higher."""


@dataclass(frozen=True)
class Bench:
    """Sensors and manoeuvres."""

    name: str
    arm: Arm
    scenarios: tuple[Scenario, ...]
    cases: tuple[Case, ...]


def _at(law: type[Law], sizes: tuple[float, float]) -> list[Case]:
    return [
        Case(f"{law.key} {PLACES[i]}", "named", ((law.key, PLACES[i]),), law(i, sizes[i]))  # type: ignore[call-arg]
        for i in (SHOULDER, ELBOW)
        if sizes[i]
    ]


def modern() -> Bench:
    """20-bit encoders, half a minute at 50 Hz."""
    both = tuple(PLACES)
    cases = [
        *_at(laws.MotorCoulomb, (0.02, 0.02)),
        *_at(laws.MotorViscous, (0.04, 0.05)),
        *_at(laws.LinkCoulomb, (0.3, 0.36)),
        *_at(laws.CubicStiffness, (30.0, 30.0)),
        *_at(laws.TorqueLag, (5e-4, 1e-3)),
        Case("flexibility", "named", tuple(("joint_flexibility", j) for j in both), lacks="flexibility"),
        Case("coupling", "named", tuple(("rotor_coupling", j) for j in both), lacks="coupling"),
        Case("momentum", "named", (("angular_momentum", None),), momentum=50.0),
        Case("null as drawn", "nothing missing", exact=True),
        Case("null as built", "nothing missing"),
        Case("values", "values differ", exact=True, changed=True),
        Case("rate stiffness elbow", "unknown", law=laws.RateStiffness(ELBOW, 0.02)),
        Case("base detent", "unknown", law=laws.BaseDetent(0, 1.0)),
    ]
    scenarios = tuple(replace(load_scenario(EXAMPLE / f"{name}.toml"), duration_s=30.0) for name in "abc")
    arm = replace(load_arm(EXAMPLE / "arm.toml").at_period(0.02), smoother=Smoother(9, 4, 4))
    return Bench("modern", arm, scenarios, tuple(cases))


def lively(duration_s: float = 40.0) -> Bench:
    """The sensors of the paper, 3 mrad at 20 Hz, and the large motions of examples/lively."""
    cases = [
        *_at(laws.MotorCoulomb, (5.0, 3.0)),
        *_at(laws.MotorViscous, (10.0, 5.0)),
        *_at(laws.LinkCoulomb, (100.0, 60.0)),
        *_at(laws.CubicStiffness, (1000.0, 300.0)),
        *_at(laws.TorqueLag, (0.02, 0.02)),
        Case("flexibility", "named", tuple(("joint_flexibility", j) for j in PLACES), lacks="flexibility"),
        Case("momentum", "named", (("angular_momentum", None),), momentum=500.0),
        Case("null as drawn", "nothing missing", exact=True),
        Case("null as built", "nothing missing"),
        Case("values", "values differ", exact=True, changed=True),
        Case("rate stiffness elbow", "unknown", law=laws.RateStiffness(ELBOW, 0.2)),
        Case("base detent", "unknown", law=laws.BaseDetent(0, 400.0)),
    ]
    scenario = replace(load_scenario(LIVELY / "scenario.toml"), encoder_noise="quantised")
    motions = ((0.9, 0.6, 0.8, 1.1), (0.8, 0.75, 0.7, 1.0), (0.9, 0.5, 0.8, 1.3))
    scenarios = tuple(
        replace(
            scenario,
            duration_s=duration_s,
            manoeuvre={
                "shoulder": Motion(1.25, (Sine(first, slow),)),
                "elbow": Motion(-2.0, (Sine(second, fast),)),
            },
        )
        for first, slow, second, fast in motions
    )
    # the example's longer window shows how the laws differ in form from the columns, and names what that looks like
    arm = replace(load_arm(LIVELY / "arm.toml"), smoother=Smoother())
    return Bench("lively", arm, scenarios, tuple(cases))


def simulation(case: Case) -> Model:
    """The model that the analyst has."""
    drawn = load_model(EXAMPLE / "cad.toml")
    if case.lacks == "flexibility":
        rigid = [replace(j, stiffness=Quantity(np.inf), damping=Quantity(0.0)) for j in drawn.joints]
        return replace(drawn, joints=tuple(rigid))
    if case.lacks == "coupling":
        armature = tuple(Effect(CATALOGUE["rotor_coupling"], place, 0.0) for place in PLACES)
        return replace(drawn, effects=(*drawn.effects, *armature))
    return drawn


def plant(case: Case, seed: int) -> Model:
    """The arm that moves."""
    drawn = load_model(EXAMPLE / "cad.toml")
    model = drawn if case.exact else built(drawn, 1000 + seed)
    if case.changed:
        first, second = model.joints
        first = replace(first, stiffness=replace(first.stiffness, value=0.8 * first.stiffness.value))
        second = replace(second, rotor_inertia=replace(second.rotor_inertia, value=1.1 * second.rotor_inertia.value))
        model = replace(model, joints=(first, second))
    return model


def frames(
    bench: Bench,
    case: Case,
    seed: int = 0,
    *,
    models: Sequence[Model] = (),
    hidden: Sequence[Hidden] = (),
    change: Callable[[Cycles], Cycles] = lambda cycles: cycles,
) -> list[np.ndarray[Any, Any]]:
    """The CAN frames of three runs. models, hidden: what moves in each run and its laws, in place of those of the case;
    change: of what the sensors recorded."""
    models, hidden = models or [plant(case, seed)] * 3, hidden or [case.law] * 3
    scenarios = [replace(s, angular_momentum_nms=case.momentum) for s in bench.scenarios]
    return [
        encode(bench.arm, change(_recorded(bench.arm, model, scenario, 10 * seed + k, law)))
        for k, (model, scenario, law) in enumerate(zip(models, scenarios, hidden, strict=True))
    ]


def _recorded(arm: Arm, model: Model, scenario: Scenario, seed: int, law: Hidden) -> Cycles:
    cycles: Cycles = kept(
        lambda: run(arm, model, scenario, seed, law), ("oracles.simulate",), arm, model, scenario, seed, law
    )
    return cycles


def verdict(bench: Bench, drawn: Model, seen: Sequence[np.ndarray[Any, Any]]) -> Explanation:
    """What is said of the frames; nothing else goes in."""
    records = [read_measured_run(bench.arm, Path(f"run {k}"), one) for k, one in enumerate(seen)]
    return explain(bench.arm, drawn, records[:2], records[2:])


def score(case: Case, seed: int, found: Explanation) -> dict[str, Any]:
    """Compare a verdict with the truth."""
    named = {(f.kind, f.joint) for f in found.findings}
    sets = [{(f.kind, f.joint)} | {_parse(name) for name in f.instead} for f in found.findings]
    wrong = found.answer in {"named", "part named"} and not named <= set(case.hidden)
    # a law that is not exactly its column's may leave something over on the untouched run, and then that is said
    answers = {case.answer, "part named"} if case.law is not None and case.answer == "named" else {case.answer}
    right = found.answer in answers and (not case.hidden or named == set(case.hidden))
    if case.changed:
        right = right and {v.name for v in found.values if v.differs} == {"k1", "Im2"}
    if case.answer == "nothing missing":
        # a value may differ by chance or by what was built; a name would be false
        right = found.answer in {"nothing missing", "values differ"}
    within = right or (
        found.answer == "cannot tell"
        and len(sets) == len(case.hidden)
        and all(len(one) <= 2 for one in sets)
        and all(any(truth in one for one in sets) for truth in case.hidden)
    )
    gap = found.gap
    return {
        "case": case.name,
        "expected": case.answer,
        "seed": seed,
        "answer": found.answer,
        "sentence": found.sentence,
        "right": bool(right),
        "within": bool(within),
        "wrong": bool(wrong),
        "rho": float(np.nanmax(found.refit.excess)),
        "rho_after": float(np.nanmax(found.closed.excess)),
        "completeness": None if found.search is None else min(found.search.completeness),
        "as_delivered": gap and gap.delivered.gap,
        "refit": gap and gap.refit.gap,
        "closed": gap and gap.closed.gap,
        "floor": gap and gap.floor.gap,
        "column": _column(case),
        "limits": {} if found.search is None else {c.name: c.limit for c in found.search.rounds[0]},
    }


def _column(case: Case) -> str:
    """Column of the one effect that a law hides."""
    if case.law is None or not case.law.key:
        return ""
    return f"{case.law.key}{case.law.joint + 1}"


def _parse(column: str) -> tuple[str, str | None]:
    key, joint, _ = column_named(column)
    return key, None if joint < 0 else PLACES[joint]
