# SPDX-License-Identifier: MIT
"""The catalogue of effects that a model may carry beyond rigid bodies, rotors and linear springs.

An entry here defines an effect completely: its name in the model file, the torque that the simulator applies or what a
sensor reads, and the columns that it has in the balances (`zygos.balances.effects`). A user's own laws are entries
within `laws`.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.effects.kind import NOT_HELD, SLOWEST_RATE, Held, Kind, Place, smooth_sign
from zygos.effects.memory import Memory
from zygos.effects.motion import Motion
from zygos.errors import ZygosError

Array = NDArray[np.float64]

OFFSET = "spring_offset"
"""Key of the effect with which an estimator accounts for encoders whose zeros are wrong."""

GAIN = "torque_gain"
"""Key of the effect with which an estimator accounts for torque sensors whose gains differ."""

SLOW_LOAD_RATE = 0.01
"""Rate over which the sign of friction in proportion to the load is blurred, rad/s, because a small rate does not show
its sign."""


def _coulomb(motion: Motion, _shape: float) -> Array:
    return smooth_sign(motion.rate)


def _viscous(motion: Motion, _shape: float) -> Array:
    return motion.rate


def _viscous_size(motion: Motion, _shape: float) -> Array:
    return np.abs(motion.rate)


def _stribeck(motion: Motion, speed: float) -> Array:
    return np.asarray(np.exp(-((motion.rate / speed) ** 2)) * smooth_sign(motion.rate))


def _with_load(motion: Motion, _shape: float) -> Array:
    return np.asarray(np.tanh(motion.rate / SLOW_LOAD_RATE) * np.abs(motion.load))


def _one(motion: Motion, _shape: float) -> Array:
    return np.ones_like(motion.rate)


def _cube(motion: Motion, _shape: float) -> Array:
    return motion.deflection**3


def _quarter_fourth(deflection: Array, _shape: float) -> Array:
    return 0.25 * deflection**4


def _offset(motion: Motion, _shape: float) -> Array:
    return np.ones_like(motion.deflection)


def _same(x: Array) -> Array:
    return x


def _deflection(deflection: Array, _shape: float) -> Array:
    return deflection


def _gap(motion: Motion, half_width: float) -> Array:
    return -np.clip(motion.deflection, -half_width, half_width)


def _gap_energy(deflection: Array, half_width: float) -> Array:
    inside = np.clip(deflection, -half_width, half_width)
    return np.asarray(-(np.abs(deflection) - 0.5 * np.abs(inside)) * np.abs(inside))


def _reported(motion: Motion, _shape: float) -> Array:
    return motion.applied


def _sine(motion: Motion, order: float) -> Array:
    return np.asarray(np.sin(order * motion.ratio * motion.angle))


def _cosine(motion: Motion, order: float) -> Array:
    return np.asarray(np.cos(order * motion.ratio * motion.angle))


def _sine_integral(angle: Array, order: float) -> Array:
    return np.asarray(-np.cos(order * angle) / order)


def _cosine_integral(angle: Array, order: float) -> Array:
    return np.asarray(np.sin(order * angle) / order)


def _since(motion: Motion, onset: float) -> Array:
    return np.where(motion.time >= onset, 1.0, 0.0)


def _always(motion: Motion, _shape: float) -> Array:
    return np.ones_like(motion.time)


def _base_sine(motion: Motion, order: float) -> Array:
    return np.asarray(np.sin(order * motion.angle))


def _base_cosine(motion: Motion, order: float) -> Array:
    return np.asarray(np.cos(order * motion.angle))


def _double_sine(motion: Motion, _shape: float) -> Array:
    return np.asarray(np.sin(2.0 * motion.angle))


def _double_cosine(motion: Motion, _shape: float) -> Array:
    return np.asarray(np.cos(2.0 * motion.angle))


class Form(NamedTuple):
    """A law as c/ports/host/multibody.c has it."""

    name: str
    """Of ZYGOS_LAW_..."""
    width: float = np.nan
    shape: float | None = None
    """None: that of the effect."""


COMPILED: Mapping[Callable[[Motion, float], Array], Form] = {
    _one: Form("ONE"),
    _offset: Form("ONE"),
    _viscous: Form("RATE"),
    _viscous_size: Form("SIZE"),
    _coulomb: Form("SIGN", SLOWEST_RATE),
    _stribeck: Form("STRIBECK", SLOWEST_RATE),
    _with_load: Form("LOAD", SLOW_LOAD_RATE),
    _reported: Form("REPORTED"),
    _cube: Form("CUBE"),
    _gap: Form("GAP"),
    _sine: Form("SINE"),
    _cosine: Form("COSINE"),
    _always: Form("ONE"),
    _since: Form("SINCE"),
    _base_sine: Form("SINE"),
    _base_cosine: Form("COSINE"),
    _double_sine: Form("SINE", shape=2.0),
    _double_cosine: Form("COSINE", shape=2.0),
}
"""Laws without a memory, at joints and on the base, that are compiled as well."""


def _bristle_rates(motion: Motion, distance: float) -> tuple[Array, Array]:
    share = motion.rate[..., None] / distance
    return share, np.abs(share)


def _slider_rates(motion: Motion, distance: float) -> tuple[Array, Array]:
    share = motion.rate[..., None] / (distance * _SLIDERS)
    return share, np.zeros_like(share)


def _bent(motion: Motion, _distance: float) -> Array:
    """Of all states, which bend alike."""
    return np.asarray(np.real(motion.memory).mean(axis=-1))


_COMPILED_MEMORIES: Mapping[Callable[[Motion, float], tuple[Array, Array]], Form] = {
    _bristle_rates: Form("BRISTLE"),
    _slider_rates: Form("SLIDERS"),
}


def compiled_form(kind: Kind) -> Form | None:
    """The law of an entry as c/ports/host/multibody.c has it; None where it does not."""
    if kind.law is None:
        return None
    if kind.memory is None:
        return COMPILED.get(kind.law)
    return _COMPILED_MEMORIES.get(kind.memory.rates) if kind.law is _bent and kind.place != "base" else None


def _oscillator_rates(motion: Motion, frequency: float) -> tuple[Array, NDArray[np.complex128]]:
    rate = motion.rate[..., None]
    return rate, np.full(rate.shape, _pole(frequency))


def _pole(frequency: float) -> complex:
    return complex(2.0 * np.pi * frequency * (OSCILLATOR_DAMPING + 1j * np.sqrt(1.0 - OSCILLATOR_DAMPING**2)))


def _oscillator(motion: Motion, frequency: float) -> Array:
    """-s (2 d w s + w^2) / (s^2 + 2 d w s + w^2) of the rate, as a constant and the residues at both poles."""
    pole, size = _pole(frequency), 2.0 * np.pi * frequency
    damped = 2.0 * OSCILLATOR_DAMPING * size
    residue = (damped * pole**2 - size**2 * pole) / (-2j * pole.imag)
    return np.asarray(-damped * motion.rate - 2.0 * np.real(residue * motion.memory[..., 0]))


def _read_shifted(_arm: Arm, angle: Array, amount: float, _number: int) -> Array:
    return angle + amount


def _read_scaled(_arm: Arm, signal: Array, amount: float, _number: int) -> Array:
    return (1.0 + amount) * signal


def _read_sine(_arm: Arm, angle: Array, amount: float, _number: int) -> Array:
    return np.asarray(angle + amount * np.sin(angle))


def _read_cosine(_arm: Arm, angle: Array, amount: float, _number: int) -> Array:
    return np.asarray(angle + amount * np.cos(angle))


def _read_motor_sine(arm: Arm, angle: Array, amount: float, joint: int) -> Array:
    return np.asarray(angle + amount * np.sin(arm.joints[joint].gear_ratio * angle))


def _read_motor_cosine(arm: Arm, angle: Array, amount: float, joint: int) -> Array:
    return np.asarray(angle + amount * np.cos(arm.joints[joint].gear_ratio * angle))


def _read_late(arm: Arm, angle: Array, amount: float, _number: int) -> Array:
    at = arm.period_s * np.arange(angle.shape[-1])
    return np.asarray(CubicSpline(at, angle, axis=-1)(at + amount))


def _read_biased(arm: Arm, rate: Array, amount: float, number: int) -> Array:
    return rate + (amount * np.eye(3)[number] if arm.spatial else amount)


def _read_turned(_arm: Arm, rate: Array, amount: float, number: int) -> Array:
    return np.asarray(rate @ Rotation.from_rotvec(amount * np.eye(3)[number]).as_matrix())


def _grid(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{x:.3g}") for x in np.geomspace(low, high, count))


_SPEEDS = _grid(0.005, 0.5, 9)

OSCILLATOR_DAMPING = 0.02
"""Damping ratio of a hidden oscillator: fuel has about 0.01, a solar panel 0.005."""
_FREQUENCIES = _grid(0.1, 3.0, 25)
_DISTANCES = _grid(1e-4, 1e-2, 7)
_SLIDERS = np.array([0.25, 0.5, 0.75, 1.0])
"""Distances after which the elements of a Maxwell slip model slide, as shares of the largest."""
_SITES_OF_MEMORY: tuple[tuple[str, Place, str, str], ...] = (
    ("motor", "motor", "at the motor", "θ"),
    ("link", "link", "at the link", "q"),
    ("joint", "spring", "of the joint's deflection", "θ−q"),
)

_ORDERS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
_ORDERS_OF_BASE = tuple(order for order in _ORDERS if order != 2.0)
_Side = Literal["link", "motor"]
_Reads = Callable[[Arm, Array, float, int], Array]
_ENCODER_ERRORS: tuple[tuple[str, str, str, tuple[str, ...], tuple[_Reads, _Reads], tuple[str, str]], ...] = (
    ("zero", "zero of the {}", "rad", (), (_read_shifted, _read_shifted), ("reads q + c", "reads θ + c")),
    ("scale", "scale error of the {}", "1", (), (_read_scaled, _read_scaled), ("reads (1 + c) q", "reads (1 + c) θ")),
    (
        "eccentricity_sin",
        "eccentricity of the {} (sine)",
        "rad",
        ("eccentricity_cos",),
        (_read_sine, _read_motor_sine),
        ("reads q + c sin q", "reads θ + c sin nθ"),
    ),
    (
        "eccentricity_cos",
        "eccentricity of the {} (cosine)",
        "rad",
        ("eccentricity_sin",),
        (_read_cosine, _read_motor_cosine),
        ("reads q + c cos q", "reads θ + c cos nθ"),
    ),
    (
        "late",
        "late latch of the {}",
        "s",
        (),
        (_read_late, _read_late),
        ("reads q of the time t + c", "reads θ of the time t + c"),
    ),
)
_SIDES: tuple[_Side, ...] = ("link", "motor")

_FRICTIONLOSS = Held(
    "approximate",
    "`frictionloss` of the joint, or of the hinge of its rotor; soft constraints round the sign off at rates below "
    "2 mrad/s",
)
_FRICTION = Held("approximate", "`friction` of `<dynamics>`, as exact as its simulator")
_REFLECTED = Held(
    "exact",
    "`armature` and inertials of link and carrier together; the hinge of a rotor at a joint with a spring",
)
_DAMPING = Held("exact", "`damping` of the joint, or of the hinge of its rotor")
_CUBIC = Held("exact", "third number of `stiffness` of the tendon, from MuJoCo 4.0 on")
_RELAXED = Held("exact", "`springlength` of the tendon; not beside a cubic stiffness or a backlash")
_GAP = Held("exact", "two numbers of `springlength` of a second tendon")
_DYNAMICS = Held("exact", "`damping` of `<dynamics>`")

ENTRIES = (
    Kind(
        "motor_coulomb",
        "Coulomb friction at the motor",
        "Nm",
        "motor",
        _coulomb,
        twins=("motor_viscous", "link_coulomb"),
        searched_on_ground=True,
        flies=True,
        formula="sat(θ̇ / 1e-3 rad/s)",
        mjcf=_FRICTIONLOSS,
        urdf=_FRICTION,
    ),
    Kind(
        "motor_viscous",
        "viscous friction at the motor",
        "Nms/rad",
        "motor",
        _viscous,
        impulse=_same,
        viscous=True,
        twins=("motor_coulomb", "torque_lag"),
        searched_on_ground=True,
        flies=True,
        formula="θ̇",
        mjcf=_DAMPING,
        urdf=_DYNAMICS,
    ),
    Kind(
        "torque_offset",
        "constant offset of the torque",
        "Nm",
        "motor",
        _one,
        positive=False,
        searched=False,
        searched_last=True,
        flies=True,
        formula="1",
    ),
    Kind(
        "viscous_asymmetry",
        "difference of viscous friction between the directions",
        "Nms/rad",
        "motor",
        _viscous_size,
        positive=False,
        searched=False,
        searched_last=True,
        searched_on_ground=True,
        flies=True,
        formula="|θ̇|",
    ),
    Kind(
        "load_friction",
        "friction in proportion to the load",
        "1",
        "load",
        _with_load,
        twins=("motor_coulomb",),
        searched=False,
        searched_last=True,
        searched_on_ground=True,
        formula="|load| tanh(θ̇ / 0.01 rad/s)",
    ),
    Kind(
        GAIN,
        "error of the torque sensor's gain",
        "1",
        "torque",
        _reported,
        positive=False,
        searched=False,
        searched_last=True,
        searched_on_ground=True,
        gain=True,
        formula="τ",
    ),
    Kind(
        "link_coulomb",
        "Coulomb friction at the link",
        "Nm",
        "link",
        _coulomb,
        twins=("motor_coulomb",),
        flies=True,
        formula="sat(q̇ / 1e-3 rad/s)",
        mjcf=_FRICTIONLOSS,
        urdf=_FRICTION,
    ),
    Kind(
        "cubic_stiffness",
        "cubic joint stiffness",
        "Nm/rad^3",
        "spring",
        _cube,
        _quarter_fourth,
        positive=False,
        flies=True,
        formula="(θ−q)³",
        mjcf=_CUBIC,
        urdf=NOT_HELD,
    ),
    Kind(
        OFFSET,
        "offset of the spring",
        "Nm",
        "spring",
        _offset,
        _deflection,
        positive=False,
        flies=True,
        formula="1",
        mjcf=_RELAXED,
        urdf=NOT_HELD,
    ),
    Kind(
        "torque_lag",
        "torque lag",
        "s",
        "torque",
        twins=("motor_viscous",),
        flies=True,
        formula="the torque begins later by c < period",
    ),
    Kind(
        "rotor_coupling",
        "rotor gyroscopic coupling",
        "1",
        "rotor",
        positive=False,
        flies=True,
        formula="share of Im that takes part in the rotation of the carrying body",
        mjcf=_REFLECTED,
        urdf=NOT_HELD,
    ),
    Kind(
        "angular_momentum",
        "angular momentum",
        "Nms",
        "base",
        positive=False,
        world="plane",
        flies=True,
        formula="the value of H",
        mjcf=NOT_HELD,
        urdf=NOT_HELD,
    ),
    Kind(
        "motor_stribeck",
        "Stribeck friction at the motor",
        "Nm",
        "motor",
        _stribeck,
        twins=("motor_coulomb", "motor_viscous"),
        becomes="motor_coulomb",
        searched=False,
        searched_last=True,
        shapes=_SPEEDS,
        shape_title="Stribeck velocity v",
        shape_unit="rad/s",
        formula="exp(−(θ̇/v)²) sat(θ̇ / 1e-3 rad/s)",
    ),
    Kind(
        "link_viscous",
        "viscous friction at the link",
        "Nms/rad",
        "link",
        _viscous,
        viscous=True,
        twins=("link_coulomb", "motor_viscous"),
        searched=False,
        searched_last=True,
        formula="q̇",
        mjcf=_DAMPING,
        urdf=_DYNAMICS,
    ),
    Kind(
        "link_viscous_asymmetry",
        "difference of viscous friction at the link between the directions",
        "Nms/rad",
        "link",
        _viscous_size,
        positive=False,
        twins=("viscous_asymmetry",),
        searched=False,
        searched_last=True,
        formula="|q̇|",
    ),
    Kind(
        "link_stribeck",
        "Stribeck friction at the link",
        "Nm",
        "link",
        _stribeck,
        twins=("link_coulomb", "link_viscous"),
        becomes="link_coulomb",
        searched=False,
        searched_last=True,
        shapes=_SPEEDS,
        shape_title="Stribeck velocity v",
        shape_unit="rad/s",
        formula="exp(−(q̇/v)²) sat(q̇ / 1e-3 rad/s)",
    ),
    Kind(
        "backlash",
        "backlash",
        "Nm/rad",
        "spring",
        _gap,
        _gap_energy,
        twins=("cubic_stiffness", "link_coulomb"),
        searched=False,
        searched_last=True,
        shapes=_grid(1e-5, 1e-2, 10),
        shape_title="half width g of the gap",
        shape_unit="rad",
        formula="−clip(θ−q, −g, g); all of the gap is free at c = k",
        mjcf=_GAP,
        urdf=NOT_HELD,
    ),
    Kind(
        "ripple_sin",
        "torque ripple (sine)",
        "Nm",
        "torque",
        _sine,
        _sine_integral,
        positive=False,
        twins=("ripple_cos",),
        searched=False,
        searched_last=True,
        shapes=_ORDERS,
        shape_title="order N in turns of the motor",
        shape_unit="1",
        formula="sin(N n θ)",
    ),
    Kind(
        "ripple_cos",
        "torque ripple (cosine)",
        "Nm",
        "torque",
        _cosine,
        _cosine_integral,
        positive=False,
        twins=("ripple_sin",),
        searched=False,
        searched_last=True,
        shapes=_ORDERS,
        shape_title="order N in turns of the motor",
        shape_unit="1",
        formula="cos(N n θ)",
    ),
    Kind(
        "base_torque",
        "constant torque on the base",
        "Nm",
        "base",
        _always,
        positive=False,
        twins=("base_leak", "gyro_bias"),
        searched=False,
        searched_last=True,
        axes=True,
        formula="1, in base axes",
    ),
    Kind(
        "base_leak",
        "torque on the base from an instant on",
        "Nm",
        "base",
        _since,
        positive=False,
        twins=("base_torque",),
        searched=False,
        searched_last=True,
        shapes=_grid(1.0, 300.0, 12),
        shape_title="onset since the start of the run",
        shape_unit="s",
        axes=True,
        formula="1 from the onset on, in base axes",
    ),
    Kind(
        "gravity_gradient_sin",
        "gravity gradient torque on the base (sine)",
        "Nm",
        "base",
        _double_sine,
        positive=False,
        twins=("gravity_gradient_cos", "detent_sin"),
        searched=False,
        searched_last=True,
        world="plane",
        formula="sin 2φ, φ = angle that the base has turned",
    ),
    Kind(
        "gravity_gradient_cos",
        "gravity gradient torque on the base (cosine)",
        "Nm",
        "base",
        _double_cosine,
        positive=False,
        twins=("gravity_gradient_sin", "detent_cos"),
        searched=False,
        searched_last=True,
        world="plane",
        formula="cos 2φ",
    ),
    Kind(
        "gravity_gradient",
        "gravity gradient",
        "1/s^2",
        "field",
        twins=("base_torque",),
        searched=False,
        searched_last=True,
        world="space",
        formula="force (r r′ − 1/3) x on each kg at x from the mass centre; r points to the Earth; c = 3μ/r³",
    ),
    Kind(
        "detent_sin",
        "detent torque on the base (sine)",
        "Nm",
        "base",
        _base_sine,
        positive=False,
        twins=("detent_cos", "gravity_gradient_sin"),
        searched=False,
        searched_last=True,
        shapes=_ORDERS_OF_BASE,
        shape_title="order N in turns of the base",
        shape_unit="1",
        world="plane",
        formula="sin Nφ",
    ),
    Kind(
        "detent_cos",
        "detent torque on the base (cosine)",
        "Nm",
        "base",
        _base_cosine,
        positive=False,
        twins=("detent_sin", "gravity_gradient_cos"),
        searched=False,
        searched_last=True,
        shapes=_ORDERS_OF_BASE,
        shape_title="order N in turns of the base",
        shape_unit="1",
        world="plane",
        formula="cos Nφ",
    ),
    *(
        Kind(
            f"{side}_dahl",
            f"Dahl {'hysteresis' if place == 'spring' else 'friction'} {where}",
            "Nm",
            place,
            _bent,
            twins=(f"{side}_maxwell", *(() if place == "spring" else (f"{side}_coulomb", f"{side}_stribeck"))),
            becomes="" if place == "spring" else f"{side}_coulomb",
            searched=False,
            searched_last=True,
            shapes=_DISTANCES,
            shape_title="presliding distance d",
            shape_unit="rad",
            memory=Memory(_bristle_rates),
            formula=f"z, dz = (1 − z sgn dx) dx / d, x = {symbol}",
        )
        for side, place, where, symbol in _SITES_OF_MEMORY
    ),
    *(
        Kind(
            f"{side}_maxwell",
            f"Maxwell slip {where}",
            "Nm",
            place,
            _bent,
            twins=(f"{side}_dahl", *(() if place == "spring" else (f"{side}_coulomb", f"{side}_stribeck"))),
            becomes="" if place == "spring" else f"{side}_coulomb",
            searched=False,
            searched_last=True,
            shapes=_DISTANCES,
            shape_title="distance d after which all slides",
            shape_unit="rad",
            memory=Memory(_slider_rates, size=len(_SLIDERS), stops=True),
            formula=f"mean of z at d/4, d/2, 3d/4 and d, dz = dx / d up to ±1, x = {symbol}",
        )
        for side, place, where, symbol in _SITES_OF_MEMORY
    ),
    Kind(
        "base_oscillator",
        "oscillator on the base",
        "kg m^2",
        "base",
        _oscillator,
        searched=False,
        searched_last=True,
        shapes=_FREQUENCIES,
        shape_title="frequency",
        shape_unit="Hz",
        memory=Memory(_oscillator_rates),
        axes=True,
        formula="−dω_z/dt of an inertia on a spring with a damping ratio of 0.02, in base axes",
    ),
    Kind(
        "body_change",
        "change of a body",
        "of the parameter",
        "body",
        positive=False,
        searched=False,
        shapes=_grid(1.0, 300.0, 12),
        shape_title="instant since the start of the run",
        shape_unit="s",
        formula="a base parameter is larger by c from the instant on",
        mjcf=NOT_HELD,
        urdf=NOT_HELD,
    ),
    *(
        Kind(
            f"{side}_{key}",
            title.format(f"{side} encoder"),
            unit,
            "sensor",
            positive=False,
            twins=tuple(f"{side}_{twin}" for twin in twins),
            searched=False,
            searched_last=key != "zero",
            sensor=side,
            reads=reads[number],
            formula=formula[number],
            mjcf=NOT_HELD,
            urdf=NOT_HELD,
        )
        for number, side in enumerate(_SIDES)
        for key, title, unit, twins, reads, formula in _ENCODER_ERRORS
    ),
    Kind(
        "gyro_bias",
        "bias of the gyro",
        "rad/s",
        "sensor",
        positive=False,
        twins=("angular_momentum", "base_torque"),
        searched=False,
        axes=True,
        sensor="gyro",
        reads=_read_biased,
        formula="reads ω + c",
        mjcf=NOT_HELD,
        urdf=NOT_HELD,
    ),
    Kind(
        "gyro_scale",
        "scale error of the gyro",
        "1",
        "sensor",
        positive=False,
        searched=False,
        searched_last=True,
        sensor="gyro",
        reads=_read_scaled,
        formula="reads (1 + c) ω",
        mjcf=NOT_HELD,
        urdf=NOT_HELD,
    ),
    Kind(
        "gyro_misalignment",
        "misalignment of the gyro",
        "rad",
        "sensor",
        positive=False,
        searched=False,
        searched_last=True,
        axes=True,
        world="space",
        sensor="gyro",
        reads=_read_turned,
        formula="is turned about a base axis by c",
        mjcf=NOT_HELD,
        urdf=NOT_HELD,
    ),
)
"""Units are those of the coefficient: torques at a motor in Nm before the gear, rates after it.

torque_offset: the constant by which the reported torque exceeds the one that acts. A Coulomb friction of different size
in both directions looks the same except at rest, so that one entry stands for both.
viscous_asymmetry: half of the difference of the viscous coefficients in positive and negative direction.
load_friction: share of the torque through the gear, as the model predicts it, that friction opposes the motion with.
torque_gain: share by which the torque that acts exceeds the reported one. The gain of one joint must be left out:
without a torque that is known, all gains, masses and frictions can grow together.
spring_offset: the spring's torque where theta = q reads 0. If wrong encoder zeros make theta - q read too large by x, a
spring of stiffness k looks as if it had an offset of -k x.
torque_lag: the time by which the motor follows the reported torque later, less than a SYNC period.
rotor_coupling: the share of the rotor's inertia that the carrying body's rotation acts on. It is 1 in nature and 0 in
simulators whose `armature` adds to the joint's inertia alone. A model that does not mention it has 1.
motor_stribeck, link_stribeck: by how much friction at rest exceeds that of a moving joint. Stribeck friction has a
Coulomb friction beside it, which is an entry of its own.
backlash: the spring's torque is k (theta - q) less c (theta - q) within the gap, and less c g beyond it. At c = k the
gap is free of torque; a smaller c is a gap that is stiff to some degree. The coefficient is linear, the gap a shape.
ripple: its order counts turns of the motor, before the gear, whose angle is n theta.
gravity_gradient: of an arm in space that knows where the Earth is at the start of each run. It turns with the base, and
its torques on base and joints follow from the inertias. In a low orbit c is 3.8e-6 1/s^2.
gravity_gradient_..., detent: of unknown phase, so that each has a sine and a cosine. A detent of the second order looks
like a gravity gradient, which stands for it. The motion in a plane does not show how the mass of a body lies in the
plane, so that the size of the torque is the coefficient.
..._dahl, ..._maxwell: friction whose sign follows the motion over a distance. That of a joint's deflection is the
hysteresis of its spring.
base_oscillator: fuel that sloshes or a panel that bends. It is driven by the turning of the base alone, and its inertia
takes part in no other motion.
body_change: has one component for each base parameter of the bodies. What is taken up or dropped moves with the arm at
that instant, so that the motion goes on without a jump.
motor_eccentricity: repeats with each turn of the motor; c is after the gear, as theta is. What an eccentric rotor does
to the torque once a turn is a ripple of the first order.
link_late, motor_late: the encoder latches its angle later than the arm file states.
link_..., motor_...: of a rigid joint, whose one encoder reads both angles, only those of the link exist.
angular_momentum: the angular momentum of the whole arm about its mass centre. A model that does not mention it makes no
assumption about it.
"""

_own: ContextVar[tuple[Kind, ...]] = ContextVar("own laws", default=())
"""A user's own entries, which are known within `laws` alone."""


class Catalogue(Mapping[str, Kind]):
    """The entries by key: those of `ENTRIES`, then within `laws` the user's own."""

    def _entries(self) -> dict[str, Kind]:
        return {kind.key: kind for kind in (*ENTRIES, *_own.get())}

    def __getitem__(self, key: str) -> Kind:
        """The entry of that key. Errors: KeyError."""
        return self._entries()[key]

    def __iter__(self) -> Iterator[str]:
        """The keys."""
        return iter(self._entries())

    def __len__(self) -> int:
        """Number of entries."""
        return len(ENTRIES) + len(_own.get())


CATALOGUE = Catalogue()


def load_laws(path: Path | str) -> tuple[Kind, ...]:
    """The entries of a Python file that states LAWS = [Kind(...), ...]. The file is executed.

    Errors: ZygosError for a file that cannot be executed, that has no such list, and for an entry whose key is taken.
    """
    path = Path(path)
    if not path.is_file():
        raise ZygosError(f"{path}: there is no such file; remedy: give a Python file with LAWS = [Kind(...)]")
    try:
        found = runpy.run_path(str(path)).get("LAWS")
    except ZygosError:
        raise
    except Exception as error:
        raise ZygosError(
            f"{path}: is not a Python file that can be executed ({type(error).__name__}: {error}); remedy: correct it"
        ) from error
    if not isinstance(found, list | tuple) or not found or not all(isinstance(one, Kind) for one in found):
        raise ZygosError(
            f"{path}: states no list LAWS of entries; remedy: LAWS = [Kind(...)], docs/gap.md has an example"
        )
    taken = {kind.key for kind in ENTRIES}
    for kind in found:
        if kind.key in taken:
            raise ZygosError(f"{path}: there is already an effect {kind.key!r}; remedy: give another key")
        taken.add(kind.key)
    return tuple(found)


@contextmanager
def laws(*own: Path | str | Kind) -> Iterator[tuple[Kind, ...]]:
    """Within the block, the catalogue also has these entries: of Python files, or entries themselves.

    Errors: as `load_laws`.
    """
    found: list[Kind] = []
    for one in own:
        found += (one,) if isinstance(one, Kind) else load_laws(one)
    keys = [*CATALOGUE, *(kind.key for kind in found)]
    for key in keys:
        if keys.count(key) > 1:
            raise ZygosError(f"there are two effects {key!r}; remedy: give one of them another key")
    token = _own.set((*_own.get(), *found))
    try:
        yield tuple(found)
    finally:
        _own.reset(token)
