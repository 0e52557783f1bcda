# SPDX-License-Identifier: MIT
"""Estimates of arms on the ground from CAN frames, whose torques come from Pinocchio."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import ground_support
import numpy as np
import pytest
from ground_support import heavier, recorded, short_arm, torque_of
from laboratory_support import laboratory_arm
from pendulum_support import recordings

from zygos.arm import Arm, load_arm
from zygos.can.run import Run, joined
from zygos.effects import CATALOGUE, Effect, effect
from zygos.errors import Undecided, ZygosError
from zygos.ground.estimate import GroundEstimate, estimate_ground
from zygos.ground.motion import Motion, torque_noise
from zygos.ground.payload import check_found, payload
from zygos.ground.rows import friction
from zygos.ground.score import score
from zygos.model.model import Model, load_model, save_model
from zygos.model.nearest import nearest_bodies
from zygos.runs.cycles import Cycles
from zygos.simulation.run import simulate
from zygos.simulation.scenario import load_scenario

EXAMPLES = Path(__file__).parents[2] / "examples"


OFFSETS = np.array([[0.01, -0.02, 0.005], [-0.01, 0.01, 0.02]])


@cache
def _setup(joints: int = 3) -> tuple[Arm, Model, Run, Run]:
    """An arm and two runs of it. Two joints are cheaper, and three show what gravity and a payload do."""
    arm, model = short_arm(joints)
    first, second = (recorded(arm, model, path=k, seed=k, offset=OFFSETS[k, :joints]) for k in (0, 1))
    return arm, model, first, second


@cache
def _learned() -> Model:
    """What the first run of two joints says."""
    return estimate_ground([_setup(2)[2]]).to_model()


def _truth(found: GroundEstimate, model: Model) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    known = {one.column(found.arm): one.value for one in model.effects}
    effects = [known.get(one.column(found.arm), 0.0) for one in found.effects]
    return np.concatenate([model.base_values(found.arm), effects])


def _within(found: GroundEstimate, truth: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Share of the values whose 95 % interval misses the truth."""
    return float(np.mean(np.abs(found.solution.value - truth) > found.solution.half(0.95)))


@pytest.mark.slow
def test_two_runs_with_different_offsets_give_one_arm() -> None:
    arm, model, first, second = _setup(2)
    found = estimate_ground([first, second])
    assert found.validity == "valid", found.reason
    assert np.abs(found.solution.offset - OFFSETS[:, :2]).max() < 1e-3
    assert _within(found, _truth(found, model)) <= 0.2
    declared = np.array([joint.torque_sigma for joint in arm.joints])
    assert np.all(found.torque_sigma < 2.5 * declared)
    assert np.all(found.excess < 1.3)


@pytest.mark.slow
def test_intervals_hold_over_seeds() -> None:
    arm, model = short_arm(2)
    missed, beyond = [], []
    for seed in range(16):
        run = recorded(arm, model, path=2, seed=seed, seconds=16.0, offset=0.01)
        found = estimate_ground([run])
        truth = _truth(found, model)
        missed.append(_within(found, truth))
        beyond.append(float(np.mean(np.abs(found.solution.value - truth) > found.solution.half(0.999))))
    error = 3.0 * np.std(missed, ddof=1) / np.sqrt(len(missed))
    assert np.mean(missed) <= 0.05 + max(error, 0.01)
    assert np.mean(missed) >= 0.05 - max(error, 0.05)
    assert np.mean(beyond) <= 0.001 + 3.0 * np.sqrt(0.001 / (16 * 20))


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "noise"), [(0.05, 1.0), (0.0, 5.0)])
def test_an_offset_or_loud_torques_leave_good_parameters_good(offset: float, noise: float) -> None:
    arm, model, *_ = _setup(2)
    quiet = replace(arm, joints=tuple(replace(joint, torque_sigma=0.0) for joint in arm.joints))
    run = recorded(arm, model, path=0, seed=3, seconds=10.0, offset=offset, noise=noise)
    found = estimate_ground([replace(run, arm=quiet)])
    assert found.validity in ("valid", "partial"), found.reason
    assert found.determined.mean() > 0.85
    assert "not noise" not in found.reason
    assert _within(found, _truth(found, model)) <= 0.2


@pytest.mark.slow
def test_a_model_predicts_a_run_that_it_never_saw() -> None:
    _, model, _, second = _setup(2)
    true, own = score(second, model), score(second, _learned())
    for one, two in zip(true.joints, own.joints, strict=True):
        # at the accelerations' frequencies the encoders add to the noise of the torques, at the readings' they do not
        assert one.sigmas < 2.5, one
        assert two.error_nm < 1.05 * one.error_nm
        assert 0.95 < one.floor < 1.1
        assert two.floor < 1.05 * one.floor
        assert one.energy_share < 0.01
    assert abs(true.joints[1].offset_nm - 100.0 * 0.01) < 0.1


@pytest.mark.slow
def test_a_wrong_model_is_seen_at_its_joint() -> None:
    _, model, first, _ = _setup()
    wrong = heavier(model, 1.0, (0.0, 0.0, 0.1))
    assert score(first, wrong).joints[2].share > 5.0 * score(first, model).joints[2].share


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "key", "place", "size"),
    [
        ({"asymmetry": 0.004}, "viscous_asymmetry", slice(None), 0.004),
        ({"load": 0.06}, "load_friction", slice(1, None), 0.06),
        ({"gain": 0.05}, "torque_gain", slice(0, 1), 0.05),
    ],
)
def test_nuisances_of_real_drives_are_found(more: dict[str, float], key: str, place: slice, size: float) -> None:
    arm, model, *_ = _setup(3 if key == "torque_gain" else 2)
    run = recorded(arm, model, path=3, seed=0, seconds=20.0 if key == "torque_gain" else 10.0, offset=0.01, more=more)
    kinds = [CATALOGUE[one] for one in ("motor_coulomb", "motor_viscous")]
    asked = friction(arm, [CATALOGUE[key]])
    effects = (*friction(arm, kinds), *(asked[1:] if key == "torque_gain" else asked))
    found = estimate_ground([run], effects=effects)
    at = [found.names.index(one.column(arm)) for one in effects if one.kind.key == key][place]
    without = estimate_ground([run])
    assert np.allclose(found.solution.value[at], size, atol=0.1 * size + 3.0 * found.solution.sigma[at].max())
    assert np.all(found.solution.value[at] > 5.0 * found.solution.sigma[at])
    assert without.excess.max() > 1.2 * found.excess.max()


def test_currents_give_ratios_only_and_say_so(tmp_path: Path) -> None:
    arm, model, *_ = _setup(2)
    amperes = replace(arm, torque_unit="A")
    run = recorded(arm, model, path=3, seed=0, seconds=20.0, more={"gain": 0.2})
    found = estimate_ground([replace(run, arm=amperes)])
    assert found.relative
    assert "relative" in " ".join(found.notes)
    gain = found.solution.value[found.names.index("torque_gain2")]
    assert gain == pytest.approx(0.2, rel=0.1)
    save_model(found.to_model(), tmp_path / "model.toml")
    assert not re.search(r'"(Nm|kg)', (tmp_path / "model.toml").read_text())
    learned = load_model(tmp_path / "model.toml")
    assert learned.relative and learned.base_values(amperes).tolist() == found.value[: len(arm.parameters)].tolist()
    for refused in (
        lambda: score(run, learned),
        lambda: payload([run], learned),
        lambda: nearest_bodies(arm, model, learned),
    ):
        with pytest.raises(ZygosError, match=r"learned from motor currents.*remedy"):
            refused()


@pytest.mark.slow
def test_friction_that_comes_out_negative_by_noise_can_be_read_back(tmp_path: Path) -> None:
    """Of an arm without friction: its model is a file that every command reads."""
    arm, model = short_arm(2)
    bare = replace(model, effects=())
    found = estimate_ground([recorded(arm, bare, path=0, seed=0, seconds=8.0)])
    friction = [value for name, value in zip(found.names, found.solution.value, strict=True) if "coulomb" in name]
    assert min(friction) < 0.0
    assert found.validity != "doubtful"
    save_model(found.to_model(), tmp_path / "model.toml")
    assert all(effect.value >= 0.0 for effect in load_model(tmp_path / "model.toml").effects)


@pytest.mark.slow
def test_a_payload_is_weighed() -> None:
    arm, model, *_ = _setup()
    place = (0.05, -0.02, 0.2)
    run = recorded(arm, heavier(model, 2.8, place), path=1, seed=5, offset=0.01)
    found = payload([run], model)
    assert found.found
    truth = {"m3": 2.8, "mx3": 2.8 * place[0], "my3": 2.8 * place[1], "mz3": 2.8 * place[2]}
    assert {"m3", "mx3"} <= set(found.names)
    for name, value, sigma in zip(found.names, found.value, found.sigma, strict=True):
        if name in truth and "+" not in found.groups[found.names.index(name)]:
            assert abs(value - truth[name]) < 4.0 * sigma, (name, value, sigma)
    assert np.all(found.after < 0.3 * found.before[1])
    after = score(run, found.to_model())
    assert all(one.floor < 1.1 for one in after.joints)


@pytest.mark.slow
def test_friction_is_averaged_as_the_torques_of_a_faster_recording() -> None:
    """A reversal falls somewhere into its period: a mean torque has seen it there, and the sign of a rate at the
    instants has not. Without noise, what the values have wrong becomes a third."""
    arm, model, *_ = _setup(2)
    finer = 10
    fast = replace(arm, period_s=arm.period_s / finer)
    q, tau = torque_of(fast, model, path=0, seconds=8.0)
    at = np.arange(finer, len(q) - finer, finer)
    weight = np.ones(finer + 1)
    weight[[0, -1]] = 0.5
    window = np.arange(finer + 1) - finer // 2
    mean = np.einsum("w,mwj->mj", weight / finer, tau[at[:, None] + window])
    m = len(at)
    cycles = Cycles(np.arange(m, dtype=np.uint64), q[at], q[at], mean, np.zeros((m, 3)), np.zeros(m, dtype=np.uint32))
    wrong, bodies = [], []
    for averaged in (False, True):
        described = replace(arm, torque_law="sampled", torque_averaged=averaged)
        found = estimate_ground([Run(described, table=cycles)])
        error, own = found.solution.value - _truth(found, model), len(arm.parameter_names)
        wrong.append(np.sqrt(np.mean(error[own:] ** 2)))
        bodies.append(np.sqrt(np.mean((error[:own] / found.solution.sigma[:own]) ** 2)))
    assert wrong[1] < wrong[0] / 3.0, wrong
    assert bodies[1] < 1.5, bodies  # 6 where the halves of the last means count


@pytest.mark.slow
def test_the_interval_of_a_payload_holds_the_uncertainty_of_the_model() -> None:
    """Sixteen models, each from a run of its own, and the same payload: what the models have wrong together is part of
    the intervals."""
    arm, model, *_ = _setup()
    place, held, count = (0.05, -0.02, 0.2), 0, 0
    truth = {"m3": 2.8, "mx3": 2.8 * place[0], "my3": 2.8 * place[1], "mz3": 2.8 * place[2]}
    for seed in range(16):
        learned = estimate_ground([recorded(arm, model, path=0, seed=100 + seed, seconds=8.0)]).to_model()
        loaded = recorded(arm, heavier(model, 2.8, place), path=1, seed=200 + seed, seconds=24.0, offset=0.01)
        found = payload([loaded], learned)
        for name, group, value, half in zip(found.names, found.groups, found.value, found.half95, strict=True):
            if name in truth and "+" not in group:
                held += abs(value - truth[name]) < half
                count += 1
    assert count >= 32
    assert held / count > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / 16), (held, count)  # values of one seed are correlated


@pytest.mark.slow
@pytest.mark.parametrize(("key", "value"), [("torque_gain", 0.2), ("load_friction", 0.1)])
def test_a_payload_beside_a_wrong_gain_or_friction_with_the_load(key: str, value: float) -> None:
    """What the model says of the torques holds with the payload, too."""
    arm, model, *_ = _setup()
    place = (0.05, -0.02, 0.2)
    more = {"gain" if key == "torque_gain" else "load": value}
    loaded = recorded(arm, heavier(model, 2.8, place), path=1, seed=5, more=more)
    kinds = [CATALOGUE["motor_coulomb"], CATALOGUE["motor_viscous"]]
    effects = (*friction(arm, kinds), *friction(arm, [CATALOGUE[key]])[1 if key == "torque_gain" else 0 :])
    learned = estimate_ground([recorded(arm, model, path=0, seed=6, more=more)], effects=effects).to_model()
    found = payload([loaded], learned)
    for name, truth in (("m3", 2.8), ("mx3", 2.8 * place[0])):
        k = found.names.index(name)
        assert abs(found.value[k] - truth) < 4.0 * found.sigma[k], (name, found.value[k], found.sigma[k])
        assert found.sigma[k] < 0.05 * abs(truth)
    # the model with the payload knows what it knew, and no more of what the payload took over
    assert np.linalg.eigvalsh(found.to_model().covariance(arm)).min() > -1e-9


@pytest.mark.slow
def test_correlations_are_read_back(tmp_path: Path) -> None:
    _, _, first, _ = _setup(2)
    learned = _learned()
    save_model(learned, tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert again == learned
    covariance = again.covariance(first.arm)
    off = covariance - np.diag(np.diag(covariance))
    assert np.abs(off).max() > 0.1 * np.diag(covariance).min()
    bare = replace(again, correlation=None)
    np.testing.assert_allclose(np.diag(bare.covariance(first.arm)), np.diag(covariance), rtol=1e-12)
    assert np.count_nonzero(bare.covariance(first.arm)) == len(covariance)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("b = [0.5, 0.5]", "is not an array of 1 numbers"),
        ("b = [1.5]", "1.5"),
        ("b = [0.9]\nc = [0.9, -0.9]", "the correlations contradict each other"),
    ],
)
def test_correlations_that_cannot_be_are_refused(tmp_path: Path, line: str, said: str) -> None:
    (tmp_path / "m.toml").write_text(
        f'name = "x"\n[parameters]\na = 1.0\nb = 1.0\nc = 1.0\n[correlation]\na = []\n{line}\n'
    )
    with pytest.raises(ZygosError, match=said):
        load_model(tmp_path / "m.toml")


def test_the_noise_of_a_torque_that_is_not_declared_is_seen() -> None:
    """In frames it has the error of their steps; a table of exact torques has next to none."""
    arm, _, first, _ = _setup(2)
    silent = replace(arm, joints=tuple(replace(joint, torque_sigma=0.0) for joint in arm.joints))
    declared = np.array([joint.torque_sigma for joint in arm.joints])
    table = replace(first.cycles, tau=first.cycles.tau + 3e-6)  # off the steps of the frames
    seen = torque_noise(Motion.of(Run(silent, table=table)))
    np.testing.assert_allclose(seen, declared, rtol=0.1)
    t = np.arange(len(table)) * arm.period_s
    smooth = replace(table, tau=np.column_stack([np.sin(t + k) for k in range(arm.n)]))
    assert np.all(torque_noise(Motion.of(Run(silent, table=smooth))) < 1e-5)
    stepped = replace(table, tau=np.round(smooth.tau, 4))
    assert np.all(torque_noise(Motion.of(Run(silent, table=stepped))) >= 1e-4 / np.sqrt(12.0))


def test_no_payload_is_no_payload() -> None:
    arm, model, first, _ = _setup()
    found = payload([first], model)
    assert not found.found
    with pytest.raises(Undecided, match="no payload"):
        check_found(found)
    blind = replace(arm, joints=tuple(replace(joint, position_m=None) for joint in arm.joints))
    with pytest.raises(ZygosError, match="position_m"):
        payload([replace(first, arm=blind)], model)


@pytest.mark.slow
def test_what_is_no_noise_is_named() -> None:
    arm, model, *_ = _setup(2)
    run = recorded(arm, model, path=3, seed=0, seconds=10.0, more={"load": 0.3})
    found = estimate_ground([run])
    assert found.validity == "partial"
    assert "not noise" in found.reason
    assert found.remedy
    assert found.elsewhere is None, "another law of friction is no other gravity"


@pytest.mark.slow(but=["gravity1"])
@pytest.mark.parametrize("gravity", [(0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_gravity_that_points_elsewhere_is_named(gravity: tuple[float, float, float]) -> None:
    arm, model, *_ = _setup()
    assert arm.gravity == (0.0, 0.0, -9.81)
    run = recorded(arm, model, seconds=8.0)
    found = estimate_ground([replace(run, arm=replace(arm, gravity=gravity))])
    assert found.validity == "doubtful"
    assert "with gravity = [0.0, 0.0, -9.81]" in found.reason
    assert "gravity in the arm file" in found.remedy


def test_a_motion_at_rest_determines_little() -> None:
    arm, model, *_ = _setup()
    run = recorded(arm, model, path=0, seed=0, seconds=4.0)
    cycles = run.cycles
    still = Run.of_cycles(arm, replace(cycles, q=0.0 * cycles.q, theta=0.0 * cycles.theta))
    try:
        found = estimate_ground([still])
    except Undecided:
        return
    assert found.validity != "valid"


def test_refusals() -> None:
    arm, model, first, _ = _setup()
    floating = load_arm(EXAMPLES / "spatial" / "arm.toml")
    with pytest.raises(ZygosError, match="fixed base and rigid joints"):
        estimate_ground([replace(first, arm=floating)])
    cycles = first.cycles
    brief = Run(
        arm,
        table=replace(cycles, **{k: getattr(cycles, k)[:200] for k in ("sync", "q", "theta", "tau", "omega", "flags")}),
    )
    with pytest.raises(Undecided, match="too few"):
        estimate_ground([brief])
    other, other_model = short_arm(2)
    second = recorded(other, other_model, seconds=4.0)
    with pytest.raises(ZygosError, match="another arm"):
        estimate_ground([first, second])
    with pytest.raises(ZygosError, match="cut-off"):
        score(first, model, cutoff=1e4)


@pytest.mark.slow
def test_a_floating_arm_with_springs_is_scored_by_increments() -> None:
    """Friction that the model lacks is the torque that is left at its joint, and a wrong spring is left at the spring
    alone: the sum of the balances of rotor and link is free of it."""
    arm, model = load_arm(EXAMPLES / "gap" / "arm.toml"), load_model(EXAMPLES / "lively" / "model.toml")
    friction = 0.5
    true = replace(model, effects=(replace(effect("motor_coulomb", "elbow"), value=friction),))
    run = simulate(arm, true, load_scenario(EXAMPLES / "lively" / "scenario.toml"), noise=True, duration_s=12.0)
    stiff = replace(
        true,
        joints=tuple(
            replace(joint, stiffness=replace(joint.stiffness, value=1.2 * joint.stiffness.value))
            for joint in true.joints
        ),
    )
    own, lacking, wrong = (score(run, one) for one in (true, model, stiff))
    assert own.cutoff_hz is None and own.increment_s == pytest.approx(0.2)
    assert own.arm_energy_share < 1e-3 < 1e-2 < min(lacking.arm_energy_share, wrong.arm_energy_share)
    shoulder, elbow = own.joints
    assert max(joint.sigmas for joint in own.joints) < 2.0 and max(joint.share for joint in own.joints) < 0.1
    assert lacking.joints[0].error_nm == pytest.approx(shoulder.error_nm)
    # the sign of the rate, less its mean, which is taken as an offset
    added = lacking.joints[1].error_nm ** 2 + lacking.joints[1].offset_nm ** 2 - elbow.error_nm**2
    assert np.sqrt(added) == pytest.approx(friction * arm.joints[1].gear_ratio, rel=0.05)
    for one, two in zip(own.joints, wrong.joints, strict=True):
        assert two.error_nm == pytest.approx(one.error_nm)
        assert two.spring_nm > 5.0 * one.spring_nm
    with pytest.raises(ZygosError, match=r"--cutoff: arm .* remedy: leave it out"):
        score(run, model, cutoff=5.0)
    ground_only = next(kind for kind in CATALOGUE.values() if kind.on_ground and kind.at_joint)
    with pytest.raises(ZygosError, match=rf"effect {ground_only.key} at elbow: .* remedy: remove"):
        score(run, replace(model, effects=(Effect(ground_only, "elbow", 1.0),)))
    cycles = run.cycles
    few = {name: getattr(cycles, name)[:15] for name in ("sync", "q", "theta", "tau", "omega", "flags")}
    with pytest.raises(ZygosError, match=r"no unbroken piece of 0\.2 s; remedy: a longer run"):
        score(Run(arm, table=replace(cycles, **few)), model)


def test_joined_runs_have_a_gap_between() -> None:
    _, _, first, second = _setup()
    whole = joined([first, second])
    assert len(whole) == len(first) + len(second)
    assert np.count_nonzero(np.diff(whole.cycles.sync.astype(np.int64)) != 1) == 1
    assert joined([first]) is first


@pytest.mark.slow
def test_a_joint_whose_torque_is_hardly_more_than_noise_is_not_evaluated() -> None:
    """Its error in per cent would say nothing of the model, which is right."""
    arm, model, *_ = _setup(2)
    run = recorded(arm, model, path=0, seed=0, seconds=10.0)
    plain = score(run, model)
    assert all(one.evaluated and one.error_nm < 3.0 * one.floor_nm for one in plain.joints)
    # noise as large as the torque of the second joint
    loud = np.random.default_rng(0).normal(0.0, 1.0, len(run)) * np.std(run.cycles.tau[:, 1]) * 30.0
    tau = run.cycles.tau + np.stack([np.zeros(len(run)), loud], axis=1)
    found = score(replace(run, frames=None, table=replace(run.cycles, tau=tau)), model)
    assert [one.evaluated for one in found.joints] == [True, False]
    assert found.share == pytest.approx(found.joints[0].share)
    assert found.as_dict()["joints"][1]["evaluated"] is False


@pytest.mark.slow
def test_a_joint_that_noise_dominates_does_not_decide_an_estimate() -> None:
    """All of its torque is left, which says nothing of the other joint."""
    arm, model, *_ = _setup(2)
    runs = []
    for k in range(2):
        run = recorded(arm, model, path=k, seed=k, seconds=10.0)
        loud = np.random.default_rng(k).normal(0.0, 1.0, len(run)) * np.std(run.cycles.tau[:, 1]) * 30.0
        tau = run.cycles.tau + np.stack([np.zeros(len(run)), loud], axis=1)
        runs.append(replace(run, frames=None, table=replace(run.cycles, tau=tau)))
    found = estimate_ground(runs)
    assert found.evaluated.tolist() == [True, False]
    assert found.solution.share[1] > 0.5 and "% of the held-out torque" not in found.reason
    assert [one["evaluated"] for one in found.as_dict()["joints"]] == [True, False]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "unit"), [("UR10e", "Nm"), ("Panda", "A")])
def test_gains_of_torque_sensors_do_not_multiply_what_is_not_explained_by_zero(name: str, unit: str) -> None:
    """Drives whose friction grows with the load, which the model lacks: where nothing holds the gains, and a joint is
    weighted by what its multiplied equation leaves, they become -1."""
    arm, model = laboratory_arm(name, torque_law="sampled")
    gain = np.array([0.0, -0.3, -0.15, 0.4, 0.2, -0.3, 0.05][: arm.n]) * (1.0 if unit == "A" else 0.1)
    runs = []
    for k in range(2):
        run = recorded(arm, model, path=k, seed=k, seconds=15.0, more={"load": 0.08})
        table = replace(run.cycles, tau=run.cycles.tau / (1.0 + gain))
        runs.append(replace(run, arm=replace(arm, torque_unit=unit), frames=None, table=table))
    kinds = [CATALOGUE[key] for key in ("motor_coulomb", "motor_viscous")]
    sensed = friction(arm, [CATALOGUE["torque_gain"]])[1:]
    found = estimate_ground(runs, effects=(*friction(arm, kinds), *sensed))
    at = [found.names.index(one.column(arm)) for one in sensed]
    assert np.all(np.abs(found.solution.value[at] - gain[1:]) < 0.45)
    assert np.all(found.solution.share > 0.005) and np.all(found.solution.share < 0.2)
    assert found.validity == "partial" and "not noise" in found.reason


@pytest.mark.slow
def test_a_gain_that_no_sensor_has_is_doubted_where_the_balance_does_not_close(tmp_path: Path) -> None:
    """Friction of a measured arm that is not asked for looks like a torque sensor that is 58 % off."""
    measured = recordings(tmp_path)
    arm = measured["00"].arm
    sensed = friction(arm, [CATALOGUE["torque_gain"]])[1:]
    found = estimate_ground([measured["00"]], effects=sensed)
    assert found.solution.value[-1] < -0.4
    assert found.validity == "doubtful" and "looks like a gain" in found.reason and "--friction" in found.remedy
    kinds = [CATALOGUE[key] for key in ("motor_coulomb", "motor_viscous")]
    found = estimate_ground([measured["00"], measured["02"]], effects=(*friction(arm, kinds), *sensed))
    assert abs(found.solution.value[-1]) < 0.2 and found.validity == "partial"


def test_gravity_is_not_blamed_because_it_needs_a_large_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint about the vertical that hardly turns, with cogging that the model lacks: gravity along another axis is
    nearly constant there, and beside the offset that takes it up again every residual is a small share."""
    arm, model = short_arm(1)
    free = ground_support.motion
    monkeypatch.setattr(ground_support, "motion", lambda *given: tuple(0.03 * part for part in free(*given)))
    runs = []
    for k in range(2):
        run = recorded(arm, model, path=k, seed=k, seconds=20.0)
        q, spread = run.cycles.theta, np.std(run.cycles.tau)
        tau = run.cycles.tau + spread * (np.sin(83.0 * q) + 0.3 * (q - q.mean()) / np.std(q))
        runs.append(replace(run, frames=None, table=replace(run.cycles, tau=tau)))
    found = estimate_ground(runs)
    assert found.validity == "doubtful" and found.elsewhere is None, found.reason


@pytest.mark.slow
def test_one_joint_of_which_most_is_left_makes_an_estimate_doubtful() -> None:
    """The mean over the joints may be small."""
    arm, model, *_ = _setup()
    runs = []
    for k in range(2):
        run = recorded(arm, model, path=k, seed=k, seconds=10.0)
        q = run.cycles.theta[:, 2]
        tau = run.cycles.tau.copy()
        tau[:, 2] += 1.5 * np.std(tau[:, 2]) * np.sin(15.0 * q)
        runs.append(replace(run, frames=None, table=replace(run.cycles, tau=tau)))
    found = estimate_ground(runs)
    assert found.solution.share[:2].max() < 0.2 and found.solution.share[2] > 0.5
    assert np.sqrt(np.mean(found.solution.share**2)) < 0.5
    assert found.validity == "doubtful" and "held-out torque at joint3" in found.reason
