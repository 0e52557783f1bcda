# SPDX-License-Identifier: MIT
"""The whole flight chain on arms of any kind: C against numpy room by room, and against the engines that moved them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from arm_support import exact_torques, random_arm
from motion_support import FLEXIBLE, sines
from numpy.typing import NDArray
from runs_support import trajectory_of
from scipy.spatial.transform import Rotation

from zygos.arm import Encoder, load_arm
from zygos.balances.energy import energy_columns
from zygos.balances.state import State
from zygos.model.model import load_model
from zygos.native.flight import Flight, config_of, encode, ffi, lib
from zygos.reference import chain
from zygos.reference.compare import check_frames, tables
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[2] / "examples"

KINDS = list(product((1, 2, 7), ("free", "fixed"), ("spatial", "planar", "planar-symmetric"), FLEXIBLE))


@pytest.mark.slow(but=["2-*-mixed", "2-free-spatial-*", "2-fixed-planar-rigid"])
@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), KINDS)
def test_every_room_is_numpys(joints: int, base: str, kinetic: str, kind: str) -> None:
    """From the frames on, with cantools and autosar-e2e on the other side."""
    flexible = [FLEXIBLE[kind](i) for i in range(joints)]
    arm, _ = random_arm(joints, joints, base, kinetic, flexible)  # type: ignore[arg-type]
    coarse = Encoder(quantum_rad=1e-4)  # coarser than the wire, so that the bandwidth test accepts what the wire rounds
    arm = replace(arm, joints=tuple(replace(j, link_encoder=coarse, motor_encoder=coarse) for j in arm.joints))
    cycles = sines(arm, 400)
    frames = encode(arm, cycles)
    rooms = check_frames(arm, frames)
    assert [room.name for room in rooms if not room.equal] == []
    assert {"wire and cycles", "fault counters", "smoother", "balance"} <= {room.name for room in rooms}
    assert all(room.compared > 0 for room in rooms)

    flight = Flight(arm)
    trace = flight.frames(frames, trace=True)
    assert trace is not None
    a, b = flight.normal_equations()
    noise = flight.noise()
    rows = trace.row[trace.instant & trace.accepted]
    rows = rows - rows.mean(axis=0)
    assert len(rows) > 350
    size = np.linalg.norm(rows, axis=0) + 1e-300
    np.testing.assert_allclose(
        np.column_stack([a + noise[:-1, :-1], b + noise[-1, :-1]]) / np.outer(size[:-1], size),
        rows[:, :-1].T @ rows / np.outer(size[:-1], size),
        atol=1e-12,
    )


@pytest.mark.parametrize(("base", "kinetic"), [("free", "spatial"), ("fixed", "spatial"), ("free", "planar")])
def test_a_rotor_that_turns_with_its_link_has_no_room_of_its_own(base: str, kinetic: str) -> None:
    """That of a rigid joint at gear one, behind a flexible joint and before one; in rows and in their noise."""
    arm, _ = random_arm(3, 3, base, kinetic, [True, False, True])  # type: ignore[arg-type]
    coarse = Encoder(quantum_rad=1e-4)
    joints = [replace(joint, link_encoder=coarse, motor_encoder=coarse) for joint in arm.joints]
    joints[1] = replace(joints[1], gear_ratio=1.0)
    arm = replace(arm, joints=tuple(joints), imu=replace(arm.imu, rate_sigma=5e-3 * arm.free))
    assert "Im2" not in arm.parameter_names
    flight = Flight(arm)
    frames = encode(arm, sines(arm, 400))
    rooms = check_frames(arm, frames, flight)
    assert [room.name for room in rooms if not room.equal] == []
    assert "balance" in {room.name for room in rooms}
    trace = Flight(arm).frames(frames, trace=True)
    assert trace is not None
    samples = calibrate(arm, trace.cycles)
    expected = tables(arm, samples, smooth(arm, samples), ()).used.noise
    size = np.sqrt(np.diag(expected))
    assert (size > 0.0).all()
    np.testing.assert_allclose(flight.noise() / np.outer(size, size), expected / np.outer(size, size), atol=1e-9)


def test_a_rigid_joint_needs_no_link_encoder() -> None:
    """Its drive may leave the link field of the frame invalid; the cycle door does not look at q."""
    arm, _ = random_arm(3, 2, "free", "spatial", [False, True])
    cycles = sines(arm, 300)
    whole = Flight(arm)
    whole.cycles(cycles)
    blind = Flight(arm)
    blind.cycles(replace(cycles, q=np.where([False, True], cycles.q, np.nan)))
    np.testing.assert_array_equal(whole.normal_equations()[0], blind.normal_equations()[0])
    assert blind.counts["invalid"] == 0
    lost = Flight(arm)
    lost.cycles(replace(cycles, q=np.where([True, False], cycles.q, np.nan)))
    assert lost.counts["invalid"] == len(cycles)


@pytest.mark.slow
def test_kinetic_energy_of_an_arm_in_space() -> None:
    """Three joints, moved by Pinocchio's equations at 500 Hz, without noise, through `zygos_arm_cycle`.

    The solution predicts the kinetic energy, also of the two seconds that it has not seen. All parameters have values,
    and those are right by their own sigmas. The intervals contain the steps of torque frames although these torques
    have none, because a configuration cannot say less.
    """
    folder, learn_s = EXAMPLES / "spatial", 22.0
    arm, model = exact_torques(load_arm(folder / "arm.toml")).at_period(0.002), load_model(folder / "model.toml")
    scenario = load_scenario(folder / "scenario.toml")
    arm = replace(arm, compensate_every=0)  # there is no noise
    run = trajectory_of(
        arm, model, scenario, engine="pinocchio", noise=False, duration_s=learn_s + 2.0, rtol=1e-8, atol=1e-10
    )
    learned, cycles = round(learn_s / arm.period_s), run.cycles()
    flight = Flight(arm)
    flight.cycles(Cycles(*(getattr(cycles, name)[:learned] for name in Cycles.__dataclass_fields__)))
    estimate = flight.estimate()
    true = model.base_values(arm)

    at = np.arange(50, len(cycles), 37)
    state = State(run.q[0, at], run.theta[0, at], run.qd[0, at], run.thetad[0, at], run.omega0[0, at])
    columns = energy_columns(arm, state, np.zeros((len(at), arm.n)))
    moving = np.array([name.startswith(("N", "Im")) for name in estimate.names])
    exact, predicted = (columns[:, moving] @ values[moving] for values in (true, estimate.solution))
    error = np.abs(predicted - exact) / exact.max()
    print(f"kinetic energy to {error[at < learned].max():.1e}, {error.max():.1e} beyond")
    assert error[at < learned].max() <= 1e-5
    assert error.max() <= 2e-5

    assert estimate.validity == "valid"
    np.testing.assert_array_equal(estimate.value, estimate.solution)
    assert np.max(np.abs(estimate.value - true) / estimate.sigma) <= 3.0
    reference = chain(arm, Cycles(*(getattr(cycles, name)[:learned] for name in Cycles.__dataclass_fields__)))
    size = np.abs(reference.solution.x)
    tolerance = max(1e-9, 1e-14 * estimate.condition)
    assert np.max(np.abs(estimate.solution - reference.solution.x) / size) <= tolerance


@pytest.mark.parametrize("frame", [[0.0] * 9, [1, 0, 0, 0, 1, 0, 0, 0, -1], [1, 0, 0, 0, 1, 0, 0, 0, float("nan")]])
def test_a_frame_that_is_no_rotation_is_refused(frame: list[float]) -> None:
    arm, _ = random_arm(3, 2, "free", "spatial")
    native, config = ffi.new("zygos_arm_t *"), config_of(arm)
    config.joint[1].frame = frame
    assert lib.zygos_arm_init(native, config) == lib.ZYGOS_E_AXIS


def test_every_rotation_is_a_frame_and_no_reflection_is() -> None:
    arm, _ = random_arm(3, 2, "free", "spatial")
    native, config = ffi.new("zygos_arm_t *"), config_of(arm)
    for rotation in Rotation.random(200, random_state=0).as_matrix():
        config.joint[1].frame = rotation.ravel().tolist()
        assert lib.zygos_arm_init(native, config) == 1
        config.joint[1].frame = (-rotation).ravel().tolist()
        assert lib.zygos_arm_init(native, config) == lib.ZYGOS_E_AXIS
