# SPDX-License-Identifier: MIT
"""`zygos convert` as a user types it: foreign logs and tables become runs, or are refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import telemetry_support as foreign
from cli_support import run
from numpy.typing import NDArray
from runs_support import trajectory_of
from scipy.interpolate import CubicSpline
from scipy.io import loadmat

from conftest import EXAMPLE, PAPER, ROOT, need
from zygos.arm import NO_IMU, Arm, load_arm
from zygos.can import bus
from zygos.files.tables import write_columns
from zygos.model.model import Model, load_model
from zygos.native.flight import Estimate, Flight, encode
from zygos.runs.cycles import Cycles
from zygos.runs.tables import read_cycles
from zygos.simulation.scenario import Scenario, load_scenario
from zygos.telemetry.grid import regrid, tracks
from zygos.telemetry.map import load_map, read_table

FOLDER = foreign.EXAMPLE
NAMES = ("Cycle", "Drive1Position", "Drive1Torque", "Drive2Position", "Drive2Torque", "RatesXY", "RateZ")
RECEIVE = ('source = "sync"                       # a', 'source = "receive"\ninterpolation = "cubic"  # a')
NO_SIGNAL = ('signal = "Cycle.Count"', "")


def convert(log: Path, out: Path, *more: object, map_file: Path = FOLDER / "map.toml") -> int:
    dbc = [] if log.suffix in (".csv", ".parquet", ".npz") else ["--dbc", FOLDER / "arm.dbc"]
    arm = [] if "--arm" in more else ["--arm", EXAMPLE / "arm.toml"]
    return run("convert", log, *dbc, "--map", map_file, *arm, "-o", out, *more)


def steady(k: int, name: str) -> float:
    """Stamps of a punctual bus."""
    return 0.05 * k + 2e-4 * NAMES.index(name)


def native(arm: Arm, cycles: Cycles) -> Estimate:
    flight = Flight(arm)
    flight.cycles(cycles)
    return flight.estimate()


def spread(arm: Arm, cycles: Cycles, sizes: dict[str, float], seeds: int = 12) -> NDArray[np.float64]:
    """(p,) by how much the estimate moves when every reading is off by a uniform error as wide as `sizes`."""
    values = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        moved = {
            name: getattr(cycles, name) + rng.uniform(-0.5, 0.5, getattr(cycles, name).shape) * size
            for name, size in sizes.items()
        }
        values.append(native(arm, replace(cycles, **moved)).value)
    deviation: NDArray[np.float64] = np.sqrt(np.mean((np.array(values) - native(arm, cycles).value) ** 2, axis=0))
    return deviation


@pytest.fixture(scope="module")
def cycles(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """The first 30 s of the example."""
    return every(trajectory_of(arm, model, scenario, seeds=[3], noise=True).cycles(), slice(600))


def every(cycles: Cycles, which: slice) -> Cycles:
    return Cycles(*(getattr(cycles, name)[which] for name in Cycles.__dataclass_fields__))


@pytest.fixture(scope="module")
def log(cycles: Cycles, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run as a stranger would record it; the counter starts close before its wrap."""
    folder = tmp_path_factory.mktemp("foreign")
    return foreign.write(folder / "my.blf", foreign.messages(cycles, steady, first_count=65_000))


@pytest.fixture(scope="module")
def brief_log(cycles: Cycles, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 7.5 s of it."""
    folder = tmp_path_factory.mktemp("brief")
    return foreign.write(folder / "my.blf", foreign.messages(every(cycles, slice(150)), steady, first_count=65_000))


@pytest.mark.slow
def test_a_log_with_a_counter_gives_the_native_estimate(arm: Arm, cycles: Cycles, log: Path, tmp_path: Path) -> None:
    """Within what the two roundings explain: that of the foreign codes, and that of zygos' own wire."""
    assert convert(log, tmp_path / "run.blf", "--json", tmp_path / "c.json") == 0
    head, _, body = (tmp_path / "arm.toml").read_text().partition("\n")
    assert head == "# zygos convert wrote this arm file for run.blf; its noise is that of their values."
    assert body == (EXAMPLE / "arm.toml").read_text()
    assert run("estimate", tmp_path / "run.blf", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    content = json.loads((tmp_path / "m.json").read_text())
    assert (content["door"], content["cycles"]) == ("frames", 600)
    values = np.array([parameter["value"] for parameter in content["parameters"]])
    wire = {"q": 6e-6, "theta": 6e-6, "tau": 1e-4, "omega": 2.0**-21}
    both = {name: math.hypot(foreign.STEPS[name], wire[name]) for name in wire}
    own = native(arm, cycles).value
    assert np.all(np.abs(values - own) < 5.0 * spread(arm, cycles, both))
    assert np.all(np.abs(values / own - 1.0) < 1e-3)
    report = json.loads((tmp_path / "c.json").read_text())
    assert (report["cycles"], report["breaks"], report["time"], report["door"]) == (600, 0, "sync", "frames")
    shoulder = report["signals"][0]
    assert (shoulder["signal"], shoulder["from"]) == ("shoulder.link", "Drive1Position.Link")
    assert shoulder["largest"] == pytest.approx(cycles.q[:, 0].max(), abs=1e-5)
    assert run("self-test", tmp_path / "run.blf") == 0


SI = """VERSION ""

BS_:

BU_: A

BO_ 128 Sync: 1 A
 SG_ Count : 0|8@1+ (1,0) [0|255] "" A

{messages}
{kinds}
"""
FIELDS = [f"{kind}{i}" for i in (1, 2) for kind in ("Link", "Motor", "Torque")] + ["GyroX", "GyroY", "GyroZ"]


def si_log(folder: Path, cycles: Cycles) -> tuple[Path, Path, Path]:
    """Log, DBC and map of a bus whose signals are doubles in SI: nothing is rounded."""
    import cantools

    messages = "".join(
        f'BO_ {512 + k} {name}: 8 A\n SG_ Value : 0|64@1- (1,0) [0|0] "" A\n\n' for k, name in enumerate(FIELDS)
    )
    kinds = "".join(f"SIG_VALTYPE_ {512 + k} Value : 2;\n" for k in range(len(FIELDS)))
    dbc = folder / "si.dbc"
    dbc.write_text(SI.format(messages=messages, kinds=kinds))
    database = cantools.database.load_file(str(dbc))
    columns = {f"Gyro{axis}": cycles.omega[:, k] for k, axis in enumerate("XYZ")}
    for i in (0, 1):
        columns |= {
            f"Link{i + 1}": cycles.q[:, i],
            f"Motor{i + 1}": cycles.theta[:, i],
            f"Torque{i + 1}": cycles.tau[:, i],
        }
    log = []
    for k in range(len(cycles)):
        log.append(can.Message(timestamp=0.05 * k, arbitration_id=128, is_extended_id=False, data=[k % 256]))
        for j, name in enumerate(FIELDS):
            data = database.encode_message(name, {"Value": float(columns[name][k])})
            stamp = 0.05 * k + 2e-4 * (j + 1)
            log.append(can.Message(timestamp=stamp, arbitration_id=512 + j, is_extended_id=False, data=data))
    joints = "".join(
        f'[[joint]]\nname = "{name}"\nmotor = {{ signal = "Motor{i}.Value", unit = "rad", side = "output" }}\n'
        f'link = {{ signal = "Link{i}.Value", unit = "rad" }}\ntorque = {{ signal = "Torque{i}.Value", unit = "Nm" }}\n'
        for i, name in ((1, "shoulder"), (2, "elbow"))
    )
    gyro = "".join(f'{a} = {{ signal = "Gyro{a.upper()}.Value", unit = "rad/s" }}\n' for a in "xyz")
    map_file = folder / "map.toml"
    map_file.write_text(f'[time]\nsource = "sync"\nsignal = "Sync.Count"\n{joints}[gyro]\n{gyro}')
    return foreign.write(folder / "si.asc", log), dbc, map_file


@pytest.mark.slow
def test_with_a_counter_and_si_not_a_bit_changes(arm: Arm, cycles: Cycles, tmp_path: Path) -> None:
    log, dbc, map_file = si_log(tmp_path, cycles)
    options = ("--dbc", dbc, "--map", map_file, "--arm", EXAMPLE / "arm.toml")
    assert run("convert", log, *options, "-o", tmp_path / "table" / "run.npz") == 0
    got = read_cycles(tmp_path / "table" / "run.npz", arm)
    for name in Cycles.__dataclass_fields__:
        assert np.array_equal(getattr(got, name), getattr(cycles, name)), name
    assert run("convert", log, *options, "-o", tmp_path / "can" / "run.log") == 0
    assert np.array_equal(bus.read_log(tmp_path / "can" / "run.log").frames, encode(arm, cycles))


@pytest.fixture(scope="module")
def twice(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """The example with a servo at 40 Hz."""
    return trajectory_of(arm, model, scenario, seeds=[3], noise=True, period_s=0.025).cycles()


def jittered(cycles: Cycles, folder: Path, seed: int = 0, share: float = 0.2) -> Path:
    """Samples at 40 Hz whose receive stamps are off by up to a share of the period, each message by its own."""
    off = np.random.default_rng(seed).uniform(-share, share, (len(cycles), len(NAMES)))

    def stamp(k: int, name: str) -> float:
        return 1.7e9 + 0.025 * (k + 1 + float(off[k, NAMES.index(name)]))

    return foreign.write(folder / "my.log", foreign.messages(cycles, stamp))


@pytest.mark.slow
def test_a_log_without_a_counter(
    arm: Arm, model: Model, scenario: Scenario, twice: Cycles, tmp_path: Path, true: NDArray[np.float64]
) -> None:
    """Readings lie within the noise that the arm file beside the run declares, and the values near the true ones."""
    source = jittered(twice, tmp_path)
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    out = tmp_path / "out"
    assert convert(source, out / "run.npz", "--json", tmp_path / "c.json", map_file=map_file) == 0
    report = json.loads((tmp_path / "c.json").read_text())
    noisy = load_arm(out / "arm.toml")
    got = read_cycles(out / "run.npz", noisy)
    assert noisy.joints[0].link_encoder.sigma_rad > 1.3 * arm.joints[0].link_encoder.sigma_rad
    signals = {row["signal"]: row for row in report["signals"]}
    assert signals["shoulder.link"]["sigma"] == pytest.approx(noisy.joints[0].link_encoder.sigma_rad)
    assert signals["gyro.z"]["sigma"] == pytest.approx(noisy.imu.rate_sigma)
    assert signals["elbow.torque"]["sigma"] == pytest.approx(noisy.joints[1].torque_sigma)
    assert report["bandwidth"]["refused_share"] < 0.05
    # the grid begins with the last of the first stamps, which the log itself states to a microsecond
    stamps = [message.timestamp for message in can.LogReader(str(source))][: len(NAMES)]
    begin = max(stamps) - 1.7e9 - 0.025
    true_angle = CubicSpline(0.025 * np.arange(len(twice)), without_noise(arm, model, scenario, twice))
    at = begin + 0.05 * got.sync
    inner = (at > 0.2) & (at < 59.5)
    for i, joint in enumerate(noisy.joints):
        error = got.q[inner, i] - true_angle(at[inner])[:, i]
        assert 0.3 < np.sqrt(np.mean(error**2)) / joint.link_encoder.sigma_rad < 1.1
    # stamps that lie so far leave little of the bodies; what is said of them holds, and says so
    assert run("estimate", "--energy", out / "run.npz", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["noise_ratio"] > 1.5
    value, half = (np.array([one[key] for one in content["parameters"]]) for key in ("value", "half95"))
    assert np.all(np.abs(value - true) <= half)
    assert np.all(half[:6] > 0.2 * true[:6])

    steady, better = jittered(twice, tmp_path, share=0.05), tmp_path / "better"
    assert convert(steady, better / "run.npz", map_file=map_file) == 0
    assert (
        run("estimate", "--energy", better / "run.npz", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    )
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["validity"] == "valid"
    values = np.array([parameter["value"] for parameter in content["parameters"]])
    print(np.round(100 * (values / true - 1), 2))
    assert np.max(np.abs(values / true - 1.0)) < 0.05


def without_noise(arm: Arm, model: Model, scenario: Scenario, run_: Cycles) -> NDArray[np.float64]:
    """(n, N) link angles of the same run, which the servo's noise moved, without the encoder's own errors."""
    trajectory = trajectory_of(arm, model, scenario, seeds=[3], noise=True, period_s=0.025)
    assert np.array_equal(trajectory.cycles().q, run_.q)
    angles: NDArray[np.float64] = trajectory.q[0]
    return angles


@pytest.mark.slow
def test_a_time_in_the_telemetry_goes_before_the_stamps(arm: Arm, cycles: Cycles, log: Path, tmp_path: Path) -> None:
    """Cycle.Time counts 0.1 ms and wraps; the log's stamps are useless. As even as a counter, so the same readings."""
    time_s = 0.05 * np.arange(len(cycles)) + 429_490.0  # the 32 bits end 6.7 s after the beginning
    late = foreign.messages(
        cycles, lambda k, name: 0.05 * k + (0.02 if k % 3 else 0.0) + 2e-4 * NAMES.index(name), time_s=time_s
    )
    source = foreign.write(tmp_path / "my.blf", late)
    map_file = foreign.edited(
        FOLDER / "map.toml",
        tmp_path / "map.toml",
        ('source = "sync"  ', 'source = "signal"\nunit = "ms"\ninterpolation = "linear"  '),
        ("Cycle.Count", "Cycle.Time"),
    )
    assert convert(source, tmp_path / "a" / "run.npz", map_file=map_file) == 0
    assert convert(log, tmp_path / "b" / "run.npz") == 0
    ours, counted = (read_cycles(tmp_path / folder / "run.npz", arm) for folder in "ab")
    n = len(ours)
    assert n >= len(counted) - 1
    assert np.max(np.abs(ours.q - counted.q[:n])) < 1e-6
    assert np.max(np.abs(ours.tau - counted.tau[:n])) < 1e-3


def test_lost_messages_break_the_run_and_nothing_else(arm: Arm, cycles: Cycles, tmp_path: Path) -> None:
    """A hole of 130 cycles (longer than a receiver waits for FTIME), one lost frame, and one that came twice."""
    whole = foreign.messages(cycles, steady, first_count=65_000)
    kept = [m for m in whole if not 10.0 < m.timestamp < 16.499]
    lost = next(m for m in kept if m.arbitration_id == 785 and m.timestamp > 5.0)
    twice = next(m for m in kept if m.arbitration_id == 786 and m.timestamp > 20.0)
    kept = [m for m in kept if m is not lost]
    kept.insert(kept.index(twice), twice)
    short = can.Message(timestamp=25.001, arbitration_id=785, is_extended_id=False, data=[1, 2])
    kept.insert(next(k for k, m in enumerate(kept) if m.timestamp > 25.001), short)
    source = foreign.write(tmp_path / "my.asc", kept)
    assert convert(source, tmp_path / "run.blf", "--json", tmp_path / "c.json") == 0
    report = json.loads((tmp_path / "c.json").read_text())
    assert (report["cycles"], report["breaks"], report["damaged_frames"]) == (600 - 130 - 2, 3, 1)
    assert report["left_out"] == {"incomplete cycles": 2, "repeated cycles": 1}
    assert "1 frame could not be decoded" in report["warnings"][0]
    flight = Flight(arm)
    trace = flight.frames(bus.read_log(tmp_path / "run.blf").frames, trace=True)
    assert trace is not None
    assert flight.faults["time_lost"] == flight.faults["time_jumped"] == 0
    away = set(range(600)) - set(trace.cycles.sync.astype(int).tolist())
    gone = {round(m.timestamp / 0.05 - 0.01) for m in whole if 10.0 < m.timestamp < 16.499}
    assert len(away) == 132
    assert len(gone & away) == 130
    assert np.max(np.abs(trace.cycles.q - cycles.q[sorted(set(range(600)) - away)])) < 1e-5


@pytest.mark.slow
def test_a_recording_that_is_too_slow(
    model: Model,
    scenario: Scenario,
    arm: Arm,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The example with 20-bit encoders at 10 Hz; at 40 Hz the same motion passes. The file is written all the same."""
    monkeypatch.setattr("zygos.files.progress.FIRST_S", 600.0)  # a slow machine would print how far it is
    text = (EXAMPLE / "arm.toml").read_text().replace("quantum_rad = 0.003", "quantum_rad = 6e-6")
    sharp = tmp_path / "sharp.toml"
    sharp.write_text(text)
    fast = trajectory_of(load_arm(sharp), model, scenario, seeds=[3], noise=True, period_s=0.0125).cycles()
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    for step, needed in ((8, 40.0), (2, None)):
        picked = every(fast, slice(None, None, step))
        h = 0.0125 * step
        source = foreign.write(
            tmp_path / f"{step}.log",
            foreign.messages(picked, lambda k, name, h=h: h * k + 2e-4 * NAMES.index(name)),  # type: ignore[misc]
        )
        own = tmp_path / f"arm{step}.toml"
        own.write_text(text.replace("period_s = 0.05", f"period_s = {min(h, 0.05)}"))
        out = tmp_path / str(step) / "run.blf"
        code = convert(source, out, "--arm", own, "--json", tmp_path / "c.json", map_file=map_file)
        report = json.loads((tmp_path / "c.json").read_text())
        assert out.is_file()
        error = capsys.readouterr().err
        if needed:
            assert code == 3
            assert "10 Hz; this motion needs >= 40 Hz" in error
            assert report["bandwidth"]["needed_hz"] == pytest.approx(needed)
        else:
            assert (code, error.strip()) == (0, "")


def test_a_wrong_unit(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The DBC knows better; where it is overruled, the table says that two angles do not move alike."""
    link = 'signal = "Drive1Position.Link", unit = "deg"'
    wrong = foreign.edited(FOLDER / "map.toml", tmp_path / "wrong.toml", (link, link.replace("deg", "rad")))
    assert convert(log, tmp_path / "run.blf", map_file=wrong) == 2
    assert 'link.unit: the map says "rad", the DBC says "deg" for Drive1Position.Link' in capsys.readouterr().err
    assert not (tmp_path / "run.blf").exists()
    forced = foreign.edited(
        FOLDER / "map.toml", tmp_path / "forced.toml", (link, link.replace('"deg"', '"rad", scale = 1.0'))
    )
    convert(log, tmp_path / "run.blf", "--json", tmp_path / "c.json", map_file=forced)
    out = capsys.readouterr().out
    assert "shoulder: motor and link angle do not move alike" in out
    assert "angles beyond ±8 turns wrap" in out
    assert run("estimate", tmp_path / "run.blf", "-o", tmp_path / "m.toml") == 3
    capsys.readouterr()
    flipped = foreign.edited(
        FOLDER / "map.toml", tmp_path / "flip.toml", (link, link.replace('"deg"', '"deg", sign = -1'))
    )
    assert convert(log, tmp_path / "x" / "run.npz", map_file=flipped) == 0
    assert "in opposite directions" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_a_foreign_table_and_the_cycle_door(
    arm: Arm, cycles: Cycles, tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table in degrees and milliseconds becomes a table of cycles, which estimate and check take and say so."""
    columns: dict[str, NDArray[Any]] = {"t_ms": 50.0 * np.arange(len(cycles)), "n": np.arange(len(cycles))}
    for i in (0, 1):
        columns |= {f"link{i}": np.degrees(cycles.q[:, i]), f"motor{i}": np.degrees(cycles.theta[:, i]) * 50.0}
        columns |= {f"amps{i}": cycles.tau[:, i] / 0.2}
    columns |= {f"w{k}": np.degrees(cycles.omega[:, k]) for k in range(3)}
    write_columns(tmp_path / f"my{suffix}", columns)
    joints = "".join(
        f'[[joint]]\nname = "{name}"\nmotor = {{ column = "motor{i}", unit = "deg", side = "rotor" }}\n'
        f'link = {{ column = "link{i}", unit = "deg" }}\n'
        f'torque = {{ column = "amps{i}", unit = "A", torque_constant = 0.2 }}\n'
        for i, name in enumerate(("shoulder", "elbow"))
    )
    gyro = "[gyro]\n" + "".join(f'{a} = {{ column = "w{k}", unit = "deg/s" }}\n' for k, a in enumerate("xyz"))
    map_file = tmp_path / "map.toml"
    map_file.write_text(f'[time]\nsource = "sync"\ncolumn = "n"\n{joints}{gyro}')
    out = tmp_path / "out" / f"run{suffix}"
    assert convert(tmp_path / f"my{suffix}", out, map_file=map_file) == 0
    assert "output: table of cycles" in capsys.readouterr().out
    assert run("estimate", "--energy", out, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    assert "input: table of cycles" in capsys.readouterr().out
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["door"] == "cycle"
    values = np.array([parameter["value"] for parameter in content["parameters"]])
    assert np.allclose(values, native(arm, cycles).value, rtol=1e-9)
    assert run("self-test", out, "--json", tmp_path / "check.json") == 0
    assert capsys.readouterr().out.startswith("equal: ")
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["door"] == "cycle"
    assert report["rooms"][0]["room"] == "smoother"
    assert all(room["equal"] and room["compared"] for room in report["rooms"])


@pytest.mark.slow
def test_the_other_commands_refuse_what_they_cannot_take(
    cycles: Cycles, brief_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert convert(brief_log, tmp_path / "run.npz") == 0
    table, out = tmp_path / "run.npz", tmp_path / "n.toml"
    assert run("explain", "--simulation", EXAMPLE / "model.toml", table, table, "-o", out) == 2
    assert "run.npz" in capsys.readouterr().err
    assert run("estimate", tmp_path / "none.npz", "-o", tmp_path / "m.toml") == 2
    assert "none.npz: no such file" in capsys.readouterr().err
    write_columns(tmp_path / "bad.npz", {"sync": np.arange(5)})
    assert run("self-test", tmp_path / "bad.npz") == 2
    assert "the cycle table of arm lively has no column q1" in capsys.readouterr().err


def test_cycles_of_no_use(cycles: Cycles, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from zygos.runs.tables import write_cycles

    write_cycles(tmp_path / "run.npz", replace(cycles, tau=np.full_like(cycles.tau, np.nan)))
    (tmp_path / "arm.toml").write_bytes((EXAMPLE / "arm.toml").read_bytes())
    assert run("estimate", tmp_path / "run.npz", "-o", tmp_path / "m.toml") == 3
    assert "600 cycles invalid, not finite or implausibly large" in capsys.readouterr().err


@pytest.mark.slow
def test_what_the_wire_cannot_carry_is_counted(arm: Arm, cycles: Cycles, tmp_path: Path) -> None:
    fast = cycles.omega.copy()
    fast[91:112, 2] = 5.2 * np.sin(np.pi * np.arange(21) / 20)
    strong = cycles.tau.copy()
    strong[21:42, 0] = 850.0 * np.sin(np.pi * np.arange(21) / 20)
    source = foreign.write(tmp_path / "my.blf", foreign.messages(replace(cycles, omega=fast, tau=strong), steady))
    convert(source, tmp_path / "a" / "run.blf", "--json", tmp_path / "c.json")
    said = json.loads((tmp_path / "c.json").read_text())["warnings"]
    assert any(line.startswith("9 cycles: in CAN frames rates beyond ±4") for line in said)
    assert any(line.startswith("3 cycles: in CAN frames torques beyond ±838.8606") for line in said)
    convert(source, tmp_path / "b" / "run.npz", "--json", tmp_path / "c.json")
    assert json.loads((tmp_path / "c.json").read_text())["warnings"] == []
    got = read_cycles(tmp_path / "b" / "run.npz", arm)
    assert got.omega[101, 2] == pytest.approx(5.2, abs=1e-6)


@pytest.mark.parametrize(
    ("unit", "samples", "message"),
    [
        ("us", 12_000, "no unbroken piece of the run is as long as the smoother's window of"),
        ("s", 40, "one sample in 1,000 periods of the arm"),
    ],
)
def test_a_wrong_unit_of_the_time_is_suspected(
    cycles: Cycles, unit: str, samples: int, message: str, tmp_path: Path
) -> None:
    """A time in milliseconds that the map calls microseconds, and seconds."""
    at = np.linspace(0.0, 39.0, samples).astype(int)
    columns = {"motor": cycles.theta[at], "link": cycles.q[at], "torque": cycles.tau[at], "gyro": cycles.omega[at]}
    write_columns(tmp_path / "my.npz", {"t": 50.0 * np.arange(samples), **columns})
    (tmp_path / "map.toml").write_text(
        f'[time]\nsource = "column"\ncolumn = "t"\nunit = "{unit}"\ninterpolation = "linear"\n'
        + "".join(
            f'[[joint]]\nname = "{name}"\nmotor = {{ column = "motor[{k}]", unit = "rad", side = "output" }}\n'
            f'link = {{ column = "link[{k}]", unit = "rad" }}\ntorque = {{ column = "torque[{k}]", unit = "Nm" }}\n'
            for k, name in enumerate(("shoulder", "elbow"))
        )
        + "[gyro]\n"
        + "".join(f'{axis} = {{ column = "gyro[{k}]", unit = "rad/s" }}\n' for k, axis in enumerate("xyz"))
    )
    convert(tmp_path / "my.npz", tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json",
            map_file=tmp_path / "map.toml")  # fmt: skip
    assert any(message in line for line in json.loads((tmp_path / "c.json").read_text())["warnings"])


def test_a_wire_that_is_coarser_than_the_sensor_says_so(brief_log: Path, tmp_path: Path) -> None:
    text = (EXAMPLE / "arm.toml").read_text().replace("quantum_rad = 0.003", "quantum_rad = 1e-6")
    (tmp_path / "arm.toml").write_text(text)
    convert(brief_log, tmp_path / "a" / "run.log", "--arm", tmp_path / "arm.toml", "--json", tmp_path / "c.json")
    said = json.loads((tmp_path / "c.json").read_text())["warnings"]
    assert sum("is coarser than the quantum of 1e-06 rad" in line for line in said) == 4


DBC, MAP, ARM = ("--dbc", FOLDER / "arm.dbc"), ("--map", FOLDER / "map.toml"), ("--arm", EXAMPLE / "arm.toml")
OUT = ("-o", "{in}/r.blf")
REFUSALS: list[tuple[str, tuple[object, ...], str]] = [
    ("no DBC", (*MAP, *OUT), "needs the DBC of its bus"),
    ("DBC that is not there", ("--dbc", "{in}/no.dbc", *MAP, *OUT), "no.dbc: no such file"),
    ("DBC that is none", ("--dbc", "{in}/bad.dbc", *MAP, *OUT), "bad.dbc: not a readable DBC"),
    ("DBC twice", (*DBC, *DBC, *MAP, *OUT), "message Drive1Position is defined in arm.dbc as well"),
    ("map that is not there", (*DBC, "--map", "{in}/no.toml", *ARM, *OUT), "no.toml: no such file"),
    (
        "no arm file",
        (*DBC, "--map", "{in}/map.toml", *OUT),
        "no such arm file; remedy: give it with --arm, or put arm.toml next to the map",
    ),
    ("unknown output", (*DBC, *MAP, "-o", "{in}/r.dat"), "not a known kind of CAN log"),
    ("output that is the input", (*DBC, *MAP, "-o", "{in}/my.blf"), "writing it would replace"),
    (
        "signal that is not in the DBC",
        (*DBC, "--map", "{in}/typo.toml", *ARM, *OUT),
        'joint[1].motor: there is no "Drive2Position.Motr" in arm.dbc; remedy: did you mean "Drive2Position.Motor"?',
    ),
    (
        "signal that is not in the log",
        ("--dbc", "{in}/other.dbc", *MAP, *OUT),
        "my.blf has no RateZ.Z; remedy: compare the identifiers of the DBC",
    ),
    ("counter that is not in the log", ("--dbc", "{in}/third.dbc", *MAP, *OUT), "time: my.blf has no Cycle.Count"),
    (
        "another period",
        (*DBC, *MAP, "--arm", "{in}/slow.toml", *OUT),
        "by the log's time stamps a cycle of Cycle.Count lasts 0.05 s, by the arm file 0.04 s",
    ),
    (
        "another arm beside the run",
        (*DBC, *MAP, "-o", "{in}/beside/r.blf"),
        "is not the arm file of this run",
    ),
]


@pytest.mark.parametrize(("arguments", "message"), [entry[1:] for entry in REFUSALS], ids=[e[0] for e in REFUSALS])
def test_refusals(
    brief_log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[object, ...],
    message: str,
) -> None:
    source = tmp_path / "my.blf"
    source.write_bytes(brief_log.read_bytes())
    (tmp_path / "map.toml").write_text((FOLDER / "map.toml").read_text())
    typo = ("Drive2Position.Motor", "Drive2Position.Motr")
    foreign.edited(FOLDER / "map.toml", tmp_path / "typo.toml", typo)
    (tmp_path / "bad.dbc").write_text("BO_ nonsense\n")
    foreign.edited(FOLDER / "arm.dbc", tmp_path / "other.dbc", ("2566848306", "2566848307"))
    foreign.edited(FOLDER / "arm.dbc", tmp_path / "third.dbc", ("BO_ 256 ", "BO_ 257 "))
    foreign.edited(EXAMPLE / "arm.toml", tmp_path / "slow.toml", ("period_s = 0.05", "period_s = 0.04"))
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "arm.toml").write_bytes((ROOT / "examples" / "gap" / "arm.toml").read_bytes())
    before = sorted(tmp_path.rglob("*"))
    assert run("convert", source, *(str(word).replace("{in}", str(tmp_path)) for word in arguments)) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert sorted(tmp_path.rglob("*")) == before
    assert source.read_bytes() == brief_log.read_bytes()


@pytest.mark.slow
def test_a_run_is_replaced_with_its_arm_file(arm: Arm, cycles: Cycles, brief_log: Path, tmp_path: Path) -> None:
    """Also where the noise of the second conversion is another one, and nothing but the two files is left."""
    out = tmp_path / "out" / "run.npz"
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    assert convert(brief_log, out) == 0
    exact = read_cycles(out, arm)
    assert convert(brief_log, out, map_file=map_file) == 0
    noisy = load_arm(out.parent / "arm.toml")
    assert noisy.joints[0].torque_sigma > arm.joints[0].torque_sigma
    assert convert(brief_log, out) == 0
    assert load_arm(out.parent / "arm.toml") == arm
    np.testing.assert_array_equal(read_cycles(out, arm).q, exact.q)
    assert sorted(path.name for path in out.parent.iterdir()) == ["arm.toml", "run.npz"]


def test_runs_beside_each_other_need_the_same_noise(
    brief_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    assert convert(brief_log, out / "a.npz") == 0
    assert convert(brief_log, out / "b.blf") == 0
    assert "for a.npz, b.blf;" in (out / "arm.toml").read_text()
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert convert(brief_log, out / "b.blf", map_file=map_file) == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert "is the arm file of a.npz, whose noise is not that of this run; remedy: write each run into a folder" in said
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    (out / "a.npz").unlink()
    assert convert(brief_log, out / "b.blf", map_file=map_file) == 0
    assert "for b.blf;" in (out / "arm.toml").read_text()


def test_an_arm_file_of_the_user_is_not_replaced(brief_log: Path, tmp_path: Path) -> None:
    """Not where it says what the run needs, and not where it is the input."""
    out = tmp_path / "out"
    out.mkdir()
    text = (EXAMPLE / "arm.toml").read_text()
    (out / "arm.toml").write_text(text)
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    assert convert(brief_log, out / "run.blf") == 0
    assert convert(brief_log, out / "run.blf", "--arm", out / "arm.toml") == 0
    assert convert(brief_log, out / "other.blf", "--arm", out / "arm.toml", map_file=map_file) == 2
    assert (out / "arm.toml").read_text() == text
    assert sorted(path.name for path in out.iterdir()) == ["arm.toml", "run.blf"]


@pytest.mark.slow(only=["write_cycles"])
@pytest.mark.parametrize("fails", ["write_cycles", "write_text"])
def test_a_conversion_that_cannot_be_written_changes_nothing(
    fails: str, brief_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out" / "run.npz"
    assert convert(brief_log, out) == 0
    before = {path.name: path.read_bytes() for path in out.parent.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(f"zygos.telemetry.convert.{fails}", full)
    map_file = foreign.edited(FOLDER / "map.toml", tmp_path / "map.toml", RECEIVE, NO_SIGNAL)
    assert convert(brief_log, out, map_file=map_file) == 2
    assert "cannot be written (No space left on device)" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.parent.iterdir()} == before


def test_a_table_takes_no_dbc(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.csv").write_text("a\n1\n")
    options = ("--dbc", FOLDER / "arm.dbc", "--map", FOLDER / "map.toml", "-o", tmp_path / "r.npz")
    assert run("convert", tmp_path / "x.csv", *options) == 2
    assert "a table needs no --dbc" in capsys.readouterr().err
    assert run("convert", tmp_path / "y.csv", "--map", FOLDER / "map.toml", "-o", tmp_path / "r.npz") == 2
    assert "y.csv: no such file" in capsys.readouterr().err
    assert run("convert", tmp_path / "x.csv", "--map", FOLDER / "map.toml", "-o", tmp_path / "r.npz") == 2
    assert "the input is a table, which has columns; remedy: name a column" in capsys.readouterr().err


@pytest.mark.slow
def test_the_worked_example_of_the_documentation(tmp_path: Path) -> None:
    """The log of examples/telemetry, which is seed 7 of examples/paper, with the commands of docs/telemetry.md."""
    arm, model = load_arm(PAPER / "arm.toml"), load_model(PAPER / "model.toml")
    scenario = load_scenario(PAPER / "scenario.toml")
    options = ("--dbc", FOLDER / "arm.dbc", "--map", FOLDER / "map.toml")
    assert run("convert", FOLDER / "run.blf", *options, "-o", tmp_path / "run.blf") == 0
    assert run("estimate", "--energy", tmp_path / "run.blf", "-o", tmp_path / "model.toml") == 0
    assert run("convert", FOLDER / "run.blf", *options, "-o", tmp_path / "run.npz") == 0
    told = trajectory_of(arm, model, scenario, seeds=[7], noise=True, duration_s=10.0).cycles()
    got = read_cycles(tmp_path / "run.npz", arm)
    for name, step in foreign.STEPS.items():
        assert np.max(np.abs(getattr(got, name)[:200] - getattr(told, name))) < 0.6 * step, name
    words = (ROOT / "docs" / "telemetry.md").read_text().replace("\\\n", " ").split()
    command = (
        "zygos convert examples/telemetry/run.blf --dbc examples/telemetry/arm.dbc --map examples/telemetry/map.toml"
    )
    assert command in " ".join(words)


def test_a_matlab_file_by_the_snippet_of_the_documentation(arm: Arm, tmp_path: Path, monkeypatch: Any) -> None:
    """A robot that nobody here has seen: its first axis, both encoders in degrees after the gear."""
    data = ROOT.parent / "shared" / "data" / "kr300" / "run_a.mat"
    need(data.is_file(), f"the recording of a KR300, {data.name}")
    text = (ROOT / "docs" / "telemetry.md").read_text()
    snippet = text.split("```python\n")[1].split("```")[0]
    entry = text.split("```toml\n")[-1].split("```")[0]
    (tmp_path / "run_a.mat").symlink_to(data)
    monkeypatch.chdir(tmp_path)
    exec(snippet)
    joint = replace(arm.joints[0], name="axis 1", gear_ratio=256.8571)
    robot = replace(arm, name="kr300", base="fixed", period_s=0.004, joints=(joint,), imu=NO_IMU)
    (tmp_path / "map.toml").write_text(entry)
    mapping = load_map(tmp_path / "map.toml", robot, "table")
    cycles = regrid(tracks(read_table(tmp_path / "run_a.npz", mapping), mapping), robot, mapping)
    raw = loadmat(data, squeeze_me=True, struct_as_record=False)["rec"]
    assert len(cycles) >= 2500
    n = len(cycles)
    assert np.max(np.abs(cycles.q[:, 0] - np.radians(raw.act_pos_se_deg[0, :n]))) < 1e-6
    assert np.max(np.abs(cycles.tau[:, 0] - raw.act_torque_abs_nm[0, :n])) < 1e-3
    assert np.ptp(cycles.q) > 0.01 and np.max(np.abs(cycles.theta - cycles.q)) < 0.01
