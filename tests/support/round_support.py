"""A round of a flight computer's telemetry: what it tells of one estimate, decoded and as the library has it."""

from __future__ import annotations

import math

import numpy as np
from cantools.database.can import Database
from e2e.p02 import e2e_p02_check

from zygos.can.wire import data_ids
from zygos.native.flight import VALIDITY, Flight


def told(dbc: Database, data: bytes) -> tuple[str, float, int]:
    """Name, value and counter of a telemetry frame whose CRC is good."""
    assert e2e_p02_check(data, data_ids(3, 32), length=8)
    values = dbc.get_message_by_name("TELEMETRY").decode(data, decode_choices=False)
    assert isinstance(values, dict)
    (name,) = set(values) - {"Crc", "Counter", "Status", "Item"}
    return name, float(values[name]), int(values["Counter"])


def round_of(flight: Flight) -> dict[str, float]:
    """Estimate, adopt, and return what the telemetry holds of it.

    In it are float32 numbers, counters modulo 2^24, and nothing where there is no value.
    """
    estimate = flight.estimate()
    flight.adopt()
    raw = flight._estimate
    out: dict[str, float] = {
        "verdict_validity": VALIDITY.index(estimate.validity),
        "verdict_reason": raw.reason,
        **{
            f"verdict_{name}": getattr(estimate, name)
            for name in ("cycle", "accepted", "refused", "arcs", "blocks", "rank", "condition", "cluster", "residual")
        },
        "verdict_noise_ratio": estimate.noise_ratio,
        "verdict_gate": estimate.signal_to_noise,
        "verdict_left_out": estimate.left_out[0],
        **{f"fault_{name}": n for name, n in flight.faults.items()},
        **{f"count_{name}": n for name, n in flight.counts.items()},
        "count_arcs": flight.native.accumulator.arcs,
        **{f"node_{name}": 0 for name in ("overflow", "misshapen", "down", "unsent", "corrupt", "unsaved")},
    }
    for name, value, sigma, half in zip(estimate.names, estimate.value, estimate.sigma, estimate.half95, strict=True):
        out |= {name: value, f"{name}_sigma": sigma, f"{name}_half95": half}
    return {name: float(np.float32(value)) for name, value in out.items() if math.isfinite(value)}
