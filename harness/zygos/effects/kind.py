# SPDX-License-Identifier: MIT
"""What an entry of the catalogue states of its effect: its site, its law, and the names it has in files and sentences.

At each site the coefficient c of a law f acts in the same way for every law:

    motor    rotor torque -c f                        before the gear
    link     torque -c f on the link                  after the gear
    load     rotor torque -c f / n; f grows with the torque through the gear, after it
    spring   torque +c f on the link, -c f / n on the rotor
    torque   the motor's torque exceeds the reported one by c f
    base     torque +c f on the base, in base axes
    field    force c (r r' - 1/3) x on each kg of the arm at x from its mass centre, r = `Arm.nadir`
    body     a base parameter is larger by c from an instant on
    sensor   a sensor reads what `Kind.transform` makes of the exact reading
    rotor    share of the rotor's inertia that the carrying body's rotation acts on

All angles are after the gear.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects.memory import Memory
from zygos.effects.motion import Motion
from zygos.errors import ZygosError

Array = NDArray[np.float64]
Place = Literal["motor", "link", "spring", "torque", "rotor", "base", "field", "load", "sensor", "body"]
PLACES: tuple[Place, ...] = get_args(Place)
REMEMBERING: tuple[Place, ...] = ("motor", "link", "spring", "base")
"""Sites at which a law may have a memory."""

SLOWEST_RATE = 1e-3
"""Rate below which Coulomb friction fades linearly to zero, rad/s after the gear: a sign function cannot be integrated,
and a noisy rate does not show its sign."""


class Sensed(Protocol):
    """What `zygos.balances.readings.Readings` has."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def q(self) -> Array:
        """(..., n, N) link angles, rad."""

    @property
    def theta(self) -> Array:
        """(..., n, N) motor angles after the gear, rad."""

    @property
    def omega0(self) -> Array:
        """(..., n) or (..., n, 3) base rate, rad/s."""


R = TypeVar("R", bound=Sensed)


@dataclass(frozen=True)
class Held:
    """How the file of another simulator can hold an effect."""

    how: Literal["exact", "approximate", "snippet", "no"]
    """snippet: not in the file, but by lines in the loop that controls the simulation. no: it is no part of a robot."""
    by: str = ""
    """With what, in Markdown."""

    @property
    def holds(self) -> bool:
        """Whether the file itself has it."""
        return self.how in ("exact", "approximate")


BY_LOOP = Held("snippet")
NOT_HELD = Held("no")


@dataclass(frozen=True)
class Kind:
    """One entry of the catalogue. Errors: ZygosError for an unknown site, and for an entry without a law."""

    key: str
    """Name of the effect in files; followed by the joint's number it is the name of the column."""
    title: str
    """Name of the effect in sentences."""
    unit: str
    place: Place
    law: Callable[[Motion, float], Array] | None = None
    """f(motion, shape): torque per unit coefficient. None: a lag, a rotor's coupling, an angular momentum, a force
    on all bodies, a body, a sensor."""
    potential: Callable[[Array, float], Array] | None = None
    """Integral of f over the deflection (spring) or over the motor's angle before the gear (torque), where that alone
    determines f; arguments as of a law."""
    impulse: Callable[[Array], Array] | None = None
    """Integral of f over time per unit coefficient as a function of the angle (motor; rad), where the angle alone
    determines it."""
    viscous: bool = False
    """Whether f is proportional to a rate. Its power is then a square, in which noise leaves a mean value."""
    positive: bool = True
    """Whether the coefficient must not be negative: a negative one would create energy, so the model would be wrong."""
    twins: tuple[str, ...] = ()
    """Keys of the effects that look the same as this one in some motions."""
    becomes: str = ""
    """Key of the effect without a shape that this one is at an end of its shapes; empty: none."""
    searched: bool = True
    """Whether `zygos explain` tries this effect on an arm that floats or has a flexible joint."""
    searched_last: bool = False
    """Whether it tries this effect where those that are `searched` leave something over."""
    searched_on_ground: bool = False
    """Whether it tries this effect on an arm on the ground with rigid joints."""
    flies: bool = False
    """Whether the flight library accounts for it."""
    shapes: tuple[float, ...] = ()
    """Values of the law's shape parameter among which a search begins; empty: it has none."""
    shape_title: str = ""
    shape_unit: str = ""
    memory: Memory | None = None
    """The internal states of a law whose torque depends on the motion before."""
    axes: bool = False
    """Whether it has one component along each base axis on an arm that moves in space."""
    world: Literal["", "plane", "space"] = ""
    """Whether only arms that move in a plane, or in space, can have it."""
    gain: bool = False
    """Whether f is the reported torque, so that the noise of the torque is noise of the column."""
    sensor: Literal["", "link", "motor", "gyro"] = ""
    """The sensor whose reading changes, where the site is a sensor."""
    reads: Callable[[Arm, Array, float, int], Array] | None = None
    """reads(arm, signal, amount, number): what a sensor reads of a signal at n cycles: (..., n) of an encoder and of
    the gyro of a planar arm, (..., n, 3) of that of a spatial one. number: of the joint or of the component, from 0."""
    formula: str = ""
    """The law in `docs/gap.md`."""
    mjcf: Held = BY_LOOP
    """How an MJCF file can hold it."""
    urdf: Held = BY_LOOP
    """How a URDF can hold it."""

    def __post_init__(self) -> None:
        """Refuse what is no entry."""
        if self.place not in PLACES:
            raise ZygosError(f"effect {self.key}: there is no site {self.place!r}; remedy: one of {', '.join(PLACES)}")
        if not re.fullmatch("[a-z]([a-z_0-9]*[a-z])?", self.key):
            raise ZygosError(
                f"effect {self.key!r}: a key has small letters, digits and underscores and ends with a letter; "
                "remedy: rename it"
            )
        needs = (
            "reads" if self.place == "sensor" else "law" if self.place in ("motor", "link", "spring", "load") else ""
        )
        if needs and not callable(getattr(self, needs)):
            raise ZygosError(
                f"effect {self.key}: an effect of the site {self.place} needs the function {needs}; remedy: give it"
            )
        if self.memory and self.place not in REMEMBERING:
            raise ZygosError(
                f"effect {self.key}: a law at the site {self.place} has no memory; remedy: leave memory out, or one of "
                f"{', '.join(REMEMBERING)}"
            )
        if self.place == "sensor" and not self.sensor:
            raise ZygosError(f'effect {self.key}: which sensor is unknown; remedy: sensor = "link", "motor" or "gyro"')

    @property
    def side(self) -> Literal["motor", "link", "spring"]:
        """What the rate and the angle of its law are those of: the motor, the link, or the deflection."""
        return "link" if self.place == "link" else "spring" if self.place == "spring" else "motor"

    @property
    def family(self) -> str:
        """What is alike: all frictions of one side of a joint, all laws of its spring, an effect along both directions
        of its angle; else the entry alone."""
        if self.positive and self.place in ("motor", "link", "load"):
            return f"friction of the {self.side}"
        return "spring" if self.place == "spring" else re.sub("_(sin|cos)$", "", self.key)

    @property
    def torque(self) -> Callable[[Array], Array] | None:
        """f as a function of the rate (motor, link) or of the deflection (spring) alone; None where the law has a
        shape or a memory, and at other sites."""
        law = self.law
        if law is None or self.shapes or self.memory or self.place not in ("motor", "link", "spring"):
            return None
        if self.place == "spring":
            return lambda deflection: law(Motion(deflection=deflection, angle=deflection), np.nan)
        return lambda rate: law(Motion(rate=rate), np.nan)

    @property
    def shape_varies(self) -> bool:
        """Whether there are shapes between those that are listed: an order is a whole number."""
        return any(x % 1.0 for x in self.shapes)

    @property
    def shape(self) -> float:
        """A shape in the middle of its grid; NaN where it has none."""
        return self.shapes[len(self.shapes) // 2] if self.shapes else float("nan")

    @property
    def on_ground(self) -> bool:
        """Whether only estimates on the ground have a column for it: it needs the predicted torque, or multiplies the
        reported one."""
        return self.place == "load" or self.gain

    def left_out(self, keys: Collection[str]) -> bool:
        """Whether it is one of these entries, or becomes one of them."""
        return self.key in keys or self.becomes in keys

    @property
    def at_joint(self) -> bool:
        """Whether the effect belongs to a joint."""
        return self.place not in ("base", "field", "body") and self.sensor != "gyro"

    @property
    def lags(self) -> bool:
        """Whether the effect is the time by which the motor's torque begins later."""
        return self.place == "torque" and self.law is None

    def components(self, arm: Arm) -> tuple[str, ...]:
        """Names of its components on this arm; one without a name where it is a number."""
        if self.place == "body":
            return tuple(name for name, _ in arm.body_parameters)
        return ("x", "y", "z") if self.axes and arm.spatial else ("",)

    def lacking(self, arm: Arm, joint: int) -> str:
        """Why the arm cannot have the effect at a joint (from 0; -1 of none); empty if it can."""
        name = f"arm {arm.name}"
        rigid = joint >= 0 and not arm.joints[joint].flexible
        lacks = (
            (joint < 0 and self.place != "body" and not arm.free, f"the base of {name} is fixed"),
            (self.world == "plane" and arm.spatial, f"{name} moves in space, where it is a vector"),
            (self.world == "space" and not arm.spatial, f"{name} moves in a plane"),
            (self.place == "field" and arm.nadir is None, f"the arm file of {name} does not say where the Earth is"),
            (self.place == "spring" and rigid, f"the joint is rigid in {name} and has no spring"),
            (self.sensor == "motor" and rigid, f"the joint is rigid in {name} and has one encoder"),
            (
                self.place == "rotor" and joint == 0 and not arm.free,
                f"the body that carries this rotor is the base, which is fixed in {name} and does not turn",
            ),
        )
        return next((reason for lacking, reason in lacks if lacking), "")

    def transform(self, arm: Arm, readings: R, joint: int, amount: float, component: int = 0) -> R:
        """What sensors with an error of that amount read where exact ones read `readings`.

        joint: from 0; -1 for the gyro. component: from 0, of an effect with several. A rigid joint has one encoder, of
        which both angles are readings.
        """
        assert self.reads is not None
        if self.sensor == "gyro":
            return replace(readings, omega0=self.reads(arm, readings.omega0, amount, component))
        changed = {}
        for name, side in (("q", "link"), ("theta", "motor")):
            if side == self.sensor or not arm.joints[joint].flexible:
                angles: Array = getattr(readings, name).copy()
                angles[..., joint] = self.reads(arm, angles[..., joint], amount, joint)
                changed[name] = angles
        return replace(readings, **changed)


def smooth_sign(rate: Array) -> Array:
    """Sign of a rate (rad/s), linear within `SLOWEST_RATE`."""
    return np.asarray(np.minimum(np.maximum(rate / SLOWEST_RATE, -1.0), 1.0), dtype=np.float64)
