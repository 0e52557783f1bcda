# SPDX-License-Identifier: MIT
"""An arm that changes while it is learned: the alarm, a restart that keeps the joints, and sums that fade."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from flight_support import part, sines
from numpy.typing import NDArray
from plant_support import LIVELY, lively
from runs_support import trajectory_of
from soak_support import fly, settle, stored
from state_support import config_of_its_own

from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_change
from zygos.model.model import Model, Quantity
from zygos.native.flight import (
    CHANGE_ALARM,
    MIN_SIGNAL_TO_NOISE,
    OVERDECLARED,
    REASONS,
    Drift,
    Estimate,
    Flight,
    config_of,
    encode,
    ffi,
    lib,
)
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

SEEDS = 10
CHANGE_S, AFTER_S, ARC_S = 150.0, 130.0, 60.0
LOST = 37
"""Cycles between the light and the heavy part: somebody takes the payload up."""
LOOK = 200
"""Cycles."""
BODIES = ("a00", "a01", "a02", "a11", "a12", "a22")
NORMAL95 = 1.959964


def heavier(model: Model) -> Model:
    """The last link with twice its mass and inertia."""

    def twice(one: Quantity) -> Quantity:
        return replace(one, value=2.0 * one.value)

    *others, last = model.bodies
    xx, xy, xz, yy, yz, zz = last.inertia
    inertia = (twice(xx), twice(xy), twice(xz), twice(yy), twice(yz), twice(zz))
    return replace(model, bodies=(*others, replace(last, mass=twice(last.mass), inertia=inertia)))


def shifted(cycles: Cycles, by: int) -> Cycles:
    return replace(cycles, sync=cycles.sync + np.uint64(by))


def split(frames: NDArray[np.void], every: int) -> list[NDArray[np.void]]:
    """Pieces of so many cycles."""
    return np.split(frames, np.flatnonzero(frames["id"] == 0x080)[every::every])


@dataclass(frozen=True)
class Story:
    """One seed: a light arm, then a heavy one."""

    light: Estimate
    """At the end of the light part."""
    looks: list[Drift]
    """Every LOOK cycles of the heavy part; nothing is adopted once the alarm is raised."""
    early: list[Drift]
    """The same of the light part."""
    kept: Estimate
    """Two arcs behind a restart that keeps the joints."""
    fresh: Estimate
    """The same two arcs alone."""
    watch: Watch


@pytest.fixture(scope="module")
def true() -> tuple[Floats, Floats]:
    arm, model, _ = lively()
    return model.base_values(arm), heavier(model).base_values(arm)


@pytest.fixture(scope="module")
def runs() -> list[tuple[Cycles, Cycles]]:
    """The light and the heavy part of each seed."""
    arm, model, scenario = lively()
    light = trajectory_of(arm, model, scenario, duration_s=CHANGE_S, seeds=range(SEEDS), noise=True)
    heavy = trajectory_of(arm, heavier(model), scenario, duration_s=AFTER_S, seeds=range(100, 100 + SEEDS), noise=True)
    behind = round(CHANGE_S / arm.period_s) + LOST
    return [(light.cycles(k), shifted(heavy.cycles(k), behind)) for k in range(SEEDS)]


def flight_sums(packed: Sequence[float], width: int) -> Floats:
    """A lower triangle by rows as a symmetric matrix (width, width)."""
    out = np.zeros((width, width))
    out[np.tril_indices(width)] = list(packed)[: width * (width + 1) // 2]
    return out + np.tril(out, -1).T


def look(flight: Flight, frames: NDArray[np.void]) -> Drift:
    """Feed frames and compare; adopt the estimate unless the arm has changed, as zygos_solve() does."""
    flight.frames(frames)
    drift = flight.drift()
    if not drift.changed:
        flight.adopt()
    return drift


@pytest.fixture(scope="module")
def stories(runs: list[tuple[Cycles, Cycles]]) -> list[Story]:
    arm = lively()[0]
    out = []
    for light, heavy in runs:
        first, second = encode(arm, light), encode(arm, heavy)
        flight, restarted, fresh, watch = Flight(arm), Flight(arm), Flight(arm), Watch(Flight(arm))
        early = [look(flight, piece) for piece in split(first, LOOK)]
        before = flight.estimate()
        looks = [look(flight, piece) for piece in split(second, LOOK)]
        watch.frames(np.concatenate([first, second]))
        watch.look()
        restarted.frames(first)
        restarted.restart(keep_joints=True)
        two = np.concatenate(split(second, LOOK)[: round(2.0 * ARC_S / arm.period_s) // LOOK])
        restarted.frames(two)
        fresh.frames(two)
        out.append(Story(before, looks, early, restarted.estimate(), fresh.estimate(), watch))
    return out


def far(estimate: Estimate, true: Floats) -> Floats:
    """(p,) errors in standard deviations that belong to the 95 % intervals."""
    return (estimate.value - true) / (estimate.half95 / NORMAL95)


# ---------------------------------------------------------------- the alarm


@pytest.mark.slow
def test_a_payload_raises_the_alarm_within_an_arc_and_only_bodies_have_changed(stories: list[Story]) -> None:
    arc = round(ARC_S / 0.05) // LOOK
    for story in stories:
        assert not any(drift.changed for drift in story.early)
        assert any(np.isfinite(drift.deviation).all() for drift in story.early)
        assert any(drift.changed for drift in story.looks[:arc])
        now = [drift for drift in story.looks[:arc] if drift.changed][-1]
        assert "a22" in now.changed
        assert set(now.changed) <= set(BODIES)
        # what was known before ends with the light part, whose newest cycle the gap shows
        assert now.until == round(CHANGE_S / 0.05) - 1


@pytest.mark.slow
def test_the_watch_keeps_the_plainest_look(stories: list[Story]) -> None:
    """It looks twice an arc through the whole log."""
    for story in stories:
        found = story.watch.plainest
        assert found is not None
        assert "a22" in found.changed
        assert set(found.changed) <= set(BODIES)
        assert found.until * 0.05 == pytest.approx(CHANGE_S, abs=0.1)


@pytest.mark.slow
def test_no_alarm_while_nothing_changes() -> None:
    """20 seeds of five minutes, looked at every 15 s: 400 looks, half of which compare 12 parameters."""
    arm, model, scenario = lively()
    runs = trajectory_of(arm, model, scenario, duration_s=300.0, seeds=range(20), noise=True)
    last, compared = [], 0
    for k in range(20):
        flight = Flight(arm)
        for piece in split(encode(arm, runs.cycles(k)), 300):
            drift = look(flight, piece)
            assert drift.changed == (), (k, drift.largest)
            if np.isfinite(drift.deviation).all():
                compared, deviation = compared + 1, drift.deviation
        last.append(deviation)
    assert compared > 200
    # and the deviations are no larger than they are said to be: their mean square is at most 1
    square = np.mean(np.square(last), axis=0)
    print(np.sqrt(square).round(2))
    assert np.all(square < 1.0 + 3.0 * math.sqrt(2.0 / 20.0))


@pytest.mark.parametrize("compensated", [False, True])
def test_the_deviation_in_closed_form(compensated: bool) -> None:
    """By numpy from the rows of the newest arc, or its sums where noise is taken off, and from the estimate that was
    adopted."""
    arm, model, scenario = lively()
    arm = arm if compensated else replace(arm, compensate_every=0)
    rng, flight = np.random.default_rng(1), Flight(arm)
    fly(flight, stored(arm, model, scenario), 3, rng)
    before = flight.estimate()
    assert flight.adopt()
    trace = flight.cycles(shifted(sines(arm, 900), int(flight.native.sums.cycle) + 1 + LOST), trace=True)
    assert trace is not None
    drift, guard = flight.drift(), flight._work.sums.guard
    n, p = round(guard.held_instants), len(before.value)
    assert guard.held_arcs == 1 and n > 600
    everything = sum(block[2] for block in flight.blocks().energy)
    noise = n / everything * flight.noise()
    rows = trace.row[trace.instant & trace.accepted][-n:]
    rows = rows - rows.mean(axis=0)
    sums = flight_sums(guard.held.gram, p + 1) if compensated else rows.T @ rows
    square = sums[:p, :p]
    own = np.linalg.solve(square, sums[p, :p])
    residual = np.append(own, -1.0)
    left = max(residual @ (sums + noise) @ residual / n, before.residual**2)
    scatter = left * (max(before.cluster, 0.25) + 24.0 * arm.smoother.points / n)
    inverse = np.linalg.inv(square)
    wider = before.half95 / before.sigma / NORMAL95
    spread = np.sqrt(
        wider**2 * np.diag(before.covariance) + scatter * np.diag(inverse @ (square + noise[:p, :p]) @ inverse)
    )
    np.testing.assert_allclose(drift.deviation, (own - before.solution) / spread, rtol=1e-5)


def test_the_limits_are_those_of_the_library() -> None:
    headers = Path(__file__).parents[2] / "include" / "zygos" / "priv"
    text = "".join((headers / f"{name}.h").read_text() for name in ("change", "solver"))
    for name, value in (
        ("CHANGE_ALARM", CHANGE_ALARM),
        ("MIN_SIGNAL_TO_NOISE", MIN_SIGNAL_TO_NOISE),
        ("OVERDECLARED", OVERDECLARED),
    ):
        found = re.search(rf"#define ZYGOS_{name} ([\d.]+)", text)
        assert found and float(found[1]) == value


# ---------------------------------------------------------------- restart


@pytest.mark.slow
def test_two_arcs_after_the_restart_tell_the_new_payload(stories: list[Story], true: tuple[Floats, Floats]) -> None:
    """Every parameter's errors are as large as its intervals say: their mean square is 1, within 3 of its errors."""
    assert {story.kept.validity for story in stories} == {"valid"}
    errors = np.array([far(story.kept, true[1]) for story in stories])
    square = np.mean(errors**2, axis=0)
    print(np.sqrt(square).round(2))
    assert np.all(square < 1.0 + 3.0 * math.sqrt(2.0 / SEEDS))
    # narrow intervals, not wide ones, make that true: the old payload is far outside of all of them
    half95 = np.array([story.kept.half95 / true[1] for story in stories])
    assert np.all(np.median(half95, axis=0) < 0.01)
    bodies = [k for k, name in enumerate(stories[0].kept.names) if name in BODIES]
    assert np.all(np.abs([far(story.kept, true[0])[bodies] for story in stories]) > 50.0)


@pytest.mark.slow
def test_what_is_known_of_the_joints_survives_the_restart(stories: list[Story], true: tuple[Floats, Floats]) -> None:
    """Their errors are no larger than before it, within 3 errors of a ratio, and smaller than without what was kept."""
    joints = [k for k, name in enumerate(stories[0].kept.names) if name not in BODIES]
    assert len(joints) == 6
    before = np.sqrt(np.mean([(story.light.value / true[0] - 1.0)[joints] ** 2 for story in stories], axis=0))
    after = np.sqrt(np.mean([(story.kept.value / true[1] - 1.0)[joints] ** 2 for story in stories], axis=0))
    print((100.0 * before).round(3), (100.0 * after).round(3))
    assert np.all(after < before * (1.0 + 3.0 / math.sqrt(SEEDS)))
    sigmas = np.array([(story.kept.sigma / story.fresh.sigma)[joints] for story in stories])
    assert np.all(np.median(sigmas, axis=0) < 0.95)


# ---------------------------------------------------------------- fading


def squares(flight: Flight, cycles: Cycles) -> Floats:
    """(p, p) of the accepted rows that the flight forms, less their mean, by numpy."""
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    z = trace.row[trace.instant & trace.accepted][:, :-1]
    z = z - z.mean(axis=0)
    return np.asarray(z.T @ z, dtype=np.float64)


def test_two_arcs_in_closed_form() -> None:
    """What the first arc left fades in each cycle up to the end of the second."""
    arm = replace(lively()[0], compensate_every=0, impulse_arc_s=0.0, memory_s=20.0)
    keep = math.exp(-arm.period_s / 20.0)
    run = sines(arm, 1100)
    one, two, three = part(run, 0, 500), shifted(part(run, 500, 1000), 9), shifted(part(run, 1000, 1100), 18)
    flight = Flight(arm)
    first, second = squares(flight, one), squares(flight, two)
    np.testing.assert_allclose(flight.normal_equations()[0], first + second, rtol=1e-10, atol=1e-10 * second.max())
    third = squares(flight, three)  # the gap before it has ended the second arc
    faded = keep**500
    assert 0.1 < faded < 0.5
    expected = faded * first + second + third
    np.testing.assert_allclose(flight.normal_equations()[0], expected, rtol=1e-10, atol=1e-10 * expected.max())


def test_motor_rows_fade_alike() -> None:
    """Each arc by the cycles up to the end of the newest one; the newest one that is closed by none."""
    arm = replace(lively()[0], compensate_every=0, impulse_arc_s=5.0)
    run = sines(arm, 430)
    whole, fading = Flight(arm), Flight(replace(arm, memory_s=20.0))
    for flight in (whole, fading):
        flight.cycles(run)
        assert lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)) == 0
    there, faded = (flight.blocks().motors[:4] for flight in (whole, fading))
    newest = np.trace(faded[3][0][0]) / np.trace(there[3][0][0])
    for k in range(4):
        for (sums, _), (known, _) in zip(faded[k], there[k], strict=True):
            ratio = math.exp(-100 * (3 - k) * arm.period_s / 20.0)
            np.testing.assert_allclose(sums, newest * ratio * known, rtol=1e-9)


@pytest.mark.slow
def test_with_a_short_memory_the_estimate_follows_and_without_it_does_not(true: tuple[Floats, Floats]) -> None:
    """With 10 s, a sixth of an arc, what the light arm left has faded to a millionth in the end; without
    it both arms are in the sums, which fit neither."""
    arm, model, scenario = lively()
    light, heavy = (stored(arm, plant, scenario) for plant in (model, heavier(model)))
    errors: dict[str, list[Floats]] = {"fading": [], "endless": []}
    for seed in range(3):
        for name, memory in (("fading", 10.0), ("endless", None)):
            flight, rng = Flight(replace(arm, memory_s=memory)), np.random.default_rng(seed)
            fly(flight, light, 2, rng)
            fly(flight, heavy, 2, rng)
            errors[name].append((flight.estimate().solution / true[1] - 1.0)[: len(BODIES)])
    mean = {name: np.sqrt(np.mean(np.square(each), axis=0)) for name, each in errors.items()}
    print(mean)
    assert np.all(mean["fading"] < 0.005)
    assert not np.any(mean["endless"] < 0.05)


# ---------------------------------------------------------------- refusals


def test_what_was_changed_or_is_not_there_is_not_compared() -> None:
    """Without a running solution nothing is; sums that a flipped bit has changed are not, and the estimate stays."""
    arm, model, scenario = lively()
    flight, rng = Flight(arm), np.random.default_rng(0)
    fly(flight, stored(arm, model, scenario), 2, rng)
    drift = flight.drift()
    assert (drift.changed, drift.reason) == ((), REASONS[lib.ZYGOS_REASON_NO_DATA])
    assert np.isnan(drift.deviation).all()
    assert flight.adopt()
    fly(flight, stored(arm, model, scenario), 2, rng)
    settle(flight)
    whole = flight.drift()
    assert whole.reason == "" and np.isfinite(whole.deviation).all()
    before = flight.estimate()
    flight.native.sums.guard.held.gram[5] *= 1.5
    assert np.isnan(flight.drift().deviation).all()
    np.testing.assert_array_equal(flight.estimate().value, before.value)


def test_without_motor_rows_there_is_nothing_to_keep() -> None:
    arm = replace(lively()[0], impulse_arc_s=0.0)
    flight = Flight(arm)
    flight.cycles(sines(arm, 300))
    before = bytes(ffi.buffer(flight.native))
    with pytest.raises(ZygosError, match=r"no motor rows .*remedy: \[arc\] impulse_max_s"):
        flight.restart(keep_joints=True)
    assert bytes(ffi.buffer(flight.native)) == before
    flight.restart()


@pytest.mark.parametrize("keep", [0.8999, 1.0001, 0.0, -1.0, math.inf, math.nan])
def test_a_keep_out_of_range_is_refused(keep: float) -> None:
    config = config_of(lively()[0])
    native = ffi.new("zygos_arm_t *")
    assert lib.zygos_arm_init(native, config) == 1
    config.forgetting_factor = keep
    assert lib.zygos_arm_init(native, config) == lib.ZYGOS_E_VALUE
    for allowed in (0.9, 1.0):
        config.forgetting_factor = allowed
        assert lib.zygos_arm_init(native, config) == 1


def with_memory(folder: Path, text: str) -> Path:
    file = folder / "arm.toml"
    file.write_text((LIVELY / "arm.toml").read_text() + f"\n[arc]\nmemory_min = {text}\n")
    return file


@pytest.mark.parametrize("text", ["0", "-1", "1.99", "inf", "nan", "'short'"])
def test_a_memory_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ZygosError, match=r"arc\.memory_min.*remedy") as error:
        load_arm(with_memory(tmp_path, text))
    assert error.value.exit_code == 2


def test_a_memory_in_minutes(tmp_path: Path) -> None:
    arm: Arm = load_arm(with_memory(tmp_path, "30"))
    assert arm.memory_s == 1800.0
    assert config_of(arm).forgetting_factor == pytest.approx(1.0 - 0.05 / 1800.0, rel=1e-9)
    assert load_arm(with_memory(tmp_path, "2")).memory_s == 120.0
    assert config_of(load_arm(LIVELY / "arm.toml")).forgetting_factor == 1.0


@pytest.mark.parametrize(
    ("name", "reason", "certain"),
    [("k1", "", True), ("k1", REASONS[lib.ZYGOS_REASON_UNCLOSED], False), ("torque_gain2", "", False)],
)
def test_a_balance_that_does_not_close_shows_no_change(name: str, reason: str, certain: bool) -> None:
    """Link angles that are late look like a changed arm as soon as the motion is another one."""
    arm = load_arm(LIVELY / "arm.toml")
    result = replace(Flight(arm).estimate(), reason=reason)
    drift = Drift(names=(name,), deviation=np.array([9.0]), reason="", until=1000)
    said = about_change(result, drift, arm)
    assert ("the arm changed after 50 s" in said) == certain
    assert ("`zygos check-arm`" in said) != certain
