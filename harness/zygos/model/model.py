"""What someone believes of an arm: masses, lengths, inertias, stiffness (`model.toml`).

A model is given either by its bodies and joints, or by base parameters (docs/theory.md). Both give `base_parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.files.output import write_text
from zygos.files.toml import Table
from zygos.model import gram

SOURCES = ("CAD", "test", "zygos")
_LARGEST = 1e12
"""Of masses, inertias, stiffnesses, dampings and sigmas, in SI units. A station has 1e9 kg m^2."""
_FARTHEST_M = 1e6
INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_JOINT_UNITS = {"rotor_mass": "kg", "rotor_inertia": "kg m^2", "stiffness": "Nm/rad", "damping": "Nms/rad"}


@dataclass(frozen=True)
class Quantity:
    """A value with its standard deviation (0: taken as exact), where it comes from, and its unit."""

    value: float
    sigma: float = 0.0
    source: str = "CAD"
    unit: str = ""


@dataclass(frozen=True)
class Body:
    """A rigid body without the rotor it carries; vectors in its own frame, whose origin is the joint carrying it."""

    name: str
    mass: Quantity
    """kg."""
    origin_xyz: tuple[float, float, float]
    """Mass centre, m (URDF's inertial origin)."""
    inertia: tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]
    """ixx, ixy, ixz, iyy, iyz, izz about the mass centre, kg m^2."""
    joint_xyz: tuple[float, float, float] | None = None
    """Origin of the joint that carries the next body, m; None for the last body."""

    @property
    def tensor(self) -> NDArray[np.float64]:
        """(3, 3) inertia about the mass centre, kg m^2."""
        return _tensor([entry.value for entry in self.inertia])


@dataclass(frozen=True)
class JointModel:
    """What the drive of one joint adds: its rotor, fixed in place to the carrying body, and its flexibility."""

    name: str
    rotor_mass: Quantity
    """kg, at the joint."""
    rotor_inertia: Quantity
    """kg m^2, about the joint axis, before the gear; counted on the carrying body as well."""
    stiffness: Quantity
    """Nm/rad, after the gear; infinite for a model whose joint is rigid."""
    damping: Quantity
    """Nms/rad, after the gear."""


@dataclass(frozen=True)
class Model:
    """A model of an arm: either `bodies` (N+1) and `joints` (N), or `parameters` by name; and its effects."""

    name: str
    bodies: tuple[Body, ...] = ()
    joints: tuple[JointModel, ...] = ()
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    effects: tuple[Effect, ...] = ()

    def base_parameters(self, arm: Arm) -> dict[str, Quantity]:
        """Base parameters by name, in the order of `arm.parameter_names`.

        Sigmas of a model given by bodies are propagated to first order. Errors: ZygosError if the model does not fit
        the arm: other joints, missing or unknown parameters, b_ij where the arm says planar-symmetric.
        """
        names = arm.parameter_names
        if not self.bodies:
            return self._named_parameters(arm)
        self.check_fits(arm)
        values = self._convert(arm, self._scalars())
        sigmas = np.sqrt(np.diag(self.base_covariance(arm)))
        quantities = self._quantities()
        inertial = quantities[: 7 * len(self.bodies)] + [joint.rotor_inertia for joint in self.joints]
        found = {quantity.source for quantity in inertial}
        # a mixture is worth no more than its least certain part
        sources = [next(source for source in SOURCES if source in found)] * len(arm.body_parameters)
        keys = {"Im": "rotor_inertia", "k": "stiffness", "b": "damping"}
        sources += [getattr(self.joints[i], keys[kind]).source for kind, i, _ in arm.joint_parameters]
        return {
            name: Quantity(float(value), float(sigma), source, unit)
            for name, value, sigma, source, unit in zip(
                names, values, sigmas, sources, arm.parameter_units, strict=True
            )
        }

    def base_values(self, arm: Arm) -> NDArray[np.float64]:
        """(p,) base parameters in the order of `arm.parameter_names`, SI units. Errors as `base_parameters`."""
        return np.array([quantity.value for quantity in self.base_parameters(arm).values()])

    def base_covariance(self, arm: Arm) -> NDArray[np.float64]:
        """(p, p) covariance of the base parameters.

        For a model given by bodies it carries the correlations that masses and inertias impose; independent variances
        of the a_ij would allow negative kinetic energy (docs/theory.md). Geometry is taken as exact.
        """
        if not self.bodies:
            sigma = np.array([quantity.sigma for quantity in self._named_parameters(arm).values()])
            return np.diag(sigma**2)
        self.check_fits(arm)
        # an infinite stiffness is exact; its place only has to hold a number
        scalars = np.nan_to_num(self._scalars(), posinf=1.0)
        sigmas = np.array([quantity.sigma for quantity in self._quantities()])
        columns = np.zeros((len(arm.parameter_names), len(scalars)))
        for index in np.flatnonzero(sigmas):
            # central difference; the step is large against rounding, the third derivative negligible
            step = 1e-4 * max(abs(scalars[index]), 1e-3)
            shift = np.zeros_like(scalars)
            shift[index] = step
            columns[:, index] = (self._convert(arm, scalars + shift) - self._convert(arm, scalars - shift)) / (2 * step)
        scaled = columns * sigmas
        covariance: NDArray[np.float64] = scaled @ scaled.T
        return covariance

    def _named_parameters(self, arm: Arm) -> dict[str, Quantity]:
        missing = [name for name in arm.parameter_names if name not in self.parameters]
        unknown = [name for name in self.parameters if name not in arm.parameter_names]
        if missing or unknown:
            raise ZygosError(
                f"model {self.name} does not fit arm {arm.name}: missing {missing}, unknown {unknown}; "
                f"remedy: [parameters] must hold exactly {', '.join(arm.parameter_names)}"
            )
        return {name: self.parameters[name] for name in arm.parameter_names}

    def check_fits(self, arm: Arm) -> None:
        """Refuse, with ZygosError, an arm whose joints are not those of this model by bodies."""
        names = [joint.name for joint in arm.joints]
        if [joint.name for joint in self.joints] != names:
            raise ZygosError(
                f"model {self.name} has joints {[joint.name for joint in self.joints]}, arm {arm.name} "
                f"has {names}; remedy: name the joints alike, from the base outwards"
            )
        if arm.free and self.bodies[0].mass.value == 0.0:
            raise ZygosError(
                f"model {self.name}: the base {self.bodies[0].name} has no mass, but in arm {arm.name} it floats; "
                'remedy: give it mass and inertia, or write base = "fixed" in the arm file'
            )
        for ours, theirs in zip(self.joints, arm.joints, strict=True):
            if not theirs.flexible and np.isfinite(ours.stiffness.value):
                raise ZygosError(
                    f"model {self.name}: joint {ours.name} has a stiffness, but in arm {arm.name} it is rigid; remedy: "
                    "stiffness = inf in the model, or flexible = true in the arm file"
                )

    def _quantities(self) -> list[Quantity]:
        listed: list[Quantity] = []
        for body in self.bodies:
            listed += [body.mass, *body.inertia]
        for joint in self.joints:
            listed += [joint.rotor_mass, joint.rotor_inertia, joint.stiffness, joint.damping]
        return listed

    def _scalars(self) -> NDArray[np.float64]:
        return np.array([quantity.value for quantity in self._quantities()])

    def _convert(self, arm: Arm, scalars: NDArray[np.float64]) -> NDArray[np.float64]:
        """Base parameters (p,) from the scalars in the order of `_quantities` (docs/theory.md, "From bodies …")."""
        bodies = len(self.bodies)
        body = scalars[: 7 * bodies].reshape(bodies, 7)
        drive = scalars[7 * bodies :].reshape(bodies - 1, 4)
        mass = body[:, 0].copy()
        first = np.zeros((bodies, 3))
        second = np.zeros((bodies, 3, 3))
        reach = np.zeros((bodies, 3))
        for i, part in enumerate(self.bodies):
            centre = np.array(part.origin_xyz)
            tensor = _tensor(body[i, 1:])
            first[i] = mass[i] * centre
            second[i] = 0.5 * np.trace(tensor) * np.eye(3) - tensor + mass[i] * np.outer(centre, centre)
            if part.joint_xyz is not None:
                reach[i] = part.joint_xyz
                rotor_mass, rotor_inertia = drive[i, :2]
                axis = arm.frames[i].T @ arm.axes[i]
                mass[i] += rotor_mass
                first[i] += rotor_mass * reach[i]
                second[i] += rotor_mass * np.outer(reach[i], reach[i])
                second[i] += 0.5 * rotor_inertia * (np.eye(3) - np.outer(axis, axis))
        if arm.spatial:
            matrix, moments = gram.of_bodies(arm, mass, first, second, reach)
            kinetic = gram.to_parameters(arm, matrix)
        else:
            kinetic = self._planar(arm, mass, first, second, reach)
            moments = gram.of_bodies(arm, mass, first, second, reach)[1]
        heavy = np.repeat(np.array(arm.feels_gravity), 2)
        if not arm.free and not arm.joints[0].flexible:
            kinetic[0] += arm.joints[0].gear_ratio ** 2 * drive[0, 1]
        columns = {"Im": 1, "k": 2, "b": 3}
        joints = [drive[i, columns[kind]] for kind, i, _ in arm.joint_parameters]
        return np.concatenate([kinetic, moments[-len(heavy) :][heavy], joints])

    def _planar(
        self,
        arm: Arm,
        mass: NDArray[np.float64],
        first: NDArray[np.float64],
        second: NDArray[np.float64],
        reach: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """a_ij, and b_ij where the arm has them, of bodies as in `gram.of_bodies`."""
        axis = arm.axis
        across = np.einsum("ab,ibc->iac", np.eye(3) - np.outer(axis, axis), arm.frames)
        first = np.einsum("iac,ic->ia", across, first)
        reach = np.einsum("iac,ic->ia", across, reach)
        polar = np.einsum("iac,icd,iad->i", across, second, across)
        total = mass.sum() if arm.free else np.inf
        beyond = np.append(np.cumsum(mass[::-1])[::-1][1:], 0.0)
        pull = first + beyond[:, None] * reach
        near = pull / total
        far = reach - near
        before = np.cumsum(mass) - mass
        a = polar - 2 * np.sum(first * near, axis=1) + beyond * np.sum(far * far, axis=1)
        if arm.free:
            a += (mass + before) * np.sum(near * near, axis=1)
        values: list[float] = []
        skew: list[float] = []
        bodies = range(0 if arm.free else 1, arm.n + 1)
        for i in bodies:
            for j in bodies[bodies.index(i) :]:
                values.append(float(a[i] if i == j else far[i] @ pull[j]))
                if i < j:
                    skew.append(float(axis @ np.cross(pull[j], far[i])))
        if arm.kinetic == "planar":
            values += skew
        elif skew and np.max(np.abs(skew)) > 1e-9 * np.max(np.abs(values)):
            raise ZygosError(
                f"model {self.name}: mass centres lie off the joint-to-joint lines (b_ij = {skew}), but "
                f'arm {arm.name} says kinetic = "planar-symmetric"; remedy: kinetic = "planar"'
            )
        return np.array(values)


def load_model(path: str | Path) -> Model:
    """Read `model.toml`. Errors: ZygosError naming file, key and remedy, also for a body that cannot exist."""
    top = Table.load(path)
    name = top.text("name")
    source = top.choice("source", SOURCES, "CAD")
    if top.has("parameters"):
        if top.has("body") or top.has("joint"):
            raise top.error("parameters", "stands beside [[body]] or [[joint]]", "keep one of the two")
        table = top.table("parameters")
        parameters = {key: _quantity(table, key, None, source, infinite=key.startswith("k")) for key in table.names()}
        effects = _effects(top, source)
        top.finish()
        return Model(name, parameters=parameters, effects=effects)
    tables = top.tables("body")
    bodies = tuple(
        _body(table, source, first=index == 0, last=index == len(tables) - 1) for index, table in enumerate(tables)
    )
    joints = tuple(read_joint_model(table, source) for table in top.tables("joint"))
    if len(bodies) != len(joints) + 1:
        raise top.error(
            "body",
            f"{len(bodies)} bodies for {len(joints)} joints",
            "give one [[body]] for the base and one for each [[joint]]",
        )
    effects = _effects(top, source)
    top.finish()
    return Model(name, bodies, joints, effects=effects)


def save_model(model: Model, path: str | Path) -> None:
    """Write `model.toml` so that a reader sees the old file or the whole new one. Errors: ZygosError if it cannot be
    written."""
    document = tomlkit.document()
    document["name"] = model.name
    if model.parameters:
        table = tomlkit.table()
        for name, quantity in model.parameters.items():
            table[name] = _inline(quantity, unit=True)
        document["parameters"] = table
    else:
        bodies = tomlkit.aot()
        for body in model.bodies:
            entry = tomlkit.table()
            entry["name"] = body.name
            entry["mass"] = _inline(body.mass)
            entry["origin_xyz"] = list(body.origin_xyz)
            for key, quantity in zip(INERTIA_KEYS, body.inertia, strict=True):
                entry[key] = _inline(quantity)
            if body.joint_xyz is not None:
                entry["joint_xyz"] = list(body.joint_xyz)
            bodies.append(entry)
        joints = tomlkit.aot()
        for joint in model.joints:
            entry = tomlkit.table()
            entry["name"] = joint.name
            for key in _JOINT_UNITS:
                entry[key] = _inline(getattr(joint, key))
            joints.append(entry)
        document["body"] = bodies
        document["joint"] = joints
    if model.effects:
        entries = tomlkit.aot()
        for effect in model.effects:
            entry = tomlkit.table()
            entry["kind"] = effect.kind.key
            if effect.joint is not None:
                entry["joint"] = effect.joint
            entry["value"] = effect.value
            entry["sigma"] = effect.sigma
            entry["unit"] = effect.kind.unit
            entry["source"] = effect.source
            if effect.evidence:
                entry["evidence"] = effect.evidence
            entries.append(entry)
        document["effect"] = entries
    write_text(Path(path), tomlkit.dumps(document))


def _effects(top: Table, source: str) -> tuple[Effect, ...]:
    effects: list[Effect] = []
    for table in top.tables("effect", optional=True):
        key = table.choice("kind", tuple(CATALOGUE))
        kind = CATALOGUE[key]
        effect = Effect(
            kind,
            table.text("joint") if kind.at_joint else None,
            table.number("value", low=0.0 if kind.positive else -_LARGEST, high=_LARGEST, unit=kind.unit),
            table.number("sigma", 0.0, low=0.0, high=_LARGEST, unit=kind.unit),
            table.choice("source", SOURCES, source),
            table.text("evidence") if table.has("evidence") else "",
        )
        if table.has("unit") and (unit := table.text("unit")) != kind.unit:
            raise table.error("unit", f"{unit!r} is not the unit of {key}", f'convert the value to "{kind.unit}"')
        table.finish()
        if any((other.kind, other.joint) == (effect.kind, effect.joint) for other in effects):
            raise table.error("kind", f"{key} at {effect.joint or 'the base'} stands twice", "keep one of the entries")
        effects.append(effect)
    return tuple(effects)


def _inline(quantity: Quantity, *, unit: bool = False) -> Any:
    table = tomlkit.inline_table()
    table["value"] = quantity.value
    table["sigma"] = quantity.sigma
    if unit:
        table["unit"] = quantity.unit
    table["source"] = quantity.source
    return table


def _quantity(
    table: Table,
    key: str,
    unit: str | None,
    source: str,
    *,
    default: float | None = None,
    low: float = -_LARGEST,
    above: float = -np.inf,
    infinite: bool = False,
) -> Quantity:
    """A number, or { value, sigma, source }; with unit None the file states the unit."""
    if not table.has(key) and default is not None:
        return Quantity(default, 0.0, source, unit or "")
    if not table.has(key) or not isinstance(table.peek(key), dict):
        value = table.number(key, low=low, above=above, high=_LARGEST, unit=unit or "", infinite=infinite)
        return Quantity(value, 0.0, source, unit or "")
    entry = table.table(key)
    quantity = Quantity(
        entry.number("value", low=low, above=above, high=_LARGEST, unit=unit or "", infinite=infinite),
        entry.number("sigma", 0.0, low=0.0, high=_LARGEST, unit=unit or ""),
        entry.choice("source", SOURCES, source),
        entry.text("unit") if unit is None else unit,
    )
    entry.finish()
    return quantity


def _vector3(table: Table, key: str) -> tuple[float, float, float]:
    x, y, z = table.vector(key, 3, limit=_FARTHEST_M, unit="m")
    return x, y, z


def _tensor(entries: Any) -> NDArray[np.float64]:
    ixx, ixy, ixz, iyy, iyz, izz = entries
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=np.float64)


def is_possible(tensor: NDArray[np.float64]) -> bool:
    """Whether a body can have this inertia (3, 3) about its mass centre: all principal moments positive, none above
    the sum of the other two."""
    principal = np.linalg.eigvalsh(tensor)
    return bool(principal[0] > 0.0 and principal[2] <= (principal[0] + principal[1]) * (1 + 1e-9))


def _body(table: Table, source: str, *, first: bool, last: bool) -> Body:
    """The first body, the base, may be without mass: a fixed one's plays no part."""
    name = table.text("name")
    mass = _quantity(table, "mass", "kg", source, low=0.0, above=-np.inf if first else 0.0)
    origin = _vector3(table, "origin_xyz")
    ixx, ixy, ixz, iyy, iyz, izz = (
        _quantity(table, key, "kg m^2", source, default=None if key[1] == key[2] else 0.0) for key in INERTIA_KEYS
    )
    if last and table.has("joint_xyz"):
        raise table.error("joint_xyz", "the last body carries no joint", "remove it")
    joint = None if last else _vector3(table, "joint_xyz")
    table.finish()
    body = Body(name, mass, origin, (ixx, ixy, ixz, iyy, iyz, izz), joint)
    if not is_possible(body.tensor) and (mass.value > 0.0 or body.tensor.any()):
        raise table.error(
            "ixx",
            f"no body has the principal moments {np.linalg.eigvalsh(body.tensor).tolist()} kg m^2",
            "correct the inertia: all positive, none above the sum of the other two",
        )
    return body


def read_joint_model(table: Table, source: str) -> JointModel:
    """One [[joint]] of a model file; values without a source have `source`. Errors: as `load_model`."""
    joint = JointModel(
        table.text("name"),
        _quantity(table, "rotor_mass", "kg", source, default=0.0, low=0.0),
        _quantity(table, "rotor_inertia", "kg m^2", source, above=0.0),
        _quantity(table, "stiffness", "Nm/rad", source, above=0.0, infinite=True),
        _quantity(table, "damping", "Nms/rad", source, low=0.0),
    )
    table.finish()
    return joint
