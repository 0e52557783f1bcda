# SPDX-License-Identifier: MIT
"""Samples that no arm could have produced: each is found, and no motion, step or coarse reading is taken for one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from zygos.errors import ZygosError
from zygos.runs.outliers import outliers, steps_off, two_courses
from zygos.telemetry.map import Channel, Clock, Map, Recording, SourceSamples
from zygos.telemetry.mend import Mended, mended

Floats = NDArray[np.float64]
N = 4000
T = 0.002 * np.arange(N)
MOTION = 0.8 * np.sin(1.7 * T) + 0.4 * np.cos(9.1 * T + 0.3)
"""An angle with rates of up to 5 rad/s."""


def noisy(seed: int, sigma: float = 1e-4) -> Floats:
    angle: Floats = MOTION + sigma * np.random.default_rng(seed).standard_normal(N)
    return angle


def some(seed: int, count: int) -> NDArray[np.int64]:
    """Places that are not next to each other."""
    return np.sort(np.random.default_rng(seed).choice(np.arange(5, N - 5, 3), count, replace=False))


# -- outliers -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.0, 99.99, -3.2768, None])
@pytest.mark.parametrize("count", [1, 20, 80])
def test_spikes_and_codes_are_found_and_nothing_else(value: float | None, count: int) -> None:
    at = some(count, count)
    x = noisy(1)
    x[at] = x[at] + np.random.default_rng(2).choice([-0.3, 0.3], count) if value is None else value
    clear = at[np.abs(x[at] - MOTION[at]) > 0.01]
    found = outliers(x, 1e-4)
    assert set(clear) <= set(found) <= set(at)


def test_short_bursts_are_found() -> None:
    at = some(3, 20)[::2]
    x = noisy(1)
    for k in at:
        x[k : k + 3] = 0.2 + MOTION[k]
    assert set(outliers(x, 1e-4)) == {int(k) + i for k in at for i in range(3)}


def stick_slip(rng: np.random.Generator) -> Floats:
    """A torque that jumps at each reversal, and commanded steps."""
    return 0.3 * np.sign(np.cos(9.1 * T)) + np.repeat(rng.normal(size=N // 40), 40) + 0.01 * rng.standard_normal(N)


POSSIBLE: dict[str, Callable[[np.random.Generator], Floats]] = {
    "noise alone": lambda rng: rng.standard_normal(N),
    "coarse steps": lambda rng: np.round((MOTION + 1e-4 * rng.standard_normal(N)) / 0.01) * 0.01,
    "one count at rest": lambda rng: 1e-3 * (rng.random(N) < 0.02),
    "rest, then at full speed": lambda rng: np.where(T < 4.0, 0.0, 3.0 * (T - 4.0)),
    "a stop against an end": lambda rng: np.minimum(2.0 * T, 5.0),
    "a vibration that begins": lambda rng: np.where(T < 4.0, 0.0, np.sin(800.0 * (T - 4.0))),
    "a knock that rings": lambda rng: 0.05 * np.exp(-np.maximum(T - 4.0, 0) * 40) * np.sin(400 * np.maximum(T - 4, 0)),
    "sampled slowly": lambda rng: np.sin(1.7 * 50 * T),
}


@pytest.mark.parametrize("kind", POSSIBLE)
def test_what_an_arm_can_do_is_no_outlier(kind: str) -> None:
    for seed in range(5):
        x = POSSIBLE[kind](np.random.default_rng(seed))
        assert len(outliers(x, 0.0)) == 0
        assert len(two_courses(x, 0.0)) == 0


def test_an_angle_that_flickers_about_the_end_of_its_turn_has_no_outliers() -> None:
    x = np.mod(0.04 * (np.arange(N) % 100 > 0) - 0.02 + 0.003 * np.random.default_rng(1).standard_normal(N), 360.0)
    assert np.count_nonzero(x > 359.0) == N // 100
    assert len(outliers(x, 0.005, [360.0])) == 0
    assert len(outliers(x, 0.005)) == N // 100 - 1  # all but the first sample, which has no neighbours on both sides


def test_a_step_that_stays_is_found_as_a_step() -> None:
    x = noisy(1) + np.where(T >= 4.0, 0.5, 0.0)
    off = steps_off(x, np.ones(N - 1), 1e-4)
    assert np.flatnonzero(off).tolist() == [1999]
    assert off[1999] == pytest.approx(0.5, abs=0.01)
    assert not steps_off(noisy(1), np.ones(N - 1), 1e-4).any()
    assert len(outliers(x, 1e-4)) == 0


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_two_sources_of_one_signal_are_told_apart(share: float) -> None:
    second = np.random.default_rng(4).random(N) < share
    for other in (np.full(N, 3.0), MOTION + 2.0):
        found = np.isin(np.arange(N), two_courses(np.where(second, other, noisy(1)), 1e-4))
        assert np.mean(found == second) > 0.999 or np.mean(found != second) > 0.999  # but for the first ones


# -- recordings -----------------------------------------------------------------------------------------------------

ANGLE = Channel(
    *("elbow.motor", "theta", 1, "angle", "m", "deg", math.radians(1.0), 0.0, True, "map.toml: joint[1].motor"),
    turn=360.0,
)
TORQUE = replace(
    ANGLE, label="elbow.torque", field="tau", quantity="torque", source="y", unit="Nm", gain=1.0, turn=math.inf
)
DEGREES = np.degrees(MOTION) + 0.006 * np.round(np.random.default_rng(5).standard_normal(N))
LOAD = np.cos(1.7 * T) + 0.01 * np.random.default_rng(6).standard_normal(N)


def mend(
    angle: Floats, torque: Floats = LOAD, *, t: NDArray[Any] = T, width: float | None = None, **keys: Any
) -> Mended:
    """A table of an angle in degrees and a torque, through `mended`."""
    rows, nowhere = np.arange(len(angle)), np.full(len(angle), np.nan)
    sources = {
        "m": SourceSamples(angle, rows, nowhere, width),
        "y": SourceSamples(torque, rows, nowhere),
    }
    channels = (replace(ANGLE, **keys), TORQUE)
    mapping = Map(Clock("column", "t", interpolation="cubic"), channels)
    return mended(Recording(sources, t, nowhere, None), {"m": t, "y": t}, mapping, {"m": 1e-4, "y": 0.0})


def values(of: Mended, source: str = "m") -> Floats:
    return of.recording.sources[source].value


def test_a_sound_recording_keeps_every_bit() -> None:
    for width in (None, 655.36):
        sound = mend(DEGREES, width=width)
        assert values(sound) is DEGREES or np.array_equal(values(sound), DEGREES)
        assert (sound.turns, sound.left_out, sound.warnings) == ({"m": 0, "y": 0}, {"m": 0, "y": 0}, ())


@pytest.mark.parametrize("modulo", [360.0, 40.96])
def test_an_angle_is_unwrapped_by_its_modulo_or_its_width(modulo: float) -> None:
    wrapped = np.mod(DEGREES, modulo)
    for unwrapped in (mend(wrapped, modulo=modulo), mend(wrapped, width=modulo)):
        moved = values(unwrapped) - DEGREES
        assert np.ptp(moved) < 1e-9
        assert unwrapped.turns["m"] == np.count_nonzero(np.abs(np.diff(wrapped)) > 0.5 * modulo)
        if modulo == 360.0:
            assert unwrapped.warnings == ()
        else:  # 40.96° of the arm: in which of them it begins, nobody knows
            (said,) = unwrapped.warnings
            assert "if the angle did not begin at" in said and "write offset = 40.96 in the map for each turn" in said


@pytest.mark.parametrize("keys", [{}, {"width": 655.36}, {"modulo": 100.0}])
def test_a_wrap_that_nothing_explains_is_refused_with_its_modulo(keys: dict[str, Any]) -> None:
    with pytest.raises(
        ZygosError, match=r"m jumps in \d+ places, first in row \d+ .* remedy: write modulo = 360 there"
    ):
        mend(np.mod(DEGREES, 360.0), **keys)


def test_a_code_at_the_end_of_the_range_does_not_disturb_the_turns() -> None:
    """32767 between counts that wrap at 65536, in a signal of 16 bits."""
    counts = np.mod(np.round(DEGREES * 3000.0), 65536.0)
    at = some(7, 15)
    counts[at] = 32767.0
    out = mend(counts, width=65536.0, gain=math.radians(1 / 3000.0), turn=360.0 * 3000.0)
    kept = out.recording.sources["m"].group
    assert np.ptp(values(out) / 3000.0 - DEGREES[kept]) < 1e-3
    assert out.left_out["m"] >= 13


def test_turns_in_a_gap_are_counted_by_the_motion_on_both_sides() -> None:
    turning = 3000.0 * T
    kept = np.flatnonzero((T < 4.0) | (T > 4.1))
    got = mend(np.mod(turning, 360.0)[kept], LOAD[kept], t=T[kept], modulo=360.0)
    assert np.max(np.abs(values(got) - turning[kept])) < 1e-9
    unsure = 3000.0 * np.sin(T)
    with pytest.raises(ZygosError, match=r"moves so far in row 2001, since the sample before, that its turns cannot"):
        kept = np.flatnonzero((T < 4.0) | (T > 4.3))
        mend(np.mod(unsure, 360.0)[kept], LOAD[kept], t=T[kept], modulo=360.0)


def test_outliers_are_left_out_with_their_row_and_named() -> None:
    at = some(8, 12)
    angle, torque = DEGREES.copy(), LOAD.copy()
    angle[at] = torque[at] = 0.0
    out = mend(angle, torque)
    gone = set(range(N)) - set(out.recording.sources["m"].group.tolist())
    assert gone == set(at.tolist()) == set(range(N)) - set(out.recording.sources["y"].group.tolist())
    assert f"first in row {at[0] + 1} (0), most are 0, as a second source or a code for no value sends it" in " ".join(
        out.warnings
    )


def test_the_first_and_the_last_samples_may_lie_off() -> None:
    angle = DEGREES.copy()
    angle[[0, 1, -1]] = 300.0
    assert set(range(N)) - set(mend(angle).recording.sources["m"].group.tolist()) == {0, 1, N - 1}


@pytest.mark.slow
def test_a_stroke_of_a_torque_stays_and_a_code_does_not() -> None:
    for seed in range(5):
        assert mend(DEGREES, stick_slip(np.random.default_rng(seed))).left_out["y"] == 0
    torque = LOAD.copy()
    torque[1000] += 0.7
    assert mend(DEGREES, torque).left_out["y"] == 0
    torque[2000] = 32.767
    assert mend(DEGREES, torque).left_out["y"] == 1


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_second_source_is_refused_and_its_value_can_be_left_out(share: float) -> None:
    second = np.random.default_rng(9).random(N) < share
    angle, torque = np.where(second, 0.0, DEGREES + 50.0), np.where(second, 0.0, LOAD)
    with pytest.raises(ZygosError, match=r"a second source or a code .* remedy: write missing = 0 there"):
        mend(angle, torque)
    chosen = mend(angle, torque, missing=0.0)
    assert np.array_equal(values(chosen), DEGREES[~second] + 50.0)
    assert np.array_equal(values(chosen, "y"), LOAD[~second])
    with pytest.raises(ZygosError, match=r"as if two sources sent them; remedy: stop one of them"):
        mend(np.where(np.arange(N) % 2, DEGREES + 90.0, DEGREES))


@pytest.mark.parametrize("end", ["first", "last"])
def test_what_an_angle_says_before_it_is_measured_is_left_out(end: str) -> None:
    """A fifth of the recording at exactly 0; also a standstill that ends without a jump has equal readings."""
    count = len(T) // 5
    idle = DEGREES + 40.0
    idle[slice(0, count) if end == "first" else slice(-count, None)] = 0.0
    found = mend(idle)
    assert found.left_out == {"m": count, "y": count}
    (said,) = found.warnings
    assert f"is 0 in its {end} {count:,} samples, with a jump of" in said
    still = DEGREES.copy()
    still[:count] = still[count]
    assert mend(still).left_out == {"m": 0, "y": 0}


def test_a_pause_is_no_jump() -> None:
    """What an angle did in a gap of a second is not known; a whole turn is one."""
    keep = np.r_[0:1500, 2000:3000]
    assert mend(DEGREES[keep], LOAD[keep], t=T[keep]).warnings == ()


def test_an_angle_that_is_set_anew_is_named() -> None:
    out = mend(DEGREES + np.where(T >= 4.0, 30.0, 0.0))
    assert len(out.warnings) == 1
    assert "m jumps in 1 place, first in row 2001" in out.warnings[0]
