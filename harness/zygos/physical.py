"""The arm behind an estimate: bodies, lengths and drives whose base parameters explain it (docs/physical.md).

Base parameters with noise are those of no arm: their matrix N has entries to spare, 45 against 31 that bodies can
choose in space with three joints, and nothing keeps it positive. A fit moves bodies instead of numbers. Each body is
written so that whatever the numbers are it can exist (log-Cholesky: Rucker & Wensing, "Smooth parameterization of
rigid-body inertia", RA-L 2022), and what the estimate does not say stays as the drawing has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import f as fisher

from zygos import gram
from zygos.arm import Arm
from zygos.errors import Undecided, ZygosError
from zygos.model import INERTIA_KEYS, Body, JointModel, Model, Quantity
from zygos.nearest import differentiate

Array = NDArray[np.float64]

CHANCE = 1e-3
"""The limit of chi^2/dof is what an estimate of the described arm exceeds this often."""
THINNEST = 1e-4
"""Of a body's largest principal second moment: what is thinner in the drawing is made so thick."""

_DEPENDENT = 1e-11
"""Columns whose scaled normal matrix has a smaller eigenvalue depend on each other, as in c/solver.c."""
_STEPS = 4
"""Of the path from the drawing to the estimate."""
_DRIVE_KEYS = {"Im": "rotor_inertia", "k": "stiffness", "b": "damping"}


@dataclass(frozen=True)
class Observed:
    """What an estimate says of the p base parameters of an arm."""

    value: Array
    """(p,) least squares for all of them; NaN for none."""
    root: Array
    """(r, p): chi^2 of base parameters x is |root (x - value)|^2; directions that the motion did not excite drop out."""
    blocks: int
    """Of the jackknife that chi^2 is scaled by."""


@dataclass(frozen=True)
class Fit:
    """The arm that explains an estimate best."""

    model: Model
    """By bodies; sigmas are of each entry by itself, and those of entries nobody has determined are large."""
    value: Array
    """(p,) its base parameters."""
    covariance: Array
    """(p, p) theirs."""
    known: dict[str, float]
    """For each entry of `entries_of_model`, how much of the drawing's uncertainty the estimate took away, 0 .. 1."""
    lengths: Array
    """(N, 3) by how much the lengths differ from the drawing, m."""
    chi2: float
    """Of the estimate and of the lengths' prior."""
    dof: float
    """What these say beyond what the bodies were fitted to."""
    limit: float
    """Of chi2/dof; infinite where dof is below one, for then the bodies can follow any estimate."""
    least: float
    """chi^2 of the nearest positive semi-definite N, by convex programming: no arm whatever has less."""

    @property
    def explained(self) -> bool:
        """Whether chi2/dof is within its limit."""
        return self.chi2 <= self.limit * max(self.dof, 1.0)


def observe(names: Sequence[str], report: Mapping[str, Any]) -> Observed:
    """What the JSON of `zygos estimate` says of the parameters `names`; other columns of it are eliminated.

    chi^2 has the shape of the normal equations, A, and the size of the jackknife: (x - value)' A (x - value) / c with c
    the median of published variance over that of A^-1. The published covariance has the rank of its at most 32 blocks
    and is no metric; independent variances would give away the sharpest combinations. Errors: ZygosError, Undecided if
    the estimate was refused.
    """
    listed = [str(entry["name"]) for entry in report["parameters"]]
    missing = [name for name in names if name not in listed]
    if missing:
        raise ZygosError(f"the estimate has no {', '.join(missing[:3])}; remedy: give the arm that it was learned with")
    if report["validity"] == "refused":
        raise Undecided(f"the estimate was refused: {report['reason']}; remedy: that of `zygos estimate`")
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
        raise Undecided("no parameter of the estimate has a sigma; remedy: a longer run that moves every joint")
    inner = scaled[np.ix_(own, own)]
    if others:
        cross = scaled[np.ix_(own, others)]
        inner = inner - cross @ np.linalg.pinv(scaled[np.ix_(others, others)], rcond=_DEPENDENT, hermitian=True) @ cross.T
    eigen, vectors = np.linalg.eigh(inner)
    kept = eigen > _DEPENDENT * eigen[-1]
    root = np.sqrt(eigen[kept, None] / np.median(ratio)) * vectors[:, kept].T / scale[own]
    return Observed(solution[own], root, int(report["blocks"]))


@dataclass(frozen=True)
class Coordinates:
    """Numbers y, zero at the drawing and one where it is off by a standard deviation, for arms near the drawing.

    Ten of each body: log mass, mass centre in radii of gyration, and the factor E (lower triangular, logarithms on the
    diagonal) that the Cholesky factor of its second moment per mass is multiplied with. Then the lengths, and the
    logarithms of Im, k and b. A drawing is taken to be right to a factor of e, or a radius of gyration.
    """

    arm: Arm
    drawing: Model
    length_sigma: float
    """Of each component of a length, m; 0: exact."""

    @property
    def bodies(self) -> range:
        """Those that move."""
        return range(0 if self.arm.free else 1, self.arm.n + 1)

    @property
    def places(self) -> list[tuple[int, Array]]:
        """Body and unit vector of each length that may be off. In a plane lengths along the axis have no effect."""
        if self.length_sigma == 0.0:
            return []
        return [(i, vector) for i in self.bodies if i < self.arm.n for vector in self._directions(i)]

    @property
    def size(self) -> int:
        """Number of coordinates."""
        centres = sum(len(self._directions(i)) for i in self.bodies)
        return 7 * len(self.bodies) + centres + len(self.places) + len(self.arm.joint_parameters)

    @property
    def of_lengths(self) -> slice:
        """Where the lengths stand in y."""
        first = self.size - len(self.arm.joint_parameters)
        return slice(first - len(self.places), first)

    def model(self, y: Array) -> Model:
        """The arm with these coordinates; sigmas 0."""
        bodies = list(self.drawing.bodies)
        rest = list(y)
        for i in self.bodies:
            count = 7 + len(self._directions(i))
            bodies[i] = self._body(i, np.array(rest[:count]))
            rest = rest[count:]
        for (i, vector), shift in zip(self.places, y[self.of_lengths], strict=True):
            x, y_, z = np.array(bodies[i].joint_xyz) + self.length_sigma * shift * vector
            bodies[i] = replace(bodies[i], joint_xyz=(float(x), float(y_), float(z)))
        values: dict[int, dict[str, float]] = {}
        for (kind, i, _), log in zip(self.arm.joint_parameters, y[self.of_lengths.stop :], strict=True):
            key = _DRIVE_KEYS[kind]
            values.setdefault(i, {})[key] = getattr(self.drawing.joints[i], key).value * float(np.exp(log))
        joints = tuple(_drive(joint, values.get(i, {})) for i, joint in enumerate(self.drawing.joints))
        return Model(self.drawing.name, tuple(bodies), joints)

    def _directions(self, i: int) -> Array:
        """(d, 3) in body i's frame: where its mass centre and the next joint may move with any effect, and, on a
        planar-symmetric arm, without leaving the line of the joints."""
        if self.arm.spatial:
            return np.eye(3)
        attitude = self.arm.frames[i]
        along = self._line()
        vectors = [along] if self.arm.kinetic == "planar-symmetric" else [along, np.cross(self.arm.axis, along)]
        return np.array(vectors) @ attitude

    def _line(self) -> Array:
        """(3,) across the axis in the base frame of a stretched planar arm: from the first joint to the last centre."""
        last = self.drawing.bodies[-1].origin_xyz
        places = [
            self.arm.frames[i] @ np.array(body.joint_xyz if i < self.arm.n else last)
            for i, body in enumerate(self.drawing.bodies)
            if i > 0
        ]
        across = np.array(places) @ (np.eye(3) - np.outer(self.arm.axis, self.arm.axis))
        longest = across[np.argmax(np.linalg.norm(across, axis=1))]
        length = float(np.linalg.norm(longest))
        line: Array = longest / length if length > 0.0 else np.linalg.svd(self.arm.axis[None])[2][1]
        return line

    def _body(self, i: int, y: Array) -> Body:
        drawn = self.drawing.bodies[i]
        mass = drawn.mass.value * float(np.exp(y[0]))
        per_mass = _second_moment(drawn) / drawn.mass.value
        factor = np.diag(np.exp(y[1:4]))
        factor[np.tril_indices(3, -1)] = y[4:7]
        root = np.linalg.cholesky(per_mass) @ factor
        second = mass * root @ root.T
        tensor = np.trace(second) * np.eye(3) - second
        shift = np.sqrt(np.trace(per_mass)) * y[7:] @ self._directions(i)
        cx, cy, cz = (np.array(drawn.origin_xyz) + shift).tolist()
        ixx, ixy, ixz, iyy, iyz, izz = (
            Quantity(float(entry), 0.0, "zygos", "kg m^2") for entry in tensor[np.triu_indices(3)]
        )
        return replace(
            drawn,
            mass=Quantity(mass, 0.0, "zygos", "kg"),
            origin_xyz=(cx, cy, cz),
            inertia=(ixx, ixy, ixz, iyy, iyz, izz),
        )


def entries_of_model(arm: Arm, model: Model) -> dict[str, Quantity]:
    """What a fit moves and a model file has a sigma for, by name: of each body mass and inertia, of each drive Im, k, b."""
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
) -> Fit:
    """The arm near `drawing` (given by bodies) that explains an estimate best.

    Minimises chi^2 + |y|^2 over the `Coordinates` y. The way there: the estimate is first moved to the nearest N that
    is positive semi-definite, a convex problem with one answer; then the target goes from the drawing's base parameters
    to it along a line, on which every N is, for these matrices form a convex set; and the fit follows in steps, each
    starting from the one before. Errors: ZygosError if the drawing does not fit the arm.
    """
    drawing.base_values(replace(arm))
    where = Coordinates(arm, drawing, length_sigma)

    def base(y: Array) -> Array:
        return where.model(y).base_values(arm)

    nearest, least = nearest_matrix(arm, drawing, observed)
    y = np.zeros(where.size)
    start = base(y)
    path = [start + t * (nearest - start) for t in np.linspace(0.0, 1.0, _STEPS + 1)[1:]]
    for step, target in enumerate([*path, observed.value]):
        progress((step + 1) / (_STEPS + 2))

        def residual(at: Array, target: Array = target) -> Array:
            return np.concatenate([observed.root @ (base(at) - target), at])

        def slope(at: Array) -> Array:
            return np.vstack([observed.root @ differentiate(base, at, np.ones(where.size)), np.eye(where.size)])

        y = least_squares(residual, y, slope, method="lm", xtol=1e-10, ftol=1e-10, max_nfev=100).x
    value = base(y)
    slope_of_base = differentiate(base, y, np.ones(where.size))
    missing = observed.root @ (value - observed.value)
    lengths = y[where.of_lengths]
    spread = np.linalg.inv(np.eye(where.size) + (observed.root @ slope_of_base).T @ (observed.root @ slope_of_base))
    rows = np.vstack([observed.root @ slope_of_base, np.eye(where.size)[where.of_lengths]])
    dof = float(len(rows) - np.sum((rows @ spread) * rows))
    model, known = _with_sigmas(where, y, spread)
    return Fit(
        model=model,
        value=value,
        covariance=slope_of_base @ spread @ slope_of_base.T,
        known=known,
        lengths=np.array(
            [
                np.subtract(after.joint_xyz, before.joint_xyz)
                for after, before in zip(model.bodies[:-1], drawing.bodies[:-1], strict=True)
            ]
        ),
        chi2=float(missing @ missing + lengths @ lengths),
        dof=dof,
        limit=float(fisher.isf(CHANCE, dof, observed.blocks - 1)) if dof >= 1.0 else np.inf,
        least=least,
    )


def nearest_matrix(arm: Arm, drawing: Model, observed: Observed) -> tuple[Array, float]:
    """The base parameters (p,) nearest to an estimate whose N less the rotors' share is positive semi-definite and
    whose Im, k and b are not negative, and their chi^2.

    What every arm obeys, though not only arms: a semidefinite program, solved by Clarabel. The drawing gives the units
    alone. Errors: ZygosError if cvxpy or Clarabel is missing.
    """
    try:
        import cvxpy  # noqa: PLC0415  (an extra, and slow to load)
    except ImportError:
        raise ZygosError("fitting needs cvxpy and Clarabel; remedy: pip install 'zygos[fit]'") from None
    drawn = drawing.base_values(arm)
    kinetic, rotor = _linear(arm)
    bodies = len(arm.body_parameters)
    size = int(np.sqrt(kinetic.shape[1]))
    # a diagonal entry of N in the drawing's size makes every unknown of order one
    diagonal = np.abs(kinetic[:, :: size + 1]).T @ np.abs(drawn[: len(kinetic)])
    unit = np.sqrt(diagonal)
    matrix = cvxpy.Variable((size, size), PSD=True)
    moments = cvxpy.Variable(bodies - len(kinetic))
    drives = cvxpy.Variable(len(drawn) - bodies, nonneg=True)
    drive_units = drawn[bodies:]
    weight = float(np.abs(drawn[len(kinetic) : bodies]).max(initial=0.0)) or 1.0
    scaled = kinetic * np.outer(unit, unit).ravel()
    x = cvxpy.hstack(
        [
            scaled @ cvxpy.vec(matrix, order="C") + (rotor * drive_units) @ drives,
            weight * moments,
            cvxpy.multiply(drive_units, drives),
        ]
    )
    # chi^2 of a bad estimate is huge; its size is taken out for the solver
    off = observed.root @ (drawn - observed.value)
    length = max(1.0, float(np.linalg.norm(off)))
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares((observed.root / length) @ (x - observed.value))))
    problem.solve(solver=cvxpy.CLARABEL)
    value: Array = np.asarray(x.value, dtype=float)
    gone = observed.root @ (value - observed.value)
    return value, float(gone @ gone)


def _linear(arm: Arm) -> tuple[Array, Array]:
    """Kinetic parameters from N of the bodies without rotors (c, V^2), row by row, and from Im, k, b (c, 3 N or fewer)."""
    kinds = arm.joint_parameters
    if arm.spatial:
        size = gram.directions(arm)
        kinetic = np.array([gram.to_parameters(arm, unit.reshape(size, size)) for unit in np.eye(size * size)]).T
        # the upper triangle stands for both entries
        both = np.array([gram.to_parameters(arm, unit.reshape(size, size).T) for unit in np.eye(size * size)]).T
        kinetic = 0.5 * (kinetic + both)
        rotor = np.zeros((len(kinetic), len(kinds)))
        for column, (kind, i, _) in enumerate(kinds):
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
    for column, (kind, i, _) in enumerate(kinds):
        if kind == "Im" and i >= first:
            rotor[pairs.index((i - first, i - first)), column] = 1.0
    return np.array([row.ravel() for row in rows]), rotor


def _second_moment(body: Body) -> Array:
    """(3, 3) of the mass about its centre, kg m^2, at least THINNEST thick."""
    second = 0.5 * np.trace(body.tensor) * np.eye(3) - body.tensor
    eigen, vectors = np.linalg.eigh(second)
    thick: Array = (vectors * np.maximum(eigen, THINNEST * eigen[-1])) @ vectors.T
    return thick


def _drive(joint: JointModel, values: dict[str, float]) -> JointModel:
    return JointModel(
        joint.name,
        joint.rotor_mass if not joint.rotor_mass.sigma else replace(joint.rotor_mass, sigma=0.0),
        *(
            Quantity(values[key], 0.0, "zygos", getattr(joint, key).unit)
            if key in values
            else replace(getattr(joint, key), sigma=0.0)
            for key in _DRIVE_KEYS.values()
        ),
    )


def _with_sigmas(where: Coordinates, y: Array, spread: Array) -> tuple[Model, dict[str, float]]:
    """The arm at y with the sigmas that the coordinates' covariance gives each entry, and how much of each is known."""

    def entries(at: Array) -> Array:
        return np.array([entry.value for entry in entries_of_model(where.arm, where.model(at)).values()])

    slope = differentiate(entries, y, np.ones(where.size))
    after = np.sqrt(np.sum((slope @ spread) * slope, axis=1))
    before = np.linalg.norm(slope, axis=1)
    model = where.model(y)
    names = list(entries_of_model(where.arm, model))
    sigma = dict(zip(names, after.tolist(), strict=True))
    bodies = tuple(
        replace(
            body,
            mass=replace(body.mass, sigma=sigma[f"{body.name} mass"]),
            inertia=tuple(
                replace(entry, sigma=sigma[f"{body.name} {key}"])
                for key, entry in zip(INERTIA_KEYS, body.inertia, strict=True)
            ),
        )
        if i in where.bodies
        else body
        for i, body in enumerate(model.bodies)
    )
    joints = tuple(
        replace(
            joint,
            **{
                key: replace(getattr(joint, key), sigma=sigma[f"{joint.name} {key}"])
                for key in _DRIVE_KEYS.values()
                if f"{joint.name} {key}" in sigma
            },
        )
        for joint in model.joints
    )
    known = 1.0 - (after / np.where(before > 0.0, before, 1.0)) ** 2
    return replace(model, bodies=bodies, joints=joints), dict(zip(names, known.tolist(), strict=True))
