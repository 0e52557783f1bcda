# SPDX-License-Identifier: MIT
"""Bits of estimates from fixed runs: a change of how the library stores its sums must change none of them.

`golden/readings.npz` has what sensors read, as whole steps, and `golden/configurations.json` what the library is told
of the arms: neither depends on the machine, nor on the rest of the harness. `golden/estimates.json` has what the
library makes of them. A motion is flown in several laps, so that blocks merge, and hardly an arc waits for the end of
the one before it, so that bits do not depend on when tasks are done. After a change that is to alter bits,
`python tests/unit/test_golden.py` writes it anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zygos.native.flight import ffi, lib

GOLDEN = Path(__file__).with_name("golden")
CONFIGURATIONS = json.loads((GOLDEN / "configurations.json").read_text())
WITH_GUARD = "excluded arcs, restart and solution in place"


def readings(motion: str) -> Any:
    """Cycles of a motion, as the library takes them."""
    with np.load(GOLDEN / "readings.npz") as stored:
        steps = np.cumsum(stored[motion], axis=0, dtype=np.int64)
        scales, breaks = stored[f"{motion}_scales"], stored[f"{motion}_breaks"]
    joints = (steps.shape[1] - 3) // 3
    names = [name for name in ("q", "theta", "tau") for _ in range(joints)] + ["omega"] * 3
    values = steps * scales[[("q", "theta", "tau", "omega").index(name) for name in names]]
    cycles = ffi.new("zygos_cycle_t[]", len(values))
    for k, row in enumerate(values.tolist()):
        for at, name in enumerate(("q", "theta", "tau")):
            getattr(cycles[k], name)[0:joints] = row[at * joints : (at + 1) * joints]
        cycles[k].omega = row[3 * joints :]
    for k in breaks.tolist():
        cycles[k].flags = lib.ZYGOS_CYCLE_BREAK
    return cycles


def configured(name: str) -> Any:
    """The library's configuration of that name."""
    config = ffi.new("zygos_config_t *", CONFIGURATIONS[name]["config"])
    config.abi = lib.zygos_abi()
    return config


def solved(state: Any) -> Any:
    """The estimate from a copy of the sums."""
    work, estimate = ffi.new("zygos_work_t *"), ffi.new("zygos_estimate_t *")
    lib.zygos_arm_take(state, work)
    lib.zygos_work_solve(work, estimate)
    return estimate


def flown(name: str) -> Iterator[Any]:
    """The estimates of a run: one at its end; of the run with excluded arcs one behind them, and one in place from the
    arm after a restart that kept the sums of the motor rows."""
    cycles, laps = readings(CONFIGURATIONS[name]["motion"]), CONFIGURATIONS[name]["laps"]
    state = ffi.new("zygos_arm_t *")
    assert lib.zygos_arm_init(state, configured(name)) == 1
    for lap in range(laps):
        if name == WITH_GUARD and lap == laps - 1:
            assert lib.zygos_arm_adopt(state, solved(state)) == 1
            stick(cycles)
        fly(state, cycles, lap * len(cycles))
    yield solved(state)
    if name == WITH_GUARD:
        assert sum(state.sums.guard.left_out) > 0
        cycles = readings(CONFIGURATIONS[name]["motion"])
        assert lib.zygos_arm_restart(state, lib.ZYGOS_KEEP_JOINTS) == 1
        fly(state, cycles, laps * len(cycles))
        solver, estimate = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
        lib.zygos_arm_solve(state, solver, estimate)
        yield estimate


def fly(state: Any, cycles: Any, behind: int) -> None:
    """Feed a motion whose first cycle has the number behind + 1."""
    for k, cycle in enumerate(cycles):
        cycle.sync = behind + k + 1
    lib.zygos_batch_cycles(state, cycles, len(cycles), ffi.NULL)


def stick(cycles: Any) -> None:
    """From the middle on, 100 cycles have the torque of the first joint before them."""
    middle = len(cycles) // 2
    for k in range(middle, middle + 100):
        cycles[k].tau[0] = cycles[middle - 1].tau[0]


def bits(estimate: Any) -> dict[str, Any]:
    """Values and standard deviations exactly, and the digest of the covariance."""
    p = estimate.parameters
    covariance = ffi.buffer(estimate.covariance)[: 4 * p * (p + 1)]
    return {
        "validity": estimate.validity,
        "reason": estimate.reason,
        "blocks": estimate.blocks,
        "accepted": estimate.accepted,
        "value": [x.hex() for x in list(estimate.value)[:p]],
        "sigma": [x.hex() for x in list(estimate.sigma)[:p]],
        "covariance": hashlib.sha256(covariance).hexdigest(),
    }


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_every_bit_is_what_it_was(name: str) -> None:
    expected = json.loads((GOLDEN / "estimates.json").read_text())[name]
    found = [bits(estimate) for estimate in flown(name)]
    assert found == expected
    assert all(one["validity"] > lib.ZYGOS_REFUSED for one in found)


if __name__ == "__main__":
    every = {name: [bits(estimate) for estimate in flown(name)] for name in CONFIGURATIONS}
    (GOLDEN / "estimates.json").write_text(json.dumps(every, indent=1) + "\n")
