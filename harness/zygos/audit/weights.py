# SPDX-License-Identifier: MIT
"""Torques beside what the masses of a simulation weigh, joint by joint.

The torque of a joint is fitted by the gravity of the simulation, its inertial torque, the acceleration of a rotor,
friction and an offset, each with a factor of its own. That of gravity is the scale of the torque against the masses;
friction has no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.audit import remedies
from zygos.audit.findings import Audit, SignalFault, signal_names
from zygos.balances.joint import gravity_forces
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.files.output import number
from zygos.ground.motion import Motion, cutoff_hz, torque_rows
from zygos.model.model import Model

Floats = NDArray[np.float64]
_BLOCKS = 8
"""Blocks of time, of which one after the other is left out for the standard deviation."""
_SLOW = 0.02
"""Rate at which Coulomb friction has three quarters of its size, rad/s."""


@dataclass(frozen=True)
class Weight:
    """The torque of a joint beside the gravity of a simulation."""

    joint: int
    factor: float
    """By which the measured torque of gravity is larger."""
    sigma: float
    gravity_nm: float
    """Root mean square of the gravity of the simulation less its mean, Nm."""

    @property
    def wrong(self) -> bool:
        """Whether the factor is far from 1, and surely so."""
        return (
            self.factor > 0.0
            and abs(math.log(self.factor)) > math.log(limits.SCALE_OFF.value)
            and abs(self.factor - 1.0) > limits.NAMED_Z.value * self.sigma
        )


def check_weighed(arm: Arm, simulation: Model) -> None:
    """Refuse, with ZygosError, an arm whose torques no masses weigh, and a simulation without masses."""
    if not arm.grounded or arm.torque_unit == "A" or not simulation.bodies:
        raise ZygosError(
            "--simulation: only masses weigh torques in Nm, of an arm on the ground with rigid joints; remedy: leave "
            "it out, or give the file of bodies (URDF, MJCF or a model.toml with [[body]])"
        )


def weights(run: Run, simulation: Model) -> list[Weight]:
    """Those of the joints at which gravity tells the scale. simulation: given by bodies.

    Errors: ZygosError as `check_weighed`, and for a run that is too short.
    """
    check_weighed(run.arm, simulation)
    motion = Motion.of(run)
    arm = motion.arm
    rows = torque_rows(arm, motion.samples, min(cutoff_hz(run.arm), limits.HIGHEST_CUTOFF_HZ.value))
    needed = rows.z @ simulation.base_values(arm)
    gravity = -gravity_forces(arm, rows.state, simulation.first_moments(arm)) @ np.array(arm.gravity)
    acceleration = rows.acceleration
    rubbing = rows.filtered(np.tanh(rows.state.qd / _SLOW))
    out = []
    for j in range(arm.n):
        columns = np.column_stack(
            [
                gravity[:, j],
                needed[:, j] - gravity[:, j],
                acceleration[:, j],
                rubbing[:, j],
                rows.state.qd[:, j],
                np.ones(len(needed)),
            ]
        )[rows.kept]
        told = float(np.std(columns[:, 0]))
        if not told > 0.0:
            continue
        factor, sigma = _first(columns, rows.tau[rows.kept, j])
        if sigma < limits.WEIGHED.value * abs(factor):
            out.append(Weight(j, factor, sigma, told))
    return out


def _first(columns: Floats, target: Floats) -> tuple[float, float]:
    """The first coefficient of a fit, and its standard deviation by leaving out one block of time after the other."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    used = size > 0.0
    scaled = columns[:, used] / size[used]

    def solve(of: Floats, to: Floats) -> float:
        return float(np.linalg.lstsq(of, to, rcond=1e-9)[0][0] / size[0])

    places = np.array_split(np.arange(len(target)), _BLOCKS)
    each = [solve(np.delete(scaled, place, axis=0), np.delete(target, place)) for place in places]
    spread = math.sqrt((_BLOCKS - 1) / _BLOCKS * float(np.sum(np.square(np.array(each) - np.mean(each)))))
    return solve(scaled, target), spread


def beside_masses(run: Run, found: Audit, weighed: Sequence[Weight]) -> Audit:
    """An audit in which masses say the scales of torques, in the place of the other joints' torques."""
    names = {i: name for name, kind, i in signal_names(run.arm) if kind == "tau"}
    faults = {names[one.joint]: _fault(run, names[one.joint], one) for one in weighed if one.wrong}
    others = [f for f in found.findings if not (f.signal in names.values() and f.fault.startswith("scaled"))]
    verdicts = {name: [f.fault for f in (*others, *faults.values()) if f.signal == name] for name in names.values()}
    signals = [
        replace(one, verdict="; ".join(verdicts[one.name]) or ("ok" if one.decided else "not decidable"))
        if one.name in verdicts
        else one
        for one in found.signals
    ]
    silent = [name for i, name in names.items() if i not in {one.joint for one in weighed}]
    notes = list(found.notes)
    if silent:
        notes.append(f"{', '.join(silent)}: gravity in this run does not tell their scale against the masses")
    return replace(found, signals=tuple(signals), findings=(*others, *faults.values()), notes=tuple(notes))


def _fault(run: Run, name: str, one: Weight) -> SignalFault:
    remedy = remedies.scaled(run.arm, "tau", one.joint, 1.0 / one.factor)
    factor, half95 = number(one.factor, 3), number(limits.INTERVAL_Z.value * one.sigma, 2)
    return SignalFault(
        name,
        f"torque scale or masses: {factor} times what the simulation weighs",
        f"gravity changes by {number(one.gravity_nm, 3)} Nm in the simulation, and by {factor} ± {half95} times as "
        "much in the torque; friction does not count",
        "if the torque is wrong, correct its unit, its torque constant or the firmware of the drive, or write "
        f"{remedy.text}; if it is right, the masses of the simulation are not, which `zygos explain` corrects",
        remedy.settings,
    )
