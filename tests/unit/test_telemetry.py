# SPDX-License-Identifier: MIT
"""Maps, grids and what they err, against motions whose values are known at every instant."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from runs_support import trajectory_of
from telemetry_support import edited

from conftest import ROOT
from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.files.tables import read_columns, write_columns
from zygos.model.model import Model
from zygos.native.flight import Flight
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.runs.tables import read_cycles, write_cycles
from zygos.simulation.scenario import Scenario, load_scenario
from zygos.telemetry.convert import cycles_of
from zygos.telemetry.grid import (
    Noise,
    Track,
    bridged,
    grid_noise,
    held_mean,
    instants,
    interpolate,
    interpolation_variance,
    needed_rate,
    regrid,
    resampled,
    synchronous,
    tracks,
    tracks_of,
    unwrap,
)
from zygos.telemetry.map import Channel, Clock, Map, load_map, read_table

Floats = NDArray[np.float64]
JOINT = """
[[joint]]
name = "{name}"
motor = {{ column = "m{i}", unit = "rad", side = "output" }}
link = {{ column = "l{i}", unit = "rad" }}
torque = {{ column = "t{i}", unit = "Nm" }}
"""
GYRO = "[gyro]\n" + "".join(f'{axis} = {{ column = "w{axis}", unit = "rad/s" }}\n' for axis in "xyz")
GRID = '[time]\nsource = "column"\ncolumn = "t"\nunit = "s"\ninterpolation = "cubic"\n'
SYNC = '[time]\nsource = "sync"\ncolumn = "n"\n'
JOINTS = JOINT.format(name="shoulder", i=1) + JOINT.format(name="elbow", i=2)


def mapping(tmp_path: Path, arm: Arm, text: str = GRID + JOINTS + GYRO) -> Map:
    file = tmp_path / "map.toml"
    file.write_text(text)
    return load_map(file, arm, "table")


def row(cycles: Cycles) -> dict[str, NDArray[np.float64]]:
    """Columns of a foreign table."""
    columns = {"n": cycles.sync.astype(float), "t": 0.05 * cycles.sync}
    for i in (0, 1):
        columns |= {f"m{i + 1}": cycles.theta[:, i], f"l{i + 1}": cycles.q[:, i], f"t{i + 1}": cycles.tau[:, i]}
    return columns | {f"w{axis}": cycles.omega[:, k] for k, axis in enumerate("xyz")}


def some_cycles(n: int, seed: int = 0) -> Cycles:
    rng = np.random.default_rng(seed)
    return Cycles(
        sync=np.arange(n, dtype=np.uint64),
        q=rng.normal(size=(n, 2)),
        theta=rng.normal(size=(n, 2)),
        tau=rng.normal(size=(n, 2)),
        omega=rng.normal(size=(n, 3)),
        flags=np.zeros(n, dtype=np.uint32),
    )


# -- units ----------------------------------------------------------------------------------------------------------

UNIT_CASES = [  # entry, value of the source, SI by a pocket calculator; the gear is 50
    ('motor = { column = "m1", unit = "rad", side = "output" }', 1.5, 1.5),
    ('motor = { column = "m1", unit = "mrad", side = "output" }', 1500.0, 1.5),
    ('motor = { column = "m1", unit = "rad", side = "rotor" }', 75.0, 1.5),
    ('motor = { column = "m1", unit = "deg", side = "output" }', 90.0, 1.5707963267948966),
    ('motor = { column = "m1", unit = "turn", side = "rotor", sign = -1 }', -25.0, 3.141592653589793),
    ('motor = { column = "m1", unit = "counts", counts_per_turn = 1000, side = "output" }', 250, 1.5707963267948966),
    ('motor = { column = "m1", unit = "rad", side = "output", scale = 2.0, offset = 0.5, sign = -1 }', 1.0, -2.5),
    ('torque = { column = "t1", unit = "Nm" }', 3.0, 3.0),
    ('torque = { column = "t1", unit = "mNm", at = "rotor" }', 3000.0, 3.0),
    ('torque = { column = "t1", unit = "kNm", at = "output" }', 0.15, 3.0),
    ('torque = { column = "t1", unit = "A", torque_constant = 0.25 }', 12.0, 3.0),
    ('torque = { column = "t1", unit = "mA", torque_constant = 0.25, at = "output" }', 600e3, 3.0),
    ('x = { column = "wx", unit = "rpm" }', 30.0, 3.141592653589793),
    ('x = { column = "wx", unit = "deg/s" }', 180.0, 3.141592653589793),
    ('x = { column = "wx", unit = "mdeg/s" }', 180e3, 3.141592653589793),
    ('x = { column = "wx", unit = "mrad/s" }', 2.0, 0.002),
    ('x = { column = "wx", unit = "turn/s" }', 0.5, 3.141592653589793),
]


@pytest.mark.parametrize(("entry", "value", "si"), UNIT_CASES)
def test_units_sides_and_signs(arm: Arm, tmp_path: Path, entry: str, value: float, si: float) -> None:
    key = entry.split(maxsplit=1)[0]
    lines = [entry if line.startswith(f"{key} = ") else line for line in (GRID + JOINTS + GYRO).splitlines()]
    first = lines.index(entry)
    label = {"motor": "shoulder.motor", "torque": "shoulder.torque", "x": "gyro.x"}[key]
    if key != "x":  # the elbow's stays as it was
        second = next(k for k in range(first + 1, len(lines)) if lines[k] == entry)
        lines[second] = JOINT.format(name="elbow", i=2).splitlines()[3 if key == "motor" else 5]
    found = {channel.label: channel for channel in mapping(tmp_path, arm, "\n".join(lines)).channels}[label]
    assert found.gain * value + found.offset == pytest.approx(si, rel=1e-14)


def grounded(tmp_path: Path, **top: str) -> Arm:
    """The pendulum of the examples with other entries at the top of its file."""
    text = (ROOT / "examples" / "pendulum" / "arm.toml").read_text()
    for key, value in top.items():
        kept = [line for line in text.splitlines() if not line.startswith(f"{key} =")]
        text = "\n".join([f'{key} = "{value}"', *kept])
    (tmp_path / "arm.toml").write_text(text)
    return load_arm(tmp_path / "arm.toml")


GROUND_JOINT = """
[[joint]]
name = "{name}"
motor = {{ column = "m{i}", unit = "rad", side = "output" }}
torque = {{ column = "t{i}", {torque} }}
"""


def torque_gain(tmp_path: Path, arm: Arm, torque: str) -> float:
    text = GRID + "".join(
        GROUND_JOINT.format(name=joint.name, i=i, torque=torque) for i, joint in enumerate(arm.joints)
    )
    return next(one.gain for one in mapping(tmp_path, arm, text).channels if one.field == "tau")


@pytest.mark.parametrize(
    ("top", "torque", "gain"),  # the gear is 6
    [
        ({}, 'unit = "Nm"', 1.0),
        ({}, 'unit = "Nm", at = "output"', 1.0 / 6.0),
        ({"torque_at": "joint"}, 'unit = "Nm"', 1.0),
        ({"torque_at": "joint"}, 'unit = "mNm", at = "output"', 1e-3),
        ({"torque_unit": "A"}, 'unit = "A"', 1.0),
        ({"torque_unit": "A"}, 'unit = "mA"', 1e-3),
    ],
)
def test_a_torque_is_stated_on_the_side_and_in_the_unit_of_the_arm_file(
    tmp_path: Path, top: dict[str, str], torque: str, gain: float
) -> None:
    """A sensor behind the gear reports what the arm file expects: nothing is divided by the gear ratio. Currents stay
    currents."""
    assert torque_gain(tmp_path, grounded(tmp_path, **top), torque) == pytest.approx(gain, rel=1e-14)


@pytest.mark.parametrize(
    ("top", "torque", "said"),
    [
        ({"torque_at": "joint"}, 'unit = "Nm", at = "rotor"', r'torque.at: "rotor" is before the gear, .* "joint"'),
        ({"torque_unit": "A"}, 'unit = "Nm"', r'torque.unit: "Nm" is no current, .* remedy: write "A"'),
        ({"torque_unit": "A"}, 'unit = "A", torque_constant = 0.1', r"torque.torque_constant: .* remain currents"),
        ({}, 'unit = "A"', r"torque.torque_constant: is missing"),
    ],
)
def test_a_torque_that_contradicts_the_arm_file_is_refused(
    tmp_path: Path, top: dict[str, str], torque: str, said: str
) -> None:
    with pytest.raises(ZygosError, match=said):
        torque_gain(tmp_path, grounded(tmp_path, **top), torque)


def test_the_cycles_have_every_channel_in_its_place(arm: Arm, tmp_path: Path) -> None:
    """A counter, SI units and no sign: the same bits, in whatever order the map lists the joints."""
    text = SYNC + JOINT.format(name="elbow", i=2) + JOINT.format(name="shoulder", i=1) + GYRO
    sent = some_cycles(30)
    write_columns(tmp_path / "x.npz", row(sent))
    chosen = mapping(tmp_path, arm, text)
    got = synchronous(read_table(tmp_path / "x.npz", chosen), chosen, arm).cycles
    for name in Cycles.__dataclass_fields__:
        assert np.array_equal(getattr(got, name), getattr(sent, name)), name


REFUSED_MAPS = [
    (
        'unit = "Nm"',
        'unit = "Nn"',
        r'torque.unit: "Nn" is not a unit of torque; remedy: write one of "Nm", "mNm", "kNm"',
    ),
    ('unit = "rad", side', 'unit = "Nm", side', r'motor.unit: "Nm" is not a unit of angle'),
    ('unit = "rad/s"', 'unit = "rad"', r'gyro.x.unit: "rad" is not a unit of rate; remedy: .*"deg/s".*"rpm"'),
    ('unit = "rad", side', 'unit = "counts", side', r"motor.counts_per_turn: is missing"),
    ('unit = "Nm"', 'unit = "A"', r"torque.torque_constant: is missing"),
    (', side = "output"', "", r"motor.side: is missing"),
    (
        'name = "elbow"',
        'name = "elbo"',
        r'joint\[1\].name: "elbo" is no joint of arm lively; remedy: did you mean "elbow"',
    ),
    ('name = "elbow"', 'name = "shoulder"', r'"shoulder" appears twice'),
    (JOINT.format(name="elbow", i=2), "", r"joint: no entry for elbow of arm lively"),
    (GYRO, "", r"gyro: is missing"),
    ('z = { column = "wz", unit = "rad/s" }', "", r"gyro.z: is missing"),
    ('column = "m1"', 'signal = "Drive.Motor"', r"motor.signal: the input is a table"),
    ('interpolation = "cubic"\n', "", r"time.interpolation: is missing"),
    ('"column"', '"receive"', r"time.source: 'receive' is not known; remedy: write \"sync\" or \"column\""),
    ('unit = "s"', 'unit = "min"', r'time.unit: "min" is not a unit of time'),
    (
        GRID,
        SYNC + "period_s = 0.03\n",
        r"time.period_s: a count lasts 0.03 s, and 0.05 s, a period of arm lively, is not a multiple",
    ),
    ('column = "l1"', 'colum = "l1"', r"link.column: is missing"),
    ('column = "t2"', 'column = "t1"', r"joint\[1\].torque: t1 is already that of shoulder.torque; remedy: name"),
    ('unit = "rad/s"', 'unit = "rad/s", sing = -1', r'gyro.x.sing: unknown key; remedy: did you mean "sign"'),
    ('unit = "rad/s"', 'unit = "rad/s", scale = 0', r"gyro.x.scale: is 0"),
    ('unit = "rad/s"', 'unit = "rad/s", sign = 0', r"gyro.x.sign: is 0"),
]


@pytest.mark.parametrize(("old", "new", "message"), REFUSED_MAPS)
def test_maps_that_are_refused(arm: Arm, tmp_path: Path, old: str, new: str, message: str) -> None:
    whole = GRID + JOINTS + GYRO
    assert old in whole
    with pytest.raises(ZygosError, match=message):
        mapping(tmp_path, arm, whole.replace(old, new, 1))


def test_a_fixed_base_has_no_gyro_and_a_rigid_joint_no_link(arm: Arm, tmp_path: Path) -> None:
    rigid = replace(arm.joints[0], flexible=False)
    ground = replace(arm, base="fixed", joints=(rigid, arm.joints[1]))
    with pytest.raises(ZygosError, match=r"joint\[0\].link: a rigid joint has only its motor's angle"):
        mapping(tmp_path, ground)
    text = SYNC + JOINTS.replace('link = { column = "l1", unit = "rad" }\n', "")
    with pytest.raises(ZygosError, match="gyro: the base of arm lively is fixed"):
        mapping(tmp_path, ground, text + GYRO)
    sent = some_cycles(12)
    write_columns(tmp_path / "x.npz", row(sent))
    chosen = mapping(tmp_path, ground, text)
    got = synchronous(read_table(tmp_path / "x.npz", chosen), chosen, ground).cycles
    assert np.array_equal(got.q, np.column_stack([sent.theta[:, 0], sent.q[:, 1]]))
    assert not got.omega.any()


# -- the counter ----------------------------------------------------------------------------------------------------


def counted(arm: Arm, tmp_path: Path, columns: dict[str, Floats], time: str = SYNC) -> tuple[Cycles, int, int]:
    chosen = mapping(tmp_path, arm, time + JOINTS + GYRO)
    write_columns(tmp_path / "x.npz", columns)
    run = synchronous(read_table(tmp_path / "x.npz", chosen), chosen, arm)
    return run.cycles, run.incomplete, run.repeated


def test_missing_and_repeated_cycles_are_left_out_and_break_the_run(arm: Arm, tmp_path: Path) -> None:
    columns = row(some_cycles(20))
    columns["l2"] = columns["l2"].copy()
    columns["l2"][5] = np.nan
    columns["n"] = columns["n"].copy()
    columns["n"][12] = 11
    got, incomplete, repeated = counted(arm, tmp_path, columns)
    assert (incomplete, repeated) == (1, 2)
    assert got.sync.tolist() == [*range(5), *range(6, 11), *range(13, 20)]
    assert np.flatnonzero(got.flags == BREAK_BEFORE).tolist() == [5, 10]


def test_a_counter_that_wraps_and_counts_milliseconds(arm: Arm, tmp_path: Path) -> None:
    columns = row(some_cycles(40))
    columns["n"] = (50 * np.arange(40) + 700) % 1000.0
    got, _, _ = counted(arm, tmp_path, columns, SYNC + "modulo = 1000\nperiod_s = 0.001\n")
    assert got.sync.tolist() == list(range(40))
    columns["n"][7] += 3
    with pytest.raises(ZygosError, match=r"time: counter n steps by 53 at value 8, a cycle has 50 counts"):
        counted(arm, tmp_path, columns, SYNC + "modulo = 1000\nperiod_s = 0.001\n")
    with pytest.raises(ZygosError, match="counter n decreases after value 6"):
        counted(arm, tmp_path, columns, SYNC)


def test_whole_turns_of_a_counter_are_seen_in_the_stamps() -> None:
    """An outage of exactly 240 counts, and stamps that lie by a count."""
    values = np.array([238.0, 239.0, 0.0, 1.0, 2.0])
    stamps = np.array([0.0, 1.8, 2.1, 243.2, 243.9])
    assert unwrap(values, 240.0, stamps).tolist() == [0, 1, 2, 243, 244]
    assert unwrap(values, 240.0, np.full(5, np.nan)).tolist() == [0, 1, 2, 3, 4]


def test_a_counter_whose_every_cycle_lacks_something(arm: Arm, tmp_path: Path) -> None:
    columns = row(some_cycles(20)) | {"wz": np.full(20, np.nan)}
    with pytest.raises(ZygosError, match=r"no cycle of n has each signal once; .*not finite"):
        counted(arm, tmp_path, columns)


def test_columns_that_are_refused(arm: Arm, tmp_path: Path) -> None:
    columns = row(some_cycles(20))
    renamed = {("link1" if name == "l1" else name): values for name, values in columns.items()}
    with pytest.raises(ZygosError, match=r'link: x.npz has no column "l1"; remedy: did you mean "(link1|l2)"'):
        counted(arm, tmp_path, renamed)
    with pytest.raises(ZygosError, match="has values that are not numbers"):
        counted(arm, tmp_path, columns | {"wz": np.full(20, "north")})
    with pytest.raises(ZygosError, match=r"time: column n of x\.npz has no value; remedy: name the column of the time"):
        counted(arm, tmp_path, columns | {"n": np.full(20, np.nan)})


def test_what_is_missing_in_a_table_is_counted(arm: Arm, tmp_path: Path) -> None:
    """Rows without time, and single values: with a counter their cycles are missing, on a grid they are bridged."""
    columns = row(some_cycles(60)) | {"t": 0.05 * np.arange(60)}
    for name, at in (("n", 3), ("t", 3), ("l1", 7), ("l1", 20), ("wz", 8)):
        columns[name] = np.where(np.arange(60) == at, np.nan, columns[name])
    for text, lost in (
        (SYNC + JOINTS + GYRO, {"rows without time": 1, "incomplete cycles": 3}),
        (GRID + JOINTS + GYRO, {"rows without time": 1, "missing values": 3}),
    ):
        chosen = mapping(tmp_path, arm, text)
        write_columns(tmp_path / "x.npz", columns)
        _, _, left_out = cycles_of(read_table(tmp_path / "x.npz", chosen), chosen, arm)
        assert {name: count for name, count in left_out.items() if count} == lost


def test_a_signal_without_a_value(arm: Arm, tmp_path: Path) -> None:
    chosen = mapping(tmp_path, arm)
    write_columns(tmp_path / "x.npz", row(some_cycles(20)) | {"t2": np.full(20, np.nan)})
    with pytest.raises(ZygosError, match=r"joint\[1\].torque: t2 has 0 samples; remedy"):
        tracks(read_table(tmp_path / "x.npz", chosen), chosen)


# -- the grid -------------------------------------------------------------------------------------------------------

CHANNEL = Channel("shoulder.link", "q", 0, "angle", "l1", "rad", 1.0, 0.0, True, "map.toml: joint[0].link")


def angle(t: Floats) -> Floats:
    """A motion that is known at every instant, up to 1.3 Hz."""
    return 0.8 * np.sin(1.7 * t) + 0.4 * np.cos(4.1 * t + 0.3) + 0.05 * np.sin(8.2 * t)


def stamps_of(kind: str, h: float, seed: int) -> tuple[Floats, Floats]:
    """When samples were taken, and when their stamps say so: at a rate of 1/h for a minute."""
    even = h * np.arange(round(60.0 / h))
    off = h * np.random.default_rng(seed).uniform(-0.2, 0.2, len(even))
    return {"even": (even, even), "uneven": (even + off, even + off), "lying": (even, even + off)}[kind]


@pytest.mark.parametrize("kind", ["even", "uneven", "lying"])
@pytest.mark.parametrize("how", ["linear", "cubic"])
def test_what_the_grid_errs_is_what_it_says(kind: str, how: str) -> None:
    """At twice the rate of the grid, stamps 20 % off: the added sigma is neither exceeded nor much too large."""
    sigma = 3e-4
    shares = []
    for seed in range(10):
        taken, stamped = stamps_of(kind, 0.025, seed)
        x = angle(taken) + sigma * np.random.default_rng(100 + seed).standard_normal(len(taken))
        track = Track(CHANNEL, stamped, x)
        at = 0.05 * np.arange(5, 1190) + 0.011
        error = interpolate(track, at, how) - angle(at)
        assert np.all(np.isfinite(error))
        stated = math.sqrt(sigma**2 + sum(interpolation_variance(track, how, sigma)))
        shares.append(float(np.sqrt(np.mean(error**2))) / stated)
        assert np.max(np.abs(error)) < 6.0 * stated
    print(kind, how, stated, np.mean(shares))
    assert max(shares) < 1.1
    assert min(shares) > 0.4


def test_a_clean_fast_recording_adds_next_to_nothing() -> None:
    taken, stamped = stamps_of("even", 0.01, 0)
    track = Track(CHANNEL, stamped, angle(taken) + 1e-3 * np.random.default_rng(0).standard_normal(len(taken)))
    assert sum(interpolation_variance(track, "cubic", 1e-3)) < 2e-4**2
    assert sum(interpolation_variance(track, "cubic", 1e-4)) > 5e-4**2  # the samples err by more than the arm file says


def test_the_mean_of_a_held_torque_is_its_impulse() -> None:
    """Against a sum over 0.1 ms."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.02, 0.03, 200))
    x = rng.normal(size=200)
    track = Track(replace(CHANNEL, field="tau", quantity="torque"), t, x)
    begin = t[0] + 0.05 * np.arange(80)
    fine = begin[:, None] + 1e-4 * (np.arange(500) + 0.5)
    expected = x[np.searchsorted(t, fine, side="right") - 1].mean(axis=1)
    assert np.max(np.abs(held_mean(track, begin, 0.05) - expected)) < 0.02
    assert math.isnan(held_mean(track, np.array([t[0] - 0.01]), 0.05)[0])
    assert math.isnan(held_mean(track, np.array([t[-1]]), 0.05)[0])


@pytest.mark.parametrize("law", ["applied_from_sync", "applied_previous_cycle", "sampled"])
def test_the_torque_record_follows_the_torque_law(arm: Arm, tmp_path: Path, law: str) -> None:
    """A ramp in steps of 25 ms, on a grid of 50 ms that begins with it."""
    sent = some_cycles(200)
    sent = replace(sent, tau=np.column_stack([np.arange(200.0), np.arange(200.0)]))
    text = GRID.replace('"s"', '"ms"') + JOINTS + GYRO
    columns = row(sent) | {"t": 25.0 * np.arange(200)}
    write_columns(tmp_path / "x.npz", columns)
    other = replace(arm, torque_law=law)
    chosen = mapping(tmp_path, other, text)
    got = regrid(tracks(read_table(tmp_path / "x.npz", chosen), chosen), other, chosen)
    first = {"applied_from_sync": 0.5, "applied_previous_cycle": 0.5, "sampled": 0.0}[law]
    assert got.tau[:5, 0] == pytest.approx(first + 2.0 * np.arange(5))
    shift = 1 if law == "applied_previous_cycle" else 0  # before the first sample no torque is known
    assert got.q[:5, 0] == pytest.approx(sent.q[2 * shift : 2 * shift + 10 : 2, 0])


def test_nothing_is_interpolated_over_a_hole(arm: Arm, tmp_path: Path) -> None:
    sent = some_cycles(400)
    columns = {name: values[np.r_[0:150, 153:300, 301:400]] for name, values in row(sent).items()}
    write_columns(tmp_path / "x.npz", columns)
    chosen = mapping(tmp_path, arm)
    recording = read_table(tmp_path / "x.npz", chosen)
    got = regrid(tracks(recording, chosen), arm, chosen)
    # the torque at 149 is held into the hole; one sample that is missing at 300 is no hole
    assert sorted(set(range(399)) - set(got.sync.tolist())) == [150, 151, 152]
    assert got.sync[np.flatnonzero(got.flags)].tolist() == [153]


@pytest.mark.slow(only=["2*", "60*"])
@pytest.mark.parametrize(("missing", "bridged_gaps"), [(2, 85), (11, 85), (60, 0)])
def test_a_gap_is_bridged_if_the_motion_allows_it(arm: Arm, missing: int, bridged_gaps: int) -> None:
    """Samples of 2 ms on a grid of 10 ms: gaps of 6 or 24 ms cost nothing, and their values are as good as the others;
    the motion of 1.3 Hz does not allow 122 ms."""
    fine = replace(arm, period_s=0.01)
    t = 0.002 * np.arange(30_000)
    x = angle(t) + 3e-4 * np.random.default_rng(0).standard_normal(len(t))
    gaps = np.random.default_rng(1).choice(np.arange(100, 29_800, 100), 85, replace=False)
    kept = np.delete(np.arange(len(t)), (gaps[:, None] + np.arange(missing)).ravel())
    chosen = Map(Clock("receive", interpolation="cubic"), (CHANNEL,))
    at = 0.02 + 0.01 * np.arange(5990)
    track = Track(CHANNEL, t[kept], x[kept])
    whole = bridged(track, at, fine, chosen)
    assert np.count_nonzero(whole.gaps_s <= whole.bridge_s) == bridged_gaps
    assert int(whole.holes.sum()) == 85 - bridged_gaps
    error = resampled(whole, at, fine, chosen) - angle(at)
    assert np.mean(np.isfinite(error)) == 1.0 if bridged_gaps else np.mean(np.isfinite(error)) < 0.9
    assert np.nanmax(np.abs(error)) < 6.0 * 3e-4


@pytest.mark.parametrize(("missing", "bridged_gaps"), [(2, 20), (12, 0)])
def test_a_gap_that_interpolation_would_fill_wrongly_is_a_hole(arm: Arm, missing: int, bridged_gaps: int) -> None:
    """Samples at twice the rate of the grid: 75 ms of the motion are a cubic, 325 ms are not."""
    t = 0.025 * np.arange(2400)
    gaps = np.arange(100, 2300, 110)
    kept = np.delete(np.arange(len(t)), (gaps[:, None] + np.arange(missing)).ravel())
    chosen = Map(Clock("receive", interpolation="cubic"), (CHANNEL,))
    track = Track(CHANNEL, t[kept], angle(t[kept]))
    whole = bridged(track, 0.1 + 0.05 * np.arange(1190), arm, chosen)
    assert np.count_nonzero(whole.gaps_s <= whole.bridge_s) == bridged_gaps


def test_samples_on_the_grid_are_taken_as_they_are(arm: Arm, tmp_path: Path) -> None:
    """Bit for bit, whatever they are, and nothing is added to their noise."""
    for law in ("applied_from_sync", "applied_previous_cycle", "sampled"):
        other, sent = replace(arm, torque_law=law), some_cycles(200)
        write_columns(tmp_path / "x.npz", row(sent) | {"t": 17.0 + 0.05 * np.arange(200)})
        chosen = mapping(tmp_path, other)
        found = tracks(read_table(tmp_path / "x.npz", chosen), chosen)
        got = regrid(found, other, chosen)
        late = law == "applied_previous_cycle"  # its first torque is that of the cycle before
        for name in ("q", "theta", "omega"):
            assert np.array_equal(getattr(got, name), getattr(sent, name)[late:][: len(got)]), name
        assert np.array_equal(got.tau, sent.tau[: len(got)])
        at = instants(found, other, chosen)
        assert [grid_noise(track, at, other, chosen) for track in found] == [Noise()] * 9


def test_a_signal_beside_the_grid_costs_by_its_distance() -> None:
    """0.5 ms of 50 ms: what the interpolation adds is the error that it makes there."""
    t = 0.05 * np.arange(1200)
    track, at = Track(CHANNEL, t, angle(t)), 0.0505 + 0.05 * np.arange(1190)
    stated = math.sqrt(sum(interpolation_variance(track, "linear", 0.0, at)))
    error = float(np.sqrt(np.mean((interpolate(track, at, "linear") - angle(at)) ** 2)))
    assert 0.7 < error / stated < 1.1
    assert stated < 0.05 * math.sqrt(sum(interpolation_variance(track, "linear", 0.0)))


def test_a_delay_is_taken_off_the_stamps(arm: Arm, tmp_path: Path) -> None:
    """One signal is measured 20 ms before its stamp, another one 10 ms after."""
    late = ('"t1", unit = "Nm"', '"t1", unit = "Nm", delay_s = 0.02')
    early = ('"m2", unit = "rad"', '"m2", unit = "rad", delay_s = -0.01')
    text = (GRID + JOINTS + GYRO).replace(*late).replace(*early)
    write_columns(tmp_path / "x.npz", row(some_cycles(200)))
    chosen = mapping(tmp_path, arm, text)
    begins = {track.channel.label: track.t[0] for track in tracks(read_table(tmp_path / "x.npz", chosen), chosen)}
    assert begins["shoulder.torque"] == pytest.approx(-0.02)
    assert begins["elbow.motor"] == pytest.approx(0.01)
    assert begins["elbow.torque"] == 0.0
    counted_map = text.replace(GRID, SYNC)
    with pytest.raises(ZygosError, match=r'torque.delay_s: with source = "sync" .* remedy: write in \[time\] source'):
        mapping(tmp_path, arm, counted_map)


def test_holes_of_one_signal_only(arm: Arm) -> None:
    h = 0.05
    slow = Track(CHANNEL, np.r_[0.0:10.0:h, 12.0:20.0:h], np.arange(len(np.r_[0.0:10.0:h, 12.0:20.0:h]), dtype=float))
    at = np.array([9.94, 9.96, 11.0, 12.01])
    assert np.isfinite(interpolate(slow, at, "linear")).tolist() == [True, False, False, True]
    assert np.isfinite(interpolate(slow, at, "hold")).tolist() == [True, False, False, True]


STAMPS: list[tuple[Callable[[Floats], Floats], str]] = [
    (lambda t: np.where(t > 5.0, t - 3.0, t), r"goes backwards at sample 102 \(1 time in all\); remedy: remove"),
    (
        lambda t: np.where(t < 0.1, t + 100.0, t),
        r"goes backwards at sample 3 \(1 time in all\); remedy: remove the first 2 samples, whose times are later",
    ),
    (lambda t: t[np.r_[0:200:2, 1:200:2].argsort()[::-1]], r"goes backwards .*; remedy: sort the recording, state the"),
    (lambda t: np.where(t < 0.1, t - 1e5, t), r"spans .* remove samples whose times are wrong, at the beginning"),
    (
        lambda t: np.round(t, 1),
        r"99 of 200 time stamps of \S+ are repeated, with other values; remedy: use a time source with finer steps",
    ),
    (lambda t: np.where(t > 5.0, t + 1.7e9, t), "spans .* times the time of its samples"),
    (lambda t: t[:5], "has 5 samples"),
]


@pytest.mark.parametrize(("spoil", "message"), STAMPS)
def test_stamps_that_are_refused(arm: Arm, tmp_path: Path, spoil: Callable[[Floats], Floats], message: str) -> None:
    columns = row(some_cycles(200))
    t = spoil(columns["t"])
    columns = {name: values[: len(t)] for name, values in columns.items()} | {"t": t}
    write_columns(tmp_path / "x.npz", columns)
    chosen = mapping(tmp_path, arm)
    with pytest.raises(ZygosError, match=message):
        regrid(tracks(read_table(tmp_path / "x.npz", chosen), chosen), arm, chosen)


def test_a_clock_with_a_modulo(arm: Arm, tmp_path: Path) -> None:
    """Milliseconds of 16 bits wrap; a step backwards is no wrap. Nanoseconds since 1970 keep their digits."""
    sent = some_cycles(200)
    text = GRID.replace('"s"', '"ms"') + "modulo = 65536\n" + JOINTS + GYRO
    wrapping = (50 * np.arange(200) + 60_000) % 65536
    chosen = mapping(tmp_path, arm, text)
    write_columns(tmp_path / "x.npz", row(sent) | {"t": wrapping})
    got = regrid(tracks(read_table(tmp_path / "x.npz", chosen), chosen), arm, chosen)
    assert np.max(np.abs(got.q - sent.q[: len(got)])) < 1e-9
    wrapping[180] -= 120
    write_columns(tmp_path / "x.npz", row(sent) | {"t": wrapping})
    with pytest.raises(ZygosError, match="the time of t goes backwards at sample 181"):
        tracks(read_table(tmp_path / "x.npz", chosen), chosen)
    chosen = mapping(tmp_path, arm, GRID.replace('"s"', '"ns"') + JOINTS + GYRO)
    epoch = 1_700_000_000_123_456_789 + 50_000_000 * np.arange(200, dtype=np.uint64)
    write_columns(tmp_path / "x.npz", row(sent) | {"t": epoch})
    found = tracks(read_table(tmp_path / "x.npz", chosen), chosen)
    assert np.max(np.abs(found[0].t - 0.05 * np.arange(200))) < 1e-14


def test_a_repeated_stamp_counts_once(arm: Arm, tmp_path: Path) -> None:
    columns = row(some_cycles(200))
    columns["t"] = columns["t"].copy()
    columns["t"][50] = columns["t"][51]
    write_columns(tmp_path / "x.npz", columns)
    chosen = mapping(tmp_path, arm)
    found = tracks(read_table(tmp_path / "x.npz", chosen), chosen)
    assert [track.repeated for track in found] == [1] * 9
    assert found[0].x[50] == columns["l1"][51]


# -- the rate that a motion needs -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fine(scenario: Scenario, model: Model, arm: Arm) -> tuple[Arm, Cycles]:
    """The arm of examples/lively with encoders of 0.1 mrad, 20 s at 200 Hz."""
    sharp = replace(
        arm,
        joints=tuple(
            replace(
                joint,
                link_encoder=replace(joint.link_encoder, quantum_rad=1e-4),
                motor_encoder=replace(joint.motor_encoder, quantum_rad=1e-4),
            )
            for joint in arm.joints
        ),
    )
    run = trajectory_of(
        sharp, model, scenario, seeds=[0], noise=True, period_s=0.005, duration_s=40.0, rtol=1e-9, atol=1e-11
    )
    return sharp, run.cycles()


@pytest.fixture(scope="module")
def quick() -> tuple[Arm, Cycles]:
    """The arm of examples/gap, 20 bit, 20 s at 200 Hz."""
    folder = ROOT / "examples" / "gap"
    from zygos.model.model import load_model

    scenario, arm = load_scenario(folder / "b.toml"), load_arm(folder / "arm.toml")
    plant = load_model(scenario.plant)
    return arm, trajectory_of(
        arm, plant, scenario, seeds=[0], noise=True, duration_s=20.0, rtol=1e-9, atol=1e-11
    ).cycles()


def thinned(arm: Arm, cycles: Cycles, step: int) -> tuple[Arm, Cycles]:
    """Every step-th cycle, as if the arm had been sampled so."""
    picked = {name: getattr(cycles, name)[::step] for name in Cycles.__dataclass_fields__}
    picked["sync"] = np.arange(len(picked["q"]), dtype=np.uint64)
    return replace(arm, period_s=arm.period_s * step), Cycles(**picked)


def refused(arm: Arm, cycles: Cycles, step: int) -> float:
    """Share that the C library refuses of the true motion, sampled so."""
    slower, run = thinned(arm, cycles, step)
    flight = Flight(slower)
    flight.cycles(run)
    return flight.counts["refused"] / (flight.counts["accepted"] + flight.counts["refused"])


@pytest.mark.slow
@pytest.mark.parametrize("which", ["fine", "quick"])
@pytest.mark.parametrize("step", [8, 16, 20, 40])
def test_the_rate_that_a_motion_needs(
    request: pytest.FixtureRequest, tmp_path: Path, arm: Arm, which: str, step: int
) -> None:
    """From a recording that is too slow alone; the C library then says of the true motion that this rate is enough,
    and half of it is not."""
    whole, cycles = request.getfixturevalue(which)
    whole = replace(whole, period_s=0.005)
    slower, run = thinned(whole, cycles, step)
    chosen = mapping(tmp_path, arm, SYNC + JOINTS + GYRO)
    rate, needed = needed_rate(tracks_of(run, slower, chosen), slower, chosen)
    assert rate == pytest.approx(200.0 / step)
    assert needed is not None
    enough = round(200.0 / needed)
    print(which, rate, needed, refused(whole, cycles, enough))
    assert refused(whole, cycles, max(enough, 1)) <= 0.06
    if enough * 2 * 0.005 <= 0.065:
        assert refused(whole, cycles, enough * 2) > 0.05 or needed == pytest.approx(rate)


# -- tables of cycles -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
def test_a_table_of_cycles_keeps_every_bit(arm: Arm, tmp_path: Path, suffix: str) -> None:
    sent = replace(some_cycles(50), flags=np.arange(50, dtype=np.uint32) % 2)
    write_cycles(tmp_path / f"x{suffix}", sent)
    got = read_cycles(tmp_path / f"x{suffix}", arm)
    for name in Cycles.__dataclass_fields__:
        assert np.array_equal(getattr(got, name), getattr(sent, name)), name
        assert getattr(got, name).dtype == getattr(sent, name).dtype


def test_the_columns_of_a_csv_have_their_names(tmp_path: Path) -> None:
    write_cycles(tmp_path / "x.csv", some_cycles(2))
    names = (tmp_path / "x.csv").read_text().splitlines()[0]
    assert names == "sync,q1,q2,theta1,theta2,tau1,tau2,wx,wy,wz,flags"


def european(text: str, separator: str, decimal: str) -> str:
    """A CSV with another separator and decimal mark."""
    return text.replace(",", separator).replace(".", decimal)


FORMS = [(";", ","), (";", "."), ("\t", "."), ("\t", ","), ("|", "."), (",", ".")]


@pytest.mark.parametrize(("separator", "decimal"), FORMS)
@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("names", [True, False])
def test_a_csv_in_another_form(mark: str, separator: str, decimal: str, names: bool, tmp_path: Path) -> None:
    """With and without the names of the columns, against the same numbers in an ordinary CSV."""
    write_cycles(tmp_path / "x.csv", some_cycles(3))
    text = european((tmp_path / "x.csv").read_text(), separator, decimal)
    (tmp_path / "y.csv").write_text(mark + (text if names else text.partition("\n")[2]), encoding="utf-8")
    expected, got = (read_columns(tmp_path / name) for name in ("x.csv", "y.csv"))
    assert list(got) == (list(expected) if names else [str(k) for k in range(1, len(expected) + 1)])
    for one, other in zip(expected.values(), got.values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_whole_numbers_before_the_first_decimal_comma(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("1;2\n" * 30 + "0,5;-1,25e1\n")
    columns = read_columns(tmp_path / "x.csv")
    assert (columns["1"][-1], columns["2"][-1]) == (0.5, -12.5)


def test_columns_of_a_table_without_names_are_named_by_their_numbers(arm: Arm, tmp_path: Path) -> None:
    sent = some_cycles(60)
    columns = row(sent) | {"t": 0.05 * np.arange(60)}
    (tmp_path / "x.csv").write_text(
        "\n".join(
            ";".join(f"{value}".replace(".", ",") for value in line) for line in zip(*columns.values(), strict=True)
        )
    )
    text = GRID + JOINTS + GYRO
    for number, name in enumerate(columns, start=1):
        text = text.replace(f'column = "{name}"', f'column = "{number}"')
    chosen = mapping(tmp_path, arm, text)
    got = regrid(tracks(read_table(tmp_path / "x.csv", chosen), chosen), arm, chosen)
    np.testing.assert_allclose(got.q, sent.q[: len(got)], atol=1e-12)
    wrong = mapping(tmp_path, arm, text.replace('column = "2"', 'column = "21"'))
    with pytest.raises(ZygosError, match=r'x\.csv has no column "21"; remedy: '):
        read_table(tmp_path / "x.csv", wrong)


def test_a_csv_with_commas_for_both_says_so(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text('t,q\n"0,05","1,25"\n')
    with pytest.raises(ZygosError, match=r"x\.csv: numbers have a decimal comma, and columns are .* remedy: "):
        read_columns(tmp_path / "x.csv")


@pytest.mark.parametrize("text", ["\ufefft,q\n0.5,1\n1.5,2\n", "t,q;r\n0.5,1\n1.5,2\n", '"t","q"\n0.5,1\n1.5,2\n'])
def test_a_csv_with_commas_is_read(text: str, tmp_path: Path) -> None:
    """With the mark that spreadsheets put before the first name, and with a name that holds another separator."""
    (tmp_path / "x.csv").write_text(text, encoding="utf-8")
    columns = read_columns(tmp_path / "x.csv")
    assert list(columns) == ["t", "q;r" if ";" in text else "q"]
    np.testing.assert_array_equal(columns["t"], [0.5, 1.5])


@pytest.mark.parametrize("separator", [", ", " ; ", "\t"])
@pytest.mark.parametrize("missing", ["nan", "NaN", "NA", " ", "null", "-nan"])
def test_spaces_and_missing_values_of_a_csv(separator: str, missing: str, tmp_path: Path) -> None:
    lines = (("t", "n", "q"), ("1714564800000000001", "7", "-1.5e1"), ("1714564800000000003", missing, missing))
    (tmp_path / "x.csv").write_text("\n".join(separator.join(line) for line in lines))
    columns = read_columns(tmp_path / "x.csv")
    assert columns["t"].tolist() == [1714564800000000001, 1714564800000000003]
    np.testing.assert_array_equal(columns["n"], [7.0, np.nan])
    np.testing.assert_array_equal(columns["q"], [-15.0, np.nan])


def test_missing_values_beside_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t;q\n0,5; nan\n1,5; -2,5e1\n")
    columns = read_columns(tmp_path / "x.csv")
    np.testing.assert_array_equal(columns["q"], [np.nan, -25.0])
    np.testing.assert_array_equal(columns["t"], [0.5, 1.5])


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-16-be", "utf-8"])
@pytest.mark.parametrize("separator", [",", ";"])
def test_a_csv_in_another_encoding(separator: str, encoding: str, tmp_path: Path) -> None:
    text = f"t{separator}q [°]\n0.5{separator}2\n1.5{separator}3\n"
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    (tmp_path / "x.csv").write_bytes((mark + text).encode(encoding))
    columns = read_columns(tmp_path / "x.csv")
    assert list(columns) == ["t", "q [°]"]
    np.testing.assert_array_equal(columns["q [°]"], [2, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# my arm\nt,q\n0.5,2\n", r"the columns begin below '# my arm', in row 2"),
        ("my arm\nof May\n\nt;q\n0.5;2\n", r"the columns begin below 'my arm', in row 3"),
        ("t q\n0.5 2\n", r"columns are separated by spaces; remedy: export it with commas"),
        ("0.5  2\n0.6  2\n", r"columns are separated by spaces"),
    ],
)
def test_a_csv_whose_columns_are_not_found(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(ZygosError, match=message):
        read_columns(tmp_path / "x.csv")


def test_the_first_value_that_is_no_number_is_named(arm: Arm, tmp_path: Path) -> None:
    write_columns(tmp_path / "x.csv", row(some_cycles(20)))
    lines = (tmp_path / "x.csv").read_text().splitlines()
    lines.insert(1, ",".join(["s"] * len(lines[0].split(","))))
    (tmp_path / "x.csv").write_text("\n".join(lines))
    chosen = mapping(tmp_path, arm)
    with pytest.raises(ZygosError, match=r'not numbers \(row 1 below the names has "s"\); remedy'):
        read_table(tmp_path / "x.csv", chosen)


def test_single_values_in_an_npz_and_decimals_in_a_parquet(tmp_path: Path) -> None:
    import polars

    np.savez(tmp_path / "x.npz", t=np.arange(3), rate_hz=500.0, name="arm")
    assert list(read_columns(tmp_path / "x.npz")) == ["t"]
    polars.DataFrame({"t": polars.Series(["0.5", "1.25"]).cast(polars.Decimal(18, 6))}).write_parquet(
        tmp_path / "x.parquet"
    )
    np.testing.assert_array_equal(read_columns(tmp_path / "x.parquet")["t"], [0.5, 1.25])


BAD_TABLES = [
    ("q2,", "p2,", r"has no column q2; remedy: it needs sync q1 q2"),
    ("flags\n", "flags,tau3\n", r"tau3 is no column of a cycle table of 2 joints"),
    ("\n1,", "\n0,", r"sync does not increase after row 1 \(0, then 0\)"),
    ("\n1,", "\n1.5,", r"column sync has values that are not whole numbers"),
    ("\n1,", "\none,", r"column sync has values that are not whole numbers"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_TABLES)
def test_tables_of_cycles_that_are_refused(arm: Arm, tmp_path: Path, old: str, new: str, message: str) -> None:
    write_cycles(tmp_path / "x.csv", some_cycles(3))
    changed = edited(tmp_path / "x.csv", tmp_path / "y.csv", (old, new))
    if "tau3" in new:
        lines = changed.read_text().splitlines()
        changed.write_text("\n".join([lines[0], *(line + ",0" for line in lines[1:])]) + "\n")
    with pytest.raises(ZygosError, match=message):
        read_cycles(changed, arm)


def test_files_that_are_no_tables(tmp_path: Path) -> None:
    for name in ("x.csv", "x.npz", "x.parquet"):
        with pytest.raises(ZygosError, match="no such file"):
            read_columns(tmp_path / name)
        (tmp_path / name).write_bytes(b"\x00\x01PK nothing")
        if name != "x.csv":
            with pytest.raises(ZygosError, match=r"not a readable \.\w+ table"):
                read_columns(tmp_path / name)
    np.savez(tmp_path / "o.npz", x=np.array([{}], dtype=object))
    with pytest.raises(ZygosError, match=r"not a readable \.npz table"):
        read_columns(tmp_path / "o.npz")
    np.savez(tmp_path / "u.npz", x=np.zeros(3), y=np.zeros(4))
    with pytest.raises(ZygosError, match=r"different numbers of rows: x has 3, y has 4; remedy: "):
        read_columns(tmp_path / "u.npz")
    (tmp_path / "e.csv").write_text("a,b\n")
    with pytest.raises(ZygosError, match="has no row"):
        read_columns(tmp_path / "e.csv")


def test_without_polars_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "polars", None)
    (tmp_path / "x.parquet").touch()
    with pytest.raises(ZygosError, match=r"pip install 'zygos\[tables\]'"):
        read_columns(tmp_path / "x.parquet")


def test_recordings_of_an_even_train_have_no_stamp_noise() -> None:
    assert Track(CHANNEL, 0.1 * np.arange(50), np.zeros(50)).stamp_sigma_s < 1e-12
