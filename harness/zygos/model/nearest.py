# SPDX-License-Identifier: MIT
"""Bodies from base parameters: the bodies nearest to a drawing, and which of their entries are determined.

An arm has fewer base parameters than its bodies have entries (docs/theory.md). Of all bodies with the given parameters,
those that differ least from the drawing are chosen, in units of its sigmas: min |y|^2 subject to base(x + D y) = given.
The solver is Gauss-Newton; each step is the shortest solution of the linearised equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Body, JointModel, Model, Quantity, is_possible

Array = NDArray[np.float64]

ENTRIES = ("mass", "x", "y", "z", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Entries of a body, as in a URDF <inertial>; the inertia is about the mass centre."""
UNITS = ("kg", *("m",) * 3, *("kg m^2",) * 6)
DETERMINED = 1e-6
"""An entry is determined if its component is at most this in every direction that leaves the parameters unchanged, in
units of the drawing."""

_SINGULAR = 1e-8
"""Smallest singular value that counts, relative to the largest; the Jacobian is accurate to 1e-11."""
_STEP = 1e-3
"""Step of the numerical differentiation, as a share of each entry's natural size."""
_STEPS = 50
_UNMOVED = 1e-12
"""Change of an entry, in units of the drawing, that is only rounding: the entry then keeps the drawing's value."""
_CLOSE = 1e-10
"""Largest error of a base parameter, relative to its value and to its change by one of the drawing's units."""


@dataclass(frozen=True)
class Nearest:
    """Bodies with given base parameters."""

    model: Model
    """The drawing with these bodies; rotor inertias, stiffness and damping as given."""
    known: Array
    """(N+1, 10) share of the drawing's uncertainty in each of ENTRIES that the parameters remove, 0 .. 1."""
    determined: NDArray[np.bool_]
    """(N+1, 10) whether the parameters alone determine the entry."""
    moved: Array
    """(N+1, 10) difference of the entry from the drawing, in units of the drawing."""


def nearest_bodies(
    arm: Arm, drawing: Model, given: Model, progress: Callable[[float], None] = lambda share: None
) -> Nearest:
    """The bodies nearest to `drawing` (given by bodies) whose base parameters are those of `given` (given by base
    parameters; a missing parameter is no constraint).

    The unit of an entry is its sigma; where that is 0, its natural size (mass, radius of gyration, mean principal
    moment) times the largest relative sigma of the body, or the size itself if the body has no sigma. Lengths are
    exact, and so are rotor masses.
    Errors: ZygosError if the models do not fit the arm or come from motor currents, Undecided if no physically possible
    bodies near the drawing have the parameters.
    """
    if given.relative:
        raise ZygosError(
            f"model {given.name} was learned from motor currents with unknown torque constants, so that no bodies have "
            "its values; remedy: learn it again from torques"
        )
    unknown = [name for name in given.parameters if name not in arm.parameter_names]
    if unknown:
        raise ZygosError(
            f"model {given.name} does not fit arm {arm.name}: unknown {unknown}; remedy: give the arm file with which "
            "the model was estimated"
        )
    target = {name: given.parameters[name].value for name, _ in arm.body_parameters if name in given.parameters}
    rows = [arm.parameter_names.index(name) for name in target]
    # during the iteration, mass centres may leave the lines between the joints of a planar-symmetric arm
    crooked = replace(arm, kinetic="planar") if arm.kinetic == "planar-symmetric" else None
    off_line = [one.symbol == "b" and one.joint is None for one in crooked.full_parameters] if crooked else []
    wanted = np.array([*target.values(), *[0.0] * sum(off_line)])
    drives = tuple(_drive(arm, index, joint, given) for index, joint in enumerate(drawing.joints))
    start, units, sizes = _entries(drawing)
    drawing.check_fits(arm if crooked is None else crooked)

    def base(entries: Array) -> Array:
        bodies = tuple(_body(body, row) for body, row in zip(drawing.bodies, entries.reshape(-1, 10), strict=True))
        # the sigmas of the drives are not needed here, and would make the evaluation compute a covariance
        plain = tuple(JointModel(joint.name, *(Quantity(q.value) for q in _quantities(joint))) for joint in drives)
        model = Model(drawing.name, bodies, plain)
        values = model.unchecked_values(arm)[rows]
        if crooked is None:
            return values
        return np.concatenate([values, crooked.structure.expanded(model.unchecked_values(crooked))[off_line]])

    y = np.zeros(start.size)
    jacobian = _jacobian(base, start, sizes) * units
    weights = np.linalg.norm(jacobian, axis=1)
    # a product of two entries that are both zero has no gradient until one of them has changed
    weights[weights == 0.0] = weights.max()
    error = _error(base(start), wanted, weights)
    for step in range(_STEPS):
        progress(step / _STEPS)
        scaled = jacobian / weights[:, None]
        missing = (wanted - base(start + units * y)) / weights
        towards = np.linalg.pinv(scaled, rcond=_SINGULAR) @ (missing + scaled @ y) - y
        share = 1.0
        while share > 1e-3 and error > _CLOSE:
            if _error(base(start + units * (y + share * towards)), wanted, weights) < error:
                break
            share /= 2
        y = y + share * towards
        error = _error(base(start + units * y), wanted, weights)
        jacobian = _jacobian(base, start + units * y, sizes) * units
        if error < _CLOSE and np.linalg.norm(share * towards) < 1e-9 * (1.0 + np.linalg.norm(y)):
            break
    if not error < _CLOSE:
        raise Undecided(
            f"no bodies near model {drawing.name} have the base parameters of model {given.name}; remedy: check that "
            "both belong to the same arm with the same lengths; an estimate of a spatial arm contains noise, so no "
            "bodies have exactly its parameters: fit bodies with `zygos fit`, and export those"
        )
    y[np.abs(y) < _UNMOVED] = 0.0
    _, singular, directions = np.linalg.svd(jacobian / weights[:, None])
    rank = int(np.sum(singular > _SINGULAR * singular[0]))
    free = np.linalg.norm(directions[rank:], axis=0)
    found = (start + units * y).reshape(-1, 10)
    model = replace(
        drawing,
        bodies=tuple(_body(body, row) for body, row in zip(drawing.bodies, found, strict=True)),
        joints=drives,
        effects=given.effects,
    )
    for body in model.bodies[0 if arm.free else 1 :]:
        _check_possible(body, drawing, given)
    return Nearest(
        model,
        known=np.clip(1.0 - free.reshape(-1, 10) ** 2, 0.0, 1.0),
        determined=free.reshape(-1, 10) < DETERMINED,
        moved=y.reshape(-1, 10),
    )


def entries_of(body: Body) -> list[float]:
    """The values of a body's ENTRIES."""
    return [body.mass.value, *body.origin_xyz, *(quantity.value for quantity in body.inertia)]


def _quantities(joint: JointModel) -> tuple[Quantity, ...]:
    return joint.rotor_mass, joint.rotor_inertia, joint.stiffness, joint.damping


def _drive(arm: Arm, index: int, joint: JointModel, given: Model) -> JointModel:
    """The drive of the drawing, with the given values where there are any."""
    names = [f"{kind}{at + 1}" for kind, at, _ in arm.joint_parameters if at == index]
    known = {name: given.parameters[name] for name in names if name in given.parameters}
    return replace(
        joint,
        rotor_inertia=known.get(f"Im{index + 1}", joint.rotor_inertia),
        stiffness=known.get(f"k{index + 1}", joint.stiffness),
        damping=known.get(f"b{index + 1}", joint.damping),
    )


def _entries(drawing: Model) -> tuple[Array, Array, Array]:
    """Values, units and natural sizes of the drawing's entries, each (10 (N+1),)."""
    values, units, sizes = [], [], []
    for body in drawing.bodies:
        moment = float(np.trace(body.tensor)) / 3.0
        # a base that is fixed may have no mass; its entries have no effect, and any size does
        mass = body.mass.value or 1.0
        moment = moment or 1.0
        size = np.array([mass] + [np.sqrt(moment / mass)] * 3 + [moment] * 6)
        sigma = np.array([body.mass.sigma, 0.0, 0.0, 0.0, *(quantity.sigma for quantity in body.inertia)])
        relative = float((sigma / size).max()) or 1.0
        values.append(entries_of(body))
        units.append(np.where(sigma > 0.0, sigma, relative * size))
        sizes.append(size)
    return np.ravel(values), np.ravel(units), np.ravel(sizes)


def _body(body: Body, entries: Array) -> Body:
    """The body with other entries, without sigmas."""
    x, y, z = (float(value) for value in entries[1:4])
    ixx, ixy, ixz, iyy, iyz, izz = (
        Quantity(float(value), 0.0, "zygos", quantity.unit)
        for value, quantity in zip(entries[4:], body.inertia, strict=True)
    )
    mass = Quantity(float(entries[0]), 0.0, "zygos", body.mass.unit)
    return replace(body, mass=mass, origin_xyz=(x, y, z), inertia=(ixx, ixy, ixz, iyy, iyz, izz))


def _jacobian(base: Callable[[Array], Array], at: Array, sizes: Array) -> Array:
    """(p, 10 (N+1)) Jacobian by fourth-order central differences."""
    columns = []
    for index, size in enumerate(sizes):
        step = np.zeros_like(at)
        step[index] = _STEP * size
        near = base(at + step) - base(at - step)
        far = base(at + 2 * step) - base(at - 2 * step)
        columns.append((8 * near - far) / (12 * _STEP * size))
    return np.array(columns).T


def _error(values: Array, wanted: Array, weights: Array) -> float:
    return float(np.max(np.abs(values - wanted) / (weights + np.abs(wanted)), initial=0.0))


def _check_possible(body: Body, drawing: Model, given: Model) -> None:
    wrong = ""
    if body.mass.value <= 0.0:
        wrong = f"the mass {body.mass.value:g} kg"
    elif not is_possible(body.tensor):
        wrong = f"the principal moments {np.linalg.eigvalsh(body.tensor).tolist()} kg m^2"
    if wrong:
        raise Undecided(
            f"the bodies nearest to model {drawing.name} with the base parameters of model {given.name} cannot exist: "
            f"{body.name} has {wrong}; remedy: fit possible bodies with `zygos fit`, or state sigmas in the "
            "drawing for the entries that are least certain"
        )
