# SPDX-License-Identifier: MIT
"""The linear motion of blocks against differences, and its solution against dense least squares."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from refine_support import Case, plant, runs

from zygos.native.propagation import Propagation
from zygos.refinement.blocks import Blocks, Linear, blocks_of, linearise, torque_steps
from zygos.refinement.follow import Prior, Start, follow
from zygos.refinement.record import record_of

CHANGE = 1e-4
"""Of states and of parameters, as a share of their sizes."""
OF_STATES, OF_PARAMETERS = 0.005, 0.06
"""Errors of derivatives that are taken once in 10 ms. They cost the square of it of the information, 0.4 %."""


@cache
def blocks(example: str, duration_s: float) -> Blocks:
    case = Case(example, duration_s=duration_s)
    return blocks_of(record_of(case.arm, [runs(case, [0])[0]]))


def moved(cut: Blocks, example: str, values: np.ndarray | float = 0.0, states: np.ndarray | float = 0.0) -> Linear:  # type: ignore[type-arg]
    arm = cut.record.arm
    steps = 5 if example == "paper" else 1
    own = np.asarray(plant(example).base_values(arm)) + values
    return linearise(cut, Propagation(arm, steps, friction=True), own, np.zeros(5 * arm.n), cut.states + states)


@pytest.mark.slow(only=["spatial*"])
@pytest.mark.parametrize(("example", "duration_s"), [("paper", 10.0), ("spatial", 0.6)])
def test_derivatives_are_those_of_the_motion(example: str, duration_s: float) -> None:
    cut = blocks(example, duration_s)
    at = moved(cut, example)
    rng = np.random.default_rng(0)
    p = len(at.size)
    inside = slice(0, len(cut.first) - 1)  # after the record there are no readings
    for k in range(2):
        value = CHANGE * at.size * rng.normal(size=p) if k else np.zeros(p)
        state = np.zeros_like(at.states) if k else CHANGE * rng.normal(size=at.states.shape)
        other = moved(cut, example, value, state)
        error, gap = at.error - other.error, other.gap - at.gap + np.concatenate([state[1:], state[-1:]])
        for change, slopes, degrees in ((error, at.reading, cut.kept.shape[2]), (gap, at.end, 1)):
            expected = np.einsum("bkx,bx->bk", slopes.of_state, state) + slopes.of_constant[..., :p] @ value
            # all polynomials of a sensor together: those of a high degree have little to tell
            whole, off = (
                np.sqrt(np.mean(part[inside].reshape(len(part) - 1, -1, degrees) ** 2, axis=(0, 2)))
                for part in (change, change - expected)
            )
            assert np.all(off <= (OF_PARAMETERS if k else OF_STATES) * whole + 1e-14)


def test_a_solution_is_that_of_dense_least_squares() -> None:
    """Of 12 blocks of an arm in a plane, with all torque errors as unknowns."""
    cut = blocks("paper", 10.0)
    few = replace(
        cut, first=cut.first[:12], read=cut.read[:12], value=cut.value[:12], tau=cut.tau[:12], around=cut.around[:12],
        lost=cut.lost[:12], kept=cut.kept[:12], states=cut.states[:12],
    )  # fmt: skip
    at, arm = moved(few, "paper"), cut.record.arm
    n, x, p, relative = arm.n, at.states.shape[1], len(at.size), np.full(arm.n, 0.005)
    unit = np.concatenate([at.size, np.ones(5 * n), [0.01]])
    prior = Prior(unit, np.arange(p), 100.0 * np.eye(p), np.zeros(p))
    start = Start(np.asarray(plant("paper").base_values(arm)), np.zeros(5 * n))
    found = follow(at, relative, start, prior, keep=True)

    # unknowns: parameters, state and bias of each block, errors of torques and steps of the bias in their deviations
    m, fast = len(few.first), x + 1
    torque = np.sqrt(torque_steps(arm) ** 2 + (relative * few.tau[:, 0]) ** 2) / at.blocks.shape[0, 0]
    noise = at.end.of_torque[:, :, 0] * torque[:, None]
    sensors = np.array([*(one.link_encoder.sigma_rad for one in arm.over_the_wire.joints),
                        *(one.motor_encoder.sigma_rad for one in arm.over_the_wire.joints),
                        arm.over_the_wire.imu.rate_sigma])  # fmt: skip
    walk = arm.imu.bias_walk * np.sqrt(arm.period_s)
    places = p + fast * m
    table, right = [], []

    def row(values: dict[int, float], target: float) -> None:
        table.append(np.zeros(places))
        for place, value in values.items():
            table[-1][place] += value
        right.append(target)

    begin, sigma = few.begins[0]
    for j in range(p):
        row({j: 100.0}, 0.0)
    for j in range(fast):
        row({p + j: 1.0 / sigma[j]}, (begin[j] - (at.states[0, j] if j < x else 0.0)) / sigma[j])
    for b in range(m):
        for k, one in enumerate(sensors):
            seen = {j: at.reading.of_constant[b, k, j] * at.size[j] / one for j in range(p)}
            seen |= {p + b * fast + j: at.reading.of_state[b, k, j] / one for j in range(x)}
            if k == len(sensors) - 1:
                seen[p + b * fast + x] = 1.0 / one
            row(seen, at.error[b, k] / one)
    # the motion is exact but for the torques and the bias: constraints by elimination of its noise
    step = np.zeros((fast * (m - 1), places))
    off = np.zeros(fast * (m - 1))
    cover = np.zeros((fast * (m - 1), (n + 1) * (m - 1)))
    for b in range(m - 1):
        part = slice(b * fast, b * fast + x)
        step[part, :p] = -at.end.of_constant[b][:, :p] * at.size
        step[part, p + b * fast : p + b * fast + x] = -at.end.of_state[b]
        step[part, p + (b + 1) * fast : p + (b + 1) * fast + x] = np.eye(x)
        step[b * fast + x, p + b * fast + x], step[b * fast + x, p + (b + 1) * fast + x] = -1.0, 1.0
        off[part] = at.gap[b]
        cover[part, b * (n + 1) : b * (n + 1) + n] = noise[b]
        cover[b * fast + x, b * (n + 1) + n] = walk
    # all unknowns as functions of the first state, the parameters and the noises
    free = np.concatenate([np.arange(p + fast)])
    later = np.arange(p + fast, places)
    inverse = np.linalg.inv(step[:, later])
    whole = np.zeros((places, len(free) + cover.shape[1]))
    whole[free, free] = 1.0
    whole[later, : len(free)] = -inverse @ step[:, free]
    whole[later, len(free) :] = inverse @ cover
    fixed = np.zeros(places)
    fixed[later] = inverse @ off
    left = np.concatenate([np.array(table) @ whole, np.eye(cover.shape[1], whole.shape[1], len(free))])
    target = np.concatenate([np.array(right) - np.array(table) @ fixed, np.zeros(cover.shape[1])])
    scale = np.linalg.norm(left, axis=0)
    answer = np.linalg.lstsq(left / scale, target, rcond=None)[0] / scale
    inside = np.linalg.pinv(left / scale)
    covariance = (inside @ inside.T)[:p, :p] / np.outer(scale[:p], scale[:p]) * np.outer(at.size, at.size)
    sigmas = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigmas, rtol=1e-5)
    assert np.all(np.abs(found.value - start.value - answer[:p] * at.size) < 1e-4 * sigmas)
    states = (whole @ answer + fixed)[p:].reshape(m, fast)[:, :x]
    np.testing.assert_allclose(found.states - at.states, states, atol=1e-7 * np.abs(states).max())
    # the squares of the innovations are those that are left, without the priors and the noises
    assert found.squares.sum() == pytest.approx(
        float(np.sum((left @ answer - target) ** 2)) - float(np.sum((100.0 * answer[:p]) ** 2)), rel=1e-5
    )
