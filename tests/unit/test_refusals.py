# SPDX-License-Identifier: MIT
"""A refusal names the cause that was measured: rank, motion, noise, an unexplained residual, timing, or no frames."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from audit_support import inverted, swapped
from gap_support import example
from scipy.io import loadmat

from conftest import EXAMPLE, ROOT, need
from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother, load_arm
from zygos.audit import Audit, audit
from zygos.can import bus
from zygos.cli import main
from zygos.effects import CATALOGUE
from zygos.errors import ZygosError
from zygos.estimation.remedies import Known, measured, remedy
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_change, about_noise
from zygos.files.tables import write_columns
from zygos.gap import sentences
from zygos.gap.balances import Layout
from zygos.gap.findings import Finding, Significance
from zygos.gap.record import read_measured_run
from zygos.gap.whereabouts import whereabouts
from zygos.native.flight import REASONS, Estimate, Flight, lib
from zygos.runs.cycles import Cycles
from zygos.runs.tables import read_cycles
from zygos.telemetry.grid import needed_rate, tracks
from zygos.telemetry.map import load_map, read_table

DATA = ROOT.parent / "shared" / "data"
PENDULUM, KR300, VEHICLE = (
    DATA / "dfki-double-pendulum",
    DATA / "kr300" / "run_a.mat",
    DATA / "foreign-can" / "savvycan-candump.log",
)
UNEXPLAINED, NOT_IDENTIFIABLE = REASONS[lib.ZYGOS_REASON_UNEXPLAINED], REASONS[lib.ZYGOS_REASON_NOT_IDENTIFIABLE]


def table(arm: Arm, q: np.ndarray, tau: np.ndarray) -> Cycles:  # type: ignore[type-arg]
    n = len(q)
    return Cycles(np.arange(n, dtype=np.uint64), q, q.copy(), tau, np.zeros((n, 3)), np.zeros(n, dtype=np.uint32))


# ------------------------------------------------------------------------------------------ one rigid joint


@pytest.fixture
def lever() -> Arm:
    """One rigid joint whose motor turns an inertia: one parameter, a11 = 3 kg m^2."""
    encoder = Encoder(2 * np.pi / 2**18)
    joint = Joint("arm", 1, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 10.0, encoder, encoder, flexible=False)
    return Arm("lever", "fixed", "planar", 0.004, "sampled", "rotor", (joint,), NO_IMU, arc_max_s=10.0)


def swung(arm: Arm, *parts: tuple[float, float, int], speed: float = 1.0, noise: float = 0.0) -> Cycles:
    """Parts (inertia kg m^2, Coulomb friction Nm, cycles), all of the same motion."""
    q, tau = [], []
    for inertia, friction, n in parts:
        t = arm.period_s * np.arange(n)
        waves = [(0.8, 1.3 * speed), (0.3, 3.1 * speed)]
        rate = sum(a * w * np.cos(w * t) for a, w in waves)
        torque = -inertia * sum(a * w**2 * np.sin(w * t) for a, w in waves) + friction * np.tanh(50.0 * rate)
        q.append(sum(a * np.sin(w * t) for a, w in waves))
        tau.append(torque / arm.joints[0].gear_ratio)
    quantum = arm.joints[0].motor_encoder.quantum_rad
    angle = np.concatenate(q) + noise * np.random.default_rng(0).normal(size=sum(map(len, q)))
    run = table(arm, quantum * np.rint(angle / quantum)[:, None], np.concatenate(tau)[:, None])
    sync = run.sync.copy()
    for start in np.cumsum([len(part) for part in q])[:-1]:
        sync[start:] += np.uint64(50)
    return replace(run, sync=sync)


def learned(arm: Arm, cycles: Cycles) -> tuple[Estimate, Watch]:
    watch = Watch(Flight(arm))
    watch.cycles(cycles)
    watch.look()
    return watch.flight.estimate(), watch


def test_friction_of_a_joint_that_moves_is_unexplained_and_no_lack_of_motion(lever: Arm) -> None:
    """Rank 1 of 1: the motion excites everything there is."""
    clean, _ = learned(lever, swung(lever, (3.0, 0.0, 20_000)))
    assert clean.validity == "valid"
    found, watch = learned(lever, swung(lever, (3.0, 3.0, 20_000)))
    assert (found.validity, found.reason, found.rank) == ("refused", UNEXPLAINED, 1)
    assert "excite" not in found.reason and "determine" not in found.reason
    said = measured(found, watch.flight)
    assert re.match(r"\d[\d.]* % of the variance of the work is unexplained, rank 1 of 1$", said)
    share = watch.flight.unexplained(found)
    assert 0.1 < share <= 1.0 + 1e-9
    helps = remedy(found, watch.flight, watch.known)
    assert "friction" in helps and "check-arm" in helps
    assert "longer run" not in helps and "moves every joint" not in helps
    # nothing has an interval that could hold anything
    assert "interval" not in about_noise(found)


def test_an_arm_at_rest_is_still_a_lack_of_motion(lever: Arm) -> None:
    sigma = lever.joints[0].motor_encoder.sigma_rad
    still = swung(lever, (3.0, 0.0, 20_000), noise=4.0 * sigma)
    q = 0.3 + still.q - swung(lever, (3.0, 0.0, 20_000)).q
    found, watch = learned(lever, replace(still, q=q, theta=q, tau=np.full_like(still.tau, 0.3)))
    assert found.validity == "refused"
    assert found.reason != UNEXPLAINED
    assert "friction" not in remedy(found, watch.flight, watch.known)


def test_a_payload_is_a_change_and_friction_that_comes_up_is_not(lever: Arm) -> None:
    # changes are looked for in the rows of the energy
    lever = replace(lever, joint_increment_s=0.0)
    _, payload = learned(lever, swung(lever, (3.0, 0.0, 15_000), (4.0, 0.0, 10_000)))
    found = payload.look()
    assert found is not None and found.changed == ("a11",) and found.reason == ""
    assert about_change(payload.flight.estimate(), found, lever).startswith("the arm changed after 60 s")
    _, friction = learned(lever, swung(lever, (3.0, 0.0, 15_000), (3.0, 4.0, 10_000)))
    found = friction.look()
    assert found is not None and found.contradicting == ("a11",)
    assert found.changed == ()
    assert found.reason == REASONS[lib.ZYGOS_REASON_UNCLOSED]
    said = about_change(friction.flight.estimate(), found, lever)
    assert not said.startswith("the arm changed")
    assert "friction" in said and "or a change of the arm" in said


def test_nothing_is_said_of_noise_where_nothing_was_solved(lever: Arm) -> None:
    found, watch = learned(lever, swung(lever, (3.0, 0.0, 10)))
    assert found.reason == REASONS[lib.ZYGOS_REASON_NO_DATA]
    assert about_noise(found) == ""
    assert "longer" in remedy(found, watch.flight)


def test_a_longer_run_is_advised_where_its_length_was_seen_to_help(lever: Arm) -> None:
    found, watch = learned(lever, swung(lever, (3.0, 0.0, 20_000)))
    blurred = replace(found, validity="refused", reason=NOT_IDENTIFIABLE)
    assert remedy(blurred, watch.flight, [Known(5_000, 0)]).startswith(
        "a longer run: 0 parameters had a value after 20"
    )
    assert "longer run" not in remedy(blurred, watch.flight, [Known(5_000, 1)])
    assert "longer run" not in remedy(blurred, watch.flight)
    for code in (
        lib.ZYGOS_REASON_NOISE,
        lib.ZYGOS_REASON_DECLARED,
        lib.ZYGOS_REASON_UNCLOSED,
        lib.ZYGOS_REASON_TOO_FAST,
    ):
        assert "longer run" not in remedy(replace(found, reason=REASONS[code]), watch.flight, watch.known), code
    few = replace(found, reason=REASONS[lib.ZYGOS_REASON_NO_DATA], accepted=2)
    assert remedy(few, watch.flight) == "a longer run: 2 instants were accepted, 3 are needed"


def test_one_cause_has_one_remedy(lever: Arm) -> None:
    """Where the bandwidth test refuses instants already, neither a faster motion nor a longer window helps against
    noise."""
    found, watch = learned(lever, swung(lever, (3.0, 0.0, 20_000)))
    quiet = replace(found, reason=REASONS[lib.ZYGOS_REASON_NOISE], accepted=2_379, refused=0)
    assert remedy(quiet, watch.flight).startswith("a longer window of the smoother")
    said = remedy(replace(quiet, refused=112), watch.flight)
    assert said.startswith("a higher SYNC rate") and "larger or faster motion of every joint" not in said
    for code in (lib.ZYGOS_REASON_NOISE, lib.ZYGOS_REASON_NOT_IDENTIFIABLE, lib.ZYGOS_REASON_TOO_FAST):
        said = remedy(replace(quiet, reason=REASONS[code], accepted=1_629, refused=860), watch.flight)
        assert said.endswith("a slower motion: 860 of 2,489 instants failed the bandwidth test")


@pytest.mark.slow
def test_a_longer_window_helps_against_noise(lever: Arm) -> None:
    """What is proposed is carried out: with 31 points in place of 7, the motion stands out of coarse encoders."""
    coarse = Encoder(0.016)
    rough = replace(lever, joints=(replace(lever.joints[0], link_encoder=coarse, motor_encoder=coarse),),
                    joint_increment_s=0.0)  # fmt: skip
    run = swung(rough, (3.0, 0.0, 20_000))
    before, watch = learned(rough, run)
    assert before.validity == "refused" and before.signal_to_noise < 2.0
    assert remedy(before, watch.flight).startswith("a longer window of the smoother ([smoother] points")
    after, _ = learned(replace(rough, smoother=Smoother(31, 4, 15)), run)
    assert after.validity == "valid" and after.signal_to_noise > 2.0 * before.signal_to_noise


# ------------------------------------------------------------------------------------------ no frames at all


def test_a_log_of_another_machine_has_no_frames_of_the_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    need(VEHICLE.is_file(), f"the log of a road vehicle, {VEHICLE.name}")
    (tmp_path / "run.log").write_bytes(VEHICLE.read_bytes())
    with pytest.raises(SystemExit) as end:
        main(
            ["estimate", str(tmp_path / "run.log"), "--arm", str(EXAMPLE / "arm.toml"), "-o", str(tmp_path / "m.toml")]
        )
    assert end.value.code == 3
    said = capsys.readouterr()
    assert "no complete cycle of this arm was received" in said.err
    assert "no frame of this arm came: compare the node numbers" in said.err
    assert "times as large" not in said.out + said.err
    assert not (tmp_path / "m.toml").exists()
    with pytest.raises(ZygosError, match=r"not one whole cycle of arm \w+.*no frame of this arm.*node numbers"):
        read_measured_run(load_arm(EXAMPLE / "arm.toml"), VEHICLE, bus.read_log(VEHICLE).frames)


@pytest.mark.slow(only=["one", "explain", "predict"])
@pytest.mark.parametrize(
    "command",
    [
        ["predict", "--model", "published.toml", "{run}"],
        ["estimate", "{run}", "-o", "{new}"],
        ["estimate", "{run}", "00.blf", "-o", "{new}"],
        ["explain", "--simulation", "published.toml", "{run}", "00.blf", "-o", "{new}"],
    ],
    ids=["predict", "one", "two", "explain"],
)
def test_a_log_of_drives_with_messages_of_their_own_is_converted_first(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pendulum = ROOT / "examples" / "pendulum"
    places = {"{run}": pendulum / "03.blf", "{new}": tmp_path / "new.toml"}
    names = {one: pendulum / one for one in ("published.toml", "00.blf")} | places
    with pytest.raises(SystemExit) as end:
        main([str(names.get(one, one)) for one in command] + ["--arm", str(pendulum / "arm.toml")])
    assert end.value.code == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "not one whole cycle of arm pendulum is in it" in said and "`zygos convert`" in said
    assert "same recording" not in said and not list(tmp_path.iterdir())


# ------------------------------------------------------------------------------------------ timing


def jittering(folder: Path, jitter: float, speed: float, rate: float = 250.0) -> tuple[Path, Path]:
    """A table of two pendulum joints at `rate`, whose stamps lie by up to `jitter` of the interval, and its map."""
    rng, n = np.random.default_rng(0), 2000
    t = np.arange(n) / rate
    stamps = t + jitter / rate * rng.uniform(-1.0, 1.0, n)
    columns = {"t": stamps - stamps[0]}
    text = '[time]\nsource = "column"\ncolumn = "t"\nunit = "s"\ninterpolation = "cubic"\n'
    for i in (1, 2):
        angle = 0.5 * np.sin(speed * t + i) + 0.2 * np.sin(2.3 * speed * t)
        columns |= {f"m{i}": 1e-5 * np.rint(1e5 * angle), f"t{i}": np.cos(speed * t + i)}
        text += (
            f'[[joint]]\nname = "joint {i}"\nmotor = {{ column = "m{i}", unit = "rad", side = "output" }}\n'
            f'torque = {{ column = "t{i}", unit = "Nm" }}\n'
        )
    write_columns(folder / "run.npz", columns)
    (folder / "map.toml").write_text(text)
    (folder / "arm.toml").write_text(
        f'name = "two"\nbase = "fixed"\nkinetic = "planar"\nperiod_s = {1.0 / rate}\ntorque_law = "sampled"\n'
        'torque_at = "rotor"\ngravity = [0.0, 0.0, -9.81]\n'
        + "".join(
            f'[[joint]]\nname = "joint {i}"\nnode = {i}\naxis = [0.0, 1.0, 0.0]\nframe_rpy = [0.0, 0.0, 0.0]\n'
            'gear_ratio = 6.0\nflexible = false\nmotor_encoder = { quantum_rad = 1e-5, side = "output" }\n'
            for i in (1, 2)
        )
    )
    return folder / "run.npz", folder / "map.toml"


def converted(folder: Path, run: Path, mapping: Path) -> int:
    (folder / "out").mkdir()
    with pytest.raises(SystemExit) as end:
        main(["convert", str(run), "--map", str(mapping), "-o", str(folder / "out" / "run.npz")])
    return int(end.value.code or 0)


def test_stamps_that_jitter_are_not_taken_for_a_fast_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, mapping = jittering(tmp_path, 0.49, 1.0)
    arm = load_arm(tmp_path / "arm.toml")
    chosen = load_map(mapping, arm, "table")
    found = tracks(read_table(run, chosen), chosen)
    rate, needed = needed_rate(found, arm, chosen)
    assert needed is None or needed >= 2.0 * rate  # what would be taken for the motion's
    assert converted(tmp_path, run, mapping) == 3
    said = capsys.readouterr().err
    assert re.search(r"the time stamps jitter by 1\.1\d ms \(29 % of the interval\)", said)
    assert "with even stamps" in said and "cycle counter" in said
    assert "this motion needs" not in said


def test_a_motion_that_is_too_fast_is_not_blamed_on_stamps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, mapping = jittering(tmp_path, 0.0, 150.0)
    assert converted(tmp_path, run, mapping) == 3
    said = capsys.readouterr().err
    assert "this motion needs >=" in said
    assert "jitter" not in said


# ------------------------------------------------------------------------------------------ where a gap is


def local(layout: Layout, **rho: float) -> np.ndarray:  # type: ignore[type-arg]
    return np.array([[rho.get(name, 1.0) for name in layout.balances]] * 2)


def finding(kind: str, joint: str | None) -> Finding:
    return Finding(kind, joint, 1.0, 0.01, "Nm", Significance(9.0, 1.0), entry=CATALOGUE.get(kind))


def where(arm: Arm, layout: Layout, seen: np.ndarray, found: tuple[Finding, ...] = (), *, first: bool = False) -> str:  # type: ignore[type-arg]
    return sentences.where(arm, whereabouts(arm, layout, seen, (), found, first=first))


def test_the_place_is_that_of_the_effect_which_is_named() -> None:
    """Friction at a link shows in the energy and the momentum: nothing is then said of the gyro."""
    arm, _, _ = example()
    layout = Layout(arm)
    seen = local(layout, E=9.0, H=12.0)
    said = where(arm, layout, seen, (finding("link_coulomb", "shoulder"),))
    assert "acts at the link side of the shoulder" in said
    assert "gyro" not in said and "base" not in said
    assert "link side" in where(arm, layout, seen)
    assert "on the base" in where(arm, layout, seen, (finding("angular_momentum", None),))
    # what comes first is in the verdict's own sentence
    assert "look at" not in where(arm, layout, seen, first=True)


def test_a_gyro_is_not_sent_to_a_motor_that_fails_a_little() -> None:
    arm, _, _ = example()
    layout = Layout(arm)
    said = where(arm, layout, local(layout, H=90.0, M1=3.0))
    assert "gyro" in said and "motor side" not in said
    said = where(arm, layout, local(layout, H=3.0, M1=90.0))
    assert "motor side of the shoulder" in said and "gyro" not in said
    assert "link side" in where(arm, layout, local(layout, E=9.0))


# ------------------------------------------------------------------------------------------ check-arm


def pendulum(number: str) -> tuple[Arm, Cycles]:
    """A measured run of the DFKI double pendulum on a grid of 2 ms; its torques are those of its joints, in place."""
    file = PENDULUM / f"trajectory_{number}.csv.gz"
    need(file.is_file(), f"the measured runs of a double pendulum, {file.name}")
    with np.errstate(all="ignore"):
        data = np.genfromtxt(file, delimiter=",", names=True)
    t = np.arange(0.0, data["time"][-1] - data["time"][0], 0.002)
    q, tau = (
        np.column_stack([np.interp(t, data["time"] - data["time"][0], data[f"{name}{i}"]) for i in (1, 2)])
        for name in ("pos_meas", "tau_meas")
    )
    encoder = Encoder(3.8e-4)
    joints = tuple(
        Joint(f"joint {i}", i, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 6.0, encoder, encoder, 0.01, flexible=False)
        for i in (1, 2)
    )
    arm = Arm(
        "pendulum", "fixed", "planar", 0.002, "sampled", "rotor", joints, NO_IMU, Smoother(15, 4, 7),
        gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip
    return arm, table(arm, q, tau / 6.0)


def accused(found: Audit) -> dict[str, str]:
    return {f.signal: f.fault for f in found.findings}


@pytest.mark.slow
@pytest.mark.parametrize("number", ["00", "01", "02", "03", "11"])
def test_coupled_joints_are_not_accused_where_the_law_of_one_motor_does_not_fit(number: str) -> None:
    arm, cycles = pendulum(number)
    found = audit(arm, cycles)
    assert found.findings == ()
    # at the rates of 11 with this smoother's window of 30 ms, the law leaves most of the first torque
    assert found.ok == (number != "11"), found.notes
    undone = audit(arm, swapped("tau", 0, 1)(cycles))
    if number == "11":
        assert undone.findings == () and not undone.ok
        return
    assert accused(undone) == {
        "joint 1 torque": "swapped with joint 2 torque",
        "joint 2 torque": "swapped with joint 1 torque",
    }
    for i in (0, 1):
        assert accused(audit(arm, inverted("tau", i)(cycles))) == {f"joint {i + 1} torque": "inverted"}


def test_noise_of_a_torque_is_tested_as_that_of_an_encoder() -> None:
    arm, cycles = pendulum("02")
    declared = [replace(joint, torque_sigma=0.0) for joint in arm.joints]
    found = audit(replace(arm, joints=tuple(declared)), cycles)
    # noise that nobody declared is said, and is no fault
    assert found.ok
    assert [text.partition(":")[0] for text in found.remarks][-2:] == ["joint 1 torque", "joint 2 torque"]
    sigma = float(re.search(r"torque_sigma = ([\d.e-]+)", found.remarks[-1])[1])  # type: ignore[index]
    assert 1e-4 < sigma < 1e-3
    few = [replace(joint, torque_sigma=1e-5) for joint in arm.joints]
    assert all(
        f.fault.startswith("noisier than declared by") for f in audit(replace(arm, joints=tuple(few)), cycles).findings
    )


# ------------------------------------------------------------------------------------------ the documentation


@pytest.mark.slow
def test_the_example_of_a_matlab_file_has_its_torques_where_they_are(tmp_path: Path) -> None:
    """docs/telemetry.md: an arm of a ton needs thousands of Nm at its joints; read as torques of the output these
    would be some twenty."""
    need(KR300.is_file(), f"the measured run of a KUKA KR300, {KR300.name}")
    text = (ROOT / "docs" / "telemetry.md").read_text(encoding="utf-8").partition("## A MATLAB file")[2]
    entry = re.search(r"```toml\n(.*?)```", text, re.DOTALL)
    assert entry is not None
    ratios = (256.8571, 267.4286, 252.3333)
    mapping = entry[1].partition("[[joint]]")
    one = mapping[1] + mapping[2]
    joints = "".join(one.replace("axis 1", f"axis {i + 1}").replace("[0]", f"[{i}]") for i in range(3))
    (tmp_path / "map.toml").write_text(mapping[0] + joints)
    record = loadmat(KR300, squeeze_me=True, struct_as_record=False)["rec"]
    np.savez(
        tmp_path / "run_a.npz", t=record.time_cont, motor=record.act_pos_mot_deg.T, link=record.act_pos_se_deg.T,
        torque=record.act_torque_abs_nm.T,
    )  # fmt: skip
    axes = ("[0, 0, -1]", "[0, 1, 0]", "[0, 1, 0]")
    (tmp_path / "arm.toml").write_text(
        'name = "kr300"\nbase = "fixed"\ngravity = [0, 0, -9.81]\nkinetic = "spatial"\nperiod_s = 0.004\n'
        'torque_law = "sampled"\ntorque_at = "rotor"\n'
        + "".join(
            f'[[joint]]\nname = "axis {i + 1}"\nnode = {i + 1}\naxis = {axis}\nframe_rpy = [0, 0, 0]\n'
            f"gear_ratio = {ratio}\nlink_encoder = {{ quantum_rad = 1e-5 }}\n"
            'motor_encoder = { quantum_rad = 1e-5, side = "output" }\n'
            for i, (ratio, axis) in enumerate(zip(ratios, axes, strict=True))
        )
    )
    (tmp_path / "out").mkdir()
    try:
        main(["convert", str(tmp_path / "run_a.npz"), "--map", str(tmp_path / "map.toml"),
              "-o", str(tmp_path / "out" / "run.npz")])  # fmt: skip
    except SystemExit as end:
        assert end.code in (0, None, 3)
    arm = load_arm(tmp_path / "out" / "arm.toml")
    cycles = read_cycles(tmp_path / "out" / "run.npz", arm)
    # the torque at the joint that goes with its acceleration: what axis 1 turns has some 100 kg m^2 and more
    h = arm.period_s
    smooth = np.hanning(101) / np.hanning(101).sum()
    angle, torque = (np.convolve(x, smooth, "same")[200:-200] for x in (cycles.theta[:, 0], cycles.tau[:, 0]))
    rate = np.gradient(angle, h)
    columns = np.column_stack([np.gradient(rate, h), rate, np.tanh(50.0 * rate), np.ones(len(rate))])
    inertia = ratios[0] * np.linalg.lstsq(columns, torque, rcond=None)[0][0]
    print(inertia)
    assert 100.0 < inertia < 3000.0
