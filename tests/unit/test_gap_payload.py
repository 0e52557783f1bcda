# SPDX-License-Identifier: MIT
"""A payload of the last body of a floating arm, from the change of its inertial parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_support import example

from zygos.arm import load_arm
from zygos.gap.payload import payload_of
from zygos.model.model import Model, load_model

SPATIAL = Path(__file__).parents[2] / "examples" / "spatial"


def carrying(model: Model, mass: float, place: tuple[float, float, float]) -> Model:
    """The model with a point mass at a place of the last body."""
    body = model.bodies[-1]
    own, centre, at = body.mass.value, np.array(body.origin_xyz), np.array(place)
    whole = own + mass
    middle = (own * centre + mass * at) / whole
    tensor = body.tensor
    for share, far in ((own, centre - middle), (mass, at - middle)):
        tensor = tensor + share * (far @ far * np.eye(3) - np.outer(far, far))
    entries = (tensor[0, 0], tensor[0, 1], tensor[0, 2], tensor[1, 1], tensor[1, 2], tensor[2, 2])
    inertia = tuple(replace(q, value=float(x)) for q, x in zip(body.inertia, entries, strict=True))
    loaded = replace(
        body,
        mass=replace(body.mass, value=whole),
        origin_xyz=tuple(middle.tolist()),
        inertia=inertia,  # type: ignore[arg-type]
    )
    return replace(model, bodies=(*model.bodies[:-1], loaded))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_point_mass_is_found_from_the_change_of_the_parameters(sign: float) -> None:
    arm, model, _ = example()
    names = tuple(one.name for one in arm.parameters if one.joint is None)
    at = [arm.parameter_names.index(name) for name in names]
    heavier = carrying(model, 150.0, (4.0, 0.0, 0.0)).base_values(arm)
    before, change = (
        (model, heavier - model.base_values(arm))
        if sign > 0.0
        else (
            carrying(model, 150.0, (4.0, 0.0, 0.0)),
            model.base_values(arm) - heavier,
        )
    )
    noise = 1e-6 * model.base_values(arm)[at] * np.random.default_rng(0).normal(size=(20, len(at)))
    found = payload_of(arm, before, names, change[at], noise)
    wanted = {"m2": 150.0, "mx2": 600.0, "Izz2": 2400.0}
    assert {one.name: sign * one.value for one in found} == pytest.approx(wanted, rel=1e-4)
    assert [one.unit for one in found] == ["kg", "kg m", "kg m^2"]


def test_no_payload_without_bodies_or_where_the_parameters_do_not_tell_it() -> None:
    arm, model, _ = example()
    names = tuple(one.name for one in arm.parameters if one.joint is None)
    plain = Model("values", parameters=model.base_parameters(arm))
    drawn = np.random.default_rng(0).normal(size=(20, len(names)))
    assert payload_of(arm, plain, names, np.ones(len(names)), drawn) == ()
    assert payload_of(arm, model, names[4:], np.ones(2), drawn[:, 4:]) == ()


@pytest.mark.slow
def test_a_point_mass_in_space() -> None:
    arm, model = load_arm(SPATIAL / "arm.toml"), load_model(SPATIAL / "model.toml")
    names = tuple(one.name for one in arm.parameters if one.joint is None)
    at = [arm.parameter_names.index(name) for name in names]
    mass = 0.2 * model.bodies[-1].mass.value
    place = tuple(1.2 * x + 0.1 for x in model.bodies[-1].origin_xyz)
    change = (carrying(model, mass, place).base_values(arm) - model.base_values(arm))[at]  # type: ignore[arg-type]
    drawn = 1e-6 * np.random.default_rng(0).normal(size=(20, len(at)))
    values = {one.name: one.value for one in payload_of(arm, model, names, change, drawn)}
    body = len(model.bodies) - 1
    assert values[f"m{body}"] == pytest.approx(mass, rel=1e-3)
    for axis, x in zip("xyz", place, strict=True):
        assert values[f"m{axis}{body}"] == pytest.approx(mass * x, rel=1e-2)
