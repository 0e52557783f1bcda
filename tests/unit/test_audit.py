# SPDX-License-Identifier: MIT
"""The audit of a run against its arm file: what was put in is named, that alone, and nothing where nothing was."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_support import exact_torques
from audit_support import (
    Fault,
    both,
    clipped,
    exchanged,
    inverted,
    late,
    noisy,
    over_the_bus,
    rounded,
    scaled,
    shifted,
    stuck,
    swapped,
    with_column,
)
from runs_support import trajectory_of
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.io import loadmat
from scipy.optimize import minimize_scalar
from scipy.signal import savgol_filter
from scipy.stats import linregress

from conftest import EXAMPLE, ROOT, need
from zygos.accuracy.cases import all_cases, chosen
from zygos.arm import ANGLE_STEP, NO_IMU, Arm, Encoder, Joint, Smoother, load_arm
from zygos.audit import Audit, audit
from zygos.audit.balance import flattened
from zygos.audit.delays import Group
from zygos.audit.delays import shifted as taken_later
from zygos.audit.means import Means, jackknifed
from zygos.audit.readings import grid_step, noise_level, runs_of_equal, white_noise
from zygos.audit.remedies import Kind
from zygos.audit.sections import answer_of
from zygos.can.run import Run, load_run
from zygos.effects import Effect, effect
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native.flight import WINDOW_MAX, Flight
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

GAP = ROOT / "examples" / "gap"
KR300 = Path(ROOT).parent / "shared" / "data" / "kr300" / "run_a.mat"
STEP = 2 * np.pi / 2**20


def run(name: str, arm: Arm, seeds: int, *effects: Effect) -> list[Cycles]:
    """The runs of seeds 0.. of an example, through the bus. "lively", "a" and "b" of the gap example."""
    if name == "lively":
        model, scenario, options = load_model(EXAMPLE / "model.toml"), load_scenario(EXAMPLE / "scenario.toml"), {}
    else:
        model, scenario = load_model(GAP / "cad.toml"), load_scenario(GAP / f"{name}.toml")
        options = {"duration_s": 20.0, "rtol": 1e-9, "atol": 1e-11}
    model = replace(model, effects=model.effects + effects)
    drawn = range(50 if name == "lively" and arm == arm_of(name) else seeds)  # as the fixture `noisy`
    trajectory = trajectory_of(arm, model, scenario, seeds=drawn, noise=True, **options)
    return [over_the_bus(arm, trajectory.cycles(k)) for k in range(seeds)]


def arm_of(name: str) -> Arm:
    return load_arm((EXAMPLE if name == "lively" else GAP) / "arm.toml")


@pytest.fixture(scope="module")
def runs() -> dict[str, tuple[Arm, list[Cycles]]]:
    return {name: (arm_of(name), run(name, arm_of(name), 1)) for name in ("lively", "b")}


def named(found: Audit) -> dict[str, str]:
    """Fault by signal; each signal has one at most."""
    assert len({f.signal for f in found.findings}) == len(found.findings), found.findings
    return {f.signal: f.fault for f in found.findings}


@pytest.mark.slow
@pytest.mark.parametrize(("seeds", "name"), [(2, "lively"), (1, "b"), (1, "a")])
def test_a_clean_run_is_clean(seeds: int, name: str) -> None:
    arm = arm_of(name)
    for cycles in run(name, arm, seeds):
        found = audit(arm, cycles)
        assert found.findings == ()
        assert found.ok
        assert {s.verdict for s in found.signals} == {"ok"}
        assert min(found.laws, key=lambda law: found.laws[law]) == "applied_from_sync"
        for pair in found.pairs:
            assert abs(pair.skew_s) < max(4 * pair.skew_sigma_s, 1e-5)


@pytest.mark.slow
def test_a_smoother_that_flattens_the_motion_is_named_and_the_next_one_is_right() -> None:
    """Fine encoders on a fixed base: what the polynomial takes off the motion is more than is left of the noise."""
    (case,) = chosen(all_cases(ROOT / "examples"), ["fixed"])
    arm = replace(exact_torques(case.arm), smoother=Smoother(21, 4, 10))
    precision = {"rtol": 1e-9, "atol": 1e-11}
    trajectory = trajectory_of(
        case.plant, case.model, case.scenario, seeds=[0], noise=True, duration_s=15.0, **precision
    )
    cycles = over_the_bus(arm, trajectory.cycles(0))
    found = audit(arm, cycles)
    assert named(found) == {"smoother": "of order 4 flattens the motion"}
    assert found.findings[0].remedy == "order = 6 and points = 21 in [smoother], or slower motion"
    better = replace(arm, smoother=Smoother(21, 6, 10))
    assert audit(better, cycles).ok
    hold = []
    for told in (arm, better):
        flight = Flight(told)
        flight.cycles(cycles)
        estimate = flight.estimate()
        hold.append(np.abs(estimate.value - case.model.base_values(arm)) <= estimate.half95)
    assert not hold[0].all() and hold[1].all()


@pytest.mark.slow
def test_a_smoother_is_not_judged_without_values_or_room(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    """Not from too short a run, nor where the library has no room for another one, nor beside a cut-off frequency."""
    arm, (cycles, *_) = runs["lively"]
    short = Cycles(*(getattr(cycles, name)[:60] for name in Cycles.__dataclass_fields__))
    assert flattened(arm, cycles, ()) is not None
    assert flattened(arm, short, ()) is None
    assert flattened(replace(arm, smoother=Smoother(WINDOW_MAX, WINDOW_MAX - 3, WINDOW_MAX // 2)), cycles, ()) is None
    assert flattened(replace(arm, smoother=replace(arm.smoother, cutoff_hz=3.0)), cycles, ()) is None


Q1, Q2 = "shoulder link angle", "elbow link angle"
M1, M2 = "shoulder motor angle", "elbow motor angle"
T1, T2 = "shoulder torque", "elbow torque"
SIGNALS = (
    (Q1, "q", 0), (Q2, "q", 1), (M1, "theta", 0), (M2, "theta", 1), (T1, "tau", 0), (T2, "tau", 1),
    ("gyro z", "omega", 2),
)  # fmt: skip
FAULTS: list[tuple[str, Fault, dict[str, str]]] = [
    *(
        (f"{signal} inverted", inverted(kind, i), {signal: "inverted"})
        for signal, kind, i in SIGNALS
    ),
    *(
        (f"{signal} stuck", stuck(kind, i, start, stop), {signal: "stuck"})
        for signal, kind, i in SIGNALS
        for start, stop in ((0.4, 1.0), (0.4, 0.5))
    ),
    *(
        (f"{signal} dead", scaled(kind, i, 0.0), {signal: "stuck"})
        for signal, kind, i in ((Q1, "q", 0), (M2, "theta", 1), (T2, "tau", 1), ("gyro z", "omega", 2))
    ),
    *(
        (f"{signal} clipped", clipped(kind, i, 0.6), {signal: "saturated"})
        for signal, kind, i in ((Q1, "q", 0), (M1, "theta", 0), (T1, "tau", 0), (T2, "tau", 1), ("gyro z", "omega", 2))
    ),
    ("links swapped", swapped("q", 0, 1), {Q1: f"swapped with {Q2}", Q2: f"swapped with {Q1}"}),
    ("motors swapped", swapped("theta", 0, 1), {M1: f"swapped with {M2}", M2: f"swapped with {M1}"}),
    ("torques swapped", swapped("tau", 0, 1), {T1: f"swapped with {T2}", T2: f"swapped with {T1}"}),
    ("encoders of joint 1", exchanged(0), {Q1: f"swapped with {M1}", M1: f"swapped with {Q1}"}),
    ("encoders of joint 2", exchanged(1), {Q2: f"swapped with {M2}", M2: f"swapped with {Q2}"}),
    ("gyro axes", swapped("omega", 1, 2), {"gyro y": "swapped with gyro z", "gyro z": "swapped with gyro y"}),
    (
        "joint 2 turned",
        both(inverted("q", 1), inverted("theta", 1), inverted("tau", 1)),
        dict.fromkeys((Q2, M2, T2), "inverted, as all signals of the joint"),
    ),
    (
        "joints swapped",
        both(swapped("q", 0, 1), swapped("theta", 0, 1), swapped("tau", 0, 1)),
        dict.fromkeys((Q1, M1, T1), "swapped with elbow's, as all signals of the joint")
        | dict.fromkeys((Q2, M2, T2), "swapped with shoulder's, as all signals of the joint"),
    ),
    ("two at once", both(inverted("q", 0), inverted("tau", 1)), {Q1: "inverted", T2: "inverted"}),
]  # fmt: skip


QUICK_FAULTS = (
    "b-elbow torque dead", "b-shoulder link angle clipped", "b-encoders of joint 1",
)  # fmt: skip
LARGER_ARM = (*QUICK_FAULTS, "b-joints swapped", "b-gyro axes")
PLACED = [
    (f"{name}-{title}", name, fault, expected)
    for name in ("lively", "b")
    for title, fault, expected in FAULTS
    if name == "lively" or f"b-{title}" in LARGER_ARM
]
"""All faults of one arm, and some of the other, which is larger."""


@pytest.mark.slow(but=QUICK_FAULTS)
@pytest.mark.parametrize(("name", "fault", "expected"), [case[1:] for case in PLACED], ids=[case[0] for case in PLACED])
def test_a_fault_is_named_and_nothing_else(
    runs: dict[str, tuple[Arm, list[Cycles]]], name: str, fault: Fault, expected: dict[str, str]
) -> None:
    arm, clean = runs[name]
    for cycles in clean:
        found = audit(arm, fault(cycles))
        assert named(found) == expected
        assert not found.ok


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["q", "theta"])
@pytest.mark.parametrize(("i", "power"), [(0, 1), (1, -1)])
def test_a_gear_ratio_too_many_is_named(
    runs: dict[str, tuple[Arm, list[Cycles]]], kind: str, i: int, power: int
) -> None:
    """Which of the two angles it is, their noise tells; the example's is far above the wire's steps."""
    arm, clean = runs["lively"]
    signal = {"q": (Q1, Q2), "theta": (M1, M2)}[kind][i]
    for cycles in clean:
        found = named(audit(arm, scaled(kind, i, 50.0**power)(cycles)))
        assert found == {signal: f"scaled by {50.0**power:.4g}"}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "i", "sign"), [("q", 0, 1), ("theta", 1, -1)])
@pytest.mark.parametrize("name", ["lively", "b"])
def test_a_zero_that_is_off_is_named_with_its_value(
    runs: dict[str, tuple[Arm, list[Cycles]]], name: str, kind: str, i: int, sign: int
) -> None:
    arm, clean = runs[name]
    for cycles in clean:
        found = audit(arm, shifted(kind, i, 0.03)(cycles))
        assert [f.signal for f in found.findings] == [(Q1, Q2)[i]]
        assert found.findings[0].fault.startswith("zero off by")
        pair = found.pairs[i]
        assert abs(-pair.zero_rad - 0.03 * sign) < 5 * pair.zero_sigma_rad + 0.001


@pytest.mark.slow
def test_other_steps_than_declared_are_named(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    for name, counts in (("lively", 1024), ("b", 65536)):
        arm, clean = runs[name]
        for cycles in clean:
            found = audit(arm, rounded("q", 0, 2 * np.pi / counts)(cycles))
            assert [(f.signal, f.fault.split(",")[0]) for f in found.findings] == [
                (Q1, f"moves in steps of 2π/{counts}")
            ]
            assert found.signals[0].step == pytest.approx(2 * np.pi / counts, rel=1e-5)


@pytest.mark.slow
def test_a_declared_quantum_with_the_noise_of_interpolation_is_no_fault(
    runs: dict[str, tuple[Arm, list[Cycles]]],
) -> None:
    """Readings in steps of an encoder, with a declared noise that is larger than that of the steps, as of a conversion.
    A quantum that is far too large is named."""
    arm, clean = runs["b"]
    step = 2.0 * np.pi / 65536
    for factor, fault in ((1.05, ""), (1.4, ""), (8.0, "moves in steps of 2π/65536")):
        encoder = replace(arm.joints[0].link_encoder, quantum_rad=factor * step, counts=None)
        known = replace(arm, joints=(replace(arm.joints[0], link_encoder=encoder), *arm.joints[1:]))
        for cycles in clean:
            found = named(audit(known, rounded("q", 0, step)(cycles)))
            assert found.get(Q1, "").split(",")[0] == fault


@pytest.mark.slow
def test_noise_above_the_declared_is_named(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, clean = runs["b"]
    sigma = arm.joints[0].link_encoder.sigma_rad
    for cycles in clean:
        said = named(audit(arm, noisy("theta", 1, 12 * sigma)(cycles)))[M2]
        factor = float(said.removeprefix("noisier than declared by a factor of "))
        assert factor == pytest.approx(12 * sigma / np.hypot(sigma, ANGLE_STEP / np.sqrt(12)), rel=0.1)
        assert audit(arm, noisy("theta", 1, 1.5 * sigma)(cycles)).ok
        worse = audit(arm, both(noisy("theta", 1, 12 * sigma), inverted("tau", 0))(cycles))
        assert [one.fault.split(" ")[0] for one in worse.findings] == ["inverted", "noisier"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "latch_us", "i", "side"),
    [("lively", 20_000, 0, "link"), ("lively", 20_000, 1, "motor"), ("b", 3000, 1, "motor")],
)
def test_a_latch_that_the_arm_file_hides_is_named(name: str, latch_us: int, i: int, side: str) -> None:
    arm = arm_of(name)
    true = late(arm, i, f"{side}_encoder", latch_us)
    for cycles in run(name, true, 1):
        found = audit(arm, cycles)
        signal = {"link": (Q1, Q2), "motor": (M1, M2)}[side][i]
        assert [f.signal for f in found.findings] == [signal]
        assert found.findings[0].fault.startswith("skewed")
        pair = found.pairs[i]
        assert abs(pair.skew_s - (1 if side == "motor" else -1) * 1e-6 * latch_us) < 4 * pair.skew_sigma_s + 2e-5
        assert audit(true, cycles).ok


FRICTION = {
    "coulomb": (effect("motor_coulomb", "shoulder", 0.5), effect("motor_coulomb", "elbow", 0.3)),
    "viscous": (effect("motor_viscous", "shoulder", 0.02), effect("motor_viscous", "elbow", 0.05)),
    "link": (effect("link_coulomb", "elbow", 5.0),),
    "lag": (effect("torque_lag", "elbow", 0.001),),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "key"), [("b", key) for key in FRICTION if key != "viscous"] + [("a", "viscous")])
def test_what_an_arm_may_do_is_no_fault_of_a_signal(name: str, key: str) -> None:
    """Viscous friction of a motor looks like a newer link encoder; the balance of the whole arm tells."""
    arm = arm_of(name)
    (cycles,) = run(name, arm, 1, *FRICTION[key])
    found = audit(arm, cycles)
    assert found.findings == ()
    assert any("viscous friction" in text for text in found.remarks) == (key == "viscous")
    assert named(audit(arm, inverted("tau", 1)(cycles))) == {T2: "inverted"}


@pytest.mark.slow
def test_another_torque_law_is_named() -> None:
    arm = arm_of("lively")
    true = replace(arm, torque_law="applied_previous_cycle")
    for cycles in run("lively", true, 2):
        found = audit(arm, cycles)
        assert named(found) == {"torques": "not applied_from_sync"}
        assert 'torque_law = "applied_previous_cycle"' in found.findings[0].remedy
        assert audit(true, cycles).ok
        assert named(audit(replace(arm, torque_law="sampled"), cycles)) in ({}, {"torques": "not sampled"})


@pytest.mark.slow
def test_signs_and_zeros_of_the_arm_file_count(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, clean = runs["b"]
    joints = list(arm.joints)
    joints[0] = replace(joints[0], link_encoder=replace(joints[0].link_encoder, sign=-1, zero_rad=0.2))
    turned = replace(arm, joints=tuple(joints))
    as_it_says = both(inverted("q", 0), shifted("q", 0, 0.2))(clean[0])
    assert audit(turned, as_it_says).ok
    found = audit(turned, shifted("q", 0, 0.2)(clean[0]))
    first = found.findings[0]
    assert (first.signal, first.fault) == (Q1, "inverted")
    assert "sign = 1" in first.remedy


# --------------------------------------------------------------------------------------- the common mistakes first

CASES = Path(ROOT).parent / "shared" / "cases"
WRAPS = "link_angle_wraps_pi_check_arm_accuses_gear.npz"


def test_wraps_are_named_and_no_gear_is_accused() -> None:
    """An angle of a sine in ±π leaves its range three times; all else of the run is right."""
    need((CASES / WRAPS).is_file(), f"the run {WRAPS}")
    run_of_case = load_run(CASES / WRAPS, CASES / "paper_arm.toml")
    found = audit(run_of_case.arm, run_of_case.cycles)
    assert named(found) == {Q2: "wraps 3 times at ±π"}
    jumps = np.flatnonzero(np.abs(np.diff(run_of_case.q[:, 1])) > np.pi) + 1
    assert f"before cycle {jumps[0]}" in found.findings[0].evidence and len(jumps) == 3


@pytest.mark.slow
def test_samples_that_no_arm_makes_are_named_and_nothing_else(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, (first, *_) = runs["lively"]
    q, tau = first.q.copy(), first.tau.copy()
    q[[300, 700], 1] += 1.0
    tau[[400, 800, 801], 0] = -9999.0
    found = audit(arm, replace(first, q=q, tau=tau))
    assert named(found) == {Q2: "has 2 samples that no arm makes", T1: "has 3 samples that no arm makes"}
    assert all("`zygos convert RUN --arm ARM.toml -o NEW`" in finding.remedy for finding in found.findings)


@pytest.mark.slow(but=["q-*"])
@pytest.mark.parametrize(
    ("kind", "unit", "factor"),
    [("theta", "deg", 180.0 / np.pi), ("q", "counts", 1.0 / 0.003), ("theta", "turn", 0.5 / np.pi)],
)
def test_an_angle_in_another_unit(
    runs: dict[str, tuple[Arm, list[Cycles]]], kind: str, unit: str, factor: float
) -> None:
    arm, clean = runs["lively"]
    assert arm.joints[0].link_encoder.quantum_rad == 0.003
    found = named(audit(arm, scaled(kind, 0, factor)(clean[0])))
    assert list(found) == [{"q": Q1, "theta": M1}[kind]]
    assert next(iter(found.values())).startswith(f"in {unit}, not in rad")


@pytest.mark.slow
def test_counts_that_are_not_the_declared_ones_accuse_no_other_angle(
    runs: dict[str, tuple[Arm, list[Cycles]]],
) -> None:
    arm, clean = runs["lively"]
    found = audit(arm, rounded("theta", 0, 1.0)(scaled("theta", 0, 2**16 / (2 * np.pi))(clean[0])))
    assert not any(one.fault.startswith(("scaled", "in turn")) for one in found.findings if one.signal != M1)
    assert named(found)[M1].startswith("in counts")


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 180.0 / np.pi), ("rpm", 30.0 / np.pi), ("mrad/s", 1e3)])
def test_a_gyro_in_another_unit_is_not_turned(
    runs: dict[str, tuple[Arm, list[Cycles]]], unit: str, factor: float
) -> None:
    """A gyro whose readings are too large is explained a little better by axes that do not move."""
    arm, clean = runs["lively"]
    found = named(audit(arm, both(*(scaled("omega", i, factor) for i in range(3)))(clean[0])))
    assert list(found) == ["gyro x", "gyro y", "gyro z"]
    assert all(fault.startswith(f"in {unit}, not in rad/s") for fault in found.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "columns", "periods"),
    [("tau", (0, 1), 2.0), ("tau", (0,), 1.5), ("omega", (0, 1, 2), 3.3), ("q", (0, 1), 1.4), ("theta", (0,), 1.2),
     ("q", (0, 1), -3.0), ("tau", (0, 1), -0.7)],
)  # fmt: skip
def test_a_delay_is_found_within_its_interval(
    runs: dict[str, tuple[Arm, list[Cycles]]], kind: Kind, columns: tuple[int, ...], periods: float
) -> None:
    arm, clean = runs["b"]
    moved = taken_later(clean[0], Group(kind, columns), -periods)
    found = audit(arm, Cycles(*(getattr(moved, name)[10:-10] for name in Cycles.__dataclass_fields__)))
    (finding,) = found.findings
    said = re.fullmatch(r"(late|early) by ([\d.]+) ms ± ([\d.e+-]+)", finding.fault)
    assert said is not None and said[1] == ("late" if periods > 0.0 else "early")
    late_ms, sigma_ms = float(said[2]), float(said[3])
    assert abs(late_ms - 1e3 * arm.period_s * abs(periods)) < 4.0 * sigma_ms + 0.05
    assert {one.key for one in finding.settings} == {"delay_s"}


@pytest.mark.slow
def test_both_angles_that_are_late_are_no_early_torques(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    """The gyro decides."""
    arm, clean = runs["b"]
    moved = taken_later(clean[0], Group("theta", (0, 1), both=True), -4.0)
    (finding,) = audit(arm, Cycles(*(getattr(moved, name)[10:-10] for name in Cycles.__dataclass_fields__))).findings
    said = re.fullmatch(r"late by ([\d.]+) ms ± ([\d.e+-]+)", finding.fault)
    assert finding.signal == "angles" and said is not None
    assert abs(float(said[1]) - 20.0) < 4.0 * float(said[2])
    assert {one.table[2] for one in finding.settings} == {"motor", "link"} and len(finding.settings) == 4


@pytest.mark.slow
def test_vibration_is_no_noise_and_noise_of_the_gyro_is(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    """Content of 30 to 45 Hz in both encoders of a joint, 50 times their noise; and a gyro with three times its own."""
    arm, clean = runs["b"]
    t = arm.period_s * np.arange(len(clean[0]))
    sigma = arm.joints[0].link_encoder.sigma_rad
    shakes = 50.0 * sigma * sum(np.sin(2 * np.pi * f * t + f) for f in np.arange(30.0, 45.0, 1.7))
    shaken = both(*(lambda c, k=k: with_column(c, k, 0, getattr(c, k)[:, 0] + shakes) for k in ("q", "theta")))(
        clean[0]
    )  # type: ignore[misc]
    assert noise_level(shaken.q[:, 0], [(0, len(t))]) > 10.0 * sigma
    assert not [f for f in audit(arm, shaken).findings if f.fault.startswith("noisier")]
    loud = both(*(noisy("omega", i, np.sqrt(8.0) * arm.imu.rate_sigma) for i in range(3)))(clean[0])
    assert [f.signal for f in audit(arm, loud).findings] == ["gyro x", "gyro y", "gyro z"]


def test_white_noise_is_that_of_the_band_with_least() -> None:
    t = np.arange(4000)
    for seed in range(3):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(len(t))
        motion = np.sin(0.01 * t) + 0.05 * np.sin(1.1 * t)
        assert white_noise(motion + noise, [(0, len(t))]) == pytest.approx(1e-3, rel=0.15)
        assert noise_level(motion + noise, [(0, len(t))]) > 3e-3


def test_a_fast_motion_in_some_parts_of_a_run_is_no_noise() -> None:
    """Also where the run has many gaps, so that a part has few spans of the spectrum."""
    t = np.arange(2000)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    jolt = np.where(t % 1000 < 500, 0.3 * np.random.default_rng(1).standard_normal(len(t)), 0.0)
    for length in (100, 250, 2000):
        assert white_noise(noise + jolt, [(a, a + length) for a in range(0, 2000, length)]) < 2e-3


@pytest.mark.slow
def test_the_headline_says_what_is_open(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    """A law that the run does not decide is in the headline, and the answer is not green; no signal is in doubt."""
    arm, clean = runs["b"]
    answer = answer_of(Run(arm, table=clean[0]), audit(arm, clean[0]))
    assert (answer.verdict, answer.tone) == ("confirmed", "good")
    found = replace(audit(arm, clean[0]), notes=("torque_law: not decided (…)",))
    answer = answer_of(Run(arm, table=clean[0]), found)
    assert found.ok and answer.tone == "open"
    assert answer.sentence == "signs and places of the signals are confirmed, but not decided: torque_law"


def test_what_does_not_move_is_not_decided(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, clean = runs["b"]
    cycles = clean[0]
    still = replace(cycles, q=0 * cycles.q + 0.3, theta=0 * cycles.theta + 0.3)
    found = audit(arm, still)
    assert not found.ok
    assert {s.verdict for s in found.signals if "angle" in s.name} == {"not decidable"}
    assert any("does not move" in note for note in found.notes)


def test_a_short_run_is_not_decided(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, clean = runs["lively"]
    short = Cycles(*(getattr(clean[0], name)[:20] for name in Cycles.__dataclass_fields__))
    found = audit(arm, short)
    assert found.findings == ()
    assert not found.ok


def test_another_number_of_joints_is_refused(runs: dict[str, tuple[Arm, list[Cycles]]]) -> None:
    arm, clean = runs["lively"]
    with pytest.raises(ZygosError, match="2 joints, arm lively has 1"):
        audit(replace(arm, joints=arm.joints[:1]), clean[0])


@pytest.mark.slow
def test_the_sign_of_a_rigid_joints_torque_under_gravity() -> None:
    """A pendulum that SciPy swings; 0.2 Nm of friction."""
    h, n = 0.004, 5000
    encoder = Encoder(2 * np.pi / 2**18)
    joint = Joint("arm", 1, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 10.0, encoder, encoder, flexible=False)
    arm = Arm(
        "p", "fixed", "planar", h, "applied_from_sync", "rotor", (joint,), NO_IMU, gravity=(0.0, 0.0, -9.81)
    )  # fmt: skip
    t = h * np.arange(n)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        amplitude, omega, phase = rng.uniform(0.5, 2.0, 3), rng.uniform(0.5, 6.0, 3), rng.uniform(0, 6, 3)

        def torque(at: float, a=amplitude, w=omega, p=phase) -> float:  # type: ignore[no-untyped-def]
            return float(np.sum(a * np.sin(w * at + p)))

        def swing(at: float, y: np.ndarray, torque: Callable[[float], float] = torque) -> list[float]:  # type: ignore[type-arg]
            return [y[1], (10 * torque(h * np.floor(at / h)) - 2 * np.tanh(100 * y[1]) - 20 * np.sin(y[0])) / 3.0]

        y = solve_ivp(swing, (0, t[-1]), [0.1, 0.0], t_eval=t, max_step=h, rtol=1e-6).y[0]
        q = encoder.quantum_rad * np.rint(y / encoder.quantum_rad)[:, None]
        tau = np.array([[torque(at)] for at in t])
        cycles = Cycles(np.arange(n, dtype=np.uint64), q, q.copy(), tau, np.zeros((n, 3)), np.zeros(n, dtype=np.uint32))
        found = audit(arm, cycles)
        assert found.findings == ()
        assert found.ok
        assert named(audit(arm, inverted("tau", 0)(cycles))) == {"arm torque": "inverted"}


# ------------------------------------------------------------------------------------------- a measured table


@pytest.fixture(scope="module")
def robot() -> tuple[Arm, Cycles]:
    """Axes 1 to 3 of a KUKA KR300; the encoders' quanta are those of their noise."""
    need(KR300.is_file(), f"the measured run of a KUKA KR300, {KR300.name}")
    record = loadmat(KR300, squeeze_me=True, struct_as_record=False)["rec"]
    q, theta = np.deg2rad(record.act_pos_se_deg[:3].T), np.deg2rad(record.act_pos_mot_deg[:3].T)
    n = len(q)
    quanta = [[np.sqrt(12) * noise_level(x[:, i], [(0, n)]) for i in range(3)] for x in (q, theta)]
    ratios = (256.8571, 267.4286, 252.3333)
    axes = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    joints = tuple(
        Joint(
            f"a{i + 1}",
            i + 1,
            axes[i],
            (0.0, 0.0, 0.0),
            ratios[i],
            Encoder(quanta[0][i]),
            Encoder(quanta[1][i]),
            torque_sigma=noise_level(record.act_torque_abs_nm[i], [(0, n)]),
        )
        for i in range(3)
    )
    arm = Arm("kr300", "fixed", "spatial", 0.004, "sampled", "rotor", joints, NO_IMU, gravity=(0.0, 0.0, -9.81))
    tau = record.act_torque_abs_nm[:3].T.copy()
    return arm, Cycles(np.arange(n, dtype=np.uint64), q, theta, tau, np.zeros((n, 3)), np.zeros(n, dtype=np.uint32))


def shift_of_best_correlation(late: np.ndarray, early: np.ndarray, h: float) -> float:  # type: ignore[type-arg]
    """By how many seconds `late` comes after `early`: a spline through the smoothed rates, moved until they agree."""
    rates = [savgol_filter(x, 31, 3, deriv=1, delta=h) for x in (late, early)]
    t = h * np.arange(len(late))
    spline = CubicSpline(t, rates[1])
    inner = slice(50, -50)

    def unlike(delay: float) -> float:
        return -float(np.corrcoef(rates[0][inner], spline(t[inner] - delay))[0, 1])

    return float(minimize_scalar(unlike, bounds=(-0.02, 0.02), method="bounded", options={"xatol": 1e-7}).x)


@pytest.mark.slow
def test_the_encoders_of_a_measured_robot_are_skewed_by_3_ms(robot: tuple[Arm, Cycles]) -> None:
    arm, cycles = robot
    found = audit(arm, cycles)
    skewed = {f.signal for f in found.findings if f.fault.startswith("skewed")}
    assert skewed == {f"a{i} motor angle" for i in (1, 2, 3)}
    others = [f for f in found.findings if not f.fault.startswith(("skewed", "zero off"))]
    assert others == []
    for i, pair in enumerate(found.pairs):
        assert pair.stiff
        assert pair.skew_s == pytest.approx(0.003, abs=0.0002)
        assert 2e-5 < pair.skew_sigma_s < 3e-4
        independent = shift_of_best_correlation(cycles.q[:, i], cycles.theta[:, i], arm.period_s)
        assert abs(pair.skew_s - independent) < 3 * pair.skew_sigma_s
    # The difference holds 3 ms of rate: what it says of the stiffness is false by a factor, where it says anything.
    third = found.pairs[2]
    assert third.stiffness_unskewed > 4e6
    assert not third.stiffness > 0.5 * third.stiffness_unskewed


def test_the_remedy_takes_the_skew_away(robot: tuple[Arm, Cycles]) -> None:
    arm, cycles = robot
    latched = arm
    for i, pair in enumerate(audit(arm, cycles).pairs):
        latched = late(latched, i, "motor_encoder", round(1e6 * pair.skew_s))
    found = audit(latched, cycles)
    assert not [f for f in found.findings if f.fault.startswith("skewed")]
    assert max(abs(pair.skew_s) for pair in found.pairs) < 1e-4


def stiff_swap(kind: str, what: str, i: int, j: int) -> tuple[str, Fault, dict[str, str]]:
    first, second = f"a{i + 1} {what}", f"a{j + 1} {what}"
    return f"{first}, {second}", swapped(kind, i, j), {first: f"swapped with {second}", second: f"swapped with {first}"}


KINDS = (("q", "link angle"), ("theta", "motor angle"), ("tau", "torque"))
STIFF_FAULTS: list[tuple[str, Fault, dict[str, str]]] = [
    *(
        (f"a{i + 1} {what}", inverted(kind, i), {f"a{i + 1} {what}": "inverted"})
        for kind, what in KINDS
        for i in range(3)
    ),
    *(stiff_swap(kind, what, *pair) for kind, what in KINDS for pair in ((0, 1), (0, 2), (1, 2))),
    ("stuck", stuck("q", 1, 0.4, 0.6), {"a2 link angle": "stuck"}),
]


@pytest.mark.slow(but=["a2 torque", "a1 link*, a3 *", "stuck"])
@pytest.mark.parametrize(("fault", "expected"), [f[1:] for f in STIFF_FAULTS], ids=[f[0] for f in STIFF_FAULTS])
def test_faults_of_stiff_joints_with_friction_and_weight(
    robot: tuple[Arm, Cycles], fault: Fault, expected: dict[str, str]
) -> None:
    arm, cycles = robot
    found = audit(arm, fault(cycles))
    assert {f.signal: f.fault for f in found.findings if not f.fault.startswith(("skewed", "zero off"))} == expected


def test_a_scale_of_a_stiff_joint(robot: tuple[Arm, Cycles]) -> None:
    """Where the noise does not tell which of the two angles it is, both are named."""
    arm, cycles = robot
    for factor in (256.8571, 2.0):
        found = audit(arm, scaled("q", 0, factor)(cycles))
        (said,) = (f for f in found.findings if "scaled" in f.fault)
        scale = float(said.fault.split()[-1])
        if factor > 100:
            assert said.signal == "a1 link angle"
            assert scale == pytest.approx(factor, rel=0.002)
        else:
            assert max(scale, 1 / scale) == pytest.approx(factor, rel=0.002)
            assert "angle scaled would explain it equally well" in said.evidence


# --------------------------------------------------------------------------------------------------- the parts


def test_the_window_gives_rates_where_the_readings_were_taken(arm: Arm) -> None:
    """A reading that is latched late is of a later instant."""
    h, n = arm.period_s, 2000
    t, omega = h * np.arange(n), 0.3
    latch = 0.013
    cycles = Cycles(
        sync=np.arange(n, dtype=np.uint64),
        q=np.tile(np.sin(omega * (t + latch))[:, None], 2),
        theta=np.tile(np.sin(omega * t)[:, None], 2),
        tau=np.zeros((n, 2)),
        omega=np.zeros((n, 3)),
        flags=np.zeros(n, dtype=np.uint32),
    )
    means = Means(late(late(arm, 0, "link_encoder", 13_000), 1, "link_encoder", 13_000), cycles)
    for derivative in range(3):
        np.testing.assert_allclose(means.q[0][derivative], means.theta[0][derivative], atol=4e-5)
    np.testing.assert_allclose(means.theta[0][2], -(omega**2) * means.theta[0][0], atol=4e-5)
    assert np.std(means.theta[0][1]) == pytest.approx(omega * np.std(means.theta[0][0]), rel=0.02)


def test_the_jackknifes_error_is_that_of_independent_rows() -> None:
    errors, expected = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x, noise = rng.standard_normal((2, 400))
        value, sigma = jackknifed([np.ones(400), x], 2.0 + 3.0 * x + noise)
        fit = linregress(x, 2.0 + 3.0 * x + noise)
        assert value[1] == pytest.approx(fit.slope, rel=1e-9)
        errors.append(sigma[1])
        expected.append(fit.stderr)
    assert np.mean(errors) == pytest.approx(np.mean(expected), rel=0.15)


def test_the_grid_of_readings() -> None:
    rng = np.random.default_rng(0)
    smooth = np.cumsum(rng.standard_normal(3000)) * 0.01
    for counts in (2000, 4096, 60_000):
        step = 2 * np.pi / counts
        wired = STEP * np.rint(step * np.rint(smooth / step) / STEP)
        assert grid_step(wired, [(0, 3000)], STEP) == pytest.approx(step, rel=1e-5)
    assert np.isnan(grid_step(smooth, [(0, 3000)], STEP))
    assert np.isnan(grid_step(STEP * np.rint(smooth / STEP), [(0, 3000)], STEP))


def test_equal_means_are_equal() -> None:
    """A mean of equal readings is not bit for bit what its neighbour is."""
    x = np.concatenate([np.sin(np.arange(30.0)), np.full(40, 0.4), np.sin(np.arange(30.0))])
    x[31:70:2] *= 1.0 + 1e-15
    assert runs_of_equal(x, [(0, 100)], 20) == [(30, 70)]


def test_noise_and_flat_stretches() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(5000)
    assert noise_level(np.sin(0.01 * t) + 1e-3 * rng.standard_normal(5000), [(0, 5000)]) == pytest.approx(
        1e-3, rel=0.05
    )
    readings = np.array([1.0, 2, 2, 2, 3, 3, 4, 4, 4, 4])
    assert runs_of_equal(readings, [(0, 10)], 3) == [(1, 4), (6, 10)]
    assert runs_of_equal(readings, [(0, 3), (3, 10)], 3) == [(6, 10)]
