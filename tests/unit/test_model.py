# SPDX-License-Identifier: MIT
"""Base parameters from bodies, and the model file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plant_support import LIVELY, lively, random_arm

from zygos.dynamics.planar import PlanarDynamics
from zygos.errors import ZygosError
from zygos.model.model import Model, Quantity, load_model, save_model

TABLE_III = {  # Nanos & Papadopoulos, Table III
    "a00": 23774.1975, "a01": 42329.8731, "a02": 9611.6878, "a11": 81831.7048, "a12": 19708.7659, "a22": 5098.5390,
    "Im1": 1.0, "b1": 85.0, "Im2": 1.0, "b2": 75.0,
}  # fmt: skip


def test_the_papers_table_to_all_printed_digits() -> None:
    arm, model, _ = lively()
    parameters = model.base_parameters(arm)
    assert tuple(parameters) == arm.parameter_names
    for name, printed in TABLE_III.items():
        assert round(parameters[name].value, 4) == printed, name
        assert parameters[name].unit == dict(zip(arm.parameter_names, arm.parameter_units, strict=True))[name]


def test_closed_form_of_the_papers_example() -> None:
    """docs/paper.md, "The arm", with other numbers than the paper's."""
    arm, model, _ = lively()
    base, link1, link2 = model.bodies
    model = replace(
        model,
        bodies=(
            replace(base, mass=Quantity(3000.0)),
            replace(link1, mass=Quantity(150.0)),
            replace(link2, mass=Quantity(700.0)),
        ),
    )
    m0, m1, m2, rotor = 3000.0, 150.0, 700.0, 1.0
    total = m0 + m1 + m2 + 2 * rotor
    s1 = m1 * 5 + (rotor + m2) * 10
    s2 = m2 * 2.5
    expected = [
        666.7 + 1 + m0 * (total - m0) * 25 / total, m0 / total * 5 * s1, m0 / total * 5 * s2,
        33.3 + 1 + m1 * 25 + (rotor + m2) * 100 - s1**2 / total, s2 * (10 - s1 / total),
        50 + m2 * (total - m2) * 2.5**2 / total,
    ]  # fmt: skip
    np.testing.assert_allclose(model.base_values(arm)[:6], expected, rtol=1e-12)


@pytest.mark.slow
def test_covariance_is_that_of_the_bodies() -> None:
    """Against draws of the bodies: correlated, so that no draw within it gives negative kinetic energy."""
    arm, model, _ = lively()
    base, link1, link2 = model.bodies
    relative = 0.02

    def spread(quantity: Quantity) -> Quantity:
        return replace(quantity, sigma=relative * quantity.value)

    model = replace(model, bodies=tuple(replace(body, mass=spread(body.mass)) for body in (base, link1, link2)))
    covariance = model.base_covariance(arm)
    sigmas = [quantity.sigma for quantity in model.base_parameters(arm).values()]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigmas)
    rng = np.random.default_rng(0)
    draws = np.array([
        replace(model, bodies=tuple(
            replace(body, mass=Quantity(body.mass.value * (1 + relative * rng.standard_normal())))
            for body in model.bodies)).base_values(arm)
        for _ in range(1500)
    ])  # fmt: skip
    sample = np.cov(draws.T)
    np.testing.assert_allclose(sample[:6, :6], covariance[:6, :6], rtol=0.12, atol=0.05 * np.abs(covariance).min())
    assert np.linalg.matrix_rank(covariance[:6, :6], tol=1e-6 * np.abs(covariance).max()) <= 3
    for draw in draws[:50]:
        assert PlanarDynamics.from_parameters(arm, draw).margin > 0


def test_mass_centres_off_the_line_need_a_planar_arm() -> None:
    arm, model = random_arm(np.random.default_rng(0), 3, "planar")
    assert len(model.base_values(arm)) == 4**2 + 3 * 3
    with pytest.raises(ZygosError, match='kinetic = "planar"'):
        model.base_values(replace(arm, kinetic="planar-symmetric"))


def test_file_round_trip(tmp_path: Path) -> None:
    arm, model, _ = lively()
    model = replace(
        model, joints=tuple(replace(joint, stiffness=Quantity(820.0, 6.0, "test", "Nm/rad")) for joint in model.joints)
    )
    save_model(model, tmp_path / "bodies.toml")
    assert load_model(tmp_path / "bodies.toml") == model

    named = Model("estimate", parameters=model.base_parameters(arm))
    save_model(named, tmp_path / "named.toml")
    again = load_model(tmp_path / "named.toml")
    assert again == named
    assert again.base_parameters(arm) == named.parameters
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["bodies.toml", "named.toml"]


def test_a_failed_write_leaves_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, model, _ = lively()
    file = tmp_path / "model.toml"
    save_model(model, file)
    before = file.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(ZygosError, match=r"model\.toml: cannot be written.*remedy"):
        save_model(replace(model, name="other"), file)
    assert file.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.toml"]


@pytest.mark.parametrize(("find", "put", "key"), [
    ("mass = 200.0", "mass = 0.0", r"body\[1\]\.mass"),
    ("mass = 200.0", "mas = 200.0", r"body\[1\]\.mass: is missing"),
    ("mass = 200.0", "mass = 200.0\nmaas = 1", r"body\[1\]\.maas: unknown key"),
    ("mass = 200.0", 'mass = "heavy"', r"body\[1\]\.mass"),
    ("mass = 200.0", "mass = { value = 200.0, sigma = -1 }", r"body\[1\]\.mass\.sigma"),
    ("mass = 200.0", "mass = { value = nan }", r"body\[1\]\.mass\.value"),
    ("mass = 200.0", "mass = 1" + "0" * 400, r"body\[1\]\.mass"),
    ("mass = 200.0", "mass = nan", r"body\[1\]\.mass: nan is out of range"),
    ("mass = 200.0", "mass = 1e300", r"body\[1\]\.mass: 1e\+300 is out of range"),
    ("ixx = 33.3", "ixx = 1e300", r"body\[1\]\.ixx: 1e\+300 is out of range"),
    ("joint_xyz = [10, 0, 0]", "joint_xyz = [1e300, 0, 0]", r"body\[1\]\.joint_xyz: 1e\+300 is out of range"),
    ("damping = 85.0", "damping = { value = 85.0, sigma = 1e300 }", r"joint\[0\]\.damping\.sigma: 1e\+300"),
    ("origin_xyz = [2.5, 0, 0]", "origin_xyz = [2.5, 0]", r"body\[2\]\.origin_xyz"),
    ("origin_xyz = [2.5, 0, 0]", "origin_xyz = [2.5, 0, 0]\njoint_xyz = [5, 0, 0]", r"body\[2\]\.joint_xyz"),
    ("joint_xyz = [10, 0, 0]", "", r"body\[1\]\.joint_xyz: is missing"),
    ("ixx = 33.3", "ixx = 3.3e3", r"body\[1\]\.ixx: no body can have the principal moments"),
    ("ixx = 33.3", "ixx = -33.3", r"body\[1\]\.ixx"),
    ("rotor_inertia = 1.0", "rotor_inertia = 0", r"joint\[0\]\.rotor_inertia"),
    ("damping = 85.0", "damping = -1.0", r"joint\[0\]\.damping"),
    ('source = "CAD"', 'source = "guess"', "source"),
    ('name = "lively"', 'name = "lively"\n[parameters]\na00 = 1.0', "parameters"),
    ("[[body]]", "[[body]", "not valid TOML"),
    ('name = "elbow"', "name = 3", r"joint\[1\]\.name"),
])  # fmt: skip
def test_bad_files_are_refused(tmp_path: Path, find: str, put: str, key: str) -> None:
    text = (LIVELY / "model.toml").read_text()
    assert find in text
    file = tmp_path / "model.toml"
    file.write_text(text.replace(find, put, 1))
    with pytest.raises(ZygosError, match=rf"model\.toml: .*{key}.*; remedy: "):
        load_model(file)


def test_a_missing_file_and_a_missing_body(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="no such file; remedy"):
        load_model(tmp_path / "none.toml")
    text = (LIVELY / "model.toml").read_text()
    file = tmp_path / "model.toml"
    file.write_text(text[: text.rindex("[[joint]]")])
    with pytest.raises(ZygosError, match="3 bodies for 1 joints; remedy"):
        load_model(file)


def test_a_model_of_another_arm_is_refused() -> None:
    arm, model, _ = lively()
    other = replace(model, joints=model.joints[::-1])
    with pytest.raises(ZygosError, match=r"joints.*remedy"):
        other.base_parameters(arm)
    named = Model("estimate", parameters={"a00": Quantity(1.0)})
    with pytest.raises(ZygosError, match=r"missing.*a01.*remedy"):
        named.base_parameters(arm)
