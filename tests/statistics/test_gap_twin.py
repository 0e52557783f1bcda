# SPDX-License-Identifier: MIT
"""The null twin of a run is what the run would be if the model were right: it closes, it stays on the path, the fit
gives back what it was made with, and a run without a gap cannot be told from it.

The statistics are over seeds 0 .. n-1. A band of 3 standard errors counts both what the seeds and what the finite
number of draws of the twin leave uncertain; the draws are shared by all seeds, so their part does not average out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import gap_support
import numpy as np
import pytest
from gap_support import Floats, centred, dense, effect, noisy, rms, true_columns
from runs_support import trajectory_of
from threadpoolctl import threadpool_limits

from zygos import limits
from zygos.arm import TORQUE_STEP, Arm, Joint, Smoother
from zygos.balances.readings import Readings
from zygos.dynamics.compiled import Planar
from zygos.effects import Effect
from zygos.errors import Undecided
from zygos.gap.balances import Layout, Sums, accumulate, balance_rows, thinning, zero_columns
from zygos.gap.fit import Fit, fit
from zygos.gap.record import MeasuredRun, read_measured_run, smoothed_states
from zygos.gap.search import candidates
from zygos.gap.study import Study, base_values, begin, coefficient, read_hypothesis
from zygos.gap.twin import Twin, draws, follow, measure
from zygos.model.model import Model
from zygos.native.flight import encode
from zygos.runs.samples import calibrate
from zygos.simulation.scenario import EncoderNoise, Scenario
from zygos.simulation.sensors import draw_noise

SEEDS = 16
RUNS = ("a", "b")
OTHER_STREAMS = 1000
"""Seeds of the runs' noise begin here: the twin draws with seeds from 0 on, and the same stream some cycles later is
no independent noise."""
ROUNDING = 0.04
"""By how much the part of a rounding error that a smoother lets through may differ from that of a Gaussian error of the
same variance: it depends on how the motion crosses the steps."""
ROUNDING_PULL = 0.5
"""By how many of its standard deviations that may shift a value."""


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """As `zygos explain` does: its matrices are many and small."""
    with threadpool_limits(limits=1):
        yield


@cache
def example(run: str = "a") -> tuple[Arm, Model, Scenario]:
    """The example at 100 Hz, whose smoother is as long as at 200 Hz."""
    arm, model, scenario = gap_support.example(run)
    return replace(arm.at_period(0.01), smoother=Smoother(13, 4, 6)), model, scenario


def displaced(arm: Arm, seed: int) -> Arm:
    """The arm with its encoders' steps elsewhere: along one path it is their position that makes rounding random."""
    rng = np.random.default_rng(seed)

    def joint(one: Joint) -> Joint:
        link, motor = (
            replace(encoder, zero_rad=encoder.quantum_rad * rng.uniform(-0.5, 0.5))
            for encoder in (one.link_encoder, one.motor_encoder)
        )
        return replace(one, link_encoder=link, motor_encoder=motor)

    return replace(arm, joints=tuple(joint(one) for one in arm.joints))


@cache
def record(run: str, seed: int = 0, noise: EncoderNoise = "quantised") -> MeasuredRun:
    """Sensors of a seed along the run. What is quantised passes the wire, whose steps are the encoders'; Gaussian
    readings do not, for the wire would round them once more."""
    moved, (arm, _, _) = noisy(run), example(run)
    stream = OTHER_STREAMS + 2 * seed + RUNS.index(run)
    arm = displaced(arm, stream) if noise == "quantised" else arm
    seen = replace(moved, arm=arm, noise=draw_noise(arm, len(moved.t), [stream], noise)).cycles()
    if noise == "quantised":
        return read_measured_run(arm, Path(run), encode(arm, seen))
    samples = calibrate(arm, seen)
    return replace(record(run), arm=arm, samples=samples, omega0=samples.omega @ arm.axis)


@cache
def null_model() -> Model:
    """What makes the runs, at rest as a whole."""
    arm, model, _ = example()
    return replace(model, effects=(effect(arm, "angular_momentum", -1, 0.0),))


def true_dynamics(*effects: Effect) -> Planar:
    arm, _, _ = example()
    model = null_model()
    return Planar.from_model(arm, replace(model, effects=(*model.effects, *effects)))


def records() -> list[MeasuredRun]:
    return [record(run) for run in RUNS]


@cache
def study() -> Study:
    """The true model's equations fitted to the runs of seed 0."""
    arm, _, _ = example()
    return begin(records(), read_hypothesis(Layout(arm), null_model()), true_dynamics())


@cache
def twins() -> list[Twin]:
    """Of the true model."""
    return follow(true_dynamics(), records())


@dataclass(frozen=True)
class Ensemble:
    """All seeds against the twin of seed 0: they move alike, so their twins do."""

    rho: Floats
    """(seeds, runs, balances)"""
    pull: Floats
    """(seeds, coefficients) value less truth in standard deviations."""
    z: dict[str, Floats]
    """Of each candidate, (seeds, runs)."""


@cache
def ensemble(noise: EncoderNoise) -> Ensemble:
    first = study()
    values = base_values(first.model, first.layout)
    truth = np.array([coefficient(true_dynamics(), first.hypothesis, name) for name in first.hypothesis.names])
    uncentred = (first.layout.balances.index("H"),)
    rho, pull, z = [], [], []
    for seed in range(SEEDS):
        runs = tuple(record(run, seed, noise) for run in RUNS)
        seen = tuple(
            replace(
                accumulate(
                    balance_rows(Layout(one.arm), one.readings(), values, every=thinning(one.arm)), kept, uncentred
                ),
                noise=twin.noise,
            )
            for one, kept, twin in zip(runs, first.accepted, first.twin_sums, strict=True)
        )
        one = replace(first, records=runs, sums=seen, fit=fit(first.hypothesis, seen, first.weight))
        rho.append(one.excess)
        pull.append((one.value - truth) / one.spread)
        z.append({candidate.name: candidate.z for candidate in candidates(one, one, limits.NAMED_Z.value)})
    return Ensemble(np.array(rho), np.array(pull), {name: np.array([one[name] for one in z]) for name in z[0]})


def beyond(values: Floats, target: float, shared: Floats | float) -> Floats:
    """How many standard errors the mean over seeds is off; shared: what all seeds have in common."""
    error = np.hypot(values.std(axis=0, ddof=1) / np.sqrt(len(values)), shared)
    return np.asarray((values.mean(axis=0) - target) / error, dtype=np.float64)


# ---------------------------------------------------------------- a run without a gap


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["gaussian", "quantised"])
def test_rho_of_a_null_run_is_1(noise: EncoderNoise) -> None:
    first, seen = study(), ensemble(noise)
    drawn = fit(first.hypothesis, first.twin_sums, first.weight).rms / first.noise
    shared = drawn.std(axis=0, ddof=1) / np.sqrt(limits.DRAWS.value)
    off = beyond(seen.rho, 1.0, shared)
    print(noise, seen.rho.mean(axis=0).round(4).tolist(), off.round(1).tolist())
    if noise == "gaussian":
        assert np.abs(off).max() < 3.0
    else:
        assert np.abs(beyond(seen.rho, 1.0, np.hypot(shared, ROUNDING / 3.0))).max() < 3.0
        assert np.abs(seen.rho.mean(axis=0) - 1.0).max() < ROUNDING
    assert seen.rho.max() ** 2 - 1.0 < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["gaussian", "quantised"])
def test_z_of_every_candidate_is_standard_on_null_runs(noise: EncoderNoise) -> None:
    """Over the seeds z has mean 0 and deviation 1, but for what 20 draws know of the twin: z is Student's t with 19
    degrees of freedom, whose deviation is sqrt(19/17), about a mean that is itself off by 1/sqrt(20)."""
    seen = ensemble(noise)
    assert len(seen.z) == 11
    wide = np.sqrt((limits.DRAWS.value - 1) / (limits.DRAWS.value - 3))
    mean_error = wide * np.sqrt(1.0 / SEEDS + 1.0 / limits.DRAWS.value)
    deviation_error = wide * np.sqrt(0.5 / (SEEDS - 1) + 0.5 / (limits.DRAWS.value - 1))
    z = np.stack([seen.z[name] for name in sorted(seen.z)])
    for name, one in sorted(seen.z.items()):
        print(noise, name, one.mean(axis=0).round(2), one.std(axis=0, ddof=1).round(2))
    assert np.abs(z.mean(axis=1)).max() < 3.0 * mean_error
    spread = z.std(axis=1, ddof=1)
    assert np.abs(spread - 1.0).max() < 3.0 * deviation_error
    # all together, of which some six are independent: as many as there are encoders and runs to err
    assert abs(np.sqrt(np.mean(spread**2)) - 1.0) < 3.0 * deviation_error / np.sqrt(6.0)
    # what is named must reach 4.5 on both runs
    assert np.abs(z).min(axis=-1).max() < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["gaussian", "quantised"])
def test_values_are_right_within_their_spread(noise: EncoderNoise) -> None:
    seen = ensemble(noise)
    wide = np.sqrt((limits.DRAWS.value - 1) / (limits.DRAWS.value - 3))
    print(noise, seen.pull.mean(axis=0).round(2), seen.pull.std(axis=0, ddof=1).round(2))
    band = 3.0 * wide * np.sqrt(1.0 / SEEDS + 1.0 / limits.DRAWS.value)
    assert np.abs(seen.pull.mean(axis=0)).max() < band + (ROUNDING_PULL if noise == "quantised" else 0.0)
    deviation_error = wide * np.sqrt(0.5 / (SEEDS - 1) + 0.5 / (limits.DRAWS.value - 1))
    assert np.abs(seen.pull.std(axis=0, ddof=1) - 1.0).max() < 3.0 * deviation_error


# ---------------------------------------------------------------- the twin itself


def wrong(*changes: tuple[str, float]) -> Planar:
    """The true model with parameters times factors."""
    arm, model, _ = example()
    base = model.base_values(arm)
    for name, factor in changes:
        base[arm.parameter_names.index(name)] *= factor
    return Planar.from_parameters(arm, base, null_model().effects)


def effects_of(arm: Arm) -> tuple[Effect, ...]:
    listed = (
        ("motor_coulomb", 0, 0.1),
        ("motor_viscous", 1, 0.5),
        ("link_coulomb", 1, 5.0),
        ("cubic_stiffness", 1, 500.0),
        ("torque_lag", 0, 5e-3),
    )
    return tuple(effect(arm, *one) for one in listed)


def everything(twin: Twin) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Every instant of a twin."""
    arcs, cycles, _ = twin.exact.q.shape
    return np.ones((arcs, cycles - twin.arm.smoother.points + 1), dtype=np.bool_)


def exact_sums(twin: Twin, values: Floats, layout: Layout | None = None) -> Sums:
    """Of a twin's readings before any noise; H without a constant. layout: other columns than the arm's own."""
    layout = layout or Layout(twin.arm)
    return accumulate(balance_rows(layout, twin.exact, values), everything(twin), (layout.balances.index("H"),))


@pytest.mark.slow
def test_a_twin_is_an_exact_solution() -> None:
    """Its balances close as those of a simulated run do, though it does not begin where the run did."""
    arm, model, _ = example()
    base = model.base_values(arm)
    for twin, noise in zip(twins(), study().noise, strict=True):
        table = dense(balance_rows(Layout(arm), twin.exact, base))
        terms = table.left * true_columns(arm, base)
        scale = rms(centred(np.moveaxis(np.concatenate([terms, table.right[..., None]], axis=-1), -1, 0))).max(axis=0)
        rest = table.left @ true_columns(arm, base) - table.right
        rest[:-1] = centred(rest[:-1])
        share = rms(rest) / scale
        print([f"{x:.1e}" for x in share], [f"{x:.2f}" for x in rms(rest) / noise])
        # smoothed states err by the sensors' noise, which sets the joints ringing
        assert np.all(share <= [5e-6, 3e-5, 3e-5, 1e-5])


@pytest.mark.slow
def test_the_true_models_twin_needs_no_servo() -> None:
    """Its torques are the run's but for what holds it against the noise of its start."""
    for one, twin in zip(records(), twins(), strict=True):
        at = one.starts[:, None] + np.arange(one.cycles)
        added = rms(np.swapaxes(twin.exact.tau - one.samples.tau[at], 0, 2)) / rms(
            np.swapaxes(one.samples.tau[at], 0, 2)
        )
        print(added)
        assert added.max() < 1e-3


@pytest.mark.slow(only=["changes0*"])
@pytest.mark.parametrize(("changes", "limit"), [
    ((), 3e-4),
    ((("k1", 0.8),), 0.25),
    ((("Im2", 1.1),), 0.05),
    ((("b1", 0.0), ("b2", 2.0)), 0.05),
])  # fmt: skip
def test_a_wrong_models_twin_stays_on_the_path(changes: Sequence[tuple[str, float]], limit: float) -> None:
    """Within a share of how far the joints move, however long the arc."""
    for one, twin in zip(records(), follow(wrong(*changes), records()), strict=True):
        plain = one.readings()
        for got, want in ((twin.exact.q, plain.q), (twin.exact.theta, plain.theta)):
            away = np.abs(got - want).max(axis=(0, 1)) / np.ptp(want, axis=(0, 1))
            print(away)
            assert away.max() < limit


@pytest.mark.slow
def test_friction_does_not_leave_the_path_either() -> None:
    """A twin without the friction that the run has."""
    arm, model, scenario = example("b")
    friction = effect(arm, "motor_coulomb", 0, 0.5)
    moved = trajectory_of(arm, replace(model, effects=(friction,)), scenario, duration_s=4.0, rtol=1e-9, atol=1e-11)
    one = read_measured_run(arm, Path("b"), encode(arm, moved.cycles()))
    (twin,) = follow(true_dynamics(), [one])
    away = np.abs(twin.exact.q - one.readings().q).max(axis=(0, 1)) / np.ptp(one.readings().q, axis=(0, 1))
    print(away)
    assert away.max() < 0.2


def test_the_fit_gives_back_what_a_twin_was_made_with() -> None:
    """Base parameters and effects, from readings without noise; a wrong model's twin as well."""
    arm, _, _ = example()
    effects = effects_of(arm)
    hypothesis = read_hypothesis(Layout(arm), replace(null_model(), effects=(*null_model().effects, *effects)))
    right = true_dynamics(*effects)
    off_in_values = replace(wrong(("k1", 0.9), ("Im2", 1.1)), laws=right.laws, torque_lag=right.torque_lag)
    for dynamics in (right, off_in_values):
        truth = np.array([coefficient(dynamics, hypothesis, name) for name in hypothesis.names])
        layout = hypothesis.layout
        sums = [exact_sums(twin, base_values(dynamics, layout), layout) for twin in follow(dynamics, records())]
        found = fit(hypothesis, sums, study().weight)
        off = np.abs(found.value - truth) / np.where(truth == 0.0, 1e-3, np.abs(truth))
        print({name: f"{x:.1e}" for name, x in zip(hypothesis.names, off, strict=True)})
        assert off.max() < 5e-3
        assert np.abs(found.zeros).max() < 0.5 * Layout(arm).zero_sigma.min()


def test_draws_of_a_twin_scatter_about_what_it_was_made_with() -> None:
    """With what noise adds to the sums taken out, the mean of the draws is what the noise-free twin gives."""
    one = study()
    truth = np.array([coefficient(one.model, one.hypothesis, name) for name in one.hypothesis.names])
    found = fit(one.hypothesis, one.twin_sums, one.weight)
    assert found.value.shape == (limits.DRAWS.value, len(truth))
    values, h = base_values(one.model, one.layout), one.layout.balances.index("H")
    exact = [
        accumulate(balance_rows(Layout(twin.arm), twin.exact, values, every=thinning(twin.arm)), kept, (h,))
        for twin, kept in zip(one.twins, one.accepted, strict=True)
    ]
    still = fit(one.hypothesis, exact, one.weight).value - truth
    print((still / one.spread).round(2), (one.bias / one.spread).round(2), one.spread / truth)
    assert np.all(np.abs(one.bias - still) < 0.1 * one.spread)
    # what a smooth curve does not follow is no more than some deviations
    assert np.all(np.abs(one.bias) < 3.0 * one.spread)
    assert np.all(one.spread < 1e-4 * truth)


def test_noise_in_the_columns_biases_a_fit_that_ignores_it() -> None:
    """What noise adds to the sums is not nothing: where it stays in, the draws' mean is visibly another."""
    one = study()
    plain = [replace(sums, noise=None) for sums in one.twin_sums]
    shift = fit(one.hypothesis, plain, one.weight).value - fit(one.hypothesis, one.twin_sums, one.weight).value
    print((shift.mean(axis=0) / one.spread).round(2))
    assert np.abs(shift.mean(axis=0) / one.spread).max() > 0.2


def test_momentum_of_a_twin_is_the_models() -> None:
    """Each arc begins with the angular momentum that the model assumes, and keeps it."""
    arm, _, _ = example()
    dynamics = replace(true_dynamics(), angular_momentum=7.0)
    for assumed, made in ((0.0, twins()), (7.0, follow(dynamics, records()))):
        for twin in made:
            state = smoothed_states(arm, twin.exact)
            h = dynamics.momentum(state.q, state.base, state.qd, state.thetad)
            print(np.abs(h - assumed).max())
            assert np.abs(h - assumed).max() < 0.5


def test_rigid_twin_has_one_angle_a_joint() -> None:
    """And stays about where the motor was, though the run's joint bends by half a radian."""
    dynamics = replace(true_dynamics(), stiffness=np.array([np.inf, 1000.0]))
    for one, twin in zip(records(), follow(dynamics, records()), strict=True):
        np.testing.assert_array_equal(twin.exact.q[..., 0], twin.exact.theta[..., 0])
        assert np.abs(twin.exact.q[..., 1] - twin.exact.theta[..., 1]).max() > 1e-3
        away = np.abs(twin.exact.theta - one.readings().theta).max(axis=(0, 1))
        print(away)
        assert away.max() < 0.6


def test_a_reading_of_a_twin_errs_as_the_sensors_declare() -> None:
    arm, _, _ = example()
    arm = replace(arm, joints=tuple(replace(joint, torque_sigma=0.01) for joint in arm.joints))
    twin = twins()[0]
    noisy = replace(twin, arm=arm)
    one, again, other = measure(noisy, 3), measure(noisy, 3), measure(noisy, 4)
    np.testing.assert_array_equal(one.q, again.q)
    assert not np.any(one.q == other.q)
    sigma = arm.joints[0].link_encoder.sigma_rad
    for got, want, size in (
        (one.q, twin.exact.q, sigma),
        (one.theta, twin.exact.theta, sigma),
        (one.tau, twin.exact.tau, np.hypot(0.01, TORQUE_STEP / np.sqrt(12.0))),
        (one.omega0, twin.exact.omega0, np.hypot(arm.imu.rate_sigma, arm.imu.step / np.sqrt(12.0))),
    ):
        error = got - want
        # the gyro's bias walks by 1e-8 sqrt(20 s), which is nothing beside its white noise
        assert error.std() == pytest.approx(size, rel=3.0 / np.sqrt(2.0 * error.size))


def test_the_wire_adds_its_rounding() -> None:
    """To what is finer than its steps; encoders whose steps are the wire's are not rounded twice."""
    arm, _, _ = example()
    same = arm.over_the_wire
    assert [j.link_encoder for j in same.joints] == [j.link_encoder for j in arm.joints]
    fine = [replace(j, link_encoder=replace(j.link_encoder, quantum_rad=2.0 * np.pi / 2**24)) for j in arm.joints]
    imu = replace(arm.imu, resolution="coarse", rate_sigma=0.0)
    through = replace(arm, joints=tuple(fine), imu=imu).over_the_wire
    assert through.joints[0].link_encoder.sigma_rad == pytest.approx(2.0 * np.pi / 2**20 / np.sqrt(12.0), rel=0.01)
    assert through.imu.rate_sigma == pytest.approx(2.0**-13 / np.sqrt(12.0))
    assert through.joints[1].torque_sigma == pytest.approx(1e-4 / np.sqrt(12.0))


# ---------------------------------------------------------------- sums


def parts(readings: Readings, arcs: slice) -> Readings:
    """Some arcs of readings."""
    return Readings(readings.q[arcs], readings.theta[arcs], readings.omega0[arcs], readings.tau[arcs])


def test_sums_do_not_depend_on_how_draws_are_split() -> None:
    """Draws one at a time, in two calls, and stacked into one batch; a run arc by arc."""
    arm, model, _ = example()
    base, h = model.base_values(arm), Layout(arm).balances.index("H")
    twin = twins()[0]
    accepted = everything(twin)
    accepted[0, 100:200] = False
    zeros = zero_columns(Layout(arm), twin.exact, base)
    whole = draws(twin, accepted, 4, Layout(arm), (h,), zeros, base)
    halves = [draws(twin, accepted, 2, Layout(arm), (h,), zeros, base, seed) for seed in (0, 2)]
    readings = [measure(twin, seed) for seed in range(4)]
    stacked = Readings(
        *(np.stack([getattr(one, name) for one in readings]) for name in ("q", "theta", "omega0", "tau"))
    )
    batch = accumulate(balance_rows(Layout(arm), stacked, zeros=zeros), accepted, (h,))
    arcs = []
    for k in range(2):
        own = tuple(column[k : k + 1] for column in zeros)
        rows = balance_rows(Layout(arm), parts(readings[0], slice(k, k + 1)), zeros=own)
        arcs.append(accumulate(rows, accepted[k : k + 1], (h,)))
    for k, gram in enumerate(whole.gram):
        np.testing.assert_array_equal(gram, np.concatenate([half.gram[k] for half in halves]))
        scale = np.sqrt(np.einsum("...ii->...i", gram))
        size = scale[..., :, None] * scale[..., None, :]
        assert np.all(np.abs(batch.gram[k] - gram) <= 1e-12 * size)
        assert np.all(np.abs(arcs[0].gram[k] + arcs[1].gram[k] - gram[0]) <= 1e-12 * size[0])
    np.testing.assert_array_equal(whole.count, halves[0].count)
    np.testing.assert_array_equal(arcs[0].count + arcs[1].count, whole.count)
    assert whole.count[0] == accepted.sum() == accepted.size - 100


def test_instants_that_are_refused_do_not_count() -> None:
    """Whatever stands there; constants of the arcs are those of the rest, and an arc may be refused as a whole."""
    arm, model, _ = example()
    twin = twins()[0]
    table = balance_rows(Layout(arm), twin.exact, model.base_values(arm))
    accepted = everything(twin)
    accepted[1] = False
    accepted[0, :50] = False
    plain = accumulate(table, accepted)
    for rows in table.balances:
        rows.left[..., 0, :50, :] += 1e6
        rows.right[..., 1, :] -= 1e6
    for got, want in zip(accumulate(table, accepted).gram, plain.gram, strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-12)


def test_sums_of_a_record_use_what_the_smoother_follows() -> None:
    arm, _, _ = example()
    first = study()
    for one, accepted, seen in zip(first.records, first.accepted, first.sums, strict=True):
        assert accepted.shape == (len(one.starts), one.instants)
        np.testing.assert_array_equal(seen.count, accepted[:, :: thinning(arm)].sum())
        assert accepted.mean() > 0.99


# ---------------------------------------------------------------- the fit


def test_the_fit_is_least_squares() -> None:
    """Of all instants of all balances, each over its noise, with a constant an arc and zeros that the arm file holds;
    against numpy on the rows themselves."""
    arm, model, _ = example()
    known = study().layout
    hypothesis = replace(study().hypothesis, effects=("motor_viscous1",))
    base, weight, h = model.base_values(arm), study().weight, known.balances.index("H")
    zeros, names = len(known.zeros), hypothesis.names
    stacked, right, sums = [], [], []
    for run, twin in enumerate(twins()):
        rows = balance_rows(Layout(arm), measure(twin, 7), base)
        table = dense(rows)
        accepted = everything(twin)
        accepted[0, 300:700] = False
        sums.append(accumulate(rows, accepted, (h,)))
        for balance in range(len(known.balances)):
            for arc, kept in enumerate(accepted):
                block = np.column_stack([table.left[balance, arc], table.right[balance, arc]])[kept]
                if balance != h:
                    block = block - block.mean(axis=0)
                columns = {name: weight[balance] * block[:, k] for k, name in enumerate(known.columns)}
                shared = np.column_stack([columns[name] for name in names])
                own = np.zeros((len(shared), 2 * zeros))
                own[:, run * zeros : (run + 1) * zeros] = np.column_stack([columns[name] for name in known.zeros])
                stacked.append(np.column_stack([shared, own]))
                right.append(weight[balance] * block[:, -1])
    held = np.diag(np.tile(1.0 / known.zero_sigma, 2))
    stacked.append(np.column_stack([np.zeros((2 * zeros, len(names))), held]))
    right.append(np.zeros(2 * zeros))
    design, wanted = np.concatenate(stacked), np.concatenate(right)
    scale = np.linalg.norm(design, axis=0)
    want = np.linalg.lstsq(design / scale, wanted)[0] / scale
    found = fit(hypothesis, sums, weight)
    spread = np.sqrt(np.diag(np.linalg.inv((design / scale).T @ (design / scale)))) / scale
    np.testing.assert_array_less(np.abs(found.value - want[: len(names)]), 1e-3 * spread[: len(names)])
    np.testing.assert_array_less(np.abs(found.zeros.ravel() - want[len(names) :]), 1e-3 * spread[len(names) :])


def loose(arm: Arm) -> Arm:
    """The arm, had nobody looked for its encoders' zeros."""
    joints = tuple(
        replace(
            j,
            link_encoder=replace(j.link_encoder, zero_sigma_rad=1e-3),
            motor_encoder=replace(j.motor_encoder, zero_sigma_rad=1e-3),
        )
        for j in arm.joints
    )
    return replace(arm, joints=joints)


def test_zeros_of_the_encoders_are_found() -> None:
    """Each run has its own; the parameters are those of encoders that are right."""
    arm, model, _ = example()
    arm = loose(arm)
    layout = Layout(arm)
    hypothesis, base = replace(study().hypothesis, layout=layout), model.base_values(arm)
    off = 1e-4 * np.array([[1.0, -2.0, 0.5, 1.5], [-1.0, 1.0, 2.0, -0.5]])
    sums = []
    for twin, zero in zip(twins(), off, strict=True):
        seen = replace(twin.exact, q=twin.exact.q + zero[::2], theta=twin.exact.theta + zero[1::2])
        sums.append(accumulate(balance_rows(layout, seen, base), everything(twin), (layout.balances.index("H"),)))
    found = fit(hypothesis, sums, study().weight)
    error = np.abs(found.value / base - 1.0)
    encoders = found.zeros[..., : off.shape[-1]]
    print(encoders / off, error)
    # to first order in the zeros
    np.testing.assert_allclose(encoders, off, rtol=0.0, atol=3e-6)
    assert error.max() < 1e-5


# ---------------------------------------------------------------- one balance by itself


@pytest.mark.parametrize("joint", [1, 2])
def test_a_motors_balance_alone_finds_its_drive(joint: int) -> None:
    """Inertia, stiffness and damping of its joint; what it does not see is 0."""
    arm, _, _ = example()
    dynamics, hypothesis = true_dynamics(), study().hypothesis
    sums = [exact_sums(twin, base_values(dynamics, Layout(arm))) for twin in twins()]
    balance = Layout(arm).balances.index(f"M{joint}")
    found: Fit = fit(hypothesis, sums, study().weight, alone=balance)
    for name in hypothesis.names:
        want = coefficient(dynamics, hypothesis, name) if name in {f"Im{joint}", f"k{joint}", f"b{joint}"} else 0.0
        print(name, f"{abs(float(found.of(name)) - want) / (want or 1.0):.1e}")
        assert float(found.of(name)) == pytest.approx(want, rel=3e-5, abs=0.0)
    assert np.isfinite(found.rms[:, balance]).all()
    assert np.isnan(np.delete(found.rms, balance, axis=1)).all()


def test_a_fit_of_too_little_is_undecided() -> None:
    """Arcs in which nothing moves."""
    arm, model, _ = example()
    twin = twins()[0]
    still = Readings(
        np.zeros_like(twin.exact.q), np.zeros_like(twin.exact.q), np.zeros_like(twin.exact.omega0), twin.exact.tau
    )
    sums = accumulate(balance_rows(Layout(arm), still, model.base_values(arm)), everything(twin))
    with pytest.raises(Undecided, match="a00 moves nothing"):
        fit(study().hypothesis, [sums], np.ones(4))
