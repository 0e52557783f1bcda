"""zygos_check() and zygos_restart(): what memory errors have changed is found, and healed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs_support import trajectory_of

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native import snapshot
from zygos.native.flight import Flight, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

WORK = ffi.new("zygos_work_t *")


@cache
def run() -> tuple[Arm, Cycles]:
    """Rows of every kind, in arcs of which several are closed and one is open."""
    arm = replace(load_arm(EXAMPLE / "arm.toml"), arc_max_s=20.0, momentum_max_s=10.0)
    scenario = replace(load_scenario(EXAMPLE / "scenario.toml"), duration_s=40.0)
    return arm, trajectory_of(arm, load_model(EXAMPLE / "model.toml"), scenario, seeds=[0], noise=True).cycles(0)


@cache
def learned() -> bytes:
    arm, cycles = run()
    flight = Flight(arm)
    flight.cycles(cycles)
    assert flight.native.accumulator.filled > 0  # a step waits to be shared out
    return bytes(ffi.buffer(flight.native))


@pytest.fixture
def flight() -> Flight:
    out = Flight(run()[0])
    ffi.memmove(out.native, learned(), len(learned()))
    return out


def check(flight: Flight) -> int:
    """The verdict, which leaves the memory as it is."""
    before = bytes(ffi.buffer(flight.native))
    verdict = int(lib.zygos_check(flight.native, config(), WORK))
    assert bytes(ffi.buffer(flight.native)) == before
    return verdict


@cache
def config() -> Any:
    flight = Flight(run()[0])  # it owns the memory that is copied
    return ffi.new("zygos_config_t *", flight.native.config)


def test_what_nobody_changed_passes(flight: Flight) -> None:
    assert check(flight) == 1
    assert check(Flight(flight.arm)) == 1
    assert flight.estimate().validity == "valid"


def test_misuse_is_refused(flight: Flight) -> None:
    own = ffi.addressof(flight.native, "config")
    for arguments in ((ffi.NULL, own, WORK), (flight.native, ffi.NULL, WORK), (flight.native, own, ffi.NULL)):
        assert lib.zygos_check(*arguments) == lib.ZYGOS_E_NULL
    assert lib.zygos_check(ffi.new("zygos_t *"), own, WORK) == lib.ZYGOS_E_ORDER
    other = ffi.new("zygos_config_t *", own[0])
    other.period_s += 1e-3
    assert lib.zygos_check(flight.native, other, WORK) == lib.ZYGOS_E_CONFIG
    assert not lib.zygos_work_intact(ffi.NULL)
    own.joints = 1000
    assert lib.zygos_check(flight.native, own, WORK) == lib.ZYGOS_E_STATE


def changed(path: str, change: Callable[[Any], Any]) -> Callable[[Any], None]:
    """Gives one member of zygos_t another value."""
    *parents, last = path.split(".")

    def apply(native: Any) -> None:
        for name in parents:
            key = name.partition("[")
            native = getattr(native, key[0])
            native = native[int(key[2][:-1])] if key[2] else native
        key = last.partition("[")
        if key[2]:
            array = getattr(native, key[0])
            array[int(key[2][:-1])] = change(array[int(key[2][:-1])])
        else:
            setattr(native, last, change(getattr(native, last)))

    return apply


def _fills(native: Any) -> None:
    native.accumulator.buffer[native.accumulator.filling].gram[0] += 1.0


def _open_momentum_rows(native: Any) -> None:
    native.momentum_sums.arc.rows.gram[0] *= 2.0


CHANGES: dict[str, tuple[Callable[[Any], None], int]] = {
    "magic": (changed("magic", lambda x: x ^ 4), lib.ZYGOS_E_ORDER),
    "gear ratio": (changed("config.joint[1].gear_ratio", lambda x: 2 * x), lib.ZYGOS_E_CONFIG),
    "joints": (changed("config.joints", lambda x: x ^ 1 << 20), lib.ZYGOS_E_CONFIG),
    "place in the queue": (changed("receiver.queue.head", lambda x: x ^ 1 << 20), lib.ZYGOS_E_STATE),
    "blocks": (changed("accumulator.count", lambda x: x ^ 1 << 10), lib.ZYGOS_E_STATE),
    "columns of motor rows": (changed("motor_sums.column_map.count[0]", lambda x: x + 1), lib.ZYGOS_E_STATE),
    "columns of momentum rows": (changed("momentum_sums.columns", lambda x: x + 1), lib.ZYGOS_E_STATE),
    "closed block": (changed("accumulator.block[0].gram[0]", lambda x: 2 * x), lib.ZYGOS_E_SUMS),
    "buffer that fills": (_fills, lib.ZYGOS_E_SUMS),
    "noise": (changed("accumulator.noise_closed.gram[0]", lambda x: x + 1.0), lib.ZYGOS_E_SUMS),
    "instants of the arc": (changed("accumulator.arc_instants", lambda x: x ^ 8), lib.ZYGOS_E_SUMS),
    "motor rows": (changed("motor_sums.block[0].joint[1].sum[0]", lambda x: 2 * x), lib.ZYGOS_E_SUMS),
    "momentum rows": (_open_momentum_rows, lib.ZYGOS_E_SUMS),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_is_found(what: str, flight: Flight) -> None:
    change, verdict = CHANGES[what]
    change(flight.native)
    assert check(flight) == verdict


def test_it_finds_what_the_solver_finds(flight: Flight) -> None:
    """At any bit of the sums, and at no other."""
    rng = np.random.default_rng(0)
    entries = (len(flight.names) + 2) * (len(flight.names) + 3) // 2
    first = ffi.offsetof("zygos_t", "accumulator", "block", 0, "gram")
    found = 0
    for place in first + rng.integers(0, 8 * entries, 100):
        ffi.memmove(flight.native, learned(), len(learned()))
        memory = ffi.cast("uint8_t *", flight.native)
        memory[int(place)] ^= 1 << int(rng.integers(8))
        corrupt = flight.estimate().reason.startswith("the accumulated sums are corrupt")
        assert (check(flight) < 1) == corrupt
        found += corrupt
    assert found > 0


@pytest.mark.parametrize(
    "what", [name for name, (_, code) in CHANGES.items() if code == lib.ZYGOS_E_SUMS or "rows" in name]
)
def test_a_restart_heals_sums_and_tables(what: str, flight: Flight) -> None:
    """Behind it the rest of the run gives the bits of an arm that restarted without an upset."""
    arm, cycles = run()
    healthy = Flight(arm)
    ffi.memmove(healthy.native, learned(), len(learned()))
    CHANGES[what][0](flight.native)
    for one in (healthy, flight):
        assert lib.zygos_restart(one.native, lib.ZYGOS_KEEP_FAULTS) == 1
        one.cycles(cycles)
    assert check(flight) == 1
    np.testing.assert_array_equal(flight.estimate().value, healthy.estimate().value)
    assert np.isfinite(flight.estimate().value).any()


def test_a_restart_refuses_a_configuration_that_cannot_be(flight: Flight) -> None:
    """What follows from it would lie anywhere. zygos_init() with a good one heals that, too."""
    flight.native.config.joints ^= 1 << 20
    before = bytes(ffi.buffer(flight.native))
    assert lib.zygos_restart(flight.native, lib.ZYGOS_KEEP_FAULTS) == lib.ZYGOS_E_JOINTS
    assert bytes(ffi.buffer(flight.native)) == before
    assert lib.zygos_init(flight.native, config()) == 1
    assert check(flight) == 1


def test_a_state_that_was_sealed_corrupt_is_refused(flight: Flight, tmp_path: Path) -> None:
    path = tmp_path / "state.zyg"
    CHANGES["closed block"][0](flight.native)
    snapshot.write(path, "state", flight.native)
    other = Flight(flight.arm)
    with pytest.raises(ZygosError, match="before it was sealed; remedy: take an older one"):
        snapshot.resume(other, path)
    assert other.counts["cycles"] == 0
