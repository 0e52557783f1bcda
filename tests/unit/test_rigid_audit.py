# SPDX-License-Identifier: MIT
"""The audit of an arm on the ground by the law of the whole arm: Pinocchio's torques, correct ones and wrong ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from audit_support import Fault, both, inverted, scaled, swapped
from panda_support import panda, recorded

from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother, TorqueAt, TorqueUnit
from zygos.audit import Audit, audit, remedies
from zygos.audit.rigid import Reading, RigidLaw
from zygos.runs.cycles import INVALID, Cycles

SIGMA = 0.01
THREE, SEVEN = 3, 7
"""Numbers of joints. What is said of all seven takes ten times as long."""


def run(joints: int, seed: int, **options: float) -> tuple[Cycles, float]:
    """A run, and the deviation of its noisiest torque before the gear."""
    made = recorded(panda(joints), seed, noise=SIGMA, **options)
    return made.cycles, SIGMA * float(made.torque.std(axis=0).max()) / 100.0


def audited(cycles: Cycles, sigma: float = 1.0, unit: TorqueUnit = "Nm") -> Audit:
    """With a declared noise of torques that is not below the true one."""
    arm = panda(cycles.q.shape[1])
    joints = tuple(replace(joint, torque_sigma=sigma) for joint in arm.joints)
    return audit(replace(arm, joints=joints, torque_unit=unit), cycles)


def faults(found: Audit) -> dict[str, str]:
    return {one.signal: one.fault for one in found.findings}


@pytest.mark.slow
@pytest.mark.parametrize(("joints", "seed"), [(THREE, 0), (SEVEN, 0)])
def test_correct_torques_are_never_accused(joints: int, seed: int) -> None:
    """Gravity, coupling, friction, offsets and 1 % of noise; every sign and place is confirmed."""
    cycles, _ = run(joints, seed)
    found = audited(cycles)
    assert found.findings == ()
    assert [s.name for s in found.signals if not s.decided] == []


@pytest.mark.slow
def test_slow_motion_of_little_size_is_not_accused() -> None:
    """Less is confirmed then, and nothing is made up."""
    cycles, _ = run(SEVEN, 3, amplitude=0.08)
    assert audited(cycles).findings == ()


T = [f"j{i} torque" for i in range(1, 8)]


def exchange(i: int, j: int) -> tuple[Fault, dict[str, str]]:
    return swapped("tau", i, j), {T[i]: f"swapped with {T[j]}", T[j]: f"swapped with {T[i]}"}


def cases() -> Iterator[tuple[int, str, Fault, dict[str, str]]]:
    """Number of joints, name, fault and what is said of it."""
    for i in (0, 2):
        yield THREE, f"inverted {i + 1}", inverted("tau", i), {T[i]: "inverted"}
    yield THREE, "swapped 2 3", *exchange(1, 2)
    everything = both(*(inverted("tau", i) for i in range(THREE)))
    yield THREE, "all inverted", everything, dict.fromkeys(T[:THREE], "inverted")
    fault, expected = exchange(1, 2)
    yield THREE, "two", both(inverted("tau", 0), fault), {T[0]: "inverted", **expected}
    yield SEVEN, "angle of 4", inverted("theta", 3), {"j4 motor angle": "inverted"}


CASES = list(cases())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "fault", "expected"), [(n, *case) for n, _, *case in CASES], ids=[f"{n} {name}" for n, name, *_ in CASES]
)
def test_wrong_readings_are_named(joints: int, fault: Fault, expected: dict[str, str]) -> None:
    cycles, _ = run(joints, 4)
    assert faults(audited(fault(cycles))) == expected


def test_a_wrong_gear_ratio_is_named_with_its_value() -> None:
    joint, factor = 2, 0.625
    cycles, _ = run(THREE, 5)
    found = audited(scaled("tau", joint, factor)(cycles))
    assert list(faults(found)) == [T[joint]]
    said = found.findings[0].fault
    assert said.startswith("scaled by ")
    assert float(said.removeprefix("scaled by ")) == pytest.approx(factor, rel=0.03)
    said = found.findings[0].remedy.removeprefix("gear_ratio = ").split(" ")[0]
    assert float(said) == pytest.approx(100.0 / factor, rel=0.03)


def pendulum(torque_at: TorqueAt = "rotor") -> tuple[Arm, Cycles]:
    """Two links of 0.3 m that swing about x, gears of 6, and 20 s of their torques by Lagrange's equations."""
    encoder = Encoder(2 * np.pi / 2**16, 2**16)
    joints = tuple(
        Joint(name, i + 1, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 6.0, encoder, encoder, flexible=False, torque_sigma=0.01,
              position_m=(0.0, 0.0, -0.3 * i))
        for i, name in enumerate(("j1", "j2"))
    )  # fmt: skip
    arm = Arm("pendulum", "fixed", "planar", 0.005, "sampled", torque_at, joints, NO_IMU,
              smoother=Smoother(31, 4, 15), gravity=(0.0, 0.0, -9.81))  # fmt: skip
    t = arm.period_s * np.arange(4000)
    size, rate, phase = np.array([[0.8, 0.4], [0.9, 0.5]]), np.array([[2.4, 5.2], [3.4, 7.0]]), np.array([0.1, 1.0])
    angle = rate[..., None] * t + phase[:, None]
    q, v, a = (
        np.einsum("ij,ijt->it", size * rate**k, wave)
        for k, wave in ((0, np.sin(angle)), (1, np.cos(angle)), (2, -np.sin(angle)))
    )
    coupling, inner, outer = 0.018, 0.066, 0.013
    weight = 9.81 * np.array([0.22, 0.06])[:, None] * np.sin([q[0], q[0] + q[1]])
    cosine, sine = coupling * np.cos(q[1]), coupling * np.sin(q[1])
    torque = np.array([
        (inner + 2 * cosine) * a[0] + (outer + cosine) * a[1] - sine * (2 * v[0] + v[1]) * v[1] + weight.sum(axis=0),
        (outer + cosine) * a[0] + outer * a[1] + sine * v[0] ** 2 + weight[1],
    ]) + 0.03 * np.tanh(v / 0.01)  # fmt: skip
    torque += 0.002 * np.random.default_rng(0).standard_normal(torque.shape)
    theta = encoder.quantum_rad * np.rint(q.T / encoder.quantum_rad)
    tau = torque.T / (6.0 if torque_at == "rotor" else 1.0)
    number, flags = np.arange(len(t), dtype=np.uint64), np.zeros(len(t), dtype=np.uint32)
    return arm, Cycles(number, theta, theta.copy(), tau, np.zeros((len(t), 3)), flags)


@pytest.mark.slow
@pytest.mark.parametrize(("torque_at", "factor"), [("rotor", 6.0), ("joint", 1 / 6)], ids=["rotor", "joint"])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_torque_of_the_other_side_of_its_gear_is_named_between_two(
    torque_at: TorqueAt, factor: float, joint: int
) -> None:
    """The torques of two joints show their ratio alone, and the inverse factor of the other torque is no gear's."""
    arm, cycles = pendulum(torque_at)
    assert faults(audit(arm, cycles)) == {}
    found = audit(arm, scaled("tau", joint, factor)(cycles))
    assert list(faults(found)) == [T[joint]]
    assert found.findings[0].remedy.startswith("measured ")


@pytest.mark.slow(but=["1"])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_late_angle_is_no_early_torque(joint: int) -> None:
    """Of one joint, by four periods of 5 ms."""
    arm, cycles = pendulum()
    theta, flags = cycles.theta.copy(), cycles.flags.copy()
    theta[4:, joint] = cycles.theta[:-4, joint]
    flags[:4] = INVALID
    (finding,) = audit(arm, replace(cycles, q=theta, theta=theta, flags=flags)).findings
    assert finding.signal == f"j{joint + 1} motor angle" and finding.fault.startswith("late by ")
    (setting,) = finding.settings
    assert (setting.key, setting.value) == ("delay_s", pytest.approx(0.020, abs=4e-4))


CONSTANTS = (2.0, 3.0, 0.7, 1.4, 0.3, 5.0, 1.0)
"""Ampere for one Nm of each motor."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "fault", "expected"),
    [(SEVEN, both(), {}), (THREE, inverted("tau", 1), {T[1]: "inverted"}), (THREE, *exchange(1, 2))],
    ids=["as recorded", "inverted", "swapped"],
)
def test_the_scales_of_currents_are_no_fault(joints: int, fault: Fault, expected: dict[str, str]) -> None:
    """Nobody knows the constants of the motors; signs and places are decided nevertheless."""
    cycles, _ = run(joints, 4)
    currents = fault(both(*(scaled("tau", i, CONSTANTS[i]) for i in range(joints)))(cycles))
    assert faults(audited(currents, unit="A")) == expected


@pytest.mark.slow
def test_the_noise_of_torques_is_compared_with_the_declared_one() -> None:
    cycles, sigma = run(THREE, 6)
    assert faults(audited(cycles, sigma)) == {}
    said = faults(audited(cycles, sigma / 100.0))
    assert any(fault.startswith("noisier than declared by a factor of ") for fault in said.values())
    silent = audited(cycles, 0.0)
    assert silent.ok and all(any(f"{name}: changes by" in text for text in silent.remarks) for name in T[:THREE])


def test_a_torque_that_is_noisier_by_a_unit_may_be_a_current() -> None:
    """A current of mA at 0.1 Nm/A reads 10,000 times the torque; no other evidence shows a scale that all have."""
    arm = replace(panda(1), joints=(replace(panda(1).joints[0], torque_sigma=2e-4),))
    assert "about 0.1 Nm/A if" in remedies.noisy_torque(arm, 0, 2.0).text
    assert remedies.noisy_torque(arm, 0, 6e-4).text.startswith("torque_sigma = 0.0006 of the joint")


def test_a_short_run_decides_nothing() -> None:
    cycles, _ = run(SEVEN, 7, duration_s=4.0)
    found = audited(cycles)
    assert found.findings == ()
    assert not found.ok
    assert any("too short for the law of the whole arm" in note for note in found.notes)


@pytest.mark.slow
def test_torques_of_another_run_are_not_explained() -> None:
    """They belong to no joint, so that none is accused and none is confirmed."""
    cycles, _ = run(THREE, 8)
    other, _ = run(THREE, 9)
    found = audited(replace(cycles, tau=other.tau))
    assert found.findings == ()
    assert {s.name for s in found.signals if not s.decided} >= set(T[:THREE])


def test_noise_that_is_larger_by_the_gear_ratio_may_be_that_of_a_torque_behind_it() -> None:
    arm = replace(panda(1), joints=(replace(panda(1).joints[0], torque_sigma=2e-4),))
    assert 'at = "output" of torque in the map' in remedies.noisy_torque(arm, 0, 0.019).text
    assert "behind the gear" not in remedies.noisy_torque(arm, 0, 0.01).text
    sensors = replace(arm, torque_at="joint")
    assert "behind the gear" not in remedies.noisy_torque(sensors, 0, 0.019).text


def test_the_remedy_of_a_wrong_scale_is_that_of_its_side() -> None:
    """Of a sensor behind the gear, no key of the arm file changes the scale."""
    arm, sensors = panda(1), replace(panda(1), torque_at="joint")
    for told, factor, said in (
        (arm, 0.0102, 'measured behind the gear: at = "output" of torque in the map'),
        (arm, 0.02, "gear_ratio = 2.0 of the joint"),
        (arm, 100.0, "gear_ratio = 10000.0 of the joint"),
        (sensors, 98.0, "measured before the gear: scale = 100.0 of torque in the map"),
        (sensors, 0.01, "scale = 0.01 of torque in the map"),
    ):
        assert remedies.torque_scale(told, 0, factor).text.startswith(said)
        assert remedies.other_side(told, 0, factor) == said.startswith("measured")


@pytest.mark.parametrize("count", range(36, 130, 7))
def test_a_run_of_which_few_rows_are_left_has_no_score(count: int) -> None:
    """Another unit of the angles may leave only a few valid instants, all of them in one half of the run."""
    cycles = recorded(panda(2), 5, duration_s=1.0).cycles
    few = Cycles(*(getattr(cycles, name)[:count] for name in Cycles.__dataclass_fields__))
    law = RigidLaw(panda(2), few, set())
    score = law.score(Reading.declared(2))
    assert np.isfinite(score.total) or np.isnan(score.share).all()
    assert not law.enough
