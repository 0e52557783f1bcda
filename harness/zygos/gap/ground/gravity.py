# SPDX-License-Identifier: MIT
"""Whether gravity acts along another direction than the arm file says, or where it says that there is none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.balances.joint import gravity_forces
from zygos.balances.quadrature import integral
from zygos.balances.state import State
from zygos.gap.ground.columns import Table
from zygos.gap.ground.fit import fit, forms, solve
from zygos.ground.estimate import DEFAULT_FRICTION
from zygos.ground.rows import RunRows
from zygos.model.model import Model

Floats = NDArray[np.float64]


def missing_gravity(table: Table, simulation: Model) -> Floats | None:
    """(3,) gravity that acts beyond that of the arm file, m/s^2; None where none does, or the simulation does not say
    where its masses are.

    It pulls at the first moments of the simulation, beside whatever values its parameters have.
    """
    layout = table.layout
    arm = layout.arm
    if not simulation.bodies:
        return None
    moments = simulation.first_moments(arm)
    usual = [layout.at(one.name) for one in layout.candidates if one.key in DEFAULT_FRICTION]
    fitted = fit(table, [*layout.basis, *usual])
    free = np.array(fitted.free)
    grams = []
    for number, rows in enumerate(table.rows):
        columns = _columns(table, rows, number, moments)[..., [*free, *range(-4, 0)]]
        columns = columns / fitted.sigma[:, None] * ~rows.lingers[..., None]
        for part in np.array_split(columns[rows.rows.accepted], limits.GRAVITY_BLOCKS.value):
            grams.append(np.einsum("mjp,mjq->jpq", part, part, optimize=True))
    joints, prior = np.sum(grams, axis=0), np.append(layout.prior()[free], np.zeros(3))
    each = np.sum(grams, axis=1)
    total = each.sum(axis=0)
    pulls = np.flatnonzero(np.diag(total)[-4:-1] > 0.0)

    def value(gram: Floats) -> Floats:
        return solve(gram[:-1, :-1], prior, gram[:-1, -1:])[:, 0]

    with_it, without = value(total), solve(total[:-4, :-4], prior[:-3], total[:-4, -1:])[:, 0]
    left = [forms(joints, x) for x in (np.append(without, np.zeros(3)), with_it)]
    found = with_it[-3:]
    spread = np.array([value(total - own)[-3:] for own in each]) - found
    sigma = np.sqrt((len(each) - 1) / len(each) * np.sum(spread**2, axis=0))
    size = float(np.linalg.norm(found[pulls]))
    sure = size > limits.NAMED_Z.value * float(np.linalg.norm(sigma[pulls]))
    return (
        found
        if size > limits.GRAVITY_OFF.value
        and sure
        and np.any(left[1] < (1.0 - limits.GRAVITY_EXPLAINS.value) * left[0])
        else None
    )


def _columns(table: Table, rows: RunRows, number: int, moments: Floats) -> Floats:
    """(m, N, W+3) columns of a run's increments in the order of the layout, gravity along each axis before what the
    simulation leaves of the impulse."""
    layout, motion = table.layout, rows.motion
    arm, count = layout.arm, len(rows.w)
    offsets = np.zeros((count, arm.n, layout.runs, arm.n))
    for j in range(arm.n):
        offsets[:, j, number, j] = rows.offset[j]
    force = gravity_forces(arm, State.smoothed(arm, motion.smoothed), moments)
    pulled = np.zeros((count, arm.n, 3))
    for k, (begin, end) in enumerate(zip(rows.rows.begin, rows.rows.end, strict=True)):
        pulled[k] = -integral(force[begin : end + 1], arm.period_s, axis=0)[-1]
    left = rows.w - rows.z @ layout.start
    return np.concatenate([rows.z, offsets.reshape(count, arm.n, -1), pulled, left[..., None]], axis=-1)
