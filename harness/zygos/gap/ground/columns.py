# SPDX-License-Identifier: MIT
"""The sums of several runs over all columns that are tried, with what the simulation says of them taken away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.effects import Effect
from zygos.gap.ground.candidates import GAIN, Candidate
from zygos.ground.motion import Motion, torque_noise
from zygos.ground.rows import RunRows, run_rows
from zygos.ground.sums import MOST_BLOCKS, sums_of
from zygos.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """The columns: s shared ones (p of the arm, those of the simulation's effects, of candidates), then an
    offset of each torque in each run, then what the simulation leaves of the impulse. W in all."""

    arm: Arm
    own: tuple[Effect, ...]
    """Effects of the simulation that rows of joints have."""
    candidates: tuple[Candidate, ...]
    runs: int
    start: Floats
    """(s,) what the simulation has for each shared column."""
    names: tuple[str, ...]
    """(s,)"""
    units: tuple[str, ...]
    """(s,)"""
    known: tuple[tuple[str, float], ...] = ()
    """Columns that are known to be 0 to within a deviation."""

    @classmethod
    def of(cls, arm: Arm, simulation: Model, candidates: Sequence[Candidate], runs: int) -> Layout:
        """The columns for a simulation and what may be tried beside."""
        own = tuple(e for e in simulation.effects if e.kind.place in ("motor", "link", "load", "torque"))
        own = tuple(e for e in own if e.kind.key not in ("torque_gain", "torque_offset"))
        extra = [one.effect for one in candidates if one.effect is not None]
        start = np.concatenate([simulation.base_values(arm), [e.value for e in own], np.zeros(len(extra))])
        names = (*arm.parameter_names, *(e.column(arm) for e in own))
        units = (*arm.parameter_units, *(e.kind.unit for e in (*own, *extra)))
        names = (*names, *(one.name for one in candidates if one.effect is not None))
        return cls(arm, own, tuple(candidates), runs, start, names, units)

    @property
    def shared(self) -> int:
        """s."""
        return len(self.names)

    @property
    def width(self) -> int:
        """W."""
        return self.shared + self.runs * self.arm.n + 1

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those of all columns after the arm's."""
        return (*self.own, *(one.effect for one in self.candidates if one.effect is not None))

    def at(self, name: str) -> int:
        """Place of a shared column."""
        return self.names.index(name)

    @property
    def gains(self) -> tuple[tuple[int, int], ...]:
        """Joint and column of each gain of a torque sensor."""
        return tuple((one.joint, self.at(one.name)) for one in self.candidates if one.key == GAIN)

    @property
    def held(self) -> tuple[int, ...]:
        """Columns that are 0 until a candidate is adopted."""
        return tuple(self.at(one.name) for one in self.candidates)

    @property
    def basis(self) -> tuple[int, ...]:
        """Columns of the simulation's own equations, and of offsets."""
        held = set(self.held)
        return tuple(k for k in range(self.width - 1) if k not in held)

    def prior(self) -> Floats:
        """(W-1,) weight (inverse variance) with which a column is held to the simulation's value.

        A parameter of bodies is held by the largest value in the same unit: a motion that does not show it leaves it
        where the simulation has it.
        """
        out = np.zeros(self.width - 1)
        arm = self.arm
        for unit in set(arm.parameter_units):
            of = [k for k, one in enumerate(arm.parameter_units) if one == unit]
            body = [k for k in of if arm.parameters[k].joint is None]
            size = float(np.max(np.abs(self.start[body]), initial=0.0))
            if size > 0.0:
                out[body] = 1.0 / size**2
        for name, sigma in self.known:
            out[self.at(name)] = 1.0 / sigma**2
        return out


@dataclass(frozen=True)
class Table:
    """Sums of products of the columns over B blocks of time of all runs."""

    layout: Layout
    rows: tuple[RunRows, ...]
    gram: Floats
    """(B, N, W, W) with the expected products of the sensors' noise subtracted."""
    noise: Floats
    """(B, N, W, W) what was subtracted."""
    counts: Floats
    """(B, N) rows."""
    owner: NDArray[np.int64]
    """(B,) run of each block."""
    place: Floats
    """(B, 2) begin and end of each block in its run, s."""
    floor: Floats
    """(R, N) standard deviation of an increment's impulse that the noise of torques and angles causes, Nms."""

    @property
    def blocks(self) -> int:
        """B."""
        return len(self.gram)

    def with_gains(self, x: Floats) -> Table:
        """The sums with the torque that the values x (W-1,) predict in the columns of the sensors' gains.

        With the measured torque in it, a gain would take away whatever the model lacks.
        """
        gains = self.layout.gains
        if not gains:
            return self
        gram, noise = self.gram.copy(), self.noise.copy()
        full = np.zeros(self.layout.width)
        shared = self.layout.shared
        full[:shared] = -(self.layout.start + x[:shared])
        full[[place for _, place in gains]] = 0.0
        for sums in (gram, noise):
            for joint, place in gains:
                own = sums[:, joint]
                cross = own @ full
                cross[:, place] = cross @ full
                own[:, place, :] = cross
                own[:, :, place] = cross
        return replace(self, gram=gram, noise=noise)

    @property
    def span_s(self) -> float:
        """Length of the increments, s."""
        return self.rows[0].span_s


def table_of(layout: Layout, motions: Sequence[Motion], span_s: float, predicted: Sequence[Floats | None]) -> Table:
    """The sums of runs. predicted: torque after the gear at the smoothed instants of each (m, N), for friction in
    proportion to the load."""
    arm, joints = layout.arm, layout.arm.n
    runs = [run_rows(motion, span_s, layout.effects, load) for motion, load in zip(motions, predicted, strict=True)]
    runs = [replace(rows, gains=()) for rows in runs]
    turn = np.eye(layout.shared + 2)
    turn[: layout.shared, -1] = -layout.start
    grams, noises, counts, owners, places, floors = [], [], [], [], [], []
    most = max(limits.LEAST_BLOCKS.value, min(MOST_BLOCKS, limits.TOTAL_BLOCKS.value // len(runs)))
    for number, rows in enumerate(runs):
        sums = sums_of(rows, most)
        own, own_noise = turn.T @ sums.gram @ turn, turn.T @ sums.noise @ turn
        gram = np.zeros((sums.blocks, joints, layout.width, layout.width))
        noise = np.zeros_like(gram)
        for j in range(joints):
            at = np.array([*range(layout.shared), layout.shared + number * joints + j, layout.width - 1])
            gram[:, j, at[:, None], at] = own[:, j]
            noise[:, j, at[:, None], at] = own_noise[:, j]
        grams.append(gram)
        noises.append(noise)
        counts.append(sums.count)
        owners.append(np.full(sums.blocks, number))
        places.append(_places(rows, sums.blocks))
        reading = torque_noise(rows.motion) * arm.gear_ratios
        by_angles = noise[..., -1, -1].sum(axis=0) / np.maximum(sums.count.sum(axis=0), 1)
        floors.append(np.sqrt(reading**2 * arm.period_s * rows.span_s + np.maximum(by_angles, 0.0)))
    return Table(
        layout,
        tuple(runs),
        np.concatenate(grams),
        np.concatenate(noises),
        np.concatenate(counts).astype(np.float64),
        np.concatenate(owners),
        np.concatenate(places),
        np.array(floors),
    )


def _places(rows: RunRows, blocks: int) -> Floats:
    """(blocks, 2) begin and end of the blocks that `sums_of` makes, s."""
    used = np.flatnonzero((rows.rows.accepted[:, None] & ~rows.lingers).any(axis=1))
    index, h = rows.motion.smoothed.index, rows.motion.arm.period_s
    parts = np.array_split(used, blocks)
    return np.array(
        [[index[rows.rows.begin[part[0]]] * h, index[rows.rows.end[part[-1]]] * h] for part in parts], dtype=np.float64
    )
