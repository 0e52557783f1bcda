# SPDX-License-Identifier: MIT
"""Bodies fitted to an estimate: what they predict, what they leave alone, and when there are none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arm_support import exact_torques, random_arm
from numpy.typing import NDArray
from physical_support import (
    BLOCKS,
    directional_errors,
    drawing_of,
    estimate_of,
    inertia_matrices,
    inertia_matrices_of,
)

from conftest import ROOT
from zygos.arm import Arm, load_arm
from zygos.dynamics.serial import SpatialDynamics
from zygos.errors import Undecided, ZygosError
from zygos.model import gram
from zygos.model.model import Model, Quantity, load_model
from zygos.model.physical import Observed, PhysicalFit, fit_bodies, nearest_matrix, observe

Floats = NDArray[np.float64]
SPATIAL = ROOT / "examples" / "spatial"
LENGTH = 1e-3


@pytest.fixture(scope="module")
def spatial() -> tuple[Arm, Model]:
    return exact_torques(load_arm(SPATIAL / "arm.toml")), load_model(SPATIAL / "model.toml")


def fitted(arm: Arm, drawing: Model, report: dict[str, Any], length: float = LENGTH) -> PhysicalFit:
    return fit_bodies(arm, drawing, observe(arm.parameter_names, report), length)


@pytest.fixture(scope="module")
def campaign(spatial: tuple[Arm, Model]) -> list[tuple[Floats, PhysicalFit]]:
    """Six estimates with noise, each fitted from another drawing: the raw values and the fit."""
    arm, built = spatial
    runs = []
    for seed in range(6):
        report = estimate_of(arm, built.base_values(arm), noise_j=0.3, seed=seed)
        runs.append((np.array(report["solution"]), fitted(arm, drawing_of(built, seed), report)))
    return runs


@pytest.mark.slow
def test_bodies_predict_better_than_the_estimate(
    spatial: tuple[Arm, Model], campaign: list[tuple[Floats, PhysicalFit]]
) -> None:
    """The inertia matrix over 200 postures, by Pinocchio from bodies; that of the raw estimate from energies."""
    arm, built = spatial
    true = inertia_matrices(arm, built)
    np.testing.assert_allclose(inertia_matrices_of(arm, built.base_values(arm)), true, rtol=1e-9, atol=1e-9)
    before = np.array([directional_errors(inertia_matrices_of(arm, raw), true) for raw, _ in campaign])
    after = np.array([directional_errors(inertia_matrices(arm, fit.model), true) for _, fit in campaign])
    # one draw may be luckier than its fit; the mean square over all of them is not
    assert np.sqrt(np.mean(after**2)) < 0.9 * np.sqrt(np.mean(before**2))
    assert np.median(after) < 0.9 * np.median(before)
    for _, fit in campaign:
        np.testing.assert_allclose(inertia_matrices_of(arm, fit.value), inertia_matrices(arm, fit.model), atol=1e-8)


@pytest.mark.slow
def test_chi_squared_and_sigmas_are_what_they_say(
    spatial: tuple[Arm, Model], campaign: list[tuple[Floats, PhysicalFit]]
) -> None:
    arm, built = spatial
    true = built.base_values(arm)
    ratios = [fit.chi2 / fit.dof for _, fit in campaign]
    # lengths that are less than sure add to what is known of N: more than the 14 = 45 - 31 that bodies cannot choose
    dof = campaign[0][1].dof
    assert 14.0 <= dof <= 18.0 and all(fit.explained for _, fit in campaign)
    assert np.mean(ratios) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / dof / len(ratios)))
    for _, fit in campaign:
        off = (fit.value - true) / np.sqrt(np.diag(fit.covariance))
        assert np.abs(off).max() < 4.5
    # the average square over all parameters, which share their noise: few independent ones among 6 times 54
    squares = [np.mean(((fit.value - true) / np.sqrt(np.diag(fit.covariance))) ** 2) for _, fit in campaign]
    assert np.mean(squares) == pytest.approx(1.0, abs=3.0 * np.std(squares, ddof=1) / np.sqrt(len(squares)))


@pytest.mark.slow
def test_an_indefinite_estimate_becomes_an_arm(spatial: tuple[Arm, Model]) -> None:
    arm, built = spatial
    report = estimate_of(arm, built.base_values(arm), noise_j=20.0)
    raw = np.array(report["solution"])
    with pytest.raises(ZygosError, match="no arm has these N"):
        SpatialDynamics.from_parameters(arm, raw)
    fit = fitted(arm, drawing_of(built, 0), report)
    SpatialDynamics.from_parameters(arm, fit.value)
    # any arm's N is positive semi-definite, so none is nearer than the nearest of those
    assert 0.0 < fit.least < fit.chi2


@pytest.mark.slow
def test_without_noise_any_drawing_leads_to_the_arm(spatial: tuple[Arm, Model]) -> None:
    arm, built = spatial
    true = built.base_values(arm)
    report = estimate_of(arm, true)
    for seed in range(2):
        drawing = drawing_of(built, seed, length_m=0.0)
        fit = fitted(arm, drawing, report, 0.0)
        np.testing.assert_allclose(fit.value, true, rtol=1e-6, atol=1e-7)
        assert [body.joint_xyz for body in fit.model.bodies] == [body.joint_xyz for body in built.bodies]


@pytest.mark.slow
def test_what_the_estimate_does_not_say_stays_as_drawn(spatial: tuple[Arm, Model]) -> None:
    arm, built = spatial
    drawing = drawing_of(built, 3)
    fit = fitted(arm, drawing, estimate_of(arm, drawing.base_values(arm)))
    for after, before in zip(fit.model.bodies, drawing.bodies, strict=True):
        assert after.mass.value == pytest.approx(before.mass.value, rel=1e-7)
        np.testing.assert_allclose(after.tensor, before.tensor, atol=1e-7 * np.trace(before.tensor))
        np.testing.assert_allclose(after.origin_xyz, before.origin_xyz, atol=1e-7)
    # the mass of the whole is in no base parameter: some of it is known, most of it is not
    assert fit.model.bodies[0].mass.sigma > 0.1 * fit.model.bodies[0].mass.value
    assert fit.known["yaw stiffness"] > 0.9999


@pytest.mark.slow(but=["2-free-planar-flexible1"])
@pytest.mark.parametrize(
    ("joints", "base", "kinetic", "flexible"),
    [
        (2, "fixed", "spatial", [False, True]),
        (2, "free", "planar", [True, True]),
        (2, "free", "planar-symmetric", [True, False]),
        (3, "fixed", "planar", [True, True, True]),
        (1, "free", "planar-symmetric", [True]),
    ],
)
def test_arms_of_every_kind_come_back(joints: int, base: Any, kinetic: Any, flexible: list[bool]) -> None:
    arm, built = random_arm(1, joints, base, kinetic, flexible)
    true = built.base_values(arm)
    drawing = replace(
        built,
        bodies=tuple(
            replace(body, mass=replace(body.mass, value=body.mass.value * (1.1 if k % 2 else 0.95)))
            for k, body in enumerate(built.bodies)
        ),
        joints=tuple(
            replace(joint, rotor_inertia=replace(joint.rotor_inertia, value=0.9 * joint.rotor_inertia.value))
            for joint in built.joints
        ),
    )
    fit = fitted(arm, drawing, estimate_of(arm, true))
    np.testing.assert_allclose(fit.value, true, rtol=1e-5, atol=1e-6 * np.abs(true[: len(arm.body_parameters)]).max())
    assert fit.explained and fit.least < 1.0


def test_the_nearest_matrix_is_the_clipped_one(spatial: tuple[Arm, Model]) -> None:
    """In the Frobenius norm, with the rotors as drawn, the nearest positive semi-definite matrix has the negative
    eigenvalues set to zero. The rotors are heavy, so that their share is felt."""
    arm, drawn = spatial
    built = replace(drawn, joints=tuple(replace(joint, rotor_inertia=Quantity(2.0)) for joint in drawn.joints))
    true = built.base_values(arm)
    row, column = gram.pairs(arm)
    rng = np.random.default_rng(0)
    noise = np.concatenate([rng.normal(scale=1.0, size=len(row)), np.zeros(9)])
    weights = np.concatenate([np.where(row == column, 1.0, np.sqrt(2.0)), 1e6 / true[len(row) :]])
    found, least = nearest_matrix(arm, built, Observed(true + noise, np.diag(weights), BLOCKS))
    rotors = gram.of_rotors(arm, np.array([joint.rotor_inertia.value for joint in built.joints]))
    eigen, vectors = np.linalg.eigh(gram.from_parameters(arm, (true + noise)[: len(row)]) - rotors)
    assert eigen[0] < -1.0
    clipped = (vectors * np.maximum(eigen, 0.0)) @ vectors.T + rotors
    np.testing.assert_allclose(gram.from_parameters(arm, found[: len(row)]), clipped, atol=1e-3)
    assert least == pytest.approx(np.sum(np.minimum(eigen, 0.0) ** 2), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["axis", "length"])
def test_an_estimate_of_another_arm_is_not_explained(spatial: tuple[Arm, Model], what: str) -> None:
    arm, built = spatial
    other, joints = built, list(arm.joints)
    if what == "axis":
        joints[1] = replace(joints[1], axis=(0.0, float(np.cos(0.1)), float(np.sin(0.1))))
    else:
        x, y, z = built.bodies[2].joint_xyz or (0.0, 0.0, 0.0)
        bodies = [*built.bodies[:2], replace(built.bodies[2], joint_xyz=(x, y + 0.2, z)), built.bodies[3]]
        other = replace(built, bodies=tuple(bodies))
    values = other.base_values(replace(arm, joints=tuple(joints)))
    fit = fitted(arm, drawing_of(built, 0), estimate_of(arm, values, noise_j=0.03))
    assert not fit.explained and fit.chi2 / fit.dof > 2.0 * fit.limit


def test_columns_of_effects_are_eliminated(spatial: tuple[Arm, Model]) -> None:
    """A column more, correlated with all others: what is said of the arm is what the whole inverse says of it."""
    arm, built = spatial
    report = estimate_of(arm, built.base_values(arm), noise_j=0.1)
    normal, p = np.array(report["normal"]), len(arm.parameter_names)
    cross = normal @ np.random.default_rng(0).normal(size=p) / np.diag(normal) * np.diag(normal).max() ** 0.5 * 1e-3
    wide = np.block(
        [[normal, cross[:, None]], [cross[None], np.array([[10.0 * cross @ np.linalg.solve(normal, cross)]])]]
    )
    inverse = np.linalg.inv(wide)
    report |= {
        "normal": wide.tolist(),
        "solution": [*report["solution"], 0.1],
        "parameters": [
            *report["parameters"],
            {"name": "motor_viscous1", "unit": "Nms/rad", "value": 0.1, "sigma": 1e-3},
        ],
    }
    sigma = 0.1 * np.sqrt(np.diag(inverse)[:p])
    for entry, own in zip(report["parameters"], sigma, strict=False):
        entry["sigma"] = float(own)
    observed = observe(arm.parameter_names, report)
    covariance = np.linalg.inv(observed.root.T @ observed.root)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=1e-6)


def test_refusals(spatial: tuple[Arm, Model]) -> None:
    arm, built = spatial
    report = estimate_of(arm, built.base_values(arm), noise_j=0.1)
    with pytest.raises(Undecided, match="the estimate was refused: too few"):
        observe(arm.parameter_names, report | {"validity": "refused", "reason": "too few accepted instants"})
    with pytest.raises(ZygosError, match="the estimate has no a00, a01"):
        observe(("a00", "a01"), report)
    blind = [entry | {"sigma": None} for entry in report["parameters"]]
    with pytest.raises(Undecided, match="no parameter of the estimate has a sigma"):
        observe(arm.parameter_names, report | {"parameters": blind})
    first, *rest = built.joints
    undamped = replace(built, joints=(replace(first, damping=replace(first.damping, value=0.0)), *rest))
    with pytest.raises(ZygosError, match="damping of joint yaw is 0"):
        fitted(arm, undamped, report)
