"""The audit of an arm on the ground by the law of the whole arm: Pinocchio's torques, correct ones and wrong ones."""

from __future__ import annotations

from dataclasses import replace

import pytest
from audit_support import Fault, both, inverted, scaled, swapped
from panda_support import panda, recorded

from zygos.audit import Audit, audit
from zygos.runs.cycles import Cycles

ARM = panda()
SIGMA = 0.01


def run(seed: int, **options: float) -> tuple[Cycles, float]:
    """A run, and the deviation of its noisiest torque before the gear."""
    made = recorded(ARM, seed, noise=SIGMA, **{"duration_s": 20.0, **options})
    return made.cycles, SIGMA * float(made.torque.std(axis=0).max()) / 100.0


def audited(cycles: Cycles, sigma: float = 1.0) -> Audit:
    """With a declared noise of torques that is not below the true one."""
    joints = tuple(replace(joint, torque_sigma=sigma) for joint in ARM.joints)
    return audit(replace(ARM, joints=joints), cycles)


def faults(found: Audit) -> dict[str, str]:
    return {one.signal: one.fault for one in found.findings}


@pytest.mark.slow(but=["0"])
@pytest.mark.parametrize("seed", range(10))
def test_correct_torques_are_never_accused(seed: int) -> None:
    """Gravity, coupling, friction, offsets and 1 % of noise; every sign and place is confirmed."""
    cycles, _ = run(seed)
    found = audited(cycles)
    assert found.findings == ()
    assert [s.name for s in found.signals if not s.decided] == []


@pytest.mark.slow
def test_slow_motion_of_little_size_is_not_accused() -> None:
    """Less is confirmed then, and nothing is made up."""
    cycles, _ = run(3, amplitude=0.08)
    assert audited(cycles).findings == ()


T = [f"j{i} torque" for i in range(1, 8)]
FAULTS: list[tuple[str, Fault, dict[str, str]]] = [
    *((f"inverted {i + 1}", inverted("tau", i), {T[i]: "inverted"}) for i in range(7)),
    *(
        (f"swapped {i + 1} {j + 1}", swapped("tau", i, j), {T[i]: f"swapped with {T[j]}", T[j]: f"swapped with {T[i]}"})
        for i, j in ((1, 5), (2, 3), (4, 5), (5, 6), (0, 6))
    ),
    ("angle of 4", inverted("theta", 3), {"j4 motor angle": "inverted"}),
    ("all inverted", both(*(inverted("tau", i) for i in range(7))), dict.fromkeys(T, "inverted")),
    ("two", both(inverted("tau", 0), swapped("tau", 2, 4)),
     {T[0]: "inverted", T[2]: f"swapped with {T[4]}", T[4]: f"swapped with {T[2]}"}),
]  # fmt: skip


@pytest.mark.slow(but=["inverted 7"])
@pytest.mark.parametrize(("fault", "expected"), [one[1:] for one in FAULTS], ids=[one[0] for one in FAULTS])
def test_wrong_readings_are_named(fault: Fault, expected: dict[str, str]) -> None:
    cycles, _ = run(4)
    assert faults(audited(fault(cycles))) == expected


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.01, 0.625, 1.6, 100.0])
@pytest.mark.parametrize("joint", [0, 2, 3])
def test_a_wrong_gear_ratio_is_named_with_its_value(joint: int, factor: float) -> None:
    cycles, _ = run(5)
    found = audited(scaled("tau", joint, factor)(cycles))
    assert list(faults(found)) == [T[joint]]
    said = found.findings[0].fault
    assert said.startswith("scaled by ")
    assert float(said.removeprefix("scaled by ")) == pytest.approx(factor, rel=0.03)
    said = found.findings[0].remedy.removeprefix("gear_ratio = ").split(" ")[0]
    assert float(said) == pytest.approx(100.0 / factor, rel=0.03)


CONSTANTS = (2.0, 3.0, 0.7, 1.4, 0.3, 5.0, 1.0)
"""Ampere for one Nm of each motor."""


@pytest.mark.slow(but=["as recorded"])
@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (both(), {}),
        (inverted("tau", 1), {T[1]: "inverted"}),
        (swapped("tau", 1, 3), {T[1]: f"swapped with {T[3]}", T[3]: f"swapped with {T[1]}"}),
    ],
    ids=["as recorded", "inverted", "swapped"],
)
def test_the_scales_of_currents_are_no_fault(fault: Fault, expected: dict[str, str]) -> None:
    """Nobody knows the constants of the motors; signs and places are decided nevertheless."""
    cycles, _ = run(4)
    currents = fault(both(*(scaled("tau", i, by) for i, by in enumerate(CONSTANTS)))(cycles))
    joints = tuple(replace(joint, torque_sigma=1.0) for joint in ARM.joints)
    assert faults(audit(replace(ARM, joints=joints, torque_unit="A"), currents)) == expected


@pytest.mark.slow
def test_the_noise_of_torques_is_compared_with_the_declared_one() -> None:
    cycles, sigma = run(6)
    assert faults(audited(cycles, sigma)) == {}
    said = faults(audited(cycles, sigma / 100.0))
    assert any(fault.startswith("noisier than declared by a factor of ") for fault in said.values())
    assert set(faults(audited(cycles, 0.0)).values()) == {"noisy, and no noise is declared"}


def test_a_short_run_decides_nothing() -> None:
    cycles, _ = run(7, duration_s=4.0)
    found = audited(cycles)
    assert found.findings == ()
    assert not found.ok
    assert any("too short for the law of the whole arm" in note for note in found.notes)


@pytest.mark.slow
def test_torques_of_another_run_are_not_explained() -> None:
    """They belong to no joint, so that none is accused and none is confirmed."""
    cycles, _ = run(8)
    other, _ = run(9)
    found = audited(replace(cycles, tau=other.tau))
    assert found.findings == ()
    assert {s.name for s in found.signals if not s.decided} >= {T[0], T[3], T[4], T[5], T[6]}
