# SPDX-License-Identifier: MIT
"""The simulation is a run that another simulator made from the torques of a measured run."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from gap_support import example
from ground_gap_support import Array, axis, measured, nothing, sign, simulated, size
from runs_support import trajectory_of

from zygos.balances.state import State
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.dynamics.replay import exact_readings, replay, substeps
from zygos.effects import CATALOGUE, Effect
from zygos.errors import Undecided, ZygosError
from zygos.gap.content import simulation_json
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.runs import explain_runs
from zygos.runs.cycles import Cycles


def coulomb(q: Array, qd: Array) -> Array:
    return 0.1 * size() * sign(qd)


@cache
def runs(seconds: float = 20.0) -> tuple[Run, ...]:
    return tuple(measured(coulomb, seconds=seconds))


@pytest.mark.slow
def test_the_simulators_model_is_estimated_from_its_run_and_what_it_lacks_is_named() -> None:
    found = explain_runs(simulated(runs()[0]), runs()[:2], validate=runs()[2])
    assert isinstance(found, GroundExplanation)
    assert found.answer == "named", found.sentence
    (friction,) = found.findings
    assert friction.kind == "motor_coulomb"
    assert friction.value == pytest.approx(0.1 * size(), rel=0.02)
    arm, model = axis()
    for name, one in model.base_parameters(arm).items():
        assert found.simulation.parameters[name].value == pytest.approx(one.value, abs=0.01)
    assert not found.simulation.effects
    assert found.notes[0].startswith("the values of the simulation are estimated from its run")
    assert found.notes[0] == found.simulated.sentence  # type: ignore[union-attr]
    assert simulation_json(found.simulated) == {"run": None, "torques_of": None}


@pytest.mark.slow
def test_a_friction_that_the_simulator_has_is_not_missing() -> None:
    c = 0.05 * size()
    found = explain_runs(simulated(measured(lambda q, qd: c * qd)[0], viscous=c), measured(lambda q, qd: c * qd))
    assert found.answer == "nothing missing", found.sentence
    (effect,) = found.simulation.effects
    assert isinstance(effect, Effect)
    assert (effect.kind.key, effect.value) == ("motor_viscous", pytest.approx(c, rel=0.02))


@pytest.mark.slow
def test_the_simulator_of_a_floating_arm() -> None:
    """Its open loop under the torques of run A; the plant has Coulomb friction at the elbow."""
    plant = Effect(CATALOGUE["motor_coulomb"], "elbow", 0.03)
    logs = []
    for seed, name in enumerate("abc"):
        arm, model, scenario = example(name)
        true = replace(model, effects=(*model.effects, plant))
        logs.append(trajectory_of(arm, true, scenario, seeds=[seed], duration_s=20.0, rtol=1e-8, atol=1e-10))
    seen, a = [Run.of_cycles(arm, log.cycles()) for log in logs], logs[0]
    own = seen[0].cycles
    drives = from_model(arm, replace(model, effects=()))
    start = State(a.q[:, 0], a.theta[:, 0], a.qd[:, 0], a.thetad[:, 0], a.omega0[:, 0]).packed()
    steps = substeps(drives, a.q[:, ::97], arm.period_s)
    moved, applied = replay(
        drives, arm.period_s, start, lambda k, _: own.tau[None, k], own.tau[None, 0], len(own.tau), steps
    )
    (q,), (theta,), (rate,) = exact_readings(drives, arm, moved, applied)
    n = len(q)
    made = Run.of_cycles(arm, Cycles(own.sync[:n], q, theta, own.tau[:n], rate[:, None] * arm.axis, own.flags[:n]))
    found = explain_runs(made, seen[:2], validate=seen[2])
    assert found.answer == "named", found.sentence
    (friction,) = found.findings
    assert (friction.kind, friction.joint) == ("motor_coulomb", "elbow")
    assert friction.value == pytest.approx(0.03, rel=0.005)
    for name, one in model.base_parameters(arm).items():
        assert found.simulation.parameters[name].value == pytest.approx(one.value, rel=1e-3)
    assert "estimated from its run" in found.notes[0]


def test_other_torques_and_a_run_that_tells_nothing_are_refused() -> None:
    short = runs(5.0)
    own = simulated(short[0])
    other = replace(own, frames=None, table=replace(own.cycles, tau=1.01 * own.cycles.tau))
    with pytest.raises(ZygosError, match="torques are those of none of the measured runs"):
        explain_runs(other, short)
    with pytest.raises(ZygosError, match="the same recording"):
        explain_runs(short[0], short)
    free = measured(nothing, seconds=5.0)
    rest = 0.0 * free[0].cycles.q + 0.1
    still = replace(free[0], frames=None, table=replace(free[0].cycles, q=rest, theta=rest))
    with pytest.raises(Undecided, match="does not tell its parameters apart"):
        explain_runs(still, free)
