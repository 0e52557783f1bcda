# SPDX-License-Identifier: MIT
"""The audit of a run of a KUKA KR300 R2500: how far apart in time the two encoders of an axis are read."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from zygos.audit.readings import noise_level
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles
from zygos.runs.tables import write_cycles

SOURCE = Path("../shared/data/kr300/run_a.mat")
"""The run, beside the checkout: it is no part of the project (docs/check-arm.md)."""
_PERIOD_S = 0.004
_AXES = (("a1", 256.8571, (0, 0, -1)), ("a2", 267.4286, (0, 1, 0)), ("a3", 252.3333, (0, 1, 0)))
"""Name, gear ratio and direction of the axes that have an encoder at the link."""
_UNDECIDED = 3


@dataclass(frozen=True)
class Skew:
    """The encoders of an axis."""

    axis: str
    skew_ms: float
    """Time by which the motor's encoder is read later than that of the link."""
    sigma_ms: float
    """Standard error of skew_ms."""
    reported: bool
    """Whether the audit names it as a fault."""


def write_kr300(source: Path, folder: Path) -> tuple[Path, Path]:
    """Write the run as a table of cycles, and its arm file, into a folder; their paths.

    Errors: ZygosError if the source cannot be read.
    """
    try:
        record = loadmat(source, squeeze_me=True, struct_as_record=False)["rec"]
    except (OSError, ValueError, KeyError, MatReadError) as error:
        raise ZygosError(f"{source}: not the run of the KR300 ({error}); remedy: get it anew") from None
    q, theta = np.deg2rad(record.act_pos_se_deg[:3].T), np.deg2rad(record.act_pos_mot_deg[:3].T)
    n = len(q)
    flags = np.zeros(n, dtype=np.uint32)
    cycles = Cycles(np.arange(n, dtype=np.uint64), q, theta, record.act_torque_abs_nm[:3].T, np.zeros((n, 3)), flags)
    lines = [
        'name = "kr300"',
        'base = "fixed"',
        "gravity = [0, 0, -9.81]",
        'kinetic = "spatial"',
        f"period_s = {_PERIOD_S}",
        'torque_law = "sampled"',
        'torque_at = "rotor"',
    ]
    for i, (name, ratio, axis) in enumerate(_AXES):
        # the steps of the encoders are not published: what changes from reading to reading at random stands for them
        link, motor = (float(np.sqrt(12) * noise_level(x[:, i], [(0, n)])) for x in (q, theta))
        lines += [
            "[[joint]]",
            f'name = "{name}"',
            f"node = {i + 1}",
            f"axis = {list(axis)}",
            f"gear_ratio = {ratio}",
            f"link_encoder = {{ quantum_rad = {link} }}",
            f'motor_encoder = {{ quantum_rad = {motor}, side = "output" }}',
        ]
    folder.mkdir(parents=True, exist_ok=True)
    arm, run = folder / "arm.toml", folder / "run.npz"
    arm.write_text("\n".join(lines) + "\n")
    write_cycles(run, cycles)
    return arm, run


def audit_kr300(source: Path, folder: Path) -> tuple[Skew, ...]:
    """What `zygos check-arm` says of the run. Errors: ZygosError if the command fails."""
    arm, run = write_kr300(source, folder)
    answer = folder / "audit.json"
    command = [sys.executable, "-m", "zygos.cli", "check-arm", str(arm), str(run), "--json", str(answer)]
    command += ["--report", str(folder / "audit.html")]
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode not in (0, _UNDECIDED):
        raise ZygosError(f"`zygos check-arm` failed: {ended.stderr.strip()}; remedy: see its message")
    content = json.loads(answer.read_text())
    faulty = {re.split(r"\s", one["signal"])[0] for one in content["findings"] if one["fault"].startswith("skewed")}
    return tuple(
        Skew(one["joint"], 1e3 * one["skew_s"], 1e3 * one["skew_sigma_s"], one["joint"] in faulty)
        for one in content["pairs"]
    )
