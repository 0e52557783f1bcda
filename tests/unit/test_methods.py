# SPDX-License-Identifier: MIT
"""The paper's methods on exact motion, and the way each of them fails under noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_support import Floats, Motion, make_arm, move, true_parameters

from zygos import reference
from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.paper.methods import Record, amc, de, eb, record_of
from zygos.runs.samples import calibrate


@pytest.fixture(scope="module", params=["planar-symmetric", "planar"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Arm:
    return make_arm(tmp_path_factory.mktemp("arm"), kinetic=request.param)


@pytest.fixture(scope="module")
def motion(arm: Arm) -> Motion:
    return move(arm, 2.5)


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, Motion]:
    """Samples fine enough for the springs' oscillation, of a motion that starts at rest."""
    arm = make_arm(tmp_path_factory.mktemp("fine"), period=0.005)
    return arm, move(arm, momentum=0.0)


def relative(arm: Arm, x: Floats) -> Floats:
    return np.abs(x / true_parameters(arm) - 1.0)


def part(record: Record, instants: slice) -> Record:
    return Record(record.q[:, instants], record.theta[:, instants], record.tau[:, instants], record.f0[:, instants])


def noisy(record: Record, sigma: float, seeds: int) -> Record:
    rng = np.random.default_rng(11)
    shape = (seeds, *record.q.shape[1:])
    return Record(
        q=record.q + sigma * rng.normal(size=shape),
        theta=record.theta + sigma * rng.normal(size=shape),
        tau=np.repeat(record.tau, seeds, axis=0),
        f0=np.repeat(record.f0, seeds, axis=0),
    )


@pytest.mark.slow
def test_momentum_and_energy_of_the_equations_of_motion_are_conserved(arm: Arm, motion: Motion) -> None:
    """The motion integrates the columns of `de`; `amc` and `eb` share no term with them."""
    momentum = amc.regressor(arm, motion.record(), exact=True)[0] @ true_parameters(arm)[amc.seen(arm)]
    np.testing.assert_allclose(momentum, motion.momentum, atol=1e-11)
    z, w = eb.regressor(arm, motion.record(), "exact", "first")
    assert np.max(np.abs(z[0] @ true_parameters(arm) - w[0])) < 1e-10 * np.max(np.abs(w))


def test_energy_balance_with_exact_rates_reaches_the_paper(arm: Arm, motion: Motion) -> None:
    """Table IV, without noise: 1e-6 %, and only when the energy at the start is subtracted (erratum 3)."""
    assert np.max(relative(arm, eb.estimate(arm, motion.record(), rates="exact", start="first")[0])) < 1e-8
    assert np.max(relative(arm, eb.estimate(arm, motion.record(), rates="exact", start="rest")[0])) > 1e-3


def test_momentum_with_exact_rates_sees_all_but_springs_and_dampers(arm: Arm, motion: Motion) -> None:
    estimate = amc.estimate(arm, motion.record(), momentum_nms=motion.momentum, exact=True)[0]
    seen = np.array([name[0] not in "kb" or len(name) == 3 for name in arm.parameter_names])
    np.testing.assert_array_equal(np.isnan(estimate), ~seen)
    assert np.max(relative(arm, estimate)[seen]) < 1e-7


def test_momentum_collapses_under_noise(arm: Arm, motion: Motion) -> None:
    """Rows whose noise is far above the momentum fit it best with nothing: -100 %, as in the paper."""
    estimate = amc.estimate(arm, noisy(motion.record(), 0.05, 4), momentum_nms=motion.momentum)
    assert np.nanmedian(np.abs(estimate / true_parameters(arm))) < 0.1
    with pytest.raises(ZygosError, match="momentum"):
        amc.estimate(arm, motion.record(), momentum_nms=0.0)


@pytest.mark.slow
def test_differential_equations_without_noise_and_with(fine: tuple[Arm, Motion]) -> None:
    """Fine samples give the parameters to a few percent; noise attenuates them by most of their size."""
    arm, motion = fine
    record = motion.record(exact=False)
    assert np.max(relative(arm, de.estimate(arm, record)[0])) < 0.03
    estimate = de.estimate(arm, noisy(record, 1e-3, 3))
    inertias = [i for i, name in enumerate(arm.parameter_names) if name[0] in "aI"]
    assert np.median(np.abs(estimate[:, inertias] / true_parameters(arm)[inertias])) < 0.5


@pytest.mark.parametrize("rates", ["midpoint", "savgol"])
def test_energy_balance_with_estimated_rates(fine: tuple[Arm, Motion], rates: eb.Rates) -> None:
    """The weak dampers are seen worst."""
    arm, motion = fine
    record = motion.record(exact=False)
    error = relative(arm, eb.estimate(arm, record, rates=rates)[0])
    assert np.median(error) < 2e-3
    assert np.max(error) < 0.12
    paper = relative(arm, eb.estimate(arm, record, rates="backward")[0])
    assert np.mean(error) < 0.2 * np.mean(paper)


def test_seeds_of_a_batch_are_independent(arm: Arm, motion: Motion) -> None:
    batch = noisy(motion.record(), 1e-4, 3)
    single = Record(batch.q[1:2], batch.theta[1:2], batch.tau[1:2], batch.f0[1:2])
    for estimate in (eb.estimate, amc.estimate, de.estimate):
        np.testing.assert_allclose(estimate(arm, batch)[1], estimate(arm, single)[0], rtol=1e-9, atol=1e-30)


def test_the_smoothed_rows_are_those_of_the_reference(fine: tuple[Arm, Motion]) -> None:
    """Differences of rows within an arc are the same, batch or room by room."""
    arm, motion = replace(fine[0], compensate_every=0), fine[1]
    z, w = eb.regressor(arm, motion.record(exact=False), "savgol")
    chain = reference.chain(arm, motion.cycles()).balance
    first = chain.index[0] - 3
    for x, y in ((z[0], chain.z), (w[0], chain.w)):
        ours = x[first : first + len(y)] - x[first]
        np.testing.assert_allclose(ours, y - y[0], atol=1e-11 * np.abs(y).max())


@pytest.mark.parametrize(("rates", "first"), [("midpoint", 0.5), ("savgol", 3.0)])
def test_work_and_dissipation_count_from_the_start(fine: tuple[Arm, Motion], rates: eb.Rates, first: float) -> None:
    """The first row carries what was done before it: in half a step, or in the half window of the smoother."""
    arm, motion = fine
    full = motion.record(exact=False)
    record = part(full, slice(100, None))
    z, w = eb.regressor(arm, record, rates)
    instants = first + np.arange(len(w[0]))
    for ours, exact in ((z[0, :, 8], motion.slip2[100:, 0]), (w[0], eb.work(arm, record)[0])):
        expected = np.interp(instants, np.arange(len(exact)), exact - exact[0])
        assert np.max(np.abs(ours - expected)) < 0.1 * np.max(np.abs(np.diff(exact)))


def test_record_of_takes_the_first_segment(arm: Arm, motion: Motion) -> None:
    cycles = motion.cycles()
    cycles.flags[100] = 1
    record = record_of(arm, calibrate(arm, cycles))
    assert record.q.shape == (1, 100, 2)
    np.testing.assert_array_equal(record.f0[0], motion.f0[:100])
    np.testing.assert_array_equal(record_of(arm, calibrate(arm, cycles), calibrate(arm, cycles)).q[1], record.q[0])
    with pytest.raises(ZygosError, match="differ in length"):
        record_of(arm, calibrate(arm, cycles), calibrate(arm, motion.cycles()))
    cycles.flags[:] = 2
    with pytest.raises(ZygosError, match="no valid cycle"):
        record_of(arm, calibrate(arm, cycles))


def test_misuse_is_refused(arm: Arm, motion: Motion) -> None:
    record = motion.record(exact=False)
    with pytest.raises(ZygosError, match="exact rates"):
        eb.estimate(arm, record, rates="exact")
    with pytest.raises(ZygosError, match="exact rates"):
        amc.estimate(arm, record, exact=True)
    with pytest.raises(ZygosError, match="shape"):
        replace(record, f0=record.f0[:, 1:])
    with pytest.raises(ZygosError, match="three samples"):
        de.estimate(arm, part(record, slice(2)))
    with pytest.raises(ZygosError, match="fill the smoother"):
        eb.estimate(arm, part(record, slice(7)), rates="savgol")
