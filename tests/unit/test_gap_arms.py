# SPDX-License-Identifier: MIT
"""The twin study of arms that are neither planar nor free: on runs of MuJoCo, which shares no code with it.

A run that lacks nothing closes as its twin does, and what is hidden in the plant stands out in its own column, with its
own size. Columns, twin and simulator of the package are tested against each other in `test_gap_balances.py`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_arms_support import begun, standing
from scipy.stats import binom
from trial_support import runs_of, sampled

from oracles.arms import Plant, Trial, spatial
from oracles.hidden import Law, LinkViscous, MotorCoulomb, TidalField
from oracles.tree import Payload
from zygos import limits
from zygos.dynamics.equations import from_model, parameters
from zygos.effects import CATALOGUE, columns_at
from zygos.gap.balances import Acting, thinning, zero_columns
from zygos.gap.changes import BODIES, find_change, settled
from zygos.gap.fit import fit, shares_of_pairs
from zygos.gap.forecast import cut, cut_twin, forecast
from zygos.gap.null import chance, null_scores, null_sigmas
from zygos.gap.record import MeasuredRun
from zygos.gap.runs import record_of
from zygos.gap.study import Study, again, base_values
from zygos.gap.torques import torque_noise
from zygos.gap.twin import draws, follow

TRIALS = {"spatial": spatial, "standing": standing}
SAMPLED = {"spatial": (0.008, 7), "standing": (0.0125, 9)}
SECONDS = {"spatial": 10.0, "standing": 6.0}
LAWS: dict[str, type[Law]] = {
    "motor_coulomb2": MotorCoulomb,
    "link_viscous2": LinkViscous,
    "gravity_gradient": TidalField,
}
SIZE = {
    "motor_coulomb2": {"standing": 0.004},
    "link_viscous2": {"spatial": 2.0, "standing": 0.05},
    "gravity_gradient": {"spatial": 3e-4},
}
BESIDE = {
    "motor_coulomb2": ("motor_coulomb1",),
    "link_viscous2": ("link_viscous1",),
    "gravity_gradient": ("base_torquez",),
}
"""Wrong columns, of which those that look most like the right one do not take its place."""
CANDIDATES = [f"{key}{i}" for key in "motor_coulomb link_coulomb motor_viscous cubic_stiffness".split() for i in (1, 2)]


def trial_of(name: str) -> Trial:
    """An arm of the trials, sampled seldom."""
    return sampled(TRIALS[name](), *SAMPLED[name])


def recorded(trial: Trial, laws: tuple[Law, ...], seconds: float) -> tuple[MeasuredRun, ...]:
    """Two runs of a plant that hides laws."""
    return tuple(map(record_of, runs_of(Plant(trial, replace(trial.drawn, effects=()), laws), 3, seconds)))


@cache
def records(name: str, hidden: str, value: float) -> tuple[MeasuredRun, ...]:
    """Two runs of a plant in which the second joint hides a law."""
    trial = trial_of(name)
    laws = (LAWS[hidden](1, value),) if hidden else ()
    laws = tuple(replace(law, nadir=trial.arm.nadir) if isinstance(law, TidalField) else law for law in laws)
    return recorded(trial, laws, SECONDS[name])


@cache
def study(name: str, hidden: str = "", value: float = 0.0) -> Study:
    """The true model's equations, without effects, fitted to two runs."""
    trial = trial_of(name)
    own = tuple(Acting(CATALOGUE["link_viscous"], i) for i in (0, 1))
    if trial.arm.free:
        own += (Acting(CATALOGUE["gravity_gradient"], -1),)
        own += tuple(Acting(CATALOGUE["base_torque"], -1, axis) for axis in "xyz")
    return begun(trial, records(name, hidden, value), own)


def scores(found: Study, name: str) -> tuple[float, float, list[float]]:
    """Coefficient on both runs together, its deviation, and its scores on each."""
    wider = replace(found.hypothesis, effects=(*found.hypothesis.effects, name))
    null = [found.of_twin(wider, [run]).of(name) for run in (0, 1)]
    each = [float(found.of(wider, [run]).of(name)) for run in (0, 1)]
    z = [(x - draw.mean()) / draw.std(ddof=1) for x, draw in zip(each, null, strict=True)]
    return float(found.of(wider).of(name)), float(null_sigmas(found, [name])[0]), z


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spatial", "standing"])
def test_a_run_that_lacks_nothing_closes_as_its_twin(name: str) -> None:
    found = study(name)
    print(found.layout.balances, found.excess.round(2), found.wobble.round(2))
    wanted = ("E", "M1", "M2", "M3", "Hx", "Hy", "Hz") if name == "spatial" else ("E", "M1", "M2", "L1", "L2")
    assert found.layout.balances == wanted
    assert np.all(np.abs(found.excess**2 - 1.0) < np.maximum(0.3, 4.0 * found.wobble))
    for column in ("motor_coulomb1", "link_coulomb1"):
        _, _, z = scores(found, column)
        print(column, z)
        assert min(abs(x) for x in z) < limits.NAMED_Z.value


@pytest.mark.slow
@pytest.mark.parametrize(("column", "name"), [(column, name) for column, sizes in SIZE.items() for name in sizes])
def test_what_is_hidden_stands_out_with_its_size(name: str, column: str) -> None:
    value = SIZE[column][name]
    found = study(name, column, value)
    assert np.nanmax(found.excess) > 2.0
    got, sigma, z = scores(found, column)
    print(got, sigma, z)
    assert min(z) > 3.0 * limits.NAMED_Z.value
    after = again(found, replace(found.hypothesis, effects=(column,)))
    print(found.excess.round(1), after.excess.round(2), after.value[-1])
    assert after.value[-1] == pytest.approx(value, rel=0.01)
    over = after.excess**2 - 1.0
    assert np.all(over < np.maximum(0.4, 4.0 * after.wobble))
    instead = found.of(replace(found.hypothesis, effects=BESIDE[column]))
    assert np.nansum((instead.rms / found.noise) ** 2) > 2.0 * np.nansum(after.excess**2)


@pytest.mark.slow
def test_what_was_recorded_after_a_payload_closes_in_a_few_steps() -> None:
    """The fit to both sides of the change is so far off that the first twin of what came after it does not close."""
    trial = trial_of("spatial")
    drawn = replace(trial.drawn, effects=())
    x, y, z = (2.0 * far for far in drawn.bodies[-1].origin_xyz)
    plant = Plant(trial, drawn, payload=Payload(0.1 * drawn.bodies[-1].mass.value, 15.0, (x, y, z)))
    found = begun(trial, tuple(map(record_of, runs_of(plant, 3, 30.0))), ())
    change = find_change(found, [])
    assert change is not None
    assert (change.what, change.run, change.arc, change.torn) == (BODIES, 1, 1, True)
    assert (change.before_s, change.after_s) == pytest.approx((10.0, 20.0), abs=0.1)
    assert change.share > 0.95
    apart = settled(found, change, limits.CLOSED_BALANCE.value)
    assert apart is not None
    _, now, was = apart
    print(now.excess, now.value - was.value if was else None)
    assert np.nanmax(now.excess) < limits.CLOSED_BALANCE.value
    assert was is not None


@pytest.mark.slow
def test_the_largest_score_of_runs_that_lack_nothing() -> None:
    """Scores of single candidates are standard, the largest of all grows with their number, and so does the
    threshold."""
    found = study("standing")
    every = null_scores(found, CANDIDATES)
    assert every.shape == (500, len(CANDIDATES))
    np.testing.assert_allclose(every.std(axis=0), 1.0, atol=0.2)
    largest = np.abs(every).max(axis=1)
    assert np.median(largest) > np.median(np.abs(every[:, 0]))
    luck = chance(found, CANDIDATES)
    assert (luck.threshold, luck.runs, luck.candidates, luck.freedom) == (limits.NAMED_Z.value, 2, len(CANDIDATES), 19)
    assert 1.0 < luck.count < 2.0 * len(CANDIDATES)
    assert 0.0 < luck.false_alarms < limits.FALSE_ALARMS.value
    assert luck.rate(luck.needed(0.05)) == pytest.approx(0.05)
    assert chance(found, CANDIDATES, 1e-12).threshold > max(
        limits.NAMED_Z.value, chance(found, CANDIDATES[:1], 1e-12).threshold
    )
    spread = np.array(
        [found.of_twin(replace(found.hypothesis, effects=(name,))).of(name).std(ddof=1) for name in CANDIDATES]
    )
    print(null_sigmas(found, CANDIDATES) / spread)
    np.testing.assert_allclose(null_sigmas(found, CANDIDATES) / spread, 1.0, atol=0.6)


@pytest.mark.slow
def test_what_pairs_of_columns_take_away() -> None:
    """One solve for all pairs gives what a fit of each pair leaves over, with what it pays for the sensors' zeros."""
    found = study("standing", "motor_coulomb2", SIZE["motor_coulomb2"]["standing"])
    names = ["motor_viscous2", "link_viscous1", "link_coulomb2", "torque_lag1"]
    # noise that is taken off may leave less than nothing of a balance
    sums = [replace(one, noise=None) for one in found.sums]
    shares = shares_of_pairs(found.hypothesis, sums, found.weight, names)

    def left(*added: str) -> float:
        own = fit(replace(found.hypothesis, effects=added), sums, found.weight)
        counts = np.array([one.count for one in sums])
        paid = np.sum(((own.zeros + found.applied) / found.layout.zero_sigma) ** 2)
        return float(np.nansum(found.weight**2 * own.rms**2 * counts) + paid)

    for i, first in enumerate(names):
        assert shares[i, i] == pytest.approx(1.0 - left(first) / left(), abs=1e-6)
        for j in range(i):
            wanted = pytest.approx(1.0 - left(first, names[j]) / left(), abs=1e-6)
            assert (shares[i, j], shares[j, i]) == (wanted, wanted)
    alone = np.diagonal(shares)
    assert np.all(shares >= np.maximum(alone[:, None], alone) - 1e-9) and alone.min() < shares.max() - 1e-3


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated() -> None:
    """Readings of the twins with seeds of their own stand for runs that lack nothing: a rate that is asked for holds
    for scores as the search has them, each run's coefficient in deviations of its twin's readings."""
    found = study("standing")
    searches, rate = 30, 0.2
    every = thinning(found.layout.arm)
    fresh = []
    for run, (twin, kept) in enumerate(zip(found.twins, found.accepted, strict=True)):
        base = base_values(found.model, found.layout)
        zeros = zero_columns(found.layout, found.records[run].readings(), base, every)
        drawn = draws(
            twin, kept, searches, found.layout, found.hypothesis.uncentred, zeros, base, 1000 * (run + 1), every
        )
        fresh.append(replace(drawn, noise=found.twin_sums[run].noise))
    z = np.empty((2, searches, len(CANDIDATES)))
    for k, name in enumerate(CANDIDATES):
        wider = replace(found.hypothesis, effects=(name,))
        for run in (0, 1):
            known = found.of_twin(wider, [run]).of(name)
            got = fit(wider, fresh[run : run + 1], found.weight).of(name)
            z[run, :, k] = (got - known.mean()) / known.std(ddof=1)
    luck = chance(found, CANDIDATES)
    passed = (np.abs(z).min(axis=0) > luck.needed(rate)) & (z[0] * z[1] > 0.0)
    alarms = int(passed.any(axis=1).sum())
    print(luck.count, luck.needed(rate), alarms, np.abs(z).max())
    # of both runs the deviations are known to 16 % only, and that of a candidate is the same in all searches
    assert alarms <= binom.isf(0.00135, searches, rate)
    assert not np.any((np.abs(z).min(axis=0) > luck.threshold) & (z[0] * z[1] > 0.0))
    # a threshold for one candidate does not hold for all of them
    alone = chance(found, CANDIDATES[:1]).needed(rate)
    assert alarms < int(((np.abs(z).min(axis=0) > alone) & (z[0] * z[1] > 0.0)).any(axis=1).sum())


@pytest.mark.slow
def test_predictions_of_an_arm_on_the_ground() -> None:
    """Half a second ahead the true model is as good as its own twin; it has no signals of a base."""
    (record, _), trial = records("standing", "", 0.0), trial_of("standing")
    model = from_model(trial.arm, replace(trial.drawn, effects=()))
    seen = cut(record)
    assert seen.width == 0
    gap, floor = forecast(model, seen), forecast(model, cut_twin(follow(model, [record])[0]))
    print(gap.gap, floor.gap)
    assert gap.signals.shape == (4,)
    # the table rounds torques to 16 bits, and every encoder has a zero of up to half a quantum
    assert floor.median < 1.3
    assert gap.median < 2.5 * floor.median


@pytest.mark.parametrize("name", ["spatial", "standing"])
def test_equations_of_motion_give_their_parameters_back(name: str) -> None:
    trial = TRIALS[name]()
    values = trial.drawn.base_values(trial.arm)
    found = parameters(trial.arm, from_model(trial.arm, replace(trial.drawn, effects=())))
    np.testing.assert_allclose(found, values, rtol=1e-9, atol=1e-12)


def test_noise_of_torques_is_found_beside_the_jitter_of_a_servo() -> None:
    record, _ = records("standing", "", 0.0)
    s, sigma = record.samples, np.array([0.01, 0.02])
    noise = sigma * np.random.default_rng(0).standard_normal(s.tau.shape)
    found = torque_noise(replace(record, samples=replace(s, tau=s.tau + noise)))
    print(torque_noise(record), found)
    np.testing.assert_allclose(found, sigma, rtol=0.1)
    assert np.all(torque_noise(record) < 0.1 * sigma)


@pytest.mark.slow
def test_a_column_of_every_site_can_be_fitted() -> None:
    """All but those of loads, bodies and hidden masses: on a run without any of them, none stands out."""
    trial = standing()
    known = [kind for kind in CATALOGUE.values() if kind.place in ("motor", "link", "spring", "torque", "sensor")]
    left_out = ("spring_offset", "torque_gain", "torque_offset", "link_zero", "motor_zero")
    own = tuple(
        Acting(kind, c.joint, c.component, kind.shapes[len(kind.shapes) // 2] if kind.shapes else None)
        for kind in known
        if kind.key not in left_out
        for c in columns_at(trial.arm, kind)
    )
    found = begun(trial, recorded(trial, (), 8.0), own)
    for name in (one.name for one in own):
        _, sigma, z = scores(found, name)
        assert sigma > 0.0
        assert min(abs(x) for x in z) < limits.NAMED_Z.value, (name, z)
