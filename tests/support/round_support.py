# SPDX-License-Identifier: MIT
"""A round of a flight computer's telemetry: what it tells of one estimate, decoded and as the library has it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from cantools.database.can import Database
from e2e.p02 import e2e_p02_check

from zygos.can.wire import data_ids
from zygos.testing.twin import Answer


def told(dbc: Database, data: bytes) -> tuple[str, float, int]:
    """Name, value and counter of a telemetry frame whose CRC is good."""
    assert e2e_p02_check(data, data_ids(3, 32), length=8)
    values = dbc.get_message_by_name("TELEMETRY").decode(data, decode_choices=False)
    assert isinstance(values, dict)
    (name,) = set(values) - {"Crc", "Counter", "Status", "Item"}
    return name, float(values[name]), int(values["Counter"])


def round_of(answer: Answer, names: Sequence[str]) -> dict[str, float]:
    """What the telemetry holds of an answer of a twin, without the refinement; names: those of the parameters.

    In it are float32 numbers, counters modulo 2^24, and nothing where there is no value.
    """
    raw = answer.estimate
    plain = ("validity", "reason", "cycle", "accepted", "refused", "arcs", "blocks", "rank", "condition", "cluster")
    out: dict[str, float] = {
        **{f"verdict_{name}": getattr(raw, name) for name in (*plain, "residual", "noise_ratio")},
        "verdict_gate": raw.signal_to_noise,
        "verdict_left_out": raw.left_out[0],
        **{f"fault_{name}": n for name, n in answer.faults.items()},
        **{f"count_{name}": n for name, n in answer.counts.items()},
        **{f"node_{name}": 0 for name in ("overflow", "misshapen", "down", "unsent", "unsaved")},
        "node_corrupt": answer.corrupt,
    }
    for k, name in enumerate(names):
        out |= {name: raw.value[k], f"{name}_sigma": raw.sigma[k], f"{name}_half95": raw.half95[k]}
    return {name: float(np.float32(value)) for name, value in out.items() if math.isfinite(value)}
