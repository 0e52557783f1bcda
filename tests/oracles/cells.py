# SPDX-License-Identifier: MIT
"""The cells of the trials: what is hidden, where, how large, and what may be said of it, stated before any run.

A size is a multiple of the detection limit that the product states for the true column on the nulls of the same arm
(`limits.json`, written by `python -m oracles.trials limits` from the ledger). Where it states none, a share of the
torques stands in its place.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from oracles import hidden as h
from oracles.arms import ARMS, Dirt, Plant, Trial, as_built
from oracles.hidden import Law, SensorError
from oracles.tree import Payload
from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect
from zygos.model.model import Model, Quantity

Group = Literal["null", "law", "pair", "outside", "without", "values", "structure", "change"]
LIMITS = Path(__file__).with_name("limits.json")
MULTIPLES = (3.0, 10.0, 30.0)
Make = Callable[[int, float], Law | SensorError]

TORQUE = {
    "planar": (14.9, 12.9),
    "coarse": (12.5, 23.2),
    "spatial": (0.56, 0.72, 0.38),
    "pendulum": (0.40, 0.095),
    "six": (25.6, 135.0, 50.0, 2.8, 0.47, 0.83),
}
"""Root mean square of the reported torques of run A, Nm."""
RATE = {"planar": 0.25, "coarse": 0.7, "spatial": 1.1, "pendulum": 1.9, "six": 1.2}
BEND = {"planar": 0.2, "coarse": 0.6, "spatial": 0.008}
"""Root mean square of the springs' deflections, rad."""
SHARE = {"planar": 1e-4, "coarse": 0.015, "spatial": 3e-4, "pendulum": 3e-3, "six": 3e-3}
"""Limit of a torque as a share of the joint's, where nothing better is known."""


@dataclass(frozen=True)
class Hidden:
    """One effect that a cell hides."""

    make: Make
    joint: int
    """From 0; -1: the base or its gyro."""
    times: float = 0.0
    """Multiple of the detection limit; 0: `size` counts."""
    size: float = 0.0

    @property
    def law(self) -> Law | SensorError:
        """With any size."""
        return self.make(self.joint, 1.0)


@dataclass(frozen=True)
class Cell:
    """What is hidden in an arm, and how the product is asked."""

    name: str
    arm: str
    group: Group
    hidden: tuple[Hidden, ...] = ()
    without: str = ""
    """Key of the catalogue that the product must do without."""
    near: tuple[str, ...] = ()
    """Keys that "part named" may state, beside those that the laws declare."""
    lacks: str = ""
    """What the simulation leaves out: flexibility or coupling."""
    momentum: float = 0.0
    changed: tuple[tuple[str, int, float], ...] = ()
    """Quantities of joints that were built otherwise: field, joint, factor."""
    payload: float = 0.0
    """Mass that the last body takes up in the middle of each run, as a share of its own."""
    draws: int = 1


def seed_of(cell: Cell, draw: int) -> int:
    """Seed of a plant: it depends on the cell's name alone, so that other cells change nothing."""
    return int.from_bytes(hashlib.sha256(f"{cell.name}:{draw}".encode()).digest()[:4], "big")


@cache
def _limits() -> dict[str, dict[str, float]]:
    return json.loads(LIMITS.read_text()) if LIMITS.is_file() else {}


def guessed(arm: str, key: str, joint: int) -> float:
    """A limit where the product states none."""
    i = max(joint, 0)
    share, torque, rate = SHARE[arm], TORQUE[arm][i], RATE[arm]
    trial = ARMS[arm]()
    n = trial.arm.gear_ratios[i]
    bend = BEND.get(arm, 1.0)
    scales = {
        "motor_coulomb": torque,
        "motor_stribeck": 2.0 * torque,
        "motor_viscous": torque / rate,
        "viscous_asymmetry": 2.0 * torque / rate,
        "torque_offset": torque,
        "ripple_sin": torque,
        "link_coulomb": n * torque,
        "link_viscous": n * torque / rate,
        "cubic_stiffness": n * torque / bend**3,
        "backlash": bend,
        "load_friction": 1.0,
        "torque_gain": 1.0,
        "torque_lag": 0.5,
        "link_scale": 0.5,
        "link_eccentricity_sin": 1.0,
        "link_late": 1.0,
        "motor_scale": 0.5,
        "motor_late": 1.0,
        "motor_zero": 1.0,
        "gyro_bias": 1.0,
        "gyro_scale": 1.0,
        "base_torque": 0.3 * n * torque,
        "base_leak": 0.5 * n * torque,
        "gravity_gradient_sin": 0.5 * n * torque,
        "gravity_gradient": 0.005 * n * torque,
    }
    return share * scales[key]


def limit(arm: str, dirty: bool, law: Law | SensorError, joint: int) -> float:
    """Detection limit of a true column on nulls of this arm."""
    column = law.key if joint < 0 else f"{law.key}{joint + 1}"
    stated = _limits().get(f"{arm}/{'dirty' if dirty else 'clean'}", {})
    # effects of the base of an arm in space act about z
    return stated.get(column, stated.get(column + "z", guessed(arm, law.key, joint)))


def is_dirty(cell: Cell, draw: int) -> bool:
    """Whether the torque sensors of this draw have noise, gains and offsets."""
    if cell.group == "null":
        return draw % 2 == 1
    if any(one.law.key in ERRORS_OF_TORQUE for one in cell.hidden):
        # the sensors' own errors are a hundred times as large, and what is hidden would be the sum of both
        return False
    return (seed_of(cell, 0) + draw) % 2 == 1


# The cells


def _forms(*pairs: tuple[str, Make, Make]) -> dict[str, tuple[Make, Make]]:
    return {name: (own, other) for name, own, other in pairs}


FRICTION = _forms(
    ("motor_coulomb", h.MotorCoulomb, h.TanhCoulomb),
    ("motor_coulomb_lugre", h.LuGre, h.LuGre),
    ("motor_viscous", h.MotorViscous, h.BentViscous),
    ("viscous_asymmetry", h.AsymmetricViscous, h.SmoothAsymmetry),
    ("motor_stribeck", h.Stribeck, h.StribeckLorentz),
    ("load_friction", h.LoadFriction, h.LoadFriction),
)
LINK = _forms(
    ("link_coulomb", h.LinkCoulomb, h.DahlLink),
    ("link_viscous", h.LinkViscous, h.BentLinkViscous),
    ("cubic_stiffness", h.Cubic, h.Hardening),
    ("backlash", h.Backlash, h.Backlash),
)
DRIVE = _forms(
    ("torque_lag", h.LowPass, h.LowPass),
    ("torque_offset", h.Offset, h.Offset),
    ("torque_gain", h.torque_gain, h.torque_gain),
    ("ripple", h.Ripple, h.Ripple),
)
SENSORS = _forms(
    ("link_scale", h.link_scale, h.link_scale),
    ("link_eccentricity", h.link_eccentricity, h.link_eccentricity),
    ("link_late", h.link_late, h.link_late),
    ("motor_scale", h.motor_scale, h.motor_scale),
    ("motor_late", h.motor_late, h.motor_late),
    ("motor_zero", h.motor_zero, h.motor_zero),
)
BASE = _forms(
    ("base_torque", h.BaseTorque, h.BaseTorque),
    ("base_leak", h.Leak, h.Leak),
    ("gravity_gradient", h.Gradient, h.Gradient),
    ("gyro_bias", h.gyro_bias, h.gyro_bias),
    ("gyro_scale", h.gyro_scale, h.gyro_scale),
)
# a friction that the torque's own offset hides is no cell on the ground, where every torque has an unknown offset
FEW = ("motor_coulomb", "link_viscous", "cubic_stiffness", "torque_lag")
COARSE = ("motor_coulomb", "motor_viscous", "link_coulomb", "cubic_stiffness")
ON: dict[str, dict[str, tuple[Make, Make]]] = {
    "planar": {**FRICTION, **LINK, **DRIVE, **SENSORS, **BASE},
    "spatial": {
        **{k: v for k, v in FRICTION.items() if k != "motor_coulomb_lugre"},
        **LINK,
        "torque_lag": DRIVE["torque_lag"],
        **SENSORS,
        **BASE,
        "gravity_gradient": (h.TidalField, h.TidalField),
    },
    "coarse": {
        **{k: v for k, v in {**FRICTION, **LINK}.items() if k in COARSE},
        "torque_lag": DRIVE["torque_lag"],
    },
    "pendulum": {**FRICTION, "torque_lag": DRIVE["torque_lag"], "ripple": DRIVE["ripple"]},
    "six": {k: v for k, v in FRICTION.items() if k != "motor_coulomb_lugre"},
}
ERRORS_OF_TORQUE = ("torque_offset", "torque_gain")
PLACES = {"planar": (0, 1), "coarse": (0, 1), "spatial": (0, 2), "pendulum": (0, 1), "six": (1, 4)}
SIZES: dict[str, tuple[float, ...]] = {
    "planar": MULTIPLES,
    "coarse": (10.0, 30.0),
    "spatial": (3.0, 30.0),
    "pendulum": MULTIPLES,
    "six": (3.0, 30.0),
}
NULLS = {"planar": 60, "coarse": 12, "spatial": 10, "pendulum": 48, "six": 20}

OUTSIDE: dict[str, tuple[tuple[str, Make, int, float], ...]] = {
    "planar": (
        ("rate_stiffness", h.RateStiffness, 1, 0.02),
        ("quadratic_drag", h.QuadraticDrag, 0, 0.8),
        ("posture_friction", h.PostureFriction, 1, 0.04),
        ("warming_friction", h.WarmingFriction, 1, 0.2),
        ("cross_damping", h.CrossDamping, 1, 4.0),
        ("cable_spring", h.CableSpring, 0, 2.0),
        ("base_detent", h.BaseDetent, 0, 1.0),
        ("base_drag", h.BaseDrag, 0, 20.0),
    ),
    "coarse": (("rate_stiffness", h.RateStiffness, 1, 0.2), ("base_detent", h.BaseDetent, 0, 400.0)),
    "spatial": (
        ("rate_stiffness", h.RateStiffness, 2, 0.02),
        ("quadratic_drag", h.QuadraticDrag, 0, 0.005),
        ("posture_friction", h.PostureFriction, 2, 0.006),
        ("cross_damping", h.CrossDamping, 1, 0.6),
    ),
    "pendulum": (
        ("quadratic_drag", h.QuadraticDrag, 0, 0.006),
        ("concave_friction", h.ConcaveFriction, 0, 0.02),
        ("posture_friction", h.PostureFriction, 1, 0.008),
        ("warming_friction", h.WarmingFriction, 0, 0.02),
        ("cross_damping", h.CrossDamping, 1, 0.02),
        ("cable_spring", h.HardCable, 0, 0.15),
    ),
    "six": (
        ("concave_friction", h.ConcaveFriction, 4, 0.05),
        ("posture_friction", h.PostureFriction, 1, 8.0),
        ("warming_friction", h.WarmingFriction, 4, 0.05),
        ("cross_damping", h.CrossDamping, 2, 3.0),
        ("cable_spring", h.HardCable, 4, 0.05),
    ),
}
"""Laws that no catalogue has: name, law, joint and size."""

NEAREST = {
    "motor_coulomb": (
        "motor_viscous",
        "motor_stribeck",
        "link_coulomb",
        "link_stribeck",
        "load_friction",
        "torque_lag",
    ),
    "motor_viscous": ("motor_coulomb", "link_viscous", "torque_lag", "viscous_asymmetry"),
    "link_coulomb": ("motor_coulomb", "link_viscous", "motor_stribeck", "link_stribeck"),
    "link_viscous": ("motor_viscous", "link_coulomb"),
    "cubic_stiffness": ("backlash",),
    "backlash": ("cubic_stiffness", "motor_coulomb", "link_coulomb"),
    "torque_lag": ("motor_viscous",),
    "viscous_asymmetry": ("torque_offset", "motor_viscous"),
    "motor_stribeck": ("motor_coulomb", "link_coulomb", "link_stribeck"),
    "load_friction": ("motor_coulomb",),
}
"""What a law that was left out of the catalogue looks like: keys that "part named" may state."""
PAIRS: dict[str, tuple[tuple[tuple[Make, int], tuple[Make, int]], ...]] = {
    "planar": (
        ((h.TanhCoulomb, 0), (h.TanhCoulomb, 1)),
        ((h.TanhCoulomb, 1), (h.MotorViscous, 1)),
        ((h.DahlLink, 0), (h.Hardening, 1)),
        ((h.LowPass, 0), (h.BentViscous, 1)),
    ),
    "coarse": (),
    "spatial": (((h.TanhCoulomb, 0), (h.LinkViscous, 2)),),
    "pendulum": (((h.TanhCoulomb, 0), (h.TanhCoulomb, 1)), ((h.MotorCoulomb, 0), (h.AsymmetricViscous, 0))),
    "six": (((h.TanhCoulomb, 1), (h.BentViscous, 4)),),
}


def _of_arm(arm: str) -> list[Cell]:
    trial = ARMS[arm]()
    joints = [joint.name for joint in trial.arm.joints]
    cells = [Cell(f"{arm}/null", arm, "null", draws=NULLS[arm])]
    for name, (own, other) in ON[arm].items():
        at_base = name in BASE
        for place in (-1,) if at_base else PLACES[arm]:
            where = "base" if at_base else joints[place]
            for k, times in enumerate(SIZES[arm]):
                if arm == "spatial" and not at_base and place != PLACES[arm][k]:
                    # a minute a verdict: each size at one place
                    continue
                if arm == "planar" and not at_base and times == 10.0 and place != PLACES[arm][len(name) % 2]:
                    # the middle size at one place
                    continue
                if name == "torque_gain" and place == 0:
                    # gains are those against the first joint
                    continue
                make = own if k == 1 else other
                cells.append(Cell(f"{arm}/{name}/{where}/x{times:g}", arm, "law", (Hidden(make, place, times),)))
    for first, second in PAIRS[arm]:
        pair = tuple(Hidden(make, place, 30.0) for make, place in (first, second))
        name = "+".join(f"{make.__name__}@{joints[place]}" for make, place in (first, second))
        cells.append(Cell(f"{arm}/pair/{name}", arm, "pair", pair))
    for name, make, place, size in OUTSIDE[arm]:
        cells.append(Cell(f"{arm}/outside/{name}/{joints[place]}", arm, "outside", (Hidden(make, place, size=size),)))
    for key, (own, _) in ON[arm].items():
        if key in NEAREST and arm != "coarse" and (arm != "spatial" or key in FEW):
            place = PLACES[arm][-1]
            cells.append(
                Cell(
                    f"{arm}/without/{key}/{joints[place]}",
                    arm,
                    "without",
                    (Hidden(own, place, 30.0),),
                    without=key,
                    near=NEAREST[key],
                )
            )
    return cells


def _others() -> list[Cell]:
    return [
        *(Cell(f"{arm}/payload", arm, "change", payload=0.1) for arm in ARMS if arm != "coarse"),
        Cell("planar/lacks/flexibility", "planar", "structure", lacks="flexibility"),
        Cell("planar/lacks/coupling", "planar", "structure", lacks="coupling"),
        Cell("planar/momentum", "planar", "structure", momentum=50.0),
        Cell("coarse/momentum", "coarse", "structure", momentum=500.0),
        Cell("coarse/values", "coarse", "values", changed=(("stiffness", 0, 0.8), ("rotor_inertia", 1, 1.1))),
        Cell("planar/values", "planar", "values", changed=(("stiffness", 0, 0.8), ("rotor_inertia", 1, 1.1))),
        Cell("spatial/values", "spatial", "values", changed=(("stiffness", 2, 0.8), ("rotor_inertia", 1, 1.3))),
    ]


@cache
def cells() -> tuple[Cell, ...]:
    """All cells, in the order in which they are tried: a campaign that is cut short has some of every kind."""
    listed = [cell for arm in ARMS for cell in _of_arm(arm)]
    return (*listed, *_others())


def cell_named(name: str) -> Cell:
    """The cell of that name."""
    return next(cell for cell in cells() if cell.name == name)


# From a cell to a plant


@dataclass(frozen=True)
class Case:
    """A cell with a seed: the plant, and what the analyst has."""

    cell: Cell
    draw: int
    seed: int
    plant: Plant
    arm: Arm
    """As its file says."""
    simulation: Model
    dirty: bool


def case(cell: Cell, draw: int) -> Case:
    """The plant of a cell and draw, and what the product is given beside its runs."""
    seed, dirty = seed_of(cell, draw), is_dirty(cell, draw)
    trial = ARMS[cell.arm]()
    random = np.random.default_rng([seed, 4711])
    sizes = [
        one.size if not one.times else one.times * limit(cell.arm, dirty, one.law, one.joint) for one in cell.hidden
    ]
    made = [one.make(max(one.joint, 0), size) for one, size in zip(cell.hidden, sizes, strict=True)]
    made = [replace(one, nadir=trial.arm.nadir) if isinstance(one, h.TidalField) else one for one in made]
    # the same share of bend on slow and fast arms
    made = [replace(one, bend=20.0 * RATE[cell.arm]) if isinstance(one, h.BentViscous) else one for one in made]
    model = as_built(trial, seed)
    if cell.group == "values":
        model = replace(trial.drawn, effects=())
    for field, joint, factor in cell.changed:
        joints = list(model.joints)
        quantity: Quantity = getattr(joints[joint], field)
        joints[joint] = replace(joints[joint], **{field: replace(quantity, value=factor * quantity.value)})
        model = replace(model, joints=tuple(joints))
    dirt = _dirt(trial, random) if dirty else None
    arm = trial.arm
    if dirt is not None and draw % 4 == 3:
        # of some plants the noise is declared
        noise = dirt.noise * np.array(TORQUE[cell.arm])
        arm = replace(
            arm, joints=tuple(replace(j, torque_sigma=float(s)) for j, s in zip(arm.joints, noise, strict=True))
        )
    payload = None
    if cell.payload:
        last = trial.drawn.bodies[-1]
        end = tuple(2.0 * x for x in last.origin_xyz)
        middle = 0.5 * trial.scenarios[0].duration_s
        payload = Payload(cell.payload * last.mass.value, middle, end)  # type: ignore[arg-type]
    plant = Plant(
        trial,
        model,
        tuple(one for one in made if isinstance(one, Law)),
        tuple(one for one in made if isinstance(one, SensorError)),
        payload=payload,
        momentum=cell.momentum or None,
        dirt=dirt,
    )
    return Case(cell, draw, seed, plant, arm, _simulation(cell, trial), dirty)


def _dirt(trial: Trial, random: np.random.Generator) -> Dirt:
    n = trial.arm.n
    gain = random.uniform(0.01, 0.02, n) * random.choice([-1.0, 1.0], n)
    gain[0] = 0.0
    return Dirt(random.uniform(0.001, 0.005, n), gain, random.uniform(-0.03, 0.03, n))


def _simulation(cell: Cell, trial: Trial) -> Model:
    drawn = trial.drawn
    if cell.lacks == "flexibility":
        rigid = [replace(j, stiffness=Quantity(np.inf), damping=Quantity(0.0)) for j in drawn.joints]
        return replace(drawn, joints=tuple(rigid))
    if cell.lacks == "coupling":
        kinds = CATALOGUE["rotor_coupling"]
        armature = tuple(Effect(kinds, joint.name, 0.0) for joint in trial.arm.joints)
        return replace(drawn, effects=(*drawn.effects, *armature))
    return drawn


def wanted(words: Sequence[str]) -> list[Cell]:
    """The cells whose name contains one of the words; all without a word."""
    return [cell for cell in cells() if not words or any(word in cell.name for word in words)]
