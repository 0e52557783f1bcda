# SPDX-License-Identifier: MIT
"""The assumed physical parameters of an arm: masses, lengths, inertias, stiffness (`model.toml`).

A model is given either by its bodies and joints, or by base parameters (docs/theory.md). Both give `base_parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.linalg import block_diag

from zygos.arm import OF_CURRENTS, Arm
from zygos.effects import CATALOGUE, Effect
from zygos.effects.kind import Kind
from zygos.errors import ZygosError
from zygos.files.output import write_text
from zygos.files.toml import Table
from zygos.model import gram
from zygos.model.correlation import Correlation, read_correlation

SOURCES = ("CAD", "test", "zygos")
_LARGEST = 1e12
"""Largest accepted mass, inertia, stiffness, damping or sigma, in SI units. A space station has about 1e9 kg m^2."""
_FARTHEST_M = 1e6
_SAME_PLACE_M = 1e-6
"""Largest difference between a joint's place in a model and in the arm file, m."""
INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_SOURCE_MEANING = "Where the value comes from."
_SOURCE_OTHERWISE = "source of the file"
_JOINT_UNITS = {"rotor_mass": "kg", "rotor_inertia": "kg m^2", "stiffness": "Nm/rad", "damping": "Nms/rad"}


@dataclass(frozen=True)
class Quantity:
    """A value with its standard deviation (0: assumed exact), its source, and its unit."""

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
    """The drive of one joint: its rotor, which is mounted on the carrying body, and its flexibility."""

    name: str
    rotor_mass: Quantity
    """Mass in kg, located at the joint."""
    rotor_inertia: Quantity
    """Inertia about the joint axis before the gear, kg m^2; the carrying body's inertia includes it as well."""
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
    correlation: Correlation | None = None
    """Of the values that were estimated together; None: their errors are independent."""

    @property
    def relative(self) -> bool:
        """Whether the values were learned from motor currents, and are in proportion to an unknown torque constant."""
        return any(one.unit in OF_CURRENTS.values() for one in self.parameters.values())

    def base_parameters(self, arm: Arm) -> dict[str, Quantity]:
        """Base parameters by name, in the order of `arm.parameter_names`.

        Sigmas of a model given by bodies are propagated to first order. Errors: ZygosError if the model does not fit
        the arm: different joints, missing or unknown parameters, b_ij for a planar-symmetric arm.
        """
        names = arm.parameter_names
        if not self.bodies:
            return self._named_parameters(arm)
        self.check_fits(arm)
        values = self.unchecked_values(arm)
        sigmas = np.sqrt(np.diag(self.base_covariance(arm)))
        quantities = self._quantities()
        inertial = quantities[: 7 * len(self.bodies)] + [joint.rotor_inertia for joint in self.joints]
        found = {quantity.source for quantity in inertial}
        # a mixture is only as certain as its least certain part
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
        if self.bodies:
            self.check_fits(arm)
            return self.unchecked_values(arm)
        return np.array([quantity.value for quantity in self.base_parameters(arm).values()])

    def unchecked_values(self, arm: Arm) -> NDArray[np.float64]:
        """The same of a model given by bodies, whether it fits the arm or not: mass centres may lie off the line of a
        planar-symmetric arm, and joints elsewhere than in the arm file."""
        return _grouped(arm, self._candidates(arm, self._scalars()))

    def base_covariance(self, arm: Arm) -> NDArray[np.float64]:
        """(p, p) covariance of the base parameters.

        For a model given by bodies it carries the correlations that masses and inertias impose; independent variances
        of the a_ij would allow negative kinetic energy (docs/theory.md). Geometry is taken as exact.
        """
        if not self.bodies:
            sigma = np.array([quantity.sigma for quantity in self._named_parameters(arm).values()])
            return self._correlated(arm.parameter_names, sigma)
        self.check_fits(arm)
        # an infinite stiffness is exact; any finite number may stand in its place here
        scalars = np.nan_to_num(self._scalars(), posinf=1.0)
        sigmas = np.array([quantity.sigma for quantity in self._quantities()])
        columns = np.zeros((len(arm.parameter_names), len(scalars)))
        for index in np.flatnonzero(sigmas):
            # central difference; the step is large compared with rounding errors, and the third derivative is
            # negligible
            step = 1e-4 * max(abs(scalars[index]), 1e-3)
            shift = np.zeros_like(scalars)
            shift[index] = step
            above, below = (_grouped(arm, self._candidates(arm, moved)) for moved in (scalars + shift, scalars - shift))
            columns[:, index] = (above - below) / (2 * step)
        scaled = columns * sigmas
        covariance: NDArray[np.float64] = scaled @ scaled.T
        return covariance

    def covariance(self, arm: Arm) -> NDArray[np.float64]:
        """(p + e, p + e) covariance of the base parameters and the values of the effects, in their order."""
        base, sigma = self.base_covariance(arm), np.array([effect.sigma for effect in self.effects])
        if self.bodies:
            return block_diag(base, np.diag(sigma**2)) if len(sigma) else base
        names = [*arm.parameter_names, *(effect.column(arm) for effect in self.effects)]
        return self._correlated(names, np.concatenate([np.sqrt(np.diag(base)), sigma]))

    def _correlated(self, names: Sequence[str], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, m) covariance of values (m,) with these names."""
        matrix = np.eye(len(names)) if self.correlation is None else self.correlation.matrix(names)
        return matrix * np.outer(sigma, sigma)

    def _named_parameters(self, arm: Arm) -> dict[str, Quantity]:
        if self.relative and arm.torque_unit != "A":
            raise ZygosError(
                f"model {self.name} was learned from motor currents with unknown torque constants, but the torques of "
                f"arm {arm.name} are in {arm.torque_unit}; remedy: give the arm file with which it was learned, or "
                "learn it again from torques"
            )
        missing = [name for name in arm.parameter_names if name not in self.parameters]
        unknown = [name for name in self.parameters if name not in arm.parameter_names]
        if missing or unknown:
            raise ZygosError(
                f"model {self.name} does not fit arm {arm.name}: missing {missing}, unknown {unknown}; "
                f"remedy: [parameters] must hold exactly {', '.join(arm.parameter_names)}"
            )
        return {name: self.parameters[name] for name in arm.parameter_names}

    def check_fits(self, arm: Arm) -> None:
        """Raise ZygosError if the joints of this model by bodies are not those of the arm, or its bodies do not lie as
        the arm file says."""
        names = [joint.name for joint in arm.joints]
        if [joint.name for joint in self.joints] != names:
            raise ZygosError(
                f"model {self.name} has joints {[joint.name for joint in self.joints]}, arm {arm.name} "
                f"has {names}; remedy: use the same joint names, in order from the base outwards"
            )
        if arm.free and self.bodies[0].mass.value == 0.0:
            raise ZygosError(
                f"model {self.name}: the base {self.bodies[0].name} has no mass, but it floats in arm {arm.name}; "
                'remedy: give it mass and inertia, or write base = "fixed" in the arm file'
            )
        for body, theirs in zip(self.bodies[:-1], arm.joints, strict=True):
            if theirs.position_m is None or body.joint_xyz is None or (theirs is arm.joints[0] and not arm.free):
                continue  # where a fixed base carries the arm has no effect
            if np.max(np.abs(np.subtract(body.joint_xyz, theirs.position_m))) > _SAME_PLACE_M:
                raise ZygosError(
                    f"model {self.name}: body {body.name} carries joint {theirs.name} at {list(body.joint_xyz)} m, arm "
                    f"{arm.name} has it at {list(theirs.position_m)} m; remedy: correct joint_xyz in the model or "
                    "position_m in the arm file"
                )
        if arm.kinetic == "planar-symmetric":
            values, skew = self._planar(arm, *self._moments(arm, self._scalars()))
            if np.max(np.abs(skew), initial=0.0) > 1e-9 * np.max(np.abs(values)):
                raise ZygosError(
                    f"model {self.name}: mass centres lie off the joint-to-joint lines (b_ij = {skew.tolist()}), but "
                    f'arm {arm.name} says kinetic = "planar-symmetric"; remedy: write kinetic = "planar"'
                )
        for ours, theirs in zip(self.joints, arm.joints, strict=True):
            if not theirs.flexible and np.isfinite(ours.stiffness.value):
                raise ZygosError(
                    f"model {self.name}: joint {ours.name} has a stiffness, but in arm {arm.name} it is rigid; remedy: "
                    "write stiffness = inf in the model, or flexible = true in the arm file"
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

    def first_moments(self, arm: Arm) -> NDArray[np.float64]:
        """(2N,) first moments u and v of the body after each joint of an arm on a fixed base, kg m, of a model given by
        bodies, whether gravity moves them or not. Errors: as `check_fits`."""
        self.check_fits(arm)
        moments = gram.of_bodies(arm, *self._moments(arm, self._scalars()))[1]
        return np.asarray(moments[-2 * arm.n :], dtype=np.float64)

    def candidate_values(self, arm: Arm) -> NDArray[np.float64]:
        """(c,) values of `arm.structure.candidates` of a model given by bodies, SI units. Errors: as `check_fits`."""
        self.check_fits(arm)
        return self._candidates(arm, self._scalars())

    def _candidates(self, arm: Arm, scalars: NDArray[np.float64]) -> NDArray[np.float64]:
        """(c,) from the scalars in the order of `_quantities` (docs/theory.md, "From bodies …")."""
        mass, first, second, reach = self._moments(arm, scalars)
        drive = scalars[7 * len(mass) :].reshape(len(mass) - 1, 4)
        own = {"Im": drive[:, 1], "k": drive[:, 2], "b": drive[:, 3]}
        if not arm.structure.candidates_are_full:
            tensor = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
            table = np.column_stack([mass, first, tensor[:, *np.triu_indices(3)]])
            return np.concatenate([np.ravel(table[1:]), _of_joints(arm, own)])
        if arm.spatial:
            matrix, moments = gram.of_bodies(arm, mass, first, second, reach)
            kinetic = gram.to_parameters(arm, matrix)
        else:
            symmetric, skew = self._planar(arm, mass, first, second, reach)
            kinetic = symmetric if arm.kinetic == "planar-symmetric" else np.concatenate([symmetric, skew])
            moments = gram.of_bodies(arm, mass, first, second, reach)[1]
        heavy = np.repeat(np.array(arm.feels_gravity), 2)
        if not arm.free and not arm.joints[0].flexible and arm.torque_at == "rotor":
            kinetic[0] += arm.joints[0].gear_ratio ** 2 * drive[0, 1]
        return np.concatenate([kinetic, moments[-len(heavy) :][heavy], _of_joints(arm, own)])

    def _moments(
        self, arm: Arm, scalars: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mass, first and second moments and reach of the bodies with the rotors that they carry, as
        `gram.of_bodies` has them."""
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
        return mass, first, second, reach

    def _planar(
        self,
        arm: Arm,
        mass: NDArray[np.float64],
        first: NDArray[np.float64],
        second: NDArray[np.float64],
        reach: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """a_ij and b_ij of bodies given as in `gram.of_bodies`."""
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
        return np.array(values), np.array(skew)


def _of_joints(arm: Arm, joints: Mapping[str, NDArray[np.float64]]) -> list[float]:
    """Those of `arm.structure.candidates` that joints have, from the values (N,) of each symbol."""
    return [float(joints[one.symbol][one.joint]) for one in arm.structure.candidates if one.joint is not None]


def _grouped(arm: Arm, candidates: NDArray[np.float64]) -> NDArray[np.float64]:
    """The independent parameters (p,) of candidates (c,)."""
    structure = arm.structure
    if not structure.reduces:
        return candidates
    # an infinite stiffness has no part in other parameters
    found: NDArray[np.float64] = structure.groups @ np.where(np.isfinite(candidates), candidates, 0.0)
    of_candidate = {one.name: value for one, value in zip(structure.candidates, candidates.tolist(), strict=True)}
    for k, one in enumerate(structure.parameters):
        if one.symbol == "k":
            found[k] = of_candidate[one.name]
    return found


def load_model(path: str | Path) -> Model:
    """Read `model.toml`. Errors: ZygosError naming file, key and remedy, also for a physically impossible body."""
    return read_model(Table.load(path, "a model"))


def read_model(top: Table) -> Model:
    """The model of a table with the keys of `model.toml`. Errors: as `load_model`."""
    name = top.text("name", "Name of the model, for messages.")
    source = top.choice("source", "Where the values come from that state no source of their own.", SOURCES, "CAD")
    if top.has("parameters"):
        if top.has("body") or top.has("joint"):
            raise top.error("parameters", "is given together with [[body]] or [[joint]]", "keep one of the two")
        table = top.table(
            "parameters",
            "The base parameters by their names (docs/theory.md). A model has either this table, or [[body]] and "
            "[[joint]].",
            otherwise="required where [[body]] is absent, refused beside it",
        )
        parameters = {
            key: _quantity(
                table,
                key,
                "A base parameter, as `zygos estimate` names it.",
                None,
                source,
                infinite=key.startswith("k"),
            )
            for key in table.names()
        }
        effects = _effects(top, source, relative=Model("", parameters=parameters).relative)
        correlation = None
        if top.has("correlation"):
            correlation = read_correlation(
                top.table(
                    "correlation",
                    "Correlations between the errors of the values, as `zygos estimate` writes them for arms on the "
                    "ground: one key for each value, with its correlations with those before it.",
                    optional=True,
                )
            )
        top.finish()
        return Model(name, parameters=parameters, effects=effects, correlation=correlation)
    tables = top.tables(
        "body",
        "The bodies from the base to the last link, each without the rotor that it carries.",
        otherwise="required where [parameters] is absent, refused beside it",
    )
    bodies = tuple(
        _body(table, source, first=index == 0, last=index == len(tables) - 1) for index, table in enumerate(tables)
    )
    joints = tuple(
        read_joint_model(table, source)
        for table in top.tables(
            "joint",
            "The joints' drives, in the order of the joints.",
            otherwise="required where [parameters] is absent, refused beside it",
        )
    )
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
    """Write `model.toml` so that a reader sees either the old file or the complete new one. Errors: ZygosError if it
    cannot be written."""
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
        document["effect"] = _entries(model.effects, model.relative)
    if model.correlation is not None:
        document["correlation"] = model.correlation.table()
    write_text(Path(path), tomlkit.dumps(document))


def _entries(effects: Sequence[Effect], relative: bool) -> tomlkit.items.AoT:
    entries = tomlkit.aot()
    for effect in effects:
        entry = tomlkit.table()
        entry["kind"] = effect.kind.key
        if effect.joint is not None:
            entry["joint"] = effect.joint
        if effect.component:
            entry["component"] = effect.component
        entry["value"] = effect.value
        entry["sigma"] = effect.sigma
        entry["unit"] = _unit_of(effect.kind, relative)
        if effect.shape is not None:
            entry["shape"] = effect.shape
            if effect.kind.shape_unit:
                entry["shape_unit"] = effect.kind.shape_unit
        entry["source"] = effect.source
        if effect.evidence:
            entry["evidence"] = effect.evidence
        entries.append(entry)
    return entries


def _unit_of(kind: Kind, relative: bool) -> str:
    """The unit of an effect's value; relative: of a model that was learned from motor currents."""
    return OF_CURRENTS.get(kind.unit, kind.unit) if relative else kind.unit


def _effects(top: Table, source: str, *, relative: bool = False) -> tuple[Effect, ...]:
    effects: list[Effect] = []
    for table in top.tables("effect", "Effects beyond rigid bodies and linear springs (docs/gap.md).", optional=True):
        key = table.choice("kind", "The effect.", tuple(CATALOGUE))
        kind = CATALOGUE[key]
        effect = Effect(
            kind,
            _at(table) if kind.at_joint else None,
            table.number(
                "value",
                "Coefficient of the effect.",
                low=0.0 if kind.positive else -_LARGEST,
                high=_LARGEST,
                unit=kind.unit,
            ),
            table.number(
                "sigma", "Standard deviation of the value. 0: exact.", 0.0, low=0.0, high=_LARGEST, unit=kind.unit
            ),
            table.choice("source", _SOURCE_MEANING, SOURCES, source, otherwise=_SOURCE_OTHERWISE),
            table.text("evidence", "Why the effect is in the model, in words.", otherwise="none")
            if table.has("evidence")
            else "",
            table.number(
                "shape",
                "Shape parameter of the effect's law, in the unit that its kind has for it.",
                low=-_LARGEST,
                high=_LARGEST,
                otherwise="required where the law of the kind has one",
            )
            if kind.shapes or table.has("shape")
            else None,
            table.text(
                "component",
                "Which component of the effect, where it has several: x, y or z of base axes, or a base parameter.",
                otherwise="none",
            )
            if table.has("component")
            else "",
        )
        if table.has("shape") and not kind.shapes:
            raise table.error("shape", f"{key} has no shape", "remove the key")
        if table.has("shape_unit"):
            unit = table.text("shape_unit", "The unit of the shape.", otherwise="that of the kind")
            if unit != kind.shape_unit:
                raise table.error(
                    "shape_unit", f"{unit!r} is not the unit of the shape of {key}", f'"{kind.shape_unit}"'
                )
        of_kind = _unit_of(kind, relative)
        if table.has("unit") and (unit := _unit(table, "the unit of the kind")) != of_kind:
            raise table.error("unit", f"{unit!r} is not the unit of {key}", f'convert the value to "{of_kind}"')
        table.finish()
        place = (effect.kind, effect.joint, effect.component)
        if any((other.kind, other.joint, other.component) == place for other in effects):
            raise table.error("kind", f"{key} at {effect.joint or 'the base'} appears twice", "keep one of the entries")
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
    meaning: str,
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
    otherwise = "" if default is None else f"{default:g}"
    if not table.has(key) or not isinstance(table.peek(key), dict):
        value = table.number(
            key, meaning, low=low, above=above, high=_LARGEST, unit=unit or "", infinite=infinite, otherwise=otherwise
        )
        return Quantity(value, 0.0, source, unit or "")
    entry = table.table(key, meaning, otherwise=otherwise)
    quantity = Quantity(
        entry.number("value", "The value.", low=low, above=above, high=_LARGEST, unit=unit or "", infinite=infinite),
        entry.number(
            "sigma", "Standard deviation of the value. 0: exact.", 0.0, low=0.0, high=_LARGEST, unit=unit or ""
        ),
        entry.choice("source", _SOURCE_MEANING, SOURCES, source, otherwise=_SOURCE_OTHERWISE),
        _unit(entry) if unit is None else unit,
    )
    entry.finish()
    return quantity


def _vector3(table: Table, key: str, meaning: str, otherwise: str = "") -> tuple[float, float, float]:
    x, y, z = table.vector(key, meaning, 3, limit=_FARTHEST_M, unit="m", otherwise=otherwise)
    return x, y, z


def _at(table: Table) -> str:
    return table.text(
        "joint", "Name of the joint at which the effect acts.", otherwise="required, except for effects of the base"
    )


def _unit(table: Table, otherwise: str = "") -> str:
    return table.text("unit", "Unit of value and sigma.", otherwise=otherwise)


def _tensor(entries: Any) -> NDArray[np.float64]:
    ixx, ixy, ixz, iyy, iyz, izz = entries
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=np.float64)


def is_possible(tensor: NDArray[np.float64]) -> bool:
    """Whether a body can have this inertia (3, 3) about its mass centre: all principal moments positive, none above
    the sum of the other two."""
    principal = np.linalg.eigvalsh(tensor)
    return bool(principal[0] > 0.0 and principal[2] <= (principal[0] + principal[1]) * (1 + 1e-9))


def _body(table: Table, source: str, *, first: bool, last: bool) -> Body:
    """Read a body. The first one, the base, may have no mass: that of a fixed base has no effect."""
    name = table.text("name", "Name of the body.")
    mass = _quantity(
        table,
        "mass",
        "Mass of the body. Only the base may have none.",
        "kg",
        source,
        low=0.0,
        above=-np.inf if first else 0.0,
    )
    origin = _vector3(
        table, "origin_xyz", "Mass centre in the frame of the body, whose origin is the joint that carries it."
    )
    ixx, ixy, ixz, iyy, iyz, izz = (
        _quantity(
            table,
            key,
            "Entry of the inertia about the mass centre, in the axes of the body.",
            "kg m^2",
            source,
            default=None if key[1] == key[2] else 0.0,
        )
        for key in INERTIA_KEYS
    )
    if last and table.has("joint_xyz"):
        raise table.error("joint_xyz", "the last body carries no joint", "remove it")
    joint = None
    if not last:
        joint = _vector3(
            table,
            "joint_xyz",
            "Origin of the joint that carries the next body, in the frame of this body.",
            "required, except for the last body, where it is refused",
        )

    table.finish()
    body = Body(name, mass, origin, (ixx, ixy, ixz, iyy, iyz, izz), joint)
    if not is_possible(body.tensor) and (mass.value > 0.0 or body.tensor.any()):
        raise table.error(
            "ixx",
            f"no body can have the principal moments {np.linalg.eigvalsh(body.tensor).tolist()} kg m^2",
            "correct the inertia: all must be positive, and none larger than the sum of the other two",
        )
    return body


def read_joint_model(table: Table, source: str) -> JointModel:
    """Read one [[joint]] of a model file; values without a source get `source`. Errors: as `load_model`."""
    joint = JointModel(
        table.text("name", "Name of the joint."),
        _quantity(
            table,
            "rotor_mass",
            "Mass of the rotor, which the body before the joint carries.",
            "kg",
            source,
            default=0.0,
            low=0.0,
        ),
        _quantity(
            table,
            "rotor_inertia",
            "Inertia of the rotor about its axis, before the gear. 0: that of a rigid joint is not known apart from "
            "the link's.",
            "kg m^2",
            source,
            low=0.0,
        ),
        _quantity(
            table,
            "stiffness",
            "Stiffness of the joint's spring, after the gear. inf: the joint is rigid.",
            "Nm/rad",
            source,
            above=0.0,
            infinite=True,
        ),
        _quantity(table, "damping", "Damping of the joint's spring, after the gear.", "Nms/rad", source, low=0.0),
    )
    table.finish()
    if joint.rotor_inertia.value == 0.0 and math.isfinite(joint.stiffness.value):
        raise table.error(
            "rotor_inertia",
            "is 0, but the rotor of a flexible joint moves by itself",
            "give its inertia, or stiffness = inf for a rigid joint",
        )
    return joint
