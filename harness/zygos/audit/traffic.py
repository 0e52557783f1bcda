# SPDX-License-Identifier: MIT
"""What only the frames of a run show: how much of each signal arrived, what saturated, and the clock of SYNC."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.audit.findings import Traffic, signal_names
from zygos.can.wire import identifiers
from zygos.native.flight import Flight, ffi, lib

_SYNC, _FTIME = 0x080, 0x3A0
_ACCEPTED = 1


def traffic_of(arm: Arm, frames: NDArray[Any]) -> Traffic:
    """What the C receiver makes of frames, `FRAME` records (n,), that its cycles do not say."""
    frames = np.ascontiguousarray(frames)
    verdicts = np.zeros(len(frames), dtype=np.uint8)
    lib.zygos_batch_frames(
        Flight(arm).native,
        ffi.cast("zygos_frame_t *", frames.ctypes.data),
        len(frames),
        ffi.cast("uint8_t *", verdicts.ctypes.data),
        ffi.NULL,
    )
    return _traffic(arm, frames, verdicts == _ACCEPTED)


def _traffic(arm: Arm, frames: NDArray[Any], accepted: NDArray[np.bool_]) -> Traffic:
    syncs = (frames["id"] == _SYNC) & accepted
    counters = frames["data"][syncs, 0].astype(np.int64)
    if len(counters) < 2:
        return Traffic(share={name: 0.0 for name, _, _ in signal_names(arm)})
    numbers = np.concatenate([[0], np.cumsum(np.diff(counters) % 240)])
    expected = int(numbers[-1])  # the last SYNC opens a cycle that nothing closes
    number_at = np.concatenate([[0], numbers])[np.cumsum(syncs)]
    share, saturated = {}, {}
    parts = {kind.part: identifier for identifier, kind in identifiers(arm).items()}
    coarse = arm.imu.resolution == "coarse"
    for name, kind, i in signal_names(arm):
        if kind == "omega":
            part, first, width = (
                ("rate", 2 + 2 * i, 2) if coarse else (("rate_xy", "rate_xy", "rate_z")[i], (2, 5, 2)[i], 3)
            )
        else:
            part, first, width = f"{'torque' if kind == 'tau' else 'angles'}{i}", 2, 3
        ours = frames["id"] == parts[part]
        share[name] = min(1.0, float(np.sum(ours & accepted)) / expected)
        if kind in ("tau", "omega"):
            data = frames["data"][ours & ~accepted, first : first + width].astype(np.int64)
            codes = (data << (8 * np.arange(width))).sum(axis=1)
            half = 1 << (8 * width - 1)
            saturated[name] = int(np.sum((codes == half) | (codes == half - 1)))
    times = (frames["id"] == _FTIME) & accepted
    micros = (frames["data"][times, 3:7].astype(np.int64) << (8 * np.arange(4))).sum(axis=1)
    period = float("nan")
    if len(micros) > 2:
        steps = (np.diff(micros) + 2**31) % 2**32 - 2**31
        cycles = np.diff(number_at[times])
        # the median keeps a clock that started anew out of it
        period = float(np.median(1e-6 * steps[cycles > 0] / cycles[cycles > 0])) if np.any(cycles > 0) else period
    return Traffic(share, saturated, period)
