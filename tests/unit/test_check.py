# SPDX-License-Identifier: MIT
"""zygos_arm_check() and zygos_arm_restart(): what memory errors have changed is found, and healed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_support import bytes_of, copy_of, part
from soak_support import again, stored, with_short_arcs
from state_support import config_of_its_own, lose_the_way, one_of_each, sums

from conftest import EXAMPLE
from zygos.arm import load_arm
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native import snapshot
from zygos.native.flight import Flight, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

WORK = ffi.new("zygos_work_t *")


@cache
def cycles() -> Cycles:
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    motion = stored(arm, model, load_scenario(EXAMPLE / "scenario.toml"))
    return part(again(arm, motion, 1, np.random.default_rng(0)), 0, 805)


@cache
def learned() -> Flight:
    """Rows of every kind, in arcs of which several are closed and one is open."""
    flight = Flight(replace(with_short_arcs(load_arm(EXAMPLE / "arm.toml")), memory_s=None))
    flight.cycles(cycles())
    return flight


@pytest.fixture
def flight() -> Flight:
    return copy_of(learned())


def check(flight: Flight) -> int:
    """The verdict, which leaves the memory as it is."""
    before = bytes_of(flight.native)
    verdict = int(lib.zygos_arm_check(flight.native, config_of_its_own(learned()), WORK))
    assert ffi.buffer(flight.native)[:] == before
    return verdict


def test_what_nobody_changed_passes(flight: Flight) -> None:
    assert check(flight) == 1
    assert check(Flight(flight.arm)) == 1
    assert flight.estimate().validity == "valid"


def test_misuse_is_refused(flight: Flight) -> None:
    own = ffi.addressof(flight.native, "sums", "config")
    for arguments in ((ffi.NULL, own, WORK), (flight.native, ffi.NULL, WORK), (flight.native, own, ffi.NULL)):
        assert lib.zygos_arm_check(*arguments) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_check(ffi.new("zygos_arm_t *"), own, WORK) == lib.ZYGOS_E_ORDER
    other = ffi.new("zygos_config_t *", own[0])
    other.period_s += 1e-3
    assert lib.zygos_arm_check(flight.native, other, WORK) == lib.ZYGOS_E_CONFIG
    assert not lib.zygos_sums_end_copy(ffi.NULL)
    own.joints = 1000
    assert lib.zygos_arm_check(flight.native, own, WORK) == lib.ZYGOS_E_STATE


def a_sum(flight: Flight) -> None:
    """Change what zygos_arm_check() finds in the sums."""
    for place in sums(flight.native, np.random.default_rng(0)):
        place.flip(flight.native, 52)
        if check(flight) == lib.ZYGOS_E_SUMS:
            return
        place.flip(flight.native, 52)
    raise AssertionError("no sum is under a check")


def magic(flight: Flight) -> None:
    flight.native.magic ^= 4


def gear_ratio(flight: Flight) -> None:
    flight.native.sums.config.joint[1].gear_ratio *= 2.0


CHANGES: dict[Any, int] = {
    magic: lib.ZYGOS_E_ORDER,
    gear_ratio: lib.ZYGOS_E_CONFIG,
    lose_the_way: lib.ZYGOS_E_STATE,
    a_sum: lib.ZYGOS_E_SUMS,
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_found(change: Any, flight: Flight) -> None:
    change(flight)
    assert check(flight) == CHANGES[change]


@pytest.mark.slow
def test_a_restart_heals_sums_and_tables(flight: Flight) -> None:
    """Whatever was changed but the configuration: behind it the rest of the run gives the bits of an arm that restarted
    without an upset."""
    healthy, rest = copy_of(learned()), part(cycles(), 0, 400)
    assert lib.zygos_arm_restart(healthy.native, lib.ZYGOS_KEEP_FAULTS) == 1
    healthy.cycles(rest)
    expected = healthy.estimate()
    rng = np.random.default_rng(0)
    places = [*sums(flight.native, rng), *one_of_each(flight.native, rng, without=("config", "magic"))[::8]]
    for place, other in zip(places, rng.permutation(np.array(places, dtype=object)), strict=True):
        ffi.memmove(flight.native, learned().native, ffi.sizeof("zygos_arm_t"))
        for one in (place, other):
            one.flip(flight.native, one.bits(rng, 2)[1])
        assert lib.zygos_arm_restart(flight.native, lib.ZYGOS_KEEP_FAULTS) == 1
        flight.cycles(rest)
        np.testing.assert_array_equal(flight.estimate().value, expected.value, err_msg=f"{place} and {other}")
    assert check(flight) == 1
    assert np.isfinite(expected.value).any()


def test_a_restart_refuses_a_configuration_that_cannot_be(flight: Flight) -> None:
    """What follows from it would lie anywhere. zygos_arm_init() with a good one heals that, too."""
    flight.native.sums.config.joints ^= 1 << 20
    before = bytes_of(flight.native)
    assert lib.zygos_arm_restart(flight.native, lib.ZYGOS_KEEP_FAULTS) == lib.ZYGOS_E_JOINTS
    assert bytes_of(flight.native) == before
    assert lib.zygos_arm_init(flight.native, config_of_its_own(learned())) == 1
    assert check(flight) == 1


@pytest.mark.slow
def test_a_state_that_was_sealed_corrupt_is_refused(flight: Flight, tmp_path: Path) -> None:
    path = tmp_path / "state.zyg"
    a_sum(flight)
    snapshot.write(path, "state", flight.native)
    other = Flight(flight.arm)
    with pytest.raises(ZygosError, match="before it was sealed; remedy: take an older one"):
        snapshot.resume(other, path)
    assert other.counts["cycles"] == 0
