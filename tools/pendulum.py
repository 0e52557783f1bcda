# SPDX-License-Identifier: MIT
"""Writes the logs of examples/pendulum: the replies of its drives as they were on the bus, from the published tables.

Usage: pendulum.py FOLDER_OF_TRAJECTORIES OUTPUT_FOLDER. The tables are trajectory_*.csv.gz of
../shared/data/dfki-double-pendulum. Their angles, rates and torques lie on the steps of the drives' frames to 1e-9 of a
step, so that the frames can be restored exactly. A row has one time stamp, which both replies get here.
"""

import gzip
import sys
from pathlib import Path

import can
import numpy as np

DRIVES = (8, 9)
"""Numbers of the drives of joints 1 and 2 on the bus."""
RANGES = {"pos": (12.5, 16), "vel": (22.5, 12), "tau": (12.0, 12)}
"""Largest value, and bits, of the fields of a reply; the smallest value is the negative one."""
SIGN = -1
"""Of a drive's counts in those of the tables."""


def counts(values: np.ndarray, largest: float, bits: int) -> np.ndarray:
    """Counts of a field. Raises ValueError for values that do not lie on its steps."""
    steps = (SIGN * values + largest) / (2.0 * largest) * (2**bits - 1)
    whole = np.round(steps)
    if np.max(np.abs(steps - whole)) > 1e-6 or whole.min() < 0 or whole.max() > 2**bits - 1:
        raise ValueError("the values do not lie on the steps of the frames")
    return whole.astype(int)


def write(table: Path, log: Path) -> int:
    """Write the log of a table; the number of its frames."""
    with gzip.open(table, "rt") as stream:
        names = stream.readline().strip().split(",")
        rows = np.loadtxt(stream, delimiter=",")
    column = {name: rows[:, k] for k, name in enumerate(names)}
    fields = [{kind: counts(column[f"{kind}_meas{i}"], *RANGES[kind]) for kind in RANGES} for i in (1, 2)]
    with can.Logger(str(log)) as logger:
        for k, time in enumerate(column["time"]):
            for drive, field in zip(DRIVES, fields, strict=True):
                code = (int(field["pos"][k]) << 24) | (int(field["vel"][k]) << 12) | int(field["tau"][k])
                data = bytes([drive]) + code.to_bytes(5, "big")
                logger.on_message_received(
                    can.Message(timestamp=float(time), arbitration_id=0, is_extended_id=False, data=data, channel=0)
                )
    return 2 * len(rows)


if __name__ == "__main__":
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    for trajectory in sorted(source.glob("trajectory_*.csv.gz")):
        log = target / f"{trajectory.name.removesuffix('.csv.gz').removeprefix('trajectory_')}.blf"
        print(f"{log}: {write(trajectory, log):,} frames, {log.stat().st_size:,} bytes")
