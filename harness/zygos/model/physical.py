# SPDX-License-Identifier: MIT
"""The physical arm that explains an estimate: bodies, lengths and drives whose base parameters fit it
(docs/physical.md).

Estimated base parameters contain noise and usually belong to no physical arm: for a spatial arm with three joints, the
matrix N has 45 entries, but the bodies have only 31 degrees of freedom, and N need not be positive. The fit therefore
varies the bodies. Their coordinates describe a physically possible body for all values (log-Cholesky: Rucker & Wensing,
"Smooth parameterization of rigid-body inertia", RA-L 2022), and what the estimate does not determine stays as in the
drawing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from zygos.arm import Arm
from zygos.errors import Undecided, ZygosError, installs
from zygos.model import gram
from zygos.model.model import INERTIA_KEYS, Body, JointModel, Model, Quantity
from zygos.quantiles import chi_square_isf, fisher_isf

Array = NDArray[np.float64]

CHANCE = 1e-3
"""Probability that an estimate of the described arm exceeds the limit of chi^2/dof."""
THINNEST = 1e-4
"""Smallest principal second moment of a body, as a share of its largest one; a thinner body in the drawing is thickened
to this value."""

_DEPENDENT = 1e-11
"""Columns whose scaled normal matrix has a smaller relative eigenvalue are dependent, as in c/solve/solver.c."""
_SHARPEST = 1e-6
"""Smallest relative sigma of a combination of parameters."""
_PRECISIONS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0)
"""Smallest relative sigma of a combination of parameters in each step of a fit; the last one takes all as they are."""
_ROUGH, _CLOSE = 1e-3, 1e-10
"""Tolerances of the intermediate steps and of the last one."""
_EVALUATIONS = 100
"""Largest number of evaluations in a step."""
_STEP = 1e-5
"""Step of the numerical differentiation, in coordinates of order one."""
_UPPER = np.triu_indices(3)
_DRIVE_KEYS = {"Im": "rotor_inertia", "k": "stiffness", "b": "damping"}


@dataclass(frozen=True)
class Observed:
    """The information of an estimate about the p base parameters of an arm."""

    value: Array
    """(p,) least-squares solution for all base parameters."""
    root: Array
    """(r, p): |root (x - value)|^2 is chi^2 of base parameters x; combinations that the motion did not excite have no
    row."""
    blocks: int | None
    """Number of blocks of the jackknife that scales chi^2; None where its scale is known."""


@dataclass(frozen=True)
class PhysicalFit:
    """The arm that explains an estimate best."""

    model: Model
    """Model given by bodies; each sigma is that of one entry alone, and is large for entries that nothing
    determines."""
    value: Array
    """(p,) base parameters of the model."""
    covariance: Array
    """(p, p) covariance of the base parameters."""
    known: dict[str, float]
    """Share of the drawing's uncertainty that the estimate removes, 0 .. 1, for each entry of `entries_of_model`."""
    lengths: Array
    """(N, 3) differences of the lengths from the drawing, m."""
    chi2: float
    """chi^2 of the estimate and of the lengths relative to the drawing."""
    dof: float
    """Degrees of freedom of chi2: those of the estimate and the lengths that are not used up by fitting the bodies."""
    limit: float
    """Limit of chi2/dof; infinite if dof is below one, because then the bodies can follow any estimate."""
    least: float
    """chi^2 of the nearest positive semi-definite N, by convex programming: a lower bound for every arm."""

    @property
    def explained(self) -> bool:
        """Whether chi2/dof is within its limit."""
        return self.chi2 <= self.limit * max(self.dof, 1.0)


def _limit(dof: float, blocks: int | None) -> float:
    """What chi^2/dof exceeds with the probability `CHANCE`, where chi^2 is scaled by this number of blocks."""
    if dof < 1.0:
        return np.inf
    return float(chi_square_isf(CHANCE, dof)) / dof if blocks is None else fisher_isf(CHANCE, dof, blocks - 1)


def observe(names: Sequence[str], report: Mapping[str, Any]) -> Observed:
    """The information about the parameters `names` in the JSON of `zygos estimate`; other columns are eliminated.

    Refined values are taken with their covariance, where they are published. Otherwise
    chi^2 has the shape of the normal equations A and the scale of the jackknife: (x - value)' A (x - value) / c, where
    c is the median ratio of published variance to that of A^-1. The published covariance has the rank of its at most 32
    blocks, so it is not a metric; independent variances would lose the most precise combinations. Errors: ZygosError;
    Undecided if the estimate was refused.
    """
    listed = [str(entry["name"]) for entry in report["parameters"]]
    missing = [name for name in names if name not in listed]
    if missing:
        raise ZygosError(f"the estimate has no {', '.join(missing[:3])}; remedy: give the arm file of the estimate")
    if report["validity"] == "refused":
        raise Undecided(f"the estimate was refused: {report['reason']}; remedy: see that of `zygos estimate`")
    if (report.get("refinement") or {}).get("published"):
        return _refined(names, report)
    solution = np.array(report["solution"], dtype=float)
    sigma = np.array([entry["sigma"] for entry in report["parameters"]], dtype=float)
    normal = np.array(report["normal"], dtype=float)
    own = [listed.index(name) for name in names]
    others = [k for k in range(len(listed)) if k not in own]
    scale = 1.0 / np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    scaled = normal * np.outer(scale, scale)
    spread = scale**2 * np.diag(np.linalg.pinv(scaled, rcond=_DEPENDENT, hermitian=True))
    ratio = (sigma**2 / spread)[own]
    ratio = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(ratio):
        raise Undecided("no parameter of the estimate has a sigma; remedy: see that of `zygos estimate`")
    inner = scaled[np.ix_(own, own)]
    if others:
        cross = scaled[np.ix_(own, others)]
        inner = (
            inner - cross @ np.linalg.pinv(scaled[np.ix_(others, others)], rcond=_DEPENDENT, hermitian=True) @ cross.T
        )
    eigen, vectors = np.linalg.eigh(inner)
    kept = eigen > _DEPENDENT * eigen[-1]
    root = np.sqrt(eigen[kept, None] / np.median(ratio)) * vectors[:, kept].T / scale[own]
    return Observed(solution[own], _blunted(root, solution[own]), int(report["blocks"]))


def _refined(names: Sequence[str], report: Mapping[str, Any]) -> Observed:
    """The information of refined values, whose covariance (p, p) is in the order of the base parameters."""
    values = {entry["name"]: entry["value"] for entry in report.get("values", ())}
    value = np.array([values.get(name) for name in names], dtype=float)
    covariance = np.array(report["refinement"].get("covariance"), dtype=float)
    if covariance.shape != 2 * value.shape or not np.isfinite([*value, *covariance.flat]).all():
        raise ZygosError(
            "the refined values have no covariance of their number; remedy: give the file that `zygos estimate --json` "
            "wrote"
        )
    sigma = np.sqrt(np.diag(covariance))
    eigen, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    root = vectors.T / np.sqrt(np.maximum(eigen, _DEPENDENT))[:, None] / sigma
    return Observed(value, _blunted(root, value), None)


def _blunted(root: Array, value: Array) -> Array:
    """The rows, none of them more precise than `_SHARPEST`: no solver could handle the scale of an estimate without
    noise."""
    sharp = np.linalg.norm(root * value, axis=1)[:, None] * _SHARPEST
    return np.asarray(root / np.maximum(1.0, sharp))


class Coordinates:
    """Coordinates y of arms near the drawing: zero at the drawing, and one at a deviation of one standard deviation.

    Each body has the logarithm of its mass, the factor E (lower triangular, logarithms on the diagonal) by which the
    Cholesky factor of its second moment per mass is multiplied, and its mass centre in radii of gyration. They are
    followed by the lengths and the logarithms of Im, k and b. The standard deviation of the drawing is a factor of e,
    or a radius of gyration.
    """

    def __init__(self, arm: Arm, drawing: Model, length_sigma: float) -> None:
        """length_sigma: standard deviation of each component of a length, m; 0: exact. Errors: ZygosError if the
        drawing does not fit the arm, or if a value that is varied by a factor is zero."""
        drawing.base_values(arm)
        for kind, i, _ in arm.joint_parameters:
            start = getattr(drawing.joints[i], _DRIVE_KEYS[kind]).value
            if not 0.0 < start < np.inf:
                raise ZygosError(
                    f"model {drawing.name}: {_DRIVE_KEYS[kind]} of joint {drawing.joints[i].name} is {start:g}, which "
                    "no factor can change; remedy: state its order of magnitude"
                )
        self.arm = arm
        self.drawing = drawing
        self.length_sigma = length_sigma
        self.bodies = range(0 if arm.free else 1, arm.n + 1)
        """Numbers of the bodies that move."""
        self._directions = {i: self._movable(i) for i in self.bodies}
        self._roots = {i: _root(drawing.bodies[i]) for i in self.bodies}
        # an arm file that states where the joints are leaves no length open
        varied = length_sigma > 0.0 and arm.structure.candidates_are_full
        self._places = [(i, d) for i in self.bodies if i < arm.n for d in self._directions[i]] if varied else []
        of_bodies = sum(7 + len(directions) for directions in self._directions.values())
        self.of_lengths = slice(of_bodies, of_bodies + len(self._places))
        """Positions of the lengths in y."""
        self.size = self.of_lengths.stop + len(arm.joint_parameters)

    def model(self, y: Array) -> Model:
        """The arm with these coordinates, with sigmas 0."""
        bodies = list(self.drawing.bodies)
        first = 0
        for i in self.bodies:
            count = 7 + len(self._directions[i])
            bodies[i] = self._body(i, y[first : first + count])
            first += count
        for (i, direction), off in zip(self._places, y[self.of_lengths], strict=True):
            x, y_, z = (_reach(bodies[i]) + self.length_sigma * off * direction).tolist()
            bodies[i] = replace(bodies[i], joint_xyz=(x, y_, z))
        joints = list(self.drawing.joints)
        for (kind, i, _), log in zip(self.arm.joint_parameters, y[self.of_lengths.stop :], strict=True):
            key = _DRIVE_KEYS[kind]
            drawn = getattr(joints[i], key)
            joints[i] = _with(joints[i], {key: Quantity(drawn.value * float(np.exp(log)), 0.0, "zygos", drawn.unit)})
        return Model(self.drawing.name, tuple(bodies), tuple(joints))

    def base(self, y: Array) -> Array:
        """(p,) base parameters of the arm at y."""
        return self.model(y).unchecked_values(self.arm)

    def _body(self, i: int, y: Array) -> Body:
        drawn = self.drawing.bodies[i]
        mass = drawn.mass.value * float(np.exp(y[0]))
        factor = np.diag(np.exp(y[1:4]))
        factor[1, 0], factor[2, 0], factor[2, 1] = y[4:7]
        root = self._roots[i] @ factor
        second = mass * root @ root.T
        tensor = np.trace(second) * np.eye(3) - second
        gyration = float(np.linalg.norm(self._roots[i]))
        x, y_, z = (np.array(drawn.origin_xyz) + gyration * y[7:] @ self._directions[i]).tolist()
        return replace(
            drawn,
            mass=Quantity(mass, 0.0, "zygos", "kg"),
            origin_xyz=(x, y_, z),
            inertia=_six(Quantity(entry, 0.0, "zygos", "kg m^2") for entry in tensor[_UPPER].tolist()),
        )

    def _movable(self, i: int) -> Array:
        """(d, 3) directions in body i's frame in which its mass centre and the next joint may deviate. For a planar arm
        they are perpendicular to the axis, since no other direction has an effect; for a planar-symmetric arm there is
        one, along the line of its joints."""
        if self.arm.spatial:
            return np.eye(3)
        along = self._line()
        vectors = [along] if self.arm.kinetic == "planar-symmetric" else [along, np.cross(self.arm.axis, along)]
        directions: Array = np.array(vectors) @ self.arm.frames[i]
        return directions

    def _line(self) -> Array:
        """(3,) unit vector perpendicular to the axis, in the base frame of the stretched arm, along the longest
        distance from a joint to the next, or from the last joint to the mass centre."""
        ways = [body.joint_xyz or body.origin_xyz for body in self.drawing.bodies[1:]]
        stretched = np.einsum("iab,ib->ia", self.arm.frames[1:], np.array(ways))
        across = stretched - np.outer(stretched @ self.arm.axis, self.arm.axis)
        longest: Array = across[np.argmax(np.linalg.norm(across, axis=1))]
        if not longest.any():
            raise ZygosError(
                f"model {self.drawing.name}: joints and mass centres lie on one axis; remedy: state the lengths"
            )
        return longest / np.linalg.norm(longest)


def entries_of_model(arm: Arm, model: Model) -> dict[str, Quantity]:
    """The entries, by name, that a fit varies and that have a sigma in a model file: mass and inertia of the bodies,
    Im, k, b."""
    listed: dict[str, Quantity] = {}
    for body in model.bodies[0 if arm.free else 1 :]:
        listed[f"{body.name} mass"] = body.mass
        listed |= {f"{body.name} {key}": entry for key, entry in zip(INERTIA_KEYS, body.inertia, strict=True)}
    for kind, i, _ in arm.joint_parameters:
        key = _DRIVE_KEYS[kind]
        listed[f"{model.joints[i].name} {key}"] = getattr(model.joints[i], key)
    return listed


def fit_bodies(
    arm: Arm,
    drawing: Model,
    observed: Observed,
    length_sigma: float,
    progress: Callable[[float], None] = lambda share: None,
) -> PhysicalFit:
    """The arm near `drawing` (given by bodies) that explains an estimate best.

    Minimises chi^2 + |y|^2 over the `Coordinates` y. A precise estimate of an arm that is far from the drawing makes a
    narrow curved valley, in which steps are short. The fit therefore begins with sigmas of a tenth of the parameters,
    and follows the solution as they shrink to those of the estimate. progress is called with the share that is
    finished. Errors: ZygosError if the drawing does not fit the arm.
    """
    where = Coordinates(arm, drawing, length_sigma)
    least = nearest_matrix(arm, drawing, observed)[1]
    y = np.zeros(where.size)
    size = np.linalg.norm(observed.root * where.base(y), axis=1)
    for step, precision in enumerate(_PRECISIONS):

        def told(share: float, step: int = step) -> None:
            progress((step + share) / len(_PRECISIONS))

        root = observed.root / np.maximum(1.0, precision * size)[:, None]
        y = _least_squares(where, root, observed.value, y, _ROUGH if precision else _CLOSE, told)
    value = where.base(y)
    slope_of_base = _slope(where.base, y)
    missing = observed.root @ (value - observed.value)
    lengths = y[where.of_lengths]
    rows = np.vstack([observed.root @ slope_of_base, np.eye(where.size)])
    # a square root of the covariance of y
    spread = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    tested = np.vstack([rows[: -where.size], rows[-where.size :][where.of_lengths]])
    dof = float(len(tested) - np.sum((tested @ spread) ** 2))
    model, known = _with_sigmas(where, y, spread)
    return PhysicalFit(
        model=model,
        value=value,
        covariance=(slope_of_base @ spread) @ (slope_of_base @ spread).T,
        known=known,
        lengths=np.array(
            [
                _reach(after) - _reach(before)
                for after, before in zip(model.bodies[:-1], drawing.bodies[:-1], strict=True)
            ]
        ),
        chi2=float(missing @ missing + lengths @ lengths),
        dof=dof,
        limit=_limit(dof, observed.blocks),
        least=least,
    )


def nearest_matrix(arm: Arm, drawing: Model, observed: Observed) -> tuple[Array, float]:
    """The base parameters (p,) nearest to an estimate with N minus the rotors' contribution positive semi-definite and
    Im, k and b not negative, and their chi^2. Where the lengths are known, possible bodies take the place of N.

    Every physical arm satisfies these conditions, but so do some that are not physical. The semidefinite program is
    solved by Clarabel; the drawing is used only for scaling. Errors: ZygosError if cvxpy or Clarabel is missing.
    """
    try:
        cvxpy = import_module("cvxpy")
        import_module("clarabel")
    except ImportError:
        raise ZygosError(f"fitting needs cvxpy and Clarabel; remedy: {installs('fit')}") from None
    drawn = drawing.candidate_values(arm)
    candidates = (_by_matrix if arm.structure.candidates_are_full else _by_bodies)(cvxpy, arm, drawn)
    x = arm.structure.groups @ candidates
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(observed.root @ x - observed.root @ observed.value)))
    with warnings.catch_warnings():
        # cvxpy warns of a solution with fewer digits; it is only a starting point, and a bound that needs few digits
        warnings.simplefilter("ignore", UserWarning)
        with suppress(cvxpy.SolverError):
            problem.solve(solver=cvxpy.CLARABEL)
    if x.value is None:
        raise Undecided(
            f"Clarabel finds no arm near the estimate ({problem.status}); remedy: check that the estimate belongs to "
            f"arm {arm.name}, and that model {drawing.name} is in SI units"
        )
    value: Array = np.asarray(x.value, dtype=float)
    gone = observed.root @ (value - observed.value)
    return value, float(gone @ gone)


def _by_bodies(cvxpy: Any, arm: Arm, drawn: Array) -> Any:
    """The candidates (c,) as an expression of possible bodies: their matrices [[S, s], [s', m]] of second moment, first
    moment and mass, less the rotors that they carry, are positive semi-definite."""
    bodies, drives = drawn[: 10 * arm.n].reshape(arm.n, 10), drawn[10 * arm.n :]
    factors = cvxpy.Variable(len(drives), nonneg=True)
    units = np.where(drives > 0.0, drives, 1.0)
    of_joint = {
        (one.symbol, one.joint): k
        for k, one in enumerate(one for one in arm.structure.candidates if one.joint is not None)
    }
    parts: list[Any] = []
    for i, own in enumerate(bodies):
        # scaling by the drawing makes every unknown of order one
        second = 0.5 * own[[4, 7, 9]].sum() - own[[4, 7, 9]]
        unit = np.sqrt(np.append(np.maximum(second, THINNEST * second.max()), own[0]))
        matrix = cvxpy.multiply(cvxpy.Variable((4, 4), PSD=True), np.outer(unit, unit))
        square = matrix[:3, :3]
        if i + 1 < arm.n:
            axis = arm.frames[i + 1].T @ arm.axes[i + 1]
            carried = of_joint["Im", i + 1]
            share = 0.5 * units[carried] * (np.eye(3) - np.outer(axis, axis))
            square = square + factors[carried] * share
        inertia = cvxpy.trace(square) * np.eye(3) - square
        parts += [matrix[3, 3], matrix[0, 3], matrix[1, 3], matrix[2, 3]]
        parts += [inertia[row, column] for row, column in zip(*_UPPER, strict=True)]
    return cvxpy.hstack([*parts, cvxpy.multiply(units, factors)])


def _by_matrix(cvxpy: Any, arm: Arm, drawn: Array) -> Any:
    """The candidates (c,) as an expression of N without rotors, which is positive semi-definite, of first moments, and
    of drives, which are not negative."""
    kinetic, rotor = _linear(arm)
    bodies = len(arm.full_body_names)
    size = int(np.sqrt(kinetic.shape[1]))
    # scaling by the diagonal of N in the drawing makes every unknown of order one
    diagonal = np.abs(kinetic[:, :: size + 1]).T @ np.abs(drawn[: len(kinetic)])
    unit = np.sqrt(diagonal)
    matrix = cvxpy.Variable((size, size), PSD=True)
    moments = cvxpy.Variable(bodies - len(kinetic))
    drives = cvxpy.Variable(len(drawn) - bodies, nonneg=True)
    drive_units = drawn[bodies:]
    weight = float(np.abs(drawn[len(kinetic) : bodies]).max(initial=0.0)) or 1.0
    scaled = kinetic * np.outer(unit, unit).ravel()
    return cvxpy.hstack(
        [
            scaled @ cvxpy.vec(matrix, order="C") + (rotor * drive_units) @ drives,
            weight * moments,
            cvxpy.multiply(drive_units, drives),
        ]
    )


def _linear(arm: Arm) -> tuple[Array, Array]:
    """Matrices that give the full kinetic parameters from N of the bodies without rotors, (c, V^2), and from Im, k, b,
    (c, at most 3 N)."""
    kinds = arm.full_joint_parameters
    if arm.spatial:
        size = gram.directions(arm)
        kinetic = np.array([gram.to_parameters(arm, unit.reshape(size, size)) for unit in np.eye(size * size)]).T
        # the upper triangle represents both symmetric entries
        both = np.array([gram.to_parameters(arm, unit.reshape(size, size).T) for unit in np.eye(size * size)]).T
        kinetic = 0.5 * (kinetic + both)
        rotor = np.zeros((len(kinetic), len(kinds)))
        for column, (kind, i) in enumerate(kinds):
            if kind == "Im":
                rotor[:, column] = gram.to_parameters(arm, gram.of_rotors(arm, np.eye(arm.n)[i]))
        return kinetic, rotor
    first = 0 if arm.free else 1
    count = arm.n + 1 - first
    pairs = [(i, j) for i in range(count) for j in range(i, count)]
    rows = []
    for i, j in pairs:
        row = np.zeros((2 * count, 2 * count))
        row[2 * i, 2 * j] = row[2 * i + 1, 2 * j + 1] = 1.0
        rows.append(0.5 * (row + row.T))
    for i, j in pairs if arm.kinetic == "planar" else []:
        if i < j:
            row = np.zeros((2 * count, 2 * count))
            row[2 * i + 1, 2 * j], row[2 * i, 2 * j + 1] = 1.0, -1.0
            rows.append(0.5 * (row + row.T))
    rotor = np.zeros((len(rows), len(kinds)))
    for column, (kind, i) in enumerate(kinds):
        if kind == "Im" and i >= first:
            rotor[pairs.index((i - first, i - first)), column] = 1.0
    return np.array([row.ravel() for row in rows]), rotor


def _least_squares(
    where: Coordinates, root: Array, target: Array, start: Array, tolerance: float, progress: Callable[[float], None]
) -> Array:
    """The y that minimises |root (base(y) - target)|^2 + |y|^2, or the best one after _EVALUATIONS."""
    evaluations = 0

    def residual(y: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        progress(min(1.0, evaluations / _EVALUATIONS))
        return np.concatenate([root @ (where.base(y) - target), y])

    def slope(y: Array) -> Array:
        return np.vstack([root @ _slope(where.base, y), np.eye(where.size)])

    found: Array = least_squares(
        residual, start, slope, method="lm", xtol=tolerance, ftol=tolerance, max_nfev=_EVALUATIONS
    ).x
    return found


def _six(entries: Iterable[Quantity]) -> tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]:
    ixx, ixy, ixz, iyy, iyz, izz = entries
    return ixx, ixy, ixz, iyy, iyz, izz


def _with(joint: JointModel, changed: dict[str, Any]) -> JointModel:
    return replace(joint, **changed)


def _slope(function: Callable[[Array], Array], y: Array) -> Array:
    """Jacobian by central differences; every coordinate is of order one."""
    steps = _STEP * np.eye(len(y))
    return np.array([(function(y + step) - function(y - step)) / (2.0 * _STEP) for step in steps]).T


def _root(body: Body) -> Array:
    """(3, 3) Cholesky factor of the second moment per mass about the centre, m, limited from below by THINNEST."""
    second = (0.5 * np.trace(body.tensor) * np.eye(3) - body.tensor) / body.mass.value
    eigen, vectors = np.linalg.eigh(second)
    root: Array = np.linalg.cholesky((vectors * np.maximum(eigen, THINNEST * eigen[-1])) @ vectors.T)
    return root


def _reach(body: Body) -> Array:
    """(3,) position of the next joint, m; zero for the last body."""
    return np.array(body.joint_xyz or (0.0, 0.0, 0.0))


def _with_sigmas(where: Coordinates, y: Array, spread: NDArray[Any]) -> tuple[Model, dict[str, float]]:
    """The arm at y with a sigma for each entry, from the covariance spread spread' of the coordinates, and the share of
    the drawing's uncertainty that is removed from each."""

    def entries(at: Array) -> Array:
        return np.array([entry.value for entry in entries_of_model(where.arm, where.model(at)).values()])

    slope = _slope(entries, y)
    after = np.linalg.norm(slope @ spread, axis=1)
    before = np.linalg.norm(slope, axis=1)
    model = where.model(y)
    names = list(entries_of_model(where.arm, model))
    sigma = dict(zip(names, after.tolist(), strict=True))
    bodies = tuple(
        replace(
            body,
            mass=replace(body.mass, sigma=sigma[f"{body.name} mass"]),
            inertia=_six(
                replace(entry, sigma=sigma[f"{body.name} {key}"])
                for key, entry in zip(INERTIA_KEYS, body.inertia, strict=True)
            ),
        )
        if i in where.bodies
        else body
        for i, body in enumerate(model.bodies)
    )
    joints = tuple(
        _with(
            joint,
            {
                key: replace(getattr(joint, key), sigma=sigma[f"{joint.name} {key}"])
                for key in _DRIVE_KEYS.values()
                if f"{joint.name} {key}" in sigma
            },
        )
        for joint in model.joints
    )
    known = 1.0 - (after / np.where(before > 0.0, before, 1.0)) ** 2
    return replace(model, bodies=bodies, joints=joints), dict(zip(names, known.tolist(), strict=True))
