# SPDX-License-Identifier: MIT
"""The flight library as a whole: its calls and their misuse, arcs and blocks, what it answers and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_support import (
    CHOSEN,
    arcs,
    balanced,
    bytes_of,
    chosen,
    copy_of,
    energy_only,
    joined,
    part,
    sines,
    traced,
)  # fmt: skip
from numpy.typing import NDArray
from reference_support import make_arm
from runs_support import trajectory_of
from scipy.spatial.transform import Rotation
from state_support import config_of_its_own

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native.flight import REASONS, Flight, Trace, config_of, cycles_to_native, encode, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, INVALID, Cycles
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]

MAX_BLOCKS = int(lib.ZYGOS_MAX_BLOCKS_VALUE)
MIN_ARC = int(lib.ZYGOS_MIN_ARC_INSTANTS_VALUE)
NO_DATA, NOT_IDENTIFIABLE, TOO_FAST, NOT_PHYSICAL = REASONS[1:5]


@pytest.fixture
def arm(tmp_path: Path) -> Arm:
    return energy_only(make_arm(tmp_path))


def fed(arm: Arm, cycles: Cycles) -> Flight:
    flight = Flight(arm)
    flight.cycles(cycles)
    return flight


@cache
def _closing(arm: Arm, n: int) -> Cycles:
    return balanced(arm, sines(arm, n), chosen(arm))


def closing(arm: Arm, n: int) -> Cycles:
    """n cycles whose rows balance for the chosen parameters; they may be changed."""
    return deepcopy(_closing(arm, n))


def fill(arm: Arm) -> int:
    """Cycles after a gap that bring no row: the window but one, and three instants for the dissipation."""
    return 2 * arm.smoother.lag + 3


# ---------------------------------------------------------------- configuration


def set_(path: str, value: Any) -> Callable[[Any], None]:
    """Sets one member of a struct, such as joint[1].node, to a value or to what a function makes of it."""

    def change(struct: Any) -> None:
        *parents, last = path.replace("[", ".").replace("]", "").split(".")
        target = struct
        for name in parents:
            target = target[int(name)] if name.isdigit() else getattr(target, name)
        before = target[int(last)] if last.isdigit() else getattr(target, last)
        after = value(before) if callable(value) else value
        if last.isdigit():
            target[int(last)] = after
        else:
            setattr(target, last, after)

    return change


NAN, INF = float("nan"), float("inf")
REFUSALS = [
    (lib.ZYGOS_E_ABI, "abi", [0, lib.zygos_abi() ^ 1, lib.zygos_abi() + 31]),
    (lib.ZYGOS_E_JOINTS, "joints", [0, 8, 2**32 - 1]),
    (lib.ZYGOS_E_KINETIC, "kinetic", [3, 2**32 - 1]),
    (lib.ZYGOS_E_BASE, "base", [1, 2, 2**32 - 1]),  # a fixed base has no gyro
    (lib.ZYGOS_E_BASE, "gravity", [[0.0, 0.0, -9.81], [NAN, 0.0, 0.0]]),
    (lib.ZYGOS_E_PERIOD, "period_s", [0.0, -0.02, 0.9e-5, 0.0651, NAN, INF]),
    (lib.ZYGOS_E_TORQUE_LAW, "torque_law", [3, 2**32 - 1]),
    (lib.ZYGOS_E_SMOOTHER, "smoother_half_width", [0, 1, 2, 4, 16, 2**31]),
    (lib.ZYGOS_E_SMOOTHER, "smoother_order", [0, 1, 5, 2**32 - 1]),
    (lib.ZYGOS_E_SMOOTHER, "smoother_lag", [0, 2, 4]),
    (lib.ZYGOS_E_NODE, "imu_node", [0, 1, 2, 32]),
    (lib.ZYGOS_E_NODE, "joint[0].node", [0, 2, 16, 32]),
    (lib.ZYGOS_E_NODE, "joint[1].node", [0, 1, 16, 2**32 - 1]),
    (lib.ZYGOS_E_AXIS, "joint[0].axis[2]", [0.0, -1.0, 0.999, NAN]),
    (lib.ZYGOS_E_AXIS, "joint[1].axis[2]", [-1.0, 1.001]),
    (lib.ZYGOS_E_AXIS, "joint[1].axis", [[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [NAN, 0.0, 1.0]]),
    (lib.ZYGOS_E_VALUE, "joint[0].rigid", [2, 2**32 - 1]),
    (lib.ZYGOS_E_VALUE, "joint[1].gear_ratio", [0.0, -50.0, NAN, INF]),
    (lib.ZYGOS_E_VALUE, "joint[0].link_sign", [0.0, 2.0, -0.5, NAN]),
    (lib.ZYGOS_E_VALUE, "joint[1].motor_sign", [0.0, 2.0, -0.5, NAN]),
    (lib.ZYGOS_E_VALUE, "joint[1].link_zero_rad", [NAN, INF, -INF]),
    (lib.ZYGOS_E_VALUE, "joint[0].motor_zero_rad", [NAN, INF, 1e9]),
    (lib.ZYGOS_E_VALUE, "joint[1].link_sigma_rad", [-1e-6, NAN, INF]),
    (lib.ZYGOS_E_VALUE, "joint[0].motor_sigma_rad", [-1e-6, NAN, INF]),
    (lib.ZYGOS_E_VALUE, "joint[1].latch_us", [20_001, 2**32 - 1]),
    (lib.ZYGOS_E_VALUE, "joint[1].link_latch_s", [-1e-6, 0.0201, NAN]),
    (lib.ZYGOS_E_VALUE, "joint[0].motor_latch_s", [-1e-6, 0.0201, NAN]),
    (lib.ZYGOS_E_VALUE, "imu_latch_s", [-1e-6, 0.0201, NAN]),
    (lib.ZYGOS_E_VALUE, "imu_to_base[4]", [1.1, -1.0, 0.0, NAN]),
    (lib.ZYGOS_E_VALUE, "imu_to_base", [[0.0] * 9, [0, 1, 0, 1, 0, 0, 0, 0, 1], [0.6, 0.8, 0, 0.8, 0.6, 0, 0, 0, 1]]),
    (lib.ZYGOS_E_VALUE, "imu_fine", [2, 2**32 - 1]),
    (lib.ZYGOS_E_VALUE, "imu_sigma", [-1e-9, 1.1, NAN, INF]),
    (lib.ZYGOS_E_VALUE, "forgetting_factor", [0.0, 0.89, 1.0 + 1e-15, NAN]),
    (lib.ZYGOS_E_VALUE, "compensation", [18, 2**32 - 1]),
    (lib.ZYGOS_E_ARC, "arc_cycles", [0, MIN_ARC - 1]),
    (lib.ZYGOS_E_ARC, "impulse_arc_cycles", [1, MIN_ARC - 1]),
    (lib.ZYGOS_E_ARC, "momentum_arc_cycles", [1, MIN_ARC - 1]),
    (lib.ZYGOS_E_EFFECT, "effects", [2, 5, 2**32 - 1]),
]


def test_a_configuration_is_refused_and_nothing_changed(arm: Arm) -> None:
    flight = fed(arm, sines(arm, 100))
    before = copy_of(flight)
    for code, path, values in REFUSALS:
        for value in values:
            config = config_of(arm)
            set_(path, value)(config)
            assert lib.zygos_arm_init(flight.native, config) == code, (path, value)
        assert ffi.buffer(flight.native) == ffi.buffer(before.native), path


def test_any_rotation_of_the_gyro_is_taken_and_no_reflection(arm: Arm) -> None:
    native, config = ffi.new("zygos_arm_t *"), config_of(arm)
    for rotation in Rotation.random(40, random_state=0).as_matrix():
        for sign, code in ((1.0, 1), (-1.0, lib.ZYGOS_E_VALUE)):
            config.imu_to_base = (sign * rotation).ravel().tolist()
            assert lib.zygos_arm_init(native, config) == code


def test_every_refusal_has_a_configuration(arm: Arm) -> None:
    codes = {value for name, value in vars_of_enum("enum zygos_error").items()}
    of_snapshots = {code for code in codes if code <= lib.ZYGOS_E_SNAPSHOT}
    others = {lib.ZYGOS_E_NULL, lib.ZYGOS_E_ORDER, lib.ZYGOS_E_KEEP, *of_snapshots}
    assert {code for code, _, _ in REFUSALS} == codes - others


def vars_of_enum(name: str) -> dict[str, int]:
    return {label: value for value, label in ffi.typeof(name).elements.items()}


def test_the_edges_of_what_is_allowed(arm: Arm) -> None:
    native = ffi.new("zygos_arm_t *")
    for path, value in (
        ("period_s", 1e-5),
        ("period_s", 0.065),
        ("smoother_order", 2),
        ("torque_law", 2),
        ("arc_cycles", MIN_ARC),
        ("arc_cycles", 2**32 - 1),
        ("imu_node", 31),
        ("joint[1].node", 31),
        ("joint[1].link_sigma_rad", 0.0),
        ("imu_latch_s", 0.02),
        ("imu_sigma", 0.0),
        ("forgetting_factor", 0.9),
        ("compensation", 15),
        ("impulse_arc_cycles", MIN_ARC),
        ("momentum_arc_cycles", MIN_ARC),
    ):
        config = config_of(arm)
        set_(path, value)(config)
        assert lib.zygos_arm_init(native, config) == 1, path


def test_the_binding_names_what_the_library_refuses(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="shorter than 20 cycles"):
        Flight(make_arm(tmp_path, tail="[arc]\nmax_s = 0.2"))


def test_init_with_its_own_configuration(arm: Arm) -> None:
    """Starting again from the configuration inside the struct itself."""
    flight = fed(arm, sines(arm, 100))
    assert lib.zygos_arm_init(flight.native, ffi.addressof(flight.native, "sums", "config")) == 1
    assert bytes_of(flight.native) == bytes_of(Flight(arm).native)


def test_init_starts_from_nothing(arm: Arm) -> None:
    """Whatever the memory held before, and however often it was used."""
    used = fed(arm, sines(arm, 300))
    ffi.buffer(used.native)[0:8] = b"\xa5" * 8
    assert lib.zygos_arm_init(used.native, config_of(arm)) == 1
    assert bytes_of(used.native) == bytes_of(Flight(arm).native)


# ---------------------------------------------------------------- misuse


def test_null_pointers(arm: Arm) -> None:
    flight = Flight(arm)
    before = bytes_of(flight.native)
    null = ffi.NULL
    frame, cycle, work = ffi.new("zygos_frame_t *"), ffi.new("zygos_cycle_t *"), ffi.new("zygos_work_t *")
    verdicts = [
        lib.zygos_arm_init(null, config_of(arm)),
        lib.zygos_arm_init(flight.native, null),
        lib.zygos_arm_frame(null, frame),
        lib.zygos_arm_frame(flight.native, null),
        lib.zygos_arm_step(null),
        lib.zygos_arm_cycle(null, cycle),
        lib.zygos_arm_cycle(flight.native, null),
        lib.zygos_arm_restart(null, 0),
        lib.zygos_work_solve(null, ffi.new("zygos_estimate_t *")),
        lib.zygos_work_solve(work, null),
    ]
    assert set(verdicts) == {lib.ZYGOS_E_NULL}
    lib.zygos_arm_take(flight.native, null)
    lib.zygos_arm_take(null, work)
    assert bytes_of(work) == bytes(ffi.sizeof("zygos_work_t"))
    assert bytes_of(flight.native) == before


@pytest.mark.parametrize("pattern", [0x00, 0xFF, 0xA5])
def test_calls_before_init(arm: Arm, pattern: int) -> None:
    """Zeroed memory and memory of any content are both refused and left alone."""
    native = ffi.new("zygos_arm_t *")
    ffi.memmove(native, bytes([pattern]) * ffi.sizeof("zygos_arm_t"), ffi.sizeof("zygos_arm_t"))
    before = bytes_of(native)
    verdicts = [
        lib.zygos_arm_frame(native, ffi.new("zygos_frame_t *")),
        lib.zygos_arm_step(native),
        lib.zygos_arm_cycle(native, ffi.new("zygos_cycle_t *")),
        lib.zygos_arm_restart(native, 0),
    ]
    assert set(verdicts) == {lib.ZYGOS_E_ORDER}
    assert bytes_of(native) == before


def test_solving_what_was_never_taken_is_refused() -> None:
    """A zeroed struct, one of any content, and one taken from an arm without init."""
    out = ffi.new("zygos_estimate_t *")
    for pattern in (0x00, 0xFF, 0xA5):
        work = ffi.new("zygos_work_t *")
        ffi.memmove(work, bytes([pattern]) * ffi.sizeof("zygos_work_t"), ffi.sizeof("zygos_work_t"))
        assert lib.zygos_work_solve(work, out) == 0
        assert (out.validity, out.reason) == (lib.ZYGOS_REFUSED, lib.ZYGOS_REASON_CORRUPT)
        assert np.isnan(list(out.value)).all()
    work = ffi.new("zygos_work_t *")
    lib.zygos_arm_take(ffi.new("zygos_arm_t *"), work)
    assert lib.zygos_work_solve(work, out) == 0


def test_a_failed_init_does_not_arm_the_struct(arm: Arm) -> None:
    native, config = ffi.new("zygos_arm_t *"), config_of(arm)
    config.joints = 0
    lib.zygos_arm_init(native, config)
    assert lib.zygos_arm_step(native) == lib.ZYGOS_E_ORDER


# ---------------------------------------------------------------- arcs


def test_rows_begin_when_window_and_dissipation_are_filled(arm: Arm) -> None:
    trace = traced(arm, replace(sines(arm, 40), tau=np.full((40, arm.n), 0.3)))
    assert np.flatnonzero(trace.instant).tolist() == list(range(fill(arm), 40))
    n, p = arm.n, len(arm.parameter_names)
    origin = trace.row[fill(arm)]
    damping = [arm.parameter_names.index(f"b{i + 1}") for i in range(n)]
    assert origin[p] == 0.0
    assert origin[damping].tolist() == [0.0] * n
    assert (trace.row[fill(arm) + 1 :, damping] > 0.0).all()


def plain_sums(arm: Arm, trace: Any) -> tuple[Floats, Floats]:
    """A and b from the trace's rows: each arc's mean taken away, arcs of fewer than 20 accepted rows left out."""
    p = len(arm.parameter_names)
    gram = np.zeros((p + 1, p + 1))
    for start, stop in arcs(arm, trace):
        rows = trace.row[start:stop][trace.accepted[start:stop]]
        if len(rows) >= MIN_ARC:
            rows = rows - rows.mean(axis=0)
            gram += rows.T @ rows
    return gram[:p, :p], gram[:p, p]


def same_sums(flight: Flight, trace: Any) -> None:
    """To 1e-12 of each column's maximum."""
    found, expected = flight.normal_equations(), plain_sums(flight.arm, trace)
    scale = np.sqrt(np.diag(expected[0]))
    assert (np.abs(found[0] - expected[0]) <= 1e-12 * np.outer(scale, scale)).all()
    work = np.sqrt(np.sum(trace.row[trace.accepted, -1] ** 2))
    assert (np.abs(found[1] - expected[1]) <= 1e-12 * scale * work).all()


def test_longest_arc(arm: Arm) -> None:
    """After arc_cycles instants the work and the dissipation begin again at zero, without losing an instant."""
    arm = replace(arm, arc_max_s=100 * arm.period_s)
    trace = traced(arm, replace(sines(arm, 350), tau=np.full((350, arm.n), 0.3)))
    rows = trace.row[fill(arm) :]
    assert trace.instant[fill(arm) :].all()
    origins = np.flatnonzero((rows[:, -1] == 0.0) & (rows[:, arm.parameter_names.index("b1")] == 0.0))
    assert origins.tolist() == [0, 100, 200, 300]
    flight = fed(arm, sines(arm, 350))
    assert flight.counts["accepted"] == 350 - fill(arm)
    assert flight.estimate().arcs == 4  # the open one included


@pytest.mark.parametrize("how", ["missing", "flag", "invalid", "back", "not finite", "too large"])
def test_a_gap_ends_the_arc_and_fills_again(arm: Arm, how: str) -> None:
    """Cycle 101 is lost in some way, or is not what follows cycle 100."""
    cycles = sines(arm, 200)
    at, lost = 100, how not in ("flag", "back")
    if how == "missing":
        cycles = joined(part(cycles, 0, at), part(cycles, at + 1, 200))
        lost = False
    elif how == "flag":
        cycles.flags[at] = BREAK_BEFORE
    elif how == "invalid":
        cycles.flags[at] = INVALID
    elif how == "back":
        cycles.sync[at:] -= 1
    elif how == "not finite":
        cycles.theta[at, 1] = np.nan
    else:
        cycles.omega[at, 0] = -1.1e6
    flight = Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    again = int(np.flatnonzero(~trace.instant)[fill(arm)])
    assert again == at
    assert np.flatnonzero(~trace.instant).tolist() == [*range(fill(arm)), *range(at, at + fill(arm))]
    counts = flight.counts
    assert counts["gaps"] == 1
    assert counts["invalid"] == int(lost)
    assert counts["cycles"] == len(cycles) - int(lost)
    assert flight.estimate().arcs == 2  # the open one included
    same_sums(flight, trace)


def test_a_cycle_that_is_not_finite_is_counted_and_dropped(arm: Arm) -> None:
    """Angles may go up to 1e4 rad, torques and rates up to 1e6."""
    flight, first = Flight(arm), 1
    for signal, value in (
        *product(["q", "theta", "tau", "omega"], [np.nan, np.inf, -np.inf, 1.000001e6, -1.000001e6, -1e300]),
        *product(["q", "theta"], [1.000001e4, -1.000001e4]),
    ):
        flight.cycles(sines(arm, 20, first=first))
        before, one = flight.counts, sines(arm, 1, first=first + 20)
        getattr(one, signal)[0, -1] = value
        assert lib.zygos_arm_cycle(flight.native, cycles_to_native(one)) == 0
        changed = {name for name, count in flight.counts.items() if count != before[name]}
        assert changed - {"arcs_dropped", "accepted"} == {"invalid", "gaps"}, (signal, value)
        first += 21
    assert np.isfinite(flight.normal_equations()[0]).all()


@pytest.mark.parametrize("signal", ["q", "theta"])
def test_an_angle_that_wraps_ends_the_arc(arm: Arm, signal: str) -> None:
    """Over the end of the 16 turns that the wire holds; a step of less than 8 turns is none."""
    for turns, wraps in ((16, 1), (8.1, 1), (7.9, 0)):
        cycles = sines(arm, 200)
        getattr(cycles, signal)[100:, 1] -= turns * 2.0 * np.pi
        flight = Flight(arm)
        trace = flight.cycles(cycles, trace=True)
        assert trace is not None
        assert (flight.counts["wraps"], flight.counts["gaps"]) == (wraps, wraps)
        assert trace.instant[100] == (not wraps)
        assert flight.estimate().arcs == 1


def test_a_wrap_across_a_gap_is_the_gap(arm: Arm) -> None:
    cycles = sines(arm, 200)
    cycles.q[100:, 1] -= 32.0 * np.pi
    cycles.sync[100:] += 5
    flight = fed(arm, cycles)
    assert (flight.counts["wraps"], flight.counts["gaps"]) == (0, 1)


def test_joints_beyond_those_in_use_are_not_read(arm: Arm) -> None:
    cycles = cycles_to_native(sines(arm, 1))
    cycles[0].q[2] = cycles[0].theta[6] = cycles[0].tau[3] = NAN
    assert lib.zygos_arm_cycle(Flight(arm).native, cycles) == 1


def test_short_arcs_are_dropped_and_counted(arm: Arm) -> None:
    """Arcs of 19, 20, 0 and 150 rows: the first is dropped, the third has nothing to drop."""
    parts, first = [], 1
    for rows in (MIN_ARC - 1, MIN_ARC, 0, 150):
        parts.append(sines(arm, fill(arm) + rows, first=first))
        first += fill(arm) + rows + 5
    flight = Flight(arm)
    trace = flight.cycles(joined(*parts), trace=True)
    assert flight.counts["gaps"] == 3
    assert flight.counts["arcs_dropped"] == 1
    assert flight.counts["accepted"] == MIN_ARC + 150
    same_sums(flight, trace)
    estimate = flight.estimate()
    assert (estimate.arcs, estimate.accepted) == (2, MIN_ARC + 150)


def test_refused_instants_have_no_weight_but_the_arc_runs_on(arm: Arm) -> None:
    """An encoder that jumps for one cycle: the window that holds it is refused, the work and the sums go on."""
    cycles = closing(arm, 600)
    cycles.q[300, 0] += 0.01
    flight = Flight(arm)
    trace = flight.cycles(cycles, trace=True)
    assert trace is not None
    refused = np.flatnonzero(trace.instant & ~trace.accepted)
    assert set(refused) <= set(range(300, 300 + arm.smoother.points))
    assert 0 < len(refused) == flight.counts["refused"] == flight.estimate().refused
    assert flight.counts["accepted"] == 600 - fill(arm) - len(refused)
    assert flight.estimate().arcs == 1
    assert flight.counts["gaps"] == 0
    same_sums(flight, trace)


# ---------------------------------------------------------------- blocks


def even_blocks(instants: list[float]) -> None:
    """Enough blocks, and none with so much of the data that leaving it out tells about the rest only."""
    assert MAX_BLOCKS // 4 <= len(instants) <= MAX_BLOCKS
    assert max(instants) <= sum(instants) / 6


def instants_of(flight: Flight) -> list[float]:
    """Of the blocks, the open ones included."""
    return [block[2] for block in flight.blocks().energy]


def intact(flight: Flight) -> bool:
    return int(lib.zygos_arm_check(flight.native, config_of_its_own(flight), flight._work)) == 1


def constant(arm: Arm, first: int, n: int) -> Cycles:
    """n cycles in which every sensor says the same."""
    shape = (n, arm.n)
    return Cycles(
        sync=np.arange(first, first + n, dtype=np.uint64),
        q=np.full(shape, 0.3),
        theta=np.full(shape, 0.31),
        tau=np.full(shape, 0.1),
        omega=np.full((n, 3), 0.0123),
        flags=np.zeros(n, dtype=np.uint32),
    )


@pytest.mark.slow(but=["150000-*"])
@pytest.mark.parametrize("arc_s", [0.5, 60.0, 1e7])
@pytest.mark.parametrize("cycles", [150_000, 1_000_000])
def test_blocks_of_a_run_of_many_hours(arm: Arm, cycles: int, arc_s: float) -> None:
    """Rest, in arcs of any length: the blocks stay alike, and their sums are not called corrupt."""
    flight = Flight(replace(arm, arc_max_s=arc_s))
    for first in range(1, cycles, 50_000):
        flight.cycles(constant(arm, first, 50_000))
    assert intact(flight)
    instants, waited = instants_of(flight), flight.counts["waited"]
    even_blocks(instants)
    assert sum(instants) + waited > 0.99 * cycles
    assert waited < (0.2 * cycles if arc_s == 0.5 else 1)


@pytest.mark.slow(but=["60.0-8000", "0.4-*"])
@pytest.mark.parametrize(
    ("arc_s", "cycles"), [(60.0, 8_000), (0.4, 5_000), (1e6, 20_000), (60.0, 40_000), (7.0, 20_000)]
)
def test_blocks_merge_and_lose_nothing(arm: Arm, arc_s: float, cycles: int) -> None:
    """Arcs that never end, that end now and then, and that are as short as they may be."""
    arm = replace(arm, arc_max_s=arc_s)
    run = balanced(arm, sines(arm, cycles), chosen(arm))
    flight, traces, accepted = Flight(arm), [], 0
    for start in range(0, cycles, 500):
        trace = flight.cycles(part(run, start, start + 500), trace=True)
        assert trace is not None
        traces.append(trace)
        accepted += int(trace.accepted.sum())
        assert flight.counts["accepted"] == accepted
        # an instant's weights in the two blocks that it is in add up to 1
        instants = instants_of(flight)
        assert sum(instants) == pytest.approx(flight.estimate().accepted, rel=1e-12)
        assert accepted - sum(instants) < MIN_ARC  # those of an open arc that is too short
        assert intact(flight)
    same_sums(flight, Trace.joined(traces))
    even_blocks(instants)
    np.testing.assert_allclose(flight.estimate().value, chosen(arm), rtol=1e-9)


def test_estimates_do_not_disturb_the_accumulation(arm: Arm) -> None:
    run = closing(arm, 2000)
    asked, left = Flight(arm), fed(arm, run)
    for start in range(0, 2000, 20):
        asked.cycles(part(run, start, start + 20))
        asked.estimate()
    assert bytes_of(asked.native) == bytes_of(left.native)


def test_the_same_run_gives_the_same_estimate(arm: Arm) -> None:
    run = closing(arm, 1000)
    flight = fed(arm, run)
    first, second = flight.estimate(), flight.estimate()
    other = fed(arm, run).estimate()
    for name in ("value", "sigma", "covariance"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        np.testing.assert_array_equal(getattr(first, name), getattr(other, name))


# ---------------------------------------------------------------- what is answered


@pytest.mark.parametrize(
    ("law", "imu"), [("applied_from_sync", "fine"), ("applied_previous_cycle", "coarse"), ("sampled", "fine")]
)
def test_balanced_rows_give_their_parameters_back(tmp_path: Path, law: str, imu: str) -> None:
    arm = energy_only(make_arm(tmp_path, law=law, imu=f'resolution = "{imu}"'))
    estimate = fed(arm, closing(arm, 2000)).estimate()
    assert (estimate.validity, estimate.reason) == ("valid", "")
    np.testing.assert_allclose(estimate.value, chosen(arm), rtol=1e-10)
    # no more than the steps of torque frames, which these torques do not have
    assert (estimate.sigma <= 0.01 * chosen(arm)).all()
    assert estimate.rank == len(estimate.names) == len(CHOSEN)
    assert 1.0 <= estimate.condition < 1e8
    assert estimate.residual < 1e-6


def test_a_torque_that_takes_effect_at_once_is_the_one_reported_a_cycle_later(tmp_path: Path) -> None:
    """The two laws for held torque see the same arm when the reports are a cycle apart."""
    early, late = make_arm(tmp_path), make_arm(tmp_path, law="applied_previous_cycle")
    run = closing(early, 500)
    shifted = run.tau.copy()
    shifted[1:] = run.tau[:-1]
    rows = traced(early, run).row, traced(late, replace(run, tau=shifted)).row
    np.testing.assert_array_equal(rows[0][fill(early) :], rows[1][fill(early) :])


def test_torque_one_cycle_off_is_seen(arm: Arm) -> None:
    """The same record under the other torque law gives other parameters: the hold is not symmetric."""
    run = closing(arm, 2000)
    run.tau[1:] = run.tau[:-1].copy()
    estimate = fed(arm, run).estimate()
    known = np.isfinite(estimate.value)
    assert not known.all() or np.max(np.abs(estimate.value / chosen(arm) - 1.0)) > 1e-2


def test_both_doors_give_the_same_rows(arm: Arm) -> None:
    """Cycles that came off the bus, put through the other door, give the same bits."""
    bus = Flight(arm)
    trace = bus.frames(encode(arm, closing(arm, 500)), trace=True)
    assert trace is not None
    direct = fed(arm, trace.cycles)
    for one, other in zip(bus.normal_equations(), direct.normal_equations(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert instants_of(bus) == instants_of(direct)


def test_cycle_number_of_the_estimate(arm: Arm) -> None:
    """That of the newest cycle, whatever number the record began with, and also when there is no answer."""
    for first, n in ((1, 500), (10**15, 500), (7, 3)):
        flight = fed(arm, sines(arm, n, first=first))
        assert flight.estimate().cycle == first + n - 1
        assert flight.counts["cycles"] == n


@pytest.mark.parametrize("instants", [0, 1, MIN_ARC - 1, MIN_ARC, 35])
def test_too_few_data(arm: Arm, instants: int) -> None:
    """Fewer than three instants a parameter: no value, no sigma, not even a wild one."""
    assert 3 * len(arm.parameter_names) == 36
    estimate = fed(arm, closing(arm, fill(arm) + instants)).estimate()
    assert (estimate.validity, estimate.reason) == ("refused", NO_DATA)
    assert np.isnan(estimate.value).all()
    assert np.isnan(estimate.sigma).all()
    assert np.isnan(estimate.covariance).all()
    assert estimate.accepted == (instants if instants >= MIN_ARC else 0)


def test_just_enough_data_are_not_refused_as_too_few(arm: Arm) -> None:
    """Each segment has a block of its own, and the first one two: eight are enough."""
    flight, run, opened = Flight(arm), sines(arm, 400), {}
    for k in range(0, 304, 8):  # segments are whole buffers
        flight.cycles(part(run, k, k + 8))
        opened.setdefault(flight.estimate().blocks, k)
    segment = opened[4] - opened[3]
    for segments, few in ((6, True), (7, False)):
        instants = segments * segment
        estimate = fed(arm, closing(arm, fill(arm) + instants)).estimate()
        assert (estimate.accepted, estimate.blocks) == (instants, segments + 1)
        assert (estimate.reason == NO_DATA) == few


def test_all_at_rest(arm: Arm) -> None:
    """Nothing moves, the torques hold something: not one parameter is identifiable."""
    run = sines(arm, 2000, still=(0, 1))
    run = replace(run, omega=np.zeros_like(run.omega), tau=np.full_like(run.tau, 0.3))
    estimate = fed(arm, run).estimate()
    assert (estimate.validity, estimate.reason) == ("refused", NOT_IDENTIFIABLE)
    assert np.isnan(estimate.value).all()
    assert np.isnan(estimate.sigma).all()


def test_all_at_rest_with_noise(arm: Arm) -> None:
    """Encoder noise excites every column a little; what it gives must not be published."""
    rng = np.random.default_rng(3)
    run = sines(arm, 2000, still=(0, 1))
    sigma = arm.joints[0].link_encoder.sigma_rad
    run = replace(
        run,
        q=run.q + sigma * rng.normal(size=run.q.shape),
        theta=run.theta + sigma * rng.normal(size=run.q.shape),
        omega=1e-6 * rng.normal(size=run.omega.shape),
        tau=np.full_like(run.tau, 0.3),
    )
    estimate = fed(arm, run).estimate()
    assert np.isnan(estimate.value).all(), dict(zip(estimate.names, estimate.value, strict=True))
    assert (estimate.validity, estimate.reason) == ("refused", NOT_IDENTIFIABLE)


@pytest.mark.parametrize(
    ("still", "angle", "known"),
    [
        (1, 0.4, {"a00", "a01", "a02", "Im1", "k1", "b1"}),
        (1, 0.0, {"a00", "Im1", "k1", "b1"}),
        (0, 0.4, {"a02", "a12", "a22", "Im2", "k2", "b2"}),
        (0, 0.0, {"a22", "Im2", "k2", "b2"}),
    ],
)
def test_one_joint_locked(arm: Arm, still: int, angle: float, known: set[str]) -> None:
    """Bodies that move as one cannot be told apart: their columns have no value, the others have the right one.

    With joint 2 locked, bodies 1 and 2 are one, with joint 1 locked, the base and body 1 are. Locked straight, their
    cross terms with the third body have the same column too.
    """
    run = balanced(arm, sines(arm, 2000, still=(still,), angle=angle), chosen(arm))
    estimate = fed(arm, run).estimate()
    found = {name for name, value in zip(estimate.names, estimate.value, strict=True) if np.isfinite(value)}
    assert found == known
    assert (estimate.validity, estimate.reason) == ("partial", NOT_IDENTIFIABLE)
    for name, value, sigma in zip(estimate.names, estimate.value, estimate.sigma, strict=True):
        assert np.isfinite(sigma) == (name in known)
        if name in known:
            np.testing.assert_allclose(value, CHOSEN[name], rtol=1e-10)
    unknown = ~np.isfinite(estimate.value)
    assert np.isnan(estimate.covariance[unknown]).all()
    assert np.isfinite(estimate.covariance[np.ix_(~unknown, ~unknown)]).all()
    assert estimate.rank < len(estimate.names)


def test_motion_too_fast_for_the_sample_rate(arm: Arm) -> None:
    """More than 5 % of the instants refused: the values are there, and doubted."""
    run = closing(arm, 2000)
    run.q[50:2000:100, 1] += 0.01  # each jump spoils up to seven windows
    estimate = fed(arm, run).estimate()
    share = estimate.refused / (estimate.refused + estimate.accepted)
    assert share > 0.05
    assert (estimate.validity, estimate.reason) == ("doubtful", TOO_FAST)


def test_some_refused_instants_are_no_reason_to_doubt(arm: Arm) -> None:
    run = closing(arm, 2000)
    run.q[50:2000:400, 1] += 0.01
    estimate = fed(arm, run).estimate()
    assert 0.0 < estimate.refused / (estimate.refused + estimate.accepted) < 0.05
    assert estimate.reason != TOO_FAST


@pytest.mark.parametrize(
    ("name", "value"), [("k1", -400.0), ("b2", -2.0), ("Im1", -0.01), ("a01", 40.0), ("a22", -1.0)]
)
def test_not_physical(arm: Arm, name: str, value: float) -> None:
    """A negative stiffness, damping or rotor inertia, and an inertia matrix that is not positive definite."""
    parameters = chosen(arm)
    parameters[arm.parameter_names.index(name)] = value
    estimate = fed(arm, balanced(arm, sines(arm, 2000), parameters)).estimate()
    assert (estimate.validity, estimate.reason) == ("doubtful", NOT_PHYSICAL)
    np.testing.assert_allclose(estimate.value, parameters, rtol=1e-10)


@pytest.mark.parametrize("rest", [200, 9000, 40_000])
def test_rest_after_motion_is_not_called_corrupt(arm: Arm, rest: int) -> None:
    """The constants of an arc at rest are far larger than what remains of them once its mean is taken away."""
    flight = fed(arm, closing(arm, 2000))
    still = constant(arm, 2001, rest)
    still.flags[0] = BREAK_BEFORE
    flight.cycles(still)
    estimate = flight.estimate()
    assert (estimate.validity, estimate.reason) == ("valid", "")
    np.testing.assert_allclose(estimate.value, chosen(arm), rtol=1e-9)


# ---------------------------------------------------------------- restart


def test_restart_forgets_the_estimate_and_keeps_reception(arm: Arm) -> None:
    """After a restart the rest of the run gives the bits of an arm that never saw the first part."""
    run = closing(arm, 1200)
    first, second = part(run, 0, 600), part(run, 600, 1200)
    flight = Flight(arm)
    flight.frames(encode(arm, first)[:-1])
    assert lib.zygos_arm_restart(flight.native, lib.ZYGOS_KEEP_NOTHING) == 1
    assert flight.estimate().validity == "refused"
    assert flight.counts["accepted"] == 0
    trace = flight.frames(encode(arm, second), trace=True)
    assert trace is not None
    # The cycle that was open at the restart is whole and belongs to what comes after.
    assert trace.cycles.sync[0] == 599
    assert trace.cycles.flags.max() == 0
    assert np.flatnonzero(trace.instant)[0] == fill(arm)
    assert flight.faults["dropped"] == 0
    fresh = fed(arm, trace.cycles)
    assert flight.estimate().accepted == fresh.estimate().accepted
    np.testing.assert_array_equal(flight.estimate().value, fresh.estimate().value)


def test_restart_forgets_the_cycles_that_wait(arm: Arm) -> None:
    """They belong to the payload that is gone."""
    flight = Flight(arm)
    for frame in encode(arm, sines(arm, 5)):
        lib.zygos_arm_frame(flight.native, ffi.from_buffer("zygos_frame_t *", frame.tobytes()))
    assert lib.zygos_arm_restart(flight.native, lib.ZYGOS_KEEP_FAULTS) == 1
    assert lib.zygos_arm_step(flight.native) == 0


def test_restart_and_the_fault_counters(arm: Arm) -> None:
    frames = encode(arm, sines(arm, 100))
    frames = np.delete(frames, np.flatnonzero(frames["id"] == 0x181)[50])
    for keep, kept in ((lib.ZYGOS_KEEP_NOTHING, 0), (lib.ZYGOS_KEEP_FAULTS, 1)):
        flight = Flight(arm)
        flight.frames(frames)
        bad = sines(arm, 1)
        bad.flags[0] = INVALID
        flight.cycles(bad)
        before = (flight.faults["incomplete"], flight.counts["gaps"], flight.counts["invalid"])
        assert before == (1, 2, 1)
        assert lib.zygos_arm_restart(flight.native, keep) == 1
        after = (flight.faults["incomplete"], flight.counts["gaps"], flight.counts["invalid"])
        assert after == tuple(kept * count for count in before)


@pytest.mark.parametrize(("motors", "keep"), [(False, 2), (False, 3), (True, 4), (True, 6), (True, 2**31)])
def test_restart_refuses_bits_it_does_not_know(arm: Arm, motors: bool, keep: int) -> None:
    """Bit 1 keeps the sums of the motor rows, where there are any."""
    flight = fed(replace(arm, impulse_arc_s=10.0 * motors), sines(arm, 300))
    before = bytes_of(flight.native)
    assert lib.zygos_arm_restart(flight.native, keep) == lib.ZYGOS_E_KEEP
    assert bytes_of(flight.native) == before


@pytest.mark.parametrize("keep", [False, True])
def test_restart_keeps_what_the_motor_rows_know(keep: bool) -> None:
    """Of the arm before the restart if so asked; the rows of the energy are forgotten."""
    arm = replace(load_arm(EXAMPLE / "arm.toml"), arc_max_s=20.0, impulse_arc_s=5.0, momentum_max_s=10.0)
    scenario = replace(load_scenario(EXAMPLE / "scenario.toml"), duration_s=40.0)
    run = trajectory_of(arm, load_model(EXAMPLE / "model.toml"), scenario, seeds=[0], noise=True).cycles(0)
    flight = fed(arm, part(run, 0, 580))
    known = flight.blocks().motors
    assert len(known) >= 5
    flight.restart(keep_joints=keep)
    after = flight.blocks()
    assert (len(after.motors), after.energy, after.momentum) == (keep * len(known), [], [])  # its open arc is closed
    for blocks, before in zip(after.motors, known, strict=False):
        for (sums, instants), (known_sums, known_instants) in zip(blocks, before, strict=True):
            np.testing.assert_array_equal(sums, known_sums)
            assert instants == known_instants
    assert (flight.counts["accepted"], flight.estimate().validity) == (0, "refused")
    rest = part(run, 580, 800)
    flight.cycles(rest)
    sigma = flight.estimate().half95[arm.parameter_names.index("k1")]
    alone = fed(arm, rest).estimate().half95[arm.parameter_names.index("k1")]
    assert sigma < 0.7 * alone if keep else sigma == alone


def test_a_cycle_of_encoders_apart_behind_the_first_one_is_a_gap(arm: Arm) -> None:
    """One value in the window of the smoother is enough to lose it; no angle has passed the end of its range."""
    run = closing(arm, 2)
    run.q[1, 0] += 9.0 * np.pi
    run.theta[1, 0] -= 9.0 * np.pi
    flight = fed(arm, run)
    assert (flight.counts["wraps"], flight.counts["apart"], flight.counts["gaps"]) == (0, 1, 1)
