# SPDX-License-Identifier: MIT
"""When something changed on an arm on the ground: friction, the offset of a torque, or the bodies by a payload.

A change multiplies columns by a step from a block of time on, so that every candidate and every instant between two
blocks is one small solve.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.gap.changes import BODIES, Change
from zygos.gap.ground.columns import Layout, Table
from zygos.gap.ground.fit import Fit, solve
from zygos.quantiles import normal_isf, student_sf
from zygos.structure import STANDARD, independent

Floats = NDArray[np.float64]
Group = tuple[str, tuple[str, ...], Floats]
"""What changes, the names of the coefficients, and (W-1, r) their directions."""


def find_change(table: Table, fitted: Fit) -> tuple[Change, Fit] | None:
    """The change that explains most of what a fit leaves over, and the fit of what was recorded after it; None where
    none explains most of it."""
    table = table.with_gains(fitted.x)
    of = np.array(fitted.free)
    prior = table.layout.prior()[of]
    weighted = np.einsum("j,bjpq->bpq", 1.0 / fitted.sigma**2, table.gram)
    order = np.lexsort((table.place[:, 0], table.owner))
    weighted, owner, place = weighted[order], table.owner[order], table.place[order]
    total = weighted.sum(axis=0)
    after = np.cumsum(weighted[::-1], axis=0)[::-1]
    tried = [
        (*_improvement(total, after[cut], of, prior, group[2]), cut, group)
        for cut in range(limits.CHANGE_BLOCKS.value, len(weighted) - limits.CHANGE_BLOCKS.value + 1)
        for group in _groups(table.layout, fitted)
    ]
    if not tried:
        return None
    best = max(gain for gain, *_ in tried)
    fewest = min(len(group[1]) for gain, _, _, group in tried if gain >= limits.STANDS_IN.value * best)
    gain, delta, cut, group = max(
        (one for one in tried if one[0] >= limits.STANDS_IN.value * best and len(one[3][1]) == fewest),
        key=lambda one: one[0],
    )
    share = _share(table, fitted, gain)
    values, z = _certain(weighted, cut, of, prior, group[2], delta)
    if share < limits.CHANGE_TAKES.value or z < limits.CHANGE_Z.value:
        return None
    between = bool(owner[cut] != owner[cut - 1])
    blocks = int(np.count_nonzero(owner[:cut] == owner[cut]))
    stepped = after[cut][:, :-1] @ group[2]
    x = np.zeros_like(fitted.x)
    x[of] = solve(total[np.ix_(of, of)], prior, (total[of, -1] - stepped[of] @ delta)[:, None])[:, 0]
    start = np.append(table.layout.start, np.zeros(len(x) - table.layout.shared))
    old = group[2].T @ (x + start) if group[0] != BODIES else np.zeros(len(delta))
    change = Change(
        what=group[0],
        run=int(owner[cut]),
        arc=0 if between else blocks,
        # it may lie within either of the blocks that meet at the best cut
        after_s=0.0 if between else float(place[cut, 1]),
        before_s=0.0 if between else float(place[cut - 1, 0]),
        names=group[1],
        old=old,
        new=old + delta,
        sigma=values,
        z=z,
        share=share,
    )
    return change, replace(fitted, x=x + group[2] @ delta)


def _groups(layout: Layout, fitted: Fit) -> Iterator[Group]:
    """Everything that may change."""
    width, joints = layout.width - 1, layout.arm.n
    own = len(layout.arm.parameter_names)
    for k in range(own, layout.shared):
        if layout.names[k].startswith(("torque_lag", "torque_gain")):
            continue
        yield layout.names[k], (layout.names[k],), np.eye(width)[:, [k]]
    for j in range(joints):
        direction = np.zeros((width, 1))
        direction[[layout.shared + run * joints + j for run in range(layout.runs)]] = 1.0
        name = f"torque_offset{j + 1}"
        yield name, (name,), direction
    names, base = _bodies(layout)
    yield BODIES, names, np.vstack([base, np.zeros((width - own, base.shape[1]))])


def _bodies(layout: Layout) -> tuple[tuple[str, ...], Floats]:
    """Parameters of the last body and what they do to the arm's (p, r); without lengths, all parameters of bodies."""
    arm = layout.arm
    structure = arm.structure
    if structure.candidates_are_full:
        own = [k for k, one in enumerate(arm.parameters) if one.joint is None]
        return tuple(arm.parameters[k].name for k in own), np.eye(len(arm.parameters))[:, own]
    last = [k for k, one in enumerate(structure.candidates) if one.symbol in STANDARD and one.ends == (str(arm.n),)]
    kept = independent(structure.groups, last)
    return tuple(structure.candidates[k].name for k in kept), structure.groups[:, kept]


def _improvement(
    total: Floats, after: Floats, of: NDArray[np.int64], prior: Floats, directions: Floats
) -> tuple[float, Floats]:
    """Reduction of the weighted squared residual by a step in some directions, and the size of the step."""
    stepped = after[:, :-1] @ directions
    slope = solve(total[np.ix_(of, of)], prior, np.column_stack([stepped[of], total[of, -1]]))
    square = directions.T @ stepped[:-1] - stepped[of].T @ slope[:, :-1]
    right = directions.T @ after[:-1, -1] - stepped[of].T @ slope[:, -1]
    scale = np.sqrt(np.maximum(np.diag(directions.T @ stepped[:-1]), 1e-300))
    scaled = square / scale / scale[:, None]
    delta = np.linalg.pinv(scaled, hermitian=True, rcond=limits.RCOND_OF_BLOCKS.value) @ (right / scale) / scale
    return float(right @ delta), np.asarray(delta, dtype=np.float64)


def _certain(
    weighted: Floats, cut: int, of: NDArray[np.int64], prior: Floats, directions: Floats, delta: Floats
) -> tuple[Floats, float]:
    """Standard deviations of a step from leaving out blocks, and in how many of them it differs from none."""
    total, after = weighted.sum(axis=0), weighted[cut:].sum(axis=0)
    blocks, shifts = len(weighted), []
    for k, own in enumerate(weighted):
        rest = after - own if k >= cut else after
        shifts.append(_improvement(total - own, rest, of, prior, directions)[1] - delta)
    covariance = (blocks - 1) / blocks * np.array(shifts).T @ np.array(shifts)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    freedom = max(2.0, min(cut, blocks - cut) - 1.0)
    # of several coefficients the surest one speaks for all of them
    t = float(np.max(np.abs(delta) / sigma))
    return sigma, float(normal_isf(max(float(student_sf(t, freedom)) * len(delta), 1e-300)))


def _share(table: Table, fitted: Fit, gain: float) -> float:
    """Share of the squared residual beyond noise that an improvement takes away; 0 where noise is all that is left."""
    rows = np.array([table.counts[table.owner == run].sum(axis=0) for run in range(table.layout.runs)])
    noise = (limits.NOISE.value * rows * table.floor**2).sum(axis=0)
    left = table.counts.sum(axis=0) * fitted.sigma**2
    rest = float((np.maximum(left - noise, 0.0) / fitted.sigma**2).sum())
    return gain / rest if rest > 0.0 else 0.0
