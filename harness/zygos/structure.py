# SPDX-License-Identifier: MIT
"""The structurally independent parameters of an arm, from its geometry alone (docs/theory.md, "Structural base
parameters").

The columns of the energy at random states are linear functions of each other where the geometry makes them so: their
null space is the same for every motion, and for rows of energy, motor impulse, momentum and joints alike. Candidates
are accepted in a fixed order of preference, each if its column is independent of those accepted before; every other
candidate is then a part of some of the accepted ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.errors import ZygosError

if TYPE_CHECKING:
    from zygos.arm import Arm, Parameter

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

SECOND = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Symbols of a body's inertia about the origin of its frame, in the order of the upper triangle."""
FIRST = ("mx", "my", "mz")
"""Symbols of a body's first moments."""
STANDARD = ("m", *FIRST, *SECOND)
"""Symbols of the ten inertial parameters of a body, in the order of the columns."""
STANDARD_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)

_NOTHING = 1e-6
"""Relative singular values up to this are zero: exact geometries have 1e-15, arms in general position 1e-4 and more. A
deviation of a calibrated axis by a milliradian makes 1e-7, far less than any motion shows."""
_NO_EFFECT = 1e-9
"""Columns shorter than this, relative to the longest of a body's, belong to parameters without any effect."""
_GAP = 10.0
"""Smallest ratio of a singular value that is not zero to one that is."""
_RIGHT_RAD = np.pi / 12.0
_RIGHT_TOLERANCE = 1e-5
"""Angles this close [rad] to a multiple of 15 degrees are taken for it, as pi has few digits in many descriptions."""
_UPPER = np.triu_indices(3)


@dataclass(frozen=True)
class Structure:
    """Which parameters of an arm are independent; p_full full parameters, p independent ones, c candidates."""

    parameters: tuple[Parameter, ...]
    """The p independent parameters, in the order of every row and output."""
    candidates: tuple[Parameter, ...]
    """The c parameters that they were chosen from: those of bodies where lengths are known, else the full ones."""
    basis: Floats
    """E (p_full, p): the full parameters of an arm whose rows are those of the independent ones are E times them."""
    groups: Floats
    """T (p, c): the independent parameters are T times the candidates."""

    @property
    def size(self) -> int:
        """p, the number of independent parameters."""
        return len(self.parameters)

    @property
    def reduces(self) -> bool:
        """Whether the independent parameters are other ones than the full ones."""
        return not np.array_equal(self.basis, np.eye(len(self.basis)))

    @property
    def selects(self) -> bool:
        """Whether every independent parameter is one of the full ones."""
        return self.candidates_are_full and bool(np.isin(self.basis, (0.0, 1.0)).all())

    @property
    def candidates_are_full(self) -> bool:
        """Whether the candidates are the full parameters, because the lengths between the joints are not known."""
        return len(self.candidates) == len(self.basis) and not any(one.symbol in STANDARD for one in self.candidates)

    def reduced(self, columns: Floats) -> Floats:
        """Columns (..., p + e) of the independent parameters, from those of the full ones (..., p_full + e), whose
        last e (effects, right side) stay as they are."""
        if not self.reduces:
            return columns
        full = len(self.basis)
        own: Floats = columns[..., :full] @ self.basis
        return np.concatenate([own, columns[..., full:]], axis=-1) if columns.shape[-1] > full else own

    def expanded(self, values: Floats) -> Floats:
        """Full parameters (..., p_full) whose rows are those of the independent values (..., p)."""
        return values @ self.basis.T if self.reduces else values

    @property
    def grouping(self) -> tuple[str, ...]:
        """(p,) for each independent parameter the sum of candidates it stands for, such as `Ixx2 - Iyy2 + 0.04 m3`.

        Numbers have 6 digits. They are products of lengths and gear ratios, in SI units.
        """
        return tuple(_sum(one, row, self.candidates) for one, row in zip(self.parameters, self.groups, strict=True))

    @property
    def grouped(self) -> tuple[Parameter, ...]:
        """Candidates that are only seen as parts of independent parameters."""
        kept = {one.name for one in self.parameters}
        return tuple(
            one
            for one, column in zip(self.candidates, self.groups.T, strict=True)
            if column.any() and one.name not in kept
        )

    @property
    def unseen(self) -> tuple[Parameter, ...]:
        """Candidates without any effect on the motion."""
        return tuple(one for one, column in zip(self.candidates, self.groups.T, strict=True) if not column.any())


@lru_cache(maxsize=128)
def structure_of(arm: Arm) -> Structure:
    """The structure of an arm. Errors: ZygosError if it is not clear which directions of its parameters are null."""
    full = arm.full_parameters
    candidates, to_full = _standard(arm) if _lengths_known(arm) else (full, np.eye(len(full)))
    if arm.torque_at == "joint":
        # the torque is measured behind the rotors
        to_full = np.where([[one.symbol == "Im"] for one in full], 0.0, to_full)
    # what rounding leaves of a zero would be an entry of the basis
    to_full = np.where(np.abs(to_full) > 1e-13 * np.abs(to_full).max(axis=0), to_full, 0.0)
    own = np.array([one.symbol in ("k", "b") and one.joint is not None for one in candidates])
    sought = np.flatnonzero(~own)
    columns = _full_columns(arm) @ to_full[:, sought]
    columns = columns - columns.mean(axis=0)
    length = np.linalg.norm(columns, axis=0)
    # the columns of rotors are larger by the square of the gear ratio
    of_links = length[[candidates[k].symbol != "Im" for k in sought]]
    seen = length > _NO_EFFECT * of_links.max(initial=0.0)
    scaled = columns[:, seen] / length[seen]
    singular = np.linalg.svd(scaled, compute_uv=False)
    rank = int(np.count_nonzero(singular > _NOTHING * singular[0]))
    order_of_zero = singular[rank] if rank < len(singular) else 0.0
    listed = sought[seen]
    order = sorted(range(len(listed)), key=lambda k: _preference(arm, candidates[listed[k]]))
    kept = np.sort(_independent(scaled, order, rank))
    if singular[rank - 1] < _GAP * order_of_zero or len(kept) < rank:
        raise ZygosError(
            f"arm {arm.name}: it is not clear how many parameters it has, because some axes are nearly, but not "
            "exactly parallel or perpendicular, or some gear ratios nearly 1 (singular values of "
            f"{singular[rank - 1] / singular[0]:.1g} and {order_of_zero / singular[0]:.1g} of the largest); remedy: "
            "write the angles of the drawing into frame_rpy and axis; deviations this small show in no motion"
        )
    parts = np.linalg.lstsq(scaled[:, kept], scaled, rcond=None)[0]
    parts[np.abs(parts) < 1e-10] = 0.0
    chosen = np.sort(np.concatenate([listed[kept], np.flatnonzero(own)]))
    groups = np.zeros((len(chosen), len(candidates)))
    rows = np.searchsorted(chosen, listed[kept])
    groups[np.ix_(rows, listed)] = parts * length[seen] / length[seen][kept][:, None]
    groups[np.searchsorted(chosen, np.flatnonzero(own)), np.flatnonzero(own)] = 1.0
    groups[:, chosen] = np.eye(len(chosen))
    return Structure(tuple(candidates[k] for k in chosen), candidates, to_full[:, chosen], groups)


def _lengths_known(arm: Arm) -> bool:
    """Whether the inertial parameters of the bodies enter linearly: known lengths, and a base that does not move."""
    return not arm.free and all(joint.position_m is not None for joint in arm.joints)


def _independent(scaled: Floats, order: Sequence[int], rank: int) -> list[int]:
    """Columns that are accepted in this order (Gram-Schmidt, twice each for the rounding), `rank` at most."""
    found: list[int] = []
    base = np.zeros((len(scaled), 0))
    for k in order:
        if len(found) == rank:
            break
        rest = scaled[:, k]
        for _ in range(2):
            rest = rest - base @ (base.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > _NOTHING:
            found.append(k)
            base = np.column_stack([base, rest / size])
    return found


def _preference(arm: Arm, one: Parameter) -> tuple[int, ...]:
    """Sorts candidates: those that it is best to keep come first.

    Of bodies: the inertia about their own axis, first moments across it, products, the rest; of the same kind those of
    later bodies, so that a group belongs to its earliest one. Rotors come last: where they turn with their links, their
    inertia is a part of the links'.
    """
    if one.symbol == "Im":
        assert one.joint is not None
        return (0 if arm.joints[one.joint].flexible else 20, -one.joint, 0)
    if one.symbol in STANDARD:
        body = int(one.ends[0])
        along = int(np.argmax(np.abs(arm.joints[body - 1].axis)))
        axis, first, second = (("x", "y", "z")[(along + k) % 3] for k in range(3))
        kinds = (
            ("I", axis, axis), ("m", first), ("m", second), ("I", first, second), ("I", first, axis),
            ("I", second, axis), ("I", first, first), ("I", second, second), ("m", axis), ("m",),
        )  # fmt: skip
        names = [kind[0] + "".join(sorted(kind[1:])) for kind in kinds]
        return (1 + names.index(one.symbol), -body, 0)
    bodies = [int(end.rstrip("xyzuv")) for end in one.ends]
    kind = {"G": 1, "N": 2, "a": 2, "b": 4}[one.symbol] + int(one.symbol in ("N", "a") and len(set(one.ends)) > 1)
    return (kind, -max(bodies), -min(bodies))


def _sum(one: Parameter, row: Floats, candidates: Sequence[Parameter]) -> str:
    """What a parameter stands for: itself first, then the others in their order."""
    names = [candidate.name for candidate in candidates]
    said = one.name
    for name, size in zip(names, row.tolist(), strict=True):
        if size and name != one.name:
            # rounded twice, so that a digit 5 behind the sixth is not left to the last bit
            number = f"{float(f'{abs(size):.12g}'):.6g}"
            said += (" - " if size < 0.0 else " + ") + ("" if number == "1" else f"{number} ") + name
    return said


def _standard(arm: Arm) -> tuple[tuple[Parameter, ...], Floats]:
    """Inertial parameters of the bodies, rotors, springs and dampers (c), and the matrix (p_full, c) that gives the
    full parameters from them.

    A mass point of body b, at r in its frame, lies at the sum of the lengths l_j of the bodies before and of r. Its
    coordinates along the directions are c = c_0 + F r, so its share of N is m c c', and of the first moments m c.
    """
    from zygos.arm import Parameter  # noqa: PLC0415  (an arm has a structure, which has parameters of the arm)

    full = arm.full_parameters
    positions = [np.array(joint.position_m) for joint in arm.joints]
    folds = _folds(arm)
    size = 2 * arm.n
    listed: list[Parameter] = []
    columns: list[Floats] = []
    reached = np.zeros(size)
    for body in range(1, arm.n + 1):
        if body > 1:
            reached = reached + folds[body - 2] @ positions[body - 1]
        fold = folds[body - 1]
        for k, (symbol, unit) in enumerate(zip(STANDARD, STANDARD_UNITS, strict=True)):
            listed.append(Parameter(symbol, unit, (str(body),)))  # type: ignore[arg-type]
            unit_vector = np.eye(10)[k]
            inertia = np.zeros((3, 3))
            inertia[_UPPER] = unit_vector[4:]
            inertia = inertia + inertia.T - np.diag(np.diag(inertia))
            second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
            first = fold @ unit_vector[1:4]
            crossed = np.outer(reached, first)
            matrix = unit_vector[0] * np.outer(reached, reached) + crossed + crossed.T + fold @ second @ fold.T
            columns.append(_of_moments(arm, matrix, unit_vector[0] * reached + first))
    names = [one.name for one in full]
    for i, joint in enumerate(arm.joints):
        of_joint = [("Im", "kg m^2"), *([("k", "Nm/rad"), ("b", "Nms/rad")] if joint.flexible else [])]
        for symbol, unit in of_joint:
            one = Parameter(symbol, unit, joint=i)  # type: ignore[arg-type]
            listed.append(one)
            column = np.zeros(len(full))
            if one.name in names:
                column[names.index(one.name)] = 1.0
            elif arm.torque_at == "rotor":
                # the rotor of a rigid first joint turns with its link alone
                column[0] = joint.gear_ratio**2
            columns.append(column)
    return tuple(listed), np.column_stack(columns)


def _folds(arm: Arm) -> list[Floats]:
    """For each body 1..N of an arm on a fixed base the (2 N, 3) matrix that maps a vector in its frame to the
    coordinates along the directions; what lies along a joint's axis is fixed in the body before."""
    size = 2 * arm.n
    listed: list[Floats] = []
    before = np.zeros((size, 3))
    for i, joint in enumerate(arm.joints):
        axis = _exact_vector(joint.axis)
        fold = np.outer(before @ _exact_frame(joint.frame_rpy) @ axis, axis)
        fold[2 * i : 2 * i + 2] = arm.across[i].T
        listed.append(fold)
        before = fold
    return listed


def _of_moments(arm: Arm, matrix: Floats, moments: Floats) -> Floats:
    """The full parameters (p_full,) of a matrix N (2 N, 2 N) and first moments (2 N,), without those of joints."""
    hand = _hand(arm)
    out = np.zeros(len(arm.full_parameters))
    for k, one in enumerate(arm.full_parameters):
        if one.joint is not None:
            continue
        at = [2 * (int(end.rstrip("uv")) - 1) + int(end.endswith("v")) for end in one.ends]
        if one.symbol == "G":
            out[k] = moments[at[0]]
        elif one.symbol == "N":
            out[k] = matrix[at[0], at[1]] + (matrix[1, 1] if at == [0, 0] else 0.0)
        elif one.symbol == "a":
            out[k] = matrix[at[0], at[1]] + matrix[at[0] + 1, at[1] + 1]
        else:
            out[k] = hand * (matrix[at[0] + 1, at[1]] - matrix[at[0], at[1] + 1])
    return out


def _hand(arm: Arm) -> float:
    """1 where the two directions of the bodies of a planar arm and the axis are right-handed, else -1."""
    return float(np.sign(np.linalg.det(np.column_stack([arm.across[0], np.array(arm.joints[0].axis)]))))


def _full_columns(arm: Arm) -> Floats:
    """(m, p_full) energy columns at random states, the same on every machine; those of springs and dampers are 0."""
    full = arm.full_parameters
    rng = np.random.default_rng(13)
    count = 2 * len(full) + 20
    q, qd = rng.uniform(-np.pi, np.pi, (count, arm.n)), rng.normal(size=(count, arm.n))
    thetad = np.where([joint.flexible for joint in arm.joints], rng.normal(size=(count, arm.n)), qd)
    turned = rng.normal(size=(count, 3))
    if not arm.free:
        turned = np.zeros((count, 3))
    elif not arm.spatial:
        turned = turned[:, :1] * arm.axis
    gravity = np.array(arm.gravity)
    attitude = np.broadcast_to(np.eye(3), (count, 3, 3))
    direction: dict[str, Floats] = {
        f"0{x}": np.broadcast_to(e, (count, 3)) for x, e in zip("xyz", np.eye(3), strict=True)
    }
    rate = {end: np.cross(turned, along) for end, along in direction.items()}
    spin = arm.gear_ratios * thetad
    rotor = np.zeros((count, arm.n))
    angle, rates = np.zeros(count), [turned @ arm.axis if arm.free and not arm.spatial else np.zeros(count)]
    angles = [angle]
    for i, joint in enumerate(arm.joints):
        axis = _exact_vector(joint.axis)
        mounted = attitude @ _exact_frame(joint.frame_rpy)
        along = mounted @ axis
        rotor[:, i] = 0.5 * spin[:, i] ** 2 + spin[:, i] * np.sum(along * turned, axis=1)
        turned = turned + along * qd[:, i, None]
        attitude = mounted @ Rotation.from_rotvec(q[:, i, None] * axis).as_matrix()
        for letter, across in zip("uv", arm.across[i].T, strict=True):
            direction[f"{i + 1}{letter}"] = attitude @ across
            rate[f"{i + 1}{letter}"] = np.cross(turned, attitude @ across)
        angles.append(angles[-1] + q[:, i])
        rates.append(rates[-1] + qd[:, i])
    columns = np.zeros((count, len(full)))
    for k, one in enumerate(full):
        if one.joint is not None:
            columns[:, k] = rotor[:, one.joint] if one.symbol == "Im" else 0.0
        elif one.symbol == "G":
            columns[:, k] = -direction[one.ends[0]] @ gravity
        else:
            half = 0.5 if len(set(one.ends)) == 1 else 1.0
            if one.symbol == "N":
                columns[:, k] = half * np.sum(rate[one.ends[0]] * rate[one.ends[1]], axis=1)
            else:
                a, b = int(one.ends[0]), int(one.ends[1])
                wave = np.cos if one.symbol == "a" else np.sin
                columns[:, k] = half * rates[a] * rates[b] * wave(angles[b] - angles[a])
    return columns


def _exact_frame(rpy: tuple[float, float, float]) -> Floats:
    """(3, 3) attitude of a frame, its angles exact where they are meant to be multiples of 15 degrees."""
    angles = np.array(rpy)
    exact = _RIGHT_RAD * np.round(angles / _RIGHT_RAD)
    angles = np.where(np.abs(angles - exact) < _RIGHT_TOLERANCE, exact, angles)
    return np.asarray(Rotation.from_euler("xyz", angles).as_matrix(), dtype=np.float64)


def _exact_vector(vector: tuple[float, float, float]) -> Floats:
    """(3,) a unit vector, its components exact where they are meant to be 0 or 1."""
    given = np.array(vector)
    given = np.where(np.abs(given) < _RIGHT_TOLERANCE, 0.0, given)
    return np.asarray(given / np.linalg.norm(given), dtype=np.float64)


def independent(groups: Floats, own: Sequence[int]) -> list[int]:
    """Those of the columns that are no combination of the ones before."""
    kept: list[int] = []
    for k in own:
        tried = groups[:, [*kept, k]]
        size = np.linalg.norm(tried, axis=0)
        if size[-1] > 0.0 and np.linalg.svd(tried / size, compute_uv=False)[-1] > _NO_EFFECT:
            kept.append(k)
    return kept
