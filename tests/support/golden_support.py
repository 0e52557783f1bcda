# SPDX-License-Identifier: MIT
"""Fixed runs, and the bits of their estimates.

In `unit/golden/`, `readings.npz` has what sensors read, as whole steps, and `configurations.json` what the library is
told of the arms: neither depends on the machine, nor on the rest of the harness. `estimates.json` has what the library
makes of them. A motion is flown in several laps, so that blocks merge, and hardly an arc waits for the end of
the one before it, so that bits do not depend on when tasks are done. After a change that is to alter bits,
`python tests/support/golden_support.py` writes it anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from zygos.native.flight import ffi, lib

GOLDEN = Path(__file__).resolve().parents[1] / "unit" / "golden"
CONFIGURATIONS = json.loads((GOLDEN / "configurations.json").read_text())
EXPECTED = GOLDEN / "estimates.json"
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


def configured(name: str, library: Any) -> Any:
    """The library's configuration of that name."""
    config = ffi.new("zygos_config_t *", CONFIGURATIONS[name]["config"])
    config.abi = library.zygos_abi()
    return config


def solved(state: Any, library: Any) -> Any:
    """The estimate from a copy of the sums."""
    work, estimate = ffi.new("zygos_work_t *"), ffi.new("zygos_estimate_t *")
    library.zygos_arm_take(state, work)
    library.zygos_work_solve(work, estimate)
    return estimate


def flown(name: str, library: Any = lib) -> Iterator[Any]:
    """The estimates of a run by a build of the library: one at its end; of the run with excluded arcs one behind them,
    and one in place from the arm after a restart that kept the sums of the motor rows."""
    cycles, laps = readings(CONFIGURATIONS[name]["motion"]), CONFIGURATIONS[name]["laps"]
    state = ffi.new("zygos_arm_t *")
    assert library.zygos_arm_init(state, configured(name, library)) == 1
    for lap in range(laps):
        if name == WITH_GUARD and lap == laps - 1:
            assert library.zygos_arm_adopt(state, solved(state, library)) == 1
            stick(cycles)
        fly(library, state, cycles, lap * len(cycles))
    yield solved(state, library)
    if name == WITH_GUARD:
        assert sum(state.sums.guard.left_out) > 0
        cycles = readings(CONFIGURATIONS[name]["motion"])
        assert library.zygos_arm_restart(state, lib.ZYGOS_KEEP_JOINTS) == 1
        fly(library, state, cycles, laps * len(cycles))
        solver, estimate = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
        library.zygos_arm_solve(state, solver, estimate)
        yield estimate


def fly(library: Any, state: Any, cycles: Any, behind: int) -> None:
    """Feed a motion whose first cycle has the number behind + 1."""
    for k, cycle in enumerate(cycles):
        cycle.sync = behind + k + 1
    library.zygos_batch_cycles(state, cycles, len(cycles), ffi.NULL)


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


if __name__ == "__main__":
    every = {name: [bits(estimate) for estimate in flown(name)] for name in CONFIGURATIONS}
    EXPECTED.write_text(json.dumps(every, indent=1) + "\n")
