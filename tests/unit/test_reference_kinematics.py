# SPDX-License-Identifier: MIT
"""The Gram table of planar rate vectors against clouds of point masses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_support import Floats, make_arm

from zygos.balances.energy import energy_columns
from zygos.balances.kinematics import planar_columns
from zygos.balances.state import State


def point_mass_energy(rng: np.random.Generator, on_line: bool, q: Floats, f: Floats) -> Floats:
    """Kinetic energy of random free-floating planar bodies, (m,), from positions alone: no inertia formula is used.

    Body i is five point masses; its centre of mass lies on the line from its joint to the next when on_line.
    Velocities come from a central difference of the positions, exact to 1e-9 of the energy.
    """
    bodies = f.shape[1]
    mass: Floats = rng.uniform(1.0, 3.0, size=(bodies, 5))
    place = rng.normal(size=(bodies, 5, 2))
    place -= np.sum(mass[..., None] * place, axis=1, keepdims=True) / np.sum(mass, axis=1)[:, None, None]
    aside = np.zeros(bodies) if on_line else rng.normal(size=bodies)
    offset = np.stack([rng.uniform(0.3, 0.7, bodies), aside], axis=1)
    place += offset[:, None]
    length = np.asarray(rng.uniform(0.8, 1.5, size=bodies))
    angle = np.concatenate([np.zeros((len(q), 1)), np.cumsum(q, axis=1)], axis=1)

    def positions(step: float) -> Floats:
        turned = angle + step * f
        c, s = np.cos(turned), np.sin(turned)
        rotation = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
        joint: Floats = np.cumsum(rotation[..., 0] * length[:, None], axis=1)
        joint = np.concatenate([np.zeros_like(joint[:, :1]), joint[:, :-1]], axis=1)
        points = joint[:, :, None] + np.einsum("mbij,bpj->mbpi", rotation, place)
        centre = np.einsum("bp,mbpi->mi", mass, points) / mass.sum()
        return np.asarray(points - centre[:, None, None], dtype=np.float64)

    h = 1e-3
    velocity = (8.0 * (positions(h) - positions(-h)) - (positions(2 * h) - positions(-2 * h))) / (12.0 * h)
    return np.asarray(0.5 * np.einsum("bp,mbpi->m", mass, velocity**2), dtype=np.float64)


@pytest.mark.parametrize("joints", [1, 2, 3, 7])
@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar"])
def test_energy_of_point_masses_is_in_the_columns(tmp_path: Path, joints: int, kinetic: str) -> None:
    arm = make_arm(tmp_path, joints=joints, kinetic=kinetic)
    rng = np.random.default_rng(joints)
    q = rng.uniform(-3.0, 3.0, (400, joints))
    qd = rng.normal(size=(400, joints))
    state = State(q, q, qd, qd, rng.normal(size=400))
    z = energy_columns(arm, state, np.zeros_like(q))
    z = z[:, : len(arm.parameter_names) - 3 * joints]
    energy = point_mass_energy(rng, kinetic == "planar-symmetric", q, state.f)
    found, _, rank, _ = np.linalg.lstsq(z, energy, rcond=None)
    fit: Floats = found.astype(np.float64)
    assert rank == z.shape[1]
    assert np.max(np.abs(z @ fit - energy)) < 1e-7 * np.max(energy)
    assert np.linalg.eigvalsh(_matrix(fit, joints + 1))[0] > 0.0


def _matrix(fit: Floats, bodies: int) -> Floats:
    matrix = np.zeros((bodies, bodies))
    matrix[np.triu_indices(bodies)] = fit[: bodies * (bodies + 1) // 2]
    return np.asarray(matrix + np.triu(matrix, 1).T, dtype=np.float64)


def test_centres_of_mass_off_the_line_need_the_planar_columns(tmp_path: Path) -> None:
    """The test above can fail: symmetric columns do not carry an arm that is not symmetric."""
    arm = make_arm(tmp_path)
    rng = np.random.default_rng(1)
    q, qd = rng.uniform(-3.0, 3.0, (400, 2)), rng.normal(size=(400, 2))
    state = State(q, q, qd, qd, rng.normal(size=400))
    z = energy_columns(arm, state, np.zeros_like(q))[:, :6]
    energy = point_mass_energy(rng, False, q, state.f)
    fit = np.linalg.lstsq(z, energy, rcond=None)[0]
    assert np.max(np.abs(z @ fit - energy)) > 1e-3 * np.max(energy)


def test_columns_of_the_paper(tmp_path: Path) -> None:
    """The twelve columns of Nanos & Papadopoulos eq. (37), written out (docs/theory)."""
    arm = make_arm(tmp_path)
    rng = np.random.default_rng(2)
    q, theta, qd, md, loss = rng.normal(size=(5, 50, 2))
    f0 = rng.normal(size=50)
    z = energy_columns(arm, State(q, theta, qd, md, f0), loss)
    f1, f2 = f0 + qd[:, 0], f0 + qd[:, 0] + qd[:, 1]
    d, n = theta - q, 50.0
    expected = {
        "a00": 0.5 * f0**2,
        "a01": np.cos(q[:, 0]) * f0 * f1,
        "a02": np.cos(q[:, 0] + q[:, 1]) * f0 * f2,
        "a11": 0.5 * f1**2,
        "a12": np.cos(q[:, 1]) * f1 * f2,
        "a22": 0.5 * f2**2,
        "Im1": n * f0 * md[:, 0] + 0.5 * n**2 * md[:, 0] ** 2,
        "k1": 0.5 * d[:, 0] ** 2,
        "b1": loss[:, 0],
        "Im2": n * f1 * md[:, 1] + 0.5 * n**2 * md[:, 1] ** 2,
        "k2": 0.5 * d[:, 1] ** 2,
        "b2": loss[:, 1],
    }
    for column, name in enumerate(arm.parameter_names):
        np.testing.assert_allclose(z[:, column], expected[name], rtol=1e-12, atol=1e-12 * np.abs(expected[name]).max())


def test_columns_of_cosines_are_even_and_those_of_sines_odd_in_the_posture(tmp_path: Path) -> None:
    arm = make_arm(tmp_path, joints=3, kinetic="planar")
    rng = np.random.default_rng(4)
    q, qd = rng.normal(size=(2, 5, 3))
    state = State(q, q, qd, qd, rng.normal(size=5))
    names = [name for name, _ in arm.body_parameters]
    there, mirrored = (planar_columns(arm, replace(state, q=x), np.multiply) for x in (q, -q))
    np.testing.assert_allclose(there[:, :10], mirrored[:, :10], rtol=1e-14)
    np.testing.assert_allclose(there[:, 10:], -mirrored[:, 10:], rtol=1e-14, atol=1e-16)
    pair = state.f[:, 1] * state.f[:, 3] * np.sin(state.phi[:, 3] - state.phi[:, 1])
    np.testing.assert_allclose(there[:, names.index("b13")], pair, rtol=1e-12, atol=1e-14)
